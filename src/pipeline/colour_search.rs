//! When nothing fits, the picture is asked: compact objects of any saturated colour that stand out from their ground,
//! sorted by colour; each cluster is tried against the list. The limit on false alarms holds for all clusters together,
//! because the matcher that is given counts [`MOST_CLUSTERS`] of them, tried or not.

use std::collections::HashSet;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::matching::MatchOutcome;
use crate::pipeline::georeference::{Job, Outcome, Run, find, orient_again};
use crate::pipeline::second_pass::{keep_strongest, strongest, taught};
use crate::pipeline::{MarkDetector, ScanOutcome, scan};
use crate::profile::colour::lab_from_srgb;
use crate::profile::{Profile, srgb_of_hex};
use autoref_raster::error::Result;
use autoref_raster::ranks::upper_median;

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
    /// What to try next, of clusters that look like marks, the most vivid first: grass and earth come in many objects,
    /// paint is bright. Not the paint that `profile` was asked for, nor what it has found.
    pub fn advice(&self, profile: &str) -> Vec<String> {
        let is_new = |c: &&ColourCluster| is_new(&c.colour, profile);
        if self.clusters.iter().any(|cluster| cluster.adopted) {
            return Vec::new();
        }
        let line = |c: &ColourCluster| {
            format!("these {} objects of colour {} look like marks: --paint \"{}\"", c.objects, c.colour, c.colour)
        };
        let is_unseen = |c: &&ColourCluster| 2 * c.seen < c.objects;
        let mut new: Vec<&ColourCluster> = self.clusters.iter().filter(is_unseen).filter(is_new).collect();
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
    for members in clusters(&seen.candidates).into_iter().take(MOST_CLUSTERS) {
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
        search.clusters.push(ColourCluster { colour, objects, seen: already, matched, adopted });
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
    if solved.is_none() && job.asked.is_something() && matches!(first.outcome, Outcome::Refused(_)) {
        search.left_out = left_out(job, &seen.candidates)?;
    }
    search.elapsed_s = started.elapsed().as_secs_f64();
    Ok((solved.unwrap_or(first), Some(search)))
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
    use autoref_raster::coords::PixelPoint;

    #[test]
    fn nobody_is_sent_to_the_paint_that_was_asked_for() {
        let cluster =
            |colour: &str| ColourCluster { colour: colour.into(), objects: 20, seen: 0, matched: 0, adopted: false };
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
        let cluster = ColourCluster { colour: "#2A4363".into(), objects: 9, seen: 0, matched: 0, adopted: false };
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
        let found = |x: f64| Candidate::at(PixelPoint { x, y: 50.0 });
        let known = Places::of(&[found(100.0), found(300.0)]);
        assert!(known.has(&found(101.5)) && known.has(&found(299.0)) && !known.has(&found(120.0)));
        let cluster =
            |seen: usize| ColourCluster { colour: "#DF5918".into(), objects: 10, seen, matched: 0, adopted: false };
        let advice = |seen| {
            let (clusters, left_out) = (vec![cluster(seen)], Vec::new());
            ColourSearch { objects: 10, clusters, left_out, elapsed_s: 0.0 }.advice("orange")
        };
        assert!(advice(10).is_empty() && advice(5).is_empty());
        assert_eq!(advice(4).len(), 1, "most were passed over");
    }
}
