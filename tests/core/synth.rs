//! The sample maker: its truth is the picture's, its picture does not depend on how it is made.

use std::path::{Path, PathBuf};

use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::window::{TileGrid, Window};
use autoref_synth::{self as synth, *};
use gdal::raster::GdalType;

fn flat(marks: Vec<PlacedMark>) -> SynthSpec {
    SynthSpec {
        placed: marks,
        size_px: Some((200, 160)),
        noise_sigma: 0.0,
        background: Background::Flat([60, 80, 100]),
        ..SynthSpec::default()
    }
}

fn style(shape: Shape, size_px: f64, blur_px: f64, turn_deg: f64) -> MarkStyle {
    MarkStyle {
        size: MarkSize::Px(size_px),
        shape,
        blur_px,
        fading: 0.2,
        texture: 0.0,
        turn: MarkTurn::Degrees(turn_deg),
        ..MarkStyle::default()
    }
}

fn busy() -> SynthSpec {
    SynthSpec {
        gcps: random_gcps(14, 30.0, 20.0, 5),
        visible: Visible::Random(9),
        size_px: Some((1111, 787)),
        clutter: 25,
        displacement_px: 0.7,
        straddle_px: Some(64),
        rotation_deg: 12.5,
        mark: MarkStyle { shadow_share: 0.5, cover_max: 0.3, ..MarkStyle::default() },
        ..SynthSpec::default()
    }
}

/// All bands of a file, interleaved.
fn read_back<T: GdalType + Copy>(path: &Path) -> (Vec<T>, gdal::Dataset) {
    let dataset = gdal::Dataset::open(path).expect("GDAL opens what it wrote");
    let (width, height) = dataset.raster_size();
    let planes: Vec<Vec<T>> = (1..=dataset.raster_count())
        .map(|b| {
            let band = dataset.rasterband(b).expect("a band");
            band.read_as::<T>((0, 0), (width, height), (width, height), None).expect("pixels").data().to_vec()
        })
        .collect();
    let pixels = (0..width * height).flat_map(|i| planes.iter().map(move |p| p[i]).collect::<Vec<_>>()).collect();
    (pixels, dataset)
}

fn in_folder(folder: &tempfile::TempDir, name: &str) -> PathBuf {
    folder.path().join(name)
}

#[test]
fn the_centroid_of_a_mark_is_its_stated_centre() {
    let cases = [
        (Shape::Square, 20.0, 0.9, 17.0),
        (Shape::Square, 6.0, 0.6, 44.0),
        (Shape::Disc, 14.0, 1.8, 0.0),
        (Shape::Disc, 9.0, 0.0, 0.0),
        (Shape::Cross, 24.0, 0.9, 30.0),
        (Shape::Square, 12.0, 0.0, 63.0),
    ];
    for (shape, size, blur, turn) in cases {
        let (x, y) = (97.318, 81.774);
        let mark = PlacedMark { name: "M".into(), x, y, style: Some(style(shape, size, blur, turn)) };
        let scene = Scene::new(&flat(vec![mark])).expect("a scene");
        // 16 bits: the rounding of 8 alone would move the centroid of a small mark by more than what is tested.
        let window = Window::whole(200, 160);
        let pixels = scene.render_window_u16(window).expect("pixels");
        let (mut sum, mut sx, mut sy) = (0.0, 0.0, 0.0);
        for (i, pixel) in pixels.chunks_exact(3).enumerate() {
            // Red is where orange differs most from the ground; the ground is 60 of 255 there.
            let alpha = (f64::from(pixel[0]) - 60.0 * 257.0) / (f64::from(Paint::ORANGE.0[0]) * 257.0 - 60.0 * 257.0);
            sum += alpha;
            sx += alpha * ((i % 200) as f64 + 0.5);
            sy += alpha * ((i / 200) as f64 + 0.5);
        }
        // Without blur the pixels at the edges hide where in them the edge runs: the sampled centroid itself is off.
        let tolerance = if blur == 0.0 { 5e-3 } else { 1e-3 };
        let (ex, ey) = (sx / sum - x, sy / sum - y);
        assert!(ex.abs() < tolerance && ey.abs() < tolerance, "{shape:?} {size} {blur}: off by {ex}, {ey}");
        let truth = &scene.truth().gcps[0];
        assert_eq!((truth.x, truth.y, truth.visible), (x, y, true));
        let area = match shape {
            Shape::Disc => size * size * std::f64::consts::FRAC_PI_4,
            Shape::Cross => size * size * 0.4375,
            _ => size * size,
        };
        assert!((sum / (0.8 * area) - 1.0).abs() < 2e-3, "{shape:?}: the paint's area is {sum}, not {}", 0.8 * area);
    }
}

#[test]
fn a_covered_mark_loses_the_stated_share() {
    for shape in [Shape::Square, Shape::Disc, Shape::Checker] {
        for seed in 0..6 {
            let look =
                MarkStyle { cover_max: 0.5, fading: 0.0, second_paint: Paint::ORANGE, ..style(shape, 30.0, 0.5, 20.0) };
            let mark = PlacedMark { name: "M".into(), x: 100.0, y: 80.0, style: Some(look) };
            let scene = Scene::new(&SynthSpec { seed, ..flat(vec![mark]) }).expect("a scene");
            let pixels = scene.render_window_u16(Window::whole(200, 160)).expect("pixels");
            let red = f64::from(Paint::ORANGE.0[0]) - 60.0;
            let sum: f64 = pixels.chunks_exact(3).map(|p| (f64::from(p[0]) / 257.0 - 60.0) / red).sum();
            let whole = if shape == Shape::Disc { 900.0 * std::f64::consts::FRAC_PI_4 } else { 900.0 };
            let covered = scene.truth().gcps[0].covered;
            assert!(
                (1.0 - sum / whole - covered).abs() < 0.04,
                "{shape:?} {seed}: {} hidden, said {covered}",
                1.0 - sum / whole
            );
        }
    }
}

#[test]
fn the_picture_does_not_depend_on_the_windows_or_threads() {
    let photos = crate::common::root().join("../shared/data/photos");
    let mut grounds = vec![Background::Landscape, Background::Flat([90, 90, 90])];
    if photos.is_dir() {
        let names = ["forest_agung.jpg", "town_freetown.jpg", "suburb_vegas_uint16.tif", "canal_pdok_tiled_jpeg.tif"];
        grounds.push(Background::Photographs(names.map(|n| photos.join(n)).to_vec()));
        grounds.push(Background::Photographs(vec![photos.join("forest_agung.jpg")]));
    } else {
        crate::common::skipped(format!("no photographs in {}", photos.display()));
    }
    for background in grounds {
        // Reaching over a brick of photographs, so that seams are met.
        let spec = SynthSpec { background, size_px: Some((2700, 1900)), ..busy() };
        let scene = Scene::new(&spec).expect("a scene");
        let (w, h) = (scene.width(), scene.height());
        let whole = scene.render_window(Window::whole(w, h)).expect("pixels");
        let again = Scene::new(&spec).expect("a scene");
        for (tw, th) in [(256, 256), (w, 7), (391, 613)] {
            let grid = TileGrid::new(w, h, tw, th, 0);
            for tile in grid.iter().filter(|t| t.id % 5 == 0 || t.id < 20) {
                let window = tile.core;
                let part = again.render_window(window).expect("pixels");
                for (row, y) in part.chunks_exact(window.width as usize * 3).zip(window.y..) {
                    let at = ((y * w + window.x) * 3) as usize;
                    assert!(row == &whole[at..at + row.len()], "{:?}: row {y} of {window:?}", spec.background);
                }
            }
        }
    }
}

#[test]
fn another_seed_is_another_picture_and_the_same_seed_the_same_truth() {
    let (a, b) = (Scene::new(&busy()).expect("a scene"), Scene::new(&busy()).expect("a scene"));
    let c = Scene::new(&SynthSpec { seed: 2, ..busy() }).expect("a scene");
    assert_eq!(a.truth(), b.truth());
    let window = Window::new(0, 0, 300, 200);
    assert_ne!(a.render_window(window).expect("pixels"), c.render_window(window).expect("pixels"));
}

#[test]
fn files_hold_what_windows_show() {
    let folder = tempfile::tempdir().expect("a folder");
    let tiles = FileLayout::Tiles(64);
    let outputs = [
        Output { layout: tiles, ..Output::default() },
        Output {
            layout: FileLayout::Tiles(256),
            compression: Compression::Deflate,
            predictor: true,
            ..Output::default()
        },
        Output { layout: FileLayout::Strips(1), compression: Compression::Lzw, predictor: true, ..Output::default() },
        Output { layout: FileLayout::Strips(16), compression: Compression::Packbits, ..Output::default() },
        Output { layout: tiles, compression: Compression::Zstd, interleave: Interleave::Band, ..Output::default() },
        Output { layout: FileLayout::Strips(100), big_tiff: BigTiff::Always, ..Output::default() },
    ];
    for (i, output) in outputs.into_iter().enumerate() {
        let spec = SynthSpec { output, ..busy() };
        let path = in_folder(&folder, &format!("{i}.tif"));
        let truth = synth::write(&spec, &path).expect("written");
        let (pixels, dataset) = read_back::<u8>(&path);
        assert_eq!(dataset.raster_size(), (1111, 787));
        let drawn = synth::render_window(&spec, Window::whole(1111, 787)).expect("pixels");
        assert!(pixels == drawn, "{:?}", spec.output);
        assert_eq!(Truth::read(&truth_path(&path)).expect("a truth file"), truth);
        let head = std::fs::read(&path).expect("bytes");
        let version = u16::from_le_bytes([head[2], head[3]]);
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
        let again = in_folder(&folder, "again.tif");
        alone.install(|| synth::write(&spec, &again)).expect("written");
        assert!(std::fs::read(&again).expect("bytes") == head, "one thread writes another file: {:?}", spec.output);
        std::fs::remove_file(&again).and(std::fs::remove_file(truth_path(&again))).expect("removed");
        assert_eq!(version == 43, spec.output.big_tiff == BigTiff::Always, "{:?}", spec.output);
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).expect("a folder").flatten().map(|e| e.file_name()).collect();
    assert_eq!(left.len(), 12, "temporary files are left: {left:?}");
}

#[test]
fn sixteen_bits_alpha_and_nodata_come_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = in_folder(&folder, "deep.tif");
    let output = Output { bits: 16, layout: FileLayout::Strips(8), ..Output::default() };
    let spec = SynthSpec { output, border: Border::Alpha { width_px: 60 }, straddle_px: None, ..busy() };
    let truth = synth::write(&spec, &path).expect("written");
    let (pixels, _) = read_back::<u16>(&path);
    let scene = Scene::new(&spec).expect("a scene");
    let drawn = scene.render_window_u16(Window::whole(1111, 787)).expect("pixels");
    let mut empty = 0;
    for (got, want) in pixels.chunks_exact(4).zip(drawn.chunks_exact(3)) {
        assert_eq!(&got[..3], want);
        assert!(got[3] == 65535 || (got == [0; 4]), "{got:?}");
        empty += usize::from(got[3] == 0);
    }
    let share = empty as f64 / (1111.0 * 787.0);
    assert!((0.05..0.35).contains(&share), "the border takes {share}");
    assert_eq!(truth.visible().count(), 9);

    let path = in_folder(&folder, "nodata.tif");
    let border = Border::Nodata { width_px: 60, value: 255 };
    let spec = SynthSpec { border, straddle_px: None, ..busy() };
    synth::write(&spec, &path).expect("written");
    let (pixels, dataset) = read_back::<u8>(&path);
    assert_eq!(dataset.rasterband(2).expect("a band").no_data_value(), Some(255.0));
    let white = pixels.chunks_exact(3).filter(|p| *p == [255; 3]).count();
    assert_eq!(white, empty, "the same border, told another way");
}

#[test]
fn the_truth_agrees_with_its_geotransform() {
    for (mirrored, rotation_deg) in [(false, 0.0), (false, -0.026), (true, 133.0)] {
        let spec = SynthSpec { mirrored, rotation_deg, displacement_px: 0.0, ..busy() };
        let truth = Scene::new(&spec).expect("a scene").truth().clone();
        assert_eq!(truth.visible().count(), 9);
        for g in &truth.gcps {
            let map = truth.geotransform.apply(PixelPoint { x: g.x, y: g.y });
            assert!((map.easting - g.easting).abs() < 1e-6 && (map.northing - g.northing).abs() < 1e-6, "{g:?}");
        }
        assert!((truth.geotransform.scale() - 0.03).abs() < 1e-12);
        let t = truth.geotransform.0;
        assert_eq!(t[1] * t[5] - t[2] * t[4] > 0.0, mirrored);
        // The image's x axis points to its angle from east.
        let angle = if mirrored { (-t[4]).atan2(-t[1]) } else { t[4].atan2(t[1]) };
        assert!((angle.to_degrees() - rotation_deg).abs() < 1e-9);
    }
    // A displacement moves the marks and leaves the mapping.
    let spec =
        SynthSpec { displacement_px: 2.0, gcps: random_gcps(400, 30.0, 20.0, 1), visible: Visible::All, ..busy() };
    let truth = Scene::new(&spec).expect("a scene").truth().clone();
    let square: f64 = truth.gcps.iter().map(|g| (g.x - g.gcp_x).powi(2) + (g.y - g.gcp_y).powi(2)).sum();
    let sigma = (square / (2.0 * truth.gcps.len() as f64)).sqrt();
    assert!((sigma - 2.0).abs() < 0.2, "{sigma}");
}

#[test]
fn marks_straddle_tile_corners_when_asked() {
    let truth = Scene::new(&SynthSpec { displacement_px: 0.0, ..busy() }).expect("a scene").truth().clone();
    let off = |v: f64| (v / 64.0 - (v / 64.0).round()).abs() * 64.0;
    let corners = truth.visible().filter(|g| off(g.x) < 7.0 && off(g.y) < 7.0).count();
    let edges = truth.visible().filter(|g| off(g.x) < 7.0 || off(g.y) < 7.0).count();
    assert!(corners >= 1 && edges >= 3, "{corners} on corners, {edges} on edges");
}

#[test]
fn marks_go_into_a_photograph_as_it_is() {
    let folder = tempfile::tempdir().expect("a folder");
    let photo = in_folder(&folder, "photo.tif");
    let ground = SynthSpec { size_px: Some((320, 240)), ..SynthSpec::default() };
    synth::write(&ground, &photo).expect("written");
    let (before, _) = read_back::<u8>(&photo);
    let mark = PlacedMark { name: "A".into(), x: 0.4, y: 120.3, style: None };
    let spec = SynthSpec { background: Background::AsIs(photo), placed: vec![mark], ..SynthSpec::default() };
    let scene = Scene::new(&spec).expect("a scene");
    assert_eq!((scene.width(), scene.height()), (320, 240));
    let after = scene.render_window(Window::whole(320, 240)).expect("pixels");
    let mut changed = 0;
    for (i, (a, b)) in after.chunks_exact(3).zip(before.chunks_exact(3)).enumerate() {
        let (dx, dy) = ((i % 320) as f64 + 0.5 - 0.4, (i / 320) as f64 + 0.5 - 120.3);
        assert!(a == b || dx.hypot(dy) < 18.0, "pixel {i} changed");
        changed += usize::from(a != b);
    }
    assert!(changed > 80, "{changed} pixels of half a mark of 14 x 14");
}

#[test]
fn what_cannot_be_is_refused_before_any_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = in_folder(&folder, "a.tif");
    let says = |spec: SynthSpec, words: &str| {
        let error = synth::write(&spec, &path).expect_err(words).to_string();
        assert!(error.contains(words) && !error.contains('\n'), "{error}");
        assert!(!path.exists() && !truth_path(&path).exists());
    };
    let output = |output| SynthSpec { output, ..busy() };
    says(SynthSpec::default(), "neither GCPs nor an image size");
    for gsd_m in [0.0, f64::NAN, 1e-300, 1e300] {
        says(SynthSpec { gsd_m, ..busy() }, "ground sample distance");
    }
    says(SynthSpec { visible: Visible::Random(15), ..busy() }, "15 visible");
    says(SynthSpec { visible: Visible::Named(vec!["X".into()]), ..busy() }, "\"X\"");
    says(SynthSpec { visible: Visible::Random(14), size_px: Some((200, 200)), ..busy() }, "fit into 200 x 200");
    says(SynthSpec { gsd_m: 1e-9, size_px: None, ..busy() }, "an image of");
    says(output(Output { layout: FileLayout::Tiles(100), ..Output::default() }), "multiple of 16");
    says(output(Output { layout: FileLayout::Strips(0), ..Output::default() }), "0 rows");
    says(output(Output { bits: 16, compression: Compression::Jpeg(80), ..Output::default() }), "JPEG");
    says(SynthSpec { background: Background::AsIs("nowhere.jpg".into()), ..busy() }, "nowhere.jpg");
    let nowhere = synth::write(&busy(), &folder.path().join("no/a.tif")).expect_err("no folder").to_string();
    assert!(nowhere.contains("no such folder"), "{nowhere}");
    let far = SynthSpec { origin: Some(MapPoint { easting: 0.0, northing: 0.0 }), visible: Visible::All, ..busy() };
    assert_eq!(Scene::new(&far).expect("an image beside its GCPs").truth().visible().count(), 0);

    std::fs::write(&path, b"mine").expect("a file");
    let error = synth::write(&busy(), &path).expect_err("it exists").to_string();
    assert!(error.contains("exists") && error.contains("--overwrite"), "{error}");
    assert_eq!(std::fs::read(&path).expect("bytes"), b"mine");
    synth::write(&output(Output { overwrite: true, ..Output::default() }), &path).expect("replaced");
}

#[test]
fn gcp_tables_are_read_in_any_column_order() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = in_folder(&folder, "gcps.csv");
    std::fs::write(&path, "\u{feff}Height,name, Easting,Northing\n80.5,P1,570406.86,7032516.80\n,P2,1,2\n")
        .expect("a file");
    let gcps = read_gcp_csv(&path).expect("a list");
    let first = SynthGcp { name: "P1".into(), easting: 570406.86, northing: 7032516.80, height: Some(80.5) };
    assert_eq!(gcps, [first, SynthGcp { name: "P2".into(), easting: 1.0, northing: 2.0, height: None }]);
    for (text, words) in [
        ("name,easting\nA,1\n", "\"northing\""),
        ("name,easting,northing\nA,1,2\nB,x,2\n", "line 3"),
        ("name,easting,northing\nA,1,2\nA,1,3\n", "twice"),
        ("name,easting,northing\nA,1\n", "line 2"),
    ] {
        std::fs::write(&path, text).expect("a file");
        let error = read_gcp_csv(&path).expect_err(words).to_string();
        assert!(error.contains(words), "{error}");
    }
    let list = in_folder(&folder, "gcps.geojson");
    write_gcp_geojson(&list, &gcps, Some(32632)).expect("written");
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&list).expect("bytes")).expect("JSON");
    assert_eq!(json["features"][0]["geometry"]["coordinates"][1], 7032516.80);
    assert_eq!(json["crs"]["properties"]["name"], "urn:ogc:def:crs:EPSG::32632");
}

#[test]
fn the_landscape_is_drawn_at_any_ground_sample_distance() {
    for gsd_m in [0.0005, 0.03, 0.5, 1.0, 30.0, 5000.0] {
        let placed = vec![PlacedMark { name: "A".into(), x: 9.0, y: 9.0, style: None }];
        let spec = SynthSpec { gsd_m, placed, size_px: Some((2_000_000_000, 2_000_000_000)), ..SynthSpec::default() };
        let scene = Scene::new(&spec).expect("a scene");
        for corner in [0, 1_999_999_000] {
            let pixels = scene.render_window(Window::new(corner, corner, 128, 96)).expect("pixels");
            let mean = pixels.iter().map(|&v| u64::from(v)).sum::<u64>() / pixels.len() as u64;
            assert!((30..220).contains(&mean), "{gsd_m} m at {corner}: mean {mean}");
        }
    }
}

#[test]
fn clutter_keeps_away_from_marks_and_only_named_gcps_are_marked() {
    let names = ["G3", "G7"].map(String::from).to_vec();
    let spec = SynthSpec { visible: Visible::Named(names), clutter: 400, straddle_px: None, ..busy() };
    let truth = Scene::new(&spec).expect("a scene").truth().clone();
    assert_eq!(truth.visible().map(|g| g.name.as_str()).collect::<Vec<_>>(), ["G3", "G7"]);
    assert_eq!(truth.clutter.len(), 400);
    for (g, c) in truth.visible().flat_map(|g| truth.clutter.iter().map(move |c| (g, c))) {
        let reach = (g.size_px + c.size_px) * std::f64::consts::FRAC_1_SQRT_2;
        assert!((g.x - c.x).hypot(g.y - c.y) > reach, "{c:?} touches {}", g.name);
    }
}
