//! Tables as spreadsheets write them: with a first line `sep=;`, semicolons or tabs for commas, and decimal commas.

use std::path::Path;

use crate::gcp::text::decode;
use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};

/// The text of a table.
pub struct Spreadsheet {
    text: String,
    delimiter: u8,
    /// Lines before the titles.
    skipped: usize,
}

impl Spreadsheet {
    /// Reads a file; `what` it is, for messages.
    ///
    /// # Errors
    /// When it cannot be read, is larger than `most_bytes`, or is no text.
    pub fn read(path: &Path, what: &'static str, most_bytes: u64) -> Result<Spreadsheet> {
        let bytes = bounded::read(path, what, most_bytes)?;
        let text = decode(&bytes).ok_or_else(|| Error::format(path, "begin", "this is no text"))?;
        Ok(Spreadsheet::of(text))
    }

    fn of(text: String) -> Spreadsheet {
        let delimiter = delimiter(&text);
        let stated = text.split_once('\n').filter(|(first, _)| stated_delimiter(first).is_some());
        match stated {
            Some((_, rest)) => Spreadsheet { delimiter, skipped: 1, text: rest.to_owned() },
            None => Spreadsheet { delimiter, skipped: 0, text },
        }
    }

    /// A reader of its rows; lines that begin with # are passed over.
    pub fn reader(&self) -> csv::Reader<&[u8]> {
        csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .delimiter(self.delimiter)
            .from_reader(self.text.as_bytes())
    }

    /// Whether it is a document in JSON instead.
    pub fn is_json(&self) -> bool {
        self.text.trim_start_matches('\u{feff}').trim_start().starts_with(['{', '['])
    }

    /// The row of the file that the record of this index is, both counted as people do: titles are row 1.
    pub fn row(&self, record: usize) -> usize {
        record + 2 + self.skipped
    }

    /// A finite number. A German spreadsheet writes semicolons and decimal commas; between commas they are quoted,
    /// where a comma before three digits may as well part the thousands.
    pub fn number(&self, text: &str) -> Option<f64> {
        let thousands = self.delimiter == b',' && text.rsplit_once(',').is_some_and(|(_, digits)| digits.len() == 3);
        let plain = if thousands { text.to_owned() } else { text.replacen(',', ".", 1) };
        plain.parse::<f64>().ok().filter(|v| v.is_finite())
    }
}

fn stated_delimiter(line: &str) -> Option<u8> {
    let stated = line.trim().trim_matches('"').strip_prefix("sep=")?.as_bytes();
    (stated.len() <= 1).then(|| stated.first().copied().unwrap_or(b'\t'))
}

/// What stands between the columns, by the first line that is no comment: a comma, or what spreadsheets write in
/// countries with a decimal comma.
fn delimiter(text: &str) -> u8 {
    let first = text.lines().find(|line| !line.starts_with('#') && !line.is_empty()).unwrap_or_default();
    let found = || ";\t".bytes().find(|d| first.as_bytes().contains(d));
    stated_delimiter(first).or_else(found).unwrap_or(b',')
}
