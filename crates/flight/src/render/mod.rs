//! Frames of a landscape that is known: what a chain from film to cameras is tried on.
//!
//! Every pixel follows its ray through the lens to the first ground (bilinear between the cells of the elevation
//! model), and sees the cover there in the light of a sun; then haze, clouds, vignetting and grain. A row depends on
//! nothing but its frame: any threads give the same bytes. The world is flat and metric.

mod landscape;

pub use landscape::{Cover, Landscape};

use autoref_synth::rng::{Rng, hash2, value_noise};
use nalgebra::Vector3;

use crate::camera::Camera;
use crate::pose::{Pose, YawPitchRoll};

/// How a flight is flown.
#[derive(Clone, Debug)]
pub struct Plan {
    pub lines: usize,
    pub frames_per_line: usize,
    /// From frame to frame, and from line to line.
    pub base_m: f64,
    pub spacing_m: f64,
    /// Middle of the flight on the map, and height above the zero of the landscape.
    pub centre: [f64; 2],
    pub height_m: f64,
    /// Direction of flight, clockwise from north; lines are flown to and fro.
    pub heading_deg: f64,
    /// Elevation of the view: −90 straight down.
    pub pitch_deg: f64,
    /// Direction of the view against that of the first line, clockwise.
    pub look_deg: f64,
    /// Standard deviations of position and angles about the plan.
    pub jitter_m: f64,
    pub jitter_deg: f64,
}

/// What the air, the film and the light do.
#[derive(Clone, Debug)]
pub struct Effects {
    /// Sun: azimuth from north, elevation.
    pub sun_deg: [f64; 2],
    /// Distance over which haze takes 1 − 1/e of the light; none for clear air.
    pub haze_m: Option<f64>,
    /// Share of the sky under clouds of a layer, 0..=1, and its height.
    pub clouds: f64,
    pub cloud_height_m: f64,
    /// The sea mirrors the sun.
    pub glint: bool,
    /// Share of light that is lost in the corners.
    pub vignetting: f64,
    /// Standard deviation of a pixel, of 255.
    pub grain: f64,
    /// Rays across a pixel, each way.
    pub samples: usize,
}

/// A frame to render.
#[derive(Clone, Debug)]
pub struct Exposure {
    pub name: String,
    pub pose: Pose,
    pub seed: u64,
}

impl Plan {
    /// The exposures, line by line.
    pub fn exposures(&self, seed: u64) -> Vec<Exposure> {
        let mut rng = Rng::new(seed, 0xf1, 0);
        let (sin, cos) = self.heading_deg.to_radians().sin_cos();
        let mut out = Vec::new();
        for line in 0..self.lines {
            for k in 0..self.frames_per_line {
                let middle = |i: usize, n: usize| i as f64 - (n as f64 - 1.0) / 2.0;
                let turn = if line % 2 == 0 { 1.0 } else { -1.0 };
                let along = turn * self.base_m * middle(k, self.frames_per_line);
                let across = self.spacing_m * middle(line, self.lines);
                let mut shake = |sigma: f64| sigma * rng.normal();
                let centre = Vector3::new(
                    self.centre[0] + along * sin + across * cos + shake(self.jitter_m),
                    self.centre[1] + along * cos - across * sin + shake(self.jitter_m),
                    self.height_m + shake(self.jitter_m),
                );
                let angles = YawPitchRoll {
                    yaw_deg: self.heading_deg + self.look_deg + shake(self.jitter_deg),
                    pitch_deg: self.pitch_deg + shake(self.jitter_deg),
                    roll_deg: shake(self.jitter_deg),
                };
                let index = out.len() as u64;
                out.push(Exposure {
                    name: format!("L{:02}_{:04}", line + 1, k + 1),
                    pose: Pose::looking(centre, angles),
                    seed: seed ^ hash2(index, 0xf7a3, 7),
                });
            }
        }
        out
    }
}

/// A frame being rendered.
pub struct FrameRenderer<'a> {
    pub landscape: &'a Landscape,
    pub camera: &'a Camera,
    pub exposure: &'a Exposure,
    pub effects: &'a Effects,
    /// 1 (grey) or 3.
    pub bands: usize,
}

/// Tone of the sky at the horizon and overhead.
const HORIZON: [f64; 3] = [0.80, 0.83, 0.86];
const ZENITH: [f64; 3] = [0.42, 0.55, 0.74];
/// Share of the light that comes from the sky.
const AMBIENT: f64 = 0.38;

impl FrameRenderer<'_> {
    /// Rows `from..to`, bands behind each other in a pixel.
    pub fn rows(&self, from: usize, to: usize) -> Vec<u8> {
        use rayon::prelude::*;
        let width = self.camera.size_px[0] as usize;
        let mut out = vec![0u8; width * self.bands * (to - from)];
        out.par_chunks_mut(width * self.bands).enumerate().for_each(|(k, line)| {
            for (x, pixel) in line.chunks_mut(self.bands).enumerate() {
                self.pixel(x, from + k, pixel);
            }
        });
        out
    }

    /// Where the ray through a place of the frame meets the ground.
    pub fn ground(&self, at: [f64; 2]) -> Option<[f64; 3]> {
        let (eye, direction) = self.ray(at)?;
        self.landscape.surface.meets(eye.into(), direction.into(), 0.0)
    }

    fn ray(&self, at: [f64; 2]) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let ray = Vector3::from(self.camera.ray(at)?);
        Some((self.exposure.pose.centre, self.exposure.pose.rotation.transpose() * ray))
    }

    fn pixel(&self, x: usize, y: usize, out: &mut [u8]) {
        let n = self.effects.samples.max(1);
        let mut sum = [0.0; 3];
        for k in 0..n * n {
            let offset = |i: usize| (i as f64 + 0.5) / n as f64;
            let colour = self.colour([x as f64 + offset(k % n), y as f64 + offset(k / n)]);
            (0..3).for_each(|c| sum[c] += colour[c] / (n * n) as f64);
        }
        let light = self.light([x as f64 + 0.5, y as f64 + 0.5]);
        if self.bands == 1 {
            let grey = 0.299 * sum[0] + 0.587 * sum[1] + 0.114 * sum[2];
            out[0] = self.developed(grey * light, x, y, 0);
        } else {
            for (band, value) in out.iter_mut().enumerate() {
                *value = self.developed(sum[band] * light, x, y, band);
            }
        }
    }

    /// Of the light, what the lens lets through at a place.
    fn light(&self, at: [f64; 2]) -> f64 {
        let size = self.camera.size_px;
        let (dx, dy) = ((at[0] - size[0] / 2.0) / (size[0] / 2.0), (at[1] - size[1] / 2.0) / (size[1] / 2.0));
        1.0 - self.effects.vignetting * ((dx * dx + dy * dy) / 2.0)
    }

    /// The stored value: exposure and grain. The sum of four hashed bytes is near enough to normal for film.
    fn developed(&self, value: f64, x: usize, y: usize, band: usize) -> u8 {
        let h = hash2(self.exposure.seed ^ (band as u64 + 1), x as i64, y as i64);
        let bytes = (0..4).map(|k| (h >> (8 * k) & 255) as f64).sum::<f64>();
        // Four uniform bytes: mean 510, variance 4·(256² − 1)/12.
        let normal = (bytes - 510.0) / (4.0 * 65_535.0 / 12.0f64).sqrt();
        (255.0 * value.clamp(0.0, 1.0) + self.effects.grain * normal).round().clamp(0.0, 255.0) as u8
    }

    fn colour(&self, at: [f64; 2]) -> [f64; 3] {
        let Some((eye, direction)) = self.ray(at) else { return [0.0; 3] };
        let ground = self.landscape.surface.meets(eye.into(), direction.into(), 0.0);
        let (mut colour, distance) = match ground {
            Some(place) => {
                let distance = (Vector3::from(place) - eye).norm();
                (self.shaded(place, &direction, distance), Some(distance))
            }
            None => (sky(&direction), None),
        };
        if let (Some(haze_m), Some(distance)) = (self.effects.haze_m, distance) {
            let clear = (-distance / haze_m).exp();
            (0..3).for_each(|c| colour[c] = HORIZON[c] + (colour[c] - HORIZON[c]) * clear);
        }
        let cover = self.cloud(&eye, &direction, distance);
        (0..3).for_each(|c| colour[c] += (0.93 - colour[c]) * cover);
        colour
    }

    fn sun(&self) -> Vector3<f64> {
        let [azimuth, elevation] = self.effects.sun_deg.map(f64::to_radians);
        Vector3::new(azimuth.sin() * elevation.cos(), azimuth.cos() * elevation.cos(), elevation.sin())
    }

    fn shaded(&self, place: [f64; 3], direction: &Vector3<f64>, distance: f64) -> [f64; 3] {
        let [e, n, h] = place;
        let sun = self.sun();
        if self.landscape.is_sea(h) {
            return self.sea(e, n, direction, &sun, distance);
        }
        let normal = Vector3::from(self.landscape.normal(e, n));
        let grazing = (-direction.dot(&normal)).clamp(0.03, 1.0);
        let width_m = distance / self.camera.f_px() / grazing.sqrt() / self.effects.samples.max(1) as f64;
        let light = AMBIENT + (1.0 - AMBIENT) * (normal.dot(&sun) / sun.z.max(0.2)).clamp(0.0, 1.4);
        self.landscape.colour(e, n, h, normal.z, width_m).map(|v| v * light)
    }

    /// Waves differ from frame to frame: nothing on the water can be matched.
    fn sea(&self, e: f64, n: f64, direction: &Vector3<f64>, sun: &Vector3<f64>, distance: f64) -> [f64; 3] {
        let wave = |length: f64, k: u64| {
            let fine = distance / self.camera.f_px() * 2.0 < length;
            let seed = self.exposure.seed ^ (k << 40);
            if fine { f64::from(value_noise(seed, (e / length) as f32, (n / length) as f32)) - 0.5 } else { 0.0 }
        };
        let swell = wave(60.0, 1) + 0.6 * wave(14.0, 2);
        let base = 0.16 + 0.05 * swell;
        let mirrored = Vector3::new(direction.x, direction.y, -direction.z);
        let glint =
            if self.effects.glint { mirrored.dot(sun).max(0.0).powi(40) * (0.9 + 0.8 * swell).max(0.0) } else { 0.0 };
        [0.85, 1.0, 1.15].map(|tint| (base * tint + glint).clamp(0.0, 1.0))
    }

    /// How much of the view a cloud takes.
    fn cloud(&self, eye: &Vector3<f64>, direction: &Vector3<f64>, distance: Option<f64>) -> f64 {
        let effects = self.effects;
        if effects.clouds <= 0.0 || direction.z.abs() < 1e-6 {
            return 0.0;
        }
        let along = (effects.cloud_height_m - eye.z) / direction.z;
        if along <= 0.0 || distance.is_some_and(|d| along > d) || along > 120_000.0 {
            return 0.0;
        }
        let at = eye + direction * along;
        // Clouds drift between frames.
        let noise = |wave: f64, k: u64| {
            f64::from(value_noise(self.landscape.seed ^ (k << 44), (at.x / wave) as f32, (at.y / wave) as f32))
        };
        let density = 0.6 * noise(2_600.0, 5) + 0.27 * noise(900.0, 6) + 0.13 * noise(260.0, 7);
        // Value noise of these weights lies between about 0.2 and 0.8.
        ((density - (0.8 - 0.6 * effects.clouds)) / 0.07).clamp(0.0, 1.0) * 0.97
    }
}

fn sky(direction: &Vector3<f64>) -> [f64; 3] {
    let up = direction.z.clamp(0.0, 1.0).sqrt();
    std::array::from_fn(|c| HORIZON[c] + (ZENITH[c] - HORIZON[c]) * up)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> Plan {
        Plan {
            lines: 2,
            frames_per_line: 3,
            base_m: 800.0,
            spacing_m: 1_500.0,
            centre: [500.0, -200.0],
            height_m: 2_400.0,
            heading_deg: 90.0,
            pitch_deg: -90.0,
            look_deg: 0.0,
            jitter_m: 0.0,
            jitter_deg: 0.0,
        }
    }

    fn effects() -> Effects {
        Effects {
            sun_deg: [160.0, 40.0],
            haze_m: None,
            clouds: 0.0,
            cloud_height_m: 1_500.0,
            glint: true,
            vignetting: 0.0,
            grain: 0.0,
            samples: 1,
        }
    }

    #[test]
    fn lines_are_flown_to_and_fro() {
        let exposures = plan().exposures(1);
        let east: Vec<f64> = exposures.iter().map(|x| x.pose.centre.x.round()).collect();
        assert_eq!(east, [-300.0, 500.0, 1_300.0, 1_300.0, 500.0, -300.0]);
        assert_eq!((exposures[0].pose.centre.y - exposures[3].pose.centre.y).abs().round(), 1_500.0);
        assert!(exposures[0].pose.rotation[(2, 2)] < -0.999_999, "straight down");
    }

    /// Ground that a pixel sees is projected back into that pixel, and two frames see one place in one colour.
    #[test]
    fn pixels_see_the_ground_that_projects_into_them() {
        let landscape = Landscape::drawn(5, [500.0, -200.0], 9_000.0, 25.0, 700.0);
        let camera =
            Camera::pinhole("c", [300.0, 240.0], 330.0, [151.0, 118.0]).with(crate::camera::Parameter::K1, -0.02);
        let (plan, effects) = (plan(), effects());
        let exposures = plan.exposures(1);
        let renderer =
            |exposure| FrameRenderer { landscape: &landscape, camera: &camera, exposure, effects: &effects, bands: 3 };
        let (one, other) = (renderer(&exposures[0]), renderer(&exposures[1]));
        let (mut seen, mut alike) = (0, 0);
        for k in 0..400usize {
            let at = [(k % 20) as f64 * 15.0 + 7.5, (k / 20) as f64 * 12.0 + 6.5];
            let Some(place) = one.ground(at) else { continue };
            let h = landscape.surface.height(place[0], place[1]).expect("ground");
            assert!((h - place[2]).abs() < 0.05, "{h} {place:?}");
            let back = camera.project(exposures[0].pose.to_camera(&Vector3::from(place)).into()).expect("in front");
            assert!((back[0] - at[0]).hypot(back[1] - at[1]) < 1e-3, "{back:?} {at:?}");
            let there = camera.project(exposures[1].pose.to_camera(&Vector3::from(place)).into());
            let Some(there) = there.filter(|p| camera.contains(*p)) else { continue };
            if landscape.is_sea(place[2]) {
                continue;
            }
            seen += 1;
            let (a, b) = (one.colour(at), other.colour(there));
            alike += usize::from((0..3).all(|c| (a[c] - b[c]).abs() < 0.06));
        }
        assert!(seen > 60 && alike * 10 > seen * 8, "{alike} of {seen}");
    }

    #[test]
    fn rows_do_not_depend_on_how_they_are_cut() {
        let landscape = Landscape::drawn(5, [0.0, 0.0], 30_000.0, 60.0, 900.0);
        let camera = Camera::pinhole("c", [96.0, 64.0], 110.0, [48.0, 32.0]);
        let oblique = Plan { pitch_deg: -15.0, look_deg: 90.0, ..plan() };
        let effects =
            Effects { haze_m: Some(20_000.0), clouds: 0.4, grain: 5.0, vignetting: 0.3, samples: 2, ..effects() };
        let exposures = oblique.exposures(2);
        let renderer = FrameRenderer {
            landscape: &landscape,
            camera: &camera,
            exposure: &exposures[2],
            effects: &effects,
            bands: 1,
        };
        let whole = renderer.rows(0, 64);
        let parts = [renderer.rows(0, 5), renderer.rows(5, 40), renderer.rows(40, 64)].concat();
        assert_eq!(whole, parts);
        // Sky above, ground below, and both textured.
        let mean = |rows: &[u8]| rows.iter().map(|v| f64::from(*v)).sum::<f64>() / rows.len() as f64;
        assert!(mean(&whole[..96 * 6]) > mean(&whole[96 * 50..]) + 15.0);
    }
}
