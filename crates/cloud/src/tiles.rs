//! Points outside memory: spooled in the order of the file, then sorted into tiles of neighbouring points in one
//! scratch folder. A tile is a run of records in a file; how points are shared out never changes a result, only the
//! time.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::error::{Error, Result};
use crate::kdtree::{self, Bounds, Tree};
use crate::point::{Point, RECORD_BYTES};
use crate::schema::array;

/// Cells along each side of the histogram by which points are shared out.
const CELLS: usize = 256;
/// Points of one read when a file is streamed.
const STREAM_POINTS: usize = 1 << 15;

fn encode_all(points: &[Point]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(points.len() * RECORD_BYTES);
    points.iter().for_each(|point| bytes.extend_from_slice(&point.encode()));
    bytes
}

/// A run of points in a scratch file.
#[derive(Clone, Debug)]
pub struct Tile {
    file: Arc<File>,
    /// Records before it in the file.
    begin: u64,
    pub points: usize,
    /// Points at the begin of the run that are active and in the order of a tree.
    pub active: usize,
    /// Of the active points.
    pub bounds: Bounds,
    /// Points in the tiles before this one.
    pub before: u64,
}

/// The scratch folder of one cloud, removed when dropped.
pub struct Scratch {
    folder: PathBuf,
}

impl Scratch {
    /// Files will be made in `parent`.
    ///
    /// # Errors
    /// When none can be made there.
    pub fn new(parent: &Path) -> Result<Scratch> {
        let scratch = Scratch { folder: parent.to_path_buf() };
        scratch.file()?;
        Ok(scratch)
    }

    /// A new file without a name: nothing is left behind, whatever ends the program.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn file(&self) -> Result<File> {
        tempfile::tempfile_in(&self.folder).map_err(|e| Error::io(&self.folder, "make a scratch file in", e))
    }

    /// An error of a scratch file.
    pub fn error(&self, action: &str, source: std::io::Error) -> Error {
        Error::io(&self.folder, action, source)
    }
}

/// Takes points in the file's order.
pub struct Spool {
    file: BufWriter<File>,
    pub points: u64,
    /// One more than the largest index: points of the file that were left out count, too.
    pub indices: u64,
    pub bounds: Bounds,
}

impl Spool {
    /// # Errors
    /// When the scratch file cannot be made.
    pub fn new(scratch: &mut Scratch) -> Result<Spool> {
        Ok(Spool {
            file: BufWriter::with_capacity(1 << 20, scratch.file()?),
            points: 0,
            indices: 0,
            bounds: Bounds::EMPTY,
        })
    }

    /// # Errors
    /// When the scratch disk is full.
    pub fn push(&mut self, scratch: &Scratch, point: &Point) -> Result<()> {
        self.bounds.add(point.xyz);
        self.points += 1;
        self.indices = self.indices.max(point.index() + 1);
        self.file.write_all(&point.encode()).map_err(|e| scratch.error("write scratch data to", e))
    }
}

/// A cloud in tiles.
pub struct Tiles {
    pub scratch: Scratch,
    pub tiles: Vec<Tile>,
    pub points: u64,
    /// Points of the file, also those that were left out.
    pub indices: u64,
    pub bounds: Bounds,
}

impl Tiles {
    /// Shares out spooled points among tiles of at most `most_points` each.
    ///
    /// # Errors
    /// When the scratch disk is full.
    pub fn new(mut scratch: Scratch, spool: Spool, most_points: usize) -> Result<Tiles> {
        let Spool { file, points, indices, bounds } = spool;
        let file = file.into_inner().map_err(|e| scratch.error("write scratch data to", e.into_error()))?;
        let whole = Tile { file: Arc::new(file), begin: 0, points: points as usize, active: 0, bounds, before: 0 };
        let mut tiles = Vec::new();
        share_out(&mut scratch, whole, most_points.max(1), &mut tiles)?;
        let mut before = 0;
        for tile in &mut tiles {
            tile.before = before;
            before += tile.points as u64;
        }
        Ok(Tiles { scratch, tiles, points, indices, bounds })
    }

    /// The points of a tile.
    ///
    /// # Errors
    /// When the scratch file cannot be read.
    pub fn load(&self, tile: usize) -> Result<Vec<Point>> {
        let tile = &self.tiles[tile];
        read(&tile.file, tile.begin, tile.points).map_err(|e| self.scratch.error("read scratch data from", e))
    }

    /// The tree of a tile's active points; [`Tiles::prepare`] must have run.
    ///
    /// # Errors
    /// When the scratch file cannot be read.
    pub fn tree(&self, tile: usize) -> Result<Tree> {
        let tile = &self.tiles[tile];
        let points =
            read(&tile.file, tile.begin, tile.active).map_err(|e| self.scratch.error("read scratch data from", e))?;
        Ok(Tree::new(points, tile.bounds))
    }

    fn store(&self, tile: usize, points: &[Point]) -> Result<()> {
        let tile = &self.tiles[tile];
        tile.file
            .write_all_at(&encode_all(points), tile.begin * RECORD_BYTES as u64)
            .map_err(|e| self.scratch.error("write scratch data to", e))
    }

    /// As [`Tiles::update`], for changes that need scratch files.
    ///
    /// # Errors
    /// Those of `change`, and of the scratch disk.
    pub fn update_with_scratch(&self, mut change: impl FnMut(&Scratch, &mut [Point]) -> Result<bool>) -> Result<()> {
        self.update(|_, points| change(&self.scratch, points))
    }

    /// Lets `change` see and change all points, tile by tile. Only tags may change between two calls of
    /// [`Tiles::prepare`], and the order must stay.
    ///
    /// # Errors
    /// Those of `change`, and of the scratch disk.
    pub fn update(&self, mut change: impl FnMut(usize, &mut [Point]) -> Result<bool>) -> Result<()> {
        for tile in 0..self.tiles.len() {
            let mut points = self.load(tile)?;
            if change(tile, &mut points)? {
                self.store(tile, &points)?;
            }
        }
        Ok(())
    }

    /// Brings the active points of every tile to its begin and into the order of a tree.
    ///
    /// # Errors
    /// Those of the scratch disk.
    pub fn prepare(&mut self) -> Result<()> {
        for number in 0..self.tiles.len() {
            let mut points = self.load(number)?;
            let mut active = 0;
            for at in 0..points.len() {
                if points[at].is_active() {
                    points.swap(at, active);
                    active += 1;
                }
            }
            let bounds = Bounds::of(&points[..active]);
            kdtree::arrange(&mut points[..active], bounds);
            self.store(number, &points)?;
            self.tiles[number].active = active;
            self.tiles[number].bounds = bounds;
        }
        Ok(())
    }
}

fn read(file: &File, begin: u64, points: usize) -> std::io::Result<Vec<Point>> {
    let mut all = Vec::with_capacity(points);
    let mut bytes = vec![0; STREAM_POINTS.min(points) * RECORD_BYTES];
    while all.len() < points {
        let count = STREAM_POINTS.min(points - all.len());
        let bytes = &mut bytes[..count * RECORD_BYTES];
        file.read_exact_at(bytes, (begin + all.len() as u64) * RECORD_BYTES as u64)?;
        all.extend(bytes.chunks_exact(RECORD_BYTES).map(Point::decode));
    }
    Ok(all)
}

/// Streams a run of points.
fn stream(scratch: &Scratch, run: &Tile, mut each: impl FnMut(&Point) -> Result<()>) -> Result<()> {
    let mut done = 0;
    while done < run.points {
        let count = STREAM_POINTS.min(run.points - done);
        let points =
            read(&run.file, run.begin + done as u64, count).map_err(|e| scratch.error("read scratch data from", e))?;
        points.iter().try_for_each(&mut each)?;
        done += count;
    }
    Ok(())
}

/// Appends `run` to `tiles`, in parts of at most `most_points`.
fn share_out(scratch: &mut Scratch, run: Tile, most_points: usize, tiles: &mut Vec<Tile>) -> Result<()> {
    if run.points <= most_points {
        tiles.push(run);
        return Ok(());
    }
    let mut bounds = Bounds::EMPTY;
    stream(scratch, &run, |point| {
        bounds.add(point.xyz);
        Ok(())
    })?;
    let side = |axis: usize| bounds.max[axis] - bounds.min[axis];
    let mut axes = [0, 1, 2];
    axes.sort_by(|&a, &b| side(b).total_cmp(&side(a)));
    if side(axes[0]) <= 0.0 {
        // All at one place: any cut is as good.
        let mut begin = 0;
        while begin < run.points {
            let points = most_points.min(run.points - begin);
            tiles.push(Tile { begin: run.begin + begin as u64, points, bounds, ..run.clone() });
            begin += points;
        }
        return Ok(());
    }
    let cell = |point: &Point| {
        let along = |axis: usize| {
            let extent = side(axis);
            let share = if extent > 0.0 { (point.xyz[axis] - bounds.min[axis]) / extent } else { 0.0 };
            ((share * CELLS as f64) as usize).min(CELLS - 1)
        };
        along(axes[1]) * CELLS + along(axes[0])
    };
    let mut counts = vec![0u64; CELLS * CELLS];
    stream(scratch, &run, |point| {
        counts[cell(point)] += 1;
        Ok(())
    })?;
    let mut owner = vec![0u32; CELLS * CELLS];
    let mut sizes = Vec::new();
    let whole = Rectangle { x: (0, CELLS), y: (0, CELLS) };
    cut(&counts, whole, run.points as u64, most_points as u64, &mut owner, &mut sizes);

    let file = Arc::new(scratch.file()?);
    let parts = distribute(scratch, &run, &file, &sizes, |point| owner[cell(point)] as usize)?;
    // The run's file is let go before its parts are cut further.
    drop(run);
    for part in parts {
        share_out(scratch, part, most_points, tiles)?;
    }
    Ok(())
}

/// Copies the points of `run` into `file`, part after part.
fn distribute(
    scratch: &Scratch,
    run: &Tile,
    file: &Arc<File>,
    sizes: &[u64],
    part_of: impl Fn(&Point) -> usize,
) -> Result<Vec<Tile>> {
    let mut begins = Vec::with_capacity(sizes.len());
    let mut total = 0;
    for &size in sizes {
        begins.push(total);
        total += size;
    }
    let buffer_bytes = ((32 << 20) / sizes.len()).clamp(4 << 10, 256 << 10);
    let mut buffers: Vec<Vec<u8>> = vec![Vec::new(); sizes.len()];
    let mut next = begins.clone();
    let flush = |buffer: &mut Vec<u8>, next: &mut u64| {
        let done = file.write_all_at(buffer, *next * RECORD_BYTES as u64);
        *next += (buffer.len() / RECORD_BYTES) as u64;
        buffer.clear();
        done.map_err(|e| scratch.error("write scratch data to", e))
    };
    stream(scratch, run, |point| {
        let part = part_of(point);
        buffers[part].extend_from_slice(&point.encode());
        if buffers[part].len() >= buffer_bytes { flush(&mut buffers[part], &mut next[part]) } else { Ok(()) }
    })?;
    for (buffer, next) in buffers.iter_mut().zip(&mut next) {
        flush(buffer, next)?;
    }
    let parts = begins.iter().zip(sizes).filter(|(_, size)| **size > 0);
    Ok(parts
        .map(|(&begin, &size)| Tile {
            file: Arc::clone(file),
            begin,
            points: size as usize,
            active: 0,
            bounds: Bounds::EMPTY,
            before: 0,
        })
        .collect())
}

#[derive(Clone, Copy)]
struct Rectangle {
    x: (usize, usize),
    y: (usize, usize),
}

/// Halves a rectangle of cells by its points until every part is small enough or one cell.
fn cut(counts: &[u64], area: Rectangle, points: u64, most: u64, owner: &mut [u32], sizes: &mut Vec<u64>) {
    let (width, height) = (area.x.1 - area.x.0, area.y.1 - area.y.0);
    if points <= most || (width == 1 && height == 1) {
        for y in area.y.0..area.y.1 {
            owner[y * CELLS + area.x.0..y * CELLS + area.x.1].fill(sizes.len() as u32);
        }
        sizes.push(points);
        return;
    }
    let along_x = width >= height;
    let range = if along_x { area.x } else { area.y };
    let line = |at: usize| -> u64 {
        if along_x {
            (area.y.0..area.y.1).map(|y| counts[y * CELLS + at]).sum()
        } else {
            counts[at * CELLS + area.x.0..at * CELLS + area.x.1].iter().sum()
        }
    };
    let mut below = 0;
    let mut split = range.0;
    // At least one line on both sides.
    while split < range.1 - 1 && (split == range.0 || (below + line(split)) * 2 <= points) {
        below += line(split);
        split += 1;
    }
    let (mut low, mut high) = (area, area);
    if along_x {
        (low.x.1, high.x.0) = (split, split);
    } else {
        (low.y.1, high.y.0) = (split, split);
    }
    cut(counts, low, below, most, owner, sizes);
    cut(counts, high, points - below, most, owner, sizes);
}

/// What the steps found, point by point in the file's order.
pub struct Verdicts {
    /// Points of one part.
    part_points: u64,
    points: u64,
    parts: Vec<(File, u64)>,
    loaded: Option<(u64, Vec<[u8; 2]>)>,
}

impl Verdicts {
    /// Collects the verdicts of all tiles; a part of the file of `part_points` is held in memory at a time.
    ///
    /// # Errors
    /// Those of the scratch disk.
    pub fn new(tiles: &mut Tiles, part_points: u64) -> Result<Verdicts> {
        let points = tiles.indices;
        let count = points.div_ceil(part_points).max(1);
        let mut writers = Vec::new();
        for _ in 0..count {
            writers.push((BufWriter::with_capacity(1 << 16, tiles.scratch.file()?), 0));
        }
        for tile in 0..tiles.tiles.len() {
            for point in tiles.load(tile)? {
                let (writer, entries) = &mut writers[(point.index() / part_points) as usize];
                let within = ((point.index() % part_points) as u32).to_le_bytes();
                let entry = [within[0], within[1], within[2], within[3], point.class(), point.step_byte()];
                writer.write_all(&entry).map_err(|e| tiles.scratch.error("write scratch data to", e))?;
                *entries += 1;
            }
        }
        let mut parts = Vec::new();
        for (writer, entries) in writers {
            let file = writer.into_inner().map_err(|e| tiles.scratch.error("write scratch data to", e.into_error()))?;
            parts.push((file, entries));
        }
        Ok(Verdicts { part_points, points, parts, loaded: None })
    }

    /// Class and step of a point; points are best asked for in their order. `None` when the point never was in the
    /// chain.
    ///
    /// # Errors
    /// Those of the scratch disk.
    pub fn get(&mut self, scratch: &Scratch, index: u64) -> Result<Option<(u8, u8)>> {
        let part = index / self.part_points;
        if self.loaded.as_ref().is_none_or(|(loaded, _)| *loaded != part) {
            let length = self.part_points.min(self.points - part * self.part_points);
            // A step of 255 marks a point that was left out.
            let mut values = vec![[0, 255]; length as usize];
            let (file, entries) = &self.parts[part as usize];
            let mut bytes = vec![0; 6 * STREAM_POINTS];
            let mut done = 0;
            while done < *entries {
                let count = (*entries - done).min(STREAM_POINTS as u64) as usize;
                let bytes = &mut bytes[..6 * count];
                file.read_exact_at(bytes, 6 * done).map_err(|e| scratch.error("read scratch data from", e))?;
                for entry in bytes.chunks_exact(6) {
                    values[u32::from_le_bytes(array(entry)) as usize] = [entry[4], entry[5]];
                }
                done += count as u64;
            }
            self.loaded = Some((part, values));
        }
        let values = &self.loaded.as_ref().expect("it was loaded above").1;
        let [class, step] = values[(index % self.part_points) as usize];
        Ok((step != 255).then_some((class, step)))
    }
}
