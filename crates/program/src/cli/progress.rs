//! What goes on, on standard error: a bar that moves on a terminal, a line every ten seconds elsewhere.

use std::io::IsTerminal;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::out::{Stream, is_mute};
use autoref_raster::RasterInfo;
use autoref_stream::pipeline::Progress;

/// Between two lines where no bar can move.
const EVERY: Duration = Duration::from_secs(10);

/// Progress while the image is read: MB/s, share done, time left; then what is done with it.
pub struct Bar {
    shown: Shown,
    bytes_per_pixel: u64,
}

enum Shown {
    Nothing,
    Moving(indicatif::ProgressBar),
    Lines(Lines),
}

/// Whether progress is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Telling {
    Told,
    Silent,
}

impl Telling {
    /// Nothing is told with --quiet, and beside the document of --json.
    pub fn silent_if(quiet_or_json: bool) -> Self {
        if quiet_or_json { Telling::Silent } else { Telling::Told }
    }
}

impl Bar {
    pub fn new(info: &RasterInfo, telling: Telling) -> Self {
        let bytes_per_pixel = (info.bands * info.sample.bytes()) as u64;
        let bytes = info.pixels() * bytes_per_pixel;
        let shown = match (telling, std::io::stderr().is_terminal()) {
            (Telling::Silent, _) => Shown::Nothing,
            (Telling::Told, true) => {
                let bar = indicatif::ProgressBar::new(bytes);
                bar.set_style(Bar::reading());
                bar.set_message("reading");
                Shown::Moving(bar)
            }
            (Telling::Told, false) => Shown::Lines(Lines::new("reading", bytes)),
        };
        Bar { shown, bytes_per_pixel }
    }

    fn reading() -> indicatif::ProgressStyle {
        indicatif::ProgressStyle::with_template(
            "{msg} {bar:30} {percent:>3} % {decimal_bytes_per_sec:>12} {eta:>4} left",
        )
        .expect("the template is well formed")
    }

    pub fn finish(&self) {
        match &self.shown {
            Shown::Nothing => {}
            Shown::Moving(bar) => bar.finish_and_clear(),
            Shown::Lines(lines) => lines.end(),
        }
    }

    /// What goes on now: a line that moves, in place of the bar.
    pub fn stage(&self, what: &str) {
        tracing::info!("{what}");
        match &self.shown {
            Shown::Nothing => {}
            Shown::Moving(bar) => {
                let style = indicatif::ProgressStyle::with_template("{spinner} {msg} {elapsed:>4}")
                    .expect("the template is well formed");
                bar.set_style(style);
                bar.set_message(what.to_string());
                bar.enable_steady_tick(Duration::from_millis(120));
            }
            Shown::Lines(lines) => lines.now(what, None),
        }
    }
}

impl Progress for Bar {
    fn scanned(&self, pixels: u64) {
        match &self.shown {
            Shown::Nothing => {}
            Shown::Moving(bar) => bar.inc(pixels * self.bytes_per_pixel),
            Shown::Lines(lines) => lines.more(pixels * self.bytes_per_pixel),
        }
    }

    fn pass(&self, what: &str) {
        tracing::info!("{what}");
        match &self.shown {
            Shown::Nothing => {}
            Shown::Moving(bar) => {
                bar.disable_steady_tick();
                bar.reset();
                bar.set_style(Bar::reading());
                bar.set_message(what.to_string());
            }
            Shown::Lines(lines) => lines.now(what, Some(0)),
        }
    }

    fn stage(&self, what: &str) {
        Bar::stage(self, what);
    }
}

/// A thread that says every ten seconds what goes on.
struct Lines(Arc<(Mutex<Now>, Condvar)>);

struct Now {
    what: String,
    since: Instant,
    /// Bytes read, while the image is read.
    done: Option<u64>,
    of: u64,
    over: bool,
}

impl Lines {
    fn new(what: &str, of: u64) -> Self {
        let now = Now { what: what.into(), since: Instant::now(), done: Some(0), of, over: false };
        let shared = Arc::new((Mutex::new(now), Condvar::new()));
        let told = Arc::clone(&shared);
        std::thread::spawn(move || {
            let (now, changed) = &*told;
            let mut now = now.lock().unwrap_or_else(PoisonError::into_inner);
            loop {
                let next = Instant::now() + EVERY;
                // Woken at the end only.
                while !now.over && Instant::now() < next {
                    let wait = next.saturating_duration_since(Instant::now());
                    now = changed.wait_timeout(now, wait).unwrap_or_else(PoisonError::into_inner).0;
                }
                if now.over {
                    return;
                }
                eprintln!("{}", now.line());
            }
        });
        Lines(shared)
    }

    fn change(&self, change: impl FnOnce(&mut Now)) {
        change(&mut self.0.0.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn more(&self, bytes: u64) {
        self.change(|now| now.done = now.done.map(|done| done + bytes));
    }

    fn now(&self, what: &str, done: Option<u64>) {
        self.change(|now| (now.what, now.done, now.since) = (what.to_owned(), done, Instant::now()));
    }

    fn end(&self) {
        self.change(|now| now.over = true);
        self.0.1.notify_all();
    }
}

impl Drop for Lines {
    fn drop(&mut self) {
        self.end();
    }
}

impl Now {
    fn line(&self) -> String {
        self.line_after(self.since.elapsed())
    }

    fn line_after(&self, spent: Duration) -> String {
        let seconds = spent.as_secs();
        let Some(done) = self.done else { return format!("{}: {seconds} s", self.what) };
        let share = done as f64 / self.of.max(1) as f64;
        let left = match share {
            share if share > 0.0 && share < 1.0 => {
                format!(", about {:.0} s left", spent.as_secs_f64() * (1.0 - share) / share)
            }
            _ => String::new(),
        };
        format!("{}: {:.0} %, {seconds} s{left}", self.what, 100.0 * share)
    }
}

/// A count of like pieces of work, with the time that is left: a bar on a terminal, a line every ten seconds elsewhere.
pub struct Steps(Shown);

impl Steps {
    /// `of`: 0 where it is not known how many there are.
    pub fn new(what: &str, of: u64) -> Self {
        if is_mute(Stream::Errors) {
            return Steps(Shown::Nothing);
        }
        if !std::io::stderr().is_terminal() {
            let lines = Lines::new(what, of);
            if of == 0 {
                lines.now(what, None);
            }
            return Steps(Shown::Lines(lines));
        }
        let bar = indicatif::ProgressBar::new(of);
        let template = match of {
            0 => "{spinner} {msg} {elapsed:>4}",
            _ => Steps::COUNTED,
        };
        let style = indicatif::ProgressStyle::with_template(template).expect("the template is well formed");
        bar.set_style(style);
        bar.set_message(what.to_string());
        bar.enable_steady_tick(Duration::from_millis(120));
        Steps(Shown::Moving(bar))
    }

    const COUNTED: &str = "{msg} {bar:30} {pos}/{len} {elapsed:>4}, {eta} left";

    /// So many are done, of so many.
    pub fn at(&self, done: u64, of: u64) {
        match &self.0 {
            Shown::Nothing => {}
            Shown::Moving(bar) => {
                if bar.length() != Some(of) {
                    let style = indicatif::ProgressStyle::with_template(Steps::COUNTED);
                    bar.set_style(style.expect("the template is well formed"));
                    bar.set_length(of);
                }
                bar.set_position(done);
            }
            // All counted is not all done: programs go on in silence, or begin to count something else.
            Shown::Lines(lines) => lines.change(|now| (now.done, now.of) = ((done < of).then_some(done), of)),
        }
    }
}

impl Drop for Steps {
    fn drop(&mut self) {
        if let Shown::Moving(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

/// A line that moves while something without a measure of its progress goes on; gone when it is dropped. Silent unless
/// stderr is a terminal.
pub struct Busy(indicatif::ProgressBar);

impl Busy {
    pub fn new(what: &str, telling: Telling) -> Self {
        let bar = indicatif::ProgressBar::new_spinner();
        if telling == Telling::Silent || !std::io::stderr().is_terminal() {
            bar.set_draw_target(indicatif::ProgressDrawTarget::hidden());
        }
        let style = indicatif::ProgressStyle::with_template("{spinner} {msg} {elapsed:>4}");
        bar.set_style(style.expect("the template is well formed"));
        bar.set_message(what.to_string());
        bar.enable_steady_tick(Duration::from_millis(120));
        Busy(bar)
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_how_far_and_how_long() {
        let mut now = Now { what: "reading".into(), since: Instant::now(), done: Some(30), of: 120, over: false };
        assert_eq!(now.line_after(Duration::from_secs(20)), "reading: 25 %, 20 s, about 60 s left");
        now.done = Some(0);
        assert_eq!(now.line_after(Duration::from_secs(20)), "reading: 0 %, 20 s");
        now.done = None;
        assert_eq!(now.line(), "reading: 0 s");
    }

    #[test]
    fn what_is_counted_whole_is_not_called_done() {
        let lines = Lines::new("colmap", 14);
        let steps = Steps(Shown::Lines(lines));
        let said = |done: u64| {
            steps.at(done, 14);
            let Shown::Lines(lines) = &steps.0 else { unreachable!("made so above") };
            lines.0.0.lock().expect("nobody panicked").line_after(Duration::from_secs(50))
        };
        assert_eq!(said(14), "colmap: 50 s");
        assert_eq!(said(13), "colmap: 93 %, 50 s, about 4 s left");
    }
}
