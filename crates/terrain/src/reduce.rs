//! From the frame's file to a grey image at the reduced scale: every file block is read once, in tiles or bands.

use std::path::Path;
use std::sync::Arc;

use autoref_raster::error::{Error, Result};
use autoref_raster::window::{TileGrid, Window};
use autoref_raster::{Block, PixelRow, RasterInfo, RasterSource, SampleType, Samples};
use rayon::prelude::*;

use crate::bits::BitMask;
use crate::plane::Plane;
use crate::smooth::{GAUSSIAN_HALO_PX, gaussian, reduce};

/// A frame at the reduced scale.
pub struct Reduced {
    pub grey: Plane,
    /// Pixels that hold something, in at least half of what they stand for.
    pub valid: BitMask,
    /// Size of the frame.
    pub width: u64,
    pub height: u64,
    pub factor: usize,
    /// Grey levels that the sample type's white is above its black: 255 of 8-bit frames, more where levels were spread.
    pub white_steps: f64,
    /// Smoothed before it was reduced.
    pub smooth: bool,
}

/// How a frame is read.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Pixels of the frame that one pixel stands for, along a side.
    pub factor: usize,
    pub smooth: bool,
    /// Side of a tile, px of the frame; 0 lets the memory decide.
    pub tile_px: u64,
    pub memory_budget_bytes: u64,
    /// Masks that are held beside those of the method.
    pub masks_beside: u64,
}

/// Samples to 8 bits: of wider ones what lies between the 0.1st and the 99.9th percentile is spread out.
struct Levels {
    low: f64,
    high: f64,
    identity: bool,
}

impl Levels {
    fn of(source: &dyn RasterSource) -> Result<Levels> {
        let info = source.info();
        if info.sample == SampleType::U8 {
            return Ok(Levels { low: 0.0, high: f64::from(info.white), identity: info.white == 255 });
        }
        // The same windows whatever the tiling: 16 × 16 of them, spread evenly.
        let side = |length: u64| length.div_ceil(16).min(64);
        let mut counts = vec![0u64; 65_536];
        let (w, h) = (side(info.width), side(info.height));
        for j in 0..16 {
            for i in 0..16 {
                let at = |k: u64, length: u64, side: u64| (length - side) * k / 15;
                let window = Window::new(at(i, info.width, w), at(j, info.height, h), w, h);
                each_row(&source.read(window)?, |_, _, row| {
                    for_grey(&row, info, |_, value, valid| counts[usize::from(value)] += u64::from(valid));
                });
            }
        }
        let total: u64 = counts.iter().sum();
        let percentile = |share: f64| {
            let mut below = 0;
            counts.iter().position(|count| {
                below += count;
                below as f64 >= share * total as f64 && below > 0
            })
        };
        let (low, high) = (percentile(0.001).unwrap_or(0) as f64, percentile(0.999).unwrap_or(65_535) as f64);
        Ok(Levels { low, high: high.max(low + 1.0), identity: false })
    }

    fn white_steps(&self, white: f64) -> f64 {
        255.0 * white / (self.high - self.low)
    }

    fn level(&self, value: u16) -> u8 {
        if self.identity {
            return value as u8;
        }
        ((f64::from(value) - self.low) * 255.0 / (self.high - self.low) + 0.5).clamp(0.0, 255.0) as u8
    }
}

/// Calls `see(x, y, row)` for every row of every piece that holds something.
fn each_row(block: &Block, mut see: impl FnMut(u64, u64, PixelRow)) {
    for piece in block.pieces.iter().filter(|piece| !piece.empty) {
        let part = piece.window.intersect(&block.window);
        for y in part.y..part.bottom() {
            see(part.x, y, piece.row(part.x, y, part.width));
        }
    }
}

/// Grey values of a row: of colour 0.299 R + 0.587 G + 0.114 B in 15 bits, rounded, as OpenCV's `COLOR_RGB2GRAY`.
fn for_grey(row: &PixelRow, info: &RasterInfo, mut see: impl FnMut(usize, u16, bool)) {
    let nodata = info.nodata_sample();
    let [r, g, b] = info.rgb;
    let mut one = |i: usize, pixel: &dyn Fn(usize) -> u16| {
        let (red, green, blue) = (pixel(r), pixel(g), pixel(b));
        let sum = 9798 * u32::from(red) + 19_235 * u32::from(green) + 3735 * u32::from(blue);
        let empty =
            info.alpha.is_some_and(|alpha| pixel(alpha) == 0) || nodata.is_some_and(|n| [red, green, blue] == [n; 3]);
        see(i, ((sum + 16_384) >> 15) as u16, !empty);
    };
    for i in 0..row.len {
        let first = i * row.pixel_stride;
        match row.samples {
            Samples::U8(samples) => one(i, &|band| u16::from(samples[first + band])),
            Samples::U16(samples) => one(i, &|band| samples[first + band]),
        }
    }
}

/// Grey pixels of a window and which of them hold something.
struct Grey {
    window: Window,
    level: Vec<u8>,
    valid: Vec<bool>,
}

fn read_grey(source: &dyn RasterSource, window: Window, levels: &Levels) -> Result<Grey> {
    let info = source.info();
    let block = source.read(window)?;
    let count = window.area() as usize;
    let mut grey = Grey { window, level: vec![0; count], valid: vec![false; count] };
    each_row(&block, |x, y, row| {
        let first = ((y - window.y) * window.width + x - window.x) as usize;
        for_grey(&row, info, |i, value, valid| {
            grey.level[first + i] = levels.level(value);
            grey.valid[first + i] = valid;
        });
    });
    Ok(grey)
}

/// Smooths `grey` and reduces the part of it in `core`, which is aligned to the factor.
fn reduce_core(grey: &Grey, core: Window, reading: &Reading) -> (Window, Vec<u8>, Vec<bool>) {
    let (w, h) = (grey.window.width as usize, grey.window.height as usize);
    let smoothed = if reading.smooth { gaussian(&grey.level, w, h) } else { grey.level.clone() };
    let (left, top) = ((core.x - grey.window.x) as usize, (core.y - grey.window.y) as usize);
    let (cw, ch) = (core.width as usize, core.height as usize);
    let cut = |y: usize| (top + y) * w + left..(top + y) * w + left + cw;
    let pixels: Vec<u8> = (0..ch).flat_map(|y| smoothed[cut(y)].iter().copied()).collect();
    let factor = reading.factor;
    let reduced = reduce(&pixels, cw, ch, factor);
    let (rw, rh) = (cw.div_ceil(factor), ch.div_ceil(factor));
    let mut full = vec![[0u32; 2]; rw * rh];
    for y in 0..ch {
        for (x, &valid) in grey.valid[cut(y)].iter().enumerate() {
            let counts = &mut full[y / factor * rw + x / factor];
            counts[usize::from(valid)] += 1;
        }
    }
    let valid = full.iter().map(|[empty, held]| held >= empty).collect();
    let at = factor as u64;
    (Window::new(core.x / at, core.y / at, rw as u64, rh as u64), reduced, valid)
}

/// Reads a frame and reduces it.
///
/// # Errors
/// When the file cannot be read, or the masks of it do not fit the memory.
pub fn reduce_frame(source: &Arc<dyn RasterSource>, reading: &Reading) -> Result<Reduced> {
    let info = source.info();
    let (width, height, factor) = (info.width, info.height, reading.factor as u64);
    let (rw, rh) = (width.div_ceil(factor), height.div_ceil(factor));
    check_memory(&info.path, rw, rh, reading)?;
    let levels = Levels::of(source.as_ref())?;
    let mut grey = Plane::new(rw as usize, rh as usize, plane_memory(reading))?;
    let mut valid = BitMask::new(rw as usize, rh as usize);
    let mut store = |(window, pixels, held): (Window, Vec<u8>, Vec<bool>)| -> Result<()> {
        grey.write(&window, &pixels)?;
        for (i, _) in held.iter().enumerate().filter(|(_, held)| **held) {
            let (x, y) = (window.x as usize + i % window.width as usize, window.y as usize + i / window.width as usize);
            valid.set(x, y, true);
        }
        Ok(())
    };
    let bounds = info.bounds();
    if info.sequential {
        bands(source.as_ref(), &levels, reading, &mut store)?;
    } else {
        let asked = if reading.tile_px > 0 { reading.tile_px } else { 1024 };
        let tile = asked.div_ceil(factor) * factor;
        let grid = TileGrid::new(width, height, tile, tile, 0);
        let threads = rayon::current_num_threads() as u64;
        for first in (0..grid.len()).step_by(threads as usize) {
            let some: Vec<u64> = (first..(first + threads).min(grid.len())).collect();
            let done: Vec<Result<_>> = some
                .into_par_iter()
                .map(|id| {
                    let core = grid.tile(id).core;
                    let grey = read_grey(source.as_ref(), core.grown(GAUSSIAN_HALO_PX as u64, &bounds), &levels)?;
                    Ok(reduce_core(&grey, core, reading))
                })
                .collect();
            done.into_iter().try_for_each(|tile| store(tile?))?;
        }
    }
    Ok(Reduced {
        grey,
        valid,
        width,
        height,
        factor: reading.factor,
        white_steps: levels.white_steps(info.white.into()),
        smooth: reading.smooth,
    })
}

/// Full-width bands from the top down; the rows that two bands share are kept, so that nothing is read twice.
fn bands(
    source: &dyn RasterSource,
    levels: &Levels,
    reading: &Reading,
    store: &mut impl FnMut((Window, Vec<u8>, Vec<bool>)) -> Result<()>,
) -> Result<()> {
    let info = source.info();
    let (width, height, factor) = (info.width, info.height, reading.factor as u64);
    let halo = GAUSSIAN_HALO_PX as u64;
    let rows = ((4 << 20) / width.max(1)).clamp(factor, 1024).div_ceil(factor) * factor;
    let mut held = Grey { window: Window::new(0, 0, width, 0), level: Vec::new(), valid: Vec::new() };
    for top in (0..height).step_by(rows as usize) {
        let core = Window::new(0, top, width, rows.min(height - top));
        let end = (core.bottom() + halo).min(height);
        let fresh = read_grey(source, Window::new(0, held.window.bottom(), width, end - held.window.bottom()), levels)?;
        held.level.extend(fresh.level);
        held.valid.extend(fresh.valid);
        held.window.height = end - held.window.y;
        store(reduce_core(&held, core, reading))?;
        let gone = core.bottom().saturating_sub(halo).max(held.window.y) - held.window.y;
        held.level.drain(..(gone * width) as usize);
        held.valid.drain(..(gone * width) as usize);
        held.window = Window::new(0, held.window.y + gone, width, held.window.height - gone);
    }
    Ok(())
}

/// What a plane may hold in memory.
pub fn plane_memory(reading: &Reading) -> u64 {
    reading.memory_budget_bytes.saturating_sub(96 << 20) / 8
}

/// Masks that are held at a time: what holds anything, what is decided and what is unsure, and what is kept. And what
/// everything else takes.
const MASKS_HELD: u64 = 4;
const BASE_BYTES: u64 = 64 << 20;

fn check_memory(path: &Path, width: u64, height: u64, reading: &Reading) -> Result<()> {
    let needed = BASE_BYTES + (MASKS_HELD + reading.masks_beside) * BitMask::bytes_for(width, height);
    if needed <= reading.memory_budget_bytes {
        return Ok(());
    }
    Err(Error::Limit {
        what: format!("{}: masks of {width} × {height} px", path.display()),
        needed,
        allowed: reading.memory_budget_bytes,
        remedy: "raise --memory or --reduce".into(),
    })
}
