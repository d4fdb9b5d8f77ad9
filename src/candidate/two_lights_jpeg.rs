//! A mark in two lights, fitted to the coefficients of a JPEG.
//!
//! Chroma at half resolution blurs the paint's edges more than those of the light, which luma shows as well: a fit to
//! pixels with one blur ([`super::two_lights`]) trades one for the other. Here the same model goes through what the
//! JPEG did, as that of a mark in one light does ([`super::jpeg_fit`]).

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::descent::Trust;
use super::fit::{Fit, add_priors};
use super::jpeg_fit::dot;
use super::jpeg_noise::{Noise, class, texture};
use super::jpeg_planes::{Channels, Planes, block, half, planes, seen_blocks};
use super::jpeg_steps::{CELLS, Cells, Cosines, TO_YCC, Tables};
use super::kernels::{Sample, Samples};
use super::lights::{Centre, Lights, PAINT, PARAMETERS, Vector, light, model};
use super::scene::{Ground, Scene};
use crate::segment::classify::Classifier;

/// Steps of least squares.
const ROUNDS: usize = 5;
type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// A block in coefficients, seen in one channel.
struct Block {
    channel: usize,
    /// The gradient by each parameter.
    parts: Vec<Cells>,
    left: Cells,
    /// How much of the texture of ground in the light each pixel shows, and the mean square of that.
    shown: Cells,
    open: f64,
}

struct Problem<'a> {
    lights: Lights,
    planes: &'a Planes,
    channels: &'a Channels,
    cosines: &'a Cosines,
    classes: [usize; CELLS],
}

/// The model over one plane: gradients, values, what is seen of the ground.
struct Plane {
    parts: Vec<Vec<f64>>,
    value: Vec<f64>,
}

impl Plane {
    fn half(&self, planes: &Planes) -> Plane {
        let half = |plane: &Vec<f64>| half(plane, planes.width, planes.height);
        Plane { parts: self.parts.iter().map(half).collect(), value: half(&self.value) }
    }
}

impl Problem<'_> {
    fn blocks(&self, p: &Vector) -> Vec<Block> {
        let planes = self.planes;
        let count = planes.width * planes.height;
        let plane = || Plane { parts: vec![vec![0.0; count]; PARAMETERS], value: vec![0.0; count] };
        let mut all = [plane(), plane(), plane()];
        let mut shown = vec![0.0; count];
        // From bands to channels, a row a channel.
        let columns = [Vector3::x(), Vector3::y(), Vector3::z()].map(|band| self.channels.of(TO_YCC * band).into());
        let to_channels = Matrix3::from_columns(&columns);
        self.lights.each(p, |at| {
            let value = to_channels * model(p, &at);
            let gradient = to_channels * Lights::jacobian(p, &at);
            for (c, plane) in all.iter_mut().enumerate() {
                plane.value[at.i] = value[c];
                (0..PARAMETERS).for_each(|k| plane.parts[k][at.i] = gradient[(c, k)]);
            }
            shown[at.i] = (0..3).map(|c| light(p, c, at.light)).sum::<f64>() / 3.0 * (1.0 - at.share);
        });
        let [luma, blue, red] = all;
        let (blue, red) = (blue.half(planes), red.half(planes));
        let half_shown = half(&shown, planes.width, planes.height);
        let mut blocks = Vec::new();
        let full = (&planes.seen[..], &shown[..], planes.width);
        let coarse = (&planes.half_seen[..], &half_shown[..], planes.width / 2);
        self.add_blocks(&mut blocks, (0, &luma, &planes.luma), full);
        self.add_blocks(&mut blocks, (1, &blue, &planes.chroma[0]), coarse);
        self.add_blocks(&mut blocks, (2, &red, &planes.chroma[1]), coarse);
        blocks
    }

    /// Transforms the blocks of one channel.
    fn add_blocks(
        &self,
        out: &mut Vec<Block>,
        (channel, plane, data): (usize, &Plane, &[f64]),
        (seen, shown, width): (&[bool], &[f64], usize),
    ) {
        /// Ground that is covered shows a little still.
        const WORN: f64 = 0.02;
        for (b, mask) in seen_blocks(seen, width) {
            let masked = |plane: &[f64]| {
                let mut cells = block(plane, width, b);
                cells.iter_mut().zip(&mask).for_each(|(c, m)| *c *= m);
                cells
            };
            let parts = plane.parts.iter().map(|part| self.cosines.transform(&masked(part))).collect();
            let (data, value) = (masked(data), masked(&plane.value));
            let left = self.cosines.transform(&std::array::from_fn(|i| data[i] - value[i]));
            let shown = masked(shown);
            let open = shown.iter().map(|s| s * s).sum::<f64>() / CELLS as f64;
            out.push(Block { channel, parts, left, shown, open: open.max(WORN) });
        }
    }

    /// One step of least squares and, after the last, the covariance (xx, xy, yy) of the centre.
    fn step(&self, p: &Vector, round: usize) -> Option<(Vector, [f64; 3])> {
        let blocks = self.blocks(p);
        let texture = texture(blocks.iter().map(|b| (b.channel, &b.left, b.open)), self.channels, &self.classes);
        let noise = Noise { channels: self.channels, classes: &self.classes, texture: &texture };
        let trust = if round > 0 { Trust::Robust } else { Trust::Even };
        let (mut h, mut g) = (Matrix::zeros(), Vector::zeros());
        let weights: Vec<Cells> = blocks.iter().map(|b| noise.weights(b.channel, &b.left, b.open, trust)).collect();
        for (block, weights) in blocks.iter().zip(&weights) {
            for (a, part) in block.parts.iter().enumerate() {
                let weighted: Cells = std::array::from_fn(|k| weights[k] * part[k]);
                g[a] += dot(&weighted, &block.left);
                for (b, other) in block.parts.iter().enumerate().skip(a) {
                    h[(a, b)] += dot(&weighted, other);
                }
            }
        }
        h.fill_lower_triangle_with_upper_triangle();
        add_priors(self.lights.priors(p), &mut h, &mut g, &mut 0.0);
        let factor = h.cholesky()?;
        let step = factor.solve(&g);
        let mut covariance = [0.0; 3];
        if round + 1 == ROUNDS {
            let inverse = factor.inverse();
            for (block, weights) in blocks.iter().zip(&weights) {
                let influence = [0, 1].map(|axis| {
                    std::array::from_fn(|k| {
                        block.parts.iter().enumerate().map(|(a, part)| inverse[(axis, a)] * part[k]).sum()
                    })
                });
                noise.add_variance(&mut covariance, influence, (block.channel, weights, &block.shown), self.cosines);
            }
        }
        Some((step, covariance))
    }
}

/// Fits again to the coefficients, from the parameters `p` of a fit to pixels. `ground` is that of even light. `None`
/// when the patch shows no steps of a JPEG or nothing came of it.
pub(super) fn refine(
    scene: &Scene<'_>,
    classifier: &Classifier,
    fit: &Fit,
    (p, lights): (&Vector, &Lights),
    ground: &Ground,
) -> Option<Centre> {
    /// No JPEG moves a centre further.
    const MOST_PX: f64 = 1.0;
    /// Pixels see the blur of the interpolated chroma too.
    const MOST_BLUR_PX: f64 = 1.3;
    let cosines = Cosines::new();
    let tables = Tables::shown_by(scene.patch, &cosines)?;
    let is_paint = classifier.paint_of(&scene.patch.rgb, &scene.patch.valid);
    let (mut planes, (x, y)) = planes(scene, scene.patch, &is_paint, fit)?;
    let channels = Channels::new(ground, &tables);
    channels.apply(&mut planes);
    let window = &scene.patch.window;
    let (x, y) = ((x - window.x as i64) as f64 + 0.5, (y - window.y as i64) as f64 + 0.5);
    let samples: Samples = (0..planes.width * planes.height)
        .map(|i| Sample { x: x + (i % planes.width) as f64, y: y + (i / planes.width) as f64, share: 0.0 })
        .collect();
    let problem = Problem {
        lights: lights.elsewhere(samples),
        planes: &planes,
        channels: &channels,
        cosines: &cosines,
        classes: std::array::from_fn(class),
    };
    let mut here = *p;
    here[5] = here[5].min(MOST_BLUR_PX.ln());
    let mut covariance_px2 = [0.0; 3];
    for round in 0..ROUNDS {
        let step;
        (step, covariance_px2) = problem.step(&here, round)?;
        for (k, step) in step.iter().enumerate() {
            here[k] += if k < PAINT { step.clamp(-0.5, 0.5) } else { *step };
        }
    }
    // Also false of what is no number.
    let near = (here[0] - p[0]).hypot(here[1] - p[1]) < MOST_PX;
    /// Variance that the model's own errors add, and the share of the squared distance to the centre by even light that
    /// stays in doubt: measured on drawn marks.
    const UNSEEN: f64 = 1.2;
    const DOUBT: f64 = 0.1;
    let covariance_px2 = covariance_px2.map(|v| UNSEEN * v);
    let sane = here.iter().chain(&covariance_px2).all(|v| v.is_finite());
    (near && sane).then_some(Centre { x: here[0], y: here[1], covariance_px2, doubt: DOUBT })
}
