//! Where the time of a command went: the spans of its stages, added up. `--profile-json FILE` writes them, `--verbose`
//! prints them.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::bail;
use autoref_raster::{atomic, bounded, memory_plan};
use serde_json::json;
use tracing::span::{Attributes, Id};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

/// What `schema` says in every profile.
const SCHEMA: &str = "autoref-stream-profile";
const SCHEMA_VERSION: u32 = 1;

/// All spans of one name under one parent.
#[derive(Clone, Copy, Debug, Default)]
struct Total {
    count: u64,
    /// From the first moment of each span to its last.
    open: Duration,
    /// While a thread was in it; of several threads the sum.
    busy: Duration,
}

/// In the order in which the first of each began, which is that of the stages: few, so that they are looked through.
type Totals = Arc<Mutex<Vec<(Vec<&'static str>, Total)>>>;

/// Adds up the spans of a run.
#[derive(Clone, Debug)]
pub struct StageTimes {
    totals: Totals,
    started: Instant,
}

/// What is kept with a span.
struct Clock {
    path: Vec<&'static str>,
    made: Instant,
    entered: Option<Instant>,
    busy: Duration,
}

impl StageTimes {
    pub fn new() -> Self {
        StageTimes { totals: Totals::default(), started: Instant::now() }
    }

    /// One line a span, indented under its parent: seconds on the clock, seconds of all threads in it, how often.
    pub fn lines(&self) -> Vec<String> {
        let totals = self.totals.lock().unwrap_or_else(PoisonError::into_inner);
        let line = |(path, total): &(Vec<&'static str>, Total)| {
            let name = format!("{}{}", "  ".repeat(path.len() - 1), path.last().copied().unwrap_or_default());
            let (open, busy) = (total.open.as_secs_f64(), total.busy.as_secs_f64());
            let often = if total.count == 1 { "once".into() } else { format!("{} times", total.count) };
            format!("{name:<28} {open:>9.3} s on the clock, {busy:>9.3} s in threads, {often}")
        };
        totals.iter().map(line).collect()
    }

    /// Writes the profile.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let totals = self.totals.lock().unwrap_or_else(PoisonError::into_inner);
        let spans: Vec<_> = totals
            .iter()
            .map(|(path, total)| {
                json!({"path": path.join("/"), "count": total.count, "open_s": total.open.as_secs_f64(),
                    "busy_s": total.busy.as_secs_f64()})
            })
            .collect();
        let document = json!({
            "schema": SCHEMA, "schema_version": SCHEMA_VERSION,
            "program": format!("autoref-stream {}", env!("CARGO_PKG_VERSION")),
            "elapsed_s": self.started.elapsed().as_secs_f64(),
            "peak_memory_bytes": memory_plan::peak_resident_bytes(),
            "spans": spans,
        });
        let mut text = serde_json::to_string_pretty(&document)?;
        text.push('\n');
        Ok(atomic::write(path, text.as_bytes())?)
    }
}

/// Refuses a path that cannot take a profile, before any work is done. An older profile is replaced.
///
/// # Errors
/// When something else is there, or the folder is not.
pub fn check(path: &Path) -> anyhow::Result<()> {
    let older = || {
        let text = bounded::read_to_string(path, "a profile of stages", bounded::TEXT_BYTES).unwrap_or_default();
        serde_json::from_str::<serde_json::Value>(&text).is_ok_and(|document| document["schema"] == SCHEMA)
    };
    if path.is_file() && !older() {
        bail!("--profile-json {} exists and is no profile; name another file", path.display());
    }
    Ok(atomic::check_outputs(&[path], atomic::Existing::Replace)?)
}

impl<S: tracing::Subscriber + for<'a> LookupSpan<'a>> Layer<S> for StageTimes {
    fn on_new_span(&self, _attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        let Some(span) = context.span(id) else { return };
        let path: Vec<_> = span.scope().from_root().map(|span| span.name()).collect();
        let mut totals = self.totals.lock().unwrap_or_else(PoisonError::into_inner);
        if !totals.iter().any(|(known, _)| *known == path) {
            totals.push((path.clone(), Total::default()));
        }
        drop(totals);
        span.extensions_mut().insert(Clock { path, made: Instant::now(), entered: None, busy: Duration::ZERO });
    }

    fn on_enter(&self, id: &Id, context: Context<'_, S>) {
        if let Some(span) = context.span(id)
            && let Some(clock) = span.extensions_mut().get_mut::<Clock>()
        {
            clock.entered = Some(Instant::now());
        }
    }

    fn on_exit(&self, id: &Id, context: Context<'_, S>) {
        if let Some(span) = context.span(id)
            && let Some(clock) = span.extensions_mut().get_mut::<Clock>()
        {
            clock.busy += clock.entered.take().map_or(Duration::ZERO, |entered| entered.elapsed());
        }
    }

    fn on_close(&self, id: Id, context: Context<'_, S>) {
        let Some(span) = context.span(&id) else { return };
        let Some(clock) = span.extensions_mut().remove::<Clock>() else { return };
        let mut totals = self.totals.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((_, total)) = totals.iter_mut().find(|(path, _)| *path == clock.path) else { return };
        total.count += 1;
        total.open += clock.made.elapsed();
        total.busy += clock.busy;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing_subscriber::layer::SubscriberExt;

    #[test]
    fn spans_are_added_up_under_their_parents_whatever_thread_they_ran_in() {
        let times = StageTimes::new();
        let subscriber = tracing_subscriber::registry().with(times.clone());
        tracing::subscriber::with_default(subscriber, || {
            let dispatch = tracing::dispatcher::get_default(Clone::clone);
            let scan = tracing::info_span!("scan").entered();
            let parent = tracing::Span::current();
            std::thread::scope(|scope| {
                for _ in 0..3 {
                    let (parent, dispatch) = (parent.clone(), dispatch.clone());
                    scope.spawn(move || {
                        tracing::dispatcher::with_default(&dispatch, || {
                            let _tile = tracing::info_span!(parent: &parent, "read").entered();
                        });
                    });
                }
            });
            drop((parent, scan));
        });
        let totals = times.totals.lock().expect("no thread panicked");
        let counts: Vec<_> = totals.iter().map(|(path, total)| (path.join("/"), total.count)).collect();
        assert_eq!(counts, [("scan".to_string(), 1), ("scan/read".to_string(), 3)]);
        let (scan, read) = (totals[0].1, totals[1].1);
        assert!(scan.busy <= scan.open && read.busy <= read.open);
    }
}
