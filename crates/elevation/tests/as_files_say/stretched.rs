//! Cells that are as large as on the ground: of degrees, and of maps whose metres are not those of the ground, as
//! Mercator's far from the equator.

use autoref_elevation::source::Heights;

use super::*;

const MERCATOR: &str = "EPSG:3857";
/// Cells of the map, metres.
const CELL_M: f64 = 500.0;
const LEFT: f64 = 1_100_000.0;
/// About 80° north.
const TOP: f64 = 15_600_000.0;

const MAJOR_M: f64 = 6_378_137.0;

/// Of the ellipsoid of WGS 84, squared.
fn eccentricity2() -> f64 {
    let flattening: f64 = 1.0 / 298.257_223_563;
    flattening * (2.0 - flattening)
}

/// Writes a zone between two meridians and two parallels, degrees; its area on the ellipsoid, square metres (J. P.
/// Snyder, Map projections, 1987, equation 3-12).
fn write_zone(path: &Path, [west, east]: [f64; 2], [south, north]: [f64; 2]) -> f64 {
    let ring = format!("[[{west},{south}],[{east},{south}],[{east},{north}],[{west},{north}],[{west},{south}]]");
    std::fs::write(
        path,
        format!(
            "{{\"type\":\"Feature\",\"properties\":{{\"name\":\"n\"}},\"geometry\":{{\"type\":\"Polygon\",\"coordinates\":[{ring}]}}}}"
        ),
    )
    .expect("written");
    let e = eccentricity2().sqrt();
    let q = |degrees: f64| {
        let s = degrees.to_radians().sin();
        (1.0 - e * e) * (s / (1.0 - e * e * s * s) - ((1.0 - e * s) / (1.0 + e * s)).ln() / (2.0 * e))
    };
    MAJOR_M * MAJOR_M * (east - west).to_radians() * (q(north) - q(south)) / 2.0
}

#[test]
fn areas_of_geographic_cells_are_their_own() {
    let folder = tempfile::tempdir().expect("a folder");
    let make = |name: &str, height: f32| {
        let path = folder.path().join(name);
        let set = create::<f32>(&path, (60, 60), 1, "EPSG:4326", [10.0, 0.05, 0.0, 80.0, 0.0, -0.05]);
        // Not flat, so that there is a variogram.
        put(&set, 1, (0..3600).map(|i| height + ((i * 7919) % 13) as f32 * 1e-3 * height).collect());
        path
    };
    let (a, b) = (make("a.tif", 10.0), make("b.tif", 0.0));
    let zones = folder.path().join("north.geojson");
    let area = write_zone(&zones, [10.0, 13.0], [79.5, 80.0]);
    let found = compare(&a, &b, Some(&zones), &folder.path().join("c"));
    let volume = &found.volumes[0];
    assert!((volume.area_m2 / area - 1.0).abs() < 1e-5, "{} of {area}", volume.area_m2);
    let mean = volume.volume_m3.expect("cells") / volume.area_m2;
    assert!((mean - volume.mean_m.expect("cells")).abs() < 1e-9 && (10.0..10.13).contains(&mean), "{mean}");
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
    let area = write_zone(&zones, [10.0, 10.4], [80.02, 80.07]);
    let found = compare(&a, &b, Some(&zones), &folder.path().join("c"));
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
