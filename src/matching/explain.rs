//! Why nothing is believed, in plain words.

use crate::matching::{Effort, Evidence, Pattern, Priors};
use autoref_raster::words::counted;

/// Plain words on why nothing is believed.
pub(super) fn explain(
    candidates: usize,
    control: &[usize],
    best: Option<Pattern>,
    runner_up: Option<Pattern>,
    (effort, limit): (Effort, f64),
    priors: &Priors,
) -> Evidence {
    let mut advice = Vec::new();
    let open = open_questions(priors);
    let reason = if candidates < 3 {
        advice.push(
            "check that the profile fits the paint: try another --profile, or learn one with `sample`".to_string(),
        );
        format!("{} found; a pattern needs at least 3", counted(candidates, "candidate", "candidates"))
    } else if control.len() < 3 {
        advice.push("give at least 3 control points; 4 or 5 visible ones are needed to be sure".to_string());
        format!("{} in the list; a pattern needs at least 3", counted(control.len(), "control point", "control points"))
    } else if let Some(best) = &best {
        let beaten = best.log10_false_alarms <= limit;
        if beaten {
            let mut help = open.clone();
            help.push("only the points that can be in the image (--names), each of them once");
            advice.push(format!("the list or the image shows a figure that repeats: give {}", help.join(", or ")));
        }
        let allowed = match beaten {
            true => String::new(),
            false => format!(", where at most {} may be (--max-false-alarms)", scientific(limit)),
        };
        let rival = runner_up.as_ref().filter(|_| beaten).map_or(String::new(), |other| {
            format!(
                ", but another one is almost as good ({} GCPs, {})",
                other.pairs.len(),
                scientific(other.log10_false_alarms)
            )
        });
        format!(
            "the best pattern joins {} of {} GCPs in the image, and chance alone would produce {} such patterns{allowed}\
             {rival}",
            best.pairs.len(),
            best.gcps_in_image,
            scientific(best.log10_false_alarms),
        )
    } else if control.len() == 3 {
        let mut help = open.clone();
        help.push("a fourth point");
        advice.push(format!("give {}", help.join(", or ")));
        format!("three points cannot prove a pattern among {candidates} candidates without other knowledge")
    } else {
        format!(
            "no three of {candidates} candidates lie like GCPs of the list in a way that chance would not produce as well"
        )
    };
    if advice.is_empty() {
        advice
            .push("more marks in the image, or fewer false candidates (a stricter --profile, --mark-size)".to_string());
        if !open.is_empty() {
            advice.push(format!("if they are known: {}", open.join(" and ")));
        }
    }
    Evidence { reason, advice, best, runner_up, effort, diagnoses: Vec::new() }
}

/// What the search has not been told and would be helped by.
fn open_questions(priors: &Priors) -> Vec<&'static str> {
    /// A scale known less well was guessed.
    const KNOWN: f64 = 2.0;
    let scale = priors.gsd_m_per_px.is_none_or(|(least, most)| most > KNOWN * least);
    let scale = scale.then_some("the ground sample distance (--gsd)");
    let north = priors.rotation_deg.is_none().then_some("the direction of north (--north-up)");
    scale.into_iter().chain(north).collect()
}

/// 10^x for people.
pub(super) fn scientific(log10: f64) -> String {
    let value = 10f64.powf(log10);
    match log10 {
        2.0..6.0 => return format!("{value:.0}"),
        0.0..2.0 => return format!("{value:.1}"),
        // One digit that is not 0.
        -5.0..0.0 => return format!("{value:.*}", (-log10.floor()) as usize),
        _ => {}
    }
    // One digit and the power, which a double may not hold.
    let digit = 10f64.powf(log10 - log10.floor()).round();
    let (digit, power) = if digit >= 10.0 { (1.0, log10.floor() + 1.0) } else { (digit, log10.floor()) };
    format!("{digit}e{power}")
}

#[cfg(test)]
mod tests {
    use super::scientific;

    #[test]
    fn numbers_are_those_of_people() {
        for (value, said) in [(259.141, "259"), (1.26, "1.3"), (8e-3, "0.008"), (1e-4, "0.0001"), (3e-9, "3e-9")] {
            assert_eq!(scientific(f64::log10(value)), said);
        }
        assert_eq!([scientific(75.3), scientific(-400.0)], ["2e75", "1e-400"]);
    }
}
