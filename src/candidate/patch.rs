//! Geometry and colour statistics of the small window around one candidate.

use nalgebra::{Matrix3, Vector3};

use crate::profile::colour::linear_from_srgb;
use crate::raster::{Block, Patch, RasterInfo, Samples};
use crate::segment::classify::Classifier;
use crate::segment::label::Region;

/// Pixels further from the region than this are all "far".
pub const FAR_PX: u8 = 14;

/// A patch split into the candidate's own paint, other paint, and ground.
#[derive(Clone)]
pub struct Scene<'a> {
    pub patch: &'a Patch,
    pub width: usize,
    pub height: usize,
    /// The candidate's pixels.
    pub own: Vec<bool>,
    /// Paint that is not the candidate's.
    pub other: Vec<bool>,
    /// Chebyshev distance to the candidate's nearest pixel, capped at [`FAR_PX`]; 0 on it.
    pub outside_px: Vec<u8>,
    /// Chebyshev distance to the nearest pixel that is not the candidate's, capped; 0 outside it.
    pub inside_px: Vec<u8>,
    /// The same to the nearest other paint.
    pub other_px: Vec<u8>,
    /// From samples to the scale 0..=255.
    scale: f64,
    /// Colours are given in linear light.
    linear: bool,
}

impl<'a> Scene<'a> {
    /// `None` when none of the candidate's pixels is in the patch. `connected` says that the region is exactly the
    /// 8-connected set that its first pixel is in; with mask filters it is the paint inside the bounds instead.
    pub fn new(region: &Region, patch: &'a Patch, classifier: &Classifier, connected: bool) -> Option<Scene<'a>> {
        let (width, height) = (patch.window.width as usize, patch.window.height as usize);
        let paint = classifier.paint_of(&patch.rgb, &patch.valid);
        let (first_y, first_x) = region.first;
        let start = patch
            .window
            .contains(first_x, first_y)
            .then(|| (first_y - patch.window.y) as usize * width + (first_x - patch.window.x) as usize)
            .filter(|&i| connected && paint[i]);
        let own = match start {
            Some(start) => flood(&paint, width, height, start),
            None => {
                let inside = |i: usize| {
                    region.bounds.contains(patch.window.x + (i % width) as u64, patch.window.y + (i / width) as u64)
                };
                (0..paint.len()).map(|i| paint[i] && inside(i)).collect()
            }
        };
        if !own.iter().any(|&b| b) {
            return None;
        }
        Some(Scene::of_pixels(patch, own, paint))
    }

    /// The scene of a set of pixels of the patch among all that is paint.
    pub fn of_pixels(patch: &'a Patch, own: Vec<bool>, paint: Vec<bool>) -> Scene<'a> {
        let (width, height) = (patch.window.width as usize, patch.window.height as usize);
        let other: Vec<bool> = paint.iter().zip(&own).map(|(&p, &o)| p && !o).collect();
        let outside_px = distance(&own, width, height);
        let inside_px = depth(&own, width, height);
        let alone = !other.iter().any(|&b| b);
        let other_px = if alone { vec![FAR_PX; own.len()] } else { distance(&other, width, height) };
        let scale = 255.0 / f64::from(patch.white);
        Scene { patch, width, height, own, other, outside_px, inside_px, other_px, scale, linear: false }
    }

    /// Samples on the scale 0..=255, not rounded; in linear light for [`Scene::in_linear_light`].
    pub fn colour(&self, i: usize) -> Vector3<f64> {
        let c = self.patch.rgb[i].map(|sample| f64::from(sample) * self.scale);
        if self.linear {
            return Vector3::from(c.map(|v| 255.0 * linear_from_srgb(v / 255.0)));
        }
        Vector3::from(c)
    }

    /// The same scene with its colours in linear light, still on the scale 0..=255.
    pub fn in_linear_light(&self) -> Scene<'a> {
        Scene { linear: true, ..self.clone() }
    }

    /// Samples, as the file has them, of the pixels that are `wanted`.
    fn samples(&self, wanted: impl Fn(usize) -> bool) -> Vec<[u16; 3]> {
        let mut samples = Vec::with_capacity(self.own.len());
        samples.extend(self.patch.rgb.iter().enumerate().filter(|&(i, _)| wanted(i)).map(|(_, c)| *c));
        samples
    }

    fn colours(&self, wanted: impl Fn(usize) -> bool) -> Vec<Vector3<f64>> {
        (0..self.own.len()).filter(|&i| wanted(i)).map(|i| self.colour(i)).collect()
    }

    /// Every pixel's colour along a direction, less `origin`.
    pub fn along(&self, direction: Vector3<f64>, origin: f64) -> Vec<f64> {
        if self.linear {
            return (0..self.own.len()).map(|i| self.colour(i).dot(&direction) - origin).collect();
        }
        let ([a, b, c], scale) = ([direction[0], direction[1], direction[2]], self.scale);
        // Scaled before it is weighed: a multiple of 257 of a byte is that byte, to the last bit.
        let sample = |v: u16| f64::from(v) * scale;
        let along = |v: &[u16; 3]| sample(v[0]) * a + sample(v[1]) * b + sample(v[2]) * c - origin;
        self.patch.rgb.iter().map(along).collect()
    }

    /// Robust statistics of the pixels that are `wanted`; `None` of fewer than 12.
    pub fn ground(&self, wanted: impl Fn(usize) -> bool) -> Option<Ground> {
        if self.linear { ground(&self.colours(wanted)) } else { sample_ground(&self.samples(wanted), self.patch.white) }
    }

    /// Median, band by band, of the pixels that are `wanted`; 0 of none.
    pub fn median_colour(&self, wanted: impl Fn(usize) -> bool) -> Vector3<f64> {
        if self.linear {
            let colours = self.colours(wanted);
            let of = |c: usize| if colours.is_empty() { 0.0 } else { median(colours.iter().map(|v| v[c]).collect()) };
            return Vector3::new(of(0), of(1), of(2));
        }
        let samples = self.samples(wanted);
        let of = |c: usize| {
            let median2 = twice_median(samples.iter().map(|v| u32::from(v[c])));
            f64::from(255 * median2) / f64::from(2 * u32::from(self.patch.white))
        };
        Vector3::new(of(0), of(1), of(2))
    }

    /// Ground: valid, at the given distances from the candidate, clear of other paint.
    pub fn is_ground(&self, i: usize, from_px: u8, to_px: u8) -> bool {
        self.patch.valid[i] && (from_px..=to_px).contains(&self.outside_px[i]) && self.other_px[i] > 2
    }

    /// Number of separate pieces of paint in the patch, the candidate included.
    pub fn clutter(&self) -> u32 {
        let mut left = self.other.clone();
        let mut count = 1;
        while let Some(start) = left.iter().position(|&b| b) {
            let piece = flood(&left, self.width, self.height, start);
            left.iter_mut().zip(&piece).for_each(|(l, &p)| *l &= !p);
            count += 1;
        }
        count
    }
}

/// Copies a block together: RGB as read, and which pixels hold anything (alpha not 0, not all colour samples nodata).
pub fn patch_from_block(block: &Block, info: &RasterInfo) -> Patch {
    let window = block.window;
    let width = window.width as usize;
    let mut rgb = vec![[0u16; 3]; window.area() as usize];
    let mut valid = vec![false; rgb.len()];
    for piece in block.pieces.iter().filter(|p| !p.empty) {
        let part = piece.window.intersect(&window);
        for y in part.y..part.bottom() {
            let row = piece.row(part.x, y, part.width);
            let sample = |i: usize, b: usize| match row.samples {
                Samples::U8(s) => u16::from(s[i * row.pixel_stride + b]),
                Samples::U16(s) => s[i * row.pixel_stride + b],
            };
            let start = (y - window.y) as usize * width + (part.x - window.x) as usize;
            for i in 0..row.len {
                let colour = info.rgb.map(|b| sample(i, b));
                let clear = info.alpha.is_some_and(|a| sample(i, a) == 0);
                let nothing = info.nodata.is_some_and(|n| colour.iter().all(|&v| f64::from(v) == n));
                rgb[start + i] = colour;
                valid[start + i] = !clear && !nothing;
            }
        }
    }
    Patch { window, rgb, valid, white: info.white }
}

/// The 8-connected set of `mask` that holds `start`.
pub(crate) fn flood(mask: &[bool], width: usize, height: usize, start: usize) -> Vec<bool> {
    let mut set = vec![false; mask.len()];
    let mut todo = vec![start];
    set[start] = true;
    while let Some(i) = todo.pop() {
        for j in neighbours(i, width, height) {
            if mask[j] && !set[j] {
                set[j] = true;
                todo.push(j);
            }
        }
    }
    set
}

fn neighbours(i: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % width, i / width);
    let columns = x.saturating_sub(1)..(x + 2).min(width);
    (y.saturating_sub(1)..(y + 2).min(height)).flat_map(move |v| columns.clone().map(move |u| v * width + u))
}

/// Chebyshev distance to the nearest set pixel, capped at [`FAR_PX`].
pub(crate) fn distance(mask: &[bool], width: usize, height: usize) -> Vec<u8> {
    if (1..=u64::BITS as usize).contains(&width) {
        distance_in_words(mask, width, height)
    } else {
        distance_in_sweeps(mask, width, height)
    }
}

/// Grows the set by a pixel on all sides at a time, each row in one word.
fn distance_in_words(mask: &[bool], width: usize, height: usize) -> Vec<u8> {
    let mut out = vec![FAR_PX; mask.len()];
    let mut rows: Vec<u64> =
        mask.chunks_exact(width).map(|row| row.iter().rev().fold(0, |bits, &set| bits << 1 | u64::from(set))).collect();
    let inside = u64::MAX >> (u64::BITS as usize - width);
    let mut reached = vec![0u64; height];
    for far_px in 0..FAR_PX {
        let mut any = 0;
        for ((row, reached), out) in rows.iter_mut().zip(&mut reached).zip(out.chunks_exact_mut(width)) {
            let mut new = *row & !*reached;
            any |= new;
            *reached |= new;
            while new != 0 {
                out[new.trailing_zeros() as usize] = far_px;
                new &= new - 1;
            }
            *row |= (*row << 1 | *row >> 1) & inside;
        }
        if any == 0 {
            break;
        }
        let mut above = 0;
        for y in 0..height {
            let (here, below) = (rows[y], rows.get(y + 1).copied().unwrap_or(0));
            rows[y] = above | here | below;
            above = here;
        }
    }
    out
}

/// A sweep down and one up give it exactly for this metric: A. Rosenfeld and J. L. Pfaltz, "Distance functions on digital
/// pictures", Pattern Recognition 1(1), 1968.
fn distance_in_sweeps(mask: &[bool], width: usize, height: usize) -> Vec<u8> {
    let mut out: Vec<u8> = mask.iter().map(|&set| if set { 0 } else { FAR_PX }).collect();
    let mut before = vec![FAR_PX; width];
    for y in 0..height {
        sweep(&mut out[y * width..(y + 1) * width], &mut before);
    }
    before.fill(FAR_PX);
    for y in (0..height).rev() {
        sweep(&mut out[y * width..(y + 1) * width], &mut before);
    }
    out
}

/// Of each set pixel the Chebyshev distance to the nearest that is not set, capped at [`FAR_PX`]; 0 elsewhere. That nearest
/// one is never further out than the rim around the box of what is set, so that only the box is swept.
fn depth(mask: &[bool], width: usize, height: usize) -> Vec<u8> {
    let mut out = vec![0; mask.len()];
    let rows = || (0..height).map(|y| &mask[y * width..(y + 1) * width]);
    let Some(top) = rows().position(|row| row.contains(&true)) else { return out };
    let bottom = rows().rposition(|row| row.contains(&true)).unwrap_or(top);
    let left = rows().filter_map(|row| row.iter().position(|&b| b)).min().unwrap_or(0);
    let right = rows().filter_map(|row| row.iter().rposition(|&b| b)).max().unwrap_or(left);
    let (x0, x1) = (left.saturating_sub(1), (right + 2).min(width));
    let (y0, y1) = (top.saturating_sub(1), (bottom + 2).min(height));
    let box_width = x1 - x0;
    let clear: Vec<bool> = rows().take(y1).skip(y0).flat_map(|row| row[x0..x1].iter().map(|&b| !b)).collect();
    for (row, y) in distance(&clear, box_width, y1 - y0).chunks_exact(box_width).zip(y0..) {
        out[y * width + x0..y * width + x1].copy_from_slice(row);
    }
    out
}

/// Lowers a row by what the row before it knows; `before` holds the least of the three neighbours there, and gets those of
/// this row.
fn sweep(row: &mut [u8], before: &mut [u8]) {
    for (value, near) in row.iter_mut().zip(before.iter()) {
        *value = (*value).min(near + 1);
    }
    let mut side = FAR_PX;
    for value in row.iter_mut() {
        side = (*value).min(side + 1);
        *value = side;
    }
    for value in row.iter_mut().rev() {
        side = (*value).min(side + 1);
        *value = side;
    }
    before.copy_from_slice(row);
    for (near, value) in before.iter_mut().zip(&row[1..]) {
        *near = (*near).min(*value);
    }
    for (near, value) in before[1..].iter_mut().zip(row.iter()) {
        *near = (*near).min(*value);
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
    let median: [f64; 3] = std::array::from_fn(|c| median(colours.iter().map(|v| v[c]).collect()));
    let spread: [f64; 3] = std::array::from_fn(|c| {
        // 1.4826 makes it a standard deviation for Gaussian noise; 2 is the noise of a good 8-bit picture.
        (1.4826 * self::median(colours.iter().map(|v| (v[c] - median[c]).abs()).collect())).max(2.0)
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

/// [`ground`] of samples as the file has them, of which `white` is 255, in whole numbers: every region of the right colour
/// asks. Copies of an image with all samples and the white multiplied give the same to the last bit.
pub fn sample_ground(colours: &[[u16; 3]], white: u16) -> Option<Ground> {
    if colours.len() < 12 {
        return None;
    }
    // In halves of a sample.
    let off = |v: u16, median2: u32| (2 * u32::from(v)).abs_diff(median2);
    let limits: [(u32, f64); 3] = std::array::from_fn(|c| {
        let median2 = twice_median(colours.iter().map(|v| u32::from(v[c])));
        // Four times the median absolute deviation; the rest as in `ground`.
        let deviation4 = twice_median(colours.iter().map(|v| off(v[c], median2)));
        (median2, 2.0 * 3.5 * 1.4826 / 4.0 * f64::from(deviation4))
    });
    let least = 2 * 7 * u32::from(white);
    let is_outlier = |v: u16, (median2, limit): (u32, f64)| {
        let off = off(v, median2);
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

/// Twice the median, so that the mean of the middle two is whole; 0 of nothing. Small values are counted.
pub(crate) fn twice_median(values: impl ExactSizeIterator<Item = u32> + Clone) -> u32 {
    const COUNTED: usize = 512;
    let (mut counts, len) = ([0u32; COUNTED], values.len());
    if len == 0 {
        return 0;
    }
    if values.clone().all(|v| (v as usize) < COUNTED) {
        values.for_each(|v| counts[v as usize] += 1);
        let rank = |k: usize| {
            let mut seen = 0;
            counts.iter().position(|&n| {
                seen += n as usize;
                seen > k
            })
        };
        return (rank((len - 1) / 2).unwrap_or(0) + rank(len / 2).unwrap_or(0)) as u32;
    }
    let mut sorted: Vec<u32> = values.collect();
    let (below, high, _) = sorted.select_nth_unstable(len / 2);
    let high = *high;
    if len % 2 == 1 { 2 * high } else { high + below.iter().copied().max().unwrap_or(high) }
}

/// Median; the mean of the middle two when the count is even.
///
/// # Panics
/// On an empty list or a NaN.
pub fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    let order = |a: &f64, b: &f64| a.partial_cmp(b).expect("samples are finite");
    let high = *values.select_nth_unstable_by(middle, order).1;
    if values.len().is_multiple_of(2) {
        let below = values[..middle].iter().copied().fold(f64::NEG_INFINITY, f64::max);
        return (below + high) / 2.0;
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_of_odd_and_even_counts() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(median(vec![7.0]), 7.0);
    }

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
        fn depths_are_distances_to_what_is_not_set(width in 1usize..24, height in 1usize..24, set in proptest::collection::vec(0usize..600, 1..200)) {
            let mut mask = vec![false; width * height];
            set.iter().for_each(|i| mask[i % (width * height)] = true);
            let clear: Vec<bool> = mask.iter().map(|b| !b).collect();
            proptest::prop_assert_eq!(depth(&mask, width, height), distance(&clear, width, height));
        }

        #[test]
        fn distances_are_chebyshev(width in 1usize..90, height in 1usize..40, set in proptest::collection::vec(0usize..1600, 0..6)) {
            let mut mask = vec![false; width * height];
            set.iter().for_each(|i| mask[i % (width * height)] = true);
            for (i, got) in distance(&mask, width, height).into_iter().enumerate() {
                let to = |j: usize| (i % width).abs_diff(j % width).max((i / width).abs_diff(j / width));
                let nearest = (0..mask.len()).filter(|&j| mask[j]).map(to).min().unwrap_or(usize::MAX);
                proptest::prop_assert_eq!(usize::from(got), nearest.min(usize::from(FAR_PX)));
            }
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
