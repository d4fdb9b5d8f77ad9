//! Windows of the file as memory, and what the system is told about its pages.
#![allow(unsafe_code)]

use std::fs::File;
use std::io;
use std::sync::Arc;

use memmap2::{Mmap, MmapOptions};

/// Maps `length` bytes at `start`, which must lie in the file. The pages go when the last user drops the map.
///
/// # Errors
/// When the system refuses.
pub fn map(file: &File, start: u64, length: u64) -> io::Result<Arc<Mmap>> {
    // SAFETY: a map is only undefined when the file changes beneath it. The samples are plain bytes, of which any value
    // is valid, and nothing is concluded from reading one twice; a file that another program cuts off meanwhile ends
    // this one with a signal, which docs/decisions/native-tiff.md says, and is why reading into buffers is the default.
    let map = unsafe { MmapOptions::new().offset(start).len(length as usize).map(file)? };
    Ok(Arc::new(map))
}

/// Passes advice about a part of the file on; that is help, not duty, so a refusal is no error.
pub fn advise(file: &File, (offset, length): (u64, u64), advice: rustix::fs::Advice) {
    if let Some(length) = std::num::NonZeroU64::new(length) {
        let _ = rustix::fs::fadvise(file, offset, Some(length), advice);
    }
}

/// Asks the system to read a part of the file ahead, unless it is there already: then the mere asking would cost the
/// time of a look at every page.
pub fn read_ahead(file: &File, (offset, length): (u64, u64)) {
    let present = |at: u64| {
        let mut byte = [0u8];
        let mut buffers = [io::IoSliceMut::new(&mut byte)];
        rustix::io::preadv2(file, &mut buffers, at, rustix::io::ReadWriteFlags::NOWAIT).is_ok()
    };
    if length > 0 && !(present(offset) && present(offset + length / 2) && present(offset + length - 1)) {
        advise(file, (offset, length), rustix::fs::Advice::WillNeed);
    }
}

/// Physical memory of the machine; without an answer the most there can be.
pub fn memory_bytes() -> u64 {
    let kib = || {
        let text = std::fs::read_to_string("/proc/meminfo").ok()?;
        let line = text.lines().find(|line| line.starts_with("MemTotal:"))?;
        line.split_whitespace().nth(1)?.parse::<u64>().ok()
    };
    kib().map_or(u64::MAX, |kib| kib << 10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_map_begins_where_it_was_asked_to() {
        let mut file = tempfile::tempfile().expect("a temporary file");
        let bytes: Vec<u8> = (0..20_000u32).map(|i| (i % 251) as u8).collect();
        file.write_all(&bytes).expect("space for 20 kB");
        let map = map(&file, 5001, 9000).expect("mappable");
        assert_eq!(map[..], bytes[5001..14_001]);
    }
}
