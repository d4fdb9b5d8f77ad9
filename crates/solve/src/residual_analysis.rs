//! What the residuals of a fit say of its model: are they normal, do they favour a direction, do they grow outwards.
//!
//! Normality by A² of T. W. Anderson and D. A. Darling, "A test of goodness of fit", 1954, with mean and variance from
//! the sample and the p-value of R. B. D'Agostino and M. A. Stephens, "Goodness-of-fit techniques", 1986, table 4.9: it
//! sees the tails, which the test of Kolmogorov and Smirnov hardly does. Directions by Lord Rayleigh's test for a
//! favoured direction, with the p-value of J. H. Zar, "Biostatistical analysis", 1999, eq. 27.4. Intervals of
//! correlations by R. A. Fisher's z, 95 %. Whether residuals lie along the lines to the centre by the mean of cos 2δ, δ
//! the angle between residual and line: the angle doubled, out and in are one (K. V. Mardia, P. E. Jupp, "Directional
//! statistics", 2000, sections 1.1 and 6.3: the V test; of n chance directions the mean has a variance of 1/2n).

use autoref_raster::normal;
use serde::Serialize;

/// A residual and where its point lies, metres.
pub struct Residual {
    /// Easting and northing of the point.
    pub position: [f64; 2],
    /// Height of the point; `None` where it is not known.
    pub height_m: Option<f64>,
    /// The residual in easting.
    pub e_m: f64,
    /// The residual in northing.
    pub n_m: f64,
    /// The residual in height, where there is one.
    pub h_m: Option<f64>,
}

/// What is said of residuals. What too few points leave open is `None`.
#[derive(Debug, Serialize)]
pub struct Analysis {
    /// How many residuals there are.
    pub points: usize,
    /// As given to [`analyse`].
    pub tail_cut: f64,
    /// The mean of the points, metres.
    pub centre: [f64; 2],
    /// Residuals in easting.
    pub easting: Component,
    /// Residuals in northing.
    pub northing: Component,
    /// Residuals in height; `None` when no point has one.
    pub height: Option<Component>,
    /// Which way the residuals point in the plane.
    pub directions: Directions,
    /// How they hang together with the place.
    pub correlations: Correlations,
}

/// One component of the residuals.
#[derive(Debug, Serialize)]
pub struct Component {
    /// Without the tails.
    pub histogram: Option<Histogram>,
    /// Without the tails.
    pub normality: Option<Normality>,
}

/// Counts in bins of equal width.
#[derive(Debug, Serialize)]
pub struct Histogram {
    /// Lower end of the first bin.
    pub from_m: f64,
    /// Upper end of the last bin.
    pub to_m: f64,
    /// In each bin, from below.
    pub counts: [usize; BINS],
}

/// Whether values may come from a normal distribution.
#[derive(Debug, Serialize)]
#[serde(tag = "test", rename = "Anderson-Darling")]
pub struct Normality {
    /// A² with mean and variance from the sample.
    pub statistic: f64,
    /// The chance of such a statistic if they do.
    pub p_value: f64,
    /// Values that were tested.
    pub n: usize,
}

/// Which way residuals point.
#[derive(Debug, Serialize)]
pub struct Directions {
    /// Counts in equal sectors, anticlockwise from west.
    pub sectors: [usize; SECTORS],
    /// The direction they favour.
    pub favoured: Option<Favoured>,
    /// How they lie to the lines from the centre.
    pub radial: Option<Radial>,
}

/// Whether residuals lie along the lines from the centre to their points.
#[derive(Debug, Serialize)]
pub struct Radial {
    /// The mean of cos 2δ, δ between residual and line: 1 all along (out or in), −1 all across.
    pub mean: f64,
    /// Chance directions lie within ± this 95 times in 100.
    pub chance_95: f64,
    /// Residuals.
    pub n: usize,
}

/// The mean direction, and whether it is more than chance.
#[derive(Debug, Serialize)]
#[serde(tag = "test", rename = "Rayleigh")]
pub struct Favoured {
    /// Anticlockwise from east.
    pub direction_deg: f64,
    /// Length of the mean of unit vectors, 0 (all directions alike) to 1.
    pub share: f64,
    /// The chance of such a share if no direction is favoured.
    pub p_value: f64,
}

/// How residuals hang together with the distance and direction from the centre.
#[derive(Debug, Serialize)]
pub struct Correlations {
    /// Length of the residual and distance, in the plane.
    pub magnitude_distance_2d: Option<Correlation>,
    /// The same in space.
    pub magnitude_distance_3d: Option<Correlation>,
    /// Direction of the residual and direction from the centre, radians.
    pub direction_outward: Option<Correlation>,
}

/// A correlation with its interval of 95 %.
#[derive(Debug, Serialize)]
pub struct Correlation {
    /// Pearson's coefficient.
    pub r: f64,
    /// Lower end of the interval.
    pub low_95: f64,
    /// Upper end of the interval.
    pub high_95: f64,
    /// Pairs of values.
    pub n: usize,
}

const BINS: usize = 10;
const SECTORS: usize = 8;
/// Below it neither a test nor an interval says anything.
const FEWEST: usize = 5;

/// The analysis. `tail_cut` is the share of the smallest and of the largest values that histograms, tests and
/// magnitudes leave out, 0 to below 0.5.
pub fn analyse(residuals: &[Residual], tail_cut: f64) -> Analysis {
    let values = |of: &dyn Fn(&Residual) -> Option<f64>| -> Vec<f64> { residuals.iter().filter_map(of).collect() };
    let n = residuals.len().max(1) as f64;
    let mean = |of: &dyn Fn(&Residual) -> f64| residuals.iter().map(of).sum::<f64>() / n;
    let centre = [mean(&|r| r.position[0]), mean(&|r| r.position[1])];
    let heights = values(&|r| r.height_m);
    let level = heights.iter().sum::<f64>() / heights.len().max(1) as f64;
    let outward = |r: &Residual| (r.position[0] - centre[0], r.position[1] - centre[1]);
    let plan: Vec<[f64; 2]> = residuals
        .iter()
        .map(|r| {
            let (east, north) = outward(r);
            [r.e_m.hypot(r.n_m), east.hypot(north)]
        })
        .collect();
    let space: Vec<[f64; 2]> = residuals
        .iter()
        .filter_map(|r| {
            let (east, north) = outward(r);
            let (height, error) = r.height_m.zip(r.h_m)?;
            Some([r.e_m.hypot(r.n_m).hypot(error), east.hypot(north).hypot(height - level)])
        })
        .collect();
    let direction = |r: &Residual| {
        let (east, north) = outward(r);
        [r.n_m.atan2(r.e_m), north.atan2(east)]
    };
    let directions: Vec<[f64; 2]> = residuals.iter().map(direction).collect();
    // A point in the centre, or one that fits to the last bit, lies along nothing.
    let has_direction = |r: &&Residual| r.e_m.hypot(r.n_m) > 0.0 && outward(r) != (0.0, 0.0);
    let with_direction: Vec<[f64; 2]> = residuals.iter().filter(has_direction).map(direction).collect();
    let angles: Vec<f64> = directions.iter().map(|d| d[0]).collect();
    let component = |values: &[f64]| {
        let kept = without_tails(values, tail_cut);
        Component { histogram: histogram(&kept), normality: normality(&kept) }
    };
    let in_space = values(&|r| r.h_m);
    Analysis {
        points: residuals.len(),
        tail_cut,
        centre,
        easting: component(&values(&|r| Some(r.e_m))),
        northing: component(&values(&|r| Some(r.n_m))),
        height: (!in_space.is_empty()).then(|| component(&in_space)),
        directions: Directions {
            sectors: sectors(&angles),
            favoured: favoured(&angles),
            radial: radial(&with_direction),
        },
        correlations: Correlations {
            magnitude_distance_2d: correlation(&pairs_without_tails(&plan, tail_cut)),
            magnitude_distance_3d: correlation(&pairs_without_tails(&space, tail_cut)),
            direction_outward: correlation(&directions),
        },
    }
}

/// Of directions of residuals and from the centre, radians.
fn radial(directions: &[[f64; 2]]) -> Option<Radial> {
    let n = directions.len();
    if n < FEWEST {
        return None;
    }
    let count = n as f64;
    let mean = directions.iter().map(|[residual, line]| (2.0 * (residual - line)).cos()).sum::<f64>() / count;
    Some(Radial { mean, chance_95: 1.96 / (2.0 * count).sqrt(), n })
}

fn cut(len: usize, share: f64) -> usize {
    (len as f64 * share).floor() as usize
}

fn without_tails(values: &[f64], share: f64) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let k = cut(sorted.len(), share);
    sorted[k..sorted.len() - k].to_vec()
}

/// By the first of each pair.
fn pairs_without_tails(pairs: &[[f64; 2]], share: f64) -> Vec<[f64; 2]> {
    let mut sorted = pairs.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let k = cut(sorted.len(), share);
    sorted[k..sorted.len() - k].to_vec()
}

fn histogram(sorted: &[f64]) -> Option<Histogram> {
    let (low, high) = (*sorted.first()?, *sorted.last()?);
    let width = (high - low) / BINS as f64;
    let mut counts = [0usize; BINS];
    for value in sorted {
        let bin = if width > 0.0 { ((value - low) / width) as usize } else { 0 };
        counts[bin.min(BINS - 1)] += 1;
    }
    Some(Histogram { from_m: low, to_m: high, counts })
}

fn normality(sorted: &[f64]) -> Option<Normality> {
    let n = sorted.len();
    let mean = sorted.iter().sum::<f64>() / n.max(1) as f64;
    let variance = sorted.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n.saturating_sub(1).max(1) as f64;
    if n < FEWEST || variance <= 0.0 {
        return None;
    }
    let below = |i: usize| normal::below((sorted[i] - mean) / variance.sqrt()).clamp(1e-15, 1.0 - 1e-15);
    let count = n as f64;
    let sum: f64 = (0..n).map(|i| (2.0 * i as f64 + 1.0) * (below(i).ln() + (1.0 - below(n - 1 - i)).ln())).sum();
    let a2 = (-count - sum / count) * (1.0 + 0.75 / count + 2.25 / (count * count));
    if !a2.is_finite() {
        return None;
    }
    let p = if a2 < 0.2 {
        1.0 - (-13.436 + 101.14 * a2 - 223.73 * a2 * a2).exp()
    } else if a2 < 0.34 {
        1.0 - (-8.318 + 42.796 * a2 - 59.938 * a2 * a2).exp()
    } else if a2 < 0.6 {
        (0.9177 - 4.279 * a2 - 1.38 * a2 * a2).exp()
    } else if a2 < 10.0 {
        (1.2937 - 5.709 * a2 + 0.0186 * a2 * a2).exp()
    } else {
        // Below 1e-23; the parabola above is for the statistics of its table, and rises again far beyond them.
        0.0
    };
    Some(Normality { statistic: a2, p_value: p.clamp(0.0, 1.0), n })
}

/// Counts anticlockwise from east, beginning at −180°.
fn sectors(angles: &[f64]) -> [usize; SECTORS] {
    let mut counts = [0; SECTORS];
    for angle in angles {
        let turn = (angle + std::f64::consts::PI) / std::f64::consts::TAU;
        counts[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] += 1;
    }
    counts
}

fn favoured(angles: &[f64]) -> Option<Favoured> {
    let n = angles.len() as f64;
    if angles.len() < FEWEST {
        return None;
    }
    let (c, s) = (angles.iter().map(|a| a.cos()).sum::<f64>(), angles.iter().map(|a| a.sin()).sum::<f64>());
    let r = c.hypot(s);
    let p = ((1.0 + 4.0 * n + 4.0 * (n * n - r * r)).sqrt() - (1.0 + 2.0 * n)).exp();
    Some(Favoured { direction_deg: s.atan2(c).to_degrees(), share: r / n, p_value: p.clamp(0.0, 1.0) })
}

fn correlation(pairs: &[[f64; 2]]) -> Option<Correlation> {
    let n = pairs.len();
    let count = n as f64;
    let mean = |i: usize| pairs.iter().map(|p| p[i]).sum::<f64>() / count;
    let (a, b) = (mean(0), mean(1));
    let sum = |f: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(f).sum::<f64>();
    let spread = (sum(&|p| (p[0] - a).powi(2)) * sum(&|p| (p[1] - b).powi(2))).sqrt();
    if n < FEWEST || spread.is_nan() || spread <= 0.0 {
        return None;
    }
    let r = (sum(&|p| (p[0] - a) * (p[1] - b)) / spread).clamp(-1.0, 1.0);
    let (z, half) = (r.clamp(-1.0 + 1e-12, 1.0 - 1e-12).atanh(), normal::WITHIN_95 / (count - 3.0).sqrt());
    Some(Correlation { r, low_95: (z - half).tanh(), high_95: (z + half).tanh(), n })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_statistic_of_a_normal_sample_and_of_an_exponential_one() {
        // scipy.stats.anderson(x, "norm").statistic · (1 + 0.75/n + 2.25/n²) of quantiles at (i + ½)/20.
        let normal: Vec<f64> = (0..20).map(|i| quantile((f64::from(i) + 0.5) / 20.0)).collect();
        let exponential: Vec<f64> = (0..20).map(|i| -(1.0 - (f64::from(i) + 0.5) / 20.0_f64).ln()).collect();
        let p = |values: &[f64]| normality(values).expect("enough values").p_value;
        assert!(p(&normal) > 0.99, "{}", p(&normal));
        assert!(p(&exponential) < 0.05, "{}", p(&exponential));
        let outlier: Vec<f64> = (0..1500).map(|i| quantile((f64::from(i) + 0.5) / 1500.0)).chain([5000.0]).collect();
        assert_eq!(p(&outlier), 0.0);
        assert!(normality(&[1.0; 20]).is_none() && normality(&normal[..3]).is_none());
    }

    fn quantile(p: f64) -> f64 {
        let (mut low, mut high) = (-9.0, 9.0);
        for _ in 0..80 {
            let middle = (low + high) / 2.0;
            if normal::below(middle) < p { low = middle } else { high = middle }
        }
        low
    }

    #[test]
    fn what_grows_outwards_is_seen_and_tails_are_cut() {
        let grown: Vec<Residual> = (0..24)
            .map(|i| {
                let (angle, radius) = (f64::from(i) * 0.9, 10.0 + f64::from(i * 7 % 24));
                let at = [radius * f64::cos(angle), radius * f64::sin(angle)];
                Residual { position: at, height_m: None, e_m: at[0] / 1e3, n_m: at[1] / 1e3, h_m: None }
            })
            .collect();
        let analysis = analyse(&grown, 0.0);
        assert!(analysis.correlations.magnitude_distance_2d.as_ref().expect("enough points").r > 0.9);
        assert!(analysis.height.is_none());
        let json = serde_json::to_string(&analysis.directions.favoured).expect("plain data");
        assert!(json.starts_with(r#"{"test":"Rayleigh","direction_deg":"#), "{json}");
        let counts = |a: &Analysis| -> usize { a.easting.histogram.as_ref().expect("bins").counts.iter().sum() };
        assert_eq!((counts(&analysis), counts(&analyse(&grown, 0.1))), (24, 20));
        let radial = |a: &Analysis| {
            let Radial { mean, chance_95, .. } = *a.directions.radial.as_ref().expect("enough points");
            (mean.abs() > chance_95).then_some(mean.signum())
        };
        assert_eq!(radial(&analysis), Some(1.0));
        let turned = |of: &dyn Fn(&Residual) -> [f64; 2]| -> Analysis {
            let with = |r: &Residual| {
                let [e_m, n_m] = of(r);
                Residual { position: r.position, height_m: None, e_m, n_m, h_m: None }
            };
            analyse(&grown.iter().map(with).collect::<Vec<_>>(), 0.0)
        };
        // In is as radial as out, a turn is across, and a stretch is neither.
        assert_eq!(radial(&turned(&|r| [-r.e_m, -r.n_m])), Some(1.0));
        assert_eq!(radial(&turned(&|r| [-r.n_m, r.e_m])), Some(-1.0));
        assert_eq!(radial(&turned(&|r| [r.e_m, -r.n_m])), None);
        let all: usize = sectors(&[-3.2, 3.2, 0.0, 1.0]).iter().sum();
        assert_eq!(all, 4);
    }

    #[test]
    fn a_favoured_direction_is_seen() {
        let one: Vec<f64> = (0..20).map(|i| 0.5 + 0.01 * f64::from(i)).collect();
        let round: Vec<f64> = (0..20).map(|i| std::f64::consts::TAU * f64::from(i) / 20.0).collect();
        let p = |angles: &[f64]| favoured(angles).expect("enough angles").p_value;
        assert!(p(&one) < 1e-6 && p(&round) > 0.9);
    }
}
