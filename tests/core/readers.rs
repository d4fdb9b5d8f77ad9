//! The native TIFF reader against GDAL and the `tiff` crate: every layout, codec, depth and byte order gives the same
//! samples; odd and broken files give the right answer or one clear line.

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use crate::readers_oracle::made::Kind;
use crate::readers_oracle::{gdal_patch, worst_difference};
use autoref_raster::Error;
use autoref_raster::window::Window;
use autoref_raster::{Patch, RasterSource, ReaderChoice, open, read_patch, tiff as native};

const CACHE: u64 = 64 << 20;
/// Decoders of lossy files that are not baseline JPEG may differ: by rounding in the inverse transform and in the
/// colour conversion, and by how colour differences are brought to full size. Largest and mean difference of one sample
/// that is accepted.
const JPEG_LARGEST: u16 = 12;
const JPEG_MEAN: f64 = 0.6;

fn shared(name: &str) -> Option<PathBuf> {
    let path = crate::common::root().join("../shared/data").join(name);
    if !path.exists() {
        crate::common::skipped(format!("{} is absent", path.display()));
        return None;
    }
    Some(path)
}

fn read_all(path: &Path, choice: ReaderChoice) -> Result<(Patch, String), Error> {
    let source = open(path, choice, 0, CACHE)?;
    let info = source.info();
    let whole = info.bounds();
    // Of a giant only a corner and the middle.
    let window = match whole.area() > 4_000_000 {
        true => Window::new(whole.width / 2, whole.height / 2, 300, 200).intersect(&whole),
        false => whole,
    };
    let description = format!("{} ({})", info.reader, info.description);
    Ok((read_patch(&*source, window)?, description))
}

fn files_below(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("the folder is readable") {
        let path = entry.expect("the folder is readable").path();
        if path.is_dir() {
            files_below(&path, found);
        } else {
            found.push(path);
        }
    }
}

/// An error must be one line that says something.
fn is_clear_line(path: &Path, error: &Error) {
    let text = error.to_string();
    assert!(!text.contains('\n') && text.len() > 20, "{}: {text:?}", path.display());
    let name = path.file_name().expect("a file").to_string_lossy();
    assert!(text.contains(name.as_ref()), "{name} is not named in {text:?}");
}

/// Gives up on a job that hangs: the thread is left behind and the test fails.
fn within<T: Send + 'static>(limit: Duration, name: &Path, job: impl FnOnce() -> T + Send + 'static) -> T {
    let (give, take) = mpsc::channel();
    std::thread::spawn(move || give.send(job()));
    take.recv_timeout(limit).unwrap_or_else(|e| panic!("{}: {e}", name.display()))
}

/// Peak resident memory of this process, bytes.
fn peak_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).expect("Linux says so");
    let kib: u64 = line.split_whitespace().nth(1).and_then(|v| v.parse().ok()).expect("a number");
    kib << 10
}

#[test]
fn every_odd_and_broken_file_gives_gdals_pixels_or_one_clear_line() {
    let Some(folder) = shared("tiff") else { return };
    let mut files = Vec::new();
    files_below(&folder, &mut files);
    files.sort();
    let (mut same, mut refused, mut native) = (0, 0, 0);
    for path in files {
        let name = path.file_name().expect("a file").to_string_lossy().into_owned();
        let job = path.clone();
        let outcome = within(Duration::from_secs(30), &path, move || read_all(&job, ReaderChoice::Auto));
        match outcome {
            Err(error) => {
                is_clear_line(&path, &error);
                println!("refused {name}: {error}");
                refused += 1;
            }
            Ok((patch, reader)) => {
                native += usize::from(reader.starts_with("native"));
                let job = path.clone();
                let window = patch.window;
                match within(Duration::from_secs(30), &path, move || gdal_patch(&job, window)) {
                    Err(error) => println!("only ours {name} by {reader}: {error}"),
                    Ok(oracle) => {
                        let (largest, mean) = worst_difference(&patch, &oracle);
                        let lossy = reader.contains("JPEG") || reader.contains("WEBP");
                        let allowed = if lossy { (JPEG_LARGEST, JPEG_MEAN) } else { (0, 0.0) };
                        assert!(
                            largest <= allowed.0 && mean <= allowed.1,
                            "{name} by {reader}: differs by up to {largest}, {mean} in the mean"
                        );
                        assert_eq!(patch.valid, oracle.valid, "{name} by {reader}");
                        same += 1;
                    }
                }
            }
        }
    }
    println!("{same} as GDAL ({native} read natively), {refused} refused; peak {} MiB", peak_bytes() >> 20);
    assert!(same > 60 && native > 20);
    // All tests of this file run in one process.
    assert!(peak_bytes() < 600 << 20);
}

#[test]
fn photographs_read_alike_natively_and_through_gdal() {
    for name in ["river_town_oam", "savanna_oam", "canal_pdok_tiled_jpeg", "suburb_vegas_uint16", "oak_sjer_neon"] {
        let Some(path) = shared(&format!("photos/{name}.tif")) else { continue };
        let (native, reader) = read_all(&path, ReaderChoice::Native).expect("readable");
        let oracle = gdal_patch(&path, native.window).expect("readable");
        let (largest, mean) = worst_difference(&native, &oracle);
        println!("{name}: {reader}: differs by up to {largest}, {mean:.3} in the mean");
        assert_eq!((largest, mean), (0, 0.0), "{name}");
        assert_eq!(native.valid, oracle.valid, "{name}");
    }
}

fn same(got: &Patch, expected: &Patch, what: &str) {
    assert_eq!(got.window, expected.window, "{what}");
    assert_eq!(got.white, expected.white, "{what}");
    let pixels = got.rgb.iter().zip(&expected.rgb).zip(got.valid.iter().zip(&expected.valid));
    if let Some(i) = pixels.into_iter().position(|((a, b), (v, w))| a != b || v != w) {
        let (x, y) = (i as u64 % got.window.width, i as u64 / got.window.width);
        panic!(
            "{what}: pixel ({x}, {y}) of {:?} is {:?} {}, expected {:?} {}",
            got.window, got.rgb[i], got.valid[i], expected.rgb[i], expected.valid[i]
        );
    }
}

/// A few windows of any shape, the same each time.
fn some_windows(seed: usize, whole: Window) -> Vec<Window> {
    let mut draws = autoref_raster::random::Mmix(seed as u64 * 2_654_435_761 + 1);
    let mut below = |limit: u64| draws.below(limit as usize) as u64;
    let mut windows = vec![whole];
    for _ in 0..3 {
        let (x, y) = (below(whole.width), below(whole.height));
        windows.push(Window::new(x, y, 1 + below(whole.width - x), 1 + below(whole.height - y)));
    }
    windows
}

/// Every option list that differs in codec and predictor.
fn codecs() -> Vec<Vec<&'static str>> {
    let mut all = vec![vec!["COMPRESS=NONE"], vec!["COMPRESS=PACKBITS"]];
    for codec in ["COMPRESS=DEFLATE", "COMPRESS=LZW", "COMPRESS=ZSTD"] {
        all.extend([vec![codec, "PREDICTOR=1"], vec![codec, "PREDICTOR=2"]]);
    }
    all
}

const LAYOUTS: [&[&str]; 6] = [
    &["TILED=YES", "BLOCKXSIZE=64", "BLOCKYSIZE=48"],
    &["TILED=YES", "BLOCKXSIZE=16", "BLOCKYSIZE=16"],
    &["TILED=YES", "BLOCKXSIZE=256", "BLOCKYSIZE=256"],
    &["BLOCKYSIZE=1"],
    &["BLOCKYSIZE=7"],
    &["BLOCKYSIZE=157"],
];

/// The samples of an interleaved file as the `tiff` crate decodes them.
///
/// `None` where the crate does not take what GDAL wrote: it asks for an end code that GDAL's LZW leaves out when a
/// strip ends just where the codes grow.
fn tiff_crate_samples(path: &Path) -> Option<Vec<u16>> {
    let file = std::io::BufReader::new(std::fs::File::open(path).expect("it was just written"));
    let mut decoder = tiff::decoder::Decoder::new(file).expect("a TIFF");
    match decoder.read_image() {
        Ok(tiff::decoder::DecodingResult::U8(samples)) => Some(samples.into_iter().map(u16::from).collect()),
        Ok(tiff::decoder::DecodingResult::U16(samples)) => Some(samples),
        Err(error) if error.to_string().contains("no lzw end code") => None,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_layout_codec_depth_and_byte_order_decodes_to_the_same_samples() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (mut count, mut written, mut not_compared) = (0, 0, 0);
    for (a, bands) in [1, 3, 4, 5].into_iter().enumerate() {
        for sixteen in [false, true] {
            for (b, codec) in codecs().into_iter().enumerate() {
                for (c, layout) in LAYOUTS.into_iter().enumerate() {
                    for (d, interleave) in ["INTERLEAVE=PIXEL", "INTERLEAVE=BAND"].into_iter().enumerate() {
                        for order in ["ENDIANNESS=LITTLE", "ENDIANNESS=BIG"] {
                            count += 1;
                            // A quarter of the combinations, so that any bands, codec, layout and order meet, and any
                            // two options; all with AUTOREF_LARGE=1.
                            let turn = a + b + c + 2 * d + usize::from(sixteen) + usize::from(order.ends_with("BIG"));
                            if !crate::common::large() && !turn.is_multiple_of(4) {
                                continue;
                            }
                            written += 1;
                            let big = if count % 2 == 0 { "BIGTIFF=YES" } else { "BIGTIFF=NO" };
                            let options = [&codec[..], layout, &[interleave, order, big]].concat();
                            let kind = Kind::new(bands, sixteen, &options);
                            let what = format!("{bands} bands, 16 bit: {sixteen}, {options:?}");
                            let path = kind.write(folder.path(), "a.tif");
                            not_compared += usize::from(!check_against_truth(&path, &kind, count, &what));
                            std::fs::remove_file(path).expect("it is ours");
                        }
                    }
                }
            }
        }
    }
    println!("{written} files, {not_compared} of them not taken by the tiff crate");
    assert!(not_compared < written / 20);
}

fn check_against_truth(path: &Path, kind: &Kind, seed: usize, what: &str) -> bool {
    let source = open(path, ReaderChoice::Native, 0, CACHE).unwrap_or_else(|e| panic!("{what}: {e}"));
    assert_eq!(source.info().reader, "native");
    let whole = source.info().bounds();
    for window in some_windows(seed, whole) {
        let got = read_patch(&*source, window).unwrap_or_else(|e| panic!("{what}: {e}"));
        same(&got, &kind.truth(window), what);
    }
    let stats = source.stats();
    assert_eq!(stats.blocks_decoded, source.info().blocks, "{what}: each block once");
    assert_eq!(stats.blocks_skipped, 0, "{what}");
    // GDAL's reader on a sample of them: its own variety is in GDAL.
    if seed.is_multiple_of(7) {
        let source = open(path, ReaderChoice::Gdal, 0, CACHE).unwrap_or_else(|e| panic!("{what}: {e}"));
        for window in some_windows(seed + 1, whole) {
            same(&read_patch(&*source, window).expect("GDAL reads its own"), &kind.truth(window), what);
        }
    }
    // The tiff crate is built without ZSTD, reads only the first of separate planes, and mixes up bands beyond the
    // alpha.
    let has = |option: &str| kind.options.iter().any(|o| o == option);
    if has("INTERLEAVE=PIXEL") && !has("COMPRESS=ZSTD") && kind.bands < 5 {
        let Some(samples) = tiff_crate_samples(path) else {
            assert!(what.contains("LZW"), "{what}");
            return false;
        };
        assert_eq!(samples.len(), kind.width * kind.height * kind.bands);
        for (i, &sample) in samples.iter().enumerate() {
            let (pixel, band) = (i / kind.bands, i % kind.bands);
            assert_eq!(sample, kind.sample(pixel % kind.width, pixel / kind.width, band), "tiff crate: {what}");
        }
    }
    true
}

#[test]
fn jpeg_blocks_decode_as_gdal_decodes_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let layouts: [&[&str]; 3] =
        [&["TILED=YES", "BLOCKXSIZE=64", "BLOCKYSIZE=48"], &["BLOCKYSIZE=16"], &["BLOCKYSIZE=157"]];
    for layout in layouts {
        for (bands, photometric) in [(1, "MINISBLACK"), (3, "YCBCR"), (3, "RGB"), (4, "RGB")] {
            for interleave in ["INTERLEAVE=PIXEL", "INTERLEAVE=BAND"] {
                if photometric == "YCBCR" && interleave == "INTERLEAVE=BAND" {
                    continue;
                }
                let photometric = format!("PHOTOMETRIC={photometric}");
                let options = [layout, &["COMPRESS=JPEG", "JPEG_QUALITY=90", &photometric, interleave]].concat();
                let kind = Kind::new(bands, false, &options);
                let path = kind.write(folder.path(), "j.tif");
                let (got, reader) =
                    read_all(&path, ReaderChoice::Native).unwrap_or_else(|e| panic!("{options:?}: {e}"));
                let oracle = gdal_patch(&path, got.window).expect("GDAL reads its own");
                let (largest, mean) = worst_difference(&got, &oracle);
                println!("{options:?} {reader}: up to {largest}, {mean:.3} in the mean");
                // Of one and three components ours is libjpeg's arithmetic, as GDAL's is; interleaved fours are decoded
                // elsewhere.
                let ours = bands < 4 || interleave == "INTERLEAVE=BAND";
                let allowed = if ours { (0, 0.0) } else { (JPEG_LARGEST, JPEG_MEAN) };
                assert!(largest <= allowed.0 && mean <= allowed.1, "{options:?}");
            }
        }
    }
}

#[test]
fn strips_larger_than_the_cache_stream_by_rows() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for sixteen in [false, true] {
        for codec in codecs() {
            for rows in ["BLOCKYSIZE=157", "BLOCKYSIZE=60"] {
                let options = [&codec[..], &[rows]].concat();
                let kind = Kind { height: 2000, width: 400, ..Kind::new(3, sixteen, &options) };
                let options = kind.options.iter().map(|o| o.replace("157", "2000").replace("=60", "=1100")).collect();
                let kind = Kind { options, ..kind };
                let path = kind.write(folder.path(), "s.tif");
                // One strip has 1.3 or 4.8 MB, or between; of two the border lies within a window.
                let source = open(&path, ReaderChoice::Native, 0, 1 << 20).unwrap_or_else(|e| panic!("{codec:?}: {e}"));
                let plain = codec[0] == "COMPRESS=NONE";
                assert_eq!(source.info().sequential, !plain, "{codec:?}");
                assert!(source.info().chunk_bytes <= 600 << 10);
                for y in (0..2000).step_by(500) {
                    let window = Window::new(13, y, 380, 500);
                    same(&read_patch(&*source, window).expect("streams"), &kind.truth(window), &format!("{codec:?}"));
                }
                assert_eq!(source.stats().blocks_decoded, source.info().blocks, "{codec:?}: read once");
                // Going back costs a second run, but is right.
                let window = Window::new(0, 3, 400, 40);
                same(&read_patch(&*source, window).expect("streams"), &kind.truth(window), &format!("{codec:?}"));
            }
        }
    }
}

#[test]
fn one_jpeg_strip_larger_than_the_cache_goes_through_gdal_or_is_refused_with_numbers() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let kind = Kind { height: 4000, width: 400, ..Kind::new(3, false, &["COMPRESS=JPEG", "BLOCKYSIZE=4000"]) };
    let path = kind.write(folder.path(), "s.tif");
    let error = open(&path, ReaderChoice::Native, 0, 1 << 20).map(|_| ()).expect_err("JPEG strips do not stream");
    assert!(matches!(error, Error::Limit { needed: 4_800_000, .. }), "{error}");
    assert!(error.to_string().contains("gdal_translate"), "{error}");
    match open(&path, ReaderChoice::Auto, 0, 1 << 20) {
        Ok(source) => {
            assert_eq!(source.info().reader, "gdal");
            read_patch(&*source, Window::new(0, 0, 400, 100)).expect("GDAL reads its own");
        }
        Err(error) => assert!(matches!(error, Error::Limit { .. }), "{error}"),
    }
}

#[test]
fn blocks_that_the_file_does_not_hold_read_as_gdal_reads_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (bands, sixteen, nodata) in [
        (3, false, None),
        (3, false, Some(0.0)),
        (3, false, Some(255.0)),
        (1, true, Some(7.0)),
        (4, false, None),
        (4, true, None),
    ] {
        for interleave in ["INTERLEAVE=PIXEL", "INTERLEAVE=BAND"] {
            let options = ["TILED=YES", "BLOCKXSIZE=64", "BLOCKYSIZE=48", "COMPRESS=DEFLATE", interleave];
            let kind = Kind { width: 903, height: 757, sparse: true, nodata, ..Kind::new(bands, sixteen, &options) };
            let path = kind.write(folder.path(), "sparse.tif");
            let what = format!("{kind:?}");
            let source = open(&path, ReaderChoice::Native, 0, CACHE).unwrap_or_else(|e| panic!("{what}: {e}"));
            let whole = source.info().bounds();
            let got = read_patch(&*source, whole).expect("readable");
            same(&got, &kind.truth(whole), &what);
            let stats = source.stats();
            let planes = if interleave == "INTERLEAVE=BAND" { bands as u64 } else { 1 };
            assert_eq!((stats.blocks_decoded, stats.blocks_skipped), (planes, source.info().blocks - planes), "{what}");
            let gdal = open(&path, ReaderChoice::Gdal, 0, CACHE).expect("GDAL reads its own");
            same(&read_patch(&*gdal, whole).expect("readable"), &got, &what);
            // Sparse blocks that count as holding nothing are not even allocated.
            let empty = source.read(whole).expect("readable").pieces.iter().filter(|piece| piece.empty).count();
            assert_eq!(empty > 0, nodata.is_some() || bands == 4, "{what}");
        }
    }
}

#[test]
fn compressed_blocks_without_content_are_decoded_once() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (bands, sixteen, nodata) in
        [(3, false, Some(0.0)), (3, false, Some(255.0)), (4, false, None), (4, true, None), (1, true, Some(7.0))]
    {
        for codec in ["COMPRESS=DEFLATE", "COMPRESS=ZSTD", "COMPRESS=LZW"] {
            let options = ["TILED=YES", "BLOCKXSIZE=512", "BLOCKYSIZE=512", codec, "INTERLEAVE=PIXEL"];
            // One column of blocks holds ground, one ends in the collar, three are nothing else.
            let collar_from = Some(700);
            let kind = Kind { width: 2560, height: 1024, nodata, collar_from, ..Kind::new(bands, sixteen, &options) };
            let path = kind.write(folder.path(), "collar.tif");
            let what = format!("{kind:?}");
            let source = open(&path, ReaderChoice::Native, 0, CACHE).unwrap_or_else(|e| panic!("{what}: {e}"));
            let whole = source.info().bounds();
            let block = source.read(whole).expect("readable");
            let stats = source.stats();
            assert_eq!((stats.blocks_decoded, stats.blocks_skipped), (4 + 1, 6 - 1), "{what}");
            assert_eq!(block.pieces.iter().filter(|piece| piece.empty).count(), 6, "{what}");
            same(&block.to_patch(source.info()), &kind.truth(whole), &what);
        }
    }
    // Where no value means "nothing" black is a colour, and is decoded.
    let options = ["TILED=YES", "BLOCKXSIZE=512", "BLOCKYSIZE=512", "COMPRESS=DEFLATE", "INTERLEAVE=PIXEL"];
    let kind = Kind { width: 2560, height: 1024, collar_from: Some(700), ..Kind::new(3, false, &options) };
    let source = open(&kind.write(folder.path(), "black.tif"), ReaderChoice::Native, 0, CACHE).expect("readable");
    let whole = source.info().bounds();
    same(&read_patch(&*source, whole).expect("readable"), &kind.truth(whole), "black");
    assert_eq!(source.stats().blocks_skipped, 0);
}

#[test]
fn mapped_and_read_blocks_are_the_same() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for layout in LAYOUTS {
        let kind = Kind::new(3, false, &[layout, &["INTERLEAVE=PIXEL"]].concat());
        let path = kind.write(folder.path(), "m.tif");
        let directories = native::Directories::read(&path).expect("a TIFF");
        let read = native::open(&directories, 0, CACHE).expect("readable");
        let mapped = native::open_mapped(&directories, 0, CACHE).expect("readable");
        for window in some_windows(3, read.info().bounds()) {
            let expected = kind.truth(window);
            same(&read_patch(&read, window).expect("readable"), &expected, "read");
            same(&read_patch(&mapped, window).expect("readable"), &expected, "mapped");
        }
        assert_eq!(read.stats(), mapped.stats());
    }
}

/// GDAL's metadata may say that bands are in another order than TIFF's tags tell.
#[test]
fn bands_that_are_called_blue_green_red_are_read_as_gdal_reads_them() {
    use gdal::raster::ColorInterpretation::{AlphaBand, BlueBand, GreenBand, RedBand, Undefined};
    let folder = tempfile::tempdir().expect("a temporary folder");
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let orders = [
        vec![BlueBand, GreenBand, RedBand],
        vec![AlphaBand, RedBand, GreenBand, BlueBand],
        vec![Undefined, RedBand, GreenBand, BlueBand],
        vec![RedBand, GreenBand, BlueBand, Undefined],
    ];
    for (k, order) in orders.into_iter().enumerate() {
        let what = format!("{order:?}");
        let red = 10 + 60 * order.iter().position(|c| *c == RedBand).expect("there") as u16;
        let path = folder.path().join(format!("{k}.tif"));
        let options = gdal::raster::RasterCreationOptions::from_iter(["PHOTOMETRIC=MINISBLACK"]);
        let file = driver.create_with_band_type_with_options::<u8, _>(&path, 8, 8, order.len(), &options);
        let file = file.expect("created");
        for (b, colour) in order.into_iter().enumerate() {
            let mut band = file.rasterband(b + 1).expect("there");
            let level = if colour == AlphaBand { 255 } else { 10 + 60 * b as u8 };
            band.set_color_interpretation(colour).expect("set");
            band.write((0, 0), (8, 8), &mut gdal::raster::Buffer::new((8, 8), vec![level; 64])).expect("written");
        }
        file.close().expect("closed");
        let read = |choice| read_all(&path, choice).expect("readable").0;
        let (auto, through_gdal) = (read(ReaderChoice::Auto), read(ReaderChoice::Gdal));
        same(&auto, &through_gdal, &what);
        assert_eq!(auto.rgb[0][0], red, "{what}");
    }
}

#[test]
fn many_threads_read_each_block_once() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for options in
        [&["TILED=YES", "BLOCKXSIZE=64", "BLOCKYSIZE=48", "COMPRESS=LZW"][..], &["BLOCKYSIZE=3", "COMPRESS=ZSTD"]]
    {
        let kind = Kind { width: 900, height: 700, ..Kind::new(3, false, options) };
        let path = kind.write(folder.path(), "t.tif");
        for choice in [ReaderChoice::Native, ReaderChoice::Gdal] {
            let source = open(&path, choice, 0, CACHE).expect("readable");
            std::thread::scope(|scope| {
                for thread in 0..4 {
                    let (source, kind) = (&source, &kind);
                    scope.spawn(move || {
                        for window in some_windows(thread, source.info().bounds()) {
                            let got = read_patch(&**source, window).expect("readable");
                            same(&got, &kind.truth(window), "threads");
                        }
                    });
                }
            });
            assert_eq!(source.stats().blocks_decoded, source.info().blocks, "{choice:?}");
        }
    }
}

#[test]
fn what_is_no_image_gets_one_clear_line() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let put = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a temporary file");
        path
    };
    let kind = Kind::new(3, false, &["COMPRESS=DEFLATE", "TILED=YES", "BLOCKXSIZE=64", "BLOCKYSIZE=48"]);
    let whole = std::fs::read(kind.write(folder.path(), "whole.tif")).expect("it was just written");
    let cases = [
        (folder.path().to_path_buf(), "directory"),
        (put("empty.tif", b""), "empty"),
        (put("text.tif", b"this is a letter, not an image\n"), "GDAL"),
        (put("header_only.tif", b"II*\0"), "ends after 4 bytes"),
        (put("no_directory.tif", b"II*\0\0\0\0\0"), "no directory"),
        (put("beyond.tif", b"II*\0\xff\xff\xff\x7f"), "beyond the end"),
        (put("cut.tif", &whole[..whole.len() / 2]), "beyond the end"),
        (folder.path().join("missing.tif"), "No such file"),
    ];
    for (path, expected) in cases {
        for choice in [ReaderChoice::Auto, ReaderChoice::Gdal] {
            let error = open(&path, choice, 0, CACHE).map(|source| source.info().clone());
            let Err(error) = error else {
                // A file that is cut off in its pixels opens in GDAL; the blocks beyond are errors then.
                assert_eq!((choice, expected), (ReaderChoice::Gdal, "beyond the end"), "{}", path.display());
                continue;
            };
            is_clear_line(&path, &error);
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}

/// A little-endian TIFF of one directory at byte 8 with entries (tag, type, count, value), then `data`.
fn tiny_tiff(entries: &[(u16, u16, u32, u32)], next: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"II*\0\x08\0\0\0".to_vec();
    bytes.extend((entries.len() as u16).to_le_bytes());
    for &(tag, kind, count, value) in entries {
        bytes.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        bytes.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
    }
    bytes.extend(next.to_le_bytes());
    bytes.extend(data);
    bytes
}

#[test]
fn headers_that_lie_cost_neither_memory_nor_time() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("liar.tif");
    let zeros = libdeflater_zeros(3 << 20);
    let million = 1 << 20;
    // Width, height, bits, compression, photometric, offset, samples, rows a strip, byte count.
    let at = 8 + 2 + 9 * 12 + 4;
    let image = |width: u32, height: u32, compression: u32, offset: (u32, u32), count: (u32, u32)| {
        [
            (256, 4, 1, width),
            (257, 4, 1, height),
            (258, 3, 1, 8),
            (259, 3, 1, compression),
            (262, 3, 1, 1),
            (273, 4, offset.0, offset.1),
            (277, 3, 1, 1),
            (278, 4, 1, height),
            (279, 4, count.0, count.1),
        ]
    };
    let length = zeros.len() as u32;
    let write = |entries: &[(u16, u16, u32, u32)], next| {
        std::fs::write(&path, tiny_tiff(entries, next, &zeros)).expect("a temporary file");
        native::Directories::read(&path).expect("the directory is sound")
    };
    for compression in [1, 5, 7, 8, 32_773, 50_000] {
        // A million by a million pixels in one strip of a few kilobytes.
        let all = write(&image(million, million, compression, (1, at), (1, length)), 0);
        let Err(error) = native::open(&all, 0, 8 << 20).and_then(|source| {
            let patch = read_patch(&source, Window::new(5, 5, 100, 10))?;
            // Deflate holds three rows of zeros, so the first windows are there.
            read_patch(&source, Window::new(5, 500, patch.window.width, 10))
        }) else {
            panic!("compression {compression}: the pixels are not there")
        };
        is_clear_line(&path, &error);
    }
    // More offsets than the file has bytes.
    let all = write(&image(10, 10, 8, (u32::MAX, 8), (1, length)), 0);
    is_clear_line(&path, &native::open(&all, 0, CACHE).map(|_| ()).expect_err("the offsets are not there"));
    // A block that decodes to more than its image needs, in a directory that follows itself.
    let all = write(&image(100, 40, 8, (1, at), (1, length)), 8);
    assert!(all.broken_tail.as_ref().is_some_and(|what| what.contains("circle")));
    let source = native::open(&all, 0, CACHE).expect("the first directory is sound");
    let patch = read_patch(&source, Window::whole(100, 40)).expect("enough data");
    assert!(patch.rgb.iter().all(|&pixel| pixel == [0; 3]));
    assert!(peak_bytes() < 600 << 20);
}

fn libdeflater_zeros(count: usize) -> Vec<u8> {
    let mut compressor = libdeflater::Compressor::new(libdeflater::CompressionLvl::default());
    let mut out = vec![0; compressor.zlib_compress_bound(count)];
    let length = compressor.zlib_compress(&vec![0; count], &mut out).expect("the bound holds");
    out.truncate(length);
    out
}
