//! Space resection: the pose of one photograph from points of known place.
//!
//! Three points give up to four poses (Grunert 1841, as in Haralick et al. 1994, *Review and Analysis of Solutions of
//! the Three Point Perspective Pose Estimation Problem*, eq. 9); the pose that most points agree with is refined by
//! least squares.

use nalgebra::{Matrix2, Matrix4, SMatrix, Vector2, Vector3};

use crate::bundle::{
    BundleCamera, BundleFrame, BundlePoint, Loss, Observation, Options, Problem, Treatment, Trust, factor, solve,
};
use crate::camera::{Camera, Parameter};
use crate::error::{Error, Result};
use crate::pose::{Pose, Similarity};

/// A point with its pixel.
#[derive(Clone, Debug)]
pub struct Seen {
    pub name: String,
    pub xyz: Vector3<f64>,
    /// 1σ on the ground, metres; 0 of what is exact.
    pub sigma_m: Vector3<f64>,
    pub pixel: [f64; 2],
}

/// What is known besides the points.
#[derive(Clone, Debug)]
pub struct ResectOptions {
    /// 1σ of the points in the image.
    pub sigma_px: f64,
    /// Known position with standard deviations.
    pub position: Option<(Vector3<f64>, Vector3<f64>)>,
    /// Whether the focal length is sought too.
    pub focal: Focal,
    /// Residuals beyond this many of their own standard deviations name a blunder.
    pub critical: f64,
}

/// Whether the focal length is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Focal {
    Known,
    Sought,
}

impl Default for ResectOptions {
    fn default() -> Self {
        ResectOptions { sigma_px: 1.0, position: None, focal: Focal::Known, critical: 4.0 }
    }
}

/// The pose with its accuracy.
#[derive(Clone, Debug)]
pub struct Resection {
    pub camera: Camera,
    pub pose: Pose,
    /// Turn (radians) and centre; `None` without redundancy and prior knowledge.
    pub covariance: Option<SMatrix<f64, 6, 6>>,
    /// Predicted − measured, pixels, of every point in order; `None` behind the camera.
    pub residuals_px: Vec<Option<[f64; 2]>>,
    /// Indices of points that were taken out as blunders.
    pub blunders: Vec<usize>,
    /// Of the points kept: √(mean of the squares of the residuals in x and in y).
    pub rms_px: f64,
    /// √(v'Pv / redundancy) with the σ that were stated; `None` without redundancy.
    pub sigma0: Option<f64>,
    /// How many times as large the deviations are as those that follow from what was stated: √(v'Pv / redundancy) where
    /// it is too large for chance, else 1. It is in `covariance`.
    pub widened: f64,
    /// Other poses that see the points as well: three points allow up to four, and nothing but a known position tells.
    pub alternatives: Vec<Pose>,
}

/// The poses that see three points along three unit vectors.
pub fn three_points(world: &[Vector3<f64>; 3], rays: &[Vector3<f64>; 3]) -> Vec<Pose> {
    let square = |a: &Vector3<f64>, b: &Vector3<f64>| (a - b).norm_squared();
    let (a, b, c) = (square(&world[1], &world[2]), square(&world[0], &world[2]), square(&world[0], &world[1]));
    let (ca, cb, cg) = (rays[1].dot(&rays[2]), rays[0].dot(&rays[2]), rays[0].dot(&rays[1]));
    if b <= 0.0 || a <= 0.0 || c <= 0.0 {
        return Vec::new();
    }
    let (q, s, ab, cbq) = ((a - c) / b, (a + c) / b, a / b, c / b);
    let a4 = (q - 1.0).powi(2) - 4.0 * cbq * ca * ca;
    let a3 = 4.0 * (q * (1.0 - q) * cb - (1.0 - s) * ca * cg + 2.0 * cbq * ca * ca * cb);
    let a2 = 2.0
        * (q * q - 1.0 + 2.0 * q * q * cb * cb + 2.0 * (1.0 - cbq) * ca * ca - 4.0 * s * ca * cb * cg
            + 2.0 * (1.0 - ab) * cg * cg);
    let a1 = 4.0 * (-q * (1.0 + q) * cb + 2.0 * ab * cg * cg * cb - (1.0 - s) * ca * cg);
    let a0 = (1.0 + q).powi(2) - 4.0 * ab * cg * cg;
    let mut poses = Vec::new();
    let pairs = quartic([a0, a1, a2, a3, a4]).into_iter().filter(|v| *v > 0.0).flat_map(|v| {
        let length = b / (1.0 + v * v - 2.0 * v * cb);
        let below = 2.0 * (cg - v * ca);
        let of_u = |u: f64| (u, v, length);
        if below.abs() > 1e-6 {
            return vec![of_u(((q - 1.0) * v * v - 2.0 * q * cb * v + 1.0 + q) / below)];
        }
        // Here the second cosine law says nothing of u; the third, u² − 2·cos γ·u + 1 = c / s₁², has two solutions.
        let half = (cg * cg - 1.0 + c / length).max(0.0).sqrt();
        if half == 0.0 { vec![of_u(cg)] } else { vec![of_u(cg - half), of_u(cg + half)] }
    });
    for (u, v, length) in pairs {
        let off = length * (u * u + v * v - 2.0 * u * v * ca) - a;
        if u <= 0.0 || length <= 0.0 || off.abs() > 1e-4 * a {
            continue;
        }
        let s1 = length.sqrt();
        let camera = [rays[0] * s1, rays[1] * (u * s1), rays[2] * (v * s1)];
        if let Some(fit) = Similarity::fit(world, &camera, &[1.0; 3]) {
            let mean = |p: &[Vector3<f64>; 3]| (p[0] + p[1] + p[2]) / 3.0;
            let centre = mean(world) - fit.rotation.transpose() * mean(&camera);
            poses.push(Pose { rotation: fit.rotation, centre });
        }
    }
    poses
}

/// Real roots, by the eigenvalues of the companion matrix and two steps of Newton.
fn quartic(c: [f64; 5]) -> Vec<f64> {
    let largest = c.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if c[4].abs() < 1e-13 * largest || largest == 0.0 || !largest.is_finite() {
        return Vec::new();
    }
    let mut m = Matrix4::zeros();
    for i in 0..4 {
        m[(i, 3)] = -c[i] / c[4];
        if i > 0 {
            m[(i, i - 1)] = 1.0;
        }
    }
    let Some(schur) = nalgebra::linalg::Schur::try_new(m, 1e-14, 500) else { return Vec::new() };
    let mut roots = Vec::new();
    for z in schur.complex_eigenvalues().iter() {
        if z.im.abs() > 1e-4 * (1.0 + z.re.abs()) {
            continue;
        }
        let mut x = z.re;
        for _ in 0..3 {
            let f = (((c[4] * x + c[3]) * x + c[2]) * x + c[1]) * x + c[0];
            let d = ((4.0 * c[4] * x + 3.0 * c[3]) * x + 2.0 * c[2]) * x + c[1];
            if d != 0.0 && (f / d).abs() < 0.1 * (1.0 + x.abs()) {
                x -= f / d;
            }
        }
        roots.push(x);
    }
    roots
}

/// Whether the points lie on a line or at one place, to a thousandth of their extent.
fn are_in_line(seen: &[Seen]) -> bool {
    let Some(far) = seen.iter().map(|s| s.xyz - seen[0].xyz).max_by(|a, b| a.norm().total_cmp(&b.norm())) else {
        return true;
    };
    let along = far.normalize();
    let beside = |s: &Seen| (s.xyz - seen[0].xyz).cross(&along).norm();
    far.norm() == 0.0 || seen.iter().all(|s| beside(s) <= 1e-3 * far.norm())
}

/// Focal lengths of cameras, in sides of their images: beyond, an object far off would do as well.
const FOCAL_SIDES: std::ops::Range<f64> = 0.15..12.0;

/// Starts that are refined, beside the best one of each focal length.
const BEST_STARTS: usize = 12;

/// Points that starts are compared by, at most.
const MOST_ASKED: usize = 200;

/// Finds the pose; wrong points are named.
///
/// # Errors
/// With fewer than three points (four when the focal length is sought), or when no pose sees them.
pub fn resect(camera: &Camera, seen: &[Seen], options: &ResectOptions) -> Result<Resection> {
    let least = if options.focal == Focal::Sought { 4 } else { 3 };
    if seen.len() < least {
        return Err(Error::no_result(
            format!("{} points are seen in the frame, {least} are needed", seen.len()),
            match options.focal {
                Focal::Known => "measure more points",
                Focal::Sought => "measure more points, or state the focal length",
            },
        ));
    }
    let cameras: Vec<Camera> = match options.focal {
        Focal::Known => vec![camera.clone()],
        Focal::Sought => {
            let side = camera.size_px[0].max(camera.size_px[1]);
            (0..48).map(|i| camera.clone().with(Parameter::F, side * 0.35 * 1.09f64.powi(i))).collect()
        }
    };
    let judging = judging(seen, options);
    // Which starts are good, some tell as well as all.
    let some: Vec<Seen> = seen.iter().step_by(seen.len().div_ceil(MOST_ASKED)).cloned().collect();
    let mut best: Vec<(f64, Camera, Pose)> = Vec::new();
    for camera in &cameras {
        for pose in starts(camera, seen, options) {
            let score = disagreement(camera, &pose, &some, &judging);
            best.push((score, camera.clone(), pose));
        }
    }
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    let as_well: Vec<Pose> = match options.position {
        None if places(seen) == 3 => {
            let good = |b: &&(f64, Camera, Pose)| b.0 <= AS_GOOD * options.sigma_px.powi(2) + BELOW_GROUND;
            best.iter().filter(good).map(|b| b.2).collect()
        }
        _ => Vec::new(),
    };
    let (result, is_open) = refined(best, seen, options);
    let mut found = result.ok_or_else(|| {
        if are_in_line(seen) {
            return Error::no_result(
                "the points lie on one line, or at one place, and leave the pose open",
                "measure a point to the side of it",
            );
        }
        if is_open {
            return Error::no_result("the points leave the focal length open", "give it: --f-px, or --camera");
        }
        Error::no_result(
            "no pose sees the points where they were measured",
            "check the focal length, the order of the coordinates and whether pixels count from the upper left corner",
        )
    })?;
    // Poses nearer to each other than a hundredth of the distance to the ground are one.
    let range = (found.pose.centre - seen[0].xyz).norm();
    for pose in as_well {
        let known = std::iter::once(&found.pose).chain(&found.alternatives);
        if known.into_iter().all(|other| (other.centre - pose.centre).norm() > 0.01 * range) {
            found.alternatives.push(pose);
        }
    }
    Ok(found)
}

/// A mean squared distance of so many times the variance that is stated is as good as none.
const AS_GOOD: f64 = 18.0;
/// What speaks against a camera below its points, px².
const BELOW_GROUND: f64 = 1.0;

/// The resection that the better part of the points agrees with best, from the best starts; and whether one was passed
/// over that leaves the focal length open.
fn refined(mut best: Vec<(f64, Camera, Pose)>, seen: &[Seen], options: &ResectOptions) -> (Option<Resection>, bool) {
    let judging = judging(seen, options);
    // Wrong points can lead the best starts to one wrong focal length: the best of each is tried as well.
    let mut tried: Vec<f64> = Vec::new();
    let mut rank = 0;
    best.retain(|(_, camera, _)| {
        let is_new = !tried.contains(&camera.f_px());
        if is_new {
            tried.push(camera.f_px());
        }
        rank += 1;
        is_new || rank <= BEST_STARTS
    });
    let mut result: Option<(f64, Resection)> = None;
    let mut is_open = false;
    let is_good = |result: &Option<(f64, Resection)>| {
        result.as_ref().is_some_and(|(score, _)| *score <= AS_GOOD * options.sigma_px.powi(2))
    };
    for (rank, (_, camera, pose)) in best.into_iter().enumerate() {
        if rank >= BEST_STARTS && is_good(&result) {
            break;
        }
        // Gross errors may carry the focal length away before they are named: it is held until then as well.
        let held_too = (options.focal == Focal::Sought).then_some(Focal::Known);
        for (way, at_first) in std::iter::once(options.focal).chain(held_too).enumerate() {
            if way > 0 && is_good(&result) {
                break;
            }
            let Ok(found) = refine(&camera, &pose, seen, options, at_first) else { continue };
            let sides = found.camera.f_px() / camera.size_px[0].max(camera.size_px[1]);
            if options.focal == Focal::Sought && !FOCAL_SIDES.contains(&sides) {
                is_open = true;
                continue;
            }
            let score = disagreement(&found.camera, &found.pose, seen, &judging);
            if result.as_ref().is_none_or(|r| score < r.0) {
                result = Some((score, found));
            }
        }
    }
    (result.map(|(_, found)| found), is_open)
}

/// How many different places the points have.
fn places(seen: &[Seen]) -> usize {
    (0..seen.len()).filter(|i| seen[..*i].iter().all(|other| other.xyz != seen[*i].xyz)).count()
}

/// Poses of all triples, or of 400 drawn ones.
fn starts(camera: &Camera, seen: &[Seen], options: &ResectOptions) -> Vec<Pose> {
    let rays: Vec<Option<Vector3<f64>>> = seen.iter().map(|s| camera.ray(s.pixel).map(Vector3::from)).collect();
    let n = seen.len();
    let mut triples = Vec::new();
    if n <= 13 {
        for i in 0..n {
            for j in i + 1..n {
                for k in j + 1..n {
                    triples.push([i, j, k]);
                }
            }
        }
    } else {
        let mut state = 0x9E37_79B9_7F4A_7C15u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % n
        };
        while triples.len() < 400 {
            let t = [draw(), draw(), draw()];
            if t[0] != t[1] && t[1] != t[2] && t[0] != t[2] {
                triples.push(t);
            }
        }
    }
    let mut poses = Vec::new();
    for t in triples {
        let (Some(a), Some(b), Some(c)) = (rays[t[0]], rays[t[1]], rays[t[2]]) else { continue };
        let world = t.map(|i| seen[i].xyz);
        poses.extend(three_points(&world, &[a, b, c]));
    }
    if let Some((at, _)) = &options.position {
        poses.sort_by(|p, q| (p.centre - at).norm().total_cmp(&(q.centre - at).norm()));
    }
    poses
}

/// How far from its pixel a point may be seen, 1σ, pixels: by the measurement and by its place on the ground.
fn expected_px(camera: &Camera, pose: &Pose, seen: &Seen, sigma_px: f64) -> f64 {
    let depth = pose.to_camera(&seen.xyz).z.abs().max(f64::MIN_POSITIVE);
    sigma_px.hypot(camera.f_px() * seen.sigma_m.max() / depth)
}

/// Mean of the better part of the squared distances, in the variance of a measurement (all but a third, at least three
/// and one more where there is one), and how far a known position is missed.
fn disagreement(camera: &Camera, pose: &Pose, seen: &[Seen], options: &ResectOptions) -> f64 {
    let mut d: Vec<f64> = seen
        .iter()
        .map(|s| {
            camera.project(pose.to_camera(&s.xyz).into()).map_or(1e9, |p| {
                let share = options.sigma_px / expected_px(camera, pose, s, options.sigma_px);
                (((p[0] - s.pixel[0]).powi(2) + (p[1] - s.pixel[1]).powi(2)) * share.powi(2)).min(1e9)
            })
        })
        .collect();
    d.sort_by(f64::total_cmp);
    let keep = (seen.len() - seen.len() / 3).max(4).min(seen.len());
    let mut score = d[..keep].iter().sum::<f64>() / keep as f64;
    if let Some((at, sigma)) = &options.position {
        score += (pose.centre - at).component_div(sigma).norm_squared() * options.sigma_px.powi(2) / keep as f64;
    } else if seen.len() == 3 {
        // Three points: cameras stand above the ground more often than below it.
        let mean = seen.iter().map(|s| s.xyz.z).sum::<f64>() / 3.0;
        score += if pose.centre.z < mean { BELOW_GROUND } else { 0.0 };
    }
    score
}

fn problem(camera: &Camera, pose: &Pose, seen: &[Seen], options: &ResectOptions, trust: Trust) -> Problem {
    let mut bundle = BundleCamera::held(camera.clone());
    if options.focal == Focal::Sought {
        bundle = bundle.treat(Parameter::F, Treatment::Free);
    }
    let spread = seen.iter().map(|s| (s.xyz - seen[0].xyz).norm()).fold(0.0, f64::max);
    // Exact points are held by a σ that no residual notices.
    let sigma = |s: &Seen| s.sigma_m.map(|sigma| if sigma > 0.0 { sigma } else { spread * 1e-7 });
    Problem {
        cameras: vec![bundle],
        frames: vec![BundleFrame { camera: 0, pose: *pose, position: options.position, direction: None }],
        points: seen.iter().map(|s| BundlePoint { xyz: s.xyz, survey: Some((s.xyz, sigma(s))) }).collect(),
        observations: seen
            .iter()
            .enumerate()
            .map(|(i, s)| Observation { frame: 0, point: i, pixel: s.pixel, sigma_px: options.sigma_px, trust })
            .collect(),
    }
}

fn unknowns(options: &ResectOptions) -> usize {
    6 + usize::from(options.focal == Focal::Sought)
}

/// How points are judged. A known position may be what is wrong: where the points can do without it, it has no say.
fn judging(seen: &[Seen], options: &ResectOptions) -> ResectOptions {
    let counts = 2 * seen.len() < unknowns(options) + 4;
    ResectOptions { position: options.position.filter(|_| counts), ..options.clone() }
}

/// From a start to the end; `at_first` is what becomes of the focal length until the points far off are named.
fn refine(camera: &Camera, pose: &Pose, seen: &[Seen], options: &ResectOptions, at_first: Focal) -> Result<Resection> {
    let robust = Options { loss: Loss::Cauchy(2.0), ..Options::default() };
    let unknowns = unknowns(options);
    let first = judging(seen, options);
    let mut position_counts = first.position.is_some() || options.position.is_none();
    let mut at = problem(camera, pose, seen, &ResectOptions { focal: at_first, ..first.clone() }, Trust::Robust);
    if seen.len() > 3 {
        solve(&mut at, &robust)?;
    }
    let (mut camera, mut pose) = (at.cameras[0].camera.clone(), at.frames[0].pose);
    let mut blunders = far_off(&camera, &pose, seen, options);
    let mut kept: Vec<usize> = (0..seen.len()).filter(|i| !blunders.contains(i)).collect();
    let mut aside = blunders.len();
    loop {
        let subset: Vec<Seen> = kept.iter().map(|i| seen[*i].clone()).collect();
        let now = ResectOptions { position: options.position.filter(|_| position_counts), ..options.clone() };
        let mut at = problem(&camera, &pose, &subset, &now, Trust::Full);
        let plain = Options { loss: Loss::Squared, ..Options::default() };
        let summary = solve(&mut at, &plain)?;
        (camera, pose) = (at.cameras[0].camera.clone(), at.frames[0].pose);
        let known = 2 * kept.len() + if now.position.is_some() { 3 } else { 0 };
        let redundancy = known.saturating_sub(unknowns);
        let sigma0 = (redundancy > 0).then(|| (2.0 * summary.cost / redundancy as f64).sqrt());
        let factored = factor(&at, Loss::Squared);
        // What was set aside from afar may be right after all.
        if let Some(f) = factored.as_ref().filter(|_| aside > 0) {
            let unit = (sigma0.unwrap_or(1.0) / least_share(redundancy)).max(1.0);
            let right = |i: &usize| off_by(&camera, &pose, f, &seen[*i], options) <= options.critical * unit;
            let back: Vec<usize> = blunders[..aside].iter().copied().filter(right).collect();
            blunders.retain(|i| !back.contains(i));
            aside = 0;
            if !back.is_empty() {
                kept.extend(back);
                kept.sort_unstable();
                continue;
            }
        }
        // The worst normalised residual, as long as the rest still fixes the pose with something to spare, and only
        // where the points are judged: later on, a wrong position would make some of them look wrong.
        let judged = options.position.is_none() || !position_counts || first.position.is_some();
        let spare = known >= unknowns + 3 && kept.len() > 4 && judged;
        let left = (2.0 * summary.cost, redundancy);
        let worst = factored.as_ref().filter(|_| spare).map(|f| worst_points(&at, f, &subset, options, left));
        if let Some(worst) = worst.filter(|worst| !worst.is_empty()) {
            blunders.extend(worst.iter().map(|index| kept[*index]));
            kept.retain(|i| !blunders.contains(i));
            continue;
        }
        if !position_counts {
            position_counts = true;
            continue;
        }
        let residuals_px: Vec<Option<[f64; 2]>> = seen
            .iter()
            .map(|s| camera.project(pose.to_camera(&s.xyz).into()).map(|p| [p[0] - s.pixel[0], p[1] - s.pixel[1]]))
            .collect();
        if kept.iter().any(|i| residuals_px[*i].is_none()) {
            return Err(Error::no_result("a point lies behind the camera", "check the points"));
        }
        let widened = excess(sigma0, redundancy);
        let sum: f64 = kept.iter().filter_map(|i| residuals_px[*i]).map(|r| r[0] * r[0] + r[1] * r[1]).sum();
        blunders.sort_unstable();
        return Ok(Resection {
            covariance: factored.map(|f| f.frame(0) * widened.powi(2)),
            widened,
            rms_px: (sum / (2 * kept.len()) as f64).sqrt(),
            camera,
            pose,
            residuals_px,
            blunders,
            sigma0,
            alternatives: Vec::new(),
        });
    }
}

/// Points that lie far from a robust pose: by that of all together, two of ten hide each other.
fn far_off(camera: &Camera, pose: &Pose, seen: &[Seen], options: &ResectOptions) -> Vec<usize> {
    /// Times the spread of all, and the share of all that is not too many.
    const GROSS: f64 = 16.0;
    const MOST: f64 = 0.35;
    /// More than that many measurements must be left: few points fit many poses.
    const LEFT: usize = 8;
    let off: Vec<f64> = seen
        .iter()
        .map(|s| {
            let at = camera.project(pose.to_camera(&s.xyz).into());
            let share = options.sigma_px / expected_px(camera, pose, s, options.sigma_px);
            at.map_or(f64::INFINITY, |p| (p[0] - s.pixel[0]).hypot(p[1] - s.pixel[1]) * share)
        })
        .collect();
    let mut sorted = off.clone();
    sorted.sort_by(f64::total_cmp);
    // The median length of a normal 2-vector is 1.1774 σ.
    let spread = (sorted[sorted.len() / 2] / 1.1774).max(options.sigma_px);
    let far: Vec<usize> = (0..seen.len()).filter(|i| off[*i] > GROSS * spread).collect();
    let left = 2 * (seen.len() - far.len());
    let needed = if options.focal == Focal::Sought { 7 + LEFT + 2 } else { 6 + LEFT };
    if far.len() as f64 > MOST * seen.len() as f64 || left < needed { Vec::new() } else { far }
}

/// Of so many squares of normal numbers, the root of the share of their expected sum at a normal quantile (Wilson and
/// Hilferty, 1931).
fn share(redundancy: usize, quantile: f64) -> f64 {
    let ninth = 2.0 / (9.0 * redundancy.max(1) as f64);
    (1.0 - ninth + quantile * ninth.sqrt()).max(0.2).powi(3).sqrt()
}

/// The normal number that one in a hundred exceeds.
const ONE_PERCENT: f64 = 2.326;

/// What one set in a hundred does not reach: points that were chosen because they fit spread less than others.
fn least_share(redundancy: usize) -> f64 {
    share(redundancy, -ONE_PERCENT)
}

/// σ₀ where the points fit worse than one set in a hundred would by chance: how many times as large all deviations are
/// as those that follow from what was stated. Else 1.
fn excess(sigma0: Option<f64>, redundancy: usize) -> f64 {
    sigma0.filter(|s| *s > share(redundancy, ONE_PERCENT)).unwrap_or(1.0)
}

/// How far a point that took no part lies from where the pose has it, in standard deviations of both.
fn off_by(
    camera: &Camera,
    pose: &Pose,
    factored: &crate::bundle::Factored,
    seen: &Seen,
    options: &ResectOptions,
) -> f64 {
    let local = pose.to_camera(&seen.xyz);
    let (at, j) = camera.project_with_jacobian(local.into());
    let j = nalgebra::Matrix2x3::from_fn(|r, c| j[r][c]) * pose.rotation;
    // A turn about the camera moves the point by its distance: the covariance of both, in the image.
    let moved = nalgebra::Matrix3x6::from_fn(|r, c| if c < 3 { 0.0 } else { f64::from(u8::from(r == c - 3)) });
    let turned = (pose.rotation.transpose() * local).cross_matrix() * pose.rotation.transpose();
    let all = moved + nalgebra::Matrix3x6::from_fn(|r, c| if c < 3 { turned[(r, c)] } else { 0.0 });
    let q = j * all * factored.frame(0) * all.transpose() * j.transpose()
        + Matrix2::identity() * options.sigma_px.powi(2)
        + j * nalgebra::Matrix3::from_diagonal(&seen.sigma_m.component_mul(&seen.sigma_m)) * j.transpose();
    let v = Vector2::new(at[0] - seen.pixel[0], at[1] - seen.pixel[1]);
    let inverse = q.try_inverse().filter(|_| local.z > 0.0);
    inverse.map_or(f64::INFINITY, |inverse| v.dot(&(inverse * v)).sqrt())
}

/// Of so many points one at a time is judged wrong: in larger nets, where none hides another, as many as hold these
/// together.
const NET: usize = 50;

/// The point whose residual is largest against its own standard deviation, if beyond the critical value. The σ stated
/// may be too small for the whole net: then a point is wrong when it is beyond the critical value in units of the
/// others' spread (by their median: several may be wrong), or when the others fit so much better without it as chance
/// would have it for the worst of them once in twenty sets (Fisher's test on the sum of squares that it accounts for,
/// with Bonferroni's bound). `left` is the sum of squares of all and the redundancy. Of a large net the worst ones,
/// by the first of these rules.
fn worst_points(
    at: &Problem,
    factored: &crate::bundle::Factored,
    seen: &[Seen],
    options: &ResectOptions,
    left: (f64, usize),
) -> Vec<usize> {
    let Some(tests) = normalised(at, factored, seen) else { return Vec::new() };
    let mut worst: Vec<usize> = (0..tests.len()).collect();
    worst.sort_by(|a, b| tests[*b].total_cmp(&tests[*a]));
    // The median length of a normal 2-vector is 1.1774 σ.
    let unit = (tests[worst[(worst.len() - 1) / 2]] / 1.1774).max(1.0);
    worst.truncate((tests.len() / NET).max(1));
    let most = tests[worst[0]];
    let rest = left.1.saturating_sub(2) as f64;
    // Of F with 2 and n degrees of freedom: P(F > x) = (1 + 2x/n)^(−n/2).
    let ratio = most * most / (left.0 - most * most).max(f64::MIN_POSITIVE);
    let by_chance = if rest > 0.0 { (1.0 + ratio).powf(-rest / 2.0) * tests.len() as f64 } else { 1.0 };
    let first = worst[0];
    worst.retain(|i| {
        tests[*i] > options.critical && (tests[*i] > options.critical * unit || (*i == first && by_chance < 0.05))
    });
    worst
}

/// The residual of each point against its standard deviation; `None` where one lies behind the camera.
fn normalised(at: &Problem, factored: &crate::bundle::Factored, seen: &[Seen]) -> Option<Vec<f64>> {
    let mut tests = Vec::new();
    for (i, o) in at.observations.iter().enumerate() {
        // From where the fit has the point: image and survey of a point that one frame sees share one test.
        let p = at.cameras[0].camera.project(at.frames[0].pose.to_camera(&at.points[i].xyz).into())?;
        let v = Vector2::new(p[0] - o.pixel[0], p[1] - o.pixel[1]);
        // Of the residual: what was stated less what the fit took up.
        let q = Matrix2::identity() * o.sigma_px.powi(2) - factored.predicted(at, o)?;
        let coarse = o.sigma_px / expected_px(&at.cameras[0].camera, &at.frames[0].pose, &seen[i], o.sigma_px);
        let floor = Matrix2::identity() * (1e-3 * (o.sigma_px * coarse).powi(2));
        let test = v.dot(&((q + floor).try_inverse()? * v)).max(0.0).sqrt();
        tests.push(test);
    }
    Some(tests)
}
