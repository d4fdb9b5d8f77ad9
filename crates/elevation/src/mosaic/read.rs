//! How windows of a mosaic's sources are read: as they are, between their cells, or as means of finer ones.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use autoref_raster::masked;
use gdal::Dataset;

use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::model::open_dataset;
use crate::resample::{Interpolation, Resampled};
use crate::source::{Heights, Patch, read_rows};
use crate::window::Window;

use super::reduce::{self, Means, Reaches};
use super::source::Source;

/// A part of a source's cells, on the grid of the whole: places are counted from the whole's corner, so that no tiling
/// changes what lies between two cells.
struct Part {
    grid: Grid,
    window: Window,
    values: Vec<f64>,
    /// What lies outside.
    beyond: f64,
}

impl Heights for Part {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        let own = Grid { width: self.window.width, height: self.window.height, ..self.grid };
        let inside = Patch { x: patch.x - self.window.x as i64, y: patch.y - self.window.y as i64, ..patch };
        read_rows(&own, &self.values, inside, out);
        if !self.beyond.is_nan() {
            let (width, height) = (self.window.width as i64, self.window.height as i64);
            for (row, line) in (inside.y..).zip(out.chunks_exact_mut(patch.width)) {
                let outside = |column: i64| !((0..width).contains(&column) && (0..height).contains(&row));
                let cells = (inside.x..).zip(line).filter(|(column, _)| outside(*column));
                cells.for_each(|(_, value)| *value = self.beyond);
            }
        }
        Ok(())
    }
}

/// The cells of `part` at the places of `patch` of the mosaic.
fn between(part: &Part, mosaic: &Grid, patch: Patch, interpolation: Interpolation, out: &mut Vec<f64>) -> Result<()> {
    Resampled::new(part, *mosaic, (0.0, 0.0), interpolation).read(patch, out)
}

/// Interpolates beside voids and edges too: a place has a value where the cell that it lies in has one, by the weights
/// of those neighbours that are there. Otherwise tiles that abut would leave a gap. As GDAL's warper has it, a cubic
/// that misses one of its neighbours gives way to the two nearest along each axis.
fn between_what_is_there(
    mut part: Part,
    mosaic: &Grid,
    patch: Patch,
    interpolation: Interpolation,
    out: &mut Vec<f64>,
) -> Result<()> {
    /// Of neighbours that weigh less nothing follows.
    const LEAST_WEIGHT: f64 = 0.05;
    let wide = interpolation != Interpolation::Bilinear;
    if wide {
        between(&part, mosaic, patch, interpolation, out)?;
    }
    let there = part.values.iter().map(|value| f64::from(u8::from(!value.is_nan()))).collect();
    let there = Part { values: there, beyond: 0.0, ..part };
    part.values.iter_mut().filter(|value| value.is_nan()).for_each(|value| *value = 0.0);
    part.beyond = 0.0;
    let (mut narrow, mut weights, mut nearest) = (Vec::new(), Vec::new(), Vec::new());
    between(&part, mosaic, patch, Interpolation::Bilinear, &mut narrow)?;
    between(&there, mosaic, patch, Interpolation::Bilinear, &mut weights)?;
    between(&there, mosaic, patch, Interpolation::Nearest, &mut nearest)?;
    for ((value, weight), nearest) in narrow.iter_mut().zip(weights).zip(nearest) {
        // Where all neighbours are there nothing is divided: the same bits as away from any edge.
        if nearest != 1.0 || weight < LEAST_WEIGHT {
            *value = f64::NAN;
        } else if (weight - 1.0).abs() > 1e-9 {
            *value /= weight;
        }
    }
    if wide {
        out.iter_mut().zip(narrow).filter(|(value, _)| value.is_nan()).for_each(|(value, narrow)| *value = narrow);
    } else {
        *out = narrow;
    }
    Ok(())
}

/// Datasets that a worker has open, not too many.
#[derive(Default)]
pub struct Opened {
    datasets: HashMap<PathBuf, (u64, Dataset)>,
    uses: u64,
}

const MOST_OPEN: usize = 24;

impl Opened {
    fn dataset(&mut self, path: &Path) -> Result<&Dataset> {
        self.uses += 1;
        if !self.datasets.contains_key(path) {
            if self.datasets.len() >= MOST_OPEN {
                let oldest = self.datasets.iter().min_by_key(|(_, (used, _))| *used).map(|(path, _)| path.clone());
                oldest.and_then(|path| self.datasets.remove(&path));
            }
            self.datasets.insert(path.to_path_buf(), (0, open_dataset(path)?));
        }
        let entry = self.datasets.get_mut(path).expect("it was put there above");
        entry.0 = self.uses;
        Ok(&entry.1)
    }

    /// All bands of a source in a window of the mosaic; NaN where there is nothing.
    ///
    /// # Errors
    /// When the source cannot be opened, or its cells or its mask not be read.
    pub fn read(
        &mut self,
        source: &Source,
        mosaic: &Grid,
        window: Window,
        interpolation: Interpolation,
    ) -> Result<Vec<f64>> {
        let mut all = self.read_at_one_place(source, mosaic, window, interpolation)?;
        for again in source.again.iter().filter(|again| again.meets(mosaic, window)) {
            fill(&mut all, &self.read_at_one_place(again, mosaic, window, interpolation)?);
        }
        Ok(all)
    }

    fn read_at_one_place(
        &mut self,
        source: &Source,
        mosaic: &Grid,
        window: Window,
        interpolation: Interpolation,
    ) -> Result<Vec<f64>> {
        // Between two classes of a palette lies none.
        let whole = source.on_grid || !source.palette.is_empty();
        let interpolation = if whole { Interpolation::Nearest } else { interpolation };
        if reduce::is_finer(&source.grid, mosaic) && interpolation != Interpolation::Nearest {
            return self.read_reduced(source, mosaic, window, interpolation);
        }
        let dataset = self.dataset(&source.path)?;
        let mut all = Vec::with_capacity(window.area() as usize * source.bands);
        let mut plane = Vec::new();
        let patch = Patch {
            x: window.x as i64,
            y: window.y as i64,
            width: window.width as usize,
            height: window.height as usize,
        };
        let Some(part) = source.part(mosaic, window) else {
            return Ok(vec![f64::NAN; window.area() as usize * source.bands]);
        };
        let at_edge =
            part.x == 0 || part.y == 0 || part.right() == source.grid.width || part.bottom() == source.grid.height;
        for values in valid_bands(dataset, source, part)? {
            let beside_voids = at_edge || values.iter().any(|v| v.is_nan());
            let cells = Part { grid: source.grid, window: part, values, beyond: f64::NAN };
            if interpolation != Interpolation::Nearest && beside_voids {
                between_what_is_there(cells, mosaic, patch, interpolation, &mut plane)?;
            } else {
                between(&cells, mosaic, patch, interpolation, &mut plane)?;
            }
            all.extend_from_slice(&plane);
        }
        Ok(all)
    }

    /// As [`Opened::read`], of a source whose cells are finer than the mosaic's: means, from strips of bounded size.
    fn read_reduced(
        &mut self,
        source: &Source,
        mosaic: &Grid,
        window: Window,
        interpolation: Interpolation,
    ) -> Result<Vec<f64>> {
        /// Cells of the source that are held at once, in each band.
        const MOST_CELLS: u64 = 1 << 21;
        let Some(part) = source.part(mosaic, window) else {
            return Ok(vec![f64::NAN; window.area() as usize * source.bands]);
        };
        let dataset = self.dataset(&source.path)?;
        let block_rows = dataset.rasterband(1).map_err(|e| Error::gdal(&source.path, e))?.block_size().1 as u64;
        // Rows of whole blocks, that none be decoded twice; windows too wide for those are cut first.
        if part.width * block_rows.min(part.height) > MOST_CELLS && window.width > 1 {
            let Window { x, y, width, height } = window;
            let west = Window::new(x, y, width / 2, height);
            let east = Window::new(west.right(), y, width - west.width, height);
            let mut half = |half: Window| Ok((half, self.read_reduced(source, mosaic, half, interpolation)?));
            return Ok(side_by_side(half(west)?, half(east)?));
        }
        let rows = (MOST_CELLS / part.width).max(1);
        let strip_rows = if rows < block_rows { rows } else { rows / block_rows * block_rows };
        let reaches = Reaches::new(part, (&source.grid, mosaic), window, interpolation);
        let mut means: Vec<_> = (0..source.bands).map(|_| Means::new(&reaches)).collect();
        let mut y = part.y;
        while y < part.bottom() {
            let end = ((y / strip_rows + 1) * strip_rows).min(part.bottom());
            let strip = Window::new(part.x, y, part.width, end - y);
            for (means, values) in means.iter_mut().zip(valid_bands(dataset, source, strip)?) {
                means.add(&values);
            }
            y = end;
        }
        Ok(means.into_iter().flat_map(Means::finish).collect())
    }

    /// What the cells of a source cost; infinite where nobody says.
    ///
    /// # Errors
    /// Those of [`Opened::read`], of the companion.
    pub fn read_companion(&mut self, source: &Source, mosaic: &Grid, window: Window) -> Result<Vec<f64>> {
        let Some(companion) = &source.companion else { return Ok(vec![f64::INFINITY; window.area() as usize]) };
        let mut costs = self.read(companion, mosaic, window, Interpolation::Bilinear)?;
        costs.truncate(window.area() as usize);
        for again in source.again.iter().filter(|again| again.meets(mosaic, window)) {
            fill(&mut costs, &self.read_companion(again, mosaic, window)?);
        }
        Ok(costs)
    }
}

impl Source {
    /// Puts NaN where there is nothing. A picture is nothing where all its colours are nodata: red that is 0 beside
    /// green is a colour. Other bands are read each for itself.
    fn leave_out_nodata(&self, planes: &mut [Vec<f64>]) {
        let (is_picture, colours) = (self.is_picture(), self.deciding_bands());
        for cell in 0..planes.first().map_or(0, Vec::len) {
            let all = is_picture && colours.iter().all(|band| self.forms[*band].is_void(planes[*band][cell]));
            for (plane, form) in planes.iter_mut().zip(&self.forms) {
                let value = &mut plane[cell];
                if all || (!is_picture && form.is_void(*value)) {
                    *value = f64::NAN;
                }
            }
        }
    }
}

/// Puts others where there is nothing.
fn fill(values: &mut [f64], others: &[f64]) {
    values.iter_mut().zip(others).filter(|(value, _)| value.is_nan()).for_each(|(value, other)| *value = *other);
}

/// The values of two windows that lie beside each other, as one; rows of all bands lie below each other.
fn side_by_side((west, left): (Window, Vec<f64>), (east, right): (Window, Vec<f64>)) -> Vec<f64> {
    let lines = left.chunks_exact(west.width as usize).zip(right.chunks_exact(east.width as usize));
    lines.flat_map(|(left, right)| left.iter().chain(right)).copied().collect()
}

/// The bands of a window; NaN where there is nothing.
fn valid_bands(dataset: &Dataset, source: &Source, part: Window) -> Result<Vec<Vec<f64>>> {
    let size = (part.width as usize, part.height as usize);
    let part = source.in_file(part);
    let mut planes = all_bands(dataset, source, part)?;
    source.leave_out_nodata(&mut planes);
    for (number, values) in (1..).zip(&mut planes) {
        // What is transparent is not there: its opacity is no part of a median or a mean either.
        if source.forms[number - 1].is_alpha() {
            values.iter_mut().filter(|value| **value == 0.0).for_each(|value| *value = f64::NAN);
        }
        if source.masked {
            let band = dataset.rasterband(number).map_err(|e| Error::gdal(&source.path, e))?;
            masked::leave_out(&source.path, &band, (part.x as isize, part.y as isize), size, values)?;
        }
        source.order_rows(values, size.0);
    }
    Ok(planes)
}

/// The bands of a window as they are in the file: block by block with all bands, so that a block which holds them all
/// is decoded once whatever the size of GDAL's cache.
fn all_bands(dataset: &Dataset, source: &Source, part: Window) -> Result<Vec<Vec<f64>>> {
    let failed = |e: gdal::errors::GdalError| Error::gdal(&source.path, e);
    let bands = (1..=source.bands).map(|number| dataset.rasterband(number)).collect::<std::result::Result<Vec<_>, _>>();
    let bands = bands.map_err(failed)?;
    let (across, down) = match bands.as_slice() {
        [first, _, ..] => first.block_size(),
        // One band has no others to wait for.
        _ => (part.right() as usize, part.bottom() as usize),
    };
    let mut planes = vec![vec![0.0; part.area() as usize]; source.bands];
    let mut block = Vec::new();
    // From one edge of a block to the next.
    let cuts = |first: u64, end: u64, side: u64| {
        let edges =
            std::iter::successors(Some(first), move |at| Some((at / side + 1) * side)).take_while(move |at| *at < end);
        edges.map(move |at| (at, ((at / side + 1) * side).min(end) - at))
    };
    for (y, height) in cuts(part.y, part.bottom(), down as u64) {
        for (x, width) in cuts(part.x, part.right(), across as u64) {
            let size = (width as usize, height as usize);
            block.resize(size.0 * size.1, 0.0);
            for (band, plane) in bands.iter().zip(&mut planes) {
                band.read_into_slice((x as isize, y as isize), size, size, &mut block, None).map_err(failed)?;
                let at = ((y - part.y) * part.width + (x - part.x)) as usize;
                let lines = plane[at..].chunks_mut(part.width as usize);
                lines.zip(block.chunks_exact(size.0)).for_each(|(to, from)| to[..size.0].copy_from_slice(from));
            }
        }
    }
    Ok(planes)
}
