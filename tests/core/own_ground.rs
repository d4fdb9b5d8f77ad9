//! Marks on ground that the profile takes for paint in less light.

use crate::common::tiles::{find, memory};
use autoref_raster::RasterSource;
use autoref_raster::coords::PixelPoint;
use autoref_stream::candidate::Candidate;
use autoref_stream::pipeline::PaintDetector;
use autoref_stream::profile::Profile;
use autoref_stream::rematch::{Expected, Refinement, rematch};
use autoref_synth::plant::{Picture, Random};

const SIZE: usize = 400;
/// Pixels along a side, and centres: away from tile faces, on them, on a corner of four.
const SIDE: f64 = 12.0;
const PLACES: [(f64, f64); 6] =
    [(60.3, 50.7), (128.4, 90.2), (300.0, 63.5), (128.1, 256.3), (255.6, 255.9), (340.25, 330.5)];

/// Uneven ground with squares of a paint, each pixel mixed by the share that the square covers.
fn field(ground: [f64; 3], paint: [f64; 3], random: &mut Random) -> Picture {
    let share = |from: f64, to: f64, at: usize| (to.min(at as f64 + 1.0) - from.max(at as f64)).clamp(0.0, 1.0);
    let rgb = (0..SIZE * SIZE).map(|i| {
        let (x, y) = (i % SIZE, i / SIZE);
        let of =
            |(u, v): (f64, f64)| share(u - SIDE / 2.0, u + SIDE / 2.0, x) * share(v - SIDE / 2.0, v + SIDE / 2.0, y);
        let cover = PLACES.into_iter().map(of).fold(0.0, f64::max);
        let light = 1.0 + 0.01 * random.gauss();
        std::array::from_fn(|c| (light * (ground[c] + cover * (paint[c] - ground[c]))).clamp(0.0, 255.0).round() as u8)
    });
    Picture { width: SIZE, height: SIZE, rgb: rgb.collect() }
}

/// The whole picture is paint to the profile; the marks are its bright part, each found once, whatever the tiling.
#[test]
fn bright_paint_on_ground_of_its_own_colour_is_found() {
    for (profile, ground, paint) in [
        ("ral-6018", [60.0, 112.0, 45.0], [87.0, 166.0, 57.0]),
        ("white", [193.0, 193.0, 191.0], [243.0, 244.0, 243.0]),
        ("orange", [165.0, 75.0, 28.0], [250.0, 108.0, 24.0]),
    ] {
        let source = memory(&field(ground, paint, &mut Random(17)));
        let profile = Profile::builtin(profile).expect("shipped");
        let whole = find(&source, &profile, 1000, 1);
        assert_eq!(whole.len(), PLACES.len(), "{}: {whole:?}", profile.name);
        for (x, y) in PLACES {
            let error = |c: &Candidate| (c.centre.x - x).hypot(c.centre.y - y);
            assert!(whole.iter().any(|c| error(c) < 0.1), "{} at {x}, {y}: {whole:?}", profile.name);
        }
        for (tile, threads) in [(64, 2), (128, 2), (150, 3)] {
            assert_eq!(whole, find(&source, &profile, tile, threads), "{}, tile {tile}", profile.name);
        }
    }
}

/// Where a mark is expected its window shows it too, on such ground as on other.
#[test]
fn windows_show_bright_paint_on_ground_of_its_own_colour() {
    let source = memory(&field([60.0, 112.0, 45.0], [87.0, 166.0, 57.0], &mut Random(23)));
    let profile = Profile::builtin("ral-6018").expect("shipped");
    let detector = PaintDetector::new(profile, source.info(), None).expect("sizes in pixels").relaxed();
    let expect = |(gcp, (x, y)): (usize, &(f64, f64))| Expected {
        gcp,
        position: PixelPoint { x: x + 2.0, y: y - 1.5 },
        radius_px: 6.0,
    };
    let expected: Vec<Expected> = PLACES.iter().enumerate().map(expect).collect();
    let answers = rematch(&source, &detector, &[], &[], &expected).expect("memory");
    for ((x, y), answer) in PLACES.iter().zip(answers) {
        let Refinement::Found(mark) = answer else { panic!("{x}, {y}: {answer:?}") };
        assert!((mark.centre.x - x).hypot(mark.centre.y - y) < 0.1, "{x}, {y}: {mark:?}");
    }
}

/// What the whole profile finds by itself is found once, by the same numbers as without a look at the bright part.
#[test]
fn marks_on_other_ground_are_found_once() {
    for (profile, paint) in [("white", [243.0, 244.0, 243.0]), ("orange", [250.0, 108.0, 24.0])] {
        let source = memory(&field([92.0, 90.0, 84.0], paint, &mut Random(5)));
        let found = find(&source, &Profile::builtin(profile).expect("shipped"), 100, 2);
        assert_eq!(found.len(), PLACES.len(), "{profile}: {found:?}");
    }
}
