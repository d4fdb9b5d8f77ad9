//! Where heights come from: memory, means over blocks of another source, files ([`crate::model`]), copies that are
//! quick to read again ([`crate::kept`]).

use crate::error::Result;
use crate::grid::Grid;
use crate::window::Window;

/// A part of a raster; it may reach outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patch {
    pub x: i64,
    pub y: i64,
    pub width: usize,
    pub height: usize,
}

impl From<Window> for Patch {
    fn from(window: Window) -> Patch {
        let (width, height) = (window.width as usize, window.height as usize);
        Patch { x: window.x as i64, y: window.y as i64, width, height }
    }
}

/// Heights on a grid, read in windows by several threads at once.
pub trait Heights: Sync {
    fn grid(&self) -> Grid;

    /// Heights of `patch`, row by row; NaN where there is none, also outside the grid.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()>;

    /// Whether it is known without reading that no cell of `patch` has a height.
    fn holds_nothing(&self, _patch: Patch) -> bool {
        false
    }
}

/// Heights in memory; NaN where there is none.
#[derive(Clone, Debug)]
pub struct MemoryHeights {
    grid: Grid,
    values: Vec<f64>,
}

impl MemoryHeights {
    /// # Panics
    /// When `values` does not hold one number for each cell.
    pub fn new(grid: Grid, values: Vec<f64>) -> Self {
        assert_eq!(values.len() as u64, grid.width * grid.height, "a number for each cell");
        MemoryHeights { grid, values }
    }

    /// Heights row by row.
    pub fn values(&self) -> &[f64] {
        &self.values
    }
}

impl Heights for MemoryHeights {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        read_rows(&self.grid, &self.values, patch, out);
        Ok(())
    }
}

/// The part of `values` (row by row on `grid`) that `patch` asks for, NaN outside.
pub(crate) fn read_rows<T: Copy + Into<f64>>(grid: &Grid, values: &[T], patch: Patch, out: &mut Vec<f64>) {
    let (width, height) = (grid.width as i64, grid.height as i64);
    let first = patch.x.clamp(0, width);
    let last = (patch.x + patch.width as i64).clamp(first, width);
    let before = ((first - patch.x) as usize).min(patch.width);
    out.clear();
    out.reserve(patch.width * patch.height);
    for row in patch.y..patch.y + patch.height as i64 {
        let end = out.len() + patch.width;
        if (0..height).contains(&row) && first < last {
            out.resize(out.len() + before, f64::NAN);
            let line = &values[(row * width + first) as usize..(row * width + last) as usize];
            out.extend(line.iter().map(|v| (*v).into()));
        }
        out.resize(end, f64::NAN);
    }
}

/// Means over `factor` × `factor` cells of another source; NaN where less than half of the cells have a height.
pub struct Means<'a, H: Heights + ?Sized> {
    inner: &'a H,
    factor: u64,
}

impl<'a, H: Heights + ?Sized> Means<'a, H> {
    /// Means over `factor` × `factor` cells of another.
    pub fn new(inner: &'a H, factor: u64) -> Self {
        Means { inner, factor: factor.max(1) }
    }
}

/// Cells of the inner source that are held at a time.
pub(crate) const CELLS_AT_A_TIME: usize = 1 << 20;

impl<H: Heights + ?Sized> Heights for Means<'_, H> {
    fn grid(&self) -> Grid {
        self.inner.grid().coarser(self.factor)
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        if self.factor == 1 {
            return self.inner.read(patch, out);
        }
        let factor = self.factor as usize;
        out.clear();
        out.resize(patch.width * patch.height, f64::NAN);
        let across = (CELLS_AT_A_TIME / (factor * factor)).clamp(1, patch.width.max(1));
        let down = (CELLS_AT_A_TIME / (factor * factor * across)).clamp(1, patch.height.max(1));
        let mut cells = Vec::new();
        for y in (0..patch.height).step_by(down) {
            for x in (0..patch.width).step_by(across) {
                let (columns, rows) = (across.min(patch.width - x), down.min(patch.height - y));
                let part = Patch {
                    x: (patch.x + x as i64) * factor as i64,
                    y: (patch.y + y as i64) * factor as i64,
                    width: columns * factor,
                    height: rows * factor,
                };
                self.inner.read(part, &mut cells)?;
                for row in 0..rows {
                    for column in 0..columns {
                        let from = row * factor * part.width + column * factor;
                        out[(y + row) * patch.width + x + column] = mean(&cells[from..], part.width, factor);
                    }
                }
            }
        }
        Ok(())
    }

    fn holds_nothing(&self, patch: Patch) -> bool {
        let (factor, cells) = (self.factor as i64, self.factor as usize);
        let (width, height) = (patch.width * cells, patch.height * cells);
        self.inner.holds_nothing(Patch { x: patch.x * factor, y: patch.y * factor, width, height })
    }
}

/// The mean of a square at the start of `cells`, whose rows are `stride` apart.
fn mean(cells: &[f64], stride: usize, side: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for row in 0..side {
        for &value in &cells[row * stride..row * stride + side] {
            if !value.is_nan() {
                sum += value;
                count += 1;
            }
        }
    }
    if 2 * count >= side * side { sum / count as f64 } else { f64::NAN }
}

/// A part of another source.
pub struct Cropped<'a, H: Heights + ?Sized> {
    inner: &'a H,
    x: u64,
    y: u64,
    grid: Grid,
}

impl<'a, H: Heights + ?Sized> Cropped<'a, H> {
    /// The cells that meet `bounds` (west, south, east, north), whose first column and row are multiples of `step_px`.
    /// `None` when there are none.
    pub fn new(inner: &'a H, bounds: [f64; 4], step_px: u64) -> Option<Self> {
        let g = inner.grid();
        let along = |from: f64, to: f64, origin: f64, step: f64, size: u64| {
            let (a, b) = ((from - origin) / step, (to - origin) / step);
            let low = a.min(b).max(0.0).min(size as f64).floor() as u64 / step_px * step_px;
            let high = a.max(b).max(0.0).min(size as f64).ceil() as u64;
            (high > low).then_some((low, high - low))
        };
        let (x, width) = along(bounds[0], bounds[2], g.x0, g.step_x, g.width)?;
        let (y, height) = along(bounds[1], bounds[3], g.y0, g.step_y, g.height)?;
        let grid = Grid { x0: g.x0 + x as f64 * g.step_x, y0: g.y0 + y as f64 * g.step_y, width, height, ..g };
        Some(Cropped { inner, x, y, grid })
    }
}

impl<H: Heights + ?Sized> Heights for Cropped<'_, H> {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        self.inner.read(Patch { x: patch.x + self.x as i64, y: patch.y + self.y as i64, ..patch }, out)
    }

    fn holds_nothing(&self, patch: Patch) -> bool {
        self.inner.holds_nothing(Patch { x: patch.x + self.x as i64, y: patch.y + self.y as i64, ..patch })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(width: u64, height: u64) -> Grid {
        Grid { x0: 0.0, y0: 0.0, step_x: 1.0, step_y: -1.0, width, height }
    }

    #[test]
    fn outside_there_is_nothing() {
        let memory = MemoryHeights::new(grid(2, 2), vec![1.0, 2.0, 3.0, 4.0]);
        let mut out = Vec::new();
        memory.read(Patch { x: -1, y: 1, width: 4, height: 2 }, &mut out).expect("memory");
        assert!(out[0].is_nan() && out[3].is_nan() && out[4..].iter().all(|v| v.is_nan()));
        assert_eq!(&out[1..3], &[3.0, 4.0]);
        memory.read(Patch { x: 5, y: 5, width: 2, height: 1 }, &mut out).expect("memory");
        assert!(out.iter().all(|v| v.is_nan()));
    }

    #[test]
    fn means_need_half_of_their_cells() {
        let nan = f64::NAN;
        let memory = MemoryHeights::new(grid(4, 2), vec![1.0, 3.0, nan, nan, nan, nan, nan, 5.0]);
        let means = Means::new(&memory, 2);
        let mut out = Vec::new();
        means.read(Patch { x: 0, y: 0, width: 2, height: 1 }, &mut out).expect("memory");
        assert_eq!(out[0], 2.0);
        assert!(out[1].is_nan());
    }
}
