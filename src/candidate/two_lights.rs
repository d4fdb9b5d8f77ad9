//! A mark in two lights, fitted whole: shape, colours of paint and ground, the border of the shadow and the ratio of
//! the two lights at once.
//!
//! Dividing the darker part by a ratio ([`super::shadow`]) leaves a seam wherever border or ratio are a little off, and
//! the fit of a shape takes the seam for an edge. Here the colours of the pixels themselves are the observations: a
//! blurred shape of paint on ground, times the light, which falls across a straight blurred border. Where the border
//! meets the outline, the blurred product is more than the product of the two blurred pictures, to first order by the
//! variance of the blur times the product of their slopes. A JPEG's coefficients are fitted again
//! ([`super::two_lights_jpeg`]). Levenberg–Marquardt with
//! Tukey's weights, as in [`super::fit`]; the covariance of the centre is that of correlated residuals (W. K. Newey and
//! K. D. West, 1987).

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::descent::{End, FIRST_DAMPING, Normal, Surface, Trust, at_rest, descend};
use super::fit::{Fit, add_priors, correlated_scatter};
use super::kernels::{Form, Sample, Samples};
use super::lights::{BORDER, Centre, GROUND, Lights, PAINT, PARAMETERS, RATIO, Vector, ground_at, light, model};
use super::pixel_set::PixelSet;
use super::scene::{Ground, Scene};
use super::shadow::{Line, lit_ground};
use super::two_lights_jpeg;
use crate::segment::classify::Classifier;

type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// The fit sees this far outside the region.
const REACH_PX: usize = 7;
/// Variance of a sample that is neither texture nor edge, levels of 255 squared: sensor and JPEG.
const NOISE2: f64 = 9.0;
/// Share of the step from ground to paint by which a model of an edge errs.
const EDGE_SD: f64 = 0.08;
/// Residuals beyond this many deviations lose their weight.
const CUT: f64 = 4.7;
/// Ground further from the border of the shadow is clear of it.
const CLEAR_PX: f64 = 3.0;
/// Rounds of weights.
const ROUNDS: usize = 3;

/// Fits the mark whose pixels `own` about are, from the shape `start`, the border and the ratio of the lights.
/// `ground` is that of even light.
///
/// `None` where the equations break down or the fit runs away from where it began.
pub(super) fn fit(
    scene: &Scene<'_>,
    own: &PixelSet,
    start: &Fit,
    (border, ratio): (&Line, [f64; 3]),
    (classifier, ground): (&Classifier, &Ground),
) -> Option<Centre> {
    let hidden = scene.beside_other().minus(own);
    let (mut samples, mut colours) = (Samples::default(), Vec::new());
    own.grown(REACH_PX).and(&scene.valid).minus(&hidden).for_each(|i| {
        let (x, y) = ((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5);
        samples.push(Sample { x, y, share: 0.0 });
        colours.push(scene.colour(i));
    });
    if colours.len() < 4 * PARAMETERS {
        return None;
    }
    let side_px = (start.sides_px[0] * start.sides_px[1]).sqrt();
    // Beside the border the light that was divided out leaves colours that no ground has, most of all in a JPEG.
    let lit = lit_ground(scene, border, CLEAR_PX);
    let ground = lit.as_ref().unwrap_or(ground);
    let mut lights = Lights {
        form: start.form,
        samples,
        colours,
        weights: Vec::new(),
        start: (start.x, start.y),
        side_px,
        width_px: border.width,
        texture: ground.covariance,
    };
    let mut p = lights.first(start, border, ratio);
    lights.reweigh(&p, Trust::Even);
    for round in 0..ROUNDS {
        let (_, normal) = lights.look(&p)?;
        p = descend(&lights, p, normal, if round == 0 { 30 } else { 12 }, &mut { FIRST_DAMPING }).map(End::place)?;
        lights.reweigh(&p, Trust::Robust);
    }
    let by_pixels = lights.report(&p)?;
    Some(two_lights_jpeg::refine(scene, classifier, start, (&p, &lights), ground).unwrap_or(by_pixels))
}

impl Lights {
    /// Where the descent begins.
    fn first(&self, start: &Fit, border: &Line, ratio: [f64; 3]) -> Vector {
        let (x, y) = self.start;
        let mut p = Vector::zeros();
        p[0] = x;
        p[1] = y;
        p[2] = start.sides_px[0].ln();
        p[3] = start.sides_px[1].ln();
        p[4] = start.angle_rad;
        p[5] = start.blur_px.clamp(0.5, 3.0).ln();
        p[BORDER] = border.direction.1.atan2(border.direction.0);
        p[BORDER + 1] = border.offset - x * border.direction.0 - y * border.direction.1;
        p[BORDER + 2] = border.width.ln();
        (0..3).for_each(|c| p[RATIO + c] = ratio[c]);
        // Colours are linear in all else: regress them.
        let (mut squares, mut pushes) = ([[[0.0f64; 3]; 2]; 3], [[0.0f64; 2]; 3]);
        self.each(&p, |at| {
            for c in 0..3 {
                let light = ratio[c] + (1.0 - ratio[c]) * at.light;
                let j = [at.share * light, (1.0 - at.share) * light];
                for a in 0..2 {
                    (0..2).for_each(|b| squares[c][a][b] += j[a] * j[b]);
                    pushes[c][a] += j[a] * self.colours[at.i][c];
                }
            }
        });
        for c in 0..3 {
            let ([[aa, ab, _], [_, bb, _]], [a, b]) = (squares[c], pushes[c]);
            let det = aa * bb - ab * ab;
            if det > 1e-9 {
                p[PAINT + c] = (bb * a - ab * b) / det;
                p[GROUND + c] = (aa * b - ab * a) / det;
            }
        }
        p
    }

    /// Weights from what texture, noise and edges are expected to leave over; robust ones also from what is left over.
    fn reweigh(&mut self, p: &Vector, trust: Trust) {
        let mut weights = Vec::with_capacity(self.colours.len());
        self.each(p, |at| {
            let light = Vector3::from_fn(|c, _| light(p, c, at.light));
            let lit = light.sum() / 3.0;
            let edge = Vector3::from_fn(|c, _| (p[PAINT + c] - ground_at(p, c, &at)) * light[c]);
            let v = at.share;
            let variance = self.texture * (lit * lit * (1.0 - v) * (1.0 - v))
                + Matrix3::identity() * NOISE2
                + edge * edge.transpose() * (4.0 * EDGE_SD * EDGE_SD * v * (1.0 - v).max(0.0));
            let weight = variance.try_inverse().unwrap_or_else(Matrix3::zeros);
            let trusted = match trust {
                Trust::Even => 1.0,
                Trust::Robust => {
                    let left = self.colours[at.i] - model(p, &at);
                    let z = left.dot(&(weight * left)) / 3.0 / (CUT * CUT);
                    if z < 1.0 { (1.0 - z) * (1.0 - z) } else { 0.0 }
                }
            };
            weights.push(weight * trusted);
        });
        self.weights = weights;
    }

    fn equations(&self, p: &Vector) -> Normal<PARAMETERS> {
        let (mut h, mut g, mut cost) = (Matrix::zeros(), Vector::zeros(), 0.0);
        self.each(p, |at| {
            let weight = &self.weights[at.i];
            let left = self.colours[at.i] - model(p, &at);
            let j = Self::jacobian(p, &at);
            let weighed = weight * j;
            h += j.transpose() * weighed;
            g += weighed.transpose() * left;
            cost += left.dot(&(weight * left));
        });
        add_priors(self.priors(p), &mut h, &mut g, &mut cost);
        Normal { h, g, cost }
    }

    fn report(&self, p: &Vector) -> Option<Centre> {
        let inverse = self.equations(p).h.cholesky()?.inverse();
        let mut pushes = Vec::with_capacity(self.colours.len());
        self.each(p, |at| {
            let left = self.colours[at.i] - model(p, &at);
            let pulled = self.weights[at.i] * left;
            let push = Self::jacobian(p, &at).transpose() * pulled;
            let along = |axis: usize| (inverse.row(axis) * push)[0];
            pushes.push((at.place[0].floor() as i64, at.place[1].floor() as i64, along(0), along(1)));
        });
        /// What the residuals do not show: the error of the border's shape, measured on drawn marks.
        const UNSEEN: f64 = 3.0;
        const OF_SIDE: f64 = 0.006;
        const DOUBT: f64 = 0.25;
        let scatter = correlated_scatter(&pushes);
        let side_px = ((p[2] + if self.form == Form::Disc { p[2] } else { p[3] }) / 2.0).exp();
        let ratio = (p[RATIO] + p[RATIO + 1] + p[RATIO + 2]) / 3.0;
        let floor = (OF_SIDE * side_px).powi(2);
        let covariance_px2 = [UNSEEN * scatter[0] + floor, UNSEEN * scatter[1], UNSEEN * scatter[2] + floor];
        let sane = p.iter().chain(&covariance_px2).all(|v| v.is_finite()) && (0.02..1.0).contains(&ratio);
        sane.then(|| Centre { x: p[0], y: p[1], covariance_px2, doubt: DOUBT })
    }
}

impl Surface<PARAMETERS> for Lights {
    type Looked = Normal<PARAMETERS>;

    fn look(&self, p: &Vector) -> Option<(f64, Normal<PARAMETERS>)> {
        let near = |k: usize, start: f64| (p[k] - start).abs() < self.side_px + 2.0;
        let inside = near(0, self.start.0)
            && near(1, self.start.1)
            && p[5].abs() < 2.0
            && (-1.5..2.0).contains(&p[BORDER + 2])
            && p[BORDER + 1].abs() < 2.0 * self.side_px + 4.0;
        inside.then(|| self.equations(p)).map(|normal| (normal.cost, normal))
    }

    fn normal(&self, _p: &Vector, looked: Normal<PARAMETERS>) -> Option<Normal<PARAMETERS>> {
        Some(looked)
    }

    fn rests(&self, step: &Vector, (before, after): (f64, f64), _: &Normal<PARAMETERS>) -> bool {
        at_rest(step[0].abs().max(step[1].abs()), before, after)
    }
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{SIDE, colour, inside, patch_of};
    use super::*;
    use crate::profile::Profile;
    use autoref_raster::SampleType;

    #[test]
    fn the_centre_of_a_mark_in_two_lights_is_found_from_a_start_a_pixel_off() {
        // A square of 12 px about (24.3, 23.8), turned by 0.2, that a shadow × 0.4 covers beyond a line: each pixel the
        // mean of 64 places.
        let (sin, cos) = 0.2f64.sin_cos();
        let patch = patch_of(|i| {
            let mut sum = [0.0; 3];
            for k in 0..64 {
                let within = |k: usize| (k as f64 + 0.5) / 8.0;
                let (x, y) = ((i % SIDE) as f64 + within(k % 8), (i / SIDE) as f64 + within(k / 8));
                let (u, v) = (x - 24.3, y - 23.8);
                let is_paint = (u * cos + v * sin).abs() < 6.0 && (v * cos - u * sin).abs() < 6.0;
                let light = if x + 0.3 * y > 31.0 { 0.4 } else { 1.0 };
                let here = colour(i, is_paint);
                (0..3).for_each(|c| sum[c] += here[c] * light / 64.0);
            }
            sum
        });
        let own = inside(18..30, 18..30);
        let scene = Scene::of_pixels(&patch, own.clone(), &own);
        let start = Fit {
            form: Form::Rectangle,
            x: 23.4,
            y: 24.5,
            sides_px: [10.5, 11.0],
            angle_rad: 0.1,
            blur_px: 1.0,
            height: 1.0,
            scatter_px2: [0.01, 0.0, 0.01],
            chi2: 1.0,
            rms: 0.1,
            rms_inside: 0.03,
            hidden: 0.0,
            edge_sd: 0.08,
        };
        let norm = 1.0f64.hypot(0.3);
        let border = Line { direction: (-1.0 / norm, -0.3 / norm), offset: -31.8 / norm, width: 1.0 };
        let ground = Ground { mean: colour(0, false).into(), covariance: Matrix3::identity() * 2.0, count: 100 };
        let profile = Profile::builtin("orange").expect("it ships");
        let classifier = Classifier::new(&profile, SampleType::U8, 255, [0, 1, 2], None, None).expect("valid");
        let lights = (&border, [0.5; 3]);
        let centre = fit(&scene, &own, &start, lights, (&classifier, &ground)).expect("a plain case");
        let off = (centre.x - 24.3).hypot(centre.y - 23.8);
        assert!(off < 0.05, "{centre:?}");
        let [xx, xy, yy] = centre.covariance_px2;
        assert!(xx > 0.0 && yy > 0.0 && xx * yy > xy * xy && (xx + yy).sqrt() < 0.5, "{centre:?}");
    }
}
