//! What a pass over both models gathers: residuals, normal equations, and scores of blocks.

use autoref_raster::exact_sum::ExactSum;

use super::parameters::SHIFTS;
use super::residuals::AbsHistogram;
use super::weighing::Weighing;

/// Number of slope classes.
pub const SLOPES: usize = 8;
/// The middle of each class: how much a residual there tells about the shift.
const SLOPE_TANGENTS: [f64; SLOPES] = [0.015, 0.05, 0.11, 0.22, 0.4, 0.65, 1.0, 1.5];

/// What a pass does beside the histograms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Gather {
    /// Nothing.
    Residuals,
    /// Nothing, of every n-th row of blocks: how wide residuals scatter.
    Scatter { blocks_apart: u64 },
    /// Normal equations with the weights.
    Normal { scales: [f64; SLOPES], weighing: Weighing },
    /// Normal equations with the derivative of the weighed residual, and the scores block by block, for the covariance.
    Scores { scales: [f64; SLOPES], weighing: Weighing, block_px: u64 },
}

impl Gather {
    pub(super) fn solves(&self) -> bool {
        matches!(self, Gather::Normal { .. } | Gather::Scores { .. })
    }
}

/// Whether cells without any slope take part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flats {
    /// Water and filled holes tell nothing about a shift.
    LeftOut,
    Kept,
}

/// What a pass gathers. Sums are exact, so that joining them in any order gives the same bits.
#[derive(Clone)]
pub struct Sums {
    /// Shifts, and terms of the surface.
    parameters: usize,
    matrix: Vec<ExactSum>,
    right: Vec<ExactSum>,
    /// Matrix (row by row) and right-hand side of the shift with the template's gradient as it is.
    rough: [ExactSum; ROUGH],
    /// By slope class.
    pub residuals: Vec<AbsHistogram>,
    /// Cells that both models have (and that lie on stable ground, where that is given).
    pub common: u64,
    /// Of them, those with a slope.
    pub sloping: u64,
    /// Of them, those whose weight is not zero.
    pub used: u64,
    /// Scores by block, fixed point, `parameters` for each.
    scores: Vec<i128>,
    /// Matrices by block, fixed point, where there are few blocks; else empty.
    matrices: Vec<i128>,
}

/// Of more blocks none weighs enough to be told from the others.
const BLOCKS_APART: usize = 2048;

/// Of the shift's own equations: four of the matrix, two of the right-hand side.
pub(super) const ROUGH: usize = 6;

/// Units of a score: 2⁻⁵⁰.
const SCORE_UNIT: f64 = (1u64 << 50) as f64;

impl Sums {
    pub(super) fn new(parameters: usize, blocks: usize) -> Self {
        Sums {
            parameters,
            matrix: vec![ExactSum::default(); parameters * parameters],
            right: vec![ExactSum::default(); parameters],
            rough: Default::default(),
            residuals: vec![AbsHistogram::default(); SLOPES],
            common: 0,
            sloping: 0,
            used: 0,
            scores: vec![0; parameters * blocks],
            matrices: vec![0; if blocks <= BLOCKS_APART { parameters * parameters * blocks } else { 0 }],
        }
    }

    /// Adds another's sums, exactly: their order does not matter.
    pub fn merge(&mut self, other: &Sums) {
        self.matrix.iter_mut().zip(&other.matrix).for_each(|(a, b)| a.merge(b));
        self.right.iter_mut().zip(&other.right).for_each(|(a, b)| a.merge(b));
        self.rough.iter_mut().zip(&other.rough).for_each(|(a, b)| a.merge(b));
        self.residuals.iter_mut().zip(&other.residuals).for_each(|(a, b)| a.merge(b));
        self.common += other.common;
        self.sloping += other.sloping;
        self.used += other.used;
        self.scores.iter_mut().zip(&other.scores).for_each(|(a, b)| *a += b);
        self.matrices.iter_mut().zip(&other.matrices).for_each(|(a, b)| *a += b);
    }

    /// How many parameters the equations are of.
    pub fn parameters(&self) -> usize {
        self.parameters
    }

    /// An element of the normal equations' matrix.
    pub fn matrix(&self, row: usize, column: usize) -> f64 {
        self.matrix[row * self.parameters + column].value()
    }

    /// An element of their right-hand side.
    pub fn right(&self, row: usize) -> f64 {
        self.right[row].value()
    }

    /// The step of the shift, cells, by the template's gradient as it is, after a pass for scores. From the step that
    /// the smoothed gradient tells it differs by what interpolation makes of rough ground. `None` where the equations
    /// have no solution.
    pub fn rough_step(&self) -> Option<[f64; SHIFTS]> {
        let [xx, xy, yx, yy, x, y] = self.rough.each_ref().map(ExactSum::value);
        let determinant = xx * yy - xy * yx;
        let step = [(yy * x - xy * y) / determinant, (xx * y - yx * x) / determinant];
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Scores of the blocks, row by row, [`Sums::parameters`] for each.
    pub fn block_scores(&self) -> Vec<f64> {
        self.scores.iter().map(|v| *v as f64 / SCORE_UNIT).collect()
    }

    /// What each block adds to the matrix of the normal equations, row by row; empty where there are many blocks.
    pub fn block_matrices(&self) -> Vec<f64> {
        self.matrices.iter().map(|v| *v as f64 / SCORE_UNIT).collect()
    }

    /// Standard deviation of the residuals in each slope class; a class with few cells has that of all.
    ///
    /// `floor`: what a scale is at least. No class counts as more than ten times as precise as all together.
    pub fn scales(&self, floor: f64) -> [f64; SLOPES] {
        const ENOUGH: u64 = 200;
        let mut all = AbsHistogram::default();
        self.residuals.iter().for_each(|h| all.merge(h));
        let overall = all.scale();
        std::array::from_fn(|class| {
            let own = &self.residuals[class];
            let scale = if own.total >= ENOUGH { own.scale() } else { overall };
            scale.max(overall / 10.0).max(floor)
        })
    }

    /// How badly the models fit where they slope: scales of the classes, weighed by their tangents and counts.
    pub fn misfit(&self) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (histogram, tangent) in self.residuals.iter().zip(SLOPE_TANGENTS) {
            sum += histogram.median() * tangent * histogram.total as f64;
            weight += tangent * histogram.total as f64;
        }
        if weight > 0.0 { sum / weight } else { f64::INFINITY }
    }

    /// Takes the sums of a block, and its scores where they are held block by block.
    pub(super) fn take<const N: usize>(&mut self, partial: &Partial<N>, block: Option<usize>) {
        for (sum, &term) in self.matrix.iter_mut().zip(partial.matrix.as_flattened()) {
            sum.add(term);
        }
        for (sum, &term) in self.right.iter_mut().zip(&partial.right) {
            sum.add(term);
        }
        for (sum, &term) in self.rough.iter_mut().zip(&partial.rough) {
            sum.add(term);
        }
        if let Some(block) = block {
            for (score, &term) in self.scores[block * N..][..N].iter_mut().zip(&partial.right) {
                *score += (term * SCORE_UNIT) as i128;
            }
            if let Some(own) = self.matrices.get_mut(block * N * N..(block + 1) * N * N) {
                for (sum, &term) in own.iter_mut().zip(partial.matrix.as_flattened()) {
                    *sum += (term * SCORE_UNIT) as i128;
                }
            }
        }
    }
}

/// Plain sums of a block, made in one fixed order.
pub struct Partial<const N: usize> {
    pub matrix: [[f64; N]; N],
    pub right: [f64; N],
    pub rough: [f64; ROUGH],
}

impl<const N: usize> Partial<N> {
    pub(super) fn add(&mut self, left: &[f64; N], right: &[f64; N], curvature: f64, weighed: f64) {
        for (i, &l) in left.iter().enumerate() {
            self.right[i] += weighed * l;
            let scaled = curvature * l;
            for (sum, &r) in self.matrix[i].iter_mut().zip(right) {
                *sum += scaled * r;
            }
        }
    }

    /// The shift alone, by the template's gradient as it is.
    pub(super) fn add_rough(&mut self, [tx, ty]: [f64; 2], [ox, oy]: [f64; 2], curvature: f64, weighed: f64) {
        let of_matrix = [tx * ox, tx * oy, ty * ox, ty * oy].map(|term| curvature * term);
        let terms = of_matrix.into_iter().chain([weighed * tx, weighed * ty]);
        self.rough.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
}
