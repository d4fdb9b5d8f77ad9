//! `autoref-stream solve`: from two lists to an orientation, without an image.

use autoref_raster::atomic::Existing;
use std::process::ExitCode;
use std::time::Instant;

use autoref_stream::gcp;
use autoref_stream::georef::candidate_list;
use autoref_stream::matching::Priors;
use autoref_stream::pipeline::georeference::solve_candidates;

use crate::cli::accuracy;
use crate::cli::args::SolveArgs;
use crate::cli::diagnosis;
use crate::cli::document::Document;
use crate::cli::prepare::{self, OwnWord, Shared};
use crate::cli::replay;
use crate::cli::run;
use crate::cli::solving::ImagePlace;
use crate::cli::working_crs;

pub fn run(args: &SolveArgs) -> anyhow::Result<ExitCode> {
    let started = Instant::now();
    if let Some(patch) = &args.patch {
        return replay::run(args, patch, started);
    }
    if args.candidates.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        anyhow::bail!(
            "{} is a result, not a list of candidates; give --patch FILE to replay a review",
            args.candidates.display()
        );
    }
    let size = match args.size.as_slice() {
        [] => None,
        &[width, height] if width > 0.0 && height > 0.0 => Some((width, height)),
        _ => anyhow::bail!("--size takes width and height in pixels: --size 22039,20051"),
    };
    if let Some(output) = &args.output {
        autoref_raster::atomic::check_outputs(&[output], Existing::of_flag(args.overwrite))?;
    }
    args.solving.check(Existing::of_flag(args.overwrite))?;
    let list = gcp::read(args.gcps.path()?, &args.gcps.options(None))?;
    accuracy::check_nssda(&args.gcps.accuracy, &list)?;
    let candidates = candidate_list::read_csv(&args.candidates)?;
    let priors = Priors {
        gsd_m_per_px: args.matching.gsd.map(|g| (g.0, g.1)),
        rotation_deg: args.matching.north_up.map(|half| (0.0, half)),
        image_size_px: size,
    };
    let time_limit = args.matching.limit();
    let matcher = prepare::matcher(&args.matching, OwnWord::default(), Shared { chances: 1, part: 1 }, &time_limit)?;
    let match_started = Instant::now();
    let mut outcome = solve_candidates(&candidates, &list.gcps, matcher.as_ref(), &priors)?;
    diagnosis::examine(
        &mut outcome,
        &candidates,
        &list,
        &priors,
        None,
        (&args.matching, &time_limit),
        &args.gcps.working_crs.force,
    );
    diagnosis::labels(&args.candidates, &mut outcome, &list)?;
    let mut document = Document::new(&list, args.gcps.path()?, &outcome, candidates);
    document.result.options = serde_json::json!({"priors": priors, "max_false_alarms": args.matching.max_false_alarms});
    document.result.timings.match_s = match_started.elapsed().as_secs_f64();
    let place = ImagePlace { size_px: size, georeferences: Vec::new() };
    let dem = args.solving.apply(&mut document.result, &outcome, &list, &place)?;
    let seen = document.result.extent_px();
    accuracy::state(&mut document.result, &list, &args.gcps.accuracy, seen);
    working_crs::deliver(&mut document.result, &list, size)?;
    if let Some(dem) = dem {
        let mut transaction = autoref_raster::atomic::Transaction::new();
        dem.stage(&document.result, &mut transaction)?;
        document.result.files_written.extend(transaction.paths().iter().map(|path| path.display().to_string()));
        transaction.commit()?;
    }
    document.finish(started);
    if let Some(output) = &args.output {
        document.result.files_written.push(output.display().to_string());
        crate::out::write_text(output, document.result.to_json().as_bytes(), Existing::of_flag(args.overwrite))?;
    }
    run::print(&document.result, run::Printing { json: args.json, quiet: args.quiet });
    Ok(document.exit_code())
}
