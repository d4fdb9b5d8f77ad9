//! Light that falls off towards the corners: a smooth surface, fitted robustly, by which the values are divided.
//!
//! The 2017 Svalbard thesis (10.1.1) blurs the image with ever smaller boxes and adds the result's complement; borders
//! and text show in that mask, and broad dark ground is brightened like shadow. Here the image is reduced to cells of
//! the film, marks and boxes left out, and a surface with few coefficients is fitted to the differences between the
//! logarithms of cells near each other with Tukey's weights (A. E. Beaton, J. W. Tukey, The fitting of power series,
//! 1974). Neighbouring ground is alike, ground far apart is not, so differences say more of light than the cells
//! themselves, and a shore is one difference among many (after the gradients of Y. Zheng, J. Yu, S. B. Kang, S. Lin, C.
//! Kambhamettu, Single-image vignetting correction using radial gradient symmetry, 2008). Of one frame only what grows
//! with the square of the distance from the middle is fitted, since a slope may be ground; over a roll the ground
//! averages out, and the surface may lean.

use nalgebra::{DMatrix, DVector};

use crate::types::{Camera, InteriorOrientation};
use crate::window::read_grey_valid;
use autoref_raster::RasterSource;
use autoref_raster::error::Result;
use autoref_raster::ranks::{median, upper_median};
use autoref_raster::window::Window;

/// Cells along a side of the image.
pub const CELLS: usize = 48;
/// The darkest share of the scan that says where black is.
const BLACK_SHARE: f64 = 0.002;
/// Cells whose logarithms are compared lie this many cells apart, in a row or a column.
const APART: usize = 2;
/// Light is never divided by less than this: what is darker has no grey steps left to stretch.
const LEAST: f64 = 0.15;

/// Medians of cells of the film, row by row; `None` where a cell is masked, outside the scan, black or white
/// throughout.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// What no light gives, of white.
    pub black: f64,
    /// Above black, of white.
    pub values: Vec<Option<f64>>,
}

/// Light over the film, relative: 1 where a value stays as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Lighting {
    pub black: f64,
    /// Logarithm of the light: the first of the [`terms`] of the place.
    coefficients: Vec<f64>,
    level: f64,
}

/// How many [`terms`] one frame says, and a roll.
const OF_FRAME: usize = 1;
const OF_ROLL: usize = 6;

/// r², then r⁴, x, y, x², xy, with (x, y) from −1 to 1 over the bounding box of the marks and r² ½ at the middle of a
/// side. (y² is r² less x².)
fn terms([x, y]: [f64; 2]) -> [f64; OF_ROLL] {
    let r2 = 0.5 * (x * x + y * y);
    [r2, r2 * r2, x, y, x * x, x * y]
}

/// Reads the scan once, decimated, into cells. `unit` maps film millimetres (y down) to −1 to 1; `masked` says what to
/// leave out.
///
/// # Errors
/// Those of reading.
pub fn cells(
    source: &dyn RasterSource,
    camera: &Camera,
    interior: &InteriorOrientation,
    unit: impl Fn([f64; 2]) -> [f64; 2],
    masked: impl Fn([f64; 2]) -> bool,
) -> Result<Cells> {
    let info = source.info();
    let factor = (info.width.max(info.height) / 512).max(1);
    let mut sorted: Vec<f32> = vec![];
    let mut all: Vec<Vec<f32>> = vec![vec![]; CELLS * CELLS];
    let rows = 64 * factor;
    for top in (0..info.height).step_by(rows as usize) {
        let band = Window::new(0, top, info.width, rows.min(info.height - top));
        let (grey, holds) = read_grey_valid(source, band, factor)?;
        source.release(band);
        let holds = |i: &usize| holds.as_ref().is_none_or(|holds| holds[*i]);
        for (i, v) in grey.data.iter().enumerate().filter(|(i, _)| holds(i)) {
            sorted.push(*v);
            let at = grey.to_scan((i % grey.width) as f64 + 0.5, (i / grey.width) as f64 + 0.5);
            let Some([x, y]) = interior.to_mm(at) else { continue };
            let film = [x, camera.y_sign() * y];
            let place = unit(film);
            if place.iter().all(|v| v.abs() < 1.0) && !masked(film) {
                let [cx, cy] = place.map(|v| (((v + 1.0) * 0.5 * CELLS as f64) as usize).min(CELLS - 1));
                all[cy * CELLS + cx].push(*v);
            }
        }
    }
    sorted.sort_by(f32::total_cmp);
    let black = sorted.get((BLACK_SHARE * sorted.len() as f64) as usize).copied().unwrap_or(0.0);
    let median = |mut cell: Vec<f32>| {
        let middle = upper_median(&mut cell)?;
        // Without grey steps nothing can be said of light.
        (middle > black + 0.004 && middle < 0.985).then(|| f64::from(middle - black))
    };
    Ok(Cells { black: f64::from(black), values: all.into_iter().map(median).collect() })
}

/// The light of one frame: of its own cells. `None` with too few of them.
pub fn of_frame(cells: &Cells) -> Option<Lighting> {
    fit(std::slice::from_ref(cells), OF_FRAME, cells.black)
}

/// The light of a roll: of the median of every difference over the frames. Differences that fewer than a third of the
/// frames show are left out; `None` below three frames, and with too few cells.
pub fn of_roll(frames: &[Cells]) -> Option<Lighting> {
    if frames.len() < 3 { None } else { fit(frames, OF_ROLL, 0.0) }
}

/// Where the middle of a cell lies, −1 to 1.
fn cell_place(k: usize) -> [f64; 2] {
    [k % CELLS, k / CELLS].map(|i| (i as f64 + 0.5) * 2.0 / CELLS as f64 - 1.0)
}

fn logarithm(value: Option<f64>) -> Option<f64> {
    value.filter(|v| *v > 0.0).map(f64::ln)
}

/// Pairs of cells and how much brighter the second is, in logarithms.
fn differences(frames: &[Cells]) -> Vec<(usize, usize, f64)> {
    let pairs = (0..CELLS * CELLS).flat_map(|k| {
        let right = (k % CELLS + APART < CELLS).then_some(k + APART);
        let below = (k / CELLS + APART < CELLS).then_some(k + APART * CELLS);
        [right, below].into_iter().flatten().map(move |other| (k, other))
    });
    pairs
        .filter_map(|(a, b)| {
            let of = |f: &Cells| Some(logarithm(f.values[b])? - logarithm(f.values[a])?);
            let seen: Vec<f64> = frames.iter().filter_map(of).collect();
            (!seen.is_empty() && 3 * seen.len() >= frames.len()).then(|| (a, b, median(seen)))
        })
        .collect()
}

fn fit(frames: &[Cells], count: usize, black: f64) -> Option<Lighting> {
    let known = differences(frames);
    if known.len() < 40 * count {
        return None;
    }
    let term = |k: usize, c: usize| terms(cell_place(k))[c];
    let design = DMatrix::from_fn(known.len(), count, |i, c| term(known[i].1, c) - term(known[i].0, c));
    let right = DVector::from_fn(known.len(), |i, _| known[i].2);
    let mut weights = vec![1.0; known.len()];
    let mut solution = DVector::zeros(count);
    for _ in 0..30 {
        let weighted = DMatrix::from_fn(known.len(), count, |i, c| weights[i] * design[(i, c)]);
        let next = (weighted.transpose() * &design).cholesky()?.solve(&(weighted.transpose() * &right));
        let residuals = &right - &design * &next;
        let scale = 1.4826 * median(residuals.iter().map(|r| r.abs()).collect());
        for (w, r) in weights.iter_mut().zip(residuals.iter()) {
            let t = r / (4.685 * scale).max(1e-6);
            *w = if t.abs() < 1.0 { (1.0 - t * t).powi(2) } else { 0.0 };
        }
        let step = (&next - &solution).norm();
        solution = next;
        if step < 1e-9 {
            break;
        }
    }
    let coefficients: Vec<f64> = solution.iter().copied().collect();
    let mut lighting = Lighting { black, coefficients, level: 0.0 };
    let shown = |k: &usize| 3 * frames.iter().filter(|f| logarithm(f.values[*k]).is_some()).count() >= frames.len();
    lighting.level = median((0..CELLS * CELLS).filter(shown).map(|k| lighting.logarithm(cell_place(k))).collect());
    Some(lighting)
}

impl Lighting {
    fn logarithm(&self, place: [f64; 2]) -> f64 {
        self.coefficients.iter().zip(terms(place)).map(|(c, t)| c * t).sum()
    }

    /// Light at a place, −1 to 1.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        (self.logarithm(place) - self.level).exp().clamp(LEAST, 1.0 / LEAST)
    }

    /// The same light with another frame's black.
    pub fn with_black(&self, black: f64) -> Lighting {
        Lighting { black, ..self.clone() }
    }

    /// A value of white as it would be in even light.
    pub fn corrected(&self, value: f32, place: [f64; 2]) -> f32 {
        let black = self.black as f32;
        black + (value - black) / self.at(place) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_synth::rng::Rng;

    #[test]
    fn a_known_surface_is_found_under_dark_ground() {
        // A fifth of the film is sea, four times darker; light falls by half to the corners, by the law that is fitted
        // and by another.
        for (exponential, within) in [(true, 0.02), (false, 0.04)] {
            let light = |[x, y]: [f64; 2]| {
                let r2 = 0.5 * (x * x + y * y);
                if exponential { (-0.69 * r2).exp() } else { 1.0 - 0.5 * r2 }
            };
            let mut random = Rng::new(3, 0, 0);
            let values: Vec<Option<f64>> = (0..CELLS * CELLS)
                .map(|k| {
                    let place = cell_place(k);
                    let ground = if place[0] + 0.4 * place[1] > 0.75 { 0.1 } else { random.range(0.4, 0.45) };
                    (k % 11 != 0).then_some(ground * light(place))
                })
                .collect();
            let frame = Cells { black: 0.0, values };
            // One frame of five leans, and half of the film is seen by it alone.
            let mut other = frame.clone();
            other.values.iter_mut().enumerate().for_each(|(k, v)| *v = v.map(|v| v * (2.0 * cell_place(k)[0]).exp()));
            let mut roll = vec![frame.clone(); 4];
            roll.iter_mut().for_each(|f| (0..CELLS * CELLS / 2).for_each(|k| f.values[k] = None));
            roll.insert(0, other);
            for (found, within) in [(of_frame(&frame), within), (of_roll(&roll), within + 0.04)] {
                let found = found.expect("enough cells");
                for place in [[0.0, 0.0], [0.9, 0.9], [-0.9, 0.5], [0.0, -0.95]] {
                    let relative = found.at(place) / found.at([0.0, 0.0]);
                    assert!((relative - light(place)).abs() < within, "{place:?}: {relative} {}", light(place));
                }
            }
        }
    }

    #[test]
    fn too_few_cells_and_too_few_frames_say_nothing() {
        let empty = Cells { black: 0.0, values: vec![None; CELLS * CELLS] };
        assert_eq!(of_frame(&empty), None);
        assert_eq!(of_roll(&[empty.clone(), empty]), None);
    }
}
