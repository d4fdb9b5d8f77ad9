//! The edit and its undoing, stopped at every byte: the file is always the old or the new image.

use std::io;
use std::path::{Path, PathBuf};

use super::journal::{self, Plan};
use super::store::Store;
use super::{TagOptions, prepare};
use autoref_raster::ReaderChoice;
use autoref_raster::coords::GeoTransform;
use autoref_raster::crs::Crs;

const OLD: GeoTransform = GeoTransform([10.0, 2.0, 0.0, 20.0, 0.0, -2.0]);
const NEW: GeoTransform = GeoTransform([570_000.25, 0.03, -0.004, 7_032_000.5, -0.004, -0.03]);

/// What was done to a file, in order.
#[derive(Clone, Debug)]
enum Step {
    Write(u64, Vec<u8>),
    Length(u64),
    Sync,
}

/// A file in memory that remembers what was done to it, and refuses the step with a given number.
struct Remembering {
    bytes: Vec<u8>,
    steps: Vec<Step>,
    fails_at: Option<usize>,
}

impl Remembering {
    fn new(bytes: Vec<u8>, fails_at: Option<usize>) -> Self {
        Remembering { bytes, steps: Vec::new(), fails_at }
    }

    fn step(&mut self, step: Step) -> io::Result<()> {
        let fails = self.fails_at == Some(self.steps.len());
        self.steps.push(step.clone());
        match step {
            Step::Write(at, mut bytes) => {
                if fails {
                    // Half of it arrives.
                    bytes.truncate(bytes.len() / 2);
                }
                let end = at as usize + bytes.len();
                self.bytes.resize(self.bytes.len().max(end), 0);
                self.bytes[at as usize..end].copy_from_slice(&bytes);
            }
            Step::Length(length) if !fails => self.bytes.resize(length as usize, 0),
            Step::Length(_) | Step::Sync => {}
        }
        if fails { Err(io::Error::other("no space left on device")) } else { Ok(()) }
    }
}

impl Store for Remembering {
    fn length(&self) -> io::Result<u64> {
        Ok(self.bytes.len() as u64)
    }
    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        let range = at as usize..at as usize + out.len();
        out.copy_from_slice(self.bytes.get(range).ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }
    fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.step(Step::Write(at, bytes.to_vec()))
    }
    fn set_length(&mut self, length: u64) -> io::Result<()> {
        self.step(Step::Length(length))
    }
    fn sync(&mut self) -> io::Result<()> {
        self.step(Step::Sync)
    }
}

/// Every state in which a crash may leave the file: after each step, after each byte of a longer write, and, as long as
/// no sync has come between, with sectors of a longer write that never arrived.
fn states(before: &[u8], steps: &[Step]) -> Vec<Vec<u8>> {
    let mut now = before.to_vec();
    let mut states = vec![now.clone()];
    for step in steps {
        match step {
            Step::Write(at, bytes) => {
                let at = *at as usize;
                // Up to eight bytes in one sector are written whole; that this one is such a write is checked here.
                let whole = bytes.len() <= 8;
                if whole {
                    assert_eq!(at / 512, (at + bytes.len() - 1) / 512, "the switch lies in two sectors");
                }
                let unaltered = now.clone();
                now.resize(now.len().max(at + bytes.len()), 0);
                for (index, &byte) in bytes.iter().enumerate() {
                    now[at + index] = byte;
                    if !whole {
                        let mut torn = now.clone();
                        torn.truncate(unaltered.len().max(at + index + 1));
                        states.push(torn);
                    }
                }
                if !whole {
                    for sector in (0..bytes.len()).step_by(512) {
                        let mut lost = now.clone();
                        let end = (at + sector + 512).min(now.len());
                        lost[at + sector..end].fill(0);
                        lost[at + sector..]
                            .iter_mut()
                            .zip(unaltered.iter().skip(at + sector))
                            .take(512)
                            .for_each(|(byte, old)| *byte = *old);
                        states.push(lost);
                    }
                }
            }
            Step::Length(length) => now.resize(*length as usize, 0),
            Step::Sync => {}
        }
        states.push(now.clone());
    }
    states
}

/// Which of the two it is, by GDAL; by our reader too, the pixels of which must be right.
fn which(bytes: &[u8], file: &Path, pixels: &[[u16; 3]]) -> GeoTransform {
    let memory = PathBuf::from(format!("/vsimem/autoref-fault-{}.tif", std::process::id()));
    gdal::vsi::create_mem_file(&memory, bytes.to_vec()).expect("memory");
    let dataset = gdal::Dataset::open(&memory).expect("GDAL opens every state");
    let read = GeoTransform(dataset.geo_transform().expect("georeferenced"));
    drop(dataset);
    gdal::vsi::unlink_mem_file(&memory).expect("it was made above");
    std::fs::write(file, bytes).expect("writable");
    let source =
        autoref_raster::open(file, ReaderChoice::Native, 0, 1 << 20).expect("the native reader opens every state");
    let patch = autoref_raster::read_patch(source.as_ref(), source.info().bounds()).expect("readable");
    assert!(patch.rgb == pixels, "pixels are wrong");
    assert_eq!(source.info().geotransform.map(near), Some(near(read)), "the readers disagree");
    near(read)
}

/// Rounded, since GDAL divides and multiplies.
fn near(transform: GeoTransform) -> GeoTransform {
    GeoTransform(transform.0.map(|v| (v * 1e6).round() / 1e6))
}

fn sample(path: &Path, options: &[&str], cog: bool) {
    autoref_raster::initialise_gdal(0);
    let memory = gdal::DriverManager::get_driver_by_name("MEM").expect("there");
    let mut dataset = memory.create_with_band_type::<u8, _>("", 40, 24, 3).expect("created");
    for band in 1..=3 {
        let pixels = (0..40 * 24).map(|i| (i * (band + 6) % 251) as u8).collect();
        let mut buffer = gdal::raster::Buffer::new((40, 24), pixels);
        dataset.rasterband(band).expect("there").write((0, 0), (40, 24), &mut buffer).expect("written");
    }
    dataset.set_geo_transform(&OLD.0).expect("settable");
    let driver = gdal::DriverManager::get_driver_by_name(if cog { "COG" } else { "GTiff" }).expect("there");
    let options = gdal::raster::RasterCreationOptions::from_iter(options.iter().copied());
    dataset.create_copy(&driver, path, &options).expect("copied").close().expect("written");
}

#[test]
fn a_crash_at_any_byte_leaves_the_old_or_the_new_image() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let crs = Crs::from_epsg(25832).expect("known");
    let kinds: [(&[&str], bool); 3] = [
        (&["COMPRESS=DEFLATE", "ENDIANNESS=BIG"], false),
        (&["BIGTIFF=YES", "TILED=YES", "BLOCKXSIZE=16", "BLOCKYSIZE=16"], false),
        (&["COMPRESS=LZW"], true),
    ];
    for (number, (options, cog)) in kinds.into_iter().enumerate() {
        let (path, trial) = (folder.path().join(format!("{number}.tif")), folder.path().join("trial.tif"));
        sample(&path, options, cog);
        let source = autoref_raster::open(&path, ReaderChoice::Native, 0, 1 << 20).expect("opens");
        let pixels = autoref_raster::read_patch(source.as_ref(), source.info().bounds()).expect("readable").rgb;
        let before = std::fs::read(&path).expect("readable");
        let (edit, _) = prepare(&path, 0, &NEW, Some(&crs), &TagOptions { break_cog: true }).expect("it takes tags");
        let mut store = Remembering::new(before.clone(), None);
        edit.plan.apply(&mut store).expect("nothing fails");
        let after = store.bytes.clone();
        check_states(&before, &store.steps, &trial, &pixels, [OLD, NEW]);
        let record = journal::read(&path, &store).expect("our record");
        let mut store = Remembering::new(after.clone(), None);
        journal::undo(&mut store, &record).expect("nothing fails");
        assert!(store.bytes == before, "undone byte for byte");
        check_states(&after, &store.steps, &trial, &pixels, [NEW, OLD]);
        undo_is_repeatable(&before, &after, &store.steps);
        refused_by_the_system(&before, &edit.plan);
    }
}

fn check_states(before: &[u8], steps: &[Step], trial: &Path, pixels: &[[u16; 3]], [first, last]: [GeoTransform; 2]) {
    let mut switched = false;
    for state in states(before, steps) {
        let seen = which(&state, trial, pixels);
        assert!(seen == near(if switched { last } else { first }) || (!switched && seen == near(last)));
        switched |= seen == near(last);
    }
    assert!(switched, "the last state is the new one");
}

/// A second undo after a crash in the first leads to the same file.
fn undo_is_repeatable(before: &[u8], after: &[u8], steps: &[Step]) {
    let path = Path::new("in memory");
    for state in states(after, steps) {
        let mut store = Remembering::new(state, None);
        match journal::read(path, &store) {
            Ok(record) => {
                journal::undo(&mut store, &record).expect("nothing fails");
                assert!(store.bytes == before);
            }
            // Only a file that is restored has no record any more.
            Err(error) => assert!(store.bytes == before, "{error}"),
        }
    }
}

/// An error (not a crash) at any step leaves the file byte for byte as it was.
fn refused_by_the_system(before: &[u8], plan: &Plan) {
    let mut complete = Remembering::new(before.to_vec(), None);
    plan.apply(&mut complete).expect("nothing fails");
    for step in 0..complete.steps.len() {
        let mut store = Remembering::new(before.to_vec(), Some(step));
        plan.apply(&mut store).expect_err("this step fails");
        assert!(store.bytes == before, "step {step} of {} left something", complete.steps.len());
    }
}
