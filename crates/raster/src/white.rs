//! The value of full white, by the file's or the caller's word.

use std::sync::Arc;

use super::described::Described;
use super::{RasterSource, SampleType};
use crate::error::{Error, Result};

/// The value of full white: all bits that NBITS (or BitsPerSample) names; else, of 16-bit samples, MaxSampleValue when
/// it is one less than a power of two above 8 bits, as for 12-bit cameras (any other value is a statistic of the image,
/// which the TIFF specification forbids to use for display).
pub(crate) fn white_of(sample: SampleType, bits: Option<u32>, max_sample_value: Option<u64>) -> u16 {
    let width = 8 * sample.bytes() as u32;
    if let Some(bits) = bits.filter(|bits| (1..width).contains(bits)) {
        return ((1u32 << bits) - 1) as u16;
    }
    match (sample, max_sample_value) {
        (SampleType::U8, _) => 255,
        (SampleType::U16, Some(max)) if (512..65_535).contains(&(max + 1)) && (max + 1).is_power_of_two() => max as u16,
        (SampleType::U16, _) => 65_535,
    }
}

/// The same pixels with another value of full white; `None` leaves what the file says. Samples are never changed:
/// everything that scales them does so by [`crate::RasterInfo::white`].
///
/// # Errors
/// [`Error::Usage`] when no sample of the image can reach that value, or it is 0.
pub fn with_white(source: Arc<dyn RasterSource>, white: Option<u16>) -> Result<Arc<dyn RasterSource>> {
    let Some(white) = white else { return Ok(source) };
    let largest = match source.info().sample {
        SampleType::U8 => 255,
        SampleType::U16 => u16::MAX,
    };
    if white == 0 || white > largest {
        return Err(Error::usage(
            format!("{}: --white {white}, but its samples go from 0 to {largest}", source.info().path.display()),
            format!("give a value from 1 to {largest}"),
        ));
    }
    let mut info = source.info().clone();
    info.white = white;
    Ok(Arc::new(Described::new(source, info)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_follows_the_bits() {
        assert_eq!(white_of(SampleType::U8, None, Some(100)), 255);
        assert_eq!(white_of(SampleType::U8, Some(1), None), 1);
        assert_eq!(white_of(SampleType::U16, Some(12), None), 4095);
        assert_eq!(white_of(SampleType::U16, None, Some(2047)), 2047);
        assert_eq!(white_of(SampleType::U16, None, Some(3000)), 65_535);
        assert_eq!(white_of(SampleType::U16, None, Some(65_535)), 65_535);
        assert_eq!(white_of(SampleType::U16, Some(16), None), 65_535);
    }
}
