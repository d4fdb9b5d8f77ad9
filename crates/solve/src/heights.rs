//! Heights apart from planimetry: what the surveyed heights exceed the elevation model by, as a function of position.
//!
//! Three surfaces are fitted by least squares with equal weights: a shift, a tilted plane, and a quadratic surface, the
//! "doming" that self-calibrated photogrammetry leaves (M. R. James, S. Robson, "Mitigating systematic error in
//! topographic models derived from UAV and ground-based image networks", 2014). The one chosen has the smallest
//! leave-one-out error, so that more parameters win only when they predict points they have not seen. With e the
//! residual and h the leverage, leaving the point out gives e / (1 − h) (D. M. Allen, "The relationship between
//! variable selection and data augmentation and a method for prediction", 1974); nothing is fitted again.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use autoref_raster::coords::MapPoint;

/// A surveyed point and the model's height there, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeightPoint {
    /// Where the model was read: the mark's centre, brought to the map.
    pub position: MapPoint,
    /// Height of the list.
    pub surveyed_m: f64,
    /// Height of the elevation model.
    pub model_m: f64,
}

/// A surface of differences.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HeightModel {
    /// One number.
    Shift,
    /// A plane: three numbers.
    Tilt,
    /// A plane and the three products of second degree: six numbers.
    Quadratic,
}

impl HeightModel {
    /// Simplest first.
    pub const ALL: [HeightModel; 3] = [HeightModel::Shift, HeightModel::Tilt, HeightModel::Quadratic];

    /// Number of coefficients.
    pub fn parameters(self) -> usize {
        match self {
            HeightModel::Shift => 1,
            HeightModel::Tilt => 3,
            HeightModel::Quadratic => 6,
        }
    }

    /// As JSON and messages have it.
    pub fn label(self) -> &'static str {
        match self {
            HeightModel::Shift => "shift",
            HeightModel::Tilt => "tilt",
            HeightModel::Quadratic => "quadratic",
        }
    }
}

/// 1, u, v, u², u·v, v².
fn terms(u: f64, v: f64) -> [f64; 6] {
    [1.0, u, v, u * u, u * v, v * v]
}

/// One fitted surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeightFit {
    /// Which surface.
    pub model: HeightModel,
    /// Metres, for 1, u, v, u², u·v, v² (as many as the model has), with u and v as [`HeightCorrection`] defines them.
    pub coefficients_m: Vec<f64>,
    /// √(mean residual²), divisor n.
    pub rms_m: f64,
    /// √(mean leave-one-out residual²); `None` where leaving a point out leaves too few, or the surface undetermined.
    pub leave_one_out_rms_m: Option<f64>,
    /// Surveyed − (model + surface), in the order of the points.
    pub residuals_m: Vec<f64>,
    /// The same with the surface fitted to the other points; empty when `leave_one_out_rms_m` is `None`.
    pub leave_one_out_m: Vec<f64>,
}

/// What to add to the elevation model, and how the choice was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeightCorrection {
    /// u = (easting − centre) / unit_m, v = (northing − centre) / unit_m.
    pub centre_easting: f64,
    /// Likewise.
    pub centre_northing: f64,
    /// Largest distance of a point from the centre, metres.
    pub unit_m: f64,
    /// The surface that is added to the model.
    pub chosen: HeightModel,
    /// √(mean difference²) before any correction, divisor n.
    pub uncorrected_rms_m: f64,
    /// Every surface that the points determine, simplest first.
    pub fits: Vec<HeightFit>,
    /// What speaks against the choice, in plain words.
    pub warnings: Vec<String>,
}

impl HeightCorrection {
    /// The fit that was chosen.
    ///
    /// # Panics
    /// When `fits` holds none of the model `chosen`, which [`solve`] never leaves out.
    pub fn chosen_fit(&self) -> &HeightFit {
        self.fits.iter().find(|fit| fit.model == self.chosen).expect("the choice is among the fits")
    }

    /// Whether the fit that was chosen is there: what is read from a file may lack it.
    pub fn has_its_choice(&self) -> bool {
        self.fits.iter().any(|fit| fit.model == self.chosen)
    }

    /// Metres to add to the model's height at a map position.
    ///
    /// # Panics
    /// As [`HeightCorrection::chosen_fit`].
    pub fn at(&self, position: MapPoint) -> f64 {
        let (u, v) = self.local(position);
        self.chosen_fit().coefficients_m.iter().zip(terms(u, v)).map(|(c, t)| c * t).sum()
    }

    fn local(&self, p: MapPoint) -> (f64, f64) {
        ((p.easting - self.centre_easting) / self.unit_m, (p.northing - self.centre_northing) / self.unit_m)
    }
}

/// Why no correction was solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoHeights {
    /// Not one point has both heights.
    NoPoints,
    /// A coordinate or height is not a finite number.
    NotFinite,
}

/// A surface counts as undetermined when the smallest singular value of its equations is below this part of the
/// largest.
const RANK: f64 = 1e-6;

/// Fits every surface that the points determine and chooses by leave-one-out error. A surface of k parameters needs k
/// points, and k + 1 to be chosen over the shift.
///
/// # Errors
/// [`NoHeights`] without points or with numbers that are not finite.
pub fn solve(points: &[HeightPoint]) -> Result<HeightCorrection, NoHeights> {
    if points.is_empty() {
        return Err(NoHeights::NoPoints);
    }
    let finite = |p: &HeightPoint| {
        [p.position.easting, p.position.northing, p.surveyed_m, p.model_m].iter().all(|v| v.is_finite())
    };
    if !points.iter().all(finite) {
        return Err(NoHeights::NotFinite);
    }
    let n = points.len() as f64;
    let first = points[0].position;
    let mean = |f: &dyn Fn(&HeightPoint) -> f64| points.iter().map(f).sum::<f64>() / n;
    let centre_easting = first.easting + mean(&|p| p.position.easting - first.easting);
    let centre_northing = first.northing + mean(&|p| p.position.northing - first.northing);
    let extent = points
        .iter()
        .map(|p| (p.position.easting - centre_easting).hypot(p.position.northing - centre_northing))
        .fold(0.0, f64::max);
    let mut correction = HeightCorrection {
        centre_easting,
        centre_northing,
        // All points in one place leave the shift alone, which takes any unit.
        unit_m: if extent > 0.0 { extent } else { 1.0 },
        chosen: HeightModel::Shift,
        uncorrected_rms_m: mean(&|p| (p.surveyed_m - p.model_m).powi(2)).sqrt(),
        fits: Vec::new(),
        warnings: Vec::new(),
    };
    let local: Vec<(f64, f64)> = points.iter().map(|p| correction.local(p.position)).collect();
    let differences: Vec<f64> = points.iter().map(|p| p.surveyed_m - p.model_m).collect();
    correction.fits = HeightModel::ALL.into_iter().filter_map(|model| fit(model, &local, &differences)).collect();
    let by_error = |fit: &&HeightFit| fit.leave_one_out_rms_m.unwrap_or(f64::INFINITY);
    // The first of equals is the simplest.
    correction.chosen = correction
        .fits
        .iter()
        .min_by(|a, b| by_error(a).total_cmp(&by_error(b)))
        .map_or(HeightModel::Shift, |fit| fit.model);
    correction.warnings = warnings(points.len(), &correction);
    Ok(correction)
}

/// `None` when the points do not determine the surface.
fn fit(model: HeightModel, local: &[(f64, f64)], differences: &[f64]) -> Option<HeightFit> {
    let (n, k) = (local.len(), model.parameters());
    if n < k {
        return None;
    }
    let design = DMatrix::from_fn(n, k, |row, column| terms(local[row].0, local[row].1)[column]);
    let svd = design.clone().svd(true, true);
    if svd.singular_values.min() <= RANK * svd.singular_values.max() {
        return None;
    }
    let coefficients = svd.solve(&DVector::from_column_slice(differences), 0.0).ok()?;
    let residuals = DVector::from_column_slice(differences) - &design * &coefficients;
    let u = svd.u.as_ref()?;
    // Rows of U hold the leverages: h = |u_i|².
    let redundancy: Vec<f64> = (0..n).map(|i| 1.0 - u.row(i).norm_squared()).collect();
    let leave_one_out_m: Vec<f64> = match redundancy.iter().all(|r| *r > 1e-9) {
        true => residuals.iter().zip(&redundancy).map(|(e, r)| e / r).collect(),
        false => Vec::new(),
    };
    let rms = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
    Some(HeightFit {
        model,
        coefficients_m: coefficients.iter().copied().collect(),
        rms_m: rms(residuals.as_slice()),
        leave_one_out_rms_m: (!leave_one_out_m.is_empty()).then(|| rms(&leave_one_out_m)),
        residuals_m: residuals.iter().copied().collect(),
        leave_one_out_m,
    })
}

fn warnings(points: usize, correction: &HeightCorrection) -> Vec<String> {
    let mut warnings = Vec::new();
    if points == 1 {
        warnings.push("only 1 height: the shift takes its whole error".into());
    } else if points < 8 {
        warnings.push(format!("only {points} heights: a quadratic surface needs 8 or more to be trusted"));
    }
    if correction.chosen == HeightModel::Quadratic {
        warnings.push("a quadratic surface grows fast outside the points: do not use it far beyond them".into());
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(n: usize, surface: impl Fn(f64, f64) -> f64) -> Vec<HeightPoint> {
        (0..n)
            .map(|i| {
                let (e, no) = (37.0 * ((i * 7) % 11) as f64, 53.0 * ((i * 5) % 9) as f64);
                let noise = 0.004 * ((i * 13) % 7) as f64 - 0.012;
                let model_m = 80.0 + 0.01 * e;
                HeightPoint {
                    position: MapPoint { easting: 570_000.0 + e, northing: 7_032_000.0 + no },
                    surveyed_m: model_m + surface(e, no) + noise,
                    model_m,
                }
            })
            .collect()
    }

    #[test]
    fn each_surface_is_chosen_where_it_is_the_truth() {
        type Surface = fn(f64, f64) -> f64;
        let cases: [(HeightModel, Surface); 3] = [
            (HeightModel::Shift, |_, _| -1.8),
            (HeightModel::Tilt, |e, n| -1.8 + 0.002 * e - 0.001 * n),
            (HeightModel::Quadratic, |e, n| -1.8 + 0.002 * e + 4e-6 * (e - 200.0).powi(2) + 3e-6 * (n - 200.0).powi(2)),
        ];
        for (model, surface) in cases {
            let points = points(20, surface);
            let correction = solve(&points).expect("there are heights");
            assert_eq!(correction.chosen, model);
            for p in &points {
                assert!((p.surveyed_m - p.model_m - correction.at(p.position)).abs() < 0.03, "{model:?}");
            }
        }
    }

    #[test]
    fn leaving_out_in_closed_form_is_fitting_again() {
        let points = points(9, |e, n| 1e-5 * e * n);
        let correction = solve(&points).expect("there are heights");
        for fit in &correction.fits {
            for i in 0..points.len() {
                let mut others = points.clone();
                let left = others.remove(i);
                let mut again = solve(&others).expect("there are heights");
                again.chosen = fit.model;
                let error = left.surveyed_m - left.model_m - again.at(left.position);
                assert!((error - fit.leave_one_out_m[i]).abs() < 1e-8, "{:?} point {i}", fit.model);
            }
        }
    }

    #[test]
    fn few_or_badly_placed_heights_leave_simple_surfaces() {
        let one = solve(&points(1, |_, _| 2.0)).expect("there is a height");
        assert_eq!((one.chosen, one.fits.len()), (HeightModel::Shift, 1));
        assert!(one.chosen_fit().leave_one_out_rms_m.is_none() && !one.warnings.is_empty());
        // Three points fit a plane without residuals, which proves nothing: the shift stays.
        assert_eq!(solve(&points(3, |e, _| 0.01 * e)).expect("heights").chosen, HeightModel::Shift);
        let line: Vec<HeightPoint> = (0..12)
            .map(|i| HeightPoint {
                position: MapPoint { easting: f64::from(i), northing: 2.0 * f64::from(i) },
                surveyed_m: f64::from(i),
                model_m: 0.0,
            })
            .collect();
        assert_eq!(solve(&line).expect("heights").fits.len(), 1, "a plane is not determined on a line");
        assert_eq!(solve(&[]).err(), Some(NoHeights::NoPoints));
    }
}
