//! Light that falls off towards the corners: a smooth surface, fitted robustly, by which the values are divided.
//!
//! The 2017 Svalbard thesis (10.1.1) blurs the image with ever smaller boxes and adds the result's complement; borders and
//! text show in that mask, and broad dark ground is brightened like shadow. Here the image is reduced to cells of the film,
//! marks and boxes left out, and a surface with few coefficients is fitted to the logarithms of the cells with Tukey's
//! weights (A. E. Beaton, J. W. Tukey, The fitting of power series, 1974). Of one frame only what depends on the distance from
//! the middle is fitted, since a slope may be ground; over a roll the ground averages out, and the surface may lean.

use nalgebra::{DMatrix, DVector};

use crate::error::Result;
use crate::film::types::{Camera, InnerOrientation};
use crate::film::window::read_grey;
use crate::raster::RasterSource;
use crate::window::Window;

/// Cells along a side of the image.
pub const CELLS: usize = 48;
/// The darkest share of the scan that says where black is.
const BLACK_SHARE: f64 = 0.002;
/// Light is never divided by less than this: what is darker has no grey steps left to stretch.
const LEAST: f64 = 0.15;

/// Medians of cells of the film, row by row; `None` where a cell is masked, outside the scan, black or white throughout.
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
    /// Logarithm of the light: [`terms`] of the place.
    coefficients: Vec<f64>,
    level: f64,
}

/// 1, r², r⁴, then x, y, x², xy, with (x, y) from −1 to 1 over the bounding box of the marks and r² ½ at the middle of a side.
/// (y² is r² less x².)
fn terms([x, y]: [f64; 2]) -> [f64; 7] {
    let r2 = 0.5 * (x * x + y * y);
    [1.0, r2, r2 * r2, x, y, x * x, x * y]
}

/// Reads the scan once, decimated, into cells. `unit` maps film millimetres (y down) to −1 to 1; `masked` says what to leave
/// out.
///
/// # Errors
/// Those of reading.
pub fn cells(
    source: &dyn RasterSource,
    camera: &Camera,
    inner: &InnerOrientation,
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
        let grey = read_grey(source, band, factor)?;
        source.release(band);
        sorted.extend_from_slice(&grey.data);
        for (i, v) in grey.data.iter().enumerate() {
            let at = grey.to_scan((i % grey.width) as f64 + 0.5, (i / grey.width) as f64 + 0.5);
            let Some([x, y]) = inner.to_mm(at) else { continue };
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
        cell.sort_by(f32::total_cmp);
        let middle = *cell.get(cell.len() / 2)?;
        // Without grey steps nothing can be said of light.
        (middle > black + 0.004 && middle < 0.985).then(|| f64::from(middle - black))
    };
    Ok(Cells { black: f64::from(black), values: all.into_iter().map(median).collect() })
}

/// The light of one frame: of its own cells.
pub fn of_frame(cells: &Cells) -> Option<Lighting> {
    fit(&cells.values, 3, cells.black)
}

/// The light of a roll: every frame's cells relative to their median, then the median over the frames. Cells that fewer than a
/// third of the frames show are left out; `None` below three frames.
pub fn of_roll(frames: &[Cells]) -> Option<Lighting> {
    if frames.len() < 3 {
        return None;
    }
    let relative: Vec<Vec<Option<f64>>> = frames
        .iter()
        .filter_map(|f| {
            let middle = median(f.values.iter().flatten().copied().collect())?;
            Some(f.values.iter().map(|v| v.map(|v| v / middle)).collect())
        })
        .collect();
    let over = |k: usize| {
        let seen: Vec<f64> = relative.iter().filter_map(|f| f[k]).collect();
        (3 * seen.len() >= frames.len()).then(|| median(seen)).flatten()
    };
    let values: Vec<Option<f64>> = (0..CELLS * CELLS).map(over).collect();
    fit(&values, 7, 0.0)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Where the middle of a cell lies, −1 to 1.
fn cell_place(k: usize) -> [f64; 2] {
    [k % CELLS, k / CELLS].map(|i| (i as f64 + 0.5) * 2.0 / CELLS as f64 - 1.0)
}

fn fit(values: &[Option<f64>], count: usize, black: f64) -> Option<Lighting> {
    let known: Vec<([f64; 7], f64)> = values
        .iter()
        .enumerate()
        .filter_map(|(k, v)| Some((terms(cell_place(k)), v.filter(|v| *v > 0.0)?.ln())))
        .collect();
    if known.len() < 20 * count {
        return None;
    }
    let design = DMatrix::from_fn(known.len(), count, |i, c| known[i].0[c]);
    let right = DVector::from_fn(known.len(), |i, _| known[i].1);
    let mut weights = vec![1.0; known.len()];
    let mut solution = DVector::zeros(count);
    for _ in 0..30 {
        let weighted = DMatrix::from_fn(known.len(), count, |i, c| weights[i] * design[(i, c)]);
        let next = (weighted.transpose() * &design).cholesky()?.solve(&(weighted.transpose() * &right));
        let residuals = &right - &design * &next;
        let scale = 1.4826 * median(residuals.iter().map(|r| r.abs()).collect())?;
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
    lighting.level = median(known.iter().map(|(t, _)| lighting.logarithm(t)).collect())?;
    Some(lighting)
}

impl Lighting {
    fn logarithm(&self, terms: &[f64; 7]) -> f64 {
        self.coefficients.iter().zip(terms).map(|(c, t)| c * t).sum()
    }

    /// Light at a place, −1 to 1.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        (self.logarithm(&terms(place)) - self.level).exp().clamp(LEAST, 1.0 / LEAST)
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

    #[test]
    fn a_known_surface_is_found_under_dark_ground() {
        // A fifth of the film is sea, four times darker; light falls by half to the corners.
        let light = |[x, y]: [f64; 2]| 1.0 - 0.25 * (x * x + y * y);
        let values: Vec<Option<f64>> = (0..CELLS * CELLS)
            .map(|k| {
                let place = cell_place(k);
                let ground =
                    if place[0] + 0.4 * place[1] > 0.75 { 0.1 } else { 0.4 + 0.05 * ((k * 7 % 13) as f64 / 13.0) };
                (k % 11 != 0).then_some(ground * light(place))
            })
            .collect();
        let found = of_frame(&Cells { black: 0.0, values }).expect("enough cells");
        for place in [[0.0, 0.0], [0.9, 0.9], [-0.9, 0.5], [0.0, -0.95]] {
            let relative = found.at(place) / found.at([0.0, 0.0]);
            assert!((relative - light(place)).abs() < 0.03, "{place:?}: {relative} {}", light(place));
        }
    }

    #[test]
    fn too_few_cells_and_too_few_frames_say_nothing() {
        let empty = Cells { black: 0.0, values: vec![None; CELLS * CELLS] };
        assert_eq!(of_frame(&empty), None);
        assert_eq!(of_roll(&[empty.clone(), empty]), None);
    }
}
