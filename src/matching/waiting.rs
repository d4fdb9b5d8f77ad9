//! Hypotheses that wait to be refined: the best of pairs of GCPs that are tried one after another.
//!
//! What a long list takes to refine six hypotheses is worth thousands of looks; a pair of GCPs in a small field has
//! fewer. Then the best of several pairs are refined together: a pattern that could be believed hits far more than
//! chance does and stands at their head.

use crate::matching::bar::Bar;
use crate::matching::pairs::GcpPair;
use crate::matching::search::{Hypothesis, REFINED_PER_PAIR};

/// The most surprising hypotheses of the pairs since the last were refined.
pub(super) struct Waiting<'p> {
    best: Vec<(&'p GcpPair, Hypothesis)>,
    bar: Bar<'static>,
}

impl<'p> Waiting<'p> {
    /// Nothing waits yet.
    pub fn new() -> Waiting<'p> {
        Waiting { best: Vec::new(), bar: Bar::of(REFINED_PER_PAIR) }
    }

    /// What a hypothesis must reach to be one of them.
    pub fn bar(&self) -> &Bar<'static> {
        &self.bar
    }

    /// Keeps the best of these and of those that wait; of equals the earlier.
    pub fn take(&mut self, pair: &'p GcpPair, hypotheses: Vec<Hypothesis>) {
        hypotheses.iter().for_each(|hypothesis| self.bar.raise(hypothesis.score));
        self.best.extend(hypotheses.into_iter().map(|hypothesis| (pair, hypothesis)));
        self.best.sort_by(|s, t| t.1.score.total_cmp(&s.1.score));
        self.best.truncate(REFINED_PER_PAIR);
    }

    /// All of them, the best first; none wait then.
    pub fn next(&mut self) -> Vec<(&'p GcpPair, Hypothesis)> {
        std::mem::replace(self, Waiting::new()).best
    }
}
