//! A grey image at the reduced scale: in memory while it is small, in a scratch file otherwise.

use std::fs::File;
use std::os::unix::fs::FileExt;

use autoref_raster::error::{Error, Result};
use autoref_raster::window::Window;

enum Store {
    Memory(Vec<u8>),
    Scratch(File),
}

/// One byte a pixel, row-major, written and read in windows.
pub struct Plane {
    width: usize,
    height: usize,
    store: Store,
}

impl Plane {
    /// A plane of zeros that takes at most `memory_bytes`.
    ///
    /// # Errors
    /// When a scratch file is needed and the folder for temporary files has no room for it.
    pub fn new(width: usize, height: usize, memory_bytes: u64) -> Result<Plane> {
        let bytes = (width * height) as u64;
        let store = if bytes <= memory_bytes {
            Store::Memory(vec![0; width * height])
        } else {
            let failed = |e| Error::io(std::env::temp_dir(), "make a scratch file in", e);
            let file = tempfile::tempfile().map_err(failed)?;
            file.set_len(bytes).map_err(failed)?;
            Store::Scratch(file)
        };
        Ok(Plane { width, height, store })
    }

    /// Width, pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Writes the pixels of `window`, row-major.
    ///
    /// # Errors
    /// When the scratch file cannot be written.
    pub fn write(&mut self, window: &Window, pixels: &[u8]) -> Result<()> {
        let (x, y, w) = (window.x as usize, window.y as usize, window.width as usize);
        for (i, row) in pixels.chunks_exact(w.max(1)).enumerate() {
            let first = (y + i) * self.width + x;
            match &mut self.store {
                Store::Memory(all) => all[first..first + w].copy_from_slice(row),
                Store::Scratch(file) => file
                    .write_all_at(row, first as u64)
                    .map_err(|e| Error::io(std::env::temp_dir(), "write a scratch file in", e))?,
            }
        }
        Ok(())
    }

    /// The pixels of the window that begins at `x`, `y`, row-major; where it leaves the plane they are mirrored about
    /// the outer pixels' centres.
    ///
    /// # Errors
    /// When the scratch file cannot be read.
    pub fn mirrored(&self, x: i64, y: i64, width: usize, height: usize) -> Result<Vec<u8>> {
        let mut out = vec![0; width * height];
        let columns: Vec<usize> = (0..width as i64).map(|i| mirror(x + i, self.width)).collect();
        let first = columns.iter().copied().min().unwrap_or(0);
        let last = columns.iter().copied().max().unwrap_or(0);
        let mut line = vec![0; last + 1 - first];
        let length = line.len();
        for (i, row) in out.chunks_exact_mut(width.max(1)).enumerate() {
            let at = mirror(y + i as i64, self.height) * self.width + first;
            match &self.store {
                Store::Memory(all) => line.copy_from_slice(&all[at..at + length]),
                Store::Scratch(file) => file
                    .read_exact_at(&mut line, at as u64)
                    .map_err(|e| Error::io(std::env::temp_dir(), "read a scratch file in", e))?,
            }
            row.iter_mut().zip(&columns).for_each(|(value, column)| *value = line[column - first]);
        }
        Ok(out)
    }

    /// The pixels of `window`, which must lie in the plane.
    ///
    /// # Errors
    /// When the scratch file cannot be read.
    pub fn read(&self, window: &Window) -> Result<Vec<u8>> {
        self.mirrored(window.x as i64, window.y as i64, window.width as usize, window.height as usize)
    }
}

fn mirror(position: i64, length: usize) -> usize {
    if length <= 1 {
        return 0;
    }
    let period = 2 * (length as i64 - 1);
    let folded = position.rem_euclid(period);
    folded.min(period - folded) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scratch_and_memory_hold_the_same() {
        let read = |memory: u64| {
            let mut plane = Plane::new(7, 5, memory).expect("a plane");
            plane.write(&Window::new(0, 0, 7, 5), &(0..35).collect::<Vec<u8>>()).expect("written");
            plane.write(&Window::new(2, 1, 3, 2), &[100; 6]).expect("written");
            plane.mirrored(-3, -2, 14, 10).expect("read")
        };
        assert_eq!(read(0), read(35));
        // Row −2 is row 2, column −3 is column 3.
        assert_eq!(read(0)[0], 100);
        let mut small = Plane::new(1, 1, 0).expect("a plane");
        small.write(&Window::new(0, 0, 1, 1), &[9]).expect("written");
        assert_eq!(small.mirrored(-5, -5, 11, 11).expect("read"), [9; 121]);
    }
}
