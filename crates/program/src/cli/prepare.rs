//! From options to what a run needs: the open image, its detector and plan, priors and a matcher.

use std::path::Path;
use std::sync::Arc;

use anyhow::bail;
use autoref_raster::coords::{GeoTransform, Handedness};
use autoref_raster::crs::Crs;
use autoref_raster::mask::{Element, LONGEST_SIDE_PX};
use autoref_raster::memory_plan::{PlanOptions, ScanPlan};
use autoref_raster::{self as raster, Georeference, RasterInfo, RasterSource, ReaderChoice};
use autoref_stream::gcp::{self, GcpOptions};
use autoref_stream::georef::beneath;
use autoref_stream::matching::{Matcher, MirrorMatcher, OfImage, Priors, RobustMatcher, TimeLimit};
use autoref_stream::pipeline::MarkDetector;
use autoref_stream::pipeline::asked::Asked;
use autoref_stream::profile::{Profile, Rule};

use crate::cli::args::{MarkArgs, MatchArgs, MatcherArg, PriorArg, ReadArgs};
use crate::cli::values::{Gsd, MarkSize};
use autoref_raster::words::counted;

/// An opened image with the detector and the plan for scanning it.
pub struct Prepared {
    /// With the georeference that the image had before any run of this program, where that is known.
    pub source: Arc<dyn RasterSource>,
    /// What an earlier run has written over that.
    pub written: Option<GeoTransform>,
    pub detector: MarkDetector,
    pub plan: ScanPlan,
    /// What the plan was made with.
    pub options: PlanOptions,
    /// Of the marks, whatever their paint.
    pub asked: Asked,
}

/// As asked for, else one for each core.
pub fn threads(asked: Option<u64>) -> usize {
    asked.map_or_else(|| std::thread::available_parallelism().map_or(1, std::num::NonZero::get), |n| n as usize)
}

/// A list that was given for the image is named as one.
fn of_a_list(image: &Path, error: autoref_raster::Error) -> autoref_raster::Error {
    let read = gcp::read(image, &GcpOptions { crs: Some("local".into()), ..GcpOptions::default() });
    match read {
        Ok(list) => autoref_raster::Error::usage(
            format!("{}: this is a list of {}, no image", image.display(), counted(list.gcps.len(), "point", "points")),
            format!("name the orthophoto first and the list behind it: IMAGE --gcps {}", image.display()),
        ),
        Err(_) => error,
    }
}

/// Opens the image, builds the detector, and plans before the first read.
pub fn open(image: &Path, read: &ReadArgs, marks: &MarkArgs, gsd: Option<Gsd>) -> anyhow::Result<Prepared> {
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
    let source = source.map_err(|error| of_a_list(image, error))?;
    let source = raster::with_white(source, read.white)?;
    let (source, written) = as_it_came(source, read.page);
    let info = source.info();
    let gsd_m = gsd.map(Gsd::middle_m).or_else(|| known_gsd(info));
    if gsd_m.is_none() && matches!(marks.mark_size, Some(MarkSize::Metres(..))) {
        bail!(
            "--mark-size gives a length, and the ground size of a pixel is not known; give --gsd, or the size in pixels"
        );
    }
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
        "{}: {}×{} px, {}, {} ({})",
        image.display(),
        info.width,
        info.height,
        counted(info.bands, "band", "bands"),
        info.description,
        info.reader
    );
    tracing::info!("memory plan: {}", plan.line());
    let asked = asked(marks, gsd_m);
    Ok(Prepared { source, written, detector, plan, options, asked })
}

/// The image with the georeference that it came with, so that a second run says what the first one said; beside it the
/// one that an earlier run wrote. Counted pixels are no georeference.
fn as_it_came(source: Arc<dyn RasterSource>, page: usize) -> (Arc<dyn RasterSource>, Option<GeoTransform>) {
    let info = source.info();
    let shown = Georeference { transform: info.geotransform, crs_wkt: info.crs_wkt.clone() };
    let beneath = beneath::beneath(info, page);
    let is_other = |shown: &GeoTransform| {
        let known = beneath.as_ref().map(|beneath| beneath.transform);
        known.is_some_and(|known| known.is_none_or(|known| known.differs_px(shown) >= beneath::SAME_PX))
    };
    let written = shown.transform.filter(is_other);
    if let Some(beneath) = &beneath {
        let what = if beneath.transform.is_some() { "the one beneath counts" } else { "none is known beneath" };
        tracing::info!("{}: its georeference is of an earlier run: {what}", info.path.display());
    }
    // Where nothing is known beneath, the earlier run says where the image lies: a wrong zone shows against it.
    let mut came = beneath.filter(|beneath| beneath.transform.is_some()).unwrap_or_else(|| shown.clone());
    came.transform = came.transform.filter(|own| !own.counts_pixels());
    let source = if came == shown { source } else { raster::with_georeference(source, came) };
    (source, written)
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
    let own = profile.gates.rule.take();
    profile.gates.rule = own.into_iter().chain(marks.gate.iter().cloned()).reduce(Rule::and);
    Ok(profile)
}

/// What `--mark-size` and `--gate` say, of paint of any colour.
fn asked(marks: &MarkArgs, gsd_m: Option<f64>) -> Asked {
    let size = marks.mark_size.map(|size| format!("--mark-size {size}"));
    let rules = marks.gate.iter().map(|rule| format!("--gate '{}'", String::from(rule.clone())));
    Asked {
        size: marks.mark_size.map(MarkSize::of_profile),
        rule: marks.gate.iter().cloned().reduce(Rule::and),
        gsd_m,
        options: size.into_iter().chain(rules).collect(),
    }
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

/// The same, but for what an earlier run has `written`: that came of the list, and would bear witness for itself.
fn own_scale(info: &RasterInfo, written: Option<GeoTransform>) -> Option<(f64, f64)> {
    let geotransform = info.geotransform.filter(|own| written != Some(*own));
    prior_scale(&RasterInfo { geotransform, ..info.clone() })
}

/// The ladder of priors: what the caller and the image say, then (when the image said anything) without the image's
/// part. An earlier run's answer is none of them.
pub fn priors((info, written): (&RasterInfo, Option<GeoTransform>), matching: &MatchArgs) -> Vec<Priors> {
    let size = Some((info.width as f64, info.height as f64));
    let own_scale = own_scale(info, written).filter(|_| matching.prior == PriorArg::Auto);
    let asked = Priors {
        gsd_m_per_px: matching.gsd.map(|g| (g.0, g.1)),
        rotation_deg: matching.north_up.map(|half| (0.0, half)),
        image_size_px: size,
    };
    let mut ladder = vec![asked.clone()];
    if asked.gsd_m_per_px.is_none()
        && let Some(scale) = own_scale
    {
        ladder.insert(0, Priors { gsd_m_per_px: Some(scale), ..asked });
    }
    ladder
}

/// What the image says of itself, where it may: nothing of itself by default.
#[derive(Clone, Copy, Debug, Default)]
pub struct OwnWord {
    /// Mirrored, where its georeference is: rows that go north, or columns that go west.
    handedness: Option<Handedness>,
    of_image: OfImage,
}

impl OwnWord {
    pub fn of((info, written): (&RasterInfo, Option<GeoTransform>), matching: &MatchArgs) -> OwnWord {
        if matching.prior != PriorArg::Auto {
            return OwnWord::default();
        }
        let is_mirrored = |&GeoTransform(g): &GeoTransform| g[1] * g[5] - g[2] * g[4] > 0.0;
        OwnWord {
            handedness: info.geotransform.filter(is_mirrored).map(|_| Handedness::Mirrored),
            of_image: OfImage { scale: own_scale(info, written).is_some(), north: info.geotransform.is_some() },
        }
    }
}

/// What a matcher's searches have together.
#[derive(Clone, Copy)]
pub struct Shared {
    /// So many, sets of priors and looks at the image, share the limit on false alarms.
    pub chances: usize,
    /// Each may do this part of the work that one may do.
    pub part: u64,
}

/// The matcher that was asked for. Where the image says something of its handedness both ways are tried.
pub fn matcher(
    matching: &MatchArgs,
    own: OwnWord,
    shared: Shared,
    time_limit: &TimeLimit,
) -> anyhow::Result<Box<dyn Matcher>> {
    if !(matching.max_false_alarms > 0.0 && matching.max_false_alarms <= 1.0) {
        bail!("--max-false-alarms {} is not between 0 and 1", matching.max_false_alarms);
    }
    if matching.north_up.is_some_and(|d| !(0.0..=180.0).contains(&d)) {
        bail!("--north-up takes degrees from 0 to 180");
    }
    if matching.allow_mirrored || own.handedness.is_some() {
        let shared = Shared { chances: 2 * shared.chances, ..shared };
        let within = one_way(matching, own.of_image, shared, time_limit)?;
        return Ok(Box::new(MirrorMatcher { within, expected: own.handedness }));
    }
    one_way(matching, own.of_image, shared, time_limit)
}

/// The matcher of images that are not mirrored.
fn one_way(
    matching: &MatchArgs,
    of_image: OfImage,
    shared: Shared,
    time_limit: &TimeLimit,
) -> anyhow::Result<Box<dyn Matcher>> {
    if matching.matcher == MatcherArg::Tpp {
        let max_false_alarms = matching.max_false_alarms / shared.chances as f64;
        return Ok(Box::new(matching.patterns.matcher(matching.gsd, max_false_alarms)?));
    }
    Ok(Box::new(RobustMatcher {
        max_false_alarms: matching.max_false_alarms,
        tries: shared.chances as f64,
        budget_hypotheses: RobustMatcher::default().budget_hypotheses / shared.part,
        time_limit: time_limit.clone(),
        of_image,
    }))
}
