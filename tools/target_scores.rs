//! Prints what the score of black and white targets is made of: targets planted into real photographs beside whatever
//! else answers there, for the populations in `src/black_white/examine.rs`.
//!
//! `cargo run --release -p autoref-tools --bin target_scores` (photographs in `../shared/data`).

#[path = "../benches/detection/targets.rs"]
mod targets;

use autoref_raster::mask::Mask;
use autoref_raster::memory::MemorySource;
use autoref_raster::memory_plan::PlanOptions;
use autoref_raster::memory_plan::plan;
use autoref_raster::{Block, Pixels, RasterSource};
use autoref_stream::black_white::TargetDetector;
use autoref_stream::detector::Detector;
use autoref_stream::pipeline::{NoProgress, scan};
use autoref_stream::profile::Profile;
use autoref_stream::segment::label::Region;
use autoref_synth::plant::{Picture, Random};
use std::sync::Mutex;

/// Writes down what the detector sees and keeps everything.
struct Spy<'a> {
    inner: TargetDetector,
    truth: &'a [(f64, f64)],
    rows: Mutex<Vec<String>>,
}

impl Detector for Spy<'_> {
    fn halo_px(&self) -> u64 {
        self.inner.halo_px()
    }
    fn segment_block(&self, block: &Block, mask: &mut Mask) {
        self.inner.segment_block(block, mask);
    }
    fn gate(&self, region: &Region) -> bool {
        self.inner.gate(region)
    }
    fn patch_margin_px(&self) -> u64 {
        self.inner.patch_margin_px()
    }
    fn largest_mark_px(&self) -> u64 {
        self.inner.largest_mark_px()
    }
    fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<autoref_stream::candidate::Candidate> {
        let (seen, score) = self.inner.look(region, pixels)?;
        let fit = seen.fit;
        let hit = self.truth.iter().any(|t| (t.0 - fit.x).hypot(t.1 - fit.y) < 2.0);
        let near = self.truth.iter().any(|t| (t.0 - fit.x).hypot(t.1 - fit.y) < 60.0);
        if hit || !near {
            let row = format!(
                "{} {:.3} {:.3} {:.3} {:.3} {:.2} {score:.2}",
                u8::from(hit),
                fit.misfit.max(1e-4).ln(),
                fit.height.abs().ln(),
                seen.evenness,
                fit.blur,
                seen.side_px
            );
            self.rows.lock().expect("no panic inside").push(row);
        }
        self.inner.examine(region, pixels)
    }
}

fn main() {
    let kinds = [
        (targets::Kind::Checker, "black-white-checker"),
        (targets::Kind::Hourglass, "black-white-hourglass"),
        (targets::Kind::Cross, "black-white-cross"),
        (targets::Kind::FifthArm, "black-white-cross"),
    ];
    for (kind, profile) in kinds {
        for (number, name) in targets::COVERS.iter().enumerate() {
            let Some(picture) = targets::photo(name) else { continue };
            for planted in [true, false] {
                let mut random = Random(7 + number as u64);
                let (picture, truth) = if planted {
                    targets::plant_targets(&targets::middle(&picture, 1200), kind, None, &mut random)
                } else {
                    (picture.clone(), Vec::new())
                };
                let Picture { width, height, rgb } = picture;
                let source = MemorySource::rgb8(width as u64, height as u64, rgb.into_flattened());
                let profile = Profile::builtin(profile).expect("shipped");
                let inner = TargetDetector::new(profile, source.info(), None).expect("sound");
                let spy = Spy { inner, truth: &truth, rows: Mutex::default() };
                let options = PlanOptions {
                    tile_px: None,
                    threads: 2,
                    memory_budget_bytes: 2 << 30,
                    baseline_bytes: 0,
                    cache_bytes: 0,
                };
                let plan = plan(source.info(), spy.halo_px(), &options).expect("fits");
                let found = scan(&source, &plan, &spy, &NoProgress).expect("memory").candidates;
                for row in spy.rows.lock().expect("no panic inside").iter().filter(|r| r.starts_with('1') == planted) {
                    println!("{kind:?} {name} {row}");
                }
                let hit = truth
                    .iter()
                    .filter(|t| found.iter().any(|c| (c.centre.x - t.0).hypot(c.centre.y - t.1) < 2.0))
                    .count();
                eprintln!(
                    "{kind:?} {name}: {hit} of {} planted, {} candidates on {:.1} megapixels",
                    truth.len(),
                    found.len(),
                    (width * height) as f64 / 1e6
                );
            }
        }
    }
}
