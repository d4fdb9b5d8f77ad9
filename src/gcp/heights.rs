//! What lists write where no height is known.

use std::path::Path;

use crate::gcp::raw::RawPoint;
use crate::gcp::text;

/// Values of no ground: those that programs put for a value that is missing.
const MISSING: [f64; 4] = [-9_999.0, -99_999.0, -999_999.0, -32_768.0];
/// The largest numbers of single and double precision stand for nothing too.
const BEYOND_ALL: f64 = 1e30;

/// Whether a cell says in words that there is no height.
pub(super) fn says_none(text: &str) -> bool {
    const WORDS: [&str; 12] = ["nan", "-", "--", "---", "–", "n/a", "na", "#n/a", "null", "none", "nodata", "no data"];
    WORDS.contains(&text.trim().to_lowercase().as_str())
}

/// Whether a cell stands for no height, in words or as a number.
pub(super) fn stands_for_none(text: &str) -> bool {
    says_none(text) || text::number(text).is_some_and(is_missing)
}

fn is_missing(height: f64) -> bool {
    height.is_nan() || MISSING.contains(&height) || height.abs() >= BEYOND_ALL
}

/// Takes away heights that say that there is none, and says so.
pub(super) fn drop_missing(path: &Path, points: &mut [RawPoint], notes: &mut Vec<String>) {
    let mut dropped: Vec<(&str, f64)> = Vec::new();
    for point in points.iter_mut() {
        if let Some(height) = point.gcp.height.filter(|height| is_missing(*height)) {
            point.gcp.height = None;
            dropped.push((&point.place, height));
        }
    }
    let Some(&(first, height)) = dropped.first() else { return };
    let value = match height {
        _ if height.is_nan() => "no number".to_owned(),
        _ if height.abs() >= BEYOND_ALL => format!("{height:e}"),
        _ => height.to_string(),
    };
    let more = if dropped.len() > 1 { format!(" and {} more", dropped.len() - 1) } else { String::new() };
    notes.push(format!("{}: {first}{more}: {value} is taken for no height", path.display()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::Gcp;

    #[test]
    fn values_of_no_ground_are_no_heights() {
        let heights = [-9999.0, -99999.0, -32768.0, 1e38, -f64::from(f32::MAX), f64::NAN, -9999.5, -32.768, 0.0];
        let point = |height| RawPoint::bare(Gcp { height: Some(height), ..Gcp::control("P", 1.0, 2.0) }, "row 2");
        let mut points: Vec<RawPoint> = heights.map(point).into();
        let mut notes = Vec::new();
        drop_missing(Path::new("l.csv"), &mut points, &mut notes);
        let kept: Vec<f64> = points.iter().filter_map(|p| p.gcp.height).collect();
        assert_eq!(kept, [-9999.5, -32.768, 0.0]);
        assert_eq!(notes, ["l.csv: row 2 and 5 more: -9999 is taken for no height"]);
    }
}
