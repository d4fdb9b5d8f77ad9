//! What a warped copy has where no image is.

use std::str::FromStr;

/// What is where no image is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Border {
    /// Nodata when the image has a nodata value or is an elevation model (samples that can be negative or fractional),
    /// else alpha.
    #[default]
    Auto,
    /// One more band that says how much of a pixel is covered.
    Alpha,
    /// This value in every band.
    Nodata(f64),
}

impl Border {
    /// Of elevation models that name none.
    pub(super) const ELEVATION_NODATA: f64 = -9999.0;
}

impl FromStr for Border {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "auto" => Ok(Border::Auto),
            "alpha" => Ok(Border::Alpha),
            number => number
                .parse()
                .map(Border::Nodata)
                .map_err(|_| format!("`{text}` is no border: write alpha, auto, or the nodata value")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_nodata_and_other_words_are_none() {
        assert_eq!("-32767".parse(), Ok(Border::Nodata(-32767.0)));
        assert!("alfa".parse::<Border>().is_err());
    }
}
