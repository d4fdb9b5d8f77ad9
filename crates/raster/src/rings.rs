//! Which sides of rings a level line may cross.

/// Sides of rings, by number, in slices of northings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SidesByNorthing {
    /// Of each slice the sides that reach into it, in order.
    slices: Vec<Vec<u32>>,
    low: f64,
    slice_height: f64,
}

impl SidesByNorthing {
    /// `spans` are the lowest and the highest northing of each side, none of which is level.
    pub fn new(spans: &[(f64, f64)]) -> SidesByNorthing {
        if spans.is_empty() {
            return SidesByNorthing::default();
        }
        let low = spans.iter().map(|span| span.0).fold(f64::INFINITY, f64::min);
        let high = spans.iter().map(|span| span.1).fold(f64::NEG_INFINITY, f64::max);
        // Long sides reach into many slices: fewer slices then, so that the lists stay about as long as the sides.
        let heights: f64 = spans.iter().map(|span| (span.1 - span.0) / (high - low)).sum();
        let fitting = (4.0 * spans.len() as f64 / heights).max(64.0) as usize;
        let count = spans.len().min(fitting).clamp(1, 4096);
        let slice_height = ((high - low) / count as f64).max(f64::MIN_POSITIVE);
        let mut slices = vec![Vec::new(); count];
        let slice = |northing: f64| (((northing - low) / slice_height) as usize).min(count - 1);
        for (i, span) in (0..).zip(spans) {
            slices[slice(span.0)..=slice(span.1)].iter_mut().for_each(|list| list.push(i));
        }
        SidesByNorthing { slices, low, slice_height }
    }

    /// Numbers of the sides that a level line at `northing` may cross, ascending: all that it crosses, and some more.
    pub fn near(&self, northing: f64) -> &[u32] {
        let at = (northing - self.low) / self.slice_height;
        // NaN is nowhere.
        if self.slices.is_empty() || !(0.0..=self.slices.len() as f64).contains(&at) {
            return &[];
        }
        &self.slices[(at as usize).min(self.slices.len() - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix64;

    #[test]
    fn every_side_that_a_line_crosses_is_near_it() {
        let mut random = SplitMix64(3);
        let spans: Vec<(f64, f64)> = (0..500)
            .map(|i| {
                let low = 1000.0 * random.unit();
                (low, low + if i % 50 == 0 { 900.0 } else { 5.0 } * random.unit())
            })
            .collect();
        let sides = SidesByNorthing::new(&spans);
        let mut listed = 0;
        for _ in 0..500 {
            let y = -100.0 + 2100.0 * random.unit();
            let near = sides.near(y);
            assert!(near.is_sorted());
            let crosses = |span: &(f64, f64)| span.0 <= y && y < span.1;
            assert!((0..).zip(&spans).all(|(i, span)| !crosses(span) || near.contains(&i)), "{y}");
            listed += near.len();
        }
        assert!(listed < 500 * 30, "{listed}");
        assert!(sides.near(f64::NAN).is_empty() && SidesByNorthing::new(&[]).near(0.0).is_empty());
    }
}
