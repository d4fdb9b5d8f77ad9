//! The marks as geometry: what each kind shows at a place, in millimetres from its reference point. The shape's frame
//! has u to the right and v inwards, as the mark stands at the lower edge of an upright frame.

use super::types::MarkKind;

/// What lies at a place of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// The opaque frame: dark.
    Opaque,
    /// A line or dot exposed into the opaque frame: bright, always the same.
    Bright,
    /// Transparent: shows the image.
    Clear,
    /// The shape says nothing about it.
    Unknown,
}

/// Whether the lengths make sense together.
pub fn is_sound(kind: &MarkKind) -> bool {
    let ok = |v: f64| v.is_finite() && v > 0.0 && v < 50.0;
    match kind {
        MarkKind::ThreeTooth {
            width_mm,
            outer_height_mm,
            middle_height_mm,
            middle_width_mm,
            gap_mm,
            base_mm,
            border_mm,
            hole_diameter_mm,
        } => {
            [*width_mm, *outer_height_mm, *middle_height_mm, *middle_width_mm, *gap_mm, *border_mm, *hole_diameter_mm]
                .into_iter()
                .all(ok)
                && base_mm.is_finite()
                && middle_width_mm + 2.0 * gap_mm < *width_mm
                && *base_mm < outer_height_mm.min(*middle_height_mm)
                && hole_diameter_mm < border_mm
        }
        MarkKind::Cross { arm_mm, line_mm, gap_mm, lines_deg } => {
            ok(*arm_mm) && ok(*line_mm) && *gap_mm >= 0.0 && gap_mm < arm_mm && lines_deg.is_finite()
        }
        MarkKind::RingCross { ring_diameter_mm, line_mm, arm_from_mm, arm_to_mm, arm_line_mm, lines_deg } => {
            [*ring_diameter_mm, *line_mm, *arm_to_mm, *arm_line_mm].into_iter().all(ok)
                && *arm_from_mm >= 0.0
                && arm_from_mm < arm_to_mm
                && line_mm < ring_diameter_mm
                && lines_deg.is_finite()
        }
        MarkKind::Dot { diameter_mm, ring_diameter_mm, ring_line_mm } => {
            ok(*diameter_mm)
                && ring_diameter_mm.is_none_or(|d| ok(d) && d > *diameter_mm)
                && ring_line_mm.is_none_or(ok)
                && ring_diameter_mm.is_some() == ring_line_mm.is_some()
        }
        MarkKind::Notch { width_mm, depth_mm } => ok(*width_mm) && ok(*depth_mm),
        MarkKind::Learned { .. } => true,
    }
}

/// A shape without its mirror image being another: all the drawn kinds. Learned templates may be anything.
pub fn is_symmetric(kind: &MarkKind) -> bool {
    !matches!(kind, MarkKind::Learned { .. })
}

/// Half width and the reach outwards and inwards of what the shape describes, millimetres: (u, −v, +v).
pub fn reach_mm(kind: &MarkKind) -> (f64, f64, f64) {
    let round = |r: f64| (r, r, r);
    match kind {
        MarkKind::ThreeTooth { width_mm, outer_height_mm, middle_height_mm, border_mm, .. } => {
            let margin = 0.12 * width_mm;
            (0.5 * width_mm + margin, *border_mm, outer_height_mm.max(*middle_height_mm) + margin)
        }
        MarkKind::Cross { arm_mm, line_mm, .. } => round(arm_mm + 3.0 * line_mm),
        MarkKind::RingCross { ring_diameter_mm, line_mm, arm_to_mm, .. } => {
            round(arm_to_mm.max(0.5 * ring_diameter_mm) + line_mm)
        }
        MarkKind::Dot { diameter_mm, ring_diameter_mm, ring_line_mm } => {
            round((0.5 * ring_diameter_mm.unwrap_or(0.0) + ring_line_mm.unwrap_or(0.0)).max(1.3 * diameter_mm))
        }
        MarkKind::Notch { width_mm, depth_mm } => (0.9 * width_mm, 0.6 * depth_mm, 1.5 * depth_mm),
        MarkKind::Learned { .. } => round(0.0),
    }
}

/// The smallest thing that must survive in a coarse picture of the mark, millimetres.
pub fn detail_mm(kind: &MarkKind) -> f64 {
    match kind {
        MarkKind::ThreeTooth { gap_mm, middle_width_mm, .. } => gap_mm.min(*middle_width_mm),
        MarkKind::Cross { line_mm, .. } => *line_mm,
        MarkKind::RingCross { line_mm, .. } => *line_mm,
        MarkKind::Dot { diameter_mm, ring_line_mm, .. } => 0.5 * ring_line_mm.unwrap_or(*diameter_mm),
        MarkKind::Notch { width_mm, .. } => 0.25 * width_mm,
        MarkKind::Learned { .. } => 0.0,
    }
}

/// Radius of the part that alone defines the reference point, where that is not the whole shape: the hole of a toothed
/// mark and the opaque ring around it.
pub fn point_radius_mm(kind: &MarkKind) -> Option<f64> {
    match kind {
        MarkKind::ThreeTooth { hole_diameter_mm, .. } => Some(1.1 * hole_diameter_mm),
        _ => None,
    }
}

/// The thinnest line, dot or space between, millimetres. 0 where that is not known and for notches with sharp tips.
pub fn thinnest_mm(kind: &MarkKind) -> f64 {
    let space = |mm: f64| if mm > 0.0 { mm } else { f64::INFINITY };
    let least = |lengths: &[f64]| lengths.iter().copied().fold(f64::INFINITY, f64::min);
    match *kind {
        MarkKind::ThreeTooth {
            outer_height_mm,
            middle_height_mm,
            middle_width_mm,
            gap_mm,
            base_mm,
            hole_diameter_mm,
            border_mm,
            width_mm,
        } => {
            let outer_tooth = 0.5 * (width_mm - middle_width_mm) - gap_mm;
            let high = outer_height_mm.min(middle_height_mm) - base_mm;
            // Teeth lean by an eighth of their height on either side.
            let lean = 0.25 * (outer_height_mm.max(middle_height_mm) - base_mm);
            let around_hole = border_mm.min(base_mm.abs()) - 0.5 * hole_diameter_mm;
            least(&[middle_width_mm - lean, outer_tooth - lean, gap_mm, hole_diameter_mm, around_hole, high]).max(0.0)
        }
        MarkKind::Cross { line_mm, gap_mm, arm_mm, .. } => least(&[line_mm, space(2.0 * gap_mm), arm_mm - gap_mm]),
        MarkKind::RingCross { ring_diameter_mm, line_mm, arm_from_mm, arm_to_mm, arm_line_mm, .. } => {
            let inside = 0.5 * (ring_diameter_mm - line_mm);
            let before_ring = space(arm_from_mm - inside - line_mm);
            least(&[line_mm, arm_line_mm, inside, space(2.0 * arm_from_mm), arm_to_mm - arm_from_mm, before_ring])
        }
        MarkKind::Dot { diameter_mm, ring_diameter_mm, ring_line_mm } => {
            let ring = ring_diameter_mm.zip(ring_line_mm);
            let between = ring.map_or(f64::INFINITY, |(d, line)| space(0.5 * (d - line - diameter_mm)));
            least(&[diameter_mm, ring_line_mm.unwrap_or(f64::INFINITY), between])
        }
        MarkKind::Notch { width_mm, depth_mm } if width_mm >= 1.35 * depth_mm => depth_mm,
        MarkKind::Notch { .. } | MarkKind::Learned { .. } => 0.0,
    }
}

/// What the kind shows at (u, v), millimetres from the reference point.
pub fn tone(kind: &MarkKind, u: f64, v: f64) -> Tone {
    Outlines::of(kind).tone(u, v)
}

/// A kind with what does not change from place to place.
pub struct Outlines<'a> {
    kind: &'a MarkKind,
    reach: (f64, f64, f64),
    /// Sine and cosine of the lines' direction, where they are turned at all.
    lines: Option<(f64, f64)>,
}

impl Outlines<'_> {
    /// What does not change from place to place, worked out.
    pub fn of(kind: &MarkKind) -> Outlines<'_> {
        let lines_deg = match kind {
            MarkKind::Cross { lines_deg, .. } | MarkKind::RingCross { lines_deg, .. } => *lines_deg,
            _ => 0.0,
        };
        let lines = (lines_deg != 0.0).then(|| lines_deg.to_radians().sin_cos());
        Outlines { kind, reach: reach_mm(kind), lines }
    }

    /// Along and across the lines.
    fn turned(&self, u: f64, v: f64) -> (f64, f64) {
        self.lines.map_or((u, v), |(s, c)| (c * u + s * v, -s * u + c * v))
    }

    /// What the kind shows at (u, v), millimetres from the reference point.
    pub fn tone(&self, u: f64, v: f64) -> Tone {
        let (half, out, inward) = self.reach;
        match *self.kind {
            MarkKind::ThreeTooth { .. } if u.abs() > half || v < -out || v > inward => Tone::Unknown,
            MarkKind::ThreeTooth {
                width_mm,
                outer_height_mm,
                middle_height_mm,
                middle_width_mm,
                gap_mm,
                base_mm,
                hole_diameter_mm,
                ..
            } => {
                if 4.0 * (u * u + v * v) < hole_diameter_mm * hole_diameter_mm {
                    return Tone::Clear;
                }
                let a = u.abs();
                let middle = 0.5 * middle_width_mm;
                // The sides of the teeth lean towards the reference point, so that teeth are narrower at their tops.
                let lean = 0.12 * (v - base_mm).max(0.0);
                let top = if a < middle - lean {
                    middle_height_mm
                } else if a < middle + gap_mm + 0.5 * lean {
                    base_mm
                } else if a < 0.5 * width_mm - lean {
                    outer_height_mm
                } else {
                    // Beside the teeth the border ends at the level of the gaps' bottoms.
                    base_mm - 0.35 * (outer_height_mm - base_mm)
                };
                if v < top { Tone::Opaque } else { Tone::Clear }
            }
            MarkKind::Cross { arm_mm, line_mm, gap_mm, .. } => {
                let (p, q) = self.turned(u, v);
                let (long, across) = (p.abs().max(q.abs()), p.abs().min(q.abs()));
                if u * u + v * v > out * out {
                    Tone::Unknown
                } else if across < 0.5 * line_mm && long < arm_mm && long >= gap_mm {
                    Tone::Bright
                } else {
                    Tone::Opaque
                }
            }
            MarkKind::RingCross { ring_diameter_mm, line_mm, arm_from_mm, arm_to_mm, arm_line_mm, .. } => {
                let (p, q) = self.turned(u, v);
                let (long, across) = (p.abs().max(q.abs()), p.abs().min(q.abs()));
                let r = (u * u + v * v).sqrt();
                let arm = across < 0.5 * arm_line_mm && (arm_from_mm..arm_to_mm).contains(&long);
                if r > out {
                    Tone::Unknown
                } else if arm || (r - 0.5 * ring_diameter_mm).abs() < 0.5 * line_mm {
                    Tone::Bright
                } else {
                    Tone::Opaque
                }
            }
            MarkKind::Dot { diameter_mm, ring_diameter_mm, ring_line_mm } => {
                let r = (u * u + v * v).sqrt();
                let ring = ring_diameter_mm
                    .zip(ring_line_mm)
                    .is_some_and(|(diameter, line)| (r - 0.5 * diameter).abs() < 0.5 * line);
                if r > out {
                    Tone::Unknown
                } else if ring || r < 0.5 * diameter_mm {
                    Tone::Bright
                } else {
                    Tone::Opaque
                }
            }
            MarkKind::Notch { .. } if u.abs() > half || v < -out || v > inward => Tone::Unknown,
            MarkKind::Notch { width_mm, depth_mm } => {
                // The tip is the reference point; the border's edge lies one depth further in.
                let inside = v > depth_mm || (v > 0.0 && u.abs() < 0.5 * width_mm * v / depth_mm);
                if inside { Tone::Clear } else { Tone::Opaque }
            }
            MarkKind::Learned { .. } => Tone::Unknown,
        }
    }
}
