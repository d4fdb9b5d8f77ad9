//! What an old output has left beside it is not read with the new one. Every command of `commands::CASES` with
//! AUTOREF_LARGE=1; in `make test` those that write rasters and lines of two small models and a cloud.

use std::path::{Path, PathBuf};

use super::commands::{CASES, everything, program};
use super::faults::contents;
use super::orthorectify::write_dem;
use super::system_calls::{can_trace, run_words};
use crate::common::large;

const QUICK: &[&str] = &[
    "mosaic d1.tif d2.tif -o o/x.tif --write-index o/y.tif --overwrite",
    "dem align d1.tif --to d2.tif -o o/x.tif --method bias --overwrite",
    "dem hillshade d1.tif -o o/x.tif --overwrite",
    "dem slope d1.tif -o o/x.tif --compute-edges --overwrite",
    "dem resample d1.tif -o o/x{res}.tif --resolution 10,20 --overwrite",
    "dem contour d1.tif -o o/x.shp --interval 50 --overwrite",
    "dem contour d1.tif -o o/x.gpkg --interval 50 --overwrite",
    "cloud grid k.xyz -o o --cell 4 --overwrite",
    "gcps convert g.csv -o o/x.shp --overwrite",
    "synth o/x.tif --gcps g.csv --size 96x64 --overwrite",
];

fn small() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    for (name, lift) in [("d1.tif", 0.0), ("d2.tif", 1.5)] {
        let height = |x: f64, y: f64| 200.0 + 80.0 * ((x - 500_000.0) / 45.0).sin() + (7e6 - y) / 5.0 + lift;
        write_dem(&at(name), (60, 50), [500_000.0, 7_000_000.0], 5.0, height);
    }
    let cloud: String = (0..400).map(|i| format!("{} {} {}\n", i % 20, i / 20, 100 + i % 7)).collect();
    std::fs::write(at("k.xyz"), format!("x y z\n{cloud}")).expect("writable");
    std::fs::write(at("g.csv"), "name,easting,northing\nA,1,1\nB,2,1.5\n").expect("writable");
    std::fs::create_dir(at("o")).expect("a folder");
    folder
}

/// What GDAL would read with a file, but for what the command has written itself.
fn companions(file: &Path) -> Vec<PathBuf> {
    let appended = |end: &str| PathBuf::from(format!("{}{end}", file.display()));
    match file.extension().and_then(|end| end.to_str()) {
        Some("tif") => [".aux.xml", ".ovr", ".msk", ".msk.ovr"].map(appended).into(),
        Some("jpg" | "vrt") => vec![appended(".aux.xml"), appended(".ovr")],
        Some("shp") => ["qix", "sbn", "sbx"].map(|end| file.with_extension(end)).into(),
        Some("gpkg") => vec![appended("-wal"), appended("-journal")],
        _ => Vec::new(),
    }
}

#[test]
fn companions_of_an_old_output_go_with_it() {
    let (small, large_place) = (small(), large().then(everything));
    let dir = large_place.as_ref().map_or(small.path().to_owned(), |place| place.at(""));
    let of_large = CASES.iter().map(|case| case.line).filter(|line| line.contains("--overwrite"));
    let lines: Vec<&str> = if large() { of_large.collect() } else { QUICK.to_vec() };
    let out = dir.join("o");
    let names = || contents(&out, &[]).into_keys().collect::<Vec<_>>();
    let (mut count, mut bad) = (0, Vec::new());
    for line in lines {
        let words: Vec<String> = line.split(' ').map(|word| word.replace(';', " ")).collect();
        let run = |without: &str| {
            let words: Vec<&str> = words.iter().map(String::as_str).filter(|word| *word != without).collect();
            program(&dir, &words)
        };
        let _ = std::fs::remove_dir_all(&out);
        std::fs::create_dir(&out).expect("a folder");
        if !matches!(run("").status.code(), Some(0 | 1)) {
            bad.push(format!("{line}: fails in an empty folder"));
            continue;
        }
        let clean = names();
        let mains: Vec<PathBuf> =
            clean.iter().filter(|name| !companions(&out.join(name)).is_empty()).cloned().collect();
        let old: Vec<PathBuf> = mains.iter().flat_map(|name| companions(&out.join(name))).collect();
        let old: Vec<PathBuf> = old.into_iter().filter(|path| !path.exists()).collect();
        let lay = || old.iter().for_each(|path| std::fs::write(path, "old").expect("writable"));
        lay();
        std::fs::write(out.join("x.qml"), "a style").expect("writable");
        run("");
        count += old.len();
        let left: Vec<PathBuf> = names().into_iter().filter(|name| !clean.contains(name)).collect();
        // What replaces its folder whole is another thing.
        if !left.iter().all(|name| name == Path::new("x.qml")) {
            bad.push(format!("{line}: {left:?} are read with the new files"));
        }
        // Beside what is not there they stop a run that must replace nothing.
        let alone = mains.len() == 1 && words.iter().any(|word| Path::new(word).ends_with(&mains[0]));
        if alone && !line.starts_with("gcps convert") {
            clean.iter().for_each(|name| std::fs::remove_file(out.join(name)).expect("there"));
            old.iter().filter(|path| path.exists()).for_each(|path| std::fs::remove_file(path).expect("there"));
            lay();
            let refused = run("--overwrite");
            let said = String::from_utf8_lossy(&refused.stderr).into_owned();
            if refused.status.code() != Some(2) || !old.iter().any(|path| said.contains(&*file_name(path))) {
                bad.push(format!("{line}: left companions are no matter: {said}"));
            }
        }
    }
    eprintln!("{count} companions, {} things wrong", bad.len());
    assert!(count > 0 && bad.is_empty(), "{}", bad.join("\n"));
}

fn file_name(path: &Path) -> String {
    path.file_name().expect("a name").to_string_lossy().into_owned()
}

#[test]
fn an_input_that_would_belong_to_the_output_is_kept() {
    let place = small();
    let at = |name: &str| place.path().join("o").join(name);
    let model = std::fs::read(place.path().join("d1.tif")).expect("there");
    for (input, beside) in [("x.tif.ovr", None), ("x.tif.msk", Some("x.tif.msk.aux.xml"))] {
        std::fs::write(at(input), &model).expect("writable");
        beside.iter().for_each(|name| std::fs::write(at(name), "<PAMDataset/>").expect("writable"));
        let named = format!("o/{input}");
        let run = program(place.path(), &["dem", "slope", &named, "-o", "o/x.tif", "--overwrite"]);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(2), "{said}");
        assert!(said.contains("would belong to the output o/x.tif") && !at("x.tif").exists(), "{said}");
        assert!(at(input).exists() && beside.is_none_or(|name| at(name).exists()), "an input is gone");
        std::fs::remove_file(at(input)).expect("there");
    }
}

/// Killed at whatever moment, a run leaves no new raster that is read through what belonged to the old one, and the
/// next run makes up for it.
#[test]
fn no_kill_leaves_old_companions_beside_a_new_output() {
    if !can_trace() {
        return;
    }
    let place = small();
    let at = |name: &str| place.path().join("o").join(name);
    let companions = ["x.tif.aux.xml", "x.tif.msk"];
    for line in ["dem slope d1.tif -o o/x.tif --overwrite", "mosaic d1.tif -o o/x.tif --overwrite"] {
        let words: Vec<String> = line.split(' ').map(String::from).collect();
        let mut kills = 0;
        for number in 1.. {
            std::fs::write(at("x.tif"), "old").expect("writable");
            companions.iter().for_each(|name| std::fs::write(at(name), "old").expect("writable"));
            let fault = format!("inject=rename,renameat,renameat2,link,linkat:signal=KILL:when={number}");
            let ran = run_words(place.path(), &words, &["-e", &fault]);
            let is_new = std::fs::read(at("x.tif")).is_ok_and(|bytes| bytes != b"old");
            let beside = companions.iter().filter(|name| at(name).exists()).count();
            assert!(!is_new || beside == 0, "{line}, killed at file {number}: {beside} old companions");
            if ran.status.success() {
                break;
            }
            kills += 1;
            let next = program(place.path(), &line.split(' ').collect::<Vec<_>>());
            assert!(next.status.success(), "{line}: {}", String::from_utf8_lossy(&next.stderr));
            assert!(companions.iter().all(|name| !at(name).exists()), "{line}: the next run leaves companions");
        }
        assert!(kills > companions.len(), "{line}: {kills} kills");
    }
}
