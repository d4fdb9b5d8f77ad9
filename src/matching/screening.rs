//! How many pairs of GCPs a search must try, and how long it looks at each hypothesis.

/// How thoroughly a search tries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Screening {
    /// Pairs of GCPs that are enough.
    pub pairs: usize,
    /// A hypothesis that hits nothing with so many looks at other GCPs is dropped; a GCP outside the image is a look
    /// too.
    pub first_looks: usize,
}

impl Screening {
    /// Every hypothesis is asked for all its GCPs.
    pub const EVERY_LOOK: usize = usize::MAX;

    /// The screening that takes the fewest looks in all and misses this share of the cases, when `hits` of `others`
    /// GCPs beside the pair have marks.
    pub fn shortest(hits: usize, others: usize, pairs: usize, missed: f64) -> Screening {
        /// Looks that a hypothesis takes as long as before the first.
        const LAID_OUT: usize = 3;
        let (marks, points) = (hits as f64 + 2.0, others as f64 + 2.0);
        let both = marks * (marks - 1.0) / (points * (points - 1.0));
        // ln(1 − 1) is −∞: one pair is enough then.
        let enough = |noticed: f64| (missed.ln() / (-noticed).ln_1p()).ceil().max(1.0);
        let every = Screening { pairs: (enough(both) as usize).min(pairs), first_looks: Screening::EVERY_LOOK };
        let (mut best, mut fewest) = (every, every.pairs * (LAID_OUT + others));
        let mut none_hit = 1.0;
        for looks in 1..=others - hits {
            none_hit *= (others - hits - looks + 1) as f64 / (others - looks + 1) as f64;
            let needed = enough(both * (1.0 - none_hit));
            if needed <= pairs as f64 && (needed as usize) * (LAID_OUT + looks) < fewest {
                fewest = needed as usize * (LAID_OUT + looks);
                best = Screening { pairs: needed as usize, first_looks: looks };
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::SplitMix64;

    /// A pair of 20 points drawn at random and the first looks: how often a pattern of few marks is noticed by the
    /// pairs that the screening allows, counted instead of reckoned.
    #[test]
    fn a_screened_search_notices_99_of_100_patterns() {
        for (hits, others, pairs) in [(4, 18, 190), (6, 18, 190), (10, 18, 190), (6, 48, 1225), (20, 198, 19_900)] {
            let screening = Screening::shortest(hits, others, pairs, 0.01);
            assert!(screening.pairs <= pairs && screening.first_looks < others, "{screening:?}");
            let mut random = SplitMix64(others as u64);
            let mut points: Vec<usize> = (0..others + 2).collect();
            let marked = |point: &usize| *point < hits + 2;
            let trials = 3000;
            let noticed = (0..trials)
                .filter(|_| {
                    (0..screening.pairs).any(|_| {
                        // A pair and its looks are the first of a shuffle.
                        for k in 0..2 + screening.first_looks {
                            let other = k + (random.unit() * (points.len() - k) as f64) as usize;
                            points.swap(k, other);
                        }
                        points[..2].iter().all(marked) && points[2..2 + screening.first_looks].iter().any(marked)
                    })
                })
                .count();
            // 0.99 less three standard deviations.
            assert!(
                noticed as f64 >= 0.9845 * f64::from(trials),
                "{noticed} of {trials}, {hits} of {others}, {screening:?}"
            );
        }
    }

    #[test]
    fn a_list_too_short_for_a_screening_is_asked_in_full() {
        assert_eq!(Screening::shortest(1, 18, 190, 0.01), Screening { pairs: 190, first_looks: Screening::EVERY_LOOK });
        assert_eq!(Screening::shortest(18, 18, 190, 0.01), Screening { pairs: 1, first_looks: Screening::EVERY_LOOK });
    }
}
