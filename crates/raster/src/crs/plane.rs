//! The part of a CRS that says where cells lie, for bands that are no heights.
#![allow(unsafe_code)]

use std::path::Path;

use gdal::spatial_ref::SpatialRef;

use crate::crs::Crs;
use crate::error::{Error, Result};

/// A CRS without its heights, as WKT; empty for none. GDAL gives every band that names no unit that of the vertical
/// axis: differences, slopes, intensities and colours count from nothing. `path` is named in messages.
///
/// # Errors
/// When GDAL cannot read it.
pub fn without_heights(path: &Path, wkt: &str) -> Result<String> {
    if wkt.is_empty() {
        return Ok(String::new());
    }
    let failed = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let reference = SpatialRef::from_wkt(wkt).map_err(failed)?;
    // As it came, where there is nothing to take away.
    if !reference.is_compound() && reference.axes_count() != 3 {
        return Ok(wkt.to_string());
    }
    // SAFETY: the reference is owned here and outlives both calls, which change it in place; a null name keeps its own.
    unsafe {
        gdal_sys::OSRStripVertical(reference.to_c_hsrs());
        gdal_sys::OSRDemoteTo2D(reference.to_c_hsrs(), std::ptr::null());
    }
    reference.to_wkt().map_err(failed)
}

/// Whether two CRSs differ in their heights at most.
pub fn same_plane(a: &Crs, b: &Crs) -> bool {
    let plane = |crs: &Crs| without_heights(Path::new("CRS"), crs.wkt()).ok();
    plane(a).is_some_and(|of_a| plane(b) == Some(of_a))
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
            assert!(!plan.is_compound() && plan.axes_count() == 2, "{with}");
        }
        assert_eq!(without_heights(path, "").expect("nothing"), "");
        let crs = |text: &str| Crs::parse(text).expect("PROJ knows it");
        assert!(same_plane(&crs("EPSG:4326+5773"), &crs("EPSG:4326+3855")));
        assert!(!same_plane(&crs("EPSG:4326+5773"), &crs("EPSG:4258+3855")));
    }
}
