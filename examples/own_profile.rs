//! Teaches a profile from one mark that somebody points at, and detects the others with it.
//!
//! `cargo run --release --example own_profile`

use autoref_raster::coords::PixelPoint;
use autoref_raster::memory::MemorySource;
use autoref_raster::memory_plan::{PlanOptions, plan};
use autoref_raster::window::Window;
use autoref_raster::{RasterSource, read_patch};
use autoref_stream::detector::Detector as _;
use autoref_stream::learn::learn;
use autoref_stream::pipeline::{NoProgress, PaintDetector, scan};

/// Turquoise, which no shipped profile takes, on grey gravel.
const PAINT: [u8; 3] = [20, 190, 180];

pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let marks = found()?;
    println!("{} marks: {marks:.2?}", marks.len());
    Ok(())
}

/// Centres of the marks that a profile learned from the first of them finds.
pub fn found() -> Result<Vec<(f64, f64)>, Box<dyn std::error::Error>> {
    let (width, height) = (400u64, 300u64);
    let mut rgb: Vec<u8> = (0..width * height).flat_map(|i| [110 + (i * 7919 % 13) as u8; 3]).collect();
    for (left, top) in [(60, 50), (300, 80), (180, 220)] {
        for (x, y) in (0..14).flat_map(|y| (0..14).map(move |x| (left + x, top + y))) {
            rgb[((y * width + x) * 3) as usize..][..3].copy_from_slice(&PAINT);
        }
    }
    let source = MemorySource::rgb8(width, height, rgb);
    let patch = read_patch(&source, Window::new(27, 17, 80, 80))?;
    let profile = learn("turquoise", &[(patch, PixelPoint { x: 67.0, y: 57.0 })])?;
    let detector = PaintDetector::new(profile, source.info(), None)?;
    let options = PlanOptions {
        tile_px: None,
        threads: 1,
        memory_budget_bytes: 512 << 20,
        baseline_bytes: 32 << 20,
        cache_bytes: 16 << 20,
    };
    let plan = plan(source.info(), detector.halo_px(), &options)?;
    let outcome = scan(&source, &plan, &detector, &NoProgress)?;
    Ok(outcome.candidates.iter().map(|c| (c.centre.x, c.centre.y)).collect())
}
