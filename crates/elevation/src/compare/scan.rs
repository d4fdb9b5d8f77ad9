//! Both models, cell by cell on B's grid.

use crate::error::Result;
use crate::footprint::{self, Footprints, Partial};
use crate::grid::{Grid, GroundUnit};
use crate::resample::{Interpolation, Resampled, Scratch};
use crate::source::{Heights, Patch};
use crate::window::Window;
use crate::zones::{RowSets, Zones};

/// What is known of a cell beside its difference.
pub(super) struct Cell<'a> {
    pub(super) x: u64,
    pub(super) y: u64,
    pub(super) difference: f32,
    pub(super) height: f32,
    pub(super) facing: Facing,
    /// Numbers of its zones.
    pub(super) zones: &'a [u32],
}

/// How the ground lies, by classes that count from 1; 0 where it is not known, or below the first limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Facing {
    pub(super) slope: u16,
    pub(super) aspect: u16,
}

/// A on B's grid.
pub(super) enum OnGrid<'a> {
    Between(Resampled<'a, dyn Heights + 'a>),
    /// Cells finer than B's, as means over each of B's cells: between samples of them, the ground that is rougher than
    /// B's cells would count as a difference, with one sign on ridges and the other in valleys.
    Under(Footprints<'a, dyn Heights + 'a>),
}

impl<'a> OnGrid<'a> {
    /// Cells of B so many times as long as A's are means of these.
    const FINER: f64 = 1.05;

    pub(super) fn new(a: &'a dyn Heights, grid: Grid, resampling: Interpolation) -> OnGrid<'a> {
        let cell = |g: &Grid| (g.step_x * g.step_y).abs();
        if (cell(&grid) / cell(&a.grid())).sqrt() > Self::FINER {
            OnGrid::Under(Footprints::new(a, grid, (0.0, 0.0)).sloping())
        } else {
            OnGrid::Between(Resampled::new(a, grid, (0.0, 0.0), resampling))
        }
    }

    /// How A's heights come onto B's grid: the word of `--resampling`, or `mean`.
    pub(super) fn way(&self, resampling: Interpolation) -> &'static str {
        match (self, resampling) {
            (OnGrid::Under(_), _) => "mean",
            (_, Interpolation::Nearest) => "nearest",
            (_, Interpolation::Bilinear) => "bilinear",
            (_, Interpolation::Cubic) => "cubic",
            (_, Interpolation::Lagrange) => "lagrange",
        }
    }

    fn read(&self, patch: Patch, buffers: &mut Buffers) -> Result<()> {
        match self {
            OnGrid::Between(a) => a.read_with(patch, &mut buffers.scratch, &mut buffers.a),
            OnGrid::Under(a) => a.read_with(patch, &mut buffers.under, &mut buffers.a),
        }
    }
}

/// Both models on B's grid.
pub(super) struct Scan<'a> {
    pub(super) grid: Grid,
    pub(super) unit: GroundUnit,
    pub(super) a: OnGrid<'a>,
    pub(super) b: &'a dyn Heights,
    pub(super) zones: Option<&'a Zones>,
    /// Lower limits of the slope classes, per cent.
    pub(super) slope_limits: &'a [f64],
    /// Differences outside are left out.
    pub(super) limits: (f64, f64),
}

#[derive(Default)]
pub(super) struct Buffers {
    pub(super) scratch: Scratch,
    pub(super) under: footprint::Buffers,
    pub(super) a: Vec<f64>,
    pub(super) b: Vec<f64>,
    pub(super) zones: RowSets,
    /// Rows that were kept.
    pub(super) bytes: Vec<u8>,
}

/// Cells of a row whose slopes are made at a time, which is quicker than one by one.
const LINE: usize = 16;

/// How the ground lies, after B. Horn, *Hill shading and the reflectance map*, 1981.
struct Line {
    /// Rise towards east and north, metres a metre.
    east: [f64; LINE],
    north: [f64; LINE],
    percent: [f64; LINE],
}

impl Line {
    /// Of `count` cells of `b`; `from` is the upper left neighbour of the first.
    #[inline(always)]
    fn of(b: &[f64], (from, stride): (usize, usize), count: usize, (per_x, per_y): (f64, f64)) -> Line {
        let [up, middle, down] = [0, 1, 2].map(|row| &b[from + row * stride..][..count + 2]);
        let mut line = Line { east: [0.0; LINE], north: [0.0; LINE], percent: [0.0; LINE] };
        for k in 0..count {
            let (left, right) = (up[k] + 2.0 * middle[k] + down[k], up[k + 2] + 2.0 * middle[k + 2] + down[k + 2]);
            let (above, below) = (up[k] + 2.0 * up[k + 1] + up[k + 2], down[k] + 2.0 * down[k + 1] + down[k + 2]);
            line.east[k] = (right - left) * per_x;
            line.north[k] = (below - above) * per_y;
        }
        for k in 0..LINE {
            line.percent[k] = 100.0 * (line.east[k] * line.east[k] + line.north[k] * line.north[k]).sqrt();
        }
        line
    }
}

impl Scan<'_> {
    /// All common cells of a window, row by row.
    pub(super) fn cells(&self, window: Window, buffers: &mut Buffers, mut see: impl FnMut(Cell<'_>)) -> Result<()> {
        let (width, height) = (window.width as usize, window.height as usize);
        let (x, y) = (window.x as i64, window.y as i64);
        if self.b.holds_nothing(window.into()) {
            return Ok(());
        }
        self.a.read(window.into(), buffers)?;
        let stride = width + 2;
        self.b.read(Patch { x: x - 1, y: y - 1, width: stride, height: height + 2 }, &mut buffers.b)?;
        if matches!(self.a, OnGrid::Under(_)) {
            centre_partial(buffers, (width, stride));
        }
        buffers.zones.clear(width);
        let (grid, b) = (&self.grid, &buffers.b);
        for row in 0..height {
            let north = grid.y0 + ((window.y + row as u64) as f64 + 0.5) * grid.step_y;
            if self.zones.is_some() {
                self.mark_zones(window.x, window.y + row as u64, width, &mut buffers.zones);
            }
            let (mx, my) = self.unit.metres_per_unit(north);
            let (per_x, per_y) = (0.125 / (mx * grid.step_x), 0.125 / (my * grid.step_y));
            for column in (0..width).step_by(LINE) {
                let count = LINE.min(width - column);
                let line = Line::of(b, (row * stride + column, stride), count, (per_x, per_y));
                let a = &buffers.a[row * width + column..][..count];
                for (k, (a, &height)) in a.iter().zip(&b[(row + 1) * stride + column + 1..][..count]).enumerate() {
                    let difference = a - height;
                    if difference.is_nan() || difference < self.limits.0 || difference > self.limits.1 {
                        continue;
                    }
                    let steep = self.slope_limits.iter().rposition(|limit| line.percent[k] >= *limit);
                    see(Cell {
                        x: window.x + (column + k) as u64,
                        y: window.y + row as u64,
                        difference: difference as f32,
                        height: height as f32,
                        facing: Facing {
                            slope: steep.map_or(0, |class| class as u16 + 1),
                            aspect: aspect(line.east[k], line.north[k]).map_or(0, |direction| direction + 1),
                        },
                        zones: buffers.zones.of(column + k),
                    });
                }
            }
        }
        Ok(())
    }

    /// Of a cell of a row, on the ground.
    pub(super) fn cell_m2(&self, y: u64) -> f64 {
        let (mx, my) = self.unit.metres_per_unit(self.grid.y0 + (y as f64 + 0.5) * self.grid.step_y);
        (mx * self.grid.step_x * my * self.grid.step_y).abs()
    }

    /// The zones of a row from a column on.
    pub(super) fn mark_zones(&self, x: u64, y: u64, cells: usize, out: &mut RowSets) {
        if let Some(zones) = self.zones {
            let grid = &self.grid;
            let north = grid.y0 + (y as f64 + 0.5) * grid.step_y;
            zones.row_sets(north, (grid.x0 + (x as f64 + 0.5) * grid.step_x, grid.step_x), cells, out);
        }
    }
}

/// Brings means over parts of cells to the cells' middles, by how B lies there: else B's height of the whole cell would
/// be subtracted from that of a part of it. Where B does not tell, the cell is left out. B's cells begin one row and
/// column before A's.
fn centre_partial(buffers: &mut Buffers, (width, stride): (usize, usize)) {
    let Buffers { under, a, b, .. } = buffers;
    for Partial { index, off_px } in &under.partial {
        let at = (index / width + 1) * stride + index % width + 1;
        let rise = |step: usize| {
            let [before, here, after] = [b[at - step], b[at], b[at + step]];
            match (before.is_nan(), after.is_nan()) {
                (false, false) => 0.5 * (after - before),
                (true, false) => after - here,
                (false, true) => here - before,
                (true, true) => f64::NAN,
            }
        };
        // A middle that lies where the cell's does asks nothing of B.
        let along = |off_px: f64, step: usize| if off_px.abs() > 1e-6 { off_px * rise(step) } else { 0.0 };
        a[*index] -= along(off_px[0], 1) + along(off_px[1], stride);
    }
}

/// Tangent of half of an eighth of a turn.
const HALF_EIGHTH: f64 = std::f64::consts::SQRT_2 - 1.0;

/// Which of eight directions, clockwise from north, a slope that rises so much eastwards and northwards looks to; 8
/// where there is none, `None` where it is not known.
fn aspect(east: f64, north: f64) -> Option<u16> {
    // Downhill.
    let (e, n) = (-east, -north);
    if e.is_nan() || n.is_nan() {
        None
    } else if e == 0.0 && n == 0.0 {
        Some(8)
    } else if e.abs() < HALF_EIGHTH * n.abs() {
        Some(if n > 0.0 { 0 } else { 4 })
    } else if n.abs() <= HALF_EIGHTH * e.abs() {
        Some(if e > 0.0 { 2 } else { 6 })
    } else {
        Some(match (e > 0.0, n > 0.0) {
            (true, true) => 1,
            (true, false) => 3,
            (false, false) => 5,
            (false, true) => 7,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::MemoryHeights;

    /// Cells of 7 and 8.5 under cells of 10, offset, rows north up or south up: a plane is one after the mean too,
    /// beside a hole of either model as well.
    #[test]
    fn means_of_a_plane_lie_on_it() {
        let plane = |x: f64, y: f64| 0.35 * x - 0.6 * y;
        let heights = |grid: Grid, hole: u64| {
            let at = |i: u64, step: f64| (i as f64 + 0.5) * step;
            let values = (0..grid.height).flat_map(|j| (0..grid.width).map(move |i| (i, j))).map(|(i, j)| {
                let is_hole = i / hole == 1 && j / hole == 1;
                if is_hole { f64::NAN } else { plane(grid.x0 + at(i, grid.step_x), grid.y0 + at(j, grid.step_y)) }
            });
            MemoryHeights::new(grid, values.collect())
        };
        for (step_x, step_y, down) in [(7.0, 8.5, -1.0), (8.5, 7.0, 1.0), (5.0, 9.4, -1.0)] {
            let fine = Grid { x0: -18.7, y0: -23.1 * down, step_x, step_y: step_y * down, width: 60, height: 60 };
            let grid = Grid { x0: 0.0, y0: 0.0, step_x: 10.0, step_y: 10.0 * down, width: 30, height: 30 };
            let (a, b) = (heights(fine, 16), heights(grid, 9));
            let unit = GroundUnit::Projected { metres_per_unit: 1.0 };
            let a = OnGrid::new(&a, grid, Interpolation::Bilinear);
            let limits = (f64::NEG_INFINITY, f64::INFINITY);
            let scan = Scan { grid, unit, a, b: &b, zones: None, slope_limits: &[], limits };
            let mut seen = 0;
            let window = Window { x: 0, y: 0, width: 30, height: 30 };
            let see = |cell: Cell<'_>| {
                seen += 1;
                assert!(cell.difference.abs() < 1e-5, "{} {}: {}", cell.x, cell.y, cell.difference);
            };
            scan.cells(window, &mut Buffers::default(), see).expect("memory");
            assert!(seen > 600, "{seen}");
        }
    }

    #[test]
    fn aspects_are_those_of_the_angle() {
        for degree in 0..720 {
            // Between the borders of classes.
            let downhill = (f64::from(degree) + 0.25) / 2.0;
            let (east, north) = (-downhill.to_radians().sin(), -downhill.to_radians().cos());
            assert_eq!(aspect(3.0 * east, 3.0 * north), Some(((downhill + 22.5) / 45.0) as u16 % 8), "{downhill}");
        }
        assert_eq!(aspect(0.0, -0.0), Some(8));
        assert_eq!(aspect(f64::NAN, 1.0), None);
    }
}
