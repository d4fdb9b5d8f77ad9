//! Where the cells of a north-up raster lie, and how long they are on the ground.

use crate::coords::GeoTransform;

/// A raster grid without rotation: the outer corner of the first cell, the steps, the size.
///
/// `step_y` is negative for rasters with north up. Coordinates are in the units of the CRS, easting or longitude first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    pub x0: f64,
    pub y0: f64,
    pub step_x: f64,
    pub step_y: f64,
    pub width: u64,
    pub height: u64,
}

impl Grid {
    /// `None` when the geotransform is rotated or singular.
    pub fn new(transform: &GeoTransform, width: u64, height: u64) -> Option<Grid> {
        let g = transform.0;
        let plain = g[2] == 0.0 && g[4] == 0.0 && g[1] != 0.0 && g[5] != 0.0;
        let finite = g.iter().all(|v| v.is_finite());
        (plain && finite).then_some(Grid { x0: g[0], y0: g[3], step_x: g[1], step_y: g[5], width, height })
    }

    pub fn transform(&self) -> GeoTransform {
        GeoTransform([self.x0, self.step_x, 0.0, self.y0, 0.0, self.step_y])
    }

    /// The grid of means over `factor` × `factor` cells; parts of cells at the right and at the bottom are kept.
    pub fn coarser(&self, factor: u64) -> Grid {
        Grid {
            step_x: self.step_x * factor as f64,
            step_y: self.step_y * factor as f64,
            width: self.width.div_ceil(factor),
            height: self.height.div_ceil(factor),
            ..*self
        }
    }

    /// West, south, east, north.
    pub fn bounds(&self) -> [f64; 4] {
        let (x1, y1) = (self.x0 + self.step_x * self.width as f64, self.y0 + self.step_y * self.height as f64);
        [self.x0.min(x1), self.y0.min(y1), self.x0.max(x1), self.y0.max(y1)]
    }

    /// The common part of two grids' areas, if there is any.
    pub fn overlap(&self, other: &Grid) -> Option<[f64; 4]> {
        let (a, b) = (self.bounds(), other.bounds());
        let common = [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])];
        (common[0] < common[2] && common[1] < common[3]).then_some(common)
    }

    /// The middle of the grid.
    pub fn centre(&self) -> (f64, f64) {
        (self.x0 + self.step_x * self.width as f64 / 2.0, self.y0 + self.step_y * self.height as f64 / 2.0)
    }
}

/// What a unit of the CRS is on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GroundUnit {
    /// A projected CRS: metres of a unit.
    Projected { metres_per_unit: f64 },
    /// Degrees on an ellipsoid.
    Geographic { semi_major_m: f64, eccentricity2: f64 },
}

impl GroundUnit {
    /// Metres.
    pub const METRES: GroundUnit = GroundUnit::Projected { metres_per_unit: 1.0 };
    /// Degrees on the ellipsoid of WGS 84; that of GRS 80 differs by a tenth of a millimetre.
    pub const WGS84: GroundUnit =
        GroundUnit::Geographic { semi_major_m: 6_378_137.0, eccentricity2: 0.006_694_379_990_14 };

    /// Metres in a unit of x and of y at this y (a latitude in degrees, where the CRS is geographic).
    ///
    /// The radii of curvature across and along the meridian (Torge and Müller, *Geodesy*, 2012, equations 4.13 and
    /// 4.14).
    pub fn metres_per_unit(&self, y: f64) -> (f64, f64) {
        match *self {
            GroundUnit::Projected { metres_per_unit } => (metres_per_unit, metres_per_unit),
            GroundUnit::Geographic { semi_major_m, eccentricity2 } => {
                let latitude = y.to_radians();
                let w2 = 1.0 - eccentricity2 * latitude.sin().powi(2);
                let across = semi_major_m / w2.sqrt() * latitude.cos();
                let along = semi_major_m * (1.0 - eccentricity2) / w2.powf(1.5);
                (across.to_radians(), along.to_radians())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_degree_at_the_equator_and_at_sixty() {
        let (x, y) = GroundUnit::WGS84.metres_per_unit(0.0);
        assert!((x - 111_319.490_8).abs() < 1e-3 && (y - 110_574.275_8).abs() < 1e-3, "{x} {y}");
        let (x, y) = GroundUnit::WGS84.metres_per_unit(60.0);
        assert!((x - 55_800.0).abs() < 1.0 && (y - 111_412.2).abs() < 1.0, "{x} {y}");
    }
}
