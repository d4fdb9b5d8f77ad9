//! A list as KOF, whose columns are narrow.

use super::Survey;

/// Letters of a name in KOF's columns.
pub(super) const KOF_NAME: usize = 10;

/// A number in at most so many columns, with as many of its decimals as fit. `None` when it does not fit.
pub(super) fn fitting(value: f64, width: usize) -> Option<String> {
    let exact = value.to_string();
    if exact.len() <= width {
        return Some(exact);
    }
    (0..width).rev().map(|decimals| format!("{value:.decimals$}")).find(|text| text.len() <= width)
}

/// Records "05" in the columns of the specification: name 5–14, northing 25–36, easting 38–48, height 50–57.
pub(super) fn write(survey: &Survey) -> String {
    let mut text = String::from(" 00 Oppdrag      Dato     Ver\n");
    for gcp in survey.gcps() {
        let name: String = gcp.name.chars().take(KOF_NAME).collect();
        let number = |value: f64, width: usize| fitting(value, width).unwrap_or_default();
        let height = gcp.height.map_or(String::new(), |h| number(h, 8));
        let row = format!(
            " 05 {name:<10}          {:>12} {:>11} {height:>8}",
            number(gcp.northing, 12),
            number(gcp.easting, 11)
        );
        text.push_str(&(row.trim_end().to_owned() + "\n"));
    }
    text
}
