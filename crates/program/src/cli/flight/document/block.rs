//! The cameras document of a block, `cameras.json`: what `flight solve` and `flight adjust` found.

use autoref_flight::adjust::{AdjustedPoint, Adjustment, Blunder, Role};
use autoref_flight::bundle::Ended;
use autoref_flight::read::Reconstruction;
use autoref_flight::statistics::Residuals;
use autoref_flight::world::World;
use autoref_flight::{Camera, Parameter};
use nalgebra::Vector3;
use serde::Serialize;

use super::camera::{CameraRecord, InteriorOrientation, by_name};
use super::{in_map, length};
use crate::cli::flight::ties::PairTies;

/// The cameras of a block, their interior orientations, and the residuals of its points. A number that is not finite
/// is written as `null`.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(Default))]
pub struct CamerasDocument {
    pub crs: String,
    /// Metres of the map's unit, and of that of its heights.
    pub unit_m: f64,
    pub height_unit_m: f64,
    pub frames_registered: usize,
    pub frames_listed: usize,
    pub cameras: Vec<BlockCamera>,
    pub interior: Vec<AdjustedInterior>,
    pub gcps: Vec<PointRecord>,
    pub check_points: Vec<PointRecord>,
    /// Metres; `None` without residuals.
    pub gcp_statistics: Option<Residuals>,
    pub check_point_statistics: Option<Residuals>,
    pub blunders: Vec<BlunderRecord>,
    pub reprojection_rms_px: f64,
    pub reprojection_mean_px: f64,
    pub sigma_tie_px: f64,
    pub ties: usize,
    pub ties_left_out: usize,
    pub iterations: usize,
    pub ended: &'static str,
    pub notes: Vec<String>,
    /// Of `flight solve`, where warped neighbours were matched.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pairs: Option<Vec<PairTies>>,
    /// Of `flight solve`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lines: Option<Vec<LineRecord>>,
    /// Of `flight solve` with a rough table.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rough_differences: Option<RoughDifferences>,
}

/// A camera of the block, and what its ties leave.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(Default))]
pub struct BlockCamera {
    #[serde(flatten)]
    pub camera: CameraRecord,
    pub rms_px: f64,
    pub ties: usize,
}

/// An interior orientation, with the standard deviations of what was adjusted of it.
#[derive(Clone, Debug, Serialize)]
pub struct AdjustedInterior {
    pub name: String,
    #[serde(flatten)]
    pub interior: InteriorOrientation,
    /// In the unit of each parameter.
    #[serde(serialize_with = "by_name")]
    pub sigma: Vec<(Parameter, f64)>,
}

/// A control point or a check point, and its residuals.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(test, derive(Default))]
pub struct PointRecord {
    pub name: String,
    /// In the map's units.
    pub e: f64,
    pub n: f64,
    pub h: f64,
    /// Adjusted − surveyed, x, y, z of the map, and its length.
    pub residual_m: Option<[f64; 3]>,
    pub d_m: Option<f64>,
    /// 1σ of x, y, z of the map.
    pub sigma_m: Option<[f64; 3]>,
    pub images: Vec<ImageResidual>,
}

/// The residual of a point in a frame: predicted − measured.
#[derive(Clone, Debug, Serialize)]
pub struct ImageResidual {
    pub frame: String,
    pub residual_px: [f64; 2],
}

/// A point that errs in a frame, or on the ground where `frame` is `None`.
#[derive(Clone, Debug, Serialize)]
pub struct BlunderRecord {
    pub gcp: String,
    pub frame: Option<String>,
    #[serde(flatten)]
    pub by: BlunderBy,
    /// In standard deviations.
    pub test: f64,
}

/// By how much a point errs.
#[derive(Clone, Debug, Serialize)]
pub enum BlunderBy {
    /// In a frame; `None` where the camera looks away from the point.
    #[serde(rename = "by_px")]
    Pixels(Option<Vec<f64>>),
    /// On the ground: x, y, z of the map.
    #[serde(rename = "by_m")]
    Metres(Vec<f64>),
}

/// A line of the flight: its frames, and the residuals of the GCPs and check points that they show, as Table 9.1 of the
/// thesis of 2017 has them.
#[derive(Clone, Debug, Serialize)]
pub struct LineRecord {
    pub name: String,
    pub frames: Vec<String>,
    pub gcp_statistics: Option<Residuals>,
    pub check_point_statistics: Option<Residuals>,
}

/// How far the cameras stand from the rough table.
#[derive(Clone, Debug, Serialize)]
pub struct RoughDifferences {
    pub frames: Vec<FrameDifference>,
    /// Metres.
    pub statistics: Option<Residuals>,
}

/// Camera − rough table of a frame.
#[derive(Clone, Debug, Serialize)]
pub struct FrameDifference {
    pub name: String,
    pub x_m: f64,
    pub y_m: f64,
    pub z_m: f64,
    pub d_m: f64,
    /// `None` where the table has no direction.
    pub turn_deg: Option<f64>,
    /// As the table names it.
    pub line: Option<String>,
}

impl CamerasDocument {
    /// What an adjustment found of `listed` frames; what `flight solve` alone says is not in it yet.
    pub fn of(found: &Adjustment, model: &Reconstruction, world: &World, listed: usize, crs: String) -> Self {
        let name = |i: usize| model.photographs[i].name.clone();
        let cameras = found.photographs.iter().map(|c| {
            let of = &found.cameras[model.photographs[c.photograph].camera];
            let camera = CameraRecord::of(&name(c.photograph), of, &c.pose, c.covariance.as_ref(), world);
            BlockCamera { camera, rms_px: c.rms_px, ties: c.ties }
        });
        let (gcps, gcp_statistics) = points(found, Role::Control, world, &name);
        let (check_points, check_point_statistics) = points(found, Role::Check, world, &name);
        let [unit_m, height_unit_m] = world.units_m();
        CamerasDocument {
            crs,
            unit_m,
            height_unit_m,
            frames_registered: found.photographs.len(),
            frames_listed: listed,
            cameras: cameras.collect(),
            interior: found.cameras.iter().zip(&found.interior_sigmas).map(AdjustedInterior::of).collect(),
            gcps,
            check_points,
            gcp_statistics,
            check_point_statistics,
            blunders: found.blunders.iter().map(|b| BlunderRecord::of(b, found, world, &name)).collect(),
            reprojection_rms_px: found.tie_rms_px,
            reprojection_mean_px: found.tie_mean_px,
            sigma_tie_px: found.sigma_tie_px,
            ties: found.ties,
            ties_left_out: found.dropped_ties,
            iterations: found.summary.iterations,
            ended: match found.summary.ended {
                Ended::Converged => "converged",
                Ended::OutOfIterations => "out of iterations",
                Ended::Stuck => "stuck",
                Ended::Left => "out of bounds",
            },
            notes: found.notes.clone(),
            pairs: None,
            lines: None,
            rough_differences: None,
        }
    }
}

/// The points of a role, and the statistics of their residuals.
fn points(
    found: &Adjustment,
    role: Role,
    world: &World,
    name: &impl Fn(usize) -> String,
) -> (Vec<PointRecord>, Option<Residuals>) {
    let of_role = found.points.iter().filter(|p| p.role == role);
    let records: Vec<PointRecord> = of_role.map(|p| PointRecord::of(p, world, name)).collect();
    let residuals: Vec<[f64; 3]> = records.iter().filter_map(|p| p.residual_m).collect();
    let statistics = Residuals::of(&residuals);
    (records, statistics)
}

impl PointRecord {
    fn of(point: &AdjustedPoint, world: &World, name: &impl Fn(usize) -> String) -> Self {
        let [e, n, h] = world.to_map(&point.xyz).unwrap_or_default();
        let residual_m = point.residual.map(|r| in_map(world, &point.xyz, &r));
        let images = point.image.iter().map(|(i, r)| ImageResidual { frame: name(*i), residual_px: *r });
        PointRecord {
            name: point.name.clone(),
            e,
            n,
            h,
            residual_m,
            d_m: residual_m.as_ref().map(length),
            sigma_m: point.covariance.map(|c| world.deviations_on_map(&point.xyz, &c)),
            images: images.collect(),
        }
    }
}

impl AdjustedInterior {
    fn of((camera, sigmas): (&Camera, &Vec<(Parameter, f64)>)) -> Self {
        let interior = InteriorOrientation::of(camera);
        AdjustedInterior { name: camera.name.clone(), interior, sigma: sigmas.clone() }
    }
}

impl BlunderRecord {
    fn of(blunder: &Blunder, found: &Adjustment, world: &World, name: &impl Fn(usize) -> String) -> Self {
        let by = blunder.by.clone();
        let on_map = |by: Vec<f64>| {
            let point = found.points.iter().find(|p| p.name == blunder.gcp);
            match (point, by.as_slice()) {
                (Some(point), &[x, y, z]) => in_map(world, &point.xyz, &Vector3::new(x, y, z)).to_vec(),
                _ => by,
            }
        };
        BlunderRecord {
            gcp: blunder.gcp.clone(),
            frame: blunder.photograph.map(name),
            by: match blunder.photograph {
                Some(_) => BlunderBy::Pixels(Some(by).filter(|by| !by.is_empty())),
                None => BlunderBy::Metres(on_map(by)),
            },
            test: blunder.test,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_known_is_null_and_what_is_not_said_is_absent() {
        let blunder = |frame: Option<&str>, by: BlunderBy| {
            let record = BlunderRecord { gcp: "G".into(), frame: frame.map(String::from), by, test: 4.5 };
            serde_json::to_string(&record).expect("JSON")
        };
        assert_eq!(
            blunder(Some("f"), BlunderBy::Pixels(Some(vec![1.0, f64::NAN]))),
            r#"{"gcp":"G","frame":"f","by_px":[1.0,null],"test":4.5}"#
        );
        assert_eq!(blunder(Some("f"), BlunderBy::Pixels(None)), r#"{"gcp":"G","frame":"f","by_px":null,"test":4.5}"#);
        assert_eq!(
            blunder(None, BlunderBy::Metres(vec![1.0, 2.0, 3.0])),
            r#"{"gcp":"G","frame":null,"by_m":[1.0,2.0,3.0],"test":4.5}"#
        );
        let document = serde_json::to_string(&CamerasDocument::default()).expect("JSON");
        assert!(document.contains(r#""gcp_statistics":null"#), "{document}");
        assert!(document.ends_with(r#""ended":"","notes":[]}"#), "{document}");
    }
}
