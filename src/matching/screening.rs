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

    /// The fewest first looks with which, all pairs tried, no more than this share of the patterns goes unnoticed that
    /// hold so many of the pairs and have marks for `hits` of the `others`.
    pub fn of_all_pairs(hits: usize, others: usize, pairs_of_pattern: usize, missed: f64) -> usize {
        let mut none_hit = 1.0f64;
        for looks in 1..=others.saturating_sub(hits) {
            none_hit *= (others - hits - looks + 1) as f64 / (others - looks + 1) as f64;
            if none_hit.powi(pairs_of_pattern as i32) <= missed {
                return looks;
            }
        }
        Screening::EVERY_LOOK
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

    /// Rivals of few marks among many points, their pairs laid out at random: how often the first looks of none hit.
    #[test]
    fn of_a_pattern_whose_pairs_are_all_tried_one_is_noticed() {
        let mut random = SplitMix64(5);
        for (marks, others, missed) in [(4, 58, 0.01), (6, 198, 0.01), (12, 198, 0.001)] {
            let (hits, pairs) = (marks - 2, marks * (marks - 1) / 2);
            let looks = Screening::of_all_pairs(hits, others, pairs, missed);
            assert!(looks < others - hits, "{looks} of {others}");
            let trials = 20_000;
            let unnoticed = (0..trials)
                .filter(|_| {
                    (0..pairs).all(|_| {
                        let mut left = hits;
                        (0..looks).all(|look| {
                            let is_hit = random.unit() * ((others - look) as f64) < left as f64;
                            left -= usize::from(is_hit);
                            !is_hit
                        })
                    })
                })
                .count();
            let most = missed * f64::from(trials);
            assert!(unnoticed as f64 <= most + 3.0 * most.sqrt(), "{unnoticed} of {trials}, {looks} looks");
        }
        assert_eq!(Screening::of_all_pairs(1, 198, 1, 1e-5), Screening::EVERY_LOOK);
        assert_eq!(Screening::of_all_pairs(3, 2, 3, 1e-5), Screening::EVERY_LOOK);
    }

    #[test]
    fn a_list_too_short_for_a_screening_is_asked_in_full() {
        assert_eq!(Screening::shortest(1, 18, 190, 0.01), Screening { pairs: 190, first_looks: Screening::EVERY_LOOK });
        assert_eq!(Screening::shortest(18, 18, 190, 0.01), Screening { pairs: 1, first_looks: Screening::EVERY_LOOK });
    }
}
