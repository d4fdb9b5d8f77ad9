//! Marks of a picture in memory, looked for in tiles.

use autoref_raster::RasterSource;
use autoref_raster::memory::MemorySource;
use autoref_raster::memory_plan::PlanOptions;
use autoref_raster::memory_plan::plan;
use autoref_raster::window::TileGrid;
use autoref_stream::candidate::Candidate;
use autoref_stream::pipeline::{MarkDetector, NoProgress, scan};
use autoref_stream::profile::Profile;
use autoref_synth::plant::Picture;

pub fn find(source: &dyn RasterSource, profile: &Profile, tile_px: u64, threads: usize) -> Vec<Candidate> {
    let detector = MarkDetector::new(profile.clone(), source.info(), None).expect("a sound profile");
    let options = PlanOptions {
        tile_px: Some(tile_px),
        threads,
        memory_budget_bytes: 1 << 30,
        baseline_bytes: 0,
        cache_bytes: 16 << 20,
    };
    let mut plan = plan(source.info(), detector.as_detector().halo_px(), &options).expect("it fits");
    // Strips are cut into bands; squares are the harder case.
    plan.grid =
        TileGrid::new(source.info().width, source.info().height, tile_px, tile_px, detector.as_detector().halo_px());
    scan(source, &plan, detector.as_detector(), &NoProgress).expect("readable").candidates
}

pub fn memory(picture: &Picture) -> MemorySource {
    MemorySource::rgb8(picture.width as u64, picture.height as u64, picture.rgb.clone().into_flattened())
}
