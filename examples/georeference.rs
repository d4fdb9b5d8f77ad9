//! Opens a raster, finds the marks, matches them to a list of GCPs, solves the orientation and writes a world file.
//!
//! `cargo run --release --example georeference -- IMAGE GCPS OUT.tfw`; without arguments on `fixtures/field.tif`.

use std::path::{Path, PathBuf};

use autoref_raster::memory_plan::{PlanOptions, baseline_bytes, plan};
use autoref_raster::{ReaderChoice, open};
use autoref_stream::detector::Detector as _;
use autoref_stream::gcp::{self, GcpOptions};
use autoref_stream::georef::sidecar::world_file;
use autoref_stream::matching::{Priors, RobustMatcher};
use autoref_stream::pipeline::asked::Asked;
use autoref_stream::pipeline::georeference::{Job, Outcome, Refine, georeference};
use autoref_stream::pipeline::{NoProgress, PaintDetector};
use autoref_stream::profile::Profile;

type AnyError = Box<dyn std::error::Error>;

pub fn main() -> Result<(), AnyError> {
    let folder = tempfile::tempdir()?;
    let given: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [image, list, out] = <[PathBuf; 3]>::try_from(given).unwrap_or_else(|_| sample(folder.path()));
    println!("{}", run(&image, &list, &out)?);
    Ok(())
}

/// From files to a world file; what came of it, in a sentence.
pub fn run(image: &Path, list: &Path, out: &Path) -> Result<String, AnyError> {
    let memory_budget_bytes = 512 << 20;
    let source = open(image, ReaderChoice::Auto, 0, 64 << 20)?;
    let info = source.info();
    let detector = PaintDetector::new(Profile::load("orange")?, info, None)?;
    let options = PlanOptions {
        tile_px: None,
        threads: 2,
        memory_budget_bytes,
        baseline_bytes: baseline_bytes(),
        cache_bytes: 64 << 20,
    };
    let plan = plan(info, detector.halo_px(), &options)?;
    let gcps = gcp::read(list, &GcpOptions::default())?.gcps;
    let priors = Priors { image_size_px: Some((info.width as f64, info.height as f64)), ..Priors::default() };
    let job = Job {
        source: source.as_ref(),
        plan: &plan,
        detector: &detector,
        refiner: &detector,
        gcps: &gcps,
        matcher: &RobustMatcher::default(),
        priors: &[priors],
        progress: &NoProgress,
        refine: Refine::Always,
        asked: &Asked::default(),
    };
    match georeference(&job)?.outcome {
        Outcome::Refused(evidence) => Err(evidence.reason.into()),
        Outcome::Solved(orientation) => {
            let solution = &orientation.solution;
            std::fs::write(out, world_file(&solution.geotransform))?;
            let (matched, rmse_px) = (orientation.marks.len(), solution.rmse_m / solution.scale_m_per_px);
            Ok(format!("{matched} of {} GCPs matched, RMSE {rmse_px:.3} px", gcps.len()))
        }
    }
}

/// The drawn orthophoto of the fixtures, with its list, and a name for the world file.
pub fn sample(folder: &Path) -> [PathBuf; 3] {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    [fixtures.join("field.tif"), fixtures.join("field.geojson"), folder.join("field.tfw")]
}
