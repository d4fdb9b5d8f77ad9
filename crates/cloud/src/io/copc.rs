//! COPC: LAZ whose chunks are the nodes of an octree (Hobu, Inc., *Cloud Optimized Point Cloud Specification* 1.0,
//! 2021), built in bounded memory.
//!
//! Records are spooled to the scratch disk as they come. A node then takes from its points the first in each of 128³
//! cells of its cube, so that every level is an even choice of what lies below, and hands the others on to its eight
//! children. Nodes whose points fit the memory do so there, larger ones from a spool into one spool for each child. A
//! node of few points takes all of them. Which points a node holds depends on their order in the cloud alone, not on
//! the memory.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;

use laz::{LasZipCompressor, LazVlr};

use crate::error::{Error, Result};
use crate::schema::array;
use crate::tiles::Scratch;

/// The user of COPC's records.
pub(super) const USER_ID: &str = "copc";
/// Bytes of the record that describes the octree; it is the first behind the header.
pub(super) const INFO_BYTES: usize = 160;
/// Bytes of an extended record before its content.
const EVLR_HEADER_BYTES: usize = 60;

/// A node of so many points has no children.
const LEAF_POINTS: u64 = 65_536;
/// A node with children takes at most so many for itself.
const MOST_TAKEN: usize = 131_072;
/// Two to this power cells lie along the side of a node.
const CELL_BITS: u32 = 7;
/// Two to this power cells lie along the side of the root on the finest level.
const FINEST_BITS: u32 = 31;
/// So deep that a cell of a node is a cell of the finest level.
const DEEPEST: u32 = FINEST_BITS - CELL_BITS;

/// Steps of the coordinates, and where they count from, in the file that is written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steps {
    pub scale: [f64; 3],
    pub offset: [f64; 3],
}

impl Steps {
    fn coordinates(&self, record: &[u8]) -> [f64; 3] {
        [0, 1, 2].map(|axis| {
            f64::from(i32::from_le_bytes(array(&record[4 * axis..]))) * self.scale[axis] + self.offset[axis]
        })
    }
}

/// The cube of the root.
#[derive(Clone, Copy, Debug)]
struct Cube {
    low: [f64; 3],
    side: f64,
}

/// Which node, and so the cube: level, and place along each axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Key {
    level: u32,
    at: [u32; 3],
}

impl Key {
    fn child(self, octant: usize) -> Key {
        Key { level: self.level + 1, at: [0, 1, 2].map(|axis| 2 * self.at[axis] + (octant as u32 >> axis & 1)) }
    }
}

/// One chunk.
#[derive(Clone, Copy, Debug)]
struct Node {
    key: Key,
    begin: u64,
    points: u64,
}

/// Records on the scratch disk.
struct Spooled {
    file: BufWriter<File>,
    points: u64,
}

impl Spooled {
    fn new(scratch: &Scratch) -> Result<Spooled> {
        Ok(Spooled { file: BufWriter::with_capacity(1 << 18, scratch.file()?), points: 0 })
    }

    fn push(&mut self, scratch: &Scratch, record: &[u8]) -> Result<()> {
        self.points += 1;
        self.file.write_all(record).map_err(|e| scratch.error("write scratch data to", e))
    }

    /// The records from the first on.
    fn read(self, scratch: &Scratch) -> Result<BufReader<File>> {
        let failed = |e| scratch.error("read scratch data from", e);
        let mut file = self.file.into_inner().map_err(|e| scratch.error("write scratch data to", e.into_error()))?;
        file.seek(SeekFrom::Start(0)).map_err(failed)?;
        Ok(BufReader::with_capacity(1 << 20, file))
    }
}

/// Which of a node's cells have their point.
struct Cells(Vec<u64>);

impl Cells {
    fn new() -> Cells {
        Cells(vec![0; 1 << (3 * CELL_BITS - 6)])
    }

    fn clear(&mut self) {
        self.0.fill(0);
    }

    /// Takes a cell; whether it was free.
    fn take(&mut self, cell: u32) -> bool {
        let (word, bit) = (&mut self.0[(cell >> 6) as usize], 1 << (cell & 63));
        let free = *word & bit == 0;
        *word |= bit;
        free
    }
}

/// A COPC file on its way to disk.
pub(super) struct Builder {
    path: PathBuf,
    packer: LasZipCompressor<'static, BufWriter<File>>,
    points_offset: u64,
    record_bytes: usize,
    memory_bytes: u64,
    scratch: Scratch,
    spooled: Spooled,
    nodes: Vec<Node>,
    cells: Cells,
}

/// What is known when the last chunk is written.
pub(super) struct Built {
    pub file: BufWriter<File>,
    /// Content of the first record.
    pub info: [u8; INFO_BYTES],
    /// Where the hierarchy's record begins.
    pub hierarchy_offset: u64,
}

impl Builder {
    /// Points follow at `points_offset`, where `file` stands.
    pub fn new(
        path: PathBuf,
        file: BufWriter<File>,
        vlr: LazVlr,
        points_offset: u64,
        scratch: Scratch,
        memory_bytes: u64,
    ) -> Result<Builder> {
        let record_bytes = vlr.items_size() as usize;
        let packer = LasZipCompressor::new(file, vlr)
            .map_err(|e| Error::unsupported(&path, format!("packing: {e}"), "name the output .las"))?;
        let spooled = Spooled::new(&scratch)?;
        let (nodes, cells) = (Vec::new(), Cells::new());
        Ok(Builder { path, packer, points_offset, record_bytes, memory_bytes, scratch, spooled, nodes, cells })
    }

    /// Keeps a record for the octree.
    pub fn push(&mut self, record: &[u8]) -> Result<()> {
        self.spooled.push(&self.scratch, record)
    }

    /// Builds the octree over all records, whose coordinates lie from `min` to `max`, and writes chunks and hierarchy.
    pub fn build(mut self, steps: Steps, min: [f64; 3], max: [f64; 3]) -> Result<Built> {
        let side = (0..3).map(|axis| max[axis] - min[axis]).fold(0.0, f64::max);
        // Of one place, or none, any cube will do.
        let side = if side > 0.0 { side } else { steps.scale.into_iter().map(f64::abs).fold(0.0, f64::max) };
        let centre = [0, 1, 2].map(|axis| (min[axis] + max[axis]) / 2.0);
        let cube = Cube { low: centre.map(|c| c - side / 2.0), side };
        let all = std::mem::replace(&mut self.spooled, Spooled::new(&self.scratch)?);
        let mut tree = Tree { builder: &mut self, steps, cube, times: [f64::INFINITY, f64::NEG_INFINITY] };
        tree.spooled(Key { level: 0, at: [0; 3] }, all)?;
        let times = if tree.times[0] <= tree.times[1] { tree.times } else { [0.0; 2] };
        let (file, hierarchy_offset, hierarchy_bytes) = self.end()?;
        let mut info = [0; INFO_BYTES];
        let numbers = [centre[0], centre[1], centre[2], side / 2.0, side / f64::from(1 << CELL_BITS)];
        for (index, number) in numbers.into_iter().enumerate() {
            info[8 * index..8 * index + 8].copy_from_slice(&number.to_le_bytes());
        }
        let root = hierarchy_offset + EVLR_HEADER_BYTES as u64;
        info[40..48].copy_from_slice(&root.to_le_bytes());
        info[48..56].copy_from_slice(&hierarchy_bytes.to_le_bytes());
        info[56..64].copy_from_slice(&times[0].to_le_bytes());
        info[64..72].copy_from_slice(&times[1].to_le_bytes());
        Ok(Built { file, info, hierarchy_offset })
    }

    /// Begins the chunk of a node. The packer ends a chunk only when another one follows: at the end it would write an
    /// empty one.
    fn begin(&mut self, key: Key, points: u64) -> Result<()> {
        let io = |e| Error::io(&self.path, "write", e);
        let begin = if self.nodes.is_empty() {
            self.points_offset + 8
        } else {
            self.packer.finish_current_chunk().map_err(io)?;
            self.packer.get_mut().stream_position().map_err(io)?
        };
        self.nodes.push(Node { key, begin, points });
        Ok(())
    }

    fn pack(&mut self, record: &[u8]) -> Result<()> {
        self.packer.compress_one(record).map_err(|e| Error::io(&self.path, "write", e))
    }

    /// Ends the last chunk and writes the hierarchy; its place and bytes.
    fn end(mut self) -> Result<(BufWriter<File>, u64, u64)> {
        let io = |e| Error::io(&self.path, "write", e);
        self.packer.done().map_err(io)?;
        let mut file = self.packer.into_inner();
        let hierarchy_offset = file.seek(SeekFrom::End(0)).map_err(io)?;
        // The table of chunks begins where the last chunk ends.
        file.seek(SeekFrom::Start(self.points_offset)).map_err(io)?;
        let mut word = [0; 8];
        file.get_mut().read_exact(&mut word).map_err(io)?;
        let end = u64::from_le_bytes(word);
        file.seek(SeekFrom::Start(hierarchy_offset)).map_err(io)?;
        let ends = self.nodes.iter().skip(1).map(|node| node.begin).chain([end]);
        let mut page = Vec::with_capacity(32 * self.nodes.len());
        for (node, end) in self.nodes.iter().zip(ends) {
            for number in [node.key.level, node.key.at[0], node.key.at[1], node.key.at[2]] {
                page.extend(number.to_le_bytes());
            }
            page.extend(node.begin.to_le_bytes());
            page.extend(((end - node.begin) as u32).to_le_bytes());
            page.extend((node.points as u32).to_le_bytes());
        }
        let mut header = [0; EVLR_HEADER_BYTES];
        header[2..2 + USER_ID.len()].copy_from_slice(USER_ID.as_bytes());
        header[18..20].copy_from_slice(&1000u16.to_le_bytes());
        header[20..28].copy_from_slice(&(page.len() as u64).to_le_bytes());
        header[28..42].copy_from_slice(b"COPC hierarchy");
        file.write_all(&header).and_then(|()| file.write_all(&page)).map_err(io)?;
        Ok((file, hierarchy_offset, page.len() as u64))
    }
}

/// The octree while it is built, from the root down.
struct Tree<'a> {
    builder: &'a mut Builder,
    steps: Steps,
    cube: Cube,
    /// Least and greatest GPS time.
    times: [f64; 2],
}

impl Tree<'_> {
    /// Where a record lies on the finest level.
    fn finest(&self, record: &[u8]) -> [u32; 3] {
        let xyz = self.steps.coordinates(record);
        let most = f64::from((1u32 << FINEST_BITS) - 1);
        [0, 1, 2].map(|axis| {
            let share = (xyz[axis] - self.cube.low[axis]) / self.cube.side;
            (share * f64::from(1u32 << FINEST_BITS)).clamp(0.0, most) as u32
        })
    }

    /// The cell of a node on `level` that a place lies in.
    fn cell(level: u32, finest: [u32; 3]) -> u32 {
        let mask = (1 << CELL_BITS) - 1;
        let [x, y, z] = finest.map(|place| (place >> (DEEPEST - level)) & mask);
        x | y << CELL_BITS | z << (2 * CELL_BITS)
    }

    /// Which child of a node on `level` a place lies in.
    fn octant(level: u32, finest: [u32; 3]) -> usize {
        let [x, y, z] = finest.map(|place| (place >> (FINEST_BITS - 1 - level)) & 1);
        (x | y << 1 | z << 2) as usize
    }

    /// Whether cells of this level are finer than the steps of the coordinates: then points in one cell lie at one
    /// place, and no deeper level parts them.
    fn is_deepest(&self, level: u32) -> bool {
        let cell = self.cube.side / f64::from(1u32 << CELL_BITS) / 2f64.powi(level as i32);
        level >= DEEPEST || cell < self.steps.scale.into_iter().map(f64::abs).fold(f64::INFINITY, f64::min)
    }

    fn pack(&mut self, record: &[u8]) -> Result<()> {
        let time = f64::from_le_bytes(array(&record[22..]));
        if time.is_finite() {
            self.times = [self.times[0].min(time), self.times[1].max(time)];
        }
        self.builder.pack(record)
    }

    /// A node and all below it, of records on the scratch disk.
    fn spooled(&mut self, key: Key, spooled: Spooled) -> Result<()> {
        let (points, size) = (spooled.points, self.builder.record_bytes);
        let failed = |scratch: &Scratch, e| scratch.error("read scratch data from", e);
        let mut reader = spooled.read(&self.builder.scratch)?;
        let mut record = vec![0; size];
        if points <= LEAF_POINTS || self.is_deepest(key.level) {
            self.builder.begin(key, points)?;
            for _ in 0..points {
                reader.read_exact(&mut record).map_err(|e| failed(&self.builder.scratch, e))?;
                self.pack(&record)?;
            }
            return Ok(());
        }
        // Beside its record a point takes its number, more than twice while it is shared out.
        if points.saturating_mul(size as u64 + 12) <= self.builder.memory_bytes && points <= u64::from(u32::MAX) {
            let mut records = vec![0; points as usize * size];
            reader.read_exact(&mut records).map_err(|e| failed(&self.builder.scratch, e))?;
            return self.in_memory(key, &records, (0..points as u32).collect());
        }
        self.builder.cells.clear();
        let mut taken = Vec::new();
        let mut children: [Option<Spooled>; 8] = Default::default();
        for _ in 0..points {
            reader.read_exact(&mut record).map_err(|e| failed(&self.builder.scratch, e))?;
            let place = self.finest(&record);
            if taken.len() < MOST_TAKEN * size && self.builder.cells.take(Self::cell(key.level, place)) {
                taken.extend_from_slice(&record);
                continue;
            }
            let child = &mut children[Self::octant(key.level, place)];
            if child.is_none() {
                *child = Some(Spooled::new(&self.builder.scratch)?);
            }
            child.as_mut().expect("made above").push(&self.builder.scratch, &record)?;
        }
        drop(reader);
        self.builder.begin(key, (taken.len() / size) as u64)?;
        for record in taken.chunks_exact(size) {
            self.pack(record)?;
        }
        drop(taken);
        for (octant, child) in children.into_iter().enumerate() {
            if let Some(child) = child {
                self.spooled(key.child(octant), child)?;
            }
        }
        Ok(())
    }

    /// A node and all below it, of the records with these numbers.
    fn in_memory(&mut self, key: Key, records: &[u8], numbers: Vec<u32>) -> Result<()> {
        let size = self.builder.record_bytes;
        let record = |number: u32| &records[number as usize * size..(number as usize + 1) * size];
        let mut taken = Vec::new();
        let mut children: [Vec<u32>; 8] = Default::default();
        if numbers.len() as u64 <= LEAF_POINTS || self.is_deepest(key.level) {
            taken = numbers;
        } else {
            self.builder.cells.clear();
            for number in numbers {
                let place = self.finest(record(number));
                if taken.len() < MOST_TAKEN && self.builder.cells.take(Self::cell(key.level, place)) {
                    taken.push(number);
                } else {
                    children[Self::octant(key.level, place)].push(number);
                }
            }
        }
        self.builder.begin(key, taken.len() as u64)?;
        for number in taken {
            self.pack(record(number))?;
        }
        for (octant, child) in children.into_iter().enumerate() {
            if !child.is_empty() {
                self.in_memory(key.child(octant), records, child)?;
            }
        }
        Ok(())
    }
}
