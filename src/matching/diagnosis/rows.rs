//! Single rows: points without a mark where they are listed, but with one where a slip of the pen would have put them.

use std::f64::consts::PI;

use super::{Certainty, Diagnosis, FOOT_M, GrossErrors, Mistake, POSSIBLE_LOG10, US_SURVEY_FOOT_M};
use crate::candidate::{Candidate, least_whole_area_px};
use crate::matching::Pattern;
use crate::matching::evidence::log10_tail;
use crate::matching::field::Field;
use crate::matching::settle::{centre_and_spread, tolerance_px};
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_solve::Pair;

/// Places of a digit that can be mistyped: 10^−1 m (smaller ones hide in the tolerance) to 10^6 m.
const PLACES: std::ops::RangeInclusive<i32> = -1..=6;
/// Mistakes of many rows alike that are tried: swapped, two kinds of feet, two zones.
const FAMILIES: f64 = 5.0;
/// The least that points are taken to deviate by, pixels: few may agree by luck, and centres of the scan are rough.
const LEAST_DEVIATION_PX: f64 = 0.3;
/// No candidate is closer to its GCP than this by merit, pixels.
const CLOSEST_PX: f64 = 1.0;

/// The marks that are left over, and where a point would have to be.
struct Rest<'a> {
    given: &'a GrossErrors<'a>,
    pattern: &'a Pattern,
    /// Marks no GCP of the pattern claims, as good as those that are claimed.
    field: Field,
    /// Of all candidates as good.
    density: f64,
    centre: PixelPoint,
    spread: f64,
    /// GCPs, control and check, that have no mark where they are listed.
    unexplained: Vec<usize>,
}

/// A repaired position that falls on a mark.
struct Hit {
    candidate: PixelPoint,
    distance_px: f64,
}

pub(super) fn diagnose(given: &GrossErrors<'_>, pattern: &Pattern) -> Vec<Diagnosis> {
    let Some(rest) = Rest::new(given, pattern) else { return Vec::new() };
    let mut told = rest.families();
    told.extend(rest.exchanged());
    told.extend(rest.digits(&told));
    told
}

impl<'a> Rest<'a> {
    fn new(given: &'a GrossErrors<'a>, pattern: &'a Pattern) -> Option<Self> {
        let pairs: Vec<Pair> = pattern
            .pairs
            .iter()
            .map(|&(c, g)| Pair {
                pixel: given.candidates[c].centre,
                covariance_px2: None,
                map: given.gcps[g].position(),
                survey_sigma_m: None,
            })
            .collect();
        if pairs.len() < 3 {
            return None;
        }
        let (centre, spread) = centre_and_spread(&pairs);
        // A mark worse than every one that was matched explains nothing.
        let worst = pattern.pairs.iter().filter_map(|&(c, _)| given.candidates[c].score).min_by(f64::total_cmp);
        let good = |score: Option<f64>| worst.is_none_or(|worst| score.is_none_or(|score| score >= worst));
        let used = |i: usize| pattern.pairs.iter().any(|&(c, _)| c == i);
        // Nor does a part of a mark, as a field of a chequer is.
        let least_area_px = least_whole_area_px(pattern.pairs.iter().map(|&(c, _)| &given.candidates[c]));
        let whole = |c: &Candidate| c.area_px.is_none_or(|area| area >= least_area_px);
        let left: Vec<PixelPoint> = (0..given.candidates.len())
            .filter(|&i| !used(i) && good(given.candidates[i].score) && whole(&given.candidates[i]))
            .map(|i| given.candidates[i].centre)
            .collect();
        if left.is_empty() {
            return None;
        }
        let size = given.priors.image_size_px.unwrap_or_else(|| {
            given.candidates.iter().fold((1.0f64, 1.0f64), |(w, h), c| (w.max(c.centre.x), h.max(c.centre.y)))
        });
        let count = left.len() as f64;
        let field = Field::new(left, Some(size));
        let density = count / field.area_px2();
        let mut rest = Rest { given, pattern, field, density, centre, spread, unexplained: Vec::new() };
        rest.unexplained = (0..given.gcps.len())
            .filter(|g| !pattern.pairs.iter().any(|(_, h)| h == g))
            .filter(|&g| rest.mark_at(given.gcps[g].position(), rest.stated_px(g)).is_none())
            .collect();
        Some(rest)
    }

    fn place(&self, position: MapPoint) -> Option<PixelPoint> {
        let p = self.pattern.similarity.invert(position);
        self.field.contains(p).then_some(p)
    }

    /// How far a point's mark may lie from its place by the point's own stated accuracy, pixels.
    fn stated_px(&self, gcp: usize) -> f64 {
        self.given.gcps[gcp].reach_m() / self.pattern.similarity.scale_m_per_px()
    }

    /// The same where the marks that fit are looked for within `by_others_px`; what is stated alone reaches no farther
    /// than chance seldom puts a candidate.
    fn with_stated(&self, by_others_px: f64, stated_px: f64) -> f64 {
        const CHANCE: f64 = 0.003;
        let by_chance_px = (CHANCE / (PI * self.density)).sqrt();
        by_others_px.max(by_others_px.hypot(stated_px).min(by_chance_px))
    }

    fn tolerance(&self, p: PixelPoint, stated_px: f64) -> f64 {
        let by_others_px =
            tolerance_px(self.pattern.noise_px.max(1.0), self.pattern.pairs.len(), self.centre, self.spread, p);
        self.with_stated(by_others_px, stated_px)
    }

    fn mark_at(&self, position: MapPoint, stated_px: f64) -> Option<Hit> {
        let p = self.place(position)?;
        let (index, distance_px) = self.field.nearest(p, self.tolerance(p, stated_px))?;
        Some(Hit { candidate: self.field.points()[index], distance_px })
    }

    /// The mark that a repaired row falls on. It must fit as the other points do: a mark is looked for generously, but
    /// a mistake that is undone leaves nothing over.
    fn repaired_at(&self, position: MapPoint, stated_px: f64) -> Option<Hit> {
        let p = self.place(position)?;
        let deviation_px = self.pattern.deviation_px.max(LEAST_DEVIATION_PX);
        let fits_px = tolerance_px(deviation_px, self.pattern.pairs.len(), self.centre, self.spread, p);
        self.mark_at(position, stated_px).filter(|hit| hit.distance_px <= self.with_stated(fits_px, stated_px))
    }

    /// Whether a mark lies no farther from where a point is listed than the stated accuracy allows: then nothing speaks
    /// for a slip.
    fn is_within_stated(&self, hit: &Hit, gcp: usize) -> bool {
        let p = self.pattern.similarity.invert(self.given.gcps[gcp].position());
        (hit.candidate.x - p.x).hypot(hit.candidate.y - p.y) < self.stated_px(gcp)
    }

    /// Chance of a mark that close to a place.
    fn chance(&self, hit: &Hit) -> f64 {
        let density = self.density.max(self.field.density_near(hit.candidate));
        -(-density * PI * hit.distance_px.max(CLOSEST_PX).powi(2)).exp_m1()
    }

    fn limit(&self) -> f64 {
        self.given.matcher.max_false_alarms.log10()
    }

    fn certainty(&self, log10: f64) -> Option<Certainty> {
        match log10 {
            l if l <= self.limit() => Some(Certainty::Claimed),
            l if l <= POSSIBLE_LOG10 => Some(Certainty::Possible),
            _ => None,
        }
    }

    fn name(&self, gcp: usize) -> String {
        self.given.gcps[gcp].name.clone()
    }

    /// Rows that suffer from the same mistake: the more of them fall on marks, the surer.
    fn families(&self) -> Vec<Diagnosis> {
        let mut families: Vec<(Mistake, String, Vec<MapPoint>)> = Vec::new();
        let of = |to: &dyn Fn(MapPoint) -> MapPoint| -> Vec<MapPoint> {
            self.given.gcps.iter().map(|g| to(g.position())).collect()
        };
        let scaled = |f: f64| of(&|p| MapPoint { easting: p.easting * f, northing: p.northing * f });
        families.push((
            Mistake::EastingNorthingSwapped,
            "easting and northing are swapped".into(),
            of(&|p| MapPoint { easting: p.northing, northing: p.easting }),
        ));
        families.push((Mistake::InternationalFeet, "the coordinates are in international feet".into(), scaled(FOOT_M)));
        families.push((
            Mistake::UsSurveyFeet,
            "the coordinates are in US survey feet".into(),
            scaled(US_SURVEY_FOOT_M),
        ));
        for (zone, gcps) in self.given.other_zones() {
            let positions = gcps.iter().map(crate::gcp::Gcp::position).collect();
            families.push((Mistake::WrongUtmZone, format!("the coordinates belong to {}", zone.title()), positions));
        }
        let mut told: Vec<Diagnosis> = Vec::new();
        for (mistake, what, positions) in families {
            let (mut probabilities, mut named) = (Vec::new(), Vec::new());
            for &gcp in &self.unexplained {
                let Some(p) = self.place(positions[gcp]) else { continue };
                let radius = self.tolerance(p, self.stated_px(gcp));
                let density = self.density.max(self.field.density_near(p));
                probabilities.push(-(-density * PI * radius * radius).exp_m1());
                if self.mark_at(positions[gcp], self.stated_px(gcp)).is_some() {
                    named.push(self.name(gcp));
                }
            }
            if named.is_empty() {
                continue;
            }
            let log10 = log10_tail(&probabilities, named.len()) + FAMILIES.log10();
            if let Some(certainty) = self.certainty(log10) {
                told.push(Diagnosis {
                    mistake,
                    certainty,
                    message: format!(
                        "{}: {what}; with that undone there is a mark where each must be",
                        named.join(", ")
                    ),
                    gcps: named,
                    log10_false_alarms: Some(log10),
                });
            }
        }
        told
    }

    /// Two rows of which eastings, or northings, changed places.
    fn exchanged(&self) -> Vec<Diagnosis> {
        let gcps = self.given.gcps;
        let n = self.unexplained.len();
        // Pairs of rows, and two columns.
        let tests = (n * n.saturating_sub(1)) as f64;
        let mut all: Vec<(f64, usize, usize)> = Vec::new();
        for (k, &i) in self.unexplained.iter().enumerate() {
            for &j in &self.unexplained[k + 1..] {
                let (a, b) = (gcps[i].position(), gcps[j].position());
                let mixed =
                    |east: MapPoint, north: MapPoint| MapPoint { easting: east.easting, northing: north.northing };
                // Both exchanges put the marks at the same two places; what differs is which row is at which. Names
                // cannot be seen, so they are one hypothesis.
                let stated_px = self.stated_px(i).max(self.stated_px(j));
                if let (Some(one), Some(other)) =
                    (self.repaired_at(mixed(b, a), stated_px), self.repaired_at(mixed(a, b), stated_px))
                    && one.candidate != other.candidate
                    && ![i, j].iter().any(|&gcp| [&one, &other].iter().any(|hit| self.is_within_stated(hit, gcp)))
                {
                    // P[product of two uniform numbers ≤ t] = t·(1 − ln t).
                    let product = self.chance(&one) * self.chance(&other);
                    all.push(((product * (1.0 - product.ln())).log10(), i, j));
                }
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut taken: Vec<usize> = Vec::new();
        let mut told = Vec::new();
        for (chance, i, j) in all {
            let log10 = chance + tests.log10();
            if let Some(certainty) = self.certainty(log10)
                && !taken.contains(&i)
                && !taken.contains(&j)
            {
                taken.extend([i, j]);
                told.push(Diagnosis {
                    mistake: Mistake::CoordinatesExchanged,
                    certainty,
                    gcps: vec![self.name(i), self.name(j)],
                    message: format!(
                        "{} and {}: their eastings (or northings) are exchanged; with that undone there is a mark where each must be",
                        self.name(i),
                        self.name(j)
                    ),
                    log10_false_alarms: Some(log10),
                });
            }
        }
        told
    }

    /// One wrong digit, or two neighbouring ones transposed, in one coordinate of a row.
    fn digits(&self, told: &[Diagnosis]) -> Vec<Diagnosis> {
        let explained = |gcp: usize| told.iter().any(|d| d.gcps.contains(&self.given.gcps[gcp].name));
        let mut tests = 0u64;
        let mut best: Vec<(f64, usize, Mistake, String)> = Vec::new();
        for &gcp in self.unexplained.iter().filter(|&&g| !explained(g)) {
            let p = self.given.gcps[gcp].position();
            for (column, value) in [("easting", p.easting), ("northing", p.northing)] {
                for (mistake, edited) in edits(value) {
                    let position = match column {
                        "easting" => MapPoint { easting: edited, ..p },
                        _ => MapPoint { northing: edited, ..p },
                    };
                    if self.place(position).is_none() {
                        continue;
                    }
                    tests += 1;
                    let hit = self.repaired_at(position, self.stated_px(gcp));
                    if let Some(hit) = hit.filter(|hit| !self.is_within_stated(hit, gcp)) {
                        let what = format!("with {column} {edited:.3} instead of {value:.3} there is a mark");
                        best.push((self.chance(&hit).log10(), gcp, mistake, what));
                    }
                }
            }
        }
        best.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut named: Vec<usize> = Vec::new();
        let mut diagnoses = Vec::new();
        for (chance, gcp, mistake, what) in best {
            let log10 = chance + (tests as f64).log10();
            let Some(certainty) = self.certainty(log10) else { continue };
            if named.contains(&gcp) {
                continue;
            }
            named.push(gcp);
            let slip = if mistake == Mistake::MistypedDigit { "a mistyped digit" } else { "two digits transposed" };
            let doubt = match certainty {
                Certainty::Claimed => String::new(),
                Certainty::Possible => format!(" (chance does the same in {})", one_of_lists(log10)),
            };
            diagnoses.push(Diagnosis {
                mistake,
                certainty,
                gcps: vec![self.name(gcp)],
                message: format!("{}: {slip}? {what}, as listed there is none{doubt}", self.name(gcp)),
                log10_false_alarms: Some(log10),
            });
        }
        diagnoses
    }
}

/// How rare something of the chance 10^`log10` is, in words.
fn one_of_lists(log10: f64) -> String {
    match 10f64.powf(-log10) {
        lists if lists < 1e6 => {
            let unit = 10f64.powf((lists.log10().floor() - 1.0).max(0.0));
            format!("one of {:.0} lists", (lists / unit).floor() * unit)
        }
        _ => "fewer than one of a million lists".to_owned(),
    }
}

/// Every value that differs by one digit, or by two neighbouring digits transposed.
fn edits(value: f64) -> Vec<(Mistake, f64)> {
    let digit = |place: i32| ((value.abs() / 10f64.powi(place) + 1e-6).floor() as i64).rem_euclid(10);
    // Digits before the number's first are not written, so not mistyped.
    let first = value.abs().max(1.0).log10().floor() as i32;
    let mut all = Vec::new();
    for place in PLACES.filter(|p| *p <= first) {
        let unit = 10f64.powi(place) * value.signum();
        // A first digit of 0 would not have been written.
        for other in (i64::from(place == first)..10).filter(|&d| d != digit(place)) {
            all.push((Mistake::MistypedDigit, value + (other - digit(place)) as f64 * unit));
        }
        if place < first && digit(place) != digit(place + 1) && (place + 1 < first || digit(place) != 0) {
            let change = (digit(place) - digit(place + 1)) as f64 * 9.0;
            all.push((Mistake::TransposedDigits, value + change * unit));
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chances_in_words() {
        for (log10, words) in
            [(-1.0, "one of 10 lists"), (-3.76, "one of 5700 lists"), (-9.0, "fewer than one of a million lists")]
        {
            assert_eq!(one_of_lists(log10), words);
        }
    }

    #[test]
    fn one_digit_or_two_neighbours_are_all_that_changes() {
        let written = |v: f64| format!("{v:.1}");
        let right = written(570_418.3);
        for (mistake, edited) in edits(570_418.3) {
            let edited = written(edited);
            let differing: Vec<usize> =
                (0..right.len()).filter(|&i| edited.as_bytes().get(i) != right.as_bytes().get(i)).collect();
            assert_eq!(edited.len(), right.len(), "{edited}");
            assert_eq!(differing.len(), if mistake == Mistake::MistypedDigit { 1 } else { 2 }, "{edited}");
        }
        assert!(edits(570_418.3).iter().any(|(m, v)| *m == Mistake::TransposedDigits && (v - 570_481.3).abs() < 1e-6));
        assert!(edits(-12.5).iter().any(|(_, v)| (v + 72.5).abs() < 1e-6));
    }
}
