//! MicMac's models of distortion with numbered parameters (`ModUnif`), as polynomials of the plane.
//!
//! Source: `src/photogram/phgr_ebner_brown_dist.cpp` and `src/ori_phot/orilib.cpp` of MicMac, and what they name: H.
//! Ebner, *Self calibrating block adjustment*, 1976; D. C. Brown, *The bundle adjustment – progress and prospects*,
//! 1976.

use std::path::Path;

use crate::error::{Error, Result};
use crate::plane::{Fisheye, Law, Polynomial};
use crate::xml::Element;

/// A radial distortion with its companions, per pixel of the plane: MicMac's `ModRad` and `ModPhgrStd`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Radial {
    pub centre: [f64; 2],
    /// Of r³, r⁵, …
    pub coefficients: Vec<f64>,
    /// P1 belongs to x: (2x² + r², 2xy).
    pub decentric: [f64; 2],
    /// What x and y add to x.
    pub affine: [f64; 2],
}

impl Radial {
    /// The same as a polynomial of places in units of `unit` pixels.
    pub fn polynomial(&self, unit: f64) -> Polynomial {
        let mut all = Polynomial::new(self.centre, unit);
        let scaled: Vec<f64> = (1..).zip(&self.coefficients).map(|(k, c)| c * unit.powi(2 * k)).collect();
        all.add_radial(&scaled).add_decentric(&[self.decentric.map(|p| p * unit)]);
        all.add([1, 0], [self.affine[0], 0.0]).add([0, 1], [self.affine[1], 0.0]);
        all
    }
}

/// One distortion of a chain.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Model {
    None,
    Radial(Radial),
    Polynomial(Polynomial),
    /// The polynomial goes behind the fisheye.
    Fisheye(Fisheye, Polynomial),
}

impl Model {
    /// Whether all places stay where they are.
    pub fn moves_nothing(&self) -> bool {
        match self {
            Model::None => true,
            Model::Radial(r) => r.coefficients.is_empty() && [r.decentric, r.affine] == [[0.0; 2]; 2],
            Model::Polynomial(p) => p.terms().is_empty(),
            Model::Fisheye(..) => false,
        }
    }
}

/// What a camera gives to the models: their parameters have defaults from it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub f: f64,
    pub pp: [f64; 2],
    pub size: [f64; 2],
}

impl Frame {
    /// Size and principal point may be far from one: coefficients are held for coordinates about one.
    fn unit(&self) -> f64 {
        self.size[0].max(self.size[1])
    }
}

/// Reads `ModUnif`.
///
/// # Errors
/// When the model is not named or not known, or has more numbers than it has parameters.
pub(super) fn read(path: &Path, model: &Element, frame: Frame) -> Result<Model> {
    let refuse = |what: String| Err(Error::format(path, "<ModUnif>", what));
    let kind = model.find("TypeModele").map_or("", Element::word);
    let Some([parameters, states]) = counts(kind) else {
        let said = if kind.is_empty() { "there is no <TypeModele>".into() } else { format!("`{kind}` is not read") };
        return refuse(format!("{said}; calibrate with FraserBasic or RadialStd"));
    };
    let list = |name: &str| -> Option<Vec<f64>> {
        let mut elements = Vec::new();
        model.all(name, &mut elements);
        elements.iter().map(|e| e.numbers().filter(|n| n.len() == 1).map(|n| n[0])).collect()
    };
    let (Some(mut v), Some(stated)) = (list("Params"), list("Etats")) else {
        return refuse("a <Params> or <Etats> is no number".into());
    };
    if v.len() > parameters || stated.len() > states {
        return refuse(format!("`{kind}` has {parameters} <Params> and {states} <Etats>, not more; correct the file"));
    }
    let none_stated = v.is_empty();
    v.resize(parameters, 0.0);
    let state = |k: usize, else_is: f64| stated.get(k).copied().unwrap_or(else_is);
    // What a model divides by.
    let first = match kind {
        "eModeleEbner" => state(0, 0.4 * frame.size[0].min(frame.size[1])),
        k if k.starts_with("eModeleRadFour") => state(0, frame.size[0].hypot(frame.size[1]) / 2.0),
        _ => state(0, frame.f),
    };
    if first <= 0.0 {
        return refuse(format!("its first <Etats> is {first}; a positive number is expected"));
    }
    Ok(match kind {
        "eModeleEbner" => Model::Polynomial(ebner(&v, first, frame.unit())),
        "eModeleDCBrown" => Model::Polynomial(brown(&v, first, frame.unit())),
        "eModele_DRad_PPaEqPPs" | "eModele_Fraser_PPaEqPPs" => {
            let (radial, others) = v.split_at(5);
            let other = |k: usize| others.get(k).copied().unwrap_or(0.0);
            let (decentric, affine) = ([other(0), other(1)], [other(2), other(3)]);
            Model::Radial(Radial { centre: frame.pp, coefficients: radial.to_vec(), decentric, affine })
        }
        "eModelePolyDeg0" => Model::None,
        "eModelePolyDeg1" => Model::Polynomial(general(&v, 1, [0.0; 2], frame.unit())),
        _ if kind.starts_with("eModelePolyDeg") => {
            let degree = if v.len() == 6 { 2 } else { degree_of(v.len()) };
            Model::Polynomial(general(&v, degree, [state(1, frame.pp[0]), state(2, frame.pp[1])], first))
        }
        _ if kind.starts_with("eModeleRadFour") => {
            let centre = [state(1, frame.size[0] / 2.0), state(2, frame.size[1] / 2.0)];
            Model::Polynomial(four(&v, centre, first))
        }
        _ => {
            let law = match kind {
                "eModele_FishEye_10_5_5" => Law::Equidistant,
                "eModele_EquiSolid_FishEye_10_5_5" => Law::Equisolid,
                _ => Law::Stereographic,
            };
            let centre = if none_stated { frame.pp } else { [v[0], v[1]] };
            let fisheye = Fisheye { law, centre_px: centre, scale_px: first };
            Model::Fisheye(fisheye, behind_fisheye(&v[2..], centre, first))
        }
    })
}

/// How many parameters and states a model has.
fn counts(kind: &str) -> Option<[usize; 2]> {
    Some(match kind {
        "eModeleEbner" => [12, 1],
        "eModeleDCBrown" => [14, 1],
        "eModele_DRad_PPaEqPPs" => [5, 1],
        "eModele_Fraser_PPaEqPPs" => [9, 1],
        "eModelePolyDeg0" => [0, 3],
        "eModelePolyDeg1" => [2, 3],
        "eModelePolyDeg2" => [6, 3],
        "eModelePolyDeg3" => [14, 3],
        "eModelePolyDeg4" => [24, 3],
        "eModelePolyDeg5" => [36, 3],
        "eModelePolyDeg6" => [50, 3],
        "eModelePolyDeg7" => [66, 3],
        "eModeleRadFour7x2" => [11, 3],
        "eModeleRadFour11x2" => [13, 3],
        "eModeleRadFour15x2" => [15, 3],
        "eModeleRadFour19x2" => [17, 3],
        "eModele_FishEye_10_5_5" | "eModele_EquiSolid_FishEye_10_5_5" | "eModele_Stereographik_FishEye_10_5_5" => {
            [50, 1]
        }
        _ => return None,
    })
}

/// The degree of the general polynomial with that many parameters, from 3 up: 14, 24, 36, 50, 66.
fn degree_of(parameters: usize) -> usize {
    (3..).find(|d| d * (d + 3) - 4 >= parameters).unwrap_or(3)
}

/// A sum of c xⁱ yʲ.
type Sum<'a> = &'a [(u8, u8, f64)];

/// Polynomials in pixels from the plane's origin, as the article has them. Each row: the parameter, its function of x
/// and y, and by how much x and y move with it.
fn in_pixels(rows: &[(f64, Sum<'_>, [f64; 2])], unit: f64) -> Polynomial {
    let mut all = Polynomial::new([0.0; 2], unit);
    for (parameter, sum, moves) in rows {
        for (i, j, c) in *sum {
            // The unit takes the coordinates down and the result up.
            let scale = unit.powi(i32::from(i + j) - 1) * parameter * c;
            all.add([*i, *j], moves.map(|m| m * scale));
        }
    }
    all
}

/// Ebner's twelve functions, orthogonal over nine points with the base `b` between them.
fn ebner(v: &[f64], b: f64, unit: f64) -> Polynomial {
    let q = 2.0 / 3.0 * b * b;
    let (x, y, xy): (Sum<'_>, Sum<'_>, Sum<'_>) = (&[(1, 0, 1.0)], &[(0, 1, 1.0)], &[(1, 1, 1.0)]);
    let (x2, y2): (Sum<'_>, Sum<'_>) = (&[(2, 0, 1.0), (0, 0, -q)], &[(0, 2, 1.0), (0, 0, -q)]);
    let (xy2, yx2): (Sum<'_>, Sum<'_>) = (&[(1, 2, 1.0), (1, 0, -q)], &[(2, 1, 1.0), (0, 1, -q)]);
    let x2y2: Sum<'_> = &[(2, 2, 1.0), (2, 0, -q), (0, 2, -q), (0, 0, q * q)];
    let rows = [
        (v[0], x, [1.0, 0.0]),
        (v[0], y, [0.0, -1.0]),
        (v[1], y, [1.0, 0.0]),
        (v[1], x, [0.0, 1.0]),
        (v[2], x2, [-2.0, 0.0]),
        (v[2], xy, [0.0, 1.0]),
        (v[3], xy, [1.0, 0.0]),
        (v[3], y2, [0.0, -2.0]),
        (v[4], y2, [1.0, 0.0]),
        (v[5], x2, [0.0, 1.0]),
        (v[6], xy2, [1.0, 0.0]),
        (v[7], yx2, [0.0, 1.0]),
        (v[8], yx2, [1.0, 0.0]),
        (v[9], xy2, [0.0, 1.0]),
        (v[10], x2y2, [1.0, 0.0]),
        (v[11], x2y2, [0.0, 1.0]),
    ];
    in_pixels(&rows, unit)
}

/// Brown's fourteen functions for aerial cameras.
fn brown(v: &[f64], f: f64, unit: f64) -> Polynomial {
    let (x, y, xy): (Sum<'_>, Sum<'_>, Sum<'_>) = (&[(1, 0, 1.0)], &[(0, 1, 1.0)], &[(1, 1, 1.0)]);
    let (x2, y2): (Sum<'_>, Sum<'_>) = (&[(2, 0, 1.0)], &[(0, 2, 1.0)]);
    let (x2y, xy2, x2y2): (Sum<'_>, Sum<'_>, Sum<'_>) = (&[(2, 1, 1.0)], &[(1, 2, 1.0)], &[(2, 2, 1.0)]);
    let rows = [
        (v[0], x, [1.0, 0.0]),
        (v[1], y, [1.0, 0.0]),
        (v[2], xy, [1.0, 0.0]),
        (v[3], y2, [1.0, 0.0]),
        (v[4], x2y, [1.0, 0.0]),
        (v[5], xy2, [1.0, 0.0]),
        (v[6], x2y2, [1.0, 0.0]),
        (v[7], xy, [0.0, 1.0]),
        (v[8], x2, [0.0, 1.0]),
        (v[9], x2y, [0.0, 1.0]),
        (v[10], xy2, [0.0, 1.0]),
        (v[11], x2y2, [0.0, 1.0]),
        // A film that is not flat moves places along the radius.
        (v[12] / f, &[(3, 2, 1.0)], [1.0, 0.0]),
        (v[12] / f, &[(2, 3, 1.0)], [0.0, 1.0]),
        (v[13], &[(3, 0, 1.0), (1, 2, 1.0)], [1.0, 0.0]),
        (v[13], &[(2, 1, 1.0), (0, 3, 1.0)], [0.0, 1.0]),
    ];
    in_pixels(&rows, unit)
}

/// `eModelePolyDeg1…7`: six terms of low degree without those that turn, shift and scale, then x^(d−k) y^k of the
/// degrees from 3 up, for x and then for y.
fn general(v: &[f64], degree: usize, centre: [f64; 2], scale: f64) -> Polynomial {
    let c = |k: usize| v.get(k).copied().unwrap_or(0.0);
    let mut all = Polynomial::new(centre, scale);
    all.add([1, 0], [c(0), c(1)]).add([0, 1], [c(1), -c(0)]);
    if degree < 2 {
        return all;
    }
    all.add([2, 0], [-2.0 * c(2), c(5)]).add([1, 1], [c(3), c(2)]).add([0, 2], [c(4), -2.0 * c(3)]);
    let mut at = 6;
    for degree in 3..=degree as u8 {
        let width = usize::from(degree) + 1;
        for k in 0..=degree {
            let place = at + usize::from(k);
            all.add([degree - k, k], [c(place), c(place + width)]);
        }
        at += 2 * width;
    }
    all
}

/// `eModeleRadFour…`: the six terms of low degree about the image's centre, and a radial distortion about another.
fn four(v: &[f64], centre: [f64; 2], scale: f64) -> Polynomial {
    let (low, rest) = v.split_at(6);
    let (off, radial) = rest.split_at(2);
    let of_radial = [0, 1].map(|k| centre[k] + off[k] * scale);
    let mut all = general(low, 2, centre, scale).about(of_radial);
    all.add_radial(radial);
    all
}

/// The polynomial of the fisheyes, `10_5_5`: ten radial terms, five decentric pairs, and what of a polynomial of degree
/// five is neither of them nor a turn of the camera.
fn behind_fisheye(v: &[f64], centre: [f64; 2], scale: f64) -> Polynomial {
    let (radial, rest) = v.split_at(10);
    let (decentric, rest) = rest.split_at(10);
    let pairs: Vec<[f64; 2]> = decentric.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
    let mut all = Polynomial::new(centre, scale);
    all.add_radial(radial).add_decentric(&pairs);
    let mut next = rest.iter().copied();
    let mut one = || next.next().unwrap_or(0.0);
    let (first, second) = (one(), one());
    all.add([1, 0], [first, second]).add([0, 1], [second, 0.0]);
    for degree in 3..=5_u8 {
        for k in 0..=degree {
            let x = if k > 0 { one() } else { 0.0 };
            let y = if degree % 2 == 1 || k < degree { one() } else { 0.0 };
            all.add([degree - k, k], [x, y]);
        }
    }
    all
}
