//! Worlds of a reference system: what its coordinates count in, and the way to longitude and latitude.

use std::path::Path;

use anyhow::{Context as _, Result, bail};
use autoref_flight::read::Reconstruction;
use autoref_flight::world::{Geodesy, World};
use autoref_raster::crs::{Coordinate, Crs, Way};
use nalgebra::Vector3;

/// Of a map's datum against WGS 84, metres: a block's shape does not depend on it.
pub const DATUM_M: f64 = 100.0;

/// Both ways, found once: every point of a block takes them.
struct Proj {
    there: Way,
    back: Way,
    units: Units,
}

/// What coordinates count in: a unit of the map's plan in units of its CRS and in metres, and one of heights in metres.
#[derive(Clone, Copy)]
struct Units {
    of_crs: f64,
    plan_m: f64,
    height_m: f64,
}

impl Units {
    fn of(crs: &Crs) -> Self {
        Units { of_crs: 1.0, plan_m: crs.metres_per_unit(), height_m: height_unit_m(crs) }
    }
    /// Metres throughout, whatever the CRS counts in.
    fn metres(crs: &Crs) -> Self {
        Units { of_crs: 1.0 / crs.metres_per_unit(), plan_m: 1.0, height_m: 1.0 }
    }
}

/// Metres in a unit of a system's heights: of its vertical axis, else of the horizontal ones, else (degrees) the metre.
pub fn height_unit_m(crs: &Crs) -> f64 {
    let plan_m = if crs.is_geographic() { 1.0 } else { crs.metres_per_unit() };
    crs.height_metres_per_unit().unwrap_or(plan_m)
}

impl Proj {
    fn around(crs: &Crs, units: Units, centre: [f64; 3]) -> Result<Self> {
        let earth = Crs::from_epsg(4326)?;
        let mut at = [Coordinate { x: centre[0] * units.of_crs, y: centre[1] * units.of_crs, height: None }];
        let there = crs.way(&at, &earth, DATUM_M)?;
        there.transform(&mut at)?;
        Ok(Proj { there, back: earth.way(&at, crs, DATUM_M)?, units })
    }
}

impl Geodesy for Proj {
    fn to_geographic(&self, map: [f64; 3]) -> Option<[f64; 3]> {
        let Units { of_crs, height_m, .. } = self.units;
        let mut p = [Coordinate { x: map[0] * of_crs, y: map[1] * of_crs, height: None }];
        self.there.transform(&mut p).ok()?;
        Some([p[0].x, p[0].y, map[2] * height_m])
    }
    fn map_of_geographic(&self, g: [f64; 3]) -> Option<[f64; 3]> {
        let mut p = [Coordinate { x: g[0], y: g[1], height: None }];
        self.back.transform(&mut p).ok()?;
        let Units { of_crs, height_m, .. } = self.units;
        Some([p[0].x / of_crs, p[0].y / of_crs, g[2] / height_m])
    }
    fn units_m(&self) -> [f64; 2] {
        [self.units.plan_m, self.units.height_m]
    }
}

/// The world about a place in the units of its CRS.
pub fn world_of(crs: Option<&Crs>, centre: [f64; 3]) -> Result<World> {
    match crs.filter(|c| !c.is_local()) {
        None => Ok(World::flat(centre)),
        Some(crs) => curved(crs, Units::of(crs), centre),
    }
}

/// The world about a place of the map that is given in metres, as all others are to be.
pub fn metric_world_of(crs: &Crs, centre_m: [f64; 3]) -> Result<World> {
    if crs.is_local() { Ok(World::flat(centre_m)) } else { curved(crs, Units::metres(crs), centre_m) }
}

/// Brings cameras that stand in a map (`cameras.json`) to the tangent frame at their middle, metres: what lies straight
/// on the ground lies so there, whatever the map does to it.
///
/// # Errors
/// When the map is one of degrees, or has no place on the Earth for one of them.
pub fn straighten(model: &mut Reconstruction, path: &Path) -> Result<()> {
    let stated = model.crs.take().filter(|word| !word.trim().eq_ignore_ascii_case("local"));
    let Some(crs) = stated.as_deref().map(Crs::parse).transpose()? else { return Ok(()) };
    if crs.is_geographic() {
        bail!("{}: its cameras stand in degrees ({}); give them in a projected CRS", path.display(), crs.title());
    }
    let sum: Vector3<f64> = model.photographs.iter().map(|p| p.pose.centre).sum();
    let middle = sum / model.photographs.len().max(1) as f64;
    let outside = |what: String| format!("{}: {what} outside {}; correct `C` or `crs`", path.display(), crs.title());
    let world = world_of(Some(&crs), middle.into()).ok().with_context(|| outside("its cameras lie".into()))?;
    for p in &mut model.photographs {
        let posed = world.pose_to_world(&p.pose);
        p.pose = posed.with_context(|| outside(format!("the camera of `{}` lies", p.name)))?;
    }
    Ok(())
}

fn curved(crs: &Crs, units: Units, centre: [f64; 3]) -> Result<World> {
    let world = Proj::around(crs, units, centre).ok().and_then(|proj| World::curved(Box::new(proj), centre));
    world.with_context(|| format!("{}: the points lie outside it; give --crs, or crs in FLIGHT.toml", crs.title()))
}

/// Whether a system is the longitudes and latitudes of WGS 84.
pub fn is_wgs84(crs: &Crs) -> bool {
    crs.is_geographic() && matches!(crs.epsg(), Some(4326 | 4979))
}
