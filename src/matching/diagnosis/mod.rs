//! The gross-error diagnosis: classic mistakes in a list of GCPs, tried when a pattern does not fit or leaves points
//! unexplained.
//!
//! A mistake is claimed only on the evidence that is asked of a match: the expected number of chance explanations as
//! good, over everything the diagnosis tries, must not exceed the matcher's limit. Weaker evidence, down to
//! [`POSSIBLE_LOG10`], is told as a possibility with its figure. Nothing is ever corrected.
//!
//! What shows which mistake (a similarity absorbs shift, rotation and, without a known ground sample distance, scale):
//!
//! | mistake | shows in |
//! |---|---|
//! | easting and northing swapped, mirrored image | the pattern, which fits only as its mirror image; the size of the numbers, the image's own georeference, the direction of north or, failing all, the smaller rotation tell which |
//! | feet for metres | the scale, when it is known; international or US survey feet (2 ppm apart): the place, when the image has one |
//! | wrong UTM zone, ground coordinates, leading digits left out | the place of the image, or for some points of the list the marks they would fall on |
//! | coordinates of two points exchanged, a mistyped digit | a mark where the repaired point would be, and none where it is listed |
//! | labels exchanged | marks that carry names ([`exchanged_labels`]): names take no part in finding the pattern |

mod place;
mod rows;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::gcp::{Gcp, GcpRole};
use crate::matching::{MatchOutcome, Matcher, Pattern, Priors, RobustMatcher};
use autoref_raster::coords::MapPoint;
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::units::{FOOT_M, US_SURVEY_FOOT_M};

/// Explanations that chance produces once in a hundred lists are mentioned as possible; rarer ones may be claimed.
pub const POSSIBLE_LOG10: f64 = -2.0;

/// A mistake that the diagnosis knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mistake {
    EastingNorthingSwapped,
    MirroredImage,
    /// Feet, of which the evidence does not tell the kind.
    Feet,
    InternationalFeet,
    UsSurveyFeet,
    /// The ground sample distance is in feet, or metres were declared to be feet.
    GsdInFeet,
    /// Eastings, or northings, of two points.
    CoordinatesExchanged,
    MistypedDigit,
    TransposedDigits,
    WrongUtmZone,
    /// Ground distances for grid distances, or the reverse.
    GridToGround,
    /// Leading digits of all coordinates are missing, or there are too many.
    LeadingDigits,
    LabelsExchanged,
}

/// How sure a diagnosis is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Certainty {
    /// Chance alone hardly explains it.
    Claimed,
    /// Worth a look; the figure says how often chance does the same.
    Possible,
}

/// A mistake that explains what was seen. Nothing was changed because of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    pub mistake: Mistake,
    pub certainty: Certainty,
    /// Names of the GCPs concerned; empty when it is the whole list.
    pub gcps: Vec<String>,
    /// One line: the mistake, what fits without it, what to do.
    pub message: String,
    /// log₁₀ of the expected number of explanations as good by chance; `None` where the evidence is a comparison with
    /// what the image says of itself, not a pattern.
    pub log10_false_alarms: Option<f64>,
}

impl Diagnosis {
    /// Whether it speaks against the whole list and chance hardly explains it: what follows from the list lies wrong.
    /// Exchanged axes and mirrored images are told, and leave the marks where they are.
    pub fn condemns_list(&self) -> bool {
        let is_told = matches!(self.mistake, Mistake::EastingNorthingSwapped | Mistake::MirroredImage);
        self.certainty == Certainty::Claimed && self.gcps.is_empty() && !is_told
    }
}

/// Where the image's own georeference puts its centre, in the metres of the list.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownPlace {
    pub centre: MapPoint,
    /// The same place in pixels.
    pub centre_px: autoref_raster::coords::PixelPoint,
}

/// What the diagnosis is told.
pub struct GrossErrors<'a> {
    pub candidates: &'a [Candidate],
    pub gcps: &'a [Gcp],
    pub priors: &'a Priors,
    /// System of the list.
    pub crs: Option<&'a Crs>,
    pub known: Option<KnownPlace>,
    pub matcher: RobustMatcher,
}

/// A whole-list mistake undone: the list as it would be, what is known then, and what it is called.
struct Attempt {
    mistake: Mistake,
    gcps: Vec<Gcp>,
    priors: Priors,
    note: String,
}

impl GrossErrors<'_> {
    /// Why nothing fits: mistakes of the whole list first; else single rows beside the best partial pattern.
    pub fn on_refusal(&self, best: Option<&Pattern>) -> Vec<Diagnosis> {
        let control = self.gcps.iter().filter(|g| g.role == GcpRole::Control).count();
        if self.candidates.len() < 3 || control < 3 {
            return Vec::new();
        }
        let attempts = self.attempts();
        let matcher = RobustMatcher {
            // Each attempt is one more chance for a false alarm; together they must not take long.
            tries: self.matcher.tries * (1.0 + attempts.len() as f64),
            budget_hypotheses: self.matcher.budget_hypotheses
                / RobustMatcher::later_part(self.gcps.len())
                / attempts.len() as u64,
            ..self.matcher.clone()
        };
        let fits = |attempt: &Attempt| match matcher.find(self.candidates, &attempt.gcps, &attempt.priors) {
            MatchOutcome::Solved(solved) => Some(self.whole_list(attempt, &solved.pattern)),
            MatchOutcome::NoMatch(_) => None,
        };
        if let Some(mistake) = attempts.par_iter().find_map_first(fits) {
            return vec![mistake];
        }
        // Beside a partial pattern the two together must be as rare as a match, and the row's own evidence must stand.
        best.map_or_else(Vec::new, |pattern| {
            let rows = rows::diagnose(self, pattern);
            rows.into_iter().filter(|d| self.rare_with(d, pattern)).collect()
        })
    }

    /// What a fit leaves unexplained: points without a mark, a scale or a place that contradicts the image's own.
    pub fn on_solution(&self, pattern: &Pattern) -> Vec<Diagnosis> {
        let mut all = place::diagnose(self, pattern);
        all.extend(rows::diagnose(self, pattern));
        all
    }

    fn rare_with(&self, diagnosis: &Diagnosis, pattern: &Pattern) -> bool {
        let own = diagnosis.log10_false_alarms.unwrap_or(0.0);
        pattern.log10_false_alarms + own <= self.matcher.max_false_alarms.log10()
    }

    fn attempts(&self) -> Vec<Attempt> {
        let mut attempts = Vec::new();
        // A mirrored image is the same pattern as a swapped list; a direction of north means nothing before it is known
        // which of them it is.
        attempts.push(Attempt {
            mistake: Mistake::EastingNorthingSwapped,
            gcps: self.moved(|p| MapPoint { easting: p.northing, northing: p.easting }),
            priors: Priors { rotation_deg: None, ..self.priors.clone() },
            note: String::new(),
        });
        // A scale known no better than the two units differ has had its chance.
        if self.priors.gsd_m_per_px.is_some_and(|(low, high)| high * FOOT_M < low) {
            for (mistake, factor) in [(Mistake::Feet, FOOT_M), (Mistake::GsdInFeet, 1.0 / FOOT_M)] {
                attempts.push(Attempt {
                    mistake,
                    gcps: self.moved(|p| MapPoint { easting: p.easting * factor, northing: p.northing * factor }),
                    priors: self.priors.clone(),
                    note: String::new(),
                });
            }
        }
        // Another zone turns the list by some degrees; only a sharp idea of north notices.
        if self.priors.rotation_deg.is_some_and(|(_, half)| half < 12.0) {
            for (zone, gcps) in self.other_zones() {
                let note = zone.title();
                attempts.push(Attempt { mistake: Mistake::WrongUtmZone, gcps, priors: self.priors.clone(), note });
            }
        }
        attempts
    }

    fn moved(&self, to: impl Fn(MapPoint) -> MapPoint) -> Vec<Gcp> {
        let moved = |gcp: &Gcp| {
            let p = to(gcp.position());
            Gcp { easting: p.easting, northing: p.northing, ..gcp.clone() }
        };
        self.gcps.iter().map(moved).collect()
    }

    /// The list as it would be if its numbers belonged to a neighbouring UTM zone, and that zone.
    fn other_zones(&self) -> Vec<(Crs, Vec<Gcp>)> {
        let Some(declared) = self.crs else { return Vec::new() };
        neighbours(declared)
            .into_iter()
            .filter_map(|zone| {
                let mut points: Vec<Coordinate> =
                    self.gcps.iter().map(|g| Coordinate { x: g.easting, y: g.northing, height: None }).collect();
                zone.transform(&mut points, declared, f64::INFINITY).ok()?;
                let mut gcps = self.gcps.to_vec();
                for (gcp, point) in gcps.iter_mut().zip(points) {
                    (gcp.easting, gcp.northing) = (point.x, point.y);
                }
                gcps.iter().all(|g| g.easting.is_finite() && g.northing.is_finite()).then_some((zone, gcps))
            })
            .collect()
    }

    fn whole_list(&self, attempt: &Attempt, pattern: &Pattern) -> Diagnosis {
        let fits = format!("the pattern fits then: {} GCPs have a mark", pattern.pairs.len());
        let (mistake, message) = match attempt.mistake {
            Mistake::EastingNorthingSwapped => self.swapped_or_mirrored(pattern, &fits),
            Mistake::Feet => (Mistake::Feet, self.feet(&fits)),
            Mistake::GsdInFeet => (
                Mistake::GsdInFeet,
                format!(
                    "the ground sample distance is given in feet, or a list in metres was declared to be in feet; {fits}"
                ),
            ),
            other => (
                other,
                format!("the coordinates belong to another UTM zone, {}; {fits}; give --crs accordingly", attempt.note),
            ),
        };
        Diagnosis {
            mistake,
            certainty: Certainty::Claimed,
            gcps: Vec::new(),
            message,
            log10_false_alarms: Some(pattern.log10_false_alarms),
        }
    }

    fn feet(&self, fits: &str) -> String {
        format!(
            "the coordinates are in feet where metres were expected (international or US survey: 2 ppm apart, which a pattern \
             does not show); {fits}; give a --crs that counts in the right feet"
        )
    }

    /// The pattern fits the swapped list, and so the mirror image: which of the two is the mistake?
    fn swapped_or_mirrored(&self, pattern: &Pattern, fits: &str) -> (Mistake, String) {
        // Turned the other way round from the swapped list, a flipped image stands at −90° − θ.
        let turned = pattern.similarity.rotation_deg();
        let flipped = -90.0 - turned;
        let off = |angle: f64, centre: f64| {
            let off = (angle - centre).rem_euclid(360.0);
            off.min(360.0 - off)
        };
        let centre = self.priors.rotation_deg.map_or(0.0, |(centre, _)| centre);
        // Lists that name the northing first are common, mirrored images are not: only one that lies straight is one.
        const STRAIGHT_DEG: f64 = 10.0;
        let swapped_likelier = off(turned, centre) <= off(flipped, centre) || off(flipped, centre) > STRAIGHT_DEG;
        let large = |v: f64| v.abs() >= 1e6;
        let (eastings, northings) = (
            self.gcps.iter().filter(|g| large(g.easting)).count(),
            self.gcps.iter().filter(|g| large(g.northing)).count(),
        );
        let n = self.gcps.len();
        // In most systems northings are the larger numbers, but not in all: the area of use of a known one decides.
        let fits_in = |swap: bool| {
            let at = |g: &Gcp| if swap { (g.northing, g.easting) } else { (g.easting, g.northing) };
            self.gcps.iter().map(at).all(|(e, n)| self.crs.and_then(|crs| crs.covers(e, n)) == Some(true))
        };
        let (swapped, sure) = match (eastings, northings, self.known) {
            _ if fits_in(true) != fits_in(false) => (fits_in(true), true),
            (e, 0, _) if e == n => (true, true),
            (0, m, _) if m == n => (false, true),
            (_, _, Some(known)) => {
                let away = |e: f64, n: f64| (e - known.centre.easting).hypot(n - known.centre.northing);
                let g = &self.gcps[pattern.pairs[0].1];
                (away(g.northing, g.easting) < away(g.easting, g.northing), true)
            }
            _ => (swapped_likelier, self.priors.rotation_deg.is_some_and(|(_, half)| half <= 45.0)),
        };
        let (mistake, what, remedy, other) = if swapped {
            (
                Mistake::EastingNorthingSwapped,
                "easting and northing are swapped in the list",
                "exchange the columns, or give them the titles northing and easting",
                "the image may be mirrored instead",
            )
        } else {
            (
                Mistake::MirroredImage,
                "the image is mirrored",
                "give --allow-mirrored, or flip it left to right",
                "easting and northing may be swapped in the list instead",
            )
        };
        let doubt = if sure { String::new() } else { format!(" ({other})") };
        (mistake, format!("{what}{doubt}; {fits}; {remedy}"))
    }
}

/// UTM zones beside that of `crs`, on the same datum.
fn neighbours(crs: &Crs) -> Vec<Crs> {
    let Some(code) = crs.label().strip_prefix("EPSG:").and_then(|code| code.parse::<u32>().ok()) else {
        return Vec::new();
    };
    let family = [32601..=32660, 32701..=32760, 25828..=25838, 26901..=26923].into_iter().find(|f| f.contains(&code));
    let Some(family) = family else { return Vec::new() };
    [code - 1, code + 1].into_iter().filter(|c| family.contains(c)).filter_map(|c| Crs::from_epsg(c).ok()).collect()
}

/// Marks that carry names against the pattern: labels of two marks exchanged, or one that names another GCP.
///
/// `labels`: index of a candidate and its name, for those that have one. A name that is in no GCP of the list is no
/// label.
pub fn exchanged_labels(labels: &[(usize, String)], pattern: &Pattern, gcps: &[Gcp]) -> Vec<Diagnosis> {
    let is_gcp = |name: &str| gcps.iter().any(|g| g.name == name);
    let odd: Vec<(&str, &str)> = labels
        .iter()
        .filter(|(_, name)| is_gcp(name))
        .filter_map(|(candidate, name)| {
            let &(_, gcp) = pattern.pairs.iter().find(|(c, _)| c == candidate)?;
            (gcps[gcp].name != *name).then_some((name.as_str(), gcps[gcp].name.as_str()))
        })
        .collect();
    let mut told: Vec<Diagnosis> = Vec::new();
    for &(label, truth) in &odd {
        let both_ways = odd.contains(&(truth, label));
        if both_ways && label > truth {
            continue;
        }
        let (gcps, message) = if both_ways {
            (
                vec![label.to_string(), truth.to_string()],
                format!("the labels of {label} and {truth} are exchanged; the pattern says which is which"),
            )
        } else {
            (vec![label.to_string()], format!("the mark labelled {label} is {truth} by the pattern"))
        };
        told.push(Diagnosis {
            mistake: Mistake::LabelsExchanged,
            certainty: Certainty::Claimed,
            gcps,
            message,
            log10_false_alarms: Some(pattern.log10_false_alarms),
        });
    }
    told
}
