//! A raster with marks that are not in its file.
//!
//! Around every mark a small chip is read once, painted, passed through JPEG (where the image has 8 bits) and kept; a
//! window that meets a chip is handed out as a copy with the chip laid over it. The file is only read.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::window::Window;
use autoref_raster::{
    Block, Piece, PieceData, PooledBytes, RasterInfo, RasterSource, ReadStats, SampleType, Samples, read_patch,
};
use autoref_synth::plant::{Cell, Picture, Random, paint_mark};

/// Ground around the window of a mark that goes through JPEG with it.
const MARGIN_PX: u64 = 16;
/// Chips begin at multiples of this, where a JPEG of the whole image would have its blocks.
const ALIGN_PX: u64 = 16;
/// Side of the squares by which chips are looked up.
const BUCKET_PX: u64 = 512;
/// How often a place is drawn anew when it is taken, outside, or holds no pixels.
const TRIES: usize = 60;
const ROUNDS_OF_PLACES: usize = 3;

/// A mark that was planted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantedMark {
    /// Which of the conditions it was painted under.
    pub cell: usize,
    pub x: f64,
    pub y: f64,
}

struct Chip {
    window: Window,
    pixels: ChipPixels,
}

/// Samples as the raster has them, red, green, blue.
enum ChipPixels {
    U8(Vec<[u8; 3]>),
    U16(Vec<[u16; 3]>),
}

impl Chip {
    /// A pixel of the image, which must lie in the chip's window.
    fn at(&self, x: u64, y: u64) -> [u16; 3] {
        let i = ((y - self.window.y) * self.window.width + x - self.window.x) as usize;
        match &self.pixels {
            ChipPixels::U8(rgb) => rgb[i].map(u16::from),
            ChipPixels::U16(rgb) => rgb[i],
        }
    }
}

/// The raster with its marks.
pub struct PlantedSource {
    inner: Arc<dyn RasterSource>,
    chips: Vec<Chip>,
    buckets: HashMap<(u64, u64), Vec<usize>>,
    pub marks: Vec<PlantedMark>,
}

/// Side of a chip for one set of conditions.
fn chip_side_px(cell: &Cell) -> u64 {
    (cell.window_px() as u64 + 2 * MARGIN_PX + ALIGN_PX).next_multiple_of(ALIGN_PX)
}

/// What a chip is kept in, bytes.
pub fn chip_bytes(cell: &Cell, sample: SampleType) -> u64 {
    chip_side_px(cell).pow(2) * 3 * sample.bytes() as u64
}

impl PlantedSource {
    /// Plants `wanted[i]` marks of the conditions `cells[i]` at random places, none overlapping, none on pixels that
    /// hold nothing. There may be fewer than wanted where the image has no more room.
    ///
    /// # Errors
    /// When a window of the image cannot be read.
    pub fn plant(inner: Arc<dyn RasterSource>, cells: &[Cell], wanted: &[usize], seed: u64) -> Result<PlantedSource> {
        let mut source = PlantedSource { inner, chips: Vec::new(), buckets: HashMap::new(), marks: Vec::new() };
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        // The generator's first numbers of small seeds are small.
        (0..16).for_each(|_| {
            random.unit();
        });
        // Sizes in turn, so that a lack of room hits all alike.
        let mut missing: Vec<usize> = Vec::new();
        for turn in 0..wanted.iter().copied().max().unwrap_or(0) {
            missing.extend((0..cells.len()).filter(|&i| turn < wanted[i]));
        }
        for _ in 0..ROUNDS_OF_PLACES {
            let mut places: Vec<(usize, Window)> = Vec::new();
            let mut homeless = Vec::new();
            for cell in std::mem::take(&mut missing) {
                match source.free_place(chip_side_px(&cells[cell]), &places, &mut random) {
                    Some(window) => places.push((cell, window)),
                    None => homeless.push(cell),
                }
            }
            missing = source.paint(cells, places, seed)?;
            if missing.is_empty() {
                break;
            }
            missing.extend(homeless);
        }
        Ok(source)
    }

    fn free_place(&self, side_px: u64, places: &[(usize, Window)], random: &mut Random) -> Option<Window> {
        let info = self.inner.info();
        let room = |length: u64| length.checked_sub(side_px).map(|left| left / ALIGN_PX + 1);
        let (columns, rows) = (room(info.width)?, room(info.height)?);
        (0..TRIES).find_map(|_| {
            let at = |n: u64, unit: f64| ((unit * n as f64) as u64).min(n - 1) * ALIGN_PX;
            let window = Window::new(at(columns, random.unit()), at(rows, random.unit()), side_px, side_px);
            let free = |other: &Window| other.intersect(&window).is_empty();
            (self.near(&window).all(|i| free(&self.chips[i].window)) && places.iter().all(|(_, w)| free(w)))
                .then_some(window)
        })
    }

    /// Reads and paints the chips, from the top down; returns the conditions of those that cannot be used.
    fn paint(&mut self, cells: &[Cell], mut places: Vec<(usize, Window)>, seed: u64) -> Result<Vec<usize>> {
        places.sort_by_key(|(_, w)| (w.y, w.x));
        let source = self.inner.as_ref();
        let work = |&(cell, window): &(usize, Window)| -> Result<(usize, Option<(Chip, PlantedMark)>)> {
            // The mark depends on seed and place, not on who comes first.
            let mut random =
                Random((seed ^ window.x.wrapping_mul(0xc2b2_ae3d_27d4_eb4f) ^ window.y.rotate_left(32)) | 1);
            (0..16).for_each(|_| {
                random.unit();
            });
            Ok((cell, painted(source, &cells[cell], cell, window, &mut random)?))
        };
        let painted: Vec<_> = if source.info().sequential {
            places.iter().map(work).collect::<Result<_>>()?
        } else {
            places.par_iter().map(work).collect::<Result<_>>()?
        };
        let mut unusable = Vec::new();
        for (cell, result) in painted {
            match result {
                None => unusable.push(cell),
                Some((chip, mark)) => {
                    let number = self.chips.len();
                    for bucket in buckets(&chip.window) {
                        self.buckets.entry(bucket).or_default().push(number);
                    }
                    self.chips.push(chip);
                    self.marks.push(mark);
                }
            }
        }
        Ok(unusable)
    }

    /// Whether a place lies in the surroundings of a planted mark, which are not the image's own.
    pub fn covers(&self, p: PixelPoint) -> bool {
        let pixel = Window::new(p.x.max(0.0) as u64, p.y.max(0.0) as u64, 1, 1);
        self.near(&pixel).any(|i| self.chips[i].window.contains(pixel.x, pixel.y))
    }

    /// Pixels of the image that are its own.
    pub fn clear_pixels(&self) -> u64 {
        self.info().pixels() - self.chips.iter().map(|chip| chip.window.area()).sum::<u64>()
    }

    /// Chips that may meet a window.
    fn near(&self, window: &Window) -> impl Iterator<Item = usize> + '_ {
        let mut found: Vec<usize> =
            buckets(window).filter_map(|bucket| self.buckets.get(&bucket)).flatten().copied().collect();
        found.sort_unstable();
        found.dedup();
        found.into_iter()
    }
}

fn buckets(window: &Window) -> impl Iterator<Item = (u64, u64)> + use<> {
    let columns = window.x / BUCKET_PX..=window.right().saturating_sub(1) / BUCKET_PX;
    (window.y / BUCKET_PX..=window.bottom().saturating_sub(1) / BUCKET_PX)
        .flat_map(move |row| columns.clone().map(move |column| (row, column)))
}

/// A chip with its mark; `None` where the image holds nothing.
fn painted(
    source: &dyn RasterSource,
    cell: &Cell,
    number: usize,
    window: Window,
    random: &mut Random,
) -> Result<Option<(Chip, PlantedMark)>> {
    let patch = read_patch(source, window)?;
    if patch.valid.iter().any(|valid| !valid) {
        return Ok(None);
    }
    let white = u32::from(patch.white.max(1));
    let byte = |v: u16| ((u32::from(v) * 255 + white / 2) / white).min(255) as u8;
    let ground = Picture {
        width: window.width as usize,
        height: window.height as usize,
        rgb: patch.rgb.iter().map(|c| c.map(byte)).collect(),
    };
    let mut picture = ground.clone();
    // Anywhere relative to the blocks of the JPEG, which treats a mark in the middle of a block better than one on its
    // edge.
    let mut offset = || MARGIN_PX as usize + (random.unit() * ALIGN_PX as f64) as usize;
    let corner = (offset(), offset());
    let (x, y) = paint_mark(&mut picture, cell, corner, random);
    // Images of more than 8 bits never were JPEG.
    if source.info().sample == SampleType::U8 && cell.quality > 0 {
        picture = picture.through_jpeg(cell.quality);
    }
    let pixels = if source.info().sample == SampleType::U8 && white == 255 {
        ChipPixels::U8(picture.rgb)
    } else {
        // What was not painted keeps all its bits.
        let sample = |i: usize, c: usize| match picture.rgb[i][c] {
            same if same == ground.rgb[i][c] => patch.rgb[i][c],
            changed => ((u32::from(changed) * white + 127) / 255) as u16,
        };
        ChipPixels::U16((0..picture.rgb.len()).map(|i| [0, 1, 2].map(|c| sample(i, c))).collect())
    };
    let mark = PlantedMark { cell: number, x: window.x as f64 + x, y: window.y as f64 + y };
    Ok(Some((Chip { window, pixels }, mark)))
}

impl RasterSource for PlantedSource {
    fn info(&self) -> &RasterInfo {
        self.inner.info()
    }

    fn read(&self, window: Window) -> Result<Block> {
        let mut block = self.inner.read(window)?;
        let chips: Vec<&Chip> = self
            .near(&window)
            .map(|i| &self.chips[i])
            .filter(|chip| !chip.window.intersect(&window).is_empty())
            .collect();
        if !chips.is_empty() {
            let info = self.inner.info();
            for piece in block.pieces.iter_mut().filter(|piece| !piece.empty) {
                let over: Vec<&Chip> =
                    chips.iter().filter(|c| !c.window.intersect(&piece.window).is_empty()).copied().collect();
                if !over.is_empty() {
                    *piece = overlaid(piece, &over, info);
                }
            }
        }
        Ok(block)
    }

    fn prefetch(&self, window: Window) {
        self.inner.prefetch(window);
    }

    fn release(&self, window: Window) {
        self.inner.release(window);
    }

    fn stats(&self) -> ReadStats {
        self.inner.stats()
    }
}

/// A copy of a piece with the chips laid over it.
fn overlaid(piece: &Piece, chips: &[&Chip], info: &RasterInfo) -> Piece {
    let window = piece.window;
    let stride = piece.pixel_stride;
    let row_stride = window.width as usize * stride;
    let data = match piece.data {
        PieceData::U8(_) | PieceData::Mapped(..) => {
            let mut bytes = vec![0u8; row_stride * window.height as usize];
            for (row, out) in bytes.chunks_exact_mut(row_stride).enumerate() {
                if let Samples::U8(samples) = piece.row(window.x, window.y + row as u64, window.width).samples {
                    out[..samples.len()].copy_from_slice(samples);
                }
            }
            lay(&mut bytes, &window, stride, chips, info, |v| v.min(255) as u8);
            PieceData::U8(Arc::new(PooledBytes { bytes, home: None }))
        }
        PieceData::U16(_) => {
            let mut words = vec![0u16; row_stride * window.height as usize];
            for (row, out) in words.chunks_exact_mut(row_stride).enumerate() {
                if let Samples::U16(samples) = piece.row(window.x, window.y + row as u64, window.width).samples {
                    out[..samples.len()].copy_from_slice(samples);
                }
            }
            lay(&mut words, &window, stride, chips, info, |v| v);
            PieceData::U16(Arc::new(words))
        }
    };
    Piece { window, data, offset: 0, row_stride, pixel_stride: stride, empty: false }
}

fn lay<T: Copy>(
    samples: &mut [T],
    window: &Window,
    stride: usize,
    chips: &[&Chip],
    info: &RasterInfo,
    convert: impl Fn(u16) -> T,
) {
    let grey = info.rgb[0] == info.rgb[1] && info.rgb[1] == info.rgb[2];
    for chip in chips {
        let part = chip.window.intersect(window);
        for y in part.y..part.bottom() {
            for x in part.x..part.right() {
                let colour = chip.at(x, y);
                let first = ((y - window.y) * window.width + x - window.x) as usize * stride;
                if grey {
                    let [r, g, b] = colour.map(f64::from);
                    // Luma of Rec. ITU-R BT.601.
                    samples[first + info.rgb[0]] = convert((0.299 * r + 0.587 * g + 0.114 * b).round() as u16);
                } else {
                    for (band, value) in info.rgb.into_iter().zip(colour) {
                        samples[first + band] = convert(value);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::memory::MemorySource;

    fn source() -> Arc<dyn RasterSource> {
        let rgb = (0..700u32 * 500).flat_map(|i| [(i % 251) as u8, (i / 700 % 241) as u8, 90]).collect();
        Arc::new(MemorySource::rgb8(700, 500, rgb))
    }

    #[test]
    fn windows_agree_with_the_whole_and_the_rest_is_untouched() {
        let cells = [Cell { side_px: 6.0, ..Cell::base() }, Cell { side_px: 14.0, ..Cell::base() }];
        let planted = PlantedSource::plant(source(), &cells, &[5, 5], 1).expect("in memory");
        assert_eq!(planted.marks.len(), 10);
        let info = planted.info().clone();
        let whole = planted.read(info.bounds()).expect("in memory").to_patch(&info);
        let before = source().read(info.bounds()).expect("in memory").to_patch(&info);
        let mut changed = 0;
        for (i, (a, b)) in whole.rgb.iter().zip(&before.rgb).enumerate() {
            let (x, y) = ((i % 700) as u64, (i / 700) as u64);
            if a != b {
                changed += 1;
                assert!(planted.chips.iter().any(|c| c.window.contains(x, y)));
            }
        }
        assert!(changed > 1000);
        for chip in &planted.chips {
            // A window that cuts the chip.
            let window = Window::new(chip.window.x + 7, chip.window.y + 5, 20, 31);
            let patch = planted.read(window).expect("in memory").to_patch(&info);
            for (i, colour) in patch.rgb.iter().enumerate() {
                let at = (window.y as usize + i / 20) * 700 + window.x as usize + i % 20;
                assert_eq!(*colour, whole.rgb[at]);
            }
        }
        // The paint is where it is said to be.
        for mark in &planted.marks {
            let [r, _, b] = whole.rgb[mark.y as usize * 700 + mark.x as usize];
            assert!(r > 180 && b < 120, "{mark:?}");
        }
    }

    #[test]
    fn no_room_is_an_answer() {
        let cells = [Cell { side_px: 10.0, ..Cell::base() }];
        let planted = PlantedSource::plant(source(), &cells, &[100_000], 1).expect("in memory");
        assert!((10..90).contains(&planted.marks.len()), "{}", planted.marks.len());
        let tiny: Arc<dyn RasterSource> = Arc::new(MemorySource::rgb8(20, 20, vec![0; 1200]));
        assert!(PlantedSource::plant(tiny, &cells, &[5], 1).expect("in memory").marks.is_empty());
    }
}
