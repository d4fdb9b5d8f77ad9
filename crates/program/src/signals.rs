//! Ctrl-C, and a request to end: no part of an output stays behind.

use autoref_raster::atomic;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;

/// From now on an interrupted run removes what it was making, and ends as the signal ends any program.
pub fn heed() {
    // What was started to be left alone, as a shell does with commands in the background, stays so.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let heeded = [SIGINT, SIGTERM].into_iter().filter(|signal| !is_ignored(&status, *signal));
    // Without a handler a run ends as it always did, and the next one clears up.
    let Ok(mut signals) = Signals::new(heeded) else { return };
    std::thread::spawn(move || {
        for signal in signals.forever() {
            atomic::abandon();
            let _ = emulate_default_handler(signal);
        }
    });
}

/// Whether the system's own words about a process count a signal among those it ignores.
fn is_ignored(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ignored_signals_are_read() {
        let status = "Name:\tx\nSigIgn:\t0000000000000002\nSigCgt:\t0000000000004000\n";
        assert!(is_ignored(status, SIGINT) && !is_ignored(status, SIGTERM) && !is_ignored("", SIGINT));
    }
}
