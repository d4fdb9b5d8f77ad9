//! Crosses with a fifth arm: the strip of a plate's number that runs into the crossing.
//!
//! The strip fills one of the four quarters between the arms, so the least of the differences on the ring says nothing
//! there. Without that quarter much else answers, corners of roofs and gaps in leaves, five times as many regions. So a
//! cell that answers must also look like arms and plate in the whole disc about it, which costs a hundred sums and
//! leaves three answers in a hundred.

use super::extent::Seen;
use super::fit::Start;
use super::grey::Plane;
use super::kernels::Sample;
use super::response::{Around, RINGS, Ring};

/// Most that the levels of arms and of plate may vary within themselves, as a share of all their variance. Of 294 drawn
/// plates 1 in 100 has more at its best cell; of 7,400 cells that answered in five photographs 97 in 100.
const MOST_MIXED: f64 = 0.35;
/// What least squares leave over at most of what robust rounds may still make a cross: 98 of 100 drawn
/// plates leave less.
pub const MOST_LEFT: f64 = 0.25;
/// The disc, what is surely arm and what is surely plate, in radii of the ring.
const DISC: f64 = 1.25;
const ARM: f64 = 0.2;
const PLATE: f64 = 0.45;

/// What the fit cannot see of its own error when arms taper, in widths of an arm: without one of the four edges that
/// meet there the taper does not cancel. Measured on drawn plates seen from 4 to 40 sides away, up to 20° askew.
pub const TAPER: f64 = 0.001;
/// A strip at an acute angle to an arm can be taken for it in the disc, so more than the likeliest way is looked at.
pub const WAYS: usize = 3;

/// Cells between the arms that follow an arm clockwise; the arms themselves come last.
const PARTS: usize = 5;
const ARMS: usize = 4;

/// Which cells about one are arms and quarters of a cross, for four ways that its arms may lie.
pub struct Disc {
    ring: &'static Ring,
    offsets: Vec<(isize, isize)>,
    /// Of each cell and each way the part that it belongs to.
    parts: Vec<[Option<usize>; 4]>,
}

/// Number, sum and sum of squares of grey levels.
#[derive(Clone, Copy, Default)]
struct Levels {
    n: u32,
    sum: u32,
    squares: u32,
}

impl Levels {
    fn add(&mut self, level: u8) {
        let level = u32::from(level);
        (self.n, self.sum, self.squares) = (self.n + 1, self.sum + level, self.squares + level * level);
    }

    fn mean(&self) -> f64 {
        f64::from(self.sum) / f64::from(self.n)
    }

    fn variance(&self) -> f64 {
        f64::from(self.squares) / f64::from(self.n) - self.mean().powi(2)
    }
}

impl Disc {
    pub fn of(ring: &'static Ring) -> Disc {
        let reach = ring.reach as isize;
        let square = (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (x, y)));
        let offsets: Vec<_> = square.filter(|&(x, y)| (x as f64).hypot(y as f64) <= DISC * ring.radius).collect();
        let parts = offsets.iter().map(|&at| [0, 1, 2, 3].map(|way| part(ring, way, at))).collect();
        Disc { ring, offsets, parts }
    }

    /// Whether something at a cell that is the ring's reach from the plane's edge answers with at least `least`.
    pub fn answers(&self, plane: &Plane, at: (usize, usize), least: u8) -> bool {
        !self.look(plane, at, least).is_empty()
    }

    /// The ways in which a cross may lie there, the likeliest first: the least difference between arms and the three
    /// clear quarters, whether the arms are bright, and the sample of the ring at the arm that the open quarter follows
    /// clockwise.
    pub fn look(&self, plane: &Plane, (column, row): (usize, usize), least: u8) -> Vec<(u8, bool, usize)> {
        let cell = |x: isize, y: isize| plane.row(row.wrapping_add_signed(y))[column.wrapping_add_signed(x)];
        let samples = self.ring.offsets.map(|(x, y)| cell(x as isize, y as isize));
        let response = strongest(&samples, cell(0, 0));
        if response < least.max(1) {
            return Vec::new();
        }
        let mut sums = [[Levels::default(); PARTS]; 4];
        for (&(x, y), parts) in self.offsets.iter().zip(&self.parts) {
            let level = cell(x, y);
            for (sums, part) in sums.iter_mut().zip(parts) {
                if let Some(part) = *part {
                    sums[part].add(level);
                }
            }
        }
        let ways = (0..4).flat_map(|way| (0..4).map(move |open| (way, open)));
        let mut mixed: Vec<_> = ways.map(|(way, open)| (mixed(&sums[way], open), way + 4 * open)).collect();
        mixed.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        if mixed[0].0.0 > MOST_MIXED {
            return Vec::new();
        }
        mixed.iter().take(WAYS).map(|&((_, bright), sample)| (response, bright, sample)).collect()
    }
}

/// The part of a cross that a cell belongs to whose first arm goes through sample `way` of the ring.
fn part(ring: &Ring, way: usize, (x, y): (isize, isize)) -> Option<usize> {
    let (x, y) = (x as f64, y as f64);
    let (to_x, to_y) = ring.offsets[way];
    let (sin, cos) = f64::from(to_y).atan2(f64::from(to_x)).sin_cos();
    let (u, v) = ((cos * x + sin * y) / ring.radius, (cos * y - sin * x) / ring.radius);
    if u.abs().min(v.abs()) < ARM {
        return Some(ARMS);
    }
    let quarter = match (u > 0.0, v > 0.0) {
        (true, true) => 0,
        (false, true) => 1,
        (false, false) => 2,
        (true, false) => 3,
    };
    (u.abs().min(v.abs()) > PLATE).then_some(quarter)
}

/// How much arms and plate vary within themselves when a quarter may be anything, as a share of all their variance,
/// and whether the arms are the brighter.
fn mixed(parts: &[Levels; PARTS], open: usize) -> (f64, bool) {
    let mut plate = Levels::default();
    for (_, quarter) in parts[..ARMS].iter().enumerate().filter(|(k, _)| *k != open) {
        plate.n += quarter.n;
        plate.sum += quarter.sum;
        plate.squares += quarter.squares;
    }
    let arms = &parts[ARMS];
    let within = (arms.variance() + plate.variance()) / 2.0;
    let apart = arms.mean() - plate.mean();
    (within / (within + apart * apart / 4.0).max(1e-9), apart > 0.0)
}

fn strongest(samples: &[u8; 16], middle: u8) -> u8 {
    let (mut with_all, mut open) = ([0], [0]);
    let ring = std::array::from_fn(|k| &samples[k..=k]);
    answer(&Around { ring, centre: &[middle] }, &mut with_all, &mut open);
    open[0]
}

/// Responses of a row's cells to crosses (`out`) and to those one of whose quarters may be anything (`open`). Returns
/// how many there are, as [`super::response::respond`] does.
pub fn respond(plane: &Plane, ring: &Ring, row: usize, out: &mut Vec<u8>, open: &mut Vec<u8>) -> usize {
    out.clear();
    open.clear();
    let Some(around) = Around::of_row(plane, ring, row) else { return 0 };
    out.resize(around.centre.len(), 0);
    open.resize(around.centre.len(), 0);
    answer(&around, out, open);
    out.len()
}

fn answer(around: &Around<'_>, out: &mut [u8], open: &mut [u8]) {
    let n = out.len();
    let ring = around.ring.map(|s| &s[..n]);
    let centre = &around.centre[..n];
    let open = &mut open[..n];
    for i in 0..n {
        // Of four samples at quarter turns the least and the next, the greatest and the next.
        let (mut low, mut next_low, mut high, mut next_high) = ([0u8; 4], [0u8; 4], [0u8; 4], [0u8; 4]);
        for k in 0..4 {
            let (a, b, c, d) = (ring[k][i], ring[k + 4][i], ring[k + 8][i], ring[k + 12][i]);
            let (least_1, most_1, least_2, most_2) = (a.min(b), a.max(b), c.min(d), c.max(d));
            let (one, two) = (least_1.max(least_2), most_1.min(most_2));
            low[k] = least_1.min(least_2);
            next_low[k] = one.min(two);
            high[k] = most_1.max(most_2);
            next_high[k] = one.max(two);
        }
        let middle = centre[i];
        let (mut best, mut best_open) = (0u8, 0u8);
        for k in 0..4 {
            let other = (k + 2) % 4;
            let (bright, dark) = (low[k].min(middle), high[k].max(middle));
            best = best.max(bright.saturating_sub(high[other]));
            best = best.max(low[other].saturating_sub(dark));
            best_open = best_open.max(bright.saturating_sub(next_high[other]));
            best_open = best_open.max(next_low[other].saturating_sub(dark));
        }
        out[i] = best;
        open[i] = best_open;
    }
}

/// The discs of both rings.
pub fn discs() -> [Disc; 2] {
    [Disc::of(&RINGS[0]), Disc::of(&RINGS[1])]
}

/// Takes out the cells between the first arm and the second, where the fifth one is.
pub fn without_open_quarter(samples: &mut Vec<Sample>, cross: &Start) {
    samples.retain(|cell| depth(cross, cell) <= 0.0);
}

/// Takes out the strip, as far as it shows between the first arm and the second, and what it blurs.
///
/// The edges of these arms beyond it are worth having: seen from far below the arms taper, and without one edge in four
/// the taper shifts the crossing.
pub fn without_strip(samples: &mut Vec<Sample>, cross: &Start, middle: f64) {
    let margin = 1.5 * cross.blur + 0.5;
    let beyond = cross.width / 2.0 + margin;
    if cross.width < 2.0 * margin {
        // Too small for the strip to be told from the arms.
        return without_open_quarter(samples, cross);
    }
    let shows = |cell: &&Sample| (cell.level > middle) == (cross.height > 0.0) && depth(cross, cell) > beyond;
    let strip: Vec<(f64, f64)> = samples.iter().filter(shows).map(|cell| (cell.x, cell.y)).collect();
    // Where strip and arm meet at an acute angle, the strip shows no nearer than this.
    let near = 2.0 * margin + 1.0;
    samples
        .retain(|cell| depth(cross, cell) <= 0.0 || strip.iter().all(|(x, y)| (cell.x - x).hypot(cell.y - y) > near));
}

/// How far a cell lies from the axes of the first arm and the second, towards each other; not above zero elsewhere.
fn depth(cross: &Start, cell: &Sample) -> f64 {
    let (dx, dy) = (cell.x - cross.x, cell.y - cross.y);
    let [(sin_0, cos_0), (sin_1, cos_1)] = cross.angles.map(f64::sin_cos);
    (cos_0 * dy - sin_0 * dx).min(sin_1 * dx - cos_1 * dy)
}

/// Whether a cross with an open quarter is one: arms as long as each other within a factor, and a centre that is known.
/// Plates have at most 0.013 of a width; glare and lattices that fit have more, or arms of all lengths.
pub fn holds(seen: &Seen) -> bool {
    const LEAST_EVENNESS: f64 = 0.4;
    const MOST_UNSURE: f64 = 0.03;
    let width = (seen.fit.widths[0] * seen.fit.widths[1]).sqrt();
    let [xx, _, yy] = seen.fit.covariance;
    seen.evenness >= LEAST_EVENNESS && xx.max(yy).sqrt() <= MOST_UNSURE * width
}

/// Whether a fifth arm drew a cross that was found in spite of it: without one quarter the fit is much better, and the
/// centre another. Wrinkles are spread over all quarters, and a number that stands apart moves nothing.
pub fn drew(seen: &Seen, open: &Seen) -> bool {
    const FAR_BETTER: f64 = 0.4;
    /// Chi-square of two degrees of freedom, one in a thousand.
    const FAR: f64 = 13.8;
    let (dx, dy) = (open.fit.x - seen.fit.x, open.fit.y - seen.fit.y);
    let [xx, xy, yy] = std::array::from_fn(|i| open.fit.covariance[i] + seen.fit.covariance[i]);
    let squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
    open.fit.misfit < FAR_BETTER * seen.fit.misfit && squared > FAR
}

#[cfg(test)]
mod tests {
    use super::super::response::direction;
    use super::*;
    use crate::black_white::Motif;

    fn looked(ring: &'static Ring, level: impl Fn(f64, f64) -> f64) -> Vec<(u8, bool, usize)> {
        let data = (0..21 * 21).map(|i| level(f64::from(i % 21) - 10.0, f64::from(i / 21) - 10.0) as u8).collect();
        let plane = Plane { x: 0, y: 0, width: 21, height: 21, data };
        let disc = Disc::of(ring);
        let seen = disc.look(&plane, (10, 10), 60);
        let (mut out, mut open) = (Vec::new(), Vec::new());
        respond(&plane, ring, 10, &mut out, &mut open);
        assert!(seen.first().is_none_or(|first| first.0 == open[10 - ring.reach]), "rows and single cells agree");
        seen
    }

    /// The fifth arm is sought between the arm that is told and the next, whatever else is there.
    #[test]
    fn a_fifth_arm_is_told_from_the_others_and_three_arms_are_no_cross() {
        for ring in &RINGS {
            for degrees in (0..360).step_by(15) {
                let turn = f64::from(degrees).to_radians();
                let (sin, cos) = turn.sin_cos();
                let turned = |x: f64, y: f64| (cos * x + sin * y, cos * y - sin * x);
                let half = ring.radius / 3.4;
                for negative in [false, true] {
                    let grey = |bright: bool| if bright != negative { 200.0 } else { 30.0 };
                    let seen = looked(ring, |x, y| {
                        let (u, v) = turned(x, y);
                        let strip = u + v > 0.0 && (u - v).abs() < 1.2 * half;
                        grey(u.abs() < half || v.abs() < half || strip)
                    });
                    let towards = |sample: usize| {
                        let off = direction(ring, sample, Motif::Cross) - turn;
                        off.sin().atan2(off.cos()).abs() < 0.3
                    };
                    assert!(seen.iter().any(|way| way.1 != negative && towards(way.2)), "{degrees}°: {seen:?}");
                    let three = looked(ring, |x, y| {
                        let (u, v) = turned(x, y);
                        grey(u.abs() < half || (v.abs() < half && u > 0.0))
                    });
                    assert!(three.is_empty(), "{degrees}°: {three:?}");
                    let edge = looked(ring, |x, y| grey(turned(x, y).0 > 0.0));
                    assert!(edge.is_empty(), "{degrees}°: {edge:?}");
                }
            }
        }
    }

    /// What a strip covers is left out of the fit, and the edges of the arms beyond it stay.
    #[test]
    fn a_strip_is_taken_out_and_the_edges_beyond_it_stay() {
        let right = std::f64::consts::FRAC_PI_2;
        let cross = Start { x: 20.0, y: 20.0, angles: [0.0, right], width: 8.0, blur: 1.0, height: 200.0 };
        let on_strip = |x: f64, y: f64| x + y > 40.0 && (x - y).abs() < 3.0;
        let cells = || {
            (0..40 * 40).map(|i| (f64::from(i % 40) + 0.5, f64::from(i / 40) + 0.5)).map(|(x, y)| {
                let bright = (x - 20.0).abs() < 4.0 || (y - 20.0).abs() < 4.0 || on_strip(x, y);
                Sample { x, y, level: if bright { 220.0 } else { 20.0 } }
            })
        };
        let mut left: Vec<Sample> = cells().collect();
        without_strip(&mut left, &cross, 120.0);
        let beyond = |cell: &&Sample| cell.x > 24.0 && cell.y > 24.0;
        assert!(!left.iter().filter(beyond).any(|cell| on_strip(cell.x, cell.y)));
        assert!(left.iter().any(|cell| cell.x > 38.0 && (22.0..26.0).contains(&cell.y)), "the edge of an arm");
        assert_eq!(left.iter().filter(|c| c.x < 20.0 || c.y < 20.0).count(), 1200, "the other quarters");
        let mut left: Vec<Sample> = cells().collect();
        without_open_quarter(&mut left, &cross);
        assert_eq!(left.len(), 1200);
    }
}
