//! `flight` and what frames are like: broken ones, film, EXIF, clicks in a page, MicMac instead of COLMAP.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use serde_json::Value;

use super::flight::{Place, SIDE, autoref, expect, json, said, text};
use crate::common::data;

fn run(bin: Option<&Path>, words: &[&str]) -> std::process::Output {
    autoref(&[&["flight"], words].concat(), bin, &[])
}

#[test]
fn a_bad_frame_stops_no_other() {
    let place = Place::new();
    place.five_frames();
    let whole = std::fs::read(place.at("frames/f0.png")).expect("drawn");
    std::fs::write(place.at("frames/f5.png"), &whole[..whole.len() / 2]).expect("written");
    std::fs::write(place.at("frames/f6.png"), "not a picture").expect("written");
    std::fs::write(place.at("frames/e0.png"), b"").expect("written");
    let small = gdal::DriverManager::get_driver_by_name("MEM").expect("there").create("", 8, 8, 1).expect("in memory");
    let png = gdal::DriverManager::get_driver_by_name("PNG").expect("there");
    small.create_copy(&png, place.at("frames/f7.png"), &Default::default()).expect("written");
    let toml = place.init();
    let output = run(Some(&place.stand_in()), &["solve", text(&toml), "-o", text(&place.at("out")), "--json"]);
    expect(&output, 0, &["f5.png: left out", "f6.png: left out", "e0.png: left out", "f7.png: left out: it has 8 x 8"]);
    let document = json(&output);
    assert_eq!((document["frames_registered"].as_u64(), document["frames_listed"].as_u64()), (Some(5), Some(9)));
    let notes = document["notes"].to_string();
    assert!(["e0.png", "f5.png", "f6.png", "f7.png"].iter().all(|name| notes.contains(name)), "{notes}");
}

#[test]
fn a_frame_that_the_table_lacks_is_placed_between_its_neighbours() {
    let place = Place::new();
    place.five_frames();
    let table = std::fs::read_to_string(place.at("table.csv")).expect("written");
    let fewer: String = table.lines().filter(|l| !l.contains("f2")).map(|l| format!("{l}\n")).collect();
    place.write("table.csv", &fewer);
    let toml = place.at("FLIGHT.toml");
    let (frames, table, gcps) = (place.at("frames"), place.at("table.csv"), place.at("gcps.txt"));
    let words = ["init", text(&frames), "--cameras", text(&table), "--gcps", text(&gcps), "-o", text(&toml)];
    expect(&run(None, &[&words[..], &["--crs", "local", "--f-px", "500"]].concat()), 0, &["4 of 4 rows"]);
    let output = run(Some(&place.stand_in()), &["solve", text(&toml), "-o", text(&place.at("out")), "--json"]);
    // The warped ties are tried: every frame has a place.
    expect(&output, 0, &["rough_ties"]);
    assert_eq!(json(&output)["frames_registered"], 5);
}

#[test]
fn init_knows_resampled_film() {
    let place = Place::new();
    std::fs::create_dir(place.at("frames")).expect("a folder");
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let said_by = |name: &str, words: &str| {
        use gdal::Metadata;
        let mut set = driver.create(place.at("frames").join(name), 40, 40, 1).expect("a file");
        set.set_metadata_item("TIFFTAG_IMAGEDESCRIPTION", words, "").expect("a tag");
    };
    let words = r#"{"camera": "svalbard-zeiss-1936", "pixel_mm": 0.1, "film_of_first_pixel_mm": [2.2, 3.1]}"#;
    said_by("1.resampled.tif", words);
    said_by("2.resampled.tif", words);
    said_by("1.mask.tif", words);
    let (frames, toml) = (place.at("frames"), place.at("FLIGHT.toml"));
    expect(&run(None, &["init", text(&frames), "-o", text(&toml)]), 0, &[]);
    let written = std::fs::read_to_string(&toml).expect("written");
    let project: toml::Value = toml::from_str(&written).expect("TOML");
    assert!(
        written.contains("a flight of 2 frames") || written.contains("A flight of 2 frames"),
        "masks are no frames: {written}"
    );
    let f_px = project["camera"]["f_px"].as_float().expect("a number");
    assert!((f_px - 2107.1).abs() < 1e-6 && project["camera"]["focal"].as_str() == Some("held"), "{written}");
    let pp: Vec<f64> =
        project["camera"]["pp_px"].as_array().expect("two").iter().filter_map(|v| v.as_float()).collect();
    assert!((pp[0] - 873.525).abs() < 1e-6 && (pp[1] - 873.0).abs() < 1e-6, "{pp:?}");
    let again = ["init", text(&frames), "-o", text(&toml), "--overwrite"];
    expect(&run(None, &[&again[..], &["--film", "no-such-camera"]].concat()), 2, &["no-such-camera", "--list-cameras"]);
    place.five_frames();
    std::fs::remove_file(place.at("frames/1.resampled.tif")).expect("removed");
    std::fs::remove_file(place.at("frames/2.resampled.tif")).expect("removed");
    expect(&run(None, &[&again[..], &["--film", "wild-15-4"]].concat()), 2, &["f0.png", "--f-px"]);
}

/// A drone's photograph twice: focal length and positions come from it.
#[test]
fn init_takes_focal_length_and_positions_from_exif() {
    let Some(photo) = data("photos/construction_caliterra.jpg") else { return };
    let place = Place::new();
    std::fs::create_dir(place.at("frames")).expect("a folder");
    for name in ["a.jpg", "b.jpg"] {
        std::fs::copy(&photo, place.at("frames").join(name)).expect("copied");
    }
    let (frames, toml) = (place.at("frames"), place.at("F.toml"));
    expect(&run(None, &["init", text(&frames), "-o", text(&toml)]), 0, &["EXIF: focal length", "EXIF: 2 positions"]);
    let project: toml::Value = toml::from_str(&std::fs::read_to_string(&toml).expect("there")).expect("TOML");
    assert_eq!(project["camera"]["focal"].as_str(), Some("rough"));
    assert!(project["crs"].as_str().is_some_and(|c| c.starts_with("EPSG:326") || c.starts_with("EPSG:327")));
    let table = autoref_flight::read::tables::cameras(&place.at("F_gps.csv")).expect("a table");
    assert_eq!((table.len(), table[0].name.as_str()), (2, "a.jpg"));
    expect(&run(None, &["init", text(&frames), "-o", text(&place.at("F2.toml")), "--crs", "local"]), 0, &[]);
    assert!(!place.at("F2_gps.csv").exists());
}

#[test]
fn the_page_for_clicks_has_what_is_known_and_its_list_is_read() {
    let place = Place::new();
    place.five_frames();
    let toml = place.init();
    let click = |more: &[&str]| run(None, &[&["click", text(&toml), "-o", text(&place.at("clicks"))], more].concat());
    expect(&click(&[]), 0, &[]);
    let page = std::fs::read_to_string(place.at("clicks/click.html")).expect("written");
    assert!(!page.contains("http") && place.at("clicks/click_frames/4.png").is_file());
    let start = page.find("id=\"data\">").expect("data") + 10;
    let end = page[start..].find("</script>").expect("its end") + start;
    let known: Value = serde_json::from_str(&page[start..end]).expect("JSON");
    let marks = known["marks"].as_array().expect("a list");
    assert_eq!(
        (known["frames"].as_array().map(Vec::len), known["points"].as_array().map(Vec::len)),
        (Some(5), Some(8))
    );
    let mut list = "name,image,px,py\n".to_string();
    for m in marks.iter().filter(|m| !m["at"].is_null()) {
        let name = |of: &str, key: &str| known[of][m[key].as_u64().expect("an index") as usize]["name"].clone();
        let row = format!("{},{},{},{}\n", name("points", "p"), name("frames", "f"), m["at"][0], m["at"][1]);
        list += &row;
        let far =
            (0..2).map(|k| (m["at"][k].as_f64().unwrap_or(0.0) - m["predicted"][k].as_f64().unwrap_or(1e9)).abs());
        assert!(m["predicted"].is_null() || far.fold(0.0, f64::max) < 150.0, "{m}");
    }
    assert!(marks.iter().filter(|m| !m["predicted"].is_null()).count() >= 8);
    // What the page saves says the same as the list did.
    let list = place.write("observations.csv", &list);
    let model = place.at("model");
    place.flight.write_model(&model);
    let adjusted = |more: &[&str]| {
        let gcps = place.at("gcps.txt");
        let words = [&["adjust", text(&model), "--gcps", text(&gcps), "--json"], more].concat();
        let output = run(None, &words);
        expect(&output, 0, &[]);
        json(&output)
    };
    assert_eq!(adjusted(&[])["cameras"], adjusted(&["--observations", text(&list)])["cameras"]);
    expect(&click(&[]), 2, &["click.html exists", "--overwrite"]);
    let cameras = place.write("cameras.json", &adjusted(&[]).to_string());
    expect(&click(&["--overwrite", "--cameras", text(&cameras)]), 0, &[]);
}

#[test]
fn micmac_is_run_where_it_is_installed() {
    let place = Place::new();
    place.five_frames();
    let toml = place.init();
    let (bin, out) = (place.at("mm3d-bin"), place.at("out"));
    std::fs::create_dir(&bin).expect("a folder");
    let solve = || run(Some(&bin), &["solve", text(&toml), "-o", text(&out), "--engine", "micmac", "--json"]);
    expect(&solve(), 2, &["`mm3d` is not there", "PATH"]);
    // A stand-in whose last command leaves the true cameras.
    let prepared = place.at("Ori-Compensated");
    std::fs::create_dir(&prepared).expect("a folder");
    for p in &place.flight.model.photographs {
        let (c, r) = (p.pose.centre, p.pose.rotation);
        // MicMac writes camera to world.
        let row = |i: usize| format!("<L{}>{} {} {}</L{}>", i + 1, r[(0, i)], r[(1, i)], r[(2, i)], i + 1);
        let xml = format!(
            "<?xml version=\"1.0\"?><ExportAPERO><OrientationConique><FileInterne>AutoCal.xml</FileInterne>\
             <RelativeNameFI>true</RelativeNameFI><Externe><Centre>{} {} {}</Centre><ParamRotation><CodageMatr>{}{}{}\
             </CodageMatr></ParamRotation></Externe></OrientationConique></ExportAPERO>",
            c.x,
            c.y,
            c.z,
            row(0),
            row(1),
            row(2)
        );
        std::fs::write(prepared.join(format!("Orientation-{}.xml", p.name)), xml).expect("written");
    }
    let camera = &place.flight.model.cameras[0];
    let (f, pp, size) = (camera.f_px(), camera.pp_px(), camera.size_px);
    let xml = format!(
        "<?xml version=\"1.0\"?><ExportAPERO><CalibrationInternConique><KnownConv>eConvApero_DistM2C</KnownConv><PP>{} {}</PP><F>{f}</F>\
         <SzIm>{} {}</SzIm><CalibDistortion><ModRad><CDist>{} {}</CDist></ModRad></CalibDistortion></CalibrationInternConique>\
         </ExportAPERO>",
        pp[0], pp[1], size[0], size[1], pp[0], pp[1]
    );
    std::fs::write(prepared.join("AutoCal.xml"), xml).expect("written");
    // Masks lie beside the frames: MicMac finds them where it runs.
    std::fs::write(place.at("frames/f2_Masq.tif"), format!("P5\n{SIDE} {SIDE}\n255\n{}", "\u{1}".repeat(SIDE * SIDE)))
        .expect("written");
    let script = format!(
        "#!/bin/sh\n[ -n \"$STAND_IN_FAILS\" ] && exit 3\ncase $1 in HomolFilterMasq) [ -f f2_Masq.tif ] && [ -f \
         f3_Masq.tif ] && touch masks;;\nCampari) [ -f masks ] && [ -f GCP-S3D.xml ] && [ -f f4.png ] && cp -r {} .;; esac\n",
        prepared.display()
    );
    std::fs::write(bin.join("mm3d"), script).expect("written");
    std::fs::set_permissions(bin.join("mm3d"), std::fs::Permissions::from_mode(0o755)).expect("executable");
    let output = solve();
    expect(&output, 0, &["micmac"]);
    let document = json(&output);
    assert_eq!(document["frames_registered"], 5);
    assert!(
        place.flight.worst_camera_m(&document) < 1.0 && document["notes"].to_string().contains("MicMac"),
        "{}",
        said(&output)
    );
    let words = ["flight", "solve", text(&toml), "-o", text(&out), "--engine", "micmac"];
    expect(&autoref(&words, Some(&bin), &[("STAND_IN_FAILS", "1")]), 2, &["mm3d ended with", "micmac.log"]);
}
