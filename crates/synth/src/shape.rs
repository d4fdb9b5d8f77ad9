//! How much of each pixel a mark covers, exactly enough that the centroid of the picture is the stated centre.
//!
//! A camera blurs with something close to an isotropic Gaussian and integrates over square pixels. All angular shapes
//! here but the hourglass are sums of rectangles in the mark's own frame, where the Gaussian still is separable, so the
//! blurred shape is a sum of products of error functions; the hourglass's triangles are summed along one axis by
//! Gauss–Legendre quadrature. The pixel's square is integrated by Gauss–Legendre quadrature, which converges
//! fast on so smooth a function. Without blur the pixel coverage is the exact area of a clipped polygon. A disc goes
//! through a radial profile tabulated once per size.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use super::quadrature::GAUSS;
use super::triangles::Triangles;
use autoref_raster::normal::erf;
use serde::{Deserialize, Serialize};

/// What a mark looks like from above. "Size" is the side of the bounding square in the mark's own frame, or the
/// diameter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    #[default]
    Square,
    Disc,
    /// Two painted bars, each a quarter of the size wide.
    Cross,
    /// Two opposite quadrants in the second colour on a square in the first.
    Checker,
    /// A plate in the first colour with a cross in the second, its bars an eighth of the size wide.
    CrossPlate,
    /// A plate in the first colour with two triangles in the second: tip to tip in its centre, 90° at the tips, their
    /// bases two opposite sides of the plate.
    Hourglass,
    /// A bar twice as long as wide; only clutter looks like this.
    Bar,
}

/// Blur below this many pixels is none: the quadrature would need more points than the clipped polygon costs.
const NO_BLUR_PX: f64 = 0.05;

/// A rectangle in the mark's frame, centred or not: [u0, u1] × [v0, v1].
type Rect = [f64; 4];

/// A mark's figure, ready to be asked for coverage. Coordinates are relative to the mark's centre, in pixels.
#[derive(Clone, Debug)]
pub(crate) struct Figure {
    cos: f64,
    sin: f64,
    sigma: f64,
    /// Rectangles whose disjoint union is everything painted.
    all: Vec<Rect>,
    /// Those in the second colour; part of `all`.
    second: Vec<Rect>,
    /// What else is in the second colour.
    triangles: Option<Triangles>,
    /// For a disc: radius and blurred profile.
    disc: Option<(f64, Profile)>,
    /// Half the size.
    half: f64,
    reach: f64,
}

impl Figure {
    /// * `size_px`: side or diameter, > 0.
    /// * `rotation_rad`: of the mark's u axis from the image's x axis towards its y axis.
    /// * `blur_px`: σ of the Gaussian; below 0.05 none.
    pub(crate) fn new(shape: Shape, size_px: f64, rotation_rad: f64, blur_px: f64) -> Self {
        let sigma = if blur_px < NO_BLUR_PX { 0.0 } else { blur_px };
        let h = size_px / 2.0;
        let bars = |half_width: f64| {
            let b = half_width;
            vec![[-h, h, -b, b], [-b, b, -h, -b], [-b, b, b, h]]
        };
        let (all, second) = match shape {
            Shape::Square => (vec![[-h, h, -h, h]], vec![]),
            Shape::Bar => (vec![[-h, h, -h / 2.0, h / 2.0]], vec![]),
            Shape::Cross => (bars(h / 4.0), vec![]),
            Shape::Checker => (vec![[-h, h, -h, h]], vec![[-h, 0.0, -h, 0.0], [0.0, h, 0.0, h]]),
            Shape::CrossPlate => (vec![[-h, h, -h, h]], bars(h / 8.0)),
            Shape::Hourglass => (vec![[-h, h, -h, h]], vec![]),
            Shape::Disc => (vec![], vec![]),
        };
        let disc = (shape == Shape::Disc).then(|| (h, Profile::of_disc(h, sigma)));
        let triangles = (shape == Shape::Hourglass).then_some(Triangles { height: h });
        let corner = if shape == Shape::Disc { h } else { h * std::f64::consts::SQRT_2 };
        let (sin, cos) = rotation_rad.sin_cos();
        Figure { cos, sin, sigma, all, second, triangles, disc, half: h, reach: corner + 5.0 * sigma + 1.0 }
    }

    /// Nothing is covered further than this from the centre, in pixels.
    pub(crate) fn reach(&self) -> f64 {
        self.reach
    }

    /// Shares (0–1) of the unit pixel whose centre is at (dx, dy) from the mark's centre that are painted at all, and
    /// painted in the second colour.
    pub(crate) fn coverage(&self, dx: f64, dy: f64) -> (f64, f64) {
        let (u, v) = (self.cos * dx + self.sin * dy, self.cos * dy - self.sin * dx);
        let far = self.half + 5.0 * self.sigma + 0.75;
        if u.abs() > far || v.abs() > far {
            return (0.0, 0.0);
        }
        if self.sigma == 0.0 {
            return self.sharp(dx, dy);
        }
        // Two panels per blur width keep the quadrature's error below 1e-6 of a pixel.
        let panels = (0.6 / self.sigma).ceil().max(1.0) as usize;
        let h = 1.0 / panels as f64;
        let (mut all, mut second) = (0.0, 0.0);
        for py in 0..panels {
            for px in 0..panels {
                for (gy, wy) in GAUSS {
                    for (gx, wx) in GAUSS {
                        let x = dx - 0.5 + (px as f64 + gx) * h;
                        let y = dy - 0.5 + (py as f64 + gy) * h;
                        let (a, b) = self.blurred(x, y);
                        all += wx * wy * a;
                        second += wx * wy * b;
                    }
                }
            }
        }
        (all * h * h, second * h * h)
    }

    /// Places spread evenly over what is painted, without blur, relative to the centre in the image's axes.
    pub(crate) fn places(&self) -> Vec<(f64, f64)> {
        let n = 40;
        let mut found = vec![];
        for j in 0..n {
            for i in 0..n {
                let at = |k: i32| self.half * (2.0 * (f64::from(k) + 0.5) / f64::from(n) - 1.0);
                let (u, v) = (at(i), at(j));
                let painted = match &self.disc {
                    Some((radius, _)) => u.hypot(v) <= *radius,
                    None => self.all.iter().any(|r| (r[0]..=r[1]).contains(&u) && (r[2]..=r[3]).contains(&v)),
                };
                if painted {
                    found.push((self.cos * u - self.sin * v, self.sin * u + self.cos * v));
                }
            }
        }
        found
    }

    /// The blurred figure at a point.
    fn blurred(&self, x: f64, y: f64) -> (f64, f64) {
        if let Some((_, profile)) = &self.disc {
            return (profile.at(x.hypot(y)), 0.0);
        }
        let (u, v) = (self.cos * x + self.sin * y, self.cos * y - self.sin * x);
        let k = FRAC_1_SQRT_2 / self.sigma;
        let side = |low: f64, high: f64, t: f64| 0.5 * (erf((high - t) * k) - erf((low - t) * k));
        let sum = |rects: &[Rect]| rects.iter().map(|r| side(r[0], r[1], u) * side(r[2], r[3], v)).sum();
        let all: f64 = sum(&self.all);
        let triangles = self.triangles.map_or(0.0, |t| t.blurred(u, v, self.sigma, all));
        (all, sum(&self.second) + triangles)
    }

    /// Exact areas of the unblurred figure in a pixel.
    fn sharp(&self, dx: f64, dy: f64) -> (f64, f64) {
        if let Some((radius, _)) = self.disc {
            // A polygon of 512 sides is smaller than its disc by 2.5e-5 and shares its centre.
            let polygon = (0..512).map(|i| {
                let (s, c) = (TAU * f64::from(i) / 512.0).sin_cos();
                (radius * c - dx, radius * s - dy)
            });
            return (clipped_area(polygon.collect()), 0.0);
        }
        let corner = |(u, v): (f64, f64)| (self.cos * u - self.sin * v - dx, self.sin * u + self.cos * v - dy);
        let area = |corners: &[(f64, f64)]| clipped_area(corners.iter().map(|&c| corner(c)).collect());
        let sum = |rects: &[Rect]| -> f64 {
            rects.iter().map(|&[u0, u1, v0, v1]| area(&[(u0, v0), (u1, v0), (u1, v1), (u0, v1)])).sum()
        };
        let triangles: f64 = self.triangles.map_or(0.0, |t| t.corners().iter().map(|c| area(c)).sum());
        (sum(&self.all), sum(&self.second) + triangles)
    }
}

/// Area of a convex polygon within the unit square about the origin (I. Sutherland and G. Hodgman, "Reentrant polygon
/// clipping", CACM 1974; then the shoelace formula).
fn clipped_area(mut polygon: Vec<(f64, f64)>) -> f64 {
    let planes: [fn((f64, f64)) -> f64; 4] = [|p| 0.5 - p.0, |p| 0.5 + p.0, |p| 0.5 - p.1, |p| 0.5 + p.1];
    for inside in planes {
        let mut kept = Vec::with_capacity(polygon.len() + 2);
        for (i, &p) in polygon.iter().enumerate() {
            let q = polygon[(i + 1) % polygon.len()];
            let (dp, dq) = (inside(p), inside(q));
            if dp >= 0.0 {
                kept.push(p);
            }
            if (dp >= 0.0) != (dq >= 0.0) {
                let t = dp / (dp - dq);
                kept.push((p.0 + t * (q.0 - p.0), p.1 + t * (q.1 - p.1)));
            }
        }
        polygon = kept;
    }
    let twice: f64 = polygon.iter().zip(polygon.iter().cycle().skip(1)).map(|(p, q)| p.0 * q.1 - q.0 * p.1).sum();
    (twice / 2.0).abs()
}

/// A blurred disc as a function of the distance from its centre.
#[derive(Clone, Debug)]
struct Profile {
    step: f64,
    values: Vec<f64>,
}

impl Profile {
    /// Convolving the disc with a Gaussian: along each chord the integral is a difference of error functions, across
    /// them it is summed (substituting v = R·sin t, which keeps the ends smooth).
    fn of_disc(radius: f64, sigma: f64) -> Self {
        if sigma == 0.0 {
            return Profile { step: 1.0, values: vec![] };
        }
        let step = (sigma / 24.0).min(0.05);
        let n = ((radius + 6.0 * sigma) / step).ceil() as usize + 3;
        let k = FRAC_1_SQRT_2 / sigma;
        let chords = ((16.0 * radius / sigma) as usize).clamp(64, 4096);
        let chords: Vec<(f64, f64)> = (0..chords)
            .map(|j| {
                let t = PI * ((j as f64 + 0.5) / chords as f64 - 0.5);
                let half = radius * t.cos();
                (radius * t.sin(), half * erf(half * k) * PI / (chords as f64 * sigma * TAU.sqrt()))
            })
            .collect();
        let values = (0..n)
            .map(|i| {
                let r = i as f64 * step;
                // Chords perpendicular to the line to the point, so only this factor changes with r.
                chords.iter().map(|(v, along)| along * (-(v - r) * (v - r) / (2.0 * sigma * sigma)).exp()).sum()
            })
            .collect();
        Profile { step, values }
    }

    fn at(&self, r: f64) -> f64 {
        let t = r / self.step;
        let i = t as usize;
        if i + 1 >= self.values.len() {
            return 0.0;
        }
        let f = t - i as f64;
        self.values[i] * (1.0 - f) + self.values[i + 1] * f
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Shape; 7] =
        [Shape::Square, Shape::Disc, Shape::Cross, Shape::Checker, Shape::CrossPlate, Shape::Hourglass, Shape::Bar];

    fn moments(figure: &Figure, cx: f64, cy: f64, n: i32) -> (f64, f64, f64, f64) {
        let (mut a, mut sx, mut sy, mut second) = (0.0, 0.0, 0.0, 0.0);
        for y in 0..n {
            for x in 0..n {
                let (px, py) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
                let (c, s) = figure.coverage(px - cx, py - cy);
                assert!((-1e-6..=1.0 + 1e-5).contains(&c) && s <= c + 1e-6, "{c} {s}");
                a += c;
                sx += c * px;
                sy += c * py;
                second += s;
            }
        }
        (a, sx / a, sy / a, second)
    }

    #[test]
    fn every_shape_is_centred_and_has_its_area() {
        for shape in ALL {
            for (size, rotation, blur) in [(10.0, 0.3, 0.9), (6.5, 1.1, 0.0), (5.0, -0.7, 0.3), (14.0, 0.0, 1.8)] {
                let (cx, cy) = (20.37, 19.81);
                let figure = Figure::new(shape, size, rotation, blur);
                let (area, x, y, second) = moments(&figure, cx, cy, 40);
                let s2 = size * size;
                let expected = match shape {
                    Shape::Square | Shape::Checker | Shape::CrossPlate | Shape::Hourglass => s2,
                    Shape::Bar => s2 / 2.0,
                    Shape::Disc => s2 * PI / 4.0,
                    Shape::Cross => s2 * (0.5 - 0.0625),
                };
                // Sampled without blur, even exact areas have a centroid that is off by what the edge pixels hide.
                let tolerance = if blur < 0.5 { 6e-3 } else { 1e-4 };
                let off = (x - cx).abs().max((y - cy).abs());
                assert!(off < tolerance, "{shape:?} {size} {blur}: {x} {y}");
                assert!((area / expected - 1.0).abs() < 2e-4, "{shape:?} {size} {blur}: {area} for {expected}");
                let share = match shape {
                    Shape::Checker | Shape::Hourglass => 0.5,
                    Shape::CrossPlate => 0.25 - 0.015_625,
                    _ => 0.0,
                };
                assert!((second / s2 - share).abs() < 1e-4, "{shape:?}: {second}");
            }
        }
    }

    #[test]
    fn blur_equals_brute_force() {
        // The exact coverage against the sharp figure sampled 40 × 40 a pixel and weighted with the Gaussian.
        let (size, rotation, sigma) = (5.0, 0.4, 0.8);
        let blurred = Figure::new(Shape::Square, size, rotation, sigma);
        for (dx, dy) in [(0.2, -0.1), (2.4, 0.3), (2.9, 2.2), (-3.7, 1.0)] {
            let (mut sum, mut weight) = (0.0, 0.0);
            let sharp = Figure::new(Shape::Square, size, rotation, 0.0);
            let n = 41;
            for j in -n..=n {
                for i in -n..=n {
                    let (ox, oy) = (f64::from(i) / 10.0, f64::from(j) / 10.0);
                    let w = (-(ox * ox + oy * oy) / (2.0 * sigma * sigma)).exp();
                    sum += w * sharp.coverage(dx + ox, dy + oy).0;
                    weight += w;
                }
            }
            let got = blurred.coverage(dx, dy).0;
            assert!((got - sum / weight).abs() < 2e-4, "{dx},{dy}: {got} {}", sum / weight);
        }
    }
}
