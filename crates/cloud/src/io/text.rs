//! Tables of text: x, y, z and further columns, separated by semicolons, tabs, commas or blanks, whichever comes first
//! in this order; beside semicolons and tabs a comma is a decimal one.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use super::text_head::{self, Count, DECIMAL_COMMAS, NO_THOUSANDS, remark};
use super::text_line::{has_decimal_commas, has_thousands, number, numbers, plain_numbers, read_line, text_of, words};
use super::{Format, Header, PointReader, Precision};
use crate::error::{Error, Result};
use crate::schema::{Batch, Kind, Schema};
use autoref_raster::words::counted;

const MOST_COLUMNS: usize = 256;

struct TextReader {
    path: PathBuf,
    file: BufReader<File>,
    /// Of x, y and z among the columns.
    axes: [usize; 3],
    columns: usize,
    line: u64,
    bytes: Vec<u8>,
    /// How many rows the file says that this scan has, and how many of them were read.
    count: Option<Count>,
    counted: u64,
    /// Rows whose first column counts on, as numbers of points do; `None` where one does not, or its title says what it
    /// is.
    numbered: Option<u64>,
    before: f64,
}

pub(super) fn open(path: &Path) -> Result<(Header, Box<dyn PointReader>)> {
    let (schema, reader) = begin(path)?;
    let header = Header {
        format: Format::Text,
        points: None,
        colours: colour_limits(path, &schema),
        schema,
        precision: Precision::Double,
        crs: None,
        shift: None,
        intensity: None,
        las: None,
        description: format!("text, {} columns", reader.columns),
    };
    Ok((header, Box::new(reader)))
}

fn begin(path: &Path) -> Result<(Schema, TextReader)> {
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let mut file = BufReader::with_capacity(1 << 20, file);
    let (mut line, mut bytes) = (0, Vec::new());
    let head = text_head::read(path, &mut file, &mut line, &mut bytes)?;
    let (columns, count) = (head.columns, head.count);
    if !(3..=MOST_COLUMNS).contains(&columns) {
        return Err(Error::format(
            path,
            format!("line {}", line + 1),
            format!("{columns} columns; x, y, z are needed"),
        ));
    }
    let numbered = head.may_begin_with_numbers().then_some(0);
    let names = text_head::names_of(path, head, line)?;
    let axes = text_head::axes_among(path, &names)?;
    let schema = text_head::schema_of(&names, axes);
    let path = path.to_path_buf();
    let reader = TextReader { path, file, axes, columns, line, bytes, count, counted: 0, numbered, before: f64::NAN };
    Ok((schema, reader))
}

/// The limits of 8 bits, where the first rows with a colour have no larger ones; a table says nothing of their kind.
/// Black and white alone tell nothing, and what can be read once only is not looked at.
fn colour_limits(path: &Path, schema: &Schema) -> Option<[f64; 2]> {
    const ROWS: usize = 20_000;
    const MOST_ROWS: usize = 50 * ROWS;
    let of = |names: [&str; 2]| schema.fields.iter().find(|field| names.contains(&field.name.as_str()));
    let fields = [of(["red", "r"])?, of(["green", "g"])?, of(["blue", "b"])?];
    std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file)?;
    // What is wrong with a row is told when it is read for good.
    let (_, mut reader) = begin(path).ok()?;
    let mut batch = Batch::default();
    for _ in 0..MOST_ROWS / ROWS {
        let read = reader.read(&mut batch, ROWS);
        let mut most = 0.0f64;
        for row in batch.raw.chunks_exact(schema.stride).take(batch.len()) {
            for field in fields {
                let value = field.value(row);
                if value.fract() != 0.0 || !(0.0..=255.0).contains(&value) {
                    return None;
                }
                most = most.max(value);
            }
        }
        if most > 1.0 {
            return Some([0.0, 255.0]);
        }
        if read.is_err() || batch.is_empty() {
            return None;
        }
    }
    None
}

impl TextReader {
    /// Whether the rows that were read are as many as the file says.
    fn check_count(&self) -> Result<()> {
        match self.count {
            Some(Count { rows, line }) if rows != self.counted => {
                let what =
                    format!("{} rows follow, not {rows}: the table is damaged, or this is no count", self.counted);
                Err(Error::format(&self.path, format!("line {line}"), what))
            }
            _ => Ok(()),
        }
    }

    /// Looks whether the first column counts on.
    fn look_at_number(&mut self, first: f64) {
        let Some(rows) = self.numbered else { return };
        let goes_on = first.fract() == 0.0 && (rows == 0 || first == self.before + 1.0);
        self.numbered = goes_on.then_some(rows + 1);
        self.before = first;
    }

    /// Takes a line that is no row: an empty one, a remark, or the count of the next scan of a file that counts.
    fn take_other(&mut self, columns: usize) -> Result<()> {
        let text = text_of(&mut self.bytes);
        if text.is_empty() || remark(text).is_some() {
            return Ok(());
        }
        let next = self.count.and_then(|_| Count::of(text, self.line));
        if next.is_none() {
            return Err(Error::format(&self.path, format!("line {}", self.line), mistake(text, columns)));
        }
        self.check_count()?;
        (self.count, self.counted) = (next, 0);
        Ok(())
    }
}

impl PointReader for TextReader {
    fn read(&mut self, batch: &mut Batch, limit: usize) -> Result<()> {
        batch.clear();
        while batch.len() < limit {
            if !read_line(&self.path, &mut self.file, &mut self.line, &mut self.bytes)? {
                return self.check_count();
            }
            let begin = batch.raw.len();
            if plain_numbers(&self.bytes, &mut batch.raw) != Some(self.columns) {
                batch.raw.truncate(begin);
                let text = text_of(&mut self.bytes);
                if remark(text).is_some() || numbers(text, &mut batch.raw) != Some(self.columns) {
                    batch.raw.truncate(begin);
                    self.take_other(self.columns)?;
                    continue;
                }
            }
            self.counted += 1;
            if self.numbered.is_some() {
                self.look_at_number(Kind::F64.read(&batch.raw[begin..]));
            }
            batch.xyz.push(self.axes.map(|axis| Kind::F64.read(&batch.raw[begin + 8 * axis..])));
        }
        Ok(())
    }

    fn left_over(&mut self) -> Result<Option<String>> {
        const FEWEST: u64 = 3;
        Ok(self.numbered.filter(|rows| *rows >= FEWEST).map(|_| {
            "the first column counts the rows and was read as x: put a head above them that names the columns (ID X Y \
             Z)"
            .into()
        }))
    }
}

/// What is wrong with a row.
fn mistake(text: &str, columns: usize) -> String {
    if has_decimal_commas(text) {
        return format!("`{text}` has decimal commas between blanks: {DECIMAL_COMMAS}");
    }
    if has_thousands(text) {
        return format!("`{text}` has marks between thousands: {NO_THOUSANDS}");
    }
    let row = words(text);
    match row.iter().find(|word| number(word).is_none()) {
        Some(word) if row.len() == columns => format!("`{word}` is no number"),
        _ => format!("{}, the lines before have {columns}", counted(row.len(), "value", "values")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, ..ProptestConfig::default() })]
        /// Where the short way answers, it answers what the rules do.
        #[test]
        fn plain_rows_are_read_by_the_rules(line in "([0-9]{1,3}(\\.[0-9]{0,3})?|-1e3|;|,|\t| |\"|a|é|\u{b}){0,12}(\r\n)?") {
            let (mut plain, mut full) = (Vec::new(), Vec::new());
            if let Some(count) = plain_numbers(line.as_bytes(), &mut plain) {
                prop_assert_eq!(numbers(line.trim(), &mut full).or(line.trim().is_empty().then_some(0)), Some(count));
                prop_assert_eq!(plain, full);
            }
        }
    }

    /// Reads a table to its end: how many points, and the names of its columns.
    fn read_all(name: &str, table: &str) -> Result<(usize, Vec<String>)> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(name);
        std::fs::write(&path, table).expect("a file");
        let (header, mut reader) = open(&path)?;
        let (mut batch, mut points) = (Batch::default(), 0);
        loop {
            reader.read(&mut batch, 2)?;
            if batch.is_empty() {
                return Ok((points, header.schema.fields.iter().map(|field| field.name.clone()).collect()));
            }
            points += batch.len();
        }
    }

    #[test]
    fn numbers_of_points_are_told() {
        let note = |table: &str| {
            let folder = tempfile::tempdir().expect("a folder");
            let path = folder.path().join("table.txt");
            std::fs::write(&path, table).expect("a file");
            let (_, mut reader) = open(&path).expect("a table");
            let mut batch = Batch::default();
            while reader.read(&mut batch, 2).is_ok() && !batch.is_empty() {}
            reader.left_over().expect("nothing is read for it")
        };
        let told = note("7 500 600 1\n8 501 601 2\n9 502 602 3\n").expect("a note");
        assert!(told.contains("first column") && told.contains("ID X Y Z"), "{told}");
        for table in [
            "7 500 600\n8 501 601\n9 502 602\n",
            "ID X Y Z\n7 500 600 1\n8 501 601 2\n9 502 602 3\n",
            "7 500 600 1\n8 501 601 2\n10 502 602 3\n",
            "7.5 500 600 1\n8.5 501 601 2\n9.5 502 602 3\n",
            "7 500 600 1\n8 501 601 2\n",
        ] {
            assert_eq!(note(table), None, "{table}");
        }
    }

    /// Counts are checked, scans that follow each other are one cloud, and the columns of PTS have names.
    #[test]
    fn counts_and_columns_of_pts() {
        let table = "2\n1 2 3 -500 10 20 30\n1 2 4 -400 10 20 30\n0\n1\n1 2 5 -300 10 20 255\n";
        let (points, names) = read_all("scan.pts", table).expect("two scans");
        assert_eq!((points, names.join(" ").as_str()), (3, "x y z intensity red green blue"));
        assert_eq!(read_all("scan.pts", "1\n1 2 3 0.5\n").expect("a scan").1[3], "intensity");
        assert_eq!(read_all("normals.pts", "1\n1 2 3 0.1 0.2 0.9\n").expect("a scan").1[3], "column_4");
        let cloud_compare = "//X Y Z Intensity\n2\n1 2 3 7\n1 2 4 8\n";
        assert_eq!(read_all("cloud.asc", cloud_compare).expect("a table").0, 2);
        let refused = |table: &str| read_all("scan.pts", table).expect_err("a wrong count").to_string();
        assert!(refused("3\n1 2 3\n1 2 4\n").contains("line 1: 2 rows follow, not 3"));
        assert!(refused("1\n1 2 3\n1 2 4\n2\n1 2 3\n").contains("line 1: 2 rows follow, not 1"));
        assert!(refused("10\n20\n0 0 0\n1 0 0\n").contains("PTX"));
    }

    /// LF, CR LF and CR alone end lines, wherever the buffers of 1 MiB end.
    #[test]
    fn lines_end_as_files_end_them() {
        let rows = 70_000;
        for end in ["\n", "\r\n", "\r"] {
            let table: String = (0..rows).map(|row| format!("{row} {} 1.25{end}", row * 7)).collect();
            assert!(table.len() > 1 << 20);
            let (points, names) = read_all("rows.xyz", &format!("X Y Z{end}{end}{table}")).expect("a table");
            assert_eq!((points, names.len()), (rows, 3), "{end:?}");
        }
        // A table of one kind within another: the lines are those of both.
        assert_eq!(read_all("both.xyz", "1 2 3\r4 5 6\n7 8 9").expect("a table").0, 3);
        let wrong = read_all("short.xyz", "1 2 3\r4 5\r").expect_err("two values").to_string();
        assert!(wrong.contains("line 2: 2 values"), "{wrong}");
    }

    #[test]
    fn decimal_commas_between_blanks_are_named() {
        for table in ["1,5 2,5 3,5\n", "X Y Z\n1,5 2 3,25\n", "1 2 3\n1,5 2,5 3,5\n"] {
            let refused = read_all("comma.xyz", table).expect_err("commas").to_string();
            assert!(refused.contains("decimal commas between blanks: write decimal points"), "{refused}");
        }
        assert_eq!(read_all("comma.csv", "1,5;2,5;3,5\n").expect("a table").0, 1);
        assert_eq!(read_all("comma.csv", "1, 2, 3\n").expect("a table").0, 1);
    }

    #[test]
    fn thousands_quoted_commas_and_wide_letters_are_named() {
        let refused = |table: &str| read_all("cloud.csv", table).expect_err("refused").to_string();
        for row in [
            "598'014.0 6'643'213.2 45.0",
            "598 014,0;6 643 213,2;45,0",
            "598.014,0;6.643.213,2;45,0",
            "598,014.0\t6,643,213.2\t45.0",
            "598.014;6.643.213;45",
        ] {
            for table in [format!("{row}\n"), format!("X;Y;Z\n{row}\n"), format!("1;2;3\n{row}\n")] {
                let said = refused(&table);
                assert!(said.contains("marks between thousands: write the numbers without them"), "{said}");
            }
        }
        for head in ["", "X,Y,Z\n"] {
            let said = refused(&format!("{head}\"598014,002\",\"6643213,291\",\"45,057\"\n"));
            assert!(said.contains("commas within quotes") && said.contains("semicolons"), "{said}");
        }
        assert_eq!(read_all("cloud.csv", "\"X\",\"Y\",\"Z\"\n\"1.5\",\"2\",\"3\"\n").expect("a table").0, 1);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("wide.xyz");
        for bytes in [
            "\u{feff}1 2 3\n".encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>(),
            "X Y Z\n1 2 3\n".encode_utf16().flat_map(u16::to_be_bytes).collect(),
        ] {
            std::fs::write(&path, bytes).expect("a file");
            let said = open(&path).err().expect("refused").to_string();
            assert!(said.contains("UTF-16: save it as text in UTF-8"), "{said}");
        }
    }

    /// Names of several languages, metres behind a name, classes and columns beside x, y and z.
    #[test]
    fn heads_of_other_programs() {
        for head in ["Rechtswert;Hochwert;Höhe", "X [m];Y [m];Z [m]", "est;nord;altitude", "E(m);N(m);H(m)"] {
            let (points, names) = read_all("table.csv", &format!("{head}\n1,5;2,5;3,5\n")).expect("a table");
            assert_eq!((points, names.join(" ").as_str()), (1, "x y z"), "{head}");
        }
        let latin_1 = b"Rechtswert;Hochwert;H\xf6he\n1;2;3\n";
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("latin.csv");
        std::fs::write(&path, latin_1).expect("a file");
        assert!(open(&path).is_ok());
        // X, Y and Z count before words that mean the same.
        let names = read_all("both.csv", "height,x,y,z\n1,2,3,4\n").expect("a table").1;
        assert_eq!(names, ["height", "x", "y", "z"]);
        let refused = |table: &str| read_all("table.csv", table).expect_err("refused").to_string();
        assert!(refused("x [ft],y [ft],z [ft]\n1,2,3\n").contains("no column `X` among x [ft]"));
        assert!(refused("name,x,y,z\nP1,1,2,3\n").contains("leave columns of words out"));
    }

    /// A head in a remark that names other columns than x, y and z is no reason to take the first three.
    #[test]
    fn columns_of_another_table_are_not_taken_for_coordinates() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lvis.txt");
        let rows = "1654935003 145 42504.0 311.2 69.4 1500.3\n1654935003 146 42504.1 311.3 69.4 1501.3\n";
        let error = |head: &str| {
            std::fs::write(&path, format!("# exported 2009\n{head}\n{rows}")).expect("a file");
            open(&path).map(|(header, _)| header.schema).err().map(|error| error.to_string())
        };
        let refused = error("# LFID SHOT TIME LONGITUDE_CENTROID LATITUDE_CENTROID ELEVATION_CENTROID");
        assert!(refused.is_some_and(|what| what.contains("LATITUDE_CENTROID")));
        assert_eq!(error("# six columns: height and latitude unknown"), None);
        assert_eq!(error("# points of a scanner that stood here"), None);
    }

    #[test]
    fn usual_rows_are_plain() {
        for line in ["1 2.5 -3e2\r\n", "1\t2.5\t -3e2 \n", "1,2.5,-3e2\n", " 1, 2.5 , -3e2"] {
            let mut raw = Vec::new();
            assert_eq!(plain_numbers(line.as_bytes(), &mut raw), Some(3), "{line}");
            assert_eq!(raw, [1.0, 2.5, -300.0_f64].map(f64::to_le_bytes).concat(), "{line}");
        }
        for line in ["1;2;3", "1,5\t2,5\t3,5", "1,2,3,", "1 2,3", "1,2 3", "\u{feff}1 2 3", "nan 1 2", "1..2", "1,,2"] {
            assert_eq!(plain_numbers(line.as_bytes(), &mut Vec::new()), None, "{line}");
        }
    }
}
