//! GeoTIFF tags in the image itself, with undo.
//!
//! `docs/decisions/tags-in-place.md` tells why it is done by appending. Nothing but the pointer to the image's
//! directory is changed (and one word in the header of a COG that is allowed to be one no longer): pixels, overviews
//! and masks stay where they are.

mod cog;
pub(super) mod directory;
#[cfg(test)]
mod faults;
mod journal;
pub(super) mod keys;
pub mod store;
mod untagged;

use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};
use std::time::Duration;

use self::store::Imagined;
use crate::georef::sidecar;
use autoref_raster::atomic::Edit;
use autoref_raster::bounded;
use autoref_raster::coords::GeoTransform;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};
use autoref_raster::tiff::container::Directories;
use autoref_raster::tiff::is_tiff;

pub use cog::TagOptions;
pub use journal::Plan;
pub use keys::RasterType;
pub(super) use untagged::Untagged;

const LOCK_ATTEMPTS: u32 = 40;
const LOCK_PAUSE: Duration = Duration::from_millis(50);

/// Tags that are about to be written.
#[derive(Debug)]
pub struct TagEdit {
    path: PathBuf,
    file: File,
    plan: Plan,
}

/// What was undone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Undone {
    /// Length of the file before the tags, and now again.
    pub length_bytes: u64,
    /// Program and version that had written them.
    pub program: String,
    /// The file had been edited before that as well: it can be undone once more.
    pub more_below: bool,
}

/// Refuses, before any work, files that cannot take tags.
///
/// # Errors
/// [`Error::Unsupported`] for what is no TIFF, and for a Cloud Optimized GeoTIFF unless it may be broken; [`Error::Io`]
/// when the file must not be written to; [`Error::Limit`] when a classic TIFF is nearly 4 GiB long.
pub fn check(image: &Path, page: usize, options: &TagOptions) -> Result<()> {
    let (_file, directories, index) = open(image, page)?;
    cog::check(&directories, options)?;
    directory::rebuild(&directories, index, &[]).map(|_| ())
}

/// Works out the edit. Nothing is written before [`Edit::apply`].
///
/// `transform` speaks of pixel corners, as everywhere; in a file that is PixelIsPoint the tags will speak of centres.
/// The second value says, in words, what GeoTIFF keys lose of the CRS.
///
/// # Errors
/// Those of [`check`]; [`Error::Gdal`] when GDAL has no GeoTIFF keys for the CRS.
pub fn prepare(
    image: &Path,
    page: usize,
    transform: &GeoTransform,
    crs: Option<&Crs>,
    options: &TagOptions,
) -> Result<(TagEdit, Option<String>)> {
    let (file, directories, index) = open(image, page)?;
    let ghost = cog::check(&directories, options)?;
    let raster_type = match directories.numbers(index, keys::GEO_KEY_DIRECTORY) {
        Ok(Some(keys)) => RasterType::of_keys(&keys),
        // Keys that cannot be read are replaced.
        Ok(None) | Err(_) => RasterType::default(),
    };
    let (tags, lost) = keys::geo_tags(transform, crs, raster_type)?;
    let rebuilt = directory::rebuild(&directories, index, &tags)?;
    let patches = ghost.into_iter().chain([rebuilt.pointer]).collect();
    let plan =
        Plan::new(&file, rebuilt.appended, patches, &rebuilt.directories).map_err(|e| Error::io(image, "read", e))?;
    Ok((TagEdit { path: image.to_path_buf(), file, plan }, lost))
}

impl Edit for TagEdit {
    fn apply(&mut self) -> Result<()> {
        self.plan.apply(&mut self.file).map_err(|e| Error::io(&self.path, "write tags into", e))
    }

    fn revert(&mut self) -> Result<()> {
        self.plan.revert(&mut self.file).map_err(|e| Error::io(&self.path, "restore", e))
    }

    fn path(&self) -> &Path {
        &self.path
    }
}

/// Whether an edit is taken back, or only asked whether it could be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Undo {
    Now,
    DryRun,
}

/// Takes back the last edit, byte for byte.
///
/// # Errors
/// [`Error::Usage`] when the file holds no undo record, or another program has changed it since; [`Error::Io`].
pub fn undo(image: &Path, how: Undo) -> Result<Undone> {
    let mut file = open_for_writing(image)?;
    let record = journal::read(image, &file)?;
    let io = |e| Error::io(image, "restore", e);
    let more_below = journal::has_record(&file, record.old_length).map_err(io)?;
    if how == Undo::Now {
        journal::undo(&mut file, &record).map_err(io)?;
    }
    Ok(Undone { length_bytes: record.old_length, program: record.program, more_below })
}

/// What taking back all edits would do, the last one first.
///
/// # Errors
/// As [`undo`], for each of them.
pub fn would_undo_all(image: &Path) -> Result<Vec<Undone>> {
    let file = open_for_writing(image)?;
    let mut imagined = Imagined::of(&file).map_err(|e| Error::io(image, "read", e))?;
    let records = journal::undo_all(image, &mut imagined)?;
    let last = records.len().saturating_sub(1);
    let undone = |(index, record): (usize, journal::Record)| Undone {
        length_bytes: record.old_length,
        program: record.program,
        more_below: index < last,
    };
    Ok(records.into_iter().enumerate().map(undone).collect())
}

/// Whether the file ends with an undo record.
pub fn is_tagged(image: &Path) -> bool {
    File::open(image).is_ok_and(|file| {
        let length = file.metadata().map_or(0, |metadata| metadata.len());
        journal::has_record(&file, length).unwrap_or(false)
    })
}

/// What others may stumble over once `image` has tags with `transform`, in words. `renewed`: its `.aux.xml` is written
/// too.
pub fn warning(image: &Path, renewed: bool, transform: &GeoTransform) -> Option<String> {
    let aux = sidecar::aux_path(image);
    let text = bounded::read_to_string(&aux, "an .aux.xml", bounded::TEXT_BYTES).unwrap_or_default();
    let other = sidecar::transform_of_aux(&text).is_none_or(|old| old.differs_px(transform) > 1e-3);
    let placed = ["<GeoTransform", "<GCPList"].iter().any(|word| text.contains(word));
    (!renewed && placed && other).then(|| {
        format!(
            "{} holds another georeference, which GDAL and QGIS believe before the tags; write it anew: \
             --write aux,tags --overwrite",
            aux.display()
        )
    })
}

fn open(image: &Path, page: usize) -> Result<(File, Directories, usize)> {
    let metadata = std::fs::metadata(image).map_err(|e| Error::io(image, "open", e))?;
    if !metadata.is_file() || !is_tiff(image)? {
        return Err(Error::unsupported(image, "tags in a file that is no TIFF", "use --write world,aux"));
    }
    let file = open_for_writing(image)?;
    let directories = Directories::read(image)?;
    let index = directories.page(page)?;
    Ok((file, directories, index))
}

/// Opens and locks it against a second one of us.
fn open_for_writing(image: &Path) -> Result<File> {
    let file =
        OpenOptions::new().read(true).write(true).open(image).map_err(|e| Error::io(image, "open for writing", e))?;
    // A child process that is just being started holds a copy of our own lock for a moment: try again.
    for attempt in 0..=LOCK_ATTEMPTS {
        match file.try_lock() {
            Err(std::fs::TryLockError::WouldBlock) if attempt < LOCK_ATTEMPTS => std::thread::sleep(LOCK_PAUSE),
            Err(std::fs::TryLockError::WouldBlock) => break,
            // File systems without locks are written to without.
            Ok(()) | Err(std::fs::TryLockError::Error(_)) => return Ok(file),
        }
    }
    let what = format!("{}: another run is writing to it", image.display());
    Err(Error::usage(what, "wait until it has finished"))
}
