//! The sums of one round of least squares. Most pixels lie on the opaque frame, where the mark says 0 and moving it
//! changes nothing: of these only the grey value is kept.
//!
//! Single precision carries grey values and sums of a thousand pixels; what is solved is summed in double precision.

mod sectors;

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::spread::Magnitudes;
use super::surface::{Say, Surface, Under};
use crate::window::Grey;

/// Pixels taken together, and how many such groups are summed in single precision.
const LANES: usize = 8;
const GROUPS: usize = 128;

/// A pixel does not fit when it is off by this share of the mark's contrast and by so many standard deviations.
const FIT: f32 = 0.3;
const FIT_SIGMA: f32 = 4.0;
/// Values of the drawn mark above which a pixel is the mark's, and below which it is not.
const ON_MARK: f32 = 0.4;
const BESIDE_MARK: f32 = 0.1;

/// Pixels where the mark is not 0.
#[derive(Default)]
struct Shaped {
    grey: Vec<f32>,
    /// The mark's value and how it changes per pixel right and down.
    mark: [Vec<f32>; 3],
    /// From the centre, pixels right and down.
    from: [Vec<f32>; 2],
    residuals: Vec<f32>,
}

impl Shaped {
    fn clear(&mut self) {
        self.grey.clear();
        self.mark.iter_mut().chain(&mut self.from).for_each(Vec::clear);
    }

    /// Takes the pixels `span` of a row; `from` is where its first lies.
    #[inline(always)]
    fn extend(&mut self, under: &Under, values: &[f32], span: Range<usize>, from: [f64; 2]) {
        let (start, end) = (self.grey.len(), self.grey.len() + span.len());
        let [right, down] = &mut self.from;
        right.resize(end, 0.0);
        down.resize(end, from[1] as f32);
        let [value, by_x, by_y] = &mut self.mark;
        value.resize(end, 0.0);
        by_x.resize(end, 0.0);
        by_y.resize(end, 0.0);
        under.marks(span.clone(), [&mut value[start..], &mut by_x[start..], &mut by_y[start..]]);
        let first = (from[0] + span.start as f64) as f32;
        self.grey.extend_from_slice(&values[span]);
        for (k, right) in right[start..].iter_mut().enumerate() {
            *right = first + k as f32;
        }
    }

    /// The `L` pixels from `k` on.
    #[inline(always)]
    fn part<const L: usize>(&self, k: usize) -> Part<L> {
        let ([value, by_x, by_y], [right, down]) = (&self.mark, &self.from);
        Part {
            grey: first(&self.grey[k..]),
            mark: [first(&value[k..]), first(&by_x[k..]), first(&by_y[k..])],
            from: [first(&right[k..]), first(&down[k..])],
        }
    }
}

#[inline(always)]
fn first<const L: usize>(values: &[f32]) -> [f32; L] {
    *values.first_chunk().expect("asked for within the pixels")
}

/// `L` pixels side by side.
struct Part<const L: usize> {
    grey: [f32; L],
    mark: [[f32; L]; 3],
    from: [[f32; L]; 2],
}

impl<const L: usize> Part<L> {
    /// How the grey value changes with the levels of frame and mark, and with the mark's slopes.
    #[inline(always)]
    fn by_levels(&self) -> [[f32; L]; 4] {
        let mut by = [[1.0; L], self.mark[0], self.mark[0], self.mark[0]];
        for d in 0..2 {
            for i in 0..L {
                by[2 + d][i] *= self.from[d][i];
            }
        }
        by
    }

    /// Brightness of the mark above the opaque frame, with `M` levels.
    #[inline(always)]
    fn gain<const M: usize>(&self, levels: &[f32; 4]) -> [f32; L] {
        let mut gain = [levels[1]; L];
        if M > 2 {
            for i in 0..L {
                gain[i] += levels[2] * self.from[0][i] + levels[3] * self.from[1][i];
            }
        }
        gain
    }

    /// Squares of how much the grey value changes per pixel.
    #[inline(always)]
    fn changes(&self, mut gain: [f32; L]) -> [f32; L] {
        for i in 0..L {
            let (x, y) = (self.mark[1][i], self.mark[2][i]);
            gain[i] = gain[i] * gain[i] * (x * x + y * y);
        }
        gain
    }

    #[inline(always)]
    fn residuals<const M: usize>(&self, levels: &[f32; 4]) -> [f32; L] {
        let mut residuals = self.gain::<M>(levels);
        for i in 0..L {
            residuals[i] = self.grey[i] - (levels[0] + self.mark[0][i] * residuals[i]);
        }
        residuals
    }
}

/// Normal equations (upper half) and right side for `N` unknowns.
struct Sums<const N: usize> {
    normal: [[[f32; LANES]; N]; N],
    right: [[f32; LANES]; N],
}

impl<const N: usize> Sums<N> {
    const ZERO: Self = Sums { normal: [[[0.0; LANES]; N]; N], right: [[0.0; LANES]; N] };

    /// Adds `L` pixels, at most [`LANES`].
    #[inline(always)]
    fn add<const L: usize>(&mut self, weights: [f32; L], row: [[f32; L]; N], values: [f32; L]) {
        for a in 0..N {
            let mut weighted = weights;
            for i in 0..L {
                weighted[i] *= row[a][i];
                self.right[a][i] += weighted[i] * values[i];
            }
            for b in a..N {
                for i in 0..L {
                    self.normal[a][b][i] += weighted[i] * row[b][i];
                }
            }
        }
    }
}

/// The sums of all pixels.
struct Equations<const N: usize> {
    normal: [[f64; N]; N],
    right: [f64; N],
}

impl<const N: usize> Equations<N> {
    const ZERO: Self = Equations { normal: [[0.0; N]; N], right: [0.0; N] };

    fn add(&mut self, sums: &Sums<N>) {
        let total = |lanes: &[f32; LANES]| lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
        for a in 0..N {
            self.right[a] += total(&sums.right[a]);
            for b in a..N {
                self.normal[a][b] += total(&sums.normal[a][b]);
            }
        }
    }

    /// The inverse of the normal equations and the solution.
    fn solved(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let inverse = DMatrix::from_fn(N, N, |a, b| self.normal[a.min(b)][a.max(b)]).try_inverse()?;
        let solution = &inverse * DVector::from_column_slice(&self.right);
        Some((inverse, solution))
    }
}

/// The least squares of one mark with `N` unknowns, kept from round to round. `M` of them are levels: of the opaque
/// frame, of the mark above it, and with slopes how that changes across.
pub(super) struct Fit<const N: usize, const M: usize> {
    opaque: Vec<f32>,
    shaped: Shaped,
    /// The slopes stay 0 where they are no unknowns.
    levels: [f32; 4],
    /// Robust standard deviation of a pixel in the last round; 0 before the first.
    sigma: f32,
    /// Of the mark's contrast, how far a pixel is off since the mark is not exactly as drawn.
    unlike: f32,
    magnitudes: Magnitudes,
}

impl<const N: usize, const M: usize> Fit<N, M> {
    /// Without pixels; `unlike` is how far the mark is from its drawing, of its contrast.
    pub fn new(unlike: f32) -> Self {
        let (opaque, shaped, magnitudes) = (vec![], Shaped::default(), Magnitudes::default());
        Fit { opaque, shaped, levels: [0.0; 4], sigma: 0.0, unlike, magnitudes }
    }

    /// How many pixels it holds.
    pub fn pixels(&self) -> usize {
        self.opaque.len() + self.shaped.grey.len()
    }

    /// Brightness of the mark above the opaque frame, of white.
    pub fn contrast(&self) -> f64 {
        f64::from(self.levels[1])
    }

    /// Robust standard deviation of a pixel in the last round, of white.
    pub fn sigma(&self) -> f64 {
        f64::from(self.sigma)
    }

    /// The pixels around `c` that the mark says something about, one in `sparse`: a lattice that no line of the mark
    /// slips through.
    #[inline(always)]
    pub fn gather(&mut self, grey: &Grey, surface: &Surface, c: [f64; 2], sparse: usize) {
        let range = |axis: usize, n: usize| {
            let [before, behind] = surface.reach_px(axis);
            (((c[axis] - before).floor().max(0.0)) as usize, ((c[axis] + behind).ceil().clamp(0.0, n as f64)) as usize)
        };
        let ((x0, x1), (y0, y1)) = (range(0, grey.width), range(1, grey.height));
        let (across, down) = (surface.phase(0, x0, c[0]), surface.phase(1, y0, c[1]));
        self.opaque.clear();
        self.shaped.clear();
        for y in y0..y1 {
            let Some((before, under)) = surface.under(across, down, y - y0, x1.saturating_sub(x0)) else { continue };
            let first = x0 + before;
            let values = &grey.data[y * grey.width + first..][..under.count];
            let from = [first as f64 + 0.5 - c[0], y as f64 + 0.5 - c[1]];
            // Where the row begins in the lattice.
            let at = first + 2 * y;
            for k in 0..under.runs() {
                let (say, span) = under.run(k);
                match say {
                    Say::Nothing => {}
                    Say::Opaque if sparse == 1 => self.opaque.extend_from_slice(&values[span]),
                    Say::Opaque => {
                        let mut k = span.start + before_next(at + span.start, sparse);
                        while k < span.end {
                            self.opaque.push(values[k]);
                            k += sparse;
                        }
                    }
                    Say::Shaped if sparse == 1 => self.shaped.extend(&under, values, span, from),
                    Say::Shaped => {
                        let mut k = span.start + before_next(at + span.start, sparse);
                        while k < span.end {
                            self.shaped.extend(&under, values, k..k + 1, from);
                            k += sparse;
                        }
                    }
                }
            }
        }
    }

    /// One round on the pixels gathered: levels under the weights of the last round's, then residuals, their spread and
    /// new weights. Returns the inverse of the normal equations and the step of all unknowns, the centre's last; `None`
    /// where nothing determines them.
    #[inline(always)]
    pub fn round(&mut self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let (_, levels) = self.level_sums().solved()?;
        levels.iter().enumerate().for_each(|(k, v)| self.levels[k] = *v as f32);
        self.look_at_residuals();
        self.step_sums().solved()
    }

    #[inline(always)]
    fn level_sums(&self) -> Equations<M> {
        let mut all = Equations::ZERO;
        let scale = Scale::of(self.sigma, self.unlike);
        let (n, levels) = (self.shaped.grey.len(), &self.levels);
        for start in (0..n).step_by(GROUPS * LANES) {
            let (mut sums, end) = (Sums::ZERO, n.min(start + GROUPS * LANES));
            let whole = start + (end - start) / LANES * LANES;
            for k in (start..whole).step_by(LANES) {
                add_levels(&mut sums, &self.shaped.part::<LANES>(k), levels, scale);
            }
            for k in whole..end {
                add_levels(&mut sums, &self.shaped.part::<1>(k), levels, scale);
            }
            all.add(&sums);
        }
        add_opaque(&mut all, &self.opaque, levels[0], scale.of_residual, 0.0);
        all
    }

    #[inline(always)]
    fn look_at_residuals(&mut self) {
        let (n, levels) = (self.shaped.grey.len(), self.levels);
        self.shaped.residuals.resize(n, 0.0);
        for k in (0..n / LANES * LANES).step_by(LANES) {
            let residuals = self.shaped.part::<LANES>(k).residuals::<M>(&levels);
            self.shaped.residuals[k..k + LANES].copy_from_slice(&residuals);
        }
        for k in n / LANES * LANES..n {
            let [residual] = self.shaped.part::<1>(k).residuals::<M>(&levels);
            self.shaped.residuals[k] = residual;
        }
        self.magnitudes.clear();
        self.magnitudes.count(&self.opaque, levels[0]);
        self.magnitudes.count(&self.shaped.residuals, 0.0);
        // At least a fifth of an 8-bit level.
        self.sigma = (1.4826 * self.magnitudes.median()).max(0.0008).max(self.unlike * levels[1].abs());
    }

    #[inline(always)]
    fn step_sums(&self) -> Equations<N> {
        let mut all = Equations::ZERO;
        let scale = Scale::of(self.sigma, self.unlike);
        let (n, levels) = (self.shaped.grey.len(), &self.levels);
        for start in (0..n).step_by(GROUPS * LANES) {
            let (mut sums, end) = (Sums::ZERO, n.min(start + GROUPS * LANES));
            let whole = start + (end - start) / LANES * LANES;
            for k in (start..whole).step_by(LANES) {
                add_step::<LANES, N, M>(&mut sums, &self.shaped, k, levels, scale);
            }
            for k in whole..end {
                add_step::<1, N, M>(&mut sums, &self.shaped, k, levels, scale);
            }
            all.add(&sums);
        }
        add_opaque(&mut all, &self.opaque, levels[0], scale.of_residual, levels[0]);
        all
    }

    /// Mean square of what the last round leaves over, of all pixels, of the squared contrast; what does not fit at all
    /// counts as if it hardly fitted.
    pub fn left_over(&self) -> f64 {
        let most = (FIT * self.levels[1].abs()).powi(2);
        let sum =
            |squares: &mut dyn Iterator<Item = f32>| squares.map(|square| f64::from(square.min(most))).sum::<f64>();
        let beside = sum(&mut self.opaque.iter().map(|v| (v - self.levels[0]).powi(2)));
        let shaped = sum(&mut self.shaped.residuals.iter().map(|r| r * r));
        (beside + shaped) / self.pixels().max(1) as f64 / f64::from(self.levels[1]).powi(2)
    }

    /// Share of the mark's pixels that do not fit the last round plus share of those around it. A pixel of the mark
    /// must also stand out from the frame: a faint mark would fit anywhere. With the number of the mark's pixels, which
    /// are the fewer.
    pub fn misfit(&self) -> (f64, f64) {
        let limit = (FIT * self.levels[1].abs()).max(FIT_SIGMA * self.sigma);
        let fits = |r: f32| r.abs() <= limit;
        let off = self.opaque.iter().filter(|v| !fits(**v - self.levels[0])).count();
        let (mut mark, mut beside) = ((0.0, 1.0), (off as f64, 1.0 + self.opaque.len() as f64));
        for ((grey, value), r) in self.shaped.grey.iter().zip(&self.shaped.mark[0]).zip(&self.shaped.residuals) {
            if *value > ON_MARK {
                mark.0 += f64::from(!fits(*r) || grey - self.levels[0] <= limit);
                mark.1 += 1.0;
            } else if *value < BESIDE_MARK {
                beside.0 += f64::from(!fits(*r));
                beside.1 += 1.0;
            }
        }
        (mark.0 / mark.1 + beside.0 / beside.1, mark.1)
    }
}

/// Pixels from `at` to the next of a lattice of every `step`-th.
#[inline(always)]
fn before_next(at: usize, step: usize) -> usize {
    (step - at % step) % step
}

/// Pixels for the levels, weighted by how well they fit the last ones; all alike with scale 0.
#[inline(always)]
fn add_levels<const L: usize, const M: usize>(sums: &mut Sums<M>, part: &Part<L>, levels: &[f32; 4], scale: Scale) {
    let by_levels = part.by_levels();
    let mut row = [[0.0; L]; M];
    row.copy_from_slice(&by_levels[..M]);
    let changes = part.changes(part.gain::<M>(levels));
    sums.add(weights(part.residuals::<M>(levels), changes, scale), row, part.grey);
}

/// Pixels for levels and centre.
#[inline(always)]
fn add_step<const L: usize, const N: usize, const M: usize>(
    sums: &mut Sums<N>,
    shaped: &Shaped,
    k: usize,
    levels: &[f32; 4],
    scale: Scale,
) {
    let part = shaped.part::<L>(k);
    let residuals: [f32; L] = first(&shaped.residuals[k..]);
    let (gain, by_levels) = (part.gain::<M>(levels), part.by_levels());
    let mut row = [[0.0; L]; N];
    row[..M].copy_from_slice(&by_levels[..M]);
    for d in 0..2 {
        for i in 0..L {
            row[M + d][i] = -gain[i] * part.mark[1 + d][i];
        }
    }
    sums.add(weights(residuals, part.changes(gain), scale), row, residuals);
}

/// Weights of pixels, of which each may be off by what an edge that lies [`EDGE_PX`] elsewhere makes of it.
#[inline(always)]
fn weights<const L: usize>(mut residuals: [f32; L], changes: [f32; L], scale: Scale) -> [f32; L] {
    for i in 0..L {
        let u = residuals[i] * scale.of_residual;
        let inside = (1.0 - u * u / (1.0 + scale.of_change * changes[i])).max(0.0);
        residuals[i] = inside * inside;
    }
    residuals
}

/// By which residuals become weights.
#[derive(Clone, Copy)]
struct Scale {
    of_residual: f32,
    /// Of the squared change of grey per pixel, what it adds to the squared deviation.
    of_change: f32,
}

impl Scale {
    /// `sigma` 0 weighs all alike.
    fn of(sigma: f32, unlike: f32) -> Scale {
        let of_residual = if sigma == 0.0 { 0.0 } else { 1.0 / (TUKEY * sigma) };
        // A learned mark has the edges that the scans have.
        let edge_px = if unlike == 0.0 { EDGE_PX } else { 0.0 };
        Scale { of_residual, of_change: if sigma == 0.0 { 0.0 } else { (edge_px / sigma).powi(2) } }
    }
}

/// Pixels of the opaque frame, which tell its level only; their values count above `zero`.
#[inline(always)]
fn add_opaque<const N: usize>(all: &mut Equations<N>, values: &[f32], level: f32, scale: f32, zero: f32) {
    for block in values.chunks(GROUPS * LANES) {
        let (mut normal, mut right) = ([0.0f32; LANES], [0.0f32; LANES]);
        let (parts, rest) = block.as_chunks::<LANES>();
        for part in parts {
            for i in 0..LANES {
                let weight = tukey((part[i] - level) * scale);
                normal[i] += weight;
                right[i] += weight * (part[i] - zero);
            }
        }
        for i in 0..rest.len() {
            let weight = tukey((rest[i] - level) * scale);
            normal[i] += weight;
            right[i] += weight * (rest[i] - zero);
        }
        let total = |lanes: [f32; LANES]| lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
        all.normal[0][0] += total(normal);
        all.right[0] += total(right);
    }
}

/// Where Tukey's biweight becomes 0, standard deviations: 95 % efficient for normal errors.
const TUKEY: f32 = 4.685;
/// How far the edges of a drawn mark may lie from where a scan shows them, pixels: lines are wider or narrower than the
/// camera's file says, and scanners blur as they do. Where both edges of a line are off, a fit that allows none takes
/// one for the line.
const EDGE_PX: f32 = 0.15;

/// Tukey's biweight; 1 at 0, 0 from 1 on.
#[inline(always)]
fn tukey(u: f32) -> f32 {
    let inside = (1.0 - u * u).max(0.0);
    inside * inside
}
