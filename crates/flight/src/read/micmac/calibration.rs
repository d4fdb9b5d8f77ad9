//! MicMac's calibrations: `AutoCal*.xml` and the like of v1, `Calib-PerspCentral-*.xml` of MMVII.

use std::path::Path;

use super::super::affinity::{Affinity, Axes, SizeIn};
use super::models::{self, Frame, Model, Radial};
use crate::camera::{Camera, Parameter, Projection};
use crate::error::{Error, Result};
use crate::plane::{HIGHEST_POWER, PlaneMap, Polynomial};
use crate::xml::{Element, numbers};

/// A camera as its file has it.
#[derive(Clone, Debug)]
pub(super) struct Calibration {
    /// In the plane of `<F>` and `<PP>`.
    pub camera: Camera,
    /// Size and places count in millimetres of film until an orientation says which pixels they are.
    pub on_film: bool,
    /// From that plane to pixels, as `<OrIntGlob>` has it.
    pub to_pixels: Option<Affinity>,
}

impl Calibration {
    fn of_pixels(camera: Camera) -> Self {
        Calibration { camera, on_film: false, to_pixels: None }
    }

    /// The camera as the file alone has it: in pixels, or in millimetres of film.
    pub fn alone(&self, path: &Path) -> Result<Camera> {
        match self.to_pixels {
            Some(affinity) => affinity.to_pixels(path, "OrIntGlob", &self.camera, SizeIn::Pixels, Axes::Image),
            None => Ok(self.camera.clone()),
        }
    }

    /// The camera of an orientation that has `scan` from the plane on.
    pub fn scanned(&self, path: &Path, scan: &Affinity) -> Result<Camera> {
        let (all, size) = match &self.to_pixels {
            Some(global) => (scan.then(global), SizeIn::Pixels),
            None => (*scan, SizeIn::Plane),
        };
        all.to_pixels(path, "OrIntImaM2C", &self.camera, size, Axes::Plane)
    }
}

/// Reads a calibration of either form.
///
/// # Errors
/// When the XML is broken or holds what no camera here is.
pub(super) fn read(path: &Path) -> Result<Calibration> {
    let root = Element::read(path)?;
    if let Some(inner) = root.find("InternalCalibration") {
        return Ok(Calibration::of_pixels(mmvii_camera(path, inner)?));
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

fn is_true(element: &Element, name: &str) -> bool {
    element.find(name).is_some_and(|e| matches!(e.word(), "true" | "1"))
}

/// Which way a distortion is stated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stated {
    /// From the ideal plane to the image: MicMac's M2C.
    ToImage,
    /// From the image to the ideal plane: C2M.
    FromImage,
}

/// Reads `CalibrationInternConique`.
///
/// # Errors
/// When it holds what no camera here is.
pub(super) fn v1_camera(path: &Path, inner: &Element) -> Result<Calibration> {
    let f = one(path, inner, "F")?;
    let pp = numbers::<2>(path, inner, "PP")?;
    let size = numbers::<2>(path, inner, "SzIm")?;
    if f <= 0.0 || size.iter().any(|s| *s <= 0.0) {
        return Err(Error::format(path, "<F>, <SzIm>", "focal length and size must be positive"));
    }
    refuse_unread(path, inner)?;
    let mut camera = Camera::pinhole(stem(path), size, f, pp);
    distort(path, inner, &mut camera)?;
    let Some(global) = inner.find("OrIntGlob") else {
        return Ok(Calibration { camera, on_film: is_true(inner, "ScannedAnalogik"), to_pixels: None });
    };
    let stated = Affinity::read(path, global)?;
    let to_pixels = if is_true(global, "C2M") { stated.inverse() } else { Some(stated) };
    let to_pixels = to_pixels.ok_or_else(|| Error::format(path, "<OrIntGlob>", "its two axes are one; correct it"))?;
    Ok(Calibration { camera, on_film: false, to_pixels: Some(to_pixels) })
}

/// What moves pixels in MicMac and has no place in a camera here.
fn refuse_unread(path: &Path, inner: &Element) -> Result<()> {
    let mut entrance = Vec::new();
    inner.all("ParamAF", &mut entrance);
    if entrance.iter().any(|e| e.numbers().is_none_or(|n| n.iter().any(|v| *v != 0.0))) {
        let what = "a centre of projection that moves with the direction is not read; calibrate without it";
        return Err(Error::format(path, "<ParamAF>", what));
    }
    if inner.find("CorrectionRefractionAPosteriori").is_some() {
        let what = "a refraction after the lens is not read; calibrate under water without it";
        return Err(Error::format(path, "<CorrectionRefractionAPosteriori>", what));
    }
    Ok(())
}

/// Puts the chain of distortions into the camera. The last of the list is applied first; the first radial model that
/// is applied becomes the lens's terms, which can be adjusted, and all others maps before and behind it.
fn distort(path: &Path, inner: &Element, camera: &mut Camera) -> Result<()> {
    let sense = stated(path, inner)?;
    let distortions: Vec<&Element> = inner.children.iter().filter(|c| c.name == "CalibDistortion").collect();
    let senses: Vec<&Element> = inner.children.iter().filter(|c| c.name == "ComplIsC2M").collect();
    let frame = Frame { f: camera.f_px(), pp: camera.pp_px(), size: camera.size_px };
    let mut lens = None;
    for (i, distortion) in distortions.iter().enumerate().rev() {
        let of_its_own = senses.get(i).filter(|_| i + 1 < distortions.len());
        let sense = match of_its_own.map(|s| s.word()) {
            Some("true" | "1") => Some(Stated::FromImage),
            Some(_) => Some(Stated::ToImage),
            None => sense,
        };
        for element in &distortion.children {
            let model = v1_model(path, element, frame)?;
            if model.moves_nothing() {
                continue;
            }
            let sense = sense.ok_or_else(|| {
                let what = "there is none, and MicMac's programs take its distortion either way; add \
                            <KnownConv>eConvApero_DistM2C</KnownConv> if it goes from the plane to the image, as \
                            calibrations of MicMac's do";
                Error::format(path, "<KnownConv>", what)
            })?;
            match model {
                Model::Radial(radial)
                    if lens.is_none() && sense == Stated::ToImage && radial.coefficients.len() <= RADIAL.len() =>
                {
                    set_lens(camera, &radial);
                    lens = Some(i);
                }
                other => {
                    let maps = if lens.is_none() { &mut camera.before } else { &mut camera.after };
                    maps.extend(plane_maps(path, element, other, sense, frame)?);
                }
            }
        }
    }
    Ok(())
}

/// The sense of all distortions, where it is stated.
fn stated(path: &Path, inner: &Element) -> Result<Option<Stated>> {
    let Some(convention) = inner.child("KnownConv") else { return Ok(None) };
    match convention.word() {
        "eConvApero_DistC2M" => Ok(Some(Stated::FromImage)),
        "eConvApero_DistM2C"
        | "eConvOriLib"
        | "eConvAngErdas"
        | "eConvAngErdas_Grade"
        | "eConvAngPhotoMDegre"
        | "eConvAngPhotoMGrade"
        | "eConvAngLPSDegre"
        | "eConvMatrixInpho" => Ok(Some(Stated::ToImage)),
        other => {
            let what =
                format!("`{other}` is not read in a calibration; write eConvApero_DistM2C or eConvApero_DistC2M");
            Err(Error::format(path, "<KnownConv>", what))
        }
    }
}

const RADIAL: [Parameter; 6] = {
    use Parameter::{K1, K2, K3, K4, K5, K6};
    [K1, K2, K3, K4, K5, K6]
};

fn set_lens(camera: &mut Camera, radial: &Radial) {
    use Parameter::{B1, B2, Dx, Dy, P1, P2};
    let (f, pp) = (camera.f_px(), camera.pp_px());
    let off = [0, 1].map(|k| (radial.centre[k] - pp[k]) / f);
    camera.set(Dx, off[0]).set(Dy, off[1]);
    for (k, (slot, value)) in (1..).zip(RADIAL.iter().zip(&radial.coefficients)) {
        camera.set(*slot, value * f.powi(2 * k));
    }
    // MicMac's P1 belongs to x: OpenCV's p2.
    camera.set(P2, radial.decentric[0] * f).set(P1, radial.decentric[1] * f);
    camera.set(B1, radial.affine[0]).set(B2, radial.affine[1]);
}

fn plane_maps(path: &Path, element: &Element, model: Model, sense: Stated, frame: Frame) -> Result<Vec<PlaneMap>> {
    let stated = |polynomial: Polynomial| match sense {
        Stated::ToImage => PlaneMap::Polynomial(polynomial),
        Stated::FromImage => PlaneMap::Undo(polynomial),
    };
    Ok(match model {
        Model::None => Vec::new(),
        Model::Radial(radial) => {
            if 2 * radial.coefficients.len() + 1 > HIGHEST_POWER {
                let what =
                    format!("more than {} <CoeffDist> are not read; calibrate with RadialStd", HIGHEST_POWER / 2);
                return Err(Error::format(path, format!("<{}>", element.name), what));
            }
            vec![stated(radial.polynomial(frame.f))]
        }
        Model::Polynomial(polynomial) => vec![stated(polynomial)],
        Model::Fisheye(fisheye, polynomial) if sense == Stated::ToImage => {
            vec![PlaneMap::Fisheye(fisheye), PlaneMap::Polynomial(polynomial)]
        }
        Model::Fisheye(..) => {
            let what = "a fisheye from the image to the plane is not read; write it with eConvApero_DistM2C";
            return Err(Error::format(path, "<KnownConv>", what));
        }
    })
}

fn v1_model(path: &Path, model: &Element, frame: Frame) -> Result<Model> {
    match model.name.as_str() {
        "ModNoDist" => Ok(Model::None),
        "ModUnif" => models::read(path, model, frame),
        "ModRad" | "ModPhgrStd" => {
            // The flag has the principal point for the centre, whatever else is written.
            let own_centre = model.find("CDist").is_some() && !is_true(model, "PPaEqPPs");
            let centre = if own_centre { numbers::<2>(path, model, "CDist")? } else { frame.pp };
            let mut terms = Vec::new();
            model.all("CoeffDist", &mut terms);
            let numbers: Option<Vec<f64>> =
                terms.iter().map(|t| t.numbers().filter(|n| n.len() == 1).map(|n| n[0])).collect();
            let Some(mut coefficients) = numbers else {
                return Err(Error::format(path, format!("<{}>", model.name), "a <CoeffDist> is no number"));
            };
            while coefficients.last() == Some(&0.0) {
                coefficients.pop();
            }
            let decentric = [optional(path, model, "P1")?, optional(path, model, "P2")?];
            let affine = [optional(path, model, "b1")?, optional(path, model, "b2")?];
            Ok(Model::Radial(Radial { centre, coefficients, decentric, affine }))
        }
        _ => {
            let what = "this model of distortion is not read; calibrate with FraserBasic or RadialStd";
            Err(Error::format(path, format!("<{}>", model.name), what))
        }
    }
}

/// MMVII's camera. Its distortion is one sum of radial, decentric and polynomial terms about the principal point, in
/// units of the focal length (`MMVII/src/SymbDerGen/Formulas_CamStenope.h`).
fn mmvii_camera(path: &Path, inner: &Element) -> Result<Camera> {
    let size = numbers::<2>(path, inner, "NbPix")?;
    let perfect =
        inner.find("PerfectProj").ok_or_else(|| Error::format(path, "<InternalCalibration>", "no <PerfectProj>"))?;
    let (f, pp) = (one(path, perfect, "F")?, numbers::<2>(path, perfect, "PP")?);
    if f <= 0.0 || size.iter().any(|s| *s <= 0.0) {
        return Err(Error::format(path, "<F>, <NbPix>", "focal length and size must be positive"));
    }
    let name = inner.find("Name").map_or_else(|| stem(path), |n| n.word().to_string());
    let mut camera = Camera::pinhole(name, size, f, pp);
    camera.projection = match inner.find("Projection").map_or("Stenope", Element::word) {
        "Stenope" => Projection::Perspective,
        "FE_EquiDist" => Projection::Fisheye,
        "FE_EquiSolid" => Projection::Equisolid,
        // So MMVII spells it.
        "StereroGraphik" => Projection::Stereographic,
        "OrthoGraphik" => Projection::Orthographic,
        "EquiRect" => Projection::Equirectangular,
        other => {
            let what = format!("`{other}` is not read; calibrate with one of MMVII's central projections");
            return Err(Error::format(path, "<Projection>", what));
        }
    };
    let Some(distortion) = inner.find("Distorsion") else { return Ok(camera) };
    let mut terms = Vec::new();
    for term in distortion.children.iter().flat_map(|group| &group.children) {
        let value = term.numbers().and_then(|n| <[f64; 1]>::try_from(n).ok());
        let [value] = value.ok_or_else(|| Error::format(path, format!("<{}>", term.name), "is no number"))?;
        if value != 0.0 {
            terms.push((term.name.as_str(), value));
        }
    }
    if terms.iter().all(|(name, _)| mmvii_slot(name).is_some()) {
        for (slot, value) in terms.iter().filter_map(|(name, value)| Some((mmvii_slot(name)?, value))) {
            camera.set(slot, *value);
        }
        return Ok(camera);
    }
    let mut all = Polynomial::new(pp, f);
    for (name, value) in terms {
        add_mmvii(&mut all, name, value).ok_or_else(|| {
            let what = "this term of distortion is not read; calibrate with fewer degrees";
            Error::format(path, format!("<{name}>"), what)
        })?;
    }
    camera.before.push(PlaneMap::Polynomial(all));
    Ok(camera)
}

/// The lens's parameter that a term of MMVII is.
fn mmvii_slot(name: &str) -> Option<Parameter> {
    use Parameter::{B1, B2, K1, K2, K3, K4, K5, K6, P1, P2};
    Some(match name {
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
        _ => return None,
    })
}

/// A term of MMVII by its name; `None` where it is not known, or of a power that is not held.
fn add_mmvii(all: &mut Polynomial, name: &str, value: f64) -> Option<()> {
    let number = |text: &str, most: usize| text.parse().ok().filter(|n| (1..=most).contains(n));
    match name {
        "b1" | "a" => all.add([1, 0], [value, 0.0]),
        "b2" => all.add([0, 1], [value, 0.0]),
        "b" => all.add([1, 0], [0.0, value]),
        _ => match name.split_at_checked(1)? {
            ("K", n) => {
                let mut coefficients = vec![0.0; number(n, HIGHEST_POWER / 2)?];
                *coefficients.last_mut()? = value;
                all.add_radial(&coefficients)
            }
            // p1, p3, … are of a centre displaced in x, p2, p4, … in y.
            ("p", n) => {
                let n = number(n, HIGHEST_POWER - 1)?;
                let mut pairs = vec![[0.0; 2]; n.div_ceil(2)];
                pairs.last_mut()?[(n + 1) % 2] = value;
                all.add_decentric(&pairs)
            }
            (axis @ ("x" | "y"), powers) => {
                let (i, j) = powers.strip_prefix('_')?.split_once('_')?;
                let powers = [i.parse().ok()?, j.parse().ok()?];
                let held = powers.iter().all(|p: &u8| usize::from(*p) <= HIGHEST_POWER);
                let adds = if axis == "x" { [value, 0.0] } else { [0.0, value] };
                held.then(|| all.add(powers, adds))?
            }
            _ => return None,
        },
    };
    Some(())
}
