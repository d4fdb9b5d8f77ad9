//! North-up copies.

use std::path::Path;

use crate::coords::GeoTransform;
use crate::error::{Error, Result};
use crate::georef::crs::Crs;

#[derive(Clone, Debug, Default)]
pub struct WarpOptions {}

impl WarpOptions {
    pub fn check(&self, image: &Path) -> Result<()> {
        Err(Error::unsupported(image, "--write warp", "choose another kind"))
    }
}

pub fn write(
    image: &Path,
    _out: &Path,
    _transform: &GeoTransform,
    _crs: Option<&Crs>,
    options: &WarpOptions,
    _progress: &dyn Fn(f64) -> bool,
) -> Result<()> {
    options.check(image)
}
