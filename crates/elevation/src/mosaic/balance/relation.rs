//! What one pair of sources says of one band: which blocks agree, the ratio of contrasts, and what a surface explains.
//!
//! The ratio is that of spreads (geometric mean regression), which noise in both does not shrink and which does not
//! care for the order of the two. Surfaces are kept out of it as far as they are to be expected: spreads are those of
//! what the surfaces, held by their prior, leave.

use std::collections::HashMap;

use autoref_raster::ranks::upper_median;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::blocks::{BLOCK_PX, Block};
use super::start;
use super::surface::{Frame, TERMS, dot};

/// Blocks of fewer tell no contrast.
const FEWEST_FOR_CONTRAST: usize = 8;
/// Nor do those whose means go together less than this …
const LEAST_CORRELATION: f64 = 0.4;
/// … or by less than so many of the correlation's standard deviations.
const LEAST_SIGNIFICANCE: f64 = 4.0;
/// A block that lies so many standard deviations off does not fit.
const REJECT: f64 = 3.0;
/// Ratios of contrasts are never trusted further than this.
const RATIO_FLOOR: f64 = 1e-3;
/// Nor are levels, as a share of the contrast.
const LEVEL_FLOOR: f64 = 1e-3;
/// Fits at most; all end when the same blocks are kept.
const FITS: usize = 12;

/// The blocks of a pair, in one band.
pub struct Pair<'a> {
    pub sources: (usize, usize),
    pub band: usize,
    pub blocks: Vec<&'a Block>,
    /// Means of both, without the surface that all sources have in common.
    pub values: Vec<(f64, f64)>,
    pub frames: &'a [Frame],
    /// Terms of a surface.
    pub terms: usize,
    /// Blocks that agree with the line or level that most speaks for.
    pub start: Vec<usize>,
}

/// What a pair says.
#[derive(Default)]
pub struct Relation {
    /// Numbers of the blocks that fit together.
    pub kept: Vec<usize>,
    /// Logarithm of the second's contrast over the first's, with its variance, where there is enough of a pattern.
    pub ratio: Option<(f64, f64)>,
    /// Variance of a kept block's difference, in numbers of the second source, of as many independent blocks.
    pub noise: f64,
    pub evidence: Option<Evidence>,
}

/// What a surface explains of the differences, in numbers of the second source.
#[derive(Clone, Copy)]
pub struct Evidence {
    /// Sum of squares that it explains beyond a constant and the values themselves.
    pub explained: f64,
    /// What it would explain for each unit of variance of the coefficients of both sources.
    pub leverage: f64,
    /// Variance of a block without any surface, of as many independent blocks.
    pub noise: f64,
}

/// Sums over kept blocks, about their means: of both values (x, y) and of the surfaces' terms (z).
struct Moments {
    n: f64,
    x: f64,
    y: f64,
    z: DVector<f64>,
    xx: f64,
    xy: f64,
    yy: f64,
    zx: DVector<f64>,
    zy: DVector<f64>,
    zz: DMatrix<f64>,
}

/// Spreads of what surfaces leave, and the surfaces' coefficients for each unit of x and of y.
struct Fit {
    xx: f64,
    xy: f64,
    yy: f64,
    for_x: DVector<f64>,
    for_y: DVector<f64>,
}

impl<'a> Pair<'a> {
    pub fn new(blocks: &'a [Block], band: usize, frames: &'a [Frame], terms: usize) -> Pair<'a> {
        let sources = blocks[0].pair;
        let blocks: Vec<&Block> = blocks.iter().filter(|b| b.counts(band)).collect();
        let values: Vec<(f64, f64)> = blocks.iter().map(|block| block.means[band]).collect();
        let line = if values.len() >= FEWEST_FOR_CONTRAST { start::line(&values) } else { None };
        let near = |line: start::Line| (0..values.len()).filter(|&k| line.distance(values[k]) <= line.reach).collect();
        let start = line.map(near).unwrap_or_default();
        Pair { sources, band, blocks, values, frames, terms, start }
    }

    /// Takes the surface that all sources have in common, in balanced numbers, out of the values.
    pub fn without(&mut self, common: &[f64; TERMS], gains: &[f64]) {
        let (i, j) = self.sources;
        for (value, block) in self.values.iter_mut().zip(&self.blocks) {
            let own = |source: usize| dot(common, &self.frames[source].basis(block.centre)) / gains[source];
            let (x, y) = block.means[self.band];
            *value = (x + own(i), y + own(j));
        }
    }

    /// What the coefficients of the first's surface are multiplied with, then those of the second's.
    fn row(&self, k: usize) -> [f64; 2 * TERMS] {
        let centre = self.blocks[k].centre;
        let (first, second) = (self.frames[self.sources.0].basis(centre), self.frames[self.sources.1].basis(centre));
        let mut row = [0.0; 2 * TERMS];
        row[..self.terms].copy_from_slice(&first[..self.terms]);
        (0..self.terms).for_each(|t| row[self.terms + t] = -second[t]);
        row
    }

    fn moments(&self, kept: &[usize]) -> Moments {
        let terms = 2 * self.terms;
        let n = kept.len() as f64;
        let mut m = Moments {
            n,
            x: 0.0,
            y: 0.0,
            z: DVector::zeros(terms),
            xx: 0.0,
            xy: 0.0,
            yy: 0.0,
            zx: DVector::zeros(terms),
            zy: DVector::zeros(terms),
            zz: DMatrix::zeros(terms, terms),
        };
        for &k in kept {
            let (x, y) = self.values[k];
            (m.x, m.y) = (m.x + x / n, m.y + y / n);
            self.row(k)[..terms].iter().zip(m.z.iter_mut()).for_each(|(z, sum)| *sum += z / n);
        }
        for &k in kept {
            let (x, y) = self.values[k];
            let (x, y) = (x - m.x, y - m.y);
            (m.xx, m.xy, m.yy) = (m.xx + x * x, m.xy + x * y, m.yy + y * y);
            let row = self.row(k);
            for a in 0..terms {
                let z = row[a] - m.z[a];
                (m.zx[a], m.zy[a]) = (m.zx[a] + z * x, m.zy[a] + z * y);
                for b in 0..=a {
                    m.zz[(a, b)] += z * (row[b] - m.z[b]);
                }
            }
        }
        m.zz.fill_upper_triangle_with_lower_triangle();
        m
    }

    /// Which blocks agree, and what they say. `prior` is the noise's variance over that of a surface's coefficients,
    /// `None` for no surfaces; `slope` is the ratio of contrasts where these blocks do not tell it.
    pub fn relation(&self, prior: Option<f64>, slope: f64) -> Relation {
        if self.start.len() >= FEWEST_FOR_CONTRAST
            && let Some(relation) = self.settled(self.start.clone(), prior, None)
        {
            return relation;
        }
        let gaps: Vec<f64> = self.values.iter().map(|(x, y)| y - slope * x).collect();
        let Some((from, to)) = start::densest(&gaps) else { return Relation::default() };
        let near = (0..gaps.len()).filter(|&k| gaps[k] >= from && gaps[k] <= to).collect();
        self.settled(near, prior, Some(slope)).unwrap_or_default()
    }

    /// Fits and keeps what fits until the same blocks are kept; `None` where no ratio can be told and none is given.
    fn settled(&self, start: Vec<usize>, prior: Option<f64>, given: Option<f64>) -> Option<Relation> {
        let mut kept = start;
        for _ in 0..FITS {
            let moments = self.moments(&kept);
            let fit = moments.fit(prior);
            let slope = given.or_else(|| fit.slope(kept.len()))?;
            let residuals: Vec<f64> =
                (0..self.blocks.len()).map(|k| self.residual(&moments, &fit, slope, k).abs()).collect();
            let mut sizes: Vec<f64> = kept.iter().map(|&k| residuals[k]).collect();
            let median = upper_median(&mut sizes).expect("some blocks are kept");
            // Rounding of sums is no difference.
            let limit = REJECT * 1.4826 * median + 1e-9 * (moments.y.abs() + moments.yy.sqrt());
            let next: Vec<usize> = (0..residuals.len()).filter(|&k| residuals[k] <= limit).collect();
            if next == kept || next.is_empty() {
                break;
            }
            kept = next;
        }
        let moments = self.moments(&kept);
        let fit = moments.fit(prior);
        let slope = given.or_else(|| fit.slope(kept.len()))?;
        Some(self.stated(kept, &moments, &fit, (slope, given.is_none())))
    }

    fn residual(&self, moments: &Moments, fit: &Fit, slope: f64, k: usize) -> f64 {
        let (x, y) = self.values[k];
        let row = self.row(k);
        let surface = |coefficients: &DVector<f64>| {
            coefficients.iter().zip(row).zip(&moments.z).map(|((c, z), mean)| c * (z - mean)).sum::<f64>()
        };
        y - moments.y - surface(&fit.for_y) - slope * (x - moments.x - surface(&fit.for_x))
    }

    fn stated(&self, kept: Vec<usize>, moments: &Moments, fit: &Fit, (slope, told): (f64, bool)) -> Relation {
        let square = |residual: f64| residual * residual;
        // Without a surface, and with as much of one as fits best.
        let (free, spared) = match moments.surface(slope, self.terms) {
            Some(surface) => (surface.fit, 2 + self.terms),
            None => (moments.fit(None), 2),
        };
        let residuals: Vec<f64> = kept.iter().map(|&k| self.residual(moments, &free, slope, k)).collect();
        let inflation = self.inflation(&kept, &residuals);
        let left = residuals.iter().copied().map(square).sum::<f64>() / (moments.n - spared as f64).max(1.0);
        let floor = square(LEVEL_FLOOR) * moments.yy / moments.n + square(1e-9 * moments.y) + 1e-18;
        let evidence = moments.surface(slope, self.terms).map(|surface| Evidence {
            explained: surface.explained,
            leverage: surface.leverage,
            noise: (left + floor) * inflation,
        });
        let own = kept.iter().map(|&k| square(self.residual(moments, fit, slope, k))).sum::<f64>();
        let noise = (own / (moments.n - 2.0).max(1.0) + floor) * inflation;
        let ratio = told.then(|| {
            let loose = 1.0 - fit.xy * fit.xy / (fit.xx * fit.yy);
            (slope.ln(), inflation * loose.max(0.0) / (moments.n - 2.0).max(1.0) + square(RATIO_FLOOR))
        });
        Relation { kept, ratio, noise, evidence }
    }

    /// By how many times differences that hang together say less than as many independent ones, from the correlation of
    /// neighbours: that of a process which forgets in both directions.
    fn inflation(&self, kept: &[usize], residuals: &[f64]) -> f64 {
        let places: HashMap<(u64, u64), f64> =
            kept.iter().zip(residuals).map(|(&k, r)| (self.blocks[k].place, *r)).collect();
        let (mut together, mut neighbours) = (0.0, 0.0);
        for (&k, residual) in kept.iter().zip(residuals) {
            let (x, y) = self.blocks[k].place;
            for next in [(x + BLOCK_PX as u64, y), (x, y + BLOCK_PX as u64)] {
                if let Some(other) = places.get(&next) {
                    (together, neighbours) = (together + residual * other, neighbours + 1.0);
                }
            }
        }
        let variance = residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len().max(1) as f64;
        if neighbours < 8.0 || variance <= 0.0 {
            return 1.0;
        }
        let correlation = (together / neighbours / variance).clamp(0.0, 0.95);
        ((1.0 + correlation) / (1.0 - correlation)).powi(2).min((kept.len() as f64 / 8.0).max(1.0))
    }
}

/// What a surface explains, and its fit.
struct Explained {
    explained: f64,
    leverage: f64,
    fit: Fit,
}

impl Moments {
    fn fit(&self, prior: Option<f64>) -> Fit {
        let ridge = prior.and_then(|prior| {
            let held = &self.zz + DMatrix::identity(self.z.len(), self.z.len()) * prior.max(1e-12 * self.zz.trace());
            Cholesky::<f64, Dyn>::new(held)
        });
        let Some(ridge) = ridge.filter(|_| !self.z.is_empty()) else {
            let none = DVector::zeros(self.z.len());
            return Fit { xx: self.xx, xy: self.xy, yy: self.yy, for_x: none.clone(), for_y: none };
        };
        let (for_x, for_y) = (ridge.solve(&self.zx), ridge.solve(&self.zy));
        Fit {
            xx: self.xx - self.zx.dot(&for_x),
            xy: self.xy - self.zx.dot(&for_y),
            yy: self.yy - self.zy.dot(&for_y),
            for_x,
            for_y,
        }
    }

    /// What a surface explains of y − slope · x beyond a constant and x itself: a surface must not carry what a gain
    /// explains. `None` where there are too few blocks for one.
    fn surface(&self, slope: f64, terms: usize) -> Option<Explained> {
        if terms == 0 || self.n < (2 * terms + 8) as f64 {
            return None;
        }
        // Nothing is taken for x where that has no pattern.
        let x = if self.xx > 0.0 { self.xx.recip() } else { 0.0 };
        let along = &self.zy - &self.zx * slope;
        let gap = self.xy - slope * self.xx;
        let z = &along - &self.zx * (gap * x);
        let zz = &self.zz - &self.zx * self.zx.transpose() * x;
        // The surface of one source is one of the other, in other coordinates.
        let own = zz.view((0, 0), (terms, terms)).into_owned();
        let held = &own + DMatrix::identity(terms, terms) * (1e-9 * own.trace() + f64::MIN_POSITIVE);
        let coefficients = Cholesky::new(held)?.solve(&z.rows(0, terms));
        let explained = coefficients.dot(&z.rows(0, terms)).max(0.0);
        let mut for_y = DVector::zeros(2 * terms);
        for_y.rows_mut(0, terms).copy_from(&coefficients);
        // Of the gap along x the residual keeps what it has: it is a gain's.
        let fit = Fit { xx: 0.0, xy: 0.0, yy: 0.0, for_x: DVector::zeros(2 * terms), for_y };
        Some(Explained { explained, leverage: zz.trace(), fit })
    }
}

impl Fit {
    /// The ratio of contrasts, where the two go together.
    fn slope(&self, blocks: usize) -> Option<f64> {
        let slope = (self.yy / self.xx).sqrt();
        let correlation = self.xy / (self.xx * self.yy).sqrt();
        let deviation = ((1.0 - correlation * correlation).max(0.0) / (blocks.max(3) - 2) as f64).sqrt();
        let told = blocks >= FEWEST_FOR_CONTRAST
            && correlation > LEAST_CORRELATION
            && correlation > LEAST_SIGNIFICANCE * deviation;
        (told && slope.is_finite() && slope > 0.0).then_some(slope)
    }
}
