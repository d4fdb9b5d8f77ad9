//! How far off its axis a camera maps one to one: beyond the fold of a radial polynomial, far points would come back
//! into the image.

use crate::camera::{Camera, Parameter};

/// What of the plane of its projection a camera shows, in radii there, f as unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Nothing folds within.
    smooth: f64,
    /// Nothing is shown beyond.
    most: f64,
    /// The sign of areas of the image against those of the plane, where nothing is folded.
    sense: f64,
}

/// Beyond the image's corners.
const MORE: f64 = 1.05;
/// The first fold may lie as much nearer between the directions that were tried.
const LESS: f64 = 0.98;
/// Directions from the principal point for lenses that differ by direction.
const DIRECTIONS: usize = 32;
/// Steps along a direction, of equal angles off the axis of a perspective, up to the widest.
const STEPS: usize = 400;
const WIDEST_DEG: f64 = 89.8;

/// What lies along a direction.
struct Along {
    /// The first fold.
    fold: Option<f64>,
    /// The last place before it that lies in the image; 0 without one.
    edge: f64,
}

impl Camera {
    /// How far the image's mapping is one to one: out to its corners, or to the fold where that comes first.
    pub fn reach(&self) -> Reach {
        let (pp, scale) = (self.pp_px(), [self.f_px(), self.f_px() * self.get(Parameter::Aspect)]);
        let corners = [[0.0, 0.0], [self.size_px[0], 0.0], [0.0, self.size_px[1]], self.size_px];
        let sense = self.area_of([0.0; 2]).signum();
        let all = Reach { smooth: f64::INFINITY, most: f64::INFINITY, sense };
        let bends = !self.is_plain();
        // A ray that was found beyond a fold is none.
        let place = |corner: [f64; 2]| self.ray(corner).and_then(|ray| self.place(ray));
        let is_before_fold =
            |at: &[f64; 2]| !bends || self.along(direction(*at), at[0].hypot(at[1]), &all).fold.is_none();
        let places = corners.map(|corner| place(corner).filter(is_before_fold));
        let mut edge = places.iter().flatten().map(|at| at[0].hypot(at[1])).fold(0.0, f64::max);
        let of_corners = corners.map(|c| direction([(c[0] - pp[0]) / scale[0], (c[1] - pp[1]) / scale[1]]));
        let around = (0..if self.is_radial() { 0 } else { DIRECTIONS }).map(|k| {
            let (y, x) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
            [x, y]
        });
        let directions: Vec<[f64; 2]> = of_corners.into_iter().chain(around).collect();
        if places.iter().any(Option::is_none) {
            edge = directions.iter().map(|d| self.along(*d, f64::INFINITY, &all).edge).fold(edge, f64::max);
        }
        let most = edge * MORE;
        let folds = directions.iter().filter(|_| bends).filter_map(|d| self.along(*d, most, &all).fold);
        Reach { smooth: folds.fold(f64::INFINITY, f64::min) * LESS, most, sense }
    }

    /// Whether a point in the camera's axes lies where the mapping is one to one.
    pub fn reaches(&self, point: [f64; 3], reach: &Reach) -> bool {
        self.place(point).is_some_and(|place| self.is_within(place, reach))
    }

    /// Pixel of a point in the camera's axes that the image shows, its edges included.
    pub fn shows(&self, point: [f64; 3], reach: &Reach) -> Option<[f64; 2]> {
        let place = self.place(point).filter(|place| self.is_within(*place, reach))?;
        self.pixel_of(place).filter(|pixel| self.contains(*pixel))
    }

    fn is_within(&self, place: [f64; 2], reach: &Reach) -> bool {
        let radius = place[0].hypot(place[1]);
        radius <= reach.most && (radius <= reach.smooth || !self.is_folded(place, reach))
    }

    /// What is no number is folded too.
    fn is_folded(&self, place: [f64; 2], reach: &Reach) -> bool {
        let area = self.area_of(place) * reach.sense;
        area.is_nan() || area <= 0.0
    }

    /// Whether the lens does the same in all directions.
    fn is_radial(&self) -> bool {
        use Parameter::*;
        !self.has_plane_maps() && [P1, P2, B1, B2, Dx, Dy].iter().all(|p| self.get(*p) == 0.0)
    }

    /// What lies along a direction of the plane, as far as `to`.
    fn along(&self, direction: [f64; 2], to: f64, reach: &Reach) -> Along {
        let place = |radius: f64| direction.map(|d| d * radius);
        let ends = |radius: f64| self.projection.direction(place(radius)).is_none();
        let is_folded = |radius: f64| self.is_folded(place(radius), reach);
        let shows = |radius: f64| {
            let pixel = self.pixel_of(place(radius)).filter(|pixel| self.contains(*pixel));
            pixel.is_some() && !ends(radius) && !is_folded(radius)
        };
        let mut found = Along { fold: None, edge: 0.0 };
        let (mut before, mut was_shown) = (0.0, shows(0.0));
        for k in 1..=STEPS {
            let radius = (WIDEST_DEG.to_radians() * k as f64 / STEPS as f64).tan().min(to);
            let is_shown = shows(radius);
            if is_shown {
                found.edge = radius;
            } else if was_shown {
                found.edge = last(before, radius, shows);
            }
            if !ends(radius) && is_folded(radius) {
                found.fold = Some(last(before, radius, |r| !is_folded(r)));
                break;
            }
            if radius >= to || ends(radius) {
                break;
            }
            (before, was_shown) = (radius, is_shown);
        }
        found
    }
}

/// A unit vector; to the right where there is none.
fn direction([x, y]: [f64; 2]) -> [f64; 2] {
    let length = x.hypot(y);
    if length > 0.0 { [x / length, y / length] } else { [1.0, 0.0] }
}

/// The last number between two at which something holds that holds at the first alone.
fn last(mut low: f64, mut high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..40 {
        let middle = (low + high) / 2.0;
        if holds(middle) { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Projection;
    use crate::plane::{PlaneMap, Polynomial};

    fn radial(f_px: f64, k1: f64) -> Camera {
        Camera::pinhole("c", [400.0, 300.0], f_px, [200.0, 150.0]).with(Parameter::K1, k1)
    }

    /// The radius to which every place is shown, of those in the image before it folds, along a direction.
    fn shown(camera: &Camera, [x, y]: [f64; 2]) -> (f64, usize) {
        let reach = camera.reach();
        let radii = (0..6000).map(|k| f64::from(k) * 1e-3);
        let shown: Vec<f64> = radii.filter(|r| camera.shows([x * r, y * r, 1.0], &reach).is_some()).collect();
        (shown.last().copied().unwrap_or(0.0), shown.len())
    }

    #[test]
    fn a_lens_reaches_to_its_fold_and_no_farther() {
        // r − 0.3 r³ turns at r = √(1/0.9) = 1.054, of 0.703: 244 px of 250 to a corner with f = 347, 141 px with 200.
        for f_px in [347.0, 200.0] {
            let (far, count) = shown(&radial(f_px, -0.3), [0.8, 0.6]);
            assert!((far - 1.054).abs() < 2e-3 && count == 1055, "{f_px}: {far} {count}");
        }
        // Not to the side, where the image ends before the fold; nothing comes back from beyond it.
        let (far, count) = shown(&radial(347.0, -0.3), [0.0, 1.0]);
        assert!((far - 0.462).abs() < 2e-3 && count == 462, "{far} {count}");
        // Corners that have a ray: no farther than the image.
        let (far, count) = shown(&radial(347.0, -0.1), [0.8, 0.6]);
        assert!((0.72..0.78).contains(&far) && count as f64 > 1000.0 * far - 1.0, "{far} {count}");
    }

    #[test]
    fn a_fold_that_differs_by_direction_is_followed() {
        // The same lens, its centre of distortion 0.1 to the right.
        let camera = radial(200.0, -0.3).with(Parameter::Dx, 0.1);
        for (sign, fold) in [(1.0, 1.154), (-1.0, 0.954)] {
            let (far, count) = shown(&camera, [sign, 0.0]);
            assert!((far - fold).abs() < 2e-3 && count as f64 > 1000.0 * fold - 1.0, "{sign}: {far} {count}");
        }
        // A scan that lies mirrored is not folded.
        let mut mirrored = Polynomial::new([200.0, 150.0], 1.0);
        mirrored.add([1, 0], [-2.0, 0.0]);
        let mut camera = radial(347.0, -0.3);
        camera.after = vec![PlaneMap::Polynomial(mirrored)];
        let (far, count) = shown(&camera, [0.8, 0.6]);
        assert!((far - 1.054).abs() < 2e-3 && count == 1055, "{far} {count}");
    }

    #[test]
    fn wide_lenses_show_what_lies_behind() {
        let camera = |projection| Camera { projection, ..Camera::pinhole("c", [400.0; 2], 114.6, [200.0; 2]) };
        let at = |camera: &Camera, off_deg: f64| {
            let (s, c) = off_deg.to_radians().sin_cos();
            camera.shows([s, 0.0, c], &camera.reach())
        };
        let fisheye = camera(Projection::Fisheye);
        assert!(at(&fisheye, 99.0).is_some() && at(&fisheye, 101.0).is_none() && at(&fisheye, -99.0).is_some());
        let sphere = Camera {
            projection: Projection::Equirectangular,
            ..Camera::pinhole("c", [720.0, 360.0], 114.591_559, [360.0, 180.0])
        };
        assert!([-179.0, -91.0, 0.0, 91.0, 179.0].iter().all(|off| at(&sphere, *off).is_some()));
        for projection in [Projection::Perspective, Projection::Orthographic] {
            assert!(at(&camera(projection), 91.0).is_none() && at(&camera(projection), 179.0).is_none());
        }
    }
}
