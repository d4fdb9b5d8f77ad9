//! Masks of the frame's size as 1-bit TIFF, probabilities as 8-bit TIFF, and MicMac's description of a mask.

use std::path::Path;

use autoref_raster::error::{Error, Result};
use autoref_raster::{Written, failed_to_write};
use gdal::DriverManager;
use gdal::raster::{Buffer, RasterCreationOptions};

use crate::by_hand::FullMask;

/// How masks are compressed; both are lossless.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaskCompression {
    #[default]
    CcittG4,
    Deflate,
}

/// Rows that are written at once.
const ROWS: usize = 64;

/// Writes rows of one byte a pixel as a TIFF of one band, strip by strip.
fn write_rows(
    path: &Path,
    [width, height]: [usize; 2],
    options: &[&str],
    mut row: impl FnMut(usize, &mut [u8]) -> Result<()>,
) -> Result<()> {
    let failed = |e: gdal::errors::GdalError| failed_to_write(path, &e.to_string());
    let watch = Written::watch(path);
    let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
    let blocks = format!("BLOCKYSIZE={ROWS}");
    let options =
        RasterCreationOptions::from_iter(options.iter().copied().chain([blocks.as_str(), "BIGTIFF=IF_SAFER"]));
    let dataset =
        driver.create_with_band_type_with_options::<u8, _>(path, width, height, 1, &options).map_err(failed)?;
    let mut band = dataset.rasterband(1).map_err(failed)?;
    for first in (0..height).step_by(ROWS) {
        let rows = ROWS.min(height - first);
        let mut pixels = vec![0; width * rows];
        for (i, line) in pixels.chunks_exact_mut(width).enumerate() {
            row(first + i, line)?;
        }
        let mut buffer = Buffer::new((width, rows), pixels);
        band.write((0, first as isize), (width, rows), &mut buffer).map_err(failed)?;
    }
    watch.close(dataset)
}

/// Writes `mask` at the frame's size: 1 bit a pixel, 1 = keep.
///
/// # Errors
/// When the file cannot be written, or a mask that a person gave cannot be read.
pub fn mask(path: &Path, mask: &FullMask<'_>, compression: MaskCompression) -> Result<()> {
    let compress = match compression {
        MaskCompression::CcittG4 => "COMPRESS=CCITTFAX4",
        MaskCompression::Deflate => "COMPRESS=DEFLATE",
    };
    let mut rows = mask.rows()?;
    write_rows(path, mask.size, &["NBITS=1", compress], |y, line| rows.row(y, line))
}

/// Writes `pixels`, row by row of a frame of `size`, as [`mask()`] does: 1 where one is not 0.
///
/// # Errors
/// When the file cannot be written.
pub fn mask_of_bytes(path: &Path, size: [usize; 2], pixels: &[u8]) -> Result<()> {
    write_rows(path, size, &["NBITS=1", "COMPRESS=CCITTFAX4"], |y, line| {
        let own = &pixels[y * size[0]..][..size[0]];
        line.iter_mut().zip(own).for_each(|(bit, value)| *bit = u8::from(*value != 0));
        Ok(())
    })
}

/// Writes values at the reduced scale at the frame's size, 8 bits a pixel.
///
/// # Errors
/// When the file cannot be written or `row` fails.
pub fn grey(path: &Path, size: [usize; 2], factor: usize, mut row: impl FnMut(usize) -> Result<Vec<u8>>) -> Result<()> {
    let mut last: (usize, Vec<u8>) = (usize::MAX, Vec::new());
    write_rows(path, size, &["COMPRESS=DEFLATE"], |y, line| {
        if last.0 != y / factor {
            last = (y / factor, row(y / factor)?);
        }
        line.iter_mut().enumerate().for_each(|(x, value)| *value = last.1[x / factor]);
        Ok(())
    })
}

/// What MicMac reads beside a mask: a `FileOriMnt` with the mask's name and size, as its `SaisieMasq` writes it.
pub fn micmac_xml(mask_name: &str, [width, height]: [usize; 2]) -> String {
    let name = autoref_raster::markup::escaped(mask_name);
    format!(
        "<?xml version=\"1.0\" ?>\n<FileOriMnt>\n     <NameFileMnt>./{name}</NameFileMnt>\n     \
         <NombrePixels>{width} {height}</NombrePixels>\n     <OriginePlani>0 0</OriginePlani>\n     \
         <ResolutionPlani>1 1</ResolutionPlani>\n     <OrigineAlti>0</OrigineAlti>\n     \
         <ResolutionAlti>1</ResolutionAlti>\n     <Geometrie>eGeomMNTFaisceauIm1PrCh_Px1D</Geometrie>\n\
         </FileOriMnt>\n"
    )
}

/// Writes a plane at the frame's size.
///
/// # Errors
/// When the file cannot be written.
pub fn grey_plane(path: &Path, size: [usize; 2], factor: usize, plane: &crate::plane::Plane) -> Result<()> {
    grey(path, size, factor, |y| plane.read(&autoref_raster::window::Window::new(0, y as u64, plane.width() as u64, 1)))
}

/// Writes a mask as COLMAP reads it: 8-bit PNG, black where no features are wanted.
///
/// # Errors
/// When the file cannot be written, or a mask that a person gave cannot be read.
pub fn colmap(path: &Path, mask: &FullMask<'_>) -> Result<()> {
    let [width, height] = mask.size;
    let failed = |e: png::EncodingError| Error::io(path, "write", std::io::Error::other(e));
    let file = std::fs::File::create(path).map_err(|e| Error::io(path, "create", e))?;
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(failed)?;
    let mut stream = writer.stream_writer().map_err(failed)?;
    let mut rows = mask.rows()?;
    let mut line = vec![0; width];
    for y in 0..height {
        rows.row(y, &mut line)?;
        line.iter_mut().for_each(|value| *value *= 255);
        std::io::Write::write_all(&mut stream, &line).map_err(|e| Error::io(path, "write", e))?;
    }
    stream.finish().map_err(failed)
}
