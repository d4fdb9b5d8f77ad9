//! Where the pixels of a chip lie: what is shown of the image, and what the fit of its mark must see.

use crate::detector::Detector;
use autoref_raster::RasterInfo;
use autoref_raster::coords::PixelPoint;
use autoref_raster::window::Window;

/// What to cut out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    pub centre: PixelPoint,
    /// Side of the window, image pixels.
    pub side_px: u64,
    /// Longest side of the mark whose fitted outline is wanted.
    pub mark_px: Option<f64>,
}

impl Spot {
    /// The window of a mark whose region has these sides.
    pub fn of_mark(centre: PixelPoint, size_px: f64) -> Spot {
        let side_px = ((2.2 * size_px + 26.0).clamp(48.0, 640.0) / 8.0).round() as u64 * 8;
        Spot { centre, side_px, mark_px: Some(size_px) }
    }
}

/// Where the pixels of a spot lie.
pub(super) struct Frame {
    pub left: i64,
    pub top: i64,
    /// What is seen of the image; empty when the window lies outside.
    pub shown: Window,
    /// What the fit of the mark must see.
    pub mark: Option<Window>,
    /// All that must be read for both.
    pub read: Window,
}

impl Frame {
    pub fn new(spot: &Spot, info: &RasterInfo, detector: &dyn Detector) -> Frame {
        let (x, y) = (spot.centre.x.floor() as i64, spot.centre.y.floor() as i64);
        let (half, side) = (spot.side_px as i64 / 2, spot.side_px as i64);
        let (left, top) = (x - half, y - half);
        let clamp = |v: i64, limit: u64| v.clamp(0, limit as i64) as u64;
        let (x0, y0) = (clamp(left, info.width), clamp(top, info.height));
        let (x1, y1) = (clamp(left + side, info.width), clamp(top + side, info.height));
        let shown = Window::new(x0, y0, x1 - x0, y1 - y0);
        let inside = x >= 0 && y >= 0 && info.bounds().contains(x as u64, y as u64);
        let mark = spot.mark_px.filter(|_| inside).map(|size_px| {
            let reach = (size_px / 2.0).ceil() as u64 + 2 + detector.patch_margin_px();
            Window::new(x as u64, y as u64, 1, 1).grown(reach, &info.bounds())
        });
        let wanted = mark.map_or(shown, |mark| shown.union(&mark));
        Frame { left, top, shown, mark, read: wanted.grown(detector.halo_px(), &info.bounds()) }
    }
}
