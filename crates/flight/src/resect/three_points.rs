//! Poses from three points, and those of a net by its triples.

use autoref_raster::random::Mmix;
use nalgebra::{Matrix4, Vector3};

use super::seen::{ResectOptions, Seen};
use crate::camera::Camera;
use crate::pose::{Pose, Similarity};

/// Which roots of the quartic make poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Roots {
    /// Real ones.
    Real,
    /// Also pairs that are nearly real: where two poses fall together, errors of measurement push them off the real
    /// axis, and the pose that fits best lies at the middle of the pair.
    Near,
}

impl Roots {
    /// The largest imaginary part, against the root's size.
    fn most_imaginary(self) -> f64 {
        match self {
            Roots::Real => 1e-4,
            Roots::Near => 0.3,
        }
    }

    /// The largest share of a side's square that a pose may miss.
    fn most_off(self) -> f64 {
        match self {
            Roots::Real => 1e-4,
            Roots::Near => 0.5,
        }
    }
}

/// The poses that see three points along three unit vectors.
pub fn three_points(world: &[Vector3<f64>; 3], rays: &[Vector3<f64>; 3]) -> Vec<Pose> {
    poses(world, rays, Roots::Real)
}

fn poses(world: &[Vector3<f64>; 3], rays: &[Vector3<f64>; 3], roots: Roots) -> Vec<Pose> {
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
    let pairs = quartic([a0, a1, a2, a3, a4], roots).into_iter().filter(|v| *v > 0.0).flat_map(|v| {
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
        if u <= 0.0 || length <= 0.0 || off.abs() > roots.most_off() * a {
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

/// Roots, by the eigenvalues of the companion matrix and three steps of Newton; of pairs that are only nearly real the
/// middle.
fn quartic(c: [f64; 5], wanted: Roots) -> Vec<f64> {
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
        let imaginary = z.im.abs() / (1.0 + z.re.abs());
        if imaginary > wanted.most_imaginary() {
            continue;
        }
        let mut x = z.re;
        // There is nothing for Newton to find at the middle of a pair.
        let steps = if imaginary > Roots::Real.most_imaginary() { 0 } else { 3 };
        for _ in 0..steps {
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

/// Poses of all triples, or of 400 drawn ones.
pub(super) fn starts(camera: &Camera, seen: &[Seen], options: &ResectOptions) -> Vec<Pose> {
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
        let mut draws = Mmix(0x9E37_79B9_7F4A_7C15);
        let mut draw = || draws.below(n);
        while triples.len() < 400 {
            let t = [draw(), draw(), draw()];
            if t[0] != t[1] && t[1] != t[2] && t[0] != t[2] {
                triples.push(t);
            }
        }
    }
    let mut all = Vec::new();
    for t in triples {
        let (Some(a), Some(b), Some(c)) = (rays[t[0]], rays[t[1]], rays[t[2]]) else { continue };
        let world = t.map(|i| seen[i].xyz);
        all.extend(poses(&world, &[a, b, c], Roots::Near));
    }
    if let Some((at, _)) = &options.position {
        all.sort_by(|p, q| (p.centre - at).norm().total_cmp(&(q.centre - at).norm()));
    }
    all
}
