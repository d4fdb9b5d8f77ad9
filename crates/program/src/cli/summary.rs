//! What a surveyor reads at the end of a run: six to eight lines. With `--verbose` everything that was said, one thing
//! a line.

use std::fmt::Write;

use autoref_stream::matching::diagnosis::{Certainty, Diagnosis};
use autoref_stream::pipeline::reasons::{NotFound, Reason};
use autoref_stream::result::{Misfit, RefusedRun, RunOutcome, RunPattern, RunResult, SolvedRun, Twins};

use crate::cli::lengths::length;
use crate::cli::{accuracy, solving};
use autoref_raster::words::counted;

/// How much is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    Brief,
    Full,
}

/// Notes of a brief summary; the others are in the JSON.
const NOTES: usize = 3;
/// Points that are named.
const LOOKED_AT: usize = 3;
/// A fit through fewer points hides a blunder in one of them.
const FEW_POINTS: usize = 5;

pub fn summary(result: &RunResult, detail: Detail) -> String {
    let mut lines = Lines(String::new());
    match &result.outcome {
        RunOutcome::Solved(run) => solved(result, run, detail, &mut lines),
        RunOutcome::Refused(run) => refused(result, run, &mut lines),
    }
    if detail == Detail::Full {
        full(result, &mut lines);
    }
    let shown = if detail == Detail::Full { result.warnings.len() } else { NOTES };
    for note in result.warnings.iter().take(shown) {
        lines.add("Note", note.to_string());
    }
    if result.warnings.len() > shown {
        lines.add(
            "",
            format!(
                "and {}: --verbose, or the JSON",
                counted(result.warnings.len() - shown, "more note", "more notes")
            ),
        );
    }
    if !result.files_written.is_empty() {
        lines.add("Files", result.files_written.join(", "));
    }
    let memory = result
        .peak_memory_bytes
        .map_or(String::new(), |b| format!(", at most {:.0} MiB of memory", b as f64 / 1_048_576.0));
    lines.add("Time", format!("{:.2} s{memory}", result.elapsed_s));
    lines.0
}

struct Lines(String);

impl Lines {
    fn add(&mut self, label: &str, value: String) {
        // A name may hold line ends.
        writeln!(self.0, "{label:<16}{}", crate::printable(&value)).expect("a string takes all writes");
    }
}

/// A direction against east, with the sense in words.
fn turned(degrees: f64) -> String {
    let sense = if degrees <= -5e-5 { "clockwise" } else { "anticlockwise" };
    format!("{:.4}° {sense}", degrees.abs())
}

fn solved(result: &RunResult, run: &SolvedRun, detail: Detail, lines: &mut Lines) {
    let found = run.matches.len() + run.check_points.len();
    let inside = run.gcps_in_image;
    lines.add("Matched", format!("{found} of {inside} points in the image, {} listed", result.gcps_listed));
    let fit = &run.fit;
    lines.add("Scale", format!("{:.6} m per pixel, turned {} from east", fit.scale_m_per_px, turned(fit.rotation_deg)));
    let (all, e, n) = (length(fit.rmse_m), length(fit.rmse_e_m), length(fit.rmse_n_m));
    lines.add("RMSE", format!("{all} = {:.2} px (east {e}, north {n})", fit.rmse_px));
    if let Some(heights) = &run.heights {
        lines.add("Heights", solving::heights_in_brief(heights));
    }
    if let Some(model) = solving::model_line(run) {
        lines.add("Model", model);
    }
    let verdict = Verdict::of(result, run);
    lines.add("Verdict", verdict.sentence);
    // The full summary has lines of its own for both.
    if detail == Detail::Brief {
        verdict.chance.into_iter().for_each(|chance| lines.add("Chance", chance));
        verdict.tested.into_iter().for_each(|tested| lines.add("Check points", tested));
    }
    let look_at = look_at(run, spoken_of(&result.diagnoses));
    if !look_at.is_empty() {
        lines.add("Look at", look_at.join("; "));
    }
}

/// The mistake that the verdict speaks of: the surest.
fn spoken_of(diagnoses: &[Diagnosis]) -> Option<&Diagnosis> {
    let claimed = diagnoses.iter().find(|diagnosis| diagnosis.certainty == Certainty::Claimed);
    claimed.or(diagnoses.first())
}

/// How a verdict speaks of a mistake that chance may explain as well.
const MAY_BE_MISTAKEN: &str = "and a mistake in the list is possible";

/// One plain sentence, and what it leaves unsaid of the chance of a false alarm and of the check points.
struct Verdict {
    sentence: String,
    chance: Option<String>,
    tested: Option<String>,
}

/// What the verdict says against a result that was solved, for who writes outputs from it later.
pub fn reservation(result: &RunResult) -> Option<String> {
    Verdict::against(result, result.solved()?).map(|verdict| verdict.sentence)
}

impl Verdict {
    fn of(result: &RunResult, run: &SolvedRun) -> Verdict {
        Verdict::against(result, run).unwrap_or_else(|| Verdict::for_it(result, run))
    }

    /// What speaks against the result; `None` where nothing does.
    fn against(result: &RunResult, run: &SolvedRun) -> Option<Verdict> {
        let chance = chance(result);
        let tested = tested(run);
        let misfit = Misfit::of(result);
        let twins = Twins::of(result).map(|twins| twins.clause(run.fit.scale_m_per_px));
        let outlier = run.matches.iter().chain(&run.check_points).any(|m| m.outlier);
        // The surest mistake speaks; it does not hide that points do not fit.
        if let Some(diagnosis) = spoken_of(&result.diagnoses) {
            let certainty = match diagnosis.certainty {
                Certainty::Claimed => "but a mistake in the list is likely",
                Certainty::Possible => MAY_BE_MISTAKEN,
            };
            let mut sentence = format!("solved, {certainty}: {}", diagnosis.message);
            if outlier {
                sentence += "; a point does not fit, too: look at it before you trust the rest";
            }
            if let Some(misfit) = misfit {
                sentence += &format!("; {}", misfit.clause());
            }
            sentence.extend(twins.map(|twins| format!("; {twins}")));
            return Some(Verdict { sentence, chance, tested });
        }
        if outlier {
            let and_chance = and_chance(chance.as_deref());
            let mut sentence =
                format!("solved, but a point does not fit: look at it before you trust the rest{and_chance}");
            sentence.extend(misfit.map(|misfit| format!("; {}", misfit.clause())));
            sentence.extend(twins.map(|twins| format!("; {twins}")));
            return Some(Verdict { sentence, chance: None, tested });
        }
        if let Some(misfit) = misfit {
            let sentence = twins.map_or(misfit.verdict(), |twins| format!("{}; {twins}", misfit.verdict()));
            return Some(Verdict { sentence, chance, tested });
        }
        twins.map(|twins| Verdict { sentence: format!("solved, but {twins}"), chance, tested })
    }

    /// Of a result that nothing speaks against: what tests it.
    fn for_it(result: &RunResult, run: &SolvedRun) -> Verdict {
        let and_chance = and_chance(chance(result).as_deref());
        let horizontal = run.accuracy.as_ref().and_then(|a| a.figures.horizontal.as_ref());
        let sentence = if let Some(h) = horizontal {
            let rmse = length(h.rmse_h1_m);
            format!(
                "solved, and {} within {rmse} (RMSE){and_chance}",
                counted(h.check_points, "check point agrees", "check points agree")
            )
        } else if run.matches.len() < FEW_POINTS {
            let points = run.matches.len();
            let shows =
                if points < 3 { "nothing would show a blunder in one" } else { "a blunder in one would hardly show" };
            format!("solved from {points} points only: {shows}{and_chance}")
        } else {
            format!("solved; the points agree with each other, no check point tests them{and_chance}")
        };
        // The sentence has the RMSE already.
        let tested = tested(run).filter(|_| run.accuracy.as_ref().is_some_and(|a| a.figures.nssda.is_some()));
        Verdict { sentence, chance: None, tested }
    }
}

/// How often chance makes such a pattern; of a review's, how often it makes the run's.
fn chance(result: &RunResult) -> Option<String> {
    let log10 = result.log10_false_alarms?;
    let images = format!("in one of 10^{:.0} images", (-log10).max(0.0).floor());
    Some(match result.run_pattern {
        Some(RunPattern { believed: false, .. }) => format!(
            "alone makes {} patterns like the run's, which was refused for it: these marks stand by the review alone",
            expected(log10)
        ),
        Some(RunPattern { points, kept, .. }) if kept < points => {
            format!("made the run's pattern {images}, and of its {points} points the review kept {kept}")
        }
        _ => format!("makes such a pattern {images}"),
    })
}

/// A number of false alarms.
fn expected(log10: f64) -> String {
    if log10 > -3.0 && log10 < 6.0 { format!("{:.3}", 10f64.powf(log10)) } else { format!("10^{log10:.1}") }
}

/// The same as the end of a sentence.
fn and_chance(chance: Option<&str>) -> String {
    chance.map_or(String::new(), |text| format!("; chance {text}"))
}

/// What check points say, with the figures that were asked for.
fn tested(run: &SolvedRun) -> Option<String> {
    let figures = &run.accuracy.as_ref()?.figures;
    let horizontal = figures.horizontal.as_ref()?;
    let nssda = figures
        .nssda
        .as_ref()
        .map_or(String::new(), |nssda| format!("; NSSDA {} at 95 %", length(nssda.horizontal_95_m)));
    let points = horizontal.check_points;
    Some(format!("{points} kept out of the fit, RMSE {}{nssda}", length(horizontal.rmse_h1_m)))
}

/// Points that a person should see, and why.
fn look_at(run: &SolvedRun, verdict: Option<&Diagnosis>) -> Vec<String> {
    // What the verdict says of a point is not said twice.
    let is_left = |gcp: &str| verdict.is_none_or(|diagnosis| diagnosis.gcps.iter().all(|named| named != gcp));
    let all = run.matches.iter().chain(&run.check_points).filter(|m| is_left(&m.gcp));
    let unfit = all.filter(|m| m.outlier).map(|m| format!("{} is {:.1} px off", m.gcp, m.residual_px));
    // A mark that is there, elsewhere, is worth more of a look than one that is not.
    let not_found = || run.not_found.iter().filter(|point| is_left(&point.name));
    let displaced = not_found().filter(|point| point.reason == Reason::Displaced);
    // Somebody has looked at what a review settled.
    let is_other = |reason: Reason| !matches!(reason, Reason::Outside | Reason::Displaced | Reason::Reviewed);
    let others = not_found().filter(|point| is_other(point.reason));
    let missing = displaced.chain(others).map(NotFound::line);
    let mut all: Vec<String> = unfit.chain(missing).collect();
    let more = all.len().saturating_sub(LOOKED_AT);
    if more > 0 {
        all.truncate(LOOKED_AT);
        all.push(format!("and {more} more (report, JSON)"));
    }
    all
}

fn refused(result: &RunResult, run: &RefusedRun, lines: &mut Lines) {
    lines.add("Not solved", run.reason.clone());
    for advice in &result.advice {
        lines.add("  may help", advice.clone());
    }
    let seen = counted(result.candidates_found, "candidate", "candidates");
    lines.add("Seen", format!("{seen}, {} listed", counted(result.gcps_listed, "point", "points")));
}

fn full(result: &RunResult, lines: &mut Lines) {
    let mut line = |label: &str, value: String| lines.add(label, value);
    line("Marks found", counted(result.candidates_found, "candidate", "candidates"));
    if let Some(second) = &result.second_pass {
        line("Second pass", second.line());
    }
    if let Some(run) = result.solved() {
        solving::lines(run, &mut line);
        accuracy::lines(run, &mut line);
        let said = spoken_of(&result.diagnoses).map(|diagnosis| &diagnosis.message);
        for message in
            result.diagnoses.iter().map(|diagnosis| &diagnosis.message).filter(|message| Some(*message) != said)
        {
            line("Mistake?", message.clone());
        }
    }
    if let Some(log10) = result.log10_false_alarms {
        let of_run = result.run_pattern.map_or(String::new(), |pattern| {
            format!(
                ", by the run's {}, of which the review kept {}",
                counted(pattern.points, "point", "points"),
                pattern.kept
            )
        });
        line("False alarms", format!("{} such patterns expected by chance{of_run}", expected(log10)));
    }
    if let Some(names) = result.solved().and_then(|run| run.names.as_ref()) {
        let against =
            if names.contradict > 0 { format!(", {} of another's place", names.contradict) } else { String::new() };
        line("Names on targets", format!("{} of {} agree{against}", names.agree, names.named));
    }
}
