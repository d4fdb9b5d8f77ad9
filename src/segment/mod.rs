//! From pixels to regions: colour test, filters, connected components.

pub mod classify;
pub mod filters;
pub mod kernels;
pub mod label;
pub mod mask;
