//! Gains, offsets and surfaces of one band from what its pairs say.
//!
//! Gains are least squares in their logarithms, each pair by its variance. Levels and surfaces follow together. How far
//! surfaces are believed follows from the differences themselves: the variance of their coefficients is the most
//! likely one (a variance component; D. A. Harville, *Maximum likelihood approaches to variance component estimation
//! and to related problems*, 1977), and zero unless that is far more likely than none. What overlaps cannot tell – a
//! slope of the whole strip – thus stays out of the surfaces, and levels do not drift.

use super::super::graph::Normal;
use super::blocks::Block;
use super::relation::{Evidence, Pair, Relation};
use super::surface::{Balancing, Frame, TERMS, dot};
use crate::stream::each;
use autoref_raster::ranks::upper_median;
use autoref_raster::sets::Sets;

/// Variance of the logarithm of gains that is expected before anything is known.
const GAIN_VARIANCE: f64 = 0.25;
/// Relations see the surfaces, and these what the relations leave: at least and at most so often.
const FEWEST_ROUNDS: usize = 4;
const MOST_ROUNDS: usize = 16;
/// The common surface has settled when no coefficient moves by more than this share.
const COMMON_SETTLED: f64 = 1e-3;
/// Fewer sources have no surface in common.
const FEWEST_IN_COMMON: usize = 4;
/// A coefficient that all have in common is so many of its mean's standard deviations.
const COMMON_SIGNIFICANCE: f64 = 6.0;
/// Logarithm of the likelihood that surfaces must gain.
const LEAST_GAIN: f64 = 6.0;
/// Differences of a pair weigh as if they had at least this share of the usual variance.
const LEAST_NOISE: f64 = 1e-4;
/// Nor is a whole pair trusted beyond this share of the surfaces' variance: none of them is quite a polynomial, and
/// what little they miss adds up along a strip.
const SURFACE_FLOOR: f64 = 3e-4;

/// What ties sources in one band.
pub struct Ties {
    pub band: usize,
    /// The group of each source: the number of the group's first source.
    pub groups: Vec<usize>,
    /// Pairs whose levels are evened out, and whose contrasts neither they nor others tell.
    pub level_only: Vec<(usize, usize)>,
    /// Blocks of each pair that agree.
    pub agreeing: Vec<usize>,
    /// How far the surface that all have in common departs from its mean, where the reference keeps it.
    pub kept_surface: Option<f64>,
    /// Pairs that overlap without a block that counts.
    pub uncounted: Vec<(usize, usize)>,
}

/// The correction of one band of one source.
pub struct Correction {
    pub gain: f64,
    pub offset: f64,
    pub surface: [f64; TERMS],
}

/// A band that is evened out.
pub struct Band<'a> {
    pub band: usize,
    pub blocks: &'a [Block],
    /// The mean level of each source; NaN where nothing of it was read.
    pub levels: Vec<f64>,
    pub frames: &'a [Frame],
    pub balancing: Balancing,
    pub threads: usize,
}

/// What is known of a band so far.
struct State {
    gains: Vec<f64>,
    /// Of the surfaces' coefficients about those that all have in common, in squares of balanced numbers.
    variance: f64,
    /// The surface that all sources have in common, as that of a lens: in balanced numbers.
    common: [f64; TERMS],
    relations: Vec<Relation>,
}

impl Band<'_> {
    /// Finds the band's corrections, source by source.
    pub fn adjust(&self) -> (Ties, Vec<Correction>) {
        let sources = self.frames.len();
        let terms = self.balancing.surface.terms();
        let overlaps: Vec<&[Block]> = self.blocks.chunk_by(|a, b| a.pair == b.pair).collect();
        let mut pairs = each(overlaps.len(), self.threads, |k| Pair::new(overlaps[k], self.band, self.frames, terms));
        let (gains, common) = (vec![1.0; sources], [0.0; TERMS]);
        let mut state = State { gains, variance: 0.0, common, relations: Vec::new() };
        let mut groups = Vec::new();
        for round in 0..MOST_ROUNDS {
            state = self.round(&pairs, state);
            groups = groups_of(&pairs, &state.relations, sources, |relation| !relation.kept.is_empty());
            let before = state.common;
            if terms == TERMS && state.variance > 0.0 {
                let free = self.unknowns(&pairs, &state, &groups, None);
                state.common = common_surface(&free, &groups, before);
            }
            pairs.iter_mut().for_each(|pair| pair.without(&state.common, &state.gains));
            let moved = before.iter().zip(&state.common).any(|(a, b)| (a - b).abs() > COMMON_SETTLED * b.abs());
            // Without surfaces only a contrast that is not told waits for the others' gains.
            let told = state.relations.iter().all(|relation| relation.ratio.is_some());
            let settled = if terms == 0 { told || round > 0 } else { round + 1 >= FEWEST_ROUNDS && !moved };
            if settled {
                break;
            }
        }
        let corrections = self.corrections(&pairs, &state, &groups);
        let select = |wanted: &dyn Fn(&Relation) -> bool| {
            let found = pairs.iter().zip(&state.relations).filter(|(_, relation)| wanted(relation));
            found.map(|(pair, _)| pair.sources).collect()
        };
        // A gain that others tell is told.
        let contrasts = groups_of(&pairs, &state.relations, sources, |relation| relation.ratio.is_some());
        let mut level_only: Vec<(usize, usize)> = select(&|r| !r.kept.is_empty() && r.ratio.is_none());
        level_only.retain(|(i, j)| contrasts[*i] != contrasts[*j]);
        let ties = Ties {
            band: self.band,
            level_only,
            agreeing: state.relations.iter().map(|r| r.kept.len()).collect(),
            uncounted: select(&|r| r.kept.is_empty()),
            kept_surface: self.balancing.reference.and_then(|source| self.kept_surface(source, &state)),
            groups,
        };
        (ties, corrections)
    }

    /// Relations by the surfaces' variance, gains by these, and the variance by what these leave.
    fn round(&self, pairs: &[Pair], state: State) -> State {
        let State { gains, variance, common, relations } = state;
        let relations = each(pairs.len(), self.threads, |k| {
            let (i, j) = pairs[k].sources;
            // The noise is in numbers of the second source, the variance in balanced ones.
            let noise = relations.get(k).map(|r| r.noise * gains[j] * gains[j]);
            let prior = noise.filter(|_| variance > 0.0).map(|noise| noise / variance);
            pairs[k].relation(prior, gains[i] / gains[j])
        });
        let gains = self.gains(pairs, &relations);
        let variance = surface_variance(pairs, &relations, &gains);
        State { gains, variance, common, relations }
    }

    fn gains(&self, pairs: &[Pair], relations: &[Relation]) -> Vec<f64> {
        let held = (0..self.frames.len()).map(|source| Some(source) == self.balancing.reference).collect();
        let mut normal = Normal::new(1, held);
        for (pair, relation) in pairs.iter().zip(relations) {
            if let Some((ratio, variance)) = relation.ratio {
                normal.tie(pair.sources.0, pair.sources.1);
                normal.observe(&[1.0], &[1.0], ratio, 1.0 / variance);
            }
        }
        normal.pull(&[1.0 / GAIN_VARIANCE]);
        normal.solve().iter().map(|v| v.exp()).collect()
    }

    /// Values are counted from each source's mean level, so that gains do not move that.
    fn level(&self, source: usize) -> f64 {
        if self.levels[source].is_nan() { 0.0 } else { self.levels[source] }
    }

    /// Shifts of levels and surfaces: gain₁·x + o₁ + s₁ = gain₂·y + o₂ + s₂. Those of the reference are held, and the
    /// shift of the first source of each other group.
    fn unknowns(&self, pairs: &[Pair], state: &State, groups: &[usize], reference: Option<usize>) -> Vec<f64> {
        let terms = if state.variance > 0.0 { self.balancing.surface.terms() } else { 0 };
        let moved = |source: usize, value: f64| state.gains[source] * (value - self.level(source)) + self.level(source);
        let held = |source: usize, unknown: usize| {
            let first = groups[source] == source && reference.map(|r| groups[r]) != Some(source);
            reference == Some(source) || first && unknown == 0
        };
        let held = (0..groups.len() * (1 + terms)).map(|k| held(k / (1 + terms), k % (1 + terms))).collect();
        let noises: Vec<f64> = pairs
            .iter()
            .zip(&state.relations)
            .map(|(pair, relation)| relation.noise * state.gains[pair.sources.1].powi(2))
            .collect();
        let mut usual: Vec<f64> = noises.iter().copied().filter(|v| *v > 0.0).collect();
        let floor = upper_median(&mut usual).map_or(1.0, |v| v * LEAST_NOISE);
        let mut normal = Normal::new(1 + terms, held);
        for ((pair, relation), noise) in pairs.iter().zip(&state.relations).zip(noises) {
            let (i, j) = pair.sources;
            let noise = noise.max(floor) + SURFACE_FLOOR * state.variance * relation.kept.len() as f64;
            normal.tie(i, j);
            for &k in &relation.kept {
                let row = |source: usize| {
                    let [a, b, c, d, e] = self.frames[source].basis(pair.blocks[k].centre);
                    [1.0, a, b, c, d, e]
                };
                let (x, y) = pair.values[k];
                let gap = moved(j, y) - moved(i, x);
                normal.observe(&row(i)[..=terms], &row(j)[..=terms], gap, 1.0 / noise);
            }
        }
        let mut pulls = [0.0; 1 + TERMS];
        pulls[1..=terms].fill(if terms > 0 { 1.0 / state.variance } else { 0.0 });
        normal.pull(&pulls[..=terms]);
        normal.solve()
    }

    fn corrections(&self, pairs: &[Pair], state: &State, groups: &[usize]) -> Vec<Correction> {
        let found = self.unknowns(pairs, state, groups, self.balancing.reference);
        let unknowns = found.len() / groups.len();
        let shift = |source: usize| found[source * unknowns];
        // Groups without the reference keep the mean of their levels.
        let mut means = vec![(0.0, 0.0); groups.len()];
        for (source, &group) in groups.iter().enumerate() {
            means[group] = (means[group].0 + shift(source), means[group].1 + 1.0);
        }
        if let Some(source) = self.balancing.reference {
            means[groups[source]] = (0.0, 1.0);
        }
        let correction = |source: usize| {
            let gain = state.gains[source];
            let (sum, n) = means[groups[source]];
            let alone = groups.iter().filter(|group| **group == groups[source]).count() == 1;
            let mut surface = state.common;
            surface
                .iter_mut()
                .zip(&found[source * unknowns + 1..(source + 1) * unknowns])
                .for_each(|(s, own)| *s += own);
            if self.balancing.reference == Some(source) || alone {
                surface = [0.0; TERMS];
            }
            Correction { gain, offset: self.level(source) * (1.0 - gain) + shift(source) - sum / n, surface }
        };
        (0..groups.len()).map(correction).collect()
    }

    /// How far the surface that all have in common departs from its mean over the source that keeps it.
    fn kept_surface(&self, source: usize, state: &State) -> Option<f64> {
        let frame = &self.frames[source];
        let (x, y) = frame.centre;
        let at = |u: f64, v: f64| dot(&state.common, &frame.basis((x + u * frame.half.0, y + v * frame.half.1)));
        let corners =
            [(-1.0, -1.0), (0.0, -1.0), (1.0, -1.0), (-1.0, 0.0), (0.0, 0.0), (1.0, 0.0)].map(|(u, v)| at(u, v));
        let most = corners.into_iter().map(f64::abs).fold(0.0, f64::max);
        (most > 0.0).then_some(most)
    }
}

/// Which sources hang together by relations that tie: the first source of each one's group.
fn groups_of(pairs: &[Pair], relations: &[Relation], sources: usize, ties: impl Fn(&Relation) -> bool) -> Vec<usize> {
    let mut groups = Sets::apart(sources);
    for (pair, _) in pairs.iter().zip(relations).filter(|(_, relation)| ties(relation)) {
        groups.unite(pair.sources.0, pair.sources.1);
    }
    groups.roots().into_iter().map(|first| first as usize).collect()
}

/// What the surfaces of all sources have in common beside `known`: those coefficients of the second degree whose mean
/// stands far out of what they scatter by. A slope that all have in common is one of the ground, for all that overlaps
/// tell.
fn common_surface(free: &[f64], groups: &[usize], known: [f64; TERMS]) -> [f64; TERMS] {
    let tied = |source: usize| groups.iter().filter(|group| **group == groups[source]).count() > 1;
    let sources: Vec<usize> = (0..groups.len()).filter(|source| tied(*source)).collect();
    let n = sources.len() as f64;
    let mut common = [0.0; TERMS];
    if sources.len() < FEWEST_IN_COMMON {
        return common;
    }
    for term in 2..TERMS {
        let own = |source: &usize| free[source * (1 + TERMS) + 1 + term];
        let mean = sources.iter().map(own).sum::<f64>() / n;
        let variance = sources.iter().map(|source| (own(source) - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let whole = known[term] + mean;
        if whole.abs() > COMMON_SIGNIFICANCE * (variance / n).sqrt() {
            common[term] = whole;
        }
    }
    common
}

/// The variance of surfaces' coefficients that is most likely by what surfaces explain in the overlaps, in squares of
/// balanced numbers; 0 where none is not much less likely.
fn surface_variance(pairs: &[Pair], relations: &[Relation], gains: &[f64]) -> f64 {
    let told: Vec<(f64, f64, f64, f64)> = pairs
        .iter()
        .zip(relations)
        .filter_map(|(pair, relation)| {
            let Evidence { explained, leverage, noise } = relation.evidence?;
            let (scale, terms) = (gains[pair.sources.1].powi(2), pair.terms as f64);
            // Mean squares for each of so many terms.
            Some((terms, explained * scale / terms, leverage / terms, noise * scale))
        })
        .filter(|(_, explained, leverage, noise)| explained.is_finite() && *leverage > 0.0 && *noise > 0.0)
        .collect();
    let likelihood = |variance: f64| {
        let of = |&(terms, explained, leverage, noise): &(f64, f64, f64, f64)| {
            let expected = noise + variance * leverage;
            -0.5 * terms * (expected.ln() + explained / expected)
        };
        told.iter().map(of).sum::<f64>()
    };
    let most = told.iter().map(|(_, explained, leverage, _)| explained / leverage).fold(0.0, f64::max);
    // Twenty steps to a power of ten, over six of them.
    let candidates = (-120..=10).map(|step| most * 10f64.powf(f64::from(step) / 20.0));
    let best = candidates.map(|v| (likelihood(v), v)).fold((f64::MIN, 0.0), |a, b| if b.0 > a.0 { b } else { a });
    if best.0 - likelihood(0.0) > LEAST_GAIN { best.1 } else { 0.0 }
}
