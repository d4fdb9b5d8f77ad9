//! Flags and helpers that several commands share.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use anyhow::{Context, bail};
use autoref_raster::atomic::Existing;
use autoref_raster::coords::{GeoTransform, Handedness};
use autoref_raster::crs::Crs;
use autoref_raster::mask::{Element, LONGEST_SIDE_PX};
use autoref_raster::memory_plan::{self, PlanOptions, ScanPlan};
use autoref_raster::{self as raster, RasterInfo, RasterSource, ReaderChoice};
use autoref_stream::gcp::GcpOptions;
use autoref_stream::matching::{Matcher, MirrorMatcher, Priors, RobustMatcher, TimeLimit};
use autoref_stream::pipeline::MarkDetector;
use autoref_stream::profile::{Profile, Rule, Size};
use clap::{Args, ValueEnum};

use crate::cli::accuracy::AccuracyArgs;
use crate::cli::patterns::PatternArgs;
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
}

/// What the marks look like.
#[derive(Args, Clone, Debug)]
pub struct MarkArgs {
    /// Mark profile: a built-in name, a RAL number (`ral-2007`), or a TOML file. `orange` takes safety orange from
    /// saturated to faded, 5 to 60 px wide; `apriltag-36h11`, `aruco-4x4-50` and other coded targets need a build with
    /// `--features coded`.
    #[arg(long, value_name = "NAME|FILE", default_value = "orange", help_heading = "Marks")]
    pub profile: String,
    /// Side or diameter of the marks, in pixels (12 or 10..14) or metres (0.4m or 0.3m..0.5m). Default: what the
    /// profile says.
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
    /// Ground size of a pixel, in metres: 0.03 (±10 %), 0.03±5%, or 0.02..0.05. Default: from the image's georeference
    /// or resolution, else unknown.
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
    /// Nothing is written when chance alone would produce more patterns as good as the one found.
    #[arg(long, value_name = "P", default_value_t = 1e-4, help_heading = "Matching")]
    pub max_false_alarms: f64,
    /// End the search for the pattern after so many seconds, found or not; without it the search counts its steps, so
    /// that the answer does not depend on the machine.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, help_heading = "Matching")]
    pub time_limit: Option<f64>,
}

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    let value = text.trim().parse::<f64>().ok().filter(|v| *v > 0.0 && v.is_finite());
    value.ok_or_else(|| format!("`{text}` is no positive number"))
}

fn seconds(text: &str) -> Result<f64, String> {
    let value = text.trim().trim_end_matches('s').parse::<f64>().ok().filter(|v| *v >= 0.0 && v.is_finite());
    value.ok_or_else(|| format!("`{text}` is no number of seconds"))
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
    /// CRS of the list (EPSG code, WKT, PROJ string, a file with one, or `local` for local metres). Default: what the
    /// list says, else the image's where the points lie on it.
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

/// A number of bytes.
#[derive(Clone, Copy, Debug)]
pub struct Bytes(pub u64);

impl FromStr for Bytes {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let trimmed = text.trim().trim_end_matches(['b', 'B']).trim_end_matches(['i', 'I']);
        let (number, unit) = match trimmed.char_indices().last() {
            Some((at, 'k' | 'K')) => (&trimmed[..at], 1u64 << 10),
            Some((at, 'm' | 'M')) => (&trimmed[..at], 1 << 20),
            Some((at, 'g' | 'G')) => (&trimmed[..at], 1 << 30),
            _ => (trimmed, 1),
        };
        let value: f64 = number.trim().parse().map_err(|_| format!("`{text}` is no size; write 512M or 2G"))?;
        let bytes = value * unit as f64;
        if !(1.0..1e18).contains(&bytes) {
            return Err(format!("`{text}` is no sensible size"));
        }
        Ok(Bytes(bytes as u64))
    }
}

/// A budget that the libraries fit into.
pub fn memory_budget(text: &str) -> Result<Bytes, String> {
    let bytes: Bytes = text.parse()?;
    if bytes.0 < memory_plan::SMALLEST_BUDGET_BYTES {
        return Err(format!("the least that is allowed is {}M", memory_plan::SMALLEST_BUDGET_BYTES >> 20));
    }
    Ok(bytes)
}

/// Smallest and largest ground size of a pixel, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gsd(pub f64, pub f64);

impl FromStr for Gsd {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let number = |t: &str| {
            let t = t.trim().trim_end_matches('m').trim();
            t.parse::<f64>().ok().filter(|v| *v > 0.0 && v.is_finite()).ok_or_else(|| {
                let hint = if t.contains(',') { "; write a decimal point" } else { "" };
                format!("`{t}` is no positive length in metres{hint}")
            })
        };
        let range = if let Some((low, high)) = text.split_once("..") {
            Gsd(number(low)?, number(high)?)
        } else if let Some((centre, tolerance)) = text.split_once('±').or_else(|| text.split_once("+-")) {
            let centre = number(centre)?;
            let half = match tolerance.trim().strip_suffix('%') {
                Some(percent) => centre * number(percent)? / 100.0,
                None => number(tolerance)?,
            };
            if half >= centre {
                return Err(format!("`{text}`: the tolerance is larger than the value"));
            }
            Gsd(centre - half, centre + half)
        } else {
            let centre = number(text)?;
            Gsd(centre * 0.9, centre * 1.1)
        };
        if range.0 > range.1 {
            return Err(format!("`{text}`: the smaller value comes first"));
        }
        Ok(range)
    }
}

/// A range of mark sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MarkSize {
    Pixels(f64, f64),
    Metres(f64, f64),
}

impl MarkSize {
    /// The same as a profile has it.
    pub fn of_profile(self) -> Size {
        match self {
            MarkSize::Pixels(low, high) => Size { min_px: Some(low), max_px: Some(high), min_m: None, max_m: None },
            MarkSize::Metres(low, high) => Size { min_px: None, max_px: None, min_m: Some(low), max_m: Some(high) },
        }
    }
}

/// As the command line takes it: `10..20px`.
impl std::fmt::Display for MarkSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            MarkSize::Pixels(low, high) => write!(f, "{low}..{high}px"),
            MarkSize::Metres(low, high) => write!(f, "{low}..{high}m"),
        }
    }
}

/// The word of a choice on the command line.
pub fn word_of(choice: impl clap::ValueEnum) -> String {
    choice.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

impl FromStr for MarkSize {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let (low, high) = text.split_once("..").unwrap_or((text, text));
        let metres = high.trim_end().ends_with('m');
        let number = |t: &str| {
            let t = t.trim().trim_end_matches("px").trim_end_matches('m').trim();
            t.parse::<f64>().ok().filter(|v| *v > 0.0 && v.is_finite()).ok_or(format!("`{t}` is no size"))
        };
        // A single size means about that size.
        let (low, high) = match (number(low)?, number(high)?) {
            (low, high) if low == high => (low * 0.75, high * 1.25),
            (low, high) if low < high => (low, high),
            _ => return Err(format!("`{text}`: the smaller size comes first")),
        };
        Ok(if metres { MarkSize::Metres(low, high) } else { MarkSize::Pixels(low, high) })
    }
}

/// An opened image with the detector and the plan for scanning it.
pub struct Prepared {
    pub source: Arc<dyn RasterSource>,
    pub detector: MarkDetector,
    pub plan: ScanPlan,
    /// What the plan was made with.
    pub options: PlanOptions,
}

/// As asked for, else one for each core.
pub fn threads(asked: Option<u64>) -> usize {
    asked.map_or_else(|| std::thread::available_parallelism().map_or(1, std::num::NonZero::get), |n| n as usize)
}

/// Opens the image, builds the detector, and plans before the first read.
pub fn prepare(image: &Path, read: &ReadArgs, marks: &MarkArgs, gsd: Option<Gsd>) -> anyhow::Result<Prepared> {
    let threads = threads(read.threads);
    // Fails only when a pool exists already, which then serves.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    let cache_bytes = autoref_raster::memory_plan::cache_share_bytes(read.memory.0);
    let choice = read.reader.choice();
    let profile = profile(marks)?;
    // Both take about as long. The image is opened on this thread, which will ask its coordinate system's library for
    // more.
    let (source, colours) = std::thread::scope(|scope| {
        let colours = scope.spawn(|| MarkDetector::colours(&profile));
        let source = raster::open(image, choice, read.page, cache_bytes);
        (source, colours.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    });
    let source = raster::with_white(source?, read.white)?;
    let info = source.info();
    let gsd_m = gsd.map(|g| (g.0 * g.1).sqrt()).or_else(|| known_gsd(info));
    let detector = MarkDetector::with_colours(profile, colours?, info, gsd_m)?;
    let options = PlanOptions {
        tile_px: read.tile,
        threads,
        memory_budget_bytes: read.memory.0,
        baseline_bytes: autoref_raster::memory_plan::baseline_bytes(),
        cache_bytes,
    };
    let plan = autoref_raster::memory_plan::plan(info, detector.as_detector().halo_px(), &options)?;
    tracing::info!(
        "{}: {}×{} px, {} bands, {} ({})",
        image.display(),
        info.width,
        info.height,
        info.bands,
        info.description,
        info.reader
    );
    tracing::info!("memory plan: {}", plan.line());
    Ok(Prepared { source, detector, plan, options })
}

fn profile(marks: &MarkArgs) -> anyhow::Result<Profile> {
    let mut profile = Profile::load(&marks.profile)?;
    if let Some(size) = marks.mark_size {
        profile.size = size.of_profile();
    }
    if !marks.gate.is_empty() && profile.is_target() {
        bail!("--gate is of paint; `{}` is found by its shape", profile.name);
    }
    let elements = [&marks.closing, &marks.opening];
    if elements.iter().any(|path| path.is_some()) && profile.is_target() {
        bail!("--closing and --opening are of paint; `{}` is found by its shape", profile.name);
    }
    let [closing, opening] = elements.map(|path| path.as_deref().map(structuring_element).transpose());
    profile.filters.closing_element = closing?.or(profile.filters.closing_element);
    profile.filters.opening_element = opening?.or(profile.filters.opening_element);
    for rule in &marks.gate {
        profile.gates.rule = Some(match profile.gates.rule.take() {
            Some(own) => own.and(rule.clone()),
            None => rule.clone(),
        });
    }
    Ok(profile)
}

/// The pixels of a small image that are not 0.
fn structuring_element(path: &Path) -> anyhow::Result<Element> {
    let source = raster::open(path, ReaderChoice::Auto, 0, 1 << 20)?;
    let (width, height) = (source.info().width, source.info().height);
    if width.max(height) > LONGEST_SIDE_PX as u64 {
        bail!(
            "{}: {width} × {height} pixels; a structuring element has at most {LONGEST_SIDE_PX} a side",
            path.display()
        );
    }
    let patch = raster::read_patch(source.as_ref(), source.info().bounds())?;
    let set = patch.rgb.iter().zip(&patch.valid).map(|(rgb, valid)| *valid && rgb.iter().any(|v| *v > 0)).collect();
    Element::new(set, width as usize).map_err(|what| anyhow::anyhow!("{}: {what}", path.display()))
}

/// Ground size of a pixel by the image's own account.
fn known_gsd(info: &RasterInfo) -> Option<f64> {
    prior_scale(info).map(|(low, high)| (low * high).sqrt())
}

/// Scale range by an existing georeference in metres (±10 %), or by one that names no system or the resolution tags
/// (±20 %): its unit may be anything.
fn prior_scale(info: &RasterInfo) -> Option<(f64, f64)> {
    let crs = info.crs_wkt.as_deref().and_then(|wkt| Crs::parse(wkt).ok());
    let unit_m = match &crs {
        Some(crs) if crs.is_geographic() => None,
        Some(crs) => Some(crs.metres_per_unit()),
        None => Some(1.0),
    };
    let georeferenced = info.geotransform.as_ref().zip(unit_m).map(|(t, unit_m)| t.scale() * unit_m);
    match (georeferenced, info.resolution_m_per_px) {
        (Some(gsd), _) if (1e-4..1e4).contains(&gsd) => {
            let open = if crs.is_some() { 0.1 } else { 0.2 };
            Some((gsd * (1.0 - open), gsd * (1.0 + open)))
        }
        (_, Some(gsd)) => Some((gsd * 0.8, gsd * 1.2)),
        _ => None,
    }
}

/// The ladder of priors: what the caller and the image say, then (when the image said anything) without the image's
/// part.
pub fn priors(info: &RasterInfo, matching: &MatchArgs) -> Vec<Priors> {
    let size = Some((info.width as f64, info.height as f64));
    let asked = Priors {
        gsd_m_per_px: matching.gsd.map(|g| (g.0, g.1)),
        rotation_deg: matching.north_up.map(|half| (0.0, half)),
        image_size_px: size,
    };
    let mut ladder = vec![asked.clone()];
    if matching.prior == PriorArg::Auto
        && asked.gsd_m_per_px.is_none()
        && let Some(scale) = prior_scale(info)
    {
        ladder.insert(0, Priors { gsd_m_per_px: Some(scale), ..asked });
    }
    ladder
}

/// Mirrored, where the image's own georeference is: rows that go north, or columns that go west.
pub fn own_handedness(info: &RasterInfo, matching: &MatchArgs) -> Option<Handedness> {
    // Pixels counted as if they were places are no georeference.
    const PIXELS: [f64; 6] = [0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let GeoTransform(g) = info.geotransform.filter(|own| matching.prior == PriorArg::Auto && own.0 != PIXELS)?;
    (g[1] * g[5] - g[2] * g[4] > 0.0).then_some(Handedness::Mirrored)
}

/// The matcher that was asked for, knowing how many sets of priors it may be tried with. `own`: what the image says of
/// its handedness; both ways are tried then.
pub fn matcher(
    matching: &MatchArgs,
    own: Option<Handedness>,
    tries: usize,
    time_limit: &TimeLimit,
) -> anyhow::Result<Box<dyn Matcher>> {
    if !(matching.max_false_alarms > 0.0 && matching.max_false_alarms <= 1.0) {
        bail!("--max-false-alarms {} is not between 0 and 1", matching.max_false_alarms);
    }
    if matching.north_up.is_some_and(|d| !(0.0..=180.0).contains(&d)) {
        bail!("--north-up takes degrees from 0 to 180");
    }
    if matching.allow_mirrored || own.is_some() {
        let within = one_way(matching, 2 * tries, time_limit)?;
        return Ok(Box::new(MirrorMatcher { within, expected: own }));
    }
    one_way(matching, tries, time_limit)
}

/// The matcher of images that are not mirrored.
fn one_way(matching: &MatchArgs, tries: usize, time_limit: &TimeLimit) -> anyhow::Result<Box<dyn Matcher>> {
    if matching.matcher == MatcherArg::Tpp {
        let max_false_alarms = matching.max_false_alarms / tries as f64;
        return Ok(Box::new(matching.patterns.matcher(matching.gsd, max_false_alarms)?));
    }
    Ok(Box::new(RobustMatcher {
        max_false_alarms: matching.max_false_alarms,
        tries: tries as f64,
        time_limit: time_limit.clone(),
        ..RobustMatcher::default()
    }))
}

/// Rounded to so many digits; what is printed as zero has no sign.
pub fn unsigned_zero(value: f64, digits: i32) -> f64 {
    let parts = 10f64.powi(digits);
    (value * parts).round() / parts + 0.0
}

/// Writes text to a file, whole or not at all, or to standard output for "-".
pub fn write_text(path: &Path, text: &[u8], existing: Existing) -> anyhow::Result<()> {
    use std::io::Write;
    if path.as_os_str() == "-" {
        crate::out::keep(std::io::stdout().write_all(text));
        return Ok(());
    }
    autoref_raster::atomic::check_outputs(&[path], existing)?;
    Ok(autoref_raster::atomic::write(path, text)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_printed_as_they_are_read() {
        for text in ["10..20px", "0.3..0.5m", "5.25..8.75px"] {
            assert_eq!(text.parse::<MarkSize>().map(|size| size.to_string()).as_deref(), Ok(text));
        }
    }

    #[test]
    fn ground_sample_distances_as_people_write_them() {
        assert_eq!("0.02..0.05".parse(), Ok(Gsd(0.02, 0.05)));
        let Gsd(low, high) = "0.03±5%".parse().expect("a range");
        assert!((low - 0.0285).abs() < 1e-12 && (high - 0.0315).abs() < 1e-12);
        let Gsd(low, high) = "0.03".parse().expect("a number");
        assert!((low - 0.027).abs() < 1e-12 && (high - 0.033).abs() < 1e-12);
        assert!("-1".parse::<Gsd>().is_err() && "0.05..0.02".parse::<Gsd>().is_err());
    }

    #[test]
    fn sizes_with_units() {
        assert_eq!("512M".parse::<Bytes>().expect("a size").0, 512 << 20);
        assert_eq!("2GiB".parse::<Bytes>().expect("a size").0, 2 << 30);
        assert!("many".parse::<Bytes>().is_err());
        assert_eq!("0.3m..0.5m".parse(), Ok(MarkSize::Metres(0.3, 0.5)));
    }
}
