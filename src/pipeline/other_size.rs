//! When nothing fits, paint of the profile that is larger or smaller than its marks: seen by the first scan in passing,
//! looked at, and matched as one cluster more of the search over colours.

use std::collections::HashSet;

use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::matching::MatchOutcome;
use crate::pipeline::georeference::{Job, Outcome, Run, find, orient_again};
use crate::pipeline::second_pass::keep_strongest;
use crate::pipeline::{ScanOutcome, scan};
use autoref_raster::error::Result;

/// Fewer are no pattern.
const FEWEST: usize = 3;
/// Marks of one kind differ by less than this factor.
const ONE_KIND: f64 = 1.6;
/// What is advised takes marks so much larger than those that were seen, and so much smaller: the bounds of a square that
/// lies across the pixels are up to √2 as large as its side.
const SPARE: f64 = 1.25;
const SPARE_BELOW: f64 = 1.6;

/// What was seen of the profile's paint in other sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OtherSize {
    /// Smallest and largest side of a mark that the first look was for, pixels.
    pub first_px: [f64; 2],
    /// The same of this look.
    pub looked_px: [f64; 2],
    /// Objects of about one size beyond those of the first look: the most there are, or the marks.
    pub objects: usize,
    /// Their smallest and largest side, pixels.
    pub side_px: [f64; 2],
    /// Points of the list that they match; 0 when refused.
    pub matched: usize,
    pub adopted: bool,
}

impl OtherSize {
    fn option(&self) -> String {
        let [low, high] = self.side_px;
        format!("--mark-size {:.0}..{:.0}px", (low / SPARE_BELOW).floor(), (high * SPARE).ceil())
    }

    /// What to try next, where they match nothing.
    fn advice(&self) -> String {
        let ([low, high], [least, most]) = (self.side_px, self.first_px);
        format!(
            "{} objects of this paint of {low:.0} to {high:.0} px are {} than the marks that are looked for \
             ({least:.0} to {most:.0} px): {}",
            self.objects,
            if low > least { "larger" } else { "smaller" },
            self.option()
        )
    }

    /// That the marks are of another size, when they are.
    pub(super) fn note(&self) -> Option<String> {
        let ([low, high], [least, most], [from, to]) = (self.side_px, self.first_px, self.looked_px);
        self.adopted.then(|| {
            format!(
                "the marks are {low:.0} to {high:.0} px across, and the profile's {least:.0} to {most:.0} px: they were \
                 found by one look more, for {from:.0} to {to:.0} px; next time give {}",
                self.option()
            )
        })
    }
}

/// Looks for the marks of the job's detector beyond their sizes, where its scan has seen such paint; the run that
/// solves, if one does. What matches nothing becomes part of the advice of `first`. A size that the user gave holds,
/// and so does a chance for an accident that is spent (`may_match`).
///
/// # Errors
/// When the raster cannot be read.
pub(super) fn look_beyond(
    job: &Job<'_>,
    first: &mut Run,
    may_match: MayMatch,
) -> Result<(Option<Run>, Option<OtherSize>)> {
    if first.scan.regions_of_other_size < FEWEST as u64 {
        return Ok((None, None));
    }
    let Some((detector, refiner)) = job.detector.beyond_its_sizes().zip(job.refiner.beyond_its_sizes()) else {
        return Ok((None, None));
    };
    let sizes_px = job.detector.mark_side_px().zip(detector.mark_side_px());
    let Some((own_px, looked_px)) = sizes_px.filter(|_| detector.halo_px() <= job.plan.halo_px) else {
        return Ok((None, None));
    };
    job.progress.pass("looking for marks of other sizes");
    let seen = scan(job.source, job.plan, detector.as_ref(), job.progress)?;
    // What the first look has found is of no other size, whatever its bounds.
    let known = Places::of(&first.scan.candidates);
    let is_beyond = |side_px: &f64| !(own_px.0..=own_px.1).contains(side_px);
    let unseen = seen.candidates.iter().filter(|candidate| !known.has(candidate));
    let Some((objects, side_px)) = of_one_size(unseen.filter_map(side_of).filter(is_beyond).collect()) else {
        return Ok((None, None));
    };
    let first_px = [own_px.0, own_px.1];
    let looked_px = [looked_px.0, looked_px.1];
    let mut other = OtherSize { first_px, looked_px, objects, side_px, matched: 0, adopted: false };
    let mut candidates = seen.candidates.clone();
    keep_strongest(&mut candidates, job.gcps.len());
    let job = Job { detector: detector.as_ref(), refiner: refiner.as_ref(), ..*job };
    let outcome = if may_match == MayMatch::Yes { oriented(&job, &candidates)? } else { None };
    if let Some(Outcome::Solved(orientation)) = &outcome {
        let marks = || orientation.marks.iter().chain(&orientation.check_marks).map(|found| &found.mark);
        let sides = || marks().filter_map(side_of);
        other.objects = marks().count();
        other.matched = other.objects;
        other.side_px = [sides().fold(f64::INFINITY, f64::min), sides().fold(0.0, f64::max)];
        other.adopted = true;
    } else if let Outcome::Refused(evidence) = &mut first.outcome {
        evidence.advice.insert(0, other.advice());
    }
    let run = outcome.map(|outcome| Run {
        scan: ScanOutcome { candidates, ..seen },
        outcome,
        match_s: first.match_s,
        rematch_s: first.rematch_s,
    });
    Ok((run, Some(other)))
}

/// Whether what is seen may be matched to the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MayMatch {
    Yes,
    No,
}

/// The orientation by these candidates; `None` when refused.
fn oriented(job: &Job<'_>, candidates: &[Candidate]) -> Result<Option<Outcome>> {
    let MatchOutcome::Solved(solved) = find(job, candidates) else { return Ok(None) };
    let outcome = orient_again(job, candidates, *solved, job.refiner)?;
    Ok(matches!(outcome, Outcome::Solved(_)).then_some(outcome))
}

fn side_of(candidate: &Candidate) -> Option<f64> {
    candidate.size_px.map(|[width, height]| width.max(height))
}

/// Where candidates are, in cells.
pub(super) struct Places(HashSet<[i64; 2]>);

impl Places {
    /// Side of a cell, px: a mark has one centre in all colours, but for its shadow and its rim.
    const CELL_PX: f64 = 4.0;

    pub fn of(candidates: &[Candidate]) -> Places {
        Places(candidates.iter().map(Places::cell).collect())
    }

    fn cell(candidate: &Candidate) -> [i64; 2] {
        [candidate.centre.x, candidate.centre.y].map(|v| (v / Places::CELL_PX).floor() as i64)
    }

    /// Whether one is at this candidate's place.
    pub fn has(&self, candidate: &Candidate) -> bool {
        let [x, y] = Places::cell(candidate);
        (-1..=1).any(|down| (-1..=1).any(|right| self.0.contains(&[x + right, y + down])))
    }
}

/// The most sides that differ by no more than marks of one kind do: how many, and the smallest and the largest; `None`
/// where they are too few for a pattern.
fn of_one_size(mut sides_px: Vec<f64>) -> Option<(usize, [f64; 2])> {
    sides_px.sort_by(f64::total_cmp);
    let from = |i: usize| {
        let end = sides_px.partition_point(|side| *side <= ONE_KIND * sides_px[i]);
        (end - i, [sides_px[i], sides_px[end - 1]])
    };
    // Of equally many the larger: specks are many.
    (0..sides_px.len()).map(from).filter(|(objects, _)| *objects >= FEWEST).max_by_key(|(objects, _)| *objects)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_of_about_one_size_are_named_with_the_option_that_takes_them() {
        assert_eq!(of_one_size(vec![72.0, 300.0, 71.0, 190.0, 74.0, 75.5]), Some((4, [71.0, 75.5])));
        assert_eq!(of_one_size(vec![72.0, 150.0, 290.0]), None, "no two alike");
        let (first_px, looked_px, side_px) = ([5.0, 60.0], [30.0, 300.0], [71.0, 75.5]);
        let mut other = OtherSize { first_px, looked_px, objects: 4, side_px, matched: 0, adopted: false };
        let advice = other.advice();
        assert!(advice.contains("larger") && advice.ends_with("--mark-size 44..95px"), "{advice}");
        assert_eq!(other.note(), None);
        other.adopted = true;
        assert!(other.note().expect("adopted").contains("71 to 76 px across"));
        let (first_px, side_px) = ([30.0, 60.0], [10.0, 12.0]);
        assert!(OtherSize { first_px, side_px, ..other }.advice().contains("smaller"));
    }
}
