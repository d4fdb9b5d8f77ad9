//! The centre of a mark to a fraction of a pixel: least squares between the scan and the drawn mark.
//!
//! The model of a pixel is `d + T(x − c) · (g + gx·dx + gy·dy)`: d the level of the opaque frame, T the drawn mark
//! blurred as by a scanner, g its brightness, and gx, gy how that changes across it, which only marks that show the
//! image have. After A. Gruen, "Adaptive least squares correlation", South African Journal of Photogrammetry, 1985,
//! with Tukey's biweight, so that scratches and dust take no part.

mod drawing;
mod fit;
mod sizes;
mod spread;
mod surface;

use std::cell::OnceCell;

use self::fit::Fit;
use self::sizes::Sizes;
use self::surface::{SHARP_PX, Surface};
use super::template::{Linear, Model};
use super::types::MarkKind;
use super::window::Grey;
use autoref_raster::coords::PixelPoint;
use autoref_raster::simd::{Kernel, widest};

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
    /// Share of the mark's pixels that do not fit the model plus share of those around it: scratches and dust have more
    /// room beside the mark, so that what is missing of it weighs more.
    pub misfit: f64,
    /// How far all edges that fit lie further out than drawn, pixels.
    swell_px: f64,
}

/// No centre moves further than this from where it starts, pixels.
const MOST_PX: f64 = 6.0;
/// Rounds of least squares; a centre that moves less is settled, pixels.
const MOST_ROUNDS: usize = 25;
const STEP_PX: f64 = 2e-3;
/// Of marks that reach further than this one pixel in so many is taken until the centre moves less than that, pixels.
const LARGE_PX: f64 = 25.0;
const SPARSE: usize = 5;
const SPARSE_STEP_PX: f64 = 0.05;
/// Steps that shrink by a factor between these, one after the other in the same direction, are taken to go on shrinking
/// so.
const SHRINKING: std::ops::Range<f64> = 0.3..0.8;

/// Marks of lines that fit worse are looked at from around, how far around, pixels, and by how much another place must
/// fit better: a scratch along a line holds the centre where only that line fits.
const DAMAGED: f64 = 0.03;
const AROUND_PX: f64 = 2.0;
const CLEARLY: f64 = 0.01;
/// So many standard deviations the misfit of some of the pixels may be above that of all.
const ROUGHLY_SIGMAS: f64 = 2.0;

/// How far a pixel of a learned mark is off although mark and place are right, of the mark's contrast: frames differ in
/// sharpness, and a mark lies otherwise between their pixels. Its edges, which alone tell where it is, must not count
/// as damage for that.
const UNLIKE: f32 = 0.06;

/// Blurs of softer scans, pixels, each a root of two more than the last: between two of them an edge is softer or
/// sharper by a fifth, which moves no line.
const SOFTER_PX: [f64; 5] = [1.0, 1.4, 2.0, 2.8, 4.0];
/// 1σ of a centre along one axis for each pixel of blur beyond that of a good scan: what lies beside the mark shines
/// into it. Marks of a real frame that was blurred by 3 and by 4 px lay 0.02 to 0.28 px beside their place.
const SOFT_SIGMA: f64 = 0.025;
/// Of a dot of another size what is left over is less by this factor at least; specks and scratches leave as much with
/// any.
const CLEARLY_LESS: f64 = 0.85;
/// A dot is as large as drawn where all edges fit, lie no further out or in than this, pixels, and agree about the
/// centre: 1σ along an axis, pixels. A fit that holds one edge of a larger dot takes it for as large as drawn.
const AS_LARGE_PX: f64 = 0.1;
const AGREE_PX: f64 = 0.02;
/// Rounds by which levels and weights are settled at a place that is given.
const LEVEL_ROUNDS: usize = 3;

/// A mark drawn for one frame, to be refined from one or several starts.
pub struct Refiner {
    surface: Surface,
    /// The same for softer scans, of crosses: others have no second edge beside the first, and how soft a small dot or
    /// hole is cannot be told from how large it is. `None` for a learned mark, which has the edges that the scans have.
    softer: Option<Softer>,
    /// The same with dots and their rings larger and smaller.
    sizes: Option<Sizes>,
    /// Whether the covariance has in it how far the mark's sectors disagree.
    is_dot: bool,
    unlike: f32,
    slopes: bool,
    /// For marks of lines, how far around a start is tried where the mark is damaged.
    around_px: Option<f64>,
}

/// Whether a mark is drawn of lines, each of two edges.
fn has_lines(model: &Model) -> bool {
    matches!(model, Model::Drawn(MarkKind::Cross { .. } | MarkKind::RingCross { .. }))
}

/// Dots are as drawn but for their size: what does not fit them is a scratch or light. Lines, teeth and learned marks
/// differ from their drawings all around, which would count as doubt.
fn is_dot(model: &Model) -> bool {
    matches!(model, Model::Drawn(MarkKind::Dot { .. }))
}

impl Refiner {
    /// `radius_mm`: what lies further from the reference point takes no part. `None` for a degenerate pose.
    pub fn new(model: &Model, linear: Linear, radius_mm: f64) -> Option<Refiner> {
        let px_per_mm = (linear[0] * linear[3] - linear[1] * linear[2]).abs().sqrt();
        Some(Refiner {
            surface: Surface::new(model, linear, radius_mm, SHARP_PX)?,
            softer: has_lines(model).then(|| Softer::of(model, linear, radius_mm)),
            sizes: Sizes::of(model, linear, radius_mm),
            is_dot: is_dot(model),
            unlike: if model.is_drawn() { 0.0 } else { UNLIKE },
            slopes: model.is_drawn() && model.shows_image(),
            around_px: model.sectors_deg().map(|_| AROUND_PX.max(model.detail_mm() * px_per_mm)),
        })
    }

    /// Refines `start` on full-resolution values. `None` when it does not settle: nothing to hold on to, or the centre
    /// walks away. Of several places that a damaged mark of lines may settle at, `doubt` adds to the misfit of each.
    pub fn refine(&self, grey: &Grey, start: PixelPoint, doubt: impl Fn(PixelPoint) -> f64) -> Option<Refined> {
        let found = self.refine_sharp(grey, start, doubt)?;
        Some(self.sized(grey, self.softened(grey, found)))
    }

    fn refine_sharp(&self, grey: &Grey, start: PixelPoint, doubt: impl Fn(PixelPoint) -> f64) -> Option<Refined> {
        let Some(step) = self.around_px else { return self.settle(&self.surface, grey, start, &|_, _| true) };
        let around = [4, 0, 1, 2, 3, 5, 6, 7, 8].map(|k| {
            let (dx, dy) = (f64::from(k % 3 - 1) * step, f64::from(k / 3 - 1) * step);
            PixelPoint { x: start.x + dx, y: start.y + dy }
        });
        Some(self.best_of(grey, &around, doubt)?.1)
    }

    /// Of several starts the one whose mark fits best, with its index; of those that fit equally well the first, and
    /// the first that is undamaged ends the search. `doubt` is added to the misfit of a place.
    pub fn best_of(
        &self,
        grey: &Grey,
        starts: &[PixelPoint],
        doubt: impl Fn(PixelPoint) -> f64,
    ) -> Option<(usize, Refined)> {
        let mut best: Option<(usize, Refined, f64)> = None;
        for (k, start) in starts.iter().enumerate() {
            let most = best.as_ref().map_or(f64::INFINITY, |b| b.2 - CLEARLY);
            let hopeful = |place: PixelPoint, misfit: f64| misfit + doubt(place) < most;
            let Some(r) = self.settle(&self.surface, grey, *start, &hopeful).filter(|r| r.contrast > 0.0) else {
                continue;
            };
            let misfit = r.misfit + doubt(r.centre);
            if misfit < most {
                best = Some((k, r, misfit));
            }
            if misfit < DAMAGED {
                break;
            }
        }
        best.map(|(k, r, _)| (k, r))
    }

    /// The same with the mark as soft as the scan shows it. Of a line with edges softer than drawn, a fit that gives
    /// edges that are off no weight holds one, and lies beside it.
    fn softened(&self, grey: &Grey, found: Refined) -> Refined {
        let Some(softer) = &self.softer else { return found };
        let (mut best, mut least) = (found, self.left_over(&self.surface, grey, found.centre));
        for (surface, blur_px) in softer.surfaces() {
            if self.left_over(surface, grey, best.centre) >= least {
                break;
            }
            let Some(mut other) = self.settle(surface, grey, best.centre, &|_, _| true).filter(|r| r.contrast > 0.0)
            else {
                break;
            };
            let soft_px2 = (SOFT_SIGMA * (blur_px - SHARP_PX)).powi(2);
            [0, 2].into_iter().for_each(|axis| other.covariance_px2[axis] += soft_px2);
            (best, least) = (other, self.left_over(surface, grey, other.centre));
        }
        best
    }

    /// The same with a dot as large as the scan shows it: exposure, a burnt-out scan or the camera's file make it
    /// larger or smaller evenly. Of a dot drawn too small a fit that gives edges that are off no weight holds one side.
    /// What does not fit the mark as the file has it still counts as its misfit.
    fn sized(&self, grey: &Grey, found: Refined) -> Refined {
        let apart = |axis: usize| found.covariance_px2[axis] > AGREE_PX * AGREE_PX;
        let is_other = found.misfit >= DAMAGED || found.swell_px.abs() > AS_LARGE_PX || apart(0) || apart(2);
        let Some(sizes) = self.sizes.as_ref().filter(|_| is_other) else { return found };
        let as_drawn = self.left_over(&self.surface, grey, found.centre);
        let is_near = |r: &Refined| (r.centre.x - found.centre.x).hypot(r.centre.y - found.centre.y) < MOST_PX;
        let go = |surfaces: Box<dyn Iterator<Item = &Surface> + '_>| {
            let (mut best, mut least) = (found, as_drawn);
            for surface in surfaces {
                let other = self.settle(surface, grey, best.centre, &|_, _| true);
                let Some(other) = other.filter(|r| r.contrast > 0.0 && is_near(r)) else { break };
                let left = self.left_over(surface, grey, other.centre);
                if left >= least {
                    break;
                }
                (best, least) = (Refined { misfit: found.misfit, ..other }, left);
            }
            (best, least)
        };
        let (larger, smaller) = (go(sizes.larger()), go(sizes.smaller()));
        let (best, least) = if smaller.1 < larger.1 { smaller } else { larger };
        if least < CLEARLY_LESS * as_drawn { best } else { found }
    }

    fn settle(&self, surface: &Surface, grey: &Grey, start: PixelPoint, hopeful: &Hopeful) -> Option<Refined> {
        let (unlike, is_dot) = (self.unlike, self.is_dot);
        if self.slopes {
            widest(Descent::<6, 4> { surface, unlike, is_dot, grey, start, hopeful })
        } else {
            widest(Descent::<4, 2> { surface, unlike, is_dot, grey, start, hopeful })
        }
    }

    /// What a drawn mark leaves over at a place; see [`Fit::left_over`].
    fn left_over(&self, surface: &Surface, grey: &Grey, place: PixelPoint) -> f64 {
        let unlike = self.unlike;
        let left_over = if self.slopes {
            widest(LeftOver::<6, 4> { surface, unlike, grey, place })
        } else {
            widest(LeftOver::<4, 2> { surface, unlike, grey, place })
        };
        left_over.unwrap_or(f64::INFINITY)
    }
}

/// The mark drawn for softer scans, once each is asked for.
struct Softer {
    model: Model,
    linear: Linear,
    radius_mm: f64,
    surfaces: [OnceCell<Option<Surface>>; SOFTER_PX.len()],
}

impl Softer {
    fn of(model: &Model, linear: Linear, radius_mm: f64) -> Softer {
        Softer { model: model.clone(), linear, radius_mm, surfaces: Default::default() }
    }

    /// From the sharpest on, each with its blur, pixels.
    fn surfaces(&self) -> impl Iterator<Item = (&Surface, f64)> {
        let drawn = |blur_px: f64| Surface::new(&self.model, self.linear, self.radius_mm, blur_px);
        SOFTER_PX
            .iter()
            .zip(&self.surfaces)
            .map_while(move |(px, cell)| Some((cell.get_or_init(|| drawn(*px)).as_ref()?, *px)))
    }
}

/// What a mark leaves over where it lies, with `N` unknowns of which `M` are levels.
#[derive(Clone, Copy)]
struct LeftOver<'a, const N: usize, const M: usize> {
    surface: &'a Surface,
    unlike: f32,
    grey: &'a Grey,
    place: PixelPoint,
}

impl<const N: usize, const M: usize> Kernel for LeftOver<'_, N, M> {
    type Output = Option<f64>;

    #[inline(always)]
    fn run(self) -> Option<f64> {
        let LeftOver { surface, unlike, grey, place } = self;
        let mut fit = Fit::<N, M>::new(unlike);
        fit.gather(grey, surface, grey.from_scan(place), 1);
        for _ in 0..LEVEL_ROUNDS {
            fit.round()?;
        }
        Some(fit.left_over())
    }
}

/// Whether a place with at least so large a misfit is worth going on with.
type Hopeful<'a> = dyn Fn(PixelPoint, f64) -> bool + 'a;

/// Gauss-Newton with `N` unknowns: `M` levels and the centre.
#[derive(Clone, Copy)]
struct Descent<'a, const N: usize, const M: usize> {
    surface: &'a Surface,
    unlike: f32,
    is_dot: bool,
    grey: &'a Grey,
    start: PixelPoint,
    /// Asked before all pixels are taken.
    hopeful: &'a Hopeful<'a>,
}

impl<const N: usize, const M: usize> Kernel for Descent<'_, N, M> {
    type Output = Option<Refined>;

    /// Of a large mark on some of its pixels while the centre still moves, then on all.
    #[inline(always)]
    fn run(self) -> Option<Refined> {
        let Descent { surface, unlike, is_dot, grey, start, hopeful } = self;
        let mut c = grey.from_scan(start);
        let mut fit = Fit::<N, M>::new(unlike);
        let is_large = (0..2).flat_map(|axis| surface.reach_px(axis)).any(|px| px > LARGE_PX);
        let mut sparse = if is_large { SPARSE } else { 1 };
        let mut settled = None;
        let mut stride = Stride::default();
        for round in 0..MOST_ROUNDS {
            fit.gather(grey, surface, c, sparse);
            if fit.pixels() < 24 {
                return None;
            }
            let (inverse, step) = fit.round()?;
            let step = [step[M], step[M + 1]];
            let size = step[0].hypot(step[1]);
            let moved = stride.of(step);
            c = [c[0] + moved[0], c[1] + moved[1]];
            let centre = grey.to_scan(c[0], c[1]);
            if (centre.x - start.x).hypot(centre.y - start.y) > MOST_PX || !size.is_finite() {
                return None;
            }
            if sparse > 1 {
                let settled = size < SPARSE_STEP_PX;
                if settled {
                    let (misfit, pixels) = fit.misfit();
                    if !hopeful(centre, misfit - ROUGHLY_SIGMAS * 0.5 / pixels.sqrt()) {
                        return None;
                    }
                }
                if settled || round == MOST_ROUNDS / 2 {
                    (sparse, stride) = (1, Stride::default());
                }
                continue;
            }
            settled = Some((centre, inverse));
            if size < STEP_PX {
                break;
            }
        }
        let (centre, inverse) = settled?;
        let variance = fit.sigma() * fit.sigma();
        let mut covariance_px2 = [(M, M), (M, M + 1), (M + 1, M + 1)].map(|at| inverse[at] * variance);
        if is_dot {
            covariance_px2.iter_mut().zip(fit.disagreement(&inverse)).for_each(|(v, apart)| *v += apart);
        }
        let refined = Refined {
            centre,
            covariance_px2,
            contrast: fit.contrast(),
            sigma: fit.sigma(),
            misfit: fit.misfit().0,
            swell_px: f64::from(fit.swell_px()),
        };
        covariance_px2.iter().all(|v| v.is_finite()).then_some(refined)
    }
}

/// How far each step goes: no further than a pixel along either axis, but to the end where steps shrink alike. Weights
/// that follow the residuals make the descent as slow as a geometric series, of which two steps tell the sum.
#[derive(Default)]
struct Stride {
    last: Option<[f64; 2]>,
}

impl Stride {
    fn of(&mut self, step: [f64; 2]) -> [f64; 2] {
        let limited = step.map(|v| v.clamp(-1.0, 1.0));
        let factor = self.last.filter(|_| limited == step).map_or(1.0, |last| onward(last, step));
        // A step cut short says nothing of the next, and after a longer one the next two tell anew.
        self.last = (limited == step && factor == 1.0).then_some(step);
        limited.map(|v| factor * v)
    }
}

/// How many times as far as `step` the end is when steps go on shrinking as from `last` to `step`.
fn onward(last: [f64; 2], step: [f64; 2]) -> f64 {
    let dot = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
    let shrunk = dot(last, step) / dot(last, last);
    let straight = dot(last, step) > 0.9 * (dot(last, last) * dot(step, step)).sqrt();
    if straight && SHRINKING.contains(&shrunk) { 1.0 / (1.0 - shrunk) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cross with grain.
    fn scanned(model: &Model, linear: Linear, centre: PixelPoint) -> Grey {
        const SIDE: usize = 90;
        let inverse = crate::template::invert(linear).expect("a turn");
        let value = |n: usize| {
            let (x, y) = (n % SIDE, n / SIDE);
            let of = |k: usize| {
                let (dx, dy) = (
                    x as f64 + (k % 8) as f64 / 8.0 + 0.0625 - centre.x,
                    y as f64 + (k / 8) as f64 / 8.0 + 0.0625 - centre.y,
                );
                let (u, v) = (inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy);
                model.sample(u, v).map_or(0.0, |s| s.0)
            };
            let grain = ((n as u32).wrapping_mul(2_654_435_761) >> 24) as f32 / 255.0;
            0.1 + 0.02 * grain + 0.5 * (0..64).map(of).sum::<f32>() / 64.0
        };
        Grey { width: SIDE, height: SIDE, data: (0..SIDE * SIDE).map(value).collect(), origin: [0, 0], factor: 1 }
    }

    #[test]
    fn a_cross_under_a_speck_settles_and_alike_on_every_processor() {
        let model = Model::Drawn(MarkKind::Cross { arm_mm: 0.6, line_mm: 0.08, gap_mm: 0.0, lines_deg: 0.0 });
        let linear = [50.0, 0.7, 0.7, -50.0];
        let centre = PixelPoint { x: 45.3, y: 44.8 };
        let mut grey = scanned(&model, linear, centre);
        // A corner of it lies under a bright speck.
        (20..30).for_each(|y| grey.data[y * grey.width..][..50].fill(0.8));
        let refiner = Refiner::new(&model, linear, 0.8).expect("a turn");
        let start = PixelPoint { x: 45.0, y: 45.0 };
        let descent = Descent::<4, 2> {
            surface: &refiner.surface,
            unlike: 0.0,
            is_dot: false,
            grey: &grey,
            start,
            hopeful: &|_, _| true,
        };
        let found = widest(descent).expect("settles");
        assert_eq!(Some(found), descent.run());
        // No scanner blurs this one: its edges, steeper than those of the model, count for little.
        let off = (found.centre.x - centre.x).hypot(found.centre.y - centre.y);
        assert!(off < 0.25, "{off} px");
    }

    /// Lines as wide as a good scan shows them lie where they are in soft scans too, from starts on either side.
    #[test]
    fn crosses_of_soft_scans_lie_where_they_are() {
        let model = Model::Drawn(MarkKind::Cross { arm_mm: 1.2, line_mm: 0.08, gap_mm: 0.3, lines_deg: 0.0 });
        let linear = [25.0, 0.2, 0.2, -25.0];
        let centre = PixelPoint { x: 45.3, y: 44.6 };
        for blur_px in [0.7, 1.0, 1.3, 1.7, 2.2, 2.8] {
            let mut grey = scanned(&model, linear, centre);
            let (width, height) = (grey.width, grey.height);
            crate::window::blur(&mut grey.data, width, height, blur_px);
            let refiner = Refiner::new(&model, linear, 1.6).expect("a turn");
            for (dx, dy) in [(0.4, -0.3), (-0.5, 0.4)] {
                let start = PixelPoint { x: centre.x + dx, y: centre.y + dy };
                let found = refiner.refine(&grey, start, |_| 0.0).expect("settles");
                let off = (found.centre.x - centre.x).hypot(found.centre.y - centre.y);
                assert!(off < 0.04, "blurred by {blur_px} px: {off} px off");
            }
        }
    }

    fn dot(diameter_mm: f64) -> Model {
        Model::Drawn(MarkKind::Dot { diameter_mm, ring_diameter_mm: None, ring_line_mm: None })
    }

    /// The centre's error in its own standard deviations, with 0.02 px for the scanner as the result has it.
    fn sigmas(found: &Refined, centre: PixelPoint) -> f64 {
        let (dx, dy) = (found.centre.x - centre.x, found.centre.y - centre.y);
        let [xx, xy, yy] = found.covariance_px2;
        let (xx, yy) = (xx + 4e-4, yy + 4e-4);
        ((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)).sqrt()
    }

    /// Overexposed, burnt out or wrong in the camera's file: evenly larger or smaller dots lie where they are.
    #[test]
    fn dots_of_another_size_lie_where_they_are() {
        let linear = [33.3, 0.3, 0.3, -33.3];
        let refiner = Refiner::new(&dot(0.3), linear, 0.4).expect("a turn");
        for (k, diameter_mm) in [0.24, 0.3, 0.33, 0.36, 0.39].into_iter().enumerate() {
            let centre = PixelPoint { x: 45.3 + 0.17 * k as f64, y: 44.8 - 0.23 * k as f64 };
            let mut grey = scanned(&dot(diameter_mm), linear, centre);
            let (width, height) = (grey.width, grey.height);
            crate::window::blur(&mut grey.data, width, height, 0.7);
            let start = PixelPoint { x: centre.x + 0.6, y: centre.y - 0.4 };
            let found = refiner.refine(&grey, start, |_| 0.0).expect("settles");
            let off = (found.centre.x - centre.x).hypot(found.centre.y - centre.y);
            assert!(off < 0.04 && sigmas(&found, centre) < 3.0, "{diameter_mm} mm: {off} px off, {found:?}");
        }
    }

    /// What a scratch over its rim takes of a dot is in what is said of its centre; without one little is.
    #[test]
    fn scratches_over_a_dot_are_in_its_covariance() {
        let linear = [33.3, 0.3, 0.3, -33.3];
        let refiner = Refiner::new(&dot(0.3), linear, 0.4).expect("a turn");
        let centre = PixelPoint { x: 45.3, y: 44.8 };
        let unspoilt = scanned(&dot(0.3), linear, centre);
        let clean = refiner.refine(&unspoilt, centre, |_| 0.0).expect("settles");
        for (column, value) in [(41, 0.7), (42, 0.1), (47, 0.1), (49, 0.7), (48, 0.1)] {
            let mut grey = unspoilt.clone();
            let width = grey.width;
            grey.data.chunks_exact_mut(width).for_each(|row| row[column..column + 2].fill(value));
            crate::window::blur(&mut grey.data, width, width, 0.7);
            let found = refiner.refine(&grey, centre, |_| 0.0).expect("settles");
            let sigma_px = |r: &Refined| r.covariance_px2[0].max(r.covariance_px2[2]).sqrt();
            assert!(sigmas(&found, centre) < 3.5, "column {column}: {found:?}");
            assert!(sigma_px(&found) > 0.04 && sigma_px(&clean) < 0.04, "column {column}: {found:?}, {clean:?}");
        }
    }

    /// A line of two pixels has edges that a picture drawn place by place would move by an eighth of one. The blur is
    /// not quite the model's.
    #[test]
    fn thin_crosses_lie_where_they_are() {
        let model = Model::Drawn(MarkKind::Cross { arm_mm: 0.9, line_mm: 0.06, gap_mm: 0.0, lines_deg: 0.0 });
        // Pixels to a millimetre, and how far the scan is turned: lines of 1.5 to 2.4 pixels.
        for (k, (scale, turn)) in [(25.0, 0.004), (33.4, -0.01), (40.0, 0.02)].into_iter().enumerate() {
            let linear = [scale, turn * scale, turn * scale, -scale];
            let centre = PixelPoint { x: 45.3 + 0.23 * k as f64, y: 44.8 - 0.31 * k as f64 };
            let mut grey = scanned(&model, linear, centre);
            let (width, height) = (grey.width, grey.height);
            crate::window::blur(&mut grey.data, width, height, 0.7);
            let refiner = Refiner::new(&model, linear, 1.35).expect("a turn");
            let start = PixelPoint { x: centre.x + 0.4, y: centre.y - 0.3 };
            let found = refiner.refine(&grey, start, |_| 0.0).expect("settles");
            let off = (found.centre.x - centre.x).hypot(found.centre.y - centre.y);
            assert!(off < 0.08, "{scale} px/mm: {off} px");
        }
    }

    /// An arrow's head, its tip at `centre`, as a scanner sees it.
    fn arrow(side: usize, centre: [f64; 2], seed: u32) -> Vec<f32> {
        let inside = |x: f64, y: f64| {
            let (u, v) = (x - centre[0], y - centre[1]);
            f32::from(u8::from(v > -26.0 && v < 0.0 && u.abs() < -0.45 * v))
        };
        let sharp = (0..side * side).map(|n| {
            let part = |k: usize| (k as f64 + 0.5) / 6.0;
            let cover = |k: usize| inside((n % side) as f64 + part(k % 6), (n / side) as f64 + part(k / 6));
            (0..36).map(cover).sum::<f32>() / 36.0
        });
        let mut values: Vec<f32> = sharp.collect();
        crate::window::blur(&mut values, side, side, 0.6);
        let grain = |n: usize| ((n as u32 ^ seed).wrapping_mul(2_654_435_761) >> 24) as f32 / 255.0 - 0.5;
        values.iter().enumerate().map(|(n, v)| 0.05 + 0.8 * v + 0.04 * grain(n)).collect()
    }

    /// A mark that is not its own image, learned from one scan, lies in others where it is, not where its softest edges
    /// pull it.
    #[test]
    fn a_learned_mark_without_symmetry_lies_where_it_is() {
        const SIDE: usize = 81;
        let middle = 0.5 * SIDE as f64;
        let values = arrow(SIDE, [middle, middle], 1);
        let model = Model::Learned(crate::template::LearnedTemplate {
            pixel_um: 60.0,
            width: SIDE,
            height: SIDE,
            reference: [middle, middle],
            weights: vec![1.0; values.len()],
            values,
            marks: 1,
            reference_sigma_um: 0.0,
        });
        let scale = 1e3 / 60.0;
        let refiner = Refiner::new(&model, [scale, 0.0, 0.0, -scale], 2.0).expect("a turn");
        for (seed, [dx, dy]) in [[0.5, 0.5], [0.3, -0.2], [-0.1, 0.45]].into_iter().enumerate() {
            let data = arrow(SIDE, [middle + dx, middle + dy], 7 + seed as u32);
            let grey = Grey { width: SIDE, height: SIDE, data, origin: [0, 0], factor: 1 };
            let start = PixelPoint { x: middle + 0.4, y: middle - 0.4 };
            let found = refiner.refine(&grey, start, |_| 0.0).expect("settles");
            let off = (found.centre.x - middle - dx).hypot(found.centre.y - middle - dy);
            assert!(off < 0.08, "{off} px at {dx}, {dy}");
        }
    }

    /// Steps until one is small, from so far off, where each takes a share of the way that is left; and how far the
    /// furthest went.
    fn rounds(start: f64, share: f64) -> (usize, f64) {
        let (mut stride, mut at, mut furthest) = (Stride::default(), -start, -start);
        for round in 1..100 {
            let step = -at * share;
            at += stride.of([step, 0.0])[0];
            furthest = furthest.max(at);
            if step.abs() < STEP_PX {
                return (round, furthest);
            }
        }
        (100, furthest)
    }

    #[test]
    fn steps_that_shrink_go_to_their_end_and_none_beyond_it() {
        // Exact steps, some cut short: as many as without looking ahead.
        for (start, most) in [(0.3, 2), (1.75, 3), (4.75, 6), (6.0, 7)] {
            let (rounds, furthest) = rounds(start, 1.0);
            assert!(rounds <= most && furthest <= 1e-9, "{start}: {rounds} rounds, to {furthest}");
        }
        // Slow ones: in a few, and not beyond the end.
        for share in [0.25, 0.4, 0.6] {
            let (rounds, furthest) = rounds(1.0, share);
            assert!(rounds <= 5 && furthest <= 1e-9, "{share}: {rounds} rounds, to {furthest}");
        }
    }
}
