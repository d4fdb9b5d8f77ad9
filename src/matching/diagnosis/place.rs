//! Scale and place of a fit against what the image says of itself.

use super::{Certainty, Diagnosis, FOOT_M, GrossErrors, Mistake, US_SURVEY_FOOT_M, neighbours};
use crate::gcp::leading_digits;
use crate::matching::Pattern;
use autoref_raster::coords::MapPoint;
use autoref_raster::crs::Coordinate;

/// Two places agree within this part of the image's diagonal, or this many metres if that is more.
const NEAR_DIAGONALS: f64 = 0.25;
const NEAR_M: f64 = 2.0;
/// Where a list lies so many times farther off than it would by a mistake, that mistake was made, however roughly the
/// image knows its own place: another zone moves a list by hundreds of kilometres, feet by thousands.
const FARTHER_BY_ZONE: f64 = 100.0;
const FARTHER_BY_FEET: f64 = 1000.0;
/// Scales agree within this (a georeference is rarely worse); factors of ground to grid lie within 0.5 %.
const SCALE_AGREES: f64 = 0.03;
/// Leading digits are told where the rest of the coordinates agrees so well: a place by chance does so once in 2,500.
const LEADING_AGREES_M: f64 = 100.0;
const GROUND_FACTOR: std::ops::Range<f64> = 2e-5..5e-3;

pub(super) fn diagnose(given: &GrossErrors<'_>, pattern: &Pattern) -> Vec<Diagnosis> {
    let Some(known) = given.known else { return scale_alone(given, pattern).into_iter().collect() };
    let solved = pattern.similarity.apply(known.centre_px);
    let scale = pattern.similarity.scale_m_per_px();
    let diagonal_m = 2.0 * known.centre_px.x.hypot(known.centre_px.y) * scale;
    let away = |p: MapPoint| (p.easting - known.centre.easting).hypot(p.northing - known.centre.northing);
    let found = away(solved);
    // What a mistake must improve upon, and by how much: a place that agrees has nothing to explain.
    let near_m = (NEAR_DIAGONALS * diagonal_m).max(NEAR_M);
    let told = |mistake, message: String| {
        vec![Diagnosis { mistake, certainty: Certainty::Claimed, gcps: Vec::new(), message, log10_false_alarms: None }]
    };
    let scaled = |f: f64| MapPoint { easting: solved.easting * f, northing: solved.northing * f };
    if found > 20.0 * near_m {
        let (international, survey) = (away(scaled(FOOT_M)), away(scaled(US_SURVEY_FOOT_M)));
        if international.min(survey) <= near_m.max(found / FARTHER_BY_FEET) {
            return told_feet(international, survey);
        }
    }
    if let Some(declared) = given.crs
        && found > 20.0 * near_m
    {
        for zone in neighbours(declared) {
            let mut point = [Coordinate { x: solved.easting, y: solved.northing, height: None }];
            if zone.transform(&mut point, declared, f64::INFINITY).is_err() {
                continue;
            }
            let left = away(MapPoint { easting: point[0].x, northing: point[0].y });
            if left <= near_m.max(found / FARTHER_BY_ZONE) {
                let there = if left <= near_m { "on it".to_string() } else { format!("{left:.0} m from it") };
                return told(
                    Mistake::WrongUtmZone,
                    format!(
                        "the list lies {:.0} km from where the image says it is, but {there} when read as {}: wrong UTM zone?",
                        found / 1000.0,
                        zone.title()
                    ),
                );
            }
        }
    }
    let wanted = (known.centre.easting - solved.easting, known.centre.northing - solved.northing);
    if let Some(digits) = leading_digits(wanted, near_m.min(LEADING_AGREES_M)) {
        return told(
            Mistake::LeadingDigits,
            format!("the list lies {:.0} km from where the image says it is, but on it with {digits}", found / 1000.0),
        );
    }
    ground_factor(known.centre, solved, found).map_or_else(Vec::new, |(factor, rest_m)| {
        told(
            Mistake::GridToGround,
            format!(
                "the list lies {found:.1} m from where the image says it is, and {rest_m:.1} m after division by {factor:.6}: \
                 ground coordinates for grid coordinates, or the reverse?"
            ),
        )
    })
}

fn told_feet(international: f64, survey: f64) -> Vec<Diagnosis> {
    let (mistake, kind) = if 3.0 * international < survey {
        (Mistake::InternationalFeet, "international feet")
    } else if 3.0 * survey < international {
        (Mistake::UsSurveyFeet, "US survey feet")
    } else {
        (Mistake::Feet, "feet (international or US survey: the image's own place is too rough to tell)")
    };
    let message = format!("the coordinates are in {kind} where metres were expected: the list lies on the image then");
    vec![Diagnosis { mistake, certainty: Certainty::Claimed, gcps: Vec::new(), message, log10_false_alarms: None }]
}

/// Greatest over least of a scale that is known closely.
const CLOSE_SCALE: f64 = 1.3;

/// The scale by the pattern is 3.28 times, or a 3.28th of, what was known before.
fn scale_alone(given: &GrossErrors<'_>, pattern: &Pattern) -> Option<Diagnosis> {
    let (low, high) = given.priors.gsd_m_per_px?;
    // What was known, give and take the same share.
    let expected = (low + high) / 2.0;
    // A rough idea of the scale does not tell feet from anything else.
    if high > 1.5 * low {
        return None;
    }
    let ratio = pattern.similarity.scale_m_per_px() / expected;
    let agrees = |r: f64| (r - 1.0).abs() < SCALE_AGREES.max(high / expected - 1.0);
    let (mistake, what) = if agrees(ratio * FOOT_M) {
        (Mistake::Feet, "the coordinates are in feet where metres were expected (international or US survey)")
    } else if agrees(ratio / FOOT_M) {
        (Mistake::GsdInFeet, "the ground sample distance is in feet, or metres were declared to be feet")
    } else {
        return None;
    };
    // A scale that is known to a few percent is 3.28 times another by that mistake only.
    let certainty = if high < CLOSE_SCALE * low { Certainty::Claimed } else { Certainty::Possible };
    Some(Diagnosis {
        mistake,
        certainty,
        gcps: Vec::new(),
        message: format!("a pixel is {ratio:.4} times as large as the image says: {what}?"),
        log10_false_alarms: None,
    })
}

/// A factor that takes both coordinates from the known place to the solved one: it, and what it leaves.
fn ground_factor(known: MapPoint, solved: MapPoint, found_m: f64) -> Option<(f64, f64)> {
    let square = known.easting.powi(2) + known.northing.powi(2);
    let factor = (solved.easting * known.easting + solved.northing * known.northing) / square;
    let rest_m = (solved.easting - factor * known.easting).hypot(solved.northing - factor * known.northing);
    // The shift must be along the position vector to a fiftieth: any shift has a factor, few point away from the
    // origin.
    let plausible = GROUND_FACTOR.contains(&(factor - 1.0).abs()) && found_m > 20.0 && rest_m < found_m / 50.0;
    plausible.then_some((factor, rest_m))
}
