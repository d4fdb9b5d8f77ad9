//! The centre of a mark to a fraction of a pixel: least squares between the scan and the drawn mark.
//!
//! The model of a pixel is `d + T(x − c) · (g + gx·dx + gy·dy)`: d the level of the opaque frame, T the drawn mark blurred
//! as by a scanner, g its brightness, and gx, gy how that changes across it, which only marks that show the image have. After
//! A. Gruen, "Adaptive least squares correlation", South African Journal of Photogrammetry, 1985, with Tukey's biweight, so
//! that scratches and dust take no part.

use nalgebra::{DMatrix, DVector};

use super::template::{Linear, Model, invert};
use super::window::{Grey, blur};
use crate::coords::PixelPoint;

/// A refined centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refined {
    pub centre: PixelPoint,
    /// Var x, cov xy, var y, px².
    pub covariance_px2: [f64; 3],
    /// Brightness of the mark above the opaque frame, of white.
    pub contrast: f64,
    /// Robust standard deviation of a pixel about the model, of white.
    pub sigma: f64,
    /// Share of the mark's pixels that do not fit the model plus share of those around it: scratches and dust have more room beside
    /// the mark, so that what is missing of it weighs more.
    pub misfit: f64,
}

/// Places drawn per pixel.
const FINE: usize = 4;
/// Blur of scanner and emulsion, pixels.
const BLUR_PX: f64 = 0.7;
/// No centre moves further than this from where it starts, pixels.
const MOST_PX: f64 = 6.0;
/// Rounds of least squares; a centre that moves less is settled, pixels.
const MOST_ROUNDS: usize = 25;
const STEP_PX: f64 = 2e-3;
/// Of marks that reach further than this one pixel in so many is taken until the centre moves less than that, pixels.
const LARGE_PX: f64 = 25.0;
const SPARSE: usize = 5;
const SPARSE_STEP_PX: f64 = 0.05;

/// A pixel does not fit when it is off by this share of the mark's contrast and by so many standard deviations.
const FIT: f64 = 0.3;
const FIT_SIGMA: f64 = 4.0;
/// Marks of lines that fit worse are looked at from around, how far around, pixels, and by how much another place must fit better: a
/// scratch along a line holds the centre where only that line fits.
const DAMAGED: f64 = 0.03;
const AROUND_PX: f64 = 2.0;
const CLEARLY: f64 = 0.01;
/// Values of the drawn mark above which a pixel is the mark's, and below which it is not.
const ON_MARK: f64 = 0.4;
const BESIDE_MARK: f64 = 0.1;

/// The mark drawn finely and blurred, looked up between its values.
struct Surface {
    width: usize,
    height: usize,
    /// Of the reference point, in fine values.
    reference: [f64; 2],
    values: Vec<f32>,
    known: Vec<bool>,
}

impl Surface {
    fn new(model: &Model, linear: Linear, radius_mm: f64) -> Option<Surface> {
        let inverse = invert(linear)?;
        let px_per_mm = (linear[0] * linear[3] - linear[1] * linear[2]).abs().sqrt();
        let half = ((radius_mm * px_per_mm + 3.0) * FINE as f64).ceil() as usize;
        let width = 2 * half + 1;
        let mut values = vec![0.0f32; width * width];
        let mut known = vec![false; width * width];
        for y in 0..width {
            for x in 0..width {
                let (dx, dy) = ((x as f64 - half as f64) / FINE as f64, (y as f64 - half as f64) / FINE as f64);
                let (u, v) = (inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy);
                let sample = model.sample(u, v);
                known[y * width + x] = u * u + v * v <= radius_mm * radius_mm && sample.is_some_and(|(_, w)| w > 0.3);
                values[y * width + x] = sample.map_or(0.0, |(value, _)| value);
            }
        }
        blur(&mut values, width, width, BLUR_PX * FINE as f64);
        Some(Surface { width, height: width, reference: [half as f64; 2], values, known })
    }

    /// How far it reaches along both axes, pixels.
    fn half_px(&self) -> f64 {
        self.reference[0] / FINE as f64
    }

    /// Value and derivatives per pixel at (dx, dy) pixels from the reference point; `None` where nothing is known.
    fn at(&self, dx: f64, dy: f64) -> Option<[f64; 3]> {
        let (x, y) = (self.reference[0] + dx * FINE as f64, self.reference[1] + dy * FINE as f64);
        if x < 1.0 || y < 1.0 || x + 2.0 >= self.width as f64 || y + 2.0 >= self.height as f64 {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        if !self.known[j * self.width + i] {
            return None;
        }
        let (fx, fy) = (x - i as f64, y - j as f64);
        let v = |i: usize, j: usize| f64::from(self.values[j * self.width + i]);
        let (a, b, c, d) = (v(i, j), v(i + 1, j), v(i, j + 1), v(i + 1, j + 1));
        let value = (a * (1.0 - fx) + b * fx) * (1.0 - fy) + (c * (1.0 - fx) + d * fx) * fy;
        let gx = ((b - a) * (1.0 - fy) + (d - c) * fy) * FINE as f64;
        let gy = ((c - a) * (1.0 - fx) + (d - b) * fx) * FINE as f64;
        Some([value, gx, gy])
    }
}

/// A mark drawn for one frame, to be refined from one or several starts.
pub struct Refiner {
    surface: Surface,
    slopes: bool,
    /// For marks of lines, how far around a start is tried where the mark is damaged.
    around_px: Option<f64>,
}

impl Refiner {
    /// `radius_mm`: what lies further from the reference point takes no part. `None` for a degenerate pose.
    pub fn new(model: &Model, linear: Linear, radius_mm: f64) -> Option<Refiner> {
        let px_per_mm = (linear[0] * linear[3] - linear[1] * linear[2]).abs().sqrt();
        Some(Refiner {
            surface: Surface::new(model, linear, radius_mm)?,
            slopes: model.is_drawn() && model.shows_image(),
            around_px: model.sectors_deg().map(|_| AROUND_PX.max(model.detail_mm() * px_per_mm)),
        })
    }

    /// Refines `start` on full-resolution values. `None` when it does not settle: nothing to hold on to, or the centre walks away. Of
    /// several places that a damaged mark of lines may settle at, `doubt` adds to the misfit of each.
    pub fn refine(&self, grey: &Grey, start: PixelPoint, doubt: impl Fn(PixelPoint) -> f64) -> Option<Refined> {
        let Some(step) = self.around_px else { return self.settle(grey, start) };
        let around = [4, 0, 1, 2, 3, 5, 6, 7, 8].map(|k| {
            let (dx, dy) = (f64::from(k % 3 - 1) * step, f64::from(k / 3 - 1) * step);
            PixelPoint { x: start.x + dx, y: start.y + dy }
        });
        Some(self.best_of(grey, &around, doubt)?.1)
    }

    /// Of several starts the one whose mark fits best, with its index; of those that fit equally well the first, and the first that is
    /// undamaged ends the search. `doubt` is added to the misfit of a place.
    pub fn best_of(
        &self,
        grey: &Grey,
        starts: &[PixelPoint],
        doubt: impl Fn(PixelPoint) -> f64,
    ) -> Option<(usize, Refined)> {
        let mut best: Option<(usize, Refined, f64)> = None;
        for (k, start) in starts.iter().enumerate() {
            let Some(r) = self.settle(grey, *start).filter(|r| r.contrast > 0.0) else { continue };
            let misfit = r.misfit + doubt(r.centre);
            if best.as_ref().is_none_or(|b| misfit < b.2 - CLEARLY) {
                best = Some((k, r, misfit));
            }
            if misfit < DAMAGED {
                break;
            }
        }
        best.map(|(k, r, _)| (k, r))
    }

    fn settle(&self, grey: &Grey, start: PixelPoint) -> Option<Refined> {
        if self.slopes { self.descend::<6>(grey, start) } else { self.descend::<4>(grey, start) }
    }

    /// Gauss-Newton with `N` unknowns: two or four levels and the centre. Of a large mark on some of its pixels while the
    /// centre still moves, then on all.
    fn descend<const N: usize>(&self, grey: &Grey, start: PixelPoint) -> Option<Refined> {
        let mut c = grey.from_scan(start);
        let mut fit = Fit::<N>::default();
        let mut sparse = if self.surface.half_px() > LARGE_PX { SPARSE } else { 1 };
        let mut last = None;
        for round in 0..MOST_ROUNDS {
            fit.gather(grey, &self.surface, c, sparse);
            if fit.rows.len() < 24 {
                return None;
            }
            fit.solve_levels()?;
            let (inverse, step) = fit.step()?;
            let (dx, dy) = (step[N - 2].clamp(-1.0, 1.0), step[N - 1].clamp(-1.0, 1.0));
            c = [c[0] + dx, c[1] + dy];
            let centre = grey.to_scan(c[0], c[1]);
            if (centre.x - start.x).hypot(centre.y - start.y) > MOST_PX || !dx.is_finite() || !dy.is_finite() {
                return None;
            }
            if sparse > 1 {
                if dx.hypot(dy) < SPARSE_STEP_PX || round == MOST_ROUNDS / 2 {
                    sparse = 1;
                }
                continue;
            }
            let variance = fit.sigma * fit.sigma;
            let p = N - 2;
            last = Some(Refined {
                centre,
                covariance_px2: [inverse[(p, p)], inverse[(p, p + 1)], inverse[(p + 1, p + 1)]].map(|v| v * variance),
                contrast: fit.levels[1],
                sigma: fit.sigma,
                misfit: fit.misfit(),
            });
            if dx.hypot(dy) < STEP_PX {
                break;
            }
        }
        last.filter(|r| r.covariance_px2.iter().all(|v| v.is_finite()))
    }
}

/// One pixel: its value, the mark's value there with derivatives, and where it lies from the centre.
struct Row {
    grey: f64,
    mark: [f64; 3],
    dx: f64,
    dy: f64,
}

/// The least squares of one mark, kept from round to round.
struct Fit<const N: usize> {
    rows: Vec<Row>,
    residuals: Vec<f64>,
    weights: Vec<f64>,
    /// Of the opaque frame, of the mark above it, and how that changes across; the last two stay 0 without slopes.
    levels: [f64; 4],
    /// Of the last round; 0 before the first.
    sigma: f64,
    scratch: Vec<f64>,
}

impl<const N: usize> Default for Fit<N> {
    fn default() -> Self {
        Fit { rows: vec![], residuals: vec![], weights: vec![], levels: [0.0; 4], sigma: 0.0, scratch: vec![] }
    }
}

impl<const N: usize> Fit<N> {
    const LEVELS: usize = N - 2;

    /// The pixels around `c` that the mark says something about, one in `sparse` (a lattice that no line of the mark slips through),
    /// weighted by how well they fitted the last round's levels.
    fn gather(&mut self, grey: &Grey, surface: &Surface, c: [f64; 2], sparse: usize) {
        let half = surface.half_px();
        let range = |c: f64, n: usize| {
            (((c - half).floor().max(0.0)) as usize, ((c + half).ceil().clamp(0.0, n as f64)) as usize)
        };
        let ((x0, x1), (y0, y1)) = (range(c[0], grey.width), range(c[1], grey.height));
        self.rows.clear();
        self.weights.clear();
        for y in y0..y1 {
            let first = x0 + (sparse - (x0 + 2 * y) % sparse) % sparse;
            for x in (first..x1).step_by(sparse) {
                let (dx, dy) = (x as f64 + 0.5 - c[0], y as f64 + 0.5 - c[1]);
                if let Some(mark) = surface.at(dx, dy) {
                    self.rows.push(Row { grey: f64::from(grey.at(x, y)), mark, dx, dy });
                }
            }
        }
        let (levels, sigma) = (self.levels, self.sigma);
        let weight = |r: &Row| if sigma > 0.0 { tukey((r.grey - level::<N>(&levels, r)) / sigma) } else { 1.0 };
        self.weights.extend(self.rows.iter().map(weight));
    }

    /// Levels under the present weights, then residuals, their spread and new weights.
    fn solve_levels(&mut self) -> Option<()> {
        let mut normal = [[0.0f64; 4]; 4];
        let mut right = [0.0f64; 4];
        for (r, w) in self.rows.iter().zip(&self.weights) {
            let t = r.mark[0];
            let row = [1.0, t, t * r.dx, t * r.dy];
            for a in 0..Self::LEVELS {
                let wa = w * row[a];
                right[a] += wa * r.grey;
                for b in a..Self::LEVELS {
                    normal[a][b] += wa * row[b];
                }
            }
        }
        let n = Self::LEVELS;
        let matrix = DMatrix::from_fn(n, n, |a, b| normal[a.min(b)][a.max(b)]);
        let levels = matrix.try_inverse()? * DVector::from_fn(n, |a, _| right[a]);
        levels.iter().enumerate().for_each(|(k, v)| self.levels[k] = *v);
        let levels = self.levels;
        self.residuals.clear();
        self.residuals.extend(self.rows.iter().map(|r| r.grey - level::<N>(&levels, r)));
        self.sigma = spread(&self.residuals, &mut self.scratch);
        let sigma = self.sigma;
        self.weights.clear();
        self.weights.extend(self.residuals.iter().map(|r| tukey(r / sigma)));
        Some(())
    }

    /// The inverse of the normal equations and the step of all unknowns, the centre's last.
    fn step(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let mut normal = [[0.0f64; N]; N];
        let mut right = [0.0f64; N];
        let levels = &self.levels;
        for ((r, v), w) in self.rows.iter().zip(&self.residuals).zip(&self.weights) {
            let t = r.mark[0];
            let gain = gain::<N>(levels, r);
            let mut row = [0.0f64; N];
            row[..Self::LEVELS].copy_from_slice(&[1.0, t, t * r.dx, t * r.dy][..Self::LEVELS]);
            (row[N - 2], row[N - 1]) = (-gain * r.mark[1], -gain * r.mark[2]);
            for a in 0..N {
                let wa = w * row[a];
                right[a] += wa * v;
                for b in a..N {
                    normal[a][b] += wa * row[b];
                }
            }
        }
        let inverse = DMatrix::from_fn(N, N, |a, b| normal[a.min(b)][a.max(b)]).try_inverse()?;
        let step = &inverse * DVector::from_fn(N, |a, _| right[a]);
        Some((inverse, step))
    }

    /// A pixel of the mark must also stand out from the frame: a faint mark would fit anywhere.
    fn misfit(&self) -> f64 {
        let limit = (FIT * self.levels[1].abs()).max(FIT_SIGMA * self.sigma);
        let (mut mark, mut beside) = ((0.0, 1.0), (0.0, 1.0));
        for (row, r) in self.rows.iter().zip(&self.residuals) {
            let fits = r.abs() <= limit;
            if row.mark[0] > ON_MARK {
                mark.0 += f64::from(!fits || row.grey - self.levels[0] <= limit);
                mark.1 += 1.0;
            } else if row.mark[0] < BESIDE_MARK {
                beside.0 += f64::from(!fits);
                beside.1 += 1.0;
            }
        }
        mark.0 / mark.1 + beside.0 / beside.1
    }
}

/// Brightness of the mark above the opaque frame at a pixel.
fn gain<const N: usize>(levels: &[f64; 4], r: &Row) -> f64 {
    levels[1] + if N > 4 { levels[2] * r.dx + levels[3] * r.dy } else { 0.0 }
}

fn level<const N: usize>(levels: &[f64; 4], r: &Row) -> f64 {
    levels[0] + r.mark[0] * gain::<N>(levels, r)
}

/// 1.4826 × the median of the absolute values, at least a fifth of an 8-bit level.
fn spread(residuals: &[f64], all: &mut Vec<f64>) -> f64 {
    all.clear();
    all.extend(residuals.iter().map(|r| r.abs()));
    let middle = all.len() / 2;
    let (_, median, _) = all.select_nth_unstable_by(middle, f64::total_cmp);
    (1.4826 * *median).max(0.0008)
}

/// Tukey's biweight, 95 % efficient for normal errors.
fn tukey(t: f64) -> f64 {
    let u = t / 4.685;
    if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
}
