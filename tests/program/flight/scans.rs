//! A block of MicMac's with Ebner's distortion, whose scans lie turned against the film and whose rotations are angles:
//! adjusted, read back and mapped.

use std::path::Path;

use autoref_flight::camera::{Camera, SizeOf};
use autoref_flight::read::{self, micmac};
use serde_json::Value;

use super::{F_PX, Place, SIDE, autoref, brightness, expect, ground, json, text};
use crate::orthorectify::{correlation, ortho, write_dem};

/// The block's orientations; its camera in pixels.
fn write_block(place: &Place, folder: &Path) -> Camera {
    std::fs::create_dir_all(folder).expect("a folder");
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("written");
    let half = SIDE as f64 / 2.0;
    let parameters = [2e-3, -1e-3, 2e-6, -3e-6, 4e-6, 1e-6, 1e-8, -1e-8, 2e-8, 1e-8, 1e-11, -1e-11];
    let parameters: String = parameters.iter().map(|p| format!("<Params>{p}</Params>")).collect();
    let calibration = format!(
        "<ExportAPERO><CalibrationInternConique><KnownConv>eConvApero_DistM2C</KnownConv><PP>{half} {half}</PP><F>{F_PX}</F>\
         <SzIm>{SIDE} {SIDE}</SzIm><CalibDistortion><ModUnif><TypeModele>eModeleEbner</TypeModele>{parameters}\
         <Etats>150</Etats></ModUnif></CalibDistortion></CalibrationInternConique></ExportAPERO>"
    );
    write("AutoCal.xml", &calibration);
    for p in &place.flight.model.photographs {
        let ([omega, phi, kappa], c) = (p.pose.omega_phi_kappa(), p.pose.centre);
        // A quarter of a turn: the film's x runs down in the scan.
        let orientation = format!(
            "<ExportAPERO><OrientationConique><OrIntImaM2C><I00>{SIDE} 0</I00><V10>0 1</V10><V01>-1 0</V01></OrIntImaM2C>\
             <TypeProj>eProjStenope</TypeProj><FileInterne>AutoCal.xml</FileInterne><Externe><Centre>{} {} {}</Centre>\
             <ParamRotation><CodageAngulaire>{omega} {phi} {kappa}</CodageAngulaire></ParamRotation></Externe>\
             <ConvOri><KnownConv>eConvAngPhotoMDegre</KnownConv></ConvOri></OrientationConique></ExportAPERO>",
            c.x, c.y, c.z
        );
        write(&format!("Orientation-{}.xml", p.name), &orientation);
    }
    micmac::read_camera_in_pixels(&folder.join("Orientation-f0.png.xml")).expect("a camera")
}

#[test]
fn turned_scans_with_a_polynomial_distortion_are_adjusted_and_mapped() {
    let mut place = Place::new();
    let (block, cameras, dem, out) =
        (place.at("block"), place.at("cameras.json"), place.at("dem.tif"), place.at("a.tif"));
    let camera = write_block(&place, &block);
    assert_eq!(camera.size_of, SizeOf::Film);
    place.flight.model.cameras[0] = camera.clone();
    let model = place.flight.model.clone();
    for (_, xyz, seen) in &mut place.flight.gcps {
        for (frame, at) in seen {
            *at = camera.project(model.photographs[*frame].pose.to_camera(xyz).into()).expect("in front");
        }
    }
    let list = place.write("turned.txt", &place.flight.gcp_list());
    let adjust = ["flight", "adjust", text(&block), "--gcps", text(&list), "--sigma-ground", "0.01", "--free", "none"];
    let output = autoref(&[&adjust[..], &["--crs", "local", "-o", text(&cameras), "--json"]].concat(), None, &[]);
    expect(&output, 0, &[]);
    let document = json(&output);
    assert!(place.flight.worst_camera_m(&document) < 0.02, "{}", place.flight.worst_camera_m(&document));
    let interior = &document["cameras"][0];
    assert_eq!(
        (&interior["size_of"], interior["distortion"]["after"].as_array().map(Vec::len)),
        (&"film".into(), Some(1))
    );
    let back = read::reconstruction(&cameras).expect("a block");
    let wanted = Camera { name: back.cameras[0].name.clone(), ..camera };
    assert_eq!((back.cameras.len(), &back.cameras[0]), (1, &wanted), "what was written is what is read");

    place.flight.render(&place.at("frames"), &[0, 1, 2, 3, 4]);
    write_dem(&dem, (400, 250), [800.0, 2250.0], 2.0, ground);
    let frame = place.at("frames").join("f2.png");
    let map = |cameras: &Path, more: &[&str]| {
        let some = ["flight", "orthorectify", text(&frame), "--dem", text(&dem), "--cameras", text(cameras)];
        autoref(&[&some[..], &["-o", text(&out), "--json", "--overwrite"], more].concat(), None, &[])
    };
    for (source, more) in [(&cameras, &[][..]), (&block, &["--crs", "local"])] {
        let output = map(source, more);
        expect(&output, 0, &[]);
        let gsd = json(&output)["gsd"].as_f64().expect("a number");
        assert!((gsd - 0.8).abs() < 0.1, "{gsd}");
        let (grey, alpha, size, t) = ortho(&out);
        let truth = |k: usize| {
            let (i, j) = ((k % size.0) as f64 + 0.5, (k / size.0) as f64 + 0.5);
            f64::from(brightness(t[0] + t[1] * i, t[3] + t[5] * j))
        };
        let seen: Vec<usize> = (0..grey.len()).filter(|k| alpha[*k] == 255).collect();
        let pairs: Vec<(f64, f64)> = seen.iter().map(|k| (f64::from(grey[*k]), truth(*k))).collect();
        let found = correlation(&pairs);
        assert!(found > 0.97 && pairs.len() > SIDE * SIDE * 9 / 10, "{found:.4} of {} pixels", pairs.len());
    }
}

/// What a document cannot mean is refused with the camera's name, not passed over.
#[test]
fn a_map_of_the_plane_that_is_none_is_refused() {
    let place = Place::new();
    let camera = |before: Value| {
        let document = serde_json::json!({"crs": "local", "cameras": [{
            "name": "f0.png", "C": [0, 0, 400], "R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "f_px": 500,
            "pp_px": [240, 240], "size_px": [480, 480], "distortion": {"before": before},
        }]});
        place.write("other.json", &document.to_string())
    };
    let adjusted = |file: &Path| {
        let gcps = place.at("gcps.txt");
        autoref(&["flight", "adjust", text(file), "--gcps", text(&gcps), "--free", "none"], None, &[])
    };
    let bent = |scale: f64| serde_json::json!([{"polynomial": {"centre_px": [0, 0], "scale_px": scale, "terms": []}}]);
    expect(&adjusted(&camera(bent(0.0))), 2, &["other.json: camera `f0.png`: `before`: a scale is not positive"]);
    expect(&adjusted(&camera(serde_json::json!([{"bend": 1}]))), 2, &["`before`: unknown variant `bend`"]);
}
