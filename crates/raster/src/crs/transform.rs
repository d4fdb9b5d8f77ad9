//! Coordinates from one system into another, with what the authority says of its accuracy.
//!
//! PROJ knows several operations between two systems, some of which need grids that may not be installed. Left to
//! itself it falls back on a "ballpark" operation that ignores the change of datum, or the height of the geoid, in
//! silence. Here ballpark operations are never taken, and the best operation that can be carried out must be as
//! accurate as the caller demands; otherwise it is an error.

use std::collections::HashMap;
use std::sync::{LazyLock, Mutex};

use gdal::spatial_ref::{AxisMappingStrategy, CoordTransform, CoordTransformOptions, SpatialRef};

use super::Crs;
use crate::error::{Error, Result};

/// Worst accuracy of a change of datum that is taken without being asked for, metres. Changes between the satellite
/// datums (WGS 84 to ETRS89, NZGD2000, SIRGAS 2000, …) are stated as 1 m; a grid for heights adds some centimetres.
pub const DEFAULT_DATUM_ACCURACY_M: f64 = 1.5;

/// A point on the map, in the units of its system: easting or longitude first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coordinate {
    pub x: f64,
    pub y: f64,
    pub height: Option<f64>,
}

/// How far the result may be off through the change of datum itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Accuracy {
    /// A projection only: nothing is lost.
    Exact,
    /// By the authority's word, metres.
    Metres(f64),
    /// The parameters come from the definition itself; nobody says how good they are.
    Unstated,
}

/// What projections have, and no change of datum.
const EXACT_M: f64 = 1e-6;

/// Tried in this order, metres: PROJ takes an upper bound, it does not tell the figure. Zero would mean any.
const LADDER_M: [f64; 18] =
    [EXACT_M, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0];

/// Two definitions and the bounds of what lies between them, degrees as bits.
type Question = (String, String, Option<[u64; 4]>);

/// Which bound of [`LADDER_M`] is the narrowest that works, of what was asked before: a job asks the same several
/// times.
static NARROWEST: LazyLock<Mutex<HashMap<Question, usize>>> = LazyLock::new(Mutex::default);
const MOST_KNOWN: usize = 256;

/// A way from one CRS to another.
pub struct Way {
    from: Crs,
    to: Crs,
    transform: CoordTransform,
    with_heights: bool,
    accuracy: Accuracy,
}

impl Way {
    /// Heights change only where both systems have them.
    ///
    /// # Errors
    /// When a point lies outside.
    pub fn transform(&self, points: &mut [Coordinate]) -> Result<()> {
        let (mut x, mut y): (Vec<f64>, Vec<f64>) = points.iter().map(|p| (p.x, p.y)).unzip();
        let mut z: Vec<f64> =
            if self.with_heights { points.iter().map(|p| p.height.unwrap_or(0.0)).collect() } else { Vec::new() };
        let failed = |what: &str| self.from.failed(&self.to, what, "look at the order of the columns and at --crs");
        self.transform.transform_coords(&mut x, &mut y, &mut z).map_err(|e| failed(&e.to_string()))?;
        for (i, point) in points.iter_mut().enumerate() {
            let height = if self.with_heights { point.height.map(|_| z[i]) } else { point.height };
            if !x[i].is_finite() || !y[i].is_finite() || height.is_some_and(|h| !h.is_finite()) {
                return Err(failed(&format!("the point {}, {} lies outside", point.x, point.y)));
            }
            *point = Coordinate { x: x[i], y: y[i], height };
        }
        Ok(())
    }
}

impl Crs {
    /// Brings points into another system, in place. Heights are changed when both systems have a vertical axis, else
    /// left.
    ///
    /// `worst_accuracy_m`: what is demanded of a change of datum, see [`DEFAULT_DATUM_ACCURACY_M`].
    ///
    /// # Errors
    /// When PROJ knows no operation that is good enough with the grids that are installed, or a point lies outside.
    pub fn transform(&self, points: &mut [Coordinate], to: &Crs, worst_accuracy_m: f64) -> Result<Accuracy> {
        if self.wkt == to.wkt || points.is_empty() {
            return Ok(Accuracy::Exact);
        }
        if self.is_local() || to.is_local() {
            let local = if self.is_local() { self } else { to };
            return Err(self.failed(
                to,
                &format!("{} has no relation to the Earth", local.title()),
                "give another CRS",
            ));
        }
        let way = self.way(points, to, worst_accuracy_m)?;
        way.transform(points)?;
        Ok(way.accuracy)
    }

    /// The operation for points around these, to be used many times: PROJ's search for it takes far longer than its
    /// use.
    ///
    /// # Errors
    /// When PROJ knows no operation that is good enough with the grids that are installed.
    pub fn way(&self, around: &[Coordinate], to: &Crs, worst_accuracy_m: f64) -> Result<Way> {
        let (transform, accuracy) = self.operation(around, to)?;
        match accuracy {
            Accuracy::Metres(metres) if metres > worst_accuracy_m => {
                let grids = self.missing_grids(around, to);
                let why =
                    format!("the best transformation that is installed is good to {metres} m only{}", and_miss(&grids));
                return Err(Error::CoarseDatum {
                    what: self.cannot(to, &why),
                    install: format!("install the datum grid ({})", how_to_install(&grids)),
                    otherwise: "give the points in their own datum".into(),
                });
            }
            _ => {}
        }
        let with_heights = self.height_metres_per_unit.is_some() && to.height_metres_per_unit.is_some();
        Ok(Way { from: self.clone(), to: to.clone(), transform, with_heights, accuracy })
    }

    /// The best operation that can be carried out, and how good it is.
    fn operation(&self, points: &[Coordinate], to: &Crs) -> Result<(CoordTransform, Accuracy)> {
        let around = self.around(points);
        let create = |accuracy_m: Option<f64>| -> gdal::errors::Result<CoordTransform> {
            let mut options = CoordTransformOptions::new()?;
            options.set_ballpark_allowed(false)?;
            if let Some([west, south, east, north]) = around {
                options.set_area_of_interest(west, south, east, north)?;
            }
            if let Some(accuracy_m) = accuracy_m {
                options.desired_accuracy(accuracy_m)?;
            }
            let (from, to) = (self.spatial_ref(), to.spatial_ref());
            let broken = |_| gdal::errors::GdalError::BadArgument("a definition that cannot be read back".into());
            CoordTransform::new_with_options(&from.map_err(broken)?, &to.map_err(broken)?, &options)
        };
        // Making the operation succeeds even when none is good enough; using it then does not.
        let works = |transform: &CoordTransform| {
            let probe = points[0];
            let (mut x, mut y) = ([probe.x], [probe.y]);
            let with_heights = self.height_metres_per_unit.is_some() && to.height_metres_per_unit.is_some();
            let mut z = if with_heights { vec![probe.height.unwrap_or(0.0)] } else { Vec::new() };
            transform.transform_coords(&mut x, &mut y, &mut z).is_ok() && x[0].is_finite() && y[0].is_finite()
        };
        // A wider bound lets in more operations, so the narrowest that works is found by halving. Every search reads
        // PROJ's database.
        let rung = |k: usize| create(Some(LADDER_M[k])).ok().filter(works);
        let accuracy = |k: usize| if k == 0 { Accuracy::Exact } else { Accuracy::Metres(LADDER_M[k]) };
        let question = (self.wkt.clone(), to.wkt.clone(), around.map(|degrees| degrees.map(f64::to_bits)));
        let known = NARROWEST.lock().expect("nobody panics with it").get(&question).copied();
        for k in known.into_iter().chain([0]) {
            if let Some(transform) = rung(k) {
                return Ok((transform, accuracy(k)));
            }
        }
        let (mut low, mut high, mut best) = (1, LADDER_M.len(), None);
        while low < high {
            let middle = (low + high) / 2;
            match rung(middle) {
                Some(transform) => (high, best) = (middle, Some(transform)),
                None => low = middle + 1,
            }
        }
        if let Some(transform) = best {
            let mut narrowest = NARROWEST.lock().expect("nobody panics with it");
            if narrowest.len() >= MOST_KNOWN {
                narrowest.clear();
            }
            narrowest.insert(question, high);
            return Ok((transform, accuracy(high)));
        }
        create(None).ok().filter(works).map(|any| (any, Accuracy::Unstated)).ok_or_else(|| {
            let grids = self.missing_grids(points, to);
            let why = if grids.is_empty() {
                "a datum or geoid grid is missing, or the points lie outside it or in a hole of it".to_string()
            } else {
                format!("the datum or geoid grid is missing: {}, or another has no value there", grids.join(", "))
            };
            let (x, y) = (points[0].x, points[0].y);
            let place = self.longitude_latitude(x, y);
            let place =
                place.map_or_else(|| format!("{x}, {y}"), |(x, y)| format!("longitude {x:.4}, latitude {y:.4}"));
            self.failed(
                to,
                &format!("no transformation between them can be carried out at {place}: {why}"),
                &format!(
                    "install a grid that covers the place ({}), or give both systems on one datum",
                    how_to_install(&grids)
                ),
            )
        })
    }

    /// Names of the grids that the best operation would need and that are not installed.
    fn missing_grids(&self, points: &[Coordinate], to: &Crs) -> Vec<String> {
        super::grids::missing(self, to, self.around(points))
    }

    /// West, south, east and north of the points, degrees, with a small margin.
    fn around(&self, points: &[Coordinate]) -> Option<[f64; 4]> {
        let mut box_deg = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        // A few points tell where in the world this is.
        for point in points.iter().step_by(points.len().div_ceil(16)) {
            let (longitude, latitude) = self.longitude_latitude(point.x, point.y)?;
            box_deg[0] = box_deg[0].min(longitude - 0.01);
            box_deg[1] = box_deg[1].min(latitude - 0.01);
            box_deg[2] = box_deg[2].max(longitude + 0.01);
            box_deg[3] = box_deg[3].max(latitude + 0.01);
        }
        let valid = box_deg[0] >= -180.0 && box_deg[2] <= 180.0 && box_deg[1] >= -90.0 && box_deg[3] <= 90.0;
        valid.then_some(box_deg)
    }

    /// Longitude and latitude, degrees, good enough to say where in the world a point is: the datum is not looked at.
    pub fn longitude_latitude(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let mut world = SpatialRef::from_epsg(4326).ok()?;
        world.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
        let transform = CoordTransform::new(&self.spatial_ref().ok()?, &world).ok()?;
        let (mut x, mut y) = ([x], [y]);
        transform.transform_coords(&mut x, &mut y, &mut []).ok()?;
        (x[0].abs() <= 360.0 && y[0].abs() <= 90.0).then_some((x[0], y[0]))
    }

    /// Places on the system's own ellipsoid, of the Earth or another body: metres from its middle, along three axes.
    /// `None` for a local system, one whose longitudes count in something else than degrees, and where one of the
    /// places has none.
    pub fn on_own_ellipsoid(&self, places: &[(f64, f64)]) -> Option<Vec<[f64; 3]>> {
        if self.is_local() {
            return None;
        }
        let own = self.spatial_ref().ok()?;
        let mut base = own.geog_cs().ok()?;
        if !Crs::parse(&base.to_wkt().ok()?).ok()?.counts_degrees() {
            return None;
        }
        base.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
        let (mut x, mut y): (Vec<f64>, Vec<f64>) = places.iter().copied().unzip();
        CoordTransform::new(&own, &base).ok()?.transform_coords(&mut x, &mut y, &mut []).ok()?;
        if !x.iter().all(|x| x.is_finite()) || !y.iter().all(|y| y.abs() <= 90.0) {
            return None;
        }
        let (major_m, minor_m) = (base.semi_major().ok()?, base.semi_minor().ok()?);
        let eccentricity2 = 1.0 - (minor_m / major_m).powi(2);
        let place = |(longitude, latitude): (f64, f64)| {
            let ((sin_x, cos_x), (sin_y, cos_y)) = (longitude.to_radians().sin_cos(), latitude.to_radians().sin_cos());
            let across_m = major_m / (1.0 - eccentricity2 * sin_y * sin_y).sqrt();
            [across_m * cos_y * cos_x, across_m * cos_y * sin_x, across_m * (1.0 - eccentricity2) * sin_y]
        };
        Some(x.into_iter().zip(y).map(place).collect())
    }

    fn failed(&self, to: &Crs, why: &str, remedy: &str) -> Error {
        Error::usage(self.cannot(to, why), remedy)
    }

    fn cannot(&self, to: &Crs, why: &str) -> String {
        let why = why.split_whitespace().collect::<Vec<_>>().join(" ");
        format!("cannot bring coordinates from {} to {}: {why}", self.title(), to.title())
    }
}

fn and_miss(grids: &[String]) -> String {
    if grids.is_empty() { String::new() } else { format!(" (a better one needs {})", grids.join(", ")) }
}

fn how_to_install(grids: &[String]) -> String {
    // What PROJ's own collection has is called so; other grids come from their authorities.
    let is_offered = |name: &&String| name.ends_with(".tif");
    match grids.iter().find(is_offered) {
        Some(name) => format!("projsync --file {name}, or apt install proj-data"),
        None => "apt install proj-data, or projsync".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(from: &str, to: &str, x: f64, y: f64, height: Option<f64>) -> Result<(Coordinate, Accuracy)> {
        let mut points = [Coordinate { x, y, height }];
        let (from, to) = (Crs::parse(from)?, Crs::parse(to)?);
        let accuracy = from.transform(&mut points, &to, DEFAULT_DATUM_ACCURACY_M)?;
        Ok((points[0], accuracy))
    }

    /// Longitude first whatever the authority's order is. The coordinates are cs2cs's (PROJ 9.1), checked against the
    /// national calculators where they exist.
    #[test]
    fn known_coordinates_in_every_axis_order() {
        let cases: [(&str, &str, f64, f64, f64, f64); 6] = [
            ("EPSG:4167", "EPSG:2193", 173.0, 0.0, 1_600_000.0, 10_000_000.0),
            ("EPSG:4326", "EPSG:3857", 180.0, 0.0, 20_037_508.342_789_244, 0.0),
            ("EPSG:4326", "EPSG:4326", 10.4, 63.4, 10.4, 63.4),
            ("EPSG:4258", "EPSG:25832", 9.0, 0.0, 500_000.0, 0.0),
            ("EPSG:4258", "EPSG:25833", 15.0, 0.0, 500_000.0, 0.0),
            ("EPSG:4277", "EPSG:27700", -2.0, 49.0, 400_000.0, -100_000.0),
        ];
        for (from, to, x, y, easting, northing) in cases {
            let (found, accuracy) = at(from, to, x, y, None).expect(to);
            assert!((found.x - easting).abs() < 1e-3 && (found.y - northing).abs() < 1e-3, "{to}: {found:?}");
            assert_eq!(accuracy, Accuracy::Exact, "{to}: only a projection");
        }
        // The old observatory of Berne is the origin of the Swiss grid.
        let (berne, _) = at("EPSG:4150", "EPSG:2056", 7.439_583_333, 46.952_405_556, None).expect("CH1903+");
        assert!((berne.x - 2_600_000.0).abs() < 0.1 && (berne.y - 1_200_000.0).abs() < 0.1, "{berne:?}");
        // Heights go along unchanged where only the projection changes.
        let (trondheim, _) = at("EPSG:5973", "EPSG:5972", 270_000.0, 7_042_000.0, Some(80.5)).expect("one datum");
        assert!((trondheim.height.expect("kept") - 80.5).abs() < 1e-6, "{trondheim:?}");
        assert!((560_000.0..580_000.0).contains(&trondheim.x), "{trondheim:?}");
    }

    #[test]
    fn a_change_of_datum_says_how_good_it_is() {
        let (_, accuracy) = at("EPSG:4326", "EPSG:25832", 10.4, 63.4, None).expect("stated as 1 m");
        assert_eq!(accuracy, Accuracy::Metres(1.0));
        let error = at("EPSG:4326", "EPSG:2263", -74.0, 40.7, None).expect_err("4 m without a grid").to_string();
        assert!(error.contains("good to 5 m only"), "{error}");
    }

    /// Whether the grids are installed or not: never the coordinates as they were.
    #[test]
    fn a_missing_grid_is_an_error_never_a_zero() {
        match at("EPSG:5972", "EPSG:4979", 570_000.0, 7_032_000.0, Some(80.0)) {
            Err(error) => {
                let text = error.to_string();
                assert!(
                    text.contains("grid is missing: ") && text.contains("longitude 10.") && text.contains("NN2000"),
                    "it is named: {text}"
                );
            }
            Ok((point, _)) => {
                assert!((30.0..50.0).contains(&(point.height.expect("kept") - 80.0)), "the geoid: {point:?}")
            }
        }
        match at("EPSG:27700", "EPSG:32630", 400_000.0, 300_000.0, None) {
            Err(error) => assert!(error.to_string().contains("install the datum grid"), "{error}"),
            Ok((_, accuracy)) => assert_ne!(accuracy, Accuracy::Exact),
        }
        let error = at("+proj=utm +zone=32 +ellps=bessel", "EPSG:25832", 570_000.0, 7_032_000.0, None);
        assert!(error.is_err(), "a datum that is not named cannot be changed");
    }
}
