//! Tags in place.

use std::path::{Path, PathBuf};

use crate::coords::GeoTransform;
use crate::error::{Error, Result};
use crate::georef::atomic::Edit;
use crate::georef::crs::Crs;
use crate::georef::write::WriteRequest;

#[derive(Clone, Debug, Default)]
pub struct TagOptions {}

pub struct TagEdit {
    path: PathBuf,
}

impl Edit for TagEdit {
    fn apply(self: Box<Self>) -> Result<()> {
        Err(Error::unsupported(&self.path, "--write tags", "choose another kind"))
    }
    fn path(&self) -> &Path {
        &self.path
    }
}

#[derive(Clone, Debug)]
pub struct Undone {
    pub length_bytes: u64,
    pub program: String,
    pub more_below: bool,
}

pub fn check(image: &Path, _page: usize, _options: &TagOptions) -> Result<()> {
    Err(Error::unsupported(image, "--write tags", "choose another kind"))
}

pub fn warnings(_request: &WriteRequest) -> Vec<String> {
    Vec::new()
}

pub fn prepare(
    image: &Path,
    page: usize,
    _transform: &GeoTransform,
    _crs: Option<&Crs>,
    options: &TagOptions,
) -> Result<TagEdit> {
    check(image, page, options)?;
    Ok(TagEdit { path: image.to_path_buf() })
}

pub fn undo(image: &Path, _dry_run: bool) -> Result<Undone> {
    Err(Error::unsupported(image, "undo", "nothing was written"))
}
