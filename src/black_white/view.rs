//! The cells that a fit sees.

use super::TargetDetector;
use super::fit::{Fit, Start, fit};
use super::grey::mean_of_cell;
use super::kernels::Sample;
use autoref_raster::Patch;

/// The cells in a disc about the place where a fit starts.
pub(super) struct View {
    pub samples: Vec<Sample>,
    /// Pixels along the side of a cell.
    pub scale: f64,
    /// The patch's corner, pixels.
    pub origin: (f64, f64),
    pub start: Start,
}

impl View {
    /// A disc of `radius` pixels about the start; a target cut by the image's edge or by nodata is no target.
    pub fn of(patch: &Patch, start: Start, radius: f64, most_cells: f64) -> Option<View> {
        let mut size = 1u64;
        while radius / size as f64 > most_cells {
            size *= 2;
        }
        let scale = size as f64;
        let samples = samples(patch, (start.x, start.y), radius, size);
        if (samples.len() as f64) < 0.75 * std::f64::consts::PI * (radius / scale).powi(2) {
            return None;
        }
        let origin = (patch.window.x as f64, patch.window.y as f64);
        let start = Start {
            x: (start.x - origin.0) / scale,
            y: (start.y - origin.1) / scale,
            width: start.width / scale,
            blur: (start.blur / scale).max(0.4),
            ..start
        };
        Some(View { samples, scale, origin, start })
    }

    pub fn in_pixels(&self, fit: &Fit) -> Fit {
        let scale = self.scale;
        Fit {
            x: self.origin.0 + fit.x * scale,
            y: self.origin.1 + fit.y * scale,
            widths: fit.widths.map(|w| w * scale),
            blur: fit.blur * scale,
            covariance: fit.covariance.map(|v| v * scale * scale),
            ..*fit
        }
    }

    pub fn in_cells(&self, fit: &Fit) -> Fit {
        let scale = self.scale;
        Fit {
            x: (fit.x - self.origin.0) / scale,
            y: (fit.y - self.origin.1) / scale,
            widths: fit.widths.map(|w| w / scale),
            blur: fit.blur / scale,
            covariance: fit.covariance.map(|v| v / (scale * scale)),
            ..*fit
        }
    }

    /// Fits in image pixels; gives up what is not `hopeful` on the way.
    pub fn fit(&self, detector: &TargetDetector, hopeful: impl Fn(&Fit) -> bool) -> Option<Fit> {
        let hopeful = |sketch: &Fit| hopeful(&self.in_pixels(sketch));
        let found = fit(detector.motif, &self.samples, self.start, detector.skew, hopeful)?;
        Some(self.in_pixels(&found))
    }
}

/// Means of whole cells of `size` pixels within `view` of a place, in cells from the patch's corner.
fn samples(patch: &Patch, at: (f64, f64), view: f64, size: u64) -> Vec<Sample> {
    let (width, height) = (patch.window.width / size, patch.window.height / size);
    let (cx, cy) = ((at.0 - patch.window.x as f64) / size as f64, (at.1 - patch.window.y as f64) / size as f64);
    let reach = view / size as f64;
    let range = |c: f64, len: u64| (c - reach).max(0.0) as u64..((c + reach).ceil().max(0.0) as u64).min(len);
    let mut out = Vec::new();
    for (v, u) in range(cy, height).flat_map(|v| range(cx, width).map(move |u| (v, u))) {
        let (x, y) = (u as f64 + 0.5, v as f64 + 0.5);
        if (x - cx).hypot(y - cy) > reach {
            continue;
        }
        out.extend(mean_of_cell(patch, (u, v), size).map(|level| Sample { x, y, level }));
    }
    out
}
