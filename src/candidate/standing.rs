//! One candidate of each mark: where several masks show it, the first one's stands.

use super::Candidate;
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::window::Window;

/// Which of a detector's masks a region is of: 0 its own, then those of the detectors beside it.
pub(crate) type Layer = usize;

/// A region that was examined and what became of it.
pub(crate) struct Examined {
    pub layer: Layer,
    pub region: Region,
    pub found: Vec<Candidate>,
}

/// Centres of candidates that stand, by y.
#[derive(Default)]
pub(crate) struct Standing(Vec<PixelPoint>);

impl Standing {
    pub fn add(&mut self, candidates: impl Iterator<Item = PixelPoint>) {
        self.0.extend(candidates);
        self.0.sort_by(|a, b| a.y.total_cmp(&b.y));
    }

    fn between(&self, least_y: f64, most_y: f64) -> impl Iterator<Item = &PixelPoint> {
        let from = self.0.partition_point(|at| at.y < least_y);
        self.0[from..].iter().take_while(move |at| at.y <= most_y)
    }

    /// Whether one lies in a window: a region with these bounds is of its mark.
    pub fn any_in(&self, window: &Window) -> bool {
        let (left, right) = (window.x as f64, window.right() as f64);
        self.between(window.y as f64, window.bottom() as f64).any(|at| (left..=right).contains(&at.x))
    }

    /// Whether one is of the same mark as a candidate.
    pub fn any_like(&self, candidate: &Candidate) -> bool {
        /// Centres of one mark lie within this share of its side.
        const APART: f64 = 0.5;
        let (at, reach) = (candidate.centre, APART * candidate.area_px.unwrap_or(0.0).sqrt());
        self.between(at.y - reach, at.y + reach).any(|other| (other.x - at.x).hypot(other.y - at.y) <= reach)
    }
}

/// All candidates in order; of those of one mark in several layers the one of the first.
pub(crate) fn one_of_each(mut examined: Vec<Examined>) -> Vec<Candidate> {
    examined.sort_by_key(|one| (one.region.first, one.layer));
    let mut standing = Standing::default();
    let layers = examined.iter().map(|one| one.layer + 1).max().unwrap_or(0);
    for layer in 0..layers {
        let mut kept = Vec::new();
        for Examined { region, found, .. } in examined.iter_mut().filter(|one| one.layer == layer) {
            if standing.any_in(&region.bounds) {
                found.clear();
            }
            found.retain(|candidate| !standing.any_like(candidate));
            kept.extend(found.iter().map(|candidate| candidate.centre));
        }
        standing.add(kept.into_iter());
    }
    examined.into_iter().flat_map(|one| one.found).collect()
}
