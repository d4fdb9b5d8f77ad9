//! TIFFs of every kind, written by GDAL, with the samples that went in.

use std::path::{Path, PathBuf};

use autoref_raster::Patch;
use autoref_raster::window::Window;
use gdal::DriverManager;
use gdal::raster::{Buffer, GdalType, RasterCreationOptions};

/// What a file is like.
#[derive(Clone, Debug)]
pub struct Kind {
    pub width: usize,
    pub height: usize,
    pub bands: usize,
    pub sixteen: bool,
    /// GDAL creation options, "KEY=VALUE".
    pub options: Vec<String>,
    /// Leave every block but the first out of the file.
    pub sparse: bool,
    pub nodata: Option<f64>,
    /// From this column on every pixel is nodata, or transparent, and in the file all the same.
    pub collar_from: Option<usize>,
}

impl Kind {
    pub fn new(bands: usize, sixteen: bool, options: &[&str]) -> Self {
        let options = options.iter().map(|s| s.to_string()).collect();
        Kind { width: 203, height: 157, bands, sixteen, options, sparse: false, nodata: None, collar_from: None }
    }

    /// Smooth with noise, so that predictors, runs and dictionaries all have work; alpha has holes.
    pub fn sample(&self, x: usize, y: usize, band: usize) -> u16 {
        if self.sparse && (x >= 64 || y >= 48) || self.collar_from.is_some_and(|column| x >= column) {
            return self.nodata.map_or(0, |value| value as u16);
        }
        if band + 1 == self.bands && self.bands.is_multiple_of(2) {
            return if (x / 16 + y / 8).is_multiple_of(5) { 0 } else { 255 };
        }
        let noise = (x * 7919 + y * 104_729 + band * 1_299_709) % 97 % 7;
        let smooth = x + 2 * y + 40 * band + if (x / 30).is_multiple_of(2) { noise } else { 0 };
        if self.sixteen { (smooth * 131 % 65_536) as u16 } else { (smooth % 256) as u16 }
    }

    fn write_bands<T: GdalType + Copy>(&self, path: &Path, convert: impl Fn(u16) -> T) {
        let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has GeoTIFF");
        let mut options = RasterCreationOptions::new();
        for option in &self.options {
            let (key, value) = option.split_once('=').expect("KEY=VALUE");
            options.set_name_value(key, value).expect("no zero bytes");
        }
        if self.bands >= 3 && !self.options.iter().any(|o| o.starts_with("PHOTOMETRIC")) {
            options.set_name_value("PHOTOMETRIC", "RGB").expect("no zero bytes");
        }
        if self.bands.is_multiple_of(2) {
            options.set_name_value("ALPHA", "YES").expect("no zero bytes");
        }
        if self.sparse {
            options.set_name_value("SPARSE_OK", "TRUE").expect("no zero bytes");
        }
        let mut dataset = driver
            .create_with_band_type_with_options::<T, _>(path, self.width, self.height, self.bands, &options)
            .expect("GDAL writes this kind");
        let (w, h) = if self.sparse { (64, 48) } else { (self.width, self.height) };
        for band in 0..self.bands {
            let mut target = dataset.rasterband(band + 1).expect("the band is there");
            if self.nodata.is_some() {
                target.set_no_data_value(self.nodata).expect("GDAL keeps it");
            }
            let samples = (0..w * h).map(|i| convert(self.sample(i % w, i / w, band))).collect();
            target.write((0, 0), (w, h), &mut Buffer::new((w, h), samples)).expect("GDAL writes");
        }
        dataset.flush_cache().expect("GDAL writes");
    }

    pub fn write(&self, folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        match self.sixteen {
            true => self.write_bands::<u16>(&path, |v| v),
            false => self.write_bands::<u8>(&path, |v| v as u8),
        }
        path
    }

    /// The samples that went in.
    pub fn truth(&self, window: Window) -> Patch {
        let alpha = self.bands.is_multiple_of(2).then(|| self.bands - 1);
        let (mut rgb, mut valid) = (Vec::new(), Vec::new());
        for y in window.y as usize..window.bottom() as usize {
            for x in window.x as usize..window.right() as usize {
                let colour = |band| self.sample(x, y, if self.bands >= 3 { band } else { 0 });
                let pixel = [colour(0), colour(1), colour(2)];
                let nodata = self.nodata.is_some_and(|n| pixel.iter().all(|&v| f64::from(v) == n));
                valid.push(!nodata && alpha.is_none_or(|band| self.sample(x, y, band) != 0));
                rgb.push(pixel);
            }
        }
        Patch { window, rgb, valid, white: if self.sixteen { 65_535 } else { 255 } }
    }
}
