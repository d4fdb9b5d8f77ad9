//! Surfaces outside memory: square blocks of cells on the scratch disk, kept only where points are and one block
//! around. Blocks lie on multiples of their side in map coordinates, so that nothing depends on how points were shared
//! out.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;

use super::surface::{Frame, Surface};
use crate::error::{Error, Result};
use crate::point::Point;
use crate::schema::array;
use crate::tiles::Scratch;
use autoref_raster::bilinear::by_differences;

/// How a surface is cut. Part of the definition of the result where holes are wider than the halo.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    /// Cells along a side of a block.
    pub block: usize,
    /// Cells around a block that holes in it are filled with.
    pub halo: usize,
    /// Surfaces of at most so many cells are held whole.
    pub whole: u64,
    /// Cells at most of the surface of wide cells, to which the wider holes are held.
    pub coarse: u64,
}

impl Default for Lattice {
    fn default() -> Self {
        Lattice { block: 1024, halo: 128, whole: 1280 * 1280, coarse: 1280 * 1280 }
    }
}

/// Cells of a frame, ends excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    pub x: (usize, usize),
    pub y: (usize, usize),
}

impl Rect {
    /// Cells from west to east.
    pub fn width(&self) -> usize {
        self.x.1 - self.x.0
    }

    /// Cells from north to south.
    pub fn height(&self) -> usize {
        self.y.1 - self.y.0
    }

    /// Wider by `cells` on every side, as far as the frame goes.
    pub fn grown(&self, cells: usize, frame: &Frame) -> Rect {
        Rect {
            x: (self.x.0.saturating_sub(cells), (self.x.1 + cells).min(frame.columns)),
            y: (self.y.0.saturating_sub(cells), (self.y.1 + cells).min(frame.rows)),
        }
    }
}

/// Row and column of a block in the map's lattice.
pub type Key = (i64, i64);

/// Which blocks of a frame there are.
pub struct Blocks {
    pub frame: Frame,
    pub lattice: Lattice,
    /// Column and row of the frame's first cell in the map's lattice.
    origin: [i64; 2],
    slots: BTreeMap<Key, u64>,
}

impl Blocks {
    /// No block of the frame yet.
    pub fn new(frame: Frame, lattice: Lattice) -> Blocks {
        let cells = |edge: f64| (edge / frame.cell_m).round() as i64;
        Blocks { frame, lattice, origin: [cells(frame.west), cells(-frame.north)], slots: BTreeMap::new() }
    }

    /// Cells of all blocks that there are.
    pub fn cells(&self) -> u64 {
        (self.slots.len() * self.lattice.block * self.lattice.block) as u64
    }

    /// Those that there are, in order.
    pub fn keys(&self) -> Vec<Key> {
        self.slots.keys().copied().collect()
    }

    /// The block of a cell of the frame.
    pub fn key(&self, column: usize, row: usize) -> Key {
        let side = self.lattice.block as i64;
        ((self.origin[1] + row as i64).div_euclid(side), (self.origin[0] + column as i64).div_euclid(side))
    }

    /// The frame's cells in a block; empty when it lies outside.
    pub fn rect(&self, key: Key) -> Rect {
        let side = self.lattice.block as i64;
        let along = |index: i64, origin: i64, count: usize| {
            let clip = |cell: i64| cell.clamp(0, count as i64) as usize;
            (clip(index * side - origin), clip((index + 1) * side - origin))
        };
        Rect { x: along(key.1, self.origin[0], self.frame.columns), y: along(key.0, self.origin[1], self.frame.rows) }
    }

    /// Makes room for a block, with NaN in `plane`.
    ///
    /// # Errors
    /// When the scratch disk does not take the block.
    pub fn open(&mut self, key: Key, plane: &Plane, scratch: &Scratch) -> Result<()> {
        let next = self.slots.len() as u64;
        if let std::collections::btree_map::Entry::Vacant(entry) = self.slots.entry(key) {
            entry.insert(next);
            let row = f64::NAN.to_le_bytes().repeat(self.lattice.block * self.lattice.block);
            let at = next * row.len() as u64;
            plane.file.write_all_at(&row, at).map_err(|e| scratch.error("write scratch data to", e))?;
        }
        Ok(())
    }

    /// Adds the blocks around those that there are.
    ///
    /// # Errors
    /// When the scratch disk does not take a block.
    pub fn surround(&mut self, plane: &Plane, scratch: &Scratch) -> Result<()> {
        for (row, column) in self.keys() {
            for key in (row - 1..=row + 1).flat_map(|row| (column - 1..=column + 1).map(move |column| (row, column))) {
                let rect = self.rect(key);
                if rect.width() > 0 && rect.height() > 0 {
                    self.open(key, plane, scratch)?;
                }
            }
        }
        Ok(())
    }

    /// Points by their blocks: the cells that they take, and their numbers.
    pub fn groups(&self, points: &[Point]) -> BTreeMap<Key, (Rect, Vec<u32>)> {
        let mut groups: BTreeMap<Key, (Rect, Vec<u32>)> = BTreeMap::new();
        for (index, point) in (0u32..).zip(points) {
            if point.is_active() {
                let cell = self.frame.cell(point.xyz);
                let (column, row) = (cell % self.frame.columns, cell / self.frame.columns);
                let one = Rect { x: (column, column + 1), y: (row, row + 1) };
                let (rect, indices) = groups.entry(self.key(column, row)).or_insert_with(|| (one, Vec::new()));
                rect.x = (rect.x.0.min(column), rect.x.1.max(column + 1));
                rect.y = (rect.y.0.min(row), rect.y.1.max(row + 1));
                indices.push(index);
            }
        }
        groups
    }

    /// Calls `each` with every piece of a row of `rect` that lies in one block: first column, row, length, and the
    /// place in a plane's file, if the block is there.
    fn pieces(&self, rect: Rect, mut each: impl FnMut(usize, usize, usize, Option<u64>) -> Result<()>) -> Result<()> {
        let side = self.lattice.block as i64;
        for row in rect.y.0..rect.y.1 {
            let mut column = rect.x.0;
            while column < rect.x.1 {
                let key = self.key(column, row);
                let end = self.rect(key).x.1.min(rect.x.1);
                let down = self.origin[1] + row as i64 - key.0 * side;
                let across = self.origin[0] + column as i64 - key.1 * side;
                let place = self.slots.get(&key).map(|slot| ((*slot as i64 * side + down) * side + across) as u64 * 8);
                each(column, row, end - column, place)?;
                column = end;
            }
        }
        Ok(())
    }
}

/// One number for every cell of the blocks.
pub struct Plane {
    file: File,
}

impl Plane {
    /// One without blocks.
    ///
    /// # Errors
    /// When the scratch folder takes no new file.
    pub fn new(scratch: &mut Scratch) -> Result<Plane> {
        Ok(Plane { file: scratch.file()? })
    }

    /// The cells of `rect`; where no block is, `elsewhere` of column and row.
    ///
    /// # Errors
    /// When a row of a block cannot be read back.
    pub fn read(
        &self,
        scratch: &Scratch,
        blocks: &Blocks,
        rect: Rect,
        elsewhere: impl Fn(usize, usize) -> f64,
    ) -> Result<Surface> {
        let mut values = vec![0.0; rect.width() * rect.height()];
        let mut bytes = vec![0; rect.width() * 8];
        blocks.pieces(rect, |column, row, length, place| {
            let begin = (row - rect.y.0) * rect.width() + column - rect.x.0;
            let values = &mut values[begin..begin + length];
            let Some(place) = place else {
                values.iter_mut().enumerate().for_each(|(index, value)| *value = elsewhere(column + index, row));
                return Ok(());
            };
            let bytes = &mut bytes[..length * 8];
            self.file.read_exact_at(bytes, place).map_err(|e| scratch.error("read scratch data from", e))?;
            let numbers = bytes.chunks_exact(8).map(|bytes| f64::from_le_bytes(array(bytes)));
            values.iter_mut().zip(numbers).for_each(|(value, number)| *value = number);
            Ok(())
        })?;
        Ok(Surface { columns: rect.width(), rows: rect.height(), values })
    }

    /// Writes the cells of `rect` out of a surface that covers `window`.
    ///
    /// # Errors
    /// When the scratch disk does not take a row of a block.
    pub fn write(&self, scratch: &Scratch, blocks: &Blocks, rect: Rect, window: Rect, surface: &Surface) -> Result<()> {
        let mut bytes = Vec::with_capacity(rect.width() * 8);
        blocks.pieces(rect, |column, row, length, place| {
            let Some(place) = place else { return Ok(()) };
            let begin = (row - window.y.0) * surface.columns + column - window.x.0;
            bytes.clear();
            surface.values[begin..begin + length]
                .iter()
                .for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
            self.file.write_all_at(&bytes, place).map_err(|e| scratch.error("write scratch data to", e))
        })
    }
}

/// The surface in cells so wide that all of it fits into memory, without holes: what holds where blocks end.
pub struct Coarse {
    factor: i64,
    origin: [i64; 2],
    first: [i64; 2],
    surface: Surface,
}

impl Coarse {
    /// The means of the known cells of `plane`, holes filled. Cells are joined 16 × 16, or more where that is not
    /// enough.
    ///
    /// # Errors
    /// When a block cannot be read back.
    pub fn new(blocks: &Blocks, plane: &Plane, scratch: &Scratch) -> Result<Coarse> {
        let (frame, origin) = (&blocks.frame, blocks.origin);
        let extent = |factor: i64| {
            let first = origin.map(|cell| cell.div_euclid(factor));
            let last = [origin[0] + frame.columns as i64 - 1, origin[1] + frame.rows as i64 - 1]
                .map(|cell| cell.div_euclid(factor));
            (first, [0, 1].map(|axis| (last[axis] - first[axis] + 1) as usize))
        };
        let mut factor = 16.min(blocks.lattice.block as i64);
        while extent(factor).1.iter().map(|&cells| cells as u64).product::<u64>() > blocks.lattice.coarse {
            factor *= 2;
        }
        let (first, [columns, rows]) = extent(factor);
        let mut sums = vec![(0.0, 0u32); columns * rows];
        for key in blocks.keys() {
            let rect = blocks.rect(key);
            let values = plane.read(scratch, blocks, rect, |_, _| f64::NAN)?;
            for (index, value) in values.values.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
                let cell = [rect.x.0 + index % values.columns, rect.y.0 + index / values.columns];
                let [x, y] =
                    [0, 1].map(|axis| ((origin[axis] + cell[axis] as i64).div_euclid(factor) - first[axis]) as usize);
                let (sum, count) = &mut sums[y * columns + x];
                *sum += value;
                *count += 1;
            }
        }
        let values =
            sums.into_iter().map(|(sum, count)| if count > 0 { sum / f64::from(count) } else { f64::NAN }).collect();
        let mut surface = Surface { columns, rows, values };
        super::inpaint(&mut surface);
        Ok(Coarse { factor, origin, first, surface })
    }

    /// The height at a cell of the frame, linear between the centres of the wide cells. NaN when nothing is known at
    /// all.
    pub fn value(&self, column: usize, row: usize) -> f64 {
        let along = |axis: usize, cell: usize, count: usize| {
            let at =
                ((self.origin[axis] + cell as i64 - self.first[axis] * self.factor) as f64 + 0.5) / self.factor as f64;
            let at = (at - 0.5).clamp(0.0, (count - 1) as f64);
            let low = at as usize;
            (low, (low + 1).min(count - 1), at - low as f64)
        };
        let (west, east, across) = along(0, column, self.surface.columns);
        let (north, south, down) = along(1, row, self.surface.rows);
        let corners = [north, south].map(|row| self.surface.row(row)).map(|row| [row[west], row[east]]);
        by_differences(corners, [across, down])
    }
}

/// Refuses what the blocks would need beyond the budget.
///
/// # Errors
/// [`Error::Limit`] when a square of `cells` by `cells` needs more than `allowed` bytes.
pub fn check_window(cells: usize, cell_bytes: u64, allowed: u64, what: String) -> Result<()> {
    let needed = (cells as u64).saturating_mul(cells as u64).saturating_mul(cell_bytes);
    if needed > allowed {
        let remedy = "raise --memory or the cell of --ground, or lower its window or net".into();
        return Err(Error::Limit { what, needed, allowed, remedy });
    }
    Ok(())
}
