//! The 2-D similarity image → map in closed form.
//!
//! In complex numbers, with z = x − i·y (the image turned so that y runs up) and w = easting + i·northing, the model is
//! w = a·z + b; |a| is the ground size of a pixel and arg a the rotation, anticlockwise from east. Weighted least
//! squares gives a = Σ p·conj(z−z̄)·(w−w̄) / Σ p·|z−z̄|². This is the 2-D case of B. K. P. Horn, "Closed-form solution
//! of absolute orientation using unit quaternions", 1987, and of S. Umeyama, "Least-squares estimation of
//! transformation parameters between two point patterns", 1991 (eq. 34–43): in the plane, and with the scale that
//! minimises the residuals on the map, they are the same. A mirrored image is turned over first: z = −x − i·y.

use serde::{Deserialize, Serialize};

use autoref_raster::coords::{GeoTransform, Handedness, MapPoint, PixelPoint};

/// Image → map: `easting = scale·(cos·x + sin·y) + e0`, and so on, as the complex pair `a`, `b` of w = a·(±x − i·y) +
/// b, with −x for a mirrored image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// Scale · cos, metres per pixel; the angle counts anticlockwise from east.
    pub a_re: f64,
    /// Scale · sin, likewise.
    pub a_im: f64,
    /// Map coordinates of the image's origin.
    pub easting_0: f64,
    /// Likewise.
    pub northing_0: f64,
    /// The image shows the ground as a mirror does. Absent in JSON when it does not.
    #[serde(default, skip_serializing_if = "is_as_is")]
    pub mirrored: Handedness,
}

fn is_as_is(handedness: &Handedness) -> bool {
    !handedness.is_mirrored()
}

/// An image point, or a step between two, with y upwards and not mirrored.
pub(crate) fn upright(x_px: f64, y_px: f64, mirrored: Handedness) -> (f64, f64) {
    (mirrored.sign() * x_px, -y_px)
}

impl Similarity {
    /// Image (pixels, y down) → map (metres).
    pub fn apply(&self, p: PixelPoint) -> MapPoint {
        let (x, y) = upright(p.x, p.y, self.mirrored);
        MapPoint {
            easting: self.easting_0 + self.a_re * x - self.a_im * y,
            northing: self.northing_0 + self.a_im * x + self.a_re * y,
        }
    }

    /// Map → image. The similarity must not be degenerate (scale zero), which no constructor here returns.
    pub fn invert(&self, m: MapPoint) -> PixelPoint {
        let (e, n) = (m.easting - self.easting_0, m.northing - self.northing_0);
        let square = self.a_re * self.a_re + self.a_im * self.a_im;
        let x = (self.a_re * e + self.a_im * n) / square;
        PixelPoint { x: self.mirrored.sign() * x, y: -(self.a_re * n - self.a_im * e) / square }
    }

    /// Ground size of a pixel, metres.
    pub fn scale_m_per_px(&self) -> f64 {
        length(self.a_re, self.a_im)
    }

    /// Anticlockwise from east, degrees in (−180, 180].
    pub fn rotation_deg(&self) -> f64 {
        self.a_im.atan2(self.a_re).to_degrees()
    }

    /// The same as GDAL writes it, about pixel corners.
    pub fn geotransform(&self) -> GeoTransform {
        let sign = self.mirrored.sign();
        GeoTransform([self.easting_0, sign * self.a_re, self.a_im, self.northing_0, sign * self.a_im, -self.a_re])
    }

    /// The same ground seen through a mirror: of an image that was turned over left to right, `width_px` wide, the
    /// transform of the image as it was.
    pub fn mirrored(&self, width_px: f64) -> Similarity {
        let sign = self.mirrored.sign();
        Similarity {
            easting_0: self.easting_0 + sign * self.a_re * width_px,
            northing_0: self.northing_0 + sign * self.a_im * width_px,
            mirrored: Handedness::from(!self.mirrored.is_mirrored()),
            ..*self
        }
    }

    /// The similarity through two pairs of an image that is not mirrored, or `None` when the image points coincide.
    pub fn through(p: [PixelPoint; 2], m: [MapPoint; 2]) -> Option<Similarity> {
        let (dx, dy) = upright(p[1].x - p[0].x, p[1].y - p[0].y, Handedness::AsIs);
        let square = dx * dx + dy * dy;
        if square <= 0.0 || !square.is_finite() {
            return None;
        }
        let (de, dn) = (m[1].easting - m[0].easting, m[1].northing - m[0].northing);
        let (a_re, a_im) = ((dx * de + dy * dn) / square, (dx * dn - dy * de) / square);
        Some(anchored(a_re, a_im, Handedness::AsIs, p[0], m[0]))
    }
}

/// √(x² + y²) in operations that IEEE 754 rounds alike everywhere, which `hypot` is not: the report's page repeats this
/// fit (`src/report/page/solve.js`) and must get the same bits.
pub(crate) fn length(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

/// The similarity of given scale and rotation that takes `p` to `m`.
fn anchored(a_re: f64, a_im: f64, mirrored: Handedness, p: PixelPoint, m: MapPoint) -> Similarity {
    let (x, y) = upright(p.x, p.y, mirrored);
    Similarity {
        a_re,
        a_im,
        easting_0: m.easting - (a_re * x - a_im * y),
        northing_0: m.northing - (a_im * x + a_re * y),
        mirrored,
    }
}

/// A mark and the surveyed point it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// The mark's centre.
    pub pixel: PixelPoint,
    /// Covariance of the centre, px²: xx, xy, yy.
    pub covariance_px2: Option<[f64; 3]>,
    /// The surveyed point, metres.
    pub map: MapPoint,
    /// 1σ of the survey in each of easting and northing, metres.
    pub survey_sigma_m: Option<f64>,
}

/// Why no similarity was solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsolvable {
    /// Two different points are needed.
    #[error("too few points")]
    TooFewPoints,
    /// All marks, or all surveyed points, lie in one place.
    #[error("the points lie in one line or in one place")]
    Degenerate,
}

/// The least-squares similarity with all weights equal, without the statistics. `None` when it is degenerate.
pub fn fit_equal_weights(pairs: &[Pair]) -> Option<Similarity> {
    (pairs.len() >= 2).then(|| fit(pairs, &vec![1.0; pairs.len()], Handedness::AsIs)).flatten()
}

pub(crate) fn fit(pairs: &[Pair], weights: &[f64], mirrored: Handedness) -> Option<Similarity> {
    let total: f64 = weights.iter().sum();
    let (centre, mean) = centres(pairs, weights, total);
    let (mut re, mut im, mut square) = (0.0, 0.0, 0.0);
    for (pair, p) in pairs.iter().zip(weights) {
        let (x, y) = upright(pair.pixel.x - centre.x, pair.pixel.y - centre.y, mirrored);
        let (e, n) = (pair.map.easting - mean.easting, pair.map.northing - mean.northing);
        re += p * (x * e + y * n);
        im += p * (x * n - y * e);
        square += p * (x * x + y * y);
    }
    let (a_re, a_im) = (re / square, im / square);
    let scale = length(a_re, a_im);
    (square > 0.0 && scale > 0.0 && scale.is_finite()).then(|| anchored(a_re, a_im, mirrored, centre, mean))
}

pub(crate) fn centres(pairs: &[Pair], weights: &[f64], total: f64) -> (PixelPoint, MapPoint) {
    // About the first point, so that coordinates of millions of metres lose no digits.
    let (p0, m0) = (pairs[0].pixel, pairs[0].map);
    let mut sums = [0.0; 4];
    for (pair, w) in pairs.iter().zip(weights) {
        let d =
            [pair.pixel.x - p0.x, pair.pixel.y - p0.y, pair.map.easting - m0.easting, pair.map.northing - m0.northing];
        sums.iter_mut().zip(d).for_each(|(s, d)| *s += w * d);
    }
    let [x, y, e, n] = sums.map(|s| s / total);
    (PixelPoint { x: p0.x + x, y: p0.y + y }, MapPoint { easting: m0.easting + e, northing: m0.northing + n })
}

pub(crate) fn residual(similarity: &Similarity, pair: &Pair) -> (f64, f64) {
    let computed = similarity.apply(pair.pixel);
    (pair.map.easting - computed.easting, pair.map.northing - computed.northing)
}
