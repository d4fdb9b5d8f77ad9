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

/// A candidate that stands: where it is, half of its width and height, and its area.
struct Mark {
    centre: PixelPoint,
    half: [f64; 2],
    area_px: f64,
    is_whole: bool,
}

impl Mark {
    fn holds(&self, at: PixelPoint) -> bool {
        (self.centre.x - at.x).abs() <= self.half[0] && (self.centre.y - at.y).abs() <= self.half[1]
    }

    /// Whether a whole mark of so many pixels stands before this one, which may be a part of it.
    fn gives_way_to(&self, area_px: f64) -> bool {
        /// A part is no larger a share of the whole.
        const MOST_OF_WHOLE: f64 = 0.65;
        !self.is_whole && self.area_px <= MOST_OF_WHOLE * area_px
    }
}

/// The mark may be larger than the region that it was found by.
fn side_px(candidate: &Candidate) -> f64 {
    candidate.area_px.unwrap_or(0.0).sqrt()
}

/// Whether the centre is known as that of a whole mark is: of a part that colour found of one, to no better than a
/// share of its own side.
fn is_whole(candidate: &Candidate) -> bool {
    const MOST_OF_SIDE: f64 = 0.2;
    match (candidate.covariance_px2, candidate.area_px) {
        (Some([xx, _, yy]), Some(area_px)) => xx.max(yy) <= MOST_OF_SIDE * MOST_OF_SIDE * area_px,
        _ => true,
    }
}

impl Standing {
    pub fn add<'a>(&mut self, candidates: impl Iterator<Item = &'a Candidate>) {
        let mark = |candidate: &Candidate| Mark {
            centre: candidate.centre,
            half: candidate.size_px.unwrap_or_default().map(|side| side.max(side_px(candidate)) / 2.0),
            area_px: candidate.area_px.unwrap_or(0.0),
            is_whole: is_whole(candidate),
        };
        self.marks.extend(candidates.map(mark));
        self.marks.sort_by(|a, b| a.centre.y.total_cmp(&b.centre.y));
        self.half_height = self.marks.iter().map(|mark| mark.half[1]).fold(0.0, f64::max);
    }

    fn between(&self, least_y: f64, most_y: f64) -> impl Iterator<Item = &Mark> {
        let from = self.marks.partition_point(|mark| mark.centre.y < least_y);
        self.marks[from..].iter().take_while(move |mark| mark.centre.y <= most_y)
    }

    fn in_window(&self, window: &Window) -> impl Iterator<Item = &Mark> {
        let (left, right) = (window.x as f64, window.right() as f64);
        let marks = self.between(window.y as f64, window.bottom() as f64);
        marks.filter(move |mark| (left..=right).contains(&mark.centre.x))
    }

    /// Whether a whole one lies in a window: a region with these bounds is of its mark.
    pub fn any_whole_in(&self, window: &Window) -> bool {
        self.in_window(window).any(|mark| mark.is_whole)
    }

    /// Those of the same mark as a candidate: their centres are near, or the candidate lies in the bounds of the other,
    /// as the field of a chequer does.
    fn like(&self, candidate: &Candidate) -> impl Iterator<Item = &Mark> {
        /// Centres of one mark lie within this share of its side.
        const APART: f64 = 0.5;
        let (at, near) = (candidate.centre, APART * side_px(candidate));
        let reach = near.max(self.half_height);
        let is_like = move |mark: &&Mark| (mark.centre.x - at.x).hypot(mark.centre.y - at.y) <= near || mark.holds(at);
        self.between(at.y - reach, at.y + reach).filter(is_like)
    }

    /// Whether one is of the same mark as a candidate.
    pub fn any_like(&self, candidate: &Candidate) -> bool {
        self.like(candidate).next().is_some()
    }

    /// Whether one is of the same mark as a candidate, and no part of it.
    pub fn any_before(&self, candidate: &Candidate) -> bool {
        let (is_whole, area_px) = (is_whole(candidate), candidate.area_px.unwrap_or(0.0));
        self.like(candidate).any(|mark| !(is_whole && mark.gives_way_to(area_px)))
    }

    /// Whether a candidate is a part of a whole mark that stands.
    pub fn any_around(&self, candidate: &Candidate) -> bool {
        let mut part = Standing::default();
        part.add(std::iter::once(candidate));
        let (part, at) = (&part.marks[0], candidate.centre);
        let reach = self.half_height.max(part.half[1]);
        let mut marks = self.between(at.y - reach, at.y + reach);
        let is_of = |mark: &Mark| mark.holds(at) || part.holds(mark.centre);
        marks.any(|mark| mark.is_whole && is_of(mark) && part.gives_way_to(mark.area_px))
    }
}

/// All candidates in order; of those of one mark in several layers the one of the first, but no part before a whole.
pub(crate) fn one_of_each(mut examined: Vec<Examined>) -> Vec<Candidate> {
    examined.sort_by_key(|one| (one.region.first, one.layer));
    let mut standing = Standing::default();
    let layers = examined.iter().map(|one| one.layer + 1).max().unwrap_or(0);
    for layer in 0..layers {
        let mut kept = Vec::new();
        for Examined { region, found, .. } in examined.iter_mut().filter(|one| one.layer == layer) {
            if standing.any_whole_in(&region.bounds) {
                found.clear();
            }
            let is_in_bounds = standing.in_window(&region.bounds).next().is_some();
            found.retain(|candidate| !(is_in_bounds && !is_whole(candidate) || standing.any_before(candidate)));
            kept.extend(found.iter().cloned());
        }
        standing.add(kept.iter());
    }
    let all = examined.into_iter().flat_map(|one| one.found);
    all.filter(|candidate| !standing.any_around(candidate)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(x: f64, side_px: f64, sigma_px: f64) -> Candidate {
        Candidate {
            covariance_px2: Some([sigma_px * sigma_px, 0.0, sigma_px * sigma_px]),
            area_px: Some(side_px * side_px),
            size_px: Some([side_px; 2]),
            ..Candidate::at(PixelPoint { x, y: 50.0 })
        }
    }

    fn seen(layer: Layer, candidate: Candidate) -> Examined {
        let half = (candidate.size_px.expect("given")[0] / 2.0) as u64;
        let pixel = Window::new(candidate.centre.x as u64, candidate.centre.y as u64, 1, 1);
        let bounds = pixel.grown(half, &Window::new(0, 0, 1000, 1000));
        let region = Region {
            first: (bounds.y, bounds.x),
            bounds,
            area: bounds.area(),
            sum_x: 0,
            sum_y: 0,
            sum_xx: 0,
            sum_xy: 0,
            sum_yy: 0,
            perimeter: 2 * (bounds.width + bounds.height),
        };
        Examined { layer, region, found: vec![candidate] }
    }

    /// Where the limit of the colour cuts through a mark its own mask holds specks, and each was a candidate.
    #[test]
    fn a_whole_mark_stands_before_its_specks() {
        let whole = candidate(100.0, 28.0, 0.02);
        let specks = [92.0, 105.0].map(|x| candidate(x, 3.0, 1.1));
        let all = || specks.iter().cloned().map(|speck| seen(0, speck));
        let found = one_of_each(all().chain([seen(1, whole.clone())]).collect());
        assert_eq!(found, std::slice::from_ref(&whole));
        let found = one_of_each(all().chain([seen(0, whole.clone())]).collect());
        assert_eq!(found, std::slice::from_ref(&whole));
        // A mark of its own on something of nearly its colour stays, and so do specks of nothing.
        let own = candidate(95.0, 8.0, 0.04);
        assert_eq!(one_of_each(vec![seen(0, own.clone()), seen(1, whole)]), [own]);
        assert_eq!(one_of_each(all().collect()).len(), 2);
        let unsure = candidate(100.0, 28.0, 9.0);
        assert_eq!(one_of_each(all().chain([seen(1, unsure)]).collect()).len(), 2);
    }
}
