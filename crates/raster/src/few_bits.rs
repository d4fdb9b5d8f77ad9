//! Samples of a few bits in many: 12 bits of a camera in 16 of a file.

use std::fmt;

use crate::Patch;

/// The brightest sample is at most a quarter of what counts as full white.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FewBits {
    pub brightest: u16,
    pub white: u16,
}

impl FewBits {
    /// `None` where more of the range is used.
    pub fn of(brightest: u16, white: u16) -> Option<Self> {
        (u64::from(brightest) * 4 <= u64::from(white) + 3).then_some(FewBits { brightest, white })
    }

    /// Of the pixels of a patch that hold something; `None` also where no other value of white would do.
    pub fn of_patch(patch: &Patch) -> Option<Self> {
        let valid = patch.rgb.iter().zip(&patch.valid).filter(|(_, valid)| **valid);
        let brightest = valid.flat_map(|(rgb, _)| rgb).copied().max()?;
        FewBits::of(brightest, patch.white).filter(|few| few.better_white() < few.white)
    }

    /// The white to try instead.
    pub fn better_white(self) -> u16 {
        [255, 1023, 4095, 16_383].into_iter().find(|white| *white >= self.brightest).unwrap_or(u16::MAX)
    }
}

impl fmt::Display for FewBits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let FewBits { brightest, white } = self;
        write!(
            f,
            "the brightest pixel looked at is {brightest} of {white}: if fewer bits are used than the file has, give --white {}",
            self.better_white()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::FewBits;
    use crate::Patch;
    use crate::window::Window;

    #[test]
    fn twelve_bits_in_sixteen_are_few_and_a_dark_window_of_eight_is_dark() {
        let of = |value: u16, white: u16| {
            let window = Window::whole(2, 1);
            let rgb = vec![[value, 1, 2], [white; 3]];
            FewBits::of_patch(&Patch { window, rgb, valid: vec![true, false], white })
        };
        assert_eq!(of(4000, 65_535).map(FewBits::better_white), Some(4095));
        assert_eq!(of(2047, 65_535).map(FewBits::better_white), Some(4095));
        assert_eq!((of(40, 255), of(20_000, 65_535), of(4000, 4095)), (None, None, None));
    }
}
