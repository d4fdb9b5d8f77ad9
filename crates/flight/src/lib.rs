//! From photographs to cameras that know where they stood.
//!
//! ```text
//! frames, table → Start → ties → relative orientation → bundle adjustment on GCPs → cameras with covariances
//! ```
//!
//! Reads what other programs made ([`read`]), orients single photographs ([`resect`]), adjusts blocks ([`adjust`] over
//! [`bundle`]), lays frames upon each other ([`ground_plane`], [`grey`]) and onto an elevation model ([`ortho`]) and
//! renders flights with known truth ([`render`]).
//! `docs/flight.md` has the method, what was measured and the limits; `docs/coordinates.md` the conventions of pixels,
//! angles and units. This crate imports `autoref-raster` and `autoref-synth`.

pub mod adjust;
pub mod bundle;
pub mod camera;
pub mod complete;
pub mod dual;
pub mod error;
pub mod grey;
pub mod ground_plane;
pub mod intersect;
mod line;
pub mod lines;
pub mod micmac_files;
pub mod ortho;
pub mod plane;
pub mod pose;
mod reach;
pub mod read;
pub mod refine;
pub mod render;
pub mod resect;
mod residual;
pub mod shape;
pub mod start;
pub mod statistics;
pub mod ties;
pub mod world;
mod xml;

pub use camera::{Camera, Parameter, Projection, SizeOf};
pub use error::{Error, Result};
pub use pose::{Pose, Similarity, YawPitchRoll};
pub use reach::Reach;
