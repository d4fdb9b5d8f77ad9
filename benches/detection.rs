//! How many marks are found, how many false ones come with them, and how well the centres sit?
//!
//! Marks are planted with known sub-pixel centres into real photographs, one factor at a time about a base case (10 px,
//! blur 0.9 px, fading up to 20 %, JPEG 90). Excluded: reading files, tiling and merging (they never change a
//! candidate).
//!
//! `cargo bench -p autoref-benches --bench detection` prints the tables of `docs/benchmark-detection.md` (at least
//! 2,000 marks a cell); `AUTOREF_BENCH_MARKS=100` is a quick look, `AUTOREF_BENCH_PYTHON=python3` (with scikit-image)
//! adds the pipeline of `benches/scikit_pipeline.py` on the same pictures; `AUTOREF_BENCH_ROWS=rows.txt` writes one
//! line a mark found: condition, error, standard deviations, what the fit saw; `AUTOREF_BENCH_MISSES=folder` writes a
//! window around every mark missed, as PNG, and what the detector saw there; `AUTOREF_BENCH_COVERS=IMG_00,forest`
//! plants only into the covers whose name holds one of these words; `AUTOREF_BENCH_ONLY=covered,JPEG` measures only the
//! conditions and covers whose name holds one of these words. The photographs are looked for in `../shared/data`.

#[path = "detection/scan.rs"]
mod scan;

use std::path::{Path, PathBuf};

use autoref_raster::Patch;
use autoref_raster::coords::PixelPoint;
use autoref_raster::window::Window;
use autoref_stream::candidate::Candidate;
use autoref_stream::candidate::evidence::GroundSeen;
use autoref_stream::candidate::examine::measure;
use autoref_stream::learn::learn;
use autoref_stream::profile::Profile;
use autoref_stream::segment::label::Region;
use autoref_stream::selftest::{Tally, reach_px};
use autoref_synth::plant::{Cell, Picture, Random, plant};
use rayon::prelude::*;
use scan::Detector;

/// Covers that marks are planted into. No limit was chosen on the last.
const COVERS: [&str; 9] = [
    "photos/city_ochota_3013.jpg",
    "photos/city_ochota_3019.jpg",
    "photos/construction_caliterra.jpg",
    "photos/river_town_oam.tif",
    "photos/savanna_oam.tif",
    "photos/canal_pdok_tiled_jpeg.tif",
    "photos/suburb_vegas_uint16.tif",
    "photos/forest_agung.jpg",
    "targets/IMG_0046.jpg",
];
/// Covers that are reported by themselves: full of things of the paint's own colour, or small, or held out: nothing was
/// ever planted into `oak_sjer_neon.tif` and `IMG_0031.jpg` before the figures that are published.
const MORE: [&str; 5] = [
    "photos/village_boruszyn.jpg",
    "photos/town_freetown.jpg",
    "photos/oak_sjer_neon.tif",
    "targets/IMG_0031.jpg",
    "photos/pumpkins_crop.png",
];

fn photo(name: &str) -> Option<Picture> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")).join(name);
    let file = gdal::Dataset::open(&path).ok()?;
    let (width, height) = file.raster_size();
    let bands: Vec<Vec<f64>> = (1..=3)
        .map(|b| file.rasterband(b).ok()?.read_as::<f64>((0, 0), (width, height), (width, height), None).ok())
        .map(|b| b.map(|b| b.data().to_vec()))
        .collect::<Option<_>>()?;
    // 16-bit pictures are stretched so that 0.5 % of the samples saturate.
    let white = if name.contains("uint16") {
        let mut all: Vec<f64> = bands.iter().flatten().copied().collect();
        all.sort_by(f64::total_cmp);
        all[all.len() * 995 / 1000]
    } else {
        255.0
    };
    let byte = |v: f64| (v * 255.0 / white).round().min(255.0) as u8;
    let rgb = (0..width * height).map(|i| [byte(bands[0][i]), byte(bands[1][i]), byte(bands[2][i])]).collect();
    Some(Picture { width, height, rgb })
}

fn cells() -> Vec<Cell> {
    let mut cells = Vec::new();
    let mut add = |label: String, change: &dyn Fn(&mut Cell)| {
        let mut cell = Cell { label, ..Cell::base() };
        change(&mut cell);
        cells.push(cell);
    };
    for side in [5.0, 6.0, 8.0, 10.0, 14.0, 20.0, 30.0] {
        add(format!("size {side} px"), &|c| c.side_px = side);
    }
    for blur in [0.6, 1.2, 1.8] {
        add(format!("blur {blur} px"), &|c| c.blur_px = blur);
    }
    for angle in [0.0, 22.5, 45.0] {
        add(format!("rotation {angle}°"), &|c| c.angle_deg = Some(angle));
    }
    for fading in [0.0, 0.3, 0.4] {
        add(format!("fading to {:.0} %", fading * 100.0), &|c| c.fading = fading);
    }
    for light in [0.6, 0.35] {
        add(format!("shadow, light {light}"), &|c| c.light = light);
    }
    for cover in [0.15, 0.3] {
        add(format!("covered {:.0} %", cover * 100.0), &|c| c.cover = cover);
    }
    for quality in [75, 85, 95] {
        add(format!("JPEG {quality}"), &|c| c.quality = quality);
    }
    for quality in [75, 90] {
        add(format!("JPEG {quality}, chroma in full"), &|c| (c.quality, c.full_chroma) = (quality, true));
    }
    let paints = [[255, 103, 0], [255, 121, 0], [255, 90, 31], [245, 110, 20], [240, 130, 50]];
    for paint in paints {
        add(format!("paint {paint:?}"), &|c| c.paint = paint);
    }
    add("disc".into(), &|c| c.disc = true);
    add("mixed in linear light".into(), &|c| c.linear = true);
    cells
}

fn row(tally: &Tally) -> String {
    format!(
        "{} | {:.2} % | {:+.3} {:+.3} | {:.3} | {:.3} | {:.2}",
        tally.marks,
        100.0 * tally.recall(),
        tally.bias_px()[0],
        tally.bias_px()[1],
        tally.rmse_px(),
        tally.median_px().unwrap_or(f64::NAN),
        tally.normalised()
    )
}

/// The prototype's options with a colour taught from marks of the base case: its own reference is another paint's.
fn taught_prototype(covers: &[(&str, Picture)]) -> Detector {
    let mut marks = Vec::new();
    let mut random = Random(4242);
    for (_, picture) in covers.iter().take(4) {
        let (planted, truth) = plant(&middle(picture, 400), &Cell::base(), &mut random);
        for &(x, y) in truth.iter().take(5) {
            let bounds = Window::whole(planted.width as u64, planted.height as u64);
            let window = Window::new(x as u64, y as u64, 1, 1).grown(20, &bounds);
            let cut = planted.crop(window.x as usize, window.y as usize, window.width as usize, window.height as usize);
            let rgb: Vec<[u16; 3]> = cut.rgb.iter().map(|c| c.map(u16::from)).collect();
            marks.push((Patch { window, valid: vec![true; rgb.len()], rgb, white: 255 }, PixelPoint { x, y }));
        }
    }
    let taught = learn("taught", &marks).expect("planted marks stand out");
    let mut profile = Profile::builtin("autoref-2016").expect("shipped");
    profile.colour.clouds = taught.colour.clouds;
    profile.colour.rough = None;
    profile.colour.rough_box = None;
    Detector::new(profile)
}

/// The pipeline in Python over the same pictures; `None` when it is not asked for.
fn scikit(pictures: &[&Picture]) -> Option<Vec<Vec<Candidate>>> {
    let python = std::env::var_os("AUTOREF_BENCH_PYTHON")?;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let names: Vec<PathBuf> = (0..pictures.len()).map(|i| folder.path().join(format!("{i}.png"))).collect();
    for (name, picture) in names.iter().zip(pictures) {
        write_png(name, picture);
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/scikit_pipeline.py");
    let output = std::process::Command::new(python).arg(script).args(&names).output().expect("python starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut lists = vec![Vec::new(); pictures.len()];
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let fields: Vec<&str> = line.split('\t').collect();
        let index = names.iter().position(|n| n.as_os_str() == fields[0]).expect("a name it was given");
        let number = |i: usize| fields[i].parse::<f64>().expect("a number");
        lists[index].push(Candidate::at(PixelPoint { x: number(1), y: number(2) }));
    }
    Some(lists)
}

/// One line a mark found, for whoever models the errors.
fn write_rows(
    file: &mut std::fs::File,
    (label, cover): (&str, &str),
    detector: &Detector,
    picture: &Picture,
    truth: &[(f64, f64)],
) {
    use std::io::Write;
    for (region, candidate) in detector.candidates(picture) {
        let at = candidate.centre;
        let Some(t) = truth.iter().find(|t| (t.0 - at.x).hypot(t.1 - at.y) < 2.0) else { continue };
        let seen = measure(
            &region,
            &detector.patch(picture, &region),
            &detector.classifier,
            &detector.profile,
            &detector.gates,
        );
        let (Some(seen), Some(v)) = (seen, candidate.covariance_px2) else { continue };
        let Some(fit) = seen.fit else { continue };
        let raw = fit.scatter_px2;
        let refined = seen.refined.map_or([0.0; 4], |r| {
            let [xx, xy, yy] = r.covariance_px2;
            [f64::from(r.quality), xx, xy, yy]
        });
        writeln!(
            file,
            "{label}\t{cover}\t{:?}\t{:.4}\t{:.4}\t{:.6}\t{:.6}\t{:.6}\t{:.6}\t{:.3}\t{:.3}\t{:.4}\t{:.3}\t{:.4}\t{:.3}\t{:.3}\t{:.3}\t{:.4}\t{:.3}\t{}\t{:.6}\t{:.6}\t{:?}",
            fit.form,
            at.x - t.0,
            at.y - t.1,
            v[0],
            v[2],
            raw[0],
            raw[2],
            fit.sides_px[0],
            fit.sides_px[1],
            fit.rms,
            fit.blur_px,
            fit.hidden,
            fit.angle_rad,
            seen.contrast,
            fit.chi2,
            fit.edge_sd,
            fit.height,
            u8::from(seen.ground == GroundSeen::Local),
            v[1],
            raw[1],
            refined
        )
        .expect("room for a line");
    }
}

/// A window around every mark missed, four times enlarged, and one line about what stopped each region there.
fn write_misses(
    folder: &Path,
    label: &str,
    detector: &Detector,
    picture: &Picture,
    truth: &[(f64, f64)],
    side_px: f64,
) {
    let found = detector.list(picture);
    let missed =
        truth.iter().filter(|t| found.iter().all(|c| (c.centre.x - t.0).hypot(c.centre.y - t.1) > reach_px(side_px)));
    let reach = (side_px + 16.0) as usize;
    for &(x, y) in missed {
        let (left, top) = ((x as usize).saturating_sub(reach), (y as usize).saturating_sub(reach));
        let window = picture.crop(left, top, 2 * reach, 2 * reach);
        let name = format!("{}-{x:.0}-{y:.0}.png", label.replace(|c: char| !c.is_alphanumeric(), "_"));
        let large = |i: usize| window.rgb[i / 4 / (4 * window.width) * window.width + i % (4 * window.width) / 4];
        let rgb = (0..16 * window.width * window.height).map(large).collect();
        let large = Picture { width: 4 * window.width, height: 4 * window.height, rgb };
        write_png(&folder.join(&name), &large);
        let near = |r: &Region| r.bounds.grown(3, &Window::whole(picture.width as u64, picture.height as u64));
        let regions =
            detector.regions(picture).into_iter().filter(|r| near(r).contains(x as u64, y as u64) && r.area > 3);
        let stages: Vec<String> = regions.map(|r| detector.explain(picture, &r)).collect();
        println!("missed {name}: {}", if stages.is_empty() { "no region".into() } else { stages.join("; ") });
    }
}

fn write_png(path: &Path, picture: &Picture) {
    let file = std::io::BufWriter::new(std::fs::File::create(path).expect("room for a picture"));
    let mut png = png::Encoder::new(file, picture.width as u32, picture.height as u32);
    png.set_color(png::ColorType::Rgb);
    let mut writer = png.write_header().expect("a header");
    writer.write_image_data(picture.rgb.as_flattened()).expect("a picture");
}

fn middle(picture: &Picture, side: usize) -> Picture {
    let side = side.min(picture.width).min(picture.height);
    picture.crop((picture.width - side) / 2, (picture.height - side) / 2, side, side)
}

fn main() {
    let least: usize = std::env::var("AUTOREF_BENCH_MARKS").ok().and_then(|v| v.parse().ok()).unwrap_or(2000);
    let load = |names: &[&'static str]| -> Vec<(&'static str, Picture)> {
        names.iter().filter_map(|n| Some((*n, photo(n)?))).collect()
    };
    let covers = load(&COVERS);
    if covers.is_empty() {
        println!("no photographs under ../shared/data: nothing to measure");
        return;
    }
    let ours = Detector::new(Profile::builtin("orange").expect("shipped"));
    let prototype = taught_prototype(&covers);

    println!(
        "| conditions | marks | recall | bias x, y px | RMSE px | median px | normalised | 2016: recall | RMSE px | scikit-image: recall | RMSE px |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let mut rows = std::env::var_os("AUTOREF_BENCH_ROWS").map(|p| std::fs::File::create(p).expect("a file of rows"));
    let misses = std::env::var_os("AUTOREF_BENCH_MISSES").map(PathBuf::from);
    let only = std::env::var("AUTOREF_BENCH_ONLY").unwrap_or_default();
    let wanted = |name: &str| only.split(',').any(|word| name.contains(word));
    let ground = std::env::var("AUTOREF_BENCH_COVERS").unwrap_or_default();
    let used = |name: &str| ground.split(',').any(|word| name.contains(word));
    for (number, cell) in cells().iter().enumerate().filter(|(_, c)| wanted(&c.label)) {
        let (mut mine, mut theirs, mut python) = (Tally::default(), Tally::default(), Tally::default());
        // Larger marks need more ground for the same number.
        for round in 0..6u64 {
            let results: Vec<_> = covers
                .par_iter()
                .enumerate()
                .filter(|(_, (name, _))| used(name))
                .map(|(i, (name, picture))| {
                    let side = if least < 1000 { 400 } else { 1000 };
                    let (w, h) = (picture.width.saturating_sub(side), picture.height.saturating_sub(side));
                    let mut random = Random(1 + 1_000_003 * (number as u64 + 1) + 7919 * i as u64 + 104_729 * round);
                    let (x, y) = ((random.unit() * w as f64) as usize, (random.unit() * h as f64) as usize);
                    let (planted, truth) = plant(
                        &picture.crop(x, y, side.min(picture.width), side.min(picture.height)),
                        cell,
                        &mut random,
                    );
                    (ours.list(&planted), prototype.list(&planted), truth, planted, *name)
                })
                .collect();
            let pictures: Vec<&Picture> = results.iter().map(|r| &r.3).collect();
            for ((.., truth, _, _), list) in results.iter().zip(scikit(&pictures).unwrap_or_default()) {
                python.add((0.0, 0.0), truth, &list, cell.side_px);
            }
            for (a, b, truth, planted, name) in results {
                if let Some(file) = &mut rows {
                    write_rows(file, (&cell.label, name), &ours, &planted, &truth);
                }
                if let Some(folder) = &misses {
                    write_misses(folder, &cell.label, &ours, &planted, &truth, cell.side_px);
                }
                mine.add((0.0, 0.0), &truth, &a, cell.side_px);
                theirs.add((0.0, 0.0), &truth, &b, cell.side_px);
            }
            if mine.marks >= least {
                break;
            }
        }
        let old = row(&theirs);
        let old: Vec<&str> = old.split(" | ").collect();
        let other = row(&python);
        let other: Vec<&str> = if python.marks == 0 { vec!["–"; 4] } else { other.split(" | ").collect() };
        println!("| {} | {} | {} | {} | {} | {} |", cell.label, row(&mine), old[1], old[3], other[1], other[3]);
    }

    let more = load(&MORE);
    let all = covers.iter().chain(&more).enumerate().filter(|(_, cover)| wanted(cover.0));
    table_of_covers(all, (&ours, &prototype), least);
}

/// Each cover by itself: marks of the base case, and false candidates where nothing was planted.
fn table_of_covers<'a>(
    covers: impl Iterator<Item = (usize, &'a (&'static str, Picture))>,
    (ours, prototype): (&Detector, &Detector),
    least: usize,
) {
    println!(
        "\n| cover | marks | recall | RMSE px | normalised | megapixels | false candidates per megapixel | 2016 | scikit-image |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (number, (name, picture)) in covers {
        let size = (picture.width * picture.height) as f64 / 1e6;
        let mine = base_case(ours, picture, number as u64, least / 4);
        let (a, b) = (ours.list(picture).len() as f64 / size, prototype.list(picture).len() as f64 / size);
        let c = scikit(&[picture]).map_or("–".into(), |lists| format!("{:.2}", lists[0].len() as f64 / size));
        let name = name.split('/').next_back().unwrap_or(name);
        let (recall, rmse, normalised) = (100.0 * mine.recall(), mine.rmse_px(), mine.normalised());
        println!(
            "| {name} | {} | {recall:.2} % | {rmse:.3} | {normalised:.2} | {size:.2} | {a:.2} | {b:.2} | {c} |",
            mine.marks
        );
    }
}

/// Marks of the base case planted into one cover at new places.
fn base_case(detector: &Detector, picture: &Picture, number: u64, least: usize) -> Tally {
    let mut tally = Tally::default();
    let side = 600usize;
    for round in 0..40u64 {
        if tally.marks >= least {
            break;
        }
        let mut random = Random(0x5eed_0001 + 7_368_787 * number + 15_485_863 * round);
        let (w, h) = (picture.width.saturating_sub(side), picture.height.saturating_sub(side));
        let (x, y) = ((random.unit() * w as f64) as usize, (random.unit() * h as f64) as usize);
        let ground = picture.crop(x, y, side.min(picture.width), side.min(picture.height));
        let (planted, truth) = plant(&ground, &Cell::base(), &mut random);
        tally.add((0.0, 0.0), &truth, &detector.list(&planted), Cell::base().side_px);
    }
    tally
}
