//! Flight lines, and which frames are worth comparing: those next to each other along a line, and those of other lines
//! that see the same ground.

use std::f64::consts::{FRAC_PI_6, SQRT_2, TAU};

use autoref_raster::ranks::upper_median;
use nalgebra::Vector3;

use crate::camera::Camera;
use crate::pose::Pose;

/// What a rough table says of a frame.
#[derive(Clone, Debug, Default)]
pub struct Station {
    /// East and north, metres.
    pub place_m: Option<[f64; 2]>,
    /// Clockwise from north.
    pub azimuth_rad: Option<f64>,
    /// The line's name, where the table states it.
    pub line: Option<String>,
}

/// Frames of one run, by their numbers, in the order of the flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    pub name: String,
    pub frames: Vec<usize>,
}

/// Directions within a line differ by less (thesis of 2017, chapter 9: 30°).
const SAME_DIRECTION_RAD: f64 = FRAC_PI_6;
/// A step longer than so many usual ones, or a place farther off by so many standard deviations, begins another line.
const LONG_STEP: f64 = 3.0;
const SIGMAS: f64 = 3.0;

/// The lines of a flight whose frames are in its order. A stated name has the last word; else a line ends where the
/// direction of view, or the way from frame to frame, turns by 30°, or a step is three times as long as usual.
/// `sigma_m`: of a place, per axis.
pub fn lines(stations: &[Station], sigma_m: f64) -> Vec<Line> {
    let noise_m = SIGMAS * SQRT_2 * sigma_m;
    let mut steps: Vec<f64> = stations.windows(2).filter_map(|w| Some(length(between(&w[0], &w[1])?))).collect();
    let longest_m = upper_median(&mut steps).map_or(f64::INFINITY, |usual| LONG_STEP * usual + noise_m);
    let mut lines: Vec<Line> = Vec::new();
    for (next, station) in stations.iter().enumerate() {
        if let Some(name) = &station.line {
            match lines.iter_mut().find(|l| l.name == *name) {
                Some(line) => line.frames.push(next),
                None => lines.push(Line { name: name.clone(), frames: vec![next] }),
            }
            continue;
        }
        let goes_on = lines.last().filter(|line| follows(stations, &line.frames, next, longest_m, noise_m)).is_some();
        match lines.last_mut().filter(|_| goes_on) {
            Some(line) => line.frames.push(next),
            None => lines.push(Line { name: free_name(&lines, stations), frames: vec![next] }),
        }
    }
    lines
}

/// The least number that names no line.
fn free_name(lines: &[Line], stations: &[Station]) -> String {
    let taken =
        |name: &str| lines.iter().any(|l| l.name == name) || stations.iter().any(|s| s.line.as_deref() == Some(name));
    (1..).map(|n: usize| n.to_string()).find(|name| !taken(name)).expect("there are more numbers than lines")
}

/// Does a frame go on with the line of these?
fn follows(stations: &[Station], line: &[usize], next: usize, longest_m: f64, noise_m: f64) -> bool {
    let (Some(first), Some(last)) = (line.first(), line.last()) else { return false };
    if stations[*last].line.is_some() {
        return false;
    }
    let (sin, cos) = line
        .iter()
        .filter_map(|i| stations[*i].azimuth_rad)
        .fold((0.0, 0.0), |(s, c), azimuth| (s + azimuth.sin(), c + azimuth.cos()));
    if let Some(azimuth) = stations[next].azimuth_rad.filter(|_| sin != 0.0 || cos != 0.0) {
        let turn = (azimuth - f64::atan2(sin, cos)).rem_euclid(TAU);
        if turn.min(TAU - turn) > SAME_DIRECTION_RAD {
            return false;
        }
    }
    let Some(step) = between(&stations[*last], &stations[next]) else { return true };
    if length(step) > longest_m {
        return false;
    }
    let Some(track) = between(&stations[*first], &stations[*last]).filter(|t| length(*t) > noise_m) else {
        return true;
    };
    let along = (step[0] * track[0] + step[1] * track[1]) / length(track);
    let aside = (step[0] * track[1] - step[1] * track[0]).abs() / length(track);
    // A step that turns, by more than the places' errors can make it.
    let turns = aside.atan2(along) > SAME_DIRECTION_RAD;
    let off = if along > 0.0 { aside } else { length(step) };
    // The errors of the step, and those of the way so far, drawn out to the step's length.
    !(turns && off > noise_m * (length(step) / length(track)).hypot(1.0))
}

fn between(a: &Station, b: &Station) -> Option<[f64; 2]> {
    let (a, b) = (a.place_m?, b.place_m?);
    Some([b[0] - a[0], b[1] - a[1]])
}

fn length(v: [f64; 2]) -> f64 {
    v[0].hypot(v[1])
}

/// The direction that tells lines apart: of the view, or, straight down, of the frame's upper side. Clockwise from
/// north.
pub fn azimuth_rad(pose: &Pose) -> f64 {
    let axis = |row: usize| Vector3::new(pose.rotation[(row, 0)], pose.rotation[(row, 1)], pose.rotation[(row, 2)]);
    let view = axis(2);
    let level = if view.z < -0.7 { -axis(1) } else { view };
    level.x.atan2(level.y)
}

/// Pairs of frames to compare, smaller number first, sorted: `along` frames to each side on a line, and for each frame
/// the `across` frames of other lines, or of its own where that comes back beside it, that see most of the same ground.
/// `poses` are those of all frames in a metric frame with the height upwards, where they are known; without them the
/// nearest places stand for the ground.
pub fn pairs(
    stations: &[Station],
    lines: &[Line],
    (along, across): (usize, usize),
    sight: Option<Sight<'_>>,
) -> Vec<(usize, usize)> {
    let mut line_of = vec![(usize::MAX, 0); stations.len()];
    // How far the frames stand that a frame is compared with on its line.
    let mut reach_m = vec![0.0f64; stations.len()];
    let mut pairs = std::collections::BTreeSet::new();
    for (number, line) in lines.iter().enumerate() {
        for (at, a) in line.frames.iter().enumerate() {
            line_of[*a] = (number, at);
            for b in line.frames[at + 1..].iter().take(along) {
                pairs.insert((*a.min(b), *a.max(b)));
                let apart_m = between(&stations[*a], &stations[*b]).map_or(0.0, length);
                reach_m[*a] = reach_m[*a].max(apart_m);
                reach_m[*b] = reach_m[*b].max(apart_m);
            }
        }
    }
    let comes_back = |a: usize, b: usize| {
        let apart_m = between(&stations[a], &stations[b]).map(length);
        line_of[a].1.abs_diff(line_of[b].1) > along && apart_m.is_some_and(|m| m < COMES_BACK * reach_m[a])
    };
    for a in 0..stations.len() {
        let others = (0..stations.len()).filter(|b| line_of[*b].0 != line_of[a].0 || comes_back(a, *b));
        let mut ranked: Vec<(f64, usize)> = match &sight {
            Some(sight) => {
                let shared = |b: usize| sight.shared(a, b).min(sight.shared(b, a));
                others.map(|b| (-shared(b), b)).filter(|(rank, _)| *rank <= -LEAST_SHARED).collect()
            }
            None => others.filter_map(|b| Some((length(between(&stations[a], &stations[b])?), b))).collect(),
        };
        ranked.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        pairs.extend(ranked.iter().take(across).map(|(_, b)| (a.min(*b), a.max(*b))));
    }
    pairs.into_iter().collect()
}

/// A line comes back where a frame farther along it is nearer than this share of those that are compared anyway.
const COMES_BACK: f64 = 0.8;
/// Of each of two frames so much must show ground that the other sees.
const LEAST_SHARED: f64 = 0.12;
/// Points along a side of a frame.
const SIDE: usize = 9;
/// Lengths on the ground show longer or shorter by up to this factor in the other frame.
const MOST_SCALE: f64 = 3.0;

/// Frames over level ground.
#[derive(Clone, Copy, Debug)]
pub struct Sight<'a> {
    pub camera: &'a Camera,
    pub poses: &'a [Pose],
    pub ground_m: f64,
}

impl Sight<'_> {
    /// Share of a frame whose ground another sees at a like scale.
    pub fn shared(&self, a: usize, b: usize) -> f64 {
        let (from, to) = (&self.poses[a], &self.poses[b]);
        let [width, height] = self.camera.size_px;
        let mut seen = 0;
        for i in 0..SIDE * SIDE {
            let at = |k: usize, size: f64| (k as f64 + 0.5) / SIDE as f64 * size;
            let Some(ray) = self.camera.ray([at(i % SIDE, width), at(i / SIDE, height)]) else { continue };
            let ray = from.rotation.transpose() * Vector3::from(ray);
            if ray.z >= 0.0 || from.centre.z <= self.ground_m {
                continue;
            }
            let away = (self.ground_m - from.centre.z) / ray.z;
            let ground = from.centre + ray * away;
            let in_other = to.rotation * (ground - to.centre);
            let Some([x, y]) = self.camera.project(in_other.into()) else { continue };
            let scale = in_other.norm() / away.max(f64::MIN_POSITIVE);
            let inside = (0.0..width).contains(&x) && (0.0..height).contains(&y);
            if inside && (1.0 / MOST_SCALE..MOST_SCALE).contains(&scale) {
                seen += 1;
            }
        }
        f64::from(seen) / (SIDE * SIDE) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::YawPitchRoll;

    /// Two lines of five, 400 m apart, flown to and fro, then one back again in the same direction as the second.
    fn block(turned: bool) -> Vec<Station> {
        let place = |i: usize| {
            let (line, k) = (i / 5, (i % 5) as f64);
            let x = if line == 0 { 200.0 * k } else { 800.0 - 200.0 * k };
            Station {
                place_m: Some([x + 7.0 * (i as f64 * 1.7).sin(), 400.0 * line as f64 + 7.0 * (i as f64 * 2.9).cos()]),
                azimuth_rad: turned.then_some(if line == 0 { 1.5 } else { 4.7 } + 0.1 * (i as f64).sin()),
                line: None,
            }
        };
        (0..15).map(place).collect()
    }

    fn frames(lines: &[Line]) -> Vec<Vec<usize>> {
        lines.iter().map(|l| l.frames.clone()).collect()
    }

    #[test]
    fn lines_end_where_direction_or_way_turn() {
        let truth: Vec<Vec<usize>> = (0..3).map(|l| (5 * l..5 * l + 5).collect()).collect();
        for turned in [false, true] {
            assert_eq!(frames(&lines(&block(turned), 10.0)), truth, "{turned}");
        }
        let straight: Vec<Station> = (0..9)
            .map(|i| Station {
                place_m: Some([500.0 * i as f64, 180.0 * (i as f64 * 2.3).sin()]),
                ..Station::default()
            })
            .collect();
        assert_eq!(lines(&straight, 200.0).len(), 1, "errors of the table end no line");
        // The first way is 12° off to the left, the next step 21° to the right.
        let bent = [[0.0, 0.0], [1800.0, 380.0], [3500.0, -280.0], [5300.0, 40.0], [7100.0, 0.0]];
        let bent = bent.map(|place| Station { place_m: Some(place), ..Station::default() });
        assert_eq!(lines(&bent, 200.0).len(), 1, "nor do those of two frames' way");
        assert_eq!(lines(&vec![Station::default(); 4], 200.0).len(), 1, "nothing is known");
        let mut named = block(true);
        named.iter_mut().enumerate().for_each(|(i, s)| s.line = Some(["S36a", "S36b"][i % 2].into()));
        assert_eq!(
            frames(&lines(&named, 10.0)),
            [(0..15).step_by(2).collect::<Vec<_>>(), (1..15).step_by(2).collect()]
        );
    }

    #[test]
    fn frames_of_other_lines_are_compared_where_they_see_the_same_ground() {
        let camera = Camera::pinhole("c", [1000.0; 2], 1000.0, [500.0; 2]);
        let stations = block(true);
        let angles = YawPitchRoll { yaw_deg: 0.0, pitch_deg: -90.0, roll_deg: 0.0 };
        let poses: Vec<Pose> = stations
            .iter()
            .map(|s| s.place_m.expect("given"))
            .map(|[x, y]| Pose::looking(Vector3::new(x, y, 620.0), angles))
            .collect();
        let found = lines(&stations, 10.0);
        let sight = Sight { camera: &camera, poses: &poses, ground_m: 20.0 };
        // 600 m wide: a third is shared with the line beside, nothing with the one after.
        assert!((sight.shared(0, 9) - 1.0 / 3.0).abs() < 0.06, "{}", sight.shared(0, 9));
        assert_eq!(sight.shared(0, 10), 0.0);
        let pairs = pairs(&stations, &found, (2, 3), Some(sight));
        for (a, b) in [(0, 1), (0, 2), (0, 9), (2, 7), (5, 10)] {
            assert!(pairs.contains(&(a, b)), "{a}, {b}");
        }
        for (a, b) in [(0, 3), (4, 8), (0, 14), (2, 12)] {
            assert!(!pairs.contains(&(a, b)), "{a}, {b}");
        }
        assert!(pairs.is_sorted());
    }

    /// A turn that the table's errors hide ends no line; its frames are compared across it all the same.
    #[test]
    fn a_line_that_comes_back_is_compared_with_itself() {
        let place = |i: usize| match i {
            0..8 => [28.0 * i as f64, 0.0],
            _ => [28.0 * (15 - i) as f64, 40.0],
        };
        let stations: Vec<Station> =
            (0..16).map(|i| Station { place_m: Some(place(i)), ..Station::default() }).collect();
        let found = lines(&stations, 40.0);
        assert_eq!(found.len(), 1);
        let compared = pairs(&stations, &found, (3, 4), None);
        for (a, b) in [(0, 15), (2, 13), (1, 15)] {
            assert!(compared.contains(&(a, b)), "{a}, {b}");
        }
        assert!(!compared.contains(&(0, 9)));
        let straight: Vec<Station> =
            (0..12).map(|i| Station { place_m: Some([28.0 * f64::from(i), 0.0]), ..Station::default() }).collect();
        let compared = pairs(&straight, &lines(&straight, 40.0), (3, 4), None);
        assert!(compared.iter().all(|(a, b)| b - a <= 3), "{compared:?}");
    }

    #[test]
    fn azimuths_are_of_the_view_or_of_the_upper_side() {
        for (pitch_deg, yaw_deg) in [(-20.0, 75.0f64), (-90.0, 200.0)] {
            let pose = Pose::looking(Vector3::zeros(), YawPitchRoll { yaw_deg, pitch_deg, roll_deg: 0.0 });
            let off = (azimuth_rad(&pose) - yaw_deg.to_radians()).rem_euclid(TAU);
            assert!(off.min(TAU - off) < 1e-9, "{pitch_deg}: {off}");
        }
    }
}
