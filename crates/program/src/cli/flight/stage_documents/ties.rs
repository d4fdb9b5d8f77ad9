//! Ties by pair and by frame.

use serde::Serialize;

use crate::cli::flight::relative::Matched;
use crate::cli::flight::stage::Stage;
use crate::cli::flight::stage_line::StageLine;

/// Cells along a side of a frame for which it is told whether they have ties.
const CELLS: usize = 8;

/// Ties by pair and by frame.
#[derive(Debug, Serialize)]
pub struct TiesStage {
    pub stage: Stage,
    pub neighbours_warped: bool,
    pub pairs: Vec<MatchedPair>,
    pub frames: Vec<TiedFrame>,
}

impl TiesStage {
    pub fn of(matched: &Matched, names: &[&str], size_px: [f64; 2]) -> Self {
        let name = |i: usize| names[i].to_string();
        let verified = &matched.verified;
        let all = matched.all.as_ref().unwrap_or(verified);
        let agree = verified.by_pair();
        let pair = |((a, b), matches): ((usize, usize), usize)| {
            let ties = agree.get(&(a, b)).copied().unwrap_or(0);
            MatchedPair { frames: [name(a), name(b)], matches, ties }
        };
        let frame = |i: usize| {
            let places = verified.places_tied(i);
            let neighbours = agree.iter().filter(|((a, b), n)| **n > 0 && (*a == i || *b == i)).count();
            let (features, ties, covered) = (all.features(i), places.len(), covered(&places, size_px));
            TiedFrame { name: name(i), features, ties, neighbours, covered }
        };
        TiesStage {
            stage: Stage::Ties,
            neighbours_warped: matched.all.is_some(),
            pairs: all.by_pair().into_iter().map(pair).collect(),
            frames: (0..names.len()).map(frame).collect(),
        }
    }

    pub fn line(&self) -> StageLine {
        StageLine::of_ties(self.pairs.iter().map(|pair| pair.ties))
    }
}

/// Two frames: their matches, and those that agree with a relative orientation.
#[derive(Debug, Serialize)]
pub struct MatchedPair {
    pub frames: [String; 2],
    pub matches: usize,
    pub ties: usize,
}

/// How a frame is tied to others.
#[derive(Debug, Serialize)]
pub struct TiedFrame {
    pub name: String,
    pub features: usize,
    pub ties: usize,
    /// Frames that it shares ties with.
    pub neighbours: usize,
    /// Share of the frame where ties lie.
    pub covered: f64,
}

/// Share of the frame's cells in which one of the places lies.
fn covered(places: &[[f64; 2]], size_px: [f64; 2]) -> f64 {
    let mut has = [false; CELLS * CELLS];
    for at in places {
        let [i, j] = [0, 1].map(|k| ((at[k] / size_px[k] * CELLS as f64) as usize).min(CELLS - 1));
        has[j * CELLS + i] = true;
    }
    has.iter().filter(|h| **h).count() as f64 / has.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_covered_where_it_has_ties() {
        assert_eq!(covered(&[], [800.0, 400.0]), 0.0);
        let everywhere: Vec<[f64; 2]> =
            (0..64).map(|k| [(k % 8) as f64 * 100.0 + 50.0, (k / 8) as f64 * 50.0 + 25.0]).collect();
        assert_eq!(covered(&everywhere, [800.0, 400.0]), 1.0);
        assert_eq!(covered(&everywhere[..16], [800.0, 400.0]), 0.25);
        // The far edge is inside.
        assert_eq!(covered(&[[800.0, 400.0]], [800.0, 400.0]), 1.0 / 64.0);
    }
}
