//! Coordinate reference systems, through GDAL and PROJ.
//!
//! ```
//! use autoref_raster::crs::Crs;
//! let new_zealand = Crs::parse("EPSG:2193")?; // the authority puts north first; here it is always east, north
//! assert_eq!((new_zealand.label().as_str(), new_zealand.metres_per_unit()), ("EPSG:2193", 1.0));
//! assert!(Crs::parse("EPSG:999999").is_err());
//! # Ok::<(), autoref_raster::Error>(())
//! ```

mod grids;
mod names;
mod plane;
mod transform;

pub use plane::{same_plane, without_heights};
pub use transform::{Accuracy, Coordinate, DEFAULT_DATUM_ACCURACY_M, Way};

use std::path::Path;

use gdal::spatial_ref::{AxisMappingStrategy, SpatialRef};

use crate::error::{Error, Result};

/// A coordinate reference system, with axes in the traditional order (easting, northing) whatever the authority says.
#[derive(Clone, Debug, PartialEq)]
pub struct Crs {
    wkt: String,
    epsg: Option<u32>,
    name: String,
    kind: Kind,
    /// Length of a unit of the horizontal axes in metres; 1 for geographic systems.
    metres_per_unit: f64,
    /// Size of a unit of longitudes and latitudes; `None` for systems that have none.
    radians_per_unit: Option<f64>,
    unit_name: String,
    /// Length of a unit of the vertical axis in metres, when there is one.
    height_metres_per_unit: Option<f64>,
    area: Option<Area>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Geographic,
    Projected,
    /// Without relation to the Earth.
    Local,
}

/// Where a system is meant to be used, degrees. West may lie east of east, across the antimeridian.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Area {
    west_deg: f64,
    south_deg: f64,
    east_deg: f64,
    north_deg: f64,
}

impl Area {
    fn contains(&self, longitude_deg: f64, latitude_deg: f64, margin_deg: f64) -> bool {
        let width = if self.east_deg >= self.west_deg {
            self.east_deg - self.west_deg
        } else {
            self.east_deg - self.west_deg + 360.0
        };
        let from_west = (longitude_deg - self.west_deg + margin_deg).rem_euclid(360.0);
        from_west <= width + 2.0 * margin_deg
            && (self.south_deg - margin_deg..=self.north_deg + margin_deg).contains(&latitude_deg)
    }
}

/// Whether a text can be nothing but the name of a file that holds a CRS.
fn is_called_as_file(text: &str) -> bool {
    let end = Path::new(text).extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    ["prj", "wkt", "wkt2", "txt", "xml", "json", "proj", "qpj"].contains(&end.as_str())
        && !text.contains(['[', '+', '{', '<', '\n'])
        && !text.contains("://")
}

const REMEDY: &str = "give an EPSG code (EPSG:25832), WKT, a PROJ string, or a file with one of them";

/// Whether the system of this code counts in the unit of `reference`: GDAL leaves the code on a system in metres that a
/// file gives another unit.
fn counts_in_unit_of(reference: &SpatialRef, code: u32) -> bool {
    SpatialRef::from_epsg(code).is_ok_and(|named| (named.linear_units() / reference.linear_units() - 1.0).abs() < 1e-9)
}

impl Crs {
    /// Reads an EPSG code ("EPSG:25832", "25832", "EPSG:25832+5941"), WKT, a PROJ string, an OGC URN, the short names
    /// of drone software ("WGS84 UTM 32N"), EPSG's own names ("Amersfoort / RD New", two joined by
    /// " + "), or the name of a file with one of them or of a raster that has one.
    ///
    /// # Errors
    /// When nothing of the kind is understood; for systems without horizontal axes, or that count from the Earth's
    /// centre.
    pub fn parse(text: &str) -> Result<Crs> {
        crate::initialise_gdal(0);
        // A definition that is none harms no file that is being written meanwhile.
        crate::written::unheard(|| Crs::read(text))
    }

    fn read(text: &str) -> Result<Crs> {
        let text = text.trim();
        let file = Path::new(text);
        let from_file = text.len() < 4096 && file.is_file();
        if !from_file && is_called_as_file(text) {
            let what =
                if file.is_dir() { "a folder, no file with a CRS" } else { "no such file, and no name of a CRS" };
            return Err(Error::usage(format!("{text}: {what}"), REMEDY));
        }
        let definition = if from_file { definition_in(file)? } else { text.to_string() };
        let bad = |why: &dyn std::fmt::Display| {
            let why = why.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
            let shown: String = text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(120).collect();
            Error::usage(format!("`{shown}` is no coordinate reference system: {why}"), REMEDY)
        };
        let definition = definition.trim().trim_start_matches('\u{feff}');
        if definition.is_empty() {
            return Err(bad(&"it is empty"));
        }
        let definition = short_name(definition).unwrap_or_else(|| definition.to_string());
        if definition.starts_with("http") && !definition.contains("opengis.net/def/crs") {
            return Err(bad(&"addresses are not fetched"));
        }
        let named = || SpatialRef::from_definition(&names::definition(&definition)?).ok();
        let mut reference =
            SpatialRef::from_definition(&definition).or_else(|e| named().ok_or(e)).map_err(|e| match e {
                gdal::errors::GdalError::OgrError { .. } => bad(&"GDAL and PROJ do not know it"),
                other => bad(&other),
            })?;
        if reference.auth_code().is_err() {
            // A .prj of ArcGIS names no code; where the content is one of EPSG's, so is the label. It may be none of
            // them.
            let _ = reference.auto_identify_epsg();
        }
        let kind = match () {
            () if reference.is_geocentric() => return Err(bad(&"it counts from the Earth's centre; a map is needed")),
            () if reference.is_geographic() => Kind::Geographic,
            () if reference.is_projected() => Kind::Projected,
            () if reference.is_local() => Kind::Local,
            () if reference.is_vertical() => {
                return Err(bad(&"it has heights only; join it to a horizontal one, as in EPSG:25832+5941"));
            }
            () => return Err(bad(&"it is neither geographic nor projected")),
        };
        Crs::describe(&reference, kind).map_err(|e| bad(&e))
    }

    /// The system that has this code.
    ///
    /// # Errors
    /// When PROJ does not know the code, or it is of no system for a map: geocentric, vertical alone, or neither
    /// geographic nor projected.
    pub fn from_epsg(code: u32) -> Result<Crs> {
        Crs::parse(&format!("EPSG:{code}"))
    }

    fn describe(reference: &SpatialRef, kind: Kind) -> gdal::errors::Result<Crs> {
        let (wkt, three_axes) = (reference.to_wkt()?, reference.axes_count() == 3);
        let height_metres_per_unit = three_axes.then(|| {
            // A compound system has a vertical part of its own; that of a 3-D one is its third axis.
            let unit = reference.get_attr_value("VERT_CS|UNIT", 1).ok().flatten();
            unit.and_then(|text| text.parse().ok()).or_else(|| unit_of_up_axis(&wkt)).unwrap_or(1.0)
        });
        Ok(Crs {
            wkt,
            epsg: reference
                .auth_name()
                .filter(|name| name.eq_ignore_ascii_case("EPSG"))
                .and_then(|_| reference.auth_code().ok())
                .and_then(|code| u32::try_from(code).ok())
                .filter(|code| kind == Kind::Geographic || counts_in_unit_of(reference, *code)),
            name: reference.name().unwrap_or_default(),
            kind,
            metres_per_unit: if kind == Kind::Geographic { 1.0 } else { reference.linear_units() },
            radians_per_unit: (kind == Kind::Geographic).then(|| reference.angular_units()),
            unit_name: if kind == Kind::Geographic {
                reference.angular_units_name().unwrap_or_default()
            } else {
                reference.linear_units_name().unwrap_or_default()
            },
            height_metres_per_unit,
            area: reference.area_of_use().map(|area| Area {
                west_deg: area.west_lon_degree,
                south_deg: area.south_lat_degree,
                east_deg: area.east_lon_degree,
                north_deg: area.north_lat_degree,
            }),
        })
    }

    /// Its WKT.
    pub fn wkt(&self) -> &str {
        &self.wkt
    }

    /// The name by which the authority knows it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// "EPSG:n", or WKT when it is none of EPSG's.
    pub fn label(&self) -> String {
        self.epsg.map_or_else(|| self.wkt.clone(), |code| format!("EPSG:{code}"))
    }

    /// The code, when it is one of EPSG's.
    pub fn epsg(&self) -> Option<u32> {
        self.epsg
    }

    /// As a PROJ string, for programs that read nothing else. `None` when PROJ has no such string.
    pub fn proj_string(&self) -> Option<String> {
        let text = self.spatial_ref().ok()?.to_proj4().ok()?;
        Some(text.trim().to_string()).filter(|text| !text.is_empty())
    }

    /// For messages: "EPSG:n (name)", or the name alone.
    pub fn title(&self) -> String {
        match self.epsg {
            Some(code) => format!("EPSG:{code} ({})", self.name),
            None if self.name.is_empty() => "an unnamed system".into(),
            None => self.name.clone(),
        }
    }

    /// Degrees (or grads), in which nothing is fitted.
    pub fn is_geographic(&self) -> bool {
        self.kind == Kind::Geographic
    }

    /// Without relation to the Earth: nothing can be projected from it or to it.
    pub fn is_local(&self) -> bool {
        self.kind == Kind::Local
    }

    /// Of the horizontal axes.
    pub fn metres_per_unit(&self) -> f64 {
        self.metres_per_unit
    }

    /// Whether coordinates are longitudes and latitudes in degrees, not in grads and not on a map. Names do not tell:
    /// a degree is `degree` in one file and `Degree` in another.
    pub fn counts_degrees(&self) -> bool {
        let degree = std::f64::consts::PI / 180.0;
        self.radians_per_unit.is_some_and(|unit| (unit / degree - 1.0).abs() < 1e-6)
    }

    /// The unit of its axes, as the WKT calls it.
    pub fn unit_name(&self) -> &str {
        &self.unit_name
    }

    /// Of the vertical axis; `None` for systems without one.
    pub fn height_metres_per_unit(&self) -> Option<f64> {
        self.height_metres_per_unit
    }

    /// A projected system of three axes without its heights, which are ellipsoidal: GeoTIFF has no keys for such a
    /// one. `None` for all others, compound ones too.
    #[allow(unsafe_code)]
    pub fn without_ellipsoidal_height(&self) -> Option<Crs> {
        let reference = self.spatial_ref().ok()?;
        if self.kind != Kind::Projected || reference.is_compound() || reference.axes_count() != 3 {
            return None;
        }
        // SAFETY: the handle belongs to `reference`, which outlives the call; a null name keeps the name.
        let code = unsafe { gdal_sys::OSRDemoteTo2D(reference.to_c_hsrs(), std::ptr::null()) };
        (code == gdal_sys::OGRErr::OGRERR_NONE).then(|| Crs::describe(&reference, self.kind).ok()).flatten()
    }

    /// Whether a point lies where the system is meant to be used, give or take two degrees. `None` when that is not
    /// known.
    pub fn covers(&self, x: f64, y: f64) -> Option<bool> {
        let area = self.area?;
        let Some((longitude, latitude)) = self.longitude_latitude(x, y) else { return Some(false) };
        Some(area.contains(longitude, latitude, 2.0))
    }

    /// Whether a longitude and latitude, degrees, lie where the system is meant to be used, give or take two degrees.
    pub fn covers_degrees(&self, longitude: f64, latitude: f64) -> Option<bool> {
        Some(self.area?.contains(longitude, latitude, 2.0))
    }

    /// Whether its axes count south, then west (Krovak's): a map in them is the mirror image of the ground.
    pub fn is_mirror_image(&self) -> bool {
        SpatialRef::from_wkt(&self.wkt).ok().is_some_and(|mut reference| {
            reference.set_axis_mapping_strategy(AxisMappingStrategy::AuthorityCompliant);
            reference.axis_orientation("PROJCS", 0).is_ok_and(|o| o == gdal_sys::OGRAxisOrientation::OAO_South)
                && reference.axis_orientation("PROJCS", 1).is_ok_and(|o| o == gdal_sys::OGRAxisOrientation::OAO_West)
        })
    }

    fn spatial_ref(&self) -> Result<SpatialRef> {
        let mut reference =
            SpatialRef::from_wkt(&self.wkt).map_err(|e| Error::usage(e.to_string(), "use another --crs"))?;
        reference.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
        Ok(reference)
    }

    /// The UTM zone of a geographic point, on the datum of this system, so that nothing but a projection is between
    /// them. The zones are those of the UTM grid, with its exceptions for western Norway and Svalbard.
    ///
    /// # Errors
    /// When this is no geographic system, or the point lies outside UTM (beyond 84° north or 80° south).
    pub fn utm_zone(&self, longitude_deg: f64, latitude_deg: f64) -> Result<Crs> {
        if !(-80.0..=84.0).contains(&latitude_deg) || !longitude_deg.is_finite() {
            return Err(Error::usage(
                format!("latitude {latitude_deg:.3}° lies outside the zones of UTM"),
                "give a projected CRS (--to-crs or --crs), for example EPSG:3995 or EPSG:3031; or the columns are exchanged",
            ));
        }
        let zone = utm_zone_number(longitude_deg, latitude_deg);
        let north = latitude_deg >= 0.0;
        let code = match self.epsg {
            Some(4326 | 4979) => Some(if north { 32600 } else { 32700 } + zone),
            Some(4258 | 4937) if north && (28..=38).contains(&zone) => Some(25800 + zone),
            Some(4269) if north && (1..=23).contains(&zone) => Some(26900 + zone),
            _ => None,
        };
        if let Some(code) = code {
            return Crs::from_epsg(code);
        }
        let base = self.spatial_ref()?.geog_cs().and_then(|base| base.to_wkt()).map_err(|e| {
            Error::usage(format!("{} is not geographic: {e}", self.title()), "give a projected --to-crs")
        })?;
        let name = format!("{} / UTM zone {zone}{}", self.name, if north { 'N' } else { 'S' });
        let (meridian, false_northing) = (f64::from(zone) * 6.0 - 183.0, if north { 0 } else { 10_000_000 });
        Crs::parse(&format!(
            "PROJCS[\"{name}\",{base},PROJECTION[\"Transverse_Mercator\"],PARAMETER[\"latitude_of_origin\",0],\
             PARAMETER[\"central_meridian\",{meridian}],PARAMETER[\"scale_factor\",0.9996],\
             PARAMETER[\"false_easting\",500000],PARAMETER[\"false_northing\",{false_northing}],UNIT[\"metre\",1],\
             AXIS[\"Easting\",EAST],AXIS[\"Northing\",NORTH]]"
        ))
    }
}

fn utm_zone_number(longitude_deg: f64, latitude_deg: f64) -> u32 {
    let longitude = (longitude_deg + 180.0).rem_euclid(360.0) - 180.0;
    match longitude {
        l if (56.0..64.0).contains(&latitude_deg) && (3.0..12.0).contains(&l) => 32,
        l if latitude_deg >= 72.0 && (0.0..9.0).contains(&l) => 31,
        l if latitude_deg >= 72.0 && (9.0..21.0).contains(&l) => 33,
        l if latitude_deg >= 72.0 && (21.0..33.0).contains(&l) => 35,
        l if latitude_deg >= 72.0 && (33.0..42.0).contains(&l) => 37,
        l => ((l + 180.0) / 6.0).floor() as u32 + 1,
    }
}

/// The definition in a text file (.prj, .wkt), or the CRS of a raster.
fn definition_in(file: &Path) -> Result<String> {
    const LARGEST: u64 = 1 << 16;
    let size = std::fs::metadata(file).map_err(|e| Error::io(file, "read", e))?.len();
    if size <= LARGEST
        && let Ok(text) =
            String::from_utf8(crate::bounded::read(file, "a definition of a CRS", crate::bounded::TEXT_BYTES)?)
    {
        return Ok(text.split_whitespace().collect::<Vec<_>>().join(" "));
    }
    let nothing = || Error::format(file, "its content", "it holds no coordinate reference system");
    let wkt = gdal::Dataset::open(file).map_err(|e| Error::gdal(file, e))?.projection();
    if wkt.is_empty() { Err(nothing()) } else { Ok(wkt) }
}

/// "25832"; "WGS84 UTM 32N" and its kin, as OpenDroneMap's lists have it; Poland's PUWG names.
fn short_name(text: &str) -> Option<String> {
    if text.bytes().all(|b| b.is_ascii_digit()) {
        return Some(format!("EPSG:{text}"));
    }
    let plain: String = text.chars().filter(|c| !" _-/\t".contains(*c)).collect::<String>().to_uppercase();
    if matches!(plain.as_str(), "PUWG1992" | "PUWG92" | "PL1992") {
        return Some("EPSG:2180".into());
    }
    let (base, zones) =
        [("WGS84UTM", 1..=60u32), ("ETRS89UTM", 28..=38), ("EUREF89UTM", 28..=38), ("NAD83UTM", 1..=23)]
            .into_iter()
            .find(|(name, _)| plain.starts_with(name))?;
    let zone = plain[base.len()..].trim_start_matches("ZONE");
    let (zone, south) = match zone.strip_suffix('S') {
        Some(zone) => (zone, true),
        None => (zone.strip_suffix('N').unwrap_or(zone), false),
    };
    let zone: u32 = zone.parse().ok().filter(|zone| zones.contains(zone))?;
    let code = match (base, south) {
        ("WGS84UTM", false) => 32600,
        ("WGS84UTM", true) => 32700,
        ("NAD83UTM", false) => 26900,
        (_, false) => 25800,
        (_, true) => return None,
    };
    Some(format!("EPSG:{}", code + zone))
}

/// Which axis of the CRS each of our (east, north) is: "2,1" where the authority puts north first.
pub fn axis_mapping(crs: &Crs) -> &'static str {
    let north_first = SpatialRef::from_wkt(crs.wkt()).ok().is_some_and(|mut reference| {
        reference.set_axis_mapping_strategy(AxisMappingStrategy::AuthorityCompliant);
        let key = if crs.is_geographic() { "GEOGCS" } else { "PROJCS" };
        reference.axis_orientation(key, 0).is_ok_and(|o| o == gdal_sys::OGRAxisOrientation::OAO_North)
            && reference.axis_orientation(key, 1).is_ok_and(|o| o == gdal_sys::OGRAxisOrientation::OAO_East)
    });
    if north_first { "2,1" } else { "1,2" }
}

/// Metres in a unit of the axis that points upwards, from `AXIS["…",up,…,LENGTHUNIT["US survey foot",0.3048…`.
fn unit_of_up_axis(wkt: &str) -> Option<f64> {
    let up = &wkt[wkt.find("\",up,")?..];
    let unit = &up[up.find("LENGTHUNIT[")?..];
    unit.split(',').nth(1)?.trim_end_matches(']').parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ellipsoidal_heights_of_a_projected_system_can_be_left_out() {
        let three = SpatialRef::from_definition("EPSG:7899").expect("known");
        // SAFETY: the handle belongs to `three`, which outlives the call; a null name keeps the name.
        #[allow(unsafe_code)]
        unsafe {
            gdal_sys::OSRPromoteTo3D(three.to_c_hsrs(), std::ptr::null())
        };
        let three = Crs::parse(&three.to_wkt().expect("WKT")).expect("known");
        assert!(three.height_metres_per_unit().is_some());
        let flat = three.without_ellipsoidal_height().expect("it has three axes");
        assert_eq!((flat.height_metres_per_unit(), flat.is_geographic()), (None, false));
        for other in ["EPSG:25832", "EPSG:25832+5941", "EPSG:4979"] {
            assert_eq!(Crs::parse(other).expect(other).without_ellipsoidal_height(), None, "{other}");
        }
    }

    #[test]
    fn nonsense_is_one_clear_line() {
        for bad in
            ["EPSG:999999", "EPSG:", "utm 32", "PROJCS[\"x\"", "+proj=nothing", "25832.5", "https://example.org/a", ""]
        {
            let message = Crs::parse(bad).expect_err(bad).to_string();
            assert!(message.contains(bad) && message.contains("EPSG code"), "{bad}: {message}");
            assert!(!message.contains('\n'), "{message}");
        }
    }

    #[test]
    fn systems_without_a_map_are_refused() {
        for (code, word) in [("EPSG:5941", "heights only"), ("EPSG:4978", "Earth's centre")] {
            let message = Crs::parse(code).expect_err(code).to_string();
            assert!(message.contains(word), "{message}");
        }
    }

    #[test]
    fn axes_that_mirror_the_ground_are_known() {
        let mirrored = [2065, 5513, 5514, 2054, 25832, 2193];
        let found = mirrored.map(|code| Crs::from_epsg(code).expect("known").is_mirror_image());
        assert_eq!(found, [true, true, false, false, false, false], "{mirrored:?}");
    }

    #[test]
    fn short_names_of_drone_software() {
        for (text, code) in [
            ("WGS84 UTM 54N", 32654),
            ("WGS84 UTM 22S", 32722),
            ("wgs84 utm 32n", 32632),
            ("WGS 84 / UTM zone 32N", 32632),
            ("ETRS89 UTM 33N", 25833),
            ("PUWG1992", 2180),
            ("25832", 25832),
        ] {
            assert_eq!(Crs::parse(text).expect(text).label(), format!("EPSG:{code}"));
        }
        assert!(Crs::parse("WGS84 UTM 61N").is_err());
    }

    #[test]
    fn feet_are_told_apart() {
        let metres = |text: &str| Crs::parse(text).expect(text).metres_per_unit();
        assert!((metres("EPSG:2263") - 1200.0 / 3937.0).abs() < 1e-15, "US survey foot");
        assert_eq!(metres("+proj=utm +zone=12 +datum=NAD83 +units=ft"), 0.3048);
        assert!((metres("+proj=utm +zone=12 +datum=NAD83 +units=us-ft") - 1200.0 / 3937.0).abs() < 1e-12);
        assert_eq!(metres("EPSG:2222"), 0.3048, "Arizona East, international feet");
    }

    #[test]
    fn compound_systems_have_heights_with_a_unit() {
        let heights = |text: &str| Crs::parse(text).expect(text).height_metres_per_unit();
        assert_eq!(heights("EPSG:25832"), None);
        assert_eq!(heights("EPSG:5972"), Some(1.0));
        assert_eq!(heights("EPSG:4979"), Some(1.0));
        assert_eq!(Crs::parse("EPSG:25832+5941").expect("ad hoc").height_metres_per_unit(), Some(1.0));
        let feet = heights("+proj=utm +zone=32 +datum=WGS84 +units=us-ft +vunits=us-ft").expect("three axes");
        assert!((feet - 1200.0 / 3937.0).abs() < 1e-12);
        assert!((heights("EPSG:2263+6360").expect("NAVD88 in feet") - 1200.0 / 3937.0).abs() < 1e-9);
    }

    #[test]
    fn degrees_are_known_by_their_size() {
        let esri = "GEOGCS[\"GCS_WGS_1984\",DATUM[\"D_WGS_1984\",SPHEROID[\"WGS_1984\",6378137.0,298.257223563]],\
                    PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",0.0174532925199433]]";
        let grads = "EPSG:4807";
        for (text, degrees) in [(esri, true), ("EPSG:4326", true), (grads, false), ("EPSG:25832", false)] {
            assert_eq!(Crs::parse(text).expect(text).counts_degrees(), degrees, "{text}");
        }
    }

    #[test]
    fn a_file_may_hold_the_definition() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let prj = folder.path().join("a.prj");
        let esri = "PROJCS[\"ETRS_1989_UTM_Zone_32N\",GEOGCS[\"GCS_ETRS_1989\",DATUM[\"D_ETRS_1989\",SPHEROID[\"GRS_1980\",6378137.0,298.257222101]],PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",0.0174532925199433]],PROJECTION[\"Transverse_Mercator\"],PARAMETER[\"False_Easting\",500000.0],PARAMETER[\"False_Northing\",0.0],PARAMETER[\"Central_Meridian\",9.0],PARAMETER[\"Scale_Factor\",0.9996],PARAMETER[\"Latitude_Of_Origin\",0.0],UNIT[\"Meter\",1.0]]\n";
        std::fs::write(&prj, esri).expect("writable");
        let crs = Crs::parse(prj.to_str().expect("plain")).expect("ArcGIS's WKT");
        assert!(crs.name().contains("32N") && crs.metres_per_unit() == 1.0);
        std::fs::write(&prj, "nothing of the kind").expect("writable");
        let message = Crs::parse(prj.to_str().expect("plain")).expect_err("no definition").to_string();
        assert!(message.contains("a.prj"), "{message}");
    }

    #[test]
    fn utm_zones_with_their_exceptions() {
        let wgs84 = Crs::from_epsg(4326).expect("known");
        let zone = |longitude: f64, latitude: f64| wgs84.utm_zone(longitude, latitude).expect("inside").label();
        assert_eq!(zone(10.4, 63.4), "EPSG:32632");
        assert_eq!(zone(5.3, 60.4), "EPSG:32632", "Bergen");
        assert_eq!(zone(15.6, 78.2), "EPSG:32633", "Longyearbyen");
        assert_eq!(zone(174.8, -41.3), "EPSG:32760");
        assert_eq!(zone(180.0, 0.0), "EPSG:32601");
        assert!(wgs84.utm_zone(0.0, 89.0).is_err());
        let etrs = Crs::from_epsg(4258).expect("known").utm_zone(10.4, 63.4).expect("inside");
        assert_eq!(etrs.label(), "EPSG:25832", "the datum stays");
        let other = Crs::from_epsg(4167).expect("NZGD2000").utm_zone(174.8, -41.3).expect("inside");
        assert!(other.name().contains("NZGD2000") && other.name().contains("60S"), "{}", other.name());
    }
}
