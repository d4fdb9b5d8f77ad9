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

use crate::gcp::convert::{ListFormat, names};
use crate::gcp::programs::{NoHeight, pix4d_has_accuracies};
use crate::gcp::{Gcp, GcpRole};
use crate::georef::output::Output;
use crate::result::RunResult;
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

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
    /// As surveyed, in the units of the CRS; check points were kept out of the fit.
    pub gcp: Gcp,
    /// (0, 0) is the outer corner of the first pixel.
    pub pixel: PixelPoint,
    /// Surveyed − computed.
    pub residual_e_m: f64,
    pub residual_n_m: f64,
}

impl TiePoints {
    /// Those of a result. `image` gives the name.
    pub fn of(result: &RunResult, image: &Path, crs: Option<&Crs>) -> Self {
        let rows = result.matches().iter().map(|row| (row, GcpRole::Control));
        let pairs = rows
            .chain(result.check_points().iter().map(|row| (row, GcpRole::Check)))
            .map(|(row, role)| TiePoint {
                gcp: Gcp {
                    name: row.gcp.clone(),
                    easting: row.easting,
                    northing: row.northing,
                    height: row.height,
                    sigma_m: row.survey_sigma_m,
                    sigma_height_m: row.survey_sigma_height_m,
                    role,
                },
                pixel: PixelPoint { x: row.x, y: row.y },
                residual_e_m: row.residual_e_m,
                residual_n_m: row.residual_n_m,
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

    pub(crate) fn gcps(&self) -> impl Iterator<Item = &Gcp> + Clone {
        self.pairs.iter().map(|pair| &pair.gcp)
    }

    /// The same with names that a format can hold.
    fn named_for(&self, format: ListFormat) -> Self {
        let mut named = self.clone();
        for pair in &mut named.pairs {
            pair.gcp.name = names::held(format, &pair.gcp.name).into_owned();
        }
        named
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
    let named = |format| tie_points.named_for(format);
    match (output, paths) {
        (Output::Points, [path]) => points::write(path, &named(ListFormat::Qgis)),
        (Output::GcpList, [path]) => gcp_list::write(path, &named(ListFormat::Odm)),
        (Output::GeoJson, [path]) => geojson::write(path, tie_points),
        (Output::Csv, [path]) => csv::write(path, &named(ListFormat::Csv)),
        (Output::MicMac, [ground, image]) => micmac::write(ground, image, &named(ListFormat::MicMac)),
        (Output::Metashape, [reference, markers]) => {
            metashape::write_reference(reference, &named(ListFormat::MetashapeCsv))?;
            metashape::write_markers(markers, &named(ListFormat::MetashapeXml))
        }
        (Output::Pix4d, [gcps, marks]) => pix4d::write(gcps, marks, &named(ListFormat::Pix4d)),
        _ => Err(Error::usage(format!("`{output}` is no list of tie points"), "this is a mistake in the program")),
    }
}

/// The formats of a dialect's files, as `gcps convert` knows them; none of those that hold every name.
fn formats(output: Output) -> &'static [ListFormat] {
    match output {
        Output::Points => &[ListFormat::Qgis],
        Output::GcpList => &[ListFormat::Odm],
        Output::Csv => &[ListFormat::Csv],
        Output::MicMac => &[ListFormat::MicMac],
        Output::Metashape => &[ListFormat::MetashapeCsv, ListFormat::MetashapeXml],
        Output::Pix4d => &[ListFormat::Pix4d],
        _ => &[],
    }
}

/// What the points have and a dialect does not say, in plain words.
pub fn lost(output: Output, tie_points: &TiePoints) -> Vec<String> {
    let mut lost = Vec::new();
    let is_changed = |gcp: &&Gcp| formats(output).iter().any(|format| names::held(*format, &gcp.name) != gcp.name);
    let changed = tie_points.gcps().filter(is_changed).count();
    if changed > 0 {
        let names = counted(changed, "name", "names");
        lost.push(format!("--write {output}: letters (line ends, tabs and the like) of {names} are written as blanks"));
    }
    let has_some = tie_points.gcps().any(|gcp| gcp.sigma_m.is_some() || gcp.sigma_height_m.is_some());
    if output == Output::Pix4d && has_some && !pix4d_has_accuracies(tie_points.gcps()) {
        lost.push(
            "Pix4D's list is written without accuracies: it can hold them only where every point has one of its place \
             and one of its height (`sigma_m`, `sigma_height_m`)"
                .into(),
        );
    }
    lost
}

/// Refuses, before any work, what a dialect cannot hold.
///
/// # Errors
/// When OpenDroneMap's list would lack a CRS or have an image name with blanks, at which it is cut; when a point
/// without a height is to go where heights are demanded; when two names are one in a dialect.
pub fn check(outputs: &[Output], image: &Path, crs: Option<&Crs>, gcps: &[Gcp]) -> Result<()> {
    for output in outputs {
        let names = || gcps.iter().map(|gcp| gcp.name.as_str());
        let one_of_two = |format: &ListFormat| names::one_of_two(*format, usize::MAX, names());
        if let Some((place, other, held)) = formats(*output).iter().find_map(one_of_two) {
            return Err(Error::usage(
                format!("`{}` and `{other}` are both `{held}` in the files of --write {output}", gcps[place].name),
                format!("rename one, or leave {output} out of --write"),
            ));
        }
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
                    let program = if *output == Output::MicMac { "MicMac" } else { "Pix4D" };
                    return Err(no_height(program, NoHeight(gcp.name.clone())));
                }
            }
            _ => {}
        }
    }
    Ok(())
}

fn no_height(program: &str, NoHeight(name): NoHeight) -> Error {
    Error::usage(
        format!("{program} needs heights, and `{name}` has none"),
        "complete the list of points, or choose another --write",
    )
}

fn write_file(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).map_err(|e| Error::io(path, "write", e))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(name: &str, output: Output, crs: Option<Crs>) -> String {
        let folder = tempfile::tempdir().expect("a folder");
        let paths = files(output, &folder.path().join("e6.tif"));
        let pair = TiePoint {
            gcp: Gcp {
                height: Some(12.0),
                sigma_m: Some(0.02),
                sigma_height_m: Some(0.09),
                ..Gcp::control(name, 10.7, 59.9)
            },
            pixel: PixelPoint { x: 1.5, y: 2.5 },
            residual_e_m: 0.0,
            residual_n_m: 0.0,
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
            (Output::Csv, ",12,0.02,0.09,"),
        ] {
            let text = written("A", output, None);
            assert!(text.contains(expected), "{text}");
        }
    }

    #[test]
    fn lists_of_one_unit_have_their_accuracies_in_it() {
        let feet = || Some(Crs::from_epsg(2263).expect("US survey feet"));
        let text = written("A", Output::MicMac, feet());
        assert!(text.contains("<Incertitude>0.0656166") && text.contains(" 0.295275"), "{text}");
        let text = written("A", Output::Pix4d, feet());
        assert!(text.contains(",0.0656166") && text.contains(",0.295275"), "{text}");
        let text = written("A", Output::Metashape, feet());
        assert!(text.contains("sx=\"0.02\"") && text.contains("Accuracy_(m)"), "{text}");
    }

    #[test]
    fn pix4d_has_the_latitude_first() {
        let degrees = Crs::from_epsg(4326).expect("WGS 84");
        assert!(written("A", Output::Pix4d, Some(degrees)).starts_with("A,59.9,10.7,12,"));
    }
    #[test]
    fn names_are_such_as_a_row_can_hold() {
        let odm = Crs::from_epsg(25832).expect("UTM");
        let rows = written("A\t\"1\"\nB", Output::GcpList, Some(odm));
        assert_eq!(rows.lines().map(|row| row.split('\t').count()).collect::<Vec<_>>(), [1, 7], "{rows}");
        assert!(rows.ends_with("\tA '1' B\n"), "{rows}");
    }

    #[test]
    fn two_names_that_are_one_in_a_row_are_refused() {
        let list = [Gcp::control("A\tB", 1.0, 2.0), Gcp::control("A B", 3.0, 4.0)];
        let crs = Crs::from_epsg(25832).expect("UTM");
        let checked = |output| check(&[output], Path::new("e6.tif"), Some(&crs), &list).map_err(|e| e.to_string());
        assert!(checked(Output::GcpList).is_err_and(|said| said.contains("both `A B`")));
        assert_eq!(checked(Output::GeoJson), Ok(()));
    }

    #[test]
    fn accuracies_that_pix4d_cannot_hold_are_said_to_be_lost() {
        let pair = |sigma_height_m| TiePoint {
            gcp: Gcp { sigma_m: Some(0.02), sigma_height_m, ..Gcp::control("A", 1.0, 2.0) },
            pixel: PixelPoint { x: 1.5, y: 2.5 },
            residual_e_m: 0.0,
            residual_n_m: 0.0,
        };
        let points =
            |pairs| TiePoints { image_name: "e6.tif".into(), image_size_px: None, crs: None, pairs, transform: None };
        assert!(lost(Output::Pix4d, &points(vec![pair(Some(0.05))])).is_empty());
        let some = points(vec![pair(Some(0.05)), pair(None)]);
        assert!(lost(Output::Pix4d, &some)[0].contains("sigma_height_m"));
        assert!(lost(Output::Metashape, &some).is_empty());
    }
}
