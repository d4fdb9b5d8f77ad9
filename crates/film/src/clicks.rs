//! Places that somebody pointed at, made exact: marks that look alike are laid on each other, and where what they have
//! in common is its own image turned by half a turn, edge on edge, its centre is the reference point, where clicks may
//! have missed it. Of other marks it is the mean of the clicks. What neither says stays as it was pointed at.

use super::learn::Grid;

/// Half the side of the disc that is compared, millimetres.
const DISC_MM: f64 = 1.6;
/// Correlation from which two marks look alike, and from which one is its own image turned by half a turn.
const ALIKE: f64 = 0.6;
/// Correlation of edges from which a mark in front of terrain is seen, from which it shows the same as the others, and
/// contrast, of theirs, below which it is faint.
const SEEN: f64 = 0.45;
const SAME: f64 = 0.8;
const FAINT: f64 = 0.5;
/// What changes over more than this is terrain or light, not an edge: half the side of the box whose mean is taken
/// away, millimetres.
const EDGE_MM: f64 = 0.35;
const SYMMETRIC: f64 = 0.85;
/// Correlation of edges, as vectors, from which a half turn lays a mark on itself: a solid half disc covers itself well
/// when it is turned, its edges do not.
const EDGE_ON_EDGE: f64 = 0.75;
/// Steepness of a disc's rim, so many values wide, against the whole from which the mark goes on beyond it.
const GOES_ON: f64 = 0.25;
const RIM: f64 = 2.5;
/// Edges that cross have this share of the steepness in the direction of less of it: their crossing is its own image
/// wherever they lead. A straight edge or bar alone is that at each of its points.
const CROSSING: f64 = 0.25;
/// A centre of symmetry is no further from the mean of clicks than this, values of the grid, or than so many standard
/// deviations of that mean.
const NEAR_CLICKS: f64 = 3.0;
const NEAR_SIGMAS: f64 = 3.0;
/// No reference point is known better, values of the grid.
const LEAST_SIGMA: f64 = 0.15;
/// How far clicks may be off: pixels of the scan, and millimetres.
const REACH_PX: f64 = 8.0;
const REACH_MM: f64 = 0.15;

/// A window about a click, values row by row.
type Values = [f32];

/// What is known of the centre of a mark that was pointed at; shifts in values of the grid, to the right and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Centre {
    /// It shows the same as others.
    Same([f64; 2]),
    /// It shows what others do, but so faintly that theirs tell better what it looks like.
    Faint([f64; 2]),
    /// It tells by itself, or it is like others but not the same.
    Own([f64; 2]),
    /// It looks like no other and has no centre of symmetry.
    AsPointed,
}

impl Centre {
    pub fn shift(self) -> Option<[f64; 2]> {
        match self {
            Centre::Same(shift) | Centre::Faint(shift) | Centre::Own(shift) => Some(shift),
            Centre::AsPointed => None,
        }
    }
}

/// A centre and its standard deviation, values of the grid: what clicks leave where no symmetry tells the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Told {
    pub centre: Centre,
    pub sigma: f64,
}

/// The centre of what every window shows.
pub(super) fn centres(windows: &[&Values], grid: &Grid) -> Vec<Told> {
    let field = Field::new(grid);
    // The first may be the one that shows least: then another, on which most can be laid.
    let most = windows.len() / 2 + 1;
    let count = |moved: &[Option<[f64; 2]>]| moved.iter().flatten().count();
    let mut tries = (0..windows.len()).map(|first| field.laid_on(windows, first));
    let mut moved = tries.next().unwrap_or_default();
    if count(&moved) < most {
        moved = tries.find(|m| count(m) >= most).unwrap_or(moved);
    }
    let mut found = vec![Centre::AsPointed; windows.len()];
    let mut shared_sigma = 0.0;
    if count(&moved) >= 2 {
        let stack = field.stacked(windows, &moved);
        let squares: f64 = moved.iter().flatten().map(|s| s[0] * s[0] + s[1] * s[1]).sum();
        let n = count(&moved) as f64;
        let of_mean = (squares / (2.0 * (n - 1.0)) / n).sqrt();
        let symmetric = field.symmetric_centre(&stack).map(|centre| (centre, field.spread(windows, &moved, centre)));
        let (centre, sigma) = settled(symmetric, of_mean);
        shared_sigma = sigma;
        let edges = field.edges(&stack);
        for ((window, shift), found) in windows.iter().zip(&mut moved).zip(&mut found) {
            *found = match field.compare(&edges, &field.edges(window), *shift) {
                Some((shift, alike)) => {
                    let shift = [shift[0] + centre[0], shift[1] + centre[1]];
                    if alike.correlation > SAME {
                        Centre::Same(shift)
                    } else if alike.contrast < FAINT {
                        Centre::Faint(shift)
                    } else {
                        Centre::Own(shift)
                    }
                }
                None => Centre::AsPointed,
            };
        }
    }
    let click_sigma = sigma_of_clicks(&found);
    let told = |(window, centre): (&&Values, Centre)| {
        if centre != Centre::AsPointed {
            return Told { centre, sigma: shared_sigma };
        }
        // Alone there is one click, and it is its own mean.
        match (field.symmetric_centre(window), settled(field.symmetric_centre(window).map(|c| (c, 0.0)), click_sigma)) {
            (Some(own), (shift, sigma)) if own == shift => Told { centre: Centre::Own(shift), sigma },
            (_, (_, sigma)) => Told { centre, sigma },
        }
    };
    windows.iter().zip(found).map(told).collect()
}

/// What a half turn does to the edges in a disc.
struct HalfTurn {
    /// Correlation of the slopes, which change their sign.
    fit: f64,
    /// Steepness of the disc's rim against all of it.
    rim: f64,
    /// Ratio of the smaller to the larger principal moment of the slopes: 0 of parallel edges, 1 of a right cross.
    crossing: f64,
}

/// The reference point of marks from the mean of their clicks, and its standard deviation: their centre of symmetry,
/// with its own, where it lies as near as the mean's allows. Further away it is another point, or the clicks are all
/// wrong: then the mean stays, no better than both are apart.
fn settled(symmetric: Option<([f64; 2], f64)>, of_mean: f64) -> ([f64; 2], f64) {
    let Some((centre, sigma)) = symmetric else { return ([0.0; 2], of_mean.max(LEAST_SIGMA)) };
    let away = centre[0].hypot(centre[1]);
    let allowed = NEAR_CLICKS.max(NEAR_SIGMAS * 2f64.sqrt() * of_mean);
    if away <= allowed { (centre, sigma.max(LEAST_SIGMA)) } else { ([0.0; 2], of_mean.max(away / 2f64.sqrt())) }
}

/// Standard deviation of a click along one axis, by those that are known to be off; 0 where none is.
fn sigma_of_clicks(found: &[Centre]) -> f64 {
    let known: Vec<[f64; 2]> = found.iter().filter_map(|c| c.shift()).collect();
    let squares: f64 = known.iter().map(|s| s[0] * s[0] + s[1] * s[1]).sum();
    (squares / (2 * known.len().max(1)) as f64).sqrt()
}

/// How alike two windows are where one lies on the other.
#[derive(Clone, Copy, Debug)]
struct Alike {
    correlation: f64,
    /// How strongly the second shows what the first does.
    contrast: f64,
}

/// The values about the click that are compared.
struct Field {
    width: i64,
    height: i64,
    radius: i64,
    reach: i64,
    /// Half the side of the box that tells edges from terrain.
    edge: usize,
}

impl Field {
    fn new(grid: &Grid) -> Field {
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
            *shift = shift.filter(|_| alike.is_some_and(|(_, a)| a.correlation > ALIKE));
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
    fn compare(&self, pattern: &Values, window: &Values, known: Option<[f64; 2]>) -> Option<([f64; 2], Alike)> {
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
    fn edges(&self, window: &Values) -> Vec<f32> {
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

    /// Standard deviation of a centre that all windows share, by what each tells alone.
    fn spread(&self, windows: &[&Values], moved: &[Option<[f64; 2]>], centre: [f64; 2]) -> f64 {
        let alone = |(window, shift): (&&Values, &Option<[f64; 2]>)| {
            let (own, shift) = (self.symmetric_centre(window)?, (*shift)?);
            Some((own[0] - shift[0] - centre[0]).powi(2) + (own[1] - shift[1] - centre[1]).powi(2))
        };
        let squares: Vec<f64> = windows.iter().zip(moved).filter_map(alone).collect();
        let n = squares.len() as f64;
        if n < 2.0 { LEAST_SIGMA } else { (squares.iter().sum::<f64>() / (2.0 * n) / n).sqrt() }
    }

    /// How steep the smoothed window is, across and down; `None` at its rim.
    fn slopes(&self, window: &Values) -> Vec<Option<[f64; 2]>> {
        let smooth = |x: i64, y: i64| -> Option<f64> {
            let mut sum = 0.0;
            for (dy, wy) in [(-1, 1.0), (0, 2.0), (1, 1.0)] {
                for (dx, wx) in [(-1, 1.0), (0, 2.0), (1, 1.0)] {
                    sum += wx * wy * self.at(window, x + dx, y + dy)?;
                }
            }
            Some(sum / 16.0)
        };
        let slope = |k: i64| {
            let (x, y) = (k % self.width, k / self.width);
            let across = smooth(x + 1, y)? - smooth(x - 1, y)?;
            Some([across, smooth(x, y + 1)? - smooth(x, y - 1)?])
        };
        (0..self.width * self.height).map(slope).collect()
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
    fn symmetric_centre(&self, window: &Values) -> Option<[f64; 2]> {
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
    fn stacked(&self, windows: &[&Values], shifts: &[Option<[f64; 2]>]) -> Vec<f32> {
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
                    let top = value(0, 0) + (value(1, 0) - value(0, 0)) * (fx - i);
                    let bottom = value(0, 1) + (value(1, 1) - value(0, 1)) * (fx - i);
                    top + (bottom - top) * (fy - j)
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

#[cfg(test)]
mod tests {
    use super::*;

    fn cross_at(grid: &Grid, x: f64, y: f64) -> Vec<f32> {
        let soft = |d: f64| (-0.5 * d * d).exp();
        (0..grid.width * grid.height)
            .map(|k| {
                let (u, v) = ((k % grid.width) as f64 + 0.5 - x, (k / grid.width) as f64 + 0.5 - y);
                let arms = if u.abs().max(v.abs()) < 14.0 { soft(u).max(soft(v)) } else { 0.0 };
                (arms + 0.02 * ((k * 7919) % 13) as f64 / 13.0) as f32
            })
            .collect()
    }

    /// Half discs are no images of themselves: nothing but the clicks' mean tells where their centre is, and they
    /// scatter by what is known.
    #[test]
    fn clicks_on_marks_without_symmetry_say_how_good_they_are() {
        let grid = Grid { step_mm: 0.06, width: 80, height: 80 };
        let off = [[2.0, -1.3], [-4.6, 0.4], [0.0, 5.0], [2.6, -4.1]];
        let made = off.map(|o| -> Vec<f32> {
            let wedge = |k: usize| {
                let (u, v) = ((k % 80) as f64 + 0.5 - 40.0 - o[0], (k / 80) as f64 + 0.5 - 40.0 - o[1]);
                let depth = (0.45 * -v - u.abs()).clamp(0.0, 1.0) * (v + 20.0).clamp(0.0, 1.0);
                depth as f32 + 0.02 * ((k * 7919) % 13) as f32 / 13.0
            };
            (0..6400).map(wedge).collect()
        });
        let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
        let squares: f64 = off.iter().map(|o| o[0] * o[0] + o[1] * o[1]).sum();
        let expected = (squares / 6.0 / 4.0).sqrt();
        for (told, o) in centres(&windows, &grid).iter().zip(off) {
            assert!((told.sigma - expected).abs() < 0.1 * expected, "{told:?}, {expected}");
            let shift = told.centre.shift().expect("wedges look alike");
            assert!((shift[0] - o[0]).hypot(shift[1] - o[1]) < 0.3, "{shift:?} for {o:?}");
        }
    }

    /// What lies inside of a shape, in values from its reference point, with grain.
    fn solid(size: (usize, usize), off: [f64; 2], inside: impl Fn(f64, f64) -> bool) -> Vec<f32> {
        let middle = [0.5 * size.0 as f64 + off[0], 0.5 * size.1 as f64 + off[1]];
        let covered = |k: usize| {
            let (x, y) = ((k % size.0) as f64, (k / size.0) as f64);
            let parts = (0..36).filter(|s| {
                let at = |p: usize| (p as f64 + 0.5) / 6.0;
                inside(x + at(s % 6) - middle[0], y + at(s / 6) - middle[1])
            });
            parts.count() as f32 / 36.0 + 0.04 * ((k * 7919) % 13) as f32 / 13.0
        };
        (0..size.0 * size.1).map(covered).collect()
    }

    /// A shape by its name, as whether a place in values from its reference point lies inside.
    type Solid = (&'static str, fn(f64, f64) -> bool);

    /// Solid shapes cover themselves well under half a turn about their middle, which is not their reference point:
    /// exact clicks stay.
    #[test]
    fn exact_clicks_on_solid_shapes_stay() {
        let shapes: [Solid; 4] = [
            ("half disc", |u, v| u.hypot(v) < 16.0 && v < 0.0),
            ("quarter of a disc", |u, v| u.hypot(v) < 20.0 && v < 0.0 && u > 0.0),
            ("triangle", |u, v| v > 0.0 && v < 24.0 && u.abs() < 0.6 * v),
            ("box open above", |u, v| u.abs().max(v.abs()) < 13.0 && !(u.abs() < 9.0 && v < 9.0)),
        ];
        let off = [[0.1, -0.1], [-0.2, 0.1], [0.0, 0.1], [0.1, -0.1]];
        for (name, inside) in shapes {
            let made = off.map(|o| solid((80, 80), o, inside));
            let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
            for (told, o) in centres(&windows, &Grid { step_mm: 0.06, width: 80, height: 80 }).iter().zip(off) {
                let shift = told.centre.shift().expect("they look alike");
                let error = (shift[0] - o[0]).hypot(shift[1] - o[1]);
                assert!(error < 0.3 && told.sigma < 0.5, "{name}: {told:?} for {o:?}");
            }
        }
    }

    /// Dots are their own images, but all clicks are 6 values off to one side: the centre is not where it was pointed
    /// at, and nobody is told a point that he did not mean without a doubt.
    #[test]
    fn a_centre_far_from_all_clicks_is_doubtful() {
        let made: Vec<Vec<f32>> =
            [[6.0, 0.1], [5.9, -0.1], [6.1, 0.0]].map(|o| solid((80, 80), o, |u, v| u.hypot(v) < 8.0)).to_vec();
        let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
        for told in centres(&windows, &Grid { step_mm: 0.06, width: 80, height: 80 }) {
            let shift = told.centre.shift().expect("they look alike");
            assert!(shift[0].hypot(shift[1]) < 0.5 && told.sigma > 3.0, "{told:?}");
        }
    }

    #[test]
    fn clicks_that_are_off_are_moved_to_the_centres() {
        for (width, height) in [(80, 80), (81, 79)] {
            let grid = Grid { step_mm: 0.06, width, height };
            let middle = [0.5 * width as f64, 0.5 * height as f64];
            let off = [[2.0, -1.3], [-4.6, 0.4], [0.0, 5.0], [1.7, 1.7]];
            let made: Vec<Vec<f32>> = off.iter().map(|o| cross_at(&grid, middle[0] + o[0], middle[1] + o[1])).collect();
            let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
            for (found, true_off) in centres(&windows, &grid).iter().zip(off) {
                let found = found.centre.shift().expect("crosses look alike");
                let error = (found[0] - true_off[0]).hypot(found[1] - true_off[1]);
                assert!(error < 0.2, "{found:?} for {true_off:?}");
            }
        }
    }
}
