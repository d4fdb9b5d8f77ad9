//! The native TIFF and BigTIFF reader: a thin layer over the codecs.

pub mod container;
mod decoder;
mod decompress;
mod empty_blocks;
mod floats;
mod jpeg;
mod layout;
mod lzw;
mod mapping;
mod predictor;
mod rows;
mod stream;

pub use container::{Directories, is_tiff};
pub use decoder::{TiffDecoder, open, open_mapped, open_pixels};
pub use floats::{FloatTiff, bound_float_cache};
