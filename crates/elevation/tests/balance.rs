//! `--balance` on drawn sources: what has changed, what overlaps cannot tell, and what does not fit the sample type.

use std::path::{Path, PathBuf};

use autoref_elevation::files::Resources;
use autoref_elevation::mosaic::{Balance, Choice, Made, MosaicJob, Surface};
use autoref_elevation::resample::Interpolation;
use autoref_raster::random::{mix, unit};
use gdal::raster::{Buffer, GdalType};
use gdal::{Dataset, DriverManager, spatial_ref::SpatialRef};

/// Where a lattice of random numbers is smooth, between −1 and 1.
fn lattice(x: f64, y: f64, seed: u64) -> f64 {
    let corner = |i: f64, j: f64| {
        let cell = ((i + 4096.0) as u64) << 32 | (j + 4096.0) as u64;
        2.0 * unit(mix(cell ^ seed << 56)) - 1.0
    };
    let (i, j) = (x.floor(), y.floor());
    let (u, v) = (x - i, y - j);
    let (u, v) = (u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v));
    let row = |j: f64| corner(i, j) * (1.0 - u) + corner(i + 1.0, j) * u;
    row(j) * (1.0 - v) + row(j + 1.0) * v
}

/// Ground with patterns of many sizes, of mean 0 and about as many from −1 to 1 as beyond.
fn ground(x: usize, y: usize, seed: u64) -> f64 {
    let (x, y) = (x as f64 + 0.5, y as f64 + 0.5);
    let at = |size: f64, k: u64| lattice(x / size, y / size, 8 * seed + k);
    2.0 * (0.4 * at(4.0, 0) + 0.6 * at(23.0, 1) + 0.8 * at(90.0, 2))
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().expect("a folder"))
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// A source of one band whose corner lies so many cells to the east of the first one's.
    fn source<T: GdalType + Copy>(
        &self,
        name: &str,
        east: usize,
        (width, height): (usize, usize),
        value: impl Fn(usize, usize) -> T,
    ) -> PathBuf {
        let path = self.at(name);
        let driver = DriverManager::get_driver_by_name("GTiff").expect("a driver");
        let mut set = driver.create_with_band_type::<T, _>(&path, width, height, 1).expect("a file");
        set.set_geo_transform(&[500_000.0 + east as f64, 1.0, 0.0, 6_600_000.0, 0.0, -1.0]).expect("placed");
        set.set_spatial_ref(&SpatialRef::from_epsg(32632).expect("PROJ knows it")).expect("labelled");
        let cells = (0..width * height).map(|k| value(k % width, k / width)).collect();
        let mut band = set.rasterband(1).expect("a band");
        band.write((0, 0), (width, height), &mut Buffer::new((width, height), cells)).expect("written");
        path
    }

    fn balanced(&self, inputs: &[PathBuf], reference: Option<usize>, surface: Surface) -> (Made, Vec<f64>) {
        let out = self.at("mosaic.tif");
        let made = joined(inputs, reference, surface, (512, 1), &out);
        (made, read(&out))
    }
}

fn joined(
    inputs: &[PathBuf],
    reference: Option<usize>,
    surface: Surface,
    (tile_px, threads): (u64, usize),
    out: &Path,
) -> Made {
    let resources = Resources { threads, tile_px: Some(tile_px), memory_budget_bytes: 512 << 20 };
    let job = MosaicJob {
        inputs,
        out,
        choice: Choice::Nearest,
        resolution: None,
        resampling: Interpolation::Bilinear,
        use_index: None,
        write_index: None,
        balance: Some(surface),
        balance_to: reference.map(|k| inputs[k].as_path()),
        page: None,
        blend_px: 0,
        resources,
    };
    job.run().expect("joined")
}

fn read(path: &Path) -> Vec<f64> {
    let set = Dataset::open(path).expect("a raster");
    let (width, height) = set.raster_size();
    let band = set.rasterband(1).expect("a band");
    band.read_as::<f64>((0, 0), (width, height), (width, height), None).expect("cells").data().to_vec()
}

fn byte(value: f64) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

fn balance(made: &Made) -> &Balance {
    made.balance.as_ref().expect("it was asked for")
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// How far gain and level of the second source are off, where it has `gain` · ground + `offset`.
fn errors(made: &Made, (gain, offset): (f64, f64), level: f64) -> (f64, f64) {
    let found = balance(made);
    let (by, plus) = (found.gains[1][0], found.offsets[1][0]);
    (by * gain - 1.0, by * (gain * level + offset) + plus - level)
}

/// Snow as a field and clouds in lumps, over up to two fifths of the overlap.
#[test]
fn what_has_changed_does_not_move_gains() {
    let folder = Folder::new();
    let scene = |x: usize, y: usize| 110.0 + 25.0 * ground(x, y, 3);
    let first = folder.source("a.tif", 0, (300, 320), |x, y| byte(scene(x, y)));
    let cloudy = |x: usize, y: usize, share: f64| lattice(x as f64 / 35.0, y as f64 / 35.0, 99) > 0.75 - 2.0 * share;
    for (share, gain, offset) in [(0.15, 0.8, 10.0), (0.25, 0.9, 5.0), (0.4, 0.8, 10.0), (0.25, 1.0, 0.0)] {
        let field = move |_: usize, y: usize| (y as f64) < 320.0 * share;
        let lumps = move |x: usize, y: usize| cloudy(x, y, share);
        for (kind, changed) in [("a field", &field as &dyn Fn(usize, usize) -> bool), ("lumps", &lumps)] {
            let second = folder.source("b.tif", 200, (300, 320), |x, y| {
                byte(gain * if changed(x, y) { 230.0 } else { scene(x + 200, y) } + offset)
            });
            let (made, _) = folder.balanced(&[first.clone(), second], Some(0), Surface::Quadratic);
            let (by, level) = errors(&made, (gain, offset), 110.0);
            assert!(by.abs() < 0.01 && level.abs() < 0.5, "{kind} of {share}, gain {gain}: {by:.4}, {level:.2}");
            let overlap = &balance(&made).overlaps[0];
            assert!(overlap.agreeing_blocks < overlap.blocks, "{overlap:?}");
        }
    }
}

/// Twenty-four images along a strip that overlap by a quarter: what a surface could carry from one to the next.
#[test]
fn levels_do_not_drift_along_a_strip() {
    let folder = Folder::new();
    let scene = |x: usize, y: usize| 11_000.0 + 2_000.0 * ground(x, y, 5);
    for noise in [0.0, 250.0] {
        let draw = |k: usize, salt: u64| unit(mix(k as u64 * 977 + salt));
        let inputs: Vec<PathBuf> = (0..24)
            .map(|k| {
                let (gain, offset) = if k == 12 { (1.0, 0.0) } else { (0.75 + 0.5 * draw(k, 1), 3e3 * draw(k, 2)) };
                folder.source(&format!("{k}.tif"), 120 * k, (160, 160), |x, y| {
                    let grain = noise * (draw(x + 200 * y, 7 + k as u64) - 0.5) * 12f64.sqrt();
                    (gain * scene(x + 120 * k, y) + offset + grain).round().clamp(0.0, 65_535.0) as u16
                })
            })
            .collect();
        for surface in [Surface::Linear, Surface::Quadratic] {
            let (made, values) = folder.balanced(&inputs, Some(12), surface);
            let width = made.width as usize;
            for part in 0..8 {
                let cells = (0..values.len()).filter(|k| k % width * 8 / width == part);
                let off: Vec<f64> = cells.map(|k| values[k] - scene(k % width, k / width)).collect();
                assert!(mean(&off).abs() < 80.0, "{surface:?}, noise {noise}, part {part}: {:.1}", mean(&off));
            }
        }
    }
}

/// The fall of light that all images have in common goes, and the strip does not bend for it.
#[test]
fn a_common_fall_of_light_is_taken_out() {
    let folder = Folder::new();
    let scene = |x: usize, y: usize| 11_000.0 + 2_000.0 * ground(x, y, 11);
    let inputs: Vec<PathBuf> = (0..8)
        .map(|k| {
            let gain = 0.8 + 0.4 * unit(mix(k as u64));
            folder.source(&format!("{k}.tif"), 60 * k, (160, 160), |x, y| {
                let u = (x as f64 + 0.5) / 80.0 - 1.0;
                (gain * (scene(x + 60 * k, y) - 900.0 * u * u)).round() as u16
            })
        })
        .collect();
    let (made, values) = folder.balanced(&inputs, None, Surface::Quadratic);
    let rms = |of: &dyn Fn(&autoref_elevation::mosaic::Overlap) -> f64| {
        balance(&made).overlaps.iter().map(of).fold(0.0, f64::max)
    };
    assert!(rms(&|o| o.rms_after) < 15.0, "{} of {}", rms(&|o| o.rms_after), rms(&|o| o.rms_before));
    // The strip as a whole has a level and a contrast of its own: against the scene by a line, part by part.
    let width = made.width as usize;
    let truth: Vec<f64> = (0..values.len()).map(|k| scene(k % width, k / width)).collect();
    let (a, b) = (mean(&truth), mean(&values));
    let xx: f64 = truth.iter().map(|t| (t - a).powi(2)).sum();
    let gain = truth.iter().zip(&values).map(|(t, v)| (t - a) * (v - b)).sum::<f64>() / xx;
    for part in 0..8 {
        let cells = (0..values.len()).filter(|k| k % width * 8 / width == part);
        let off: Vec<f64> = cells.map(|k| values[k] - b - gain * (truth[k] - a)).collect();
        assert!(mean(&off).abs() < 110.0, "part {part}: {:.1}", mean(&off));
    }
}

#[test]
fn without_a_reference_brightness_and_contrast_lie_between_the_sources() {
    let folder = Folder::new();
    let first = folder.source("a.tif", 0, (300, 300), |x, y| byte(200.0 + 10.0 * ground(x, y, 7)));
    let second = folder.source("b.tif", 200, (300, 300), |x, y| byte(190.0 + 36.0 * ground(x + 200, y, 7)));
    let (made, values) = folder.balanced(&[first, second], None, Surface::Quadratic);
    let level = mean(&values);
    assert!((185.0..205.0).contains(&level), "{level}");
    let spread = mean(&values.iter().map(|v| (v - level).powi(2)).collect::<Vec<_>>()).sqrt();
    assert!((10.0..25.0).contains(&spread), "{spread}");
    let gains = &balance(&made).gains;
    assert!((gains[0][0] / gains[1][0] / 3.6 - 1.0).abs() < 0.01, "{gains:?}");
    let full = values.iter().filter(|v| **v == 255.0).count();
    assert!(full * 100 < values.len(), "{full} of {}", values.len());
}

#[test]
fn cells_at_the_limits_do_not_count_and_clipped_ones_are_told() {
    let folder = Folder::new();
    let scene = |x: usize, y: usize| 110.0 + 25.0 * ground(x, y, 13);
    let first = folder.source("a.tif", 0, (300, 300), |x, y| byte(scene(x, y)));
    let second = folder.source("b.tif", 200, (300, 300), |x, y| byte(1.6 * scene(x + 200, y) + 40.0));
    let inputs = [first, second];
    let at_limit = read(&inputs[1]).iter().filter(|v| **v == 255.0).count();
    assert!(at_limit > 5_000, "{at_limit}");
    let (made, _) = folder.balanced(&inputs, Some(0), Surface::Quadratic);
    let (by, level) = errors(&made, (1.6, 40.0), 110.0);
    assert!(by.abs() < 0.005 && level.abs() < 0.3, "{by:.4}, {level:.2}");
    assert_eq!(balance(&made).clipped_cells, 0);
    // To the second one: what of the first goes beyond is clipped, and nothing else counts.
    let (made, values) = folder.balanced(&inputs, Some(1), Surface::Quadratic);
    let width = made.width as usize;
    let clipped = (0..values.len()).filter(|k| values[*k] == 255.0 && k % width < 250).count() as u64;
    let told = balance(&made).clipped_cells;
    assert!(told > 1_000 && told <= clipped && told + told / 20 > clipped, "{told} of {clipped}");
    assert!(balance(&made).notes.iter().any(|note| note.contains(&told.to_string())), "{:?}", balance(&made).notes);
    // Where all lies at the limits no gain is invented, and that is said.
    let black = folder.source("c.tif", 400, (300, 300), |x, y| if ground(x, y, 17) > 0.0 { 255u8 } else { 0 });
    let (made, _) = folder.balanced(&[inputs[1].clone(), black], Some(0), Surface::Quadratic);
    assert!(balance(&made).notes.iter().any(|note| note.contains("limits")), "{:?}", balance(&made).notes);
}

/// What overlaps too little, by nothing, or without a pattern is named.
#[test]
fn what_no_overlap_ties_is_said() {
    let folder = Folder::new();
    let scene = |x: usize, y: usize| 100.0 + 20.0 * ground(x, y, 19);
    let source = |name: &str, east: usize, gain: f64| {
        folder.source(name, east, (200, 200), move |x, y| byte(gain * scene(x + east, y)))
    };
    let said = |inputs: &[PathBuf], reference: Option<usize>| {
        let (made, _) = folder.balanced(inputs, reference, Surface::Quadratic);
        balance(&made).notes.join("\n")
    };
    let (a, narrow) = (source("a.tif", 0, 1.0), source("narrow.tif", 193, 1.3));
    let notes = said(&[a.clone(), narrow], Some(0));
    assert!(notes.contains("1 of 2 sources are tied to no other") && notes.contains("narrow.tif"), "{notes}");
    let (b, c, d) = (source("b.tif", 100, 1.2), source("c.tif", 600, 0.8), source("d.tif", 700, 1.1));
    let four = [a.clone(), b.clone(), c, d];
    let notes = said(&four, Some(0));
    assert!(notes.contains("2 of 4 sources") && notes.contains("c.tif, d.tif"), "{notes}");
    assert!(said(&four, None).contains("2 groups"), "{}", said(&four, None));
    assert_eq!(said(&[a, b], Some(0)), "");
    // Two even areas: their levels meet, and no contrast is made up.
    let even = [0usize, 100].map(|east| {
        let level = 90.0 + east as f64 / 5.0;
        folder.source(&format!("even{east}.tif"), east, (200, 200), move |x, y| {
            byte(level + 4.0 * (unit(mix((x + 1000 * (y + 1000 * east)) as u64)) - 0.5))
        })
    });
    let (made, values) = folder.balanced(&even, Some(0), Surface::Quadratic);
    let found = balance(&made);
    assert_eq!(found.gains[1][0], 1.0);
    assert!((mean(&values) - 90.0).abs() < 0.2 && found.notes[0].contains("levels alone"), "{:?}", found.notes);
}

#[test]
fn tiles_and_threads_do_not_change_a_balanced_mosaic() {
    let folder = Folder::new();
    let inputs: Vec<PathBuf> = (0..3)
        .map(|k| {
            let gain = 1.0 + 0.1 * k as f64;
            folder.source(&format!("{k}.tif"), 150 * k, (300, 280), |x, y| {
                byte(gain * (110.0 + 40.0 * ground(x + 150 * k, y, 23)) + (x as f64 / 20.0))
            })
        })
        .collect();
    let made = |cut: (u64, usize)| {
        let out = folder.at("mosaic.tif");
        let made = joined(&inputs, None, Surface::Quadratic, cut, &out);
        (serde_json::to_string(&made).expect("numbers"), std::fs::read(&out).expect("a file"))
    };
    let whole = made((512, 1));
    assert!(whole.0.contains("clipped_cells"));
    for cut in [(64, 1), (512, 3), (128, 2)] {
        assert!(made(cut) == whole, "{cut:?} changed the mosaic");
    }
}
