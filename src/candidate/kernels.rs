//! The blurred shape over many pixels at once: its values, and the sums of the normal equations.
//!
//! Every function is written once, over pixels in lanes, and compiled three times: plainly, for AVX2 and for AVX-512.
//! Nothing is contracted or reordered, so all give the same bits; tests compare them.
#![allow(unsafe_code)]

use autoref_raster::normal::{P, erfc_over_exp};

/// Pixels that are worked on together.
pub const LANES: usize = 16;
/// Running sums side by side, so that the order of additions does not depend on the machine.
const SUMS: usize = 8;
pub const PARAMETERS: usize = 10;
const SQUARES: usize = PARAMETERS * (PARAMETERS + 1) / 2;

/// One number for each of the pixels that are worked on together.
pub type Lanes = [f64; LANES];

/// The outline of the shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    Rectangle,
    Disc,
}

/// One pixel of the fit.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Pixel centre.
    pub x: f64,
    pub y: f64,
    /// Share of paint, about 0 on ground and 1 on paint.
    pub share: f64,
}

#[derive(Clone, Copy)]
struct Chunk {
    x: Lanes,
    y: Lanes,
    share: Lanes,
}

/// The pixels of a fit in chunks of lanes, the last one filled up with copies of its first, which never count.
#[derive(Default)]
pub struct Samples {
    chunks: Vec<Chunk>,
    len: usize,
}

impl Samples {
    /// One more pixel.
    pub fn push(&mut self, sample: Sample) {
        let lane = self.len % LANES;
        if lane == 0 {
            let Sample { x, y, share } = sample;
            self.chunks.push(Chunk { x: [x; LANES], y: [y; LANES], share: [share; LANES] });
        } else if let Some(chunk) = self.chunks.last_mut() {
            (chunk.x[lane], chunk.y[lane], chunk.share[lane]) = (sample.x, sample.y, sample.share);
        }
        self.len += 1;
    }

    /// Number of pixels.
    pub fn count(&self) -> usize {
        self.len
    }
}

impl FromIterator<Sample> for Samples {
    fn from_iter<I: IntoIterator<Item = Sample>>(samples: I) -> Samples {
        let mut all = Samples::default();
        samples.into_iter().for_each(|s| all.push(s));
        all
    }
}

/// A shape in its place on a tilted plane of ground: what is the same for all pixels.
#[derive(Clone, Copy, Debug)]
pub struct Model {
    pub form: Form,
    pub x: f64,
    pub y: f64,
    pub a: f64,
    pub b: f64,
    pub sigma: f64,
    pub sin: f64,
    pub cos: f64,
    pub height: f64,
    /// Ground at `origin`, its slopes in x and y.
    pub plane: [f64; 3],
    pub origin: (f64, f64),
}

/// What is left over of the shares of a chunk's pixels, and the model's gradient there.
struct Look {
    left: Lanes,
    gradient: [Lanes; PARAMETERS],
}

/// Sums over all pixels, weighted: products of gradients (upper triangle, by rows), gradients times what is left over,
/// and squares of what is left over.
pub struct Equations {
    pub squares: [f64; SQUARES],
    pub pushes: [f64; PARAMETERS],
    pub cost: f64,
    /// Squares of what is left over, all pixels alike.
    pub left2: f64,
}

/// eˣ for x ≤ 0 to a relative 2e-10, without a branch: 2ⁿ·eʳ with |r| ≤ ½ ln 2 and eight terms of Taylor's series.
#[inline(always)]
pub(super) fn exp_of_negative(x: f64) -> f64 {
    // Adding it leaves the nearest whole number in the lowest bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const LN2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    let x = if x > -700.0 { x } else { -700.0 };
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN2_HIGH) - n * LN2_LOW;
    let series = 1.0
        + r * (1.0
            + r * (0.5
                + r * (1.0 / 6.0
                    + r * (1.0 / 24.0
                        + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0 + r * (1.0 / 40320.0))))))));
    series * f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52)
}

/// Standard normal density and distribution, the latter to 7.5e-8 ([`autoref_raster::normal`]), from one exponential
/// without a branch.
#[inline(always)]
pub fn normal(t: f64) -> (f64, f64) {
    const INV_SQRT_2PI: f64 = 0.398_942_280_401_432_7;
    let e = exp_of_negative(-0.5 * t * t);
    let tail = 0.5 * erfc_over_exp(P * t.abs() * std::f64::consts::FRAC_1_SQRT_2) * e;
    (INV_SQRT_2PI * e, if t >= 0.0 { 1.0 - tail } else { tail })
}

/// A blurred bar of length `a` seen at `u` from its middle: value, derivatives by u, ln a, ln σ.
#[inline(always)]
fn bar(u: f64, a: f64, inverse_sigma: f64) -> [f64; 4] {
    let (tp, tm) = ((u + a / 2.0) * inverse_sigma, (u - a / 2.0) * inverse_sigma);
    let ((gp, cp), (gm, cm)) = (normal(tp), normal(tm));
    [cp - cm, (gp - gm) * inverse_sigma, 0.5 * a * (gp + gm) * inverse_sigma, tm * gm - tp * gp]
}

/// Value of the shape and its gradient by centre, logarithms of the sides, angle and logarithm of the blur.
#[inline(always)]
pub(super) fn shape(model: &Model, x: f64, y: f64) -> (f64, [f64; 6]) {
    let (dx, dy) = (x - model.x, y - model.y);
    let (sin, cos) = (model.sin, model.cos);
    let inverse_sigma = 1.0 / model.sigma;
    match model.form {
        Form::Rectangle => {
            let (u, v) = (cos * dx + sin * dy, cos * dy - sin * dx);
            let [fu, fu_u, fu_a, fu_s] = bar(u, model.a, inverse_sigma);
            let [fv, fv_v, fv_b, fv_s] = bar(v, model.b, inverse_sigma);
            let (gu, gv) = (fu_u * fv, fu * fv_v);
            let by = [
                sin * gv - cos * gu,
                -sin * gu - cos * gv,
                fu_a * fv,
                fu * fv_b,
                gu * v - gv * u,
                fu_s * fv + fu * fv_s,
            ];
            (fu * fv, by)
        }
        Form::Disc => {
            let radius = ((dx * dx + dy * dy) + 1e-12).sqrt();
            let t = (model.a / 2.0 - radius) * inverse_sigma;
            let (g, c) = normal(t);
            let outward = g * inverse_sigma;
            let unit = outward / radius;
            (c, [unit * dx, unit * dy, outward * model.a / 2.0, 0.0, 0.0, -t * g])
        }
    }
}

/// What is left over of a pixel's share, its place from the origin and the ground there; `value` is that of the shape.
#[inline(always)]
fn left_over(model: &Model, chunk: &Chunk, i: usize, value: f64) -> (f64, [f64; 2], f64) {
    let (rx, ry) = (chunk.x[i] - model.origin.0, chunk.y[i] - model.origin.1);
    let plane = model.plane[0] + model.plane[1] * rx + model.plane[2] * ry;
    // Paint covers the ground: the plane shows where the shape does not.
    (chunk.share[i] - (model.height * value + plane * (1.0 - value)), [rx, ry], plane)
}

#[inline(always)]
fn look_at(model: &Model, chunk: &Chunk, look: &mut Look) {
    for i in 0..LANES {
        let (value, by) = shape(model, chunk.x[i], chunk.y[i]);
        let (left, [rx, ry], plane) = left_over(model, chunk, i, value);
        let (open, k) = (1.0 - value, model.height - plane);
        look.left[i] = left;
        for (g, by) in look.gradient.iter_mut().zip(by) {
            g[i] = k * by;
        }
        look.gradient[6][i] = value;
        look.gradient[7][i] = open;
        look.gradient[8][i] = open * rx;
        look.gradient[9][i] = open * ry;
    }
}

const NOTHING_SEEN: Look = Look { left: [0.0; LANES], gradient: [[0.0; LANES]; PARAMETERS] };

#[inline(always)]
fn add_products(sum: &mut [f64; SUMS], a: &Lanes, b: &Lanes) {
    for i in 0..LANES / SUMS {
        for (k, sum) in sum.iter_mut().enumerate() {
            *sum += a[SUMS * i + k] * b[SUMS * i + k];
        }
    }
}

#[inline(always)]
fn equations_in(model: &Model, samples: &Samples, weights: &[f64]) -> Equations {
    let mut squares = [[0.0; SUMS]; SQUARES];
    let mut pushes = [[0.0; SUMS]; PARAMETERS];
    let (mut cost, mut left2) = ([0.0; SUMS], [0.0; SUMS]);
    let mut look = NOTHING_SEEN;
    for (chunk, some) in samples.chunks.iter().zip(weights.chunks(LANES)) {
        let mut weight = [0.0; LANES];
        weight[..some.len()].copy_from_slice(some);
        look_at(model, chunk, &mut look);
        let mut weighted = [0.0; LANES];
        for i in 0..LANES {
            weighted[i] = weight[i] * look.left[i];
        }
        add_products(&mut cost, &weighted, &look.left);
        // What the last chunk is filled up with does not count.
        look.left[some.len()..].fill(0.0);
        add_products(&mut left2, &look.left, &look.left);
        let mut triangle = squares.iter_mut();
        for (a, push) in pushes.iter_mut().enumerate() {
            for i in 0..LANES {
                weighted[i] = weight[i] * look.gradient[a][i];
            }
            add_products(push, &weighted, &look.left);
            for (gradient, square) in look.gradient[a..].iter().zip(triangle.by_ref()) {
                add_products(square, &weighted, gradient);
            }
        }
    }
    let sum = |s: [f64; SUMS]| s.iter().sum::<f64>();
    Equations { squares: squares.map(sum), pushes: pushes.map(sum), cost: sum(cost), left2: sum(left2) }
}

#[inline(always)]
fn values_in(model: &Model, samples: &Samples, left: &mut Vec<f64>, values: &mut Vec<f64>) {
    left.clear();
    values.clear();
    let (mut l, mut v) = ([0.0; LANES], [0.0; LANES]);
    for (k, chunk) in samples.chunks.iter().enumerate() {
        for i in 0..LANES {
            v[i] = shape(model, chunk.x[i], chunk.y[i]).0;
            l[i] = left_over(model, chunk, i, v[i]).0;
        }
        let len = LANES.min(samples.len - k * LANES);
        left.extend_from_slice(&l[..len]);
        values.extend_from_slice(&v[..len]);
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn equations_avx2(model: &Model, samples: &Samples, weights: &[f64]) -> Equations {
    equations_in(model, samples, weights)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq")]
fn equations_avx512(model: &Model, samples: &Samples, weights: &[f64]) -> Equations {
    equations_in(model, samples, weights)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn values_avx2(model: &Model, samples: &Samples, left: &mut Vec<f64>, values: &mut Vec<f64>) {
    values_in(model, samples, left, values);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq")]
fn values_avx512(model: &Model, samples: &Samples, left: &mut Vec<f64>, values: &mut Vec<f64>) {
    values_in(model, samples, left, values);
}

/// The sums of the normal equations; `weights` has one of each pixel.
pub fn equations(model: &Model, samples: &Samples, weights: &[f64]) -> Equations {
    #[cfg(target_arch = "x86_64")]
    match Vectors::of_machine() {
        // SAFETY: the machine has AVX-512 F and DQ.
        Vectors::Avx512 => return unsafe { equations_avx512(model, samples, weights) },
        // SAFETY: the machine has AVX2.
        Vectors::Avx2 => return unsafe { equations_avx2(model, samples, weights) },
        Vectors::None => {}
    }
    equations_in(model, samples, weights)
}

/// What is left over of each pixel's share, and the value of the shape there.
pub fn values(model: &Model, samples: &Samples, left: &mut Vec<f64>, values: &mut Vec<f64>) {
    #[cfg(target_arch = "x86_64")]
    match Vectors::of_machine() {
        // SAFETY: the machine has AVX-512 F and DQ.
        Vectors::Avx512 => return unsafe { values_avx512(model, samples, left, values) },
        // SAFETY: the machine has AVX2.
        Vectors::Avx2 => return unsafe { values_avx2(model, samples, left, values) },
        Vectors::None => {}
    }
    values_in(model, samples, left, values);
}

/// The widest instructions that the kernels have a twin for.
#[cfg(target_arch = "x86_64")]
pub(crate) enum Vectors {
    None,
    Avx2,
    Avx512,
}

#[cfg(target_arch = "x86_64")]
impl Vectors {
    pub(crate) fn of_machine() -> Vectors {
        if autoref_raster::simd::Kernels::wanted() == autoref_raster::simd::Kernels::Scalar {
            Vectors::None
        } else if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq") {
            Vectors::Avx512
        } else if is_x86_feature_detected!("avx2") {
            Vectors::Avx2
        } else {
            Vectors::None
        }
    }
}

/// Calls `each` with every pixel: its number and place, what is left over, and the gradient there.
pub fn gradients(model: &Model, samples: &Samples, mut each: impl FnMut(usize, [f64; 2], f64, [f64; PARAMETERS])) {
    let mut look = NOTHING_SEEN;
    for (k, chunk) in samples.chunks.iter().enumerate() {
        look_at(model, chunk, &mut look);
        for i in 0..LANES.min(samples.len - k * LANES) {
            let gradient = std::array::from_fn(|p| look.gradient[p][i]);
            each(k * LANES + i, [chunk.x[i], chunk.y[i]], look.left[i], gradient);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(form: Form) -> Model {
        let (sin, cos) = 0.4f64.sin_cos();
        Model {
            form,
            x: 20.3,
            y: 19.8,
            a: 5.0,
            b: 4.5,
            sigma: 1.1,
            sin,
            cos,
            height: 1.1,
            plane: [0.05, 0.01, -0.02],
            origin: (20.0, 20.0),
        }
    }

    fn samples(n: usize) -> Samples {
        let at = |i: usize| (i % 37) as f64 + 0.5;
        (0..n).map(|i| Sample { x: at(i), y: at(i / 37), share: ((i * 7919) % 101) as f64 / 100.0 }).collect()
    }

    #[test]
    fn exponential_and_distribution_are_what_they_should_be() {
        for i in 0..=40_000 {
            let x = -0.001 * f64::from(i);
            assert!((exp_of_negative(x) / x.exp() - 1.0).abs() < 3e-10, "{x}");
        }
        assert!(exp_of_negative(-1e9) < 1e-300 && exp_of_negative(f64::NEG_INFINITY) < 1e-300);
        for (t, p) in [(0.0, 0.5), (1.0, 0.841_344_746), (-1.959_963_985, 0.025), (40.0, 1.0), (-40.0, 0.0)] {
            assert!((normal(t).1 - p).abs() < 2e-7, "{t}");
        }
    }

    #[test]
    fn both_ways_give_the_same_bits() {
        for form in [Form::Rectangle, Form::Disc] {
            for n in [1, 15, 16, 17, 300, 1369] {
                let (model, samples) = (model(form), samples(n));
                let weights: Vec<f64> = (0..n).map(|i| (i % 5) as f64).collect();
                let (fast, plain) = (equations(&model, &samples, &weights), equations_in(&model, &samples, &weights));
                assert_eq!(fast.squares.map(f64::to_bits), plain.squares.map(f64::to_bits));
                assert_eq!(fast.pushes.map(f64::to_bits), plain.pushes.map(f64::to_bits));
                assert_eq!([fast.cost, fast.left2].map(f64::to_bits), [plain.cost, plain.left2].map(f64::to_bits));
                #[cfg(target_arch = "x86_64")]
                if is_x86_feature_detected!("avx2") {
                    // SAFETY: the machine has AVX2.
                    let narrow = unsafe { equations_avx2(&model, &samples, &weights) };
                    assert_eq!(narrow.squares.map(f64::to_bits), plain.squares.map(f64::to_bits));
                    assert_eq!(narrow.pushes.map(f64::to_bits), plain.pushes.map(f64::to_bits));
                }
                let (mut a, mut b) = ((vec![], vec![]), (vec![], vec![]));
                values(&model, &samples, &mut a.0, &mut a.1);
                values_in(&model, &samples, &mut b.0, &mut b.1);
                assert_eq!(a.0.len(), n);
                let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                assert_eq!((bits(&a.0), bits(&a.1)), (bits(&b.0), bits(&b.1)));
            }
        }
    }

    #[test]
    fn the_sums_are_those_of_the_gradients() {
        let (model, samples) = (model(Form::Rectangle), samples(100));
        let weights: Vec<f64> = (0..100).map(|i| f64::from(i % 3)).collect();
        let sums = equations(&model, &samples, &weights);
        let (mut cost, mut left2, mut push, mut corner) = (0.0, 0.0, [0.0; PARAMETERS], 0.0);
        gradients(&model, &samples, |i, _, left, g| {
            cost += weights[i] * left * left;
            left2 += left * left;
            corner += weights[i] * g[0] * g[9];
            (0..PARAMETERS).for_each(|k| push[k] += weights[i] * left * g[k]);
        });
        assert!((sums.cost - cost).abs() < 1e-9 && (sums.left2 - left2).abs() < 1e-9);
        assert!((sums.squares[9] - corner).abs() < 1e-9);
        assert!(sums.pushes.iter().zip(push).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn gradients_match_differences() {
        for form in [Form::Rectangle, Form::Disc] {
            let turned = |by: f64| (0.4 + by).sin_cos();
            for (x, y) in [(22.0, 21.0), (17.5, 20.5), (20.1, 23.0)] {
                let (_, g) = shape(&model(form), x, y);
                let value = |k: usize, step: f64| {
                    let mut m = model(form);
                    match k {
                        0 => m.x += step,
                        1 => m.y += step,
                        2 => m.a *= step.exp(),
                        3 => m.b *= step.exp(),
                        4 => (m.sin, m.cos) = turned(step),
                        _ => m.sigma *= step.exp(),
                    }
                    shape(&m, x, y).0
                };
                for (k, g) in g.into_iter().enumerate() {
                    let slope = (value(k, 1e-3) - value(k, -1e-3)) / 2e-3;
                    assert!((slope - g).abs() < 3e-4, "{form:?} {k}: {slope} {g}");
                }
            }
        }
    }
}
