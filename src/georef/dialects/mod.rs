//! Tie points as other programs read them.
//!
//! A dialect that carries tie points returns exactly the pairs of pixel and surveyed point that were matched; numbers
//! are written in the shortest form that reads back to the same double wherever the format allows it.

pub mod csv;
pub mod gcp_list;
pub mod geojson;
pub mod metashape;
pub mod micmac;
pub mod pix4d;
pub mod points;

use std::path::{Path, PathBuf};

use crate::gcp::Gcp;
use crate::georef::write::Output;
use crate::result::RunResult;
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// What was matched, ready for any dialect.
#[derive(Clone, Debug, PartialEq)]
pub struct TiePoints {
    /// File name of the image, without folders.
    pub image_name: String,
    /// Width and height of the image; `None` when the orientation was solved from lists alone.
    pub image_size_px: Option<(u64, u64)>,
    /// CRS of eastings and northings; `None` for local coordinates.
    pub crs: Option<Crs>,
    /// Control points of the fit first, then the check points.
    pub pairs: Vec<TiePoint>,
    pub transform: Option<GeoTransform>,
}

/// A surveyed point and where it was found in the image.
#[derive(Clone, Debug, PartialEq)]
pub struct TiePoint {
    pub name: String,
    /// (0, 0) is the outer corner of the first pixel.
    pub pixel: PixelPoint,
    /// In the units of the CRS, as surveyed.
    pub easting: f64,
    pub northing: f64,
    pub height: Option<f64>,
    /// 1σ of the survey in each of easting and northing, metres.
    pub sigma_m: Option<f64>,
    /// The same of the height.
    pub sigma_height_m: Option<f64>,
    /// Surveyed − computed.
    pub residual_e_m: f64,
    pub residual_n_m: f64,
    /// Kept out of the fit.
    pub check: bool,
}

impl TiePoints {
    /// Those of a result. `image` gives the name.
    pub fn of(result: &RunResult, image: &Path, crs: Option<&Crs>) -> Self {
        let rows = result.matches().iter().map(|row| (row, false));
        let pairs = rows
            .chain(result.check_points().iter().map(|row| (row, true)))
            .map(|(row, check)| TiePoint {
                name: row.gcp.clone(),
                pixel: PixelPoint { x: row.x, y: row.y },
                easting: row.easting,
                northing: row.northing,
                height: row.height,
                sigma_m: row.survey_sigma_m,
                sigma_height_m: row.survey_sigma_height_m,
                residual_e_m: row.residual_e_m,
                residual_n_m: row.residual_n_m,
                check,
            })
            .collect();
        TiePoints {
            image_name: image.file_name().map_or_else(|| "image".into(), |name| name.to_string_lossy().into_owned()),
            image_size_px: result.image.as_ref().map(|image| (image.width, image.height)),
            crs: crs.cloned(),
            pairs,
            transform: result.geotransform(),
        }
    }
}

/// The files of a dialect beside `base`, the path of the image (or what takes its place in `--out`); the writer gets a
/// temporary name for each of them, in this order.
pub fn files(output: Output, base: &Path) -> Vec<PathBuf> {
    let with = |ending: &str| base.with_extension(ending);
    match output {
        Output::Points => {
            // QGIS appends to the whole name.
            let mut name = base.as_os_str().to_owned();
            name.push(".points");
            vec![PathBuf::from(name)]
        }
        Output::GcpList => vec![with("gcp_list.txt")],
        Output::GeoJson => vec![with("gcps.geojson")],
        Output::Csv => vec![with("gcps.csv")],
        Output::MicMac => vec![with("appuis.xml"), with("mesures.xml")],
        Output::Metashape => vec![with("metashape.csv"), with("metashape.xml")],
        Output::Pix4d => vec![with("pix4d-gcps.csv"), with("pix4d-marks.csv")],
        _ => Vec::new(),
    }
}

/// Writes a dialect. `paths` are those of [`files`], under temporary names that are put in place later.
///
/// # Errors
/// When a file cannot be written, or the dialect cannot hold the points; the message says which.
pub fn write(output: Output, paths: &[PathBuf], tie_points: &TiePoints) -> Result<()> {
    match (output, paths) {
        (Output::Points, [path]) => points::write(path, tie_points),
        (Output::GcpList, [path]) => gcp_list::write(path, tie_points),
        (Output::GeoJson, [path]) => geojson::write(path, tie_points),
        (Output::Csv, [path]) => csv::write(path, tie_points),
        (Output::MicMac, [ground, image]) => micmac::write(ground, image, tie_points),
        (Output::Metashape, [reference, markers]) => metashape::write(reference, markers, tie_points),
        (Output::Pix4d, [gcps, marks]) => pix4d::write(gcps, marks, tie_points),
        _ => Err(Error::usage(format!("`{output}` is no list of tie points"), "this is a mistake in the program")),
    }
}

/// Refuses, before any work, what a dialect cannot hold.
///
/// # Errors
/// When OpenDroneMap's list would lack a CRS or have an image name with blanks, at which it is cut; when a point
/// without a height is to go where heights are demanded.
pub fn check(outputs: &[Output], image: &Path, crs: Option<&Crs>, gcps: &[Gcp]) -> Result<()> {
    for output in outputs {
        match output {
            Output::GcpList => {
                gcp_list::header(crs)?;
                let name = image.file_name().unwrap_or_default().to_string_lossy();
                if name.contains(char::is_whitespace) {
                    return Err(Error::usage(
                        format!("OpenDroneMap's gcp_list.txt cannot hold the image name `{name}`: it is cut at blanks"),
                        "rename the image, or leave gcp-list out of --write",
                    ));
                }
            }
            Output::MicMac | Output::Pix4d => {
                if let Some(gcp) = gcps.iter().find(|gcp| gcp.height.is_none()) {
                    return Err(no_height(if *output == Output::MicMac { "MicMac" } else { "Pix4D" }, &gcp.name));
                }
            }
            _ => {}
        }
    }
    Ok(())
}

fn no_height(program: &str, name: &str) -> Error {
    Error::usage(
        format!("{program} needs heights, and `{name}` has none"),
        "complete the list of points, or choose another --write",
    )
}

fn required_height(program: &str, pair: &TiePoint) -> Result<f64> {
    pair.height.ok_or_else(|| no_height(program, &pair.name))
}

fn write_file(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).map_err(|e| Error::io(path, "write", e))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(output: Output, crs: Option<Crs>) -> String {
        let folder = tempfile::tempdir().expect("a folder");
        let paths = files(output, &folder.path().join("e6.tif"));
        let pair = TiePoint {
            name: "A".into(),
            pixel: PixelPoint { x: 1.5, y: 2.5 },
            easting: 10.7,
            northing: 59.9,
            height: Some(12.0),
            sigma_m: Some(0.02),
            sigma_height_m: Some(0.09),
            residual_e_m: 0.0,
            residual_n_m: 0.0,
            check: false,
        };
        let tie_points =
            TiePoints { image_name: "e6.tif".into(), image_size_px: None, crs, pairs: vec![pair], transform: None };
        write(output, &paths, &tie_points).expect("written");
        paths.iter().map(|path| std::fs::read_to_string(path).expect("text")).collect()
    }

    #[test]
    fn heights_have_their_own_deviation() {
        for (output, expected) in [
            (Output::MicMac, "<Incertitude>0.02 0.02 0.09</Incertitude>"),
            (Output::Pix4d, "A,10.7,59.9,12,0.02,0.09\n"),
            (Output::Metashape, "sx=\"0.02\" sy=\"0.02\" sz=\"0.09\""),
            (Output::GeoJson, "\"sigma_height_m\": 0.09"),
        ] {
            let text = written(output, None);
            assert!(text.contains(expected), "{text}");
        }
    }

    #[test]
    fn pix4d_has_the_latitude_first() {
        let degrees = Crs::from_epsg(4326).expect("WGS 84");
        assert!(written(Output::Pix4d, Some(degrees)).starts_with("A,59.9,10.7,12,"));
    }
}
