//! How near is reading a file to the speed of its codec alone, and how far from GDAL?
//!
//! For each layout, in processor time of one thread (so that other work on the machine does not count) and with the
//! file in the page cache: `ours` reads every pixel in windows and looks at one byte in each cache line; `codec` only
//! decompresses the same blocks from memory (no predictor, no file, no cache, for LZW with weezl); `gdal` reads the
//! same windows through the GDAL reader. Excluded: opening. The picture is a photograph under ../shared/data, or the
//! file in AUTOREF_BENCH_FILE; without either the bench says so and ends.

use std::hint::black_box;
use std::path::{Path, PathBuf};

use autoref_raster::tiff::container::tag;
use autoref_raster::window::Window;
use autoref_raster::{RasterSource, ReaderChoice, Samples, open, tiff as native};
use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use gdal::raster::RasterCreationOptions;
use gdal::{Dataset, DriverManager};

const CACHE: u64 = 64 << 20;

const CASES: [(&str, &[&str]); 6] = [
    ("plain_tiles512", &["TILED=YES", "BLOCKXSIZE=512", "BLOCKYSIZE=512"]),
    ("plain_strips", &["BLOCKYSIZE=1"]),
    ("deflate2_tiles512", &["TILED=YES", "BLOCKXSIZE=512", "BLOCKYSIZE=512", "COMPRESS=DEFLATE", "PREDICTOR=2"]),
    ("zstd2_tiles256", &["TILED=YES", "COMPRESS=ZSTD", "PREDICTOR=2"]),
    ("lzw2_row_strips", &["BLOCKYSIZE=1", "COMPRESS=LZW", "PREDICTOR=2"]),
    ("jpeg_tiles512", &["TILED=YES", "BLOCKXSIZE=512", "BLOCKYSIZE=512", "COMPRESS=JPEG", "PHOTOMETRIC=YCBCR"]),
];

/// Processor time of this thread, in nanoseconds.
struct ThreadTime;

impl Measurement for ThreadTime {
    type Intermediate = u64;
    type Value = u64;

    fn start(&self) -> u64 {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
    }
    fn end(&self, start: u64) -> u64 {
        self.start() - start
    }
    fn add(&self, a: &u64, b: &u64) -> u64 {
        a + b
    }
    fn zero(&self) -> u64 {
        0
    }
    fn to_f64(&self, value: &u64) -> f64 {
        *value as f64
    }
    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}

fn picture() -> Option<PathBuf> {
    let given = std::env::var_os("AUTOREF_BENCH_FILE").map(PathBuf::from);
    let photograph = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/photos/village_boruszyn.jpg");
    given.or(Some(photograph.into())).filter(|path| path.exists())
}

fn make(picture: &Path, folder: &Path, name: &str, options: &[&str]) -> PathBuf {
    let path = folder.join(format!("{name}.tif"));
    let mut list = RasterCreationOptions::new();
    for option in options {
        let (key, value) = option.split_once('=').expect("KEY=VALUE");
        list.set_name_value(key, value).expect("no zero bytes");
    }
    let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has GeoTIFF");
    let source = Dataset::open(picture).expect("the picture opens");
    source.create_copy(&driver, &path, &list).expect("GDAL writes").close().expect("GDAL writes");
    path
}

/// Reads everything and looks at one byte in each cache line.
fn look(source: &dyn RasterSource) -> u64 {
    let whole = source.info().bounds();
    let mut sum = 0;
    for y in (0..whole.height).step_by(512) {
        let block = source.read(Window::new(0, y, whole.width, 512).intersect(&whole)).expect("readable");
        for piece in &block.pieces {
            for y in piece.window.y..piece.window.bottom() {
                match piece.row(piece.window.x, y, piece.window.width).samples {
                    Samples::U8(row) => sum += row.iter().step_by(64).map(|&v| u64::from(v)).sum::<u64>(),
                    Samples::U16(row) => sum += row.iter().step_by(32).map(|&v| u64::from(v)).sum::<u64>(),
                }
            }
        }
    }
    sum
}

/// The blocks of a file as they are in it, and the decoded size of a whole one.
fn blocks(path: &Path) -> (Vec<Vec<u8>>, usize) {
    let all = native::Directories::read(path).expect("a TIFF");
    let number = |tag| all.first(0, tag).expect("a readable tag");
    let numbers =
        |a, b| all.numbers(0, a).expect("a readable tag").or_else(|| all.numbers(0, b).expect("a readable tag"));
    let offsets = numbers(tag::TILE_OFFSETS, tag::STRIP_OFFSETS).expect("blocks");
    let counts = numbers(tag::TILE_BYTE_COUNTS, tag::STRIP_BYTE_COUNTS).expect("blocks");
    let file = std::fs::read(path).expect("readable");
    let mut list: Vec<_> =
        offsets.iter().zip(&counts).map(|(&o, &c)| file[o as usize..(o + c) as usize].to_vec()).collect();
    if let Some((_, tables)) = all.raw(0, tag::JPEG_TABLES).expect("a readable tag") {
        list.iter_mut().for_each(|data| *data = [&tables[..tables.len() - 2], &data[2..]].concat());
    }
    let width = number(tag::TILE_WIDTH).or(number(tag::IMAGE_WIDTH)).expect("a width");
    let height = number(tag::TILE_LENGTH).or(number(tag::ROWS_PER_STRIP)).expect("a height");
    (list, (width * height * 3) as usize)
}

/// Only decompresses.
fn codec_alone(name: &str, blocks: &[Vec<u8>], size: usize) {
    let mut out = vec![0; size];
    let mut deflate = libdeflater::Decompressor::new();
    let mut zstd = zstd::bulk::Decompressor::new().expect("memory");
    let mut lzw = weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
    for data in blocks {
        match name.split('_').next() {
            Some("deflate2") => assert_eq!(deflate.zlib_decompress(data, &mut out), Ok(size)),
            Some("zstd2") => assert_eq!(zstd.decompress_to_buffer(data, &mut out).expect("sound"), size),
            Some("lzw2") => {
                lzw.reset();
                let (mut read, mut written) = (0, 0);
                while written < size {
                    let result = lzw.decode_bytes(&data[read..], &mut out[written..]);
                    assert!(result.status.is_ok() && result.consumed_in + result.consumed_out > 0);
                    (read, written) = (read + result.consumed_in, written + result.consumed_out);
                }
            }
            Some("jpeg") => {
                let options = zune_jpeg::zune_core::options::DecoderOptions::new_fast();
                let stream = zune_jpeg::zune_core::bytestream::ZCursor::new(&data[..]);
                let mut decoder = zune_jpeg::JpegDecoder::new_with_options(stream, options);
                decoder.decode_into(&mut out).expect("sound");
            }
            _ => out[..data.len()].copy_from_slice(data),
        }
        black_box(&out);
    }
}

fn decode(c: &mut Criterion<ThreadTime>) {
    let Some(picture) = picture() else {
        println!("no picture: set AUTOREF_BENCH_FILE");
        return;
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, options) in CASES {
        let path = make(&picture, folder.path(), name, options);
        let mut group = c.benchmark_group(name);
        let ours = open(&path, ReaderChoice::Native, 0, CACHE).expect("readable");
        let gdal = open(&path, ReaderChoice::Gdal, 0, CACHE).expect("readable");
        assert_eq!(look(&*ours), look(&*gdal), "{name}");
        group.throughput(Throughput::Bytes(ours.info().pixels() * 3)).sample_size(10);
        // A reader whose cache is too small to answer the second run from memory.
        let cache = ours.info().chunk_bytes;
        group.bench_function("ours", |b| {
            let source = open(&path, ReaderChoice::Native, 0, cache.max(8 << 20)).expect("readable");
            b.iter(|| look(&*source));
        });
        if name.starts_with("plain") {
            let directories = native::Directories::read(&path).expect("a TIFF");
            let source = native::open_mapped(&directories, 0, 8 << 20).expect("readable");
            group.bench_function("ours mapped", |b| b.iter(|| look(&source)));
        }
        let (list, size) = blocks(&path);
        group.bench_function("codec", |b| b.iter(|| codec_alone(name, &list, size)));
        group.bench_function("gdal", |b| {
            b.iter(|| look(&*open(&path, ReaderChoice::Gdal, 0, 8 << 20).expect("readable")));
        });
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().with_measurement(ThreadTime);
    targets = decode
}
criterion_main!(benches);
