//! The files for other programs, read back by their formats.

use super::{Roll, affine, json, text};

/// Elements of an XML document as (depth, name, text), in order; the parser must be content with all of it.
fn elements(xml: &str) -> Vec<(usize, String, String)> {
    use quick_xml::events::Event;
    assert!(xml.starts_with("<?xml version=\"1.0\""), "{xml}");
    let mut reader = quick_xml::Reader::from_str(xml);
    let (mut seen, mut open): (Vec<(usize, String, String)>, Vec<usize>) = (vec![], vec![]);
    loop {
        match reader.read_event().expect("well-formed") {
            Event::Start(e) => {
                let name = std::str::from_utf8(e.name().into_inner().as_ref()).expect("UTF-8").to_owned();
                seen.push((open.len(), name, String::new()));
                open.push(seen.len() - 1);
            }
            Event::End(_) => {
                open.pop();
            }
            Event::Text(t) => {
                if let Some(&k) = open.last() {
                    seen[k].2 += t.trim();
                }
            }
            Event::Eof => return seen,
            _ => {}
        }
    }
}

/// A `MesureAppuiFlottant1Im` at `depth`: name of the image, and points by name. Order and nesting are checked.
fn measures(all: &[(usize, String, String)], depth: usize) -> (String, Vec<(String, [f64; 2])>) {
    assert_eq!((all[0].0, all[0].1.as_str()), (depth, "MesureAppuiFlottant1Im"));
    assert_eq!((all[1].0, all[1].1.as_str()), (depth + 1, "NameIm"));
    assert_eq!((all.len() - 2) % 3, 0, "{all:?}");
    let points = all[2..].chunks(3).map(|group| {
        let names: Vec<(usize, &str)> = group.iter().map(|e| (e.0 - depth, e.1.as_str())).collect();
        assert_eq!(names, [(1, "OneMesureAF1I"), (2, "NamePt"), (2, "PtIm")]);
        let xy: Vec<f64> = group[2].2.split(' ').map(|v| v.parse().expect("a number")).collect();
        (group[1].2.clone(), [xy[0], xy[1]])
    });
    (all[1].2.clone(), points.collect())
}

/// The files of one roll, for a camera whose y runs up and one whose y runs down.
#[test]
fn files_for_other_programs_read_back_as_their_formats_say() {
    for (camera, pixel_um, name) in
        [("wild-15-4", "100", "wild-15-4-1"), ("svalbard-zeiss-1936", "65", "svalbard-zeiss-1936-1")]
    {
        let roll = Roll::new(camera, pixel_um, &["--frames", "2"]);
        roll.fiducials(&["--exports"], 0);
        let truth = roll.truth(name);

        // The camera: millimetres from the upper left corner of the marks, y down.
        let (_, film) = measures(&elements(&text(&roll.out("Ori-InterneScan/MeasuresCamera.xml"))), 0);
        let names: Vec<&String> = film.iter().map(|p| &p.0).collect();
        assert!(
            names.iter().zip(&roll.camera.marks).all(|(a, b)| **a == b.name) && names.len() == roll.camera.marks.len()
        );
        for (p, m) in film.iter().zip(&roll.camera.marks) {
            let (first, first_mark) = (&film[0], &roll.camera.marks[0]);
            let up = if camera == "wild-15-4" { -1.0 } else { 1.0 };
            assert!(
                (p.1[0] - first.1[0] - (m.x_mm.expect("there") - first_mark.x_mm.expect("there"))).abs() < 1e-9,
                "x in mm"
            );
            assert!(
                (p.1[1] - first.1[1] - up * (m.y_mm.expect("there") - first_mark.y_mm.expect("there"))).abs() < 1e-9,
                "y down"
            );
        }
        for k in 0..2 {
            assert_eq!(film.iter().map(|p| p.1[k]).fold(f64::MAX, f64::min), 0.0);
        }

        // The image: pixels, within a set, named by the scan with its extension.
        let xml = elements(&text(&roll.out(&format!("Ori-InterneScan/MeasuresIm-{name}.tif.xml"))));
        assert_eq!((xml[0].0, xml[0].1.as_str()), (0, "SetOfMesureAppuisFlottants"));
        let (image, pixels) = measures(&xml[1..], 1);
        assert_eq!(image, format!("{name}.tif"));
        assert_eq!(pixels.len(), truth.len());
        for (mark, at) in &truth {
            let found = pixels.iter().find(|p| p.0 == *mark).expect("every mark");
            assert!((found.1[0] - at[0]).hypot(found.1[1] - at[1]) < 0.6, "{found:?} {at:?}");
        }
        // What ReSampFid makes of both files puts the marks of the truth where the certificate has them.
        let pairs: Vec<([f64; 2], [f64; 2])> =
            pixels.iter().map(|p| (p.1, film.iter().find(|f| f.0 == p.0).expect("paired by name").1)).collect();
        let (px, mm): (Vec<[f64; 2]>, Vec<[f64; 2]>) = pairs.into_iter().unzip();
        let to_mm = affine(&px, &mm);
        for (mark, at) in &truth {
            let (is, should) = (to_mm(*at), film.iter().find(|f| f.0 == *mark).expect("named").1);
            assert!((is[0] - should[0]).hypot(is[1] - should[1]) < 0.05, "{mark}: {is:?} {should:?}");
        }
        assert_eq!(text(&roll.out("id_fiducial.txt")).lines().collect::<Vec<_>>(), names);

        tables_read_back(&roll, name, &pixels);
    }
}

fn tables_read_back(roll: &Roll, name: &str, pixels: &[(String, [f64; 2])]) {
    let frame = roll.frame(name);
    let number = |s: &str| s.parse::<f64>().expect("a number");
    // spymicmac.
    let mut csv = csv::Reader::from_path(roll.out(&format!("{name}.measures.csv"))).expect("written");
    let head: Vec<String> = csv.headers().expect("a head").iter().map(str::to_owned).collect();
    assert_eq!(head, ["gcp", "im_col", "im_row", "residual_x_um", "residual_y_um"]);
    for (row, mark) in csv.records().map(|r| r.expect("a row")).zip(&frame.marks) {
        let c = mark.centre.expect("found");
        let r = mark.residual_um.expect("solved");
        assert_eq!((&row[0], number(&row[1]), number(&row[2])), (mark.mark.as_str(), c.x, c.y));
        assert!((number(&row[3]) - r[0]).abs() < 6e-4 && (number(&row[4]) - r[1]).abs() < 6e-4);
    }
    // hipp: pairs of y and x at its places, the principal point last.
    let mut csv = csv::Reader::from_path(roll.out("fiducials_hipp.csv")).expect("written");
    let head: Vec<String> = csv.headers().expect("a head").iter().map(str::to_owned).collect();
    let middle = ["midside_left", "midside_top", "midside_right", "midside_bottom"];
    let corner = ["corner_top_left", "corner_top_right", "corner_bottom_right", "corner_bottom_left"];
    let (places, marks): (Vec<&str>, Vec<&str>) = if roll.camera.marks.len() == 8 {
        (middle.iter().chain(&corner).copied().collect(), vec!["P5", "P7", "P6", "P8", "P3", "P4", "P1", "P2"])
    } else {
        (middle.to_vec(), vec!["LEFT", "TOP", "RIGHT", "BOTTOM"])
    };
    let wanted: Vec<String> = std::iter::once("fileName".to_string())
        .chain(places.iter().chain(&["principal_point"]).flat_map(|p| [format!("{p}_y"), format!("{p}_x")]))
        .collect();
    assert_eq!(head, wanted);
    let rows: Vec<csv::StringRecord> = csv.records().map(|r| r.expect("a row")).collect();
    assert_eq!(rows.len(), 2);
    let row = rows.iter().find(|r| r[0].ends_with(&format!("{name}.tif"))).expect("a row per frame");
    for (k, mark) in marks.iter().enumerate() {
        let at = pixels.iter().find(|p| p.0 == *mark).expect("named").1;
        assert_eq!((number(&row[2 + 2 * k]), number(&row[1 + 2 * k])), (at[0], at[1]), "{mark}");
    }
    let principal = [number(&row[row.len() - 1]), number(&row[row.len() - 2])];
    assert!(
        (principal[0] / frame.width as f64 - 0.5).abs() < 0.02
            && (principal[1] / frame.height as f64 - 0.5).abs() < 0.02
    );
    // GeoJSON as GDAL reads it.
    let dataset = gdal::Dataset::open(roll.out(&format!("{name}.geojson"))).expect("GDAL reads it");
    let mut layer = gdal::vector::LayerAccess::features(&mut dataset.layer(0).expect("a layer")).count();
    assert_eq!(layer, frame.marks.len());
    let features = json(&roll.out(&format!("{name}.geojson")));
    for (f, m) in features["features"].as_array().expect("features").iter().zip(&frame.marks) {
        let c = m.centre.expect("found");
        assert_eq!(f["geometry"]["coordinates"], serde_json::json!([c.x, -c.y]));
        assert_eq!((&f["properties"]["x_px"], &f["properties"]["mark"]), (&c.x.into(), &m.mark.as_str().into()));
        layer -= 1;
    }
    assert_eq!(layer, 0);
    // JSON: pixel → millimetres by the matrix gives the residuals.
    let raw = json(&roll.out(&format!("{name}.fiducials.json")));
    let h: Vec<f64> =
        raw["inner"]["pixel_to_mm"].as_array().expect("a matrix").iter().map(|v| v.as_f64().expect("there")).collect();
    for (m, calibrated) in raw["marks"].as_array().expect("marks").iter().zip(&roll.camera.marks) {
        let (x, y) = (m["centre"]["x"].as_f64().expect("there"), m["centre"]["y"].as_f64().expect("there"));
        let dx = 1e3 * (h[0] * x + h[1] * y + h[2] - calibrated.x_mm.expect("there"));
        let dy = 1e3 * (h[3] * x + h[4] * y + h[5] - calibrated.y_mm.expect("there"));
        assert!((dx - m["residual_um"][0].as_f64().expect("there")).abs() < 1e-6);
        assert!((dy - m["residual_um"][1].as_f64().expect("there")).abs() < 1e-6);
    }
}

#[test]
fn pixels_can_count_from_centres_and_a_frame_without_orientation_has_no_measures() {
    let roll = Roll::new("rmk-cross", "100", &[]);
    roll.fiducials(&["--exports"], 0);
    let xml = roll.out("Ori-InterneScan/MeasuresIm-rmk-cross-1.tif.xml");
    let corner = measures(&elements(&text(&xml))[1..], 1).1;
    roll.fiducials(&["--exports", "--pixels-from", "centre"], 0);
    let centre = measures(&elements(&text(&xml))[1..], 1).1;
    for (a, b) in corner.iter().zip(&centre) {
        assert!((a.1[0] - b.1[0] - 0.5).abs() < 1e-9 && (a.1[1] - b.1[1] - 0.5).abs() < 1e-9);
    }
    // The scan is replaced by an empty one: the measures of the earlier run must not stay.
    let scan = roll.scans().join("rmk-cross-1.tif");
    std::fs::write(&scan, b"II*\0 no TIFF").expect("writable");
    roll.fiducials(&["--exports"], 1);
    assert!(!xml.exists());
    assert_eq!(text(&roll.out("rmk-cross-1.measures.csv")).lines().count(), 1);
}
