//! Bands that a scanner leaves along its rows or columns, removed in the frequency domain.
//!
//! After section 10.1.1 of the 2017 Svalbard thesis: in the Fourier transform of the image, bands that run along whole
//! rows (or columns) lie on one axis, and the lines beside that axis say what the ground would have there. The axis and
//! its neighbours are all that is needed, so the image is not transformed: while it streams by, every row is summed
//! against the few slowest waves along it, which gives lines v = 0 to `NEIGHBOURS` of the transform. Where we differ:
//! the thesis puts the median across the axis in the place of every coefficient, which takes ground away where there
//! are no bands. Here a stretch of the axis must stand out against the ground's power beside it before anything is
//! subtracted, and then only the share that the bands have in it (N. Wiener, Extrapolation, interpolation, and
//! smoothing of stationary time series, 1949). Waves longer than an eighth of the image are left alone: they are light,
//! not bands; and so that light has no ends where it stops, whose waves are short, a polynomial of the fourth degree is
//! taken from the profile first.

use nalgebra::{Matrix5, Vector5};

use crate::window::{Grey, read_grey};
use autoref_cosine::{cosine, cosine_back};
use autoref_raster::RasterSource;
use autoref_raster::error::Result;
use autoref_raster::window::Window;

/// Which bands to remove.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Banding {
    Off,
    /// Bands that run along the rows of the scan: a row is too bright or too dark as a whole.
    Rows,
    Columns,
    Both,
}

impl Banding {
    /// As the command line and the description of a frame write it.
    pub fn name(self) -> &'static str {
        match self {
            Banding::Off => "off",
            Banding::Rows => "rows",
            Banding::Columns => "columns",
            Banding::Both => "both",
        }
    }
}

/// Lines beside the axis that say what the ground would have there.
const NEIGHBOURS: usize = 6;
/// Half waves over the image below which nothing is taken for a band.
const SLOWEST: usize = 16;
/// How many times the ground's expected size one coefficient must be to count as a band.
const STANDS_OUT: f64 = 6.0;
/// Lengths of the stretches of the axis that may stand out as a whole: one period has one coefficient, rows that are
/// off each in its own way have all of them.
const STRETCHES: [usize; 5] = [1, 3, 9, 27, 81];
/// One coefficient counts for so much of a stretch, or a single strong one would stand out for all around it: no
/// stretch stands out by fewer than two.
const ONE_COUNTS: f64 = 60.0;
/// The ground's power is a mean over this many coefficients along the axis.
const SMOOTH: usize = 17;
/// More than this many times the ground's power is not told apart.
const MOST: f64 = 1e9;
/// Rows and columns are summed in groups of this many before they meet a wave.
const GROUP: usize = 8;

/// What to subtract, per row and per column of the scan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bands {
    rows: Profile,
    columns: Profile,
}

/// Sums of the profile from scan row (or column) `first` on, so that any stretch has its mean in two reads.
#[derive(Clone, Debug, Default, PartialEq)]
struct Profile {
    first: u64,
    sums: Vec<f64>,
}

impl Profile {
    fn new(first: u64, values: &[f64]) -> Profile {
        let mut sum = 0.0;
        let add = |v: &f64| {
            sum += v;
            sum
        };
        Profile { first, sums: std::iter::once(0.0).chain(values.iter().map(add)).collect() }
    }

    /// Mean over `count` rows from `from` on; nothing is known outside.
    fn mean(&self, from: u64, count: u64) -> f32 {
        if self.sums.is_empty() {
            return 0.0;
        }
        let at = |v: u64| self.sums[(v.saturating_sub(self.first) as usize).min(self.sums.len() - 1)];
        ((at(from + count) - at(from)) / count as f64) as f32
    }

    /// Root mean square of the values.
    fn rms(&self) -> f64 {
        let n = self.sums.len().saturating_sub(1).max(1) as f64;
        (self.sums.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>() / n).sqrt()
    }
}

impl Bands {
    /// Takes the bands out of values read from the scan.
    pub fn remove(&self, grey: &mut Grey) {
        if self == &Bands::default() {
            return;
        }
        let columns: Vec<f32> = (0..grey.width as u64)
            .map(|x| self.columns.mean(grey.origin[0] as u64 + x * grey.factor, grey.factor))
            .collect();
        for (y, row) in grey.data.chunks_mut(grey.width.max(1)).enumerate() {
            let of_row = self.rows.mean(grey.origin[1] as u64 + y as u64 * grey.factor, grey.factor);
            for (v, of_column) in row.iter_mut().zip(&columns) {
                *v -= of_row + of_column;
            }
        }
    }

    /// Root mean square of what is removed along rows and along columns, of white.
    pub fn rms(&self) -> [f64; 2] {
        [self.rows.rms(), self.columns.rms()]
    }
}

/// Sums against the waves 0 to [`NEIGHBOURS`]: a (real, imaginary) pair per wave and row (or column).
struct Waves {
    length: usize,
    sums: Vec<[(f64, f64); NEIGHBOURS + 1]>,
}

impl Waves {
    fn new(count: usize, length: usize) -> Waves {
        Waves { length, sums: vec![[(0.0, 0.0); NEIGHBOURS + 1]; count] }
    }

    /// Phases of every wave at a place along it.
    fn phases(&self, at: f64) -> [(f64, f64); NEIGHBOURS + 1] {
        std::array::from_fn(|v| {
            let (s, c) = (-2.0 * std::f64::consts::PI * v as f64 * at / self.length as f64).sin_cos();
            (c, s)
        })
    }

    /// The profile of the bands.
    fn bands(&self) -> Vec<f64> {
        let n = self.sums.len();
        if n <= SLOWEST {
            return vec![0.0; n];
        }
        let line = |v: usize, imaginary: bool| {
            self.sums.iter().map(|s| if imaginary { s[v].1 } else { s[v].0 }).collect::<Vec<f64>>()
        };
        let axis = cosine(&without_trend(&line(0, false)));
        let mut ground = vec![0.0; n];
        for v in 1..=NEIGHBOURS {
            for part in [line(v, false), line(v, true)] {
                ground.iter_mut().zip(cosine(&part)).for_each(|(g, c)| *g += c * c / NEIGHBOURS as f64);
            }
        }
        // Few neighbours say little about one coefficient, but ground may have more there than around it.
        let ratios: Vec<f64> = around(&ground, SMOOTH)
            .zip(ground.iter().zip(&axis))
            .map(|((sum, count), (here, d))| (d * d / here.max(sum / count as f64)).min(MOST))
            .collect();
        let found: Vec<f64> =
            axis.iter().zip(shares(ratios)).map(|(d, share)| share * d / self.length as f64).collect();
        cosine_back(&found)
    }
}

/// The values less the polynomial of the fourth degree that fits them best.
fn without_trend(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    // Legendre's polynomials: nearly orthogonal on evenly spaced places.
    let terms = |i: usize| {
        let t = (2 * i + 1) as f64 / n as f64 - 1.0;
        let t2 = t * t;
        Vector5::new(1.0, t, 1.5 * t2 - 0.5, (2.5 * t2 - 1.5) * t, (4.375 * t2 - 3.75) * t2 + 0.375)
    };
    let (normal, right) = values.iter().enumerate().fold((Matrix5::zeros(), Vector5::zeros()), |(a, b), (i, v)| {
        let t = terms(i);
        (a + t * t.transpose(), b + t * *v)
    });
    let fit = normal.cholesky().map_or(Vector5::zeros(), |a: nalgebra::Cholesky<f64, _>| a.solve(&right));
    values.iter().enumerate().map(|(i, v)| v - terms(i).dot(&fit)).collect()
}

/// Sums of `count` (odd) values around every value, and of how many: there are fewer at the ends.
fn around(values: &[f64], count: usize) -> impl Iterator<Item = (f64, usize)> {
    let (n, sums) = (values.len(), Profile::new(0, values).sums);
    (0..n).map(move |u| {
        let (from, to) = (u.saturating_sub(count / 2), (u + count / 2 + 1).min(n));
        (sums[to] - sums[from], to - from)
    })
}

/// How much of every coefficient on the axis is bands: 0 where no stretch stands out. `ratios` are their squares over
/// the ground's power, 1 on average without bands.
fn shares(mut ratios: Vec<f64>) -> Vec<f64> {
    ratios.iter_mut().take(SLOWEST).for_each(|r| *r = 0.0);
    let capped: Vec<f64> = ratios.iter().map(|r| r.min(ONE_COUNTS)).collect();
    let mut shares = vec![0.0f64; ratios.len()];
    for stretch in STRETCHES {
        // What chance adds to a mean of so many falls with their square root.
        let limit = 1.0 + (STANDS_OUT * STANDS_OUT - 1.0) / (stretch as f64).sqrt();
        let near = stretch.min(3);
        let of_bands: Vec<f64> =
            around(&ratios, near).map(|(sum, _)| 1.0 - 1.0 / (sum / near as f64).max(1.0)).collect();
        let mut done = 0;
        for (u, (sum, _)) in around(if stretch == 1 { &ratios } else { &capped }, stretch).enumerate() {
            if sum > limit * stretch as f64 {
                let to = (u + stretch / 2 + 1).min(ratios.len());
                let from = u.saturating_sub(stretch / 2).max(done);
                shares[from..to].iter_mut().zip(&of_bands[from..to]).for_each(|(s, b)| *s = s.max(*b));
                done = to;
            }
        }
    }
    shares.iter_mut().take(SLOWEST).for_each(|s| *s = 0.0);
    shares
}

/// Finds the bands in the part `region` of the scan, which must show ground only; they are known there and nowhere
/// else. Memory: 128 rows of the region, and 112 bytes per row and column.
///
/// # Errors
/// Those of reading.
pub fn find(source: &dyn RasterSource, region: Window, which: Banding) -> Result<Bands> {
    let (w, h) = (region.width as usize, region.height as usize);
    let (by_row, by_column) =
        (matches!(which, Banding::Rows | Banding::Both), matches!(which, Banding::Columns | Banding::Both));
    if which == Banding::Off || w < 2 * GROUP || h < 2 * GROUP {
        return Ok(Bands::default());
    }
    let mut rows = Waves::new(if by_row { h } else { 0 }, w);
    let mut columns = Waves::new(if by_column { w } else { 0 }, h);
    let along: Vec<_> = (0..w.div_ceil(GROUP))
        .map(|k| rows.phases((k * GROUP) as f64 + 0.5 * GROUP.min(w - k * GROUP) as f64))
        .collect();
    let mut top = 0;
    let mut group = vec![0.0f32; w];
    while top < h {
        let count = (16 * GROUP).min(h - top);
        let band = Window::new(region.x, region.y + top as u64, region.width, count as u64);
        let grey = read_grey(source, band, 1)?;
        source.release(band);
        for (k, row) in grey.data.chunks(w).enumerate() {
            if by_row {
                let sums = &mut rows.sums[top + k];
                for (part, phases) in row.chunks(GROUP).zip(&along) {
                    add(sums, f64::from(part.iter().sum::<f32>()), phases);
                }
            }
            if by_column {
                group.iter_mut().zip(row).for_each(|(g, v)| *g += v);
                if k % GROUP == GROUP - 1 || k + 1 == count {
                    let size = k % GROUP + 1;
                    let phases = columns.phases((top + k + 1) as f64 - 0.5 * size as f64);
                    for (sums, g) in columns.sums.iter_mut().zip(&mut group) {
                        add(sums, f64::from(*g), &phases);
                        *g = 0.0;
                    }
                }
            }
        }
        top += count;
    }
    Ok(Bands { rows: Profile::new(region.y, &rows.bands()), columns: Profile::new(region.x, &columns.bands()) })
}

fn add(sums: &mut [(f64, f64); NEIGHBOURS + 1], value: f64, phases: &[(f64, f64); NEIGHBOURS + 1]) {
    for (s, p) in sums.iter_mut().zip(phases) {
        s.0 += value * p.0;
        s.1 += value * p.1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_synth::rng::Rng;
    use std::f64::consts::{FRAC_1_SQRT_2, PI};

    const ROWS: usize = 2000;

    /// Ground of power falling with the frequency, `beside` times as strong on all lines near half waves 300, and
    /// bands.
    fn banded(seed: u64, beside: f64, bands: &[f64]) -> Waves {
        let mut random = Rng::new(seed, 1, 0);
        let mut waves = Waves::new(ROWS, 1500);
        for v in 0..=NEIGHBOURS {
            let mut line = |size: f64| {
                let size = |u: usize| {
                    let structure = if (299..=301).contains(&u) { beside } else { 1.0 };
                    size * structure * 0.3 * waves.length as f64 * (1.0 + u as f64 / 40.0).powf(-1.5)
                };
                cosine_back(&(0..ROWS).map(|u| size(u) * random.normal()).collect::<Vec<_>>())
            };
            let (re, im) =
                if v == 0 { (line(1.0), vec![0.0; ROWS]) } else { (line(FRAC_1_SQRT_2), line(FRAC_1_SQRT_2)) };
            waves.sums.iter_mut().zip(re.into_iter().zip(im)).for_each(|(s, c)| s[v] = c);
        }
        let length = waves.length as f64;
        waves.sums.iter_mut().zip(bands).for_each(|(s, b)| s[0].0 += b * length);
        waves
    }

    fn rms(values: impl Iterator<Item = f64>) -> f64 {
        (values.map(|v| v * v).sum::<f64>() / ROWS as f64).sqrt()
    }

    #[test]
    fn nothing_is_taken_from_ground_without_bands() {
        for seed in 0..40 {
            for beside in [1.0, 30.0] {
                let taken = banded(seed, beside, &[0.0; ROWS]).bands();
                assert!(taken.iter().all(|v| *v == 0.0), "ground {seed}, {beside}: {}", rms(taken.into_iter()));
            }
        }
        assert_eq!(Waves::new(SLOWEST, 10).bands(), vec![0.0; SLOWEST]);
        assert!(Waves::new(ROWS, 10).bands().iter().all(|v| *v == 0.0), "black film");
    }

    /// On even ground, where nothing hides them, the ends of light that falls off are no bands.
    #[test]
    fn light_is_no_band() {
        for (noise, seed) in [(0.004, 1), (0.02, 2), (0.05, 3)] {
            let mut random = Rng::new(seed, 3, 0);
            let mut waves = Waves::new(ROWS, ROWS);
            for (y, sums) in waves.sums.iter_mut().enumerate() {
                let t = 2.0 * (y as f64 + 0.5) / ROWS as f64 - 1.0;
                let of_noise = noise * (ROWS as f64).sqrt();
                for (re, im) in sums.iter_mut() {
                    (*re, *im) =
                        (of_noise * FRAC_1_SQRT_2 * random.normal(), of_noise * FRAC_1_SQRT_2 * random.normal());
                }
                let vignette = 1.0 - 0.25 * t * t + 0.1 * t;
                sums[0] = (0.4 * ROWS as f64 * vignette + of_noise * random.normal(), 0.0);
            }
            let taken = waves.bands();
            assert!(taken.iter().all(|v| *v == 0.0), "noise {noise}: {}", rms(taken.into_iter()));
        }
    }

    /// Beside one strong period the ground keeps its waves.
    #[test]
    fn one_period_does_not_take_the_ground_around_it() {
        let period: Vec<f64> = (0..ROWS).map(|y| 0.4 * (PI * 500.0 * (y as f64 + 0.5) / ROWS as f64).cos()).collect();
        let (before, after) = (banded(9, 1.0, &[0.0; ROWS]).bands(), banded(9, 1.0, &period).bands());
        assert!(before.iter().all(|v| *v == 0.0));
        let taken: Vec<f64> = cosine(&after.iter().zip(&period).map(|(a, p)| a - p).collect::<Vec<_>>());
        // Of 1,000 waves of the whole, two or so beside the period may lose a share.
        let changed = taken.iter().filter(|d| d.abs() > 1e-9).count();
        assert!(changed <= 3, "{changed}");
    }

    #[test]
    fn a_period_and_rows_each_off_in_its_own_way_are_found() {
        for seed in 0..10 {
            let ground = rms(banded(seed, 1.0, &[0.0; ROWS]).sums.iter().map(|s| s[0].0 / 1500.0));
            let mut random = Rng::new(seed, 2, 0);
            let period: Vec<f64> = (0..ROWS).map(|y| 3.0 * ground * (2.0 * PI * y as f64 / 37.0).sin()).collect();
            let own: Vec<f64> = (0..ROWS).map(|_| ground * random.normal()).collect();
            for (bands, left) in [(period, 0.25), (own, 0.5)] {
                let found = banded(seed, 1.0, &bands).bands();
                let after = rms(found.iter().zip(&bands).map(|(f, b)| f - b)) / rms(bands.iter().copied());
                assert!(after < left, "ground {seed}: {after} of the bands are left");
            }
        }
    }

    #[test]
    fn a_period_without_ground_is_all_there_is() {
        let mut alone = Waves::new(ROWS, 10);
        alone.sums.iter_mut().enumerate().for_each(|(y, s)| s[0].0 = (0.2 * PI * (y as f64 + 0.5)).cos());
        let found = alone.bands();
        assert!(found.iter().zip(&alone.sums).all(|(f, s)| (f - 0.1 * s[0].0).abs() < 1e-3));
    }
}
