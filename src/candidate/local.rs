//! A third look, for marks that lie over the border of two grounds or were found only in part.
//!
//! One Gaussian over the whole ring takes a roof on one side and a garden on the other for one ground of enormous variance,
//! before which nothing stands out; and the larger a mark, the more kinds of ground it touches. Here the ground under each
//! pixel is the mean of the ring near it (normalised convolution: H. Knutsson and C.-F. Westin, "Normalized and
//! differential convolution", CVPR 1993), and only the scatter about that local mean is noise. A region that colour found in
//! part is first grown over the pixels that look more like its paint than like the ground beside it.

use nalgebra::{Matrix3, Vector3};

use super::patch::{Scene, flood, ground};

/// Each of the two box filters that make a local mean reaches this far.
const BOX_REACH: usize = 4;
/// Growing over less than this share of the region changes nothing worth a fit.
const LEAST_GROWTH: f64 = 0.1;

/// Paint seen against the ground beside it.
pub(super) struct Local {
    /// Share of paint in each pixel: 0 on the local ground, 1 on the plateau. Zero where no ground is near.
    pub shares: Vec<f64>,
    /// Mahalanobis distance of the paint from the ground, the root mean square of its inverse along the border.
    pub contrast: f64,
}

/// Measures the shares against local ground; `None` without a ring of ground around the region.
pub(super) fn local_shares(scene: &Scene<'_>, plateau: Vector3<f64>, ring: (u8, u8)) -> Option<Local> {
    let count = scene.own.len();
    let in_ring: Vec<bool> = (0..count).map(|i| scene.is_ground(i, ring.0, ring.1)).collect();
    let colours: Vec<Vector3<f64>> = (0..count).map(|i| scene.colour(i)).collect();
    let mut sums: Vec<[f64; 4]> = (0..count)
        .map(|i| {
            let c = colours[i];
            if in_ring[i] { [c[0], c[1], c[2], 1.0] } else { [0.0; 4] }
        })
        .collect();
    for _ in 0..2 {
        boxed(&mut sums, scene.width, scene.height);
    }
    let near = |i: usize| (sums[i][3] > 1e-9).then(|| Vector3::new(sums[i][0], sums[i][1], sums[i][2]) / sums[i][3]);
    let scatter: Vec<Vector3<f64>> =
        (0..count).filter(|&i| in_ring[i]).filter_map(|i| Some(colours[i] - near(i)?)).collect();
    // Sensor noise and JPEG: 3 levels, as in the first look.
    let noise = ground(&scatter)?.covariance + Matrix3::identity() * 9.0;
    let inverse = noise.cholesky()?.inverse();
    let (mut open, mut border) = (0.0, 0usize);
    let shares = (0..count)
        .map(|i| {
            let Some(ground) = near(i) else { return f64::from(u8::from(scene.own[i])) };
            let step = plateau - ground;
            let direction = inverse * step;
            // Ground of the paint's own colour: nothing can be seen there, and nothing may explode.
            let contrast2 = direction.dot(&step).max(4.0);
            if (1..=3).contains(&scene.outside_px[i]) {
                open += 1.0 / contrast2;
                border += 1;
            }
            direction.dot(&(colours[i] - ground)) / contrast2
        })
        .collect();
    (border > 0).then(|| Local { shares, contrast: (border as f64 / open).sqrt() })
}

/// What a region is of its mark.
pub(super) enum Growth {
    /// About all of it, or nothing around it that could be told from it.
    Whole,
    /// A part: these pixels are the mark.
    Grown(Vec<bool>),
    /// A part that is smaller than another region of the same mark, which stands for it.
    Beaten,
}

/// Grows the region over the pixels connected to it that are more paint than ground.
pub(super) fn grow(scene: &Scene<'_>, shares: &[f64]) -> Growth {
    let (width, height) = (scene.width, scene.height);
    let mask: Vec<bool> =
        (0..scene.own.len()).map(|i| scene.own[i] || scene.patch.valid[i] && (0.5..1.5).contains(&shares[i])).collect();
    let Some(start) = scene.own.iter().position(|&own| own) else { return Growth::Whole };
    let grown = flood(&mask, width, height, start);
    let area = |set: &[bool]| set.iter().filter(|&&b| b).count();
    let before = area(&scene.own);
    let at_edge = |i: usize| {
        let (x, y) = (i % width, i / width);
        x == 0 || y == 0 || x + 1 == width || y + 1 == height
    };
    if area(&grown) as f64 <= before as f64 * (1.0 + LEAST_GROWTH) || (0..grown.len()).any(|i| grown[i] && at_edge(i)) {
        return Growth::Whole;
    }
    // Two regions of one mark grow into the same: the larger stands for it, of equals the first.
    let mut left: Vec<bool> = scene.other.iter().zip(&grown).map(|(o, g)| *o && *g).collect();
    while let Some(first) = left.iter().position(|&b| b) {
        let piece = flood(&scene.other, width, height, first);
        left.iter_mut().zip(&piece).for_each(|(l, &p)| *l &= !p);
        let other = area(&piece);
        if other > before || other == before && first < start {
            return Growth::Beaten;
        }
    }
    Growth::Grown(grown)
}

/// Sums over squares of `2·BOX_REACH + 1`, clipped at the patch's edges.
fn boxed(values: &mut [[f64; 4]], width: usize, height: usize) {
    let mut line = Vec::new();
    for y in 0..height {
        running(values, y * width, 1, width, &mut line);
    }
    for x in 0..width {
        running(values, x, width, height, &mut line);
    }
}

fn running(values: &mut [[f64; 4]], first: usize, step: usize, count: usize, line: &mut Vec<[f64; 4]>) {
    line.clear();
    line.extend((0..count).map(|k| values[first + k * step]));
    let mut sum = [0.0; 4];
    for value in line.iter().take(BOX_REACH) {
        (0..4).for_each(|c| sum[c] += value[c]);
    }
    for k in 0..count {
        if let Some(value) = line.get(k + BOX_REACH) {
            (0..4).for_each(|c| sum[c] += value[c]);
        }
        if k > BOX_REACH {
            (0..4).for_each(|c| sum[c] -= line[k - BOX_REACH - 1][c]);
        }
        values[first + k * step] = sum;
    }
}
