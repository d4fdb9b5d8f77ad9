//! Brightness evened out between sources: a gain, an offset and a smooth surface for each band of each source, from
//! their overlaps.
//!
//! Each pair of overlapping sources gives, from means over blocks, the ratio of their spreads by robust geometric mean
//! regression, which does not shrink what is noisy and does not care which one comes first. Gains are then least
//! squares in their logarithms over the graph of overlaps; offsets and surfaces follow together from the blocks that
//! fit. All are held to no change by a weak pull, surfaces by a stronger one, or to a source that is left as it is:
//! nothing drifts (L. Chandelier and G. Martinoty, *A radiometric aerial triangulation for the equalization of digital
//! aerial images and orthoimages*, 2009, adjust the same graph).

use serde::Serialize;

use crate::error::Result;
use crate::grid::Grid;
use crate::output::{self, Cut};
use crate::resample::Interpolation;
use crate::window::Window;

use super::graph::Normal;
use super::read::Opened;
use super::source::Source;

/// The degree of the surfaces beside gains and offsets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum Surface {
    /// Gains and offsets alone.
    None,
    /// A plane.
    Linear,
    /// A polynomial of the second degree.
    #[default]
    Quadratic,
}

impl Surface {
    /// Numbers that a surface has.
    fn terms(self) -> usize {
        match self {
            Surface::None => 0,
            Surface::Linear => 2,
            Surface::Quadratic => 5,
        }
    }
}

/// How brightness is evened out.
#[derive(Clone, Copy, Debug, Default)]
pub struct Balancing {
    pub surface: Surface,
    /// The number, from 0 on, of a source that is left as it is.
    pub reference: Option<usize>,
}

/// Corrections: balanced = gain · value + offset + surface, where the surface is a·u + b·v + c·(u² − ⅓) + d·u·v +
/// e·(v² − ⅓), and u and v run from −1 to 1 over the source, eastwards and southwards.
#[derive(Clone, Debug, Serialize)]
pub struct Balance {
    /// By source, then by band.
    pub gains: Vec<Vec<f64>>,
    pub offsets: Vec<Vec<f64>>,
    /// a to e.
    pub surfaces: Vec<Vec<[f64; TERMS]>>,
    pub overlaps: Vec<Overlap>,
    /// Differences over the ground, for the page.
    #[serde(skip)]
    pub map: DifferenceMap,
    #[serde(skip)]
    frames: Vec<Frame>,
}

const TERMS: usize = 5;

/// Mean sizes of differences, over all bands and pairs, in squares of the mosaic; NaN where there is no overlap.
#[derive(Clone, Debug, Default)]
pub struct DifferenceMap {
    pub width: usize,
    pub height: usize,
    pub before: Vec<f64>,
    pub after: Vec<f64>,
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

/// Where a source lies, in cells of the mosaic: its centre, and half its sides.
#[derive(Clone, Copy, Debug)]
struct Frame {
    centre: (f64, f64),
    half: (f64, f64),
}

impl Frame {
    fn of(source: &Source, mosaic: &Grid) -> Frame {
        let centre = source.grid.centre();
        let half = |size: u64, step: f64, own: f64| (size as f64 * step / own / 2.0).abs().max(0.5);
        Frame {
            centre: ((centre.0 - mosaic.x0) / mosaic.step_x, (centre.1 - mosaic.y0) / mosaic.step_y),
            half: (
                half(source.grid.width, source.grid.step_x, mosaic.step_x),
                half(source.grid.height, source.grid.step_y, mosaic.step_y),
            ),
        }
    }

    /// What the coefficients of a surface are multiplied with.
    fn basis(&self, x: f64, y: f64) -> [f64; TERMS] {
        let (u, v) = ((x - self.centre.0) / self.half.0, (y - self.centre.1) / self.half.1);
        [u, v, u * u - 1.0 / 3.0, u * v, v * v - 1.0 / 3.0]
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Balance {
    /// The correction of a band of a source at a place of the mosaic, in cells.
    pub fn correct(&self, source: usize, band: usize, (x, y): (f64, f64), value: f64) -> f64 {
        let surface = dot(&self.surfaces[source][band], &self.frames[source].basis(x, y));
        self.gains[source][band] * value + self.offsets[source][band] + surface
    }
}

/// Side of the blocks whose means are compared.
const BLOCK_PX: usize = 16;
/// Cells that a block must have of both.
const FEWEST_CELLS: usize = BLOCK_PX * BLOCK_PX / 2;
/// Blocks of a pair that are held at most; beyond, every second, fourth, … column and row of blocks is looked at.
const MOST_BLOCKS: u64 = 4_000_000;
/// The pull of gains and offsets towards no change, against a pair of a hundred blocks.
const PULL: f64 = 1e-4;
/// That of surfaces, by itself and as a share of the weight of all overlaps of a source.
const SURFACE_PULL: (f64, f64) = (1e-2, 1e-3);
/// Gains see the values without the surfaces, and these what the gains leave: so often.
const ROUNDS: usize = 8;
/// Squares on the longer side of the page's map.
const MAP_SQUARES: u64 = 96;

/// One block of one pair: place, pair, and the means of both sources band by band.
struct Block {
    place: (u64, u64),
    centre: (f64, f64),
    pair: (usize, usize),
    means: Vec<(f64, f64)>,
}

/// One streamed pass over all overlaps, and the adjustment.
///
/// # Errors
/// When a source or its mask cannot be read.
pub fn estimate(
    sources: &[Source],
    grid: &Grid,
    balancing: Balancing,
    interpolation: Interpolation,
    threads: usize,
) -> Result<Balance> {
    let frames: Vec<Frame> = sources.iter().map(|s| Frame::of(s, grid)).collect();
    let covered: f64 = frames.iter().map(|f| 4.0 * f.half.0 * f.half.1).sum();
    let mut step = 1u64;
    while covered as u64 / (BLOCK_PX * BLOCK_PX) as u64 / (step * step) > MOST_BLOCKS {
        step *= 2;
    }
    let states = output::produce(
        grid,
        Cut { tile_px: 256, block_px: 256 },
        threads,
        || (Opened::default(), Vec::<Block>::new()),
        |(opened, blocks), window| {
            if (window.x / 256 + window.y / 256).is_multiple_of(step) {
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
        surfaces: vec![vec![[0.0; TERMS]; bands]; sources.len()],
        overlaps: Vec::new(),
        map: DifferenceMap::default(),
        frames,
    };
    for band in 0..bands {
        adjust(&blocks, band, balancing, &mut balance);
        report(&blocks, band, &mut balance);
    }
    balance.map = map(&blocks, grid, &balance);
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
        near.iter().map(|&i| opened.read(&sources[i], grid, window, interpolation)).collect::<Result<_>>()?;
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
                    let middle = |from: u64, size: usize, whole: usize, at: usize| {
                        from as f64 + size.min(whole - at) as f64 / 2.0
                    };
                    let centre = (middle(place.0, BLOCK_PX, width, x), middle(place.1, BLOCK_PX, height, y));
                    blocks.push(Block { place, centre, pair: (first, second), means });
                }
            }
        }
    }
    Ok(())
}

/// What a pair says of one band.
struct Relation {
    /// Numbers of the points that fit together.
    kept: Vec<usize>,
    /// Logarithm of the second's spread over the first's, where there is enough of a pattern in both.
    ratio: Option<f64>,
    weight: f64,
}

fn relation(points: &[(f64, f64)]) -> Relation {
    let mut kept: Vec<usize> = (0..points.len()).collect();
    let mut ratio = None;
    for _ in 0..6 {
        let n = kept.len() as f64;
        let moment = |f: &dyn Fn((f64, f64)) -> f64| kept.iter().map(|&k| f(points[k])).sum::<f64>() / n;
        let level = (moment(&|p| p.0), moment(&|p| p.1));
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
        kept = (0..points.len()).filter(|&k| residual(&points[k]) <= limit).collect();
    }
    let weight = (kept.len() as f64 / 100.0).min(100.0);
    Relation { kept, ratio, weight }
}

fn adjust(blocks: &[Block], band: usize, balancing: Balancing, balance: &mut Balance) {
    let sources = balance.gains.len();
    let terms = balancing.surface.terms();
    for _ in 0..if terms == 0 { 1 } else { ROUNDS } {
        let groups = || blocks.chunk_by(|a, b| a.pair == b.pair);
        let relations: Vec<Relation> = groups()
            .map(|group| {
                // What the values would be without the surfaces.
                let plain = |block: &Block, source: usize, value: f64| {
                    let basis = balance.frames[source].basis(block.centre.0, block.centre.1);
                    value + dot(&balance.surfaces[source][band], &basis) / balance.gains[source][band]
                };
                let points: Vec<(f64, f64)> = group
                    .iter()
                    .map(|b| (plain(b, b.pair.0, b.means[band].0), plain(b, b.pair.1, b.means[band].1)))
                    .collect();
                relation(&points)
            })
            .collect();
        let mut levels = Normal::new(sources, 1, balancing.reference);
        for (group, relation) in groups().zip(&relations) {
            if let Some(ratio) = relation.ratio {
                levels.tie(group[0].pair.0, group[0].pair.1);
                levels.observe(&[1.0], &[1.0], ratio, relation.weight);
            }
        }
        levels.pull(&[PULL], &[0.0]);
        let gains: Vec<f64> = levels.solve().iter().map(|v| v.exp()).collect();
        // gain₁·x + o₁ + s₁ = gain₂·y + o₂ + s₂
        let mut normal = Normal::new(sources, 1 + terms, balancing.reference);
        for (group, relation) in groups().zip(&relations) {
            let (i, j) = group[0].pair;
            normal.tie(i, j);
            let weight = relation.weight / relation.kept.len().max(1) as f64;
            for block in relation.kept.iter().map(|&k| &group[k]) {
                let row = |source: usize| {
                    let [a, b, c, d, e] = balance.frames[source].basis(block.centre.0, block.centre.1);
                    [1.0, a, b, c, d, e]
                };
                let gap = gains[j] * block.means[band].1 - gains[i] * block.means[band].0;
                normal.observe(&row(i)[..=terms], &row(j)[..=terms], gap, weight);
            }
        }
        let pulls = |first: f64, others: f64| [first, others, others, others, others, others];
        normal.pull(&pulls(PULL, SURFACE_PULL.0)[..=terms], &pulls(0.0, SURFACE_PULL.1)[..=terms]);
        for (source, found) in normal.solve().chunks_exact(1 + terms).enumerate() {
            balance.gains[source][band] = gains[source];
            balance.offsets[source][band] = found[0];
            balance.surfaces[source][band][..terms].copy_from_slice(&found[1..]);
        }
    }
}

/// A block's difference, second minus first, before and after.
fn gaps(block: &Block, band: usize, balance: &Balance) -> (f64, f64) {
    let ((i, j), (x, y)) = (block.pair, block.means[band]);
    (y - x, balance.correct(j, band, block.centre, y) - balance.correct(i, band, block.centre, x))
}

/// What the overlaps look like in one band.
fn report(blocks: &[Block], band: usize, balance: &mut Balance) {
    for group in blocks.chunk_by(|a, b| a.pair == b.pair) {
        let n = group.len() as f64;
        let mean = |f: &dyn Fn((f64, f64)) -> f64| group.iter().map(|b| f(gaps(b, band, balance))).sum::<f64>() / n;
        let overlap = Overlap {
            first: group[0].pair.0 + 1,
            second: group[0].pair.1 + 1,
            band: band + 1,
            blocks: group.len(),
            mean_before: mean(&|g| g.0),
            mean_after: mean(&|g| g.1),
            rms_before: mean(&|g| g.0 * g.0).sqrt(),
            rms_after: mean(&|g| g.1 * g.1).sqrt(),
        };
        balance.overlaps.push(overlap);
    }
}

/// Where the differences are.
fn map(blocks: &[Block], grid: &Grid, balance: &Balance) -> DifferenceMap {
    let side = grid.width.max(grid.height).div_ceil(MAP_SQUARES).max(BLOCK_PX as u64);
    let (width, height) = (grid.width.div_ceil(side) as usize, grid.height.div_ceil(side) as usize);
    let mut sums = vec![(0.0, 0.0, 0.0); width * height];
    for block in blocks {
        let sum = &mut sums[(block.place.1 / side) as usize * width + (block.place.0 / side) as usize];
        for band in 0..block.means.len() {
            let (before, after) = gaps(block, band, balance);
            *sum = (sum.0 + before.abs(), sum.1 + after.abs(), sum.2 + 1.0);
        }
    }
    DifferenceMap {
        width,
        height,
        before: sums.iter().map(|s| s.0 / s.2).collect(),
        after: sums.iter().map(|s| s.1 / s.2).collect(),
    }
}
