//! What a file of heights or differences says of itself, where the binding of GDAL has no word for it.
#![allow(unsafe_code)]

use std::path::Path;

use gdal::spatial_ref::SpatialRef;

use crate::error::{Error, Result};

/// Whether a feature has a geometry; GDAL's functions take one that is not there for an error.
pub fn has_geometry(feature: &gdal::vector::Feature<'_>) -> bool {
    // SAFETY: the geometry belongs to the feature, which outlives the call; the pointer is only compared.
    feature.geometry().is_some_and(|geometry| unsafe { !geometry.c_geometry().is_null() })
}

/// A CRS without its heights, for differences: they count from nothing, and are in metres.
///
/// # Errors
/// When GDAL cannot read it.
pub fn without_heights(path: &Path, wkt: &str) -> Result<String> {
    if wkt.is_empty() {
        return Ok(String::new());
    }
    let failed = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let reference = SpatialRef::from_wkt(wkt).map_err(failed)?;
    // SAFETY: the reference is owned here and outlives both calls, which change it in place; a null name keeps its own.
    unsafe {
        gdal_sys::OSRStripVertical(reference.to_c_hsrs());
        gdal_sys::OSRDemoteTo2D(reference.to_c_hsrs(), std::ptr::null());
    }
    reference.to_wkt().map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_go_and_the_plan_stays() {
        let path = Path::new("x.tif");
        for (with, code) in [("EPSG:2264+6360", 2264), ("EPSG:4979", 4326), ("EPSG:32633", 32_633)] {
            let wkt = SpatialRef::from_definition(with).and_then(|s| s.to_wkt()).expect("PROJ knows it");
            let plan = without_heights(path, &wkt).expect("a CRS");
            let plan = SpatialRef::from_wkt(&plan).expect("a CRS");
            assert_eq!(plan.auth_code().ok(), Some(code), "{with}");
            assert!(crate::couple::vertical(&plan.to_wkt().expect("a CRS")).is_none());
        }
        assert_eq!(without_heights(path, "").expect("nothing"), "");
    }
}
