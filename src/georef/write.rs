//! Everything a solved orientation can be written as, checked before the work and put in place all together.
//!
//! Files are made under temporary names first ([`WriteRequest::stage`]); only when all of them exist are they renamed,
//! and the image's own tags switched ([`Transaction::commit`]). A failure at any point leaves what was there before.

use std::path::{Path, PathBuf};

use crate::georef::dialects::{self, TiePoints};
use crate::georef::output::Output;
use crate::georef::{exif, gcps_vrt, sidecar, tags, warp};
use crate::result::RunResult;
use autoref_raster::atomic::{self, Existing, Transaction};
use autoref_raster::bounded;
use autoref_raster::coords::GeoTransform;
use autoref_raster::crs::{Coordinate, Crs, DEFAULT_DATUM_ACCURACY_M};
use autoref_raster::error::{Error, Result};
use autoref_raster::protected::same_file;
use autoref_raster::tile_folder;

impl Output {
    /// The files of this kind beside `base`. None for tags, which go into the image.
    pub fn files(self, base: &Path) -> Vec<PathBuf> {
        match self {
            Output::World => vec![sidecar::world_file_path(base)],
            Output::Aux => vec![sidecar::aux_path(base)],
            Output::Vrt => vec![base.with_extension("vrt")],
            Output::Tags => Vec::new(),
            Output::Warp => vec![base.with_extension("warp.tif")],
            Output::Exif => vec![base.with_extension("exif.jpg")],
            Output::Gcps => vec![base.with_extension("gcps.vrt")],
            _ => dialects::files(self, base),
        }
    }
}

/// What to write, and where. Known before the image is read, so that what cannot be done is refused at once.
#[derive(Clone, Debug)]
pub struct WriteRequest {
    /// The raster that gets the georeference.
    pub image: PathBuf,
    /// Its image, counted from 0 over those of full resolution.
    pub page: usize,
    /// Output names extend this path: the image's own, or its name in another folder.
    pub base: PathBuf,
    /// The other folder.
    pub out: Option<PathBuf>,
    pub kinds: Vec<Output>,
    pub existing: Existing,
    pub tags: tags::TagOptions,
    pub warp: warp::WarpOptions,
    /// Worst accuracy of the change of datum to the WGS 84 of EXIF, metres.
    pub datum_accuracy_m: f64,
}

impl WriteRequest {
    /// Outputs beside the image, or in the folder `out`.
    pub fn new(image: &Path, out: Option<&Path>, kinds: &[Output], existing: Existing) -> Self {
        let is_folder = tile_folder::is_tile_folder(image);
        // `tiles/` and `tiles.txt` are written as `tiles.vrt` is.
        let own = if is_folder { image.with_extension("vrt") } else { image.to_path_buf() };
        let name = own.file_name().map_or_else(|| "image".into(), std::ffi::OsStr::to_os_string);
        let mut unique: Vec<Output> = Vec::new();
        for kind in Output::ALL {
            if kinds.contains(&kind) {
                unique.push(kind);
            }
        }
        WriteRequest {
            image: image.to_path_buf(),
            page: 0,
            base: out.map_or(own, |folder| folder.join(name)),
            out: out.map(Path::to_path_buf),
            kinds: unique,
            existing,
            tags: tags::TagOptions::default(),
            warp: warp::WarpOptions::default(),
            datum_accuracy_m: DEFAULT_DATUM_ACCURACY_M,
        }
    }

    /// The files with their own world files, `.aux.xml` and tags: the image, or the tiles of a folder, each with its
    /// corner in pixels of the whole.
    pub(super) fn parts(&self) -> Result<Vec<Part>> {
        if !tile_folder::is_tile_folder(&self.image) {
            return Ok(vec![Part { path: self.image.clone(), base: self.base.clone(), tile: None }]);
        }
        let folder = tile_folder::TileFolder::open(&self.image)?;
        let part = |tile: tile_folder::Tile| {
            let path = tile.path.clone();
            let name = path.file_name().unwrap_or_default();
            Part { base: self.out.as_ref().map_or(path.clone(), |out| out.join(name)), path, tile: Some(tile) }
        };
        Ok(folder.tiles.into_iter().map(part).collect())
    }

    fn files_of(&self, kind: Output, parts: &[Part]) -> Vec<PathBuf> {
        match kind {
            Output::World | Output::Aux => parts.iter().flat_map(|part| kind.files(&part.base)).collect(),
            _ => self.own_files(kind),
        }
    }

    /// The files of a kind that is of the whole image. A virtual raster of a virtual raster beside it has a name of its
    /// own: `e6.autoref.vrt`, as the result is `e6.autoref.json`.
    pub(super) fn own_files(&self, kind: Output) -> Vec<PathBuf> {
        let files = kind.files(&self.base);
        if kind == Output::Vrt && same_file(&files[0], &self.image) {
            return vec![self.base.with_extension("autoref.vrt")];
        }
        files
    }

    /// Every file that will be written, the image itself not counted.
    ///
    /// # Errors
    /// When the tiles of a folder cannot be opened.
    pub fn files(&self) -> Result<Vec<PathBuf>> {
        let parts = self.parts()?;
        Ok(self.kinds.iter().flat_map(|&kind| self.files_of(kind, &parts)).collect())
    }

    /// Whether this output was asked for.
    pub fn wants(&self, kind: Output) -> bool {
        self.kinds.contains(&kind)
    }

    /// Refuses, before any work, what cannot be written.
    ///
    /// # Errors
    /// [`Error::Usage`] for outputs that exist and are to be kept or that are the image itself; whatever speaks against
    /// tags in this file or against a warped copy.
    pub fn check(&self) -> Result<()> {
        let parts = self.parts()?;
        let files: Vec<PathBuf> = self.kinds.iter().flat_map(|&kind| self.files_of(kind, &parts)).collect();
        for file in &files {
            if same_file(file, &self.image) {
                return Err(Error::usage(
                    format!("the output {} is the image itself", file.display()),
                    "give --out DIR, or choose another --write",
                ));
            }
        }
        atomic::check_outputs(&files.iter().map(PathBuf::as_path).collect::<Vec<_>>(), self.existing)?;
        if self.wants(Output::Tags) {
            for part in &parts {
                tags::check(&part.path, self.page, &self.tags)?;
            }
        }
        if self.wants(Output::Exif) {
            exif::check(&self.image)?;
        }
        if self.wants(Output::Warp) {
            self.warp.check(&self.image, self.page)?;
        }
        Ok(())
    }

    /// Refuses a world file alone for local coordinates beside an image that has a CRS: it names none, so that GDAL
    /// would read it in the image's.
    ///
    /// # Errors
    /// [`Error::Usage`] with the remedy; when the image cannot be opened.
    pub fn check_local(&self, crs: Option<&Crs>) -> Result<()> {
        if crs.is_some() || !self.wants(Output::World) || self.wants(Output::Aux) {
            return Ok(());
        }
        for part in self.parts()? {
            if sidecar::has_crs(&part.path, self.page)? {
                return Err(Error::usage(
                    format!(
                        "{} has a CRS, in which a world file of local coordinates would be read",
                        part.path.display()
                    ),
                    "add aux to --write, which says that they are local, or give the --crs of the list",
                ));
            }
        }
        Ok(())
    }

    /// Refuses a CRS whose places EXIF cannot have. `around`: places of the image in it.
    ///
    /// # Errors
    /// [`Error::CoarseDatum`] with the option that accepts it; [`Error::Usage`] for an accuracy that is none.
    pub fn check_place(&self, crs: Option<&Crs>, around: &[Coordinate]) -> Result<()> {
        exif::check_datum(crs, around, self.datum_accuracy_m)
    }

    /// Makes every file under a temporary name and adds it to the transaction. Nothing is in place before
    /// [`Transaction::commit`]. Returns warnings in plain words.
    ///
    /// # Errors
    /// When the result holds no transform, or a file cannot be made.
    pub fn stage(
        &self,
        result: &RunResult,
        transaction: &mut Transaction,
        progress: &dyn Fn(f64) -> bool,
    ) -> Result<Vec<String>> {
        let transform = result.geotransform().ok_or_else(|| {
            Error::usage("the result holds no georeference: it was not solved", "run again with better marks or GCPs")
        })?;
        let crs = result.crs.as_deref().map(Crs::parse).transpose()?;
        let crs = crs.as_ref();
        self.check_local(crs)?;
        let mut warnings = Vec::new();
        let parts = self.parts()?;
        for &kind in &self.kinds {
            let files = self.own_files(kind);
            match kind {
                Output::World | Output::Aux | Output::Tags => {
                    for part in &parts {
                        warnings.extend(self.stage_part(kind, part, &part.transform(&transform), crs, transaction)?);
                    }
                }
                Output::Vrt => transaction.stage(&files[0], |temporary| {
                    sidecar::write_vrt(&self.image, self.page, temporary, &transform, crs)
                })?,
                Output::Warp => transaction.stage(&files[0], |temporary| {
                    warp::write(&self.image, self.page, temporary, &transform, crs, &self.warp, progress)
                })?,
                Output::Exif => {
                    let place = exif::Place::of(&transform, crs, result, self.datum_accuracy_m)?;
                    transaction.stage(&files[0], |temporary| exif::write(&self.image, temporary, &place))?;
                    warnings.extend(place.lost);
                }
                Output::Gcps => {
                    let points = TiePoints::of(result, &self.base, crs);
                    transaction
                        .stage(&files[0], |temporary| gcps_vrt::write(&self.image, self.page, temporary, &points))?;
                }
                _ => {
                    let points = TiePoints::of(result, &self.base, crs);
                    transaction.stage_all(&files, |temporaries| dialects::write(kind, temporaries, &points))?;
                    warnings.extend(dialects::lost(kind, &points));
                }
            }
        }
        Ok(warnings)
    }

    /// What goes beside, or into, one file.
    fn stage_part(
        &self,
        kind: Output,
        part: &Part,
        transform: &GeoTransform,
        crs: Option<&Crs>,
        transaction: &mut Transaction,
    ) -> Result<Vec<String>> {
        if kind == Output::Tags {
            let (edit, lost) = tags::prepare(&part.path, self.page, transform, crs, &self.tags)?;
            transaction.on_commit(edit);
            let renewed = self.wants(Output::Aux) && part.base == part.path;
            return Ok(tags::warning(&part.path, renewed, transform).into_iter().chain(lost).collect());
        }
        let file = &kind.files(&part.base)[0];
        if kind == Output::World {
            transaction.stage_bytes(file, sidecar::world_file(transform).as_bytes())?;
        } else {
            let existing = bounded::read_to_string(file, "an .aux.xml", bounded::TEXT_BYTES).ok();
            let existing = existing.as_deref().map(|text| (file.as_path(), text));
            let crs = sidecar::crs_beside(&part.path, self.page, crs)?;
            let aux = sidecar::aux_xml(transform, crs.as_ref(), existing)?;
            transaction.stage_bytes(file, aux.as_bytes())?;
        }
        Ok(Vec::new())
    }
}

/// A file with a georeference of its own.
pub(super) struct Part {
    pub(super) path: PathBuf,
    /// Its output names extend this path.
    pub(super) base: PathBuf,
    tile: Option<tile_folder::Tile>,
}

impl Part {
    /// Its transform when the whole has `transform`.
    pub(super) fn transform(&self, transform: &GeoTransform) -> GeoTransform {
        self.tile.as_ref().map_or(*transform, |tile| tile_folder::TileFolder::transform_of(tile, transform))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back_and_files_do_not_collide() {
        let mut files: Vec<PathBuf> = Vec::new();
        for kind in Output::ALL {
            assert_eq!(kind.name().parse::<Output>(), Ok(kind));
            files.extend(kind.files(Path::new("a/e6.tif")));
        }
        let count = files.len();
        files.sort();
        files.dedup();
        assert_eq!(files.len(), count, "two kinds share a file");
        let message = "wolrd".parse::<Output>().expect_err("a typing error");
        assert!(message.contains("gcp-list"), "{message}");
    }
}
