//! What earlier runs wrote and a refused run leaves in force.

use std::path::{Path, PathBuf};

use crate::georef::beneath;
use crate::georef::sidecar;
use crate::georef::write::WriteRequest;
use crate::result::RunResult;
use autoref_raster::bounded;
use autoref_raster::coords::GeoTransform;

/// The files of earlier runs that are still there: those that the earlier result has on record, and beside the image
/// those that hold the georeference `written` by an earlier run. Asked before that result is replaced.
pub fn standing(request: &WriteRequest, written: Option<&GeoTransform>) -> Vec<PathBuf> {
    let result = beneath::result_path(&request.base);
    let folder = result.parent().unwrap_or(Path::new(""));
    let earlier = result.is_file().then(|| RunResult::read(&result).ok()).flatten();
    let recorded = earlier.iter().flat_map(|earlier| earlier.files_written.iter().chain(&earlier.files_standing));
    let on_record = recorded.filter(|name| !is_told_anew(name)).filter_map(|name| {
        let name = Path::new(name);
        // Names count from where that run was started, and its files lie beside its result.
        [folder.join(name.file_name()?), name.to_path_buf()].into_iter().find(|path| path.is_file())
    });
    let mut all: Vec<PathBuf> = on_record.collect();
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
