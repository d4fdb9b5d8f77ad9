//! From map coordinates to a Cartesian frame and back.
//!
//! A CRS that is `local` is metric and flat. On the Earth the adjustment works in the tangent frame of the project's
//! centre (east, north, up on WGS84's ellipsoid), so that curvature and the map's scale are right. Heights are taken as
//! if above the ellipsoid: a geoid that tilts within the project shows in the residuals.
//!
//! Coordinates of the map are in its units, easting and northing in one and heights in another; the world is in metres.
//! [`Geodesy`] is the one place where the one becomes the other.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::pose::{Pose, orthonormal};

/// Map (in its units) ↔ longitude, latitude (degrees), height (metres).
pub trait Geodesy {
    fn to_geographic(&self, map: [f64; 3]) -> Option<[f64; 3]>;
    fn map_of_geographic(&self, lon_lat_h: [f64; 3]) -> Option<[f64; 3]>;
    /// Metres in a unit of easting and northing, and in one of the heights.
    fn units_m(&self) -> [f64; 2] {
        [1.0; 2]
    }
}

const A: f64 = 6_378_137.0;
const F: f64 = 1.0 / 298.257_223_563;

/// Longitude and latitude (degrees) and height to geocentric metres (WGS84).
pub fn geocentric(lon_lat_h: [f64; 3]) -> Vector3<f64> {
    let e2 = F * (2.0 - F);
    let (sl, cl) = lon_lat_h[0].to_radians().sin_cos();
    let (sp, cp) = lon_lat_h[1].to_radians().sin_cos();
    let n = A / (1.0 - e2 * sp * sp).sqrt();
    Vector3::new((n + lon_lat_h[2]) * cp * cl, (n + lon_lat_h[2]) * cp * sl, (n * (1.0 - e2) + lon_lat_h[2]) * sp)
}

/// Inverse of [`geocentric`], by iteration (to 1e-12 rad within a few steps at heights of aircraft).
pub fn geographic(x: &Vector3<f64>) -> [f64; 3] {
    let e2 = F * (2.0 - F);
    let p = x.x.hypot(x.y);
    let mut latitude = x.z.atan2(p * (1.0 - e2));
    let mut height = 0.0;
    for _ in 0..12 {
        let (s, c) = latitude.sin_cos();
        let n = A / (1.0 - e2 * s * s).sqrt();
        height = p * c + x.z * s - A * A / n;
        latitude = x.z.atan2(p * (1.0 - e2 * n / (n + height)));
    }
    [x.y.atan2(x.x).to_degrees(), latitude.to_degrees(), height]
}

/// A frame tangent to the ellipsoid.
pub struct Tangent {
    geodesy: Box<dyn Geodesy>,
    origin: Vector3<f64>,
    /// Geocentric → east, north, up.
    axes: Matrix3<f64>,
    pub lon_lat_h: [f64; 3],
}

/// The frame that the adjustment works in.
pub enum World {
    Flat { origin: Vector3<f64> },
    Curved(Tangent),
}

/// Units of the map over which its axes and its scale are taken.
const STEP: f64 = 10.0;

/// East, north, up at a place, as rows.
pub fn tangent_axes(lon_deg: f64, lat_deg: f64) -> Matrix3<f64> {
    let (sl, cl) = lon_deg.to_radians().sin_cos();
    let (sp, cp) = lat_deg.to_radians().sin_cos();
    Matrix3::new(-sl, cl, 0.0, -sp * cl, -sp * sl, cp, cp * cl, cp * sl, sp)
}

impl World {
    /// Flat, with an origin near the points so that numbers stay small.
    pub fn flat(centre: [f64; 3]) -> Self {
        World::Flat { origin: Vector3::new(centre[0].round(), centre[1].round(), 0.0) }
    }
    /// Tangent at a place of the map; `None` when it has no longitude and latitude.
    pub fn curved(geodesy: Box<dyn Geodesy>, centre: [f64; 3]) -> Option<Self> {
        let [lon, lat, _] = geodesy.to_geographic([centre[0], centre[1], 0.0])?;
        let at = [lon, lat, 0.0];
        Some(World::Curved(Tangent { geodesy, origin: geocentric(at), axes: tangent_axes(lon, lat), lon_lat_h: at }))
    }
    /// Map → world; `None` where the map has no place on the Earth.
    pub fn to_world(&self, map: [f64; 3]) -> Option<Vector3<f64>> {
        match self {
            World::Flat { origin } => Some(Vector3::from(map) - origin),
            World::Curved(t) => Some(t.axes * (geocentric(t.geodesy.to_geographic(map)?) - t.origin)),
        }
    }
    /// World → map; `None` where the map does not reach.
    pub fn to_map(&self, world: &Vector3<f64>) -> Option<[f64; 3]> {
        match self {
            World::Flat { origin } => Some((world + origin).into()),
            World::Curved(t) => t.geodesy.map_of_geographic(geographic(&(t.axes.transpose() * world + t.origin))),
        }
    }
    /// Metres in a unit of the map's easting and northing, and in one of its heights.
    pub fn units_m(&self) -> [f64; 2] {
        match self {
            World::Flat { .. } => [1.0; 2],
            World::Curved(t) => t.geodesy.units_m(),
        }
    }
    /// A difference of two places of the map in metres of the map.
    pub fn metres_of(&self, difference: [f64; 3]) -> [f64; 3] {
        let [plan_m, height_m] = self.units_m();
        let [e, n, h] = difference;
        [e * plan_m, n * plan_m, h * height_m]
    }
    /// A difference of two places of the map in metres on the ground, along the axes of the map at one of them.
    pub fn ground_metres_of(&self, map: [f64; 3], difference: [f64; 3]) -> [f64; 3] {
        let [e, n, h] = self.metres_of(difference);
        let plan = Vector2::new(e, n);
        let plan = self.map_scale(map).and_then(|scale| scale.try_inverse()).map_or(plan, |ground| ground * plan);
        [plan.x, plan.y, h]
    }
    /// The map's axes (grid east, grid north, up) at a place, as columns in the world.
    pub fn grid(&self, map: [f64; 3]) -> Option<Matrix3<f64>> {
        if let World::Flat { .. } = self {
            return Some(Matrix3::identity());
        }
        let mut axes = self.steps(map)?;
        axes.column_iter_mut().for_each(|mut axis| axis /= axis.norm());
        Some(orthonormal(&axes))
    }
    /// What steps of [`STEP`] units along the map's axes are in the world, as columns.
    fn steps(&self, map: [f64; 3]) -> Option<Matrix3<f64>> {
        let at = self.to_world(map)?;
        let mut steps = Matrix3::zeros();
        for i in 0..3 {
            let mut moved = map;
            moved[i] += STEP;
            steps.set_column(i, &(self.to_world(moved)? - at));
        }
        Some(steps)
    }
    /// What becomes of metres along the axes of [`World::grid`] on the map, in its metres: the scale of the map at a
    /// place, along east and north, which need not be one (EPSG:3857 has 2.2 at 63° north, equal areas several).
    pub fn map_scale(&self, map: [f64; 3]) -> Option<Matrix2<f64>> {
        if let World::Flat { .. } = self {
            return Some(Matrix2::identity());
        }
        let along = self.grid(map)?.transpose() * self.steps(map)?;
        let [plan_m, _] = self.units_m();
        let metres = along.fixed_view::<2, 2>(0, 0) / (STEP * plan_m);
        metres.try_inverse()
    }
    /// Standard deviations along the map's axes of what has a covariance at a place of the world.
    pub fn deviations_on_map(&self, at: &Vector3<f64>, covariance: &Matrix3<f64>) -> [f64; 3] {
        let grid = self.to_map(at).and_then(|map| self.grid(map)).unwrap_or_else(Matrix3::identity);
        let turned = grid.transpose() * covariance * grid;
        [0, 1, 2].map(|axis| turned[(axis, axis)].sqrt())
    }
    /// Standard deviations along the map's axes at a place of it, along the world's. Only the plan is turned: up leans
    /// by less than such numbers are known. The correlation that the turn brings is left out.
    pub fn deviations_of_map(&self, map: [f64; 3], sigma: Vector3<f64>) -> Vector3<f64> {
        let Some(grid) = self.grid(map).filter(|_| sigma.x != sigma.y) else { return sigma };
        let plan = |axis: usize| (grid[(axis, 0)] * sigma.x).hypot(grid[(axis, 1)] * sigma.y);
        Vector3::new(plan(0), plan(1), sigma.z)
    }
    /// A pose of the world in the map: the centre in map coordinates, the rotation against the map's axes there.
    pub fn pose_to_map(&self, pose: &Pose) -> Option<Pose> {
        let centre = self.to_map(&pose.centre)?;
        Some(Pose { rotation: pose.rotation * self.grid(centre)?, centre: Vector3::from(centre) })
    }
    /// A pose of the tangent frame (east, north, up) at a place of the Earth; `None` on a plane, which lies nowhere.
    pub fn pose_of_tangent(&self, lon_lat_h: [f64; 3], pose: &Pose) -> Option<Pose> {
        let World::Curved(t) = self else { return None };
        let axes = tangent_axes(lon_lat_h[0], lon_lat_h[1]);
        let centre = geocentric(lon_lat_h) + axes.transpose() * pose.centre;
        Some(Pose { rotation: pose.rotation * axes * t.axes.transpose(), centre: t.axes * (centre - t.origin) })
    }
    /// A pose of the map, as [`World::pose_to_map`] gives it, in the world.
    pub fn pose_to_world(&self, pose: &Pose) -> Option<Pose> {
        let map: [f64; 3] = pose.centre.into();
        Some(Pose { rotation: pose.rotation * self.grid(map)?.transpose(), centre: self.to_world(map)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Plain;
    impl Geodesy for Plain {
        fn to_geographic(&self, m: [f64; 3]) -> Option<[f64; 3]> {
            Some([m[0] * 1e-5, 60.0 + m[1] * 1e-5, m[2]])
        }
        fn map_of_geographic(&self, g: [f64; 3]) -> Option<[f64; 3]> {
            Some([g[0] * 1e5, (g[1] - 60.0) * 1e5, g[2]])
        }
    }

    /// The same map, which counts easting and northing in feet and heights in fathoms.
    struct Feet;
    const UNITS_M: [f64; 2] = [0.3048, 1.8288];
    impl Geodesy for Feet {
        fn to_geographic(&self, m: [f64; 3]) -> Option<[f64; 3]> {
            Plain.to_geographic([m[0] * UNITS_M[0], m[1] * UNITS_M[0], m[2] * UNITS_M[1]])
        }
        fn map_of_geographic(&self, g: [f64; 3]) -> Option<[f64; 3]> {
            let [x, y, h] = Plain.map_of_geographic(g)?;
            Some([x / UNITS_M[0], y / UNITS_M[0], h / UNITS_M[1]])
        }
        fn units_m(&self) -> [f64; 2] {
            UNITS_M
        }
    }

    #[test]
    fn a_map_in_feet_is_the_same_world() {
        let metric = World::curved(Box::new(Plain), [0.0; 3]).expect("on the Earth");
        let feet = World::curved(Box::new(Feet), [0.0; 3]).expect("on the Earth");
        let angles = crate::YawPitchRoll { yaw_deg: 30.0, pitch_deg: -70.0, roll_deg: 4.0 };
        let pose = Pose::looking(Vector3::new(300.0, -200.0, 150.0), angles);
        let listed = Pose { centre: Vector3::new(300.0 / 0.3048, -200.0 / 0.3048, 150.0 / 1.8288), ..pose };
        let [a, b] = [metric.pose_to_world(&pose), feet.pose_to_world(&listed)].map(|p| p.expect("on the Earth"));
        assert!((a.centre - b.centre).norm() < 1e-6 && (a.rotation - b.rotation).norm() < 2e-6, "{a:?} {b:?}");
        let back = feet.pose_to_map(&b).expect("on the map");
        assert!((back.centre - listed.centre).norm() < 1e-5, "{}", back.centre);
        let by = feet.metres_of([10.0, 20.0, 30.0]);
        assert!((Vector3::from(by) - Vector3::new(3.048, 6.096, 54.864)).norm() < 1e-9, "{by:?}");
    }

    #[test]
    fn a_map_stretches_the_ground_by_its_scale() {
        let scale = |geodesy: Box<dyn Geodesy>, north: f64| {
            let world = World::curved(geodesy, [0.0; 3]).expect("on the Earth");
            world.map_scale([40.0, north, 300.0]).expect("on the Earth")
        };
        // A degree has 100,000 units: of longitude 55,801 m at 60° north, of latitude 111,414 m.
        let plain = scale(Box::new(Plain), 0.0);
        let (east, north) = (1e5 / 55_801.0, 1e5 / 111_414.0);
        assert!((plain[(0, 0)] - east).abs() < 1e-3 && (plain[(1, 1)] - north).abs() < 1e-3, "{plain}");
        assert!(plain[(0, 1)].abs().max(plain[(1, 0)].abs()) < 1e-4, "{plain}");
        // What lies 100 m to the east and 200 m to the north there lies so far on the ground.
        let world = World::curved(Box::new(Plain), [0.0; 3]).expect("on the Earth");
        let by = Vector3::from(world.ground_metres_of([40.0, 0.0, 300.0], [100.0 * east, 200.0 * north, -7.0]));
        assert!((by - Vector3::new(100.0, 200.0, -7.0)).norm() < 0.2, "{by}");
        // In metres, whatever the map counts in.
        assert!((plain - scale(Box::new(Feet), 0.0)).norm() < 1e-3);
        let flat = World::flat([500.0; 3]).map_scale([500.0; 3]);
        assert_eq!(flat, Some(Matrix2::identity()));
    }

    /// A map whose north is turned by 30° to the east, as far from its meridian.
    struct Turned;
    impl Geodesy for Turned {
        fn to_geographic(&self, m: [f64; 3]) -> Option<[f64; 3]> {
            let (s, c) = 30f64.to_radians().sin_cos();
            Plain.to_geographic([2.0 * (c * m[0] + s * m[1]), c * m[1] - s * m[0], m[2]])
        }
        fn map_of_geographic(&self, g: [f64; 3]) -> Option<[f64; 3]> {
            let (s, c) = 30f64.to_radians().sin_cos();
            let [x, y, h] = Plain.map_of_geographic(g)?;
            Some([c * x / 2.0 - s * y, s * x / 2.0 + c * y, h])
        }
    }

    #[test]
    fn deviations_are_along_the_axes_of_the_map() {
        let world = World::curved(Box::new(Turned), [0.0; 3]).expect("on the Earth");
        let close = |a: Vector3<f64>, b: Vector3<f64>| assert!((a - b).norm() < 0.02, "{a} {b}");
        // 5 m to the map's east, which lies 30° south of east.
        let grid = world.grid([0.0; 3]).expect("on the Earth");
        let on_map = Vector3::new(5.0, 1.0, 2.0);
        let covariance = grid * Matrix3::from_diagonal(&on_map.component_mul(&on_map)) * grid.transpose();
        close(world.deviations_on_map(&Vector3::zeros(), &covariance).into(), on_map);
        let (c, s) = (30f64.to_radians().cos(), 0.5);
        let turned = Vector3::new((5.0 * c).hypot(s), (5.0 * s).hypot(c), 2.0);
        close(world.deviations_of_map([0.0; 3], on_map), turned);
        let alike = Vector3::new(3.0, 3.0, 2.0);
        assert_eq!(world.deviations_of_map([0.0; 3], alike), alike);
    }

    #[test]
    fn there_and_back_and_the_drop_of_the_horizon() {
        let world = World::curved(Box::new(Plain), [0.0; 3]).expect("on the Earth");
        let far = world.to_world([0.0, 15_300.0, 0.0]).expect("on the Earth");
        // 17 km away the ground lies 23 m below the tangent plane.
        assert!((far.y - 17_047.0).abs() < 30.0 && (far.z + 22.8).abs() < 0.3, "{far}");
        // The same place and direction, told in the tangent frame there.
        let level = Pose { rotation: Matrix3::identity(), centre: Vector3::new(0.0, 0.0, 5.0) };
        let lat = 60.0 + 15_300.0 * 1e-5;
        let pose = world.pose_of_tangent([0.0, lat, -5.0], &level).expect("on the Earth");
        assert!((pose.centre - far).norm() < 1e-6, "{}", pose.centre);
        // Up there leans to the north by the angle between both places.
        let up = pose.rotation.row(2);
        assert!((up[1] - 15_300.0e-5f64.to_radians().sin()).abs() < 1e-9, "{up}");
        let map = world.to_map(&far).expect("back");
        assert!((map[1] - 15_300.0).abs() < 1e-4 && map[2].abs() < 1e-6, "{map:?}");
    }
}
