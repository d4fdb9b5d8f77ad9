//! The scalar reference that says which colours are paint.

use crate::profile::Profile;
use crate::profile::colour::{Cloud, Space};
use autoref_raster::error::{Error, Result};

/// The scalar reference: is this colour paint, and how far is it from it?
#[derive(Clone, Debug)]
pub struct PaintTest {
    pub(super) space: Space,
    pub(super) limit2: f64,
    pub(super) clouds: Vec<Cloud>,
    pub(super) rough: Option<(Space, f64, Cloud)>,
    pub(super) low: [u8; 3],
    pub(super) high: [u8; 3],
}

impl PaintTest {
    /// # Errors
    /// [`Error::Usage`] when the profile is not valid.
    pub fn new(profile: &Profile) -> Result<PaintTest> {
        profile.validate()?;
        if profile.is_target() {
            return Err(Error::usage(
                format!("profile \"{}\" finds targets by shape: it has no colour", profile.name),
                "give a profile of paint",
            ));
        }
        let model = &profile.colour;
        let clouds = profile.clouds().map_err(|i| {
            Error::usage(format!("profile \"{}\": colour cloud {i} is singular", profile.name), "correct the profile")
        })?;
        let rough = model
            .rough
            .as_ref()
            .and_then(|r| Some((r.space, r.limit * r.limit, Cloud::new(r.mean, r.covariance, r.metric)?)));
        let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let (low, high) = model.rough_box.map_or(([0; 3], [255; 3]), |b| (b.low.map(byte), b.high.map(byte)));
        Ok(PaintTest { space: model.space, limit2: model.limit * model.limit, clouds, rough, low, high })
    }

    /// Squared distance, over the squared limit, of an 8-bit sRGB colour from the nearest cloud: paint is at most 1.
    /// Infinite where a rough test already says no.
    pub fn relative_distance2(&self, colour: [u8; 3]) -> f64 {
        if (0..3).any(|i| !(self.low[i]..=self.high[i]).contains(&colour[i])) {
            return f64::INFINITY;
        }
        let unit = colour.map(|v| f64::from(v) / 255.0);
        if let Some((space, limit2, cloud)) = &self.rough
            && cloud.distance2(&space.convert(unit)) > *limit2
        {
            return f64::INFINITY;
        }
        self.nearest2(unit) / self.limit2
    }

    /// Squared distance of an sRGB colour in 0..=1 from the nearest cloud, in the metric's own units.
    pub fn nearest2(&self, unit: [f64; 3]) -> f64 {
        let at = self.space.convert(unit);
        self.clouds.iter().map(|c| c.distance2(&at)).fold(f64::INFINITY, f64::min)
    }

    /// Whether a colour, 8-bit levels, is that of paint.
    pub fn is_paint(&self, colour: [u8; 3]) -> bool {
        self.relative_distance2(colour) <= 1.0
    }
}
