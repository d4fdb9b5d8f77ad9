//! Heights of a solved run: an elevation model against the survey, and the corrected copy of it.

use std::path::{Path, PathBuf};

use autoref_raster::atomic::Transaction;
use autoref_raster::coords::{GeoTransform, MapPoint};
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::{ElevationModel, RasterInfo};
use autoref_stream::gcp::GcpList;
use autoref_stream::georef::heights::{CopyPlace, write_corrected};
use autoref_stream::pipeline::georeference::Orientation;
use autoref_stream::pipeline::heights::{self, HeightResult, ModelFrame, PlacedModel};
use autoref_stream::result::{RunResult, SolvedRun};

use crate::cli::lengths::length;

/// What is known of the image's size and place.
pub struct ImagePlace {
    pub size_px: Option<(f64, f64)>,
    /// The georeference that the image came with, and the one that an earlier run wrote, where there are.
    pub georeferences: Vec<GeoTransform>,
}

impl ImagePlace {
    /// Of an image over whose georeference an earlier run has `written`.
    pub fn of(info: &RasterInfo, written: Option<GeoTransform>) -> Self {
        let georeferences = [info.geotransform, written].into_iter().flatten().collect();
        ImagePlace { size_px: Some((info.width as f64, info.height as f64)), georeferences }
    }
}

/// A corrected elevation model that is to be written.
pub struct DemCopy {
    placed: PlacedModel,
    heights: HeightResult,
    fitted: GeoTransform,
    target: PathBuf,
    list_wkt: Option<String>,
}

impl DemCopy {
    /// Draws the copy into a part file, which appears with the other outputs.
    ///
    /// # Errors
    /// When the model cannot be read or the copy not be written.
    pub fn stage(self, result: &RunResult, transaction: &mut Transaction) -> autoref_raster::error::Result<()> {
        let to_positions = self.placed.to_positions(&self.fitted);
        let own = self.placed.frame == ModelFrame::Map;
        // The delivered transform counts in the outputs' units, the positions of the surface in metres of the fit.
        let delivered = result.geotransform().map_or(to_positions, |g| self.placed.to_positions(&g));
        let place = CopyPlace {
            to_positions,
            geotransform: if own { to_positions } else { delivered },
            crs_wkt: if own { self.placed.model.crs_wkt() } else { self.list_wkt.as_deref() },
        };
        transaction.stage(&self.target, |partial| {
            write_corrected(&self.placed.model, &self.heights.correction, &place, partial)
        })
    }
}

/// An elevation model that is compared with the survey, and what comes of it.
pub(super) struct Comparison<'a> {
    pub dem: &'a Path,
    /// Heights are means over so many cells a side.
    pub area_cells: u32,
    /// Where the corrected copy goes.
    pub copy: Option<&'a Path>,
}

/// Enters the heights of the list, where it has any, without an elevation model.
pub(super) fn of_list(result: &mut RunResult, orientation: &Orientation, list: &GcpList) -> anyhow::Result<()> {
    enter_heights(result, heights::from_list(orientation, &list.gcps)?);
    Ok(())
}

impl Comparison<'_> {
    /// Enters the heights of the model in the result; answers the copy that is to be written.
    pub(super) fn run(
        &self,
        result: &mut RunResult,
        orientation: &Orientation,
        list: &GcpList,
        place: &ImagePlace,
    ) -> anyhow::Result<Option<DemCopy>> {
        let name = self.dem.display().to_string();
        let model = ElevationModel::open(self.dem)?;
        let placed = PlacedModel::new(model, &name, place.size_px, &place.georeferences, list.crs.as_ref())?
            .over(self.area_cells);
        let to_map = |p: MapPoint| {
            let mut point = [Coordinate { x: p.easting, y: p.northing, height: None }];
            list.working_crs.leave(&mut point)?;
            Ok(MapPoint { easting: point[0].x, northing: point[0].y })
        };
        let mut solved = heights::correct(orientation, &list.gcps, &placed, &to_map)?;
        if solved.position_crs.is_none() {
            solved.position_crs = list.crs.as_ref().map(Crs::label);
        }
        enter_heights(result, Some(solved.clone()));
        Ok(self.copy.map(|target| DemCopy {
            placed,
            heights: solved,
            fitted: orientation.solution.geotransform,
            target: target.to_path_buf(),
            list_wkt: list.crs.as_ref().map(|crs| crs.wkt().to_string()),
        }))
    }
}

/// The heights of a run in one line.
pub fn heights_in_brief(solved: &HeightResult) -> String {
    let (correction, fit) = (&solved.correction, solved.correction.chosen_fit());
    format!(
        "{} points, {} off the model (RMS), {} after a {}",
        solved.points.len(),
        length(correction.uncorrected_rms_m),
        length(fit.rms_m),
        fit.model.label()
    )
}

/// Enters the heights of a solved run.
fn enter_heights(result: &mut RunResult, heights: Option<HeightResult>) {
    if let Some(solved) = result.solved_mut() {
        solved.heights = heights;
    }
}

/// Lines of the summary.
pub fn lines(solved: &SolvedRun, line: &mut impl FnMut(&str, String)) {
    let Some(heights) = &solved.heights else { return };
    let from = match heights.frame {
        ModelFrame::Image => "model in the image's grid",
        ModelFrame::Map => "model in map coordinates",
        ModelFrame::List => "elevations of the list",
    };
    line(
        "Heights",
        format!(
            "{} points, {from}; uncorrected RMS {:.4} m",
            heights.points.len(),
            heights.correction.uncorrected_rms_m
        ),
    );
    for fit in &heights.correction.fits {
        let left_out = fit.leave_one_out_rms_m.map_or(String::new(), |loo| format!(", leave-one-out {loo:.4} m"));
        let chosen = if fit.model == heights.correction.chosen { "  (chosen)" } else { "" };
        line(&format!("  {}", fit.model.label()), format!("RMS {:.4} m{left_out}{chosen}", fit.rms_m));
    }
    if let Some(rms) = heights.check_rms_m {
        line("  check points", format!("RMS {rms:.4} m of {}", heights.check_points.len()));
    }
    if !heights.without_height.is_empty() {
        line("  no height", heights.without_height.join(", "));
    }
    for warning in &heights.warnings {
        line("  note", warning.clone());
    }
}
