//! Light and bands of drawn frames, evened out against known truth.

use std::path::PathBuf;

use super::pixels;
use autoref_film::drawn::{FilmGround, FilmScene, FilmSpec};
use autoref_film::interior::{Observation, solve};
use autoref_film::resample::banding::Banding;
use autoref_film::resample::kernel::Kernel;
use autoref_film::resample::{self, Light, ResampleOptions, lighting};
use autoref_film::{InteriorModel, InteriorOrientation, load_camera};
use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_raster::window::Window;
use autoref_raster::{Block, Piece, RasterInfo, RasterSource, ReadStats};

/// A frame that is drawn once and read many times, with its orientation.
struct Kept {
    info: RasterInfo,
    pieces: Vec<Piece>,
    inner: InteriorOrientation,
}

impl Kept {
    fn new(spec: &FilmSpec, ground: &FilmGround) -> Kept {
        let (scene, inner) = scene(spec, ground);
        let block = scene.read(scene.info().bounds()).expect("in memory");
        Kept { info: scene.info().clone(), pieces: block.pieces, inner }
    }
}

impl RasterSource for Kept {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read(&self, window: Window) -> autoref_raster::error::Result<Block> {
        let is_in = |piece: &&Piece| !piece.window.intersect(&window).is_empty();
        Ok(Block { window, pieces: self.pieces.iter().filter(is_in).cloned().collect() })
    }

    fn stats(&self) -> ReadStats {
        ReadStats::default()
    }
}

/// A frame of a camera without turn, resampled by the library at the scan's own pixel size; values of white.
fn resampled(spec: &FilmSpec, frame: &Kept, options: &ResampleOptions, light: Light) -> (usize, Vec<f64>) {
    let folder = tempfile::tempdir().expect("a folder");
    let (image, mask) = (folder.path().join("a.tif"), folder.path().join("b.tif"));
    resample::resample(frame, &spec.camera, &frame.inner, options, light, "{}", [&image, &mask]).expect("writable");
    let (w, _, values) = pixels(&image);
    (w, values.into_iter().map(|v| v / 65_535.0).collect())
}

fn scene(spec: &FilmSpec, ground: &FilmGround) -> (FilmScene, InteriorOrientation) {
    let scene = FilmScene::new(spec, ground).expect("drawable");
    let marks: Vec<Observation> = scene
        .truth()
        .marks
        .iter()
        .zip(&spec.camera.marks)
        .map(|(t, m)| Observation {
            name: m.name.clone(),
            mm: [m.x_mm.expect("calibrated"), m.y_mm.expect("calibrated")],
            pixel: PixelPoint { x: t.x, y: t.y },
            covariance_px2: [0.01, 0.0, 0.01],
        })
        .collect();
    let inner = solve(&spec.camera, &marks, InteriorModel::Affine, Handedness::AsIs).expect("solved");
    (scene, inner)
}

/// A landscape of noise; with `AUTOREF_LARGE=1` more of them, and photographs from above where they are there. None of
/// these repeats within a frame of 2,000 px: what a small photograph repeats along whole rows is a band.
fn grounds(first: u64) -> Vec<(&'static str, FilmGround, Vec<u64>)> {
    let large = std::env::var_os("AUTOREF_LARGE").is_some();
    let mut all = vec![("noise", FilmGround::default(), (first..first + if large { 4 } else { 1 }).collect())];
    let data = crate::common::root().join("../shared/data");
    let names = ["film/japan_1936_42/Z17-X114848-Y51988.png", "photos/savanna_oam.tif", "photos/river_town_oam.tif"];
    let paths: Vec<PathBuf> = names.iter().map(|n| data.join(n)).filter(|p| large && p.exists()).collect();
    if !paths.is_empty() {
        all.push(("photographs", FilmGround::open(&paths).expect("readable"), (first..first + 4).collect()));
    }
    all
}

fn grey16(pixel_um: f64, seed: u64) -> (FilmSpec, ResampleOptions) {
    let camera = load_camera("rmk-cross").expect("built in");
    let mut spec = FilmSpec::plain(&camera, pixel_um, seed);
    (spec.bits, spec.noise, spec.vignette) = (16, 0.004, 0.0);
    let options = ResampleOptions {
        pixel_mm: 1e-3 * pixel_um,
        kernel: Kernel::Cubic,
        mask_radius_mm: 3.0,
        boxes_mm: vec![],
        banding: Banding::Off,
    };
    (spec, options)
}

/// Means of squares of 64 pixels that lie clear of marks and border, and their standard deviations.
fn squares(w: usize, values: &[f64]) -> Vec<(f64, f64)> {
    let h = values.len() / w;
    let (mut all, margin) = (vec![], 64);
    for y in (margin..h - margin - 64).step_by(64) {
        for x in (margin..w - margin - 64).step_by(64) {
            let square: Vec<f64> = (0..64 * 64).map(|k| values[(y + k / 64) * w + x + k % 64]).collect();
            let mean = square.iter().sum::<f64>() / 4096.0;
            all.push((mean, (square.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 4096.0).sqrt()));
        }
    }
    all
}

/// Relative spread of `a` over `b`, square by square: 0 when they differ by one factor.
fn spread(a: &[(f64, f64)], b: &[(f64, f64)], black: f64) -> f64 {
    let ratios: Vec<f64> = a.iter().zip(b).map(|(a, b)| (a.0 - black) / (b.0 - black)).collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    (ratios.iter().map(|r| (r / mean - 1.0).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt()
}

#[test]
fn known_vignette_is_evened_out_and_contrast_stays() {
    for (name, ground, seeds) in grounds(5) {
        for seed in seeds {
            let [before, frame_after, roll_after, kept_frame, kept_roll] = vignette(&ground, seed);
            println!(
                "{name} {seed}, vignette 0.5: light varies by {before:.4} before, {frame_after:.4} (frame), \
                 {roll_after:.4} (roll of 6); contrast kept: {kept_frame:.4}, {kept_roll:.4}"
            );
            assert!(before > 0.06 && frame_after < 0.75 * before, "{name} {seed}");
            // Six photographs may share what is bright and dark.
            let at_most = if name == "noise" { 0.6 } else { 0.75 };
            assert!(roll_after < at_most * before, "{name} {seed}");
            assert!([kept_frame, kept_roll].iter().all(|k| (k - 1.0).abs() < 0.06), "{name} {seed}");
        }
    }
}

/// How much the light varies before, after `--lighting frame` and after `roll`, and the contrast that these two keep.
fn vignette(ground: &FilmGround, seed: u64) -> [f64; 5] {
    let (clean, options) = grey16(140.0, seed);
    let mut dim = clean.clone();
    dim.vignette = 0.5;
    let (w, even) = resampled(&clean, &Kept::new(&clean, ground), &options, Light::AsScanned);
    let shown = Kept::new(&dim, ground);
    let even = squares(w, &even);
    // What the opaque frame lets through is not light of the image.
    let black = 0.03;
    let before = spread(&squares(w, &resampled(&dim, &shown, &options, Light::AsScanned).1), &even, black);
    let of_frame = squares(w, &resampled(&dim, &shown, &options, Light::OfFrame).1);
    let cells: Vec<_> = (seed..seed + 6)
        .map(|seed| {
            let mut one = dim.clone();
            one.seed = seed;
            let (scene, inner) = scene(&one, ground);
            resample::frame_cells(&scene, &one.camera, &inner, &options).expect("in memory")
        })
        .collect();
    let roll = lighting::of_roll(&cells).expect("six frames");
    let of_roll = squares(w, &resampled(&dim, &shown, &options, Light::OfRoll(&roll)).1);
    let (frame_after, roll_after) = (spread(&of_frame, &even, black), spread(&of_roll, &even, black));
    // Contrast within squares, relative to their brightness, is that of the even frame.
    let contrast = |s: &[(f64, f64)]| s.iter().map(|(m, d)| d / (m - black)).sum::<f64>() / s.len() as f64;
    let kept = |after: &[(f64, f64)]| contrast(after) / contrast(&even);
    [before, frame_after, roll_after, kept(&of_frame), kept(&of_roll)]
}

#[test]
fn known_bands_are_removed_and_the_ground_stays() {
    for (name, ground, seeds) in grounds(8) {
        for seed in seeds {
            let bands = Bands::new(&ground, seed);
            let (before, across) = (bands.left(Banding::Off), bands.left(Banding::Columns));
            assert!(before > 0.01 && across > 0.9 * before);
            for which in [Banding::Rows, Banding::Both] {
                let (after, of_clean) = (bands.left(which), bands.rms(&bands.clean, which));
                println!(
                    "{name} {seed}, {which:?}: bands {before:.5} of white before, {after:.5} after; a frame without \
                     bands changes by {of_clean:.5}; wrong direction leaves {across:.5}"
                );
                // Photographs may have more of their own along the rows than the bands.
                let at_most = if name == "noise" { 0.4 } else { 0.95 };
                assert!(after < at_most * before, "{name} {seed}: {before} {after}");
                assert!(of_clean < 0.01 * before, "{name} {seed}: ground is taken for bands: {of_clean}");
            }
        }
    }
}

/// One frame without bands and with.
struct Bands {
    spec: FilmSpec,
    options: ResampleOptions,
    clean: Kept,
    banded: Kept,
    /// The frame without bands, nothing removed.
    still: Vec<f64>,
}

impl Bands {
    fn new(ground: &FilmGround, seed: u64) -> Bands {
        let (mut spec, options) = grey16(100.0, seed);
        spec.rotation_deg = 0.4;
        let clean = Kept::new(&spec, ground);
        let banded = Kept::new(&FilmSpec { banding: 0.02, ..spec.clone() }, ground);
        let (_, still) = resampled(&spec, &clean, &options, Light::AsScanned);
        Bands { spec, options, clean, banded, still }
    }

    /// What is left of the bands when `which` are removed.
    fn left(&self, which: Banding) -> f64 {
        self.rms(&self.banded, which)
    }

    /// Bands are what differs from the frame without them, inside the ground that they are measured on.
    fn rms(&self, frame: &Kept, banding: Banding) -> f64 {
        let options = ResampleOptions { banding, ..self.options.clone() };
        let (w, values) = resampled(&self.spec, frame, &options, Light::AsScanned);
        let h = values.len() / w;
        let inside: Vec<usize> = (80..h - 80).flat_map(|y| (80..w - 80).map(move |x| y * w + x)).collect();
        let sum: f64 = inside.iter().map(|&i| (values[i] - self.still[i]).powi(2)).sum();
        (sum / inside.len() as f64).sqrt()
    }
}
