//! Masks of the ground of a photograph that image matching can use: without water, clouds, sky, featureless snow, film
//! borders and text.
//!
//! Pixel coordinates: x to the right, y down, (0, 0) at the outer corner of the first pixel. True in a
//! [`bits::BitMask`] means keep. `docs/masks.md` has the method and the limits. This crate imports `autoref-raster`.

pub mod area;
pub mod batch;
pub mod bits;
pub mod by_hand;
pub mod classify;
pub mod clean;
mod contradiction;
pub mod entropy;
pub mod explain;
pub mod features;
mod fill;
pub mod forest;
mod frame_scale;
pub mod given;
pub mod judge;
pub mod knn;
mod labelled;
pub mod light;
pub mod mirror;
pub mod model;
pub mod morphology;
pub mod names;
pub mod options;
mod or_nothing;
pub mod outline;
pub mod plane;
pub mod reduce;
pub mod report;
pub mod resume;
pub mod shapes;
pub mod sheet;
pub mod smooth;
pub mod teach;
pub mod unlike;
pub mod write;
