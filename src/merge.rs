//! Joining regions that straddle tile edges.
//!
//! Each tile hands over its open regions and, for every face it shares with another tile, the runs of pixels along it.
//! When two neighbouring tiles have both been fed, their facing runs are compared and touching regions united; when
//! every piece of a united region has met all the tiles that it reaches, the region is complete. Everything in a
//! [`Region`] is an integer and every operation on it commutes, so the result does not depend on the order in which
//! tiles arrive, nor on the tiling itself.
//!
//! After dask-image's `_label.py` (look only at the faces, unite, relabel), but streaming: what is held is the open
//! regions of tiles that still wait for a neighbour.
//!
//! ```
//! use autoref_stream::merge::RegionMerger;
//! use autoref_stream::segment::label::Labeller;
//! use autoref_raster::mask::Mask;
//! use autoref_raster::window::{TileGrid, Window};
//! let raster = Window::whole(8, 4);
//! let grid = TileGrid::new(8, 4, 4, 4, 0); // two tiles side by side
//! let mut merger = RegionMerger::new(grid);
//! let (mut labeller, mut found) = (Labeller::new(), Vec::new());
//! for id in 0..2 {
//!     let core = grid.tile(id).core;
//!     let mut mask = Mask::new(core);
//!     (core.x..core.right()).for_each(|x| mask.set(x, 1, true)); // one line across both
//!     let regions = labeller.label(&mask, core, raster, |_| true);
//!     merger.feed(id, regions, &mut |region| found.push(region));
//! }
//! merger.finalize();
//! assert_eq!((found.len(), found[0].area), (1, 8));
//! ```

use std::collections::HashMap;

use crate::segment::label::{FaceRun, Faces, Region, TileRegions};
use autoref_raster::window::{TileGrid, Window};

struct Entry {
    parent: u32,
    region: Region,
    /// Entries of this set, when this is its root.
    members: Vec<u32>,
    /// Tiles that pieces of this set reach and have not met yet, counted once a piece; kept at the root.
    waiting: u64,
}

struct WaitingTile {
    faces: Faces,
    /// Entry of each open region. It is gone when the region has met all tiles that it reaches; no face names it then.
    entries: Vec<u32>,
    /// Of each open region, which of [`AROUND`] it reaches: a bit each.
    reaches: Vec<u8>,
    neighbours_left: u32,
}

/// The neighbours of a tile as steps (down, right).
const AROUND: [(i64, i64); 8] = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)];

/// Feeds on tiles in any order and gives out the regions that cross their edges.
pub struct RegionMerger {
    grid: TileGrid,
    tiles: HashMap<u64, WaitingTile>,
    entries: Vec<Option<Entry>>,
    free: Vec<u32>,
    fed: u64,
}

impl RegionMerger {
    /// No tile has come yet.
    pub fn new(grid: TileGrid) -> Self {
        RegionMerger { grid, tiles: HashMap::new(), entries: Vec::new(), free: Vec::new(), fed: 0 }
    }

    /// Takes the open regions of tile `id`; what became complete by it is handed to `emit`.
    ///
    /// # Panics
    /// When a tile is fed twice.
    pub fn feed(&mut self, id: u64, regions: TileRegions, emit: &mut impl FnMut(Region)) {
        let neighbours = self.neighbours(id);
        let core = self.grid.tile(id).core;
        let there = neighbours.iter().fold(0u8, |bits, (side, _)| bits | 1 << side);
        let reaches: Vec<u8> = regions.open.iter().map(|region| reach(&region.bounds, &core) & there).collect();
        let entries: Vec<u32> = regions
            .open
            .into_iter()
            .zip(&reaches)
            .map(|(region, reaches)| self.new_entry(region, u64::from(reaches.count_ones())))
            .collect();
        let neighbours_left = neighbours.len() as u32;
        let tile = WaitingTile { faces: regions.faces, entries, reaches, neighbours_left };
        assert!(self.tiles.insert(id, tile).is_none(), "tile {id} was fed twice");
        self.fed += 1;
        for (side, other) in neighbours {
            if self.tiles.contains_key(&other) {
                self.join(id, other);
                self.have_met(id, side, emit);
                // Steps lie in the list as their opposites do from the end.
                self.have_met(other, AROUND.len() - 1 - side, emit);
            }
        }
        if self.tiles.get(&id).is_some_and(|tile| tile.neighbours_left == 0) {
            self.tiles.remove(&id);
        }
    }

    /// What of tile `id` reaches the neighbour on `side` waits for one less.
    fn have_met(&mut self, id: u64, side: usize, emit: &mut impl FnMut(Region)) {
        let tile = self.tiles.get_mut(&id).expect("a tile stays until it has met all its neighbours");
        tile.neighbours_left -= 1;
        let left = tile.neighbours_left;
        let reaching = tile.entries.iter().zip(&tile.reaches).filter(|(_, bits)| **bits >> side & 1 == 1);
        for entry in reaching.map(|(&entry, _)| entry).collect::<Vec<_>>() {
            let root = self.root(entry);
            self.entry(root).waiting -= 1;
            if self.entry(root).waiting == 0 {
                let done = self.entries[root as usize].take().expect("a root in use holds an entry");
                for member in done.members {
                    self.entries[member as usize] = None;
                    self.free.push(member);
                }
                emit(done.region);
            }
        }
        if left == 0 {
            self.tiles.remove(&id);
        }
    }

    /// To be called after the last tile.
    ///
    /// # Panics
    /// When tiles are missing: regions would be lost.
    pub fn finalize(self) {
        assert_eq!(self.fed, self.grid.len(), "every tile must be fed before the merge is complete");
        assert!(self.tiles.is_empty(), "the last tile closes all");
    }

    /// Open regions held now; for the tests of bounded memory.
    pub fn held(&self) -> usize {
        self.entries.len() - self.free.len()
    }

    /// Which of [`AROUND`] there are, and their tiles.
    fn neighbours(&self, id: u64) -> Vec<(usize, u64)> {
        let (columns, rows) = (self.grid.columns() as i64, self.grid.rows() as i64);
        let (row, column) = ((id as i64) / columns, (id as i64) % columns);
        let tile = |(dy, dx)| {
            let (y, x) = (row + dy, column + dx);
            ((0..rows).contains(&y) && (0..columns).contains(&x)).then_some((y * columns + x) as u64)
        };
        AROUND.into_iter().enumerate().filter_map(|(side, step)| Some((side, tile(step)?))).collect()
    }

    fn new_entry(&mut self, region: Region, waiting: u64) -> u32 {
        debug_assert!(waiting > 0, "an open region reaches another tile");
        let index = self.free.pop().unwrap_or_else(|| {
            self.entries.push(None);
            (self.entries.len() - 1) as u32
        });
        self.entries[index as usize] = Some(Entry { parent: index, region, members: vec![index], waiting });
        index
    }

    fn entry(&mut self, index: u32) -> &mut Entry {
        self.entries[index as usize].as_mut().expect("indices in use always hold an entry")
    }

    fn root(&mut self, mut index: u32) -> u32 {
        loop {
            let parent = self.entry(index).parent;
            if parent == index {
                return index;
            }
            let grandparent = self.entry(parent).parent;
            self.entry(index).parent = grandparent;
            index = grandparent;
        }
    }

    fn join(&mut self, a: u64, b: u64) {
        let columns = self.grid.columns();
        let (first, second) = (a.min(b), a.max(b));
        let (tile_a, tile_b) = (&self.tiles[&first], &self.tiles[&second]);
        let same_row = first / columns == second / columns;
        let (one, two): (&[FaceRun], &[FaceRun]) = if same_row {
            (&tile_a.faces.right, &tile_b.faces.left)
        } else {
            (&tile_a.faces.bottom, &tile_b.faces.top)
        };
        let mut contacts = Vec::new();
        let mut start = 0;
        for run in two {
            while start < one.len() && one[start].end < run.start {
                start += 1;
            }
            for other in one[start..].iter().take_while(|other| other.start <= run.end) {
                let sides = run.end.min(other.end).saturating_sub(run.start.max(other.start));
                contacts.push((tile_a.entries[other.region as usize], tile_b.entries[run.region as usize], sides));
            }
        }
        for (one, two, sides) in contacts {
            self.unite(one, two, sides);
        }
    }

    fn unite(&mut self, a: u32, b: u32, shared_sides: u64) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            self.entry(a).region.perimeter -= 2 * shared_sides;
            return;
        }
        let (keep, gone) = if self.entry(a).members.len() >= self.entry(b).members.len() { (a, b) } else { (b, a) };
        let lost = self.entry(gone);
        lost.parent = keep;
        let (region, waiting, members) = (lost.region.clone(), lost.waiting, std::mem::take(&mut lost.members));
        let kept = self.entry(keep);
        kept.region.absorb(&region, shared_sides);
        kept.waiting += waiting;
        kept.members.extend(members);
    }
}

/// Which of [`AROUND`] a region with these bounds may touch from inside a tile: a bit each.
fn reach(bounds: &Window, core: &Window) -> u8 {
    let down = [bounds.y == core.y, true, bounds.bottom() == core.bottom()];
    let right = [bounds.x == core.x, true, bounds.right() == core.right()];
    AROUND
        .iter()
        .enumerate()
        .fold(0, |bits, (side, &(dy, dx))| bits | u8::from(down[(dy + 1) as usize] && right[(dx + 1) as usize]) << side)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::label::Labeller;
    use autoref_raster::mask::Mask;
    use proptest::prelude::*;

    /// The oracle: flood fill over the whole mask, counting everything pixel by pixel.
    fn flood_fill(mask: &Mask) -> Vec<Region> {
        let Window { width, height, .. } = mask.window();
        let mut seen = Mask::new(mask.window());
        let mut regions = Vec::new();
        for y in 0..height {
            for x in 0..width {
                if !mask.get(x, y) || seen.get(x, y) {
                    continue;
                }
                let mut region = Region {
                    first: (y, x),
                    bounds: Window::new(x, y, 1, 1),
                    area: 0,
                    sum_x: 0,
                    sum_y: 0,
                    sum_xx: 0,
                    sum_xy: 0,
                    sum_yy: 0,
                    perimeter: 0,
                };
                let mut stack = vec![(x, y)];
                seen.set(x, y, true);
                while let Some((x, y)) = stack.pop() {
                    let (x128, y128) = (u128::from(x), u128::from(y));
                    region.area += 1;
                    region.sum_x += x128;
                    region.sum_y += y128;
                    region.sum_xx += x128 * x128;
                    region.sum_xy += x128 * y128;
                    region.sum_yy += y128 * y128;
                    region.bounds = region.bounds.union(&Window::new(x, y, 1, 1));
                    for (dx, dy) in [(-1i64, 0i64), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
                        let (nx, ny) = (x as i64 + dx, y as i64 + dy);
                        let inside = (0..width as i64).contains(&nx) && (0..height as i64).contains(&ny);
                        let set = inside && mask.get(nx as u64, ny as u64);
                        if dx * dy == 0 && !set {
                            region.perimeter += 1;
                        }
                        if set && !seen.get(nx as u64, ny as u64) {
                            seen.set(nx as u64, ny as u64, true);
                            stack.push((nx as u64, ny as u64));
                        }
                    }
                }
                regions.push(region);
            }
        }
        regions
    }

    fn tiled(mask: &Mask, tile_width: u64, tile_height: u64, order: impl Fn(u64) -> u64) -> Vec<Region> {
        let raster = mask.window();
        let grid = TileGrid::new(raster.width, raster.height, tile_width, tile_height, 0);
        let mut ids: Vec<u64> = (0..grid.len()).collect();
        ids.sort_by_key(|&id| order(id));
        let mut merger = RegionMerger::new(grid);
        let mut labeller = Labeller::new();
        let mut all = Vec::new();
        for id in ids {
            let mut regions = labeller.label(mask, grid.tile(id).core, raster, |_| true);
            all.append(&mut regions.finished);
            merger.feed(id, regions, &mut |region| all.push(region));
        }
        assert_eq!(merger.held(), 0);
        merger.finalize();
        all.sort_by_key(|region| region.first);
        all
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]
        #[test]
        fn any_tiling_in_any_order_gives_the_regions_of_the_whole(
            width in 1u64..90, height in 1u64..40, tw in 1u64..40, th in 1u64..40,
            density in 1u64..7, seed in any::<u64>(), shuffle in any::<u64>(),
        ) {
            let mut mask = Mask::new(Window::whole(width, height));
            let mut random = autoref_raster::random::SplitMix64(seed);
            for y in 0..height {
                for x in 0..width {
                    mask.set(x, y, random.next_u64() % 8 < density);
                }
            }
            let expected = flood_fill(&mask);
            let found = tiled(&mask, tw, th, |id| (id ^ shuffle).wrapping_mul(0x9E37_79B9_7F4A_7C15));
            prop_assert_eq!(expected, found);
        }
    }
}
