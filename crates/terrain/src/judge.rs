//! Masked areas judged whole, clouds in a sky, and what may be sky though it is kept.
//!
//! A forest that looks at windows of a few pixels takes a mown field for a lake. Two things that windows do not show
//! tell them apart. Water and sky are even but for the camera's noise, which is as fine as the pixels; a field has soft
//! shades, so that its second differences (the Laplacian) are small against its gradients. And a sky lies along the
//! frame's upper border.
//!
//! All sums are of integers over an area's pixels, so that nothing depends on tiles.

use autoref_raster::error::Result;
use autoref_raster::window::Window;

use crate::area::Areas;
use crate::bits::{Bit, BitMask};
use crate::plane::Plane;

/// The greatest mean vote, of 255, of an area that stays masked: 82 where its mean Laplacian and gradient are equal,
/// 3.25 more for each ⅟₂₈ octave that the Laplacian is greater, at most 100; 96 more for the whole upper border; within
/// 40 and 130.
///
/// Source: a logistic regression on 303 areas of 50 places, each judged by a forest that its place did not teach;
/// rounded, and moved by 10 to the side of the mask. The bounds are chosen.
const LIMIT: f64 = 82.0;
const LIMIT_A_STEP: f64 = 3.25;
const LIMIT_AWAY_FROM_THE_BORDER: f64 = 100.0;
const LIMIT_UPPER_BORDER: f64 = 96.0;
const LIMITS: [f64; 2] = [40.0, 130.0];

/// The same where one of the flight's frames was taught: 0.35, whatever the texture.
const LIMIT_TAUGHT: f64 = 90.0;

/// Where a frame was taught, an area whose mean vote is above 0.24, but by what ships alone below 0.6, must also be one
/// that what ships would mask, with this much more than its limit: a field that looks somewhat like water to both is a
/// field if its texture says so. Above 0.6 only the taught frame knows that this is no ground.
///
/// Source: 75 pairs of the teaching list and the 12 of `docs/masks.md`.
const CERTAIN_TAUGHT: f64 = 60.0;
const SHIPS_DOUBTS_BELOW: f64 = 153.0;
const LIMIT_MORE: f64 = 20.0;

/// Fineness of equal Laplacian and gradient, as `features` writes ratios.
const EQUAL: f64 = 128.0;

fn limit(fineness: f64, upper_border: f64) -> f64 {
    let by_texture = (LIMIT + LIMIT_A_STEP * (fineness - EQUAL)).min(LIMIT_AWAY_FROM_THE_BORDER);
    (by_texture + LIMIT_UPPER_BORDER * upper_border).clamp(LIMITS[0], LIMITS[1])
}

/// What masked areas are judged by, one byte a pixel.
pub struct Evidence<'a> {
    /// 0 mask … 255 keep.
    pub votes: &'a Plane,
    /// As [`crate::features::Measured::fineness`] writes it.
    pub fineness: &'a Plane,
    /// Votes of what ships alone, where a frame was taught.
    pub shipped: Option<&'a Plane>,
}

/// What is summed over an area.
#[derive(Clone, Copy, Default)]
struct Sums {
    votes: u64,
    fineness: u64,
    shipped: u64,
    pixels: u64,
    upper_border: u64,
}

impl Sums {
    /// Mean of the area's pixels that hold something.
    fn mean(&self, sum: u64) -> f64 {
        sum as f64 / self.pixels as f64
    }

    /// The greatest mean vote of no ground by texture and place, in a frame of `width` pixels.
    fn limit(&self, width: usize) -> f64 {
        limit(self.mean(self.fineness), self.upper_border as f64 / width as f64)
    }

    /// Is the area no ground, by what a frame of the flight taught?
    fn stays_masked_as_taught(&self, width: usize) -> bool {
        let (vote, shipped) = (self.mean(self.votes), self.mean(self.shipped));
        let ships_agrees = shipped >= SHIPS_DOUBTS_BELOW || shipped <= self.limit(width) + LIMIT_MORE;
        vote <= CERTAIN_TAUGHT || (vote <= LIMIT_TAUGHT && ships_agrees)
    }
}

/// Turns the masked areas over to keep whose mean vote is above what their mean fineness and their share of the upper
/// border allow; where a frame was taught, above what that allows. Pixels outside `valid` take no part; an area of such
/// pixels alone stays.
///
/// # Errors
/// When a plane cannot be read.
pub fn keep_doubtful(mask: &mut BitMask, evidence: &Evidence<'_>, valid: &BitMask) -> Result<()> {
    let areas = Areas::of(mask, Bit::Clear);
    let mut sums = vec![Sums::default(); areas.runs.len()];
    let (mut vote, mut fine, mut shipped) = (Vec::new(), Vec::new(), None);
    let mut row = None;
    for (run, &root) in areas.runs.iter().zip(&areas.root) {
        if row != Some(run.row) {
            let window = Window::new(0, u64::from(run.row), mask.width() as u64, 1);
            vote = evidence.votes.read(&window)?;
            fine = evidence.fineness.read(&window)?;
            shipped = evidence.shipped.map(|plane| plane.read(&window)).transpose()?;
            row = Some(run.row);
        }
        let sum = &mut sums[root as usize];
        for x in run.start as usize..run.end as usize {
            if valid.get(x, run.row as usize) {
                sum.votes += u64::from(vote[x]);
                sum.fineness += u64::from(fine[x]);
                sum.shipped += shipped.as_ref().map_or(0, |shipped| u64::from(shipped[x]));
                sum.pixels += 1;
            }
        }
        if run.row == 0 {
            sum.upper_border += run.pixels();
        }
    }
    let width = mask.width();
    for (run, &root) in areas.runs.iter().zip(&areas.root) {
        let sum = &sums[root as usize];
        if sum.pixels == 0 {
            continue;
        }
        let stays = match evidence.shipped {
            Some(_) => sum.stays_masked_as_taught(width),
            None => sum.mean(sum.votes) <= sum.limit(width),
        };
        if !stays {
            mask.fill_run(run.row as usize, run.start as usize, run.end as usize, Bit::Set);
        }
    }
    Ok(())
}

/// Least share of the upper border that a sky covers itself, and together with the clouds in it.
const SKY_UPPER_BORDER: f64 = 0.3;
const SKY_AND_CLOUDS: f64 = 0.8;

/// A kept area in a sky is cloud when it has at most this share of the sky's pixels.
const CLOUD_OF_SKY: f64 = 0.5;

/// What lies about a kept area.
#[derive(Clone, Copy, PartialEq)]
enum Around {
    Nothing,
    /// One masked area, by its root.
    One(u32),
    More,
}

impl Around {
    fn and(self, root: u32) -> Around {
        match self {
            Around::Nothing => Around::One(root),
            Around::One(known) if known == root => self,
            _ => Around::More,
        }
    }
}

/// The masked area about each kept one, at its root.
fn surroundings(kept: &Areas, masked: &Areas) -> Vec<Around> {
    let mut around = vec![Around::Nothing; kept.runs.len()];
    for (run, &root) in kept.runs.iter().zip(&kept.root) {
        let here = &mut around[root as usize];
        for row in run.row.saturating_sub(1)..=run.row + 1 {
            // Beside the run touching counts, above and below it overlap.
            let beside = u32::from(row == run.row);
            let first = masked.runs.partition_point(|m| (m.row, m.end + beside) <= (row, run.start));
            let near = masked.runs[first..].iter().take_while(|m| m.row == row && m.start < run.end + beside);
            near.enumerate().for_each(|(i, _)| *here = here.and(masked.root[first + i]));
        }
    }
    around
}

/// Masks clouds: kept areas that a sky and the frame's border enclose. A sky is a masked area along the upper border
/// that does not reach the lower one.
pub fn mask_clouds(mask: &mut BitMask) {
    let (masked, kept) = (Areas::of(mask, Bit::Clear), Areas::of(mask, Bit::Set));
    let (width, last) = (mask.width() as f64, mask.height() as u32 - 1);
    let mut along = vec![0u64; masked.runs.len()];
    let mut reaches_down = vec![false; masked.runs.len()];
    for (run, &root) in masked.runs.iter().zip(&masked.root) {
        along[root as usize] += if run.row == 0 { run.pixels() } else { 0 };
        reaches_down[root as usize] |= run.row == last;
    }
    let is_sky = |root: u32| {
        along[root as usize] as f64 >= SKY_UPPER_BORDER * width
            && along[root as usize] > 0
            && !reaches_down[root as usize]
    };
    let around = surroundings(&kept, &masked);
    let mut stands = vec![false; kept.runs.len()];
    for (run, &root) in kept.runs.iter().zip(&kept.root) {
        stands[root as usize] |= run.row == last;
    }
    let sky_of = |root: u32| match around[root as usize] {
        Around::One(sky)
            if is_sky(sky)
                && !stands[root as usize]
                && kept.pixels[root as usize] as f64 <= CLOUD_OF_SKY * masked.pixels[sky as usize] as f64 =>
        {
            Some(sky)
        }
        _ => None,
    };
    let mut with_clouds = along.clone();
    for (run, &root) in kept.runs.iter().zip(&kept.root).filter(|(run, _)| run.row == 0) {
        if let Some(sky) = sky_of(root) {
            with_clouds[sky as usize] += run.pixels();
        }
    }
    for (run, &root) in kept.runs.iter().zip(&kept.root) {
        if sky_of(root).is_some_and(|sky| with_clouds[sky as usize] as f64 >= SKY_AND_CLOUDS * width) {
            mask.fill_run(run.row as usize, run.start as usize, run.end as usize, Bit::Clear);
        }
    }
}

/// A pixel with at most so many of 255 votes is even enough to be sky.
const EVEN: u8 = 200;

/// Columns of the lattice that is looked at.
const COLUMNS: usize = 128;

/// Least share of the upper border of an even area that may be sky.
const MAY_BE_SKY: f64 = 0.5;

/// Share of the frame that is kept though it belongs to an even area along the upper border, on a lattice.
///
/// # Errors
/// When the plane cannot be read.
pub fn kept_though_even(keep: &BitMask, votes: &Plane, valid: &BitMask) -> Result<f64> {
    let step = (keep.width() / COLUMNS).max(1);
    // Of a frame that is lower than half a step the lowest row stands for the others.
    let first = |side: usize| (step / 2).min(side.saturating_sub(1));
    let (left, top) = (first(keep.width()), first(keep.height()));
    let (columns, rows) = ((keep.width() - left).div_ceil(step), (keep.height() - top).div_ceil(step));
    let (column, row) = (|i: usize| left + i * step, |i: usize| top + i * step);
    let mut even = BitMask::new(columns, rows);
    for y in 0..rows {
        let line = votes.read(&Window::new(0, row(y) as u64, votes.width() as u64, 1))?;
        (0..columns).for_each(|x| even.set(x, y, line[column(x)] <= EVEN && valid.get(column(x), row(y))));
    }
    let areas = Areas::of(&even, Bit::Set);
    let mut along = vec![0u64; areas.runs.len()];
    let mut kept = vec![0u64; areas.runs.len()];
    for (run, &root) in areas.runs.iter().zip(&areas.root) {
        along[root as usize] += if run.row == 0 { run.pixels() } else { 0 };
        let y = row(run.row as usize);
        kept[root as usize] += (run.start..run.end).filter(|&x| keep.get(column(x as usize), y)).count() as u64;
    }
    let sky = along.iter().zip(&kept).filter(|(along, _)| **along as f64 > MAY_BE_SKY * columns as f64);
    Ok(sky.map(|(_, kept)| *kept).sum::<u64>() as f64 / (columns * rows) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(width: usize, height: usize, value: impl Fn(usize, usize) -> u8) -> Plane {
        let mut plane = Plane::new(width, height, 1 << 20).expect("a plane");
        let values: Vec<u8> = (0..width * height).map(|i| value(i % width, i / width)).collect();
        plane.write(&Window::new(0, 0, width as u64, height as u64), &values).expect("written");
        plane
    }

    fn mask(rows: &[&str]) -> BitMask {
        BitMask::from_fn(rows[0].len(), rows.len(), |x, y| rows[y].as_bytes()[x] == b'#')
    }

    #[test]
    fn areas_masked_without_much_evidence_are_kept() {
        // Four areas: votes 30; votes 70, soft; votes 70, fine; one that holds nothing.
        let mut keep = BitMask::from_fn(40, 4, |x, y| y == 0 || !matches!(x % 10, 2..=5));
        let valid = BitMask::from_fn(40, 4, |x, _| x < 30);
        let votes = plane(40, 4, |x, _| if x < 10 { 30 } else { 70 });
        let fineness = plane(40, 4, |x, _| if x < 20 { 115 } else { 135 });
        let evidence = Evidence { votes: &votes, fineness: &fineness, shipped: None };
        keep_doubtful(&mut keep, &evidence, &valid).expect("read");
        assert_eq!([3, 13, 23, 33].map(|x| keep.get(x, 2)), [false, true, false, false]);
    }

    #[test]
    fn where_a_frame_was_taught_what_ships_has_its_say_on_what_it_doubts() {
        // Six areas, soft but the third: what is taught masks the first five, the fifth for certain; to what ships the
        // first is ground, the others look like water, the fourth the more so.
        let votes = plane(60, 4, |x, _| [80, 80, 80, 80, 50, 95][x / 10]);
        let shipped = plane(60, 4, |x, _| [200, 75, 75, 40, 75, 10][x / 10]);
        let fineness = plane(60, 4, |x, _| if x / 10 == 2 { 135 } else { 112 });
        let evidence = Evidence { votes: &votes, fineness: &fineness, shipped: Some(&shipped) };
        let valid = BitMask::from_fn(60, 4, |_, _| true);
        let mut keep = BitMask::from_fn(60, 4, |x, y| y == 0 || !matches!(x % 10, 2..=5));
        keep_doubtful(&mut keep, &evidence, &valid).expect("read");
        let judged = [3, 13, 23, 33, 43, 53].map(|x| keep.get(x, 2));
        assert_eq!(judged, [false, true, false, false, false, true]);
    }

    #[test]
    fn what_lies_along_the_upper_border_needs_less() {
        let votes = plane(20, 6, |_, _| 110);
        let fineness = plane(20, 6, |_, _| 122);
        let valid = BitMask::from_fn(20, 6, |_, _| true);
        for (below, kept) in [(0, false), (1, true)] {
            let mut keep = BitMask::from_fn(20, 6, |_, y| y < below || y > 3);
            let evidence = Evidence { votes: &votes, fineness: &fineness, shipped: None };
            keep_doubtful(&mut keep, &evidence, &valid).expect("read");
            assert_eq!(keep.get(9, 2), kept);
        }
    }

    #[test]
    fn clouds_in_a_sky_are_masked_and_islands_in_a_lake_stay() {
        let sky = ["..##......", "..##..#...", "..........", "#...##....", "##########", "####..####", "####..####"];
        let mut masked = mask(&sky);
        mask_clouds(&mut masked);
        let expected =
            ["..........", "..........", "..........", "#...##....", "##########", "####..####", "####..####"];
        assert!(masked == mask(&expected));
        for lake in [
            // Reaches the lower border; covers too little of the upper one; the island is larger than half of it.
            ["..........", "...##.....", "..........", "#########.", "#########."],
            ["######....", "######.#..", "######....", "##########", "##########"],
            ["..........", ".########.", ".########.", "..........", "##########"],
        ] {
            let mut kept = mask(&lake);
            mask_clouds(&mut kept);
            assert!(kept == mask(&lake), "{lake:?}");
        }
    }

    #[test]
    fn an_even_area_at_the_upper_border_is_told() {
        let votes = plane(300, 200, |_, y| if y < 100 { 180 } else { 240 });
        let valid = BitMask::from_fn(300, 200, |_, _| true);
        let share = |keep: &BitMask| kept_though_even(keep, &votes, &valid).expect("read");
        assert!((share(&valid) - 0.5).abs() < 0.02);
        assert_eq!(share(&BitMask::from_fn(300, 200, |_, y| y > 99)), 0.0);
        for (width, height) in [(1200, 3), (600, 1), (2000, 3), (1, 600)] {
            let low = plane(width, height, |_, _| 180);
            let all = BitMask::from_fn(width, height, |_, _| true);
            assert_eq!(kept_though_even(&all, &low, &all).expect("read"), 1.0, "{width} x {height}");
        }
        let narrow = plane(300, 200, |x, _| if x < 100 { 180 } else { 240 });
        assert_eq!(kept_though_even(&valid, &narrow, &valid).expect("read"), 0.0);
    }
}
