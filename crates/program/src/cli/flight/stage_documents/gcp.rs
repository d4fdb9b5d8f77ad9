//! Surveyed points in the images, and what a similarity leaves at them.

use autoref_flight::adjust::{GroundPoint, OnGround, Role};
use autoref_flight::read::Reconstruction;
use autoref_flight::statistics::Residuals;
use autoref_flight::world::World;
use nalgebra::Vector3;
use serde::Serialize;

use crate::cli::flight::document::{in_map, length};
use crate::cli::flight::stage::Stage;
use crate::cli::flight::stage_line::StageLine;

/// Surveyed points in the images, and what a similarity leaves at them.
#[derive(Debug, Serialize)]
pub struct GcpStage {
    pub stage: Stage,
    pub crs: String,
    /// Metres of the map's unit, and of that of its heights.
    pub unit_m: f64,
    pub height_unit_m: f64,
    pub scale: f64,
    pub points: Vec<SurveyedPoint>,
    /// Metres; `None` without residuals.
    pub gcp_statistics: Option<Residuals>,
    pub check_point_statistics: Option<Residuals>,
}

impl GcpStage {
    pub fn of(placed: &OnGround, points: &[GroundPoint], model: &Reconstruction, world: &World, crs: String) -> Self {
        let point = |(p, left): (&GroundPoint, &Option<Vector3<f64>>)| SurveyedPoint::of(p, left, model, world);
        let points: Vec<SurveyedPoint> = points.iter().zip(&placed.residuals).map(point).collect();
        let statistics = |role: Role| {
            let residuals = points.iter().filter(|p| p.role == role).filter_map(|p| p.residual_m);
            Residuals::of(&residuals.collect::<Vec<_>>())
        };
        let [unit_m, height_unit_m] = world.units_m();
        GcpStage {
            stage: Stage::Gcp,
            crs,
            unit_m,
            height_unit_m,
            scale: placed.similarity.scale,
            gcp_statistics: statistics(Role::Control),
            check_point_statistics: statistics(Role::Check),
            points,
        }
    }

    pub fn line(&self) -> StageLine {
        StageLine::Gcp { points: self.points.len(), rms_m: self.gcp_statistics.map(|s| s.d.rms) }
    }
}

/// A control point or a check point in the map's units, and what the similarity leaves at it.
#[derive(Debug, Serialize)]
pub struct SurveyedPoint {
    pub name: String,
    pub role: Role,
    pub e: f64,
    pub n: f64,
    pub h: f64,
    pub sigma_m: [f64; 3],
    pub images: Vec<ImagePoint>,
    /// In the axes of the map, and its length; `None` where no rays meet.
    pub residual_m: Option<[f64; 3]>,
    pub d_m: Option<f64>,
}

impl SurveyedPoint {
    fn of(p: &GroundPoint, left: &Option<Vector3<f64>>, model: &Reconstruction, world: &World) -> Self {
        let [e, n, h] = world.to_map(&p.xyz).unwrap_or_default();
        let residual_m = left.map(|v| in_map(world, &p.xyz, &v));
        let image =
            |(i, pixel): &(usize, [f64; 2])| ImagePoint { frame: model.photographs[*i].name.clone(), pixel: *pixel };
        SurveyedPoint {
            name: p.name.clone(),
            role: p.role,
            e,
            n,
            h,
            sigma_m: p.sigma.into(),
            images: p.seen.iter().map(image).collect(),
            residual_m,
            d_m: residual_m.as_ref().map(length),
        }
    }
}

/// Where a point was measured.
#[derive(Debug, Serialize)]
pub struct ImagePoint {
    pub frame: String,
    pub pixel: [f64; 2],
}
