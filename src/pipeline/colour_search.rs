//! When nothing fits, the picture is asked: compact objects of any saturated colour that stand out from their ground,
//! sorted by colour; each cluster is tried against the list. The limit on false alarms holds for all clusters together,
//! because the matcher that is given counts [`MOST_CLUSTERS`] of them, tried or not.

use std::collections::HashSet;

use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::matching::MatchOutcome;
use crate::pipeline::georeference::{Job, Outcome, Run, find, orient_again};
use crate::pipeline::picture::MOST_SEQUENTIAL_PX;
use crate::pipeline::second_pass::{keep_strongest, strongest, taught};
use crate::pipeline::{MarkDetector, ScanOutcome, scan};
use crate::profile::colour::lab_from_srgb;
use crate::profile::{Profile, srgb_of_hex};
use crate::rematch::shows_a_mark;
use crate::segment::reference::PaintTest;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::ranks::upper_median;
use autoref_raster::window::Window;
use autoref_raster::{RasterSource, read_patch};

/// So many clusters are tried at most, the largest first.
pub const MOST_CLUSTERS: usize = 8;
/// Fewer objects are no cluster.
const LEAST_OBJECTS: usize = 4;
/// Colours of one paint lie so near to each other: in a\*, b\* and half of the lightness.
const NEAR: f64 = 20.0;

/// What the search saw.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColourSearch {
    /// Objects of any colour.
    pub objects: usize,
    /// The clusters tried, the largest first.
    pub clusters: Vec<ColourCluster>,
    /// Clusters that the user's size or rules left out, when nothing else solved it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// Seconds, scan and matching.
    pub elapsed_s: f64,
}

/// Objects of one colour.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColourCluster {
    /// Their median, as #RRGGBB.
    pub colour: String,
    pub objects: usize,
    /// Of these, candidates by the profile already.
    #[serde(default)]
    pub seen: usize,
    /// Points of the list that they match; 0 when refused.
    pub matched: usize,
    pub adopted: bool,
    /// Of the strongest objects so many were looked at once more, with a profile of this paint alone, ...
    #[serde(default)]
    pub looked_at: usize,
    /// ... and so many of these are marks by it.
    #[serde(default)]
    pub confirmed: usize,
}

impl ColourCluster {
    /// Whether the profile has passed most of them over.
    fn is_unseen(&self) -> bool {
        2 * self.seen < self.objects
    }

    /// Whether `--paint` with this colour finds them: grass and cars look like marks only as long as any colour may be
    /// paint.
    fn is_confirmed(&self) -> bool {
        self.confirmed >= LEAST_OBJECTS && 2 * self.confirmed >= self.looked_at
    }
}

/// Objects of one colour that a size or a rule of the user's forbids.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Their median, as #RRGGBB.
    pub colour: String,
    pub objects: usize,
    /// Smallest and largest side, pixels.
    pub side_px: [f64; 2],
    /// The options that left them out, as they were given.
    pub options: String,
}

impl LeftOut {
    fn line(&self) -> String {
        let LeftOut { colour, objects, side_px: [low, high], options } = self;
        format!(
            "{objects} objects of colour {colour} of {low:.0} to {high:.0} px look like marks; {options} left them out"
        )
    }
}

/// How many clusters advice names.
const NAMED: usize = 3;

impl ColourSearch {
    /// What to try next, of clusters that a profile of their own paint finds, the most vivid first. Not the paint that
    /// `profile` was asked for, nor what it has found.
    pub fn advice(&self, profile: &str) -> Vec<String> {
        let is_new = |c: &&ColourCluster| is_new(&c.colour, profile);
        if self.clusters.iter().any(|cluster| cluster.adopted) {
            return Vec::new();
        }
        let line = |c: &ColourCluster| {
            format!("these {} objects of colour {} look like marks: --paint \"{}\"", c.objects, c.colour, c.colour)
        };
        let is_plain = |c: &&ColourCluster| c.is_unseen() && c.is_confirmed();
        let mut new: Vec<&ColourCluster> = self.clusters.iter().filter(is_plain).filter(is_new).collect();
        new.sort_by(|s, t| chroma(&t.colour).total_cmp(&chroma(&s.colour)));
        let mut left_out: Vec<&LeftOut> = self.left_out.iter().collect();
        left_out.sort_by(|s, t| chroma(&t.colour).total_cmp(&chroma(&s.colour)));
        let forbidden = left_out.into_iter().take(NAMED).map(LeftOut::line);
        forbidden.chain(new.into_iter().take(NAMED).map(line)).collect()
    }

    /// That the marks are of another paint than `profile`'s, or of this, told from the rest by the search alone.
    pub fn note(&self, profile: &str) -> Option<String> {
        let ColourCluster { colour, .. } = self.clusters.iter().find(|cluster| cluster.adopted)?;
        Some(if is_new(colour, profile) {
            format!("the marks are of colour {colour}, not the profile's: next time name it, --paint \"{colour}\"")
        } else {
            format!(
                "the marks are of the paint that was asked for, but only the search over colours ({colour}) told them \
                 from the rest: look at their pictures in the report"
            )
        })
    }
}

/// Whether a colour is another than the paint that was asked for.
fn is_new(colour: &str, profile: &str) -> bool {
    let places = srgb_of_hex(profile).zip(srgb_of_hex(colour));
    places.is_none_or(|(asked, own)| (place(own) - place(asked)).norm() >= NEAR)
}

/// Looks for marks of any colour and tries each cluster; the run that solves comes back, else the first.
///
/// # Errors
/// When the raster cannot be read.
pub fn colour_search(job: &Job<'_>, first: Run) -> Result<(Run, Option<ColourSearch>)> {
    let started = std::time::Instant::now();
    let (profile, info) = (job.asked.of(Profile::any_paint()), job.source.info());
    let Ok(detector) = MarkDetector::new(profile, info, job.asked.gsd_m) else {
        return Ok((first, None));
    };
    job.progress.pass("looking for marks of any colour");
    let seen = scan(job.source, job.plan, detector.as_detector(), job.progress)?;
    let objects = seen.candidates.len();
    let mut search = ColourSearch { objects, clusters: Vec::new(), left_out: Vec::new(), elapsed_s: 0.0 };
    let mut solved = None;
    let known = Places::of(&first.scan.candidates);
    let clustered = clusters(&seen.candidates);
    for members in &clustered {
        let mut candidates: Vec<Candidate> = members.iter().map(|&i| seen.candidates[i].clone()).collect();
        let colour = median_colour(&candidates);
        let already = candidates.iter().filter(|candidate| known.has(candidate)).count();
        keep_strongest(&mut candidates, job.gcps.len());
        let outcome = oriented(job, &candidates, colour)?;
        let matched = match &outcome {
            Some(Outcome::Solved(orientation)) => orientation.marks.len() + orientation.check_marks.len(),
            _ => 0,
        };
        let (objects, adopted) = (members.len(), matched > 0);
        let colour = hex(colour);
        let (looked_at, confirmed) = (0, 0);
        search.clusters.push(ColourCluster { colour, objects, seen: already, matched, adopted, looked_at, confirmed });
        if let Some(outcome) = outcome.filter(|_| adopted) {
            solved = Some(Run {
                scan: ScanOutcome { candidates, ..seen.clone() },
                outcome,
                match_s: first.match_s,
                rematch_s: first.rematch_s,
            });
            break;
        }
    }
    if solved.is_none() && is_in_the_dark(&first) {
        confirm(job, &mut search.clusters, (&clustered, &seen.candidates))?;
    }
    if solved.is_none() && job.asked.is_something() && matches!(first.outcome, Outcome::Refused(_)) {
        search.left_out = left_out(job, &seen.candidates)?;
    }
    search.elapsed_s = started.elapsed().as_secs_f64();
    Ok((solved.unwrap_or(first), Some(search)))
}

/// Whether a run has found nothing that the list explains. Where a pattern that chance hardly produces lacks only
/// evidence, paint of another colour is not what is missing.
fn is_in_the_dark(run: &Run) -> bool {
    /// log₁₀ of how many such patterns chance produces.
    const HARDLY: f64 = -1.0;
    match &run.outcome {
        Outcome::Refused(evidence) => evidence.best.as_ref().is_none_or(|best| best.log10_false_alarms > HARDLY),
        Outcome::Solved(_) => false,
    }
}

/// Looks at the strongest objects of the most vivid clusters, each in a window of its own, with a profile of that paint
/// alone: what somebody finds who names it.
fn confirm(
    job: &Job<'_>,
    found: &mut [ColourCluster],
    (members, candidates): (&[Vec<usize>], &[Candidate]),
) -> Result<()> {
    /// Objects of each cluster, and how far off its place a mark's centre may lie, pixels.
    const LOOKED_AT: usize = 8;
    const RADIUS_PX: f64 = Places::CELL_PX;
    let info = job.source.info();
    // To read such a raster once more from the top down takes as long as a search.
    if info.sequential && info.width * info.height > MOST_SEQUENTIAL_PX {
        return Ok(());
    }
    let mut vivid: Vec<usize> = (0..found.len()).filter(|&k| found[k].is_unseen()).collect();
    vivid.sort_by(|&s, &t| chroma(&found[t].colour).total_cmp(&chroma(&found[s].colour)));
    vivid.truncate(NAMED);
    let strongest = |&k: &usize| {
        let mut strongest: Vec<&Candidate> = members[k].iter().map(|&i| &candidates[i]).collect();
        strongest.sort_by(|a, b| b.score.unwrap_or(0.0).total_cmp(&a.score.unwrap_or(0.0)));
        strongest.truncate(LOOKED_AT);
        strongest
    };
    let objects: Vec<Vec<&Candidate>> = vivid.iter().map(strongest).collect();
    let profile = |k: usize| {
        // Paint that is worn is no plain mark, and its table of colours costs as much as that of the fresh one.
        let mut profile = job.asked.of(Profile::of_paint(srgb_of_hex(&found[k].colour)?));
        profile.examine.worn = false;
        Some(profile)
    };
    let mut detectors = Vec::new();
    for (&k, objects) in vivid.iter().zip(&objects) {
        let Some(profile) = profile(k) else { return Ok(()) };
        // What is read from the top down is passed once.
        let may_be = info.sequential || stand_out(job.source, &profile, objects)?;
        detectors.push(may_be.then(|| MarkDetector::new(profile, info, job.asked.gsd_m).ok()).flatten());
    }
    let mut places: Vec<(usize, PixelPoint)> = Vec::new();
    for (i, objects) in objects.iter().enumerate() {
        places.extend(objects.iter().map(|object| (i, object.centre)));
    }
    places.sort_by(|(_, a), (_, b)| a.y.total_cmp(&b.y));
    let is_mark = |&(i, at): &(usize, PixelPoint)| match &detectors[i] {
        Some(detector) => shows_a_mark(job.source, detector.as_detector(), at, RADIUS_PX),
        None => Ok(false),
    };
    let are_marks: Vec<bool> = match info.sequential {
        true => places.iter().map(is_mark).collect::<Result<_>>()?,
        false => places.par_iter().map(is_mark).collect::<Result<_>>()?,
    };
    for ((i, _), is_mark) in places.iter().zip(are_marks) {
        let cluster = &mut found[vivid[*i]];
        cluster.looked_at += 1;
        cluster.confirmed += usize::from(is_mark);
    }
    Ok(())
}

/// Whether most of the objects lie on ground that is not of a profile's paint: pixel by pixel, since a detector costs a
/// table of colours, and grass on grass shows at once.
fn stand_out(source: &dyn RasterSource, profile: &Profile, objects: &[&Candidate]) -> Result<bool> {
    /// Of the ground beside an object at most this share has the paint's colour.
    const MOST_BESIDE: f64 = 0.25;
    /// Where that ground begins and ends, in sides of the object.
    const BESIDE: std::ops::Range<f64> = 0.9..1.6;
    let (test, bounds) = (PaintTest::new(profile)?, source.info().bounds());
    let mut standing = 0;
    for object in objects {
        let side_px = object.size_px.map_or(10.0, |[width, height]| width.max(height)).clamp(4.0, 100.0);
        let pixel = Window::new(object.centre.x as u64, object.centre.y as u64, 1, 1);
        let patch = read_patch(source, pixel.grown((BESIDE.end * side_px).ceil() as u64, &bounds))?;
        let (scale, width) = (255.0 / f64::from(patch.white), patch.window.width);
        let is_beside = |i: &usize| {
            let (column, row) = (*i as u64 % width, *i as u64 / width);
            let (x, y) = ((patch.window.x + column) as f64 + 0.5, (patch.window.y + row) as f64 + 0.5);
            BESIDE.contains(&((x - object.centre.x).hypot(y - object.centre.y) / side_px))
        };
        let beside: Vec<usize> = (0..patch.rgb.len()).filter(|&i| patch.valid[i]).filter(is_beside).collect();
        let is_paint = |i: &&usize| test.is_paint(patch.rgb[**i].map(|v| (f64::from(v) * scale).round() as u8));
        let paint = beside.iter().filter(is_paint).count();
        standing += usize::from((paint as f64) <= MOST_BESIDE * beside.len() as f64);
    }
    Ok(standing >= LEAST_OBJECTS && 2 * standing >= objects.len())
}

/// What looks like marks, were it not for the user's size and rules; `allowed` is what these let pass.
fn left_out(job: &Job<'_>, allowed: &[Candidate]) -> Result<Vec<LeftOut>> {
    /// The same object, seen twice.
    const SAME_PX: f64 = 3.0;
    let Ok(detector) = MarkDetector::new(Profile::any_paint(), job.source.info(), None) else { return Ok(Vec::new()) };
    job.progress.pass("looking for marks that the size or a rule leaves out");
    let mut seen = scan(job.source, job.plan, detector.as_detector(), job.progress)?.candidates;
    let is_same = |a: &Candidate, b: &Candidate| (a.centre.x - b.centre.x).hypot(a.centre.y - b.centre.y) < SAME_PX;
    seen.retain(|candidate| !allowed.iter().any(|other| is_same(candidate, other)));
    let of = |members: Vec<usize>| {
        let objects: Vec<Candidate> = members.iter().map(|&i| seen[i].clone()).collect();
        let sides = || objects.iter().filter_map(|c| c.size_px.map(|[width, height]| width.max(height)));
        let side_px = [sides().fold(f64::INFINITY, f64::min), sides().fold(0.0, f64::max)];
        let colour = hex(median_colour(&objects));
        LeftOut { colour, objects: objects.len(), side_px, options: job.asked.options.join(" or ") }
    };
    Ok(clusters(&seen).into_iter().map(of).filter(|cluster| cluster.side_px[0].is_finite()).collect())
}

fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02X}{g:02X}{b:02X}")
}

/// The orientation by a cluster, its missing points looked for with what it teaches; `None` when refused.
fn oriented(job: &Job<'_>, candidates: &[Candidate], colour: [u8; 3]) -> Result<Option<Outcome>> {
    let MatchOutcome::Solved(solved) = find(job, candidates) else { return Ok(None) };
    let teachers = strongest(solved.pattern.pairs.iter().map(|pair| &candidates[pair.0]));
    let profile = taught(job, &teachers)?.unwrap_or_else(|| job.asked.of(Profile::of_paint(colour)));
    let Ok(detector) = MarkDetector::new(profile, job.source.info(), job.asked.gsd_m) else { return Ok(None) };
    let refiner = detector.relaxed();
    let job = Job { refiner: refiner.as_detector(), ..*job };
    let outcome = orient_again(&job, candidates, *solved, refiner.as_detector())?;
    Ok(matches!(outcome, Outcome::Solved(_)).then_some(outcome))
}

/// Where candidates are, in cells.
struct Places(HashSet<[i64; 2]>);

impl Places {
    /// Side of a cell, px: a mark has one centre in all colours, but for its shadow and its rim.
    const CELL_PX: f64 = 4.0;

    fn of(candidates: &[Candidate]) -> Places {
        Places(candidates.iter().map(Places::cell).collect())
    }

    fn cell(candidate: &Candidate) -> [i64; 2] {
        [candidate.centre.x, candidate.centre.y].map(|v| (v / Places::CELL_PX).floor() as i64)
    }

    /// Whether one is at this candidate's place.
    fn has(&self, candidate: &Candidate) -> bool {
        let [x, y] = Places::cell(candidate);
        (-1..=1).any(|down| (-1..=1).any(|right| self.0.contains(&[x + right, y + down])))
    }
}

/// How far a colour, #RRGGBB, is from grey in a\*, b\*.
fn chroma(colour: &str) -> f64 {
    srgb_of_hex(colour).map_or(0.0, |rgb| place(rgb).yz().norm())
}

fn place(rgb: [u8; 3]) -> Vector3<f64> {
    let lab = lab_from_srgb(rgb.map(|v| f64::from(v) / 255.0));
    Vector3::new(lab[0] / 2.0, lab[1], lab[2])
}

/// Indices of the candidates of each cluster, the largest first: the candidate with the most neighbours in colour takes
/// them all, and so on with what is left.
fn clusters(candidates: &[Candidate]) -> Vec<Vec<usize>> {
    // Neighbours are counted in cells of colour: candidates may be tens of thousands.
    let mut cells: std::collections::BTreeMap<[i32; 3], Vec<usize>> = std::collections::BTreeMap::new();
    for (i, candidate) in candidates.iter().enumerate() {
        if let Some(paint) = candidate.paint {
            let at = place(paint);
            cells.entry([0, 1, 2].map(|k| (at[k] / (NEAR / 4.0)).floor() as i32)).or_default().push(i);
        }
    }
    let mut found = Vec::new();
    while found.len() < MOST_CLUSTERS {
        let near = |a: &[i32; 3], b: &[i32; 3]| (0..3).map(|k| (a[k] - b[k]).pow(2)).sum::<i32>() <= 16;
        let size = |at: &[i32; 3]| cells.iter().filter(|(b, _)| near(at, b)).map(|(_, m)| m.len()).sum::<usize>();
        let Some((most, at)) =
            cells.keys().map(|at| (size(at), *at)).max_by_key(|(n, at)| (*n, std::cmp::Reverse(*at)))
        else {
            break;
        };
        if most < LEAST_OBJECTS {
            break;
        }
        let keys: Vec<[i32; 3]> = cells.keys().filter(|b| near(&at, b)).copied().collect();
        let mut members: Vec<usize> = keys.iter().filter_map(|key| cells.remove(key)).flatten().collect();
        members.sort_unstable();
        found.push(members);
    }
    found
}

fn median_colour(candidates: &[Candidate]) -> [u8; 3] {
    std::array::from_fn(|c| {
        let mut values: Vec<u8> = candidates.iter().filter_map(|candidate| candidate.paint.map(|p| p[c])).collect();
        upper_median(&mut values).unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eight of them were looked at, and all are marks by their own paint.
    fn found(colour: &str, objects: usize, seen: usize) -> ColourCluster {
        let (matched, adopted, looked_at, confirmed) = (0, false, 8, 8);
        ColourCluster { colour: colour.into(), objects, seen, matched, adopted, looked_at, confirmed }
    }

    /// Grass and cars were named as paint, which nobody found who followed it.
    #[test]
    fn only_paint_that_its_own_profile_finds_is_named() {
        let advice = |looked_at: usize, confirmed: usize| {
            let clusters = vec![ColourCluster { looked_at, confirmed, ..found("#65813D", 42, 0) }];
            ColourSearch { objects: 42, clusters, left_out: Vec::new(), elapsed_s: 0.0 }.advice("orange")
        };
        assert!(advice(8, 3).is_empty() && advice(0, 0).is_empty() && advice(12, 5).is_empty());
        assert!(advice(4, 4).len() == 1 && advice(8, 5).len() == 1);
    }

    /// Amber squares on grey ground and on amber ground.
    #[test]
    fn objects_on_ground_of_their_colour_do_not_stand_out() {
        let places = [20, 60, 100, 140].map(|x| PixelPoint { x: f64::from(x), y: 20.0 });
        let mark = |at| Candidate { size_px: Some([10.0, 10.0]), ..Candidate::at(at) };
        let objects = places.map(mark);
        let profile = Profile::of_paint([240, 170, 8]);
        let stands = |ground: [u8; 3], objects: &[&Candidate]| {
            let is_mark = |x: i32, y: i32| places.iter().any(|at| (x - at.x as i32).abs().max((y - 20).abs()) < 5);
            let colour = |i: i32| if is_mark(i % 160, i / 160) { [240, 170, 8] } else { ground };
            let source = autoref_raster::memory::MemorySource::rgb8(160, 40, (0..160 * 40).flat_map(colour).collect());
            stand_out(&source, &profile, objects).expect("in memory")
        };
        let all: Vec<&Candidate> = objects.iter().collect();
        assert!(stands([110; 3], &all) && !stands([235, 165, 10], &all));
        assert!(!stands([110; 3], &all[..3]), "too few");
    }

    #[test]
    fn nobody_is_sent_to_the_paint_that_was_asked_for() {
        let cluster = |colour: &str| found(colour, 20, 0);
        let search = ColourSearch {
            objects: 40,
            clusters: vec![cluster("#2A4363"), cluster("#C83232")],
            left_out: Vec::new(),
            elapsed_s: 0.0,
        };
        let advice = search.advice("orange");
        assert!(advice.len() == 2 && advice[0].contains("#C83232"), "the most vivid first: {advice:?}");
        for asked in ["#2A4363", "#2C4564"] {
            let advice = search.advice(asked);
            assert!(advice.len() == 1 && advice[0].contains("#C83232"), "{advice:?}");
        }
    }

    #[test]
    fn what_the_user_forbids_is_said_first_and_the_paint_that_he_named_is_not_told_him_anew() {
        let options = "--mark-size 30..50px".into();
        let left_out = LeftOut { colour: "#DF5918".into(), objects: 12, side_px: [10.0, 16.0], options };
        let cluster = found("#2A4363", 9, 0);
        let mut search = ColourSearch { objects: 9, clusters: vec![cluster], left_out: vec![left_out], elapsed_s: 0.0 };
        let advice = search.advice("#DF5918");
        let said = "12 objects of colour #DF5918 of 10 to 16 px look like marks; --mark-size 30..50px left them out";
        assert!(advice.len() == 2 && advice[0] == said, "{advice:?}");
        search.clusters[0].adopted = true;
        let note = |profile: &str| search.note(profile).expect("adopted");
        assert!(note("orange").contains("--paint \"#2A4363\"") && !note("#2C4564").contains("--paint"));
    }

    /// The marks were found, and something else spoke against them: a wrong --gsd, a list of check points.
    #[test]
    fn nobody_is_sent_to_the_paint_that_the_profile_has_found() {
        let mark = |x: f64| Candidate::at(PixelPoint { x, y: 50.0 });
        let known = Places::of(&[mark(100.0), mark(300.0)]);
        assert!(known.has(&mark(101.5)) && known.has(&mark(299.0)) && !known.has(&mark(120.0)));
        let advice = |seen| {
            let (clusters, left_out) = (vec![found("#DF5918", 10, seen)], Vec::new());
            ColourSearch { objects: 10, clusters, left_out, elapsed_s: 0.0 }.advice("orange")
        };
        assert!(advice(10).is_empty() && advice(5).is_empty());
        assert_eq!(advice(4).len(), 1, "most were passed over");
    }
}
