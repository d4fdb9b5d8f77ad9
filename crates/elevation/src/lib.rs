//! Elevation models: aligned to each other, compared, drawn; rasters joined into mosaics. Streamed, whatever their
//! size.
//!
//! The algorithms see heights through [`source::Heights`], in windows, and keep sums whose value does not depend on the
//! order of their terms ([`autoref_raster::exact_sum`]): the size of the tiles and the number of threads never change a
//! result by a bit. `docs/elevation.md` and `docs/mosaic.md` have the methods and the limits. This crate imports
//! `autoref-raster`.

pub mod align;
pub mod compare;
pub mod couple;
pub mod derive;
pub mod files;
pub mod footprint;
mod gdal_call;
pub mod gradient;
pub mod grid;
pub mod histogram;
pub mod kept;
pub mod labels;
pub mod lift;
pub mod model;
pub mod mosaic;
pub mod output;
pub mod profile;
pub mod resample;
pub mod resampled;
mod row_cache;
pub mod source;
pub mod stream;
mod turns;
mod warp;
pub mod zeros;
pub mod zones;

use autoref_raster::{atomic, coords, crs, error, window};
