//! Every command that writes files, with what it reads: for the tests of inputs that are no outputs and of faults on
//! the way.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_synth::{SynthSpec, random_gcps};

use super::flight::Place;
use super::orthorectify::write_dem;

/// The program in `folder`, where a stand-in for COLMAP may lie in `bin`; its scratch files go to `tmp` beside it, when
/// that is there.
pub(super) fn command(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
    surround(&mut command, folder);
    command
}

/// Folder and environment of [`command`] for whatever starts the program.
pub(super) fn surround(command: &mut Command, folder: &Path) {
    let path = std::env::var("PATH").unwrap_or_default();
    command.current_dir(folder).env("PATH", format!("{}:{path}", folder.join("bin").display()));
    if folder.join("tmp").is_dir() {
        command.env("TMPDIR", folder.join("tmp"));
    }
}

pub(super) fn program(folder: &Path, arguments: &[&str]) -> Output {
    command(folder).args(arguments).output().expect("the program starts")
}

/// A small image with its list, candidates, profile and accuracy file.
pub(super) fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    furnish(folder.path());
    folder
}

fn furnish(folder: &Path) {
    let spec = SynthSpec { gcps: random_gcps(6, 12.0, 9.0, 4), size_px: Some((480, 360)), ..SynthSpec::default() };
    autoref_synth::write(&spec, &folder.join("a.tif")).expect("a sample");
    autoref_synth::write_gcp_geojson(&folder.join("a.geojson"), &spec.gcps, Some(32632)).expect("a list");
    let detect = program(folder, &["detect", "a.tif", "-o", "c.csv"]);
    assert!(detect.status.success(), "{}", String::from_utf8_lossy(&detect.stderr));
    let profile = std::fs::read(crate::common::root().join("src/profile/builtin/orange.toml")).expect("shipped");
    std::fs::write(folder.join("p.toml"), profile).expect("writable");
}

/// A command that writes under `o/`, and what it reads.
pub(super) struct Case {
    pub(super) line: &'static str,
    pub(super) inputs: &'static [&'static str],
}

impl Case {
    /// Too slow, or of too slow inputs, for `make test`.
    pub(super) fn is_slow(&self) -> bool {
        ["fiducials", "flight solve", "flight orthorectify", "flight click", "synth-f", "selftest"]
            .iter()
            .any(|word| self.line.starts_with(word))
    }

    /// The words of the line; `;` stands for a space within one.
    pub(super) fn arguments(&self) -> Vec<String> {
        self.line.split(' ').map(|word| word.replace(';', " ")).collect()
    }
}

pub(super) const CASES: &[Case] = &[
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
    // By the method that learns nothing: the files are the same.
    Case { line: "mask a.tif -o o --method threshold --overwrite", inputs: &["a.tif"] },
    Case { line: "mask frames -o o --method threshold --overwrite", inputs: &["frames/f.tif"] },
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
    Case { line: "gcps convert a.geojson -o o/x.gpkg --overwrite", inputs: &["a.geojson"] },
    Case { line: "gcps convert a.geojson -o o/x.geojson --overwrite", inputs: &["a.geojson"] },
    Case {
        line: "a.tif --gcps a.geojson --out o --no-report --write world,aux,vrt,gcps,points,gcp-list,geojson,micmac,metashape,pix4d --overwrite",
        inputs: &["a.tif", "a.geojson"],
    },
    Case { line: "cloud clean k.xyz --out o/x.laz --outliers 8,2 --overwrite", inputs: &["k.xyz"] },
    Case { line: "cloud clean k.xyz --out o/x.ply --outliers 8,2 --overwrite", inputs: &["k.xyz"] },
    Case { line: "dem slope d1.tif --out o/x.tif --overwrite", inputs: &["d1.tif"] },
    Case { line: "dem aspect d1.tif --out o/x.tif --overwrite", inputs: &["d1.tif"] },
    Case { line: "dem roughness d1.tif --out o/x.tif --overwrite", inputs: &["d1.tif"] },
    Case { line: "dem tri d1.tif --out o/x.tif --overwrite", inputs: &["d1.tif"] },
    Case { line: "dem tpi d1.tif --out o/x.tif --overwrite", inputs: &["d1.tif"] },
    Case {
        line: "mosaic d1.tif d2.tif --out o/x.tif --balance --balance-page o/x.html --overwrite",
        inputs: &["d1.tif", "d2.tif"],
    },
    Case {
        line: "fiducials film/wild-15-4-1.tif --camera wild-15-4 -o o --exports",
        inputs: &["film/wild-15-4-1.tif"],
    },
    Case {
        line: "fiducials film/wild-15-4-1.tif --camera wild-15-4 -o o --resample --overwrite",
        inputs: &["film/wild-15-4-1.tif"],
    },
    Case {
        line: "flight init frames5 --cameras table.csv --gcps gcps.txt --crs local --f-px 500 -o o/FLIGHT.toml --overwrite",
        inputs: &["table.csv", "gcps.txt"],
    },
    Case { line: "flight solve FLIGHT.toml -o o --overwrite", inputs: &["FLIGHT.toml", "gcps.txt", "frames5/f0.png"] },
    Case {
        line: "flight adjust model --gcps gcps.txt --crs local -o o/x.json --overwrite",
        inputs: &["model/images.txt", "gcps.txt"],
    },
    Case {
        line: "flight resect f0.png --gcps gcps.txt --crs local --f-px 500 --size 480,480 -o o/x.json --overwrite",
        inputs: &["gcps.txt"],
    },
    Case { line: "flight export FLIGHT.toml -o o --overwrite", inputs: &["FLIGHT.toml", "gcps.txt", "table.csv"] },
    Case { line: "flight click FLIGHT.toml -o o --overwrite", inputs: &["FLIGHT.toml", "frames5/f0.png"] },
    Case {
        line: "flight orthorectify frames5/f2.png --dem d3.tif --cameras cameras.json -o o/x.tif --overwrite",
        inputs: &["frames5/f2.png", "d3.tif", "cameras.json"],
    },
    Case { line: "synth-film o --camera camera.toml --pixel-um 160 --overwrite", inputs: &["camera.toml"] },
    Case {
        line: "synth-flight o --dem d1.tif --lines 1 --frames 1 --size 64,48 --f-px 60 --height 300 --samples 1 --overwrite",
        inputs: &["d1.tif"],
    },
    Case {
        line: "selftest a.tif --profile p.toml --sizes 12 --marks 4 --profile-json o/x.json",
        inputs: &["a.tif", "p.toml"],
    },
    Case { line: "compare-solvers a.tif --gcps a.geojson --profile-json o/x.json", inputs: &["a.tif", "a.geojson"] },
    // The image is found beside the result.
    Case { line: "apply r.json --out o --write csv,warp --overwrite", inputs: &["r.json", "a.tif"] },
    Case {
        line: "a.jpg --gcps a.geojson --out o --write exif --no-report --overwrite",
        inputs: &["a.jpg", "a.geojson"],
    },
    Case {
        line: "a.tif --gcps a.geojson --dem grid.tif --write-dem o/dem.tif --out o --no-report --overwrite",
        inputs: &["a.tif", "a.geojson", "grid.tif"],
    },
    Case { line: "mask a.tif -o o --probability --explain --colmap --overwrite", inputs: &["a.tif"] },
    Case { line: "gcps convert a.geojson -o o/x.shp --overwrite", inputs: &["a.geojson"] },
    Case { line: "cloud clean k.xyz k2.xyz --out o --overwrite", inputs: &["k.xyz", "k2.xyz"] },
    Case { line: "cloud clean k.xyz --out o/x.copc.laz --overwrite", inputs: &["k.xyz"] },
    Case { line: "dem resample d1.tif --out o/x{res}.tif --resolution 10,20 --overwrite", inputs: &["d1.tif"] },
];

/// Two elevation models, a cloud, a table of colours, a list as CSV, a result and a folder of frames beside the rest.
pub(super) fn everything() -> Place {
    let folder = Place::new();
    let at = |name: &str| folder.at(name);
    furnish(&at(""));
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
    for name in ["k.xyz", "k2.xyz"] {
        std::fs::write(at(name), format!("x y z\n{cloud}")).expect("writable");
    }
    let jpeg = gdal::DriverManager::get_driver_by_name("JPEG").expect("GDAL has it");
    let image = gdal::Dataset::open(at("a.tif")).expect("an image");
    image.create_copy(&jpeg, at("a.jpg"), &gdal::cpl::CslStringList::new()).expect("a copy");
    let (width, height) = image.raster_size();
    driver.create_with_band_type::<f32, _>(at("grid.tif"), width, height, 1).expect("writable");
    let _ = std::fs::remove_file(at("a.jpg.aux.xml"));
    std::fs::write(at("t.txt"), "90 0 0 255\n300 255 0 0\n").expect("writable");
    std::fs::write(at("g.csv"), "name,easting,northing\nA,1,1\nB,2,1.5\n").expect("writable");
    std::fs::create_dir(at("o")).expect("a folder");
    let job = program(&at(""), &["a.tif", "--gcps", "a.geojson", "--out", "o", "--no-report"]);
    assert!(job.status.success(), "{}", String::from_utf8_lossy(&job.stderr));
    std::fs::rename(at("o/a.autoref.json"), at("r.json")).expect("written");
    std::fs::remove_dir_all(at("o")).expect("there");
    flights(&folder);
    std::fs::create_dir(at("frames")).expect("a folder");
    std::fs::copy(at("a.tif"), at("frames/f.tif")).expect("copied");
    folder
}

/// Film, frames of a flight with its project, a model and cameras, an elevation model below, and a stand-in for COLMAP.
fn flights(place: &Place) {
    let done = |line: &str| {
        let run = program(&place.at(""), &line.split(' ').collect::<Vec<_>>());
        assert!(run.status.success(), "{line}: {}", String::from_utf8_lossy(&run.stderr));
    };
    std::fs::copy(crate::common::root().join("crates/film/src/cameras/wild-15-4.toml"), place.at("camera.toml"))
        .expect("copied");
    if crate::common::large() {
        done("synth-film film --camera wild-15-4 --pixel-um 160");
    }
    place.five_frames();
    std::fs::rename(place.at("frames"), place.at("frames5")).expect("moved");
    place.flight.write_model(&place.at("model"));
    place.stand_in();
    done("flight init frames5 --cameras table.csv --gcps gcps.txt --crs local --f-px 500 -o FLIGHT.toml");
    done("flight adjust model --gcps gcps.txt --crs local -o cameras.json");
    write_dem(&place.at("d3.tif"), (80, 50), [800.0, 2250.0], 10.0, |x, y| 0.01 * x + 0.02 * y);
    std::fs::create_dir(place.at("tmp")).expect("a folder");
}

pub(super) fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.expect("readable").path();
        if path.is_dir() { found.extend(files_below(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}
