//! From pixels to regions: colour test, filters, connected components.

pub mod label;
pub mod mask;
