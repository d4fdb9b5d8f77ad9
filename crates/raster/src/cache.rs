//! Decoded chunks, each decoded once: a bounded least-recently-used store in which a second thread that wants the same
//! chunk waits for the first.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::PieceData;
use crate::error::Result;

/// What a [`ChunkCache`] keeps.
pub trait Cached: Clone {
    /// What it costs to keep.
    fn bytes(&self) -> u64;
}

/// Pixels of one chunk: a file block or a group of them.
#[derive(Clone, Debug)]
pub struct Chunk {
    /// `None` where the file holds nothing (sparse) and that means "no pixel is valid".
    pub data: Option<PieceData>,
    /// Index of the first sample in `data`.
    pub offset: usize,
    pub row_stride: usize,
    pub pixel_stride: usize,
    /// What it costs to keep.
    pub bytes: u64,
}

impl Cached for Chunk {
    fn bytes(&self) -> u64 {
        self.bytes
    }
}

/// One decoding under way; those who wait hold on to it, so that they get the chunk even when it is evicted at once.
struct Flight<C> {
    outcome: Mutex<Outcome<C>>,
    landed: Condvar,
}

enum Outcome<C> {
    Pending,
    Done(C),
    /// The decoder failed; each waiter tries itself and reports its own error.
    Failed,
}

enum Slot<C> {
    Decoding(Arc<Flight<C>>),
    Ready { chunk: C, used: u64 },
}

struct State<C> {
    slots: HashMap<u64, Slot<C>>,
    /// Time of last use → key, for eviction.
    order: BTreeMap<u64, u64>,
    bytes: u64,
    clock: u64,
}

/// See the module.
pub struct ChunkCache<C = Chunk> {
    state: Mutex<State<C>>,
    capacity_bytes: u64,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic elsewhere leaves the maps whole: every change of them is finished before the lock is let go.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes the slot of a decoding that did not finish (error or panic) away again and wakes those who wait.
struct Landing<'a, C> {
    cache: &'a ChunkCache<C>,
    key: u64,
    flight: Arc<Flight<C>>,
    done: bool,
}

impl<C> Drop for Landing<'_, C> {
    fn drop(&mut self) {
        if !self.done {
            lock(&self.cache.state).slots.remove(&self.key);
            *lock(&self.flight.outcome) = Outcome::Failed;
        }
        self.flight.landed.notify_all();
    }
}

impl<C: Cached> ChunkCache<C> {
    /// Keeps at most `capacity_bytes` of decoded chunks that nobody uses; what readers hold is theirs.
    pub fn new(capacity_bytes: u64) -> Self {
        let state = State { slots: HashMap::new(), order: BTreeMap::new(), bytes: 0, clock: 0 };
        ChunkCache { state: Mutex::new(state), capacity_bytes }
    }

    /// The chunk `key`, decoded by `decode` unless it is here or another thread is at it.
    ///
    /// # Errors
    /// Those of `decode`.
    pub fn get(&self, key: u64, decode: impl Fn() -> Result<C>) -> Result<C> {
        loop {
            let flight = match self.begin(key) {
                Begin::Ready(chunk) => return Ok(chunk),
                Begin::Mine(flight) => {
                    let mut landing = Landing { cache: self, key, flight, done: false };
                    let chunk = decode()?;
                    self.finish(key, &chunk);
                    *lock(&landing.flight.outcome) = Outcome::Done(chunk.clone());
                    landing.done = true;
                    return Ok(chunk);
                }
                Begin::Theirs(flight) => flight,
            };
            let mut outcome = lock(&flight.outcome);
            while matches!(*outcome, Outcome::Pending) {
                outcome = flight.landed.wait(outcome).unwrap_or_else(PoisonError::into_inner);
            }
            if let Outcome::Done(chunk) = &*outcome {
                return Ok(chunk.clone());
            }
        }
    }

    fn begin(&self, key: u64) -> Begin<C> {
        let mut state = lock(&self.state);
        let state = &mut *state;
        state.clock += 1;
        match state.slots.get_mut(&key) {
            Some(Slot::Ready { chunk, used }) => {
                state.order.remove(used);
                *used = state.clock;
                state.order.insert(state.clock, key);
                Begin::Ready(chunk.clone())
            }
            Some(Slot::Decoding(flight)) => Begin::Theirs(flight.clone()),
            None => {
                let flight = Arc::new(Flight { outcome: Mutex::new(Outcome::Pending), landed: Condvar::new() });
                state.slots.insert(key, Slot::Decoding(flight.clone()));
                Begin::Mine(flight)
            }
        }
    }

    fn finish(&self, key: u64, chunk: &C) {
        let mut evicted = Vec::new();
        let mut state = lock(&self.state);
        if chunk.bytes() > self.capacity_bytes {
            state.slots.remove(&key);
            return;
        }
        state.clock += 1;
        let used = state.clock;
        state.slots.insert(key, Slot::Ready { chunk: chunk.clone(), used });
        state.order.insert(used, key);
        state.bytes += chunk.bytes();
        while state.bytes > self.capacity_bytes {
            let Some((_, oldest)) = state.order.pop_first() else { break };
            if let Some(Slot::Ready { chunk, .. }) = state.slots.remove(&oldest) {
                state.bytes -= chunk.bytes();
                evicted.push(chunk);
            }
        }
        // Buffers are freed or go home after the lock is gone.
        drop(state);
        drop(evicted);
    }

    /// Lets go of the chunks for which `done` says so.
    pub fn forget(&self, done: impl Fn(u64) -> bool) {
        let mut gone = Vec::new();
        let mut state = lock(&self.state);
        let keys: Vec<u64> = state.order.values().copied().filter(|&key| done(key)).collect();
        for key in keys {
            if let Some(Slot::Ready { chunk, used }) = state.slots.remove(&key) {
                state.order.remove(&used);
                state.bytes -= chunk.bytes();
                gone.push(chunk);
            }
        }
        drop(state);
        drop(gone);
    }
}

enum Begin<C> {
    Ready(C),
    Mine(Arc<Flight<C>>),
    Theirs(Arc<Flight<C>>),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn chunk(bytes: u64) -> Chunk {
        Chunk { data: None, offset: 0, row_stride: 0, pixel_stride: 1, bytes }
    }

    #[test]
    fn many_threads_decode_once() {
        let cache = ChunkCache::new(1000);
        let count = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for key in 0..10 {
                        let got = cache.get(key, || {
                            count.fetch_add(1, Ordering::SeqCst);
                            std::thread::sleep(std::time::Duration::from_millis(2));
                            Ok(chunk(100))
                        });
                        assert_eq!(got.expect("never fails").bytes, 100);
                    }
                });
            }
        });
        assert_eq!(count.load(Ordering::SeqCst), 10);
    }

    #[test]
    fn the_least_recently_used_goes_first() {
        let cache = ChunkCache::new(300);
        let decoded = Mutex::new(Vec::new());
        let get = |key| {
            cache
                .get(key, || {
                    lock(&decoded).push(key);
                    Ok(chunk(100))
                })
                .expect("never fails")
        };
        for key in [1, 2, 3, 1, 4, 1, 2] {
            get(key);
        }
        assert_eq!(*lock(&decoded), [1, 2, 3, 4, 2]);
        cache.forget(|key| key == 1);
        get(1);
        assert_eq!(lock(&decoded).len(), 6);
    }

    #[test]
    fn waiters_of_a_failure_fail_too_and_a_panic_frees_the_slot() {
        let cache = ChunkCache::new(300);
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..4)
                .map(|_| {
                    scope.spawn(|| {
                        cache.get(5, || {
                            std::thread::sleep(std::time::Duration::from_millis(5));
                            Err(Error::format("x", "tile 5", "broken"))
                        })
                    })
                })
                .collect();
            for thread in threads {
                assert!(thread.join().expect("no panic").is_err());
            }
        });
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| cache.get(6, || panic!("on purpose"))));
        assert!(panicked.is_err());
        assert!(cache.get(6, || Ok(chunk(1))).is_ok());
    }
}
