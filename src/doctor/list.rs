//! Mistakes of the whole list, tried when nothing fits.

use super::{Diagnosis, Mistake};
use crate::candidate::Candidate;
use crate::gcp::Gcp;
use crate::georef::crs::Crs;
use crate::matching::{MatchOutcome, Matcher, Priors};

/// One international foot, metres.
pub const FOOT_M: f64 = 0.3048;
/// One US survey foot, metres.
pub const SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;

/// Tries the list with swapped axes and in other units; what is found would be accepted by the same matcher with the same
/// priors. The mistakes are tried one by one, each a search of its own, so this takes up to three times the time of a
/// refusal.
pub fn diagnose_list(
    candidates: &[Candidate],
    gcps: &[Gcp],
    crs: Option<&Crs>,
    matcher: &dyn Matcher,
    priors: &Priors,
) -> Vec<Diagnosis> {
    let changed = |change: &dyn Fn(&Gcp) -> (f64, f64), priors: &Priors| {
        let list: Vec<Gcp> = gcps
            .iter()
            .map(|gcp| {
                let (easting, northing) = change(gcp);
                Gcp { easting, northing, ..gcp.clone() }
            })
            .collect();
        match matcher.find(candidates, &list, priors) {
            MatchOutcome::Solved(solved) => Some(solved.pattern),
            MatchOutcome::NoMatch(_) => None,
        }
    };
    // A direction of north means nothing in a mirror.
    let mirrored = changed(&|g| (g.northing, g.easting), &Priors { rotation_deg: None, ..priors.clone() });
    if let Some(pattern) = mirrored {
        return vec![Diagnosis::new(mirror(gcps, crs), pattern.log10_false_alarms)];
    }
    if priors.gsd_m_per_px.is_none() {
        // Any unit fits when the scale is free.
        return Vec::new();
    }
    let units = [(FOOT_M, Mistake::FeetForMetres { survey: None }), (1.0 / FOOT_M, Mistake::MetresForFeet)];
    units
        .into_iter()
        .find_map(|(factor, mistake)| {
            let pattern = changed(&|g| (g.easting * factor, g.northing * factor), priors)?;
            Some(Diagnosis::new(mistake, pattern.log10_false_alarms))
        })
        .into_iter()
        .collect()
}

/// A pattern that fits at a scale which only another unit explains: the image says otherwise of its ground sample distance.
pub fn diagnose_unit(scale_m_per_px: f64, priors: &Priors) -> Option<Diagnosis> {
    let (low, high) = priors.gsd_m_per_px?;
    let allowed = |scale: f64| (low..=high).contains(&scale);
    let mistake = if allowed(scale_m_per_px) {
        return None;
    } else if allowed(scale_m_per_px * FOOT_M) {
        Mistake::FeetForMetres { survey: None }
    } else if allowed(scale_m_per_px / FOOT_M) {
        Mistake::MetresForFeet
    } else {
        return None;
    };
    // Scales two decades about the stated one would hit the range this often.
    Some(Diagnosis::new(mistake, ((high / low).ln() / 100f64.ln()).log10()))
}

/// Whether metres of the fit lie where the system is used.
fn covers(crs: &Crs, easting: f64, northing: f64) -> Option<bool> {
    crs.covers(easting / crs.metres_per_unit(), northing / crs.metres_per_unit())
}

/// Swapping the axes mirrors the pattern, so the pattern cannot tell the two apart; the place of the coordinates can.
fn mirror(gcps: &[Gcp], crs: Option<&Crs>) -> Mistake {
    let count = gcps.len().max(1) as f64;
    let easting = gcps.iter().map(|g| g.easting).sum::<f64>() / count;
    let northing = gcps.iter().map(|g| g.northing).sum::<f64>() / count;
    let (as_listed, as_swapped) = match crs {
        Some(crs) => (covers(crs, easting, northing), covers(crs, northing, easting)),
        None => (None, None),
    };
    let by_size = |e: f64, n: f64| (1e5..1e6).contains(&e) && (1e6..1e7).contains(&n);
    let listed = as_listed.unwrap_or_else(|| by_size(easting, northing));
    let swapped = as_swapped.unwrap_or_else(|| by_size(northing, easting));
    match (listed, swapped) {
        (false, true) => Mistake::SwappedAxes,
        (true, false) => Mistake::MirroredImage,
        _ => Mistake::SwappedAxesOrMirroredImage,
    }
}
