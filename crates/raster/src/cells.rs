//! Texts as cells of tables that a spreadsheet may open.

use std::borrow::Cow;

/// Whether a spreadsheet would take the text of a cell for a formula, also behind apostrophes, which would be taken for
/// [`no_formula`]'s.
fn is_formula(text: &str) -> bool {
    text.trim_start_matches('\'').starts_with(['=', '+', '-', '@', '\t', '\r'])
}

/// A text as a cell of a table that a spreadsheet may open: what begins like a formula gets an apostrophe in front,
/// which spreadsheets hide and [`without_apostrophe`] takes off again.
pub fn no_formula(text: &str) -> Cow<'_, str> {
    if is_formula(text) { Cow::Owned(format!("'{text}")) } else { Cow::Borrowed(text) }
}

/// The text of a cell that [`no_formula`] may have written.
pub fn without_apostrophe(cell: &str) -> &str {
    cell.strip_prefix('\'').filter(|text| is_formula(text)).unwrap_or(cell)
}

/// A field of a comma-separated table, quoted when it must be: also where a row that begins with it would be a remark,
/// or a file no table.
pub fn quoted(text: &str) -> String {
    let is_beginning = text.starts_with(['!', '{', '<']) || text.starts_with("//");
    if text.contains([',', '"', '\n', '\r', ';', '#']) || is_beginning || text != text.trim() {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_string()
    }
}

/// The same of a text that a spreadsheet may open, never a formula to it.
pub fn csv_text(text: &str) -> String {
    quoted(&no_formula(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_become_texts_and_come_back() {
        for name in ["=1+1", "-P1", "@x", "+49", "'=1", "''-2"] {
            let cell = no_formula(name);
            assert_eq!((&*cell, without_apostrophe(&cell)), (format!("'{name}").as_str(), name));
        }
        assert_eq!((&*no_formula("P-1"), without_apostrophe("'quoted'")), ("P-1", "'quoted'"));
    }
}
