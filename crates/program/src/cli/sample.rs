//! `autoref-stream sample`: learn a profile from marks that somebody points at or outlines, or from a table of colours.

mod outlines;
mod page;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use autoref_raster::atomic::{self, Existing, Transaction};
use autoref_raster::coords::PixelPoint;
use autoref_raster::ranks::median;
use autoref_raster::words::{counted, some_of};
use autoref_raster::{Patch, RasterSource, ReaderChoice};
use autoref_stream::learn::{
    ColourTable, DEFAULT_REACH_PX, LIKE_THE_OTHERS, LearnOptions, Lesson, RoughRule, SampleStatistics,
    apart_from_paint, learn, learn_colours, learn_outlined, learn_with, read_colours,
};
use autoref_stream::profile::Profile;
use autoref_stream::profile::colour::lab_from_srgb;

use super::positions::{Mark, PositionArgs, patch_around};
use crate::cli::args::SampleArgs;
use crate::cli::values::MarkSize;

/// Learn a mark profile from marks in an image, or from a table of colours, and write it as TOML.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The image; none with --colours.
    image: Option<PathBuf>,
    #[command(flatten)]
    positions: PositionArgs,
    /// The marks are the groups of pixels that are not 0 in this raster of the image's size.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["at", "result", "gcps", "polygons", "colours"])]
    mask: Option<PathBuf>,
    /// The marks are the polygons of this file (GeoJSON, GeoPackage, Shapefile): on the map where the image is
    /// georeferenced, else in pixels.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["at", "result", "gcps", "colours"])]
    polygons: Option<PathBuf>,
    /// Learn from this table of colours instead of an image: red, green, blue of 0 to 1 or 0 to 255, or #RRGGBB, a row
    /// each.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["at", "result", "gcps", "image"])]
    colours: Option<PathBuf>,
    /// With --colours: side or diameter of the marks, in pixels (10..14) or metres (0.3m..0.5m).
    #[arg(long, value_name = "SIZE", default_value = "5..60", requires = "colours")]
    mark_size: MarkSize,
    /// How far around a mark to look, pixels; at least the mark's own size.
    #[arg(long, value_name = "PX", default_value_t = DEFAULT_REACH_PX)]
    reach_px: u64,
    /// Name of the new profile.
    #[arg(long, default_value = "taught")]
    name: String,
    /// Also learn a box in RGB that paint must be in first: the middle share of the marks' values in each band (0.75; 1
    /// is smallest to largest), or so many standard deviations about their mean (1.5sd).
    #[arg(long, value_name = "SHARE|Ksd", value_parser = parse_rough)]
    rough_box: Option<RoughRule>,
    /// Also learn kernel densities of L*, a*, b*, and drop candidates that are improbable by them.
    #[arg(long)]
    density: bool,
    /// Where to write the profile; standard output when absent.
    #[arg(short, long, value_name = "TOML")]
    output: Option<PathBuf>,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Write a page with the colours' statistics, histograms and scatter plots, in RGB and L*a*b*.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Print the profile as one JSON document on standard output, instead of TOML when no file is named.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    samples: SampleArgs,
}

/// "0.75" or "1.5sd", or three of a kind.
fn parse_rough(text: &str) -> Result<RoughRule, String> {
    let wrong = || {
        format!(
            "\"{text}\" is neither a share above 0 and at most 1 nor a number of standard deviations (1.5sd), nor three of either"
        )
    };
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    let in_deviations = parts.iter().all(|part| part.ends_with("sd"));
    let number = |part: &&str| {
        let digits = if in_deviations { part.trim_end_matches("sd").trim() } else { part };
        digits.parse::<f64>().ok().filter(|v| *v > 0.0 && *v <= if in_deviations { f64::MAX } else { 1.0 })
    };
    let values: Vec<f64> = parts.iter().map(number).collect::<Option<_>>().ok_or_else(wrong)?;
    let bands = match values.as_slice() {
        [all] => [*all; 3],
        [red, green, blue] => [*red, *green, *blue],
        _ => return Err(wrong()),
    };
    Ok(if in_deviations { RoughRule::Sigma(bands) } else { RoughRule::Middle(bands) })
}

/// A listed mark that nothing is learned from.
#[derive(Debug, serde::Serialize)]
struct LeftOut {
    name: String,
    reason: String,
}

/// What was learned, and what nothing was learned from.
struct Learnt {
    lesson: Lesson,
    outside: Vec<String>,
    left_out: Vec<LeftOut>,
    /// Of a table of colours: what its values were taken for.
    values: Option<String>,
}

impl From<Lesson> for Learnt {
    fn from(lesson: Lesson) -> Self {
        Learnt { lesson, outside: Vec::new(), left_out: Vec::new(), values: None }
    }
}

pub fn run(args: &Args) -> Result<()> {
    let outputs: Vec<&Path> = [&args.output, &args.html].into_iter().flatten().map(PathBuf::as_path).collect();
    atomic::check_outputs(&outputs, Existing::of_flag(args.overwrite))?;
    let learnt = args.learn()?;
    let statistics = SampleStatistics::new(&learnt.lesson.paint);
    report(&learnt, statistics.as_ref());
    let Learnt { lesson, outside, left_out, values } = learnt;
    let toml = lesson.profile.to_toml();
    let mut transaction = Transaction::new();
    if let Some(path) = &args.output {
        transaction.stage_bytes(path, toml.as_bytes())?;
    }
    if let Some(path) = &args.html {
        let page = page::page(&lesson, statistics.as_ref());
        transaction.stage_bytes(path, page.as_bytes())?;
    }
    let files: Vec<String> = transaction.paths().iter().map(|path| path.display().to_string()).collect();
    transaction.commit()?;
    if args.output.is_none() && !args.json {
        crate::out::product(&toml);
    }
    if args.json {
        let document = serde_json::json!({
            "files_written": files,
            "profile": lesson.profile,
            "statistics": statistics,
            "outside": outside,
            "left_out": left_out,
            "values": values,
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    }
    Ok(())
}

impl Args {
    fn learn(&self) -> Result<Learnt> {
        let options = LearnOptions { rough_box: self.rough_box, density: self.density };
        if let Some(path) = &self.colours {
            return self.of_colours(path, read_colours(path)?, &options).with_context(|| path.display().to_string());
        }
        let image = self.image.as_deref().context("no image: name one, or give --colours FILE")?;
        let source = self.samples.open(image, 64 << 20)?;
        let outlined = match (&self.mask, &self.polygons) {
            (Some(path), _) => {
                let mask = autoref_raster::open(path, ReaderChoice::Auto, 0, 16 << 20)?;
                Some((path, outlines::of_mask(source.as_ref(), mask.as_ref())?))
            }
            (None, Some(path)) => Some((path, outlines::of_polygons(source.as_ref(), path)?)),
            (None, None) => None,
        };
        match outlined {
            Some((path, marks)) => {
                let lesson = learn_outlined(&self.name, &marks, &options);
                Ok(lesson.with_context(|| path.display().to_string())?.into())
            }
            None => self.pointed(image, source.as_ref(), &options),
        }
    }

    /// From a table, but for its rows that are not the paint.
    fn of_colours(&self, path: &Path, table: ColourTable, options: &LearnOptions) -> Result<Learnt> {
        let ColourTable { colours, rows, values, note } = table;
        if let Some(note) = note {
            tracing::warn!("{}: taken for {values}, but {note}", path.display());
        }
        let (mut kept, mut left_out) = (Vec::new(), Vec::new());
        for ((colour, row), apart) in colours.iter().zip(rows).zip(apart_from_paint(&colours)?) {
            if apart {
                let reason = format!("is more than {LIKE_THE_OTHERS} units of a*b* from the other colours");
                left_out.push(LeftOut { name: format!("row {row}"), reason });
            } else {
                kept.push(*colour);
            }
        }
        let lesson = learn_colours(&self.name, kept, self.mark_size.of_profile(), options)?;
        Ok(Learnt { left_out, values: Some(values.to_string()), ..lesson.into() })
    }

    /// From marks at positions.
    fn pointed(&self, image: &Path, source: &dyn RasterSource, options: &LearnOptions) -> Result<Learnt> {
        let found = self.positions.positions(source.info())?;
        let reach_px = self.reach_px.clamp(8, 2048);
        let marks = found
            .marks
            .into_iter()
            .map(|mark| Ok((patch_around(source, mark.at, reach_px)?, mark)))
            .collect::<Result<Vec<_>>>()?;
        let (marks, left_out) = sift(marks);
        if marks.is_empty() {
            bail!(
                "{}: no point of the list can be learned from; {}: {}",
                image.display(),
                left_out[0].name,
                left_out[0].reason
            );
        }
        let lesson = learn_with(&self.name, &marks, options)?;
        Ok(Learnt { left_out, outside: found.outside, ..lesson.into() })
    }
}

/// Largest ratio of a listed mark's side and the median of all marks: of what runs on into a roof of its colour, the
/// roof is no paint.
const SIZE_LIKE_THE_OTHERS: f64 = 2.0;

/// Leaves out listed marks that do not stand out, or have another colour or size than most: nobody saw them. What was
/// pointed at stays, and fails loudly.
fn sift(marks: Vec<(Patch, Mark)>) -> (Vec<(Patch, PixelPoint)>, Vec<LeftOut>) {
    let mut left_out = Vec::new();
    let mut kept = Vec::new();
    for (patch, mark) in marks {
        let alone = learn("alone", &[(patch.clone(), mark.at)]);
        let colour = match &alone {
            Ok(profile) => profile.learned.as_ref().map(|l| (lab_from_srgb(l.mean_srgb), l.side_px_median)),
            Err(error) if mark.listed => {
                let reason = error.to_string();
                left_out.push(LeftOut { name: mark.name, reason });
                continue;
            }
            Err(_) => None,
        };
        kept.push((patch, mark, colour));
    }
    let middle = |axis: usize| median(kept.iter().filter_map(|(_, _, c)| c.map(|(c, _)| c[axis])).collect());
    // Of two marks neither is the odd one.
    if kept.iter().filter(|(_, _, c)| c.is_some()).count() >= 3 {
        let (a, b) = (middle(1), middle(2));
        let side = median(kept.iter().filter_map(|(_, _, c)| c.map(|(_, side)| side)).collect());
        kept.retain(|(_, mark, colour)| {
            let Some((colour, own)) = colour.filter(|_| mark.listed) else { return true };
            let off = (colour[1] - a).hypot(colour[2] - b);
            let reason = if off > LIKE_THE_OTHERS {
                format!("the colour there is {off:.0} units of a*b* from that of the other marks")
            } else if own > SIZE_LIKE_THE_OTHERS * side || own * SIZE_LIKE_THE_OTHERS < side {
                format!("what lies there is {own:.0} px wide, the other marks {side:.0} px")
            } else {
                return true;
            };
            left_out.push(LeftOut { name: mark.name.clone(), reason });
            false
        });
    }
    (kept.into_iter().map(|(patch, mark, _)| (patch, mark.at)).collect(), left_out)
}

fn report(learnt: &Learnt, statistics: Option<&SampleStatistics>) {
    let Learnt { lesson, outside, left_out, values } = learnt;
    if !outside.is_empty() {
        eprintln!("outside the image: {}", outside.join(", "));
    }
    match values {
        None => left_out.iter().for_each(|mark| eprintln!("{} is left out: {}", mark.name, mark.reason)),
        Some(values) => {
            eprintln!("values taken for {values}");
            if let Some(first) = left_out.first() {
                let names: Vec<&str> = left_out.iter().map(|row| row.name.as_str()).collect();
                let rows = counted(names.len(), "row is", "rows are");
                tracing::warn!("{rows} left out, as each {}: {}", first.reason, some_of(&names));
            }
        }
    }
    if let Some(s) = statistics {
        let figures = |v: [f64; 3], digits: usize| v.map(|v| format!("{v:.digits$}")).join(" ");
        let deviation = |c: &[[f64; 3]; 3]| std::array::from_fn(|i| c[i][i].sqrt());
        let (rgb, lab) = (&s.rgb, &s.lab);
        eprintln!("{} colours; RGB {} ± {}", s.samples, figures(rgb.mean, 3), figures(deviation(&rgb.covariance), 3));
        eprintln!("L*a*b* {} ± {}", figures(lab.mean, 1), figures(deviation(&lab.covariance), 1));
    }
    let profile: &Profile = &lesson.profile;
    let Some(l) = &profile.learned else { return };
    let [r, g, b] = l.mean_srgb.map(|v| (v * 255.0).round());
    eprintln!("{} marks, {} pixels of paint, mean colour {r} {g} {b}", l.marks, l.pixels);
    eprintln!("side {:.1} to {:.1} px, median {:.1}", l.side_px_min, l.side_px_max, l.side_px_median);
    /// Flat paint on even ground scores above 0, marks with some texture little below.
    const UNLIKE_PAINT: f64 = -15.0;
    if profile.examine.min_score < UNLIKE_PAINT {
        tracing::warn!(
            "what was pointed at is little like flat paint of one colour (marks count from a score of {:.0} on): centres may \
             be off by more than they state; crosses and checkers in black and white have profiles of their own \
             (--profile black-white-cross)",
            profile.examine.min_score
        );
    }
    eprintln!(
        "colour limit {:.2}; the nearest 1 % of the ground beside the marks is within {:.2}, {:.2} % of it would be taken for paint",
        profile.colour.limit,
        l.background_distance_p01,
        100.0 * l.background_share
    );
}
