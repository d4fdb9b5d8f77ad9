//! How well the points will hold the image: the error of a similarity through them, in the corners of the area.

use nalgebra::Matrix2;
use serde::Serialize;

use autoref_raster::coords::MapPoint;

use super::loss::worst_loss;

/// √(−2 ln 0.05): the Rayleigh distribution's 95 % in standard deviations.
const RADIUS_95: f64 = 2.447_747;
/// Baarda's √λ₀ for a significance of 0.1 % and a power of 80 %.
const BAARDA_SQRT_LAMBDA: f64 = 4.13;
/// The area is the points' own rectangle, grown by this share of its sides on every side.
const MARGIN: f64 = 0.1;

/// The error in one corner of the area.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CornerStrength {
    pub direction: &'static str,
    pub easting: f64,
    pub northing: f64,
    /// Standard deviation of a coordinate of the transform there, over that of one mark.
    pub factor: f64,
    /// The same after the loss that hurts most there.
    pub factor_after_loss: f64,
    /// Radius that holds the transform's error in 95 of 100 cases, metres; when the noise of a mark is known.
    pub error_95_m: Option<f64>,
    pub error_95_after_loss_m: Option<f64>,
}

/// How well a layout of marks would tell the transform.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Strength {
    /// 1σ of a coordinate of one mark, metres.
    pub noise_m: Option<f64>,
    pub corners: Vec<CornerStrength>,
    /// The point whose own blunder would show least: name, redundancy number, smallest blunder that a test notices.
    pub weakest: (String, f64, Option<f64>),
    /// What to change, in plain words.
    pub advice: Vec<String>,
}

/// `None` below three points or when they lie in one place.
pub fn strength(points: &[(String, MapPoint)], lose: usize, noise_m: Option<f64>) -> Option<Strength> {
    if points.len() < 3 {
        return None;
    }
    let places: Vec<MapPoint> = points.iter().map(|p| p.1).collect();
    let span = |f: fn(&MapPoint) -> f64| {
        let (low, high) =
            places.iter().map(f).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let margin = MARGIN * (high - low);
        (low - margin, high + margin)
    };
    let ((west, east), (south, north)) = (span(|p| p.easting), span(|p| p.northing));
    cofactor(&places, places[0])?;
    let corners: Vec<CornerStrength> = [
        ("north-west", west, north),
        ("north-east", east, north),
        ("south-east", east, south),
        ("south-west", west, south),
    ]
    .into_iter()
    .map(|(direction, easting, northing)| {
        let corner = MapPoint { easting, northing };
        let all = cofactor(&places, corner).unwrap_or(f64::INFINITY).sqrt();
        let left = worst_loss(&places, corner, lose).sqrt();
        let metres = |factor: f64| noise_m.map(|s| RADIUS_95 * s * factor).filter(|v| v.is_finite());
        CornerStrength {
            direction,
            easting,
            northing,
            factor: all,
            factor_after_loss: left.min(f64::MAX),
            error_95_m: metres(all),
            error_95_after_loss_m: metres(left),
        }
    })
    .collect();
    let redundancy = |i: usize| (1.0 - cofactor(&places, places[i]).unwrap_or(1.0)).max(0.0);
    let weakest =
        (0..places.len()).min_by(|&i, &j| redundancy(i).total_cmp(&redundancy(j))).expect("three points or more");
    let r = redundancy(weakest);
    let blunder = noise_m.filter(|_| r > 0.02).map(|s| BAARDA_SQRT_LAMBDA * s / r.sqrt());
    let advice = advice(&places, &corners, (&points[weakest].0, r));
    Some(Strength { noise_m, corners, weakest: (points[weakest].0.clone(), r, blunder), advice })
}

/// Variance of a coordinate of the transform at `at`, over that of one point: 1/n + d²/Σd².
pub(super) fn cofactor(places: &[MapPoint], at: MapPoint) -> Option<f64> {
    let n = places.len() as f64;
    // About the first point, so that coordinates of millions of metres lose no digits.
    let first = places.first()?;
    let offset = |p: &MapPoint| (p.easting - first.easting, p.northing - first.northing);
    let (e, m) = places.iter().map(offset).fold((0.0, 0.0), |(e, m), d| (e + d.0 / n, m + d.1 / n));
    let square = |p: &MapPoint| (offset(p).0 - e).powi(2) + (offset(p).1 - m).powi(2);
    let spread: f64 = places.iter().map(square).sum();
    (places.len() >= 2 && spread > 0.0).then(|| 1.0 / n + square(&at) / spread)
}

fn advice(places: &[MapPoint], corners: &[CornerStrength], weakest: (&str, f64)) -> Vec<String> {
    let mut advice = Vec::new();
    let n = places.len() as f64;
    let centre = places.iter().fold((0.0, 0.0), |(e, m), p| (e + p.easting / n, m + p.northing / n));
    let moment = |f: &dyn Fn(f64, f64) -> f64| {
        places.iter().map(|p| f(p.easting - centre.0, p.northing - centre.1)).sum::<f64>() / n
    };
    let m = Matrix2::new(moment(&|e, _| e * e), moment(&|e, n| e * n), moment(&|e, n| e * n), moment(&|_, n| n * n));
    let eigenvalues = m.symmetric_eigenvalues();
    if eigenvalues.min().max(0.0).sqrt() < 0.05 * eigenvalues.max().sqrt() {
        advice.push("the points lie almost on one line: put one or two well beside it".into());
    }
    let worst = corners.iter().max_by(|a, b| a.factor_after_loss.total_cmp(&b.factor_after_loss));
    if let Some(worst) = worst.filter(|c| c.factor_after_loss > 2.0) {
        advice.push(format!(
            "in the {} corner the error grows to {:.1} times that of one mark when the wrong marks are lost: put another there",
            worst.direction, worst.factor_after_loss
        ));
    }
    if weakest.1 < 0.2 {
        advice.push(format!(
            "a blunder at {} would hardly show (redundancy {:.2}): put another mark near it",
            weakest.0, weakest.1
        ));
    }
    advice
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_by_hand() {
        let at = |e: f64, n: f64| MapPoint { easting: 570_000.0 + e, northing: 7_032_000.0 + n };
        let points: Vec<_> = [(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)]
            .into_iter()
            .enumerate()
            .map(|(i, (e, n))| (format!("P{i}"), at(e, n)))
            .collect();
        let s = strength(&points, 1, Some(0.02)).expect("four points");
        // Corners are 60·√2 m from the middle, Σd² = 4·5000: q = 1/4 + 7200/20000 = 0.61.
        for corner in &s.corners {
            assert!((corner.factor - 0.61f64.sqrt()).abs() < 1e-9, "{corner:?}");
            assert!((corner.error_95_m.expect("noise") - RADIUS_95 * 0.02 * 0.61f64.sqrt()).abs() < 1e-9);
            assert!(corner.factor_after_loss > corner.factor);
        }
        // Every corner point has q = 1/4 + 5000/20000.
        assert!((s.weakest.1 - 0.5).abs() < 1e-9);
        assert!((s.weakest.2.expect("noise") - 4.13 * 0.02 / 0.5f64.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_line_is_named_and_one_place_is_refused() {
        let line: Vec<_> =
            (0..6).map(|i| (format!("P{i}"), MapPoint { easting: 37.0 * f64::from(i * i), northing: 0.0 })).collect();
        let s = strength(&line, 2, None).expect("six points");
        assert!(s.advice.iter().any(|a| a.contains("one line")), "{:?}", s.advice);
        let heap: Vec<_> = (0..4).map(|i| (format!("P{i}"), MapPoint { easting: 1.0, northing: 2.0 })).collect();
        assert!(strength(&heap, 2, None).is_none());
    }
}
