//! Which pixels are paint: exactly, and at memory speed.
//!
//! The decision on an 8-bit colour depends on three bytes, so it is a table of 2²⁴ bits (2 MiB), computed once per
//! profile from the scalar reference [`PaintTest`] (`segment::table`). A row first goes through a vectorised test of
//! the accepted colours' bounds (see [`super::kernels`]), which drops nearly all pixels of an ordinary image, and what
//! is left is looked up. 16-bit samples are scaled to 8 bits by `(255·v + white/2) / white`, never by a tile's own
//! statistics, so that the answer does not depend on the tiling.

use std::sync::Arc;

use super::reference::PaintTest;
use super::table::ColourTable;
use crate::profile::Profile;
use crate::segment::kernels::Prefilter;
use autoref_raster::error::{Error, Result};
use autoref_raster::mask::Mask;
use autoref_raster::{Piece, PixelRow, SampleType, Samples};

/// The colours that a profile takes for paint, each decided once: what takes time about a [`Classifier`], and does not
/// depend on the image. Cheap to clone.
#[derive(Clone)]
pub struct PaintColours {
    table: Arc<ColourTable>,
    test: Arc<PaintTest>,
}

impl PaintColours {
    /// # Errors
    /// [`Error::Usage`] when the profile is not valid or not one of paint.
    pub fn of(profile: &Profile) -> Result<PaintColours> {
        let test = PaintTest::new(profile)?;
        Ok(PaintColours { table: Arc::new(ColourTable::new(&test)), test: Arc::new(test) })
    }
}

/// Decides for every pixel of a row whether it is paint. Cheap to clone; shared by all workers.
#[derive(Clone)]
pub struct Classifier {
    table: Arc<ColourTable>,
    /// The table's bounds for pixels as the file has them, and for red, green, blue.
    of_samples: Arc<Prefilter>,
    of_colours: Arc<Prefilter>,
    test: Arc<PaintTest>,
    sample: SampleType,
    white: u16,
    rgb: [usize; 3],
    alpha: Option<usize>,
    /// As an integer sample; `None` when no sample can equal it.
    nodata: Option<u16>,
    /// Paint has at least so much red, green and blue.
    least: [u8; 3],
}

impl Classifier {
    /// `rgb` and `alpha` are sample indices in a pixel (one grey band three times is fine); `white` is the sample value
    /// of full white; a pixel whose colour samples all equal `nodata`, or whose alpha is 0, is background.
    ///
    /// # Errors
    /// [`Error::Usage`] when the profile is not valid or `white` is 0.
    pub fn new(
        profile: &Profile,
        sample: SampleType,
        white: u16,
        rgb: [usize; 3],
        alpha: Option<usize>,
        nodata: Option<f64>,
    ) -> Result<Classifier> {
        Classifier::of(PaintColours::of(profile)?, sample, white, rgb, alpha, nodata)
    }

    /// The same of colours that are decided already.
    ///
    /// # Errors
    /// [`Error::Usage`] when `white` is 0.
    pub fn of(
        PaintColours { table, test }: PaintColours,
        sample: SampleType,
        white: u16,
        rgb: [usize; 3],
        alpha: Option<usize>,
        nodata: Option<f64>,
    ) -> Result<Classifier> {
        if white == 0 {
            return Err(Error::usage("the value of white is 0", "give the largest sample value with --white"));
        }
        let nodata = nodata.filter(|v| v.fract() == 0.0 && (0.0..=65_535.0).contains(v)).map(|v| v as u16);
        let [of_samples, of_colours] = [rgb, [0, 1, 2]].map(|rgb| Arc::new(Prefilter::new(rgb, table.bounds)));
        Ok(Classifier { table, of_samples, of_colours, test, sample, white, rgb, alpha, nodata, least: [0; 3] })
    }

    /// The same for paint that has at least so much red, green and blue, 0..=255.
    pub fn at_least(&self, least: [u8; 3]) -> Classifier {
        Classifier { least, ..self.clone() }
    }

    /// The scalar reference behind the table, which knows no least.
    pub fn reference(&self) -> &PaintTest {
        &self.test
    }

    /// The table's answer for an 8-bit colour. The bounds spare most colours the table, which is larger than the
    /// nearest caches.
    pub fn is_paint(&self, colour: [u8; 3]) -> bool {
        self.table.bounds.passes(colour) && self.accepts(colour)
    }

    fn accepts(&self, colour: [u8; 3]) -> bool {
        let [r, g, b] = self.least;
        colour[0] >= r && colour[1] >= g && colour[2] >= b && self.table.get(colour)
    }

    /// Which of a window's pixels are paint: `colours` red, green, blue as the file has them, `valid` where there is
    /// any.
    ///
    /// # Panics
    /// When the two are not of one length.
    pub fn paint_of(&self, colours: &[[u16; 3]], valid: &[bool]) -> Vec<bool> {
        assert_eq!(colours.len(), valid.len());
        let bits = self.paint_bits(colours);
        valid.iter().enumerate().map(|(i, &valid)| valid && bits[i / 64] >> (i % 64) & 1 == 1).collect()
    }

    /// Which of these colours, as the file has them, are paint: a bit each, lowest first.
    pub fn paint_bits(&self, colours: &[[u16; 3]]) -> Vec<u64> {
        let samples = colours.as_flattened().iter();
        // Apart, so that bytes are taken many at a time.
        let bytes: Vec<u8> = match self.white {
            255 => samples.map(|&v| v.min(255) as u8).collect(),
            _ => samples.map(|&v| self.to_byte(v)).collect(),
        };
        let mut bits = vec![0u64; colours.len().div_ceil(64)];
        self.of_colours.row(&bytes, 3, colours.len(), &mut bits);
        keep(&mut bits, |i| self.accepts([bytes[3 * i], bytes[3 * i + 1], bytes[3 * i + 2]]));
        bits
    }

    /// A sample on the 8-bit scale: `(255·v + white/2) / white`, at most 255; bytes with white 255 are themselves.
    pub fn to_byte(&self, sample: u16) -> u8 {
        scale(sample, self.white)
    }

    /// One bit a pixel: is it paint? `bits` has `ceil(row.len / 64)` words; all are overwritten, unused high bits are
    /// zero.
    ///
    /// # Panics
    /// When `bits` or the row's samples are too short.
    pub fn classify_row(&self, row: PixelRow<'_>, bits: &mut [u64]) {
        let words = row.len.div_ceil(64);
        let bits = &mut bits[..words];
        match row.samples {
            Samples::U8(samples) if self.white == 255 && self.sample == SampleType::U8 => {
                self.of_samples.row(samples, row.pixel_stride, row.len, bits);
                // Without a detour over wider samples: of ground in the paint's colours every pixel comes here.
                let [r, g, b] = self.rgb;
                let colour = |i: usize| {
                    let pixel = &samples[i * row.pixel_stride..];
                    [pixel[r], pixel[g], pixel[b]]
                };
                let nodata = self.nodata.and_then(|v| u8::try_from(v).ok());
                match (self.alpha, nodata) {
                    (None, None) if self.least == [0; 3] => keep(bits, |i| self.table.get(colour(i))),
                    (alpha, nodata) => keep(bits, |i| {
                        let transparent = alpha.is_some_and(|a| samples[i * row.pixel_stride + a] == 0);
                        let colour = colour(i);
                        !transparent && nodata.is_none_or(|n| colour != [n; 3]) && self.accepts(colour)
                    }),
                }
            }
            Samples::U8(samples) => self.classify_wide(row.len, bits, |i| {
                let pixel = &samples[i * row.pixel_stride..];
                (self.rgb.map(|b| u16::from(pixel[b])), self.alpha.map(|a| u16::from(pixel[a])))
            }),
            Samples::U16(samples) => self.classify_wide(row.len, bits, |i| {
                let pixel = &samples[i * row.pixel_stride..];
                (self.rgb.map(|b| pixel[b]), self.alpha.map(|a| pixel[a]))
            }),
        }
    }

    /// Of a row whose paint is known, `bits` as [`Classifier::classify_row`] of a classifier without a least gives
    /// them, what has the least.
    pub fn narrow_row(&self, row: PixelRow<'_>, bits: &mut [u64]) {
        let bright = |colour: [u16; 3]| (0..3).all(|c| self.to_byte(colour[c]) >= self.least[c]);
        match row.samples {
            Samples::U8(samples) => {
                keep(bits, |i| bright(self.rgb.map(|b| u16::from(samples[i * row.pixel_stride + b]))));
            }
            Samples::U16(samples) => keep(bits, |i| bright(self.rgb.map(|b| samples[i * row.pixel_stride + b]))),
        }
    }

    fn classify_wide(&self, len: usize, bits: &mut [u64], pixel: impl Fn(usize) -> ([u16; 3], Option<u16>)) {
        for (word, first) in bits.iter_mut().zip((0..len).step_by(64)) {
            *word = 0;
            for i in first..(first + 64).min(len) {
                let (colour, _) = pixel(i);
                *word |= u64::from(self.table.bounds.passes(colour.map(|v| self.to_byte(v)))) << (i - first);
            }
        }
        self.refine(bits, pixel);
    }

    /// Keeps the set bits whose pixel is paint by the table and holds something.
    fn refine(&self, bits: &mut [u64], pixel: impl Fn(usize) -> ([u16; 3], Option<u16>)) {
        keep(bits, |i| {
            let (colour, alpha) = pixel(i);
            let holds_nothing = alpha == Some(0) || self.nodata.is_some_and(|n| colour == [n; 3]);
            !holds_nothing && self.accepts(colour.map(|v| self.to_byte(v)))
        });
    }
}

/// Clears the set bits of pixels that are not `wanted`.
fn keep(bits: &mut [u64], wanted: impl Fn(usize) -> bool) {
    for (w, word) in bits.iter_mut().enumerate() {
        let mut left = std::mem::take(word);
        while left != 0 {
            let bit = left.trailing_zeros();
            left &= left - 1;
            *word |= u64::from(wanted(w * 64 + bit as usize)) << bit;
        }
    }
}

fn scale(sample: u16, white: u16) -> u8 {
    if white == 255 {
        return sample.min(255) as u8;
    }
    ((255 * u32::from(sample) + u32::from(white) / 2) / u32::from(white)).min(255) as u8
}

/// Piece → Mask, by the colour of each pixel.
pub(crate) fn classify_piece(classifier: &Classifier, piece: &Piece, mask: &mut Mask) {
    if piece.empty {
        return;
    }
    let (x, width) = (piece.window.x, piece.window.width);
    let mut bits = vec![0u64; (width as usize).div_ceil(64)];
    for y in piece.window.y..piece.window.bottom() {
        classifier.classify_row(piece.row(x, y, width), &mut bits);
        mask.put_bits(x, y, width, &bits);
    }
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    fn classifier(profile: &str) -> Classifier {
        let profile = Profile::builtin(profile).expect("shipped");
        Classifier::new(&profile, SampleType::U8, 255, [0, 1, 2], None, None).expect("valid")
    }

    /// Every one of the 2²⁴ colours, through the whole row path, equals the scalar reference; a fifth of the reds, the
    /// least and the most among them, without `AUTOREF_LARGE=1`.
    #[test]
    fn all_colours_equal_the_scalar_reference() {
        let reds: Vec<u8> =
            (0..=255u8).step_by(if std::env::var_os("AUTOREF_LARGE").is_some() { 1 } else { 5 }).collect();
        for name in ["orange", "autoref-2016", "white-on-dark"] {
            let classifier = classifier(name);
            let wrong: u64 = reds
                .par_iter()
                .map(|&r| {
                    let row: Vec<u8> = (0..=0xffffu32).flat_map(|gb| [r, (gb >> 8) as u8, gb as u8]).collect();
                    let mut bits = vec![0u64; 65_536 / 64];
                    let pixels = PixelRow { samples: Samples::U8(&row), pixel_stride: 3, len: 65_536 };
                    classifier.classify_row(pixels, &mut bits);
                    (0..65_536usize)
                        .filter(|i| {
                            let fast = bits[i / 64] >> (i % 64) & 1 == 1;
                            fast != classifier.reference().is_paint([r, (i >> 8) as u8, *i as u8])
                        })
                        .count() as u64
                })
                .sum();
            assert_eq!(wrong, 0, "{name}");
        }
    }

    #[test]
    fn orange_is_paint_and_concrete_is_not() {
        let orange = classifier("orange");
        for colour in [[255, 110, 20], [255, 103, 0], [255, 121, 0], [200, 90, 40], [120, 50, 15]] {
            assert!(orange.is_paint(colour), "{colour:?}");
        }
        for grey in (0..=255u8).map(|v| [v; 3]) {
            assert!(!orange.is_paint(grey), "{grey:?}");
        }
        for colour in [[180, 130, 90], [90, 120, 60], [170, 30, 110], [160, 150, 130], [255, 230, 0]] {
            assert!(!orange.is_paint(colour), "{colour:?}");
        }
    }

    #[test]
    fn sixteen_bits_follow_the_fixed_rule() {
        let profile = Profile::builtin("orange").expect("shipped");
        let narrow = classifier("orange");
        for white in [65_535u16, 4095, 1023] {
            let wide = Classifier::new(&profile, SampleType::U16, white, [2, 1, 0], Some(3), Some(7.0)).expect("valid");
            let bytes: Vec<[u8; 3]> =
                (0..300u32).map(|i| [(i * 7) as u8, (i * 3 / 2) as u8, (i * 5 / 3) as u8]).collect();
            let mut row: Vec<u16> = bytes
                .iter()
                .flat_map(|c| {
                    let up = |v: u8| ((u32::from(v) * u32::from(white) + 127) / 255) as u16;
                    [up(c[2]), up(c[1]), up(c[0]), 1]
                })
                .collect();
            row[3] = 0;
            let mut bits = vec![u64::MAX; 5];
            let pixels = PixelRow { samples: Samples::U16(&row), pixel_stride: 4, len: 300 };
            wide.classify_row(pixels, &mut bits);
            for (i, c) in bytes.iter().enumerate() {
                let got = bits[i / 64] >> (i % 64) & 1 == 1;
                assert_eq!(got, i != 0 && narrow.is_paint(*c), "{c:?} at white {white}");
            }
            assert_eq!(bits[4] >> 44, 0);
        }
    }

    #[test]
    fn nothing_is_background() {
        let profile = Profile::builtin("white-on-dark").expect("shipped");
        let classifier =
            Classifier::new(&profile, SampleType::U8, 255, [0; 3], None, Some(255.0)).expect("one grey band");
        let row = [255u8, 250, 10, 250];
        let mut bits = [0u64];
        classifier.classify_row(PixelRow { samples: Samples::U8(&row), pixel_stride: 1, len: 4 }, &mut bits);
        assert_eq!(bits[0], 0b1010);
        assert!(Classifier::new(&profile, SampleType::U8, 0, [0; 3], None, None).is_err());
    }
}
