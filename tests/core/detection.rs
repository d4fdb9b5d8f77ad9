//! Detection on real photographs with planted marks: the always-on, small twin of `benches/detection.rs`.

use crate::scan::Detector;
use autoref_raster::coords::PixelPoint;
use autoref_raster::mask::Mask;
use autoref_raster::window::Window;
use autoref_raster::{Patch, SampleType};
use autoref_stream::candidate::evidence::GroundSeen;
use autoref_stream::candidate::examine::measure;
use autoref_stream::candidate::{Gates, examine};
use autoref_stream::learn::learn;
use autoref_stream::profile::Profile;
use autoref_stream::segment::classify::Classifier;
use autoref_synth::plant::{Cell, Picture, Random, paint_mark, plant};

fn photo(name: &str) -> Option<Picture> {
    let path = format!("{}/../shared/data/photos/{name}", crate::common::root().display());
    let Ok(file) = gdal::Dataset::open(&path) else {
        crate::common::skipped(format!("{path} is absent"));
        return None;
    };
    let (width, height) = file.raster_size();
    let band = |b: usize| {
        let band = file.rasterband(b).expect("three bands");
        band.read_as::<u8>((0, 0), (width, height), (width, height), None).expect("a whole photograph").data().to_vec()
    };
    let bands = [band(1), band(2), band(3)];
    let rgb = (0..width * height).map(|i| [bands[0][i], bands[1][i], bands[2][i]]).collect();
    Some(Picture { width, height, rgb })
}

fn patch(picture: &Picture, x: f64, y: f64, reach_px: u64) -> Patch {
    let bounds = Window::whole(picture.width as u64, picture.height as u64);
    let window = Window::new(x as u64, y as u64, 1, 1).grown(reach_px, &bounds);
    let cut = picture.crop(window.x as usize, window.y as usize, window.width as usize, window.height as usize);
    let rgb: Vec<[u16; 3]> = cut.rgb.iter().map(|c| c.map(u16::from)).collect();
    Patch { window, valid: vec![true; rgb.len()], rgb, white: 255 }
}

fn orange() -> Detector {
    Detector::new(Profile::builtin("orange").expect("shipped"))
}

#[test]
fn planted_marks_are_found_and_centred() {
    let detector = orange();
    for (side_px, least_recall, most_rmse, most_median) in [(6.0, 0.95, 0.12, 0.052), (10.0, 0.985, 0.09, 0.035)] {
        let (mut marks, mut errors, mut normalised) = (0, Vec::new(), Vec::new());
        for (seed, name) in ["city_ochota_3013.jpg", "savanna_oam.tif", "forest_agung.jpg"].iter().enumerate() {
            let Some(full) = photo(name) else { return };
            let cell = Cell { label: (*name).into(), side_px, ..Cell::base() };
            let (picture, truth) = plant(&full.crop(200, 200, 500, 500), &cell, &mut Random(11 + seed as u64));
            println!("{}: {} marks of {side_px} px", cell.label, truth.len());
            let found = detector.list(&picture);
            marks += truth.len();
            for (x, y) in truth {
                let error = |c: &autoref_stream::candidate::Candidate| (c.centre.x - x).hypot(c.centre.y - y);
                let Some(best) = found.iter().min_by(|a, b| error(a).total_cmp(&error(b))) else { continue };
                if error(best) < side_px / 2.0 {
                    let v = best.covariance_px2.expect("examined");
                    errors.extend([best.centre.x - x, best.centre.y - y]);
                    normalised.extend([(best.centre.x - x) / v[0].sqrt(), (best.centre.y - y) / v[2].sqrt()]);
                }
            }
        }
        let recall = errors.len() as f64 / 2.0 / marks as f64;
        let rms = |v: &[f64]| (v.iter().map(|e| e * e).sum::<f64>() / v.len() as f64).sqrt();
        let bias = errors.iter().sum::<f64>() / errors.len() as f64;
        let mut absolute: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
        absolute.sort_by(f64::total_cmp);
        let median = absolute[absolute.len() / 2];
        println!(
            "{side_px} px: {marks} marks, recall {recall:.3}, RMSE {:.3}, median {median:.3}, bias {bias:.4}, normalised {:.2}",
            rms(&errors),
            rms(&normalised)
        );
        assert!(recall >= least_recall, "{side_px} px: recall {recall}");
        assert!(rms(&errors) <= most_rmse && median <= most_median && bias.abs() <= 0.02);
        assert!((0.8..1.25).contains(&rms(&normalised)), "{side_px} px: normalised errors {}", rms(&normalised));
    }
}

/// Four grounds that differ more from each other than any does from itself meet under each mark: one Gaussian over all
/// of them hides it. Larger marks lie on such places more often.
#[test]
fn marks_where_grounds_meet_are_found() {
    let detector = orange();
    let grounds = [[225, 225, 215], [28, 52, 30], [70, 150, 140], [130, 98, 70]];
    let mut random = Random(77);
    let (side, cells) = (90usize, 5usize);
    let noisy =
        |c: [u8; 3], r: &mut Random| c.map(|v| (f64::from(v) + 4.0 * r.gauss()).round().clamp(0.0, 255.0) as u8);
    for side_px in [10.0, 20.0, 30.0] {
        let size = side * cells;
        let quarter =
            |i: usize| usize::from(i % size % side >= side / 2) + 2 * usize::from(i / size % side >= side / 2);
        let rgb = (0..size * size).map(|i| noisy(grounds[quarter(i)], &mut random)).collect();
        let mut picture = Picture { width: size, height: size, rgb };
        let cell = Cell { side_px, ..Cell::base() };
        let corner = |k: usize| k * side + side / 2 - cell.window_px() / 2;
        let truth: Vec<_> = (0..cells * cells)
            .map(|k| paint_mark(&mut picture, &cell, (corner(k % cells), corner(k / cells)), &mut random))
            .collect();
        let picture = picture.through_jpeg(90);
        let found = detector.list(&picture);
        let mut local = 0;
        for region in detector.regions(&picture).iter().filter(|r| detector.gates.region(r)) {
            let patch = detector.patch(&picture, region);
            let seen = measure(region, &patch, &detector.classifier, &detector.profile, &detector.gates);
            local += usize::from(seen.is_some_and(|e| e.ground == GroundSeen::Local));
        }
        let near = |t: &(f64, f64)| found.iter().filter(|c| (c.centre.x - t.0).hypot(c.centre.y - t.1) < 0.4).count();
        let hit = truth.iter().filter(|t| near(t) == 1).count();
        println!("{side_px} px: {hit} of {} found once, {local} regions looked at against local ground", truth.len());
        assert!(hit + 1 >= truth.len(), "{side_px} px: {hit} of {}", truth.len());
        assert!(local * 2 > truth.len(), "the picture does not ask for the look at local ground: {local}");
    }
}

/// Paints at the rim of the colour model are found by a few of their pixels and grown over the rest.
#[test]
fn marks_found_in_part_are_grown() {
    let detector = orange();
    for (k, paint) in [[240, 130, 50], [255, 121, 0]].into_iter().enumerate() {
        let (mut marks, mut hit) = (0, 0);
        for (seed, name) in ["city_ochota_3019.jpg", "construction_caliterra.jpg", "savanna_oam.tif"].iter().enumerate()
        {
            let Some(full) = photo(name) else { return };
            let cell = Cell { paint, ..Cell::base() };
            let (picture, truth) =
                plant(&full.crop(700, 900, 450, 450), &cell, &mut Random((31 + 7 * seed + k) as u64));
            let found = detector.list(&picture);
            let near =
                |t: &(f64, f64)| found.iter().filter(|c| (c.centre.x - t.0).hypot(c.centre.y - t.1) < 2.0).count();
            marks += truth.len();
            hit += truth.iter().filter(|t| near(t) == 1).count();
        }
        println!("{paint:?}: {hit} of {marks}");
        assert!(hit as f64 >= 0.985 * marks as f64, "{paint:?}: {hit} of {marks} found once");
    }
}

#[test]
fn real_ground_gives_few_false_candidates() {
    let detector = orange();
    for name in ["city_ochota_3013.jpg", "construction_caliterra.jpg", "savanna_oam.tif", "river_town_oam.tif"] {
        let Some(full) = photo(name) else { return };
        let found = detector.list(&full).len() as f64;
        let rate = found / (full.width * full.height) as f64 * 1e6;
        assert!(rate <= 1.0, "{name}: {rate:.2} false candidates per megapixel");
    }
}

#[test]
fn a_profile_taught_by_five_marks_finds_the_others() {
    let Some(full) = photo("construction_caliterra.jpg") else { return };
    // A paint that no shipped profile knows.
    let cell = Cell { paint: [120, 40, 200], side_px: 12.0, ..Cell::base() };
    let (picture, truth) = plant(&full.crop(1000, 1000, 500, 500), &cell, &mut Random(5));
    let marks: Vec<_> = truth.iter().take(5).map(|&(x, y)| (patch(&picture, x, y, 30), PixelPoint { x, y })).collect();
    let profile = learn("violet", &marks).expect("they stand out");
    let stats = profile.learned.clone().expect("statistics");
    assert!((stats.side_px_median - 12.0).abs() < 1.5, "{stats:?}");
    let found = Detector::new(profile).list(&picture);
    let hit = truth.iter().filter(|t| found.iter().any(|c| (c.centre.x - t.0).hypot(c.centre.y - t.1) < 1.0)).count();
    assert!(hit as f64 >= 0.97 * truth.len() as f64, "{hit} of {}", truth.len());
    assert!(found.len() <= truth.len() + 1, "{} candidates for {} marks", found.len(), truth.len());
    // Ground itself does not stand out.
    let bare = vec![(patch(&full, 30.0, 30.0, 30), PixelPoint { x: 30.5, y: 30.5 })];
    assert!(learn("bare", &bare).is_err());
    assert!(learn("none", &[]).is_err());
}

/// 11 bits of a camera in 16 of a file: what helps is said.
#[test]
fn a_mark_in_few_of_the_bits_is_refused_with_its_white() {
    let of = |white: u16| {
        let window = autoref_raster::window::Window::whole(61, 61);
        let colour = |i: u64| match (i % 61).abs_diff(30) < 6 && (i / 61).abs_diff(30) < 6 {
            true => [1900, 700, 200],
            false => [0u64, 7, 13].map(|band| 600 + ((i * 7919 + band * 31) % 83) as u16),
        };
        let patch =
            autoref_raster::Patch { window, rgb: (0..3721).map(colour).collect(), valid: vec![true; 3721], white };
        learn("few", &[(patch, PixelPoint { x: 30.5, y: 30.5 })])
    };
    let said = of(65_535).expect_err("it does not stand out").to_string();
    assert!(said.contains("does not stand out"), "{said}");
    assert!(said.contains("is 1900 of 65535") && said.contains("give --white 4095"), "{said}");
    assert!(of(2047).is_ok());
}

/// Marks cut by the image's edge, images of nothing, one colour everywhere: an answer, never a panic.
#[test]
fn edges_and_emptiness_are_answered() {
    let profile = Profile::builtin("orange").expect("shipped");
    let classifier = Classifier::new(&profile, SampleType::U8, 255, [0, 1, 2], None, None).expect("valid");
    let gates = Gates::new(&profile, None).expect("pixels");
    let mut found = 0;
    for (width, height, side, ground) in [(40, 40, 10, 90u8), (12, 12, 10, 90), (10, 10, 10, 90), (3, 60, 3, 0)] {
        let mut rgb = vec![[ground; 3]; width * height];
        for (y, x) in (0..side.min(height)).flat_map(|y| (0..side.min(width)).map(move |x| (y, x))) {
            rgb[y * width + x] = [250, 108, 20];
        }
        let picture = Picture { width, height, rgb };
        let mut mask = Mask::new(Window::whole(width as u64, height as u64));
        for (i, c) in picture.rgb.iter().enumerate() {
            mask.set((i % width) as u64, (i / width) as u64, classifier.is_paint(*c));
        }
        for region in crate::scan::label(&mask) {
            let mut seen = patch(&picture, 0.0, 0.0, 100);
            let candidate = examine(&region, &seen, &classifier, &profile, &gates);
            if let Some(c) = candidate {
                found += 1;
                assert!(c.centre.x.is_finite() && c.centre.y.is_finite());
                assert!(c.covariance_px2.is_some_and(|v| v[0] > 0.0 && v[2] > 0.0));
            }
            seen.valid.fill(false);
            assert!(examine(&region, &seen, &classifier, &profile, &gates).is_none());
        }
    }
    assert!(found >= 1, "the mark in the corner of the largest picture is whole");
    assert!(Detector::new(profile).list(&Picture { width: 1, height: 1, rgb: vec![[255, 110, 20]] }).is_empty());
}
