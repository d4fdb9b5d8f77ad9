//! MicMac's cameras, orientations and measurements, of v1 (`mm3d`) and of MMVII.
//!
//! Source: `include/XML_GEN/ParamChantierPhotogram.xml` and the sources of MicMac; pixels are taken as MicMac counts
//! them.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};

use super::affinity::{Affinity, SizeIn};
use super::{Photograph, Reconstruction};
use crate::camera::{Camera, Parameter, PixelPolynomial};
use crate::error::{Error, Result, read_text};
use crate::pose::{Pose, orthonormal};
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

/// A camera as its file has it.
#[derive(Clone, Debug)]
struct Calibration {
    camera: Camera,
    /// Size and places count in millimetres of film until an orientation says which pixels they are.
    on_film: bool,
    /// `<OrIntGlob>` turns an axis of the image over.
    mirrored: bool,
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
    const AFFINITY: &str = "OrIntImaM2C";
    let calibration = match (place, &orientation.inside) {
        (Some(at), _) => read_calibration(at)?,
        (None, Some(inside)) => inside.clone(),
        (None, None) => return Err(Error::format(file, "<FileInterne>", "no camera is named")),
    };
    let by = orientation.to_pixels;
    if calibration.mirrored || by.mirrors() {
        let (at, element) = if by.mirrors() { (file, AFFINITY) } else { (place.unwrap_or(file), "OrIntGlob") };
        let what = "turns the image over against the axes that the rotation is of; orient with images as they are seen";
        return Err(Error::format(at, format!("<{element}>"), what));
    }
    if calibration.on_film && by == Affinity::IDENTITY {
        return Err(on_film(file));
    }
    by.to_pixels(file, AFFINITY, &calibration.camera, SizeIn::Plane)
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
            format!("`{}` is not a perspective; not supported", kind.word()),
        ));
    }
    let convention = outer.find("KnownConv").map_or("eConvApero_DistM2C", Element::word);
    if !matches!(convention, "eConvApero_DistM2C" | "eConvApero_DistC2M") {
        return Err(Error::format(path, "<KnownConv>", format!("`{convention}` is not supported")));
    }
    let rows: Vec<[f64; 3]> = ["L1", "L2", "L3"]
        .iter()
        .map(|l| {
            let rotation = outer
                .find("ParamRotation")
                .ok_or_else(|| Error::format(path, "<Externe>", "there is no <ParamRotation>"))?;
            if rotation.find("CodageAngulaire").is_some() {
                let what = "angles are not read; write the rotation as <CodageMatr> with its rows <L1>, <L2>, <L3>, as \
                            MicMac's commands write it";
                return Err(Error::format(path, "<CodageAngulaire>", what));
            }
            numbers::<3>(path, rotation, l)
        })
        .collect::<Result<_>>()?;
    // The file holds camera → world.
    let to_world = Matrix3::from_fn(|r, c| rows[r][c]);
    let centre = Vector3::from(numbers::<3>(path, outer, "Centre")?);
    let mut pairs = Vec::new();
    let mut checks = Vec::new();
    if let Some(verify) = conic.find("Verif") {
        verify.all("Appuis", &mut pairs);
        for pair in pairs {
            checks.push((numbers::<3>(path, pair, "Ter")?, numbers::<2>(path, pair, "Im")?));
        }
    }
    let tolerance_px =
        conic.find("Verif").and_then(|v| v.find("Tol")).and_then(Element::numbers).and_then(|n| n.first().copied());
    let inside = conic.find("Interne").map(|inner| v1_camera(path, inner)).transpose()?;
    let to_pixels = conic.find("OrIntImaM2C").map(|affinity| Affinity::read(path, affinity)).transpose()?;
    Ok(Orientation {
        pose: Pose { rotation: rotation(path, to_world)?.transpose(), centre },
        camera_file: conic.find("FileInterne").map(|f| f.word().to_string()),
        image: None,
        camera: inside.as_ref().map(|c| c.camera.clone()),
        checks,
        tolerance_px: tolerance_px.unwrap_or(1e-3),
        inside,
        to_pixels: to_pixels.unwrap_or(Affinity::IDENTITY),
    })
}

fn rotation(path: &Path, m: Matrix3<f64>) -> Result<Matrix3<f64>> {
    let tidy = orthonormal(&m);
    if (tidy - m).norm() > 1e-4 {
        return Err(Error::format(path, "the rotation", "its rows are not orthogonal unit vectors"));
    }
    Ok(tidy)
}

fn mmvii_orientation(path: &Path, pose: &Element) -> Result<Orientation> {
    let matrix =
        pose.find("RotMatrix").ok_or_else(|| Error::format(path, "<CameraPose>", "there is no <RotMatrix>"))?;
    // The axes of the camera in the world: the columns of camera → world.
    let axes = [numbers::<3>(path, matrix, "AxeI")?, numbers(path, matrix, "AxeJ")?, numbers(path, matrix, "AxeK")?];
    let to_world = Matrix3::from_fn(|r, c| axes[c][r]);
    Ok(Orientation {
        pose: Pose {
            rotation: rotation(path, to_world)?.transpose(),
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
/// When the XML is broken, holds a model of distortion that is not read, or an affinity that no camera holds.
pub fn read_camera(path: &Path) -> Result<Camera> {
    Ok(read_calibration(path)?.camera)
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
    let calibration = read_calibration(path)?;
    if calibration.on_film { Err(on_film(path)) } else { Ok(calibration.camera) }
}

fn read_calibration(path: &Path) -> Result<Calibration> {
    let root = Element::read(path)?;
    if let Some(inner) = root.find("InternalCalibration") {
        return Ok(Calibration { camera: mmvii_camera(path, inner)?, on_film: false, mirrored: false });
    }
    let inner = root.find("CalibrationInternConique").ok_or_else(|| {
        Error::format(path, "the root", "there is neither <CalibrationInternConique> nor <InternalCalibration>")
    })?;
    v1_camera(path, inner)
}

fn one(path: &Path, parent: &Element, name: &str) -> Result<f64> {
    Ok(numbers::<1>(path, parent, name)?[0])
}

fn optional(path: &Path, parent: &Element, name: &str) -> Result<f64> {
    if parent.find(name).is_some() { one(path, parent, name) } else { Ok(0.0) }
}

fn stem(path: &Path) -> String {
    path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

fn v1_camera(path: &Path, inner: &Element) -> Result<Calibration> {
    let f = one(path, inner, "F")?;
    let pp = numbers::<2>(path, inner, "PP")?;
    let size = numbers::<2>(path, inner, "SzIm")?;
    if f <= 0.0 || size.iter().any(|s| *s <= 0.0) {
        return Err(Error::format(path, "<F>, <SzIm>", "focal length and size must be positive"));
    }
    let mut camera = Camera::pinhole(stem(path), size, f, pp);
    if inner.find("KnownConv").is_some_and(|c| c.word() != "eConvApero_DistM2C") {
        return Err(Error::format(path, "<KnownConv>", "only eConvApero_DistM2C is read"));
    }
    let distortions: Vec<&Element> = inner.children.iter().filter(|c| c.name == "CalibDistortion").collect();
    for (i, distortion) in distortions.iter().enumerate() {
        for model in &distortion.children {
            v1_distortion(path, &mut camera, model, i)?;
        }
    }
    let is_true = |element: &Element, name: &str| element.find(name).is_some_and(|e| matches!(e.word(), "true" | "1"));
    let Some(global) = inner.find("OrIntGlob") else {
        return Ok(Calibration { camera, on_film: is_true(inner, "ScannedAnalogik"), mirrored: false });
    };
    let stated = Affinity::read(path, global)?;
    let to_pixels = if is_true(global, "C2M") { stated.inverse() } else { Some(stated) };
    let to_pixels = to_pixels.ok_or_else(|| Error::format(path, "<OrIntGlob>", "its two axes are one; correct it"))?;
    let camera = to_pixels.to_pixels(path, "OrIntGlob", &camera, SizeIn::Pixels)?;
    Ok(Calibration { camera, on_film: false, mirrored: to_pixels.mirrors() })
}

fn v1_distortion(path: &Path, camera: &mut Camera, model: &Element, index: usize) -> Result<()> {
    let place = format!("<{}>", model.name);
    let refuse = |what: &str| Err(Error::format(path, place.clone(), what));
    match model.name.as_str() {
        "ModNoDist" => Ok(()),
        "ModRad" | "ModPhgrStd" => {
            // The last of the list is applied first: a polynomial after the lens is read, the other way round is not.
            if index > 0 || camera.polynomial.is_some() {
                return refuse("a radial model after another one is not supported");
            }
            let (f, pp) = (camera.f_px(), camera.pp_px());
            let centre = if model.find("CDist").is_some() { numbers::<2>(path, model, "CDist")? } else { pp };
            camera.set(Parameter::Dx, (centre[0] - pp[0]) / f).set(Parameter::Dy, (centre[1] - pp[1]) / f);
            let mut terms = Vec::new();
            model.all("CoeffDist", &mut terms);
            use Parameter::{K1, K2, K3, K4, K5, K6};
            let slots = [K1, K2, K3, K4, K5, K6];
            for (i, term) in terms.iter().enumerate() {
                let Some([value]) = term.numbers().and_then(|n| <[f64; 1]>::try_from(n).ok()) else {
                    return refuse("a <CoeffDist> is no number");
                };
                match slots.get(i) {
                    Some(slot) => {
                        camera.set(*slot, value * f.powi(2 * (i as i32 + 1)));
                    }
                    None if value == 0.0 => {}
                    None => return refuse("more than six radial coefficients are not supported"),
                }
            }
            // MicMac's P1 belongs to x: OpenCV's p2.
            camera.set(Parameter::P2, optional(path, model, "P1")? * f);
            camera.set(Parameter::P1, optional(path, model, "P2")? * f);
            camera.set(Parameter::B1, optional(path, model, "b1")?);
            camera.set(Parameter::B2, optional(path, model, "b2")?);
            Ok(())
        }
        "ModUnif" => {
            let kind = model.find("TypeModele").map_or("", Element::word);
            let list = |name: &str| -> Option<Vec<f64>> {
                let mut elements = Vec::new();
                model.all(name, &mut elements);
                elements.iter().map(|e| e.numbers().filter(|n| n.len() == 1).map(|n| n[0])).collect()
            };
            let (Some(coefficients), Some(states)) = (list("Params"), list("Etats")) else {
                return refuse("a <Params> or <Etats> is no number");
            };
            match (kind.strip_prefix("eModelePolyDeg").and_then(|d| d.parse::<usize>().ok()), states.as_slice()) {
                (Some(degree @ 2..=7), [scale, x, y]) if *scale > 0.0 && camera.polynomial.is_none() => {
                    camera.polynomial =
                        Some(PixelPolynomial { degree, centre_px: [*x, *y], scale_px: *scale, coefficients });
                    Ok(())
                }
                _ if kind.starts_with("eModeleEbner") || kind.starts_with("eModeleDCBrown") || !kind.is_empty() => {
                    refuse(&format!("`{kind}` is not supported; calibrate with FraserBasic or RadialStd"))
                }
                _ => refuse("the model is not named"),
            }
        }
        _ => refuse("this model of distortion is not supported; calibrate with FraserBasic or RadialStd"),
    }
}

fn mmvii_camera(path: &Path, inner: &Element) -> Result<Camera> {
    let size = numbers::<2>(path, inner, "NbPix")?;
    let perfect =
        inner.find("PerfectProj").ok_or_else(|| Error::format(path, "<InternalCalibration>", "no <PerfectProj>"))?;
    let f = one(path, perfect, "F")?;
    if let Some(p) = inner.find("Projection").filter(|p| p.word() != "Stenope") {
        return Err(Error::format(path, "<Projection>", format!("`{}` is not supported", p.word())));
    }
    let name = inner.find("Name").map_or_else(|| stem(path), |n| n.word().to_string());
    let mut camera = Camera::pinhole(name, size, f, numbers::<2>(path, perfect, "PP")?);
    let Some(distortion) = inner.find("Distorsion") else { return Ok(camera) };
    use Parameter::{B1, B2, K1, K2, K3, K4, K5, K6, P1, P2};
    let mut terms = Vec::new();
    for group in &distortion.children {
        terms.extend(group.children.iter());
    }
    for term in terms {
        let slot = match term.name.as_str() {
            "K1" => K1,
            "K2" => K2,
            "K3" => K3,
            "K4" => K4,
            "K5" => K5,
            "K6" => K6,
            // MMVII's p1 is (3x²+y², 2xy).
            "p1" => P2,
            "p2" => P1,
            "b1" => B1,
            "b2" => B2,
            other => {
                if term.numbers().is_some_and(|n| n.iter().all(|v| *v == 0.0)) {
                    continue;
                }
                return Err(Error::format(path, format!("<{other}>"), "this term of distortion is not supported"));
            }
        };
        let value = term.numbers().and_then(|n| <[f64; 1]>::try_from(n).ok());
        let [value] = value.ok_or_else(|| Error::format(path, format!("<{}>", term.name), "is no number"))?;
        camera.set(slot, value);
    }
    Ok(camera)
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
