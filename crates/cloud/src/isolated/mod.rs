//! Points that statistics of distance do not tell: low points close beneath the ground or the canopy, and small
//! clusters far from everything.
//!
//! A point is noise
//! - when it lies below the lower envelope of its surroundings, and alone there: the surroundings are the at most 128
//!   points nearest in plan within a radius, the envelope is the plane of asymmetric least squares (Eilers & Boelens,
//!   *Baseline correction with asymmetric least squares smoothing*, 2005) to which points above it weigh 0.02. With d
//!   the depth below the envelope over the envelope's spread, and g the height above the point of the lowest but
//!   `least` − 2 of its surroundings, along the envelope's slope, over their spacing in plan, √(d g) is at least
//!   `lowness`; or
//! - when the `least`-th neighbour is four times as far as for the median point: a cluster of at most `least` points.
//!
//! Both are taken over the true neighbours, so that tiles change nothing.

mod envelope;
mod lanes;
mod surroundings;

use std::fs::File;
use std::sync::Arc;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::kdtree::{Bounds, Tree};
use crate::neighbours;
use crate::outliers;
use crate::params;
use crate::tiles::Tiles;
use envelope::NEAR;
use surroundings::{Found, Question, Surroundings, Trees};

/// Points whose surroundings are gathered at once.
const GROUP_POINTS: usize = 64;
/// Points in the radius that is found from the density.
const EXPECTED: f64 = 100.0;
/// How much farther than for the median point a cluster's outer neighbour is.
const FARTHER: f64 = 4.0;

/// Parameters of the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Of the surroundings; `None` is the radius that holds 100 points at the mean density of occupied ground.
    pub radius_m: Option<f64>,
    /// Geometric mean of depth and loneliness, from which on a point is low.
    pub lowness: f64,
    /// A cluster of more points is no noise.
    pub least: usize,
}

impl Default for Options {
    fn default() -> Self {
        Options { radius_m: None, lowness: 0.35, least: 5 }
    }
}

impl Options {
    /// Reads `r=0,m=0.35,min=5`; a radius of 0 is found from the density.
    ///
    /// # Errors
    /// Unknown names, values that make no sense.
    pub fn read(text: &str) -> Result<Options> {
        let [r, m, min] = params::read("--isolated", text, [("r", 0.0), ("m", 0.35), ("min", 5.0)])?;
        if r < 0.0 || m <= 0.0 {
            return Err(Error::usage(format!("--isolated: r is {r}, m is {m}"), "give r from 0 up and m above 0"));
        }
        let least = params::whole("--isolated", "min", min, 1)?.min(1000);
        Ok(Options { radius_m: (r > 0.0).then_some(r), lowness: m, least })
    }

    /// For the memory plan: what a point takes in tiles, as if so many distances were kept.
    pub fn neighbours(&self) -> usize {
        self.least.max(64)
    }
}

/// Classifies noise; see the module. Answers how many points.
///
/// # Errors
/// Those of the scratch disk.
pub fn find(tiles: &mut Tiles, options: &Options, kept_points: usize, step: u8) -> Result<u64> {
    tiles.prepare()?;
    let radius = match options.radius_m {
        Some(radius) => radius,
        None => radius_of_density(tiles)?,
    };
    let distances = tiles.scratch.file()?;
    let question = Question {
        radius,
        lowness: options.lowness,
        company: (options.least - 1).clamp(1, NEAR),
        neighbour: options.least.min(NEAR),
    };
    let mut noise = vec![Vec::new(); tiles.tiles.len()];
    let mut kept: Vec<(usize, Arc<Tree>)> = Vec::new();
    for number in 0..tiles.tiles.len() {
        if tiles.tiles[number].active == 0 {
            continue;
        }
        let found = examine(tiles, number, &mut kept, &question)?;
        noise[number] = (0u32..).zip(&found).filter(|(_, found)| found.low).map(|(at, _)| at).collect();
        let known = |found: &Found| found.distance2.filter(|_| options.least <= NEAR).unwrap_or(f64::NAN);
        let values: Vec<f64> = found.iter().map(known).collect();
        outliers::write(tiles, &distances, tiles.tiles[number].before, &values)?;
    }
    drop(kept);
    let clusters = clusters(tiles, options.least, kept_points, &distances)?;
    for (noise, far) in noise.iter_mut().zip(clusters) {
        noise.extend(far);
        noise.sort_unstable();
        noise.dedup();
    }
    outliers::mark(tiles, &noise, step)
}

/// What the surroundings of a tile's points tell; `kept` are the trees that were needed before.
fn examine(
    tiles: &Tiles,
    number: usize,
    kept: &mut Vec<(usize, Arc<Tree>)>,
    question: &Question,
) -> Result<Vec<Found>> {
    let bounds = tiles.tiles[number].bounds;
    let near: Vec<usize> = (0..tiles.tiles.len())
        .filter(|&other| tiles.tiles[other].active > 0)
        .filter(|&other| tiles.tiles[other].bounds.gap2_in_plan(&bounds) <= question.radius * question.radius)
        .collect();
    kept.retain(|(other, _)| near.contains(other));
    for &other in &near {
        if kept.iter().all(|(known, _)| *known != other) {
            kept.push((other, Arc::new(tiles.tree(other)?)));
        }
    }
    let own = kept.iter().find(|(other, _)| *other == number).map(|(_, tree)| Arc::clone(tree));
    let Some(own) = own else { return Ok(Vec::new()) };
    let trees: &Trees = kept;
    let groups: Vec<Vec<Found>> = own
        .groups(GROUP_POINTS)
        .par_iter()
        .with_min_len(8)
        .map_init(Surroundings::default, |around, group| around.examine(&own.points()[group.clone()], trees, question))
        .collect();
    Ok(groups.concat())
}

/// Points whose `least`-th neighbour is too far, by their place in the tiles. `distances` holds its squared distance
/// for every point, NaN where it has to be searched.
fn clusters(tiles: &Tiles, least: usize, kept_points: usize, distances: &File) -> Result<Vec<Vec<u32>>> {
    let known = |number: usize| {
        let tile = &tiles.tiles[number];
        outliers::read(tiles, distances, tile.before, tile.active)
    };
    let begin = |number: usize| {
        let values = known(number)?;
        // What is known is not searched: nothing is nearer than 0.
        let start = |value: &f64| if value.is_nan() { f64::INFINITY } else { 0.0 };
        let open = values.iter().any(|value| value.is_nan());
        Ok(open.then(|| values.iter().flat_map(|value| std::iter::repeat_n(start(value), least)).collect()))
    };
    neighbours::for_each_tile_from(tiles, least, begin, kept_points, |number, _, found| {
        let mut values = known(number)?;
        for (value, nearest) in values.iter_mut().zip(found.chunks_exact(least)) {
            if value.is_nan() {
                *value = nearest[least - 1];
            }
        }
        outliers::write(tiles, distances, tiles.tiles[number].before, &values)
    })?;
    let median2 = median(tiles, distances)?;
    let limit2 = median2 * FARTHER * FARTHER;
    let mut far = Vec::with_capacity(tiles.tiles.len());
    for number in 0..tiles.tiles.len() {
        // A cloud of fewer points has no such neighbour, and where most lie on one place, distances tell nothing.
        let is_far = |value: &f64| value.is_finite() && median2 > 0.0 && *value >= limit2;
        far.push((0u32..).zip(&known(number)?).filter(|(_, value)| is_far(value)).map(|(index, _)| index).collect());
    }
    Ok(far)
}

/// The median of the values of all active points, none of them negative.
fn median(tiles: &Tiles, file: &File) -> Result<f64> {
    // Bits of positive doubles sort as the numbers do: the median is found sixteen bits at a time.
    let mut rank = tiles.tiles.iter().map(|tile| tile.active as u64).sum::<u64>() / 2;
    let mut prefix = 0u64;
    for round in 0..4 {
        let mut counts = vec![0u64; 1 << 16];
        for tile in &tiles.tiles {
            for value in outliers::read(tiles, file, tile.before, tile.active)? {
                let bits = value.to_bits();
                if round == 0 || bits >> (64 - 16 * round) == prefix {
                    counts[(bits >> (48 - 16 * round)) as usize & 0xffff] += 1;
                }
            }
        }
        let mut digit = 0;
        while digit < 0xffff && rank >= counts[digit] {
            rank -= counts[digit];
            digit += 1;
        }
        prefix = (prefix << 16) | digit as u64;
    }
    Ok(f64::from_bits(prefix))
}

/// The radius of a disc that holds the expected number of points.
fn radius_of_density(tiles: &Tiles) -> Result<f64> {
    let mut bounds = Bounds::EMPTY;
    tiles.tiles.iter().filter(|tile| tile.active > 0).for_each(|tile| bounds.merge(&tile.bounds));
    let points: u64 = tiles.tiles.iter().map(|tile| tile.active as u64).sum();
    let (width, height) = (bounds.max[0] - bounds.min[0], bounds.max[1] - bounds.min[1]);
    // Cells of sixteen points on average; those without any are no ground.
    let cell = (16.0 * width * height / points.max(1) as f64).sqrt().max((width.max(height)) / 30_000.0);
    if cell.is_nan() || cell <= 0.0 {
        return Ok(width.max(height).max(f64::MIN_POSITIVE));
    }
    let columns = (width / cell) as usize + 1;
    let mut occupied = vec![false; columns * ((height / cell) as usize + 1)];
    crate::elm::each_active(tiles, |xyz| {
        let (x, y) = ((xyz[0] - bounds.min[0]) / cell, (xyz[1] - bounds.min[1]) / cell);
        occupied[y as usize * columns + x as usize] = true;
        Ok(())
    })?;
    let area = occupied.iter().filter(|&&occupied| occupied).count() as f64 * cell * cell;
    let area = area.min(width * height);
    Ok((EXPECTED * area / points.max(1) as f64 / std::f64::consts::PI).sqrt())
}
