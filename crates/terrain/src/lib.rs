//! Masks of the ground of a photograph that image matching can use: without water, clouds, sky, featureless snow, film
//! borders and text.
//!
//! Pixel coordinates: x to the right, y down, (0, 0) at the outer corner of the first pixel. True in a [`bits::BitMask`]
//! means keep.

pub mod area;
pub mod bits;
pub mod clean;
pub mod entropy;
pub mod knn;
pub mod morphology;
pub mod smooth;
