//! Which GCP a coded target names.
//!
//! A code of number 17 names the GCP whose label's last digits are 17 ("17", "GCP17", "tag_017", "P-17b"): the last run
//! of digits, without leading zeros, when no other label of the list (check points included) has the same; the family
//! does not matter. Codes without such a label name nothing, and their marks are as free as paint.

use std::collections::HashMap;

use crate::candidate::Candidate;
use crate::gcp::Gcp;

/// What is named, but takes no part in the matching: a check point.
const NO_PART: usize = usize::MAX;

/// The number in which a label ends: its last run of digits. `None` without one, or beyond 32 bits.
///
/// ```
/// use autoref_stream::matching::number_of_label;
/// assert_eq!(number_of_label("GCP_2024-017b"), Some(17));
/// assert_eq!(number_of_label("north"), None);
/// ```
pub fn number_of_label(label: &str) -> Option<u32> {
    let head = label.trim_end_matches(|c: char| !c.is_ascii_digit());
    let start = head.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    head[start..].parse().ok()
}

/// Which GCP a number names.
#[derive(Clone, Debug, Default)]
pub struct Labels {
    /// Index in the list of GCPs; `None` when several labels end in the number.
    by_number: HashMap<u32, Option<usize>>,
}

impl Labels {
    pub fn new(gcps: &[Gcp]) -> Labels {
        let mut by_number = HashMap::new();
        for (i, number) in gcps.iter().enumerate().filter_map(|(i, g)| Some((i, number_of_label(&g.name)?))) {
            by_number.entry(number).and_modify(|known| *known = None).or_insert(Some(i));
        }
        Labels { by_number }
    }

    /// Index of the GCP that the candidate names.
    pub fn named_by(&self, candidate: &Candidate) -> Option<usize> {
        *self.by_number.get(&candidate.code.as_ref()?.number)?
    }
}

/// For every candidate of a search, the point of the search that it names.
#[derive(Clone, Debug)]
pub(super) struct Names {
    pub(super) of: Vec<Option<usize>>,
}

impl Names {
    /// `control`: indices in the list of GCPs of the points that take part. `None` when nothing is named.
    pub fn new(candidates: &[&Candidate], labels: &Labels, control: &[usize]) -> Option<Names> {
        let part = |gcp: usize| control.iter().position(|&c| c == gcp).unwrap_or(NO_PART);
        let of: Vec<Option<usize>> = candidates.iter().map(|c| labels.named_by(c).map(part)).collect();
        of.iter().any(Option::is_some).then_some(Names { of })
    }

    /// Whether the label of a candidate, if it has one, is this point's.
    #[inline]
    pub fn allow(&self, candidate: usize, gcp: usize) -> bool {
        self.of[candidate].is_none_or(|named| named == gcp)
    }

    /// Candidates that name a point of the search, with that point.
    pub(super) fn pairs(&self) -> impl Iterator<Item = (usize, usize)> + Clone {
        self.of.iter().enumerate().filter_map(|(c, g)| Some((c, (*g)?))).filter(|(_, g)| *g != NO_PART)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate::Code;
    use autoref_raster::coords::PixelPoint;

    #[test]
    fn labels_are_named_by_their_last_digits_when_they_are_the_only_ones() {
        for (label, number) in [("17", 17), ("GCP17", 17), ("tag_017", 17), ("P2-005", 5), ("A17b", 17), ("0", 0)] {
            assert_eq!(number_of_label(label), Some(number), "{label}");
        }
        for label in ["", "north", "99999999999", "é"] {
            assert_eq!(number_of_label(label), None, "{label}");
        }
        let gcps = ["GCP1", "P2", "X2", "c", "4"].map(|name| Gcp::control(name, 0.0, 0.0));
        let labels = Labels::new(&gcps);
        let named = |number: u32| {
            let code = Some(Code { family: "aruco-4x4-50".into(), number });
            let centre = PixelPoint { x: 0.0, y: 0.0 };
            let (covariance_px2, score, area_px, size_px, elevation_m) = (None, None, None, None, None);
            labels.named_by(&Candidate {
                centre,
                covariance_px2,
                score,
                area_px,
                size_px,
                elevation_m,
                code,
                paint: None,
            })
        };
        assert_eq!([1, 2, 3, 4].map(named), [Some(0), None, None, Some(4)]);
    }
}
