//! What JPEG does to a picture, for benchmarks on pieces of a scene.

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

use autoref_raster::error::{Error, Result};

/// How many samples of colour differences a JPEG keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chroma {
    /// One a pixel (4:4:4).
    Full,
    /// One for four pixels (4:2:0, as cameras and GDAL's YCbCr do).
    Halved,
}

/// Encodes an RGB picture (8 bits, row-major, `3 · width · height` bytes) as baseline JPEG and decodes it again.
///
/// The 8×8 blocks are aligned with the picture's corner, so pieces of one scene get other artefacts than the whole
/// would; for statistics over many marks that is as good.
///
/// # Errors
/// [`Error::Usage`] when the size does not fit the bytes, a side is 0 or above 65535, or the quality is not 1 to 100.
pub fn jpeg_round_trip(rgb: &[u8], width: u64, height: u64, quality: u8, chroma: Chroma) -> Result<Vec<u8>> {
    let refuse = |what: String| Error::usage(what, "JPEG takes 1 to 65535 pixels a side and qualities 1 to 100");
    let side = |n: u64| u16::try_from(n).ok().filter(|&n| n > 0);
    let (Some(w), Some(h)) = (side(width), side(height)) else {
        return Err(refuse(format!("a JPEG of {width} x {height} pixels")));
    };
    if rgb.len() as u64 != width * height * 3 || !(1..=100).contains(&quality) {
        return Err(refuse(format!("{} bytes for {width} x {height} RGB pixels at quality {quality}", rgb.len())));
    }
    let mut bytes = vec![];
    let mut encoder = Encoder::new(&mut bytes, quality);
    encoder.set_sampling_factor(match chroma {
        Chroma::Full => SamplingFactor::F_1_1,
        Chroma::Halved => SamplingFactor::F_2_2,
    });
    encoder.encode(rgb, w, h, ColorType::Rgb).map_err(|e| refuse(e.to_string()))?;
    // Three components decode to RGB unless told otherwise.
    let mut decoder = zune_jpeg::JpegDecoder::new(zune_jpeg::zune_core::bytestream::ZCursor::new(&bytes));
    decoder.decode().map_err(|e| Error::format("JPEG in memory", "scan", e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn better_quality_is_nearer_and_colours_keep_their_order() {
        let (w, h) = (37, 29);
        let rgb: Vec<u8> = (0..w * h).flat_map(|i| [200, 90 + (i % w) as u8, 30 + (i / w) as u8]).collect();
        let error = |quality| {
            let back = jpeg_round_trip(&rgb, w, h, quality, Chroma::Halved).expect("a round trip");
            assert_eq!(back.len(), rgb.len());
            let full = jpeg_round_trip(&rgb, w, h, quality, Chroma::Full).expect("a round trip");
            assert_ne!(back, full);
            back.iter().zip(&rgb).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / rgb.len() as f64
        };
        let (rough, fine) = (error(30), error(95));
        assert!(fine < rough && fine < 2.0 && rough < 12.0, "{fine} {rough}");
    }

    #[test]
    fn impossible_pictures_are_refused() {
        for (bytes, w, h, quality) in [(0, 0, 5, 90), (3, 1, 1, 0), (3, 1, 1, 101), (5, 1, 1, 90), (3, 70_000, 1, 90)] {
            assert!(jpeg_round_trip(&vec![0; bytes], w, h, quality, Chroma::Full).is_err());
        }
    }
}
