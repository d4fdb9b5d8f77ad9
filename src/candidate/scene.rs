//! Geometry and colour statistics of the small window around one candidate.

use std::cell::OnceCell;

use nalgebra::{Matrix3, Vector3};

use super::pixel_set::PixelSet;
use crate::profile::Filters;
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::Patch;
use autoref_raster::ranks;
use autoref_raster::srgb::{linear_from_srgb, linear_of_bytes};

/// The ring of ground around a mark starts and ends so far outside, beyond the blurred border.
pub(super) const RING_PX: (usize, usize) = (4, 9);
/// So far from paint its blur reaches.
const BLURRED_PX: usize = 2;

/// Which paint of a patch is a region's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OwnPaint {
    /// Exactly the 8-connected set that its first pixel is in.
    Piece,
    /// All paint inside its bounds.
    InBounds,
}

impl OwnPaint {
    /// Mask filters change the outlines of regions, so that none is a piece of the paint any more.
    pub(crate) fn under(filters: &Filters) -> OwnPaint {
        if *filters == Filters::default() { OwnPaint::Piece } else { OwnPaint::InBounds }
    }
}

/// A patch split into the candidate's own paint, other paint, and ground.
#[derive(Clone)]
pub(crate) struct Scene<'a> {
    pub patch: &'a Patch,
    pub width: usize,
    pub height: usize,
    /// The candidate's pixels.
    pub own: PixelSet,
    /// Paint that is not the candidate's.
    pub other: PixelSet,
    /// Where there is anything.
    pub valid: PixelSet,
    /// From samples to the scale 0..=255.
    scale: f64,
    /// Colours are given in linear light.
    linear: bool,
    /// Worked out when first asked for: every look asks for them.
    plateau: OnceCell<Vector3<f64>>,
    ring_ground: OnceCell<Option<Ground>>,
}

impl<'a> Scene<'a> {
    /// `None` when none of the candidate's pixels is in the patch.
    pub fn new(region: &Region, patch: &'a Patch, classifier: &Classifier, own_paint: OwnPaint) -> Option<Scene<'a>> {
        if patch.window.is_empty() {
            return None;
        }
        let (width, height) = (patch.window.width as usize, patch.window.height as usize);
        let valid = PixelSet::of(&patch.valid, width);
        let paint = PixelSet::of_bits(&classifier.paint_bits(&patch.rgb), width, height).and(&valid);
        let (first_y, first_x) = region.first;
        let start = patch
            .window
            .contains(first_x, first_y)
            .then(|| (first_y - patch.window.y) as usize * width + (first_x - patch.window.x) as usize)
            .filter(|&i| own_paint == OwnPaint::Piece && paint.has(i));
        let own = match start {
            Some(start) => paint.piece(start),
            None => {
                let inside = |i: usize| {
                    region.bounds.contains(patch.window.x + (i % width) as u64, patch.window.y + (i / width) as u64)
                };
                paint.and(&PixelSet::from_fn(width, height, inside))
            }
        };
        (!own.is_empty()).then(|| Scene::among(patch, own, &paint, valid))
    }

    /// The scene of a set of pixels of the patch among all that is paint.
    pub fn of_pixels(patch: &'a Patch, own: PixelSet, paint: &PixelSet) -> Scene<'a> {
        Scene::among(patch, own, paint, PixelSet::of(&patch.valid, patch.window.width as usize))
    }

    /// The scene of other pixels of the same patch among all that is paint.
    pub fn with_own(&self, own: PixelSet, paint: &PixelSet) -> Scene<'a> {
        Scene::among(self.patch, own, paint, self.valid.clone())
    }

    /// The same scene, blind to some of its pixels.
    pub fn without(&self, unseen: &PixelSet) -> Scene<'a> {
        let (plateau, ring_ground) = Default::default();
        Scene { valid: self.valid.minus(unseen), plateau, ring_ground, ..self.clone() }
    }

    fn among(patch: &'a Patch, own: PixelSet, paint: &PixelSet, valid: PixelSet) -> Scene<'a> {
        let (width, height) = (patch.window.width as usize, patch.window.height as usize);
        let scale = 255.0 / f64::from(patch.white);
        let (plateau, ring_ground) = Default::default();
        Scene { patch, width, height, other: paint.minus(&own), own, valid, scale, linear: false, plateau, ring_ground }
    }

    /// Paint of whatever mark.
    pub fn paint(&self) -> PixelSet {
        self.own.or(&self.other)
    }

    /// Samples on the scale 0..=255, not rounded; in linear light for [`Scene::in_linear_light`].
    pub fn colour(&self, i: usize) -> Vector3<f64> {
        let samples = self.patch.rgb[i];
        if self.linear && self.patch.white == 255 {
            // The same numbers: bytes are on the scale already.
            let beyond = |v: u16| linear_from_srgb(f64::from(v) / 255.0);
            let light = |v: u16| linear_of_bytes().get(usize::from(v)).copied().unwrap_or_else(|| beyond(v));
            let [r, g, b] = samples;
            return Vector3::new(255.0 * light(r), 255.0 * light(g), 255.0 * light(b));
        }
        let [r, g, b] = samples;
        let on_scale = |v: u16| f64::from(v) * self.scale;
        let colour = Vector3::new(on_scale(r), on_scale(g), on_scale(b));
        if self.linear {
            return colour.map(|v| 255.0 * linear_from_srgb(v / 255.0));
        }
        colour
    }

    /// The same scene with its colours in linear light, still on the scale 0..=255.
    pub fn in_linear_light(&self) -> Scene<'a> {
        let (plateau, ring_ground) = Default::default();
        Scene { linear: true, plateau, ring_ground, ..self.clone() }
    }

    /// Colour of the paint where it is least mixed: the median over the deepest pixels of the region.
    pub fn plateau(&self) -> Vector3<f64> {
        *self.plateau.get_or_init(|| {
            // A region two pixels deep has a core of one or a few; three deep, everything from the third ring on.
            let core = [2, 1].into_iter().map(|depth_px| self.own.shrunk(depth_px)).find(|core| !core.is_empty());
            self.median_colour(core.as_ref().unwrap_or(&self.own))
        })
    }

    /// The ground in the ring around the region.
    pub fn ring_ground(&self) -> Option<&Ground> {
        let ground = self.ring_ground.get_or_init(|| {
            self.statistics(&self.ring(RING_PX)).or_else(|| {
                // Crowded or cut off: whatever is near and not paint.
                self.statistics(&self.valid.minus(&self.own.grown(1)).minus(&self.other))
            })
        });
        ground.as_ref()
    }

    /// Samples of the pixels of a set, as the file has them.
    fn samples(&self, set: &PixelSet) -> Vec<[u16; 3]> {
        let mut samples = Vec::with_capacity(set.count());
        set.for_each(|i| samples.push(self.patch.rgb[i]));
        samples
    }

    fn colours(&self, set: &PixelSet) -> Vec<Vector3<f64>> {
        set.iter().map(|i| self.colour(i)).collect()
    }

    /// Every pixel's colour along a direction, less `origin`.
    pub fn along(&self, direction: Vector3<f64>, origin: f64) -> Vec<f64> {
        if self.linear {
            return (0..self.patch.rgb.len()).map(|i| self.colour(i).dot(&direction) - origin).collect();
        }
        self.patch.rgb.iter().map(|v| self.sample_along(*v, direction) - origin).collect()
    }

    /// The same of one pixel, which is not in linear light.
    pub fn one_along(&self, i: usize, direction: Vector3<f64>, origin: f64) -> f64 {
        debug_assert!(!self.linear);
        self.sample_along(self.patch.rgb[i], direction) - origin
    }

    fn sample_along(&self, v: [u16; 3], direction: Vector3<f64>) -> f64 {
        // Scaled before it is weighed: a multiple of 257 of a byte is that byte, to the last bit.
        let sample = |v: u16| f64::from(v) * self.scale;
        sample(v[0]) * direction[0] + sample(v[1]) * direction[1] + sample(v[2]) * direction[2]
    }

    /// Robust statistics of the pixels of a set; `None` of fewer than 12.
    pub fn statistics(&self, set: &PixelSet) -> Option<Ground> {
        if self.linear { ground(&self.colours(set)) } else { sample_ground(&self.samples(set), self.patch.white) }
    }

    /// Median, band by band, of the pixels of a set; 0 of none.
    pub fn median_colour(&self, set: &PixelSet) -> Vector3<f64> {
        if self.linear {
            let colours = self.colours(set);
            let of =
                |c: usize| if colours.is_empty() { 0.0 } else { ranks::median(colours.iter().map(|v| v[c]).collect()) };
            return Vector3::new(of(0), of(1), of(2));
        }
        let samples = self.samples(set);
        let of = |c: usize| {
            let median2 = twice_median(samples.iter().map(|v| u32::from(v[c])));
            f64::from(255 * median2) / f64::from(2 * u32::from(self.patch.white))
        };
        Vector3::new(of(0), of(1), of(2))
    }

    /// Ground: valid, `from_px` to `to_px` from the candidate's nearest pixel, clear of other paint.
    pub fn ring(&self, (from_px, to_px): (usize, usize)) -> PixelSet {
        let near = self.own.grown(from_px - 1);
        let ring = near.grown(to_px + 1 - from_px).minus(&near);
        ring.and(&self.valid).minus(&self.beside_other())
    }

    /// Other paint and what it may have blurred into.
    pub fn beside_other(&self) -> PixelSet {
        self.other.grown(BLURRED_PX)
    }

    /// Number of separate pieces of paint in the patch, the candidate included.
    pub fn clutter(&self) -> u32 {
        let mut left = self.other.clone();
        let mut count = 1;
        while let Some(start) = left.first() {
            left = left.minus(&left.piece(start));
            count += 1;
        }
        count
    }
}

/// Mean and covariance of a set of colours with its outliers left out.
#[derive(Clone, Debug)]
pub struct Ground {
    pub mean: Vector3<f64>,
    pub covariance: Matrix3<f64>,
    pub count: usize,
}

/// Robust statistics: median, then mean and covariance of what lies within 3.5 standard deviations of it (per axis, by
/// the median absolute deviation). `None` below 12 colours.
pub fn ground(colours: &[Vector3<f64>]) -> Option<Ground> {
    if colours.len() < 12 {
        return None;
    }
    let median: [f64; 3] = std::array::from_fn(|c| ranks::median(colours.iter().map(|v| v[c]).collect()));
    let spread: [f64; 3] = std::array::from_fn(|c| {
        // 1.4826 makes it a standard deviation for Gaussian noise; 2 is the noise of a good 8-bit picture.
        (1.4826 * ranks::median(colours.iter().map(|v| (v[c] - median[c]).abs()).collect())).max(2.0)
    });
    let kept: Vec<&Vector3<f64>> =
        colours.iter().filter(|v| (0..3).all(|c| (v[c] - median[c]).abs() <= 3.5 * spread[c])).collect();
    if kept.len() < 8 {
        return None;
    }
    let n = kept.len() as f64;
    let mean = kept.iter().fold(Vector3::zeros(), |s, v| s + **v) / n;
    let scatter = kept.iter().fold(Matrix3::zeros(), |s: Matrix3<f64>, v| {
        let d = **v - mean;
        s + d * d.transpose()
    });
    Some(Ground { mean, covariance: scatter / n, count: kept.len() })
}

/// [`ground`] of samples as the file has them, of which `white` is 255, in whole numbers: every region of the right
/// colour asks. Copies of an image with all samples and the white multiplied give the same to the last bit.
pub fn sample_ground(colours: &[[u16; 3]], white: u16) -> Option<Ground> {
    if colours.len() < 12 {
        return None;
    }
    // The limits as in `ground`.
    let limits = middles(colours)
        .map(|Middle { median2, deviation4 }| (median2, 2.0 * 3.5 * 1.4826 / 4.0 * f64::from(deviation4)));
    let least = 2 * 7 * u32::from(white);
    let is_outlier = |v: u16, (median2, limit): (u32, f64)| {
        let off = off(u32::from(v), median2);
        f64::from(off) > limit && 255 * off > least
    };
    let (mut n, mut sum, mut products) = (0i128, [0u64; 3], [[0u64; 3]; 3]);
    for v in colours {
        if (0..3).any(|c| is_outlier(v[c], limits[c])) {
            continue;
        }
        n += 1;
        for a in 0..3 {
            sum[a] += u64::from(v[a]);
            for b in a..3 {
                products[a][b] += u64::from(v[a]) * u64::from(v[b]);
            }
        }
    }
    if n < 8 {
        return None;
    }
    let mean = Vector3::from(sum.map(|s| (255 * s) as f64 / (i128::from(white) * n) as f64));
    let white2 = i128::from(white) * i128::from(white);
    let covariance = Matrix3::from_fn(|a, b| {
        let (a, b) = (a.min(b), a.max(b));
        let scatter = 255 * 255 * (n * i128::from(products[a][b]) - i128::from(sum[a]) * i128::from(sum[b]));
        let (scatter, count2) =
            if scatter % white2 == 0 { (scatter / white2, n * n) } else { (scatter, n * n * white2) };
        scatter as f64 / count2 as f64
    });
    Some(Ground { mean, covariance, count: n as usize })
}

/// In halves of a sample.
fn off(v: u32, median2: u32) -> u32 {
    (2 * v).abs_diff(median2)
}

/// Where a band's samples lie: twice their median, four times the median of how far they lie from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Middle {
    median2: u32,
    deviation4: u32,
}

impl Middle {
    fn of(values: impl ExactSizeIterator<Item = u32> + Clone) -> Middle {
        let median2 = twice_median(values.clone());
        Middle { median2, deviation4: twice_median(values.map(|v| off(v, median2))) }
    }

    /// Of so many of each byte, at least one in all.
    fn of_counts(counts: &[u16; BYTES], len: usize) -> Middle {
        let median2 = twice_ranked(counts.iter().map(|&n| usize::from(n)).enumerate(), len);
        let beside = |off: usize| {
            let (low, high) = ((median2 as usize).checked_sub(off), median2 as usize + off);
            let at = |twice: usize| counts.get(twice / 2).map_or(0, |&n| usize::from(n));
            low.filter(|_| off > 0).map_or(0, at) + at(high)
        };
        let offs = (median2 as usize % 2..=2 * BYTES).step_by(2).map(|off| (off, beside(off)));
        Middle { median2, deviation4: twice_ranked(offs, len) }
    }
}

const BYTES: usize = 256;

/// Where each band of the colours, of which there are some, lies. Bytes are counted in one pass.
fn middles(colours: &[[u16; 3]]) -> [Middle; 3] {
    let largest = colours.as_flattened().iter().fold(0, |all, &v| all | v);
    if usize::from(largest) >= BYTES || colours.len() > usize::from(u16::MAX) {
        return std::array::from_fn(|c| Middle::of(colours.iter().map(|v| u32::from(v[c]))));
    }
    let mut counts = [[0u16; BYTES]; 3];
    for colour in colours {
        for (counts, &v) in counts.iter_mut().zip(colour) {
            counts[usize::from(v)] += 1;
        }
    }
    counts.map(|counts| Middle::of_counts(&counts, colours.len()))
}

/// Sum of the middle two of `len` values, which for an odd number are one, given as how many there are of each, rising.
fn twice_ranked(counts: impl Iterator<Item = (usize, usize)>, len: usize) -> u32 {
    let (mut seen, mut below) = (0, None);
    for (value, n) in counts {
        seen += n;
        if below.is_none() && seen > (len - 1) / 2 {
            below = Some(value);
        }
        if let Some(below) = below
            && seen > len / 2
        {
            return (below + value) as u32;
        }
    }
    0
}

/// Twice the median, so that the mean of the middle two is whole; 0 of nothing. Small values are counted.
pub(crate) fn twice_median(values: impl ExactSizeIterator<Item = u32> + Clone) -> u32 {
    const COUNTED: usize = 512;
    let (mut counts, len) = ([0u32; COUNTED], values.len());
    if len == 0 {
        return 0;
    }
    if values.clone().all(|v| (v as usize) < COUNTED) {
        values.for_each(|v| counts[v as usize] += 1);
        return twice_ranked(counts.iter().map(|&n| n as usize).enumerate(), len);
    }
    let mut sorted: Vec<u32> = values.collect();
    let (below, high, _) = sorted.select_nth_unstable(len / 2);
    let high = *high;
    if len % 2 == 1 { 2 * high } else { high + below.iter().copied().max().unwrap_or(high) }
}

#[cfg(test)]
mod tests {
    use super::*;

    proptest::proptest! {
        #[test]
        fn twice_the_median_is_what_sorting_gives(values in proptest::collection::vec(0u32..1200, 1..60), large: bool) {
            let values: Vec<u32> = values.into_iter().map(|v| if large { v } else { v % 400 }).collect();
            let mut sorted = values.clone();
            sorted.sort_unstable();
            let expected = sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2];
            proptest::prop_assert_eq!(twice_median(values.into_iter()), expected);
        }

        #[test]
        fn bytes_counted_lie_where_sorting_says(colours in proptest::collection::vec(proptest::array::uniform3(0u16..256), 1..60), narrow: bool) {
            let colours: Vec<[u16; 3]> = colours.into_iter().map(|c| if narrow { c.map(|v| v % 5 * 63) } else { c }).collect();
            let twin: [Middle; 3] = std::array::from_fn(|c| Middle::of(colours.iter().map(|v| u32::from(v[c]))));
            proptest::prop_assert_eq!(middles(&colours), twin);
        }
    }

    #[test]
    fn outliers_do_not_move_the_ground() {
        let mut colours: Vec<_> = (0..60).map(|i| [100 + i % 5, 90, 80]).collect();
        colours.extend([[250, 20, 0]; 10]);
        let narrow = sample_ground(&colours, 255).expect("enough");
        for (factor, white) in [(1, 255), (257, 65_535), (16, 4080)] {
            let wide: Vec<[u16; 3]> = colours.iter().map(|c| c.map(|v| v * factor)).collect();
            let g = sample_ground(&wide, white).expect("enough");
            assert_eq!((g.mean, g.covariance), (narrow.mean, narrow.covariance));
            let scale = 255.0 / f64::from(white);
            let twin: Vec<_> = wide.iter().map(|c| Vector3::from(c.map(|v| f64::from(v) * scale))).collect();
            let twin = ground(&twin).expect("enough");
            assert!((twin.mean - g.mean).norm() < 1e-9 && (twin.covariance - g.covariance).norm() < 1e-9);
            assert!((g.mean[0] - 102.0).abs() < 0.1 && g.count == 60);
            assert!((g.covariance[(0, 0)] - 2.0).abs() < 1e-9 && g.covariance[(0, 1)].abs() < 1e-9, "{g:?}");
        }
    }
}
