//! Known shifts and tilts of drawn terrain are found again, and their stated errors are right.

use autoref_elevation::align::{Alignment, Degree, Method, Options, Outcome, align};
use autoref_elevation::grid::{Grid, GroundUnit};
use autoref_elevation::source::{Heights as _, MemoryHeights};
use autoref_elevation::stream::Means;
use autoref_elevation::zones::Zones;
use autoref_raster::random::SplitMix64;

const CELL_M: f64 = 10.0;

/// Hills of all sizes from 120 m to some kilometres, as a formula, so that they can be read anywhere.
struct Terrain(Vec<[f64; 4]>);

impl Terrain {
    fn new(seed: u64) -> Self {
        let mut dice = SplitMix64(seed);
        let waves = (0..40).map(|i| {
            let length_m = 120.0 * 1.1f64.powi(i);
            let direction = dice.unit() * std::f64::consts::TAU;
            let k = std::f64::consts::TAU / length_m;
            [k * direction.cos(), k * direction.sin(), dice.unit() * 6.3, 0.012 * length_m]
        });
        Terrain(waves.collect())
    }

    /// Ground that is rough from cell to cell: waves from just above two cells.
    fn rough(seed: u64) -> Self {
        let mut dice = SplitMix64(seed);
        let waves = (0..240).map(|i| {
            let length_m = 2.1 * CELL_M * 100f64.powf(f64::from(i) / 240.0);
            let direction = dice.unit() * std::f64::consts::TAU;
            let k = std::f64::consts::TAU / length_m;
            [k * direction.cos(), k * direction.sin(), dice.unit() * 6.3, 0.01 * length_m]
        });
        Terrain(waves.collect())
    }

    /// Mountains: three times as steep.
    fn steep(seed: u64) -> Self {
        let mut terrain = Terrain::new(seed);
        terrain.0.iter_mut().for_each(|wave| wave[3] *= 3.0);
        terrain
    }

    fn at(&self, east: f64, north: f64) -> f64 {
        500.0 + self.0.iter().map(|[kx, ky, phase, a]| a * (kx * east + ky * north + phase).sin()).sum::<f64>()
    }
}

/// What is seen of a terrain.
struct View {
    width: u64,
    height: u64,
    /// Where the file says the ground lies, minus where it lies.
    error: (f64, f64, f64),
    tilt: (f64, f64),
    /// Metres at a place, which runs from −1 to 1 over the view.
    bend: fn(f64, f64) -> f64,
    noise_m: f64,
    cell_m: f64,
}

const PLAIN: View = View {
    width: 200,
    height: 160,
    error: (0.0, 0.0, 0.0),
    tilt: (0.0, 0.0),
    bend: |_, _| 0.0,
    noise_m: 0.0,
    cell_m: CELL_M,
};

fn draw(terrain: &Terrain, view: &View, dice: &mut SplitMix64) -> MemoryHeights {
    let grid = Grid {
        x0: 500_000.0,
        y0: 8_700_000.0,
        step_x: view.cell_m,
        step_y: -view.cell_m,
        width: view.width,
        height: view.height,
    };
    let mut values = Vec::new();
    for row in 0..view.height {
        for column in 0..view.width {
            let east = (column as f64 + 0.5) * view.cell_m;
            let north = -(row as f64 + 0.5) * view.cell_m;
            let (middle_e, middle_n) = grid.centre();
            let (from_e, from_n) = (east - (middle_e - grid.x0), north - (middle_n - grid.y0));
            let height = terrain.at(east - view.error.0, north - view.error.1) + view.error.2;
            let bend = (view.bend)(from_e / (middle_e - grid.x0), from_n / (grid.y0 - middle_n));
            values.push(height + view.tilt.0 * from_e + view.tilt.1 * from_n + bend + view.noise_m * dice.normal());
        }
    }
    MemoryHeights::new(grid, values)
}

fn aligned(a: &MemoryHeights, b: &MemoryHeights, options: &Options<'_>) -> Alignment {
    match align(a, b, options).expect("memory cannot fail") {
        Outcome::Aligned(alignment) => *alignment,
        Outcome::Refused(why) => panic!("refused: {why}"),
    }
}

#[test]
fn a_sub_pixel_shift_is_found_to_a_thousandth_of_a_cell() {
    let (terrain, mut dice) = (Terrain::new(1), SplitMix64(1));
    let b = draw(&terrain, &PLAIN, &mut dice);
    let a = draw(&terrain, &View { error: (13.7, -22.1, 3.3), ..PLAIN }, &mut dice);
    for method in [Method::Auto, Method::Lzd] {
        let found = aligned(&a, &b, &Options { method, ..Options::default() });
        let [e, n, h] = found.shift_m;
        assert!((e + 13.7).abs() < 0.02 && (n - 22.1).abs() < 0.02 && (h + 3.3).abs() < 0.005, "{method}: {found:?}");
        assert!(found.nmad_after_m < 0.1 && found.nmad_before_m > 1.0, "{found:?}");
    }
    let found = aligned(&a, &b, &Options { method: Method::NuthKaab, ..Options::default() });
    let [e, n, h] = found.shift_m;
    assert!((e + 13.7).abs() < 0.5 && (n - 22.1).abs() < 0.5 && (h + 3.3).abs() < 0.2, "{found:?}");
}

#[test]
fn rough_ground_draws_the_shift_by_no_more_than_is_stated() {
    let (terrain, mut dice) = (Terrain::rough(3), SplitMix64(3));
    let plain = View { width: 140, height: 110, noise_m: 0.02, ..PLAIN };
    let b = draw(&terrain, &plain, &mut dice);
    for (east_m, north_m) in [(3.1, -2.4), (13.7, 22.3), (-17.6, 1.2), (4.9, -8.2)] {
        let a = draw(&terrain, &View { error: (east_m, north_m, 0.0), ..plain }, &mut dice);
        let found = aligned(&a, &b, &Options { method: Method::Lzd, ..Options::default() });
        let [e, n, _] = found.shift_m;
        for (index, error_m) in [e + east_m, n + north_m].into_iter().enumerate() {
            let stated_m = found.covariance_m2[(index, index)].sqrt();
            assert!(error_m.abs() < 0.0015 * CELL_M, "{east_m}, {north_m}: {error_m} m off");
            assert!(error_m.abs() < 3.0 * stated_m, "{east_m}, {north_m}: {error_m} m off, {stated_m} m stated");
        }
    }
}

#[test]
fn shift_and_tilt_are_found_together() {
    let (terrain, mut dice) = (Terrain::new(2), SplitMix64(2));
    let b = draw(&terrain, &PLAIN, &mut dice);
    let a = draw(&terrain, &View { error: (-27.4, 44.2, -7.0), tilt: (0.001, -0.0005), ..PLAIN }, &mut dice);
    let found = aligned(&a, &b, &Options::default());
    let tilt = found.tilt.expect("there is one");
    assert!((found.shift_m[0] - 27.4).abs() < 0.1 && (found.shift_m[1] + 44.2).abs() < 0.1, "{found:?}");
    assert!((tilt.east + 0.001).abs() < 2e-5 && (tilt.north - 0.0005).abs() < 2e-5, "{tilt:?}");
    // Flat cells are no hindrance to a height and a tilt.
    let grid = Grid { x0: 0.0, y0: 0.0, step_x: 1.0, step_y: -1.0, width: 60, height: 60 };
    let flat = MemoryHeights::new(grid, vec![10.0; 3600]);
    let tilted = (0..3600).map(|i| 12.0 + 0.01 * ((i % 60) as f64 - 29.5)).collect();
    let found =
        aligned(&MemoryHeights::new(grid, tilted), &flat, &Options { method: Method::Tilt, ..Options::default() });
    let tilt = found.tilt.expect("asked for");
    assert!((tilt.east + 0.01).abs() < 1e-6 && tilt.north.abs() < 1e-6, "{tilt:?}");
    assert!((found.shift_m[2] + 2.0).abs() < 1e-6, "{found:?}");
}

/// A bowl with a twist, and something of the third degree.
fn bowl(u: f64, v: f64) -> f64 {
    4.0 * u * u - 2.0 * v * v + 1.5 * u * v + 0.5 * u
}

fn twisted(u: f64, v: f64) -> f64 {
    bowl(u, v) + 2.0 * u * u * u - 1.5 * u * v * v
}

#[test]
fn bent_models_are_bent_back() {
    use autoref_elevation::source::Heights;
    let (terrain, mut dice) = (Terrain::new(10), SplitMix64(10));
    let b = draw(&terrain, &View { noise_m: 0.2, ..PLAIN }, &mut dice);
    // Coarser than the other model too: then it is the one whose cells the fit counts in.
    let coarse = View { width: 80, height: 64, cell_m: 25.0, ..PLAIN };
    for (view, worst_m) in [(PLAIN, 0.15), (coarse, 0.5)] {
        for (bend, degree) in [(bowl as fn(f64, f64) -> f64, Degree::Quadratic), (twisted, Degree::Cubic)] {
            let error = (17.3, -8.6, 2.5);
            let a = draw(&terrain, &View { error, bend, noise_m: 0.2, ..view }, &mut dice);
            let found = aligned(&a, &b, &Options { surface: Degree::Cubic, ..Options::default() });
            assert_eq!(found.bend.as_ref().map(|bend| bend.degree), Some(degree), "{found:?}");
            assert!((found.shift_m[0] + 17.3).abs() < worst_m && (found.shift_m[1] - 8.6).abs() < worst_m, "{found:?}");
            let grid = a.grid();
            let [w, s, e, n] = grid.bounds();
            for (u, v) in [(0.0, 0.0), (0.9, 0.9), (-0.9, 0.4), (0.5, -0.8)] {
                let (x, y) = ((w + e) / 2.0 + u * (e - w) / 2.0, (s + n) / 2.0 + v * (n - s) / 2.0);
                let expected = -(error.2 + bend(u, v));
                let correction = found.height_at(x + found.shift.0, y + found.shift.1, &GroundUnit::METRES);
                assert!((correction - expected).abs() < worst_m, "{degree} at {u}, {v}: {correction} for {expected}");
            }
        }
    }
}

#[test]
fn a_surface_is_taken_out_only_where_there_is_one() {
    let (terrain, mut dice) = (Terrain::new(11), SplitMix64(11));
    let noisy = View { noise_m: 1.0, ..PLAIN };
    let b = draw(&terrain, &noisy, &mut dice);
    for (tilt, tilted) in [((0.0, 0.0), false), ((0.002, 0.001), true)] {
        let a = draw(&terrain, &View { error: (12.0, 5.0, -1.0), tilt, ..noisy }, &mut dice);
        let found = aligned(&a, &b, &Options { surface: Degree::Cubic, ..Options::default() });
        assert!(found.bend.is_none() && found.tilt.is_some() == tilted, "{found:?}");
        // A surface that is asked for by name is fitted whole.
        let forced = Options { surface: Degree::Quadratic, method: Method::Tilt, ..Options::default() };
        assert_eq!(aligned(&a, &b, &forced).bend.expect("asked for").terms.len(), 3);
    }
}

/// A part of a model, whose file says that it lies elsewhere.
fn part(whole: &MemoryHeights, [x, y]: [usize; 2], [width, height]: [usize; 2], said_m: (f64, f64)) -> MemoryHeights {
    let grid = whole.grid();
    let rows = whole.values().chunks_exact(grid.width as usize).skip(y).take(height);
    let values = rows.flat_map(|row| &row[x..x + width]).copied().collect();
    let (x0, y0) = (grid.x0 + x as f64 * grid.step_x + said_m.0, grid.y0 + y as f64 * grid.step_y + said_m.1);
    MemoryHeights::new(Grid { x0, y0, width: width as u64, height: height as u64, ..grid }, values)
}

#[test]
fn a_small_model_finds_its_place_on_a_large_one_in_both_directions() {
    let (terrain, mut dice) = (Terrain::new(21), SplitMix64(21));
    let view = View { width: 320, height: 300, noise_m: 0.2, ..PLAIN };
    let (large, seen_again) = (draw(&terrain, &view, &mut dice), draw(&terrain, &view, &mut dice));
    for (size, (east_m, north_m)) in [
        ([60, 50], (350.0, -270.0)),
        ([60, 50], (-800.0, 600.0)),
        ([90, 80], (120.0, -90.0)),
        ([200, 48], (310.0, 700.0)),
    ] {
        let small = part(&seen_again, [70, 100], size, (east_m, north_m));
        for (sign, a, b) in [(-1.0, &small, &large), (1.0, &large, &small)] {
            let [e, n, h] = aligned(a, b, &Options::default()).shift_m;
            let (off_e, off_n) = (e - sign * east_m, n - sign * north_m);
            assert!(off_e.abs() < 1.0 && off_n.abs() < 1.0 && h.abs() < 0.2, "{size:?}, {sign}: {off_e} {off_n} {h}");
        }
    }
}

#[test]
fn a_small_model_of_other_ground_finds_no_place() {
    let mut dice = SplitMix64(22);
    let large = draw(&Terrain::new(23), &View { width: 320, height: 300, ..PLAIN }, &mut dice);
    let elsewhere = draw(&Terrain::new(24), &View { width: 320, height: 300, ..PLAIN }, &mut dice);
    for place in [[0, 0], [70, 100], [200, 180]] {
        let small = part(&elsewhere, place, [60, 50], (0.0, 0.0));
        for (a, b) in [(&small, &large), (&large, &small)] {
            let outcome = align(a, b, &Options::default()).expect("memory cannot fail");
            assert!(matches!(outcome, Outcome::Refused(_)), "{place:?}: {outcome:?}");
        }
    }
}

#[test]
fn hundreds_of_metres_and_a_fifth_of_the_ground_changed() {
    let (terrain, mut dice) = (Terrain::new(3), SplitMix64(3));
    let b = draw(&terrain, &PLAIN, &mut dice);
    let noisy = View { error: (412.0, -333.0, 25.0), noise_m: 0.5, ..PLAIN };
    let a = draw(&terrain, &noisy, &mut dice);
    // A glacier that has lost up to 150 m.
    let values = a.values().iter().enumerate().map(|(i, &z)| {
        let (x, y) = ((i % 200) as f64, (i / 200) as f64);
        let inside = (60.0..110.0).contains(&x) && y < 130.0;
        if inside { z - 150.0 + y } else { z }
    });
    use autoref_elevation::source::Heights;
    let a = MemoryHeights::new(a.grid(), values.collect());
    let found = aligned(&a, &b, &Options::default());
    assert!((found.shift_m[0] + 412.0).abs() < 1.0 && (found.shift_m[1] - 333.0).abs() < 1.0, "{found:?}");
    assert!((found.shift_m[2] + 25.0).abs() < 0.1, "{found:?}");
}

/// Three in ten cells lie 40 m lower. Where the search ends they hide in the scatter of a shift that is not yet right.
#[test]
fn lowered_ground_holds_no_wrong_height() {
    use autoref_elevation::source::Heights;
    let (terrain, mut dice) = (Terrain::steep(13), SplitMix64(13));
    let b = draw(&terrain, &PLAIN, &mut dice);
    for error in [(-75.0, 45.0, 0.0), (0.0, 0.0, 0.0)] {
        let a = draw(&terrain, &View { error, noise_m: 2.0, ..PLAIN }, &mut dice);
        let lowered = a.values().iter().enumerate().map(|(i, &z)| {
            let (x, y) = ((i % 200) as f64 / 100.0 - 1.0, (i / 200) as f64 / 80.0 - 1.0);
            if x * x + y * y < 0.39 { z - 40.0 } else { z }
        });
        let a = MemoryHeights::new(a.grid(), lowered.collect());
        for method in [Method::Auto, Method::Lzd, Method::NuthKaab] {
            let run = |tile_px, threads| {
                let means = Means::square(tile_px, threads);
                aligned(&a, &b, &Options { method, means, ..Options::default() })
            };
            let found = run(4096, 1);
            let off = [0, 1, 2].map(|i| found.shift_m[i] + [error.0, error.1, error.2][i]);
            let worst_m = if method == Method::NuthKaab { 1.0 } else { 0.2 };
            assert!(off[0].abs().max(off[1].abs()) < worst_m && off[2].abs() < 0.15, "{method}: {off:?} {found:?}");
            let stated_m = found.covariance_m2[(2, 2)].sqrt();
            assert!(off[2].abs() < 4.0 * stated_m && stated_m < 0.2, "{method}: {off:?}, {stated_m} m stated");
            assert_eq!(format!("{found:?}"), format!("{:?}", run(48, 3)), "{method}");
        }
    }
}

#[test]
fn finer_and_coarser_models_meet() {
    let (terrain, mut dice) = (Terrain::new(4), SplitMix64(4));
    let b = draw(&terrain, &PLAIN, &mut dice);
    let fine = View { width: 760, height: 600, cell_m: 2.5, error: (7.3, 11.9, -1.0), noise_m: 0.1, ..PLAIN };
    let a = draw(&terrain, &fine, &mut dice);
    let found = aligned(&a, &b, &Options::default());
    assert!((found.shift_m[0] + 7.3).abs() < 0.2 && (found.shift_m[1] + 11.9).abs() < 0.2, "{found:?}");
    let back = aligned(&b, &a, &Options::default());
    for i in 0..3 {
        assert!((found.shift_m[i] + back.shift_m[i]).abs() < 0.05, "{found:?} {back:?}");
    }
}

#[test]
fn any_tiling_and_any_number_of_threads_gives_the_same_bits() {
    let (terrain, mut dice) = (Terrain::new(5), SplitMix64(5));
    let small = View { width: 140, height: 100, ..PLAIN };
    let b = draw(&terrain, &small, &mut dice);
    let a = draw(&terrain, &View { error: (5.0, 8.0, 1.0), noise_m: 1.0, ..small }, &mut dice);
    for (method, surface) in
        [(Method::Auto, Degree::Linear), (Method::NuthKaab, Degree::Linear), (Method::Tilt, Degree::Cubic)]
    {
        // The second run holds a fraction in memory and streams the rest.
        for memory_cells in [1 << 20, 4096] {
            if method != Method::Auto && memory_cells > 4096 {
                continue;
            }
            let run = |tile_px: u64, threads: usize| {
                let means = Means::square(tile_px, threads);
                let options = Options { means, memory_cells, method, surface, ..Options::default() };
                format!("{:?}", aligned(&a, &b, &options))
            };
            let whole = run(4096, 1);
            for (tile_px, threads) in [(16, 2), (33, 1), (64, 3), (100, 2), (128, 4)] {
                assert_eq!(whole, run(tile_px, threads), "{method}, tiles of {tile_px}");
            }
        }
    }
}

/// How coarse the search begins, which memory decides, changes no bit of where the fit ends.
#[test]
fn any_memory_gives_the_same_bits() {
    let (terrain, mut dice) = (Terrain::new(6), SplitMix64(6));
    let small = View { width: 150, height: 110, ..PLAIN };
    let b = draw(&terrain, &small, &mut dice);
    let a = draw(&terrain, &View { error: (5.0, 8.0, 1.0), noise_m: 1.0, ..small }, &mut dice);
    for method in [Method::Auto, Method::Lzd, Method::Bias, Method::Tilt] {
        let run = |memory_cells: u64| {
            let options = Options { memory_cells, method, ..Options::default() };
            format!("{:?}", aligned(&a, &b, &options))
        };
        assert_eq!(run(1 << 20), run(4096), "{method}");
    }
}

/// Whether a tilt is taken out is decided at one coarseness, also where it is as weak as one that is left.
#[test]
fn any_memory_takes_out_the_same_tilt() {
    let (terrain, mut dice) = (Terrain::new(7), SplitMix64(7));
    let view = View { width: 330, height: 200, ..PLAIN };
    let b = draw(&terrain, &view, &mut dice);
    let mut tilted = Vec::new();
    for rise in [0.0, 0.3e-4, 0.5e-4, 0.9e-4, 3e-4] {
        let a = draw(&terrain, &View { error: (5.0, 8.0, 1.0), tilt: (rise, 0.0), noise_m: 1.0, ..view }, &mut dice);
        let run = |memory_cells: u64| aligned(&a, &b, &Options { memory_cells, ..Options::default() });
        let (held, streamed) = (run(1 << 20), run(4096));
        assert_eq!(format!("{held:?}"), format!("{streamed:?}"), "{rise}");
        tilted.push(held.tilt.is_some());
    }
    assert!(!tilted[0] && tilted[4], "{tilted:?}");
}

#[test]
fn flat_or_unlike_ground_is_refused() {
    let (terrain, mut dice) = (Terrain::new(6), SplitMix64(6));
    let grid = Grid { x0: 500_000.0, y0: 8_700_000.0, step_x: 10.0, step_y: -10.0, width: 150, height: 150 };
    let mut noise = |slope: f64| {
        let values = (0..150 * 150).map(|i| slope * (i % 150) as f64 + 0.3 * dice.normal()).collect();
        MemoryHeights::new(grid, values)
    };
    for slope in [0.0, 1.0] {
        let (a, b) = (noise(slope), noise(slope));
        let outcome = align(&a, &b, &Options::default()).expect("memory");
        assert!(matches!(outcome, Outcome::Refused(_)), "slope {slope}: {outcome:?}");
        let height = aligned(&a, &b, &Options { method: Method::Bias, ..Options::default() });
        assert!(height.shift_m[2].abs() < 0.02, "{height:?}");
    }
    let plane = |rise: f64| {
        let values = (0..150 * 150).map(|i| rise + 2.0 * (i % 150) as f64 + 0.7 * (i / 150) as f64).collect();
        MemoryHeights::new(grid, values)
    };
    let outcome = align(&plane(0.0), &plane(1.0), &Options::default()).expect("memory");
    let Outcome::Refused(why) = outcome else { panic!("{outcome:?}") };
    assert!(why.contains("one direction only") && why.contains("--method bias"), "{why}");
    let constant = MemoryHeights::new(grid, vec![3.0; 150 * 150]);
    let outcome = align(&constant, &constant.clone(), &Options::default()).expect("memory");
    assert!(matches!(outcome, Outcome::Refused(_)), "{outcome:?}");
    let far = draw(&terrain, &PLAIN, &mut SplitMix64(1));
    let error = align(&far, &MemoryHeights::new(Grid { x0: 0.0, ..grid }, vec![1.0; 150 * 150]), &Options::default());
    assert!(error.is_err(), "no common ground");
}

#[test]
fn stable_ground_can_be_given() {
    let (terrain, mut dice) = (Terrain::new(7), SplitMix64(7));
    let b = draw(&terrain, &PLAIN, &mut dice);
    let a = draw(&terrain, &View { error: (4.0, 3.0, 2.0), ..PLAIN }, &mut dice);
    use autoref_elevation::source::Heights;
    // More than half has changed: only who knows where can tell.
    let values = a.values().iter().enumerate().map(|(i, &z)| if i % 200 < 120 { z + 40.0 } else { z }).collect();
    let a = MemoryHeights::new(a.grid(), values);
    let ring =
        vec![(501_210.0, 8_690_000.0), (503_000.0, 8_690_000.0), (503_000.0, 8_701_000.0), (501_210.0, 8_701_000.0)];
    let zones = Zones::new([("rock".to_string(), vec![ring])]);
    let found = aligned(&a, &b, &Options { stable: Some(&zones), ..Options::default() });
    assert!((found.shift_m[0] + 4.0).abs() < 0.05 && (found.shift_m[2] + 2.0).abs() < 0.02, "{found:?}");
}

#[test]
fn degrees_are_metres_on_the_ground() {
    let terrain = Terrain::new(8);
    let step = 1.0 / 3600.0;
    let (mx, my) = GroundUnit::WGS84.metres_per_unit(60.0);
    let model = |shift: (f64, f64)| {
        let grid = Grid { x0: 10.0, y0: 60.02, step_x: step, step_y: -step, width: 150, height: 144 };
        let values = (0..144).flat_map(|row| {
            let terrain = &terrain;
            (0..150).map(move |column| {
                let east = (f64::from(column) + 0.5) * step * mx - shift.0;
                terrain.at(east, -(f64::from(row) + 0.5) * step * my - shift.1)
            })
        });
        MemoryHeights::new(grid, values.collect())
    };
    let options = Options { unit: GroundUnit::WGS84, ..Options::default() };
    let found = aligned(&model((20.0, -35.0)), &model((0.0, 0.0)), &options);
    assert!((found.shift_m[0] + 20.0).abs() < 0.1 && (found.shift_m[1] - 35.0).abs() < 0.1, "{found:?}");
    assert!((found.shift.0 * mx + 20.0).abs() < 0.1, "{found:?}");
}

/// Normalised errors of the shift over many draws of the noise: a standard deviation of one, within what chance allows.
#[test]
fn stated_errors_are_the_real_ones() {
    let terrain = Terrain::new(9);
    let trials = if std::env::var_os("AUTOREF_LARGE").is_some() { 400 } else { 40 };
    let small = View { width: 96, height: 96, noise_m: 1.5, ..PLAIN };
    let mut squares = [0.0; 3];
    for trial in 0..trials {
        let mut dice = SplitMix64(1000 + trial);
        let error = (dice.unit() * 20.0 - 10.0, dice.unit() * 20.0 - 10.0, 1.0);
        let b = draw(&terrain, &small, &mut dice);
        let a = draw(&terrain, &View { error, ..small }, &mut dice);
        let found = aligned(&a, &b, &Options { method: Method::Lzd, ..Options::default() });
        for (i, truth) in [-error.0, -error.1, -error.2].into_iter().enumerate() {
            squares[i] += (found.shift_m[i] - truth).powi(2) / found.covariance_m2[(i, i)];
        }
    }
    let limit = if trials >= 400 { 0.1 } else { 0.35 };
    for (i, sum) in squares.iter().enumerate() {
        let normalised = (sum / trials as f64).sqrt();
        println!("normalised error {i}: {normalised:.3} over {trials} trials");
        assert!((normalised - 1.0).abs() < limit, "parameter {i}: {normalised}");
    }
}

/// The same of a bend's terms, beside a shift.
#[test]
fn stated_errors_of_a_bend_are_the_real_ones() {
    let terrain = Terrain::new(12);
    let trials = if std::env::var_os("AUTOREF_LARGE").is_some() { 400 } else { 30 };
    let small = View { width: 96, height: 96, noise_m: 1.5, ..PLAIN };
    let mut squares = [0.0; 3];
    for trial in 0..trials {
        let mut dice = SplitMix64(5000 + trial);
        let b = draw(&terrain, &small, &mut dice);
        let a = draw(&terrain, &View { error: (3.0, -4.0, 1.0), bend: bowl, ..small }, &mut dice);
        let found = aligned(&a, &b, &Options { surface: Degree::Quadratic, ..Options::default() });
        let bend = found.bend.expect("there is one");
        // That of the cells of A before the shift, of which the second degree does not change.
        for (square, (term, truth)) in squares.iter_mut().zip(bend.terms.iter().zip([-4.0, -1.5, 2.0])) {
            *square += ((term.metres - truth) / term.se_m).powi(2);
        }
    }
    let limit = if trials >= 400 { 0.1 } else { 0.4 };
    for (i, sum) in squares.iter().enumerate() {
        let normalised = (sum / trials as f64).sqrt();
        println!("normalised error of term {i}: {normalised:.3} over {trials} trials");
        assert!((normalised - 1.0).abs() < limit, "term {i}: {normalised}");
    }
}
