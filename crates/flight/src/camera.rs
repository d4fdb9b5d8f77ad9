//! Cameras: how a direction becomes a pixel.
//!
//! Pixels count from the outer corner of the first pixel, x to the right, y down; its centre is (0.5, 0.5). The camera
//! looks along +z, x to the right and y down in the image.

use serde::{Deserialize, Serialize};

use crate::dual::{Dual, Real};

/// How the angle off the axis becomes a distance from the principal point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Projection {
    /// r = tan θ.
    #[default]
    Perspective,
    /// r = θ (Kannala–Brandt; OpenCV's and COLMAP's fisheye).
    Fisheye,
}

/// The parameters of a lens in a fixed order, so that any of them can be adjusted.
///
/// With (x, y) = (X/Z, Y/Z) taken from the centre of distortion (`dx`, `dy`) and r² = x² + y²:
/// L = (1 + k1 r² + … + k6 r¹²) / (1 + d1 r² + d2 r⁴ + d3 r⁶);
/// x′ = x L + 2 p1 x y + p2 (r² + 2x²) + b1 x + b2 y; y′ = y L + p1 (r² + 2y²) + 2 p2 x y;
/// u = cx + f x′, v = cy + f·aspect y′ (the centre of distortion added back).
///
/// Radial and tangential terms: Brown, *Close-range camera calibration*, 1971, in OpenCV's order; affine terms:
/// El-Hakim and Fraser, as MicMac's `ModPhgrStd`. The rational terms serve models of other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[repr(usize)]
pub enum Parameter {
    F,
    Aspect,
    Cx,
    Cy,
    K1,
    K2,
    K3,
    K4,
    K5,
    K6,
    D1,
    D2,
    D3,
    P1,
    P2,
    B1,
    B2,
    Dx,
    Dy,
}

pub const PARAMETERS: usize = 19;

impl Parameter {
    pub const ALL: [Parameter; PARAMETERS] = {
        use Parameter::*;
        [F, Aspect, Cx, Cy, K1, K2, K3, K4, K5, K6, D1, D2, D3, P1, P2, B1, B2, Dx, Dy]
    };
    pub fn name(self) -> &'static str {
        [
            "f", "aspect", "cx", "cy", "k1", "k2", "k3", "k4", "k5", "k6", "d1", "d2", "d3", "p1", "p2", "b1", "b2",
            "dx", "dy",
        ][self as usize]
    }
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|p| p.name() == name)
    }
}

/// A polynomial that goes before the lens's other terms, in pixels about a centre: MicMac's `eModelePolyDegN`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PixelPolynomial {
    pub degree: usize,
    pub centre_px: [f64; 2],
    /// Pixels that count as one.
    pub scale_px: f64,
    pub coefficients: Vec<f64>,
}

/// A camera: size, projection and parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    pub name: String,
    pub size_px: [f64; 2],
    pub projection: Projection,
    /// In the order of [`Parameter`]; f, cx, cy in pixels, the others without unit.
    pub values: [f64; PARAMETERS],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polynomial: Option<PixelPolynomial>,
}

impl Camera {
    /// Without distortion.
    pub fn pinhole(name: impl Into<String>, size_px: [f64; 2], f_px: f64, pp_px: [f64; 2]) -> Self {
        let mut values = [0.0; PARAMETERS];
        values[Parameter::F as usize] = f_px;
        values[Parameter::Aspect as usize] = 1.0;
        values[Parameter::Cx as usize] = pp_px[0];
        values[Parameter::Cy as usize] = pp_px[1];
        Camera { name: name.into(), size_px, projection: Projection::Perspective, values, polynomial: None }
    }
    pub fn get(&self, parameter: Parameter) -> f64 {
        self.values[parameter as usize]
    }
    pub fn set(&mut self, parameter: Parameter, value: f64) -> &mut Self {
        self.values[parameter as usize] = value;
        self
    }
    pub fn with(mut self, parameter: Parameter, value: f64) -> Self {
        self.set(parameter, value);
        self
    }
    pub fn f_px(&self) -> f64 {
        self.get(Parameter::F)
    }
    pub fn pp_px(&self) -> [f64; 2] {
        [self.get(Parameter::Cx), self.get(Parameter::Cy)]
    }

    /// Pixel of a point in the camera's axes (x right, y down, z forward); `None` when the point is not in front.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        (point[2] > 0.0 || self.projection == Projection::Fisheye)
            .then(|| project(self.projection, &self.values, self.polynomial.as_ref(), point))
            .filter(|p| p[0].is_finite() && p[1].is_finite())
    }

    /// Pixel and its derivatives by the point.
    pub fn project_with_jacobian(&self, point: [f64; 3]) -> ([f64; 2], [[f64; 3]; 2]) {
        let values = self.values.map(Dual::<3>::constant);
        let x = std::array::from_fn(|i| Dual::variable(point[i], i));
        let [u, v] = project(self.projection, &values, self.polynomial.as_ref(), x);
        ([u.v, v.v], [u.d, v.d])
    }

    /// Pixel and its derivatives by the point and by the parameters of `which`, written behind each other.
    ///
    /// # Panics
    /// When `N` is less than three and the parameters of `which` together.
    pub fn project_with_parameters<const N: usize>(&self, point: [f64; 3], which: &[Parameter]) -> [Dual<N>; 2] {
        assert!(which.len() + 3 <= N, "room for the derivatives");
        let mut values = self.values.map(Dual::<N>::constant);
        for (i, p) in which.iter().enumerate() {
            values[*p as usize] = Dual::variable(self.get(*p), i + 3);
        }
        let x = std::array::from_fn(|i| Dual::variable(point[i], i));
        project(self.projection, &values, self.polynomial.as_ref(), x)
    }

    /// Unit vector, in the camera's axes, that a pixel looks along; `None` when no direction gives that pixel.
    pub fn ray(&self, pixel: [f64; 2]) -> Option<[f64; 3]> {
        let (f, aspect) = (self.f_px(), self.get(Parameter::Aspect));
        let start = [(pixel[0] - self.get(Parameter::Cx)) / f, (pixel[1] - self.get(Parameter::Cy)) / (f * aspect)];
        let r = start[0].hypot(start[1]);
        let (mut x, mut y) = match self.projection {
            Projection::Perspective => (start[0], start[1]),
            Projection::Fisheye if r > 1e-9 => {
                let t = r.min(1.5).tan() / r;
                (start[0] * t, start[1] * t)
            }
            Projection::Fisheye => (start[0], start[1]),
        };
        let off = |x: f64, y: f64| {
            let p = project(self.projection, &self.values, self.polynomial.as_ref(), [x, y, 1.0]);
            (p[0] - pixel[0]).hypot(p[1] - pixel[1])
        };
        let mut error = off(x, y);
        for _ in 0..50 {
            if error < 1e-10 * f {
                break;
            }
            let (at, j) = self.project_with_jacobian([x, y, 1.0]);
            let (rx, ry) = (pixel[0] - at[0], pixel[1] - at[1]);
            let det = j[0][0] * j[1][1] - j[0][1] * j[1][0];
            if det.abs() < 1e-12 * f * f {
                return None;
            }
            let (dx, dy) = ((j[1][1] * rx - j[0][1] * ry) / det, (j[0][0] * ry - j[1][0] * rx) / det);
            let mut step = 1.0;
            loop {
                let next = off(x + step * dx, y + step * dy);
                if next < error {
                    (x, y, error) = (x + step * dx, y + step * dy, next);
                    break;
                }
                step *= 0.5;
                if step < 1e-6 {
                    // The rounding of the projection: nothing better is near.
                    return (error < 1e-6 * f).then(|| unit([x, y, 1.0]));
                }
            }
        }
        (error < 1e-6 * f).then(|| unit([x, y, 1.0]))
    }

    /// Whether the image's mapping is one to one out to the place of an undistorted point: beyond the fold of a radial
    /// polynomial, far points would come back into the image.
    pub fn reach(&self) -> f64 {
        let pp = self.pp_px();
        let corners = [[0.0, 0.0], [self.size_px[0], 0.0], [0.0, self.size_px[1]], self.size_px];
        let radius = corners.iter().filter_map(|c| self.ray(*c)).map(|d| d[0].hypot(d[1]) / d[2].max(1e-3));
        let farthest = radius.fold(0.0, f64::max);
        if farthest > 0.0 {
            farthest * 1.05
        } else {
            corners.iter().map(|c| (c[0] - pp[0]).hypot(c[1] - pp[1])).fold(0.0, f64::max) / self.f_px() * 1.05
        }
    }

    pub fn contains(&self, pixel: [f64; 2]) -> bool {
        (0.0..=self.size_px[0]).contains(&pixel[0]) && (0.0..=self.size_px[1]).contains(&pixel[1])
    }

    /// Only f, principal point and k1 differ from a plain camera: COLMAP's SIMPLE_RADIAL holds it.
    pub fn is_simple_radial(&self) -> bool {
        use Parameter::*;
        self.projection == Projection::Perspective
            && self.polynomial.is_none()
            && self.get(Aspect) == 1.0
            && [K2, K3, K4, K5, K6, D1, D2, D3, P1, P2, B1, B2, Dx, Dy].iter().all(|p| self.get(*p) == 0.0)
    }
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let n = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|c| c / n)
}

/// The projection itself, for plain numbers and for those with derivatives.
fn project<T: Real>(
    kind: Projection,
    values: &[T; PARAMETERS],
    polynomial: Option<&PixelPolynomial>,
    point: [T; 3],
) -> [T; 2] {
    use Parameter::*;
    let get = |p: Parameter| values[p as usize];
    let one = T::of(1.0);
    let two = T::of(2.0);
    let (mut x, mut y) = (point[0] / point[2], point[1] / point[2]);
    if kind == Projection::Fisheye {
        let off = (point[0] * point[0] + point[1] * point[1]).sqrt();
        if off.value() > 1e-12 * point[2].value().abs() {
            let per = off.atan2(point[2]) / off;
            (x, y) = (point[0] * per, point[1] * per);
        }
    }
    if let Some(polynomial) = polynomial {
        let [u, v] = polynomial.apply(get(Cx) + get(F) * x, get(Cy) + get(F) * get(Aspect) * y);
        (x, y) = ((u - get(Cx)) / get(F), (v - get(Cy)) / (get(F) * get(Aspect)));
    }
    x = x - get(Dx);
    y = y - get(Dy);
    let r2 = x * x + y * y;
    let mut radial = get(K6);
    for k in [K5, K4, K3, K2, K1] {
        radial = radial * r2 + get(k);
    }
    let mut l = one + radial * r2;
    if [D1, D2, D3].iter().any(|d| get(*d).value() != 0.0) {
        l = l / (one + r2 * (get(D1) + r2 * (get(D2) + r2 * get(D3))));
    }
    let xy = two * x * y;
    let xd = x * l + get(P1) * xy + get(P2) * (r2 + two * x * x) + get(B1) * x + get(B2) * y;
    let yd = y * l + get(P1) * (r2 + two * y * y) + get(P2) * xy;
    let u = get(Cx) + get(F) * (xd + get(Dx));
    let v = get(Cy) + get(F) * get(Aspect) * (yd + get(Dy));
    [u, v]
}

impl PixelPolynomial {
    /// MicMac's general polynomial (`cDistGen_Deg0_DegN`, "eModelePolyDeg2…7"): six terms of low degree without those
    /// that turn, shift and scale, then x^(d−k) y^k of the degrees from 3 up, for x and then for y.
    fn apply<T: Real>(&self, u: T, v: T) -> [T; 2] {
        let s = T::of(1.0 / self.scale_px);
        let x = (u - T::of(self.centre_px[0])) * s;
        let y = (v - T::of(self.centre_px[1])) * s;
        let c = |i: usize| T::of(self.coefficients.get(i).copied().unwrap_or(0.0));
        let two = T::of(2.0);
        let mut dx = c(0) * x + c(1) * y - two * c(2) * x * x + c(3) * x * y + c(4) * y * y;
        let mut dy = -(c(0) * y) + c(1) * x + c(2) * x * y - two * c(3) * y * y + c(5) * x * x;
        let mut at = 6;
        for degree in 3..=self.degree {
            for part in [&mut dx, &mut dy] {
                for k in 0..=degree {
                    let mut term = c(at);
                    for _ in 0..degree - k {
                        term = term * x;
                    }
                    for _ in 0..k {
                        term = term * y;
                    }
                    *part = *part + term;
                    at += 1;
                }
            }
        }
        let scale = T::of(self.scale_px);
        [u + dx * scale, v + dy * scale]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Camera {
        use Parameter::*;
        let mut camera = Camera::pinhole("test", [4000.0, 3000.0], 3200.0, [2010.0, 1490.0]);
        for (p, v) in
            [(Aspect, 1.001), (K1, -0.12), (K2, 0.05), (P1, 3e-4), (P2, -2e-4), (B1, 1e-3), (B2, -4e-4), (Dx, 0.002)]
        {
            camera.set(p, v);
        }
        camera
    }

    #[test]
    fn rays_undo_projections() {
        for projection in [Projection::Perspective, Projection::Fisheye] {
            let camera = Camera { projection, ..lens() };
            for pixel in [[0.0, 0.0], [4000.0, 10.0], [2010.0, 1490.0], [1234.5, 2999.0]] {
                let ray = camera.ray(pixel).expect("inside the image");
                let back = camera.project(ray).expect("in front");
                assert!((back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-6, "{projection:?} {pixel:?} {back:?}");
            }
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        use Parameter::*;
        let (camera, point, h) = (lens(), [0.3, -0.2, 1.1], 1e-6);
        let which = [F, Aspect, Cx, Cy, K1, K2, P1, P2, B1, B2, Dx, Dy];
        let exact = camera.project_with_parameters::<16>(point, &which);
        for (i, p) in which.iter().enumerate() {
            let scale = if matches!(p, F | Cx | Cy) { 1e3 } else { 1.0 };
            let at = |d: f64| camera.clone().with(*p, camera.get(*p) + d * scale).project(point).expect("in front");
            for (axis, exact) in exact.iter().enumerate() {
                let slope = (at(h)[axis] - at(-h)[axis]) / (2.0 * h * scale);
                assert!((exact.d[i + 3] - slope).abs() < 1e-4 * (1.0 + slope.abs()), "{p:?} {axis}");
            }
        }
        for i in 0..3 {
            let at = |d: f64| {
                let mut moved = point;
                moved[i] += d;
                camera.project(moved).expect("in front")
            };
            for (axis, exact) in exact.iter().enumerate() {
                assert!((exact.d[i] - (at(h)[axis] - at(-h)[axis]) / (2.0 * h)).abs() < 1e-3);
            }
        }
    }
}
