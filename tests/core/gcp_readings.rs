//! Readings that were certain and wrong: cells under others' titles, heights of the other set, roles and accuracies in
//! words that were not understood, systems that change within a list.

use crate::lists_folder::Folder;
use autoref_stream::gcp::convert::{ConvertOptions, convert};
use autoref_stream::gcp::{Gcp, GcpList, GcpOptions, GcpRole};

fn read_as(name: &str, crs: Option<&str>, text: &str) -> Result<GcpList, String> {
    let options = GcpOptions { crs: crs.map(str::to_owned), ..GcpOptions::default() };
    Folder::new().read(name, text, &options)
}

fn read(text: &str) -> GcpList {
    read_as("l.csv", Some("local"), text).unwrap_or_else(|e| panic!("{text}: {e}"))
}

#[track_caller]
fn says(list: &GcpList, what: &str) {
    assert!(list.notes.iter().any(|note| note.contains(what)), "no `{what}` in {:?}", list.notes);
}

#[track_caller]
fn refused(crs: Option<&str>, text: &str, words: &[&str]) {
    let error = read_as("l.csv", crs, text).expect_err(text);
    for word in words {
        assert!(error.contains(word), "no `{word}` in: {error}");
    }
}

fn of(gcp: &Gcp) -> (&str, f64, f64, Option<f64>) {
    (&gcp.name, gcp.easting, gcp.northing, gcp.height)
}

#[test]
fn cells_stand_under_their_own_titles() {
    let rows = "P1  500100.12  6600200.23  100.12\nP2  500200.1  6600300.2  101.1\n";
    for titles in ["Point ID   Easting   Northing   Elevation", "Pt  Easting (m)  Northing (m)  Height (m)"] {
        let list = read_as("l.txt", Some("local"), &format!("{titles}\n{rows}")).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(of(&list.gcps[0]), ("P1", 500100.12, 6600200.23, Some(100.12)), "{titles}");
    }
    let padded = "Name\t\tX\tY\t\tZ\nP1\t1.5\t2.5\t3.5\nP2\t4.5\t2.5\t3.5\n";
    assert_eq!(of(&read(padded).gcps[0]), ("P1", 1.5, 2.5, Some(3.5)));
    refused(None, &format!("Our new points E N H\n{rows}"), &["6 titles", "4 cells", "semicolons"]);
    let optional = read("name x y z code\nP1 1.5 2.5 3.5\nP2 1.5 4.5 3.5\n");
    assert_eq!(of(&optional.gcps[0]), ("P1", 1.5, 2.5, Some(3.5)));
}

#[test]
fn prose_above_rows_is_no_header() {
    let rows = "P1 500100.1 6600200.2 10.1\nP2 500200.1 6600300.2 11.1\n";
    let list = read(&format!("# Site: North East quarter\n{rows}"));
    assert_eq!(of(&list.gcps[0]), ("P1", 500100.1, 6600200.2, Some(10.1)));
}

#[test]
fn each_set_of_coordinates_has_its_own_height() {
    let text = "Name,WGS84 Latitude,WGS84 Longitude,WGS84 Ellipsoid Height,Grid Northing,Grid Easting,Grid Elevation\n\
                A,59.53,9.001,50.5,6600200.2,500100.1,10.5\nB,59.54,9.002,50.5,6600300.2,500200.1,10.5\n";
    let list = read_as("l.csv", Some("EPSG:25832"), text).expect("a map's");
    assert_eq!(of(&list.gcps[0]), ("A", 500100.1, 6600200.2, Some(10.5)));
    let emlid = "Name,Easting,Northing,Elevation,Description,Longitude,Latitude,Ellipsoidal height\n\
                 A,500100.1,6600200.2,10.5,,9.00178,59.53,50.2\nB,500200.1,6600300.2,10.5,,9.00278,59.531,50.2\n";
    for (crs, height) in [("EPSG:4979", 50.2), ("EPSG:25832", 10.5)] {
        let list = read_as("l.csv", Some(crs), emlid).unwrap_or_else(|e| panic!("{crs}: {e}"));
        assert_eq!(list.gcps[0].height, Some(height), "{crs}");
    }
    let grid = read("Name,Grid Easting,Grid Northing,Grid Elevation\nA,1.5,2.5,10.5\nB,3.5,2.5,10.5\n");
    assert_eq!(grid.gcps[0].height, Some(10.5));
}

#[test]
fn one_list_is_of_one_system() {
    let rows = |systems: [&str; 3]| {
        let rows = systems.iter().enumerate().map(|(i, crs)| format!("P{i},50010{i}.1,6600200.2,{crs}\n"));
        rows.collect::<String>()
    };
    let crs = |systems| format!("name,easting,northing,crs\n{}", rows(systems));
    refused(None, &crs(["EPSG:25832", "EPSG:25833", "EPSG:25833"]), &["row 3", "row 2", "EPSG:25833", "EPSG:25832"]);
    let list = read_as("l.csv", None, &crs(["", "EPSG:25833", "ETRS89 / UTM zone 33N"])).expect("one system");
    assert_eq!(list.crs.expect("stated").epsg(), Some(25833));
    let zone = |zones| format!("name,easting,northing,Zone\n{}", rows(zones));
    refused(None, &zone(["32N", "32N", "33N"]), &["row 4", "zone 33N", "row 2", "--crs"]);
    for zones in [["32N", "32N", "32V"], ["A", "B", "B"], ["1", "2", "3"]] {
        read_as("l.csv", Some("EPSG:25832"), &zone(zones)).unwrap_or_else(|e| panic!("{zones:?}: {e}"));
    }
}

#[test]
fn roles_in_many_words() {
    let with = |title: &str, words: &[&str]| {
        let rows = words.iter().enumerate().map(|(i, word)| format!("P{i},{i}.5,2.5,{word}\n"));
        read(&format!("name,easting,northing,{title}\n{}", rows.collect::<String>()))
    };
    let checks = |list: &GcpList| list.gcps.iter().map(|gcp| gcp.role == GcpRole::Check).collect::<Vec<_>>();
    let roles = with("role", &["GCP", "validation", "VCP", "QC", "Check (3D)", "tree"]);
    assert_eq!(checks(&roles), [false, true, true, true, true, false]);
    says(&roles, "`tree` in `role` was taken for a control point");
    assert_eq!(checks(&with("check", &["WAHR", "FALSCH", "oui", "nein"])), [true, false, true, false]);
    assert_eq!(checks(&with("use", &["yes", "no"])), [false, true]);
    assert_eq!(checks(&with("Enabled", &["ja", "nein", "off"])), [false, true, true]);
    says(&with("type", &["CP", "GCP"]), "`CP` in `type` was taken for a check point");
    // Each word by what its own column makes of it.
    says(&with("check", &["skip", "no"]), "`skip` in `check` was taken for a control point");
    says(&with("enabled", &["CP", "yes"]), "`CP` in `enabled` was taken for a control point");
    let in_use = read("name,easting,northing,type,enabled\nA,1.5,2.5,Verif,yes\nB,3.5,2.5,GCP,yes\n");
    says(&in_use, "`Verif` in `type` was taken for a control point");
    // What another column says of the point settles it.
    let settled = read("name,easting,northing,type,check\nA,1.5,2.5,tree,no\nB,3.5,2.5,tree,yes\nC,5.5,2.5,CP,yes\n");
    assert_eq!(checks(&settled), [false, true, true]);
    assert!(settled.notes.iter().all(|note| !note.contains("was taken for")), "{:?}", settled.notes);
}

#[test]
fn accuracies_are_one_standard_deviation() {
    let list = read(
        "name,easting,northing,height,Horizontal Accuracy (95%),Vertical Accuracy (95%)\nA,1,2,3,0.02,0.03\nB,4,2,3,0.02,0.03\n",
    );
    assert!((list.gcps[0].sigma_m.expect("one") - 0.02 / 2.4477).abs() < 1e-6, "{:?}", list.gcps[0]);
    assert!((list.gcps[0].sigma_height_m.expect("one") - 0.03 / 1.96).abs() < 1e-6, "{:?}", list.gcps[0]);
    says(&list, "`Horizontal Accuracy (95%)` by 2.448");
    let list = read("name,easting,northing,Accuracy (2 sigma)\nA,1,2,0.04\nB,4,2,0.04\n");
    assert_eq!(list.gcps[0].sigma_m, Some(0.02));
    let list = read("name,E,N,mE [cm],mN [cm]\nA,1,2,3,4\nB,4,2,3,4\n");
    assert!((list.gcps[0].sigma_m.expect("one") - 0.035_355).abs() < 1e-5);
    says(&read("name,easting,northing,Plan precision (mm)\nA,1,2,3\nB,4,2,3\n"), "no accuracy was read");
}

#[test]
fn west_and_south_in_titles_negate() {
    let text = "Name,Latitude (N),Longitude (W),H\nA,40.1234,75.1234,10\nB,40.1244,75.1244,10\n";
    let options = ConvertOptions::default();
    let folder = Folder::new();
    let output = folder.0.path().join("out.csv");
    let done = convert(&folder.write("l.csv", text), &output, &options).expect("degrees");
    assert!(done.notes.iter().any(|note| note.contains("`Longitude (W)`")), "{:?}", done.notes);
    let written = std::fs::read_to_string(&output).expect("written");
    assert!(written.contains("-75.1234") && !written.contains("-40"), "{written}");
    let east = text.replace("(N)", "(North)").replace("(W)", "(East)");
    convert(&folder.write("m.csv", east), &folder.0.path().join("m.out.csv"), &options).expect("degrees");
}

#[test]
fn numbers_without_titles_are_what_they_can_be() {
    let list = read("1,1000.10,2000.20,Kerb,100.5\n2,1100.10,2100.20,Kerb,100.5\n3,1200.10,2100.20,Gate,100.5\n");
    assert_eq!((list.gcps[0].name.as_str(), list.gcps[0].easting, list.gcps[0].northing), ("1", 1000.1, 2000.2));
    says(&list, "was not used");
    let wide = "7   512 345,67   6 612 345,67   12,30\n8   512 445,67   6 612 545,67   13,30\n";
    let list = read_as("l.txt", Some("EPSG:25832"), wide).expect("columns between wide gaps");
    assert_eq!(of(&list.gcps[0]), ("7", 512345.67, 6612345.67, Some(12.3)));
    refused(Some("local"), &wide.replace("   ", " "), &["thousands", "semicolons"]);
    let list = read("1,500100.1,6600200.2,10.5,1\n2,500200.1,6600300.2,10.5,2\n");
    assert_eq!((list.gcps[0].height, list.gcps[0].sigma_m), (Some(10.5), None));
    says(&list, "column 5 was not used");
}

#[test]
fn only_what_is_carried_nowhere_is_lost() {
    let text =
        "name,E,N,H,Strip,HRMS (mm),Vertical accuracy (mm)\n1,500.5,2,3,1,8,9\n2,501.5,2,3,1,8,9\n3,502.5,9,3,3,8,9\n";
    let folder = Folder::new();
    let path = folder.write("l.csv", text);
    let local = ConvertOptions { crs: Some("local".into()), ..ConvertOptions::default() };
    let output = folder.0.path().join("out.csv");
    let done = convert(&path, &output, &local).unwrap_or_else(|e| panic!("{e}"));
    assert!(done.lost.is_empty(), "{:?}", done.lost);
    let written = std::fs::read_to_string(&output).expect("written");
    let strips: Vec<&str> = written.lines().skip(1).filter_map(|line| line.rsplit(',').next()).collect();
    assert_eq!(strips, ["1", "1", "3"], "{written}");
}

/// The same rules, where they must not reach.
#[test]
fn what_was_read_rightly_stays_so() {
    // An empty last column shifts nothing.
    let list = read("ID,Name,E,N,H\n1,101,500100.1,6600200.1,\n2,102,500200.1,6600300.1,\n");
    assert_eq!((list.gcps[0].easting, list.gcps[0].northing, list.gcps[0].height), (500100.1, 6600200.1, None));
    // In American plane coordinates in feet the northing may be the smaller one.
    let feet =
        "Point Northing Easting Elevation Surveyor\nP1 660000.1 2200000.2 100.1 Smith\nP2 660100.1 2200100.2 1.1 Lee\n";
    for text in [feet.to_owned(), format!("# {feet}")] {
        assert_eq!(of(&read(&text).gcps[0]), ("P1", 2200000.2, 660000.1, Some(100.1)), "{text}");
    }
    // The s of seconds is no south.
    let text =
        "Name,Latitude (DD MM SS.s),Longitude (DD MM SS.s)\nP1,59 30 11.5,10 20 10.5\nP2,59 30 12.5,10 20 11.5\n";
    let list = read_as("l.csv", Some("EPSG:4326"), text).expect("degrees");
    assert!(list.notes.iter().all(|note| !note.contains("south")), "{:?}", list.notes);
    // A dash is nothing.
    let list = read("Name,E,N,H,Type\nP1,500100.1,6600200.1,5.1,-\nP2,500200.1,6600300.1,5.2,Check\n");
    assert_eq!(list.gcps.iter().map(|gcp| gcp.role).collect::<Vec<_>>(), [GcpRole::Control, GcpRole::Check]);
    // Axes every hundred metres are coordinates.
    let list = read("100,200.5,10.2,P1\n200,210.5,10.3,P2\n300,205.25,10.4,P3\n");
    assert_eq!((list.gcps[0].easting, list.gcps[0].northing), (100.0, 200.5));
    // Two numbers of a building are no thousands of one.
    let list = read("P1 100 200.5 50 120.3\nP2 110 210.5 60 130.3\n");
    assert_eq!((list.gcps[1].easting, list.gcps[1].northing), (110.0, 210.5));
    // Zones of a building site are none of UTM.
    let text = "Name,E,N,Zone\nP1,500100.1,6600200.1,1A\nP2,500200.1,6600300.1,2B\n";
    assert!(read_as("l.csv", Some("EPSG:25832"), text).is_ok());
    let text = text.replace("1A", "32N").replace("2B", "33N");
    assert!(read_as("l.csv", Some("EPSG:25832"), &text).is_ok());
    refused(None, &text, &["zone 33N", "--crs"]);
    // Words beside a place in three coordinates are noted.
    let feature = |name: &str, x: f64| {
        format!(
            r#"{{"type": "Feature", "properties": {{"name": "{name}", "elevation": "unknown", "accuracy": "good"}},
            "geometry": {{"type": "Point", "coordinates": [{x}, 2.5, 3.5]}}}}"#
        )
    };
    let text =
        format!(r#"{{"type": "FeatureCollection", "features": [{}, {}]}}"#, feature("A", 1.5), feature("B", 9.5));
    let list = read_as("l.geojson", Some("local"), &text).expect("points");
    assert_eq!(of(&list.gcps[0]), ("A", 1.5, 2.5, Some(3.5)));
    says(&list, "`good` under `accuracy` is no number");
}

#[test]
fn what_is_no_point_is_passed_over_where_there_are_points() {
    let feature = |geometry: &str, name: &str| {
        format!(r#"{{"type":"Feature","geometry":{geometry},"properties":{{"name":"{name}"}}}}"#)
    };
    let geojson =
        |features: &[String]| format!(r#"{{"type":"FeatureCollection","features":[{}]}}"#, features.join(","));
    let boundary = feature(r#"{"type":"LineString","coordinates":[[500100,6600200],[500900,6600900]]}"#, "boundary");
    let text = geojson(&[
        feature(r#"{"type":"Point","coordinates":[500100.5,6600200.5]}"#, "A"),
        boundary.clone(),
        feature(r#"{"type":"MultiPoint","coordinates":[[500200.5,6600300.5,12.5]]}"#, "B"),
        feature("null", "C"),
    ]);
    let list = read_as("l.geojson", Some("EPSG:25832"), &text).expect("two points");
    let names: Vec<(&str, Option<f64>)> = list.gcps.iter().map(|gcp| (gcp.name.as_str(), gcp.height)).collect();
    assert_eq!(names, [("A", None), ("B", Some(12.5))]);
    says(&list, "passed over, no points: feature 2 (LineString), feature 4 (no geometry)");
    let error = read_as("l.geojson", Some("EPSG:25832"), &geojson(&[boundary])).expect_err("no point");
    assert!(error.contains("feature 1") && error.contains("LineString"), "{error}");

    let two = feature(r#"{"type":"MultiPoint","coordinates":[[500200,6600300],[500201,6600301]]}"#, "D");
    let point = feature(r#"{"type":"Point","coordinates":[500100.5,6600200.5]}"#, "A");
    let error = read_as("l.geojson", Some("EPSG:25832"), &geojson(&[point, two])).expect_err("two points in one");
    assert!(error.contains("feature 2") && error.contains("MultiPoint"), "{error}");

    let placemark = |name: &str, geometry: &str| format!("<Placemark><name>{name}</name>{geometry}</Placemark>");
    let kml = |marks: &[String]| {
        let marks = marks.concat();
        format!(
            r#"<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document><Folder>{marks}</Folder></Document></kml>"#
        )
    };
    let line = placemark("track", "<LineString><coordinates>10.1,59.1 10.2,59.2</coordinates></LineString>");
    let points = [("A", "10.1,59.1,5"), ("B", "10.2,59.2,6")]
        .map(|(name, at)| placemark(name, &format!("<Point><coordinates>{at}</coordinates></Point>")));
    let list = read_as("l.kml", None, &kml(&[points[0].clone(), line.clone(), points[1].clone()])).expect("two points");
    assert_eq!(list.gcps.len(), 2);
    says(&list, "passed over, no points: feature 2 (LINESTRING)");
    let error = read_as("l.kml", None, &kml(&[line])).expect_err("no point");
    assert!(error.contains("no layer with points") || error.contains("it must be a point"), "{error}");
}
