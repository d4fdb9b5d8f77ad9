//! Scans that can only be read from the top down (JPEG, PNG, one compressed strip), decoded once into a temporary file,
//! so that windows of them cost no more memory than those of a tiled scan.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::sync::Arc;

use super::window::{grey_info, read_rows};
use autoref_raster::error::{Error, Result};
use autoref_raster::window::Window;
use autoref_raster::{Block, Piece, PieceData, PooledBytes, RasterInfo, RasterSource, ReadStats, SampleType};

/// A scan as grey samples in a file without a name, which is gone with the program.
pub struct SpooledSource {
    info: RasterInfo,
    file: File,
    sample_bytes: u64,
}

impl SpooledSource {
    /// Decodes `source` from top to bottom. Disk: a byte (or two) per pixel in the system's folder for temporary files.
    ///
    /// # Errors
    /// Those of reading; [`Error::Io`] when the temporary folder is full.
    pub fn of(source: &dyn RasterSource) -> Result<SpooledSource> {
        let from = source.info();
        let mut info = grey_info(&from.path, from.width, from.height, from.sample, from.white);
        info.geotransform = from.geotransform;
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
        let sample_bytes = if sample == SampleType::U8 { 1 } else { 2 };
        Ok(SpooledSource { info, file, sample_bytes })
    }
}

impl RasterSource for SpooledSource {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read(&self, window: Window) -> Result<Block> {
        let line = (window.width * self.sample_bytes) as usize;
        let mut bytes = vec![0u8; line * window.height as usize];
        for (k, row) in bytes.chunks_mut(line.max(1)).enumerate() {
            let at = ((window.y + k as u64) * self.info.width + window.x) * self.sample_bytes;
            self.file.read_exact_at(row, at).map_err(|e| Error::io(&self.info.path, "read the decoded copy of", e))?;
        }
        let data = match self.info.sample {
            SampleType::U8 => PieceData::U8(Arc::new(PooledBytes { bytes, home: None })),
            SampleType::U16 => {
                let words = bytes.chunks_exact(2).map(|b| u16::from_ne_bytes([b[0], b[1]])).collect();
                PieceData::U16(Arc::new(words))
            }
        };
        let piece = Piece { window, data, offset: 0, row_stride: window.width as usize, pixel_stride: 1, empty: false };
        Ok(Block { window, pieces: vec![piece] })
    }

    fn stats(&self) -> ReadStats {
        ReadStats::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::window::read_grey;
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
}
