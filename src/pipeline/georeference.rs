//! From an image and a list of GCPs to a solved orientation: scan, match, solve, look again, solve again.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::detector::Detector;
use crate::gcp::{Gcp, GcpRole};
use crate::matching::close_core::close_core;
use crate::matching::diagnosis::{Diagnosis, GrossErrors, KnownPlace};
use crate::matching::doubtful::{Ground, doubtful_far};
use crate::matching::field::Field;
use crate::matching::{Evidence, Labels, MatchOutcome, Matcher, Priors, RobustMatcher, Solved, TimeLimit};
use crate::pipeline::asked::Asked;
use crate::pipeline::beside::{Beside, Neighbourhood, chance_radius_px, density};
use crate::pipeline::{Progress, ScanOutcome, scan};
use crate::rematch::{Expected, Free, Refinement, is_inside, one_gcp_each, rematch};
use autoref_raster::RasterSource;
use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};
use autoref_raster::error::Result;
use autoref_raster::memory_plan::ScanPlan;
use autoref_solve::{Pair, Solution, solve_as};

/// Everything a run needs; the parts are values or hold no state that changes.
pub struct Job<'a> {
    pub source: &'a dyn RasterSource,
    pub plan: &'a ScanPlan,
    pub detector: &'a dyn Detector,
    /// For the refinement: may take less for granted.
    pub refiner: &'a dyn Detector,
    pub gcps: &'a [Gcp],
    pub matcher: &'a dyn Matcher,
    /// Tried in order until one solves: what is believed first, then less.
    pub priors: &'a [Priors],
    pub progress: &'a dyn Progress,
    pub refine: Refine,
    /// Holds for marks of any paint.
    pub asked: &'a Asked,
}

impl Job<'_> {
    fn beside(&self) -> Beside {
        let info = self.source.info();
        match self.refine {
            Refine::Always => {
                Beside::Weighed { middle: Some(PixelPoint { x: info.width as f64 / 2.0, y: info.height as f64 / 2.0 }) }
            }
            Refine::Never => Beside::Stay,
        }
    }
}

/// Whether points are looked for again where they must be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refine {
    #[default]
    Always,
    /// The first match stands as it is, as in the tables of the 2016 thesis; check points are the scan's candidates.
    Never,
}

/// What came of it.
#[derive(Clone, Debug)]
pub struct Run {
    pub scan: ScanOutcome,
    pub outcome: Outcome,
    pub match_s: f64,
    pub rematch_s: f64,
}

/// What a run ends with.
#[derive(Clone, Debug)]
pub enum Outcome {
    Solved(Box<Orientation>),
    Refused(Box<Evidence>),
}

/// Which look gave a mark's centre; in JSON "scan", "rematch" or "review".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FoundBy {
    Scan,
    /// The refinement: a window of its own where the GCP must be.
    Rematch,
    /// A person, on record in a patch file.
    Review,
}

/// A GCP and the mark that is it.
#[derive(Clone, Debug)]
pub struct FoundMark {
    /// Index in the list of GCPs.
    pub gcp: usize,
    pub mark: Candidate,
    pub found_by: FoundBy,
}

/// A solved orientation.
#[derive(Clone, Debug)]
pub struct Orientation {
    /// The match that was believed, with marks that left the fit since ([`Orientation::marks`] has those that stay).
    pub evidence: Solved,
    pub solution: Solution,
    /// Control points of the fit, in order of the list and of `solution.pairs`.
    pub marks: Vec<FoundMark>,
    /// Check points that were found; they took no part in the fit.
    pub check_marks: Vec<FoundMark>,
    /// Inside the image, but no mark was found.
    pub not_found: Vec<usize>,
    pub outside: Vec<usize>,
    /// Mistakes in the list that would explain what the fit does not.
    pub diagnoses: Vec<Diagnosis>,
}

/// Runs the job.
///
/// # Errors
/// When the raster cannot be read. Not to find a solution is an [`Outcome`], not an error.
pub fn georeference(job: &Job<'_>) -> Result<Run> {
    let scan = scan(job.source, job.plan, job.detector, job.progress)?;
    match_and_orient(job, scan)
}

/// The second half: the pattern among the candidates of a scan, and the orientation by it.
///
/// # Errors
/// When the raster cannot be read.
pub(super) fn match_and_orient(job: &Job<'_>, scan: ScanOutcome) -> Result<Run> {
    let started = Instant::now();
    job.progress.stage("matching the marks to the list");
    let outcome = tracing::info_span!("match").in_scope(|| find(job, &scan.candidates));
    let match_s = started.elapsed().as_secs_f64();
    let started = Instant::now();
    job.progress.stage("looking again where every point must be");
    let _span = tracing::info_span!("solve and look again").entered();
    let outcome = match outcome {
        MatchOutcome::NoMatch(mut evidence) => {
            evidence.advice.extend(of_other_shape(&scan));
            Outcome::Refused(evidence)
        }
        MatchOutcome::Solved(solved) => {
            orient((job.gcps, &scan.candidates), *solved, job.beside(), |expected, taken| match job.refine {
                Refine::Always => rematch(job.source, job.refiner, &scan.candidates, taken, expected),
                Refine::Never => Ok(unrefined(job, (&scan.candidates, taken), expected)),
            })?
        }
    };
    Ok(Run { scan, outcome, match_s, rematch_s: started.elapsed().as_secs_f64() })
}

/// What is said where the paint was seen, but hardly a mark.
fn of_other_shape(scan: &ScanOutcome) -> Option<String> {
    const FEWEST: u64 = 3;
    let n = scan.regions_turned_down;
    (scan.candidates.len() < FEWEST as usize && n >= FEWEST).then(|| {
        format!(
            "{n} patches of this paint were looked at and turned down: squares, discs, crosses, rings, chequers and \
             hourglasses are measured; triangles, arrows, L and T are not"
        )
    })
}

/// What the scan saw of check points, and nothing of any other.
fn unrefined(
    job: &Job<'_>,
    (candidates, taken): (&[Candidate], &[Candidate]),
    expected: &[Expected],
) -> Vec<Refinement> {
    let size_px = (job.source.info().width as f64, job.source.info().height as f64);
    let free = Free::among(candidates, taken);
    let answer = |e: &Expected| match free.nearest(e) {
        Some(candidate) if job.gcps[e.gcp].role == GcpRole::Check => Refinement::Kept { candidate },
        _ if is_inside(e.position, size_px) => Refinement::NotFound,
        _ => Refinement::Outside,
    };
    expected.iter().map(answer).collect()
}

/// Orients by a match that is believed already; points that the job's refinement does not see are looked for with
/// `taught` too.
///
/// # Errors
/// When the raster cannot be read.
pub(super) fn orient_again(
    job: &Job<'_>,
    candidates: &[Candidate],
    evidence: Solved,
    taught: &dyn Detector,
) -> Result<Outcome> {
    orient((job.gcps, candidates), evidence, job.beside(), |expected, taken| {
        let mut answers = rematch(job.source, job.refiner, candidates, taken, expected)?;
        let missing: Vec<usize> = (0..expected.len()).filter(|&i| matches!(answers[i], Refinement::NotFound)).collect();
        let asked: Vec<Expected> = missing.iter().map(|&i| expected[i]).collect();
        for (&i, answer) in missing.iter().zip(rematch(job.source, taught, candidates, taken, &asked)?) {
            answers[i] = answer;
        }
        Ok(answers)
    })
}

/// Tries the priors in order. The limit on false alarms holds for all tries together.
pub(super) fn find(job: &Job<'_>, candidates: &[Candidate]) -> MatchOutcome {
    let mut outcome = job.matcher.find(candidates, job.gcps, &job.priors[0].with_mark_sizes(candidates));
    for priors in &job.priors[1..] {
        if matches!(outcome, MatchOutcome::Solved(_)) {
            break;
        }
        tracing::info!("nothing found with what the image says of itself; trying without");
        outcome = job.matcher.find(candidates, job.gcps, &priors.with_mark_sizes(candidates));
    }
    outcome
}

/// The same from a list of candidates, without an image to look at again.
///
/// # Errors
/// None at present; the signature is that of looking at an image.
pub fn solve_candidates(
    candidates: &[Candidate],
    gcps: &[Gcp],
    matcher: &dyn Matcher,
    priors: &Priors,
) -> Result<Outcome> {
    let middle = priors.image_size_px.map(|(width, height)| PixelPoint { x: width / 2.0, y: height / 2.0 });
    match matcher.find(candidates, gcps, &priors.with_mark_sizes(candidates)) {
        MatchOutcome::NoMatch(evidence) => Ok(Outcome::Refused(evidence)),
        MatchOutcome::Solved(solved) => {
            orient((gcps, candidates), *solved, Beside::Weighed { middle }, |expected, taken| {
                let inside = |p: PixelPoint| priors.image_size_px.is_none_or(|size_px| is_inside(p, size_px));
                let free = Free::among(candidates, taken);
                Ok(expected
                    .iter()
                    .map(|e| match free.nearest(e) {
                        Some(candidate) => Refinement::Kept { candidate },
                        None if inside(e.position) => Refinement::NotFound,
                        None => Refinement::Outside,
                    })
                    .collect())
            })
        }
    }
}

/// The marks of a list's points.
struct Marks {
    /// Of the points that the fit takes.
    control: Vec<FoundMark>,
    check: Vec<FoundMark>,
    not_found: Vec<usize>,
    outside: Vec<usize>,
}

/// Looks where GCPs must be.
type Look<'a> = &'a dyn Fn(&[Expected], &[Candidate]) -> Result<Vec<Refinement>>;

fn orient(
    (gcps, candidates): (&[Gcp], &[Candidate]),
    evidence: Solved,
    beside: Beside,
    look: impl Fn(&[Expected], &[Candidate]) -> Result<Vec<Refinement>>,
) -> Result<Outcome> {
    let matched = evidence
        .pattern
        .pairs
        .iter()
        .map(|&(candidate, gcp)| FoundMark { gcp, mark: candidates[candidate].clone(), found_by: FoundBy::Scan })
        .collect();
    let noise_px = evidence.pattern.noise_px;
    let Some(mut found) = complete((gcps, candidates), &evidence, (matched, noise_px), beside, &look)? else {
        return Ok(Outcome::Refused(Box::new(degenerate(evidence))));
    };
    let mirrored = evidence.pattern.similarity.mirrored;
    // What stands beside its point may hide the mark that it should be, and has made room for others like it.
    if let Beside::Weighed { middle } = beside
        && let Some(close) = close_core(&pairs(gcps, &found.control), mirrored, middle)
    {
        let core: Vec<FoundMark> =
            found.control.iter().zip(&close.stays).filter(|(_, stays)| **stays).map(|(mark, _)| mark.clone()).collect();
        let noise_px = noise_px.min(close.noise_px);
        if let Some(again) = complete((gcps, candidates), &evidence, (core, noise_px), beside, &look)? {
            found = again;
        }
    }
    match solve_as(&pairs(gcps, &found.control), mirrored) {
        Ok(solution) => Ok(Outcome::Solved(Box::new(Orientation {
            evidence,
            solution,
            marks: found.control,
            check_marks: found.check,
            not_found: found.not_found,
            outside: found.outside,
            diagnoses: Vec::new(),
        }))),
        Err(_) => Ok(Outcome::Refused(Box::new(degenerate(evidence)))),
    }
}

/// Looks for the points that have no mark yet where those that have one put them. `None` when these solve nothing.
fn complete(
    (gcps, candidates): (&[Gcp], &[Candidate]),
    evidence: &Solved,
    (matched, noise_px): (Vec<FoundMark>, f64),
    beside: Beside,
    look: Look<'_>,
) -> Result<Option<Marks>> {
    let mirrored = evidence.pattern.similarity.mirrored;
    let Ok(solution) = solve_as(&pairs(gcps, &matched), mirrored) else { return Ok(None) };
    let expected: Vec<Expected> = (0..gcps.len())
        .filter(|gcp| !matched.iter().any(|mark| mark.gcp == *gcp))
        .map(|gcp| expect(gcp, &gcps[gcp], &solution, noise_px, density(candidates)))
        .collect();
    let paired: Vec<Candidate> = matched.iter().map(|found| found.mark.clone()).collect();
    let mut answers = look(&expected, &paired)?;
    one_gcp_each(&expected, candidates, &mut answers);
    // Where names were heeded, a mark with another GCP's name is not this one, whatever its place.
    let labels = Labels::new(gcps);
    let may_be = |mark: &FoundMark| {
        evidence.names.is_none() || labels.named_by(&mark.mark).is_none_or(|named| named == mark.gcp)
    };
    let kept = answers.iter().filter_map(|answer| match answer {
        Refinement::Kept { candidate } => Some(*candidate),
        _ => None,
    });
    let is_paired = |i: &usize| paired.iter().any(|mark| mark.centre == candidates[*i].centre);
    let mut taken: Vec<usize> = (0..candidates.len()).filter(is_paired).chain(kept).collect();
    let placed: Vec<(usize, &Candidate)> = matched.iter().map(|found| (found.gcp, &found.mark)).collect();
    let about = Neighbourhood::new((gcps, candidates), (&solution, &placed), noise_px);
    let mut found = Marks { control: matched, check: Vec::new(), not_found: Vec::new(), outside: Vec::new() };
    for (expected, answer) in expected.iter().zip(answers) {
        let gcp = expected.gcp;
        let mark = match answer {
            Refinement::Kept { candidate } => {
                Some(FoundMark { gcp, mark: candidates[candidate].clone(), found_by: FoundBy::Scan })
            }
            Refinement::Found(mark) => Some(FoundMark { gcp, mark: *mark, found_by: FoundBy::Rematch }),
            Refinement::NotFound => None,
            Refinement::Outside => {
                found.outside.push(gcp);
                continue;
            }
        };
        let is_check = gcps[gcp].role == GcpRole::Check;
        let off_its_place = || {
            let candidate = about.mark_of(expected, &taken, beside)?;
            let mark = FoundMark { gcp, mark: candidates[candidate].clone(), found_by: FoundBy::Scan };
            may_be(&mark).then(|| {
                taken.push(candidate);
                mark
            })
        };
        match mark.filter(&may_be).or_else(off_its_place) {
            Some(mark) if is_check => found.check.push(mark),
            Some(mark) => found.control.push(mark),
            None => found.not_found.push(gcp),
        }
    }
    found.control.sort_by_key(|mark| mark.gcp);
    let may_be_asked = |mark: &FoundMark| evidence.names.is_none() || labels.named_by(&mark.mark) != Some(mark.gcp);
    let doubtful = without_doubtful(&mut found.control, &found.outside, candidates, gcps, (mirrored, &may_be_asked));
    found.not_found.extend(doubtful);
    found.not_found.sort_unstable();
    Ok(Some(found))
}

/// Takes doubtful far marks away ([`doubtful_far`]) and tells whose they were.
fn without_doubtful(
    marks: &mut Vec<FoundMark>,
    outside: &[usize],
    candidates: &[Candidate],
    gcps: &[Gcp],
    (mirrored, may_be_asked): (Handedness, &dyn Fn(&FoundMark) -> bool),
) -> Vec<usize> {
    let may_have_mark = |gcp: &usize| gcps[*gcp].role == GcpRole::Control && !outside.contains(gcp);
    let in_image: Vec<MapPoint> = (0..gcps.len()).filter(may_have_mark).map(|gcp| gcps[gcp].position()).collect();
    let field = Field::new(candidates.iter().map(|candidate| candidate.centre).collect(), None);
    let density = |p: PixelPoint| field.density_near(p);
    let ground = Ground { gcps: &in_image, mirrored, density: &density };
    let mut gone = Vec::new();
    while let Some(doubtful) = doubtful_far(&pairs(gcps, marks), &ground, |i| may_be_asked(&marks[i])) {
        gone.push(marks.remove(doubtful).gcp);
    }
    gone
}

/// What surrounds a matched or refused list, for the diagnosis.
pub struct Surroundings<'a> {
    pub crs: Option<&'a autoref_raster::crs::Crs>,
    pub known: Option<KnownPlace>,
    pub max_false_alarms: f64,
    pub time_limit: TimeLimit,
}

/// Lets the diagnosis look at an outcome. A mistake that makes a refused list fit becomes part of the reason.
pub fn diagnose(
    outcome: &mut Outcome,
    candidates: &[Candidate],
    gcps: &[Gcp],
    priors: &Priors,
    surroundings: Surroundings<'_>,
) {
    let Surroundings { crs, known, max_false_alarms, time_limit } = surroundings;
    let matcher = RobustMatcher { max_false_alarms, time_limit, ..RobustMatcher::default() };
    let errors = GrossErrors { candidates, gcps, priors, crs, known, matcher };
    match outcome {
        Outcome::Solved(orientation) => {
            orientation.diagnoses = errors.on_solution(&orientation.evidence.pattern);
            // The refinement found marks that the scan did not have: those points are explained.
            let marks = || orientation.marks.iter().chain(&orientation.check_marks);
            let found: Vec<&str> = marks().map(|mark| gcps[mark.gcp].name.as_str()).collect();
            orientation.diagnoses.retain(|d| !d.gcps.iter().any(|name| found.contains(&name.as_str())));
        }
        Outcome::Refused(evidence) => {
            evidence.diagnoses = errors.on_refusal(evidence.best.as_ref());
            if let Some(first) = evidence.diagnoses.first() {
                evidence.reason = format!("{}; {}", evidence.reason, first.message);
                let messages = evidence.diagnoses.iter().map(|d| d.message.clone());
                evidence.advice = messages.chain(std::mem::take(&mut evidence.advice)).collect();
            }
        }
    }
}

/// Marks and the GCPs that they are, as a fit takes them.
///
/// # Panics
/// When a mark is that of a GCP beyond the list.
pub fn pairs(gcps: &[Gcp], marks: &[FoundMark]) -> Vec<Pair> {
    marks
        .iter()
        .map(|found| Pair {
            pixel: found.mark.centre,
            covariance_px2: found.mark.covariance_px2,
            map: gcps[found.gcp].position(),
            survey_sigma_m: gcps[found.gcp].sigma_m,
        })
        .collect()
}

/// Where a GCP must be, and how far off it may be: what the match's noise and the fit's uncertainty there allow.
fn expect(gcp: usize, point: &Gcp, solution: &Solution, noise_px: f64, density: f64) -> Expected {
    /// Where the fit is less sure than a mark, a candidate that chance puts there more often than this is no mark of
    /// the point.
    const CHANCE: f64 = 0.0002;
    let position = solution.similarity.invert(point.position());
    let fit_px = solution.sigma_at_m(position) / solution.scale_m_per_px;
    let by_chance_px = chance_radius_px(CHANCE, density);
    let sure_px = 3.8 * noise_px * std::f64::consts::SQRT_2;
    let radius_px = (3.8 * noise_px.hypot(fit_px)).min(sure_px.max(by_chance_px)).clamp(2.0, 64.0);
    Expected { gcp, position, radius_px }
}

fn degenerate(evidence: Solved) -> Evidence {
    Evidence {
        reason: "the matched points lie in one place: no orientation follows from them".into(),
        advice: vec!["more points, farther apart".into()],
        best: Some(evidence.pattern),
        runner_up: evidence.runner_up,
        effort: evidence.effort,
        diagnoses: Vec::new(),
    }
}
