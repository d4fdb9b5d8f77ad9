//! MicMac's planes of the image: a calibration or a scan may count in millimetres, and an affinity says which pixel is
//! where.
//!
//! Source: MicMac's `OrIntGlob` (of a calibration, to millimetres where `<C2M>` is true) and `OrIntImaM2C` (of an
//! orientation, to pixels), and how its sources join both: pixel = glob⁻¹(ima(millimetre)).

use std::path::Path;

use crate::camera::{Camera, Parameter, SizeOf};
use crate::error::{Error, Result};
use crate::plane::{PlaneMap, Polynomial};
use crate::xml::{Element, numbers};

/// shift + columns · (x, y).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Affinity {
    shift: [f64; 2],
    columns: [[f64; 2]; 2],
}

/// What a camera's size counts before an affinity takes it to pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SizeIn {
    Pixels,
    Plane,
}

/// Which way the axes of the camera in pixels run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axes {
    /// As those of the plane that a rotation is stated for, however the image lies on it.
    Plane,
    /// x to the right and y down in the image, where no rotation is stated.
    Image,
}

/// What an affinity may turn or shear over a frame unseen, pixels.
const UNSEEN_PX: f64 = 1e-6;
/// Scales that differ by no more are one: the files' own rounding.
const ONE_SCALE: f64 = 1e-12;

impl Affinity {
    pub(super) const IDENTITY: Affinity = Affinity { shift: [0.0; 2], columns: [[1.0, 0.0], [0.0, 1.0]] };

    /// `<I00>`, `<V10>` and `<V01>` of an element.
    pub(super) fn read(path: &Path, element: &Element) -> Result<Self> {
        let columns = [numbers(path, element, "V10")?, numbers(path, element, "V01")?];
        let read = Affinity { shift: numbers(path, element, "I00")?, columns };
        match read.inverse() {
            Some(_) => Ok(read),
            None => {
                Err(Error::format(path, format!("<{}>", element.name), "its two axes are one; correct <V10> and <V01>"))
            }
        }
    }

    /// `None` where both axes are one.
    pub(super) fn inverse(&self) -> Option<Self> {
        let [[a, c], [b, d]] = self.columns;
        let determinant = self.determinant();
        let columns = [[d / determinant, -c / determinant], [-b / determinant, a / determinant]];
        let bare = Affinity { shift: [0.0; 2], columns };
        let shift = bare.apply(self.shift).map(|v| -v);
        columns.iter().flatten().chain(&shift).all(|v| v.is_finite()).then_some(Affinity { shift, columns })
    }

    /// First `self`, then `next`.
    pub(super) fn then(&self, next: &Affinity) -> Self {
        let bare = Affinity { shift: [0.0; 2], ..*next };
        Affinity { shift: next.apply(self.shift), columns: self.columns.map(|column| bare.apply(column)) }
    }

    fn determinant(&self) -> f64 {
        let [[a, c], [b, d]] = self.columns;
        a * d - b * c
    }

    fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|k| self.shift[k] + self.columns[0][k] * x + self.columns[1][k] * y)
    }

    /// A camera of this plane in pixels. Shifts and scales along the axes go into its parameters, two scales as
    /// `aspect`; what else the affinity does to the image stays behind the lens. `element` is where the file has it.
    ///
    /// # Errors
    /// When the frame would lie outside the image.
    pub(super) fn to_pixels(
        self,
        path: &Path,
        element: &str,
        camera: &Camera,
        size: SizeIn,
        axes: Axes,
    ) -> Result<Camera> {
        if self == Affinity::IDENTITY {
            return Ok(camera.clone());
        }
        let size_px = match size {
            SizeIn::Pixels => camera.size_px,
            SizeIn::Plane => self.extent(camera.size_px),
        };
        if size_px.iter().any(|s| *s <= 0.0) {
            return Err(Error::format(path, format!("<{element}>"), "puts the frame outside the image; correct <I00>"));
        }
        let signs = if axes == Axes::Image { self.signs() } else { [1.0; 2] };
        let along = [self.columns[0][0] * signs[0], self.columns[1][1] * signs[1]];
        let one_scale = (along[1] / along[0] - 1.0).abs() < ONE_SCALE;
        let held =
            along[0] > 0.0 && along[1] > 0.0 && self.lies_along(size_px) && (one_scale || !camera.has_plane_maps());
        let scale = match held {
            true if one_scale => [along[0]; 2],
            true => along,
            false => [self.determinant().abs().sqrt(); 2],
        };
        let mut pixels = self.scaled(camera, scale, signs);
        pixels.size_px = size_px;
        pixels.size_of = if size == SizeIn::Plane { SizeOf::Film } else { SizeOf::Image };
        if !held {
            let mut rest = Polynomial::new(pixels.pp_px(), 1.0);
            let [[a, c], [b, d]] = [0, 1].map(|k| self.columns[k].map(|v| v / (scale[k] * signs[k])));
            rest.add([1, 0], [a - 1.0, c]).add([0, 1], [b, d - 1.0]);
            pixels.after.push(PlaneMap::Polynomial(rest));
        }
        Ok(pixels)
    }

    /// Width and height of the image that holds a frame of the plane.
    fn extent(&self, [w, h]: [f64; 2]) -> [f64; 2] {
        let corners = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]].map(|corner| self.apply(corner));
        // To a millionth: the files' rounding makes 1406.9999999999998 of 1407.
        [0, 1].map(|k| (corners.iter().map(|c| c[k]).fold(f64::MIN, f64::max) * 1e6).round() / 1e6)
    }

    /// Whether it turns and shears an image of that size by nothing that is seen.
    fn lies_along(&self, size_px: [f64; 2]) -> bool {
        // Millimetres of the frame's edges, as this plane counts them.
        let reach = [size_px[0] / self.columns[0][0].abs(), size_px[1] / self.columns[1][1].abs()];
        let aside = (self.columns[1][0] * reach[1]).abs().max((self.columns[0][1] * reach[0]).abs());
        aside <= UNSEEN_PX
    }

    /// The axes of the plane that run against those of the image, as −1. One that is turned far runs with them.
    fn signs(&self) -> [f64; 2] {
        let [[a, c], [b, d]] = self.columns;
        match a.abs() > c.abs() && d.abs() > b.abs() {
            true => [a.signum(), d.signum()],
            false => [1.0, self.determinant().signum()],
        }
    }

    /// The camera on a plane of that scale and sense, its principal point where this affinity has it.
    fn scaled(&self, camera: &Camera, scale: [f64; 2], signs: [f64; 2]) -> Camera {
        use Parameter::{Aspect, B2, Cx, Cy, Dx, Dy, F, P1, P2};
        let (mut pixels, from, to) = (camera.clone(), camera.pp_px(), self.apply(camera.pp_px()));
        let shift = [0, 1].map(|k| to[k] - scale[0] * signs[k] * from[k]);
        for maps in [&mut pixels.before, &mut pixels.after] {
            maps.iter_mut().for_each(|map| *map = map.moved(scale[0], signs, shift));
        }
        pixels.set(F, camera.f_px() * scale[0]).set(Cx, to[0]).set(Cy, to[1]);
        if scale[0] != scale[1] {
            pixels.set(Aspect, camera.get(Aspect) * (scale[1] / scale[0]));
        }
        // A plane whose y points up, as on film: x to the right and y down, as pixels run.
        for (parameter, sign) in
            [(P1, signs[1]), (P2, signs[0]), (B2, signs[0] * signs[1]), (Dx, signs[0]), (Dy, signs[1])]
        {
            pixels.set(parameter, camera.get(parameter) * sign);
        }
        pixels
    }
}
