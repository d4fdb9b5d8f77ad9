//! A picture of shares of paint that is turned by half a turn onto itself: the middle about which it meets itself best,
//! and how well that middle is known.

use autoref_raster::bilinear::by_weights;
use nalgebra::{Matrix2, Vector2};

/// The middle moves no farther from where it was looked for.
pub(super) const MOST_MOVED_PX: f64 = 2.0;
/// With less in common a figure is none, whatever is left out.
const LEAST_WITH_HOLES: f64 = 0.7;
/// Correlation with itself from which on an outline counts as even.
pub(super) const SURELY_ALIKE: f64 = 0.95;
/// Noise of neighbouring pixels goes together.
const TOGETHER: f64 = 4.0;
/// A standard deviation of the middle is hardly less, pixels.
const LEAST_SIGMA_PX: f64 = 0.03;
const ROUNDS: usize = 8;

/// Shares of paint, pixel by pixel.
pub(super) struct Picture<'a> {
    pub shares: &'a [f64],
    pub width: usize,
    pub height: usize,
}

/// A picture that was turned by half a turn onto itself.
pub(super) struct Turned {
    pub middle: Vector2<f64>,
    pub correlation: f64,
    /// Of the difference of two shares of paint.
    pub mean_square: f64,
    /// Inverse of the normal equations of the middle.
    inverse: Matrix2<f64>,
}

impl Picture<'_> {
    /// Between the middles of four pixels; `None` outside.
    pub fn at(&self, p: Vector2<f64>) -> Option<f64> {
        let (x, y) = (p.x - 0.5, p.y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f64 && y < (self.height - 1) as f64) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (u, v) = (x - column as f64, y - row as f64);
        let s = |dx: usize, dy: usize| self.shares[(row + dy) * self.width + column + dx];
        Some(by_weights([[s(0, 0), s(1, 0)], [s(0, 1), s(1, 1)]], [u, v]))
    }

    /// The same with the slope: half the difference of the places a pixel ahead and a pixel behind.
    fn with_slope(&self, p: Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let (x, y) = (p.x - 0.5, p.y - 0.5);
        if !(x >= 1.0 && y >= 1.0 && x < (self.width - 2) as f64 && y < (self.height - 2) as f64) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (u, v) = (x - column as f64, y - row as f64);
        let first = (row - 1) * self.width + column - 1;
        // Between columns: of four rows of four.
        let rows: [[f64; 3]; 4] = std::array::from_fn(|dy| {
            let s = &self.shares[first + dy * self.width..][..4];
            std::array::from_fn(|dx| s[dx] * (1.0 - u) + s[dx + 1] * u)
        });
        let between = |dx: usize, dy: usize| rows[dy][dx] * (1.0 - v) + rows[dy + 1][dx] * v;
        let slope = Vector2::new(between(2, 1) - between(0, 1), between(1, 2) - between(1, 0)) / 2.0;
        Some((between(1, 1), slope))
    }

    /// Correlation of the shares at some places with those where the places come to lie.
    pub fn correlation(&self, places: &[Vector2<f64>], to: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Option<f64> {
        let pairs: Vec<(f64, f64)> =
            places.iter().map(|p| Some((self.at(*p)?, self.at(to(*p))?))).collect::<Option<_>>()?;
        let n = pairs.len() as f64;
        let (a, b) = (pairs.iter().map(|p| p.0).sum::<f64>() / n, pairs.iter().map(|p| p.1).sum::<f64>() / n);
        let sum = |of: fn(f64, f64) -> f64| pairs.iter().map(|p| of(p.0 - a, p.1 - b)).sum::<f64>();
        let scatter = (sum(|x, _| x * x) * sum(|_, y| y * y)).sqrt();
        (scatter > 0.0).then(|| sum(|x, y| x * y) / scatter)
    }

    /// Scatter of the sum by which what does not meet itself pulls at the middle. An irregular outline errs together
    /// over a part of an arm: places near each other are taken together, by a weight that falls to 0 (T. G. Conley,
    /// "GMM estimation with cross sectional dependence", 1999, equation 3.15, with a round cone for a weight).
    fn pull(&self, places: &[Vector2<f64>], middle: Vector2<f64>) -> Option<Matrix2<f64>> {
        /// The weight reaches so far, as a share of the figure's half width.
        const REACH: f64 = 0.6;
        let half = places.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max);
        let pulls: Vec<(Vector2<f64>, Vector2<f64>)> = places
            .iter()
            .map(|p| {
                let (there, slope) = self.with_slope(2.0 * middle - p)?;
                Some((*p, -2.0 * slope * (self.at(*p)? - there)))
            })
            .collect::<Option<_>>()?;
        let mut scatter = Matrix2::zeros();
        for (k, (p, pull)) in pulls.iter().enumerate() {
            let near = |other: &Vector2<f64>| (1.0 - (p - other).norm() / (REACH * half)).max(0.0);
            let beside = pulls[k + 1..].iter().map(|(other, pull)| pull * near(other)).sum::<Vector2<f64>>();
            scatter += pull * pull.transpose() + pull * beside.transpose() + beside * pull.transpose();
        }
        Some(scatter)
    }

    /// The middle about which the shares turn onto themselves, by Gauss and Newton from `middle`; `None` where they
    /// never do.
    pub fn turned_half(&self, places: &[Vector2<f64>], mut middle: Vector2<f64>) -> Option<Turned> {
        /// Near its middle a figure is alike already; most else is not, and the way to the middle is long.
        const LEAST_AT_START: f64 = 0.5;
        let start = middle;
        if self.correlation(places, |p| 2.0 * start - p)? < LEAST_AT_START {
            return None;
        }
        let mut normal = Matrix2::zeros();
        let mut square = 0.0;
        for _ in 0..ROUNDS {
            normal = Matrix2::zeros();
            square = 0.0;
            let mut right = Vector2::zeros();
            for p in places {
                let (there, slope) = self.with_slope(2.0 * middle - p)?;
                let left = self.at(*p)? - there;
                // Moving the middle by one moves the turned place by two.
                let slope = -2.0 * slope;
                normal += slope * slope.transpose();
                right -= slope * left;
                square += left * left;
            }
            let step = normal.cholesky()?.solve(&right);
            middle += step;
            if (middle - start).norm() > MOST_MOVED_PX {
                return None;
            }
            if step.norm() < 1e-4 {
                break;
            }
        }
        let correlation = self.correlation(places, |p| 2.0 * middle - p)?;
        if correlation < LEAST_WITH_HOLES {
            return None;
        }
        let inverse = normal.try_inverse()?;
        Some(Turned { middle, correlation, mean_square: square / places.len() as f64, inverse })
    }

    /// Covariance of the middle about which these places were turned, px².
    pub fn covariance_px2(&self, turned: &Turned, places: &[Vector2<f64>]) -> Option<[f64; 3]> {
        let Turned { middle, correlation, mean_square, inverse } = *turned;
        // Each two places are compared twice.
        let by_noise = inverse * (2.0 * TOGETHER * mean_square);
        // What both halves of an irregular outline have in common pulls too, and is not seen: of crosses that were
        // drawn with wavy arms three times what is.
        let irregular = ((1.0 - correlation) / (1.0 - SURELY_ALIKE)).min(1.0);
        let by_outline = inverse * (2.0 * (1.0 + 3.0 * irregular) * self.pull(places, middle)?) * inverse;
        let inverse = if by_outline.trace() > by_noise.trace() { by_outline } else { by_noise };
        let least = LEAST_SIGMA_PX * LEAST_SIGMA_PX;
        Some([inverse[(0, 0)] + least, inverse[(0, 1)], inverse[(1, 1)] + least])
    }
}
