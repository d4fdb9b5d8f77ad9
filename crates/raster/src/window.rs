//! Rectangles of pixels and how a raster is cut into them. No input or output here.
//!
//! ```
//! use autoref_raster::window::Window;
//! let tile = Window::new(4096, 0, 4096, 4096);
//! assert!(tile.contains(4096, 0) && !tile.contains(8192, 0)); // half-open
//! assert_eq!(Window::whole(500_000, 500_000).area(), 250_000_000_000); // 64 bits
//! ```

/// A half-open rectangle of pixels: columns `x..x+width`, rows `y..y+height`.
///
/// 64 bits, because areas overflow 32.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Window {
    pub x: u64,
    pub y: u64,
    pub width: u64,
    pub height: u64,
}

impl Window {
    /// `width` × `height` pixels from column `x` and row `y` on.
    pub const fn new(x: u64, y: u64, width: u64, height: u64) -> Self {
        Window { x, y, width, height }
    }

    /// The window of a whole raster.
    pub const fn whole(width: u64, height: u64) -> Self {
        Window { x: 0, y: 0, width, height }
    }

    /// The first column beyond it.
    pub const fn right(&self) -> u64 {
        self.x + self.width
    }

    /// The first row beyond it.
    pub const fn bottom(&self) -> u64 {
        self.y + self.height
    }

    /// Whether no pixel lies in it.
    pub const fn is_empty(&self) -> bool {
        self.width == 0 || self.height == 0
    }

    /// Number of pixels.
    pub const fn area(&self) -> u64 {
        self.width * self.height
    }

    /// Whether the pixel in column `x` and row `y` lies in it.
    pub const fn contains(&self, x: u64, y: u64) -> bool {
        x >= self.x && x < self.right() && y >= self.y && y < self.bottom()
    }

    /// Whether all pixels of `other` lie in it.
    pub const fn contains_window(&self, other: &Window) -> bool {
        other.x >= self.x && other.right() <= self.right() && other.y >= self.y && other.bottom() <= self.bottom()
    }

    /// The common part, empty (zero size) when there is none.
    pub fn intersect(&self, other: &Window) -> Window {
        let x = self.x.max(other.x);
        let y = self.y.max(other.y);
        let right = self.right().min(other.right());
        let bottom = self.bottom().min(other.bottom());
        Window { x, y, width: right.saturating_sub(x), height: bottom.saturating_sub(y) }
    }

    /// The smallest window that holds both.
    pub fn union(&self, other: &Window) -> Window {
        let (x, y) = (self.x.min(other.x), self.y.min(other.y));
        let (right, bottom) = (self.right().max(other.right()), self.bottom().max(other.bottom()));
        Window { x, y, width: right - x, height: bottom - y }
    }

    /// Grown by `margin_px` on every side and clipped to `bounds`.
    pub fn grown(&self, margin_px: u64, bounds: &Window) -> Window {
        let x = self.x.saturating_sub(margin_px);
        let y = self.y.saturating_sub(margin_px);
        let right = self.right().saturating_add(margin_px);
        let bottom = self.bottom().saturating_add(margin_px);
        Window { x, y, width: right - x, height: bottom - y }.intersect(bounds)
    }
}

/// One unit of work: it owns the pixels of `core` and sees those of `read`, which is the core and its halo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Row-major index in the grid.
    pub id: u64,
    pub core: Window,
    pub read: Window,
}

/// A raster cut into tiles. The last column and row are smaller when the size does not divide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileGrid {
    bounds: Window,
    tile_width: u64,
    tile_height: u64,
    halo_px: u64,
}

impl TileGrid {
    /// Tiles of `tile_width` × `tile_height` pixels (each at least 1, clipped to the raster) with a halo of `halo_px`.
    pub fn new(raster_width: u64, raster_height: u64, tile_width: u64, tile_height: u64, halo_px: u64) -> Self {
        TileGrid {
            bounds: Window::whole(raster_width, raster_height),
            tile_width: tile_width.clamp(1, raster_width.max(1)),
            tile_height: tile_height.clamp(1, raster_height.max(1)),
            halo_px,
        }
    }

    /// The whole raster.
    pub fn bounds(&self) -> Window {
        self.bounds
    }

    /// Width of a tile's core, but for the last column, pixels.
    pub fn tile_width(&self) -> u64 {
        self.tile_width
    }

    /// Height of a tile's core, but for the last row, pixels.
    pub fn tile_height(&self) -> u64 {
        self.tile_height
    }

    /// What is read beyond the core on every side, as far as the raster goes.
    pub fn halo_px(&self) -> u64 {
        self.halo_px
    }

    /// Tiles from left to right.
    pub fn columns(&self) -> u64 {
        self.bounds.width.div_ceil(self.tile_width)
    }

    /// Tiles from top to bottom.
    pub fn rows(&self) -> u64 {
        self.bounds.height.div_ceil(self.tile_height)
    }

    /// Number of tiles.
    pub fn len(&self) -> u64 {
        self.columns() * self.rows()
    }

    /// Whether there is no tile.
    pub fn is_empty(&self) -> bool {
        self.bounds.is_empty()
    }

    /// # Panics
    /// When `id` is not below [`TileGrid::len`].
    pub fn tile(&self, id: u64) -> Tile {
        assert!(id < self.len(), "tile {id} of {}", self.len());
        let (row, column) = (id / self.columns(), id % self.columns());
        let core = Window::new(column * self.tile_width, row * self.tile_height, self.tile_width, self.tile_height)
            .intersect(&self.bounds);
        Tile { id, core, read: core.grown(self.halo_px, &self.bounds) }
    }

    /// The tiles whose cores a window that lies in the raster reaches into, row by row.
    pub fn tiles_of(&self, window: &Window) -> impl Iterator<Item = u64> + use<> {
        let (columns, width, height) = (self.columns(), self.tile_width, self.tile_height);
        let across = window.x / width..window.right().div_ceil(width);
        let down = window.y / height..window.bottom().div_ceil(height);
        down.flat_map(move |row| across.clone().map(move |column| row * columns + column))
    }

    /// All tiles in row-major order.
    pub fn iter(&self) -> impl Iterator<Item = Tile> + '_ {
        (0..self.len()).map(|id| self.tile(id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn cores_cover_the_raster_once(w in 1u64..200, h in 1u64..200, tw in 1u64..70, th in 1u64..70, halo in 0u64..20) {
            let grid = TileGrid::new(w, h, tw, th, halo);
            let mut seen = vec![0u8; (w * h) as usize];
            for tile in grid.iter() {
                prop_assert!(tile.read.contains_window(&tile.core));
                prop_assert!(grid.bounds().contains_window(&tile.read));
                for y in tile.core.y..tile.core.bottom() {
                    for x in tile.core.x..tile.core.right() {
                        seen[(y * w + x) as usize] += 1;
                    }
                }
            }
            prop_assert!(seen.iter().all(|&n| n == 1));
        }
    }

    #[test]
    fn disjoint_windows_have_an_empty_intersection() {
        assert!(Window::new(0, 0, 4, 4).intersect(&Window::new(4, 0, 4, 4)).is_empty());
    }
}
