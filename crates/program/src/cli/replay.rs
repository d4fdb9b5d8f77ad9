//! `autoref-stream solve NAME.autoref.json --patch FILE`: what a review changed, applied to the result it was made
//! from.

use std::collections::HashMap;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use anyhow::bail;
use autoref_raster::atomic::Existing;
use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use autoref_raster::crs::Crs;
use autoref_review::{Action, PatchFile, Subject, Target};
use autoref_stream::gcp::{GcpList, WorkingCrs};
use autoref_stream::matching::{Effort, Evidence};
use autoref_stream::pipeline::georeference::Outcome;
use autoref_stream::pipeline::reasons::{NotFound, Reason};
use autoref_stream::replay::{Replayed, replay, run_pattern};
use autoref_stream::report;
use autoref_stream::result::{Misfit, RunResult, Warning};

use crate::cli::accuracy;
use crate::cli::args::SolveArgs;
use crate::cli::diagnosis;
use crate::cli::document::Document;
use crate::cli::recorded_image::{apply_command, from_result, recorded_image};
use crate::cli::run;
use crate::cli::solving;
use crate::cli::working_crs::Force;
use autoref_raster::words::counted;

pub fn run(args: &SolveArgs, patch_path: &Path, started: Instant) -> anyhow::Result<ExitCode> {
    if args.gcps.gcps.is_some() {
        bail!("--patch takes the points of {}; leave --gcps away", args.candidates.display());
    }
    if args.solving.asked() {
        bail!("--patch solves again what the recorded run solved; leave --model, --solver and --dem away");
    }
    if let Some(output) = &args.output {
        autoref_raster::atomic::check_outputs(&[output], Existing::of_flag(args.overwrite))?;
    }
    let recorded = RunResult::read(&args.candidates)?;
    let patch = PatchFile::read(patch_path, Subject::Gcps)?;
    let replayed = replay(&recorded, &patch, patch_path)?;
    let delivery = Delivery::of(&recorded, &args.candidates)?;
    let mut notes = Vec::new();
    let name = args.candidates.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    if !patch.source.is_empty() && patch.source != name {
        notes.push(format!("the patch was made from {}, not from {name}", patch.source));
    }
    let crs = recorded.crs.as_deref().map(Crs::parse).transpose()?;
    let list = GcpList { gcps: recorded.gcps.clone(), crs, working_crs: WorkingCrs::local(), notes, hints: Vec::new() };
    let mut outcome = outcome(replayed, &recorded);
    accuracy::check_nssda(&args.gcps.accuracy, &list)?;
    let mut document = document(args, &recorded, &list, &outcome);
    if differs(&patch, document.result.geotransform().map(|g| g.0)) {
        bail!(
            "{}: its page had shown another transform: it was not made from {} as that is now; review its page again, or remove `shown` from the patch to replay it all the same",
            patch_path.display(),
            args.candidates.display()
        );
    }
    if refuse_again(&mut outcome, &recorded, &args.gcps.working_crs.force) {
        document = self::document(args, &recorded, &list, &outcome);
    }
    let edits = counted(patch.edits.len(), "edit", "edits");
    document.result.warn(format!("{edits} by hand replayed from {}", patch_path.display()));
    keep_reasons(&mut document.result, &recorded);
    settle(&mut document.result, &recorded, &patch);
    document.result.patch = Some(patch);
    if let Some(delivery) = &delivery {
        delivery.apply(&mut document.result);
    }
    document.finish(started);
    if let Some(output) = &args.output {
        if let Some(image) = &mut document.result.image {
            let place = recorded_image(&args.candidates, image);
            image.from_result = if place.exists() { from_result(&place, output) } else { image.from_result.take() };
        }
        document.result.files_written.push(output.display().to_string());
        crate::out::write_text(output, document.result.to_json().as_bytes(), Existing::of_flag(args.overwrite))?;
    }
    run::print(&document.result, run::Printing { json: args.json, quiet: args.quiet });
    // A pipe cannot be read again.
    let is_kept = |output: &&Path| output.is_file() && !args.json && !args.quiet;
    if let Some(output) = args.output.as_deref().filter(is_kept)
        && document.result.solved().is_some()
    {
        // A run that was not laid beside its image has its result where its outputs are.
        let is_apart = recorded.image.as_ref().is_some_and(|image| image.from_result.is_some());
        let run_folder = args.candidates.parent().filter(|_| is_apart);
        // The result alone is written yet, and the image keeps the georeference that it had.
        println!("{:<16}{}", "To write it", crate::printable(&apply_command(output, &document.result, run_folder)));
    }
    Ok(document.exit_code())
}

fn outcome(replayed: Replayed, recorded: &RunResult) -> Outcome {
    match replayed {
        Replayed::Solved(orientation) => Outcome::Solved(orientation),
        Replayed::Unsolvable { points } => Outcome::Refused(Box::new(Evidence {
            // A review of what is written of this one must not forget them.
            diagnoses: recorded.diagnoses.clone(),
            reason: format!(
                "the review leaves {}; an orientation needs 2 in different places",
                counted(points, "point", "points")
            ),
            advice: vec!["accept or place more marks".into()],
            best: None,
            runner_up: None,
            effort: Effort::default(),
        })),
    }
}

/// The document of what came of the replay, with what the recorded run knew of the image and was asked for.
fn document(args: &SolveArgs, recorded: &RunResult, list: &GcpList, outcome: &Outcome) -> Document {
    let mut document = Document::new(list, Path::new(&recorded.gcp_file), outcome, recorded.candidates.clone());
    let result = &mut document.result;
    result.options = recorded.options.clone();
    // A georeference can be written from what was settled by hand: `apply` wants to know the image.
    result.image = recorded.image.clone();
    if let Outcome::Solved(orientation) = outcome {
        result.run_pattern = Some(run_pattern(recorded, orientation));
        solving::again(result, recorded, orientation, list);
    }
    let extent = result.extent_px();
    accuracy::state(result, list, &args.gcps.accuracy, extent);
    if let (Some(solved), Some(image)) = (result.solved(), &recorded.image)
        && let Some(solution) = &solved.solution
        && let Some(errors) = accuracy::error_model(solved)
    {
        let marks: Vec<PixelPoint> = solved.matches.iter().map(|row| PixelPoint { x: row.x, y: row.y }).collect();
        let size_px = (image.width as f64, image.height as f64);
        let notes = report::plain_warnings(solution, &errors, Misfit::of(result).as_ref(), &marks, size_px);
        result.warnings.extend(notes.into_iter().map(Warning::Said));
    }
    document
}

/// Refuses anew what the recorded run refused for a mistake of the whole list: a review settles marks, not the list. A
/// run that solved in spite of one was told so by `--force`, and its verdict says so again. Whether it was refused.
fn refuse_again(outcome: &mut Outcome, recorded: &RunResult, forced: &[Force]) -> bool {
    if recorded.refused().is_none() || matches!(outcome, Outcome::Refused(_)) {
        return false;
    }
    diagnosis::refuse_mistakes(outcome, forced);
    let Outcome::Refused(evidence) = outcome else { return false };
    // What may be accepted stays so for the next replay.
    evidence.best = recorded.best_pattern().cloned();
    evidence.runner_up = recorded.runner_up.clone();
    evidence.effort = recorded.search.clone().unwrap_or_default();
    true
}

/// Why points have no mark was seen in the image, which a replay does not look at.
fn keep_reasons(result: &mut RunResult, recorded: &RunResult) {
    let seen = recorded.solved().map(|run| run.not_found.as_slice()).unwrap_or_default();
    // What an earlier review settled stays so, whatever lies there.
    let by_review = |known: &NotFound| matches!(known.reason, Reason::Proposed | Reason::Reviewed);
    let unseen = result.solved_mut().into_iter().flat_map(|run| &mut run.not_found);
    for lost in unseen.filter(|lost| lost.reason != Reason::Outside) {
        let Some(known) = seen.iter().find(|known| known.name == lost.name && known.reason != Reason::Outside) else {
            continue;
        };
        if lost.reason == Reason::Hidden || by_review(known) {
            *lost = NotFound { x: lost.x, y: lost.y, ..known.clone() };
        }
    }
    for known in seen.iter().filter(|known| by_review(known)) {
        result.warnings.retain(|warning| !warning.misses(&known.name));
    }
}

/// What a person rejected or could not see is no doubt of the program's any more, and a proposal that nobody accepted
/// is no mark beside its place.
fn settle(result: &mut RunResult, recorded: &RunResult, patch: &PatchFile) {
    let proposals = recorded.best_pattern().into_iter().flat_map(|pattern| &pattern.pairs);
    let mut settled: HashMap<&str, (Reason, &str)> = proposals
        .map(|pair| (recorded.gcps[pair.1].name.as_str(), (Reason::Proposed, "not accepted in the review")))
        .collect();
    for edit in &patch.edits {
        let Target::Gcp { gcp } = &edit.target else { continue };
        match edit.action {
            Action::Reject => settled.insert(gcp, (Reason::Reviewed, "a review rejected what was found there")),
            Action::NotVisible => settled.insert(gcp, (Reason::Reviewed, "a review could not see it")),
            // It has a mark then.
            Action::Accept | Action::Move | Action::Pick => settled.remove(gcp.as_str()),
        };
    }
    for (gcp, (reason, said)) in settled {
        result.warnings.retain(|warning| !warning.misses(gcp));
        let lost = result.solved_mut().into_iter().flat_map(|solved| &mut solved.not_found);
        for lost in lost.filter(|lost| lost.name == gcp && lost.reason != Reason::Outside) {
            *lost = NotFound::new(gcp.to_owned(), reason, PixelPoint { x: lost.x, y: lost.y }, said.into());
        }
    }
}

/// Whether the page had shown another transform: the patch belongs to another result, or was changed since.
fn differs(patch: &PatchFile, now: Option<[f64; 6]>) -> bool {
    let Some(shown) = &patch.shown else { return false };
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * a.abs().max(1.0);
    match (shown.geotransform, now) {
        (Some(a), Some(b)) => !a.iter().zip(b).all(|(a, b)| close(*a, b)),
        (a, b) => a.is_some() || b.is_some(),
    }
}

/// The way from the metres of the fit to the units and CRS of the outputs, as the recorded run went it.
struct Delivery {
    fitted: GeoTransform,
    delivered: GeoTransform,
    size_px: (f64, f64),
    /// Heights as the recorded run wrote them, by the points' names.
    heights: HashMap<String, f64>,
    height_metres_per_unit: f64,
}

impl Delivery {
    /// `None` when the two are the same.
    fn of(recorded: &RunResult, path: &Path) -> anyhow::Result<Option<Delivery>> {
        if !recorded.delivered {
            return Ok(None);
        }
        let solved = recorded.solved().and_then(|solved| Some((solved.solution.as_ref()?, solved.geotransform)));
        let Some((solution, delivered)) = solved else {
            bail!(
                "{}: the run was refused and its outputs are in other units or another CRS than its points; \
                 run it again with points in metres, without --to-crs",
                path.display()
            );
        };
        let size_px =
            recorded.image.as_ref().map_or((1000.0, 1000.0), |image| (image.width as f64, image.height as f64));
        let fitted = solving::written_affine(recorded).unwrap_or(solution.geotransform);
        let rows = recorded.solved().into_iter().flat_map(|solved| solved.matches.iter().chain(&solved.check_points));
        let heights = rows.filter_map(|row| Some((row.gcp.clone(), row.height?))).collect();
        let crs = recorded.crs.as_deref().map(Crs::parse).transpose()?;
        let unit_m = |crs: Crs| crs.height_metres_per_unit().unwrap_or_else(|| crs.metres_per_unit());
        let height_metres_per_unit = crs.map_or(1.0, unit_m);
        Ok(Some(Delivery { fitted, delivered, size_px, heights, height_metres_per_unit }))
    }

    fn point(&self, fitted: MapPoint) -> MapPoint {
        let pixel = self.fitted.invert(fitted).expect("a solution has a scale");
        self.delivered.apply(pixel)
    }

    /// Of a point, from the metres of the fit.
    fn height(&self, name: &str, fitted_m: f64) -> f64 {
        self.heights.get(name).copied().unwrap_or(fitted_m / self.height_metres_per_unit)
    }

    fn apply(&self, result: &mut RunResult) {
        result.delivered = true;
        let Some(solved) = result.solved_mut() else { return };
        let (width, height) = self.size_px;
        let fitted = solved.geotransform;
        let at = |x: f64, y: f64| self.point(fitted.apply(PixelPoint { x, y }));
        solved.geotransform = GeoTransform::through(at(0.0, 0.0), at(width, 0.0), at(0.0, height), (width, height));
        for row in solved.matches.iter_mut().chain(&mut solved.check_points) {
            let point = self.point(MapPoint { easting: row.easting, northing: row.northing });
            (row.easting, row.northing) = (point.easting, point.northing);
            row.height = row.height.map(|height| self.height(&row.gcp, height));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_those_that_were_written() {
        let plain = GeoTransform([0.0, 1.0, 0.0, 0.0, 0.0, -1.0]);
        let delivery = Delivery {
            fitted: plain,
            delivered: plain,
            size_px: (100.0, 100.0),
            heights: HashMap::from([("P1".to_owned(), 100.0)]),
            height_metres_per_unit: 1200.0 / 3937.0,
        };
        assert_eq!(delivery.height("P1", 30.480_060_960_121_92), 100.0);
        assert!((delivery.height("P2", 30.480_060_960_121_92) - 100.0).abs() < 1e-9);
    }
}
