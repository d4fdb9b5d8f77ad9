//! What people really hand in: broken profiles, pictures of nothing, marks on the edge, marks without end. A clear line
//! or the right answer, never a panic; all through the program.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use gdal::raster::{Buffer, RasterCreationOptions};

fn autoref(args: &[&str]) -> Output {
    let output = Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!said.contains("panicked"), "{args:?}: {said}");
    assert!(matches!(output.status.code(), Some(0..=2)), "{args:?}: {:?} {said}", output.status);
    output
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).trim().to_string()
}

const ORANGE: [u8; 4] = [250, 110, 25, 255];
const GROUND: [u8; 4] = [96, 92, 80, 255];

/// A picture of `bands` (3, or 4 with alpha) from a rule.
fn picture(
    path: &Path,
    (width, height): (usize, usize),
    bands: usize,
    nodata: Option<f64>,
    rule: impl Fn(usize, usize) -> [u8; 4],
) {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let alpha = if bands == 4 { "ALPHA=YES" } else { "ALPHA=NO" };
    let options = RasterCreationOptions::from_iter(["PHOTOMETRIC=RGB", "COMPRESS=DEFLATE", alpha]);
    let file =
        driver.create_with_band_type_with_options::<u8, _>(path, width, height, bands, &options).expect("a new file");
    for band in 0..bands {
        let data = (0..width * height).map(|i| rule(i % width, i / width)[band]).collect();
        let mut out = file.rasterband(band + 1).expect("a band");
        out.write((0, 0), (width, height), &mut Buffer::new((width, height), data)).expect("written");
        out.set_no_data_value(nodata).expect("kept");
    }
    file.close().expect("written");
}

fn text(path: &Path) -> &str {
    path.to_str().expect("plain")
}

const COLOUR: &str = "[colour]\nlimit = 3.0\n[[colour.clouds]]\nmean = [50.0, 40.0, 49.0]\n\
                      covariance = [[90.0, 0.0, 0.0], [0.0, 80.0, 0.0], [0.0, 0.0, 90.0]]\n";
const SIZE: &str = "[size]\nmin_px = 5.0\nmax_px = 30.0\n";

/// What is in the file, and a word that the message must have.
fn broken_profiles(sound: &str) -> Vec<(String, &'static str)> {
    let swapped = |from: &str, to: &str| {
        assert!(sound.contains(from), "{from}");
        sound.replace(from, to)
    };
    let with = |extra: &str| format!("{sound}{extra}\n");
    vec![
        (String::new(), "name"),
        (swapped("name = \"x\"\n", ""), "name"),
        (format!("name = \"x\"\n{COLOUR}"), "size"),
        (format!("name = \"x\"\n{SIZE}"), "colour"),
        (swapped("limit = 3.0\n", ""), "limit"),
        (swapped("limit = 3.0", "limit = nan"), "colour.limit"),
        (swapped("limit = 3.0", "limit = inf"), "colour.limit"),
        (swapped("limit = 3.0", "limit = -3.0"), "colour.limit"),
        (swapped("limit = 3.0", "limit = \"3\""), "line"),
        (swapped("mean = [50.0", "mean = [nan"), "colour.clouds"),
        (swapped("mean = [50.0, 40.0, 49.0]", "mean = [50.0, 40.0]"), "line"),
        (swapped("[[90.0, 0.0", "[[nan, 0.0"), "colour.clouds"),
        (swapped("[[90.0, 0.0", "[[-90.0, 0.0"), "colour.clouds"),
        (swapped("[0.0, 80.0, 0.0]", "[0.0, 0.0, 0.0]"), "singular"),
        (swapped("[[90.0, 0.0", "[[90.0, 50.0"), "colour.clouds"),
        (swapped("min_px = 5.0", "min_px = -5.0"), "size"),
        (swapped("min_px = 5.0", "min_px = nan"), "size"),
        (swapped("min_px = 5.0", "min_px = 50.0"), "size"),
        (swapped("max_px = 30.0", "max_px = 1e9"), "size.max_px"),
        (swapped("max_px = 30.0", "max_m = 0.4"), "size of a pixel is not known"),
        (swapped("name = \"x\"", "name = \"x\"\nshape = \"hexagon\""), "hexagon"),
        (swapped("name = \"x\"", "name = \"x\"\nshape = \"checker\""), "colour"),
        (swapped("name = \"x\"", "name = \"x\"\ncolor = 3"), "color"),
        (with("[gates]\nmin_area_px = -3"), "line"),
        (with("[gates]\nmin_area_px = 50\nmax_area_px = 10"), "gates.max_area_px"),
        (with("[gates]\nmax_eccentricity = nan"), "gates.max_eccentricity"),
        (with("[gates]\nmin_tightness = 1.5"), "gates.max_tightness"),
        (with("[gates]\nmin_solidity = 0.9\nmax_solidity = 0.5"), "gates.max_solidity"),
        (with("[gates]\nmin_area_per_perimeter_px = -1.0"), "gates.max_area_per_perimeter_px"),
        (with("[filters]\nclosing_radius_px = 1000"), "filters"),
        (with("[examine]\nmin_score = nan"), "min_score"),
        (with("[examine]\nmin_distance_px = inf"), "min_distance_px"),
        (with("[examine]\nmax_spread = nan"), "max_spread"),
        (with("[examine]\ncentre = \"middle\""), "middle"),
        (
            with(
                "[examine.density]\nsamples = [[], [], []]\nbandwidth = [1.0, 1.0, 1.0]\nmin_probability = 0.0\nmax_zero_share = 0.5",
            ),
            "examine.density",
        ),
        (
            with(
                "[examine.density]\nsamples = [[1.0], [1.0], [1.0]]\nbandwidth = [1.0, 1.0, 1.0]\nmin_probability = 0.0\nmax_zero_share = 2.0",
            ),
            "examine.density",
        ),
        ("<profile/>".into(), "line 1"),
        ("name = \"x\n".into(), "line 1"),
    ]
}

#[test]
fn bad_profiles_are_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let image = folder.path().join("image.tif");
    picture(&image, (60, 60), 3, None, |_, _| GROUND);
    let sound = format!("name = \"x\"\n{COLOUR}{SIZE}");
    let cases = broken_profiles(&sound);
    let path = folder.path().join("profile.toml");
    let refused = |words: &[&str], what: &str| {
        let output = autoref(&["detect", text(&image), "--profile", text(&path)]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{what}\n{message}");
        assert!(words.iter().all(|word| message.contains(word)), "{what}\n{message}: no {words:?}");
        assert_eq!(message.lines().count(), 1, "{what}\n{message}");
    };
    for (number, (content, word)) in cases.iter().enumerate() {
        std::fs::write(&path, content).expect("writable");
        // Whether the size of a pixel is known shows with the image; the rest in the file, which the library reads as
        // the program does: every case by the library, one in three by the program, all with AUTOREF_LARGE=1.
        let needs_image = *word == "size of a pixel is not known";
        let words = if needs_image { vec![*word] } else { vec![*word, "profile.toml"] };
        if !needs_image {
            let said = autoref_stream::profile::Profile::load(text(&path)).expect_err(content).to_string();
            assert!(words.iter().all(|word| said.contains(word)) && !said.contains('\n'), "{content}\n{said}");
        }
        if needs_image || number % 3 == 0 || crate::common::large() {
            refused(&words, content);
        }
    }
    std::fs::write(&path, [0u8, 159, 146, 150, 0xFF]).expect("writable");
    refused(&["profile.toml"], "bytes that are no text");
    std::fs::remove_file(&path).expect("it was written");
    refused(&["profile.toml"], "no file");
    std::fs::create_dir(&path).expect("a folder of that name");
    refused(&["profile.toml"], "a folder");
    // The sound one passes.
    std::fs::remove_dir(&path).expect("it is empty");
    std::fs::write(&path, &sound).expect("writable");
    assert_eq!(autoref(&["detect", text(&image), "--profile", text(&path)]).status.code(), Some(0));
}

/// Centres of the candidates, from the CSV on standard output.
fn centres(output: &Output) -> Vec<(f64, f64)> {
    let mut reader = csv::Reader::from_reader(&output.stdout[..]);
    let number = |r: &csv::StringRecord, i: usize| r[i].parse::<f64>().expect("a number");
    reader.records().map(|r| r.expect("a row")).map(|r| (number(&r, 0), number(&r, 1))).collect()
}

/// Pictures, and how many candidates of the default profile are right.
fn pictures(folder: &Path) -> Vec<(PathBuf, std::ops::RangeInclusive<usize>)> {
    let mut all = Vec::new();
    let mut add = |name: &str,
                   size: (usize, usize),
                   bands: usize,
                   nodata: Option<f64>,
                   right: std::ops::RangeInclusive<usize>,
                   rule: &dyn Fn(usize, usize) -> [u8; 4]| {
        let path = folder.join(format!("{name}.tif"));
        picture(&path, size, bands, nodata, rule);
        all.push((path, right));
    };
    let orange = |yes: bool| if yes { ORANGE } else { GROUND };
    add("one-pixel", (1, 1), 3, None, 0..=0, &|_, _| ORANGE);
    add("row", (80, 1), 3, None, 0..=0, &|x, _| orange(x > 30 && x < 42));
    add("column", (1, 80), 3, None, 0..=0, &|_, y| orange(y > 30 && y < 42));
    add("all-orange", (300, 200), 3, None, 0..=0, &|_, _| ORANGE);
    add("all-black", (300, 200), 3, None, 0..=0, &|_, _| [0; 4]);
    add("all-nodata", (300, 200), 3, Some(0.0), 0..=0, &|_, _| [0; 4]);
    add("all-orange-nodata", (300, 200), 3, Some(250.0), 0..=0, &|_, _| [250; 4]);
    add("all-transparent", (300, 200), 4, None, 0..=0, &|x, y| {
        let [r, g, b, _] = orange(x % 40 < 12 && y % 40 < 12);
        [r, g, b, 0]
    });
    // Three of 12 px flush with an edge, two in corners; one in the middle.
    let flush = |x: usize, y: usize| {
        let inside = |x0: usize, y0: usize| (x0..x0 + 12).contains(&x) && (y0..y0 + 12).contains(&y);
        orange([(0, 0), (50, 0), (0, 60), (188, 60), (188, 128), (90, 60)].iter().any(|&(a, b)| inside(a, b)))
    };
    add("edges", (200, 140), 3, None, 6..=6, &flush);
    // Cut in half by the edges: a mark or not, but no more than there are.
    add("cut", (200, 140), 3, None, 0..=4, &|x, y| {
        let inside = |cx: i64, cy: i64| (x as i64 - cx).abs() < 6 && (y as i64 - cy).abs() < 6;
        orange(inside(0, 70) || inside(199, 70) || inside(100, 0) || inside(100, 139))
    });
    // A mark half beyond the border of what the image holds.
    add("border", (200, 140), 3, Some(0.0), 0..=1, &|x, y| {
        if x < 100 { [0; 4] } else { orange(x < 106 && (60..72).contains(&y)) }
    });
    // Touching at their corners: one region of 288 marks, which is no mark.
    add("touching", (240, 240), 3, None, 0..=0, &|x, y| orange((x / 10 + y / 10) % 2 == 0));
    // Three pixels apart: 400 marks, or 2,500.
    let side = if crate::common::large() { 50 } else { 20 };
    add("crowd", (12 * side, 12 * side), 3, None, side * side..=side * side, &|x, y| orange(x % 12 < 9 && y % 12 < 9));
    add("lines", (300, 300), 3, None, 0..=0, &|x, y| orange(x % 7 == 0 || y % 50 == 0));
    add("specks", (300, 300), 3, None, 0..=0, &|x, y| orange(x % 3 == 0 && y % 3 == 0));
    all
}

#[test]
fn odd_pictures_are_answered() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let list = folder.path().join("list.csv");
    std::fs::write(&list, "name,easting,northing\na,1000,2000\nb,1010,2003\nc,1004,2011\nd,1001,2020\ne,1020,2001\n")
        .expect("writable");
    // A taught profile takes touching marks apart; it has no statistics of its own here.
    let split = folder.path().join("split.toml");
    let orange = autoref_stream::profile::Profile::builtin("orange").expect("shipped");
    std::fs::write(&split, orange.to_toml().replace("split = false", "split = true")).expect("writable");
    assert!(std::fs::read_to_string(&split).expect("written").contains("split = true"));
    let huge = folder.path().join("huge.toml");
    std::fs::write(&huge, format!("name = \"huge\"\n{COLOUR}[size]\nmin_px = 700.0\nmax_px = 2000.0\n"))
        .expect("writable");
    for (number, (image, right)) in pictures(folder.path()).into_iter().enumerate() {
        let name = image.file_stem().expect("a name").to_string_lossy().into_owned();
        let found = |profile: &str| {
            let output = autoref(&["detect", text(&image), "--profile", profile, "--quiet"]);
            assert_eq!(output.status.code(), Some(0), "{name}, {profile}: {}", stderr(&output));
            let found = centres(&output);
            assert!(found.iter().all(|c| c.0.is_finite() && c.1.is_finite()), "{name}, {profile}: {found:?}");
            found
        };
        let marks = found("orange");
        assert!(right.contains(&marks.len()), "{name}: {} candidates, right are {right:?}", marks.len());
        if name == "edges" {
            for at in [(6.0, 6.0), (56.0, 6.0), (6.0, 66.0), (194.0, 66.0), (194.0, 134.0), (96.0, 66.0)] {
                let near = marks.iter().map(|c| (c.0 - at.0).hypot(c.1 - at.1)).fold(f64::INFINITY, f64::min);
                assert!(near < 0.5, "edges: {at:?} is {near:.2} px off");
            }
        }
        // In turn, all with AUTOREF_LARGE=1.
        let in_turn = |turn: usize, of: usize| crate::common::large() || number % of == turn;
        if in_turn(0, 3) {
            assert!(found(text(&huge)).is_empty(), "{name}: larger than the image");
        }
        if in_turn(1, 3) || ["all-orange", "touching", "crowd"].contains(&name.as_str()) {
            // Marks that touch are taken apart at most sixteen at a time.
            let most = if name == "crowd" { 2500 } else { 64 };
            assert!(found(text(&split)).len() <= most, "{name}: taught");
        }
        for (turn, profile) in ["autoref-2016", "black-white-cross", "black-white-checker"].into_iter().enumerate() {
            // The first eight are tiny, or of one colour.
            if in_turn(2 + 3 * turn, 9) || (number < 8 && number % 3 == turn) {
                found(profile);
            }
        }
        // The main job says why not and writes no georeference.
        let output = autoref(&[text(&image), "--gcps", text(&list), "--gsd", "0.05", "--no-report", "--overwrite"]);
        assert_eq!(output.status.code(), Some(1), "{name}: {}", stderr(&output));
        assert!(String::from_utf8_lossy(&output.stdout).contains("Not solved"), "{name}");
        assert!(!image.with_extension("tfw").exists() && !image.with_extension("wld").exists(), "{name}");
        // A lesson from it is a profile or one line.
        if in_turn(0, 2) {
            let output = autoref(&["sample", text(&image), "--at", "0.5,0.5"]);
            let is_answer = output.status.code() == Some(0) || stderr(&output).lines().count() == 1;
            assert!(is_answer, "{name}: {}", stderr(&output));
        }
        if in_turn(1, 2) || name == "one-pixel" {
            let distance = folder.path().join("distance.tif");
            let output = autoref(&["distance", text(&image), "-o", text(&distance), "--overwrite"]);
            assert_eq!(output.status.code(), Some(0), "{name}: {}", stderr(&output));
        }
    }
}

/// A grey picture of one strip; its bytes, and where those of the strip lie.
fn grey(path: &Path, options: &[&str]) -> (Vec<u8>, std::ops::Range<usize>) {
    let (width, height) = (400, 300);
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let strip = format!("BLOCKYSIZE={height}");
    let options = RasterCreationOptions::from_iter(options.iter().copied().chain([strip.as_str()]));
    let mut file =
        driver.create_with_band_type_with_options::<u8, _>(path, width, height, 1, &options).expect("a new file");
    let data = (0..width * height).map(|i| u8::from((i % width / 7 + i / width / 5) % 2 == 0)).collect();
    let mut band = file.rasterband(1).expect("a band");
    band.write((0, 0), (width, height), &mut Buffer::new((width, height), data)).expect("written");
    file.flush_cache().expect("written");
    drop(file);
    let bytes = std::fs::read(path).expect("there");
    let entry = |tag: u16| {
        let at = u32::from_le_bytes(bytes[4..8].try_into().expect("four")) as usize + 2;
        let found = (0..30).map(|i| at + 12 * i).find(|at| bytes[*at..*at + 2] == tag.to_le_bytes()).expect("the tag");
        u32::from_le_bytes(bytes[found + 8..found + 12].try_into().expect("four")) as usize
    };
    let begin = entry(273);
    let strip = begin..begin + entry(279);
    (bytes, strip)
}

/// Decoders of fax go on over broken rows: white paper is no answer.
#[test]
fn fax_that_breaks_is_an_error() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("fax.tif");
    let (mut bytes, strip) = grey(&path, &["COMPRESS=CCITTFAX4", "NBITS=1"]);
    assert_eq!(autoref(&["detect", path.to_str().expect("UTF-8"), "--quiet"]).status.code(), Some(0));
    let middle = strip.start + strip.len() / 2;
    bytes[middle..strip.end].fill(0);
    std::fs::write(&path, bytes).expect("writable");
    let output = autoref(&["detect", path.to_str().expect("UTF-8"), "--quiet"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("fax.tif") && output.stdout.is_empty(), "{}", stderr(&output));
}

#[test]
fn jpeg_of_sixteen_bits_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("deep.tif");
    let (mut bytes, _) = grey(&path, &["COMPRESS=JPEG"]);
    let directory = u32::from_le_bytes(bytes[4..8].try_into().expect("four")) as usize + 2;
    let depth = (0..30).map(|i| directory + 12 * i).find(|at| bytes[*at..*at + 2] == 258u16.to_le_bytes());
    bytes[depth.expect("the tag") + 8] = 16;
    std::fs::write(&path, bytes).expect("writable");
    let output = autoref(&["detect", path.to_str().expect("UTF-8"), "--quiet"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert_eq!(stderr(&output).lines().count(), 1, "{}", stderr(&output));
}
