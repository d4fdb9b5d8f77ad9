//! A profile taught by examples: marks that somebody points at or outlines, or the paint's colours alone.

mod colour_table;
mod colours;
mod example;
mod statistics;

use crate::candidate::Gates;
use crate::candidate::pixel_set::PixelSet;
use crate::candidate::split::score_of;
use crate::profile::colour::{Cloud, Metric, Space, lab_from_srgb};
use crate::profile::mixing::cloud;
use crate::profile::{
    CloudSpec, ColourModel, Density, Examine, Filters, GateLimits, Learned, Profile, RoughBox, Shape, Size, Target,
};
use crate::segment::classify::Classifier;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_raster::ranks::median;
use autoref_raster::words::counted;
use autoref_raster::{FewBits, Patch, SampleType};
use example::{Example, example, outlined};

pub use colour_table::{ColourTable, ColourValues, read_colours};
pub use colours::{LIKE_THE_OTHERS, apart_from_paint, learn_colours};
pub use statistics::{ColourStatistics, SampleStatistics};

/// How far around a position a patch should reach when the size of the marks is not known.
pub const DEFAULT_REACH_PX: u64 = 40;

/// How far around an outlined mark its patch must reach.
pub const OUTLINE_REACH_PX: u64 = example::RING_PX as u64 + 2;

/// How the rough box in RGB follows from the paint's pixels; one value for each band.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RoughRule {
    /// The middle share of the values, 1 being smallest to largest. The prototype's `min-max` with a percentile of 25 %
    /// is 0.75.
    Middle([f64; 3]),
    /// Mean ± so many standard deviations: the prototype's `mean-std` with its weights.
    Sigma([f64; 3]),
}

impl RoughRule {
    fn of(self, paint: &[[f64; 3]]) -> Result<RoughBox> {
        let sound = match self {
            RoughRule::Middle(shares) => shares.iter().all(|share| *share > 0.0 && *share <= 1.0),
            RoughRule::Sigma(weights) => weights.iter().all(|k| *k > 0.0 && k.is_finite()),
        };
        if !sound {
            return Err(Error::usage(
                format!("the rough box {self:?} holds nothing"),
                "give a share above 0 and at most 1, or a positive number of standard deviations",
            ));
        }
        let range = |band: usize| {
            let mut values: Vec<f64> = paint.iter().map(|c| c[band]).collect();
            values.sort_by(f64::total_cmp);
            match self {
                RoughRule::Middle(shares) => {
                    let at = |q: f64| values[((values.len() - 1) as f64 * q).round() as usize];
                    (at((1.0 - shares[band]) / 2.0), at((1.0 + shares[band]) / 2.0))
                }
                RoughRule::Sigma(weights) => {
                    let (mean, sd) = mean_and_deviation(&values);
                    (mean - weights[band] * sd, mean + weights[band] * sd)
                }
            }
        };
        let ranges = [range(0), range(1), range(2)];
        Ok(RoughBox { low: ranges.map(|r| r.0), high: ranges.map(|r| r.1) })
    }
}

/// What else a lesson may give.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LearnOptions {
    pub rough_box: Option<RoughRule>,
    /// Kernel densities, with the prototype's limits: least probability 1e-7, less than 25 % of zeros.
    pub density: bool,
}

/// Values that a density keeps of each axis.
const DENSITY_SAMPLES: usize = 200;

/// Densities of L\*, a\*, b\*: quantiles of the paint, with B. W. Silverman's bandwidth 1.06·σ·n^(−1/5) (Density
/// Estimation for Statistics and Data Analysis, 1986, eq. 3.28).
fn density(paint: &[[f64; 3]]) -> Density {
    let axis = |axis: usize| {
        let mut values: Vec<f64> = paint.iter().map(|c| lab_from_srgb(*c)[axis]).collect();
        values.sort_by(f64::total_cmp);
        let (_, sd) = mean_and_deviation(&values);
        let kept = values.len().min(DENSITY_SAMPLES);
        let samples: Vec<f64> = (0..kept).map(|k| values[(2 * k + 1) * values.len() / (2 * kept)]).collect();
        // Of paint without any variation, a tenth of a unit.
        (samples, (1.06 * sd * (values.len() as f64).powf(-0.2)).max(0.1))
    };
    let [l, a, b] = [axis(0), axis(1), axis(2)];
    let bandwidth = [l.1, a.1, b.1];
    Density { samples: [l.0, a.0, b.0], bandwidth, min_probability: 1e-7, max_zero_share: 0.25 }
}

fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt())
}

/// Learns a profile from marks at known positions (each inside its patch, which should reach [`DEFAULT_REACH_PX`]
/// around it).
///
/// The paint is what is connected to the position and lies nearer to the colour there than to the ground on the patch's
/// border, seen along the direction that separates the two best. The colour limit is 3.5 standard deviations, less when
/// the ground is nearer than that, but never below what holds 95 % of the examples' own pixels.
///
/// # Errors
/// [`Error::Usage`] naming the position when it is outside its patch, on nodata, or does not stand out from its
/// surroundings; or when there are no positions.
pub fn learn(name: &str, marks: &[(Patch, PixelPoint)]) -> Result<Profile> {
    learn_with(name, marks, &LearnOptions::default()).map(|lesson| lesson.profile)
}

/// [`learn`], with the parts of the 2016 prototype's colour model that need samples (Script A.9): a rough box in RGB,
/// and kernel densities.
///
/// # Errors
/// Those of [`learn`]; [`Error::Usage`] for a rule that leaves no box.
pub fn learn_with(name: &str, marks: &[(Patch, PixelPoint)], options: &LearnOptions) -> Result<Lesson> {
    if marks.is_empty() {
        return Err(Error::usage("no mark to learn from", "give at least one position with --at x,y"));
    }
    let examples: Vec<Example> = marks
        .iter()
        .map(|(patch, at)| {
            example(patch, *at).map_err(|why| {
                let remedy = match FewBits::of_patch(patch) {
                    Some(dark) => format!("{dark}; else point at the middle of a mark"),
                    None => "point at the middle of a mark".into(),
                };
                Error::usage(format!("the mark at {:.1},{:.1} {why}", at.x, at.y), remedy)
            })
        })
        .collect::<Result<_>>()?;
    let patches: Vec<&Patch> = marks.iter().map(|(patch, _)| patch).collect();
    from_examples(name, &patches, &examples, options)
}

/// A mark whose pixels somebody outlined.
#[derive(Clone, Debug)]
pub struct Outlined {
    pub name: String,
    /// Reaches [`OUTLINE_REACH_PX`] around the mark where the image does.
    pub patch: Patch,
    /// The mark's pixels, row by row of the patch.
    pub own: Vec<bool>,
    /// Those of all outlined marks in the patch.
    pub all: Vec<bool>,
}

/// Learns a profile from outlined marks: their pixels are the paint, what is around them the ground.
///
/// # Errors
/// [`Error::Usage`] naming the mark that holds no pixel or has no ground around it; when there is none; for a rule that
/// leaves no box.
pub fn learn_outlined(name: &str, marks: &[Outlined], options: &LearnOptions) -> Result<Lesson> {
    if marks.is_empty() {
        return Err(Error::usage("no mark is outlined", "give a mask or polygons that hold at least one"));
    }
    let examples: Vec<Example> = marks
        .iter()
        .map(|mark| {
            let set = |pixels: &[bool]| PixelSet::of(pixels, mark.patch.window.width as usize);
            outlined(&mark.patch, &set(&mark.own), &set(&mark.all)).map_err(|why| {
                Error::usage(format!("the mark {} {why}", mark.name), "outline marks inside the image, not its ground")
            })
        })
        .collect::<Result<_>>()?;
    let patches: Vec<&Patch> = marks.iter().map(|mark| &mark.patch).collect();
    from_examples(name, &patches, &examples, options)
}

/// What was learned, and from which colours.
#[derive(Clone, Debug)]
pub struct Lesson {
    pub profile: Profile,
    /// sRGB 0..=1 of all pixels of paint.
    pub paint: Vec<[f64; 3]>,
}

fn from_examples(name: &str, patches: &[&Patch], examples: &[Example], options: &LearnOptions) -> Result<Lesson> {
    let paint: Vec<[f64; 3]> = examples.iter().flat_map(|e| e.paint.iter().copied()).collect();
    let (spec, shape) = widened(&paint)?;
    let mut own: Vec<f64> = paint.iter().map(|c| shape.distance2(&lab_from_srgb(*c)).sqrt()).collect();
    let mut back: Vec<f64> =
        examples.iter().flat_map(|e| e.ground.iter()).map(|c| shape.distance2(&lab_from_srgb(*c)).sqrt()).collect();
    own.sort_by(f64::total_cmp);
    back.sort_by(f64::total_cmp);
    let near = back[back.len() / 100];
    let limit = near.min(3.5).max(own[own.len() * 95 / 100]);
    let mut sides: Vec<f64> = examples.iter().map(|e| e.side_px).collect();
    sides.sort_by(f64::total_cmp);
    let (small, large) = (sides[0], sides[sides.len() - 1]);
    let mean_srgb = std::array::from_fn(|c| paint.iter().map(|v| v[c]).sum::<f64>() / paint.len() as f64);
    let share = back.iter().filter(|d| **d <= limit).count() as f64 / back.len() as f64;
    let mut profile = Profile {
        name: name.to_owned(),
        description: format!("Learned from {}", counted(examples.len(), "mark", "marks")),
        shape: Shape::Any,
        colour: ColourModel {
            space: Space::Lab,
            metric: Metric::Mahalanobis,
            limit,
            rough_box: options.rough_box.map(|rule| rule.of(&paint)).transpose()?,
            rough: None,
            clouds: vec![spec],
        },
        size: Size { min_px: Some(0.6 * small), max_px: Some(1.6 * large), min_m: None, max_m: None },
        gates: GateLimits::default(),
        filters: Filters::default(),
        examine: Examine { split: true, ..Examine::default() },
        target: Target::default(),
        tag: None,
        learned: Some(Learned {
            marks: examples.len() as u64,
            pixels: paint.len() as u64,
            mean_srgb,
            side_px_min: small,
            side_px_median: median(sides),
            side_px_max: large,
            eccentricity_max: examples.iter().map(|e| e.eccentricity).fold(0.0, f64::max),
            tightness_min: examples.iter().map(|e| e.tightness).fold(1.0, f64::min),
            background_distance_p01: near,
            background_share: share,
        }),
    };
    profile.examine.density = options.density.then(|| density(&paint));
    profile.validate()?;
    profile.examine.min_score = least_score(&profile, patches, examples)?;
    Ok(Lesson { profile, paint })
}

/// The cloud of the paint in L\*a\*b\*, and its distances. The next mark lies in other light: at least 4 units of
/// lightness and 2.5 of each chroma axis are added.
fn widened(paint: &[[f64; 3]]) -> Result<(CloudSpec, Cloud)> {
    let mut spec = cloud(paint);
    for (axis, least) in [4.0f64, 2.5, 2.5].into_iter().enumerate() {
        spec.covariance[axis][axis] += least * least;
    }
    let shape = Cloud::new(spec.mean, spec.covariance, Metric::Mahalanobis)
        .ok_or_else(|| Error::usage("the colours of the examples have no covariance", "give more or larger marks"))?;
    Ok((spec, shape))
}

/// The score that the next mark should reach: four standard deviations below the examples' mean, no more than 3 below
/// the least of twenty examples (3·(20/n)² of n fewer), and at most the usual 0.
///
/// What was pointed at is known to be a mark, however little it resembles flat paint on even ground, which the score
/// was made for. Few examples say little of their spread, so it is taken as at least 1.5; clean and worn marks together
/// spread far, and those below the worn ones are none.
fn least_score(profile: &Profile, patches: &[&Patch], examples: &[Example]) -> Result<f64> {
    const LEAST_SPREAD: f64 = 1.5;
    /// The least of fewer examples says less of the next mark.
    const MANY: f64 = 20.0;
    let white = patches[0].white;
    let classifier = Classifier::new(profile, SampleType::U16, white, [0, 1, 2], None, None)?;
    let gates = Gates::new(profile, None)?;
    let scores: Vec<f64> = patches
        .iter()
        .zip(examples)
        .filter_map(|(patch, example)| score_of(patch, &example.own, &classifier, profile, &gates))
        .filter(|score| *score > -49.0)
        .collect();
    if scores.is_empty() {
        return Ok(0.0);
    }
    let n = scores.len() as f64;
    let mean = scores.iter().sum::<f64>() / n;
    let sd = (scores.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt();
    let least = scores.iter().copied().fold(f64::INFINITY, f64::min);
    let below_least = 2.0 * LEAST_SPREAD * (MANY / n).max(1.0).powi(2);
    Ok((mean - 4.0 * sd.max(LEAST_SPREAD)).max(least - below_least).min(0.0))
}
