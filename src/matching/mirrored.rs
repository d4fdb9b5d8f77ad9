//! Images that may be mirrored: film scanned from its back, transparencies copied face down.

use autoref_raster::coords::{Handedness, PixelPoint};

use super::{Evidence, MatchOutcome, Matcher, Pattern, Priors, Solved};
use crate::candidate::Candidate;
use crate::gcp::Gcp;

/// Asks another matcher for the pattern as the image shows it, and as its mirror image would.
///
/// These are two chances for a false alarm: the matcher within should have half of what is allowed. A list that is its
/// own mirror image fits both ways; then neither is believed, unless one is expected.
pub struct MirrorMatcher {
    pub within: Box<dyn Matcher>,
    /// What the image says of itself: looked for first, and believed where it fits.
    pub expected: Option<Handedness>,
}

impl Matcher for MirrorMatcher {
    fn find(&self, candidates: &[Candidate], gcps: &[Gcp], priors: &Priors) -> MatchOutcome {
        // Any axis serves: without a size, that of the candidate farthest right.
        let right_px = || candidates.iter().map(|c| c.centre.x).fold(0.0, f64::max);
        let width_px = priors.image_size_px.map_or_else(right_px, |size| size.0);
        let turned: Vec<Candidate> = candidates.iter().map(|c| turned_over(c, width_px)).collect();
        let back = |pattern: Pattern| Pattern { similarity: pattern.similarity.mirrored(width_px), ..pattern };
        let turned_back = |solved: Solved| {
            let Solved { pattern, runner_up, effort, names } = solved;
            MatchOutcome::Solved(Box::new(Solved {
                pattern: back(pattern),
                runner_up: runner_up.map(back),
                effort,
                names,
            }))
        };
        if self.expected == Some(Handedness::Mirrored)
            && let MatchOutcome::Solved(solved) = self.within.find(&turned, gcps, priors)
        {
            return turned_back(*solved);
        }
        let as_is = self.within.find(candidates, gcps, priors);
        let done = match self.expected {
            Some(Handedness::AsIs) => matches!(as_is, MatchOutcome::Solved(_)),
            // That way was tried above.
            Some(Handedness::Mirrored) => true,
            None => false,
        };
        if done {
            return as_is;
        }
        match (as_is, self.within.find(&turned, gcps, priors)) {
            (MatchOutcome::Solved(one), MatchOutcome::Solved(other)) => two_ways(*one, back(other.pattern)),
            (MatchOutcome::NoMatch(_), MatchOutcome::Solved(solved)) => turned_back(*solved),
            (as_is, _) => as_is,
        }
    }
}

/// The candidate as the mirror image of a picture of this width has it.
fn turned_over(candidate: &Candidate, width_px: f64) -> Candidate {
    Candidate {
        centre: PixelPoint { x: width_px - candidate.centre.x, y: candidate.centre.y },
        covariance_px2: candidate.covariance_px2.map(|[xx, xy, yy]| [xx, -xy, yy]),
        ..candidate.clone()
    }
}

/// Both fit. One of them stands when it has more than twice the points of the other, as a repetition must.
fn two_ways(as_is: Solved, mirrored: Pattern) -> MatchOutcome {
    let (one, other) = (as_is.pattern.pairs.len(), mirrored.pairs.len());
    if one > 2 * other {
        return MatchOutcome::Solved(Box::new(as_is));
    }
    if other > 2 * one {
        let Solved { pattern, effort, names, .. } = as_is;
        return MatchOutcome::Solved(Box::new(Solved { pattern: mirrored, runner_up: Some(pattern), effort, names }));
    }
    MatchOutcome::NoMatch(Box::new(Evidence {
        reason: format!("the points fit the image as it is ({one} marks) and mirrored ({other} marks)"),
        advice: vec!["leave out --allow-mirrored when the image is not mirrored, or flip the image when it is".into()],
        best: Some(as_is.pattern),
        runner_up: Some(mirrored),
        effort: as_is.effort,
        diagnoses: Vec::new(),
    }))
}
