//! What is said of accuracy holds: the expected-error map over synthetic cases.

mod common;

use autoref_stream::accuracy::ErrorModel;
use autoref_stream::coords::{MapPoint, PixelPoint};
use autoref_stream::solve::{Pair, Similarity, solve};
use common::Random;

const SIZE_PX: (f64, f64) = (8000.0, 6000.0);

#[derive(Clone, Copy, Debug)]
enum Noise {
    Equal,
    /// Each point's own stated σ, the survey's: 1 to 5 times the smallest, and nothing else.
    Stated,
    /// The same, and a common part that nobody states.
    StatedAndCommon,
}

/// Shares of check positions within the radii of the transform and of a point.
fn coverage(cases: u64, points: usize, noise: Noise, seed: u64) -> (f64, f64) {
    let (mut transform, mut point, mut total) = (0u64, 0u64, 0u64);
    for case in 0..cases {
        let mut random = Random::new(seed.wrapping_mul(1_000_003) + case);
        let angle = random.uniform(-3.1, 3.1);
        let scale = 0.03;
        let truth = Similarity { a_re: scale * f64::cos(angle), a_im: scale * f64::sin(angle), easting_0: 570_000.0, northing_0: 7_032_000.0 };
        let mut precision = 0.0;
        let pairs: Vec<Pair> = (0..points)
            .map(|_| {
                let pixel = PixelPoint { x: random.uniform(0.0, SIZE_PX.0), y: random.uniform(0.0, SIZE_PX.1) };
                let (survey, common) = match noise {
                    Noise::Equal => (None, 0.02),
                    Noise::Stated => (Some(0.01 * 5f64.powf(random.uniform(0.0, 1.0))), 0.0),
                    Noise::StatedAndCommon => (Some(0.01 * 5f64.powf(random.uniform(0.0, 1.0))), 0.03),
                };
                let sigma = survey.unwrap_or(0.0).hypot(common);
                precision += 1.0 / (sigma * sigma);
                let exact = truth.apply(pixel);
                let map = MapPoint { easting: exact.easting + sigma * random.normal(), northing: exact.northing + sigma * random.normal() };
                Pair { pixel, covariance_px2: None, map, survey_sigma_m: survey }
            })
            .collect();
        let unit_sigma = (points as f64 / precision).sqrt();
        let solution = solve(&pairs).expect("random points");
        let model = ErrorModel::new(&solution).expect("noise is known");
        for i in 0..25 {
            let p = PixelPoint { x: SIZE_PX.0 * f64::from(i % 5) / 4.0, y: SIZE_PX.1 * f64::from(i / 5) / 4.0 };
            let (computed, exact) = (solution.similarity.apply(p), truth.apply(p));
            let (e, n) = (computed.easting - exact.easting, computed.northing - exact.northing);
            let expected = model.at(p);
            transform += u64::from(e.hypot(n) <= expected.transform_95_m);
            let (e, n) = (e + unit_sigma * random.normal(), n + unit_sigma * random.normal());
            point += u64::from(e.hypot(n) <= expected.point_95_m);
            total += 1;
        }
    }
    (transform as f64 / total as f64, point as f64 / total as f64)
}

#[test]
fn explore() {
    for noise in [Noise::Equal, Noise::Stated, Noise::StatedAndCommon] {
        for points in [2, 3, 4, 5, 6, 8, 12, 20, 40] {
            if points == 2 && matches!(noise, Noise::Equal) { continue; }
            let (t, p) = coverage(8000, points, noise, 1);
            println!("{noise:?} {points}: transform {:.4} point {:.4}", t, p);
        }
    }
}
