//! Sub-pixel centres: fit of a blurred square or disc to the share of paint in each pixel.
//!
//! The model is a filled shape convolved with a Gaussian, which for a rectangle is a product of differences of normal
//! distribution functions, on a tilted plane of ground. It is fitted by Levenberg–Marquardt (D. W. Marquardt, "An
//! algorithm for least-squares estimation of nonlinear parameters", 1963) with iteratively reweighted residuals
//! (P. J. Huber, "Robust statistics", 1981). What is left over is ground texture and JPEG blocks, not white noise, so the
//! scatter of the centre is summed along the edges; the uncertainty room makes a covariance of it.

use nalgebra::{SMatrix, SVector};

use crate::coords::PixelPoint;

/// Parameters: centre x, y; logarithms of the two sides (disc: of the diameter, twice); angle; logarithm of the blur;
/// height; plane: constant, slope in x, slope in y.
pub const PARAMETERS: usize = 10;
type Vector = SVector<f64, PARAMETERS>;
type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;

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

/// Standard deviations that say how far a parameter may lie from its start or from its expectation.
#[derive(Clone, Copy, Debug)]
pub struct Priors {
    /// Of the logarithm of the ratio of the sides: squares are square.
    pub aspect: f64,
    /// Of the logarithm of the blur about `blur_px`.
    pub blur: f64,
    pub blur_px: f64,
    /// Of the height about 1.
    pub height: f64,
    /// Of the plane's slopes, per pixel.
    pub slope: f64,
    /// Standard deviation of the share on ground, from the ring around the mark.
    pub ground_sd: f64,
}

#[derive(Clone, Debug)]
pub struct Fit {
    pub form: Form,
    pub x: f64,
    pub y: f64,
    pub sides_px: [f64; 2],
    pub angle_rad: f64,
    pub blur_px: f64,
    pub height: f64,
    /// Scatter of x and y by what is left over, summed along the edges: xx, xy, yy, px². Not yet a covariance: what the fit
    /// itself absorbs is not in it.
    pub scatter_px2: [f64; 3],
    /// Weighted mean square of what is left over, in units of the expected noise.
    pub chi2: f64,
    /// Root mean square of what is left over, as a share of paint.
    pub rms: f64,
    /// Share of the samples' weight that the robust weights took away from the inside and the border of the mark.
    pub hidden: f64,
    /// Robust standard deviation of what is left over on the border.
    pub edge_sd: f64,
}

impl Fit {
    /// The border of the shape about a centre, as a closed polygon in the units of the centre: four corners, or a disc in
    /// steps of 15°.
    pub fn outline(&self, centre: PixelPoint) -> Vec<PixelPoint> {
        let [a, b] = self.sides_px;
        if self.form == Form::Disc {
            return (0..24)
                .map(|k| (f64::from(k) * std::f64::consts::PI / 12.0).sin_cos())
                .map(|(sin, cos)| PixelPoint { x: centre.x + a / 2.0 * cos, y: centre.y + a / 2.0 * sin })
                .collect();
        }
        let (sin, cos) = self.angle_rad.sin_cos();
        [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
            .map(|(u, v)| (u * a, v * b))
            .map(|(u, v)| PixelPoint { x: centre.x + cos * u - sin * v, y: centre.y + sin * u + cos * v })
            .to_vec()
    }
}

/// Standard normal density and distribution. The distribution is Abramowitz and Stegun, "Handbook of mathematical
/// functions" (1964), 7.1.26, good to 1.5e-7, because it shares its exponential with the density.
#[inline]
pub(crate) fn normal(t: f64) -> (f64, f64) {
    const INV_SQRT_2PI: f64 = 0.398_942_280_401_432_7;
    let e = (-0.5 * t * t).exp();
    let k = 1.0 / (1.0 + 0.327_591_1 * t.abs() * std::f64::consts::FRAC_1_SQRT_2);
    let poly =
        k * (0.254_829_592 + k * (-0.284_496_736 + k * (1.421_413_741 + k * (-1.453_152_027 + k * 1.061_405_429))));
    let tail = 0.5 * poly * e;
    (INV_SQRT_2PI * e, if t >= 0.0 { 1.0 - tail } else { tail })
}

/// A blurred bar of length `a` seen at `u` from its middle: value, derivatives by u, ln a, ln σ.
fn bar(u: f64, a: f64, sigma: f64) -> [f64; 4] {
    let (tp, tm) = ((u + a / 2.0) / sigma, (u - a / 2.0) / sigma);
    let ((gp, cp), (gm, cm)) = (normal(tp), normal(tm));
    [cp - cm, (gp - gm) / sigma, 0.5 * a * (gp + gm) / sigma, tm * gm - tp * gp]
}

/// A shape in its place: what of the parameters is the same for all pixels.
struct Posed {
    form: Form,
    x: f64,
    y: f64,
    a: f64,
    b: f64,
    sigma: f64,
    sin: f64,
    cos: f64,
}

impl Posed {
    fn new(form: Form, p: &Vector) -> Posed {
        let (sin, cos) = p[4].sin_cos();
        Posed { form, x: p[0], y: p[1], a: p[2].exp(), b: p[3].exp(), sigma: p[5].exp(), sin, cos }
    }

    /// Value of the shape (0..=1) and its gradient by the first six parameters.
    fn at(&self, x: f64, y: f64) -> (f64, [f64; 6]) {
        let (dx, dy) = (x - self.x, y - self.y);
        let (sigma, sin, cos) = (self.sigma, self.sin, self.cos);
        match self.form {
            Form::Rectangle => {
                let (u, v) = (cos * dx + sin * dy, cos * dy - sin * dx);
                let [fu, fu_u, fu_a, fu_s] = bar(u, self.a, sigma);
                let [fv, fv_v, fv_b, fv_s] = bar(v, self.b, sigma);
                let (gu, gv) = (fu_u * fv, fu * fv_v);
                (
                    fu * fv,
                    [
                        sin * gv - cos * gu,
                        -sin * gu - cos * gv,
                        fu_a * fv,
                        fu * fv_b,
                        gu * v - gv * u,
                        fu_s * fv + fu * fv_s,
                    ],
                )
            }
            Form::Disc => {
                let radius = ((dx * dx + dy * dy) + 1e-12).sqrt();
                let t = (self.a / 2.0 - radius) / sigma;
                let (g, c) = normal(t);
                (c, [g * dx / radius / sigma, g * dy / radius / sigma, g * self.a / 2.0 / sigma, 0.0, 0.0, -t * g])
            }
        }
    }
}

struct Problem<'a> {
    form: Form,
    samples: &'a [Sample],
    priors: Priors,
    /// Origin of the plane and centre of the trust region.
    start: (f64, f64),
    side_px: f64,
    /// Noise inside the mark.
    paint_sd: f64,
    /// Noise on the border.
    edge_sd: f64,
    /// Of each sample, set between rounds and constant inside one.
    weights: Vec<f64>,
}

impl Problem<'_> {
    fn pose(&self, p: &Vector) -> Posed {
        Posed::new(self.form, p)
    }

    /// What is left over of a sample, its gradient by the parameters, and the value of the shape there.
    fn residual(&self, p: &Vector, pose: &Posed, s: &Sample) -> (f64, Vector, f64) {
        let (value, g) = pose.at(s.x, s.y);
        let (rx, ry) = (s.x - self.start.0, s.y - self.start.1);
        let plane = p[7] + p[8] * rx + p[9] * ry;
        // Paint covers the ground: the plane shows where the shape does not.
        let model = p[6] * value + plane * (1.0 - value);
        let k = p[6] - plane;
        let open = 1.0 - value;
        let gradient = Vector::from([
            k * g[0],
            k * g[1],
            k * g[2],
            k * g[3],
            k * g[4],
            k * g[5],
            value,
            open,
            open * rx,
            open * ry,
        ]);
        (s.share - model, gradient, value)
    }

    /// Residuals of the priors: (value, parameter-space gradient) each already over its standard deviation.
    fn priors(&self, p: &Vector) -> [(f64, [(usize, f64); 2]); 8] {
        let q = &self.priors;
        let size_sd = 0.5;
        [
            ((p[2] - p[3]) / q.aspect, [(2, 1.0 / q.aspect), (3, -1.0 / q.aspect)]),
            ((p[5] - q.blur_px.ln()) / q.blur, [(5, 1.0 / q.blur), (5, 0.0)]),
            ((p[6] - 1.0) / q.height, [(6, 1.0 / q.height), (6, 0.0)]),
            (p[8] / q.slope, [(8, 1.0 / q.slope), (8, 0.0)]),
            (p[9] / q.slope, [(9, 1.0 / q.slope), (9, 0.0)]),
            (p[7] / (2.0 * q.ground_sd), [(7, 0.5 / q.ground_sd), (7, 0.0)]),
            (((p[2] + p[3]) / 2.0 - self.side_px.ln()) / size_sd, [(2, 0.5 / size_sd), (3, 0.5 / size_sd)]),
            // The angle of a disc or of a blob is free; a weak pull keeps the normal equations regular.
            (0.0, [(4, 0.1), (4, 0.0)]),
        ]
    }

    fn normal_equations(&self, p: &Vector) -> (Matrix, Vector, f64) {
        let (mut h, mut g, mut cost) = (Matrix::zeros(), Vector::zeros(), 0.0);
        let pose = self.pose(p);
        for (s, &w) in self.samples.iter().zip(&self.weights) {
            if w == 0.0 {
                continue;
            }
            let (r, j, _) = self.residual(p, &pose, s);
            cost += w * r * r;
            for a in 0..PARAMETERS {
                let wj = w * j[a];
                g[a] += wj * r;
                for b in a..PARAMETERS {
                    h[(a, b)] += wj * j[b];
                }
            }
        }
        for a in 0..PARAMETERS {
            for b in 0..a {
                h[(a, b)] = h[(b, a)];
            }
        }
        add_priors(self.priors(p), &mut h, &mut g, &mut cost);
        (h, g, cost)
    }

    /// Levenberg–Marquardt from `p`, at most `rounds` accepted or refused steps.
    fn descend(&self, mut p: Vector, rounds: usize) -> Option<Vector> {
        let mut damping = 1e-3;
        let (mut h, mut g, mut cost) = self.normal_equations(&p);
        for _ in 0..rounds {
            let mut damped = h;
            for i in 0..PARAMETERS {
                damped[(i, i)] *= 1.0 + damping;
            }
            let step = damped.cholesky()?.solve(&g);
            let next = p + step;
            let inside = next[5].abs() < 2.0
                && (next[0] - self.start.0).abs() < self.side_px + 2.0
                && (next[1] - self.start.1).abs() < self.side_px + 2.0;
            // Most steps are taken: the next equations are set up with the cost that decides it.
            let there = inside.then(|| self.normal_equations(&next));
            if let Some((next_h, next_g, next_cost)) = there.filter(|there| there.2 <= cost) {
                p = next;
                damping = (damping * 0.2).max(1e-9);
                let small = step[0].abs().max(step[1].abs()) < 2e-4 && (cost - next_cost) < 1e-4 * cost;
                if small {
                    return Some(p);
                }
                (h, g, cost) = (next_h, next_g, next_cost);
            } else {
                damping *= 6.0;
                if damping > 1e9 {
                    return Some(p);
                }
            }
        }
        Some(p)
    }

    /// Sets the weights from the noise model and Tukey's biweight of each residual about the fit `p`.
    fn reweigh(&mut self, p: &Vector, robust: bool) {
        // Residuals beyond this many standard deviations lose their weight; 4.7 is 95 % efficient on Gaussian noise.
        const CUT: f64 = 4.7;
        let (ground, paint, edge) = (self.priors.ground_sd, self.paint_sd, self.edge_sd);
        let pose = self.pose(p);
        let weights = self
            .samples
            .iter()
            .map(|s| {
                let (r, _, v) = self.residual(p, &pose, s);
                let variance =
                    ground * ground * (1.0 - v) * (1.0 - v) + paint * paint * v * v + 4.0 * edge * edge * v * (1.0 - v);
                let z = r * r / variance / (CUT * CUT);
                let trust = if !robust {
                    1.0
                } else if z < 1.0 {
                    (1.0 - z) * (1.0 - z)
                } else {
                    0.0
                };
                trust / variance
            })
            .collect();
        self.weights = weights;
    }

    /// Root mean square of what is left over, all samples alike.
    fn rms(&self, p: &Vector) -> f64 {
        let pose = self.pose(p);
        let squares: f64 = self.samples.iter().map(|s| self.residual(p, &pose, s).0.powi(2)).sum();
        (squares / self.samples.len() as f64).sqrt()
    }

    /// Robust standard deviation of the residuals of the samples whose shape value lies in a range.
    fn spread(&self, p: &Vector, low: f64, high: f64) -> Option<f64> {
        let pose = self.pose(p);
        let r: Vec<f64> = self
            .samples
            .iter()
            .filter_map(|s| {
                let (r, _, v) = self.residual(p, &pose, s);
                (low..=high).contains(&v).then_some(r.abs())
            })
            .collect();
        (r.len() >= 4).then(|| 1.4826 * super::patch::median(r))
    }
}

/// Sum of squares left over by the start itself, before any descent.
pub fn start_cost(
    form: Form,
    samples: &[Sample],
    start: (f64, f64),
    side_px: f64,
    angle_rad: f64,
    priors: Priors,
) -> f64 {
    let side = side_px.max(1.0).ln();
    let p = Vector::from([start.0, start.1, side, side, angle_rad, priors.blur_px.ln(), 1.0, 0.0, 0.0, 0.0]);
    let pose = Posed::new(form, &p);
    samples.iter().map(|s| (s.share - pose.at(s.x, s.y).0).powi(2)).sum()
}

/// Fits `form` to the samples from a start (centre, side, angle).
///
/// A first fit that leaves more than `rms_limit` over is not refined: robust weights do not make what is left over smaller.
///
/// `None` when there are fewer than 12 samples or the normal equations break down.
pub fn fit(
    form: Form,
    samples: &[Sample],
    start: (f64, f64),
    side_px: f64,
    angle_rad: f64,
    priors: Priors,
    rms_limit: f64,
) -> Option<Fit> {
    if samples.len() < 12 {
        return None;
    }
    let side = side_px.max(1.0).ln();
    let mut p = Vector::from([start.0, start.1, side, side, angle_rad, priors.blur_px.ln(), 1.0, 0.0, 0.0, 0.0]);
    let mut problem = Problem {
        form,
        samples,
        priors,
        start,
        side_px: side_px.max(1.0),
        paint_sd: (0.5 * priors.ground_sd).max(0.03),
        edge_sd: 0.08,
        weights: Vec::new(),
    };
    problem.reweigh(&p, false);
    p = problem.descend(p, 12)?;
    let rounds = if problem.rms(&p) > rms_limit { 0 } else { 2 };
    for round in 0..rounds {
        problem.paint_sd = problem.spread(&p, 0.9, 1.1).unwrap_or(problem.paint_sd).clamp(0.012, 0.25);
        problem.edge_sd = problem.spread(&p, 0.15, 0.85).unwrap_or(problem.edge_sd).clamp(0.015, 0.25);
        problem.reweigh(&p, true);
        p = problem.descend(p, if round == 0 { 8 } else { 6 })?;
    }
    report(&problem, &p)
}

fn report(problem: &Problem<'_>, p: &Vector) -> Option<Fit> {
    let (h, _, _) = problem.normal_equations(p);
    let inverse = h.cholesky()?.inverse();
    let scatter = edge_scatter(problem, p, &inverse);
    let (mut chi2, mut weight_sum, mut square, mut count) = (0.0, 0.0, 0.0, 0.0);
    let (mut lost, mut all) = (0.0, 0.0);
    let pose = problem.pose(p);
    for (s, &w) in problem.samples.iter().zip(&problem.weights) {
        let (r, _, v) = problem.residual(p, &pose, s);
        chi2 += w * r * r;
        weight_sum += 1.0;
        square += r * r;
        count += 1.0;
        if v > 0.3 {
            all += 1.0;
            lost += f64::from(u8::from(w == 0.0));
        }
    }
    let finite = p.iter().all(|v| v.is_finite()) && scatter.iter().all(|v| v.is_finite());
    finite.then(|| Fit {
        form: problem.form,
        x: p[0],
        y: p[1],
        sides_px: match problem.form {
            Form::Rectangle => [p[2].exp(), p[3].exp()],
            Form::Disc => [p[2].exp(); 2],
        },
        angle_rad: p[4],
        blur_px: p[5].exp(),
        height: p[6],
        scatter_px2: scatter,
        chi2: chi2 / weight_sum,
        rms: (square / count).sqrt(),
        hidden: if all > 0.0 { lost / all } else { 0.0 },
        edge_sd: problem.edge_sd,
    })
}

/// H⁻¹ (Σ_k s_k s_kᵀ) H⁻¹ for the centre along the two axes of the shape, where s_k sums what the samples of one line parallel
/// to an edge, a pixel wide, add to the gradient (clusters after K.-Y. Liang and S. L. Zeger, "Longitudinal data analysis using
/// generalized linear models", Biometrika 73(1), 1986). Along an edge in step with the pixel grid every pixel errs alike.
fn edge_scatter(problem: &Problem<'_>, p: &Vector, inverse: &Matrix) -> [f64; 3] {
    // Farther out nothing pushes.
    const LINES: usize = 192;
    let pose = problem.pose(p);
    let (sin, cos) = (pose.sin, pose.cos);
    let mut lines = [[0.0f64; LINES]; 2];
    let line = |at: f64| ((at.floor() + (LINES / 2) as f64).clamp(0.0, (LINES - 1) as f64)) as usize;
    for (s, &w) in problem.samples.iter().zip(&problem.weights).filter(|(_, w)| **w > 0.0) {
        let (r, j, _) = problem.residual(p, &pose, s);
        let push = [0, 1].map(|axis| w * r * (0..PARAMETERS).map(|k| inverse[(axis, k)] * j[k]).sum::<f64>());
        let (dx, dy) = (s.x - p[0], s.y - p[1]);
        lines[0][line(cos * dx + sin * dy)] += cos * push[0] + sin * push[1];
        lines[1][line(cos * dy - sin * dx)] += cos * push[1] - sin * push[0];
    }
    let [along, across] = lines.map(|l| l.iter().map(|v| v * v).sum::<f64>());
    [cos * cos * along + sin * sin * across, sin * cos * (along - across), sin * sin * along + cos * cos * across]
}

/// Adds priors to normal equations: of each its residual over its standard deviation and the parameters that it pulls at.
pub(crate) fn add_priors<const N: usize>(
    priors: impl IntoIterator<Item = (f64, [(usize, f64); 2])>,
    h: &mut SMatrix<f64, N, N>,
    g: &mut SVector<f64, N>,
    cost: &mut f64,
) {
    for (r, j) in priors {
        *cost += r * r;
        for (a, ja) in j {
            g[a] -= ja * r;
            for (b, jb) in j {
                h[(a, b)] += ja * jb;
            }
        }
    }
}

/// Scatter (xx, xy, yy) of a sum of pushes (W. K. Newey and K. D. West, "A simple, positive semi-definite, heteroskedasticity
/// and autocorrelation consistent covariance matrix", 1987), each `(column, row, push x, push y)`, that are correlated with their neighbours:
/// products of pushes weighted with a Bartlett kernel of 4 cells on a side. Not numbers when there are none.
pub(crate) fn correlated_scatter(pushes: &[(i64, i64, f64, f64)]) -> [f64; 3] {
    const REACH: i64 = 4;
    let (x0, y0) = pushes.iter().fold((i64::MAX, i64::MAX), |m, q| (m.0.min(q.0), m.1.min(q.1)));
    let (x1, y1) = pushes.iter().fold((i64::MIN, i64::MIN), |m, q| (m.0.max(q.0), m.1.max(q.1)));
    if pushes.is_empty() {
        return [f64::NAN; 3];
    }
    let (width, height) = ((x1 - x0 + 1) as usize, (y1 - y0 + 1) as usize);
    let mut grid = vec![[0.0f64; 2]; width * height];
    for &(x, y, px, py) in pushes {
        grid[(y - y0) as usize * width + (x - x0) as usize] = [px, py];
    }
    // The two-dimensional Bartlett kernel is the autocorrelation of a box, so the sum is that of squared box sums.
    let mut out = [0.0; 3];
    let box_area = (REACH * REACH) as f64;
    for top in -REACH + 1..height as i64 {
        for left in -REACH + 1..width as i64 {
            let mut sum = [0.0; 2];
            for y in top.max(0)..(top + REACH).min(height as i64) {
                for x in left.max(0)..(left + REACH).min(width as i64) {
                    let g = grid[y as usize * width + x as usize];
                    sum[0] += g[0];
                    sum[1] += g[1];
                }
            }
            out[0] += sum[0] * sum[0];
            out[1] += sum[0] * sum[1];
            out[2] += sum[1] * sum[1];
        }
    }
    out.map(|v| v / box_area)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_match_differences() {
        for form in [Form::Rectangle, Form::Disc] {
            let p = Vector::from([0.3, -0.2, 1.6, 1.5, 0.4, 0.1, 1.0, 0.0, 0.0, 0.0]);
            for (x, y) in [(2.0, 1.0), (-2.5, 0.5), (0.1, 3.0)] {
                let (_, g) = Posed::new(form, &p).at(x, y);
                for k in 0..6 {
                    let (mut up, mut down) = (p, p);
                    up[k] += 1e-3;
                    down[k] -= 1e-3;
                    let value = |p: &Vector| Posed::new(form, p).at(x, y).0;
                    let slope = (value(&up) - value(&down)) / 2e-3;
                    assert!((slope - g[k]).abs() < 3e-4, "{form:?} {k}: {slope} {}", g[k]);
                }
            }
        }
    }

    #[test]
    fn a_clean_shape_is_recovered() {
        let priors = Priors { aspect: 0.1, blur: 0.5, blur_px: 1.0, height: 0.3, slope: 0.02, ground_sd: 0.02 };
        for (form, angle) in [(Form::Rectangle, 0.3), (Form::Disc, 0.0)] {
            let truth = Vector::from([20.37, 19.81, 8f64.ln(), 8f64.ln(), angle, 0.0, 1.0, 0.0, 0.0, 0.0]);
            let samples: Vec<Sample> = (0..40 * 40)
                .map(|i| (f64::from(i % 40) + 0.5, f64::from(i / 40) + 0.5))
                .map(|(x, y)| Sample { x, y, share: Posed::new(form, &truth).at(x, y).0 })
                .collect();
            let f = fit(form, &samples, (20.0, 20.2), 7.0, 0.2, priors, f64::INFINITY).expect("well posed");
            assert!((f.x - 20.37).abs() < 0.005 && (f.y - 19.81).abs() < 0.005, "{f:?}");
            assert!((f.sides_px[0] - 8.0).abs() < 0.05, "{f:?}");
        }
    }
}
