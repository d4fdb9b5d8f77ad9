//! The middle of the transparent hole: what is bright near the predicted point and furthest from everything dark.

use super::super::window::Grey;
use autoref_raster::coords::PixelPoint;

/// Radii of what may be the hole, pixels of the scans of 2017: smaller is noise, larger is no hole.
const LEAST_PX: f64 = 3.0;
const MOST_PX: f64 = 10.0;

/// Section 8.4: within `half_px` of `near`, blurred, what is at least as bright as the mean; of its features those that
/// are larger than a hole are left out while others remain, and the place furthest from the dark is the reference
/// point. `None` when nothing is large enough. `unit` is pixels per pixel of the scans of 2017.
pub(super) fn hole(grey: &Grey, near: PixelPoint, half_px: f64, unit: f64) -> Option<PixelPoint> {
    let [x, y] = grey.from_scan(near);
    let clip = |v: f64, n: usize| v.clamp(0.0, n as f64) as usize;
    let (x0, x1) = (clip((x - half_px).round(), grey.width), clip((x + half_px).round(), grey.width));
    let (y0, y1) = (clip((y - half_px).round(), grey.height), clip((y + half_px).round(), grey.height));
    let (width, height) = (x1 - x0, y1 - y0);
    if width < 3 || height < 3 {
        return None;
    }
    let mut patch: Vec<f32> = (0..width * height).map(|n| grey.at(x0 + n % width, y0 + n / width)).collect();
    super::super::window::blur(&mut patch, width, height, (super::FINE_BLUR_PX * unit).max(0.5));
    let mean = patch.iter().map(|v| f64::from(*v)).sum::<f64>() / patch.len() as f64;
    let bright: Vec<bool> = patch.iter().map(|v| f64::from(*v) >= mean).collect();
    let depth = distances(&bright, width);
    let features = features(&bright, width);
    let deepest = |f: &Vec<usize>| f.iter().map(|n| depth[*n]).fold(0.0, f64::max);
    let large_enough = |f: &&Vec<usize>| deepest(f) >= LEAST_PX * unit;
    let holes = features.iter().filter(large_enough).filter(|f| deepest(f) <= MOST_PX * unit);
    let best = holes
        .max_by(|a, b| deepest(a).total_cmp(&deepest(b)))
        .or(features.iter().filter(large_enough).max_by(|a, b| deepest(a).total_cmp(&deepest(b))))?;
    // Of places equally deep the middle.
    let top: Vec<usize> = best.iter().copied().filter(|n| depth[*n] >= deepest(best) - 1e-9).collect();
    let middle = |of: &dyn Fn(usize) -> usize| top.iter().map(|n| of(*n) as f64 + 0.5).sum::<f64>() / top.len() as f64;
    Some(grey.to_scan(x0 as f64 + middle(&|n| n % width), y0 as f64 + middle(&|n| n / width)))
}

/// 8-connected sets of what is set.
fn features(set: &[bool], width: usize) -> Vec<Vec<usize>> {
    let height = set.len() / width;
    let mut seen = vec![false; set.len()];
    let mut all = vec![];
    for start in 0..set.len() {
        if !set[start] || seen[start] {
            continue;
        }
        seen[start] = true;
        let (mut feature, mut next) = (vec![start], 0);
        while next < feature.len() {
            let (x, y) = (feature[next] % width, feature[next] / width);
            next += 1;
            for v in y.saturating_sub(1)..(y + 2).min(height) {
                for u in x.saturating_sub(1)..(x + 2).min(width) {
                    let n = v * width + u;
                    if set[n] && !std::mem::replace(&mut seen[n], true) {
                        feature.push(n);
                    }
                }
            }
        }
        all.push(feature);
    }
    all
}

/// Euclidean distance from every set pixel to the nearest that is not, in pixels; where there is none, the area's size.
///
/// P. F. Felzenszwalb and D. P. Huttenlocher, "Distance transforms of sampled functions", Theory of Computing 8, 2012:
/// the lower envelope of parabolas, along rows and then along columns.
fn distances(set: &[bool], width: usize) -> Vec<f64> {
    let height = set.len() / width;
    let far = ((width + height) as f64).powi(2);
    let mut squares: Vec<f64> = set.iter().map(|s| if *s { far } else { 0.0 }).collect();
    for row in squares.chunks_exact_mut(width) {
        let out = envelope(row);
        row.copy_from_slice(&out);
    }
    for x in 0..width {
        let column: Vec<f64> = (0..height).map(|y| squares[y * width + x]).collect();
        for (y, v) in envelope(&column).into_iter().enumerate() {
            squares[y * width + x] = v;
        }
    }
    squares.into_iter().map(f64::sqrt).collect()
}

/// min over q of (p − q)² + f(q), for every p.
fn envelope(f: &[f64]) -> Vec<f64> {
    // Parabolas of the envelope and where each begins.
    let mut lowest: Vec<(usize, f64)> = vec![];
    for q in 0..f.len() {
        let crossing = |p: usize| {
            let (a, b) = (q as f64, p as f64);
            (f[q] + a * a - f[p] - b * b) / (2.0 * (a - b))
        };
        while lowest.last().is_some_and(|(p, from)| crossing(*p) <= *from) {
            lowest.pop();
        }
        let from = lowest.last().map_or(f64::NEG_INFINITY, |(p, _)| crossing(*p));
        lowest.push((q, from));
    }
    let mut k = 0;
    (0..f.len())
        .map(|p| {
            while k + 1 < lowest.len() && lowest[k + 1].1 < p as f64 {
                k += 1;
            }
            let q = lowest[k].0;
            (p as f64 - q as f64).powi(2) + f[q]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_are_those_of_looking_at_every_pair(
            width in 1usize..12, bits in proptest::collection::vec(any::<bool>(), 1..140),
        ) {
            let height = bits.len().div_ceil(width);
            let mut set = bits;
            set.resize(width * height, true);
            prop_assume!(set.contains(&false));
            for (n, found) in distances(&set, width).iter().enumerate() {
                let away = |m: &usize| {
                    ((n % width) as f64 - (m % width) as f64).hypot((n / width) as f64 - (m / width) as f64)
                };
                let dark = (0..set.len()).filter(|m| !set[*m]);
                let nearest = dark.map(|m| away(&m)).fold(f64::MAX, f64::min);
                prop_assert!((found - nearest).abs() < 1e-9, "{} {}", found, nearest);
            }
        }
    }

    #[test]
    fn the_hole_is_taken_and_not_the_scratch_or_the_snow_beside() {
        let mut data = vec![20.0f32; 60 * 60];
        for y in 0..60 {
            for x in 0..60 {
                let round = (x as f64 + 0.5 - 33.0).hypot(y as f64 + 0.5 - 27.0) < 7.0;
                let scratch = (10..13).contains(&x);
                if round || scratch {
                    data[y * 60 + x] = if round { 120.0 } else { 240.0 };
                }
            }
        }
        let grey = Grey { width: 60, height: 60, data, origin: [100, 200], factor: 1 };
        let at = hole(&grey, PixelPoint { x: 128.0, y: 231.0 }, 20.0, 1.0).expect("a hole");
        assert!((at.x - 133.0).hypot(at.y - 227.0) < 0.8, "{at:?}");
        let flat = Grey { data: (0..3600).map(|n| (n * 7919 % 13) as f32).collect(), ..grey };
        assert!(hole(&flat, PixelPoint { x: 128.0, y: 231.0 }, 20.0, 1.0).is_none());
    }
}
