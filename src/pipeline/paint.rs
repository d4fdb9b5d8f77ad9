//! The detector of painted marks: profile, colour test, gates and examination under one name.

use crate::candidate::evidence::outline_of;
use crate::candidate::split::examine_parts;
use crate::candidate::{Candidate, Gates, examine, patch_margin_px};
use crate::detector::Detector;
use crate::pipeline::bright_paint::BrightPaint;
use crate::pipeline::worn_paint::{WornColours, WornPaint};
use crate::profile::Profile;
use crate::segment::classify::{Classifier, PaintColours, classify_piece};
use crate::segment::filters::MaskFilters;
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::mask::Mask;
use autoref_raster::{Block, Piece, Pixels, RasterInfo};

/// The colours that a profile looks for: what takes time about a [`PaintDetector`], and does not depend on the image.
pub struct ProfileColours {
    paint: PaintColours,
    worn: Option<WornColours>,
}

impl ProfileColours {
    /// # Errors
    /// When the profile is not valid or not one of paint.
    pub fn of(profile: &Profile) -> Result<ProfileColours> {
        Ok(ProfileColours { paint: PaintColours::of(profile)?, worn: WornColours::of(profile)? })
    }
}

/// Finds the marks of a profile in a raster.
pub struct PaintDetector {
    profile: Profile,
    classifier: Classifier,
    gates: Gates,
    filters: MaskFilters,
    /// What the samples mean; kept to build stricter tests.
    info: RasterInfo,
    bright: Option<BrightPaint>,
    worn: Option<WornPaint>,
}

impl PaintDetector {
    /// # Errors
    /// When the profile is not valid, or gives sizes in metres and `gsd_m` is unknown.
    pub fn new(profile: Profile, info: &RasterInfo, gsd_m: Option<f64>) -> Result<Self> {
        let colours = ProfileColours::of(&profile)?;
        PaintDetector::with_colours(profile, colours, info, gsd_m)
    }

    /// The same with the profile's colours, which may be worked out before the image is open.
    ///
    /// # Errors
    /// As [`PaintDetector::new`].
    pub fn with_colours(
        profile: Profile,
        colours: ProfileColours,
        info: &RasterInfo,
        gsd_m: Option<f64>,
    ) -> Result<Self> {
        let gates = Gates::new(&profile, gsd_m)?;
        let classifier = Classifier::of(colours.paint, info.sample, info.white, info.rgb, info.alpha, info.nodata)?;
        let filters = MaskFilters::new(&profile.filters, gates.max_side_px());
        let bright = BrightPaint::of(&profile, &classifier, &gates);
        let worn = colours.worn.map(|worn| WornPaint::of(&profile, worn, info, &gates)).transpose()?;
        Ok(PaintDetector { profile, classifier, gates, filters, info: info.clone(), bright, worn })
    }

    fn with_field_beside(&self, found: Candidate, region: &Region, pixels: &dyn Pixels) -> Candidate {
        match &self.worn {
            Some(worn) => worn.with_field_beside(found, region, pixels),
            None => found,
        }
    }

    /// For places where a mark must be: the same colours and shapes, but a weak score is enough.
    pub fn relaxed(&self) -> Self {
        let mut profile = self.profile.clone();
        profile.examine.min_score = profile.examine.min_score.min(0.0) - 4.0;
        PaintDetector {
            classifier: self.classifier.clone(),
            gates: self.gates.clone(),
            filters: self.filters.clone(),
            info: self.info.clone(),
            bright: self.bright.as_ref().map(|bright| bright.with_profile(&profile)),
            worn: self.worn.as_ref().map(|worn| worn.with_profile(&profile)),
            profile,
        }
    }
}

impl Detector for PaintDetector {
    fn halo_px(&self) -> u64 {
        self.filters.halo_px()
    }

    fn segment_piece(&self, piece: &Piece, mask: &mut Mask) {
        classify_piece(&self.classifier, piece, mask);
    }

    fn segment_block(&self, _block: &Block, mask: &mut Mask) {
        self.filters.apply(mask);
    }

    fn gate(&self, region: &Region) -> bool {
        self.gates.region(region)
    }

    fn patch_margin_px(&self) -> u64 {
        patch_margin_px(&self.profile)
    }

    fn largest_mark_px(&self) -> u64 {
        self.gates.max_side_px()
    }

    fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<Candidate> {
        let found = examine(region, pixels, &self.classifier, &self.profile, &self.gates)?;
        Some(self.with_field_beside(found, region, pixels))
    }

    fn outline(&self, region: &Region, pixels: &dyn Pixels) -> Option<(PixelPoint, Vec<PixelPoint>)> {
        outline_of(examine::measure(region, pixels, &self.classifier, &self.profile, &self.gates)?)
    }

    fn examine_all(&self, region: &Region, pixels: &dyn Pixels) -> Vec<Candidate> {
        // With mask filters a region is not the paint that the patch shows: it cannot be taken apart.
        if !self.profile.examine.split || !self.filters.is_identity() {
            return self.examine(region, pixels).into_iter().collect();
        }
        let found = examine_parts(region, pixels, &self.classifier, &self.profile, &self.gates);
        // Of several it is not known which pixels of the region are whose.
        if found.len() != 1 {
            return found;
        }
        found.into_iter().map(|found| self.with_field_beside(found, region, pixels)).collect()
    }

    fn stricter(&self) -> Option<Box<dyn Detector>> {
        let mut profile = self.profile.clone();
        profile.colour.limit *= 0.7;
        let info = &self.info;
        let classifier = Classifier::new(&profile, info.sample, info.white, info.rgb, info.alpha, info.nodata).ok()?;
        let (gates, filters) = (self.gates.clone(), self.filters.clone());
        let (bright, worn) = (None, None);
        Some(Box::new(PaintDetector { profile, classifier, gates, filters, info: info.clone(), bright, worn }))
    }

    fn others(&self) -> Vec<&dyn Detector> {
        let bright = self.bright.iter().map(|bright| bright as &dyn Detector);
        bright.chain(self.worn.iter().map(|worn| worn as &dyn Detector)).collect()
    }

    fn finish(&self, list: Vec<Candidate>) -> Vec<Candidate> {
        crate::candidate::prototype_options::finish(list, &self.profile)
    }
}
