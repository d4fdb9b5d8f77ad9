//! What rays and GCPs say before anything is adjusted: the point that rays meet in, the similarity from a free datum to
//! the ground.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::Camera;
use crate::pose::{Pose, Similarity};
use crate::read::Reconstruction;

/// The point nearest to the rays; `None` when they are (nearly) parallel or it lies behind a camera.
pub fn intersect(cameras: &[Camera], poses: &[(usize, Pose)], pixels: &[[f64; 2]]) -> Option<Vector3<f64>> {
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for ((camera, pose), pixel) in poses.iter().zip(pixels) {
        let d = pose.rotation.transpose() * Vector3::from(cameras[*camera].ray(*pixel)?);
        let m = Matrix3::identity() - d * d.transpose();
        a += m;
        b += m * pose.centre;
    }
    let values = a.symmetric_eigenvalues();
    if poses.len() < 2 || values.min() < 1e-7 * values.max() {
        return None;
    }
    let mut x = a.try_inverse()? * b;
    // Least squares in the images.
    for _ in 0..5 {
        let (mut n, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for ((camera, pose), pixel) in poses.iter().zip(pixels) {
            let p = pose.to_camera(&x);
            if p.z <= 0.0 {
                return None;
            }
            let (at, j) = cameras[*camera].project_with_jacobian(p.into());
            let j = nalgebra::Matrix2x3::from_fn(|r, c| j[r][c]) * pose.rotation;
            let r = Vector2::new(at[0] - pixel[0], at[1] - pixel[1]);
            n += j.transpose() * j;
            g -= j.transpose() * r;
        }
        x += n.try_inverse()? * g;
    }
    poses.iter().all(|(_, p)| p.to_camera(&x).z > 0.0).then_some(x)
}

/// The same of places in the photographs of a reconstruction.
pub(crate) fn intersect_seen(model: &Reconstruction, seen: &[(usize, [f64; 2])]) -> Option<Vector3<f64>> {
    let poses: Vec<(usize, Pose)> =
        seen.iter().map(|(i, _)| (model.photographs[*i].camera, model.photographs[*i].pose)).collect();
    let pixels: Vec<[f64; 2]> = seen.iter().map(|s| s.1).collect();
    intersect(&model.cameras, &poses, &pixels)
}

/// The similarity that most GCPs agree with: least median over triples, then the agreeing ones by least squares.
pub fn datum(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<Similarity> {
    let n = from.len();
    let mut best: Option<(f64, Similarity)> = None;
    let mut tried = 0;
    'all: for i in 0..n {
        for j in i + 1..n {
            for k in j + 1..n {
                let pick = |p: &[Vector3<f64>]| [p[i], p[j], p[k]];
                if let Some(s) = Similarity::fit(&pick(from), &pick(to), &[1.0; 3]) {
                    let mut d: Vec<f64> = from.iter().zip(to).map(|(a, b)| (s.apply(a) - b).norm()).collect();
                    d.sort_by(f64::total_cmp);
                    let score = d[(n / 2 + 1).min(n - 1)];
                    if best.as_ref().is_none_or(|b| score < b.0) {
                        best = Some((score, s));
                    }
                }
                tried += 1;
                if tried > 20_000 {
                    break 'all;
                }
            }
        }
    }
    let (score, mut s) = best?;
    for _ in 0..3 {
        let weights: Vec<f64> = from
            .iter()
            .zip(to)
            .map(|(a, b)| f64::from(u8::from((s.apply(a) - b).norm() <= 2.5 * score.max(1e-9) || n <= 4)))
            .collect();
        s = Similarity::fit(from, to, &weights).unwrap_or(s);
    }
    Some(s)
}
