//! Points that statistics of distance do not tell: low points close beneath the ground or the canopy, and small clusters
//! far from everything.
//!
//! A point is noise
//! - when it lies below the lower envelope of its surroundings by `share` times the envelope's spread: the surroundings are
//!   the at most 128 points nearest in plan within a radius, the envelope is the plane of asymmetric least squares (Eilers
//!   & Boelens, *Baseline correction with asymmetric least squares smoothing*, 2005) to which points above it weigh 0.02; or
//! - when the `least`-th neighbour is four times as far as for the median point: a cluster of at most `least` points.
//!
//! Both are taken over the true neighbours, so that tiles change nothing.

use std::cmp::Ordering;
use std::sync::Arc;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::kdtree::{Bounds, Tree};
use crate::neighbours;
use crate::outliers;
use crate::params;
use crate::tiles::{Point, Tiles};

/// Surroundings at most, and at least.
const MOST: usize = 128;
const LEAST: usize = 6;
/// What points above the envelope weigh against those below.
const ABOVE: f64 = 0.02;
const ROUNDS: usize = 8;
/// Points whose surroundings are gathered at once.
const GROUP_POINTS: usize = 48;
/// More points than these around a group are a crowd: a smaller halo will do.
const CROWD: usize = 4096;
/// Points in the radius that is found from the density.
const EXPECTED: f64 = 100.0;
/// How much farther than for the median point a cluster's outer neighbour is.
const FARTHER: f64 = 4.0;

/// Parameters of the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Of the surroundings; `None` is the radius that holds 100 points at the mean density of occupied ground.
    pub radius_m: Option<f64>,
    /// Depth below the envelope in units of its spread.
    pub share: f64,
    pub least: usize,
}

impl Default for Options {
    fn default() -> Self {
        Options { radius_m: None, share: 0.55, least: 5 }
    }
}

impl Options {
    /// Reads `r=0,m=0.55,min=5`; a radius of 0 is found from the density.
    ///
    /// # Errors
    /// Unknown names, values that make no sense.
    pub fn read(text: &str) -> Result<Options> {
        let [r, m, min] = params::read("--isolated", text, [("r", 0.0), ("m", 0.55), ("min", 5.0)])?;
        if r < 0.0 || m <= 0.0 {
            return Err(Error::usage(format!("--isolated: r is {r}, m is {m}"), "give r from 0 up and m above 0"));
        }
        let least = params::whole("--isolated", "min", min, 1)?.min(1000);
        Ok(Options { radius_m: (r > 0.0).then_some(r), share: m, least })
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
    let mut noise = clusters(tiles, options.least, kept_points)?;
    let radius = match options.radius_m {
        Some(radius) => radius,
        None => radius_of_density(tiles)?,
    };
    let mut kept: Vec<(usize, Arc<Tree>)> = Vec::new();
    for number in 0..tiles.tiles.len() {
        if tiles.tiles[number].active == 0 {
            continue;
        }
        let bounds = tiles.tiles[number].bounds;
        let near: Vec<usize> = (0..tiles.tiles.len())
            .filter(|&other| tiles.tiles[other].active > 0)
            .filter(|&other| tiles.tiles[other].bounds.gap2_in_plan(&bounds) <= radius * radius)
            .collect();
        kept.retain(|(other, _)| near.contains(other));
        for &other in &near {
            if kept.iter().all(|(known, _)| *known != other) {
                kept.push((other, Arc::new(tiles.tree(other)?)));
            }
        }
        let own = kept.iter().find(|(other, _)| *other == number).map(|(_, tree)| Arc::clone(tree));
        let Some(own) = own else { continue };
        let low: Vec<u32> = own
            .groups(GROUP_POINTS)
            .par_iter()
            .with_min_len(8)
            .map_init(Surroundings::default, |around, group| {
                let points = &own.points()[group.clone()];
                let low = around.low_of(points, &kept, radius, options.share);
                low.into_iter().map(|at| (group.start + at) as u32).collect::<Vec<u32>>()
            })
            .flatten()
            .collect();
        noise[number].extend(low);
        noise[number].sort_unstable();
        noise[number].dedup();
    }
    outliers::mark(tiles, &noise, step)
}

/// Points whose `least`-th neighbour is too far, by their place in the tiles.
fn clusters(tiles: &mut Tiles, least: usize, kept_points: usize) -> Result<Vec<Vec<u32>>> {
    let file = tiles.scratch.file()?;
    let mut counts = vec![0u64; 1 << 16];
    neighbours::for_each_tile(tiles, least, f64::INFINITY, kept_points, |number, _, found| {
        let farthest: Vec<f64> = found.chunks_exact(least).map(|nearest| nearest[least - 1]).collect();
        farthest.iter().for_each(|distance2| counts[(distance2.to_bits() >> 48) as usize] += 1);
        outliers::write(tiles, &file, tiles.tiles[number].before, &farthest)
    })?;
    // Bits of positive doubles sort as the numbers do: the median is found sixteen bits at a time.
    let mut rank = counts.iter().sum::<u64>() / 2;
    let mut prefix = 0u64;
    for round in 0..4 {
        if round > 0 {
            counts.fill(0);
            for tile in &tiles.tiles {
                for value in outliers::read(tiles, &file, tile.before, tile.active)? {
                    let bits = value.to_bits();
                    if bits >> (64 - 16 * round) == prefix {
                        counts[(bits >> (48 - 16 * round)) as usize & 0xffff] += 1;
                    }
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
    let median2 = f64::from_bits(prefix);
    let limit2 = median2 * FARTHER * FARTHER;
    let mut far = Vec::with_capacity(tiles.tiles.len());
    for tile in &tiles.tiles {
        let values = outliers::read(tiles, &file, tile.before, tile.active)?;
        // A cloud of fewer points has no such neighbour, and where most lie on one place, distances tell nothing.
        let is_far = |value: &f64| value.is_finite() && median2 > 0.0 && *value >= limit2;
        far.push((0u32..).zip(&values).filter(|(_, value)| is_far(value)).map(|(index, _)| index).collect());
    }
    Ok(far)
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

/// What lies around a group of points, and buffers.
#[derive(Default)]
struct Surroundings {
    found: Vec<Point>,
    /// In the order of their coordinates, so that sums do not depend on tiles.
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    index: Vec<u64>,
    distance2: Vec<f64>,
    ranked: Vec<f64>,
    nearest: Vec<[f64; 4]>,
    /// Of one point: offsets of its surroundings.
    offsets: Vec<[f64; 3]>,
    envelope: Envelope,
}

impl Surroundings {
    /// The low points of a group, by their place in it.
    fn low_of(&mut self, points: &[Point], trees: &[(usize, Arc<Tree>)], radius: f64, share: f64) -> Vec<usize> {
        // Where all lie at one place, no halo is small enough.
        const SMALLEST: f64 = 1e-9;
        let mut halo = radius;
        while !self.gather(points, trees, halo, CROWD) {
            if halo < SMALLEST * radius {
                self.gather(points, trees, halo, usize::MAX);
                break;
            }
            halo /= 2.0;
        }
        let (mut low, mut open) = (Vec::new(), Vec::new());
        for (at, point) in points.iter().enumerate() {
            self.choose(point, halo * halo);
            if halo < radius && self.offsets.len() < MOST {
                open.push(at);
            } else if self.is_low(share) {
                low.push(at);
            }
        }
        // Beside a crowd a point's surroundings reach farther: such points search by themselves.
        for at in open {
            let point = &points[at];
            self.nearest.clear();
            for (_, tree) in trees {
                tree.nearest_in_plan(point, radius * radius, MOST, &mut self.nearest);
            }
            let order = |a: &[f64; 4], b: &[f64; 4]| {
                a[2].total_cmp(&b[2]).then(a[3].total_cmp(&b[3])).then(a[1].total_cmp(&b[1]))
            };
            self.nearest.sort_unstable_by(order);
            let [px, py, pz] = point.xyz;
            self.offsets.clear();
            self.offsets.extend(self.nearest.iter().map(|[_, z, x, y]| [x - px, y - py, z - pz]));
            if self.is_low(share) {
                low.push(at);
            }
        }
        low
    }

    /// Takes in what lies within `halo` of the group in plan; whether it is at most `most` points.
    fn gather(&mut self, points: &[Point], trees: &[(usize, Arc<Tree>)], halo: f64, most: usize) -> bool {
        let mut area = Bounds::of(points);
        for axis in 0..2 {
            // Rounded outwards: the distance has the last word.
            let slack = halo + 1e-9 * (area.min[axis].abs() + area.max[axis].abs() + halo);
            area.min[axis] -= slack;
            area.max[axis] += slack;
        }
        self.found.clear();
        trees.iter().for_each(|(_, tree)| tree.within_in_plan(&area, most, &mut self.found));
        if self.found.len() > most {
            return false;
        }
        let order = |a: &Point, b: &Point| {
            let pairs = a.xyz.iter().zip(&b.xyz).map(|(a, b)| a.total_cmp(b));
            pairs.fold(Ordering::Equal, Ordering::then)
        };
        self.found.sort_unstable_by(order);
        let axis = |axis: usize, into: &mut Vec<f64>| {
            into.clear();
            into.extend(self.found.iter().map(|point| point.xyz[axis]));
        };
        axis(0, &mut self.x);
        axis(1, &mut self.y);
        axis(2, &mut self.z);
        self.index.clear();
        self.index.extend(self.found.iter().map(Point::index));
        true
    }

    /// Whether the point whose surroundings were chosen lies too deep below their lower envelope.
    fn is_low(&mut self, share: f64) -> bool {
        if self.offsets.len() < LEAST {
            return false;
        }
        self.envelope.depth(&self.offsets).is_some_and(|depth| depth >= share)
    }

    /// Offsets of the at most [`MOST`] points nearest to `point` in plan, itself left out.
    fn choose(&mut self, point: &Point, radius2: f64) {
        let [px, py, pz] = point.xyz;
        self.distance2.clear();
        self.distance2.extend(self.x.iter().zip(&self.y).map(|(x, y)| (x - px) * (x - px) + (y - py) * (y - py)));
        let own = point.index();
        let Surroundings { x, y, z, index, distance2, ranked, offsets, .. } = self;
        let choose = |limit2: f64, offsets: &mut Vec<[f64; 3]>| {
            offsets.clear();
            for (at, &distance2) in distance2.iter().enumerate() {
                if distance2 <= limit2 && index[at] != own {
                    offsets.push([x[at] - px, y[at] - py, z[at] - pz]);
                }
            }
        };
        choose(radius2, offsets);
        if offsets.len() <= MOST {
            return;
        }
        ranked.clear();
        ranked.extend(offsets.iter().map(|[dx, dy, _]| dx * dx + dy * dy));
        let farthest2 = *ranked.select_nth_unstable_by(MOST - 1, f64::total_cmp).1;
        choose(farthest2, offsets);
        if offsets.len() > MOST {
            // Of the equally far ones the lowest count, then those in the west and the south.
            let key = |[dx, dy, dz]: &[f64; 3]| [dx * dx + dy * dy, *dz, *dx, *dy];
            offsets.sort_by(|a, b| {
                let pairs = key(a).into_iter().zip(key(b)).map(|(a, b)| a.total_cmp(&b));
                pairs.fold(Ordering::Equal, Ordering::then)
            });
            offsets.truncate(MOST);
        }
    }
}

/// Buffers of the fit of an envelope: offsets and weights, two points side by side, since processors add pairs at once.
#[derive(Default)]
struct Envelope {
    x: Vec<[f64; 2]>,
    y: Vec<[f64; 2]>,
    z: Vec<[f64; 2]>,
    weight: Vec<[f64; 2]>,
}

/// Sums of weights and weighted products: 1, x, y, z, x², xy, y², xz, yz.
type Sums = [[f64; 2]; 9];

impl Envelope {
    /// How deep below the envelope of its surroundings the origin lies, in units of the spread about it; `None` when it does
    /// not, or the surroundings lie on a line.
    fn depth(&mut self, offsets: &[[f64; 3]]) -> Option<f64> {
        let Envelope { x, y, z, weight } = self;
        for (axis, into) in [&mut *x, &mut *y, &mut *z].into_iter().enumerate() {
            into.clear();
            into.extend(offsets.chunks(2).map(|pair| [pair[0][axis], pair.get(1).map_or(0.0, |second| second[axis])]));
        }
        weight.clear();
        weight.resize(x.len(), [1.0; 2]);
        if offsets.len() % 2 == 1 {
            // The last one has no partner.
            weight[x.len() - 1][1] = 0.0;
        }
        let mut sums = self.sums();
        let mut plane = solve(&sums)?;
        for _ in 1..ROUNDS {
            if !self.weigh(plane) {
                break;
            }
            sums = self.sums();
            plane = solve(&sums)?;
        }
        // Above its envelope nothing is low.
        if plane[0] <= 0.0 {
            return None;
        }
        self.weigh(plane);
        let (mut sum, mut squares) = ([0.0; 2], [0.0; 2]);
        for (((x, y), z), w) in self.x.iter().zip(&self.y).zip(&self.z).zip(&self.weight) {
            for lane in 0..2 {
                let off = z[lane] - (plane[0] + plane[1] * x[lane] + plane[2] * y[lane]);
                sum[lane] += w[lane];
                squares[lane] += w[lane] * off * off;
            }
        }
        let spread = ((squares[0] + squares[1]) / (sum[0] + sum[1])).sqrt();
        (spread > 0.0).then(|| plane[0] / spread)
    }

    /// Weighs points by the side of the plane that they are on; whether any changed.
    fn weigh(&mut self, [height, east, north]: [f64; 3]) -> bool {
        let mut changes = [0.0; 2];
        for (((x, y), z), w) in self.x.iter().zip(&self.y).zip(&self.z).zip(&mut self.weight) {
            for lane in 0..2 {
                let off = z[lane] - (height + east * x[lane] + north * y[lane]);
                let new = if off > 0.0 { ABOVE } else { 1.0 };
                let new = if w[lane] == 0.0 { 0.0 } else { new };
                changes[lane] += (new - w[lane]).abs();
                w[lane] = new;
            }
        }
        changes[0] + changes[1] > 0.0
    }

    fn sums(&self) -> Sums {
        let mut s: Sums = [[0.0; 2]; 9];
        for (((x, y), z), w) in self.x.iter().zip(&self.y).zip(&self.z).zip(&self.weight) {
            for lane in 0..2 {
                let (x, y, z, w) = (x[lane], y[lane], z[lane], w[lane]);
                let (wx, wy) = (w * x, w * y);
                s[0][lane] += w;
                s[1][lane] += wx;
                s[2][lane] += wy;
                s[3][lane] += w * z;
                s[4][lane] += wx * x;
                s[5][lane] += wx * y;
                s[6][lane] += wy * y;
                s[7][lane] += wx * z;
                s[8][lane] += wy * z;
            }
        }
        s
    }
}

/// Height at the origin and both slopes of the weighted least squares plane; `None` when the points lie on a line.
fn solve(sums: &Sums) -> Option<[f64; 3]> {
    let [w, x, y, z, xx, xy, yy, xz, yz] = sums.map(|[a, b]| a + b);
    let mut m = [[w, x, y, z], [x, xx, xy, xz], [y, xy, yy, yz]];
    // Gaussian elimination with pivots on the diagonal: the matrix is positive definite, or the points lie on a line.
    let diagonal = [m[0][0], m[1][1], m[2][2]];
    for i in 0..3 {
        let size = m[i][i];
        if size.is_nan() || size <= 1e-12 * diagonal[i] {
            return None;
        }
        for below in i + 1..3 {
            let factor = m[below][i] / size;
            for column in i..4 {
                m[below][column] -= factor * m[i][column];
            }
        }
    }
    let c = m[2][3] / m[2][2];
    let b = (m[1][3] - m[1][2] * c) / m[1][1];
    let a = (m[0][3] - m[0][1] * b - m[0][2] * c) / m[0][0];
    Some([a, b, c])
}
