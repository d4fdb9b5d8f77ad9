//! The report of a run: one self-contained HTML file that a client reads, a surveyor prints, and a reviewer works in.
//!
//! The overview is gathered during the scan ([`Overview`]), the chips are cut after it ([`gather`]), and [`page`] puts
//! both with the result into a page of fixed markup, style and script. All that comes from files (names of GCPs, paths,
//! messages) is in one block of JSON whose `<` are escaped, and reaches the document as text only, so that a name
//! cannot become markup. The page draws plots and tables itself, because the review redraws them; it asks for nothing
//! over the network, and a content security policy in it says so to the browser.

mod chips;
mod frame;
mod jpeg;
mod kept_pixels;
mod layout_warnings;
mod overview;
mod points;

pub use chips::{Chip, cut};
pub use frame::Spot;
pub use kept_pixels::KeptPixels;
pub use layout_warnings::plain_warnings;
pub use overview::{Overview, Rgb8, Stretch};
pub use points::{Gathered, gather};

use serde::Serialize;

use crate::matching::diagnosis::Diagnosis;
use crate::result::RunResult;
use autoref_raster::error::Result;
use autoref_solve::Similarity;
use points::{Candidates, ChipData, Point};

/// A part of the report that another room words: a heading, sentences, figures with labels, and tables.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Section {
    pub heading: String,
    pub paragraphs: Vec<String>,
    /// What must be said against them.
    pub reservations: Vec<String>,
    /// Label and value, both as they are to be read.
    pub figures: Vec<(String, String)>,
    /// Differences of height at points, drawn as upright arrows; none, no drawing.
    pub height_arrows: Vec<HeightArrow>,
    pub tables: Vec<Table>,
}

/// A difference of height at a point of the map, metres.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HeightArrow {
    pub name: String,
    pub easting: f64,
    pub northing: f64,
    pub residual_m: f64,
    /// It took no part in the fit.
    pub check: bool,
}

/// A table; the first row of cells follows the header.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Table {
    pub caption: String,
    pub header: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

/// What the page's script reads.
#[derive(Serialize)]
struct Page<'a> {
    /// Name of the result file, as a patch names it.
    source: &'a str,
    made: String,
    program: &'a str,
    status: crate::result::Status,
    reason: Option<&'a str>,
    /// It was refused for a mistake of the whole list, which a review does not mend.
    condemned: bool,
    advice: &'a [String],
    image: Image<'a>,
    gcp_file: &'a str,
    crs: Option<&'a str>,
    log10_false_alarms: Option<f64>,
    best_pairs: Option<usize>,
    similarity: Option<Similarity>,
    solution: Option<&'a autoref_solve::Solution>,
    /// The transform of `--model`, when it is not the similarity.
    chosen_model: Option<&'a crate::result::ChosenModel>,
    /// What speaks against the fit, which the map of its errors does not know.
    misfit: Option<String>,
    points: &'a [Point],
    candidates: &'a Candidates,
    chips: &'a [ChipData],
    overview: OverviewData<'a>,
    hand_variance_px2: f64,
    warnings: Vec<String>,
    sections: &'a [Section],
    details: serde_json::Value,
    patch: Option<&'a autoref_review::PatchFile>,
}

#[derive(Serialize)]
struct Image<'a> {
    name: String,
    path: &'a str,
    description: &'a str,
    width: u64,
    height: u64,
    /// In another folder than the page.
    apart: bool,
}

#[derive(Serialize)]
struct OverviewData<'a> {
    width: usize,
    height: usize,
    src: &'a str,
}

/// The whole page. `source` is the name (without folder) of the result file beside it, `sections` come before the
/// technical part in their order, and `made` is when, in words.
///
/// # Errors
/// Those of making pictures; see [`gather`].
pub fn page(
    result: &RunResult,
    gathered: &Gathered,
    sections: &[Section],
    source: &str,
    made: String,
) -> Result<String> {
    let info = result.image.as_ref();
    let path = info.map_or("", |image| image.path.as_str());
    let name = std::path::Path::new(path).file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let data = Page {
        source,
        made,
        program: &result.program,
        status: result.status(),
        reason: result.refused().map(|refused| refused.reason.as_str()),
        condemned: result.refused().is_some() && result.diagnoses.iter().any(Diagnosis::condemns_list),
        advice: &result.advice,
        image: Image {
            name,
            path,
            description: info.map_or("", |image| image.description.as_str()),
            width: info.map_or(0, |image| image.width),
            height: info.map_or(0, |image| image.height),
            apart: info.is_some_and(|image| image.from_result.is_some()),
        },
        gcp_file: &result.gcp_file,
        crs: result.crs.as_deref(),
        log10_false_alarms: result.log10_false_alarms,
        best_pairs: result.best_pattern().map(|pattern| pattern.pairs.len()),
        similarity: result.similarity(),
        solution: result.solved().and_then(|solved| solved.solution.as_ref()),
        chosen_model: result.solved().and_then(|solved| solved.chosen_model.as_ref()),
        misfit: crate::result::Misfit::of(result).map(|misfit| misfit.clause()),
        points: &gathered.points,
        candidates: &gathered.candidates,
        chips: &gathered.chips,
        overview: OverviewData {
            width: gathered.overview_size.0,
            height: gathered.overview_size.1,
            src: &gathered.overview,
        },
        hand_variance_px2: autoref_review::HAND_VARIANCE_PX2,
        warnings: result
            .warnings
            .iter()
            .map(ToString::to_string)
            .chain(result.diagnoses.iter().map(|d| d.message.clone()))
            .collect(),
        sections,
        details: details(result),
        patch: result.patch.as_ref(),
    };
    let json = serde_json::to_string(&data).expect("no map keys but strings, no failing serialiser");
    Ok(assemble(&json))
}

/// What was done, for the technical part.
fn details(result: &RunResult) -> serde_json::Value {
    serde_json::json!({
        "options": result.options,
        "timings": result.timings,
        "elapsed_s": result.elapsed_s,
        "peak_memory_bytes": result.peak_memory_bytes,
        "memory_plan": result.memory_plan,
        "reading": result.reading,
        "reader": result.image.as_ref().map(|image| &image.reader),
        "search": result.search,
        "runner_up": result.runner_up.as_ref().map(|p| (p.pairs.len(), p.log10_false_alarms)),
        "candidates_found": result.candidates_found,
        "geotransform": result.geotransform(),
        "files_written": result.files_written,
        "moved_m": result.prior_georeference.as_ref().map(|prior| prior.moved_m),
        "corner_moved_m": result.prior_georeference.as_ref().map(|prior| prior.corner_moved_m),
    })
}

const MARKUP: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
const SCRIPTS: [&str; 6] = [
    include_str!("page/solve.js"),
    include_str!("page/planar.js"),
    include_str!("page/plots.js"),
    include_str!("page/sketch.js"),
    include_str!("page/review.js"),
    include_str!("page/page.js"),
];

fn assemble(json: &str) -> String {
    let safe = json.replace('<', "\\u003c");
    let mut page = String::with_capacity(MARKUP.len() + safe.len() + 64 * 1024);
    // Split at the marks, never searched in what was put in.
    for part in MARKUP.split_inclusive("@@") {
        match part {
            "STYLE@@" => page.push_str(STYLE),
            "DATA@@" => page.push_str(&safe),
            "SCRIPTS@@" => SCRIPTS.iter().for_each(|script| page.push_str(script)),
            _ => page.push_str(part.strip_suffix("@@").unwrap_or(part)),
        }
    }
    page
}

/// UTC, to the minute: "2026-03-01 14:05 UTC".
pub fn utc(time: std::time::SystemTime) -> String {
    let ((year, month, day), seconds) = autoref_raster::dates::civil(time);
    let minutes = seconds / 60;
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02} UTC", minutes / 60, minutes % 60)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, UNIX_EPOCH};

    #[test]
    fn times_are_told_to_the_minute() {
        assert_eq!(utc(UNIX_EPOCH + Duration::from_secs(951_782_399)), "2000-02-28 23:59 UTC");
    }

    #[test]
    fn data_cannot_close_the_block_it_lies_in() {
        let page = assemble(r#"{"name":"</script><script>alert(1)</script>@@STYLE@@"}"#);
        assert!(!page.contains("<script>alert") && page.contains("\\u003cscript>alert"));
        assert_eq!(page.matches("</script>").count(), MARKUP.matches("</script>").count());
    }
}
