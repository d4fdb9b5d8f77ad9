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
        let paint: Vec<bool> = patch
            .rgb
            .iter()
            .zip(&patch.valid)
            .map(|(c, &valid)| valid && classifier.is_paint(c.map(|v| classifier.to_byte(v))))
            .collect();
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
        let not_own: Vec<bool> = own.iter().map(|o| !o).collect();
        let inside_px = distance(&not_own, width, height);
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
///
/// A sweep down and one up give it exactly for this metric: A. Rosenfeld and J. L. Pfaltz, "Distance functions on digital
/// pictures", Pattern Recognition 1(1), 1968.
pub(crate) fn distance(mask: &[bool], width: usize, height: usize) -> Vec<u8> {
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
        fn distances_are_chebyshev(width in 1usize..40, height in 1usize..40, set in proptest::collection::vec(0usize..1600, 0..6)) {
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
        let mut colours: Vec<_> = (0..60).map(|i| Vector3::new(100.0 + (i % 5) as f64, 90.0, 80.0)).collect();
        colours.extend((0..10).map(|_| Vector3::new(250.0, 20.0, 0.0)));
        let g = ground(&colours).expect("enough");
        assert!((g.mean[0] - 102.0).abs() < 0.1 && g.count == 60);
    }
}
