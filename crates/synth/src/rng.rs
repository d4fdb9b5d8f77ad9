//! Random numbers that depend on a seed and a place, never on who asks first: the picture is the same for every thread
//! count and every cut into windows.

use autoref_raster::bilinear::by_differences;
use autoref_raster::normal;
use autoref_raster::random::SplitMix64;
pub use autoref_raster::random::mix;

/// A hash of a place on an integer lattice; odd x and y have the same as −x and −y.
#[inline]
pub fn hash2(seed: u64, x: i64, y: i64) -> u64 {
    mix(seed ^ (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f))
}

/// Streams of random numbers, one per purpose.
pub(crate) mod purpose {
    pub const VISIBLE: u64 = 2;
    pub const DISPLACE: u64 = 3;
    pub const MARK: u64 = 4;
    pub const CLUTTER: u64 = 5;
    pub const PLACED: u64 = 6;
    pub const MOSAIC: u64 = 7;
}

/// A sequence of its own for every purpose.
#[derive(Clone, Debug)]
pub struct Rng(SplitMix64);

impl Rng {
    /// One independent stream per (seed, purpose, index).
    pub fn new(seed: u64, purpose: u64, index: u64) -> Self {
        let state = mix(mix(seed ^ 0x5851_f42d_4c95_7f2d) ^ mix(purpose.wrapping_mul(0x1405_7b7e_f767_814f)) ^ index);
        Rng(SplitMix64(state))
    }

    /// The next 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        self.0.unit()
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform below `n`; 0 when `n` is 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n.saturating_sub(1))
    }

    /// True in a share, 0 to 1, of all calls.
    pub fn chance(&mut self, share: f64) -> bool {
        self.unit() < share
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        self.0.normal()
    }

    /// Puts the items in an order in which each is as likely as any other.
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}

/// Standard normal deviates from 12 bits by a table of quantiles, in 1/256 of a level: what a pixel of noise costs is
/// one look-up.
#[derive(Clone, Debug)]
pub struct NoiseTable {
    table: Vec<i32>,
    seed: u64,
}

impl NoiseTable {
    /// Noise with the standard deviation `sigma`, 8-bit levels.
    pub fn new(seed: u64, sigma: f64) -> Self {
        let n = 4096;
        let mut values: Vec<i32> = Vec::with_capacity(n);
        // The quantile function by bisection of erf; 4096 values once.
        for i in 0..n {
            let p = (i as f64 + 0.5) / n as f64;
            let (mut low, mut high) = (-6.0, 6.0);
            for _ in 0..50 {
                let mid = 0.5 * (low + high);
                if normal::below(mid) < p { low = mid } else { high = mid }
            }
            values.push((0.5 * (low + high) * sigma * 256.0).round() as i32);
        }
        NoiseTable { table: values, seed: mix(seed ^ 0x6e6f_6973) }
    }

    /// Noise of the three bands at a pixel, in 1/256 of an 8-bit level.
    #[inline]
    pub fn at(&self, x: u64, y: u64) -> [i32; 3] {
        let h = hash2(self.seed, x as i64, y as i64);
        [0, 12, 24].map(|shift| self.table[((h >> shift) & 4095) as usize])
    }
}

/// Value noise in [0, 1] at a place: hashed lattice values, smoothed between.
#[inline]
pub fn value_noise(seed: u64, x: f32, y: f32) -> f32 {
    let (i, j) = (floor(x), floor(y));
    between(&corners(seed, i, j), x - i as f32, y - j as f32)
}

/// [`value_noise`] of one seed for places one after another: what the corners of a cell are is kept while they lie in
/// it.
#[derive(Clone, Debug)]
pub struct ValueNoise {
    seed: u64,
    /// Column and row.
    cell: (i64, i64),
    corners: [[f32; 2]; 2],
}

impl ValueNoise {
    /// The noise of a seed.
    pub fn new(seed: u64) -> Self {
        ValueNoise { seed, cell: (0, 0), corners: corners(seed, 0, 0) }
    }

    /// The noise at a place.
    #[inline]
    pub fn at(&mut self, x: f32, y: f32) -> f32 {
        let (i, j) = (floor(x), floor(y));
        if i != self.cell.0 || j != self.cell.1 {
            self.cell = (i, j);
            self.corners = corners(self.seed, i, j);
        }
        between(&self.corners, x - i as f32, y - j as f32)
    }
}

/// By hand: the baseline instruction set makes a library call of `f32::floor`.
#[inline]
fn floor(t: f32) -> i64 {
    t as i64 - i64::from((t as i64 as f32) > t)
}

/// Lattice values about a cell, row by row.
#[inline]
fn corners(seed: u64, i: i64, j: i64) -> [[f32; 2]; 2] {
    let at = |i, j| (hash2(seed, i, j) >> 40) as f32 * (1.0 / 16_777_216.0);
    let line = |j| [at(i, j), at(i + 1, j)];
    [line(j), line(j + 1)]
}

#[inline]
fn between(corners: &[[f32; 2]; 2], fx: f32, fy: f32) -> f32 {
    let (sx, sy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    by_differences(*corners, [sx, sy])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_the_same_whatever_was_asked_before() {
        let mut noise = ValueNoise::new(7);
        let mut draws = Rng::new(3, 1, 0);
        for _ in 0..10_000 {
            let [x, y] = [0, 1].map(|_| draws.range(-3.0, 3.0) as f32);
            assert_eq!(noise.at(x, y), value_noise(7, x, y), "({x}, {y})");
        }
    }
}
