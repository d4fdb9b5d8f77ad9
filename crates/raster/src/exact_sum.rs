//! Sums of floating-point numbers that do not depend on the order of their terms.

/// Bits of one limb.
const LIMB_BITS: u32 = 32;
/// From 2^-1074, the smallest double, to 2^1024, and room for carries.
const LIMBS: usize = 70;
/// A limb takes so many additions of 32-bit pieces before it may overflow.
const ADDITIONS_BEFORE_CARRY: u32 = 1 << 29;

/// The exact sum of doubles: a fixed-point number wide enough for all of them.
///
/// Whatever the order or the grouping of the terms, the sum is the same number, and [`ExactSum::value`] rounds it once.
/// (Kulisch, *Computer Arithmetic and Validity*, 2013, calls it the long accumulator.)
///
/// ```
/// use autoref_raster::exact_sum::ExactSum;
/// let sum: ExactSum = [1e100, 1.0, -1e100].into_iter().collect();
/// assert_eq!(sum.value(), 1.0);
/// ```
#[derive(Clone)]
pub struct ExactSum {
    limbs: [i64; LIMBS],
    additions: u32,
}

impl Default for ExactSum {
    fn default() -> Self {
        ExactSum { limbs: [0; LIMBS], additions: 0 }
    }
}

impl ExactSum {
    /// Adds one term. Terms that are not finite are left out; callers test for them.
    pub fn add(&mut self, term: f64) {
        debug_assert!(term.is_finite(), "only finite terms can be summed exactly");
        let bits = term.to_bits();
        let exponent = ((bits >> 52) & 0x7ff) as u32;
        if exponent == 0x7ff {
            return;
        }
        let fraction = bits & ((1 << 52) - 1);
        let (mantissa, position) = if exponent == 0 { (fraction, 0) } else { (fraction | (1 << 52), exponent - 1) };
        let limb = (position / LIMB_BITS) as usize;
        let wide = u128::from(mantissa) << (position % LIMB_BITS);
        let negative = term.is_sign_negative();
        for piece in 0..3 {
            let part = ((wide >> (32 * piece)) & 0xffff_ffff) as i64;
            self.limbs[limb + piece as usize] += if negative { -part } else { part };
        }
        self.additions += 1;
        if self.additions == ADDITIONS_BEFORE_CARRY {
            self.carry();
        }
    }

    /// Adds all terms of another sum.
    pub fn merge(&mut self, other: &ExactSum) {
        let mut other = other.clone();
        other.carry();
        self.carry();
        for (mine, theirs) in self.limbs.iter_mut().zip(other.limbs) {
            *mine += theirs;
        }
        self.carry();
    }

    /// Brings every limb but the last into 0…2³² − 1.
    fn carry(&mut self) {
        let mut carry = 0;
        for limb in &mut self.limbs[..LIMBS - 1] {
            let total = *limb + carry;
            *limb = total & 0xffff_ffff;
            carry = total >> LIMB_BITS;
        }
        self.limbs[LIMBS - 1] += carry;
        self.additions = 0;
    }

    /// The sum, rounded once to the nearest double; twice where that is subnormal.
    pub fn value(&self) -> f64 {
        let mut sum = self.clone();
        sum.carry();
        let negative = sum.limbs[LIMBS - 1] < 0;
        if negative {
            for limb in &mut sum.limbs {
                *limb = -*limb;
            }
            sum.carry();
        }
        let Some(top) = sum.limbs.iter().rposition(|&limb| limb != 0) else { return 0.0 };
        // The top 128 bits, with a sticky bit for the rest: one rounding, to nearest even.
        let mut bits: u128 = 0;
        for step in 0..4 {
            let limb = top.checked_sub(step).map_or(0, |index| sum.limbs[index]);
            bits = (bits << 32) | limb as u128;
        }
        if top >= 4 && sum.limbs[..top - 3].iter().any(|&limb| limb != 0) {
            bits |= 1;
        }
        // The lowest bit of limb 0 weighs 2^-1074.
        let exponent = (top as i32 - 3) * 32 - 1074;
        let magnitude = scale(bits as f64, exponent);
        if negative { -magnitude } else { magnitude }
    }
}

/// `value`·2^`exponent`, in two steps so that neither factor leaves the range of doubles.
fn scale(value: f64, exponent: i32) -> f64 {
    let half = exponent / 2;
    value * 2f64.powi(half) * 2f64.powi(exponent - half)
}

impl FromIterator<f64> for ExactSum {
    fn from_iter<I: IntoIterator<Item = f64>>(terms: I) -> Self {
        let mut sum = ExactSum::default();
        terms.into_iter().for_each(|term| sum.add(term));
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn order_and_grouping_change_nothing(mut terms in prop::collection::vec(-1e12f64..1e12, 0..200), cut in 0usize..200) {
            let forward: ExactSum = terms.iter().copied().collect();
            let cut = cut.min(terms.len());
            let mut parts: ExactSum = terms[cut..].iter().copied().collect();
            parts.merge(&terms[..cut].iter().copied().collect());
            terms.reverse();
            let backward: ExactSum = terms.iter().copied().collect();
            prop_assert_eq!(forward.value().to_bits(), backward.value().to_bits());
            prop_assert_eq!(forward.value().to_bits(), parts.value().to_bits());
            let plain: f64 = terms.iter().sum();
            let size: f64 = terms.iter().map(|term| term.abs()).sum();
            prop_assert!((plain - forward.value()).abs() <= 1e-13 * size);
        }

        #[test]
        fn sums_of_integers_are_exact(terms in prop::collection::vec(-(1i64 << 40)..(1 << 40), 1..300)) {
            let sum: ExactSum = terms.iter().map(|&t| t as f64).collect();
            prop_assert_eq!(sum.value(), terms.iter().sum::<i64>() as f64);
        }

        #[test]
        fn one_term_comes_back(term in prop::num::f64::NORMAL) {
            let sum: ExactSum = [term].into_iter().collect();
            prop_assert_eq!(sum.value().to_bits(), term.to_bits());
        }
    }

    #[test]
    fn cancellation_is_exact() {
        let sum: ExactSum = [1e300, 3.5, -1e300, 1e-300, -3.5].into_iter().collect();
        assert_eq!(sum.value(), 1e-300);
        assert_eq!(ExactSum::default().value(), 0.0);
    }
}
