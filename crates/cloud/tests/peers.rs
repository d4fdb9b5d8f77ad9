//! Against what PDAL, SciPy and Pingel's program say of the same files.

mod common;

use autoref_cloud::clean::Step;
use autoref_cloud::isolated;
use autoref_cloud::smrf::Options;
use common::{plan, read, run, shared};

fn noise(file: &str, step: Step) -> Option<u64> {
    let (report, _, classes) = run(&shared(file)?, &plan(vec![step]), "laz");
    let flagged = classes.iter().filter(|&&class| class == 7).count() as u64;
    println!("{file} {:?}", report.steps);
    assert_eq!(report.steps[0].classified, flagged, "{file}");
    Some(flagged)
}

#[test]
fn outliers_of_pdal_and_scipy() {
    let statistical = |neighbours, multiplier| Step::Outliers { neighbours, multiplier };
    let radius = |radius_m, least| Step::Radius { radius_m, least };
    let low = || Step::Low { cell_m: 10.0, gap_m: 1.0 };
    for (file, step, expected) in [
        ("pdal/autzen-point-format-3.las", statistical(2, 1.5), 106 - 96),
        ("pdal/autzen-point-format-3.las", statistical(5, 0.0), 106 - 63),
        ("pdal/autzen-point-format-3.las", radius(200.0, 1), 106 - 60),
        ("pdal/autzen-point-format-3.las", radius(100.0, 2), 106 - 3),
        ("pdal/autzen_trim.laz", statistical(8, 2.0), 4133),
        ("pdal/warsaw_small.las", statistical(8, 2.0), 137),
        ("coromandel/points_test.laz", statistical(8, 2.0), 382),
        ("pdal/elm1.txt", low(), 2),
        ("pdal/elm2.txt", low(), 7),
    ] {
        if let Some(found) = noise(file, step.clone()) {
            assert_eq!(found, expected, "{file} {step:?}");
        }
    }
}

#[test]
fn labelled_noise_is_found_with_fewer_flags_than_outliers_take() {
    let Some(path) = shared("coromandel/points_test.laz") else { return };
    let (_, labels) = read(&path);
    let (_, _, classes) = run(&path, &plan(vec![Step::Isolated(isolated::Options::default())]), "laz");
    let found = labels.iter().zip(&classes).filter(|&(&label, &class)| label == 7 && class == 7).count();
    let flagged = classes.iter().filter(|&&class| class == 7).count();
    assert!(found >= 11 && flagged < 382, "{found} of 12, {flagged} flagged");
}

#[test]
fn ground_of_pdal_without_return_numbers() {
    let Some(path) = shared("pdal/utm17_1.txt") else { return };
    let (report, _, classes) = run(&path, &plan(vec![Step::Ground(Options::default())]), "las");
    assert_eq!(report.steps[0].ground, Some(10));
    assert!(classes.iter().all(|&class| class == 2));
}

/// Total error and Cohen's kappa of classes against the labels in the file's fourth column, and the ground found.
fn agreement(name: &str, options: Options) -> Option<(f64, f64, u64)> {
    let path = shared(&format!("isprs/{name}.txt"))?;
    let labels: Vec<bool> = std::fs::read_to_string(&path)
        .expect("text")
        .lines()
        .filter(|line| !line.trim().is_empty())
        .map(|line| line.split_whitespace().nth(3) == Some("0"))
        .collect();
    let (report, _, classes) = run(&path, &plan(vec![Step::Ground(options)]), "las");
    let n = labels.len() as f64;
    let count =
        |a: bool, b: bool| labels.iter().zip(&classes).filter(|(l, c)| **l == a && (**c == 2) == b).count() as f64;
    let (gg, go, og, oo) = (count(true, true), count(true, false), count(false, true), count(false, false));
    let agree = (gg + oo) / n;
    let chance = ((gg + go) * (gg + og) + (og + oo) * (go + oo)) / (n * n);
    Some((1.0 - agree, (agree - chance) / (1.0 - chance), report.steps[0].ground.expect("a ground step")))
}

#[test]
fn ground_of_the_isprs_samples() {
    // Slope, window, threshold, scaling; total error and kappa of the author's program, optimised and with one set for
    // all.
    let samples = [
        ("samp11", [0.2, 16.0, 0.45, 1.2], (0.091897, 0.8123), (0.094949, 0.8065)),
        ("samp12", [0.18, 12.0, 0.30, 0.95], (0.030296, 0.9394), (0.031984, 0.9360)),
        ("samp22", [0.16, 18.0, 0.35, 1.3], (0.034856, 0.9189), (0.035253, 0.9178)),
        ("samp31", [0.08, 15.0, 0.25, 1.5], (0.011780, 0.9763), (0.026124, 0.9472)),
        ("samp42", [0.06, 49.0, 1.05, 0.0], (0.020438, 0.9516), (0.028420, 0.9330)),
        ("samp53", [0.45, 3.0, 0.1, 3.8], (0.024056, 0.6822), (0.072285, 0.4792)),
        ("samp54", [0.05, 11.0, 0.15, 2.3], (0.023931, 0.9519), (0.040428, 0.9191)),
        ("samp61", [0.28, 5.0, 0.5, 1.45], (0.008813, 0.8697), (0.016999, 0.7840)),
    ];
    let mut kappas = [0.0, 0.0];
    for (name, [slope, window_m, threshold_m, scaling], optimised, single) in samples {
        let base = Options { cell_m: 1.0, low_slope: 500.0, net_m: 0.0, slope, window_m, threshold_m, scaling };
        let one = Options { slope: 0.15, window_m: 18.0, threshold_m: 0.5, scaling: 1.25, ..base };
        for (index, (options, expected)) in [(base, optimised), (one, single)].into_iter().enumerate() {
            let Some((te, kappa, ground)) = agreement(name, options) else { return };
            println!(
                "{name} {index}: te {te:.6} (author {:.6}), kappa {kappa:.4} ({:.4}), ground {ground}",
                expected.0, expected.1
            );
            assert!((te - expected.0).abs() < 1.5e-3 && (kappa - expected.1).abs() < 4e-3, "{name} {index}");
            kappas[index] += kappa / samples.len() as f64;
        }
    }
    println!("mean kappa {:.5} optimised, {:.5} single", kappas[0], kappas[1]);
    assert!(kappas[0] >= 0.887 && kappas[1] >= 0.840, "{kappas:?}");
    let (te, _, ground) =
        agreement("samp53", Options { low_slope: 500.0, ..Options::default() }).expect("it was there");
    println!("samp53, thesis: te {te:.6}, ground {ground}");
    let (te, _, ground) = agreement("samp11", Options::default()).expect("it was there");
    println!("samp11, thesis: te {te:.6}, ground {ground}");
}

/// Points of a file, or why it is refused.
fn points_of(path: &std::path::Path) -> Result<u64, String> {
    let (_, mut reader) = autoref_cloud::io::open(path).map_err(|e| e.to_string())?;
    let mut batch = autoref_cloud::schema::Batch::default();
    let mut points = 0;
    loop {
        reader.read(&mut batch, 1000).map_err(|e| e.to_string())?;
        if batch.is_empty() {
            return Ok(points);
        }
        points += batch.len() as u64;
    }
}

#[test]
fn odd_files_are_read_or_refused_in_one_line() {
    let refused = [
        ("1.2-no-points.las", "truncated"),
        ("badheader.txt", "no column `Z`"),
        ("garbage_nVariableLength.las", "truncated"),
        ("no_vertex.ply", "no element `vertex`"),
        ("simple-laszip-compressor-version-1.2r0.laz", "before 2011"),
        ("sized_dims.ply", "no property `z`"),
        ("unsized_dims.ply", "no property `z`"),
        ("utm17_space.pcd", "pcl_pcd2ply"),
    ];
    let counted = [
        ("1.2-empty-geotiff-vlrs.las", 43),
        ("1.2-with-color.copc.laz", 1065),
        ("bad-geotiff-keys.las", 10),
        ("bad_vlr_count.las", 10),
        ("extrabytes.las", 1065),
        ("gps-time-nan.las", 1),
        ("laszip-generated.laz", 1065),
        ("laszip-generated_with2bytespadding.laz", 1065),
        ("liblas-generated.laz", 1065),
        ("lots_of_vlr.las", 1),
        ("no-points.las", 0),
        ("wontcompress3.las", 1000),
    ];
    let Some(folder) = shared("pdal_odd") else { return };
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        let found = points_of(&path);
        if let Some((_, word)) = refused.iter().find(|(file, _)| *file == name) {
            let message = found.expect_err(&name);
            assert!(message.contains(word) && !message.contains('\n'), "{name}: {message}");
        } else {
            let points = found.unwrap_or_else(|message| panic!("{name}: {message}"));
            let expected = counted.iter().find(|(file, _)| *file == name).map_or(points, |(_, expected)| *expected);
            assert_eq!(points, expected, "{name}");
        }
    }
}
