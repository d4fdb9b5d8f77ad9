//! From the reduced frame to the mask, by one of three methods.

use autoref_raster::error::Result;
use autoref_raster::window::{TileGrid, Window};
use rayon::prelude::*;

use crate::area::flip_small;
use crate::bits::{Bit, BitMask};
use crate::clean::{Cleaning, clean};
use crate::entropy::{RADIUS_PX, entropy};
use crate::features::{FEATURES, FrameScale, Measured};
use crate::forest::Forest;
use crate::frame_scale::{CORE_PX, frame_scale, measured};
use crate::judge::{Evidence, keep_doubtful, kept_though_even, mask_clouds};
use crate::knn::Neighbours;
use crate::mirror::mask_mirrored;
use crate::plane::Plane;
use crate::reduce::Reduced;
use crate::unlike::{Known, Lattice, Seen};

/// How pixels are told apart.
pub enum Classifier {
    /// The nearest samples by entropy and intensity.
    Neighbours(Neighbours),
    /// Entropy above so many bits is kept.
    Threshold(f64),
    Forest(Box<Learned>),
}

/// What `auto` has learned.
pub struct Learned {
    pub forest: Forest<FEATURES>,
    pub known: Known,
    /// What it would have learned of what ships alone, where a frame was taught.
    pub shipped: Option<Forest<FEATURES>>,
}

/// What cleans the classes.
#[derive(Clone, Debug, PartialEq)]
pub enum Cleaner {
    Thesis(Cleaning),
    /// None: the classes as they are.
    Nothing,
    /// Masked areas are judged whole, clouds in a sky and lakes that mirror masked; then areas under this share of the
    /// image change class, background first.
    Areas(f64),
}

/// A pixel with more of 255 votes is ground at first: 0.55, so that what is half sure makes areas that are then judged
/// whole.
const KEEP_ABOVE: u8 = 140;

/// Between these probabilities, of 255, a pixel is unsure.
pub const UNSURE: std::ops::RangeInclusive<u8> = 77..=178;

/// Radius of the windows that smooth the votes, and how often they do: together near a Gaussian of σ 3.5 px.
const VOTE_RADIUS_PX: usize = 3;
const VOTE_PASSES: usize = 3;

/// A frame's classes at the reduced scale.
pub struct Classes {
    pub keep: BitMask,
    /// Where the votes are divided, where the method has votes.
    pub unsure: Option<BitMask>,
    /// Where the votes count: pixels that hold something, more than one level, where the method has votes.
    pub decided: Option<BitMask>,
    /// Probability of keep, 0…255, where the method has one.
    pub probability: Option<Plane>,
    /// The pixels that were compared with all that was taught, where the method knows.
    pub seen: Option<Seen>,
    /// Share of the frame that is kept in an even area along the upper border, where the method has votes.
    pub kept_though_even: Option<f64>,
}

/// What one tile tells: votes, what masked areas are judged by, and what is far from all that was taught.
struct Told {
    votes: Vec<u8>,
    fineness: Vec<u8>,
    /// Votes of what ships alone, where a frame was taught.
    shipped: Vec<u8>,
    /// Pixels whose window shows one level only: masked whatever the votes.
    flat: Vec<bool>,
    seen: Seen,
}

/// What a forest tells of a frame's pixels, one byte each.
struct Votes {
    probability: Plane,
    fineness: Plane,
    /// Of what ships alone, where a frame was taught.
    shipped: Option<Plane>,
}

impl Votes {
    fn new(learned: &Learned, width: usize, height: usize, memory_bytes: u64) -> Result<Votes> {
        let plane = || Plane::new(width, height, memory_bytes);
        let shipped = learned.shipped.as_ref().map(|_| plane()).transpose()?;
        Ok(Votes { probability: plane()?, fineness: plane()?, shipped })
    }

    fn write(&mut self, core: &Window, told: &Told) -> Result<()> {
        self.probability.write(core, &told.votes)?;
        self.fineness.write(core, &told.fineness)?;
        self.shipped.as_mut().map_or(Ok(()), |plane| plane.write(core, &told.shipped))
    }

    fn evidence(&self) -> Evidence<'_> {
        Evidence { votes: &self.probability, fineness: &self.fineness, shipped: self.shipped.as_ref() }
    }
}

/// Classifies every pixel and cleans the classes.
///
/// # Errors
/// When a scratch file fails.
pub fn classify(reduced: &Reduced, classifier: &Classifier, cleaner: &Cleaner, memory_bytes: u64) -> Result<Classes> {
    let (width, height) = (reduced.grey.width(), reduced.grey.height());
    let mut keep = BitMask::new(width, height);
    let mut unsure = matches!(classifier, Classifier::Forest(_)).then(|| BitMask::new(width, height));
    let mut decided = unsure.clone();
    let (scale, mut votes) = match classifier {
        Classifier::Forest(learned) => {
            (Some(frame_scale(reduced)?), Some(Votes::new(learned, width, height, memory_bytes)?))
        }
        _ => (None, None),
    };
    let mut seen = Seen::default();
    let grid = TileGrid::new(width as u64, height as u64, CORE_PX, CORE_PX, 0);
    let threads = rayon::current_num_threads() as u64;
    for first in (0..grid.len()).step_by(threads as usize) {
        let ids: Vec<u64> = (first..(first + threads).min(grid.len())).collect();
        let done: Vec<Result<(Window, Told)>> = ids
            .into_par_iter()
            .map(|id| {
                let core = grid.tile(id).core;
                Ok((core, told(reduced, classifier, scale.as_ref(), &core)?))
            })
            .collect();
        for one in done {
            let (core, told) = one?;
            for (i, &vote) in told.votes.iter().enumerate() {
                let x = core.x as usize + i % core.width as usize;
                let y = core.y as usize + i / core.width as usize;
                keep.set(x, y, vote > KEEP_ABOVE);
                if let Some(unsure) = &mut unsure {
                    unsure.set(x, y, UNSURE.contains(&vote));
                }
                if let Some(decided) = &mut decided {
                    decided.set(x, y, !told.flat[i]);
                }
            }
            if let Some(votes) = &mut votes {
                votes.write(&core, &told)?;
            }
            seen.join(told.seen);
        }
    }
    // What holds nothing is no ground; it must not be closed over either.
    keep.and(&reduced.valid);
    if let (Some(unsure), Some(decided)) = (&mut unsure, &mut decided) {
        decided.and(&reduced.valid);
        unsure.and(decided);
    }
    keep = cleaned(keep, cleaner, reduced, votes.as_ref())?;
    let seen = scale.map(|_| seen);
    let probability = votes.map(|votes| votes.probability);
    let even = probability.as_ref().map(|votes| kept_though_even(&keep, votes, &reduced.valid)).transpose()?;
    Ok(Classes { keep, unsure, decided, probability, seen, kept_though_even: even })
}

/// The mask of the pixels that `keep` has one by one.
fn cleaned(keep: BitMask, cleaner: &Cleaner, reduced: &Reduced, votes: Option<&Votes>) -> Result<BitMask> {
    let mut keep = match cleaner {
        Cleaner::Thesis(cleaning) => clean(keep, cleaning),
        Cleaner::Nothing => keep,
        Cleaner::Areas(share) => {
            let mut keep = keep;
            if let Some(votes) = votes {
                keep_doubtful(&mut keep, &votes.evidence(), &reduced.valid)?;
                mask_clouds(&mut keep);
                mask_mirrored(&mut keep, &reduced.grey, &reduced.valid)?;
            }
            flip_small(&mut keep, Bit::Clear, *share);
            flip_small(&mut keep, Bit::Set, *share);
            keep
        }
    };
    keep.and(&reduced.valid);
    Ok(keep)
}

/// What the pixels of `core` tell: the probability of keep, 0…255, and how many of those that were looked at are far
/// from what was taught.
fn told(reduced: &Reduced, classifier: &Classifier, scale: Option<&FrameScale>, core: &Window) -> Result<Told> {
    if let (Classifier::Forest(learned), Some(scale)) = (classifier, scale) {
        let margin = VOTE_RADIUS_PX * VOTE_PASSES;
        let (measured, _) = measured(&reduced.grey, core, margin)?;
        let votes: Vec<u8> =
            (0..measured.width * measured.height).map(|i| vote(&learned.forest, scale, &measured, i)).collect();
        let seen = look(&learned.known, reduced, scale, &measured, core);
        let inner = |y: usize| {
            (y + margin) * measured.width + margin..(y + margin) * measured.width + margin + core.width as usize
        };
        let fineness = (0..core.height as usize).flat_map(|y| measured.fineness()[inner(y)].iter().copied()).collect();
        let flat = (0..core.height as usize).flat_map(inner).map(|i| measured.is_flat(i)).collect();
        let votes = smooth_votes(&votes, measured.width, measured.height);
        // Means over masked areas are all that is asked of these votes: no other pixels, and not smoothed.
        let shipped = match &learned.shipped {
            Some(forest) => (0..core.height as usize)
                .flat_map(inner)
                .zip(&votes)
                .map(|(i, &kept)| if kept > KEEP_ABOVE { 0 } else { vote(forest, scale, &measured, i) })
                .collect(),
            None => Vec::new(),
        };
        return Ok(Told { votes, fineness, shipped, flat, seen });
    }
    let bounds = Window::whole(reduced.grey.width() as u64, reduced.grey.height() as u64);
    let read = core.grown(RADIUS_PX as u64, &bounds);
    let pixels = reduced.grey.read(&read)?;
    let (w, h) = (read.width as usize, read.height as usize);
    let (left, top) = ((core.x - read.x) as usize, (core.y - read.y) as usize);
    let bits = entropy(&pixels, w, h, RADIUS_PX, top..top + core.height as usize);
    let mut out = Vec::with_capacity(core.area() as usize);
    for (y, row) in bits.chunks_exact(w).enumerate() {
        for x in left..left + core.width as usize {
            let kept = match classifier {
                Classifier::Neighbours(neighbours) => neighbours.keep(row[x], pixels[(top + y) * w + x]),
                Classifier::Threshold(limit) => f64::from(row[x]) > *limit,
                Classifier::Forest(_) => unreachable!("forests have a scale"),
            };
            out.push(if kept { 255 } else { 0 });
        }
    }
    Ok(Told { votes: out, fineness: Vec::new(), shipped: Vec::new(), flat: Vec::new(), seen: Seen::default() })
}

/// Looks at the lattice's pixels in `core` that show something.
fn look(known: &Known, reduced: &Reduced, scale: &FrameScale, measured: &Measured, core: &Window) -> Seen {
    let margin = VOTE_RADIUS_PX * VOTE_PASSES;
    let mut seen = Seen::default();
    for (x, y) in Lattice::of(reduced.grey.width(), reduced.grey.height()).within(core) {
        let i = ((y - core.y) as usize + margin) * measured.width + (x - core.x) as usize + margin;
        if reduced.valid.get(x as usize, y as usize) && measured.shows_something(i) {
            seen.add((x as usize, y as usize), known.is_far(&scale.apply(measured, i)));
        }
    }
    seen
}

/// A pixel's probability of keep. Where a window of 15 px shows one grey level only there is nothing to match.
fn vote(forest: &Forest<FEATURES>, scale: &FrameScale, measured: &Measured, i: usize) -> u8 {
    if measured.is_flat(i) { 0 } else { forest.keep(&scale.apply(measured, i)) }
}

/// Means over windows, again and again; the margin is used up. Sums are exact until the one division at the end.
fn smooth_votes(votes: &[u8], width: usize, height: usize) -> Vec<u8> {
    let r = VOTE_RADIUS_PX;
    let (mut w, mut h) = (width, height);
    let mut sums: Vec<u32> = votes.iter().map(|&v| u32::from(v)).collect();
    for _ in 0..VOTE_PASSES {
        let across: Vec<u32> =
            sums.chunks_exact(w).flat_map(|row| row.windows(2 * r + 1).map(|window| window.iter().sum())).collect();
        w -= 2 * r;
        h -= 2 * r;
        sums = (0..h * w).map(|i| (0..=2 * r).map(|dy| across[i + dy * w]).sum()).collect();
    }
    let whole = ((2 * r + 1) as u32).pow(2 * VOTE_PASSES as u32);
    sums.iter().map(|sum| ((sum + whole / 2) / whole) as u8).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_votes_stay_and_one_vote_spreads_evenly() {
        assert_eq!(smooth_votes(&[200; 19 * 20], 19, 20), [200, 200]);
        let mut votes = [0u8; 41 * 41];
        votes[20 * 41 + 20] = 255;
        let smoothed = smooth_votes(&votes, 41, 41);
        // 23 × 23: the middle and two corners.
        assert_eq!(smoothed[0], smoothed[23 * 23 - 1]);
        assert!(smoothed[11 * 23 + 11] > smoothed[0]);
    }
}
