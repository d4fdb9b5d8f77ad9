//! The cheap gates: what a region's integers alone can rule out. They follow the limits of the 2016 prototype (Scripts
//! A.9 and A.55), computed from exact moments instead of pixels.

use crate::profile::{Profile, Shape};
use crate::segment::label::Region;
use autoref_raster::error::Result;

/// Limits on regions, in pixels, ready for use.
#[derive(Clone, Debug, PartialEq)]
pub struct Gates {
    area: (u64, u64),
    side: (u64, u64),
    eccentricity: (f64, f64),
    tightness: (f64, f64),
    /// Least tightness of what is about as wide as it is high: thin crosses that lie along the pixels.
    thin_tightness: f64,
    area_per_perimeter: (f64, f64),
    mark_side_px: (f64, f64),
    /// Largest area of one mark; `area.1` may be that of several that touch.
    single_area: u64,
}

/// A cross of 40 px with arms of 5 px fills 0.23 of its bounds, one with arms of 3 px 0.14.
const THIN_TIGHTNESS: f64 = 0.12;
/// Eccentricity of a thin figure at most: of lines and borders, which are as thin, it is larger.
const THIN_ECCENTRICITY: f64 = 0.5;
/// How many marks that touch are looked at as one region when the profile asks for it.
const MOST_TOUCHING: u64 = 16;

impl Gates {
    /// Absent limits are derived from the range of mark sides. Colour finds a faded or blurred small mark only in part
    /// and a saturated one with its blurred border, so the derived limits are wide: a sixth of the smallest mark's area
    /// to the largest mark's with 2 pixels of border, and the diagonal with that border for the side.
    ///
    /// # Errors
    /// [`autoref_raster::Error::Usage`] when the profile is not valid, or gives metres only and `gsd_m` is unknown.
    pub fn new(profile: &Profile, gsd_m: Option<f64>) -> Result<Gates> {
        profile.validate()?;
        let (low, high) = profile.side_range_px(gsd_m)?;
        let g = &profile.gates;
        let outer = high + 4.0;
        let max_side = g.max_side_px.unwrap_or((outer * std::f64::consts::SQRT_2).ceil() as u64);
        let single_area = g.max_area_px.unwrap_or((outer * outer).ceil() as u64);
        // Marks in a row: long, thin and not tight.
        let split = profile.examine.split;
        let (area, side, eccentricity, tightness) = if split {
            (MOST_TOUCHING * single_area, MOST_TOUCHING.isqrt() * max_side, 1.0, 0.05)
        } else {
            (single_area, max_side, 0.97, 0.25)
        };
        let may_be_thin = g.min_tightness.is_none() && matches!(profile.shape, Shape::Any | Shape::Cross);
        Ok(Gates {
            area: (g.min_area_px.unwrap_or(((low * low / 6.0).floor() as u64).max(3)), area),
            side: (g.min_side_px.unwrap_or(if low >= 3.0 { 2 } else { 1 }), side),
            eccentricity: (g.min_eccentricity.unwrap_or(0.0), g.max_eccentricity.unwrap_or(eccentricity)),
            tightness: (g.min_tightness.unwrap_or(tightness), g.max_tightness.unwrap_or(1.0)),
            thin_tightness: if may_be_thin { THIN_TIGHTNESS } else { f64::INFINITY },
            area_per_perimeter: (
                g.min_area_per_perimeter_px.unwrap_or(0.0),
                g.max_area_per_perimeter_px.unwrap_or(f64::INFINITY),
            ),
            mark_side_px: (low, high),
            single_area,
        })
    }

    /// Longest bounding box side that can pass: a labeller may forget the pixels, not the existence, of anything
    /// longer.
    pub fn max_side_px(&self) -> u64 {
        self.side.1
    }

    /// Smallest area that can pass.
    pub fn min_area_px(&self) -> u64 {
        self.area.0
    }

    /// Largest area that can pass.
    pub fn max_area_px(&self) -> u64 {
        self.area.1
    }

    /// Smallest and largest side of a mark.
    pub fn mark_side_px(&self) -> (f64, f64) {
        self.mark_side_px
    }

    /// May the region be one mark?
    pub fn single(&self, region: &Region) -> bool {
        region.area <= self.single_area
    }

    /// Does the region pass every gate?
    pub fn region(&self, region: &Region) -> bool {
        let ratio = region.area as f64 / region.perimeter.max(1) as f64;
        ratio >= self.area_per_perimeter.0 && ratio <= self.area_per_perimeter.1 && self.shape(region)
    }

    /// Does it pass every gate but those on its outline's length?
    pub fn shape(&self, region: &Region) -> bool {
        let (w, h) = (region.bounds.width, region.bounds.height);
        if region.area < self.area.0 || region.area > self.area.1 {
            return false;
        }
        if w.min(h) < self.side.0 || w.max(h) > self.side.1 {
            return false;
        }
        let tightness = region.area as f64 / (w * h) as f64;
        if tightness < self.tightness.0.min(self.thin_tightness) || tightness > self.tightness.1 {
            return false;
        }
        let eccentricity = eccentricity(region);
        (self.eccentricity.0..=self.eccentricity.1).contains(&eccentricity)
            && (tightness >= self.tightness.0 || eccentricity <= THIN_ECCENTRICITY)
    }
}

/// Central second moments of a region in px² (xx, xy, yy), with the 1/12 that a pixel's own extent adds, from its exact
/// sums. Sums are taken relative to the bounding box first, so that nothing is lost however far from the origin it
/// lies.
pub fn central_moments(region: &Region) -> [f64; 3] {
    let (x0, y0, n) = (u128::from(region.bounds.x), u128::from(region.bounds.y), u128::from(region.area));
    let sx = region.sum_x - n * x0;
    let sy = region.sum_y - n * y0;
    // Σ(x−x0)² = Σx² − 2·x0·Σx + n·x0²; each left side is not negative, so the order of operations avoids underflow.
    let sxx = region.sum_xx + n * x0 * x0 - 2 * x0 * region.sum_x;
    let syy = region.sum_yy + n * y0 * y0 - 2 * y0 * region.sum_y;
    let sxy = region.sum_xy + n * x0 * y0 - x0 * region.sum_y - y0 * region.sum_x;
    let n = n as f64;
    let (mx, my) = (sx as f64 / n, sy as f64 / n);
    [sxx as f64 / n - mx * mx + 1.0 / 12.0, sxy as f64 / n - mx * my, syy as f64 / n - my * my + 1.0 / 12.0]
}

/// Area in px² of the rectangle with a region's second moments, and the larger and the smaller of these.
pub(super) fn moments_rectangle(region: &Region) -> (f64, [f64; 2]) {
    let [xx, xy, yy] = central_moments(region);
    let (middle, half_gap) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
    (12.0 * (xx * yy - xy * xy).max(0.0).sqrt(), [middle + half_gap, middle - half_gap])
}

/// Eccentricity of the ellipse with the region's second moments: 0 for a circle, 1 for a line.
pub fn eccentricity(region: &Region) -> f64 {
    let [xx, xy, yy] = central_moments(region);
    let half_gap = (((xx - yy) / 2.0).powi(2) + xy * xy).sqrt();
    let (large, small) = ((xx + yy) / 2.0 + half_gap, (xx + yy) / 2.0 - half_gap);
    (1.0 - (small / large).clamp(0.0, 1.0)).sqrt()
}

/// Centroid of a region in image coordinates, pixel corners at whole numbers.
pub fn centroid(region: &Region) -> (f64, f64) {
    let n = u128::from(region.area);
    let axis = |sum: u128, start: u64| start as f64 + (sum - n * u128::from(start)) as f64 / n as f64 + 0.5;
    (axis(region.sum_x, region.bounds.x), axis(region.sum_y, region.bounds.y))
}

/// Area of a region over that of a rectangle with the same second moments, and the ratio of the larger to the smaller
/// of these.
pub(super) fn compactness(region: &Region) -> (f64, f64) {
    let (rectangle_px, [larger, smaller]) = moments_rectangle(region);
    (region.area as f64 / rectangle_px.max(0.012), larger / smaller.max(1e-6))
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::window::Window;

    /// The region of the pixels of `window` for which `inside` holds; perimeter is left at the window's.
    fn region(window: Window, inside: impl Fn(u64, u64) -> bool) -> Region {
        let mut r = Region {
            first: (window.y, window.x),
            bounds: window,
            area: 0,
            sum_x: 0,
            sum_y: 0,
            sum_xx: 0,
            sum_xy: 0,
            sum_yy: 0,
            perimeter: 2 * (window.width + window.height),
        };
        for y in window.y..window.bottom() {
            for x in (window.x..window.right()).filter(|&x| inside(x, y)) {
                let (x, y) = (u128::from(x), u128::from(y));
                r.area += 1;
                r.sum_x += x;
                r.sum_y += y;
                r.sum_xx += x * x;
                r.sum_xy += x * y;
                r.sum_yy += y * y;
            }
        }
        r
    }

    #[test]
    fn moments_are_exact_far_from_the_origin() {
        let far = 3_000_000_000;
        let near = central_moments(&region(Window::new(0, 0, 9, 5), |x, y| (x * y) % 3 != 1));
        let away = central_moments(&region(Window::new(far, far, 9, 5), |x, y| ((x - far) * (y - far)) % 3 != 1));
        assert_eq!(near, away);
        let (x, y) = centroid(&region(Window::new(far, 7, 4, 2), |_, _| true));
        assert_eq!((x, y), (far as f64 + 2.0, 8.0));
    }

    #[test]
    fn gates_take_marks_and_drop_the_rest() {
        let gates = Gates::new(&Profile::builtin("orange").expect("shipped"), None).expect("sizes are in pixels");
        let full = |w, h| region(Window::new(1000, 2000, w, h), |_, _| true);
        for side in [3, 5, 10, 30, 62] {
            assert!(gates.region(&full(side, side)), "{side}");
        }
        assert!(!gates.region(&full(1, 12)), "a line");
        assert!(!gates.region(&full(4, 40)), "a kerb");
        assert!(!gates.region(&full(200, 200)), "a roof");
        assert!(!gates.region(&full(1, 1)), "a speck");
        let hollow = region(Window::new(0, 0, 40, 40), |x, y| x == 0 || y == 0 || x == 39 || y == 39);
        assert!(!gates.region(&hollow));
        let cross = |wide: u64, far: u64| {
            let arm = |v: u64| v.abs_diff(20) <= wide / 2;
            region(Window::new(0, 0, far, 41), move |x, y| arm(x) || arm(y))
        };
        assert!(gates.region(&cross(4, 41)), "arms of 5 px along the pixels");
        assert!(gates.region(&cross(2, 41)), "arms of 3 px");
        assert!(!gates.region(&cross(2, 62)), "kerbs that cross");
        assert!(eccentricity(&full(8, 8)) < 1e-6);
    }

    #[test]
    fn metres_need_a_pixel_size() {
        let mut profile = Profile::builtin("orange").expect("shipped");
        profile.size = crate::profile::Size { min_px: None, max_px: None, min_m: Some(0.2), max_m: Some(0.6) };
        assert!(Gates::new(&profile, None).is_err());
        let gates = Gates::new(&profile, Some(0.03)).expect("now it is known");
        assert!((gates.mark_side_px().1 - 20.0).abs() < 1e-12);
    }
}
