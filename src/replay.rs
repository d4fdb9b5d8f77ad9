//! From a result file and a patch to the orientation that the page showed.

use std::path::Path;

use crate::candidate::Candidate;
use crate::gcp::GcpRole;
use crate::matching::diagnosis::{Diagnosis, Mistake};
use crate::matching::{Effort, Pattern, Solved};
use crate::pipeline::georeference::{FoundBy, FoundMark, Orientation, pairs};
use crate::result::{RunPattern, RunResult};
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_review::HAND_VARIANCE_PX2;
use autoref_review::{Action, Edit, PatchFile, Target};
use autoref_solve::solve_as;

/// What a replay gives.
#[derive(Clone, Debug)]
pub enum Replayed {
    Solved(Box<Orientation>),
    /// The marks that are left lie in one place or are fewer than two.
    Unsolvable {
        points: usize,
    },
}

/// The mark of one GCP while edits are applied.
#[derive(Clone, Debug)]
struct Held {
    mark: Candidate,
    found_by: FoundBy,
    /// Takes part in the fit (or is compared with it).
    used: bool,
}

/// Applies the edits in order and solves again.
///
/// # Errors
/// [`Error::Usage`] when the result's best pattern refers to what the result does not have; [`Error::Format`] when an
/// edit names a GCP or candidate that the result does not have, accepts a GCP that has no mark, puts one outside the
/// image, or when one candidate ends as the mark of two GCPs.
pub fn replay(recorded: &RunResult, patch: &PatchFile, patch_path: &Path) -> Result<Replayed> {
    let pairs = recorded.best_pattern().into_iter().flat_map(|pattern| &pattern.pairs);
    if pairs.into_iter().any(|&(c, g)| c >= recorded.candidates.len() || g >= recorded.gcps.len()) {
        return Err(Error::usage(
            "the result's best pattern refers to a candidate or GCP that it does not have",
            "make the result again",
        ));
    }
    let mut held = initial(recorded);
    for (i, edit) in patch.edits.iter().enumerate() {
        apply(recorded, &mut held, edit)
            .map_err(|what| Error::format(patch_path, format!("edit {} ({})", i + 1, edit.target), what))?;
    }
    let mut marks: Vec<FoundMark> = Vec::new();
    let (mut control, mut check) = (Vec::new(), Vec::new());
    for (gcp, held) in held.iter().enumerate() {
        let Some(held) = held.as_ref().filter(|held| held.used) else { continue };
        if let Some(other) = marks.iter().find(|other| other.mark.centre == held.mark.centre) {
            let names = (&recorded.gcps[other.gcp].name, &recorded.gcps[gcp].name);
            return Err(Error::format(patch_path, "edits", format!("{} and {} share one mark", names.0, names.1)));
        }
        let found = FoundMark { gcp, mark: held.mark.clone(), found_by: held.found_by };
        marks.push(found.clone());
        if recorded.gcps[gcp].role == GcpRole::Check { check.push(found) } else { control.push(found) }
    }
    let diagnoses = open_diagnoses(recorded, patch, &marks);
    Ok(orientation(recorded, control, check, diagnoses))
}

/// The marks as the run left them; those of a refused run's best pattern are proposals until somebody accepts them.
fn initial(recorded: &RunResult) -> Vec<Option<Held>> {
    let mut held: Vec<Option<Held>> = vec![None; recorded.gcps.len()];
    for row in recorded.matches().iter().chain(recorded.check_points()) {
        let Some(gcp) = recorded.gcps.iter().position(|gcp| gcp.name == row.gcp) else { continue };
        let centre = PixelPoint { x: row.x, y: row.y };
        let known = recorded.candidates.iter().find(|c| c.centre == centre).cloned();
        let mark = known.unwrap_or(Candidate {
            covariance_px2: row.covariance_px2,
            score: row.score,
            code: row.code.clone(),
            ..Candidate::at(centre)
        });
        held[gcp] = Some(Held { mark, found_by: row.found_by, used: true });
    }
    for &(candidate, gcp) in recorded.best_pattern().into_iter().flat_map(|pattern| &pattern.pairs) {
        let mark = recorded.candidates[candidate].clone();
        held[gcp] = Some(Held { mark, found_by: FoundBy::Scan, used: false });
    }
    held
}

fn apply(recorded: &RunResult, held: &mut [Option<Held>], edit: &Edit) -> Result<(), String> {
    let Target::Gcp { gcp } = &edit.target else { return Err("names no GCP".into()) };
    let index = recorded.gcps.iter().position(|g| g.name == *gcp).ok_or("the result has no GCP of this name")?;
    let place = &mut held[index];
    match edit.action {
        Action::Accept => place.as_mut().ok_or("has no mark to accept; use `pick` or `move`")?.used = true,
        Action::Reject | Action::NotVisible => {
            if let Some(held) = place {
                held.used = false;
            }
        }
        Action::Move => {
            let centre =
                PixelPoint { x: edit.x.ok_or("`move` needs x and y")?, y: edit.y.ok_or("`move` needs x and y")? };
            if let Some(image) = &recorded.image {
                let (width, height) = (image.width, image.height);
                let inside = (0.0..=width as f64).contains(&centre.x) && (0.0..=height as f64).contains(&centre.y);
                if !inside {
                    return Err(format!(
                        "({}, {}) lies outside the image of {width} × {height} px",
                        centre.x, centre.y
                    ));
                }
            }
            let mark = Candidate {
                centre,
                covariance_px2: Some([HAND_VARIANCE_PX2, 0.0, HAND_VARIANCE_PX2]),
                score: None,
                area_px: None,
                size_px: None,
                elevation_m: place.as_ref().and_then(|held| held.mark.elevation_m),
                code: None,
                paint: None,
            };
            *place = Some(Held { mark, found_by: FoundBy::Review, used: true });
        }
        Action::Pick => {
            let index = edit.candidate.ok_or("`pick` needs the index of a candidate")?;
            let mark = recorded.candidates.get(index).ok_or("the result has no candidate of this index")?.clone();
            *place = Some(Held { mark, found_by: FoundBy::Review, used: true });
        }
    }
    Ok(())
}

/// The mistakes that the run named and the review does not settle: marks do not mend a list. One of single points is
/// settled where a mark of theirs was found after all, or where the review has spoken on each of them.
fn open_diagnoses(recorded: &RunResult, patch: &PatchFile, marks: &[FoundMark]) -> Vec<Diagnosis> {
    let has_mark = |name: &String| marks.iter().any(|found| recorded.gcps[found.gcp].name == *name);
    let is_edited =
        |name: &String| patch.edits.iter().any(|edit| matches!(&edit.target, Target::Gcp { gcp } if gcp == name));
    let is_settled = |diagnosis: &&Diagnosis| {
        let gcps = &diagnosis.gcps;
        // Labels are of marks that are there.
        let found = diagnosis.mistake != Mistake::LabelsExchanged && gcps.iter().any(has_mark);
        !gcps.is_empty() && (found || gcps.iter().all(is_edited))
    };
    recorded.diagnoses.iter().filter(|diagnosis| !is_settled(diagnosis)).cloned().collect()
}

/// The pattern that the run found, and how many of its control points kept their marks.
pub fn run_pattern(recorded: &RunResult, left: &Orientation) -> RunPattern {
    /// As `--max-false-alarms` without a word.
    const USUAL_LIMIT: f64 = 1e-4;
    let kept = left.marks.iter().filter(|found| found.found_by != FoundBy::Review).count();
    if let Some(earlier) = recorded.run_pattern {
        return RunPattern { kept: kept.min(earlier.points), ..earlier };
    }
    let points = match recorded.best_pattern() {
        Some(pattern) => pattern.pairs.len(),
        None => recorded.matches().len(),
    };
    let limit = recorded.options.get("max_false_alarms").and_then(serde_json::Value::as_f64).unwrap_or(USUAL_LIMIT);
    let is_rare = recorded.log10_false_alarms.is_some_and(|log10| log10 <= limit.log10());
    RunPattern { points, kept, believed: recorded.solved().is_some() || is_rare }
}

fn orientation(
    recorded: &RunResult,
    marks: Vec<FoundMark>,
    check_marks: Vec<FoundMark>,
    diagnoses: Vec<Diagnosis>,
) -> Replayed {
    let pairs = pairs(&recorded.gcps, &marks);
    let mirrored = recorded.similarity().map(|similarity| similarity.mirrored).unwrap_or_default();
    let Ok(solution) = solve_as(&pairs, mirrored) else { return Replayed::Unsolvable { points: pairs.len() } };
    let (mut not_found, mut outside) = (Vec::new(), Vec::new());
    for (i, gcp) in recorded.gcps.iter().enumerate() {
        if marks.iter().chain(&check_marks).any(|found| found.gcp == i) {
            continue;
        }
        let p = solution.similarity.invert(gcp.position());
        let inside = recorded
            .image
            .as_ref()
            .is_none_or(|image| p.x >= 0.0 && p.y >= 0.0 && p.x < image.width as f64 && p.y < image.height as f64);
        if inside { not_found.push(i) } else { outside.push(i) }
    }
    // The evidence is the run's: a reviewer's word is not counted as chance.
    let pattern = Pattern {
        pairs: Vec::new(),
        similarity: solution.similarity,
        log10_false_alarms: recorded.log10_false_alarms.unwrap_or(0.0),
        log10_whole_false_alarms: recorded.log10_false_alarms.unwrap_or(0.0),
        noise_px: solution.rmse_px,
        deviation_px: solution.rmse_px,
        gcps_in_image: marks.len() + check_marks.len() + not_found.len(),
    };
    let evidence = Solved { pattern, runner_up: None, effort: Effort::default(), names: None };
    Replayed::Solved(Box::new(Orientation { evidence, solution, marks, check_marks, not_found, outside, diagnoses }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::Gcp;
    use crate::matching::diagnosis::Certainty;
    use autoref_review::{SCHEMA, SCHEMA_VERSION, Subject};

    /// Four marks of a north-up image of 0.1 m pixels, the last one a metre off, and a fifth candidate where it should
    /// be.
    fn recorded() -> RunResult {
        let places = [("A", 100.0, 100.0), ("B", 900.0, 120.0), ("C", 880.0, 700.0), ("D", 140.0, 660.0)];
        let row = |name: &str, x: f64, y: f64| {
            serde_json::json!({"gcp": name, "x": x, "y": y, "easting": 0.0, "northing": 0.0, "height": null,
                "residual_e_m": 0.0, "residual_n_m": 0.0, "residual_px": 0.0, "covariance_px2": [0.01, 0.0, 0.01],
                "score": 5.0, "found_by": "scan", "outlier": false})
        };
        let gcps: Vec<Gcp> =
            places.iter().map(|(n, x, y)| Gcp::control(*n, 5000.0 + 0.1 * x, 9000.0 - 0.1 * y)).collect();
        let mut matches: Vec<_> = places.iter().map(|(n, x, y)| row(n, *x, *y)).collect();
        matches[3]["x"] = 150.0.into();
        let candidate = serde_json::json!({"centre": {"x": 140.0, "y": 660.0}, "covariance_px2": [0.01, 0.0, 0.01],
            "score": 1.0, "area_px": 100.0, "size_px": [10.0, 10.0], "elevation_m": null});
        serde_json::from_value(serde_json::json!({
            "schema_version": 1, "program": "", "status": "solved", "advice": [], "options": null,
            "geotransform": [5000.0, 0.1, 0.0, 9000.0, 0.0, -0.1], "rmse_m": 0.3, "rmse_e_m": 0.3, "rmse_n_m": 0.0, "rmse_px": 3.0,
            "scale_m_per_px": 0.1, "rotation_deg": 0.0, "gcps_in_image": 4, "gcp_file": "list.csv", "gcps_listed": 4, "gcps": gcps, "candidates_found": 1, "matches": matches,
            "check_points": [], "expected_errors": [], "not_found": [], "outside": [], "warnings": [],
            "candidates": [candidate], "files_written": [], "elapsed_s": 0.0,
            "timings": {"open_s": 0.0, "scan_s": 0.0, "examine_s": 0.0, "match_s": 0.0, "rematch_s": 0.0,
                "report_s": 0.0, "write_s": 0.0},
            "image": {"path": "a.tif", "width": 1000, "height": 800, "bands": 3, "reader": "", "description": ""},
            "log10_false_alarms": -6.0
        }))
        .expect("a result")
    }

    fn patch(edits: serde_json::Value) -> PatchFile {
        PatchFile {
            schema: SCHEMA.into(),
            schema_version: SCHEMA_VERSION,
            subject: Subject::Gcps,
            source: String::new(),
            edits: serde_json::from_value(edits).expect("edits"),
            shown: None,
        }
    }

    fn run(edits: serde_json::Value) -> Result<Replayed> {
        replay(&recorded(), &patch(edits), Path::new("patch.json"))
    }

    #[test]
    fn rejecting_or_replacing_the_wrong_mark_leaves_an_exact_fit() {
        for edits in [
            serde_json::json!([{"gcp": "D", "action": "reject"}]),
            serde_json::json!([{"gcp": "D", "action": "pick", "candidate": 0}]),
            serde_json::json!([{"gcp": "D", "action": "not-visible"}, {"gcp": "D", "action": "move", "x": 140.0, "y": 660.0}]),
        ] {
            let Replayed::Solved(orientation) = run(edits.clone()).expect("a good patch") else { panic!("{edits}") };
            assert!(orientation.solution.rmse_m < 1e-9, "{edits}: {}", orientation.solution.rmse_m);
            assert_eq!(orientation.not_found.len() + orientation.marks.len(), 4);
        }
        let Replayed::Solved(before) = run(serde_json::json!([])).expect("nothing to do") else { panic!("solvable") };
        assert!(before.solution.rmse_m > 0.1);
    }

    /// The replay forgot every mistake in the list that the run had named.
    #[test]
    fn mistakes_in_the_list_stay_until_the_review_settles_them() {
        let mut recorded = recorded();
        let named = |gcps: &[&str]| Diagnosis {
            mistake: Mistake::MistypedDigit,
            certainty: Certainty::Claimed,
            gcps: gcps.iter().map(|name| (*name).to_owned()).collect(),
            message: String::new(),
            log10_false_alarms: None,
        };
        recorded.diagnoses = vec![named(&[]), named(&["D"])];
        let open = |edits: serde_json::Value| {
            let replayed = replay(&recorded, &patch(edits), Path::new("patch.json")).expect("a good patch");
            let Replayed::Solved(orientation) = replayed else { panic!("solvable") };
            orientation.diagnoses.iter().map(|diagnosis| diagnosis.gcps.len()).collect::<Vec<_>>()
        };
        assert_eq!(open(serde_json::json!([])), [0], "D has a mark");
        assert_eq!(open(serde_json::json!([{"gcp": "D", "action": "reject"}])), [0], "a person says that it has none");
        let mut without = recorded.clone();
        without.solved_mut().expect("solved").matches.pop();
        let Replayed::Solved(kept) =
            replay(&without, &patch(serde_json::json!([])), Path::new("patch.json")).expect("a good patch")
        else {
            panic!("solvable")
        };
        assert_eq!(kept.diagnoses.len(), 2, "nobody has said anything of D");
    }

    /// The chance of a pattern of seven points was stated of the two that a review had left.
    #[test]
    fn the_pattern_of_the_run_is_told_from_what_the_review_left() {
        let pattern = |recorded: &RunResult, edits: serde_json::Value| {
            let replayed = replay(recorded, &patch(edits), Path::new("patch.json")).expect("a good patch");
            let Replayed::Solved(orientation) = replayed else { panic!("solvable") };
            run_pattern(recorded, &orientation)
        };
        let reject = serde_json::json!([{"gcp": "D", "action": "reject"}]);
        let moved = serde_json::json!([{"gcp": "A", "action": "move", "x": 100.0, "y": 100.0}]);
        let of = |points, kept, believed| RunPattern { points, kept, believed };
        let mut recorded = recorded();
        assert_eq!(pattern(&recorded, serde_json::json!([])), of(4, 4, true));
        assert_eq!(pattern(&recorded, reject.clone()), of(4, 3, true));
        assert_eq!(pattern(&recorded, moved.clone()), of(4, 3, true));
        // A second review of the same run.
        recorded.run_pattern = Some(of(7, 4, false));
        assert_eq!(pattern(&recorded, moved), of(7, 3, false));
    }

    #[test]
    fn what_cannot_be_replayed_is_said() {
        let error = |edits| run(edits).expect_err("not possible").to_string();
        assert!(error(serde_json::json!([{"gcp": "Z", "action": "reject"}])).contains("no GCP of this name"));
        assert!(error(serde_json::json!([{"gcp": "A", "action": "pick", "candidate": 9}])).contains("no candidate"));
        let twice = serde_json::json!([{"gcp": "A", "action": "pick", "candidate": 0}, {"gcp": "D", "action": "pick", "candidate": 0}]);
        assert!(error(twice).contains("share one mark"));
        let outside = error(serde_json::json!([{"gcp": "A", "action": "move", "x": 1000.5, "y": 3.0}]));
        assert!(outside.contains("outside the image of 1000 × 800 px"), "{outside}");
        let all = serde_json::json!([{"gcp": "A", "action": "reject"}, {"gcp": "B", "action": "reject"}, {"gcp": "C", "action": "reject"}]);
        assert!(matches!(run(all).expect("a patch"), Replayed::Unsolvable { points: 1 }));
    }
}
