//! Which pixels are paint: exactly, and at memory speed.
//!
//! The decision on an 8-bit colour depends on three bytes, so it is a table of 2²⁴ bits (2 MiB), computed once per profile
//! with the scalar reference [`PaintTest`], and only where an interval bound says that anything can be accepted. A row first
//! goes through a vectorised test of the accepted colours' bounds (see [`super::kernels`]), which drops nearly all pixels of an
//! ordinary image, and what is left is looked up. 16-bit samples are scaled to 8 bits by `(255·v + white/2) / white`, never
//! by a tile's own statistics, so that the answer does not depend on the tiling.

use std::sync::Arc;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::profile::Profile;
use crate::profile::colour::{
    Cloud, LAB_F_NEAR, Space, lab_f, lab_f_near, lab_from_f, lab_from_srgb, linear_of_bytes, xyz_from_linear,
};
use crate::raster::{PixelRow, SampleType, Samples};
use crate::segment::kernels::{Bounds, Prefilter};

/// The scalar reference: is this colour paint, and how far is it from it?
#[derive(Clone, Debug)]
pub struct PaintTest {
    space: Space,
    limit2: f64,
    clouds: Vec<Cloud>,
    rough: Option<(Space, f64, Cloud)>,
    low: [u8; 3],
    high: [u8; 3],
}

impl PaintTest {
    /// # Errors
    /// [`Error::Usage`] when the profile is not valid.
    pub fn new(profile: &Profile) -> Result<PaintTest> {
        profile.validate()?;
        if profile.is_target() {
            return Err(Error::usage(
                format!("profile \"{}\" finds targets by shape: it has no colour", profile.name),
                "give a profile of paint",
            ));
        }
        let model = &profile.colour;
        let clouds = profile.clouds().map_err(|i| {
            Error::usage(format!("profile \"{}\": colour cloud {i} is singular", profile.name), "correct the profile")
        })?;
        let rough = model
            .rough
            .as_ref()
            .and_then(|r| Some((r.space, r.limit * r.limit, Cloud::new(r.mean, r.covariance, r.metric)?)));
        let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let (low, high) = model.rough_box.map_or(([0; 3], [255; 3]), |b| (b.low.map(byte), b.high.map(byte)));
        Ok(PaintTest { space: model.space, limit2: model.limit * model.limit, clouds, rough, low, high })
    }

    /// Squared distance, over the squared limit, of an 8-bit sRGB colour from the nearest cloud: paint is at most 1.
    /// Infinite where a rough test already says no.
    pub fn relative_distance2(&self, colour: [u8; 3]) -> f64 {
        if (0..3).any(|i| !(self.low[i]..=self.high[i]).contains(&colour[i])) {
            return f64::INFINITY;
        }
        let unit = colour.map(|v| f64::from(v) / 255.0);
        if let Some((space, limit2, cloud)) = &self.rough
            && cloud.distance2(&space.convert(unit)) > *limit2
        {
            return f64::INFINITY;
        }
        self.nearest2(unit) / self.limit2
    }

    /// Squared distance of an sRGB colour in 0..=1 from the nearest cloud, in the metric's own units.
    pub fn nearest2(&self, unit: [f64; 3]) -> f64 {
        let at = self.space.convert(unit);
        self.clouds.iter().map(|c| c.distance2(&at)).fold(f64::INFINITY, f64::min)
    }

    pub fn is_paint(&self, colour: [u8; 3]) -> bool {
        self.relative_distance2(colour) <= 1.0
    }

    /// What holds for every colour of the cube `low..=high`. A bound: [`Verdict::Mixed`] when in doubt.
    fn judge(&self, low: [u8; 3], high: [u8; 3]) -> Verdict {
        if (0..3).any(|i| high[i] < self.low[i] || low[i] > self.high[i]) {
            return Verdict::Ground;
        }
        let boxed = (0..3).all(|i| low[i] >= self.low[i] && high[i] <= self.high[i]);
        let rough = match &self.rough {
            None => Verdict::Paint,
            Some((space, limit2, cloud)) => {
                judge_clouds(std::slice::from_ref(cloud), *limit2, &Extent::new(*space, low, high))
            }
        };
        if rough == Verdict::Ground {
            return Verdict::Ground;
        }
        match judge_clouds(&self.clouds, self.limit2, &Extent::new(self.space, low, high)) {
            Verdict::Paint if boxed && rough == Verdict::Paint => Verdict::Paint,
            Verdict::Ground => Verdict::Ground,
            _ => Verdict::Mixed,
        }
    }
}

/// What is known of a cube of colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// All are.
    Paint,
    /// None is.
    Ground,
    Mixed,
}

/// A box, in the space that distances are taken in, around all colours of a cube.
struct Extent {
    middle: Vector3<f64>,
    half: Vector3<f64>,
}

impl Extent {
    fn new(space: Space, low: [u8; 3], high: [u8; 3]) -> Extent {
        let unit = |c: [u8; 3]| c.map(|v| f64::from(v) / 255.0);
        let (lo, hi) = match space {
            Space::Rgb => (unit(low), unit(high)),
            Space::Lab => {
                // XYZ rises with each of R, G, B, and L*a*b*'s compressive function rises: corners bound it.
                let linear = linear_of_bytes();
                let f = |[r, g, b]: [u8; 3]| {
                    let [x, y, z] =
                        xyz_from_linear([linear[usize::from(r)], linear[usize::from(g)], linear[usize::from(b)]]);
                    [lab_f_near(x), lab_f_near(y), lab_f_near(z)]
                };
                let f0 = f(low);
                let f1 = if low == high { f0 } else { f(high) };
                let (f0, f1) = (f0.map(|v| v * (1.0 - LAB_F_NEAR)), f1.map(|v| v * (1.0 + LAB_F_NEAR)));
                (
                    [116.0 * f0[1] - 16.0, 500.0 * (f0[0] - f1[1]), 200.0 * (f0[1] - f1[2])],
                    [116.0 * f1[1] - 16.0, 500.0 * (f1[0] - f0[1]), 200.0 * (f1[1] - f0[2])],
                )
            }
        };
        let (lo, hi) = (Vector3::from(lo), Vector3::from(hi));
        // A hair of slack covers rounding.
        Extent { middle: (lo + hi) / 2.0, half: ((hi - lo) / 2.0).add_scalar(1e-9) }
    }
}

/// The distance from a cloud is a norm, so inside the box it differs from that of the middle by at most the norm of the half
/// diagonal, for which the absolute weights give an upper bound.
fn judge_clouds(clouds: &[Cloud], limit2: f64, extent: &Extent) -> Verdict {
    const SLACK: f64 = 1e-6;
    let limit = limit2.sqrt();
    let mut verdict = Verdict::Ground;
    for cloud in clouds {
        let at_middle = cloud.distance2(&extent.middle).max(0.0).sqrt();
        let reach = extent.half.dot(&(cloud.weight.abs() * extent.half)).sqrt();
        if at_middle + reach < limit * (1.0 - SLACK) {
            return Verdict::Paint;
        }
        if at_middle - reach <= limit * (1.0 + SLACK) {
            verdict = Verdict::Mixed;
        }
    }
    verdict
}

/// One bit for each 8-bit colour, red most significant.
struct ColourTable {
    words: Vec<u64>,
    bounds: Bounds,
}

impl ColourTable {
    const SLAB_WORDS: usize = 16 * 65_536 / 64;

    fn new(test: &PaintTest) -> ColourTable {
        let mut words = vec![0u64; (1 << 24) / 64];
        // Sixteen reds at a time, so that slabs are disjoint slices.
        let bounds = words
            .par_chunks_mut(Self::SLAB_WORDS)
            .enumerate()
            .map(|(slab, words)| fill_slab(test, slab, words))
            .reduce(|| Bounds::NOTHING, |a, b| a.union(&b));
        ColourTable { words, bounds }
    }

    fn get(&self, c: [u8; 3]) -> bool {
        let index = usize::from(c[0]) << 16 | usize::from(c[1]) << 8 | usize::from(c[2]);
        self.words[index >> 6] >> (index & 63) & 1 == 1
    }
}

/// The colours with red `16·slab .. 16·slab + 16`.
fn fill_slab(test: &PaintTest, slab: usize, words: &mut [u64]) -> Bounds {
    let mut fill = Fill { test, red: 16 * slab, words, bounds: Bounds::NOTHING };
    for (g, b) in (0..256).step_by(16).flat_map(|g| (0..256).step_by(16).map(move |b| (g, b))) {
        fill.cube([16 * slab, g, b], 16);
    }
    fill.bounds
}

struct Fill<'a> {
    test: &'a PaintTest,
    /// Of the first word.
    red: usize,
    words: &'a mut [u64],
    bounds: Bounds,
}

impl Fill<'_> {
    /// Splits cubes until one answer holds for the whole of each; below a certain size the colours are asked one by one.
    fn cube(&mut self, [r, g, b]: [usize; 3], side: usize) {
        const ONE_BY_ONE: usize = 2;
        let low = [r as u8, g as u8, b as u8];
        let verdict = self.test.judge(low, low.map(|v| v + (side - 1) as u8));
        let colours = (0..side * side * side).map(|i| [r + i / (side * side), g + i / side % side, b + i % side]);
        match verdict {
            Verdict::Ground => {}
            Verdict::Paint => {
                colours.for_each(|colour| self.set(colour));
                // Samples and their differences are extreme at corners.
                let far = |corner: usize, axis: usize| if corner >> axis & 1 == 1 { (side - 1) as u8 } else { 0 };
                (0..8).for_each(|k| self.bounds.admit(std::array::from_fn(|axis| low[axis] + far(k, axis))));
            }
            Verdict::Mixed if side > ONE_BY_ONE => {
                let half = side / 2;
                for k in 0..8 {
                    self.cube([r + half * (k >> 2), g + half * (k >> 1 & 1), b + half * (k & 1)], half);
                }
            }
            Verdict::Mixed => {
                for colour in colours {
                    let bytes = colour.map(|v| v as u8);
                    // The bound of a single colour is all but the colour: what it leaves open is asked exactly.
                    let paint = match self.test.judge(bytes, bytes) {
                        Verdict::Paint => true,
                        Verdict::Ground => false,
                        Verdict::Mixed => table_bit(self.test, bytes),
                    };
                    if paint {
                        self.set(colour);
                        self.bounds.admit(bytes);
                    }
                }
            }
        }
    }

    fn set(&mut self, [r, g, b]: [usize; 3]) {
        let index = (r - self.red) << 16 | g << 8 | b;
        self.words[index >> 6] |= 1 << (index & 63);
    }
}

/// [`PaintTest::is_paint`] with the powers of the sRGB curve looked up instead of computed; same numbers, same order.
fn table_bit(test: &PaintTest, colour: [u8; 3]) -> bool {
    if test.space == Space::Rgb || test.rough.is_some() || test.low != [0; 3] || test.high != [255; 3] {
        return test.is_paint(colour);
    }
    let lab = lab_from_f(xyz_from_linear(colour.map(|v| linear_of_bytes()[usize::from(v)])).map(lab_f));
    test.clouds.iter().map(|c| c.distance2(&lab)).fold(f64::INFINITY, f64::min) / test.limit2 <= 1.0
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
}

impl Classifier {
    /// `rgb` and `alpha` are sample indices in a pixel (one grey band three times is fine); `white` is the sample value of
    /// full white; a pixel whose colour samples all equal `nodata`, or whose alpha is 0, is background.
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
        if white == 0 {
            return Err(Error::usage("the value of white is 0", "give the largest sample value with --white"));
        }
        let test = PaintTest::new(profile)?;
        let table = ColourTable::new(&test);
        let nodata = nodata.filter(|v| v.fract() == 0.0 && (0.0..=65_535.0).contains(v)).map(|v| v as u16);
        let [of_samples, of_colours] = [rgb, [0, 1, 2]].map(|rgb| Arc::new(Prefilter::new(rgb, table.bounds)));
        let (table, test) = (Arc::new(table), Arc::new(test));
        Ok(Classifier { table, of_samples, of_colours, test, sample, white, rgb, alpha, nodata })
    }

    /// The scalar reference behind the table.
    pub fn reference(&self) -> &PaintTest {
        &self.test
    }

    /// The table's answer for an 8-bit colour. The bounds spare most colours the table, which is larger than the nearest caches.
    pub fn is_paint(&self, colour: [u8; 3]) -> bool {
        self.table.bounds.passes(colour) && self.table.get(colour)
    }

    /// Which of a window's pixels are paint: `colours` red, green, blue as the file has them, `valid` where there is any.
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
        keep(&mut bits, |i| self.table.get([bytes[3 * i], bytes[3 * i + 1], bytes[3 * i + 2]]));
        bits
    }

    /// A sample on the 8-bit scale: `(255·v + white/2) / white`, at most 255; bytes with white 255 are themselves.
    pub fn to_byte(&self, sample: u16) -> u8 {
        scale(sample, self.white)
    }

    /// One bit a pixel: is it paint? `bits` has `ceil(row.len / 64)` words; all are overwritten, unused high bits are zero.
    ///
    /// # Panics
    /// When `bits` or the row's samples are too short.
    pub fn classify_row(&self, row: PixelRow<'_>, bits: &mut [u64]) {
        let words = row.len.div_ceil(64);
        let bits = &mut bits[..words];
        match row.samples {
            Samples::U8(samples) if self.white == 255 && self.sample == SampleType::U8 => {
                self.of_samples.row(samples, row.pixel_stride, row.len, bits);
                self.refine(bits, |i| {
                    let pixel = &samples[i * row.pixel_stride..];
                    (self.rgb.map(|b| u16::from(pixel[b])), self.alpha.map(|a| u16::from(pixel[a])))
                });
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
            !holds_nothing && self.table.get(colour.map(|v| self.to_byte(v)))
        });
    }
}

/// Clears the set bits of pixels that are not `wanted`.
fn keep(bits: &mut [u64], wanted: impl Fn(usize) -> bool) {
    for (w, word) in bits.iter_mut().enumerate() {
        let mut left = *word;
        while left != 0 {
            let bit = left.trailing_zeros();
            left &= left - 1;
            if !wanted(w * 64 + bit as usize) {
                *word &= !(1 << bit);
            }
        }
    }
}

fn scale(sample: u16, white: u16) -> u8 {
    if white == 255 {
        return sample.min(255) as u8;
    }
    ((255 * u32::from(sample) + u32::from(white) / 2) / u32::from(white)).min(255) as u8
}

/// L\*a\*b\* of an 8-bit colour, for whoever measures distances to what a classifier took.
pub fn lab_of(colour: [u8; 3]) -> [f64; 3] {
    let lab = lab_from_srgb(colour.map(|v| f64::from(v) / 255.0));
    [lab[0], lab[1], lab[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn classifier(profile: &str) -> Classifier {
        let profile = Profile::builtin(profile).expect("shipped");
        Classifier::new(&profile, SampleType::U8, 255, [0, 1, 2], None, None).expect("valid")
    }

    /// Every one of the 2²⁴ colours, through the whole row path, equals the scalar reference.
    #[test]
    fn all_colours_equal_the_scalar_reference() {
        for name in ["orange", "autoref-2016", "white-on-dark"] {
            let classifier = classifier(name);
            let wrong: u64 = (0..=255u8)
                .into_par_iter()
                .map(|r| {
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
        for colour in [[180, 130, 90], [90, 120, 60], [200, 30, 30], [160, 150, 130], [255, 230, 0]] {
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
