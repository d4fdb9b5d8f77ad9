//! The windows about places that were pointed at, laid on each other and on themselves turned by half a turn.

use super::{Values, count};
use crate::stack::Grid;
use autoref_raster::bilinear::by_differences;

/// Half the side of the disc that is compared, millimetres.
const DISC_MM: f64 = 1.6;
/// Correlation from which two marks look alike, and from which one is its own image turned by half a turn.
const ALIKE: f64 = 0.6;
const SYMMETRIC: f64 = 0.85;
/// Correlation of edges from which a mark in front of terrain is seen.
const SEEN: f64 = 0.45;
/// What changes over more than this is terrain or light, not an edge: half the side of the box whose mean is taken
/// away, millimetres.
const EDGE_MM: f64 = 0.35;
/// Correlation of edges, as vectors, from which a half turn lays a mark on itself: a solid half disc covers itself well
/// when it is turned, its edges do not.
const EDGE_ON_EDGE: f64 = 0.75;
/// Steepness of a disc's rim, so many values wide, against the whole from which the mark goes on beyond it.
const GOES_ON: f64 = 0.25;
const RIM: f64 = 2.5;
/// Edges that cross have this share of the steepness in the direction of less of it: their crossing is its own image
/// wherever they lead. A straight edge or bar alone is that at each of its points.
const CROSSING: f64 = 0.25;
/// How far clicks may be off: pixels of the scan, and millimetres.
const REACH_PX: f64 = 8.0;
const REACH_MM: f64 = 0.15;

/// What a half turn does to the edges in a disc.
struct HalfTurn {
    /// Correlation of the slopes, which change their sign.
    fit: f64,
    /// Steepness of the disc's rim against all of it.
    rim: f64,
    /// Ratio of the smaller to the larger principal moment of the slopes: 0 of parallel edges, 1 of a right cross.
    crossing: f64,
}

/// How alike two windows are where one lies on the other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alike {
    pub(super) correlation: f64,
    /// How strongly the second shows what the first does.
    pub(super) contrast: f64,
}

/// The values about the click that are compared.
pub(super) struct Field {
    pub(super) width: i64,
    pub(super) height: i64,
    pub(super) radius: i64,
    reach: i64,
    /// Half the side of the box that tells edges from terrain.
    edge: usize,
}

impl Field {
    pub(super) fn new(grid: &Grid) -> Field {
        let (width, height) = (grid.width as i64, grid.height as i64);
        let reach = REACH_PX.max(REACH_MM / grid.step_mm).round() as i64;
        let room = width.min(height) / 2 - 2;
        let radius = ((DISC_MM / grid.step_mm).round() as i64).min(room - reach / 2).max(3);
        let edge = ((EDGE_MM / grid.step_mm).round() as usize).max(3);
        Field { width, height, radius, reach: reach.min(room), edge }
    }

    fn at(&self, values: &Values, x: i64, y: i64) -> Option<f64> {
        let inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
        inside.then(|| f64::from(values[(y * self.width + x) as usize]))
    }

    fn middle(&self) -> [i64; 2] {
        [self.width / 2, self.height / 2]
    }

    /// As many windows as can be, laid on each other. The first may be the one that shows least: then another, on which
    /// most can be laid.
    pub(super) fn laid_on_most(&self, windows: &[&Values]) -> Vec<Option<[f64; 2]>> {
        let most = windows.len() / 2 + 1;
        let mut tries = (0..windows.len()).map(|first| self.laid_on(windows, first));
        let first = tries.next().unwrap_or_default();
        if count(&first) >= most { first } else { tries.find(|laid| count(laid) >= most).unwrap_or(first) }
    }

    /// All windows laid on that of a number, and then on what they have in common, which is clearer; shifts of mean 0,
    /// since nothing is known of what clicks share.
    fn laid_on(&self, windows: &[&Values], first: usize) -> Vec<Option<[f64; 2]>> {
        let mut moved: Vec<Option<[f64; 2]>> = vec![None; windows.len()];
        let mut stack: Vec<f32> = windows[first].to_vec();
        for _ in 0..3 {
            for (window, shift) in windows.iter().zip(&mut moved) {
                *shift = self.register(&stack, window);
            }
            let known: Vec<[f64; 2]> = moved.iter().flatten().copied().collect();
            if known.len() < 2 {
                break;
            }
            let mean = [0, 1].map(|d| known.iter().map(|s| s[d]).sum::<f64>() / known.len() as f64);
            moved.iter_mut().flatten().for_each(|s| *s = [s[0] - mean[0], s[1] - mean[1]]);
            stack = self.stacked(windows, &moved);
        }
        self.keep_alike(&stack, windows, &mut moved);
        moved
    }

    /// Lets go of windows that share no more than where it is dark and where bright: their edges lie otherwise.
    fn keep_alike(&self, stack: &Values, windows: &[&Values], moved: &mut [Option<[f64; 2]>]) {
        let edges = self.edges(stack);
        for (window, shift) in windows.iter().zip(moved.iter_mut()) {
            let alike = shift.and_then(|s| self.compare(&edges, &self.edges(window), Some(s)));
            // Marks that lie further apart than clicks may be off were laid on each other wrongly.
            let is_near = |s: &[f64; 2]| s[0].hypot(s[1]) <= self.reach as f64;
            *shift = shift.filter(|s| is_near(s) && alike.is_some_and(|(_, a)| a.correlation > ALIKE));
        }
        let known: Vec<[f64; 2]> = moved.iter().flatten().copied().collect();
        let mean = [0, 1].map(|d| known.iter().map(|s| s[d]).sum::<f64>() / known.len().max(1) as f64);
        moved.iter_mut().flatten().for_each(|s| *s = [s[0] - mean[0], s[1] - mean[1]]);
    }

    /// Where in `window` the middle of `pattern` is, from its own middle.
    fn register(&self, pattern: &Values, window: &Values) -> Option<[f64; 2]> {
        // Two clicks may be off in opposite directions.
        let (at, value) = peak(2 * self.reach, |dx, dy| self.sums(pattern, window, dx, dy).correlation());
        at.filter(|_| value > ALIKE)
    }

    /// As [`Field::register`] between edges, near a place that is known or within reach of the click.
    pub(super) fn compare(
        &self,
        pattern: &Values,
        window: &Values,
        known: Option<[f64; 2]>,
    ) -> Option<([f64; 2], Alike)> {
        let about = known.map_or([0, 0], |k| k.map(|v| v.round() as i64));
        let reach = if known.is_some() { 2 } else { self.reach };
        let sums = |dx: i64, dy: i64| self.sums(pattern, window, about[0] + dx, about[1] + dy);
        let (at, correlation) = peak(reach, |dx, dy| sums(dx, dy).correlation());
        let Some(at) = at else { return known.map(|k| (k, Alike { correlation: 0.0, contrast: 1.0 })) };
        let contrast = sums(at[0].round() as i64, at[1].round() as i64).slope();
        let alike = Alike { correlation, contrast };
        match known {
            Some(known) => Some((known, alike)),
            None => Some((at, alike)).filter(|_| correlation > SEEN),
        }
    }

    fn sums(&self, pattern: &Values, window: &Values, dx: i64, dy: i64) -> Sums {
        let [cx, cy] = self.middle();
        let mut sums = Sums::default();
        for y in -self.radius..=self.radius {
            for x in -self.radius..=self.radius {
                if x * x + y * y > self.radius * self.radius {
                    continue;
                }
                let pair = self.at(pattern, cx + x, cy + y).zip(self.at(window, cx + x + dx, cy + y + dy));
                if let Some((a, b)) = pair {
                    sums.add(a, b);
                }
            }
        }
        sums
    }

    /// The window without what changes slowly: each value above the mean of those around it.
    pub(super) fn edges(&self, window: &Values) -> Vec<f32> {
        let (width, height) = (self.width as usize, self.height as usize);
        let mut sums = vec![0.0f64; (width + 1) * (height + 1)];
        for y in 0..height {
            let mut row = 0.0;
            for x in 0..width {
                row += f64::from(window[y * width + x]);
                sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
            }
        }
        let span = |v: usize, n: usize| (v.saturating_sub(self.edge), (v + self.edge + 1).min(n));
        let around = |k: usize| {
            let ((x0, x1), (y0, y1)) = (span(k % width, width), span(k / width, height));
            let at = |x: usize, y: usize| sums[y * (width + 1) + x];
            (at(x1, y1) - at(x0, y1) - at(x1, y0) + at(x0, y0)) / ((x1 - x0) * (y1 - y0)) as f64
        };
        window.iter().enumerate().map(|(k, v)| v - around(k) as f32).collect()
    }

    /// Standard deviation of a centre that all windows share, by what each tells alone about where it must be; `None`
    /// where fewer than two tell it.
    pub(super) fn spread(
        &self,
        windows: &[&Values],
        moved: &[Option<[f64; 2]>],
        centre: [f64; 2],
        tell: impl Fn(&Values, [f64; 2]) -> Option<[f64; 2]>,
    ) -> Option<f64> {
        let alone = |(window, shift): (&&Values, &Option<[f64; 2]>)| {
            let shift = (*shift)?;
            let own = tell(window, [shift[0] + centre[0], shift[1] + centre[1]])?;
            Some((own[0] - shift[0] - centre[0]).powi(2) + (own[1] - shift[1] - centre[1]).powi(2))
        };
        let squares: Vec<f64> = windows.iter().zip(moved).filter_map(alone).collect();
        let n = squares.len() as f64;
        (n >= 2.0).then(|| (squares.iter().sum::<f64>() / (2.0 * n) / n).sqrt())
    }

    /// How steep the smoothed window is, across and down; `None` at its rim. Both are smoothed alike along and across
    /// their direction, so that slanting edges are seen to slant as much as they do.
    pub(super) fn slopes(&self, window: &Values) -> Vec<Option<[f64; 2]>> {
        const BINOMIAL: [(i64, f64); 3] = [(-1, 0.25), (0, 0.5), (1, 0.25)];
        // As wide as the difference of values two apart is along it.
        const ACROSS: [(i64, f64); 3] = [(-1, 1.0 / 6.0), (0, 4.0 / 6.0), (1, 1.0 / 6.0)];
        let places = || (0..self.width * self.height).map(|k| (k % self.width, k / self.width));
        let smooth = |(x, y): (i64, i64)| -> Option<f64> {
            let mut sum = 0.0;
            for (dy, down) in BINOMIAL {
                for (dx, across) in BINOMIAL {
                    sum += down * across * self.at(window, x + dx, y + dy)?;
                }
            }
            Some(sum)
        };
        let smoothed: Vec<Option<f64>> = places().map(smooth).collect();
        let at = |x: i64, y: i64| {
            let inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
            inside.then(|| smoothed[(y * self.width + x) as usize]).flatten()
        };
        let slope = |(x, y): (i64, i64)| {
            let (mut across, mut down) = (0.0, 0.0);
            for (d, weight) in ACROSS {
                across += weight * (at(x + 1, y + d)? - at(x - 1, y + d)?);
                down += weight * (at(x + d, y + 1)? - at(x + d, y - 1)?);
            }
            Some([across, down])
        };
        places().map(slope).collect()
    }

    /// Whether a half turn about a place lays edges on edges within the first of `radii`, and, where the mark goes on
    /// beyond, within the second: in a disc that is too small a piece of any bar or rim is its own image.
    fn turns_into_itself(&self, slopes: &[Option<[f64; 2]>], shift: [f64; 2], radii: &[i64]) -> bool {
        let [radius, wider @ ..] = radii else { return false };
        let inner = self.edge_on_edge(slopes, shift, *radius);
        let ends = inner.rim <= GOES_ON || inner.crossing >= CROSSING;
        let beyond = wider.first().is_none_or(|wider| self.edge_on_edge(slopes, shift, *wider).fit > EDGE_ON_EDGE);
        inner.fit > EDGE_ON_EDGE && (ends || beyond)
    }

    /// How a half turn about the window's middle, shifted so, lays edges within `radius`.
    fn edge_on_edge(&self, slopes: &[Option<[f64; 2]>], shift: [f64; 2], radius: i64) -> HalfTurn {
        let (width, height) = (self.width, self.height);
        let slope = |x: i64, y: i64| {
            let inside = (0..width).contains(&x) && (0..height).contains(&y);
            inside.then(|| slopes[(y * width + x) as usize]).flatten()
        };
        let between = |x: f64, y: f64| -> Option<[f64; 2]> {
            let (i, j) = (x.floor(), y.floor());
            let (a, b) = (x - i, y - j);
            let mut sum = [0.0; 2];
            for (di, dj, weight) in
                [(0, 0, (1.0 - a) * (1.0 - b)), (1, 0, a * (1.0 - b)), (0, 1, (1.0 - a) * b), (1, 1, a * b)]
            {
                let there = slope(i as i64 + di, j as i64 + dj)?;
                sum = [sum[0] + weight * there[0], sum[1] + weight * there[1]];
            }
            Some(sum)
        };
        let centre = [0.5 * (width - 1) as f64 + shift[0], 0.5 * (height - 1) as f64 + shift[1]];
        let (mut both, mut here, mut there) = (0.0, 0.0, 0.0);
        // Squares and product of the slopes across and down.
        let mut moments = [0.0; 3];
        // Of the disc and of its rim: steepness and how many values.
        let mut steep = [(0.0, 0.0); 2];
        for y in -radius..=radius {
            for x in -radius..=radius {
                let (px, py) = (centre[0].round() as i64 + x, centre[1].round() as i64 + y);
                let turned = between(2.0 * centre[0] - px as f64, 2.0 * centre[1] - py as f64);
                let Some((a, b)) = slope(px, py).zip(turned).filter(|_| x * x + y * y <= radius * radius) else {
                    continue;
                };
                both -= a[0] * b[0] + a[1] * b[1];
                let size = a[0] * a[0] + a[1] * a[1];
                here += size;
                moments = [moments[0] + a[0] * a[0], moments[1] + a[0] * a[1], moments[2] + a[1] * a[1]];
                there += b[0] * b[0] + b[1] * b[1];
                let at_rim = ((x * x + y * y) as f64).sqrt() > radius as f64 - RIM;
                for part in &mut steep[..=usize::from(at_rim)] {
                    *part = (part.0 + size, part.1 + 1.0);
                }
            }
        }
        let mean = |(sum, n): (f64, f64)| sum / f64::max(n, 1.0);
        let [xx, xy, yy] = moments;
        let half_gap = (0.5 * (xx - yy)).hypot(xy);
        HalfTurn {
            fit: both / f64::max((here * there).sqrt(), 1e-12),
            rim: mean(steep[1]) / mean(steep[0]).max(1e-12),
            crossing: (0.5 * here - half_gap) / f64::max(0.5 * here + half_gap, 1e-12),
        }
    }

    /// The middle of the half turn that changes least, from the window's middle; `None` where it does not lay edges on
    /// edges.
    pub(super) fn symmetric_centre(&self, window: &Values) -> Option<[f64; 2]> {
        let mut best: Option<(f64, [f64; 2])> = None;
        let radii = [0.4, 0.6, 0.8, 1.0].map(|part| ((self.radius as f64 * part) as i64).max(3));
        let slopes = self.slopes(window);
        for (part, &radius) in radii.iter().enumerate() {
            // Centres lie at every half value: `sx` and `sy` are twice the shift.
            let score = |sx: i64, sy: i64| {
                let [cx, cy] = self.middle();
                let mut sums = Sums::default();
                for y in -radius..=radius {
                    for x in -radius..=radius {
                        let there = self.at(window, cx + x + sx.div_euclid(2), cy + y + sy.div_euclid(2));
                        let turned = self.at(
                            window,
                            cx - x - 1 + sx - sx.div_euclid(2) + self.width % 2,
                            cy - y - 1 + sy - sy.div_euclid(2) + self.height % 2,
                        );
                        if let Some((a, b)) = there.zip(turned).filter(|_| x * x + y * y <= radius * radius) {
                            sums.add(a, b);
                        }
                    }
                }
                sums.correlation()
            };
            let (found, value) = peak(2 * self.reach, score);
            if value > SYMMETRIC
                && best.is_none_or(|b| value > b.0)
                && let Some(found) = found.map(|f| [0.5 * f[0], 0.5 * f[1]])
                && self.turns_into_itself(&slopes, found, &radii[part..])
            {
                best = Some((value, found));
            }
        }
        best.map(|b| b.1)
    }

    /// Mean of the windows whose shift is known, each shifted.
    pub(super) fn stacked(&self, windows: &[&Values], shifts: &[Option<[f64; 2]>]) -> Vec<f32> {
        let mut mean = vec![0.0f32; (self.width * self.height) as usize];
        let known: Vec<(&&Values, [f64; 2])> =
            windows.iter().zip(shifts).filter_map(|(w, s)| Some((w, (*s)?))).collect();
        for (k, out) in mean.iter_mut().enumerate() {
            let (x, y) = (k as i64 % self.width, k as i64 / self.width);
            let sum: f64 = known
                .iter()
                .map(|(w, s)| {
                    let (fx, fy) = (x as f64 + s[0], y as f64 + s[1]);
                    let (i, j) = (fx.floor(), fy.floor());
                    let value = |di: i64, dj: i64| {
                        let clamp = |v: i64, n: i64| v.clamp(0, n - 1);
                        let (i, j) = (clamp(i as i64 + di, self.width), clamp(j as i64 + dj, self.height));
                        f64::from(w[(j * self.width + i) as usize])
                    };
                    let line = |dj: i64| [value(0, dj), value(1, dj)];
                    by_differences([line(0), line(1)], [fx - i, fy - j])
                })
                .sum();
            *out = (sum / known.len().max(1) as f64) as f32;
        }
        mean
    }
}

/// The highest score within `reach`, by the parabolas through its neighbours; no place where it lies at the rim.
fn peak(reach: i64, score: impl Fn(i64, i64) -> f64) -> (Option<[f64; 2]>, f64) {
    let mut best = (f64::MIN, 0, 0);
    for y in -reach..=reach {
        for x in -reach..=reach {
            let value = score(x, y);
            if value > best.0 {
                best = (value, x, y);
            }
        }
    }
    let (value, x, y) = best;
    if x.abs() == reach || y.abs() == reach {
        return (None, value);
    }
    let between = |a: f64, b: f64| {
        let bend = a + b - 2.0 * value;
        if bend < -1e-9 { (0.5 * (a - b) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    };
    let at =
        [x as f64 + between(score(x - 1, y), score(x + 1, y)), y as f64 + between(score(x, y - 1), score(x, y + 1))];
    (Some(at), value)
}

/// For a correlation.
#[derive(Default)]
struct Sums {
    n: f64,
    a: f64,
    b: f64,
    aa: f64,
    bb: f64,
    ab: f64,
}

impl Sums {
    fn add(&mut self, a: f64, b: f64) {
        self.n += 1.0;
        self.a += a;
        self.b += b;
        self.aa += a * a;
        self.bb += b * b;
        self.ab += a * b;
    }

    /// How many times as strongly the second shows what the first does.
    fn slope(&self) -> f64 {
        let n = self.n.max(1.0);
        let variance = self.aa - self.a * self.a / n;
        if variance > 1e-12 { (self.ab - self.a * self.b / n) / variance } else { 0.0 }
    }

    fn correlation(&self) -> f64 {
        let variance = |sum: f64, square: f64| square - sum * sum / self.n.max(1.0);
        let both = variance(self.a, self.aa) * variance(self.b, self.bb);
        if both > 1e-12 { (self.ab - self.a * self.b / self.n) / both.sqrt() } else { -1.0 }
    }
}
