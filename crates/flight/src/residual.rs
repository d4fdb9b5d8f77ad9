//! How far from its pixel a camera sees a point.
//!
//! One mechanism for all that compares points with what was measured: which points count (those that the camera sees,
//! before it or behind), and that a picture of all directions goes on at its other side.

use std::f64::consts::TAU;

use crate::camera::{Camera, Parameter, Projection};
use crate::dual::Dual;

impl Camera {
    /// Predicted − measured, pixels, of a point in the camera's axes; `None` where the camera does not see it.
    pub fn residual(&self, point: [f64; 3], pixel: [f64; 2]) -> Option<[f64; 2]> {
        let place = self.place(point)?;
        let at = self.pixel_of([place[0] + self.turn(place, pixel), place[1]])?;
        Some([at[0] - pixel[0], at[1] - pixel[1]])
    }

    /// The residual and its derivatives by the point, which the camera is to see.
    pub(crate) fn residual_with_jacobian(&self, point: [f64; 3], pixel: [f64; 2]) -> ([f64; 2], [[f64; 3]; 2]) {
        let [u, v] = self.residual_with_parameters::<3>(point, pixel, &[]);
        ([u.v, v.v], [u.d, v.d])
    }

    /// The residual and its derivatives by the point and by the parameters of `which`, written behind each other.
    ///
    /// # Panics
    /// When `N` is less than three and the parameters of `which` together.
    pub(crate) fn residual_with_parameters<const N: usize>(
        &self,
        point: [f64; 3],
        pixel: [f64; 2],
        which: &[Parameter],
    ) -> [Dual<N>; 2] {
        let [x, y] = self.projection.plane(std::array::from_fn(|i| Dual::variable(point[i], i)));
        let turn = self.turn([x.v, y.v], pixel);
        let x = if turn == 0.0 { x } else { x + Dual::constant(turn) };
        let [u, v] = self.pixel_with([x, y], which);
        [u - Dual::constant(pixel[0]), v - Dual::constant(pixel[1])]
    }

    /// What to add to the longitude of a place, radians, so that its pixel is nearest to a given one: where a picture
    /// goes all the way round, a whole turn is the same direction beyond its end.
    fn turn(&self, place: [f64; 2], pixel: [f64; 2]) -> f64 {
        if self.projection != Projection::Equirectangular {
            return 0.0;
        }
        let round = -TAU.copysign(place[0]);
        let off = |turn: f64| {
            let at = self.pixel_of([place[0] + turn, place[1]]);
            at.map_or(f64::INFINITY, |at| (at[0] - pixel[0]).hypot(at[1] - pixel[1]))
        };
        if off(round) < off(0.0) { round } else { 0.0 }
    }

    /// Whether a point in the camera's axes lies where a ray goes, and not where it comes from: before a camera that
    /// sees no more, else on the ray's side.
    pub(crate) fn is_along(&self, point: [f64; 3], ray: [f64; 3]) -> bool {
        if self.projection.sees_behind() {
            (0..3).map(|i| point[i] * ray[i]).sum::<f64>() > 0.0
        } else {
            point[2] > 0.0
        }
    }

    /// Whether a point in the camera's axes lies where a pixel looks, and not on the other side of the camera.
    pub(crate) fn faces(&self, point: [f64; 3], pixel: [f64; 2]) -> bool {
        let ray = if self.projection.sees_behind() { self.ray(pixel) } else { None };
        self.is_along(point, ray.unwrap_or([0.0, 0.0, 1.0]))
    }

    /// The most pixels that a metre at a point in the camera's axes takes up, along the image's sides or about its
    /// centre; the lens's terms left aside.
    pub(crate) fn most_px_per_m(&self, point: [f64; 3]) -> f64 {
        let [x, y, z] = point;
        let across = match self.projection {
            Projection::Perspective => z.abs(),
            // Circles of latitude are all as wide as the picture.
            Projection::Equirectangular => x.hypot(z),
            _ => {
                let away = x.hypot(y).hypot(z);
                away * self.across(point.map(|v| v / away))
            }
        };
        self.f_px() / across.max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// 3 px a degree all round.
    fn sphere() -> Camera {
        let camera = Camera::pinhole("s", [1080.0, 540.0], 540.0 / PI, [540.0, 270.0]);
        Camera { projection: Projection::Equirectangular, ..camera }
    }

    fn at(longitude_deg: f64, latitude_deg: f64) -> [f64; 3] {
        let ((x, z), (y, level)) = (longitude_deg.to_radians().sin_cos(), latitude_deg.to_radians().sin_cos());
        [level * x, y, level * z]
    }

    #[test]
    fn residuals_go_the_shorter_way_round() {
        let camera = sphere();
        let near = |[x, y]: [f64; 2], to: [f64; 2]| (x - to[0]).hypot(y - to[1]) < 1e-9;
        for (longitude, pixel, off) in [
            (179.0, [3.0, 240.0], [-6.0, 0.0]),
            (-179.0, [1077.0, 246.0], [6.0, -6.0]),
            (179.0, [1074.0, 240.0], [3.0, 0.0]),
            (-10.0, [520.0, 240.0], [-10.0, 0.0]),
            (100.0, [540.0, 240.0], [300.0, 0.0]),
        ] {
            let found = camera.residual(at(longitude, -10.0), pixel).expect("all is seen");
            assert!(near(found, off), "{longitude}: {found:?}");
            let dual = camera.residual_with_parameters::<4>(at(longitude, -10.0), pixel, &[Parameter::F]);
            assert!(near(dual.map(|v| v.v), off), "{longitude}: {dual:?}");
            // A wider picture closes farther off: the turn is part of the slope.
            let wider = camera.clone().with(Parameter::F, camera.f_px() + 1e-4);
            let slope = (wider.residual(at(longitude, -10.0), pixel).expect("seen")[0] - found[0]) / 1e-4;
            assert!((dual[0].d[3] - slope).abs() < 1e-6, "{longitude}: {slope} {dual:?}");
        }
        let behind = [0.0, 0.0, -1.0];
        assert!(near(camera.residual(behind, [1.0, 270.0]).expect("seen"), [-1.0, 0.0]));
        // Another camera has ends.
        let fisheye = Camera { projection: Projection::Fisheye, ..camera };
        assert!(fisheye.residual(at(179.0, 0.0), [3.0, 270.0]).expect("seen")[0] > 1000.0);
        // A circle is no place, and a pole has no slope that is no number.
        assert_eq!(fisheye.residual(behind, [3.0, 270.0]), None);
        let pole = sphere().residual_with_jacobian([0.0, 2.0, 0.0], [500.0, 530.0]);
        assert!((pole.0[1] - 10.0).abs() < 1e-9 && pole.1.iter().flatten().all(|v| v.is_finite()), "{pole:?}");
    }

    #[test]
    fn points_count_on_the_side_that_their_pixel_looks_to() {
        let camera = sphere();
        let pixel = camera.project(at(150.0, 20.0)).expect("seen");
        for (longitude, faces) in [(150.0, true), (-160.0, true), (-30.0, false), (0.0, false)] {
            assert_eq!(camera.faces(at(longitude, 20.0), pixel), faces, "{longitude}");
        }
        // A picture whose middle lies aside goes on at its other end.
        let aside = camera.with(Parameter::Cx, 500.0);
        let ray = aside.ray([1060.0, 270.0]).expect("all round");
        assert!((ray[0] - at(560.0 / 3.0, 0.0)[0]).abs() < 1e-9, "{ray:?}");
        let perspective = Camera { projection: Projection::Perspective, ..sphere() };
        assert!(perspective.faces(at(80.0, 0.0), [0.0, 270.0]) && !perspective.faces(at(100.0, 0.0), [1080.0, 270.0]));
    }

    #[test]
    fn a_metre_takes_as_many_pixels_as_the_camera_shows() {
        for projection in Projection::ALL {
            let camera = Camera { projection, ..sphere() };
            for off_deg in [5.0, 40.0, 80.0, 120.0, 170.0] {
                let point = at(off_deg, 0.0).map(|v| 20.0 * v);
                if !camera.sees(point) {
                    continue;
                }
                let from = camera.project(point).expect("seen");
                let [x, y, z] = point;
                let to = camera.residual([x, y + 1e-4, z], from).expect("seen");
                let px = to[0].hypot(to[1]) / 1e-4;
                let told = camera.most_px_per_m(point);
                assert!((told / px - 1.0).abs() < 1e-4, "{projection:?} {off_deg}: {told} {px}");
            }
        }
    }
}
