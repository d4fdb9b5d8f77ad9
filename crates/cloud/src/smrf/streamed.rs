//! The filter over surfaces that do not fit into memory, block by block.
//!
//! Openings reach as far as their discs, so that a halo makes them those of the whole surface to the last bit. Filled
//! holes and splines couple all cells: a hole is filled within its block and a halo of 128 cells, and where it goes on
//! beyond, it is held there at a surface of cells sixteen times as wide. A hole narrower than the halo is filled as if
//! all were in memory; in a wider one the difference dies out towards the known cells, which is where the points are. A
//! spline forgets a cell at a distance of 40 cells to the last bit.

use rayon::prelude::*;

use super::blocks::{Blocks, Coarse, Key, Lattice, Plane, Rect, check_window};
use super::surface::{Frame, Surface};
use super::{CELL_BYTES, Objects, Options, Spline, Terrain, cells, classify, inpaint, low_outliers, opening};
use crate::error::{Error, Result};
use crate::tiles::{Scratch, Tiles};

/// Cells around a block within which a spline forgets what lies beyond.
const SPLINE_HALO: usize = 40;
/// The reach of openings that are done in one go.
const OPENING_HALO: usize = 128;
/// Cells of blocks that any cloud may have, for points that lie far out.
const FREE_CELLS: u64 = 64 << 20;
/// Cells of blocks that each point may bring beyond those.
const CELLS_A_POINT: u64 = 1 << 14;
/// A cell of a plane on the scratch disk.
const HEIGHT_BYTES: u64 = 8;
/// Memory of a cell of an opening: the last surface, two steps of the next one, and marks.
const OPENING_BYTES: u64 = 33;

/// Classifies the active points of a wide cloud.
///
/// # Errors
/// [`Error::Limit`] when a block with its halo, or an opening, does not fit into `budget_bytes`, or points lie so far
/// apart that their blocks outgrow the scratch disk; and those of the scratch disk.
pub fn ground(
    tiles: &mut Tiles,
    frame: Frame,
    options: &Options,
    lattice: Lattice,
    budget_bytes: u64,
    step: u8,
    objects: Objects,
) -> Result<u64> {
    let radius =
        options.window_cells().max(if options.net_m > 0.0 { 2 * cells(options.net_m, options.cell_m) } else { 0 });
    let filled = lattice.block + 2 * lattice.halo;
    check_window(filled, CELL_BYTES, budget_bytes, "the ground surface, block by block,".into())?;
    let opened = lattice.block + (4 * radius).max(2 * OPENING_HALO);
    check_window(opened, OPENING_BYTES, budget_bytes, format!("openings of {radius} cells"))?;

    let surface = Streamed::lowest(tiles, frame, lattice)?;
    let planes = surface.terrain(&mut tiles.scratch, options)?;
    let blocks = surface.blocks;
    let mut count = 0;
    tiles.update_with_scratch(|scratch, points| {
        for (_, (rect, indices)) in blocks.groups(points) {
            let window = rect.grown(4, &frame);
            let spline = |plane: &Plane| {
                let coefficients = plane.read(scratch, &blocks, window, |_, _| 0.0)?;
                Ok(Spline::part(coefficients, (window.x.0, window.y.0), (frame.columns, frame.rows)))
            };
            let terrain = Terrain {
                frame,
                heights: spline(&planes.heights)?,
                slopes: spline(&planes.slopes)?,
                options: *options,
            };
            let found: Vec<bool> =
                indices.par_iter().map(|&index| terrain.is_ground(points[index as usize].xyz)).collect();
            for (&index, is_ground) in indices.iter().zip(found) {
                count += classify(&mut points[index as usize], is_ground, step, objects);
            }
        }
        Ok(true)
    })?;
    Ok(count)
}

/// Refuses cells so small that the blocks are all but empty: the scratch disk would fill with holes.
fn check_spacing(blocks: &Blocks, points: u64) -> Result<()> {
    let (cells, allowed) = (blocks.cells(), FREE_CELLS.saturating_add(points.saturating_mul(CELLS_A_POINT)));
    if cells <= allowed {
        return Ok(());
    }
    Err(Error::Limit {
        what: format!("the ground surface of {points} points in cells of {} m", blocks.frame.cell_m),
        needed: cells.saturating_mul(HEIGHT_BYTES),
        allowed: allowed.saturating_mul(HEIGHT_BYTES),
        remedy: "give --ground a wider cell, or crop far points first (--range-from, --crop, --outliers)".into(),
    })
}

/// Splines of heights and slopes.
struct Coefficients {
    heights: Plane,
    slopes: Plane,
}

/// The lowest heights, NaN where there are none.
struct Streamed {
    blocks: Blocks,
    lowest: Plane,
    bottom: f64,
}

impl Streamed {
    fn lowest(tiles: &mut Tiles, frame: Frame, lattice: Lattice) -> Result<Streamed> {
        let mut blocks = Blocks::new(frame, lattice);
        let lowest = Plane::new(&mut tiles.scratch)?;
        let mut bottom = f64::INFINITY;
        for tile in 0..tiles.tiles.len() {
            let points = tiles.load(tile)?;
            for (key, (rect, indices)) in blocks.groups(&points) {
                blocks.open(key, &lowest, &tiles.scratch)?;
                check_spacing(&blocks, tiles.points)?;
                let mut surface = lowest.read(&tiles.scratch, &blocks, rect, |_, _| f64::NAN)?;
                for index in indices {
                    let xyz = points[index as usize].xyz;
                    let cell = frame.cell(xyz);
                    let (column, row) = (cell % frame.columns - rect.x.0, cell / frame.columns - rect.y.0);
                    let value = &mut surface.values[row * surface.columns + column];
                    // Also true when nothing is there yet.
                    if value.is_nan() || *value > xyz[2] {
                        *value = xyz[2];
                    }
                    bottom = bottom.min(xyz[2]);
                }
                lowest.write(&tiles.scratch, &blocks, rect, rect, &surface)?;
            }
        }
        blocks.surround(&lowest, &tiles.scratch)?;
        Ok(Streamed { blocks, lowest, bottom })
    }

    fn terrain(&self, scratch: &mut Scratch, options: &Options) -> Result<Coefficients> {
        let filled = Plane::new(scratch)?;
        let coarse = Coarse::new(&self.blocks, &self.lowest, scratch)?;
        self.each(|_, rect| self.fill(scratch, &self.lowest, &filled, &coarse, rect))?;
        let objects = self.objects(scratch, &filled, &coarse, options)?;
        let holed = Plane::new(scratch)?;
        let mut known = 0u64;
        self.each(|_, rect| {
            let mut surface = filled.read(scratch, &self.blocks, rect, |x, y| coarse.value(x, y))?;
            let objects = objects.read(scratch, &self.blocks, rect, |_, _| 0.0)?;
            for (value, object) in surface.values.iter_mut().zip(&objects.values) {
                if *object > 0.0 {
                    *value = f64::NAN;
                }
            }
            known += surface.values.iter().filter(|value| !value.is_nan()).count() as u64;
            holed.write(scratch, &self.blocks, rect, rect, &surface)
        })?;
        let heights = Plane::new(scratch)?;
        let slopes = Plane::new(scratch)?;
        if known > 0 {
            let coarse = Coarse::new(&self.blocks, &holed, scratch)?;
            self.each(|_, rect| self.fill(scratch, &holed, &filled, &coarse, rect))?;
        }
        // Where nothing is left, the lowest point of all is the terrain.
        let far = |_: usize, _: usize| self.bottom;
        self.each(|_, rect| {
            let window = rect.grown(SPLINE_HALO, &self.blocks.frame);
            let mut surface = filled.read(scratch, &self.blocks, window, far)?;
            if known == 0 {
                surface.values.fill(self.bottom);
            }
            let steep = Spline::new(surface.slope(options.cell_m)).into_coefficients();
            slopes.write(scratch, &self.blocks, rect, window, &steep)?;
            heights.write(scratch, &self.blocks, rect, window, &Spline::new(surface).into_coefficients())
        })?;
        Ok(Coefficients { heights, slopes })
    }

    fn each(&self, mut each: impl FnMut(Key, Rect) -> Result<()>) -> Result<()> {
        self.blocks.keys().into_iter().try_for_each(|key| each(key, self.blocks.rect(key)))
    }

    /// Writes a block without holes.
    fn fill(&self, scratch: &Scratch, from: &Plane, to: &Plane, coarse: &Coarse, rect: Rect) -> Result<()> {
        let mut surface = from.read(scratch, &self.blocks, rect, |_, _| f64::NAN)?;
        if surface.values.iter().all(|value| !value.is_nan()) {
            return to.write(scratch, &self.blocks, rect, rect, &surface);
        }
        let frame = &self.blocks.frame;
        let window = rect.grown(self.blocks.lattice.halo, frame);
        surface = from.read(scratch, &self.blocks, window, |_, _| f64::NAN)?;
        let columns = surface.columns;
        let mut hold = |column: usize, row: usize| {
            let value = &mut surface.values[(row - window.y.0) * columns + column - window.x.0];
            if value.is_nan() {
                *value = coarse.value(column, row);
            }
        };
        for (at, inside) in [(window.y.0, window.y.0 > 0), (window.y.1 - 1, window.y.1 < frame.rows)] {
            (window.x.0..window.x.1).filter(|_| inside).for_each(|column| hold(column, at));
        }
        for (at, inside) in [(window.x.0, window.x.0 > 0), (window.x.1 - 1, window.x.1 < frame.columns)] {
            (window.y.0..window.y.1).filter(|_| inside).for_each(|row| hold(at, row));
        }
        inpaint(&mut surface);
        to.write(scratch, &self.blocks, rect, window, &surface)
    }

    /// One where a cell was empty, is a low outlier or a net's, or stands out of an opening.
    fn objects(&self, scratch: &mut Scratch, filled: &Plane, coarse: &Coarse, options: &Options) -> Result<Plane> {
        let marks = Plane::new(scratch)?;
        let frame = &self.blocks.frame;
        let far = |x: usize, y: usize| coarse.value(x, y);
        let mut last = Plane::new(scratch)?;
        let net = if options.net_m > 0.0 { cells(options.net_m, options.cell_m) } else { 0 };
        self.each(|_, rect| {
            let window = rect.grown(2, frame);
            let surface = filled.read(scratch, &self.blocks, window, far)?;
            let low = low_outliers(&surface, options);
            let mut gone = self.lowest.read(scratch, &self.blocks, window, |_, _| f64::NAN)?;
            gone.values.iter_mut().zip(low).for_each(|(value, low)| *value = f64::from(value.is_nan() || low));
            // Large openings along a net keep objects that are wider than the window apart.
            let wide = rect.grown(4 * net, frame);
            let mut cut = filled.read(scratch, &self.blocks, wide, far)?;
            if net > 0 {
                let open = opening(&cut, 2 * net);
                for row in rect.y.0..rect.y.1 {
                    for column in rect.x.0..rect.x.1 {
                        if column.is_multiple_of(net) || row.is_multiple_of(net) {
                            let cell = (row - wide.y.0) * cut.columns + column - wide.x.0;
                            cut.values[cell] = open.values[cell];
                            gone.values[(row - window.y.0) * gone.columns + column - window.x.0] = 1.0;
                        }
                    }
                }
            }
            last.write(scratch, &self.blocks, rect, wide, &cut)?;
            marks.write(scratch, &self.blocks, rect, window, &gone)
        })?;
        let mut radius = 1;
        while radius <= options.window_cells() {
            let first = radius;
            let mut reach = 2 * radius;
            while radius < options.window_cells() && reach + 2 * (radius + 1) <= OPENING_HALO {
                radius += 1;
                reach += 2 * radius;
            }
            let next = Plane::new(scratch)?;
            self.each(|_, rect| {
                let window = rect.grown(reach, frame);
                let mut surface = last.read(scratch, &self.blocks, window, far)?;
                let mut gone = marks.read(scratch, &self.blocks, window, |_, _| 0.0)?;
                for radius in first..=radius {
                    let opened = opening(&surface, radius);
                    mark(&mut gone, &surface, &opened, options.slope * (radius as f64 * options.cell_m));
                    surface = opened;
                }
                marks.write(scratch, &self.blocks, rect, window, &gone)?;
                next.write(scratch, &self.blocks, rect, window, &surface)
            })?;
            last = next;
            radius += 1;
        }
        Ok(marks)
    }
}

/// One where the surface stands out of its opening by more than `rise`.
fn mark(gone: &mut Surface, surface: &Surface, opened: &Surface, rise: f64) {
    gone.values.par_iter_mut().zip(&surface.values).zip(&opened.values).for_each(|((gone, value), opened)| {
        if value - opened > rise {
            *gone = 1.0;
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::point::Point;
    use crate::tiles::Spool;
    use autoref_raster::random::SplitMix64;

    /// Hills with a lake without points, houses, and points far below.
    fn cloud(count: u64) -> Vec<[f64; 3]> {
        let mut random = SplitMix64(11);
        let mut unit = move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        let mut points = Vec::new();
        while (points.len() as u64) < count {
            let (x, y) = (400.0 * unit() - 200.0, 300.0 * unit() + 13.0);
            if (x - 60.0).hypot(y - 140.0) < 35.0 {
                continue;
            }
            let mut z = 300.0 + 12.0 * (x / 60.0).sin() + 9.0 * (y / 45.0).cos() + 0.1 * unit();
            if x.rem_euclid(50.0) < 6.0 && y.rem_euclid(40.0) < 8.0 {
                z += 7.0;
            }
            if unit() < 0.001 {
                z -= 3000.0 * unit();
            }
            points.push([x, y, z]);
        }
        points
    }

    const SMALL: Lattice = Lattice { block: 64, halo: 48, whole: 0, coarse: 1 << 12 };

    fn classes(points: &[[f64; 3]], lattice: Lattice, most: usize, options: &Options) -> Vec<u8> {
        let mut scratch = Scratch::new(&std::env::temp_dir()).expect("a folder");
        let mut spool = Spool::new(&mut scratch).expect("a spool");
        for (index, &xyz) in (0..).zip(points) {
            spool.push(&scratch, &Point::new(xyz, index)).expect("room");
        }
        let mut tiles = Tiles::new(scratch, spool, most).expect("tiles");
        super::super::ground(&mut tiles, options, lattice, 1 << 30, 1, Objects::Stay).expect("ground");
        let mut classes = vec![0; points.len()];
        for tile in 0..tiles.tiles.len() {
            tiles.load(tile).expect("points").iter().for_each(|point| classes[point.index() as usize] = point.class());
        }
        classes
    }

    #[test]
    fn blocks_are_the_whole_surface() {
        let points = cloud(25_000);
        for options in
            [Options::default(), Options { net_m: 14.0, window_m: 12.0, low_slope: 5.0, ..Options::default() }]
        {
            let whole = classes(&points, Lattice { whole: u64::MAX, ..Lattice::default() }, 1 << 20, &options);
            let streamed = classes(&points, SMALL, 1 << 20, &options);
            let differing = whole.iter().zip(&streamed).filter(|(a, b)| a != b).count();
            assert!(differing <= 12, "{differing} of {} points differ", points.len());
            assert!(whole.iter().filter(|&&class| class == 1).count() > 300);
            for most in [3_000, 11_000] {
                assert!(streamed == classes(&points, SMALL, most, &options), "tiles of {most}");
            }
        }
    }

    #[test]
    fn wide_gaps_take_no_room() {
        // Two patches two hundred kilometres apart: a surface of 10^10 cells, of which a few blocks are made.
        let mut points = cloud(3000);
        points.extend(cloud(3000).into_iter().map(|[x, y, z]| [x + 200_000.0, y + 200_000.0, z]));
        let found = classes(&points, SMALL, 1000, &Options::default());
        let ground = |part: &[u8]| part.iter().filter(|&&class| class == 2).count();
        let (near, far) = found.split_at(3000);
        assert!(ground(near) > 1500 && ground(near).abs_diff(ground(far)) < 60, "{} {}", ground(near), ground(far));
    }
}
