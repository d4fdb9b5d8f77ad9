//! Points that stand alone.

use std::fs::File;
use std::os::unix::fs::FileExt;

use rayon::prelude::*;

use crate::error::Result;
use crate::neighbours;
use crate::point::Point;
use crate::tiles::Tiles;
use autoref_raster::exact_sum::ExactSum;

/// LAS class of noise.
pub const NOISE: u8 = 7;

/// What the statistical filter measured over the whole cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct OutlierStatistics {
    /// Mean over all points of the mean distance to the neighbours.
    pub mean_m: f64,
    /// With divisor n − 1.
    pub standard_deviation_m: f64,
    pub threshold_m: f64,
}

/// Statistical outliers (Rusu, Marton, Blodow, Dolha & Beetz, *Towards 3D point cloud based object maps for household
/// environments*, 2008): with μᵢ the mean distance of a point to its `neighbours` nearest, itself left out, μ and σ
/// their mean and standard deviation (n − 1), a point is noise when μᵢ ≥ μ + mσ, `m` being `multiplier`.
///
/// μ and σ come from exact sums: neither tiles nor the order of points change a bit. Unlike PDAL, nothing is noise
/// where all μᵢ are the same. Points with fewer neighbours in the whole cloud use those that there are.
///
/// # Errors
/// Those of the scratch disk.
pub fn statistical(
    tiles: &mut Tiles,
    neighbours: usize,
    multiplier: f64,
    kept_points: usize,
    step: u8,
) -> Result<(u64, OutlierStatistics)> {
    tiles.prepare()?;
    let file = tiles.scratch.file()?;
    let mut sum = ExactSum::default();
    let mut points = 0u64;
    neighbours::for_each_tile(tiles, neighbours, f64::INFINITY, kept_points, |number, _, found| {
        let means: Vec<f64> = found.par_chunks_exact(neighbours).map(mean_distance).collect();
        means.iter().for_each(|&mean| sum.add(mean));
        points += means.len() as u64;
        write(tiles, &file, tiles.tiles[number].before, &means)
    })?;
    if points < 2 {
        return Ok((0, OutlierStatistics::default()));
    }
    let mean = sum.value() / points as f64;
    let mut squares = ExactSum::default();
    for tile in &tiles.tiles {
        for value in read(tiles, &file, tile.before, tile.active)? {
            squares.add((value - mean) * (value - mean));
        }
    }
    let deviation = (squares.value() / (points - 1) as f64).sqrt();
    let threshold = mean + multiplier * deviation;
    let mut noise = 0;
    if deviation > 0.0 {
        tiles.update(|number, points| {
            let tile = &tiles.tiles[number];
            let means = read(tiles, &file, tile.before, tile.active)?;
            let before = noise;
            for (point, mean) in points.iter_mut().zip(means) {
                if mean >= threshold {
                    point.take_out(NOISE, step);
                    noise += 1;
                }
            }
            Ok(noise > before)
        })?;
    }
    let statistics = OutlierStatistics { mean_m: mean, standard_deviation_m: deviation, threshold_m: threshold };
    Ok((noise, statistics))
}

/// The mean of the roots of those that were found.
fn mean_distance(nearest: &[f64]) -> f64 {
    let found = nearest.iter().take_while(|distance| distance.is_finite());
    let (count, sum) = found.fold((0, 0.0), |(count, sum), distance| (count + 1, sum + distance.sqrt()));
    if count == 0 { 0.0 } else { sum / f64::from(count) }
}

/// Radius outliers: a point is noise when fewer than `least` others are nearer than `radius`.
///
/// # Errors
/// Those of the scratch disk.
pub fn radius(tiles: &mut Tiles, radius: f64, least: usize, kept_points: usize, step: u8) -> Result<u64> {
    tiles.prepare()?;
    let mut lonely: Vec<Vec<u32>> = vec![Vec::new(); tiles.tiles.len()];
    let bound2 = radius * radius;
    neighbours::for_each_tile(tiles, least, bound2, kept_points, |number, _, found| {
        let alone = found.chunks_exact(least).enumerate().filter(|(_, nearest)| nearest[least - 1] >= bound2);
        lonely[number] = alone.map(|(index, _)| index as u32).collect();
        Ok(())
    })?;
    mark(tiles, &lonely, step)
}

/// Classifies points of the tiles, by their place in them, as noise.
pub(crate) fn mark(tiles: &Tiles, which: &[Vec<u32>], step: u8) -> Result<u64> {
    tiles.update(|number, points: &mut [Point]| {
        for &index in &which[number] {
            points[index as usize].take_out(NOISE, step);
        }
        Ok(!which[number].is_empty())
    })?;
    Ok(which.iter().map(|tile| tile.len() as u64).sum())
}

pub(crate) fn write(tiles: &Tiles, file: &File, at: u64, values: &[f64]) -> Result<()> {
    let mut bytes = Vec::with_capacity(8 * values.len());
    values.iter().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
    file.write_all_at(&bytes, 8 * at).map_err(|e| tiles.scratch.error("write scratch data to", e))
}

pub(crate) fn read(tiles: &Tiles, file: &File, at: u64, count: usize) -> Result<Vec<f64>> {
    let mut bytes = vec![0; 8 * count];
    file.read_exact_at(&mut bytes, 8 * at).map_err(|e| tiles.scratch.error("read scratch data from", e))?;
    Ok(bytes.chunks_exact(8).map(|bytes| f64::from_le_bytes(crate::schema::array(bytes))).collect())
}
