//! Masks that people drew, of a frame's size: 1 keep, 0 mask, 255 nothing said.

use std::path::{Path, PathBuf};

use autoref_raster::error::{Error, Result};
use gdal::Dataset;
use gdal::raster::ResampleAlg;

use crate::reduce::Reduced;
use crate::shapes::SAYS_NOTHING;

/// A mask that was drawn for a frame.
pub struct LabelledMask {
    path: PathBuf,
    dataset: Dataset,
}

impl LabelledMask {
    /// # Errors
    /// When it cannot be opened or has another size than the frame.
    pub fn open(path: &Path, reduced: &Reduced) -> Result<LabelledMask> {
        let (_, dataset) = autoref_raster::open_dataset(path, 0)?;
        let size = dataset.raster_size();
        if size != (reduced.width as usize, reduced.height as usize) {
            return Err(Error::usage(
                format!(
                    "{}: {} × {} px, but its frame has {} × {} px",
                    path.display(),
                    size.0,
                    size.1,
                    reduced.width,
                    reduced.height
                ),
                "give a mask of its frame's size",
            ));
        }
        Ok(LabelledMask { path: path.into(), dataset })
    }

    /// Calls `see(y, labels)` for the rows of the reduced frame: of each pixel the label in the middle of what it
    /// stands for. Answers how often each label is there at full size: mask, keep, nothing.
    ///
    /// # Errors
    /// When it cannot be read or holds another value anywhere.
    pub fn each_row(&self, reduced: &Reduced, mut see: impl FnMut(usize, &[u8])) -> Result<[u64; 3]> {
        let failed = |e| Error::gdal(&self.path, e);
        let band = self.dataset.rasterband(1).map_err(failed)?;
        let (width, height) = self.dataset.raster_size();
        let factor = reduced.factor;
        let middle = |i: usize, length: usize| (i * factor + factor / 2).min(length - 1);
        let mut counts = [0; 3];
        let mut labels = vec![SAYS_NOTHING; reduced.grey.width()];
        for y in 0..height {
            let row =
                band.read_as::<f64>((0, y as isize), (width, 1), (width, 1), None::<ResampleAlg>).map_err(failed)?;
            for (x, value) in row.data().iter().enumerate() {
                match *value {
                    0.0 => counts[0] += 1,
                    1.0 => counts[1] += 1,
                    255.0 => counts[2] += 1,
                    other => {
                        return Err(Error::format(
                            &self.path,
                            format!("pixel {x}, {y}"),
                            format!("the value {other}; a mask holds 1 (keep), 0 (mask) and 255 (nothing is said)"),
                        ));
                    }
                }
            }
            let reduced_row = y / factor;
            if middle(reduced_row, height) == y {
                for (x, label) in labels.iter_mut().enumerate() {
                    *label = row.data()[middle(x, width)] as u8;
                }
                see(reduced_row, &labels);
            }
        }
        Ok(counts)
    }
}
