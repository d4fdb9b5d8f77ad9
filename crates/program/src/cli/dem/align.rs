//! `autoref-stream dem align`: one elevation model brought onto another.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::bail;
use autoref_elevation::align::{Alignment, Bend, BendTerm, Degree, Method, Outcome};
use autoref_elevation::files::{AlignJob, AlignedFiles};
use autoref_elevation::output;
use autoref_raster::atomic::Existing;
use clap::Args;
use serde::Serialize;
use serde_json::json;

use super::ResourceArgs;
use crate::cli::values::unsigned_zero;
use crate::out::{self, Stream};

#[derive(Args, Debug)]
pub struct AlignArgs {
    /// The model that is moved.
    a: PathBuf,
    /// The model that stays.
    #[arg(long, value_name = "B")]
    to: PathBuf,
    /// The moved model.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// auto, nuth-kaab, lzd, bias or tilt.
    #[arg(long, value_name = "METHOD", default_value = "auto")]
    method: Method,
    /// Highest degree of the surface that is taken out beside the shift: linear (a tilt), quadratic or cubic. `auto`
    /// takes what is there beyond chance, `tilt` all of it.
    #[arg(long, value_name = "DEGREE", default_value = "linear")]
    surface: Degree,
    /// Polygons of ground that has not changed. Default: found by robust weights.
    #[arg(long, value_name = "FILE")]
    stable: Option<PathBuf>,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
    /// Replace the output when it exists.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    resources: ResourceArgs,
}

/// Aligns, writes and prints.
///
/// # Errors
/// When a model cannot be read or the result not be written.
pub fn align(args: &AlignArgs) -> anyhow::Result<ExitCode> {
    output::check(&[&args.out], Existing::of_flag(args.overwrite))?;
    if !args.method.bends() && args.surface > Degree::Linear {
        bail!("--surface {}: --method {} fits no surface; use --method auto or tilt", args.surface, args.method);
    }
    let job = AlignJob {
        a: &args.a,
        b: &args.to,
        method: args.method,
        surface: args.surface,
        stable: args.stable.as_deref(),
        resources: args.resources.resources(),
        scratch: Some(args.out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))),
    };
    let found = job.run()?;
    let alignment = match &found.outcome {
        Outcome::Refused(why) => {
            let why = format!("{} and {}: {why}", args.a.display(), args.to.display());
            if args.json {
                println!("{}", json!({ "status": "refused", "reason": why }));
            } else if out::is_mute(Stream::Output) {
                out::error_line(&format!("autoref-stream: not aligned: {}", crate::printable(&why)));
            } else {
                println!("Not aligned: {why}");
            }
            return Ok(ExitCode::from(1));
        }
        Outcome::Aligned(alignment) => alignment,
    };
    found.write(alignment, &args.out)?;
    if args.json {
        let document = AlignmentDocument::of(args, alignment, &found);
        println!("{}", serde_json::to_string_pretty(&document)?);
        return Ok(ExitCode::SUCCESS);
    }
    let [e, n, h] = alignment.shift_m.map(|v| unsigned_zero(v, 4));
    let error = |i: usize| alignment.covariance_m2[(i, i)].max(0.0).sqrt();
    println!(
        "Shift applied to A   east {e:.4} ± {:.4} m, north {n:.4} ± {:.4} m, height {h:.4} ± {:.4} m",
        error(0),
        error(1),
        error(2)
    );
    if let Some(tilt) = &alignment.tilt {
        println!(
            "Tilt applied to A    east {:.5} ± {:.5} mm/m, north {:.5} ± {:.5} mm/m",
            unsigned_zero(1e3 * tilt.east, 5),
            1e3 * tilt.east_se,
            unsigned_zero(1e3 * tilt.north, 5),
            1e3 * tilt.north_se
        );
    }
    if let Some(bend) = &alignment.bend {
        let largest = bend.terms.iter().map(|term| term.metres.abs()).fold(0.0, f64::max);
        println!("Bend applied to A    {}, terms up to {largest:.3} m (--json lists them)", bend.degree);
    }
    if found.couple.heights.lifted() {
        println!("Heights              {}", found.couple.heights);
    }
    println!("NMAD of A − B        {:.4} m before, {:.4} m after", alignment.nmad_before_m, alignment.nmad_after_m);
    for warning in warnings(args, alignment, &found) {
        println!("Warning              {warning}");
    }
    println!("Stable ground        {:.1} % of {} common cells", 100.0 * alignment.stable_share, alignment.common_cells);
    println!("Written              {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}

/// What a person should look at.
fn warnings(args: &AlignArgs, found: &Alignment, files: &AlignedFiles) -> Vec<String> {
    /// The differences may spread no more than before.
    const NOTABLY: f64 = 1.05;
    let spread = (found.nmad_after_m > NOTABLY * found.nmad_before_m + 1e-3).then(|| {
        "the differences spread more than before: look at the models for spikes, and compare them before and after \
         (dem compare)"
            .to_string()
    });
    // Of so many cells, a mean that is hardly better known than one of them is that of two kinds of ground.
    const MANY: u64 = 1000;
    let height_se_m = found.covariance_m2[(2, 2)].max(0.0).sqrt();
    let unsure = found.common_cells >= MANY && height_se_m > found.nmad_after_m / 2.0;
    let unsure = (unsure && height_se_m > 1e-3).then(|| {
        format!(
            "the height is known to {height_se_m:.2} m only, though {} cells spread by {:.2} m: much of the ground has \
             changed, or errs together; keep to what is stable (--stable)",
            found.common_cells, found.nmad_after_m
        )
    });
    let zeros = found.zeros.notes(found.common_cells, &args.a, &args.to);
    spread
        .into_iter()
        .chain(unsure)
        .chain(files.couple.doubtful_units.clone())
        .chain(zeros)
        .chain(files.notes.clone())
        .collect()
}

/// The degree of what is taken out beside the shift.
fn surface(found: &Alignment) -> &'static str {
    match (&found.bend, &found.tilt) {
        (Some(bend), _) => bend.degree.name(),
        (None, Some(_)) => Degree::Linear.name(),
        (None, None) => Degree::Level.name(),
    }
}

/// What was found, as `--json` prints it. A number that is not finite is written as `null`.
#[derive(Debug, Serialize)]
struct AlignmentDocument {
    status: &'static str,
    method: &'static str,
    /// What A is moved by.
    shift_e_m: f64,
    shift_n_m: f64,
    shift_h_m: f64,
    shift_x_px: f64,
    shift_y_px: f64,
    /// Of east, north and height.
    covariance_m2: [[f64; 3]; 3],
    shift_e_se_m: f64,
    shift_n_se_m: f64,
    shift_h_se_m: f64,
    tilted: bool,
    tilt_e_mm_per_m: f64,
    tilt_n_mm_per_m: f64,
    /// `None` without a tilt.
    tilt_e_se_mm_per_m: Option<f64>,
    tilt_n_se_mm_per_m: Option<f64>,
    surface: &'static str,
    bend: Option<BendRecord>,
    /// East and north where the shift in height counts.
    height_counts_at: (f64, f64),
    nmad_before_m: f64,
    nmad_after_m: f64,
    median_before_m: f64,
    median_after_m: f64,
    stable_share: f64,
    common_cells: u64,
    iterations: u32,
    warnings: Vec<String>,
    resampled: bool,
    heights: String,
    output: String,
}

/// The terms above the tilt, each metres · u^east · v^north; u and v are one at half the extent.
#[derive(Debug, Serialize)]
struct BendRecord {
    half_e_m: f64,
    half_n_m: f64,
    terms: Vec<TermRecord>,
}

#[derive(Debug, Serialize)]
struct TermRecord {
    east: usize,
    north: usize,
    m: f64,
    se_m: f64,
}

impl BendRecord {
    fn of(bend: &Bend) -> Self {
        let term = |t: &BendTerm| TermRecord { east: t.east, north: t.north, m: t.metres, se_m: t.se_m };
        let (half_e_m, half_n_m) = bend.half_m;
        BendRecord { half_e_m, half_n_m, terms: bend.terms.iter().map(term).collect() }
    }
}

impl AlignmentDocument {
    fn of(args: &AlignArgs, found: &Alignment, files: &AlignedFiles) -> Self {
        let couple = &files.couple;
        let grid = autoref_elevation::source::Heights::grid(&couple.a);
        let [shift_e_m, shift_n_m, shift_h_m] = found.shift_m;
        let [shift_e_se_m, shift_n_se_m, shift_h_se_m] = [0, 1, 2].map(|i| found.covariance_m2[(i, i)].max(0.0).sqrt());
        let tilt = found.tilt.as_ref();
        AlignmentDocument {
            status: "aligned",
            method: args.method.name(),
            shift_e_m,
            shift_n_m,
            shift_h_m,
            shift_x_px: found.shift.0 / grid.step_x,
            shift_y_px: found.shift.1 / grid.step_y + 0.0,
            covariance_m2: std::array::from_fn(|i| std::array::from_fn(|j| found.covariance_m2[(i, j)])),
            shift_e_se_m,
            shift_n_se_m,
            shift_h_se_m,
            tilted: tilt.is_some(),
            tilt_e_mm_per_m: tilt.map_or(0.0, |t| 1e3 * t.east),
            tilt_n_mm_per_m: tilt.map_or(0.0, |t| 1e3 * t.north),
            tilt_e_se_mm_per_m: tilt.map(|t| 1e3 * t.east_se),
            tilt_n_se_mm_per_m: tilt.map(|t| 1e3 * t.north_se),
            surface: surface(found),
            bend: found.bend.as_ref().map(BendRecord::of),
            height_counts_at: found.centre,
            nmad_before_m: found.nmad_before_m,
            nmad_after_m: found.nmad_after_m,
            median_before_m: found.median_before_m,
            median_after_m: found.median_after_m,
            stable_share: found.stable_share,
            common_cells: found.common_cells,
            iterations: found.iterations,
            warnings: warnings(args, found, files),
            resampled: couple.projected,
            heights: couple.heights.to_string(),
            output: args.out.display().to_string(),
        }
    }
}
