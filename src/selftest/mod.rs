//! What to expect of the detector on this image, before anybody trusts it: marks of known sub-pixel centres are planted
//! into the image as it is read (the file is not touched), the real scan is run over it, and what it finds is compared.
//!
//! Marks are painted as in the detection benchmark (`docs/benchmark-detection.md`): fading, blur, any rotation, mixed
//! with the ground that is there, and JPEG.

mod planted;
mod tally;

pub use planted::{PlantedMark, PlantedSource, chip_bytes};
pub use tally::{Tally, poisson_95, reach_px};

use std::sync::Arc;

use serde::Serialize;

use crate::candidate::Candidate;
use crate::detector::Detector;
use crate::matching::field::Field;
use crate::pipeline::{Progress, scan};
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::memory_plan::ScanPlan;
use autoref_raster::{RasterInfo, RasterSource, SampleType};
use autoref_synth::plant::Cell;

/// The share of marks that a size must reach to be advised.
pub const WANTED_RECALL: f64 = 0.99;
/// Rounds over the image for the sake of more marks: this many, or until so many pixels were scanned.
const MOST_ROUNDS: usize = 6;
const SMALL_IMAGES_PX: u64 = 100_000_000;
/// False finds that are listed.
const MOST_LISTED: usize = 100;

/// What is tried.
#[derive(Clone, Debug)]
pub struct SelftestOptions {
    /// Sides or diameters, pixels.
    pub sizes_px: Vec<f64>,
    pub marks_per_size: usize,
    /// Everything but the side.
    pub conditions: Cell,
    pub seed: u64,
    /// What the chips of one round may take.
    pub chip_budget_bytes: u64,
}

/// What came of one size.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SizeRow {
    pub side_px: f64,
    pub marks: usize,
    pub found: usize,
    pub recall: f64,
    /// Of as many marks as these are worth, seeing how recall differs over the ground.
    pub recall_95: (f64, f64),
    /// How many of these marks tell as much as one on ground of its own.
    pub design_effect: f64,
    /// Mean error of x and y, pixels.
    pub bias_px: [f64; 2],
    /// Per axis, pixels; null when nothing was found.
    pub rmse_px: Option<f64>,
    pub median_px: Option<f64>,
    /// Root mean square of error over stated standard deviation.
    pub normalised: Option<f64>,
    /// What the figures were made of.
    #[serde(skip)]
    pub tally: Tally,
}

/// The smallest size that does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SizeAdvice {
    pub side_px: f64,
    pub recall: f64,
    /// Even the lower end of the 95 % interval reaches the wanted recall.
    pub sure: bool,
}

/// What to expect on this image.
#[derive(Clone, Debug, Serialize)]
pub struct Selftest {
    pub rows: Vec<SizeRow>,
    pub megapixels: f64,
    /// Without the surroundings of the planted marks: where false finds are counted.
    pub clear_megapixels: f64,
    /// Candidates away from all planted marks. Real marks in the image are among them.
    pub false_finds: usize,
    pub false_per_megapixel: f64,
    pub false_per_megapixel_95: (f64, f64),
    /// The best-scored of them.
    pub false_list: Vec<Candidate>,
    pub advice: Option<SizeAdvice>,
    /// Fewer marks than asked for found room.
    pub marks_missing: usize,
    /// How bright the paint was made, over full white: as the image's own brightest, where it has more than 8 bits.
    pub exposure: f64,
    pub rounds: usize,
}

/// Plants, scans, compares. `plan` is asked for a memory plan once the marks of a round are in memory.
///
/// # Errors
/// When the image cannot be read or no plan fits the memory.
pub fn selftest(
    source: &Arc<dyn RasterSource>,
    detector: &dyn Detector,
    plan: &dyn Fn(&RasterInfo) -> Result<ScanPlan>,
    options: &SelftestOptions,
    progress: &dyn Progress,
) -> Result<Selftest> {
    let exposure = exposure(source.as_ref())?;
    let dimmed = |paint: [u8; 3]| paint.map(|v| (f64::from(v) * exposure).round() as u8);
    let conditions = Cell {
        paint: dimmed(options.conditions.paint),
        second: dimmed(options.conditions.second),
        noise: options.conditions.noise * exposure,
        ..options.conditions.clone()
    };
    let cells: Vec<Cell> = options.sizes_px.iter().map(|&side_px| Cell { side_px, ..conditions.clone() }).collect();
    let mut tallies = vec![Tally::default(); cells.len()];
    let mut false_finds: Vec<Candidate> = Vec::new();
    let mut clear_megapixels = 0.0;
    let mut rounds = 0;
    let most_rounds = MOST_ROUNDS.max((SMALL_IMAGES_PX / source.info().pixels().max(1)).min(100) as usize);
    while rounds < most_rounds {
        let left: Vec<usize> = tallies.iter().map(|t| options.marks_per_size.saturating_sub(t.marks)).collect();
        if left.iter().all(|&n| n == 0) && rounds > 0 {
            break;
        }
        let wanted = affordable(&cells, source.info().sample, &left, options.chip_budget_bytes);
        progress.stage(&format!("round {}: painting marks", rounds + 1));
        let planted = PlantedSource::plant(source.clone(), &cells, &wanted, options.seed + rounds as u64)?;
        if planted.marks.is_empty() && rounds > 0 {
            break;
        }
        progress.pass(&format!("round {}: reading", rounds + 1));
        let outcome = scan(&planted, &plan(source.info())?, detector, progress)?;
        let others = compare(&planted.marks, &cells, &outcome.candidates, &mut tallies);
        if rounds == 0 {
            // The others find the same again. What lies beside a mark is the mark, badly centred, or was made by its
            // JPEG.
            false_finds = others.into_iter().filter(|c| !planted.covers(c.centre)).collect();
            clear_megapixels = planted.clear_pixels() as f64 / 1e6;
        }
        rounds += 1;
    }
    let per_megapixel = |count: f64| if clear_megapixels > 0.0 { count / clear_megapixels } else { 0.0 };
    let count = false_finds.len();
    let (low, high) = poisson_95(count);
    false_finds.sort_by(|a, b| b.score.unwrap_or(f64::NEG_INFINITY).total_cmp(&a.score.unwrap_or(f64::NEG_INFINITY)));
    false_finds.truncate(MOST_LISTED);
    let rows: Vec<SizeRow> = cells.iter().zip(&tallies).map(|(cell, tally)| row(cell.side_px, tally)).collect();
    Ok(Selftest {
        advice: advice(&rows),
        marks_missing: tallies.iter().map(|t| options.marks_per_size.saturating_sub(t.marks)).sum(),
        rows,
        megapixels: source.info().pixels() as f64 / 1e6,
        clear_megapixels,
        false_finds: count,
        false_per_megapixel: per_megapixel(count as f64),
        false_per_megapixel_95: (per_megapixel(low), per_megapixel(high)),
        false_list: false_finds,
        exposure,
        rounds,
    })
}

/// What the brightest half per cent of the samples reach, over full white, in images of more than 8 bits: sensors
/// seldom use the whole range, and paint that is brighter than all else would be found too easily. 1 for 8 bits, which
/// are developed pictures.
fn exposure(source: &dyn RasterSource) -> Result<f64> {
    if source.info().sample == SampleType::U8 {
        return Ok(1.0);
    }
    let mut samples: Vec<u8> = crate::planning::paint::sample(source)?.into_iter().flatten().collect();
    samples.sort_unstable();
    let brightest = samples.get(samples.len() * 995 / 1000).copied().unwrap_or(255);
    Ok(f64::from(brightest.max(1)) / 255.0)
}

/// As many marks of every size as the budget for chips allows.
fn affordable(cells: &[Cell], sample: SampleType, wanted: &[usize], budget_bytes: u64) -> Vec<usize> {
    let cost: u64 = cells.iter().zip(wanted).map(|(cell, &n)| n as u64 * chip_bytes(cell, sample)).sum();
    let share = (budget_bytes as f64 / cost.max(1) as f64).min(1.0);
    wanted.iter().map(|&n| (n as f64 * share).ceil() as usize).collect()
}

/// Counts the marks; returns the candidates that are none.
fn compare(marks: &[PlantedMark], cells: &[Cell], candidates: &[Candidate], tallies: &mut [Tally]) -> Vec<Candidate> {
    let field = Field::new(candidates.iter().map(|c| c.centre).collect(), None);
    let mut used = vec![false; candidates.len()];
    for mark in marks {
        let reach = reach_px(cells[mark.cell].side_px);
        let nearest = field.nearest(PixelPoint { x: mark.x, y: mark.y }, reach);
        if let Some((i, _)) = nearest {
            used[i] = true;
        }
        tallies[mark.cell].count((0.0, 0.0), (mark.x, mark.y), nearest.map(|(i, _)| &candidates[i]));
    }
    candidates.iter().zip(used).filter(|(_, used)| !used).map(|(c, _)| c.clone()).collect()
}

fn row(side_px: f64, tally: &Tally) -> SizeRow {
    let some = |value: f64| (tally.found() > 0).then_some(value);
    SizeRow {
        side_px,
        marks: tally.marks,
        found: tally.found(),
        recall: tally.recall(),
        recall_95: tally.recall_95(),
        design_effect: tally.design_effect(),
        bias_px: tally.bias_px(),
        rmse_px: some(tally.rmse_px()),
        median_px: tally.median_px(),
        normalised: some(tally.normalised()).filter(|_| !tally.normalised.is_empty()),
        tally: tally.clone(),
    }
}

/// The smallest size that reaches the wanted recall and above which no size surely falls short of it.
fn advice(rows: &[SizeRow]) -> Option<SizeAdvice> {
    let mut sorted: Vec<&SizeRow> = rows.iter().filter(|row| row.marks > 0).collect();
    sorted.sort_by(|a, b| b.side_px.total_cmp(&a.side_px));
    sorted
        .into_iter()
        .take_while(|row| row.recall_95.1 >= WANTED_RECALL)
        .filter(|row| row.recall >= WANTED_RECALL)
        .last()
        .map(|row| SizeAdvice { side_px: row.side_px, recall: row.recall, sure: row.recall_95.0 >= WANTED_RECALL })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn made(side_px: f64, found: usize) -> SizeRow {
        row(side_px, &Tally { marks: 300, errors: vec![[0.1, 0.0]; found], ..Tally::default() })
    }

    #[test]
    fn advice_is_the_smallest_size_that_does() {
        let rows = [made(5.0, 250), made(6.0, 297), made(8.0, 300), made(10.0, 296), made(12.0, 300)];
        // 296 of 300 is below 99 %, but not surely.
        let best = advice(&rows).expect("6 px does");
        assert_eq!((best.side_px, best.sure), (6.0, false));
        let rows = [made(6.0, 300), made(8.0, 250), made(12.0, 300)];
        assert_eq!(advice(&rows).expect("12 px does").side_px, 12.0);
        assert!(advice(&[made(6.0, 100)]).is_none() && advice(&[]).is_none());
    }
}
