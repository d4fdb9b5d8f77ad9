//! A scan opened so that any window of it can be read.

use std::path::Path;
use std::sync::Arc;

use super::spool::SpooledSource;
use super::window::GreySource;
use autoref_raster::error::Result;
use autoref_raster::{RasterSource, ReaderChoice, SampleType, open};

/// Decoded blocks kept of a scan while it is examined.
const CACHE_BYTES: u64 = 24 << 20;
/// Scans that can only be read from the top down are held in memory up to this size, decoded; larger ones go to a
/// temporary file.
const HELD_BYTES: u64 = 24 << 20;

/// Opens a scan for reading in windows. JPEG, PNG and files of one compressed strip, which cannot be, are decoded once
/// to grey.
///
/// # Errors
/// Those of [`open`] and, for such a file, of reading it and of [`SpooledSource::of`].
pub fn open_scan(path: &Path) -> Result<Arc<dyn RasterSource>> {
    let source = open(path, ReaderChoice::Auto, 0, CACHE_BYTES)?;
    let info = source.info();
    if !info.sequential {
        return Ok(source);
    }
    let sample_bytes = if info.sample == SampleType::U8 { 1 } else { 2 };
    if info.pixels() * sample_bytes > HELD_BYTES {
        return Ok(Arc::new(SpooledSource::of(source.as_ref())?));
    }
    Ok(Arc::new(GreySource::read_whole(source.as_ref())?))
}
