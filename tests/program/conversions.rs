//! Lists of GCPs from every format into every other one and back: what comes back is what went in, but for what was
//! said to be lost.

use std::path::{Path, PathBuf};

use autoref_stream::gcp::convert::{ConvertOptions, Converted, ListFormat, convert};
use autoref_stream::gcp::{self, Gcp, GcpOptions, GcpRole};

const CRS: &str = "EPSG:25832";

/// Points with heights, accuracies, roles, letters beyond ASCII; coordinates with the digits that KOF has.
const SOURCE: &str = "name,easting,northing,height,sigma_m,sigma_height_m,role,crs\n\
    P1,570406.8605,7032516.8044,80.3184,0.012,0.02,control,EPSG:25832\n\
    Brønn 2,570413.3669,7032503.4822,80.1282,0.012,0.025,check,EPSG:25832\n\
    P3,570431.9676,7032512.5002,80.4122,0.015,0.02,control,EPSG:25832\n\
    P4,570425.3519,7032526.09,-1.25,0.5,0.9,control,EPSG:25832\n";

fn named(folder: &Path, stem: &str, format: ListFormat) -> PathBuf {
    let end = match format {
        ListFormat::Odm => "txt",
        ListFormat::Qgis => "points",
        ListFormat::MetashapeCsv | ListFormat::Pix4d => "csv",
        ListFormat::MetashapeXml | ListFormat::MicMac => "xml",
        other => other.name(),
    };
    folder.join(format!("{stem}-{}.{end}", format.name()))
}

fn to(input: &Path, output: &Path, format: ListFormat, crs: Option<&str>) -> Converted {
    let options = ConvertOptions { to: Some(format), crs: crs.map(str::to_owned), ..ConvertOptions::default() };
    convert(input, output, &options).unwrap_or_else(|e| panic!("{} to {}: {e}", input.display(), format.name()))
}

fn points(path: &Path, crs: Option<&str>) -> Vec<Gcp> {
    let options = GcpOptions { crs: crs.map(str::to_owned), to_crs: Some(CRS.into()), ..GcpOptions::default() };
    gcp::read(path, &options).unwrap_or_else(|e| panic!("{}: {e}", path.display())).gcps
}

fn is_lost(lost: &[String], what: &str) -> bool {
    lost.iter().any(|l| l.split_whitespace().next() == Some(what))
}

/// Of two lists that went through formats which lost `lost`.
fn assert_same(what: &str, before: &[Gcp], after: &[Gcp], lost: &[String], tolerance: f64) {
    assert_eq!(before.len(), after.len(), "{what}");
    for (a, b) in before.iter().zip(after) {
        assert_eq!(a.name, b.name, "{what}");
        let off = (a.easting - b.easting).hypot(a.northing - b.northing);
        assert!(off <= tolerance, "{what}: {} moved by {off}", a.name);
        if !is_lost(lost, "height") {
            let off = a.height.zip(b.height).map(|(a, b)| (a - b).abs());
            assert!(off.is_some_and(|d| d <= 1e-9), "{what}: {:?} became {:?}", a.height, b.height);
        }
        if !is_lost(lost, "sigma_m") {
            assert_eq!(a.sigma_m, b.sigma_m, "{what}");
        }
        if !is_lost(lost, "sigma_height_m") {
            assert_eq!(a.sigma_height_m, b.sigma_height_m, "{what}");
        }
        if !is_lost(lost, "role") {
            assert_eq!(a.role, b.role, "{what}");
        }
    }
}

#[test]
fn every_pair_of_formats_returns_what_it_did_not_name_as_lost() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let source = folder.path().join("source.csv");
    std::fs::write(&source, SOURCE).expect("writable");
    let truth = points(&source, None);
    assert_eq!(truth[1].role, GcpRole::Check);
    for (row, first) in ListFormat::WRITTEN.into_iter().enumerate() {
        let a = named(folder.path(), "a", first);
        let there = to(&source, &a, first, None);
        // What a format cannot say is said again by the caller.
        let crs = there.lost.iter().any(|l| l.starts_with("crs") && !l.contains("brought")).then_some(CRS);
        let degrees = matches!(first, ListFormat::Kml | ListFormat::Gpx);
        let near = if degrees { 0.002 } else { 1e-9 };
        assert_same(first.name(), &truth, &points(&a, crs), &there.lost, near);
        for (column, second) in ListFormat::WRITTEN.into_iter().enumerate() {
            // Each format comes first once and second once; all pairs with AUTOREF_LARGE=1.
            if !crate::common::large() && !(row + column).is_multiple_of(ListFormat::WRITTEN.len()) {
                continue;
            }
            if is_lost(&there.lost, "height") && matches!(second, ListFormat::Pix4d | ListFormat::MicMac) {
                continue;
            }
            let what = format!("{} to {} and back", first.name(), second.name());
            let b = named(folder.path(), &format!("b-{}", first.name()), second);
            let on = to(&a, &b, second, crs);
            let crs = on.lost.iter().any(|l| l.starts_with("crs") && !l.contains("brought")).then_some(if degrees {
                "EPSG:4326"
            } else {
                CRS
            });
            let lost = [there.lost.clone(), on.lost.clone()].concat();
            let near = if degrees || matches!(second, ListFormat::Kml | ListFormat::Gpx) { 0.002 } else { 1e-9 };
            // KOF has no columns for so many digits of degrees.
            let near = if degrees && second == ListFormat::Kof { 0.2 } else { near };
            assert_same(&what, &truth, &points(&b, crs), &lost, near);
        }
    }
}

#[test]
fn what_is_lost_is_named_and_what_is_not_is_not() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let source = folder.path().join("source.csv");
    std::fs::write(&source, SOURCE).expect("writable");
    for format in [ListFormat::GeoJson, ListFormat::Csv, ListFormat::MetashapeXml, ListFormat::GeoPackage] {
        assert_eq!(to(&source, &named(folder.path(), "n", format), format, None).lost, Vec::<String>::new());
    }
    let kof = to(&source, &folder.path().join("l.kof"), ListFormat::Kof, None).lost;
    for what in ["sigma_m of 4 points", "sigma_height_m of 4 points", "role (check point) of 1 point"] {
        assert!(kof.iter().any(|l| l == what), "{what}: {kof:?}");
    }
    assert!(kof.iter().any(|l| l.starts_with("crs EPSG:25832")), "{kof:?}");
    let noted = folder.path().join("noted.csv");
    std::fs::write(&noted, "name,easting,northing,surveyor\nA,570000,7032000,Kari\nB,570100,7032000,\n")
        .expect("writable");
    let lost = to(&noted, &folder.path().join("m.kof"), ListFormat::Kof, None).lost;
    assert_eq!(lost, ["column `surveyor`"]);
    let kept = to(&noted, &folder.path().join("m.geojson"), ListFormat::GeoJson, None);
    assert!(kept.lost.is_empty());
    assert!(std::fs::read_to_string(folder.path().join("m.geojson")).expect("written").contains("Kari"));
}

#[test]
fn names_are_no_formulas_and_heights_in_feet_become_metres() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let source = folder.path().join("source.csv");
    let names = "=SUM(A1),570000,7032000,300\n-P2,570100,7032000,310\nP3,570100,7032100,-4\n";
    std::fs::write(&source, format!("name,easting,northing,height\n{names}")).expect("writable");
    for format in [ListFormat::Csv, ListFormat::MetashapeCsv, ListFormat::Pix4d] {
        let table = named(folder.path(), "t", format);
        let done = to(&source, &table, format, None);
        let text = std::fs::read_to_string(&table).expect("written");
        assert!(text.contains("'=SUM(A1),") && text.contains("'-P2,") && text.contains(",-4"), "{text}");
        assert_eq!(done.lost, Vec::<String>::new());
        let back = to(&table, &folder.path().join("back.geojson"), ListFormat::GeoJson, Some(CRS));
        assert_eq!(back.lost, Vec::<String>::new(), "{format:?}");
        let read: Vec<String> = points(&folder.path().join("back.geojson"), None).into_iter().map(|g| g.name).collect();
        assert_eq!(read, ["=SUM(A1)", "-P2", "P3"], "{format:?}");
    }
    let points_file = named(folder.path(), "q", ListFormat::Qgis);
    to(&source, &points_file, ListFormat::Qgis, Some(CRS));
    assert!(std::fs::read_to_string(&points_file).expect("written").contains(",=SUM(A1),"), "no spreadsheet's file");
    let kml = folder.path().join("p.kml");
    let feet = "+proj=utm +zone=32 +datum=WGS84 +units=us-ft +vunits=us-ft";
    let lost = to(&source, &kml, ListFormat::Kml, Some(feet)).lost;
    assert!(lost.iter().any(|l| l.starts_with("heights in US survey foot")), "{lost:?}");
    let text = std::fs::read_to_string(&kml).expect("written");
    let place = text.split("<coordinates>").nth(1).and_then(|rest| rest.split('<').next()).expect("a point");
    let height: f64 = place.split(',').nth(2).and_then(|number| number.parse().ok()).expect("in space");
    assert!((height - 300.0 * 1200.0 / 3937.0).abs() < 1e-6, "{place}");
    for format in [ListFormat::Gml, ListFormat::Odm] {
        let lost = to(&source, &named(folder.path(), "c", format), format, Some("EPSG:25832+5941")).lost;
        assert!(lost.iter().any(|l| l.contains("NN2000")), "{lost:?}");
    }
}

#[test]
fn pixels_of_several_images_come_back() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let list = folder.path().join("gcp_list.txt");
    let text = "EPSG:25832\n570406.8605\t7032516.8044\t80.3\t10.5\t20.25\ta.tif\tP1\n570406.8605\t7032516.8044\t80.3\t30\t40\t\
        b.tif\tP1\n570413.3669\t7032503.4822\tNaN\t50\t60\ta.tif\tCHK-P2\n";
    std::fs::write(&list, text).expect("writable");
    let json = folder.path().join("a.geojson");
    assert_eq!(to(&list, &json, ListFormat::GeoJson, None).lost, Vec::<String>::new());
    let back = folder.path().join("back.txt");
    assert_eq!(to(&json, &back, ListFormat::Odm, None).lost, Vec::<String>::new());
    assert_eq!(std::fs::read_to_string(&back).expect("written"), text);
    // Metashape's markers, from OpenDroneMap's list and from what was itself read from markers.
    let (markers, again) = (folder.path().join("a.xml"), folder.path().join("again.xml"));
    assert_eq!(to(&list, &markers, ListFormat::MetashapeXml, None).lost, Vec::<String>::new());
    assert_eq!(to(&markers, &again, ListFormat::MetashapeXml, None).lost, Vec::<String>::new());
    for xml in [&markers, &again] {
        assert_eq!(to(xml, &back, ListFormat::Odm, None).lost, Vec::<String>::new());
        assert_eq!(std::fs::read_to_string(&back).expect("written"), text);
    }
    let kof = to(&markers, &folder.path().join("a.kof"), ListFormat::Kof, None).lost;
    assert!(kof.iter().any(|l| l == "pixels of 2 points"), "{kof:?}");
    let qgis = to(&list, &folder.path().join("a.points"), ListFormat::Qgis, None).lost;
    assert!(qgis.iter().any(|l| l == "pixels in further images of 1 point"), "{qgis:?}");
}

#[test]
fn geojson_with_north_first_is_settled_by_the_area_of_use_and_said() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, points: [[f64; 2]; 3], crs: &str| {
        let features: Vec<String> = points
            .iter()
            .enumerate()
            .map(|(i, [x, y])| {
                format!(
                    r#"{{"type":"Feature","properties":{{"name":"P{i}"}},"geometry":{{"type":"Point","coordinates":[{x},{y}]}}}}"#
                )
            })
            .collect();
        let path = folder.path().join(name);
        let text = format!(r#"{{"type":"FeatureCollection",{crs}"features":[{}]}}"#, features.join(","));
        std::fs::write(&path, text).expect("writable");
        path
    };
    let crs = r#""crs":{"type":"name","properties":{"name":"urn:ogc:def:crs:EPSG::25832"}},"#;
    let north = [[7_032_516.8, 570_406.9], [7_032_503.5, 570_413.4], [7_032_512.5, 570_432.0]];
    for (name, crs, how) in [("a.geojson", crs, "area of use"), ("b.geojson", "", "size of the numbers")] {
        let list = gcp::read(&write(name, north, crs), &GcpOptions::default()).expect("settled");
        assert_eq!((list.gcps[0].easting, list.gcps[0].northing), (570_406.9, 7_032_516.8));
        assert!(
            list.notes.iter().any(|n| n.contains("northing comes before easting") && n.contains(how)),
            "{:?}",
            list.notes
        );
    }
    let east = north.map(|[n, e]| [e, n]);
    let list = gcp::read(&write("c.geojson", east, crs), &GcpOptions::default()).expect("as it says");
    assert_eq!(list.gcps[0].easting, 570_406.9);
    assert!(!list.notes.iter().any(|n| n.contains("before")), "{:?}", list.notes);
}

#[test]
fn bad_input_gets_one_line() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("writable");
        path
    };
    let flat = write("flat.csv", "name,easting,northing\nA,570000,7032000\nB,570100,7032000\n");
    let error = |input: &Path, output: &str, options: ConvertOptions| {
        convert(input, &folder.path().join(output), &options).expect_err("refused").to_string()
    };
    let says = |text: String, words: &[&str]| {
        assert!(!text.contains('\n') && words.iter().all(|w| text.contains(w)), "{text}");
    };
    says(error(&flat, "a.xyz", ConvertOptions::default()), &["a.xyz", "--to"]);
    says(error(&flat, "gcp_list.txt", ConvertOptions::default()), &["flat.csv", "CRS", "--crs"]);
    let micmac = ConvertOptions { to: Some(ListFormat::MicMac), ..ConvertOptions::default() };
    says(error(&flat, "a.xml", micmac), &["flat.csv", "row 2", "`A`", "height"]);
    let long = write("long.csv", "name,easting,northing\nAbcdefghijk1,570000,7032000\nAbcdefghijk2,570100,7032000\n");
    says(error(&long, "a.kof", ConvertOptions::default()), &["row 3", "Abcdefghij", "rename"]);
    let check = write("check.csv", "name,easting,northing\nCHK-1,570000,7032000\n");
    let odm = ConvertOptions { crs: Some(CRS.into()), ..ConvertOptions::default() };
    says(error(&check, "gcp_list.txt", odm), &["row 2", "`CHK-1` is a control point", "rename"]);
    let wrong = ConvertOptions { from: Some(ListFormat::MetashapeXml), ..ConvertOptions::default() };
    assert!(!error(&flat, "b.csv", wrong).contains('\n'));
    assert!(!folder.path().join("a.xml").exists() && !folder.path().join("a.kof").exists());
    assert!("shape".parse::<ListFormat>().expect_err("no format").contains("geojson"));
}
