//! Places that somebody pointed at, made exact: marks that look alike are laid on each other, and where what they have in common is
//! its own image turned by half a turn, its centre is the reference point. What neither says stays as it was pointed at.

use super::learn::Grid;

/// Half the side of the disc that is compared, millimetres.
const DISC_MM: f64 = 1.6;
/// Correlation from which two marks look alike, and from which one is its own image turned by half a turn.
const ALIKE: f64 = 0.6;
const SYMMETRIC: f64 = 0.85;
/// How far clicks may be off: pixels of the scan, and millimetres.
const REACH_PX: f64 = 8.0;
const REACH_MM: f64 = 0.15;

/// A window about a click, values row by row.
type Values = [f32];

/// By how much every click is moved, in values of the grid to the right and down: each window's own shift. `None` for windows that
/// look like no other and have no centre of symmetry.
pub(super) fn shifts(windows: &[&Values], grid: &Grid) -> Vec<Option<[f64; 2]>> {
    let field = Field::new(grid);
    let mut moved: Vec<Option<[f64; 2]>> = vec![None; windows.len()];
    let mut stack: Vec<f32> = windows.first().map_or(vec![], |w| w.to_vec());
    // What is common to all is clearer than in the first alone.
    for _ in 0..3 {
        for (window, shift) in windows.iter().zip(&mut moved) {
            *shift = field.register(&stack, window);
        }
        let known: Vec<[f64; 2]> = moved.iter().flatten().copied().collect();
        if known.len() < 2 {
            break;
        }
        // The clicks' own mean stays: nothing is known of what they share.
        let mean = [0, 1].map(|d| known.iter().map(|s| s[d]).sum::<f64>() / known.len() as f64);
        moved.iter_mut().flatten().for_each(|s| *s = [s[0] - mean[0], s[1] - mean[1]]);
        stack = field.stacked(windows, &moved);
    }
    if moved.iter().flatten().count() >= 2 {
        if let Some(centre) = field.symmetric_centre(&stack) {
            moved.iter_mut().flatten().for_each(|s| *s = [s[0] + centre[0], s[1] + centre[1]]);
        }
    } else {
        moved = vec![None; windows.len()];
    }
    for (window, shift) in windows.iter().zip(&mut moved).filter(|(_, s)| s.is_none()) {
        *shift = field.symmetric_centre(window);
    }
    moved
}

/// The values about the click that are compared.
struct Field {
    width: i64,
    height: i64,
    radius: i64,
    reach: i64,
}

impl Field {
    fn new(grid: &Grid) -> Field {
        let (width, height) = (grid.width as i64, grid.height as i64);
        let reach = REACH_PX.max(REACH_MM / grid.step_mm).round() as i64;
        let room = width.min(height) / 2 - 2;
        let radius = ((DISC_MM / grid.step_mm).round() as i64).min(room - reach / 2).max(3);
        Field { width, height, radius, reach: reach.min(room) }
    }

    fn at(&self, values: &Values, x: i64, y: i64) -> Option<f64> {
        let inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
        inside.then(|| f64::from(values[(y * self.width + x) as usize]))
    }

    fn middle(&self) -> [i64; 2] {
        [self.width / 2, self.height / 2]
    }

    /// Where in `window` the middle of `pattern` is, from its own middle.
    fn register(&self, pattern: &Values, window: &Values) -> Option<[f64; 2]> {
        let [cx, cy] = self.middle();
        let score = |dx: i64, dy: i64| {
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
            sums.correlation()
        };
        // Two clicks may be off in opposite directions.
        self.highest(2 * self.reach, ALIKE, score)
    }

    /// The middle of the half turn that changes least, from the window's middle.
    fn symmetric_centre(&self, window: &Values) -> Option<[f64; 2]> {
        let mut best: Option<(f64, [f64; 2])> = None;
        for part in [0.4, 0.6, 0.8, 1.0] {
            let radius = ((self.radius as f64 * part) as i64).max(3);
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
                && let Some(found) = found
            {
                best = Some((value, [0.5 * found[0], 0.5 * found[1]]));
            }
        }
        best.map(|b| b.1)
    }

    fn highest(&self, reach: i64, least: f64, score: impl Fn(i64, i64) -> f64) -> Option<[f64; 2]> {
        let (at, value) = peak(reach, score);
        at.filter(|_| value > least)
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

    #[test]
    fn clicks_that_are_off_are_moved_to_the_centres() {
        for (width, height) in [(80, 80), (81, 79)] {
            let grid = Grid { step_mm: 0.06, width, height };
            let middle = [0.5 * width as f64, 0.5 * height as f64];
            let off = [[2.0, -1.3], [-4.6, 0.4], [0.0, 5.0], [1.7, 1.7]];
            let made: Vec<Vec<f32>> = off.iter().map(|o| cross_at(&grid, middle[0] + o[0], middle[1] + o[1])).collect();
            let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
            for (found, true_off) in shifts(&windows, &grid).iter().zip(off) {
                let found = found.expect("crosses look alike");
                let error = (found[0] - true_off[0]).hypot(found[1] - true_off[1]);
                assert!(error < 0.2, "{found:?} for {true_off:?}");
            }
        }
    }
}
