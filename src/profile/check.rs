//! What makes a profile usable, checked before it meets a picture.

use super::colour::Cloud;
use super::{Profile, Shape};
use autoref_raster::error::{Error, Result};

impl Profile {
    /// Everything that makes a profile usable: finite numbers, positive definite covariances, sizes in order.
    ///
    /// # Errors
    /// [`Error::Usage`] naming the field.
    pub fn validate(&self) -> Result<()> {
        self.check().map_err(|(place, what)| {
            Error::usage(format!("profile \"{}\": {place}: {what}", self.name), "correct the profile")
        })
    }

    pub(super) fn check(&self) -> std::result::Result<(), (&'static str, String)> {
        if (self.shape == Shape::Tag) != self.tag.is_some() {
            return Err(("tag", "shape = \"tag\" and [tag] go together".into()));
        }
        if self.is_target() {
            self.check_target()?;
        } else {
            self.check_colour()?;
        }
        self.check_rest()
    }

    fn check_target(&self) -> std::result::Result<(), (&'static str, String)> {
        if !self.colour.is_empty() {
            return Err(("colour", "checkers, hourglasses and tags are found by shape: leave [colour] out".into()));
        }
        if !(0.02..=1.0).contains(&self.target.min_contrast) {
            return Err(("target.min_contrast", format!("{} is not in 0.02..=1", self.target.min_contrast)));
        }
        Ok(())
    }

    fn check_colour(&self) -> std::result::Result<(), (&'static str, String)> {
        let colour = &self.colour;
        if !(colour.limit.is_finite() && colour.limit > 0.0) {
            return Err(("colour.limit", format!("{} is not a positive number", colour.limit)));
        }
        if colour.clouds.is_empty() {
            return Err(("colour.clouds", "at least one colour cloud is needed".into()));
        }
        self.clouds().map_err(|index| {
            ("colour.clouds", format!("the covariance of cloud {index} is singular or not positive definite"))
        })?;
        if let Some(rough) = &colour.rough {
            let fine = rough.limit.is_finite() && rough.limit > 0.0;
            if !fine || Cloud::new(rough.mean, rough.covariance, rough.metric).is_none() {
                return Err(("colour.rough", "the limit must be positive, the covariance positive definite".into()));
            }
        }
        if let Some(b) = &colour.rough_box
            && !(0..3).all(|i| b.low[i].is_finite() && b.high[i].is_finite() && b.low[i] <= b.high[i])
        {
            return Err(("colour.rough_box", "each low must be finite and at most its high".into()));
        }
        Ok(())
    }

    fn check_rest(&self) -> std::result::Result<(), (&'static str, String)> {
        self.gates.check()?;
        self.examine.check()?;
        let size = &self.size;
        for (place, low, high) in [("size.max_px", size.min_px, size.max_px), ("size.max_m", size.min_m, size.max_m)] {
            if [low, high].into_iter().flatten().any(|v| !(v.is_finite() && v > 0.0)) {
                return Err((place, "sizes must be positive numbers".into()));
            }
            if let (Some(low), Some(high)) = (low, high)
                && low > high
            {
                return Err((place, format!("the smallest size {low} is above the largest {high}")));
            }
        }
        if size.max_px.is_none() && size.max_m.is_none() {
            return Err(("size", "max_px or max_m is needed".into()));
        }
        if size.max_px.is_some_and(|v| v > 4096.0) {
            return Err(("size.max_px", "marks above 4096 px are not supported".into()));
        }
        if self.filters.closing_radius_px > 64 || self.filters.opening_radius_px > 64 {
            return Err(("filters", "radii above 64 px are not supported".into()));
        }
        Ok(())
    }
}
