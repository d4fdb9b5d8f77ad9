//! Points by how far they lie from each other: what may be a pair of GCPs whose length in pixels is known.

use autoref_raster::coords::PixelPoint;

/// Of more points the pairs take too much memory: eight bytes each.
const MOST_POINTS: usize = 1024;
/// What rounding the squares of distances to single precision may hide, relative.
const ROUNDING: f64 = 1e-6;

/// All unordered pairs of points in the order of their distances.
pub(super) struct Distances {
    squares_px2: Vec<f32>,
    ends: Vec<(u16, u16)>,
}

impl Distances {
    /// `None` of too many points.
    pub fn of(points: &[PixelPoint]) -> Option<Distances> {
        if points.len() > MOST_POINTS {
            return None;
        }
        // Bits of positive numbers are in the order of the numbers.
        let mut pairs: Vec<u64> = Vec::with_capacity(points.len() * points.len().saturating_sub(1) / 2);
        for (i, p) in points.iter().enumerate() {
            pairs.extend((i + 1..points.len()).map(|j| {
                let (x, y) = (points[j].x - p.x, points[j].y - p.y);
                u64::from(((x * x + y * y) as f32).to_bits()) << 32 | (i as u64) << 16 | j as u64
            }));
        }
        pairs.sort_unstable();
        let squares_px2 = pairs.iter().map(|pair| f32::from_bits((pair >> 32) as u32)).collect();
        let ends = pairs.iter().map(|pair| ((pair >> 16) as u16, *pair as u16)).collect();
        Some(Distances { squares_px2, ends })
    }

    /// Calls `visit` with every ordered pair of points so far from each other, and a few that are a hair nearer or
    /// farther.
    pub fn between(&self, (low_px, high_px): (f64, f64), mut visit: impl FnMut(usize, usize)) {
        let low = low_px * low_px * (1.0 - ROUNDING);
        let high = high_px * high_px * (1.0 + ROUNDING);
        let from = self.squares_px2.partition_point(|square| f64::from(*square) < low);
        let to = self.squares_px2.partition_point(|square| f64::from(*square) <= high);
        for &(i, j) in &self.ends[from..to.max(from)] {
            visit(usize::from(i), usize::from(j));
            visit(usize::from(j), usize::from(i));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::SplitMix64;

    #[test]
    fn every_pair_of_a_length_is_visited_in_both_orders() {
        let mut random = SplitMix64(5);
        let mut unit = || random.unit();
        let points: Vec<PixelPoint> = (0..200).map(|_| PixelPoint { x: 4000.0 * unit(), y: 3000.0 * unit() }).collect();
        let distances = Distances::of(&points).expect("few points");
        for reach in [(16.0, 40.0), (900.0, 930.0), (0.0, 5000.0), (3000.0, 2000.0)] {
            let spans = |i: usize, j: usize| {
                let (x, y) = (points[j].x - points[i].x, points[j].y - points[i].y);
                let square = x * x + y * y;
                i != j && square >= reach.0 * reach.0 && square <= reach.1 * reach.1
            };
            let all = (0..points.len()).flat_map(|i| (0..points.len()).map(move |j| (i, j)));
            let expected: Vec<(usize, usize)> = all.filter(|&(i, j)| spans(i, j)).collect();
            let mut seen = Vec::new();
            distances.between(reach, |i, j| seen.push((i, j)));
            assert!(seen.len() <= expected.len() + 4, "{reach:?}: {} of {}", seen.len(), expected.len());
            seen.retain(|&(i, j)| spans(i, j));
            seen.sort_unstable();
            assert_eq!(seen, expected, "{reach:?}");
        }
    }

    #[test]
    fn very_many_points_are_not_paired() {
        let points = vec![PixelPoint { x: 0.0, y: 0.0 }; MOST_POINTS + 1];
        assert!(Distances::of(&points).is_none());
        assert!(Distances::of(&points[1..]).is_some());
    }
}
