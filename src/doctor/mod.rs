//! The blunder doctor: which classic mistake in a list of GCPs makes it fit?
//!
//! Nothing here changes a result. A diagnosis is a sentence for a person, with the evidence for it: a whole list that is
//! wrong in one way ([`list`]: axes swapped, mirrored image, feet) is tried when nothing fits; single points that are wrong
//! ([`point`]: a mistyped digit, swapped or exchanged coordinates, exchanged labels) and lists in the wrong place
//! ([`place`]: UTM zone, feet, distances on the ground instead of the grid) are looked for when the rest fits.
//!
//! ```
//! use autoref_stream::doctor::{Axis, Diagnosis, Mistake};
//!
//! let mistake = Mistake::MistypedDigit { gcp: "P7".into(), axis: Axis::Northing, listed: 7_032_563.94, fits: 7_032_536.94 };
//! let diagnosis = Diagnosis::new(mistake, -3.2);
//! assert!(diagnosis.sentence.starts_with("P7: the northing 7032563.940 would fit as 7032536.940"));
//! ```

pub mod list;
pub mod place;
pub mod point;

use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::gcp::Gcp;
use crate::georef::crs::Crs;
use crate::matching::{Matcher, Priors};
use crate::pipeline::georeference::Outcome;

pub use list::diagnose_list;
pub use place::{OwnGeoreference, diagnose_place};
pub use point::{Fitted, diagnose_labels, diagnose_points};

/// A classic mistake. What is listed stays listed: nothing is corrected.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "mistake", rename_all = "kebab-case")]
pub enum Mistake {
    /// Easting and northing of the whole list.
    SwappedAxes,
    /// Left and right of the image.
    MirroredImage,
    /// One of the two; local coordinates do not tell which.
    SwappedAxesOrMirroredImage,
    /// The list is in feet and was taken for metres. `survey` tells US survey from international feet, where the place
    /// of the image does.
    FeetForMetres { survey: Option<bool> },
    /// The list is in metres and was taken for feet, or the ground sample distance is in feet.
    MetresForFeet,
    /// Names of two points, told from names that the candidates carry.
    ExchangedLabels { gcps: [String; 2] },
    /// One coordinate of two points.
    ExchangedCoordinates { gcps: [String; 2] },
    /// Easting and northing of one point.
    SwappedAxesOfPoint { gcp: String },
    /// One digit, or two neighbouring digits turned round.
    MistypedDigit { gcp: String, axis: Axis, listed: f64, fits: f64 },
    /// The coordinates are of another zone than stated.
    WrongZone { listed: String, fits: String },
    /// The list has distances on the ground, the image those of the grid, or the other way round.
    GridToGround { factor: f64 },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    Easting,
    Northing,
}

/// A mistake and what speaks for it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    #[serde(flatten)]
    pub mistake: Mistake,
    /// For a person: what it is and what to do.
    pub sentence: String,
    /// log₁₀ of the number of such findings that chance would produce.
    pub log10_false_alarms: f64,
}

impl Diagnosis {
    pub fn new(mistake: Mistake, log10_false_alarms: f64) -> Diagnosis {
        Diagnosis { sentence: sentence(&mistake), mistake, log10_false_alarms }
    }
}

/// What a run knows when it is over.
pub struct Case<'a> {
    pub candidates: &'a [Candidate],
    /// Names that the candidates carry, by index; empty when they carry none.
    pub labels: &'a [Option<String>],
    pub gcps: &'a [Gcp],
    /// Of the list.
    pub crs: Option<&'a Crs>,
    pub matcher: &'a dyn Matcher,
    /// The strongest that were tried.
    pub priors: &'a Priors,
    pub own: Option<&'a OwnGeoreference>,
}

/// Everything that can be said about the list, given what came of the run. Check points are looked at too.
pub fn diagnose(case: &Case<'_>, outcome: &Outcome) -> Vec<Diagnosis> {
    let orientation = match outcome {
        Outcome::Refused(_) => {
            return diagnose_list(case.candidates, case.gcps, case.crs, case.matcher, case.priors);
        }
        Outcome::Solved(orientation) => orientation,
    };
    let place = |gcp: usize| {
        let found = orientation.marks.iter().chain(&orientation.check_marks).find(|mark| mark.gcp == gcp)?;
        case.candidates.iter().position(|candidate| candidate.centre == found.mark.centre)
    };
    // A mark of the second look is no candidate of the scan, but its GCP has one.
    let found = |gcp: usize| orientation.marks.iter().chain(&orientation.check_marks).any(|mark| mark.gcp == gcp);
    let pairs: Vec<(Option<usize>, usize)> =
        (0..case.gcps.len()).filter(|gcp| found(*gcp)).map(|gcp| (place(gcp), gcp)).collect();
    let fitted = Fitted {
        similarity: orientation.solution.similarity,
        noise_px: orientation.evidence.pattern.noise_px,
        pairs: &pairs,
        image_size_px: case.priors.image_size_px,
    };
    let mut all = diagnose_points(&fitted, case.candidates, case.gcps);
    all.extend(diagnose_labels(&pairs, case.labels, case.gcps));
    all.extend(list::diagnose_unit(orientation.solution.scale_m_per_px, case.priors));
    if let (Some(crs), Some(own)) = (case.crs, case.own) {
        let placed = diagnose_place(&orientation.solution, crs, own);
        // The place tells more about feet than the scale does.
        if placed.iter().any(|d| matches!(d.mistake, Mistake::FeetForMetres { .. })) {
            all.retain(|d| !matches!(d.mistake, Mistake::FeetForMetres { .. }));
        }
        all.extend(placed);
    }
    all
}

fn sentence(mistake: &Mistake) -> String {
    match mistake {
        Mistake::SwappedAxes => "easting and northing of the list are swapped: correct the columns".into(),
        Mistake::MirroredImage => "the image is mirrored: flip it (a scan from the wrong side of the film?)".into(),
        Mistake::SwappedAxesOrMirroredImage => {
            "the pattern fits mirrored: easting and northing of the list are swapped, or the image is mirrored".into()
        }
        Mistake::FeetForMetres { survey } => {
            let which = match survey {
                Some(true) => "US survey feet",
                Some(false) => "international feet",
                None => "feet",
            };
            format!("the list fits when its coordinates are {which}, not metres: convert them, or state the CRS in feet")
        }
        Mistake::MetresForFeet => {
            "the list fits when its coordinates are metres where feet are stated: check the unit of the CRS or of the ground sample distance".into()
        }
        Mistake::ExchangedLabels { gcps: [a, b] } => {
            format!("{a} and {b}: the mark called {a} lies at {b} and the other way round; the labels are exchanged")
        }
        Mistake::ExchangedCoordinates { gcps: [a, b] } => {
            format!("{a} and {b} would both fit with one coordinate exchanged between them: compare the rows with the survey")
        }
        Mistake::SwappedAxesOfPoint { gcp } => format!("{gcp}: would fit with easting and northing swapped"),
        Mistake::MistypedDigit { gcp, axis, listed, fits } => {
            let axis = match axis {
                Axis::Easting => "easting",
                Axis::Northing => "northing",
            };
            format!("{gcp}: the {axis} {listed:.3} would fit as {fits:.3}; a mistyped digit?")
        }
        Mistake::WrongZone { listed, fits } => {
            format!("the list says {listed}, but its coordinates lie where the image is only in {fits}: check the zone")
        }
        Mistake::GridToGround { factor } => format!(
            "the scale differs from the image's own by {factor:.6}, the grid's scale here: one is in distances on the ground, the other on the grid"
        ),
    }
}
