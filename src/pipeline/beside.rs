//! Marks that are not where the others put their points: those of check points, and those that the stated accuracy of
//! the survey allows.

use std::cell::OnceCell;

use crate::candidate::Candidate;
use crate::gcp::{Gcp, GcpRole};
use crate::matching::field::Field;
use crate::rematch::Expected;
use autoref_raster::coords::PixelPoint;
use autoref_solve::Solution;

/// What becomes of marks beside their points: when the others agree closely, and when the list calls a point unsure.
#[derive(Clone, Copy)]
pub(super) enum Beside {
    /// Marks beside their points leave the fit, but for those that the stated accuracy allows.
    Weighed {
        /// Middle of the image, where it is known.
        middle: Option<PixelPoint>,
    },
    Stay,
}

/// What lies about the places of points that have no mark yet.
pub(super) struct Neighbourhood<'a> {
    gcps: &'a [Gcp],
    candidates: &'a [Candidate],
    solution: &'a Solution,
    /// Deviation of the marks that fit, pixels.
    noise_px: f64,
    /// Candidates that no point has, made when the first is asked for.
    free: OnceCell<Field>,
}

impl<'a> Neighbourhood<'a> {
    pub(super) fn new(
        gcps: &'a [Gcp],
        candidates: &'a [Candidate],
        solution: &'a Solution,
        noise_px: f64,
    ) -> Neighbourhood<'a> {
        Neighbourhood { gcps, candidates, solution, noise_px, free: OnceCell::new() }
    }

    /// Index of the candidate that is a point's mark though it is not where it must be.
    pub(super) fn mark_of(&self, expected: &Expected, taken: &[usize], beside: Beside) -> Option<usize> {
        match (self.gcps[expected.gcp].role, beside) {
            (GcpRole::Check, _) => self.of_check_point(expected, taken),
            (GcpRole::Control, Beside::Weighed { .. }) => self.within_stated(expected, taken),
            (GcpRole::Control, Beside::Stay) => None,
        }
    }

    /// The mark of a check point that is not where it must be. A test that leaves out what fits badly tests nothing:
    /// the nearest mark that is no other point's is the check point's, unless chance puts one so near.
    fn of_check_point(&self, expected: &Expected, taken: &[usize]) -> Option<usize> {
        /// A candidate of clutter may lie so near with this probability at most.
        const CHANCE: f64 = 0.01;
        const FARTHEST_PX: f64 = 64.0;
        // Marks of other points are no clutter.
        let of_all = self.candidates.len();
        let clutter = density(self.candidates) * of_all.saturating_sub(taken.len()).max(1) as f64 / of_all as f64;
        self.nearest_free(expected, chance_radius_px(CHANCE, clutter).min(FARTHEST_PX), taken)
    }

    /// The mark of a control point whose stated accuracy lets it lie farther from its place than the others do, unless
    /// chance puts one so near. The evidence for the pattern is weighed already, without it.
    fn within_stated(&self, expected: &Expected, taken: &[usize]) -> Option<usize> {
        /// As in the search: nobody is taken whom chance would put there more often.
        const CHANCE: f64 = 0.003;
        let scale = self.solution.scale_m_per_px;
        let stated_px = self.gcps[expected.gcp].reach_m() / scale;
        if stated_px <= 0.0 {
            return None;
        }
        let fit_px = self.solution.sigma_at_m(expected.position) / scale;
        let clutter = self.free(taken).density_near(expected.position);
        let reach_px = (Gcp::REACH * self.noise_px.hypot(fit_px)).hypot(stated_px);
        let reach_px = reach_px.min(chance_radius_px(CHANCE, clutter));
        let is_known = |candidate: usize| {
            self.candidates[candidate].covariance_px2.is_none_or(|[xx, _, yy]| xx.max(yy) <= reach_px * reach_px)
        };
        self.nearest_free(expected, reach_px, taken).filter(|candidate| is_known(*candidate))
    }

    /// The nearest candidate within reach that no point has, when it is no nearer to another point's place.
    fn nearest_free(&self, expected: &Expected, reach_px: f64, taken: &[usize]) -> Option<usize> {
        let apart = |c: &Candidate, p: PixelPoint| (c.centre.x - p.x).hypot(c.centre.y - p.y);
        let (distance, candidate) = (0..self.candidates.len())
            .filter(|i| !taken.contains(i))
            .map(|i| (apart(&self.candidates[i], expected.position), i))
            .filter(|(distance, _)| *distance <= reach_px)
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        let place = |gcp: &Gcp| self.solution.similarity.invert(gcp.position());
        let is_nearer = |gcp: &Gcp| apart(&self.candidates[candidate], place(gcp)) < distance;
        let others = self.gcps.iter().enumerate().filter(|(gcp, _)| *gcp != expected.gcp);
        (!others.into_iter().any(|(_, gcp)| is_nearer(gcp))).then_some(candidate)
    }

    fn free(&self, taken: &[usize]) -> &Field {
        self.free.get_or_init(|| {
            let centres = || self.candidates.iter().map(|candidate| candidate.centre);
            let size_px = centres().fold((1.0f64, 1.0f64), |(w, h), centre| (w.max(centre.x), h.max(centre.y)));
            let free = centres().enumerate().filter(|(i, _)| !taken.contains(i)).map(|(_, centre)| centre);
            Field::new(free.collect(), Some(size_px))
        })
    }
}

/// The radius of a circle that holds one of so many candidates per px² by chance so often, pixels.
pub(super) fn chance_radius_px(chance: f64, density: f64) -> f64 {
    (chance / (std::f64::consts::PI * density)).sqrt()
}

/// Candidates per square pixel of the rectangle that holds them.
pub(super) fn density(candidates: &[Candidate]) -> f64 {
    let span = |of: fn(&Candidate) -> f64| {
        let ends = candidates
            .iter()
            .map(of)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        (ends.1 - ends.0).max(1.0)
    };
    candidates.len() as f64 / (span(|c| c.centre.x) * span(|c| c.centre.y))
}
