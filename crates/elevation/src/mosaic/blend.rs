//! Seams that run into each other: near a seam, a cell is the mean of the sources that win around it.
//!
//! A source's weight is the share of cells around that it wins, under a tent; it fades towards the source's own edge
//! and holes, by the distance from them, so that nothing jumps there either, and not where a source is narrower than
//! the seam. Shares and squares of distances are whole numbers, exact whatever the tiling.

use crate::error::Result;
use crate::window::Window;

use super::mix::inner;
use super::{Tile, Whole, Worker, distance};

/// The widest seam, in cells: counts under wider tents do not fit into 32 bits.
pub const WIDEST_BLEND_PX: u64 = 500;

/// Side of the box that makes a tent when it is applied twice: a seam of two cells mixes the two beside it. It lies
/// between cells, so an odd number is as the even one above.
fn side_px(blend_px: u64) -> u64 {
    blend_px.min(WIDEST_BLEND_PX).div_ceil(2) + 1
}

/// Cells around a tile that have a say.
pub fn halo_px(blend_px: u64) -> u64 {
    if blend_px == 0 { 0 } else { side_px(blend_px) - 1 }
}

impl Whole<'_> {
    pub(super) fn blended(&self, worker: &mut Worker, window: Window) -> Result<Option<Tile>> {
        let side = side_px(self.job.blend_px);
        let around = self.around(window, halo_px(self.job.blend_px));
        let Some(whole) = self.chosen(worker, around)? else { return Ok(None) };
        let (width, area) = (around.width as usize, window.area() as usize);
        let inner = inner(window, around);
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
        let (mut sums, mut weights, mut mixed) = (vec![0.0; area * bands], vec![0.0; area], vec![0u32; area]);
        for number in numbers {
            let values = self.read(worker, number as usize - 1, around)?;
            let cells = whole.index.len();
            let there: Vec<bool> = (0..cells).map(|cell| super::holds(&values, cells, cell, &deciding)).collect();
            let size = (width, around.height as usize);
            let won = tent(whole.index.iter().map(|&n| u32::from(n == number)).collect(), size, side as usize);
            let depth = distance::from_voids(&there, width, side as u16);
            for (at, &cell) in inner.iter().enumerate() {
                if won[cell] == 0 || !there[cell] {
                    continue;
                }
                let weight = f64::from(won[cell]) * f64::from(depth[cell]);
                weights[at] += weight;
                mixed[at] += 1;
                for band in 0..bands {
                    sums[band * area + at] += weight * values[band * cells + cell];
                }
            }
        }
        let mut values: Vec<f64> = whole.values.chunks_exact(whole.index.len()).flat_map(take).collect();
        for (at, value) in values.iter_mut().enumerate() {
            let blended = sums[at] / weights[at % area];
            // What one source gives alone keeps its bits, however many others the tile meets.
            if index[at % area] > 0 && mixed[at % area] > 1 && blended.is_finite() {
                *value = blended;
            }
        }
        Ok(Some(Tile { values, index }))
    }
}

/// Sums under a tent: two boxes of so many cells after each other, which lean to either side where the number is even;
/// nothing lies outside.
fn tent(mut values: Vec<u32>, (width, height): (usize, usize), side: usize) -> Vec<u32> {
    let mut line = Vec::new();
    for ahead in [side / 2, (side - 1) / 2] {
        for row in values.chunks_exact_mut(width) {
            line.clear();
            line.extend_from_slice(row);
            running(&line, (side, ahead), |at, sum| row[at] = sum);
        }
        for column in 0..width {
            line.clear();
            line.extend((0..height).map(|row| values[row * width + column]));
            running(&line, (side, ahead), |at, sum| values[at * width + column] = sum);
        }
    }
    values
}

/// Sums of `side` numbers, of which so many lie ahead.
fn running(line: &[u32], (side, ahead): (usize, usize), mut put: impl FnMut(usize, u32)) {
    let mut sum: u32 = line.iter().take(ahead).sum();
    for at in 0..line.len() {
        sum += line.get(at + ahead).copied().unwrap_or(0);
        if at + ahead >= side {
            sum -= line[at + ahead - side];
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
        let found = tent(values, (9, 9), 3);
        assert_eq!((found[40], found[41], found[42], found[43], found[31 + 9 + 9]), (9, 6, 3, 0, 6));
        assert_eq!(found.iter().sum::<u32>(), 81);
        let mut values = vec![0; 81];
        values[40] = 1;
        let found = tent(values, (9, 9), 2);
        assert_eq!((found[39], found[40], found[41], found[42], found[31]), (2, 4, 2, 0, 2));
    }
}
