//! Brightness evened out between sources: a gain and an offset for each band of each source, from their overlaps.
//!
//! Each pair of overlapping sources gives, from means over blocks, the ratio of their spreads and the difference of their
//! levels by robust geometric mean regression, which does not shrink what is noisy and does not care which one comes
//! first. Gains are then least squares in their logarithms, and offsets in the levels, over the graph of overlaps, held to
//! no change on the whole by a weak pull: nothing drifts (I. Chandelier and G. Martinoty, *A radiometric aerial
//! triangulation for the equalization of digital aerial images and orthoimages*, 2009, adjust the same graph).

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use crate::error::Result;
use crate::grid::Grid;
use crate::output;
use crate::resample::Interpolation;
use crate::window::Window;

use super::source::{Opened, Source};

/// Gains and offsets: balanced = gain · value + offset.
#[derive(Clone, Debug, Serialize)]
pub struct Balance {
    /// By source, then by band.
    pub gains: Vec<Vec<f64>>,
    pub offsets: Vec<Vec<f64>>,
    pub overlaps: Vec<Overlap>,
}

/// How two sources differ where they overlap, before and after.
#[derive(Clone, Debug, Serialize)]
pub struct Overlap {
    pub first: usize,
    pub second: usize,
    pub band: usize,
    pub blocks: usize,
    pub mean_before: f64,
    pub mean_after: f64,
    /// Root mean square of the differences of block means.
    pub rms_before: f64,
    pub rms_after: f64,
}

impl Balance {
    pub fn of(&self, source: usize, band: usize) -> (f64, f64) {
        (self.gains[source][band], self.offsets[source][band])
    }
}

/// Side of the blocks whose means are compared.
const BLOCK_PX: usize = 16;
/// Cells that a block must have of both.
const FEWEST_CELLS: usize = BLOCK_PX * BLOCK_PX / 2;
/// Blocks of a pair that are held at most; beyond, every second, fourth, … column and row of blocks is looked at.
const MOST_BLOCKS: u64 = 4_000_000;
/// The pull towards no change, against a pair of a hundred blocks.
const PULL: f64 = 1e-4;

/// One block of one pair: place, pair, and the means of both sources band by band.
struct Block {
    place: (u64, u64),
    pair: (usize, usize),
    means: Vec<(f64, f64)>,
}

/// One streamed pass over all overlaps, and the adjustment.
pub fn estimate(sources: &[Source], grid: &Grid, interpolation: Interpolation, threads: usize) -> Result<Balance> {
    let all = grid.width.div_ceil(BLOCK_PX as u64) * grid.height.div_ceil(BLOCK_PX as u64);
    let mut step = 1u64;
    while all / (step * step) > MOST_BLOCKS {
        step *= 2;
    }
    let states = output::produce(
        grid,
        256,
        threads,
        || (Opened::default(), Vec::<Block>::new()),
        |(opened, blocks), window| {
            let tile = (window.x / 256 + window.y / 256) % step.max(1);
            if tile == 0 {
                gather(sources, grid, interpolation, window, opened, blocks)?;
            }
            Ok(())
        },
        |_, ()| Ok(()),
    )?;
    let mut blocks: Vec<Block> = states.into_iter().flat_map(|(_, blocks)| blocks).collect();
    // The order in which threads came by must not matter.
    blocks.sort_by_key(|b| (b.pair, b.place.1, b.place.0));
    let bands = sources[0].bands;
    let mut balance = Balance {
        gains: vec![vec![1.0; bands]; sources.len()],
        offsets: vec![vec![0.0; bands]; sources.len()],
        overlaps: Vec::new(),
    };
    for band in 0..bands {
        adjust(&blocks, band, sources.len(), &mut balance);
    }
    Ok(balance)
}

fn gather(
    sources: &[Source],
    grid: &Grid,
    interpolation: Interpolation,
    window: Window,
    opened: &mut Opened,
    blocks: &mut Vec<Block>,
) -> Result<()> {
    let near: Vec<usize> = (0..sources.len()).filter(|&i| sources[i].meets(grid, window)).collect();
    if near.len() < 2 {
        return Ok(());
    }
    let values: Vec<Vec<f64>> =
        near.iter().map(|&i| opened.read(i, &sources[i], grid, window, interpolation)).collect::<Result<_>>()?;
    let (width, height) = (window.width as usize, window.height as usize);
    for (i, &first) in near.iter().enumerate() {
        for (j, &second) in near.iter().enumerate().skip(i + 1) {
            for y in (0..height).step_by(BLOCK_PX) {
                for x in (0..width).step_by(BLOCK_PX) {
                    let cells: Vec<usize> = (y..(y + BLOCK_PX).min(height))
                        .flat_map(|row| (x..(x + BLOCK_PX).min(width)).map(move |column| row * width + column))
                        .filter(|&cell| !values[i][cell].is_nan() && !values[j][cell].is_nan())
                        .collect();
                    if cells.len() < FEWEST_CELLS {
                        continue;
                    }
                    let mean = |values: &[f64], band: usize| {
                        let plane = &values[band * width * height..(band + 1) * width * height];
                        let known = cells.iter().map(|&cell| plane[cell]).filter(|v| !v.is_nan());
                        let (sum, n) = known.fold((0.0, 0), |(sum, n), v| (sum + v, n + 1));
                        sum / f64::from(n.max(1))
                    };
                    let means = (0..sources[first].bands).map(|b| (mean(&values[i], b), mean(&values[j], b))).collect();
                    let place = (window.x + x as u64, window.y + y as u64);
                    blocks.push(Block { place, pair: (first, second), means });
                }
            }
        }
    }
    Ok(())
}

/// What a pair says of one band.
struct Relation {
    pair: (usize, usize),
    points: Vec<(f64, f64)>,
    /// Means of the points that fit together.
    level: (f64, f64),
    /// Logarithm of the second's spread over the first's, where there is enough of a pattern in both.
    ratio: Option<f64>,
    weight: f64,
}

fn relation(pair: (usize, usize), points: Vec<(f64, f64)>) -> Relation {
    let mut kept = points.clone();
    let (mut level, mut ratio) = ((0.0, 0.0), None);
    for _ in 0..6 {
        let n = kept.len() as f64;
        level = (kept.iter().map(|p| p.0).sum::<f64>() / n, kept.iter().map(|p| p.1).sum::<f64>() / n);
        let moment = |f: &dyn Fn(&(f64, f64)) -> f64| kept.iter().map(f).sum::<f64>() / n;
        let xx = moment(&|p| (p.0 - level.0).powi(2));
        let yy = moment(&|p| (p.1 - level.1).powi(2));
        let xy = moment(&|p| (p.0 - level.0) * (p.1 - level.1));
        let correlation = xy / (xx * yy).sqrt();
        // Without a common pattern the spreads say nothing about each other.
        ratio = (kept.len() >= 8 && correlation > 0.4).then(|| (yy / xx).sqrt().ln());
        let slope = ratio.map_or(1.0, f64::exp);
        let residual = |p: &(f64, f64)| (p.1 - level.1 - slope * (p.0 - level.0)).abs();
        let mut sizes: Vec<f64> = points.iter().map(residual).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        let limit = 3.0 * 1.4826 * sizes[sizes.len() / 2] + 1e-9;
        kept = points.iter().copied().filter(|p| residual(p) <= limit).collect();
        if kept.is_empty() {
            kept.clone_from(&points);
        }
    }
    let weight = (kept.len() as f64 / 100.0).min(100.0);
    Relation { pair, points, level, ratio, weight }
}

fn adjust(blocks: &[Block], band: usize, sources: usize, balance: &mut Balance) {
    let relations: Vec<Relation> = blocks
        .chunk_by(|a, b| a.pair == b.pair)
        .map(|group| relation(group[0].pair, group.iter().map(|b| b.means[band]).collect()))
        .collect();
    let gains: Vec<f64> = {
        let edges = relations.iter().filter_map(|r| r.ratio.map(|ratio| (r.pair, ratio, r.weight)));
        differences(edges, sources).iter().map(|v| v.exp()).collect()
    };
    // gain₁·x + o₁ = gain₂·y + o₂
    let edges = relations.iter().map(|r| {
        let gap = gains[r.pair.1] * r.level.1 - gains[r.pair.0] * r.level.0;
        (r.pair, gap, r.weight)
    });
    let offsets = differences(edges, sources);
    for source in 0..sources {
        balance.gains[source][band] = gains[source];
        balance.offsets[source][band] = offsets[source];
    }
    for r in &relations {
        let (i, j) = r.pair;
        let n = r.points.len() as f64;
        let after = |p: &(f64, f64)| gains[j] * p.1 + offsets[j] - gains[i] * p.0 - offsets[i];
        let sum = |f: &dyn Fn(&(f64, f64)) -> f64| r.points.iter().map(f).sum::<f64>() / n;
        balance.overlaps.push(Overlap {
            first: i + 1,
            second: j + 1,
            band: band + 1,
            blocks: r.points.len(),
            mean_before: sum(&|p| p.1 - p.0),
            mean_after: sum(&after),
            rms_before: sum(&|p| (p.1 - p.0).powi(2)).sqrt(),
            rms_after: sum(&|p| after(p).powi(2)).sqrt(),
        });
    }
}

/// Numbers whose differences value(first) − value(second) meet what is given, by least squares; weakly held at zero.
fn differences(edges: impl Iterator<Item = ((usize, usize), f64, f64)>, count: usize) -> DVector<f64> {
    let mut matrix = DMatrix::<f64>::identity(count, count) * PULL;
    let mut right = DVector::<f64>::zeros(count);
    for ((i, j), gap, weight) in edges {
        matrix[(i, i)] += weight;
        matrix[(j, j)] += weight;
        matrix[(i, j)] -= weight;
        matrix[(j, i)] -= weight;
        right[i] += weight * gap;
        right[j] -= weight * gap;
    }
    let start = right.clone();
    matrix.cholesky().map_or(start * 0.0, |c| c.solve(&right))
}
