//! Scanned film: finds the fiducial marks of a camera in a very large scan, tells which is which from their
//! constellation, refines them to a fraction of a pixel, solves the interior orientation and says which frames a person
//! must look at.
//!
//! ```text
//! Camera → Template → search windows → peaks → constellation → refined marks → checks → InteriorOrientation
//! ```
//!
//! Only windows that can hold marks are read ([`window`]); a frame costs the same memory however large its scan is.
//! `docs/film.md` has the method, the measured table and the limits. [`drawn`] draws frames with known truth. This
//! crate imports `autoref-cosine`, `autoref-raster`, `autoref-review`, `autoref-solve` and `autoref-synth`.

pub mod camera;
pub mod check;
mod clicks;
pub mod consistency;
pub mod constellation;
pub mod contact_sheet;
mod correlate;
pub mod drawn;
pub mod frame;
pub mod interior;
mod judge;
pub mod learn;
pub mod micmac;
mod naming;
mod negative;
mod own_white;
pub mod picture;
mod plausible;
pub mod refine;
mod remeasure;
pub mod replay;
pub mod resample;
pub mod resolution;
pub mod roll;
pub mod scan;
pub mod search;
pub mod shape;
mod shown;
mod sketch;
pub mod spool;
mod stack;
pub mod tables;
pub mod template;
mod thesis;
pub mod types;
pub mod window;

pub use camera::{builtin_cameras, load_camera};
pub use frame::{FindOptions, Finder, Method, find_frame};
pub use types::*;
