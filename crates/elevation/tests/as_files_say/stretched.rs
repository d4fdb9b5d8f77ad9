//! Maps whose metres are not those of the ground, as Mercator's far from the equator.

use autoref_elevation::source::Heights;

use super::*;

const MERCATOR: &str = "EPSG:3857";
/// Cells of the map, metres.
const CELL_M: f64 = 500.0;
const LEFT: f64 = 1_100_000.0;
/// About 80° north.
const TOP: f64 = 15_600_000.0;
const MAJOR_M: f64 = 6_378_137.0;

fn eccentricity2() -> f64 {
    let flattening: f64 = 1.0 / 298.257_223_563;
    flattening * (2.0 - flattening)
}

/// Metres of the ground in a metre of the map, along x and along y (J. P. Snyder, Map projections, 1987, equations
/// 4-20 and 4-18, and 7-4 of the sphere).
fn ground(y: f64) -> (f64, f64) {
    let latitude = (y / MAJOR_M).sinh().atan();
    let w2 = 1.0 - eccentricity2() * latitude.sin().powi(2);
    (latitude.cos() / w2.sqrt(), latitude.cos() * (1.0 - eccentricity2()) / w2.powf(1.5))
}

fn mercator(path: &Path, height: impl Fn(usize, usize) -> f64) -> PathBuf {
    let set = create::<f32>(path, (SIDE, SIDE), 1, MERCATOR, [LEFT, CELL_M, 0.0, TOP, 0.0, -CELL_M]);
    put(&set, 1, (0..SIDE * SIDE).map(|i| height(i % SIDE, i / SIDE) as f32).collect());
    path.to_path_buf()
}

#[test]
fn areas_and_volumes_are_those_of_the_ground() {
    let folder = tempfile::tempdir().expect("a folder");
    let rough = |x: usize, y: usize| ((y * SIDE + x) * 7919 % 13) as f64 * 1e-3;
    let a = mercator(&folder.path().join("a.tif"), |x, y| 10.0 + rough(x, y));
    let b = mercator(&folder.path().join("b.tif"), |_, _| 0.0);
    let zones = folder.path().join("zone.geojson");
    let ring = "[[10,80.02],[10.4,80.02],[10.4,80.07],[10,80.07],[10,80.02]]";
    std::fs::write(
        &zones,
        format!(
            "{{\"type\":\"Feature\",\"properties\":{{\"name\":\"n\"}},\"geometry\":{{\"type\":\"Polygon\",\"coordinates\":[{ring}]}}}}"
        ),
    )
    .expect("written");
    let found = compare(&a, &b, Some(&zones), &folder.path().join("c"));
    let e = eccentricity2().sqrt();
    let q = |degrees: f64| {
        let s = degrees.to_radians().sin();
        (1.0 - e * e) * (s / (1.0 - e * e * s * s) - ((1.0 - e * s) / (1.0 + e * s)).ln() / (2.0 * e))
    };
    let area = MAJOR_M * MAJOR_M * 0.4f64.to_radians() * (q(80.07) - q(80.02)) / 2.0;
    let volume = &found.volumes[0];
    assert!((volume.zone_area_m2 / area - 1.0).abs() < 1e-3, "{} of {area}", volume.zone_area_m2);
    // Whole cells.
    assert!((volume.area_m2 / area - 1.0).abs() < 0.02, "{} of {area}", volume.area_m2);
    let mean = volume.volume_m3.expect("cells") / volume.area_m2;
    assert!((10.0..10.02).contains(&mean), "{mean}");
}

#[test]
fn slopes_are_those_of_the_ground() {
    let folder = tempfile::tempdir().expect("a folder");
    let ramp = mercator(&folder.path().join("a.tif"), |x, y| 20.0 * y as f64 + 3.0 * x as f64);
    let slope = Picture::SlopeDegrees;
    assert!(gradient::needs_true_sides(&ramp, slope).expect("a model"));
    let out = folder.path().join("slope.tif");
    gradient::draw(&ramp, &out, slope, gradient::Kernel::Horn, gradient::Edges::LeftOut, 2).expect("drawn");
    let drawn = read(&out, 1);
    for row in [1, 60, SIDE - 2] {
        let (across, along) = ground(TOP - (row as f64 + 0.5) * CELL_M);
        let expected = (3.0 / (CELL_M * across)).hypot(20.0 / (CELL_M * along)).atan().to_degrees();
        let found = drawn[row * SIDE + 40];
        assert!((found - expected).abs() < 1e-3 && expected > 12.0, "{found} for {expected}");
    }
}

#[test]
fn shifts_are_those_of_the_ground_and_cells_keep_their_size() {
    let folder = tempfile::tempdir().expect("a folder");
    let of = |name: &str, dx: f64, dy: f64| {
        let heights = hills(dx, dy);
        mercator(&folder.path().join(name), |x, y| f64::from(heights[y * SIDE + x]))
    };
    // What lies at column x in B lies at x − 0.6 in A, and a row and a half farther up.
    let (a, b) = (of("a.tif", 0.6, 1.5), of("b.tif", 0.0, 0.0));
    let run = |a: &Path, b: &Path| {
        let job = AlignJob {
            a,
            b,
            method: Method::Lzd,
            surface: Degree::Level,
            stable: None,
            resources: resources(),
            scratch: None,
        };
        let found = job.run().expect("aligned");
        let Outcome::Aligned(alignment) = found.outcome else { panic!("{:?}", found.outcome) };
        (alignment.shift_m, found.couple.a.grid().step_x)
    };
    let (across, along) = ground(TOP - SIDE as f64 / 2.0 * CELL_M);
    let expected = [0.6 * CELL_M * across, -1.5 * CELL_M * along];
    let (shift_m, _) = run(&a, &b);
    assert!(
        (shift_m[0] - expected[0]).abs() < 1.0 && (shift_m[1] - expected[1]).abs() < 1.0,
        "{shift_m:?}, {expected:?}"
    );
    // In UTM A's cells are as long as on the ground, not as on its own map.
    let utm = folder.path().join("utm.tif");
    let options = ["-t_srs", "EPSG:32632", "-r", "cubic", "-tr", "90", "90", "-dstnodata", "-9999"].map(String::from);
    autoref_elevation::derive::warp(&b, &utm, &options.each_ref().map(String::as_str)).expect("warped");
    let (shift_m, step_m) = run(&a, &utm);
    assert!((85.0..90.0).contains(&step_m), "{step_m}");
    assert!((shift_m[0].hypot(shift_m[1]) - expected[0].hypot(expected[1])).abs() < 5.0, "{shift_m:?}, {expected:?}");
}
