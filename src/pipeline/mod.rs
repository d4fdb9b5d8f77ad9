//! Threads, channels and the memory budget: the only wiring.
//!
//! [`autoref_raster::memory_plan::plan()`] works out what fits before anything is read, [`scan()`] runs the stages from
//! tiles to candidates.
//!
//! ```
//! use autoref_raster::memory_plan::{PlanOptions, plan};
//! use autoref_stream::pipeline::{NoProgress, PaintDetector, scan};
//! use autoref_stream::profile::Profile;
//! use autoref_raster::RasterSource;
//! use autoref_raster::memory::MemorySource;
//! let (mut rgb, side) = (vec![90; 64 * 64 * 3], 14);
//! for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x + 20, y + 30))) {
//!     rgb[(y * 64 + x) * 3..][..3].copy_from_slice(&[255, 103, 0]); // a mark of safety orange
//! }
//! let source = MemorySource::rgb8(64, 64, rgb);
//! let detector = PaintDetector::new(Profile::load("orange")?, source.info(), None)?;
//! let options = PlanOptions {
//!     tile_px: None,
//!     threads: 1,
//!     memory_budget_bytes: 512 << 20,
//!     baseline_bytes: 32 << 20,
//!     cache_bytes: 16 << 20,
//! };
//! let plan = plan(source.info(), 32, &options)?; // refused with numbers when it cannot fit
//! let found = scan(&source, &plan, &detector, &NoProgress)?;
//! assert_eq!(found.candidates.len(), 1);
//! assert!((found.candidates[0].centre.x - 27.0).abs() < 0.5);
//! # Ok::<(), autoref_raster::Error>(())
//! ```

pub mod asked;
mod beside;
mod bright_paint;
pub mod colour_search;
pub mod georeference;
pub mod heights;
pub mod marks;
mod pace;
pub mod paint;
pub mod picture;
pub mod reasons;
pub mod scan;
mod seams;
pub mod second_pass;
mod worn_paint;

pub use marks::MarkDetector;
pub use paint::PaintDetector;
pub use scan::{NoProgress, Progress, ScanOutcome, ScanTimings, scan};
