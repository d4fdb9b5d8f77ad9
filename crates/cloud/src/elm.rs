//! Extended local minimum: the lowest points of a cell that a gap separates from the rest (Chen, Devereux, Gao &
//! Amable, *Upward-fusion urban DTM generating method using airborne Lidar data*, 2012).

use std::collections::HashMap;

use crate::error::{Error, Result};
use crate::outliers::NOISE;
use crate::tiles::Tiles;

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
        let end = self.0.windows(2).position(|pair| pair[1] - pair[0] < gap).map_or(self.0.len(), |at| at + 2);
        self.0.truncate(end);
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
    // A cell with its entry of the table and two or three heights.
    let most = budget_bytes / 128;
    each_active(tiles, |xyz| {
        cells.entry(cell(xyz)).or_default().add(xyz[2], gap_m);
        if cells.len() as u64 > most {
            return Err(Error::Limit {
                what: "the cells of --low".into(),
                needed: cells.len() as u64 * 128,
                allowed: budget_bytes,
                remedy: "raise --memory or the cell".into(),
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
