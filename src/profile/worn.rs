//! Worn and blurred paint: the colours of a paint through which any common ground shines.
//!
//! Of paint that is worn to two fifths the colour depends as much on the ground as on the paint, and no cloud holds it
//! that does not hold half of all soils. But whatever the ground, worn paint has moved from it towards the paint. Along
//! the direction in the a\*b\* plane that separates paint from grounds best (R. A. Fisher, "The use of multiple
//! measurements in taxonomic problems", 1936) a plane lies between the last ground and the least of worn paint.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::colour::{Metric, Space, lab_from_srgb};
use super::mixing::GROUNDS;
use super::{CloudSpec, ColourModel, GateLimits, Profile, RoughBox, RoughDistance};
use autoref_raster::srgb::{linear_from_srgb, srgb_from_linear};

/// Share of paint that is left of worn paint.
const LEFT: f64 = 0.4;
/// Light in which grounds are seen, as shares of full sun.
const LIGHTS: [f64; 3] = [1.0, 0.7, 0.45];
/// Shares of paint in mixtures with ground.
const SHARES: [f64; 5] = [0.35, 0.5, 0.7, 0.85, 1.0];
/// Bands that are nearly as bright as the brightest, and how much darker than all mixtures they may be.
const BRIGHT_BAND: f64 = 0.95;
const DARKER: f64 = 0.8;
/// Beside all mixtures, a\*b\*.
const MARGIN: f64 = 6.0;
/// Variance of a\* and b\* by the sensor.
const NOISE: f64 = 10.0;
/// No colour lies so far along a direction of L\*a\*b\*.
const BEYOND: f64 = 400.0;

impl Profile {
    /// Whether it drops regions by limits of its own: what they drop may not come back as another region.
    pub(crate) fn has_own_gates(&self) -> bool {
        let examine = &self.examine;
        self.gates != GateLimits::default()
            || examine.max_clutter.is_some()
            || examine.max_spread.is_some()
            || examine.density.is_some()
    }

    /// The same marks by the colours of their worn paint, in which much else lies too: whoever uses it asks more of a
    /// shape. `None` of paint without a hue, of targets, and of profiles with gates of their own or options of
    /// the 2016 prototype.
    pub(crate) fn worn(&self) -> Option<Profile> {
        const LEAST_CHROMA: f64 = 30.0;
        if !self.examine.worn || self.has_own_gates() || !self.is_one_plain_paint() || self.tag.is_some() {
            return None;
        }
        let paint = self.fresh_paint().map(|v| f64::from(v) / 255.0);
        let hue = ab(paint);
        if hue.norm() < LEAST_CHROMA {
            return None;
        }
        let mut profile = self.clone();
        profile.colour = worn_colours(paint, hue)?;
        Some(profile)
    }
}

/// The colours of worn paint, sRGB 0..=1: along the direction from grounds to paint beyond the last ground, across it
/// where mixtures lie, and in the paint's brightest bands not darker than they are.
fn worn_colours(paint: [f64; 3], hue: Vector2<f64>) -> Option<ColourModel> {
    let seen = |light: f64| GROUNDS.iter().map(move |ground| ground.map(|v| srgb_from_linear(v * light)));
    let grounds: Vec<Vector2<f64>> = LIGHTS.iter().flat_map(|light| seen(*light)).map(ab).collect();
    let n = grounds.len() as f64;
    let mean = grounds.iter().sum::<Vector2<f64>>() / n;
    let scatter = grounds.iter().map(|g| (g - mean) * (g - mean).transpose()).sum::<Matrix2<f64>>() / (n - 1.0);
    let towards = ((scatter + Matrix2::identity() * NOISE).try_inverse()? * (hue - mean)).normalize();
    let across = Vector2::new(-towards.y, towards.x);

    let mixed = |g: [f64; 3], share: f64| std::array::from_fn(|c| share * paint[c] + (1.0 - share) * g[c]);
    let last_ground = seen(1.0).map(|g| ab(g).dot(&towards)).fold(f64::NEG_INFINITY, f64::max);
    let least_worn = seen(1.0).map(|g| ab(mixed(g, LEFT)).dot(&towards)).fold(f64::INFINITY, f64::min);

    let under = |light: f64| move |c: [f64; 3]| c.map(|v| srgb_from_linear(linear_from_srgb(v) * light));
    let mixtures: Vec<[f64; 3]> = LIGHTS
        .iter()
        .flat_map(|light| SHARES.iter().flat_map(move |share| seen(1.0).map(move |g| under(*light)(mixed(g, *share)))))
        .collect();
    let beside = mixtures.iter().map(|c| ab(*c).dot(&across));
    let (left, right) = beside.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, r), v| (l.min(v), r.max(v)));

    let most = paint.iter().copied().fold(0.0, f64::max);
    let low = std::array::from_fn(|c| {
        let darkest = mixtures.iter().map(|m| m[c]).fold(f64::INFINITY, f64::min);
        if paint[c] >= BRIGHT_BAND * most { DARKER * darkest } else { 0.0 }
    });
    let along = between(towards, (last_ground + least_worn) / 2.0, BEYOND);
    let CloudSpec { mean, covariance } = between(across, left - MARGIN, right + MARGIN);
    Some(ColourModel {
        space: Space::Lab,
        limit: 1.0,
        rough_box: Some(RoughBox { low, high: [1.0; 3] }),
        rough: Some(RoughDistance { space: Space::Lab, metric: Metric::Mahalanobis, limit: 1.0, mean, covariance }),
        clouds: vec![along],
        ..ColourModel::default()
    })
}

fn ab(srgb: [f64; 3]) -> Vector2<f64> {
    let lab = lab_from_srgb(srgb);
    Vector2::new(lab[1], lab[2])
}

/// All colours of which a\*b\* lies between two lengths along a direction: an ellipsoid so wide that its sides are
/// flat.
fn between(direction: Vector2<f64>, least: f64, most: f64) -> CloudSpec {
    /// Variance across: 200 away from the axis the sides have moved by a two-thousandth of the half length.
    const ACROSS: f64 = 4e7;
    let half = (most - least) / 2.0;
    let along = Vector3::new(0.0, direction.x, direction.y);
    let covariance = Matrix3::identity() * ACROSS + along * along.transpose() * (half * half - ACROSS);
    let covariance = std::array::from_fn(|r| std::array::from_fn(|c| covariance[(r, c)]));
    CloudSpec { mean: (along * (least + half)).into(), covariance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::reference::PaintTest;

    /// Whatever the ground, paint that covers two fifths of it is seen, and no ground is.
    #[test]
    fn worn_paint_is_taken_and_common_grounds_are_not() {
        for name in ["orange", "pink", "yellow", "blue", "ral-3020", "ral-5015", "ral-6018"] {
            let profile = Profile::load(name).expect("shipped");
            let worn = profile.worn().expect("it has a hue");
            worn.validate().expect("usable");
            let test = PaintTest::new(&worn).expect("valid");
            let paint = profile.fresh_paint().map(f64::from);
            for ground in GROUNDS {
                let ground = ground.map(|v| 255.0 * srgb_from_linear(v));
                let byte = |c: [f64; 3]| c.map(|v| v.round() as u8);
                let mixed = std::array::from_fn(|c| LEFT * paint[c] + (1.0 - LEFT) * ground[c]);
                assert!(test.is_paint(byte(mixed)), "{name} on {ground:?}");
                assert!(!test.is_paint(byte(ground)), "{name}: {ground:?}");
            }
        }
    }

    #[test]
    fn there_is_none_without_a_hue_or_without_the_wish() {
        assert!(Profile::load("white").expect("shipped").worn().is_none());
        assert!(Profile::load("autoref-2016").expect("shipped").worn().is_none());
        let mut orange = Profile::load("orange").expect("shipped");
        orange.examine.worn = false;
        assert!(orange.worn().is_none());
    }
}
