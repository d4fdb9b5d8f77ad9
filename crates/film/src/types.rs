//! The values that pass between the steps and that are written to the frame's JSON: cameras, marks found, the interior
//! orientation. Pixels follow `docs/coordinates.md`; millimetres are on the film, with the axes that the camera states.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use autoref_raster::coords::{Handedness, PixelPoint};

/// Where the y axis of a camera's millimetres points when the film is looked at the right way round.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum YAxis {
    /// As in most calibration certificates.
    Up,
    /// As in a picture.
    Down,
}

/// A film camera as a TOML file states it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    pub name: String,
    /// One line for `--list-cameras`.
    #[serde(default)]
    pub description: String,
    /// Where the numbers come from.
    #[serde(default)]
    pub source: String,
    /// Width and height of the film that a scan shows, border included, in millimetres.
    pub film_size_mm: [f64; 2],
    /// Width and height of the exposed image, in millimetres; `None`: as far out as the marks.
    #[serde(default)]
    pub image_size_mm: Option<[f64; 2]>,
    /// Middle of the film, camera's axes; `None`: the middle of the marks' bounding box, which the marks of one side
    /// alone do not have.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub centre_mm: Option<[f64; 2]>,
    #[serde(default)]
    pub focal_length_mm: Option<f64>,
    pub y_axis: YAxis,
    /// Scans of this camera are known to be upright and not mirrored where the marks do not tell; else such frames are
    /// doubtful.
    #[serde(default)]
    pub upright: bool,
    pub marks: Vec<CameraMark>,
    /// Distances between marks where a certificate gives no coordinates: two names and millimetres.
    #[serde(default)]
    pub distances_mm: Vec<([String; 2], f64)>,
    /// Boxes of text and instruments that `--resample` masks: two opposite corners x, y, x, y in the camera's axes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub masked_mm: Vec<[f64; 4]>,
    /// Boxes of text that masks of the ground leave out where `masked_mm` names none, likewise. `--resample` does not
    /// mask them: their sizes are a guess.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub text_boxes_mm: Vec<[f64; 4]>,
}

/// One fiducial mark of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraMark {
    pub name: String,
    /// Calibrated position; `None` when only distances are known (then solved from them, see [`Camera::distances_mm`]).
    #[serde(default)]
    pub x_mm: Option<f64>,
    #[serde(default)]
    pub y_mm: Option<f64>,
    /// Where it lies roughly, for marks known by distances only.
    #[serde(default)]
    pub near_mm: Option<[f64; 2]>,
    /// What it looks like.
    pub kind: MarkKind,
    /// Clockwise turn of the shape as seen on an upright frame, in degrees. Shapes are described as they stand at the
    /// lower edge, pointing up into the image. `None`: to the side that the mark's position is nearest to.
    #[serde(default)]
    pub turn_deg: Option<f64>,
}

/// Kinds of mark; lengths in millimetres on the film. Lines, dots and rings are bright on dark, teeth and notches
/// belong to the opaque frame that borders the image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case", deny_unknown_fields)]
pub enum MarkKind {
    /// Three opaque teeth on the border that point inwards, with a round transparent hole that is the reference point.
    ThreeTooth {
        /// Outer width over the three teeth.
        width_mm: f64,
        /// Of the outer teeth, from the hole's centre inwards.
        outer_height_mm: f64,
        /// Of the tooth in the middle, from the hole's centre inwards.
        middle_height_mm: f64,
        /// Width of the top of the middle tooth and of the gaps beside it.
        middle_width_mm: f64,
        gap_mm: f64,
        /// From the hole's centre inwards to the bottom of the gaps.
        base_mm: f64,
        /// From the hole's centre outwards to the border's edge.
        border_mm: f64,
        hole_diameter_mm: f64,
    },
    /// Two bright lines that cross at a right angle.
    Cross {
        /// From the crossing to the end of an arm.
        arm_mm: f64,
        line_mm: f64,
        /// From the crossing to where the arms begin.
        #[serde(default)]
        gap_mm: f64,
        /// Turn of the lines against the shape's axes, in degrees.
        #[serde(default)]
        lines_deg: f64,
    },
    /// A bright ring with four arms across it that do not reach the centre.
    RingCross {
        /// Of the middle of the ring's line.
        ring_diameter_mm: f64,
        line_mm: f64,
        arm_from_mm: f64,
        arm_to_mm: f64,
        arm_line_mm: f64,
        #[serde(default)]
        lines_deg: f64,
    },
    /// A bright dot, or with `ring_diameter_mm` a dot in a ring.
    Dot {
        diameter_mm: f64,
        #[serde(default)]
        ring_diameter_mm: Option<f64>,
        #[serde(default)]
        ring_line_mm: Option<f64>,
    },
    /// A V-shaped notch of the image into the opaque border; its outer tip is the reference point.
    Notch { width_mm: f64, depth_mm: f64 },
    /// A template that `fiducials --learn` wrote (or one cut by hand), a path beside the camera's file.
    Learned { template: PathBuf },
}

/// What became of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "verdict", rename_all = "snake_case")]
pub enum FrameStatus {
    Ok,
    /// Solved, but a person should look: reservations in plain words.
    Doubtful {
        reasons: Vec<String>,
    },
    /// No interior orientation.
    Failed {
        reasons: Vec<String>,
    },
}

/// Whether a mark was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MarkStatus {
    Ok,
    Doubtful,
    Missing,
}

/// One mark of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkFind {
    /// Name of the camera's mark.
    pub mark: String,
    pub status: MarkStatus,
    /// Where it is; `None` only when missing.
    pub centre: Option<PixelPoint>,
    /// Var x, cov xy, var y of the centre, px².
    pub covariance_px2: Option<[f64; 3]>,
    /// Where the other marks of the frame put it.
    pub predicted: Option<PixelPoint>,
    /// How well the shape fits there, from −1 to 1 (normalised correlation).
    pub score: Option<f64>,
    /// Measured − calibrated (x, y) through the interior orientation, micrometres on the film.
    pub residual_um: Option<[f64; 2]>,
    /// Why it is doubtful or missing.
    pub reason: Option<String>,
}

/// The transform from scan to film.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InteriorModel {
    Similarity,
    Affine,
    Projective,
}

/// Image → film.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InteriorOrientation {
    pub model: InteriorModel,
    /// Row by row the 3 × 3 matrix H, H\[8\] = 1, with (x, y) a [`PixelPoint`] and (X, Y) the camera's millimetres:
    /// `X = (h0·x + h1·y + h2) / w`, `Y = (h3·x + h4·y + h5) / w`, `w = h6·x + h7·y + h8`. For similarity and affine h6
    /// and h7 are zero.
    pub pixel_to_mm: [f64; 9],
    /// √(mean(dX² + dY²)) of the marks used, divisor n, micrometres.
    pub rmse_um: f64,
    /// Standard deviation of unit weight of one coordinate, micrometres: √(v'v / redundancy); `None` without
    /// redundancy.
    pub sigma0_um: Option<f64>,
    /// Covariance of the free coefficients, row by row: of a similarity (a, b, X₀, Y₀) with h0 = m·a, h1 = −b, h3 =
    /// s·m·b, h4 = s·a, s = −1 for y up, m = −1 when mirrored; else h0 to h5 (affine) or h0 to h7. From the marks'
    /// covariances through the fit, which weighs marks alike; larger where the residuals are.
    pub covariance: Vec<Vec<f64>>,
    /// Names of the marks used.
    pub marks: Vec<String>,
    /// Per mark used: measured − calibrated through the same model solved from the others alone, micrometres; `None`
    /// where they do not determine it.
    #[serde(default)]
    pub leave_one_out_um: Vec<Option<[f64; 2]>>,
    /// √(mean(dX² + dY²)) of these, `None` when one is missing.
    #[serde(default)]
    pub leave_one_out_rmse_um: Option<f64>,
    /// Size of a pixel on the film, micrometres.
    pub pixel_um: f64,
    /// The same along the scan's x and y; 0 in files of earlier versions.
    #[serde(default)]
    pub pixel_xy_um: [f64; 2],
    /// Clockwise turn of the frame in the scan, degrees: 0 when the film's right is the scan's right.
    pub rotation_deg: f64,
    /// The scan shows the film from the wrong side.
    pub mirrored: Handedness,
}

impl InteriorOrientation {
    /// Pixels → millimetres; `None` on or beyond the horizon of a projective orientation.
    pub fn to_mm(&self, p: PixelPoint) -> Option<[f64; 2]> {
        let h = &self.pixel_to_mm;
        let w = h[6] * p.x + h[7] * p.y + h[8];
        (w > 0.0).then(|| [(h[0] * p.x + h[1] * p.y + h[2]) / w, (h[3] * p.x + h[4] * p.y + h[5]) / w])
    }

    /// Millimetres → pixels; `None` when the orientation is singular there.
    pub fn to_pixel(&self, mm: [f64; 2]) -> Option<PixelPoint> {
        let inverse = nalgebra::Matrix3::from_row_slice(&self.pixel_to_mm).try_inverse()?;
        let v = inverse * nalgebra::Vector3::new(mm[0], mm[1], 1.0);
        let p = PixelPoint { x: v.x / v.z, y: v.y / v.z };
        (p.x.is_finite() && p.y.is_finite()).then_some(p)
    }
}

/// Everything about one scan; this is the frame's JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameResult {
    #[serde(serialize_with = "autoref_raster::path_text::one")]
    pub path: PathBuf,
    /// File name without folder and extension.
    pub name: String,
    pub width: u64,
    pub height: u64,
    pub status: FrameStatus,
    pub marks: Vec<MarkFind>,
    #[serde(rename = "inner")]
    pub interior: Option<InteriorOrientation>,
    /// What is worth knowing but is no reason to look.
    #[serde(default)]
    pub notes: Vec<String>,
    pub elapsed_s: f64,
}

impl FrameResult {
    /// Whether the frame has an interior orientation that nothing speaks against.
    pub fn is_ok(&self) -> bool {
        self.status == FrameStatus::Ok
    }
}
