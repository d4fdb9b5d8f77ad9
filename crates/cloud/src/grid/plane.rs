//! Rows and points on the scratch disk.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::schema::array;
use crate::tiles::Scratch;

/// Rows of numbers, appended once and read at will.
pub(super) struct Plane {
    file: File,
    columns: usize,
    rows: u64,
}

impl Plane {
    /// One without rows.
    ///
    /// # Errors
    /// When the scratch folder takes no new file.
    pub fn new(scratch: &mut Scratch, columns: usize) -> Result<Plane> {
        Ok(Plane { file: scratch.file()?, columns, rows: 0 })
    }

    /// Whole rows.
    ///
    /// # Errors
    /// When the scratch disk does not take the rows.
    pub fn append(&mut self, values: &[f64]) -> std::io::Result<()> {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.file.write_all_at(&bytes, self.rows * self.columns as u64 * 8)?;
        self.rows += (values.len() / self.columns) as u64;
        Ok(())
    }

    /// So many rows from `row` on.
    ///
    /// # Errors
    /// When the rows cannot be read back, or were never appended.
    pub fn read(&self, row: usize, rows: usize) -> std::io::Result<Vec<f64>> {
        let mut bytes = vec![0; rows * self.columns * 8];
        self.file.read_exact_at(&mut bytes, row as u64 * self.columns as u64 * 8)?;
        Ok(bytes.chunks_exact(8).map(|bytes| f64::from_le_bytes(array(bytes))).collect())
    }
}

/// Records of numbers, written once, then read.
pub(super) struct PointFile {
    file: BufWriter<File>,
    numbers: usize,
    bytes: u64,
    /// The folder of the scratch disk.
    parent: PathBuf,
}

impl PointFile {
    /// One without records, each of a place and values: so many numbers together.
    ///
    /// # Errors
    /// When no file can be made in `parent`.
    pub fn new(parent: &Path, numbers: usize) -> Result<PointFile> {
        let file = tempfile::tempfile_in(parent).map_err(|e| Error::io(parent, "make a scratch file in", e))?;
        let file = BufWriter::with_capacity(1 << 16, file);
        Ok(PointFile { file, numbers, bytes: 0, parent: parent.to_path_buf() })
    }

    /// Appends a record.
    ///
    /// # Errors
    /// When the scratch disk does not take the record.
    pub fn push(&mut self, place: &[f64; 2], values: &[f64]) -> Result<()> {
        for value in place.iter().chain(values) {
            let failed = |e| Error::io(&self.parent, "write scratch data to", e);
            self.file.write_all(&value.to_le_bytes()).map_err(failed)?;
        }
        self.bytes += 8 * self.numbers as u64;
        Ok(())
    }

    /// All records in their order; from the beginning each time.
    ///
    /// # Errors
    /// When what is buffered cannot be written or a record cannot be read back; and the first that `each` returns.
    pub fn each(&mut self, mut each: impl FnMut(&[f64]) -> Result<()>) -> Result<()> {
        let parent = self.parent.clone();
        let failed = |e: std::io::Error| Error::io(&parent, "read scratch data from", e);
        self.file.flush().map_err(failed)?;
        let mut file = self.file.get_ref();
        file.seek(SeekFrom::Start(0)).map_err(failed)?;
        let mut reader = BufReader::with_capacity(1 << 20, file);
        let mut record = vec![0; 8 * self.numbers];
        let mut values = vec![0.0; self.numbers];
        for _ in 0..self.bytes / record.len() as u64 {
            reader.read_exact(&mut record).map_err(failed)?;
            values
                .iter_mut()
                .zip(record.chunks_exact(8))
                .for_each(|(value, bytes)| *value = f64::from_le_bytes(array(bytes)));
            each(&values)?;
        }
        Ok(())
    }
}
