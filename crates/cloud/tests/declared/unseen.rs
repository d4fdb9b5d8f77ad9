//! Withheld points that came as noise, and bands that are no heights.

use super::*;

/// No step sees a withheld point: what another run called it stands, while older noise is judged anew.
#[test]
fn withheld_noise_goes_on_as_it_came() {
    let folder = Folder::new();
    let (path, out) = (folder.at("held.las"), folder.at("out.las"));
    for (point_format, size, class_at, bit) in [(1, 28, 15, 0x80), (6, 30, 16, 0x04)] {
        Las { minor: 4, point_format, ..Las::default() }.write(&path);
        let mut bytes = std::fs::read(&path).expect("written");
        for point in 0..8 {
            let record = &mut bytes[375 + point * size..];
            record[class_at] |= 7;
            record[15] |= if point < 4 { bit } else { 0 };
        }
        std::fs::write(&path, bytes).expect("written");
        for drop_noise in [false, true] {
            // All have neighbours: this run finds no noise.
            let mut plan = plan(vec![Step::Radius { radius_m: 100.0, least: 1 }]);
            plan.drop_noise = drop_noise;
            let report = clean(&path, &out, &out, &plan).expect("cleaned");
            assert_eq!((report.withheld, report.points_kept), (4, 16));
            let (classes, held) = (values(&out, "classification"), values(&out, "withheld"));
            let of =
                |flag: f64, class: f64| classes.iter().zip(&held).filter(|(c, h)| **h == flag && **c == class).count();
            assert_eq!((of(1.0, 7.0), of(0.0, 7.0), of(0.0, 1.0)), (4, 0, 4), "format {point_format}: {classes:?}");
        }
    }
}

/// GDAL gives a band without a unit that of the vertical axis.
#[test]
fn counts_and_intensities_are_in_no_unit_of_height() {
    let folder = Folder::new();
    let path = folder.at("a.las");
    for (code, name) in [(9001, "m"), (9003, "US survey foot")] {
        // NAVD88 over a map of the same unit.
        let vertical = if code == 9001 { 5703 } else { 6360 };
        let plan = if code == 9001 { 32_617 } else { 2264 };
        let vlrs = vec![("LASF_Projection", 34_735, keys(&[(3072, plan), (4096, vertical), (4099, code)]))];
        Las { minor: 2, vlrs, origin: [1_500_000.0, 700_000.0], ..Las::default() }.write(&path);
        let stats = vec![("mean".into(), Stat::Mean), ("count".into(), Stat::Count), ("max".into(), Stat::Max)];
        let options = Options { stats, fill_cells: 1, ..options(&path, &["z", "intensity"], 5.0) };
        grid::grid(&path, path.parent().expect("in a folder"), &options).expect("gridded");
        let units = |file: &str| {
            let raster = Dataset::open(folder.at(file)).expect("a raster");
            raster.rasterbands().map(|band| band.expect("a band").unit()).collect::<Vec<_>>()
        };
        for (file, expected) in [
            ("a_z_mean.tif", &[name][..]),
            ("a_z_count.tif", &[""]),
            ("a_z_filled.tif", &[name, "unitless", "unitless", name]),
            ("a_intensity_mean.tif", &[""]),
            ("a_intensity_count.tif", &[""]),
            ("a_intensity_filled.tif", &["", "", "", ""]),
        ] {
            assert_eq!(units(file), expected, "{file}");
        }
    }
}
