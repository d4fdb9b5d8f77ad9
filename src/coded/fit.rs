//! Sub-pixel centres of tags: the pattern of black and white modules, blurred, fitted to grey levels.
//!
//! The model is `ground + height·C(u, v)` with a slope of the light, (u, v) an affine function of the pixel, and C the
//! share of white: one less the sum of the black modules, each a product of two differences of the normal distribution.
//! The pattern is the one seen, so that a module under a leaf is no residual. Levenberg–Marquardt (D. W.
//! Marquardt, 1963) with Tukey's weights; covariance by the sandwich of W. K. Newey and K. D. West (1987), as for
//! paint.

use nalgebra::{SMatrix, SVector};

use crate::black_white::fit::tukey_weights;
use crate::black_white::kernels::Sample;
use crate::candidate::descent::{FIRST_DAMPING, Normal, Surface, at_rest, descend};
use crate::candidate::fit::{add_priors, correlated_scatter};
use crate::candidate::kernels::normal;

/// Centre x, y; steps of one module along u and along v; logarithm of the blur in modules; ground level, height of
/// white over it, slope of the light in x and y.
const PARAMETERS: usize = 11;
type Vector = SVector<f64, PARAMETERS>;
type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Modules of the largest family along a side, black border included.
pub const MOST_MODULES: usize = 8;

/// Where a tag lies, in cells: its centre and the steps of one module along its two sides.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    pub centre: [f64; 2],
    pub along: [[f64; 2]; 2],
}

impl Pose {
    /// The parallelogram nearest to four corners, given around the square of `modules` modules.
    pub fn of_corners(corners: [[f64; 2]; 4], modules: usize) -> Pose {
        let [a, b, c, d] = corners;
        let n = 2.0 * modules as f64;
        let each = |f: &dyn Fn(usize) -> f64| [f(0), f(1)];
        Pose {
            centre: each(&|i| (a[i] + b[i] + c[i] + d[i]) / 4.0),
            along: [each(&|i| (b[i] - a[i] + c[i] - d[i]) / n), each(&|i| (d[i] - a[i] + c[i] - b[i]) / n)],
        }
    }

    /// The pixel of a place in modules from the centre.
    pub fn at(&self, u: f64, v: f64) -> [f64; 2] {
        [0, 1].map(|i| self.centre[i] + u * self.along[0][i] + v * self.along[1][i])
    }

    /// Modules from the centre; `None` of a pose without area.
    pub fn inverse(&self) -> Option<[[f64; 2]; 2]> {
        let [u, v] = self.along;
        let det = u[0] * v[1] - v[0] * u[1];
        (det.abs() > 1e-9).then(|| [[v[1] / det, -v[0] / det], [-u[1] / det, u[0] / det]])
    }

    /// Mean length of a module's side.
    pub fn module(&self) -> f64 {
        let [u, v] = self.along;
        (u[0].hypot(u[1]) * v[0].hypot(v[1])).sqrt()
    }

    /// Whether the sides are as long as each other within a fifth and at right angles within 11 degrees: tags lie flat
    /// on ground that is seen from above.
    pub fn is_square(&self) -> bool {
        let [u, v] = self.along;
        let (a, b) = (u[0].hypot(u[1]), v[0].hypot(v[1]));
        let cosine = (u[0] * v[0] + u[1] * v[1]) / (a * b).max(1e-12);
        (0.8..1.25).contains(&(a / b.max(1e-12))) && cosine.abs() < 0.2
    }
}

/// What came of a fit, in cells.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    pub pose: Pose,
    /// White over black, grey levels.
    pub height: f64,
    /// Of the centre: xx, xy, yy.
    pub covariance: [f64; 3],
    /// Share of the samples' variance that the model leaves over.
    pub misfit: f64,
}

/// Black modules, a row of bits each.
pub type Pattern = [u16; MOST_MODULES];

struct Problem<'a> {
    samples: &'a [Sample],
    modules: usize,
    black: Pattern,
    weights: Vec<f64>,
    start: Vector,
}

/// Shares of a blurred coordinate in the modules, with their derivatives by the coordinate and by ln(blur).
struct Shares {
    value: [f64; MOST_MODULES],
    slope: [f64; MOST_MODULES],
    by_blur: [f64; MOST_MODULES],
    first: usize,
    last: usize,
}

fn shares(u: f64, blur: f64, modules: usize) -> Shares {
    /// Deviations beyond which nothing is left of a blurred edge.
    const FAR: f64 = 9.0;
    let zero = [0.0; MOST_MODULES];
    let mut out = Shares { value: zero, slope: zero, by_blur: zero, first: modules, last: 0 };
    let edge = |k: usize| {
        let t = (u - k as f64) / blur;
        let (density, below) = normal(t.clamp(-FAR, FAR));
        (t, density, below)
    };
    // Beyond, both edges of a module are far away on one side, and its share is nothing.
    let from = ((u - FAR * blur).floor() - 1.0).max(0.0) as usize;
    let to = ((u + FAR * blur).ceil() + 1.0).max(0.0) as usize;
    let mut low = edge(from);
    for i in from..to.min(modules) {
        let high = edge(i + 1);
        out.value[i] = low.2 - high.2;
        if out.value[i] > 1e-9 {
            out.slope[i] = (low.1 - high.1) / blur;
            out.by_blur[i] = high.0 * high.1 - low.0 * low.1;
            out.first = out.first.min(i);
            out.last = i + 1;
        }
        low = high;
    }
    out
}

impl Problem<'_> {
    /// Share of white at (u, v) modules from the square's corner, and its derivatives by u, v and ln(blur).
    fn white(&self, u: f64, v: f64, blur: f64) -> [f64; 4] {
        let (a, b) = (shares(u, blur, self.modules), shares(v, blur, self.modules));
        let mut sum = [0.0; 4];
        for j in b.first..b.last {
            let (mut value, mut slope, mut by_blur) = (0.0, 0.0, 0.0);
            for i in (a.first..a.last).filter(|i| self.black[j] >> i & 1 == 1) {
                value += a.value[i];
                slope += a.slope[i];
                by_blur += a.by_blur[i];
            }
            sum[0] += value * b.value[j];
            sum[1] += slope * b.value[j];
            sum[2] += value * b.slope[j];
            sum[3] += by_blur * b.value[j] + value * b.by_blur[j];
        }
        [1.0 - sum[0], -sum[1], -sum[2], -sum[3]]
    }

    fn pose(p: &Vector) -> Pose {
        Pose { centre: [p[0], p[1]], along: [[p[2], p[3]], [p[4], p[5]]] }
    }

    /// The model and its gradient at a place.
    fn model(&self, p: &Vector, inverse: &[[f64; 2]; 2], x: f64, y: f64) -> (f64, Vector) {
        let (dx, dy) = (x - p[0], y - p[1]);
        let a = inverse.map(|row| row[0] * dx + row[1] * dy);
        let half = self.modules as f64 / 2.0;
        let [white, by_u, by_v, by_blur] = self.white(half + a[0], half + a[1], p[6].exp());
        let height = p[8];
        // How the level changes when the centre moves along x and y; a step moves a place by its modules from the
        // centre.
        let along = [0, 1].map(|i| -height * (by_u * inverse[0][i] + by_v * inverse[1][i]));
        let (rx, ry) = (x - self.start[0], y - self.start[1]);
        let g = Vector::from([
            along[0],
            along[1],
            along[0] * a[0],
            along[1] * a[0],
            along[0] * a[1],
            along[1] * a[1],
            height * by_blur,
            1.0,
            white,
            rx,
            ry,
        ]);
        (p[7] + height * white + p[9] * rx + p[10] * ry, g)
    }

    /// Residual over its standard deviation and the parameters that it pulls at.
    fn priors(&self, p: &Vector) -> [(f64, [(usize, f64); 2]); 3] {
        let side = Self::pose(&self.start).module() * self.modules as f64;
        let slope_sd = 0.3 * self.start[8].abs().max(1.0) / side;
        [
            ((p[6] - self.start[6]) / 0.7, [(6, 1.0 / 0.7), (6, 0.0)]),
            (p[9] / slope_sd, [(9, 1.0 / slope_sd), (9, 0.0)]),
            (p[10] / slope_sd, [(10, 1.0 / slope_sd), (10, 0.0)]),
        ]
    }

    fn cost(&self, p: &Vector) -> f64 {
        let Some(inverse) = Self::pose(p).inverse() else { return f64::INFINITY };
        let seen = self.samples.iter().zip(&self.weights).filter(|(_, w)| **w > 0.0);
        let data: f64 = seen.map(|(s, w)| w * (s.level - self.model(p, &inverse, s.x, s.y).0).powi(2)).sum();
        data + self.priors(p).iter().map(|(r, _)| r * r).sum::<f64>()
    }

    fn normal_equations(&self, p: &Vector) -> Option<Normal<PARAMETERS>> {
        let inverse = Self::pose(p).inverse()?;
        let (mut h, mut g, mut cost) = (Matrix::zeros(), Vector::zeros(), 0.0);
        for (s, &w) in self.samples.iter().zip(&self.weights).filter(|(_, w)| **w > 0.0) {
            let (value, j) = self.model(p, &inverse, s.x, s.y);
            let r = s.level - value;
            cost += w * r * r;
            g.axpy(w * r, &j, 1.0);
            h.syger(w, &j, &j, 1.0);
        }
        h.fill_upper_triangle_with_lower_triangle();
        add_priors(self.priors(p), &mut h, &mut g, &mut cost);
        Some(Normal { h, g, cost })
    }

    fn residuals(&self, p: &Vector) -> Option<Vec<f64>> {
        let inverse = Self::pose(p).inverse()?;
        Some(self.samples.iter().map(|s| s.level - self.model(p, &inverse, s.x, s.y).0).collect())
    }

    /// Tukey's biweight about the fit `p`, with the noise that the residuals show.
    fn reweigh(&mut self, p: &Vector) -> Option<()> {
        self.weights = tukey_weights(&self.residuals(p)?, p[8]);
        Some(())
    }
}

impl Surface<PARAMETERS> for Problem<'_> {
    type Looked = ();

    fn look(&self, p: &Vector) -> Option<(f64, ())> {
        let module = Self::pose(&self.start).module();
        let near = (p[0] - self.start[0]).hypot(p[1] - self.start[1]) < module && (p[6] - self.start[6]).abs() < 2.5;
        near.then(|| (self.cost(p), ()))
    }

    fn normal(&self, p: &Vector, (): ()) -> Option<Normal<PARAMETERS>> {
        self.normal_equations(p)
    }

    fn rests(&self, step: &Vector, (before, after): (f64, f64), (): &()) -> bool {
        at_rest(step[0].hypot(step[1]), before, after)
    }
}

/// Fits the pattern. `blur` is a guess, in cells; `levels` those of black and white. `None` with fewer than 60 samples,
/// or when the equations break down.
pub fn fit(
    samples: &[Sample],
    modules: usize,
    black: Pattern,
    start: Pose,
    blur: f64,
    levels: (f64, f64),
) -> Option<Fit> {
    let n = samples.len() as f64;
    if samples.len() < 60 || levels.1 - levels.0 < 1.0 {
        return None;
    }
    let mean = samples.iter().map(|s| s.level).sum::<f64>() / n;
    let total: f64 = samples.iter().map(|s| (s.level - mean).powi(2)).sum();
    let ([u, v], height) = (start.along, levels.1 - levels.0);
    let ln_blur = (blur / start.module()).ln();
    let [cx, cy] = start.centre;
    let p = Vector::from([cx, cy, u[0], u[1], v[0], v[1], ln_blur, levels.0, height, 0.0, 0.0]);
    let noise = (0.1 * height).max(2.0);
    let weights = vec![1.0 / (noise * noise); samples.len()];
    let mut problem = Problem { samples, modules, black, weights, start: p };
    let mut p = descend(&problem, p, (), 20, &mut { FIRST_DAMPING })?.place();
    for _ in 0..2 {
        problem.reweigh(&p)?;
        p = descend(&problem, p, (), 8, &mut { FIRST_DAMPING })?.place();
    }
    let covariance_of = problem.normal_equations(&p)?.h.cholesky()?.inverse();
    let inverse = Problem::pose(&p).inverse()?;
    let pushes: Vec<_> = samples
        .iter()
        .zip(&problem.weights)
        .filter(|(_, w)| **w > 0.0)
        .map(|(s, &w)| {
            let (value, j) = problem.model(&p, &inverse, s.x, s.y);
            let along = covariance_of.fixed_rows::<2>(0) * j * (w * (s.level - value));
            (s.x.floor() as i64, s.y.floor() as i64, along[0], along[1])
        })
        .collect();
    // Residuals of a fit are smaller than the noise, by the parameters that were spent.
    let covariance = correlated_scatter(&pushes).map(|v| v * n / (n - PARAMETERS as f64));
    let left: f64 = problem.residuals(&p)?.iter().map(|r| r * r).sum();
    let finite = p.iter().chain(&covariance).all(|v| v.is_finite()) && covariance[0] > 0.0 && covariance[2] > 0.0;
    finite.then(|| Fit { pose: Problem::pose(&p), height: p[8], covariance, misfit: left / total.max(1e-9) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_match_differences() {
        let black = [0b111111, 0b100101, 0b110011, 0b101001, 0b100011, 0b111111, 0, 0];
        let start = Vector::from([20.0, 20.0, 4.0, 0.9, -0.8, 4.1, -1.4, 30.0, 150.0, 0.2, -0.1]);
        let problem = Problem { samples: &[], modules: 6, black, weights: Vec::new(), start };
        let value = |p: &Vector, x, y| {
            let inverse = Problem::pose(p).inverse().expect("a square");
            problem.model(p, &inverse, x, y)
        };
        for (x, y) in [(20.5, 20.5), (12.0, 17.0), (31.5, 24.0), (8.0, 30.0)] {
            let (_, g) = value(&start, x, y);
            for k in 0..PARAMETERS {
                let (mut up, mut down) = (start, start);
                up[k] += 1e-3;
                down[k] -= 1e-3;
                let slope = (value(&up, x, y).0 - value(&down, x, y).0) / 2e-3;
                assert!((slope - g[k]).abs() < 0.02 * (1.0 + g[k].abs()), "{k} at {x},{y}: {slope} {}", g[k]);
            }
        }
    }
}
