//! Why nothing is believed, in plain words.

use crate::gcp::Gcp;
use crate::matching::{Effort, Evidence, OfImage, Pattern, Priors};
use autoref_raster::coords::MapPoint;
use autoref_raster::words::counted;

/// Plain words on why nothing is believed; `control` are the points of the list that take part, by index.
pub(super) fn explain(
    candidates: usize,
    (gcps, control): (&[Gcp], &[usize]),
    best: Option<Pattern>,
    runner_up: Option<Pattern>,
    (effort, limit): (Effort, f64),
    known: (&Priors, OfImage),
) -> Evidence {
    let mut advice = Vec::new();
    let open = open_questions(known);
    let (few, options) = (control.len() < FEW, open.join(" and "));
    let reason = if candidates < 3 {
        advice.push(
            "check that the profile fits the paint: try another --profile, or learn one with `sample`; marks larger or \
             smaller than it takes (mostly 5 to 60 px) need --mark-size"
                .to_string(),
        );
        format!("{} found; a pattern needs at least 3", counted(candidates, "candidate", "candidates"))
    } else if control.len() < 3 {
        advice.push(format!("give at least 3 control points; {FEW} or more that are seen are needed to be sure"));
        format!("{} in the list; a pattern needs at least 3", counted(control.len(), "control point", "control points"))
    } else if let Some(best) = &best {
        let beaten = best.log10_false_alarms <= limit;
        let rival = runner_up.as_ref().filter(|_| beaten);
        advice.extend(rival.map(|rival| told_apart_by(best, rival, (gcps, control), known)));
        let (produced, most) = told_apart(best.log10_false_alarms, limit);
        let allowed = match beaten {
            true => String::new(),
            false => format!(", where at most {most} may be (--max-false-alarms)"),
        };
        let rival = rival.map_or(String::new(), |other| {
            format!(
                ", but another one is almost as good ({} GCPs, {})",
                other.pairs.len(),
                scientific(other.log10_false_alarms)
            )
        });
        format!(
            "the best pattern joins {} of {} GCPs in the image, and chance alone would produce {produced} such \
             patterns{allowed}{rival}",
            best.pairs.len(),
            best.gcps_in_image,
        )
    } else if control.len() == 3 {
        format!("three points cannot prove a pattern among {candidates} candidates without other knowledge")
    } else {
        format!(
            "no three of {candidates} candidates lie like GCPs of the list in a way that chance would not produce as well"
        )
    };
    if advice.is_empty() && few {
        let with = if open.is_empty() { String::new() } else { format!(", 4 with {options}") };
        let often = if control.len() < 4 { "3 hardly ever do" } else { "4 alone often do not" };
        advice.push(format!(
            "give more points: {FEW} or more that are seen in the image mostly prove a pattern{with}; {often}"
        ));
    } else if advice.is_empty() {
        advice
            .push("more marks in the image, or fewer false candidates (a stricter --profile, --mark-size)".to_string());
        if !open.is_empty() {
            advice.push(format!("if they are known: {options}"));
        }
    }
    Evidence { reason, advice, best, runner_up, effort, diagnoses: Vec::new() }
}

/// So many points prove a pattern among some dozens of candidates by themselves.
const FEW: usize = 5;

/// Scales and directions that are told apart by what people know of an image.
const OTHER_SCALE: f64 = 1.25;
const TURNED_DEG: f64 = 20.0;

const SCALE: &str = "the ground sample distance (--gsd)";
const NORTH: &str = "the direction of north (--north-up)";
const OWN_SCALE: &str = "the ground sample distance (--gsd; the image's own is taken loosely)";
const OWN_NORTH: &str = "the direction of north (--north-up; the image's own is not taken for granted)";

/// What the user has not told the search, which would be narrower by it: what the image says is not taken for granted,
/// so that a figure of the user's helps there too.
fn open_questions((priors, of_image): (&Priors, OfImage)) -> Vec<&'static str> {
    let scale = is_scale_open(priors).then_some(if of_image.scale { OWN_SCALE } else { SCALE });
    let north = priors.rotation_deg.is_none().then_some(if of_image.north { OWN_NORTH } else { NORTH });
    scale.into_iter().chain(north).collect()
}

fn is_scale_open(priors: &Priors) -> bool {
    /// A scale known less well was guessed.
    const KNOWN: f64 = 2.0;
    priors.gsd_m_per_px.is_none_or(|(least, most)| most > KNOWN * least)
}

/// What would tell a pattern from one that is almost as good: only what makes a difference between these two.
fn told_apart_by(
    best: &Pattern,
    rival: &Pattern,
    (gcps, control): (&[Gcp], &[usize]),
    (priors, of_image): (&Priors, OfImage),
) -> String {
    if let Some((one, other)) = listed_twice(best, rival, gcps) {
        let (one, other) = (&gcps[one], &gcps[other]);
        return format!(
            "points stand twice in the list, such as `{}` and `{}`, {:.2} m apart: give each of them once, by --names or \
             in a list without the others",
            one.name,
            other.name,
            distance_m(one.position(), other.position())
        );
    }
    let (one, other) = (&best.similarity, &rival.similarity);
    let ratio = one.scale_m_per_px() / other.scale_m_per_px();
    let turned = (one.rotation_deg() - other.rotation_deg()).rem_euclid(360.0);
    // Neither tells a figure from itself when it is moved.
    let is_moved = repeats_when_moved(best, (gcps, control));
    let is_open = is_scale_open(priors) && !of_image.scale && !is_moved;
    let scale = (is_open && ratio.max(1.0 / ratio) > OTHER_SCALE).then_some(SCALE);
    // The direction of the image's own georeference is not taken for granted, so that saying it helps.
    let is_open = priors.rotation_deg.is_none() && !is_moved;
    let north = (is_open && turned.min(360.0 - turned) > TURNED_DEG).then_some(NORTH);
    // Of the points of the one the other must not have half: marks may be covered.
    let joined = |pattern: &Pattern, gcp: usize| pattern.pairs.iter().any(|pair| pair.1 == gcp);
    let shared = rival.pairs.iter().filter(|pair| joined(best, pair.1)).count();
    let elsewhere = best.gcps_in_image < control.len() && best.pairs.len() > 2 * shared;
    let names = elsewhere.then_some("only the points that can be in the image (--names)");
    let help: Vec<&str> = scale.into_iter().chain(north).chain(names).collect();
    let is_mark_of_best = |pair: &&(usize, usize)| best.pairs.iter().any(|own| own.0 == pair.0);
    let same_marks = rival.pairs.iter().filter(is_mark_of_best).count();
    if help.is_empty() && 2 * same_marks < rival.pairs.len() {
        return "the image shows a figure that repeats, two sets of marks that the points fit: leave one of them out (a \
                stricter --profile, --mark-size), or give more points"
            .to_string();
    }
    if help.is_empty() {
        return "the points make a figure that repeats, as a regular grid does: it lies on itself when it is moved or \
                turned, so that marks alone cannot tell where they are. Number the targets (coded ones), or lay half of \
                the points or more out off the figure (`plan` looks at a list before the flight)"
            .to_string();
    }
    format!("the list or the image shows a figure that repeats: give {}", help.join(", or "))
}

/// Whether half of the pattern's points lie on points of the list when all are moved by some length.
fn repeats_when_moved(best: &Pattern, (gcps, control): (&[Gcp], &[usize])) -> bool {
    /// Points against points; of longer lists it is not asked.
    const MOST: usize = 4_000;
    const NOISE: f64 = 6.0;
    let off_m = NOISE * best.noise_px * best.similarity.scale_m_per_px();
    let own: Vec<MapPoint> = best.pairs.iter().map(|pair| gcps[pair.1].position()).collect();
    let all: Vec<MapPoint> = control.iter().map(|&k| gcps[k].position()).collect();
    if own.len() * all.len() > MOST {
        return false;
    }
    let by = |from: MapPoint, to: MapPoint| {
        let moved = |p: &MapPoint| MapPoint {
            easting: p.easting + to.easting - from.easting,
            northing: p.northing + to.northing - from.northing,
        };
        let lies_on_one = |p: &&MapPoint| all.iter().any(|q| distance_m(moved(p), *q) < off_m);
        distance_m(from, to) > off_m && 2 * own.iter().filter(lies_on_one).count() >= own.len()
    };
    own.iter().any(|from| all.iter().any(|to| by(*from, *to)))
}

fn distance_m(p: MapPoint, q: MapPoint) -> f64 {
    (p.easting - q.easting).hypot(p.northing - q.northing)
}

/// Two points of the list that are one place, where a rival is the same marks on the twins of the same points: most of
/// what it joins otherwise is not joined by the pattern, and lies nearer to the pattern's point than to its others.
fn listed_twice(best: &Pattern, rival: &Pattern, gcps: &[Gcp]) -> Option<(usize, usize)> {
    let of_rival = |candidate: usize| rival.pairs.iter().find(|pair| pair.0 == candidate).map(|pair| pair.1);
    let same_marks: Vec<(usize, usize)> =
        best.pairs.iter().filter_map(|&(candidate, gcp)| Some((gcp, of_rival(candidate)?))).collect();
    let renamed: Vec<(usize, usize)> = same_marks.iter().copied().filter(|(gcp, other)| gcp != other).collect();
    let joins = |pattern: &Pattern, gcp: usize| pattern.pairs.iter().any(|pair| pair.1 == gcp);
    let is_twin = |&&(gcp, other): &&(usize, usize)| {
        let from = |k: usize| distance_m(gcps[other].position(), gcps[k].position());
        let is_nearest = best.pairs.iter().all(|pair| pair.1 == gcp || from(pair.1) > from(gcp));
        is_nearest && !joins(best, other) && !joins(rival, gcp)
    };
    let twins: Vec<&(usize, usize)> = renamed.iter().filter(is_twin).collect();
    let most = |part: usize, whole: usize| part > 0 && 5 * part >= 4 * whole;
    (2 * same_marks.len() >= best.pairs.len() && most(twins.len(), renamed.len())).then(|| *twins[0])
}

/// Two numbers for people, with so many digits that they differ.
fn told_apart(log10: f64, other: f64) -> (String, String) {
    const MOST_DIGITS: usize = 4;
    let both = (scientific(log10), scientific(other));
    if both.0 != both.1 || log10 == other {
        return both;
    }
    let of_digits = |digits: usize| {
        let said = |log10: f64| format!("{:.digits$e}", 10f64.powf(log10));
        (said(log10), said(other))
    };
    (1..MOST_DIGITS).map(of_digits).find(|(one, other)| one != other).unwrap_or(both)
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
    use super::*;

    #[test]
    fn numbers_are_those_of_people() {
        for (value, said) in [(259.141, "259"), (1.26, "1.3"), (8e-3, "0.008"), (1e-4, "0.0001"), (3e-9, "3e-9")] {
            assert_eq!(scientific(f64::log10(value)), said);
        }
        assert_eq!([scientific(75.3), scientific(-400.0)], ["2e75", "1e-400"]);
    }

    /// A pattern was refused for 0.0001 such patterns where 0.0001 may be.
    #[test]
    fn a_number_just_above_its_limit_is_told_from_it() {
        assert_eq!(told_apart(-3.93, -4.0), ("1.2e-4".to_owned(), "1.0e-4".to_owned()));
        assert_eq!(told_apart(-1.0, -4.0), ("0.1".to_owned(), "0.0001".to_owned()));
        assert_eq!(told_apart(-4.0, -4.0), ("0.0001".to_owned(), "0.0001".to_owned()));
    }

    /// Three points were sent for one more, which proves nothing; what the image says of itself kept back the figures
    /// of the user that help.
    #[test]
    fn few_points_are_sent_for_enough_and_for_what_the_user_knows() {
        let gcps: Vec<Gcp> =
            (0..4).map(|k| Gcp::control(format!("G{k}"), f64::from(k * k), f64::from(3 * k))).collect();
        let advice = |points: usize, priors: &Priors, of_image: OfImage| {
            let control: Vec<usize> = (0..points).collect();
            explain(31, (&gcps, &control), None, None, (Effort::default(), -4.0), (priors, of_image)).advice.join("; ")
        };
        let nothing = Priors::default();
        for points in [3, 4] {
            let said = advice(points, &nothing, OfImage::default());
            assert!(
                said.contains("5 or more") && said.contains("(--gsd) and") && said.contains("--north-up"),
                "{said}"
            );
        }
        let said = advice(4, &nothing, OfImage { scale: true, north: true });
        assert!(said.contains("--gsd; the image's own is taken loosely") && said.contains("--north-up"), "{said}");
        let all = Priors { gsd_m_per_px: Some((0.02, 0.03)), rotation_deg: Some((0.0, 2.0)), image_size_px: None };
        let said = advice(3, &all, OfImage::default());
        assert!(said.contains("5 or more") && !said.contains("--gsd") && !said.contains("--north-up"), "{said}");
    }
}
