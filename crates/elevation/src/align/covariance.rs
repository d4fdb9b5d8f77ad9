//! How sure a fit is: from what blocks of cells say.

use nalgebra::{DMatrix, DVector};

use crate::grid::Grid;
use crate::stream::BLOCK_PX;

use super::parameters::Free;
use super::sums::Sums;

/// Blocks wide enough that neighbours hardly depend on each other, and not too many to hold.
pub(super) fn score_block_px(grid: &Grid) -> u64 {
    const MOST: u64 = 1 << 16;
    const ENOUGH: u64 = 200;
    let blocks = |px: u64| grid.width.div_ceil(px) * grid.height.div_ceil(px);
    let mut px = if blocks(2 * BLOCK_PX) >= ENOUGH { 2 * BLOCK_PX } else { BLOCK_PX };
    while blocks(px) > MOST {
        px *= 2;
    }
    px
}

/// The variance of a parameter over the inverse of its normal equations where residuals hang together nowhere: E ψ² /
/// E ψ' of the biweight for normal noise.
const WHITE: f64 = 0.8;

/// The covariance of the parameters from what each block of cells moves the solution by (the sandwich of P. Huber, *The
/// behavior of maximum likelihood estimates under nonstandard conditions*, 1967, with blocks as clusters): residuals
/// that hang together within a block count as what they are. A block moves it by what the others say without it (R.
/// Bell and D. McCaffrey, *Bias reduction in standard errors for linear regression with multi-stage samples*, 2002), so
/// that steep ground in a few blocks is not taken for certain. What hangs together over the blocks' borders is added
/// from neighbours; blocks are doubled while that shows more than chance does. No parameter is surer than the noise of
/// single cells lets it be: where all slope lies in two or three blocks, their scatter is a matter of luck.
pub(super) fn covariance(sums: &Sums, free: Free, grid: &Grid, block_px: u64) -> Option<DMatrix<f64>> {
    const FEWEST: usize = 40;
    let (first, n, parameters) = (free.first(), free.count(), sums.parameters());
    let matrix = DMatrix::from_fn(n, n, |i, j| sums.matrix(first + i, first + j));
    let inverse = matrix.clone().try_inverse()?;
    let mut blocks = Blocks {
        across: grid.width.div_ceil(block_px) as usize,
        down: grid.height.div_ceil(block_px) as usize,
        parameters,
        scores: sums.block_scores(),
        matrices: sums.block_matrices(),
    };
    let (mut best, mut filled) = blocks.scatter((&matrix, &inverse), first);
    loop {
        blocks = blocks.doubled();
        let (next, fewer) = blocks.scatter((&matrix, &inverse), first);
        let chance = 1.0 + 2.0 * (2.0 / fewer.max(1) as f64).sqrt();
        if fewer < FEWEST || fewer >= filled || next.trace() <= best.trace() * chance {
            break;
        }
        (best, filled) = (next, fewer);
    }
    let grown = |i: usize| (WHITE * inverse[(i, i)] / best[(i, i)]).max(1.0).sqrt();
    let grown: Vec<f64> = (0..n).map(grown).map(|by| if by.is_finite() { by } else { 1.0 }).collect();
    let best = DMatrix::from_fn(n, n, |i, j| best[(i, j)] * grown[i] * grown[j]);
    let mut whole = DMatrix::zeros(parameters, parameters);
    whole.view_mut((first, first), (n, n)).copy_from(&best);
    Some(whole)
}

/// What blocks of cells say, row by row.
struct Blocks {
    across: usize,
    down: usize,
    parameters: usize,
    scores: Vec<f64>,
    /// Empty where there are many.
    matrices: Vec<f64>,
}

impl Blocks {
    /// By how much each block moves the solution; `None` where it has no cell.
    fn steps(&self, (matrix, inverse): (&DMatrix<f64>, &DMatrix<f64>), first: usize) -> Vec<Option<DVector<f64>>> {
        let (n, p) = (matrix.nrows(), self.parameters);
        let step = |(block, score): (usize, &[f64])| {
            if score.iter().all(|v| *v == 0.0) {
                return None;
            }
            let score = DVector::from_column_slice(&score[first..][..n]);
            let own = self.matrices.get(block * p * p..(block + 1) * p * p);
            let without = own.map(|own| matrix - DMatrix::from_fn(n, n, |i, j| own[(first + i) * p + first + j]));
            let plain = inverse * &score;
            // Without a block that holds nearly all, the others say nothing.
            const MOST: f64 = 4.0;
            let apart = without.and_then(|without| without.lu().solve(&score));
            Some(apart.filter(|step| step.norm() < MOST * plain.norm()).unwrap_or(plain))
        };
        self.scores.chunks_exact(p).enumerate().map(step).collect()
    }

    /// The covariance that the blocks show, and how many have any cell.
    fn scatter(&self, normal: (&DMatrix<f64>, &DMatrix<f64>), first: usize) -> (DMatrix<f64>, usize) {
        let n = normal.0.nrows();
        let steps = self.steps(normal, first);
        let mut apart = DMatrix::<f64>::zeros(n, n);
        steps.iter().flatten().for_each(|step| apart += step * step.transpose());
        // Each block with its neighbours to the right and below, at all four places.
        let mut together = DMatrix::<f64>::zeros(n, n);
        for y in 0..=self.down {
            for x in 0..=self.across {
                let of = |dx: usize, dy: usize| {
                    let (x, y) = ((x + dx).checked_sub(1)?, (y + dy).checked_sub(1)?);
                    (x < self.across && y < self.down).then(|| steps[y * self.across + x].as_ref()).flatten()
                };
                let four = [of(0, 0), of(1, 0), of(0, 1), of(1, 1)];
                let sum = four.into_iter().flatten().fold(DVector::zeros(n), |sum, step| sum + step);
                together += &sum * sum.transpose() / 4.0;
            }
        }
        // A square twice as wide loses half as much over its border: what neither would lose.
        let grown: Vec<f64> = (0..n)
            .map(|i| if apart[(i, i)] > 0.0 { 2.0 * (together[(i, i)] / apart[(i, i)]) - 1.0 } else { 1.0 })
            .map(|ratio| ratio.max(1.0).sqrt())
            .collect();
        let covariance = DMatrix::from_fn(n, n, |i, j| apart[(i, j)] * grown[i] * grown[j]);
        (covariance, steps.iter().flatten().count())
    }

    /// Four blocks to one.
    fn doubled(&self) -> Blocks {
        let (across, down) = (self.across.div_ceil(2), self.down.div_ceil(2));
        let joined = |values: &[f64], each: usize| {
            let mut joined = vec![0.0; if values.is_empty() { 0 } else { each * across * down }];
            for (i, own) in values.chunks_exact(each).enumerate() {
                let target = (i / self.across / 2 * across + i % self.across / 2) * each;
                joined[target..].iter_mut().zip(own).for_each(|(sum, v)| *sum += v);
            }
            joined
        };
        let (scores, p) = (joined(&self.scores, self.parameters), self.parameters);
        Blocks { across, down, parameters: p, scores, matrices: joined(&self.matrices, p * p) }
    }
}
