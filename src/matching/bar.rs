//! What a hypothesis must reach to be refined.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// The score that a hypothesis must reach to be refined: that of the last of the best so far, whoever found them. What
/// stays below it is none of the best of all, so that nothing depends on the order.
pub(super) struct Bar<'a> {
    best: Mutex<Vec<f64>>,
    /// The bits of the least of them. Those of positive numbers are in the order of the numbers.
    least: AtomicU64,
    /// One that must be reached too.
    above: Option<&'a Bar<'a>>,
}

impl<'a> Bar<'a> {
    /// For as many of the best as are refined.
    pub fn of(refined: usize) -> Bar<'static> {
        Bar { best: Mutex::new(vec![0.0; refined]), least: AtomicU64::new(0), above: None }
    }

    /// The same for those that reach another bar too.
    pub fn under(above: &'a Bar<'a>, refined: usize) -> Bar<'a> {
        Bar { above: Some(above), ..Bar::of(refined) }
    }

    /// Whether a score of no more than this may be one of the best; a hair more, so that rounding decides nothing.
    #[inline]
    pub fn lets_by(&self, most: f64) -> bool {
        most + 1e-9 >= f64::from_bits(self.least.load(Ordering::Relaxed))
            && self.above.is_none_or(|bar| bar.lets_by(most))
    }

    /// A score was reached: what must be reached may rise.
    pub fn raise(&self, score: f64) {
        if score <= f64::from_bits(self.least.load(Ordering::Relaxed)) {
            return;
        }
        let mut best = self.best.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(last) = best.iter_mut().min_by(|s, t| s.total_cmp(t)).filter(|last| score > **last) {
            *last = score;
        }
        let least = best.iter().copied().fold(f64::INFINITY, f64::min);
        self.least.store(least.to_bits(), Ordering::Relaxed);
    }
}
