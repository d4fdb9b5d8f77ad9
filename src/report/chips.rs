//! Small windows around marks: from what the scan kept of them, else by one read each after the run, in parallel where
//! the source allows it.

use rayon::prelude::*;

use crate::detector::Detector;
use crate::report::frame::{Frame, Spot};
use crate::report::kept_pixels::KeptPixels;
use crate::report::overview::{Rgb8, Stretch};
use crate::segment::label::Labeller;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::mask::Mask;
use autoref_raster::{Block, Patch, RasterInfo, RasterSource, View};

/// Chips are reduced to at most this many pixels a side.
const MAX_CHIP_PX: u64 = 160;
/// What lies outside the image or holds no data.
const BLANK: u8 = 232;
/// A fitted shape belongs to a mark when their centres agree to this.
const SAME_MARK_PX: f64 = 0.05;

/// A window of the image as the page shows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Chip {
    /// Image coordinates of its upper left corner; may lie outside the image.
    pub left: i64,
    pub top: i64,
    /// Side in image pixels.
    pub side_px: u64,
    pub picture: Rgb8,
    /// Border of the fitted shape, image pixels.
    pub outline: Option<Vec<PixelPoint>>,
}

/// Cuts every spot; the chips are in the order of the spots. What the scan kept is not read again.
///
/// # Errors
/// When a window cannot be read.
pub fn cut(
    source: &dyn RasterSource,
    detector: &dyn Detector,
    stretch: Stretch,
    kept: &KeptPixels,
    spots: &[Spot],
) -> Result<Vec<Chip>> {
    let one = |spot: &Spot| cut_one(source, detector, stretch, kept, spot);
    if !source.info().sequential {
        return spots.par_iter().map(one).collect();
    }
    // From the top down: the reader cannot go back without starting again.
    let mut order: Vec<usize> = (0..spots.len()).collect();
    order.sort_by(|&a, &b| {
        (spots[a].centre.y - spots[a].side_px as f64).total_cmp(&(spots[b].centre.y - spots[b].side_px as f64))
    });
    let mut chips: Vec<Option<Chip>> = vec![None; spots.len()];
    for i in order {
        chips[i] = Some(one(&spots[i])?);
    }
    Ok(chips.into_iter().flatten().collect())
}

fn cut_one(
    source: &dyn RasterSource,
    detector: &dyn Detector,
    stretch: Stretch,
    kept: &KeptPixels,
    spot: &Spot,
) -> Result<Chip> {
    let info = source.info();
    let frame = Frame::new(spot, info, detector);
    let mut chip = Chip {
        left: frame.left,
        top: frame.top,
        side_px: spot.side_px,
        picture: Rgb8 { width: 0, height: 0, rgb: Vec::new() },
        outline: None,
    };
    if frame.shown.is_empty() {
        chip.picture = reduced(&chip, None, stretch);
        return Ok(chip);
    }
    let block = match kept.get(frame.read) {
        Some(block) => block,
        None => source.read(frame.read)?,
    };
    chip.picture = reduced(&chip, Some(&block.patch(frame.shown, info)), stretch);
    if frame.mark.is_some() {
        let outline = |detector| outline(&block, info, detector, spot.centre);
        chip.outline = outline(detector).or_else(|| detector.others().into_iter().find_map(outline));
    }
    Ok(chip)
}

/// The fitted shape of the mark at a place.
fn outline(block: &Block, info: &RasterInfo, detector: &dyn Detector, place: PixelPoint) -> Option<Vec<PixelPoint>> {
    let mut mask = Mask::new(block.window);
    detector.segment(block, &mut mask);
    // The block's own border: regions that meet it are not whole, and are left open.
    let regions = Labeller::new().label(&mask, block.window, info.bounds(), |region| detector.gate(region)).finished;
    let (x, y) = (place.x as u64, place.y as u64);
    regions
        .iter()
        .filter(|region| region.bounds.grown(2, &info.bounds()).contains(x, y))
        .filter_map(|region| {
            let window = region.bounds.grown(detector.patch_margin_px(), &info.bounds());
            block.window.contains_window(&window).then(|| detector.outline(region, &View { block, window, info }))?
        })
        .find(|(centre, _)| (centre.x - place.x).hypot(centre.y - place.y) < SAME_MARK_PX)
        .map(|(_, outline)| outline)
}

/// The chip's window as 8-bit RGB, in squares of whole pixels when it is larger than [`MAX_CHIP_PX`].
fn reduced(chip: &Chip, patch: Option<&Patch>, stretch: Stretch) -> Rgb8 {
    let factor = chip.side_px.div_ceil(MAX_CHIP_PX).max(1);
    let side = chip.side_px.div_ceil(factor) as usize;
    let mut sums = vec![[0u32; 3]; side * side];
    let mut counts = vec![0u32; side * side];
    if let Some(patch) = patch {
        let width = patch.window.width as usize;
        for (i, colour) in patch.rgb.iter().enumerate().filter(|(i, _)| patch.valid[*i]) {
            let x = ((patch.window.x + (i % width) as u64) as i64 - chip.left) as u64 / factor;
            let y = ((patch.window.y + (i / width) as u64) as i64 - chip.top) as u64 / factor;
            let cell = y as usize * side + x as usize;
            counts[cell] += 1;
            for (sum, value) in sums[cell].iter_mut().zip(colour) {
                *sum += u32::from(*value);
            }
        }
    }
    let mean = |(sum, count): (&[u32; 3], &u32)| match count {
        0 => [BLANK; 3],
        count => sum.map(|s| stretch.to_byte(f64::from(s) / f64::from(*count))),
    };
    Rgb8 { width: side, height: side, rgb: sums.iter().zip(&counts).flat_map(mean).collect() }
}
