//! A target in two lights, fitted whole: two lines that cross, the border of a shadow, and the levels of bright and
//! dark on either side of it.
//!
//! `level = c₀ + c₁·v + H·(c₂ + c₃·v)`, where `v` is the motif's share of bright ([`super::fit`]) and `H = Φ(d/s)` the
//! share of shade at the signed distance `d` from the border. Levels that were mapped to one light leave a seam where
//! the border is a little off, and the fit of a shape takes the seam for an edge; here border and edges are told apart.
//! Levenberg–Marquardt with Tukey's weights and the sandwich covariance, as in even light.

use nalgebra::{SMatrix, SVector};

use super::Motif;
use super::fit::{Fit, tukey_weights};
use super::kernels::{self, Cells, Pose, Sample};
use super::shade::{Levels, Shade};
use crate::candidate::descent::{FIRST_DAMPING, Normal, Surface, at_rest, descend};
use crate::candidate::fit::{add_priors, correlated_scatter};
use crate::candidate::kernels::normal;

/// Of the shape: centre, two directions, logarithms of two widths and of the blur.
const SHAPE: usize = 7;
/// Direction of the border, its place along it, logarithm of its blur; ground and height in the light, and what the
/// shade adds to them.
const PARAMETERS: usize = SHAPE + 7;
const ROUNDS: usize = 3;
/// What the noise of neighbours has in common multiplies the variance that independent noise of a hundredth of the
/// height would give.
const CORRELATED: f64 = 4.0;
/// What the model itself is off, in deviations of the blur: light adds up before cameras bend it to grey levels, so
/// that edges move towards the dark, and no longer alike on all sides.
const OWN_SHARE: f64 = 0.03;

type Vector = SVector<f64, PARAMETERS>;
type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;

struct Problem<'a> {
    motif: Motif,
    samples: &'a [Sample],
    cells: Cells,
    start: Vector,
    /// Where the border's place is counted from.
    origin: (f64, f64),
    weights: Vec<f64>,
    skew: f64,
}

impl Problem<'_> {
    /// The motif, bright 1 on dark 0.
    fn pose(&self, p: &Vector) -> Pose {
        Pose::bright(self.motif, (p[0], p[1]), [p[2], p[3]], [p[4].exp(), p[5].exp()], p[6].exp())
    }

    /// Calls `each` with every sample, what the model leaves over there and the model's gradient.
    fn each(&self, p: &Vector, mut each: impl FnMut(usize, f64, Vector)) {
        let ((sin, cos), soft) = (p[SHAPE].sin_cos(), p[SHAPE + 2].exp());
        let [c0, c1, c2, c3] = [p[SHAPE + 3], p[SHAPE + 4], p[SHAPE + 5], p[SHAPE + 6]];
        kernels::gradients(&self.pose(p), &self.cells, |i, v, by| {
            let s = &self.samples[i];
            let (dx, dy) = (s.x - self.origin.0, s.y - self.origin.1);
            let d = dx * cos + dy * sin - p[SHAPE + 1];
            let (density, share) = normal(d / soft);
            let (height, change) = (c1 + c3 * share, (c2 + c3 * v) * density / soft);
            let mut j = Vector::zeros();
            for k in 0..SHAPE {
                j[k] = height * by[k];
            }
            j[SHAPE] = change * (dy * cos - dx * sin);
            j[SHAPE + 1] = -change;
            j[SHAPE + 2] = -change * d;
            j[SHAPE + 3] = 1.0;
            j[SHAPE + 4] = v;
            j[SHAPE + 5] = share;
            j[SHAPE + 6] = share * v;
            each(i, s.level - (c0 + c1 * v + share * (c2 + c3 * v)), j);
        });
    }

    fn residuals(&self, p: &Vector) -> Vec<f64> {
        let mut left = vec![0.0; self.samples.len()];
        self.each(p, |i, r, _| left[i] = r);
        left
    }

    /// Residual over its standard deviation and the parameters that it pulls at.
    fn priors(&self, p: &Vector) -> [(f64, [(usize, f64); 2]); 6] {
        let q = &self.start;
        let right = std::f64::consts::FRAC_PI_2;
        [
            ((p[3] - p[2] - right) / self.skew, [(3, 1.0 / self.skew), (2, -1.0 / self.skew)]),
            ((p[4] - p[5]) / 0.15, [(4, 1.0 / 0.15), (5, -1.0 / 0.15)]),
            (((p[4] + p[5]) - (q[4] + q[5])) / 1.4, [(4, 1.0 / 1.4), (5, 1.0 / 1.4)]),
            ((p[6] - q[6]) / 0.7, [(6, 1.0 / 0.7), (6, 0.0)]),
            // A shadow's border is as soft as the picture, or softer with the height of what throws it.
            (p[SHAPE + 2] - q[SHAPE + 2], [(SHAPE + 2, 1.0), (SHAPE + 2, 0.0)]),
            (0.0, [(SHAPE + 3, 1e-3), (SHAPE + 4, 1e-3)]),
        ]
    }

    fn equations(&self, p: &Vector) -> Normal<PARAMETERS> {
        let (mut h, mut g, mut cost) = (Matrix::zeros(), Vector::zeros(), 0.0);
        self.each(p, |i, r, j| {
            let w = self.weights[i];
            if w > 0.0 {
                h.syger(w, &j, &j, 1.0);
                g += j * (w * r);
                cost += w * r * r;
            }
        });
        h.fill_upper_triangle_with_lower_triangle();
        add_priors(self.priors(p), &mut h, &mut g, &mut cost);
        Normal { h, g, cost }
    }
}

impl Surface<PARAMETERS> for Problem<'_> {
    type Looked = ();

    fn look(&self, p: &Vector) -> Option<(f64, ())> {
        let (q, width) = (&self.start, self.start[4].exp());
        let inside = (p[0] - q[0]).hypot(p[1] - q[1]) < 2.0 * width + 2.0
            && [4, 5, 6, SHAPE + 2].into_iter().all(|k| (p[k] - q[k]).abs() < 2.0);
        inside.then(|| {
            let data: f64 = self.residuals(p).iter().zip(&self.weights).map(|(r, w)| w * r * r).sum();
            (data + self.priors(p).iter().map(|(r, _)| r * r).sum::<f64>(), ())
        })
    }

    fn normal(&self, p: &Vector, (): ()) -> Option<Normal<PARAMETERS>> {
        Some(self.equations(p))
    }

    fn rests(&self, step: &Vector, (before, after): (f64, f64), (): &()) -> bool {
        at_rest(step[0].hypot(step[1]), before, after)
    }
}

/// Fits the motif and the border at once, from the fit `start` to levels in one light. The levels of the result are
/// those in the light.
///
/// `None` with fewer than 60 samples, or where the equations break down or the fit runs away.
pub fn fit(motif: Motif, samples: &[Sample], start: &Fit, shade: &Shade, skew: f64) -> Option<(Fit, Shade)> {
    let n = samples.len() as f64;
    if samples.len() < 60 {
        return None;
    }
    let mean = samples.iter().map(|s| s.level).sum::<f64>() / n;
    let total: f64 = samples.iter().map(|s| (s.level - mean).powi(2)).sum();
    let (lit, shaded) = (shade.lit, shade.shaded);
    let origin = (start.x, start.y);
    let (sin, cos) = shade.direction.sin_cos();
    let mut p = Vector::from([
        start.x,
        start.y,
        start.angles[0],
        start.angles[1],
        start.widths[0].ln(),
        start.widths[1].ln(),
        start.blur.max(0.3).ln(),
        shade.direction,
        (shade.x - origin.0) * cos + (shade.y - origin.1) * sin,
        shade.soft.max(0.3).ln(),
        lit.ground,
        lit.height,
        shaded.ground - lit.ground,
        shaded.height - lit.height,
    ]);
    let noise = (0.1 * lit.height.abs()).max(2.0);
    let weights = vec![1.0 / (noise * noise); samples.len()];
    let mut problem = Problem { motif, samples, cells: Cells::new(samples), start: p, origin, weights, skew };
    p = descend(&problem, p, (), 20, &mut { FIRST_DAMPING })?.place();
    for _ in 0..ROUNDS {
        problem.weights = tukey_weights(&problem.residuals(&p), p[SHAPE + 4]);
        p = descend(&problem, p, (), 8, &mut { FIRST_DAMPING })?.place();
    }
    let inverse = problem.equations(&p).h.cholesky()?.inverse();
    let (mut pushes, mut left) = (Vec::with_capacity(samples.len()), 0.0);
    problem.each(&p, |i, r, j| {
        left += r * r;
        let w = problem.weights[i];
        if w > 0.0 {
            let along = inverse.fixed_rows::<2>(0) * j * (w * r);
            pushes.push((samples[i].x.floor() as i64, samples[i].y.floor() as i64, along[0], along[1]));
        }
    });
    let lost = n / (n - PARAMETERS as f64);
    // Where border and edge lie so near that they stand for each other, a model that is a little off moves both far.
    let [xx, xy, yy] = correlated_scatter(&pushes).map(|v| v * lost);
    let known = |i: usize, j: usize| CORRELATED * inverse[(i, j)];
    let own = (OWN_SHARE * p[6].exp()).powi(2);
    let covariance = [xx + known(0, 0) + own, xy + known(0, 1), yy + known(1, 1) + own];
    let finite = p.iter().chain(&covariance).all(|v| v.is_finite()) && covariance[0] > 0.0 && covariance[2] > 0.0;
    let (sin, cos) = p[SHAPE].sin_cos();
    let levels = |share: f64| Levels {
        ground: p[SHAPE + 3] + share * p[SHAPE + 5],
        height: p[SHAPE + 4] + share * p[SHAPE + 6],
    };
    let found = Fit {
        x: p[0],
        y: p[1],
        angles: [p[2], p[3]],
        widths: [p[4].exp(), p[5].exp()],
        blur: p[6].exp(),
        ground: p[SHAPE + 3],
        height: p[SHAPE + 4],
        covariance,
        misfit: left / total.max(1e-9),
    };
    let border = Shade {
        direction: p[SHAPE],
        x: origin.0 + p[SHAPE + 1] * cos,
        y: origin.1 + p[SHAPE + 1] * sin,
        soft: p[SHAPE + 2].exp(),
        lit: levels(0.0),
        shaded: levels(1.0),
    };
    finite.then_some((found, border))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::black_white::shade;

    const LIT: Levels = Levels { ground: 30.0, height: 200.0 };
    const SHADED: Levels = Levels { ground: 14.0, height: 90.0 };

    fn truth(motif: Motif) -> Vector {
        let width = if motif == Motif::Cross { 8.0f64 } else { 14.0 };
        let (ground, height) = (SHADED.ground - LIT.ground, SHADED.height - LIT.height);
        let mut p =
            Vector::from([20.3, 19.8, 0.3, 1.87, 0.0, 0.0, 0.1, 1.1, 3.0, 0.4, LIT.ground, LIT.height, 0.0, 0.0]);
        (p[4], p[5], p[12], p[13]) = (width.ln(), width.ln(), ground, height);
        p
    }

    fn problem(motif: Motif, samples: &[Sample]) -> Problem<'_> {
        let start = truth(motif);
        let (cells, weights) = (Cells::new(samples), vec![1.0; samples.len()]);
        Problem { motif, samples, cells, start, origin: (20.0, 20.0), weights, skew: 0.15 }
    }

    /// Samples of a disc as the model has them.
    fn drawn(motif: Motif) -> Vec<Sample> {
        let place = |i: i32| (f64::from(i % 40) + 0.5, f64::from(i / 40) + 0.5);
        let dark: Vec<Sample> = (0..40 * 40).map(place).map(|(x, y)| Sample { x, y, level: 0.0 }).collect();
        let levels = problem(motif, &dark).residuals(&truth(motif)).into_iter().map(|r| -r);
        let seen = dark.iter().zip(levels).map(|(s, level)| Sample { level, ..*s });
        seen.filter(|s| (s.x - 20.0).hypot(s.y - 20.0) <= 14.0).collect()
    }

    #[test]
    fn gradients_match_differences() {
        for motif in [Motif::Cross, Motif::Saddle] {
            let samples = [Sample { x: 22.5, y: 18.5, level: 0.0 }, Sample { x: 19.5, y: 24.5, level: 0.0 }];
            let (q, p) = (problem(motif, &samples), truth(motif));
            let mut by = [Vector::zeros(); 2];
            q.each(&p, |i, _, j| by[i] = j);
            for k in 0..PARAMETERS {
                let (mut up, mut down) = (p, p);
                up[k] += 1e-4;
                down[k] -= 1e-4;
                for (i, (low, high)) in q.residuals(&down).into_iter().zip(q.residuals(&up)).enumerate() {
                    let slope = (low - high) / 2e-4;
                    assert!((slope - by[i][k]).abs() < 0.02, "{motif:?} {k}: {slope} {}", by[i][k]);
                }
            }
        }
    }

    /// From a fit in one light that is off, by way of the border that it shows.
    #[test]
    fn a_target_in_two_lights_is_recovered() {
        for motif in [Motif::Cross, Motif::Saddle] {
            let (samples, p) = (drawn(motif), truth(motif));
            let start = Fit {
                x: p[0] + 0.6,
                y: p[1] - 0.5,
                angles: [p[2] + 0.03, p[3] - 0.02],
                widths: [p[4].exp(), p[5].exp()],
                blur: 1.2,
                ground: 25.0,
                height: 150.0,
                covariance: [0.0; 3],
                misfit: 0.2,
            };
            let border = shade::across(&samples, &start.shares(motif, &samples), start.blur).expect("two lights");
            assert!((border.direction - p[7]).abs() < 0.3, "{border:?}");
            let (found, shade) = fit(motif, &samples, &start, &border, 0.15).expect("well posed");
            assert!((found.x - p[0]).hypot(found.y - p[1]) < 0.02, "{motif:?}: {found:?}");
            assert!(found.misfit < 1e-4, "{found:?}");
            assert!((shade.shaded.height - SHADED.height).abs() < 2.0, "{shade:?}");
        }
    }
}
