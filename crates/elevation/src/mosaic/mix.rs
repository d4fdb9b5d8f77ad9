//! Cells that several sources make together: the median, and means weighed by the distance from the edge.

use autoref_raster::window::Window;

use super::{Tile, Whole, Worker};
use crate::error::Result;

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

    pub(super) fn feather(&self, worker: &mut Worker, near: &[usize], window: Window, tile: &mut Tile) -> Result<()> {
        let area = window.area() as usize;
        let mut weights = vec![0.0; tile.values.len()];
        let mut sums = vec![0.0; tile.values.len()];
        for &number in near {
            let edges = self.sources[number].edge_distances(&self.grid, window);
            let values = self.read(worker, number, window)?;
            for (at, value) in values.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
                let weight = edges[at % area].max(1e-6);
                weights[at] += weight;
                sums[at] += weight * value;
            }
        }
        for (value, (sum, weight)) in tile.values.iter_mut().zip(sums.iter().zip(&weights)) {
            if *weight > 0.0 {
                *value = sum / weight;
            }
        }
        Ok(())
    }
}
