//! Tables as spreadsheets and offices of other countries save them: read right, or refused in one line that names the
//! row.

use autoref_stream::gcp::{self, GcpList, GcpOptions};

const POINTS: [(&str, f64, f64, f64); 3] = [
    ("P1", 570_406.861, 7_032_516.804, 80.31),
    ("P2", 570_413.25, 7_032_503.5, 79.0),
    ("P3", 570_420.125, 7_032_490.75, 81.5),
];

/// Titles of name, easting, northing and height.
const TITLES: [[&str; 4]; 26] = [
    ["name", "easting", "northing", "height"],
    ["Point ID", "East", "North", "Elevation"],
    ["Name", "E (m)", "N (m)", "H (m)"],
    ["Punktnummer", "Rechtswert", "Hochwert", "Höhe"],
    ["Punkt", "Ostwert", "Nordwert", "Hoehe"],
    ["Navn", "Øst", "Nord", "Høyde"],
    ["Punktnavn", "Aust", "Nord", "Høgde"],
    ["Nafn", "Austur", "Norður", "Hæð"],
    ["Nazwa", "Wschód", "Północ", "Wysokość"],
    ["Nom", "Est", "Nord", "Altitude"],
    ["Matricule", "X", "Y", "Z"],
    ["Nombre", "Este", "Norte", "Altura"],
    ["Punto", "Este", "Norte", "Cota"],
    ["Namn", "Öst", "Norr", "Höjd"],
    ["Punkt", "Øst", "Nord", "Kote"],
    ["Nimi", "Itä", "Pohjoinen", "Korkeus"],
    ["Nome", "Est", "Nord", "Quota"],
    ["Naam", "Oost", "Noord", "Hoogte"],
    ["PNr", "Rechtswert", "Hochwert", "Höhe"],
    ["Pkt", "Rechtswert", "Hochwert", "Höhe"],
    ["Nummer", "Ostwert", "Nordwert", "Höhe"],
    ["Marke", "Ostwert", "Nordwert", "Höhe"],
    ["Point#", "East", "North", "Elev"],
    ["Target", "East", "North", "Z"],
    ["Ponto", "Este", "Norte", "Cota"],
    ["Название", "X", "Y", "Z"],
];

struct Form {
    separator: &'static str,
    decimal: &'static str,
    end: &'static str,
    /// Begin and end of each cell, and what stands behind the last.
    quote: &'static str,
    tail: &'static str,
}

const PLAIN: Form = Form { separator: ",", decimal: ".", end: "\n", quote: "", tail: "" };

fn table(titles: &[&str; 4], order: [usize; 4], form: &Form) -> String {
    let row = |cells: [String; 4]| {
        let cells: Vec<String> = order.iter().map(|&i| format!("{0}{1}{0}", form.quote, cells[i])).collect();
        cells.join(form.separator) + form.tail + form.end
    };
    let number = |v: f64| format!("{v:.3}").replace('.', form.decimal);
    let points = POINTS.iter().map(|&(name, e, n, h)| row([name.to_owned(), number(e), number(n), number(h)]));
    row(titles.map(str::to_owned)) + &points.collect::<String>()
}

fn read(bytes: &[u8]) -> Result<GcpList, String> {
    read_as("list.csv", bytes)
}

fn read_as(name: &str, bytes: &[u8]) -> Result<GcpList, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("writable");
    let options = GcpOptions { crs: Some("EPSG:25832".into()), ..GcpOptions::default() };
    gcp::read(&path, &options).map_err(|e| e.to_string())
}

#[track_caller]
fn is_read(bytes: &[u8], what: &str) {
    let list = read(bytes).unwrap_or_else(|e| panic!("{what}: {e}"));
    assert_eq!(list.gcps.len(), POINTS.len(), "{what}");
    for (gcp, (name, e, n, h)) in list.gcps.iter().zip(POINTS) {
        assert_eq!((gcp.name.as_str(), gcp.easting, gcp.northing, gcp.height), (name, e, n, Some(h)), "{what}");
    }
}

#[test]
fn titles_of_many_countries_in_every_form() {
    for titles in &TITLES {
        for (separator, decimal) in [(",", "."), (";", ","), ("\t", "."), ("\t", ","), (";", "."), ("|", ".")] {
            for order in [[0, 1, 2, 3], [2, 1, 3, 0]] {
                let text = table(titles, order, &Form { separator, decimal, ..PLAIN });
                is_read(text.as_bytes(), &text);
            }
        }
        let wide = |big: bool, mark: bool, text: &str| -> Vec<u8> {
            let marked = if mark { format!("\u{feff}{text}") } else { text.to_owned() };
            marked.encode_utf16().flat_map(|u| if big { u.to_be_bytes() } else { u.to_le_bytes() }).collect()
        };
        let text = table(titles, [0, 1, 2, 3], &Form { separator: "\t", decimal: ",", end: "\r\n", ..PLAIN });
        for (big, mark) in [(false, true), (true, true)] {
            is_read(&wide(big, mark, &text), &text);
        }
        is_read(format!("\u{feff}{text}").as_bytes(), &text);
        if text.chars().all(|c| u32::from(c) < 256) {
            is_read(&text.chars().map(|c| c as u8).collect::<Vec<u8>>(), &text);
        }
    }
}

#[test]
fn what_spreadsheets_do_to_tables() {
    let titles = &TITLES[0];
    let order = [0, 1, 2, 3];
    for form in [
        Form { end: "\r", ..PLAIN },
        Form { end: "\n\n", ..PLAIN },
        Form { quote: "\"", ..PLAIN },
        Form { quote: "\"", decimal: ",", ..PLAIN },
        Form { tail: ",", ..PLAIN },
        Form { separator: ";", decimal: ",", tail: ";;;", ..PLAIN },
        Form { separator: "   ", ..PLAIN },
    ] {
        let text = table(titles, order, &form);
        is_read(text.as_bytes(), &text);
    }
    let plain = table(titles, order, &PLAIN);
    for text in [
        plain.replace("\nP2", "\n\n,,,\n  \nP2"),
        plain.trim_end().to_owned(),
        format!("{plain}\u{1a}"),
        format!("# survey of 2016\n{plain}"),
        format!("sep=;\r\n{}", table(titles, order, &Form { separator: ";", decimal: ",", end: "\r\n", ..PLAIN })),
        table(&["\"name\"", "\"easting\n[m]\"", "\"northing\n[m]\"", "height"], order, &PLAIN),
        plain.replace("height\n", "height,note\n").replace("0\n", "0,\"seen\nfrom, the road\"\n"),
        plain.replace(",7032503.500", ",\"7,032,503.500\""),
    ] {
        is_read(text.as_bytes(), &text);
    }
}

#[test]
fn what_cannot_be_read_is_one_line_with_its_row() {
    let plain = table(&TITLES[0], [0, 1, 2, 3], &Form { separator: ";", ..PLAIN });
    for value in ["nan", "inf", "-inf", "1e309", "-", "#N/A", "", "1,2,3", "12..5", "0x1F", "1_000", "1e5e5", "57 0413"]
    {
        let said = read(plain.replace("570413.250", value).as_bytes()).expect_err(value);
        assert!(said.contains("row 3") && said.contains("easting") && !said.contains('\n'), "{value}: {said}");
    }
    let refused = |text: String, words: &[&str]| {
        let said = read(text.as_bytes()).expect_err(&text);
        assert!(words.iter().all(|word| said.contains(word)) && !said.contains('\n'), "{text}: {said}");
    };
    refused(plain.replace("P3", "P1"), &["row 4", "`P1`", "row 2"]);
    refused(plain.replace("height", "Easting"), &["row 1", "two columns", "remove or rename"]);
    refused(plain.replace("570413.250;7032503.500;79.000", "570413.250"), &["row 3", "northing"]);
    refused(plain.replace("P2", "\"P2"), &["row 3"]);
    refused(String::new(), &["row 1"]);
    refused("name;easting;northing\n".into(), &["list.csv", "point"]);
}

/// Programs name tables of text `.xls`, so that Excel opens them; what begins as its old workbooks do is GDAL's.
#[test]
fn a_table_of_text_may_be_named_as_a_workbook() {
    let text = table(&TITLES[3], [0, 1, 2, 3], &Form { separator: "\t", decimal: ",", ..PLAIN });
    assert_eq!(read_as("list.xls", text.as_bytes()).expect("text").gcps.len(), POINTS.len());
    let workbook = [&[0xD0, 0xCF, 0x11, 0xE0, 0xA1, 0xB1, 0x1A, 0xE1][..], &[0; 600]].concat();
    let said = read_as("list.xls", &workbook).expect_err("nothing is in it");
    assert!(said.contains("list.xls") && said.contains("save it as .xlsx or as CSV"), "{said}");
}
