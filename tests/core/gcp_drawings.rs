//! Drawings (DXF) as lists of points: texts name the points beside them and are none.

use autoref_stream::gcp::{self, GcpList, GcpOptions};

const POINTS: [(&str, f64, f64); 4] = [
    ("A1", 569_058.81, 7_033_003.45),
    ("A2", 569_032.39, 7_033_009.46),
    ("A3", 569_015.09, 7_032_989.6),
    ("A4", 569_021.36, 7_033_013.19),
];

fn entity(kind: &str, layer: &str, (x, y): (f64, f64), rest: &str) -> String {
    format!("0\n{kind}\n8\n{layer}\n10\n{x}\n20\n{y}\n30\n100.5\n{rest}")
}

fn text(layer: &str, at: (f64, f64), words: &str) -> String {
    entity("TEXT", layer, at, &format!("40\n0.3\n1\n{words}\n"))
}

/// A drawing of a block of two lines, and of entities.
fn drawing(entities: &str) -> String {
    let line = |from: (f64, f64), to: (f64, f64)| {
        format!("0\nLINE\n8\n0\n10\n{}\n20\n{}\n11\n{}\n21\n{}\n", from.0, from.1, to.0, to.1)
    };
    let cross = line((-0.2, 0.0), (0.2, 0.0)) + &line((0.0, -0.2), (0.0, 0.2));
    format!(
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n0\nENDSEC\n\
         0\nSECTION\n2\nBLOCKS\n0\nBLOCK\n8\n0\n2\nGCP\n70\n2\n\
         10\n0\n20\n0\n30\n0\n{cross}0\nENDBLK\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n{entities}{}0\nENDSEC\n0\nEOF\n",
        line((POINTS[0].1, POINTS[0].2), (POINTS[1].1, POINTS[1].2))
    )
}

fn read(entities: &str, layer: Option<&str>) -> Result<GcpList, String> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("l.dxf");
    std::fs::write(&path, drawing(entities)).expect("writable");
    let options =
        GcpOptions { crs: Some("EPSG:25832".into()), layer: layer.map(str::to_string), ..GcpOptions::default() };
    gcp::read(&path, &options).map_err(|e| e.to_string())
}

/// One text for each point, of what `words` says.
fn texts(layer: &str, beside: (f64, f64), words: impl Fn(&str) -> String) -> String {
    POINTS.iter().map(|(name, x, y)| text(layer, (x + beside.0, y + beside.1), &words(name))).collect()
}

fn points() -> String {
    POINTS.iter().map(|(_, x, y)| entity("POINT", "GCP", (*x, *y), "")).collect()
}

#[track_caller]
fn are_the_points(list: &GcpList, named: bool) {
    assert_eq!(list.gcps.len(), POINTS.len(), "{:?}", list.gcps);
    for (i, (gcp, (name, x, y))) in list.gcps.iter().zip(POINTS).enumerate() {
        assert_eq!((gcp.easting, gcp.northing, gcp.height), (x, y, Some(100.5)), "the text's place is not the point's");
        assert_eq!(gcp.name, if named { name.to_string() } else { (i + 1).to_string() });
    }
}

#[test]
fn texts_name_points_and_lines_are_passed_over() {
    for offset in [0.0, 0.03, 0.4] {
        let list = read(&(points() + &texts("NAMES", (offset, offset), str::to_string)), None).expect("readable");
        are_the_points(&list, true);
        let said = list.notes.join("; ");
        assert!(said.contains("texts of its layer `NAMES` name 4 of 4 points"), "{said}");
        assert!(said.contains("no points: 1 of its entities"), "{said}");
    }
    // The heights beside the points are no names, and a text that stands alone names nothing.
    let mut heights = 0;
    let values = POINTS.map(|(_, x, y)| {
        heights += 1;
        text("HEIGHTS", (x + 0.1, y - 0.1), &format!("100.{heights}"))
    });
    let more = values.concat() + &text("NAMES", (569_500.0, 7_033_500.0), "Plan 7");
    let list = read(&(points() + &more + &texts("NAMES", (0.3, 0.3), str::to_string)), None).expect("readable");
    are_the_points(&list, true);
    assert!(list.notes.join("; ").contains("names of no point: 5 of its texts"), "{:?}", list.notes);
    // The same word everywhere names none.
    let list = read(&(points() + &texts("NAMES", (0.3, 0.3), |_| "GCP".into())), None).expect("readable");
    are_the_points(&list, false);
}

#[test]
fn blocks_stand_where_they_were_put_in() {
    let insert = |name: &str, x: f64, y: f64| {
        let rest = format!(
            "66\n1\n2\nGCP\n0\nATTRIB\n8\nGCP\n10\n{}\n20\n{}\n40\n0.3\n1\n{name}\n2\nPNR\n70\n0\n0\nSEQEND\n8\nGCP\n",
            x + 0.3,
            y + 0.3
        );
        entity("INSERT", "GCP", (x, y), &rest)
    };
    let blocks: String = POINTS.iter().map(|(name, x, y)| insert(name, *x, *y)).collect();
    are_the_points(&read(&blocks, None).expect("readable"), true);
    // They keep their own names.
    are_the_points(
        &read(&(blocks.clone() + &texts("HEIGHTS", (0.1, 0.1), |n| n.replace('A', "10."))), None).expect("readable"),
        true,
    );
    // The symbol of a POINT is no second one.
    are_the_points(&read(&(points() + &blocks), None).expect("readable"), true);
    // A layer of the drawing can be named.
    let other = entity("POINT", "TREES", (569_040.0, 7_033_000.0), "");
    assert_eq!(read(&(blocks.clone() + &other), None).expect("readable").gcps.len(), 5);
    are_the_points(&read(&(blocks + &other), Some("gcp")).expect("readable"), true);
    let error = read(&(points() + &other), Some("ROADS")).expect_err("no such layer");
    assert!(error.contains("`ROADS`") && error.contains("GCP, TREES"), "{error}");
}

#[test]
fn texts_alone_are_no_list() {
    let error = read(&texts("NAMES", (0.0, 0.0), str::to_string), None).expect_err("no points");
    assert!(error.contains("l.dxf") && error.contains("texts") && error.contains("table"), "{error}");
}

#[test]
fn the_unit_of_the_head_counts_where_the_place_shows_it() {
    let read = |unit: &str, crs: &str, by: f64| {
        let entities: String = POINTS
            .iter()
            .map(|(_, x, y)| entity("POINT", "GCP", (x * by, y * by), "").replace("100.5", "100"))
            .collect();
        let head = format!("$ACADVER\n1\nAC1009\n9\n$INSUNITS\n70\n{unit}\n");
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("l.dxf");
        std::fs::write(&path, drawing(&entities).replace("$ACADVER\n1\nAC1009\n", &head)).expect("writable");
        gcp::read(&path, &GcpOptions { crs: Some(crs.into()), ..GcpOptions::default() }).map_err(|e| e.to_string())
    };
    for (unit, by, height) in [("4", 1000.0, 0.1), ("5", 100.0, 1.0), ("21", 3937.0 / 1200.0, 100.0 * 1200.0 / 3937.0)]
    {
        let list = read(unit, "EPSG:25832", by).unwrap_or_else(|e| panic!("{unit}: {e}"));
        assert!((list.gcps[0].easting - POINTS[0].1).abs() < 1e-6, "{unit}: {:?}", list.gcps[0]);
        assert!((list.gcps[0].height.expect("one") - height).abs() < 1e-9, "{unit}: {:?}", list.gcps[0]);
        assert!(list.notes.iter().any(|note| note.contains("$INSUNITS")), "{:?}", list.notes);
        // What templates leave in the head says nothing of coordinates that lie where they should.
        let plain = read(unit, "EPSG:25832", 1.0).unwrap_or_else(|e| panic!("{unit}: {e}"));
        assert_eq!((plain.gcps[0].easting, plain.gcps[0].height), (POINTS[0].1, Some(100.0)), "{unit}");
    }
    let error = read("2", "EPSG:25832", 1.0 / 0.3048).expect_err("of which feet?");
    assert!(error.contains("US survey feet"), "{error}");
    let error = read("0", "EPSG:25832", 1000.0).expect_err("far away");
    assert!(error.contains("scale the drawing"), "{error}");
    let local = read("4", "local", 1.0).expect("local metres");
    assert!(local.gcps[0].easting == POINTS[0].1 && local.notes.iter().any(|note| note.contains("templates")));
}
