//! Cells that one source gives: the one that a rule or an index chooses.

use super::rule::Choice;
use super::source::Source;
use super::{Tile, Whole, Worker, holds};
use crate::error::Result;
use crate::resample::Interpolation;
use crate::window::Window;

impl Whole<'_> {
    pub(super) fn choose(
        &self,
        worker: &mut Worker,
        choice: &Choice,
        near: &[usize],
        window: Window,
        tile: &mut Tile,
    ) -> Result<()> {
        let area = window.area() as usize;
        let mut order = near.to_vec();
        if *choice == Choice::Newest {
            // The sort is stable: of equals the first wins.
            order.sort_by(|&a, &b| self.sources[b].date.cmp(&self.sources[a].date));
        }
        let deciding = self.sources[0].deciding_bands();
        let mut best = vec![f64::INFINITY; area];
        for (rank, &number) in order.iter().enumerate() {
            let rank = rank as f64;
            let costs: Option<Vec<f64>> = match choice {
                Choice::Min(_) => Some(worker.opened.read_companion(&self.sources[number], &self.grid, window)?),
                Choice::Nearest => Some(self.sources[number].distances(&self.grid, window)),
                _ => None,
            };
            let cost = |cell: usize| match (&costs, choice) {
                (Some(costs), _) => costs[cell],
                (None, Choice::Last) => -rank,
                _ => rank,
            };
            let silent = |cell: usize| matches!(choice, Choice::Min(_)) && cost(cell).is_nan();
            // NaN loses every comparison; of equals the first wins.
            if !(0..area).any(|cell| cost(cell) < best[cell] || silent(cell)) {
                continue;
            }
            let values = self.read(worker, number, window)?;
            let seen = |cell: usize| {
                let (x, y) = (cell as u64 % window.width, cell as u64 / window.width);
                worker.core.contains(window.x + x, window.y + y)
            };
            let silent = (0..area).filter(|&cell| silent(cell) && seen(cell) && holds(&values, area, cell, &deciding));
            worker.uncosted[number] += silent.count() as u64;
            for cell in 0..area {
                if cost(cell) < best[cell] && holds(&values, area, cell, &deciding) {
                    best[cell] = cost(cell);
                    tile.index[cell] = number as u32 + 1;
                    for band in 0..values.len() / area {
                        tile.values[band * area + cell] = values[band * area + cell];
                    }
                }
            }
        }
        Ok(())
    }

    pub(super) fn by_index(
        &self,
        worker: &mut Worker,
        index: &Source,
        near: &[usize],
        window: Window,
        tile: &mut Tile,
    ) -> Result<()> {
        let area = window.area() as usize;
        let deciding = self.sources[0].deciding_bands();
        let numbers = worker.opened.read(index, &self.grid, window, Interpolation::Nearest)?;
        worker.largest = numbers.iter().fold(worker.largest, |largest, number| largest.max(*number as u32));
        for &number in near {
            let wanted = (number + 1) as f64;
            if !numbers.contains(&wanted) {
                continue;
            }
            let values = self.read(worker, number, window)?;
            for cell in (0..area).filter(|&cell| numbers[cell] == wanted && holds(&values, area, cell, &deciding)) {
                tile.index[cell] = number as u32 + 1;
                for band in 0..values.len() / area {
                    tile.values[band * area + cell] = values[band * area + cell];
                }
            }
        }
        Ok(())
    }
}
