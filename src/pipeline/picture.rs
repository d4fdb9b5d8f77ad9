//! What a picture says of itself when nothing was found in it: samples of a few bits in many, no colours, no pixels.

use autoref_raster::error::Result;
use autoref_raster::window::Window;
use autoref_raster::{FewBits, RasterSource, read_patch};

/// Windows looked at along each axis, and their side in pixels.
const WINDOWS: u64 = 6;
const SIDE_PX: u64 = 64;
/// A raster that is read from the top down is looked at only when reading it once more costs little.
pub(super) const MOST_SEQUENTIAL_PX: u64 = 100_000_000;
/// Fewer pixels than these say nothing.
const FEWEST_PIXELS: usize = 100;
/// Bare ground, roofs and dry grass are redder than blue. Above this share of coloured pixels that are bluer, by this
/// factor, the bands may stand in the order blue, green, red.
const BLUISH_SHARE: f64 = 0.8;
const BLUISH: f64 = 1.08;

/// Why paint may be invisible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unusual {
    Dark(FewBits),
    /// Red, green and blue are alike everywhere.
    Grey,
    /// Nearly everything is bluer than red.
    Bluish {
        share: f64,
    },
    /// Share of the pixels that hold nothing.
    Empty {
        share: f64,
    },
}

impl Unusual {
    /// What helps, for people who looked with `profile`; `None` where that does not mind.
    pub fn advice(&self, profile: &str) -> Option<String> {
        /// Found by their shape, in grey.
        const SHAPES: [&str; 3] = ["black-white-cross", "black-white-checker", "black-white-hourglass"];
        Some(match *self {
            Unusual::Dark(few) => few.to_string(),
            Unusual::Grey if SHAPES.contains(&profile) => {
                let others: Vec<&str> = SHAPES.into_iter().filter(|shape| *shape != profile).collect();
                format!("where the targets are of another shape: --profile {}", others.join(" or "))
            }
            Unusual::Grey => format!(
                "the picture is grey, and paint is told by its colour: take the picture in colour, or look for targets of \
                 black and white by their shape (--profile {})",
                SHAPES.join(" or ")
            ),
            Unusual::Bluish { share } => format!(
                "{:.0} % of the pixels looked at are bluer than red: if the bands stand in the order blue, green, red, bring them \
                 in order (gdal_translate -b 3 -b 2 -b 1)",
                100.0 * share
            ),
            Unusual::Empty { share } => {
                format!("{:.0} % of the pixels looked at hold nothing (nodata, transparent)", 100.0 * share)
            }
        })
    }
}

/// Looks at windows spread over the picture. Empty when nothing is unusual.
///
/// # Errors
/// When a window cannot be read.
pub fn unusual(source: &dyn RasterSource) -> Result<Vec<Unusual>> {
    let info = source.info();
    if info.sequential && info.width * info.height > MOST_SEQUENTIAL_PX {
        return Ok(Vec::new());
    }
    let (mut pixels, mut valid, mut brightest, mut white) = (0usize, 0usize, 0u16, info.white);
    let (mut coloured, mut bluish) = (0usize, 0usize);
    // Row by row: what is read from the top down is passed once.
    for row in 0..WINDOWS {
        for column in 0..WINDOWS {
            let at = |length: u64, n: u64| length.saturating_sub(SIDE_PX) * n / (WINDOWS - 1);
            let window = Window::new(at(info.width, column), at(info.height, row), SIDE_PX, SIDE_PX);
            let patch = read_patch(source, window.intersect(&info.bounds()))?;
            white = patch.white;
            pixels += patch.rgb.len();
            for (rgb, _) in patch.rgb.iter().zip(&patch.valid).filter(|(_, valid)| **valid) {
                valid += 1;
                brightest = brightest.max(rgb[0]).max(rgb[1]).max(rgb[2]);
                coloured += usize::from(rgb[0] != rgb[1] || rgb[1] != rgb[2]);
                bluish += usize::from(f64::from(rgb[2]) > BLUISH * f64::from(rgb[0]));
            }
        }
    }
    let mut found = Vec::new();
    let empty = 1.0 - valid as f64 / pixels.max(1) as f64;
    if empty > 0.9 {
        found.push(Unusual::Empty { share: empty });
    }
    if valid >= FEWEST_PIXELS {
        found.extend(FewBits::of(brightest, white).map(Unusual::Dark));
        if coloured == 0 {
            found.push(Unusual::Grey);
        }
        let share = bluish as f64 / coloured.max(1) as f64;
        if coloured >= FEWEST_PIXELS && share > BLUISH_SHARE {
            found.push(Unusual::Bluish { share });
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::memory::MemorySource;

    fn of(pixel: impl Fn(usize) -> [u8; 3]) -> Vec<Unusual> {
        let rgb = (0..300 * 200).flat_map(pixel).collect();
        unusual(&MemorySource::rgb8(300, 200, rgb)).expect("in memory")
    }

    #[test]
    fn an_ordinary_picture_is_not_unusual() {
        assert_eq!(of(|i| [(i % 251) as u8, (i % 83) as u8, 120]), []);
    }

    #[test]
    fn grey_and_dark_pictures_are_named_with_what_helps() {
        assert_eq!(of(|i| [(i % 251) as u8; 3]), [Unusual::Grey]);
        let dark = of(|i| [(i % 16) as u8, 3, 5]);
        assert_eq!(dark, [Unusual::Dark(FewBits { brightest: 15, white: 255 })]);
        let bgr = of(|i| [60 + (i % 40) as u8, 90, 140 + (i % 30) as u8]);
        assert!(matches!(bgr[..], [Unusual::Bluish { share }] if share == 1.0), "{bgr:?}");
        assert_eq!(of(|i| [140 + (i % 30) as u8, 90, 60 + (i % 40) as u8]), []);
        let twelve_bits = Unusual::Dark(FewBits { brightest: 4080, white: 65_535 });
        let said = twelve_bits.advice("orange").expect("it helps");
        assert!(said.ends_with("--white 4095"), "{said}");
    }

    /// A grey picture that was searched for checkers was sent to the checkers.
    #[test]
    fn nobody_is_sent_to_the_shape_that_was_looked_for() {
        let said = |profile: &str| Unusual::Grey.advice(profile).expect("another shape");
        assert!(said("orange").contains("black-white-checker") && said("orange").contains("in colour"));
        let (checker, cross) = (said("black-white-checker"), said("black-white-cross"));
        assert!(!checker.contains("checker") && checker.contains("black-white-cross"), "{checker}");
        assert!(!cross.contains("black-white-cross") && cross.contains("black-white-checker"), "{cross}");
    }
}
