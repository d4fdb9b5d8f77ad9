//! The true nearest neighbours of every point, whatever the tiles: a tile is searched first, then every other tile that
//! may still hold a nearer point. Where points are sparse, the halo grows by itself.

use std::collections::VecDeque;
use std::sync::Arc;

use rayon::prelude::*;

use crate::error::Result;
use crate::kdtree::{Bounds, Tree};
use crate::tiles::Tiles;

/// Points of one piece of work.
const CHUNK: usize = 1 << 10;

/// Trees of tiles, the last used ones kept.
struct Trees<'a> {
    tiles: &'a Tiles,
    kept: VecDeque<(usize, Arc<Tree>)>,
    most_points: usize,
}

impl Trees<'_> {
    fn get(&mut self, tile: usize) -> Result<Arc<Tree>> {
        if let Some(at) = self.kept.iter().position(|(kept, _)| *kept == tile) {
            let entry = self.kept.remove(at).expect("the position was just found");
            self.kept.push_back(entry);
        } else {
            let needed = self.tiles.tiles[tile].active;
            while self.kept.iter().map(|(_, tree)| tree.points().len()).sum::<usize>() + needed > self.most_points {
                if self.kept.pop_front().is_none() {
                    break;
                }
            }
            self.kept.push_back((tile, Arc::new(self.tiles.tree(tile)?)));
        }
        Ok(Arc::clone(&self.kept.back().expect("it was just put there").1))
    }
}

/// Finds the `count` nearest active neighbours of every active point that are nearer than the root of `bound2`, and
/// hands the squared distances over, tile by tile: `count` sorted numbers a point, in the order of the tile's points;
/// what was not found stays at `bound2`.
///
/// At most `kept_points` are held in trees beside the tile itself. [`Tiles::prepare`] must have run.
///
/// # Errors
/// Those of `each` and of the scratch disk.
///
/// # Panics
/// When `count` is 0.
pub fn for_each_tile(
    tiles: &Tiles,
    count: usize,
    bound2: f64,
    kept_points: usize,
    each: impl FnMut(usize, &Tree, &[f64]) -> Result<()>,
) -> Result<()> {
    let all = |number: usize| Ok(Some(vec![bound2; tiles.tiles[number].active * count]));
    for_each_tile_from(tiles, count, all, kept_points, each)
}

/// As [`for_each_tile`], each neighbour with a bound of its own that its squared distance must be below: `begin` has
/// them for a tile, or `None` when nothing is to be found there.
///
/// # Errors
/// Those of `begin`, of `each` and of the scratch disk.
///
/// # Panics
/// When `count` is 0.
pub fn for_each_tile_from(
    tiles: &Tiles,
    count: usize,
    begin: impl Fn(usize) -> Result<Option<Vec<f64>>>,
    kept_points: usize,
    mut each: impl FnMut(usize, &Tree, &[f64]) -> Result<()>,
) -> Result<()> {
    assert!(count > 0, "neighbours are asked for");
    let mut trees = Trees { tiles, kept: VecDeque::new(), most_points: kept_points };
    for (number, tile) in tiles.tiles.iter().enumerate() {
        if tile.active == 0 {
            continue;
        }
        let Some(mut found) = begin(number)? else { continue };
        let tree = trees.get(number)?;
        let search = |tree: &Tree, others: &Tree, found: &mut [f64]| {
            found.par_chunks_mut(CHUNK * count).zip(tree.points().par_chunks(CHUNK)).for_each(|(found, points)| {
                for (nearest, point) in found.chunks_exact_mut(count).zip(points) {
                    others.nearest(point, nearest);
                }
            });
        };
        search(&tree, &tree, &mut found);
        let mut others: Vec<(f64, usize)> = tiles
            .tiles
            .iter()
            .enumerate()
            .filter(|(other, tile)| *other != number && tile.active > 0)
            .map(|(other, tile)| (tile.bounds.gap2(tree.bounds()), other))
            .collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut reach = found.par_chunks_exact(count).map(|nearest| nearest[count - 1]).reduce(|| 0.0, f64::max);
        for (gap2, other) in others {
            if gap2 >= reach {
                break;
            }
            let bounds = tiles.tiles[other].bounds;
            if !any_within(&tree, &bounds, &found, count) {
                continue;
            }
            let other = trees.get(other)?;
            search(&tree, &other, &mut found);
            reach = found.par_chunks_exact(count).map(|nearest| nearest[count - 1]).reduce(|| 0.0, f64::max);
        }
        each(number, &tree, &found)?;
    }
    Ok(())
}

/// Whether a point of the tile may have a neighbour in the box.
fn any_within(tree: &Tree, bounds: &Bounds, found: &[f64], count: usize) -> bool {
    tree.points()
        .par_iter()
        .zip(found.par_chunks_exact(count))
        .any(|(point, nearest)| bounds.distance2(point.xyz) < nearest[count - 1])
}
