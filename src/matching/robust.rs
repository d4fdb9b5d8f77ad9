//! Blind matching by pairs: hypothesise, verify, refine, weigh.
//!
//! An ordered pair of candidates laid on a pair of GCPs fixes a similarity. Pairs of GCPs are taken in order of how
//! many pairs of candidates can be theirs (short ones first when the scale is roughly known: few candidates lie at the
//! right distance), and every hypothesis predicts where the other GCPs must be, most certain first, so that most are
//! dropped after a few looks into an occupancy bitmap. The best of each GCP pair are refined to a least-squares
//! pattern, whose worth is its number of false alarms ([`super::evidence`]), not its residuals.
//! `docs/decisions/matcher.md` argues the choice.

use crate::candidate::Candidate;
use crate::gcp::{Gcp, GcpRole};
use crate::matching::explain::explain;
use crate::matching::grow::GROWN_FROM;
use crate::matching::labels::Names;
use crate::matching::pairs::GcpPair;
use crate::matching::repetition::Repetition;
use crate::matching::search::{Hypothesis, LONG, LOOKS_OF_ONE, REFINED_PER_PAIR, Search, Tried};
use crate::matching::waiting::Waiting;
use crate::matching::{
    Effort, Labels, MatchOutcome, Matcher, NamesAgree, OfImage, Pattern, Priors, SearchEnd, Solved, TimeLimit,
};
use autoref_raster::coords::MapPoint;

/// How much rarer (log₁₀) the best pattern must be than an accident that says something else.
pub(super) const RUNNER_UP_GAP: f64 = 2.0;
/// A rival rarer than this (log₁₀) is hardly an accident: the limit holds against it too.
const SUSPECT_LOG10: f64 = -2.0;
/// A rival rarer than this (log₁₀) is none: something repeats. Which of the two has more marks says little then,
/// because marks are forgotten, hidden and overlooked, unless the rival explains less than half as many.
pub(super) const REPETITION_LOG10: f64 = -4.0;
/// Of a rival's marks the best pattern must join so many to be compared with it mark by mark; fewer say nothing.
const SHARED_MARKS: f64 = 0.8;
const FEWEST_SHARED: usize = 5;
/// Marks agree no better than this, pixels.
const LEAST_DEVIATION_PX: f64 = 0.1;
/// Above this many candidates the best-scored are tried alone first, ...
const GUIDED_ABOVE: usize = 6000;
const GUIDED_FIRST: usize = 2000;
/// ... then this many times as many, and so on to all (after O. Chum and J. Matas, "Matching with PROSAC", 2005):
/// hypotheses grow with the square of the candidates.
const GUIDED_STEP: usize = 4;
/// One part in so many of the budget of hypotheses for each search among fewer than all, and for patterns that grow.
const EARLY_SHARE: u64 = 8;
/// A list that repeats itself is hardly ever believed, a hypothesis about a long list costs more than it is charged,
/// and with a known scale it takes few looks: they get so many percent of the budget.
const REPEATED_PERCENT: u64 = 20;
const LONG_PERCENT: u64 = 70;
const LONG_OF_SCALE_PERCENT: u64 = 50;
/// Without a scale, of longer lists than this less in proportion: what many marks tell is found with little work, what
/// few marks tell with no work that could be waited for.
const VERY_LONG: u64 = 500;
const GROWTH_SHARE: u64 = 3;
/// Without a scale so many times as much is tried as the best take to be refined: a pattern that could be believed is
/// no accident of the whole search, and stands among the six best of many more hypotheses.
const TRIED_PER_REFINED: u64 = 4;
/// How often a rival may take the first place before the last is left there; two so close are refused anyhow.
const MOST_CHALLENGES: usize = 3;

/// The default matcher.
#[derive(Clone, Debug)]
pub struct RobustMatcher {
    /// A pattern is believed when chance alone would produce no more than this many.
    pub max_false_alarms: f64,
    /// The search ends here, found or not (`docs/decisions/search-work.md`).
    pub budget_hypotheses: u64,
    /// How often the caller may call with other priors: each is a chance for a false alarm, and counted.
    pub tries: f64,
    pub time_limit: TimeLimit,
    /// What advice does not ask for.
    pub of_image: OfImage,
}

impl Default for RobustMatcher {
    fn default() -> Self {
        RobustMatcher {
            max_false_alarms: 1e-4,
            budget_hypotheses: 100_000_000,
            tries: 1.0,
            time_limit: TimeLimit::default(),
            of_image: OfImage::default(),
        }
    }
}

impl Matcher for RobustMatcher {
    fn find(&self, candidates: &[Candidate], gcps: &[Gcp], priors: &Priors) -> MatchOutcome {
        let (control, positions) = control_points(gcps);
        let all: Vec<&Candidate> = candidates.iter().collect();
        let labels = Labels::new(gcps);
        if Names::new(&all, &labels, &control).is_none() {
            return self.by_places(candidates, (gcps, &control, &positions), priors);
        }
        // With the names and without them: two chances for a false alarm.
        let twice = RobustMatcher { tries: 2.0 * self.tries, ..self.clone() };
        let found = twice.search_guided(candidates, &positions, priors, Some((&labels, &control)));
        let names = found.names;
        let limit = self.max_false_alarms.log10() - self.tries.log10();
        if names.is_some_and(|names| names.log10_false_alarms <= limit)
            && let solved @ MatchOutcome::Solved(_) = twice.decide(found, candidates.len(), (gcps, &control), priors)
        {
            return solved;
        }
        let mut outcome = twice.by_places(candidates, (gcps, &control, &positions), priors);
        if let MatchOutcome::NoMatch(evidence) = &mut outcome {
            evidence.advice.push(unheeded(names));
        }
        outcome
    }
}

/// What is said of names that did not decide.
fn unheeded(names: Option<NamesAgree>) -> String {
    match names {
        Some(NamesAgree { named, agree, .. }) => format!(
            "{named} marks bear numbers that the list has, but at best {agree} of them agree on one place of the image: check that \
             the labels of the list end in the numbers on the targets"
        ),
        None => "the marks bear numbers that the list has, but no three of them agree on one place of the image: check that the \
                 labels of the list end in the numbers on the targets"
            .to_string(),
    }
}

/// Indices and positions of the points that take part.
pub(super) fn control_points(gcps: &[Gcp]) -> (Vec<usize>, Vec<MapPoint>) {
    let control: Vec<usize> = (0..gcps.len()).filter(|&i| gcps[i].role == GcpRole::Control).collect();
    let positions = control.iter().map(|&i| gcps[i].position()).collect();
    (control, positions)
}

impl RobustMatcher {
    /// Which part of the work of the first search each later one may do, after a refusal of a list of so many points:
    /// one in so many.
    pub fn later_part(points: usize) -> u64 {
        if points < LONG { 4 } else { 8 }
    }

    /// The answer without names. A list that repeats itself is hardly ever believed; the search for it is short.
    fn by_places(
        &self,
        candidates: &[Candidate],
        (gcps, control, positions): (&[Gcp], &[usize], &[MapPoint]),
        priors: &Priors,
    ) -> MatchOutcome {
        let repetition = Repetition::of(positions, priors);
        let points = positions.len() as u64;
        let percent = match repetition {
            Some(_) => REPEATED_PERCENT,
            None if positions.len() < LONG => 100,
            None if priors.narrow_by_scale() => LONG_OF_SCALE_PERCENT,
            None => LONG_PERCENT * VERY_LONG / points.max(VERY_LONG),
        };
        let budget_hypotheses = self.budget_hypotheses * percent / 100;
        let matcher = RobustMatcher { budget_hypotheses, ..self.clone() };
        let found = matcher.search_guided(candidates, positions, priors, None);
        let mut outcome = matcher.decide(found, candidates.len(), (gcps, control), priors);
        if let (MatchOutcome::NoMatch(evidence), Some(repetition)) = (&mut outcome, repetition) {
            evidence.advice.insert(0, repetition.advice());
        }
        outcome
    }

    /// Whether the best pattern is rare enough, by itself and beside the runner-up.
    fn believes(&self, found: &Found, gcps: usize) -> bool {
        let Some(best) = &found.best else { return false };
        let limit = self.max_false_alarms.log10();
        let unlike = |other: &Pattern| {
            let suspect = other.log10_false_alarms <= SUSPECT_LOG10;
            let repeats = other.log10_false_alarms <= REPETITION_LOG10;
            let rarer = other.log10_false_alarms.min(0.0) - best.log10_false_alarms;
            let gap = if suspect { (-limit).max(RUNNER_UP_GAP) } else { RUNNER_UP_GAP };
            let told = !repeats
                || best.pairs.len() > 2 * other.pairs.len()
                || log10_closer_by_chance(best, other, gcps) <= limit;
            rarer >= gap && told
        };
        best.log10_false_alarms <= limit && found.runner_up.as_ref().is_none_or(unlike)
    }

    /// Believes the best pattern, or says why not.
    pub(super) fn decide(
        &self,
        found: Found,
        candidates: usize,
        (gcps, control): (&[Gcp], &[usize]),
        priors: &Priors,
    ) -> MatchOutcome {
        let restore = |pattern: Pattern| Pattern {
            pairs: pattern.pairs.iter().map(|&(c, g)| (c, control[g])).collect(),
            ..pattern
        };
        let believed = self.believes(&found, control.len());
        let (best, runner_up) = (found.best.map(restore), found.runner_up.map(restore));
        let limit = self.max_false_alarms.log10();
        if let Some(pattern) = &best
            && believed
        {
            return MatchOutcome::Solved(Box::new(Solved {
                pattern: pattern.clone(),
                runner_up,
                effort: found.effort,
                names: found.names,
            }));
        }
        let (effort, known) = ((found.effort, limit), (priors, self.of_image));
        MatchOutcome::NoMatch(Box::new(explain(candidates, (gcps, control), best, runner_up, effort, known)))
    }
}

/// log₁₀ of the number of patterns that would lie on a rival's marks as closely as `best` does if the rival were true;
/// 0 where that says nothing. A pattern on these marks follows from the two of the list's GCPs that it lays on two of
/// them.
///
/// A layout that is nearly regular (two rows along a road) fits itself when it is moved on by a place, to the
/// irregularity of its rows; the true place fits to the centring of the marks. If the rival is true, its deviations are
/// all the noise there is, and whatever else lies on its marks deviates by no less. That n marks do by a share ρ of it
/// has at most the probability (ρ²·e^(1 − ρ²))^(n − 2) (H. Chernoff, "A measure of asymptotic efficiency for tests of
/// a hypothesis based on the sum of observations", 1952, for χ² with 2n − 4 degrees of freedom).
fn log10_closer_by_chance(best: &Pattern, rival: &Pattern, gcps: usize) -> f64 {
    let joined = |candidate: usize| best.pairs.iter().any(|pair| pair.0 == candidate);
    let shared = rival.pairs.iter().filter(|pair| joined(pair.0)).count();
    let share2 = (best.deviation_px.max(LEAST_DEVIATION_PX) / rival.deviation_px).powi(2);
    if shared < FEWEST_SHARED
        || (shared as f64) < SHARED_MARKS * rival.pairs.len() as f64
        || share2.is_nan()
        || share2 >= 1.0
    {
        return 0.0;
    }
    let ln_chance = (shared as f64 - 2.0) * (share2.ln() + 1.0 - share2);
    (gcps as f64).powi(2).log10() + ln_chance / std::f64::consts::LN_10
}

/// What a search has done of what it may do, counted as hypotheses: the looks that each of them took are in it, and
/// what a pattern costs that is refined.
#[derive(Default)]
struct Work {
    done: u64,
    allowed: u64,
    gcps: u64,
    /// What pairs of GCPs took so far.
    tried: Tried,
    /// Looks at other GCPs that a hypothesis takes, before any is tried.
    looks: u64,
    /// What trying took since the last were refined, and how many times what refining takes it is to be.
    since_refined: u64,
    tried_per_refined: u64,
    /// Patterns refined, and what they took.
    refined: (u64, u64),
}

impl Work {
    /// What so many hypotheses cost with their looks.
    fn cost(tried: Tried) -> u64 {
        tried.hypotheses + tried.looks / LOOKS_OF_ONE
    }

    /// What a hypothesis costs, so far as it is known.
    fn each(&self) -> u64 {
        let expected = Tried { hypotheses: 1, looks: self.looks };
        Work::cost(self.tried).checked_div(self.tried.hypotheses).unwrap_or(0).max(Work::cost(expected))
    }

    /// As many hypotheses as the same work does that take every look.
    fn as_with_every_look(&self, tried: Tried) -> u64 {
        Work::cost(tried) / Work::cost(Tried { hypotheses: 1, looks: self.gcps })
    }

    fn hypotheses_left(&self) -> u64 {
        self.allowed.saturating_sub(self.done) / self.each()
    }

    fn tried(&mut self, tried: Tried) {
        self.tried = self.tried + tried;
        // Laying out a pair of GCPs against all others costs too.
        let cost = Work::cost(tried) + self.gcps;
        self.done += cost;
        self.since_refined += cost;
    }

    /// How much is tried before the best are refined.
    fn before_refining(&self) -> u64 {
        let (patterns, cost) = self.refined;
        self.tried_per_refined * REFINED_PER_PAIR as u64 * cost.checked_div(patterns).unwrap_or(10 * self.gcps)
    }

    /// Whether so much was tried since the last were refined.
    fn is_worth_refining(&self) -> bool {
        self.since_refined >= self.before_refining()
    }

    /// How many of the next pairs, one at least, are about enough for it and no more than may be done.
    fn worth_refining(&self, pairs: &[GcpPair], hypotheses_left: u64) -> usize {
        let (mut cost, mut hypotheses) = (self.since_refined, 0);
        let each = self.each();
        let few = pairs.iter().take_while(|pair| {
            let is_wanted = cost < self.before_refining();
            cost += pair.hypotheses() * each + self.gcps;
            hypotheses += pair.hypotheses();
            is_wanted && hypotheses <= hypotheses_left
        });
        few.count().max(1)
    }

    /// Some weighings, each of every point in the image against every other.
    fn refined(&mut self, pattern: Option<&Pattern>) {
        let inside = pattern.map_or(0, |pattern| pattern.gcps_in_image as u64);
        let cost = 10 * self.gcps + inside * inside;
        self.done += cost;
        self.refined = (self.refined.0 + 1, self.refined.1 + cost);
        self.since_refined = 0;
    }
}

/// The best two patterns of a search.
#[derive(Default)]
pub(super) struct Found {
    pub best: Option<Pattern>,
    pub runner_up: Option<Pattern>,
    pub effort: Effort,
    /// Of the best, when names were heeded.
    pub names: Option<NamesAgree>,
}

/// Labels and the points that take part, where names are heeded.
type Heeded<'a> = Option<(&'a Labels, &'a [usize])>;

impl Found {
    /// Where the best pattern can be told from a rival more sharply, by other points.
    fn tell_apart(&mut self, search: &Search) {
        let Some((sharper, other)) = self.best.as_ref().and_then(|best| search.told_apart(best)) else { return };
        self.best = Some(sharper);
        let rarer =
            |one: &Pattern| self.runner_up.as_ref().is_none_or(|two| one.log10_false_alarms < two.log10_false_alarms);
        if let Some(other) = other.filter(rarer) {
            self.runner_up = Some(other);
        }
    }

    /// Sets the pattern that would be believed against its rivals, `done` of the `pairs` being tried already. A rival
    /// that takes the first place must answer the same questions.
    fn challenge(&mut self, search: &Search, pairs: &[GcpPair], limit: f64, (done, work): (usize, &Work)) {
        for _ in 0..MOST_CHALLENGES {
            self.sharpen(search, pairs, limit);
            let Some(best) = self.best.clone().filter(|best| best.log10_false_alarms <= limit) else { break };
            let spent = work.as_with_every_look(work.tried);
            let (rivals, tried) = search.rivals(&best, pairs, (done, spent));
            self.effort.hypotheses_tried += tried;
            rivals.into_iter().for_each(|rival| self.take(rival, search));
            if self.best.as_ref().is_some_and(|now| search.same_claim(now, &best)) {
                break;
            }
        }
    }

    /// The pattern that would be believed, without marks that stand beside their points.
    fn sharpen(&mut self, search: &Search, pairs: &[GcpPair], limit: f64) {
        let believed = self.best.as_ref().filter(|best| best.log10_false_alarms <= limit);
        let Some(sharper) = believed.and_then(|best| search.sharper(best, pairs, self.effort.hypotheses_possible))
        else {
            return;
        };
        if self.runner_up.as_ref().is_some_and(|other| search.same_claim(other, &sharper)) {
            self.runner_up = None;
        }
        self.best = Some(sharper);
    }

    /// Takes what these are refined to.
    fn refine(&mut self, hypotheses: Vec<(&GcpPair, Hypothesis)>, search: &Search, work: &mut Work) {
        for pattern in search.refine_all(hypotheses) {
            work.refined(pattern.as_ref());
            if let Some(pattern) = pattern {
                self.take(pattern, search);
            }
        }
    }

    /// Takes in a pattern, when it is better than one of the best two.
    pub fn take(&mut self, pattern: Pattern, search: &Search) {
        let better = |one: &Pattern, other: &Option<Pattern>| {
            other.as_ref().is_none_or(|o| one.log10_false_alarms < o.log10_false_alarms)
        };
        if better(&pattern, &self.best) {
            let old = self.best.replace(pattern);
            let best = self.best.as_ref().expect("just placed");
            if self.runner_up.as_ref().is_some_and(|r| search.same_claim(r, best)) {
                self.runner_up = None;
            }
            let old = old.filter(|old| !search.same_claim(old, best)).map(|old| search.apart_from(best, old));
            if let Some(old) = old.filter(|old| better(old, &self.runner_up)) {
                self.runner_up = Some(old);
            }
        } else if let Some(best) = self.best.as_ref().filter(|best| !search.same_claim(best, &pattern))
            && better(&pattern, &self.runner_up)
        {
            let rival = search.apart_from(best, pattern);
            if better(&rival, &self.runner_up) {
                self.runner_up = Some(rival);
            }
        }
    }
}

impl RobustMatcher {
    /// All candidates; of very many first the best-scored, then more and more of them.
    fn search_guided(&self, candidates: &[Candidate], gcps: &[MapPoint], priors: &Priors, heeded: Heeded<'_>) -> Found {
        let some = |indices: &[usize]| indices.iter().map(|&i| &candidates[i]).collect::<Vec<_>>();
        let all: Vec<usize> = (0..candidates.len()).collect();
        if candidates.len() <= GUIDED_ABOVE || candidates.iter().any(|c| c.score.is_none()) {
            return self.search(&some(&all), gcps, (priors, heeded), self.tries.log10(), self.budget_hypotheses);
        }
        let mut ranked = all.clone();
        let score = |i: usize| candidates[i].score.unwrap_or(f64::NEG_INFINITY);
        ranked.sort_by(|&a, &b| score(b).total_cmp(&score(a)).then(a.cmp(&b)));
        let rungs: Vec<usize> = std::iter::successors(Some(GUIDED_FIRST), |n| Some(n * GUIDED_STEP))
            .take_while(|n| 2 * n < candidates.len())
            .collect();
        // Every search is a chance for a false alarm.
        let log10_searches = ((1 + rungs.len()) as f64 * self.tries).log10();
        let early = self.budget_hypotheses / EARLY_SHARE;
        let last = self.budget_hypotheses.saturating_sub(rungs.len() as u64 * early).max(early);
        for rung in rungs {
            let ranked = &ranked[..rung];
            let mut found = self.search(&some(ranked), gcps, (priors, heeded), log10_searches, early);
            if self.believes(&found, gcps.len()) {
                for pattern in found.best.iter_mut().chain(found.runner_up.iter_mut()) {
                    pattern.pairs.iter_mut().for_each(|pair| pair.0 = ranked[pair.0]);
                }
                return found;
            }
        }
        self.search(&some(&all), gcps, (priors, heeded), log10_searches, last)
    }

    fn search(
        &self,
        candidates: &[&Candidate],
        gcps: &[MapPoint],
        (priors, heeded): (&Priors, Heeded<'_>),
        log10_searches: f64,
        budget: u64,
    ) -> Found {
        let mut found = Found::default();
        if candidates.len() < 3 || gcps.len() < 3 {
            return found;
        }
        let Some((search, pairs, possible)) = Search::new(candidates, gcps, priors, log10_searches) else {
            return found;
        };
        let names = heeded.and_then(|(labels, control)| Names::new(candidates, labels, control));
        let search = search.heeding(names);
        found.effort.hypotheses_possible = possible;
        let limit = self.max_false_alarms.log10();
        if candidates.len() >= GROWN_FROM && !self.time_limit.is_over() {
            let (patterns, tried) = search.grown(&pairs, budget / GROWTH_SHARE);
            found.effort.hypotheses_tried += tried;
            patterns.into_iter().for_each(|pattern| found.take(pattern, &search));
        }
        let mut done = 0;
        let screening = search.screening(limit, pairs.len());
        let gcps = gcps.len() as u64;
        let looks = gcps.min(screening.first_looks as u64);
        let done_before = found.effort.hypotheses_tried;
        let tried_per_refined = if priors.narrow_by_scale() { 1 } else { TRIED_PER_REFINED };
        let mut work = Work { done: done_before, allowed: budget, gcps, looks, tried_per_refined, ..Work::default() };
        let mut waiting = Waiting::new();
        // One decade below the limit chance has no say any more; repetition is asked about below. A pattern that leaves
        // out most of what is expected in the image does not end the search: a better one may be made of its points.
        let is_settled =
            |found: &Found| found.best.as_ref().is_some_and(|best| best.log10_whole_false_alarms <= limit - 1.0);
        let enough = screening.pairs.min(pairs.len());
        while done < enough && !is_settled(&found) {
            if self.time_limit.is_over() {
                found.effort.ended = SearchEnd::TimeLimit;
                break;
            }
            let left = work.hypotheses_left();
            let together = &pairs[done..done + work.worth_refining(&pairs[done..enough], left)];
            let looks = (screening.first_looks, waiting.bar());
            let tried = search.try_pairs(together, looks, left);
            done += together.len();
            for (pair, (hypotheses, tried)) in together.iter().zip(tried) {
                found.effort.hypotheses_tried += tried.hypotheses;
                work.tried(tried);
                waiting.take(pair, hypotheses);
            }
            if work.is_worth_refining() {
                found.refine(waiting.next(), &search, &mut work);
            }
            if left < together[0].hypotheses() || work.hypotheses_left() == 0 {
                found.effort.ended = SearchEnd::BudgetSpent;
                break;
            }
        }
        found.refine(waiting.next(), &search, &mut work);
        found.challenge(&search, &pairs, limit, (done, &work));
        found.tell_apart(&search);
        if let Some(sure) = found.best.as_ref().and_then(|best| search.without_doubtful_far(best)) {
            found.best = Some(sure);
        }
        found.names = found.best.as_ref().and_then(|best| search.names_agree(best));
        found
    }
}
