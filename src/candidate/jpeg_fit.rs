//! Centres in pictures that went through a JPEG, weighed as the JPEG left them.
//!
//! A JPEG rounds the cosine coefficients of 8 × 8 blocks, luma at full and chroma mostly at half resolution, each in
//! steps of its own (ITU-T T.81, 1992). Seen pixel by pixel that is noise correlated over whole blocks, before which a
//! fit of pixels gets half of what the picture holds. Where the steps show in the patch ([`super::jpeg_steps`]), the
//! shape that was fitted to pixels is fitted again to the coefficients: each weighs as much as its step (rounding has
//! the variance q²/12: B. Widrow and I. Kollar, "Quantization noise", 2008) and the texture of the ground at that
//! frequency let it. A picture that was resampled after its JPEG shows no steps on the grid and keeps the fit to
//! pixels.

use nalgebra::{SMatrix, SVector, Vector3};

use super::descent::Trust;
use super::fit::{Fit, add_priors};
use super::jpeg_noise::{Noise, class, texture};
use super::jpeg_planes::{Channels, Planes, block, half, planes, seen_blocks};
use super::jpeg_steps::{CELLS, Cells, Cosines, N, TO_YCC, Tables};
use super::kernels::{self, Form, Model};
use super::scene::{Ground, Scene};
use crate::segment::classify::Classifier;
use autoref_raster::Patch;

/// Centre x, y; logarithms of the sides; angle; logarithm of the blur.
const SHAPE: usize = 6;
/// Of a channel: paint; ground; its slopes in x and y.
const COLOUR: usize = 4;
const PARAMETERS: usize = SHAPE + 3 * COLOUR;
/// Steps of least squares.
const ROUNDS: usize = 3;
/// What the picture of a block is made of: gradients of the shape, the shape, open ground, that times x, times y.
const PARTS: usize = SHAPE + COLOUR;
type Vector = SVector<f64, PARAMETERS>;
type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// A fit to the coefficients of a JPEG.
#[derive(Clone, Debug)]
pub struct Refined {
    /// Centre in the patch that the first look saw.
    pub x: f64,
    pub y: f64,
    pub sides_px: [f64; 2],
    pub angle_rad: f64,
    pub blur_px: f64,
    /// xx, xy, yy of the centre.
    pub covariance_px2: [f64; 3],
    /// The quality, as libjpeg counts, whose steps the patch shows.
    pub quality: u32,
}

#[derive(Clone)]
struct State {
    shape: [f64; SHAPE],
    /// Of each channel.
    colour: [[f64; COLOUR]; 3],
}

impl State {
    fn model(&self, form: Form) -> Model {
        let [x, y, a, b, angle, sigma] = self.shape;
        let (sin, cos) = angle.sin_cos();
        let (a, b, sigma) = (a.exp(), b.exp(), sigma.exp());
        Model { form, x, y, a, b, sigma, sin, cos, height: 1.0, plane: [0.0; 3], origin: (0.0, 0.0) }
    }
}

/// The shape over the planes: gradients, then values.
struct Basis {
    parts: [Vec<f64>; SHAPE + 1],
}

impl Basis {
    fn of(planes: &Planes, model: &Model) -> Basis {
        let (width, height) = (planes.width, planes.height);
        let mut parts: [Vec<f64>; SHAPE + 1] = std::array::from_fn(|_| vec![0.0; width * height]);
        for i in 0..width * height {
            let (value, by) = kernels::shape(model, (i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            for (part, g) in parts.iter_mut().zip(by) {
                part[i] = g;
            }
            parts[SHAPE][i] = value;
        }
        Basis { parts }
    }

    fn half(&self, planes: &Planes) -> Basis {
        Basis { parts: std::array::from_fn(|k| half(&self.parts[k], planes.width, planes.height)) }
    }
}

/// A block in coefficients, seen in one channel.
struct Seen<'a> {
    channel: usize,
    parts: &'a [Cells; PARTS],
    /// The parts that are not nothing all over the block.
    some: std::ops::Range<usize>,
    left: Cells,
    /// How much of the ground's texture each pixel shows, and the mean square of that.
    shown: &'a Cells,
    open: f64,
}

struct Block {
    parts: [Cells; PARTS],
    some: std::ops::Range<usize>,
    left: Vec<(usize, Cells)>,
    shown: Cells,
    open: f64,
}

/// Transforms the blocks of one resolution: `pixel` is that of its cells, `data` the channels.
fn add_blocks(
    out: &mut Vec<Block>,
    (basis, seen, width, pixel): (&Basis, &[bool], usize, f64),
    data: &[(usize, &[f64])],
    state: &State,
    cosines: &Cosines,
) {
    /// Paint is worn, most up to a fifth: so much of the ground's texture shows on it.
    const WORN: f64 = 0.02;
    for (b, mask) in seen_blocks(seen, width) {
        let values = block(&basis.parts[SHAPE], width, b);
        let (least, most) = values.iter().fold((1.0f64, 0.0f64), |m, &v| (m.0.min(v), m.1.max(v)));
        let some = if most < 1e-3 {
            SHAPE + 1..PARTS
        } else if least > 0.999 {
            SHAPE..SHAPE + 1
        } else {
            0..PARTS
        };
        let (bx, by) = (b % (width / N) * N, b / (width / N) * N);
        let x: Cells = std::array::from_fn(|i| ((bx + i % N) as f64 + 0.5) * pixel - state.shape[0]);
        let y: Cells = std::array::from_fn(|i| ((by + i / N) as f64 + 0.5) * pixel - state.shape[1]);
        let mut parts = [[0.0; CELLS]; PARTS];
        for k in some.clone() {
            let mut cells: Cells = match k {
                0..=SHAPE => block(&basis.parts[k], width, b),
                7 => values.map(|v| 1.0 - v),
                8 => std::array::from_fn(|i| (1.0 - values[i]) * x[i]),
                _ => std::array::from_fn(|i| (1.0 - values[i]) * y[i]),
            };
            cells.iter_mut().zip(&mask).for_each(|(c, m)| *c *= m);
            parts[k] = cosines.transform(&cells);
        }
        let left = data.iter().map(|&(channel, data)| {
            let [paint, ground, gx, gy] = state.colour[channel];
            let data = block(data, width, b);
            let cells: Cells = std::array::from_fn(|i| {
                let plane = ground + gx * x[i] + gy * y[i];
                mask[i] * (data[i] - paint * values[i] - plane * (1.0 - values[i]))
            });
            (channel, cosines.transform(&cells))
        });
        let open = values.iter().map(|v| (1.0 - v) * (1.0 - v)).sum::<f64>() / CELLS as f64;
        let worn = WORN.sqrt();
        let shown = std::array::from_fn(|i| mask[i] * (1.0 - values[i] + worn * values[i]));
        out.push(Block { parts, some, left: left.collect(), shown, open: open.max(WORN) });
    }
}

pub(super) fn dot(a: &Cells, b: &Cells) -> f64 {
    let mut sums = [0.0; N];
    for (a, b) in a.chunks_exact(N).zip(b.chunks_exact(N)) {
        for i in 0..N {
            sums[i] += a[i] * b[i];
        }
    }
    sums.iter().sum()
}

/// Parameter that a part belongs to, and the factor from part to gradient.
fn parameter(part: usize, channel: usize, state: &State) -> (usize, f64) {
    let [paint, ground, ..] = state.colour[channel];
    if part < SHAPE { (part, paint - ground) } else { (part + COLOUR * channel, 1.0) }
}

/// Adds a block to the normal equations.
fn add_equations(seen: &Seen<'_>, state: &State, weights: &Cells, h: &mut Matrix, g: &mut Vector) {
    let by = |p: usize| parameter(p, seen.channel, state);
    for p in seen.some.clone() {
        let (row, scale) = by(p);
        let weighted: Cells = std::array::from_fn(|k| weights[k] * scale * seen.parts[p][k]);
        g[row] += dot(&weighted, &seen.left);
        for s in p..seen.some.end {
            let (column, scale) = by(s);
            h[(row, column)] += scale * dot(&weighted, &seen.parts[s]);
        }
    }
}

struct Problem<'a> {
    form: Form,
    planes: &'a Planes,
    channels: &'a Channels,
    cosines: &'a Cosines,
    classes: [usize; CELLS],
}

impl Problem<'_> {
    fn blocks(&self, state: &State) -> Vec<Block> {
        let planes = self.planes;
        let full = Basis::of(planes, &state.model(self.form));
        let mut blocks = Vec::new();
        add_blocks(&mut blocks, (&full, &planes.seen, planes.width, 1.0), &[(0, &planes.luma)], state, self.cosines);
        let coarse = (&full.half(planes), &planes.half_seen[..], planes.width / 2, 2.0);
        let chroma = [(1, &planes.chroma[0][..]), (2, &planes.chroma[1][..])];
        add_blocks(&mut blocks, coarse, &chroma, state, self.cosines);
        blocks
    }

    /// One step of least squares and, after the last, the covariance (xx, xy, yy) of the centre; from the second on
    /// weight is taken from what lies far off.
    fn step(&self, state: &State, round: usize) -> Option<(Vector, [f64; 3])> {
        let blocks = self.blocks(state);
        let seen: Vec<Seen<'_>> = blocks
            .iter()
            .flat_map(|b| {
                let one = move |&(channel, left): &(usize, Cells)| Seen {
                    channel,
                    parts: &b.parts,
                    some: b.some.clone(),
                    left,
                    shown: &b.shown,
                    open: b.open,
                };
                b.left.iter().map(one)
            })
            .collect();
        let texture = texture(seen.iter().map(|b| (b.channel, &b.left, b.open)), self.channels, &self.classes);
        let trust = if round > 0 { Trust::Robust } else { Trust::Even };
        let noise = Noise { channels: self.channels, classes: &self.classes, texture: &texture };
        let weights: Vec<Cells> = seen.iter().map(|b| noise.weights(b.channel, &b.left, b.open, trust)).collect();
        let (mut h, mut g) = (Matrix::zeros(), Vector::zeros());
        for (block, weights) in seen.iter().zip(&weights) {
            add_equations(block, state, weights, &mut h, &mut g);
        }
        h.fill_lower_triangle_with_upper_triangle();
        self.add_priors(state, &mut h, &mut g);
        let factor = h.cholesky()?;
        let covariance = if round + 1 == ROUNDS {
            self.covariance(state, &seen, &weights, &noise, &factor.inverse())
        } else {
            [0.0; 3]
        };
        Some((factor.solve(&g), covariance))
    }

    /// Covariance of the centre: what rounding and texture add to the very sums that it is made of.
    ///
    /// The inverse of the normal equations would be it if the texture of each coefficient were independent of the
    /// others'. Where a mark cuts through a block it is not: texture that is long against the block, cut off at the
    /// border, shows in all coefficients at once, most of all in those that tell where the border is. So the influence
    /// of each coefficient on the centre (F. R. Hampel, "The influence curve and its role in robust estimation",
    /// Journal of the American Statistical Association 69, 1974) is taken back to pixels, weakened there by how much of
    /// the ground each shows, and met with the ground's spectrum.
    fn covariance(
        &self,
        state: &State,
        seen: &[Seen<'_>],
        weights: &[Cells],
        noise: &Noise<'_>,
        inverse: &Matrix,
    ) -> [f64; 3] {
        let mut prior = Matrix::zeros();
        self.add_priors(state, &mut prior, &mut Vector::zeros());
        let rows = inverse.fixed_rows::<2>(0);
        let by_prior = rows * prior * rows.transpose();
        let mut out = [by_prior[(0, 0)], by_prior[(0, 1)], by_prior[(1, 1)]];
        for (block, weights) in seen.iter().zip(weights) {
            let mut influence = [[0.0; CELLS]; 2];
            for p in block.some.clone() {
                let (row, scale) = parameter(p, block.channel, state);
                for (axis, influence) in influence.iter_mut().enumerate() {
                    let factor = inverse[(axis, row)] * scale;
                    influence.iter_mut().zip(&block.parts[p]).for_each(|(i, part)| *i += factor * part);
                }
            }
            noise.add_variance(&mut out, influence, (block.channel, weights, block.shown), self.cosines);
        }
        out
    }

    fn add_priors(&self, state: &State, h: &mut Matrix, g: &mut Vector) {
        const ASPECT_SD: f64 = 0.1;
        /// Of the logarithm of the blur about a pixel.
        const BLUR_SD: f64 = 0.4;
        /// Levels a pixel.
        const SLOPE_SD: f64 = 1.0;
        let s = &state.shape;
        let pull = |at: usize, value: f64, sd: f64| (value / sd, [(at, 1.0 / sd), (at, 0.0)]);
        let mut priors = vec![
            ((s[2] - s[3]) / ASPECT_SD, [(2, 1.0 / ASPECT_SD), (3, -1.0 / ASPECT_SD)]),
            pull(5, s[5], BLUR_SD),
            // Weak ones keep the equations regular: a blob's angle and a disc's second side are free.
            pull(4, 0.0, 10.0),
            pull(3, 0.0, 100.0),
        ];
        for (c, colour) in state.colour.iter().enumerate() {
            let first = SHAPE + COLOUR * c;
            priors.extend([pull(first, 0.0, 1000.0), pull(first + 1, 0.0, 1000.0)]);
            priors.extend([2, 3].map(|k| pull(first + k, colour[k], SLOPE_SD)));
        }
        add_priors(priors, h, g, &mut 0.0);
    }
}

/// Fits again to the coefficients, from a fit to pixels; `around` is a patch that holds the scene's and more. `None`
/// when it shows no steps of a JPEG or nothing came of it.
pub(super) fn refine(
    scene: &Scene<'_>,
    around: &Patch,
    classifier: &Classifier,
    fit: &Fit,
    (paint, ground): (Vector3<f64>, &Ground),
) -> Option<Refined> {
    /// No JPEG moves a centre further.
    const MOST_PX: f64 = 0.6;
    let cosines = Cosines::new();
    let tables = Tables::shown_by(around, &cosines)?;
    let is_paint = classifier.paint_of(&around.rgb, &around.valid);
    let (mut planes, (x, y)) = planes(scene, around, &is_paint, fit)?;
    let channels = Channels::new(ground, &tables);
    channels.apply(&mut planes);
    let problem = Problem {
        form: fit.form,
        planes: &planes,
        channels: &channels,
        cosines: &cosines,
        classes: std::array::from_fn(class),
    };
    let window = &scene.patch.window;
    let (x, y) = ((x - window.x as i64) as f64, (y - window.y as i64) as f64);
    let [a, b] = fit.sides_px;
    let (paint, bare) = (channels.of(TO_YCC * paint), channels.of(TO_YCC * ground.mean));
    let mut state = State {
        // Pixels see the blur of the interpolated chroma too.
        shape: [fit.x - x, fit.y - y, a.ln(), b.ln(), fit.angle_rad, fit.blur_px.min(1.3).ln()],
        colour: std::array::from_fn(|c| [paint[c], bare[c], 0.0, 0.0]),
    };
    let mut covariance_px2 = [0.0; 3];
    for round in 0..ROUNDS {
        let step;
        (step, covariance_px2) = problem.step(&state, round)?;
        for (p, value) in state.shape.iter_mut().enumerate() {
            *value += step[p].clamp(-0.5, 0.5);
        }
        for (p, value) in state.colour.as_flattened_mut().iter_mut().enumerate() {
            *value += step[SHAPE + p];
        }
    }
    let [cx, cy, a, b, angle_rad, blur] = state.shape;
    let (x, y) = (cx + x, cy + y);
    // Also false of what is no number.
    let near = (x - fit.x).hypot(y - fit.y) < MOST_PX;
    near.then(|| Refined {
        x,
        y,
        sides_px: if fit.form == Form::Disc { [a.exp(); 2] } else { [a.exp(), b.exp()] },
        angle_rad,
        blur_px: blur.exp(),
        covariance_px2,
        quality: tables.quality,
    })
}
