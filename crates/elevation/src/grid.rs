//! Where the cells of a north-up raster lie, and how long they are on the ground.

use nalgebra::Vector3;

use crate::coords::GeoTransform;
use crate::crs::Crs;

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

    /// Cells, from the outer corner of the first, to the map.
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
    /// A projected CRS whose units differ from those of the ground, from row to row otherwise, as Mercator's do.
    Stretched(Stretch),
    /// Degrees on an ellipsoid.
    Geographic { semi_major_m: f64, eccentricity2: f64 },
}

/// What a unit of a projected CRS is on the ground in the rows of a grid, along its middle column: logarithms of metres
/// as Chebyshev polynomials of y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    middle: f64,
    half: f64,
    across: [f64; TERMS],
    along: [f64; TERMS],
}

/// Terms of a stretch: for a map of the whole Earth good to a fifth of a per cent, of a country to a millionth.
const TERMS: usize = 11;
/// A unit that differs less from a metre of the ground is the map's own business, as in UTM.
const STRETCHED: f64 = 0.01;
/// The cosine of the angle between the axes on the ground, up to which a cell's area is the product of its sides.
const ASLANT: f64 = 0.02;

impl Stretch {
    /// `None` where no row is stretched by more than a hundredth, where the axes are not at right angles on the ground
    /// (as in sinusoidal maps, whose areas are the ground's all the same), or the CRS does not say where all rows lie.
    pub fn of(grid: &Grid, crs: &Crs) -> Option<Stretch> {
        let [_, south, _, north] = grid.bounds();
        let (x, middle, half) = (grid.centre().0, (south + north) / 2.0, (north - south) / 2.0);
        let angle = |k: usize| std::f64::consts::PI * (k as f64 + 0.5) / TERMS as f64;
        let step = STEP_M / crs.metres_per_unit();
        let places: Vec<(f64, f64)> = (0..TERMS)
            .map(|k| middle + half * angle(k).cos())
            .flat_map(|y| [(x - step, y), (x + step, y), (x, y - step), (x, y + step)])
            .collect();
        let on_ground = crs.on_own_ellipsoid(&places)?;
        // The chord between two places: longitudes turn about a pole.
        let apart = |a: &[f64; 3], b: &[f64; 3]| Vector3::from(*b) - Vector3::from(*a);
        let sides = on_ground.as_chunks::<4>().0.iter().map(|[west, east, south, north]| {
            let (across, along) = (apart(west, east), apart(south, north));
            let is_aslant = across.dot(&along).abs() > ASLANT * across.norm() * along.norm();
            (!is_aslant).then(|| (across.norm() / (2.0 * step), along.norm() / (2.0 * step)))
        });
        let (across, along): (Vec<f64>, Vec<f64>) = sides.collect::<Option<Vec<_>>>()?.into_iter().unzip();
        let is_plain = |metres: &f64| (metres / crs.metres_per_unit() - 1.0).abs() <= STRETCHED;
        let is_length = |metres: &f64| metres.is_normal() && *metres > 0.0;
        let mut all = across.iter().chain(&along);
        if !all.clone().all(is_length) || all.all(is_plain) {
            return None;
        }
        let terms = |metres: &[f64]| -> [f64; TERMS] {
            std::array::from_fn(|j| {
                let term = |k: usize| metres[k].ln() * (j as f64 * angle(k)).cos();
                (0..TERMS).map(term).sum::<f64>() * if j == 0 { 1.0 } else { 2.0 } / TERMS as f64
            })
        };
        Some(Stretch { middle, half, across: terms(&across), along: terms(&along) })
    }

    /// Metres in a unit of x and of y. Beyond the grid as in its last row.
    fn metres_per_unit(&self, y: f64) -> (f64, f64) {
        let angle = ((y - self.middle) / self.half).clamp(-1.0, 1.0).acos();
        let at = |terms: &[f64; TERMS]| -> f64 {
            terms.iter().enumerate().map(|(j, term)| term * (j as f64 * angle).cos()).sum::<f64>().exp()
        };
        (at(&self.across), at(&self.along))
    }
}

/// How far to either side of a place the ground is looked at, metres of the map: as long as degrees are exact to a
/// billionth.
const STEP_M: f64 = 100.0;

impl GroundUnit {
    /// Metres.
    pub const METRES: GroundUnit = GroundUnit::Projected { metres_per_unit: 1.0 };
    /// Degrees on the ellipsoid of WGS 84; that of GRS 80 differs by a tenth of a millimetre.
    pub const WGS84: GroundUnit =
        GroundUnit::Geographic { semi_major_m: 6_378_137.0, eccentricity2: 0.006_694_379_990_14 };

    /// Whether cells of one row are larger on the ground than those of another.
    pub fn varies(&self) -> bool {
        !matches!(self, GroundUnit::Projected { .. })
    }

    /// Metres in a unit of x and of y at this y (a latitude in degrees, where the CRS is geographic).
    ///
    /// The radii of curvature across and along the meridian (Torge and Müller, *Geodesy*, 2012, equations 4.13 and
    /// 4.14).
    pub fn metres_per_unit(&self, y: f64) -> (f64, f64) {
        match *self {
            GroundUnit::Projected { metres_per_unit } => (metres_per_unit, metres_per_unit),
            GroundUnit::Stretched(stretch) => stretch.metres_per_unit(y),
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

    fn grid_of(x: f64, y: f64, step: f64) -> Grid {
        let transform = GeoTransform([x, step, 0.0, y, 0.0, -step]);
        Grid::new(&transform, 1000, 1000).expect("north up")
    }

    /// Web Mercator maps the ellipsoid as if it were a sphere of its greater axis: a unit is as long as the parallel is
    /// to the equator.
    #[test]
    fn a_unit_of_mercator_is_the_shorter_the_nearer_the_pole() {
        let crs = Crs::from_epsg(3857).expect("PROJ knows it");
        let unit = GroundUnit::Stretched(Stretch::of(&grid_of(1e6, 15e6, 1000.0), &crs).expect("stretched"));
        for y in [14.0e6, 14.3e6, 14.9e6f64] {
            let latitude = (y / 6_378_137.0).sinh().atan();
            let (mx, my) = GroundUnit::WGS84.metres_per_unit(latitude.to_degrees());
            let expected = (mx.to_degrees() / 6_378_137.0, my.to_degrees() * latitude.cos() / 6_378_137.0);
            let (across, along) = unit.metres_per_unit(y);
            assert!((across / expected.0 - 1.0).abs() < 1e-6, "{y}: {across} for {}", expected.0);
            assert!((along / expected.1 - 1.0).abs() < 1e-6, "{y}: {along} for {}", expected.1);
        }
        let whole = GroundUnit::Stretched(Stretch::of(&grid_of(-2e7, 2e7, 40_000.0), &crs).expect("stretched"));
        for y in [0.0, 4e6, 9e6, 1.3e7, 1.9e7f64] {
            let (across, expected) = (whole.metres_per_unit(y).0, 1.0 / (y / 6_378_137.0).cosh());
            assert!((across / expected - 1.0).abs() < 0.006, "{y}: {across} for {expected}");
        }
    }

    /// Wherever the pole lies in the grid: a row goes through it.
    #[test]
    fn polar_maps_are_stretched_alike_in_all_rows() {
        for (code, at_pole) in [(3413, 1.0 / 0.9698), (3031, 1.0 / 0.9727)] {
            let crs = Crs::from_epsg(code).expect("PROJ knows it");
            for beside in [0.0, 50_000.0] {
                let grid = grid_of(-1e6 + beside, 1e6 + beside, 2000.0);
                let unit = GroundUnit::Stretched(Stretch::of(&grid, &crs).expect("stretched"));
                for y in [0.0, 190_000.0, -400_000.0, 900_000.0] {
                    let (across, along) = unit.metres_per_unit(y);
                    assert!((across / at_pole - 1.0).abs() < 0.01, "{code}, {y}: {across} for {at_pole}");
                    assert!((along / across - 1.0).abs() < 1e-3, "{code}, {y}: {across} and {along}");
                }
            }
        }
        let ups = Crs::from_epsg(32661).expect("PROJ knows it");
        assert_eq!(Stretch::of(&grid_of(1e6, 3e6, 2000.0), &ups), None, "within a hundredth");
    }

    #[test]
    fn the_moon_is_measured_on_the_moon_and_slanting_axes_are_left() {
        let moon = Crs::parse("+proj=eqc +R=1737400 +units=m +no_defs").expect("PROJ knows it");
        assert_eq!(Stretch::of(&grid_of(-1000.0, 1000.0, 2.0), &moon), None);
        let sinusoidal = Crs::parse("+proj=sinu +datum=WGS84 +units=m +no_defs").expect("PROJ knows it");
        assert_eq!(Stretch::of(&grid_of(3_300_000.0, 6_660_000.0, 16.0), &sinusoidal), None);
    }

    #[test]
    fn units_of_utm_and_of_feet_are_the_maps_own() {
        for (code, x, y) in
            [(32633, 500_000.0, 8_700_000.0), (25832, 600_000.0, 6_000_000.0), (2263, 980_000.0, 200_000.0)]
        {
            let crs = Crs::from_epsg(code).expect("PROJ knows it");
            assert_eq!(Stretch::of(&grid_of(x, y, 10.0), &crs), None, "{code}");
        }
    }

    #[test]
    fn a_degree_at_the_equator_and_at_sixty() {
        let (x, y) = GroundUnit::WGS84.metres_per_unit(0.0);
        assert!((x - 111_319.490_8).abs() < 1e-3 && (y - 110_574.275_8).abs() < 1e-3, "{x} {y}");
        let (x, y) = GroundUnit::WGS84.metres_per_unit(60.0);
        assert!((x - 55_800.0).abs() < 1.0 && (y - 111_412.2).abs() < 1.0, "{x} {y}");
    }
}
