//! Marks that are not where the others put their points: those of check points, and those that the stated accuracy of
//! the survey allows.

use std::cell::OnceCell;

use crate::candidate::{Candidate, least_whole_area_px};
use crate::gcp::{Gcp, GcpRole};
use crate::matching::field::Field;
use crate::rematch::Expected;
use autoref_raster::coords::PixelPoint;
use autoref_raster::ranks::upper_median;
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
    /// How good these are.
    marks: Good,
    /// Candidates that no point has, made when the first is asked for.
    free: OnceCell<Field>,
}

/// A GCP, by index, and its mark.
type Placed<'m> = (usize, &'m Candidate);

/// How good the marks are that fit.
struct Good {
    /// How far their points lie off in stated deviations: 1 where these are true, less where they are too large.
    share_of_stated: f64,
    /// Those of the least of them.
    worst_score: Option<f64>,
    least_area_px: f64,
}

impl Good {
    fn of(marks: &[Placed<'_>], gcps: &[Gcp], solution: &Solution) -> Good {
        /// Squares of two-dimensional normal errors are above so many of their variances as often as below.
        const MEDIAN: f64 = 2.0 * std::f64::consts::LN_2;
        /// What the median of few may be too small by.
        const FEW: f64 = 2.0;
        let square = |&(gcp, mark): &Placed<'_>| {
            let stated_px = gcps[gcp].sigma_m.filter(|sigma| *sigma > 0.0)? / solution.scale_m_per_px;
            let at = solution.similarity.invert(gcps[gcp].position());
            let off_px = (mark.centre.x - at.x).hypot(mark.centre.y - at.y);
            Some((off_px / stated_px).powi(2))
        };
        let mut squares: Vec<f64> = marks.iter().filter_map(square).collect();
        let share = upper_median(&mut squares).map_or(1.0, |median| FEW * (median / MEDIAN).sqrt());
        Good {
            share_of_stated: share.min(1.0),
            worst_score: marks.iter().filter_map(|mark| mark.1.score).min_by(f64::total_cmp),
            least_area_px: least_whole_area_px(marks.iter().map(|mark| mark.1)),
        }
    }

    /// Whether a candidate is as good as the least of them, and no part of a mark.
    fn has(&self, candidate: &Candidate) -> bool {
        let is_good = self.worst_score.is_none_or(|worst| candidate.score.is_none_or(|score| score >= worst));
        is_good && candidate.area_px.is_none_or(|area| area >= self.least_area_px)
    }
}

impl<'a> Neighbourhood<'a> {
    /// About the places that `solution` gives points, which is that of `marks`.
    pub(super) fn new(
        (gcps, candidates): (&'a [Gcp], &'a [Candidate]),
        (solution, marks): (&'a Solution, &[Placed<'_>]),
        noise_px: f64,
    ) -> Neighbourhood<'a> {
        let marks = Good::of(marks, gcps, solution);
        Neighbourhood { gcps, candidates, solution, noise_px, marks, free: OnceCell::new() }
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
    /// chance puts one so near, or the others show that the list states too much. The evidence for the pattern is
    /// weighed already, without it.
    fn within_stated(&self, expected: &Expected, taken: &[usize]) -> Option<usize> {
        /// As in the search: nobody is taken whom chance would put there more often.
        const CHANCE: f64 = 0.003;
        let scale = self.solution.scale_m_per_px;
        let stated_px = self.marks.share_of_stated * self.gcps[expected.gcp].reach_m() / scale;
        if stated_px <= 0.0 {
            return None;
        }
        let fit_px = self.solution.sigma_at_m(expected.position) / scale;
        let clutter = self.free(taken).density_near(expected.position);
        let reach_px = (Gcp::REACH * self.noise_px.hypot(fit_px)).hypot(stated_px);
        let reach_px = reach_px.min(chance_radius_px(CHANCE, clutter));
        let is_known = |candidate: &Candidate| {
            candidate.covariance_px2.is_none_or(|[xx, _, yy]| xx.max(yy) <= reach_px * reach_px)
        };
        let candidate = self.nearest_free(expected, reach_px, taken)?;
        let mark = &self.candidates[candidate];
        (is_known(mark) && self.marks.has(mark)).then_some(candidate)
    }

    /// The nearest candidate within reach that no point has, when it is no nearer to another point's place.
    fn nearest_free(&self, expected: &Expected, reach_px: f64, taken: &[usize]) -> Option<usize> {
        let apart = |c: &Candidate, p: PixelPoint| (c.centre.x - p.x).hypot(c.centre.y - p.y);
        let (distance, candidate) = (0..self.candidates.len())
            .map(|i| (apart(&self.candidates[i], expected.position), i))
            .filter(|(distance, i)| *distance <= reach_px && !taken.contains(i))
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
