//! Options that several commands share.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, bail};
use autoref_raster::{self as raster, RasterInfo, RasterSource, ReaderChoice};
use autoref_stream::gcp::GcpOptions;
use autoref_stream::matching::TimeLimit;
use autoref_stream::profile::{Profile, Rule};
use clap::{Args, ValueEnum};

use crate::cli::accuracy::AccuracyArgs;
use crate::cli::patterns::PatternArgs;
use crate::cli::solving::SolvingArgs;
use crate::cli::values::{Bytes, Gsd, MarkSize, memory_budget, seconds};
use crate::cli::working_crs::{self, WorkingCrsArgs};

/// How the image is read and with what means.
#[derive(Args, Debug)]
pub struct ReadArgs {
    /// Side of the tiles, in pixels, taken literally; for strips, a band of at most N² pixels. Default: about a million
    /// pixels, in whole file blocks.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000), help_heading = "Resources")]
    pub tile: Option<u64>,
    /// Number of working threads. Default: one for each core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1024), help_heading = "Resources")]
    pub threads: Option<u64>,
    /// Bound on the peak resident memory of the whole program, libraries included: bytes, or with K, M or G. At least
    /// 112M.
    #[arg(long, value_name = "SIZE", default_value = "512M", value_parser = memory_budget, help_heading = "Resources")]
    pub memory: Bytes,
    /// Which decoder: the native one takes most TIFFs, GDAL everything else.
    #[arg(long, value_enum, default_value = "auto", help_heading = "Reading")]
    pub reader: ReaderArg,
    /// Image of a multi-page file, counted from 0. Default: the first of full resolution.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Reading")]
    pub page: usize,
    /// Sample value of full white, for images whose file does not say it: 4095 for 12 bits in 16. Default:
    /// MaxSampleValue or NBITS, else the largest value of the samples' type. Never taken from the image's own
    /// brightness.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), help_heading = "Reading")]
    pub white: Option<u16>,
}

/// How the image is read by the commands that look at a few places of it.
#[derive(Args, Debug)]
pub struct SampleArgs {
    /// Sample value of full white, for images whose file does not say it: 4095 for 12 bits in 16. Default:
    /// MaxSampleValue or NBITS, else the largest value of the samples' type.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), help_heading = "Reading")]
    white: Option<u16>,
    /// Image of a multi-page file, counted from 0. Default: the first of full resolution.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Reading")]
    page: usize,
}

impl SampleArgs {
    pub fn open(&self, image: &Path, cache_bytes: u64) -> anyhow::Result<Arc<dyn RasterSource>> {
        let source = raster::open(image, ReaderChoice::Auto, self.page, cache_bytes)?;
        Ok(raster::with_white(source, self.white)?)
    }

    /// Whether the user said what white is.
    pub fn names_white(&self) -> bool {
        self.white.is_some()
    }
}

/// The profile of paint where none is named.
pub const DEFAULT_PROFILE: &str = "orange";

/// What the marks look like.
#[derive(Args, Clone, Debug)]
pub struct MarkArgs {
    /// Mark profile: a built-in name, a RAL number (`ral-2007`), or a TOML file. `orange` takes safety orange from
    /// saturated to faded, 5 to 60 px wide; `apriltag-36h11`, `aruco-4x4-50` and other coded targets need a build with
    /// `--features coded`.
    #[arg(long, value_name = "NAME|FILE", default_value = DEFAULT_PROFILE, help_heading = "Marks")]
    pub profile: String,
    /// Side or diameter of the marks, in pixels (12 or 10..14) or a length (0.4m, 0.3..0.5m or 300..500mm). Default:
    /// what the profile says.
    #[arg(long, value_name = "SIZE", help_heading = "Marks")]
    pub mark_size: Option<MarkSize>,
    /// Drop candidates that do not satisfy this rule: `area in [20, 400) and eccentricity <= 0.9`. Properties: area,
    /// perimeter, width, height, extent, eccentricity, solidity, compactness, mean_distance, min_distance,
    /// max_distance. Repeat for more; docs/detection-options.md has the grammar.
    #[arg(long, value_name = "RULE", help_heading = "Marks")]
    pub gate: Vec<Rule>,
    /// Close gaps of the mask of paint with this structuring element, in place of the profile's: a small image whose
    /// pixels that are not 0 belong to it; its middle pixel is the origin and must be one of them.
    #[arg(long, value_name = "FILE", help_heading = "Marks")]
    pub closing: Option<PathBuf>,
    /// Open the mask of paint (remove specks and bridges) with this structuring element.
    #[arg(long, value_name = "FILE", help_heading = "Marks")]
    pub opening: Option<PathBuf>,
}

/// A paint by its colour, instead of a profile.
#[derive(Args, Debug)]
pub struct PaintArg {
    /// Colour of the paint in full sun, as #RRGGBB: makes a profile on the spot.
    #[arg(long, value_name = "#RRGGBB", value_parser = paint, conflicts_with = "profile", help_heading = "Marks")]
    pub paint: Option<String>,
}

impl PaintArg {
    /// The marks with this paint in place of the profile.
    pub fn of(&self, marks: &MarkArgs) -> MarkArgs {
        let profile = self.paint.clone().unwrap_or_else(|| marks.profile.clone());
        MarkArgs { profile, ..marks.clone() }
    }
}

fn paint(text: &str) -> Result<String, String> {
    let with_mark = if text.starts_with('#') { text.to_owned() } else { format!("#{text}") };
    match Profile::of_hex(&with_mark) {
        Some(profile) => Ok(profile.name),
        None => Err("a colour is #RRGGBB, such as #FFA421".into()),
    }
}

/// What is known before matching.
#[derive(Args, Debug)]
pub struct MatchArgs {
    /// Ground size of a pixel, in metres: 0.03 (±10 %), 0.03±5%, or 0.02..0.05; also 3cm or 30mm. Default: from the
    /// image's georeference or resolution, else unknown.
    #[arg(long, value_name = "M", allow_negative_numbers = true, help_heading = "Matching")]
    pub gsd: Option<Gsd>,
    /// The image's top points north within DEG degrees.
    #[arg(long, value_name = "DEG", num_args = 0..=1, default_missing_value = "15", help_heading = "Matching")]
    pub north_up: Option<f64>,
    /// Whether a georeference or resolution that the image already has may narrow the search.
    #[arg(long, value_enum, default_value = "auto", help_heading = "Matching")]
    pub prior: PriorArg,
    /// The image may be mirrored, as film scanned from its back is: try both ways. A list that is its own mirror image
    /// is refused then.
    #[arg(long, help_heading = "Matching")]
    pub allow_mirrored: bool,
    /// How the pattern is found: `robust` from pairs; `tpp`, the topological point patterns of the 2016 thesis.
    #[arg(long, value_enum, default_value = "robust", help_heading = "Matching")]
    pub matcher: MatcherArg,
    #[command(flatten)]
    pub patterns: PatternArgs,
    /// Write nothing when chance alone would produce more than P patterns as good as the one found.
    #[arg(long, value_name = "P", default_value_t = 1e-4, help_heading = "Matching")]
    pub max_false_alarms: f64,
    /// End the search for the pattern after so many seconds, found or not; without it the search counts its steps, so
    /// that the answer does not depend on the machine.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, help_heading = "Matching")]
    pub time_limit: Option<f64>,
}

impl MatchArgs {
    /// One clock for all searches of a run.
    pub fn limit(&self) -> TimeLimit {
        self.time_limit.map_or_else(TimeLimit::default, TimeLimit::seconds)
    }
}

/// Whether a file begins as the usual images do: TIFF, PNG, JPEG, JPEG 2000.
fn is_image(path: &Path) -> bool {
    const BEGINNINGS: [&[u8]; 7] =
        [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"\x89PNG", b"\xff\xd8\xff", b"\0\0\0\x0cjP"];
    // A pipe would wait for its writer.
    if !path.is_file() {
        return false;
    }
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(8).read_to_end(&mut start));
    read.is_ok() && BEGINNINGS.iter().any(|beginning| start.starts_with(beginning))
}

/// How the list of GCPs is read.
#[derive(Args, Debug)]
pub struct GcpArgs {
    /// Surveyed points: GeoJSON, CSV, KOF, OpenDroneMap, Pix4D, Metashape and QGIS lists, GeoPackage, Shapefile, KML,
    /// GPX.
    #[arg(long, value_name = "FILE", help_heading = "Ground control points")]
    // Asked for by `path`: a replay takes the points of the result.
    pub gcps: Option<PathBuf>,
    /// Coordinate reference system (CRS) of the list: EPSG code, WKT, PROJ string, a file with one, or `local` for
    /// local metres. Default: what the list says, else the image's where the points lie on it.
    #[arg(long, value_name = "CRS", help_heading = "Ground control points")]
    pub crs: Option<String>,
    /// CRS of the outputs, when it is not that of the points.
    #[arg(long, value_name = "CRS", help_heading = "Ground control points")]
    pub to_crs: Option<String>,
    /// Use only these points: names, patterns (G*), attributes (COLUMN=VALUE).
    #[arg(long, value_name = "A,B,…", value_delimiter = ',', help_heading = "Ground control points")]
    pub names: Vec<String>,
    /// Keep these points out of matching and fit, and compare them afterwards: names, patterns (C*), attributes
    /// (COLUMN=VALUE). A column `role` or `check` does the same.
    #[arg(long, value_name = "A,B,…", value_delimiter = ',', help_heading = "Ground control points")]
    pub check: Vec<String>,
    #[command(flatten)]
    pub accuracy: AccuracyArgs,
    #[command(flatten)]
    pub working_crs: WorkingCrsArgs,
}

impl GcpArgs {
    pub fn path(&self) -> anyhow::Result<&Path> {
        let path = self.gcps.as_deref().context("no list of GCPs: give --gcps FILE")?;
        if is_image(path) {
            bail!("{}: an image, no list of GCPs; the image comes first, the list behind --gcps", path.display());
        }
        Ok(path)
    }

    /// `image`: where the points are, when the list names no CRS.
    pub fn options(&self, image: Option<&RasterInfo>) -> GcpOptions {
        let mut options = GcpOptions {
            crs: self.crs.clone(),
            to_crs: self.to_crs.clone(),
            names: self.names.clone(),
            check: self.check.clone(),
            accuracy: self.accuracy.accuracy.clone(),
            image: image.and_then(working_crs::of_image),
            ..GcpOptions::default()
        };
        self.working_crs.fill(&mut options);
        options
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ReaderArg {
    Auto,
    Native,
    /// Native, uncompressed blocks as views of the file: for several runs at once on one file.
    Mapped,
    Gdal,
}

impl ReaderArg {
    pub fn choice(self) -> ReaderChoice {
        match self {
            ReaderArg::Auto => ReaderChoice::Auto,
            ReaderArg::Native => ReaderChoice::Native,
            ReaderArg::Mapped => ReaderChoice::Mapped,
            ReaderArg::Gdal => ReaderChoice::Gdal,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PriorArg {
    /// Use what the image has; when nothing fits, try again without.
    Auto,
    /// Ignore it.
    None,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MatcherArg {
    Robust,
    Tpp,
}

/// Match a list of candidates to a list of GCPs and solve the orientation; needs no image.
#[derive(Args, Debug)]
pub struct SolveArgs {
    /// CSV with the columns x and y (pixels; (0, 0) is the outer corner of the first pixel); score, covariance, size
    /// and elevation are used when there. With --patch: the result of a run (NAME.autoref.json).
    pub candidates: PathBuf,
    /// Replay what a review changed: the patch file that the page of --report saved. Needs no --gcps.
    #[arg(long, value_name = "FILE")]
    pub patch: Option<PathBuf>,
    /// Write the result here, as JSON. Without it nothing is written.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Width and height of the image, in pixels; tells which GCPs must be visible. Default: the candidates' extent.
    #[arg(long, value_name = "W,H", value_delimiter = ',', num_args = 1)]
    pub size: Vec<f64>,
    /// Replace an existing result.
    #[arg(long)]
    pub overwrite: bool,
    /// Print the result as one JSON document instead of the summary.
    #[arg(long)]
    pub json: bool,
    /// Print nothing but errors.
    #[arg(long)]
    pub quiet: bool,
    #[command(flatten)]
    pub gcps: GcpArgs,
    #[command(flatten)]
    pub matching: MatchArgs,
    #[command(flatten)]
    pub solving: SolvingArgs,
}
