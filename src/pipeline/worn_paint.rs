//! Marks that wear or blur has mixed with their ground, of which the profile takes a few specks for paint or nothing.
//!
//! They are regions of another mask, of all colours on the paint's side of common grounds ([`Profile::worn`]). Much
//! else has these colours, so shape and paint are asked for more ([`crate::candidate::worn`]).

use crate::candidate::evidence::outline_of;
use crate::candidate::worn::Worn;
use crate::candidate::{Candidate, Gates, patch_margin_px};
use crate::detector::Detector;
use crate::profile::Profile;
use crate::segment::classify::{Classifier, PaintColours, classify_piece};
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::mask::Mask;
use autoref_raster::{Block, Piece, Pixels, RasterInfo};

/// The colours of a profile's worn paint.
pub(super) struct WornColours {
    profile: Profile,
    colours: PaintColours,
}

impl WornColours {
    /// `None` of a profile that is not looked at this way.
    ///
    /// # Errors
    /// When the profile is not valid.
    pub fn of(profile: &Profile) -> Result<Option<WornColours>> {
        let Some(profile) = profile.worn() else { return Ok(None) };
        let colours = PaintColours::of(&profile)?;
        Ok(Some(WornColours { profile, colours }))
    }
}

/// Finds marks of worn or blurred paint.
pub(super) struct WornPaint {
    worn: Worn,
}

impl WornPaint {
    /// `profile` is that of the paint, not worn.
    ///
    /// # Errors
    /// When the image's value of white is 0.
    pub fn of(profile: &Profile, worn: WornColours, info: &RasterInfo, gates: &Gates) -> Result<WornPaint> {
        let (sample, white) = (info.sample, info.white);
        let classifier = Classifier::of(worn.colours, sample, white, info.rgb, info.alpha, info.nodata)?;
        let (gates, fresh) = (gates.clone(), profile.fresh_paint());
        let worn = Worn { profile: worn.profile, classifier, gates, fresh };
        Ok(WornPaint { worn })
    }

    /// See [`Worn::with_field_beside`].
    pub fn with_field_beside(&self, found: Candidate, region: &Region, pixels: &dyn Pixels) -> Candidate {
        self.worn.with_field_beside(found, region, pixels)
    }

    /// The same paint, examined as another profile asks.
    pub fn with_profile(&self, profile: &Profile) -> WornPaint {
        let mut worn = self.worn.clone();
        worn.profile.examine = profile.examine.clone();
        WornPaint { worn }
    }
}

impl Detector for WornPaint {
    fn halo_px(&self) -> u64 {
        0
    }

    fn segment_piece(&self, piece: &Piece, mask: &mut Mask) {
        classify_piece(&self.worn.classifier, piece, mask);
    }

    fn segment_block(&self, _block: &Block, _mask: &mut Mask) {}

    fn gate(&self, region: &Region) -> bool {
        self.worn.gate(region)
    }

    fn patch_margin_px(&self) -> u64 {
        patch_margin_px(&self.worn.profile)
    }

    fn largest_mark_px(&self) -> u64 {
        self.worn.gates.max_side_px()
    }

    fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<Candidate> {
        self.worn.examine(region, pixels)
    }

    fn outline(&self, region: &Region, pixels: &dyn Pixels) -> Option<(PixelPoint, Vec<PixelPoint>)> {
        outline_of(self.worn.measure(region, pixels)?)
    }
}
