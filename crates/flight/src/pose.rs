//! Where a camera stood and where it looked.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// A pose: p = R (X − C) takes a point of the world into the camera's axes (x right, y down, z forward).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// World → camera.
    pub rotation: Matrix3<f64>,
    pub centre: Vector3<f64>,
}

/// Yaw, pitch and roll in degrees: the azimuth of the view clockwise from north (the world's y), its elevation above
/// the horizon (−20 looks 20° down), and the turn about the view (positive: the image's right side hangs down).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct YawPitchRoll {
    pub yaw_deg: f64,
    pub pitch_deg: f64,
    pub roll_deg: f64,
}

/// The rotation vector δ, radians, with `rotation` = exp(δ) `from`. By way of a quaternion: of a matrix that rounding
/// has made a hair larger than the identity there is no angle.
pub fn turn(rotation: &Matrix3<f64>, from: &Matrix3<f64>) -> Vector3<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation * from.transpose())).scaled_axis()
}

impl Pose {
    /// A point of the world in the camera's axes: x right, y down, z forward.
    #[inline]
    pub fn to_camera(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let (r, by) = (&self.rotation, point - self.centre);
        // Spelled out: called for every point of every step.
        Vector3::from_fn(|i, _| r[(i, 0)] * by.x + r[(i, 1)] * by.y + r[(i, 2)] * by.z)
    }

    /// A camera at `centre` that looks as the angles say; the world is east, north, up.
    pub fn looking(centre: Vector3<f64>, angles: YawPitchRoll) -> Self {
        let (sy, cy) = angles.yaw_deg.to_radians().sin_cos();
        let (sp, cp) = angles.pitch_deg.to_radians().sin_cos();
        let (sr, cr) = angles.roll_deg.to_radians().sin_cos();
        let forward = Vector3::new(sy * cp, cy * cp, sp);
        let right = Vector3::new(cy, -sy, 0.0);
        let down = forward.cross(&right);
        // The camera turns clockwise as seen from behind: its right side goes down.
        let (x, y) = (right * cr + down * sr, down * cr - right * sr);
        Pose { rotation: Matrix3::from_rows(&[x.transpose(), y.transpose(), forward.transpose()]), centre }
    }

    /// The angles of [`Pose::looking`]. Straight down or up, the yaw is that of the image's top (bottom) and the roll
    /// is 0.
    pub fn yaw_pitch_roll(&self) -> YawPitchRoll {
        angles(&self.rotation)
    }

    /// ω, φ, κ in degrees: R = diag(1, −1, −1) · R_z(κ)ᵀ R_y(φ)ᵀ R_x(ω)ᵀ as photogrammetry writes it (camera x right, y
    /// up, z backward; Kraus, *Photogrammetry* I, 2007).
    pub fn omega_phi_kappa(&self) -> [f64; 3] {
        // Camera axes → world, in the photogrammetric camera.
        let m = (Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)) * self.rotation).transpose();
        let phi = m[(0, 2)].clamp(-1.0, 1.0).asin();
        let omega = (-m[(1, 2)]).atan2(m[(2, 2)]);
        let kappa = (-m[(0, 1)]).atan2(m[(0, 0)]);
        [omega.to_degrees(), phi.to_degrees(), kappa.to_degrees()]
    }

    /// The direction of a camera that is mounted under an aircraft, looks straight down when the aircraft flies level
    /// and has its image's top towards the nose: yaw clockwise from north, pitch with the nose up, roll with the right
    /// wing down, degrees (ARINC 705; M. Bäumker and F.-J. Heimes, *New calibration and computing method for direct
    /// georeferencing of image and scanner data using the position and angular data of an hybrid inertial navigation
    /// system*, 2001). Metashape, Pix4D, OpenSfM and orthority count so.
    pub fn under_aircraft(centre: Vector3<f64>, angles: YawPitchRoll) -> Self {
        let turn = |axis: Vector3<f64>, degrees: f64| *Rotation3::new(axis * degrees.to_radians()).matrix();
        // Aircraft (nose, right wing, down) to north, east, down.
        let to_ned = turn(Vector3::z(), angles.yaw_deg)
            * turn(Vector3::y(), angles.pitch_deg)
            * turn(Vector3::x(), angles.roll_deg);
        let to_enu = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0) * to_ned;
        // The camera's right is the right wing, its down the tail, its view down.
        let axes = to_enu * Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        Pose { rotation: axes.transpose(), centre }
    }

    /// From ω, φ, κ in degrees; see [`Pose::omega_phi_kappa`].
    pub fn from_omega_phi_kappa(centre: Vector3<f64>, degrees: [f64; 3]) -> Self {
        let [o, p, k] = degrees.map(f64::to_radians);
        let axis = |v: Vector3<f64>, a: f64| *Rotation3::new(v * a).matrix();
        let m = axis(Vector3::x(), o) * axis(Vector3::y(), p) * axis(Vector3::z(), k);
        Pose { rotation: Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)) * m.transpose(), centre }
    }

    /// The pose in a world that was moved by X′ = s Q X + t.
    pub fn moved(&self, by: &Similarity) -> Self {
        Pose { rotation: self.rotation * by.rotation.transpose(), centre: by.apply(&self.centre) }
    }
}

fn angles(r: &Matrix3<f64>) -> YawPitchRoll {
    let (right, forward) = (r.row(0), r.row(2));
    let pitch = forward[2].clamp(-1.0, 1.0).asin();
    let level = forward[0].hypot(forward[1]);
    if level < 1e-9 {
        // The image's top is −row 1.
        let up = -r.row(1) * if forward[2] < 0.0 { 1.0 } else { -1.0 };
        return YawPitchRoll {
            yaw_deg: up[0].atan2(up[1]).to_degrees().rem_euclid(360.0),
            pitch_deg: pitch.to_degrees(),
            roll_deg: 0.0,
        };
    }
    let level_right = Vector3::new(forward[1] / level, -forward[0] / level, 0.0);
    let f = Vector3::new(forward[0], forward[1], forward[2]);
    let x = Vector3::new(right[0], right[1], right[2]);
    YawPitchRoll {
        yaw_deg: forward[0].atan2(forward[1]).to_degrees().rem_euclid(360.0),
        pitch_deg: pitch.to_degrees(),
        roll_deg: x.dot(&f.cross(&level_right)).atan2(x.dot(&level_right)).to_degrees(),
    }
}

/// Standard deviations of yaw, pitch, roll (degrees) from the covariance of a small turn of the camera, radians²:
/// R ← exp(δ) R.
pub fn angle_sigmas(rotation: &Matrix3<f64>, turn: &Matrix3<f64>) -> [f64; 3] {
    let step = 1e-6;
    let base = angles(rotation);
    let mut j = Matrix3::zeros();
    for i in 0..3 {
        let mut delta = Vector3::zeros();
        delta[i] = step;
        let a = angles(&(Rotation3::new(delta).matrix() * rotation));
        let wrap = |d: f64| (d + 180.0).rem_euclid(360.0) - 180.0;
        j[(0, i)] = wrap(a.yaw_deg - base.yaw_deg) / step;
        j[(1, i)] = (a.pitch_deg - base.pitch_deg) / step;
        j[(2, i)] = wrap(a.roll_deg - base.roll_deg) / step;
    }
    let c = j * turn * j.transpose();
    [c[(0, 0)].max(0.0).sqrt(), c[(1, 1)].max(0.0).sqrt(), c[(2, 2)].max(0.0).sqrt()]
}

/// X′ = s Q X + t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    pub scale: f64,
    pub rotation: Matrix3<f64>,
    pub shift: Vector3<f64>,
}

impl Similarity {
    /// The one that moves nothing.
    pub fn identity() -> Self {
        Similarity { scale: 1.0, rotation: Matrix3::identity(), shift: Vector3::zeros() }
    }
    /// Where it takes a point.
    pub fn apply(&self, x: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * x * self.scale + self.shift
    }

    /// The least-squares similarity from `from` to `to` with weights (Umeyama 1991, eq. 34–43); `None` when the points
    /// are fewer than three or lie on a line.
    pub fn fit(from: &[Vector3<f64>], to: &[Vector3<f64>], weights: &[f64]) -> Option<Self> {
        let sum: f64 = weights.iter().sum();
        if from.len() < 3 || !sum.is_finite() || sum <= 0.0 {
            return None;
        }
        let mean =
            |p: &[Vector3<f64>]| p.iter().zip(weights).map(|(p, w)| p * *w).fold(Vector3::zeros(), |a, b| a + b) / sum;
        let (mf, mt) = (mean(from), mean(to));
        let mut cross = Matrix3::zeros();
        let mut spread = 0.0;
        for ((f, t), w) in from.iter().zip(to).zip(weights) {
            cross += (t - mt) * (f - mf).transpose() * *w;
            spread += w * (f - mf).norm_squared();
        }
        let svd = cross.svd(true, true);
        let (u, v) = (svd.u?, svd.v_t?);
        let s = svd.singular_values;
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| s[*b].total_cmp(&s[*a]));
        if !s[order[0]].is_finite() || s[order[1]] <= 1e-9 * s[order[0]] || spread <= 0.0 {
            return None;
        }
        let mut d = Vector3::new(1.0, 1.0, 1.0);
        if (u.determinant() * v.determinant()) < 0.0 {
            d[order[2]] = -1.0;
        }
        let rotation = u * Matrix3::from_diagonal(&d) * v;
        let scale = s.dot(&d) / spread;
        (scale > 0.0).then(|| Similarity { scale, rotation, shift: mt - rotation * mf * scale })
    }
}

/// The rotation nearest to a matrix that is one but for rounding.
pub fn orthonormal(m: &Matrix3<f64>) -> Matrix3<f64> {
    let svd = m.svd(true, true);
    match (svd.u, svd.v_t) {
        (Some(u), Some(v)) => {
            let r = u * v;
            if r.determinant() < 0.0 { u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0)) * v } else { r }
        }
        _ => *m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_there_and_back() {
        for (yaw_deg, pitch_deg, roll_deg) in [(12.0, -20.0, 3.0), (350.0, -89.0, -170.0), (180.0, 45.0, 90.0)] {
            let a = YawPitchRoll { yaw_deg, pitch_deg, roll_deg };
            let b = Pose::looking(Vector3::zeros(), a).yaw_pitch_roll();
            assert!((a.yaw_deg - b.yaw_deg).abs() + (a.pitch_deg - b.pitch_deg).abs() < 1e-9, "{a:?} {b:?}");
            assert!((a.roll_deg - b.roll_deg).abs() < 1e-9);
        }
    }

    #[test]
    fn under_an_aircraft_the_view_is_down() {
        let of = |yaw_deg, pitch_deg, roll_deg| {
            Pose::under_aircraft(Vector3::zeros(), YawPitchRoll { yaw_deg, pitch_deg, roll_deg })
        };
        let level = of(30.0, 0.0, 0.0).yaw_pitch_roll();
        assert!((level.yaw_deg - 30.0).abs() < 1e-9 && (level.pitch_deg + 90.0).abs() < 1e-5, "{level:?}");
        // The nose up: the view swings forward.
        let up = of(30.0, 60.0, 0.0).yaw_pitch_roll();
        assert!((up.yaw_deg - 30.0).abs() < 1e-9 && (up.pitch_deg + 30.0).abs() < 1e-9 && up.roll_deg.abs() < 1e-9);
        // The right wing down: the view swings to the left.
        let banked = of(0.0, 0.0, 20.0);
        let view = banked.rotation.row(2);
        assert!(view[0] < -0.3 && view[1].abs() < 1e-12 && view[2] < -0.9, "{view:?}");
        // The two rows of a flight that its adjustment has in ω, φ, κ too, a few degrees from its stated angles.
        for ((yaw, pitch), opk) in
            [((92.9, 30.0), [-2.728, -30.083, -93.729]), ((-175.8, 30.0), [-30.071, 1.882, 175.984])]
        {
            let adjusted = Pose::from_omega_phi_kappa(Vector3::zeros(), opk).rotation;
            let turn = Rotation3::from_matrix(&(of(yaw, pitch, 0.0).rotation * adjusted.transpose())).angle();
            assert!(turn.to_degrees() < 3.0, "{}", turn.to_degrees());
        }
    }

    #[test]
    fn a_level_camera_that_looks_north() {
        let pose = Pose::looking(Vector3::zeros(), YawPitchRoll { yaw_deg: 0.0, pitch_deg: 0.0, roll_deg: 0.0 });
        assert!((pose.rotation * Vector3::new(1.0, 0.0, 0.0) - Vector3::x()).norm() < 1e-12, "east is right");
        assert!((pose.rotation * Vector3::new(0.0, 0.0, 1.0) + Vector3::y()).norm() < 1e-12, "up is −y");
        let rolled = Pose::looking(Vector3::zeros(), YawPitchRoll { yaw_deg: 0.0, pitch_deg: 0.0, roll_deg: 10.0 });
        assert!(rolled.rotation.row(0)[2] < 0.0, "a positive roll lowers the right side");
    }

    #[test]
    fn omega_phi_kappa_there_and_back() {
        for degrees in [[28.831, 0.94, 1.782], [-2.728, -30.083, -93.729], [-0.349, 0.298, -179.087]] {
            let back = Pose::from_omega_phi_kappa(Vector3::zeros(), degrees).omega_phi_kappa();
            assert!(degrees.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-9), "{back:?}");
        }
        // ω = φ = κ = 0 looks straight down, north up.
        let down = Pose::from_omega_phi_kappa(Vector3::zeros(), [0.0; 3]);
        assert!((down.yaw_pitch_roll().pitch_deg + 90.0).abs() < 1e-9 && down.yaw_pitch_roll().yaw_deg.abs() < 1e-9);
    }
}
