//! Many hypotheses about one pair of GCPs at once: which of them may hit as many others as they must.
//!
//! A hypothesis is dropped after a few looks into bitmaps. One at a time most of that is waiting for branches; here a
//! look is taken for several hypotheses together, without a branch, in single precision. Where
//! [`may_hold`](crate::matching::bitmap::Bitmap::may_hold) says that there may be a candidate it says so too, so what
//! it drops would be dropped anyway.

use crate::matching::search::{Demand, GcpPair, Hypothesis, REFINED_PER_PAIR, Search, Span, Target, keep_best};
use autoref_raster::coords::PixelPoint;
use autoref_raster::simd::{Kernel, widest};

/// Hypotheses that a look is taken for together.
const LANES: usize = 16;
/// Hypotheses of a batch.
const BATCH: usize = 64;

/// Hypotheses with one first end on their way through the looks: the first few, all, and the nearest candidates.
pub(super) struct Looking<'s> {
    fresh: Batch,
    later: Later<'s>,
}

impl<'s> Looking<'s> {
    /// With point `i` at the first end of the pair.
    pub fn new(search: &'s Search<'s>, pair: &GcpPair, demand: Demand, i: usize) -> Self {
        let view = View { search, span: search.span(pair), i };
        Looking { fresh: Batch::new(), later: Later { view, demand, noticed: Batch::new(), best: Vec::new() } }
    }

    /// The hypothesis with point `j` at the second end.
    #[inline]
    pub fn take(&mut self, targets: &[Target], j: usize) {
        if self.later.demand.first_looks >= targets.len() {
            self.later.take(targets, j);
        } else if self.fresh.push(j) == BATCH {
            self.first_looks(targets);
        }
    }

    #[inline(never)]
    fn first_looks(&mut self, targets: &[Target]) {
        let Looking { fresh, later } = self;
        let view = later.view;
        fresh.drain_noticed(&view, &targets[..later.demand.first_looks], 1, |j| later.take(targets, j));
    }

    /// The most surprising of all that were taken, best first.
    pub fn best(mut self, targets: &[Target]) -> Vec<Hypothesis> {
        if self.fresh.len > 0 {
            self.first_looks(targets);
        }
        self.later.all_looks(targets);
        keep_best(&mut self.later.best);
        self.later.best
    }
}

/// What the first looks left.
struct Later<'s> {
    view: View<'s>,
    demand: Demand,
    noticed: Batch,
    best: Vec<Hypothesis>,
}

impl Later<'_> {
    #[inline]
    fn take(&mut self, targets: &[Target], j: usize) {
        if self.noticed.push(j) == BATCH {
            self.all_looks(targets);
        }
    }

    #[inline(never)]
    fn all_looks(&mut self, targets: &[Target]) {
        let Later { view, demand, noticed, best } = self;
        let View { search, span, i } = *view;
        let points = search.field.points();
        noticed.drain_noticed(view, targets, demand.fewest, |j| {
            let z = span.factor(points[i], points[j]);
            if let Some(score) = search.verify((i, j), z, targets, *demand) {
                best.push(Hypothesis { score, i: i as u32, j: j as u32 });
                if best.len() >= 4 * REFINED_PER_PAIR {
                    keep_best(best);
                }
            }
        });
    }
}

/// Second ends that wait for a look.
struct Batch {
    len: usize,
    ends: [u32; BATCH],
}

impl Batch {
    fn new() -> Batch {
        Batch { len: 0, ends: [0; BATCH] }
    }

    /// Adds one; gives how many there are.
    ///
    /// # Panics
    /// When the batch is full.
    #[inline]
    fn push(&mut self, end: usize) -> usize {
        self.ends[self.len] = end as u32;
        self.len += 1;
        self.len
    }

    /// Empties the batch; calls `each` with the second ends of the hypotheses of which at least `fewest` of these
    /// targets may have a candidate, in their order.
    #[inline(always)]
    fn drain_noticed(&mut self, view: &View<'_>, targets: &[Target], fewest: usize, mut each: impl FnMut(usize)) {
        let counts = widest(Looks { view, targets, batch: self });
        for (end, count) in self.ends[..self.len].iter().zip(counts) {
            if count as usize >= fewest {
                each(*end as usize);
            }
        }
        self.len = 0;
    }
}

/// The field as seen from point `i` at the first end of a pair.
#[derive(Clone, Copy)]
struct View<'a> {
    search: &'a Search<'a>,
    span: Span,
    i: usize,
}

/// Counts of each hypothesis the targets that may have a candidate.
struct Looks<'a> {
    view: &'a View<'a>,
    targets: &'a [Target],
    batch: &'a Batch,
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

impl Kernel for Looks<'_> {
    type Output = [u32; BATCH];

    #[inline(always)]
    fn run(self) -> [u32; BATCH] {
        let Looks { view: View { search, span, i }, targets, batch } = self;
        let points = search.field.points();
        let from = points[*i];
        let mut counts = [0u32; BATCH];
        let used = batch.len.next_multiple_of(LANES);
        let (ends, counts_of) = (batch.ends[..used].as_chunks::<LANES>().0, counts[..used].as_chunks_mut::<LANES>().0);
        for (ends, counts_of) in ends.iter().zip(counts_of) {
            let (mut x_px, mut y_px) = ([0.0; LANES], [0.0; LANES]);
            for lane in 0..LANES {
                let to = points[ends[lane] as usize];
                (x_px[lane], y_px[lane]) = (to.x, to.y);
            }
            let (mut z_re, mut z_im) = ([0f32; LANES], [0f32; LANES]);
            for lane in 0..LANES {
                let z = span.factor(from, PixelPoint { x: x_px[lane], y: y_px[lane] });
                (z_re[lane], z_im[lane]) = (z.0 as f32, z.1 as f32);
            }
            let mut counts = [0u32; LANES];
            for target in targets {
                let bitmap = &search.bitmaps[target.bitmap];
                let (columns, rows, words) = (bitmap.columns as u32, bitmap.rows as f32, &bitmap.bits[..]);
                // All in cells.
                let (x0, y0) = bitmap.cell_of(from);
                let (x0, y0) = (x0 as f32, y0 as f32);
                let east = (target.east * bitmap.cells_per_px) as f32;
                let north = (target.north * bitmap.cells_per_px) as f32;
                let mut bits = [0u32; LANES];
                for lane in 0..LANES {
                    let (re, im) = (z_re[lane], z_im[lane]);
                    let column = cell(x0 + (re * east - im * north), columns as f32);
                    let row = cell(y0 - (re * north + im * east), rows);
                    bits[lane] = row * columns + column;
                }
                for lane in 0..LANES {
                    let word = words.get(bits[lane] as usize / 32).copied().unwrap_or(0);
                    counts[lane] += word >> (bits[lane] % 32) & 1;
                }
            }
            *counts_of = counts;
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate::Candidate;
    use crate::matching::Priors;
    use autoref_raster::coords::MapPoint;
    use autoref_raster::random::SplitMix64;

    #[test]
    fn looks_at_many_answer_as_one_at_a_time() {
        let mut random = SplitMix64(11);
        let mut unit = || random.unit();
        let candidate = |x: f64, y: f64| Candidate::at(PixelPoint { x, y });
        let candidates: Vec<Candidate> = (0..300).map(|_| candidate(2000.0 * unit(), 1500.0 * unit())).collect();
        let gcps: Vec<MapPoint> =
            (0..12).map(|_| MapPoint { easting: 60.0 * unit(), northing: 45.0 * unit() }).collect();
        let priors = Priors { image_size_px: Some((2000.0, 1500.0)), ..Priors::default() };
        let all: Vec<&Candidate> = candidates.iter().collect();
        let (search, pairs, _) = Search::new(&all, &gcps, &priors, 0.0).expect("hypotheses are possible");
        let (mut hits, mut more) = (0, 0);
        for pair in &pairs[..20] {
            let (targets, i) = (search.targets(pair, search.tolerance_px), pair.a);
            let view = View { search: &search, span: search.span(pair), i };
            let mut batch = Batch::new();
            (0..BATCH - 3).map(|k| 20 + 4 * k).for_each(|j| {
                batch.push(j);
            });
            let look = || Looks { view: &view, targets: &targets, batch: &batch };
            let counts = [look().run(), widest(look())];
            for (lane, j) in batch.ends[..batch.len].iter().enumerate() {
                let from = search.field.points()[i];
                let z = view.span.factor(from, search.field.points()[*j as usize]);
                let may = |target: &&Target| {
                    let p = PixelPoint {
                        x: from.x + z.0 * target.east - z.1 * target.north,
                        y: from.y - (z.0 * target.north + z.1 * target.east),
                    };
                    search.field.contains(p) && search.bitmaps[target.bitmap].may_hold(p)
                };
                let expected = targets.iter().filter(may).count() as u32;
                // Beside a border between cells single precision may find one more, never one less.
                assert_eq!(counts[0][lane], counts[1][lane]);
                assert!((expected..=expected + 1).contains(&counts[0][lane]), "{expected}: {}", counts[0][lane]);
                hits += expected;
                more += counts[0][lane] - expected;
            }
        }
        assert!(hits > 100 && more < hits / 50, "{hits}, {more} more");
    }
}
