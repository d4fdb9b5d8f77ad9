//! `flight orthorectify` through the program: drawn frames over a drawn model, and neighbours of two real blocks.

use std::path::Path;

use super::flight::{F_PX, Place, SIDE, autoref, brightness, expect, ground, json, text, write_png};
use crate::common::data;
use autoref_raster::crs::{Coordinate, Crs};
use gdal::Metadata as _;

/// A raster of floats on a plane.
pub(super) fn write_dem(
    path: &Path,
    size: (usize, usize),
    corner: [f64; 2],
    cell: f64,
    height: impl Fn(f64, f64) -> f64,
) {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let mut file = driver.create_with_band_type::<f32, _>(path, size.0, size.1, 1).expect("a new file");
    file.set_geo_transform(&[corner[0], cell, 0.0, corner[1], 0.0, -cell]).expect("kept");
    let at = |k: usize| ((k % size.0) as f64 + 0.5, (k / size.0) as f64 + 0.5);
    let heights = (0..size.0 * size.1).map(|k| height(corner[0] + at(k).0 * cell, corner[1] - at(k).1 * cell) as f32);
    let mut buffer = gdal::raster::Buffer::new(size, heights.collect());
    file.rasterband(1).expect("a band").write((0, 0), size, &mut buffer).expect("written");
    file.close().expect("written");
}

/// First band and last (alpha) of an orthophoto with its geotransform.
pub(super) fn ortho(path: &Path) -> (Vec<u8>, Vec<u8>, (usize, usize), [f64; 6]) {
    let file = gdal::Dataset::open(path).expect("it opens");
    let size = file.raster_size();
    let read = |b: usize| {
        file.rasterband(b).expect("a band").read_as::<u8>((0, 0), size, size, None).expect("read").data().to_vec()
    };
    (read(1), read(file.raster_count()), size, file.geo_transform().expect("georeferenced"))
}

/// The same picture as numbers of a palette: red as the number, green the other way round.
fn with_palette(grey: &Path, out: &Path) {
    let set = gdal::Dataset::open(grey).expect("it opens");
    let size = set.raster_size();
    let mut numbers: gdal::raster::Buffer<u8> =
        set.rasterband(1).expect("a band").read_as((0, 0), size, size, None).expect("read");
    let driver = |name| gdal::DriverManager::get_driver_by_name(name).expect("there");
    let copy = driver("MEM").create_with_band_type::<u8, _>("", size.0, size.1, 1).expect("in memory");
    let mut band = copy.rasterband(1).expect("a band");
    band.write((0, 0), size, &mut numbers).expect("written");
    let mut table = gdal::raster::ColorTable::new(gdal::raster::PaletteInterpretation::Rgba);
    for r in 0..256i16 {
        let entry = gdal::raster::ColorEntry::rgba(r, 255 - r, 7, 255);
        table.set_color_entry(r as u16, &entry);
    }
    band.set_color_table(&table);
    copy.create_copy(&driver("PNG"), out, &Default::default()).expect("a PNG").close().expect("written");
}

pub(super) fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let n = pairs.len() as f64;
    let mean = pairs.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0 / n, s.1 + p.1 / n));
    let sum = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
    let (a, b) = (sum(&|p| (p.0 - mean.0).powi(2)), sum(&|p| (p.1 - mean.1).powi(2)));
    sum(&|p| (p.0 - mean.0) * (p.1 - mean.1)) / (a * b).sqrt()
}

#[test]
fn an_orthophoto_shows_the_ground_and_hides_what_the_frame_does_not_see() {
    let place = Place::new();
    place.flight.render(&place.at("frames"), &[2]);
    place.flight.write_model(&place.at("model"));
    let (frame, dem, cameras) = (place.at("frames").join("f2.png"), place.at("dem.tif"), place.at("cameras.json"));
    // A tower that the frame does not show stands in the model: it covers itself and its shadow, the rest stays as it
    // was.
    let tower = |x: f64, y: f64| f64::from(u8::from((1290.0..1300.0).contains(&x) && (1990.0..2010.0).contains(&y)));
    write_dem(&dem, (400, 250), [800.0, 2250.0], 2.0, ground);
    let towered = place.at("towered.tif");
    write_dem(&towered, (400, 250), [800.0, 2250.0], 2.0, |x, y| ground(x, y) + 120.0 * tower(x, y));
    let adjust = [
        "flight",
        "adjust",
        text(&place.at("model")),
        "--gcps",
        text(&place.at("gcps.txt")),
        "--sigma-ground",
        "0.01",
        "--free",
        "none",
        "-o",
        text(&cameras),
        "--crs",
        "local",
    ]
    .map(str::to_string);
    expect(&autoref(&adjust.each_ref().map(String::as_str), None, &[]), 0, &[]);
    let run = |dem: &Path, name: &str, more: &[&str]| {
        let out = place.at(name);
        let some = [
            "flight",
            "orthorectify",
            text(&frame),
            "--dem",
            text(dem),
            "--cameras",
            text(&cameras),
            "-o",
            text(&out),
            "--json",
        ];
        (autoref(&[&some, more].concat(), None, &[]), out)
    };
    let (output, out) = run(&dem, "a.tif", &[]);
    expect(&output, 0, &[]);
    let gsd = json(&output)["gsd"].as_f64().expect("a number");
    assert!((gsd - 0.8).abs() < 0.1, "{gsd}");
    let (grey, alpha, size, transform) = ortho(&out);
    let truth = |k: usize| {
        (
            transform[0] + transform[1] * ((k % size.0) as f64 + 0.5),
            transform[3] + transform[5] * ((k / size.0) as f64 + 0.5),
        )
    };
    let pairs: Vec<(f64, f64)> = (0..grey.len())
        .filter(|k| alpha[*k] == 255)
        .map(|k| (f64::from(grey[k]), f64::from(brightness(truth(k).0, truth(k).1))))
        .collect();
    let found = correlation(&pairs);
    assert!(found > 0.97 && pairs.len() > SIDE * SIDE * 9 / 10, "{found:.4} of {} pixels", pairs.len());
    // Any tiling, the same bytes.
    let bytes = std::fs::read(&out).expect("there");
    for (name, more) in
        [("b.tif", ["--tile", "64", "--threads", "1"]), ("c.tif", ["--tile", "300", "--memory", "112M"])]
    {
        let (output, other) = run(&dem, name, &more);
        expect(&output, 0, &[]);
        assert!(std::fs::read(other).expect("there") == bytes, "{name}");
    }
    // A frame whose numbers stand for colours is drawn in them.
    let drawn = place.at("palette");
    std::fs::create_dir(&drawn).expect("writable");
    with_palette(&frame, &drawn.join("f2.png"));
    let coloured = place.at("p.tif");
    let drawn = drawn.join("f2.png");
    let palette = ["flight", "orthorectify", text(&drawn), "--dem", text(&dem), "--cameras", text(&cameras), "-o"];
    expect(&autoref(&[&palette[..], &[text(&coloured)]].concat(), None, &[]), 0, &[]);
    let file = gdal::Dataset::open(&coloured).expect("it opens");
    assert_eq!(file.raster_count(), 4, "three colours and alpha");
    let green: gdal::raster::Buffer<u8> = file.rasterband(2).unwrap().read_as((0, 0), size, size, None).expect("read");
    assert_eq!(ortho(&coloured).0, grey);
    let off = |k: &usize| (i16::from(green.data()[*k]) - (255 - i16::from(grey[*k]))).abs() > 1;
    assert!(!(0..grey.len()).filter(|k| alpha[*k] == 255).any(|k| off(&k)));
    // Behind the tower, seen from the camera at x = 1160, nothing is seen; before it, all.
    let (output, out) = run(&towered, "t.tif", &[]);
    expect(&output, 0, &[]);
    let (_, hidden, size, transform) = ortho(&out);
    let at = |x: f64, y: f64| {
        hidden[((y - transform[3]) / transform[5]) as usize * size.0 + ((x - transform[0]) / transform[1]) as usize]
    };
    assert_eq!((at(1315.0, 2000.0), at(1270.0, 2000.0), at(1315.0, 2060.0)), (0, 255, 255));
    // What cannot be.
    expect(&run(&dem, "a.tif", &[]).0, 2, &["a.tif exists", "--overwrite"]);
    expect(&run(&place.at("no.tif"), "x.tif", &[]).0, 2, &["no.tif"]);
    let far = place.at("far.tif");
    write_dem(&far, (20, 20), [90_000.0, 90_000.0], 2.0, |_, _| 0.0);
    expect(&run(&far, "x.tif", &[]).0, 1, &["far.tif", "none of its rays"]);
    expect(&run(&dem, "x.tif", &["--gsd", "0"]).0, 2, &["--gsd"]);
    expect(&run(&dem, "x.tif", &["--gsd", "100000"]).0, 1, &["no pixel", "--gsd"]);
    expect(&run(&dem, "x.tif", &["--shift", "1e20,0,0"]).0, 2, &["--shift 1e20,0,0"]);
    for more in [["--camera", "camera.toml"], ["--angles", "aircraft"]] {
        expect(&run(&dem, "x.tif", &more).0, 2, &[more[0], "is of a camera table", "cameras.json"]);
    }
    let other = place.at("frames").join("q.png");
    std::fs::copy(&frame, &other).expect("copied");
    let x = place.at("x.tif");
    let unknown =
        ["flight", "orthorectify", text(&other), "--dem", text(&dem), "--cameras", text(&cameras), "-o", text(&x)];
    expect(&autoref(&unknown, None, &[]), 2, &["cameras.json", "q.png"]);
    assert!(!place.at("x.tif").exists());
}

/// Two frames of an aerial camera and two of a drone: their orthophotos agree where they overlap.
#[test]
fn orthophotos_of_neighbours_agree() {
    let Some(frames) = data("frames") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let case = |name: &str, images: [&str; 2], dem: &str, (least, more): (usize, &[&str])| {
        let run = |image: &str| {
            let out = folder.path().join(format!("{name}-{image}.tif"));
            let (frame, dem) = (frames.join(name).join(image), frames.join(name).join(dem));
            let some = ["flight", "orthorectify", text(&frame), "--dem", text(&dem), "-o", text(&out)];
            expect(&autoref(&[&some, more].concat(), None, &[]), 0, &[]);
            ortho(&out)
        };
        let (a, b) = (run(images[0]), run(images[1]));
        let cell = a.3[1];
        let off = [((a.3[0] - b.3[0]) / cell).round() as i64, ((b.3[3] - a.3[3]) / cell).round() as i64];
        let mut pairs = Vec::new();
        for k in 0..a.0.len() {
            let (x, y) = ((k % a.2.0) as i64 + off[0], (k / a.2.0) as i64 + off[1]);
            if (0..b.2.0 as i64).contains(&x) && (0..b.2.1 as i64).contains(&y) {
                let other = y as usize * b.2.0 + x as usize;
                if a.1[k] == 255 && b.1[other] == 255 {
                    pairs.push((f64::from(a.0[k]), f64::from(b.0[other])));
                }
            }
        }
        let found = correlation(&pairs);
        eprintln!("{name}: correlation {found:.4} of {} pixels of {cell}", pairs.len());
        assert!(found > 0.75 && pairs.len() > least, "{name}: {found:.3} of {}", pairs.len());
    };
    let table = frames.join("ngi/camera_pos_ori.txt");
    let ngi = ["3324c_2015_1004_05_0182_RGB.tif", "3324c_2015_1004_05_0184_RGB.tif"];
    case("ngi", ngi, "dem.tif", (10_000, &["--cameras", text(&table), "--f-px", "833.3333", "--gsd", "8"]));
    let (table, camera) = (frames.join("odm/odm_xyz_opk.csv"), frames.join("odm/reconstruction.json"));
    case(
        "odm",
        ["100_0005_0018.tif", "100_0005_0136.tif"],
        "dsm.tif",
        (2_500, &["--cameras", text(&table), "--camera", text(&camera), "--gsd", "1.6"]),
    );
}

/// The model that is at `path`, in a CRS.
fn put_in(path: &Path, epsg: u32) {
    let options = gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let mut file = gdal::Dataset::open_ex(path, options).expect("it opens");
    file.set_spatial_ref(&gdal::spatial_ref::SpatialRef::from_epsg(epsg).expect("known")).expect("kept");
    file.close().expect("written");
}

/// At 63° north the metres of EPSG:3857 are 2.2 to one on the ground: a frame shows no less of it there.
#[test]
fn a_map_that_stretches_the_ground_loses_none_of_it() {
    let place = Place::new();
    // What the frame shows does not matter, nor how finely.
    let frame = place.at("f2.png");
    write_png(&frame, 200, &[100; 200 * 200]);
    // On the zone's meridian, where north of both maps is one.
    let mut at = [[500_000.0, 6_985_000.0], [500_000.0, 6_986_000.0]].map(|[x, y]| Coordinate { x, y, height: None });
    let utm = at;
    let crs = |epsg: u32| Crs::from_epsg(epsg).expect("known");
    crs(25833).transform(&mut at, &crs(3857), 100.0).expect("both have it");
    let scale = (at[1].y - at[0].y) / 1000.0;
    assert!((scale - 2.19).abs() < 0.02, "{scale}");
    for pitch in [-90.0, -40.0] {
        let drawn = |epsg: u32, eye: &Coordinate, scale: f64| {
            let (dem, out) = (place.at(&format!("{epsg}_dem.tif")), place.at(&format!("{epsg}_{pitch}.tif")));
            let half = 4000.0 * scale;
            write_dem(&dem, (400, 400), [eye.x - half, eye.y + half], 20.0 * scale, |_, _| 100.0);
            put_in(&dem, epsg);
            let row = format!("name,x,y,z,yaw,pitch,roll\nf2.png,{},{},1100,20,{pitch},0\n", eye.x, eye.y);
            let table = place.write(&format!("{epsg}.csv"), &row);
            let words = ["flight", "orthorectify", text(&frame), "--dem", text(&dem), "--cameras", text(&table)];
            let output = autoref(&[&words[..], &["--f-px", "208.3", "-o", text(&out), "--json"]].concat(), None, &[]);
            expect(&output, 0, &[]);
            let number = |key: &str| json(&output)[key].as_f64().expect("a number");
            let gsd = number("gsd") / scale;
            (gsd, number("pixels_seen") * gsd * gsd)
        };
        let (metric, stretched) = (drawn(25833, &utm[0], 1.0), drawn(3857, &at[0], scale));
        assert!((stretched.0 / metric.0 - 1.0).abs() < 0.01, "{pitch}: {metric:?} {stretched:?}");
        assert!((stretched.1 / metric.1 - 1.0).abs() < 0.02, "{pitch}: {metric:?} {stretched:?}");
    }
}

/// The interior that the options state is in pixels of the frame, whatever the size of its camera.
#[test]
fn the_interior_of_the_options_is_that_of_the_frame() {
    let place = Place::new();
    place.flight.render(&place.at("frames"), &[2]);
    let (frame, dem) = (place.at("frames").join("f2.png"), place.at("dem.tif"));
    write_dem(&dem, (400, 250), [800.0, 2250.0], 2.0, ground);
    let pose = place.flight.model.photographs[2].pose;
    let rows: Vec<[f64; 3]> = (0..3).map(|i| std::array::from_fn(|k| pose.rotation[(i, k)])).collect();
    let cameras = |size: f64| {
        let half = size / 2.0;
        let camera = serde_json::json!({
            "name": "f2.png", "C": pose.centre.as_slice(), "R": rows, "f_px": F_PX * size / SIDE as f64,
            "pp_px": [half, half], "size_px": [size, size], "distortion": {},
        });
        let document = serde_json::json!({"crs": "local", "cameras": [camera]});
        place.write(&format!("cameras_{size}.json"), &document.to_string())
    };
    let drawn = |size: f64, more: &[&str]| {
        let (cameras, out) = (cameras(size), place.at("out.tif"));
        let words = ["flight", "orthorectify", text(&frame), "--dem", text(&dem), "--cameras", text(&cameras)];
        let also = ["--gsd", "2", "--overwrite", "-o", text(&out)];
        expect(&autoref(&[&words[..], &also, more].concat(), None, &[]), 0, &[]);
        ortho(&out)
    };
    let side = SIDE as f64;
    let interior = ["--f-px", "500", "--pp-px", "240,240"];
    assert!(drawn(side, &[]) == drawn(2.0 * side, &interior) && drawn(side, &[]) == drawn(2.0 * side, &[]));
}

/// A frame of 40 × 30 bands of columns and rows over level ground: `value` of band, column and row.
fn small_frame<T: gdal::raster::GdalType + Copy>(
    path: &Path,
    bands: usize,
    value: impl Fn(usize, usize, usize) -> T,
) -> gdal::Dataset {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let file = driver.create_with_band_type::<T, _>(path, 40, 30, bands).expect("a new file");
    for band in 0..bands {
        let values = (0..40 * 30).map(|k| value(band, k % 40, k / 40)).collect();
        let mut buffer = gdal::raster::Buffer::new((40, 30), values);
        file.rasterband(band + 1).expect("a band").write((0, 0), (40, 30), &mut buffer).expect("written");
    }
    file
}

/// Runs `orthorectify` on a frame of [`small_frame`] that looks straight down from 100 m, one pixel to a metre.
fn small_ortho(place: &Place, frame: &Path) -> gdal::Dataset {
    let (dem, out) = (place.at("dem.tif"), place.at("ortho.tif"));
    write_dem(&dem, (20, 20), [-50.0, 50.0], 5.0, |_, _| 0.0);
    let name = frame.file_name().and_then(|name| name.to_str()).expect("plain");
    let table = place.write("table.csv", &format!("name,x,y,z,yaw,pitch,roll\n{name},0,0,100,0,-90,0\n"));
    let words = ["flight", "orthorectify", text(frame), "--dem", text(&dem), "--cameras", text(&table)];
    let more = ["--f-px", "100", "--gsd", "1", "--overwrite", "-o", text(&out)];
    expect(&autoref(&[&words[..], &more].concat(), None, &[]), 0, &[]);
    gdal::Dataset::open(&out).expect("it opens")
}

/// The numbers of a band at a place of the map.
fn number_at(file: &gdal::Dataset, band: usize, [x, y]: [f64; 2]) -> f64 {
    let transform = file.geo_transform().expect("georeferenced");
    let at = (((x - transform[0]) / transform[1]) as isize, ((y - transform[3]) / transform[5]) as isize);
    let band = file.rasterband(band).expect("a band");
    band.read_as::<f64>(at, (1, 1), (1, 1), None).expect("read").data()[0]
}

/// White paint in a picture whose nodata is 255: its red is no hole, and its border is one.
#[test]
fn a_colour_that_is_the_number_of_nodata_stays() {
    let place = Place::new();
    let frame = place.at("frame.tif");
    let file = small_frame::<u8>(&frame, 3, |band, x, _| if x < 10 { 255 } else { [255, 120, 90][band] });
    for band in 1..=3 {
        file.rasterband(band).expect("a band").set_no_data_value(Some(255.0)).expect("kept");
    }
    file.close().expect("written");
    let ortho = small_ortho(&place, &frame);
    let all = |at| [1, 2, 3, 4].map(|band| number_at(&ortho, band, at));
    assert_eq!((all([5.5, 0.5]), all([-15.5, 0.5])), ([255.0, 120.0, 90.0, 255.0], [0.0; 4]));
    // Bands of floats have each their own holes.
    let frame = place.at("floats.tif");
    small_frame::<f32>(&frame, 2, |band, x, _| if band == 1 && x < 10 { f32::NAN } else { 7.0 })
        .close()
        .expect("written");
    let ortho = small_ortho(&place, &frame);
    assert!(number_at(&ortho, 1, [-15.5, 0.5]) == 7.0 && number_at(&ortho, 2, [-15.5, 0.5]).is_nan());
}

#[test]
fn what_a_frame_says_of_its_bands_is_kept() {
    let place = Place::new();
    let frame = place.at("frame.tif");
    let file = small_frame::<u16>(&frame, 2, |band, _, _| [300, 400][band]);
    let mut band = file.rasterband(2).expect("a band");
    band.set_description("NIR").expect("kept");
    band.set_scale(0.01).and_then(|()| band.set_offset(5.0)).expect("kept");
    autoref_raster::set_unit(&frame, &band, "W/m2").expect("kept");
    file.close().expect("written");
    let ortho = small_ortho(&place, &frame);
    let band = ortho.rasterband(2).expect("a band");
    let said = (band.description().expect("text"), band.scale(), band.offset(), band.unit());
    assert_eq!(said, ("NIR".to_string(), Some(0.01), Some(5.0), "W/m2".to_string()));
    assert_eq!([1, 2].map(|band| number_at(&ortho, band, [0.5, 0.5])), [300.0, 400.0]);
    assert_eq!(ortho.rasterband(1).expect("a band").description().expect("text"), "");
}
