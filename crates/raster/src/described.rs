//! A raster of which the caller knows something better than the file.

use std::ops::Deref;
use std::sync::Arc;

use super::{Block, Piece, RasterInfo, RasterSource, ReadStats};
use crate::coords::GeoTransform;
use crate::error::Result;
use crate::window::Window;

/// The pixels of another source, borrowed or shared, described otherwise.
pub struct Described<S> {
    inner: S,
    info: RasterInfo,
}

impl<S> Described<S> {
    /// `info` in the place of what the source says of itself; its size and bands are the source's.
    pub fn new(inner: S, info: RasterInfo) -> Self {
        Described { inner, info }
    }
}

impl<S: Deref<Target: RasterSource> + Send + Sync> RasterSource for Described<S> {
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

/// Where a raster says that it lies.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Georeference {
    /// Pixel corners to the CRS, map units.
    pub transform: Option<GeoTransform>,
    pub crs_wkt: Option<String>,
}

/// The same pixels with another georeference, in the place of what the file and those beside it say.
pub fn with_georeference(source: Arc<dyn RasterSource>, georeference: Georeference) -> Arc<dyn RasterSource> {
    let mut info = source.info().clone();
    (info.geotransform, info.crs_wkt) = (georeference.transform, georeference.crs_wkt);
    Arc::new(Described::new(source, info))
}
