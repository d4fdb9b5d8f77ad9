//! Fiducial marks: measured against drawn frames with known truth, and against the real Wild frame. `AUTOREF_LARGE=1` runs the
//! trials of 5,000 marks whose figures are in `docs/film.md`; small twins always run.

use std::path::{Path, PathBuf};

use autoref_stream::film::{FindOptions, Finder, FrameResult, MarkStatus, load_camera};
use autoref_stream::raster::RasterSource;
use autoref_stream::synth::{FilmGround, FilmScene, FilmSpec};
use rayon::prelude::*;

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data");

fn large() -> bool {
    std::env::var_os("AUTOREF_LARGE").is_some()
}

/// Grey photographs from above, or noise where the data are not there.
fn ground() -> FilmGround {
    let names = [
        "film/japan_1936_42/Z17-X114848-Y51988.png",
        "film/japan_1936_42/Z17-X114848-Y51992.png",
        "film/japan_1936_42/Z17-X114852-Y51988.png",
        "photos/savanna_oam.tif",
        "photos/oak_sjer_neon.tif",
    ];
    let paths: Vec<PathBuf> = names.iter().map(|n| Path::new(DATA).join(n)).filter(|p| p.exists()).collect();
    if paths.is_empty() {
        println!("the photographs are absent: drawing noise instead");
    }
    FilmGround::open(&paths).expect("the photographs can be read")
}

/// What came out of a trial.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    frames: usize,
    frames_ok: usize,
    /// Marks that lie in the scan whole.
    marks: usize,
    within_2px: usize,
    /// Passed as good, but more than 5 px off.
    unflagged: usize,
    /// Passed as good.
    good: usize,
    undamaged: usize,
    square_px2: f64,
    /// Cut marks passed as good although off.
    seconds: f64,
}

impl Tally {
    fn add(mut self, o: Tally) -> Tally {
        self.frames += o.frames;
        self.frames_ok += o.frames_ok;
        self.marks += o.marks;
        self.within_2px += o.within_2px;
        self.unflagged += o.unflagged;
        self.good += o.good;
        self.undamaged += o.undamaged;
        self.square_px2 += o.square_px2;
        self.seconds += o.seconds;
        self
    }

    fn share(&self) -> f64 {
        self.within_2px as f64 / self.marks.max(1) as f64
    }

    fn rmse_px(&self) -> f64 {
        (self.square_px2 / self.undamaged.max(1) as f64).sqrt()
    }
}

fn score(scene: &FilmScene, found: &FrameResult) -> Tally {
    let mut t =
        Tally { frames: 1, frames_ok: usize::from(found.is_ok()), seconds: found.elapsed_s, ..Tally::default() };
    for truth in &scene.truth().marks {
        let mark = found.marks.iter().find(|m| m.mark == truth.mark).expect("every mark is reported");
        let error = mark.centre.map(|c| (c.x - truth.x).hypot(c.y - truth.y));
        let good = mark.status == MarkStatus::Ok;
        t.good += usize::from(good);
        t.unflagged += usize::from(good && error.is_none_or(|e| e > 5.0));
        if truth.complete {
            t.marks += 1;
            t.within_2px += usize::from(error.is_some_and(|e| e <= 2.0));
        }
        if truth.complete && !truth.damaged && good {
            t.undamaged += 1;
            t.square_px2 += error.unwrap_or(0.0).powi(2);
        }
        if std::env::var_os("AUTOREF_FILM_VERBOSE").is_some()
            && (error.is_none_or(|e| e > 2.0) || (!good && truth.complete))
        {
            println!(
                "{} {} complete {} damaged {} hole {:?} gain {:.2} error {error:?} score {:?} {:?} {:?} | q {} m {} {:?}",
                found.name,
                truth.mark,
                truth.complete,
                truth.damaged,
                truth.hole_contrast,
                scene.truth().gain,
                mark.score,
                mark.status,
                mark.reason,
                scene.truth().quarters,
                scene.truth().mirrored,
                found.notes
            );
        }
    }
    t
}

fn trial(camera: &str, pixel_um: f64, frames: u64, turned: bool) -> Tally {
    let camera = load_camera(camera).expect("built in");
    let finder = Finder::new(&camera).expect("drawn shapes");
    let ground = ground();
    let all: Vec<Tally> = (0..frames)
        .into_par_iter()
        .map(|seed| {
            let mut spec = FilmSpec::archive(&camera, pixel_um, seed);
            if turned {
                spec.quarters = (seed / 3 % 4) as u8;
                spec.mirrored = seed % 5 == 4;
            }
            let scene = FilmScene::new(&spec, &ground).expect("drawable");
            let found = finder.find(&scene as &dyn RasterSource, &FindOptions::default()).expect("in memory");
            score(&scene, &found)
        })
        .collect();
    let sum = all.into_iter().fold(Tally::default(), Tally::add);
    println!(
        "{}: {} frames ({} OK), {} marks, {:.3} % within 2 px, RMSE {:.3} px on {} undamaged, {} unflagged over 5 px, {} of {} passed",
        camera.name,
        sum.frames,
        sum.frames_ok,
        sum.marks,
        100.0 * sum.share(),
        sum.rmse_px(),
        sum.undamaged,
        sum.unflagged,
        sum.good,
        sum.marks
    );
    sum
}

#[test]
fn svalbard_marks_are_found_and_no_gross_error_is_passed() {
    let (pixel_um, frames) = if large() { (20.0, 1_260) } else { (27.0, 16) };
    let frames = std::env::var("AUTOREF_FILM_FRAMES").ok().and_then(|n| n.parse().ok()).unwrap_or(frames);
    let pixel_um = std::env::var("AUTOREF_FILM_UM").ok().and_then(|n| n.parse().ok()).unwrap_or(pixel_um);
    let t = trial("svalbard-zeiss-1936", pixel_um, frames, true);
    assert_eq!(t.unflagged, 0);
    assert!(t.share() >= 0.999 || t.marks - t.within_2px <= usize::from(!large()), "{t:?}");
    assert!(t.rmse_px() <= 0.3, "{t:?}");
}
