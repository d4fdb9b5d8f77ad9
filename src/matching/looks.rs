//! Many hypotheses about one pair of GCPs at once: which of them may hit as many others as they must.
//!
//! A hypothesis is dropped after a few looks into bitmaps. One at a time most of that is waiting for branches; here a
//! look is taken for several hypotheses together, without a branch, in single precision, and says that there may be a
//! candidate wherever there is one. Of what is left only that is scored which may be among the best of its pair.

// Loads that are known to lie in a bitmap.
#![allow(unsafe_code)]

use crate::matching::bar::Bar;
use crate::matching::bitmap::Bitmap;
use crate::matching::pairs::GcpPair;
use crate::matching::search::{
    Demand, Hypothesis, Laid, MayHit, REFINED_PER_PAIR, Search, Span, Tried, cost_of_choice, keep_best,
};
use crate::matching::targets::{Target, Targets};
use autoref_raster::coords::PixelPoint;
use autoref_raster::simd::{Kernel, widest};

/// Hypotheses that a look is taken for together.
const LANES: usize = 16;
/// Looks of which one takes as long as to seek the candidate that is nearest to a target.
const LOOKS_OF_HIT: usize = 40;
/// Hypotheses of a batch.
const BATCH: usize = 64;

/// Hypotheses about a pair on their way through the looks: the first few, and all.
pub(super) struct Looking<'s> {
    fresh: Batch,
    seen: Seen,
    later: Later<'s>,
    hypotheses: u64,
}

impl<'s> Looking<'s> {
    pub fn new(search: &'s Search<'s>, pair: &GcpPair, (demand, bar): (Demand, &'s Bar<'s>)) -> Self {
        let view = View { search, span: search.span(pair) };
        let (noticed, seen) = (Batch::new(), Seen::default());
        let later = Later { view, demand, bar, noticed, seen, may_hit: Vec::new(), best: Vec::new(), looks: 0 };
        Looking { fresh: Batch::new(), seen: Seen::default(), later, hypotheses: 0 }
    }

    /// The hypothesis with these points at the ends; the targets are the same for all.
    #[inline]
    pub fn take(&mut self, targets: &Targets<'_>, ends: (usize, usize)) {
        self.hypotheses += 1;
        if self.later.demand.first_looks >= targets.len() {
            self.later.take(targets, ends);
        } else if self.fresh.push(ends) == BATCH {
            self.first_looks(targets);
        }
    }

    #[inline(never)]
    fn first_looks(&mut self, targets: &Targets<'_>) {
        let Looking { fresh, seen, later, .. } = self;
        let first = targets.first(later.demand.first_looks);
        let view = later.view;
        fresh.drain(|ends, used| {
            seen.look(&view, first, ends);
            for lane in 0..used {
                later.looks += (first.len() + LOOKS_OF_HIT * seen.count(lane)) as u64;
                let hypothesis = view.hypothesis(ends.of(lane));
                // Most of what may be a hit here is none: to ask costs less than all the other looks.
                if seen.of(lane).any(|k| view.search.hit(hypothesis, &first[k]).is_some()) {
                    later.take(targets, ends.of(lane));
                }
            }
        });
    }

    /// The most surprising of all that were taken, best first, and what that took. The looks are counted so that they
    /// do not depend on what was passed over.
    pub fn best(mut self, targets: &Targets<'_>) -> (Vec<Hypothesis>, Tried) {
        if self.fresh.len > 0 {
            self.first_looks(targets);
        }
        self.later.all_looks(targets);
        keep_best(&mut self.later.best);
        (self.later.best, Tried { hypotheses: self.hypotheses, looks: self.later.looks })
    }
}

/// What the first looks left.
struct Later<'s> {
    view: View<'s>,
    demand: Demand,
    bar: &'s Bar<'s>,
    noticed: Batch,
    seen: Seen,
    /// Room for the targets that one hypothesis may hit.
    may_hit: Vec<MayHit>,
    best: Vec<Hypothesis>,
    /// Looks taken.
    looks: u64,
}

impl Later<'_> {
    #[inline]
    fn take(&mut self, targets: &Targets<'_>, ends: (usize, usize)) {
        if self.noticed.push(ends) == BATCH {
            self.all_looks(targets);
        }
    }

    #[inline(never)]
    fn all_looks(&mut self, targets: &Targets<'_>) {
        if self.noticed.len == 0 {
            return;
        }
        let targets = targets.all();
        let Later { view, demand, bar, noticed, seen, may_hit, best, looks } = self;
        noticed.drain(|ends, used| {
            seen.look(view, targets, ends);
            for lane in 0..used {
                let count = seen.count(lane);
                *looks += targets.len() as u64;
                if count < demand.fewest {
                    continue;
                }
                *looks += (targets.len() + LOOKS_OF_HIT * count) as u64;
                may_hit.clear();
                may_hit.extend(seen.of(lane).map(|k| view.search.may_hit(targets, k)));
                let Some(hypothesis) = view.scored(may_hit, targets, ends.of(lane), (*demand, bar)) else {
                    continue;
                };
                bar.raise(hypothesis.score);
                best.push(hypothesis);
                if best.len() >= 4 * REFINED_PER_PAIR {
                    keep_best(best);
                }
            }
        });
    }
}

/// What looks at a few hypotheses say of each target: whether it may have a candidate.
#[derive(Default)]
struct Seen {
    /// Of each 32 targets a bit each, for every lane.
    words: Vec<[u32; LANES]>,
    /// The cell of each bitmap in which the first end lies, column and row, for every lane.
    from: Vec<[[f32; LANES]; 2]>,
}

impl Seen {
    fn look(&mut self, view: &View<'_>, targets: &[Target], ends: &Ends) {
        self.words.resize(targets.len().div_ceil(32), [0; LANES]);
        view.cells_of(ends, &mut self.from);
        widest(Looks { view, targets, ends, from: &self.from, words: &mut self.words });
    }

    fn count(&self, lane: usize) -> usize {
        self.words.iter().map(|words| words[lane].count_ones() as usize).sum()
    }

    /// The targets that may have a candidate, in their order.
    fn of(&self, lane: usize) -> impl Iterator<Item = usize> {
        self.words.iter().enumerate().flat_map(move |(at, words)| {
            let left = |word: &u32| Some(word & (word - 1)).filter(|left| *left != 0);
            std::iter::successors(Some(words[lane]).filter(|word| *word != 0), left)
                .map(move |left| 32 * at + left.trailing_zeros() as usize)
        })
    }
}

/// The highest score that a hypothesis can have when no others than these targets are hit: hits that say less than
/// choosing them costs add nothing, and the fewer are hit the more a choice costs.
fn most_score(may_hit: &[MayHit], inside: usize) -> f64 {
    let choice = cost_of_choice(may_hit.len().max(1), inside);
    may_hit.iter().map(|may_hit| (may_hit.surprise - choice).max(0.0)).sum()
}

/// The points at the two ends of a few hypotheses.
#[derive(Clone, Copy)]
struct Ends {
    first: [u32; LANES],
    second: [u32; LANES],
}

impl Ends {
    #[inline]
    fn of(&self, lane: usize) -> (usize, usize) {
        (self.first[lane] as usize, self.second[lane] as usize)
    }
}

/// Hypotheses that wait for a look.
struct Batch {
    len: usize,
    ends: [Ends; BATCH / LANES],
}

impl Batch {
    fn new() -> Batch {
        Batch { len: 0, ends: [Ends { first: [0; LANES], second: [0; LANES] }; BATCH / LANES] }
    }

    /// Adds one; gives how many there are.
    ///
    /// # Panics
    /// When the batch is full.
    #[inline]
    fn push(&mut self, (first, second): (usize, usize)) -> usize {
        let (ends, lane) = (&mut self.ends[self.len / LANES], self.len % LANES);
        (ends.first[lane], ends.second[lane]) = (first as u32, second as u32);
        self.len += 1;
        self.len
    }

    /// Empties the batch: calls `each` with its hypotheses in their order, some at a time, and how many count.
    #[inline]
    fn drain(&mut self, mut each: impl FnMut(&Ends, usize)) {
        let len = std::mem::take(&mut self.len);
        for (first, ends) in (0..len).step_by(LANES).zip(&self.ends) {
            each(ends, (len - first).min(LANES));
        }
    }
}

/// The field as a pair of GCPs is laid on it.
#[derive(Clone, Copy)]
struct View<'a> {
    search: &'a Search<'a>,
    span: Span,
}

/// From here on single floats are whole numbers, and the lower bits say which.
const INTEGERS: f32 = (1u32 << 23) as f32;

/// The whole part of a number of cells, the nearest that there is; on the border between two cells either of them.
#[inline(always)]
fn cell(v: f32, cells: f32) -> u32 {
    let v = if v > 0.5 { v } else { 0.5 };
    let v = if v < cells - 0.5 { v } else { cells - 0.5 };
    (v + (INTEGERS - 0.5)).to_bits() & 0x7F_FFFF
}

/// Writes down of each target whether it may have a candidate.
struct Looks<'a> {
    view: &'a View<'a>,
    targets: &'a [Target],
    ends: &'a Ends,
    from: &'a [[[f32; LANES]; 2]],
    words: &'a mut [[u32; LANES]],
}

impl Kernel for Looks<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Looks { view, targets, ends, from, words } = self;
        let z = view.factors(ends);
        for (targets, words) in targets.chunks(32).zip(words) {
            let mut seen = [0u32; LANES];
            for (place, target) in targets.iter().enumerate() {
                let bits = view.sight_of(target).look(&from[target.bitmap], &z);
                for lane in 0..LANES {
                    seen[lane] |= bits[lane] << place;
                }
            }
            *words = seen;
        }
    }
}

impl<'a> View<'a> {
    fn hypothesis(&self, ends: (usize, usize)) -> Laid {
        let View { search, span } = self;
        let points = search.field.points();
        let (from, to) = (points[ends.0], points[ends.1]);
        Laid { ends, from, z: span.factor(from, to) }
    }

    /// The cells of all bitmaps in which the first ends lie.
    fn cells_of(&self, ends: &Ends, cells: &mut Vec<[[f32; LANES]; 2]>) {
        let points = self.search.field.points();
        cells.clear();
        cells.extend(self.search.bitmaps.iter().map(|bitmap| {
            let (mut columns, mut rows) = ([0.0; LANES], [0.0; LANES]);
            for lane in 0..LANES {
                let (column, row) = bitmap.cell_of(points[ends.first[lane] as usize]);
                (columns[lane], rows[lane]) = (column as f32, row as f32);
            }
            [columns, rows]
        }));
    }

    /// The hypothesis with its score, where it may be among the best of its pair.
    #[inline]
    fn scored(
        &self,
        may_hit: &[MayHit],
        targets: &[Target],
        ends: (usize, usize),
        (demand, bar): (Demand, &Bar<'_>),
    ) -> Option<Hypothesis> {
        let laid = self.hypothesis(ends);
        let inside = self.search.inside(laid, targets);
        if !bar.lets_by(most_score(may_hit, inside)) {
            return None;
        }
        let score = self.search.verify(laid, targets, (may_hit, inside), demand)?;
        Some(Hypothesis { score, i: ends.0 as u32, j: ends.1 as u32 })
    }

    /// The factors of the hypotheses with these ends, real and imaginary parts.
    #[inline(always)]
    fn factors(&self, ends: &Ends) -> [[f32; LANES]; 2] {
        let View { search, span } = self;
        let points = search.field.points();
        let (mut x_px, mut y_px) = ([0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            let (from, to) = (points[ends.first[lane] as usize], points[ends.second[lane] as usize]);
            (x_px[lane], y_px[lane]) = (to.x - from.x, to.y - from.y);
        }
        let origin = PixelPoint { x: 0.0, y: 0.0 };
        let (mut z_re, mut z_im) = ([0f32; LANES], [0f32; LANES]);
        for lane in 0..LANES {
            let z = span.factor(origin, PixelPoint { x: x_px[lane], y: y_px[lane] });
            (z_re[lane], z_im[lane]) = (z.0 as f32, z.1 as f32);
        }
        [z_re, z_im]
    }

    #[inline(always)]
    fn sight_of(&self, target: &Target) -> Sight<'a> {
        let bitmap: &'a Bitmap = &self.search.bitmaps[target.bitmap];
        Sight {
            words: &bitmap.bits,
            columns: bitmap.columns as u32,
            cells: [bitmap.columns as f32, bitmap.rows as f32],
            offset: [(target.east * bitmap.cells_per_px) as f32, (target.north * bitmap.cells_per_px) as f32],
        }
    }
}

/// A target's bitmap and its offset, in its cells.
struct Sight<'a> {
    words: &'a [u32],
    columns: u32,
    cells: [f32; 2],
    /// East and north from the pair's first GCP.
    offset: [f32; 2],
}

impl Sight<'_> {
    /// For each hypothesis 1 where a candidate may be, 0 elsewhere.
    #[inline(always)]
    fn look(&self, [x0, y0]: &[[f32; LANES]; 2], [z_re, z_im]: &[[f32; LANES]; 2]) -> [u32; LANES] {
        let Sight { words, columns, cells, offset: [east, north] } = self;
        let (mut at, mut bits) = ([0u32; LANES], [0u32; LANES]);
        for lane in 0..LANES {
            let (re, im) = (z_re[lane], z_im[lane]);
            let column = cell(x0[lane] + (re * east - im * north), cells[0]);
            let row = cell(y0[lane] - (re * north + im * east), cells[1]);
            at[lane] = row * columns + column;
        }
        for lane in 0..LANES {
            debug_assert!((at[lane] as usize) < words.len() * 32, "a cell of the bitmap");
            // SAFETY: `cell` is a whole number below that of the rows, or columns, whatever it is asked for; the bitmap
            // has a bit for each of its cells.
            let word = unsafe { *words.get_unchecked(at[lane] as usize / 32) };
            bits[lane] = word >> (at[lane] % 32) & 1;
        }
        bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate::Candidate;
    use crate::matching::Priors;
    use autoref_raster::coords::MapPoint;
    use autoref_raster::random::SplitMix64;

    /// 300 candidates anywhere and 12 GCPs.
    fn anything() -> (Vec<Candidate>, Vec<MapPoint>, Priors) {
        let mut random = SplitMix64(11);
        let mut unit = || random.unit();
        let candidate = |x: f64, y: f64| Candidate::at(PixelPoint { x, y });
        let candidates = (0..300).map(|_| candidate(2000.0 * unit(), 1500.0 * unit())).collect();
        let gcps = (0..12).map(|_| MapPoint { easting: 60.0 * unit(), northing: 45.0 * unit() }).collect();
        (candidates, gcps, Priors { image_size_px: Some((2000.0, 1500.0)), ..Priors::default() })
    }

    #[test]
    fn looks_at_many_answer_as_one_at_a_time() {
        let (candidates, gcps, priors) = anything();
        let all: Vec<&Candidate> = candidates.iter().collect();
        let (search, pairs, _) = Search::new(&all, &gcps, &priors, 0.0).expect("hypotheses are possible");
        let (mut hits, mut more) = (0, 0);
        for pair in &pairs[..20] {
            let targets = search.targets(pair, search.tolerance_px, usize::MAX);
            let targets = targets.all();
            let view = View { search: &search, span: search.span(pair) };
            for first in (20..260).step_by(4 * LANES) {
                let second = std::array::from_fn(|lane| first + 4 * lane as u32);
                let ends = Ends { first: std::array::from_fn(|lane| (pair.a + lane / 5) as u32), second };
                let (mut one, mut other, mut from) = (vec![[0; LANES]; 1], vec![[0; LANES]; 1], Vec::new());
                view.cells_of(&ends, &mut from);
                Looks { view: &view, targets, ends: &ends, from: &from, words: &mut one }.run();
                widest(Looks { view: &view, targets, ends: &ends, from: &from, words: &mut other });
                assert_eq!(one, other);
                let seen = Seen { words: one, from };
                for lane in 0..LANES {
                    let laid = view.hypothesis(ends.of(lane));
                    for (k, target) in targets.iter().enumerate() {
                        let p = laid.place(target);
                        let expected = search.field.contains(p) && search.bitmaps[target.bitmap].may_hold(p);
                        let found = seen.of(lane).any(|of| of == k);
                        // Beside a border between cells single precision may find one more, never one less.
                        assert!(found || !expected, "target {k}");
                        hits += usize::from(expected);
                        more += usize::from(found && !expected);
                    }
                    assert_eq!(seen.count(lane), seen.of(lane).count());
                }
            }
        }
        assert!(hits > 100 && more < hits / 50, "{hits}, {more} more");
    }

    /// The best of a pair are those of all hypotheses that are scored one by one, whatever was passed over.
    #[test]
    fn what_is_passed_over_is_none_of_the_best() {
        let (candidates, gcps, priors) = anything();
        let all: Vec<&Candidate> = candidates.iter().collect();
        let (search, pairs, _) = Search::new(&all, &gcps, &priors, 0.0).expect("hypotheses are possible");
        let mut passed = 0;
        for (pair, first_looks) in pairs[..12].iter().zip([2, 4, usize::MAX].into_iter().cycle()) {
            let (best, tried) = search.try_pair(pair, first_looks, u64::MAX);
            let targets = search.targets(pair, search.tolerance_px, usize::MAX);
            let demand = Demand { fewest: search.fewest_hits(&targets, search.tolerance_px), first_looks };
            let targets = targets.all();
            let may_hit: Vec<MayHit> = (0..targets.len()).map(|k| search.may_hit(targets, k)).collect();
            let mut expected = Vec::new();
            for i in 0..candidates.len() {
                let view = View { search: &search, span: search.span(pair) };
                search.ends_of(pair, i, |j, _| {
                    let laid = view.hypothesis((i, j));
                    let inside = search.inside(laid, targets);
                    let score = search.verify(laid, targets, (&may_hit, inside), demand);
                    expected.extend(score.map(|score| Hypothesis { score, i: i as u32, j: j as u32 }));
                });
            }
            passed += tried.hypotheses as usize - expected.len();
            keep_best(&mut expected);
            let of = |h: &Hypothesis| (h.i, h.j, h.score.to_bits());
            assert_eq!(best.iter().map(of).collect::<Vec<_>>(), expected.iter().map(of).collect::<Vec<_>>());
            assert_eq!(best.len(), REFINED_PER_PAIR);
        }
        assert!(passed > 10_000, "{passed} hypotheses have too few hits");
    }
}
