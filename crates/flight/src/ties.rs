//! Features of two views matched where each other is expected, and what of the matches holds together.
//!
//! Descriptors are SIFT's (Lowe, *Distinctive Image Features from Scale-Invariant Keypoints*, 2004): nearest neighbours
//! that are mutual and clearly nearer than the second (his ratio). Where the views are roughly registered, only
//! features near the expected place are compared; matches that move otherwise than those around them are wrong; a
//! second search goes by what moved together.

use autoref_raster::ranks::upper_median_and_distance;
use rayon::prelude::*;

/// The length of a descriptor.
pub const DESCRIPTOR: usize = 128;

/// Lowe's ratio where the whole window is searched, and where the place is known from matches nearby.
const RATIO_WIDE: f64 = 0.8;
const RATIO_NEAR: f64 = 0.9;
/// Features closer than this are one place: the second nearest must be of another.
const SAME_PLACE_PX: f64 = 3.0;
/// How far from the place that its neighbours tell a match is sought.
const NEAR_PX: f64 = 40.0;
/// Matches around one that tell how it should move.
const NEIGHBOURS: usize = 10;
/// What moves as its neighbours do within this is never taken for wrong.
const SAME_MOVE_PX: f64 = 8.0;
/// Neighbours that move apart by more (median deviation) are chance.
const MOST_SPREAD_PX: f64 = 20.0;
/// Fewer matches tell nothing about each other.
const LEAST_MATCHES: usize = 12;

/// Features of a view: places in pixels, and descriptors.
#[derive(Clone, Debug, Default)]
pub struct Features {
    pub at: Vec<[f64; 2]>,
    pub descriptors: Vec<[u8; DESCRIPTOR]>,
}

/// Features by cells of a grid.
struct Cells {
    cell_px: f64,
    columns: usize,
    rows: usize,
    from: Vec<usize>,
    members: Vec<usize>,
}

impl Cells {
    fn new(at: &[[f64; 2]], cell_px: f64) -> Self {
        let most = at.iter().fold([0.0f64; 2], |m, p| [m[0].max(p[0]), m[1].max(p[1])]);
        let [columns, rows] = most.map(|m| (m / cell_px) as usize + 1);
        let cell = |p: &[f64; 2]| {
            let [i, j] = p.map(|v| (v.max(0.0) / cell_px) as usize);
            j * columns + i
        };
        let mut members: Vec<usize> = (0..at.len()).collect();
        members.sort_by_key(|k| cell(&at[*k]));
        let mut from = vec![0usize; columns * rows + 1];
        for p in at {
            from[cell(p) + 1] += 1;
        }
        for i in 0..columns * rows {
            from[i + 1] += from[i];
        }
        Cells { cell_px, columns, rows, from, members }
    }

    /// All within the cells that a window touches.
    fn around(&self, place: [f64; 2], half_px: [f64; 2]) -> impl Iterator<Item = usize> + '_ {
        let bound = |v: f64, most: usize| ((v / self.cell_px).floor().max(0.0) as usize).min(most);
        let (left, right) =
            (bound(place[0] - half_px[0], self.columns), bound(place[0] + half_px[0], self.columns - 1));
        let (top, bottom) = (bound(place[1] - half_px[1], self.rows), bound(place[1] + half_px[1], self.rows - 1));
        let outside = place[0] + half_px[0] < 0.0 || place[1] + half_px[1] < 0.0;
        let bottom = if outside { 0 } else { bottom + 1 };
        (top..bottom).flat_map(move |j| {
            let row = j * self.columns;
            let (a, b) = if left <= right { (self.from[row + left], self.from[row + right + 1]) } else { (0, 0) };
            self.members[a..b].iter().copied()
        })
    }
}

fn squared(a: &[u8; DESCRIPTOR], b: &[u8; DESCRIPTOR]) -> u32 {
    a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b)).pow(2)).sum()
}

/// Where features of one view are expected in the other.
trait Expected: Sync {
    fn place(&self, feature: usize) -> Option<[f64; 2]>;
}

impl<F: Fn(usize) -> Option<[f64; 2]> + Sync> Expected for F {
    fn place(&self, feature: usize) -> Option<[f64; 2]> {
        self(feature)
    }
}

/// Mutual nearest neighbours within the window around the expected place, clearly nearer than the second.
fn nearest(a: &Features, b: &Features, expected: &impl Expected, half_px: [f64; 2], ratio: f64) -> Vec<(usize, usize)> {
    let cells = Cells::new(&b.at, 48.0);
    let inside = |p: [f64; 2], q: [f64; 2]| (p[0] - q[0]).abs() <= half_px[0] && (p[1] - q[1]).abs() <= half_px[1];
    // Per feature of a: its nearest, all distances that it was compared by, and whether the second is clearly farther.
    let best: Vec<Option<(usize, u32, bool)>> = (0..a.at.len())
        .into_par_iter()
        .map(|i| {
            let place = expected.place(i)?;
            let compared: Vec<(u32, usize)> = cells
                .around(place, half_px)
                .filter(|j| inside(place, b.at[*j]))
                .map(|j| (squared(&a.descriptors[i], &b.descriptors[j]), j))
                .collect();
            let (first, j) = *compared.iter().min()?;
            let elsewhere = |k: usize| {
                (b.at[k][0] - b.at[j][0]).abs() > SAME_PLACE_PX || (b.at[k][1] - b.at[j][1]).abs() > SAME_PLACE_PX
            };
            let second = compared.iter().filter(|(_, k)| elsewhere(*k)).map(|(d, _)| *d).min();
            let clear = second.is_none_or(|s| f64::from(first) < ratio * ratio * f64::from(s));
            Some((j, first, clear))
        })
        .collect();
    // Mutual: no other feature of a is nearer to the one found.
    let mut nearest_of_b: Vec<Option<(u32, usize)>> = vec![None; b.at.len()];
    for (i, found) in best.iter().enumerate() {
        if let Some((j, d, _)) = found
            && nearest_of_b[*j].is_none_or(|known| (*d, i) < known)
        {
            nearest_of_b[*j] = Some((*d, i));
        }
    }
    best.iter()
        .enumerate()
        .filter_map(|(i, found)| {
            let (j, _, clear) = (*found)?;
            (clear && nearest_of_b[j].is_some_and(|(_, k)| k == i)).then_some((i, j))
        })
        .collect()
}

/// The matches nearest to a place, the one at `but` left out.
fn around(place: [f64; 2], pairs: &[(usize, usize)], a: &Features, but: Option<usize>) -> Vec<usize> {
    let away = |k: &usize| {
        let p = a.at[pairs[*k].0];
        (p[0] - place[0]).powi(2) + (p[1] - place[1]).powi(2)
    };
    let mut near: Vec<usize> = (0..pairs.len()).filter(|k| Some(*k) != but).collect();
    if near.len() > NEIGHBOURS {
        near.select_nth_unstable_by(NEIGHBOURS - 1, |k, l| away(k).total_cmp(&away(l)));
        near.truncate(NEIGHBOURS);
    }
    near
}

/// How matches move, by coordinate: the median, and the median deviation from it.
fn movement(members: &[usize], pairs: &[(usize, usize)], a: &Features, b: &Features) -> [(f64, f64); 2] {
    [0, 1].map(|c| {
        let mut moved: Vec<f64> = members.iter().map(|k| b.at[pairs[*k].1][c] - a.at[pairs[*k].0][c]).collect();
        upper_median_and_distance(&mut moved).expect("a match has others around it")
    })
}

/// The matches that move as those around them do.
fn together(pairs: &[(usize, usize)], a: &Features, b: &Features) -> Vec<(usize, usize)> {
    let mut kept = pairs.to_vec();
    for _ in 0..3 {
        if kept.len() < LEAST_MATCHES {
            return Vec::new();
        }
        let fits = |(k, (i, j)): (usize, &(usize, usize))| {
            let ways = movement(&around(a.at[*i], &kept, a, Some(k)), &kept, a, b);
            (0..2).all(|c| {
                let (way, spread) = ways[c];
                // Where even the neighbours disagree nothing holds together.
                let apart = (b.at[*j][c] - a.at[*i][c] - way).abs();
                spread <= MOST_SPREAD_PX && apart <= (4.0 * spread).clamp(SAME_MOVE_PX, NEAR_PX)
            })
        };
        let next: Vec<(usize, usize)> =
            kept.par_iter().enumerate().filter(|(k, pair)| fits((*k, pair))).map(|(_, pair)| *pair).collect();
        let settled = next.len() == kept.len();
        kept = next;
        if settled {
            break;
        }
    }
    if kept.len() < LEAST_MATCHES { Vec::new() } else { kept }
}

/// Pairs of features of two views that show the same ground. The views are registered to within `half_px` (x, y): a
/// feature of `a` at p is sought in `b` within that window around p. Empty when fewer than twelve hold together.
pub fn matched(a: &Features, b: &Features, half_px: [f64; 2]) -> Vec<(usize, usize)> {
    let wide = nearest(a, b, &|i: usize| Some(a.at[i]), half_px, RATIO_WIDE);
    let sure = together(&wide, a, b);
    if sure.is_empty() {
        return sure;
    }
    let by_neighbours = |i: usize| {
        let place = a.at[i];
        let ways = movement(&around(place, &sure, a, None), &sure, a, b);
        Some([place[0] + ways[0].0, place[1] + ways[1].0])
    };
    together(&nearest(a, b, &by_neighbours, [NEAR_PX; 2], RATIO_NEAR), a, b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that look random.
    fn noise(seed: u64) -> u64 {
        autoref_raster::random::mix(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    fn descriptor(seed: u64) -> [u8; DESCRIPTOR] {
        std::array::from_fn(|k| (noise(seed * 1000 + k as u64) % 120) as u8)
    }

    #[test]
    fn what_moves_together_is_matched_and_what_only_looks_alike_is_not() {
        let place = |k: u64| [(noise(2 * k) % 1000) as f64, (noise(2 * k + 1) % 1000) as f64];
        let (mut a, mut b) = (Features::default(), Features::default());
        for k in 0..400 {
            a.at.push(place(k));
            a.descriptors.push(descriptor(k));
            // One of two is in b, moved smoothly; of the others one of two has a double there.
            let [x, y] = place(k);
            if k % 2 == 0 {
                b.at.push([x + 30.0 + 0.02 * y, y - 12.0]);
                b.descriptors.push(descriptor(k).map(|v| v + 3));
            } else if k % 4 == 1 {
                b.at.push([x - 60.0 + (noise(k + 7000) % 120) as f64, y - 60.0 + (noise(k + 9000) % 120) as f64]);
                b.descriptors.push(descriptor(k).map(|v| v + 5));
            }
        }
        let found = matched(&a, &b, [120.0, 120.0]);
        let right = found
            .iter()
            .filter(|(i, j)| {
                let (p, q) = (a.at[*i], b.at[*j]);
                (q[0] - p[0] - 30.0 - 0.02 * p[1]).abs() < 1e-9 && (q[1] - p[1] + 12.0).abs() < 1e-9
            })
            .count();
        assert!(right >= 195, "{right} of 200");
        assert!(found.len() - right <= 4, "{} wrong", found.len() - right);
    }

    #[test]
    fn views_of_different_ground_have_no_matches() {
        let features = |seed: u64| Features {
            at: (0..300)
                .map(|k| [(noise(seed + 2 * k) % 800) as f64, (noise(seed + 2 * k + 1) % 800) as f64])
                .collect(),
            descriptors: (0..300).map(|k| descriptor(seed + k)).collect(),
        };
        assert_eq!(matched(&features(1), &features(50_000), [300.0, 300.0]), []);
        assert_eq!(matched(&Features::default(), &features(1), [300.0, 300.0]), []);
    }
}
