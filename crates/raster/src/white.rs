//! The value of full white, by the caller's word.

use std::sync::Arc;

use super::{Block, Piece, RasterInfo, RasterSource, ReadStats, SampleType};
use crate::error::{Error, Result};
use crate::window::Window;

/// A raster whose value of full white the caller knows better than the file.
struct Rescaled {
    inner: Arc<dyn RasterSource>,
    info: RasterInfo,
}

/// The same pixels with another value of full white; `None` leaves what the file says. Samples are never changed:
/// everything that scales them does so by [`RasterInfo::white`].
///
/// # Errors
/// [`Error::Usage`] when no sample of the image can reach that value, or it is 0.
pub fn with_white(source: Arc<dyn RasterSource>, white: Option<u16>) -> Result<Arc<dyn RasterSource>> {
    let Some(white) = white else { return Ok(source) };
    let largest = match source.info().sample {
        SampleType::U8 => 255,
        SampleType::U16 => u16::MAX,
    };
    if white == 0 || white > largest {
        return Err(Error::usage(
            format!("{}: --white {white}, but its samples go from 0 to {largest}", source.info().path.display()),
            format!("give a value from 1 to {largest}"),
        ));
    }
    let mut info = source.info().clone();
    info.white = white;
    Ok(Arc::new(Rescaled { inner: source, info }))
}

impl RasterSource for Rescaled {
    fn info(&self) -> &RasterInfo {
        &self.info
    }
    fn read(&self, window: Window) -> Result<Block> {
        self.inner.read(window)
    }
    fn read_seen(&self, window: Window, see: &mut dyn FnMut(&Piece)) -> Result<Block> {
        self.inner.read_seen(window, see)
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
