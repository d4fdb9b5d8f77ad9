//! No command writes over what it reads, under whatever name and with whatever flags.

mod options;

use std::path::{Path, PathBuf};
use std::process::Command;

use super::commands::{CASES, everything, files_below, program, workplace};

fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .expect("readable")
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.is_file())
        .map(|path| (path.clone(), std::fs::read(&path).expect("readable")))
        .collect();
    files.sort();
    files
}

#[test]
fn no_output_of_any_command_is_an_input() {
    let folder = workplace();
    let dir = folder.path();
    std::os::unix::fs::symlink("a.tif", dir.join("link.tif")).expect("links");
    std::fs::hard_link(dir.join("c.csv"), dir.join("hard.csv")).expect("links");
    std::fs::write(dir.join("a.tif.aux.xml"), "<PAMDataset/>").expect("writable");
    let commands: &[&[&str]] = &[
        &["detect", "a.tif", "--profile", "p.toml", "-o", "OUT"],
        &["distance", "a.tif", "--profile", "p.toml", "-o", "OUT"],
        &["sample", "a.tif", "--at", "100,100", "-o", "OUT"],
        &["solve", "c.csv", "--gcps", "a.geojson", "-o", "OUT"],
        &["solve", "hard.csv", "--gcps", "a.geojson", "-o", "OUT"],
        &["synth", "OUT", "--as-is", "a.tif", "--gcps", "c.csv"],
        &["synth", "new.tif", "--gcps", "c.csv", "--write-gcps", "OUT"],
    ];
    let before = contents(dir);
    let mut pairs = 0;
    for command in commands {
        let inputs = ["a.tif", "link.tif", "c.csv", "hard.csv", "a.geojson", "p.toml"].into_iter().filter(|name| {
            let read = |file: &str| command.contains(&file);
            match *name {
                "link.tif" => read("a.tif"),
                "c.csv" | "hard.csv" => read("c.csv") || read("hard.csv"),
                name => read(name),
            }
        });
        let sidecar = command.contains(&"a.tif").then_some("a.tif.aux.xml");
        for target in inputs.chain(sidecar) {
            let mut arguments: Vec<&str> =
                command.iter().map(|word| if *word == "OUT" { target } else { word }).collect();
            if command[0] != "sample" {
                arguments.push("--overwrite");
            }
            let out = program(dir, &arguments);
            let said = String::from_utf8_lossy(&out.stderr);
            assert_eq!(out.status.code(), Some(2), "{arguments:?}: {said}");
            assert!(said.contains("input") && said.trim_end().lines().count() == 1, "{arguments:?}: {said}");
            assert!(contents(dir) == before, "{arguments:?} changed a file");
            pairs += 1;
        }
    }
    assert!(pairs >= 20, "{pairs} pairs were tried");
}

/// Commands that `make test` tries with two of their files.
const TWO_FILES: usize = 24;

/// Every file that a command writes is in turn a second name, hard or soft, of every file that it reads: it is refused,
/// and what is read keeps its bytes. In part in `make test`: the first and the last file of each command, of several
/// inputs each with one of them.
#[test]
fn no_file_that_a_command_writes_is_one_that_it_reads() {
    let folder = everything();
    let dir = &folder.at("");
    let all = std::env::var_os("AUTOREF_LARGE").is_some();
    let out = dir.join("o");
    let (mut pairs, mut commands) = (0, 0);
    for (place, case) in CASES
        .iter()
        .enumerate()
        .filter(|(place, case)| all || (!case.is_slow() && (*place < TWO_FILES || place % 2 == 0)))
    {
        let arguments = case.arguments();
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        std::fs::create_dir(&out).expect("a folder");
        let run = program(dir, &arguments);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert!(matches!(run.status.code(), Some(0 | 1)), "{}: {said}", case.line);
        let mut written = files_below(&out);
        assert!(!written.is_empty(), "{} wrote nothing", case.line);
        assert!(!written.iter().any(|path| path.to_string_lossy().contains(".part")), "{written:?}");
        if !all {
            written = vec![written.first().expect("one").clone(), written.last().expect("one").clone()];
            written.dedup();
            // The first commands of the list with the first and the last of their files, the others with one.
            written.truncate(if place < TWO_FILES { 2 } else { 1 });
        }
        commands += 1;
        let inputs = if all || place < TWO_FILES { case.inputs } else { &case.inputs[..1] };
        for (number, input) in inputs.iter().enumerate() {
            let in_turn =
                |index: &usize| all || inputs.len() < written.len() || (index + number).is_multiple_of(written.len());
            for (index, target) in written.iter().enumerate().filter(|(index, _)| in_turn(index)) {
                for hard in [true, false].into_iter().filter(|&hard| all || hard == ((number + index) % 2 == 0)) {
                    std::fs::remove_dir_all(&out).expect("there");
                    std::fs::create_dir_all(target.parent().expect("a folder")).expect("a folder");
                    let linked = if hard {
                        std::fs::hard_link(dir.join(input), target)
                    } else {
                        std::os::unix::fs::symlink(dir.join(input), target)
                    };
                    linked.expect("links");
                    let before = contents(dir);
                    let frame = std::fs::read(dir.join(input)).expect("readable");
                    let run = program(dir, &arguments);
                    let said = String::from_utf8_lossy(&run.stderr).into_owned();
                    let what = format!("{} with {} as {input}, hard {hard}", case.line, target.display());
                    assert!(contents(dir) == before, "{what} changed a file");
                    assert!(std::fs::read(dir.join(input)).expect("there") == frame, "{what} changed it");
                    assert_eq!(run.status.code(), Some(2), "{what}: {said}");
                    assert!(!files_below(&out).iter().any(|path| path.to_string_lossy().contains(".part")), "{what}");
                    pairs += 1;
                }
            }
        }
        std::fs::remove_dir_all(&out).expect("there");
    }
    println!("{commands} commands, {pairs} pairs");
    assert!(
        (commands == CASES.len() || !all) && pairs >= if all { 250 } else { 45 },
        "{commands} commands, {pairs} pairs"
    );
}

/// A folder is replaced only when all in it is of an earlier comparison.
#[test]
fn a_comparison_clears_no_folder_of_other_things() {
    let folder = everything();
    let dir = &folder.at("");
    std::fs::create_dir(dir.join("models")).expect("a folder");
    std::fs::rename(dir.join("d1.tif"), dir.join("models/d1.tif")).expect("moved");
    let lines: [&[&str]; 2] = [
        &["dem", "compare", "models/d1.tif", "d2.tif", "--out", "models", "--overwrite"],
        &["dem", "compare", "d2.tif", "d2.tif", "--out", "models", "--overwrite"],
    ];
    for line in lines {
        let run = program(dir, line);
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.code() == Some(2) && said.contains("models"), "{said}");
        assert!(dir.join("models/d1.tif").is_file(), "{line:?} removed a model");
    }
}

#[test]
fn a_list_that_the_job_would_write_is_not_replaced() {
    let folder = workplace();
    let dir = folder.path();
    let convert = "name,easting,northing\n".to_owned();
    let list = std::fs::read_to_string(dir.join("a.geojson")).expect("readable");
    let list: serde_json::Value = serde_json::from_str(&list).expect("JSON");
    let rows = list["features"].as_array().expect("features").iter().map(|f| {
        let at = &f["geometry"]["coordinates"];
        format!("{},{},{}\n", f["properties"]["name"].as_str().expect("a name"), at[0], at[1])
    });
    std::fs::write(dir.join("a.csv"), convert + &rows.collect::<String>()).expect("writable");
    let before = contents(dir);
    let out = program(dir, &["a.tif", "--gcps", "a.csv", "--crs", "EPSG:32632", "--write", "csv", "--overwrite"]);
    let list_name = PathBuf::from("a.csv");
    assert_eq!(std::fs::read(dir.join(&list_name)).expect("there"), before_of(&before, &list_name));
    // Either the tie points have another name, or the job is refused; the list stays.
    assert!(matches!(out.status.code(), Some(0 | 2)), "{}", String::from_utf8_lossy(&out.stderr));
}

fn before_of(files: &[(PathBuf, Vec<u8>)], name: &Path) -> Vec<u8> {
    files.iter().find(|(path, _)| path.ends_with(name)).expect("was there").1.clone()
}

#[test]
fn devices_stay_devices() {
    let folder = workplace();
    let out = program(folder.path(), &["detect", "a.tif", "-o", "/dev/null", "--overwrite"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(!std::fs::metadata("/dev/null").expect("there").is_file(), "/dev/null was replaced");
    let full = program(folder.path(), &["detect", "a.tif", "-o", "/dev/full", "--overwrite"]);
    assert_eq!(full.status.code(), Some(2), "{}", String::from_utf8_lossy(&full.stderr));
    assert!(!std::fs::metadata("/dev/full").expect("there").is_file(), "/dev/full was replaced");
}

/// Runs through a shell, so that standard output is a full device or a closed pipe.
#[test]
fn a_full_or_closed_standard_output_is_no_panic() {
    let folder = workplace();
    let binary = env!("CARGO_BIN_EXE_autoref-stream");
    let shell = |line: String| {
        Command::new("bash").arg("-c").arg(line).current_dir(folder.path()).output().expect("bash starts")
    };
    std::fs::create_dir(folder.path().join("r")).expect("a folder");
    model(&folder.path().join("d.tif"), 500_000.0);
    std::fs::write(folder.path().join("k.xyz"), "x y z\n1 2 3\n2 3 4\n").expect("writable");
    for line in [
        "a.tif --gcps a.geojson --out r --overwrite --json --no-report",
        "detect a.tif -o -",
        "mask a.tif -o m --method threshold --overwrite --json",
        "dem profile d.tif --line '500005,6999990 500100,6999900'",
        "cloud info k.xyz --json",
        "gcps convert a.geojson -o b.csv --overwrite --json",
        "fiducials --list-cameras",
        "man",
        "--help",
    ] {
        let closed = shell(format!("set -o pipefail; {binary} {line} | true; exit ${{PIPESTATUS[0]}}"));
        let said = String::from_utf8_lossy(&closed.stderr).into_owned();
        assert!(!said.contains("panicked") && closed.status.code() == Some(0), "{line}: {:?} {said}", closed.status);
        let full = shell(format!("{binary} {line} > /dev/full"));
        let said = String::from_utf8_lossy(&full.stderr).into_owned();
        assert!(!said.contains("panicked") && full.status.code() == Some(2), "{line}: {:?} {said}", full.status);
        assert_eq!(said.matches("No space left").count(), 1, "{line}: {said}");
    }
}

/// A small model of hills at `x0`.
fn model(path: &Path, x0: f64) {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let mut set = driver.create_with_band_type::<f32, _>(path, 40, 40, 1).expect("writable");
    set.set_geo_transform(&[x0, 10.0, 0.0, 7_000_000.0, 0.0, -10.0]).expect("a place");
    let reference = gdal::spatial_ref::SpatialRef::from_epsg(25833).expect("known");
    set.set_spatial_ref(&reference).expect("a CRS");
    let height = |i: usize| ((i % 40) as f32 / 3.0).sin() * 20.0 + ((i / 40) as f32 / 4.0).cos() * 30.0;
    let mut heights = gdal::raster::Buffer::new((40, 40), (0..1600).map(height).collect());
    set.rasterband(1).and_then(|mut band| band.write((0, 0), (40, 40), &mut heights)).expect("written");
}

/// A virtual raster of files that lie beside it.
fn virtual_raster(path: &Path, parts: &[&str]) {
    let source = |part: &&str| {
        format!(
            "<SimpleSource><SourceFilename relativeToVRT=\"1\">{part}</SourceFilename><SourceBand>1</SourceBand>\
             </SimpleSource>"
        )
    };
    let text = format!(
        "<VRTDataset rasterXSize=\"40\" rasterYSize=\"40\"><SRS>EPSG:25833</SRS><GeoTransform>500000,10,0,7000000,0,-10\
         </GeoTransform><VRTRasterBand dataType=\"Float32\" band=\"1\">{}</VRTRasterBand></VRTDataset>",
        parts.iter().map(source).collect::<String>()
    );
    std::fs::write(path, text).expect("writable");
}

/// What a raster refers to is an input as the raster is: parts of virtual ones, also of those in others, headers, and
/// the companions that a rule names.
#[test]
fn what_an_input_refers_to_is_never_written_over() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path();
    let at = |name: &str| dir.join(name);
    for (name, x0) in [("s0.tif", 500_000.0), ("s1.tif", 500_000.0), ("s2.tif", 500_100.0), ("s0_r.tif", 500_000.0)] {
        model(&at(name), x0);
    }
    // GDAL's names for files hold what may stand in a file's own.
    model(&at("s,3.tif"), 500_000.0);
    virtual_raster(&at("v.vrt"), &["s1.tif", "s2.tif"]);
    virtual_raster(&at("outer.vrt"), &["v.vrt"]);
    virtual_raster(&at("s2_r.vrt"), &["s0_r.tif"]);
    std::fs::write(at("s2.tif.aux.xml"), "<PAMDataset/>").expect("writable");
    std::fs::write(at("table.txt"), "0 0 0 0\n100 255 255 255\n").expect("writable");
    let made = program(dir, &["mosaic", "s0.tif", "s2.tif", "-o", "first.tif", "--write-index", "i.tif"]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    virtual_raster(&at("i.vrt"), &["i.tif"]);
    let lines = [
        "mosaic v.vrt -o s1.tif",
        "mosaic s0.tif v.vrt -o s2.tif",
        "mosaic outer.vrt -o s1.tif",
        "mosaic outer.vrt -o v.vrt.tif --write-index s2.tif",
        "mosaic outer.vrt s0.tif --balance --balance-page s2.tif.aux.xml -o new.tif",
        "mosaic s0.tif -o s0_r.tif --choose min:{stem}_r.tif",
        "mosaic s0.tif -o new.tif --choose min:{stem}_r.tif --write-index s0_r.tif",
        "mosaic s2.tif -o s0_r.tif --choose min:{stem}_r.vrt",
        "mosaic s0.tif s2.tif -o i.tif --use-index i.tif",
        "mosaic s0.tif s2.tif -o i.tif --use-index i.vrt",
        "dem slope v.vrt -o s1.tif",
        "dem slope vrt://s1.tif?bands=1 -o s1.tif",
        "dem slope GTIFF_DIR:1:s,3.tif -o s,3.tif",
        "dem aspect outer.vrt -o s1.tif",
        "dem hillshade v.vrt -o s2.tif",
        "dem roughness v.vrt -o s1.tif",
        "dem tri v.vrt -o s1.tif",
        "dem tpi v.vrt -o s1.tif",
        "dem colour outer.vrt -o s1.tif --table table.txt",
        "dem contour v.vrt -o s1.tif --interval 5",
        "dem profile v.vrt -o s1.tif --line 500005,6999990;500100,6999900",
        "dem resample v.vrt -o s1.tif --resolution 20",
        "dem resample v.vrt -o s{res}.tif --resolution 1",
        "dem align v.vrt --to s0.tif -o s1.tif",
        "dem align s0.tif --to outer.vrt -o s2.tif",
    ];
    let before = contents(dir);
    for line in lines {
        let arguments: Vec<&str> = line.split(' ').chain(["--overwrite"]).collect();
        let out = program(dir, &arguments);
        let said = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{line}: {said}");
        assert!(contents(dir) == before, "{line} changed a file");
        assert!(said.contains("input") && said.trim_end().lines().count() == 1, "{line}: {said}");
    }
    // What refers to nothing may be replaced.
    let made = program(dir, &["mosaic", "v.vrt", "-o", "first.tif", "--overwrite"]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
}

/// What was asked for and would not be done is said before any work.
#[test]
fn options_without_effect_are_refused() {
    let folder = workplace();
    std::fs::write(folder.path().join("k.xyz"), "x y z\n0 0 1\n1 1 2\n2 2 3\n").expect("writable");
    let job = "a.tif --gcps a.geojson --out o --no-report";
    let before = contents(folder.path());
    for (line, words) in [
        (format!("{job} --quality 50"), "--quality belongs to --write warp"),
        (format!("{job} --write world --resolution 2"), "--resolution belongs to --write warp"),
        (format!("{job} --second-pass=always --refine never"), "--second-pass=always has no effect"),
        (format!("{job} --second-pass --profile black-white-cross"), "found by their shape"),
        ("cloud grid k.xyz --out o --range-from 1,2,3".into(), "--range-from has no effect"),
        (format!("{job} --write warp --compress zstd --quality 50"), "--quality is of jpeg and webp"),
        (format!("{job} --write warp --quality 50"), "--quality is of jpeg and webp"),
        (format!("{job} --break-cog"), "--break-cog belongs to --write tags"),
        (
            "cloud grid k.xyz --out o --fill 0 --power 2".into(),
            "--power has no effect: no --stat is idw, and holes are not",
        ),
        ("cloud grid k.xyz --out o --fill 1 --power 2".into(), "holes are not filled"),
        ("cloud grid k.xyz --out o --stat count --power 2".into(), "holes are not filled"),
        ("cloud grid k.xyz --out o --like-pdal --power 2".into(), "holes are filled with PDAL's weights"),
    ] {
        let run = program(folder.path(), &line.split(' ').collect::<Vec<_>>());
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.code() == Some(2) && said.contains(words), "{line}: {said}");
        assert!(contents(folder.path()) == before && files_below(&folder.path().join("o")).is_empty(), "{line}");
    }
    for line in [&format!("{job} --write warp --quality 50 --compress jpeg"), "cloud grid k.xyz --out g --power 2"] {
        let run = program(folder.path(), &line.split(' ').collect::<Vec<_>>());
        assert!(run.status.success(), "{line}: {}", String::from_utf8_lossy(&run.stderr));
    }
}
