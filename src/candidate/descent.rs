//! The one least-squares descent of the fits to marks: Levenberg–Marquardt (D. W. Marquardt, "An algorithm for
//! least-squares estimation of nonlinear parameters", 1963).

use nalgebra::{Cholesky, SMatrix, SVector};

/// The damping that a descent begins with.
pub(crate) const FIRST_DAMPING: f64 = 1e-3;
/// A descent ends where even a step so heavily damped leads nowhere.
const MOST_DAMPING: f64 = 1e9;
/// A centre that moves less than this, pixels or cells, has come to rest.
const STILL: f64 = 2e-4;
/// So does a cost that falls by a smaller share.
const SHARE_STILL: f64 = 1e-4;

/// Whether a descent is at rest whose centre moved so far, from one cost to the next.
pub(crate) fn at_rest(centre_moved: f64, before: f64, after: f64) -> bool {
    centre_moved < STILL && before - after < SHARE_STILL * before
}

/// How far residuals are trusted when they are weighed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Trust {
    /// All alike.
    Even,
    /// By Tukey's biweight: what is far off loses its weight.
    Robust,
}

/// The normal equations at a place, with the cost there.
pub(crate) struct Normal<const N: usize> {
    pub h: SMatrix<f64, N, N>,
    pub g: SVector<f64, N>,
    pub cost: f64,
}

/// What is descended.
pub(crate) trait Surface<const N: usize> {
    /// What is known of a place once its cost is.
    type Looked;

    /// The cost at `p`; `None` outside of what is allowed.
    fn look(&self, p: &SVector<f64, N>) -> Option<(f64, Self::Looked)>;

    /// The normal equations at a place that was looked at; `None` when they break down.
    fn normal(&self, p: &SVector<f64, N>, looked: Self::Looked) -> Option<Normal<N>>;

    /// Whether a step that was taken, from one cost to the next, is the last.
    fn rests(&self, step: &SVector<f64, N>, costs: (f64, f64), there: &Self::Looked) -> bool;
}

/// Where a descent ended.
pub(crate) enum End<const N: usize> {
    AtRest(SVector<f64, N>),
    /// Its rounds were spent.
    OnItsWay(SVector<f64, N>),
}

impl<const N: usize> End<N> {
    pub(crate) fn at(&self) -> &SVector<f64, N> {
        match self {
            End::AtRest(p) | End::OnItsWay(p) => p,
        }
    }

    pub(crate) fn place(self) -> SVector<f64, N> {
        match self {
            End::AtRest(p) | End::OnItsWay(p) => p,
        }
    }
}

/// Descends from `p`, at most `rounds` accepted or refused steps; `damping` is that of the last. `None` when the
/// equations break down.
pub(crate) fn descend<const N: usize, S: Surface<N>>(
    surface: &S,
    mut p: SVector<f64, N>,
    looked: S::Looked,
    rounds: usize,
    damping: &mut f64,
) -> Option<End<N>> {
    let mut here = surface.normal(&p, looked)?;
    for _ in 0..rounds {
        let mut damped = here.h;
        for i in 0..N {
            damped[(i, i)] *= 1.0 + *damping;
        }
        let step = Cholesky::new(damped)?.solve(&here.g);
        let next = p + step;
        if let Some((next_cost, there)) = surface.look(&next).filter(|(next_cost, _)| *next_cost <= here.cost) {
            p = next;
            *damping = (*damping * 0.2).max(1e-9);
            if surface.rests(&step, (here.cost, next_cost), &there) {
                return Some(End::AtRest(p));
            }
            here = surface.normal(&p, there)?;
        } else {
            *damping *= 6.0;
            if *damping > MOST_DAMPING {
                return Some(End::AtRest(p));
            }
        }
    }
    Some(End::OnItsWay(p))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// H. H. Rosenbrock's valley (1960) as residuals 10 (y − x²) and 1 − x.
    struct Valley;

    impl Surface<2> for Valley {
        type Looked = ();

        fn look(&self, p: &SVector<f64, 2>) -> Option<(f64, ())> {
            (p[0].abs() < 5.0).then(|| (100.0 * (p[1] - p[0] * p[0]).powi(2) + (1.0 - p[0]).powi(2), ()))
        }

        fn normal(&self, p: &SVector<f64, 2>, (): ()) -> Option<Normal<2>> {
            let jacobian = SMatrix::<f64, 2, 2>::new(-20.0 * p[0], 10.0, -1.0, 0.0);
            let residuals = SVector::<f64, 2>::new(10.0 * (p[1] - p[0] * p[0]), 1.0 - p[0]);
            let cost = residuals.norm_squared();
            Some(Normal { h: jacobian.transpose() * jacobian, g: -jacobian.transpose() * residuals, cost })
        }

        fn rests(&self, step: &SVector<f64, 2>, _costs: (f64, f64), (): &()) -> bool {
            step.norm() < 1e-12
        }
    }

    #[test]
    fn the_foot_of_a_curved_valley_is_reached() {
        let start = SVector::<f64, 2>::new(-1.2, 1.0);
        let end = descend(&Valley, start, (), 200, &mut { FIRST_DAMPING }).expect("regular");
        assert!(matches!(end, End::AtRest(p) if (p - SVector::<f64, 2>::new(1.0, 1.0)).norm() < 1e-9));
        let few = descend(&Valley, start, (), 3, &mut { FIRST_DAMPING }).expect("regular");
        assert!(matches!(few, End::OnItsWay(p) if (p - SVector::<f64, 2>::new(1.0, 1.0)).norm() > 1e-3));
    }
}
