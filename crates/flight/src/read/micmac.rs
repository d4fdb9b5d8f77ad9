//! MicMac's cameras, orientations and measurements, of v1 (`mm3d`) and of MMVII.
//!
//! Source: `include/XML_GEN/ParamChantierPhotogram.xml` and the sources of MicMac; pixels are taken as MicMac counts
//! them.

mod calibration;
mod models;
mod rotation;

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};

use self::calibration::Calibration;
use super::affinity::Affinity;
use super::model::{Photograph, Reconstruction};
use crate::camera::Camera;
use crate::error::{Error, Result, read_text};
use crate::pose::Pose;
use crate::xml::{Element, numbers};

/// An orientation as MicMac wrote it, with the pairs by which it lets readers check themselves.
#[derive(Clone, Debug)]
pub struct Orientation {
    pub pose: Pose,
    /// The camera's file as it is named there.
    pub camera_file: Option<String>,
    /// The image that MMVII names in the file.
    pub image: Option<String>,
    /// A camera written inside the orientation, in the plane of its calibration.
    pub camera: Option<Camera>,
    /// Point on the ground and its place in the plane of its calibration: pixels, of scanned film millimetres.
    pub checks: Vec<([f64; 3], [f64; 2])>,
    pub tolerance_px: f64,
    /// What `camera` is beside its values, and from its plane to pixels.
    inside: Option<Calibration>,
    to_pixels: Affinity,
}

/// Whether a folder holds orientations.
pub fn is_orientation_folder(path: &Path) -> bool {
    !orientation_files(path).is_empty()
}

fn orientation_files(folder: &Path) -> Vec<(PathBuf, String)> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut files: Vec<(PathBuf, String)> = entries
        .flatten()
        .filter_map(|e| {
            let name = e.file_name().to_string_lossy().into_owned();
            let stem = name.strip_suffix(".xml")?;
            let image = stem
                .strip_prefix("Orientation-")
                .or_else(|| stem.strip_prefix("Ori-PerspCentral-"))
                .filter(|s| !s.is_empty())?;
            Some((e.path(), image.to_string()))
        })
        .collect();
    files.sort();
    files
}

/// Whether a file is called like an orientation.
pub fn is_orientation_name(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    name.starts_with("Orientation-") || name.starts_with("Ori-PerspCentral-")
}

/// All orientations of a folder with their cameras. Ties are not in such files.
///
/// # Errors
/// When a file is broken or names a camera that is not there.
pub fn read_orientations(folder: &Path) -> Result<Reconstruction> {
    let mut all = Reconstruction::default();
    // Of one file there are as many cameras as ways from its plane to pixels.
    let mut known: Vec<(PathBuf, Affinity, usize)> = Vec::new();
    for (file, image) in orientation_files(folder) {
        let orientation = read_orientation(&file)?;
        let place = camera_place(&file, &orientation)?;
        let seen = known.iter().find(|(at, by, _)| place.as_ref() == Some(at) && *by == orientation.to_pixels);
        let camera = match seen {
            Some((_, _, camera)) => *camera,
            None => {
                all.cameras.push(camera_in_pixels(&file, &orientation, place.as_deref())?);
                let camera = all.cameras.len() - 1;
                known.extend(place.map(|at| (at, orientation.to_pixels, camera)));
                camera
            }
        };
        let name = orientation.image.unwrap_or(image);
        all.photographs.push(Photograph { name, camera, pose: orientation.pose });
    }
    if all.photographs.is_empty() {
        return Err(Error::format(folder, "the folder", "there is no Orientation-*.xml and no Ori-PerspCentral-*.xml"));
    }
    Ok(all)
}

/// Where the camera of an orientation lies, unless it is written inside.
fn camera_place(file: &Path, orientation: &Orientation) -> Result<Option<PathBuf>> {
    match (&orientation.inside, &orientation.camera_file) {
        (Some(_), _) => Ok(None),
        (None, Some(name)) => find_camera(file, name).map(Some),
        (None, None) => Err(Error::format(file, "<FileInterne>", "no camera is named")),
    }
}

/// The camera of an orientation in pixels of its image; `place` is that of its file.
fn camera_in_pixels(file: &Path, orientation: &Orientation, place: Option<&Path>) -> Result<Camera> {
    let calibration = match (place, &orientation.inside) {
        (Some(at), _) => calibration::read(at)?,
        (None, Some(inside)) => inside.clone(),
        (None, None) => return Err(Error::format(file, "<FileInterne>", "no camera is named")),
    };
    if calibration.on_film && orientation.to_pixels == Affinity::IDENTITY {
        return Err(on_film(file));
    }
    calibration.scanned(file, &orientation.to_pixels)
}

/// Millimetres of which nothing says what pixels they are.
fn on_film(path: &Path) -> Error {
    let what =
        "counts in millimetres of film; an orientation has its pixels: give an Orientation-*.xml with <OrIntImaM2C>";
    Error::format(path, "<ScannedAnalogik>", what)
}

/// The camera's file: as named, then below the orientation's parent, then beside the orientation.
fn find_camera(orientation: &Path, name: &str) -> Result<PathBuf> {
    let folder = orientation.parent().unwrap_or(Path::new("."));
    let base = Path::new(name).file_name().map(PathBuf::from).unwrap_or_default();
    let with_xml = format!("{name}.xml");
    let candidates = [
        folder.join(&base),
        folder.join(&with_xml),
        folder.join(name),
        folder.join("..").join(name),
        PathBuf::from(name),
    ];
    candidates.iter().find(|p| p.is_file()).cloned().ok_or_else(|| {
        Error::format(
            orientation,
            "<FileInterne>",
            format!("the camera `{name}` is not beside the file; copy it there"),
        )
    })
}

/// Reads `Orientation-IMAGE.xml` (v1) or `Ori-PerspCentral-IMAGE.xml` (MMVII).
///
/// # Errors
/// When the XML is broken or has no pose.
pub fn read_orientation(path: &Path) -> Result<Orientation> {
    let root = Element::read(path)?;
    if let Some(pose) = root.find("CameraPose") {
        return mmvii_orientation(path, pose);
    }
    let conic = root
        .find("OrientationConique")
        .ok_or_else(|| Error::format(path, "the root", "there is neither <OrientationConique> nor <CameraPose>"))?;
    let outer =
        conic.find("Externe").ok_or_else(|| Error::format(path, "<OrientationConique>", "there is no <Externe>"))?;
    if let Some(kind) = conic.find("TypeProj").filter(|t| t.word() != "eProjStenope") {
        return Err(Error::format(
            path,
            "<TypeProj>",
            format!("`{}` is no perspective; orient the images as eProjStenope", kind.word()),
        ));
    }
    let to_world = rotation::to_world(path, conic, outer)?;
    let centre = Vector3::from(numbers::<3>(path, outer, "Centre")?);
    let mut pairs = Vec::new();
    let mut checks = Vec::new();
    if let Some(verify) = conic.find("Verif") {
        verify.all("Appuis", &mut pairs);
        verify.all("Mesures", &mut pairs);
        for pair in pairs {
            checks.push((numbers::<3>(path, pair, "Ter")?, numbers::<2>(path, pair, "Im")?));
        }
    }
    let tolerance_px =
        conic.find("Verif").and_then(|v| v.find("Tol")).and_then(Element::numbers).and_then(|n| n.first().copied());
    let inside = conic.find("Interne").map(|inner| calibration::v1_camera(path, inner)).transpose()?;
    let to_pixels = conic.find("OrIntImaM2C").map(|affinity| Affinity::read(path, affinity)).transpose()?;
    Ok(Orientation {
        pose: Pose { rotation: to_world.transpose(), centre },
        camera_file: conic.find("FileInterne").map(|f| f.word().to_string()),
        image: None,
        camera: inside.as_ref().map(|c| c.alone(path)).transpose()?,
        checks,
        tolerance_px: tolerance_px.unwrap_or(1e-3),
        inside,
        to_pixels: to_pixels.unwrap_or(Affinity::IDENTITY),
    })
}

fn mmvii_orientation(path: &Path, pose: &Element) -> Result<Orientation> {
    let matrix =
        pose.find("RotMatrix").ok_or_else(|| Error::format(path, "<CameraPose>", "there is no <RotMatrix>"))?;
    // The axes of the camera in the world: the columns of camera → world.
    let axes = [numbers::<3>(path, matrix, "AxeI")?, numbers(path, matrix, "AxeJ")?, numbers(path, matrix, "AxeK")?];
    let to_world = Matrix3::from_fn(|r, c| axes[c][r]);
    Ok(Orientation {
        pose: Pose {
            rotation: rotation::proper(path, to_world)?.transpose(),
            centre: Vector3::from(numbers::<3>(path, pose, "Center")?),
        },
        camera_file: pose.find("NameInternalCalib").map(|n| format!("{}.xml", n.word())),
        image: pose.find("NameImage").map(|n| n.word().to_string()),
        camera: None,
        checks: Vec::new(),
        tolerance_px: 1e-3,
        inside: None,
        to_pixels: Affinity::IDENTITY,
    })
}

/// Reads `AutoCal*.xml`, `Calib*.xml` (v1) or `Calib-PerspCentral-*.xml` (MMVII), in the plane that the file counts in:
/// pixels, where `<OrIntGlob>` leads to them; of scanned film millimetres.
///
/// # Errors
/// When the XML is broken, or holds a model of distortion that is not read.
pub fn read_camera(path: &Path) -> Result<Camera> {
    calibration::read(path)?.alone(path)
}

/// The camera of a file in pixels: a calibration's, or that which an orientation has or names.
///
/// # Errors
/// Those of [`read_camera`] and [`read_orientation`]; a calibration of film alone, whose pixels are not known.
pub fn read_camera_in_pixels(path: &Path) -> Result<Camera> {
    let root = Element::read(path)?;
    if root.find("OrientationConique").is_some() || root.find("CameraPose").is_some() {
        let orientation = read_orientation(path)?;
        return camera_in_pixels(path, &orientation, camera_place(path, &orientation)?.as_deref());
    }
    let calibration = calibration::read(path)?;
    if calibration.on_film { Err(on_film(path)) } else { calibration.alone(path) }
}

/// A point on the ground: name, place, 1σ of x, y, z where the file has them.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundPoint {
    pub name: String,
    pub xyz: [f64; 3],
    pub sigma: Option<[f64; 3]>,
}

/// Points on the ground: `DicoAppuisFlottant` (v1) or `SetGCP` (MMVII).
///
/// # Errors
/// When the XML is broken or holds no points.
pub fn read_ground_points(path: &Path) -> Result<Vec<GroundPoint>> {
    let root = Element::read(path)?;
    let mut points = Vec::new();
    let mut elements = Vec::new();
    if let Some(set) = root.find("SetGCP") {
        if let Some(measures) = set.find("Measures") {
            elements.extend(measures.children.iter().filter(|c| c.name == "el"));
        }
        for e in elements {
            // Variances: MMVII calls them by either name.
            let variances = e.find("__Opt__Sigma2").or_else(|| e.find("Sigma2"));
            let sigma = variances.and_then(Element::numbers).filter(|n| n.len() == 6);
            points.push(GroundPoint {
                name: e.find("Name").map_or("", Element::word).to_string(),
                xyz: numbers(path, e, "Pt")?,
                sigma: sigma.map(|s| [s[0].sqrt(), s[3].sqrt(), s[5].sqrt()]),
            });
        }
    } else {
        root.all("OneAppuisDAF", &mut elements);
        for e in elements {
            let sigma = e.find("Incertitude").and_then(Element::numbers).and_then(|n| <[f64; 3]>::try_from(n).ok());
            points.push(GroundPoint {
                name: e.find("NamePt").map_or("", Element::word).to_string(),
                xyz: numbers(path, e, "Pt")?,
                sigma,
            });
        }
    }
    if points.is_empty() {
        return Err(Error::format(path, "the file", "there is no <OneAppuisDAF> and no <SetGCP>"));
    }
    Ok(points)
}

/// Points measured in images: `SetOfMesureAppuisFlottants` (v1) or `SetMesIm` (MMVII): image, point, pixel.
///
/// # Errors
/// When the XML is broken or holds no measurements.
pub fn read_image_points(path: &Path) -> Result<Vec<(String, String, [f64; 2])>> {
    let root = Element::read(path)?;
    let mut all = Vec::new();
    let mut images = Vec::new();
    root.all("MesureAppuiFlottant1Im", &mut images);
    for image in images {
        let name = image.find("NameIm").map_or("", Element::word);
        let mut points = Vec::new();
        image.all("OneMesureAF1I", &mut points);
        for p in points {
            let label = p.find("NamePt").map_or("", Element::word);
            all.push((name.to_string(), label.to_string(), numbers(path, p, "PtIm")?));
        }
    }
    let mut sets = Vec::new();
    root.all("SetMesIm", &mut sets);
    for set in sets {
        let name = set.find("NameIm").map_or("", Element::word);
        for p in set.find("Measures").iter().flat_map(|m| m.children.iter().filter(|c| c.name == "el")) {
            let label = p.find("Name").map_or("", Element::word);
            all.push((name.to_string(), label.to_string(), numbers(path, p, "Pt")?));
        }
    }
    if all.is_empty() {
        return Err(Error::format(path, "the file", "there is no <MesureAppuiFlottant1Im> and no <SetMesIm>"));
    }
    Ok(all)
}

/// Whether XML holds points measured in images.
pub fn has_image_points(path: &Path) -> bool {
    read_text(path).is_ok_and(|t| t.contains("<MesureAppuiFlottant1Im>") || t.contains("<SetMesIm>"))
}
