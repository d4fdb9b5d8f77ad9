//! Is a frame like those that taught? Pixels with no taught pixel near, by the sum of the features' differences.

use autoref_raster::window::Window;

use crate::bits::BitMask;
use crate::features::FEATURES;
use crate::forest::Example;

/// Farther than this from every taught pixel is far, sum over the features.
///
/// Source: nine tenths of the shipped pixels lie nearer to the rest, when an eleventh of their list is left out at a
/// time.
pub const FAR: u16 = 270;

/// A frame with more far pixels than this is unlike what was taught.
pub const UNLIKE_SHARE: f64 = 0.25;

/// Pixels of a frame that are looked at, about.
const LOOKED_AT: f64 = 1000.0;

/// Features of what was taught.
pub struct Known(Vec<[u8; FEATURES]>);

impl Known {
    /// The features of all examples.
    pub fn new(examples: &[Example<FEATURES>]) -> Known {
        Known(examples.iter().map(|example| example.features).collect())
    }

    /// Is no taught pixel within [`FAR`]?
    pub fn is_far(&self, features: &[u8; FEATURES]) -> bool {
        // Sums of so few bytes fit 16 bits; without a check in every step the compiler adds eight at a time.
        const { assert!(FEATURES * 255 <= u16::MAX as usize) };
        let distance = |known: &[u8; FEATURES]| {
            known.iter().zip(features).fold(0, |sum: u16, (a, b)| sum.wrapping_add(u16::from(a.abs_diff(*b))))
        };
        !self.0.iter().any(|known| distance(known) <= FAR)
    }
}

/// The pixels of a frame that are looked at: a lattice about the frame's corner, the same for every tiling.
#[derive(Clone, Copy, Debug)]
pub struct Lattice(u64);

impl Lattice {
    /// Of a frame of `width` × `height` pixels.
    pub fn of(width: usize, height: usize) -> Lattice {
        Lattice((((width * height) as f64 / LOOKED_AT).sqrt() as u64).max(1))
    }

    /// The lattice's pixels in `window`.
    pub fn within(self, window: &Window) -> impl Iterator<Item = (u64, u64)> {
        let first = |from: u64| from + (self.0 / 2 + self.0 - from % self.0) % self.0;
        let (step, columns) = (self.0 as usize, (first(window.x)..window.right()).step_by(self.0 as usize));
        (first(window.y)..window.bottom()).step_by(step).flat_map(move |y| columns.clone().map(move |x| (x, y)))
    }
}

/// The pixels that were looked at, x and y, with whether they are far.
#[derive(Clone, Debug, Default)]
pub struct Seen(Vec<((usize, usize), bool)>);

impl Seen {
    pub(crate) fn add(&mut self, at: (usize, usize), is_far: bool) {
        self.0.push((at, is_far));
    }

    pub(crate) fn join(&mut self, other: Seen) {
        self.0.extend(other.0);
    }

    /// Leaves out what the classifier does not decide.
    pub(crate) fn retain(&mut self, decided: &BitMask) {
        self.0.retain(|&((x, y), _)| decided.get(x, y));
    }

    /// Share of far pixels, 0…1.
    pub fn share(&self) -> f64 {
        self.0.iter().filter(|(_, is_far)| *is_far).count() as f64 / (self.0.len() as f64).max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_share_one_lattice() {
        let lattice = Lattice::of(400, 300);
        let whole: Vec<_> = lattice.within(&Window::new(0, 0, 400, 300)).collect();
        let mut parts = Vec::new();
        for window in [Window::new(0, 0, 257, 300), Window::new(257, 0, 143, 13), Window::new(257, 13, 143, 287)] {
            parts.extend(lattice.within(&window));
        }
        parts.sort_unstable_by_key(|&(x, y)| (y, x));
        assert_eq!(parts, whole);
        assert!((900..1400).contains(&whole.len()), "{}", whole.len());
    }

    #[test]
    fn what_is_not_decided_has_no_share() {
        let mut seen = Seen::default();
        [1, 3, 5, 7].into_iter().for_each(|x| seen.add((x, 0), x > 4));
        assert_eq!(seen.share(), 0.5);
        seen.retain(&BitMask::from_fn(8, 1, |x, _| x != 7));
        assert!((seen.share() - 1.0 / 3.0).abs() < 1e-12);
        seen.retain(&BitMask::new(8, 1));
        assert_eq!(seen.share(), 0.0);
    }

    #[test]
    fn far_is_the_sum_of_differences() {
        let example = Example { features: [100; FEATURES], keep: true, weight: 1 };
        let known = Known::new(&[example]);
        let mut features = [108; FEATURES];
        assert!(!known.is_far(&features));
        features[0] += 31;
        assert!(known.is_far(&features));
    }
}
