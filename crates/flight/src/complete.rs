//! A block completed: parts that a mapper left apart are joined, frames that it left out are resected by their ties.
//!
//! A mapper that grows frame by frame ends where a frame sees too few points that are known already, as at the turn of
//! a flight, and begins another part there. Parts share frames, which say how one lies in the other. A frame by itself
//! is placed by the ties that lead to known points: poses of three points (Grunert) drawn many times, the one that
//! most ties agree with (Fischler and Bolles, *Random sample consensus*, 1981), refined; then all is adjusted
//! together.

use std::collections::HashMap;

use autoref_raster::random::Mmix;
use nalgebra::Vector3;

use crate::adjust::by_poses;
use crate::bundle::{
    ANY_FOCAL, BundleCamera, BundleFrame, BundlePoint, FROM_AFAR, Loss, Observation, Options, Problem, Summary, Trust,
    solve,
};
use crate::error::Result;
use crate::intersect::intersect_seen;
use crate::pose::{Pose, Similarity, turn};
use crate::read::{Photograph, Reconstruction, TiePoint};
use crate::resect::three_points;
use crate::start::Track;

/// Directions and places of a shared frame may differ so much between two parts: degrees, and the share of the distance
/// between shared frames.
const SAME_DEG: f64 = 5.0;
const SAME_SHARE: f64 = 0.15;
/// Share by which their focal lengths may.
const SAME_FOCAL: f64 = 0.1;
/// Known points that a frame must see where its pose has them, to be placed; what is left after the adjustment.
const LEAST_SEEN: usize = 20;
const LEAST_KEPT: usize = 12;
/// Triples that are drawn.
const DRAWS: usize = 500;
/// A tie agrees with a drawn pose at this share of the focal length, with an adjusted block at so many pixels.
const NEAR_SHARE: f64 = 0.004;
const NEAR_PX: f64 = 4.0;

/// A large block is adjusted again when it has grown by one frame in so many.
const GROWTH: usize = 20;

/// A place of a photograph, to a thousandth of a pixel.
type Place = (usize, i64, i64);

fn place(photograph: usize, pixel: [f64; 2]) -> Place {
    let [x, y] = pixel.map(|v| (v * 1000.0).round() as i64);
    (photograph, x, y)
}

/// A photograph by its whole name: others may differ in their extension only.
fn find(block: &Reconstruction, name: &str) -> Option<usize> {
    block.photographs.iter().position(|p| p.name == name)
}

/// The ties' places.
fn places_of(block: &Reconstruction) -> HashMap<Place, usize> {
    let of = |(k, tie): (usize, &TiePoint)| tie.seen.iter().map(move |(i, at)| (place(*i, *at), k)).collect::<Vec<_>>();
    block.ties.iter().enumerate().flat_map(of).collect()
}

/// The largest part with all that share two frames with it, or with what is joined already, adjusted together.
pub fn joined(mut parts: Vec<Reconstruction>) -> Option<Reconstruction> {
    // The first of equals stays the first.
    parts.sort_by_key(|part| std::cmp::Reverse(part.photographs.len()));
    let mut rest = parts.into_iter();
    let mut block = rest.next()?;
    let mut rest: Vec<Reconstruction> = rest.collect();
    let alone = block.photographs.len();
    while let Some((k, by)) = rest.iter().enumerate().find_map(|(k, part)| Some((k, lies_in(&block, part)?))) {
        let part = rest.remove(k);
        if part.photographs.iter().any(|p| find(&block, &p.name).is_none()) {
            merge(&mut block, &part, &by);
        }
    }
    if block.photographs.len() > alone {
        // What cannot be adjusted stays as it was joined.
        let before = block.clone();
        if adjust(&mut block).is_err() {
            block = before;
        }
    }
    Some(block)
}

/// How a part lies in a block, by the frames that both have; `None` where these are fewer than two, or contradict.
fn lies_in(block: &Reconstruction, part: &Reconstruction) -> Option<Similarity> {
    let ([own], [other]) = (&block.cameras[..], &part.cameras[..]) else { return None };
    if (other.f_px() / own.f_px() - 1.0).abs() > SAME_FOCAL {
        return None;
    }
    let shared: Vec<(&Pose, &Pose)> = part
        .photographs
        .iter()
        .filter_map(|p| Some((&p.pose, &block.photographs[find(block, &p.name)?].pose)))
        .collect();
    let by = if shared.len() >= 2 { by_poses(&shared)? } else { return None };
    let extent = shared.iter().map(|(_, b)| (b.centre - shared[0].1.centre).norm()).fold(0.0, f64::max);
    let agrees = |(p, b): &(&Pose, &Pose)| {
        let moved = p.moved(&by);
        turn(&moved.rotation, &b.rotation).norm().to_degrees() < SAME_DEG
            && (moved.centre - b.centre).norm() < SAME_SHARE * extent
    };
    shared.iter().all(agrees).then_some(by)
}

fn merge(block: &mut Reconstruction, part: &Reconstruction, by: &Similarity) {
    let index: Vec<usize> = part
        .photographs
        .iter()
        .map(|p| {
            find(block, &p.name).unwrap_or_else(|| {
                block.photographs.push(Photograph { name: p.name.clone(), camera: 0, pose: p.pose.moved(by) });
                block.photographs.len() - 1
            })
        })
        .collect();
    let known = places_of(block);
    for tie in &part.ties {
        let seen: Vec<(usize, [f64; 2])> = tie.seen.iter().map(|(i, at)| (index[*i], *at)).collect();
        match seen.iter().find_map(|(i, at)| known.get(&place(*i, *at))) {
            Some(k) => see(&mut block.ties[*k], &seen),
            None => block.ties.push(TiePoint { xyz: by.apply(&tie.xyz), seen }),
        }
    }
}

/// Adds what a tie is not known to be seen in.
fn see(tie: &mut TiePoint, seen: &[(usize, [f64; 2])]) {
    for (i, at) in seen {
        if tie.seen.iter().all(|(k, _)| k != i) {
            tie.seen.push((*i, *at));
        }
    }
}

/// The block with those of `names` that it lacks and `tracks`, whose frames go by `names`, can place. A block of
/// several cameras stays as it is.
///
/// # Errors
/// When a number is not finite.
pub fn completed(mut block: Reconstruction, names: &[&str], tracks: &[Track]) -> Result<Reconstruction> {
    if block.cameras.len() != 1 {
        return Ok(block);
    }
    let mut of_frame: Vec<Vec<&Track>> = vec![Vec::new(); names.len()];
    for track in tracks {
        track.iter().for_each(|(frame, _)| of_frame[*frame].push(track));
    }
    let mut hopeless = vec![false; names.len()];
    // As it was adjusted last, and the frames that came since.
    let (mut adjusted, mut fresh): (_, Vec<usize>) = (block.clone(), Vec::new());
    loop {
        let index: Vec<Option<usize>> = names.iter().map(|name| find(&block, name)).collect();
        let known = places_of(&block);
        let missing = (0..names.len()).filter(|f| index[*f].is_none() && !hopeless[*f]);
        let posed: Vec<(usize, Pose)> = missing
            .filter_map(|f| Some((f, drawn_pose(&block, &known_points(f, &of_frame[f], &index, &known, &block))?)))
            .collect();
        let added: Vec<usize> = posed.iter().map(|(frame, _)| *frame).collect();
        block.photographs.extend(posed.into_iter().map(|(frame, pose)| Photograph {
            name: names[frame].to_string(),
            camera: 0,
            pose,
        }));
        fresh.extend(&added);
        if fresh.is_empty() {
            return Ok(block);
        }
        let index: Vec<Option<usize>> = names.iter().map(|name| find(&block, name)).collect();
        tie(&mut block, &added, &index, tracks, &known);
        if !added.is_empty() && fresh.len() < adjusted.photographs.len() / GROWTH {
            continue;
        }
        adjust(&mut block)?;
        let first = adjusted.photographs.len();
        let mut ties = vec![0; block.photographs.len()];
        block.ties.iter().flat_map(|t| &t.seen).for_each(|(i, _)| ties[*i] += 1);
        if (first..ties.len()).any(|i| ties[i] < LEAST_KEPT) {
            // The one that holds least may have bent the others: once more without it.
            let least = fresh.iter().zip(&ties[first..]).min_by_key(|(_, ties)| **ties);
            least.into_iter().for_each(|(frame, _)| hopeless[*frame] = true);
            block.clone_from(&adjusted);
        } else {
            adjusted.clone_from(&block);
        }
        fresh.clear();
    }
}

/// Points of the block that ties lead to from a frame: pixel and place.
fn known_points(
    frame: usize,
    tracks: &[&Track],
    index: &[Option<usize>],
    known: &HashMap<Place, usize>,
    block: &Reconstruction,
) -> Vec<([f64; 2], Vector3<f64>)> {
    let of = |track: &&Track| {
        let pixel = track.iter().find(|(f, _)| *f == frame)?.1;
        let tie = track.iter().find_map(|(f, at)| known.get(&place(index[*f]?, *at)))?;
        Some((pixel, block.ties[*tie].xyz))
    };
    tracks.iter().filter_map(of).collect()
}

/// The pose that most points agree with, refined; `None` where these are too few.
fn drawn_pose(block: &Reconstruction, seen: &[([f64; 2], Vector3<f64>)]) -> Option<Pose> {
    if seen.len() < LEAST_SEEN {
        return None;
    }
    let camera = &block.cameras[0];
    let off = |pose: &Pose, (pixel, x): &([f64; 2], Vector3<f64>)| {
        camera.residual(pose.to_camera(x).into(), *pixel).map_or(f64::INFINITY, |[x, y]| x.hypot(y))
    };
    let near_px = (NEAR_SHARE * camera.f_px()).max(NEAR_PX);
    let agreeing = |pose: &Pose, px: f64| seen.iter().filter(|s| off(pose, s) < px).count();
    let mut draws = Mmix(0x9E37_79B9_7F4A_7C15);
    let mut draw = || draws.below(seen.len());
    let mut best: Option<(usize, Pose)> = None;
    for _ in 0..DRAWS {
        let three = [draw(), draw(), draw()];
        let rays = three.map(|k| camera.ray(seen[k].0).map(Vector3::from));
        let [Some(a), Some(b), Some(c)] = rays else { continue };
        for pose in three_points(&three.map(|k| seen[k].1), &[a, b, c]) {
            let count = agreeing(&pose, near_px);
            if best.as_ref().is_none_or(|(most, _)| count > *most) {
                best = Some((count, pose));
            }
        }
    }
    let (_, pose) = best.filter(|(count, _)| *count >= LEAST_SEEN)?;
    let spread = seen.iter().map(|s| (s.1 - seen[0].1).norm()).fold(0.0, f64::max);
    let mut problem = Problem {
        cameras: vec![BundleCamera::held(camera.clone())],
        frames: vec![BundleFrame { camera: 0, pose, position: None, direction: None }],
        // Held by a σ that no residual notices.
        points: seen
            .iter()
            .map(|s| BundlePoint { xyz: s.1, survey: Some((s.1, Vector3::repeat(spread * 1e-7))) })
            .collect(),
        observations: (0..)
            .zip(seen)
            .map(|(point, s)| Observation { frame: 0, point, pixel: s.0, sigma_px: 2.0, trust: Trust::Robust })
            .collect(),
        offset: None,
    };
    solve(&mut problem, &ROBUST).ok()?;
    let pose = problem.frames[0].pose;
    (agreeing(&pose, near_px) >= LEAST_SEEN).then_some(pose)
}

const ROBUST: Options =
    Options { loss: Loss::Cauchy(2.0), most_iterations: 60, least_gain: 1e-6, focal_px: ANY_FOCAL, damping: FROM_AFAR };

/// Ties of the frames that were added: to points that are known, and new ones where rays meet.
fn tie(
    block: &mut Reconstruction,
    added: &[usize],
    index: &[Option<usize>],
    tracks: &[Track],
    known: &HashMap<Place, usize>,
) {
    for track in tracks.iter().filter(|track| track.iter().any(|(f, _)| added.contains(f))) {
        let seen: Vec<(usize, [f64; 2])> = track.iter().filter_map(|(f, at)| Some((index[*f]?, *at))).collect();
        match seen.iter().find_map(|(i, at)| known.get(&place(*i, *at))) {
            Some(k) => see(&mut block.ties[*k], &seen),
            None if seen.len() >= 2 => {
                if let Some(xyz) = intersect_seen(block, &seen).filter(|x| x.iter().all(|v| v.is_finite())) {
                    block.ties.push(TiePoint { xyz, seen });
                }
            }
            None => {}
        }
    }
}

/// Adjusts all poses and points, loosely held where they are, and drops what does not fit.
fn adjust(block: &mut Reconstruction) -> Result<Summary> {
    let middle = block.photographs.iter().map(|p| p.pose.centre).sum::<Vector3<f64>>() / block.photographs.len() as f64;
    let extent = block.photographs.iter().map(|p| (p.pose.centre - middle).norm()).fold(0.0, f64::max);
    let hold = Vector3::repeat(extent.max(f64::MIN_POSITIVE));
    let mut problem = Problem {
        cameras: vec![BundleCamera::held(block.cameras[0].clone())],
        frames: block
            .photographs
            .iter()
            .map(|p| BundleFrame { camera: 0, pose: p.pose, position: Some((p.pose.centre, hold)), direction: None })
            .collect(),
        points: block.ties.iter().map(|t| BundlePoint { xyz: t.xyz, survey: None }).collect(),
        observations: Vec::new(),
        offset: None,
    };
    for (point, tie) in block.ties.iter().enumerate() {
        problem.observations.extend(tie.seen.iter().map(|(frame, pixel)| Observation {
            frame: *frame,
            point,
            pixel: *pixel,
            sigma_px: 1.0,
            trust: Trust::Robust,
        }));
    }
    let summary = solve(&mut problem, &ROBUST)?;
    for (p, frame) in block.photographs.iter_mut().zip(&problem.frames) {
        p.pose = frame.pose;
    }
    let mut fits = problem
        .observations
        .iter()
        .map(|o| problem.residual(o).is_some_and(|r| r[0].hypot(r[1]) < NEAR_PX))
        .collect::<Vec<bool>>()
        .into_iter();
    for (tie, point) in block.ties.iter_mut().zip(&problem.points) {
        tie.xyz = point.xyz;
        tie.seen.retain(|_| fits.next().expect("an observation for each"));
    }
    block.ties.retain(|tie| tie.seen.len() >= 2);
    Ok(summary)
}
