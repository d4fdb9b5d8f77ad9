//! `cloud clean|grid|info` from the command line, on clouds that are made here: every format, every option, bad input.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_raster::crs::{Coordinate, Crs};
use serde_json::Value;

fn cloud(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).arg("cloud").args(arguments).output().expect("the program runs")
}

fn done(arguments: &[&str]) -> Value {
    let output = cloud(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Refused with one line that names `word`, and nothing is left behind.
fn refused(arguments: &[&str], word: &str, absent: &Path) {
    let output = cloud(arguments);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{arguments:?}: {text}");
    assert!(text.contains(word) && !text.contains("panicked"), "{arguments:?}: {text}");
    assert!(!absent.exists(), "{arguments:?}");
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }
    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
    fn put(&self, name: &str, content: impl AsRef<[u8]>) -> String {
        std::fs::write(self.at(name), content).expect("writable");
        self.text(name)
    }
    fn text(&self, name: &str) -> String {
        self.at(name).to_str().expect("UTF-8").to_string()
    }
}

/// A name that is no UTF-8 is a name.
#[test]
fn clouds_with_odd_names_are_told_in_json() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let folder = Folder::new();
    let (odd, out) = (folder.0.path().join(OsStr::from_bytes(b"l\xf8.xyz")), folder.at("grids"));
    std::fs::write(&odd, "0 0 1\n1 0 2\n0 1 3\n1 1 4\n").expect("writable");
    let run = |words: &[&OsStr]| {
        let output = Command::new(env!("CARGO_BIN_EXE_autoref-stream")).arg("cloud").args(words).output();
        let output = output.expect("the program runs");
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{words:?}: {told}");
        serde_json::from_slice::<Value>(&output.stdout).expect("JSON")
    };
    let told = run(&["info".as_ref(), odd.as_ref(), "--json".as_ref()]);
    assert_eq!(told["clouds"][0]["points"], 4);
    let words = ["grid", "-o", out.to_str().expect("UTF-8"), "--cell", "1", "--json"].map(OsStr::new);
    let told = run(&[&words[..], &[odd.as_ref()]].concat());
    assert!(told["files_written"].as_array().is_some_and(|files| !files.is_empty()), "{told}");
}

/// Gentle ground, 20 × 20 m, with a point 30 m above it.
fn ground() -> Vec<[f32; 3]> {
    let mut points = Vec::new();
    for i in 0..400u16 {
        let (x, y) = (f32::from(i % 20) + 0.25, f32::from(i / 20) + 0.5);
        points.push([x, y, 100.0 + 0.05 * x + f32::from(i * 7 % 5) * 0.01]);
    }
    points[210][2] = 130.0;
    points
}

#[derive(Clone, Copy, PartialEq)]
enum Order {
    Little,
    Big,
    Text,
}

/// As MicMac writes: float coordinates, normals, colours, faces behind them.
fn ply(points: &[[f32; 3]], order: Order) -> Vec<u8> {
    let name = match order {
        Order::Little => "binary_little_endian",
        Order::Big => "binary_big_endian",
        Order::Text => "ascii",
    };
    let mut out = format!(
        "ply\nformat {name} 1.0\ncomment made here\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 0\n\
         property list uchar int vertex_indices\nend_header\n",
        points.len()
    )
    .into_bytes();
    for (index, point) in points.iter().enumerate() {
        let colour = [10, 20, (index % 256) as u8];
        let numbers = [point[0], point[1], point[2], 0.5];
        match order {
            Order::Text => {
                let words: Vec<String> =
                    numbers.iter().map(f32::to_string).chain(colour.iter().map(u8::to_string)).collect();
                out.extend_from_slice((words.join(" ") + "\n").as_bytes());
            }
            Order::Little => numbers.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes())),
            Order::Big => numbers.iter().for_each(|v| out.extend_from_slice(&v.to_be_bytes())),
        }
        if order != Order::Text {
            out.extend_from_slice(&colour);
        }
    }
    out
}

fn info(path: &str) -> Value {
    done(&["info", path, "--json"])["clouds"][0].clone()
}

#[test]
fn every_order_of_ply_becomes_the_same_cloud_and_keeps_what_it_carries() {
    let folder = Folder::new();
    let mut classes = Vec::new();
    for (name, order) in [("le.ply", Order::Little), ("be.ply", Order::Big), ("as.ply", Order::Text)] {
        let path = folder.put(name, ply(&ground(), order));
        for out in ["out.laz", "out.las", "out.ply"] {
            let out = folder.text(out);
            let report = done(&[
                "clean",
                &path,
                "-o",
                &out,
                "--shift",
                "600000,8600000,0",
                "--z",
                "-50,716",
                "--outliers",
                "k=8,m=2",
                "--ground",
                "--overwrite",
                "--json",
            ]);
            let steps = report["steps"].as_array().expect("steps");
            let names: Vec<&str> = steps.iter().filter_map(|s| s["step"].as_str()).collect();
            assert_eq!(names, ["z", "outliers", "ground"], "the order of the command line");
            for key in ["points_in", "classified", "dropped"] {
                assert!(steps[1][key].is_u64(), "{key}");
            }
            let found = info(&out);
            assert_eq!(found["points"], 400);
            let dimensions = found["dimensions"].to_string();
            for dimension in ["nx", "red", "green", "blue", "classification"] {
                assert!(dimensions.contains(dimension), "{out}: {dimensions}");
            }
            classes.push(found["classes"].to_string());
        }
    }
    assert!(classes[0].contains('7') && classes.iter().all(|c| *c == classes[0]), "{classes:?}");
}

#[test]
fn what_las_knows_goes_to_its_own_place() {
    let folder = Folder::new();
    let head = "ply\nformat ascii 1.0\ncomment crs EPSG:25833\nelement vertex 3\nproperty double x\nproperty double y\n\
                property double z\nproperty uchar return_number\nproperty uchar number_of_returns\n\
                property ushort point_source_id\nproperty float scan_angle\nproperty uchar withheld\n\
                property ushort intensity\nproperty uchar classification\nend_header\n";
    let rows = "1.2 1.2 1 2 3 77 -12 1 70 2\n2.4 1.1 2 1 3 78 30 0 80 1\n1.3 2.2 3 3 3 79 0 0 90 5\n";
    let path = folder.put("a.ply", format!("{head}{rows}"));
    let (las, back) = (folder.text("a.las"), folder.text("b.ply"));
    done(&["clean", &path, "-o", &las, "--z=-9,9", "--json"]);
    let found = info(&las);
    let dimensions: Vec<&str> = found["dimensions"]
        .as_array()
        .expect("names")
        .iter()
        .filter_map(|d| d["name"].as_str().or(d.as_str()))
        .collect();
    for name in ["return_number", "point_source_id", "scan_angle", "withheld"] {
        assert_eq!(dimensions.iter().filter(|d| **d == name).count(), 1, "{dimensions:?}");
    }
    assert!(found["crs"].to_string().contains("25833"), "{found}");
    let grids = folder.text("grids");
    done(&[
        "grid",
        &las,
        "-o",
        &grids,
        "--cell",
        "1",
        "--stat",
        "max",
        "--dimension",
        "return_number,point_source_id,withheld",
        "--keep-noise",
        "--json",
    ]);
    let values = |name: &str| -> Vec<f64> {
        let set = gdal::Dataset::open(folder.at("grids").join(name)).expect("a grid");
        let size = set.raster_size();
        let band = set.rasterband(1).expect("a band");
        band.read_as::<f64>((0, 0), size, size, None).expect("values").data().to_vec()
    };
    let has = |name: &str, wanted: f64| assert!(values(name).contains(&wanted), "{name}: {:?}", values(name));
    has("a_return_number_max.tif", 3.0);
    has("a_point_source_id_max.tif", 79.0);
    has("a_withheld_max.tif", 1.0);
    done(&["clean", &las, "-o", &back, "--z=-9,9", "--json"]);
    let text = std::fs::read(folder.at("b.ply")).expect("written");
    assert!(String::from_utf8_lossy(&text).contains("comment crs EPSG:25833\n"));
    // What has no room is refused, not cut.
    let wide = folder.put("wide.xyz", "x y z user_data\n1 1 1 70000\n2 2 2 5\n");
    refused(&["clean", &wide, "-o", &folder.text("wide.las"), "--z=-9,9"], "70000", &folder.at("wide.las"));
    let twice = folder.put("twice.xyz", "x y z z\n1 2 3 1\n");
    refused(&["clean", &twice, "-o", &folder.text("t.ply"), "--z=-9,9"], "there twice", &folder.at("t.ply"));
}

#[test]
fn crops_cameras_and_several_clouds_and_resume() {
    let folder = Folder::new();
    let (a, b) = (folder.put("a.ply", ply(&ground(), Order::Little)), folder.put("b.ply", ply(&ground(), Order::Big)));
    // A square with a hole in it, in map coordinates; the cloud is shifted.
    let crop = folder.put(
        "crop.geojson",
        r#"{"type":"FeatureCollection","features":[{"type":"Feature","properties":{},"geometry":{"type":"Polygon",
        "coordinates":[[[600000,8600000],[600010,8600000],[600010,8600010],[600000,8600010],[600000,8600000]],
        [[600004,8600004],[600006,8600004],[600006,8600006],[600004,8600006],[600004,8600004]]]}}]}"#,
    );
    let out = folder.text("cropped.laz");
    let shift = ["--shift", "600000,8600000,0"];
    let report = done(&[&["clean", &a, "-o", &out, "--crop", &crop, "--drop", "noise", "--json"], &shift[..]].concat());
    assert_eq!(report["points_kept"], 96, "10 × 10 points less 2 × 2");
    // The same square in degrees, for a cloud whose reference system is known; and the map's coordinates still.
    let zone = Crs::parse("EPSG:32633").expect("a zone");
    let corner = |x: f64, y: f64| {
        let mut place = [Coordinate { x: 600_000.0 + x, y: 8_600_000.0 + y, height: None }];
        let world = Crs::from_epsg(4326).expect("the world");
        zone.transform(&mut place, &world, 2.0).expect("a place on the Earth");
        format!("[{:.9},{:.9}]", place[0].x, place[0].y)
    };
    let ring = |low: f64, high: f64| {
        let corners = [(low, low), (high, low), (high, high), (low, high), (low, low)];
        corners.map(|(x, y)| corner(x, y)).join(",")
    };
    let degrees = folder.put(
        "degrees.geojson",
        format!(
            r#"{{"type":"FeatureCollection","features":[{{"type":"Feature","properties":{{}},"geometry":
            {{"type":"Polygon","coordinates":[[{}],[{}]]}}}}]}}"#,
            ring(-0.01, 10.01),
            ring(3.99, 6.01)
        ),
    );
    for crop in [&crop, &degrees] {
        let how = ["clean", &a, "-o", &out, "--crop", crop, "--drop", "noise", "--crs", "EPSG:32633", "--overwrite"];
        let report = done(&[&how[..], &["--json"], &shift[..]].concat());
        assert_eq!(report["points_kept"], 96, "{crop}");
    }

    // The parts of one geometry may overlap.
    let twice = folder.put(
        "twice.geojson",
        r#"{"type":"FeatureCollection","features":[{"type":"Feature","properties":{},"geometry":
        {"type":"GeometryCollection","geometries":[{"type":"Polygon","coordinates":
        [[[600000,8600000],[600006,8600000],[600006,8600004],[600000,8600004],[600000,8600000]]]},
        {"type":"Polygon","coordinates":
        [[[600004,8600000],[600010,8600000],[600010,8600004],[600004,8600004],[600004,8600000]]]}]}}]}"#,
    );
    let how = ["clean", &a, "-o", &out, "--crop", &twice, "--drop", "noise", "--overwrite", "--json"];
    assert_eq!(done(&[&how[..], &shift[..]].concat())["points_kept"], 40);

    // Cameras in map coordinates; that of `b` sees nothing: its height over z = 0 is 5 m.
    let cameras = folder.put("cameras.csv", "cloud,E,N,H\na,600010,8600010,3000\nb.ply,600010,8600010,5\n");
    let many = folder.text("many");
    let arguments =
        [&["clean", &a, &b, "-o", &many, "--range-from", &cameras, "--drop", "noise", "--json"], &shift[..]].concat();
    let report = done(&arguments);
    assert_eq!(report["clouds"][0]["points_kept"], 400);
    assert_eq!(report["clouds"][1]["points_kept"], 0);
    assert!(folder.at("many/a.laz").is_file() && folder.at("many/b.clean.html").is_file());
    // Without --overwrite an output is left alone; --resume takes what is done.
    refused(&arguments, "exists", &folder.at("none"));
    let before = std::fs::metadata(folder.at("many/a.laz")).expect("there").modified().expect("a time");
    let again = done(&[&arguments[..], &["--resume"]].concat());
    assert_eq!(again["clouds"][0]["points_kept"], 400);
    assert_eq!(before, std::fs::metadata(folder.at("many/a.laz")).expect("there").modified().expect("a time"));
    // Neither what another table says nor a cut file is what is done.
    folder.put("cameras.csv", "cloud,E,N,H\na,600010,8600010,5\nb.ply,600010,8600010,5\n");
    let again = done(&[&arguments[..], &["--resume", "--overwrite"]].concat());
    assert_eq!(again["clouds"][0]["points_kept"], 0);
    let cut = &std::fs::read(folder.at("many/b.laz")).expect("there")[..100];
    std::fs::write(folder.at("many/b.laz"), cut).expect("writable");
    done(&[&arguments[..], &["--resume", "--overwrite"]].concat());
    let whole = std::fs::read(folder.at("many/b.laz")).expect("there");
    assert!(whole.len() > 100);
    // Nor is one of which a byte has changed.
    let mut changed = whole.clone();
    changed[30] ^= 1;
    std::fs::write(folder.at("many/b.laz"), changed).expect("writable");
    done(&[&arguments[..], &["--resume", "--overwrite"]].concat());
    assert_eq!(std::fs::read(folder.at("many/b.laz")).expect("there"), whole);
    let lonely = folder.put("lonely.ply", ply(&ground(), Order::Text));
    refused(&["clean", &lonely, "-o", &folder.text("l.laz"), "--range-from", &cameras], "no row", &folder.at("l.laz"));
}

#[test]
fn bad_clouds_are_refused_in_one_line() {
    let folder = Folder::new();
    let out = folder.text("out.laz");
    let whole = ply(&ground(), Order::Little);
    let refuse = |name: &str, content: &[u8], word: &str| {
        let path = folder.put(name, content);
        refused(&["clean", &path, "-o", &out, "--outliers", "--ground"], word, &folder.at("out.laz"));
        let grids = folder.text("grids");
        refused(&["grid", &path, "-o", &grids], word, &folder.at("grids/none"));
    };
    refuse("cut.ply", &whole[..whole.len() - 500], "truncated");
    refuse("head.ply", &whole[..60], "PLY header");
    refuse("none.ply", &ply(&[], Order::Little), "there are none");
    refuse("nan.ply", &ply(&[[0.0; 3], [f32::NAN, 1.0, 1.0], [1.0, 2.0, f32::INFINITY]], Order::Big), "not finite");
    refuse("empty.las", b"", "empty");
    refuse("words.xyz", b"x y z\n1 2 3\n4 five 6\n", "five");
    refuse("e57.e57", b"ASTM-E57 and more", "E57 header");
    // A LAS file with its scale set to 0, and cut files.
    let las = folder.text("good.las");
    done(&["clean", &folder.put("plain.ply", &whole), "-o", &las, "--json"]);
    let good = std::fs::read(&las).expect("readable");
    let mut bad = good.clone();
    bad[131..139].copy_from_slice(&0f64.to_le_bytes());
    refuse("scale.las", &bad, "scale factor of x is 0");
    refuse("cut.las", &good[..good.len() - 10], "truncated");
    refuse("short.las", &good[..100], "no whole header");
    let laz = folder.text("packed.laz");
    done(&["clean", &folder.text("plain.ply"), "-o", &laz, "--json"]);
    let packed = std::fs::read(&laz).expect("readable");
    refuse("cut.laz", &packed[..packed.len() / 2], "cut.laz");
    // Where the points begin stands in the header, and there where the chunks are listed.
    let begin = u32::from_le_bytes(packed[96..100].try_into().expect("four bytes")) as usize;
    let mut astray = packed.clone();
    astray[begin..begin + 8].copy_from_slice(&(1i64 << 46).to_le_bytes());
    refuse("astray.laz", &astray, "chunk table");
    // One point far away would round all others to metres in LAS; PLY holds them.
    let far = folder.put("far.csv", "x,y,z\n639940.25,485150.5,84.1\n639941.5,485151.25,84.2\n1e10,485152,85\n");
    refused(&["clean", &far, "-o", &out], "LAS would round them", &folder.at("out.laz"));
    done(&["clean", &far, "-o", &folder.text("far.ply"), "--json"]);
    // Dropped, it has no say: steps are as fine as ever.
    let fine = folder.text("fine.las");
    done(&["clean", &far, "-o", &fine, "--z", "84,84.9", "--drop", "noise", "--json"]);
    let head = std::fs::read(&fine).expect("readable");
    assert!(f64::from_le_bytes(head[131..139].try_into().expect("eight bytes")) <= 1e-4);
    for seed in 0..crate::common::trials(14, 40) {
        let mut broken = packed.clone();
        for k in 0..3 {
            let at = (seed * 7919 + k * 104_729) % broken.len();
            broken[at] = broken[at].wrapping_add(1 + (seed * 31 % 254) as u8);
        }
        let path = folder.put("broken.laz", &broken);
        let output = cloud(&["info", &path]);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 2)) && !text.contains("panicked"), "{seed}: {text}");
    }
    // All at one place: no distance tells anything.
    let same = folder.put("same.ply", ply(&[[5.0; 3]; 50], Order::Little));
    refused(&["clean", &same, "-o", &out, "--outliers"], "one place", &folder.at("out.laz"));
    // Points that are not finite can be left out on request.
    let nan = folder.text("nan.ply");
    let kept = done(&["clean", &nan, "-o", &folder.text("kept.laz"), "--outliers", "--skip-invalid", "--json"]);
    assert_eq!(kept["points_kept"], 1);
}

#[test]
fn options_that_make_no_sense_name_their_remedy() {
    let folder = Folder::new();
    let path = folder.put("a.ply", ply(&ground(), Order::Little));
    let out = folder.text("out.laz");
    for (option, value, word) in [
        ("--outliers", "k=0", "k"),
        ("--outliers", "k=2,m=nan", "nan"),
        ("--radius", "r=inf", "inf"),
        ("--z", "5,1", "above"),
        ("--ground", "cell=0", "cell"),
        ("--ground", "cell=1e-9", "window"),
        ("--ground", "cell=1e-6,window=1e-5", "wider cell"),
        ("--ground", "window=1e9", "window"),
        ("--low", "foo", "foo"),
        ("--drop", "tree", "tree"),
        ("--range-from", "1,2,-5", "height"),
        ("--range-from", "1,2", "E,N,H"),
        ("--crop", "nowhere.gpkg", "no such file"),
        ("--crop", &path, "vector"),
    ] {
        refused(&["clean", &path, "-o", &out, option, value], word, &folder.at("out.laz"));
    }
    refused(&["clean", &path, "-o", &folder.text("a.laz"), "--copc"], "copc.laz", &folder.at("a.laz"));
    refused(&["clean", &path, &path, "-o", &folder.text("f")], "both", &folder.at("f/a.laz"));
}

#[test]
fn wide_and_thin_clouds_end_soon() {
    // Forty points over 4 × 4 km: nearly all of four million cells are a hole.
    let folder = Folder::new();
    let mut text = String::new();
    for i in 0..40 {
        text += &format!("{} {} {}\n", i * 677 % 4001, i * 1231 % 3999, i * 13 % 7);
    }
    let path = folder.put("thin.xyz", text);
    let report = done(&["clean", &path, "-o", &folder.text("out.laz"), "--ground", "cell=8", "--json"]);
    assert_eq!(report["points_kept"], 40);
}

#[test]
fn tables_are_read_as_programs_write_them() {
    let folder = Folder::new();
    for (name, text) in [
        ("ends.csv", "X;Y;Z;Intensity;\n1,5;2;3;9;\n4;5;6;8;\n"),
        ("remark.xyz", "# flown in 2017, 2 lines\n1.5 2 3 9\n4 5 6 8\n"),
        ("sentence.xyz", "# x y and z in metres\n# metres\n1.5 2 3 9\n4 5 6 8\n"),
        ("compare.txt", "//X Y Z Intensity\n1.5 2 3 9\n// half way\n4 5 6 8\n"),
        ("hash.txt", "#x,y,z,intensity\n1.5,2,3,9\n4,5,6,8\n"),
    ] {
        let path = folder.put(name, text);
        let out = folder.text("out.ply");
        let report = done(&["clean", &path, "-o", &out, "--json", "--overwrite"]);
        assert_eq!(report["points_kept"], 2, "{name}");
        let head = std::fs::read(&out).expect("written");
        let named = String::from_utf8_lossy(&head).contains(" intensity\n");
        assert_eq!(named, !text.starts_with("# "), "{name}: a head is read, a sentence is none");
    }
}

/// Inverse distance by the formula, whatever the cell and the power: sums of small weights lose nothing.
#[test]
fn inverse_distances_are_those_of_the_formula() {
    let folder = Folder::new();
    let points = ground();
    let path = folder.put("a.ply", ply(&points, Order::Little));
    for (cell, power) in [(2.0f64, 1.0f64), (2.0, 3.0), (2.0, 10.0), (400.0, 2.0), (400.0, 4.0)] {
        let radius = 0.75 * cell;
        let [cell_m, exponent, radius_m] = [cell, power, radius].map(|v| v.to_string());
        let how = ["grid", &path, "-o", &folder.text("idw"), "--cell", &cell_m, "--power", &exponent, "--stat", "idw"];
        done(&[&how[..], &["--radius", &radius_m, "--fill", "0", "--overwrite", "--json"]].concat());
        let dataset = gdal::Dataset::open(folder.at("idw/a_z_idw.tif")).expect("a grid");
        let (width, height) = dataset.raster_size();
        let transform = dataset.geo_transform().expect("a geotransform");
        let band = dataset.rasterband(1).expect("a band");
        let values = band.read_as::<f64>((0, 0), (width, height), (width, height), None).expect("values");
        let mut told = 0;
        for (i, value) in values.data().iter().enumerate().filter(|(_, value)| value.is_finite() && **value != -9999.0)
        {
            let (x, y) =
                (transform[0] + cell * ((i % width) as f64 + 0.5), transform[3] - cell * ((i / width) as f64 + 0.5));
            let (mut sum, mut weights) = (0.0, 0.0);
            for [px, py, pz] in points.iter().map(|point| point.map(f64::from)) {
                let distance = (px - x).hypot(py - y);
                if distance < radius {
                    sum += pz * distance.powf(-power);
                    weights += distance.powf(-power);
                }
            }
            assert!((value - sum / weights).abs() < 1e-4, "{cell} m, power {power}: {value}, {}", sum / weights);
            told += 1;
        }
        assert!(told > 0, "{cell} m, power {power}");
    }
    for power in ["0", "inf", "nan", "11"] {
        refused(&["grid", &path, "-o", &folder.text("no"), "--power", power], "--power", &folder.at("no"));
    }
}

#[test]
fn grids_have_their_names_and_every_statistic() {
    let folder = Folder::new();
    let path = folder.put("a.ply", ply(&ground(), Order::Little));
    let grids = folder.text("grids");
    done(&[
        "grid",
        &path,
        "-o",
        &grids,
        "--cell",
        "2",
        "--stat",
        "mean,median,min,max,count,stdev,idw",
        "--dimension",
        "z,range,red",
        "--radius",
        "z=2.828,range=1.414",
        "--range-from",
        "600010,8600010,3000",
        "--shift",
        "600000,8600000,0",
        "--json",
    ]);
    for dimension in ["z", "range", "red"] {
        for stat in ["mean", "median", "min", "max", "count", "stdev", "idw", "filled"] {
            let name = format!("grids/a_{dimension}_{stat}.tif");
            let dataset = gdal::Dataset::open(folder.at(&name)).unwrap_or_else(|e| panic!("{name}: {e}"));
            let transform = dataset.geo_transform().expect("a geotransform");
            assert_eq!((transform[0], transform[1], transform[3]), (600_000.0, 2.0, 8_600_020.0), "{name}");
        }
    }
}

/// Tables that hold colours of 8 bits become those of 16 bits that LAS has, as such a PLY does; larger ones stay.
#[test]
fn colours_of_tables_are_spread_over_sixteen_bits() {
    let folder = Folder::new();
    let red = |name: &str, content: &str| {
        let (cloud, las, out) = (folder.put(name, content), folder.text(&format!("{name}.las")), folder.text("grid"));
        done(&["clean", &cloud, "-o", &las, "--json"]);
        let words = ["grid", &las, "-o", &out, "--cell", "10", "--dimension", "red", "--stat", "max", "--json"];
        done(&[&words[..], &["--overwrite"]].concat());
        let grid = folder.at("grid").join(format!("{name}_red_max.tif"));
        let band = gdal::Dataset::open(grid).expect("a grid");
        let band = band.rasterband(1).expect("a band").read_band_as::<f64>().expect("values");
        band.data().iter().copied().filter(|v| *v > -9999.0).fold(0.0, f64::max)
    };
    assert_eq!(red("a.pts", "2\n1 2 3 100 10 20 255\n2 3 4 50 200 7 0\n"), 51_400.0);
    assert_eq!(red("b.csv", "X,Y,Z,R,G,B\n1,2,3,10,20,255\n2,3,4,200,7,0\n"), 51_400.0);
    assert_eq!(red("c.csv", "X,Y,Z,R,G,B\n1,2,3,10,20,255\n2,3,4,200,7,40000\n"), 200.0);
}
