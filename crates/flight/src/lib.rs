//! From photographs to cameras that know where they stood.

pub mod adjust;
pub mod bundle;
pub mod camera;
pub mod complete;
pub mod dual;
pub mod error;
pub mod intersect;
mod line;
pub mod lines;
pub mod micmac_files;
pub mod ortho;
pub mod plane;
pub mod pose;
pub mod read;
pub mod refine;
pub mod render;
pub mod resect;
pub mod shape;
pub mod start;
pub mod statistics;
pub mod ties;
pub mod world;
mod xml;

pub use camera::{Camera, Parameter, Projection, SizeOf};
pub use error::{Error, Result};
pub use pose::{Pose, Similarity, YawPitchRoll};
