//! Where two points laid on two GCPs put the others, and which of these places count at a tolerance.

use std::cell::OnceCell;

use crate::matching::field::Field;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_solve::Similarity;

/// What two points laid on two GCPs predict: the same for every tolerance.
pub(super) struct Predictions {
    /// The two points.
    ends: [PixelPoint; 2],
    /// In the image, in the order of the list.
    pub of: Vec<Prediction>,
}

pub(super) struct Prediction {
    pub place: PixelPoint,
    /// How far off it may be, against one mark's error.
    pub spread: f64,
    /// The nearest candidate that may be the GCP, and the square of its distance.
    nearest: Option<(usize, f64)>,
    /// Points per px² about it, once somebody asks.
    density: OnceCell<f64>,
}

impl Prediction {
    /// The radius for a tolerance that is `level_px` in the middle.
    pub fn radius_px(&self, level_px: f64) -> f64 {
        level_px * self.spread
    }

    /// The nearest candidate within the tolerance.
    pub fn hit_at(&self, level_px: f64) -> Option<usize> {
        let radius_px = self.radius_px(level_px);
        self.nearest.filter(|nearest| nearest.1 <= radius_px * radius_px).map(|nearest| nearest.0)
    }

    /// Points per px² about the place.
    pub fn density(&self, field: &Field) -> f64 {
        *self.density.get_or_init(|| field.density_near(self.place))
    }
}

/// A prediction that counts at a tolerance.
#[derive(Clone, Copy)]
pub(super) struct Counted {
    /// Its place in [`Predictions::of`].
    pub index: usize,
    /// To the nearest place that counted before it.
    pub nearest_px: f64,
    /// The area in which a mark is a hit, over that of the prediction's own circle: more where one of several points of
    /// one place may be the mark.
    pub area_share: f64,
}

impl Predictions {
    /// At tolerances up to `most_px`; `may` says which candidate can be which GCP. `None` where the pair of GCPs is one
    /// place.
    pub fn of(
        field: &Field,
        gcps: &[MapPoint],
        (a, b): (usize, usize),
        ends: [PixelPoint; 2],
        most_px: f64,
        may: &dyn Fn(usize, usize) -> bool,
    ) -> Option<Self> {
        let similarity = Similarity::through(ends, [gcps[a], gcps[b]])?;
        let others = gcps.iter().enumerate().filter(|&(k, _)| k != a && k != b);
        let placed = others.map(|(gcp, at)| (gcp, *at, similarity.invert(*at)));
        let of = placed.filter(|(_, _, place)| field.contains(*place)).map(|(gcp, at, place)| {
            let spread = spread_from_pair(gcps[a], gcps[b], at);
            let nearest = field.nearest_square(place, most_px * spread, |candidate| may(candidate, gcp));
            Prediction { place, spread, nearest, density: OnceCell::new() }
        });
        Some(Predictions { ends, of: of.collect() })
    }

    /// The predictions that count at a tolerance: of circles that touch, and of places that one mark covers, the first.
    /// A point that was surveyed twice is no second witness, nor is a mark that was found in two pieces. Where two
    /// surveys of a point differ, the one that has a mark speaks for both, and chance has both circles.
    pub fn counted(&self, field: &Field, level_px: f64) -> Vec<Counted> {
        let mut told = Told::about(self.ends, level_px, field.usual_place_px(), self.of.len());
        let mut counted: Vec<Counted> = Vec::with_capacity(self.of.len());
        for (index, prediction) in self.of.iter().enumerate() {
            match told.take(prediction.place, prediction.radius_px(level_px)) {
                Ok(nearest_px) => counted.push(Counted { index, nearest_px, area_share: 1.0 }),
                // The ends of the hypothesis have their marks.
                Err(Blocked::OnePlace(told)) if told >= self.ends.len() => {
                    self.take_twin(&mut counted[told - self.ends.len()], index, level_px);
                }
                Err(_) => {}
            }
        }
        counted
    }

    /// Another point of a place that counts. One so near that its circle is the same tells nothing new.
    fn take_twin(&self, counted: &mut Counted, twin: usize, level_px: f64) {
        /// Of the radius.
        const SAME_CIRCLE: f64 = 0.5;
        let (first, other) = (&self.of[counted.index], &self.of[twin]);
        let apart_px = (first.place.x - other.place.x).hypot(first.place.y - other.place.y);
        let radius_px = other.radius_px(level_px);
        if apart_px <= SAME_CIRCLE * radius_px {
            return;
        }
        // What the second circle adds to the first: all of it at most, and near the first 2/π of the distance in radii.
        counted.area_share += (std::f64::consts::FRAC_2_PI * apart_px / radius_px).min(1.0);
        if first.hit_at(level_px).is_none() && other.hit_at(level_px).is_some() {
            counted.index = twin;
        }
    }
}

/// Why a place does not count.
enum Blocked {
    /// One mark covers it and the place of this number that was told before.
    OnePlace(usize),
    /// Its circle touches another.
    Touching,
}

/// Where something was predicted already, and how closely.
struct Told {
    x: Vec<f64>,
    y: Vec<f64>,
    radius_px: Vec<f64>,
    usual_place_px: f64,
}

impl Told {
    /// Places that are looked at together.
    const TOGETHER: usize = 16;

    /// With the ends of a hypothesis, each a circle of the tolerance.
    fn about(ends: [PixelPoint; 2], level_px: f64, usual_place_px: f64, room: usize) -> Self {
        let empty = || Vec::with_capacity(room + ends.len());
        let mut told = Told { x: empty(), y: empty(), radius_px: empty(), usual_place_px };
        ends.iter().for_each(|end| told.push(*end, level_px));
        told
    }

    fn push(&mut self, place: PixelPoint, radius_px: f64) {
        self.x.push(place.x);
        self.y.push(place.y);
        self.radius_px.push(radius_px);
    }

    /// Takes in a place that counts, and says how far the nearest before it is; else why it does not count.
    fn take(&mut self, place: PixelPoint, radius_px: f64) -> Result<f64, Blocked> {
        let nearest_px = self.nearest_px(place, radius_px)?;
        self.push(place, radius_px);
        Ok(nearest_px)
    }

    /// How far the nearest of them is from a place, where none's circle touches that of the place and no mark covers
    /// both.
    fn nearest_px(&self, place: PixelPoint, radius_px: f64) -> Result<f64, Blocked> {
        let surely_one = self.usual_place_px * self.usual_place_px * (1.0 - 1e-9);
        let mut nearest = f64::INFINITY;
        let (mut end, all) = (self.x.len(), (&self.x[..], &self.y[..], &self.radius_px[..]));
        // Lists follow the ground: the last ones lie nearest. Squares and smaller-of-two without a branch: every
        // prediction is held against every other.
        while end > 0 {
            let part = end.saturating_sub(Self::TOGETHER)..end;
            let start = part.start;
            let (xs, ys, radii) = (&all.0[part.clone()], &all.1[part.clone()], &all.2[part]);
            end = start;
            let (mut least, mut gap) = (f64::INFINITY, f64::INFINITY);
            for i in 0..xs.len() {
                let (x, y, reach) = (xs[i] - place.x, ys[i] - place.y, radii[i] + radius_px);
                let square = x * x + y * y;
                let beyond = square - reach * reach;
                least = if square < least { square } else { least };
                gap = if beyond < gap { beyond } else { gap };
            }
            if gap < 0.0 || least < surely_one {
                let square = |i: &usize| (xs[*i] - place.x).powi(2) + (ys[*i] - place.y).powi(2);
                let nearest = (0..xs.len()).filter(|_| least < surely_one);
                let nearest = nearest.min_by(|i, j| square(i).total_cmp(&square(j)));
                return Err(nearest.map_or(Blocked::Touching, |i| Blocked::OnePlace(start + i)));
            }
            nearest = if least < nearest { least } else { nearest };
        }
        let nearest = nearest.sqrt();
        if nearest >= self.usual_place_px { Ok(nearest) } else { Err(Blocked::Touching) }
    }
}

/// How far the prediction from the pair (a, b) may be off at `p`, relative to the error of one mark: √(1 + |1−w|² +
/// |w|²) with w the complex position of `p` along the pair.
#[inline(always)]
pub(super) fn spread_from_pair(a: MapPoint, b: MapPoint, p: MapPoint) -> f64 {
    let (ux, uy) = (b.easting - a.easting, b.northing - a.northing);
    let (vx, vy) = (p.easting - a.easting, p.northing - a.northing);
    let square = ux * ux + uy * uy;
    let (w_re, w_im) = ((vx * ux + vy * uy) / square, (vy * ux - vx * uy) / square);
    (1.0 + (1.0 - w_re).powi(2) + w_im * w_im + w_re * w_re + w_im * w_im).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn predictions_between_the_pair_are_the_surest() {
        let at = |e: f64, n: f64| MapPoint { easting: e, northing: n };
        let middle = spread_from_pair(at(0.0, 0.0), at(10.0, 0.0), at(5.0, 0.0));
        assert!((middle - 1.5f64.sqrt()).abs() < 1e-12);
        assert!(spread_from_pair(at(0.0, 0.0), at(10.0, 0.0), at(0.0, 100.0)) > 14.0);
    }
}
