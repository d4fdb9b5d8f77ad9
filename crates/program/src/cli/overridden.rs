//! What a new georeference changes in the one that the image had.

use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_stream::georef::shown::Found;

use crate::cli::lengths::length;

/// Less is no change to anybody.
const LEAST_M: f64 = 1e-4;
const OVERRIDDEN: &str = "the image's own georeference is overridden";

/// How far a new georeference moves an image, and how it turns and stretches it.
pub struct Overridden {
    pub centre_moved_m: f64,
    /// The corner that moves farthest.
    pub corner_moved_m: f64,
    /// In words, where a corner notices: turned, stretched, mirrored.
    how: Vec<String>,
}

impl Overridden {
    pub fn between(old: &GeoTransform, new: &GeoTransform, (width, height): (u64, u64), metres_per_unit: f64) -> Self {
        let (w, h) = (width as f64, height as f64);
        let moved = |x: f64, y: f64| {
            let (a, b) = (old.apply(PixelPoint { x, y }), new.apply(PixelPoint { x, y }));
            (a.easting - b.easting).hypot(a.northing - b.northing) * metres_per_unit
        };
        let corners = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)];
        Overridden {
            centre_moved_m: moved(w / 2.0, h / 2.0),
            corner_moved_m: corners.into_iter().map(|(x, y)| moved(x, y)).fold(0.0, f64::max),
            how: differences(old, new, w.hypot(h) / 2.0),
        }
    }

    /// `found`: where GDAL finds the new georeference.
    pub fn note(&self, found: &Found) -> String {
        let how = if self.how.is_empty() { String::new() } else { format!(" ({})", self.how.join(", ")) };
        let (corners_m, centre_m) = (self.corner_moved_m, self.centre_moved_m);
        let moves = if corners_m < LEAST_M {
            format!("corners move by less than {}{how}", length(LEAST_M))
        } else {
            format!("corners move by up to {}, its centre by {}{how}", length(corners_m), length(centre_m))
        };
        match found {
            Found::InImage => format!("{OVERRIDDEN}; its {moves}"),
            Found::In(_) | Found::Nowhere => {
                format!("by the new georeference the image's {moves}; the image itself keeps the one that it has")
            }
            Found::Unknown => format!("by the new georeference the image's {moves}"),
        }
    }

    /// The same where it is not known how far the image moves; `None` where nothing can be said.
    pub fn plain(found: &Found) -> Option<&'static str> {
        match found {
            Found::InImage => Some(OVERRIDDEN),
            Found::In(_) | Found::Nowhere => Some("the image itself keeps the georeference that it has"),
            Found::Unknown => None,
        }
    }
}

/// How `new` turns, stretches and mirrors what `old` says; nothing that a corner `half_px` from the centre moves less
/// than a pixel by.
fn differences(old: &GeoTransform, new: &GeoTransform, half_px: f64) -> Vec<String> {
    const LEAST_PX: f64 = 1.0;
    let determinant = |g: &GeoTransform| g.0[1] * g.0[5] - g.0[2] * g.0[4];
    let (was, is) = (determinant(old), determinant(new));
    let mut how = Vec::new();
    // A georeference without an area has neither a direction nor a scale to compare with.
    if was == 0.0 || !was.is_finite() {
        return how;
    }
    if (was > 0.0) != (is > 0.0) {
        how.push("mirrored".to_owned());
    } else {
        // Both columns together, so that shear does not pass for a turn.
        let direction = |g: &GeoTransform, sign: f64| (g.0[4] - sign * g.0[2]).atan2(g.0[1] + sign * g.0[5]);
        let sign = was.signum();
        let turn = direction(new, sign) - direction(old, sign);
        let turn = turn.sin().atan2(turn.cos());
        if turn.abs() * half_px >= LEAST_PX {
            let way = if turn > 0.0 { "anticlockwise" } else { "clockwise" };
            how.push(format!("turned by {:.3}° {way}", turn.abs().to_degrees()));
        }
    }
    let ratio = new.scale() / old.scale();
    if (ratio - 1.0).abs() * half_px >= LEAST_PX {
        how.push(if (0.8..1.25).contains(&ratio) {
            format!("pixels {:.3} % {}", 100.0 * (ratio - 1.0).abs(), if ratio > 1.0 { "larger" } else { "smaller" })
        } else {
            format!("pixels {ratio:.4} times as large")
        });
    }
    how
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (u64, u64) = (2000, 2000);

    fn about_the_centre(scale: f64, turn_deg: f64) -> GeoTransform {
        let (sin, cos) = turn_deg.to_radians().sin_cos();
        let (a, b) = (scale * cos, scale * sin);
        // The centre, (1000, 1000), stays at (500, 500).
        GeoTransform([500.0 - 1000.0 * (a + b), a, b, 500.0 - 1000.0 * (b - a), b, -a])
    }

    /// The centre alone was looked at, and a turn or another scale about it passed for agreement.
    #[test]
    fn a_turn_and_a_scale_about_the_centre_are_told() {
        let right = about_the_centre(0.03, 0.0);
        let turned = Overridden::between(&about_the_centre(0.03, 90.0), &right, SIZE, 1.0);
        assert!(
            turned.centre_moved_m < 1e-9 && (turned.corner_moved_m - 60.0).abs() < 1e-6,
            "{}",
            turned.note(&Found::InImage)
        );
        assert!(
            turned.note(&Found::InImage).contains("turned by 90.000° clockwise"),
            "{}",
            turned.note(&Found::InImage)
        );
        let scaled = Overridden::between(&about_the_centre(0.03 / 1.003, 0.0), &right, SIZE, 1.0).note(&Found::InImage);
        assert!(scaled.contains("(pixels 0.300 % larger)"), "{scaled}");
        let feet = Overridden::between(&about_the_centre(0.03 / 0.3048, 0.0), &right, SIZE, 1.0).note(&Found::InImage);
        assert!(feet.contains("(pixels 0.3048 times as large)"), "{feet}");
    }

    #[test]
    fn what_no_corner_notices_is_not_told() {
        let note = Overridden::between(&about_the_centre(0.03, 0.01), &about_the_centre(0.03, 0.0), SIZE, 1.0)
            .note(&Found::InImage);
        assert!(!note.contains('('), "{note}");
    }

    #[test]
    fn a_mirrored_georeference_is_told() {
        let south_up = GeoTransform([0.0, 0.03, 0.0, 0.0, 0.0, 0.03]);
        let note = Overridden::between(&south_up, &about_the_centre(0.03, 0.0), SIZE, 1.0).note(&Found::InImage);
        assert!(note.contains("(mirrored)"), "{note}");
    }
}
