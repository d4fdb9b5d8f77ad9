//! How far the parts of a mark disagree about its centre.
//!
//! What the drawn mark does not tell (a scratch over an edge, a dot that is larger than drawn) lies beside the normal
//! equations: pixels off by more than noise get no weight, and what is left agrees with itself wherever it lies. So
//! each of eight sectors is asked how far it would pull the centre if its pixels were believed, those without weight
//! too. The sum of their squares is the covariance of sums that are alike within a sector and independent between them
//! (K.-Y. Liang and S. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika, 1986).

use nalgebra::DMatrix;

use super::{Fit, Scale};

const SECTORS: usize = 8;
/// Tangent of half a sector: the first lies about the scan's right, where marks have lines.
const HALF_SECTOR: f32 = 0.414_213_57;
/// No pixel pulls by more standard deviations than this.
const MOST_PULL: f32 = 3.0;

impl<const N: usize, const M: usize> Fit<N, M> {
    /// Var x, cov xy, var y of the centre, px², by how far the sectors pull it apart and all together aside, after the
    /// last round, whose normal equations have this inverse.
    pub fn disagreement(&self, inverse: &DMatrix<f64>) -> [f64; 3] {
        let scale = Scale::of(self.sigma, self.unlike);
        let swell = self.swell_px();
        let mut pulls = [[0.0f64; 2]; SECTORS];
        for k in 0..self.shaped.grey.len() {
            let part = self.shaped.part::<1>(k);
            let [gain] = part.gain::<M>(&self.levels);
            let [changes] = part.changes([gain]);
            let most = MOST_PULL * self.sigma * (1.0 + scale.of_change * changes).sqrt();
            let pull = (self.shaped.residuals[k] - swell * changes.sqrt()).clamp(-most, most);
            let sum = &mut pulls[sector(part.from[0][0], part.from[1][0])];
            for d in 0..2 {
                sum[d] -= f64::from(pull * gain * part.mark[1 + d][0]);
            }
        }
        let all = [0, 1].map(|d| pulls.iter().map(|p| p[d]).sum::<f64>());
        let mut covariance = [0.0; 3];
        for pull in pulls.iter().chain([&all]) {
            let [x, y] = [0, 1].map(|d| inverse[(M + d, M)] * pull[0] + inverse[(M + d, M + 1)] * pull[1]);
            [x * x, x * y, y * y].into_iter().zip(&mut covariance).for_each(|(v, sum)| *sum += v);
        }
        covariance
    }

    /// How far all edges lie further out than drawn, pixels: marks that are evenly wider pull to no side.
    pub fn swell_px(&self) -> f32 {
        let scale = Scale::of(self.sigma, self.unlike);
        let (mut sum, mut weight) = (0.0f32, 0.0f32);
        for k in 0..self.shaped.grey.len() {
            let part = self.shaped.part::<1>(k);
            let [changes] = part.changes(part.gain::<M>(&self.levels));
            let [w] = super::weights([self.shaped.residuals[k]], [changes], scale);
            sum += w * self.shaped.residuals[k] * changes.sqrt();
            weight += w * changes;
        }
        if weight > 0.0 { sum / weight } else { 0.0 }
    }
}

/// Of a place `right` and `down` from the centre.
fn sector(right: f32, down: f32) -> usize {
    let (x, y) = (right.abs(), down.abs());
    let (left, above) = (usize::from(right < 0.0), usize::from(down < 0.0));
    if y < HALF_SECTOR * x {
        left
    } else if x < HALF_SECTOR * y {
        2 + above
    } else {
        4 + 2 * above + left
    }
}
