//! What a grid says of where it lies and of the unit of its heights.

use std::path::Path;

use autoref_raster::crs::{Crs, without_heights};
use autoref_raster::units::{FOOT_M, US_SURVEY_FOOT_M};

use super::Options;
use crate::io::{self, Header};

/// Reference system and units of a cloud's grids.
pub(super) struct Place {
    /// As GeoTIFF can hold it.
    pub wkt: Option<String>,
    /// The same without heights, for values that are none.
    pub plane: Option<String>,
    /// Of the coordinates, for messages.
    pub unit: String,
    /// Of heights, as a band names it; `None` where nothing says it.
    pub height_unit: Option<&'static str>,
}

/// A unit of heights as bands name it.
fn named(metres: f64) -> Option<&'static str> {
    let is = |other: f64| (metres / other - 1.0).abs() < 1e-9;
    [(1.0, "m"), (FOOT_M, "ft"), (US_SURVEY_FOOT_M, "US survey foot"), (0.01, "cm"), (0.001, "mm"), (1000.0, "km")]
        .into_iter()
        .find_map(|(other, name)| is(other).then_some(name))
}

impl Place {
    /// Of the cloud, or what `options` say of it; what gets lost or stays open goes to `notes`.
    pub fn of(header: &Header, options: &Options, notes: &mut Vec<String>) -> Place {
        let text = header.crs.as_deref().or(options.crs_wkt.as_deref());
        let crs = text.and_then(|text| Crs::parse(text).ok());
        let unit = io::unit_of(text);
        let axis = crs.as_ref().and_then(Crs::height_metres_per_unit);
        let has_heights = options.dimensions.iter().any(|dimension| dimension.name == "z");
        let stated = header.las.as_ref().map_or(Ok(None), io::LasHeader::height_unit);
        let height_unit = stated.ok().flatten().or_else(|| named(axis?));
        if let (Err(code), true, None) = (stated, has_heights, height_unit) {
            notes.push(format!(
                "heights count in a unit with the code EPSG:{code} (VerticalUnitsGeoKey), which has no name among those of \
                 bands: `dem` will take those of z for metres"
            ));
        }
        let in_metres = crs.as_ref().is_none_or(|crs| crs.metres_per_unit() == 1.0);
        if height_unit.is_none() && stated.is_ok() && !in_metres && has_heights {
            notes.push(format!(
                "the map counts in {unit}, and nothing says in what heights count: `dem` will take those of z for \
                 metres; name their unit with gdal_edit.py -units ft (or -units us-ft) where they are feet"
            ));
        }
        // GeoTIFF has keys for two axes, or for two and heights over a geoid.
        let flat = crs.as_ref().and_then(Crs::without_ellipsoidal_height);
        let wkt = flat.or(crs).map(|crs| crs.wkt().to_string());
        // What PROJ knows it can take the heights from.
        let plane =
            wkt.as_deref().map(|wkt| without_heights(Path::new("CRS"), wkt).unwrap_or_else(|_| wkt.to_string()));
        Place { wkt, plane, unit, height_unit }
    }
}
