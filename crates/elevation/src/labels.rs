//! What a file says of itself, where the binding of GDAL has no word for it.
#![allow(unsafe_code)]

/// Whether a feature has a geometry; GDAL's functions take one that is not there for an error.
pub fn has_geometry(feature: &gdal::vector::Feature<'_>) -> bool {
    // SAFETY: the geometry belongs to the feature, which outlives the call; the pointer is only compared.
    feature.geometry().is_some_and(|geometry| unsafe { !geometry.c_geometry().is_null() })
}
