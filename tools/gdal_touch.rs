//! The yardstick of `benches/compare.sh`: GDAL reading every block of a raster and touching its bytes, nothing else.
//!
//!     gdal_touch FILE THREADS
//!
//! Each thread has a dataset of its own, as GDAL asks for, and takes whole rows of blocks (a million pixels of strips).

#![allow(unsafe_code)] // GDAL is called as a C program would

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use gdal::Dataset;

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let (file, threads) = match (args.next(), args.next()) {
        (Some(file), Some(threads)) => (file, threads.parse::<usize>()?),
        _ => anyhow::bail!("usage: gdal_touch FILE THREADS"),
    };
    let dataset = Dataset::open(Path::new(&file))?;
    let (width, height) = dataset.raster_size();
    let (block_width, block_height) = dataset.rasterband(1)?.block_size();
    let strips = block_width >= width;
    let rows = if strips { ((1 << 20) / width).max(1).next_multiple_of(block_height) } else { block_height };
    let columns = if strips { width } else { block_width };
    drop(dataset);
    let bands: Vec<usize> = vec![1, 2, 3];
    let jobs: Vec<(usize, usize)> =
        (0..height).step_by(rows).flat_map(|y| (0..width).step_by(columns).map(move |x| (x, y))).collect();
    let next = AtomicUsize::new(0);
    let sum: u64 = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads)
            .map(|_| {
                scope.spawn(|| -> anyhow::Result<u64> {
                    let dataset = Dataset::open(Path::new(&file))?;
                    let mut sum = 0u64;
                    let mut buffer = vec![0u8; columns * rows * bands.len()];
                    while let Some(&(x, y)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let size = (columns.min(width - x), rows.min(height - y));
                        let part = &mut buffer[..size.0 * size.1 * bands.len()];
                        // One call for all bands, pixel-interleaved, as a careful user of GDAL would.
                        read_interleaved(&dataset, (x, y), size, bands.len(), part)?;
                        sum += part.iter().step_by(64).map(|&b| u64::from(b)).sum::<u64>();
                    }
                    Ok(sum)
                })
            })
            .collect();
        workers.into_iter().map(|w| w.join().expect("a reader does not panic")).sum::<anyhow::Result<u64>>()
    })?;
    println!("{sum}");
    Ok(())
}

fn read_interleaved(
    dataset: &Dataset,
    (x, y): (usize, usize),
    (width, height): (usize, usize),
    bands: usize,
    out: &mut [u8],
) -> anyhow::Result<()> {
    assert!(out.len() >= width * height * bands);
    // SAFETY: the buffer holds width × height × bands bytes, and the spacings address no more than that.
    let status = unsafe {
        gdal_sys::GDALDatasetRasterIO(
            dataset.c_dataset(),
            gdal_sys::GDALRWFlag::GF_Read,
            x as i32,
            y as i32,
            width as i32,
            height as i32,
            out.as_mut_ptr().cast(),
            width as i32,
            height as i32,
            gdal_sys::GDALDataType::GDT_Byte,
            bands as i32,
            std::ptr::null_mut(),
            bands as i32,
            (bands * width) as i32,
            1,
        )
    };
    anyhow::ensure!(status == gdal_sys::CPLErr::CE_None, "GDAL could not read at {x}, {y}");
    Ok(())
}
