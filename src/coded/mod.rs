//! Coded targets: black squares with a number in them (ArUco, AprilTag), read in builds with the cargo feature `coded`.
//!
//! The decoder is `locus-core`'s. Its thresholds depend on the window that it is given, so it is given windows that the
//! image fixes, not the tile: cells of a grid over the whole raster, with a border that holds every tag whose middle is
//! in the cell. What it reads is measured on our own pixels: the pattern of the tag, blurred, is fitted to them
//! (`fit`), which gives centre, covariance and score. `docs/decisions/coded-targets.md` argues the choice.

#[cfg(feature = "coded")]
mod detector;
#[cfg(feature = "coded")]
mod fit;

#[cfg(feature = "coded")]
pub use detector::CodedDetector;
