//! Connected regions of a mask, found in one pass over its rows.
//!
//! Rows become runs; runs of neighbouring rows that touch (8-connected) are united. A region that has no run in the
//! current row is complete and leaves at once, so that what is held is bounded by a row and the tile's outline, never
//! by the number of regions: a mask of pure noise costs no more than an empty one. What touches a face shared with
//! another tile stays open for [`crate::merge::RegionMerger`].
//!
//! The run-and-union idea is that of A. Rosenfeld and J. L. Pfaltz, "Sequential operations in digital picture
//! processing", 1966; we add the early exit and the faces.

use autoref_raster::mask::Mask;
use autoref_raster::window::Window;

/// An 8-connected set of foreground pixels, described by integers only, so that merging is exact in any order.
///
/// Sums are over pixel indices (column, row) of the image, not centres: the centroid is `sum / area + 0.5`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Row and column of the first pixel in raster order: the region's identity, whatever the tiling.
    pub first: (u64, u64),
    pub bounds: Window,
    pub area: u64,
    pub sum_x: u128,
    pub sum_y: u128,
    pub sum_xx: u128,
    pub sum_xy: u128,
    pub sum_yy: u128,
    /// Pixel sides between foreground and background (or the raster's edge): the crack length of outline and holes.
    pub perimeter: u64,
}

impl Region {
    /// A single run of pixels, columns `start..end` of row `y`.
    pub(crate) fn of_run(start: u64, end: u64, y: u64) -> Self {
        let n = end - start;
        let (n128, y128) = (u128::from(n), u128::from(y));
        let sum_x = u128::from(start + end - 1) * n128 / 2;
        // Σ x² over start..end as a difference of the closed form n(n-1)(2n-1)/6.
        let squares = |m: u64| {
            let m = u128::from(m);
            if m == 0 { 0 } else { m * (m - 1) * (2 * m - 1) / 6 }
        };
        Region {
            first: (y, start),
            bounds: Window::new(start, y, n, 1),
            area: n,
            sum_x,
            sum_y: y128 * n128,
            sum_xx: squares(end) - squares(start),
            sum_xy: sum_x * y128,
            sum_yy: y128 * y128 * n128,
            perimeter: 2 + 2 * n,
        }
    }

    /// Takes in another part of the same region. `shared_sides` is the number of pixel sides along which the two parts
    /// face each other, which are no longer outline.
    pub fn absorb(&mut self, other: &Region, shared_sides: u64) {
        self.first = self.first.min(other.first);
        self.bounds = self.bounds.union(&other.bounds);
        self.area += other.area;
        self.sum_x += other.sum_x;
        self.sum_y += other.sum_y;
        self.sum_xx += other.sum_xx;
        self.sum_xy += other.sum_xy;
        self.sum_yy += other.sum_yy;
        self.perimeter = self.perimeter + other.perimeter - 2 * shared_sides;
    }
}

/// A run of one region's pixels along a face, in image coordinates along that face, half-open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaceRun {
    pub start: u64,
    pub end: u64,
    /// Index into [`TileRegions::open`].
    pub region: u32,
}

/// Runs along the four sides of a tile, each in ascending order; empty for sides on the raster's edge.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faces {
    pub top: Vec<FaceRun>,
    pub bottom: Vec<FaceRun>,
    pub left: Vec<FaceRun>,
    pub right: Vec<FaceRun>,
}

/// The regions of one tile's core.
#[derive(Clone, Debug, Default)]
pub struct TileRegions {
    /// Regions that touch no shared face and passed the gate, in order of completion.
    pub finished: Vec<Region>,
    /// Regions that may go on in a neighbouring tile.
    pub open: Vec<Region>,
    pub faces: Faces,
}

#[derive(Clone, Copy)]
struct Run {
    start: u64,
    end: u64,
    node: u32,
}

struct Node {
    parent: u32,
    region: Region,
    last_row: u64,
    /// Named in a face list, so it must outlive the region's last row.
    pinned: bool,
}

/// Labels masks row by row; keeps its buffers from one tile to the next.
#[derive(Default)]
pub struct Labeller {
    nodes: Vec<Node>,
    free: Vec<u32>,
    merged: Vec<u32>,
    previous: Vec<Run>,
    current: Vec<Run>,
}

impl Labeller {
    /// One that has labelled nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// The regions of `core`, which must lie in the mask's window. `raster` is the window of the whole raster: sides of
    /// the core on its edge are no faces. Regions that are complete inside are kept when `gate` says so.
    pub fn label(&mut self, mask: &Mask, core: Window, raster: Window, gate: impl Fn(&Region) -> bool) -> TileRegions {
        debug_assert!(mask.window().contains_window(&core) && raster.contains_window(&core));
        self.nodes.clear();
        self.free.clear();
        self.previous.clear();
        let mut out = TileRegions::default();
        let shared = Shared {
            top: core.y > raster.y,
            bottom: core.bottom() < raster.bottom(),
            left: core.x > raster.x,
            right: core.right() < raster.right(),
        };
        for y in core.y..core.bottom() {
            self.current.clear();
            self.extract_runs(mask, core, y);
            if self.current.is_empty() && self.previous.is_empty() {
                continue;
            }
            self.unite_with_previous(y);
            self.record_faces(core, y, shared, &mut out.faces);
            self.retire(y, &gate, &mut out.finished);
            std::mem::swap(&mut self.previous, &mut self.current);
        }
        // The last row's regions have no further chance to grow.
        self.current.clear();
        self.retire(core.bottom(), &gate, &mut out.finished);
        self.previous.clear();
        self.collect_open(&mut out);
        out
    }

    fn extract_runs(&mut self, mask: &Mask, core: Window, y: u64) {
        let (left, right) = ((core.x - mask.window().x) as usize, (core.right() - mask.window().x) as usize);
        let origin = mask.window().x;
        let words = mask.row(y);
        let mut position = left;
        while position < right {
            let Some(start) = next_bit(words, position, right, true) else { break };
            let end = next_bit(words, start, right, false).unwrap_or(right);
            let (start_px, end_px) = (origin + start as u64, origin + end as u64);
            let node = self.new_node(Region::of_run(start_px, end_px, y), y);
            self.current.push(Run { start: start_px, end: end_px, node });
            position = end;
        }
    }

    fn new_node(&mut self, region: Region, y: u64) -> u32 {
        let index = self.free.pop().unwrap_or(self.nodes.len() as u32);
        let node = Node { parent: index, region, last_row: y, pinned: false };
        match self.nodes.get_mut(index as usize) {
            Some(slot) => *slot = node,
            None => self.nodes.push(node),
        }
        index
    }

    fn root(&mut self, mut index: u32) -> u32 {
        while self.nodes[index as usize].parent != index {
            let parent = self.nodes[index as usize].parent;
            let grandparent = self.nodes[parent as usize].parent;
            self.nodes[index as usize].parent = grandparent;
            index = grandparent;
        }
        index
    }

    /// Unites runs of this row with touching runs of the row above, then points every run at its root.
    fn unite_with_previous(&mut self, y: u64) {
        self.merged.clear();
        let mut above = 0;
        for i in 0..self.current.len() {
            let run = self.current[i];
            while above < self.previous.len() && self.previous[above].end < run.start {
                above += 1;
            }
            let mut j = above;
            while j < self.previous.len() && self.previous[j].start <= run.end {
                let other = self.previous[j];
                let sides = run.end.min(other.end).saturating_sub(run.start.max(other.start));
                self.unite(other.node, run.node, sides);
                j += 1;
            }
        }
        for i in 0..self.current.len() {
            let root = self.root(self.current[i].node);
            self.nodes[root as usize].last_row = y;
            self.current[i].node = root;
        }
        for i in 0..self.previous.len() {
            self.previous[i].node = self.root(self.previous[i].node);
        }
        // No run and no face points at these any more, so their places are free. (Path halving in `root` never leaves
        // a pinned node pointing at an unpinned one that is not a root: a root that absorbs a pinned node is pinned.)
        for i in 0..self.merged.len() {
            let index = self.merged[i];
            if !self.nodes[index as usize].pinned {
                self.free.push(index);
            }
        }
    }

    fn unite(&mut self, a: u32, b: u32, shared_sides: u64) {
        let (mut keep, mut gone) = (self.root(a), self.root(b));
        if keep == gone {
            self.nodes[keep as usize].region.perimeter -= 2 * shared_sides;
            return;
        }
        // A pinned node must never hang below an unpinned one that later dies.
        if self.nodes[gone as usize].pinned && !self.nodes[keep as usize].pinned {
            std::mem::swap(&mut keep, &mut gone);
        }
        let region = self.nodes[gone as usize].region.clone();
        self.nodes[gone as usize].parent = keep;
        self.nodes[keep as usize].region.absorb(&region, shared_sides);
        self.merged.push(gone);
    }

    fn record_faces(&mut self, core: Window, y: u64, shared: Shared, faces: &mut Faces) {
        let (at_top, at_bottom) = (shared.top && y == core.y, shared.bottom && y + 1 == core.bottom());
        for i in 0..self.current.len() {
            let Run { start, end, node } = self.current[i];
            let mut pin = false;
            if at_top {
                faces.top.push(FaceRun { start, end, region: node });
                pin = true;
            }
            if at_bottom {
                faces.bottom.push(FaceRun { start, end, region: node });
                pin = true;
            }
            if shared.left && start == core.x {
                push_vertical(&mut faces.left, y, node);
                pin = true;
            }
            if shared.right && end == core.right() {
                push_vertical(&mut faces.right, y, node);
                pin = true;
            }
            self.nodes[node as usize].pinned |= pin;
        }
    }

    /// Lets go of every region of the previous row that has no run in this one.
    fn retire(&mut self, y: u64, gate: &impl Fn(&Region) -> bool, finished: &mut Vec<Region>) {
        for i in 0..self.previous.len() {
            let index = self.previous[i].node;
            let node = &mut self.nodes[index as usize];
            // Several runs of the previous row may belong to one region: the first one retires it.
            if node.pinned || node.last_row == y || node.last_row == u64::MAX {
                continue;
            }
            node.last_row = u64::MAX;
            if gate(&node.region) {
                finished.push(node.region.clone());
            }
            self.free.push(index);
        }
    }

    fn collect_open(&mut self, out: &mut TileRegions) {
        let mut open_index = vec![u32::MAX; self.nodes.len()];
        let Faces { top, bottom, left, right } = &mut out.faces;
        for run in top.iter_mut().chain(bottom).chain(left).chain(right) {
            let root = self.root(run.region) as usize;
            if open_index[root] == u32::MAX {
                open_index[root] = out.open.len() as u32;
                out.open.push(self.nodes[root].region.clone());
            }
            run.region = open_index[root];
        }
    }
}

#[derive(Clone, Copy)]
struct Shared {
    top: bool,
    bottom: bool,
    left: bool,
    right: bool,
}

fn push_vertical(face: &mut Vec<FaceRun>, y: u64, node: u32) {
    match face.last_mut() {
        Some(last) if last.end == y && last.region == node => last.end = y + 1,
        _ => face.push(FaceRun { start: y, end: y + 1, region: node }),
    }
}

/// The first position in `from..to` whose bit is `value`.
fn next_bit(words: &[u64], from: usize, to: usize, value: bool) -> Option<usize> {
    let flip = if value { 0 } else { u64::MAX };
    let mut index = from / 64;
    let mut word = (words[index] ^ flip) & (u64::MAX << (from % 64));
    loop {
        if word != 0 {
            let position = index * 64 + word.trailing_zeros() as usize;
            return (position < to).then_some(position);
        }
        index += 1;
        if index * 64 >= to {
            return None;
        }
        word = words[index] ^ flip;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask_of(rows: &[&str]) -> Mask {
        let window = Window::whole(rows[0].len() as u64, rows.len() as u64);
        let mut mask = Mask::new(window);
        for (y, row) in rows.iter().enumerate() {
            for (x, c) in row.bytes().enumerate() {
                mask.set(x as u64, y as u64, c == b'#');
            }
        }
        mask
    }

    fn whole(rows: &[&str]) -> Vec<Region> {
        let mask = mask_of(rows);
        let mut regions = Labeller::new().label(&mask, mask.window(), mask.window(), |_| true).finished;
        regions.sort_by_key(|r| r.first);
        regions
    }

    #[test]
    fn diagonal_pixels_are_one_region() {
        let regions = whole(&["#..", ".#.", "..#"]);
        assert_eq!(regions.len(), 1);
        assert_eq!((regions[0].area, regions[0].perimeter, regions[0].first), (3, 12, (0, 0)));
    }

    #[test]
    fn a_ring_counts_both_outlines() {
        let regions = whole(&["###", "#.#", "###"]);
        assert_eq!((regions[0].area, regions[0].perimeter), (8, 12 + 4));
        assert_eq!((regions[0].sum_x, regions[0].sum_xx), (8, 3 + 2 * 4 - 1 + 4));
    }

    #[test]
    fn arms_that_meet_later_are_one_region_once() {
        let regions = whole(&["#.#.#", "#.#.#", "#####", ".....", "#...#"]);
        assert_eq!(regions.len(), 3);
        assert_eq!((regions[0].area, regions[0].bounds), (11, Window::new(0, 0, 5, 3)));
        assert_eq!(regions[0].perimeter, 5 + 3 + 3 + (5 + 2 * 4 + 2 - 2));
    }

    #[test]
    fn noise_needs_no_more_nodes_than_two_rows() {
        let (width, height) = (256u64, 200u64);
        let mut mask = Mask::new(Window::whole(width, height));
        let mut random = autoref_raster::random::SplitMix64(1);
        for y in 0..height {
            for x in 0..width {
                mask.set(x, y, random.next_u64() >> 61 == 0);
            }
        }
        let mut labeller = Labeller::new();
        labeller.label(&mask, mask.window(), mask.window(), |r| r.area > 1_000_000);
        assert!(labeller.nodes.len() <= 256, "{} nodes", labeller.nodes.len());
    }
}
