//! Ties to a fraction of a pixel: what one frame shows around a tie is laid upon what the other shows there.
//!
//! Least squares matching (F. Ackermann, "Digital image correlation", Photogrammetric Record 11, 1984; A. Grün,
//! "Adaptive least squares correlation", South African Journal of Photogrammetry 14, 1985), in the inverse form, where
//! the gradients are those of the one window that does not move (S. Baker and I. Matthews, "Lucas-Kanade 20 years on",
//! IJCV 56, 2004). Sought are the shift, and contrast and light of the windows to each other; how the ground around is
//! turned, sheared and scaled from frame to frame the neighbouring ties say.

use std::collections::BTreeMap;

use autoref_raster::keys::cubic;
use autoref_raster::ranks::upper_median;
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Matrix4, Vector2, Vector3, Vector4};
use rayon::prelude::*;

use crate::intersect::intersect_seen;
use crate::read::Reconstruction;

/// Pixels of a window to each side of its middle, and the σ of the weights in it.
const HALF_PX: i32 = 14;
const SIGMA_PX: f64 = 7.0;
/// A feature that lies farther off is another.
const MOST_MOVED_PX: f64 = 3.0;
/// A step as small as this is the last.
const LAST_STEP_PX: f64 = 0.01;
const MOST_STEPS: usize = 25;
/// Windows that correlate less show different ground.
const LEAST_CORRELATION: f64 = 0.6;
/// Where so large a share of a frame's image points was laid, and as many at least, they count, and those that do not
/// fit show other ground: in a rendered flight two in five of them were more than a pixel off, of the others one in
/// forty.
const LEAST_LAID: f64 = 0.5;
const LEAST_POINTS: usize = 30;
/// Neighbouring ties that say how the ground is warped, and how few can say it.
const NEIGHBOURS: usize = 16;
const LEAST_NEIGHBOURS: usize = 6;

/// A frame in grey, `scale` pixels of it to a pixel of the frame along rows and columns.
#[derive(Clone, Copy)]
pub struct Picture<'a> {
    pub size: [usize; 2],
    pub grey: &'a [u8],
    pub scale: [f64; 2],
}

/// A tie of two frames: the image point that stays and the one that moves, by their places in `seen`.
#[derive(Clone, Copy, Debug)]
struct Tied {
    tie: usize,
    stays: usize,
    moves: usize,
}

/// Two frames that are to be laid upon each other.
#[derive(Debug)]
pub struct Pair {
    /// By their numbers, the smaller first.
    pub frames: [usize; 2],
    ties: Vec<Tied>,
    /// Where both frames show the same ground.
    common: Vec<[[f64; 2]; 2]>,
}

/// What became of an image point that was to be laid upon another.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    tied: Tied,
    /// `None` where the frames show different ground.
    to: Option<[f64; 2]>,
}

impl Moved {
    /// Whether both frames show the same ground there.
    pub fn is_laid(&self) -> bool {
        self.to.is_some()
    }
}

/// How two windows fit.
enum Fit {
    /// So far off.
    At(Vector2<f64>),
    Unlike,
    /// One of them is not in its frame, or nothing says how it is warped.
    Untold,
}

/// The pairs of frames that share ties. Of every tie the image point in the middle stays, and the others are laid upon
/// it: all of a tie then agree on one place of the ground.
pub fn pairs(model: &Reconstruction) -> Vec<Pair> {
    let mut pairs: BTreeMap<[usize; 2], Pair> = BTreeMap::new();
    for (tie, point) in model.ties.iter().enumerate() {
        let stays = point.seen.len() / 2;
        for (i, (a, p)) in point.seen.iter().enumerate() {
            for (j, (b, q)) in point.seen.iter().enumerate().filter(|(_, (b, _))| a < b) {
                let pair =
                    pairs.entry([*a, *b]).or_insert_with(|| Pair { frames: [*a, *b], ties: vec![], common: vec![] });
                pair.common.push([*p, *q]);
                if i == stays || j == stays {
                    let moves = if i == stays { j } else { i };
                    pair.ties.push(Tied { tie, stays, moves });
                }
            }
        }
    }
    pairs.into_values().filter(|pair| !pair.ties.is_empty() && pair.common.len() > LEAST_NEIGHBOURS).collect()
}

/// Lays the image points of a pair of frames upon each other, `pictures` in the order of its frames. Points that say
/// nothing, beside the border of a frame, are left out.
pub fn laid(model: &Reconstruction, pair: &Pair, pictures: [Picture<'_>; 2]) -> Vec<Moved> {
    let one = |tied: &Tied| {
        let seen = &model.ties[tied.tie].seen;
        let ((frame, stays), (_, moves)) = (seen[tied.stays], seen[tied.moves]);
        let from = usize::from(frame == pair.frames[1]);
        let common = pair.common.iter().map(|c| [Vector2::from(c[from]), Vector2::from(c[1 - from])]);
        let warp = warp(common, [stays.into(), moves.into()])?;
        let [one, two] = [pictures[from], pictures[1 - from]];
        let to = match shift([one, two], [stays.into(), moves.into()], &warp) {
            Fit::At(shift) => Some([moves[0] + shift.x, moves[1] + shift.y]),
            Fit::Unlike => None,
            Fit::Untold => return None,
        };
        Some(Moved { tied: *tied, to })
    };
    pair.ties.par_iter().filter_map(one).collect()
}

/// The block with the image points where they were laid, without those that do not fit, both in frames most of whose
/// do, and its ties where their rays meet now; `None` when the rays meet no better than before (the median over image
/// points): then what stands up from the ground, or moved, was laid upon each other. Where few windows of faint frames
/// fit, many of them do so by chance.
pub fn taken(model: &Reconstruction, moved: &[Moved]) -> Option<Reconstruction> {
    let mut laid = model.clone();
    for (tied, to) in clearly(model, moved) {
        laid.ties[tied.tie].seen[tied.moves].1 = to;
    }
    let met = |model: &Reconstruction| -> Vec<Option<Vector3<f64>>> {
        model.ties.par_iter().map(|tie| intersect_seen(model, &tie.seen)).collect()
    };
    let (before, after) = (met(model), met(&laid));
    let missed = |model: &Reconstruction, places: &[Option<Vector3<f64>>]| {
        let both = before.iter().zip(&after).map(|(a, b)| a.is_some() && b.is_some());
        let points = model.ties.iter().zip(places).zip(both).filter(|(_, both)| *both);
        let mut all: Vec<f64> = points
            .filter_map(|((tie, place), _)| Some((tie, (*place)?)))
            .flat_map(|(tie, place)| tie.seen.iter().map(move |seen| (seen, place)))
            .filter_map(|((frame, pixel), place)| {
                let photograph = &model.photographs[*frame];
                let local = photograph.pose.to_camera(&place).into();
                model.cameras[photograph.camera].residual(local, *pixel).map(|[x, y]| x.hypot(y))
            })
            .collect();
        upper_median(&mut all)
    };
    if missed(&laid, &after)? >= missed(model, &before)? {
        return None;
    }
    for (tie, place) in laid.ties.iter_mut().zip(&after) {
        tie.xyz = place.unwrap_or(tie.xyz);
    }
    leave_out(&mut laid, moved);
    Some(laid)
}

/// Image points that [`taken`] moves.
pub fn taken_points(model: &Reconstruction, moved: &[Moved]) -> usize {
    clearly(model, moved).count()
}

/// What was laid in frames most of whose image points were, and where.
fn clearly(model: &Reconstruction, moved: &[Moved]) -> impl Iterator<Item = (Tied, [f64; 2])> {
    let clear = clear_frames(model, moved);
    moved.iter().filter_map(move |m| {
        let to = m.to?;
        frames(model, &m.tied).into_iter().all(|frame| clear[frame]).then_some((m.tied, to))
    })
}

/// The frames of a tie's image points that were laid upon each other.
fn frames(model: &Reconstruction, tied: &Tied) -> [usize; 2] {
    let seen = &model.ties[tied.tie].seen;
    [seen[tied.stays].0, seen[tied.moves].0]
}

/// Which frames show ground so clearly that most of their image points were laid.
fn clear_frames(model: &Reconstruction, moved: &[Moved]) -> Vec<bool> {
    let mut counts = vec![[0usize; 2]; model.photographs.len()];
    for m in moved {
        for frame in frames(model, &m.tied) {
            counts[frame][usize::from(m.is_laid())] += 1;
        }
    }
    let is_clear = |[not, fit]: &[usize; 2]| *fit >= LEAST_POINTS && *fit as f64 >= LEAST_LAID * (not + fit) as f64;
    counts.iter().map(is_clear).collect()
}

/// Takes out the image points that do not fit, in frames most of whose do.
fn leave_out(laid: &mut Reconstruction, moved: &[Moved]) {
    let clear = clear_frames(laid, moved);
    let mut out: Vec<Vec<usize>> = vec![vec![]; laid.ties.len()];
    for m in moved.iter().filter(|m| !m.is_laid()) {
        if frames(laid, &m.tied).into_iter().all(|frame| clear[frame]) {
            out[m.tied.tie].push(m.tied.moves);
        }
    }
    for (tie, out) in laid.ties.iter_mut().zip(&out) {
        let mut number = 0..;
        tie.seen.retain(|_| !number.next().is_some_and(|i| out.contains(&i)));
    }
    laid.ties.retain(|tie| tie.seen.len() >= 2);
}

/// How the ground around a tie is turned, sheared and scaled from the one frame to the other, as the ties around it
/// move; `None` when they say nothing.
fn warp(common: impl Iterator<Item = [Vector2<f64>; 2]>, at: [Vector2<f64>; 2]) -> Option<Matrix2<f64>> {
    let mut near: Vec<[Vector2<f64>; 2]> = common.map(|[p, q]| [p - at[0], q - at[1]]).collect();
    // The tie itself says nothing of its surroundings, and costs nothing.
    if near.len() > NEIGHBOURS + 1 {
        near.select_nth_unstable_by(NEIGHBOURS, |a, b| a[0].norm_squared().total_cmp(&b[0].norm_squared()));
        near.truncate(NEIGHBOURS + 1);
    }
    let mut weights = vec![1.0; near.len()];
    let mut found = Matrix3x2::zeros();
    for _ in 0..5 {
        let (mut normal, mut right) = (Matrix3::zeros(), Matrix3x2::zeros());
        for ([p, q], weight) in near.iter().zip(&weights) {
            let row = Vector3::new(p.x, p.y, 1.0);
            normal += row * row.transpose() * *weight;
            right += row * q.transpose() * *weight;
        }
        found = normal.try_inverse()? * right;
        let missed: Vec<f64> =
            near.iter().map(|[p, q]| (q - found.transpose() * Vector3::new(p.x, p.y, 1.0)).norm()).collect();
        // As absolute values weigh, but for those that fit as most do.
        let usual = upper_median(&mut missed.clone())? + 0.3;
        weights = missed.iter().map(|m| 1.0 / m.max(usual)).collect();
    }
    let warp = found.fixed_rows::<2>(0).transpose();
    let values = warp.singular_values();
    (values.min() > 0.4 && values.max() < 2.5).then_some(warp)
}

impl Picture<'_> {
    /// The grey value at a place of the picture.
    fn at(&self, place: Vector2<f64>) -> f64 {
        let value = |i: usize, j: usize| f32::from(self.grey[j * self.size[0] + i]);
        f64::from(cubic(self.size, [place.x - 0.5, place.y - 0.5], value))
    }

    fn holds(&self, place: Vector2<f64>) -> bool {
        (0..2).all(|k| place[k] >= 1.0 && place[k] <= self.size[k] as f64 - 1.0)
    }
}

/// Where the second picture shows what the first shows around the first place, in pixels of the frame from the second
/// place.
fn shift(pictures: [Picture<'_>; 2], at: [Vector2<f64>; 2], warp: &Matrix2<f64>) -> Fit {
    let [one, two] = pictures;
    let [of_one, of_two] = [one, two].map(|picture| Vector2::from(picture.scale));
    let (p, q) = (at[0].component_mul(&of_one), at[1].component_mul(&of_two));
    let warp = Matrix2::from_fn(|r, c| warp[(r, c)] * of_two[r] / of_one[c]);
    let reach = f64::from(HALF_PX + 1);
    let corners = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|c| Vector2::from(c) * reach);
    let margin = Vector2::new(MOST_MOVED_PX, MOST_MOVED_PX);
    if !corners.iter().all(|c| one.holds(p + c) && two.holds(q + warp * c - margin) && two.holds(q + warp * c + margin))
    {
        return Fit::Untold;
    }
    let Some(template) = Template::of(&one, p) else { return Fit::Unlike };
    let mut moved = Vector2::zeros();
    for _ in 0..MOST_STEPS {
        let values: Vec<f64> = template.offsets.iter().map(|d| two.at(q + moved + warp * d)).collect();
        let Some(step) = template.step(&values) else { return Fit::Unlike };
        moved -= warp * step;
        if moved.norm() > MOST_MOVED_PX {
            return Fit::Unlike;
        }
        if step.norm() < LAST_STEP_PX {
            let alike = template.correlation(&values) >= LEAST_CORRELATION;
            return if alike { Fit::At(moved.component_div(&of_two)) } else { Fit::Unlike };
        }
    }
    Fit::Unlike
}

/// A window that others are laid upon.
struct Template {
    offsets: Vec<Vector2<f64>>,
    /// Weight, and what a window is made of: the gradients, the window itself, and light.
    rows: Vec<(f64, Vector4<f64>)>,
    inverse: Matrix4<f64>,
}

impl Template {
    fn of(picture: &Picture<'_>, at: Vector2<f64>) -> Option<Self> {
        let reach = HALF_PX + 1;
        let side = (2 * reach + 1) as usize;
        let place = |k: usize| Vector2::new((k % side) as f64, (k / side) as f64).add_scalar(-f64::from(reach));
        let grey: Vec<f64> = (0..side * side).map(|k| picture.at(at + place(k))).collect();
        let inside = |k: &usize| (1..side - 1).contains(&(k % side)) && (1..side - 1).contains(&(k / side));
        let (mut offsets, mut rows) = (Vec::new(), Vec::new());
        for k in (0..side * side).filter(inside) {
            let d = place(k);
            let gradient = [grey[k + 1] - grey[k - 1], grey[k + side] - grey[k - side]].map(|v| v / 2.0);
            let weight = (-0.5 * d.norm_squared() / (SIGMA_PX * SIGMA_PX)).exp();
            offsets.push(d);
            rows.push((weight, Vector4::new(gradient[0], gradient[1], grey[k], 1.0)));
        }
        let normal: Matrix4<f64> = rows.iter().map(|(weight, row)| row * row.transpose() * *weight).sum();
        Some(Template { offsets, rows, inverse: normal.try_inverse()? })
    }

    /// How far what the values show lies from the middle; `None` where they are nothing of the kind.
    fn step(&self, values: &[f64]) -> Option<Vector2<f64>> {
        let right: Vector4<f64> = self.rows.iter().zip(values).map(|((weight, row), v)| row * (weight * v)).sum();
        let found = self.inverse * right;
        (found[2] > 0.2).then(|| Vector2::new(found[0], found[1]) / found[2])
    }

    fn correlation(&self, values: &[f64]) -> f64 {
        let both = || self.rows.iter().zip(values).map(|((weight, row), v)| (*weight, row[2], *v));
        let sum: f64 = both().map(|(w, ..)| w).sum();
        let [one, two] = both().fold([0.0; 2], |[a, b], (w, u, v)| [a + w * u / sum, b + w * v / sum]);
        let [uu, uv, vv] = both().fold([0.0; 3], |s, (w, u, v)| {
            let (u, v) = (u - one, v - two);
            [s[0] + w * u * u, s[1] + w * u * v, s[2] + w * v * v]
        });
        uv / (uu * vv).sqrt().max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::pose::{Pose, YawPitchRoll};
    use crate::read::{Photograph, TiePoint};
    use autoref_synth::rng::{Rng, value_noise};

    const SIZE: [usize; 2] = [320, 240];

    /// Three frames of ground that is drawn, straight down, each with light, turn and grain of its own, and ties of
    /// which every image point but the middle one is off by 0.8 px.
    struct Drawn {
        model: Reconstruction,
        greys: Vec<Vec<u8>>,
        truth: Vec<Vec<[f64; 2]>>,
    }

    impl Drawn {
        fn new(ground: fn(usize, f64, f64) -> f64) -> Self {
            let mut rng = Rng::new(3, 1, 1);
            let camera = Camera::pinhole("c", SIZE.map(|v| v as f64), 300.0, [160.0, 120.0]);
            let look = |k: usize| {
                let angles = YawPitchRoll { yaw_deg: 4.0 * k as f64, pitch_deg: -89.0, roll_deg: 0.0 };
                Pose::looking(Vector3::new(60.0 * k as f64, 0.0, 300.0 + 10.0 * k as f64), angles)
            };
            let poses: Vec<Pose> = (0..3).map(look).collect();
            let on_ground = |pose: &Pose, pixel: [f64; 2]| {
                let ray = pose.rotation.transpose() * Vector3::from(camera.ray(pixel).expect("a pinhole"));
                pose.centre - ray * (pose.centre.z / ray.z)
            };
            let greys = (0..3).map(|k| {
                let pixel = |i: usize| {
                    let x = on_ground(&poses[k], [(i % SIZE[0]) as f64 + 0.5, (i / SIZE[0]) as f64 + 0.5]);
                    let value = (0.6 + 0.15 * k as f64) * ground(k, x.x, x.y) + 10.0 * k as f64 + 3.0 * rng.normal();
                    value.round().clamp(0.0, 255.0) as u8
                };
                (0..SIZE[0] * SIZE[1]).map(pixel).collect()
            });
            let greys: Vec<Vec<u8>> = greys.collect();
            let (mut ties, mut truth) = (Vec::new(), Vec::new());
            while ties.len() < 150 {
                let xyz = on_ground(&poses[1], [rng.range(20.0, 300.0), rng.range(20.0, 220.0)]);
                let seen = poses.iter().map(|p| camera.project(p.to_camera(&xyz).into()).expect("in front"));
                let right: Vec<[f64; 2]> = seen.collect();
                if right.iter().all(|p| p[0] > 20.0 && p[0] < 300.0 && p[1] > 20.0 && p[1] < 220.0) {
                    let mut off = |k: usize, v: f64| if k == 1 { v } else { v + 0.8 * rng.normal() };
                    let seen = right.iter().enumerate().map(|(k, p)| (k, p.map(|v| off(k, v)))).collect();
                    ties.push(TiePoint { xyz, seen });
                    truth.push(right);
                }
            }
            let photographs = poses.iter().enumerate();
            let photographs =
                photographs.map(|(k, pose)| Photograph { name: format!("{k}"), camera: 0, pose: *pose }).collect();
            let model = Reconstruction { cameras: vec![camera], photographs, ties, ..Reconstruction::default() };
            Drawn { model, greys, truth }
        }

        fn laid(&self) -> Vec<Moved> {
            let picture = |k: usize| Picture { size: SIZE, grey: &self.greys[k], scale: [1.0; 2] };
            let pairs = pairs(&self.model);
            pairs.iter().flat_map(|pair| laid(&self.model, pair, pair.frames.map(picture))).collect()
        }

        /// The largest of nineteen in twenty errors of image points that were laid, before and after.
        fn most(&self, moved: &[Moved]) -> [f64; 2] {
            let error = |m: &Moved, at: [f64; 2]| {
                let b = self.truth[m.tied.tie][m.tied.moves];
                (at[0] - b[0]).hypot(at[1] - b[1])
            };
            let before =
                |m: &Moved| Some(error(m, self.model.ties[m.tied.tie].seen[m.tied.moves].1)).filter(|_| m.is_laid());
            let after = |m: &Moved| Some(error(m, m.to?));
            let most = |mut all: Vec<f64>| {
                all.sort_by(f64::total_cmp);
                all[all.len() * 19 / 20]
            };
            [most(moved.iter().filter_map(before).collect()), most(moved.iter().filter_map(after).collect())]
        }
    }

    fn noise(seed: u64, x: f64, y: f64) -> f64 {
        let at = |size: f64| f64::from(value_noise(seed + size as u64, (x / size) as f32, (y / size) as f32));
        60.0 + 70.0 * at(3.0) + 60.0 * at(9.0)
    }

    fn laid_count(moved: &[Moved]) -> usize {
        moved.iter().filter(|m| m.is_laid()).count()
    }

    #[test]
    fn ties_are_laid_upon_each_other_to_a_tenth_of_a_pixel() {
        let drawn = Drawn::new(|_, x, y| noise(1, x, y));
        let moved = drawn.laid();
        assert!(laid_count(&moved) > 280, "{} of 300", laid_count(&moved));
        let [before, after] = drawn.most(&moved);
        assert!(before > 1.2 && after < 0.15, "{before} -> {after}");
        let better = taken(&drawn.model, &moved).expect("the rays meet better");
        assert!(better.ties.len() >= 145, "{}", better.ties.len());
        assert!(moved.iter().all(|m| m.tied.stays == 1), "the point in the middle stays");
    }

    #[test]
    fn what_shows_other_ground_is_taken_out_where_most_fits() {
        let mut drawn = Drawn::new(|_, x, y| noise(1, x, y));
        // In every tenth tie one frame shows ground 40 px away.
        for tie in drawn.model.ties.iter_mut().step_by(10) {
            tie.seen[0].1[0] += if tie.seen[0].1[0] < 160.0 { 40.0 } else { -40.0 };
        }
        let better = taken(&drawn.model, &drawn.laid()).expect("the rays meet better");
        let off = |tie: &TiePoint, truth: &Vec<[f64; 2]>| {
            tie.seen.iter().any(|(k, p)| (p[0] - truth[*k][0]).hypot(p[1] - truth[*k][1]) > 5.0)
        };
        // By the point in the middle, which stays.
        let truth_of = |tie: &TiePoint| {
            let middle = tie.seen.iter().find(|(k, _)| *k == 1).expect("it stays").1;
            drawn.truth.iter().find(|truth| truth[1] == middle).expect("drawn")
        };
        let wrong = better.ties.iter().filter(|tie| off(tie, truth_of(tie))).count();
        assert!(wrong <= 2, "{wrong} of 15 are left");
        assert!(better.ties.len() >= 140, "{} of 150", better.ties.len());
    }

    #[test]
    fn what_shows_other_ground_everywhere_is_left_alone() {
        // Each frame has ground of its own, as water has.
        let drawn = Drawn::new(|frame, x, y| noise(100 * frame as u64, x, y));
        let moved = drawn.laid();
        assert!(laid_count(&moved) < 30, "{} of 300", laid_count(&moved));
        let mut block = drawn.model.clone();
        leave_out(&mut block, &moved);
        assert_eq!(block.ties.len(), 150);
        // Nor are the few that fit by chance moved.
        assert!(taken(&drawn.model, &moved).is_none());
        let even = Drawn::new(|_, _, _| 100.0);
        assert!(laid_count(&even.laid()) < 30);
    }

    #[test]
    fn a_block_whose_rays_meet_worse_is_not_taken() {
        let drawn = Drawn::new(|_, x, y| noise(1, x, y));
        let far = |tie: usize| {
            let tied = Tied { tie, stays: 1, moves: 0 };
            Moved { tied, to: Some(drawn.model.ties[tie].seen[0].1.map(|v| v + 3.0)) }
        };
        let moved: Vec<Moved> = (0..drawn.model.ties.len()).map(far).collect();
        assert!(taken(&drawn.model, &moved).is_none());
    }

    #[test]
    fn few_ties_do_not_say_how_the_ground_is_warped() {
        let mut drawn = Drawn::new(|_, x, y| noise(1, x, y));
        drawn.model.ties.truncate(LEAST_NEIGHBOURS);
        assert!(pairs(&drawn.model).is_empty());
    }
}
