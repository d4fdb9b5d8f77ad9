//! Seams that run into each other: near a seam, a cell is the mean of the sources that win around it.
//!
//! A source's weight is the share of cells around that it wins, under a tent; it fades towards the source's own edge
//! and holes, so that nothing jumps there either. The shares are counts of cells, exact whatever the tiling.

use crate::error::Result;
use crate::window::Window;

use super::{Tile, Whole, Worker};

/// The widest seam, in cells: counts under wider tents do not fit into 32 bits.
pub const WIDEST_BLEND_PX: u64 = 500;

/// Half the side, without the middle, of the box that makes a tent when it is applied twice.
fn radius_px(blend_px: u64) -> u64 {
    blend_px.min(WIDEST_BLEND_PX).div_ceil(4)
}

/// Cells around a tile that have a say.
pub fn halo_px(blend_px: u64) -> u64 {
    2 * radius_px(blend_px)
}

/// Weight of a source at its very edge, where it may still be the only one.
const LEAST: f64 = 1e-6;

impl Whole<'_> {
    pub(super) fn blended(&self, worker: &mut Worker, window: Window) -> Result<Option<Tile>> {
        let (radius, halo) = (radius_px(self.job.blend_px), halo_px(self.job.blend_px));
        let (x, y) = (window.x.saturating_sub(halo), window.y.saturating_sub(halo));
        let right = (window.right() + halo).min(self.grid.width);
        let bottom = (window.bottom() + halo).min(self.grid.height);
        let around = Window::new(x, y, right - x, bottom - y);
        let Some(whole) = self.chosen(worker, around)? else { return Ok(None) };
        let (width, area) = (around.width as usize, window.area() as usize);
        let inner: Vec<usize> = (window.y - y..window.bottom() - y)
            .flat_map(|row| (window.x - x..window.right() - x).map(move |column| (row, column)))
            .map(|(row, column)| row as usize * width + column as usize)
            .collect();
        let index: Vec<u32> = inner.iter().map(|&cell| whole.index[cell]).collect();
        let bands = whole.values.len() / whole.index.len();
        let take = |plane: &[f64]| inner.iter().map(|&cell| plane[cell]).collect::<Vec<f64>>();
        let mut numbers = whole.index.clone();
        numbers.sort_unstable();
        numbers.dedup();
        numbers.retain(|&number| number > 0);
        if numbers.len() < 2 {
            let values = whole.values.chunks_exact(whole.index.len()).flat_map(take).collect();
            return Ok((index.iter().any(|&n| n > 0)).then_some(Tile { values, index }));
        }
        let deciding = self.sources[0].deciding_bands();
        let (mut sums, mut weights) = (vec![0.0; area * bands], vec![0.0; area]);
        for number in numbers {
            let values = self.read(worker, number as usize - 1, around)?;
            let cells = whole.index.len();
            let there: Vec<bool> = (0..cells).map(|cell| super::holds(&values, cells, cell, &deciding)).collect();
            let size = (width, around.height as usize);
            let won = tent(whole.index.iter().map(|&n| u32::from(n == number)).collect(), size, radius as usize);
            let known = tent(there.iter().map(|there| u32::from(*there)).collect(), size, radius as usize);
            let all = ((2 * radius + 1) as f64).powi(4);
            for (at, &cell) in inner.iter().enumerate() {
                if won[cell] == 0 || !there[cell] {
                    continue;
                }
                let weight = f64::from(won[cell]) * (2.0 * f64::from(known[cell]) / all - 1.0).max(LEAST);
                weights[at] += weight;
                for band in 0..bands {
                    sums[band * area + at] += weight * values[band * cells + cell];
                }
            }
        }
        let mut values: Vec<f64> = whole.values.chunks_exact(whole.index.len()).flat_map(take).collect();
        for (at, value) in values.iter_mut().enumerate() {
            let blended = sums[at] / weights[at % area];
            if index[at % area] > 0 && blended.is_finite() {
                *value = blended;
            }
        }
        Ok(Some(Tile { values, index }))
    }
}

/// Sums under a tent: two boxes of 2·radius + 1 cells after each other; nothing lies outside.
fn tent(mut values: Vec<u32>, (width, height): (usize, usize), radius: usize) -> Vec<u32> {
    let mut line = Vec::new();
    for _ in 0..2 {
        for row in values.chunks_exact_mut(width) {
            line.clear();
            line.extend_from_slice(row);
            running(&line, radius, |at, sum| row[at] = sum);
        }
        for column in 0..width {
            line.clear();
            line.extend((0..height).map(|row| values[row * width + column]));
            running(&line, radius, |at, sum| values[at * width + column] = sum);
        }
    }
    values
}

fn running(line: &[u32], radius: usize, mut put: impl FnMut(usize, u32)) {
    let mut sum: u32 = line.iter().take(radius).sum();
    for at in 0..line.len() {
        sum += line.get(at + radius).copied().unwrap_or(0);
        if at > radius {
            sum -= line[at - radius - 1];
        }
        put(at, sum);
    }
}

#[cfg(test)]
mod tests {
    use super::tent;

    #[test]
    fn a_single_cell_becomes_a_tent() {
        let mut values = vec![0; 81];
        values[40] = 1;
        let found = tent(values, (9, 9), 1);
        assert_eq!((found[40], found[41], found[42], found[43], found[31 + 9 + 9]), (9, 6, 3, 0, 6));
        assert_eq!(found.iter().sum::<u32>(), 81);
    }
}
