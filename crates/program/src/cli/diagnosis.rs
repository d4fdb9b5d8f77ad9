//! The gross-error diagnosis at the end of a run: what it is told, and names that marks of a list carry.

use std::path::Path;

use rayon::prelude::*;

use autoref_raster::RasterInfo;
use autoref_raster::coords::PixelPoint;
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::error::Error;
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::GcpList;
use autoref_stream::matching::diagnosis::{Certainty, KnownPlace, exchanged_labels};
use autoref_stream::matching::{Evidence, MatchOutcome, Matcher, Pattern, Priors, RobustMatcher, TimeLimit};
use autoref_stream::pipeline::georeference::{Outcome, Surroundings, diagnose};

use crate::cli::args::MatchArgs;
use crate::cli::working_crs::Force;

/// Titles of a column with names of marks.
const NAMES: [&str; 5] = ["name", "label", "gcp", "gcp_name", "marker"];

pub fn examine(
    outcome: &mut Outcome,
    candidates: &[Candidate],
    list: &GcpList,
    priors: &Priors,
    known: Option<KnownPlace>,
    (matching, time_limit): (&MatchArgs, &TimeLimit),
    forced: &[Force],
) {
    // Coordinates in metres are those of the CRS only when it counts in metres.
    let crs = list.crs.as_ref().filter(|_| list.working_crs.is_plain());
    let surroundings =
        Surroundings { crs, known, max_false_alarms: matching.max_false_alarms, time_limit: time_limit.clone() };
    diagnose(outcome, candidates, &list.gcps, &priors.with_mark_sizes(candidates), surroundings);
    blame_options(outcome, candidates, list, priors, (matching, time_limit));
    refuse_mistakes(outcome, forced);
}

/// Options that narrow the search and are wrong: where nothing fits with them, what fits without is told. It is not
/// written: who gives an option has a reason.
fn blame_options(
    outcome: &mut Outcome,
    candidates: &[Candidate],
    list: &GcpList,
    priors: &Priors,
    (matching, time_limit): (&MatchArgs, &TimeLimit),
) {
    let Outcome::Refused(evidence) = outcome else { return };
    // A mistake of the whole list that was found explains the refusal.
    if evidence.diagnoses.iter().any(|diagnosis| diagnosis.certainty == Certainty::Claimed) {
        return;
    }
    let mut attempts: Vec<(&str, Priors)> = Vec::new();
    if matching.gsd.is_some() {
        attempts.push(("--gsd", Priors { gsd_m_per_px: None, ..priors.clone() }));
    }
    if matching.north_up.is_some() {
        attempts.push(("--north-up", Priors { rotation_deg: None, ..priors.clone() }));
    }
    if attempts.len() == 2 {
        let neither = Priors { gsd_m_per_px: None, rotation_deg: None, ..priors.clone() };
        attempts.push(("--gsd and --north-up", neither));
    }
    let matcher = RobustMatcher {
        max_false_alarms: matching.max_false_alarms,
        // Each attempt is one more chance for a false alarm.
        tries: 1.0 + attempts.len() as f64,
        // All together may do what one later search may.
        budget_hypotheses: RobustMatcher::default().budget_hypotheses
            / RobustMatcher::later_part(list.gcps.len())
            / attempts.len().max(1) as u64,
        time_limit: time_limit.clone(),
        ..RobustMatcher::default()
    };
    let fits = |(options, priors): &(&str, Priors)| match matcher.find(
        candidates,
        &list.gcps,
        &priors.with_mark_sizes(candidates),
    ) {
        MatchOutcome::Solved(solved) => Some(fits_without(options, &solved.pattern)),
        MatchOutcome::NoMatch(_) => None,
    };
    if let Some(advice) = attempts.par_iter().find_map_first(fits) {
        evidence.advice.insert(0, advice);
    }
}

/// `without --gsd it fits at 0.0300 m per pixel, turned by 12.3°: 10 points have a mark`.
fn fits_without(options: &str, pattern: &Pattern) -> String {
    let (scale, turned) = (pattern.similarity.scale_m_per_px(), pattern.similarity.rotation_deg());
    format!(
        "without {options} it fits at {scale:.4} m per pixel, turned {turned:.1}° anticlockwise from east: {} points have \
         a mark; leave the option out, or mend it",
        pattern.pairs.len()
    )
}

/// A solution whose whole list is plainly mistaken is refused, unless the mistake was named: it would be written wrong.
pub fn refuse_mistakes(outcome: &mut Outcome, forced: &[Force]) {
    let Outcome::Solved(orientation) = outcome else { return };
    // What has no name there (a mirrored image) refuses nothing: the verdict says it.
    let plain = orientation.diagnoses.iter().filter(|diagnosis| diagnosis.condemns_list()).find_map(|diagnosis| {
        let name = Force::of(diagnosis.mistake).filter(|name| !forced.contains(name))?;
        Some((diagnosis, name))
    });
    let Some((plain, name)) = plain else { return };
    let advice = vec![
        "give the --crs that the list is in, or mend the list".into(),
        format!("to go on in spite of it: --force {}", name.name()),
    ];
    *outcome = Outcome::Refused(Box::new(Evidence {
        reason: plain.message.clone(),
        advice,
        best: Some(orientation.evidence.pattern.clone()),
        runner_up: orientation.evidence.runner_up.clone(),
        effort: orientation.evidence.effort.clone(),
        diagnoses: orientation.diagnoses.clone(),
    }));
}

/// Where the image's own georeference puts its centre, in the metres of the list.
pub fn known_place(info: &RasterInfo, list: &GcpList) -> Option<KnownPlace> {
    let (transform, crs) = (info.geotransform?, list.crs.as_ref().filter(|_| list.working_crs.is_plain())?);
    let own = Crs::parse(info.crs_wkt.as_deref()?).ok()?;
    let centre_px = PixelPoint { x: info.width as f64 / 2.0, y: info.height as f64 / 2.0 };
    let place = transform.apply(centre_px);
    let mut point = [Coordinate { x: place.easting, y: place.northing, height: None }];
    own.transform(&mut point, crs, f64::INFINITY).ok()?;
    let centre = autoref_raster::coords::MapPoint { easting: point[0].x, northing: point[0].y };
    Some(KnownPlace { centre, centre_px })
}

/// Compares names that the marks of a list carry with what the pattern says.
///
/// # Errors
/// When the list cannot be read again.
pub fn labels(path: &Path, outcome: &mut Outcome, list: &GcpList) -> autoref_raster::error::Result<()> {
    let Outcome::Solved(orientation) = outcome else { return Ok(()) };
    let unreadable = |e: csv::Error| Error::format(path, "names of the marks", e.to_string());
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_path(path).map_err(unreadable)?;
    let headers = reader.headers().map_err(unreadable)?;
    let is_name = |h: &str| NAMES.iter().any(|n| h.trim_start_matches('\u{feff}').eq_ignore_ascii_case(n));
    let Some(column) = headers.iter().position(is_name) else { return Ok(()) };
    let mut labels = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let record = record.map_err(unreadable)?;
        labels.extend(record.get(column).filter(|n| !n.is_empty()).map(|name| (index, name.to_string())));
    }
    let told = exchanged_labels(&labels, &orientation.evidence.pattern, &list.gcps);
    orientation.diagnoses.extend(told);
    Ok(())
}
