//! What rays and GCPs say before anything is adjusted: the point that rays meet in, the similarity from a free datum to
//! the ground.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::Camera;
use crate::pose::{Pose, Similarity};
use crate::read::Reconstruction;
use autoref_raster::random::SplitMix64;

/// The point nearest to the rays; `None` when they are (nearly) parallel or it lies where one of
/// them comes from: behind a camera.
pub fn intersect(cameras: &[Camera], poses: &[(usize, Pose)], pixels: &[[f64; 2]]) -> Option<Vector3<f64>> {
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    let mut rays = Vec::with_capacity(pixels.len());
    for ((camera, pose), pixel) in poses.iter().zip(pixels) {
        let ray = cameras[*camera].ray(*pixel)?;
        rays.push(ray);
        let d = pose.rotation.transpose() * Vector3::from(ray);
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
        for (((camera, pose), pixel), ray) in poses.iter().zip(pixels).zip(&rays) {
            let (camera, p) = (&cameras[*camera], pose.to_camera(&x).into());
            if !camera.is_along(p, *ray) {
                return None;
            }
            let (off, j) = camera.residual_with_jacobian(p, *pixel);
            let j = nalgebra::Matrix2x3::from_fn(|r, c| j[r][c]) * pose.rotation;
            n += j.transpose() * j;
            g -= j.transpose() * Vector2::from(off);
        }
        x += n.try_inverse()? * g;
    }
    let is_ahead =
        |((camera, pose), ray): (&(usize, Pose), &[f64; 3])| cameras[*camera].is_along(pose.to_camera(&x).into(), *ray);
    poses.iter().zip(&rays).all(is_ahead).then_some(x)
}

/// The same of places in the photographs of a reconstruction.
pub(crate) fn intersect_seen(model: &Reconstruction, seen: &[(usize, [f64; 2])]) -> Option<Vector3<f64>> {
    let poses: Vec<(usize, Pose)> =
        seen.iter().map(|(i, _)| (model.photographs[*i].camera, model.photographs[*i].pose)).collect();
    let pixels: Vec<[f64; 2]> = seen.iter().map(|s| s.1).collect();
    intersect(&model.cameras, &poses, &pixels)
}

/// Triples that a datum is sought with: all of up to 50 points, drawn at random of more.
const MOST_TRIPLES: usize = 20_000;

/// The similarity that most GCPs agree with: least median over triples, then the agreeing ones by least squares.
pub fn datum(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<Similarity> {
    let n = from.len();
    let mut best: Option<(f64, Similarity)> = None;
    for triple in triples(n) {
        let pick = |p: &[Vector3<f64>]| triple.map(|i| p[i]);
        if let Some(s) = Similarity::fit(&pick(from), &pick(to), &[1.0; 3]) {
            let mut d: Vec<f64> = from.iter().zip(to).map(|(a, b)| (s.apply(a) - b).norm()).collect();
            d.sort_by(f64::total_cmp);
            let score = d[(n / 2 + 1).min(n - 1)];
            if best.as_ref().is_none_or(|b| score < b.0) {
                best = Some((score, s));
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

/// All triples of so many points, or as many as are enough, drawn at random: the first in order would all hold the
/// first point.
fn triples(n: usize) -> Vec<[usize; 3]> {
    if n < 3 {
        return Vec::new();
    }
    if n * (n - 1) * (n - 2) / 6 <= MOST_TRIPLES {
        return (0..n).flat_map(|i| (i + 1..n).flat_map(move |j| (j + 1..n).map(move |k| [i, j, k]))).collect();
    }
    let mut random = SplitMix64(n as u64);
    let mut below = || (random.unit() * n as f64) as usize;
    std::iter::repeat_with(|| [below(), below(), below()])
        .filter(|[i, j, k]| i != j && j != k && i != k)
        .take(MOST_TRIPLES)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_first_place_among_hundreds_does_not_turn_the_datum() {
        let mut random = SplitMix64(4);
        let from: Vec<Vector3<f64>> =
            (0..300).map(|_| Vector3::new(random.unit(), random.unit(), 0.1 * random.unit()) * 900.0).collect();
        let mut to: Vec<Vector3<f64>> = from.iter().map(|p| p * 2.0 + Vector3::new(5e5, 7e6, 100.0)).collect();
        to[0] += Vector3::new(4000.0, -3000.0, 500.0);
        let datum = datum(&from, &to).expect("300 places");
        let off = from.iter().zip(&to).skip(1).map(|(a, b)| (datum.apply(a) - b).norm()).fold(0.0, f64::max);
        assert!(off < 1e-6, "{off}");
        assert!(triples(50).len() == 19_600 && triples(300).len() == MOST_TRIPLES && triples(2).is_empty());
    }
}
