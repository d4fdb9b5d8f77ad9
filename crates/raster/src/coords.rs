//! Points in the image and on the map, as types that cannot be mixed. The conventions are written once, in
//! `docs/coordinates.md`.
//!
//! ```
//! use autoref_raster::coords::{GeoTransform, PixelPoint};
//! let transform = GeoTransform([570_000.0, 0.03, 0.0, 7_032_000.0, 0.0, -0.03]);
//! let ground = transform.apply(PixelPoint { x: 0.5, y: 0.5 }); // the centre of the first pixel
//! assert_eq!(ground.easting, 570_000.015);
//! let back = transform.invert(ground).expect("a rotation and a scale");
//! assert!((back.x - 0.5).abs() < 1e-6);
//! ```

use serde::{Deserialize, Serialize};

/// A position in the image, in pixels: x to the right, y down, `(0, 0)` the outer corner of the first pixel, whose
/// centre is `(0.5, 0.5)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PixelPoint {
    pub x: f64,
    pub y: f64,
}

/// A position on the map, in the units of its CRS (metres wherever something is fitted): easting, northing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapPoint {
    pub easting: f64,
    pub northing: f64,
}

/// An affine image → map transform in GDAL's order:
/// `easting = g[0] + g[1]·x + g[2]·y`, `northing = g[3] + g[4]·x + g[5]·y`, with (x, y) a [`PixelPoint`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GeoTransform(pub [f64; 6]);

impl GeoTransform {
    /// Through the map positions of the first pixel's outer corner, of the point `width_px` to its right and of the one
    /// `height_px` below it.
    pub fn through(origin: MapPoint, right: MapPoint, down: MapPoint, (width_px, height_px): (f64, f64)) -> Self {
        GeoTransform([
            origin.easting,
            (right.easting - origin.easting) / width_px,
            (down.easting - origin.easting) / height_px,
            origin.northing,
            (right.northing - origin.northing) / width_px,
            (down.northing - origin.northing) / height_px,
        ])
    }

    /// Image (pixels from the outer corner of the first, y down) → map.
    pub fn apply(&self, p: PixelPoint) -> MapPoint {
        let g = &self.0;
        MapPoint { easting: g[0] + g[1] * p.x + g[2] * p.y, northing: g[3] + g[4] * p.x + g[5] * p.y }
    }

    /// Map → image. `None` when the transform is singular or not finite.
    pub fn invert(&self, m: MapPoint) -> Option<PixelPoint> {
        let g = &self.0;
        let det = g[1] * g[5] - g[2] * g[4];
        if !det.is_finite() || det == 0.0 {
            return None;
        }
        let (de, dn) = (m.easting - g[0], m.northing - g[3]);
        Some(PixelPoint { x: (g[5] * de - g[2] * dn) / det, y: (g[1] * dn - g[4] * de) / det })
    }

    /// How far apart, in pixels of `self`, two transforms put the points of the first 10,000 × 10,000 pixels at most;
    /// infinite when `self` has no inverse.
    pub fn differs_px(&self, other: &GeoTransform) -> f64 {
        // Affine, so the largest difference is at a corner.
        [(0.0, 0.0), (1e4, 0.0), (0.0, 1e4), (1e4, 1e4)]
            .into_iter()
            .map(|(x, y)| {
                let back = self.invert(other.apply(PixelPoint { x, y }));
                back.map_or(f64::INFINITY, |p| (p.x - x).hypot(p.y - y))
            })
            .fold(0.0, f64::max)
    }

    /// Pixels counted as if they were places, rows downwards: what programs write for a raster without a georeference.
    pub fn counts_pixels(&self) -> bool {
        self.0 == [0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    }

    /// Ground size of a pixel, in map units: √|det|.
    pub fn scale(&self) -> f64 {
        (self.0[1] * self.0[5] - self.0[2] * self.0[4]).abs().sqrt()
    }
}

/// Whether a picture shows its object as it is, or as a mirror does. In JSON it is `true` when mirrored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(from = "bool", into = "bool")]
pub enum Handedness {
    #[default]
    AsIs,
    Mirrored,
}

impl Handedness {
    pub const BOTH: [Handedness; 2] = [Handedness::AsIs, Handedness::Mirrored];

    /// Whether it is as in a mirror.
    pub fn is_mirrored(self) -> bool {
        self == Handedness::Mirrored
    }

    /// −1 when mirrored: the factor of the axis that is turned over.
    pub fn sign(self) -> f64 {
        match self {
            Handedness::AsIs => 1.0,
            Handedness::Mirrored => -1.0,
        }
    }
}

impl From<bool> for Handedness {
    fn from(mirrored: bool) -> Self {
        if mirrored { Handedness::Mirrored } else { Handedness::AsIs }
    }
}

impl From<Handedness> for bool {
    fn from(handedness: Handedness) -> bool {
        handedness.is_mirrored()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invert_after_apply_is_identity() {
        let t = GeoTransform([570_000.25, 0.03, -0.004, 7_032_000.5, -0.004, -0.03]);
        let p = PixelPoint { x: 15_827.5, y: 47_618.25 };
        let q = t.invert(t.apply(p)).expect("a rotation is not singular");
        assert!((p.x - q.x).abs() < 1e-6 && (p.y - q.y).abs() < 1e-6);
    }

    #[test]
    fn a_singular_transform_has_no_inverse() {
        assert!(GeoTransform([0.0; 6]).invert(MapPoint { easting: 1.0, northing: 1.0 }).is_none());
    }
}
