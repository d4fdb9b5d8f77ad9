//! A small picture of the whole raster, gathered while the scan has its pixels in hand.

use std::collections::HashSet;
use std::sync::{Mutex, PoisonError};

use autoref_raster::window::Window;
use autoref_raster::{Block, Piece, RasterInfo, Samples};

/// Longest side of the overview.
const MAX_SIDE_PX: f64 = 1280.0;
/// Most pixels of it: 7 MB while it grows, half of what the memory plan keeps in reserve.
const MAX_PIXELS: f64 = 1.2e6;

/// An 8-bit RGB picture, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Rgb8 {
    pub width: usize,
    pub height: usize,
    pub rgb: Vec<u8>,
}

/// How sample values become 8 bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// Sample that becomes 0, and the one that becomes 255.
    pub low: f64,
    pub high: f64,
}

impl Stretch {
    /// A sample as a level from 0 to 255.
    pub fn to_byte(&self, sample: f64) -> u8 {
        ((sample - self.low) / (self.high - self.low) * 255.0).round().clamp(0.0, 255.0) as u8
    }
}

/// The growing overview. Every pixel of it is the mean of four pixels of the raster at fixed places, each of which lies
/// in the core of one tile, so that the picture does not depend on the tiling. What holds no data is white.
pub struct Overview {
    width: usize,
    height: usize,
    /// Columns and rows of the raster that are sampled: two for each pixel of the overview, in order.
    columns: Vec<u64>,
    rows: Vec<u64>,
    rgb: [usize; 3],
    alpha: Option<usize>,
    nodata: Option<u16>,
    white: u16,
    /// Samples of more than 8 bits are divided by four, so that four of them fit in 16 bits.
    shift: u32,
    sums: Mutex<Vec<u16>>,
    /// Corners of the cores that are in the sums: a second scan shows the same pixels again.
    added: Mutex<HashSet<(u64, u64)>>,
}

impl Overview {
    /// Empty, of the size that suits the image.
    pub fn new(info: &RasterInfo) -> Self {
        let (w, h) = (info.width as f64, info.height as f64);
        let step = (w / MAX_SIDE_PX).max(h / MAX_SIDE_PX).max((w * h / MAX_PIXELS).sqrt()).max(1.0);
        let width = ((w / step).round() as usize).max(1);
        let height = ((h / step).round() as usize).max(1);
        let places = |n: usize, size: u64| {
            let half_step = size as f64 / (2 * n) as f64;
            (0..2 * n).map(|i| (((i as f64 + 0.5) * half_step) as u64).min(size - 1)).collect::<Vec<u64>>()
        };
        Overview {
            width,
            height,
            columns: places(width, info.width),
            rows: places(height, info.height),
            rgb: info.rgb,
            alpha: info.alpha,
            nodata: info.nodata_sample(),
            white: info.white,
            shift: if info.white > 255 { 2 } else { 0 },
            sums: Mutex::new(vec![0; width * height * 3]),
            added: Mutex::default(),
        }
    }

    /// Takes what it needs of a tile, unless it had it before. Cores must not overlap; `core` lies in the block's
    /// window.
    pub fn add(&self, block: &Block, core: Window) {
        if !self.added.lock().unwrap_or_else(PoisonError::into_inner).insert((core.x, core.y)) {
            return;
        }
        let columns = range(&self.columns, core.x, core.right());
        let rows = range(&self.rows, core.y, core.bottom());
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        // The cells that this tile touches, summed apart, so that the lock is held for a copy only.
        let (left, right) = (columns.start / 2, (columns.end - 1) / 2 + 1);
        let (top, bottom) = (rows.start / 2, (rows.end - 1) / 2 + 1);
        let width = right - left;
        let mut part = vec![0u16; width * (bottom - top) * 3];
        for piece in &block.pieces {
            let window = piece.window.intersect(&core);
            if window.is_empty() {
                continue;
            }
            let columns = range(&self.columns, window.x, window.right());
            for row in range(&self.rows, window.y, window.bottom()) {
                let first = (row / 2 - top) * width;
                self.add_row(piece, self.rows[row], &columns, left, &mut part[first * 3..(first + width) * 3]);
            }
        }
        let mut sums = self.sums.lock().unwrap_or_else(PoisonError::into_inner);
        for (y, row) in (top..bottom).zip(part.chunks(width * 3)) {
            let to = (y * self.width + left) * 3;
            sums[to..to + width * 3].iter_mut().zip(row).for_each(|(sum, add)| *sum += add);
        }
    }

    fn add_row(&self, piece: &Piece, y: u64, columns: &std::ops::Range<usize>, left: usize, out: &mut [u16]) {
        let window = piece.window;
        if piece.empty {
            for i in columns.clone() {
                self.put(out, i / 2 - left, [self.white; 3]);
            }
            return;
        }
        let row = piece.row(window.x, y, window.width);
        for i in columns.clone() {
            let at = (self.columns[i] - window.x) as usize * row.pixel_stride;
            let sample = |band: usize| match row.samples {
                Samples::U8(samples) => u16::from(samples[at + band]),
                Samples::U16(samples) => samples[at + band],
            };
            let colour = self.rgb.map(sample);
            let hidden = self.alpha.is_some_and(|band| sample(band) == 0)
                || self.nodata.is_some_and(|value| colour == [value; 3]);
            self.put(out, i / 2 - left, if hidden { [self.white; 3] } else { colour });
        }
    }

    fn put(&self, out: &mut [u16], cell: usize, colour: [u16; 3]) {
        for (sum, value) in out[cell * 3..cell * 3 + 3].iter_mut().zip(colour) {
            *sum += value.min(self.white) >> self.shift;
        }
    }

    /// The picture so far, and the stretch it was made with: none for 8 bits; for more, from the darkest to the
    /// brightest half per cent of what is seen, since few such images use their whole range.
    pub fn picture(&self) -> (Rgb8, Stretch) {
        let sums = self.sums.lock().unwrap_or_else(PoisonError::into_inner);
        // A sum of four samples, back to one.
        let scale = f64::from(1u32 << self.shift) / 4.0;
        let mut stretch = Stretch { low: 0.0, high: f64::from(self.white) };
        if self.shift > 0 {
            let full = (self.white >> self.shift) * 4;
            let mut seen: Vec<u16> = sums.iter().step_by(7).copied().filter(|sum| *sum < full).collect();
            if seen.len() > 100 {
                seen.sort_unstable();
                let at = |share: f64| f64::from(seen[((seen.len() - 1) as f64 * share) as usize]) * scale;
                if at(0.995) > at(0.005) {
                    stretch = Stretch { low: at(0.005), high: at(0.995) };
                }
            }
        }
        let largest = (self.white >> self.shift) * 4;
        let bytes: Vec<u8> = (0..=largest).map(|sum| stretch.to_byte(f64::from(sum) * scale)).collect();
        let rgb = sums.iter().map(|sum| bytes[usize::from(*sum)]).collect();
        (Rgb8 { width: self.width, height: self.height, rgb }, stretch)
    }
}

/// Indices of the places in `from..to`; the places rise.
fn range(places: &[u64], from: u64, to: u64) -> std::ops::Range<usize> {
    places.partition_point(|p| *p < from)..places.partition_point(|p| *p < to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::RasterSource;
    use autoref_raster::memory::MemorySource;
    use autoref_raster::window::TileGrid;

    fn source(width: u64, height: u64) -> MemorySource {
        let rgb = (0..width * height)
            .flat_map(|i| [(i % width * 255 / width) as u8, (i / width * 255 / height) as u8, (i % 251) as u8])
            .collect();
        MemorySource::rgb8(width, height, rgb)
    }

    fn overview(source: &MemorySource, tile: (u64, u64)) -> Rgb8 {
        let overview = Overview::new(source.info());
        for tile in TileGrid::new(source.info().width, source.info().height, tile.0, tile.1, 3).iter() {
            overview.add(&source.read(tile.read).expect("in memory"), tile.core);
        }
        overview.picture().0
    }

    #[test]
    fn the_picture_does_not_depend_on_the_tiling_and_shows_the_raster() {
        let source = source(3001, 1703);
        let whole = overview(&source, (3001, 1703));
        assert_eq!((whole.width, whole.height), (1280, 726));
        assert_eq!(overview(&source, (257, 64)), whole);
        assert_eq!(overview(&source, (3001, 1)), whole);
        for (x, y) in [(0, 0), (640, 300), (1279, 725)] {
            let at = (y * whole.width + x) * 3;
            assert!((i64::from(whole.rgb[at]) - (x * 255 / 1280) as i64).abs() <= 1);
            assert!((i64::from(whole.rgb[at + 1]) - (y * 255 / 726) as i64).abs() <= 1);
        }
    }

    #[test]
    fn a_small_raster_is_shown_as_it_is() {
        let source = source(40, 30);
        let picture = overview(&source, (16, 16));
        let block = source.read(source.info().bounds()).expect("in memory");
        let pixels: Vec<u8> = block.to_patch(source.info()).rgb.iter().flatten().map(|v| *v as u8).collect();
        assert_eq!((picture.width, picture.height, picture.rgb), (40, 30, pixels));
    }
}
