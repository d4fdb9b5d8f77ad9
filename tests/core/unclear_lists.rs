//! Lists that can be read in more than one way: read rightly with a note, or refused with file, row and remedy.

use crate::lists_folder::Folder;
use std::path::Path;

use autoref_stream::gcp::convert::{ConvertOptions, Converted, ListFormat, convert};
use autoref_stream::gcp::{self, GcpList, GcpOptions, GcpRole};
use proptest::prelude::*;

/// A list as the main job reads it; `local` coordinates where no CRS is given.
fn read_in(crs: &str, text: &str) -> Result<GcpList, String> {
    let options = GcpOptions { crs: Some(crs.into()), ..GcpOptions::default() };
    gcp::read(&Folder::new().write("l.csv", text), &options).map_err(|e| e.to_string())
}

fn read(text: &str) -> Result<GcpList, String> {
    read_in("local", text)
}

#[track_caller]
fn is_read(text: &str, expected: &[(&str, f64, f64, Option<f64>)], note: &str) {
    let list = read(text).unwrap_or_else(|e| panic!("{text}: {e}"));
    let found: Vec<_> = list.gcps.iter().map(|g| (g.name.as_str(), g.easting, g.northing, g.height)).collect();
    assert_eq!(found, expected, "{text}");
    assert!(note.is_empty() || list.notes.iter().any(|n| n.contains(note)), "{text}: no `{note}` in {:?}", list.notes);
}

#[track_caller]
fn refused(crs: &str, text: &str, words: &[&str]) {
    let error = read_in(crs, text).expect_err(text);
    assert!(words.iter().all(|word| error.contains(word)) && !error.contains('\n'), "{words:?}: {error}");
}

fn converted(input: &Path, output: &str, to: Option<ListFormat>) -> Result<Converted, String> {
    let options = ConvertOptions { to, ..ConvertOptions::default() };
    convert(input, &input.with_file_name(output), &options).map_err(|e| e.to_string())
}

/// Nothing that looks like a point is passed over in silence.
#[test]
fn rows_that_begin_as_remarks_do_are_points_or_named() {
    let points = [("#0", 500_021.8, 5_999_994.7, Some(100.0)), ("G4", 500_002.5, 5_999_991.2, Some(104.0))];
    let rows = "#0,500021.8,5999994.7,100\nG4,500002.5,5999991.2,104\n";
    is_read(&format!("name,easting,northing,height\n{rows}"), &points, "row 2 begins with `#`");
    is_read(rows, &points, "row 1 begins with `#`");
    let numbered = [("#1", 500_021.8, 5_999_994.7, None), ("#2", 500_002.5, 5_999_991.2, None)];
    let rows = "#1;500021,8;5999994,7\n#2;500002,5;5999991,2\n";
    is_read(&format!("name;easting;northing\n{rows}"), &numbered, "rows 2 and 3 begin with `#`");
    is_read(rows, &numbered, "rows 1 and 2 begin with `#`");
    let quoted = "name,easting,northing\n\"#1\",500021.8,5999994.7\n2,500002.5,5999991.2\n";
    is_read(quoted, &[("#1", 500_021.8, 5_999_994.7, None), ("2", 500_002.5, 5_999_991.2, None)], "");
    let out = "name,easting,northing\nG1,500021.8,5999994.7\nG2,500002.5,5999991.2\n# G3,500012.5,5999981.2\n";
    let left = [("G1", 500_021.8, 5_999_994.7, None), ("G2", 500_002.5, 5_999_991.2, None)];
    is_read(out, &left, "row 4 begins with `#` as remarks do");
    let none = "name,easting,northing\n# 1,500021.8,5999994.7\n# 2,500002.5,5999991.2\n";
    refused("local", none, &["no points", "rows 2 and 3 begin with `#`", "quote"]);
}

#[test]
fn marks_between_thousands_are_shown_by_the_file() {
    let points = [("A", 500_000.0, 4_649_776.0, Some(1_100.0)), ("B", 500_100.0, 4_649_876.0, Some(2_500.0))];
    let english = "Name,E,N,H\nA,\"500,000\",\"4,649,776\",\"1,100\"\nB,\"500,100\",\"4,649,876\",\"2,500\"\n";
    let german = "Name;E;N;H\nA;500.000;4.649.776;1.100\nB;500.100;4.649.876;2.500\n";
    is_read(english, &points, "`500,000` (row 2) the comma is taken for a thousands mark, as `4,649,776` shows");
    is_read(german, &points, "`500.000` (row 2) the point is taken for a thousands mark");
    is_read(german.split_once('\n').expect("a header").1, &points, "thousands mark");
    let folder = Folder::new();
    let lost =
        converted(&folder.write("l.csv", english.replace("\"2,500\"", "-9999")), "o.csv", None).expect("read").lost;
    assert!(lost.is_empty(), "{lost:?}");
    let local = "name,e,n\nA,105.743,92.676\nB,106.125,93.001\n";
    is_read(local, &[("A", 105.743, 92.676, None), ("B", 106.125, 93.001, None)], "taken for the decimal mark");
    refused("local", "name;e;n;h\nA;500.000;4.649.776;12.5\n", &["row 2", "`500.000`", "one decimal mark"]);
}

#[test]
fn rows_with_more_cells_than_titles_are_refused() {
    let commas = "name,easting,northing,height\nA,500000,50,4649776,25,100,10\n";
    refused("local", commas, &["row 2", "7 cells under 4 titles", "decimal commas", "semicolons"]);
    refused("local", "name easting northing\nP 1 500000 4649776\n", &["row 2", "blanks within a cell"]);
    let bare = "A,500000,50,4649776,25,100,10\nB,500100,50,4649876,25,100,10\n";
    refused("local", bare, &["row 1", "quote numbers with decimal commas"]);
    let trailing = "name,easting,northing\nA,500000,4649776,,\nB,500100,4649776, ,\n";
    assert_eq!(read(trailing).expect("nothing in them").gcps.len(), 2);
}

#[test]
fn letters_of_the_other_axis_are_refused() {
    let text = "name,lat,lon\nA,42.5 E,3.5 N\nB,42.6 E,3.6 N\n";
    let refused = |text: &str, words: &[&str]| {
        let options = GcpOptions { to_crs: Some("EPSG:25831".into()), ..GcpOptions::default() };
        let error = gcp::read(&Folder::new().write("l.csv", text), &options).expect_err(text).to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    };
    refused(text, &["row 2", "`3.5 N` stands under `lon`", "exchange the titles"]);
    refused("name,lat,lon\nA,42.5,3.5 O\nB,42.6,3.6 O\n", &["row 2", "`3.5 O`", "write E or W"]);
    let beyond = Folder::new();
    let list = beyond.write("l.csv", "name,lon,lat\nA,3.5,91.5\nB,3.6,92\n");
    let error = converted(&list, "o.csv", None).expect_err("beyond the pole");
    assert!(error.contains("row 2") && error.contains("no latitude is 91.5"), "{error}");
}

#[test]
fn angles_in_every_common_form() {
    for (longitude, latitude) in [
        ("W3.25", "N42.5"),
        ("W 3 15 00", "42 30 00"),
        ("-3:15:00", "42:30:00"),
        ("-3 15 00.0", "42 30 00.0"),
        ("3°15'00\"W", "42°30'00\"N"),
        ("W3 15.0", "N42 30.0"),
    ] {
        let text = format!("name,latitude,longitude\nA,{latitude},{longitude}\nB,42.6,-3.3\n");
        let options = GcpOptions { to_crs: Some("EPSG:25830".into()), ..GcpOptions::default() };
        let list = gcp::read(&Folder::new().write("l.csv", &text), &options).unwrap_or_else(|e| panic!("{text}: {e}"));
        let point = &list.gcps[0];
        // By gdaltransform.
        assert!(
            (point.easting - 479_458.461).abs() < 0.01 && (point.northing - 4_705_323.356).abs() < 0.01,
            "{point:?}"
        );
    }
}

#[test]
fn a_code_makes_no_check_points_without_a_title() {
    let rows = "1,4649004.5,500074.8,100.3,GCP\n2,4648981.7,500057.5,105.7,CP\n3,4648972.2,500031.4,104.7,CP\n";
    let list = read_in("EPSG:25830", rows).expect("readable");
    assert!(list.gcps.iter().all(|gcp| gcp.role == GcpRole::Control), "{:?}", list.gcps);
    let said = |what: &str| list.notes.iter().any(|note| note.contains(what));
    assert!(said("`CP` in column 5 of 2 rows makes no check point") && said("--check"), "{:?}", list.notes);
    let titled = read_in("EPSG:25830", &format!("name,northing,easting,height,role\n{rows}")).expect("readable");
    assert_eq!(titled.gcps.iter().filter(|gcp| gcp.role == GcpRole::Check).count(), 2);
}

#[test]
fn columns_before_the_coordinates_are_no_coordinates() {
    let points = [("GCP1", 500_000.5, 4_649_776.2, Some(100.1)), ("GCP2", 500_100.5, 4_649_876.2, Some(100.2))];
    let rows =
        |between: &str| format!("GCP1{between}500000.5 4649776.2 100.1\nGCP2{between}500100.5 4649876.2 100.2\n");
    is_read(&rows(" 32 "), &points, "column 2 was not used");
    is_read(&rows(" 32 7 "), &points, "column 2, 3 was not used");
    let tabs = rows("\t").replace(' ', "\t");
    is_read(&tabs.replace(".5\t", ".5\t\t"), &points, "");
    refused("local", &rows(" 1234567 "), &["row 1", "cannot be easting, northing and height", "titles"]);
}

#[test]
fn what_stands_for_no_height_is_none() {
    for value in ["-9999", "-99999", "-32768", "NaN", "1e38", "-3.4028235e38", "-", "n/a", "-9999.000"] {
        let text = format!("name,easting,northing,height\nA,500000,4649776,{value}\nB,500100,4649776,2\n");
        is_read(&text, &[("A", 500_000.0, 4_649_776.0, None), ("B", 500_100.0, 4_649_776.0, Some(2.0))], "no height");
    }
    is_read(
        "A,500000.5,4649776.5,-9999\nB,500100.5,4649776.5,2\n",
        &[("A", 500_000.5, 4_649_776.5, None), ("B", 500_100.5, 4_649_776.5, Some(2.0))],
        "row 1: -9999 is taken for no height",
    );
}

#[test]
fn titles_of_instruments_and_countries() {
    for titles in [
        "Name,Grid Northing,Grid Easting,Elevation,HRMS,VRMS",
        "Designation,Northing,Easting,Ell.Height (m),Accuracy_X/Y_(m),Accuracy_Z_(m)",
        "Nokta No,Kuzey,Doğu,Yükseklik,Accuracy,Accuracy Z",
        "Nokta,Yukarı,Sağa,Kot,Accuracy,Accuracy Z",
        "Pontszám,Észak,Kelet,Magasság,Accuracy,Accuracy Z",
        "点名,北,東,標高,Accuracy,Accuracy Z",
        "Имя точки,Север,Восток,Высота,Accuracy,Accuracy Z",
        "ΣΗΜΕΙΟ,ΒΟΡΕΙΑ,ΑΝΑΤΟΛΙΚΑ,ΥΨΟΜΕΤΡΟ,Accuracy,Accuracy Z",
        "Nome,Norte,Este,Altitude ortométrica,sigma_m,Accuracy Z",
    ] {
        let list = read(&format!("{titles}\nP1,4649776.2,500000.5,100.1,0.008,0.012\nP2,4649876.2,500100.5,1,1,1\n"));
        let point = list.unwrap_or_else(|e| panic!("{titles}: {e}")).gcps.swap_remove(0);
        assert_eq!((point.name.as_str(), point.easting, point.northing), ("P1", 500_000.5, 4_649_776.2), "{titles}");
        assert_eq!((point.height, point.sigma_m, point.sigma_height_m), (Some(100.1), Some(0.008), Some(0.012)));
    }
    // One accuracy of all three; a column of it before X and Y is none of them.
    for titles in ["#Label,X,Y,Z,Accuracy_X/Y/Z_(m)", "#Label,X/Easting,Y/Northing,Z/Altitude,Accuracy_X/Y/Z_(m)"] {
        let list = read(&format!("{titles}\nG1,500000.5,4649776.2,100.1,0.005\nG2,500100.5,4649876.2,100.1,0.008\n"));
        let point = list.unwrap_or_else(|e| panic!("{titles}: {e}")).gcps.swap_remove(0);
        assert_eq!((point.easting, point.sigma_m, point.sigma_height_m), (500_000.5, Some(0.005), Some(0.005)));
    }
    for title in ["sigma_mm", "sigma (mm)", "Sigma mm", "accuracy_mm"] {
        let list = read(&format!("name,e,n,{title}\nA,500000.5,4649776.2,5\nB,500100.5,4649876.2,5\n"));
        assert_eq!(list.unwrap_or_else(|e| panic!("{title}: {e}")).gcps[0].sigma_m, Some(0.005), "{title}");
    }
}

/// Beside the origin of a zone degrees would pass for metres.
#[test]
fn degrees_under_a_map_are_refused() {
    let degrees = "name,e,n\nA,15.00020,54.14805\nB,15.00005,54.14818\nC,15.00033,54.14810\n";
    refused("EPSG:32633", degrees, &["look like degrees", "--crs EPSG:4326"]);
    read_in("EPSG:4326", degrees).expect("degrees as what they are");
}

#[test]
fn what_a_refusal_advises_makes_the_list_readable() {
    let feet = |titles: &str| format!("name,{titles}\nA,1640420.5,15255170.1\nB,1640520.5,15255270.1\n");
    let (easting, northing) = ("Easting (US ft)", "Northing (US ft)");
    refused("EPSG:25830", &feet("Easting,Northing"), &["if they were feet", easting, northing, "--crs that counts"]);
    // Metres of zone 35 at 78° N: brought from feet they would lie at the edge of zone 33, in the Sahara.
    let elsewhere = "name,e,n\nA,640420.5,8685170.1\nB,640520.5,8685270.1\n";
    refused("EPSG:32633", elsewhere, &["another zone", "give the --crs"]);
    let error = read_in("EPSG:25830", &feet("Easting,Northing")).expect_err("feet");
    assert!(!error.contains("outside-area"), "{error}");
    let list = read_in("EPSG:25830", &feet(&format!("{easting},{northing}"))).expect("the remedy");
    assert!((list.gcps[0].easting - 1_640_420.5 * 1200.0 / 3937.0).abs() < 1e-6, "{:?}", list.gcps[0]);
    assert!(list.notes.iter().any(|note| note.contains("US survey feet")), "{:?}", list.notes);
    refused("EPSG:25830", &feet("Easting (ft),Northing (ft)"), &["`Easting (ft)`", "no certain kind", "(ift)"]);
    for text in ["name,e,n\n\"A,500000,4649776\nB,500100,4649776\n", "\"A,500000,4649776\nB,500100,4649776\n"] {
        refused("local", text, &["quote", "not closed"]);
    }
}

#[test]
fn rows_that_say_the_same_are_one_point() {
    let rows = "A,500000.5,4649776.5,1\nB,500100.5,4649776.5,2\nA,500000.5,4649776.5,1\n";
    let points = [("A", 500_000.5, 4_649_776.5, Some(1.0)), ("B", 500_100.5, 4_649_776.5, Some(2.0))];
    is_read(&format!("name,e,n,h\n{rows}"), &points, "row 4 says the same as row 2 and was passed over");
    is_read(rows, &points, "row 3 says the same as row 1");
    refused("local", &rows.replace(",2\nA,500000.5", ",2\nA,500000.6"), &["`A` was used before"]);
}

fn odd_names() -> impl Strategy<Value = Vec<String>> {
    let odd = prop::sample::select(vec![
        "//x",
        "!y",
        "#7",
        "=1+1",
        "'=1",
        "a\nb",
        "a\rb",
        "\u{1b}[31mX",
        "<b>&x</b>",
        "x;y",
        "x,y",
        "na me",
        "名前",
        "-5",
        "\"q\"",
        "\"q",
        "o'k",
        "NaN",
        "1e5",
        "P|Q",
        "tab\tq",
        "CHK-1",
        "0012",
        "12",
        "é",
        "x\\ny",
        "{x",
        "P1:",
        "EPSG:1",
        "- ",
        "//",
        "@x",
        "\u{202e}R",
        "a  b",
        "x\"y",
        "0.5 1",
        "nan",
    ]);
    let any = "[ -~éß名\t\n]{1,12}";
    let name = prop_oneof![3 => odd.prop_map(str::to_owned), 2 => any.prop_map(|name: String| name)];
    let names = prop::collection::vec(name, 1..7);
    names.prop_map(|names| {
        let mut kept: Vec<String> = vec!["Z9".into()];
        for name in names.into_iter().map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()) {
            if !kept.contains(&name) {
                kept.push(name);
            }
        }
        kept.rotate_left(1);
        kept
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Every dialect gives back the points it was given, or says that it lost letters of their names, or refuses them.
    #[test]
    fn odd_names_come_back_from_every_dialect(names in odd_names()) {
        let folder = Folder::new();
        let feature = |(i, name): (usize, &String)| serde_json::json!({
            "type": "Feature", "properties": {"name": name},
            "geometry": {"type": "Point", "coordinates": [500_000.25 + 11.5 * i as f64, 4_649_000.5, 100.5]},
        });
        let list = serde_json::json!({
            "type": "FeatureCollection", "crs": {"type": "name", "properties": {"name": "EPSG:25830"}},
            "features": names.iter().enumerate().map(feature).collect::<Vec<_>>(),
        });
        let source = folder.write("s.geojson", list.to_string());
        for format in ListFormat::WRITTEN {
            let there = format!("t-{}.{}", format.name(), match format {
                ListFormat::Qgis => "points",
                ListFormat::Odm => "txt",
                ListFormat::MetashapeCsv | ListFormat::Pix4d => "csv",
                ListFormat::MetashapeXml | ListFormat::MicMac => "xml",
                other => other.name(),
            });
            // Refused in one line, with the name that cannot be.
            let Ok(done) = converted(&source, &there, Some(format)) else { continue };
            let back = converted(&source.with_file_name(&there), "b.geojson", Some(ListFormat::GeoJson));
            let back = back.unwrap_or_else(|e| panic!("{}: {names:?}: {e}", format.name()));
            prop_assert_eq!(back.points, names.len(), "{}: {:?}", format.name(), names);
            let text = std::fs::read_to_string(source.with_file_name("b.geojson")).expect("written");
            let value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            for (name, feature) in names.iter().zip(value["features"].as_array().expect("features")) {
                let found = feature["properties"]["name"].as_str().expect("a name");
                let said = done.lost.iter().any(|lost| lost.starts_with("letters"));
                prop_assert!(found == name || said, "{}: {:?} became {:?}", format.name(), name, found);
                let at = feature["geometry"]["coordinates"][1].as_f64().expect("a number");
                let degrees = matches!(format, ListFormat::Kml | ListFormat::Gpx);
                prop_assert!(degrees || (at - 4_649_000.5).abs() < 1e-6, "{}: {:?}", format.name(), at);
            }
        }
    }
}
