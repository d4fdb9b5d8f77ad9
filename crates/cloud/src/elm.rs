//! Extended local minimum: the lowest points of a cell that a gap separates from the rest (Chen, Devereux, Gao &
//! Amable, *Upward-fusion urban DTM generating method using airborne Lidar data*, 2012).

use std::collections::HashMap;

use crate::error::{Error, Result};
use crate::outliers::NOISE;
use crate::tiles::Tiles;

/// A cell with its entry of the table, and a height of it: a list of heights grows by doubling.
const CELL_BYTES: u64 = 96;
const HEIGHT_BYTES: u64 = 16;

/// The lowest heights of a cell up to the first two that lie close together: what comes higher can change nothing.
#[derive(Default)]
struct Lowest(Vec<f64>);

impl Lowest {
    fn add(&mut self, z: f64, gap: f64) {
        let at = self.0.partition_point(|&other| other < z);
        let closed = self.0.len() >= 2 && self.0[self.0.len() - 1] - self.0[self.0.len() - 2] < gap;
        if at == self.0.len() && closed {
            return;
        }
        self.0.insert(at, z);
        // Only the last two may have been close before.
        let is_close = |lower: usize| self.0.get(lower + 1).is_some_and(|upper| upper - self.0[lower] < gap);
        match (at > 0 && is_close(at.saturating_sub(1)), is_close(at)) {
            (true, _) => self.0.truncate(at + 1),
            (false, true) => self.0.truncate(at + 2),
            (false, false) => {}
        }
    }

    /// Points below this height are noise. The highest point of a cell never is.
    fn floor(&self, gap: f64) -> f64 {
        let close = self.0.windows(2).find(|pair| pair[1] - pair[0] < gap);
        close.map_or(self.0[self.0.len() - 1], |pair| pair[0])
    }
}

/// Classifies low points as noise: in square cells of `cell_m`, counted from the cloud's least x and y, a point that
/// the next higher one of its cell exceeds by `gap_m` or more, and so on upwards until two lie closer.
///
/// # Errors
/// When there are too many cells for `budget_bytes`, and those of the scratch disk.
pub fn low_points(tiles: &Tiles, cell_m: f64, gap_m: f64, budget_bytes: u64, step: u8) -> Result<u64> {
    let mut min = [f64::INFINITY; 2];
    each_active(tiles, |xyz| {
        min = [min[0].min(xyz[0]), min[1].min(xyz[1])];
        Ok(())
    })?;
    let cell = |xyz: [f64; 3]| [0, 1].map(|axis| ((xyz[axis] - min[axis]) / cell_m).floor() as i64);
    let mut cells: HashMap<[i64; 2], Lowest> = HashMap::new();
    let mut heights = 0;
    each_active(tiles, |xyz| {
        let lowest = cells.entry(cell(xyz)).or_default();
        let before = lowest.0.len();
        lowest.add(xyz[2], gap_m);
        heights = heights + lowest.0.len() - before;
        let needed = CELL_BYTES * cells.len() as u64 + HEIGHT_BYTES * heights as u64;
        if needed > budget_bytes {
            return Err(Error::Limit {
                what: "the cells of --low".into(),
                needed,
                allowed: budget_bytes,
                remedy: "raise --memory, the cell or the threshold".into(),
            });
        }
        Ok(())
    })?;
    let mut noise = 0;
    tiles.update(|_, points| {
        let before = noise;
        for point in points.iter_mut().filter(|point| point.is_active()) {
            if point.xyz[2] < cells[&cell(point.xyz)].floor(gap_m) {
                point.take_out(NOISE, step);
                noise += 1;
            }
        }
        Ok(noise > before)
    })?;
    Ok(noise)
}

/// Hands over the places of all active points.
pub(crate) fn each_active(tiles: &Tiles, mut each: impl FnMut([f64; 3]) -> Result<()>) -> Result<()> {
    for tile in 0..tiles.tiles.len() {
        tiles.load(tile)?.iter().filter(|point| point.is_active()).try_for_each(|point| each(point.xyz))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::SplitMix64;

    /// The lowest heights up to the first two that lie close together, from all of them at once.
    #[test]
    fn what_is_kept_of_a_cell_does_not_depend_on_the_order() {
        let mut random = SplitMix64(7);
        for gap in [0.01, 0.3, 2.0] {
            let heights: Vec<f64> = (0..40).map(|_| (100.0 * random.unit()).round() / 10.0).collect();
            let mut sorted = heights.clone();
            sorted.sort_by(f64::total_cmp);
            let end = sorted.windows(2).position(|pair| pair[1] - pair[0] < gap).map_or(sorted.len(), |at| at + 2);
            let mut lowest = Lowest::default();
            heights.iter().for_each(|z| lowest.add(*z, gap));
            assert_eq!(lowest.0, sorted[..end], "{gap}");
        }
    }
}
