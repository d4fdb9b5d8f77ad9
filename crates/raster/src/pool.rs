//! Buffers that are used again: a decoded block costs no allocation once the first ones have come back.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Idle buffers. The one that came last goes first: its bytes are still in the processor's cache.
#[derive(Clone, Debug)]
pub struct Shelf {
    idle: Arc<Mutex<Vec<Vec<u8>>>>,
    most: usize,
}

impl Shelf {
    fn idle(&self) -> MutexGuard<'_, Vec<Vec<u8>>> {
        // Nothing can go wrong halfway while it is held.
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A full shelf just lets the buffer go.
    fn put(&self, buffer: Vec<u8>) {
        let mut idle = self.idle();
        if idle.len() < self.most {
            idle.push(buffer);
        }
    }
}

/// A decoded buffer that goes back to its pool when the last user drops it.
#[derive(Debug, Default)]
pub struct PooledBytes {
    pub bytes: Vec<u8>,
    pub home: Option<Shelf>,
}

impl Drop for PooledBytes {
    fn drop(&mut self) {
        if let Some(home) = self.home.take() {
            home.put(std::mem::take(&mut self.bytes));
        }
    }
}

/// A bounded store of idle byte buffers, shared by all threads.
///
/// All buffers have room for the same number of bytes, so that there are never more of them than were in use at once.
#[derive(Clone, Debug)]
pub struct BufferPool {
    buffer_bytes: usize,
    shelf: Shelf,
}

impl BufferPool {
    /// Keeps at most `idle` buffers of `buffer_bytes`; more are let go.
    pub fn new(idle: usize, buffer_bytes: usize) -> Self {
        BufferPool { buffer_bytes, shelf: Shelf { idle: Arc::default(), most: idle } }
    }

    /// For decoded chunks of `chunk_bytes`: as many as may be in use at once in any sensible plan.
    pub(super) fn for_chunks(chunk_bytes: u64) -> Self {
        Self::new(((1 << 30) / chunk_bytes.max(1)).clamp(4, 8192) as usize, chunk_bytes as usize)
    }

    /// What each of its buffers has room for.
    pub fn buffer_bytes(&self) -> usize {
        self.buffer_bytes
    }

    /// A buffer of `len` bytes with any content.
    pub fn take(&self, len: usize) -> Vec<u8> {
        let idle = self.shelf.idle().pop();
        match idle {
            Some(mut buffer) if buffer.capacity() >= len => {
                buffer.resize(len, 0);
                buffer
            }
            _ => {
                // Zeroed memory comes from the system untouched: nothing is written here.
                let mut buffer = vec![0; len.max(self.buffer_bytes)];
                buffer.truncate(len);
                buffer
            }
        }
    }

    /// Gives a buffer back at once.
    pub fn put(&self, buffer: Vec<u8>) {
        self.shelf.put(buffer);
    }

    /// Shares a filled buffer; it comes back when the last user drops it.
    pub fn share(&self, bytes: Vec<u8>) -> Arc<PooledBytes> {
        Arc::new(PooledBytes { bytes, home: Some(self.shelf.clone()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_buffer_is_taken_again() {
        let pool = BufferPool::new(2, 100);
        let shared = pool.share(pool.take(40));
        let place = shared.bytes.as_ptr();
        drop(shared);
        let again = pool.take(60);
        assert_eq!(again.as_ptr(), place);
        assert_eq!(again.len(), 60);
    }

    #[test]
    fn a_full_pool_lets_buffers_go() {
        let pool = BufferPool::new(1, 8);
        pool.put(vec![1; 8]);
        pool.put(vec![2; 8]);
        assert_eq!(pool.take(8), vec![1; 8]);
        assert_eq!(pool.take(8), vec![0; 8]);
    }
}
