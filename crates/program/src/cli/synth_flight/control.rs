//! Points on the ground that several frames show.

use anyhow::{Result, bail};
use autoref_flight::Reach;
use autoref_flight::ortho::{Place, View};
use autoref_flight::render::FrameRenderer;
use autoref_synth::rng::Rng;
use nalgebra::Vector3;

/// A surveyed point with its observations.
pub struct Point {
    pub name: String,
    pub check: bool,
    /// As it is, and as the list has it.
    pub truth: [f64; 3],
    pub listed: [f64; 3],
    /// Index of the frame, and the pixel as it is measured.
    pub seen: Vec<(usize, [f64; 2])>,
}

/// Farther ground is too faint to be measured, in flying heights.
const FARTHEST: f64 = 6.0;
/// From the frame's border, of its shorter side.
const MARGIN: f64 = 0.01;
/// Draws for each point.
const PATIENCE: usize = 400;

/// Draws GCPs and check points that at least two frames show (one, when there is one).
///
/// # Errors
/// When the frames show too little of the ground.
pub fn draw(
    frames: &[FrameRenderer<'_>],
    gcps: usize,
    checks: usize,
    sigmas: [f64; 2],
    seed: u64,
) -> Result<Vec<Point>> {
    let mut rng = Rng::new(seed, 0x9c9, 0);
    let needed = frames.len().min(2);
    let reaches: Vec<Reach> = frames.iter().map(|frame| frame.camera.reach()).collect();
    let mut points = Vec::new();
    for number in 0..gcps + checks {
        let check = number >= gcps;
        let found = (0..PATIENCE).find_map(|_| {
            let frame = &frames[rng.below(frames.len())];
            let size = frame.camera.size_px;
            let place = frame.ground([rng.range(0.0, size[0]), rng.range(0.0, size[1])])?;
            let height = frame.exposure.pose.centre.z - place[2];
            let near = (Vector3::from(place) - frame.exposure.pose.centre).norm() < FARTHEST * height;
            let wet = frame.landscape.sea_level_m.is_some_and(|level| place[2] <= level + 0.5);
            let seen: Vec<(usize, [f64; 2])> =
                frames.iter().enumerate().filter_map(|(i, f)| Some((i, visible(f, reaches[i], place)?))).collect();
            (near && !wet && seen.len() >= needed).then_some((place, seen))
        });
        let Some((truth, seen)) = found else {
            bail!(
                "no place on dry ground is seen by {needed} frames: bring the frames nearer together (--base), fly lower (--height) or \
                 give a larger model"
            );
        };
        let mut shake = |sigma: f64| sigma * rng.normal();
        let listed = if check { truth } else { truth.map(|v| v + shake(sigmas[0])) };
        let seen = seen.into_iter().map(|(i, at)| (i, at.map(|v| v + shake(sigmas[1])))).collect();
        let (letter, count) = if check { ('C', number - gcps) } else { ('G', number) };
        points.push(Point { name: format!("{letter}{:03}", count + 1), check, truth, listed, seen });
    }
    Ok(points)
}

/// The pixel of a place, when the frame shows it and no ground stands before it.
fn visible(frame: &FrameRenderer<'_>, reach: Reach, place: [f64; 3]) -> Option<[f64; 2]> {
    let pose = frame.exposure.pose;
    let surface = &frame.landscape.surface;
    let view = View { camera: frame.camera, pose, eye: pose.centre.into(), surface, sag: 0.0, reach };
    let Place::Pixel(pixel) = view.at(place[0], place[1], |h| Vector3::new(place[0], place[1], h)) else { return None };
    let margin = MARGIN * frame.camera.size_px[0].min(frame.camera.size_px[1]);
    (0..2).all(|k| pixel[k] > margin && pixel[k] < frame.camera.size_px[k] - margin).then_some(pixel)
}
