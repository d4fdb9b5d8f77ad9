//! How far off a place in the image may be: radii that hold the true position in 95 of 100 cases.
//!
//! For a 2-D similarity with isotropic noise the error of the transform at a pixel is isotropic too, with the variance
//! σ²·q per coordinate, q = 1/Σp + d²/Σp·d² (d the distance from the weighted centre; K. R. Koch, "Parameter Estimation
//! and Hypothesis Testing in Linear Models", 2nd ed., 1999, section 3.2). σ² is not known but estimated from ν = 2n − 4
//! redundant measurements, so the squared length of the error over 2·σ̂²·q is distributed as Fisher's F with (2, ν)
//! degrees of freedom. F(2, ν) has its quantiles in closed form, P(F > f) = (1 + 2f/ν)^(−ν/2), and the radius is
//!
//! r₉₅ = σ̂ · √(q · ν · (0.05^(−2/ν) − 1)),
//!
//! which tends to the Rayleigh quantile 2.4477·σ·√q for many points and is 2.5 times that for three. With two points
//! nothing is redundant: the radius rests on the stated precision of marks and survey, and is absent when neither is
//! stated. Of an affine transform q = r·(Σp·rᵀr)⁻¹·rᵀ with r = (1, x, y), and ν = 2n − 6.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::planar::{Kind, PlanarFit, affine_cofactors};
use crate::{Pair, Similarity, Solution};
use autoref_raster::coords::{MapPoint, PixelPoint};

/// Share of the cases in which the true position lies outside the radius.
const OUTSIDE: f64 = 0.05;

/// Radii of 95 % at one place, metres on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpectedError {
    /// Of the transform alone: where the place really is, were the image free of errors of its own there.
    pub transform_95_m: f64,
    /// Of a point read off the image there: the transform's error and that of one mark (centring, the image's own
    /// deformation, survey), as the residuals show it.
    pub point_95_m: f64,
}

/// What a fit says of its errors anywhere in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorModel {
    /// √(ν · (0.05^(−2/ν) − 1)) times the standard deviation of a coordinate of unit weight, metres.
    radius_m: f64,
    cofactor: Cofactor,
    centre: PixelPoint,
}

/// The variance of a coordinate of the transform, over that of unit weight.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cofactor {
    /// Σp and Σp·d², px².
    Similarity { weight: f64, spread_px2: f64 },
    /// The inverse of Σp·rᵀr, r = (1, x, y) from the centre in units of `unit_px`.
    Affine { inverse: Matrix3<f64>, unit_px: f64 },
}

impl ErrorModel {
    /// `None` when the noise is unknown: two points without stated precision.
    pub fn new(solution: &Solution) -> Option<Self> {
        let weight: f64 = solution.pairs.iter().map(|pair| pair.weight).sum();
        let variance = solution.covariance[2][2] * weight;
        let freedom = 2.0 * solution.pairs.len() as f64 - 4.0;
        if freedom <= 0.0 && variance <= 0.0 {
            return None;
        }
        let spread_px2 = if variance > 0.0 { variance / solution.covariance[0][0] } else { f64::INFINITY };
        let quantile = if freedom > 0.0 { quantile(freedom) } else { (-2.0 * OUTSIDE.ln()).sqrt() };
        let cofactor = Cofactor::Similarity { weight, spread_px2 };
        Some(ErrorModel { radius_m: quantile * variance.sqrt(), cofactor, centre: solution.centre })
    }

    /// Of an affine transform, with ν = 2n − 6; `pairs` are those of the fit. `None` with three points, whose residuals
    /// are zero whatever they are, and for another transform.
    pub fn of_affine(fit: &PlanarFit, pairs: &[Pair]) -> Option<Self> {
        let freedom = 2.0 * pairs.len() as f64 - 6.0;
        if fit.kind != Kind::Affine || freedom <= 0.0 {
            return None;
        }
        let n = pairs.len() as f64;
        let mean = |of: fn(&Pair) -> f64| pairs.iter().map(of).sum::<f64>() / n;
        let centre = PixelPoint { x: mean(|pair| pair.pixel.x), y: mean(|pair| pair.pixel.y) };
        let square = |pair: &Pair| (pair.pixel.x - centre.x).powi(2) + (pair.pixel.y - centre.y).powi(2);
        let unit_px = (pairs.iter().map(square).sum::<f64>() / n).sqrt();
        let inverse = affine_cofactors(pairs.iter().map(|pair| row(pair.pixel, centre, unit_px)), &fit.weights)?;
        let squares = fit.residuals_m.iter().zip(&fit.weights).map(|(r, w)| w * (r[0] * r[0] + r[1] * r[1]));
        let sigma_m = (squares.sum::<f64>() / freedom).sqrt();
        Some(ErrorModel {
            radius_m: quantile(freedom) * sigma_m,
            cofactor: Cofactor::Affine { inverse, unit_px },
            centre,
        })
    }

    /// At a pixel, inside the image or not.
    pub fn at(&self, p: PixelPoint) -> ExpectedError {
        let cofactor = match self.cofactor {
            Cofactor::Similarity { weight, spread_px2 } => {
                let arm = (p.x - self.centre.x).powi(2) + (p.y - self.centre.y).powi(2);
                1.0 / weight + arm / spread_px2
            }
            Cofactor::Affine { inverse, unit_px } => {
                let row = row(p, self.centre, unit_px);
                row.dot(&(inverse * row))
            }
        };
        ExpectedError {
            transform_95_m: self.radius_m * cofactor.sqrt(),
            point_95_m: self.radius_m * (1.0 + cofactor).sqrt(),
        }
    }

    /// In the four corners of an image, clockwise from the upper left; `similarity` tells which way they lie.
    pub fn corners(&self, similarity: &Similarity, (width_px, height_px): (f64, f64)) -> Vec<CornerError> {
        let middle = similarity.apply(PixelPoint { x: width_px / 2.0, y: height_px / 2.0 });
        let error = |corner: Corner| {
            let p = corner.place((width_px, height_px));
            CornerError { corner, direction: direction(middle, similarity.apply(p)).into(), expected: self.at(p) }
        };
        Corner::CLOCKWISE.into_iter().map(error).collect()
    }
}

/// The radius that holds 95 of 100 errors, in standard deviations of a coordinate that is estimated with so many
/// degrees of freedom.
pub(crate) fn quantile(freedom: f64) -> f64 {
    (freedom * (OUTSIDE.powf(-2.0 / freedom) - 1.0)).sqrt()
}

fn row(p: PixelPoint, centre: PixelPoint, unit_px: f64) -> Vector3<f64> {
    Vector3::new(1.0, (p.x - centre.x) / unit_px, (p.y - centre.y) / unit_px)
}

/// Expected errors over an image, at the nodes of a grid that reaches from corner to corner.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorMap {
    /// Size of the image, pixels.
    pub width_px: f64,
    /// Likewise.
    pub height_px: f64,
    /// Nodes from left to right and from top to bottom, the edges included; at least 2 each.
    pub columns: usize,
    /// Likewise.
    pub rows: usize,
    /// Row-major from the upper left corner.
    pub nodes: Vec<ExpectedError>,
}

/// The expected error in one corner of the image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CornerError {
    /// Which corner.
    pub corner: Corner,
    /// Which way it lies from the middle of the image, on the map: "north-west".
    pub direction: String,
    /// Radii of 95 % there.
    #[serde(flatten)]
    pub expected: ExpectedError,
}

/// A corner of the image as it is stored, x to the right and y down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Corner {
    /// (0, 0).
    UpperLeft,
    /// (width, 0).
    UpperRight,
    /// (width, height).
    LowerRight,
    /// (0, height).
    LowerLeft,
}

impl Corner {
    /// From the upper left.
    pub const CLOCKWISE: [Corner; 4] = [Corner::UpperLeft, Corner::UpperRight, Corner::LowerRight, Corner::LowerLeft];

    /// Where it lies in an image of this size.
    pub fn place(self, (width_px, height_px): (f64, f64)) -> PixelPoint {
        match self {
            Corner::UpperLeft => PixelPoint { x: 0.0, y: 0.0 },
            Corner::UpperRight => PixelPoint { x: width_px, y: 0.0 },
            Corner::LowerRight => PixelPoint { x: width_px, y: height_px },
            Corner::LowerLeft => PixelPoint { x: 0.0, y: height_px },
        }
    }
}

impl ErrorMap {
    /// The map of an image of the given size, the longer side in `steps` steps (at least 1) and the other in steps
    /// about as long. `None` when the solution says nothing of its noise.
    pub fn new(solution: &Solution, (width_px, height_px): (f64, f64), steps: usize) -> Option<Self> {
        let model = ErrorModel::new(solution)?;
        let longer = width_px.max(height_px).max(1.0);
        let nodes_of = |side: f64| ((steps.max(1) as f64 * side / longer).round() as usize).max(1) + 1;
        let (columns, rows) = (nodes_of(width_px), nodes_of(height_px));
        let nodes = (0..rows * columns)
            .map(|i| model.at(place(i % columns, i / columns, columns, rows, width_px, height_px)))
            .collect();
        Some(ErrorMap { width_px, height_px, columns, rows, nodes })
    }

    /// Where a node lies in the image.
    ///
    /// # Panics
    /// When column or row is out of range.
    pub fn place(&self, column: usize, row: usize) -> PixelPoint {
        assert!(column < self.columns && row < self.rows, "a node of the grid");
        place(column, row, self.columns, self.rows, self.width_px, self.height_px)
    }
}

fn place(column: usize, row: usize, columns: usize, rows: usize, width_px: f64, height_px: f64) -> PixelPoint {
    PixelPoint { x: width_px * column as f64 / (columns - 1) as f64, y: height_px * row as f64 / (rows - 1) as f64 }
}

/// The expected errors in the four corners of an image, clockwise from the upper left; empty when the solution says
/// nothing of its noise.
pub fn corners(solution: &Solution, size_px: (f64, f64)) -> Vec<CornerError> {
    ErrorModel::new(solution).map_or_else(Vec::new, |model| model.corners(&solution.similarity, size_px))
}

/// One of the eight winds.
fn direction(from: MapPoint, to: MapPoint) -> &'static str {
    const WINDS: [&str; 8] = ["east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east"];
    let angle = (to.northing - from.northing).atan2(to.easting - from.easting).to_degrees();
    WINDS[(angle / 45.0).round().rem_euclid(8.0) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planar::{Weighting, fit};
    use crate::solve;
    use autoref_raster::random::SplitMix64;

    fn solution(residuals_m: &[(f64, f64)], sigma_m: Option<f64>) -> Solution {
        // A square of 1,000 px about (500, 500), north up, 0.1 m per pixel.
        let corners = [(0.0, 0.0), (1000.0, 0.0), (1000.0, 1000.0), (0.0, 1000.0)];
        let pairs: Vec<Pair> = residuals_m
            .iter()
            .zip(corners)
            .map(|((e, n), (x, y))| Pair {
                pixel: PixelPoint { x, y },
                covariance_px2: None,
                map: MapPoint { easting: 0.1 * x + e, northing: -0.1 * y + n },
                survey_sigma_m: sigma_m,
            })
            .collect();
        solve(&pairs).expect("four corners are no line")
    }

    #[test]
    fn radii_by_hand() {
        // Residuals ±0.01 m that neither shift nor turn nor scale the square: e = +,−,+,− leaves all four parameters
        // alone.
        let s = solution(&[(0.01, 0.0), (-0.01, 0.0), (0.01, 0.0), (-0.01, 0.0)], None);
        // ν = 4, σ̂² = 4·10⁻⁴/4 = 10⁻⁴; 0.05^(−1/2) = 4.472136, √(4·3.472136) = 3.726734.
        let model = ErrorModel::new(&s).expect("four points");
        let centre = model.at(PixelPoint { x: 500.0, y: 500.0 });
        assert!((centre.transform_95_m - 0.01 * 3.726_734 * 0.5).abs() < 1e-7, "{centre:?}");
        assert!((centre.point_95_m - 0.01 * 3.726_734 * 1.25f64.sqrt()).abs() < 1e-7);
        // In a corner q = 1/4 + 500000/2000000 = 1/2.
        let corner = model.at(PixelPoint { x: 0.0, y: 0.0 });
        assert!((corner.transform_95_m - 0.01 * 3.726_734 * 0.5f64.sqrt()).abs() < 1e-7);
        let map = ErrorMap::new(&s, (1000.0, 500.0), 8).expect("noise is known");
        assert_eq!((map.columns, map.rows, map.nodes.len()), (9, 5, 45));
        assert_eq!(map.place(8, 4), PixelPoint { x: 1000.0, y: 500.0 });
        assert_eq!(map.nodes[4 * 9 + 8], model.at(map.place(8, 4)));
        let least = map.nodes.iter().map(|node| node.point_95_m).fold(f64::INFINITY, f64::min);
        assert!((least - centre.point_95_m).abs() < 1e-12);
    }

    #[test]
    fn two_points_rest_on_what_is_stated() {
        assert!(ErrorModel::new(&solution(&[(0.0, 0.0), (0.0, 0.0)], None)).is_none());
        let model = ErrorModel::new(&solution(&[(0.0, 0.0), (0.0, 0.0)], Some(0.02))).expect("σ is stated");
        let middle = model.at(PixelPoint { x: 500.0, y: 0.0 });
        assert!((middle.transform_95_m - 2.447_747 * 0.02 * 0.5f64.sqrt()).abs() < 1e-7, "{middle:?}");
    }

    #[test]
    fn corners_are_named_by_the_map() {
        let s = solution(&[(0.01, 0.0), (-0.01, 0.0), (0.01, 0.0), (-0.01, 0.0)], None);
        let named: Vec<String> = corners(&s, (1000.0, 1000.0)).into_iter().map(|c| c.direction).collect();
        assert_eq!(named, ["north-west", "north-east", "south-east", "south-west"]);
    }

    /// Lists of eight points with surveys of 5, 20 and 60 mm, of an image that is stretched: the corners' true errors
    /// under the affine transform lie within its radii in about 95 of 100 cases, with stated weights and without.
    #[test]
    fn radii_of_an_affine_transform_hold_what_they_state() {
        let size = (4000.0, 3000.0);
        let truth = |p: PixelPoint| MapPoint { easting: 0.031 * p.x + 0.002 * p.y, northing: -0.03 * p.y };
        for (sigmas, weighting) in [([0.005, 0.02, 0.06], Weighting::Stated), ([0.02; 3], Weighting::Equal)] {
            let mut random = SplitMix64(11);
            let (mut within, mut all) = (0, 0);
            for _ in 0..400 {
                let pair = |i: usize| {
                    let pixel = PixelPoint { x: size.0 * random.unit(), y: size.1 * random.unit() };
                    let (sigma, at) = (sigmas[i % 3], truth(pixel));
                    let easting = at.easting + sigma * random.normal();
                    let map = MapPoint { easting, northing: at.northing + sigma * random.normal() };
                    Pair { pixel, map, covariance_px2: None, survey_sigma_m: Some(sigma) }
                };
                let pairs: Vec<Pair> = (0..8).map(pair).collect();
                let fit = fit(&pairs, Kind::Affine, weighting).expect("eight points apart");
                let model = ErrorModel::of_affine(&fit, &pairs).expect("eight points");
                for corner in Corner::CLOCKWISE {
                    let p = corner.place(size);
                    let (there, at) = (fit.apply(p).expect("affine"), truth(p));
                    let off = (there.easting - at.easting).hypot(there.northing - at.northing);
                    within += usize::from(off <= model.at(p).transform_95_m);
                    all += 1;
                }
            }
            let share = within as f64 / all as f64;
            assert!((0.93..0.99).contains(&share), "{weighting:?}: {share}");
        }
    }
}
