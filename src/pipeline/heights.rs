//! Heights of an elevation model at the marks, and what the survey says to them.

use serde::{Deserialize, Serialize};

use crate::gcp::Gcp;
use crate::pipeline::georeference::{FoundMark, Orientation};
use autoref_raster::ElevationModel;
use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::error::{Error, Result};
use autoref_solve::heights::{self, HeightCorrection, HeightPoint};

/// Where a mark lies and what the model says there.
type ReadHeight<'a> = dyn Fn(&FoundMark) -> Result<(MapPoint, Option<f64>)> + 'a;

/// How an elevation model lies to the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ModelFrame {
    /// Its pixels are the image's, or whole groups of them: it is read where the marks are in the image.
    Image,
    /// It has a georeference of its own: it is read where the marks are on the map.
    Map,
    /// The list of candidates brought the heights.
    List,
}

/// One point with both heights, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeightRow {
    pub gcp: String,
    pub surveyed_m: f64,
    pub model_m: f64,
    /// Surveyed − corrected model.
    pub residual_m: f64,
    /// The same with the surface fitted to the others; `None` for check points, which never took part.
    pub leave_one_out_m: Option<f64>,
}

/// The heights of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeightResult {
    pub frame: ModelFrame,
    /// The system in which the surface's positions count: the model's own, or that of the list.
    pub position_crs: Option<String>,
    pub correction: HeightCorrection,
    pub points: Vec<HeightRow>,
    pub check_points: Vec<HeightRow>,
    /// √(mean residual²) of the check points.
    pub check_rms_m: Option<f64>,
    /// Marks where the survey or the model has no height.
    pub without_height: Vec<String>,
    pub warnings: Vec<String>,
}

/// An elevation model with the way from marks to it.
pub struct PlacedModel {
    pub model: ElevationModel,
    pub frame: ModelFrame,
    /// Model pixels per image pixel, when the frame is the image's.
    ratio: (f64, f64),
    /// Heights are means over so many cells each way; 1 is the height at the very place.
    cells: u32,
    /// From the list's system to the model's, when they differ.
    change: Option<(Crs, Crs)>,
}

impl PlacedModel {
    /// Finds out how the model lies to an image of `size_px` that has, or once had, one of the `georeferences`.
    ///
    /// # Errors
    /// When the model has no georeference and is not the image's size, or its CRS cannot be reached from `list_crs`.
    pub fn new(
        model: ElevationModel,
        name: &str,
        size_px: Option<(f64, f64)>,
        georeferences: &[GeoTransform],
        list_crs: Option<&Crs>,
    ) -> Result<Self> {
        let (width, height) = (model.size().0 as f64, model.size().1 as f64);
        let ratio = size_px.map(|(w, h)| (width / w, height / h));
        // A whole grid over the same picture, perhaps coarser: both ratios agree within a pixel at the far edge.
        let same_picture = ratio.filter(|r| (r.0 / r.1 - 1.0).abs() * width.max(height) <= 1.0);
        let own = model.geotransform().filter(|own| !own.counts_pixels());
        let is_images = |own: &GeoTransform| georeferences.iter().any(|image| image.differs_px(own) < 0.01);
        let as_image = match (own, same_picture) {
            (None, Some(ratio)) => Some(ratio),
            (Some(own), Some(ratio)) if ratio == (1.0, 1.0) && is_images(&own) => Some(ratio),
            _ => None,
        };
        if let Some(ratio) = as_image {
            return Ok(PlacedModel { model, frame: ModelFrame::Image, ratio, cells: 1, change: None });
        }
        if own.is_none() {
            let image = size_px.map_or("unknown".into(), |(w, h)| format!("{w} × {h}"));
            return Err(Error::usage(
                format!("{name} has no georeference and {width} × {height} pixels; the image's size is {image}"),
                "give a model in the image's grid, or one with a georeference",
            ));
        }
        let change = match (list_crs, model.crs_wkt().filter(|wkt| !wkt.is_empty())) {
            (Some(list), Some(wkt)) => {
                let own = Crs::parse(wkt)?;
                (own.label() != list.label()).then(|| (list.clone(), own))
            }
            _ => None,
        };
        Ok(PlacedModel { model, frame: ModelFrame::Map, ratio: (1.0, 1.0), cells: 1, change })
    }

    /// The mark's place in the system in which the surface counts, and the model's height there.
    fn read(&self, pixel: PixelPoint, map: MapPoint) -> Result<(MapPoint, Option<f64>)> {
        if self.frame == ModelFrame::Image {
            let p = PixelPoint { x: pixel.x * self.ratio.0, y: pixel.y * self.ratio.1 };
            return Ok((map, self.mean_around(p)?));
        }
        let mut point = [Coordinate { x: map.easting, y: map.northing, height: None }];
        if let Some((from, to)) = &self.change {
            from.transform(&mut point, to, f64::INFINITY)?;
        }
        let there = MapPoint { easting: point[0].x, northing: point[0].y };
        if self.cells == 1 {
            return Ok((there, self.model.at_map(there)?));
        }
        let own = self.model.geotransform().and_then(|own| own.invert(there));
        Ok((there, own.map_or(Ok(None), |p| self.mean_around(p))?))
    }

    /// Heights as means over `cells` × `cells` cells around the mark, as the thesis's GCPArea: less noise, less detail.
    pub fn over(self, cells: u32) -> Self {
        PlacedModel { cells: cells.max(1), ..self }
    }

    /// `None` where one of the cells has no height.
    fn mean_around(&self, p: PixelPoint) -> Result<Option<f64>> {
        let half = f64::from(self.cells - 1) / 2.0;
        let mut sum = 0.0;
        for row in 0..self.cells {
            for column in 0..self.cells {
                let at = PixelPoint { x: p.x + f64::from(column) - half, y: p.y + f64::from(row) - half };
                let Some(height) = self.model.at_pixel(at)? else { return Ok(None) };
                sum += height;
            }
        }
        Ok(Some(sum / f64::from(self.cells).powi(2)))
    }

    /// From the model's pixels to the system in which the surface counts.
    pub fn to_positions(&self, fitted: &GeoTransform) -> GeoTransform {
        match self.frame {
            ModelFrame::Image => {
                let g = fitted.0;
                let (x, y) = self.ratio;
                GeoTransform([g[0], g[1] / x, g[2] / y, g[3], g[4] / x, g[5] / y])
            }
            _ => self.model.geotransform().expect("a model in map coordinates has a georeference"),
        }
    }
}

/// Reads the model at the marks and fits the surfaces. `to_map` brings metres of the fit to the list's CRS.
///
/// # Errors
/// When the model cannot be read; when no mark has both heights.
pub fn correct(
    orientation: &Orientation,
    gcps: &[Gcp],
    placed: &PlacedModel,
    to_map: &dyn Fn(MapPoint) -> Result<MapPoint>,
) -> Result<HeightResult> {
    let read = |mark: &FoundMark| -> Result<(MapPoint, Option<f64>)> {
        let fitted = orientation.solution.similarity.apply(mark.mark.centre);
        let map = if placed.frame == ModelFrame::Image { fitted } else { to_map(fitted)? };
        placed.read(mark.mark.centre, map)
    };
    let position_crs = placed.change.as_ref().map(|(_, own)| own.label());
    fit(orientation, gcps, placed.frame, position_crs, &read)
}

/// The same with heights that the list of candidates brought; `None` when it brought none.
///
/// # Errors
/// As [`correct`].
pub fn from_list(orientation: &Orientation, gcps: &[Gcp]) -> Result<Option<HeightResult>> {
    if orientation.marks.iter().all(|m| m.mark.elevation_m.is_none() || gcps[m.gcp].height.is_none()) {
        return Ok(None);
    }
    let read = |mark: &FoundMark| Ok((orientation.solution.similarity.apply(mark.mark.centre), mark.mark.elevation_m));
    fit(orientation, gcps, ModelFrame::List, None, &read).map(Some)
}

fn fit(
    orientation: &Orientation,
    gcps: &[Gcp],
    frame: ModelFrame,
    position_crs: Option<String>,
    read: &ReadHeight<'_>,
) -> Result<HeightResult> {
    let (mut without_height, mut off_model) = (Vec::new(), 0);
    let mut take = |marks: &[FoundMark]| -> Result<Vec<(String, HeightPoint)>> {
        let mut points = Vec::new();
        for mark in marks {
            let gcp = &gcps[mark.gcp];
            let (position, model) = read(mark)?;
            match gcp.height.zip(model) {
                Some((surveyed_m, model_m)) => {
                    points.push((gcp.name.clone(), HeightPoint { position, surveyed_m, model_m }));
                }
                None => {
                    off_model += usize::from(gcp.height.is_some());
                    without_height.push(gcp.name.clone());
                }
            }
        }
        Ok(points)
    };
    let (control, check) = (take(&orientation.marks)?, take(&orientation.check_marks)?);
    let points: Vec<HeightPoint> = control.iter().map(|p| p.1).collect();
    let correction = heights::solve(&points).map_err(|_| {
        Error::usage(
            "not one matched point has a height both in the survey and in the elevation model",
            "give heights in the list, and a model that covers the marks",
        )
    })?;
    let chosen = correction.chosen_fit();
    let surveyed = control.len() + check.len() + off_model;
    let mut warnings = correction.warnings.clone();
    warnings.extend((2 * off_model > surveyed && frame != ModelFrame::List).then(|| few_heights(off_model, surveyed)));
    let rows = |points: &[(String, HeightPoint)], left_out: &[f64]| -> Vec<HeightRow> {
        let row = |(i, (name, p)): (usize, &(String, HeightPoint))| HeightRow {
            gcp: name.clone(),
            surveyed_m: p.surveyed_m,
            model_m: p.model_m,
            residual_m: p.surveyed_m - p.model_m - correction.at(p.position),
            leave_one_out_m: left_out.get(i).copied(),
        };
        points.iter().enumerate().map(row).collect()
    };
    let (points, check_points) = (rows(&control, &chosen.leave_one_out_m), rows(&check, &[]));
    let squares: f64 = check_points.iter().map(|r| r.residual_m.powi(2)).sum();
    Ok(HeightResult {
        frame,
        position_crs,
        check_rms_m: (!check_points.is_empty()).then(|| (squares / check_points.len() as f64).sqrt()),
        points,
        check_points,
        without_height,
        warnings,
        correction,
    })
}

/// That the model has little to say of the marks.
fn few_heights(off_model: usize, surveyed: usize) -> String {
    format!(
        "the elevation model has no height at {off_model} of the {surveyed} points with a surveyed one: look whether it \
         covers the marks, and whether its georeference is the true one"
    )
}
