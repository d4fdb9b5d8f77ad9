//! Masks of drawn frames from file to file: any tiling the same bytes, samples kept, corrections, faults in words.
#![allow(clippy::unwrap_used)] // a test that fails here says where

#[path = "../../../tests/common/skipped.rs"]
mod skipped;
use std::path::{Path, PathBuf};

use autoref_raster::ReaderChoice;
use autoref_terrain::batch::mask_frame;
use autoref_terrain::clean::Cleaning;
use autoref_terrain::given::Given;
use autoref_terrain::options::{Extras, Method, Options};
use autoref_terrain::shapes::{self, Lesson, parse_sample};
use autoref_terrain::teach::teach;
use autoref_terrain::write::MaskCompression;
use gdal::DriverManager;
use gdal::raster::{Buffer, RasterCreationOptions};

const SIZE: (usize, usize) = (1201, 803);

/// Rough ground to the left of a slanting shore, water with little noise to the right.
fn is_ground(x: usize, y: usize) -> bool {
    x < 500 + y / 4
}

fn draw(path: &Path, bands: usize, gain: f64, options: &[&str]) {
    let driver = DriverManager::get_driver_by_name("GTiff").unwrap();
    let options = RasterCreationOptions::from_iter(options.iter().copied());
    let set = driver.create_with_band_type_with_options::<u8, _>(path, SIZE.0, SIZE.1, bands, &options).unwrap();
    let mut state = 1936u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 40) as f64 / (1u64 << 24) as f64 - 0.5
    };
    let pixels: Vec<u8> = (0..SIZE.0 * SIZE.1)
        .map(|i| {
            let (x, y) = (i % SIZE.0, i / SIZE.0);
            let hills = 30.0 * (x as f64 / 9.0).sin() * (y as f64 / 7.0).cos();
            let value = if is_ground(x, y) { 110.0 + hills + 60.0 * random() } else { 95.0 + 6.0 * random() };
            (value * gain).clamp(0.0, 255.0) as u8
        })
        .collect();
    for band in 1..=bands {
        set.rasterband(band).unwrap().write((0, 0), SIZE, &mut Buffer::new(SIZE, pixels.clone())).unwrap();
    }
    set.close().unwrap();
}

fn write_mask(path: &Path, value: impl Fn(usize, usize) -> u8) {
    let driver = DriverManager::get_driver_by_name("GTiff").unwrap();
    let set = driver.create_with_band_type::<u8, _>(path, SIZE.0, SIZE.1, 1).unwrap();
    let pixels = (0..SIZE.0 * SIZE.1).map(|i| value(i % SIZE.0, i / SIZE.0)).collect();
    set.rasterband(1).unwrap().write((0, 0), SIZE, &mut Buffer::new(SIZE, pixels)).unwrap();
    set.close().unwrap();
}

fn read(path: &Path) -> Vec<u8> {
    let set = gdal::Dataset::open(path).unwrap();
    assert_eq!(set.raster_size(), SIZE);
    set.rasterband(1).unwrap().read_as::<u8>((0, 0), SIZE, SIZE, None).unwrap().data().to_vec()
}

fn agreement(mask: &[u8]) -> f64 {
    let right = mask.iter().enumerate().filter(|(i, v)| (**v == 1) == is_ground(i % SIZE.0, i / SIZE.0)).count();
    right as f64 / mask.len() as f64
}

fn options(method: Method) -> Options {
    Options {
        method,
        // So that the tests are quick.
        reduce: 3,
        neighbours: 3,
        threshold_bit: 4.0,
        // Discs that fit a small frame.
        cleaning: Cleaning { closings: vec![3, 6], disc: 5, ..Cleaning::default() },
        auto_area_share: 0.0025,
        compression: MaskCompression::CcittG4,
        extras: Extras::default(),
        corrections: Vec::new(),
        tile_px: 0,
        memory_budget_bytes: 512 << 20,
        reader: ReaderChoice::Auto,
        overwrite: true,
        resume: false,
    }
}

/// As many pixels as tell ground from water.
fn samples() -> Given {
    let samples = ["ground=40,60,140,140", "water=900,60,140,140"].map(|text| parse_sample(text).unwrap());
    Given { samples: samples.to_vec(), ..Given::default() }
}

fn run(frame: &Path, folder: &Path, given: &Given, options: &Options) -> Vec<u8> {
    let classifier = teach(&[frame.to_path_buf()], given, options).unwrap();
    let done = mask_frame(frame, folder, &classifier, given, options).unwrap();
    let mask = read(&done.report.mask);
    let share = mask.iter().filter(|v| **v == 1).count() as f64 / mask.len() as f64;
    assert!((share - done.report.keep_share).abs() < 0.02, "{share} {}", done.report.keep_share);
    mask
}

#[test]
fn ground_is_kept_and_water_masked_by_both_taught_methods() {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("a.tif");
    draw(&frame, 3, 1.0, &["TILED=YES"]);
    for method in [Method::Thesis2017, Method::Auto] {
        let mask = run(&frame, folder.path(), &samples(), &options(method));
        assert!(mask.iter().all(|v| *v <= 1) && agreement(&mask) > 0.95, "{method:?}: {}", agreement(&mask));
    }
    let xml = std::fs::read_to_string(folder.path().join("a_Masq.xml")).unwrap();
    assert!(xml.contains("<NameFileMnt>./a_Masq.tif</NameFileMnt>") && xml.contains("<NombrePixels>1201 803<"));
}

#[test]
fn what_one_frame_teaches_holds_for_a_darker_one() {
    let folder = tempfile::tempdir().unwrap();
    let (frame, other) = (folder.path().join("a.tif"), folder.path().join("b.tif"));
    draw(&frame, 1, 1.0, &[]);
    draw(&other, 1, 0.6, &[]);
    let mask = folder.path().join("taught.tif");
    write_mask(&mask, |x, y| if (400..700).contains(&x) { 255 } else { u8::from(is_ground(x, y)) });
    let given = Given { lessons: vec![Lesson { frame, mask }], ..Given::default() };
    let found = run(&other, folder.path(), &given, &options(Method::Auto));
    assert!(agreement(&found) > 0.95, "{}", agreement(&found));
}

#[test]
fn tiles_threads_layout_and_memory_do_not_change_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    let layouts: [(&str, &[&str]); 3] = [
        ("tiled", &["TILED=YES"]),
        ("strips", &["COMPRESS=DEFLATE"]),
        ("one", &["COMPRESS=DEFLATE", "BLOCKYSIZE=803"]),
    ];
    for method in [Method::Thesis2017, Method::Auto] {
        let mut all: Vec<Vec<u8>> = Vec::new();
        for (i, (name, layout)) in layouts.into_iter().enumerate() {
            let frame = folder.path().join(format!("{name}.tif"));
            draw(&frame, 1, 1.0, layout);
            let ways = [(0, 2, 512u64), (130 + 67 * i as u64, 1, 112), (700, 2, 112)];
            // Every layout in one way, the first in two; all in all with AUTOREF_LARGE=1.
            let few = if std::env::var_os("AUTOREF_LARGE").is_some() {
                &ways[..]
            } else {
                [&ways[..2], &ways[2..], &ways[1..2]][i]
            };
            for &(tile_px, threads, memory) in few {
                let options = Options { tile_px, memory_budget_bytes: memory << 20, ..options(method) };
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let out = folder.path().join("out");
                std::fs::create_dir_all(&out).unwrap();
                pool.install(|| run(&frame, &out, &samples(), &options));
                all.push(std::fs::read(out.join(format!("{name}_Masq.tif"))).unwrap());
            }
        }
        assert!(all.iter().all(|bytes| *bytes == all[0]), "{method:?}");
    }
}

/// Rough ground in large and small patches, in colour, and its darker, softer mirror image below the middle.
fn draw_lake(path: &Path, layout: &[&str]) {
    let driver = DriverManager::get_driver_by_name("GTiff").unwrap();
    let layout = RasterCreationOptions::from_iter(layout.iter().copied());
    let set = driver.create_with_band_type_with_options::<u8, _>(path, SIZE.0, SIZE.1, 3, &layout).unwrap();
    let random = |x: usize, y: usize| {
        let mixed = ((x * 7919 + y) as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        ((mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f64 / (1u64 << 24) as f64
    };
    let ground = |x: usize, y: usize| 40.0 + 90.0 * random(x / 14, y / 14) + 70.0 * random(x, y + 5000);
    for band in 1..=3 {
        let level = |x: usize, y: usize| match y {
            0..=401 => ground(x, y),
            _ => 30.0 + 90.0 * random(x / 14, (802 - y) / 14) / 2.0 + 8.0 * random(x, y + 5000),
        };
        let tint = 0.7 + 0.1 * band as f64;
        let pixels: Vec<u8> = (0..SIZE.0 * SIZE.1).map(|i| (tint * level(i % SIZE.0, i / SIZE.0)) as u8).collect();
        set.rasterband(band).unwrap().write((0, 0), SIZE, &mut Buffer::new(SIZE, pixels)).unwrap();
    }
    set.close().unwrap();
}

#[test]
fn a_lake_that_mirrors_is_masked_in_any_tiling() {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("lake.tif");
    draw_lake(&frame, &["TILED=YES"]);
    let mut all: Vec<Vec<u8>> = Vec::new();
    for (tile_px, threads, memory) in [(0, 2, 512u64), (130, 1, 112)] {
        let options = Options { tile_px, memory_budget_bytes: memory << 20, ..options(Method::Auto) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| all.push(run(&frame, folder.path(), &Given::default(), &options)));
    }
    assert!(all[0] == all[1]);
    let kept = |rows: std::ops::Range<usize>| {
        let part = &all[0][rows.start * SIZE.0..rows.end * SIZE.0];
        part.iter().filter(|v| **v == 1).count() as f64 / part.len() as f64
    };
    let (ground, lake) = (kept(0..390), kept(440..790));
    assert!(ground > 0.95 && lake < 0.1, "{ground} {lake}");
}

#[test]
fn what_a_person_says_holds() {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("a.tif");
    draw(&frame, 1, 1.0, &[]);
    let shape = |text: &str| parse_sample(text).unwrap();
    let mut given = samples();
    // A patch of water, marked as keep, is not masked whatever it looks like.
    given.samples.push(shape("keep=1000,500,80,80"));
    given.global = vec![shape("mask:text=100,100,100,40")];
    given.mended = vec![shape("mask=20,700,60,60@a.tif"), shape("keep=1100,700,60,60@other.tif")];
    let mask = run(&frame, folder.path(), &given, &options(Method::Auto));
    let at = |x: usize, y: usize| mask[y * SIZE.0 + x];
    assert_eq!([at(1040, 540), at(150, 120), at(50, 730), at(1130, 730)], [1, 0, 0, 0]);
}

/// Where a lake is drawn on the shore that is to be kept, the classifier decides, taught that it is water.
#[test]
fn a_lake_on_its_shore_is_not_kept() {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("a.tif");
    draw(&frame, 1, 1.0, &[]);
    let list = folder.path().join("list.toml");
    let sample = |class: &str, rectangle: &str| format!("[[sample]]\nclass = \"{class}\"\nrectangle = {rectangle}\n");
    let text = sample("ground", "[1000, 500, 80, 80]") + &sample("water", "[1020, 520, 40, 40]");
    std::fs::write(&list, text).unwrap();
    let mut given = samples();
    given.samples.extend(shapes::read(&list).unwrap());
    let mask = run(&frame, folder.path(), &given, &options(Method::Auto));
    let at = |x: usize, y: usize| mask[y * SIZE.0 + x];
    assert_eq!([at(1004, 504), at(1040, 540)], [1, 0]);
}

#[test]
fn what_a_person_says_holds_to_the_pixel() {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("a.tif");
    draw(&frame, 1, 1.0, &[]);
    let options = Options { reduce: 4, extras: Extras { colmap: true, ..Extras::default() }, ..options(Method::Auto) };
    let before = run(&frame, folder.path(), &samples(), &options);
    let lattice = folder.path().join("global.tif");
    let masked_by_raster = |x: usize, y: usize| (x + y).is_multiple_of(7);
    write_mask(&lattice, |x, y| u8::from(!masked_by_raster(x, y)));
    let mut given = samples();
    given.global = vec![parse_sample("mask:text=101,99,101,41").unwrap()];
    given.global_mask = Some(lattice);
    given.mended = vec![parse_sample("keep=901.5,301.5,3,7").unwrap(), parse_sample("mask=903,303,99,1").unwrap()];
    let mask = run(&frame, folder.path(), &given, &options);
    let within = |x: usize, y: usize, [left, top, w, h]: [f64; 4]| {
        let (x, y) = (x as f64 + 0.5, y as f64 + 0.5);
        (left..left + w).contains(&x) && (top..top + h).contains(&y)
    };
    // A sample is kept whatever the classifier says; none lies where something else is said here.
    for (i, (now, before)) in mask.iter().zip(&before).enumerate() {
        let (x, y) = (i % SIZE.0, i / SIZE.0);
        let expected = if within(x, y, [903.0, 303.0, 99.0, 1.0]) {
            0
        } else if within(x, y, [901.5, 301.5, 3.0, 7.0]) {
            1
        } else if within(x, y, [101.0, 99.0, 101.0, 41.0]) || masked_by_raster(x, y) {
            0
        } else {
            *before
        };
        assert_eq!(*now, expected, "{x}, {y}");
    }
    let colmap = read(&folder.path().join("a.tif.png"));
    assert!(colmap.iter().zip(&mask).all(|(png, bit)| *png == 255 * bit));
}

#[test]
fn done_frames_are_left_alone_until_something_changes() {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("a.tif");
    draw(&frame, 1, 1.0, &[]);
    let (given, mut options) = (samples(), options(Method::Thesis2017));
    (options.overwrite, options.resume) = (false, true);
    let classifier = teach(std::slice::from_ref(&frame), &given, &options).unwrap();
    let status = |options: &Options| {
        mask_frame(&frame, folder.path(), &classifier, &given, options).map(|d| d.report.status.name())
    };
    assert_eq!(status(&options).unwrap(), "done");
    assert_eq!(status(&options).unwrap(), "unchanged");
    options.cleaning.disc = 7;
    assert_eq!(status(&options).unwrap(), "done");
    options.resume = false;
    assert!(status(&options).expect_err("it exists").to_string().contains("a_Masq.tif"));
}

#[test]
fn what_is_stale_or_gone_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (frame, teacher) = (at("a.tif"), at("b.tif"));
    draw(&frame, 1, 1.0, &[]);
    draw(&teacher, 1, 1.0, &[]);
    let text = |what: &str| format!("{what}@{}", teacher.display());
    let given = Given {
        samples: vec![
            parse_sample(&text("ground=50,50,120,120")).unwrap(),
            parse_sample(&text("water=900,50,120,120")).unwrap(),
        ],
        ..Given::default()
    };
    let run = |options: &Options| {
        let taught = teach(std::slice::from_ref(&frame), &given, options).unwrap();
        mask_frame(&frame, folder.path(), &taught, &given, options).unwrap().report.status.name()
    };
    let mut all = options(Method::Thesis2017);
    all.resume = true;
    all.extras = Extras { explain: true, colmap: true, ..Extras::default() };
    assert_eq!([run(&all), run(&all)], ["done", "unchanged"]);
    // What is gone is made again.
    std::fs::remove_file(at("a_Entropy.tif")).unwrap();
    assert_eq!([run(&all), run(&all)], ["done", "unchanged"]);
    assert!(at("a_Entropy.tif").is_file());
    std::fs::write(at("a_Masq.tif"), "").unwrap();
    assert_eq!(run(&all), "done");
    // A frame that teaches has changed.
    draw(&teacher, 1, 0.8, &["TILED=YES"]);
    assert_eq!(run(&all), "done");
    // Pictures of another mask do not stay beside a new one; files of others do.
    std::fs::write(at("mine.png"), "mine").unwrap();
    all.extras = Extras::default();
    assert_eq!(run(&all), "done");
    let left = ["a.tif.png", "a_Entropy.tif", "a_Class.tif", "a_Distance.tif", "a_Scatter.svg"];
    assert!(left.iter().all(|name| !at(name).exists()) && at("mine.png").is_file() && at("a_Masq.xml").is_file());
}

#[test]
fn what_a_person_masks_is_nothing_to_be_unsure_of() {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("a.tif");
    draw(&frame, 1, 1.0, &[]);
    let options = options(Method::Auto);
    let taught = teach(std::slice::from_ref(&frame), &Given::default(), &options).unwrap();
    let report = |given: &Given| mask_frame(&frame, folder.path(), &taught, given, &options).unwrap().report;
    let whole = folder.path().join("global.tif");
    write_mask(&whole, |_, _| 0);
    for given in [
        // Beyond the frame: half a cell of the analysis lies there.
        Given { global: vec![parse_sample("mask=0,0,1210,810").unwrap()], ..Given::default() },
        Given { global_mask: Some(whole), ..Given::default() },
    ] {
        let report = report(&given);
        assert_eq!((report.unsure_share, report.unlike_share), (0.0, Some(0.0)));
    }
}

#[test]
fn pixels_taught_both_ways_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let frame = at("a.tif");
    draw(&frame, 1, 1.0, &[]);
    let sample = |text: &str| parse_sample(text).unwrap();
    let taught = |given: &Given, method: Method| {
        // The sides of the samples are those of the cells, so that the overlap is named as it was drawn.
        let options = Options { reduce: 2, ..options(method) };
        teach(std::slice::from_ref(&frame), given, &options).err().map(|error| error.to_string())
    };
    let both =
        Given { samples: vec![sample("water=100,100,60,60"), sample("ground=140,120,60,60")], ..Given::default() };
    for method in [Method::Auto, Method::Thesis2017] {
        let said = taught(&both, method).expect("they overlap");
        for word in
            ["a.tif", "`ground=140,120,60,60` says keep", "`water=100,100,60,60` says mask", "140, 120 to 160, 160"]
        {
            assert!(said.contains(word), "{said}");
        }
    }
    // A drawn mask against a sample.
    let mask = at("taught.tif");
    write_mask(&mask, |x, _| if x < 600 { 1 } else { 255 });
    let mut given = Given { samples: vec![sample("water=500,0,200,10")], ..Given::default() };
    given.lessons = vec![Lesson { frame: frame.clone(), mask }];
    let said = taught(&given, Method::Auto).expect("the mask says keep");
    assert!(said.contains("taught.tif says keep") && said.contains("500, 0 to 600, 10"), "{said}");
    // Sides that touch, and classes of one side, agree.
    let apart = ["ground=100,100,60,60", "water=160,100,60,60", "glacier=110,110,20,20"].map(sample);
    assert_eq!(taught(&Given { samples: apart.to_vec(), ..Given::default() }, Method::Auto), None);
    // In one list a lake lies on its shore; nothing is left of what it covers wholly.
    let list = |lake: &str| {
        let path = at("list.toml");
        let text = format!(
            "[[sample]]\nclass = \"ground\"\nrectangle = [100, 100, 60, 60]\n[[sample]]\nclass = \"water\"\nrectangle = {lake}\n"
        );
        std::fs::write(&path, text).unwrap();
        Given { samples: shapes::read(&path).unwrap(), ..Given::default() }
    };
    assert_eq!(taught(&list("[120, 120, 20, 20]"), Method::Auto), None);
    let said = taught(&list("[100, 100, 60, 60]"), Method::Auto).expect("nothing is left");
    assert!(said.contains("sample 1 of") && said.contains("sample 2 of"), "{said}");
}

#[test]
fn faults_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let frame = path("a.tif");
    draw(&frame, 1, 1.0, &[]);
    let frames: [PathBuf; 1] = [frame.clone()];
    let fault = |given: &Given, method: Method| teach(&frames, given, &options(method)).err().unwrap().to_string();
    let with = |text: &str| Given { samples: vec![parse_sample(text).unwrap()], ..Given::default() };
    assert!(fault(&with("keep=1190,0,20,20"), Method::Auto).contains("does not lie inside"));
    assert!(fault(&with("keep=0,0,20,20"), Method::Thesis2017).contains("no sample of a class to mask"));
    assert!(fault(&with("keep=0,0,20,20@b.tif"), Method::Auto).contains("there is no frame b.tif"));
    let small = path("small.tif");
    DriverManager::get_driver_by_name("GTiff").unwrap().create_with_band_type::<u8, _>(&small, 3, 3, 1).unwrap();
    let lesson = |mask: PathBuf| Given { lessons: vec![Lesson { frame: frame.clone(), mask }], ..Given::default() };
    assert!(fault(&lesson(small), Method::Auto).contains("3 × 3 px"));
    let odd = path("odd.tif");
    write_mask(&odd, |x, _| if x / 4 == 150 { 7 } else { 1 });
    assert!(fault(&lesson(odd), Method::Auto).contains("the value 7"));
    let empty = path("empty.tif");
    std::fs::write(&empty, "").unwrap();
    let classifier = teach(&frames, &samples(), &options(Method::Auto)).unwrap();
    let error = mask_frame(&empty, folder.path(), &classifier, &samples(), &options(Method::Auto)).err().unwrap();
    assert!(error.to_string().contains("empty.tif"));
    assert!(!path("empty_Masq.tif").exists());
}

/// The frames that people drew polygons on; their photographs are not part of the repository.
#[test]
fn an_oblique_photograph_taught_by_its_neighbour_agrees_with_the_drawn_polygons() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/oblique_svalbard");
    let (frame, other) = (data.join("uv_KR1_140705_160000.JPG"), data.join("plumeplotted1.JPG"));
    if !frame.is_file() {
        skipped::skipped(format!("{} is absent", frame.display()));
        return;
    }
    let polygons =
        |name: &str| shapes::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/polygons").join(name)).unwrap();
    // Polygons given as samples would be kept by force: here they only teach the neighbour.
    let mut given = Given { samples: polygons("KR1_plume.geojson"), ..Given::default() };
    given.samples.iter_mut().for_each(|shape| shape.frame = Some(other.display().to_string()));
    // Small, so that the test is quick.
    let options = Options { reduce: 16, ..options(Method::Auto) };
    let classifier = teach(std::slice::from_ref(&frame), &given, &options).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let done = mask_frame(&frame, folder.path(), &classifier, &given, &options).unwrap();
    let set = gdal::Dataset::open(&done.report.mask).unwrap();
    let band = set.rasterband(1).unwrap();
    let truth = polygons("KR1_uv.geojson");
    let (mut right, mut judged) = (0, 0);
    for y in (370..2650).step_by(20) {
        let row = band.read_as::<u8>((0, y as isize), (6000, 1), (6000, 1), None).unwrap();
        for x in (1345..4800).step_by(20) {
            let named = truth.iter().rev().find(|shape| shape.contains([x as f64 + 0.5, y as f64 + 0.5]));
            if let Some(shape) = named.filter(|shape| shape.meaning != shapes::Meaning::Unknown) {
                judged += 1;
                right += usize::from((row.data()[x] == 1) == (shape.meaning == shapes::Meaning::Keep));
            }
        }
    }
    let accuracy = f64::from(right as u32) / f64::from(judged);
    assert!(judged > 10_000 && accuracy > 0.90, "{accuracy} of {judged}");
}
