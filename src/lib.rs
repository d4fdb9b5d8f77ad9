//! Georeferences rasters that do not fit in memory, without a click.
//!
//! Surveyors paint marks on the ground, fly a drone and get an orthophoto. This crate finds the marks, works out
//! which surveyed point each of them is, solves the orientation and writes it with a statement of its accuracy, or says
//! why it will not. The flow is one chain of types, and each arrow is one function:
//!
//! ```text
//! TileGrid → Tile → Block → Mask → TileRegions → Region → Candidate → Match → Transform → outputs
//! ```
//!
//! Only `autoref-raster` and the rooms that read and write lists ([`gcp`], [`georef`]) touch files; everything
//! between takes values and returns values. The pixel convention is that of GDAL: x to the right, y down, `(0, 0)` at
//! the outer corner of the first pixel (`docs/coordinates.md`).
pub mod black_white;
pub mod candidate;
pub mod coded;
pub mod detector;
pub mod gcp;
pub mod georef;
pub mod learn;
pub mod matching;
pub mod merge;
pub mod pipeline;
pub mod planning;
pub mod profile;
pub mod rematch;
pub mod replay;
pub mod report;
pub mod result;
pub mod segment;
pub mod selftest;
