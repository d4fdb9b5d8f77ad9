//! Coded targets: read, centred, never misread, whatever the tiling; and what their names do for matching.

use crate::common::tiles::{find, memory};
use crate::drawn_targets::{middle, photo};
use autoref_raster::RasterSource;
use autoref_stream::candidate::Candidate;
use autoref_stream::profile::Family;
use autoref_stream::profile::Profile;
use autoref_synth::plant::{Picture, Random, blurred};
use locus_core::TagFamily;
use locus_core::bench_api::family_to_decoder;

const FAMILIES: [(Family, TagFamily); 6] = [
    (Family::Apriltag36h11, TagFamily::AprilTag36h11),
    (Family::Apriltag16h5, TagFamily::AprilTag16h5),
    (Family::Aruco4x4x50, TagFamily::ArUco4x4_50),
    (Family::Aruco4x4x100, TagFamily::ArUco4x4_100),
    (Family::Aruco6x6x250, TagFamily::ArUco6x6_250),
    (Family::ArucoMip36h12, TagFamily::ArUcoMip36h12),
];

fn builtin(family: Family) -> Profile {
    Profile::builtin(family.name()).expect("shipped")
}

/// A tag to draw: its pattern from the published table, how it lies, and how much of the ground shines through.
struct Drawn {
    family: (Family, TagFamily),
    number: u16,
    centre: (f64, f64),
    module_px: f64,
    angle: f64,
    blur_px: f64,
    fading: f64,
    light: f64,
}

impl Drawn {
    /// White at (u, v) modules from the middle; `None` outside the quiet zone of one module.
    fn white(&self, code: u64, u: f64, v: f64) -> Option<bool> {
        let n = self.family.0.modules() as f64;
        let (i, j) = ((u + n / 2.0).floor(), (v + n / 2.0).floor());
        if i < -1.0 || j < -1.0 || i > n || j > n {
            return None;
        }
        if i < 0.0 || j < 0.0 || i >= n || j >= n {
            return Some(true);
        }
        let inside = (1.0..n - 1.0).contains(&i) && (1.0..n - 1.0).contains(&j);
        Some(inside && code >> ((j as usize - 1) * (n as usize - 2) + i as usize - 1) & 1 == 1)
    }

    fn draw(&self, picture: &mut Picture, random: &mut Random) {
        let code = family_to_decoder(self.family.1).get_code(self.number).expect("a number of the family");
        let side = (self.family.0.modules() as f64 + 2.0) * self.module_px;
        let size = (1.5 * side + 8.0 * self.blur_px).ceil() as usize + 4;
        let (x0, y0) = (self.centre.0.floor() as i64 - size as i64 / 2, self.centre.1.floor() as i64 - size as i64 / 2);
        let (sin, cos) = self.angle.sin_cos();
        let (cx, cy) = (self.centre.0 - x0 as f64, self.centre.1 - y0 as f64);
        let at = |x: f64, y: f64| {
            let (dx, dy) = ((x - cx) / self.module_px, (y - cy) / self.module_px);
            self.white(code, cos * dx + sin * dy, cos * dy - sin * dx)
        };
        let covered = blurred(size, self.blur_px, |x, y| f64::from(u8::from(at(x, y).is_some())));
        let white = blurred(size, self.blur_px, |x, y| f64::from(u8::from(at(x, y) == Some(true))));
        for i in 0..size * size {
            let (x, y) = (x0 + (i % size) as i64, y0 + (i / size) as i64);
            let inside = x >= 0 && y >= 0 && x < picture.width as i64 && y < picture.height as i64;
            if covered[i] < 1e-4 || !inside {
                continue;
            }
            let pixel = &mut picture.rgb[y as usize * picture.width + x as usize];
            for c in pixel {
                let own = self.light * (28.0 * (covered[i] - white[i]) + 225.0 * white[i]);
                let ground = f64::from(*c);
                let mixed = (1.0 - self.fading) * own + (1.0 - (1.0 - self.fading) * covered[i]) * ground;
                *c = (mixed + 1.5 * random.gauss() * covered[i]).round().clamp(0.0, 255.0) as u8;
            }
        }
    }
}

/// A tag in each square of a grid, any number and rotation, blur 0.9, up to a fifth of the ground through, JPEG 90.
fn plant_tags(
    ground: &Picture,
    family: (Family, TagFamily),
    module_px: f64,
    random: &mut Random,
) -> (Picture, Vec<Drawn>) {
    let mut out = ground.clone();
    let mut truth = Vec::new();
    let pitch = ((family.0.modules() as f64 + 2.0) * module_px * 1.5) as usize + 24;
    let numbers = family.1.max_id_count() as f64;
    for gy in (0..(ground.height + 1).saturating_sub(pitch)).step_by(pitch) {
        for gx in (0..(ground.width + 1).saturating_sub(pitch)).step_by(pitch) {
            let mut place = |v: usize| v as f64 + pitch as f64 / 2.0 + 8.0 * (random.unit() - 0.5);
            let centre = (place(gx), place(gy));
            let tag = Drawn {
                family,
                number: (random.unit() * numbers) as u16,
                centre,
                module_px,
                angle: random.unit() * std::f64::consts::TAU,
                blur_px: 0.9,
                fading: 0.2 * random.unit(),
                light: 0.6 + 0.4 * random.unit(),
            };
            tag.draw(&mut out, random);
            truth.push(tag);
        }
    }
    (out.through_jpeg(90), truth)
}

/// What became of planted tags.
#[derive(Default)]
struct Tally {
    planted: usize,
    read: usize,
    misread: usize,
    false_candidates: usize,
    /// Errors of the centres in x and y, pixels, and over their standard deviations.
    errors: Vec<f64>,
    normalised: Vec<f64>,
    scores: Vec<f64>,
}

impl Tally {
    fn count(&mut self, found: &[Candidate], truth: &[Drawn]) {
        self.planted += truth.len();
        let error = |c: &Candidate, t: &Drawn| (c.centre.x - t.centre.0).hypot(c.centre.y - t.centre.1);
        for tag in truth {
            let side = tag.module_px * tag.family.0.modules() as f64;
            let Some(best) = found
                .iter()
                .filter(|c| error(c, tag) < side / 3.0)
                .min_by(|a, b| error(a, tag).total_cmp(&error(b, tag)))
            else {
                continue;
            };
            if best.code.as_ref().is_none_or(|code| code.number != u32::from(tag.number)) {
                self.misread += 1;
                continue;
            }
            self.read += 1;
            let (dx, dy) = (best.centre.x - tag.centre.0, best.centre.y - tag.centre.1);
            let v = best.covariance_px2.expect("fitted");
            self.errors.extend([dx, dy]);
            self.normalised.extend([dx / v[0].sqrt(), dy / v[2].sqrt()]);
            self.scores.push(best.score.expect("scored"));
        }
        let far = |c: &&Candidate| truth.iter().all(|t| error(c, t) > t.module_px * t.family.0.modules() as f64 / 3.0);
        self.false_candidates += found.iter().filter(far).count();
    }

    fn rms(values: &[f64]) -> f64 {
        (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
    }

    fn recall(&self) -> f64 {
        self.read as f64 / self.planted as f64
    }

    fn print(&self, what: &str) {
        let worst = self.scores.iter().copied().fold(f64::INFINITY, f64::min);
        let mut lengths: Vec<f64> = self.errors.iter().map(|e| e.abs()).collect();
        lengths.sort_by(f64::total_cmp);
        println!(
            "{what}: {} of {} read ({:.2} %), {} misread, {} false; per axis RMSE {:.3}, largest {:.2} px; \
             normalised variance {:.2}; least score {worst:.1}",
            self.read,
            self.planted,
            100.0 * self.recall(),
            self.misread,
            self.false_candidates,
            Self::rms(&self.errors),
            lengths.last().copied().unwrap_or(0.0),
            Self::rms(&self.normalised).powi(2),
        );
    }
}

const GROUNDS: [&str; 4] = [
    "photos/construction_caliterra.jpg",
    "photos/savanna_oam.tif",
    "photos/river_town_oam.tif",
    "photos/city_ochota_3013.jpg",
];

/// Recall, numbers, centres and covariances, over photographs. Every number that is read is right.
#[test]
fn planted_tags_are_read_and_centred() {
    let (grounds, side, families): (&[&str], usize, &[_]) =
        if crate::common::large() { (&GROUNDS, 800, &FAMILIES) } else { (&GROUNDS[..2], 400, &FAMILIES[1..2]) };
    let sizes: &[(f64, f64)] = if crate::common::large() {
        &[(3.0, 0.95), (4.0, 0.97), (6.0, 0.97), (10.0, 0.97)]
    } else {
        &[(3.0, 0.95), (6.0, 0.97)]
    };
    let mut normalised = Vec::new();
    for &family in families {
        for &(module_px, recall) in sizes {
            let mut tally = Tally::default();
            for (i, ground) in grounds.iter().enumerate() {
                let Some(picture) = photo(ground) else { return };
                let mut random = Random(31 + i as u64);
                let (picture, truth) = plant_tags(&middle(&picture, side), family, module_px, &mut random);
                tally.count(&find(&memory(&picture), &builtin(family.0), 512, 2), &truth);
            }
            tally.print(&format!("{} at {module_px} px a module", family.0.name()));
            assert_eq!(tally.misread, 0);
            assert!(tally.recall() >= recall, "{}", tally.recall());
            if module_px >= 4.0 {
                assert!(Tally::rms(&tally.errors) < 0.1);
            }
            normalised.extend(tally.normalised);
        }
    }
    let variance = Tally::rms(&normalised).powi(2);
    println!("normalised variance over all: {variance:.2}");
    assert!((0.3..3.0).contains(&variance), "{variance}");
}

/// Ground without tags gives none, or next to none, of any family.
#[test]
fn ordinary_ground_bears_no_numbers() {
    let (grounds, side, families): (&[&str], usize, &[_]) =
        if crate::common::large() { (&GROUNDS, 3000, &FAMILIES) } else { (&GROUNDS[2..], 700, &FAMILIES[1..3]) };
    for &(family, _) in families {
        let (mut found, mut megapixels) = (0, 0.0);
        for ground in grounds {
            let Some(picture) = photo(ground) else { return };
            let source = memory(&middle(&picture, side));
            megapixels += source.info().pixels() as f64 / 1e6;
            let list = find(&source, &builtin(family), 1024, 2);
            list.iter().for_each(|c| println!("{ground}: {c:?}"));
            found += list.len();
        }
        println!("{}: {found} on {megapixels:.1} megapixels", family.name());
        assert!(found as f64 <= (0.2 * megapixels).max(1.0));
    }
}

/// Stripes and noise: ground that needs no photograph.
fn stripes(width: usize, height: usize) -> Picture {
    let mut random = Random(5);
    let rgb = (0..width * height).map(|i| {
        let stripe = if (i % width + i / (2 * width)) % 23 < 7 { 90.0 } else { 140.0 };
        [(stripe + 8.0 * random.gauss()) as u8; 3]
    });
    Picture { width, height, rgb: rgb.collect() }
}

/// The list of candidates as bytes, so that not even the last bit of a number may differ.
fn bytes(list: &[Candidate]) -> Vec<u8> {
    let mut out = Vec::new();
    autoref_stream::georef::candidate_list::write_csv(list, &mut out).expect("memory is writable");
    out
}

#[test]
fn no_tiling_changes_a_tag() {
    let family = FAMILIES[2];
    let (picture, truth) = plant_tags(&stripes(440, 370), family, 4.0, &mut Random(3));
    let source = memory(&picture);
    let mut profile = builtin(family.0);
    // Cells of 100 px: many of them.
    profile.size.max_px = Some(50.0);
    let whole = find(&source, &profile, 4000, 1);
    assert!(whole.len() * 10 >= truth.len() * 9, "{} of {}", whole.len(), truth.len());
    for (tile, threads) in [(64, 2), (150, 3), (333, 2)] {
        assert!(bytes(&whole) == bytes(&find(&source, &profile, tile, threads)), "tile {tile}");
    }
    // Every tag once, also those beside the borders of cells.
    let mut tally = Tally::default();
    tally.count(&whole, &truth);
    assert_eq!((tally.read, tally.false_candidates), (whole.len(), 0));
}

/// Pictures of nothing, smaller than a tag, or with a tag on the edge: an answer, never a panic.
#[test]
fn edges_and_emptiness_are_answered() {
    let family = FAMILIES[0];
    for (width, height) in [(1, 1), (3, 200), (9, 9), (40, 40), (65, 65)] {
        let picture = Picture { width, height, rgb: vec![[0; 3]; width * height] };
        assert!(find(&memory(&picture), &builtin(family.0), 64, 1).is_empty());
        let rgb = (0..width * height).map(|i| [if (i % width > 8) == (i / width > 8) { 230 } else { 20 }; 3]);
        let picture = Picture { width, height, rgb: rgb.collect() };
        assert!(find(&memory(&picture), &builtin(family.0), 64, 1).is_empty());
    }
    // In the middle of the edge, in the corner, and with room for its quiet zone only.
    for (at, seen) in [((0.0, 90.0), false), ((0.0, 0.0), false), ((26.0, 90.0), true)] {
        let mut picture = stripes(200, 180);
        let (module_px, blur_px) = (5.0, 0.8);
        let tag = Drawn { family, number: 7, centre: at, module_px, angle: 0.0, blur_px, fading: 0.0, light: 1.0 };
        tag.draw(&mut picture, &mut Random(1));
        assert_eq!(find(&memory(&picture), &builtin(family.0), 64, 1).len(), usize::from(seen), "{at:?}");
    }
    let mut tiny = builtin(family.0);
    tiny.size = autoref_stream::profile::Size { min_px: Some(1.0), max_px: Some(2.0), min_m: None, max_m: None };
    assert!(find(&memory(&stripes(30, 30)), &tiny, 16, 1).is_empty());
    tiny.size = autoref_stream::profile::Size { min_px: Some(10.0), max_px: Some(900.0), min_m: None, max_m: None };
    assert!(find(&memory(&stripes(300, 200)), &tiny, 128, 2).is_empty());
}

/// An orthophoto with a regular grid of tags, from file to georeference by the program itself: solved by the numbers,
/// refused when the labels say others.
#[test]
fn a_grid_of_tags_is_georeferenced_by_its_numbers() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let family = FAMILIES[2];
    let mut picture = stripes(1400, 1100);
    let (gsd, mut rows, mut foreign) =
        (0.05, "name,easting,northing\n".to_string(), "name,easting,northing\n".to_string());
    let mut random = Random(77);
    let order = crate::common::Random::new(4).order(12);
    for (i, other) in order.iter().enumerate() {
        let centre = (200.3 + 330.0 * (i % 4) as f64, 190.7 + 340.0 * (i / 4) as f64);
        let angle = random.unit() * std::f64::consts::TAU;
        let number = i as u16 + 1;
        Drawn { family, number, centre, module_px: 4.0, angle, blur_px: 0.9, fading: 0.1, light: 0.9 }
            .draw(&mut picture, &mut random);
        let (e, n) = (569_000.0 + gsd * centre.0, 7_032_000.0 - gsd * centre.1);
        rows += &format!("GCP_{number:03},{e:.4},{n:.4}\n");
        foreign += &format!("GCP_{:03},{e:.4},{n:.4}\n", other + 1);
    }
    let image = folder.path().join("ortho.png");
    let mut encoder = png::Encoder::new(std::fs::File::create(&image).expect("writable"), 1400, 1100);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().expect("writable");
    writer.write_image_data(picture.rgb.as_flattened()).expect("a whole picture");
    writer.finish().expect("writable");
    let run = |name: &str, list: &str| {
        let list_path = folder.path().join(name);
        std::fs::write(&list_path, list).expect("writable");
        let output = assert_cmd::Command::cargo_bin("autoref-stream")
            .expect("built with the tests")
            .arg(&image)
            .args(["--profile", "aruco-4x4-50", "--json", "--quiet", "--overwrite", "--gcps"])
            .arg(&list_path)
            .output()
            .expect("it runs");
        let text = String::from_utf8(output.stdout).expect("JSON is text");
        let message = || format!("{text}{}", String::from_utf8_lossy(&output.stderr));
        (
            output.status.code(),
            serde_json::from_str::<serde_json::Value>(&text).unwrap_or_else(|_| panic!("{}", message())),
        )
    };
    let (code, result) = run("right.csv", &rows);
    assert_eq!(code, Some(0), "{result}");
    assert_eq!(result["names"]["agree"], 12);
    assert_eq!(result["matches"].as_array().map(Vec::len), Some(12));
    for row in result["matches"].as_array().expect("rows") {
        let number =
            row["gcp"].as_str().expect("a label").trim_start_matches("GCP_").trim_start_matches('0').to_string();
        assert_eq!(row["code"], format!("aruco-4x4-50:{number}"));
        assert!(row["residual_px"].as_f64().expect("solved") < 0.1, "{row}");
    }
    let t: Vec<f64> =
        result["geotransform"].as_array().expect("six").iter().map(|v| v.as_f64().expect("a number")).collect();
    assert!((t[0] - 569_000.0).abs() < 0.01 && (t[1] - gsd).abs() < 1e-5 && (t[3] - 7_032_000.0).abs() < 0.01, "{t:?}");
    let (code, result) = run("foreign.csv", &foreign);
    assert_eq!((code, &result["status"]), (Some(1), &"refused".into()), "{result}");
    assert!(result["advice"].to_string().contains("bear numbers"), "{}", result["advice"]);
}
