//! Lists of control points as found in the field and as other programs write them: read right, or refused with the line
//! at fault.

use crate::lists_folder::Folder;
use std::path::Path;

use crate::common::data;
use autoref_raster::crs::Coordinate;
use autoref_stream::gcp::{self, GcpList, GcpOptions, GcpRole, Reproject};

fn with_crs(crs: &str) -> GcpOptions {
    GcpOptions { crs: Some(crs.into()), ..GcpOptions::default() }
}

fn place(list: &GcpList, i: usize) -> (&str, f64, f64, Option<f64>) {
    let gcp = &list.gcps[i];
    (gcp.name.as_str(), gcp.easting, gcp.northing, gcp.height)
}

/// Every file of the data folder with what it holds: count, CRS, first point.
#[test]
fn lists_as_found_in_the_field() {
    type Expected = (usize, &'static str, (&'static str, f64, f64, Option<f64>));
    let cases: [(&str, Expected); 6] = [
        ("lists/OpenDroneMapExercise.txt", (6, "EPSG:32654", ("1", 487660.486620762, 4227087.75422419, Some(12.8)))),
        ("lists/ServoPhotogrammetryMay17.txt", (7, "EPSG:32615", ("1", 367615.7, 4023959.8, Some(374.9)))),
        ("lists/ochota.txt", (3, "EPSG:2180", ("1", 634676.0, 485344.0, Some(112.0)))),
        ("lists/odm_br.txt", (15, "", ("HV01", 658528.361, 7167002.098, Some(890.636)))),
        (
            "lists/odm_data_bellus.txt",
            (4, "EPSG:32617", ("1", 441_024.157_049_114_1, 4_564_001.874_709_157, Some(345.1689312))),
        ),
        ("targets/gcp_list.txt", (10, "", ("gcp02", 235269.88, 3811198.11, Some(0.0)))),
    ];
    let mut seen = Vec::new();
    for (name, (count, crs, first)) in cases {
        seen.push(name);
        let Some(path) = data(name) else { continue };
        let list = gcp::read(&path, &GcpOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(list.gcps.len(), count, "{name}");
        assert_eq!(place(&list, 0), first, "{name}");
        let found = list.crs.as_ref().expect("every one names its CRS");
        if crs.is_empty() {
            assert!(found.name().contains("unknown") || found.wkt().contains("WGS"), "{name}: {}", found.wkt());
            assert_eq!(found.metres_per_unit(), 1.0);
        } else {
            assert_eq!(found.label(), crs, "{name}");
        }
        assert!(!list.notes.iter().any(|note| note.contains("northing comes before")), "{name}: {:?}", list.notes);
    }
    // Longitude and latitude, other numbers for the same points than gcp_list.txt: projected, and that is said.
    if let Some(path) = data("targets/gcp_list_noimg.txt") {
        seen.push("targets/gcp_list_noimg.txt");
        let list = gcp::read(&path, &GcpOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((list.gcps.len(), list.crs.as_ref().map(|c| c.label()).as_deref()), (10, Some("EPSG:32611")));
        let (name, easting, northing, height) = place(&list, 0);
        assert_eq!((name, height), ("gcp01", Some(0.0)));
        // By cs2cs.
        assert!((easting - 235277.61).abs() < 0.01 && (northing - 3811190.36).abs() < 0.01, "{easting} {northing}");
        assert!(list.notes.iter().any(|note| note.contains("UTM zone of their mean")), "{:?}", list.notes);
    }
    // The lists of OpenDroneMap's own tests, and what those expect.
    seen.push("lists/gcp_latlon_valid.txt");
    if let Some(path) = data("lists/gcp_latlon_valid.txt") {
        let list = gcp::read(&path, &GcpOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let (_, e, n, _) = place(&list, 0);
        assert!((e - 609_865.707_705_413_7).abs() < 0.001 && (n - 4_950_688.361_817_497).abs() < 0.001, "{e} {n}");
    }
    seen.push("lists/sheffield_cross_gcp_file.txt");
    if let Some(path) = data("lists/sheffield_cross_gcp_file.txt") {
        let list = gcp::read(&path, &GcpOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(list.gcps.len(), 5, "{:?}", list.gcps);
    }
    // One point orients nothing, and that is said.
    for name in ["gcp_extras.txt", "gcp_michigan_feet_valid.txt", "gcp_latlon_south.txt", "gcp_utm_north_valid.txt"] {
        seen.push(name);
        let Some(path) = data(&format!("lists/{name}")) else { continue };
        let error = gcp::read(&path, &GcpOptions::default()).expect_err("one point").to_string();
        assert!(error.contains("1 point") && error.contains(name), "{error}");
    }
    // A licence beside them is no list.
    if let Some(path) = data("targets/license.txt") {
        let error = gcp::read(&path, &GcpOptions::default()).expect_err("no list").to_string();
        assert!(error.contains("license.txt") && error.contains("row 1"), "{error}");
    }
    // Nothing new may lie in the folder unseen.
    for folder in ["lists", "targets"] {
        let Some(path) = data(folder) else { continue };
        for entry in std::fs::read_dir(path).expect("readable").flatten() {
            let name = format!("{folder}/{}", entry.file_name().to_string_lossy());
            let known = seen.iter().any(|seen| name.ends_with(seen))
                || name.ends_with(".jpg")
                || name.ends_with("license.txt")
                || name.contains("LICENSE");
            assert!(known, "{name} has no expectation");
        }
    }
}

/// Three points near Trondheim.
const POINTS: [(&str, f64, f64, f64); 3] = [
    ("P1", 570406.861, 7032516.804, 80.318),
    ("P2", 570413.367, 7032503.482, 80.128),
    ("C 3", 570431.968, 7032512.5, 80.412),
];

fn check_points(list: &GcpList, what: &str) {
    assert_eq!(list.gcps.len(), 3, "{what}");
    for (i, (name, easting, northing, height)) in POINTS.into_iter().enumerate() {
        let (found, e, n, h) = place(list, i);
        let plain = found.replace('_', " ");
        assert!(plain == name || found == (i + 1).to_string(), "{what}: {found}");
        assert!((e - easting).abs() < 1e-6 && (n - northing).abs() < 1e-6, "{what}: {e} {n}");
        assert!(h.is_none_or(|h| (h - height).abs() < 1e-6), "{what}: {h:?}");
    }
}

/// Everything that people do to a table.
#[test]
fn tables_of_every_kind() {
    let folder = Folder::new();
    let comma = |v: f64| format!("{v}").replace('.', ",");
    let rows = |f: &dyn Fn(&str, f64, f64, f64) -> String| -> String {
        POINTS.iter().map(|(name, e, n, h)| f(name, *e, *n, *h)).collect()
    };
    let pix4d = rows(&|name, e, n, h| format!("{name},{e},{n},{h},0.02,0.03\n"));
    let semicolons = rows(&|name, e, n, h| format!("{name};{};{};{}\n", comma(n), comma(e), comma(h)));
    let tabs = rows(&|name, e, n, h| format!("{name}\t{n}\t{e}\t{h}\n"));
    let blanks = rows(&|name, e, n, h| format!("{} {e}  {n} {h}\n", name.replace(' ', "_")));
    let behind = rows(&|name, e, n, _| format!("{e},{n},{name}\n"));
    let numbered = POINTS
        .iter()
        .enumerate()
        .map(|(i, (_, e, n, h))| format!("{} {} {} {}\n", i + 1, comma(*e), comma(*n), comma(*h)))
        .collect::<String>();
    let thousands = rows(&|name, e, n, h| {
        format!("{name};{} {};7 032 {};{}\n", e as u64 / 1000, comma(e % 1000.0), comma(n % 1000.0), comma(h))
    });
    let metashape = format!(
        "#CoordinateSystem: EPSG:25832\n#Label,X/Easting,Y/Northing,Z/Altitude,Accuracy_(m)\n{}# Total error\n",
        rows(&|name, e, n, h| format!("\"{name}\",{e},{n},{h},0.01\n"))
    );
    let latin1: Vec<u8> = format!("Navn;Øst;Nord;Høyde\n{}", rows(&|name, e, n, h| format!("{name};{e};{n};{h}\n")))
        .chars()
        .map(|c| c as u8)
        .collect();
    let utf16: Vec<u8> = [0xFF, 0xFE]
        .into_iter()
        .chain(
            format!("Name,Easting [m],Northing [m]\r\n{}", rows(&|name, e, n, _| format!("{name},{e},{n}\r\n")))
                .encode_utf16()
                .flat_map(u16::to_le_bytes),
        )
        .collect();
    let cases: Vec<(&str, Vec<u8>)> = vec![
        ("pix4d.csv", pix4d.clone().into_bytes()),
        ("pix4d.txt", pix4d.into_bytes()),
        ("north-first.csv", semicolons.clone().into_bytes()),
        ("semicolons.csv", format!("\u{feff}Punkt;N;Ø;H\n\n{semicolons};;;\n").into_bytes()),
        ("title.csv", format!("Oppdrag: E6 Tiller\nPunkt;N;E;H\n{semicolons}").into_bytes()),
        ("tabs.txt", format!("id\tnorthing\teasting\televation\n# new\n{tabs}").into_bytes()),
        ("swapped-xy.txt", format!("id\tx\ty\tz\n{tabs}").into_bytes()),
        ("blanks.txt", blanks.into_bytes()),
        ("behind.csv", behind.into_bytes()),
        ("numbered.txt", numbered.into_bytes()),
        ("thousands.csv", format!("name;e;n;h\n{thousands}").into_bytes()),
        ("metashape.csv", metashape.into_bytes()),
        ("latin1.csv", latin1),
        ("utf16.csv", utf16),
    ];
    for (name, content) in cases {
        let list = folder.read(name, content, &with_crs("EPSG:25832")).unwrap_or_else(|e| panic!("{e}"));
        check_points(&list, name);
        let swapped = list.notes.iter().any(|note| note.contains("northing comes before easting"));
        assert_eq!(swapped, matches!(name, "north-first.csv" | "swapped-xy.txt"), "{name}: {:?}", list.notes);
    }
    // By the size of the numbers alone.
    let list = folder.read("a.csv", &semicolons, &GcpOptions::default()).expect("readable");
    check_points(&list, "no CRS");
    assert!(list.notes.iter().any(|note| note.contains("size of the numbers")), "{:?}", list.notes);
}

#[test]
fn lists_of_other_programs() {
    let folder = Folder::new();
    let [p1, p2, c3] = POINTS;
    let row = |p: (&str, f64, f64, f64)| format!("{},{},10.5,-20.5,1,0,0,0\n", p.1, p.2);
    let qgis =
        format!("mapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n{}{}{}1,2,3,-4,0,0,0,0\n", row(p1), row(p2), row(c3));
    let old: String = POINTS.iter().map(|(_, e, n, _)| format!("{e}\t{n}\t10\t-20\t1\n")).collect();
    let old_header = qgis.replace("sourceX,sourceY", "pixelX,pixelY");
    let markers: String = POINTS
        .iter()
        .enumerate()
        .map(|(i, (name, e, n, h))| format!("<marker id=\"{i}\" label=\"{name}\"><reference x=\"{e}\" y=\"{n}\" z=\"{h}\" enabled=\"{}\"/></marker>\n", i != 2))
        .collect();
    let metashape = format!(
        "<?xml version=\"1.0\"?>\n<document version=\"1.4.0\"><chunk><markers>\n{markers}<marker id=\"9\" label=\"loose\"/></markers><reference>EPSG:25832</reference></chunk></document>"
    );
    let appuis: String = POINTS
        .iter()
        .map(|(name, e, n, h)| format!("<OneAppuisDAF>\n<Pt>{e} {n} {h}</Pt>\n<NamePt> {name} </NamePt>\n<Incertitude>1 1 1</Incertitude>\n</OneAppuisDAF>\n"))
        .collect();
    let kof: String = POINTS
        .iter()
        .map(|(name, e, n, h)| format!(" 05 {name:<10} {:<8} {n:>12.3} {e:>11.3} {h:>8.3}\n", "5001"))
        .collect();
    let odm: String = POINTS
        .iter()
        .flat_map(|(name, e, n, h)| {
            ["a.jpg", "b.jpg"].map(|image| format!("{e}\t{n}\t{h}\t10.5\t20\t{image}\t{name}\n"))
        })
        .collect();
    let cases = [
        ("a.points", format!("#CRS: EPSG:25832\n{qgis}")),
        ("b.points", qgis),
        ("c.points", old_header),
        ("d.points", old),
        ("e.xml", metashape),
        (
            "f.xml",
            format!(
                "<?xml version=\"1.0\" ?>\n<Global>\n<DicoAppuisFlottant>\n{appuis}</DicoAppuisFlottant>\n</Global>\n"
            ),
        ),
        ("g.kof", format!("-05 PPPPPPPPPP KKKKKKKK XXXXXXXX.XXX YYYYYYY.YYY ZZZZ.ZZZ\n 00 KOORDSYS 22\n{kof} 09_99\n")),
        ("h.txt", format!("ETRS89 UTM 32N\n# two pictures\n{odm}")),
        ("i.txt", format!("EPSG:25832\n{}", odm.replace('\t', " ").replace("C 3", "C_3"))),
    ];
    for (name, content) in cases {
        let list = folder.read(name, content, &with_crs("EPSG:25832")).unwrap_or_else(|e| panic!("{e}"));
        check_points(&list, name);
        if name == "e.xml" {
            assert_eq!(list.gcps[2].role, GcpRole::Check, "a marker that is switched off");
            assert!(list.notes.iter().any(|note| note.contains("1 markers")), "{:?}", list.notes);
        }
    }
}

/// A vector file of GDAL's making, with a name and a role for each point.
fn vector(path: &Path, driver: &str, epsg: u32, role: &str) {
    use gdal::spatial_ref::{AxisMappingStrategy, SpatialRef};
    use gdal::vector::{Geometry, LayerAccess, LayerOptions, OGRFieldType, OGRwkbGeometryType};
    let driver = gdal::DriverManager::get_driver_by_name(driver).expect("GDAL has it");
    let mut dataset = driver.create_vector_only(path).expect("writable");
    let mut reference = SpatialRef::from_epsg(epsg).expect("known");
    reference.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
    let name = if role.is_empty() { "waypoints" } else { "points" };
    let layer = dataset
        .create_layer(LayerOptions { name, srs: Some(&reference), ty: OGRwkbGeometryType::wkbPoint25D, options: None })
        .expect("a layer");
    layer.create_defn_fields(&[("name", OGRFieldType::OFTString)]).ok();
    if !role.is_empty() {
        layer.create_defn_fields(&[("role", OGRFieldType::OFTString)]).expect("a column");
    }
    let from = autoref_raster::crs::Crs::from_epsg(25832).expect("known");
    let to = autoref_raster::crs::Crs::from_epsg(epsg).expect("known");
    for (i, (name, e, n, h)) in POINTS.into_iter().enumerate() {
        let mut at = [Coordinate { x: e, y: n, height: None }];
        from.transform(&mut at, &to, 1.5).expect("near enough");
        let mut point = Geometry::empty(OGRwkbGeometryType::wkbPoint25D).expect("a point");
        point.add_point((at[0].x, at[0].y, h));
        let mut feature = gdal::vector::Feature::new(layer.defn()).expect("a feature");
        feature.set_geometry(point).expect("a point");
        let title = feature.field_index("name").or_else(|_| feature.field_index("Name")).expect("a column");
        feature.set_field_string(title, name).expect("text");
        // GPX keeps heights in a column of its own.
        if let Ok(column) = feature.field_index("ele") {
            feature.set_field_double(column, h).expect("a number");
        }
        if !role.is_empty() {
            let column = feature.field_index("role").expect("a column");
            feature.set_field_string(column, if i == 2 { role } else { "control" }).expect("text");
        }
        feature.create(&layer).expect("written");
    }
}

#[test]
fn whatever_ogr_reads() {
    let folder = Folder::new();
    autoref_raster::initialise_gdal(0);
    for (name, driver, epsg, role) in [
        ("a.gpkg", "GPKG", 25832, "check"),
        ("b.shp", "ESRI Shapefile", 25832, "Check Point"),
        ("c.kml", "KML", 4326, "check"),
        ("d.gpx", "GPX", 4326, ""),
        ("e.fgb", "FlatGeobuf", 25832, "check"),
        ("f.gml", "GML", 25832, "check"),
    ] {
        let path = folder.0.path().join(name);
        vector(&path, driver, epsg, role);
        let options = GcpOptions { to_crs: Some("EPSG:25832".into()), ..GcpOptions::default() };
        let list = gcp::read(&path, &options).unwrap_or_else(|e| panic!("{e}"));
        for (title, e, n, h) in POINTS {
            // FlatGeobuf sorts what it holds.
            let i = list.gcps.iter().position(|g| g.name == title).unwrap_or_else(|| panic!("{name} has no {title}"));
            let (_, east, north, height) = place(&list, i);
            // Degrees are written with fewer digits.
            let tolerance = if epsg == 4326 { 2e-4 } else { 1e-9 };
            assert!((east - e).abs() < tolerance && (north - n).abs() < tolerance, "{name}: {east} {north}");
            assert!(height.is_some_and(|height| (height - h).abs() < 1e-3), "{name}: {height:?}");
        }
        if !role.is_empty() && driver != "KML" {
            let checks: Vec<&str> =
                list.gcps.iter().filter(|g| g.role == GcpRole::Check).map(|g| g.name.as_str()).collect();
            assert_eq!(checks, ["C 3"], "{name}");
            let by_attribute = GcpOptions { check: vec!["role=c*".into()], ..options };
            let list = gcp::read(&path, &by_attribute).unwrap_or_else(|e| panic!("{e}"));
            assert!(list.gcps.iter().all(|g| g.role == GcpRole::Check), "{name}");
        }
    }
    let waypoints = "<gpx version=\"1.1\" creator=\"x\" xmlns=\"http://www.topografix.com/GPX/1/1\"><wpt lat=\"63.4\" lon=\"10.4\"><ele>80.3</ele><name>P1</name></wpt><wpt lat=\"63.41\" lon=\"10.41\"><name>P2</name></wpt></gpx>";
    let list = folder.read("w.xml", waypoints, &GcpOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((list.gcps[0].height, list.gcps[1].height), (Some(80.3), None), "no height is not a height of 0");
    let error = gcp::read(&folder.write("x.gpkg", b"SQLite format 3\0nonsense"), &GcpOptions::default());
    assert!(error.expect_err("broken").to_string().contains("x.gpkg"));
}

#[test]
fn what_is_no_list_is_refused_with_the_line_at_fault() {
    let folder = Folder::new();
    let cases: [(&str, &str, &str); 14] = [
        ("a.csv", "name,easting,northing\nA,1000,2000\nB,x,4000\n", "row 3"),
        ("b.csv", "name,easting,northing\nA,1000,2000\nB,,4000\n", "row 3"),
        ("c.csv", "name,easting,northing\nA,1000,2000\n\nA,1500,4000\n", "row 4"),
        ("d.csv", "name,height\nA,1\n", "no column for the easting"),
        ("e.txt", "EPSG:25832\n570406 7032516 80 10 20 a.jpg A\n570406 7032516 80 10 twenty a.jpg A\n", "row 3"),
        ("f.txt", "EPSG:25832\n570406 7032516 80 10 20 a.jpg A\n570999 7032516 80 10 20 b.jpg A\n", "row 3"),
        ("g.txt", "Gauss Kruger 4\n570406 7032516 80 10 20 a.jpg A\n570407 7032519 80 1 2 a.jpg B\n", "row 1"),
        ("h.txt", "P1 570406 7032516\nP2 570407\nP3 570408 7032512\n", "row 2"),
        ("i.points", "mapX,mapY,sourceX,sourceY,enable\n1,2,3,4,1\n1,two,3,4,1\n", "row 3"),
        ("j.kof", " 05 P1        5001     7032516.804   570406.861  80.318\n 05 P2 north east\n", "row 2"),
        (
            "k.xml",
            "<document><chunk><markers>\n<marker label=\"A\"><reference x=\"1\" y=\"b\"/></marker>\n</markers></chunk></document>",
            "row 2",
        ),
        ("l.geojson", "{\"type\": \"FeatureCollection\",\n\"features\": [}", "line 2"),
        ("m.csv", "", "no points"),
        ("n.csv", "name;lon;lat\nA;10,4;63,4\nB;10,5;163,4\n", "no degrees"),
    ];
    for (name, content, word) in cases {
        let error = folder.read(name, content, &GcpOptions::default()).expect_err(name);
        assert!(error.contains(word) && error.contains(name), "{name}: {error}");
        assert_eq!(error.lines().count(), 1, "{error}");
    }
}

#[test]
fn nothing_is_fitted_in_degrees() {
    let folder = Folder::new();
    let degrees = "name,x,y\nA,10.41,63.42\nB,10.42,63.43\nC,10.43,63.42\n";
    let error = folder.read("a.csv", degrees, &GcpOptions::default()).expect_err("degrees without a CRS");
    assert!(error.contains("degrees") && error.contains("--crs"), "{error}");
    let list = folder.read("a.csv", degrees, &with_crs("EPSG:4258")).expect("projected");
    assert_eq!(list.crs.as_ref().map(|c| c.label()).as_deref(), Some("EPSG:25832"), "the datum stays");
    assert!(list.notes.iter().any(|note| note.contains("EPSG:25832")), "{:?}", list.notes);
    let options = GcpOptions { to_crs: Some("EPSG:4326".into()), ..with_crs("EPSG:4258") };
    let error = folder.read("a.csv", degrees, &options).expect_err("a fit in degrees");
    assert!(error.contains("nothing can be fitted"), "{error}");
    // Latitude first, as Pix4D has it where the CRS does: seen because a latitude ends at 90.
    let list = folder.read("b.csv", "A,34.1,-119.88\nB,34.2,-119.87\n", &with_crs("EPSG:4326")).expect("swapped");
    assert!(list.gcps[0].northing > 3.7e6 && list.gcps[0].easting < 1e6, "{:?}", list.gcps[0]);
}

#[test]
fn feet_are_fitted_in_metres_and_written_in_feet() {
    let folder = Folder::new();
    let text = "name,easting,northing,height\nA,980000,195000,30\nB,980100,195000,31\nC,980100,195100,32\n";
    let survey_foot = 1200.0 / 3937.0;
    let list = folder.read("a.csv", text, &with_crs("EPSG:2263")).expect("US survey feet");
    assert!((list.gcps[0].easting - 980000.0 * survey_foot).abs() < 1e-6);
    assert!((list.gcps[0].height.expect("kept") - 30.0 * survey_foot).abs() < 1e-9);
    assert!(list.notes.iter().any(|note| note.contains("0.304800610")), "{:?}", list.notes);
    let mut back = [Coordinate { x: list.gcps[1].easting, y: list.gcps[1].northing, height: list.gcps[1].height }];
    list.working_crs.leave(&mut back).expect("a scale");
    assert!((back[0].x - 980100.0).abs() < 1e-9 && (back[0].height.expect("kept") - 31.0).abs() < 1e-9, "{back:?}");
    let fitted = autoref_raster::coords::GeoTransform([1000.0, 0.03, 0.0, 2000.0, 0.0, -0.03]);
    let delivered = list.working_crs.deliver(&fitted, (100.0, 100.0)).expect("a scale");
    assert!((delivered.transform.0[1] - 0.03 / survey_foot).abs() < 1e-15 && delivered.departure_px == 0.0);
    // International feet are 2 ppm shorter: 0.6 m at this distance from the origin.
    let international = folder
        .read("a.csv", text, &with_crs("+proj=lcc +lat_0=40 +lon_0=-74 +lat_1=41 +lat_2=40 +datum=NAD83 +units=ft"))
        .expect("international feet");
    assert!((list.gcps[0].easting - international.gcps[0].easting - 0.5974).abs() < 1e-3);
}

#[test]
fn after_the_fit_an_affine_transform_says_what_it_leaves_out() {
    let folder = Folder::new();
    let text = "name,easting,northing\nA,570000,7032000\nB,570400,7032000\nC,570400,7032400\n";
    let options =
        GcpOptions { to_crs: Some("EPSG:25833".into()), reproject: Reproject::After, ..with_crs("EPSG:25832") };
    let list = folder.read("a.csv", text, &options).expect("readable");
    assert_eq!(list.gcps[0].easting, 570000.0, "the points stay where they are until the fit");
    assert_eq!(list.crs.as_ref().map(|c| c.label()).as_deref(), Some("EPSG:25833"));
    let fitted = autoref_raster::coords::GeoTransform([570000.0, 0.03, 0.001, 7032400.0, 0.001, -0.03]);
    let delivered = list.working_crs.deliver(&fitted, (13000.0, 13000.0)).expect("one datum");
    assert!(delivered.departure_px < 0.5 && delivered.departure_px > 0.0, "{}", delivered.departure_px);
    assert!(delivered.notes[0].contains("px"), "{:?}", delivered.notes);
    // The centre of the image agrees with PROJ.
    let centre = autoref_raster::coords::PixelPoint { x: 6500.0, y: 6500.0 };
    let ground = fitted.apply(centre);
    let mut exact = [Coordinate { x: ground.easting, y: ground.northing, height: None }];
    list.working_crs.leave(&mut exact).expect("one datum");
    let found = delivered.transform.apply(centre);
    assert!((found.easting - exact[0].x).hypot(found.northing - exact[0].y) < 0.02, "{found:?} {exact:?}");
}

#[test]
fn heights_need_a_reference_to_be_changed() {
    let folder = Folder::new();
    let text = "name,easting,northing,height\nA,570000,7032000,80\nB,570400,7032000,81\nC,570400,7032400,82\n";
    let to = |crs: &str, to: &str| {
        let options = GcpOptions { to_crs: Some(to.into()), ..with_crs(crs) };
        folder.read("a.csv", text, &options)
    };
    let error = to("EPSG:25832", "EPSG:5972").expect_err("heights of what?");
    assert!(error.contains("heights") && error.contains("EPSG:25832"), "{error}");
    let list = to("EPSG:5972", "EPSG:25833").expect("heights stay");
    assert_eq!(list.gcps[0].height, Some(80.0));
    assert!(list.notes.iter().any(|note| note.contains("heights stay")), "{:?}", list.notes);
    let list = to("EPSG:5972", "EPSG:5973").expect("one vertical system");
    assert!((list.gcps[0].height.expect("kept") - 80.0).abs() < 1e-9);
}

#[test]
fn points_are_chosen_by_name_pattern_and_attribute() {
    let folder = Folder::new();
    let text = "name;e;n;kind\nG1;1000;2000;a\nG2;1100;2000;b\nC1;1100;2100;b\nC2;1000;2100;a\nX=1;1050;2050;a\n";
    let chosen = |names: &[&str], check: &[&str]| {
        let owned = |list: &[&str]| list.iter().map(|s| s.to_string()).collect();
        let options = GcpOptions { names: owned(names), check: owned(check), ..GcpOptions::default() };
        folder.read("a.csv", text, &options).map(|list| {
            list.gcps
                .iter()
                .map(|g| format!("{}{}", g.name, if g.role == GcpRole::Check { "!" } else { "" }))
                .collect::<Vec<_>>()
                .join(" ")
        })
    };
    assert_eq!(chosen(&[], &["C*"]).expect("known"), "G1 G2 C1! C2! X=1");
    assert_eq!(chosen(&["G?", "C1"], &["G2"]).expect("known"), "G1 G2! C1");
    assert_eq!(chosen(&[], &["kind=b"]).expect("known"), "G1 G2! C1! C2 X=1");
    assert_eq!(chosen(&[], &["X=1"]).expect("known"), "G1 G2 C1 C2 X=1!");
    let error = chosen(&[], &["K*"]).expect_err("no such point");
    assert!(error.contains("`K*`") && error.contains("G1"), "{error}");
}

/// Metashape escapes the quotation marks of its WKT, MicMac ampersands of names: an entity does not cut a text in two.
#[test]
fn entities_in_xml_are_read_where_they_stand() {
    let wkt = autoref_raster::crs::Crs::from_epsg(25832).expect("a zone").wkt().replace('"', "&quot;");
    let metashape = format!(
        "<document><chunks><chunk><markers><marker id=\"0\" label=\"A &amp; B\"><reference x=\"570000\" y=\"7032000\" z=\"3\"/>\
         </marker><marker id=\"1\" label=\"C\"><reference x=\"570100\" y=\"7032000\" z=\"3\"/></marker></markers><reference>{wkt}</reference></chunk></chunks></document>"
    );
    let list = Folder::new().read("m.xml", metashape, &GcpOptions::default()).expect("readable");
    assert_eq!(place(&list, 0), ("A & B", 570_000.0, 7_032_000.0, Some(3.0)));
    assert_eq!(list.crs.map(|crs| crs.label()).as_deref(), Some("EPSG:25832"), "{:?}", list.notes);
    // An entity that only the document's own head knows is no reason to call the marker by its number.
    let own = "<document><chunk><markers><marker id=\"7\" label=\"&site;1\"><reference x=\"1\" y=\"2\" z=\"3\"/></marker>\
               <marker id=\"8\" label=\"&site;2\"><reference x=\"5\" y=\"9\" z=\"3\"/></marker></markers></chunk></document>";
    let list = Folder::new().read("own.xml", own, &GcpOptions::default()).expect("readable");
    assert_eq!(list.gcps.iter().map(|g| g.name.as_str()).collect::<Vec<_>>(), ["&site;1", "&site;2"]);
    let micmac = "<Global><DicoAppuisFlottant><OneAppuisDAF><Pt>570000 7032000 3</Pt><NamePt>A &amp; B</NamePt>\
                  <Incertitude>0.02 0.02 0.05</Incertitude></OneAppuisDAF><OneAppuisDAF><Pt>570100 7032000 3</Pt>\
                  <NamePt>C</NamePt></OneAppuisDAF></DicoAppuisFlottant></Global>";
    let list = Folder::new().read("a.xml", micmac, &with_crs("EPSG:25832")).expect("readable");
    assert_eq!(place(&list, 0), ("A & B", 570_000.0, 7_032_000.0, Some(3.0)));
    assert_eq!((list.gcps[0].sigma_m, list.gcps[0].sigma_height_m), (Some(0.02), Some(0.05)));
}

#[test]
fn titles_win_over_rows_that_look_like_observations() {
    let folder = Folder::new();
    let utm = with_crs("EPSG:32633");
    let point = ("1", 610_852.39, 5_277_733.59, Some(463.662));
    // Names that are numbers, and five numbers behind them, as a list of OpenDroneMap begins.
    for (content, sigmas) in [
        (
            "Name;Easting;Northing;Elevation;Longitude;Latitude\n\
             1;610852.39;5277733.59;463.662;16.47640;47.64350\n2;610872.97;5277729.76;461.732;16.47667;47.64347\n",
            (None, None),
        ),
        (
            "name,easting,northing,height,sigma_m,sigma_height_m\n1,610852.39,5277733.59,463.662,0.01,0.02\n\
             2,610872.97,5277729.76,461.732,0.01,0.02\n",
            (Some(0.01), Some(0.02)),
        ),
        (
            "# N X Y Z Sx Sy Sz\n1 610852.39 5277733.59 463.662 0.03 0.03 0.05\n2 610872.97 5277729.76 461.732 1 1 2\n",
            (Some(0.03), Some(0.05)),
        ),
        (
            "1 610852.39 5277733.59 463.662 0.03 0.03 0.05\n2 610872.97 5277729.76 461.732 0.1 0.1 0.2\n",
            (Some(0.03), Some(0.05)),
        ),
        ("1;610852.39;5277733.59;463.662*\n2;610872.97;5277729.76;461.732*\n", (None, None)),
    ] {
        let list = folder.read("list.csv", content, &utm).unwrap_or_else(|e| panic!("{content}: {e}"));
        // A number with a mark is no height that could be trusted, and no name.
        let height = if content.contains('*') { None } else { point.3 };
        assert_eq!(place(&list, 0), (point.0, point.1, point.2, height), "{content}");
        let near = |a: Option<f64>, b: Option<f64>| a.zip(b).map_or(a == b, |(a, b)| (a - b).abs() < 1e-12);
        assert!(near(list.gcps[0].sigma_m, sigmas.0) && near(list.gcps[0].sigma_height_m, sigmas.1), "{content}");
    }
    // Datums begin titles, too.
    let titles = "WGS84 Latitude,WGS84 Longitude,name\n47.6435,16.4764,A\n47.6445,16.4774,B\n";
    let list =
        folder.read("list.csv", titles, &GcpOptions { to_crs: Some("EPSG:32633".into()), ..GcpOptions::default() });
    assert_eq!(list.map(|list| list.gcps.len()).map_err(|e| e.contains("reference system")), Ok(2));
    // Colours of a cloud are no accuracies.
    let cloud = "665187.5 5648349.9 241.8 117 73 49\n665188.5 5648350.9 241.9 91 87 74\n";
    let list = folder.read("list.xyz", cloud, &utm).expect("points");
    assert!(
        list.gcps[0].sigma_m.is_none() && list.notes.iter().any(|n| n.contains("column 4, 5, 6")),
        "{:?}",
        list.notes
    );
}

#[test]
fn observations_need_no_reference_system_above_them() {
    let folder = Folder::new();
    let rows = "668184.6 5000000.1 100 792 1295 a.jpeg G1\n668184.6 5000000.1 100 392 195 b.jpeg G1\n\
                668204.6 5000010.1 101 10 20 a.jpeg CHK-G2\n";
    let list = folder.read("gcp_list.txt", rows, &with_crs("EPSG:32633")).expect("two points");
    assert_eq!(place(&list, 0), ("G1", 668_184.6, 5_000_000.1, Some(100.0)));
    assert_eq!((list.gcps.len(), list.gcps[1].role), (2, GcpRole::Check));
    let list = folder.read("gcp_list.txt", rows.replace(' ', ", "), &with_crs("EPSG:32633")).expect("two points");
    assert_eq!(place(&list, 0), ("G1", 668_184.6, 5_000_000.1, Some(100.0)));
}

#[test]
fn columns_that_tell_points_apart_are_names() {
    let folder = Folder::new();
    let utm = with_crs("EPSG:32633");
    let named = |titles: &str, ids: [&str; 2]| {
        let text = format!("{titles}\n{},500000.5,6000000.5,1\n{},500010.5,6000010.5,2\n", ids[0], ids[1]);
        let list = folder.read("list.csv", text, &utm).expect("two points");
        list.gcps.iter().map(|gcp| gcp.name.clone()).collect::<Vec<_>>()
    };
    assert_eq!(named("local_id,POINT_X,POINT_Y,Altitude", ["23", "2"]), ["23", "2"]);
    assert_eq!(named("GCP_PointNr,E_GNSS,N_GNSS,H_GNSS", ["p", "q"]), ["p", "q"]);
    // Words alone win over words with a system; letters that may mean other things are no accuracies by themselves.
    let text = "Name,E_WGS84,N_WGS84,E,N,H_WGS84,H,SN,SH\na,1,2,500000.5,6000000.5,120.1,80.1,1,1.5\n\
                b,3,4,500010.5,6000010.5,121.1,81.1,2,1.6\n";
    let list = folder.read("list.csv", text, &utm).expect("two points");
    assert_eq!(place(&list, 0), ("a", 500_000.5, 6_000_000.5, Some(80.1)));
    assert_eq!((list.gcps[0].sigma_m, list.gcps[0].sigma_height_m), (None, None));
    // A survey's number is the same for all.
    assert_eq!(named("survey_id,x,y,z", ["7", "7"]), ["1", "2"]);
    assert_eq!(named("image_name,x,y,z", ["a.jpg", "b.jpg"]), ["1", "2"]);
}

/// The axes of WKT are no titles.
#[test]
fn wkt_above_observations_is_a_reference_system() {
    let folder = Folder::new();
    let wkt = autoref_raster::crs::Crs::from_epsg(25_832).expect("known").wkt().to_string();
    let wkt2 = "PROJCRS[\"ETRS89 / UTM zone 32N\",BASEGEOGCRS[\"ETRS89\",DATUM[\"European Terrestrial Reference System 1989\",\
        ELLIPSOID[\"GRS 1980\",6378137,298.257222101]]],CONVERSION[\"UTM zone 32N\",METHOD[\"Transverse Mercator\"],\
        PARAMETER[\"Latitude of natural origin\",0],PARAMETER[\"Longitude of natural origin\",9],\
        PARAMETER[\"Scale factor at natural origin\",0.9996],PARAMETER[\"False easting\",500000],\
        PARAMETER[\"False northing\",0]],CS[Cartesian,2],AXIS[\"(E)\",east,ORDER[1],LENGTHUNIT[\"metre\",1]],\
        AXIS[\"(N)\",north,ORDER[2],LENGTHUNIT[\"metre\",1]],ID[\"EPSG\",25832]]";
    for wkt in [wkt.as_str(), wkt2] {
        let rows = "500000.5 6000000.5 10 100 200 a.jpg G1\n500010.5 6000010.5 11 110 210 a.jpg G2\n";
        let list = folder.read("gcp_list.txt", format!("{wkt}\n{rows}"), &GcpOptions::default());
        let list = list.unwrap_or_else(|e| panic!("{wkt}: {e}"));
        assert_eq!(place(&list, 0), ("G1", 500_000.5, 6_000_000.5, Some(10.0)));
    }
}

#[test]
fn coordinates_from_the_centre_of_the_earth_are_refused() {
    let folder = Folder::new();
    let said = folder.read(
        "list.txt",
        "101 4318773.5 3250831.4 3375556.0\n116 4327519.7 3227451.6 3387035.3\n",
        &with_crs("EPSG:32633"),
    );
    assert!(said.is_err_and(|e| e.contains("centre of the Earth")));
}
