//! Does a frame fit its roll? One camera and one scanner make the frames of a roll alike: size of a pixel, distances
//! between marks, how the frame lies in the scan. What differs from the others' median by far more than they differ
//! among themselves is another camera's frame, a frame laid down the wrong way, or a wrong find that agrees with
//! itself.
//!
//! Median and median absolute deviation after F. R. Hampel, "The influence curve and its role in robust estimation",
//! Journal of the American Statistical Association, 1974. A frame only ever loses by this: nothing doubtful becomes
//! good.

use super::interior::distance;
use super::types::{Camera, FrameResult, FrameStatus, MarkStatus};
use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_raster::ranks::median;

/// Fewer solved frames than this say nothing of each other.
const LEAST_FRAMES: usize = 5;
/// Share of the frames that must lie the same way for the others to be taken for wrong.
const MAJORITY: f64 = 2.0 / 3.0;
/// Standard deviations, by the median absolute deviation, that a frame may differ by.
const FAR: f64 = 6.0;
/// Differences below these are no reason to look, however alike the others are: a share of a length (film shrinks by a
/// tenth of a per cent), and millimetres on the film for its place in the scan.
const LEAST_SHARE: f64 = 0.003;
const LEAST_MM: f64 = 2.0;

/// What is compared of one frame; a few numbers, so that a roll of any length fits in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Facts {
    pixel_um: f64,
    /// Turn of the frame in the scan, quarters, and whether it is mirrored.
    quarters: u8,
    mirrored: Handedness,
    /// Distances between the marks that were found, pixels: two indices of the camera's marks and the length.
    lengths_px: Vec<(usize, usize, f64)>,
    /// Middle of the camera's marks from the middle of the scan, in the scan's axes, millimetres.
    offset_mm: [f64; 2],
    size_px: [u64; 2],
}

impl Facts {
    /// `None` for a frame without interior orientation.
    pub fn of(camera: &Camera, frame: &FrameResult) -> Option<Facts> {
        let interior = frame.interior.as_ref()?;
        let found: Vec<(usize, PixelPoint)> = camera
            .marks
            .iter()
            .enumerate()
            .filter(|(_, m)| interior.marks.contains(&m.name))
            .filter_map(|(k, m)| Some((k, frame.marks.iter().find(|f| f.mark == m.name)?.centre?)))
            .collect();
        let mut lengths_px = vec![];
        for (n, (a, p)) in found.iter().enumerate() {
            lengths_px.extend(found[n + 1..].iter().map(|(b, q)| (*a, *b, distance(*p, *q))));
        }
        let [x, y] = camera.film_centre();
        let middle = interior.to_pixel([x, camera.y_sign() * y])?;
        let mm = interior.pixel_um / 1e3;
        Some(Facts {
            pixel_um: interior.pixel_um,
            quarters: (interior.rotation_deg / 90.0).round().rem_euclid(4.0) as u8,
            mirrored: interior.mirrored,
            lengths_px,
            offset_mm: [(middle.x - 0.5 * frame.width as f64) * mm, (middle.y - 0.5 * frame.height as f64) * mm],
            size_px: [frame.width, frame.height],
        })
    }
}

/// Middle and permitted deviation of a quantity; `None` for fewer than five values.
fn usual(values: Vec<f64>, least: impl Fn(f64) -> f64) -> Option<(f64, f64)> {
    if values.len() < LEAST_FRAMES {
        return None;
    }
    let middle = median(values.clone());
    let off: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
    Some((middle, (FAR * 1.4826 * median(off)).max(least(middle))))
}

/// For every frame of a roll, in how far it is unlike the others: reasons in plain words, none for most. `None` for
/// frames without interior orientation, which take no part.
pub fn unlike(camera: &Camera, roll: &[Option<Facts>]) -> Vec<Vec<String>> {
    let known: Vec<&Facts> = roll.iter().flatten().collect();
    let mut reasons: Vec<Vec<String>> = vec![vec![]; roll.len()];
    if known.len() < LEAST_FRAMES {
        return reasons;
    }
    let share = |middle: f64| LEAST_SHARE * middle;
    let pixel = usual(known.iter().map(|f| f.pixel_um).collect(), share);
    let lie = majority(known.iter().map(|f| (f.quarters, f.mirrored)));
    let mut lengths = vec![];
    for a in 0..camera.marks.len() {
        for b in a + 1..camera.marks.len() {
            let of = |f: &&Facts| f.lengths_px.iter().find(|l| (l.0, l.1) == (a, b)).map(|l| l.2);
            lengths.extend(usual(known.iter().filter_map(of).collect(), share).map(|u| ((a, b), u)));
        }
    }
    // Where a frame lies in its scan says something only when the scans are cut alike.
    let same_size = majority(known.iter().map(|f| f.size_px)).is_some();
    let offset = [0, 1].map(|d| usual(known.iter().map(|f| f.offset_mm[d]).collect(), |_| LEAST_MM));
    for (frame, reasons) in roll.iter().zip(&mut reasons) {
        let Some(f) = frame else { continue };
        let far = |value: f64, usual: (f64, f64)| (value - usual.0).abs() > usual.1;
        if let Some(u) = pixel.filter(|u| far(f.pixel_um, *u)) {
            reasons.push(format!("its pixels are {:.3} µm, those of the roll {:.3} µm", f.pixel_um, u.0));
        }
        if let Some((quarters, mirrored)) = lie.filter(|l| *l != (f.quarters, f.mirrored)) {
            let text = |q: u8, m: Handedness| {
                format!("turned by {}°{}", 90 * u32::from(q), if m.is_mirrored() { ", mirrored" } else { "" })
            };
            let (this, others) = (text(f.quarters, f.mirrored), text(quarters, mirrored));
            reasons.push(format!("it lies {this}, the roll {others}"));
        }
        let worst = f
            .lengths_px
            .iter()
            .filter_map(|(a, b, v)| Some((*a, *b, *v, lengths.iter().find(|l| l.0 == (*a, *b))?.1)))
            .filter(|(_, _, v, u)| far(*v, *u))
            .max_by(|x, y| ((x.2 - x.3.0).abs() / x.3.1).total_cmp(&((y.2 - y.3.0).abs() / y.3.1)));
        if let Some((a, b, v, (middle, _))) = worst {
            let (a, b) = (&camera.marks[a].name, &camera.marks[b].name);
            reasons.push(format!("from {a} to {b} are {v:.1} px, on the roll {middle:.1} px"));
        }
        if let [Some(x), Some(y)] = offset
            && same_size
            && (far(f.offset_mm[0], x) || far(f.offset_mm[1], y))
        {
            let (dx, dy) = (f.offset_mm[0] - x.0, f.offset_mm[1] - y.0);
            reasons.push(format!("it lies {dx:.1}, {dy:.1} mm from where the roll lies in the scans"));
        }
    }
    reasons
}

/// The value that more than two thirds share.
fn majority<T: PartialEq + Copy>(values: impl Iterator<Item = T>) -> Option<T> {
    let all: Vec<T> = values.collect();
    let count = |v: &T| all.iter().filter(|o| *o == v).count();
    all.iter().copied().find(|v| count(v) as f64 > MAJORITY * all.len() as f64)
}

/// The frame as its roll leaves it: good frames and marks become doubtful for `reasons`, doubtful and failed ones get
/// them too.
pub fn lowered(frame: &FrameResult, reasons: &[String]) -> FrameResult {
    let mut frame = frame.clone();
    let said: Vec<String> = reasons.iter().map(|r| format!("unlike its roll: {r}")).collect();
    match &mut frame.status {
        FrameStatus::Doubtful { reasons } | FrameStatus::Failed { reasons } => reasons.extend(said.iter().cloned()),
        FrameStatus::Ok => frame.status = FrameStatus::Doubtful { reasons: said.clone() },
    }
    for mark in frame.marks.iter_mut().filter(|m| m.status == MarkStatus::Ok) {
        mark.status = MarkStatus::Doubtful;
        mark.reason = Some("its frame is unlike its roll".to_owned());
    }
    frame
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load_camera;
    use Handedness::{AsIs, Mirrored};

    fn facts(pixel_um: f64, quarters: u8, mirrored: Handedness, offset_mm: [f64; 2], stretch_px: f64) -> Option<Facts> {
        let lengths_px = vec![(0, 1, 3500.0 * 50.0 / pixel_um + stretch_px), (1, 2, 2470.0 * 50.0 / pixel_um)];
        Some(Facts { pixel_um, quarters, mirrored, lengths_px, offset_mm, size_px: [3600, 3600] })
    }

    fn roll(odd: Option<Facts>) -> Vec<Option<Facts>> {
        let wobble = |k: usize| 1.0 + 1e-4 * (k as f64 * 2.4).sin();
        let mut all: Vec<_> = (0..8).map(|k| facts(50.0 * wobble(k), 0, AsIs, [0.1 * wobble(k), -0.2], 0.0)).collect();
        all.insert(3, odd);
        all
    }

    #[test]
    fn only_the_odd_frame_is_unlike_and_says_why() {
        let camera = load_camera("svalbard-zeiss-1936").expect("built in");
        let cases = [
            (facts(50.6, 0, AsIs, [0.1, -0.2], 0.0), "µm"),
            (facts(50.0, 2, AsIs, [0.1, -0.2], 0.0), "turned by 180°, the roll turned by 0°"),
            (facts(50.0, 0, Mirrored, [0.1, -0.2], 0.0), "mirrored"),
            (facts(50.0, 0, AsIs, [4.1, -0.2], 0.0), "4.0, 0.0 mm"),
            (facts(50.0, 0, AsIs, [0.1, -0.2], 15.0), "from TOP to BOTTOM are 3515.0 px"),
        ];
        for (odd, said) in cases {
            let reasons = unlike(&camera, &roll(odd));
            assert!(reasons[3].join("; ").contains(said), "{said}: {:?}", reasons[3]);
            assert!(reasons.iter().enumerate().all(|(k, r)| k == 3 || r.is_empty()), "{reasons:?}");
        }
        assert!(unlike(&camera, &roll(facts(50.02, 0, AsIs, [0.9, -0.2], 3.0))).iter().all(Vec::is_empty));
        assert!(unlike(&camera, &roll(None)).iter().all(Vec::is_empty));
    }

    #[test]
    fn four_frames_or_a_roll_turned_half_and_half_say_nothing() {
        let camera = load_camera("svalbard-zeiss-1936").expect("built in");
        let four: Vec<_> = (0..4).map(|k| facts(50.0 + f64::from(k), k as u8, AsIs, [0.0; 2], 0.0)).collect();
        assert!(unlike(&camera, &four).iter().all(Vec::is_empty));
        let half: Vec<_> = (0..10).map(|k| facts(50.0, 2 * (k % 2), AsIs, [0.0; 2], 0.0)).collect();
        assert!(unlike(&camera, &half).iter().all(Vec::is_empty));
    }
}
