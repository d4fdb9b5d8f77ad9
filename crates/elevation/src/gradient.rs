//! Hillshade, slope and aspect where a cell's sides are not what the file's units say: degrees, whose length in metres
//! changes from row to row, and feet beside metres. Formulas, borders and rounding are `gdaldem`'s (B. K. P. Horn,
//! *Hill shading and the reflectance map*, 1981; L. W. Zevenbergen and C. R. Thorne, *Quantitative analysis of land
//! surface topography*, 1987; R. K. Mark, *Multidirectional, oblique-weighted, shaded-relief image*, 1992); only the
//! sides differ.

use std::path::Path;

use gdal::raster::GdalType;

use crate::error::Result;
use crate::grid::GroundUnit;
use crate::model::Model;
use crate::output::{self, Cut, Form};
use crate::source::{Heights, Patch};
use crate::window::Window;

/// What `gdaldem` calls no value.
const NO_ANGLE: f32 = -9999.0;

/// How the gradient is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    Horn,
    ZevenbergenThorne,
}

/// What is drawn of the gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Picture {
    /// 1…255 for light from an azimuth; heights are multiplied by `exaggeration`.
    Hillshade {
        azimuth_deg: f64,
        altitude_deg: f64,
        exaggeration: f64,
    },
    /// 1…255 for light from four sides.
    Multidirectional {
        altitude_deg: f64,
        exaggeration: f64,
    },
    SlopeDegrees,
    SlopePercent,
    /// Degrees from north by east.
    Aspect,
}

/// What happens at the border and beside cells without a height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edges {
    LeftOut,
    Extrapolated,
}

/// Whether a model's cells have sides in other units than its heights, so that GDAL would take the one for the other;
/// or, for aspects, whether its rows or columns run the other way, or its cells are no squares, which GDAL overlooks.
///
/// # Errors
/// When the model cannot be opened.
pub fn needs_true_sides(model: &Path, picture: Picture) -> Result<bool> {
    let model = Model::open(model)?;
    let grid = model.grid();
    let is_square = (grid.step_x.abs() / grid.step_y.abs() - 1.0).abs() < 1e-6;
    if picture == Picture::Aspect && (grid.step_x < 0.0 || grid.step_y > 0.0 || !is_square) {
        return Ok(true);
    }
    Ok(match model.ground_unit() {
        GroundUnit::Geographic { .. } | GroundUnit::Stretched(_) => true,
        GroundUnit::Projected { metres_per_unit } => (metres_per_unit / model.metres_per_value() - 1.0).abs() > 1e-4,
    })
}

/// Words for heights that are taken for metres though the map counts in something else.
///
/// # Errors
/// When the model cannot be opened.
pub fn doubtful_unit(model: &Path) -> Result<Option<String>> {
    Ok(Model::open(model)?.doubtful_unit(&model.display().to_string()))
}

/// Draws `model` into `out`, with the true sides of its cells.
///
/// # Errors
/// When a file cannot be read or written.
pub fn draw(model: &Path, out: &Path, picture: Picture, kernel: Kernel, edges: Edges, threads: usize) -> Result<()> {
    let model = Model::open(model)?;
    let byte = matches!(picture, Picture::Hillshade { .. } | Picture::Multidirectional { .. });
    let wkt = autoref_raster::crs::without_heights(out, model.wkt())?;
    let form = Form {
        grid: model.grid(),
        wkt: &wkt,
        bands: 1,
        nodata: Some(if byte { 0.0 } else { f64::from(NO_ANGLE) }),
        predictor: if byte { 2 } else { 3 },
        threads,
    };
    let job = Job { model: &model, picture, kernel, edges };
    if byte {
        // Adding a half and cutting off is how GDAL rounds.
        job.write(out, &form, |value| value.map_or(0, |value| (value + 0.5).clamp(0.0, 255.0) as u8))
    } else {
        job.write(out, &form, |value| value.map_or(NO_ANGLE, |value| value as f32))
    }
}

struct Job<'a> {
    model: &'a Model,
    picture: Picture,
    kernel: Kernel,
    edges: Edges,
}

impl Job<'_> {
    fn write<T: GdalType + Copy + Send>(
        &self,
        out: &Path,
        form: &Form<'_>,
        cast: impl Fn(Option<f64>) -> T + Sync,
    ) -> Result<()> {
        let dataset = output::create::<T>(out, form)?;
        output::produce(
            &form.grid,
            Cut::of_one_band(1024),
            form.threads,
            Vec::new,
            |heights: &mut Vec<f64>, window| {
                self.read(window, heights)?;
                let mut values = Vec::with_capacity((window.width * window.height) as usize);
                let wide = window.width as usize + 2;
                for row in 0..window.height as usize {
                    let y = form.grid.y0 + ((window.y + row as u64) as f64 + 0.5) * form.grid.step_y;
                    let (mx, my) = self.model.ground_unit().metres_per_unit(y);
                    let sides = (form.grid.step_x * mx, form.grid.step_y * my);
                    for column in 0..window.width as usize {
                        let at = |dy: usize, dx: usize| heights[(row + dy) * wide + column + dx];
                        let mut cells = [0.0; 9];
                        for (index, cell) in cells.iter_mut().enumerate() {
                            *cell = at(index / 3, index % 3);
                        }
                        if self.edges == Edges::Extrapolated {
                            let (x, y) = (window.x + column as u64, window.y + row as u64);
                            repeat_corner(&mut cells, (x, y), (form.grid.width, form.grid.height));
                        }
                        values.push(cast(self.value(cells, sides)));
                    }
                }
                Ok(values)
            },
            |window, values| output::put(out, &dataset, window, values),
        )?;
        output::finish(out, dataset)
    }

    /// A window and one cell around it; beyond the model as [`Edges`] asks.
    fn read(&self, window: Window, heights: &mut Vec<f64>) -> Result<()> {
        let (width, height) = (window.width as usize + 2, window.height as usize + 2);
        let patch = Patch { x: window.x as i64 - 1, y: window.y as i64 - 1, width, height };
        self.model.read(patch, heights)?;
        let grid = self.model.grid();
        if self.edges == Edges::LeftOut {
            return Ok(());
        }
        let mut outside = |target: usize, first: usize, second: usize| {
            let value = 2.0 * heights[first] - heights[second];
            heights[target] = if value.is_nan() { heights[first] } else { value };
        };
        if window.y == 0 && height > 3 {
            (0..width).for_each(|x| outside(x, width + x, 2 * width + x));
        }
        if window.y + window.height == grid.height && height > 3 {
            let last = (height - 1) * width;
            (0..width).for_each(|x| outside(last + x, last - width + x, last - 2 * width + x));
        }
        if window.x == 0 && width > 3 {
            (0..height).for_each(|y| outside(y * width, y * width + 1, y * width + 2));
        }
        if window.x + window.width == grid.width && width > 3 {
            (0..height).for_each(|y| outside(y * width + width - 1, y * width + width - 2, y * width + width - 3));
        }
        Ok(())
    }

    /// The picture's value; `None` where there is none. Sides are signed as in a geotransform.
    fn value(&self, mut z: [f64; 9], (side_x, side_y): (f64, f64)) -> Option<f64> {
        let middle = z[4];
        if middle.is_nan() {
            return None;
        }
        if z.iter().any(|height| height.is_nan()) {
            if self.edges == Edges::LeftOut {
                return None;
            }
            z.iter_mut().filter(|height| height.is_nan()).for_each(|height| *height = middle);
        }
        // Rise towards the east and the north.
        let (east, north) = match self.kernel {
            Kernel::Horn => (
                ((z[2] + 2.0 * z[5] + z[8]) - (z[0] + 2.0 * z[3] + z[6])) / (8.0 * side_x),
                ((z[6] + 2.0 * z[7] + z[8]) - (z[0] + 2.0 * z[1] + z[2])) / (8.0 * side_y),
            ),
            Kernel::ZevenbergenThorne => ((z[5] - z[3]) / (2.0 * side_x), (z[7] - z[1]) / (2.0 * side_y)),
        };
        match self.picture {
            Picture::SlopePercent => Some(100.0 * east.hypot(north)),
            Picture::SlopeDegrees => Some(east.hypot(north).atan().to_degrees()),
            Picture::Aspect => aspect(east, north),
            Picture::Hillshade { azimuth_deg, altitude_deg, exaggeration } => {
                let (east, north) = (east * exaggeration, north * exaggeration);
                Some(shade(east, north, azimuth_deg, altitude_deg))
            }
            Picture::Multidirectional { altitude_deg, exaggeration } => {
                let (east, north) = (east * exaggeration, north * exaggeration);
                Some(four_sides(east, north, altitude_deg))
            }
        }
    }
}

/// In the four corners GDAL extrapolates along the column alone and repeats it beyond the side.
fn repeat_corner(cells: &mut [f64; 9], (x, y): (u64, u64), (width, height): (u64, u64)) {
    if y != 0 && y + 1 != height {
        return;
    }
    for row in cells.chunks_exact_mut(3) {
        if x == 0 {
            row[0] = row[1];
        }
        if x + 1 == width {
            row[2] = row[1];
        }
    }
}

/// Where the ground falls to; nowhere on the level.
fn aspect(east: f64, north: f64) -> Option<f64> {
    if east == 0.0 && north == 0.0 {
        return None;
    }
    let degrees = (-east).atan2(-north).to_degrees();
    let turned = if degrees < 0.0 { degrees + 360.0 } else { degrees };
    Some(if turned >= 360.0 { 0.0 } else { turned })
}

/// The cosine between the normal and the light, 1…255.
fn shade(east: f64, north: f64, azimuth_deg: f64, altitude_deg: f64) -> f64 {
    let (azimuth, altitude) = (azimuth_deg.to_radians(), altitude_deg.to_radians());
    let towards = east * azimuth.sin() + north * azimuth.cos();
    let cosine = (altitude.sin() - altitude.cos() * towards) / (1.0 + east * east + north * north).sqrt();
    if cosine <= 0.0 { 1.0 } else { 1.0 + 254.0 * cosine }
}

/// Shades from 225°, 270°, 315° and 360°, each weighed by the square of the cosine between aspect and light, as GDAL
/// does.
fn four_sides(east: f64, north: f64, altitude_deg: f64) -> f64 {
    let altitude = altitude_deg.to_radians();
    let steepness = east * east + north * north;
    if steepness == 0.0 {
        return 1.0 + 254.0 * altitude.sin();
    }
    let sum: f64 = [225.0, 270.0, 315.0, 360.0f64]
        .iter()
        .map(|azimuth| {
            let (sine, cosine) = azimuth.to_radians().sin_cos();
            let value = altitude.sin() - altitude.cos() * (east * sine + north * cosine);
            let along = (east * sine + north * cosine).powi(2);
            along * value.max(0.0)
        })
        .sum();
    1.0 + 127.0 * sum / steepness / (1.0 + steepness).sqrt()
}

#[cfg(test)]
mod tests {
    use super::aspect;

    #[test]
    fn aspects_point_downhill_clockwise_from_north() {
        // Heights that rise to the west fall to the east.
        let near = |east, north, degrees: f64| (aspect(east, north).expect("a slope") - degrees).abs() < 1e-9;
        assert!(near(-1.0, 0.0, 90.0) && near(0.0, 1.0, 180.0) && near(1.0, 0.0, 270.0) && near(-1.0, -1.0, 45.0));
        assert!(aspect(0.0, 0.0).is_none());
    }
}
