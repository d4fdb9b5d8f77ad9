//! From the tags of a directory to what the decoder needs, and the list of what the native reader does not take.

use std::path::Path;

use super::container::{Directories, MAX_VALUES, tag};
use crate::SampleType;
use crate::error::{Error, Result};
use crate::words::counted;

/// Compression schemes that are decoded natively.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    None,
    Lzw,
    PackBits,
    Deflate,
    Zstd,
    Jpeg,
}

impl Codec {
    /// As messages have it.
    pub fn name(self) -> &'static str {
        match self {
            Codec::None => "uncompressed",
            Codec::Lzw => "LZW",
            Codec::PackBits => "PackBits",
            Codec::Deflate => "Deflate",
            Codec::Zstd => "ZSTD",
            Codec::Jpeg => "JPEG",
        }
    }
}

/// What the samples of a file are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Samples {
    Unsigned(SampleType),
    /// IEEE 754 numbers of 32 bits.
    Float32,
}

impl Samples {
    /// Bytes of a sample.
    pub fn bytes(self) -> usize {
        match self {
            Samples::Unsigned(sample) => sample.bytes(),
            Samples::Float32 => 4,
        }
    }
}

/// What is stored in place of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Predictor {
    None,
    /// Differences to the sample before.
    Horizontal,
    /// Of floating-point numbers the bytes by their weight, and then differences of bytes.
    FloatingPoint,
}

/// One image of a file, checked.
#[derive(Clone, Debug)]
pub struct Layout {
    pub width: u64,
    pub height: u64,
    /// Samples of a pixel in the file.
    pub samples: usize,
    pub sample: Samples,
    pub codec: Codec,
    pub predictor: Predictor,
    pub planar: bool,
    /// JPEG only: the samples are luminance and colour differences.
    pub ycbcr: bool,
    pub tiled: bool,
    pub block_width: u64,
    pub block_height: u64,
    pub offsets: Vec<u64>,
    pub byte_counts: Vec<u64>,
    /// Bands of red, green and blue in the file.
    pub rgb: [usize; 3],
    pub alpha: Option<usize>,
    pub nodata: Option<f64>,
    pub max_sample_value: Option<u64>,
    /// Quantisation and Huffman tables that all JPEG blocks share.
    pub jpeg_tables: Option<Vec<u8>>,
}

/// Size of the parts into which large uncompressed strips are cut.
const PLAIN_STRIP_BYTES: u64 = 512 << 10;

const THROUGH_GDAL: &str = "use --reader auto or gdal";

impl Layout {
    /// Reads and checks the tags of directory `index`.
    ///
    /// # Errors
    /// [`Error::Unsupported`] names exactly what the native reader does not take; [`Error::Format`] what is broken;
    /// [`Error::Limit`] a directory of more strips than are read.
    pub fn read(all: &Directories, index: usize) -> Result<Self> {
        let format = |what: String| Error::format(&all.path, format!("directory {index}"), what);
        let need = |tag: u16, name: &str| match all.first(index, tag)? {
            None | Some(0) => Err(format(format!("{name} (tag {tag}) is missing or zero"))),
            Some(value) => Ok(value),
        };
        let (width, height) = (need(tag::IMAGE_WIDTH, "the width")?, need(tag::IMAGE_LENGTH, "the height")?);
        if width > i32::MAX as u64 || height > i32::MAX as u64 {
            return Err(format(format!("{width} x {height} pixels are more than 2147483647 along one side")));
        }
        let samples = all.first(index, tag::SAMPLES_PER_PIXEL)?.unwrap_or(1);
        if samples == 0 || samples > 65_535 {
            return Err(format(format!("{samples} samples a pixel")));
        }
        let sample = sample_type(all, index)?;
        let codec = codec(all, index)?;
        if codec == Codec::Jpeg && sample != Samples::Unsigned(SampleType::U8) {
            return Err(unsupported(all, "JPEG of more than 8 bits"));
        }
        let planar = match all.first(index, tag::PLANAR_CONFIGURATION)?.unwrap_or(1) {
            1 => false,
            2 => samples > 1,
            other => return Err(format(format!("planar configuration {other} does not exist"))),
        };
        let (colour, ycbcr) = colours(all, index, samples as usize, codec, planar)?;
        let predictor = match (all.first(index, tag::PREDICTOR)?.unwrap_or(1), codec) {
            (_, Codec::None | Codec::PackBits | Codec::Jpeg) | (1, _) => Predictor::None,
            (2, _) => Predictor::Horizontal,
            (3, _) if sample == Samples::Float32 => Predictor::FloatingPoint,
            (other, _) => return Err(unsupported(all, format!("predictor {other} (tag 317)"))),
        };
        let tiled = all.entry(index, tag::TILE_WIDTH).is_some();
        let (block_width, block_height, offsets, counts) = match tiled {
            true => {
                let (w, h) = (need(tag::TILE_WIDTH, "the tile width")?, need(tag::TILE_LENGTH, "the tile height")?);
                (w, h, tag::TILE_OFFSETS, tag::TILE_BYTE_COUNTS)
            }
            false => {
                let rows = all.first(index, tag::ROWS_PER_STRIP)?.unwrap_or(height).clamp(1, height);
                (width, rows, tag::STRIP_OFFSETS, tag::STRIP_BYTE_COUNTS)
            }
        };
        let offsets = all.numbers(index, offsets)?.ok_or_else(|| format("it has no block offsets".into()))?;
        let byte_counts = all.numbers(index, counts)?.ok_or_else(|| unsupported(all, "blocks without byte counts"))?;
        let nodata = match all.text(index, tag::GDAL_NODATA)? {
            None => None,
            Some(text) => match text.parse() {
                Ok(value) => Some(value),
                Err(_) => return Err(unsupported(all, format!("nodata value {text:?}"))),
            },
        };
        let jpeg_tables = all.raw(index, tag::JPEG_TABLES)?.map(|(_, tables)| tables);
        let mut layout = Layout {
            width,
            height,
            samples: samples as usize,
            sample,
            codec,
            predictor,
            planar,
            ycbcr,
            tiled,
            block_width,
            block_height,
            offsets,
            byte_counts,
            rgb: colour.rgb,
            alpha: colour.alpha,
            nodata,
            max_sample_value: all.first(index, tag::MAX_SAMPLE_VALUE)?,
            jpeg_tables,
        };
        layout.check(all, index)?;
        layout.split_plain_strips(&all.path)?;
        Ok(layout)
    }

    /// Uncompressed strips can be entered anywhere: large ones (often the whole image is one) become strips of about
    /// [`PLAIN_STRIP_BYTES`], so that they are cached and shared out like any other.
    ///
    /// # Errors
    /// When there would be more of them than a directory may list.
    fn split_plain_strips(&mut self, path: &Path) -> Result<()> {
        let row_bytes = self.block_row_bytes();
        if self.codec != Codec::None || self.tiled || row_bytes * self.block_height <= 2 * PLAIN_STRIP_BYTES {
            return Ok(());
        }
        let wanted = (PLAIN_STRIP_BYTES / row_bytes).max(1);
        let rows = match self.blocks_down() {
            1 => wanted,
            // All strips but the last must be cut into equal ones.
            _ => (1..=wanted).rev().find(|&rows| self.block_height.is_multiple_of(rows)).unwrap_or(1),
        };
        let planes = if self.planar { self.samples as u64 } else { 1 };
        let strips = (self.blocks_per_plane() * planes).saturating_mul(self.block_height.div_ceil(rows));
        if strips > MAX_VALUES {
            return Err(Error::Limit {
                what: format!(
                    "{}: {} x {} pixels in plain rows of {row_bytes} bytes are {strips} strips",
                    path.display(),
                    self.width,
                    self.height
                ),
                needed: strips.saturating_mul(16),
                allowed: MAX_VALUES * 16,
                remedy: format!("gdal_translate -co TILED=YES {} tiled.tif", path.display()),
            });
        }
        let mut offsets = Vec::with_capacity(strips as usize);
        let mut byte_counts = Vec::with_capacity(strips as usize);
        for block in 0..self.blocks_per_plane() * planes {
            let (start, _) = self.extent(block);
            let held = self.block_rows(block % self.blocks_down());
            for row in (0..held).step_by(rows as usize) {
                // A sparse strip stays sparse.
                offsets.push(if start == 0 { 0 } else { start + row * row_bytes });
                byte_counts.push(rows.min(held - row) * row_bytes);
            }
        }
        (self.offsets, self.byte_counts, self.block_height) = (offsets, byte_counts, rows);
        Ok(())
    }

    /// File blocks from left to right.
    pub fn blocks_across(&self) -> u64 {
        self.width.div_ceil(self.block_width)
    }

    /// File blocks from top to bottom.
    pub fn blocks_down(&self) -> u64 {
        self.height.div_ceil(self.block_height)
    }

    /// Blocks of one plane (or of all bands when they are interleaved).
    pub fn blocks_per_plane(&self) -> u64 {
        self.blocks_across() * self.blocks_down()
    }

    /// Samples of a pixel in one block.
    pub fn block_samples(&self) -> usize {
        if self.planar { 1 } else { self.samples }
    }

    /// Rows that block row `row` holds: the last strip is shorter, tiles are padded.
    pub fn block_rows(&self, row: u64) -> u64 {
        match self.tiled {
            true => self.block_height,
            false => self.block_height.min(self.height - row * self.block_height),
        }
    }

    /// Decoded bytes of a row of a block.
    pub fn block_row_bytes(&self) -> u64 {
        self.block_width * (self.block_samples() * self.sample.bytes()) as u64
    }

    /// "tile 17 (column 1, row 2)" or "strip 3".
    pub fn block_name(&self, block: u64) -> String {
        let kind = if self.tiled { "tile" } else { "strip" };
        let within = block % self.blocks_per_plane();
        let (row, column) = (within / self.blocks_across(), within % self.blocks_across());
        match self.tiled {
            true => format!("{kind} {block} (column {column}, row {row})"),
            false => format!("{kind} {block} (from row {})", row * self.block_height),
        }
    }

    /// Numbers that must fit each other.
    fn check(&self, all: &Directories, index: usize) -> Result<()> {
        let format = |place: String, what: String| Error::format(&all.path, place, what);
        let place = format!("directory {index}");
        let planes = if self.planar { self.samples as u64 } else { 1 };
        let too_large = || format(place.clone(), "its sizes overflow".into());
        let blocks = self.blocks_across().checked_mul(self.blocks_down()).and_then(|n| n.checked_mul(planes));
        let blocks = blocks.ok_or_else(too_large)?;
        if self.block_width > i32::MAX as u64 || self.block_height > i32::MAX as u64 {
            return Err(too_large());
        }
        let row = self.block_width.checked_mul((self.block_samples() * self.sample.bytes()) as u64);
        row.and_then(|row| row.checked_mul(self.block_height)).ok_or_else(too_large)?;
        for (what, list) in [("offsets", &self.offsets), ("byte counts", &self.byte_counts)] {
            if (list.len() as u64) < blocks {
                let what = format!(
                    "{} x {} pixels need {blocks} block {what}, there are {}",
                    self.width,
                    self.height,
                    list.len()
                );
                return Err(format(place, what));
            }
        }
        for block in 0..blocks {
            let (offset, count) = self.extent(block);
            if offset.checked_add(count).is_none_or(|end| end > all.len) {
                let what = format!(
                    "its {count} bytes at {offset} lie beyond the end of the file ({} bytes): truncated?",
                    all.len
                );
                return Err(format(format!("{place}, {}", self.block_name(block)), what));
            }
        }
        Ok(())
    }

    /// Offset and length of a block in the file; length 0 where the file holds none.
    pub fn extent(&self, block: u64) -> (u64, u64) {
        let (offset, count) = (self.offsets[block as usize], self.byte_counts[block as usize]);
        if offset == 0 || count == 0 {
            return (0, 0);
        }
        if self.codec == Codec::None {
            // The size is known; some writers state a wrong one.
            let row = (block % self.blocks_per_plane()) / self.blocks_across();
            return (offset, self.block_row_bytes() * self.block_rows(row));
        }
        (offset, count)
    }
}

fn unsupported(all: &Directories, what: impl Into<String>) -> Error {
    Error::unsupported(&all.path, format!("{} by the native reader", what.into()), THROUGH_GDAL)
}

fn sample_type(all: &Directories, index: usize) -> Result<Samples> {
    let formats = all.numbers(index, tag::SAMPLE_FORMAT)?.unwrap_or_default();
    let floats = !formats.is_empty() && formats.iter().all(|&format| format == 3);
    if let Some(other) = formats.iter().find(|&&format| format != 1).filter(|_| !floats) {
        let name = match other {
            2 => "signed",
            3 => "some floating-point",
            4 => "undefined",
            5 | 6 => "complex",
            _ => "unknown",
        };
        return Err(unsupported(all, format!("{name} samples (tag 339 is {other})")));
    }
    if all.first(index, tag::FILL_ORDER)?.unwrap_or(1) != 1 {
        return Err(unsupported(all, "fill order other than 1 (tag 266)"));
    }
    let bits = all.numbers(index, tag::BITS_PER_SAMPLE)?.unwrap_or_else(|| vec![1]);
    match bits.first() {
        Some(&first) if bits.iter().any(|&b| b != first) => {
            Err(unsupported(all, format!("bands of different depths ({bits:?} bits)")))
        }
        Some(32) if floats => Ok(Samples::Float32),
        Some(8) if !floats => Ok(Samples::Unsigned(SampleType::U8)),
        Some(16) if !floats => Ok(Samples::Unsigned(SampleType::U16)),
        other if floats => Err(unsupported(all, format!("floating-point samples of {} bits", other.unwrap_or(&0)))),
        other => Err(unsupported(all, format!("samples of {} bits", other.unwrap_or(&0)))),
    }
}

fn codec(all: &Directories, index: usize) -> Result<Codec> {
    Ok(match all.first(index, tag::COMPRESSION)?.unwrap_or(1) {
        1 => Codec::None,
        5 => Codec::Lzw,
        7 => Codec::Jpeg,
        8 | 32_946 => Codec::Deflate,
        32_773 => Codec::PackBits,
        50_000 => Codec::Zstd,
        other => {
            let name = match other {
                2..=4 => "fax",
                6 => "old-style JPEG",
                34_712 | 33_003 | 33_005 => "JPEG 2000",
                34_887 => "LERC",
                34_925 => "LZMA",
                50_001 => "WebP",
                50_002 => "JPEG XL",
                _ => "unknown",
            };
            return Err(unsupported(all, format!("compression {other} ({name})")));
        }
    })
}

struct Colours {
    rgb: [usize; 3],
    alpha: Option<usize>,
}

/// Which bands are which. Where the tags leave it open (three or more bands called grey) the first three are red, green
/// and blue, as most programs have it.
fn colours(all: &Directories, index: usize, samples: usize, codec: Codec, planar: bool) -> Result<(Colours, bool)> {
    let photometric = all.first(index, tag::PHOTOMETRIC)?;
    let (base, ycbcr) = match photometric {
        Some(1) => (1, false),
        Some(2) => (3, false),
        Some(6) if codec == Codec::Jpeg && !planar && samples == 3 => (3, true),
        Some(other) => {
            let name = match other {
                0 => "white is zero",
                3 => "palette",
                4 => "transparency mask",
                5 => "CMYK",
                6 => "YCbCr",
                8..=10 => "Lab",
                _ => "unknown",
            };
            return Err(unsupported(all, format!("photometric interpretation {other} ({name})")));
        }
        None => return Err(unsupported(all, "an image without photometric interpretation (tag 262)")),
    };
    if samples < base {
        let what = format!("an RGB image with {} a pixel", counted(samples, "sample", "samples"));
        return Err(Error::format(&all.path, format!("directory {index}"), what));
    }
    let extra = all.numbers(index, tag::EXTRA_SAMPLES)?.unwrap_or_default();
    // The extra samples are the last ones.
    let first_extra = samples.saturating_sub(extra.len());
    let alpha = extra.iter().position(|kind| matches!(kind, 1 | 2)).map(|i| first_extra + i).filter(|&b| b < samples);
    let colour_bands: Vec<usize> = (0..samples).filter(|&band| Some(band) != alpha).take(3).collect();
    let rgb = match colour_bands[..] {
        [r, g, b] => [r, g, b],
        [grey, ..] => [grey; 3],
        [] => [0; 3],
    };
    let colours = Colours { rgb, alpha };
    if let Some(text) = all.text(index, tag::GDAL_METADATA)?
        && colours.contradict(&text)
    {
        return Err(unsupported(all, "bands in another order than red, green, blue (GDAL's metadata, tag 42112)"));
    }
    Ok((colours, ycbcr))
}

impl Colours {
    /// Whether what GDAL has written of a band's colour names another band red, green, blue or alpha than these.
    fn contradict(&self, metadata: &str) -> bool {
        let attribute = |item: &str, name: &str| {
            let rest = &item[item.find(&format!(" {name}=\""))? + name.len() + 3..];
            rest.split('"').next().map(str::to_owned)
        };
        metadata.split("<Item ").skip(1).any(|item| {
            let item = format!(" {item}");
            let is_colour = attribute(&item, "role").is_some_and(|role| role == "colorinterp");
            let band = attribute(&item, "sample").and_then(|sample| sample.parse::<usize>().ok());
            let said = item.split('>').nth(1).and_then(|text| text.split('<').next()).map(str::to_ascii_lowercase);
            let (true, Some(band), Some(said)) = (is_colour, band, said) else { return false };
            let ours = match said.trim() {
                "red" => Some(self.rgb[0]),
                "green" => Some(self.rgb[1]),
                "blue" => Some(self.rgb[2]),
                "alpha" => self.alpha,
                // Bands that are called something else are taken in order, as GDAL's reader here takes them.
                _ => return self.alpha == Some(band),
            };
            ours != Some(band)
        })
    }
}
