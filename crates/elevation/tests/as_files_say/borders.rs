//! A resampled model has no heights that its source does not have.

use autoref_elevation::resampled;
use gdal::Dataset;

use super::{create, put, read};

/// A grid of multiples of the side reaches beyond a model whose border is none: there it has no height, and not 0.
#[test]
fn beyond_the_border_of_a_resampled_model_there_is_no_height() {
    let folder = tempfile::tempdir().expect("a folder");
    let (a, out) = (folder.path().join("a.tif"), folder.path().join("out.tif"));
    let (columns, rows) = (60, 50);
    for (transform, side) in [
        ([500_000.7, 2.0, 0.0, 8_700_000.3, 0.0, -2.0], 5.0),
        ([500_000.7, 2.0, 0.0, 8_700_000.3, 0.0, -2.0], 0.7),
        ([500_000.0, 2.0, 0.0, 8_700_000.0, 0.0, -3.0], 7.0),
        ([500_000.0, 2.0, 0.0, 8_700_000.0, 0.0, -2.0], 4.0),
        // On the grid, but for what 0.1 rounds: an eastern border of 7,478,476 times 0.1.
        ([747_841.6, 0.1, 0.0, 6_000_005.0, 0.0, -0.1], 0.1),
        // Turned, on the grid.
        ([500_000.0, 0.8, 0.6, 6_000_000.0, 0.6, -0.8], 4.0),
    ] {
        let set = create::<i16>(&a, (columns, rows), 1, "EPSG:32633", transform);
        put(&set, 1, (0..columns * rows).map(|i| 400 + (i % 37) as i16).collect());
        drop(set);
        for how in ["near", "bilinear", "cubic", "average", "max"] {
            resampled::resample(&a, &out, side, how, 1).expect("written");
            let heights = read(&out, 1);
            let none = heights.iter().filter(|z| z.is_nan()).count();
            let least = heights.iter().copied().filter(|z| !z.is_nan()).fold(f64::INFINITY, f64::min);
            assert!(
                least >= 395.0 && none < 2 * heights.len() / 3,
                "{side} {how}: {least}, {none} of {}",
                heights.len()
            );
            let set = Dataset::open(&out).expect("a raster");
            let (x0, y0) = (set.geo_transform().expect("a place")[0], set.geo_transform().expect("a place")[3]);
            assert!(((x0 / side).round() - x0 / side).abs() < 1e-6 && ((y0 / side).round() - y0 / side).abs() < 1e-6);
            // Where the grid ends with the model nothing changes.
            let (wide, high) = set.raster_size();
            let kept = (wide, high, set.rasterband(1).expect("a band").band_type().name());
            if side == 4.0 && transform[2] == 0.0 {
                assert_eq!(kept, (30, 25, "Int16".into()));
            } else if side == 0.1 {
                assert_eq!(kept, (60, 50, "Int16".into()));
            }
        }
    }
}
