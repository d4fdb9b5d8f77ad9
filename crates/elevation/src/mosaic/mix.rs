//! Cells that several sources make together: the median, and means weighed by the distance from edges and voids.

use autoref_raster::window::Window;

use super::{Tile, Whole, Worker, distance};
use crate::error::Result;

/// Cells from a void over which the weights of `feather` grow.
pub(super) const REACH_PX: u64 = 64;
/// Weight of a source at its very edge, where it may still be the only one; in units of the map.
const LEAST: f64 = 1e-6;

impl Whole<'_> {
    pub(super) fn median(&self, worker: &mut Worker, near: &[usize], window: Window, tile: &mut Tile) -> Result<()> {
        // A row at a time where many sources meet, so that not all of them are held whole.
        let rows = (window.height / (near.len() as u64).div_ceil(8)).max(1);
        let mut y = window.y;
        while y < window.bottom() {
            let part = Window::new(window.x, y, window.width, rows.min(window.bottom() - y));
            let area = part.area() as usize;
            let all: Vec<Vec<f64>> =
                near.iter().map(|&number| self.read(worker, number, part)).collect::<Result<_>>()?;
            let mut values = Vec::with_capacity(all.len());
            for band in 0..tile.values.len() / window.area() as usize {
                for cell in 0..area {
                    values.clear();
                    values.extend(all.iter().map(|v| v[band * area + cell]).filter(|v| !v.is_nan()));
                    values.sort_unstable_by(f64::total_cmp);
                    let n = values.len();
                    if n > 0 {
                        let target =
                            band * window.area() as usize + (y - window.y) as usize * window.width as usize + cell;
                        tile.values[target] = (values[(n - 1) / 2] + values[n / 2]) / 2.0;
                    }
                }
            }
            y += rows;
        }
        Ok(())
    }

    /// Weights grow from the edge of a source's grid over the whole of it, and from its voids over [`REACH_PX`] cells.
    pub(super) fn feather(&self, worker: &mut Worker, near: &[usize], window: Window, tile: &mut Tile) -> Result<()> {
        let around = self.around(window, REACH_PX);
        let (cells, area) = (around.area() as usize, window.area() as usize);
        let inner = inner(window, around);
        let mut weights = vec![0.0; tile.values.len()];
        let mut sums = vec![0.0; tile.values.len()];
        for &number in near {
            let source = &self.sources[number];
            // What lies beyond the edge is no void: the distance from the edge tells of it.
            let beyond: Vec<bool> = source.edge_distances(&self.grid, around).iter().map(|edge| *edge < 0.0).collect();
            let edges = source.edge_distances(&self.grid, window);
            let values = self.read(worker, number, around)?;
            let (mut seen, mut distances) = (Vec::new(), Vec::new());
            for (band, plane) in values.chunks_exact(cells).enumerate() {
                let there: Vec<bool> = plane.iter().zip(&beyond).map(|(v, beyond)| !v.is_nan() || *beyond).collect();
                if there != seen {
                    distances = distance::from_voids(&there, around.width as usize, REACH_PX as u16);
                    seen = there;
                }
                for (at, &cell) in inner.iter().enumerate().filter(|(_, cell)| !plane[**cell].is_nan()) {
                    let weight = edges[at].max(LEAST) * f64::from(distances[cell]) / REACH_PX as f64;
                    weights[band * area + at] += weight;
                    sums[band * area + at] += weight * plane[cell];
                }
            }
        }
        for (value, (sum, weight)) in tile.values.iter_mut().zip(sums.iter().zip(&weights)) {
            if *weight > 0.0 {
                *value = sum / weight;
            }
        }
        Ok(())
    }

    /// A window with so many cells around it, as far as the mosaic goes.
    pub(super) fn around(&self, window: Window, halo: u64) -> Window {
        let (x, y) = (window.x.saturating_sub(halo), window.y.saturating_sub(halo));
        let right = (window.right() + halo).min(self.grid.width);
        let bottom = (window.bottom() + halo).min(self.grid.height);
        Window::new(x, y, right - x, bottom - y)
    }
}

/// Where the cells of a window are in a wider one.
pub(super) fn inner(window: Window, around: Window) -> Vec<usize> {
    (window.y - around.y..window.bottom() - around.y)
        .flat_map(|row| (window.x - around.x..window.right() - around.x).map(move |column| (row, column)))
        .map(|(row, column)| (row * around.width + column) as usize)
        .collect()
}
