//! The start from a rough table on drawn oblique lines whose neighbours alone share points, among wrong ties.

use autoref_flight::adjust::{AdjustOptions, Adjustment, GroundPoint, Role, RoughPose, adjust};
use autoref_flight::camera::Camera;
use autoref_flight::pose::{Pose, YawPitchRoll};
use autoref_flight::read::Reconstruction;
use autoref_flight::start::{Track, from_rough};
use autoref_raster::random::SplitMix64;
use nalgebra::{Rotation3, Vector3};

const SIDE_PX: f64 = 1800.0;

struct Line {
    camera: Camera,
    names: Vec<String>,
    truth: Vec<Pose>,
    rough: Vec<RoughPose>,
    tracks: Vec<Track>,
    ground: Vec<GroundPoint>,
}

impl Line {
    fn start(&self) -> Vec<Pose> {
        self.rough.iter().map(|r| r.pose).collect()
    }

    fn placed(&self) -> Reconstruction {
        from_rough(&self.names, &self.camera, &self.start(), &self.rough, &self.tracks, &self.ground).expect("a block")
    }

    /// What the adjustment makes of a block with the table's poses as observations.
    fn adjusted(&self, placed: &Reconstruction) -> Adjustment {
        let options = AdjustOptions {
            sigma_image_px: 0.5,
            interior: Vec::new(),
            rough: self.rough.iter().copied().map(Some).collect(),
            ..AdjustOptions::default()
        };
        adjust(placed, &self.ground, &options).expect("an adjustment")
    }
}

/// Five frames 3,600 m apart, 20° below the horizon; points in two frames each, of which `wrong` in a hundred are false
/// by up to 200 px.
fn line(seed: u64, wrong: f64) -> Line {
    let mut draw = SplitMix64(seed);
    let camera = Camera::pinhole("c", [SIDE_PX; 2], 2107.0, [900.0, 900.0]);
    let vector = |draw: &mut SplitMix64, s: f64| Vector3::new(draw.normal(), draw.normal(), draw.normal()) * s;
    let truth: Vec<Pose> = (0..5)
        .map(|i| {
            let angles = YawPitchRoll { yaw_deg: draw.normal(), pitch_deg: -20.0, roll_deg: draw.normal() };
            Pose::looking(Vector3::new(3600.0 * f64::from(i), 0.0, 3000.0) + vector(&mut draw, 30.0), angles)
        })
        .collect();
    let rough = truth
        .iter()
        .map(|p| {
            let turned = Rotation3::new(vector(&mut draw, 1f64.to_radians()));
            let pose = Pose { rotation: turned.matrix() * p.rotation, centre: p.centre + vector(&mut draw, 200.0) };
            RoughPose { pose, sigma_m: Vector3::repeat(200.0), sigma_rad: 2f64.to_radians() }
        })
        .collect();
    let see = |i: usize, x: &Vector3<f64>| camera.project(truth[i].to_camera(x).into()).filter(|p| camera.contains(*p));
    let (mut tracks, mut ground): (Vec<Track>, Vec<GroundPoint>) = (Vec::new(), Vec::new());
    while tracks.len() < 800 {
        let a = tracks.len() % 4;
        let x = Vector3::new(-4000.0 + 22_000.0 * draw.unit(), 4500.0 + 8000.0 * draw.unit(), 600.0 * draw.unit());
        let (Some(p), Some(q)) = (see(a, &x), see(a + 1, &x)) else { continue };
        let noise = |draw: &mut SplitMix64, at: [f64; 2]| at.map(|v| v + 0.5 * draw.normal());
        if ground.len() < 12 && tracks.len() / 61 >= ground.len() {
            let seen = vec![(a, noise(&mut draw, p)), (a + 1, noise(&mut draw, q))];
            let (sigma, xyz) = (Vector3::repeat(10.0), x + vector(&mut draw, 10.0));
            ground.push(GroundPoint { name: format!("G{}", ground.len()), xyz, sigma, role: Role::Control, seen });
            continue;
        }
        let mut other = noise(&mut draw, q);
        if draw.unit() < wrong {
            other = other.map(|v| v + 400.0 * (draw.unit() - 0.5));
        }
        tracks.push(vec![(a, noise(&mut draw, p)), (a + 1, other)]);
    }
    let names = (0..5).map(|i| format!("f{i}")).collect();
    Line { camera, names, truth, rough, tracks, ground }
}

#[test]
fn a_line_of_pairs_is_placed_by_its_table_among_wrong_ties() {
    for seed in 1..=6 {
        let line = line(seed, 0.3);
        let placed = line.placed();
        assert_eq!(placed.photographs.len(), 5);
        let right = line.tracks.len() * 7 / 10;
        assert!(placed.ties.len() > right * 8 / 10 && placed.ties.len() < right * 11 / 10, "{}", placed.ties.len());
        let found = line.adjusted(&placed);
        for (camera, truth) in found.photographs.iter().zip(&line.truth) {
            let covariance = camera.covariance.expect("the datum is fixed");
            let off = camera.pose.centre - truth.centre;
            for axis in 0..3 {
                let sigma = covariance[(3 + axis, 3 + axis)].sqrt();
                assert!(off[axis].abs() < 5.0 * sigma && sigma < 60.0, "seed {seed}: {off:?}, σ {sigma}");
            }
        }
    }
}

#[test]
fn frames_that_nothing_joins_are_left_out_and_named() {
    let mut line = line(9, 0.1);
    line.tracks.retain(|t| t.iter().all(|(i, _)| *i < 4));
    let placed = line.placed();
    assert_eq!(placed.photographs.len(), 4);
    assert!(placed.notes.iter().any(|n| n.starts_with("f4: too few ties")), "{:?}", placed.notes);
    let none = from_rough(&line.names, &line.camera, &line.start(), &line.rough, &[], &line.ground)
        .expect_err("nothing to place");
    assert!(none.to_string().contains("rough table"), "{none}");
}

#[test]
fn a_camera_far_from_where_the_table_has_it_is_told() {
    let mut line = line(3, 0.1);
    let placed = line.placed();
    let told = |line: &Line| {
        let found = line.adjusted(&placed);
        found.notes.into_iter().filter(|n| n.contains("from its rough position")).collect::<Vec<_>>()
    };
    assert!(told(&line).is_empty(), "{:?}", told(&line));
    line.rough[3].pose.centre.x += 2500.0;
    let notes = told(&line);
    assert!(notes.len() == 1 && notes[0].starts_with("f3: "), "{notes:?}");
}

/// A GCP clicked on the wrong thing does not draw the start with it.
#[test]
fn a_wrong_gcp_does_not_spoil_the_start() {
    let mut line = line(4, 0.3);
    line.ground[5].seen[0].1[0] += 150.0;
    let placed = line.placed();
    let found = line.adjusted(&placed);
    assert!(found.blunders.iter().any(|b| b.gcp == "G5"), "{:?}", found.blunders);
    for (camera, truth) in found.photographs.iter().zip(&line.truth) {
        assert!((camera.pose.centre - truth.centre).norm() < 150.0, "{:?}", camera.pose.centre - truth.centre);
    }
}
