//! The plane of a fisheye from that of a perspective.

use serde::{Deserialize, Serialize};

use super::linear::Linear;

/// How the angle θ off the axis becomes a distance from the centre, in units of the scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Law {
    /// θ.
    Equidistant,
    /// 2 sin(θ/2).
    Equisolid,
    /// 2 tan(θ/2).
    Stereographic,
}

/// Takes the place at r = tan θ from `centre_px`, `scale_px` as unit, to the distance that the law has for θ: what
/// MicMac's fisheyes do to the plane of its perspective (`FishEye_10_5_5` and its kin) before their polynomials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fisheye {
    pub law: Law,
    pub centre_px: [f64; 2],
    pub scale_px: f64,
}

impl Fisheye {
    pub(super) fn linear(&self, at: [f64; 2]) -> Linear {
        let [x, y] = [0, 1].map(|k| (at[k] - self.centre_px[k]) / self.scale_px);
        let r = x.hypot(y);
        let angle = r.atan();
        let (half, per_r2) = (angle / 2.0, 1.0 / (1.0 + r * r));
        let (distance, slope) = match self.law {
            Law::Equidistant => (angle, per_r2),
            Law::Equisolid => (2.0 * half.sin(), half.cos() * per_r2),
            Law::Stereographic => (2.0 * half.tan(), per_r2 / (half.cos() * half.cos())),
        };
        // Across the radius places come nearer by the ratio, along it by the slope.
        if r < 1e-9 {
            return (at, [[1.0, 0.0], [0.0, 1.0]]);
        }
        let ratio = distance / r;
        let [ex, ey] = [x / r, y / r];
        let more = slope - ratio;
        let to = [0, 1].map(|k| self.centre_px[k] + self.scale_px * ratio * [x, y][k]);
        (to, [[ratio + more * ex * ex, more * ex * ey], [more * ex * ey, ratio + more * ey * ey]])
    }

    pub(super) fn undo(&self, at: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = [0, 1].map(|k| (at[k] - self.centre_px[k]) / self.scale_px);
        let r = x.hypot(y);
        let angle = match self.law {
            Law::Equidistant => r,
            Law::Equisolid => 2.0 * (r / 2.0).asin(),
            Law::Stereographic => 2.0 * (r / 2.0).atan(),
        };
        // The plane of a perspective ends at a right angle, an equisolid one before; arcs beyond are no number.
        if angle.is_nan() || angle >= std::f64::consts::FRAC_PI_2 {
            return None;
        }
        let ratio = if r < 1e-9 { 1.0 } else { angle.tan() / r };
        Some([0, 1].map(|k| self.centre_px[k] + self.scale_px * ratio * [x, y][k]))
    }
}
