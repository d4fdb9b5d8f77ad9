//! Copies of heights that are read in several passes: in memory, or decoded on disk.
//!
//! Decoding a compressed model takes several times as long as what is asked of it, and an alignment passes over it a
//! dozen times.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crate::error::Result;
use crate::grid::Grid;
use crate::source::{Heights, Patch, read_rows};
use crate::stream;

/// Where copies may lie.
#[derive(Clone, Copy, Debug, Default)]
pub struct Room<'a> {
    /// Cells that may be held in memory, four bytes each.
    pub held_cells: u64,
    /// A folder for decoded copies of what is not; `None`: the source itself is read in every pass.
    pub scratch: Option<&'a Path>,
}

impl Room<'_> {
    /// A file without a name for so many bytes: it goes when the program does. `None` where there is no folder, no room
    /// or more than `most_bytes` to keep.
    pub(crate) fn file(&self, bytes: u64, most_bytes: u64) -> Option<File> {
        let folder = self.scratch?;
        // Others need the disk too.
        let free = autoref_raster::free_disk_bytes(folder).unwrap_or(0);
        if bytes > most_bytes.min(free / 2) { None } else { tempfile::tempfile_in(folder).ok() }
    }
}

/// Larger copies are not made on disk.
const MOST_BYTES: u64 = 16 << 30;

/// A copy of another source, with the same numbers.
pub enum Kept {
    InMemory(Held),
    OnDisk(Spooled),
}

fn cells(source: &dyn Heights) -> u64 {
    source.grid().width.saturating_mul(source.grid().height)
}

impl Kept {
    /// Of two sources that are read side by side: in memory both or neither.
    ///
    /// # Errors
    /// When one of them cannot be read.
    pub fn both(
        a: &dyn Heights,
        b: &dyn Heights,
        room: Room<'_>,
        cut: stream::Means,
    ) -> Result<(Option<Kept>, Option<Kept>)> {
        let fit = cells(a).saturating_add(cells(b)) <= room.held_cells;
        let room = Room { held_cells: if fit { room.held_cells } else { 0 }, ..room };
        Ok((Kept::of(a, &room, cut)?, Kept::of(b, &room, cut)?))
    }

    /// `None` where there is no room, or the disk fails: the source is still there.
    ///
    /// # Errors
    /// When the source cannot be read.
    pub fn of(source: &dyn Heights, room: &Room<'_>, cut: stream::Means) -> Result<Option<Kept>> {
        if cells(source) <= room.held_cells {
            return Ok(Held::of(source, cut)?.map(Kept::InMemory));
        }
        for number in [Number::Single, Number::Double] {
            match Spooled::of(source, room, number, cut)? {
                Copied::Whole(spooled) => return Ok(Some(Kept::OnDisk(spooled))),
                Copied::NoRoom => return Ok(None),
                Copied::Rounded => {}
            }
        }
        Ok(None)
    }
}

impl Heights for Kept {
    fn grid(&self) -> Grid {
        match self {
            Kept::InMemory(held) => held.grid(),
            Kept::OnDisk(spooled) => spooled.grid(),
        }
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        match self {
            Kept::InMemory(held) => held.read(patch, out),
            Kept::OnDisk(spooled) => spooled.read(patch, out),
        }
    }
}

/// Heights of another source in memory, as 32-bit numbers; NaN where there is none.
pub struct Held {
    grid: Grid,
    values: Vec<f32>,
}

impl Held {
    /// Reads the whole source; `None` when it has heights that are no 32-bit numbers: they would not come back as they
    /// were.
    ///
    /// # Errors
    /// When the source cannot be read.
    pub fn of(source: &dyn Heights, cut: stream::Means) -> Result<Option<Self>> {
        let grid = source.grid();
        // Tiles cover it; zeros cost nothing before they are written over.
        let values = Mutex::new(vec![0.0f32; (grid.width * grid.height) as usize]);
        let tiles = cut.tiles(grid.width, grid.height);
        let workers = stream::gather(
            &tiles,
            cut.threads,
            || (Vec::new(), true),
            |(buffer, exact), core| {
                if !*exact {
                    return Ok(());
                }
                let width = core.width as usize;
                source.read(core.into(), buffer)?;
                *exact = buffer.iter().all(|v| Number::Single.holds(*v));
                let mut values = values.lock().unwrap_or_else(PoisonError::into_inner);
                for (row, line) in (core.y..).zip(buffer.chunks_exact(width)) {
                    let from = (row * grid.width + core.x) as usize;
                    values[from..from + width].iter_mut().zip(line).for_each(|(to, v)| *to = *v as f32);
                }
                Ok(())
            },
        )?;
        let exact = workers.iter().all(|(_, exact)| *exact);
        let values = values.into_inner().unwrap_or_else(PoisonError::into_inner);
        Ok(exact.then_some(Held { grid, values }))
    }
}

impl Heights for Held {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        read_rows(&self.grid, &self.values, patch, out);
        Ok(())
    }
}

/// How a height lies in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Number {
    Single,
    Double,
}

impl Number {
    fn bytes(self) -> usize {
        match self {
            Number::Single => 4,
            Number::Double => 8,
        }
    }

    /// Whether a height comes back as it was.
    fn holds(self, v: f64) -> bool {
        self == Number::Double || v.is_nan() || f64::from(v as f32) == v
    }

    fn put(self, values: &[f64], bytes: &mut Vec<u8>) {
        bytes.clear();
        match self {
            Number::Single => values.iter().for_each(|v| bytes.extend((*v as f32).to_le_bytes())),
            Number::Double => values.iter().for_each(|v| bytes.extend(v.to_le_bytes())),
        }
    }

    fn get(self, bytes: &[u8], values: &mut [f64]) {
        match self {
            Number::Single => values
                .iter_mut()
                .zip(bytes.as_chunks::<4>().0)
                .for_each(|(v, b)| *v = f64::from(f32::from_le_bytes(*b))),
            Number::Double => {
                values.iter_mut().zip(bytes.as_chunks::<8>().0).for_each(|(v, b)| *v = f64::from_le_bytes(*b));
            }
        }
    }
}

/// What became of a copy.
enum Copied {
    Whole(Spooled),
    /// There are heights that the numbers of the copy do not hold.
    Rounded,
    NoRoom,
}

/// Heights of another source, decoded, in a file without a name: it goes when the program does.
pub struct Spooled {
    grid: Grid,
    number: Number,
    file: File,
}

impl Spooled {
    fn of(source: &dyn Heights, room: &Room<'_>, number: Number, cut: stream::Means) -> Result<Copied> {
        let grid = source.grid();
        let bytes = cells(source).saturating_mul(number.bytes() as u64);
        let Some(file) = room.file(bytes, MOST_BYTES) else { return Ok(Copied::NoRoom) };
        let spooled = Spooled { grid, number, file };
        let tiles = cut.tiles(grid.width, grid.height);
        let start = || (Vec::new(), Vec::new(), State::Good);
        let workers = stream::gather(&tiles, cut.threads, start, |(heights, bytes, state), core| {
            if *state != State::Good {
                return Ok(());
            }
            let width = core.width as usize;
            source.read(core.into(), heights)?;
            if !heights.iter().all(|v| number.holds(*v)) {
                *state = State::Rounded;
                return Ok(());
            }
            for (row, line) in (core.y..).zip(heights.chunks_exact(width)) {
                number.put(line, bytes);
                if spooled.file.write_all_at(bytes, spooled.offset(core.x, row)).is_err() {
                    *state = State::NoRoom;
                    return Ok(());
                }
            }
            Ok(())
        })?;
        let states = workers.into_iter().map(|(_, _, state)| state);
        Ok(match states.max().unwrap_or(State::Good) {
            State::Good => Copied::Whole(spooled),
            State::Rounded => Copied::Rounded,
            State::NoRoom => Copied::NoRoom,
        })
    }

    fn offset(&self, column: u64, row: u64) -> u64 {
        (row * self.grid.width + column) * self.number.bytes() as u64
    }
}

/// How a worker fares.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum State {
    Good,
    Rounded,
    NoRoom,
}

impl Heights for Spooled {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        let (width, height) = (self.grid.width as i64, self.grid.height as i64);
        out.clear();
        out.resize(patch.width * patch.height, f64::NAN);
        let first = patch.x.clamp(0, width);
        let last = (patch.x + patch.width as i64).clamp(first, width);
        let count = (last - first) as usize;
        let mut bytes = vec![0; count * self.number.bytes()];
        for (row, line) in (patch.y..).zip(out.chunks_exact_mut(patch.width)) {
            if (0..height).contains(&row) && count > 0 {
                let from = self.offset(first as u64, row as u64);
                self.file.read_exact_at(&mut bytes, from).map_err(unreadable)?;
                self.number.get(&bytes, &mut line[(first - patch.x) as usize..][..count]);
            }
        }
        Ok(())
    }
}

fn unreadable(error: io::Error) -> crate::error::Error {
    crate::error::Error::io(Path::new("the decoded copy of a model"), "read", error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::MemoryHeights;

    fn grid(width: u64, height: u64) -> Grid {
        Grid { x0: 0.0, y0: 0.0, step_x: 1.0, step_y: -1.0, width, height }
    }

    #[test]
    fn held_heights_come_back_as_they_were_or_are_not_held() {
        let values: Vec<f64> = (0..35 * 20).map(|i| if i % 9 == 0 { f64::NAN } else { f64::from(i) / 8.0 }).collect();
        let memory = MemoryHeights::new(grid(35, 20), values.clone());
        let held = Held::of(&memory, stream::Means::square(16, 2)).expect("memory").expect("eighths are exact");
        let patch = Patch { x: -2, y: -1, width: 40, height: 24 };
        let (mut a, mut b) = (Vec::new(), Vec::new());
        memory.read(patch, &mut a).expect("memory");
        held.read(patch, &mut b).expect("memory");
        assert!(a.iter().zip(&b).all(|(a, b)| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan()));
        let fine = MemoryHeights::new(grid(35, 20), values.iter().map(|v| v + 1e-9).collect());
        assert!(Held::of(&fine, stream::Means::square(16, 2)).expect("memory").is_none());
    }

    #[test]
    fn copies_on_disk_are_what_they_are_copies_of() {
        let folder = tempfile::tempdir().expect("a folder");
        let room = Room { held_cells: 10, scratch: Some(folder.path()) };
        let single: Vec<f64> = (0..35 * 20).map(|i| if i % 9 == 0 { f64::NAN } else { f64::from(i) / 8.0 }).collect();
        let double: Vec<f64> = single.iter().map(|v| v + 1e-9).collect();
        for (values, number) in [(single, Number::Single), (double, Number::Double)] {
            let memory = MemoryHeights::new(grid(35, 20), values);
            let kept = Kept::of(&memory, &room, stream::Means::square(16, 2)).expect("memory").expect("there is room");
            assert!(matches!(&kept, Kept::OnDisk(spooled) if spooled.number == number));
            let mut read = (Vec::new(), Vec::new());
            for patch in [(-2, -1, 40, 24), (3, 4, 7, 9), (40, 0, 3, 3), (-9, 5, 4, 2)] {
                let patch = Patch { x: patch.0, y: patch.1, width: patch.2, height: patch.3 };
                memory.read(patch, &mut read.0).expect("memory");
                kept.read(patch, &mut read.1).expect("a file");
                assert!(
                    read.0.iter().zip(&read.1).all(|(a, b)| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan())
                );
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0, "the files have no name");
        let memory = MemoryHeights::new(grid(35, 20), vec![1.0; 35 * 20]);
        let nowhere = Room { held_cells: 10, scratch: Some(Path::new("/absent")) };
        assert!(Kept::of(&memory, &nowhere, stream::Means::square(16, 2)).expect("memory").is_none());
        assert!(Kept::of(&memory, &Room::default(), stream::Means::square(16, 2)).expect("memory").is_none());
    }
}
