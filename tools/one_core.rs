//! What one core cannot do without: all tiles of a raster decoded, and all of them classified, each measured alone.
//!
//!     one_core FILE [PROFILE]
//!
//! Decodes once with nothing else in between, then once more with every tile classified, of which only the classifying
//! is counted. Prints both in processor seconds of the thread, and their sum: what `autoref-stream FILE --threads 1` is
//! compared with.

use std::path::Path;
use std::time::Duration;

use autoref_raster::mask::Mask;
use autoref_raster::window::{TileGrid, Window};
use autoref_raster::{Block, BlockLayout, RasterSource, ReaderChoice, open};
use autoref_stream::detector::Detector;
use autoref_stream::pipeline::PaintDetector;
use autoref_stream::profile::Profile;

const CACHE_BYTES: u64 = 64 << 20;
const TILE_PX: u64 = 1024;
const BAND_ROWS: u64 = 64;

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let Some(file) = args.next() else { anyhow::bail!("usage: one_core FILE [PROFILE]") };
    let profile = Profile::load(args.next().as_deref().unwrap_or("orange"))?;
    let fresh = || open(Path::new(&file), ReaderChoice::Auto, 0, CACHE_BYTES);
    let source = fresh()?;
    let started = processor_time();
    each_tile(&*source, |_| {})?;
    let decoded = processor_time() - started;
    let source = fresh()?;
    let detector = PaintDetector::new(profile, source.info(), None)?;
    let mut mask = Mask::new(Window::new(0, 0, 0, 0));
    let mut classified = Duration::ZERO;
    each_tile(&*source, |block| {
        let started = processor_time();
        mask.reset(block.window);
        detector.segment(block, &mut mask);
        classified += processor_time() - started;
    })?;
    let [decoded, classified] = [decoded, classified].map(|d| d.as_secs_f64());
    println!("decode {decoded:.3} classify {classified:.3} sum {:.3}", decoded + classified);
    Ok(())
}

/// Of this thread: what other programs do on the machine does not count.
fn processor_time() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

/// Tiles as the scan takes them: squares, or bands as wide as the raster where the file has strips.
fn each_tile(source: &dyn RasterSource, mut each: impl FnMut(&Block)) -> anyhow::Result<()> {
    let info = source.info();
    let bounds = info.bounds();
    let (width, height) = match info.layout {
        BlockLayout::Strips { rows } => (bounds.width, rows.max(BAND_ROWS)),
        BlockLayout::Tiles { .. } => (TILE_PX, TILE_PX),
    };
    for tile in TileGrid::new(bounds.width, bounds.height, width, height, 0).iter() {
        each(&source.read(tile.read)?);
        source.release(tile.core);
    }
    Ok(())
}
