//! The self-taught second pass: what was found teaches a profile, and the image is scanned again with it.

use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::detector::Detector;
use crate::learn::{DEFAULT_REACH_PX, learn};
use crate::pipeline::georeference::{Job, Orientation, Outcome, Run, match_and_orient, orient_again};
use crate::pipeline::{MarkDetector, scan};
use crate::profile::Profile;
use crate::segment::label::Labeller;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::mask::Mask;
use autoref_raster::window::Window;
use autoref_raster::{Patch, RasterSource, read_patch};

/// Most marks that teach.
const MOST_TEACHERS: usize = 12;
/// After a refusal nobody knows whether marks have taught or ground. Marks are like their teachers and score best;
/// ground gives thousands of candidates, and to refuse them would take minutes. So many of the strongest are matched,
/// or so many for each point, and no more than so many.
const MOST_LEARNED: usize = 200;
const MOST_LEARNED_EACH: usize = 2;
const MOST_LEARNED_OF_LONG_LIST: usize = 600;
/// A partial match that chance produces more often (log₁₀) teaches what chance joined; the strongest candidates teach.
const MOST_BY_CHANCE_LOG10: f64 = 2.0;

/// What the second pass did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SecondPass {
    /// "matched marks", "best partial match" or "strongest candidates".
    pub taught_by: String,
    pub marks: u64,
    pub mean_srgb: [f64; 3],
    /// Smallest and largest side that is looked for, pixels.
    pub side_px: [f64; 2],
    pub candidates_before: usize,
    pub candidates_after: usize,
    /// GCPs matched; 0 when refused.
    pub matched_before: usize,
    pub matched_after: usize,
    /// Whether the result is that of the second pass.
    pub adopted: bool,
    /// Where was looked again.
    #[serde(default)]
    pub looked: Looked,
}

/// Where the second pass looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Looked {
    /// In the windows where unmatched points must be.
    Windows,
    /// In the whole image.
    #[default]
    Image,
}

impl SecondPass {
    /// What is known before it looks again: nothing has changed yet.
    fn of(first: &Run, taught_by: &str, profile: &Profile, looked: Looked) -> SecondPass {
        let learned = profile.learned.as_ref();
        let (candidates, matched) = (first.scan.candidates.len(), matched(first));
        SecondPass {
            taught_by: taught_by.to_owned(),
            marks: learned.map_or(0, |l| l.marks),
            mean_srgb: learned.map_or([0.0; 3], |l| l.mean_srgb),
            side_px: [profile.size.min_px.unwrap_or(0.0), profile.size.max_px.unwrap_or(0.0)],
            candidates_before: candidates,
            candidates_after: candidates,
            matched_before: matched,
            matched_after: matched,
            adopted: false,
            looked,
        }
    }

    /// One line for the summary.
    pub fn line(&self) -> String {
        let [r, g, b] = self.mean_srgb.map(|v| (v * 255.0).round());
        format!(
            "profile from {} {}: colour {r} {g} {b}, {:.1} to {:.1} px; {} again: candidates {} → {}, matched {} → {}; {}",
            self.marks,
            self.taught_by,
            self.side_px[0],
            self.side_px[1],
            match self.looked {
                Looked::Windows => "windows",
                Looked::Image => "image",
            },
            self.candidates_before,
            self.candidates_after,
            self.matched_before,
            self.matched_after,
            if self.adopted { "taken" } else { "the first pass stands" }
        )
    }
}

/// Teaches a profile by what the first pass found and runs the job again with it; the better run comes back. A second
/// run that solves a refused job, or finds more GCPs, is better. `None` with the first run when nothing can be learned.
///
/// # Errors
/// When the raster cannot be read.
pub fn second_pass(job: &Job<'_>, first: Run) -> Result<(Run, Option<SecondPass>)> {
    job.progress.stage("learning the marks' colours");
    let (taught_by, positions) = teachers(&first);
    let Some(profile) = taught(job, &positions)? else { return Ok((first, None)) };
    let Ok(detector) = MarkDetector::new(profile.clone(), job.source.info(), None) else { return Ok((first, None)) };
    let relaxed = detector.relaxed();
    if matches!(first.outcome, Outcome::Refused(_)) && is_of_ground(job.source, detector.as_detector())? {
        tracing::info!("the strongest candidates have the colour of the ground: they teach nothing");
        return Ok((first, None));
    }
    // The plan's halo was made for the first profile; a taught one has no filters and needs none.
    job.progress.pass("second pass, with the colours learned");
    let job = Job { detector: detector.as_detector(), refiner: relaxed.as_detector(), ..*job };
    let mut seen = scan(job.source, job.plan, job.detector, job.progress)?;
    let candidates_after = seen.candidates.len();
    if matches!(first.outcome, Outcome::Refused(_)) {
        keep_strongest(&mut seen.candidates, job.gcps.len());
    }
    let second = match_and_orient(&job, seen)?;
    let (before, after) = (matched(&first), matched(&second));
    let adopted = after > before;
    let report = SecondPass {
        candidates_after,
        matched_after: after,
        adopted,
        ..SecondPass::of(&first, taught_by, &profile, Looked::Image)
    };
    Ok((if adopted { second } else { first }, Some(report)))
}

/// Patterns with as many expected false alarms as this (log₁₀), or more, are weak.
const WEAK_LOG10: f64 = -5.0;

/// Looks again where it can help: in the windows of points that must be in the image and are not matched, with a
/// profile taught by those that are; and by a whole second pass where the pattern is weak. `None` with the run as it
/// was where nothing is missing.
///
/// # Errors
/// When the raster cannot be read.
pub fn look_closer(job: &Job<'_>, first: Run) -> Result<(Run, Option<SecondPass>)> {
    let Outcome::Solved(orientation) = &first.outcome else { return Ok((first, None)) };
    if orientation.evidence.pattern.log10_false_alarms > WEAK_LOG10 {
        return second_pass(job, first);
    }
    if orientation.not_found.is_empty() {
        return Ok((first, None));
    }
    let (taught_by, positions) = teachers(&first);
    let Some(profile) = taught(job, &positions)? else { return Ok((first, None)) };
    let Ok(detector) = MarkDetector::new(profile.clone(), job.source.info(), None) else { return Ok((first, None)) };
    let relaxed = detector.relaxed();
    let outcome = orient_again(job, &first.scan.candidates, orientation.evidence.clone(), relaxed.as_detector())?;
    let second = Run { outcome, ..first.clone() };
    let after = matched(&second);
    // What left the fit would come back with the first mark that is found.
    let adopted = after > matched(&first) + left_the_fit(orientation);
    let report =
        SecondPass { matched_after: after, adopted, ..SecondPass::of(&first, taught_by, &profile, Looked::Windows) };
    Ok((if adopted { second } else { first }, Some(report)))
}

/// Marks of the pattern that stood beside their points.
fn left_the_fit(orientation: &Orientation) -> usize {
    let is_gone = |gcp: usize| !orientation.marks.iter().any(|mark| mark.gcp == gcp);
    orientation.evidence.pattern.pairs.iter().filter(|pair| is_gone(pair.1)).count()
}

/// Leaves the candidates of the best scores that are worth matching to so many points after a refusal, in their order.
pub(super) fn keep_strongest(candidates: &mut Vec<Candidate>, points: usize) {
    let most = (MOST_LEARNED_EACH * points).clamp(MOST_LEARNED, MOST_LEARNED_OF_LONG_LIST);
    if candidates.len() <= most {
        return;
    }
    let score = |c: &Candidate| c.score.unwrap_or(f64::NEG_INFINITY);
    let mut scores: Vec<f64> = candidates.iter().map(score).collect();
    scores.sort_by(|a, b| b.total_cmp(a));
    let least = scores[most - 1];
    let mut equals = most - scores.partition_point(|s| *s > least);
    candidates.retain(|c| {
        let equal = score(c) == least && equals > 0;
        equals -= usize::from(equal);
        equal || score(c) > least
    });
}

/// Whether what a detector takes for paint lies everywhere, as ground does that has taught it: in windows that are
/// spread over the image its regions of a mark's size and shape are so dense that to examine them all would take
/// minutes, and marks among them would hardly be told.
fn is_of_ground(source: &dyn RasterSource, detector: &dyn Detector) -> Result<bool> {
    /// Each in rows of its own, from the top down, so that no reader goes back.
    const WINDOWS: u64 = 16;
    const SIDE_PX: u64 = 512;
    /// Neighbouring windows lie far apart: 7 has no divisor in common with their number.
    const STEP: u64 = 7;
    /// Fields of a thousand pumpkins have some hundreds.
    const DENSE_PER_MPX: f64 = 1_000.0;
    /// So many are examined in some seconds, however dense.
    const FEW: f64 = 3_000.0;
    let bounds = source.info().bounds();
    let halo_px = detector.halo_px();
    let (mut regions, mut seen_px) = (0usize, 0u64);
    for i in 0..WINDOWS {
        let band = Window::new(0, i * bounds.height / WINDOWS, bounds.width, (bounds.height / WINDOWS).max(1));
        let width = SIDE_PX.min(bounds.width);
        let height = SIDE_PX.min(band.height.saturating_sub(2 * halo_px).max(1));
        let x = (bounds.width - width) * (i * STEP % WINDOWS) / (WINDOWS - 1);
        let core = Window::new(x, band.y + (band.height - height) / 2, width, height);
        let read = core.grown(halo_px, &bounds);
        let block = source.read(read)?;
        let mut mask = Mask::new(read);
        detector.segment(&block, &mut mask);
        regions += Labeller::new().label(&mask, core, bounds, |region| detector.gate(region)).finished.len();
        seen_px += core.area();
    }
    let dense = regions as f64 / (seen_px as f64 / 1e6);
    let all = regions as f64 * bounds.area() as f64 / seen_px as f64;
    Ok(dense > DENSE_PER_MPX && all > FEW)
}

fn matched(run: &Run) -> usize {
    match &run.outcome {
        Outcome::Solved(orientation) => orientation.marks.len() + orientation.check_marks.len(),
        Outcome::Refused(_) => 0,
    }
}

/// The marks that are believed most.
fn teachers(run: &Run) -> (&'static str, Vec<PixelPoint>) {
    let candidates = &run.scan.candidates;
    match &run.outcome {
        Outcome::Solved(orientation) => ("matched marks", strongest(orientation.marks.iter().map(|found| &found.mark))),
        Outcome::Refused(evidence) => match &evidence.best {
            Some(best) if best.pairs.len() >= 3 && best.log10_false_alarms <= MOST_BY_CHANCE_LOG10 => {
                ("marks of the best partial match", strongest(best.pairs.iter().map(|pair| &candidates[pair.0])))
            }
            _ => ("of the strongest candidates", strongest(candidates.iter())),
        },
    }
}

pub(super) fn strongest<'a>(marks: impl Iterator<Item = &'a Candidate>) -> Vec<PixelPoint> {
    let mut marks: Vec<&Candidate> = marks.collect();
    let score = |c: &Candidate| c.score.unwrap_or(f64::NEG_INFINITY);
    marks.sort_by(|a, b| score(b).total_cmp(&score(a)));
    marks.iter().take(MOST_TEACHERS).map(|c| c.centre).collect()
}

/// A profile of those positions that stand out enough to teach, with the rules that the user gave; `None` when none
/// does.
pub(super) fn taught(job: &Job<'_>, positions: &[PixelPoint]) -> Result<Option<Profile>> {
    /// No mark that nobody pointed at scores less (four less where a point must be): bare ground beside a speck does.
    const LEAST_SCORE: f64 = -12.0;
    let bounds = job.source.info().bounds();
    let mut marks: Vec<(Patch, PixelPoint)> = Vec::new();
    for &at in positions {
        let (x, y) = (at.x.max(0.0) as u64, at.y.max(0.0) as u64);
        if !bounds.contains(x, y) {
            continue;
        }
        let window = Window::new(x, y, 1, 1).grown(DEFAULT_REACH_PX, &bounds);
        let mark = (read_patch(job.source, window)?, at);
        if learn("second pass", std::slice::from_ref(&mark)).is_ok() {
            marks.push(mark);
        }
    }
    let mut taught = learn("second pass", &marks).ok().map(|profile| job.asked.ruled(profile));
    if let Some(profile) = &mut taught {
        profile.examine.min_score = profile.examine.min_score.max(LEAST_SCORE);
    }
    Ok(taught)
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::memory::MemorySource;

    /// Squares of 6 px of the default paint on grey, so far apart.
    fn painted(apart: u64) -> MemorySource {
        const SIDE: u64 = 1600;
        let pixel = |i: u64| {
            let is_paint = (i % SIDE) % apart < 6 && (i / SIDE) % apart < 6;
            if is_paint { [255, 110, 0] } else { [90, 92, 88] }
        };
        MemorySource::rgb8(SIDE, SIDE, (0..SIDE * SIDE).flat_map(pixel).collect())
    }

    #[test]
    fn a_colour_that_lies_everywhere_is_that_of_the_ground() {
        for (apart, is_ground) in [(14, true), (60, false)] {
            let source = painted(apart);
            let profile = Profile::load("orange").expect("it ships");
            let detector = MarkDetector::new(profile, source.info(), None).expect("valid");
            assert_eq!(is_of_ground(&source, detector.as_detector()).expect("readable"), is_ground, "{apart}");
        }
    }

    #[test]
    fn the_strongest_stay_in_their_order() {
        let candidate = |score: f64| Candidate { score: Some(score), ..Candidate::at(PixelPoint { x: score, y: 0.0 }) };
        // 0, 1, …, 6, 0, 1, … : ties at the cut, early and late.
        let mut all: Vec<Candidate> = (0..700).map(|i| candidate(f64::from(i % 7))).collect();
        keep_strongest(&mut all, 150);
        assert_eq!(all.len(), 300);
        assert_eq!(all.iter().filter(|c| c.score == Some(5.0)).count(), 100);
        assert_eq!((all[0].score, all[1].score, all[2].score), (Some(4.0), Some(5.0), Some(6.0)));
        let before = all.clone();
        keep_strongest(&mut all, 1000);
        assert_eq!(all, before);
    }
}
