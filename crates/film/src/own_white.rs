//! A scan whose values fill little of their 16 bits: 8 or 9 bits of a scanner, written without a word of it.

use autoref_raster::error::Result;
use autoref_raster::{Described, RasterInfo, RasterSource, SampleType};

use super::window::{read_rows, samples_of_rows};

/// Values that stay below this share of white look flat, as what differs by less than half an 8-bit level does.
const LITTLE: u16 = 64;

/// One pixel of so many may be brighter than white: defects of the sensor.
const DEFECTS: u64 = 100_000;

/// The same pixels with their largest value for white, but for single ones. Looks at all pixels; `None` where they fill
/// more of their bits.
///
/// # Errors
/// Those of reading the scan.
pub(super) fn with_own_white(source: &dyn RasterSource) -> Result<Option<Described<&dyn RasterSource>>> {
    let info = source.info();
    if info.sample != SampleType::U16 {
        return Ok(None);
    }
    let samples = samples_of_rows(info);
    let mut counts = vec![0u64; 1 << 16];
    read_rows(source, &mut |row| {
        row.iter().step_by(samples).for_each(|&value| counts[usize::from(value)] += 1);
        Ok(())
    })?;
    let most_above = info.width * info.height / DEFECTS;
    let mut above = 0;
    let is_reached = |&value: &usize| {
        above += counts[value];
        above > most_above
    };
    let white = (0..counts.len()).rev().find(is_reached).unwrap_or(0) as u16;
    let fills_little = white > 0 && white < info.white / LITTLE;
    Ok(fills_little.then(|| Described::new(source, RasterInfo { white, ..info.clone() })))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::frame::{FindOptions, Finder};
    use crate::interior::distance;
    use crate::types::{Camera, FrameStatus};
    use crate::window::{GreySource, blur};
    use autoref_raster::coords::PixelPoint;

    const SIDE: usize = 600;

    fn camera() -> Camera {
        let mark = |name: &str, x: f64, y: f64| {
            format!("{{ name = \"{name}\", x_mm = {x}, y_mm = {y}, kind = {{ shape = \"dot\", diameter_mm = 0.4 }} }}")
        };
        let marks = [mark("A", -9.0, -9.0), mark("B", 9.02, -9.0), mark("C", 9.0, 9.03), mark("D", -9.01, 9.0)];
        let text = format!(
            "name = \"small\"\nfilm_size_mm = [24.0, 24.0]\ny_axis = \"down\"\nupright = true\nmarks = [{}]",
            marks.join(", ")
        );
        toml::from_str(&text).expect("a camera")
    }

    /// A frame of the camera, 25 px to a millimetre, as grey values from 0 to 1.
    fn drawn(places: &[PixelPoint]) -> Vec<f32> {
        let grain = |n: usize| ((n as u32).wrapping_mul(2_654_435_761) >> 24) as f32 / 255.0;
        let mut values: Vec<f32> = (0..SIDE * SIDE).map(|n| 0.06 + 0.01 * grain(n)).collect();
        for p in places {
            for n in 0..24 * 24 {
                let (x, y) = (p.x.floor() as usize + n % 24 - 12, p.y.floor() as usize + n / 24 - 12);
                let part = |k: usize| (k as f64 + 0.5) / 8.0;
                let is_in = |k: &usize| (x as f64 + part(k % 8) - p.x).hypot(y as f64 + part(k / 8) - p.y) < 5.0;
                values[y * SIDE + x] += 0.7 * (0..64).filter(is_in).count() as f32 / 64.0;
            }
        }
        blur(&mut values, SIDE, SIDE, 0.7);
        values
    }

    #[test]
    fn eight_bits_in_sixteen_show_their_marks() {
        let camera = camera();
        let middle = PixelPoint { x: 300.3, y: 299.6 };
        let at = |mm: &[f64; 2]| PixelPoint { x: middle.x + 25.0 * mm[0], y: middle.y + 25.0 * mm[1] };
        let places: Vec<PixelPoint> = camera.film_points().iter().map(at).collect();
        let values = drawn(&places);
        let scan = |white: f32| {
            let data = values.iter().map(|v| (v * white).round() as u16).collect();
            GreySource::new(Path::new("small.tif"), SIDE as u64, SIDE as u64, data)
        };
        assert!(with_own_white(&scan(4095.0)).expect("memory").is_none(), "12 bits show them as they are");
        let hot = |value: f32| (value * 255.0).round() as u16;
        let mut data: Vec<u16> = values.iter().map(|v| hot(*v)).collect();
        (data[7], data[70_007]) = (u16::MAX, 5_000);
        let hot = GreySource::new(Path::new("hot.tif"), SIDE as u64, SIDE as u64, data);
        assert!(with_own_white(&hot).expect("memory").is_some_and(|scan| scan.info().white < 256), "two hot pixels");
        // In smaller boxes of so small a frame specks would agree by chance.
        let options = FindOptions { pixel_um: Some(40.0), box_share: 0.2, ..FindOptions::default() };
        let frame = Finder::new(&camera).expect("drawn").find(&scan(255.0), &options).expect("memory");
        assert_eq!(frame.status, FrameStatus::Ok, "{frame:?}");
        for (mark, place) in frame.marks.iter().zip(&places) {
            assert!(distance(mark.centre.expect("seen"), *place) < 0.05, "{mark:?}");
        }
        assert!(frame.notes.iter().any(|n| n.contains("of 16 bits")), "{:?}", frame.notes);
    }
}
