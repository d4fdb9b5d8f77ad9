//! Classes of slope, aspect and height, and zones.

use crate::zones::Zones;

use super::scan::Cell;

const ASPECTS: [&str; 9] = ["N", "NE", "E", "SE", "S", "SW", "W", "NW", "flat"];
/// Most bands of height.
const HEIGHT_BANDS: f64 = 12.0;

/// Which groups there are, and which a cell belongs to.
pub(super) struct Groups {
    pub(super) slope_classes: usize,
    pub(super) height_low: f64,
    pub(super) height_step: f64,
    pub(super) names: Vec<(String, String)>,
    pub(super) first_height: usize,
    pub(super) first_zone: usize,
}

impl Groups {
    pub(super) fn new(slope_limits: &[f64], heights: (f64, f64), zones: Option<&Zones>) -> Groups {
        let mut names = vec![("all".to_string(), "all".to_string())];
        for (i, limit) in slope_limits.iter().enumerate() {
            let upper = slope_limits.get(i + 1).map_or("inf".to_string(), |v| format!("{v}%"));
            names.push(("slope".into(), format!("[{limit}%;{upper}[")));
        }
        names.extend(ASPECTS.iter().map(|a| ("aspect".to_string(), (*a).to_string())));
        let range = (heights.1 - heights.0).max(1e-3);
        let rough = range / HEIGHT_BANDS;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].iter().map(|m| m * power).find(|s| *s >= rough).unwrap_or(rough);
        let low = (heights.0 / step).floor() * step;
        let first_height = names.len();
        let bands = ((heights.1 - low) / step).floor() as usize + 1;
        for band in 0..bands {
            let from = low + band as f64 * step;
            names.push(("height".into(), format!("[{from} m;{} m[", from + step)));
        }
        let first_zone = names.len();
        if let Some(zones) = zones {
            names.extend(zones.names().iter().map(|name| ("zone".to_string(), name.clone())));
            names.push(("zone".into(), "outside all zones".into()));
        }
        Groups {
            slope_classes: slope_limits.len(),
            height_low: low,
            height_step: step,
            names,
            first_height,
            first_zone,
        }
    }

    /// The groups that a cell belongs to, in `out`.
    #[inline]
    pub(super) fn list(&self, cell: &Cell<'_>, out: &mut Vec<usize>) {
        out.clear();
        out.push(0);
        let facing = cell.facing;
        if facing.slope > 0 {
            out.push(usize::from(facing.slope));
        }
        if facing.aspect > 0 {
            out.push(self.slope_classes + usize::from(facing.aspect));
        }
        let band = ((f64::from(cell.height) - self.height_low) / self.height_step) as usize;
        out.push((self.first_height + band).min(self.first_zone - 1));
        if self.first_zone < self.names.len() {
            if cell.zones.is_empty() {
                out.push(self.names.len() - 1);
            }
            out.extend(cell.zones.iter().map(|zone| self.first_zone + *zone as usize));
        }
    }
}
