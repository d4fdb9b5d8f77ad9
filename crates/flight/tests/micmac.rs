//! MicMac's own pairs of ground and image, and its measured points.

#[path = "../../../tests/common/skipped.rs"]
mod skipped;
use std::path::{Path, PathBuf};

use autoref_flight::camera::Camera;
use autoref_flight::read::{self, micmac};
use autoref_flight::resect::{Focal, ResectOptions, Seen, resect};
use nalgebra::Vector3;

fn data(name: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let found = ["../../../shared/data", "../shared/data"].iter().map(|p| root.join(p).join(name)).find(|p| p.exists());
    if found.is_none() {
        skipped::skipped(format!("../shared/data/{name} is absent"));
    }
    found
}

fn worst_of(orientation: &Path, camera: &Path) -> (usize, f64) {
    let o = micmac::read_orientation(orientation).expect("an orientation");
    let camera = micmac::read_camera(camera).expect("a camera");
    let off = |(ground, image): &([f64; 3], [f64; 2])| {
        let p = camera.project(o.pose.to_camera(&Vector3::from(*ground)).into()).expect("in front");
        (p[0] - image[0]).hypot(p[1] - image[1])
    };
    (o.checks.len(), o.checks.iter().map(off).fold(0.0, f64::max))
}

#[test]
fn every_pair_of_verif_is_met() {
    let Some(root) = data("micmac") else { return };
    let pairs = [
        ("mmvii_ground/Orientation-IMGP4167.JPG.xml", "mmvii_ground/AutoCal_Foc-28000_Cam-PENTAX_K5.xml"),
        ("mmvii_ground/Orientation-IMGP4168.JPG.xml", "mmvii_ground/AutoCal_Foc-28000_Cam-PENTAX_K5.xml"),
        ("mmvii_ori/Orientation-Img0907.tif.xml", "mmvii_ori/AutoCal_Foc-60000_Cam-NIKON_D810.xml"),
        ("mmvii_ori/Orientation-Img0937.tif.xml", "mmvii_ori/AutoCal_Foc-60000_Cam-NIKON_D810.xml"),
        ("mmvii_ori/Orientation-Img0970.tif.xml", "mmvii_ori/AutoCal_Foc-60000_Cam-NIKON_D810.xml"),
        ("mmvii_ori/Orientation-_DSC8385.tif.xml", "mmvii_ori/AutoCal_Foc-60000_Cam-NIKON_D810.xml"),
        ("li3ds/Orientation-00.xml", "li3ds/Calib-00.xml"),
        ("li3ds/Orientation-1.xml", "li3ds/Calib-1.xml"),
    ];
    for (orientation, camera) in pairs {
        let (count, worst) = worst_of(&root.join(orientation), &root.join(camera));
        eprintln!("{orientation}: {count} pairs, worst {worst:.3e} px");
        assert_eq!(count, 10);
        assert!(worst < 1e-9, "{orientation}: {worst} px");
    }
}

#[test]
fn both_forms_of_one_camera_agree() {
    let Some(root) = data("micmac/mmvii_ground") else { return };
    let v1 = micmac::read_orientation(&root.join("Orientation-IMGP4167.JPG.xml")).expect("v1");
    let v2 = micmac::read_orientation(&root.join("mmvii_form/Ori-PerspCentral-IMGP4167.JPG.xml")).expect("MMVII");
    assert!((v1.pose.centre - v2.pose.centre).norm() < 1e-12 && (v1.pose.rotation - v2.pose.rotation).norm() < 1e-12);
    let a = micmac::read_camera(&root.join("AutoCal_Foc-28000_Cam-PENTAX_K5.xml")).expect("v1");
    let b =
        micmac::read_camera(&root.join("mmvii_form/Calib-PerspCentral-Foc-28000_Cam-PENTAX_K5.xml")).expect("MMVII");
    // MMVII fitted its own three radial terms to v1's four.
    for at in [[100.0, 100.0], [864.0, 576.0], [1700.0, 1100.0]] {
        let ray = a.ray(at).expect("inside");
        let p = b.project(ray).expect("in front");
        assert!((p[0] - at[0]).hypot(p[1] - at[1]) < 0.05, "{at:?} {p:?}");
    }
}

/// Kronebreen 2014 as published with PyTrx: point 4 lies some 150 px from where its ground point is seen, and nobody
/// said so.
#[test]
fn the_wrong_point_of_a_real_list_is_named() {
    let Some(list) = data("oblique_svalbard/KR1_2014.txt") else { return };
    let text = std::fs::read_to_string(list).expect("a list");
    let seen: Vec<Seen> = text
        .lines()
        .skip(1)
        .enumerate()
        .map(|(i, line)| {
            let v: Vec<f64> = line.split_whitespace().map(|v| v.parse().expect("a number")).collect();
            Seen {
                name: (i + 1).to_string(),
                xyz: Vector3::new(v[0], v[1], v[2]),
                sigma_m: Vector3::zeros(),
                pixel: [v[3], v[4]],
            }
        })
        .collect();
    assert_eq!(seen.len(), 10);
    let camera = Camera::pinhole("KR1", [5184.0, 3456.0], 6248.0, [2592.0, 1728.0]);
    for focal in [Focal::Known, Focal::Sought] {
        let found = resect(&camera, &seen, &ResectOptions { focal, ..ResectOptions::default() }).expect("a pose");
        eprintln!("{focal:?}: rms {:.1} px of the others, blunders {:?}", found.rms_px, found.blunders);
        assert_eq!(found.blunders, [3], "{focal:?}");
        assert!(found.rms_px < 30.0, "{}", found.rms_px);
    }
}

#[test]
fn resection_from_six_named_points() {
    let Some(root) = data("micmac/mmvii_ground") else { return };
    let ground = micmac::read_ground_points(&root.join("Ground-Pts3D.xml")).expect("points");
    let measured = micmac::read_image_points(&root.join("GroundMeasure.xml")).expect("measurements");
    let camera = micmac::read_camera(&root.join("AutoCal_Foc-28000_Cam-PENTAX_K5.xml")).expect("a camera");
    let seen: Vec<Seen> = measured
        .iter()
        .filter(|(image, _, _)| image == "IMGP4168.JPG")
        .filter_map(|(_, name, pixel)| {
            let g = ground.iter().find(|g| g.name == *name)?;
            Some(Seen { name: name.clone(), xyz: Vector3::from(g.xyz), sigma_m: Vector3::zeros(), pixel: *pixel })
        })
        .collect();
    assert_eq!(seen.len(), 6);
    let found = resect(&camera, &seen, &ResectOptions::default()).expect("a pose");
    eprintln!("{:?} rms {} blunders {:?}", found.pose.centre, found.rms_px, found.blunders);
    assert!((found.pose.centre - Vector3::new(5.1998, 0.7730, 2.0937)).norm() < 1e-3, "{:?}", found.pose.centre);
    assert!((found.rms_px - 0.50).abs() < 0.03, "{}", found.rms_px);
}

/// Distortion as `ModPhgrStd` has it, per millimetre.
const TERMS: [f64; 7] = [4e-5, 8e-9, -4e-11, -3e-6, 8e-6, 2e-4, -3e-4];

/// A calibration on a plane in millimetres: 50 mm, principal point (0.2, −0.1).
fn calibration(more: &str) -> String {
    let [k1, k2, k3, p1, p2, b1, b2] = TERMS;
    format!(
        "<ExportAPERO><CalibrationInternConique><KnownConv>eConvApero_DistM2C</KnownConv>{more}<PP>0.2 -0.1</PP><F>50</F>\
         <CalibDistortion><ModPhgrStd><RadialePart><CDist>0.3 -0.2</CDist><CoeffDist>{k1}</CoeffDist>\
         <CoeffDist>{k2}</CoeffDist><CoeffDist>{k3}</CoeffDist></RadialePart><P1>{p1}</P1><P2>{p2}</P2><b1>{b1}</b1>\
         <b2>{b2}</b2></ModPhgrStd></CalibDistortion></CalibrationInternConique></ExportAPERO>"
    )
}

/// Where that calibration has a direction on its plane, millimetres.
fn on_plane([x, y]: [f64; 2]) -> [f64; 2] {
    let [k1, k2, k3, p1, p2, b1, b2] = TERMS;
    let (u, v) = (0.2 + 50.0 * x - 0.3, -0.1 + 50.0 * y + 0.2);
    let r2 = u * u + v * v;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let du = p1 * (r2 + 2.0 * u * u) + p2 * 2.0 * u * v + b1 * u + b2 * v;
    let dv = p1 * 2.0 * u * v + p2 * (r2 + 2.0 * v * v);
    [0.3 + u * radial + du, -0.2 + v * radial + dv]
}

fn affinity(name: &str, [i00, v10, v01]: [[f64; 2]; 3]) -> String {
    let pair = |[x, y]: [f64; 2]| format!("{x} {y}");
    format!("<{name}><I00>{}</I00><V10>{}</V10><V01>{}</V01></{name}>", pair(i00), pair(v10), pair(v01))
}

fn global(columns: [[f64; 2]; 3], to_plane: &str) -> String {
    format!("<SzIm>6000 4000</SzIm><OrIntGlob>{}<C2M>{to_plane}</C2M></OrIntGlob>", affinity("Affinite", columns))
}

/// An affinity to the plane of a calibration, with its y upwards as on film, and one to pixels with two scales.
#[test]
fn a_calibration_in_millimetres_becomes_pixels() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("AutoCal.xml");
    let up = global([[-18.0, 12.0], [0.006, 0.0], [0.0, -0.006]], "true");
    let two = global([[3000.0, 2000.0], [160.0, 0.0], [0.0, 161.0]], "false");
    for (more, up) in [(up, true), (two, false)] {
        std::fs::write(&file, calibration(&more)).expect("written");
        let camera = micmac::read_camera_in_pixels(&file).expect("a camera");
        assert_eq!(camera.size_px, [6000.0, 4000.0]);
        for [x, y] in [[0.0, 0.0], [0.2, -0.1], [-0.25, 0.2]] {
            let at = camera.project([x, y, 1.0]).expect("in front");
            let [u, v] = on_plane([x, if up { -y } else { y }]);
            let wanted =
                if up { [(u + 18.0) / 0.006, (v - 12.0) / -0.006] } else { [3000.0 + 160.0 * u, 2000.0 + 161.0 * v] };
            assert!((at[0] - wanted[0]).hypot(at[1] - wanted[1]) < 1e-9, "{at:?} {wanted:?}");
        }
    }
    let refused = |more: &str, word: &str| {
        std::fs::write(&file, calibration(more)).expect("written");
        let said = micmac::read_camera_in_pixels(&file).expect_err("refused").to_string();
        assert!(said.contains("AutoCal.xml") && said.contains(word), "{said}");
    };
    refused(&global([[0.0; 2], [0.006, 0.012], [0.003, 0.006]], "true"), "two axes are one");
    refused("<SzIm>36 24</SzIm><ScannedAnalogik>true</ScannedAnalogik>", "<ScannedAnalogik>");
}

/// Scans of one film camera, each with its own scale.
#[test]
fn an_orientation_says_which_pixels_its_millimetres_are() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("written");
    write("AutoCal.xml", &calibration("<SzIm>36 24</SzIm><ScannedAnalogik>true</ScannedAnalogik>"));
    let orientation = |columns: [[f64; 2]; 3], rotation: &str| {
        format!(
            "<ExportAPERO><OrientationConique>{}<TypeProj>eProjStenope</TypeProj><FileInterne>Ori-A/AutoCal.xml\
             </FileInterne><Externe><Centre>1 2 3</Centre><ParamRotation>{rotation}</ParamRotation></Externe>\
             </OrientationConique></ExportAPERO>",
            affinity("OrIntImaM2C", columns)
        )
    };
    let level = "<CodageMatr><L1>1 0 0</L1><L2>0 1 0</L2><L3>0 0 1</L3></CodageMatr>";
    let scale = |s: f64| [[5.0, -7.0], [s, 0.0], [0.0, s]];
    for (name, s) in [("a", 40.0), ("b", 40.0), ("c", 80.0)] {
        write(&format!("Orientation-{name}.tif.xml"), &orientation(scale(s), level));
    }
    let model = read::reconstruction(folder.path()).expect("a block");
    assert_eq!(model.cameras.len(), 2, "a and b share theirs");
    for (photograph, s) in model.photographs.iter().zip([40.0, 40.0, 80.0]) {
        let camera = &model.cameras[photograph.camera];
        assert_eq!(camera.size_px, [36.0 * s + 5.0, 24.0 * s - 7.0]);
        let (at, [u, v]) = (camera.project([0.1, -0.2, 1.0]).expect("in front"), on_plane([0.1, -0.2]));
        assert!((at[0] - 5.0 - s * u).hypot(at[1] + 7.0 - s * v) < 1e-9, "{at:?}");
        let named = folder.path().join(format!("Orientation-{}.xml", photograph.name));
        assert_eq!(micmac::read_camera_in_pixels(&named).expect("a camera"), *camera);
    }
    for (columns, rotation, word) in [
        ([[0.0, -9000.0], [40.0, 0.0], [0.0, 40.0]], level, "<OrIntImaM2C>: puts the frame outside"),
        ([[0.0; 2], [1.0, 0.0], [0.0, 1.0]], level, "<ScannedAnalogik>"),
        (scale(40.0), "<CodageAngulaire>1 2</CodageAngulaire>", "3 numbers are expected"),
    ] {
        write("Orientation-d.tif.xml", &orientation(columns, rotation));
        let said = read::reconstruction(folder.path()).expect_err("refused").to_string();
        assert!(said.contains("Orientation-d.tif.xml") && said.contains(word), "{said}");
    }
    // What is not called an orientation is not what lies beside it.
    let said = read::reconstruction(&folder.path().join("AutoCal.xml")).expect_err("no block").to_string();
    assert!(said.contains("AutoCal.xml") && said.contains("give their folder"), "{said}");
}

#[test]
fn variances_go_by_either_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("MesGCP.xml");
    for name in ["Sigma2", "__Opt__Sigma2"] {
        let text = format!(
            "<Root><SetGCP><Measures><el><Name>\"A\"</Name><Pt>1 2 3</Pt><{name}>0.25 0 0 1 0 4</{name}></el>\
             </Measures></SetGCP></Root>"
        );
        std::fs::write(&file, text).expect("written");
        assert_eq!(micmac::read_ground_points(&file).expect("points")[0].sigma, Some([0.5, 1.0, 2.0]), "{name}");
    }
}
