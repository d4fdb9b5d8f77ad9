//! No command writes over what it reads, under whatever name and with whatever flags.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_synth::{SynthSpec, random_gcps};

fn program(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
        .current_dir(folder)
        .args(arguments)
        .output()
        .expect("the program starts")
}

/// A small image with its list, candidates, profile and accuracy file.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let spec = SynthSpec { gcps: random_gcps(6, 12.0, 9.0, 4), size_px: Some((480, 360)), ..SynthSpec::default() };
    autoref_synth::write(&spec, &folder.path().join("a.tif")).expect("a sample");
    autoref_synth::write_gcp_geojson(&folder.path().join("a.geojson"), &spec.gcps, Some(32632)).expect("a list");
    let detect = program(folder.path(), &["detect", "a.tif", "-o", "c.csv"]);
    assert!(detect.status.success(), "{}", String::from_utf8_lossy(&detect.stderr));
    let profile = std::fs::read(crate::common::root().join("src/profile/builtin/orange.toml")).expect("shipped");
    std::fs::write(folder.path().join("p.toml"), profile).expect("writable");
    folder
}

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

/// A command that writes under `o/`, and what it reads.
struct Case {
    line: &'static str,
    inputs: &'static [&'static str],
}

const CASES: &[Case] = &[
    Case {
        line: "a.tif --gcps a.geojson --profile p.toml --out o --write csv,warp --overwrite",
        inputs: &["a.tif", "a.geojson", "p.toml"],
    },
    Case { line: "detect a.tif --profile p.toml -o o/x.csv --overwrite", inputs: &["a.tif", "p.toml"] },
    Case { line: "solve c.csv --gcps a.geojson -o o/x.json --overwrite", inputs: &["c.csv", "a.geojson"] },
    Case { line: "synth o/x.tif --gcps g.csv --size 96x64 --write-gcps o/y.geojson --overwrite", inputs: &["g.csv"] },
    Case { line: "sample a.tif --result r.json -o o/x.toml --html o/x.html --overwrite", inputs: &["a.tif", "r.json"] },
    Case { line: "chips a.tif --result r.json -o o --overwrite", inputs: &["a.tif", "r.json"] },
    Case { line: "distance a.tif --profile p.toml -o o/x.tif --overwrite", inputs: &["a.tif", "p.toml"] },
    Case { line: "apply r.json a.tif --out o --write csv,warp --overwrite", inputs: &["r.json", "a.tif"] },
    Case { line: "mask a.tif -o o --overwrite", inputs: &["a.tif"] },
    Case { line: "mask frames -o o --overwrite", inputs: &["frames/f.tif"] },
    Case { line: "gcps convert a.geojson -o o/x.csv --overwrite", inputs: &["a.geojson"] },
    Case { line: "patterns c.csv --gcps a.geojson -o o/x.svg --overwrite", inputs: &["c.csv", "a.geojson"] },
    Case { line: "cloud clean k.xyz --out o/x.las --outliers 8,2 --overwrite", inputs: &["k.xyz"] },
    Case { line: "cloud grid k.xyz --out o --cell 4 --overwrite", inputs: &["k.xyz"] },
    Case {
        line: "dem align d1.tif --to d2.tif --out o/x.tif --method bias --overwrite",
        inputs: &["d1.tif", "d2.tif"],
    },
    Case { line: "dem compare d1.tif d2.tif --out o --overwrite", inputs: &["d1.tif", "d2.tif"] },
    Case { line: "dem hillshade d1.tif --out o/x.tif --overwrite", inputs: &["d1.tif"] },
    Case { line: "dem contour d1.tif --out o/x.gpkg --interval 50 --overwrite", inputs: &["d1.tif"] },
    Case { line: "dem contour d1.tif --out o/x.shp --interval 50 --overwrite", inputs: &["d1.tif"] },
    Case {
        line: "dem profile d1.tif --line 500010,6999990;500200,6999900 --out o/x.csv --overwrite",
        inputs: &["d1.tif"],
    },
    Case { line: "dem resample d1.tif --out o/x.tif --resolution 20 --overwrite", inputs: &["d1.tif"] },
    Case { line: "dem colour d1.tif --table t.txt --out o/x.tif --overwrite", inputs: &["d1.tif", "t.txt"] },
    Case {
        line: "mosaic d1.tif d2.tif --out o/x.tif --write-index o/y.tif --overwrite",
        inputs: &["d1.tif", "d2.tif"],
    },
    Case { line: "plan a.geojson --profile-json o/x.json", inputs: &["a.geojson"] },
];

/// Two elevation models, a cloud, a table of colours, a list as CSV, a result and a folder of frames beside the rest.
fn everything() -> tempfile::TempDir {
    let folder = workplace();
    let at = |name: &str| folder.path().join(name);
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    for (name, lift) in [("d1.tif", 0.0), ("d2.tif", 1.5)] {
        let mut dataset = driver.create_with_band_type::<f32, _>(at(name), 60, 50, 1).expect("writable");
        dataset.set_geo_transform(&[500_000.0, 5.0, 0.0, 7_000_000.0, 0.0, -5.0]).expect("a geotransform");
        dataset.set_spatial_ref(&gdal::spatial_ref::SpatialRef::from_epsg(25833).expect("known")).expect("a CRS");
        let height = |i: usize| 200.0 + 80.0 * ((i % 60) as f32 / 9.0).sin() + (i / 60) as f32 + lift;
        let mut values = gdal::raster::Buffer::new((60, 50), (0..3000).map(height).collect());
        dataset.rasterband(1).expect("a band").write((0, 0), (60, 50), &mut values).expect("writable");
    }
    let cloud: String =
        (0..400).map(|i| format!("{} {} {}\n", i % 20, i / 20, 100.0 + 0.01 * f64::from(i % 7))).collect();
    std::fs::write(at("k.xyz"), format!("x y z\n{cloud}")).expect("writable");
    std::fs::write(at("t.txt"), "90 0 0 255\n300 255 0 0\n").expect("writable");
    std::fs::write(at("g.csv"), "name,easting,northing\nA,1,1\nB,2,1.5\n").expect("writable");
    std::fs::create_dir(at("o")).expect("a folder");
    let job = program(folder.path(), &["a.tif", "--gcps", "a.geojson", "--out", "o", "--no-report"]);
    assert!(job.status.success(), "{}", String::from_utf8_lossy(&job.stderr));
    std::fs::rename(at("o/a.autoref.json"), at("r.json")).expect("written");
    std::fs::remove_dir_all(at("o")).expect("there");
    std::fs::create_dir(at("frames")).expect("a folder");
    std::fs::copy(at("a.tif"), at("frames/f.tif")).expect("copied");
    folder
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.expect("readable").path();
        if path.is_dir() { found.extend(files_below(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

/// Every file that a command writes is in turn a second name, hard or soft, of every file that it reads: it is refused, and what
/// is read keeps its bytes. In part in `make test`: the first and the last file of each command.
#[test]
fn no_file_that_a_command_writes_is_one_that_it_reads() {
    let folder = everything();
    let dir = folder.path();
    let all = std::env::var_os("AUTOREF_LARGE").is_some();
    let out = dir.join("o");
    let (mut pairs, mut commands) = (0, 0);
    for case in CASES {
        let arguments: Vec<String> = case.line.split(' ').map(|word| word.replace(';', " ")).collect();
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
        }
        commands += 1;
        for (number, input) in case.inputs.iter().enumerate() {
            for (index, target) in written.iter().enumerate() {
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
    assert!(commands == CASES.len() && pairs >= if all { 150 } else { 50 }, "{commands} commands, {pairs} pairs");
}

/// A folder is replaced only when all in it is of an earlier comparison.
#[test]
fn a_comparison_clears_no_folder_of_other_things() {
    let folder = everything();
    let dir = folder.path();
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
    let job = format!("{binary} a.tif --gcps a.geojson --out r --overwrite --json --no-report");
    std::fs::create_dir(folder.path().join("r")).expect("a folder");
    let closed = shell(format!("set -o pipefail; {job} | true; exit ${{PIPESTATUS[0]}}"));
    let said = String::from_utf8_lossy(&closed.stderr).into_owned();
    assert!(!said.contains("panicked") && closed.status.code() == Some(0), "{:?} {said}", closed.status);
    let full = shell(format!("{job} > /dev/full"));
    let said = String::from_utf8_lossy(&full.stderr).into_owned();
    assert!(!said.contains("panicked") && full.status.code() == Some(2), "{:?} {said}", full.status);
}
