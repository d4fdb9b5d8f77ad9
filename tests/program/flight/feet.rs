//! Maps that count in feet: the flight is that of the same map in metres.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use super::{Flight, Place, autoref, brightness, expect, ground, json, text};
use crate::common::large;
use crate::orthorectify::write_dem;
use autoref_raster::crs::{Coordinate, Crs};
use nalgebra::Vector3;
use serde_json::Value;

/// New York's Long Island zone: EPSG:2263 in feet of the survey, EPSG:32118 in metres, else the same.
const FOOT_M: f64 = 1200.0 / 3937.0;
const AWAY_M: [f64; 2] = [300_000.0, 60_000.0];

/// A CRS, and the metres in a unit of its plan and of its heights.
#[derive(Clone, Copy)]
struct Map(&'static str, f64, f64);

const METRES: Map = Map("EPSG:32118", 1.0, 1.0);
const MAPS: [Map; 3] =
    [Map("EPSG:2263", FOOT_M, FOOT_M), Map("EPSG:2263+6360", FOOT_M, FOOT_M), Map("EPSG:2263+5703", FOOT_M, 1.0)];

impl Map {
    fn of_plane(self, xyz: &Vector3<f64>) -> [f64; 3] {
        [(xyz.x + AWAY_M[0]) / self.1, (xyz.y + AWAY_M[1]) / self.1, xyz.z / self.2]
    }

    fn opendronemap(self, flight: &Flight) -> String {
        opendronemap(self.0, flight, |xyz| self.of_plane(xyz))
    }

    fn points(self, flight: &Flight) -> String {
        flight.gcps.iter().fold("name,easting,northing,height\n".into(), |all, (name, xyz, _)| {
            let [e, n, h] = self.of_plane(xyz);
            format!("{all}{name},{e:.6},{n:.6},{h:.6}\n")
        })
    }

    fn table(self, flight: &Flight) -> String {
        flight.model.photographs.iter().fold("name,x,y,z,omega,phi,kappa\n".into(), |all, p| {
            let ([x, y, z], [o, f, k]) = (self.of_plane(&p.pose.centre), p.pose.omega_phi_kappa());
            format!("{all}{},{x:.6},{y:.6},{z:.6},{o:.9},{f:.9},{k:.9}\n", p.name)
        })
    }

    /// Where a camera of a document stands, metres.
    fn metres(self, camera: &Value) -> Vector3<f64> {
        let at = |i: usize| camera["C"][i].as_f64().expect("a number");
        Vector3::new(at(0) * self.1, at(1) * self.1, at(2) * self.2)
    }
}

/// OpenDroneMap's list of the GCPs, `of_plane` of which are their places in the CRS.
fn opendronemap(crs: &str, flight: &Flight, of_plane: impl Fn(&Vector3<f64>) -> [f64; 3]) -> String {
    let mut list = format!("{crs}\n");
    for (name, xyz, seen) in &flight.gcps {
        let [e, n, h] = of_plane(xyz);
        for (frame, [x, y]) in seen {
            let image = &flight.model.photographs[*frame].name;
            writeln!(list, "{e:.6} {n:.6} {h:.6} {:.4} {:.4} {image} {name}", x - 0.5, y - 0.5).expect("text");
        }
    }
    list
}

fn observations(flight: &Flight) -> String {
    let mut table = String::from("name,image,px,py\n");
    for (name, _, seen) in &flight.gcps {
        for (frame, [x, y]) in seen {
            writeln!(table, "{name},{},{x:.4},{y:.4}", flight.model.photographs[*frame].name).expect("text");
        }
    }
    table
}

/// A run in a map: what was found, and by which words.
fn run(words: &[&str]) -> Value {
    let output = autoref(words, None, &[]);
    expect(&output, 0, &[]);
    json(&output)
}

#[test]
fn points_and_positions_in_feet_give_the_cameras_of_those_in_metres() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let model = place.at("model");
    let seen = place.write("observations.csv", &observations(&place.flight));
    let in_map = |map: Map, ways: [bool; 5]| -> Vec<Value> {
        let odm = place.write("odm.txt", &map.opendronemap(&place.flight));
        let csv = place.write("points.csv", &map.points(&place.flight));
        let table = place.write("table.csv", &map.table(&place.flight));
        let adjust = ["flight", "adjust", text(&model), "--json", "--free", "none"];
        let resect = ["flight", "resect", "f2.png", "--f-px", "500", "--size", "480,480", "--json"];
        let of_list = ["--gcps", text(&odm), "--sigma-ground", "0.02"];
        let apart = ["--gcps", text(&csv), "--observations", text(&seen), "--crs", map.0, "--sigma-ground", "0.02"];
        let positions = ["--cameras", text(&table), "--crs", map.0, "--sigma-position", "0.5"];
        [&of_list[..], &apart[..], &positions[..]]
            .iter()
            .map(|more| [&adjust[..], more].concat())
            .chain([&of_list[..], &apart[..]].iter().map(|more| [&resect[..], more].concat()))
            .zip(ways)
            .filter_map(|(words, is_asked)| is_asked.then(|| run(&words)))
            .collect()
    };
    let metric = in_map(METRES, [true; 5]);
    // Every way where plan and heights count differently; where both count in feet in turn, all with AUTOREF_LARGE=1.
    let turns = [[true, false, false, false, true], [false, true, true, true, false], [true; 5]];
    for (map, turn) in MAPS.into_iter().zip(turns) {
        let ways = if large() { [true; 5] } else { turn };
        let known = metric.iter().zip(ways).filter_map(|(known, is_asked)| is_asked.then_some(known));
        for (found, known) in in_map(map, ways).iter().zip(known) {
            let unit = |key: &str| found[key].as_f64().expect("a number");
            let off = (unit("unit_m") - map.1).abs().max((unit("height_unit_m") - map.2).abs());
            assert!(off < 1e-12, "{}: {found}", map.0);
            let pair = match known["cameras"].as_array() {
                Some(all) => (&found["cameras"][2], &all[2]),
                None => (found, known),
            };
            let off = (map.metres(pair.0) - METRES.metres(pair.1)).norm();
            assert!(off < 2e-3, "{}: {off} m: {} {}", map.0, pair.0, pair.1);
            let truth = place.flight.model.photographs[2].pose.centre + Vector3::new(AWAY_M[0], AWAY_M[1], 0.0);
            assert!((METRES.metres(pair.1) - truth).norm() < 0.3, "{}", pair.1);
            // Standard deviations and residuals are metres in both.
            let sigma = |camera: &Value| camera["sigma_h"].as_f64().expect("a number");
            assert!((sigma(pair.0) / sigma(pair.1) - 1.0).abs() < 1e-3, "{} {}", pair.0, pair.1);
        }
    }
}

/// The document of a map is adjusted in it as what it was made from, also where the map stretches the ground, and where
/// it counts heights in another unit than its eastings.
#[test]
fn a_document_of_a_map_is_adjusted_on_the_ground() {
    let place = Place::new();
    let model = place.at("model");
    place.flight.write_model(&model);
    // Metres of EPSG:3857 are 1.3 to one on the ground here.
    let stretched = |xyz: &Vector3<f64>| {
        let [x, y, z] = METRES.of_plane(xyz);
        let crs = |word| Crs::parse(word).expect("known");
        let mut at = [Coordinate { x, y, height: None }];
        crs(METRES.0).transform(&mut at, &crs("EPSG:3857"), 100.0).expect("both have it");
        [at[0].x, at[0].y, z]
    };
    let lists = [
        ("EPSG:3857", opendronemap("EPSG:3857", &place.flight, stretched), 1.0, 1.0),
        (MAPS[2].0, MAPS[2].opendronemap(&place.flight), MAPS[2].1, MAPS[2].2),
    ];
    for (crs, list, plan_m, height_m) in lists {
        let (gcps, document) = (place.write("gcps.txt", &list), place.at("cameras.json"));
        let adjusted = |of: &Path, more: &[&str]| {
            let words = ["flight", "adjust", text(of), "--gcps", text(&gcps), "--sigma-ground", "0.02"];
            run(&[&words[..], &["--free", "none", "--json"], more].concat())
        };
        let first = adjusted(&model, &["-o", text(&document), "--overwrite"]);
        let second = adjusted(&document, &[]);
        for (i, known) in first["cameras"].as_array().expect("cameras").iter().enumerate() {
            let at = |camera: &Value, axis: usize| camera["C"][axis].as_f64().expect("a number");
            let by = |axis: usize| at(&second["cameras"][i], axis) - at(known, axis);
            let off = Vector3::new(by(0) * plan_m, by(1) * plan_m, by(2) * height_m).norm();
            assert!(off < 0.5, "{crs}: {off} m: {known} {}", second["cameras"][i]);
        }
    }
    // A place that the map does not have, and degrees.
    let text_of = std::fs::read_to_string(place.at("cameras.json")).expect("written");
    let mut document: Value = serde_json::from_str(&text_of).expect("JSON");
    for (crs, said) in [("EPSG:4326", "degrees"), ("EPSG:25833", "outside")] {
        document["crs"] = crs.into();
        document["cameras"][0]["C"] = serde_json::json!([1e11, 1e11, 400.0]);
        let wrong = place.write("wrong.json", &document.to_string());
        let gcps = place.at("gcps.txt");
        let words = ["flight", "adjust", text(&wrong), "--gcps", text(&gcps)];
        expect(&autoref(&words, None, &[]), 2, &["wrong.json", said]);
    }
}

#[test]
fn titles_that_count_otherwise_than_the_map_are_refused() {
    let place = Place::new();
    let model = place.at("model");
    place.flight.write_model(&model);
    let wrong = [(MAPS[0], "z (m)", "`z (m)` says metres"), (METRES, "z (ft)", "`z (ft)` says feet")];
    for (map, title, said) in wrong {
        let rows = map.table(&place.flight).replacen("x,y,z", &format!("x,y,{title}"), 1);
        let table = place.write("table.csv", &rows);
        let words = ["flight", "adjust", text(&model), "--cameras", text(&table), "--crs", map.0];
        expect(&autoref(&words, None, &[]), 2, &[said, map.0]);
    }
}

/// A model of the ground in a map, heights in the unit of the map.
fn model_of_ground(path: &Path, map: Map, epsg: u32) {
    let corner = [(800.0 + AWAY_M[0]) / map.1, (2250.0 + AWAY_M[1]) / map.1];
    let height = |x: f64, y: f64| ground(x * map.1 - AWAY_M[0], y * map.1 - AWAY_M[1]) / map.2;
    write_dem(path, (400, 250), corner, 2.0 / map.1, height);
    let options = gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let mut file = gdal::Dataset::open_ex(path, options).expect("it opens");
    let crs = gdal::spatial_ref::SpatialRef::from_epsg(epsg).expect("known");
    file.set_spatial_ref(&crs).expect("kept");
    file.close().expect("written");
}

#[test]
fn an_orthophoto_in_feet_is_that_in_metres() {
    let place = Place::new();
    place.flight.render(&place.at("frames"), &[2]);
    let frame = place.at("frames").join("f2.png");
    let drawn = |map: Map, epsg: u32, name: &str| -> (Vec<u8>, (usize, usize), [f64; 6]) {
        let (dem, out): (PathBuf, PathBuf) = (place.at(&format!("{name}_dem.tif")), place.at(&format!("{name}.tif")));
        model_of_ground(&dem, map, epsg);
        let table = place.write(&format!("{name}.csv"), &map.table(&place.flight));
        let gsd = (1.5 / map.1).to_string();
        let words = ["flight", "orthorectify", text(&frame), "--dem", text(&dem), "--cameras", text(&table)];
        let more = ["--f-px", "500", "--gsd", &gsd, "-o", text(&out), "--json"];
        let document = run(&[&words[..], &more].concat());
        let eye = document["camera"][2].as_f64().expect("a number") * map.2;
        assert!((eye - place.flight.model.photographs[2].pose.centre.z).abs() < 1e-3, "{document}");
        let file = gdal::Dataset::open(&out).expect("it opens");
        let size = file.raster_size();
        let band = file.rasterband(1).expect("a band").read_as::<u8>((0, 0), size, size, None).expect("read");
        (band.data().to_vec(), size, file.geo_transform().expect("georeferenced"))
    };
    let (metric, size, at) = drawn(METRES, 32118, "metres");
    let (feet, size_ft, at_ft) = drawn(MAPS[0], 2263, "feet");
    assert!(size == size_ft && at.iter().zip(at_ft).all(|(m, ft)| (m - ft * FOOT_M).abs() < 1e-6), "{at:?} {at_ft:?}");
    let other = metric.iter().zip(&feet).filter(|(a, b)| a.abs_diff(**b) > 1).count();
    assert!(other * 1000 < metric.len(), "{other} of {} pixels differ", metric.len());
    // And both show the ground.
    let (i, j) = (size.0 / 2, size.1 / 2);
    let [x, y] = [at[0] + at[1] * (i as f64 + 0.5), at[3] + at[5] * (j as f64 + 0.5)];
    let expected = brightness(x - AWAY_M[0], y - AWAY_M[1]);
    assert!(metric[j * size.0 + i].abs_diff(expected) < 25, "{} for {expected}", metric[j * size.0 + i]);
}
