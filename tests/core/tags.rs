//! Tags in the image itself: read back by GDAL and by the `tiff` crate, and taken back byte for byte.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use autoref_raster::atomic::Edit;
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::crs::Crs;
use autoref_raster::{self as raster, ReaderChoice};
use autoref_stream::georef::tags::{self, TagOptions};
use gdal::Metadata;
use gdal::raster::{Buffer, RasterCreationOptions};

const TURNED: GeoTransform = GeoTransform([570_000.25, 0.03, -0.004, 7_032_000.5, -0.004, -0.03]);
const NORTH_UP: GeoTransform = GeoTransform([570_000.25, 0.03, 0.0, 7_032_000.5, 0.0, -0.031]);
const SIZE: (usize, usize) = (300, 200);

/// A three-band file by GDAL with overviews and noise in it.
fn sample(path: &Path, options: &[&str], overviews: bool, prepare: impl FnOnce(&mut gdal::Dataset)) {
    raster::initialise_gdal(0);
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let options = RasterCreationOptions::from_iter(options.iter().copied());
    let mut dataset =
        driver.create_with_band_type_with_options::<u8, _>(path, SIZE.0, SIZE.1, 3, &options).expect("created");
    let mut random = crate::common::Random::new(7);
    for band in 1..=3 {
        let pixels = (0..SIZE.0 * SIZE.1).map(|_| random.bits() as u8).collect();
        let mut band = dataset.rasterband(band).expect("there");
        band.write((0, 0), SIZE, &mut Buffer::new(SIZE, pixels)).expect("written");
        band.set_no_data_value(Some(7.0)).expect("settable");
    }
    prepare(&mut dataset);
    dataset.close().expect("written");
    if overviews {
        let options = gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
        let mut dataset = gdal::Dataset::open_ex(path, options).expect("opens");
        dataset.build_overviews("AVERAGE", &[2, 4], &[]).expect("built");
        dataset.close().expect("written");
    }
}

fn write_tags(path: &Path, page: usize, transform: &GeoTransform, crs: Option<&Crs>, options: TagOptions) {
    let (mut edit, lost) = tags::prepare(path, page, transform, crs, &options).expect("it takes tags");
    assert_eq!(lost, None);
    edit.apply().expect("written");
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).expect("readable")
}

/// Largest distance, in pixels, between where two transforms put corners and centre.
fn difference_px(a: &GeoTransform, b: &GeoTransform) -> f64 {
    [(0.0, 0.0), (SIZE.0 as f64, 0.0), (0.0, SIZE.1 as f64), (150.0, 100.0)]
        .into_iter()
        .map(|(x, y)| {
            let back = a.invert(b.apply(PixelPoint { x, y })).expect("not singular");
            (back.x - x).hypot(back.y - y)
        })
        .fold(0.0, f64::max)
}

fn gdal_sees(path: &Path, transform: &GeoTransform, crs: Option<&Crs>) {
    let dataset = gdal::Dataset::open(path).expect("GDAL opens it");
    let read = GeoTransform(dataset.geo_transform().expect("georeferenced"));
    assert!(difference_px(transform, &read) < 1e-6, "{read:?} is not {transform:?}");
    match crs {
        None => assert!(dataset.projection().is_empty() || dataset.projection().starts_with("LOCAL_CS")),
        Some(crs) => {
            let read = Crs::parse(&dataset.projection()).expect("a CRS");
            assert_eq!(read.label(), crs.label());
        }
    }
}

/// Pixels through our native reader.
fn pixels(path: &Path) -> Vec<[u16; 3]> {
    let source = raster::open(path, ReaderChoice::Native, 0, 8 << 20).expect("the native reader opens it");
    raster::read_patch(source.as_ref(), source.info().bounds()).expect("readable").rgb
}

/// The same georeference through the `tiff` crate, by the rules of GeoTIFF.
fn tiff_crate_sees(path: &Path, transform: &GeoTransform, point: bool) {
    use tiff::tags::Tag;
    let file = std::io::BufReader::new(std::fs::File::open(path).expect("there"));
    let mut decoder = tiff::decoder::Decoder::new(file).expect("the tiff crate opens it");
    let doubles = |decoder: &mut tiff::decoder::Decoder<_>, tag| decoder.get_tag_f64_vec(tag).ok();
    let shift = if point { 0.5 } else { 0.0 };
    let at_origin = match doubles(&mut decoder, Tag::ModelTransformationTag) {
        Some(m) => GeoTransform([m[3], m[0], m[1], m[7], m[4], m[5]]),
        None => {
            let scale = doubles(&mut decoder, Tag::ModelPixelScaleTag).expect("scale");
            let tie = doubles(&mut decoder, Tag::ModelTiepointTag).expect("tie point");
            GeoTransform([tie[3] - tie[0] * scale[0], scale[0], 0.0, tie[4] + tie[1] * scale[1], 0.0, -scale[1]])
        }
    };
    let corner = at_origin.apply(PixelPoint { x: -shift, y: -shift });
    let read =
        GeoTransform([corner.easting, at_origin.0[1], at_origin.0[2], corner.northing, at_origin.0[4], at_origin.0[5]]);
    assert!(difference_px(transform, &read) < 1e-6, "{read:?} is not {transform:?}");
    let keys = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).expect("keys");
    assert_eq!(keys.chunks_exact(4).any(|key| key == [1025, 0, 1, 2]), point, "{keys:?}");
}

#[test]
fn every_kind_of_tiff_takes_tags_and_gives_them_back() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let crs = Crs::from_epsg(25832).expect("known");
    let mut number = 0;
    for big in ["BIGTIFF=NO", "BIGTIFF=YES"] {
        for order in ["ENDIANNESS=LITTLE", "ENDIANNESS=BIG"] {
            for layout in [&["COMPRESS=DEFLATE"] as &[&str], &["TILED=YES", "BLOCKXSIZE=64", "BLOCKYSIZE=64"]] {
                for (transform, point) in [(TURNED, false), (NORTH_UP, false), (TURNED, true), (NORTH_UP, true)] {
                    number += 1;
                    let path = folder.path().join(format!("{number}.tif"));
                    let options: Vec<&str> = [big, order].iter().chain(layout).copied().collect();
                    sample(&path, &options, number % 3 == 0, |dataset| {
                        if point {
                            // An older georeference, which is replaced; its meaning of a pixel is kept.
                            dataset.set_metadata_item("AREA_OR_POINT", "Point", "").expect("settable");
                            dataset.set_geo_transform(&[1.0, 2.0, 0.0, 3.0, 0.0, -2.0]).expect("settable");
                            dataset.set_projection(Crs::from_epsg(32633).expect("known").wkt()).expect("settable");
                        }
                    });
                    one_kind(&path, &transform, &crs, point);
                }
            }
        }
    }
}

fn one_kind(path: &Path, transform: &GeoTransform, crs: &Crs, point: bool) {
    let (before, seen_before) = (bytes(path), pixels(path));
    let overviews = |path: &Path| {
        let dataset = gdal::Dataset::open(path).expect("opens");
        let band = dataset.rasterband(1).expect("there");
        let sums: Vec<u16> = (0..band.overview_count().expect("counted") as usize)
            .map(|i| {
                let overview = band.overview(i).expect("there");
                overview.checksum((0, 0), overview.size()).expect("summed")
            })
            .collect();
        (sums, band.no_data_value())
    };
    let small_before = overviews(path);
    write_tags(path, 0, transform, Some(crs), TagOptions::default());
    let after = bytes(path);
    let changed = before.iter().zip(&after).filter(|(a, b)| a != b).count();
    assert!(changed <= 8, "{changed} old bytes changed; only the pointer may");
    assert!(before[16..] == after[16..before.len()], "something behind the header changed");
    assert!(seen_before == pixels(path), "pixels changed");
    assert_eq!(small_before, overviews(path));
    gdal_sees(path, transform, Some(crs));
    tiff_crate_sees(path, transform, point);
    let dataset = gdal::Dataset::open(path).expect("opens");
    assert_eq!(dataset.metadata_item("AREA_OR_POINT", "").as_deref(), Some(if point { "Point" } else { "Area" }));
    drop(dataset);
    // Once more on top, then both taken back.
    let other = GeoTransform([1.0, 0.5, 0.0, 2.0, 0.0, -0.5]);
    write_tags(path, 0, &other, None, TagOptions::default());
    gdal_sees(path, &other, None);
    assert!(tags::undo(path, tags::Undo::DryRun).expect("undoable").more_below);
    let foreseen = tags::would_undo_all(path).expect("undoable");
    let lengths: Vec<u64> = foreseen.iter().map(|undone| undone.length_bytes).collect();
    assert_eq!(lengths, [after.len() as u64, before.len() as u64], "both, the last one first");
    assert_eq!(bytes(path).len(), tags_len(path), "a dry run changes nothing");
    assert!(tags::undo(path, tags::Undo::Now).expect("undone").more_below);
    assert!(bytes(path) == after, "the first undo leads to the first tags");
    assert!(!tags::undo(path, tags::Undo::Now).expect("undone").more_below);
    assert!(bytes(path) == before, "the second undo leads to the file as it was");
    let message = tags::undo(path, tags::Undo::Now).expect_err("nothing left").to_string();
    assert!(message.contains("nothing to undo") && !message.contains('\n'), "{message}");
}

fn tags_len(path: &Path) -> usize {
    std::fs::metadata(path).expect("there").len() as usize
}

#[test]
fn every_crs_comes_back_from_its_keys() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.tif");
    let custom = "+proj=tmerc +lat_0=58 +lon_0=10.5 +k=0.99998 +x_0=1500 +y_0=-300 +ellps=GRS80 +units=m +no_defs";
    for definition in [
        "EPSG:2193",
        "EPSG:3857",
        "EPSG:4326",
        "EPSG:25833",
        "EPSG:27700",
        "EPSG:2056",
        "EPSG:5972",
        "EPSG:2263",
        custom,
    ] {
        sample(&path, &["COMPRESS=LZW"], false, |_| {});
        let crs = Crs::parse(definition).expect("known");
        write_tags(&path, 0, &TURNED, Some(&crs), TagOptions::default());
        let dataset = gdal::Dataset::open(&path).expect("opens");
        let reference = |wkt: &str| gdal::spatial_ref::SpatialRef::from_wkt(wkt).expect("WKT");
        let (read, asked) = (reference(&dataset.projection()), reference(crs.wkt()));
        assert!(read == asked, "{definition} came back as {}", read.to_wkt().expect("WKT"));
    }
}

#[test]
fn what_another_program_has_changed_is_not_undone() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.tif");
    let fresh = || {
        sample(&path, &["TILED=YES"], true, |_| {});
        write_tags(&path, 0, &TURNED, None, TagOptions::default());
    };
    let refused = |what: &str| {
        let before = bytes(&path);
        let message = tags::undo(&path, tags::Undo::Now).expect_err(what).to_string();
        assert!(message.contains("another program has changed"), "{what}: {message}");
        assert!(before == bytes(&path), "{what}: a refused undo touched the file");
    };
    fresh();
    let mut file = std::fs::OpenOptions::new().append(true).open(&path).expect("writable");
    file.write_all(b"more").expect("written");
    refused("appended bytes");
    fresh();
    let options = gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let mut dataset = gdal::Dataset::open_ex(&path, options).expect("opens");
    dataset.set_geo_transform(&[5.0, 1.0, 0.0, 6.0, 0.0, -1.0]).expect("settable");
    dataset.close().expect("written");
    refused("GDAL's update");
    // Another byte in the pixels near the head, in the pixels at the old end, in the new directory.
    for from_end in [None, Some(3000), Some(700)] {
        fresh();
        let mut all = bytes(&path);
        let at = from_end.map_or(5000, |d| all.len() - d);
        all[at] ^= 0x10;
        std::fs::write(&path, &all).expect("writable");
        let message = tags::undo(&path, tags::Undo::Now).expect_err("a changed byte").to_string();
        assert!(!message.contains('\n'), "{message}");
        assert!(all == bytes(&path));
    }
}

#[test]
fn a_later_page_takes_tags_and_the_others_stay() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let crs = Crs::from_epsg(25832).expect("known");
    for (number, options) in
        [&["BIGTIFF=NO"] as &[&str], &["BIGTIFF=YES"], &["BIGTIFF=NO", "ENDIANNESS=BIG"]].iter().enumerate()
    {
        let path = folder.path().join(format!("pages{number}.tif"));
        sample(&path, options, false, |_| {});
        // More pages than fit a sector, so that some pointer straddles two.
        for _ in 1..12 {
            let page = folder.path().join("page.tif");
            sample(&page, &[], false, |_| {});
            let source = gdal::Dataset::open(&page).expect("opens");
            let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
            let options = RasterCreationOptions::from_iter(["APPEND_SUBDATASET=YES"]);
            source.create_copy(&driver, &path, &options).expect("appended").close().expect("written");
        }
        let before = bytes(&path);
        for page in 0..12 {
            write_tags(&path, page, &TURNED, Some(&crs), TagOptions::default());
            for other in 0..12 {
                let name = format!("GTIFF_DIR:{}:{}", other + 1, path.display());
                let dataset = gdal::Dataset::open(name).expect("every page opens");
                let read = dataset.geo_transform().ok().map(GeoTransform);
                match read {
                    Some(read) => assert!(other == page && difference_px(&TURNED, &read) < 1e-6, "page {other}"),
                    None => assert_ne!(other, page),
                }
                assert_eq!(dataset.raster_size(), SIZE);
            }
            tags::undo(&path, tags::Undo::Now).expect("undone");
            assert!(bytes(&path) == before);
        }
    }
}

#[test]
fn a_cog_is_refused_unless_it_may_be_broken() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (plain, cog) = (folder.path().join("plain.tif"), folder.path().join("cog.tif"));
    sample(&plain, &[], false, |_| {});
    let source = gdal::Dataset::open(&plain).expect("opens");
    let driver = gdal::DriverManager::get_driver_by_name("COG").expect("GDAL has it");
    source
        .create_copy(&driver, &cog, &RasterCreationOptions::from_iter(["BLOCKSIZE=128"]))
        .expect("a COG")
        .close()
        .expect("written");
    let before = bytes(&cog);
    let message = tags::check(&cog, 0, &TagOptions::default()).expect_err("it would break").to_string();
    assert!(message.contains("Cloud Optimized") && message.contains("--break-cog"), "{message}");
    write_tags(&cog, 0, &TURNED, None, TagOptions { break_cog: true });
    assert!(contains(&bytes(&cog), b"KNOWN_INCOMPATIBLE_EDITION=YES\n"), "its header must not claim what is not so");
    gdal_sees(&cog, &TURNED, None);
    tags::undo(&cog, tags::Undo::Now).expect("undone");
    assert!(before == bytes(&cog));
}

fn contains(all: &[u8], word: &[u8]) -> bool {
    all.windows(word.len()).any(|window| window == word)
}

#[test]
fn two_runs_do_not_write_at_once() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.tif");
    sample(&path, &[], false, |_| {});
    let (edit, _) = tags::prepare(&path, 0, &TURNED, None, &TagOptions::default()).expect("it takes tags");
    let message = tags::undo(&path, tags::Undo::Now).expect_err("locked").to_string();
    assert!(message.contains("another run"), "{message}");
    drop(edit);
    let message = tags::undo(&path, tags::Undo::Now).expect_err("nothing was written").to_string();
    assert!(message.contains("nothing to undo"), "{message}");
}

#[test]
fn what_cannot_take_tags_says_so_in_a_line() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let line = |path: &Path| {
        let message = tags::check(path, 0, &TagOptions::default()).expect_err("refused").to_string();
        assert!(!message.contains('\n') && message.contains(&path.display().to_string()), "{message}");
        message
    };
    let text = folder.path().join("a.jpg");
    std::fs::write(&text, b"\xff\xd8\xff").expect("written");
    assert!(line(&text).contains("no TIFF"));
    assert!(line(&folder.path().join("absent.tif")).contains("cannot open"));
    // A classic TIFF a little below 4 GiB; the hole takes no space.
    let large = folder.path().join("large.tif");
    sample(&large, &["BIGTIFF=NO"], false, |_| {});
    let file = std::fs::OpenOptions::new().write(true).open(&large).expect("writable");
    file.set_len(u64::from(u32::MAX) - 40).expect("a hole");
    assert!(line(&large).contains("4 GiB"));
    assert_eq!(file.metadata().expect("there").len(), u64::from(u32::MAX) - 40);
}

/// A BigTIFF of 3 × `side`² bytes that are a hole in the file: pixels without disk space.
fn hole(path: &Path, side: u64) -> u64 {
    let (tile, across) = (512u64, side.div_ceil(512));
    let tiles = across * across;
    let tile_bytes = tile * tile * 3;
    let (directory, entries) = (16u64, 11u64);
    let offsets_at = directory + 8 + entries * 20 + 8;
    let counts_at = offsets_at + tiles * 8;
    let data_at = (counts_at + tiles * 8).next_multiple_of(4096);
    let mut out = b"II+\0\x08\0\0\0".to_vec();
    out.extend(directory.to_le_bytes());
    out.extend(entries.to_le_bytes());
    let mut entry = |tag: u16, kind: u16, count: u64, value: u64| {
        out.extend(tag.to_le_bytes());
        out.extend(kind.to_le_bytes());
        out.extend(count.to_le_bytes());
        out.extend(value.to_le_bytes());
    };
    entry(256, 4, 1, side);
    entry(257, 4, 1, side);
    entry(258, 3, 3, 8 | 8 << 16 | 8 << 32);
    entry(259, 3, 1, 1);
    entry(262, 3, 1, 2);
    entry(277, 3, 1, 3);
    entry(284, 3, 1, 1);
    entry(322, 4, 1, tile);
    entry(323, 4, 1, tile);
    entry(324, 16, tiles, offsets_at);
    entry(325, 16, tiles, counts_at);
    out.extend(0u64.to_le_bytes());
    out.extend((0..tiles).flat_map(|i| (data_at + i * tile_bytes).to_le_bytes()));
    out.extend((0..tiles).flat_map(|_| tile_bytes.to_le_bytes()));
    std::fs::write(path, &out).expect("written");
    let length = data_at + tiles * tile_bytes;
    let file = std::fs::OpenOptions::new().write(true).open(path).expect("writable");
    file.set_len(length).expect("a hole");
    length
}

fn sha256(path: &Path) -> String {
    let output = std::process::Command::new("sha256sum").arg(path).output().expect("coreutils are there");
    assert!(output.status.success());
    String::from_utf8_lossy(&output.stdout).split_whitespace().next().expect("a sum").to_string()
}

/// 21 GB on demand, 50 MB always: the time must not depend on the size.
#[test]
fn a_huge_file_takes_tags_in_no_time() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path: PathBuf = folder.path().join("huge.tif");
    let side = if crate::common::large() { 83_600 } else { 4_096 };
    let length = hole(&path, side);
    let crs = Crs::from_epsg(25832).expect("known");
    // PROJ's database is opened once in a process: warm.
    tags::prepare(&path, 0, &TURNED, Some(&crs), &TagOptions::default()).expect("it takes tags");
    let sum = sha256(&path);
    let started = Instant::now();
    write_tags(&path, 0, &TURNED, Some(&crs), TagOptions::default());
    let taken = started.elapsed();
    eprintln!("tags into {:.1} GB: {:.1} ms", length as f64 / 1e9, taken.as_secs_f64() * 1e3);
    gdal_sees(&path, &TURNED, Some(&crs));
    // Everything behind the header is what it was.
    let cut = |from: u64, count: u64| {
        let command = format!("tail -c +{} '{}' | head -c {count} | sha256sum", from + 1, path.display());
        std::process::Command::new("sh").args(["-c", &command]).output().expect("coreutils are there").stdout
    };
    let tagged = cut(16, length - 16);
    let started = Instant::now();
    tags::undo(&path, tags::Undo::Now).expect("undone");
    let undone = started.elapsed();
    eprintln!("undo: {:.1} ms", undone.as_secs_f64() * 1e3);
    assert_eq!(tagged, cut(16, length - 16), "a byte behind the header changed");
    assert_eq!(sum, sha256(&path), "the undo did not restore every byte");
    // Loose, for busy machines; the figure that counts is printed.
    assert!(taken.as_secs_f64() < 2.0 && undone.as_secs_f64() < 2.0, "{taken:?}, {undone:?}");
}
