//! A camera as documents have it: where it stood and looked, its interior orientation, and how well its place and
//! angles are known.

use autoref_flight::plane::PlaneMap;
use autoref_flight::pose::angle_sigmas;
use autoref_flight::world::World;
use autoref_flight::{Camera, Parameter, Pose, Projection, SizeOf};
use nalgebra::{Matrix3, SMatrix};
use serde::{Serialize, Serializer};

/// An angle with a larger deviation is not known.
const MOST_SIGMA_DEG: f64 = 60.0;

/// A camera in the map: its place in the map's units, angles in degrees.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(Default))]
pub struct CameraRecord {
    pub name: String,
    pub e: f64,
    pub n: f64,
    pub h: f64,
    pub yaw_deg: f64,
    pub pitch_deg: f64,
    pub roll_deg: f64,
    pub omega_phi_kappa_deg: [f64; 3],
    /// `None` where they cannot be stated.
    #[serde(flatten)]
    pub deviations: Option<Deviations>,
    /// The projection centre: e, n, h once more.
    #[serde(rename = "C")]
    pub centre: [f64; 3],
    /// Rows of the rotation from the map's axes to those of the camera.
    #[serde(rename = "R")]
    pub rotation: [[f64; 3]; 3],
    #[serde(flatten)]
    pub interior: InteriorOrientation,
}

/// How well a camera's pose is known: standard deviations in metres and degrees.
#[derive(Clone, Debug, Serialize)]
pub struct Deviations {
    pub sigma_e: f64,
    pub sigma_n: f64,
    pub sigma_h: f64,
    /// `None` of an angle that is not known.
    pub sigma_yaw_deg: Option<f64>,
    pub sigma_pitch_deg: Option<f64>,
    pub sigma_roll_deg: Option<f64>,
    /// Turn in radians, then place in metres.
    pub covariance: [[f64; 6]; 6],
}

/// The interior orientation, in pixels.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(Default))]
pub struct InteriorOrientation {
    pub f_px: f64,
    pub pp_px: [f64; 2],
    pub size_px: [f64; 2],
    /// Said of the size of film alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_of: Option<SizeOf>,
    pub distortion: Distortion,
}

/// What distinguishes a lens from a pinhole; nothing is written of what does not.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(Default))]
pub struct Distortion {
    #[serde(flatten, serialize_with = "by_name")]
    pub terms: Vec<(Parameter, f64)>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projection: Option<Projection>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub before: Vec<PlaneMap>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub after: Vec<PlaneMap>,
}

/// Where a camera may stand and look as well.
#[derive(Clone, Debug, Serialize)]
pub struct OtherPose {
    pub yaw_deg: f64,
    pub pitch_deg: f64,
    pub roll_deg: f64,
    /// Standard deviations of its place, metres, if it is the right one; `None` where they cannot be stated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_e: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_n: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_h: Option<f64>,
    #[serde(rename = "C")]
    pub centre: [f64; 3],
    #[serde(rename = "R")]
    pub rotation: [[f64; 3]; 3],
    pub f_px: f64,
}

/// Interior parameters under their names, in the order of the list, which has each once.
pub(super) fn by_name<S: Serializer>(values: &[(Parameter, f64)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(values.iter().map(|(parameter, value)| (parameter.name(), value)))
}

impl CameraRecord {
    /// `covariance`: turn (radians) and place (metres) in the world's frame.
    pub fn of(
        name: &str,
        camera: &Camera,
        pose: &Pose,
        covariance: Option<&SMatrix<f64, 6, 6>>,
        world: &World,
    ) -> Self {
        let map = world.pose_to_map(pose).unwrap_or(*pose);
        let grid = world.grid(map.centre.into()).unwrap_or_else(Matrix3::identity);
        let angles = map.yaw_pitch_roll();
        CameraRecord {
            name: name.into(),
            e: map.centre.x,
            n: map.centre.y,
            h: map.centre.z,
            yaw_deg: angles.yaw_deg,
            pitch_deg: angles.pitch_deg,
            roll_deg: angles.roll_deg,
            omega_phi_kappa_deg: map.omega_phi_kappa(),
            deviations: covariance.map(|c| Deviations::of(c, &map, &grid)),
            centre: map.centre.into(),
            rotation: std::array::from_fn(|r| std::array::from_fn(|k| map.rotation[(r, k)])),
            interior: InteriorOrientation::of(camera),
        }
    }
}

impl Deviations {
    /// `grid`: the axes of the map in the world's frame.
    fn of(covariance: &SMatrix<f64, 6, 6>, map: &Pose, grid: &Matrix3<f64>) -> Self {
        let place = grid.transpose() * covariance.fixed_view::<3, 3>(3, 3).into_owned() * grid;
        let [sigma_e, sigma_n, sigma_h] = [0, 1, 2].map(|i| place[(i, i)].max(0.0).sqrt());
        // One radian of turn is 57.3°: the derivatives are degrees by radians. Straight down, yaw and roll turn about
        // one axis, and neither is known alone.
        let [sigma_yaw_deg, sigma_pitch_deg, sigma_roll_deg] =
            angle_sigmas(&map.rotation, &covariance.fixed_view::<3, 3>(0, 0).into_owned())
                .map(|sigma_deg| if sigma_deg > MOST_SIGMA_DEG { None } else { Some(sigma_deg) });
        let covariance = std::array::from_fn(|r| std::array::from_fn(|k| covariance[(r, k)]));
        Deviations { sigma_e, sigma_n, sigma_h, sigma_yaw_deg, sigma_pitch_deg, sigma_roll_deg, covariance }
    }
}

impl InteriorOrientation {
    pub fn of(camera: &Camera) -> Self {
        InteriorOrientation {
            f_px: camera.f_px(),
            pp_px: camera.pp_px(),
            size_px: camera.size_px,
            size_of: (camera.size_of == SizeOf::Film).then_some(SizeOf::Film),
            distortion: Distortion::of(camera),
        }
    }
}

impl Distortion {
    fn of(camera: &Camera) -> Self {
        let terms = Parameter::ALL
            .into_iter()
            .filter(|p| !matches!(p, Parameter::F | Parameter::Cx | Parameter::Cy))
            .map(|p| (p, camera.get(p)))
            .filter(|(p, value)| *value != if *p == Parameter::Aspect { 1.0 } else { 0.0 });
        Distortion {
            terms: terms.collect(),
            projection: (camera.projection != Projection::Perspective).then_some(camera.projection),
            before: camera.before.clone(),
            after: camera.after.clone(),
        }
    }
}

impl From<CameraRecord> for OtherPose {
    fn from(camera: CameraRecord) -> Self {
        let known = camera.deviations.as_ref();
        OtherPose {
            sigma_e: known.map(|d| d.sigma_e),
            sigma_n: known.map(|d| d.sigma_n),
            sigma_h: known.map(|d| d.sigma_h),
            yaw_deg: camera.yaw_deg,
            pitch_deg: camera.pitch_deg,
            roll_deg: camera.roll_deg,
            centre: camera.centre,
            rotation: camera.rotation,
            f_px: camera.interior.f_px,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_flight::plane::Polynomial;
    use nalgebra::Vector3;

    #[test]
    fn keys_of_a_camera_come_in_their_order() {
        let mut lens = Camera::pinhole("lens", [400.0, 300.0], 500.0, [200.0, 150.0]);
        let pose = Pose { rotation: Matrix3::identity(), centre: Vector3::new(1.0, 2.0, 3.0) };
        let world = World::Flat { origin: Vector3::zeros() };
        let written = |lens: &Camera, covariance: Option<&SMatrix<f64, 6, 6>>| {
            let record = CameraRecord::of("f", lens, &pose, covariance, &world);
            serde_json::to_value(record).expect("JSON")
        };
        let keys = |value: &serde_json::Value| {
            value.as_object().map(|map| map.keys().cloned().collect::<Vec<_>>().join(" ")).unwrap_or_default()
        };
        let plain = written(&lens, None);
        assert_eq!(
            keys(&plain),
            "name e n h yaw_deg pitch_deg roll_deg omega_phi_kappa_deg C R f_px pp_px size_px distortion"
        );
        assert_eq!(plain["distortion"].to_string(), "{}");
        lens.set(Parameter::P1, 0.25).set(Parameter::K1, -0.5);
        lens.size_of = SizeOf::Film;
        lens.projection = Projection::Fisheye;
        lens.after = vec![PlaneMap::Undo(Polynomial::new([0.0, 0.0], 1000.0))];
        let known = written(&lens, Some(&SMatrix::identity()));
        assert_eq!(
            keys(&known),
            "name e n h yaw_deg pitch_deg roll_deg omega_phi_kappa_deg sigma_e sigma_n sigma_h sigma_yaw_deg \
             sigma_pitch_deg sigma_roll_deg covariance C R f_px pp_px size_px size_of distortion"
        );
        assert_eq!(keys(&known["distortion"]), "k1 p1 projection after");
        assert_eq!((&known["size_of"], &known["distortion"]["projection"]), (&"film".into(), &"fisheye".into()));
    }
}
