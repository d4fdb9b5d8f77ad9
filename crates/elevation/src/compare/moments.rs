//! Sums of differences in whole numbers.

/// Units of a difference in sums: 2⁻²⁰ m.
const UNIT: f64 = (1u64 << 20) as f64;

/// Moments that do not depend on the order.
#[derive(Clone, Default)]
pub(super) struct Moments {
    pub(super) n: u64,
    pub(super) sum: i128,
    pub(super) squares: i128,
    pub(super) within: u64,
    pub(super) low: Option<f32>,
    pub(super) high: Option<f32>,
}

/// What a difference adds to moments.
pub(super) struct Term {
    value: f32,
    fixed: i64,
    square: i128,
    within: bool,
}

impl Term {
    #[inline]
    pub(super) fn of(value: f32, within_m: f64) -> Term {
        let fixed = (f64::from(value) * UNIT).round() as i64;
        let square = i128::from(fixed) * i128::from(fixed);
        Term { value, fixed, square, within: f64::from(value).abs() <= within_m }
    }
}

impl Moments {
    #[inline]
    pub(super) fn add(&mut self, term: &Term) {
        self.n += 1;
        self.sum += i128::from(term.fixed);
        self.squares += term.square;
        self.within += u64::from(term.within);
        self.low = Some(self.low.map_or(term.value, |v| v.min(term.value)));
        self.high = Some(self.high.map_or(term.value, |v| v.max(term.value)));
    }

    pub(super) fn merge(&mut self, other: &Moments) {
        self.n += other.n;
        self.sum += other.sum;
        self.squares += other.squares;
        self.within += other.within;
        self.low = self.low.into_iter().chain(other.low).reduce(f32::min);
        self.high = self.high.into_iter().chain(other.high).reduce(f32::max);
    }

    pub(super) fn mean(&self) -> Option<f64> {
        (self.n > 0).then(|| self.sum as f64 / UNIT / self.n as f64)
    }

    pub(super) fn rmse(&self) -> Option<f64> {
        (self.n > 0).then(|| (self.squares as f64 / (UNIT * UNIT) / self.n as f64).sqrt())
    }

    /// Divisor n.
    pub(super) fn sd(&self) -> Option<f64> {
        let (mean, rmse) = (self.mean()?, self.rmse()?);
        Some((rmse * rmse - mean * mean).max(0.0).sqrt())
    }
}
