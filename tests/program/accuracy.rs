//! What is said of accuracy holds: the expected-error map over synthetic cases, the statement against figures by hand.

use crate::common::Random;
use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};
use autoref_solve::accuracy::{Basis, CheckError, ErrorModel, StatementOptions, statement};
use autoref_solve::{Pair, Similarity, solve};

const SIZE_PX: (f64, f64) = (8000.0, 6000.0);

#[derive(Clone, Copy, Debug)]
enum Noise {
    Equal,
    /// Each point's own stated σ, the survey's: 1 to 5 times the smallest, and nothing else.
    Stated,
    /// The same, and a common part that nobody states.
    StatedAndCommon,
    /// In the image, as the detector states it for every mark, and a common part on the ground.
    Centres,
}

/// Shares of check positions within the radii of the transform and of a point.
fn coverage(cases: u64, points: usize, noise: Noise, seed: u64) -> (f64, f64) {
    let (mut transform, mut point, mut total) = (0u64, 0u64, 0u64);
    for case in 0..cases {
        let mut random = Random::new(seed.wrapping_mul(1_000_003) + case);
        let angle = random.uniform(-3.1, 3.1);
        let scale = 0.03;
        let truth = Similarity {
            a_re: scale * f64::cos(angle),
            a_im: scale * f64::sin(angle),
            easting_0: 570_000.0,
            northing_0: 7_032_000.0,
            mirrored: Handedness::AsIs,
        };
        let mut precision = 0.0;
        let pairs: Vec<Pair> = (0..points)
            .map(|_| {
                let pixel = PixelPoint { x: random.uniform(0.0, SIZE_PX.0), y: random.uniform(0.0, SIZE_PX.1) };
                let centre_px = match noise {
                    Noise::Centres => 0.2 * 6f64.powf(random.uniform(0.0, 1.0)),
                    _ => 0.0,
                };
                let (survey, common) = match noise {
                    Noise::Equal => (None, 0.02),
                    Noise::Stated => (Some(0.01 * 5f64.powf(random.uniform(0.0, 1.0))), 0.0),
                    Noise::StatedAndCommon => (Some(0.01 * 5f64.powf(random.uniform(0.0, 1.0))), 0.03),
                    Noise::Centres => (None, 0.01),
                };
                let sigma = survey.unwrap_or(0.0).hypot(common);
                precision += 1.0 / (sigma * sigma + (scale * centre_px).powi(2));
                let exact = truth.apply(pixel);
                let map = MapPoint {
                    easting: exact.easting + sigma * random.normal(),
                    northing: exact.northing + sigma * random.normal(),
                };
                let off = [random.normal(), random.normal()].map(|v| centre_px * v);
                Pair {
                    pixel: PixelPoint { x: pixel.x + off[0], y: pixel.y + off[1] },
                    covariance_px2: (centre_px > 0.0).then_some([centre_px * centre_px, 0.0, centre_px * centre_px]),
                    map,
                    survey_sigma_m: survey,
                }
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
fn over_500_cases_95_of_100_places_lie_inside_the_stated_radius() {
    // 500 cases in all: every kind of noise, three to forty points.
    let kinds = [Noise::Equal, Noise::Stated, Noise::StatedAndCommon, Noise::Centres];
    let points = [3, 4, 5, 6, 8, 12, 20, 40];
    let (mut transform, mut point, mut cases) = (0.0, 0.0, 0);
    for (i, noise) in kinds.into_iter().enumerate() {
        for (j, points) in points.into_iter().enumerate() {
            let share = 500 / 32 + u64::from((i * 8 + j) < 500 % 32);
            let (t, p) = coverage(share, points, noise, 7 + (i * 8 + j) as u64);
            (transform, point, cases) = (transform + t * share as f64, point + p * share as f64, cases + share);
        }
    }
    let (transform, point) = (transform / cases as f64, point / cases as f64);
    println!("{cases} cases: transform {transform:.4}, point {point:.4}");
    assert_eq!(cases, 500);
    assert!((0.93..=0.97).contains(&transform) && (0.93..=0.97).contains(&point), "{transform} {point}");
}

#[test]
fn the_radii_are_honest_for_few_points_and_unequal_weights_too() {
    let cases = if crate::common::large() { 40_000 } else { 6000 };
    for noise in [Noise::Equal, Noise::Stated, Noise::StatedAndCommon, Noise::Centres] {
        for points in [3, 4, 5, 6, 12, 40] {
            let (transform, point) = coverage(cases, points, noise, 1);
            println!("{noise:?}, {points} points: transform {transform:.4}, point {point:.4}");
            assert!((0.93..=0.97).contains(&transform) && (0.93..=0.97).contains(&point));
        }
    }
    // Two points have no residuals: honest when all noise is stated.
    let (transform, point) = coverage(cases, 2, Noise::Stated, 1);
    assert!((0.93..=0.97).contains(&transform) && (0.93..=0.97).contains(&point), "{transform} {point}");
}

/// Errors whose figures come out by hand: Σe² = Σn² = 18 cm² over four points, so RMSE_x = RMSE_y = √4.5 cm and
/// RMSE_H1 = 3 cm; Σh² = 40 cm², so RMSE_V1 = √10 cm.
fn worked(rounds: usize, survey: Option<(f64, f64)>, heights: bool) -> Vec<CheckError> {
    let errors = [(0.03, -0.01, 0.04), (-0.02, 0.02, -0.04), (0.01, 0.03, 0.02), (0.02, -0.02, -0.02)];
    (0..rounds * errors.len())
        .map(|i| {
            let (e, n, h) = errors[i % errors.len()];
            CheckError {
                name: format!("C{i}"),
                easting_m: e,
                northing_m: n,
                height_m: heights.then_some(h),
                survey_sigma_m: survey.map(|s| s.0),
                survey_sigma_height_m: survey.map(|s| s.1),
            }
        })
        .collect()
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-12
}

#[test]
fn asprs_statement_without_survey_error_and_with_32_points() {
    let s = statement(&worked(8, None, false), &[], &StatementOptions::default());
    let h = s.figures.horizontal.expect("there are check points");
    assert!(close(h.rmse_e_m, 0.00045f64.sqrt()) && close(h.rmse_n_m, 0.00045f64.sqrt()));
    assert!(close(h.mean_e_m, 0.01) && close(h.mean_n_m, 0.005));
    assert!(close(h.rmse_h1_m, 0.03) && close(h.rmse_h_m, 0.03) && h.rmse_h2_m.is_none());
    assert_eq!((h.check_points, s.figures.basis), (32, Basis::Tested));
    assert_eq!(
        s.sentences,
        [
            "This data set was tested to meet ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2 (2023) \
          for a 3 (cm) RMSE_H Horizontal Positional Accuracy Class. The tested horizontal positional accuracy was found to \
          be RMSE_H = 3.0 (cm)."
        ]
    );
    let said = s.reservations.join("\n");
    assert!(said.contains("survey's own error is not stated") && said.contains("exceeds a quarter"), "{said}");
    assert!(!said.contains("the standard asks for 30"), "{said}");
}

#[test]
fn asprs_statement_with_survey_error_and_32_points() {
    // σ = 2 cm in each coordinate: RMSE_H2 = √8 cm, RMSE_H = √(9 + 8) = √17 cm = 4.1 cm. σ_h = 3 cm: RMSE_V = √19 cm.
    let s = statement(&worked(8, Some((0.02, 0.03)), true), &[], &StatementOptions::default());
    let h = s.figures.horizontal.expect("there are check points");
    assert!(close(h.rmse_h2_m.expect("stated"), 0.0008f64.sqrt()) && close(h.rmse_h_m, 0.0017f64.sqrt()));
    let v = s.figures.vertical.expect("there are heights");
    assert!(close(v.rmse_v1_m, 0.001f64.sqrt()) && close(v.rmse_v_m, 0.0019f64.sqrt()) && close(v.mean_m, 0.0));
    // √(17 + 19) = 6 cm.
    assert!(close(s.figures.rmse_3d_m.expect("both"), 0.06));
    assert!(s.sentences[0].contains("for a 5 (cm) RMSE_H") && s.sentences[0].ends_with("RMSE_H = 4.1 (cm)."));
    assert!(s.sentences[1].contains("for a 5 (cm) RMSE_V") && s.sentences[1].ends_with("RMSE_V = 4.4 (cm)."));
    // Half the class is 2.5 cm, the survey 2.8.
    assert!(s.reservations.iter().any(|r| r.contains("not twice as accurate")), "{:?}", s.reservations);
}

#[test]
fn asprs_statement_with_12_points_makes_the_reservation_that_is_demanded() {
    for survey in [None, Some((0.02, 0.03))] {
        let options = StatementOptions { class_h_m: Some(0.05), nssda: true, ..StatementOptions::default() };
        let s = statement(&worked(3, survey, false), &[], &options);
        let h = s.figures.horizontal.expect("there are check points");
        assert!(close(h.rmse_h_m, if survey.is_some() { 0.0017f64.sqrt() } else { 0.03 }));
        assert_eq!(s.figures.basis, Basis::TestedReduced);
        let value = if survey.is_some() { "4.1" } else { "3.0" };
        assert_eq!(
            s.sentences[0],
            format!(
                "This data set was tested as required by ASPRS Positional Accuracy Standards for Digital Geospatial Data, \
                 Edition 2 (2023). Although the Standards call for a minimum of thirty (30) checkpoints, this test was \
                 performed using ONLY 12 checkpoints. This data set was produced to meet a 5 (cm) RMSE_H Horizontal \
                 Positional Accuracy Class. The tested horizontal positional accuracy was found to be RMSE_H = {value} \
                 (cm) using the reduced number of checkpoints."
            )
        );
        assert!(s.reservations.iter().any(|r| r.contains("the standard asks for 30")));
        // 1.7308 · 3 cm, without the survey's error; 12 are too few here too.
        let nssda = s.figures.nssda.expect("asked for");
        assert!((nssda.horizontal_95_m - 1.7308 * 0.03).abs() < 1e-6);
        assert_eq!(s.sentences[1], "NSSDA: Tested 0.052 meters horizontal accuracy at 95% confidence level.");
        assert!(s.reservations.iter().any(|r| r.starts_with("NSSDA: asks for at least 20")));
    }
}

#[test]
fn what_is_not_met_or_not_tested_is_not_claimed() {
    let options = StatementOptions { class_h_m: Some(0.02), ..StatementOptions::default() };
    for rounds in [3, 8] {
        let s = statement(&worked(rounds, None, false), &[], &options);
        assert!(s.sentences[0].contains("does NOT meet the 2 (cm) RMSE_H"), "{}", s.sentences[0]);
        assert!(!s.sentences[0].contains("to meet ASPRS") && !s.sentences[0].contains("produced to meet"));
    }
    let s = statement(&[], &[(0.03, 0.0), (0.0, 0.03)], &StatementOptions::default());
    assert_eq!(s.figures.basis, Basis::Produced);
    assert!(s.sentences[0].starts_with("This data set was produced to meet ASPRS"), "{:?}", s.sentences);
    assert!(s.sentences[0].contains("for a 3 (cm) RMSE_H") && !s.sentences[0].contains("tested"));
    assert!(s.reservations[0].contains("nothing was tested") && s.figures.horizontal.is_none());
    // Nothing known at all: nothing said.
    let s = statement(&[], &[], &StatementOptions { nssda: true, ..StatementOptions::default() });
    assert!(s.sentences.is_empty() && s.figures.nssda.is_none() && !s.reservations.is_empty());
    // One point far off is named.
    let mut checks = worked(8, Some((0.005, 0.005)), false);
    checks[5].easting_m = 0.5;
    let s = statement(&checks, &[], &StatementOptions { class_h_m: Some(0.1), ..StatementOptions::default() });
    assert!(s.reservations.iter().any(|r| r.contains("blunders: C5")), "{:?}", s.reservations);
}

/// A list, its candidates and survey errors in a folder, and `solve` run over them.
fn solved(check_shift_m: f64, crs: &str, extra: &[&str]) -> (serde_json::Value, String) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    let mut random = Random::new(77);
    let truth = Similarity {
        a_re: 0.03,
        a_im: 0.001,
        easting_0: 570_000.0,
        northing_0: 7_032_000.0,
        mirrored: Handedness::AsIs,
    };
    let (mut list, mut candidates, mut errors) =
        ("name,easting,northing\n".to_string(), "x,y\n".to_string(), "name,sigma_e,sigma_n,sigma_h\n".to_string());
    for i in 0..14 {
        let p = PixelPoint { x: random.uniform(100.0, 7900.0), y: random.uniform(100.0, 5900.0) };
        let m = truth.apply(p);
        let (shift, sigma) = if i < 4 { (check_shift_m, 0.01) } else { (0.0, if i == 5 { 0.5 } else { 0.005 }) };
        let noise = [random.normal(), random.normal()].map(|v| 0.01 * v);
        list += &format!("P{i},{:.4},{:.4}\n", m.easting + noise[0] + shift, m.northing + noise[1]);
        candidates += &format!("{:.3},{:.3}\n", p.x, p.y);
        errors += &format!("P{i},{sigma},{sigma},0.02\n");
    }
    for (name, text) in [("list.csv", list), ("marks.csv", candidates), ("errors.csv", errors)] {
        std::fs::write(path(name), text).expect("writable");
    }
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
    command.args(["solve"]).arg(path("marks.csv")).arg("--gcps").arg(path("list.csv"));
    command.arg("--accuracy").arg(path("errors.csv"));
    let output = command
        .args(["--check", "P0,P1,P2,P3", "--size", "8000,6000", "--json", "--verbose", "--crs", crs])
        .args(extra)
        .output()
        .expect("the program starts");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    (serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {text}")), text)
}

#[test]
fn the_run_states_it_and_check_points_never_touch_the_fit() {
    let (result, text) = solved(0.0, "EPSG:25832", &["--nssda", "--accuracy-class", "0.05"]);
    assert_eq!(result["status"], "solved");
    let h = &result["accuracy"]["figures"]["horizontal"];
    assert_eq!(h["check_points"], 4);
    let number = |v: &serde_json::Value| v.as_f64().expect("a number");
    // The figures follow from the rows.
    let rows = result["check_points"].as_array().expect("rows");
    let squares: f64 =
        rows.iter().map(|r| number(&r["residual_e_m"]).powi(2) + number(&r["residual_n_m"]).powi(2)).sum();
    assert!(close(number(&h["rmse_h1_m"]), (squares / 4.0).sqrt()));
    assert!((number(&h["rmse_h2_m"]) - 0.01 * 2f64.sqrt()).abs() < 1e-12);
    assert!(close(number(&h["rmse_h_m"]), number(&h["rmse_h1_m"]).hypot(number(&h["rmse_h2_m"]))));
    assert!(text.contains("ONLY 4 checkpoints") && text.contains("NSSDA: Tested"), "{text}");
    assert!(text.contains("Expected error") && text.contains("produced to meet a 5 (cm)"), "{text}");
    assert_eq!(result["expected_errors"].as_array().expect("corners").len(), 4);
    // The survey's errors are weights: a coarse point counts for next to nothing.
    let matches = result["matches"].as_array().expect("rows");
    let coarse = matches.iter().position(|m| m["gcp"] == "P5").expect("a control point");
    let pairs = result["solution"]["pairs"].as_array().expect("pairs");
    let heaviest = pairs.iter().map(|p| number(&p["weight"])).fold(0.0, f64::max);
    assert!(number(&pairs[coarse]["weight"]) < 0.01 * heaviest);
    // Check points that are off by 4 cm change the statement, and not one bit of the fit.
    let (shifted, text) = solved(0.04, "EPSG:25832", &["--nssda", "--accuracy-class", "0.05"]);
    assert_eq!(shifted["geotransform"], result["geotransform"]);
    assert_eq!(shifted["solution"], result["solution"]);
    assert!(number(&shifted["accuracy"]["figures"]["horizontal"]["mean_e_m"]) < -0.02);
    assert!(text.contains("mean error"), "{text}");
    // The same list counted in US survey feet: the statement is in metres all the same.
    // Far from New York, which is forced.
    let (feet, _) = solved(0.0, "EPSG:2263", &["--force", "outside-area"]);
    let in_feet = number(&feet["accuracy"]["figures"]["horizontal"]["rmse_h1_m"]);
    let ratio = in_feet / number(&h["rmse_h1_m"]);
    // Nearly: what is stated of the survey is metres in both, and weighs more against smaller residuals.
    assert!((ratio - 1200.0 / 3937.0).abs() < 1e-3, "{ratio}");
}

/// A test that leaves out what fits badly tests nothing: marks beside their check points count, however far.
/// An affine transform counts a coarse point for next to nothing, as the similarity does, and states errors of its own.
#[test]
fn an_affine_transform_weighs_points_and_states_its_own_errors() {
    let corners = |result: &serde_json::Value| -> Vec<f64> {
        let corners = result["expected_errors"].as_array().expect("corners").iter();
        corners.map(|corner| corner["transform_95_m"].as_f64().expect("a number")).collect()
    };
    let (similarity, _) = solved(0.0, "EPSG:25832", &[]);
    let (affine, text) = solved(0.0, "EPSG:25832", &["--model", "affine"]);
    assert_eq!(affine["chosen_model"]["model"], "affine", "{text}");
    let (plain, own) = (corners(&similarity), corners(&affine));
    assert_eq!((plain.len(), own.len()), (4, 4));
    let times: Vec<f64> = own.iter().zip(&plain).map(|(own, plain)| own / plain).collect();
    assert!(
        times.iter().all(|times| (0.7..3.0).contains(times)) && times.iter().any(|times| *times > 1.1),
        "{times:?}"
    );
    // Nine points of ten, without the coarse one, have nearly the same transform.
    let of = |result: &serde_json::Value| -> Vec<f64> {
        let numbers = result["geotransform"].as_array().expect("six numbers").iter();
        numbers.map(|number| number.as_f64().expect("a number")).collect()
    };
    let (without, _) = solved(0.0, "EPSG:25832", &["--model", "affine", "--check", "P5"]);
    let corner = |t: &[f64]| [t[0] + 8000.0 * t[1] + 6000.0 * t[2], t[3] + 8000.0 * t[4] + 6000.0 * t[5]];
    let (with, without) = (corner(&of(&affine)), corner(&of(&without)));
    let apart_m = (with[0] - without[0]).hypot(with[1] - without[1]);
    assert!(apart_m < 0.002, "{apart_m} m");
}

#[test]
fn check_points_that_fit_badly_are_in_the_figures() {
    let number = |v: &serde_json::Value| v.as_f64().expect("a number");
    let (clean, _) = solved(0.0, "EPSG:25832", &["--accuracy-class", "0.05"]);
    // 3, 10 and 30 px beside the noise of 0.3 px.
    for shift_m in [0.1, 0.3, 0.9] {
        let (result, text) = solved(shift_m, "EPSG:25832", &["--accuracy-class", "0.05"]);
        let h = &result["accuracy"]["figures"]["horizontal"];
        assert_eq!(h["check_points"], 4, "{shift_m}: {text}");
        assert!((number(&h["mean_e_m"]).abs() - shift_m).abs() < 0.03, "{shift_m}: {h}");
        assert!(text.contains("does NOT meet"), "{shift_m}: {text}");
        assert_eq!(result["solution"], clean["solution"], "{shift_m}");
    }
    // Too far for any mark to be theirs: the statement says what it leaves out.
    let (result, _) = solved(30.0, "EPSG:25832", &["--accuracy-class", "0.05"]);
    let reservations = result["accuracy"]["reservations"].to_string();
    assert!(
        reservations.contains("check points in the image are not in the figures") && reservations.contains("P0"),
        "{reservations}"
    );
}
