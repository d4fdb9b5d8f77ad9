//! The model of a mark in two lights: a blurred shape of paint on ground, times the light, which falls across a
//! straight blurred border.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::kernels::{self, Form, Model, Samples};
use super::shadow::ramp;

/// Parameters: centre x, y; logarithms of the sides; angle; logarithm of the blur; direction of the light, offset and
/// logarithm of the width of the shadow's border; colours of paint and of ground in the light; the ratio of the lights
/// by band; the slopes of the ground's colour in x and in y.
pub(super) const PARAMETERS: usize = 24;
const SHAPE: usize = 6;
pub(super) const BORDER: usize = 6;
pub(super) const PAINT: usize = 9;
pub(super) const GROUND: usize = 12;
pub(super) const RATIO: usize = 15;
pub(super) const SLOPES: usize = 18;
pub(super) type Vector = SVector<f64, PARAMETERS>;

/// The centre of a mark in two lights, in pixels of the patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Centre {
    pub x: f64,
    pub y: f64,
    pub covariance_px2: [f64; 3],
    /// Share of the squared distance to the centre by even light that stays in doubt.
    pub doubt: f64,
}

pub(super) struct Lights {
    pub(super) form: Form,
    /// Places only.
    pub(super) samples: Samples,
    pub(super) colours: Vec<Vector3<f64>>,
    pub(super) weights: Vec<Matrix3<f64>>,
    /// Where the shape began; the border's offset counts from there.
    pub(super) start: (f64, f64),
    pub(super) side_px: f64,
    pub(super) width_px: f64,
    pub(super) texture: Matrix3<f64>,
}

/// What the model says of a pixel.
pub(super) struct At {
    pub i: usize,
    /// What blurring light and shape together adds to the product of both blurred.
    pub both: f64,
    pub(super) place: [f64; 2],
    /// From where the shape began.
    off: [f64; 2],
    /// Share of paint, with its gradient by the shape.
    pub share: f64,
    by_shape: [f64; SHAPE],
    /// Light from 0 to 1, with its gradient by the border.
    pub light: f64,
    by_border: [f64; 3],
}

impl Lights {
    /// The same model, seen at other places.
    pub fn elsewhere(&self, samples: Samples) -> Lights {
        let Lights { form, start, side_px, width_px, texture, .. } = *self;
        Lights { form, samples, colours: Vec::new(), weights: Vec::new(), start, side_px, width_px, texture }
    }

    /// Calls `act` with what the model says of every pixel.
    pub fn each(&self, p: &Vector, mut act: impl FnMut(At)) {
        let (sin, cos) = p[4].sin_cos();
        let (a, b) = (p[2].exp(), p[3].exp());
        let shape = Model {
            form: self.form,
            x: p[0],
            y: p[1],
            a,
            b: if self.form == Form::Disc { a } else { b },
            sigma: p[5].exp(),
            sin,
            cos,
            height: 1.0,
            plane: [0.0; 3],
            origin: self.start,
        };
        let (turn_sin, turn_cos) = p[BORDER].sin_cos();
        let width = p[BORDER + 2].exp();
        kernels::gradients(&shape, &self.samples, |i, place, left, gradient| {
            let (x, y) = (place[0] - self.start.0, place[1] - self.start.1);
            let t = (x * turn_cos + y * turn_sin - p[BORDER + 1]) / width;
            let light = ramp(t);
            let slope = 1.702 * light * (1.0 - light);
            let by_border = [slope * (y * turn_cos - x * turn_sin) / width, -slope / width, -slope * t];
            let by_shape: [f64; SHAPE] = std::array::from_fn(|k| gradient[k]);
            let along = by_shape[0] * turn_cos + by_shape[1] * turn_sin;
            let both = -(2.0 * p[5]).exp() * along * slope / width;
            act(At { i, both, off: [x, y], place, share: -left, by_shape, light, by_border });
        });
    }

    /// As [`super::fit::add_priors`] takes them.
    pub fn priors(&self, p: &Vector) -> Vec<(f64, [(usize, f64); 2])> {
        const ASPECT: f64 = 0.1;
        const BLUR: f64 = 0.4;
        const SIZE: f64 = 0.5;
        const WIDTH: f64 = 0.5;
        const OF_RATIO: f64 = 0.15;
        /// Levels a pixel.
        const SLOPE: f64 = 1.0;
        let mut priors = vec![
            ((p[2] - p[3]) / ASPECT, [(2, 1.0 / ASPECT), (3, -1.0 / ASPECT)]),
            (((p[2] + p[3]) / 2.0 - self.side_px.ln()) / SIZE, [(2, 0.5 / SIZE), (3, 0.5 / SIZE)]),
            (0.0, [(4, 0.1), (4, 0.0)]),
            ((p[5] - 1.2f64.ln()) / BLUR, [(5, 1.0 / BLUR), (5, 0.0)]),
            ((p[BORDER + 2] - self.width_px.ln()) / WIDTH, [(BORDER + 2, 1.0 / WIDTH), (BORDER + 2, 0.0)]),
        ];
        let mean = (p[RATIO] + p[RATIO + 1] + p[RATIO + 2]) / 3.0;
        for c in 0..3 {
            priors.push(((p[RATIO + c] - mean) / OF_RATIO, [(RATIO + c, 1.0 / OF_RATIO), (RATIO + c, 0.0)]));
            for k in [SLOPES + c, SLOPES + 3 + c] {
                priors.push((p[k] / SLOPE, [(k, 1.0 / SLOPE), (k, 0.0)]));
            }
        }
        priors
    }

    /// The derivatives of a pixel's colour, a row a band.
    pub fn jacobian(p: &Vector, at: &At) -> SMatrix<f64, 3, PARAMETERS> {
        let mut j = SMatrix::<f64, 3, PARAMETERS>::zeros();
        for c in 0..3 {
            let (ground, light, dark) = (ground_at(p, c, at), light(p, c, at.light), 1.0 - p[RATIO + c]);
            let step = p[PAINT + c] - ground;
            let base = ground + at.share * step;
            (0..SHAPE).for_each(|k| j[(c, k)] = light * step * at.by_shape[k]);
            (0..3).for_each(|k| j[(c, BORDER + k)] = base * dark * at.by_border[k]);
            let by_step = at.share * light + dark * at.both;
            j[(c, PAINT + c)] = by_step;
            let by_ground = light - by_step;
            j[(c, GROUND + c)] = by_ground;
            j[(c, SLOPES + c)] = by_ground * at.off[0];
            j[(c, SLOPES + 3 + c)] = by_ground * at.off[1];
            j[(c, RATIO + c)] = base * (1.0 - at.light) - step * at.both;
        }
        j
    }
}

/// Light on a band, 1 beside the shadow.
pub(super) fn light(p: &Vector, c: usize, light: f64) -> f64 {
    p[RATIO + c] + (1.0 - p[RATIO + c]) * light
}

/// A band of the ground's colour at a pixel, in the light.
pub(super) fn ground_at(p: &Vector, c: usize, at: &At) -> f64 {
    p[GROUND + c] + at.off[0] * p[SLOPES + c] + at.off[1] * p[SLOPES + 3 + c]
}

pub(super) fn model(p: &Vector, at: &At) -> Vector3<f64> {
    Vector3::from_fn(|c, _| {
        let ground = ground_at(p, c, at);
        let step = p[PAINT + c] - ground;
        (ground + at.share * step) * light(p, c, at.light) + step * (1.0 - p[RATIO + c]) * at.both
    })
}

#[cfg(test)]
mod tests {
    use super::super::kernels::Sample;
    use super::*;

    #[test]
    fn the_derivatives_are_those_of_the_model() {
        let samples: Samples =
            (0..400).map(|i| Sample { x: f64::from(i % 20) + 0.5, y: f64::from(i / 20) + 0.5, share: 0.0 }).collect();
        let lights = Lights {
            form: Form::Rectangle,
            samples,
            colours: Vec::new(),
            weights: Vec::new(),
            start: (10.0, 10.0),
            side_px: 8.0,
            width_px: 1.0,
            texture: Matrix3::identity(),
        };
        let p = Vector::from_column_slice(&[
            10.2, 9.7, 2.1, 2.0, 0.3, 0.0, 0.5, 1.0, 0.1, 250.0, 100.0, 20.0, 120.0, 110.0, 90.0, 0.4, 0.42, 0.5, 0.3,
            -0.2, 0.1, 0.4, 0.2, -0.1,
        ]);
        let values = |p: &Vector| {
            let mut all = Vec::new();
            lights.each(p, |at| all.push(model(p, &at)));
            all
        };
        let mut derivatives = Vec::new();
        lights.each(&p, |at| derivatives.push(Lights::jacobian(&p, &at)));
        // What is held fixed in the derivatives by shape and border, the blur of both together, is small.
        for k in 0..PARAMETERS {
            let step = Vector::from_fn(|i, _| if i == k { 1e-4 } else { 0.0 });
            let (after, before) = (values(&(p + step)), values(&(p - step)));
            let (mut off, mut all) = (0.0, 0.0);
            for ((after, before), derivative) in after.iter().zip(&before).zip(&derivatives) {
                let slope = (after - before) / 2e-4;
                off += (slope - derivative.column(k)).norm_squared();
                all += slope.norm_squared();
            }
            let most = if k < PAINT { 0.05 } else { 1e-9 };
            assert!(off < most * all, "{k}: {off} of {all}");
        }
    }
}
