//! MicMac's own pairs of ground and image, and its measured points.

#[path = "../../../tests/common/skipped.rs"]
mod skipped;
use std::path::{Path, PathBuf};

use autoref_flight::camera::Camera;
use autoref_flight::read::micmac;
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
