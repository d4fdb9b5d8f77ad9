//! Photographs as ground: decoded once into an unlinked scratch file, so that any number of them costs no memory, then
//! read by rows of windows.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gdal::Dataset;
use gdal::raster::{GdalDataType, ResampleAlg};

use super::rng::{hash2, mix, purpose};
use autoref_raster::error::{Error, Result};
use autoref_raster::window::Window;

/// Rows decoded at a time.
const BAND_ROWS: usize = 64;

#[derive(Clone, Copy, Debug)]
struct Photo {
    offset: u64,
    width: u64,
    height: u64,
}

/// Decoded photographs, RGB with 8 bits, in a scratch file that is gone when the store is.
#[derive(Debug)]
pub struct PhotoStore {
    file: File,
    /// For messages; the name exists no longer.
    path: PathBuf,
    photos: Vec<Photo>,
}

impl PhotoStore {
    /// Decodes photographs through GDAL: three bands, or one as grey; 16-bit samples are stretched so that the 99.5th
    /// percentile of a decimated look becomes 250.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a file that is no image to GDAL and for other sample types, [`Error::Gdal`] when
    /// reading fails, [`Error::Io`] for a file that is not there or a scratch file that cannot be written,
    /// [`Error::Usage`] for an empty list.
    pub fn open(paths: &[PathBuf]) -> Result<PhotoStore> {
        if paths.is_empty() {
            return Err(Error::usage("no photograph is given", "name at least one"));
        }
        let path = std::env::temp_dir();
        let file = tempfile::tempfile().map_err(|e| Error::io(&path, "make a scratch file in", e))?;
        let mut store = PhotoStore { file, path, photos: vec![] };
        let mut offset = 0;
        for path in paths {
            let photo = store.decode(path, offset)?;
            offset += photo.width * photo.height * 3;
            store.photos.push(photo);
        }
        Ok(store)
    }

    /// Number of photographs.
    pub fn len(&self) -> usize {
        self.photos.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.photos.is_empty()
    }

    /// Width and height of a photograph.
    ///
    /// # Panics
    /// When there is no such photograph.
    pub fn size(&self, index: usize) -> (u64, u64) {
        (self.photos[index].width, self.photos[index].height)
    }

    fn decode(&self, path: &Path, offset: u64) -> Result<Photo> {
        let gdal = |e: gdal::errors::GdalError| Error::gdal(path, e);
        std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
        // GDAL leaves its message empty when no driver knows the file.
        let dataset = Dataset::open(path).map_err(|_| {
            Error::unsupported(path, "GDAL does not know this file as an image", "use JPEG, TIFF or PNG")
        })?;
        let (width, height) = dataset.raster_size();
        let bands: Vec<usize> = if dataset.raster_count() >= 3 { vec![1, 2, 3] } else { vec![1, 1, 1] };
        let gain = match dataset.rasterband(1).map_err(gdal)?.band_type() {
            GdalDataType::UInt8 => None,
            GdalDataType::UInt16 => Some(stretch(&dataset, path, &bands)?),
            other => {
                return Err(Error::unsupported(
                    path,
                    format!("samples of type {other}"),
                    "use 8- or 16-bit photographs",
                ));
            }
        };
        let mut plane = vec![0u16; width * BAND_ROWS];
        let mut rows = vec![0u8; width * BAND_ROWS * 3];
        for top in (0..height).step_by(BAND_ROWS) {
            let n = BAND_ROWS.min(height - top);
            for (b, &band) in bands.iter().enumerate() {
                let plane = &mut plane[..width * n];
                let band = dataset.rasterband(band).map_err(gdal)?;
                band.read_into_slice((0, top as isize), (width, n), (width, n), plane, None).map_err(gdal)?;
                for (pixel, &v) in rows.chunks_exact_mut(3).zip(plane.iter()) {
                    pixel[b] = gain.map_or(v as u8, |g| (f64::from(v) * g).min(255.0) as u8);
                }
            }
            let at = offset + (top * width * 3) as u64;
            self.file
                .write_all_at(&rows[..width * n * 3], at)
                .map_err(|e| Error::io(&self.path, "write the decoded photographs to", e))?;
        }
        Ok(Photo { offset, width: width as u64, height: height as u64 })
    }

    /// A window of a photograph as it is.
    pub(crate) fn read_plain(&self, index: usize, window: Window, out: &mut [u8]) -> Result<()> {
        let width = window.width as usize * 3;
        for (row, y) in out.chunks_exact_mut(width).zip(window.y..) {
            self.read_row(index, window.x, y, row)?;
        }
        Ok(())
    }

    fn read_row(&self, index: usize, x: u64, y: u64, out: &mut [u8]) -> Result<()> {
        let p = self.photos[index];
        let at = p.offset + (y * p.width + x) * 3;
        self.file.read_exact_at(out, at).map_err(|e| Error::io(&self.path, "read the decoded photographs from", e))
    }

    /// Pixels `x..x + n` of row `y` of the plane that the photograph and its mirror images cover without end.
    fn read_mirrored(&self, index: usize, x: i64, y: i64, out: &mut [u8]) -> Result<()> {
        let p = self.photos[index];
        let fold = |v: i64, size: u64| {
            let r = v.rem_euclid(2 * size as i64) as u64;
            if r < size { (r, false) } else { (2 * size - 1 - r, true) }
        };
        let (row, _) = fold(y, p.height);
        let mut done = 0usize;
        let n = out.len() / 3;
        while done < n {
            let (column, backwards) = fold(x + done as i64, p.width);
            let run = (n - done).min(if backwards { column + 1 } else { p.width - column } as usize);
            let piece = &mut out[done * 3..(done + run) * 3];
            if backwards {
                self.read_row(index, column + 1 - run as u64, row, piece)?;
                // Reversing the bytes reverses the pixels and swaps red with blue; swap those back.
                piece.reverse();
                piece.chunks_exact_mut(3).for_each(|pixel| pixel.swap(0, 2));
            } else {
                self.read_row(index, column, row, piece)?;
            }
            done += run;
        }
        Ok(())
    }
}

/// Replaces every folder in a list by its photographs.
///
/// # Errors
/// [`Error::Io`] when a folder cannot be listed, [`Error::Usage`] when it holds no photograph.
pub fn photographs(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut all = vec![];
    for path in paths {
        if path.is_dir() {
            all.extend(photographs_in(path)?);
        } else {
            all.push(path.clone());
        }
    }
    Ok(all)
}

/// All photographs of a folder that GDAL may know by their extension, in order of name.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be listed, [`Error::Usage`] when it holds no photograph.
fn photographs_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let list = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?;
    let known = ["jpg", "jpeg", "tif", "tiff", "png"];
    let mut paths: Vec<_> = list
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|p| p.extension().and_then(|e| e.to_str()).is_some_and(|e| known.contains(&&*e.to_lowercase())))
        .collect();
    paths.sort();
    if paths.is_empty() {
        return Err(Error::usage(
            format!("{}: no photograph (jpg, tif, png) in this folder", folder.display()),
            "name files or another folder",
        ));
    }
    Ok(paths)
}

/// What to multiply 16-bit samples with.
fn stretch(dataset: &Dataset, path: &Path, bands: &[usize]) -> Result<f64> {
    let gdal = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let (width, height) = dataset.raster_size();
    let look = (width.min(256), height.min(256));
    let mut values: Vec<u16> = vec![];
    for &band in bands {
        let band = dataset.rasterband(band).map_err(gdal)?;
        let alg = Some(ResampleAlg::NearestNeighbour);
        values.extend(band.read_as::<u16>((0, 0), (width, height), look, alg).map_err(gdal)?.data());
    }
    values.sort_unstable();
    let high = values[(values.len() - 1) * 995 / 1000];
    Ok(250.0 / f64::from(high.max(1)))
}

/// Photographs laid out over an endless plane like bricks: each brick is a piece of a photograph, which goes on
/// mirrored where it ends; neighbouring bricks melt into each other over a narrow seam, so no straight cut remains.
#[derive(Debug)]
pub(crate) struct Patchwork {
    store: Arc<PhotoStore>,
    seed: u64,
    brick: (i64, i64),
    /// Cumulative areas, by which photographs are drawn.
    shares: Vec<u64>,
}

/// Width of the seams.
const SEAM_PX: i64 = 48;

impl Patchwork {
    pub(crate) fn new(store: Arc<PhotoStore>, seed: u64) -> Self {
        let mut total = 0;
        let shares = store
            .photos
            .iter()
            .map(|p| {
                total += p.width * p.height;
                total
            })
            .collect();
        Patchwork { store, seed, brick: (2400, 1800), shares }
    }

    pub(crate) fn render(&self, window: Window, out: &mut [u8]) -> Result<()> {
        let width = window.width as usize * 3;
        let (x, n) = (window.x as i64, window.width as usize);
        let mut other = vec![0u8; width];
        for (row, y) in out.chunks_exact_mut(width).zip(window.y as i64..) {
            if self.store.len() == 1 {
                // One photograph and its mirror images join without seams.
                let h = cell_hash(self.seed, 0, 0);
                self.store.read_mirrored(0, x + (h & 0xffff) as i64, y + (h >> 16 & 0xffff) as i64, row)?;
                continue;
            }
            let (course, in_course) = (y.div_euclid(self.brick.1), y.rem_euclid(self.brick.1));
            self.course_row(course, x, y, n, row)?;
            if in_course < SEAM_PX {
                self.course_row(course - 1, x, y, n, &mut other)?;
                blend(row, &other, |_| seam_weight(in_course));
            }
        }
        Ok(())
    }

    /// One row of a course of bricks, also beyond its lower edge.
    fn course_row(&self, course: i64, x: i64, y: i64, n: usize, out: &mut [u8]) -> Result<()> {
        let shift = (cell_hash(self.seed, i64::MIN, course) % self.brick.0 as u64) as i64;
        let end = x + n as i64;
        let mut at = x;
        let mut seam = vec![0u8; SEAM_PX as usize * 3];
        while at < end {
            let (brick, inside) = ((at + shift).div_euclid(self.brick.0), (at + shift).rem_euclid(self.brick.0));
            let run = (end - at).min(self.brick.0 - inside);
            let start = (at - x) as usize * 3;
            let piece = &mut out[start..start + run as usize * 3];
            self.brick_row(brick, course, at, y, piece)?;
            if inside < SEAM_PX {
                let m = run.min(SEAM_PX - inside) as usize;
                self.brick_row(brick - 1, course, at, y, &mut seam[..m * 3])?;
                blend(&mut piece[..m * 3], &seam[..m * 3], |i| seam_weight(inside + i as i64));
            }
            at += run;
        }
        Ok(())
    }

    fn brick_row(&self, brick: i64, course: i64, x: i64, y: i64, out: &mut [u8]) -> Result<()> {
        let h = cell_hash(self.seed, brick, course);
        let total = *self.shares.last().expect("a store holds at least one photograph");
        let pick = cell_hash(h, brick, course) % total;
        let photo = self.shares.partition_point(|&s| s <= pick);
        let p = self.store.photos[photo];
        // Where a photograph is larger than a brick and its seam, the brick shows a piece of it or of its mirror image,
        // never the line between them.
        let left = brick * self.brick.0 - (cell_hash(self.seed, i64::MIN, course) % self.brick.0 as u64) as i64;
        let within = |size: u64, brick: i64, h: u64| {
            let room = size as i64 - brick - SEAM_PX;
            if room > 0 { (h / 2 % room as u64 + h % 2 * size) as i64 } else { (h % (2 * size)) as i64 }
        };
        let (ox, oy) = (within(p.width, self.brick.0, h & 0xfffff), within(p.height, self.brick.1, h >> 20 & 0xfffff));
        self.store.read_mirrored(photo, x - left + ox, y - course * self.brick.1 + oy, out)
    }
}

/// Share (of 256) of the older brick at a distance into the seam.
fn seam_weight(distance: i64) -> u32 {
    let t = (distance as f32 + 0.5) / SEAM_PX as f32;
    (256.0 * (1.0 - t * t * (3.0 - 2.0 * t))) as u32
}

fn blend(row: &mut [u8], other: &[u8], weight: impl Fn(usize) -> u32) {
    for (i, (a, b)) in row.chunks_exact_mut(3).zip(other.chunks_exact(3)).enumerate() {
        let w = weight(i);
        for (a, b) in a.iter_mut().zip(b) {
            *a = ((u32::from(*a) * (256 - w) + u32::from(*b) * w + 128) >> 8) as u8;
        }
    }
}

/// A stable hash of a spec's cell, for the patchwork.
fn cell_hash(seed: u64, column: i64, row: i64) -> u64 {
    hash2(mix(seed ^ purpose::MOSAIC), column, row)
}
