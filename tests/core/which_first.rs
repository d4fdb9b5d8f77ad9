//! Which coordinate comes first, of which set, and what is no list at all.

use crate::lists_folder::Folder;
use autoref_stream::gcp::convert::{ConvertOptions, Converted, ListFormat, convert};
use autoref_stream::gcp::{self, GcpList, GcpOptions};

fn read(name: &str, text: &str, crs: &str, to_crs: Option<&str>) -> Result<GcpList, String> {
    let options = GcpOptions { crs: Some(crs.into()), to_crs: to_crs.map(str::to_owned), ..GcpOptions::default() };
    gcp::read(&Folder::new().write(name, text), &options).map_err(|e| e.to_string())
}

fn converted(name: &str, text: &str, output: &str, options: &ConvertOptions) -> Result<(Converted, String), String> {
    let folder = Folder::new();
    let output = folder.0.path().join(output);
    let done = convert(&folder.write(name, text), &output, options).map_err(|e| e.to_string())?;
    Ok((done, std::fs::read_to_string(output).expect("written")))
}

fn given(from: Option<ListFormat>, crs: Option<&str>) -> ConvertOptions {
    ConvertOptions { from, crs: crs.map(str::to_owned), ..ConvertOptions::default() }
}

#[track_caller]
fn says(error: &str, words: &[&str]) {
    assert!(words.iter().all(|word| error.contains(word)) && !error.contains('\n'), "{words:?}: {error}");
}

const LATITUDE_FIRST: &str = "G1,59.9139,10.7522,45.2\nG2,59.9145,10.7580,46.1\nG3,59.9155,10.7560,47.3\n";
const LONGITUDE_FIRST: &str = "G1,10.7522,59.9139,45.2\nG2,10.7580,59.9145,46.1\nG3,10.7560,59.9155,47.3\n";

#[test]
fn degrees_without_titles_are_read_where_something_shows_their_order() {
    for text in [LATITUDE_FIRST, LONGITUDE_FIRST] {
        let error = read("l.csv", text, "EPSG:4326", None).expect_err("either way");
        says(&error, &["row 1", "which is the latitude", "`name,lat,lon,height`"]);
        for (crs, to_crs) in [("EPSG:4326", Some("EPSG:32632")), ("EPSG:4258", None)] {
            let list = read("l.csv", text, crs, to_crs).expect("the area of use shows it");
            let (east, north) = (list.gcps[0].easting, list.gcps[0].northing);
            assert!((597_000.0..599_000.0).contains(&east) && (6.64e6..6.65e6).contains(&north), "{east} {north}");
        }
        let error = converted("l.csv", text, "o.csv", &given(None, None)).expect_err("either way");
        says(&error, &["row 1", "which is the latitude"]);
    }
    // X and Y in degrees are those of maps.
    let titled = format!("name,x,y,h\n{LONGITUDE_FIRST}");
    let list = read("l.csv", &titled, "EPSG:4326", None).expect("titles");
    assert_eq!(list.crs.and_then(|crs| crs.epsg()), Some(32632));
}

#[test]
fn pix4d_has_the_latitude_first() {
    for crs in [None, Some("EPSG:4326")] {
        let (done, text) =
            converted("l.csv", LATITUDE_FIRST, "o.csv", &given(Some(ListFormat::Pix4d), crs)).expect("read");
        assert!(
            text.contains("G1,10.7522,59.9139,45.2") && done.crs.and_then(|crs| crs.epsg()) == Some(4326),
            "{text}"
        );
        assert!(done.notes.iter().any(|note| note.contains("latitude comes first")), "{:?}", done.notes);
    }
    let numbers = LATITUDE_FIRST.replace('G', "2024.");
    let (_, text) = converted("l.csv", &numbers, "o.csv", &given(Some(ListFormat::Pix4d), None)).expect("labels");
    assert!(text.contains("2024.1,10.7522,59.9139,45.2"), "{text}");
    let titled = format!("name,lon,lat,h\n{LONGITUDE_FIRST}");
    let (_, text) = converted("l.csv", &titled, "pix4d.csv", &ConvertOptions::default()).expect("written");
    assert_eq!(text, LATITUDE_FIRST.replace("10.7580", "10.758").replace("10.7560", "10.756"));
    let map = "G1,597979.9,6643118.9,45\nG2,598302.4,6643194.2,46\n";
    let (_, text) =
        converted("l.csv", map, "o.csv", &given(Some(ListFormat::Pix4d), Some("EPSG:25832"))).expect("read");
    assert!(text.contains("G1,597979.9,6643118.9,45"), "{text}");
}

#[test]
fn angles_without_titles_have_letters() {
    let text = "P1;59°54'50.04\"N;10°45'07.92\"E;45.2\nP2;59°54'52.20\"N;10°45'28.80\"E;46.1\n";
    for text in [text.to_owned(), text.replace(';', ","), text.replace(';', " ")] {
        let (_, written) = converted("l.csv", &text, "o.csv", &ConvertOptions::default()).expect(&text);
        assert!(written.contains("P1,10.7522") && written.contains(",59.9139,45.2"), "{written}");
    }
    let error =
        converted("l.csv", "P1;59:54:50.04;10:45:07.92\nP2;59:54:52.2;10:45:28.8\n", "o.csv", &given(None, None));
    says(&error.expect_err("no letters"), &["row 1", "59:54:50.04", "`name;lat;lon;height`"]);
    let error = converted("l.csv", "name;x;y\nP1;10:45:07.92;59:54:50.04\n", "o.csv", &given(None, None));
    says(&error.expect_err("angles"), &["row 2", "it is an angle", "`lon` and `lat`"]);
}

#[test]
fn of_two_sets_of_coordinates_the_given_crs_means_one() {
    let rows = "G1,59.9139,10.7522,597979.9,6643118.9,45.2\nG2,59.9145,10.7580,598302.4,6643194.2,46.1\n";
    for titles in ["name,lat,lon,X,Y,h", "name,lat,lon,Easting,Northing,h"] {
        let text = format!("{titles}\n{rows}");
        let list = read("l.csv", &text, "EPSG:25832", None).expect("a map");
        assert_eq!([list.gcps[0].easting, list.gcps[0].northing], [597_979.9, 6_643_118.9]);
        let (_, written) = converted("l.csv", &text, "o.csv", &given(None, Some("EPSG:4258"))).expect("degrees");
        assert!(written.contains("G1,10.7522,59.9139,45.2"), "{written}");
    }
    let error = read("l.csv", "name,lat,lon\nA,59.9139,10.7522\nB,59.9145,10.7580\n", "EPSG:25832", None);
    says(&error.expect_err("degrees alone"), &["degrees", "--crs EPSG:4326"]);
}

#[test]
fn what_cannot_be_is_not_converted() {
    let refused = |text: &str, crs: &str, words: &[&str]| {
        let error = converted("l.csv", text, "o.csv", &given(None, Some(crs))).expect_err(text);
        says(&error, words);
    };
    let krovak = "742000.5,1043000.3,250\n2,742100.5,1043050.3,250\n3,742050.5,1043150.3,250\n";
    for text in [format!("name,Y,X,H\n1,{krovak}"), format!("1,{krovak}")] {
        refused(&text, "EPSG:5514", &["minus sign before both coordinates"]);
    }
    let swapped = "name,easting,northing\nA,6643118.9,597979.9\nB,6643194.2,598302.4\n";
    refused(swapped, "EPSG:25832", &["exchange the columns"]);
    let list = "name,easting,northing\nA,597979.9,6643118.9\nB,598302.4,6643194.2\n";
    refused(list, "EPSG:2193", &["outside the area of use", "--crs"]);
    refused(&format!("{list}C,1e308,1e308\n"), "EPSG:25832", &["row 4", "nowhere"]);
    let (done, _) =
        converted("l.csv", &format!("{list}C,5979.9,664311.9\n"), "o.csv", &given(None, Some("EPSG:25832")))
            .expect("one point alone");
    assert!(done.notes.iter().any(|note| note.contains("outside the area of use") && note.ends_with(": C")));
    // Where the authority itself calls the northing X, titles of X and Y say nothing.
    let poland = "name,Y,X\nA,637123.4,487654.3\nB,637223.4,487554.3\n";
    refused(poland, "EPSG:2180", &["X is the northing", "`easting` and `northing`"]);
    read("l.csv", &poland.replace("Y,X", "Y (E),X (N)"), "EPSG:2180", None).expect("said");
}

#[test]
fn a_track_is_no_list() {
    let track = "% program   : RTKLIB\n%  GPST  latitude(deg) longitude(deg) height(m) Q ns\n\
                 2019/05/01 08:00:00.000 59.9139 10.7522 45.2 1 10\n2019/05/01 08:00:01.000 59.9139 10.7523 45.2 1 10\n";
    let error = read("track.pos", track, "EPSG:4326", None).expect_err("a track");
    says(&error, &["row 2", "RTKLIB", "2 places", "take the mean"]);
}

#[test]
fn names_of_images_have_blanks() {
    let text = "EPSG:32632\n597966.2 6643165.9 45.2 100 200 my image 1.jpg G1\n\
                598287.0 6643242.0 46.1 300 400 my image 1.JPG G2\n598172.0 6643350.0 46.1 30 40 my image 2.jpg G3\n";
    for text in [text.to_owned(), text.replace(" G1", "").replace(" G2", "").replace(" G3", "")] {
        let (done, written) = converted("gcp_list.txt", &text, "o.geojson", &given(None, None)).expect("read");
        assert!(done.points == 3 && written.contains("\"my image 2.jpg\""), "{written}");
        assert_eq!(written.contains("\"G3\""), text.contains("G3"));
    }
}

#[test]
fn line_ends_in_names_stay_out_of_lists_that_are_read_by_lines() {
    let text = "name,e,n,h\n\"A\nB\",597966.2,6643165.9,45\nC,597866.2,6643065.9,45\n";
    for (output, to) in
        [("o.csv", ListFormat::Pix4d), ("o.csv", ListFormat::MetashapeCsv), ("o.points", ListFormat::Qgis)]
    {
        let options = ConvertOptions { to: Some(to), ..given(None, Some("EPSG:25832")) };
        let (done, written) = converted("l.csv", text, output, &options).expect("written");
        assert!(written.contains("A B") && done.lost.iter().any(|lost| lost.contains("of 1 name")), "{written}");
    }
}

#[test]
fn quota_is_a_height_beside_letters() {
    let list =
        read("l.csv", "Punto;E;N;Q\nA;290123,4;4641234,5;201,25\nB;290223,4;4641134,5;202\n", "EPSG:32633", None);
    assert_eq!(list.expect("read").gcps[0].height, Some(201.25));
}

#[test]
fn names_stand_under_titles_of_properties_too() {
    let feature = |name: &str, east: f64| {
        format!(
            "{{\"type\":\"Feature\",\"properties\":{{\"punkt\":\"{name}\"}},\"geometry\":{{\"type\":\"Point\",\
             \"coordinates\":[{east},6643165.9]}}}}"
        )
    };
    let text = format!(
        "{{\"type\":\"FeatureCollection\",\"features\":[{},{}]}}",
        feature("A", 597_966.2),
        feature("B", 598_066.2)
    );
    let list = read("l.geojson", &text, "EPSG:25832", None).expect("points");
    assert_eq!([&list.gcps[0].name, &list.gcps[1].name], ["A", "B"]);
}

#[test]
fn thousands_that_nothing_shows_are_refused_near_the_origin() {
    let text = "name;x;y;h\nA;429,990;285,551;409\nB;429,805;285,743;106\n";
    says(&read("l.csv", text, "EPSG:27700", None).expect_err("thousands"), &["`429,990` (row 2)", "without it"]);
    read("l.csv", text, "local", None).expect("decimals of a local list");
}

#[test]
fn rows_that_are_cut_otherwise_and_what_excel_is_told() {
    let error = read("l.csv", "name;e;n\nA;1.5;2.5\nB,1.5,2.5\n", "local", None).expect_err("commas");
    says(&error, &["row 3", "`B,1.5,2.5` is one cell under 3 titles"]);
    for rows in [
        "A;597966.2;6643165.9;1\nB;597866.2;6643065.9;2\n",
        "A \"5'334'320.9\" \"4'468'191.5\" 1\nB 5334220.9 4468091.5 2\n",
    ] {
        let list = read("l.csv", &format!("sep=;\n{rows}"), "local", None).expect(rows);
        assert_eq!(list.gcps[0].name, "A");
    }
}

#[test]
fn numbers_that_a_spreadsheet_rounded_are_refused() {
    let error = read("l.csv", "id;east;north\nP1;5,98E+05;6,64E+06\nP2;5,98E+05;6,64E+06\n", "EPSG:25832", None);
    says(&error.expect_err("rounded"), &["row 2", "`5,98E+05` is rounded to 1000", "save again"]);
    let list = read("l.csv", "id;east;north\nP1;5.979662E+05;6.6431659E+06\nP2;5.98E5;6.6431E6\n", "local", None);
    says(&list.expect_err("the second"), &["row 3"]);
    let whole = "id;east;north\nP1;5.979662E+05;6.6431659E+06\nP2;5.980662E+05;6.6432659E+06\n";
    assert_eq!(read("l.csv", whole, "EPSG:25832", None).expect("all digits").gcps[0].easting, 597_966.2);
    let error = read("l.csv", "id;east;north\nP1;1,5 m;2,5 m\nP2;2,5 m;3,5 m\n", "local", None).expect_err("units");
    says(&error, &["row 2", "the unit into the title"]);
}

#[test]
fn turkish_axis_names_are_read_in_their_order() {
    for title in ["NN", "N.N"] {
        let text = format!("{title}\tY\tX\tH\nA\t500123.4\t4420123.4\t900\nB\t500223.4\t4420223.4\t901\n");
        let list = read("l.txt", &text, "EPSG:5253", None).expect("read");
        assert_eq!((list.gcps[0].name.as_str(), list.gcps[0].height), ("A", Some(900.0)));
    }
}
