//! Threads, channels and the memory budget: the only wiring.
//!
//! [`plan()`] works out what fits before anything is read, [`scan()`] runs the stages from tiles to candidates.

pub mod georeference;
pub mod marks;
pub mod paint;
pub mod plan;
pub mod scan;
pub mod second_pass;

pub use marks::MarkDetector;
pub use paint::PaintDetector;
pub use plan::{PlanOptions, ScanPlan, peak_resident_bytes, plan};
pub use scan::{Detector, NoProgress, Progress, ScanOutcome, ScanTimings, scan};
