//! A local-background fit, for marks that lie over the border of two grounds or were found only in part.
//!
//! One Gaussian over the whole ring takes a roof on one side and a garden on the other for one ground of enormous
//! variance, before which nothing stands out; and the larger a mark, the more kinds of ground it touches. Here the
//! ground under each pixel is the mean of the ring near it (normalised convolution: H. Knutsson and C.-F. Westin,
//! "Normalized and differential convolution", CVPR 1993), and only the scatter about that local mean is noise. A region
//! that colour found in part is first grown over the pixels that look more like its paint than like the ground beside
//! it.

use nalgebra::{Matrix3, Vector3};

use super::pixel_set::PixelSet;
use super::scene::{Scene, ground};

/// Each of the two box filters that make a local mean reaches this far.
const BOX_REACH: usize = 4;
/// The border of the paint, where it has to stand out, reaches this far outside it.
const BORDER_PX: usize = 3;
/// Growing over less than this share of the region changes nothing worth a fit.
const LEAST_GROWTH: f64 = 0.1;

/// Paint seen against the ground beside it.
pub(super) struct Local<'a> {
    scene: &'a Scene<'a>,
    plateau: Vector3<f64>,
    /// Of each pixel, sums of the ring's colours near it and their weight.
    sums: Vec<[f64; 4]>,
    /// Of the ground's scatter and the sensor's noise.
    inverse: Matrix3<f64>,
    /// Mahalanobis distance of the paint from the ground, the root mean square of its inverse along the border.
    pub contrast: f64,
}

impl<'a> Local<'a> {
    /// `None` without a ring of ground around the region.
    pub fn of(scene: &'a Scene<'a>, plateau: Vector3<f64>, ring: (usize, usize)) -> Option<Local<'a>> {
        let ring = scene.ring(ring);
        let mut sums = vec![[0.0; 4]; scene.width * scene.height];
        ring.for_each(|i| {
            let c = scene.colour(i);
            sums[i] = [c[0], c[1], c[2], 1.0];
        });
        for _ in 0..2 {
            boxed(&mut sums, scene.width);
        }
        let mut scatter: Vec<Vector3<f64>> = Vec::with_capacity(ring.count());
        ring.for_each(|i| scatter.extend(mean(&sums[i]).map(|mean| scene.colour(i) - mean)));
        // Sensor noise and JPEG: 3 levels, as in the first look.
        let noise = ground(&scatter)?.covariance + Matrix3::identity() * 9.0;
        let inverse = noise.cholesky()?.inverse();
        let mut local = Local { scene, plateau, sums, inverse, contrast: 0.0 };
        let (mut open, mut border) = (0.0, 0usize);
        scene.own.grown(BORDER_PX).minus(&scene.own).for_each(|i| {
            if let Some(ground) = mean(&local.sums[i]) {
                open += 1.0 / local.contrast2(&(plateau - ground)).1;
                border += 1;
            }
        });
        local.contrast = (border as f64 / open).sqrt();
        (border > 0).then_some(local)
    }

    /// The direction from ground to paint and the squared contrast of the two.
    fn contrast2(&self, step: &Vector3<f64>) -> (Vector3<f64>, f64) {
        let direction = self.inverse * step;
        // Ground of the paint's own colour: nothing can be seen there, and nothing may explode.
        (direction, direction.dot(step).max(4.0))
    }

    /// Share of paint in a pixel: 0 on the local ground, 1 on the plateau. Where no ground is near, 1 of paint and 0 of
    /// the rest.
    fn share(&self, i: usize) -> f64 {
        let Some(ground) = mean(&self.sums[i]) else { return f64::from(u8::from(self.scene.own.has(i))) };
        let (direction, contrast2) = self.contrast2(&(self.plateau - ground));
        direction.dot(&(self.scene.colour(i) - ground)) / contrast2
    }

    /// The same of all pixels.
    pub fn shares(&self) -> Vec<f64> {
        (0..self.sums.len()).map(|i| self.share(i)).collect()
    }

    /// Grows the region over the pixels connected to it that are more paint than ground.
    pub fn grow(&self) -> Growth {
        let scene = self.scene;
        if scene.own.at_edge() {
            return Growth::Whole;
        }
        let like = |i: usize| (0.5..1.5).contains(&self.share(i));
        let Some(grown) = scene.own.spread(&scene.valid, like, |front, _| !front.at_edge()) else {
            return Growth::Whole;
        };
        let before = scene.own.count();
        if grown.count() as f64 <= before as f64 * (1.0 + LEAST_GROWTH) {
            return Growth::Whole;
        }
        // Two regions of one mark grow into the same: the larger stands for it, of equals the first.
        let mut left = scene.other.and(&grown);
        while let Some(first) = left.first() {
            let piece = scene.other.piece(first);
            left = left.minus(&piece);
            let other = piece.count();
            if other > before || other == before && Some(first) < scene.own.first() {
                return Growth::Beaten;
            }
        }
        Growth::Grown(grown)
    }
}

/// Mean colour of the ring near a pixel; `None` when no ground is near.
fn mean(sum: &[f64; 4]) -> Option<Vector3<f64>> {
    (sum[3] > 1e-9).then(|| Vector3::new(sum[0], sum[1], sum[2]) / sum[3])
}

/// What a region is of its mark.
pub(super) enum Growth {
    /// About all of it, or nothing around it that could be told from it.
    Whole,
    /// A part: these pixels are the mark.
    Grown(PixelSet),
    /// A part that is smaller than another region of the same mark, which stands for it.
    Beaten,
}

/// Sums over squares of `2·BOX_REACH + 1`, clipped at the patch's edges.
fn boxed(values: &mut [[f64; 4]], width: usize) {
    let mut line = Vec::with_capacity(width);
    for row in values.chunks_exact_mut(width) {
        line.clear();
        line.extend_from_slice(row);
        let mut sum = [0.0; 4];
        line.iter().take(BOX_REACH).for_each(|value| add(&mut sum, value));
        for (k, out) in row.iter_mut().enumerate() {
            if let Some(value) = line.get(k + BOX_REACH) {
                add(&mut sum, value);
            }
            if k > BOX_REACH {
                subtract(&mut sum, &line[k - BOX_REACH - 1]);
            }
            *out = sum;
        }
    }
    // Down the columns a whole row at a time.
    let before = values.to_vec();
    let rows: Vec<&[[f64; 4]]> = before.chunks_exact(width).collect();
    let mut sums = vec![[0.0; 4]; width];
    for row in rows.iter().take(BOX_REACH) {
        sums.iter_mut().zip(*row).for_each(|(sum, value)| add(sum, value));
    }
    for (k, out) in values.chunks_exact_mut(width).enumerate() {
        if let Some(row) = rows.get(k + BOX_REACH) {
            sums.iter_mut().zip(*row).for_each(|(sum, value)| add(sum, value));
        }
        if k > BOX_REACH {
            let row = rows[k - BOX_REACH - 1];
            sums.iter_mut().zip(row).for_each(|(sum, value)| subtract(sum, value));
        }
        out.copy_from_slice(&sums);
    }
}

fn add(sum: &mut [f64; 4], value: &[f64; 4]) {
    (0..4).for_each(|c| sum[c] += value[c]);
}

fn subtract(sum: &mut [f64; 4], value: &[f64; 4]) {
    (0..4).for_each(|c| sum[c] -= value[c]);
}
