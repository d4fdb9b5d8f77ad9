//! The 2²⁴ colours that are paint, one bit each.
//!
//! Cubes of colours are split until one answer holds for the whole of each. What holds for a cube follows from interval
//! bounds: each coordinate of the distance is taken as linear in linear light, with a bound for how far it bends within
//! the cube. What the bounds leave open is asked of the scalar reference, so that they decide how long it takes and
//! nothing else.

use nalgebra::Matrix3;
use rayon::prelude::*;

use super::reference::PaintTest;
use crate::profile::colour::{Cloud, LAB_F_NEAR, LAB_KNEE, Space, lab_f, lab_f_near, lab_from_f, xyz_from_linear};
use crate::segment::kernels::Bounds;
use autoref_raster::srgb::linear_of_bytes;

/// What is known of a cube of colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// All are.
    Paint,
    /// None is.
    Ground,
    Mixed,
}

/// One cloud and its limit, in the coordinates that bounds are taken in: the squared distance is that of `basis · v`
/// from `centre`, v being red, green, blue, or the compressed X, Y, Z that L\*a\*b\* is made of.
#[derive(Clone, Debug)]
struct Ball {
    basis: [[f64; 3]; 3],
    centre: [f64; 3],
    limit2: f64,
}

impl Ball {
    /// `None` when rounding leaves of the cloud no ellipsoid.
    fn of(cloud: &Cloud, space: Space, limit2: f64) -> Option<Ball> {
        let root = cloud.weight.cholesky()?.l().transpose();
        let (lab, origin) = match space {
            Space::Rgb => (Matrix3::identity(), nalgebra::Vector3::zeros()),
            Space::Lab => {
                let origin = lab_from_f([0.0; 3]);
                let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|f| lab_from_f(f) - origin);
                (Matrix3::from_columns(&columns), origin)
            }
        };
        let (basis, centre) = (root * lab, root * (cloud.mean - origin));
        Some(Ball { basis: std::array::from_fn(|k| basis.row(k).transpose().into()), centre: centre.into(), limit2 })
    }

    /// A bound: mixed when in doubt.
    fn judge(&self, extent: &Extent) -> Verdict {
        // For rounding, here and in the reference.
        const SLACK: f64 = 1e-6;
        let (mut nearest2, mut farthest2) = (0.0, 0.0);
        for (row, centre) in self.basis.iter().zip(self.centre) {
            let (mut at, mut reach) = (-centre, 1e-9);
            let mut slope = [0.0; 3];
            for (j, weight) in row.iter().enumerate() {
                at += weight * extent.middle[j];
                reach += weight.abs() * extent.bend[j];
                for (c, slope) in slope.iter_mut().enumerate() {
                    *slope += weight * extent.slope[j][c];
                }
            }
            reach += slope[0].abs() + slope[1].abs() + slope[2].abs();
            let (near, far) = ((at.abs() - reach).max(0.0), at.abs() + reach);
            nearest2 += near * near;
            farthest2 += far * far;
        }
        match () {
            () if farthest2 < self.limit2 * (1.0 - SLACK) => Verdict::Paint,
            () if nearest2 > self.limit2 * (1.0 + SLACK) => Verdict::Ground,
            () => Verdict::Mixed,
        }
    }
}

/// What all colours of a cube are in the coordinates of a [`Ball`]: within `bend` of `middle` and, for each channel, up
/// to one `slope` more or less.
struct Extent {
    middle: [f64; 3],
    slope: [[f64; 3]; 3],
    bend: [f64; 3],
}

impl Extent {
    /// `xyz` are the weights of linear red, green and blue in X, Y and Z.
    fn new(space: Space, xyz: &[[f64; 3]; 3], low: [u8; 3], high: [u8; 3]) -> Extent {
        let mut extent = Extent { middle: [0.0; 3], slope: [[0.0; 3]; 3], bend: [0.0; 3] };
        if space == Space::Rgb {
            for c in 0..3 {
                let (lo, hi) = (f64::from(low[c]) / 255.0, f64::from(high[c]) / 255.0);
                extent.middle[c] = (lo + hi) / 2.0;
                extent.slope[c][c] = (hi - lo) / 2.0;
            }
            return extent;
        }
        let linear = linear_of_bytes();
        let (mut light, mut half) = ([0.0; 3], [0.0; 3]);
        for c in 0..3 {
            let (lo, hi) = (linear[usize::from(low[c])], linear[usize::from(high[c])]);
            (light[c], half[c]) = ((lo + hi) / 2.0, (hi - lo) / 2.0);
        }
        for (j, weights) in xyz.iter().enumerate() {
            let (mut t, mut reach) = (0.0, 0.0);
            for c in 0..3 {
                t += weights[c] * light[c];
                reach += weights[c] * half[c];
            }
            let f = lab_f_near(t);
            // The cube root's derivative; below the knee it is that at the knee.
            let rise = if t > LAB_KNEE { f / (3.0 * t) } else { lab_f(LAB_KNEE) / (3.0 * LAB_KNEE) };
            for c in 0..3 {
                extent.slope[j][c] = rise * weights[c] * half[c];
            }
            // Taylor: half the largest second derivative, 2/9 · t^(−5/3), times the square of the way.
            let root = lab_f_near((t - reach).max(LAB_KNEE));
            let root2 = root * root;
            extent.middle[j] = f;
            extent.bend[j] =
                1.001 * reach * reach / (9.0 * root2 * root2 * root) + 2.0 * LAB_F_NEAR * (f + rise * reach);
        }
        extent
    }
}

/// The clouds that a cube may touch, by number: profiles of many paints would ask all of them for every colour else.
#[derive(Clone, Copy)]
struct Near(u64);

impl Near {
    const ALL: Near = Near(u64::MAX);

    /// Clouds beyond the 64th always count as near.
    fn has(self, number: usize) -> bool {
        number >= 64 || self.0 >> number & 1 == 1
    }

    fn drop(&mut self, number: usize) {
        if number < 64 {
            self.0 &= !(1 << number);
        }
    }
}

/// The bounds behind the table.
struct Judge<'a> {
    test: &'a PaintTest,
    space: Space,
    clouds: Vec<Ball>,
    rough: Option<(Space, Ball)>,
    xyz: [[f64; 3]; 3],
}

impl<'a> Judge<'a> {
    /// `None` when no bound is to be had.
    fn of(test: &'a PaintTest) -> Option<Judge<'a>> {
        let clouds = test.clouds.iter().map(|cloud| Ball::of(cloud, test.space, test.limit2)).collect::<Option<_>>()?;
        let rough = match &test.rough {
            Some((space, limit2, cloud)) => Some((*space, Ball::of(cloud, *space, *limit2)?)),
            None => None,
        };
        let of_channel = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(xyz_from_linear);
        let xyz = std::array::from_fn(|j| of_channel.map(|column| column[j]));
        Some(Judge { test, space: test.space, clouds, rough, xyz })
    }

    /// What holds for every colour of the cube `low..=high`, and which of the clouds `near` still are; the others are
    /// too far from a cube that this one is a part of.
    fn judge(&self, low: [u8; 3], high: [u8; 3], near: Near) -> (Verdict, Near) {
        let test = self.test;
        if (0..3).any(|i| high[i] < test.low[i] || low[i] > test.high[i]) {
            return (Verdict::Ground, near);
        }
        let boxed = (0..3).all(|i| low[i] >= test.low[i] && high[i] <= test.high[i]);
        let extent = Extent::new(self.space, &self.xyz, low, high);
        let rough = match &self.rough {
            None => Verdict::Paint,
            Some((space, ball)) if *space == self.space => ball.judge(&extent),
            Some((space, ball)) => ball.judge(&Extent::new(*space, &self.xyz, low, high)),
        };
        if rough == Verdict::Ground {
            return (Verdict::Ground, near);
        }
        let (mut verdict, mut left) = (Verdict::Ground, near);
        for (number, ball) in self.clouds.iter().enumerate().filter(|(number, _)| near.has(*number)) {
            match ball.judge(&extent) {
                Verdict::Paint if boxed && rough == Verdict::Paint => return (Verdict::Paint, left),
                Verdict::Ground => left.drop(number),
                _ => verdict = Verdict::Mixed,
            }
        }
        (verdict, left)
    }
}

/// One bit for each 8-bit colour, red most significant.
pub(super) struct ColourTable {
    words: Vec<u64>,
    cells: Cells,
    pub bounds: Bounds,
}

/// What holds for all of the 8 × 8 × 8 colours of a cell, two bits each: 8 KiB, which stay in the nearest cache. The
/// table is asked where they differ only.
struct Cells(Vec<u64>);

impl Cells {
    const COUNT: usize = 1 << 15;
    const A_WORD: usize = 32;
    const NONE: u64 = 0;
    const SOME: u64 = 1;
    const ALL: u64 = 2;

    fn of(table: &[u64]) -> Cells {
        let mut cells = vec![0u64; Cells::COUNT / Cells::A_WORD];
        // Of one red and green the blues are four words, those of a cell eight bits of them.
        for (cell, (red, green)) in (0..32).flat_map(|r| (0..32).map(move |g| (8 * r, 8 * g))).enumerate() {
            let (mut any, mut all) = ([0u64; 4], [u64::MAX; 4]);
            for (r, g) in (red..red + 8).flat_map(|r| (green..green + 8).map(move |g| (r, g))) {
                let blues = &table[(r << 8 | g) * 4..][..4];
                for (k, word) in blues.iter().enumerate() {
                    any[k] |= word;
                    all[k] &= word;
                }
            }
            for blue in 0..32 {
                let eight = |words: &[u64; 4]| (words[blue / 8] >> (8 * (blue % 8))) as u8;
                let verdict = match (eight(&any), eight(&all)) {
                    (0, _) => Cells::NONE,
                    (_, 255) => Cells::ALL,
                    _ => Cells::SOME,
                };
                let at = cell * 32 + blue;
                cells[at / Cells::A_WORD] |= verdict << (2 * (at % Cells::A_WORD));
            }
        }
        Cells(cells)
    }

    fn get(&self, c: [u8; 3]) -> u64 {
        let at = usize::from(c[0] >> 3) << 10 | usize::from(c[1] >> 3) << 5 | usize::from(c[2] >> 3);
        self.0[at / Cells::A_WORD] >> (2 * (at % Cells::A_WORD)) & 3
    }
}

impl ColourTable {
    const SLAB_WORDS: usize = 16 * 65_536 / 64;

    /// What a test says of every colour.
    pub fn new(test: &PaintTest) -> ColourTable {
        let mut words = vec![0u64; (1 << 24) / 64];
        let judge = Judge::of(test);
        // Sixteen reds at a time, so that slabs are disjoint slices.
        let bounds = words
            .par_chunks_mut(Self::SLAB_WORDS)
            .enumerate()
            .map(|(slab, words)| fill_slab(test, judge.as_ref(), slab, words))
            .reduce(|| Bounds::NOTHING, |a, b| a.union(&b));
        ColourTable { cells: Cells::of(&words), words, bounds }
    }

    /// What the test says of a colour.
    pub fn get(&self, c: [u8; 3]) -> bool {
        let verdict = self.cells.get(c);
        if verdict != Cells::SOME {
            return verdict == Cells::ALL;
        }
        let index = usize::from(c[0]) << 16 | usize::from(c[1]) << 8 | usize::from(c[2]);
        self.words[index >> 6] >> (index & 63) & 1 == 1
    }
}

/// The colours with red `16·slab .. 16·slab + 16`.
fn fill_slab(test: &PaintTest, judge: Option<&Judge<'_>>, slab: usize, words: &mut [u64]) -> Bounds {
    let mut fill = Fill { test, judge, red: 16 * slab, words, bounds: Bounds::NOTHING };
    for (g, b) in (0..256).step_by(16).flat_map(|g| (0..256).step_by(16).map(move |b| (g, b))) {
        fill.cube([16 * slab, g, b], 16, Near::ALL);
    }
    fill.bounds
}

struct Fill<'a> {
    test: &'a PaintTest,
    judge: Option<&'a Judge<'a>>,
    /// Of the first word.
    red: usize,
    words: &'a mut [u64],
    bounds: Bounds,
}

impl Fill<'_> {
    /// Splits cubes until one answer holds for the whole of each; a single colour that the bounds leave open is asked
    /// exactly.
    fn cube(&mut self, [r, g, b]: [usize; 3], side: usize, near: Near) {
        let low = [r as u8, g as u8, b as u8];
        let high = low.map(|v| v + (side - 1) as u8);
        let (verdict, near) = self.judge.map_or((Verdict::Mixed, near), |judge| judge.judge(low, high, near));
        match verdict {
            Verdict::Ground => {}
            Verdict::Paint => {
                // A row of blues lies in one word: sides are powers of two up to 16, and cubes begin at multiples.
                let row = (u64::MAX >> (64 - side)) << (b & 63);
                for (r, g) in (r..r + side).flat_map(|r| (g..g + side).map(move |g| (r, g))) {
                    let word = self.word([r, g, b]);
                    self.words[word] |= row;
                }
                // Samples and their differences are extreme at corners.
                let far = |corner: usize, axis: usize| if corner >> axis & 1 == 1 { (side - 1) as u8 } else { 0 };
                (0..8).for_each(|k| self.bounds.admit(std::array::from_fn(|axis| low[axis] + far(k, axis))));
            }
            Verdict::Mixed if side > 1 => {
                let half = side / 2;
                for k in 0..8 {
                    self.cube([r + half * (k >> 2), g + half * (k >> 1 & 1), b + half * (k & 1)], half, near);
                }
            }
            Verdict::Mixed => {
                if table_bit(self.test, low, near) {
                    self.set([r, g, b]);
                    self.bounds.admit(low);
                }
            }
        }
    }

    fn set(&mut self, colour: [usize; 3]) {
        let word = self.word(colour);
        self.words[word] |= 1 << (colour[2] & 63);
    }

    /// Which word holds the bit of a colour.
    fn word(&self, [r, g, b]: [usize; 3]) -> usize {
        ((r - self.red) << 16 | g << 8 | b) >> 6
    }
}

/// [`PaintTest::is_paint`] with the powers of the sRGB curve looked up instead of computed; same numbers, same order.
/// Clouds that are not near are farther than the limit.
fn table_bit(test: &PaintTest, colour: [u8; 3], near: Near) -> bool {
    let all_in_lab = test.space == Space::Lab && test.rough.as_ref().is_none_or(|(space, ..)| *space == Space::Lab);
    if !all_in_lab {
        return test.is_paint(colour);
    }
    if (0..3).any(|i| !(test.low[i]..=test.high[i]).contains(&colour[i])) {
        return false;
    }
    let lab = lab_from_f(xyz_from_linear(colour.map(|v| linear_of_bytes()[usize::from(v)])).map(lab_f));
    if test.rough.as_ref().is_some_and(|(_, limit2, cloud)| cloud.distance2(&lab) > *limit2) {
        return false;
    }
    let clouds = test.clouds.iter().enumerate().filter(|(number, _)| near.has(*number));
    clouds.map(|(_, c)| c.distance2(&lab)).fold(f64::INFINITY, f64::min) / test.limit2 <= 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::Profile;

    /// Clouds that a cube leaves behind are none of its colours'.
    #[test]
    fn a_wheel_of_paints_is_the_same_bit_by_bit() {
        let test = PaintTest::new(&Profile::any_paint()).expect("valid");
        assert!(test.clouds.len() > 20);
        let table = ColourTable::new(&test);
        let mut found = [0; 2];
        for i in 0..150_000u64 {
            let bits = autoref_raster::random::mix(i);
            let colour = [24, 32, 40].map(|shift| (bits >> shift) as u8);
            let paint = test.is_paint(colour);
            assert_eq!(table.get(colour), paint, "{colour:?}");
            found[usize::from(paint)] += 1;
        }
        assert!(found.iter().all(|n| *n > 10_000), "{found:?}");
    }

    /// Whatever the bounds say of a cube holds for each of its colours, and they say it of small cubes that are not at
    /// the border.
    #[test]
    fn bounds_hold_for_every_colour_of_a_cube() {
        for name in ["orange", "autoref-2016", "white-on-dark"] {
            let test = PaintTest::new(&Profile::builtin(name).expect("shipped")).expect("valid");
            let judge = Judge::of(&test).expect("its clouds are ellipsoids");
            let mut draws = autoref_raster::random::Mmix(12_345);
            let mut decided = [0u32; 3];
            for i in 0..4000 {
                let random = draws.next_u64();
                let side = 1u8 << (i % 5);
                let low = [24, 32, 40].map(|shift| (random >> shift) as u8 / side * side);
                let (verdict, _) = judge.judge(low, low.map(|v| v + (side - 1)), Near::ALL);
                decided[verdict as usize] += 1;
                if verdict == Verdict::Mixed {
                    continue;
                }
                let n = usize::from(side);
                for k in 0..n * n * n {
                    let off = [k / (n * n), k / n % n, k % n].map(|v| v as u8);
                    let colour = std::array::from_fn(|c| low[c] + off[c]);
                    assert_eq!(
                        test.is_paint(colour),
                        verdict == Verdict::Paint,
                        "{name}: {colour:?} of {low:?} + {side}"
                    );
                }
            }
            assert!(decided[Verdict::Mixed as usize] < 1200, "{name}: {decided:?}");
        }
    }
}
