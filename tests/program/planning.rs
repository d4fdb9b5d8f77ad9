//! Planting ambiguities and finding them; real lists; the command's exit codes.

use std::process::Command;

use crate::common::Random;
use autoref_raster::coords::MapPoint;
use autoref_stream::planning::{Plan, PlanRequest, plan};

type Points = Vec<(String, MapPoint)>;

fn points(places: impl IntoIterator<Item = (f64, f64)>) -> Points {
    places
        .into_iter()
        .enumerate()
        .map(|(i, (e, n))| (format!("P{}", i + 1), MapPoint { easting: 570_000.0 + e, northing: 7_032_000.0 + n }))
        .collect()
}

fn grid() -> Points {
    points((0..16).map(|i| (f64::from(i % 4) * 40.0, f64::from(i / 4) * 40.0)))
}

fn cross() -> Points {
    let arms = [20.0, 40.0, 60.0];
    points(std::iter::once((0.0, 0.0)).chain(arms.into_iter().flat_map(|r| [(r, 0.0), (-r, 0.0), (0.0, r), (0.0, -r)])))
}

/// Half of a random pattern and its mirror image.
fn mirrored() -> Points {
    let mut random = Random::new(3);
    points((0..5).flat_map(|_| {
        let (e, n) = (random.uniform(10.0, 100.0), random.uniform(0.0, 150.0));
        [(e, n), (-e, n)]
    }))
}

fn random_list(seed: u64, n: usize) -> Points {
    let mut random = Random::new(seed);
    points((0..n).map(|_| (random.uniform(0.0, 400.0), random.uniform(0.0, 300.0))).collect::<Vec<_>>())
}

fn request() -> PlanRequest {
    PlanRequest { gsd_m: Some((0.027, 0.033)), ..PlanRequest::default() }
}

/// Makes the moves that were advised and looks again.
fn follow(points: &Points, plan: &Plan) -> Points {
    let mut changed = points.clone();
    for step in &plan.moves {
        let point = changed.iter_mut().find(|p| p.0 == step.name).expect("a point of the list");
        let (de, dn) = (step.easting - point.1.easting, step.northing - point.1.northing);
        assert!((de.hypot(dn) - step.distance_m).abs() < 1e-6);
        point.1 = MapPoint { easting: step.easting, northing: step.northing };
    }
    changed
}

#[test]
fn planted_ambiguities_are_found_and_the_moves_cure_them() {
    for (name, points, turned, mirror) in
        [("grid", grid(), true, true), ("cross", cross(), true, true), ("mirrored", mirrored(), false, true)]
    {
        let found = plan(&points, &request());
        assert!(!found.unique && found.enough_points, "{name}");
        assert_eq!(found.ambiguities.iter().any(|a| a.mirrored.is_mirrored()), mirror, "{name}");
        assert_eq!(
            found.ambiguities.iter().any(|a| !a.mirrored.is_mirrored()),
            turned,
            "{name}: {:?}",
            found.ambiguities
        );
        assert!(found.ambiguities[0].unmatched.is_empty(), "{name}");
        println!("{name}: {:?}", found.moves.iter().map(|m| m.words()).collect::<Vec<_>>());
        assert!(found.moves_suffice && !found.moves.is_empty() && found.moves.len() <= 4, "{name}: {:?}", found.moves);
        assert!(plan(&follow(&points, &found), &request()).unique, "{name} after the moves");
    }
}

#[test]
fn a_shift_by_one_place_is_found_where_it_matters() {
    // Twelve points on a line, evenly: one place on, only one end is missed.
    let line = points((0..12).map(|i| (f64::from(i) * 30.0, 0.0)));
    let found = plan(&line, &request());
    assert!(
        found
            .ambiguities
            .iter()
            .any(|a| !a.mirrored.is_mirrored() && a.unmatched.len() == 1 && (a.shift_m - 30.0).abs() < 0.01)
    );
    assert!(found.strength.expect("twelve points").advice.iter().any(|a| a.contains("one line")));
}

#[test]
fn many_points_are_answered_in_time() {
    let started = std::time::Instant::now();
    let found = plan(&points((0..300).map(|i| (f64::from(i % 20) * 40.0, f64::from(i / 20) * 40.0))), &request());
    assert!(!found.unique && found.advice.len() >= 2);
    assert!(plan(&random_list(7, 400), &request()).unique);
    println!("{:.1} s", started.elapsed().as_secs_f64());
}

#[test]
fn random_lists_are_unique() {
    for seed in 0..20 {
        let n = 8 + seed as usize % 10;
        let found = plan(&random_list(seed, n), &request());
        assert!(found.unique && found.moves.is_empty(), "seed {seed}: {:?}", found.ambiguities);
    }
    // Spoiled on purpose: a random list with a turned copy of all but two of its points.
    let mut spoiled = random_list(99, 6);
    let copies: Vec<(f64, f64)> =
        spoiled.iter().map(|(_, p)| (p.northing - 7_032_000.0 + 600.0, -(p.easting - 570_000.0))).collect();
    spoiled.extend(points(copies).into_iter().map(|(name, p)| (format!("Q{name}"), p)));
    // Half of twelve points fall on the other half: losing six makes it ambiguous, losing two does not.
    assert!(plan(&spoiled, &request()).unique);
    let half = plan(&spoiled, &PlanRequest { lose: 6, ..request() });
    assert!(!half.unique && half.ambiguities.iter().any(|a| (a.turn_deg.abs() - 90.0).abs() < 0.1));
}

#[test]
fn the_theses_lists() {
    for (table, gsd) in [("thesis/b1_lerkendal_gcps.csv", 0.032), ("thesis/b2_e6_gcps.csv", 0.03)] {
        let Some(gcps) = crate::common::thesis_gcps(table) else { return };
        let points: Points = gcps.iter().map(|g| (g.name.clone(), g.position())).collect();
        let found = plan(&points, &PlanRequest { gsd_m: Some((gsd * 0.9, gsd * 1.1)), ..PlanRequest::default() });
        println!("{table}: {} points, unique {}, {:?}", found.points, found.unique, found.advice);
        assert!(found.unique, "{table}: {:?}", found.ambiguities);
        let mark = found.mark.expect("the pixel size was given");
        assert!((mark.smallest_m - 6.0 * gsd).abs() < 0.01);
        // The closed form equals the solver's own covariance.
        let strength = found.strength.expect("many points");
        let pairs: Vec<_> = gcps
            .iter()
            .map(|g| autoref_solve::Pair {
                pixel: autoref_raster::coords::PixelPoint { x: g.easting - 560_000.0, y: 7_040_000.0 - g.northing },
                covariance_px2: None,
                map: g.position(),
                survey_sigma_m: None,
            })
            .collect();
        let solution = autoref_solve::solve(&pairs).expect("many points");
        let (name, redundancy, _) = strength.weakest;
        let i = gcps.iter().position(|g| g.name == name).expect("a point of the list");
        assert!((solution.pairs[i].redundancy - redundancy).abs() < 1e-9);
        assert!(solution.pairs.iter().all(|p| p.redundancy >= redundancy - 1e-9));
    }
}

#[test]
fn the_command_says_it_in_words_json_and_exit_codes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, points: &Points| {
        let rows: String = points.iter().map(|(n, p)| format!("{n},{},{}\n", p.easting, p.northing)).collect();
        let path = folder.path().join(name);
        std::fs::write(&path, format!("name,easting,northing\n{rows}")).expect("writable");
        path
    };
    let run = |path: &std::path::Path, extra: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
        command.arg("plan").arg(path).args(extra).output().expect("the program starts")
    };
    let good = write("good.csv", &random_list(4, 9));
    let output = run(&good, &["--gsd", "0.03", "--mark-size", "0.3m"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("unique under rotation, scale and mirroring") && text.contains("0.18 m (6 px)"), "{text}");
    let bad = write("grid.csv", &grid());
    let output = run(&bad, &["--gsd", "0.03"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("ambiguous") && text.contains("move P"), "{text}");
    let output = run(&bad, &["--json", "--quiet"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one document");
    assert_eq!((json["plan"]["unique"].as_bool(), output.status.code()), (Some(false), Some(1)));
    // Marks that are too small are advice too; what cannot be read is an error.
    assert_eq!(run(&good, &["--gsd", "0.1", "--mark-size", "0.3m"]).status.code(), Some(1));
    for (path, extra) in [
        (folder.path().join("none.csv"), &[][..]),
        (good.clone(), &["--tolerance", "0"]),
        (good.clone(), &["--mark-size", "0.3m"]),
    ] {
        let output = run(&path, extra);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert_eq!(message.trim().lines().count(), 1, "{message}");
    }
}
