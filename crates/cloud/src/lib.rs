//! Point clouds, cleaned and gridded in streams: whatever their size, in bounded memory, with the same answer as if all
//! points were in memory. `docs/cloud.md` has the method and the limits. This crate imports `autoref-raster`.

pub mod clean;
pub mod crop;
pub mod elm;
pub mod info;
pub use autoref_raster::error;
pub mod grid;
pub mod io;
pub mod isolated;
pub mod kdtree;
pub mod neighbours;
pub mod outliers;
pub mod page;
pub mod params;
pub mod point;
mod quiet;
pub mod schema;
pub mod smrf;
pub mod summary;
pub mod tiles;

pub use error::{Error, Result};
