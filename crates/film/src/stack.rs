//! Windows about marks, cut out of the scans of a roll on one grid and stacked.

use super::interior::Pose;
use super::template::LearnedTemplate;
use super::types::Camera;
use super::window::{Grey, around, read_grey};
use autoref_raster::RasterSource;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::keys;

/// Spread of brightness between frames, of the window's own range, at which a value counts half.
const SPREAD: f64 = 0.12;
/// Values along the longer side of a template, at most.
const MOST_VALUES: f64 = 2048.0;

/// The values of a template: one grid for all frames of a roll, so that they can be averaged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    pub step_mm: f64,
    pub width: usize,
    pub height: usize,
}

impl Grid {
    /// One value per pixel of `pose`, at most [`MOST_VALUES`] along a side.
    pub fn new(pose: &Pose, window_mm: [f64; 2]) -> Grid {
        let step_mm = (1.0 / pose.px_per_mm()).max(window_mm[0].max(window_mm[1]) / MOST_VALUES);
        let [width, height] = window_mm.map(|mm| ((mm / step_mm).round() as usize).max(8));
        Grid { step_mm, width, height }
    }
}

/// The mark's surroundings as it stands at the lower edge, dark 0, bright 1. `None` when they leave the scan.
pub(super) fn cut(
    scan: &dyn RasterSource,
    camera: &Camera,
    pose: &Pose,
    k: usize,
    at: PixelPoint,
    grid: &Grid,
) -> Result<Option<Vec<f32>>> {
    let Grid { step_mm, width, height } = *grid;
    let linear = pose.shape_linear(camera.turns_deg()[k]);
    let half_px = 0.5 * (width as f64).hypot(height as f64) * step_mm * pose.px_per_mm() + 4.0;
    let Some(window) = around(at, half_px, half_px, &scan.info().bounds()) else { return Ok(None) };
    let grey = read_grey(scan, window, 1)?;
    let mut values = Vec::with_capacity(width * height);
    for j in 0..height {
        for i in 0..width {
            let u = (i as f64 + 0.5 - 0.5 * width as f64) * step_mm;
            let v = -(j as f64 + 0.5 - 0.5 * height as f64) * step_mm;
            let p = PixelPoint { x: at.x + linear[0] * u + linear[1] * v, y: at.y + linear[2] * u + linear[3] * v };
            match cubic(&grey, p) {
                Some(value) => values.push(value),
                None => return Ok(None),
            }
        }
    }
    even(&mut values);
    Ok(Some(values))
}

/// How many times the range of most values that of all may be before the mark is what few values show: a thin line, a
/// dot.
const THIN: f32 = 2.0;

/// Dark 0, bright 1: by what a twentieth of the values lies beyond, or, where a mark covers less of the window than
/// that, by what a five-hundredth does; else grain fills the range and a thin mark is cut off at its top.
pub(super) fn even(values: &mut [f32]) {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let range = |part: usize| (sorted[part], sorted[sorted.len() - 1 - part]);
    let (most, all) = (range(sorted.len() / 20), range((sorted.len() / 500).min(sorted.len() / 20)));
    let (low, high) = if all.1 - all.0 > THIN * (most.1 - most.0) { all } else { most };
    let range = (high - low).max(1e-4);
    values.iter_mut().for_each(|v| *v = ((*v - low) / range).clamp(-0.5, 1.5));
}

/// By Keys' cubic convolution, which keeps edges where straight lines between values would soften them.
fn cubic(grey: &Grey, p: PixelPoint) -> Option<f32> {
    let [x, y] = grey.from_scan(p).map(|v| v - 0.5);
    if x < 0.0 || y < 0.0 || x + 1.0 >= grey.width as f64 || y + 1.0 >= grey.height as f64 {
        return None;
    }
    Some(keys::cubic([grey.width, grey.height], [x, y], |i, j| grey.at(i, j)))
}

/// Windows of one mark, summed: memory does not depend on their number.
#[derive(Clone)]
pub(super) struct Stack {
    pub windows: usize,
    sum: Vec<f64>,
    square: Vec<f64>,
}

impl Stack {
    /// Of one window, values row by row.
    pub fn of(window: &[f32]) -> Stack {
        let mut stack = Stack { windows: 0, sum: vec![0.0; window.len()], square: vec![0.0; window.len()] };
        stack.add(window);
        stack
    }

    /// One more window of the same size.
    pub fn add(&mut self, window: &[f32]) {
        self.windows += 1;
        for ((sum, square), v) in self.sum.iter_mut().zip(&mut self.square).zip(window) {
            *sum += f64::from(*v);
            *square += f64::from(*v).powi(2);
        }
    }

    /// Their mean on the grid that they lie on, with how far they differ.
    pub fn average(&self, grid: &Grid) -> LearnedTemplate {
        let n = self.windows as f64;
        let mean = |k: usize| self.sum[k] / n;
        let variance = |k: usize| (self.square[k] / n - mean(k).powi(2)).max(0.0);
        LearnedTemplate {
            pixel_um: 1e3 * grid.step_mm,
            width: grid.width,
            height: grid.height,
            reference: [0.5 * grid.width as f64, 0.5 * grid.height as f64],
            values: (0..self.sum.len()).map(|k| mean(k) as f32).collect(),
            weights: (0..self.sum.len()).map(|k| (1.0 / (1.0 + variance(k) / SPREAD.powi(2))) as f32).collect(),
            marks: self.windows,
            reference_sigma_um: 0.0,
        }
    }
}
