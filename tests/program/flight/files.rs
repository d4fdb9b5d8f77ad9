//! `flight init` writes what `flight solve` reads, `flight export` what MicMac reads.

use std::path::Path;
use std::process::Command;

use super::{Place, SIDE, autoref, expect, text, write_png};

#[test]
fn init_writes_what_solve_reads_and_refuses_what_is_not_there() {
    let place = Place::new();
    place.five_frames();
    let toml = place.init();
    let written: toml::Value = toml::from_str(&std::fs::read_to_string(&toml).expect("there")).expect("TOML");
    assert_eq!(written["camera"]["f_px"].as_float(), Some(500.0));
    assert_eq!(
        (written["gcps"]["sigma_ground_m"].as_float(), written["gcps"]["sigma_image_px"].as_float()),
        (Some(25.0), Some(5.0))
    );
    let (frames, table, gcps) = (place.at("frames"), place.at("table.csv"), place.at("gcps.txt"));
    let init = |folder: &Path, table: &Path, gcps: &Path, name: &str| {
        let out = place.at(name);
        autoref(
            &["flight", "init", text(folder), "--cameras", text(table), "--gcps", text(gcps), "-o", text(&out)],
            None,
            &[],
        )
    };
    expect(&init(&frames, &table, &gcps, "FLIGHT.toml"), 2, &["FLIGHT.toml exists", "--overwrite"]);
    expect(&init(&place.at("nowhere"), &table, &gcps, "a.toml"), 2, &["nowhere"]);
    expect(&init(&frames, &table, &place.at("no.txt"), "a.toml"), 2, &["no.txt"]);
    let others = place.write("others.csv", "name,x,y,z\nQ1,1,2,3\n");
    expect(&init(&frames, &others, &gcps, "a.toml"), 2, &["others.csv", "none of its 1 names"]);
    let broken = place.write("broken.csv", "name,x,y,z\nf0,1,two,3\n");
    expect(&init(&frames, &broken, &gcps, "a.toml"), 2, &["broken.csv", "row 2", "`two`"]);
    // Northings of a table that stand first are told where the CRS shows them.
    let north_first = place.write("north.csv", "name,x,y,z\nf0,7000000,400000,9\nf1,7000100,400000,9\n");
    let utm = place.at("utm.toml");
    let words = ["flight", "init", text(&frames), "--cameras", text(&north_first), "-o", text(&utm)];
    expect(&autoref(&[&words[..], &["--crs", "EPSG:25833"]].concat(), None, &[]), 0, &["only with the northing first"]);
    std::fs::create_dir(place.at("empty")).expect("a folder");
    expect(&init(&place.at("empty"), &table, &gcps, "a.toml"), 2, &["empty", "no frames"]);
    for option in ["--check", "--observations"] {
        let out = place.at("a.toml");
        let some = ["flight", "init", text(&frames), "--cameras", text(&table), option, "G0", "-o", text(&out)];
        expect(&autoref(&some, None, &[]), 2, &[option, "--gcps"]);
    }
    assert!(!place.at("a.toml").exists());
}

#[test]
fn export_writes_what_micmac_reads() {
    let place = Place::new();
    place.five_frames();
    let toml = place.init();
    let folder = place.at("micmac");
    let export = |more: &[&str]| {
        let words = [&["flight", "export", text(&toml), "-o", text(&folder)], more].concat();
        autoref(&words, None, &[])
    };
    expect(&export(&["--pixel-mm", "0.02"]), 0, &[]);
    let read = |name: &str| std::fs::read_to_string(place.at("micmac").join(name)).expect("written");
    assert!(read("MicMac-LocalChantierDescripteur.xml").contains("<CalcName> 10 </CalcName>"), "500 px of 0.02 mm");
    assert_eq!(read("NameCpleVisib.xml").matches("<Cple>").count(), 4 + 3 + 2);
    assert!(read("commands.sh").contains("mm3d GCPBascule '(f0\\.png|"), "{}", read("commands.sh"));
    let checked = Command::new("sh").arg("-n").arg(place.at("micmac").join("commands.sh")).status().expect("a shell");
    assert!(checked.success());
    // The list that it came from and the two that it became say the same.
    let ground = autoref_flight::read::micmac::read_ground_points(&place.at("micmac").join("GCP-S3D.xml"));
    assert_eq!(ground.expect("points").len(), place.flight.gcps.len());
    let adjusted = |list: &str| {
        let list = place.at("micmac").join(list);
        place.flight.write_model(&place.at("prepared"));
        let model = place.at("prepared");
        autoref(&["flight", "adjust", text(&model), "--gcps", text(&list), "--json"], None, &[])
    };
    expect(&adjusted("GCP-S3D.xml"), 0, &[]);
    expect(&export(&[]), 2, &["MicMac-LocalChantierDescripteur.xml", "--overwrite"]);
    expect(&export(&["--overwrite"]), 0, &[]);
    expect(&export(&["--overwrite", "--pixel-mm", "0"]), 2, &["--pixel-mm"]);
}

/// The values of a mask of the frames' size.
fn values(path: &Path) -> Vec<u8> {
    let mask = gdal::Dataset::open(path).expect("a mask");
    assert_eq!(mask.raster_size(), (SIDE, SIDE));
    mask.rasterband(1).and_then(|band| band.read_band_as::<u8>()).expect("values").data().to_vec()
}

#[test]
fn masks_and_principal_point_reach_micmac() {
    let place = Place::new();
    place.five_frames();
    let project = std::fs::read_to_string(place.init()).expect("there");
    let project = project.replace("f_px = 500.0", "f_px = 500.0\npp_px = [252.0, 228.0]");
    let export = |name: &str, masks: &str| {
        let toml = place.write(&format!("{name}.toml"), &format!("{project}\n[masks]\n{masks}"));
        autoref(&["flight", "export", text(&toml), "-o", text(&place.at(name)), "--overwrite"], None, &[])
    };
    let commands = |name: &str| std::fs::read_to_string(place.at(name).join("commands.sh")).expect("written");
    let masked: Vec<usize> = vec![0, SIDE * SIDE / 2, SIDE * SIDE - 1];
    let seen = |name: &str, frame: &str| {
        let all = values(&place.at(name).join(format!("{frame}_Masq.tif")));
        assert!(place.at(name).join(format!("{frame}_Masq.xml")).is_file());
        masked.iter().map(|i| all[*i]).collect::<Vec<u8>>()
    };
    // Without masks none are written, and the principal point is where the project has it.
    expect(&export("none", ""), 0, &[]);
    assert!(commands("none").contains("HOMOL=''") && commands("none").contains("'PPRel=[0.525,0.475]'"));
    assert!(!place.at("none").join("f0_Masq.tif").exists());
    // The mask of all frames and that of one of them, beside it: 255 is as good as 1.
    let half: Vec<u8> = (0..SIDE * SIDE).map(|i| if i < SIDE * SIDE / 2 { 0 } else { 255 }).collect();
    let last: Vec<u8> = (0..SIDE * SIDE).map(|i| u8::from(i + 1 < SIDE * SIDE)).collect();
    write_png(&place.at("border.png"), SIDE, &half);
    write_png(&place.at("frames/f1_Masq.tif"), SIDE, &last);
    expect(&export("global", "global = \"border.png\""), 0, &[]);
    assert!(commands("global").contains("mm3d HomolFilterMasq"), "{}", commands("global"));
    assert_eq!((seen("global", "f0"), seen("global", "f1")), (vec![0, 1, 1], vec![0, 1, 0]));
    // Of one frame alone: the others have one too, without which MicMac stops, that keeps all.
    expect(&export("own", ""), 0, &[]);
    assert!(commands("own").contains("mm3d HomolFilterMasq"));
    assert_eq!((seen("own", "f0"), seen("own", "f1")), (vec![1, 1, 1], vec![1, 1, 0]));
    // Into the frames' folder: what lies there already is left as it is, and what is joined would count as theirs.
    let beside = |toml: &str| {
        let toml = place.at(toml);
        autoref(&["flight", "export", text(&toml), "-o", text(&place.at("frames")), "--overwrite"], None, &[])
    };
    let before = std::fs::read(place.at("frames/f1_Masq.tif")).expect("there");
    expect(&beside("global.toml"), 2, &["frames: what is joined with", "border.png", "name another folder"]);
    expect(&beside("own.toml"), 0, &[]);
    assert_eq!(std::fs::read(place.at("frames/f1_Masq.tif")).expect("there"), before);
    assert!(place.at("frames/f0_Masq.tif").is_file() && !place.at("frames/f1_Masq.xml").exists());
}
