//! In how many ways does a pattern fit itself?
//!
//! A wrong match is a similarity (perhaps a mirroring one) that lays most of the marks on surveyed points of other
//! names. When it misses u of them and just these u are lost, the wrong match explains what is left as well as the
//! right one. So a pattern is safe against the loss of k marks when every similarity but the identity misses more than
//! k.
//!
//! The search is complete: of k + 1 disjoint pairs of points at least one has both ends hit when no more than k points
//! are missed, so laying each of these pairs on every pair of points in turn meets every such similarity. Pairs whose
//! lengths no such similarity brings together are passed over (see `Scales`), which leaves few of a large pattern.

use std::collections::HashSet;

use rayon::prelude::*;
use serde::Serialize;

use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};
use autoref_solve::Similarity;
use autoref_solve::similarity::{Pair, fit_equal_weights};

/// No more ambiguities than this are listed.
pub const MOST_REPORTED: usize = 12;

/// What may be different, and how much is not seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Freedom {
    /// How many marks may be lost.
    pub lose: usize,
    /// How near to a point another must land to pass for it, metres.
    pub tolerance_m: f64,
    /// Scales that differ by more than this factor are told apart; `None`: the scale is unknown.
    pub scale_ratio: Option<f64>,
    /// Turns by more than this many degrees are told apart; `None`: any.
    pub turn_deg: Option<f64>,
}

/// A similarity that lays the pattern on itself, all but a few points.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ambiguity {
    /// It is a mirroring: only a mirrored image could be taken so, and would not be noticed.
    pub mirrored: Handedness,
    pub scale: f64,
    /// Anticlockwise; of a mirroring, twice the direction of its axis from east.
    pub turn_deg: f64,
    /// How far the pattern's middle moves, metres.
    pub shift_m: f64,
    /// Which point is taken for which, by index.
    pub pairs: Vec<(usize, usize)>,
    /// Points that land on none: without them nothing tells the two ways apart.
    pub unmatched: Vec<usize>,
    /// The farthest that a point lands from the one it is taken for, metres.
    pub worst_m: f64,
}

impl Ambiguity {
    /// "turned by 90°, moved by 10 m".
    pub fn words(&self) -> String {
        let mut parts = Vec::new();
        if self.mirrored.is_mirrored() {
            parts.push("mirrored".to_string());
        } else if self.turn_deg.abs() > 0.5 {
            parts.push(format!("turned by {:.0}°", self.turn_deg));
        }
        if (self.scale - 1.0).abs() > 0.005 {
            parts.push(format!("at {:.2} times the size", self.scale));
        }
        if self.shift_m > 0.1 && !self.mirrored.is_mirrored() {
            parts.push(format!("its middle moved by {:.1} m", self.shift_m));
        }
        if parts.is_empty() { "slightly displaced".into() } else { parts.join(", ") }
    }
}

/// Points sorted by easting, about their mean.
struct Sorted {
    points: Vec<MapPoint>,
    order: Vec<usize>,
}

impl Sorted {
    fn new(places: &[MapPoint]) -> Self {
        let n = places.len().max(1) as f64;
        let (e, m) = places.iter().fold((0.0, 0.0), |(e, m), p| (e + p.easting / n, m + p.northing / n));
        let points: Vec<MapPoint> =
            places.iter().map(|p| MapPoint { easting: p.easting - e, northing: p.northing - m }).collect();
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|&i, &j| points[i].easting.total_cmp(&points[j].easting).then(i.cmp(&j)));
        Sorted { points, order }
    }

    /// A point and the one it is taken for.
    fn pair(&self, (i, j): (usize, usize), mirrored: Handedness) -> Pair {
        Pair {
            pixel: source(self.points[i], mirrored),
            covariance_px2: None,
            map: self.points[j],
            survey_sigma_m: None,
        }
    }

    fn nearest(&self, p: MapPoint, reach_m: f64) -> Option<(usize, f64)> {
        let start = self.order.partition_point(|&i| self.points[i].easting < p.easting - reach_m);
        let mut best: Option<(usize, f64)> = None;
        for &i in &self.order[start..] {
            let q = self.points[i];
            if q.easting > p.easting + reach_m {
                break;
            }
            let distance = (q.easting - p.easting).hypot(q.northing - p.northing);
            if distance <= reach_m && best.is_none_or(|(_, d)| distance < d) {
                best = Some((i, distance));
            }
        }
        best
    }
}

/// A point as the image side of a similarity; mirrored or not.
fn source(p: MapPoint, mirrored: Handedness) -> PixelPoint {
    PixelPoint { x: p.easting, y: -mirrored.sign() * p.northing }
}

/// Every ambiguity that the freedom allows, the worst (fewest missed, then nearest) first. Of a similarity and its
/// inverse one is listed.
pub fn find(places: &[MapPoint], freedom: &Freedom) -> Vec<Ambiguity> {
    let sorted = Sorted::new(places);
    let n = places.len();
    // Any two points lie on any two others; three are the least that say something.
    if n < 3 || n - freedom.lose.min(n) < 3 {
        return Vec::new();
    }
    let scales = Scales::of(&sorted.points, freedom);
    let found: Vec<Ambiguity> = bases(&sorted.points, freedom.lose + 1)
        .into_par_iter()
        .flat_map_iter(|base| {
            let (sorted, scales) = (&sorted, &scales);
            let length = distance(sorted.points[base.0], sorted.points[base.1]);
            (0..n).flat_map(move |c| {
                let fits = move |d: &usize| {
                    *d != c && scales.allow(length, distance(sorted.points[c], sorted.points[*d]), freedom.tolerance_m)
                };
                (0..n).filter(fits).flat_map(move |d| {
                    Handedness::BOTH
                        .into_iter()
                        .filter_map(move |mirrored| settle(sorted, freedom, base, (c, d), mirrored))
                })
            })
        })
        .collect();
    distinct(found)
}

/// The same for a pattern of which one point was moved, from the ambiguities `before` that the pattern had with two
/// points more lost: a similarity that a moved point makes ambiguous misses this point and the one it landed on before.
pub(super) fn find_after_move(
    places: &[MapPoint],
    moved: usize,
    before: &[Ambiguity],
    freedom: &Freedom,
) -> Vec<Ambiguity> {
    let sorted = Sorted::new(places);
    let again = |ambiguity: &Ambiguity| {
        let mirrored = ambiguity.mirrored;
        let kept = ambiguity.pairs.iter().filter(|(i, j)| *i != moved && *j != moved);
        let fitted: Vec<Pair> = kept.map(|&pair| sorted.pair(pair, mirrored)).collect();
        refined(&sorted, freedom, fit_equal_weights(&fitted)?, mirrored)
    };
    distinct(before.iter().filter_map(again).collect())
}

/// The scales that a similarity can have which lays all but a few points of a pattern on points of it.
///
/// Of the points that are hit and those they land on, both are the pattern less a few: the squares about the mean of
/// both lie between those of the whole and of the whole less the farthest ones.
struct Scales {
    least: f64,
    most: f64,
}

impl Scales {
    fn of(points: &[MapPoint], freedom: &Freedom) -> Scales {
        let (n, lost) = (points.len() as f64, freedom.lose as f64);
        let mut squares: Vec<f64> = points.iter().map(|p| p.easting.powi(2) + p.northing.powi(2)).collect();
        squares.sort_by(f64::total_cmp);
        let whole: f64 = squares.iter().sum();
        let farthest: f64 = squares.iter().rev().take(freedom.lose).sum();
        // Without points the mean moves too.
        let less = whole - farthest * n / (n - lost);
        // What the points are off the similarity adds to the squares of those they land on.
        let off = n * freedom.tolerance_m.powi(2);
        if less <= 0.0 {
            return Scales { least: 0.0, most: f64::INFINITY };
        }
        Scales { least: (less / (whole + off)).sqrt(), most: (whole / less).sqrt() }
    }

    /// Whether a base of this length may land on a pair of the other one.
    fn allow(&self, base_m: f64, length_m: f64, tolerance_m: f64) -> bool {
        // An end lands off its point by the tolerance at the scale; half as much again is for rounding.
        let slack = 3.0 * tolerance_m / base_m;
        let scale = length_m / base_m;
        scale >= self.least * (1.0 - slack) && scale <= self.most * (1.0 + slack)
    }
}

fn distance(p: MapPoint, q: MapPoint) -> f64 {
    (p.easting - q.easting).hypot(p.northing - q.northing)
}

/// Disjoint pairs, long ones where possible; all pairs when there are too few points.
fn bases(points: &[MapPoint], count: usize) -> Vec<(usize, usize)> {
    let n = points.len();
    if n < 2 * count {
        return (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))).collect();
    }
    let mut by_radius: Vec<usize> = (0..n).collect();
    let radius = |i: usize| points[i].easting.hypot(points[i].northing);
    by_radius.sort_by(|&i, &j| radius(j).total_cmp(&radius(i)).then(i.cmp(&j)));
    let mut pairs = Vec::new();
    while pairs.len() < count {
        let a = by_radius.remove(0);
        let length = |i: usize| (points[i].easting - points[a].easting).hypot(points[i].northing - points[a].northing);
        let farthest = (0..by_radius.len())
            .max_by(|&i, &j| length(by_radius[i]).total_cmp(&length(by_radius[j])))
            .expect("two points are left for every pair");
        pairs.push((a, by_radius.remove(farthest)));
    }
    pairs
}

/// The similarity that lays a base on (c, d), when it is an ambiguity: hypothesis, count, two refits.
fn settle(
    sorted: &Sorted,
    freedom: &Freedom,
    (a, b): (usize, usize),
    (c, d): (usize, usize),
    mirrored: Handedness,
) -> Option<Ambiguity> {
    let points = &sorted.points;
    let similarity =
        Similarity::through([source(points[a], mirrored), source(points[b], mirrored)], [points[c], points[d]])?;
    allowed(&similarity, freedom, mirrored).then_some(())?;
    refined(sorted, freedom, similarity, mirrored)
}

/// The ambiguity that lies about a similarity, if there is one.
fn refined(sorted: &Sorted, freedom: &Freedom, mut similarity: Similarity, mirrored: Handedness) -> Option<Ambiguity> {
    let points = &sorted.points;
    // From two points with an error each, a place outside them is less sure: three times the tolerance first.
    let mut pairs = hits(sorted, &similarity, 3.0 * freedom.tolerance_m, freedom.lose, mirrored)?;
    for reach in [1.5, 1.0] {
        let fitted: Vec<Pair> = pairs.iter().map(|&pair| sorted.pair(pair, mirrored)).collect();
        similarity = fit_equal_weights(&fitted)?;
        pairs = hits(sorted, &similarity, reach * freedom.tolerance_m, freedom.lose, mirrored)?;
    }
    let land = |i: usize| similarity.apply(source(points[i], mirrored));
    let off = |i: usize, j: usize| (land(i).easting - points[j].easting).hypot(land(i).northing - points[j].northing);
    // The identity, or so near to it that it makes no difference.
    if (!mirrored.is_mirrored() && pairs.iter().all(|(i, j)| i == j))
        || (0..points.len()).all(|i| off(i, i) < freedom.tolerance_m)
    {
        return None;
    }
    allowed(&similarity, freedom, mirrored).then_some(())?;
    let unmatched = (0..points.len()).filter(|i| !pairs.iter().any(|(from, _)| from == i)).collect();
    let worst_m = pairs.iter().map(|&(i, j)| off(i, j)).fold(0.0, f64::max);
    let middle = similarity.apply(PixelPoint { x: 0.0, y: 0.0 });
    Some(Ambiguity {
        mirrored,
        scale: similarity.scale_m_per_px(),
        turn_deg: similarity.rotation_deg(),
        shift_m: middle.easting.hypot(middle.northing),
        pairs,
        unmatched,
        worst_m,
    })
}

fn allowed(similarity: &Similarity, freedom: &Freedom, mirrored: Handedness) -> bool {
    let scale = similarity.scale_m_per_px();
    freedom.scale_ratio.is_none_or(|ratio| scale.max(1.0 / scale) <= ratio)
        && (mirrored.is_mirrored() || freedom.turn_deg.is_none_or(|most| similarity.rotation_deg().abs() <= most))
}

/// Which point lands on which, each taken once; `None` when more than `most_missed` land on none.
fn hits(
    sorted: &Sorted,
    similarity: &Similarity,
    reach_m: f64,
    most_missed: usize,
    mirrored: Handedness,
) -> Option<Vec<(usize, usize)>> {
    // The tolerance is one of the image: a coarser scale makes it longer on the ground.
    let reach_m = reach_m * similarity.scale_m_per_px();
    let mut taken: Vec<Option<(usize, f64)>> = vec![None; sorted.points.len()];
    let mut missed = 0;
    for (i, p) in sorted.points.iter().enumerate() {
        match sorted.nearest(similarity.apply(source(*p, mirrored)), reach_m) {
            Some((j, distance)) if taken[j].is_none_or(|(_, other)| distance < other) => {
                missed += usize::from(taken[j].is_some());
                taken[j] = Some((i, distance));
            }
            _ => missed += 1,
        }
        if missed > most_missed {
            return None;
        }
    }
    let mut pairs: Vec<(usize, usize)> =
        taken.iter().enumerate().filter_map(|(j, from)| from.map(|(i, _)| (i, j))).collect();
    pairs.sort_unstable();
    Some(pairs)
}

fn distinct(mut found: Vec<Ambiguity>) -> Vec<Ambiguity> {
    found.sort_by(|s, t| {
        (s.unmatched.len(), s.mirrored)
            .cmp(&(t.unmatched.len(), t.mirrored))
            .then(s.worst_m.total_cmp(&t.worst_m))
            .then_with(|| s.pairs.cmp(&t.pairs))
    });
    let mut seen: HashSet<(Handedness, Vec<(usize, usize)>)> = HashSet::new();
    found.retain(|ambiguity| {
        let mut inverse: Vec<(usize, usize)> = ambiguity.pairs.iter().map(|&(i, j)| (j, i)).collect();
        inverse.sort_unstable();
        !seen.contains(&(ambiguity.mirrored, inverse)) && seen.insert((ambiguity.mirrored, ambiguity.pairs.clone()))
    });
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(list: &[(f64, f64)]) -> Vec<MapPoint> {
        list.iter().map(|&(e, n)| MapPoint { easting: 570_000.0 + e, northing: 7_032_000.0 + n }).collect()
    }

    const FREE: Freedom = Freedom { lose: 2, tolerance_m: 0.4, scale_ratio: None, turn_deg: None };

    #[test]
    fn a_square_turns_and_mirrors_onto_itself() {
        let square = places(&[(0.0, 0.0), (50.0, 0.0), (50.0, 50.0), (0.0, 50.0)]);
        let found = find(&square, &Freedom { lose: 0, ..FREE });
        // Turns by 90° (its inverse left out) and 180°, four mirrorings.
        let turns: Vec<f64> =
            found.iter().filter(|a| !a.mirrored.is_mirrored()).map(|a| a.turn_deg.abs().round()).collect();
        assert_eq!((found.len(), turns.len()), (6, 2), "{found:?}");
        assert!(turns.contains(&90.0) && turns.contains(&180.0));
        assert!(found.iter().all(|a| a.unmatched.is_empty() && a.worst_m < 1e-9 && (a.scale - 1.0).abs() < 1e-12));
        // North up within 15 degrees: no turn is left.
        let turned = find(&square, &Freedom { lose: 0, turn_deg: Some(30.0), ..FREE });
        assert!(turned.iter().all(|a| a.mirrored.is_mirrored()));
    }

    #[test]
    fn a_pattern_that_repeats_at_another_size_is_found_unless_the_scale_is_known() {
        // Points at powers of 1.5 on a spiral: turned by 40° and grown by 1.5 it falls on itself but for one point.
        let spiral: Vec<(f64, f64)> = (0..9)
            .map(|k| {
                let (r, t) = (10.0 * 1.5f64.powi(k), 40f64.to_radians() * f64::from(k));
                (r * t.cos(), r * t.sin())
            })
            .collect();
        let found = find(&places(&spiral), &Freedom { lose: 1, ..FREE });
        assert!(found.iter().any(|a| !a.mirrored.is_mirrored() && a.unmatched.len() == 1), "{found:?}");
        let known = find(&places(&spiral), &Freedom { lose: 1, scale_ratio: Some(1.22), ..FREE });
        assert!(known.is_empty(), "{known:?}");
    }

    /// What the search finds that lays each base on every pair.
    fn find_among_all(places: &[MapPoint], freedom: &Freedom) -> Vec<Ambiguity> {
        let (sorted, n) = (Sorted::new(places), places.len());
        let mut found = Vec::new();
        for base in bases(&sorted.points, freedom.lose + 1) {
            for (c, d) in (0..n).flat_map(|c| (0..n).map(move |d| (c, d))).filter(|(c, d)| c != d) {
                found.extend(Handedness::BOTH.into_iter().filter_map(|m| settle(&sorted, freedom, base, (c, d), m)));
            }
        }
        distinct(found)
    }

    #[test]
    fn pairs_that_are_passed_over_bring_nothing_and_a_move_is_judged_by_what_was_there() {
        let grid: Vec<(f64, f64)> = (0..42).map(|i| (f64::from(i % 7) * 20.0, f64::from(i / 7) * 20.0)).collect();
        let worn: Vec<(f64, f64)> =
            grid.iter().enumerate().map(|(i, p)| (p.0 + (i * i % 5) as f64 * 0.02, p.1)).collect();
        let pairs = |found: Vec<Ambiguity>| {
            let mut pairs: Vec<_> = found.into_iter().map(|a| (a.mirrored, a.pairs)).collect();
            pairs.sort();
            pairs
        };
        for list in [grid, worn] {
            let mut list = places(&list);
            for lose in [0, 2, 6] {
                let freedom = Freedom { lose, ..FREE };
                let found = find(&list, &freedom);
                assert!(!found.is_empty(), "a grid fits itself");
                assert_eq!(pairs(found), pairs(find_among_all(&list, &freedom)), "{lose} lost");
            }
            let before = find(&list, &Freedom { lose: FREE.lose + 2, ..FREE });
            list[17].easting += 4.0;
            list[17].northing -= 2.0;
            assert_eq!(pairs(find_after_move(&list, 17, &before, &FREE)), pairs(find(&list, &FREE)));
        }
    }

    #[test]
    fn the_loss_of_points_is_what_makes_it_ambiguous() {
        // A square and one odd point: safe while the odd point is there.
        let odd = places(&[(0.0, 0.0), (50.0, 0.0), (50.0, 50.0), (0.0, 50.0), (20.0, 7.0)]);
        assert!(find(&odd, &Freedom { lose: 0, ..FREE }).is_empty());
        let found = find(&odd, &Freedom { lose: 1, ..FREE });
        assert!(found.len() >= 6 && found.iter().all(|a| a.unmatched == [4]), "{found:?}");
    }
}
