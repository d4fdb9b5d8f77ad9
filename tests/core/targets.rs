//! Black and white targets found by their shape: real plates in photographs, planted ones, any tiling.

use crate::common::tiles::{find, memory};
use crate::drawn_targets::{Kind, middle, photo, plant_targets};
use autoref_raster::{self as raster, RasterSource, ReaderChoice};
use autoref_stream::candidate::Candidate;
use autoref_stream::profile::Profile;
use autoref_synth::plant::{Picture, Random};

fn builtin(name: &str) -> Profile {
    Profile::builtin(name).expect("shipped")
}

/// The plates of the list, whose row gcp04 in IMG_0031 lies on gcp00's plate and is wrong, and one more in IMG_0064
/// that the list does not have. Nothing else: no bush, no footprint, not the orange kite line.
#[test]
fn cross_plates_in_real_photographs_are_found_and_nothing_else() {
    let listed = [
        ("IMG_0031", vec![(730.48, 1019.94), (3484.09, 729.32)], 2),
        ("IMG_0046", vec![(2040.33, 1016.06), (3516.51, 2142.26)], 2),
        ("IMG_0064", vec![(1521.60, 1229.56)], 2),
    ];
    for (name, centres, plates) in listed {
        let Some(path) = crate::common::data(&format!("targets/{name}.jpg")) else { return };
        let source = raster::open(&path, ReaderChoice::Auto, 0, 64 << 20).expect("a photograph");
        let found = find(source.as_ref(), &builtin("black-white-cross"), 1024, 2);
        for (x, y) in centres {
            let error = |c: &Candidate| (c.centre.x - x).hypot(c.centre.y - y);
            let best = found.iter().min_by(|a, b| error(a).total_cmp(&error(b))).expect("some");
            assert!(error(best) < 3.0, "{name}: the plate at {x},{y} is {:.2} px off", error(best));
            assert!(best.size_px.is_some_and(|s| (90.0..230.0).contains(&s[0])), "{best:?}");
        }
        assert_eq!(found.len(), plates, "{name}: {found:?}");
    }
}

/// Planted checkers, hourglasses and crosses: found, centred with honest covariances, little else on ordinary ground.
#[test]
fn planted_targets_are_found_and_centred() {
    for (kind, profile, recall) in [
        (Kind::Checker, "black-white-checker", 0.98),
        (Kind::Hourglass, "black-white-hourglass", 0.90),
        (Kind::Cross, "black-white-cross", 0.97),
        (Kind::FifthArm, "black-white-cross", 0.95),
    ] {
        let (mut planted, mut hits, mut squares, mut normalised) = (0, 0, 0.0, Vec::new());
        let side = if kind == Kind::FifthArm || crate::common::large() { 800 } else { 600 };
        for (number, cover) in ["photos/construction_caliterra.jpg", "photos/savanna_oam.tif"].iter().enumerate() {
            let Some(picture) = photo(cover) else { return };
            let mut random = Random(11 + number as u64);
            let (picture, truth) = plant_targets(&middle(&picture, side), kind, None, &mut random);
            let found = find(&memory(&picture), &builtin(profile), 512, 2);
            planted += truth.len();
            for (x, y) in &truth {
                let error = |c: &Candidate| (c.centre.x - x).hypot(c.centre.y - y);
                let Some(best) = found.iter().filter(|c| error(c) < 2.0).min_by(|a, b| error(a).total_cmp(&error(b)))
                else {
                    continue;
                };
                hits += 1;
                squares += error(best).powi(2);
                let v = best.covariance_px2.expect("fitted");
                normalised.extend([(best.centre.x - x) / v[0].sqrt(), (best.centre.y - y) / v[2].sqrt()]);
            }
            // A hundred touching corners of targets are no ground; what is left is.
            assert!(found.len() <= truth.len() + truth.len() / 5, "{profile}: {} found", found.len());
        }
        let rmse = (squares / (2.0 * f64::from(hits))).sqrt();
        let z2 = normalised.iter().map(|z| z * z).sum::<f64>() / normalised.len() as f64;
        println!("{kind:?}: {hits} of {planted}, RMSE {rmse:.3} px, normalised variance {z2:.2}");
        assert!(f64::from(hits) >= recall * planted as f64, "{kind:?}: {hits} of {planted}");
        assert!(rmse < 0.1, "{kind:?}: RMSE {rmse}");
        assert!((0.5..2.0).contains(&z2), "{kind:?}: {z2}");
    }
}

#[test]
fn ordinary_ground_gives_few_targets() {
    let covers = ["photos/river_town_oam.tif", "photos/forest_agung.jpg", "photos/construction_caliterra.jpg"];
    for cover in &covers[..if crate::common::large() { 3 } else { 2 }] {
        let Some(picture) = photo(cover) else { return };
        let source = memory(&middle(&picture, if crate::common::large() { 1500 } else { 500 }));
        let megapixels = source.info().pixels() as f64 / 1e6;
        for profile in ["black-white-checker", "black-white-hourglass", "black-white-cross"] {
            let rate = find(&source, &builtin(profile), 1024, 2).len() as f64 / megapixels;
            println!("{cover} {profile}: {rate:.2} per megapixel");
            assert!(rate <= 2.0, "{cover} {profile}: {rate:.2}");
        }
    }
}

#[test]
fn no_tiling_changes_a_target() {
    // Without photographs: stripes and noise as ground.
    let mut random = Random(5);
    let (width, height) = (420, 340);
    let rgb = (0..width * height).map(|i| {
        let stripe = if (i % width + i / (2 * width)) % 23 < 7 { 90.0 } else { 140.0 };
        [(stripe + 8.0 * random.gauss()) as u8; 3]
    });
    let ground = Picture { width, height, rgb: rgb.collect() };
    let kinds = [
        (Kind::Checker, "black-white-checker", None),
        (Kind::Cross, "black-white-cross", None),
        (Kind::FifthArm, "black-white-cross", Some(50.0)),
    ];
    for (kind, profile, side) in kinds {
        let (picture, truth) = plant_targets(&ground, kind, side, &mut Random(3));
        let source = memory(&picture);
        let whole = find(&source, &builtin(profile), 4000, 1);
        assert!(whole.len() * 10 >= truth.len() * 8, "{profile}: {} of {}", whole.len(), truth.len());
        for (tile, threads) in [(64, 2), (150, 3)] {
            assert_eq!(whole, find(&source, &builtin(profile), tile, threads), "{profile}, tile {tile}");
        }
    }
}

/// Pictures of nothing, smaller than a target, or with a target on the edge: an answer, never a panic.
#[test]
fn edges_and_emptiness_are_answered() {
    for profile in ["black-white-checker", "black-white-hourglass", "black-white-cross"] {
        for (width, height) in [(1, 1), (3, 200), (9, 9), (40, 40)] {
            let picture = Picture { width, height, rgb: vec![[0; 3]; width * height] };
            assert!(find(&memory(&picture), &builtin(profile), 64, 1).is_empty());
            let rgb = (0..width * height).map(|i| [if (i % width > 8) == (i / width > 8) { 230 } else { 20 }; 3]);
            let picture = Picture { width, height, rgb: rgb.collect() };
            for c in find(&memory(&picture), &builtin(profile), 64, 1) {
                assert!(c.centre.x.is_finite() && c.covariance_px2.is_some_and(|v| v[0] > 0.0));
            }
        }
        let mut tiny = builtin(profile);
        tiny.size = autoref_stream::profile::Size { min_px: Some(1.0), max_px: Some(2.0), min_m: None, max_m: None };
        let source = memory(&Picture { width: 30, height: 30, rgb: vec![[200, 10, 10]; 900] });
        assert!(find(&source, &tiny, 16, 1).is_empty());
    }
}
