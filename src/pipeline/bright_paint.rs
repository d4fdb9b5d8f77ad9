//! Marks on ground of their own colour in less light: white on grey concrete, green on grass, orange on red soil.
//!
//! A profile takes paint in shade too, and that is the colour of such ground: mark and ground are one region, far too
//! large for a mark. What is nearly as bright as fresh paint in full light is a mask of its own inside the profile's,
//! in which the mark is a region again.

use crate::candidate::evidence::outline_of;
use crate::candidate::pixel_set::{PixelSet, region_of};
use crate::candidate::{Candidate, Gates, examine, inside, patch_margin_px};
use crate::detector::Detector;
use crate::profile::Profile;
use crate::segment::classify::{Classifier, classify_piece};
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::mask::Mask;
use autoref_raster::{Block, Piece, Pixels};

/// Finds marks of which the paint is in full light, where the whole profile finds their ground as well.
pub(super) struct BrightPaint {
    profile: Profile,
    /// Of the whole profile.
    outer: Classifier,
    /// Of its bright part.
    classifier: Classifier,
    gates: Gates,
}

impl BrightPaint {
    /// `None` of a profile that is not looked at this way.
    pub fn of(profile: &Profile, outer: &Classifier, gates: &Gates) -> Option<BrightPaint> {
        let classifier = outer.at_least(profile.least_in_full_light()?);
        Some(BrightPaint { profile: profile.clone(), outer: outer.clone(), classifier, gates: gates.clone() })
    }

    /// The same paint, examined as another profile asks.
    pub fn with_profile(&self, profile: &Profile) -> BrightPaint {
        BrightPaint {
            profile: profile.clone(),
            outer: self.outer.clone(),
            classifier: self.classifier.clone(),
            gates: self.gates.clone(),
        }
    }

    /// Whether what the whole profile sees there may be a mark itself: then that decides, unless the bright part is
    /// very even inside. Of other things in about the paint's colour the brightest part is any shape.
    fn is_decided_outside(&self, region: &Region, pixels: &dyn Pixels) -> bool {
        /// Ground goes on beyond the patch on so many of its sides, at least; a thing beside which there is other
        /// ground does not.
        const GROUND_SIDES: usize = 3;
        let patch = pixels.whole();
        let (width, height) = (patch.window.width as usize, patch.window.height as usize);
        let (y, x) = region.first;
        if !patch.window.contains(x, y) {
            return false;
        }
        let valid = PixelSet::of(&patch.valid, width);
        let paint = PixelSet::of_bits(&self.outer.paint_bits(&patch.rgb), width, height).and(&valid);
        let piece = paint.piece((y - patch.window.y) as usize * width + (x - patch.window.x) as usize);
        let Some(outer) = region_of(&piece, &patch) else { return false };
        let (of, all) = (outer.bounds, patch.window);
        let met = [of.x == all.x, of.y == all.y, of.right() == all.right(), of.bottom() == all.bottom()];
        match met.into_iter().filter(|met| *met).count() {
            0 => self.gates.shape(&outer),
            sides => sides < GROUND_SIDES,
        }
    }
}

impl Detector for BrightPaint {
    fn halo_px(&self) -> u64 {
        0
    }

    fn segment_piece(&self, piece: &Piece, mask: &mut Mask) {
        classify_piece(&self.classifier, piece, mask);
    }

    fn segment_beside(&self, piece: &Piece, outer: &Mask, mask: &mut Mask) {
        if piece.empty {
            return;
        }
        let (x, width) = (piece.window.x, piece.window.width);
        let mut bits = vec![0u64; (width as usize).div_ceil(64)];
        for y in piece.window.y..piece.window.bottom() {
            outer.get_bits(x, y, width, &mut bits);
            if bits.iter().all(|word| *word == 0) {
                continue;
            }
            self.classifier.narrow_row(piece.row(x, y, width), &mut bits);
            mask.put_bits(x, y, width, &bits);
        }
    }

    fn segment_block(&self, _block: &Block, _mask: &mut Mask) {}

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
        let look = if self.is_decided_outside(region, pixels) { inside::examine } else { examine };
        look(region, pixels, &self.classifier, &self.profile, &self.gates)
    }

    fn outline(&self, region: &Region, pixels: &dyn Pixels) -> Option<(PixelPoint, Vec<PixelPoint>)> {
        let look = if self.is_decided_outside(region, pixels) { inside::measure } else { examine::measure };
        outline_of(look(region, pixels, &self.classifier, &self.profile, &self.gates)?)
    }
}
