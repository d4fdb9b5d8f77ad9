//! What bands of sources say of their values.

use std::path::Path;

use autoref_raster::unit_of;
use gdal::raster::{ColorInterpretation, GdalDataType, RasterBand};
use gdal::{Dataset, Metadata};

use crate::error::{Error, Result};

/// What a band says of its values.
#[derive(Debug)]
pub struct BandForm {
    /// "Nothing", where samples of the band's type can hold it.
    pub nodata: Option<f64>,
    /// What stored values are multiplied with, and what is then added; kept, not applied.
    pub scale: (f64, f64),
    pub unit: Option<String>,
    /// Empty for none.
    pub name: String,
    pub colour: ColorInterpretation,
}

impl BandForm {
    /// Whether it says how opaque pixels are.
    pub fn is_alpha(&self) -> bool {
        self.colour == ColorInterpretation::AlphaBand
    }

    /// Whether a stored value is none. A float32 file keeps its nodata value rounded to float32.
    pub fn is_void(&self, value: f64) -> bool {
        !value.is_finite() || self.nodata.is_some_and(|n| value == n || value == f64::from(n as f32))
    }

    /// Whether the colour says what the band is of: grey is what every first band is called.
    pub(super) fn is_named(&self) -> bool {
        use ColorInterpretation::{GrayIndex, PaletteIndex, Undefined};
        ![Undefined, GrayIndex, PaletteIndex].contains(&self.colour)
    }
}

/// Of all bands of a file.
///
/// # Errors
/// When GDAL does not give a band.
pub fn of_bands(path: &Path, dataset: &Dataset) -> Result<Vec<BandForm>> {
    let of = |number: usize| {
        let band = dataset.rasterband(number).map_err(|e| Error::gdal(path, e))?;
        let kind = band.band_type();
        Ok(BandForm {
            nodata: band.no_data_value().filter(|value| holds(kind, *value)),
            scale: (band.scale().unwrap_or(1.0), band.offset().unwrap_or(0.0)),
            unit: unit_of(&band),
            name: band.description().unwrap_or_default(),
            colour: band.color_interpretation(),
        })
    };
    (1..=dataset.raster_count()).map(of).collect()
}

/// Whether samples of a kind can be a number: bytes are never -9999, whatever a header says.
fn holds(kind: GdalDataType, value: f64) -> bool {
    match kind {
        GdalDataType::Float64 => true,
        GdalDataType::Float32 => value.is_nan() || value.is_infinite() || (value as f32).is_finite(),
        kind => {
            let (least, most) = range(kind);
            value.fract() == 0.0 && (least..=most).contains(&value)
        }
    }
}

/// The colours of a band of indices, red, green, blue and alpha; empty when it has none.
pub fn palette_of(band: &RasterBand<'_>) -> Vec<[i16; 4]> {
    let Some(table) = band.color_table() else { return Vec::new() };
    let colour = |i: usize| table.entry_as_rgb(i).map_or([0; 4], |c| [c.r, c.g, c.b, c.a]);
    (0..table.entry_count()).map(colour).collect()
}

/// Least and largest number that cells of a kind hold.
#[inline]
pub fn range(kind: GdalDataType) -> (f64, f64) {
    match kind {
        GdalDataType::UInt8 => (0.0, 255.0),
        GdalDataType::UInt16 => (0.0, 65_535.0),
        GdalDataType::Int16 => (-32_768.0, 32_767.0),
        GdalDataType::UInt32 => (0.0, f64::from(u32::MAX)),
        GdalDataType::Int32 => (f64::from(i32::MIN), f64::from(i32::MAX)),
        _ => (f64::MIN, f64::MAX),
    }
}
