//! Sample orthophotos with known truth, for the demo, the tests and the benches.
//!
//! A [`SynthSpec`] says what to draw; a [`Scene`] is the spec with every choice made (where each mark lies, how it is
//! turned, which are in shadow); [`Scene::render_window`] draws any window of it, the same whatever window is asked
//! for; [`write`](fn@write) streams the whole picture into a GeoTIFF and puts the [`Truth`] beside it. Positions are in
//! pixels, `(0, 0)` at the outer corner of the first pixel (`docs/coordinates.md`); what is modelled and what is not is
//! in `docs/synth.md`.
//!
//! ```
//! use autoref_synth::{self as synth, SynthSpec};
//! use autoref_raster::window::Window;
//! let spec = SynthSpec { gcps: synth::random_gcps(5, 20.0, 15.0, 1), size_px: Some((200, 150)), ..SynthSpec::default() };
//! let rgb = synth::render_window(&spec, Window::new(0, 0, 64, 64))?; // any window, always the same pixels
//! assert_eq!(rgb.len(), 64 * 64 * 3);
//! # Ok::<(), autoref_raster::Error>(())
//! ```
//!
//! This crate imports `autoref-raster` only.
mod gcps;
mod jpeg;
mod landscape;
mod mark;
mod objects;
mod paint;
mod photo;
mod plan;
pub mod plant;
mod quadrature;
pub mod rng;
mod scene;
mod shape;
mod spec;
mod triangles;
mod truth;
mod write;

pub use gcps::{SynthGcp, random_gcps, read_gcp_csv, write_gcp_geojson};
pub use jpeg::{Chroma, jpeg_round_trip};
pub use paint::Paint;
pub use photo::{PhotoStore, photographs};
pub use scene::Scene;
pub use shape::Shape;
pub use spec::{
    Background, BigTiff, Border, Compression, FileLayout, Interleave, MarkSize, MarkStyle, MarkTurn, Output,
    PlacedMark, SynthSpec, Visible,
};
pub use truth::{Shadow, Truth, TruthClutter, TruthGcp};
pub use write::{Progress, truth_path, write, write_with_progress};

use autoref_raster::error::Result;
use autoref_raster::window::Window;

/// Draws one window of `spec`: RGB, 8 bits, row-major, `3 · width · height` bytes, the same bytes that
/// [`write`](fn@write) puts there. For more than one window build a [`Scene`] once.
///
/// # Errors
/// When the spec contradicts itself or a photograph cannot be read.
pub fn render_window(spec: &SynthSpec, window: Window) -> Result<Vec<u8>> {
    Scene::new(spec)?.render_window(window)
}
