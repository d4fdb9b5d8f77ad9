//! Before the flight: will the pattern of the marks be recognised, how well will it hold the image, how large must a
//! mark be, and which paint stands out? Nothing here needs an image but the last question, which needs an old one.

pub mod ambiguity;
mod loss;
mod moves;
pub(crate) mod paint;
mod strength;

pub use ambiguity::{Ambiguity, Freedom};
pub use moves::{Move, moves};
pub use paint::{PaintRank, rank_paints};
pub use strength::{CornerStrength, Strength, strength};

use autoref_raster::words::counted;
use serde::Serialize;

use autoref_raster::coords::MapPoint;

/// Sides of marks, pixels, from `docs/benchmark-detection.md`: from the smaller on at least 99 % are found, at the
/// larger the centre is also known to a twentieth of a pixel and wear costs little.
pub const SMALLEST_MARK_PX: f64 = 6.0;
pub const COMFORTABLE_MARK_PX: f64 = 10.0;
/// Fewest marks that the matcher can believe in without other knowledge (`docs/limitations.md`).
pub const FEWEST_MARKS: usize = 4;
/// How near a wrong place must be to pass for right, in pixels: the widest tolerance of the matcher's evidence.
pub const TOLERANCE_PX: f64 = 12.0;
/// The same when the size of a pixel is unknown: [`TOLERANCE_PX`] of an image of some 5,000 pixels.
pub const TOLERANCE_SHARE: f64 = 0.0025;
/// 1σ of a coordinate of a mark about a similarity, pixels, in a real orthophoto: that of the 14 points of Table B.8 of
/// the 2016 thesis (RMSE 0.0641 m at 0.032 m, 24 redundant of 28).
pub const TYPICAL_NOISE_PX: f64 = 1.5;

/// What is asked.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanRequest {
    /// How many marks may be lost: hidden, driven over, outside.
    pub lose: usize,
    /// Ground size of a pixel, metres: smallest and largest. Lengths in pixels are reckoned with their middle, which is
    /// the given value where one was given with a tolerance.
    pub gsd_m: Option<(f64, f64)>,
    /// The image's top will point north within so many degrees.
    pub north_up_deg: Option<f64>,
    /// How near counts as the same place, metres; from the ground sample distance when absent.
    pub tolerance_m: Option<f64>,
    /// 1σ of a coordinate of one mark, metres; from the ground sample distance when absent.
    pub noise_m: Option<f64>,
}

impl Default for PlanRequest {
    fn default() -> Self {
        PlanRequest { lose: 2, gsd_m: None, north_up_deg: None, tolerance_m: None, noise_m: None }
    }
}

/// How large a mark must be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MarkAdvice {
    pub gsd_m: f64,
    /// Sides or diameters, metres.
    pub smallest_m: f64,
    pub comfortable_m: f64,
}

/// What is known of a plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    pub points: usize,
    pub lose: usize,
    pub tolerance_m: f64,
    /// Enough points are left when `lose` are gone.
    pub enough_points: bool,
    /// No other way of laying the pattern on itself survives the loss.
    pub unique: bool,
    /// The ways that do, the worst first; at most [`ambiguity::MOST_REPORTED`].
    pub ambiguities: Vec<Ambiguity>,
    /// What to move so that the pattern becomes unique.
    pub moves: Vec<Move>,
    /// The moves suffice.
    pub moves_suffice: bool,
    /// Pairs of points so close that one may be taken for the other.
    pub too_close: Vec<(String, String, f64)>,
    pub strength: Option<Strength>,
    pub mark: Option<MarkAdvice>,
    /// In plain words, in order of importance; empty when all is well.
    pub advice: Vec<String>,
}

/// Looks at the pattern of `points` (name, place; projected metres).
pub fn plan(points: &[(String, MapPoint)], request: &PlanRequest) -> Plan {
    let places: Vec<MapPoint> = points.iter().map(|p| p.1).collect();
    let gsd = request.gsd_m.map(|(low, high)| (low + high) / 2.0);
    let tolerance_m = request
        .tolerance_m
        .or(gsd.map(|g| TOLERANCE_PX * g))
        .unwrap_or_else(|| TOLERANCE_SHARE * diagonal(&places).max(1e-9));
    let freedom = Freedom {
        lose: request.lose,
        tolerance_m,
        scale_ratio: request.gsd_m.map(|(low, high)| high / low),
        turn_deg: request.north_up_deg.map(|half| 2.0 * half),
    };
    let enough_points = points.len() >= request.lose + FEWEST_MARKS;
    let mut ambiguities = ambiguity::find(&places, &freedom);
    let too_close = close_pairs(points, tolerance_m);
    let unique = ambiguities.is_empty();
    let (moves, moves_suffice) = if unique || !enough_points { (Vec::new(), unique) } else { moves(points, &freedom) };
    ambiguities.truncate(ambiguity::MOST_REPORTED);
    let noise_m = request.noise_m.or(gsd.map(|g| TYPICAL_NOISE_PX * g));
    let mut plan = Plan {
        points: points.len(),
        lose: request.lose,
        tolerance_m,
        enough_points,
        unique,
        ambiguities,
        moves,
        moves_suffice,
        too_close,
        strength: strength(points, request.lose, noise_m),
        mark: gsd.map(|gsd_m| MarkAdvice {
            gsd_m,
            smallest_m: SMALLEST_MARK_PX * gsd_m,
            comfortable_m: COMFORTABLE_MARK_PX * gsd_m,
        }),
        advice: Vec::new(),
    };
    plan.advice = advice(points, &plan);
    plan
}

fn diagonal(points: &[MapPoint]) -> f64 {
    let span = |f: fn(&MapPoint) -> f64| {
        let values = points.iter().map(f);
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    if points.is_empty() { 0.0 } else { span(|p| p.easting).hypot(span(|p| p.northing)) }
}

fn close_pairs(points: &[(String, MapPoint)], tolerance_m: f64) -> Vec<(String, String, f64)> {
    let mut close = Vec::new();
    for (i, (name, p)) in points.iter().enumerate() {
        for (other, q) in &points[i + 1..] {
            let distance = (p.easting - q.easting).hypot(p.northing - q.northing);
            if distance < 2.0 * tolerance_m {
                close.push((name.clone(), other.clone(), distance));
            }
        }
    }
    close.sort_by(|a, b| a.2.total_cmp(&b.2));
    close.truncate(ambiguity::MOST_REPORTED);
    close
}

fn advice(points: &[(String, MapPoint)], plan: &Plan) -> Vec<String> {
    let mut advice = Vec::new();
    if !plan.enough_points {
        advice.push(format!(
            "{} points, and {} of them when {} are lost: plan at least {}, or chance cannot be ruled out",
            plan.points,
            plan.points.saturating_sub(plan.lose),
            plan.lose,
            plan.lose + FEWEST_MARKS
        ));
    }
    let names = |list: &[usize]| list.iter().map(|&i| points[i].0.as_str()).collect::<Vec<_>>().join(", ");
    if plan.enough_points
        && let Some(worst) = plan.ambiguities.first()
    {
        let lost = match worst.unmatched.len() {
            0 => "even with every mark found".to_string(),
            _ => format!("when {} are lost", names(&worst.unmatched)),
        };
        advice.push(format!("the pattern also fits itself {}, {lost}", worst.words()));
        let more = plan.ambiguities.len() - 1;
        if more > 0 {
            let at_least = if plan.ambiguities.len() == ambiguity::MOST_REPORTED { "at least " } else { "" };
            let more = counted(more, "other way is", "other ways are");
            advice.push(format!("{at_least}{more} as bad or nearly so"));
        }
    }
    advice.extend(plan.moves.iter().map(Move::words));
    if plan.enough_points && !plan.moves_suffice {
        advice.push(match plan.moves.is_empty() {
            true => "no single move was found to help: lay the points out anew, at irregular places".into(),
            false => "these moves help but do not suffice: add points at irregular places".into(),
        });
    }
    for (a, b, distance) in &plan.too_close {
        advice.push(format!("{a} and {b} are only {distance:.2} m apart: one may be taken for the other"));
    }
    if let Some(strength) = &plan.strength {
        advice.extend(strength.advice.iter().cloned());
    }
    advice
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ground_size_given_with_a_tolerance_is_taken_as_it_is() {
        let points: Vec<_> = [(0.0, 0.0), (40.0, 3.0), (37.0, 61.0), (9.0, 55.0), (21.0, 30.0)]
            .into_iter()
            .enumerate()
            .map(|(i, (easting, northing))| (format!("P{i}"), MapPoint { easting, northing }))
            .collect();
        let plan = plan(&points, &PlanRequest { gsd_m: Some((0.027, 0.033)), ..PlanRequest::default() });
        let mark = plan.mark.expect("a ground size");
        assert!((mark.gsd_m - 0.03).abs() < 1e-12 && (mark.smallest_m - 0.18).abs() < 1e-12, "{mark:?}");
        assert!((plan.tolerance_m - 0.36).abs() < 1e-12, "{}", plan.tolerance_m);
        let noise_m = plan.strength.and_then(|s| s.noise_m).expect("a ground size");
        assert!((noise_m - 0.045).abs() < 1e-12, "{noise_m}");
    }

    #[test]
    fn an_empty_or_tiny_plan_is_answered() {
        for n in 0..4 {
            let points: Vec<_> =
                (0..n).map(|i| (format!("P{i}"), MapPoint { easting: 10.0 * f64::from(i), northing: 3.0 })).collect();
            let plan = plan(&points, &PlanRequest::default());
            assert!(!plan.enough_points && !plan.advice.is_empty() && plan.moves.is_empty());
        }
    }
}
