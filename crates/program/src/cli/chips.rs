//! `autoref-stream chips`: a small picture around every mark, and all of them on one contact sheet.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use autoref_raster::atomic::{self, Existing, Transaction};
use autoref_raster::coords::PixelPoint;
use autoref_raster::output_folder::OutputFolder;
use autoref_raster::words::some_of;
use autoref_raster::{FewBits, Patch, RasterSource, SampleType};
use autoref_stream::report::Stretch;

use super::positions::{Mark, PositionArgs, patch_around};
use crate::cli::args::SampleArgs;

/// Cut a window around every mark and write the windows and a contact sheet as PNG.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The image.
    image: PathBuf,
    #[command(flatten)]
    positions: PositionArgs,
    /// Side of a window, pixels; the 2016 prototype used 201.
    #[arg(long, value_name = "PX", default_value_t = 201)]
    side_px: u64,
    /// Directory to write to; made when absent.
    #[arg(short, long, value_name = "DIR", default_value = "chips")]
    output: PathBuf,
    /// Replace existing pictures.
    #[arg(long)]
    overwrite: bool,
    /// Print what was done as one JSON document on standard output.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    samples: SampleArgs,
}

pub fn run(args: &Args) -> Result<()> {
    if !(3..=2001).contains(&args.side_px) {
        bail!("--side-px {} is not between 3 and 2001", args.side_px);
    }
    let source = args.samples.open(&args.image, 64 << 20)?;
    let found = args.positions.positions(source.info())?;
    if !found.outside.is_empty() {
        eprintln!("outside the image: {}", found.outside.join(", "));
    }
    let marks = &found.marks;
    let sheet_path = args.output.join(format!("{SHEET}.png"));
    let names = file_names(marks);
    let paths: Vec<PathBuf> = names.iter().map(|name| args.output.join(format!("{name}.png"))).collect();
    let numbered = marks.iter().zip(&names).filter(|(mark, name)| plain(&mark.name) != **name);
    let numbered: Vec<String> = numbered.map(|(mark, name)| format!("{} is in {name}.png", mark.name)).collect();
    if !numbered.is_empty() {
        eprintln!("names that make no file name of their own: {}", some_of(&numbered));
    }
    let _folder = OutputFolder::make(&args.output)?;
    let outputs: Vec<&Path> = paths.iter().chain([&sheet_path]).map(PathBuf::as_path).collect();
    atomic::check_outputs(&outputs, Existing::of_flag(args.overwrite))?;
    let side = args.side_px as usize;
    let columns = (marks.len() as f64).sqrt().ceil() as usize;
    let rows = marks.len().div_ceil(columns);
    // One pixel of black between the windows.
    let pitch = side + 1;
    let (width, height) = (columns * pitch - 1, rows * pitch - 1);
    if width * height > 200_000_000 {
        bail!("a contact sheet of {} windows of {side} pixels is too large; give a smaller --side-px", marks.len());
    }
    let stretch = if args.samples.names_white() { None } else { stretch(source.as_ref(), marks, args.side_px / 2)? };
    let mut files = Transaction::new();
    let mut sheet = vec![0u8; width * height * 3];
    for (i, (mark, path)) in marks.iter().zip(&paths).enumerate() {
        let patch = patch_around(source.as_ref(), mark.at, args.side_px / 2)?;
        let chip = centred(&patch, mark.at, side, stretch);
        files.stage_bytes(path, &png(&chip, side, side)?)?;
        let (x0, y0) = (i % columns * pitch, i / columns * pitch);
        for y in 0..side {
            let to = ((y0 + y) * width + x0) * 3;
            sheet[to..to + side * 3].copy_from_slice(&chip[y * side * 3..(y + 1) * side * 3]);
        }
    }
    files.stage_bytes(&sheet_path, &png(&sheet, width, height)?)?;
    files.commit()?;
    if args.json {
        let files: Vec<String> = paths.iter().chain([&sheet_path]).map(|path| path.display().to_string()).collect();
        let marks: Vec<serde_json::Value> = marks.iter().zip(&files).map(|(mark, file)| of_json(mark, file)).collect();
        let said = serde_json::json!({"files_written": files, "marks": marks, "outside": found.outside});
        println!("{}", serde_json::to_string_pretty(&said)?);
    }
    Ok(())
}

fn of_json(mark: &Mark, file: &str) -> serde_json::Value {
    serde_json::json!({"name": mark.name, "file": file, "x": mark.at.x, "y": mark.at.y})
}

/// The contact sheet, without its ending.
const SHEET: &str = "contact";

/// A name that is safe in a path.
fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

/// A file's name for every mark, without its ending: no two alike, capitals or not, nor that of the sheet, and none
/// longer than a file system takes.
fn file_names(marks: &[Mark]) -> Vec<String> {
    /// Of the 255 that most take, the rest is for a number, the ending and what a file is called until it is whole.
    const MOST_BYTES: usize = 150;
    let mut taken = BTreeSet::from([SHEET.to_string()]);
    let mut free = |name: &String| taken.insert(name.to_lowercase());
    let one = |mark: &Mark| {
        let mut name = plain(&mark.name);
        let end = (0..=name.len().min(MOST_BYTES)).rev().find(|end| name.is_char_boundary(*end));
        name.truncate(end.unwrap_or_default());
        let numbered = (2..).map(|number| format!("{name}-{number}"));
        std::iter::once(name.clone()).chain(numbered).find(&mut free).unwrap_or_default()
    };
    marks.iter().map(one).collect()
}

/// What chips of more than 8 bits are drawn with where they use a small part of the range, as those of a report: from
/// the darkest to the brightest half per cent of what is seen. `None` where white is what the file says.
fn stretch(source: &dyn RasterSource, marks: &[Mark], reach_px: u64) -> Result<Option<Stretch>> {
    let info = source.info();
    if info.sample == SampleType::U8 {
        return Ok(None);
    }
    let mut counts = vec![0u64; usize::from(u16::MAX) + 1];
    for mark in marks {
        let patch = patch_around(source, mark.at, reach_px)?;
        let valid = patch.rgb.iter().zip(&patch.valid).filter(|(_, valid)| **valid);
        valid.flat_map(|(rgb, _)| rgb).for_each(|sample| counts[usize::from(*sample)] += 1);
    }
    let all: u64 = counts.iter().sum();
    let at = |share: f64| {
        let mut below = (all.saturating_sub(1) as f64 * share) as u64;
        let level = counts.iter().position(|count| {
            let here = below < *count;
            below = below.saturating_sub(*count);
            here
        });
        level.unwrap_or_default() as u16
    };
    let (low, high) = (at(0.005), at(0.995));
    let Some(few) = FewBits::of(at(1.0), info.white).filter(|_| low < high) else { return Ok(None) };
    eprintln!("{}: {few}; until then the windows are stretched to {low} to {high}", info.path.display());
    Ok(Some(Stretch { low: low.into(), high: high.into() }))
}

/// The patch with its mark in the middle of a square, black where the image ends.
fn centred(patch: &Patch, at: PixelPoint, side: usize, stretch: Option<Stretch>) -> Vec<u8> {
    let mut out = vec![0u8; side * side * 3];
    let (left, top) = (at.x as i64 - side as i64 / 2, at.y as i64 - side as i64 / 2);
    for (i, colour) in patch.rgb.iter().enumerate().filter(|(i, _)| patch.valid[*i]) {
        let x = patch.window.x as i64 + i as i64 % patch.window.width as i64 - left;
        let y = patch.window.y as i64 + i as i64 / patch.window.width as i64 - top;
        if (0..side as i64).contains(&x) && (0..side as i64).contains(&y) {
            let to = (y as usize * side + x as usize) * 3;
            for c in 0..3 {
                out[to + c] = match stretch {
                    Some(stretch) => stretch.to_byte(f64::from(colour[c])),
                    None => (u32::from(colour[c]) * 255 / u32::from(patch.white)).min(255) as u8,
                };
            }
        }
    }
    out
}

fn png(rgb: &[u8], width: usize, height: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    writer.finish()?;
    Ok(bytes)
}
