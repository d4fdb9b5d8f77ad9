//! LAS and LAZ, read record by record; records are kept as they are.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use laz::{LasZipDecompressor, LasZipError, LazVlr};

use super::las_header::LasHeader;
use super::{Format, Header, PointReader, Precision};
use crate::error::{Error, Result};
use crate::schema::{Batch, array};

enum Source {
    Plain(BufReader<File>),
    Packed(Box<LasZipDecompressor<'static, BufReader<File>>>),
}

struct LasReader {
    path: PathBuf,
    source: Source,
    scale: [f64; 3],
    offset: [f64; 3],
    record_bytes: usize,
    points: u64,
    read: u64,
    /// Points that the file has room for, at least.
    there: u64,
    /// Whether the end of the file is there: the packed points are damaged where they cannot be read.
    complete: bool,
}

pub(super) fn open(path: &Path) -> Result<(Header, Box<dyn PointReader>)> {
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let file_bytes = file.metadata().map_err(|e| Error::io(path, "open", e))?.len();
    let mut reader = BufReader::with_capacity(1 << 20, file);
    let header = LasHeader::read(path, &mut reader, file_bytes)?;
    reader.seek(SeekFrom::Start(header.points_offset)).map_err(|e| Error::io(path, "seek", e))?;
    let mut there = header.points;
    let mut complete = false;
    let source = if header.compressed {
        let (unpacker, chunks) = unpack(path, &header, reader, file_bytes)?;
        complete = chunks.is_some();
        there = there.max(chunks.map_or(0, |chunks| least_points(chunks, unpacker.vlr())));
        Source::Packed(Box::new(unpacker))
    } else {
        there = header.points_end(file_bytes).saturating_sub(header.points_offset) / header.record_bytes as u64;
        if there < header.points {
            let what = format!("the header counts {} points, the file holds {there}: it is truncated", header.points);
            return Err(Error::format(path, "points", what));
        }
        Source::Plain(reader)
    };
    let format = if header.compressed { Format::Laz } else { Format::Las };
    let copc = header.vlr("copc", 1).map_or("", |_| ", COPC");
    let described = Header {
        format,
        points: Some(header.points),
        schema: header.schema(),
        precision: Precision::Steps(header.scale),
        crs: header.crs(),
        shift: None,
        intensity: None,
        colours: None,
        description: format!("{} 1.{}, point format {}{copc}", format.name(), header.minor, header.point_format),
        las: Some(header.clone()),
    };
    let reader = LasReader {
        path: path.to_path_buf(),
        source,
        scale: header.scale,
        offset: header.offset,
        record_bytes: header.record_bytes,
        points: header.points,
        read: 0,
        there,
        complete,
    };
    Ok((described, Box::new(reader)))
}

type Unpacker = LasZipDecompressor<'static, BufReader<File>>;

/// Points that lie in so many chunks, at least: all but the last are full. Of chunks that differ nothing is known.
fn least_points(chunks: u64, vlr: &LazVlr) -> u64 {
    if vlr.uses_variable_size_chunks() {
        return 0;
    }
    chunks.checked_sub(1).map_or(0, |full| full.saturating_mul(u64::from(vlr.chunk_size())) + 1)
}

/// The unpacker, and the number of chunks where the file has their table.
fn unpack(
    path: &Path,
    header: &LasHeader,
    mut reader: BufReader<File>,
    file_bytes: u64,
) -> Result<(Unpacker, Option<u64>)> {
    let bad = |what: String| Error::format(path, "LASzip record", what);
    let vlr = header.vlr("laszip encoded", 22_204).ok_or_else(|| bad("points are packed but it is missing".into()))?;
    // Compressor 1 packs points without chunks, as LASzip did before 1.2r1.
    if vlr.content.get(..2) == Some(&[1, 0]) {
        let remedy = "write it anew with laszip 2 or later, or as LAS, first";
        return Err(Error::unsupported(path, "the LASzip compressor without chunks (before 2011)", remedy));
    }
    let damaged = |fault: Fault| bad(fault.said(TRUNCATED));
    let vlr = LazVlr::from_buffer(&vlr.content).map_err(|e| damaged(e.into()))?;
    if vlr.items_size() != header.record_bytes as u64 {
        let what = format!("it packs {} bytes a point, the header says {}", vlr.items_size(), header.record_bytes);
        return Err(bad(what));
    }
    let chunks = check_chunk_table(path, header, &mut reader, file_bytes)?;
    let unpacker = guarded(|| Ok(LasZipDecompressor::new(reader, vlr)?)).map_err(damaged)?;
    Ok((unpacker, chunks))
}

/// How many chunks there are; `None` without a table. An untrusted count must not decide how much memory is taken.
fn check_chunk_table(
    path: &Path,
    header: &LasHeader,
    reader: &mut BufReader<File>,
    file_bytes: u64,
) -> Result<Option<u64>> {
    let io = |e| Error::io(path, "read the chunk table", e);
    let mut word = [0; 8];
    if header.points == 0 || reader.read_exact(&mut word).is_err() {
        reader.seek(SeekFrom::Start(header.points_offset)).map_err(io)?;
        return Ok(None);
    }
    let mut at = i64::from_le_bytes(word);
    // What lies before the points says, as -1 does, that the place stands at the end of the file.
    let begin = i64::try_from(header.points_offset).unwrap_or(i64::MAX);
    if at <= begin && reader.seek(SeekFrom::End(-8)).is_ok() && reader.read_exact(&mut word).is_ok() {
        at = i64::from_le_bytes(word);
    }
    let inside = u64::try_from(at).ok().filter(|&at| at >= header.points_offset && at.saturating_add(8) <= file_bytes);
    let mut counted = None;
    if let Some(at) = inside {
        reader.seek(SeekFrom::Start(at)).map_err(io)?;
        reader.read_exact(&mut word).map_err(io)?;
        let chunks = u32::from_le_bytes(array(&word[4..]));
        if u64::from(chunks) > header.points.max(file_bytes) {
            return Err(Error::format(path, format!("chunk table at byte {at}"), format!("{chunks} chunks")));
        }
        counted = Some(u64::from(chunks));
    }
    if inside.is_none() && at > begin {
        return Err(Error::format(
            path,
            "chunk table",
            "the file ends before it: it is truncated, or its place is wrong",
        ));
    }
    reader.seek(SeekFrom::Start(header.points_offset)).map_err(io)?;
    Ok(counted)
}

const TRUNCATED: &str = "the file ends before: it is truncated";

/// Why points cannot be read.
enum Fault {
    /// The data end before the points do.
    Ended,
    Other(String),
}

impl Fault {
    fn said(self, where_they_end: &str) -> String {
        match self {
            Fault::Ended => where_they_end.to_string(),
            Fault::Other(what) => what,
        }
    }
}

impl From<std::io::Error> for Fault {
    fn from(error: std::io::Error) -> Fault {
        match error.kind() {
            std::io::ErrorKind::UnexpectedEof => Fault::Ended,
            _ => Fault::Other(error.to_string()),
        }
    }
}

impl From<LasZipError> for Fault {
    fn from(error: LasZipError) -> Fault {
        match error {
            LasZipError::IoError(error) => error.into(),
            other => Fault::Other(other.to_string()),
        }
    }
}

/// The unpacker gives up by a panic on some corrupt data: that becomes an error like any other.
fn guarded<T>(work: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    crate::quiet::quietly(|| catch_unwind(AssertUnwindSafe(work)))
        .unwrap_or_else(|_| Err(Fault::Other("the packed data are corrupt".into())))
}

impl PointReader for LasReader {
    fn read(&mut self, batch: &mut Batch, limit: usize) -> Result<()> {
        batch.clear();
        let count = (self.points - self.read).min(limit as u64) as usize;
        if count == 0 {
            return Ok(());
        }
        batch.raw.resize(count * self.record_bytes, 0);
        let first = self.read + 1;
        let last = self.read + count as u64;
        let raw = &mut batch.raw[..];
        match &mut self.source {
            Source::Plain(reader) => reader.read_exact(raw).map_err(Fault::from),
            Source::Packed(unpacker) => guarded(|| Ok(unpacker.decompress_many(raw)?)),
        }
        .map_err(|fault| {
            // A file with a table of chunks at its end has its end.
            let ends =
                if self.complete { "the packed data are damaged; take another copy of the file" } else { TRUNCATED };
            Error::format(&self.path, format!("points {first} to {last} of {}", self.points), fault.said(ends))
        })?;
        self.read = last;
        let (scale, offset) = (self.scale, self.offset);
        batch.xyz.extend(batch.raw.chunks_exact(self.record_bytes).map(|record| {
            let step = |axis: usize| f64::from(i32::from_le_bytes(array(&record[4 * axis..])));
            [0, 1, 2].map(|axis| step(axis) * scale[axis] + offset[axis])
        }));
        Ok(())
    }

    fn left_over(&mut self) -> Result<Option<String>> {
        Ok(super::uncounted(self.points, self.there))
    }
}
