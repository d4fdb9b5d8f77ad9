//! Files that a raster or a list of lines refers to: parts of virtual rasters, headers beside values, tiles of a map.
#![allow(unsafe_code)]

use std::collections::HashSet;
use std::ffi::{CStr, CString};
use std::io::Read;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};

use gdal::{Dataset, DatasetOptions, GdalOpenFlags};

use crate::sidecars::sidecars;
use crate::{open, tile_folder, unheard};

/// Every file that is read when `path` is, but the file itself and what belongs to it by its name: of virtual rasters
/// their parts, and the parts of these, with what belongs to them.
pub fn referred(path: &Path) -> Vec<PathBuf> {
    let own: HashSet<PathBuf> = sidecars(path).into_iter().chain([path.to_path_buf()]).collect();
    let (mut seen, mut waiting, mut found) = (HashSet::new(), vec![path.to_path_buf()], Vec::new());
    while let Some(next) = waiting.pop() {
        // A raster that names itself ends here.
        let Ok(place) = next.canonicalize() else { continue };
        if !seen.insert(place) {
            continue;
        }
        if next != path {
            found.extend(sidecars(&next).into_iter().chain([next.clone()]));
        }
        waiting.extend(parts_of(&next).into_iter().filter(|part| !own.contains(part)));
    }
    found.retain(|file| file.is_file() && !own.contains(file));
    found.sort();
    found.dedup();
    found
}

/// The files that GDAL, or our reader of tiles, names for one raster.
fn parts_of(path: &Path) -> Vec<PathBuf> {
    // Whoever names a folder as an input protects what is read in it.
    if !path.is_file() {
        return Vec::new();
    }
    if tile_folder::is_tile_folder(path) {
        let opened = unheard(|| open::open_dataset(path, 0));
        return opened.map_or(Vec::new(), |(_, dataset)| files_of(&dataset));
    }
    if !may_refer(path) {
        return Vec::new();
    }
    crate::initialise_gdal(0);
    let kinds = GdalOpenFlags::GDAL_OF_RASTER | GdalOpenFlags::GDAL_OF_VECTOR | GdalOpenFlags::GDAL_OF_READONLY;
    let options = DatasetOptions { open_flags: kinds, ..Default::default() };
    unheard(|| Dataset::open_ex(path, options)).map_or(Vec::new(), |dataset| files_of(&dataset))
}

/// Ends of files that stand alone and are long to open, whatever GDAL would make of them.
const ALONE: [&str; 14] =
    ["csv", "tsv", "txt", "json", "geojson", "toml", "las", "laz", "ply", "xyz", "e57", "kof", "db", "gpkg"];

/// Whether a file is of a kind that has others beside it; TIFF, JPEG and PNG have only sidecars.
fn may_refer(path: &Path) -> bool {
    let end = path.extension().map(|end| end.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let mut head = [0; 4];
    let read = std::fs::File::open(path).and_then(|mut file| file.read(&mut head));
    let alone: [&[u8]; 6] = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"\xff\xd8\xff", b"\x89PNG"];
    !ALONE.contains(&end.as_str())
        && read.is_ok_and(|count| !alone.iter().any(|magic| head[..count].starts_with(magic)))
}

fn files_of(dataset: &Dataset) -> Vec<PathBuf> {
    // SAFETY: the dataset is open; the list is GDAL's copy, ended by a null pointer, and freed once after it was read.
    let names: Vec<CString> = unsafe {
        let list = gdal_sys::GDALGetFileList(dataset.c_dataset());
        let entry = |at: usize| if list.is_null() { std::ptr::null_mut() } else { *list.add(at) };
        let names = (0..).map(entry).take_while(|name| !name.is_null());
        let names = names.map(|name| CStr::from_ptr(name).to_owned()).collect();
        gdal_sys::CSLDestroy(list);
        names
    };
    names.into_iter().map(|name| PathBuf::from(std::ffi::OsString::from_vec(name.into_bytes()))).collect()
}

/// Files that a name of GDAL's own holds: `GTIFF_DIR:1:a.tif`, `NETCDF:"a.nc":z`, `/vsizip/a.zip/a.tif`.
pub fn inside_name(name: &Path) -> Vec<PathBuf> {
    let bytes = name.as_os_str().as_bytes();
    let path = |part: &[u8]| PathBuf::from(std::ffi::OsString::from_vec(part.to_vec()));
    // A file's own name may hold what cuts names apart, so that all that lies between two cuts is tried; of long names,
    // which are descriptions in XML, few.
    const MOST_CUTS: usize = 24;
    const FEW_CUTS: usize = 6;
    let is_cut = |b: &u8| b":\"?{},@=<>;&|'".contains(b);
    let cuts = bytes.iter().enumerate().filter(|(_, b)| is_cut(b)).map(|(at, _)| at);
    let ends: Vec<usize> = cuts.chain([bytes.len()]).collect();
    let reach = if ends.len() > MOST_CUTS { FEW_CUTS } else { ends.len() };
    let begins = std::iter::once(0).chain(ends.iter().map(|at| at + 1)).enumerate();
    let between = begins.flat_map(|(k, begin)| ends.iter().skip(k).take(reach).map(move |&end| (begin, end)));
    // `vrt://a.tif` names a file of this folder.
    let of_scheme = |part: &[u8]| part.strip_prefix(b"//").map(<[u8]>::to_vec);
    let between = between.filter(|(begin, end)| begin < end).flat_map(|(begin, end)| {
        let part = &bytes[begin..end];
        [Some(part.to_vec()), of_scheme(part)].into_iter().flatten().map(|part| path(&part))
    });
    let folded = std::iter::successors(bytes.strip_prefix(b"/vsi"), |rest| {
        rest.iter().position(|b| *b == b'/').map(|at| &rest[at + 1..])
    });
    // After each prefix the path may be absolute or relative, and go on inside an archive.
    let folded = folded.flat_map(|rest| path(rest).ancestors().map(Path::to_path_buf).collect::<Vec<_>>());
    between.chain(folded).filter(|part| part.is_file()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn virtual_raster(path: &Path, part: &str) {
        let whole = "xOff=\"0\" yOff=\"0\" xSize=\"2\" ySize=\"2\"";
        let text = format!(
            "<VRTDataset rasterXSize=\"2\" rasterYSize=\"2\"><VRTRasterBand dataType=\"Byte\" band=\"1\"><SimpleSource>\
             <SourceFilename relativeToVRT=\"1\">{part}</SourceFilename><SourceBand>1</SourceBand><SrcRect {whole}/>\
             <DstRect {whole}/></SimpleSource></VRTRasterBand></VRTDataset>"
        );
        std::fs::write(path, text).expect("writable");
    }

    #[test]
    fn parts_of_parts_are_found_and_rings_end() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("s.tif"), b"II*\0").expect("writable");
        std::fs::write(at("s.tif.aux.xml"), b"<PAMDataset/>").expect("writable");
        virtual_raster(&at("inner.vrt"), "s.tif");
        virtual_raster(&at("outer.vrt"), "inner.vrt");
        assert_eq!(referred(&at("outer.vrt")), [at("inner.vrt"), at("s.tif"), at("s.tif.aux.xml")]);
        virtual_raster(&at("inner.vrt"), "outer.vrt");
        assert_eq!(referred(&at("outer.vrt")), [at("inner.vrt")]);
        assert!(referred(&at("s.tif")).is_empty());
    }

    #[test]
    fn names_of_gdal_hold_files() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("a.zip");
        std::fs::write(&file, "PK").expect("writable");
        let name = file.display();
        for text in [format!("/vsizip/{name}/in/a.tif"), format!("GTIFF_DIR:1:{name}"), format!("NETCDF:\"{name}\":z")]
        {
            assert!(inside_name(Path::new(&text)).contains(&file), "{text}");
        }
        assert!(inside_name(Path::new("EPSG:25833")).is_empty());
        // Letters that cut names apart may be in a file's own name; relative names follow two slashes.
        let odd = folder.path().join("a,b=1.tif");
        std::fs::write(&odd, "II*").expect("writable");
        let name = odd.display();
        let xml =
            format!("<VRTDataset><SourceFilename relativeToVRT=\"0\">{}</SourceFilename></VRTDataset>", file.display());
        for (text, held) in
            [(format!("GTIFF_DIR:1:{name}"), &odd), (format!("vrt://{name}?bands=1"), &odd), (xml, &file)]
        {
            assert!(inside_name(Path::new(&text)).contains(held), "{text}");
        }
        // Tests run in the folder of their crate.
        assert!(inside_name(Path::new("vrt://Cargo.toml?bands=1")).contains(&PathBuf::from("Cargo.toml")));
    }
}
