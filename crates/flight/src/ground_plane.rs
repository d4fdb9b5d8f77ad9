//! Frames of one camera over a level plane of ground: pixels of one from pixels of another.

use nalgebra::{Matrix3, Vector3};

use crate::pose::Pose;

/// The interior of all frames: focal length and principal point in pixels.
#[derive(Clone, Copy)]
pub struct Interior {
    /// Focal length.
    pub f_px: f64,
    /// Principal point, x to the right and y down from the outer corner of the first pixel.
    pub pp_px: [f64; 2],
}

/// Pixels of `to` from pixels of `from`, over the plane of height `ground_m`. The third coordinate is positive where
/// both see it.
pub fn homography(from: &Pose, to: &Pose, inside: Interior, ground_m: f64) -> Option<Matrix3<f64>> {
    let k = Matrix3::new(inside.f_px, 0.0, inside.pp_px[0], 0.0, inside.f_px, inside.pp_px[1], 0.0, 0.0, 1.0);
    let on_plane = |pose: &Pose| {
        // From (x, y, 1) on the plane, x and y from the first camera's foot.
        let mut m = Matrix3::identity();
        let foot = Vector3::new(from.centre.x, from.centre.y, ground_m);
        m.set_column(2, &(foot - pose.centre));
        k * pose.rotation * m
    };
    Some(on_plane(to) * on_plane(from).try_inverse()?)
}

/// Where a map takes a pixel; `None` where it is not in front of both cameras.
pub fn mapped(h: &Matrix3<f64>, pixel: [f64; 2]) -> Option<[f64; 2]> {
    let q = h * Vector3::new(pixel[0], pixel[1], 1.0);
    (q.z > 1e-9).then(|| [q.x / q.z, q.y / q.z])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::YawPitchRoll;

    #[test]
    fn a_point_of_the_plane_maps_from_frame_to_frame() {
        let look = |x: f64, yaw_deg: f64| {
            Pose::looking(Vector3::new(x, 100.0, 3000.0), YawPitchRoll { yaw_deg, pitch_deg: -20.0, roll_deg: 1.0 })
        };
        let (a, b) = (look(0.0, 3.0), look(1800.0, -2.0));
        let inside = Interior { f_px: 2100.0, pp_px: [900.0, 890.0] };
        let h = homography(&a, &b, inside, 120.0).expect("both see the plane");
        let seen = |pose: &Pose, x: &Vector3<f64>| {
            let p = pose.to_camera(x);
            [0, 1].map(|i| inside.f_px * p[i] / p.z + inside.pp_px[i])
        };
        for ground in [Vector3::new(500.0, 7000.0, 120.0), Vector3::new(2500.0, 12_000.0, 120.0)] {
            let at = mapped(&h, seen(&a, &ground)).expect("in front of both");
            let want = seen(&b, &ground);
            assert!((at[0] - want[0]).hypot(at[1] - want[1]) < 1e-6, "{at:?} {want:?}");
        }
    }
}
