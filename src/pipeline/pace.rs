//! Keeps the tiles that are under way close together, and what is fetched of the file close before them.
//!
//! What was found at the faces of a tile that comes late waits for it in memory, and the longer the scan, the later the
//! latest comes: without a bound the peak would grow with the file.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// So many tiles for each worker are handed out before the first that has not come.
const TILES_AHEAD: u64 = 8;

/// How far the tiles have come.
pub(super) struct Pace {
    ahead: u64,
    fetched_ahead: u64,
    reached: Mutex<Reached>,
    moved: Condvar,
}

struct Reached {
    first_missing: u64,
    /// The nearest place that anybody waits for: to wake whoever waits for more would only cost the time of those who
    /// work.
    wanted: u64,
}

impl Pace {
    /// `fetched` tiles are fetched before they are handed out.
    pub fn of(workers: usize, fetched: u64) -> Pace {
        let ahead = TILES_AHEAD * workers as u64;
        let reached = Mutex::new(Reached { first_missing: 0, wanted: u64::MAX });
        Pace { ahead, fetched_ahead: ahead + fetched, reached, moved: Condvar::new() }
    }

    fn state(&self) -> MutexGuard<'_, Reached> {
        // Numbers are whole whoever held them.
        self.reached.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns when a tile may be handed out.
    pub fn wait_for_turn(&self, tile: u64) {
        self.wait(tile, self.ahead);
    }

    /// Returns when a tile may be fetched.
    pub fn wait_to_fetch(&self, tile: u64) {
        self.wait(tile, self.fetched_ahead);
    }

    fn wait(&self, tile: u64, ahead: u64) {
        let needed = (tile + 1).saturating_sub(ahead);
        let too_far = |reached: &mut Reached| {
            let too_far = reached.first_missing < needed;
            if too_far {
                reached.wanted = reached.wanted.min(needed);
            }
            too_far
        };
        drop(self.moved.wait_while(self.state(), too_far).unwrap_or_else(PoisonError::into_inner));
    }

    /// All tiles before this one have come.
    pub fn reached(&self, first_missing: u64) {
        let mut reached = self.state();
        reached.first_missing = reached.first_missing.max(first_missing);
        if reached.first_missing >= reached.wanted {
            // Whoever has to wait on says so again.
            reached.wanted = u64::MAX;
            self.moved.notify_all();
        }
    }

    /// Nobody need wait any more.
    pub fn lift(&self) {
        self.reached(u64::MAX);
    }

    /// A worker that panics leaves a tile that never comes. Nobody may wait for it, or the panic would not be heard:
    /// the guard lifts the pace when it is dropped by one.
    pub fn lifted_by_panic(&self) -> impl Drop + '_ {
        struct Guard<'a>(&'a Pace);
        impl Drop for Guard<'_> {
            fn drop(&mut self) {
                if std::thread::panicking() {
                    self.0.lift();
                }
            }
        }
        Guard(self)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    #[test]
    fn no_tile_is_handed_out_too_far_ahead() {
        let (pace, reached) = (Pace::of(1, 0), AtomicU64::new(0));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for tile in 0..200 {
                    pace.wait_for_turn(tile);
                    assert!(tile < reached.load(Ordering::SeqCst) + TILES_AHEAD);
                }
            });
            for tile in 1..=200 {
                // What is noted first is never less than what is allowed.
                reached.store(tile, Ordering::SeqCst);
                pace.reached(tile);
                std::thread::yield_now();
            }
        });
    }

    #[test]
    fn a_panic_ends_the_waiting() {
        let pace = Pace::of(1, 0);
        std::thread::scope(|scope| {
            let failing = scope.spawn(|| {
                let _rest = pace.lifted_by_panic();
                panic!("on purpose");
            });
            pace.wait_for_turn(1000);
            assert!(failing.join().is_err());
        });
    }
}
