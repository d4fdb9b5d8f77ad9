//! Ground by the simple morphological filter (Pingel, Clarke & McBride, *An improved simple morphological filter for
//! the terrain classification of airborne LIDAR data*, 2013), complete: the lowest surface with its holes filled, low
//! outliers, cut nets, growing openings, the provisional terrain, and the points near it.
//!
//! The surface is that of the author's Python: cell centres on multiples of the cell. Two things differ: the springs
//! that fill holes are solved to the end instead of to LSQR's default tolerance, and a cloud may be narrower than four
//! cells.

mod blocks;
mod inpaint;
mod morphology;
mod spline;
mod streamed;
mod surface;

use rayon::prelude::*;

pub use blocks::Lattice;
pub use inpaint::inpaint;
pub use morphology::{Extremum, extremum, opening};
pub use spline::Spline;
pub use surface::{Frame, Surface};

use crate::elm::each_active;
use crate::error::{Error, Result};
use crate::params;
use crate::point::Point;
use crate::tiles::Tiles;

/// LAS classes.
const OBJECT: u8 = 1;
const GROUND: u8 = 2;

/// An opening for every cell of the radius: more would never end, and no object is so wide.
const MOST_WINDOW_CELLS: f64 = 500.0;

/// Memory of a cell at the peak: the surface, masks, and the vectors of the solver where all of it is a hole.
const CELL_BYTES: u64 = 56;

/// What the filter takes as ground; the defaults are the thesis's of 2017 (sample 5-3 with cell and window doubled).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Options {
    pub cell_m: f64,
    /// Rise over run beyond which a cell stands out of an opened surface.
    pub slope: f64,
    /// Radius of the largest opening.
    pub window_m: f64,
    /// Distance from the provisional terrain within which a point is ground, …
    pub threshold_m: f64,
    /// … and what the terrain's slope adds to it.
    pub scaling: f64,
    /// Slope by which low outliers stand out downwards.
    pub low_slope: f64,
    /// Distance of the lines of a cut net; 0 cuts none.
    pub net_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            cell_m: 2.0,
            slope: 0.45,
            window_m: 6.0,
            threshold_m: 0.10,
            scaling: 3.80,
            low_slope: 500.0,
            net_m: 0.0,
        }
    }
}

impl Options {
    /// Reads `cell=2,slope=0.45,window=6,threshold=0.10,scaling=3.80,low_slope=500,net=0`.
    ///
    /// # Errors
    /// Unknown names, values that make no sense.
    pub fn read(text: &str) -> Result<Options> {
        let d = Options::default();
        let defaults = [
            ("cell", d.cell_m),
            ("slope", d.slope),
            ("window", d.window_m),
            ("threshold", d.threshold_m),
            ("scaling", d.scaling),
            ("low_slope", d.low_slope),
            ("net", d.net_m),
        ];
        let [cell_m, slope, window_m, threshold_m, scaling, low_slope, net_m] =
            params::read("--ground", text, defaults)?;
        params::positive("--ground", "cell", cell_m)?;
        params::positive("--ground", "window", window_m)?;
        let never_negative = [
            ("slope", slope),
            ("threshold", threshold_m),
            ("scaling", scaling),
            ("low_slope", low_slope),
            ("net", net_m),
        ];
        for (name, value) in never_negative {
            if value < 0.0 {
                return Err(Error::usage(format!("--ground: {name} is {value}"), format!("give a {name} from 0 up")));
            }
        }
        let widest = window_m.max(net_m) / cell_m;
        if widest > MOST_WINDOW_CELLS {
            let what = format!("--ground: a window or net of {widest:.0} cells");
            return Err(Error::usage(what, format!("give lengths of at most {MOST_WINDOW_CELLS} cells")));
        }
        Ok(Options { cell_m, slope, window_m, threshold_m, scaling, low_slope, net_m })
    }

    /// Radius of the largest opening in cells.
    pub fn window_cells(&self) -> usize {
        cells(self.window_m, self.cell_m)
    }
}

/// A length in whole cells, rounded up; a length that is whole but for the last bits stays so.
fn cells(length_m: f64, cell_m: f64) -> usize {
    ((length_m / cell_m - 1e-9).ceil() as usize).max(1)
}

/// The terrain that the filter found, from which points are told.
pub struct Terrain {
    frame: Frame,
    heights: Spline,
    slopes: Spline,
    options: Options,
}

impl Terrain {
    /// Whether a point is ground.
    pub fn is_ground(&self, xyz: [f64; 3]) -> bool {
        let (column, row) = self.frame.place(xyz);
        let allowed = self.options.threshold_m + self.options.scaling * self.slopes.value(column, row);
        (self.heights.value(column, row) - xyz[2]).abs() <= allowed
    }
}

/// Cells that stand out of ever larger openings, by more than the slope allows over the opening's radius.
fn standing_out(surface: &Surface, window_cells: usize, options: &Options) -> Vec<bool> {
    let mut out = vec![false; surface.values.len()];
    let mut last = surface.clone();
    for radius in 1..=window_cells {
        let opened = opening(&last, radius);
        let rise = options.slope * (radius as f64 * options.cell_m);
        out.par_iter_mut().zip(&last.values).zip(&opened.values).for_each(|((out, last), opened)| {
            *out |= last - opened > rise;
        });
        last = opened;
    }
    out
}

/// Cells deeper than the closing with a disc of one cell allows.
fn low_outliers(surface: &Surface, options: &Options) -> Vec<bool> {
    let closed = extremum(&extremum(surface, 1, Extremum::Greatest), 1, Extremum::Least);
    let drop = options.low_slope * options.cell_m;
    surface.values.iter().zip(&closed.values).map(|(value, closed)| closed - value > drop).collect()
}

/// The provisional terrain from the lowest heights of the cells (NaN where a cell is empty).
pub fn provisional_terrain(mut lowest: Surface, options: &Options) -> Surface {
    let empty: Vec<bool> = lowest.values.iter().map(|value| value.is_nan()).collect();
    let bottom = lowest.values.iter().copied().fold(f64::INFINITY, f64::min);
    inpaint(&mut lowest);
    let mut gone = low_outliers(&lowest, options);
    gone.iter_mut().zip(empty).for_each(|(gone, empty)| *gone |= empty);
    let window = options.window_cells();
    let objects = if options.net_m > 0.0 {
        // Large openings along a net keep objects that are wider than the window apart.
        let net = cells(options.net_m, options.cell_m);
        let open = opening(&lowest, 2 * net);
        let mut cut = lowest.clone();
        for cell in 0..cut.values.len() {
            if (cell % cut.columns).is_multiple_of(net) || (cell / cut.columns).is_multiple_of(net) {
                cut.values[cell] = open.values[cell];
                gone[cell] = true;
            }
        }
        drop(open);
        standing_out(&cut, window, options)
    } else {
        standing_out(&lowest, window, options)
    };
    for ((value, gone), object) in lowest.values.iter_mut().zip(gone).zip(objects) {
        if gone || object {
            *value = f64::NAN;
        }
    }
    // Where nothing is left, the lowest point of all is the terrain.
    if lowest.values.iter().all(|value| value.is_nan()) {
        lowest.values.fill(bottom);
    }
    inpaint(&mut lowest);
    lowest
}

/// What becomes of points that are not ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Objects {
    /// The steps that follow see them.
    Stay,
    /// They do not.
    Go,
}

/// Gives a point its class; 1 when it is not ground.
fn classify(point: &mut Point, is_ground: bool, step: u8, objects: Objects) -> u64 {
    match objects {
        _ if is_ground => point.classify(GROUND, step),
        Objects::Stay => point.classify(OBJECT, step),
        Objects::Go => point.take_out(OBJECT, step),
    }
    u64::from(!is_ground)
}

/// Classifies all active points as ground (2) or not (1). Answers how many are not ground.
///
/// A surface of more than `lattice.whole` cells is worked on in blocks on the scratch disk.
///
/// # Errors
/// When a block does not fit into `budget_bytes`, and those of the scratch disk.
pub fn ground(
    tiles: &mut Tiles,
    options: &Options,
    lattice: Lattice,
    budget_bytes: u64,
    step: u8,
    objects: Objects,
) -> Result<u64> {
    let mut min = [f64::INFINITY; 2];
    let mut max = [f64::NEG_INFINITY; 2];
    each_active(tiles, |xyz| {
        for axis in 0..2 {
            min[axis] = min[axis].min(xyz[axis]);
            max[axis] = max[axis].max(xyz[axis]);
        }
        Ok(())
    })?;
    if min[0] > max[0] {
        return Ok(0);
    }
    let wide = |needed: u64| Error::Limit {
        what: format!("the ground surface of {:.0} × {:.0} m", max[0] - min[0], max[1] - min[1]),
        needed,
        allowed: budget_bytes,
        remedy: "raise --memory or the cell of --ground, or crop far points first (--range-from, --crop, --outliers)"
            .into(),
    };
    let frame = Frame::new(min, max, options.cell_m).ok_or_else(|| wide(u64::MAX))?;
    if frame.cells() > lattice.whole {
        return streamed::ground(tiles, frame, options, lattice, budget_bytes, step, objects);
    }
    let needed = frame.cells().saturating_mul(CELL_BYTES);
    if needed > budget_bytes {
        return Err(wide(needed));
    }
    let mut values = vec![f64::NAN; frame.cells() as usize];
    each_active(tiles, |xyz| {
        let value = &mut values[frame.cell(xyz)];
        // Also true when nothing is there yet.
        if value.is_nan() || *value > xyz[2] {
            *value = xyz[2];
        }
        Ok(())
    })?;
    // On a thread of the pool, where short pieces of work cost nothing to hand over.
    let terrain = rayon::scope(|_| {
        let surface = provisional_terrain(Surface { columns: frame.columns, rows: frame.rows, values }, options);
        let slopes = Spline::new(surface.slope(options.cell_m));
        Terrain { frame, heights: Spline::new(surface), slopes, options: *options }
    });
    let mut count = 0;
    tiles.update(|_, points| {
        count += points
            .par_iter_mut()
            .filter(|point| point.is_active())
            .map(|point| classify(point, terrain.is_ground(point.xyz), step, objects))
            .sum::<u64>();
        Ok(true)
    })?;
    Ok(count)
}
