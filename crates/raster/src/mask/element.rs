//! Structuring elements of morphology.

use serde::{Deserialize, Serialize};

/// Longest side of an element, pixels.
pub const LONGEST_SIDE_PX: usize = 129;

/// Which neighbours of a pixel count. The origin is the middle, column `width / 2`, row `height / 2`, and belongs to
/// it: without the pixel itself, the border of a picture would close onto itself.
///
/// In files it is its rows, `#` for what belongs to it and `.` for what does not: `[".#.", "###", ".#."]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<String>", into = "Vec<String>")]
pub struct Element {
    width: usize,
    set: Vec<bool>,
}

impl Element {
    /// From pixels, row by row.
    ///
    /// # Errors
    /// A sentence when it is no rectangle, is longer than [`LONGEST_SIDE_PX`], or lacks its origin.
    pub fn new(set: Vec<bool>, width: usize) -> Result<Element, String> {
        if width == 0 || set.is_empty() || !set.len().is_multiple_of(width) {
            return Err("a structuring element is a rectangle of pixels".into());
        }
        let height = set.len() / width;
        if width.max(height) > LONGEST_SIDE_PX {
            return Err(format!(
                "a structuring element has at most {LONGEST_SIDE_PX} px a side, not {width} × {height}"
            ));
        }
        let element = Element { width, set };
        if !element.steps().any(|step| step == (0, 0)) {
            return Err("the middle pixel of a structuring element belongs to it".into());
        }
        Ok(element)
    }

    /// All pixels whose centres are within `radius_px` of the origin's.
    pub fn disc(radius_px: u32) -> Element {
        let r = i64::from(radius_px);
        let set = (-r..=r).flat_map(|y| (-r..=r).map(move |x| x * x + y * y <= r * r)).collect();
        Element { width: 2 * radius_px as usize + 1, set }
    }

    fn origin(&self) -> (i64, i64) {
        ((self.width / 2) as i64, (self.set.len() / self.width / 2) as i64)
    }

    /// Columns and rows from the origin of all that belongs to it.
    pub fn steps(&self) -> impl Iterator<Item = (i64, i64)> + '_ {
        let (x, y) = self.origin();
        let place = move |i: usize| ((i % self.width) as i64 - x, (i / self.width) as i64 - y);
        (0..self.set.len()).filter(|&i| self.set[i]).map(place)
    }

    /// How far it reaches from the origin, pixels.
    pub fn reach_px(&self) -> u64 {
        self.steps().map(|(x, y)| x.unsigned_abs().max(y.unsigned_abs())).max().unwrap_or(0)
    }
}

impl TryFrom<Vec<String>> for Element {
    type Error = String;

    fn try_from(rows: Vec<String>) -> Result<Element, String> {
        let width = rows.first().map_or(0, |row| row.chars().count());
        let mut set = Vec::new();
        for (number, row) in (1..).zip(&rows) {
            if row.chars().count() != width {
                return Err(format!("row {number} of the structuring element is not as long as the first"));
            }
            for sign in row.chars() {
                match sign {
                    '#' => set.push(true),
                    '.' => set.push(false),
                    other => return Err(format!("`{other}` in a structuring element: it is made of # and .")),
                }
            }
        }
        Element::new(set, width)
    }
}

impl From<Element> for Vec<String> {
    fn from(element: Element) -> Vec<String> {
        let sign = |set: &bool| if *set { '#' } else { '.' };
        element.set.chunks(element.width).map(|row| row.iter().map(sign).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_read_back_and_wrong_ones_are_refused() {
        let rows = |rows: &[&str]| rows.iter().map(|r| (*r).to_string()).collect::<Vec<_>>();
        let hook = Element::try_from(rows(&["##.", "##."])).expect("an element");
        assert_eq!(Vec::<String>::from(hook.clone()), rows(&["##.", "##."]));
        assert_eq!(hook.steps().collect::<Vec<_>>(), [(-1, -1), (0, -1), (-1, 0), (0, 0)]);
        assert_eq!(hook.reach_px(), 1);
        for wrong in [&["#.", "#"][..], &["..", ".."], &["##", "#."], &["#x"], &[]] {
            assert!(Element::try_from(rows(wrong)).is_err(), "{wrong:?}");
        }
        assert!(Element::try_from(vec!["#".repeat(130)]).is_err());
        assert_eq!(Element::disc(2).steps().count(), 13);
    }
}
