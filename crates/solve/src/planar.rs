//! Affine and projective transforms image → map, as explicit choices.
//!
//! An orthophoto needs neither: a similarity says all there is, and parameters beyond it fit errors. Both are here for
//! images that are no orthophotos, and say so when the points do not support them: few points, points near a line, or a
//! leave-one-out error that is no better than the similarity's.
//!
//! Least squares of the residuals on the map, every point alike or by what is stated of it ([`Weighting`]). The affine
//! transform is linear; the projective one starts from the linear solution on normalised coordinates (R. Hartley, A.
//! Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, 2003, section 4.4) and is refined by
//! Gauss–Newton steps.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::reliability::{Noise, Reliability};
use super::similarity::{self, Pair, Unsolvable};
use super::weights;
use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};

/// Which transform.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// 6 parameters; 3 points determine it.
    Affine,
    /// 8 parameters; 4 points determine it.
    Projective,
}

impl Kind {
    /// Fewest points that determine it.
    pub fn fewest_points(self) -> usize {
        match self {
            Kind::Affine => 3,
            Kind::Projective => 4,
        }
    }

    fn parameters(self) -> usize {
        2 * self.fewest_points()
    }

    fn label(self) -> &'static str {
        match self {
            Kind::Affine => "affine",
            Kind::Projective => "projective",
        }
    }
}

/// What points weigh in a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weighting {
    /// Every point alike.
    Equal,
    /// By the stated variances of centre and survey and a common part that the residuals show, as in the similarity's
    /// adjustment.
    Stated,
}

/// A fitted transform.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarFit {
    /// Which transform.
    pub kind: Kind,
    /// Of the pairs, of mean 1.
    pub weights: Vec<f64>,
    /// Residuals (easting, northing), surveyed − computed, metres, in the order of the pairs.
    pub residuals_m: Vec<[f64; 2]>,
    /// √(mean(dE² + dN²)), divisor n, metres.
    pub rmse_m: f64,
    /// The same with every point computed by a fit to the others; `None` when one cannot be left out.
    pub leave_one_out_rmse_m: Option<f64>,
    /// Those differences (easting, northing), metres, in the order of the pairs.
    pub leave_one_out_m: Option<Vec<[f64; 2]>>,
    /// What each point says of itself, of an affine transform; `None` with three points and of a projective one.
    pub reliability: Option<Vec<Reliability>>,
    /// Why the points may not support it, in plain words.
    pub warnings: Vec<String>,
    transform: Transform,
}

impl PlanarFit {
    /// Image → map. `None` beyond the horizon of a projective transform.
    pub fn apply(&self, p: PixelPoint) -> Option<MapPoint> {
        self.transform.apply(p)
    }

    /// (x, y, 1) in pixels → homogeneous (easting, northing, w). Entries lose digits when eastings are in the millions:
    /// for computing, use [`apply`](Self::apply).
    pub fn matrix(&self) -> Matrix3<f64> {
        self.transform.matrix()
    }
}

/// A homography between both sides, each about its centroid and scaled to unit size, with 1 in the last place: the
/// centroid of the points is never on the horizon.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Transform {
    h: Matrix3<f64>,
    pixel_centre: PixelPoint,
    pixel_unit: f64,
    map_centre: MapPoint,
    map_unit: f64,
}

impl Transform {
    fn apply(&self, p: PixelPoint) -> Option<MapPoint> {
        let v = self.h
            * Vector3::new(
                (p.x - self.pixel_centre.x) / self.pixel_unit,
                (p.y - self.pixel_centre.y) / self.pixel_unit,
                1.0,
            );
        (v.z > 0.0).then(|| MapPoint {
            easting: self.map_centre.easting + self.map_unit * v.x / v.z,
            northing: self.map_centre.northing + self.map_unit * v.y / v.z,
        })
    }

    /// Of a pixel in the middle of the points, the root of its area on the ground.
    fn scale_m_per_px(&self) -> f64 {
        let h = &self.h;
        let area = (h[(0, 0)] * h[(1, 1)] - h[(0, 1)] * h[(1, 0)]).abs();
        self.map_unit / self.pixel_unit * area.sqrt()
    }

    fn matrix(&self) -> Matrix3<f64> {
        let (s, c) = (1.0 / self.pixel_unit, self.pixel_centre);
        let from = Matrix3::new(s, 0.0, -s * c.x, 0.0, s, -s * c.y, 0.0, 0.0, 1.0);
        let (m, c) = (self.map_unit, self.map_centre);
        Matrix3::new(m, 0.0, c.easting, 0.0, m, c.northing, 0.0, 0.0, 1.0) * self.h * from
    }
}

/// Fits `kind` to `pairs`.
///
/// # Errors
/// [`Unsolvable::TooFewPoints`] below [`Kind::fewest_points`]; [`Unsolvable::Degenerate`] when the points do not
/// determine it (on one line; for the projective also three of four on a line) or put one of themselves beyond its
/// horizon.
pub fn fit(pairs: &[Pair], kind: Kind, weighting: Weighting) -> Result<PlanarFit, Unsolvable> {
    let equal = vec![1.0; pairs.len()];
    let first = solve(pairs, &equal, kind)?;
    let weights = match weighting {
        Weighting::Equal => equal,
        Weighting::Stated => stated_weights(pairs, kind, &first)?,
    };
    let transform = if weights.iter().all(|w| *w == 1.0) { first } else { solve(pairs, &weights, kind)? };
    let residuals_m = residuals(&transform, pairs)?;
    let rmse_m = rms(&residuals_m);
    let without = |i: usize, others: &[Pair]| {
        let weights = [&weights[..i], &weights[i + 1..]].concat();
        solve(others, &weights, kind).ok()
    };
    let leave_one_out_m = leave_one_out(pairs, without, residual);
    let leave_one_out_rmse_m = leave_one_out_m.as_deref().map(rms);
    let reliability = match kind {
        Kind::Affine => reliability(pairs, &weights, &transform, &residuals_m),
        Kind::Projective => None,
    };
    let warnings = warnings(pairs, &weights, kind, leave_one_out_rmse_m);
    Ok(PlanarFit {
        kind,
        weights,
        residuals_m,
        rmse_m,
        leave_one_out_rmse_m,
        leave_one_out_m,
        reliability,
        warnings,
        transform,
    })
}

/// What the affine transform shows of each point; `None` where nothing is redundant. A coordinate's leverage is
/// w·r·N⁻¹·rᵀ with r = (u, v, 1) and N = Σ w·rᵀ·r, the same for both.
fn reliability(
    pairs: &[Pair],
    weights: &[f64],
    transform: &Transform,
    residuals_m: &[[f64; 2]],
) -> Option<Vec<Reliability>> {
    let freedom = 2.0 * pairs.len() as f64 - Kind::Affine.parameters() as f64;
    if freedom <= 0.0 {
        return None;
    }
    let (_, local) = normalise(pairs, weights)?;
    let rows: Vec<Vector3<f64>> = local.iter().map(|p| Vector3::new(p.u, p.v, 1.0)).collect();
    let inverse = affine_cofactors(rows.iter().copied(), weights)?;
    let weighted: f64 = residuals_m.iter().zip(weights).map(|(r, w)| w * (r[0] * r[0] + r[1] * r[1])).sum();
    let noise = Noise {
        points: pairs.len(),
        freedom,
        weighted,
        sigma0_m: Some((weighted / freedom).sqrt()),
        scale_m_per_px: transform.scale_m_per_px(),
    };
    let of = |i: usize| {
        let leverage = weights[i] * rows[i].dot(&(inverse * rows[i]));
        Reliability::of(&noise, weights[i], leverage, residuals_m[i].into())
    };
    Some((0..pairs.len()).map(of).collect())
}

/// The cofactors of the three parameters of one coordinate, the same for both: the inverse of N = Σ w·r·rᵀ over the
/// rows r of the pairs, which hold 1 and the pixel's place, in any order. `None` for points near a line.
pub(crate) fn affine_cofactors(rows: impl Iterator<Item = Vector3<f64>>, weights: &[f64]) -> Option<Matrix3<f64>> {
    let normal: Matrix3<f64> = rows.zip(weights).map(|(row, weight)| *weight * row * row.transpose()).sum();
    normal.try_inverse()
}

/// Weights from the residuals of `equal`, the fit in which every point counts alike.
fn stated_weights(pairs: &[Pair], kind: Kind, equal: &Transform) -> Result<Vec<f64>, Unsolvable> {
    let squares: Vec<f64> = residuals(equal, pairs)?.iter().map(|r| r[0] * r[0] + r[1] * r[1]).collect();
    Ok(weights::of_residuals(pairs, equal.scale_m_per_px(), kind.parameters(), || squares))
}

fn residuals(transform: &Transform, pairs: &[Pair]) -> Result<Vec<[f64; 2]>, Unsolvable> {
    pairs.iter().map(|pair| residual(transform, pair).ok_or(Unsolvable::Degenerate)).collect()
}

fn residual(transform: &Transform, pair: &Pair) -> Option<[f64; 2]> {
    transform.apply(pair.pixel).map(|c| [pair.map.easting - c.easting, pair.map.northing - c.northing])
}

fn rms(residuals: &[[f64; 2]]) -> f64 {
    (residuals.iter().map(|r| r[0] * r[0] + r[1] * r[1]).sum::<f64>() / residuals.len() as f64).sqrt()
}

/// Every point against the fit to the others.
fn leave_one_out<T>(
    pairs: &[Pair],
    solve: impl Fn(usize, &[Pair]) -> Option<T>,
    residual: impl Fn(&T, &Pair) -> Option<[f64; 2]>,
) -> Option<Vec<[f64; 2]>> {
    (0..pairs.len())
        .map(|i| {
            let others: Vec<Pair> = [&pairs[..i], &pairs[i + 1..]].concat();
            residual(&solve(i, &others)?, &pairs[i])
        })
        .collect()
}

/// A pair about the centroids, in units of the spread: (u, v) image, (e, n) map; and the root of its weight.
struct Local {
    u: f64,
    v: f64,
    e: f64,
    n: f64,
    root: f64,
}

fn solve(pairs: &[Pair], weights: &[f64], kind: Kind) -> Result<Transform, Unsolvable> {
    if pairs.len() < kind.fewest_points() {
        return Err(Unsolvable::TooFewPoints);
    }
    let (mut transform, local) = normalise(pairs, weights).ok_or(Unsolvable::Degenerate)?;
    let affine = affine(&local)?;
    transform.h = match kind {
        Kind::Affine => affine,
        Kind::Projective => refine(&local, projective(&local)?)?,
    };
    // A transform that squeezes the plane into a line cannot be undone.
    if transform.h.determinant().abs() < RANK * RANK {
        return Err(Unsolvable::Degenerate);
    }
    Ok(transform)
}

fn normalise(pairs: &[Pair], weights: &[f64]) -> Option<(Transform, Vec<Local>)> {
    let n = pairs.len() as f64;
    let (p0, m0) = (pairs[0].pixel, pairs[0].map);
    let mean = |f: &dyn Fn(&Pair) -> f64| pairs.iter().map(f).sum::<f64>() / n;
    // About the first point, so that coordinates of millions of metres lose no digits.
    let pixel_centre = PixelPoint { x: p0.x + mean(&|p| p.pixel.x - p0.x), y: p0.y + mean(&|p| p.pixel.y - p0.y) };
    let map_centre = MapPoint {
        easting: m0.easting + mean(&|p| p.map.easting - m0.easting),
        northing: m0.northing + mean(&|p| p.map.northing - m0.northing),
    };
    let pixel_unit = mean(&|p| (p.pixel.x - pixel_centre.x).powi(2) + (p.pixel.y - pixel_centre.y).powi(2)).sqrt();
    let map_unit =
        mean(&|p| (p.map.easting - map_centre.easting).powi(2) + (p.map.northing - map_centre.northing).powi(2)).sqrt();
    if !(pixel_unit > 0.0 && pixel_unit.is_finite() && map_unit > 0.0 && map_unit.is_finite()) {
        return None;
    }
    let local = pairs
        .iter()
        .zip(weights)
        .map(|(p, weight)| Local {
            u: (p.pixel.x - pixel_centre.x) / pixel_unit,
            v: (p.pixel.y - pixel_centre.y) / pixel_unit,
            e: (p.map.easting - map_centre.easting) / map_unit,
            n: (p.map.northing - map_centre.northing) / map_unit,
            root: weight.sqrt(),
        })
        .collect();
    Some((Transform { h: Matrix3::identity(), pixel_centre, pixel_unit, map_centre, map_unit }, local))
}

/// Equations count as dependent when their smallest singular value is below this part of the largest.
const RANK: f64 = 1e-6;

/// Least squares; `Degenerate` when the columns are dependent.
fn least_squares(design: DMatrix<f64>, right: &DVector<f64>) -> Result<DVector<f64>, Unsolvable> {
    let svd = design.svd(true, true);
    let independent = svd.singular_values.min() > RANK * svd.singular_values.max();
    independent.then(|| svd.solve(right, 0.0).ok()).flatten().ok_or(Unsolvable::Degenerate)
}

fn affine(local: &[Local]) -> Result<Matrix3<f64>, Unsolvable> {
    let design = DMatrix::from_fn(local.len(), 3, |i, c| local[i].root * [local[i].u, local[i].v, 1.0][c]);
    let solved = |right: DVector<f64>| {
        let first = least_squares(design.clone(), &right)?;
        // The singular value decomposition leaves some thousand units in the last place; a second step takes them away.
        let rest = &right - &design * &first;
        Ok(&first + least_squares(design.clone(), &rest)?)
    };
    let e = solved(DVector::from_fn(local.len(), |i, _| local[i].root * local[i].e))?;
    let n = solved(DVector::from_fn(local.len(), |i, _| local[i].root * local[i].n))?;
    Ok(Matrix3::new(e[0], e[1], e[2], n[0], n[1], n[2], 0.0, 0.0, 1.0))
}

fn homography(h: &DVector<f64>) -> Matrix3<f64> {
    Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0)
}

/// The linear solution: the equations multiplied by the denominator, whose last coefficient is 1.
fn projective(local: &[Local]) -> Result<Matrix3<f64>, Unsolvable> {
    let design = DMatrix::from_fn(2 * local.len(), 8, |row, c| {
        let Local { u, v, e, n, root } = local[row / 2];
        let terms = match row % 2 {
            0 => [u, v, 1.0, 0.0, 0.0, 0.0, -u * e, -v * e],
            _ => [0.0, 0.0, 0.0, u, v, 1.0, -u * n, -v * n],
        };
        root * terms[c]
    });
    let right = DVector::from_fn(2 * local.len(), |row, _| {
        let p = &local[row / 2];
        p.root * if row % 2 == 0 { p.e } else { p.n }
    });
    Ok(homography(&least_squares(design, &right)?))
}

/// Weighted misfits on the map, or `None` when a point lies beyond the horizon.
fn misfits(local: &[Local], h: &Matrix3<f64>) -> Option<DVector<f64>> {
    let mut all = DVector::zeros(2 * local.len());
    for (i, p) in local.iter().enumerate() {
        let v = h * Vector3::new(p.u, p.v, 1.0);
        if v.z <= 1e-9 {
            return None;
        }
        all[2 * i] = p.root * (p.e - v.x / v.z);
        all[2 * i + 1] = p.root * (p.n - v.y / v.z);
    }
    Some(all)
}

/// Gauss–Newton from the linear solution; a step that makes the fit worse ends it.
fn refine(local: &[Local], start: Matrix3<f64>) -> Result<Matrix3<f64>, Unsolvable> {
    let mut h = start;
    let mut misfit = misfits(local, &h).ok_or(Unsolvable::Degenerate)?;
    for _ in 0..30 {
        let design = DMatrix::from_fn(2 * local.len(), 8, |row, c| {
            let p = &local[row / 2];
            let v = h * Vector3::new(p.u, p.v, 1.0);
            let (first, second) = (p.u / v.z, p.v / v.z);
            let terms = match row % 2 {
                0 => [first, second, 1.0 / v.z, 0.0, 0.0, 0.0, -first * v.x / v.z, -second * v.x / v.z],
                _ => [0.0, 0.0, 0.0, first, second, 1.0 / v.z, -first * v.y / v.z, -second * v.y / v.z],
            };
            p.root * terms[c]
        });
        let step = least_squares(design, &misfit)?;
        let mut next = homography(&step);
        next[(2, 2)] = 0.0;
        next += h;
        // Near the least misfit the sum of squares no longer tells steps apart; they are small and right all the same.
        let better = |m: &DVector<f64>| m.norm_squared() < misfit.norm_squared() || step.norm() < 1e-6;
        let Some(after) = misfits(local, &next).filter(better) else { break };
        (h, misfit) = (next, after);
        if step.norm() < 1e-13 {
            break;
        }
    }
    Ok(h)
}

/// Why these points may not support this transform, in plain words.
fn warnings(pairs: &[Pair], weights: &[f64], kind: Kind, own: Option<f64>) -> Vec<String> {
    let mut warnings = Vec::new();
    let (points, fewest) = (pairs.len(), kind.fewest_points());
    if points == fewest {
        warnings.push(format!(
            "only {points} points: the residuals of the {} fit are zero by construction and say nothing about accuracy",
            kind.label()
        ));
    } else if points < 2 * fewest {
        warnings.push(format!("only {points} points: {} or more would support the {} fit", 2 * fewest, kind.label()));
    }
    // Weighed alike: what weights gain is no merit of the further parameters.
    let without = |i: usize, others: &[Pair]| {
        let weights = [&weights[..i], &weights[i + 1..]].concat();
        similarity::fit(others, &weights, Handedness::AsIs)
    };
    let similarity = leave_one_out(pairs, without, |s, pair| {
        let c = s.apply(pair.pixel);
        Some([pair.map.easting - c.easting, pair.map.northing - c.northing])
    });
    match (own, similarity.as_deref().map(rms)) {
        (Some(own), Some(simple)) if own >= simple => warnings.push(format!(
            "the points do not support the {} fit: left-out points are missed by {own:.4} m, by {simple:.4} m with a similarity",
            kind.label()
        )),
        (None, _) if points > fewest => warnings.push(format!(
            "the {} fit hangs on single points: without one of them it is not determined",
            kind.label()
        )),
        _ => {}
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs on an irregular spread, mapped by `f`, with errors of `noise_m`.
    fn pairs(n: usize, noise_m: f64, f: impl Fn(f64, f64) -> (f64, f64)) -> Vec<Pair> {
        (0..n)
            .map(|i| {
                let (x, y) = (900.0 * ((i * 7) % 11) as f64, 1100.0 * ((i * 5) % 9) as f64);
                let (e, northing) = f(x, y);
                let error = |k: usize| noise_m * (((i * k) % 7) as f64 - 3.0);
                Pair {
                    pixel: PixelPoint { x, y },
                    covariance_px2: None,
                    map: MapPoint { easting: 570_000.0 + e + error(13), northing: 7_032_000.0 + northing + error(11) },
                    survey_sigma_m: None,
                }
            })
            .collect()
    }

    fn oblique(x: f64, y: f64) -> (f64, f64) {
        let w = 1.0 + 2e-5 * x - 3e-5 * y;
        ((0.03 * x + 0.002 * y) / w, (-0.028 * y + 0.001 * x) / w)
    }

    #[test]
    fn exact_points_are_reproduced_by_the_transform_and_by_its_matrix() {
        let sheared = |x: f64, y: f64| (0.03 * x + 0.002 * y, -0.028 * y + 0.001 * x);
        for (kind, pairs) in [(Kind::Affine, pairs(9, 0.0, sheared)), (Kind::Projective, pairs(9, 0.0, oblique))] {
            let fit = fit(&pairs, kind, Weighting::Equal).expect("well determined");
            assert!(fit.rmse_m < 1e-6, "{kind:?}: {}", fit.rmse_m);
            assert!(fit.leave_one_out_rmse_m.is_some_and(|e| e < 1e-6));
            assert!(fit.warnings.is_empty(), "{:?}", fit.warnings);
            let v = fit.matrix() * Vector3::new(pairs[4].pixel.x, pairs[4].pixel.y, 1.0);
            assert!((v.x / v.z - pairs[4].map.easting).abs() < 1e-4);
        }
    }

    /// A point's error left out is its residual by its redundancy: two ways to the same number.
    #[test]
    fn redundancies_of_an_affine_fit_are_those_of_leaving_points_out() {
        let sheared = |x: f64, y: f64| (0.03 * x + 0.002 * y, -0.028 * y + 0.001 * x);
        let mut pairs = pairs(9, 0.02, sheared);
        for (i, pair) in pairs.iter_mut().enumerate() {
            pair.survey_sigma_m = Some(if i < 4 { 0.005 } else { 0.2 });
        }
        let fit = fit(&pairs, Kind::Affine, Weighting::Stated).expect("well determined");
        let reliability = fit.reliability.expect("nine points");
        assert!((reliability.iter().map(|r| r.redundancy).sum::<f64>() - 6.0).abs() < 1e-9);
        for ((own, residual), left_out) in
            reliability.iter().zip(&fit.residuals_m).zip(fit.leave_one_out_m.expect("nine points"))
        {
            for axis in 0..2 {
                assert!((residual[axis] / own.redundancy - left_out[axis]).abs() < 1e-6, "{own:?}");
            }
            assert!(!own.misfit);
        }
    }

    #[test]
    fn a_wrong_point_of_an_affine_fit_is_its_misfit() {
        let mut wrong = pairs(9, 0.004, |x, y| (0.03 * x + 0.002 * y, -0.028 * y + 0.001 * x));
        wrong[5].map.easting += 0.8;
        let fit = fit(&wrong, Kind::Affine, Weighting::Stated).expect("well determined");
        let misfits: Vec<bool> = fit.reliability.expect("nine points").iter().map(|r| r.misfit).collect();
        assert_eq!(misfits, [false, false, false, false, false, true, false, false, false]);
        assert!(super::fit(&wrong[..3], Kind::Affine, Weighting::Stated).expect("three").reliability.is_none());
    }

    #[test]
    fn the_refined_projective_fit_is_a_minimum() {
        let pairs = pairs(12, 0.2, oblique);
        let fit = fit(&pairs, Kind::Projective, Weighting::Equal).expect("well determined");
        for (row, column) in (0..3).flat_map(|r| (0..3).map(move |c| (r, c))).filter(|at| *at != (2, 2)) {
            for sign in [-1.0, 1.0] {
                let mut other = fit.transform;
                other.h[(row, column)] += sign * 1e-4;
                let residuals: Vec<[f64; 2]> =
                    pairs.iter().map(|p| residual(&other, p).expect("nothing near the horizon")).collect();
                assert!(rms(&residuals) > fit.rmse_m, "entry {row},{column}");
            }
        }
    }

    #[test]
    fn an_orthophoto_with_noise_supports_neither_and_says_so() {
        let pairs = pairs(7, 0.05, |x, y| (0.03 * x, -0.03 * y));
        for kind in [Kind::Affine, Kind::Projective] {
            let fit = fit(&pairs, kind, Weighting::Equal).expect("well determined");
            assert!(fit.warnings.iter().any(|w| w.contains("do not support")), "{kind:?}: {:?}", fit.warnings);
        }
    }

    #[test]
    fn too_few_and_collinear_points_are_refused() {
        let all = pairs(9, 0.0, oblique);
        assert_eq!(fit(&all[..2], Kind::Affine, Weighting::Equal).err(), Some(Unsolvable::TooFewPoints));
        assert_eq!(fit(&all[..3], Kind::Projective, Weighting::Equal).err(), Some(Unsolvable::TooFewPoints));
        assert!(!fit(&all[..3], Kind::Affine, Weighting::Equal).expect("three points are enough").warnings.is_empty());
        let line: Vec<Pair> =
            all.iter().map(|p| Pair { pixel: PixelPoint { x: p.pixel.x, y: 2.0 * p.pixel.x }, ..*p }).collect();
        for kind in [Kind::Affine, Kind::Projective] {
            assert_eq!(fit(&line, kind, Weighting::Equal).err(), Some(Unsolvable::Degenerate), "{kind:?}");
        }
    }
}
