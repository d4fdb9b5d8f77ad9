//! Which grids PROJ misses between two systems. GDAL does not tell; PROJ, which GDAL brings, does.
#![allow(unsafe_code)]

use std::collections::BTreeSet;
use std::ffi::{CStr, CString, c_char, c_double, c_int};
use std::ptr::{null, null_mut};

use super::Crs;

/// The functions of `proj.h` (PROJ 6 and later) that are asked; their objects are opaque.
mod proj {
    use super::{c_char, c_double, c_int};

    #[repr(C)]
    pub struct Opaque([u8; 0]);

    /// `PROJ_SPATIAL_CRITERION_PARTIAL_INTERSECTION`.
    pub const PARTIAL_INTERSECTION: c_int = 1;
    /// `PROJ_GRID_AVAILABILITY_IGNORED`: sorted as if every grid were there.
    pub const AVAILABILITY_IGNORED: c_int = 2;

    #[link(name = "proj")]
    unsafe extern "C" {
        pub fn proj_context_create() -> *mut Opaque;
        pub fn proj_context_destroy(context: *mut Opaque) -> *mut Opaque;
        pub fn proj_log_level(context: *mut Opaque, level: c_int) -> c_int;
        pub fn proj_create(context: *mut Opaque, definition: *const c_char) -> *mut Opaque;
        pub fn proj_destroy(object: *mut Opaque) -> *mut Opaque;
        pub fn proj_create_operation_factory_context(context: *mut Opaque, authority: *const c_char) -> *mut Opaque;
        pub fn proj_operation_factory_context_destroy(factory: *mut Opaque);
        pub fn proj_operation_factory_context_set_area_of_interest(
            context: *mut Opaque,
            factory: *mut Opaque,
            west_deg: c_double,
            south_deg: c_double,
            east_deg: c_double,
            north_deg: c_double,
        );
        pub fn proj_operation_factory_context_set_spatial_criterion(
            context: *mut Opaque,
            factory: *mut Opaque,
            criterion: c_int,
        );
        pub fn proj_operation_factory_context_set_grid_availability_use(
            context: *mut Opaque,
            factory: *mut Opaque,
            availability: c_int,
        );
        pub fn proj_create_operations(
            context: *mut Opaque,
            from: *const Opaque,
            to: *const Opaque,
            factory: *const Opaque,
        ) -> *mut Opaque;
        pub fn proj_list_get_count(list: *const Opaque) -> c_int;
        pub fn proj_list_get(context: *mut Opaque, list: *const Opaque, index: c_int) -> *mut Opaque;
        pub fn proj_list_destroy(list: *mut Opaque);
        pub fn proj_coordoperation_get_grid_used_count(context: *mut Opaque, operation: *const Opaque) -> c_int;
        pub fn proj_coordoperation_get_grid_used(
            context: *mut Opaque,
            operation: *const Opaque,
            index: c_int,
            short_name: *mut *const c_char,
            full_name: *mut *const c_char,
            package: *mut *const c_char,
            url: *mut *const c_char,
            direct_download: *mut c_int,
            open_license: *mut c_int,
            available: *mut c_int,
        ) -> c_int;
    }
}

/// `PJ_LOG_NONE`: what fails is told by the caller.
const SILENT: c_int = 0;

/// Names of the grids that the best operation from one system to another would use and that are not installed, in
/// order. `around`: west, south, east, north, degrees. Empty when none is missing or PROJ does not say.
pub(super) fn missing(from: &Crs, to: &Crs, around: Option<[f64; 4]>) -> Vec<String> {
    let (Ok(from), Ok(to)) = (CString::new(from.wkt()), CString::new(to.wkt())) else { return Vec::new() };
    // SAFETY: PROJ's context, systems, factory and list are made here, given to PROJ's own functions only, not shared
    // with another thread, checked for null where PROJ does not, and destroyed once, the context last.
    unsafe {
        let context = proj::proj_context_create();
        proj::proj_log_level(context, SILENT);
        let (from, to) = (proj::proj_create(context, from.as_ptr()), proj::proj_create(context, to.as_ptr()));
        let factory = proj::proj_create_operation_factory_context(context, null());
        let mut names = Vec::new();
        if !from.is_null() && !to.is_null() && !factory.is_null() {
            if let Some([west, south, east, north]) = around {
                proj::proj_operation_factory_context_set_area_of_interest(context, factory, west, south, east, north);
            }
            proj::proj_operation_factory_context_set_spatial_criterion(context, factory, proj::PARTIAL_INTERSECTION);
            proj::proj_operation_factory_context_set_grid_availability_use(
                context,
                factory,
                proj::AVAILABILITY_IGNORED,
            );
            let list = proj::proj_create_operations(context, from, to, factory);
            if !list.is_null() {
                // Sorted by the authority's accuracy and area: the first that misses something is the best that cannot
                // be had.
                names = (0..proj::proj_list_get_count(list))
                    .map(|index| missing_of(context, list, index))
                    .find(|names| !names.is_empty())
                    .unwrap_or_default();
                proj::proj_list_destroy(list);
            }
        }
        for object in [from, to] {
            proj::proj_destroy(object);
        }
        if !factory.is_null() {
            proj::proj_operation_factory_context_destroy(factory);
        }
        proj::proj_context_destroy(context);
        names
    }
}

/// The grids that an operation of a list misses.
///
/// # Safety
/// `context` and `list` must be live objects of PROJ that no other thread uses.
unsafe fn missing_of(context: *mut proj::Opaque, list: *const proj::Opaque, index: c_int) -> Vec<String> {
    // SAFETY: as promised by the caller; the strings belong to the operation and are copied before it is destroyed.
    unsafe {
        let operation = proj::proj_list_get(context, list, index);
        if operation.is_null() {
            return Vec::new();
        }
        let mut names = BTreeSet::new();
        for grid in 0..proj::proj_coordoperation_get_grid_used_count(context, operation) {
            let (mut name, mut available) = (null(), 0);
            let known = proj::proj_coordoperation_get_grid_used(
                context,
                operation,
                grid,
                &mut name,
                null_mut(),
                null_mut(),
                null_mut(),
                null_mut(),
                null_mut(),
                &mut available,
            );
            if known != 0 && available == 0 && !name.is_null() {
                names.insert(CStr::from_ptr(name).to_string_lossy().into_owned());
            }
        }
        proj::proj_destroy(operation);
        names.into_iter().collect()
    }
}
