//! The report beside a result: its flags, what it gathers during the scan, and when it is made.

use std::path::{Path, PathBuf};

use autoref_stream::coords::PixelPoint;
use autoref_stream::georef::result::RunResult;
use autoref_stream::pipeline::{Detector, Progress};
use autoref_stream::raster::{Block, RasterSource};
use autoref_stream::report::{self, Gathered, Overview, Section};
use autoref_stream::window::Window;
use clap::Args;

use crate::cli::common::Bar;

#[derive(Args, Debug)]
pub struct ReportArgs {
    /// Write NAME.report.html, a page with pictures, plots and tables in which marks can be reviewed (the default).
    #[arg(long, overrides_with = "no_report", help_heading = "Output")]
    report: bool,
    /// Write no report.
    #[arg(long, help_heading = "Output")]
    no_report: bool,
}

impl ReportArgs {
    pub fn wanted(&self) -> bool {
        !self.no_report
    }
}

/// The progress bar, and the overview that grows with it.
pub struct Watch<'a> {
    bar: &'a Bar,
    overview: Option<Overview>,
}

impl<'a> Watch<'a> {
    pub fn new(bar: &'a Bar, source: &dyn RasterSource, args: &ReportArgs) -> Self {
        Watch { bar, overview: args.wanted().then(|| Overview::new(source.info())) }
    }

    /// Adds what the places of the marks mean to the warnings, and cuts the pictures of the report, when one is wanted.
    pub fn gather(
        &self,
        source: &dyn RasterSource,
        detector: &dyn Detector,
        result: &mut RunResult,
    ) -> anyhow::Result<Option<Gathered>> {
        if let Some(solution) = &result.solution {
            let marks: Vec<PixelPoint> = result.matches.iter().map(|row| PixelPoint { x: row.x, y: row.y }).collect();
            let info = source.info();
            let words = report::plain_warnings(solution, &marks, info.width as f64, info.height as f64);
            result.warnings.extend(words);
        }
        let Some(overview) = &self.overview else { return Ok(None) };
        self.bar.stage("making the report");
        Ok(Some(report::gather(source, detector, overview, result)?))
    }
}

impl Progress for Watch<'_> {
    fn scanned(&self, pixels: u64) {
        self.bar.scanned(pixels);
    }

    fn saw(&self, block: &Block, core: Window) {
        if let Some(overview) = &self.overview {
            overview.add(block, core);
        }
    }

    fn stage(&self, what: &str) {
        self.bar.stage(what);
    }
}

/// Where the report goes: beside the result.
pub fn path(json: &Path) -> PathBuf {
    // "e6.autoref.json": both extensions go.
    json.with_extension("").with_extension("report.html")
}

/// The page as text.
pub fn page(result: &RunResult, gathered: &Gathered, json: &Path) -> autoref_stream::Result<String> {
    let name = json.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    report::page(result, gathered, &sections(result), &name, report::utc(std::time::SystemTime::now()))
}

/// Parts that other rooms word.
fn sections(_result: &RunResult) -> Vec<Section> {
    Vec::new()
}
