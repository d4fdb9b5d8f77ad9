//! What became of a frame, with the warnings that its shares give.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::bits::BitMask;
use crate::classify::Classes;
use crate::names::Names;
use crate::options::{Method, Options};
use crate::or_nothing::{self, or_nothing};
use crate::reduce::Reduced;
use crate::unlike::{Seen, UNLIKE_SHARE};

/// Whether a frame was masked in this run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    Done,
    /// An earlier run did, from the same: so is every report that is read.
    #[default]
    Unchanged,
}

impl Status {
    /// As the report and the terminal have it.
    pub fn name(self) -> &'static str {
        match self {
            Status::Done => "done",
            Status::Unchanged => "unchanged",
        }
    }
}

/// What became of a frame. Reports of older programs lack fields, and people edit them: what is not there or cannot be
/// read is as if nothing had been said, and the others hold.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Report {
    #[serde(serialize_with = "autoref_raster::path_text::one", deserialize_with = "or_nothing")]
    pub frame: PathBuf,
    #[serde(skip_deserializing)]
    pub status: Status,
    #[serde(deserialize_with = "or_nothing")]
    pub width: u64,
    #[serde(deserialize_with = "or_nothing")]
    pub height: u64,
    #[serde(deserialize_with = "or_nothing")]
    pub keep_share: f64,
    #[serde(deserialize_with = "or_nothing")]
    pub classes: Shares,
    /// Share of unsure pixels among those that the classifier decides: neither empty, nor of one level, nor spoken of.
    #[serde(deserialize_with = "or_nothing")]
    pub unsure_share: f64,
    /// Share of pixels far from all that was taught, among those looked at that the classifier decides (`auto`).
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "or_nothing")]
    pub unlike_share: Option<f64>,
    #[serde(deserialize_with = "or_nothing::texts")]
    pub warnings: Vec<String>,
    /// Where it is now, whatever an earlier report says.
    #[serde(serialize_with = "autoref_raster::path_text::one", skip_deserializing)]
    pub mask: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none", skip_deserializing)]
    #[serde(serialize_with = "autoref_raster::path_text::some")]
    pub probability: Option<PathBuf>,
    #[serde(deserialize_with = "or_nothing")]
    pub method: Method,
    #[serde(deserialize_with = "or_nothing")]
    pub reduce: Reduction,
    /// Names of the files that were written, in the folder of the masks.
    #[serde(deserialize_with = "or_nothing::texts")]
    pub outputs: Vec<String>,
    /// What they hold, but for this report: fingerprints by name.
    #[serde(deserialize_with = "or_nothing::texts_by_name")]
    pub contents: BTreeMap<String, String>,
    #[serde(deserialize_with = "or_nothing")]
    pub fingerprint: String,
}

/// How many pixels of the frame, along a side, are one of the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reduction(pub usize);

impl Default for Reduction {
    /// Of the thesis.
    fn default() -> Self {
        Reduction(4)
    }
}

/// Shares of the frame's pixels.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Shares {
    #[serde(deserialize_with = "or_nothing")]
    pub keep: f64,
    #[serde(deserialize_with = "or_nothing")]
    pub mask: f64,
    /// Pixels that hold nothing; they are masked.
    #[serde(deserialize_with = "or_nothing")]
    pub empty: f64,
}

/// The report of a frame that was masked; what is written comes to it later.
pub(crate) fn report(
    frame: &Path,
    names: &Names,
    reduced: &Reduced,
    classes: &Classes,
    options: &Options,
    fingerprint: String,
) -> Report {
    let (keep, unsure) = (classes.keep.share(), unsure_share(classes));
    let unlike = classes.seen.as_ref().map(Seen::share);
    let empty = 1.0 - reduced.valid.share();
    let mut warnings = Vec::new();
    if keep < 0.02 {
        warnings.push("almost everything is masked".to_string());
    } else if keep > 0.995 {
        warnings.push("almost nothing is masked".to_string());
    }
    if unsure > 0.15 {
        warnings.push(format!(
            "unsure about {:.0} % of what is not masked for certain; teach it with --sample or --teach",
            100.0 * unsure
        ));
    }
    if let Some(unlike) = unlike.filter(|share| *share > UNLIKE_SHARE) {
        warnings.push(format!(
            "this frame is unlike all teaching frames: {:.0} % of it look like nothing that was taught; teach one of its flight \
             with --teach",
            100.0 * unlike
        ));
    }
    if let Some(share) = classes.kept_though_even.filter(|share| *share > EVEN_SHARE) {
        warnings.push(format!(
            "an even area along the upper border is kept, {:.0} % of the frame: if it is sky, teach it with --sample or \
             --teach",
            100.0 * share
        ));
    }
    if let Some(row) = horizon(&classes.keep) {
        warnings.push(format!("horizon found: nothing is kept above row {}", row * reduced.factor));
    }
    Report {
        frame: frame.into(),
        status: Status::Done,
        width: reduced.width,
        height: reduced.height,
        keep_share: keep,
        classes: Shares { keep, mask: (1.0 - keep - empty).max(0.0), empty },
        unsure_share: unsure,
        unlike_share: unlike,
        warnings,
        mask: names.mask.clone(),
        probability: classes.probability.as_ref().map(|_| names.probability.clone()),
        method: options.method,
        reduce: Reduction(reduced.factor),
        outputs: names.written(options, classes.probability.is_some()),
        contents: BTreeMap::new(),
        fingerprint,
    }
}

/// Share of unsure pixels among those that the classifier decides.
fn unsure_share(classes: &Classes) -> f64 {
    let count = |mask: &Option<BitMask>| mask.as_ref().map_or(0, BitMask::count) as f64;
    count(&classes.unsure) / count(&classes.decided).max(1.0)
}

/// Kept in an even area along the upper border: a greater share of the frame is warned of.
const EVEN_SHARE: f64 = 0.1;

/// The first row with ground, when at least a twentieth of the rows above hold none and most columns begin so. Ground
/// under a sky reaches both sides of the frame; a margin all around does not let it.
fn horizon(keep: &BitMask) -> Option<usize> {
    let count = |y: usize| -> u32 { keep.row(y).iter().map(|word| word.count_ones()).sum() };
    let first = (0..keep.height()).find(|&y| count(y) > 0)?;
    let below: u64 = (first..keep.height()).map(|y| u64::from(count(y))).sum();
    let ground = below as f64 / (keep.width() * (keep.height() - first)) as f64;
    let margin = keep.width() / 50;
    let reaches =
        |columns: std::ops::Range<usize>| (first..keep.height()).any(|y| columns.clone().any(|x| keep.get(x, y)));
    let sides = reaches(0..margin + 1) && reaches(keep.width() - margin - 1..keep.width());
    (first * 20 >= keep.height() && ground > 0.2 && sides).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_border_of_one_level_does_not_dilute_what_is_unsure() {
        // Of eight columns four are black; two of the others are unsure.
        let classes = Classes {
            keep: BitMask::new(8, 3),
            unsure: Some(BitMask::from_fn(8, 3, |x, _| x < 2)),
            decided: Some(BitMask::from_fn(8, 3, |x, _| x < 4)),
            probability: None,
            seen: None,
            kept_though_even: None,
        };
        assert_eq!(unsure_share(&classes), 0.5);
        let nothing = Classes { unsure: None, decided: None, ..classes };
        assert_eq!(unsure_share(&nothing), 0.0);
    }
}
