//! Bands that a scanner leaves along its rows or columns, removed in the frequency domain.
//!
//! After section 10.1.1 of the 2017 Svalbard thesis: in the Fourier transform of the image, bands that run along whole rows (or
//! columns) lie on one axis, and a median across that axis takes them away while the ground, which is not concentrated
//! there, stays. The axis and its neighbours are all that is needed, so the image is not transformed: while it streams by,
//! every row is summed against the few slowest waves along it, which gives lines v = 0 to `NEIGHBOURS` of the transform.
//! Where we differ: waves longer than an eighth of the image are left alone (they are light, not bands), and only
//! coefficients that stand out against their neighbours are changed.

use super::fft::{cosine, cosine_back};
use crate::error::Result;
use crate::film::window::{Grey, read_grey};
use crate::raster::RasterSource;
use crate::window::Window;

/// Which bands to remove.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Banding {
    Off,
    /// Bands that run along the rows of the scan: a row is too bright or too dark as a whole.
    Rows,
    Columns,
    Both,
}

/// Lines beside the axis that say what the ground would have there.
const NEIGHBOURS: usize = 6;
/// Half waves over the image below which nothing is taken for a band.
const SLOWEST: usize = 16;
/// How many times the median of its neighbours a coefficient must be to count as a band.
const STANDS_OUT: f64 = 3.0;
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
            let f: Vec<f64> = self.sums.iter().map(|s| if imaginary { s[v].1 } else { s[v].0 }).collect();
            cosine(&f)
        };
        let axis = line(0, false);
        let beside: Vec<[Vec<f64>; 2]> = (1..=NEIGHBOURS).map(|v| [line(v, false), line(v, true)]).collect();
        let found: Vec<f64> = axis
            .iter()
            .enumerate()
            .map(|(u, &d)| {
                let mut sizes: Vec<f64> = beside.iter().map(|[re, im]| re[u].hypot(im[u])).collect();
                sizes.sort_by(f64::total_cmp);
                if u < SLOWEST || d.abs() <= STANDS_OUT * sizes[NEIGHBOURS / 2] {
                    return 0.0;
                }
                // The median across the axis; lines below it are the complex conjugates of those above.
                let mut real: Vec<f64> = beside.iter().flat_map(|[re, _]| [re[u], re[u]]).chain([d]).collect();
                real.sort_by(f64::total_cmp);
                (d - real[NEIGHBOURS]) / self.length as f64
            })
            .collect();
        cosine_back(&found)
    }
}

/// Finds the bands in the part `region` of the scan, which must show ground only; they are known there and nowhere else.
/// Memory: 128 rows of the region, and 112 bytes per row and column.
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
