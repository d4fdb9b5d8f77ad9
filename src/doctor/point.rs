//! Mistakes in single points of a list that fits otherwise.
//!
//! A GCP without a mark where it must be, and a mark without a GCP, are one blunder away from each other when changing one
//! digit of the list brings them together. Candidates are many, so each finding is weighed like a match: the number of
//! alternatives that were looked at, times the chance that a false candidate lies there by accident.

use super::{Axis, Diagnosis, Mistake};
use crate::candidate::Candidate;
use crate::coords::{MapPoint, PixelPoint};
use crate::gcp::Gcp;
use crate::matching::field::Field;
use crate::solve::Similarity;

/// Findings that chance would produce this often in a correct list are not told.
const MAX_FALSE_ALARMS: f64 = 0.02;
/// How far from its place a mark may lie, in units of the noise.
const REACH_SIGMAS: f64 = 2.5;
/// Digits below are too close to the point's own place to be told from its neighbours.
const SMALLEST_DIGIT: i32 = 0;

/// A list that fits.
#[derive(Clone, Copy, Debug)]
pub struct Fitted<'a> {
    pub similarity: Similarity,
    /// 1σ of a coordinate of the pairs about the similarity, pixels.
    pub noise_px: f64,
    /// Index of the candidate, when the mark is one, and of the GCP.
    pub pairs: &'a [(Option<usize>, usize)],
    pub image_size_px: Option<(f64, f64)>,
}

/// A way in which coordinates may have been meant.
struct Alternative {
    mistake: Mistake,
    /// Where the points would be.
    places: Vec<MapPoint>,
}

/// Looks for one mistake in each GCP that has no mark.
pub fn diagnose_points(fitted: &Fitted<'_>, candidates: &[Candidate], gcps: &[Gcp]) -> Vec<Diagnosis> {
    let free = free_candidates(fitted, candidates);
    let size = fitted.image_size_px.or_else(|| extent(candidates));
    let field = Field::new(free, size);
    let radius_px = REACH_SIGMAS * fitted.noise_px.max(0.5);
    let unmatched: Vec<usize> = (0..gcps.len()).filter(|gcp| !fitted.pairs.iter().any(|p| p.1 == *gcp)).collect();
    let mut tests = Tests { fitted, field, radius_px, found: Vec::new() };
    // Each point without a mark, and all exchanges together, are given an equal share of the findings by chance.
    let shares = unmatched.len() as f64 + 1.0;
    for &gcp in &unmatched {
        tests.group(single(&gcps[gcp]), shares);
    }
    let others = |k: usize| unmatched[k + 1..].iter();
    let exchanges = (0..unmatched.len()).flat_map(|k| others(k).map(move |&other| (k, other)));
    tests.group(exchanges.map(|(k, other)| exchanged(&gcps[unmatched[k]], &gcps[other])).collect(), shares);
    tests.answer()
}

/// Candidates without a GCP that are not worse than the worst mark that has one.
fn free_candidates(fitted: &Fitted<'_>, candidates: &[Candidate]) -> Vec<PixelPoint> {
    let worst = fitted.pairs.iter().filter_map(|p| candidates[p.0?].score).min_by(f64::total_cmp);
    let worst = worst.unwrap_or(f64::NEG_INFINITY);
    (0..candidates.len())
        .filter(|i| !fitted.pairs.iter().any(|p| p.0 == Some(*i)))
        .filter(|&i| candidates[i].score.is_none_or(|score| score >= worst))
        .map(|i| candidates[i].centre)
        .collect()
}

fn extent(candidates: &[Candidate]) -> Option<(f64, f64)> {
    let most = |axis: fn(&Candidate) -> f64| candidates.iter().map(axis).max_by(f64::total_cmp);
    most(|c| c.centre.x).zip(most(|c| c.centre.y))
}

struct Tests<'a> {
    fitted: &'a Fitted<'a>,
    field: Field,
    radius_px: f64,
    /// Mistakes that would explain a mark, and how many such findings chance would produce.
    found: Vec<(Mistake, f64)>,
}

impl Tests<'_> {
    /// Looks at alternatives that count as one: each could have answered.
    fn group(&mut self, alternatives: Vec<Alternative>, shares: f64) {
        let mut expected = 0.0;
        let mut hits = Vec::new();
        for alternative in alternatives {
            if let Some((chance, hit)) = self.look(&alternative) {
                expected += chance;
                if hit {
                    hits.push(alternative.mistake);
                }
            }
        }
        self.found.extend(hits.into_iter().map(|mistake| (mistake, expected * shares)));
    }

    /// The chance that false candidates lie at all places of an alternative, and whether candidates do. `None` when a place
    /// is not in the image.
    fn look(&self, alternative: &Alternative) -> Option<(f64, bool)> {
        let predicted: Vec<PixelPoint> = alternative.places.iter().map(|p| self.fitted.similarity.invert(*p)).collect();
        if !predicted.iter().all(|p| self.field.contains(*p)) {
            return None;
        }
        let area = std::f64::consts::PI * self.radius_px * self.radius_px;
        let chance = predicted.iter().map(|p| -(-self.field.density_near(*p) * area).exp_m1()).product();
        let hits: Option<Vec<usize>> =
            predicted.iter().map(|p| self.field.nearest(*p, self.radius_px).map(|hit| hit.0)).collect();
        // One candidate explains one point.
        Some((chance, hits.is_some_and(|hits| hits.len() < 2 || hits[0] != hits[1])))
    }

    /// What is rarer than chance would have it. Two readings of one point say that neither is sure.
    fn answer(self) -> Vec<Diagnosis> {
        let points = |mistake: &Mistake| match mistake {
            Mistake::MistypedDigit { gcp, .. } | Mistake::SwappedAxesOfPoint { gcp } => vec![gcp.clone()],
            Mistake::ExchangedCoordinates { gcps } => gcps.to_vec(),
            _ => Vec::new(),
        };
        let clash = |a: &Mistake, b: &Mistake| points(a).iter().any(|p| points(b).contains(p));
        let rival = |i: usize| {
            let (mistake, false_alarms) = &self.found[i];
            let mut others = self.found.iter().enumerate().filter(|(j, _)| *j != i);
            others.any(|(_, (other, its))| clash(mistake, other) && *its <= 10.0 * false_alarms)
        };
        (0..self.found.len())
            .filter(|&i| self.found[i].1 <= MAX_FALSE_ALARMS && !rival(i))
            .map(|i| Diagnosis::new(self.found[i].0.clone(), self.found[i].1.max(1e-300).log10()))
            .collect()
    }
}

/// All that one slip makes of one point.
fn single(gcp: &Gcp) -> Vec<Alternative> {
    let mut all = vec![Alternative {
        mistake: Mistake::SwappedAxesOfPoint { gcp: gcp.name.clone() },
        places: vec![MapPoint { easting: gcp.northing, northing: gcp.easting }],
    }];
    for (axis, value) in [(Axis::Easting, gcp.easting), (Axis::Northing, gcp.northing)] {
        all.extend(slips(value).into_iter().map(|fits| Alternative {
            mistake: Mistake::MistypedDigit { gcp: gcp.name.clone(), axis, listed: value, fits },
            places: vec![match axis {
                Axis::Easting => MapPoint { easting: fits, northing: gcp.northing },
                Axis::Northing => MapPoint { easting: gcp.easting, northing: fits },
            }],
        }));
    }
    all
}

fn exchanged(a: &Gcp, b: &Gcp) -> Alternative {
    Alternative {
        mistake: Mistake::ExchangedCoordinates { gcps: [a.name.clone(), b.name.clone()] },
        places: vec![
            MapPoint { easting: b.easting, northing: a.northing },
            MapPoint { easting: a.easting, northing: b.northing },
        ],
    }
}

/// Values that differ from `value` in one digit, or in the order of two neighbouring digits, whole metres and above.
fn slips(value: f64) -> Vec<f64> {
    let places = (value.abs().max(1.0)).log10().floor() as i32;
    let digit = |place: i32| ((value.abs() / 10f64.powi(place)).floor() % 10.0) as i32;
    let shifted = |step: f64| value.signum() * (value.abs() + step);
    let mut all = Vec::new();
    for place in SMALLEST_DIGIT..=places {
        let unit = 10f64.powi(place);
        let here = digit(place);
        all.extend((0..10).filter(|d| *d != here).map(|d| shifted(f64::from(d - here) * unit)));
        let left = digit(place + 1);
        if place < places && left != here {
            all.push(shifted(f64::from(here - left) * (10.0 * unit - unit)));
        }
    }
    all
}

/// Labels that candidates carry, compared with the points that their pattern says they are.
pub fn diagnose_labels(pairs: &[(Option<usize>, usize)], labels: &[Option<String>], gcps: &[Gcp]) -> Vec<Diagnosis> {
    let labelled: Vec<(&str, &str)> = pairs
        .iter()
        .filter_map(|&(candidate, gcp)| Some((labels.get(candidate?)?.as_deref()?, gcps[gcp].name.as_str())))
        .collect();
    labelled
        .iter()
        .filter(|(label, name)| label < name && labelled.contains(&(name, label)))
        .map(|(label, name)| {
            let mistake = Mistake::ExchangedLabels { gcps: [label.to_string(), name.to_string()] };
            // Two names of n in each other's place, if names were drawn at random.
            let n = labelled.len() as f64;
            Diagnosis::new(mistake, -(n * (n - 1.0)).log10())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_of_a_number() {
        let all = slips(570_406.86);
        let has = |v: f64| all.iter().any(|s| (s - v).abs() < 1e-6);
        assert!(has(570_406.86 + 3.0) && has(570_416.86) && has(270_406.86), "one digit");
        assert!(has(750_406.86) && has(570_460.86), "two turned round");
        assert!(!has(570_406.86) && !has(570_417.86));
        assert_eq!(all.len(), 6 * 9 + 5);
        assert!(slips(-12.5).contains(&-21.5));
    }
}
