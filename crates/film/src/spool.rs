//! Scans that can only be read from the top down (JPEG, PNG, one compressed strip), decoded once into a temporary file,
//! so that windows of them cost no more memory than those of a tiled scan.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::sync::Arc;

use super::window::{decoded_info, read_rows};
use autoref_raster::error::{Error, Result};
use autoref_raster::window::Window;
use autoref_raster::{Block, Piece, PieceData, PooledBytes, RasterInfo, RasterSource, ReadStats, SampleType};

/// A scan as grey samples in a file without a name, which is gone with the program.
pub struct SpooledSource {
    info: RasterInfo,
    file: File,
    pixel_bytes: u64,
}

impl SpooledSource {
    /// Decodes `source` from top to bottom. Disk: a byte (or two, twice that with alpha) per pixel in the system's
    /// folder for temporary files.
    ///
    /// # Errors
    /// Those of reading; [`Error::Io`] when the temporary folder is full.
    pub fn of(source: &dyn RasterSource) -> Result<SpooledSource> {
        let from = source.info();
        let info = decoded_info(from);
        let folder = std::env::temp_dir();
        let failed = |e| Error::io(&folder, "write a decoded scan into", e);
        let file = tempfile::tempfile().map_err(failed)?;
        let mut out = BufWriter::with_capacity(1 << 20, file);
        let sample = from.sample;
        read_rows(source, &mut |row: &[u16]| {
            let written = match sample {
                SampleType::U8 => out.write_all(&row.iter().map(|v| *v as u8).collect::<Vec<_>>()),
                SampleType::U16 => out.write_all(&row.iter().flat_map(|v| v.to_ne_bytes()).collect::<Vec<_>>()),
            };
            written.map_err(failed)
        })?;
        let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
        let pixel_bytes = info.bands as u64 * if sample == SampleType::U8 { 1 } else { 2 };
        Ok(SpooledSource { info, file, pixel_bytes })
    }
}

impl RasterSource for SpooledSource {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read(&self, window: Window) -> Result<Block> {
        let line = (window.width * self.pixel_bytes) as usize;
        let mut bytes = vec![0u8; line * window.height as usize];
        for (k, row) in bytes.chunks_mut(line.max(1)).enumerate() {
            let at = ((window.y + k as u64) * self.info.width + window.x) * self.pixel_bytes;
            self.file.read_exact_at(row, at).map_err(|e| Error::io(&self.info.path, "read the decoded copy of", e))?;
        }
        let data = match self.info.sample {
            SampleType::U8 => PieceData::U8(Arc::new(PooledBytes { bytes, home: None })),
            SampleType::U16 => {
                let words = bytes.chunks_exact(2).map(|b| u16::from_ne_bytes([b[0], b[1]])).collect();
                PieceData::U16(Arc::new(words))
            }
        };
        let pixel_stride = self.info.bands;
        let row_stride = window.width as usize * pixel_stride;
        let piece = Piece { window, data, offset: 0, row_stride, pixel_stride, empty: false };
        Ok(Block { window, pieces: vec![piece] })
    }

    fn stats(&self) -> ReadStats {
        ReadStats::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::window::{GreySource, read_grey, read_grey_valid};
    use autoref_raster::Described;
    use autoref_raster::memory::MemorySource;

    #[test]
    fn windows_of_the_copy_are_windows_of_the_scan() {
        let rgb: Vec<u8> = (0..70u32 * 150).flat_map(|i| [(i * 7 % 251) as u8, 3, 0]).collect();
        let source = MemorySource::rgb8(70, 150, rgb);
        let copy = SpooledSource::of(&source).expect("a temporary file");
        for window in [Window::new(0, 0, 70, 150), Window::new(3, 65, 40, 2), Window::new(69, 149, 1, 1)] {
            let (a, b) = (read_grey(&source, window, 1).expect("memory"), read_grey(&copy, window, 1).expect("a file"));
            assert_eq!(a.data, b.data);
        }
    }

    #[test]
    fn copies_keep_which_pixels_hold_something() {
        let (width, height) = (70u64, 150u64);
        let is_empty = |i: u64| i % width + i / width < 60;
        let samples = |i: u64| {
            let value = 10 + (i * 7 % 241) as u8;
            if is_empty(i) { [9, 9, 9] } else { [9, value, 255] }
        };
        let rgb = MemorySource::rgb8(width, height, (0..width * height).flat_map(samples).collect());
        let [grey_nodata, rgb_nodata, alpha] =
            [([1; 3], Some(9.0), None), ([0, 1, 2], Some(9.0), None), ([1; 3], None, Some(0))]
                .map(|(bands, nodata, alpha)| RasterInfo { rgb: bands, nodata, alpha, ..rgb.info().clone() });
        let opaque = MemorySource::rgb8(
            width,
            height,
            (0..width * height).flat_map(|i| [u8::from(!is_empty(i)), samples(i)[1], 255]).collect(),
        );
        let sources =
            [Described::new(&rgb, grey_nodata), Described::new(&rgb, rgb_nodata), Described::new(&opaque, alpha)];
        for source in &sources {
            let copies: [Box<dyn RasterSource>; 2] = [
                Box::new(SpooledSource::of(source).expect("a temporary file")),
                Box::new(GreySource::read_whole(source).expect("memory")),
            ];
            for (window, factor) in [(Window::new(0, 0, 70, 150), 1), (Window::new(3, 5, 60, 140), 4)] {
                let (grey, holds) = read_grey_valid(source, window, factor).expect("memory");
                let holds = holds.expect("some hold nothing");
                let left_out = holds.iter().filter(|holds| !**holds).count() as f64 / holds.len() as f64;
                assert!((0.08..0.25).contains(&left_out), "{left_out}");
                for copy in &copies {
                    let (same, as_much) = read_grey_valid(copy.as_ref(), window, factor).expect("decoded");
                    assert_eq!((same.data, as_much.as_ref()), (grey.data.clone(), Some(&holds)));
                }
            }
        }
    }
}
