//! Titles in the languages of surveyors, names without a title, statistics below a list, systems in remarks, sheets.

use crate::lists_folder::Folder;
use autoref_stream::gcp::{self, GcpList, GcpOptions};

fn read_in(crs: Option<&str>, text: &str) -> Result<GcpList, String> {
    let options = GcpOptions { crs: crs.map(str::to_owned), ..GcpOptions::default() };
    gcp::read(&Folder::new().write("l.csv", text), &options).map_err(|e| e.to_string())
}

fn read(text: &str) -> GcpList {
    read_in(Some("local"), text).unwrap_or_else(|e| panic!("{text}: {e}"))
}

fn names(list: &GcpList) -> Vec<&str> {
    list.gcps.iter().map(|gcp| gcp.name.as_str()).collect()
}

#[track_caller]
fn says(list: &GcpList, what: &str) {
    assert!(list.notes.iter().any(|note| note.contains(what)), "no `{what}` in {:?}", list.notes);
}

/// Three rows under four titles: name, easting, northing, height, in this order unless `order` says another.
fn rows(order: [usize; 4]) -> String {
    let cells = [
        ["101", "569834.26", "7031894.72", "47.2"],
        ["102", "570032.87", "7031837.65", "43.9"],
        ["103", "569991.62", "7031863.91", "46.6"],
    ];
    cells.iter().map(|row| order.map(|column| row[column]).join(";") + "\n").collect()
}

#[test]
fn titles_of_many_languages() {
    let (east_first, north_first) = ([0, 1, 2, 3], [0, 2, 1, 3]);
    for (titles, order) in [
        ("Puntnr;X;Y;Z", east_first),
        ("Punt;X;Y;Z", east_first),
        ("Nr punktu;X;Y;H", north_first),
        ("Číslo bodu;Y;X;Výška", east_first),
        ("Mat;X;Y;Z", east_first),
        ("Punktkennung;East;North;Height", east_first),
        ("N° point;Est;Nord;Alt.", east_first),
        ("Piste;P;I;K", north_first),
        ("Ponto;M;P;Cota", east_first),
        ("PtNo;Easting_m;Northing_m;Elev_m", east_first),
        ("Point;E (m);N (m);H (m)", east_first),
        ("点号;北坐标;东坐标;高程", north_first),
        ("点名;X座標;Y座標;標高", north_first),
        ("점번호;북;동;표고", north_first),
        ("Nokta No;Y (Sağa);X (Yukarı);Kot", east_first),
        ("Σημείο;Ανατολικά;Βόρεια;Υψόμετρο", east_first),
        ("Имя точки;Север;Восток;Отметка", north_first),
        ("NUMER PUNKTU;POLNOC;WSCHOD;WYSOKOSC", north_first),
        ("Vértice;Coordenada Este;Coordenada Norte;Elevación", east_first),
        ("Pontszám;Kelet;Észak;Magasság", east_first),
    ] {
        let list = read_in(None, &format!("{titles}\n{}", rows(order))).unwrap_or_else(|e| panic!("{titles}: {e}"));
        assert_eq!(names(&list), ["101", "102", "103"], "{titles}");
        let first = &list.gcps[0];
        let place = (first.easting, first.northing, first.height);
        assert_eq!(place, (569_834.26, 7_031_894.72, Some(47.2)), "{titles}");
        let is_of_names = |note: &&String| note.contains("names are taken") || note.contains("numbered");
        assert_eq!(list.notes.iter().find(is_of_names), None, "{titles}");
    }
    // Y before X, with a height that one letter names.
    let list = read_in(Some("EPSG:23700"), "Pont;Y;X;M\n7;650834.26;240894.72;47.2\n8;650900;240900;48\n");
    let list = list.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((list.gcps[0].easting, list.gcps[0].height), (650_834.26, Some(47.2)));
    // Beside titles that are words, the letter is none's height.
    let list = read("name;easting;northing;M\nA;1;2;steel\nB;3;4;wood\n");
    assert_eq!(list.gcps[0].height, None);
}

#[test]
fn feet_behind_a_title_are_a_unit() {
    let list = read("PtNo,Easting_US_ft,Northing_US_ft,Elev_ft\n1,3280.8333,6561.6667,328.08\n2,3300,6600,330\n");
    assert!((list.gcps[0].easting - 1000.0).abs() < 1e-3 && (list.gcps[0].northing - 2000.0).abs() < 1e-3);
    assert!(list.gcps[0].height.is_some_and(|h| (h - 100.0).abs() < 0.01), "{:?}", list.gcps[0]);
    let text = "PtNo,Easting_ft,Northing_ft\n1,1869534.97,23070520.75\n2,1870186.57,23070333.5\n";
    let error = read_in(Some("EPSG:25832"), text).expect_err("feet of no certain kind");
    assert!(error.contains("`Easting_ft`") && error.contains("(US ft)"), "{error}");
}

#[test]
fn a_column_that_tells_rows_apart_names_them() {
    // Under a title that no list of words has, in front and behind.
    let list = read("Schild;E;N\nA7;1;2\nA9;3;4\nB2;5;9\n");
    assert_eq!(names(&list), ["A7", "A9", "B2"]);
    says(&list, "names are taken from the column `Schild`");
    let list = read("E;N;Kode;Schild\n1;2;GCP;A7\n3;4;GCP;A9\n5;9;GCP;B2\n");
    assert_eq!(names(&list), ["A7", "A9", "B2"]);
    let list = read(";E;N\n20;1;2\n21;3;4\n22;5;9\n");
    assert_eq!(names(&list), ["20", "21", "22"]);
    says(&list, "names are taken from column 1, which has no title");
    // Neither measures nor times, nor what repeats, names a point: these are counted, from 1.
    let list = read("E;N;Datum;Kode;PDOP\n1;2;2026-05-01;GCP;1.25\n3;4;2026-05-02;GCP;1.5\n5;9;2026-05-03;GCP;1.75\n");
    assert_eq!(names(&list), ["1", "2", "3"]);
    says(&list, "the points are numbered from 1");
    let list = read("# no titles\n569834.26 7031894.72\n570032.87 7031837.65\n569991.62 7031863.91\n");
    assert_eq!(names(&list), ["1", "2", "3"]);
    says(&list, "the points are numbered from 1");
}

/// Four corners of no square, and rows below them.
fn below(statistics: &str) -> String {
    format!("name;easting;northing;height\nA;100;7000;10\nB;300;7000;20\nMax;300;7200;30\nD;120;7240;12\n{statistics}")
}

#[test]
fn statistics_below_a_list_are_no_points() {
    for statistics in [
        "Mittelwert;205;7110;18\n",
        "Mean;205.0;7110.0;18.0\nStdAbw;110.0;128.1;9.1\n",
        "Summe;820;28440;72\n",
        "Total:;820;28440;\n",
        "Max;300;7240;30\nMin;100;7000;10\n",
        "Anzahl;4;;\nMoyenne;205;7110;18\n",
        "std dev;0.012;0.010;0.020\n",
        "Écart-type;95.2;111;8\n",
    ] {
        let list = read(&below(statistics));
        assert_eq!(names(&list), ["A", "B", "Max", "D"], "{statistics}");
        says(&list, "set aside, since they are statistics of the rows above: `");
        let done = Folder::new().converted("l.csv", below(statistics));
        assert_eq!(done.points, 4, "{statistics}");
        assert!(done.lost.iter().any(|lost| lost.contains("set aside")), "{statistics}: {:?}", done.lost);
    }
    // A point may be called so: it lies among the others, and is no statistic.
    let list = read(&below("Min;160;7100;5\n"));
    assert_eq!(names(&list), ["A", "B", "Max", "D", "Min"]);
    assert!(!list.notes.iter().any(|note| note.contains("set aside")), "{:?}", list.notes);
    // Without titles.
    let bare = below("Mittelwert;205;7110;18\n");
    let list = read(bare.split_once('\n').expect("a header").1);
    assert_eq!(names(&list), ["A", "B", "Max", "D"]);
}

#[test]
fn a_system_in_a_remark_is_taken_when_it_is_one() {
    let points = "name;easting;northing\n1;569834.26;7031894.724\n2;570032.865;7031837.651\n";
    for text in [
        format!("{points}# EPSG:25832\n"),
        format!("Koordinatensystem: ETRS89 / UTM 32N (EPSG 25832)\n\n{points}"),
        format!("# ETRS89 / UTM zone 32N\n{points}"),
        format!("{points}# Lage EPSG: 25832, Höhe EPSG: 7837\n"),
        format!("# EPSG 25832\n{}", points.split_once('\n').expect("a header").1),
    ] {
        let list = read_in(None, &text).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!(list.crs.as_ref().map(|crs| crs.label()).as_deref(), Some("EPSG:25832"), "{text}");
        says(&list, "names EPSG:25832");
    }
    let two = read_in(None, &format!("# EPSG:25832 or EPSG:25833\n{points}")).expect("readable");
    assert!(two.crs.is_none());
    says(&two, "neither was taken; give --crs");
    let other = read_in(Some("EPSG:32632"), &format!("{points}# EPSG:25832\n")).expect("readable");
    assert_eq!(other.crs.map(|crs| crs.label()).as_deref(), Some("EPSG:32632"));
}

#[test]
fn a_row_of_units_is_no_point() {
    let list = read("name,easting,northing,height,sigma\n-,mm,mm,m,mm\nA,1000,2000,5,12\nB,3000,4000,6,12\n");
    let first = &list.gcps[0];
    assert_eq!((first.name.as_str(), first.easting, first.northing, first.height), ("A", 1.0, 2.0, Some(5.0)));
    assert_eq!((first.sigma_m, list.gcps.len()), (Some(0.012), 2));
    says(&list, "row 2 holds the units of the columns");
    let list = read("name;e;n\n;[US survey feet];[ft-us]\nA;3937;7874\nB;3940;7880\n");
    assert!((list.gcps[0].easting - 1200.0).abs() < 1e-9 && (list.gcps[0].northing - 2400.0).abs() < 1e-9);
}

#[test]
fn accuracies_beyond_a_metre_are_doubted() {
    let list = read("name,e,n,sigma\nA,1,2,12\nB,3,4,12\nC,5,9,0.5\n");
    says(&list, "the stated accuracies, 12 m in the middle");
    let list = read("name,e,n,sigma_mm\nA,1,2,12\nB,3,4,12\nC,5,9,10\n");
    assert!(!list.notes.iter().any(|note| note.contains("accuracies")), "{:?}", list.notes);
}

#[test]
fn what_is_kept_is_not_said_to_be_lost() {
    let french = "N° point;Est;Nord;Alt.\n1;569\u{a0}834,260;7\u{a0}031\u{a0}894,724;47,211\n2;570 032,865;7 031 837,651;43,898\n";
    let finnish = "Piste;P;I;K\n1;6700894,724;24490834,260;47,211\n2;6700837,651;24491032,865;43,898\n";
    let feet = "Point;Easting_ft;Northing_ft\n1;1869534.97;23070520.75\n2;1870186.57;23070333.5\n";
    for text in [french, finnish, feet] {
        let folder = Folder::new();
        let done = folder.converted("l.csv", text);
        assert!(done.lost.is_empty(), "{text}: {:?}", done.lost);
        let written = std::fs::read_to_string(&done.files[0]).expect("written");
        assert!(written.lines().next().is_some_and(|titles| titles.split(',').count() <= 5), "{written}");
    }
}

/// A file with one sheet.
fn sheet(path: &std::path::Path, rows: &[&[&str]]) {
    sheets(path, &[("Punkte", rows)]);
}

/// Sheets as spreadsheets write them: every cell a text in place.
fn sheets(path: &std::path::Path, of_file: &[(&str, &[&[&str]])]) {
    autoref_raster::initialise_gdal(0);
    let driver = gdal::DriverManager::get_driver_by_name("XLSX").expect("GDAL has it");
    let mut dataset = driver.create_vector_only(path).expect("writable");
    of_file.iter().for_each(|(name, rows)| add_sheet(&mut dataset, name, rows));
}

fn add_sheet(dataset: &mut gdal::Dataset, name: &str, rows: &[&[&str]]) {
    use gdal::vector::{LayerAccess, LayerOptions, OGRFieldType, OGRwkbGeometryType};
    let layer = dataset
        .create_layer(LayerOptions { name, srs: None, ty: OGRwkbGeometryType::wkbNone, options: None })
        .expect("a sheet");
    // GDAL writes the titles of the fields as the first row.
    let titles: Vec<(&str, _)> = rows[0].iter().map(|title| (*title, OGRFieldType::OFTString)).collect();
    layer.create_defn_fields(&titles).expect("columns");
    for row in &rows[1..] {
        let mut feature = gdal::vector::Feature::new(layer.defn()).expect("a row");
        for (column, cell) in row.iter().enumerate().filter(|(_, cell)| !cell.is_empty()) {
            feature.set_field_string(column, cell).expect("text");
        }
        feature.create(&layer).expect("written");
    }
}

#[test]
fn sheets_of_text_and_below_a_title() {
    let folder = Folder::new();
    let options = GcpOptions { crs: Some("local".into()), ..GcpOptions::default() };
    let points: [&[&str]; 3] = [
        &["#1", "569.834,260", "7.031.894,724", "47,211"],
        &["#2", "570.032,865", "7.031.837,651", "43,898"],
        &["Summe", "1.139.867,125", "14.063.732,375", "91,109"],
    ];
    let titles: &[&str] = &["Punkt", "Rechtswert", "Hochwert", "Höhe"];
    for (name, above) in [
        ("a.xlsx", vec![titles]),
        ("b.xlsx", vec![&["Passpunkte 2026", "a", "b", "c"][..], titles, &["", "[m]", "[m]", "[m]"]]),
    ] {
        let path = folder.0.path().join(name);
        sheet(&path, &above.iter().chain(&points).copied().collect::<Vec<_>>());
        let list = gcp::read(&path, &options).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(names(&list), ["#1", "#2"], "{name}: {:?}", list.notes);
        let first = &list.gcps[0];
        let place = (first.easting, first.northing, first.height);
        assert_eq!(place, (569_834.26, 7_031_894.724, Some(47.211)), "{name}");
    }
    let path = folder.0.path().join("c.xlsx");
    sheet(&path, &[&["Punkt", "Höhe"], &["1", "47"], &["2", "48"]]);
    let error = gcp::read(&path, &options).expect_err("no coordinates").to_string();
    assert!(error.contains("c.xlsx") && error.contains("easting") && !error.contains('\n'), "{error}");
}

/// Points that were measured, as decimals show.
fn measured(below: &str) -> String {
    let points = "P1;569834.26;7031894.724;47.211\nP2;570032.865;7031837.651;52.18\nP3;569991.624;7031863.907;49.95\n\
                  P4;569871.118;7031750.33;44.007\n";
    format!("name;easting;northing;height\n{points}{below}")
}

#[test]
fn statistics_are_told_without_a_word() {
    let mean = "569932.467;7031836.653;48.337";
    let spread = "94.847;62.096;3.530";
    let four = ["P1", "P2", "P3", "P4"];
    for statistics in [
        format!("Querschnitt;{mean}\n"),
        format!(";{mean}\n"),
        format!("Hvadsomhelst;{spread}\n"),
        format!("Querschnitt;{mean}\nMin;569834.26;7031750.33;44.007\nMax;570032.865;7031894.724;52.18\n"),
        format!("Xyz;{spread}\nMean;{mean}\n"),
        format!("Xyz;{}\nWvu;{spread}\n", mean.replace(";48.337", ";")),
    ] {
        let list = read(&measured(&statistics));
        assert_eq!(names(&list), four, "{statistics}");
        says(&list, "set aside, since they are statistics of the rows above: `");
    }
}

#[test]
fn points_among_others_are_no_statistics() {
    // In the middle of the others, but at another height; under a name like theirs; far away, called as a statistic is.
    for (row, name, note) in [
        ("Mitte;569932.467;7031836.653;51.2\n", "Mitte", "`Mitte` has the numbers of a statistic"),
        ("P5;569932.467;7031836.653;48.337\n", "P5", ""),
        ("Max;574032.865;7038894.724;52.18\n", "Max", ""),
        ("S;574032.865;7031894.724;52.18\n", "S", ""),
    ] {
        let list = read(&measured(row));
        assert_eq!(names(&list), ["P1", "P2", "P3", "P4", name], "{row}");
        assert!(!list.notes.iter().any(|note| note.contains("set aside")), "{:?}", list.notes);
        assert!(note.is_empty() || list.notes.iter().any(|said| said.contains(note)), "{:?}", list.notes);
    }
    let square = "name;e;n;h\nSW;-10;-10;5\nSE;10;-10;7\nNE;10;10;9\nNW;-10;10;7\nCentre;0;0;7\n";
    assert_eq!(names(&read(square)), ["SW", "SE", "NE", "NW", "Centre"], "the middle of a drawn square");
}

#[test]
fn of_two_sets_of_coordinates_the_height_beside_the_pair_is_taken() {
    let rows = "A;569834.26;7031894.724;47.211;63.4;10.4;87.2\nB;570032.865;7031837.651;52.18;63.5;10.5;92.1\n";
    for titles in ["Name;E;N;Z;B;L;H", "Name;Easting;Northing;Elevation;Latitude;Longitude;Height"] {
        let list = read(&format!("{titles}\n{rows}"));
        assert_eq!(list.gcps[0].height, Some(47.211), "{titles}");
    }
}

#[test]
fn a_sheet_of_notes_is_passed_over_by_name() {
    let folder = Folder::new();
    let options = GcpOptions { crs: Some("local".into()), ..GcpOptions::default() };
    let points: &[&[&str]] = &[
        &["Punkt", "Rechtswert", "Hochwert"],
        &["1", "569834.26", "7031894.724"],
        &["2", "570032.865", "7031837.651"],
    ];
    let notes: &[&[&str]] = &[&["Datum", "Bemerkung"], &["13.05.2026", "2 Punkte, 1 Rover"], &["14.05.2026", "Regen"]];
    for order in [[("Punkte", points), ("Notizen", notes)], [("Notizen", notes), ("Punkte", points)]] {
        let path = folder.0.path().join("n.xlsx");
        let _ = std::fs::remove_file(&path);
        sheets(&path, &order);
        let list = gcp::read(&path, &options).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((names(&list), list.gcps[0].easting), (vec!["1", "2"], 569_834.26));
        says(&list, "passed over, without a list of points: sheet Notizen");
    }
    let path = folder.0.path().join("m.xlsx");
    sheets(&path, &[("Punkte", points), ("Mehr", points)]);
    let error = gcp::read(&path, &options).expect_err("two lists").to_string();
    assert!(error.contains("Punkte, Mehr") && error.contains("--gcp-layer"), "{error}");
}

#[test]
fn codes_before_the_name_name_no_point() {
    // Finland's GT: surface, line, code, point, X (north), Y, height.
    let gt = |point: u32, north: f64, east: f64| {
        format!("{:8}{:8}{:8}{point:8}{north:14.3}{east:14.3}{:14.3}\n", 0, 0, 110, 12.3)
    };
    let text = gt(1001, 7_031_894.724, 569_834.26) + &gt(1002, 7_031_837.651, 570_032.865);
    let list = read_in(Some("EPSG:32632"), &text).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((names(&list), list.gcps[0].easting), (vec!["1001", "1002"], 569_834.26));
    assert_eq!(list.gcps[0].height, Some(12.3));
    says(&list, "names are taken from column 4: those of column 1 repeat");
    // One name that stands twice is a mistake.
    let twice = "P1 11 569834.26 7031894.72\nP1 12 570032.87 7031837.65\nP3 13 569991.62 7031863.91\n";
    assert!(read_in(Some("local"), twice).expect_err("P1").contains("`P1` was used before"));
}

#[test]
fn where_nothing_shows_the_order_it_is_named_as_what_may_help() {
    let hints = |text: &str| read_in(Some("local"), text).expect("readable").hints;
    let local = hints("name,easting,northing\nA,105.7,92.6\nB,166.1,13.0\n");
    assert!(local.iter().any(|hint| hint.contains("do not show whether easting and northing")), "{local:?}");
    let utm = hints("name,easting,northing\nA,569834.2,7031894.7\nB,570032.8,7031837.6\n");
    assert!(utm.is_empty(), "{utm:?}");
}

#[test]
fn a_direction_beside_a_letter_says_which_is_which() {
    for [east, north] in [
        ["Y (E)", "X (N)"],
        ["X (E)", "Y (N)"],
        ["Rechtswert Y", "Hochwert X"],
        ["Y-Ost", "X-Nord"],
        ["Y东坐标", "X北坐标"],
        ["E LV95", "N LV95"],
        ["UTM32 \u{d8}st", "UTM32 Nord"],
    ] {
        for north_first in [false, true] {
            let (titles, row) =
                if north_first { ([north, east], "2092.6;1105.7") } else { ([east, north], "1105.7;2092.6") };
            let list = read(&format!("Name;{};Z\nA;{row};12.1\nB;1166.1;2013.4;13.2\n", titles.join(";")));
            let first = &list.gcps[0];
            assert_eq!((first.easting, first.northing, first.height), (1105.7, 2092.6, Some(12.1)), "{titles:?}");
        }
    }
    let error = read_in(Some("local"), "Name;X error;Y error\nA;1;2\nB;3;4\n").expect_err("no coordinates");
    assert!(error.contains("easting"), "{error}");
}

#[test]
fn coordinates_of_no_known_system_come_back_from_a_geopackage() {
    let folder = Folder::new();
    let list = folder.write("l.csv", "name,easting,northing\nA,569834.26,7031894.724\nB,570032.865,7031837.651\n");
    for name in ["a.gpkg", "a.fgb", "a.shp"] {
        let output = folder.0.path().join(name);
        gcp::convert::convert(&list, &output, &gcp::convert::ConvertOptions::default())
            .unwrap_or_else(|e| panic!("{e}"));
        let read = gcp::read(&output, &GcpOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((names(&read), read.gcps[0].easting), (vec!["A", "B"], 569_834.26), "{name}");
        assert!(read.crs.is_none(), "{name}: {:?}", read.crs);
    }
}

#[test]
fn a_letter_or_two_of_a_country_are_read_by_the_titles_they_make() {
    let rows = rows([0, 1, 2, 3]);
    for (encoding, titles) in [
        (encoding_rs::WINDOWS_1252, "Navn;Ø;N;H"),
        (encoding_rs::WINDOWS_1252, "Navn;\"Ø\";\"N\";\"H\""),
        (encoding_rs::WINDOWS_1252, "Punkt;Øst;Nord;Høyde"),
        (encoding_rs::WINDOWS_1254, "NOKTA ADI;SAĞA DEĞER (Y);YUKARI DEĞER (X);KOT"),
        (encoding_rs::WINDOWS_1254, "Nokta No;Y (sağa);X (yukarı);Yükseklik"),
        (encoding_rs::WINDOWS_1250, "Číslo bodu;Východ;Sever;Výška"),
        (encoding_rs::WINDOWS_1257, "Nosaukums;Austrumi;Ziemeļi;Augstums"),
    ] {
        let text = format!("{titles}\n{rows}");
        let (bytes, _, lossy) = encoding.encode(&text);
        assert!(!lossy, "{titles}");
        let options = GcpOptions { crs: Some("local".into()), ..GcpOptions::default() };
        let list = Folder::new().read("l.csv", bytes, &options).unwrap_or_else(|e| panic!("{titles}: {e}"));
        assert_eq!(names(&list), ["101", "102", "103"], "{titles}");
        assert_eq!((list.gcps[0].easting, list.gcps[0].height), (569_834.26, Some(47.2)), "{titles}");
    }
}

#[test]
fn degrees_minutes_and_seconds_in_one_number_are_read_under_titles_that_say_so() {
    let rows = "A;10.234255;63.2548;47.2\nB;10.2412;63.2559;43.9\nC;10.2301;63.2533;46.6\n";
    let seconds = "A;102342.55;632548;47.2\nB;102412;632559;43.9\nC;102301;632533;46.6\n";
    for (titles, rows) in [
        ("Nr;Lon (DDD.MMSS);Lat (DDD.MMSS);H", rows),
        ("Nr;Longitude (D.MS);Latitude;H", rows),
        ("Nr;Lon [DDDMMSS.ss];Lat [DDMMSS.ss];H", seconds),
    ] {
        let said = read_in(None, &format!("{titles}\n{rows}"));
        let degrees = read_in(
            None,
            "Nr;Lon;Lat;H\nA;10°23'42.55\";63°25'48\";47.2\nB;10°24'12\";63°25'59\";43.9\nC;10°23'1\";63°25'33\";46.6\n",
        );
        let (list, degrees) = (said.expect(titles), degrees.expect("angles"));
        says(&list, "degrees, minutes and seconds in one number");
        for (a, b) in list.gcps.iter().zip(&degrees.gcps) {
            let off = (a.easting - b.easting).hypot(a.northing - b.northing);
            assert!(off < 1e-6, "{titles}: {} lies {off} off", a.name);
        }
    }
    let wrong =
        read_in(None, "Nr;Lon (DDD.MMSS);Lat (DDD.MMSS)\nA;10.2342;63.2560\nB;10.2412;63.2559\nC;10.2301;63.2533\n");
    assert!(wrong.is_err_and(|e| e.contains("`63.2560`") && e.contains("end at 59")));
    // Without such titles they are what they were, and ten that could be such numbers are spoken of.
    let many: String = (0..5).map(|i| format!("{i};10.23{:02}55;63.2{i}48\n", 11 * i)).collect();
    let list = read_in(None, &format!("Nr;Lon;Lat\n{many}")).expect("degrees");
    says(&list, "`Lon` and `Lat` were taken as decimal degrees");
    let few = read_in(None, "Nr;Lon;Lat\nA;10.2342;63.2548\nB;10.2412;63.2559\nC;10.2301;63.2533\n").expect("degrees");
    assert!(!few.notes.iter().any(|note| note.contains("decimal degrees")), "{:?}", few.notes);
}
