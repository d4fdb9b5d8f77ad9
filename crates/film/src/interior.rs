//! Film ↔ scan: the pose that the search uses, and the interior orientation with residuals and covariance. The least
//! squares are those of [`autoref_solve`].

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::types::{Camera, InteriorModel, InteriorOrientation};
use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};
use autoref_solve::planar;
use autoref_solve::similarity::{Pair, fit_equal_weights};

/// Film (millimetres, y down) → scan: a similarity, perhaps mirrored, seen by a scanner whose axes may differ in scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Row by row, pixels per millimetre.
    pub linear: [f64; 4],
    /// Where the film's origin lies in the scan.
    pub offset: [f64; 2],
    pub mirrored: Handedness,
    pub stretch: Stretch,
}

/// How far a scan's axes differ in scale: natural logarithm of (pixels per millimetre along x / along y); 0 for most
/// scanners.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Stretch(pub f64);

impl Stretch {
    pub const NONE: Stretch = Stretch(0.0);

    /// The place as a scan with equal axes would have it.
    fn undone(self, p: PixelPoint) -> PixelPoint {
        if self == Stretch::NONE {
            return p;
        }
        let by = (0.5 * self.0).exp();
        PixelPoint { x: p.x / by, y: p.y * by }
    }

    /// That of an affine transform film → scan, row by row: how its rows differ in length.
    pub fn of_rows(rows: [[f64; 2]; 2]) -> Stretch {
        Stretch((rows[0][0].hypot(rows[0][1]) / rows[1][0].hypot(rows[1][1])).ln())
    }
}

impl Pose {
    /// The film's `centre_mm` on `centre`, turned clockwise by `turn_deg` after mirroring left to right.
    pub fn about(centre_mm: [f64; 2], centre: PixelPoint, px_per_mm: f64, turn_deg: f64, mirrored: Handedness) -> Pose {
        let (s, c) = turn_deg.to_radians().sin_cos();
        let m = mirrored.sign();
        let linear = [c * m, -s, s * m, c].map(|v| v * px_per_mm);
        let [x, y] = centre_mm;
        let offset = [centre.x - linear[0] * x - linear[1] * y, centre.y - linear[2] * x - linear[3] * y];
        Pose { linear, offset, mirrored, stretch: Stretch::NONE }
    }

    /// The same with the axes' scales apart by so much, the film's `centre_mm` where it was.
    pub(super) fn stretched(self, centre_mm: [f64; 2], stretch: Stretch) -> Pose {
        let at = self.apply(centre_mm);
        let by = (0.5 * stretch.0).exp();
        let [a, b, c, d] = self.linear;
        let linear = [by * a, by * b, c / by, d / by];
        let [x, y] = centre_mm;
        let offset = [at.x - linear[0] * x - linear[1] * y, at.y - linear[2] * x - linear[3] * y];
        Pose { linear, offset, stretch, ..self }
    }

    /// Film (millimetres, y down) → scan (pixels).
    pub fn apply(&self, mm: [f64; 2]) -> PixelPoint {
        let l = &self.linear;
        PixelPoint { x: l[0] * mm[0] + l[1] * mm[1] + self.offset[0], y: l[2] * mm[0] + l[3] * mm[1] + self.offset[1] }
    }

    /// Pixels of a millimetre, the root of its area.
    pub fn px_per_mm(&self) -> f64 {
        let l = &self.linear;
        (l[0] * l[3] - l[1] * l[2]).abs().sqrt()
    }

    /// Clockwise, degrees, where the film's down points relative to the scan's.
    pub fn turn_deg(&self) -> f64 {
        (-self.linear[1]).atan2(self.linear[3]).to_degrees()
    }

    /// Whether it is turned by a quarter or more against another, or mirrored.
    pub fn lies_otherwise(&self, other: &Pose) -> bool {
        let turn_deg = (self.turn_deg() - other.turn_deg()).rem_euclid(360.0);
        self.mirrored != other.mirrored || (45.0..315.0).contains(&turn_deg)
    }

    /// Shape → scan of a mark that is turned clockwise by `turn_deg` on the upright frame.
    pub fn shape_linear(&self, turn_deg: f64) -> [f64; 4] {
        let (s, c) = turn_deg.to_radians().sin_cos();
        let l = &self.linear;
        // Shape (u, v inwards) → film: (c·u + s·v, s·u − c·v).
        [l[0] * c + l[1] * s, l[0] * s - l[1] * c, l[2] * c + l[3] * s, l[2] * s - l[3] * c]
    }
}

fn pair(film: [f64; 2], pixel: PixelPoint, mirrored: Handedness) -> Pair {
    let sign = mirrored.sign();
    Pair {
        pixel: PixelPoint { x: sign * pixel.x, y: pixel.y },
        covariance_px2: None,
        map: MapPoint { easting: film[0], northing: -film[1] },
        survey_sigma_m: None,
    }
}

/// The pose through film points (y down) and their places in a scan whose axes are alike; `None` below two or when they
/// coincide.
pub fn fit_pose(points: &[([f64; 2], PixelPoint)], mirrored: Handedness) -> Option<Pose> {
    fit_stretched(points, mirrored, Stretch::NONE)
}

/// The pose by an affine transform first: how its axes differ in scale is kept, the rest is a similarity. `None` where
/// the points do not determine one, or it is further from a similarity than [`MOST_STRETCH`] and [`MOST_DEFORMED`]
/// allow.
pub fn fit_own_stretch(points: &[([f64; 2], PixelPoint)], mirrored: Handedness) -> Option<Pose> {
    let [x, y] = affine(points)?;
    let stretch = Stretch::of_rows([[x[0], x[1]], [y[0], y[1]]]);
    let pose = fit_stretched(points, mirrored, stretch).filter(|_| stretch.0.abs() <= MOST_STRETCH)?;
    let off = [pose.linear[0] - x[0], pose.linear[1] - x[1], pose.linear[2] - y[0], pose.linear[3] - y[1]];
    let deformed = off.iter().map(|v| v * v).sum::<f64>().sqrt() / pose.px_per_mm();
    (deformed <= MOST_DEFORMED).then_some(pose)
}

/// `pose` through other points of the same frame. A difference of scale between the axes is taken from four points or
/// more, where it makes them fit so much better that it cannot be their errors; else the one of `pose` is kept.
pub fn refit(points: &[([f64; 2], PixelPoint)], pose: &Pose) -> Option<Pose> {
    let kept = fit_stretched(points, pose.mirrored, pose.stretch);
    if points.len() < 4 {
        return kept;
    }
    let plain = fit_pose(points, pose.mirrored)?;
    let own = fit_own_stretch(points, pose.mirrored);
    let tells = |own: &Pose| own.stretch.0.abs() > SURE_STRETCH && rms_px(own, points) < 0.5 * rms_px(&plain, points);
    own.filter(tells).or(Some(plain))
}

/// Film shrinks by up to a tenth of a per cent without its scanner being wrong.
pub(super) const SURE_STRETCH: f64 = 0.003;
/// Difference of scale between a scan's axes that is taken for a scanner's, as a logarithm: scans in archives reach
/// 0.023.
pub const MOST_STRETCH: f64 = 0.035;
/// Shear and shrinkage beside that, which film and scanners may have, of a frame's size.
pub const MOST_DEFORMED: f64 = 0.004;

/// As [`fit_pose`] where the scan's axes differ in scale by what is known.
pub fn fit_stretched(points: &[([f64; 2], PixelPoint)], mirrored: Handedness, stretch: Stretch) -> Option<Pose> {
    let pairs: Vec<Pair> = points.iter().map(|(mm, p)| pair(*mm, stretch.undone(*p), mirrored)).collect();
    let similarity = fit_equal_weights(&pairs)?;
    let sign = mirrored.sign();
    let to_scan = |x: f64, y: f64| {
        let p = similarity.invert(MapPoint { easting: x, northing: -y });
        [sign * p.x, p.y]
    };
    let (o, x, y) = (to_scan(0.0, 0.0), to_scan(1.0, 0.0), to_scan(0.0, 1.0));
    let mut pose = Pose { linear: [x[0] - o[0], y[0] - o[0], x[1] - o[1], y[1] - o[1]], offset: o, mirrored, stretch };
    if stretch != Stretch::NONE {
        let by = (0.5 * stretch.0).exp();
        pose.linear = [by * pose.linear[0], by * pose.linear[1], pose.linear[2] / by, pose.linear[3] / by];
        pose.offset = [by * o[0], o[1] / by];
    }
    pose.linear.iter().chain(&pose.offset).all(|v| v.is_finite()).then_some(pose)
}

/// Film → scan by least squares, x and y rows; `None` below three points or when they lie on a line.
pub fn affine(points: &[([f64; 2], PixelPoint)]) -> Option<[[f64; 3]; 2]> {
    if points.len() < 3 {
        return None;
    }
    let centre = points.iter().fold([0.0, 0.0], |c, p| [c[0] + p.0[0], c[1] + p.0[1]]).map(|v| v / points.len() as f64);
    let (mut normal, mut right) = (Matrix3::<f64>::zeros(), [Vector3::zeros(), Vector3::zeros()]);
    for (mm, p) in points {
        let row = Vector3::new(mm[0] - centre[0], mm[1] - centre[1], 1.0);
        normal += row * row.transpose();
        right[0] += row * p.x;
        right[1] += row * p.y;
    }
    // Nearly on a line: a tenth of the longer extent is the least that carries a prediction.
    let spread = (normal[(0, 0)] + normal[(1, 1)]).max(1e-9);
    let thin = (normal[(0, 0)] * normal[(1, 1)] - normal[(0, 1)].powi(2)) / (spread * spread);
    let inverse = normal.try_inverse().filter(|_| thin > 0.0025)?;
    Some(right.map(|r| {
        let c = inverse * r;
        [c[0], c[1], c[2] - c[0] * centre[0] - c[1] * centre[1]]
    }))
}

/// Root mean square distance, pixels, between the points and what the pose says.
pub fn rms_px(pose: &Pose, points: &[([f64; 2], PixelPoint)]) -> f64 {
    let sum: f64 = points.iter().map(|(mm, p)| distance(pose.apply(*mm), *p).powi(2)).sum();
    (sum / points.len().max(1) as f64).sqrt()
}

/// Pixels between two places.
pub fn distance(a: PixelPoint, b: PixelPoint) -> f64 {
    (a.x - b.x).hypot(a.y - b.y)
}

/// A mark that takes part in the interior orientation.
#[derive(Clone, Debug)]
pub struct Observation {
    pub name: String,
    /// Camera's own axes.
    pub mm: [f64; 2],
    pub pixel: PixelPoint,
    pub covariance_px2: [f64; 3],
}

/// Solves `model`, or the next simpler one that the number of marks determines with redundancy where there is one.
///
/// `None` below two marks or when they are degenerate.
pub fn solve(
    camera: &Camera,
    marks: &[Observation],
    model: InteriorModel,
    mirrored: Handedness,
) -> Option<InteriorOrientation> {
    let model = match (model, marks.len()) {
        (_, 0..=1) => return None,
        (_, 2) => InteriorModel::Similarity,
        // Three marks check no affine transform; but a similarity may be far from scans whose axes differ in scale.
        (InteriorModel::Affine, 3) if three_tell_stretch(camera, marks, mirrored) => InteriorModel::Affine,
        (_, 3) => InteriorModel::Similarity,
        (InteriorModel::Projective, 4) => InteriorModel::Affine,
        (m, _) => m,
    };
    let sign = camera.y_sign();
    let film: Vec<([f64; 2], PixelPoint)> = marks.iter().map(|m| ([m.mm[0], sign * m.mm[1]], m.pixel)).collect();
    let pose = fit_pose(&film, mirrored)?;
    let h = matrix(marks, model, sign, mirrored)?;
    let mut interior = InteriorOrientation {
        model,
        pixel_to_mm: h,
        rmse_um: 0.0,
        sigma0_um: None,
        covariance: vec![],
        marks: marks.iter().map(|m| m.name.clone()).collect(),
        leave_one_out_um: leave_one_out(marks, model, sign, mirrored),
        leave_one_out_rmse_um: None,
        pixel_um: 1e3 / pose.px_per_mm(),
        pixel_xy_um: [h[0].hypot(h[3]), h[1].hypot(h[4])].map(|v| 1e3 * v),
        rotation_deg: pose.turn_deg(),
        mirrored,
    };
    let residuals: Vec<[f64; 2]> =
        marks.iter().map(|m| residual_um(&interior, m.mm, m.pixel)).collect::<Option<Vec<_>>>()?;
    let square: f64 = residuals.iter().map(|r| r[0] * r[0] + r[1] * r[1]).sum();
    let free = match model {
        InteriorModel::Similarity => 4,
        InteriorModel::Affine => 6,
        InteriorModel::Projective => 8,
    };
    interior.rmse_um = (square / marks.len() as f64).sqrt();
    let left_out: Option<Vec<f64>> =
        interior.leave_one_out_um.iter().map(|r| r.map(|r| r[0] * r[0] + r[1] * r[1])).collect();
    interior.leave_one_out_rmse_um = left_out.map(|r| (r.iter().sum::<f64>() / r.len() as f64).sqrt());
    let redundancy = 2 * marks.len() as i64 - free;
    interior.sigma0_um = (redundancy > 0).then(|| (square / redundancy as f64).sqrt());
    interior.covariance = covariance(&interior, marks, sign)?;
    Some(interior)
}

/// Whether three marks fit as those of a scan whose axes differ in scale, and otherwise not.
fn three_tell_stretch(camera: &Camera, marks: &[Observation], mirrored: Handedness) -> bool {
    let sign = camera.y_sign();
    let points: Vec<_> = marks.iter().map(|m| ([m.mm[0], sign * m.mm[1]], m.pixel)).collect();
    fit_own_stretch(&points, mirrored).is_some_and(|p| p.stretch.0.abs() > SURE_STRETCH)
}

/// Measured − calibrated, micrometres, in the camera's axes.
pub fn residual_um(interior: &InteriorOrientation, mm: [f64; 2], pixel: PixelPoint) -> Option<[f64; 2]> {
    interior.to_mm(pixel).map(|at| [1e3 * (at[0] - mm[0]), 1e3 * (at[1] - mm[1])])
}

/// Pixels → millimetres of the camera; `None` when the marks do not determine the model.
fn matrix(marks: &[Observation], model: InteriorModel, sign: f64, mirrored: Handedness) -> Option<[f64; 9]> {
    match model {
        InteriorModel::Similarity => similarity_matrix(marks, sign, mirrored),
        InteriorModel::Affine => planar_matrix(marks, planar::Kind::Affine),
        InteriorModel::Projective => planar_matrix(marks, planar::Kind::Projective),
    }
}

/// Every mark against the model solved from the others.
fn leave_one_out(
    marks: &[Observation],
    model: InteriorModel,
    sign: f64,
    mirrored: Handedness,
) -> Vec<Option<[f64; 2]>> {
    let of = |i: usize| {
        let others = [&marks[..i], &marks[i + 1..]].concat();
        let h = matrix(&others, model, sign, mirrored)?;
        let (p, mm) = (marks[i].pixel, marks[i].mm);
        let w = h[6] * p.x + h[7] * p.y + h[8];
        let at = [(h[0] * p.x + h[1] * p.y + h[2]) / w, (h[3] * p.x + h[4] * p.y + h[5]) / w];
        (w > 0.0).then(|| [0, 1].map(|k| 1e3 * (at[k] - mm[k])))
    };
    (0..marks.len()).map(of).collect()
}

/// The fitted similarity itself, in the camera's axes: turning it over to a pose and back would cost digits.
fn similarity_matrix(marks: &[Observation], sign: f64, mirrored: Handedness) -> Option<[f64; 9]> {
    let pairs: Vec<Pair> = marks.iter().map(|m| pair([m.mm[0], sign * m.mm[1]], m.pixel, mirrored)).collect();
    let g = fit_equal_weights(&pairs)?.geotransform().0;
    let m = mirrored.sign();
    // Northing is −y of the film.
    Some([m * g[1], g[2], g[0], -sign * m * g[4], -sign * g[5], -sign * g[3], 0.0, 0.0, 1.0])
}

fn planar_matrix(marks: &[Observation], kind: planar::Kind) -> Option<[f64; 9]> {
    let pairs: Vec<Pair> = marks
        .iter()
        .map(|m| Pair {
            pixel: m.pixel,
            covariance_px2: None,
            map: MapPoint { easting: m.mm[0], northing: m.mm[1] },
            survey_sigma_m: None,
        })
        .collect();
    let h = planar::fit(&pairs, kind, planar::Weighting::Equal).ok()?.matrix();
    let last = h[(2, 2)];
    (last.abs() > 1e-12).then(|| std::array::from_fn(|k| h[(k / 3, k % 3)] / last))
}

/// Covariance of the free coefficients, which are fitted with equal weights: N⁻¹ J'ΣJ N⁻¹ with N = J'J and Σ from the
/// marks' own covariances on the film, scaled where the residuals are larger than Σ makes them (E. M. Mikhail and F.
/// Ackermann, "Observations and Least Squares", 1976: propagation through a linear estimate).
fn covariance(interior: &InteriorOrientation, marks: &[Observation], sign: f64) -> Option<Vec<Vec<f64>>> {
    let h = &interior.pixel_to_mm;
    let n = match interior.model {
        InteriorModel::Similarity => 4,
        InteriorModel::Affine => 6,
        InteriorModel::Projective => 8,
    };
    let mut jacobian = DMatrix::<f64>::zeros(2 * marks.len(), n);
    let mut variances = Vec::with_capacity(2 * marks.len());
    let mut misfit = 0.0;
    // Pixels are scaled so that the normal matrix keeps its digits.
    let unit = marks.iter().map(|m| m.pixel.x.abs().max(m.pixel.y.abs())).fold(1.0, f64::max);
    let mirror = interior.mirrored.sign();
    for (i, m) in marks.iter().enumerate() {
        let (x, y) = (m.pixel.x / unit, m.pixel.y / unit);
        let w = h[6] * m.pixel.x + h[7] * m.pixel.y + h[8];
        let at = interior.to_mm(m.pixel)?;
        let rows: [Vec<f64>; 2] = match interior.model {
            InteriorModel::Similarity => [vec![mirror * x, -y, 1.0, 0.0], vec![sign * y, sign * mirror * x, 0.0, 1.0]],
            InteriorModel::Affine => [vec![x, y, 1.0, 0.0, 0.0, 0.0], vec![0.0, 0.0, 0.0, x, y, 1.0]],
            InteriorModel::Projective => [
                vec![x / w, y / w, 1.0 / w, 0.0, 0.0, 0.0, -at[0] * x / w, -at[0] * y / w],
                vec![0.0, 0.0, 0.0, x / w, y / w, 1.0 / w, -at[1] * x / w, -at[1] * y / w],
            ],
        };
        let pixel_mm = interior.pixel_um / 1e3;
        // One number per mark: the marks' error ellipses are nearly round.
        let variance = (0.5 * (m.covariance_px2[0] + m.covariance_px2[2]) * pixel_mm * pixel_mm).max(1e-10);
        for (axis, row) in rows.iter().enumerate() {
            row.iter().enumerate().for_each(|(a, v)| jacobian[(2 * i + axis, a)] = *v);
            variances.push(variance);
        }
        let r = residual_um(interior, m.mm, m.pixel)?;
        misfit += (r[0] * r[0] + r[1] * r[1]) * 1e-6 / variance;
    }
    let gain = (jacobian.transpose() * &jacobian).try_inverse()? * jacobian.transpose();
    let spread = DMatrix::from_diagonal(&DVector::from_vec(variances.clone()));
    let leaves = DMatrix::identity(variances.len(), variances.len()) - &jacobian * &gain;
    // What the residuals would add up to if Σ were true.
    let left = (&leaves * &spread * leaves.transpose()).diagonal();
    let expected: f64 = left.iter().zip(&variances).map(|(left, variance)| left / variance).sum();
    let scale = if 2 * marks.len() > n { (misfit / expected).max(1.0) } else { 1.0 };
    let inverse = &gain * spread * gain.transpose() * scale;
    let in_pixels = |k: usize| match (interior.model, k) {
        (InteriorModel::Similarity, 0 | 1) => 1.0 / unit,
        (InteriorModel::Affine | InteriorModel::Projective, 0 | 1 | 3 | 4 | 6 | 7) => 1.0 / unit,
        _ => 1.0,
    };
    Some((0..n).map(|a| (0..n).map(|b| inverse[(a, b)] * in_pixels(a) * in_pixels(b)).collect()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::load_camera;
    use autoref_raster::random::SplitMix64;

    fn observed(camera: &Camera, pose: &Pose) -> Vec<Observation> {
        let film = camera.film_points();
        camera
            .marks
            .iter()
            .zip(film)
            .map(|(m, mm)| Observation {
                name: m.name.clone(),
                mm: [m.x_mm.expect("known"), m.y_mm.expect("known")],
                pixel: pose.apply(mm),
                covariance_px2: [0.01, 0.0, 0.01],
            })
            .collect()
    }

    #[test]
    fn residuals_are_micrometres_on_the_film() {
        let camera = load_camera("wild-15-4").expect("built in");
        let pose = Pose::about(camera.film_centre(), PixelPoint { x: 6000.0, y: 5900.0 }, 50.0, 0.0, Handedness::AsIs);
        let marks = observed(&camera, &pose);
        let interior = solve(&camera, &marks, InteriorModel::Similarity, Handedness::AsIs).expect("well determined");
        // 50 px to a millimetre: a pixel aside is 20 µm.
        let beside = PixelPoint { x: marks[0].pixel.x + 1.0, y: marks[0].pixel.y };
        let [x, y] = residual_um(&interior, marks[0].mm, beside).expect("regular");
        assert!((x.hypot(y) - 20.0).abs() < 1e-6, "{x} {y}");
    }

    #[test]
    fn every_model_gives_back_an_exact_frame_turned_and_mirrored() {
        for name in ["svalbard-zeiss-1936", "wild-15-4"] {
            let camera = load_camera(name).expect("built in");
            for (turn, mirrored) in [(0.0, Handedness::AsIs), (91.0, Handedness::AsIs), (-178.0, Handedness::Mirrored)]
            {
                let pose = Pose::about(camera.film_centre(), PixelPoint { x: 6000.0, y: 5900.0 }, 70.0, turn, mirrored);
                let marks = observed(&camera, &pose);
                for model in [InteriorModel::Similarity, InteriorModel::Affine, InteriorModel::Projective] {
                    let interior = solve(&camera, &marks, model, mirrored).expect("well determined");
                    assert!(interior.rmse_um < 1e-3, "{name} {model:?}: {}", interior.rmse_um);
                    assert!((interior.pixel_um - 1e3 / 70.0).abs() < 1e-6);
                    let back = interior.to_pixel(marks[1].mm).expect("regular");
                    assert!(distance(back, marks[1].pixel) < 1e-6);
                    assert!(interior.covariance.iter().enumerate().all(|(k, row)| row[k] > 0.0));
                }
            }
        }
    }

    /// Two marks that a person placed beside two that were measured: the stated covariance is that of the fit, which
    /// weighs them alike, and scatters as drawn errors do.
    #[test]
    fn the_covariance_is_that_of_equal_weights() {
        let camera = load_camera("wild-15-4").expect("built in");
        let pose = Pose::about(camera.film_centre(), PixelPoint { x: 6000.0, y: 5900.0 }, 50.0, 3.0, Handedness::AsIs);
        let exact: Vec<Observation> = observed(&camera, &pose).into_iter().take(4).collect();
        let sigmas = [0.02, 0.3, 0.02, 0.3];
        let mut random = SplitMix64(7);
        let (mut squares, mut stated, draws) = (0.0, 0.0, 400);
        for _ in 0..draws {
            let mut marks = exact.clone();
            for (mark, sigma) in marks.iter_mut().zip(sigmas) {
                let variance: f64 = sigma * sigma;
                (mark.covariance_px2) = [variance, 0.0, variance];
                mark.pixel.x += sigma * random.normal();
                mark.pixel.y += sigma * random.normal();
            }
            let interior = solve(&camera, &marks, InteriorModel::Affine, Handedness::AsIs).expect("well determined");
            let at = exact[2].pixel;
            let row = [at.x, at.y, 1.0];
            let variance: f64 = (0..9).map(|k| row[k / 3] * interior.covariance[k / 3][k % 3] * row[k % 3]).sum();
            squares += (interior.to_mm(at).expect("regular")[0] - exact[2].mm[0]).powi(2) / f64::from(draws);
            stated += variance / f64::from(draws);
        }
        let ratio = (squares / stated).sqrt();
        // Residuals that come out large by chance widen what is stated, small ones do not narrow it.
        assert!((0.7..1.1).contains(&ratio), "{ratio}");
    }
}
