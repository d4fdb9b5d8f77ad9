//! The numbers of the 2016 thesis from its own tables: reproduced where they are right, and beside the right ones where
//! they are not. `docs/thesis-comparison.md` shows both.

use crate::common::{rows, thesis_candidates, thesis_gcps};
use autoref_raster::coords::PixelPoint;
use autoref_solve::absolute::{self, AbsoluteOrientation, Method, PointPair};
use autoref_solve::heights::{self, HeightModel, HeightPoint};
use autoref_solve::{Pair, Solution, kraus, solve};
use nalgebra::{Matrix3, Vector3};

fn table(number: u32) -> String {
    format!("thesis/b{number}_cm.csv")
}

/// Marks (x, −y in pixels, elevation in metres) and surveyed points: units mixed, as in the thesis.
fn space(number: u32) -> Option<Vec<PointPair>> {
    let (marks, gcps) = (thesis_candidates(&table(number))?, thesis_gcps(&table(number))?);
    let pair = |(m, g): (&autoref_stream::candidate::Candidate, &autoref_stream::gcp::Gcp)| PointPair {
        model: Vector3::new(m.centre.x, -m.centre.y, m.elevation_m.expect("the table has elevations")),
        target: Vector3::new(g.easting, g.northing, g.height.expect("the table has heights")),
    };
    Some(marks.iter().zip(&gcps).map(pair).collect())
}

fn plane(number: u32) -> Option<Vec<Pair>> {
    let (marks, gcps) = (thesis_candidates(&table(number))?, thesis_gcps(&table(number))?);
    let pair = |(m, g): (&autoref_stream::candidate::Candidate, &autoref_stream::gcp::Gcp)| Pair {
        pixel: m.centre,
        covariance_px2: None,
        map: g.position(),
        survey_sigma_m: None,
    };
    Some(marks.iter().zip(&gcps).map(pair).collect())
}

fn solved(pairs: &[PointPair], method: Method) -> AbsoluteOrientation {
    absolute::solve(pairs, method).expect("the thesis's points determine an orientation")
}

fn assert_near(what: &str, value: f64, expected: f64, tolerance: f64) {
    assert!((value - expected).abs() <= tolerance, "{what}: {value}, expected {expected} ± {tolerance}");
}

#[test]
fn umeyamas_scale_is_right_and_best_on_every_set() {
    for (number, umeyama, symmetric, digit) in
        [(10, 2.24777, 2.24809, 1e-5), (4, 2.749_819, 2.750_045, 1e-6), (8, 0.847_466, 0.847_475, 1e-6)]
    {
        let Some(pairs) = space(number) else { return };
        assert_near("Umeyama", solved(&pairs, Method::Umeyama).rmse, umeyama, digit);
        assert_near("symmetric", solved(&pairs, Method::UmeyamaSymmetricScale).rmse, symmetric, digit);
    }
    for number in 4..=11 {
        let Some(pairs) = space(number) else { return };
        let best = solved(&pairs, Method::Umeyama).rmse;
        for method in [Method::Horn, Method::HornHilden, Method::UmeyamaSymmetricScale] {
            assert!(best <= solved(&pairs, method).rmse, "B.{number}: {method:?}");
        }
    }
    let Some(pairs) = space(10) else { return };
    assert_near("B.10 scale", solved(&pairs, Method::Umeyama).scale, 0.031_989_7, 5e-8);
}

#[test]
fn the_thesiss_umeyama_comes_from_a_divisor_of_three() {
    let Some(pairs) = space(10) else { return };
    let right = solved(&pairs, Method::Umeyama);
    // A covariance divided by its 3 columns, where the variance was divided by the 7 points.
    let wrong = right.scale * pairs.len() as f64 / 3.0;
    // Table B.10 is printed with fewer digits than the thesis computed with.
    assert_near("B.22", wrong, 0.074_642_565_334_224_6, 1e-8);
    let n = pairs.len() as f64;
    let model: Vector3<f64> = pairs.iter().map(|p| p.model).sum::<Vector3<f64>>() / n;
    let target: Vector3<f64> = pairs.iter().map(|p| p.target).sum::<Vector3<f64>>() / n;
    let squares: f64 =
        pairs.iter().map(|p| ((p.target - target) - wrong * (right.rotation * (p.model - model))).norm_squared()).sum();
    assert_near("Table B.25", (squares / n).sqrt(), 89.256_115_378_846_9, 1e-4);
}

#[test]
fn horn_horn_hilden_umeyama_and_kraus_give_one_rotation() {
    for number in 4..=11 {
        let Some(pairs) = space(number) else { return };
        let horn = solved(&pairs, Method::Horn);
        for method in [Method::HornHilden, Method::Umeyama, Method::UmeyamaSymmetricScale] {
            let difference = (horn.rotation - solved(&pairs, method).rotation).norm();
            assert!(difference < 1e-8, "B.{number} {method:?}: {difference:e}");
        }
        let umeyama = solved(&pairs, Method::Umeyama);
        let adjusted = kraus::adjust(&pairs).expect("it settles").orientation;
        assert!((adjusted.rotation - umeyama.rotation).norm() < 1e-8, "B.{number}");
        assert_near("scale by iteration", adjusted.scale, umeyama.scale, 1e-10);
        assert_near("RMSE by iteration", adjusted.rmse, umeyama.rmse, 1e-9);
    }
}

#[test]
fn equations_b23_to_b25_and_table_b23_are_reproduced() {
    // The thesis maps (x, y down, elevation) to (northing, easting, height): its rows 1 and 2 are ours 2 and 1, and the
    // sign of its second column is turned.
    let thesis = Matrix3::new(
        0.999_147_844_809_866,
        0.000_806_422_198_252_350,
        -0.041_266_619_622_128_6,
        -0.000_360_186_360_855_989,
        0.999_941_399_656_625,
        0.010_819_774_421_639_4,
        0.041_272_926_690_322_5,
        -0.010_795_690_621_163_4,
        0.999_089_584_86,
    );
    for number in [8, 11] {
        let Some(pairs) = space(number) else { return };
        for method in [Method::Horn, Method::HornHilden, Method::UmeyamaSymmetricScale] {
            let orientation = solved(&pairs, method);
            assert_near("B.25", orientation.scale, 0.032_018_454_468_9, 1e-12);
            assert!((orientation.rotation - thesis).norm() < 1e-6, "B.{number}: {}", orientation.rotation);
            assert_near("total", orientation.rmse, 0.847_475_468_634_218, 1e-8);
            let by_axis = orientation.rmse_by_axis();
            assert_near("easting", by_axis.x, 0.052_817_663_545_080_3, 1e-8);
            assert_near("northing", by_axis.y, 0.051_557_918_739_275_9, 1e-8);
            assert_near("height", by_axis.z, 0.844_255_142_341_283, 1e-8);
        }
    }
}

#[test]
fn in_the_plane_location_is_better_than_the_thesis_says() {
    let Some(pairs) = plane(8) else { return };
    let solution: Solution = solve(&pairs).expect("14 points");
    assert_near("B.8 RMSE", solution.rmse_m, 0.06410, 5e-6);
    assert_near("B.8 scale", solution.scale_m_per_px, 0.031_998_043, 5e-10);
    assert_near("B.8 rotation", solution.rotation_deg, -0.026_154, 5e-7);
    let Some(pairs) = plane(4) else { return };
    assert_near("B.4 RMSE", solve(&pairs).expect("20 points").rmse_m, 0.09006, 5e-6);
}

#[test]
fn heights_apart_are_a_quadratic_surface_away_from_the_survey() {
    for (number, expected, left_out) in [(4, [0.320, 0.299, 0.0325], 0.056), (8, [0.342, 0.181, 0.0164], 0.034)] {
        let (Some(marks), Some(gcps)) = (thesis_candidates(&table(number)), thesis_gcps(&table(number))) else {
            return;
        };
        let planimetry = solve(&plane(number).expect("it was there")).expect("many points");
        let points: Vec<HeightPoint> = marks
            .iter()
            .zip(&gcps)
            .map(|(m, g)| HeightPoint {
                // Where the model was read: at the mark, not at the survey's idea of it.
                position: planimetry.similarity.apply(m.centre),
                surveyed_m: g.height.expect("the table has heights"),
                model_m: m.elevation_m.expect("the table has elevations"),
            })
            .collect();
        let correction = heights::solve(&points).expect("there are heights");
        assert_eq!(correction.chosen, HeightModel::Quadratic);
        for (fit, expected) in correction.fits.iter().zip(expected) {
            let digit = if expected < 0.1 { 5e-5 } else { 5e-4 };
            assert_near(&format!("B.{number} {:?}", fit.model), fit.rms_m, expected, digit);
        }
        let loo = correction.chosen_fit().leave_one_out_rms_m.expect("points can be left out");
        assert_near(&format!("B.{number} leave-one-out"), loo, left_out, 5e-4);
    }
}

#[test]
fn pixels_of_the_tables_are_brought_to_corner_coordinates() {
    let Some(marks) = thesis_candidates(&table(8)) else { return };
    let first = &rows(&table(8)).expect("it was there")[0];
    let (x, y): (f64, f64) = (first["x"].parse().expect("a number"), first["y"].parse().expect("a number"));
    assert_eq!(marks[0].centre, PixelPoint { x: x - 0.5, y: y - 0.5 });
}
