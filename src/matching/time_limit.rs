//! A limit in seconds, for who would rather have a refusal now. Without one no answer depends on the machine's speed.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Seconds for all searches together, counted from the first question. Clones share the clock.
#[derive(Clone, Debug, Default)]
pub struct TimeLimit(Option<Arc<Clock>>);

#[derive(Debug)]
struct Clock {
    allowed: Duration,
    ends: OnceLock<Instant>,
}

impl TimeLimit {
    /// So many seconds from the first search on.
    pub fn seconds(seconds: f64) -> Self {
        let allowed = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
        TimeLimit(Some(Arc::new(Clock { allowed, ends: OnceLock::new() })))
    }

    /// Whether the time is over; the first question starts the clock.
    pub fn is_over(&self) -> bool {
        self.0.as_ref().is_some_and(|clock| {
            let now = Instant::now();
            let ends = clock.ends.get_or_init(|| now.checked_add(clock.allowed).unwrap_or(now));
            clock.allowed != Duration::MAX && now >= *ends
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_limit_is_never_over_and_nothing_at_once() {
        assert!(!TimeLimit::default().is_over());
        assert!(!TimeLimit::seconds(1e9).is_over() && !TimeLimit::seconds(f64::INFINITY).is_over());
        assert!(TimeLimit::seconds(0.0).is_over());
    }
}
