//! Writing what was solved so that other programs understand it.
//!
//! ```
//! use autoref_raster::coords::GeoTransform;
//! use autoref_stream::georef::sidecar::world_file;
//! // A world file speaks of the centre of the first pixel.
//! let text = world_file(&GeoTransform([100.0, 2.0, 0.0, 200.0, 0.0, -2.0]));
//! assert_eq!(text.lines().collect::<Vec<_>>(), ["2", "0", "0", "-2", "101", "199"]);
//! ```

pub mod beneath;
pub mod candidate_list;
pub mod dialects;
pub mod exif;
pub mod gcps_vrt;
pub mod heights;
pub mod output;
pub mod shown;
pub mod sidecar;
pub mod spreadsheet;
pub mod standing;
pub mod tags;
pub mod transfer;
pub mod warp;
pub mod write;
