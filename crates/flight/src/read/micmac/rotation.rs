//! Rotations as MicMac writes them: a matrix, three angles, or letters; of the camera in the world or the other way,
//! with axes as the convention has them.
//!
//! Source: `ConvOri`, `KnownConv` and `RotationVect` of MicMac's `ParamChantierPhotogram.xml`, and what
//! `src/ori_phot/orilib.cpp` makes of them.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::error::{Error, Result};
use crate::pose::orthonormal;
use crate::xml::{Element, numbers};

/// What a matrix takes to what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sense {
    ToWorld,
    ToCamera,
}

/// Whether the first angle turns last, about the axis that stays, or first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    LeftToRight,
    RightToLeft,
}

/// How a rotation is meant.
#[derive(Clone, Debug, PartialEq)]
struct Convention {
    name: String,
    sense: Sense,
    /// Factors of the columns and the rows of camera → world.
    columns: [f64; 3],
    rows: [f64; 3],
    /// The axes of the three angles: 0 is x.
    axes: [usize; 3],
    order: Order,
    /// Radians of a unit; `None` where the convention has matrices only.
    unit: Option<f64>,
}

const DEGREE: f64 = std::f64::consts::PI / 180.0;
const GRADE: f64 = std::f64::consts::PI / 200.0;
/// x right, y up, z backward, as photogrammetry has its cameras.
const UPWARDS: [f64; 3] = [1.0, -1.0, -1.0];

/// The rotation of an orientation, camera → world.
///
/// # Errors
/// When the convention is not known, or what is written is no rotation.
pub(super) fn to_world(path: &Path, conic: &Element, outer: &Element) -> Result<Matrix3<f64>> {
    let stated =
        outer.child("ParamRotation").ok_or_else(|| Error::format(path, "<Externe>", "there is no <ParamRotation>"))?;
    let convention = convention(path, conic, outer)?;
    let mut matrix = if let Some(element) = stated.child("CodageMatr") {
        let rows = [
            numbers::<3>(path, element, "L1")?,
            numbers::<3>(path, element, "L2")?,
            numbers::<3>(path, element, "L3")?,
        ];
        Matrix3::from_fn(|r, c| rows[r][c])
    } else if stated.child("CodageAngulaire").is_some() {
        angles(path, numbers::<3>(path, stated, "CodageAngulaire")?, &convention)?
    } else if let Some(element) = stated.child("CodageSymbolique") {
        letters(element.word()).ok_or_else(|| {
            let what = format!("`{}` names no axes; three of i, j, k with or without - are expected", element.word());
            Error::format(path, "<CodageSymbolique>", what)
        })?
    } else {
        let what = "there is no <CodageMatr>, <CodageAngulaire> or <CodageSymbolique>";
        return Err(Error::format(path, "<ParamRotation>", what));
    };
    matrix = proper(path, matrix)?;
    if convention.sense == Sense::ToCamera {
        matrix = matrix.transpose();
    }
    proper(path, Matrix3::from_fn(|r, c| matrix[(r, c)] * convention.rows[r] * convention.columns[c]))
}

/// The rotation that a matrix is but for its digits.
///
/// # Errors
/// When it is none.
pub(super) fn proper(path: &Path, matrix: Matrix3<f64>) -> Result<Matrix3<f64>> {
    if (matrix * matrix.transpose() - Matrix3::identity()).norm() > 2e-4 {
        return Err(Error::format(path, "the rotation", "its rows are not orthogonal unit vectors"));
    }
    if matrix.determinant() < 0.0 {
        return Err(Error::format(path, "the rotation", "mirrors; change the sign of one of its rows"));
    }
    Ok(orthonormal(&matrix))
}

/// Of `<ConvOri>`, which counts for MicMac; without it that of `<Externe>`; without both Apero's.
fn convention(path: &Path, conic: &Element, outer: &Element) -> Result<Convention> {
    let orientation = conic.child("ConvOri");
    if let Some(explicit) = orientation.and_then(|o| o.child("ConvExplicite")) {
        return spelled_out(path, explicit);
    }
    let named = orientation.and_then(|o| o.child("KnownConv")).or_else(|| outer.child("KnownConv"));
    let name = named.map_or("eConvApero_DistM2C", Element::word);
    known(name).ok_or_else(|| {
        let what = format!("`{name}` is not read; orient with eConvApero_DistM2C, as MicMac's commands do");
        Error::format(path, "<KnownConv>", what)
    })
}

fn known(name: &str) -> Option<Convention> {
    let of = |sense, columns, axes, unit| Convention {
        name: name.to_string(),
        sense,
        columns,
        rows: [1.0; 3],
        axes,
        order: Order::LeftToRight,
        unit,
    };
    let plain = [1.0; 3];
    Some(match name {
        "eConvApero_DistM2C" | "eConvApero_DistC2M" => of(Sense::ToWorld, plain, [2, 1, 0], Some(DEGREE)),
        "eConvOriLib" => of(Sense::ToWorld, plain, [0, 1, 2], Some(DEGREE)),
        "eConvMatrPoivillier_E" | "eConvAngErdas" => of(Sense::ToCamera, UPWARDS, [0, 1, 2], Some(DEGREE)),
        "eConvAngErdas_Grade" => of(Sense::ToCamera, UPWARDS, [0, 1, 2], Some(GRADE)),
        "eConvAngPhotoMDegre" => of(Sense::ToWorld, UPWARDS, [0, 1, 2], Some(DEGREE)),
        "eConvAngPhotoMGrade" => of(Sense::ToWorld, UPWARDS, [0, 1, 2], Some(GRADE)),
        "eConvAngLPSDegre" => of(Sense::ToWorld, UPWARDS, [1, 0, 2], Some(DEGREE)),
        "eConvMatrixInpho" => of(Sense::ToCamera, UPWARDS, [0, 1, 2], None),
        _ => return None,
    })
}

/// `<ConvExplicite>`: what is left out has Apero's meaning.
fn spelled_out(path: &Path, explicit: &Element) -> Result<Convention> {
    let is_true =
        |name: &str, else_is: &str| matches!(explicit.child(name).map_or(else_is, Element::word), "true" | "1");
    let three = |name: &str, else_are: [f64; 3]| match explicit.child(name) {
        Some(_) => numbers::<3>(path, explicit, name),
        None => Ok(else_are),
    };
    let axes = three("NumAxe", [2.0, 1.0, 0.0])?;
    let mut sorted = axes;
    sorted.sort_by(f64::total_cmp);
    if sorted != [0.0, 1.0, 2.0] {
        return Err(Error::format(path, "<NumAxe>", "0, 1 and 2 in some order are expected"));
    }
    let unit = match explicit.child("UniteAngles").map_or("eUniteAngleDegre", Element::word) {
        "eUniteAngleDegre" => Some(DEGREE),
        "eUniteAngleGrade" => Some(GRADE),
        "eUniteAngleRadian" => Some(1.0),
        _ => None,
    };
    Ok(Convention {
        name: "<ConvExplicite>".into(),
        sense: if is_true("MatrSenC2M", "true") { Sense::ToWorld } else { Sense::ToCamera },
        columns: three("ColMul", [1.0; 3])?,
        rows: three("LigMul", [1.0; 3])?,
        axes: axes.map(|axis| axis as usize),
        order: if is_true("SensCardan", "true") { Order::LeftToRight } else { Order::RightToLeft },
        unit,
    })
}

fn angles(path: &Path, stated: [f64; 3], convention: &Convention) -> Result<Matrix3<f64>> {
    let unit = convention.unit.ok_or_else(|| {
        let what = format!("{} says no unit of angles; write the rotation as <CodageMatr>", convention.name);
        Error::format(path, "<CodageAngulaire>", what)
    })?;
    let turns = convention.axes.iter().zip(stated).map(|(axis, angle)| {
        let about = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()][*axis];
        Rotation3::from_axis_angle(&about, angle * unit).into_inner()
    });
    Ok(turns.fold(Matrix3::identity(), |all, turn| match convention.order {
        Order::LeftToRight => all * turn,
        Order::RightToLeft => turn * all,
    }))
}

/// The axes that the camera's go to, `ji-k`: columns of camera → world. The third may be left out.
fn letters(text: &str) -> Option<Matrix3<f64>> {
    let mut columns = Vec::new();
    let mut sign = 1.0;
    for letter in text.chars() {
        let axis = match letter.to_ascii_lowercase() {
            '-' if sign > 0.0 => {
                sign = -1.0;
                continue;
            }
            'i' | 'x' => Vector3::x(),
            'j' | 'y' => Vector3::y(),
            'k' | 'z' => Vector3::z(),
            _ => return None,
        };
        columns.push(axis * sign);
        sign = 1.0;
    }
    if columns.len() == 2 {
        columns.push(columns[0].cross(&columns[1]));
    }
    (columns.len() == 3 && sign > 0.0).then(|| Matrix3::from_columns(&columns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Pose;

    fn read(convention: &str, rotation: &str) -> Result<Matrix3<f64>> {
        let path = Path::new("Orientation-a.xml");
        let text = format!(
            "<OrientationConique><Externe><KnownConv>eConvInconnue</KnownConv><ParamRotation>{rotation}</ParamRotation>\
             </Externe><ConvOri>{convention}</ConvOri></OrientationConique>"
        );
        let root = Element::parse(path, &text)?;
        let conic = root.child("OrientationConique").expect("an orientation");
        to_world(path, conic, conic.child("Externe").expect("its outer part"))
    }

    fn named(name: &str, angles: [f64; 3]) -> Matrix3<f64> {
        let [a, b, c] = angles;
        let convention = format!("<KnownConv>{name}</KnownConv>");
        read(&convention, &format!("<CodageAngulaire>{a} {b} {c}</CodageAngulaire>")).expect(name)
    }

    /// Photogrammetry's triple is checked against this crate's own, the others by hand.
    #[test]
    fn angles_are_of_their_convention() {
        let [omega, phi, kappa] = [12.0, -7.0, 155.0];
        let photogrammetric = named("eConvAngPhotoMDegre", [omega, phi, kappa]);
        let pose = Pose { rotation: photogrammetric.transpose(), centre: Vector3::zeros() };
        let back = pose.omega_phi_kappa();
        assert!(back.iter().zip([omega, phi, kappa]).all(|(a, b)| (a - b).abs() < 1e-9), "{back:?}");
        let in_grades = named("eConvAngPhotoMGrade", [omega, phi, kappa].map(|a| a / 0.9));
        assert!((in_grades - photogrammetric).norm() < 1e-12);
        // Of the same three angles Erdas has the transpose, before the camera's axes are turned over.
        let upwards = Matrix3::from_diagonal(&Vector3::from(UPWARDS));
        let erdas = named("eConvAngErdas", [omega, phi, kappa]);
        assert!((erdas * upwards - (photogrammetric * upwards).transpose()).norm() < 1e-12);
        // 90° about z, then 90° about the y that it left: x goes to −z, y to −x, z to y.
        let apero = named("eConvApero_DistM2C", [90.0, 90.0, 0.0]);
        let wanted = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0);
        assert!((apero - wanted).norm() < 1e-12, "{apero}");
        let lps = named("eConvAngLPSDegre", [phi, omega, kappa]) * upwards;
        let by_hand = Rotation3::from_axis_angle(&Vector3::y_axis(), phi * DEGREE)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), omega * DEGREE)
            * Rotation3::from_axis_angle(&Vector3::z_axis(), kappa * DEGREE);
        assert!((lps - by_hand.into_inner()).norm() < 1e-12);
    }

    #[test]
    fn conventions_may_be_spelled_out_and_matrices_be_of_the_world() {
        let spelled = "<ConvExplicite><MatrSenC2M>true</MatrSenC2M><ColMul>1 -1 -1</ColMul><UniteAngles>eUniteAngleRadian\
                       </UniteAngles><NumAxe>2 1 0</NumAxe><SensCardan>false</SensCardan></ConvExplicite>";
        let angles = [155.0, -7.0, 12.0].map(f64::to_radians);
        let text = format!("<CodageAngulaire>{} {} {}</CodageAngulaire>", angles[0], angles[1], angles[2]);
        let found = read(spelled, &text).expect("a rotation");
        assert!((found - named("eConvAngPhotoMDegre", [12.0, -7.0, 155.0])).norm() < 1e-12);
        let matrix = "<CodageMatr><L1>0 1 0</L1><L2>-1 0 0</L2><L3>0 0 1</L3></CodageMatr>";
        let inpho = read("<KnownConv>eConvMatrixInpho</KnownConv>", matrix).expect("a rotation");
        assert!((inpho - Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0)).norm() < 1e-12, "{inpho}");
        let level = read("<KnownConv>eConvApero_DistM2C</KnownConv>", "<CodageSymbolique>i-j-k</CodageSymbolique>");
        let off = level.expect("a rotation") - Matrix3::from_diagonal(&Vector3::from(UPWARDS));
        assert!(off.norm() < 1e-12, "{off}");
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        let apero = "<KnownConv>eConvApero_DistM2C</KnownConv>";
        let mirror = "<CodageMatr><L1>1 0 0</L1><L2>0 1 0</L2><L3>0 0 -1</L3></CodageMatr>";
        for (convention, rotation, words) in [
            (apero, mirror, "mirrors"),
            (apero, "<CodageSymbolique>ijq</CodageSymbolique>", "names no axes"),
            (apero, "<CodageSymbolique>ii</CodageSymbolique>", "not orthogonal"),
            (apero, "", "there is no <CodageMatr>"),
            ("<KnownConv>eConvAngSurvey</KnownConv>", mirror, "`eConvAngSurvey` is not read"),
            ("<KnownConv>eConvMatrixInpho</KnownConv>", "<CodageAngulaire>1 2 3</CodageAngulaire>", "no unit"),
            ("<ConvExplicite><NumAxe>0 0 1</NumAxe></ConvExplicite>", mirror, "<NumAxe>"),
        ] {
            let said = read(convention, rotation).expect_err(words).to_string();
            assert!(said.starts_with("Orientation-a.xml: ") && said.contains(words), "{said}");
        }
    }
}
