//! Options of a run, and how a frame is opened and reduced by them.

use std::path::Path;
use std::sync::Arc;

use autoref_raster::error::{Error, Result};
use autoref_raster::memory_plan::cache_share_bytes;
use autoref_raster::{RasterSource, ReaderChoice};
use serde::{Deserialize, Serialize};

use crate::clean::Cleaning;
use crate::light::Correction;
use crate::reduce::{Reading, Reduced, reduce_frame};
use crate::write::MaskCompression;

/// How the ground is told from the rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Method {
    #[serde(rename = "thesis-2017")]
    Thesis2017,
    #[serde(rename = "threshold")]
    Threshold,
    #[default]
    #[serde(rename = "auto")]
    Auto,
}

/// What is written beside the mask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extras {
    /// `NAME_Prob.tif`, 8 bit.
    pub probability: bool,
    /// `NAME_Class.tif`, `NAME_Entropy.tif`, `NAME_Distance.tif`.
    pub explain: bool,
    /// `NAME.EXT.png`, as COLMAP names masks.
    pub colmap: bool,
}

/// Options of a run.
#[derive(Clone, Debug)]
pub struct Options {
    pub method: Method,
    /// Reduction; 0: 4, and for `auto` 1 below 1,500 px, 2 below 3,000 px.
    pub reduce: usize,
    pub neighbours: usize,
    /// Entropy, bit, above which `threshold` keeps.
    pub threshold_bit: f64,
    pub cleaning: Cleaning,
    /// Least share of the image of an area of `auto`.
    pub auto_area_share: f64,
    pub compression: MaskCompression,
    pub extras: Extras,
    /// Corrections of bands and light, one after another, on the reduced frame.
    pub corrections: Vec<Correction>,
    pub tile_px: u64,
    pub memory_budget_bytes: u64,
    pub reader: ReaderChoice,
    pub overwrite: bool,
    pub resume: bool,
}

impl Method {
    /// As the command line has it.
    pub fn name(self) -> &'static str {
        match self {
            Method::Thesis2017 => "thesis-2017",
            Method::Threshold => "threshold",
            Method::Auto => "auto",
        }
    }
}

impl Options {
    pub(crate) fn open(&self, path: &Path) -> Result<Arc<dyn RasterSource>> {
        // A frame is read once; only a margin of two pixels is decoded again.
        let source = autoref_raster::open(path, self.reader, 0, cache_share_bytes(self.memory_budget_bytes) / 2)?;
        if source.info().width == 0 || source.info().height == 0 {
            return Err(Error::format(path, "header", "the frame has no pixels"));
        }
        Ok(source)
    }

    fn factor(&self, width: u64, height: u64) -> usize {
        match (self.reduce, self.method, width.max(height)) {
            (0, Method::Auto, 0..1500) => 1,
            (0, Method::Auto, 1500..3000) => 2,
            (0, ..) => 4,
            (factor, ..) => factor,
        }
    }

    pub(crate) fn reading(&self, source: &dyn RasterSource) -> Reading {
        let factor = self.factor(source.info().width, source.info().height);
        Reading {
            factor,
            smooth: factor > 1 || self.method != Method::Auto,
            tile_px: self.tile_px,
            memory_budget_bytes: self.memory_budget_bytes,
            masks_beside: 0,
        }
    }

    /// The frame at the reduced scale, its light corrected.
    pub(crate) fn reduced(&self, source: &Arc<dyn RasterSource>, reading: &Reading) -> Result<Reduced> {
        let mut reduced = reduce_frame(source, reading)?;
        self.corrections.iter().try_for_each(|c| (c.change)(source.as_ref(), &mut reduced))?;
        Ok(reduced)
    }
}
