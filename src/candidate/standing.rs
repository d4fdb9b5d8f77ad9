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

impl Examined {
    /// Of the detector's own mask, and no candidate.
    pub fn is_turned_down(&self) -> bool {
        self.layer == 0 && self.found.is_empty()
    }
}

/// Candidates that stand, by y.
#[derive(Default)]
pub(crate) struct Standing {
    marks: Vec<Mark>,
    /// Of the tallest.
    half_height: f64,
}

/// Where a candidate that stands is, and half of its width and height.
struct Mark {
    centre: PixelPoint,
    half: [f64; 2],
}

impl Standing {
    pub fn add<'a>(&mut self, candidates: impl Iterator<Item = &'a Candidate>) {
        let half = |candidate: &Candidate| candidate.size_px.unwrap_or_default().map(|side| side / 2.0);
        self.marks.extend(candidates.map(|candidate| Mark { centre: candidate.centre, half: half(candidate) }));
        self.marks.sort_by(|a, b| a.centre.y.total_cmp(&b.centre.y));
        self.half_height = self.marks.iter().map(|mark| mark.half[1]).fold(0.0, f64::max);
    }

    fn between(&self, least_y: f64, most_y: f64) -> impl Iterator<Item = &Mark> {
        let from = self.marks.partition_point(|mark| mark.centre.y < least_y);
        self.marks[from..].iter().take_while(move |mark| mark.centre.y <= most_y)
    }

    /// Whether one lies in a window: a region with these bounds is of its mark.
    pub fn any_in(&self, window: &Window) -> bool {
        let (left, right) = (window.x as f64, window.right() as f64);
        self.between(window.y as f64, window.bottom() as f64).any(|mark| (left..=right).contains(&mark.centre.x))
    }

    /// Whether one is of the same mark as a candidate: their centres are near, or the candidate lies in the bounds of
    /// the other, as the field of a chequer does.
    pub fn any_like(&self, candidate: &Candidate) -> bool {
        /// Centres of one mark lie within this share of its side.
        const APART: f64 = 0.5;
        let (at, near) = (candidate.centre, APART * candidate.area_px.unwrap_or(0.0).sqrt());
        let reach = near.max(self.half_height);
        self.between(at.y - reach, at.y + reach).any(|mark| {
            let [dx, dy] = [mark.centre.x - at.x, mark.centre.y - at.y];
            dx.hypot(dy) <= near || dx.abs() <= mark.half[0] && dy.abs() <= mark.half[1]
        })
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
            kept.extend(found.iter().cloned());
        }
        standing.add(kept.iter());
    }
    examined.into_iter().flat_map(|one| one.found).collect()
}
