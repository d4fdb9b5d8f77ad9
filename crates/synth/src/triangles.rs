//! The two triangles of an hourglass, blurred.

use std::f64::consts::FRAC_1_SQRT_2;

use super::quadrature::GAUSS;
use autoref_raster::normal::erf;

/// Further away than so many σ the blur carries nothing: erf is 1 within 7e-6 there.
const REACH: f64 = 4.5;
/// Length of a panel of the quadrature in σ: the four-point rule errs by about 1e-6 in it.
const PANEL: f64 = 1.25;

/// Two triangles in the mark's frame, tip to tip in the origin, 90° at the tips, their axes along v.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triangles {
    /// Of each; their bases are twice as long.
    pub height: f64,
}

impl Triangles {
    pub(super) fn corners(self) -> [[(f64, f64); 3]; 2] {
        let h = self.height;
        [[(0.0, 0.0), (h, h), (-h, h)], [(0.0, 0.0), (-h, -h), (h, -h)]]
    }

    /// The blurred triangles at (u, v), where their blurred plate, the square around both, is `plate`.
    ///
    /// Along u a row of a triangle is a difference of error functions; the rows are summed under the Gaussian along v.
    pub(super) fn blurred(self, u: f64, v: f64, sigma: f64, plate: f64) -> f64 {
        // Far from the triangles' legs, which are the plate's diagonals, there is nothing of them or all of the plate.
        let inside = (v.abs() - u.abs()) * FRAC_1_SQRT_2;
        if inside.abs() > REACH * sigma {
            return if inside > 0.0 { plate } else { 0.0 };
        }
        let k = FRAC_1_SQRT_2 / sigma;
        // Far from the plate's edge the legs are two lines at right angles.
        if u.abs().max(v.abs()) < self.height - REACH * sigma {
            let leg = |along: f64| erf(along * FRAC_1_SQRT_2 * k);
            return 0.5 * (1.0 + leg(v - u) * leg(v + u));
        }
        let row = |t: f64| {
            let d = (t - v) / sigma;
            (-0.5 * d * d).exp() * 0.5 * (erf((t.abs() - u) * k) + erf((t.abs() + u) * k))
        };
        let sum = |low: f64, high: f64| {
            if low >= high {
                return 0.0;
            }
            let panels = ((high - low) / (PANEL * sigma)).ceil();
            let step = (high - low) / panels;
            let nodes = (0..panels as usize).flat_map(|i| GAUSS.map(|(g, w)| w * row(low + (i as f64 + g) * step)));
            nodes.sum::<f64>() * step
        };
        let (low, high) = ((v - REACH * sigma).max(-self.height), (v + REACH * sigma).min(self.height));
        // The rows have a kink at the tips.
        (sum(low, high.min(0.0)) + sum(low.max(0.0), high)) / (sigma * std::f64::consts::TAU.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use crate::Shape;
    use crate::shape::Figure;

    /// Share of the second colour in what is painted of the pixel at (dx, dy) from the centre.
    fn second_share(figure: &Figure, dx: f64, dy: f64) -> f64 {
        let (all, second) = figure.coverage(dx, dy);
        second / all
    }

    #[test]
    fn quarters_have_their_colours_and_the_saddle_lies_in_the_centre() {
        for (size, turn, blur) in [(12.0, 0.0, 0.0), (14.0, 0.4, 0.9), (24.0, 2.1, 1.6), (30.0, -1.0, 0.3)] {
            let figure = Figure::new(Shape::Hourglass, size, turn, blur);
            let (sin, cos) = f64::sin_cos(turn);
            let turned = |u: f64, v: f64| (cos * u - sin * v, sin * u + cos * v);
            // Along v lie the triangles, along u the plate.
            for (u, v, expected) in [(0.0, 0.3, 1.0), (0.0, -0.3, 1.0), (0.3, 0.0, 0.0), (-0.3, 0.0, 0.0)] {
                let (dx, dy) = turned(u * size, v * size);
                let share = second_share(&figure, dx, dy);
                assert!((share - expected).abs() < 0.06, "{size} {turn} {blur}, {u} {v}: {share}");
            }
            // Grey in the centre, lighter both ways along v, darker both ways along u, alike on opposite sides.
            let centre = second_share(&figure, 0.0, 0.0);
            assert!((centre - 0.5).abs() < 1e-4, "{size} {turn} {blur}: {centre}");
            for step in [0.2, 0.5, 1.0] {
                let [north, south] = [step, -step].map(|v| turned(0.0, v)).map(|(x, y)| second_share(&figure, x, y));
                let [east, west] = [step, -step].map(|u| turned(u, 0.0)).map(|(x, y)| second_share(&figure, x, y));
                assert!(north > centre && east < centre, "{size} {turn} {blur}, {step}: {north} {east}");
                let uneven = (north - south).abs().max((east - west).abs());
                assert!(uneven < 1e-4 && (north + east - 1.0).abs() < 1e-4, "{size} {turn} {blur}, {step}: {uneven}");
            }
        }
    }

    #[test]
    fn blur_equals_brute_force() {
        // The second colour against the sharp figure sampled 10 × 10 a pixel and weighted with the Gaussian.
        for (size, turn, sigma) in [(6.0, 0.4, 0.8), (9.0, 1.9, 0.5)] {
            let blurred = Figure::new(Shape::Hourglass, size, turn, sigma);
            let sharp = Figure::new(Shape::Hourglass, size, turn, 0.0);
            for (dx, dy) in [(0.1, -0.2), (1.4, 1.1), (2.9, 2.2), (-3.7, 1.0), (0.3, 4.4), (-2.0, -3.1)] {
                let (mut sum, mut weight) = (0.0, 0.0);
                let n = (4.0 * sigma * 10.0) as i32;
                for (oy, ox) in (-n..=n).flat_map(|j| (-n..=n).map(move |i| (f64::from(j) / 10.0, f64::from(i) / 10.0)))
                {
                    let w = (-(ox * ox + oy * oy) / (2.0 * sigma * sigma)).exp();
                    sum += w * sharp.coverage(dx + ox, dy + oy).1;
                    weight += w;
                }
                let got = blurred.coverage(dx, dy).1;
                assert!((got - sum / weight).abs() < 3e-4, "{size} at {dx},{dy}: {got} {}", sum / weight);
            }
        }
    }
}
