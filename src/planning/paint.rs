//! Which paint stands out from an image of the place.

use rayon::prelude::*;
use serde::Serialize;

use crate::profile::Profile;
use crate::segment::reference::PaintTest;
use autoref_raster::error::Result;
use autoref_raster::window::Window;
use autoref_raster::{RasterSource, read_patch};

/// Windows looked at: spread evenly, this many and this large at most.
const WINDOWS: u64 = 64;
const WINDOW_PX: u64 = 256;
/// Every so many pixels of a window, in both directions.
const STRIDE: usize = 2;

/// How a paint fares on the ground seen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PaintRank {
    pub profile: String,
    /// Share of the ground that would be taken for paint.
    pub ground_share: f64,
    /// Distance of the ground's colours from the paint, over the profile's limit (up to 1 is paint): what all but one
    /// in ten thousand pixels exceed, and all but one in a hundred.
    pub margin_p0001: f64,
    pub margin_p01: f64,
    pub pixels: usize,
    /// How wide a dark rim the marks need on this ground, in sides of the mark: 0 where the paint stands out by itself.
    pub rim_sides: f64,
}

/// Ground of which so much would pass for the paint hides its marks (`docs/planning.md`).
const HIDING_SHARE: f64 = 1e-3;

/// Ranks the shipped paints on an image of the ground, the one that stands out most first. Looks at up to 64 windows of
/// 256 × 256 px spread over the image. Empty when the image holds no pixel.
///
/// # Errors
/// When a window cannot be read.
pub fn rank_paints(source: &dyn RasterSource) -> Result<Vec<PaintRank>> {
    let colours = sample(source)?;
    let mut ranks: Vec<PaintRank> = Profile::of_paints()
        .into_iter()
        .map(|(profile, rim_sides)| Ok(rank((&profile.name, rim_sides), &PaintTest::new(&profile)?, &colours)))
        .collect::<Result<_>>()?;
    ranks.retain(|rank| rank.pixels > 0);
    ranks.sort_by(|a, b| a.ground_share.total_cmp(&b.ground_share).then(b.margin_p0001.total_cmp(&a.margin_p0001)));
    Ok(ranks)
}

/// `rim_sides` is what the paint needs where the ground hides it.
fn rank((name, rim_sides): (&str, f64), test: &PaintTest, colours: &[[u8; 3]]) -> PaintRank {
    let mut distances: Vec<f64> = colours
        .par_iter()
        // A rough test that says no says it without a number.
        .map(|&colour| test.relative_distance2(colour).sqrt().min(1e3))
        .collect();
    distances.sort_by(f64::total_cmp);
    let paint = distances.partition_point(|&d| d <= 1.0);
    let quantile = |share: f64| distances.get((share * distances.len() as f64) as usize).copied().unwrap_or(0.0);
    let ground_share = paint as f64 / distances.len().max(1) as f64;
    PaintRank {
        profile: name.into(),
        ground_share,
        rim_sides: if ground_share < HIDING_SHARE { 0.0 } else { rim_sides },
        margin_p0001: quantile(1e-4),
        margin_p01: quantile(1e-2),
        pixels: distances.len(),
    }
}

/// Colours of valid pixels of up to 64 windows, as 8-bit sRGB, from the top down.
pub(crate) fn sample(source: &dyn RasterSource) -> Result<Vec<[u8; 3]>> {
    let info = source.info();
    let aspect = info.width as f64 / info.height.max(1) as f64;
    let columns = ((WINDOWS as f64 * aspect).sqrt().round() as u64).clamp(1, WINDOWS);
    let rows = (WINDOWS / columns).max(1);
    let mut colours = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let (width, height) = (WINDOW_PX.min(info.width), WINDOW_PX.min(info.height));
            // The middle of each cell of the lattice.
            let middle = |i: u64, n: u64, side: u64, window: u64| {
                ((2 * i + 1) * side / (2 * n)).saturating_sub(window / 2).min(side - window)
            };
            let window = Window::new(
                middle(column, columns, info.width, width),
                middle(row, rows, info.height, height),
                width,
                height,
            );
            let patch = read_patch(source, window)?;
            let white = u32::from(patch.white.max(1));
            let byte = |v: u16| ((u32::from(v) * 255 + white / 2) / white).min(255) as u8;
            for y in (0..height as usize).step_by(STRIDE) {
                for x in (0..width as usize).step_by(STRIDE) {
                    let i = y * width as usize + x;
                    if patch.valid[i] {
                        colours.push(patch.rgb[i].map(byte));
                    }
                }
            }
        }
    }
    Ok(colours)
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::memory::MemorySource;

    #[test]
    fn the_colour_of_the_ground_comes_last() {
        // The paint of the ground's own hue, or its twin of the RAL cards.
        let grounds: [([u8; 3], &[&str]); 3] = [
            ([60, 130, 50], &["green", "ral-6018"]),
            ([230, 110, 50], &["orange", "ral-2003", "ral-2004", "ral-2005"]),
            ([40, 90, 200], &["blue", "ral-5015"]),
        ];
        for (ground, worst) in grounds {
            let rgb: Vec<u8> = (0..100 * 75)
                .flat_map(|i: u32| ground.map(|v| v.saturating_add((i.wrapping_mul(2_654_435_761) >> 28) as u8)))
                .collect();
            let ranks = rank_paints(&MemorySource::rgb8(100, 75, rgb)).expect("in memory");
            assert!(ranks.len() >= 6, "{ranks:?}");
            let last = ranks.last().expect("several paints");
            assert!(worst.contains(&last.profile.as_str()), "{ranks:?}");
            assert!(ranks[0].margin_p0001 > last.margin_p0001 && ranks[0].ground_share == 0.0);
            assert_eq!((ranks[0].rim_sides, last.rim_sides), (0.0, 0.5));
        }
    }
}
