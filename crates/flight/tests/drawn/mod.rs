//! Blocks that are drawn.

use autoref_flight::adjust::{GroundPoint, Role};
use autoref_flight::camera::{Camera, Parameter};
use autoref_flight::pose::{Pose, Similarity, YawPitchRoll};
use autoref_flight::read::{Photograph, Reconstruction, TiePoint};
use autoref_raster::random::SplitMix64;
use nalgebra::{Rotation3, Vector3};

/// Numbers drawn one after another from a seed.
pub struct Draw(SplitMix64);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Draw(SplitMix64(seed))
    }
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.unit()
    }
    pub fn normal(&mut self) -> f64 {
        let (u, v) = (self.uniform(1e-12, 1.0), self.uniform(0.0, 1.0));
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
    pub fn vector(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal()) * sigma
    }
}

/// An oblique line of `n` photographs with `ties` points and `gcps`, all true.
pub fn block(draw: &mut Draw, n: usize, ties: usize, gcps: usize) -> (Reconstruction, Vec<GroundPoint>) {
    let camera = Camera::pinhole("c", [1800.0, 1800.0], 2107.0, [900.0, 900.0]).with(Parameter::K1, -0.002);
    let mut model = Reconstruction { cameras: vec![camera.clone()], ..Reconstruction::default() };
    for i in 0..n {
        let centre = Vector3::new(1800.0 * i as f64, draw.uniform(-100.0, 100.0), 3000.0 + draw.uniform(-40.0, 40.0));
        let angles = YawPitchRoll {
            yaw_deg: draw.uniform(-1.5, 1.5),
            pitch_deg: -20.0 + draw.uniform(-0.7, 0.7),
            roll_deg: draw.uniform(-1.0, 1.0),
        };
        model.photographs.push(Photograph { name: format!("f{i}"), camera: 0, pose: Pose::looking(centre, angles) });
    }
    let reach = camera.reach();
    let see = |model: &Reconstruction, x: &Vector3<f64>| -> Vec<(usize, [f64; 2])> {
        let all = model.photographs.iter().enumerate();
        // What lies far to the side, the polynomial of the lens would bring back into the image.
        all.filter_map(|(i, p)| Some((i, camera.shows(p.pose.to_camera(x).into(), &reach)?))).collect()
    };
    let mut points = Vec::new();
    while model.ties.len() < ties || points.len() < gcps {
        let x = Vector3::new(
            draw.uniform(-3000.0, 1800.0 * n as f64 + 3000.0),
            draw.uniform(3500.0, 12_000.0),
            draw.uniform(0.0, 700.0),
        );
        let seen = see(&model, &x);
        if seen.len() < 3 {
            continue;
        }
        if points.len() < gcps {
            let sigma = Vector3::repeat(1.0);
            points.push(GroundPoint { name: format!("G{}", points.len()), xyz: x, sigma, role: Role::Control, seen });
        } else {
            model.ties.push(TiePoint { xyz: x, seen });
        }
    }
    (model, points)
}

pub fn noisy(draw: &mut Draw, model: &mut Reconstruction, points: &mut [GroundPoint], px: f64, ground: f64) {
    for t in &mut model.ties {
        for (_, at) in &mut t.seen {
            *at = [at[0] + px * draw.normal(), at[1] + px * draw.normal()];
        }
    }
    for p in points {
        p.xyz += draw.vector(ground);
        p.sigma = Vector3::repeat(ground);
        for (_, at) in &mut p.seen {
            *at = [at[0] + px * draw.normal(), at[1] + px * draw.normal()];
        }
    }
}

/// The model in a datum of its own, as a mapper leaves it.
pub fn shaken(draw: &mut Draw, model: &Reconstruction) -> Reconstruction {
    let by = Similarity { scale: 3e-4, rotation: *Rotation3::new(draw.vector(1.0)).matrix(), shift: draw.vector(1.0) };
    let mut out = model.clone();
    for p in &mut out.photographs {
        p.pose = p.pose.moved(&by);
    }
    for t in &mut out.ties {
        t.xyz = by.apply(&t.xyz);
    }
    out
}
