//! What GDAL itself says about a file, without any of our reading code.

pub mod made;

use std::path::Path;

use autoref_raster::Patch;
use autoref_raster::window::Window;
use gdal::Dataset;
use gdal::raster::ColorInterpretation as Colour;

/// A window as GDAL reads it: red, green, blue (or grey), palette applied, and the mask of the first colour band.
pub fn gdal_patch(path: &Path, window: Window) -> Result<Patch, gdal::errors::GdalError> {
    let dataset = Dataset::open(path)?;
    let count = dataset.raster_count();
    let at = (window.x as isize, window.y as isize);
    let size = (window.width as usize, window.height as usize);
    let read = |number: usize| -> Result<Vec<u16>, gdal::errors::GdalError> {
        Ok(dataset.rasterband(number)?.read_as::<u16>(at, size, size, None)?.data().to_vec())
    };
    let first = dataset.rasterband(1)?;
    let pixels = window.area() as usize;
    let nodata = first.no_data_value();
    if let (Colour::PaletteIndex, Some(table)) = (first.color_interpretation(), first.color_table()) {
        let indices = read(1)?;
        let colour = |index: u16| table.entry_as_rgb(usize::from(index)).map_or([0; 4], |e| [e.r, e.g, e.b, e.a]);
        let rgb = indices.iter().map(|&i| [0, 1, 2].map(|k| colour(i)[k] as u16)).collect();
        let valid = indices.iter().map(|&i| colour(i)[3] != 0 && nodata != Some(f64::from(i))).collect();
        return Ok(Patch { window, rgb, valid, white: 255 });
    }
    let colours: Vec<Colour> = (1..=count)
        .map(|n| Ok(dataset.rasterband(n)?.color_interpretation()))
        .collect::<Result<_, gdal::errors::GdalError>>()?;
    let alpha = colours.iter().position(|c| *c == Colour::AlphaBand).map(|i| i + 1);
    let mut bands: Vec<usize> = (1..=count).filter(|&n| Some(n) != alpha).take(3).collect();
    if bands.len() < 3 {
        bands = vec![bands[0]; 3];
    }
    let planes = bands.iter().map(|&n| read(n)).collect::<Result<Vec<_>, _>>()?;
    let rgb: Vec<[u16; 3]> = (0..pixels).map(|i| [planes[0][i], planes[1][i], planes[2][i]]).collect();
    let flags = first.mask_flags()?;
    let valid = if flags.is_nodata() {
        rgb.iter().map(|pixel| pixel.iter().any(|&v| Some(f64::from(v)) != nodata)).collect()
    } else if flags.is_all_valid() {
        vec![true; pixels]
    } else if let Some(alpha) = alpha {
        read(alpha)?.iter().map(|&a| a != 0).collect()
    } else {
        let mask = first.open_mask_band()?;
        mask.read_as::<u8>(at, size, size, None)?.data().iter().map(|&m| m != 0).collect()
    };
    Ok(Patch { window, rgb, valid, white: 0 })
}

/// Largest and mean absolute difference of the samples of two patches of the same window.
pub fn worst_difference(a: &Patch, b: &Patch) -> (u16, f64) {
    assert_eq!(a.window, b.window);
    let differences = a.rgb.iter().zip(&b.rgb).flat_map(|(a, b)| (0..3).map(move |i| a[i].abs_diff(b[i])));
    let (mut largest, mut sum) = (0, 0.0);
    for difference in differences {
        largest = largest.max(difference);
        sum += f64::from(difference);
    }
    (largest, sum / (3 * a.rgb.len()) as f64)
}
