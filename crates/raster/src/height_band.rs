//! What a band's stored values say of heights: which cells are there, scale and offset, unit.

use std::ffi::CString;
use std::path::Path;

use gdal::Dataset;
use gdal::raster::RasterBand;

use crate::crs::Crs;
use crate::error::{Error, Result};
use crate::masked;
use crate::units::{FOOT_M, US_SURVEY_FOOT_M};

/// Values that stand for "no height" in files that name none.
const USUAL_NODATA: [f64; 3] = [-32_768.0, -32_767.0, -9999.0];
/// No ground lies higher or lower, in metres or feet; in finer units that many metres are meant.
const BEYOND_ANY_GROUND: f64 = 1e5;

/// How the stored values of a band become heights in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightBand {
    pub nodata: Option<f64>,
    /// What a stored value is multiplied with, and what is then added.
    pub scale: (f64, f64),
    /// An alpha band or a mask says which cells are there.
    pub masked: bool,
    /// What a scaled value is multiplied with to be metres.
    pub metres_per_value: f64,
    /// What the file calls its unit, when it says.
    pub unit_name: Option<String>,
}

/// Metres in a unit of a band's heights, by its name, else by the vertical axis of its CRS; 1 where neither says one of
/// length.
pub fn metres_per_value(band: &RasterBand<'_>, crs: Option<&Crs>) -> f64 {
    match unit_of(band) {
        Some(name) => metres_of(&name).unwrap_or(1.0),
        None => crs.and_then(Crs::height_metres_per_unit).unwrap_or(1.0),
    }
}

/// Words by which files say that they name no unit; IDRISI writes `unspecified`.
fn says_nothing(unit: &str) -> bool {
    ["", "unspecified", "unknown", "none", "n/a", "unitless"].contains(&unit.to_ascii_lowercase().as_str())
}

/// The unit that a band names, when it says.
pub fn unit_of(band: &RasterBand<'_>) -> Option<String> {
    Some(band.unit().trim().to_string()).filter(|name| !says_nothing(name))
}

/// Whether two names are of one unit: `m` and `metre` are.
pub fn same_unit(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b) || metres_of(a).is_some_and(|metres| metres_of(b) == Some(metres))
}

impl HeightBand {
    /// Of a band of `path`. The unit is the band's own, else that of the vertical axis of `crs`, else the metre.
    ///
    /// # Errors
    /// A unit that is none of length; a mask that cannot be looked at.
    pub fn of(path: &Path, band: &RasterBand<'_>, crs: Option<&Crs>) -> Result<HeightBand> {
        refuse_signed_bytes(path, band)?;
        let unit_name = unit_of(band);
        let axis = crs.and_then(Crs::height_metres_per_unit);
        let metres_per_value = match (&unit_name, axis) {
            (Some(name), _) => metres_of(name).ok_or_else(|| {
                let remedy = "name it m or ft with gdal_edit.py -units";
                Error::unsupported(path, format!("heights in `{name}`"), remedy)
            })?,
            (None, Some(metres)) => metres,
            (None, None) => 1.0,
        };
        let unit_name = unit_name.or_else(|| axis.map(|metres| if metres == 1.0 { "m" } else { "ft" }.to_string()));
        let scale = (band.scale().unwrap_or(1.0), band.offset().unwrap_or(0.0));
        let (nodata, masked) = (band.no_data_value(), masked::has_mask(path, band)?);
        Ok(HeightBand { nodata, scale, masked, metres_per_value, unit_name })
    }

    /// Whether a stored value stands for "no height".
    pub fn is_void(&self, value: f64) -> bool {
        let height = value * self.scale.0 + self.scale.1;
        // Cells without height are left behind as other values too, whatever a file declares.
        let per_value = if self.metres_per_value < FOOT_M { self.metres_per_value } else { 1.0 };
        if !height.is_finite() || (height * per_value).abs() >= BEYOND_ANY_GROUND {
            return true;
        }
        match self.nodata {
            // A float32 file keeps its nodata value rounded to float32.
            Some(nodata) => value == nodata || value == f64::from(nodata as f32),
            None => USUAL_NODATA.contains(&value),
        }
    }

    /// Stored values to heights in metres; NaN where there is no height.
    pub fn to_metres(&self, values: &mut [f64]) {
        let (scale, offset) = self.scale;
        for value in values {
            *value = if self.is_void(*value) { f64::NAN } else { (*value * scale + offset) * self.metres_per_value };
        }
    }
}

/// Names the unit of band 1.
///
/// # Errors
/// When GDAL cannot.
pub fn set_height_unit(path: &Path, dataset: &Dataset, unit: &str) -> Result<()> {
    let band = dataset.rasterband(1).map_err(|e| Error::gdal(path, e))?;
    set_unit(path, &band, unit)
}

/// Names the unit of a band.
///
/// # Errors
/// When GDAL cannot.
#[allow(unsafe_code)]
pub fn set_unit(path: &Path, band: &RasterBand<'_>, unit: &str) -> Result<()> {
    let unit = CString::new(unit).map_err(|_| Error::usage("a zero byte in a unit", "name it m or ft"))?;
    // SAFETY: the band belongs to a dataset that outlives the call, and GDAL copies the string.
    let code = unsafe { gdal_sys::GDALSetRasterUnitType(band.c_rasterband(), unit.as_ptr()) };
    if code == gdal_sys::CPLErr::CE_None { Ok(()) } else { Err(Error::gdal(path, "the unit cannot be named")) }
}

/// Refuses bytes that GDAL before 3.7 reads as 0 to 255 and the file means as −128 to 127.
///
/// # Errors
/// With the remedy.
pub fn refuse_signed_bytes(path: &Path, band: &RasterBand<'_>) -> Result<()> {
    use gdal::Metadata as _;
    if band.metadata_item("PIXELTYPE", "IMAGE_STRUCTURE").as_deref() == Some("SIGNEDBYTE") {
        return Err(Error::unsupported(path, "samples of type Int8", "bring them to Int16 with gdal_translate -ot"));
    }
    Ok(())
}

/// Metres in a unit of height that a band names.
fn metres_of(name: &str) -> Option<f64> {
    match name.to_ascii_lowercase().as_str() {
        "m" | "metre" | "meter" | "metres" | "meters" => Some(1.0),
        "ft" | "foot" | "feet" => Some(FOOT_M),
        "us survey foot" | "us survey feet" | "us-ft" | "us_ft" | "us ft" | "ftus" | "usft" | "us foot" | "us feet"
        | "sfoot" => Some(US_SURVEY_FOOT_M),
        "cm" | "centimetre" | "centimeter" => Some(0.01),
        "dm" | "decimetre" | "decimeter" => Some(0.1),
        "mm" | "millimetre" | "millimeter" => Some(0.001),
        "km" | "kilometre" | "kilometer" => Some(1000.0),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn survey_feet_have_many_names() {
        for name in ["ftUS", "US ft", "us-ft", "US survey foot", "US_ft"] {
            assert_eq!(metres_of(name), Some(US_SURVEY_FOOT_M), "{name}");
        }
        assert!(same_unit("ftUS", "us-ft") && !same_unit("ftUS", "ft") && same_unit("ft", "foot"));
    }

    #[test]
    fn no_height_is_what_is_declared_and_what_no_ground_has() {
        let band =
            |nodata| HeightBand { nodata, scale: (1.0, 0.0), masked: false, metres_per_value: 1.0, unit_name: None };
        for value in [f64::NAN, f64::INFINITY, -3.4e38, 1e6, -9999.0] {
            assert!(band(Some(-9999.0)).is_void(value) && band(None).is_void(value), "{value}");
        }
        assert!(!band(Some(-9999.0)).is_void(-32_768.0), "another value is declared");
        // 1000 m are ground in every unit; what no ground has is none.
        for (metres_per_value, height, none) in
            [(0.01, 1e5, 1e7), (0.1, 1e4, 1e6), (0.001, 8.8e6, 1e8), (FOOT_M, 29_000.0, 1e5), (1000.0, 8.8, 1e5)]
        {
            let band = HeightBand { metres_per_value, ..band(None) };
            assert!(!band.is_void(height) && !band.is_void(-height), "{height} of {metres_per_value} m");
            assert!(band.is_void(none) && band.is_void(-none), "{none} of {metres_per_value} m");
        }
        assert!(band(None).is_void(-32_768.0) && !band(None).is_void(-12.0));
        // As a float32 file keeps it.
        assert!(band(Some(-3.402_823_466_385_288_6e38)).is_void(f64::from(f32::MIN)));
    }
}
