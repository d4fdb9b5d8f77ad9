//! The orthophoto's pixels, tile by tile, and the file that they go to.

use std::path::Path;

use autoref_elevation::grid::Grid;
use autoref_elevation::output::{self, Cut, Form};
use autoref_flight::ortho::{Place, View};
use autoref_raster::cloud_optimised::{self, Overviews};
use autoref_raster::error::{Error as RasterError, Result as RasterResult};
use autoref_raster::keys;
use autoref_raster::masked::has_mask;
use autoref_raster::set_unit;
use autoref_raster::window::Window;
use gdal::raster::{Buffer, ColorInterpretation, GdalType, RasterBand};
use gdal::{Dataset, Metadata as _};

use super::OrthorectifyArgs;
use super::model::open;
use super::place::Lattice;

/// An orthophoto to be drawn.
pub(super) struct Job<'a> {
    pub args: &'a OrthorectifyArgs,
    pub view: &'a View<'a>,
    pub lattice: &'a Lattice,
    /// Of the orthophoto, in units of the map, and in metres.
    pub grid: Grid,
    pub grid_m: Grid,
    /// Samples a side in a pixel.
    pub oversampling: usize,
    pub threads: usize,
    pub tile_px: u64,
    pub budget_bytes: u64,
}

/// Bands of the frame that are drawn, and what a pixel that is seen has in the alpha band beside them, if there is one.
struct Bands {
    of_frame: Vec<Drawn>,
    alpha: Option<f32>,
    /// The frame has an alpha band or a mask.
    masked: bool,
}

/// A band of the frame, or one colour of its palette.
struct Drawn {
    band: usize,
    /// The colour of each number; NaN where it is transparent.
    colours: Option<Vec<f32>>,
    /// What is said of the band; of a palette's colours nothing.
    said: Said,
}

/// What a file says of a band.
#[derive(Default)]
struct Said {
    name: String,
    unit: String,
    /// Factor and summand of its numbers, where they are not 1 and 0.
    scale: Option<(f64, f64)>,
}

impl Bands {
    fn of(path: &Path, frame: &Dataset, alpha: Option<f32>) -> RasterResult<Bands> {
        let mut of_frame = Vec::new();
        let failed = |e| RasterError::gdal(path, e);
        for number in 1..=frame.raster_count() {
            let band = frame.rasterband(number).map_err(failed)?;
            match (band.color_interpretation(), band.color_table()) {
                (ColorInterpretation::AlphaBand, _) => {}
                (ColorInterpretation::PaletteIndex, Some(table)) => {
                    let entry = |i| table.entry_as_rgb(i).map_or([0; 4], |c| [c.r, c.g, c.b, c.a]);
                    let entries: Vec<[i16; 4]> = (0..table.entry_count()).map(entry).collect();
                    for colour in 0..3 {
                        let of = |e: &[i16; 4]| if e[3] == 0 { f32::NAN } else { f32::from(e[colour]) };
                        let colours = Some(entries.iter().map(of).collect());
                        of_frame.push(Drawn { band: number, colours, said: Said::default() });
                    }
                }
                _ => of_frame.push(Drawn { band: number, colours: None, said: Said::of(&band) }),
            }
        }
        let masked = has_mask(path, &frame.rasterband(1).map_err(failed)?)?;
        Ok(Bands { of_frame, alpha, masked })
    }

    /// Whether bands are colours of one picture, whose pixel is nodata where all of them are: a red that is the number
    /// of nodata is a colour beside others. Bands of floats have each their own NaN.
    fn are_one_picture(&self) -> bool {
        self.alpha.is_some() && self.of_frame.len() > 1
    }
}

impl Said {
    fn of(band: &RasterBand<'_>) -> Said {
        let scale = Some((band.scale().unwrap_or(1.0), band.offset().unwrap_or(0.0))).filter(|s| *s != (1.0, 0.0));
        Said { name: band.description().unwrap_or_default(), unit: band.unit(), scale }
    }

    /// Says the same of a band of another file.
    fn write(&self, path: &Path, band: &mut RasterBand<'_>) -> RasterResult<()> {
        let failed = |e: gdal::errors::GdalError| RasterError::gdal(path, e);
        if !self.name.is_empty() {
            band.set_description(&self.name).map_err(failed)?;
        }
        if let Some((factor, summand)) = self.scale {
            band.set_scale(factor).and_then(|()| band.set_offset(summand)).map_err(failed)?;
        }
        if self.unit.is_empty() { Ok(()) } else { set_unit(path, band, &self.unit) }
    }
}

/// A number of the frame and back; rounding where the type is whole.
pub(super) trait Sample: GdalType + Copy + Default + Send {
    const NONE: Self;
    fn of(v: f32) -> Self;
}

impl Sample for u8 {
    const NONE: Self = 0;
    fn of(v: f32) -> Self {
        v.round().clamp(0.0, 255.0) as u8
    }
}
impl Sample for u16 {
    const NONE: Self = 0;
    fn of(v: f32) -> Self {
        v.round().clamp(0.0, 65535.0) as u16
    }
}
impl Sample for f32 {
    const NONE: Self = f32::NAN;
    fn of(v: f32) -> Self {
        v
    }
}

impl Job<'_> {
    /// Writes the orthophoto with an alpha band of `alpha` where it is seen, or without one with NaN where it is not.
    pub fn write<T: Sample>(&self, out: &Path, wkt: &str, alpha: Option<f32>) -> anyhow::Result<u64> {
        let frame = open(&self.args.frame)?;
        let bands = Bands::of(&self.args.frame, &frame, alpha)?;
        drop(frame);
        let form = Form {
            grid: self.grid,
            wkt,
            bands: bands.of_frame.len() + usize::from(alpha.is_some()),
            nodata: alpha.is_none().then_some(f64::NAN),
            predictor: if alpha.is_some() { 2 } else { 3 },
            threads: self.threads,
        };
        // `None` until the whole is drawn.
        let mut seen = None;
        let written = autoref_raster::atomic::with_temporary(out, |temporary| {
            let plain = temporary.with_extension("plain.tif");
            let result = self.stream::<T>(&plain, &form, &bands).and_then(|count| {
                seen = Some(count);
                // An empty picture is left out: the error only takes the temporary file away.
                if count == 0 { Err(RasterError::usage("nothing is seen", "")) } else { Ok(()) }
            });
            let result =
                result.and_then(|()| cloud_optimised::copy(&plain, temporary, Overviews::Average, self.threads));
            let _ = std::fs::remove_file(&plain);
            result
        });
        if seen == Some(0) {
            return Err(autoref_flight::Error::no_result(
                format!("no pixel of an orthophoto is seen by {}", self.args.frame.display()),
                "look at the camera's position and angles, the heights of --dem, and --gsd",
            )
            .into());
        }
        written?;
        Ok(seen.unwrap_or(0))
    }

    /// How many pixels are seen.
    fn stream<T: Sample>(&self, plain: &Path, form: &Form<'_>, bands: &Bands) -> RasterResult<u64> {
        let mut seen = 0;
        let dataset = output::create::<T>(plain, form)?;
        if bands.alpha.is_some() {
            let mut band = dataset.rasterband(form.bands).map_err(|e| RasterError::gdal(plain, e))?;
            band.set_color_interpretation(ColorInterpretation::AlphaBand).map_err(|e| RasterError::gdal(plain, e))?;
        }
        for (index, drawn) in bands.of_frame.iter().enumerate() {
            let mut band = dataset.rasterband(index + 1).map_err(|e| RasterError::gdal(plain, e))?;
            drawn.said.write(plain, &mut band)?;
        }
        output::produce(
            &self.grid,
            Cut { tile_px: self.tile_px, block_px: output::block_px(form.bands) },
            self.threads,
            || None,
            |source: &mut Option<Dataset>, window| {
                if source.is_none() {
                    let path = &self.args.frame;
                    *source = Some(Dataset::open(path).map_err(|e| RasterError::gdal(path, e))?);
                }
                let Some(frame) = source.as_ref() else { return Ok((Vec::new(), 0)) };
                let mut values = vec![T::NONE; window.area() as usize * form.bands];
                let count = self.tile::<T>(frame, bands, window, window, &mut values)?;
                Ok((values, count))
            },
            |window, (values, count)| {
                seen += count;
                output::put(plain, &dataset, window, values)
            },
        )?;
        output::finish(plain, dataset)?;
        Ok(seen)
    }

    /// Fills `part` of the tile `whole`; a part that needs too much of the frame at once is done in halves.
    fn tile<T: Sample>(
        &self,
        frame: &Dataset,
        bands: &Bands,
        whole: Window,
        part: Window,
        values: &mut [T],
    ) -> RasterResult<u64> {
        let samples = self.samples(part);
        let Some(seen) = samples.window(frame.raster_size()) else { return Ok(0) };
        let most = self.budget_bytes / 4 / self.threads.max(1) as u64;
        if seen.area() * bands.of_frame.len() as u64 * 4 > most && part.area() > 1 {
            drop(samples);
            let mut count = 0;
            for half in halves(part) {
                count += self.tile(frame, bands, whole, half, values)?;
            }
            return Ok(count);
        }
        let planes = self.planes(frame, bands, seen)?;
        let n = self.oversampling;
        let area = whole.area() as usize;
        let mut count = 0;
        for (index, samples) in samples.places.chunks_exact(n * n).enumerate() {
            let (x, y) = (part.x + index as u64 % part.width, part.y + index as u64 / part.width);
            let at = ((y - whole.y) * whole.width + x - whole.x) as usize;
            let mut visible = false;
            for (k, plane) in planes.iter().enumerate() {
                if let Some(value) = plane.mean(samples) {
                    values[k * area + at] = T::of(value);
                    visible = true;
                }
            }
            if visible {
                count += 1;
                if let Some(opaque) = bands.alpha {
                    values[planes.len() * area + at] = T::of(opaque);
                }
            }
        }
        Ok(count)
    }

    /// Where the frame shows the samples of the pixels of `part`.
    fn samples(&self, part: Window) -> Samples {
        let n = self.oversampling;
        let mut places: Vec<[f32; 2]> = Vec::with_capacity(part.area() as usize * n * n);
        let mut bounds = [f32::MAX, f32::MAX, f32::MIN, f32::MIN];
        for y in part.y..part.bottom() {
            for x in part.x..part.right() {
                for k in 0..n * n {
                    let column = x as f64 + ((k % n) as f64 + 0.5) / n as f64;
                    let row = y as f64 + ((k / n) as f64 + 0.5) / n as f64;
                    let map = [self.grid_m.x0 + self.grid_m.step_x * column, self.grid_m.y0 + self.grid_m.step_y * row];
                    let place = self.view.at(map[0], map[1], |h| self.lattice.at(column, row, h));
                    let pixel = if let Place::Pixel(p) = place { [p[0] as f32, p[1] as f32] } else { [f32::NAN; 2] };
                    if !pixel[0].is_nan() {
                        bounds = [
                            bounds[0].min(pixel[0]),
                            bounds[1].min(pixel[1]),
                            bounds[2].max(pixel[0]),
                            bounds[3].max(pixel[1]),
                        ];
                    }
                    places.push(pixel);
                }
            }
        }
        Samples { places, bounds }
    }

    /// A window of the frame's bands.
    fn planes(&self, frame: &Dataset, bands: &Bands, window: Window) -> RasterResult<Vec<Plane>> {
        let failed = |e| RasterError::gdal(&self.args.frame, e);
        let (corner, size) = ([window.x as f32, window.y as f32], (window.width as usize, window.height as usize));
        let at = (window.x as isize, window.y as isize);
        let there: Option<Buffer<u8>> = match bands.masked {
            true => {
                let band = frame.rasterband(1).map_err(failed)?;
                Some(band.open_mask_band().and_then(|mask| mask.read_as(at, size, size, None)).map_err(failed)?)
            }
            false => None,
        };
        let is_picture = bands.are_one_picture();
        // In how many bands a pixel is nodata.
        let mut empty = vec![0usize; size.0 * size.1];
        let mut plane = |drawn: &Drawn| -> RasterResult<Plane> {
            let band = frame.rasterband(drawn.band).map_err(failed)?;
            let read: Buffer<f32> = band.read_as(at, size, size, None).map_err(failed)?;
            let nodata = band.no_data_value().map(|v| v as f32);
            let mut values = read.into_shape_and_vec().1;
            for (value, empty) in values.iter_mut().zip(&mut empty) {
                let is_nodata = Some(*value) == nodata;
                *empty += usize::from(is_nodata);
                *value = match &drawn.colours {
                    _ if is_nodata && !is_picture => f32::NAN,
                    Some(colours) => colours.get(*value as usize).copied().unwrap_or(f32::NAN),
                    None => *value,
                };
            }
            Ok(Plane { corner, size, values })
        };
        let mut planes = bands.of_frame.iter().map(&mut plane).collect::<RasterResult<Vec<Plane>>>()?;
        let is_empty =
            |k: usize| is_picture && empty[k] == planes.len() || there.as_ref().is_some_and(|t| t.data()[k] == 0);
        let left_out: Vec<usize> = (0..empty.len()).filter(|k| is_empty(*k)).collect();
        for plane in &mut planes {
            left_out.iter().for_each(|k| plane.values[*k] = f32::NAN);
        }
        Ok(planes)
    }
}

/// Samples of a part of the orthophoto.
struct Samples {
    /// Pixels of the frame, row by row, NaN where it sees nothing.
    places: Vec<[f32; 2]>,
    /// Least and greatest column and row; upside down where it sees nothing at all.
    bounds: [f32; 4],
}

impl Samples {
    /// What of a frame of this size they are interpolated from; `None` where it sees nothing.
    fn window(&self, (columns, rows): (usize, usize)) -> Option<Window> {
        let bounds = self.bounds;
        if bounds[0] > bounds[2] {
            return None;
        }
        let low = |v: f32| (f64::from(v) - 3.0).floor().max(0.0) as u64;
        let (x0, y0) = (low(bounds[0]), low(bounds[1]));
        let (x1, y1) = ((bounds[2] as u64 + 4).min(columns as u64), (bounds[3] as u64 + 4).min(rows as u64));
        Some(Window::new(x0, y0, x1 - x0, y1 - y0))
    }
}

/// Two parts of a window, across its longer side.
fn halves(part: Window) -> [Window; 2] {
    if part.width >= part.height {
        let w = part.width / 2;
        [Window::new(part.x, part.y, w, part.height), Window::new(part.x + w, part.y, part.width - w, part.height)]
    } else {
        let h = part.height / 2;
        [Window::new(part.x, part.y, part.width, h), Window::new(part.x, part.y + h, part.width, part.height - h)]
    }
}

/// A window of a band of the frame.
struct Plane {
    corner: [f32; 2],
    size: (usize, usize),
    /// NaN where the frame holds nothing.
    values: Vec<f32>,
}

impl Plane {
    /// Mean over those samples that have a value, where half of all have one: a pixel of which less is seen shows other
    /// ground than its own.
    fn mean(&self, samples: &[[f32; 2]]) -> Option<f32> {
        let (mut sum, mut count) = (0.0f32, 0usize);
        for p in samples.iter().filter(|p| !p[0].is_nan()) {
            let at = [p[0] - self.corner[0], p[1] - self.corner[1]];
            if let Some(v) = cubic(&self.values, self.size, at) {
                sum += v;
                count += 1;
            }
        }
        (count > 0 && 2 * count >= samples.len()).then(|| sum / count as f32)
    }
}

/// Keys' cubic convolution (1981, a = −1/2) at a place that counts from the outer corner; the nearest pixel beside
/// pixels that hold nothing. Beyond the window's border its last pixels go on: windows reach further than the kernel
/// except at the frame's own border.
fn cubic(plane: &[f32], size: (usize, usize), at: [f32; 2]) -> Option<f32> {
    let (u, v) = (at[0] - 0.5, at[1] - 0.5);
    let (i, j) = (u.floor(), v.floor());
    let (wx, wy) = (keys::weights(u - i), keys::weights(v - j));
    let clamp = |v: f32, n: usize| (v.max(0.0) as usize).min(n - 1);
    let pixel = |x: f32, y: f32| plane[clamp(y, size.1) * size.0 + clamp(x, size.0)];
    let (mut sum, mut low, mut high) = (0.0, f32::MAX, f32::MIN);
    for (b, wy) in wy.iter().enumerate() {
        for (a, wx) in wx.iter().enumerate() {
            let value = pixel(i + a as f32 - 1.0, j + b as f32 - 1.0);
            if value.is_nan() {
                let nearest = pixel((u + 0.5).floor(), (v + 0.5).floor());
                return (!nearest.is_nan()).then_some(nearest);
            }
            (low, high) = (low.min(value), high.max(value));
            sum += wx * wy * value;
        }
    }
    // No ringing beside edges.
    Some(sum.clamp(low, high))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_seen_where_half_of_its_samples_are() {
        let plane = Plane { corner: [0.0; 2], size: (4, 4), values: vec![7.0; 16] };
        let samples = |seen: usize| -> Vec<[f32; 2]> {
            (0..9).map(|k| if k < seen { [2.0, 2.0] } else { [f32::NAN; 2] }).collect()
        };
        assert_eq!([0, 1, 4, 5, 9].map(|seen| plane.mean(&samples(seen))), [None, None, None, Some(7.0), Some(7.0)]);
        assert_eq!(plane.mean(&samples(9)[..1]), Some(7.0));
        assert_eq!(plane.mean(&[[2.0, 2.0], [2.0, 2.0], [f32::NAN; 2], [f32::NAN; 2]]), Some(7.0));
    }
}
