//! Sub-pixel centres: fit of a blurred square or disc to the share of paint in each pixel.
//!
//! The model is a filled shape convolved with a Gaussian, which for a rectangle is a product of differences of normal
//! distribution functions, on a tilted plane of ground. It is fitted by Levenberg–Marquardt (D. W. Marquardt, "An
//! algorithm for least-squares estimation of nonlinear parameters", 1963) with iteratively reweighted residuals (P. J.
//! Huber, "Robust statistics", 1981). What is left over is ground texture and JPEG blocks, not white noise, so the
//! scatter of the centre is summed along the edges; the uncertainty room makes a covariance of it.

use nalgebra::{SMatrix, SVector};

use super::descent::{End, FIRST_DAMPING, Normal, Surface, Trust, at_rest, descend};
use super::kernels::{self, Form, Model, PARAMETERS, Samples};
use autoref_raster::coords::PixelPoint;

/// Parameters: centre x, y; logarithms of the two sides (disc: of the diameter, twice); angle; logarithm of the blur;
/// height; plane: constant, slope in x, slope in y.
type Vector = SVector<f64, PARAMETERS>;
type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;

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

/// A blurred shape of paint laid onto the pixels of a candidate.
#[derive(Clone, Debug)]
pub struct Fit {
    pub form: Form,
    pub x: f64,
    pub y: f64,
    pub sides_px: [f64; 2],
    pub angle_rad: f64,
    pub blur_px: f64,
    pub height: f64,
    /// Scatter of x and y by what is left over, summed along the edges: xx, xy, yy, px². Not yet a covariance: what the
    /// fit itself absorbs is not in it.
    pub scatter_px2: [f64; 3],
    /// Weighted mean square of what is left over, in units of the expected noise.
    pub chi2: f64,
    /// Root mean square of what is left over, as a share of paint.
    pub rms: f64,
    /// The same where the shape covers more than half of a pixel.
    pub rms_inside: f64,
    /// Share of the samples' weight that the robust weights took away from the inside and the border of the mark.
    pub hidden: f64,
    /// Robust standard deviation of what is left over on the border.
    pub edge_sd: f64,
}

impl Fit {
    /// The border of the shape about a centre, as a closed polygon in the units of the centre: four corners, or a disc
    /// in steps of 15°.
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

fn model(form: Form, p: &Vector, origin: (f64, f64)) -> Model {
    let (sin, cos) = p[4].sin_cos();
    Model {
        form,
        x: p[0],
        y: p[1],
        a: p[2].exp(),
        b: p[3].exp(),
        sigma: p[5].exp(),
        sin,
        cos,
        height: p[6],
        plane: [p[7], p[8], p[9]],
        origin,
    }
}

/// What a fit leaves over of each sample, and the value of the shape there.
#[derive(Default)]
struct Seen {
    left: Vec<f64>,
    values: Vec<f64>,
}

impl Seen {
    /// Root mean square of what is left over, all samples alike.
    fn rms(&self) -> f64 {
        (self.left.iter().map(|r| r * r).sum::<f64>() / self.left.len() as f64).sqrt()
    }

    /// Root mean square of what is left over where the shape covers more than half of a pixel; 1 of no pixel.
    fn rms_inside(&self) -> f64 {
        let inside = self.left.iter().zip(&self.values).filter(|(_, v)| **v > 0.5);
        let (sum, n) = inside.fold((0.0, 0.0), |(sum, n), (r, _)| (sum + r * r, n + 1.0));
        if n > 0.0 { f64::sqrt(sum / n) } else { 1.0 }
    }

    /// Robust standard deviation of what is left over where the shape's value lies in a range.
    fn spread(&self, low: f64, high: f64) -> Option<f64> {
        let inside = |v: &f64| (low..=high).contains(v);
        let r: Vec<f64> = self.left.iter().zip(&self.values).filter(|(_, v)| inside(v)).map(|(r, _)| r.abs()).collect();
        (r.len() >= 4).then(|| 1.4826 * autoref_raster::ranks::median(r))
    }
}

/// The normal equations at a place with the root mean square of what is left over, all samples alike.
struct Equations {
    normal: Normal<PARAMETERS>,
    rms: f64,
}

struct Problem<'a> {
    form: Form,
    samples: &'a Samples,
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

/// A problem with the limit that decides whether it is worth descending on.
struct Slope<'a> {
    problem: &'a Problem<'a>,
    rms_limit: f64,
}

impl Surface<PARAMETERS> for Slope<'_> {
    // Most steps are taken: the equations are set up with the cost that decides it.
    type Looked = Equations;

    fn look(&self, p: &Vector) -> Option<(f64, Equations)> {
        let Problem { start, side_px, .. } = self.problem;
        let inside =
            p[5].abs() < 2.0 && (p[0] - start.0).abs() < side_px + 2.0 && (p[1] - start.1).abs() < side_px + 2.0;
        inside.then(|| self.problem.normal_equations(p)).map(|there| (there.normal.cost, there))
    }

    fn normal(&self, _p: &Vector, looked: Equations) -> Option<Normal<PARAMETERS>> {
        Some(looked.normal)
    }

    fn rests(&self, step: &Vector, (before, after): (f64, f64), there: &Equations) -> bool {
        // No fit of 20,000 to planted marks, nor of 740 to clutter, that stood still so far above its limit came below
        // it.
        const FAR: f64 = 1.5;
        const SLOW: f64 = 0.95;
        let small = at_rest(step[0].abs().max(step[1].abs()), before, after);
        small || (there.rms > FAR * self.rms_limit && after > SLOW * before)
    }
}

impl Problem<'_> {
    fn model(&self, p: &Vector) -> Model {
        model(self.form, p, self.start)
    }

    fn look(&self, p: &Vector, seen: &mut Seen) {
        kernels::values(&self.model(p), self.samples, &mut seen.left, &mut seen.values);
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

    fn normal_equations(&self, p: &Vector) -> Equations {
        let sums = kernels::equations(&self.model(p), self.samples, &self.weights);
        let (mut h, mut g, mut cost) = (Matrix::zeros(), Vector::from(sums.pushes), sums.cost);
        let mut squares = sums.squares.into_iter();
        for a in 0..PARAMETERS {
            for b in a..PARAMETERS {
                let sum = squares.next().expect("a triangle has that many");
                (h[(a, b)], h[(b, a)]) = (sum, sum);
            }
        }
        add_priors(self.priors(p), &mut h, &mut g, &mut cost);
        Equations { normal: Normal { h, g, cost }, rms: (sums.left2 / self.samples.count() as f64).sqrt() }
    }

    /// Descends from `p`, at most `rounds` steps; fewer where what is left over would have to fall far to reach
    /// `rms_limit` and has almost come to rest.
    fn descend(&self, p: Vector, rounds: usize, rms_limit: f64) -> Option<Vector> {
        let slope = Slope { problem: self, rms_limit };
        descend(&slope, p, self.normal_equations(&p), rounds, &mut { FIRST_DAMPING }).map(End::place)
    }

    /// Sets the weights from the noise model and Tukey's biweight of what the fit leaves over.
    fn reweigh(&mut self, seen: &Seen, trust: Trust) {
        // Residuals beyond this many standard deviations lose their weight; 4.7 is 95 % efficient on Gaussian noise.
        const CUT: f64 = 4.7;
        let (ground, paint, edge) = (self.priors.ground_sd, self.paint_sd, self.edge_sd);
        let weight = |(r, v): (&f64, &f64)| {
            let variance =
                ground * ground * (1.0 - v) * (1.0 - v) + paint * paint * v * v + 4.0 * edge * edge * v * (1.0 - v);
            let z = r * r / variance / (CUT * CUT);
            let trust = match trust {
                Trust::Even => 1.0,
                Trust::Robust if z < 1.0 => (1.0 - z) * (1.0 - z),
                Trust::Robust => 0.0,
            };
            trust / variance
        };
        self.weights.clear();
        self.weights.extend(seen.left.iter().zip(&seen.values).map(weight));
    }
}

fn start_vector(start: (f64, f64), side_px: f64, angle_rad: f64, priors: &Priors) -> Vector {
    let side = side_px.max(1.0).ln();
    Vector::from([start.0, start.1, side, side, angle_rad, priors.blur_px.ln(), 1.0, 0.0, 0.0, 0.0])
}

/// Sum of squares left over by the start itself, before any descent.
pub fn start_cost(
    form: Form,
    samples: &Samples,
    start: (f64, f64),
    side_px: f64,
    angle_rad: f64,
    priors: &Priors,
) -> f64 {
    let mut seen = Seen::default();
    let model = model(form, &start_vector(start, side_px, angle_rad, priors), start);
    kernels::values(&model, samples, &mut seen.left, &mut seen.values);
    seen.left.iter().map(|r| r * r).sum()
}

/// Fits `form` to the samples from a start (centre, side, angle).
///
/// A first fit that leaves more than `rms_limit` over is not refined: robust weights do not make what is left over
/// smaller.
///
/// `None` when there are fewer than 12 samples or the normal equations break down.
pub fn fit(
    form: Form,
    samples: &Samples,
    start: (f64, f64),
    side_px: f64,
    angle_rad: f64,
    priors: Priors,
    rms_limit: f64,
) -> Option<Fit> {
    if samples.count() < 12 {
        return None;
    }
    let mut p = start_vector(start, side_px, angle_rad, &priors);
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
    let mut seen = Seen::default();
    problem.look(&p, &mut seen);
    problem.reweigh(&seen, Trust::Even);
    p = problem.descend(p, 12, rms_limit)?;
    problem.look(&p, &mut seen);
    let rounds = if seen.rms() > rms_limit { 0 } else { 2 };
    for round in 0..rounds {
        problem.paint_sd = seen.spread(0.9, 1.1).unwrap_or(problem.paint_sd).clamp(0.012, 0.25);
        problem.edge_sd = seen.spread(0.15, 0.85).unwrap_or(problem.edge_sd).clamp(0.015, 0.25);
        problem.reweigh(&seen, Trust::Robust);
        p = problem.descend(p, if round == 0 { 8 } else { 6 }, f64::INFINITY)?;
        problem.look(&p, &mut seen);
    }
    report(&problem, &p, &seen)
}

fn report(problem: &Problem<'_>, p: &Vector, seen: &Seen) -> Option<Fit> {
    let inverse = problem.normal_equations(p).normal.h.cholesky()?.inverse();
    let scatter = edge_scatter(problem, p, &inverse);
    let (mut chi2, mut lost, mut all) = (0.0, 0.0, 0.0);
    for ((r, v), &w) in seen.left.iter().zip(&seen.values).zip(&problem.weights) {
        chi2 += w * r * r;
        if *v > 0.3 {
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
        chi2: chi2 / seen.left.len() as f64,
        rms: seen.rms(),
        rms_inside: seen.rms_inside(),
        hidden: if all > 0.0 { lost / all } else { 0.0 },
        edge_sd: problem.edge_sd,
    })
}

/// H⁻¹ (Σ_k s_k s_kᵀ) H⁻¹ for the centre along the two axes of the shape, where s_k sums what the samples of one line
/// parallel to an edge, a pixel wide, add to the gradient (clusters after K.-Y. Liang and S. L. Zeger, "Longitudinal
/// data analysis using generalized linear models", Biometrika 73(1), 1986). Along an edge in step with the pixel grid
/// every pixel errs alike.
fn edge_scatter(problem: &Problem<'_>, p: &Vector, inverse: &Matrix) -> [f64; 3] {
    // Farther out nothing pushes.
    const LINES: usize = 192;
    let model = problem.model(p);
    let (sin, cos) = (model.sin, model.cos);
    let mut lines = [[0.0f64; LINES]; 2];
    let line = |at: f64| ((at.floor() + (LINES / 2) as f64).clamp(0.0, (LINES - 1) as f64)) as usize;
    kernels::gradients(&model, problem.samples, |i, [x, y], r, j| {
        let push =
            [0, 1].map(|axis| problem.weights[i] * r * (0..PARAMETERS).map(|k| inverse[(axis, k)] * j[k]).sum::<f64>());
        let (dx, dy) = (x - p[0], y - p[1]);
        lines[0][line(cos * dx + sin * dy)] += cos * push[0] + sin * push[1];
        lines[1][line(cos * dy - sin * dx)] += cos * push[1] - sin * push[0];
    });
    let [along, across] = lines.map(|l| l.iter().map(|v| v * v).sum::<f64>());
    [cos * cos * along + sin * sin * across, sin * cos * (along - across), sin * sin * along + cos * cos * across]
}

/// Adds priors to normal equations: of each its residual over its standard deviation and the parameters that it pulls
/// at.
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

/// Scatter (xx, xy, yy) of a sum of pushes (W. K. Newey and K. D. West, "A simple, positive semi-definite,
/// heteroskedasticity and autocorrelation consistent covariance matrix", 1987), each `(column, row, push x, push y)`,
/// that are correlated with their neighbours: products of pushes weighted with a Bartlett kernel of 4 cells on a side.
/// Not numbers when there are none.
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
    use super::super::kernels::Sample;
    use super::*;

    #[test]
    fn a_clean_shape_is_recovered() {
        let priors = Priors { aspect: 0.1, blur: 0.5, blur_px: 1.0, height: 0.3, slope: 0.02, ground_sd: 0.02 };
        for (form, angle) in [(Form::Rectangle, 0.3), (Form::Disc, 0.0)] {
            let truth = Vector::from([20.37, 19.81, 8f64.ln(), 8f64.ln(), angle, 0.0, 1.0, 0.0, 0.0, 0.0]);
            let mut seen = Seen::default();
            let places = |i: usize| Sample { x: (i % 40) as f64 + 0.5, y: (i / 40) as f64 + 0.5, share: 0.0 };
            let places = || (0..40 * 40).map(places);
            kernels::values(&model(form, &truth, (0.0, 0.0)), &places().collect(), &mut seen.left, &mut seen.values);
            let samples = places().zip(seen.values).map(|(s, share)| Sample { share, ..s }).collect();
            let f = fit(form, &samples, (20.0, 20.2), 7.0, 0.2, priors, f64::INFINITY).expect("well posed");
            assert!((f.x - 20.37).abs() < 0.005 && (f.y - 19.81).abs() < 0.005, "{f:?}");
            assert!((f.sides_px[0] - 8.0).abs() < 0.05, "{f:?}");
        }
    }

    /// The definition, pair by pair.
    #[test]
    fn neighbours_are_weighed_by_bartletts_kernel_of_four_cells() {
        let push = |k: i64, m: i64| ((k * m) % 17) as f64 - 8.0;
        let pushes: Vec<(i64, i64, f64, f64)> =
            (0..60).filter(|k| k % 7 != 3).map(|k| (40 + k % 9, 70 + k / 9, push(k, 5), push(k, 11))).collect();
        let weight = |d: i64| (1.0 - d.abs() as f64 / 4.0).max(0.0);
        let mut sums = [0.0; 3];
        for a in &pushes {
            for b in &pushes {
                let w = weight(a.0 - b.0) * weight(a.1 - b.1);
                sums[0] += w * a.2 * b.2;
                sums[1] += w * (a.2 * b.3 + a.3 * b.2) / 2.0;
                sums[2] += w * a.3 * b.3;
            }
        }
        let scatter = correlated_scatter(&pushes);
        assert!(sums.iter().zip(scatter).all(|(a, b)| (a - b).abs() < 1e-9 * a.abs().max(1.0)), "{sums:?} {scatter:?}");
    }
}
