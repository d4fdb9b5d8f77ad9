//! Files that belong to another one by their names: GDAL reads it through them.

use std::path::{Path, PathBuf};

/// Ends that follow the whole name of a raster, or of one of these: a mask has overviews of its own.
const APPENDED: &[&str] = &[".aux.xml", ".ovr", ".msk"];
/// Ends in place of the extension: world files of the usual rasters.
const WORLD: &[&str] = &["tfw", "jgw", "pgw", "wld", "tifw"];
/// A shapefile is all of these.
const OF_SHAPES: &[&str] = &["dbf", "shx", "prj", "cpg", "qix", "sbn", "sbx", "idm", "ind", "qpj"];
/// Of these, what no other format has: indexes and the letters of the table.
const OF_SHAPES_ALONE: &[&str] = &["cpg", "qix", "sbn", "sbx", "qpj"];
/// Ends that follow the name of an SQLite database; one that is left from another would be played into it.
const OF_DATABASES: &[&str] = &["-wal", "-shm", "-journal"];
/// Rasters and tables whose CRS stands in a `.prj` as well.
const WITH_PROJECTION: &[&str] = &["asc", "bil", "bip", "bsq", "flt", "hdr", "e00", "grd", "tab", "tif", "jpg", "png"];

/// Names of files that belong to an image by their name, whether they are there or not.
pub fn sidecars(input: &Path) -> Vec<PathBuf> {
    let shapes = extension(input) == "shp";
    let ends = WORLD.iter().chain(if shapes { OF_SHAPES } else { &[] });
    let appended = either_case(APPENDED.iter().chain(&[".msk.ovr"])).map(|end| appended(input, &end));
    appended.chain(either_case(ends).map(|end| input.with_extension(end))).filter(|name| name != input).collect()
}

/// Whether `name` is one that a companion of `file` may have, whether it is there or not.
pub(crate) fn is_called_companion(name: &Path, file: &Path) -> bool {
    let rest = name.as_os_str().as_encoded_bytes().strip_prefix(file.as_os_str().as_encoded_bytes());
    let ends = either_case(APPENDED).chain(OF_DATABASES.iter().map(|end| (*end).to_string()));
    let is_part = || extension(file) == "shp" && name.file_stem() == file.file_stem();
    rest.is_some_and(|rest| ends.into_iter().any(|end| rest.starts_with(end.as_bytes())))
        || is_part() && OF_SHAPES.contains(&extension(name).as_str())
}

/// Ends of the files without which a file of this ending cannot be read: those of a shapefile.
pub(crate) fn parts_of(path: &Path) -> &'static [&'static str] {
    if extension(path) == "shp" { &["shx", "dbf", "prj", "cpg"] } else { &[] }
}

/// Files beside `file`, whether it is there itself or not, through which GDAL would read it and which are no other
/// file's: they bear its whole name, or are of shapefiles alone. A world file may be another image's, and a raster with
/// tags of its own is not read through it.
pub(crate) fn companions(file: &Path) -> Vec<PathBuf> {
    let mut waiting: Vec<PathBuf> = either_case(APPENDED).map(|end| appended(file, &end)).collect();
    match extension(file).as_str() {
        "shp" => {
            waiting.extend(either_case(OF_SHAPES_ALONE).map(|end| file.with_extension(end)));
            let is_others = either_case(WITH_PROJECTION).any(|end| file.with_extension(end).exists());
            if file.exists() && !is_others {
                waiting.extend(either_case(&["prj"]).map(|end| file.with_extension(end)));
            }
        }
        "gpkg" => waiting.extend(OF_DATABASES.iter().map(|end| appended(file, end))),
        _ => {}
    }
    let mut found = Vec::new();
    while let Some(name) = waiting.pop() {
        // A link is a companion whatever it leads to.
        if name != file && std::fs::symlink_metadata(&name).is_ok_and(|there| !there.is_dir()) {
            waiting.extend(either_case(APPENDED).map(|end| appended(&name, &end)));
            found.push(name);
        }
    }
    found.sort();
    found
}

/// Each end as it is, and in capitals.
fn either_case<'a, S: AsRef<str> + 'a>(ends: impl IntoIterator<Item = &'a S>) -> impl Iterator<Item = String> {
    ends.into_iter().flat_map(|end| [end.as_ref().to_string(), end.as_ref().to_ascii_uppercase()])
}

fn appended(file: &Path, end: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(end);
    PathBuf::from(name)
}

fn extension(file: &Path) -> String {
    file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn companions_are_what_gdal_reads_with_a_file_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        let beside = "a.tif.aux.xml a.tif.ovr a.tif.OVR a.tif.msk a.tif.msk.ovr a.tif.ovr.ovr a.tfw a.TFW a.tifw a.wld \
                      a.jgw a.qml a.tif.qml a.shp a.dbf a.shx a.prj a.qix a.sbn a.gpkg-wal ab.tif.ovr a.tif.msk2";
        for name in beside.split(' ') {
            std::fs::write(at(name), "x").expect("writable");
        }
        std::fs::create_dir(at("b.tif.ovr")).expect("a folder");
        std::fs::write(at("a.asc"), "x").expect("writable");
        for (file, expected) in [
            ("a.tif", "a.tif.OVR a.tif.aux.xml a.tif.msk a.tif.msk.ovr a.tif.ovr a.tif.ovr.ovr"),
            ("a.jpg", ""),
            ("a.shp", "a.qix a.sbn"),
            ("a.gpkg", "a.gpkg-wal"),
            ("a.html", ""),
            ("b.tif", ""),
        ] {
            let found = companions(&at(file));
            let names: Vec<_> = found.iter().map(|f| f.file_name().expect("a name").to_string_lossy()).collect();
            assert_eq!(names.join(" "), expected, "{file}");
        }
        // The system is the shapefile's where nothing else of its name may have it.
        std::fs::remove_file(at("a.asc")).expect("there");
        assert!(companions(&at("a.shp")).contains(&at("a.prj")));
        std::fs::remove_file(at("a.shp")).expect("there");
        assert!(!companions(&at("a.shp")).contains(&at("a.prj")));
    }
}
