//! What the first pass saw of each cell, kept for the others: in memory or on disk.
//!
//! Statistics take two further passes and the variogram a part of one. Where there is room they need no model any more,
//! and neither is decoded, resampled or derived again.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::error::{Error, Result};
use crate::kept::Room;
use crate::window::Window;

use super::scan::{Buffers, Cell, Facing, Scan};

/// Bytes of a cell.
const RECORD_BYTES: usize = 12;
/// More is not kept on disk.
const MOST_BYTES: u64 = 32 << 30;

/// A cell without its place.
#[derive(Clone, Copy)]
pub(super) struct Record {
    /// NaN where the models have no height in common.
    difference: f32,
    height: f32,
    facing: Facing,
}

impl Record {
    pub(super) const NONE: Record =
        Record { difference: f32::NAN, height: f32::NAN, facing: Facing { slope: 0, aspect: 0 } };

    pub(super) fn of(cell: &Cell<'_>) -> Record {
        Record { difference: cell.difference, height: cell.height, facing: cell.facing }
    }

    #[inline]
    fn packed(self) -> Packed {
        let facing = u32::from(self.facing.slope) << 16 | u32::from(self.facing.aspect);
        [self.difference.to_bits(), self.height.to_bits(), facing]
    }

    #[inline]
    fn unpacked([difference, height, facing]: Packed) -> Record {
        Record {
            difference: f32::from_bits(difference),
            height: f32::from_bits(height),
            facing: Facing { slope: (facing >> 16) as u16, aspect: facing as u16 },
        }
    }

    fn put(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.difference.to_le_bytes());
        bytes.extend(self.height.to_le_bytes());
        bytes.extend(self.facing.slope.to_le_bytes());
        bytes.extend(self.facing.aspect.to_le_bytes());
    }

    fn get(bytes: &[u8; RECORD_BYTES]) -> Record {
        let [a, b, c, d, e, f, g, h, i, j, k, l] = *bytes;
        Record {
            difference: f32::from_le_bytes([a, b, c, d]),
            height: f32::from_le_bytes([e, f, g, h]),
            facing: Facing { slope: u16::from_le_bytes([i, j]), aspect: u16::from_le_bytes([k, l]) },
        }
    }
}

/// A record as it lies in memory: numbers of which a new vector is made of pages that nobody has touched.
type Packed = [u32; 3];

/// Where the records are.
enum Store {
    Memory(Mutex<Vec<Packed>>),
    /// A file without a name: it goes when the program does.
    Disk {
        file: File,
        failed: AtomicBool,
    },
    /// There is no room: both models are scanned again.
    None,
}

/// Takes the records of all windows, from several threads.
pub(super) struct Recorder {
    store: Store,
    width: u64,
}

impl Recorder {
    /// `room.held_cells` counts cells of four bytes.
    pub(super) fn new(scan: &Scan<'_>, room: &Room<'_>) -> Recorder {
        let grid = scan.grid;
        let cells = grid.width.saturating_mul(grid.height);
        let bytes = cells.saturating_mul(RECORD_BYTES as u64);
        let store = if bytes / 4 <= room.held_cells {
            Store::Memory(Mutex::new(vec![[0; 3]; cells as usize]))
        } else {
            room.file(bytes, MOST_BYTES)
                .map_or(Store::None, |file| Store::Disk { file, failed: AtomicBool::new(false) })
        };
        Recorder { store, width: grid.width }
    }

    /// Whether anything is kept.
    pub(super) fn keeps(&self) -> bool {
        !matches!(self.store, Store::None)
    }

    /// The records of a window, row by row.
    pub(super) fn put(&self, window: Window, records: &[Record]) {
        let rows = (window.y..).zip(records.chunks_exact(window.width as usize));
        match &self.store {
            Store::Memory(all) => {
                let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
                for (y, row) in rows {
                    let from = (y * self.width + window.x) as usize;
                    let to = &mut all[from..from + row.len()];
                    to.iter_mut().zip(row).for_each(|(to, record)| *to = record.packed());
                }
            }
            Store::Disk { file, failed } => {
                let mut bytes = Vec::with_capacity(window.width as usize * RECORD_BYTES);
                for (y, row) in rows {
                    bytes.clear();
                    row.iter().for_each(|record| record.put(&mut bytes));
                    if file.write_all_at(&bytes, (y * self.width + window.x) * RECORD_BYTES as u64).is_err() {
                        failed.store(true, Ordering::Relaxed);
                    }
                }
            }
            Store::None => {}
        }
    }

    /// All cells, once each window was put.
    pub(super) fn finish<'a>(self, scan: &'a Scan<'a>) -> Observed<'a> {
        let records = match self.store {
            Store::Memory(all) => Records::Memory(all.into_inner().unwrap_or_else(PoisonError::into_inner)),
            Store::Disk { file, failed } if !failed.load(Ordering::Relaxed) => Records::Disk(file),
            Store::Disk { .. } | Store::None => Records::Nothing,
        };
        Observed { scan, records }
    }
}

enum Records {
    Memory(Vec<Packed>),
    Disk(File),
    Nothing,
}

/// All cells of a comparison.
pub(super) struct Observed<'a> {
    pub(super) scan: &'a Scan<'a>,
    records: Records,
}

impl Observed<'_> {
    /// All common cells of a window, row by row: what [`Scan::cells`] showed.
    pub(super) fn cells(&self, window: Window, buffers: &mut Buffers, mut see: impl FnMut(Cell<'_>)) -> Result<()> {
        if matches!(self.records, Records::Nothing) {
            return self.scan.cells(window, buffers, see);
        }
        let (grid, columns) = (&self.scan.grid, window.width as usize);
        buffers.zones.clear(columns);
        for y in window.y..window.bottom() {
            if self.scan.zones.is_some() {
                self.scan.mark_zones(window.x, y, columns, &mut buffers.zones);
            }
            let from = y * grid.width + window.x;
            let mut show = |column: u64, record: Record| {
                if !record.difference.is_nan() {
                    see(Cell {
                        x: window.x + column,
                        y,
                        difference: record.difference,
                        height: record.height,
                        facing: record.facing,
                        zones: buffers.zones.of(column as usize),
                    });
                }
            };
            match &self.records {
                Records::Memory(all) => {
                    let row = &all[from as usize..from as usize + columns];
                    (0..).zip(row).for_each(|(column, packed)| show(column, Record::unpacked(*packed)));
                }
                Records::Disk(file) => {
                    buffers.bytes.resize(columns * RECORD_BYTES, 0);
                    file.read_exact_at(&mut buffers.bytes, from * RECORD_BYTES as u64)
                        .map_err(|e| Error::io(Path::new("the differences kept on disk"), "read", e))?;
                    let row = buffers.bytes.as_chunks::<RECORD_BYTES>().0;
                    (0..).zip(row).for_each(|(column, bytes)| show(column, Record::get(bytes)));
                }
                Records::Nothing => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back() {
        let record = Record { difference: -1.25, height: 812.5, facing: Facing { slope: 7, aspect: 9 } };
        let mut bytes = Vec::new();
        record.put(&mut bytes);
        let from_bytes = Record::get(bytes.as_chunks().0.first().expect("twelve bytes"));
        for back in [from_bytes, Record::unpacked(record.packed())] {
            assert_eq!((back.difference, back.height, back.facing), (record.difference, record.height, record.facing));
        }
    }
}
