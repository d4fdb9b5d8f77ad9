//! MicMac's planes of the image: a calibration or a scan may count in millimetres, and an affinity says which pixel is
//! where.
//!
//! Source: MicMac's `OrIntGlob` (of a calibration, to millimetres where `<C2M>` is true) and `OrIntImaM2C` (of an
//! orientation, to pixels), and how its sources join both: pixel = glob⁻¹(ima(millimetre)).

use std::path::Path;

use crate::camera::{Camera, Parameter};
use crate::error::{Error, Result};
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
        let determinant = a * d - b * c;
        let columns = [[d / determinant, -c / determinant], [-b / determinant, a / determinant]];
        let bare = Affinity { shift: [0.0; 2], columns };
        let shift = bare.apply(self.shift).map(|v| -v);
        columns.iter().flatten().chain(&shift).all(|v| v.is_finite()).then_some(Affinity { shift, columns })
    }

    fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|k| self.shift[k] + self.columns[0][k] * x + self.columns[1][k] * y)
    }

    /// A camera of this plane in pixels. Shifts and scales along the axes are held exactly, two scales as `aspect`.
    ///
    /// # Errors
    /// What cannot be held: an affinity that turns or shears, two scales or a mirror under a polynomial. `element` is
    /// where the file has it.
    pub(super) fn to_pixels(self, path: &Path, element: &str, camera: &Camera, size: SizeIn) -> Result<Camera> {
        if self == Affinity::IDENTITY {
            return Ok(camera.clone());
        }
        let refuse = |what: &str| Err(Error::format(path, format!("<{element}>"), what));
        let scale = [self.columns[0][0], self.columns[1][1]];
        let size_px = match size {
            SizeIn::Pixels => camera.size_px,
            SizeIn::Plane => {
                let [near, far] = [[0.0; 2], camera.size_px].map(|corner| self.apply(corner));
                // To a millionth: the files' rounding makes 1406.9999999999998 of 1407.
                [near[0].max(far[0]), near[1].max(far[1])].map(|side| (side * 1e6).round() / 1e6)
            }
        };
        // Millimetres of the frame's edges, as this plane counts them.
        let reach = [size_px[0] / scale[0].abs(), size_px[1] / scale[1].abs()];
        let aside = (self.columns[1][0] * reach[1]).abs().max((self.columns[0][1] * reach[0]).abs());
        // An axis without a scale makes `aside` no number.
        if aside.is_nan() || aside > UNSEEN_PX {
            return refuse(
                "turns or shears the image, which no camera here holds; resample the scans to the film's frame \
                 (MicMac's ReSampFid, or `fiducials --resample`)",
            );
        }
        if size_px.iter().any(|s| *s <= 0.0) {
            return refuse("puts the frame outside the image; correct <I00>");
        }
        let one_scale = (scale[1].abs() / scale[0].abs() - 1.0).abs() < ONE_SCALE;
        let [mirror_x, mirror_y] = scale.map(f64::signum);
        let mut pixels = camera.clone();
        pixels.size_px = size_px;
        if let Some(polynomial) = &mut pixels.polynomial {
            if !one_scale || mirror_x < 0.0 || mirror_y < 0.0 {
                return refuse(
                    "scales x and y differently, or mirrors, under a polynomial; calibrate with FraserBasic or RadialStd",
                );
            }
            polynomial.centre_px = self.apply(polynomial.centre_px);
            polynomial.scale_px *= scale[0];
        }
        use Parameter::{Aspect, B2, Cx, Cy, Dx, Dy, F, P1, P2};
        let principal = self.apply(camera.pp_px());
        pixels.set(F, camera.f_px() * scale[0].abs()).set(Cx, principal[0]).set(Cy, principal[1]);
        if !one_scale {
            pixels.set(Aspect, camera.get(Aspect) * (scale[1] / scale[0]).abs());
        }
        // A plane whose y points up, as on film: x to the right and y down, as pixels run.
        for (parameter, sign) in
            [(P1, mirror_y), (P2, mirror_x), (B2, mirror_x * mirror_y), (Dx, mirror_x), (Dy, mirror_y)]
        {
            pixels.set(parameter, camera.get(parameter) * sign);
        }
        Ok(pixels)
    }

    /// Whether an axis of the image runs against that of the plane.
    pub(super) fn mirrors(&self) -> bool {
        self.columns[0][0] < 0.0 || self.columns[1][1] < 0.0
    }
}
