//! Which peak is which mark, and how the frame lies in the scan.
//!
//! A handful of marks with a few peaks each need no pattern index: every pair of peaks of two marks gives a pose, and
//! the pose that most marks agree with, best scores first, is taken. The frame's turn is a matter of its own: side and
//! corner marks lie nearly symmetrically, and only how far a camera's calibrated positions are from symmetric tells its
//! turns apart.

use super::interior::{Pose, SURE_STRETCH, Stretch, distance, fit_own_stretch, fit_pose, fit_stretched, refit, rms_px};
use super::search::Peak;
use autoref_raster::coords::{Handedness, PixelPoint};

/// How far a peak may lie from where two others put the mark, millimetres: the coarse pictures' error, stretched.
const REACH_MM: f64 = 0.4;
/// Largest deviation of scale (relative) and turn (degrees) from what is assumed.
const SCALE: f64 = 0.15;
const TURN_DEG: f64 = 7.0;

/// A pose and the peaks that agree with it.
#[derive(Clone, Debug)]
pub struct Assembly {
    pub pose: Pose,
    /// Index of each mark's peak.
    pub chosen: Vec<Option<usize>>,
    /// Sum of the chosen peaks' scores, less for peaks that lie off.
    pub score: f64,
    /// The ways in which a frame may lie (turn, mirrored) that fit the scan as well as this one, which is the first.
    pub rivals: Vec<(f64, Handedness)>,
    /// How many assemblies as good as this one specks would make by chance.
    pub chance: f64,
}

impl Assembly {
    /// How many marks have a peak.
    pub fn marks(&self) -> usize {
        self.chosen.iter().flatten().count()
    }
}

/// Number of assemblies of as many marks that peaks as good as the chosen ones, strewn over their boxes, would make by
/// chance: as many tries as the boxes have such peaks, and for each the share of its box in which the marks that do not
/// determine the pose would be taken for right (D. Lowe, "Three-dimensional object recognition from single
/// two-dimensional images", Artificial Intelligence, 1987, counts alike). `ways` is how many ways of lying were open,
/// `half_px` half the side of a box, `stated` how far the axes differ in scale by the scan's file.
pub fn chance(assembly: &Assembly, peaks: &[Vec<Peak>], half_px: f64, ways: usize, stated: Stretch) -> f64 {
    let tries: f64 = assembly
        .chosen
        .iter()
        .enumerate()
        .filter_map(|(k, c)| {
            let score = peaks[k][(*c)?].score - AS_GOOD_SCORE;
            Some(peaks[k].iter().filter(|p| p.score >= score).count() as f64)
        })
        .product();
    let unit = assembly.pose.px_per_mm();
    let within = std::f64::consts::PI * (REACH_MM * unit / (2.0 * half_px)).powi(2);
    let free = assembly.marks() as i32 - 2;
    let is_free = (assembly.pose.stretch.0 - stated.0).abs() > SURE_STRETCH;
    let checks = if assembly.pose.stretch == Stretch::NONE || !is_free {
        within.powi(free)
    } else {
        // The third mark lies in a strip that shear narrows and stretch does not.
        let strip = (REACH_MM * unit / half_px) * (0.5 * STRETCHED_MM * unit / half_px).min(1.0);
        strip * within.powi(free - 1)
    };
    ways as f64 * tries * checks
}

/// Correlations that differ by less tell no mark from a speck.
const AS_GOOD_SCORE: f64 = 0.03;
/// How far the largest stretch moves a mark against the others, of a frame 23 cm wide.
const STRETCHED_MM: f64 = 12.0;

/// The best assembly of `peaks` (one list per mark) about the pose `assumed`.
pub fn assemble(film: &[[f64; 2]], peaks: &[Vec<Peak>], assumed: &Pose) -> Option<Assembly> {
    let mut best: Option<Assembly> = None;
    for a in 0..film.len() {
        for b in a + 1..film.len() {
            for p in &peaks[a] {
                for q in &peaks[b] {
                    let two = [(film[a], p.centre), (film[b], q.centre)];
                    let Some(pose) = fit_stretched(&two, assumed.mirrored, assumed.stretch) else { continue };
                    if !is_near(&pose, assumed) {
                        continue;
                    }
                    let assembly = gather(film, peaks, pose);
                    if best.as_ref().is_none_or(|b| assembly.score > b.score) {
                        best = Some(assembly);
                    }
                }
            }
        }
    }
    best
}

/// As [`assemble`] for scans whose axes differ in scale: three peaks give a pose with its stretch. At least four marks
/// agree: three check nothing then.
pub fn assemble_stretched(film: &[[f64; 2]], peaks: &[Vec<Peak>], assumed: &Pose) -> Option<Assembly> {
    let mut triples = vec![];
    for a in 0..film.len() {
        for b in a + 1..film.len() {
            for c in b + 1..film.len() {
                let area = (film[b][0] - film[a][0]) * (film[c][1] - film[a][1])
                    - (film[c][0] - film[a][0]) * (film[b][1] - film[a][1]);
                triples.push((area.abs(), [a, b, c]));
            }
        }
    }
    triples.sort_by(|a, b| b.0.total_cmp(&a.0));
    let most = if film.len() > 4 { PEAKS_OF_MANY } else { usize::MAX };
    let mut best: Option<Assembly> = None;
    for (_, [a, b, c]) in triples.into_iter().take(TRIPLES) {
        for p in peaks[a].iter().take(most) {
            for q in peaks[b].iter().take(most) {
                // Two places that no frame has are left before a third is tried.
                let two = fit_pose(&[(film[a], p.centre), (film[b], q.centre)], assumed.mirrored);
                if two.is_none_or(|pose| !is_near(&pose, assumed)) {
                    continue;
                }
                for r in peaks[c].iter().take(most) {
                    let points = [(film[a], p.centre), (film[b], q.centre), (film[c], r.centre)];
                    let Some(pose) = fit_own_stretch(&points, assumed.mirrored).filter(|p| is_near(p, assumed)) else {
                        continue;
                    };
                    let assembly = gather(film, peaks, pose);
                    if best.as_ref().is_none_or(|b| assembly.score > b.score) {
                        best = Some(assembly);
                    }
                }
            }
        }
    }
    best.filter(|b| b.marks() >= 4)
}

/// Triples of marks tried, those that span most first, and peaks of each where a camera has more than four marks.
const TRIPLES: usize = 8;
const PEAKS_OF_MANY: usize = 6;

fn is_near(pose: &Pose, assumed: &Pose) -> bool {
    let scale = pose.px_per_mm() / assumed.px_per_mm();
    let turn = (pose.turn_deg() - assumed.turn_deg() + 540.0).rem_euclid(360.0) - 180.0;
    (scale - 1.0).abs() < SCALE && turn.abs() < TURN_DEG
}

fn gather(film: &[[f64; 2]], peaks: &[Vec<Peak>], pose: Pose) -> Assembly {
    let reach = REACH_MM * pose.px_per_mm();
    let value = |peak: &Peak, at: PixelPoint| {
        let d = distance(peak.centre, at) / reach;
        peak.score * (1.0 - 0.5 * d * d)
    };
    let mut score = 0.0;
    let mut chosen = vec![None; film.len()];
    for (k, mm) in film.iter().enumerate() {
        let at = pose.apply(*mm);
        let near = peaks[k].iter().enumerate().filter(|(_, p)| distance(p.centre, at) < reach);
        if let Some((i, peak)) = near.max_by(|x, y| value(x.1, at).total_cmp(&value(y.1, at))) {
            chosen[k] = Some(i);
            score += value(peak, at);
        }
    }
    let points: Vec<_> =
        chosen.iter().enumerate().filter_map(|(k, c)| Some((film[k], peaks[k][(*c)?].centre))).collect();
    let pose = if pose.stretch == Stretch::NONE { fit_pose(&points, pose.mirrored) } else { refit(&points, &pose) }
        .unwrap_or(pose);
    Assembly { pose, chosen, score, rivals: vec![], chance: 0.0 }
}

/// One way of naming the marks that were found.
#[derive(Clone, Debug, PartialEq)]
pub struct Naming {
    pub turn_deg: f64,
    pub mirrored: Handedness,
    /// For every place found: which of the camera's marks it is.
    pub names: Vec<usize>,
    /// How badly the calibrated positions fit, pixels.
    pub rms_px: f64,
    /// They only fit without the worst of four or more marks.
    pub leaves_out: bool,
}

/// Every naming of `places` (found under the naming `now`, film index by film index) that turning the frame by quarters
/// and mirroring it allows, best first, those that no mark contradicts before the others: in a wrong way round three of
/// four fit easily. `same` says whether two marks look alike.
pub fn namings(
    film: &[[f64; 2]],
    centre: [f64; 2],
    places: &[(usize, PixelPoint)],
    now: &Pose,
    allowed: &[(f64, Handedness)],
    same: impl Fn(usize, usize) -> bool,
) -> Vec<Naming> {
    let middle = now.apply(centre);
    let mut all = vec![];
    for &(turn_deg, mirrored) in allowed {
        // The found frame's own small turn is kept: what changes are quarters.
        let small = now.turn_deg() - 90.0 * (now.turn_deg() / 90.0).round();
        let pose = Pose::about(centre, middle, now.px_per_mm(), turn_deg + small, mirrored);
        let nearest = |p: &PixelPoint| {
            (0..film.len())
                .min_by(|&a, &b| distance(pose.apply(film[a]), *p).total_cmp(&distance(pose.apply(film[b]), *p)))
        };
        let names: Vec<usize> = places.iter().filter_map(|(_, p)| nearest(p)).collect();
        let mut seen = names.clone();
        seen.sort_unstable();
        seen.dedup();
        let fits = seen.len() == places.len() && names.iter().zip(places).all(|(n, (k, _))| same(*n, *k));
        if !fits {
            continue;
        }
        let points: Vec<_> = names.iter().zip(places).map(|(n, (_, p))| (film[*n], *p)).collect();
        if let Some((rms_px, leaves_out)) = robust_rms(&points, mirrored, now.stretch) {
            all.push(Naming { turn_deg, mirrored, names, rms_px, leaves_out });
        }
    }
    all.sort_by(|a, b| a.leaves_out.cmp(&b.leaves_out).then(a.rms_px.total_cmp(&b.rms_px)));
    all
}

/// Marks that fit worse than this contain a wrong one, pixels.
const ONE_WRONG_PX: f64 = 2.5;

/// And whether the worst is left out.
fn robust_rms(points: &[([f64; 2], PixelPoint)], mirrored: Handedness, stretch: Stretch) -> Option<(f64, bool)> {
    // Where the axes differ in scale, each way round has a right to its own difference.
    let own = || fit_own_stretch(points, mirrored).filter(|_| points.len() >= 4);
    let stretched = if stretch == Stretch::NONE { None } else { own() };
    let stretch = stretched.map_or(stretch, |p| p.stretch);
    let whole = rms_px(&fit_stretched(points, mirrored, stretch)?, points);
    if points.len() < 4 || whole < ONE_WRONG_PX {
        return Some((whole, false));
    }
    let without = (0..points.len()).filter_map(|k| {
        let others = [&points[..k], &points[k + 1..]].concat();
        Some(rms_px(&fit_stretched(&others, mirrored, stretch)?, &others))
    });
    Some((without.min_by(f64::total_cmp)?, true))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::load_camera;

    /// Specks lie where two marks put the others if the axes are taken for alike.
    #[test]
    fn marks_of_a_scan_with_stated_axes_are_told_from_specks_that_fit_without() {
        let film = [[27.0, -27.0], [-27.0, -27.1], [-27.0, 27.0], [27.1, 27.0]];
        let middle = PixelPoint { x: 1100.0, y: 1100.0 };
        let even = Pose::about([0.0, 0.0], middle, 33.0, 0.3, Handedness::AsIs);
        let stated = even.stretched([0.0, 0.0], Stretch(0.02));
        let two = [0, 1].map(|k| (film[k], stated.apply(film[k])));
        let alike = fit_pose(&two, Handedness::AsIs).expect("two places");
        let peaks: Vec<Vec<Peak>> = (0..4)
            .map(|k| {
                let mark = Peak { centre: stated.apply(film[k]), score: 0.9 };
                let speck = Peak { centre: alike.apply(film[k]), score: 0.8 };
                if k < 2 { vec![mark] } else { vec![mark, speck] }
            })
            .collect();
        let chosen = |assumed: &Pose| assemble(&film, &peaks, assumed).expect("some fit").chosen;
        assert_eq!(chosen(&stated), [Some(0); 4]);
        assert_eq!(chosen(&even), [Some(0), Some(0), Some(1), Some(1)], "the case that this is about");
    }

    /// Places of a made frame turned by 270°, as they were measured. Turned by 180° three of its marks fit nearly as
    /// well as all four do in truth, and the fourth not at all.
    #[test]
    fn names_that_a_mark_contradicts_come_after_those_that_fit_all() {
        let camera = load_camera("svalbard-zeiss-1936").expect("built in");
        let film = camera.film_points();
        let at = |x: f64, y: f64| PixelPoint { x, y };
        let top_bottom_right_left =
            [at(355.758, 4526.718), at(9171.843, 4612.629), at(4794.409, 176.687), at(4712.540, 8977.922)];
        let places: Vec<(usize, PixelPoint)> = top_bottom_right_left.into_iter().enumerate().collect();
        let points: Vec<_> = places.iter().map(|(k, p)| (film[*k], *p)).collect();
        let now = fit_pose(&points, Handedness::AsIs).expect("four places");
        let allowed = [0.0, 180.0, 90.0, 270.0].map(|turn| (turn, Handedness::AsIs));
        let all = namings(&film, camera.film_centre(), &places, &now, &allowed, |_, _| true);
        let (best, others) = all.split_first().expect("every turn names all four");
        assert!(!best.leaves_out && best.turn_deg == 270.0 && best.names == [0, 1, 2, 3], "{best:?}");
        assert!(others.len() == 3 && others.iter().all(|n| n.leaves_out), "{others:?}");
        assert!(others[0].rms_px < best.rms_px + 1.5, "the case that this is about: {others:?}");
    }
}
