//! The self-test says of an image what the detection benchmark says of it, and leaves the file alone.

use std::process::Command;
use std::sync::Arc;

use autoref_raster::memory::MemorySource;
use autoref_raster::memory_plan::PlanOptions;
use autoref_raster::memory_plan::plan;
use autoref_raster::window::Window;
use autoref_raster::{RasterInfo, RasterSource, ReaderChoice, open};
use autoref_stream::detector::Detector as _;
use autoref_stream::pipeline::{NoProgress, PaintDetector};
use autoref_stream::profile::Profile;
use autoref_stream::selftest::{Selftest, SelftestOptions, Tally, selftest};
use autoref_synth::plant::{Cell, Picture, Random, plant};

fn run(source: &Arc<dyn RasterSource>, sizes_px: &[f64], marks: usize, tile_px: u64, threads: usize) -> Selftest {
    let detector =
        PaintDetector::new(Profile::builtin("orange").expect("shipped"), source.info(), None).expect("sizes in pixels");
    let planner = |info: &RasterInfo| {
        let options = PlanOptions {
            tile_px: Some(tile_px),
            threads,
            memory_budget_bytes: 512 << 20,
            baseline_bytes: 64 << 20,
            cache_bytes: 32 << 20,
        };
        plan(info, detector.halo_px(), &options)
    };
    let options = SelftestOptions {
        sizes_px: sizes_px.to_vec(),
        marks_per_size: marks,
        conditions: Cell::base(),
        seed: 5,
        chip_budget_bytes: 64 << 20,
    };
    selftest(source, &detector, &planner, &options, &NoProgress).expect("a readable image")
}

/// The whole image as the benchmark takes it.
fn picture(source: &dyn RasterSource) -> Picture {
    let info = source.info();
    let patch = source.read(Window::whole(info.width, info.height)).expect("a readable image").to_patch(info);
    let rgb = patch.rgb.iter().map(|c| c.map(|v| v as u8)).collect();
    Picture { width: info.width as usize, height: info.height as usize, rgb }
}

/// The benchmark's way on pieces of the same photograph.
fn benchmark(full: &Picture, side_px: f64, marks: usize) -> Tally {
    let detector = crate::scan::Detector::new(Profile::builtin("orange").expect("shipped"));
    let cell = Cell { side_px, ..Cell::base() };
    let (mut tally, mut random) = (Tally::default(), Random(1 + side_px as u64 * 7919));
    for _ in 0..40 {
        if tally.marks >= marks {
            break;
        }
        let place = |length: usize, unit: f64| (unit * length.saturating_sub(500) as f64) as usize;
        let (x, y) = (place(full.width, random.unit()), place(full.height, random.unit()));
        let (planted, truth) = plant(&full.crop(x, y, 500, 500), &cell, &mut random);
        tally.add((x as f64, y as f64), &truth, &detector.list(&planted), side_px);
    }
    tally
}

#[test]
fn it_agrees_with_the_detection_benchmark_within_the_error_bars() {
    let (photos, marks): (&[&str], usize) = if crate::common::large() {
        (&["city_ochota_3013.jpg", "construction_caliterra.jpg", "savanna_oam.tif", "river_town_oam.tif"], 2000)
    } else {
        (&["savanna_oam.tif", "forest_agung.jpg"], 150)
    };
    let sizes = if crate::common::large() { &[5.0, 6.0, 10.0, 20.0][..] } else { &[5.0, 10.0][..] };
    // One tally for each photograph.
    let mut ours: Vec<Vec<Tally>> = vec![Vec::new(); sizes.len()];
    let mut theirs = ours.clone();
    for name in photos {
        let Some(path) = crate::common::data(&format!("photos/{name}")) else { return };
        let source = open(&path, ReaderChoice::Auto, 0, 64 << 20).expect("a photograph");
        let result = run(&source, sizes, marks, 512, 2);
        let full = picture(source.as_ref());
        for (i, row) in result.rows.iter().enumerate() {
            ours[i].push(row.tally.clone());
            theirs[i].push(benchmark(&full, row.side_px, marks));
        }
        // The photographs hold no marks: what is found there beside ours is what the benchmark's detector finds too.
        let bare = crate::scan::Detector::new(Profile::builtin("orange").expect("shipped")).list(&full).len();
        let expected = bare as f64 * result.clear_megapixels / result.megapixels;
        let bar = 1.0 + 3.0 * expected.sqrt();
        let off = result.false_finds as f64 - expected;
        assert!(off.abs() <= bar && result.false_finds <= bare + 1, "{name}: {} against {bare}", result.false_finds);
    }
    for ((side, a), b) in sizes.iter().zip(&ours).zip(&theirs) {
        let design = design_effect(a, b);
        let (a, b) = (pooled(a), pooled(b));
        let (n, m) = (a.marks as f64, b.marks as f64);
        let p = (a.found() + b.found()) as f64 / (n + m);
        // Three standard deviations of the difference of two shares; the share of one mark more keeps it from vanishing
        // at 100 %.
        let bar = 3.0 * (design * (p * (1.0 - p) + 1.0 / (n + m)) * (1.0 / n + 1.0 / m)).sqrt();
        println!(
            "{side} px: recall {:.4} of {} against {:.4} of {} (±{bar:.4}, design effect {design:.2}); RMSE {:.3} against {:.3} px",
            a.recall(),
            a.marks,
            b.recall(),
            b.marks,
            a.rmse_px(),
            b.rmse_px()
        );
        assert!(a.marks >= marks / 2 && b.marks >= marks, "{side} px: {} and {} marks", a.marks, b.marks);
        assert!((a.recall() - b.recall()).abs() <= bar, "{side} px: {} and {}", a.recall(), b.recall());
        // An RMSE of n values is known to 1/√(2n) if they are normal; these have heavy tails.
        let ratio = a.rmse_px() / b.rmse_px();
        let bar = 6.0 / (4.0 * marks as f64).sqrt();
        assert!((ratio.ln()).abs() <= bar.max(0.1), "{side} px: RMSE {} and {}", a.rmse_px(), b.rmse_px());
    }
}

/// How much less these marks tell than independent ones: from how recall differs over the squares of each photograph,
/// both ways of planting together.
fn design_effect(ours: &[Tally], theirs: &[Tally]) -> f64 {
    let (mut clustered, mut independent) = (0.0, 0.0);
    for (a, b) in ours.iter().zip(theirs) {
        let mut both = pooled(&[a.clone(), b.clone()]);
        for (square, [marks, found]) in a.squares.iter().chain(&b.squares) {
            let sum = both.squares.entry(*square).or_default();
            *sum = [sum[0] + marks, sum[1] + found];
        }
        clustered += both.clustered_variance();
        independent += both.marks as f64 * both.recall() * (1.0 - both.recall());
    }
    if independent > 0.0 { (clustered / independent).max(1.0) } else { 1.0 }
}

/// Several tallies as one, without their squares.
fn pooled(tallies: &[Tally]) -> Tally {
    let marks = tallies.iter().map(|t| t.marks).sum();
    Tally { marks, errors: tallies.iter().flat_map(|t| t.errors.clone()).collect(), ..Tally::default() }
}

/// Ground of many colours, none of them paint.
fn ground(width: u64, height: u64) -> Arc<dyn RasterSource> {
    let rgb = (0..width * height)
        .flat_map(|i| {
            let noise = (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 59) as u8;
            [90 + noise, 100 + noise, 80 + noise]
        })
        .collect();
    Arc::new(MemorySource::rgb8(width, height, rgb))
}

#[test]
fn the_tiling_and_the_threads_change_nothing() {
    let source = ground(1500, 1100);
    let one = run(&source, &[6.0, 12.0], 60, 4000, 1);
    let other = run(&source, &[6.0, 12.0], 60, 256, 2);
    assert_eq!(one.rows, other.rows);
    assert_eq!((one.false_finds, one.marks_missing), (other.false_finds, 0));
    assert!(one.rows.iter().all(|r| r.marks == 60 && r.recall >= 0.95), "{:?}", one.rows);
    assert_eq!(one.false_finds, 0);
}

#[test]
fn a_small_image_is_planted_several_times_and_says_what_is_missing() {
    let result = run(&ground(300, 200), &[8.0], 60, 512, 1);
    assert!(result.rounds > 1 && result.rows[0].marks == 60, "{result:?}");
    let result = run(&ground(60, 40), &[8.0], 60, 512, 1);
    assert_eq!((result.rows[0].marks, result.marks_missing), (0, 60));
    assert!(result.advice.is_none() && result.rows[0].rmse_px.is_none());
}

/// In a grey picture other paints and larger marks were advised, which nobody finds there either.
#[test]
fn of_a_grey_picture_it_says_what_helps() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (image, size) = (folder.path().join("grey.tif"), (600, 500));
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let file = driver.create_with_band_type::<u8, _>(&image, size.0, size.1, 1).expect("created");
    let values = (0..size.0 * size.1).map(|i| 60 + (i * 7919 % 83) as u8).collect();
    file.rasterband(1)
        .expect("there")
        .write((0, 0), size, &mut gdal::raster::Buffer::new(size, values))
        .expect("written");
    file.close().expect("written");
    let run = Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
        .arg("selftest")
        .arg(&image)
        .args(["--sizes", "12", "--marks", "10"])
        .output();
    let text = String::from_utf8_lossy(&run.expect("the program starts").stdout).into_owned();
    assert!(text.contains("the picture is grey") && text.contains("black-white-checker"), "{text}");
    assert!(!text.contains("another paint"), "{text}");
}

#[test]
fn the_command_leaves_the_file_alone_and_gives_advice() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let image = folder.path().join("scene.tif");
    let spec = autoref_synth::SynthSpec {
        gcps: autoref_synth::random_gcps(6, 30.0, 25.0, 1),
        size_px: Some((1100, 900)),
        ..autoref_synth::SynthSpec::default()
    };
    autoref_synth::write(&spec, &image).expect("a sample");
    let before = std::fs::read(&image).expect("just written");
    let run = |extra: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
        command.arg("selftest").arg(&image).args(extra).output().expect("the program starts")
    };
    let output = run(&["--sizes", "8,14", "--marks", "60", "--gsd", "0.03"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("95 % interval") && text.contains("False finds"), "{text}");
    assert_eq!(std::fs::read(&image).expect("still there"), before);
    let output = run(&["--sizes", "14", "--marks", "40", "--json", "--profile", "pink", "--shape", "disc"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one document");
    assert!(json["selftest"]["rows"][0]["recall"].as_f64().expect("a share") > 0.9, "{json}");
    assert_eq!(output.status.code(), Some(i32::from(json["selftest"]["advice"].is_null())));
    // Paint of another colour than the named profile's is not found: no size does.
    let output = run(&["--sizes", "14", "--marks", "20", "--paint", "blue", "--profile", "ral-2007"]);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stdout));
    // Without a profile's name it is looked for as paint of its own.
    let output = run(&["--sizes", "14", "--marks", "20", "--paint", "blue"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.code() == Some(0) && text.contains("Looked for as"), "{text}");
    for wrong in [["--sizes", "1"], ["--fading", "2"], ["--shape", "bar"], ["--blur", "0"]] {
        let output = run(&wrong);
        assert_eq!(output.status.code(), Some(2), "{wrong:?}");
    }
}
