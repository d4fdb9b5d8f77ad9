//! `autoref-stream apply`: outputs from the result of an earlier run.

use std::path::{Path, PathBuf};

use anyhow::bail;
use autoref_raster as raster;
use autoref_raster::atomic::Transaction;
use autoref_raster::memory_plan;
use autoref_raster::path_text::quoted;
use autoref_stream::georef::transfer::{self, Edges};
use autoref_stream::result::RunResult;
use clap::Args;

use crate::cli::prepare::threads;
use crate::cli::progress::Telling;
use crate::cli::recorded_image::recorded_image;
use crate::cli::summary;
use crate::cli::values::Bytes;
use crate::cli::write::{WarpBar, WriteArgs};

/// Write outputs from the result of an earlier run, without looking for marks again.
#[derive(Args, Debug)]
pub struct ApplyArgs {
    /// The NAME.autoref.json of a run.
    pub result: PathBuf,
    /// The image, if it is no longer where the result says.
    pub image: Option<PathBuf>,
    /// Write for another raster of the same project instead, such as the elevation model.
    #[arg(long, value_name = "RASTER", conflicts_with = "image")]
    pub to: Option<PathBuf>,
    /// With --to: the outer edges of both rasters coincide.
    #[arg(long, requires = "to")]
    pub same_extent: bool,
    /// Image of a multi-page file, counted from 0. Default: the one that was solved.
    #[arg(long, value_name = "N", help_heading = "Reading")]
    pub page: Option<usize>,
    /// With --write exif: worst accuracy of the change of datum to WGS 84 that is accepted, metres by the authority's
    /// word. Default: 1.5.
    #[arg(long, value_name = "M", help_heading = "Output")]
    pub datum_accuracy: Option<f64>,
    /// Bound on the peak resident memory of the whole program: bytes, or with K, M or G.
    #[arg(long, value_name = "SIZE", default_value = "512M", help_heading = "Resources")]
    pub memory: Bytes,
    /// Number of threads that compress a warped copy. Default: one for each core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1024), help_heading = "Resources")]
    pub threads: Option<u64>,
    /// Print what was written as one JSON document on standard output.
    #[arg(long, help_heading = "Output")]
    pub json: bool,
    /// Print nothing but errors.
    #[arg(long, help_heading = "Messages")]
    pub quiet: bool,
    #[command(flatten)]
    pub write: WriteArgs,
}

pub fn run(args: &ApplyArgs) -> anyhow::Result<()> {
    autoref_raster::initialise_gdal(memory_plan::cache_share_bytes(args.memory.0));
    let result = RunResult::read(&args.result)?;
    if let Some(refused) = result.refused() {
        bail!("{}: there is no georeference to apply: {}", args.result.display(), refused.reason);
    }
    let reservation = summary::reservation(&result);
    let edges = if args.same_extent { Edges::Coincide } else { Edges::Unknown };
    let (image, result, page) = match &args.to {
        // From lists alone: whatever raster is named is the image.
        Some(other) if result.image.is_none() && !args.same_extent => (other.clone(), result, args.page.unwrap_or(0)),
        Some(other) => (other.clone(), transfer::carry(&result, other, edges)?, args.page.unwrap_or(0)),
        None => {
            let solved = result.options.get("page").and_then(serde_json::Value::as_u64).unwrap_or(0);
            let page = args.page.unwrap_or(solved as usize);
            (image_of(args, &result, page)?, result, page)
        }
    };
    let _folder = args.write.folder()?;
    let mut request = args.write.request(&image, page, args.memory.0, threads(args.threads))?;
    request.datum_accuracy_m = args.datum_accuracy.unwrap_or(request.datum_accuracy_m);
    // No place is needed to refuse what is no length.
    request.check_place(None, &[])?;
    let mut transaction = Transaction::new();
    let bar = WarpBar::new(&request, Telling::silent_if(args.quiet || args.json));
    let to_open = request.what_to_open(&request.found(&result)?)?;
    let staged = request.stage(&result, &mut transaction, &|done| bar.set(done))?;
    let warnings: Vec<String> = reservation.into_iter().chain(to_open).chain(staged).collect();
    drop(bar);
    let written: Vec<String> = transaction.paths().iter().map(|path| path.display().to_string()).collect();
    transaction.commit()?;
    if args.json {
        let document = serde_json::json!({
            "files_written": written,
            "warnings": warnings,
            "peak_memory_bytes": memory_plan::peak_resident_bytes(),
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else if !args.quiet {
        for warning in &warnings {
            println!("Note      {warning}");
        }
        println!("Written   {}", written.join(", "));
    }
    Ok(())
}

/// What is said where the image that a result names is not there.
fn missing(args: &ApplyArgs, image: &Path) -> Option<raster::Error> {
    (args.image.is_none() && !image.exists()).then(|| {
        raster::Error::usage(
            format!("{}: its image {} is not there", args.result.display(), image.display()),
            format!("name it: autoref-stream apply {} IMAGE", quoted(&args.result)),
        )
    })
}

/// The image that was solved, of the same size as then.
fn image_of(args: &ApplyArgs, result: &RunResult, page: usize) -> anyhow::Result<PathBuf> {
    let solved = result.image.as_ref();
    let recorded = || solved.map(|image| recorded_image(&args.result, image));
    let Some(image) = args.image.clone().or_else(recorded) else {
        bail!("{}: it names no image; give one: apply RESULT.json IMAGE", args.result.display());
    };
    if let Some(solved) = solved
        && let (width, height) = raster::size(&image, page).map_err(|error| missing(args, &image).unwrap_or(error))?
        && (width, height) != (solved.width, solved.height)
    {
        bail!(
            "{}: it has {width} × {height} pixels, the image that was solved {} × {}; for another raster of the same project \
             give --to",
            image.display(),
            solved.width,
            solved.height
        );
    }
    Ok(image)
}
