//! Whether GDAL, and every program that reads through it, finds the new georeference in an image by what is written
//! beside it.
//!
//! Of a TIFF, JPEG or PNG an `.aux.xml` comes first; of HFA, ENVI, NITF, GeoPackage, a VRT and others their own
//! georeference does, and some take the transform but not the CRS. This differs between versions of GDAL and between
//! images of one format, so no table of formats is asked but GDAL: the image and what lies beside it are linked into a
//! folder of their own, the new files are put there, and GDAL opens the link.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::georef::output::Output;
use crate::georef::sidecar;
use crate::georef::tags;
use crate::georef::write::{Part, WriteRequest};
use crate::result::RunResult;
use autoref_raster::bounded;
use autoref_raster::coords::GeoTransform;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};
use autoref_raster::protected::same_file;
use autoref_raster::{Georeference, georeference_at};

/// Transforms that put no pixel farther apart are one: world files are rounded.
const SAME_PX: f64 = 1e-3;

/// Where GDAL finds a new georeference once all is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Found {
    /// In the image that was solved.
    InImage,
    /// In this output; the image keeps what it has.
    In(PathBuf),
    /// In no raster: world file or `.aux.xml` are in another folder or passed over, or points alone are written.
    Nowhere,
    /// The image could not be opened in a folder of links.
    Unknown,
}

/// Whether GDAL takes transform and CRS of an image from a world file and an `.aux.xml` beside it. What cannot be tried
/// is taken to.
pub fn heeds_sidecars(image: &Path, page: usize) -> bool {
    let tried = || -> Result<bool> {
        // What no image has of itself.
        let transform = GeoTransform([400_000.0, 0.25, 0.125, 5_000_000.0, 0.125, -0.25]);
        let crs = Crs::from_epsg(32_633)?;
        let beside = Beside {
            world: Some(sidecar::world_file(&transform)),
            aux: Some(sidecar::aux_xml(&transform, Some(&crs), None)?),
        };
        Ok(is_shown(&beside.opened(image, page)?, &transform, Some(&crs)))
    };
    tried().unwrap_or_else(|error| {
        tracing::debug!("{}: what is written beside it could not be tried: {error}", image.display());
        true
    })
}

impl WriteRequest {
    /// Where GDAL will find the georeference of a solved result.
    ///
    /// # Errors
    /// When the tiles of a folder cannot be opened, or the result's CRS is none.
    pub fn found(&self, result: &RunResult) -> Result<Found> {
        let Some(transform) = result.geotransform() else { return Ok(Found::Nowhere) };
        let crs = result.crs.as_deref().map(Crs::parse).transpose()?;
        // Tiles of a folder are alike: the first one speaks for all.
        if let Some(part) = self.parts()?.first() {
            let transform = part.transform(&transform);
            match self.is_in_image(part, &transform, crs.as_ref()) {
                Ok(true) => return Ok(Found::InImage),
                Ok(false) => {}
                Err(error) => {
                    tracing::debug!("{}: what GDAL will find is not known: {error}", part.path.display());
                    return Ok(Found::Unknown);
                }
            }
        }
        let raster = [Output::Vrt, Output::Warp].into_iter().find(|kind| self.wants(*kind));
        Ok(raster.and_then(|kind| self.own_files(kind).pop()).map_or(Found::Nowhere, Found::In))
    }

    /// What a person must know who opens the image itself, once world file or `.aux.xml` are written beside it.
    ///
    /// # Errors
    /// When the tiles of a folder cannot be opened.
    pub fn what_to_open(&self, found: &Found) -> Result<Option<String>> {
        let parts = self.parts()?;
        let Some(part) = parts.first().filter(|part| self.writes_beside(part) && !self.wants(Output::Tags)) else {
            return Ok(None);
        };
        let remedy = match found {
            Found::In(file) => format!("open {}", file.display()),
            Found::Nowhere if !self.wants(Output::Aux) && heeds_sidecars(&part.path, self.page) => {
                "add aux to --write".to_owned()
            }
            Found::Nowhere => "add vrt to --write, and open that".to_owned(),
            Found::InImage | Found::Unknown => return Ok(None),
        };
        Ok(Some(format!(
            "GDAL and QGIS do not take the new georeference of {} from what is written beside it: {remedy}",
            part.path.display()
        )))
    }

    /// Whether a world file or an `.aux.xml` goes where GDAL looks for those of the image.
    fn writes_beside(&self, part: &Part) -> bool {
        (self.wants(Output::World) || self.wants(Output::Aux)) && same_file(&part.base, &part.path)
    }

    fn is_in_image(&self, part: &Part, transform: &GeoTransform, crs: Option<&Crs>) -> Result<bool> {
        let beside = self.writes_beside(part);
        if self.wants(Output::Tags) {
            let renewed = beside && self.wants(Output::Aux);
            return Ok(tags::warning(&part.path, renewed, transform).is_none());
        }
        if !beside {
            return Ok(false);
        }
        let aux = match self.wants(Output::Aux) {
            true => {
                let file = sidecar::aux_path(&part.path);
                let existing = bounded::read_to_string(&file, "an .aux.xml", bounded::TEXT_BYTES).ok();
                let existing = existing.as_deref().map(|text| (file.as_path(), text));
                let crs = sidecar::crs_beside(&part.path, self.page, crs)?;
                Some(sidecar::aux_xml(transform, crs.as_ref(), existing)?)
            }
            false => None,
        };
        let world = self.wants(Output::World).then(|| sidecar::world_file(transform));
        // A world file alone names no CRS, and none is missed.
        let crs = crs.filter(|_| aux.is_some());
        Ok(is_shown(&Beside { world, aux }.opened(&part.path, self.page)?, transform, crs))
    }
}

/// Whether GDAL has found this transform, and this CRS where one is expected.
fn is_shown(found: &Georeference, transform: &GeoTransform, crs: Option<&Crs>) -> bool {
    let is_same = |shown: &Crs, crs: &Crs| shown.label() == crs.label() || shown.name() == crs.name();
    let has_crs = || {
        crs.is_none_or(|crs| {
            let shown = found.crs_wkt.as_deref().and_then(|wkt| Crs::parse(wkt).ok());
            shown.is_some_and(|shown| is_same(&shown, crs))
        })
    };
    found.transform.is_some_and(|shown| shown.differs_px(transform) < SAME_PX) && has_crs()
}

/// Contents of the files beside an image; `None` for those that stay as they are.
struct Beside {
    world: Option<String>,
    aux: Option<String>,
}

impl Beside {
    /// What GDAL finds in the image with these beside it.
    fn opened(&self, image: &Path, page: usize) -> Result<Georeference> {
        let cannot = |e| Error::io(image, "link", e);
        let name =
            image.file_name().ok_or_else(|| Error::unsupported(image, "a path without a name", "name a file"))?;
        let folder = match image.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            Some(parent) => parent.canonicalize(),
            None => std::env::current_dir(),
        }
        .map_err(cannot)?;
        let place = tempfile::tempdir().map_err(cannot)?;
        let files = [(sidecar::world_file_path(image), &self.world), (sidecar::aux_path(image), &self.aux)];
        let mut written: Vec<&OsStr> = Vec::new();
        for (file, text) in &files {
            if let (Some(text), Some(file)) = (text, file.file_name()) {
                std::fs::write(place.path().join(file), text).map_err(cannot)?;
                written.push(file);
            }
        }
        for entry in std::fs::read_dir(&folder).map_err(cannot)?.flatten() {
            let other = entry.file_name();
            let is_renewed = written.iter().any(|file| other == **file);
            if !is_renewed && (other == name || belongs_to(image, Path::new(&other))) {
                std::os::unix::fs::symlink(folder.join(&other), place.path().join(&other)).map_err(cannot)?;
            }
        }
        let place_path = place.path().canonicalize().map_err(cannot)?;
        georeference_at(&place_path.join(name), page)
    }
}

/// Whether GDAL may look for `other` beside an image: `e6.hdr`, `e6.tif.aux.xml`, or `e6` of `e6.ers`.
fn belongs_to(image: &Path, other: &Path) -> bool {
    let (stem, other) =
        (image.file_stem().unwrap_or_default().as_encoded_bytes(), other.as_os_str().as_encoded_bytes());
    other.strip_prefix(stem).is_some_and(|rest| rest.first().is_none_or(|letter| *letter == b'.'))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A small image of this driver, with a georeference of its own or without.
    fn image(folder: &Path, driver: &str, name: &str, own: Option<[f64; 6]>) -> PathBuf {
        autoref_raster::initialise_gdal(0);
        let path = folder.join(name);
        let of = |name| gdal::DriverManager::get_driver_by_name(name).expect("there");
        let mut file = of("MEM").create_with_band_type::<u8, _>("", 30, 20, 1).expect("created");
        if let Some(own) = own {
            file.set_geo_transform(&own).expect("set");
            file.set_projection(Crs::from_epsg(25_832).expect("known").wkt()).expect("set");
        }
        file.create_copy(&of(driver), &path, &Default::default()).expect("copied").close().expect("written");
        path
    }

    #[test]
    fn formats_whose_own_georeference_comes_first_are_told_from_others() {
        let folder = tempfile::tempdir().expect("a folder");
        let own = Some([500_000.0, 0.5, 0.0, 6_000_000.0, 0.0, -0.5]);
        for (driver, name, heeds) in
            [("GTiff", "a.tif", true), ("PNG", "b.png", true), ("HFA", "c.img", false), ("ENVI", "d.dat", false)]
        {
            assert_eq!(heeds_sidecars(&image(folder.path(), driver, name, own), 0), heeds, "{driver}");
        }
        // The transform without the CRS is half a georeference.
        assert!(!heeds_sidecars(&image(folder.path(), "HFA", "e.img", None), 0));
    }

    #[test]
    fn what_lies_beside_an_image_is_told_by_its_name() {
        let belongs = |other: &str| belongs_to(Path::new("a/e6.tif"), Path::new(other));
        assert!(belongs("e6.tfw") && belongs("e6.tif.aux.xml") && belongs("e6"));
        assert!(!belongs("e60.tif") && !belongs("e6-2.tfw") && !belongs("E.tfw"));
    }
}
