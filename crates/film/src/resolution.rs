//! What a scan's file says of its resolution: a prior for the size of a pixel, never the truth, since programs that
//! save pictures often write a resolution of their own.

use std::io::Read;
use std::path::Path;

use super::interior::Stretch;

/// Resolutions that programs write without knowing, pixels per inch.
const WRITTEN_UNKNOWN: [f64; 6] = [72.0, 96.0, 100.0, 150.0, 200.0, 300.0];
const INCH_UM: f64 = 25_400.0;

/// Pixels per inch along x and y as a file states them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resolution(pub [f64; 2]);

impl Resolution {
    /// Of a TIFF (`XResolution`, `YResolution`, `ResolutionUnit`), of a JPEG (JFIF density, or EXIF) or of a PNG
    /// (`pHYs`); `None` where the file states none, or no unit.
    pub fn of_file(path: &Path) -> Option<Resolution> {
        let mut head = vec![0u8; 4096];
        let n = std::fs::File::open(path).ok()?.read(&mut head).ok()?;
        head.truncate(n);
        let found = match head.get(..4)? {
            [0xff, 0xd8, ..] => jfif(&head).or_else(|| tagged(path, "EXIF_")),
            [0x89, b'P', b'N', b'G'] => png(&head),
            [b'I', b'I', ..] | [b'M', b'M', ..] => tagged(path, "TIFFTAG_"),
            _ => None,
        };
        found.filter(|r| r.0.iter().all(|v| v.is_finite() && *v > 1.0))
    }

    /// Size of a pixel, micrometres: the geometric mean of the axes.
    pub fn pixel_um(self) -> f64 {
        INCH_UM / (self.0[0] * self.0[1]).sqrt()
    }

    /// How far the axes differ in scale.
    pub(super) fn stretch(self) -> Stretch {
        Stretch((self.0[0] / self.0[1]).ln())
    }

    /// Whether programs write this without knowing.
    pub fn is_usual_default(self) -> bool {
        WRITTEN_UNKNOWN.iter().any(|d| self.0.iter().all(|v| (v - d).abs() < 0.02))
    }
}

/// Axes and unit by GDAL's names for them: 2 inches, 3 centimetres.
fn tagged(path: &Path, prefix: &str) -> Option<Resolution> {
    use gdal::Metadata;
    autoref_raster::initialise_gdal(64 << 20);
    let dataset = gdal::Dataset::open(path).ok()?;
    // EXIF writes "(300)" and "2", TIFF "300" and "2 (pixels/inch)".
    let number = |name: &str| {
        let text = dataset.metadata_item(&format!("{prefix}{name}"), "")?;
        text.trim_start_matches('(').split([' ', ')']).next()?.parse::<f64>().ok()
    };
    let unit = if prefix == "TIFFTAG_" { number("RESOLUTIONUNIT") } else { number("ResolutionUnit") }?;
    let names = if prefix == "TIFFTAG_" { ["XRESOLUTION", "YRESOLUTION"] } else { ["XResolution", "YResolution"] };
    let per_inch = match unit as i64 {
        2 => 1.0,
        3 => 2.54,
        _ => return None,
    };
    Some(Resolution([number(names[0])? * per_inch, number(names[1])? * per_inch]))
}

/// The density of a JFIF header, which follows the start of image.
fn jfif(head: &[u8]) -> Option<Resolution> {
    let at = head.windows(5).take(64).position(|w| w == b"JFIF\0")?;
    let [unit, x1, x0, y1, y0] = *head.get(at + 7..at + 12)?.first_chunk::<5>()?;
    let per_inch = match unit {
        1 => 1.0,
        2 => 2.54,
        _ => return None,
    };
    Some(Resolution([[x1, x0], [y1, y0]].map(|v| f64::from(u16::from_be_bytes(v)) * per_inch)))
}

/// Pixels per metre of a PNG.
fn png(head: &[u8]) -> Option<Resolution> {
    let at = head.windows(4).position(|w| w == b"pHYs")?;
    let part = head.get(at + 4..at + 13)?;
    let number = |k: usize| part.get(k..k + 4)?.first_chunk::<4>().map(|b| f64::from(u32::from_be_bytes(*b)));
    (part[8] == 1).then_some(())?;
    Some(Resolution([number(0)? * 0.0254, number(4)? * 0.0254]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn densities_of_jpeg_and_png_are_read() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let write = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).expect("written");
            path
        };
        // A JFIF header of 500 pixels per centimetre along x and 480 along y.
        let jpeg = [0xff, 0xd8, 0xff, 0xe0, 0, 16, b'J', b'F', b'I', b'F', 0, 1, 1, 2, 1, 0xf4, 1, 0xe0, 0, 0];
        let found = Resolution::of_file(&write("a.jpg", &jpeg)).expect("stated");
        assert!((found.0[0] - 1270.0).abs() < 1e-9 && (found.0[1] - 1219.2).abs() < 1e-9, "{found:?}");
        let mut png = vec![0x89, b'P', b'N', b'G', 13, 10, 26, 10, 0, 0, 0, 9];
        png.extend(b"pHYs");
        png.extend(50_000u32.to_be_bytes());
        png.extend(50_000u32.to_be_bytes());
        png.push(1);
        let found = Resolution::of_file(&write("a.png", &png)).expect("stated");
        assert!((found.pixel_um() - 20.0).abs() < 1e-9, "{found:?}");
        assert_eq!(Resolution::of_file(&write("a.tif", b"II*\0")), None, "no TIFF");
        assert!(Resolution([72.0, 72.0]).is_usual_default() && !Resolution([1200.0, 1180.0]).is_usual_default());
    }
}
