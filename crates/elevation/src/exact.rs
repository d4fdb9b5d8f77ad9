//! Sums that do not depend on the order of their terms.
//!
//! Every term is kept to its last bit in a long fixed-point number, so that partial sums of any tiling and any number
//! of threads join to the same bits (U. Kulisch, *Computer Arithmetic and Validity*, 2013, chapter 8: the long
//! accumulator).

/// Bits of a limb.
const LIMB_BITS: usize = 32;
/// 2046 exponents, 53 bits of a mantissa, and head room for carries.
const LIMBS: usize = 68;
/// Terms after which the limbs are brought below 2³² again; 2³¹ would still be safe.
const NORMALISE_AFTER: u32 = 1 << 28;

/// The exact sum of any number of finite `f64`.
///
/// ```
/// use autoref_elevation::exact::ExactSum;
/// let mut sum = ExactSum::default();
/// for term in [1e100, 1.0, -1e100] {
///     sum.add(term);
/// }
/// assert_eq!(sum.value(), 1.0);
/// ```
#[derive(Clone)]
pub struct ExactSum {
    limbs: [i64; LIMBS],
    pending: u32,
}

impl Default for ExactSum {
    fn default() -> Self {
        ExactSum { limbs: [0; LIMBS], pending: 0 }
    }
}

impl ExactSum {
    /// Adds a term. Terms that are not finite are left out; callers test for them.
    pub fn add(&mut self, term: f64) {
        debug_assert!(term.is_finite(), "a term that is not finite");
        let bits = term.to_bits();
        let exponent = ((bits >> 52) & 0x7ff) as usize;
        let fraction = bits & ((1 << 52) - 1);
        if exponent == 0x7ff || (exponent == 0 && fraction == 0) {
            return;
        }
        let (mantissa, place) = if exponent == 0 { (fraction, 0) } else { (fraction | 1 << 52, exponent - 1) };
        let wide = u128::from(mantissa) << (place % LIMB_BITS);
        let limb = place / LIMB_BITS;
        let sign = if bits >> 63 == 0 { 1 } else { -1 };
        for (i, target) in self.limbs[limb..limb + 3].iter_mut().enumerate() {
            *target += sign * ((wide >> (LIMB_BITS * i)) as u32 as i64);
        }
        self.pending += 1;
        if self.pending >= NORMALISE_AFTER {
            self.normalise();
        }
    }

    /// Adds another sum.
    pub fn merge(&mut self, other: &ExactSum) {
        for (mine, theirs) in self.limbs.iter_mut().zip(&other.limbs) {
            *mine += theirs;
        }
        self.pending = self.pending.saturating_add(other.pending);
        if self.pending >= NORMALISE_AFTER {
            self.normalise();
        }
    }

    /// Limbs but the last into 0..2³²; the last keeps the sign.
    fn normalise(&mut self) {
        let mut carry = 0i64;
        for limb in &mut self.limbs[..LIMBS - 1] {
            let value = *limb + carry;
            carry = value >> LIMB_BITS;
            *limb = value & 0xffff_ffff;
        }
        self.limbs[LIMBS - 1] += carry;
        self.pending = 1;
    }

    /// The sum, to the last place or the one before it, the same for the same terms in any order.
    pub fn value(&self) -> f64 {
        let mut whole = self.clone();
        whole.normalise();
        let negative = whole.limbs[LIMBS - 1] < 0;
        if negative {
            for limb in &mut whole.limbs {
                *limb = -*limb;
            }
            whole.normalise();
        }
        // The first limbs that hold something carry at least 65 bits; what follows is below the last place.
        let Some(top) = whole.limbs.iter().rposition(|&limb| limb != 0) else { return 0.0 };
        let mut value = 0.0;
        for index in (top.saturating_sub(3)..=top).rev() {
            value += whole.limbs[index] as f64 * power_of_two(index as i32 * LIMB_BITS as i32 - 1074);
        }
        if negative { -value } else { value }
    }
}

/// 2ⁿ, in two steps where one would underflow.
fn power_of_two(n: i32) -> f64 {
    if n < -1000 { f64::powi(2.0, -1000) * f64::powi(2.0, n + 1000) } else { f64::powi(2.0, n) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_order_and_any_grouping_gives_the_same_bits() {
        let mut state = 7u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let terms: Vec<f64> = (0..5000).map(|i| next() * 10f64.powi(i % 37 - 18)).collect();
        let sum = |terms: &[f64]| {
            let mut sum = ExactSum::default();
            terms.iter().for_each(|&t| sum.add(t));
            sum
        };
        let forward = sum(&terms);
        let reversed: Vec<f64> = terms.iter().rev().copied().collect();
        assert_eq!(forward.value().to_bits(), sum(&reversed).value().to_bits());
        for cut in [1, 17, 2500, 4999] {
            let mut joined = sum(&terms[cut..]);
            joined.merge(&sum(&terms[..cut]));
            assert_eq!(forward.value().to_bits(), joined.value().to_bits());
        }
        let plain: f64 = terms.iter().sum();
        assert!((forward.value() - plain).abs() < 1e-9 * terms.iter().map(|t| t.abs()).sum::<f64>());
    }

    #[test]
    fn cancellation_and_extremes_are_exact() {
        let mut sum = ExactSum::default();
        for term in [1e300, 3.5, -1e300, f64::MIN_POSITIVE / 4.0, -3.5] {
            sum.add(term);
        }
        assert_eq!(sum.value(), f64::MIN_POSITIVE / 4.0);
        let mut negative = ExactSum::default();
        negative.add(-0.1);
        negative.add(-0.2);
        assert!((negative.value() + 0.3).abs() < 1e-16);
    }
}
