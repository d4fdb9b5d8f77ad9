//! Which point to move, and where to, so that the pattern no longer fits itself.
//!
//! Greedy: of all single moves (some points, eight directions, a few lengths) the one that leaves the fewest ways of
//! fitting, and of those the shortest; again, until none is left.

use rayon::prelude::*;
use serde::Serialize;

use super::ambiguity::{self, Ambiguity, Freedom};
use autoref_raster::coords::MapPoint;

/// Lengths tried, in tolerances: the shortest is just enough to be told apart surely.
const LENGTHS: [f64; 4] = [4.0, 7.0, 12.0, 20.0];
/// More moves than this are a new plan.
const MOST_MOVES: usize = 6;
/// Points tried in a round, and points laid on others for it: of several hundred fewer are tried.
const MOST_TRIED: usize = 16;
const MOST_LAID_PER_ROUND: usize = 40_000_000;
const WINDS: [(&str, f64); 8] = [
    ("east", 0.0),
    ("north-east", 45.0),
    ("north", 90.0),
    ("north-west", 135.0),
    ("west", 180.0),
    ("south-west", 225.0),
    ("south", 270.0),
    ("south-east", 315.0),
];

/// Advice to move one point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Move {
    pub name: String,
    pub distance_m: f64,
    /// One of the eight winds.
    pub direction: String,
    /// The new place.
    pub easting: f64,
    pub northing: f64,
}

impl Move {
    /// The advice in words.
    pub fn words(&self) -> String {
        format!(
            "move {} by {:.1} m to the {}, to E {:.2}, N {:.2}",
            self.name, self.distance_m, self.direction, self.easting, self.northing
        )
    }
}

/// How bad a pattern is: the number of ways of fitting, those that miss fewest points counting most.
fn badness(ways: &[Ambiguity], freedom: &Freedom) -> f64 {
    ways.iter().map(|a| (1 + freedom.lose - a.unmatched.len()) as f64).sum()
}

/// Moves in the order in which they are to be made, and whether they suffice.
pub fn moves(points: &[(String, MapPoint)], freedom: &Freedom) -> (Vec<Move>, bool) {
    let mut places: Vec<MapPoint> = points.iter().map(|p| p.1).collect();
    let mut made: Vec<Move> = Vec::new();
    let mut moved = vec![false; points.len()];
    // With two points more lost: all that a move of one point can make of the pattern.
    let wider = Freedom { lose: freedom.lose + 2, ..*freedom };
    // Too few points are left then to say anything.
    let is_small = points.len() < wider.lose + 3;
    let mut now = badness(&ambiguity::find(&places, freedom), freedom);
    while now > 0.0 && made.len() < MOST_MOVES {
        let before = ambiguity::find(&places, &wider);
        let cost = before.len().max(1) * places.len() * WINDS.len() * LENGTHS.len();
        let most_tried = (MOST_LAID_PER_ROUND / cost).min(MOST_TRIED);
        if most_tried == 0 {
            break;
        }
        // Points that the worst ways move elsewhere; each once.
        let ways = || before.iter().filter(|way| way.unmatched.len() <= freedom.lose);
        let mut tried: Vec<usize> = (0..places.len())
            .filter(|&i| !moved[i] && ways().any(|a| a.pairs.iter().any(|&(f, t)| f == i && t != i)))
            .collect();
        let step = tried.len().div_ceil(most_tried).max(1);
        tried = tried.into_iter().step_by(step).collect();
        let options: Vec<(usize, usize, f64)> = tried
            .iter()
            .flat_map(|&i| (0..WINDS.len()).flat_map(move |w| LENGTHS.map(|l| (i, w, l * freedom.tolerance_m))))
            .collect();
        let best = options
            .into_par_iter()
            .filter_map(|(i, wind, distance)| {
                let angle = WINDS[wind].1.to_radians();
                let to = MapPoint {
                    easting: places[i].easting + distance * angle.cos(),
                    northing: places[i].northing + distance * angle.sin(),
                };
                let free = places.iter().enumerate().all(|(j, p)| {
                    j == i || (p.easting - to.easting).hypot(p.northing - to.northing) > 4.0 * freedom.tolerance_m
                });
                let mut changed = places.clone();
                changed[i] = to;
                free.then(|| {
                    let ways = if is_small {
                        ambiguity::find(&changed, freedom)
                    } else {
                        ambiguity::find_after_move(&changed, i, &before, freedom)
                    };
                    (badness(&ways, freedom), distance, i, wind, to)
                })
            })
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)).then((a.2, a.3).cmp(&(b.2, b.3))));
        let Some((_, distance_m, i, wind, to)) = best.filter(|b| b.0 < now) else { break };
        (places[i], moved[i]) = (to, true);
        now = badness(&ambiguity::find(&places, freedom), freedom);
        made.push(Move {
            name: points[i].0.clone(),
            distance_m,
            direction: WINDS[wind].0.into(),
            easting: to.easting,
            northing: to.northing,
        });
    }
    (made, now == 0.0)
}
