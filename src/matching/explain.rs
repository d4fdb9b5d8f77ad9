//! Why nothing is believed, in plain words.

use crate::matching::{Effort, Evidence, Pattern};

/// Plain words on why nothing is believed.
pub(super) fn explain(
    candidates: usize,
    control: &[usize],
    best: Option<Pattern>,
    runner_up: Option<Pattern>,
    effort: Effort,
    limit: f64,
) -> Evidence {
    let mut advice = Vec::new();
    let reason = if candidates < 3 {
        advice.push(
            "check that the profile fits the paint: try another --profile, or learn one with `sample`".to_string(),
        );
        format!("{candidates} candidate(s) found; a pattern needs at least 3")
    } else if control.len() < 3 {
        advice.push("give at least 3 control points; 4 or 5 visible ones are needed to be sure".to_string());
        format!("{} control point(s) in the list; a pattern needs at least 3", control.len())
    } else if let Some(best) = &best {
        let beaten = best.log10_false_alarms <= limit;
        if beaten {
            advice.push(
                "the list or the image shows a figure that repeats: give the direction of north (--north-up), the --gsd, or \
                 only the points that can be in the image (--names), each of them once"
                    .to_string(),
            );
        }
        let rival = runner_up.as_ref().filter(|_| beaten).map_or(String::new(), |other| {
            format!(
                ", but another one is almost as good ({} GCPs, {})",
                other.pairs.len(),
                scientific(other.log10_false_alarms)
            )
        });
        format!(
            "the best pattern joins {} of {} GCPs in the image, and chance alone would produce {} such patterns{rival}",
            best.pairs.len(),
            best.gcps_in_image,
            scientific(best.log10_false_alarms),
        )
    } else if control.len() == 3 {
        advice.push("give --gsd and --north-up, or a fourth point".to_string());
        format!("three points cannot prove a pattern among {candidates} candidates without other knowledge")
    } else {
        format!(
            "no three of {candidates} candidates lie like GCPs of the list in a way that chance would not produce as well"
        )
    };
    if advice.is_empty() {
        advice
            .push("more marks in the image, or fewer false candidates (a stricter --profile, --mark-size)".to_string());
        advice
            .push("the ground sample distance, if known (--gsd), and the direction of north (--north-up)".to_string());
    }
    Evidence { reason, advice, best, runner_up, effort, diagnoses: Vec::new() }
}

/// 10^x for people.
pub(super) fn scientific(log10: f64) -> String {
    if (-2.0..6.0).contains(&log10) {
        return format!("{:.3}", 10f64.powf(log10));
    }
    // One digit and the power, which a double may not hold.
    let digit = 10f64.powf(log10 - log10.floor()).round();
    let (digit, power) = if digit >= 10.0 { (1.0, log10.floor() + 1.0) } else { (digit, log10.floor()) };
    format!("{digit}e{power}")
}
