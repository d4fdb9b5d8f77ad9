//! `autoref-stream detect`: the candidates of an image as a list.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use autoref_raster::Error;
use autoref_raster::atomic::Existing;
use autoref_stream::georef::candidate_list;
use autoref_stream::pipeline::scan;
use clap::Args;

use crate::cli::args::{MarkArgs, PaintArg, ReadArgs};
use crate::cli::prepare;
use crate::cli::progress::{Bar, Telling};
use crate::cli::values::Gsd;
use autoref_raster::words::counted;

/// Find the marks in an image and write the candidates as CSV or GeoJSON.
#[derive(Args, Debug)]
pub struct DetectArgs {
    /// The image: any raster that GDAL opens.
    pub image: PathBuf,
    /// Where the list goes: .csv or .geojson; "-" is standard output as CSV.
    #[arg(short, long, value_name = "FILE", default_value = "-")]
    pub output: PathBuf,
    /// Replace an existing list.
    #[arg(long)]
    pub overwrite: bool,
    /// Print candidates and counts as one JSON document on standard output; then `-o -` writes no CSV.
    #[arg(long)]
    pub json: bool,
    /// No progress bar, no summary.
    #[arg(long)]
    pub quiet: bool,
    /// Ground size of a pixel in metres, for profiles that give mark sizes in metres.
    #[arg(long, value_name = "M", allow_negative_numbers = true, help_heading = "Marks")]
    pub gsd: Option<Gsd>,
    #[command(flatten)]
    pub marks: MarkArgs,
    #[command(flatten)]
    pub paint: PaintArg,
    #[command(flatten)]
    pub read: ReadArgs,
}

/// Whether the list is GeoJSON, by its name.
///
/// # Errors
/// When the name ends in something else than the formats that are written.
fn is_geojson(output: &Path) -> anyhow::Result<bool> {
    // Standard output and devices have no end.
    let Some(end) = output.extension().map(|end| end.to_string_lossy().to_lowercase()) else { return Ok(false) };
    match end.as_str() {
        "geojson" | "json" => Ok(true),
        "csv" => Ok(false),
        _ => {
            let what = format!("the name {} does not say which format to write", output.display());
            Err(Error::usage(what, "end it with .csv or .geojson").into())
        }
    }
}

pub fn run(args: &DetectArgs) -> anyhow::Result<ExitCode> {
    let geojson = is_geojson(&args.output)?;
    if args.output.as_os_str() != "-" {
        autoref_raster::atomic::check_outputs(&[&args.output], Existing::of_flag(args.overwrite))?;
    }
    let prepared = prepare::open(&args.image, &args.read, &args.paint.of(&args.marks), args.gsd)?;
    let bar = Bar::new(prepared.source.info(), Telling::silent_if(args.quiet || args.json));
    let found = scan(prepared.source.as_ref(), &prepared.plan, prepared.detector.as_detector(), &bar)?;
    bar.finish();
    let mut text = Vec::new();
    if geojson {
        candidate_list::write_geojson(&found.candidates, &mut text)?;
    } else {
        candidate_list::write_csv(&found.candidates, &mut text)?;
    }
    let to_stdout = args.output.as_os_str() == "-";
    if !(args.json && to_stdout) {
        crate::out::write_text(&args.output, &text, Existing::of_flag(args.overwrite))?;
    }
    if args.json {
        let info = prepared.source.info();
        let candidates: Vec<serde_json::Value> = found
            .candidates
            .iter()
            .map(|candidate| {
                let mut value = serde_json::to_value(candidate)?;
                value["probability"] = serde_json::json!(candidate.probability());
                Ok(value)
            })
            .collect::<Result<_, serde_json::Error>>()?;
        let document = serde_json::json!({
            "image": info.path.display().to_string(),
            "width": info.width,
            "height": info.height,
            "files_written": if to_stdout { Vec::new() } else { vec![args.output.display().to_string()] },
            "regions_examined": found.regions_examined,
            "timings": found.timings,
            "candidates": candidates,
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else if !args.quiet {
        eprintln!(
            "{} of {} examined, in {:.2} s",
            counted(found.candidates.len(), "candidate", "candidates"),
            counted(found.regions_examined, "region", "regions"),
            found.timings.scan_s + found.timings.examine_s
        );
    }
    Ok(ExitCode::SUCCESS)
}
