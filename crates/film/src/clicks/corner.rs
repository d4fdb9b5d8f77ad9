//! The corner in which two straight edges meet: the tip of a wedge or a notch.

use super::Values;
use super::field::Field;

/// Edges are looked at within these shares of the disc that is compared; the first that shows one corner tells it.
const SHARES: [f64; 2] = [0.6, 0.4];
/// What lies nearer to the corner, as a share of the disc, is rounded by blur: there each edge bends the other.
const ROUNDED: f64 = 0.4;
/// Slopes below this share of the steepest are grain.
const GRAIN: f64 = 0.3;
/// Ratio of the smaller to the larger principal moment of the slopes from which edges meet at an angle (31 degrees).
const ANGLE: f64 = 0.08;
/// Edges of a corner pass it as near as blur makes them wide, values of the grid, and a share of the disc.
const WIDE: f64 = 1.0;
const BENT: f64 = 0.1;
const ROUNDS: usize = 8;

impl Field {
    /// The corner within `reach` of a place, both from the window's middle; `None` where the edges about it do not all
    /// lead to one point. After W. Förstner and E. Gülch, "A fast operator for detection and precise location of
    /// distinct points, corners and centres of circular features", 1987: the point that the lines along all edges pass
    /// nearest.
    pub(super) fn corner(&self, window: &Values, about: [f64; 2], reach: f64) -> Option<[f64; 2]> {
        let slopes = self.slopes(window);
        let radii = SHARES.map(|share| (share * self.radius as f64).max(4.0));
        radii.into_iter().find_map(|radius| self.corner_within(&slopes, radius, (about, reach)))
    }

    fn corner_within(
        &self,
        slopes: &[Option<[f64; 2]>],
        radius: f64,
        (about, reach): ([f64; 2], f64),
    ) -> Option<[f64; 2]> {
        let mut at = about;
        for _ in 0..ROUNDS {
            let edges = self.edges_about(slopes, at, radius);
            let next = meeting(&edges)?;
            if (next[0] - about[0]).hypot(next[1] - about[1]) > reach {
                return None;
            }
            let moved = (next[0] - at[0]).hypot(next[1] - at[1]);
            at = next;
            if moved < 0.01 {
                break;
            }
        }
        let edges = self.edges_about(slopes, at, radius);
        let (mut off, mut all) = (0.0, 0.0);
        for Edge { from, slope } in &edges {
            off += (slope[0] * (from[0] - at[0]) + slope[1] * (from[1] - at[1])).powi(2);
            all += slope[0] * slope[0] + slope[1] * slope[1];
        }
        ((off / all).sqrt() <= WIDE + BENT * radius).then_some(at)
    }

    /// The steep places of a ring about `at`.
    fn edges_about(&self, slopes: &[Option<[f64; 2]>], at: [f64; 2], radius: f64) -> Vec<Edge> {
        let middle = [0.5 * (self.width - 1) as f64, 0.5 * (self.height - 1) as f64];
        let edge = |(k, slope): (usize, &Option<[f64; 2]>)| {
            let place = [k as i64 % self.width, k as i64 / self.width].map(|v| v as f64);
            let from = [place[0] - middle[0], place[1] - middle[1]];
            let far = (from[0] - at[0]).hypot(from[1] - at[1]);
            (ROUNDED * radius..=radius).contains(&far).then_some(Edge { from, slope: (*slope)? })
        };
        let all: Vec<Edge> = slopes.iter().enumerate().filter_map(edge).collect();
        let steepest = all.iter().map(Edge::steepness).fold(0.0, f64::max);
        all.into_iter().filter(|e| e.steepness() >= GRAIN * steepest).collect()
    }
}

/// A steep place, from the window's middle, and its slope across and down.
struct Edge {
    from: [f64; 2],
    slope: [f64; 2],
}

impl Edge {
    fn steepness(&self) -> f64 {
        self.slope[0].hypot(self.slope[1])
    }
}

/// The point that the lines along the edges pass nearest, weighted by their steepness; `None` where they are parallel.
fn meeting(edges: &[Edge]) -> Option<[f64; 2]> {
    let (mut xx, mut xy, mut yy, mut x, mut y) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for Edge { from, slope: [gx, gy] } in edges {
        let along = gx * from[0] + gy * from[1];
        (xx, xy, yy) = (xx + gx * gx, xy + gx * gy, yy + gy * gy);
        (x, y) = (x + gx * along, y + gy * along);
    }
    let half_gap = (0.5 * (xx - yy)).hypot(xy);
    let mean = 0.5 * (xx + yy);
    if mean <= 0.0 || (mean - half_gap) / (mean + half_gap) < ANGLE {
        return None;
    }
    let determinant = xx * yy - xy * xy;
    Some([(yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant])
}
