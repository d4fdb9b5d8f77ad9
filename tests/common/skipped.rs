//! Tests that cannot run say so, and `make test` counts them at its end: a green run must not hide what it left out.

use std::io::Write;

/// Says why a test, or a part of it, is skipped. With `AUTOREF_SKIPPED=FILE` a line is added to that file: test and
/// reason.
pub fn skipped(why: impl std::fmt::Display) {
    eprintln!("skipped: {why}");
    let Some(file) = std::env::var_os("AUTOREF_SKIPPED") else { return };
    let thread = std::thread::current();
    // nextest runs a test on its process's main thread.
    let named = std::env::var("NEXTEST_TEST_NAME").ok().or_else(|| thread.name().map(str::to_owned));
    let line = format!("{}\t{why}\n", named.as_deref().unwrap_or("a test"));
    let file = std::fs::OpenOptions::new().create(true).append(true).open(file);
    // One write a line: tests run beside each other.
    file.and_then(|mut file| file.write_all(line.as_bytes())).expect("the list of skipped tests can be written");
}
