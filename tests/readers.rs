//! The native TIFF reader against GDAL and the `tiff` crate: every layout, codec, depth and byte order gives the same
//! samples; odd and broken files give the right answer or one clear line.

mod readers_oracle;

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use autoref_stream::Error;
use autoref_stream::raster::{Patch, ReaderChoice, open, read_patch};
use autoref_stream::window::Window;
use readers_oracle::{gdal_patch, worst_difference};

const CACHE: u64 = 64 << 20;
/// JPEG decoders may differ: by rounding in the inverse transform and in the colour conversion, and by how colour
/// differences are brought to full size. Largest and mean difference of one sample that is accepted.
const JPEG_LARGEST: u16 = 12;
const JPEG_MEAN: f64 = 0.6;

fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(name);
    if !path.exists() {
        println!("skipped: {} is not there", path.display());
        return None;
    }
    Some(path)
}

fn read_all(path: &Path, choice: ReaderChoice) -> Result<(Patch, String), Error> {
    let source = open(path, choice, 0, CACHE)?;
    let info = source.info();
    let whole = info.bounds();
    // Of a giant only a corner and the middle.
    let window = match whole.area() > 60_000_000 {
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
    assert!(peak_bytes() < 1 << 30);
}

#[test]
fn photographs_read_alike_natively_and_through_gdal() {
    for name in ["river_town_oam", "savanna_oam", "canal_pdok_tiled_jpeg", "suburb_vegas_uint16", "oak_sjer_neon"] {
        let Some(path) = shared(&format!("photos/{name}.tif")) else { continue };
        let (native, reader) = read_all(&path, ReaderChoice::Native).expect("readable");
        let oracle = gdal_patch(&path, native.window).expect("readable");
        let (largest, mean) = worst_difference(&native, &oracle);
        println!("{name}: {reader}: differs by up to {largest}, {mean:.3} in the mean");
        let allowed = if reader.contains("JPEG") { (JPEG_LARGEST, JPEG_MEAN) } else { (0, 0.0) };
        assert!(largest <= allowed.0 && mean <= allowed.1, "{name}");
        assert_eq!(native.valid, oracle.valid, "{name}");
    }
}
