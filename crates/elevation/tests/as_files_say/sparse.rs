//! Blocks that a file does not hold are passed over: what comes out is that of a file that holds them, empty.

use autoref_elevation::align::{self, Options};
use autoref_elevation::kept::Room;
use autoref_elevation::model::Model;
use autoref_elevation::stream::Means;
use gdal::raster::RasterCreationOptions;

use super::*;

/// Blocks of 16 cells; those of the right half and every third of the left are empty.
fn patchy(path: &Path, values: &[f32], empty: &str) -> PathBuf {
    let driver = DriverManager::get_driver_by_name("GTiff").expect("a driver");
    let options = RasterCreationOptions::from_iter(["TILED=YES", "BLOCKXSIZE=16", "BLOCKYSIZE=16", empty]);
    let mut set = driver
        .create_with_band_type_with_options::<f32, _>(path, SIDE, SIDE, 1, &options)
        .expect("every option is known");
    set.set_geo_transform(&[500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0]).expect("a place");
    set.set_spatial_ref(&SpatialRef::from_epsg(32633).expect("PROJ knows it")).expect("a CRS");
    let mut band = set.rasterband(1).expect("a band");
    band.set_no_data_value(Some(-9999.0)).expect("a number");
    for (number, (x, y)) in (0..SIDE / 16).flat_map(|y| (0..SIDE / 32).map(move |x| (x * 16, y * 16))).enumerate() {
        if number % 3 != 0 {
            let rows = (y..y + 16).flat_map(|row| values[row * SIDE + x..][..16].to_vec());
            band.write((x as isize, y as isize), (16, 16), &mut Buffer::new((16, 16), rows.collect()))
                .expect("written");
        }
    }
    set.close().expect("a disk");
    path.to_path_buf()
}

#[test]
fn blocks_that_are_not_there_are_blocks_without_heights() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let [a, b] = [hills(0.3, -0.2), hills(0.0, 0.0)];
    let sparse = [patchy(&at("sa.tif"), &a, "SPARSE_OK=TRUE"), patchy(&at("sb.tif"), &b, "SPARSE_OK=TRUE")];
    let whole = [patchy(&at("wa.tif"), &a, "SPARSE_OK=FALSE"), patchy(&at("wb.tif"), &b, "SPARSE_OK=FALSE")];
    let bytes = |path: &Path| std::fs::metadata(path).expect("a file").len();
    assert!(bytes(&sparse[0]) < bytes(&whole[0]) / 2, "the blocks are not in the file");
    // Copies have no blocks: the files themselves are read in every pass.
    let options = Options { means: Means::square(16, 2), room: Room::default(), ..Options::default() };
    for method in [Method::Auto, Method::NuthKaab] {
        let found = |files: &[PathBuf; 2]| {
            let [a, b] = files.each_ref().map(|path| Model::open(path).expect("a model"));
            align::align(&a, &b, &Options { method, ..options }).expect("readable")
        };
        let outcome = found(&sparse);
        assert!(matches!(&outcome, Outcome::Aligned(found) if (found.shift_m[0] - 3.0).abs() < 0.1), "{outcome:?}");
        assert_eq!(outcome, found(&whole), "{method}");
    }
    let compared = [&sparse, &whole].map(|[a, b]| compare(a, b, None, &at("compared")).statistics);
    assert_eq!(format!("{:?}", compared[0]), format!("{:?}", compared[1]));
}
