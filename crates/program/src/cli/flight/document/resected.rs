//! The document of a frame alone, as `flight resect` writes it.

use autoref_flight::resect::{Resection, Seen};
use autoref_flight::world::World;
use autoref_raster::words::counted;
use serde::Serialize;

use super::camera::{CameraRecord, OtherPose};

/// A camera of its own, the points that it was solved from, and those that were kept out. A number that is not finite
/// is written as `null`.
#[derive(Clone, Debug, Serialize)]
pub struct ResectionDocument {
    pub crs: String,
    /// Metres of the map's unit, and of that of its heights.
    pub unit_m: f64,
    pub height_unit_m: f64,
    #[serde(flatten)]
    pub camera: CameraRecord,
    pub rms_px: f64,
    /// `None` without redundancy.
    pub sigma0: Option<f64>,
    pub alternatives: Vec<OtherPose>,
    pub gcps: Vec<SolvedFrom>,
    /// Names of the GCPs that were taken out.
    pub blunders: Vec<String>,
    pub check_points: Vec<PixelResidual>,
    pub notes: Vec<String>,
}

/// A point of which the camera was solved.
#[derive(Clone, Debug, Serialize)]
pub struct SolvedFrom {
    #[serde(flatten)]
    pub point: PixelResidual,
    pub blunder: bool,
}

/// The residual of a point in the frame, predicted − measured, and its length; `None` behind the camera.
#[derive(Clone, Debug, Serialize)]
pub struct PixelResidual {
    pub name: String,
    pub residual_px: Option<[f64; 2]>,
    pub d_px: Option<f64>,
}

impl ResectionDocument {
    /// `more` is to be said beside what the resection itself says.
    pub fn of(
        found: &Resection,
        name: &str,
        (seen, checks): (&[Seen], &[Seen]),
        (world, crs): (&World, String),
        more: Vec<String>,
    ) -> Self {
        let [unit_m, height_unit_m] = world.units_m();
        let others =
            found.alternatives.iter().map(|a| CameraRecord::of(name, &a.camera, &a.pose, a.covariance.as_ref(), world));
        let gcps = seen.iter().zip(&found.residuals_px).enumerate().map(|(i, (s, residual))| SolvedFrom {
            point: PixelResidual::of(s, *residual),
            blunder: found.blunders.contains(&i),
        });
        let kept_out = checks
            .iter()
            .map(|s| PixelResidual::of(s, found.camera.residual(found.pose.to_camera(&s.xyz).into(), s.pixel)));
        ResectionDocument {
            crs,
            unit_m,
            height_unit_m,
            camera: CameraRecord::of(name, &found.camera, &found.pose, found.covariance.as_ref(), world),
            rms_px: found.rms_px,
            sigma0: found.sigma0,
            alternatives: others.map(OtherPose::from).collect(),
            gcps: gcps.collect(),
            blunders: found.blunders.iter().map(|i| seen[*i].name.clone()).collect(),
            check_points: kept_out.collect(),
            notes: [notes(found), more].concat(),
        }
    }
}

impl PixelResidual {
    fn of(seen: &Seen, residual_px: Option<[f64; 2]>) -> Self {
        let d_px = residual_px.map(|r| r[0].hypot(r[1]));
        PixelResidual { name: seen.name.clone(), residual_px, d_px }
    }
}

/// What a person should know of a resection.
fn notes(found: &Resection) -> Vec<String> {
    /// Points fit so many times worse than is stated only when something is wrong, and so many where some of them are
    /// called wrong already.
    const MISFIT: f64 = 10.0;
    const MISFIT_OF_THE_REST: f64 = 4.0;
    let mut notes = Vec::new();
    if !found.alternatives.is_empty() {
        notes.push(format!(
            "{} about as good as this one (alternatives), and the standard deviations hold \
             only if this one is right: measure another point, or give --position",
            counted(found.alternatives.len(), "other pose is", "other poses are")
        ));
    }
    if found.covariance.is_none() {
        notes.push(
            "two poses fall together here, and no standard deviations can be stated: measure another point".into(),
        );
    }
    if let Some(off_m) = found.position_off_m {
        notes.push(format!(
            "--position is {off_m:.1} m from where the points see the camera: left out; look at it, and at the focal length"
        ));
    }
    let most = if found.blunders.is_empty() { MISFIT } else { MISFIT_OF_THE_REST };
    if let Some(sigma0) = found.sigma0.filter(|s| *s > most || found.pixels_times.is_some()) {
        if let Some(factor) = found.pixels_times {
            let (size, remedy) = if factor > 1.0 { ("half", "double") } else { ("twice", "halve") };
            notes.push(format!(
                "the points would fit if they were measured in a frame of {size} the size: {remedy} the pixels, or give \
                 the camera of the frame that was measured"
            ));
        }
        notes.push(format!(
            "the points fit {sigma0:.0} times worse than is stated of them: do not trust the pose; look at the points, the \
             focal length and --position"
        ));
    } else if found.widened > 1.0 {
        notes.push(format!(
            "the points fit {:.1} times worse than is stated of them, which chance does not explain: the standard deviations \
             are as many times as large",
            found.widened
        ));
    }
    notes
}
