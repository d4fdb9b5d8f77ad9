//! What several test files share.
#![allow(dead_code)] // each test file uses its own part

pub mod python;
mod random;
mod skipped;
pub mod tiles;

pub use random::Random;
pub use skipped::skipped;

use std::path::PathBuf;

use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_solve::Similarity;
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::Gcp;

/// The top of the repository.
pub fn root() -> PathBuf {
    let here = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().find(|folder| folder.join(".ci").is_dir()).expect("a crate lies in the repository").to_owned()
}

/// A path under the real data beside the repository, or `None` (with a message) when it is absent.
pub fn data(relative: &str) -> Option<PathBuf> {
    let path = root().join("../shared/data").join(relative);
    if path.exists() {
        return Some(path);
    }
    skipped(format!("../shared/data/{relative} is absent"));
    None
}

/// Whether the checks that take minutes were asked for.
pub fn large() -> bool {
    std::env::var_os("AUTOREF_LARGE").is_some()
}

/// An image of this ground sample distance, turned in any direction.
pub fn turned(random: &mut Random, gsd_m: f64) -> Similarity {
    let angle = random.uniform(-180.0, 180.0).to_radians();
    let (a_re, a_im) = (gsd_m * angle.cos(), gsd_m * angle.sin());
    Similarity { a_re, a_im, easting_0: 569_000.0, northing_0: 7_032_000.0, mirrored: Handedness::AsIs }
}

/// Trials of a test: `few` as a rule, `many` with AUTOREF_LARGE=1, AUTOREF_TRIALS of them when that is set too.
pub fn trials(few: usize, many: usize) -> usize {
    let asked = std::env::var("AUTOREF_TRIALS").ok().map(|n| n.parse().expect("AUTOREF_TRIALS is a number"));
    if large() { asked.unwrap_or(many) } else { few }
}

/// Rows of a CSV with a header, as maps from column to text.
pub fn rows(relative: &str) -> Option<Vec<std::collections::HashMap<String, String>>> {
    let mut reader = csv::Reader::from_path(data(relative)?).expect("the thesis tables are readable");
    Some(reader.deserialize().map(|row| row.expect("the thesis tables are well formed")).collect())
}

fn number(row: &std::collections::HashMap<String, String>, column: &str) -> f64 {
    row[column].trim().parse().expect("the thesis tables hold numbers")
}

/// GCPs of a thesis table.
pub fn thesis_gcps(relative: &str) -> Option<Vec<Gcp>> {
    Some(
        rows(relative)?
            .iter()
            .map(|row| Gcp {
                height: Some(number(row, "height")),
                ..Gcp::control(&row["name"], number(row, "easting"), number(row, "northing"))
            })
            .collect(),
    )
}

/// Candidates of a thesis table: its pixels count from 1 at the centre of the first pixel.
pub fn thesis_candidates(relative: &str) -> Option<Vec<Candidate>> {
    Some(
        rows(relative)?
            .iter()
            .map(|row| Candidate {
                elevation_m: Some(number(row, "elevation")),
                ..bare_candidate(number(row, "x") - 0.5, number(row, "y") - 0.5)
            })
            .collect(),
    )
}

/// A candidate of which only the place is known.
pub fn bare_candidate(x: f64, y: f64) -> Candidate {
    Candidate::at(PixelPoint { x, y })
}
