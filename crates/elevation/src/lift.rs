//! From one vertical datum to another: what is added to a model's heights, by PROJ.

use crate::crs::{Accuracy, Coordinate, Crs, DEFAULT_DATUM_ACCURACY_M, same_plane};
use crate::error::Result;
use crate::grid::Grid;
use autoref_raster::bilinear::by_differences;

/// Metres to add at every place of a model, on a lattice over its grid. Undulations of geoids are smooth beside the
/// cells of a model: between the nodes the value is bilinear.
#[derive(Clone, Debug)]
pub struct Lift {
    /// Cells of the model between nodes.
    step_px: (f64, f64),
    columns: usize,
    values_m: Vec<f64>,
    worst_error_m: f64,
    accuracy: Accuracy,
}

/// Nodes along the longer side at first; doubled until the lattice is as good as PROJ itself.
const FIRST_NODES: usize = 33;
const MOST_NODES: usize = 1025;
/// Between nodes the lattice may differ from PROJ by so much.
const GOOD_M: f64 = 0.001;
/// Places between nodes, along a side, at which it is compared with PROJ.
const PROBES: usize = 61;

impl Lift {
    /// Samples PROJ over a grid whose map coordinates are those of `to`. `from` and `to` must have heights.
    ///
    /// # Errors
    /// When PROJ has no transformation with heights between them that is good enough with the grids that are installed,
    /// or none that holds over the whole grid.
    pub fn of(grid: &Grid, from: &Crs, to: &Crs) -> Result<Lift> {
        let mut nodes = FIRST_NODES;
        let probes: Vec<(f64, f64)> = (0..PROBES * PROBES)
            .map(|i| {
                let along = |k: usize, cells: u64| (k as f64 + 0.5) / PROBES as f64 * cells as f64;
                (along(i % PROBES, grid.width), along(i / PROBES, grid.height))
            })
            .collect();
        let (truth, accuracy) = sample(grid, from, to, &probes)?;
        loop {
            let mut lift = Lift::with_nodes(grid, from, to, nodes, accuracy)?;
            let errors = probes.iter().zip(&truth).map(|(&(x, y), truth)| (lift.at(x, y) - truth).abs());
            lift.worst_error_m = errors.fold(0.0, f64::max);
            if lift.worst_error_m <= GOOD_M || nodes >= MOST_NODES {
                return Ok(lift);
            }
            nodes = 2 * nodes - 1;
        }
    }

    fn with_nodes(grid: &Grid, from: &Crs, to: &Crs, most: usize, accuracy: Accuracy) -> Result<Lift> {
        let longer = grid.width.max(grid.height) as f64;
        let count = |cells: u64| ((most - 1) as f64 * cells as f64 / longer).ceil().max(1.0) as usize + 1;
        let (columns, rows) = (count(grid.width), count(grid.height));
        let step_px = (grid.width as f64 / (columns - 1) as f64, grid.height as f64 / (rows - 1) as f64);
        let places: Vec<(f64, f64)> =
            (0..columns * rows).map(|i| ((i % columns) as f64 * step_px.0, (i / columns) as f64 * step_px.1)).collect();
        let (values_m, _) = sample(grid, from, to, &places)?;
        Ok(Lift { step_px, columns, values_m, worst_error_m: 0.0, accuracy })
    }

    /// Metres to add at a place of the grid, in cells from its outer corner; outside it, what the border has.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let rows = self.values_m.len() / self.columns;
        let split = |place: f64, step: f64, nodes: usize| {
            let at = (place / step).clamp(0.0, (nodes - 1) as f64);
            let first = (at as usize).min(nodes - 2);
            (first, at - first as f64)
        };
        let ((i, u), (j, v)) = (split(x, self.step_px.0, self.columns), split(y, self.step_px.1, rows));
        let row = |j: usize| {
            let line = &self.values_m[j * self.columns + i..];
            [line[0], line[1]]
        };
        by_differences([row(j), row(j + 1)], [u, v])
    }

    /// Least and largest value, metres.
    pub fn range_m(&self) -> (f64, f64) {
        let ends = (f64::INFINITY, f64::NEG_INFINITY);
        self.values_m.iter().fold(ends, |(low, high), v| (low.min(*v), high.max(*v)))
    }

    /// What PROJ and the lattice differ by at most, where they were compared, metres.
    pub fn worst_error_m(&self) -> f64 {
        self.worst_error_m
    }

    /// What the authority says of the transformation.
    pub fn accuracy(&self) -> Accuracy {
        self.accuracy
    }
}

/// Worst accuracy of a change of heights alone that is accepted, metres. Two geoids of the whole Earth (EGM96, EGM2008)
/// are each good to 1 m by their authority's word: no better is stated between them. The couple names it.
const HEIGHT_ACCURACY_M: f64 = 2.0;

/// What PROJ adds to heights of `from` to have them in `to`, metres, at places of a grid that lies in `to`: the heights
/// in `from` of what has none in `to`, with the other sign. With the height itself they change by some millionths of
/// it.
fn sample(grid: &Grid, from: &Crs, to: &Crs, places: &[(f64, f64)]) -> Result<(Vec<f64>, Accuracy)> {
    let mut points: Vec<Coordinate> = places
        .iter()
        .map(|&(x, y)| Coordinate { x: grid.x0 + x * grid.step_x, y: grid.y0 + y * grid.step_y, height: Some(0.0) })
        .collect();
    let worst_m = if same_plane(from, to) { HEIGHT_ACCURACY_M } else { DEFAULT_DATUM_ACCURACY_M };
    let accuracy = to.transform(&mut points, from, worst_m)?;
    let metres = from.height_metres_per_unit().unwrap_or(1.0);
    Ok((points.iter().map(|p| -p.height.unwrap_or(0.0) * metres).collect(), accuracy))
}
