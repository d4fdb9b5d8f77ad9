//! Convex hulls of points with whole coordinates (A. M. Andrew, "Another efficient algorithm for convex hulls in two
//! dimensions", 1979).

pub(super) type Corner = (i64, i64);

/// The corners of the hull, in the order of going round.
pub(super) fn convex_hull(mut points: Vec<Corner>) -> Vec<Corner> {
    points.sort_unstable();
    points.dedup();
    let turn = |a: Corner, b: Corner, c: Corner| (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0);
    let chain = |points: &mut dyn Iterator<Item = Corner>| {
        let mut hull: Vec<Corner> = Vec::new();
        for p in points {
            while hull.len() >= 2 && turn(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0 {
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
        hull
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

/// Each corner and the next.
pub(super) fn edges(hull: &[Corner]) -> impl Iterator<Item = (Corner, Corner)> + '_ {
    hull.iter().copied().zip(hull.iter().copied().cycle().skip(1))
}

/// Twice the area inside a closed line.
pub(super) fn twice_area(hull: &[Corner]) -> i64 {
    edges(hull).map(|(a, b)| a.0 * b.1 - b.0 * a.1).sum::<i64>().abs()
}
