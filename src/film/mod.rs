//! Scanned film: fiducial marks and the inner orientation.

pub mod types;

pub use types::*;
