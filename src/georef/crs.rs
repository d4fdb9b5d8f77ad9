//! Coordinate reference systems, through GDAL and PROJ.

use std::path::Path;

use gdal::spatial_ref::{AxisMappingStrategy, CoordTransform, CoordTransformOptions, SpatialRef};

use crate::error::{Error, Result};

/// A coordinate reference system, with axes in the traditional order (easting, northing) whatever the authority says.
#[derive(Clone, Debug, PartialEq)]
pub struct Crs {
    wkt: String,
    epsg: Option<u32>,
    name: String,
    geographic: bool,
    /// Length of a unit of the axes in metres; 1 for geographic systems.
    metres_per_unit: f64,
    unit_name: String,
}

impl Crs {
    /// Reads an EPSG code ("EPSG:25832", "25832"), WKT, a PROJ string, an OGC URN, or the name of a file with one of them.
    ///
    /// # Errors
    /// When nothing of the kind is understood.
    pub fn parse(text: &str) -> Result<Crs> {
        crate::raster::initialise_gdal(0);
        let text = text.trim();
        let file = Path::new(text);
        let from_file = (text.len() < 4096 && file.is_file()).then(|| std::fs::read_to_string(file));
        let definition = match from_file {
            Some(content) => content.map_err(|e| Error::io(file, "read", e))?.trim().to_string(),
            None if !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit()) => format!("EPSG:{text}"),
            None => text.to_string(),
        };
        let bad = |e: &dyn std::fmt::Display| {
            let first_line = e.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
            Error::usage(
                format!("`{text}` is no coordinate reference system: {first_line}"),
                "give an EPSG code (EPSG:25832), WKT, a PROJ string, or a file with one of them",
            )
        };
        if definition.is_empty() {
            return Err(bad(&"it is empty"));
        }
        Crs::describe(SpatialRef::from_definition(&definition).map_err(|e| bad(&e))?).map_err(|e| bad(&e))
    }

    pub fn from_epsg(code: u32) -> Result<Crs> {
        Crs::parse(&format!("EPSG:{code}"))
    }

    fn describe(reference: SpatialRef) -> gdal::errors::Result<Crs> {
        let geographic = reference.is_geographic();
        Ok(Crs {
            wkt: reference.to_wkt()?,
            epsg: reference
                .auth_name()
                .filter(|name| name.eq_ignore_ascii_case("EPSG"))
                .and_then(|_| reference.auth_code().ok())
                .and_then(|code| u32::try_from(code).ok()),
            name: reference.name().unwrap_or_default(),
            geographic,
            metres_per_unit: if geographic { 1.0 } else { reference.linear_units() },
            unit_name: reference.linear_units_name().unwrap_or_default(),
        })
    }

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

    /// Degrees, in which nothing is fitted.
    pub fn is_geographic(&self) -> bool {
        self.geographic
    }

    pub fn metres_per_unit(&self) -> f64 {
        self.metres_per_unit
    }

    pub fn unit_name(&self) -> &str {
        &self.unit_name
    }

    fn spatial_ref(&self) -> Result<SpatialRef> {
        let mut reference =
            SpatialRef::from_wkt(&self.wkt).map_err(|e| Error::usage(e.to_string(), "use another --crs"))?;
        reference.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
        Ok(reference)
    }

    /// Brings (x, y) pairs, in easting/longitude first order, into another system.
    ///
    /// # Errors
    /// When PROJ knows no exact way: a missing datum grid is an error here, never an approximation in silence.
    pub fn project(&self, points: &mut [(f64, f64)], to: &Crs) -> Result<()> {
        let fail = |e: &dyn std::fmt::Display| {
            let words = e.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
            Error::usage(
                format!("cannot bring coordinates from {} to {}: {words}", self.label(), to.label()),
                "install the missing PROJ grid (projsync), or choose another CRS",
            )
        };
        let mut options = CoordTransformOptions::new().map_err(|e| fail(&e))?;
        options.set_ballpark_allowed(false).map_err(|e| fail(&e))?;
        let transform = CoordTransform::new_with_options(&self.spatial_ref()?, &to.spatial_ref()?, &options)
            .map_err(|e| fail(&e))?;
        let (mut x, mut y): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
        transform.transform_coords(&mut x, &mut y, &mut []).map_err(|e| fail(&e))?;
        for (point, (x, y)) in points.iter_mut().zip(x.into_iter().zip(y)) {
            if !x.is_finite() || !y.is_finite() {
                return Err(fail(&format!("{}, {} lies outside", point.0, point.1)));
            }
            *point = (x, y);
        }
        Ok(())
    }

    /// The UTM zone (WGS 84) of a longitude and latitude, degrees.
    pub fn utm_of(longitude_deg: f64, latitude_deg: f64) -> Result<Crs> {
        let zone = (((longitude_deg + 180.0) / 6.0).floor() as i64).rem_euclid(60) + 1;
        let base = if latitude_deg >= 0.0 { 32600 } else { 32700 };
        Crs::from_epsg((base + zone) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn longitude_comes_first_whatever_the_authority_says() {
        let (geographic, utm) = (Crs::from_epsg(4326).expect("known"), Crs::utm_of(10.4, 63.4).expect("known"));
        assert_eq!(utm.label(), "EPSG:32632");
        let mut points = [(9.0, 63.4)];
        geographic.project(&mut points, &utm).expect("the same datum");
        assert!((points[0].0 - 500_000.0).abs() < 1e-3, "the central meridian is at 500 km east: {points:?}");
        assert!((7.0e6..7.1e6).contains(&points[0].1));
    }

    #[test]
    fn nonsense_is_one_clear_line() {
        let message = Crs::parse("EPSG:999999").expect_err("no such code").to_string();
        assert!(message.contains("EPSG:999999") && !message.contains('\n'), "{message}");
        assert!(Crs::parse("").is_err());
    }

    #[test]
    fn feet_are_told_from_metres() {
        let crs = Crs::from_epsg(2263).expect("New York, US survey feet");
        assert!((crs.metres_per_unit() - 0.304_800_609_6).abs() < 1e-9);
    }
}
