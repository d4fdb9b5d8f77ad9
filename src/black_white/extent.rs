//! How far a target reaches: rays from its middle.

use super::fit::Fit;
use super::grey::level;
use super::{Motif, Quarters, TargetDetector};
use autoref_raster::Patch;

/// Measurements of one target, image pixels.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    pub fit: Fit,
    pub side_px: f64,
    /// Shortest over longest arm (or quarter).
    pub evenness: f64,
    pub lights: Lights,
}

/// How many lights fall on a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lights {
    One,
    /// The border of a shadow crosses it.
    Two,
}

/// Arms and quarters are followed this far from the middle, in sides of the largest target.
pub const REACH_SIDES: f64 = 0.75;
/// The side of a saddle's square is at least this share of the smallest asked for.
pub const SMALLEST_SADDLE: f64 = 0.6;

/// Nothing is asked of what lies beside a ray.
pub const NO_FLANKS: [f64; 2] = [0.0; 2];

/// Rays from the middle of a fit, which are followed while they stay on their side of the middle level.
pub struct Rays<'a> {
    pub patch: &'a Patch,
    pub fit: &'a Fit,
    pub mid: f64,
    pub step: f64,
    pub longest: f64,
    /// What is on the wrong side for no longer than this is passed over, pixels.
    pub gap: f64,
}

impl<'a> Rays<'a> {
    /// From the middle of a fit, `longest` pixels at the most.
    pub fn new(patch: &'a Patch, fit: &'a Fit, longest: f64) -> Rays<'a> {
        let step = ((fit.widths[0] * fit.widths[1]).sqrt() / 8.0).clamp(0.5, 4.0);
        Rays { patch, fit, mid: fit.ground + 0.5 * fit.height, step, longest, gap: 2.0 * step }
    }

    fn bright(&self, x: f64, y: f64) -> Option<bool> {
        sample_at(self.patch, x, y, self.step).map(|v| (v > self.mid) == (self.fit.height > 0.0))
    }

    /// How far from the middle the target is bright (`on`) or not in a direction, and the contrary at `flanks` pixels
    /// clockwise of it (0: not asked for).
    pub fn follow(&self, direction: f64, on: bool, flanks: [f64; 2], from: f64) -> f64 {
        let (sin, cos) = direction.sin_cos();
        let (mut last, mut r) = (from, from);
        while r <= self.longest {
            let (x, y) = (self.fit.x + r * cos, self.fit.y + r * sin);
            let beside = |side: f64| side == 0.0 || self.bright(x - side * sin, y + side * cos) == Some(!on);
            if self.bright(x, y) == Some(on) && flanks.into_iter().all(beside) {
                last = r;
            } else if r - last > self.gap.max(0.16 * r) {
                break;
            }
            r += self.step;
        }
        last
    }
}

/// How far the four quarters of a saddle reach along their middles: the bright two, the dark two.
pub fn quarters(rays: &Rays<'_>) -> [f64; 4] {
    let (fit, quarter) = (rays.fit, std::f64::consts::FRAC_PI_2);
    let middle = (fit.angles[0] + fit.angles[1]) / 2.0;
    [(0.0, true), (2.0, true), (1.0, false), (3.0, false)]
        .map(|(turns, on)| rays.follow(middle + turns * quarter, on, NO_FLANKS, fit.blur.max(1.0)))
}

/// Side of the target and shortest over longest arm or quarter.
///
/// Along each arm of a cross both flanks are followed too: the arm ends with its plate. Of a saddle's quarters the pair
/// that ends first counts, because ground of the other pair's brightness does not end it.
pub fn extent(detector: &TargetDetector, patch: &Patch, fit: &Fit) -> Option<(f64, f64)> {
    let rays = Rays::new(patch, fit, REACH_SIDES * detector.side_px.1);
    let (low, high) = detector.side_px;
    match detector.motif {
        Motif::Cross => {
            let width = (fit.widths[0] * fit.widths[1]).sqrt();
            // Flanks two thirds of a width out: beyond the blurred border, before a letter's tape in most cases.
            let arms = [0, 1].map(|i| {
                let from = 0.5 * width;
                let flank = 0.5 * fit.widths[i] + (1.2 * fit.blur).max(0.2 * width);
                let from = from + flank;
                // An open quarter lies clockwise of the first arm and the other way round of the second.
                let both = [flank, -flank];
                let first = match (&detector.quarters, i) {
                    (Quarters::Clear, _) => both,
                    (Quarters::OneOpen(_), 0) => [0.0, -flank],
                    (Quarters::OneOpen(_), _) => [flank, 0.0],
                };
                [(0.0, first), (std::f64::consts::PI, both)]
                    .map(|(turn, flanks)| rays.follow(fit.angles[i] + turn, true, flanks, from))
            });
            let mut arms: Vec<f64> = arms.concat();
            arms.sort_by(f64::total_cmp);
            // A letter of tape beside an arm hides its end; the two longest and the shortest tell.
            let side = arms[1] + arms[2].max(arms[3] * 0.8);
            let possible = arms[0] > 1.15 * width && (0.7 * low..=1.4 * high).contains(&side);
            possible.then(|| (side, arms[0] / arms[3]))
        }
        Motif::Saddle => {
            let [a, b, c, d] = quarters(&rays);
            // Half a diagonal is side/√2.
            let side = std::f64::consts::SQRT_2 * a.min(b).min(c).min(d);
            let evenness = (a.min(b) / a.max(b)).max(c.min(d) / c.max(d));
            (SMALLEST_SADDLE * low..=1.5 * high).contains(&side).then_some((side, evenness))
        }
    }
}

/// Mean of the pixels in a square of about `size` about a place; `None` outside the patch or on nothing.
pub fn sample_at(patch: &Patch, x: f64, y: f64, size: f64) -> Option<f64> {
    let half = ((size - 1.0) / 2.0).max(0.0);
    let column = |v: f64, start: u64, len: u64| {
        let index = (v - start as f64).floor();
        (index >= 0.0 && index < len as f64).then_some(index as u64)
    };
    let (w, h) = (patch.window.width, patch.window.height);
    let (x0, x1) = (column(x - half, patch.window.x, w)?, column(x + half, patch.window.x, w)?);
    let (y0, y1) = (column(y - half, patch.window.y, h)?, column(y + half, patch.window.y, h)?);
    let (mut sum, mut n) = (0.0, 0.0);
    for i in (y0..=y1).flat_map(|v| (x0..=x1).map(move |u| (v * w + u) as usize)) {
        if !patch.valid[i] {
            return None;
        }
        sum += level(patch.rgb[i], patch.white);
        n += 1.0;
    }
    Some(sum / n)
}
