//! Standard output and standard error, which may be closed or full: a reader that has seen enough ends nothing, a full
//! device is an error in the end, and neither is a panic. The macros stand before those of the standard library.

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use autoref_raster::atomic::Existing;

/// Words for people are left out, by stream.
static MUTE: [AtomicBool; 2] = [AtomicBool::new(false), AtomicBool::new(false)];

/// Which stream says nothing more of its own accord.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    Output,
    Errors,
}

/// Leaves out what the macros print there; [`product`] and [`error_line`] are not left out.
pub fn mute(stream: Stream) {
    MUTE[stream as usize].store(true, Ordering::Relaxed);
}

/// Whether a stream says nothing of its own accord.
pub fn is_mute(stream: Stream) -> bool {
    MUTE[stream as usize].load(Ordering::Relaxed)
}

/// What the command was asked for, whatever else is left out.
pub fn product(text: &str) {
    keep(std::io::stdout().write_all(text.as_bytes()));
}

/// Why the command failed.
pub fn error_line(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Why standard output could not be written, when that is a fault.
static FAULT: Mutex<Option<String>> = Mutex::new(None);

/// Writes to standard output; see [`fault`].
pub fn write(text: std::fmt::Arguments<'_>) {
    if is_mute(Stream::Output) {
        return;
    }
    let text = text.to_string();
    // A document has its own way to write such letters.
    let words = if text.starts_with(['{', '[']) { text } else { shown(&text) };
    keep(std::io::stdout().write_all(words.as_bytes()));
}

/// Writes to standard error; when that is gone there is nobody to tell.
pub fn write_err(text: std::fmt::Arguments<'_>) {
    if is_mute(Stream::Errors) {
        return;
    }
    let _ = std::io::stderr().write_all(shown(&text.to_string()).as_bytes());
}

/// Whether a terminal would obey a letter of a file instead of showing it: controls, ends of lines that are none of
/// ours, turns of the direction of reading.
pub fn is_obeyed(letter: char) -> bool {
    let is_ours = matches!(letter, '\n' | '\r' | '\t');
    let turns = matches!(letter, '\u{2028}' | '\u{2029}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || (letter.is_control() && !is_ours)
}

/// Words for people, which may hold names out of files.
fn shown(words: &str) -> String {
    words.chars().map(|letter| if is_obeyed(letter) { char::REPLACEMENT_CHARACTER } else { letter }).collect()
}

/// Keeps a fault of standard output for the end.
pub fn keep(result: std::io::Result<()>) {
    if let Err(error) = result
        && error.kind() != ErrorKind::BrokenPipe
    {
        FAULT.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error.to_string());
    }
}

/// Brings out what is left and says whether anything was lost.
pub fn fault() -> Option<String> {
    keep(std::io::stdout().flush());
    FAULT.lock().unwrap_or_else(PoisonError::into_inner).take()
}

/// Writes text to a file, whole or not at all, or to standard output for "-".
pub fn write_text(path: &Path, text: &[u8], existing: Existing) -> anyhow::Result<()> {
    if path.as_os_str() == "-" {
        keep(std::io::stdout().write_all(text));
        return Ok(());
    }
    autoref_raster::atomic::check_outputs(&[path], existing)?;
    Ok(autoref_raster::atomic::write(path, text)?)
}

macro_rules! println {
    () => { $crate::out::write(format_args!("\n")) };
    ($($words:tt)*) => { $crate::out::write(format_args!("{}\n", format_args!($($words)*))) };
}
macro_rules! print {
    ($($words:tt)*) => { $crate::out::write(format_args!($($words)*)) };
}
macro_rules! eprintln {
    () => { $crate::out::write_err(format_args!("\n")) };
    ($($words:tt)*) => { $crate::out::write_err(format_args!("{}\n", format_args!($($words)*))) };
}
macro_rules! eprint {
    ($($words:tt)*) => { $crate::out::write_err(format_args!($($words)*)) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_that_terminals_obey_are_not_shown() {
        assert_eq!(shown("a\u{1b}[31m\u{9b}b\u{202e}c\u{2028}\n\té"), "a\u{fffd}[31m\u{fffd}b\u{fffd}c\u{fffd}\n\té");
    }
}
