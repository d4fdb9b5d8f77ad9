//! Cameras: how a direction becomes a pixel.
//!
//! Pixels count from the outer corner of the first pixel, x to the right, y down; its centre is (0.5, 0.5). The camera
//! looks along +z, x to the right and y down in the image.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use serde::{Deserialize, Serialize};

use crate::dual::{Dual, Real};
use crate::plane::PlaneMap;

/// How the angle θ off the axis becomes a distance from the principal point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Projection {
    /// r = tan θ.
    #[default]
    Perspective,
    /// r = θ (Kannala–Brandt; OpenCV's and COLMAP's fisheye).
    Fisheye,
    /// r = 2 sin(θ/2): equal areas.
    Equisolid,
    /// r = 2 tan(θ/2).
    Stereographic,
    /// r = sin θ.
    Orthographic,
    /// Longitude and latitude, no radius: x = atan(X/Z), y = asin(Y/R).
    Equirectangular,
}

/// The parameters of a lens in a fixed order, so that any of them can be adjusted.
///
/// With (x, y) = (X/Z, Y/Z) taken from the centre of distortion (`dx`, `dy`) and r² = x² + y²:
/// L = (1 + k1 r² + … + k6 r¹²) / (1 + d1 r² + d2 r⁴ + d3 r⁶);
/// x′ = x L + 2 p1 x y + p2 (r² + 2x²) + b1 x + b2 y; y′ = y L + p1 (r² + 2y²) + 2 p2 x y;
/// u = cx + f x′, v = cy + f·aspect y′ (the centre of distortion added back).
///
/// What a camera has in [`Camera::before`] moves (cx + f x, cy + f·aspect y) before these terms, what it has in
/// [`Camera::after`] moves (u, v).
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
    /// As files and the command line have it.
    pub fn name(self) -> &'static str {
        [
            "f", "aspect", "cx", "cy", "k1", "k2", "k3", "k4", "k5", "k6", "d1", "d2", "d3", "p1", "p2", "b1", "b2",
            "dx", "dy",
        ][self as usize]
    }
    /// The one of that name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|p| p.name() == name)
    }
    /// Whether it bends the plane of the projection.
    fn is_of_lens(self) -> bool {
        self as usize >= Parameter::K1 as usize
    }
}

/// What a camera's size is of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SizeOf {
    /// The image: one of another size has other pixels.
    #[default]
    Image,
    /// The film on a scan, which may be larger; pixels are the scan's.
    Film,
}

/// A camera: size, projection, parameters, and maps of its plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    pub name: String,
    pub size_px: [f64; 2],
    #[serde(default)]
    pub size_of: SizeOf,
    pub projection: Projection,
    /// In the order of [`Parameter`]; f, cx, cy in pixels, the others without unit.
    pub values: [f64; PARAMETERS],
    /// What moves the plane before the lens's terms, in the order of application.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub before: Vec<PlaneMap>,
    /// What moves the image behind them: the other lenses of a chain, a scan that lies turned.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub after: Vec<PlaneMap>,
}

impl Camera {
    /// Without distortion.
    pub fn pinhole(name: impl Into<String>, size_px: [f64; 2], f_px: f64, pp_px: [f64; 2]) -> Self {
        let mut values = [0.0; PARAMETERS];
        values[Parameter::F as usize] = f_px;
        values[Parameter::Aspect as usize] = 1.0;
        values[Parameter::Cx as usize] = pp_px[0];
        values[Parameter::Cy as usize] = pp_px[1];
        let (before, after) = (Vec::new(), Vec::new());
        let (size_of, projection) = (SizeOf::Image, Projection::Perspective);
        Camera { name: name.into(), size_px, size_of, projection, values, before, after }
    }
    /// The value of a parameter; of f, cx and cy in pixels.
    pub fn get(&self, parameter: Parameter) -> f64 {
        self.values[parameter as usize]
    }
    /// Gives a parameter another value.
    pub fn set(&mut self, parameter: Parameter, value: f64) -> &mut Self {
        self.values[parameter as usize] = value;
        self
    }
    /// The same camera with another value of a parameter.
    pub fn with(mut self, parameter: Parameter, value: f64) -> Self {
        self.set(parameter, value);
        self
    }
    /// Focal length, pixels.
    pub fn f_px(&self) -> f64 {
        self.get(Parameter::F)
    }
    /// Principal point, pixels from the outer corner of the first.
    pub fn pp_px(&self) -> [f64; 2] {
        [self.get(Parameter::Cx), self.get(Parameter::Cy)]
    }

    /// Pixel of a point in the camera's axes (x right, y down, z forward); `None` when the camera does not see it.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        self.place(point).and_then(|place| self.pixel_of(place))
    }

    /// Place of a point in the plane of the projection, f as unit; `None` when the camera does not see it.
    pub(crate) fn place(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        self.sees(point).then(|| self.projection.plane(point))
    }

    /// Whether a point in the camera's axes has a pixel: those in front, and all where the projection goes on behind.
    pub(crate) fn sees(&self, point: [f64; 3]) -> bool {
        point[2] > 0.0 || self.projection.sees_behind()
    }

    /// Pixel of a place in the plane of the projection, where it is a number.
    pub(crate) fn pixel_of(&self, place: [f64; 2]) -> Option<[f64; 2]> {
        let pixel = if self.is_plain() { scaled(|p| self.get(p), place) } else { self.image(&self.values, place) };
        Some(pixel).filter(|p| p[0].is_finite() && p[1].is_finite())
    }

    /// The determinant of [`Camera::pixel_of`] by the place, square pixels.
    pub(crate) fn area_of(&self, [x, y]: [f64; 2]) -> f64 {
        let values = self.values.map(Dual::<2>::constant);
        let [u, v] = self.image(&values, [Dual::variable(x, 0), Dual::variable(y, 1)]);
        u.d[0] * v.d[1] - u.d[1] * v.d[0]
    }

    /// Lengths across the view, at a distance of one along a ray of unit length, for one of f in the plane.
    pub fn across(&self, ray: [f64; 3]) -> f64 {
        match self.projection {
            Projection::Perspective => ray[2],
            Projection::Equirectangular => 1.0,
            _ => {
                let [x, y] = self.projection.plane(ray);
                let off = x.hypot(y);
                if off > 0.0 { ray[0].hypot(ray[1]) / off } else { 1.0 }
            }
        }
    }

    /// Pixel of a place with derivatives, of which those by the parameters of `which` come behind the first three.
    ///
    /// # Panics
    /// When `N` is less than three and the parameters of `which` together.
    pub(crate) fn pixel_with<const N: usize>(&self, place: [Dual<N>; 2], which: &[Parameter]) -> [Dual<N>; 2] {
        assert!(which.len() + 3 <= N, "room for the derivatives");
        if self.is_plain() && which.iter().all(|p| !p.is_of_lens()) {
            let variable = |i, p| Dual::variable(self.get(p), i + 3);
            let constant = |p| Dual::constant(self.get(p));
            return scaled(
                |p| which.iter().position(|w| *w == p).map_or_else(|| constant(p), |i| variable(i, p)),
                place,
            );
        }
        let mut values = self.values.map(Dual::<N>::constant);
        for (i, p) in which.iter().enumerate() {
            values[*p as usize] = Dual::variable(self.get(*p), i + 3);
        }
        self.image(&values, place)
    }

    /// Whether neither a term of the lens nor a map bends the plane: what [`Camera::image`] does is then [`scaled`].
    pub(crate) fn is_plain(&self) -> bool {
        self.values[Parameter::K1 as usize..].iter().all(|v| *v == 0.0) && !self.has_plane_maps()
    }

    /// Pixel of a place in the plane of the projection, for plain numbers and for those with derivatives.
    fn image<T: Real>(&self, values: &[T; PARAMETERS], place: [T; 2]) -> [T; 2] {
        let get = |p: Parameter| values[p as usize];
        let centre = [get(Parameter::Cx), get(Parameter::Cy)];
        let scale = [get(Parameter::F), get(Parameter::F) * get(Parameter::Aspect)];
        let mut place = place;
        if !self.before.is_empty() {
            let on_plane = [0, 1].map(|k| centre[k] + scale[k] * place[k]);
            let moved = self.before.iter().fold(on_plane, |at, map| map.apply(at));
            place = [0, 1].map(|k| (moved[k] - centre[k]) / scale[k]);
        }
        let seen = lens(values, place);
        let pixel = [0, 1].map(|k| centre[k] + scale[k] * seen[k]);
        self.after.iter().fold(pixel, |at, map| map.apply(at))
    }

    /// Unit vector, in the camera's axes, that a pixel looks along; `None` when no direction gives that pixel.
    pub fn ray(&self, pixel: [f64; 2]) -> Option<[f64; 3]> {
        let f = self.f_px();
        let [mut x, mut y] = self.without_lens(pixel)?;
        let off = |x: f64, y: f64| {
            let p = self.image(&self.values, [x, y]);
            (p[0] - pixel[0]).hypot(p[1] - pixel[1])
        };
        let values = self.values.map(Dual::<2>::constant);
        let mut error = off(x, y);
        for _ in 0..50 {
            if error < 1e-10 * f {
                break;
            }
            let [u, v] = self.image(&values, [Dual::variable(x, 0), Dual::variable(y, 1)]);
            let (rx, ry) = (pixel[0] - u.v, pixel[1] - v.v);
            let det = u.d[0] * v.d[1] - u.d[1] * v.d[0];
            if det.is_nan() || det.abs() < 1e-12 * f * f {
                return None;
            }
            let (dx, dy) = ((v.d[1] * rx - u.d[1] * ry) / det, (u.d[0] * ry - v.d[0] * rx) / det);
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
                    return if error < 1e-6 * f { self.projection.looks([x, y]) } else { None };
                }
            }
        }
        if error < 1e-6 * f { self.projection.looks([x, y]) } else { None }
    }

    /// Where a pixel lies in the plane of the projection, were it not for the lens's terms.
    fn without_lens(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let (centre, f) = (self.pp_px(), self.f_px());
        let scale = [f, f * self.get(Parameter::Aspect)];
        let back = |maps: &[PlaneMap], at| maps.iter().rev().try_fold(at, |at, map| map.undo(at));
        let at = back(&self.after, pixel)?;
        // The lens may hold the pixel where the maps before it alone do not reach.
        let at = back(&self.before, at).unwrap_or(at);
        Some([0, 1].map(|k| (at[k] - centre[k]) / scale[k]))
    }

    /// Whether a place in pixels lies in the image, its edges included.
    pub fn contains(&self, pixel: [f64; 2]) -> bool {
        (0.0..=self.size_px[0]).contains(&pixel[0]) && (0.0..=self.size_px[1]).contains(&pixel[1])
    }

    /// Whether it is more than projection and parameters.
    pub fn has_plane_maps(&self) -> bool {
        !(self.before.is_empty() && self.after.is_empty())
    }

    /// Only f, principal point and k1 differ from a plain camera: COLMAP's SIMPLE_RADIAL holds it.
    pub fn is_simple_radial(&self) -> bool {
        use Parameter::*;
        self.projection == Projection::Perspective
            && !self.has_plane_maps()
            && self.get(Aspect) == 1.0
            && [K2, K3, K4, K5, K6, D1, D2, D3, P1, P2, B1, B2, Dx, Dy].iter().all(|p| self.get(*p) == 0.0)
    }
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let n = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|c| c / n)
}

impl Projection {
    pub const ALL: [Projection; 6] = {
        use Projection::*;
        [Perspective, Fisheye, Equisolid, Stereographic, Orthographic, Equirectangular]
    };

    /// As files have it.
    pub fn name(self) -> &'static str {
        ["perspective", "fisheye", "equisolid", "stereographic", "orthographic", "equirectangular"][self as usize]
    }

    /// The one of that name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|p| p.name() == name)
    }

    /// Whether points beside and behind the camera have a place.
    pub(crate) fn sees_behind(self) -> bool {
        !matches!(self, Projection::Perspective | Projection::Orthographic)
    }

    /// Place in the plane, f as unit.
    pub(crate) fn plane<T: Real>(self, [x, y, z]: [T; 3]) -> [T; 2] {
        let (one, two) = (T::of(1.0), T::of(2.0));
        let aside2 = x * x + y * y;
        let times = |k: T| [x * k, y * k];
        let far = || (aside2 + z * z).sqrt();
        match self {
            Projection::Perspective => [x / z, y / z],
            Projection::Fisheye => {
                let off = aside2.sqrt();
                // Straight behind there is no place: a circle.
                if off.value() > 1e-12 * z.value() { times(off.atan2(z) / off) } else { [x / z, y / z] }
            }
            Projection::Equisolid => times(two / (two * far() * (far() + z)).sqrt()),
            Projection::Stereographic => times(two / (far() + z)),
            Projection::Orthographic => times(one / far()),
            Projection::Equirectangular => [x.atan2(z), y.atan2((x * x + z * z).sqrt())],
        }
    }

    /// The direction that a pixel at a place in the plane shows; a picture of all directions goes on at its other end.
    fn looks(self, [x, y]: [f64; 2]) -> Option<[f64; 3]> {
        let is_past_the_end = self == Projection::Equirectangular && x.abs() > PI;
        self.direction([if is_past_the_end { x - TAU.copysign(x) } else { x }, y])
    }

    /// The direction of a place in the plane, a unit vector; `None` where the plane has ended.
    pub(crate) fn direction(self, [x, y]: [f64; 2]) -> Option<[f64; 3]> {
        let r = x.hypot(y);
        let angle = match self {
            Projection::Perspective => return Some(unit([x, y, 1.0])),
            Projection::Equirectangular => {
                let within = x.abs() <= PI && y.abs() <= FRAC_PI_2;
                return within.then(|| [y.cos() * x.sin(), y.sin(), y.cos() * x.cos()]);
            }
            Projection::Fisheye => r,
            Projection::Equisolid => 2.0 * (r / 2.0).asin(),
            Projection::Stereographic => 2.0 * (r / 2.0).atan(),
            Projection::Orthographic => r.asin(),
        };
        let per = if r > 0.0 { angle.sin() / r } else { 1.0 };
        (angle <= PI).then(|| [x * per, y * per, angle.cos()])
    }
}

/// The pixel of a place in the plane that nothing bends.
#[inline]
fn scaled<T: Real>(get: impl Fn(Parameter) -> T, [x, y]: [T; 2]) -> [T; 2] {
    let f = get(Parameter::F);
    [get(Parameter::Cx) + f * x, get(Parameter::Cy) + f * get(Parameter::Aspect) * y]
}

/// The lens's terms in the plane of the projection.
fn lens<T: Real>(values: &[T; PARAMETERS], [x, y]: [T; 2]) -> [T; 2] {
    use Parameter::*;
    let get = |p: Parameter| values[p as usize];
    let (one, two) = (T::of(1.0), T::of(2.0));
    let (x, y) = (x - get(Dx), y - get(Dy));
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
    [xd + get(Dx), yd + get(Dy)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::Polynomial;

    fn some_lens() -> Camera {
        use Parameter::*;
        let mut camera = Camera::pinhole("test", [4000.0, 3000.0], 3200.0, [2010.0, 1490.0]);
        for (p, v) in
            [(Aspect, 1.001), (K1, -0.12), (K2, 0.05), (P1, 3e-4), (P2, -2e-4), (B1, 1e-3), (B2, -4e-4), (Dx, 0.002)]
        {
            camera.set(p, v);
        }
        camera
    }

    fn between_maps() -> Camera {
        let mut camera = some_lens();
        let mut bent = Polynomial::new([1900.0, 1500.0], 3000.0);
        bent.add([2, 1], [0.01, -0.02]).add([0, 2], [-0.01, 0.005]);
        let mut turned = Polynomial::new([2010.0, 1490.0], 1.0);
        turned.add([1, 0], [-1.0, 1.0]).add([0, 1], [-1.0, -1.0]);
        camera.before = vec![PlaneMap::Polynomial(bent.clone()), PlaneMap::Undo(bent.clone())];
        camera.after = vec![PlaneMap::Undo(bent), PlaneMap::Polynomial(turned)];
        camera
    }

    #[test]
    fn rays_undo_projections() {
        let kinds = Projection::ALL.map(|projection| Camera { projection, ..some_lens() });
        for camera in kinds.into_iter().chain([between_maps()]) {
            let projection = camera.projection;
            for pixel in [[0.0, 0.0], [4000.0, 10.0], [2010.0, 1490.0], [1234.5, 2999.0]] {
                let ray = camera.ray(pixel).expect("inside the image");
                let back = camera.project(ray).expect("in front");
                assert!((back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-6, "{projection:?} {pixel:?} {back:?}");
            }
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        for camera in [some_lens(), between_maps()] {
            derivatives_agree(&camera, [0.3, -0.2, 1.1]);
        }
        // Beside the camera and behind it too, where it sees what is there.
        let wide = Projection::ALL.into_iter().filter(|p| p.sees_behind());
        for camera in wide.map(|projection| Camera { projection, ..some_lens().with(Parameter::K2, 1e-3) }) {
            for off_deg in [0.0f64, 60.0, 90.0, 95.0, 140.0, 172.0] {
                let (sin, cos) = off_deg.to_radians().sin_cos();
                derivatives_agree(&camera, [0.8 * sin, -0.6 * sin, cos]);
            }
        }
    }

    fn derivatives_agree(camera: &Camera, point: [f64; 3]) {
        use Parameter::*;
        let h = 1e-6;
        let pixel = camera.project(point).expect("seen");
        let which = [F, Aspect, Cx, Cy, K1, K2, P1, P2, B1, B2, Dx, Dy];
        let exact = camera.residual_with_parameters::<16>(point, pixel, &which);
        let agrees = |slope: f64, exact: f64, what: &dyn std::fmt::Debug| {
            let off = (exact - slope).abs() / (1.0 + slope.abs());
            assert!(off < 1e-4, "{:?} {point:?} {what:?}: {exact} {slope}", camera.projection);
        };
        for (i, p) in which.iter().enumerate() {
            let scale = if matches!(p, F | Cx | Cy) { 1e3 } else { 1.0 };
            let at = |d: f64| {
                let with = camera.clone().with(*p, camera.get(*p) + d * scale);
                with.residual(point, pixel).expect("seen")
            };
            for (axis, exact) in exact.iter().enumerate() {
                agrees((at(h)[axis] - at(-h)[axis]) / (2.0 * h * scale), exact.d[i + 3], p);
            }
        }
        for i in 0..3 {
            let at = |d: f64| {
                let mut moved = point;
                moved[i] += d;
                camera.residual(moved, pixel).expect("seen")
            };
            for (axis, exact) in exact.iter().enumerate() {
                agrees((at(h)[axis] - at(-h)[axis]) / (2.0 * h), exact.d[i], &i);
            }
        }
    }
}
