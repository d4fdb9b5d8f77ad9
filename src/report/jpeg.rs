//! Pictures as text that a page can hold.

use base64::prelude::{BASE64_STANDARD as BASE64, Engine as _};

use crate::report::overview::Rgb8;
use autoref_raster::error::{Error, Result};

/// How finely the colours of a picture are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colours {
    /// At full resolution: small bright marks would lose their colour otherwise.
    Full,
    /// At half of it.
    Half,
}

/// A `data:` URI with the picture as JPEG.
///
/// # Errors
/// [`Error::Usage`] when the picture has no pixels or more than 65,535 a side, which pictures of this room have not.
pub fn data_uri(picture: &Rgb8, quality: u8, colours: Colours) -> Result<String> {
    let failed = |e: jpeg_encoder::EncodingError| {
        Error::usage(format!("a picture of the report cannot be made: {e}"), "run with --no-report")
    };
    let mut jpeg = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut jpeg, quality);
    let sampling = match colours {
        Colours::Full => jpeg_encoder::SamplingFactor::F_1_1,
        Colours::Half => jpeg_encoder::SamplingFactor::F_2_2,
    };
    encoder.set_sampling_factor(sampling);
    encoder
        .encode(&picture.rgb, picture.width as u16, picture.height as u16, jpeg_encoder::ColorType::Rgb)
        .map_err(failed)?;
    Ok(format!("data:image/jpeg;base64,{}", BASE64.encode(&jpeg)))
}
