//! The blurred motif over many cells at once: its values, what it leaves over, and the sums of the normal equations.
//!
//! As the kernels of paint (`candidate::kernels`): every function is written once, over cells in lanes, and compiled
//! plainly, for AVX2 and for AVX-512. Nothing is contracted or reordered, so all give the same bits.
#![allow(unsafe_code)]

use super::Motif;
#[cfg(target_arch = "x86_64")]
use crate::candidate::kernels::Vectors;
use crate::candidate::kernels::{LANES, Lanes, normal};

/// Centre x, y; directions of the two lines; logarithms of the two bar widths and of the blur; ground level, height of
/// the bright over it, slope of the ground in x and y.
pub const PARAMETERS: usize = 11;
/// Running sums side by side, so that the order of additions does not depend on the machine.
const SUMS: usize = 8;
const SQUARES: usize = PARAMETERS * (PARAMETERS + 1) / 2;

/// One cell: its middle in cells from the patch's corner, and its grey level, 0..=255.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub x: f64,
    pub y: f64,
    pub level: f64,
}

#[derive(Clone, Copy)]
struct Chunk {
    x: Lanes,
    y: Lanes,
    level: Lanes,
}

/// The cells of a fit in chunks of lanes, the last one filled up with copies of its first, which never count.
pub struct Cells {
    chunks: Vec<Chunk>,
    pub len: usize,
}

impl Cells {
    pub fn new(samples: &[Sample]) -> Cells {
        let chunk = |some: &[Sample]| {
            let lane = |i: usize| some.get(i).unwrap_or(&some[0]);
            Chunk {
                x: std::array::from_fn(|i| lane(i).x),
                y: std::array::from_fn(|i| lane(i).y),
                level: std::array::from_fn(|i| lane(i).level),
            }
        };
        Cells { chunks: samples.chunks(LANES).map(chunk).collect(), len: samples.len() }
    }
}

/// A motif in its place on tilted ground: what is the same for all cells.
#[derive(Clone, Copy)]
pub struct Pose {
    pub motif: Motif,
    pub centre: (f64, f64),
    /// Sine and cosine of the two directions.
    pub turned: [(f64, f64); 2],
    pub widths: [f64; 2],
    pub sigma: f64,
    pub ground: f64,
    pub height: f64,
    pub slope: [f64; 2],
    /// Where the ground has the level `ground`.
    pub origin: (f64, f64),
}

impl Pose {
    /// The motif at a centre, 1 where it is bright on 0: directions in radians.
    pub fn bright(motif: Motif, (x, y): (f64, f64), directions: [f64; 2], widths: [f64; 2], sigma: f64) -> Pose {
        Pose {
            motif,
            centre: (x, y),
            turned: directions.map(f64::sin_cos),
            widths,
            sigma,
            ground: 0.0,
            height: 1.0,
            slope: [0.0; 2],
            origin: (x, y),
        }
    }
}

/// Sums over all cells, weighted: products of gradients (upper triangle, by rows), gradients times what is left over,
/// and squares of what is left over.
pub struct Equations {
    pub squares: [f64; SQUARES],
    pub pushes: [f64; PARAMETERS],
    pub cost: f64,
}

/// Bar of width exp(p) across signed distance d: value and derivatives by d, ln width, ln σ.
#[inline(always)]
fn bar(d: f64, width: f64, sigma: f64) -> [f64; 4] {
    let (tp, tm) = ((d + width / 2.0) / sigma, (d - width / 2.0) / sigma);
    let ((gp, cp), (gm, cm)) = (normal(tp), normal(tm));
    [cp - cm, (gp - gm) / sigma, 0.5 * width * (gp + gm) / sigma, tm * gm - tp * gp]
}

/// The side of a line at signed distance d, −1 to 1: value and derivatives as of a bar.
#[inline(always)]
fn side(d: f64, sigma: f64) -> [f64; 4] {
    let (density, below) = normal(d / sigma);
    [2.0 * below - 1.0, 2.0 * density / sigma, 0.0, -2.0 * density * d / sigma]
}

/// What is known of a chunk's cells: of each line the value and the derivatives by distance, ln width and ln σ; the
/// model's level and its gradient.
struct Look {
    lines: [[Lanes; 4]; 2],
    level: Lanes,
    gradient: [Lanes; PARAMETERS],
}

const NOTHING_SEEN: Look =
    Look { lines: [[[0.0; LANES]; 4]; 2], level: [0.0; LANES], gradient: [[0.0; LANES]; PARAMETERS] };

/// Loops that do one thing each, over arrays of known length: the compiler turns these into vectors, and one loop over
/// the whole model not.
#[inline(always)]
fn look_at_lines<const CROSS: bool>(pose: &Pose, chunk: &Chunk, lines: &mut [[Lanes; 4]; 2]) {
    for (i, line) in lines.iter_mut().enumerate() {
        let ((sin, cos), width, sigma) = (pose.turned[i], pose.widths[i], pose.sigma);
        let [value, by_d, by_width, by_sigma] = line;
        for k in 0..LANES {
            let d = cos * (chunk.y[k] - pose.centre.1) - sin * (chunk.x[k] - pose.centre.0);
            let seen = if CROSS { bar(d, width, sigma) } else { side(d, sigma) };
            value[k] = seen[0];
            by_d[k] = seen[1];
            by_width[k] = seen[2];
            by_sigma[k] = seen[3];
        }
    }
}

/// The shape where the lines have these values (0..=1), and its derivatives by them.
#[inline(always)]
fn joined<const CROSS: bool>(one: f64, two: f64) -> (f64, [f64; 2]) {
    if CROSS {
        (one + two - one * two, [1.0 - two, 1.0 - one])
    } else {
        (0.5 - 0.5 * one * two, [-0.5 * two, -0.5 * one])
    }
}

#[inline(always)]
fn look_at<const CROSS: bool>(pose: &Pose, chunk: &Chunk, look: &mut Look) {
    look_at_lines::<CROSS>(pose, chunk, &mut look.lines);
    let [x, y, turn_0, turn_1, width_0, width_1, sigma, ground, height, slope_x, slope_y] = &mut look.gradient;
    let [one, two] = &look.lines;
    let [(sin_0, cos_0), (sin_1, cos_1)] = pose.turned;
    for k in 0..LANES {
        let (dx, dy) = (chunk.x[k] - pose.centre.0, chunk.y[k] - pose.centre.1);
        let (value, by) = joined::<CROSS>(one[0][k], two[0][k]);
        let (by_0, by_1) = (pose.height * by[0], pose.height * by[1]);
        let (d_0, d_1) = (by_0 * one[1][k], by_1 * two[1][k]);
        x[k] = d_0 * sin_0 + d_1 * sin_1;
        y[k] = -(d_0 * cos_0 + d_1 * cos_1);
        turn_0[k] = -d_0 * (sin_0 * dy + cos_0 * dx);
        turn_1[k] = -d_1 * (sin_1 * dy + cos_1 * dx);
        width_0[k] = by_0 * one[2][k];
        width_1[k] = by_1 * two[2][k];
        sigma[k] = by_0 * one[3][k] + by_1 * two[3][k];
        ground[k] = 1.0;
        height[k] = value;
    }
    for k in 0..LANES {
        slope_x[k] = chunk.x[k] - pose.origin.0;
        slope_y[k] = chunk.y[k] - pose.origin.1;
        look.level[k] =
            pose.ground + pose.height * height[k] + (pose.slope[0] * slope_x[k] + pose.slope[1] * slope_y[k]);
    }
}

/// Calls `each` with every cell: its number, the model's grey level and its gradient there.
pub fn gradients(pose: &Pose, cells: &Cells, mut each: impl FnMut(usize, f64, [f64; PARAMETERS])) {
    let mut look = NOTHING_SEEN;
    for (n, chunk) in cells.chunks.iter().enumerate() {
        match pose.motif {
            Motif::Cross => look_at::<true>(pose, chunk, &mut look),
            Motif::Saddle => look_at::<false>(pose, chunk, &mut look),
        }
        for k in 0..LANES.min(cells.len - n * LANES) {
            each(n * LANES + k, look.level[k], std::array::from_fn(|p| look.gradient[p][k]));
        }
    }
}

#[inline(always)]
fn add_products(sum: &mut [f64; SUMS], a: &Lanes, b: &Lanes) {
    for i in 0..LANES / SUMS {
        for (k, sum) in sum.iter_mut().enumerate() {
            *sum += a[SUMS * i + k] * b[SUMS * i + k];
        }
    }
}

#[inline(always)]
fn equations_of<const CROSS: bool>(pose: &Pose, cells: &Cells, weights: &[f64]) -> Equations {
    let mut squares = [[0.0; SUMS]; SQUARES];
    let mut pushes = [[0.0; SUMS]; PARAMETERS];
    let mut cost = [0.0; SUMS];
    let (mut left, mut look) = ([0.0; LANES], NOTHING_SEEN);
    for (chunk, some) in cells.chunks.iter().zip(weights.chunks(LANES)) {
        let mut weight = [0.0; LANES];
        weight[..some.len()].copy_from_slice(some);
        look_at::<CROSS>(pose, chunk, &mut look);
        for i in 0..LANES {
            left[i] = chunk.level[i] - look.level[i];
        }
        let mut weighted = [0.0; LANES];
        for i in 0..LANES {
            weighted[i] = weight[i] * left[i];
        }
        add_products(&mut cost, &weighted, &left);
        let mut triangle = squares.iter_mut();
        for (a, push) in pushes.iter_mut().enumerate() {
            for i in 0..LANES {
                weighted[i] = weight[i] * look.gradient[a][i];
            }
            add_products(push, &weighted, &left);
            for (gradient, square) in look.gradient[a..].iter().zip(triangle.by_ref()) {
                add_products(square, &weighted, gradient);
            }
        }
    }
    let sum = |s: [f64; SUMS]| s.iter().sum::<f64>();
    Equations { squares: squares.map(sum), pushes: pushes.map(sum), cost: sum(cost) }
}

#[inline(always)]
fn equations_in(pose: &Pose, cells: &Cells, weights: &[f64]) -> Equations {
    match pose.motif {
        Motif::Cross => equations_of::<true>(pose, cells, weights),
        Motif::Saddle => equations_of::<false>(pose, cells, weights),
    }
}

#[inline(always)]
fn values_in(pose: &Pose, cells: &Cells, values: &mut Vec<f64>, left: &mut Vec<f64>) {
    match pose.motif {
        Motif::Cross => values_of::<true>(pose, cells, values, left),
        Motif::Saddle => values_of::<false>(pose, cells, values, left),
    }
}

/// The shape's values (0..=1), and what the model leaves over.
#[inline(always)]
fn values_of<const CROSS: bool>(pose: &Pose, cells: &Cells, values: &mut Vec<f64>, left: &mut Vec<f64>) {
    values.clear();
    left.clear();
    let (mut v, mut l, mut lines) = ([0.0; LANES], [0.0; LANES], NOTHING_SEEN.lines);
    for (k, chunk) in cells.chunks.iter().enumerate() {
        look_at_lines::<CROSS>(pose, chunk, &mut lines);
        for i in 0..LANES {
            v[i] = joined::<CROSS>(lines[0][0][i], lines[1][0][i]).0;
            let (rx, ry) = (chunk.x[i] - pose.origin.0, chunk.y[i] - pose.origin.1);
            let level = pose.ground + pose.height * v[i] + (pose.slope[0] * rx + pose.slope[1] * ry);
            l[i] = chunk.level[i] - level;
        }
        let len = LANES.min(cells.len - k * LANES);
        values.extend_from_slice(&v[..len]);
        left.extend_from_slice(&l[..len]);
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn equations_avx2(pose: &Pose, cells: &Cells, weights: &[f64]) -> Equations {
    equations_in(pose, cells, weights)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq")]
fn equations_avx512(pose: &Pose, cells: &Cells, weights: &[f64]) -> Equations {
    equations_in(pose, cells, weights)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn values_avx2(pose: &Pose, cells: &Cells, values: &mut Vec<f64>, left: &mut Vec<f64>) {
    values_in(pose, cells, values, left);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq")]
fn values_avx512(pose: &Pose, cells: &Cells, values: &mut Vec<f64>, left: &mut Vec<f64>) {
    values_in(pose, cells, values, left);
}

/// The sums of the normal equations; `weights` has one of each cell.
pub fn equations(pose: &Pose, cells: &Cells, weights: &[f64]) -> Equations {
    #[cfg(target_arch = "x86_64")]
    match Vectors::of_machine() {
        // SAFETY: the machine has AVX-512 F and DQ.
        Vectors::Avx512 => return unsafe { equations_avx512(pose, cells, weights) },
        // SAFETY: the machine has AVX2.
        Vectors::Avx2 => return unsafe { equations_avx2(pose, cells, weights) },
        Vectors::None => {}
    }
    equations_in(pose, cells, weights)
}

/// The shape's value at each cell (0..=1), and what the model leaves over there.
pub fn values(pose: &Pose, cells: &Cells, values: &mut Vec<f64>, left: &mut Vec<f64>) {
    #[cfg(target_arch = "x86_64")]
    match Vectors::of_machine() {
        // SAFETY: the machine has AVX-512 F and DQ.
        Vectors::Avx512 => return unsafe { values_avx512(pose, cells, values, left) },
        // SAFETY: the machine has AVX2.
        Vectors::Avx2 => return unsafe { values_avx2(pose, cells, values, left) },
        Vectors::None => {}
    }
    values_in(pose, cells, values, left);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_machines_compute_the_same_bits() {
        let samples: Vec<Sample> = (0..147)
            .map(|i| (f64::from(i % 13) + 0.5, f64::from(i / 13) + 0.5))
            .map(|(x, y)| Sample { x, y, level: 40.0 + 7.0 * x - y * y })
            .collect();
        let (cells, weights) = (Cells::new(&samples), vec![0.3; samples.len()]);
        for motif in [Motif::Cross, Motif::Saddle] {
            let pose = Pose {
                motif,
                centre: (6.1, 5.7),
                turned: [0.3f64.sin_cos(), 1.9f64.sin_cos()],
                widths: [3.0, 3.3],
                sigma: 0.9,
                ground: 30.0,
                height: 80.0,
                slope: [0.2, -0.1],
                origin: (6.0, 6.0),
            };
            let plain = equations_in(&pose, &cells, &weights);
            let wide = equations(&pose, &cells, &weights);
            assert_eq!((plain.squares, plain.pushes, plain.cost), (wide.squares, wide.pushes, wide.cost));
            let (mut one, mut two) = ((Vec::new(), Vec::new()), (Vec::new(), Vec::new()));
            values_in(&pose, &cells, &mut one.0, &mut one.1);
            values(&pose, &cells, &mut two.0, &mut two.1);
            assert_eq!(one, two);
            let sum: f64 = one.1.iter().map(|r| 0.3 * r * r).sum();
            assert!((sum - wide.cost).abs() < 1e-9 * sum, "what fills the last lanes up counts");
        }
    }
}
