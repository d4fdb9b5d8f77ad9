//! Corners of the thresholded mark, and which of them are its jaws.

use super::super::template::Linear;
use super::super::types::MarkKind;
use super::to_scan;

/// Weight of the squared trace in the corner's strength, and blur of the gradients' products, pixels of the scans
/// of 2017.
const TRACE: f32 = 0.05;
const WINDOW_PX: f64 = 2.0;
/// Corners weaker than this share of the strongest are none, no two are nearer than this, and there are at most so
/// many.
const LEAST: f32 = 0.05;
const APART_PX: f64 = 10.0;
const MOST: usize = 100;
/// How far the distance of the outer teeth may be from that of the drawn mark, relative.
const BASE: f64 = 0.12;

/// Places of corners in an image of 0 and 1 that was blurred, in values from the outer corner of the first.
///
/// C. Harris and M. Stephens, "A combined corner and edge detector", Alvey Vision Conference, 1988: the determinant of
/// the gradients' second moments less a share of their squared trace. `unit` is pixels per pixel of the scans of 2017.
pub(super) fn corners(image: &[f32], width: usize, unit: f64) -> Vec<[f64; 2]> {
    let height = image.len() / width.max(1);
    if width < 3 || height < 3 {
        return vec![];
    }
    let mut products = [0, 1, 2].map(|_| vec![0.0f32; image.len()]);
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let n = y * width + x;
            let (gx, gy) = (image[n + 1] - image[n - 1], image[n + width] - image[n - width]);
            (products[0][n], products[1][n], products[2][n]) = (gx * gx, gx * gy, gy * gy);
        }
    }
    for p in &mut products {
        super::super::window::blur(p, width, height, (WINDOW_PX * unit).max(1.0));
    }
    let strength: Vec<f32> = (0..image.len())
        .map(|n| {
            let (a, b, c) = (products[0][n], products[1][n], products[2][n]);
            a * c - b * b - TRACE * (a + c) * (a + c)
        })
        .collect();
    let limit = LEAST * strength.iter().copied().fold(0.0, f32::max);
    let mut maxima: Vec<usize> = vec![];
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let n = y * width + x;
            let around = (0..9).map(|k| strength[n + k / 3 * width + k % 3 - width - 1]);
            if strength[n] > limit && around.into_iter().all(|s| s <= strength[n]) {
                maxima.push(n);
            }
        }
    }
    maxima.sort_by(|a, b| strength[*b].total_cmp(&strength[*a]));
    let mut kept: Vec<[f64; 2]> = vec![];
    for n in maxima {
        let at = [(n % width) as f64 + 0.5, (n / width) as f64 + 0.5];
        if kept.len() < MOST && kept.iter().all(|k| (k[0] - at[0]).hypot(k[1] - at[1]) >= APART_PX * unit) {
            kept.push(at);
        }
    }
    kept
}

/// A point as the product with a baseline: (Re, Im) of scale · e^(iθ).
type Ratio = [f64; 2];

fn times(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

fn ratio(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> Ratio {
    let (d, base) = ([point[0] - from[0], point[1] - from[1]], [to[0] - from[0], to[1] - from[1]]);
    let square = base[0] * base[0] + base[1] * base[1];
    let [re, im] = times(d, [base[0], -base[1]]);
    [re / square, im / square]
}

/// Table 8.1: the jaws of one side and the reference point, by angle and scale against the line between the outermost
/// jaws.
pub(super) struct Constellation {
    /// Seen from the left outermost jaw towards the right one, and from the right towards the left: two jaws and the
    /// reference point each.
    sides: [[Ratio; 3]; 2],
    base_px: f64,
}

impl Constellation {
    /// Of a drawn mark under `linear`: on each side the outer corner of the outer tooth, the corner at the bottom of
    /// the gap beside it, and that of the middle tooth: corners all at the teeth's tops would lie on a line, as those
    /// at their bottoms do.
    ///
    /// # Panics
    /// For a mark that is not three-toothed, which the caller has refused.
    pub(super) fn of(kind: &MarkKind, linear: Linear) -> Constellation {
        let MarkKind::ThreeTooth {
            width_mm, outer_height_mm, middle_height_mm, middle_width_mm, gap_mm, base_mm, ..
        } = kind
        else {
            panic!("only three-toothed marks have jaws");
        };
        // The teeth lean: see `shape::tone`.
        let lean = |v: f64| 0.12 * (v - base_mm);
        let (outer, middle) = (lean(*outer_height_mm), lean(*middle_height_mm));
        let jaws = [
            [0.5 * width_mm - outer, *outer_height_mm],
            [0.5 * middle_width_mm + gap_mm, *base_mm],
            [0.5 * middle_width_mm - middle, *middle_height_mm],
        ];
        let place = |side: f64, [u, v]: [f64; 2]| to_scan(linear, side * u, v);
        let outermost = [-1.0, 1.0].map(|side| place(side, jaws[0]));
        let side = |s: usize| {
            let (from, to) = (outermost[s], outermost[1 - s]);
            let sign = 2.0 * s as f64 - 1.0;
            [ratio(place(sign, jaws[1]), from, to), ratio(place(sign, jaws[2]), from, to), ratio([0.0; 2], from, to)]
        };
        let base_px = (outermost[1][0] - outermost[0][0]).hypot(outermost[1][1] - outermost[0][1]);
        Constellation { sides: [side(0), side(1)], base_px }
    }

    /// Equations 8.10 to 8.14: of all pairs of points the one whose jaws lie nearest to other points says where the
    /// reference point is. `None` when no pair is as far apart as the outermost jaws.
    pub(super) fn find(&self, points: &[[f64; 2]]) -> Option<[f64; 2]> {
        let mut best: Option<(f64, [f64; 2])> = None;
        for left in points {
            for right in points {
                let length = (right[0] - left[0]).hypot(right[1] - left[1]);
                if (length / self.base_px - 1.0).abs() > BASE {
                    continue;
                }
                let of = |from: &[f64; 2], to: &[f64; 2], z: Ratio| {
                    let d = times([to[0] - from[0], to[1] - from[1]], z);
                    [from[0] + d[0], from[1] + d[1]]
                };
                let ends = [(left, right), (right, left)];
                let error: f64 = (0..4)
                    .map(|k| {
                        let (from, to) = ends[k / 2];
                        let jaw = of(from, to, self.sides[k / 2][k % 2]);
                        points.iter().map(|p| (p[0] - jaw[0]).hypot(p[1] - jaw[1])).fold(f64::MAX, f64::min)
                    })
                    .sum();
                if best.is_none_or(|b| error < b.0) {
                    let at = [0, 1].map(|s| of(ends[s].0, ends[s].1, self.sides[s][2]));
                    best = Some((error, [0.5 * (at[0][0] + at[1][0]), 0.5 * (at[0][1] + at[1][1])]));
                }
            }
        }
        best.map(|b| b.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load_camera;

    #[test]
    fn a_turned_constellation_is_found_among_other_points() {
        let kind = load_camera("svalbard-zeiss-1936").expect("built in").marks[0].kind.clone();
        let of = |deg: f64| {
            let (s, c) = f64::to_radians(deg).sin_cos();
            [50.0 * c, 50.0 * s, 50.0 * s, -50.0 * c]
        };
        let trained = Constellation::of(&kind, of(0.0));
        let turned = of(3.0);
        let jaws = [[2.144, 2.0], [1.2, 0.7], [0.43, 1.7]];
        let mut points: Vec<[f64; 2]> = [-1.0, 1.0]
            .iter()
            .flat_map(|side| jaws.map(|[u, v]| to_scan(turned, side * u, v)))
            .map(|p| [p[0] + 300.0, p[1] + 200.0])
            .collect();
        points.extend((0..20).map(|k| [f64::from(k * 37 % 600), f64::from(k * 91 % 400)]));
        let at = trained.find(&points).expect("found");
        assert!((at[0] - 300.0).hypot(at[1] - 200.0) < 1.0, "{at:?}");
        assert!(trained.find(&points[..1]).is_none());
    }

    #[test]
    fn a_square_has_four_corners() {
        let mut image: Vec<f32> =
            (0..80 * 80).map(|n| f32::from((20..60).contains(&(n % 80)) && (20..60).contains(&(n / 80)))).collect();
        crate::window::blur(&mut image, 80, 80, 1.1);
        let found = corners(&image, 80, 1.0);
        assert_eq!(found.len(), 4);
        for want in [[20.0, 20.0], [60.0, 20.0], [20.0, 60.0], [60.0, 60.0]] {
            assert!(found.iter().any(|p| (p[0] - want[0]).hypot(p[1] - want[1]) < 3.0), "{want:?} in {found:?}");
        }
    }
}
