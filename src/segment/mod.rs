//! From pixels to regions: colour test, filters, connected components.
//!
//! ```
//! use autoref_stream::segment::label::Labeller;
//! use autoref_raster::mask::Mask;
//! use autoref_raster::window::Window;
//! let raster = Window::whole(6, 4);
//! let mut mask = Mask::new(raster);
//! for (x, y) in [(1, 1), (2, 1), (2, 2)] {
//!     mask.set(x, y, true);
//! }
//! let regions = Labeller::new().label(&mask, raster, raster, |_| true);
//! assert_eq!((regions.finished.len(), regions.finished[0].area), (1, 3));
//! ```

pub mod classify;
pub mod filters;
pub mod kernels;
pub mod label;
pub mod reference;
mod table;
