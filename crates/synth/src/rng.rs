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
    // Floor by hand: the baseline instruction set makes a library call of `f32::floor`.
    let floor = |t: f32| t as i64 - i64::from((t as i64 as f32) > t);
    let (i, j) = (floor(x), floor(y));
    let (fx, fy) = (x - i as f32, y - j as f32);
    let (sx, sy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    let at = |i, j| (hash2(seed, i, j) >> 40) as f32 * (1.0 / 16_777_216.0);
    let line = |j| [at(i, j), at(i + 1, j)];
    by_differences([line(j), line(j + 1)], [sx, sy])
}

#[cfg(test)]
mod tests {
    use super::hash2;

    #[test]
    fn places_have_numbers_of_their_own_and_other_ones_with_another_seed() {
        let places = || (0..10).flat_map(|x| (0..10).map(move |y| (x, y)));
        let numbers: std::collections::HashSet<u64> = places().map(|(x, y)| hash2(2016, x, y)).collect();
        assert_eq!(numbers.len(), 100);
        assert!(places().all(|(x, y)| hash2(2016, x, y) != hash2(2017, x, y)));
    }
}
