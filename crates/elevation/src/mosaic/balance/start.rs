//! A line through points most of which may lie elsewhere.
//!
//! Lines through two points are drawn, and the one is taken that chance explains worst: the line and the distance from
//! it within which so many points lie that, were all points strewn evenly over the same box, the expected number of
//! such lines would be smallest. Neither the share of points that fit nor how well they fit needs to be known
//! (L. Moisan and B. Stival, *A probabilistic criterion to detect rigid point matches between two images and estimate
//! the fundamental matrix*, 2004; L. Moisan, P. Moulon and P. Monasse, *Automatic homographic registration of a pair
//! of images, with a contrario elimination of outliers*, 2012).

use autoref_raster::random::SplitMix64;

/// Points that lines are drawn through and judged by, at most.
const SAMPLE: usize = 240;
/// Lines that are drawn.
const DRAWS: usize = 400;
/// Two points are needed for a line, and so many more to say anything for it.
const FEWEST_MORE: usize = 3;
/// Slopes may differ from the ratio of the quartiles' distances by so many times: changed ground draws these apart.
const SLOPES: f64 = 30.0;
/// Nothing fits better than to this share of the points' extent.
const FINEST: f64 = 1e-3;
/// Refinements of the best line at most.
const REFINEMENTS: usize = 6;

/// A line y = `level.1` + `slope` · (x − `level.0`), and how far from it, along y, the points lie that speak for it.
pub struct Line {
    pub slope: f64,
    pub level: (f64, f64),
    pub reach: f64,
}

impl Line {
    /// How far a pair of values lies beside it, along the second.
    pub fn distance(&self, (x, y): (f64, f64)) -> f64 {
        (y - self.level.1 - self.slope * (x - self.level.0)).abs()
    }
}

/// So many of all points, spread over them; always the same.
fn sample(points: &[(f64, f64)], dice: &mut SplitMix64) -> Vec<(f64, f64)> {
    if points.len() <= SAMPLE {
        return points.to_vec();
    }
    // One of each stratum, at random: a step that is as long as a row of blocks would see one column.
    let part = points.len() as f64 / SAMPLE as f64;
    (0..SAMPLE).map(|k| points[(((k as f64 + dice.unit()) * part) as usize).min(points.len() - 1)]).collect()
}

/// What lines are judged by.
struct Judge {
    points: Vec<(f64, f64)>,
    extent: (f64, f64),
    /// Logarithm of the number of lines with so many points, by that number.
    lines: Vec<f64>,
    sizes: Vec<f64>,
}

impl Judge {
    fn new(points: Vec<(f64, f64)>) -> Judge {
        let extent = |of: &dyn Fn(&(f64, f64)) -> f64| {
            let (least, most) = points.iter().map(of).fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
            most - least
        };
        let extent = (extent(&|p| p.0), extent(&|p| p.1));
        let n = points.len();
        let mut factorials = vec![0.0; n + 1];
        for k in 1..=n {
            factorials[k] = factorials[k - 1] + (k as f64).ln();
        }
        let lines = (0..=n).map(|k| {
            let choices = factorials[n] - factorials[k] - factorials[n - k];
            choices + (n as f64).ln() + (k.max(2) as f64 * (k.max(2) - 1) as f64 / 2.0).ln()
        });
        let lines = lines.collect();
        Judge { points, extent, lines, sizes: Vec::new() }
    }

    /// Logarithm of the number of false alarms of a line, with the reach at which it is smallest.
    fn judge(&mut self, line: &Line) -> (f64, f64) {
        self.sizes.clear();
        self.sizes.extend(self.points.iter().map(|p| line.distance(*p)));
        self.sizes.sort_unstable_by(f64::total_cmp);
        // The share of the box that the strip covers, whichever side of the box the line leaves by.
        let whole = self.extent.1.max(line.slope * self.extent.0);
        let mut best = (f64::INFINITY, 0.0);
        for (k, size) in (1..).zip(&self.sizes).skip(1 + FEWEST_MORE) {
            let chance = (2.0 * size / whole).clamp(FINEST, 1.0);
            let alarms = self.lines[k] + (k - 2) as f64 * chance.ln();
            if alarms < best.0 {
                best = (alarms, size.max(FINEST * whole / 2.0));
            }
        }
        best
    }
}

/// The ratio of spreads: the distance of the quartiles, or of the extremes where many points are equal.
fn spread(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    let n = values.len();
    let quartiles = values[n * 3 / 4] - values[n / 4];
    if quartiles > 0.0 { quartiles } else { values[n - 1] - values[0] }
}

/// The rising line that the points speak for most; `None` where chance explains all, or a source has one value.
pub fn line(points: &[(f64, f64)]) -> Option<Line> {
    if points.len() < 2 + FEWEST_MORE {
        return None;
    }
    let mut dice = SplitMix64(0x2016);
    let mut judge = Judge::new(sample(points, &mut dice));
    let ratio = spread(judge.points.iter().map(|p| p.1)) / spread(judge.points.iter().map(|p| p.0));
    if !(ratio.is_finite() && ratio > 0.0) {
        return None;
    }
    let slopes = ratio / SLOPES..ratio * SLOPES;
    let n = judge.points.len();
    let mut best: Option<(f64, Line)> = None;
    for _ in 0..DRAWS {
        let (a, b) = ((dice.unit() * n as f64) as usize, (dice.unit() * n as f64) as usize);
        let (a, b) = (judge.points[a.min(n - 1)], judge.points[b.min(n - 1)]);
        let slope = (b.1 - a.1) / (b.0 - a.0);
        // A point drawn twice has none.
        if !slopes.contains(&slope) {
            continue;
        }
        let mut line = Line { slope, level: a, reach: 0.0 };
        let (alarms, reach) = judge.judge(&line);
        line.reach = reach;
        if best.as_ref().is_none_or(|(least, _)| alarms < *least) {
            best = Some((alarms, line));
        }
    }
    let (mut alarms, mut line) = best?;
    for _ in 0..REFINEMENTS {
        let Some(mut finer) = refined(&judge.points, &line).filter(|finer| slopes.contains(&finer.slope)) else {
            break;
        };
        let (fewer, reach) = judge.judge(&finer);
        if fewer >= alarms {
            break;
        }
        finer.reach = reach;
        (alarms, line) = (fewer, finer);
    }
    (alarms < 0.0).then_some(line)
}

/// The line through what is within reach, by geometric mean regression.
fn refined(points: &[(f64, f64)], line: &Line) -> Option<Line> {
    let near: Vec<_> = points.iter().filter(|p| line.distance(**p) <= line.reach).collect();
    let n = near.len() as f64;
    let level = near.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p.0 / n, sum.1 + p.1 / n));
    let spread = |of: &dyn Fn(&(f64, f64)) -> f64| near.iter().map(|p| of(p).powi(2)).sum::<f64>();
    let slope = (spread(&|p| p.1 - level.1) / spread(&|p| p.0 - level.0)).sqrt();
    slope.is_finite().then_some(Line { slope, level, reach: 0.0 })
}

/// Where most numbers lie: the ends of the shortest interval that holds a third of them (in the manner of
/// P. J. Rousseeuw, *Least median of squares regression*, 1984, for more than half that lie elsewhere).
pub fn densest(values: &[f64]) -> Option<(f64, f64)> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let held = (sorted.len() / 3).max(2).min(sorted.len()).max(1);
    let lengths = sorted.windows(held).map(|held| (held[0], held[held.len() - 1]));
    lengths.min_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two in five points lie on the line; the others form a cloud of one value and a smear between the two.
    #[test]
    fn a_line_of_two_fifths_is_found_among_what_changed() {
        for seed in 1..20 {
            let mut dice = SplitMix64(seed);
            let points: Vec<(f64, f64)> = (0..300)
                .map(|k| {
                    let x = 110.0 + 20.0 * dice.normal();
                    let y = 0.8 * x + 10.0 + 0.1 * dice.normal();
                    match k % 10 {
                        0..4 => (x, y),
                        4..8 => (x, 200.0 + dice.normal()),
                        _ => (x, y + (200.0 - y) * dice.unit()),
                    }
                })
                .collect();
            let line = line(&points).expect("a line");
            assert!((line.slope / 0.8 - 1.0).abs() < 0.02, "seed {seed}: {}", line.slope);
        }
    }

    #[test]
    fn the_densest_interval_is_where_most_are() {
        let values: Vec<f64> = (0..100).map(|k| if k < 40 { f64::from(k) * 0.01 } else { f64::from(k) }).collect();
        let (from, to) = densest(&values).expect("there are some");
        assert!(from >= 0.0 && to < 0.4, "{from} to {to}");
        assert_eq!(densest(&[7.0]), Some((7.0, 7.0)));
        assert_eq!(densest(&[]), None);
    }
}
