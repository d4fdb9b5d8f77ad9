//! Pictures as text that a page can hold.

use crate::report::overview::Rgb8;
use autoref_raster::error::{Error, Result};

/// A `data:` URI with the picture as JPEG, colours at full resolution where `fine` is set: small bright marks would lose
/// their colour otherwise.
///
/// # Errors
/// [`Error::Usage`] when the picture has no pixels or more than 65,535 a side, which pictures of this room have not.
pub fn data_uri(picture: &Rgb8, quality: u8, fine: bool) -> Result<String> {
    let failed = |e: jpeg_encoder::EncodingError| {
        Error::usage(format!("a picture of the report cannot be made: {e}"), "run with --no-report")
    };
    let mut jpeg = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut jpeg, quality);
    let sampling = if fine { jpeg_encoder::SamplingFactor::F_1_1 } else { jpeg_encoder::SamplingFactor::F_2_2 };
    encoder.set_sampling_factor(sampling);
    encoder
        .encode(&picture.rgb, picture.width as u16, picture.height as u16, jpeg_encoder::ColorType::Rgb)
        .map_err(failed)?;
    Ok(format!("data:image/jpeg;base64,{}", base64(&jpeg)))
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let all = group.iter().fold(0u32, |all, byte| all << 8 | u32::from(*byte)) << (8 * (3 - group.len()));
        for i in 0..4 {
            let digit = DIGITS[(all >> (18 - 6 * i) & 63) as usize];
            out.push(if i <= group.len() { char::from(digit) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_as_the_rfc_has_it() {
        let vectors = ["", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"];
        for (length, expected) in vectors.iter().enumerate() {
            assert_eq!(base64(&b"foobar"[..length]), *expected);
        }
    }
}
