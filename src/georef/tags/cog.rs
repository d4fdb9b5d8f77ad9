//! Cloud Optimized GeoTIFFs: their directories come before the pixels, so one at the end breaks the layout.

use std::os::unix::fs::FileExt;

use super::journal::Patch;
use autoref_raster::error::{Error, Result};
use autoref_raster::tiff::container::{Directories, Role, tag};

/// GDAL's "ghost area" right behind the header, as in
/// <https://gdal.org/drivers/raster/cog.html#header-ghost-area>.
const GHOST: &[u8] = b"GDAL_STRUCTURAL_METADATA_SIZE=";
/// By GDAL's design the same length as what replaces it.
const INTACT: &[u8] = b"KNOWN_INCOMPATIBLE_EDITION=NO\n ";
const BROKEN: &[u8] = b"KNOWN_INCOMPATIBLE_EDITION=YES\n";

/// What `--write tags` may do.
#[derive(Clone, Copy, Debug, Default)]
pub struct TagOptions {
    /// A Cloud Optimized GeoTIFF may become an ordinary one.
    pub break_cog: bool,
}

/// Refuses a COG unless it may be broken; gives the patch that makes its header tell the truth then.
///
/// # Errors
/// [`Error::Unsupported`] for a COG that must not be broken; [`Error::Io`].
pub fn check(file: &Directories, options: &TagOptions) -> Result<Option<Patch>> {
    let ghost = ghost_patch(file)?;
    if ghost.is_none() && !laid_out_as_cog(file)? {
        return Ok(None);
    }
    if options.break_cog {
        return Ok(ghost);
    }
    Err(Error::unsupported(
        &file.path,
        "tags in place in a Cloud Optimized GeoTIFF, which it would no longer be (the new directory lies behind the pixels)",
        "use --write aux or warp, or give --break-cog",
    ))
}

fn ghost_patch(file: &Directories) -> Result<Option<Patch>> {
    let at = if file.big { 16 } else { 8 };
    let mut bytes = vec![0; (file.len.saturating_sub(at)).min(1024) as usize];
    file.file
        .read_exact_at(&mut bytes, at)
        .map_err(|e| Error::io(&file.path, format!("read {} bytes at {at}", bytes.len()), e))?;
    if !bytes.starts_with(GHOST) || !contains(&bytes, b"LAYOUT=IFDS_BEFORE_DATA") {
        return Ok(None);
    }
    let found = bytes.windows(INTACT.len()).position(|window| window == INTACT);
    Ok(found.map(|offset| Patch { at: at + offset as u64, old: INTACT.to_vec(), new: BROKEN.to_vec() }))
}

fn contains(bytes: &[u8], word: &[u8]) -> bool {
    bytes.windows(word.len()).any(|window| window == word)
}

/// Tiled, with overviews, every directory before the first pixel, and the overviews' pixels before the image's: a COG,
/// whoever wrote it.
fn laid_out_as_cog(file: &Directories) -> Result<bool> {
    let last_directory = file.list.iter().map(|directory| directory.position).max().unwrap_or(0);
    let mut first_of_image = 0;
    let mut overviews = 0;
    for index in 0..file.list.len() {
        if file.entry(index, tag::TILE_OFFSETS).is_none() {
            return Ok(false);
        }
        // Empty tiles have no place.
        let offsets = file.numbers(index, tag::TILE_OFFSETS)?.unwrap_or_default().into_iter().filter(|&at| at > 0);
        let Some(first) = offsets.min() else { continue };
        if first < last_directory {
            return Ok(false);
        }
        match file.role(index)? {
            Role::Image if index == 0 => first_of_image = first,
            Role::Image => return Ok(false),
            Role::Overview if first > first_of_image => return Ok(false),
            Role::Overview => overviews += 1,
            Role::Mask | Role::MaskOverview => {}
        }
    }
    Ok(overviews > 0)
}
