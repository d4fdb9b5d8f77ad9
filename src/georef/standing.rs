//! What earlier runs wrote and a refused run leaves in force.

use std::path::{Path, PathBuf};

use crate::georef::beneath;
use crate::georef::sidecar;
use crate::georef::tags;
use crate::georef::write::WriteRequest;
use crate::result::RunResult;
use autoref_raster::bounded;
use autoref_raster::coords::GeoTransform;
use autoref_raster::protected::same_file;

/// The files of earlier runs that are still there: those that the earlier result has on record, and beside the image
/// those that hold the georeference `written` by an earlier run. Asked before that result is replaced.
pub fn standing(request: &WriteRequest, written: Option<&GeoTransform>) -> Vec<PathBuf> {
    let result = beneath::result_path(&request.base);
    let folder = result.parent().unwrap_or(Path::new(""));
    let earlier = result.is_file().then(|| RunResult::read(&result).ok()).flatten();
    let recorded = earlier.iter().flat_map(|earlier| earlier.files_written.iter().chain(&earlier.files_standing));
    let on_record = recorded.filter(|name| !is_told_anew(name)).filter_map(|name| {
        // Names count from where that run was started, and its files lie beside its result.
        Some(folder.join(Path::new(name).file_name()?)).filter(|path| path.is_file())
    });
    // The image and what lies beside it may be another's by now: there the georeference itself tells.
    let may_be_others = |path: &PathBuf| {
        let image = &request.image;
        same_file(path, image)
            || same_file(path, &sidecar::world_file_path(image))
            || same_file(path, &sidecar::aux_path(image))
    };
    let tagged = tags::is_tagged(&request.image).then(|| request.image.clone());
    let mut all: Vec<PathBuf> = tagged.into_iter().chain(on_record.filter(|path| !may_be_others(path))).collect();
    let beside = written.map(|written| beside_the_image(&request.image, written)).unwrap_or_default();
    all.extend(beside);
    let mut unique: Vec<PathBuf> = Vec::new();
    for path in all {
        if !unique.contains(&path) {
            unique.push(path);
        }
    }
    unique
}

/// Result and report are written by every run.
fn is_told_anew(name: &str) -> bool {
    name.ends_with(".autoref.json") || name.ends_with(".report.html")
}

/// An `.aux.xml` of ours and a world file that place the image as an earlier run did.
fn beside_the_image(image: &Path, written: &GeoTransform) -> Vec<PathBuf> {
    let is_written = |own: GeoTransform| own.differs_px(written) < beneath::SAME_PX;
    let world = sidecar::world_file_path(image);
    let of_world = bounded::read_to_string(&world, "a world file", bounded::TEXT_BYTES).ok();
    let of_world = of_world.and_then(|text| sidecar::transform_of_world(&text));
    let aux = beneath::aux(image).filter(|own| is_written(*own)).map(|_| sidecar::aux_path(image));
    of_world.filter(|own| is_written(*own)).map(|_| world).into_iter().chain(aux).collect()
}
