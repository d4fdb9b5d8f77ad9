//! Deviations that allow for ties that err together.
//!
//! N⁻¹ is the covariance of the unknowns when every measurement errs for itself and by what is stated of it. Matched
//! ties do not: some are better than others, what the lens model leaves is alike at one place of all images, a frame
//! that moved is wrong as a whole, and neighbouring ties follow the same shadow. The ties' pulls show it: with
//! s_c = Σ Jᵀr over the ties of cluster c, reduced to the cameras, N⁻¹ (M + Σ s_c s_cᵀ) N⁻¹ is the covariance that the
//! residuals themselves bear out, where M is what GCPs and priors add to N by the deviations stated of them
//! (K.-Y. Liang and S. L. Zeger, *Longitudinal data analysis using generalized linear models*, 1986; A. C. Cameron,
//! J. B. Gelbach and D. L. Miller, *Robust inference with multiway clustering*, 2011, who add and subtract several ways
//! of clustering where the largest is taken here: each tie a cluster, or those of one place or frame). Its pulls are
//! those of a tie as a whole: what two rays do not show of their errors takes no part. No deviation gets smaller by it
//! than by N⁻¹.
//!
//! What a too simple lens model bends shows in residuals only in part, since the other unknowns give way. Where the
//! ties would fit better, beyond all chance, with those of Brown's terms free that are held, the way that an unknown
//! would go counts as one more deviation (the difference of two estimators, on which J. A. Hausman's test is built:
//! *Specification tests in econometrics*, 1978).

use nalgebra::{DVector, Matrix3, SMatrix, SVector, Vector3};

use super::linear::{Curvature, linear};
use super::normal::{Factored, Reduced};
use super::other_lens::OtherLens;
use super::problem::{BundlePoint, Loss, Problem};
use super::skyline::Skyline;
use crate::camera::Parameter;

/// What a lens with more terms would change.
#[derive(Clone, Debug)]
pub struct MissingTerms {
    /// Held terms with which the ties would fit better.
    pub terms: Vec<Parameter>,
    /// What would change most of all interiors; `None` where none is adjusted.
    pub moved: Option<Moved>,
}

/// An interior parameter that would change, in units of its own.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    pub camera: usize,
    pub parameter: Parameter,
    pub by: f64,
}

/// Cells along a side of the image, and of the ground, that make a cluster.
const CELLS: usize = 6;
/// Clusters of frames.
const MOST_FRAMES: usize = 64;

/// The factored normal equations, the pulls of clusters of ties, and what another lens would change.
pub struct Deviations {
    factored: Factored,
    /// What GCPs and priors add to the normal equations: by the deviations that are stated of them.
    stated: Skyline,
    /// Σ s sᵀ of the pull s of each tie.
    by_tie: Skyline,
    /// One list for each way of clustering: the pull of each cluster, and the factor C/(C − 1).
    ways: Vec<(f64, Vec<DVector<f64>>)>,
    other_lens: Option<OtherLens>,
}

impl Deviations {
    /// Of the solution; the first `ties` points are ties.
    pub fn new(problem: &Problem, factored: Factored, loss: Loss, ties: usize) -> Deviations {
        let places = Cells::of(problem.observations.iter().filter(|o| o.point < ties).map(|o| o.pixel));
        let ground = Cells::of_most(problem.points[..ties].iter().map(|p| [p.xyz.x, p.xyz.y]).collect());
        let share = problem.frames.len().div_ceil(MOST_FRAMES).max(1);
        let groups = [CELLS * CELLS, problem.frames.len().div_ceil(share), CELLS * CELLS];
        let mut sums: Vec<Vec<Option<DVector<f64>>>> = groups.iter().map(|n| vec![None; *n]).collect();
        let layout = &factored.layout;
        let left = problem.share_left();
        let mut by_tie = Skyline::new(layout.first.clone());
        let mut own = DVector::zeros(layout.size);
        for (index, BundlePoint { xyz, .. }) in problem.points[..ties].iter().enumerate() {
            for o in layout.of_point[index].iter().map(|i| &problem.observations[*i as usize]) {
                let clusters = [places.cell(o.pixel), o.frame / share, ground.cell([xyz.x, xyz.y])];
                let Some(l) = linear(problem, layout, o, loss, Curvature::Weights) else { continue };
                for (sums, cluster) in sums.iter_mut().zip(clusters) {
                    let sum = sums[cluster].get_or_insert_with(|| DVector::zeros(layout.size));
                    factored.add_pull(problem, o, &l, sum);
                }
                factored.add_pull(problem, o, &l, &mut own);
            }
            let pulled = factored.pulled_by(index);
            for (k, row) in pulled.iter().enumerate() {
                for column in &pulled[..=k] {
                    by_tie.add(*row, *column, own[*row] * own[*column] / left);
                }
            }
            pulled.into_iter().for_each(|at| own[at] = 0.0);
        }
        let ways = sums.into_iter().map(|way| {
            let pulls: Vec<DVector<f64>> = way.into_iter().flatten().collect();
            let n = pulls.len() as f64;
            (if n > 1.0 { n / (n - 1.0) } else { 0.0 }, pulls)
        });
        let (ways, stated) = (ways.collect(), Reduced::of_stated(problem, layout, loss, ties));
        Deviations { ways, stated, by_tie, factored, other_lens: OtherLens::of(problem, loss) }
    }

    /// The terms that the lens lacks. `None` where it is as its model, or what they would change of the interiors is
    /// less than what the clusters bear out.
    pub fn missing_terms(&self) -> Option<MissingTerms> {
        let other = self.other_lens.as_ref()?;
        let of = |camera: usize| {
            let at = self.factored.layout.interior_at[camera];
            let columns = self.factored.columns(at, self.factored.layout.active[camera].len());
            let alone = self.factored.interior(camera).into_iter().zip(columns);
            alone.map(move |((parameter, sigma), column)| {
                let deviation = self.variance(&column).sqrt().max(sigma);
                let by = other.interior(camera, parameter);
                (by.abs() / deviation, Moved { camera, parameter, by })
            })
        };
        let most = (0..self.factored.layout.active.len()).flat_map(of).max_by(|a, b| a.0.total_cmp(&b.0));
        let counts = most.is_none_or(|(size, _)| size > 1.0);
        counts.then(|| MissingTerms { terms: other.terms.clone(), moved: most.map(|(_, moved)| moved) })
    }

    /// The variance of an unknown, of which `column` is that of N⁻¹: by what is stated of GCPs and priors, and by what
    /// ties show, each for itself or by the way of clustering that makes it largest.
    fn variance(&self, column: &DVector<f64>) -> f64 {
        let way = |(factor, pulls): &(f64, Vec<DVector<f64>>)| {
            factor * pulls.iter().map(|pull| pull.dot(column).powi(2)).sum::<f64>()
        };
        let column_of = column.as_slice();
        let ties = self.ways.iter().map(way).fold(self.by_tie.quadratic(column_of), f64::max);
        self.stated.quadratic(column_of) + ties
    }

    /// Covariance of a frame's turn (radians, R ← exp(δ) R) and centre.
    pub fn frame(&self, frame: usize) -> SMatrix<f64, 6, 6> {
        let at = self.factored.layout.frame_at[frame];
        let columns = self.factored.columns(at, 6);
        let alone = SMatrix::from_fn(|r, c| columns[c][at + r]);
        let bent = self.other_lens.as_ref().map_or_else(SVector::zeros, |other| other.frame(frame));
        widened(alone, |i| self.variance(&columns[i]), bent)
    }

    /// Covariance of what all positions are off together, where that is adjusted.
    pub fn offset(&self) -> Option<Matrix3<f64>> {
        let at = self.factored.layout.offset_at?;
        let columns = self.factored.columns(at, 3);
        let alone = Matrix3::from_fn(|r, c| columns[c][at + r]);
        let bent = self.other_lens.as_ref().map_or_else(SVector::zeros, OtherLens::offset);
        Some(widened(alone, |i| self.variance(&columns[i]), bent))
    }

    /// What all positions, taken as they stand, seem to be off together, metres, and its covariance (N⁻¹ alone);
    /// `None` where nothing else says so.
    pub fn offset_of_positions(&self, problem: &Problem) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        self.factored.offset_of_positions(problem)
    }

    /// Standard deviations of a camera's active parameters.
    pub fn interior(&self, camera: usize) -> Vec<(Parameter, f64)> {
        let (at, active) = (self.factored.layout.interior_at[camera], &self.factored.layout.active[camera]);
        let columns = self.factored.columns(at, active.len());
        let whole = active.iter().enumerate().map(|(i, p)| {
            let bent = self.other_lens.as_ref().map_or(0.0, |other| other.interior(camera, *p));
            (*p, (self.variance(&columns[i]).max(columns[i][at + i]) + bent * bent).sqrt())
        });
        whole.collect()
    }

    /// Covariance of a surveyed point.
    pub fn point(&self, point: usize) -> Matrix3<f64> {
        let (own, leans) = (self.factored.alone(point), self.factored.leans(point));
        let bent = self.other_lens.as_ref().map_or_else(SVector::zeros, |other| other.point(point));
        widened(self.factored.point(point), |i| own[(i, i)] + self.variance(&leans[i]), bent)
    }
}

/// A covariance whose variances are made as large as `variance` bears out and another lens adds; correlations stay, and
/// none gets smaller.
fn widened<const N: usize>(
    alone: SMatrix<f64, N, N>,
    variance: impl Fn(usize) -> f64,
    bent: SVector<f64, N>,
) -> SMatrix<f64, N, N> {
    let by: [f64; N] = std::array::from_fn(|i| {
        let own = alone[(i, i)];
        let whole = own.max(variance(i)) + bent[i] * bent[i];
        if own > 0.0 { (whole / own).sqrt() } else { 1.0 }
    });
    SMatrix::from_fn(|r, c| alone[(r, c)] * by[r] * by[c])
}

/// Cells over the bounding box of places.
struct Cells {
    low: [f64; 2],
    high: [f64; 2],
}

impl Cells {
    fn of(places: impl Iterator<Item = [f64; 2]>) -> Cells {
        let none = Cells { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2] };
        places.fold(none, |box_, at| Cells {
            low: std::array::from_fn(|a| box_.low[a].min(at[a])),
            high: std::array::from_fn(|a| box_.high[a].max(at[a])),
        })
    }

    /// Over all but a fiftieth at each side: ties near the horizon, and those that are hardly determined, lie far off.
    fn of_most(places: Vec<[f64; 2]>) -> Cells {
        let side = |a: usize| {
            let mut all: Vec<f64> = places.iter().map(|p| p[a]).collect();
            all.sort_unstable_by(f64::total_cmp);
            let at = |part: usize| all.get(all.len().saturating_sub(1) * part / 50).copied().unwrap_or(0.0);
            [at(1), at(49)]
        };
        let [x, y] = [side(0), side(1)];
        Cells { low: [x[0], y[0]], high: [x[1], y[1]] }
    }

    fn cell(&self, at: [f64; 2]) -> usize {
        let along = |a: usize| {
            let part = (at[a] - self.low[a]) / (self.high[a] - self.low[a]).max(f64::MIN_POSITIVE);
            ((part * CELLS as f64) as usize).min(CELLS - 1)
        };
        along(1) * CELLS + along(0)
    }
}
