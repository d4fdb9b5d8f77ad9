//! One solve, all dialects: those that carry the transform put every pixel on the same ground, those that carry tie
//! points return exactly the pairs, each read back by its own rules.

use std::path::{Path, PathBuf};
use std::process::{Command, Output as Finished};

use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use autoref_stream::gcp::{self, GcpList, GcpOptions, GcpRole};
use autoref_stream::georef::output::Output;
use autoref_synth::{self as synth, Compression, MarkSize, MarkStyle, SynthSpec, Visible};
use serde_json::Value;

struct Solved {
    folder: tempfile::TempDir,
    result: Value,
}

const CHECK: &str = "P3,P5";

impl Solved {
    /// A sample image (rotated or north-up), its list with heights, and one run that writes every dialect.
    fn new(rotation_deg: f64) -> Solved {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut gcps = synth::random_gcps(12, 20.0, 16.0, 11);
        for (i, gcp) in gcps.iter_mut().enumerate() {
            gcp.name = format!("P{}", i + 1);
            gcp.height = Some(80.0 + 0.137 * i as f64);
        }
        let mut spec = SynthSpec {
            gcps,
            size_px: Some((750, 600)),
            rotation_deg,
            visible: Visible::All,
            mark: MarkStyle { size: MarkSize::Px(14.0), ..MarkStyle::default() },
            ..SynthSpec::default()
        };
        spec.output.compression = Compression::Deflate;
        synth::write(&spec, &folder.path().join("e6.tif")).expect("a sample");
        synth::write_gcp_geojson(&folder.path().join("e6.geojson"), &spec.gcps, Some(25832)).expect("a list");
        let solved = Solved { folder, result: Value::Null };
        // Tags go into a copy, so that the others are read without them.
        std::fs::copy(solved.path("e6.tif"), solved.path("tagged.tif")).expect("copied");
        let kinds: Vec<&str> =
            Output::ALL.iter().filter(|k| !matches!(k, Output::Tags | Output::Exif)).map(|k| k.name()).collect();
        let finished = solved.run("e6.tif", &["--write", &kinds.join(","), "--check", CHECK]);
        assert_eq!(finished.status.code(), Some(0), "{}", String::from_utf8_lossy(&finished.stderr));
        let text = std::fs::read_to_string(solved.path("e6.autoref.json")).expect("written");
        let finished = solved.run("tagged.tif", &["--write", "tags", "--check", CHECK]);
        assert_eq!(finished.status.code(), Some(0), "{}", String::from_utf8_lossy(&finished.stderr));
        Solved { result: serde_json::from_str(&text).expect("one document"), ..solved }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, image: &str, extra: &[&str]) -> Finished {
        Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
            .arg(self.path(image))
            .arg("--gcps")
            .arg(self.path("e6.geojson"))
            .args(extra)
            .arg("--quiet")
            .output()
            .expect("the program starts")
    }

    fn transform(&self) -> GeoTransform {
        serde_json::from_value(self.result["geotransform"].clone()).expect("six numbers")
    }

    /// Name, pixel, surveyed place and height, check or not, as the result has them.
    fn pairs(&self) -> Vec<Pair> {
        let rows = |key: &str, check: bool| -> Vec<Pair> {
            let number = |row: &Value, key: &str| row[key].as_f64().expect("a number");
            self.result[key]
                .as_array()
                .expect("a list")
                .iter()
                .map(|row| Pair {
                    name: row["gcp"].as_str().expect("a name").into(),
                    pixel: [number(row, "x"), number(row, "y")],
                    ground: [number(row, "easting"), number(row, "northing")],
                    height: row["height"].as_f64(),
                    check,
                })
                .collect()
        };
        let mut pairs = rows("matches", false);
        pairs.extend(rows("check_points", true));
        assert!(pairs.len() >= 6 && pairs.iter().any(|p| p.check), "too little to compare: {}", pairs.len());
        pairs
    }

    fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }
}

#[derive(Clone, Debug, PartialEq)]
struct Pair {
    name: String,
    pixel: [f64; 2],
    ground: [f64; 2],
    height: Option<f64>,
    check: bool,
}

fn number(text: &str) -> f64 {
    text.trim().parse().unwrap_or_else(|_| panic!("`{text}` is no number"))
}

/// The transform that a reader of its own rules takes from each dialect.
fn transforms(solved: &Solved) -> Vec<(&'static str, GeoTransform)> {
    let gdal = |path: &Path| {
        let dataset = gdal::Dataset::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert!(dataset.projection().contains("UTM zone 32N"), "{}: {}", path.display(), dataset.projection());
        GeoTransform(dataset.geo_transform().expect("a transform"))
    };
    // World file: A, D, B, E, then the place of the centre of the first pixel.
    let world: Vec<f64> = solved.text("e6.tfw").lines().map(number).collect();
    let [a, d, b, e, c, f] = world[..] else { panic!("six lines") };
    let world = GeoTransform([c - (a + b) / 2.0, a, b, f - (d + e) / 2.0, d, e]);
    vec![
        ("world", world),
        ("aux", gdal(&solved.path("e6.tif"))),
        ("vrt", gdal(&solved.path("e6.vrt"))),
        ("tags", gdal(&solved.path("tagged.tif"))),
    ]
}

#[test]
fn one_solve_in_every_dialect() {
    for rotation_deg in [0.0, 23.5] {
        let solved = Solved::new(rotation_deg);
        let expected = solved.transform();
        for (dialect, transform) in transforms(&solved) {
            for (x, y) in [(0.0, 0.0), (750.0, 0.0), (0.5, 599.5), (750.0, 600.0), (350.25, 311.75)] {
                let pixel = PixelPoint { x, y };
                let back = expected.invert(transform.apply(pixel)).expect("not singular");
                let off = (back.x - x).hypot(back.y - y);
                assert!(off < 1e-6, "{dialect}, {rotation_deg}°: {pixel:?} is {off} px off");
            }
        }
        let pairs = solved.pairs();
        for (dialect, found) in tie_points(&solved) {
            // GDAL's GCPs are what it would warp by: the control points alone.
            let kept = pairs.iter().filter(|pair| dialect != "gcps" || !pair.check);
            let expected: Vec<Pair> = kept.map(|pair| as_kept_by(dialect, pair)).collect();
            assert_eq!(found, expected, "{dialect}, {rotation_deg}°");
        }
        residual_vectors(&solved);
        warped_copy_agrees(&solved);
        lists_are_read_back(&solved);
    }
}

/// What a dialect has no place for.
fn as_kept_by(dialect: &str, pair: &Pair) -> Pair {
    let mut pair = pair.clone();
    match dialect {
        "points" => pair.height = None,
        // These lists know no check points.
        "micmac" | "pix4d" => pair.check = false,
        _ => {}
    }
    pair
}

fn tie_points(solved: &Solved) -> Vec<(&'static str, Vec<Pair>)> {
    vec![
        ("points", qgis(&solved.text("e6.tif.points"))),
        ("gcp-list", open_drone_map(&solved.text("e6.gcp_list.txt"))),
        ("gcps", gdal_gcps(&solved.text("e6.gcps.vrt"))),
        ("csv", table(&solved.text("e6.gcps.csv"))),
        ("geojson", geojson(&solved.text("e6.gcps.geojson"))),
        ("micmac", micmac(&solved.text("e6.appuis.xml"), &solved.text("e6.mesures.xml"))),
        ("metashape", metashape(&solved.text("e6.metashape.xml"))),
        ("pix4d", pix4d(&solved.text("e6.pix4d-gcps.csv"), &solved.text("e6.pix4d-marks.csv"))),
    ]
}

/// `QgsGCPList`: y upwards from the outer corner.
fn qgis(text: &str) -> Vec<Pair> {
    let mut lines = text.lines();
    assert!(lines.next().is_some_and(|line| line.starts_with("#CRS: PROJCS")), "{text}");
    assert!(lines.next().is_some_and(|line| line.starts_with("mapX,mapY,sourceX,sourceY,enable,dX,dY,residual")));
    lines
        .map(|line| {
            let f: Vec<&str> = line.split(',').collect();
            Pair {
                name: f[8].into(),
                pixel: [number(f[2]), -number(f[3])],
                ground: [number(f[0]), number(f[1])],
                height: None,
                check: f[4] == "0",
            }
        })
        .collect()
}

/// OpenSfM adds half a pixel: its pixels count from the centre of the first one.
fn open_drone_map(text: &str) -> Vec<Pair> {
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("EPSG:25832"));
    lines
        .map(|line| {
            let f: Vec<&str> = line.split_whitespace().collect();
            assert_eq!(f[5], "e6.tif");
            let label = f[6];
            Pair {
                name: label.trim_start_matches("CHK-").into(),
                pixel: [number(f[3]) + 0.5, number(f[4]) + 0.5],
                ground: [number(f[0]), number(f[1])],
                height: Some(number(f[2])),
                check: label.starts_with("CHK-"),
            }
        })
        .collect()
}

fn attribute(element: &str, name: &str) -> Option<String> {
    let from = element.find(&format!(" {name}=\""))? + name.len() + 3;
    Some(element[from..].split('"').next()?.to_string())
}

fn elements<'a>(text: &'a str, name: &str) -> Vec<&'a str> {
    text.split(&format!("<{name} "))
        .skip(1)
        .map(|rest| &rest[..rest.find('>').expect("closed")])
        .map(|e| e.trim())
        .collect()
}

fn required(element: &str, name: &str) -> String {
    attribute(&format!(" {element}"), name).unwrap_or_else(|| panic!("no {name} in {element}"))
}

fn gdal_gcps(vrt: &str) -> Vec<Pair> {
    elements(vrt, "GCP")
        .into_iter()
        .map(|gcp| Pair {
            name: required(gcp, "Id"),
            pixel: [number(&required(gcp, "Pixel")), number(&required(gcp, "Line"))],
            ground: [number(&required(gcp, "X")), number(&required(gcp, "Y"))],
            height: attribute(&format!(" {gcp}"), "Z").map(|z| number(&z)),
            check: false,
        })
        .collect()
}

fn table(text: &str) -> Vec<Pair> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let rows: Vec<std::collections::HashMap<String, String>> =
        reader.deserialize().map(|row| row.expect("a table with a header")).collect();
    rows.iter()
        .map(|row| Pair {
            name: row["name"].clone(),
            pixel: [number(&row["pixel_x"]), number(&row["pixel_y"])],
            ground: [number(&row["easting"]), number(&row["northing"])],
            height: Some(number(&row["height"])),
            check: row["role"] == "check",
        })
        .collect()
}

fn features<'a>(document: &'a Value, layer: &str) -> Vec<&'a Value> {
    document["features"].as_array().expect("a list").iter().filter(|f| f["properties"]["layer"] == layer).collect()
}

fn geojson(text: &str) -> Vec<Pair> {
    let document: Value = serde_json::from_str(text).expect("JSON");
    assert_eq!(document["crs"]["properties"]["name"], "urn:ogc:def:crs:EPSG::25832");
    features(&document, "gcp")
        .into_iter()
        .map(|f| {
            let at = |i: usize| f["geometry"]["coordinates"][i].as_f64().expect("a number");
            let property = |key: &str| f["properties"][key].as_f64().expect("a number");
            Pair {
                name: f["properties"]["name"].as_str().expect("a name").into(),
                pixel: [property("x"), property("y")],
                ground: [at(0), at(1)],
                height: Some(at(2)),
                check: f["properties"]["role"] == "check",
            }
        })
        .collect()
}

fn contents<'a>(text: &'a str, name: &str) -> Vec<&'a str> {
    text.split(&format!("<{name}>")).skip(1).map(|rest| rest.split("</").next().expect("closed").trim()).collect()
}

fn micmac(ground: &str, image: &str) -> Vec<Pair> {
    assert_eq!(contents(image, "NameIm"), ["e6.tif"]);
    assert_eq!(contents(ground, "NamePt"), contents(image, "NamePt"));
    let numbers = |text: &str| -> Vec<f64> { text.split_whitespace().map(number).collect() };
    contents(ground, "NamePt")
        .iter()
        .zip(contents(ground, "Pt"))
        .zip(contents(image, "PtIm"))
        .map(|((name, at), pixel)| {
            let (at, pixel) = (numbers(at), numbers(pixel));
            Pair {
                name: (*name).into(),
                pixel: [pixel[0], pixel[1]],
                ground: [at[0], at[1]],
                height: Some(at[2]),
                check: false,
            }
        })
        .collect()
}

fn metashape(text: &str) -> Vec<Pair> {
    let (markers, projections) = text.split_once("<frames>").expect("both parts");
    assert_eq!(required(elements(markers, "camera")[0], "label"), "e6.tif");
    elements(markers, "marker")
        .into_iter()
        .zip(elements(markers, "reference"))
        .zip(elements(projections, "location"))
        .map(|((marker, reference), location)| Pair {
            name: required(marker, "label"),
            pixel: [number(&required(location, "x")), number(&required(location, "y"))],
            ground: [number(&required(reference, "x")), number(&required(reference, "y"))],
            height: Some(number(&required(reference, "z"))),
            check: required(reference, "enabled") == "false",
        })
        .collect()
}

fn pix4d(gcps: &str, marks: &str) -> Vec<Pair> {
    gcps.lines()
        .zip(marks.lines())
        .map(|(gcp, mark)| {
            let (g, m): (Vec<&str>, Vec<&str>) = (gcp.split(',').collect(), mark.split(',').collect());
            assert_eq!((m[0], m[1]), ("e6.tif", g[0]));
            Pair {
                name: g[0].into(),
                pixel: [number(m[2]), number(m[3])],
                ground: [number(g[1]), number(g[2])],
                height: Some(number(g[3])),
                check: false,
            }
        })
        .collect()
}

/// Every residual is the line from where the transform puts the mark to where the point was surveyed.
fn residual_vectors(solved: &Solved) {
    let document: Value = serde_json::from_str(&solved.text("e6.gcps.geojson")).expect("JSON");
    let lines = features(&document, "residual");
    assert_eq!(lines.len(), solved.pairs().len());
    for (line, pair) in lines.into_iter().zip(solved.pairs()) {
        let at = |end: usize, i: usize| line["geometry"]["coordinates"][end][i].as_f64().expect("a number");
        let mark = solved.transform().apply(PixelPoint { x: pair.pixel[0], y: pair.pixel[1] });
        assert_eq!([at(0, 0), at(0, 1)], [mark.easting, mark.northing]);
        assert_eq!([at(1, 0), at(1, 1)], pair.ground);
        let residual = line["properties"]["residual_e_m"].as_f64().expect("a number");
        assert!((at(1, 0) - at(0, 0) - residual).abs() < 1e-6, "surveyed − computed");
    }
    // GDAL reads it, in the CRS it names.
    let dataset = gdal::Dataset::open(solved.path("e6.gcps.geojson")).expect("GDAL opens it");
    use gdal::vector::LayerAccess;
    let layer = dataset.layer(0).expect("one layer");
    assert_eq!(layer.feature_count() as usize, 3 * solved.pairs().len());
    assert_eq!(layer.spatial_ref().and_then(|r| r.auth_code().ok()), Some(25832));
}

/// The bright paint of a mark lies in the copy where the copy's own geotransform puts the surveyed point.
fn warped_copy_agrees(solved: &Solved) {
    let copy = gdal::Dataset::open(solved.path("e6.warp.tif")).expect("GDAL opens it");
    let transform = GeoTransform(copy.geo_transform().expect("a transform"));
    assert_eq!((transform.0[2], transform.0[4]), (0.0, 0.0), "north is up");
    let source = gdal::Dataset::open(solved.path("e6.tif")).expect("GDAL opens it");
    let colour = |dataset: &gdal::Dataset, pixel: PixelPoint| -> Vec<f64> {
        let window = (pixel.x as isize, pixel.y as isize);
        (1..=3)
            .map(|band| {
                let band = dataset.rasterband(band).expect("three bands");
                let read = band.read_as::<f64>(window, (1, 1), (1, 1), None).expect("inside");
                read.data()[0]
            })
            .collect()
    };
    for pair in solved.pairs() {
        let pixel = PixelPoint { x: pair.pixel[0], y: pair.pixel[1] };
        let ground = solved.transform().apply(pixel);
        let there = transform.invert(MapPoint { ..ground }).expect("not singular");
        let (a, b) = (colour(&source, pixel), colour(&copy, there));
        let difference = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(difference < 40.0, "{}: {a:?} in the image, {b:?} in the copy", pair.name);
    }
}

fn read(path: &Path) -> GcpList {
    gcp::read(path, &GcpOptions { crs: Some("EPSG:25832".into()), ..GcpOptions::default() })
        .unwrap_or_else(|e| panic!("{e}"))
}

/// What we write we also read: every list gives the same surveyed points.
fn lists_are_read_back(solved: &Solved) {
    let pairs = solved.pairs();
    for name in [
        "e6.gcp_list.txt",
        "e6.gcps.csv",
        "e6.gcps.geojson",
        "e6.appuis.xml",
        "e6.metashape.csv",
        "e6.metashape.xml",
        "e6.pix4d-gcps.csv",
    ] {
        let list = read(&solved.path(name));
        assert_eq!(list.gcps.len(), pairs.len(), "{name}");
        for (gcp, pair) in list.gcps.iter().zip(&pairs) {
            assert_eq!(
                (&gcp.name, gcp.easting, gcp.northing, gcp.height),
                (&pair.name, pair.ground[0], pair.ground[1], pair.height),
                "{name}"
            );
            let knows_roles = !matches!(name, "e6.appuis.xml" | "e6.pix4d-gcps.csv");
            assert!(!knows_roles || (gcp.role == GcpRole::Check) == pair.check, "{name}: {}", gcp.name);
        }
    }
    // QGIS's check points are switched off; their role says what they are. It has no heights.
    let list = read(&solved.path("e6.tif.points"));
    let roles = |check: bool| if check { GcpRole::Check } else { GcpRole::Control };
    let written: Vec<_> = pairs.iter().map(|pair| (&pair.name, roles(pair.check))).collect();
    assert_eq!(list.gcps.iter().map(|gcp| (&gcp.name, gcp.role)).collect::<Vec<_>>(), written);
}

/// The same points in every format that is read give the same run.
#[test]
fn every_list_gives_the_same_run() {
    let solved = Solved::new(7.5);
    let all: GcpList = read(&solved.path("e6.geojson"));
    let rows = |f: &dyn Fn(&autoref_stream::gcp::Gcp) -> String| -> String { all.gcps.iter().map(f).collect() };
    let (h, e, n) = (
        |g: &autoref_stream::gcp::Gcp| g.height.expect("the sample has heights"),
        |g: &autoref_stream::gcp::Gcp| g.easting,
        |g: &autoref_stream::gcp::Gcp| g.northing,
    );
    let comma = |v: f64| v.to_string().replace('.', ",");
    let lists: Vec<(&str, String)> = vec![
        (
            "a.csv",
            format!(
                "name;h;n;e\n{}",
                rows(&|g| format!("{};{};{};{}\n", g.name, comma(h(g)), comma(n(g)), comma(e(g))))
            ),
        ),
        ("b.kof", rows(&|g| format!("05 {} {} {} {}\n", g.name, n(g), e(g), h(g)))),
        ("c.txt", format!("EPSG:25832\n{}", rows(&|g| format!("{} {} {} 1 2 a.jpg {}\n", e(g), n(g), h(g), g.name)))),
        ("d.csv", rows(&|g| format!("{},{},{},{},0.01,0.02\n", g.name, e(g), n(g), h(g))).replace(",0.01,0.02", "")),
        (
            "e.points",
            format!(
                "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual,name\n{}",
                rows(&|g| format!("{},{},1,-2,1,0,0,0,{}\n", e(g), n(g), g.name))
            ),
        ),
        (
            "f.xml",
            format!(
                "<document><chunk><markers>{}</markers></chunk></document>",
                rows(&|g| format!(
                    "<marker label=\"{}\"><reference x=\"{}\" y=\"{}\" z=\"{}\"/></marker>\n",
                    g.name,
                    e(g),
                    n(g),
                    h(g)
                ))
            ),
        ),
        (
            "g.xml",
            format!(
                "<DicoAppuisFlottant>{}</DicoAppuisFlottant>",
                rows(&|g| format!(
                    "<OneAppuisDAF><Pt>{} {} {}</Pt><NamePt>{}</NamePt></OneAppuisDAF>\n",
                    e(g),
                    n(g),
                    h(g),
                    g.name
                ))
            ),
        ),
    ];
    let mut names: Vec<String> = Vec::new();
    for (name, text) in lists {
        std::fs::write(solved.path(name), text).expect("writable");
        names.push(name.into());
    }
    for (name, driver) in [("h.gpkg", "GPKG"), ("i.shp", "ESRI Shapefile"), ("j.kml", "KML"), ("k.gpx", "GPX")] {
        let srs = if matches!(driver, "KML" | "GPX") { "EPSG:4258" } else { "EPSG:25832" };
        let status = Command::new("ogr2ogr")
            .args(["-f", driver, "-s_srs", "EPSG:25832", "-t_srs", srs])
            .args(if driver == "GPX" { &["-dsco", "GPX_USE_EXTENSIONS=YES", "-nlt", "POINT"][..] } else { &[] })
            .args(if driver == "KML" { &["-dsco", "NameField=name"][..] } else { &[] })
            .arg(solved.path(name))
            .arg(solved.path("e6.geojson"))
            .output()
            .expect("ogr2ogr is part of the packages that the tests need");
        assert!(status.status.success(), "{driver}: {}", String::from_utf8_lossy(&status.stderr));
        names.push(name.into());
    }
    let expected = solved.transform();
    for name in names {
        // KML and GPX say WGS 84, which is the sample's ETRS89 here.
        let degrees = name.ends_with("kml") || name.ends_with("gpx");
        let crs = if degrees { "EPSG:4258" } else { "EPSG:25832" };
        let finished = Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
            .arg(solved.path("e6.tif"))
            .arg("--gcps")
            .arg(solved.path(&name))
            .args(["--crs", crs, "--to-crs", "EPSG:25832", "--check", CHECK, "--json", "--quiet", "--overwrite"])
            .arg("--no-report")
            .output()
            .expect("the program starts");
        assert_eq!(finished.status.code(), Some(0), "{name}: {}", String::from_utf8_lossy(&finished.stderr));
        let result: Value = serde_json::from_slice(&finished.stdout).expect("one document");
        let found: GeoTransform = serde_json::from_value(result["geotransform"].clone()).expect("six numbers");
        if degrees {
            // As many digits as the format keeps.
            let centre = PixelPoint { x: 375.0, y: 300.0 };
            let back = expected.invert(found.apply(centre)).expect("not singular");
            assert!((back.x - 375.0).hypot(back.y - 300.0) < 0.01, "{name}: {back:?}");
        } else {
            assert_eq!(found, expected, "{name}");
        }
        assert_eq!(
            result["matches"].as_array().map(Vec::len),
            solved.result["matches"].as_array().map(Vec::len),
            "{name}"
        );
    }
}

/// What a dialect cannot hold is refused before the image is read.
#[test]
fn what_a_dialect_cannot_hold_is_refused_before_any_work() {
    let solved = Solved::new(0.0);
    std::fs::write(solved.path("flat.csv"), "name,e,n\nA,570000,7032000\nB,570010,7032000\nC,570010,7032010\n")
        .expect("writable");
    std::fs::copy(solved.path("e6.tif"), solved.path("e 6.tif")).expect("copied");
    for (image, kind, extra, word) in [
        ("tagged.tif", "micmac", &["--crs", "EPSG:25832"][..], "needs heights"),
        ("tagged.tif", "pix4d", &["--crs", "EPSG:25832"], "needs heights"),
        ("e 6.tif", "gcp-list", &[], "needs a CRS"),
        ("e 6.tif", "gcp-list", &["--crs", "EPSG:25832"], "cut at blanks"),
    ] {
        let finished = Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
            .arg(solved.path(image))
            .arg("--gcps")
            .arg(solved.path("flat.csv"))
            .args(["--write", kind, "--overwrite"])
            .args(extra)
            .output()
            .expect("the program starts");
        let message = String::from_utf8_lossy(&finished.stderr).into_owned();
        assert_eq!(finished.status.code(), Some(2), "{kind}: {message}");
        assert!(message.contains(word) && message.trim_end().lines().count() == 1, "{kind}: {message}");
    }
}
