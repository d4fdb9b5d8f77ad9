//! Surfaces of square cells.

/// Heights of cells, row after row from the north.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    pub columns: usize,
    pub rows: usize,
    /// NaN where nothing is known.
    pub values: Vec<f64>,
}

impl Surface {
    /// Heights of a row, from the west.
    pub fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.columns..(row + 1) * self.columns]
    }

    /// The length of the gradient, by central differences and one-sided ones at the border.
    pub fn slope(&self, cell_m: f64) -> Surface {
        let along = |before: f64, after: f64, cells: f64| (after - before) / (cells * cell_m);
        let ends = |at: usize, count: usize| {
            let (low, high) = (at.saturating_sub(1), (at + 1).min(count - 1));
            (low, high, (high - low).max(1) as f64)
        };
        let mut values = Vec::with_capacity(self.values.len());
        for y in 0..self.rows {
            let (north, south, tall) = ends(y, self.rows);
            for x in 0..self.columns {
                let (west, east, wide) = ends(x, self.columns);
                let dx = along(self.row(y)[west], self.row(y)[east], wide);
                let dy = along(self.row(north)[x], self.row(south)[x], tall);
                values.push((dx * dx + dy * dy).sqrt());
            }
        }
        Surface { values, ..*self }
    }
}

/// Where the cells of a surface lie: the centres are on multiples of the cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    pub columns: usize,
    pub rows: usize,
    /// Western and northern edge.
    pub west: f64,
    pub north: f64,
    pub cell_m: f64,
}

/// The spline needs so many cells each way.
const LEAST_CELLS: usize = 4;

impl Frame {
    /// The cells that cover a box. `None` when there are more than can be counted.
    pub fn new(min: [f64; 2], max: [f64; 2], cell_m: f64) -> Option<Frame> {
        let low = min.map(|value| (value / cell_m).floor());
        let high = max.map(|value| (value / cell_m).ceil());
        let count = |axis: usize| {
            let cells = high[axis] - low[axis] + 1.0;
            (cells < 4e9).then_some((cells as usize).max(LEAST_CELLS))
        };
        let frame = Frame {
            columns: count(0)?,
            rows: count(1)?,
            west: low[0] * cell_m - 0.5 * cell_m,
            north: high[1] * cell_m + 0.5 * cell_m,
            cell_m,
        };
        Some(frame)
    }

    /// Number of cells.
    pub fn cells(&self) -> u64 {
        self.columns as u64 * self.rows as u64
    }

    /// Column and row of a place, as numbers with fractions; 0 is the outer edge.
    pub fn place(&self, xyz: [f64; 3]) -> (f64, f64) {
        ((xyz[0] - self.west) / self.cell_m, (self.north - xyz[1]) / self.cell_m)
    }

    /// The cell of a place inside.
    pub fn cell(&self, xyz: [f64; 3]) -> usize {
        let (column, row) = self.place(xyz);
        (row as usize).min(self.rows - 1) * self.columns + (column as usize).min(self.columns - 1)
    }
}
