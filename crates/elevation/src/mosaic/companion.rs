//! Companions of sources: rasters of what cells cost.

use std::path::{Path, PathBuf};

use autoref_raster::protected::same_file;
use autoref_raster::words::counted;

use crate::error::{Error, Result};
use crate::grid::Grid;

use super::alike::check_one_crs;
use super::rule::Choice;
use super::source::Source;
use super::turn;

/// Opens what a source's cells cost, which must lie on it.
pub(super) fn open_companion(source: &Source, path: PathBuf, mosaic: &Grid) -> Result<Source> {
    let named = |e: Error| match e {
        Error::Unsupported { what, remedy, .. } => Error::unsupported(&path, what, remedy),
        other => other,
    };
    let mut companion = Source::open(&path)?;
    check_one_crs(source, &companion).map_err(named)?;
    turn::bring_to(&mut companion, &source.grid);
    if source.grid.overlap(&companion.grid).is_none() {
        let what = format!("a companion that lies elsewhere than its source {}", source.path.display());
        return Err(Error::unsupported(&path, what, "write it again with the source, or correct its place"));
    }
    companion.snap(mosaic);
    Ok(companion)
}

/// Sources with cells that have no value in the companion, as words. `cells` counts them.
pub fn without_companion(sources: &[Source], mosaic: &Grid, cells: &[u64]) -> Vec<String> {
    let note = |(source, cells): (&Source, &u64)| {
        let companion = source.companion.as_ref().filter(|_| *cells > 0)?;
        let size = (source.grid.step_x / mosaic.step_x) * (source.grid.step_y / mosaic.step_y);
        let share = 100.0 * *cells as f64 / (source.grid.width as f64 * source.grid.height as f64 * size);
        Some(format!(
            "{}: {} ({share:.1} % of its area) without a value in {}: not taken from it",
            source.path.display(),
            counted(*cells, "cell", "cells"),
            companion.path.display()
        ))
    };
    sources.iter().zip(cells).filter_map(note).collect()
}

/// What a rule makes a mosaic read beside its sources, so that it can be protected before anything is written.
pub fn companions(inputs: &[PathBuf], choice: &Choice) -> Vec<PathBuf> {
    let Choice::Min(pattern) = choice else { return Vec::new() };
    inputs.iter().map(|source| companion_path(source, pattern)).collect()
}

/// The companion raster of a source. `{stem}` is the source's name; where no such file is, the name up to one of its
/// underscores, the longest first: the companion of `A_z_mean.tif` by `{stem}_range_mean.tif` is `A_range_mean.tif`.
pub(super) fn companion_path(source: &Path, pattern: &str) -> PathBuf {
    let stem = source.file_stem().unwrap_or_default().to_string_lossy();
    let path = |stem: &str| {
        let name = PathBuf::from(pattern.replace("{stem}", stem));
        if name.is_absolute() || pattern.contains('/') && name.exists() {
            name
        } else {
            source.with_file_name("").join(name)
        }
    };
    let whole = path(&stem);
    if whole.exists() {
        return whole;
    }
    let shorter = std::iter::successors(Some(&*stem), |stem| stem.rsplit_once('_').map(|(start, _)| start));
    shorter.map(path).find(|path| path.exists() && !same_file(path, source)).unwrap_or(whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_companion_goes_by_the_longest_name_that_is_there() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        let source = at("north_7_z_mean.tif");
        let pattern = "{stem}_range_mean.tif";
        // Nothing there: the name that the whole stem makes, for the message.
        assert_eq!(companion_path(&source, pattern), at("north_7_z_mean_range_mean.tif"));
        // A source may be its own companion; a shorter name does not take its place.
        for name in ["north_7_z_mean.tif", "north.tif"] {
            std::fs::write(at(name), "").expect("a file");
        }
        assert_eq!(companion_path(&source, "{stem}.tif"), source);
        for name in ["north_range_mean.tif", "north_7_range_mean.tif", "north_7_z_mean_range_mean.tif"] {
            std::fs::write(at(name), "").expect("a file");
            assert_eq!(companion_path(&source, pattern), at(name));
        }
    }
}
