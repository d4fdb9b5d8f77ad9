//! What titles and systems say of coordinates: units, degrees, and axes that are exchanged or turned.

use autoref_raster::coords::GeoTransform;
use autoref_stream::gcp::{self, GcpList, GcpOptions, ImageGeoreference, Reproject};

fn read(text: &str, options: &GcpOptions) -> Result<GcpList, String> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("l.csv");
    std::fs::write(&path, text).expect("writable");
    gcp::read(&path, options).map_err(|e| e.to_string())
}

fn within(crs: &str) -> GcpOptions {
    GcpOptions { crs: Some(crs.into()), ..GcpOptions::default() }
}

#[track_caller]
fn refused(text: &str, options: &GcpOptions, words: &[&str]) {
    let error = read(text, options).expect_err("a mistake");
    for word in words {
        assert!(error.contains(word), "no `{word}` in: {error}");
    }
}

#[test]
fn units_of_titles_are_applied() {
    let rows = "A,1000,2000,10\nB,1100,2000,11\n";
    let feet = 1200.0 / 3937.0;
    for (unit, metres) in [
        ("m", 1.0),
        ("mm", 0.001),
        ("cm", 0.01),
        ("km", 1000.0),
        ("ft", 0.3048),
        ("US ft", feet),
        ("ftUS", feet),
        ("Fuß", 0.3048),
        ("mètres", 1.0),
        ("WGS84", 1.0),
    ] {
        let list = read(&format!("name,Easting ({unit}),Northing [{unit}],Elev\n{rows}"), &GcpOptions::default());
        let list = list.unwrap_or_else(|e| panic!("{e}"));
        let (b, expected) = (&list.gcps[1], (1100.0 * metres, 2000.0 * metres));
        assert!((b.easting - expected.0).abs() < 1e-9 && (b.northing - expected.1).abs() < 1e-9, "{unit}: {b:?}");
        assert!((b.height.expect("a height") - 11.0 * metres).abs() < 1e-9, "{unit}: {b:?}");
        assert_eq!(
            list.notes.iter().any(|n| n.contains("brought to metres")),
            metres != 1.0,
            "{unit}: {:?}",
            list.notes
        );
    }
    let titles = "name,Easting (m),Northing (m),H (ft),sigma E (mm),sigma N (mm)";
    let utm = &format!("{titles}\nA,570400,7032500,100,3,4\nB,570420,7032500,100,3,4\n");
    let a = &read(utm, &within("EPSG:25832")).expect("readable").gcps[0];
    assert!((a.sigma_m.expect("one") - 0.003_535_534).abs() < 1e-9, "{:?}", a.sigma_m);
    assert!((a.height.expect("one") - 30.48).abs() < 1e-9, "{:?}", a.height);
}

/// Accuracies were read as metres beside coordinates in feet; a titled `sigma_m` is metres still.
#[test]
fn accuracies_without_a_unit_are_in_that_of_the_coordinates() {
    let feet = 1200.0 / 3937.0;
    let rows = "A,999978.608,199999.206,328,0.1,0.2\nB,999934.926,199962.071,329,0.1,0.2\n";
    let appuis: String = [("A", "999978.608 199999.206 328"), ("B", "999934.926 199962.071 329")]
        .map(|(name, at)| {
            format!(
                "<OneAppuisDAF><Pt>{at}</Pt><NamePt>{name}</NamePt><Incertitude>0.1 0.1 0.2</Incertitude></OneAppuisDAF>"
            )
        })
        .concat();
    let micmac = format!("<DicoAppuisFlottant>{appuis}</DicoAppuisFlottant>");
    let titled = format!("name,easting,northing,height,sigma_m,sigma_height_m\n{rows}");
    for (text, unit) in [(rows, feet), (&micmac, feet), (&titled, 1.0)] {
        let list = read(text, &within("EPSG:2263")).unwrap_or_else(|e| panic!("{e}"));
        let sigmas = (list.gcps[0].sigma_m.expect("one"), list.gcps[0].sigma_height_m.expect("one"));
        assert!((sigmas.0 - 0.1 * unit).abs() < 1e-9 && (sigmas.1 - 0.2 * unit).abs() < 1e-9, "{text}: {sigmas:?}");
    }
    let metres = read("A,570400,7032500,100,0.1,0.2\nB,570420,7032500,100,0.1,0.2\n", &within("EPSG:25832"));
    assert_eq!(metres.expect("readable").gcps[0].sigma_m, Some(0.1));
}

#[test]
fn units_that_contradict_the_system_are_refused() {
    let rows = "A,980000,200000\nB,980100,200000\n";
    refused(
        &format!("name,Easting (m),Northing (m)\n{rows}"),
        &within("EPSG:2263"),
        &["`Easting (m)`", "EPSG:2263", "--crs"],
    );
    refused(&format!("name,Easting (m),Northing (ft)\n{rows}"), &GcpOptions::default(), &["two units"]);
    // Feet may be of the kind that the system counts in.
    for unit in ["ft", "US survey feet"] {
        let list = read(&format!("name,Easting ({unit}),Northing ({unit})\n{rows}"), &within("EPSG:2263"));
        let list = list.unwrap_or_else(|e| panic!("{e}"));
        assert!((list.gcps[0].easting - 980_000.0 * 1200.0 / 3937.0).abs() < 1e-6, "{unit}: {:?}", list.gcps[0]);
    }
    let utm = "name,Easting (ft),Northing (ft)\nA,570400,7032500\nB,570420,7032500\n";
    refused(utm, &within("EPSG:25832"), &["`Easting (ft)`", "feet"]);
}

#[test]
fn a_table_of_errors_may_be_in_millimetres() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let table = folder.path().join("errors.csv");
    std::fs::write(&table, "name,sigma (mm)\nA,5\nB,7\n").expect("writable");
    let options = GcpOptions { accuracy: Some(table), ..within("EPSG:25832") };
    let list = read("name,easting,northing\nA,570400,7032500\nB,570420,7032500\n", &options).expect("readable");
    assert_eq!(list.gcps.iter().map(|g| g.sigma_m).collect::<Vec<_>>(), [Some(0.005), Some(0.007)]);
}

#[test]
fn titles_of_degrees_are_no_projected_coordinates() {
    let rows = "A,63.41,10.38\nB,63.42,10.39\n";
    let text = format!("name,lat,lon\n{rows}");
    refused(&text, &within("EPSG:25832"), &["degrees", "--crs EPSG:4326", "--to-crs EPSG:25832"]);
    let options = GcpOptions { to_crs: Some("EPSG:25832".into()), ..GcpOptions::default() };
    assert!(read(&text, &options).is_ok());
}

#[test]
fn exchanged_degrees_are_told_by_the_system_that_is_asked_for() {
    let text = "name,lon,lat\nA,63.41,10.38\nB,63.42,10.39\n";
    let options = GcpOptions { to_crs: Some("EPSG:25832".into()), ..GcpOptions::default() };
    refused(text, &options, &["longitude and latitude exchanged", "--fix-axes"]);
    let mended = read(text, &GcpOptions { fix_axes: true, ..options }).expect("mended");
    assert!((mended.gcps[0].easting - 569_000.0).abs() < 2_000.0, "{:?}", mended.gcps[0]);
    assert!(
        mended.notes.iter().any(|note| note.contains("longitude and latitude were exchanged")),
        "{:?}",
        mended.notes
    );
}

#[test]
fn axes_that_mirror_the_ground_are_refused_with_those_that_do_not() {
    let text = "cislo;Y;X\nA;744941.190;1044996.551\nB;744967.612;1044990.543\n";
    for code in ["EPSG:5513", "EPSG:2065"] {
        refused(text, &within(code), &["south, then west", "EPSG:5514", "−Y"]);
    }
    refused(text, &within("EPSG:5514"), &["minus sign before both"]);
    let upright = "cislo;Y;X\nA;-744941.190;-1044996.551\nB;-744967.612;-1044990.543\n";
    assert!(read(upright, &within("EPSG:5514")).is_ok());
}

#[test]
fn a_system_that_stretches_the_ground_is_known() {
    let text = "name,easting,northing\nA,569000,7033000\nB,569060,7033000\nC,569060,7033045\nD,569000,7033045\n";
    let bend = |to: &str, reproject: Reproject| {
        let options = GcpOptions { to_crs: Some(to.into()), reproject, ..within("EPSG:25832") };
        read(text, &options).expect("readable").working_crs.bend().cloned()
    };
    for to in ["EPSG:3035", "EPSG:3857"] {
        let bent = bend(to, Reproject::Before).expect("another system");
        assert!(bent.explains(bent.rms_m) && bent.note().contains("--reproject after"), "{to}: {bent:?}");
        assert_eq!(bend(to, Reproject::After), None);
    }
    let neighbour = bend("EPSG:25833", Reproject::Before).expect("another system");
    assert!(!neighbour.explains(neighbour.rms_m), "{neighbour:?}");
}

/// Millimetres were outside the area of use and no more, though feet were recognised.
#[test]
fn millimetres_are_recognised_outside_the_area_of_use() {
    let rows = "name,easting,northing\nA,570642549,7034055208\nB,570602892,7034071944\n";
    refused(rows, &within("EPSG:25832"), &["if they were millimetres", "call the columns `Easting (mm)`"]);
    let titled = rows.replace("easting,northing", "Easting (mm),Northing (mm)");
    let list = read(&titled, &within("EPSG:25832")).expect("the remedy helps");
    assert!((list.gcps[0].easting - 570_642.549).abs() < 1e-6, "{:?}", list.gcps[0]);
}

/// Feet, and a zone's number before the eastings, were sent to options that wrote them as they were, or in a circle.
#[test]
fn what_a_refusal_beside_an_image_advises_makes_the_list_readable() {
    let image = ImageGeoreference {
        crs_wkt: "EPSG:32632".into(),
        transform: Some(GeoTransform([570_000.0, 0.03, 0.0, 7_033_000.0, 0.0, -0.03])),
        size_px: (4000, 3000),
    };
    let beside = GcpOptions { image: Some(image), ..GcpOptions::default() };
    let rows = |titles: &str, more: f64, unit: f64| {
        let points = [("A", 570_050.0, 7_032_950.0), ("B", 570_100.0, 7_032_960.0), ("C", 570_070.0, 7_032_920.0)];
        let row = |(name, e, n): (&str, f64, f64)| format!("{name},{:.4},{:.4}\n", (e + more) / unit, n / unit);
        format!("name,{titles}\n{}", points.map(row).concat())
    };
    let said = |text: &str, options: &GcpOptions| read(text, options).expect_err("a mistake");
    for (unit, name) in [(0.3048, "ift"), (1200.0 / 3937.0, "US ft")] {
        let feet = said(&rows("easting,northing", 0.0, unit), &beside);
        assert!(feet.contains("if they were feet") && feet.contains(&format!("({name})")), "{feet}");
        assert!(!feet.contains("--crs local"), "{feet}");
        let list = read(&rows(&format!("Easting ({name}),Northing ({name})"), 0.0, unit), &beside).expect("the remedy");
        assert!((list.gcps[0].easting - 570_050.0).abs() < 1e-3, "{:?}", list.gcps[0]);
        assert_eq!(list.crs.map(|crs| crs.label()).as_deref(), Some("EPSG:32632"));
    }
    refused(&rows("Easting (ft),Northing (ft)", 0.0, 0.3048), &beside, &["no certain kind", "(ift)"]);
    let local = GcpOptions { crs: Some("local".into()), ..beside.clone() };
    let hints = read(&rows("easting,northing", 0.0, 0.3048), &local).expect("local numbers").hints.join("; ");
    assert!(hints.contains("leave --crs local out") && !hints.contains("exchange"), "{hints}");

    let zone_32 = within("EPSG:32632");
    let zone = said(&rows("easting,northing", 32e6, 1.0), &zone_32);
    assert!(zone.contains("take the 32 away from all eastings") && !zone.contains("--force"), "{zone}");
    let other = said(&rows("easting,northing", 33e6, 1.0), &zone_32);
    assert!(other.contains("take the 33 away") && other.contains("--crs of zone 33"), "{other}");
    let kept = GcpOptions { keep_outside: true, ..zone_32 };
    let notes = read(&rows("easting,northing", 32e6, 1.0), &kept).expect("forced").notes.join("; ");
    assert!(notes.contains("zone's number 32") && notes.contains("--force outside-area"), "{notes}");
    let geocentric = "name,X,Y,Z\nA,2815101.483,516965.179,5680848.831\nB,2815081.472,516976.042,5680857.880\n";
    refused(geocentric, &beside, &["`cs2cs EPSG:4978 EPSG:32632`"]);
}

/// The name of the system in Emlid's tables was not understood.
#[test]
fn the_name_of_a_system_in_a_column_is_read() {
    let table = |first: &str, second: &str| {
        let text = format!(
            "Name,Easting,Northing,CS name\nA,570642.549,7034055.208,{first}\nB,570602.892,7034071.944,{second}\n"
        );
        read(&text, &GcpOptions::default()).unwrap_or_else(|e| panic!("{e}"))
    };
    let utm = "ETRS89 / UTM zone 32N";
    let list = table(utm, utm);
    assert_eq!(list.crs.as_ref().map(autoref_raster::crs::Crs::label).as_deref(), Some("EPSG:25832"));
    assert!(list.notes.iter().all(|note| !note.contains("CS name")), "{:?}", list.notes);
    for (list, words) in [
        (table(utm, "ETRS89 / UTM zone 33N"), "so neither was taken"),
        (table("My site", "My site"), "which PROJ does not know"),
        (table("WGS84", "WGS84"), "not what its coordinates count in"),
    ] {
        assert!(list.crs.is_none(), "{words}: {:?}", list.crs);
        assert!(list.notes.iter().any(|note| note.contains(words)), "{words}: {:?}", list.notes);
    }
}

#[test]
fn heights_go_along_into_the_unit_of_another_system() {
    let us_foot = 1200.0 / 3937.0;
    let to = |crs: &str, to_crs: &str, reproject| GcpOptions {
        crs: Some(crs.into()),
        to_crs: Some(to_crs.into()),
        reproject,
        ..GcpOptions::default()
    };
    let feet = "name,easting,northing,height\nA,3120000,13840000,100\nB,3120400,13840000,100\n";
    for reproject in [Reproject::Before, Reproject::After] {
        let list = read(feet, &to("EPSG:2278", "EPSG:26914", reproject)).expect("one datum");
        assert!(
            (list.gcps[0].height.expect("one") - 100.0 * us_foot).abs() < 1e-9,
            "{reproject:?}: {:?}",
            list.gcps[0]
        );
    }
    let degrees = "name,lon,lat,height\nA,-95.4,29.7,30.48\nB,-95.399,29.7,30.48\n";
    let crs = "EPSG:4269";
    let list = read(degrees, &to(crs, "EPSG:2278", Reproject::Before)).expect("near enough");
    assert!((list.gcps[0].height.expect("one") - 30.48).abs() < 1e-9, "{crs}: {:?}", list.gcps[0]);
    assert!(list.notes.iter().any(|note| note.contains("heights were brought")), "{:?}", list.notes);
    assert!(!list.notes.iter().any(|note| note.contains("taken to be in the same unit")), "{:?}", list.notes);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (from, into) = (folder.path().join("l.csv"), folder.path().join("out.csv"));
    std::fs::write(&from, degrees).expect("writable");
    let options = gcp::convert::ConvertOptions {
        crs: Some("EPSG:4269".into()),
        to_crs: Some("EPSG:2278".into()),
        ..Default::default()
    };
    gcp::convert::convert(&from, &into, &options).expect("convertible");
    let written = std::fs::read_to_string(&into).expect("written");
    assert!(written.contains(",99.9998"), "30.48 m are 99.9998 US survey feet: {written}");
}
