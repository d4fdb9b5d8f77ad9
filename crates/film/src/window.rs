//! Windows of a scan as grey floats, decimated while they are read.

use std::path::Path;
use std::sync::Arc;

use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::simd::{Kernel, widest};
use autoref_raster::window::Window;
use autoref_raster::{
    Block, BlockLayout, Piece, PieceData, PixelRow, RasterInfo, RasterSource, ReadStats, SampleType, Samples,
};

/// Rows read at a time: what is held of the file while a large window is decimated.
const BAND_ROWS: u64 = 512;

/// Grey values, 0 black to 1 white, row-major. Of colour scans each pixel's largest band: marks are exposed in one
/// colour (red on Wild frames) and would be lost in a mean.
#[derive(Clone, Debug)]
pub struct Grey {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
    /// Pixel of the scan at the outer corner of the first value; negative where values were added before the scan's
    /// edge.
    pub origin: [i64; 2],
    /// Pixels of the scan along one value.
    pub factor: u64,
}

impl Grey {
    /// The value in column `x` and row `y`.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.data[y * self.width + x]
    }

    /// From a place in units of values (0 the outer corner of the first) to the scan's pixels.
    pub fn to_scan(&self, x: f64, y: f64) -> PixelPoint {
        let f = self.factor as f64;
        PixelPoint { x: self.origin[0] as f64 + f * x, y: self.origin[1] as f64 + f * y }
    }

    /// From the scan's pixels to a place in units of values, 0 the outer corner of the first.
    pub fn from_scan(&self, p: PixelPoint) -> [f64; 2] {
        let f = self.factor as f64;
        [(p.x - self.origin[0] as f64) / f, (p.y - self.origin[1] as f64) / f]
    }

    /// With `by` more values along the sides that lie at the scan's edge, each as the one it follows. A mark that lies
    /// whole in the scan but close to its edge then keeps room for its decimated picture, which reaches up to two
    /// values further.
    pub fn beyond_edges(self, scan: &Window, by: usize) -> Grey {
        let step = self.factor as i64;
        let end = |k: usize, n: usize| self.origin[k] + (n as i64 + 1) * step;
        let before = [0, 1].map(|k| if self.origin[k] < step { by } else { 0 });
        let after = [(0, self.width, scan.width), (1, self.height, scan.height)]
            .map(|(k, n, size)| if end(k, n) > size as i64 { by } else { 0 });
        if self.data.is_empty() || before == [0, 0] && after == [0, 0] {
            return self;
        }
        let (width, height) = (before[0] + self.width + after[0], before[1] + self.height + after[1]);
        let nearest = |v: usize, before: usize, n: usize| v.saturating_sub(before).min(n - 1);
        let data = (0..width * height)
            .map(|i| self.at(nearest(i % width, before[0], self.width), nearest(i / width, before[1], self.height)))
            .collect();
        let origin = [0, 1].map(|k| self.origin[k] - before[k] as i64 * step);
        Grey { width, height, data, origin, factor: self.factor }
    }

    /// Means over `by` × `by` values; what does not fill a block at the right and lower edge is left away.
    pub fn decimated(&self, by: usize) -> Grey {
        if by == 1 {
            return self.clone();
        }
        let (width, height) = (self.width / by, self.height / by);
        let mut data = vec![0.0f32; width * height];
        let scale = 1.0 / (by * by) as f32;
        for y in 0..height * by {
            let row = &self.data[y * self.width..][..width * by];
            let out = &mut data[y / by * width..][..width];
            match by {
                2 => add_means::<2>(row, scale, out),
                4 => add_means::<4>(row, scale, out),
                _ => out
                    .iter_mut()
                    .zip(row.chunks_exact(by))
                    .for_each(|(o, part)| *o += part.iter().sum::<f32>() * scale),
            }
        }
        Grey { width, height, data, origin: self.origin, factor: self.factor * by as u64 }
    }
}

/// Adds the sum of every `N` values, scaled.
fn add_means<const N: usize>(row: &[f32], scale: f32, out: &mut [f32]) {
    for (o, part) in out.iter_mut().zip(row.as_chunks::<N>().0) {
        *o += part.iter().sum::<f32>() * scale;
    }
}

/// Samples of a pixel that [`read_rows`] gives: beside the grey one, where the scan says which pixels hold something,
/// an alpha sample. A grey scan's nodata value needs none.
pub(super) fn samples_of_rows(info: &RasterInfo) -> usize {
    let [r, g, b] = info.rgb;
    let is_colour = r != g || r != b;
    if info.alpha.is_some() || info.nodata_sample().is_some() && is_colour { 2 } else { 1 }
}

/// Gives every row of a scan as grey samples, from top to bottom; holds 64 rows. Of two samples a pixel
/// the second is 0 where the scan holds nothing, else 1.
///
/// # Errors
/// Those of reading and of `sink`.
pub fn read_rows(source: &dyn RasterSource, sink: &mut dyn FnMut(&[u16]) -> Result<()>) -> Result<()> {
    let from = source.info();
    let [r, g, b] = from.rgb;
    let samples = samples_of_rows(from);
    let width = from.width as usize;
    let mut rows = vec![0u16; samples * width * 64];
    let mut top = 0;
    while top < from.height {
        let band = Window::new(0, top, from.width, 64.min(from.height - top));
        rows.fill(0);
        let block = source.read(band)?;
        for piece in block.pieces.iter().filter(|p| !p.empty) {
            let part = piece.window.intersect(&band);
            for y in part.y..part.bottom() {
                let row = piece.row(part.x, y, part.width);
                let out = &mut rows[samples * ((y - top) as usize * width + part.x as usize)..][..samples * row.len];
                let stride = row.pixel_stride;
                let out = out.iter_mut().step_by(samples).enumerate();
                match row.samples {
                    Samples::U8(s) => out.for_each(|(i, o)| {
                        let p = &s[i * stride..];
                        *o = u16::from(p[r].max(p[g]).max(p[b]));
                    }),
                    Samples::U16(s) => out.for_each(|(i, o)| {
                        let p = &s[i * stride..];
                        *o = p[r].max(p[g]).max(p[b]);
                    }),
                }
            }
        }
        if samples == 2 {
            let valid = block.to_patch(from).valid;
            rows.iter_mut().skip(1).step_by(2).zip(valid).for_each(|(alpha, valid)| *alpha = u16::from(valid));
        }
        for row in rows.chunks(samples * width).take(band.height as usize) {
            sink(row)?;
        }
        top = band.bottom();
    }
    Ok(())
}

/// A scan held in memory, one band of 8 or 16 bits, and an alpha band where its rows have two samples a pixel.
pub struct GreySource {
    info: RasterInfo,
    data: GreyData,
}

enum GreyData {
    U8(Arc<autoref_raster::PooledBytes>),
    U16(Arc<Vec<u16>>),
}

impl GreySource {
    /// # Panics
    /// When `data` does not hold `width · height` samples.
    pub fn new(path: &Path, width: u64, height: u64, data: Vec<u16>) -> Self {
        assert_eq!(data.len() as u64, width * height, "one sample a pixel");
        let info = grey_info(path, width, height, SampleType::U16, 65_535);
        GreySource { info, data: GreyData::U16(Arc::new(data)) }
    }

    pub(super) fn read_whole(source: &dyn RasterSource) -> Result<Self> {
        let from = source.info();
        let info = decoded_info(from);
        let (mut bytes, mut words): (Vec<u8>, Vec<u16>) = (vec![], vec![]);
        read_rows(source, &mut |row| {
            match from.sample {
                SampleType::U8 => bytes.extend(row.iter().map(|v| *v as u8)),
                SampleType::U16 => words.extend_from_slice(row),
            }
            Ok(())
        })?;
        let data = match from.sample {
            SampleType::U8 => GreyData::U8(Arc::new(autoref_raster::PooledBytes { bytes, home: None })),
            SampleType::U16 => GreyData::U16(Arc::new(words)),
        };
        Ok(GreySource { info, data })
    }
}

/// What is known of a scan that [`read_rows`] decoded.
pub(super) fn decoded_info(from: &RasterInfo) -> RasterInfo {
    let grey = grey_info(&from.path, from.width, from.height, from.sample, from.white);
    let geotransform = from.geotransform;
    if samples_of_rows(from) == 2 {
        RasterInfo { bands: 2, alpha: Some(1), geotransform, ..grey }
    } else {
        RasterInfo { nodata: from.nodata, geotransform, ..grey }
    }
}

/// What is known of a grey picture in memory.
pub fn grey_info(path: &Path, width: u64, height: u64, sample: SampleType, white: u16) -> RasterInfo {
    RasterInfo {
        path: path.to_path_buf(),
        width,
        height,
        bands: 1,
        sample,
        rgb: [0, 0, 0],
        alpha: None,
        nodata: None,
        white,
        layout: BlockLayout::Strips { rows: 1 },
        blocks: height,
        chunk_bytes: 0,
        sequential: false,
        reader: "memory",
        description: "grey in memory".into(),
        geotransform: None,
        crs_wkt: None,
        resolution_m_per_px: None,
    }
}

impl RasterSource for GreySource {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read(&self, window: Window) -> Result<Block> {
        let width = self.info.width as usize;
        let data = match &self.data {
            GreyData::U8(bytes) => PieceData::U8(bytes.clone()),
            GreyData::U16(words) => PieceData::U16(words.clone()),
        };
        let pixel_stride = self.info.bands;
        let offset = (window.y as usize * width + window.x as usize) * pixel_stride;
        let piece = Piece { window, data, offset, row_stride: width * pixel_stride, pixel_stride, empty: false };
        Ok(Block { window, pieces: vec![piece] })
    }

    fn stats(&self) -> ReadStats {
        ReadStats::default()
    }
}

/// Reads `window` (clipped to the scan) and averages `factor` × `factor` pixels into one value. What the reader keeps
/// of the window stays: who reads a place for the last time calls [`RasterSource::release`].
///
/// # Errors
/// Those of [`RasterSource::read`].
pub fn read_grey(source: &dyn RasterSource, window: Window, factor: u64) -> Result<Grey> {
    read_pieces(source, window, factor, &mut |_, _| {})
}

/// As [`read_grey`], and which values hold something: `None` where all do. A value of which a pixel holds nothing
/// (nodata, zero alpha, a block that the file leaves out) does not.
///
/// # Errors
/// Those of [`RasterSource::read`].
pub(super) fn read_grey_valid(
    source: &dyn RasterSource,
    window: Window,
    factor: u64,
) -> Result<(Grey, Option<Vec<bool>>)> {
    let info = source.info();
    let tells = info.alpha.is_some() || info.nodata_sample().is_some();
    let whole = window.intersect(&info.bounds());
    let (width, height) = ((whole.width / factor) as usize, (whole.height / factor) as usize);
    let mut holds: Option<Vec<bool>> = None;
    let mut leave_out = |x: u64, y: u64| {
        let (i, j) = (((x - whole.x) / factor) as usize, ((y - whole.y) / factor) as usize);
        if i < width && j < height {
            holds.get_or_insert_with(|| vec![true; width * height])[j * width + i] = false;
        }
    };
    let grey = read_pieces(source, window, factor, &mut |block, band| {
        for piece in block.pieces.iter().filter(|p| p.empty || tells) {
            let part = piece.window.intersect(band);
            // A few rows at a time: a block may be as wide as the scan.
            for y in (part.y..part.bottom()).step_by(16) {
                let rows = Window::new(part.x, y, part.width, 16.min(part.bottom() - y));
                let valid = block.patch(rows, info).valid;
                for (i, _) in valid.iter().enumerate().filter(|(_, valid)| !**valid) {
                    leave_out(rows.x + i as u64 % rows.width, rows.y + i as u64 / rows.width);
                }
            }
        }
    })?;
    Ok((grey, holds))
}

/// [`read_grey`] that shows every block to `look`, with the part of the window that it was read for.
fn read_pieces(
    source: &dyn RasterSource,
    window: Window,
    factor: u64,
    look: &mut dyn FnMut(&Block, &Window),
) -> Result<Grey> {
    let info = source.info();
    let window = window.intersect(&info.bounds());
    let (width, height) = ((window.width / factor) as usize, (window.height / factor) as usize);
    let mut grey =
        Grey { width, height, data: vec![0.0; width * height], origin: [window.x as i64, window.y as i64], factor };
    if width == 0 || height == 0 {
        return Ok(grey);
    }
    let used = Window::new(window.x, window.y, width as u64 * factor, height as u64 * factor);
    let band_rows = (BAND_ROWS / factor).max(1) * factor;
    let scale = 1.0 / (factor * factor) as f32 / f32::from(info.white.max(1));
    let mut top = used.y;
    while top < used.bottom() {
        let band = Window::new(used.x, top, used.width, band_rows.min(used.bottom() - top));
        let block = source.read(band)?;
        look(&block, &band);
        for piece in block.pieces.iter().filter(|p| !p.empty) {
            let part = piece.window.intersect(&band);
            for y in part.y..part.bottom() {
                let row = piece.row(part.x, y, part.width);
                let out = &mut grey.data[((y - used.y) / factor) as usize * width..][..width];
                add_row(&row, info, part.x - used.x, factor, scale, out);
            }
        }
        top = band.bottom();
    }
    Ok(grey)
}

/// Adds the pixels of a row, from column `first` of the window, to the values they belong to.
fn add_row(row: &PixelRow, info: &RasterInfo, first: u64, factor: u64, scale: f32, out: &mut [f32]) {
    if row.pixel_stride == 1 {
        return match row.samples {
            Samples::U8(s) => add_grey(&s[..row.len], first, factor, scale, out),
            Samples::U16(s) => add_grey(&s[..row.len], first, factor, scale, out),
        };
    }
    let [r, g, b] = info.rgb;
    let stride = row.pixel_stride;
    let (mut at, mut within) = ((first / factor) as usize, first % factor);
    let mut sum = 0u32;
    let mut put = |value: u32| {
        sum += value;
        within += 1;
        if within == factor {
            out[at] += sum as f32 * scale;
            (at, within, sum) = (at + 1, 0, 0);
        }
    };
    match row.samples {
        Samples::U8(s) if r == b => (0..row.len).for_each(|i| put(u32::from(s[i * stride + r]))),
        Samples::U8(s) => (0..row.len).for_each(|i| {
            let p = &s[i * stride..];
            put(u32::from(p[r].max(p[g]).max(p[b])));
        }),
        Samples::U16(s) => (0..row.len).for_each(|i| {
            let p = &s[i * stride..];
            put(u32::from(p[r].max(p[g]).max(p[b])));
        }),
    }
    if within > 0 && at < out.len() {
        out[at] += sum as f32 * scale;
    }
}

/// [`add_row`] where a pixel is one sample.
fn add_grey<S: Copy + Into<u32>>(samples: &[S], first: u64, factor: u64, scale: f32, out: &mut [f32]) {
    let at = (first / factor) as usize;
    let sum = |part: &[S]| part.iter().map(|v| (*v).into()).sum::<u32>() as f32 * scale;
    // What belongs to a value that an earlier piece began.
    let begun = ((factor - first % factor) % factor).min(samples.len() as u64) as usize;
    let (head, rest) = samples.split_at(begun);
    if !head.is_empty() {
        out[at] += sum(head);
    }
    let out = &mut out[at + usize::from(!first.is_multiple_of(factor))..];
    match factor {
        1 => out.iter_mut().zip(rest).for_each(|(o, v)| *o += (*v).into() as f32 * scale),
        2 => add_even::<S, 2>(rest, scale, out),
        4 => add_even::<S, 4>(rest, scale, out),
        8 => add_even::<S, 8>(rest, scale, out),
        _ => out.iter_mut().zip(rest.chunks(factor as usize)).for_each(|(o, part)| *o += sum(part)),
    }
}

/// Sums of `N` samples each; the last may be of fewer.
fn add_even<S: Copy + Into<u32>, const N: usize>(samples: &[S], scale: f32, out: &mut [f32]) {
    let (whole, rest) = samples.as_chunks::<N>();
    for (o, part) in out.iter_mut().zip(whole) {
        *o += part.iter().map(|v| (*v).into()).sum::<u32>() as f32 * scale;
    }
    if let Some(o) = out.get_mut(whole.len())
        && !rest.is_empty()
    {
        *o += rest.iter().map(|v| (*v).into()).sum::<u32>() as f32 * scale;
    }
}

/// Gaussian of standard deviation `sigma` values, in place; beyond an edge its last value goes on.
pub(super) fn blur(values: &mut [f32], width: usize, height: usize, sigma: f64) {
    if width == 0 || height == 0 {
        return;
    }
    widest(Blur { values, width, height, kernel: &gaussian(sigma) });
}

/// Weights of a Gaussian of standard deviation `sigma` values, from its middle outwards; both sides are the same.
pub(super) fn gaussian(sigma: f64) -> Vec<f32> {
    let reach = (3.0 * sigma).ceil() as i64;
    let weight = |k: i64| (-0.5 * (k as f64 / sigma).powi(2)).exp();
    let total: f64 = (-reach..=reach).map(weight).sum();
    (0..=reach).map(|k| (weight(k) / total) as f32).collect()
}

struct Blur<'a> {
    values: &'a mut [f32],
    width: usize,
    height: usize,
    kernel: &'a [f32],
}

impl Kernel for Blur<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Blur { values, width, height, kernel } = self;
        let reach = kernel.len() - 1;
        let mut line = vec![0.0f32; width + 2 * reach];
        for row in values.chunks_exact_mut(width) {
            line[..reach].fill(row[0]);
            line[reach..reach + width].copy_from_slice(row);
            line[reach + width..].fill(row[width - 1]);
            scale(row, kernel[0]);
            for (k, weight) in kernel.iter().enumerate().skip(1) {
                add_weighted(row, &line[reach - k..], &line[reach + k..], *weight);
            }
        }
        let before = values.to_vec();
        for (y, out) in values.chunks_exact_mut(width).enumerate() {
            scale(out, kernel[0]);
            for (k, weight) in kernel.iter().enumerate().skip(1) {
                let (above, below) = (y.saturating_sub(k), (y + k).min(height - 1));
                add_weighted(out, &before[above * width..], &before[below * width..], *weight);
            }
        }
    }
}

#[inline(always)]
pub(super) fn scale(out: &mut [f32], by: f32) {
    for o in out {
        *o *= by;
    }
}

#[inline(always)]
pub(super) fn add_weighted(out: &mut [f32], a: &[f32], b: &[f32], weight: f32) {
    let (a, b) = (&a[..out.len()], &b[..out.len()]);
    for i in 0..out.len() {
        out[i] += weight * (a[i] + b[i]);
    }
}

/// The window of half width `half_px` around a place, clipped to the scan; `None` when nothing of it lies inside.
pub fn around(centre: PixelPoint, half_x_px: f64, half_y_px: f64, bounds: &Window) -> Option<Window> {
    let clip = |v: f64, end: u64| v.clamp(0.0, end as f64) as u64;
    let (x0, x1) =
        (clip((centre.x - half_x_px).floor(), bounds.width), clip((centre.x + half_x_px).ceil(), bounds.width));
    let (y0, y1) =
        (clip((centre.y - half_y_px).floor(), bounds.height), clip((centre.y + half_y_px).ceil(), bounds.height));
    (x1 > x0 && y1 > y0).then(|| Window::new(x0, y0, x1 - x0, y1 - y0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::memory::MemorySource;

    #[test]
    fn decimated_reading_is_reading_and_decimating() {
        let rgb: Vec<u8> = (0..64u32 * 48).flat_map(|i| [(i * 7 % 251) as u8; 3]).collect();
        let source = MemorySource::rgb8(64, 48, rgb);
        let window = Window::new(3, 5, 41, 37);
        let whole = read_grey(&source, window, 1).expect("memory");
        let quarter = read_grey(&source, window, 4).expect("memory");
        let made = whole.decimated(4);
        assert_eq!((quarter.width, quarter.height), (10, 9));
        assert!(quarter.data.iter().zip(&made.data).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}
