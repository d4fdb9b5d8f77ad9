//! A profile taught by examples: marks that somebody points at.

use nalgebra::Vector3;

use crate::candidate::Gates;
use crate::candidate::patch::{median, sample_ground};
use crate::candidate::pixel_set::PixelSet;
use crate::candidate::split::score_of;
use crate::profile::colour::{Cloud, Metric, Space, lab_from_srgb};
use crate::profile::mixing::cloud;
use crate::profile::{
    ColourModel, Density, Examine, Filters, GateLimits, Learned, Profile, RoughBox, Shape, Size, Target,
};
use crate::segment::classify::Classifier;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_raster::{Patch, SampleType};

/// How far around a position a patch should reach when the size of the marks is not known.
pub const DEFAULT_REACH_PX: u64 = 40;

/// How the rough box in RGB follows from the paint's pixels, per band.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RoughRule {
    /// The middle share of the values, 1 being smallest to largest. The prototype's `min-max` with a percentile of 25 % is
    /// 0.75.
    Middle(f64),
    /// Mean ± so many standard deviations: the prototype's `mean-std`.
    Sigma(f64),
}

impl RoughRule {
    fn of(self, paint: &[[f64; 3]]) -> Result<RoughBox> {
        let sound = match self {
            RoughRule::Middle(share) => share > 0.0 && share <= 1.0,
            RoughRule::Sigma(k) => k > 0.0 && k.is_finite(),
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
                RoughRule::Middle(share) => {
                    let at = |q: f64| values[((values.len() - 1) as f64 * q).round() as usize];
                    (at((1.0 - share) / 2.0), at((1.0 + share) / 2.0))
                }
                RoughRule::Sigma(k) => {
                    let (mean, sd) = mean_and_deviation(&values);
                    (mean - k * sd, mean + k * sd)
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

/// Densities of L\*, a\*, b\*: quantiles of the paint, with B. W. Silverman's bandwidth 1.06·σ·n^(−1/5) (Density Estimation
/// for Statistics and Data Analysis, 1986, eq. 3.28).
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

/// What one example shows.
struct Example {
    /// sRGB 0..=1 of the mark's pixels.
    paint: Vec<[f64; 3]>,
    ground: Vec<[f64; 3]>,
    side_px: f64,
    eccentricity: f64,
    tightness: f64,
    own: PixelSet,
}

/// Learns a profile from marks at known positions (each inside its patch, which should reach [`DEFAULT_REACH_PX`] around
/// it).
///
/// The paint is what is connected to the position and lies nearer to the colour there than to the ground on the patch's
/// border, seen along the direction that separates the two best. The colour limit is 3.5 standard deviations, less when
/// the ground is nearer than that, but never below what holds 95 % of the examples' own pixels.
///
/// # Errors
/// [`Error::Usage`] naming the position when it is outside its patch, on nodata, or does not stand out from its
/// surroundings; or when there are no positions.
pub fn learn(name: &str, marks: &[(Patch, PixelPoint)]) -> Result<Profile> {
    learn_with(name, marks, &LearnOptions::default())
}

/// [`learn`], with the parts of the 2016 prototype's colour model that need samples (Script A.9): a rough box in RGB, and
/// kernel densities.
///
/// # Errors
/// Those of [`learn`]; [`Error::Usage`] for a rule that leaves no box.
pub fn learn_with(name: &str, marks: &[(Patch, PixelPoint)], options: &LearnOptions) -> Result<Profile> {
    if marks.is_empty() {
        return Err(Error::usage("no mark to learn from", "give at least one position with --at x,y"));
    }
    let examples: Vec<Example> = marks
        .iter()
        .map(|(patch, at)| {
            example(patch, *at).map_err(|why| {
                Error::usage(format!("the mark at {:.1},{:.1} {why}", at.x, at.y), "point at the middle of a mark")
            })
        })
        .collect::<Result<_>>()?;
    let paint: Vec<[f64; 3]> = examples.iter().flat_map(|e| e.paint.iter().copied()).collect();
    let mut spec = cloud(&paint);
    // The next mark lies in other light: at least 4 units of lightness and 2.5 of each chroma axis.
    for (axis, least) in [4.0f64, 2.5, 2.5].into_iter().enumerate() {
        spec.covariance[axis][axis] += least * least;
    }
    let shape = Cloud::new(spec.mean, spec.covariance, Metric::Mahalanobis)
        .ok_or_else(|| Error::usage("the colours of the examples have no covariance", "give more or larger marks"))?;
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
        description: format!("Learned from {} marks", examples.len()),
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
    profile.examine.min_score = least_score(&profile, marks, &examples)?;
    Ok(profile)
}

/// The score that the next mark should reach: four standard deviations below the examples' mean, at most the usual 0.
///
/// What was pointed at is known to be a mark, however little it resembles flat paint on even ground, which the score was
/// made for. Few examples say little of their spread, so it is taken as at least 1.5.
fn least_score(profile: &Profile, marks: &[(Patch, PixelPoint)], examples: &[Example]) -> Result<f64> {
    let white = marks[0].0.white;
    let classifier = Classifier::new(profile, SampleType::U16, white, [0, 1, 2], None, None)?;
    let gates = Gates::new(profile, None)?;
    let scores: Vec<f64> = marks
        .iter()
        .zip(examples)
        .filter_map(|((patch, _), example)| score_of(patch, &example.own, &classifier, profile, &gates))
        .filter(|score| *score > -49.0)
        .collect();
    if scores.is_empty() {
        return Ok(0.0);
    }
    let n = scores.len() as f64;
    let mean = scores.iter().sum::<f64>() / n;
    let sd = (scores.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt();
    Ok((mean - 4.0 * sd.max(1.5)).min(0.0))
}

fn example(patch: &Patch, at: PixelPoint) -> std::result::Result<Example, &'static str> {
    let (width, height) = (patch.window.width as usize, patch.window.height as usize);
    let (x, y) = (at.x - patch.window.x as f64, at.y - patch.window.y as f64);
    if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64) {
        return Err("lies outside the image");
    }
    let (x, y) = (x as usize, y as usize);
    let white = f64::from(patch.white);
    let unit = |i: usize| patch.rgb[i].map(|v| (f64::from(v) / white).min(1.0));
    let colour = |i: usize| Vector3::from(unit(i).map(|v| v * 255.0));
    let seed: Vec<usize> = (y.saturating_sub(1)..(y + 2).min(height))
        .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| v * width + u))
        .filter(|&i| patch.valid[i])
        .collect();
    if !patch.valid[y * width + x] {
        return Err("lies where the image holds nothing");
    }
    let seed_colour =
        Vector3::from(std::array::from_fn::<f64, 3, _>(|c| median(seed.iter().map(|&i| colour(i)[c]).collect())));
    // Ground: first the outer part of the patch, then again around what was found.
    let reach = |i: usize| (i % width).abs_diff(x).max((i / width).abs_diff(y));
    let far = width.max(height) / 4;
    let mut back: Vec<usize> = (0..width * height).filter(|&i| patch.valid[i] && reach(i) >= far).collect();
    let mut own = PixelSet::empty(width, height);
    for _ in 0..2 {
        let colours: Vec<[u16; 3]> = back.iter().map(|&i| patch.rgb[i].map(|v| v.min(patch.white))).collect();
        let g = sample_ground(&colours, patch.white).ok_or("has too little ground around it")?;
        let inverse = (g.covariance + nalgebra::Matrix3::identity() * 9.0).cholesky().ok_or("has no ground")?.inverse();
        let step = seed_colour - g.mean;
        let direction = inverse * step;
        let contrast2 = direction.dot(&step);
        if contrast2 < 9.0 {
            return Err("does not stand out from its surroundings");
        }
        let is_paint = |i: usize| patch.valid[i] && direction.dot(&(colour(i) - g.mean)) > 0.5 * contrast2;
        let paint = PixelSet::from_fn(width, height, is_paint);
        if !paint.has(y * width + x) {
            return Err("does not stand out from its surroundings");
        }
        own = paint.piece(y * width + x);
        let ring = own.grown(12).minus(&own.grown(2)).minus(&paint);
        back = ring.iter().filter(|&i| patch.valid[i]).collect();
    }
    let inside: Vec<usize> = own.iter().collect();
    if inside.iter().any(|&i| i % width == 0 || i % width + 1 == width || i / width == 0 || i / width + 1 == height)
        && inside.len() * 2 > width * height
    {
        return Err("does not end inside its window");
    }
    let (eccentricity, tightness) = outline(&inside, width);
    Ok(Example {
        paint: inside.iter().map(|&i| unit(i)).collect(),
        ground: back.iter().map(|&i| unit(i)).collect(),
        side_px: (inside.len() as f64).sqrt(),
        eccentricity,
        tightness,
        own,
    })
}

/// Eccentricity and tightness of a set of pixels.
fn outline(inside: &[usize], width: usize) -> (f64, f64) {
    let n = inside.len() as f64;
    let points: Vec<(f64, f64)> = inside.iter().map(|i| ((i % width) as f64, (i / width) as f64)).collect();
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let moment = |f: &dyn Fn(f64, f64) -> f64| points.iter().map(|p| f(p.0 - mx, p.1 - my)).sum::<f64>() / n;
    let (xx, xy, yy) = (moment(&|x, _| x * x) + 1.0 / 12.0, moment(&|x, y| x * y), moment(&|_, y| y * y) + 1.0 / 12.0);
    let gap = (((xx - yy) / 2.0).powi(2) + xy * xy).sqrt();
    let ratio = (((xx + yy) / 2.0 - gap) / ((xx + yy) / 2.0 + gap)).clamp(0.0, 1.0);
    let span = |f: &dyn Fn(&(f64, f64)) -> f64| {
        let low = points.iter().map(f).fold(f64::INFINITY, f64::min);
        points.iter().map(f).fold(f64::NEG_INFINITY, f64::max) - low + 1.0
    };
    ((1.0 - ratio).sqrt(), n / (span(&|p| p.0) * span(&|p| p.1)))
}
