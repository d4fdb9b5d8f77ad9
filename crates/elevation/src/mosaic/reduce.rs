//! Cells that are coarser than a source's: means under a kernel as wide as they are.
//!
//! Samples taken between cells that are much finer alias. As in GDAL's warper, the kernel is drawn out by the ratio of
//! the cells: a triangle for bilinear, Keys's cubic for the others, over what is there.

use crate::grid::Grid;
use crate::resample::Interpolation;
use crate::window::Window;
use autoref_raster::keys;

/// Ratio of the cells above which means are taken; GDAL's is 1/0.95.
const COARSER: f64 = 1.0 / 0.95;
/// Of neighbours that weigh less nothing follows.
const LEAST_WEIGHT: f64 = 0.05;

/// Whether a source's cells are finer than the mosaic's, along one side at least.
pub(super) fn is_finer(source: &Grid, mosaic: &Grid) -> bool {
    (mosaic.step_x / source.step_x).max(mosaic.step_y / source.step_y) > COARSER
}

/// What one row or column of the mosaic takes: cells of the part that was read, from `first` on.
struct Reach {
    first: usize,
    weights: Vec<f64>,
    /// The cell of the part that the centre lies in.
    within: Option<usize>,
}

/// Along one axis: `first` cell and `count` of the window, both grids as (origin, step), and the source's cells that
/// were read. Places are those of the whole source, so that no tiling changes a bit.
fn reaches(
    (first, count): (u64, u64),
    mosaic: (f64, f64),
    source: (f64, f64),
    (start, length): (u64, u64),
    interpolation: Interpolation,
) -> Vec<Reach> {
    let ratio = mosaic.1 / source.1;
    let wide = if ratio > COARSER { ratio } else { 1.0 };
    let radius = if interpolation == Interpolation::Bilinear { 1.0 } else { 2.0 };
    let weight = |distance: f64| match interpolation {
        Interpolation::Nearest => f64::from(u8::from(distance.abs() <= 0.5)),
        Interpolation::Bilinear => (1.0 - distance.abs()).max(0.0),
        Interpolation::Cubic | Interpolation::Lagrange => keys::weight(distance),
    };
    let (low, high) = (start as f64, (start + length) as f64);
    let reach = |index: u64| {
        // In cells of the source, from the outer edge of its first.
        let centre = (mosaic.0 - source.0) / source.1 + (index as f64 + 0.5) * ratio;
        let from = (centre - radius * wide - 0.5).ceil().clamp(low, high);
        let to = (centre + radius * wide - 0.5).floor().clamp(low - 1.0, high - 1.0);
        let cells = from as i64..=to as i64;
        let within = centre.floor();
        Reach {
            first: from as usize - start as usize,
            weights: cells.map(|cell| weight((cell as f64 + 0.5 - centre) / wide)).collect(),
            within: (within >= low && within < high).then(|| within as usize - start as usize),
        }
    };
    (first..first + count).map(reach).collect()
}

/// What the cells of a window of the mosaic take of a part of a source.
pub(super) struct Reaches {
    columns: Vec<Reach>,
    rows: Vec<Reach>,
    /// Columns of the part.
    width: usize,
}

impl Reaches {
    pub(super) fn new(
        part: Window,
        (source, mosaic): (&Grid, &Grid),
        window: Window,
        interpolation: Interpolation,
    ) -> Reaches {
        let columns = reaches(
            (window.x, window.width),
            (mosaic.x0, mosaic.step_x),
            (source.x0, source.step_x),
            (part.x, part.width),
            interpolation,
        );
        let rows = reaches(
            (window.y, window.height),
            (mosaic.y0, mosaic.step_y),
            (source.y0, source.step_y),
            (part.y, part.height),
            interpolation,
        );
        Reaches { columns, rows, width: part.width as usize }
    }
}

/// Means that grow as rows of the part come: what they hold does not depend on how many source cells lie under one of
/// theirs.
pub(super) struct Means<'r> {
    reaches: &'r Reaches,
    /// Weighted sums of what is there, and its weights.
    sums: Vec<(f64, f64)>,
    /// Whether the cell that the centre lies in holds something.
    there: Vec<bool>,
    /// Rows of the part that came.
    rows_seen: usize,
    line: Vec<(f64, f64)>,
}

impl<'r> Means<'r> {
    pub(super) fn new(reaches: &'r Reaches) -> Self {
        let (across, cells) = (reaches.columns.len(), reaches.columns.len() * reaches.rows.len());
        let zero = (0.0, 0.0);
        Means { reaches, sums: vec![zero; cells], there: vec![false; cells], rows_seen: 0, line: vec![zero; across] }
    }

    /// Adds the next rows of the part; NaN where there is nothing.
    pub(super) fn add(&mut self, values: &[f64]) {
        let Reaches { columns, rows, width } = self.reaches;
        for row in values.chunks_exact(*width) {
            // Along the row first.
            for (sum, reach) in self.line.iter_mut().zip(columns) {
                *sum = (0.0, 0.0);
                let cells = &row[reach.first..reach.first + reach.weights.len()];
                for (value, weight) in cells.iter().zip(&reach.weights).filter(|(value, _)| !value.is_nan()) {
                    *sum = (sum.0 + weight * value, sum.1 + weight);
                }
            }
            let at = self.rows_seen;
            let from = rows.partition_point(|reach| reach.first + reach.weights.len() <= at);
            for (number, reach) in rows.iter().enumerate().skip(from).take_while(|(_, reach)| reach.first <= at) {
                let weight = reach.weights[at - reach.first];
                let cells = number * columns.len()..(number + 1) * columns.len();
                for (sum, along) in self.sums[cells.clone()].iter_mut().zip(&self.line) {
                    *sum = (sum.0 + weight * along.0, sum.1 + weight * along.1);
                }
                if reach.within == Some(at) {
                    for (there, column) in self.there[cells].iter_mut().zip(columns) {
                        *there = column.within.is_some_and(|x| !row[x].is_nan());
                    }
                }
            }
            self.rows_seen += 1;
        }
    }

    /// The cells of the window; NaN where the cell that the centre lies in holds nothing.
    pub(super) fn finish(self) -> Vec<f64> {
        let Reaches { columns, rows, .. } = self.reaches;
        // What weights of a whole reach sum to.
        let whole = |reach: &Reach| reach.weights.iter().sum::<f64>();
        let all: Vec<f64> = columns.iter().map(whole).collect();
        let cells = self.sums.chunks_exact(columns.len()).zip(self.there.chunks_exact(columns.len()));
        let mut out = Vec::with_capacity(self.sums.len());
        for (row, (sums, there)) in rows.iter().zip(cells) {
            let down = whole(row);
            out.extend(sums.iter().zip(there).zip(&all).map(|(((sum, weights), there), across)| {
                let enough = *weights > LEAST_WEIGHT * down * across;
                if *there && enough { sum / weights } else { f64::NAN }
            }));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The means of a window, its part given in strips of so many rows.
    fn means(
        values: &[f64],
        part: Window,
        grids: (&Grid, &Grid),
        window: Window,
        interpolation: Interpolation,
        rows: usize,
    ) -> Vec<f64> {
        let reaches = Reaches::new(part, grids, window, interpolation);
        let mut means = Means::new(&reaches);
        values.chunks(rows * part.width as usize).for_each(|strip| means.add(strip));
        means.finish()
    }

    /// A stripe of two cells that samples between cells would take or miss keeps its share.
    #[test]
    fn what_is_finer_than_a_cell_keeps_its_share() {
        let source = Grid { x0: 0.0, y0: 0.0, step_x: 1.0, step_y: -1.0, width: 40, height: 40 };
        let mosaic = Grid { x0: 0.0, y0: 0.0, step_x: 4.0, step_y: -4.0, width: 10, height: 10 };
        let values: Vec<f64> = (0..1600).map(|i| f64::from(u8::from(i % 8 < 2))).collect();
        let (part, window) = (Window::whole(40, 40), Window::whole(10, 10));
        for interpolation in [Interpolation::Bilinear, Interpolation::Cubic] {
            let means = means(&values, part, (&source, &mosaic), window, interpolation, 40);
            let row = &means[50..60];
            assert!((row[2..8].iter().sum::<f64>() / 6.0 - 0.25).abs() < 0.02, "{interpolation:?} {row:?}");
        }
    }

    #[test]
    fn any_part_and_window_give_the_same_bits_and_voids_stay() {
        let source = Grid { x0: 3.3, y0: 7.1, step_x: 1.0, step_y: -1.0, width: 60, height: 50 };
        let mosaic = Grid { x0: 1.0, y0: 8.0, step_x: 2.7, step_y: -2.7, width: 24, height: 20 };
        let hole = |x: u64, y: u64| x > 30 && x < 44 && y > 20;
        let value = |x: u64, y: u64| if hole(x, y) { f64::NAN } else { (x * 31 % 17) as f64 + (y * 7 % 13) as f64 };
        let cells = |part: Window| -> Vec<f64> {
            (part.y..part.bottom()).flat_map(|y| (part.x..part.right()).map(move |x| value(x, y))).collect()
        };
        let whole = Window::whole(60, 50);
        let all = means(&cells(whole), whole, (&source, &mosaic), Window::whole(24, 20), Interpolation::Bilinear, 50);
        let (part, window) = (Window::new(10, 10, 40, 38), Window::new(7, 6, 5, 5));
        let some = means(&cells(part), part, (&source, &mosaic), window, Interpolation::Bilinear, 3);
        for (i, value) in some.iter().enumerate() {
            let at = (6 + i / 5) * 24 + 7 + i % 5;
            assert_eq!(value.to_bits(), all[at].to_bits(), "{i}");
        }
        for (i, value) in all.iter().enumerate() {
            let x = 1.0 + ((i % 24) as f64 + 0.5) * 2.7 - 3.3;
            let y = 7.1 - (8.0 - ((i / 24) as f64 + 0.5) * 2.7);
            let inside = (0.0..60.0).contains(&x) && (0.0..50.0).contains(&y);
            assert_eq!(!value.is_nan(), inside && !hole(x as u64, y as u64), "{x} {y}");
        }
    }
}
