//! Files that belong to another one by their names: GDAL reads it through them.

use std::path::{Path, PathBuf};

/// Ends that follow the whole name of a raster, or of one of these: a mask has overviews of its own.
const APPENDED: &[&str] = &[".aux.xml", ".ovr", ".msk"];
/// Ends in place of the extension: world files of the usual rasters.
const WORLD: &[&str] = &["tfw", "jgw", "pgw", "wld", "tifw"];
/// A shapefile is all of these.
const OF_SHAPES: &[&str] = &["dbf", "shx", "prj", "cpg", "qix", "sbn", "sbx", "idm", "ind", "qpj"];
/// Ends that follow the name of an SQLite database; one that is left from another would be played into it.
const OF_DATABASES: &[&str] = &["-wal", "-shm", "-journal"];
/// Rasters that may have a world file.
const IMAGES: &[&str] = &["tif", "tiff", "jpg", "jpeg", "png", "jp2", "webp", "gif", "bmp"];

/// Names of files that belong to an image by their name, whether they are there or not.
pub fn sidecars(input: &Path) -> Vec<PathBuf> {
    let shapes = extension(input) == "shp";
    let ends = WORLD.iter().chain(if shapes { OF_SHAPES } else { &[] });
    let appended = APPENDED.iter().chain(&[".msk.ovr"]).map(|end| appended(input, end));
    appended.chain(ends.map(|end| input.with_extension(end))).filter(|name| name != input).collect()
}

/// Files beside `file`, whether it is there itself or not, through which GDAL would read it. A world file that another
/// image of this name has, too, is that one's.
pub(crate) fn companions(file: &Path) -> Vec<PathBuf> {
    let end = extension(file);
    let mut waiting: Vec<PathBuf> = either_case(APPENDED).map(|end| appended(file, &end)).collect();
    match end.as_str() {
        "shp" => waiting.extend(either_case(OF_SHAPES).map(|end| file.with_extension(end))),
        "gpkg" => waiting.extend(OF_DATABASES.iter().map(|end| appended(file, end))),
        _ => {
            let is_others = |world: &str| {
                let of_world =
                    IMAGES.iter().filter(|image| **image != end && world_ends(image).iter().any(|w| w == world));
                either_case(of_world).any(|image| file.with_extension(image).is_file())
            };
            let own = world_ends(&end).into_iter().filter(|world| !is_others(world));
            let own: Vec<String> = own.collect();
            waiting.extend(either_case(&own).map(|end| file.with_extension(end)));
        }
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

/// Extensions of world files of an image with this one: its first and its last letter, or all, and a `w`.
fn world_ends(image: &str) -> Vec<String> {
    let (Some(first), Some(last)) = (image.chars().next(), image.chars().last()) else { return vec!["wld".into()] };
    if !IMAGES.contains(&image) {
        return Vec::new();
    }
    vec![format!("{first}{last}w"), format!("{image}w"), "wld".into()]
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
        for (file, expected) in [
            (
                "a.tif",
                "a.TFW a.tfw a.tif.OVR a.tif.aux.xml a.tif.msk a.tif.msk.ovr a.tif.ovr a.tif.ovr.ovr a.tifw a.wld",
            ),
            ("a.jpg", "a.jgw a.wld"),
            ("a.shp", "a.dbf a.prj a.qix a.sbn a.shx"),
            ("a.gpkg", "a.gpkg-wal"),
            ("a", "a.wld"),
            ("a.vrt", ""),
            ("a.html", ""),
            ("b.tif", ""),
        ] {
            let found = companions(&at(file));
            let names: Vec<_> = found.iter().map(|f| f.file_name().expect("a name").to_string_lossy()).collect();
            assert_eq!(names.join(" "), expected, "{file}");
        }
        std::fs::write(at("a.tiff"), "x").expect("writable");
        let kept = companions(&at("a.tif"));
        assert!(
            !kept.contains(&at("a.tfw")) && !kept.contains(&at("a.wld")),
            "they are those of a.tiff, too: {kept:?}"
        );
        assert!(kept.contains(&at("a.tifw")));
    }
}
