//! What an image said of its place before this program wrote there.
//!
//! A run, or `apply`, leaves world file, `.aux.xml` or tags by which GDAL places the image from then on. The next run
//! must not take these for what the photogrammetry wrote: its own result would be its prior.

use std::cell::LazyCell;
use std::path::{Path, PathBuf};

use crate::georef::sidecar;
use crate::georef::tags::{self, Untagged};
use crate::result::{PriorGeoreference, RunResult};
use autoref_raster::coords::GeoTransform;
use autoref_raster::error::Result;
use autoref_raster::{Georeference, RasterInfo, bounded, georeference_inside, tile_folder};

/// Transforms that put no pixel farther apart are one: world files are rounded.
pub const SAME_PX: f64 = 1e-3;
/// No photogrammetry agrees so well with the marks: a prior that does is the result.
const REPEATED_PX: f64 = 0.01;

/// `e6.tif` → `e6.autoref.json`.
pub fn result_path(image: &Path) -> PathBuf {
    image.with_extension("autoref.json")
}

/// The georeference that lies beneath the one that `info` shows of image `page`, where that is this program's: what the
/// file itself says, its tags undone, else what the result beside it has recorded, else a world file of others. Nothing
/// in it where none of them knows. `None` where the image shows a georeference of others, or none.
pub fn beneath(info: &RasterInfo, page: usize) -> Option<Georeference> {
    let shown = info.geotransform?;
    let image = info.path.as_path();
    if image.to_string_lossy().starts_with("/vsi") {
        return None;
    }
    let recorded = LazyCell::new(|| recorded(image, (info.width, info.height)));
    let is_shown = |other: &GeoTransform| shown.differs_px(other) < SAME_PX;
    let by_result = || recorded.as_ref().and_then(RunResult::geotransform).is_some_and(|own| is_shown(&own));
    if tile_folder::is_tile_folder(image) {
        return by_result().then(|| of_result(recorded.as_ref(), &shown).flatten().unwrap_or_default());
    }
    let is_tagged = tags::is_tagged(image);
    let by_tags = || is_tagged && inside(image, page, None).transform.is_some_and(|own| is_shown(&own));
    if !(aux(image).is_some_and(|own| is_shown(&own)) || by_tags() || by_result()) {
        return None;
    }
    let inside = match is_tagged {
        true => Untagged::of(image).map(|earlier| inside(image, page, Some(&earlier.name()))).unwrap_or_default(),
        false => inside(image, page, None),
    };
    match inside.transform {
        // A VRT of ours says itself what was solved; what its image had is on record.
        Some(own) if is_virtual(image) && is_shown(&own) && by_result() => {
            Some(of_result(recorded.as_ref(), &shown).flatten().unwrap_or_default())
        }
        // Where that is what the image shows, it is a copy of an earlier result, and lies right.
        Some(_) => Some(inside),
        None => match of_result(recorded.as_ref(), &shown) {
            Some(prior) => Some(prior.unwrap_or(inside)),
            None => Some(Georeference { transform: world(image).filter(|other| !is_shown(other)), ..inside }),
        },
    }
}

/// Whether a prior is the result itself, as of a second run by versions that took their own output for one.
pub(super) fn repeats(prior: &GeoTransform, solved: &GeoTransform) -> bool {
    solved.differs_px(prior) < REPEATED_PX
}

fn is_virtual(image: &Path) -> bool {
    image.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("vrt"))
}

/// The result beside an image of so many pixels; that of `e6.vrt` beside `e6.autoref.vrt`.
fn recorded(image: &Path, size: (u64, u64)) -> Option<RunResult> {
    let path = result_path(image);
    let is_ours = image.file_name().is_some_and(|name| name.to_string_lossy().ends_with(".autoref.vrt"));
    let path = if is_ours && !path.is_file() { image.with_extension("json") } else { path };
    let result = path.is_file().then(|| RunResult::read(&path).ok()).flatten()?;
    result.image.as_ref().is_some_and(|image| (image.width, image.height) == size).then_some(result)
}

/// The prior of a result; inside `None` where there was none, or where it is the result of an earlier run.
fn of_result(recorded: Option<&RunResult>, shown: &GeoTransform) -> Option<Option<Georeference>> {
    let prior = recorded?.prior_georeference.as_ref();
    let prior = prior.filter(|prior| !repeats(&prior.geotransform, shown));
    let of =
        |prior: &PriorGeoreference| Georeference { transform: Some(prior.geotransform), crs_wkt: prior.crs.clone() };
    Some(prior.map(of))
}

/// What the file itself says; nothing where it cannot be opened alone.
fn inside(image: &Path, page: usize, bytes: Option<&Path>) -> Georeference {
    let read: Result<Georeference> = georeference_inside(image, page, bytes);
    read.unwrap_or_else(|error| {
        tracing::debug!("no georeference beneath that of an earlier run: {error}");
        Georeference::default()
    })
}

/// The transform of an `.aux.xml` of ours.
pub(super) fn aux(image: &Path) -> Option<GeoTransform> {
    let text = bounded::read_to_string(&sidecar::aux_path(image), "an .aux.xml", bounded::TEXT_BYTES).ok()?;
    sidecar::transform_of_own_aux(&text)
}

/// The transform of a world file, by any of the names that GDAL looks for: `e6.tfw`, `e6.tifw`, `e6.wld`, in small and
/// in capital letters.
fn world(image: &Path) -> Option<GeoTransform> {
    let extension = image.extension().map(|extension| extension.to_string_lossy().into_owned()).unwrap_or_default();
    let names = [sidecar::world_file_path(image), image.with_extension(extension + "w"), image.with_extension("wld")];
    let in_capitals = names.clone().map(|name| {
        let extension = name.extension().map(|extension| extension.to_string_lossy().to_uppercase());
        name.with_extension(extension.unwrap_or_default())
    });
    let in_small = names.clone().map(|name| {
        let extension = name.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        name.with_extension(extension.unwrap_or_default())
    });
    let found = names.into_iter().chain(in_small).chain(in_capitals).find(|name| name.is_file())?;
    let text = bounded::read_to_string(&found, "a world file", bounded::TEXT_BYTES).ok()?;
    sidecar::transform_of_world(&text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::ReaderChoice;
    use autoref_raster::atomic::Edit;
    use gdal::raster::Buffer;

    const DRONE: GeoTransform = GeoTransform([500_000.0, 0.5, 0.0, 7_000_000.0, 0.0, -0.5]);
    const SOLVED: GeoTransform = GeoTransform([500_011.25, 0.4, 0.3, 7_000_003.5, 0.3, -0.4]);
    const AGAIN: GeoTransform = GeoTransform([500_011.27, 0.4, 0.3, 7_000_003.49, 0.3, -0.4]);

    /// A folder with `a.tif`, or with another extension by its driver.
    fn image(driver: &str, name: &str, own: Option<GeoTransform>) -> (tempfile::TempDir, PathBuf) {
        autoref_raster::initialise_gdal(0);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(name);
        let of = |name| gdal::DriverManager::get_driver_by_name(name).expect("there");
        let mut file = of("MEM").create_with_band_type::<u8, _>("", 30, 20, 1).expect("created");
        let mut band = file.rasterband(1).expect("there");
        band.write((0, 0), (30, 20), &mut Buffer::new((30, 20), vec![7u8; 600])).expect("written");
        if let Some(own) = own {
            file.set_geo_transform(&own.0).expect("set");
        }
        file.create_copy(&of(driver), &path, &Default::default()).expect("copied").close().expect("written");
        (folder, path)
    }

    fn beneath_of(path: &Path) -> Option<Option<GeoTransform>> {
        let source = autoref_raster::open(path, ReaderChoice::Auto, 0, 1 << 20).expect("opens");
        beneath(source.info(), 0).map(|found| found.transform)
    }

    fn write_aux(path: &Path, transform: &GeoTransform) {
        let text = sidecar::aux_xml(transform, None, None).expect("XML");
        std::fs::write(sidecar::aux_path(path), text).expect("written");
    }

    fn write_tags(path: &Path, transform: &GeoTransform) {
        let options = tags::TagOptions::default();
        tags::prepare(path, 0, transform, None, &options).expect("a plan").0.apply().expect("written");
    }

    fn near(found: Option<Option<GeoTransform>>, expected: &GeoTransform) {
        let found = found.expect("ours").expect("known");
        assert!(found.differs_px(expected) < 1e-6, "{found:?}");
    }

    #[test]
    fn what_others_wrote_is_no_result() {
        for (driver, name) in [("GTiff", "a.tif"), ("PNG", "a.png")] {
            assert_eq!(beneath_of(&image(driver, name, None).1), None);
            let (_folder, path) = image(driver, name, Some(DRONE));
            assert_eq!(beneath_of(&path), None, "{name}");
        }
        // A better georeference over tags of ours.
        let (_folder, path) = image("GTiff", "a.tif", None);
        write_tags(&path, &SOLVED);
        let text = "<PAMDataset><GeoTransform>1.0e+01, 1, 0, 2.0e+01, 0, -1</GeoTransform></PAMDataset>";
        std::fs::write(sidecar::aux_path(&path), text).expect("written");
        assert_eq!(beneath_of(&path), None);
    }

    #[test]
    fn the_file_itself_says_what_is_beneath() {
        let (_folder, path) = image("GTiff", "a.tif", Some(DRONE));
        write_aux(&path, &SOLVED);
        near(beneath_of(&path), &DRONE);
        std::fs::remove_file(sidecar::aux_path(&path)).expect("there");
        write_tags(&path, &SOLVED);
        near(beneath_of(&path), &DRONE);
        write_tags(&path, &AGAIN);
        near(beneath_of(&path), &DRONE);
        write_aux(&path, &SOLVED);
        near(beneath_of(&path), &DRONE);
    }

    #[test]
    fn without_a_georeference_beneath_none_is_made_up() {
        let (_folder, path) = image("GTiff", "a.tif", None);
        write_tags(&path, &SOLVED);
        assert_eq!(beneath_of(&path), Some(None));
        write_aux(&path, &AGAIN);
        let world = |transform| std::fs::write(path.with_extension("tfw"), sidecar::world_file(transform));
        world(&AGAIN).expect("written");
        assert_eq!(beneath_of(&path), Some(None), "a world file of the same run");
        world(&DRONE).expect("written");
        near(beneath_of(&path), &DRONE);
    }

    #[test]
    fn the_result_beside_the_image_remembers() {
        let (folder, path) = image("PNG", "a.png", Some(DRONE));
        write_aux(&path, &SOLVED);
        let result = |own: &GeoTransform, prior: &GeoTransform| {
            let text = serde_json::json!({
                "schema_version": 1, "program": "autoref-stream 0.1.0", "status": "solved", "advice": [],
                "image": {"path": "a.png", "width": 30, "height": 20, "bands": 1, "reader": "gdal", "description": ""},
                "gcp_file": "a.csv", "options": {}, "geotransform": own, "crs": null, "rmse_m": 0.01, "rmse_e_m": 0.01,
                "rmse_n_m": 0.01, "rmse_px": 0.4, "scale_m_per_px": 0.5, "rotation_deg": 0.0, "gcps_listed": 0,
                "gcps_in_image": 0, "candidates_found": 0, "matches": [], "check_points": [], "not_found": [],
                "outside": [], "warnings": [], "candidates": [], "files_written": [], "elapsed_s": 0.1,
                "timings": {"open_s": 0.0, "scan_s": 0.0, "examine_s": 0.0, "match_s": 0.0, "rematch_s": 0.0,
                            "write_s": 0.0},
                "prior_georeference": {"geotransform": prior, "crs": null, "moved_m": null},
            });
            std::fs::write(folder.path().join("a.autoref.json"), text.to_string()).expect("written");
        };
        assert_eq!(beneath_of(&path), Some(None), "the photogrammetry's .aux.xml is lost");
        result(&SOLVED, &DRONE);
        near(beneath_of(&path), &DRONE);
        // A result whose prior was the result itself.
        result(&SOLVED, &SOLVED);
        assert_eq!(beneath_of(&path), Some(None));
        // World files have no mark of who wrote them but their numbers.
        std::fs::remove_file(sidecar::aux_path(&path)).expect("there");
        std::fs::write(path.with_extension("pgw"), sidecar::world_file(&SOLVED)).expect("written");
        result(&SOLVED, &DRONE);
        near(beneath_of(&path), &DRONE);
        result(&AGAIN, &DRONE);
        assert_eq!(beneath_of(&path), None);
    }
}
