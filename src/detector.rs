//! What tells paint from ground and marks from blobs: the trait that every kind of mark implements.

use autoref_raster::coords::PixelPoint;
use autoref_raster::mask::Mask;
use autoref_raster::{Block, Piece, Pixels};

use crate::candidate::Candidate;
use crate::segment::label::Region;

/// What tells paint from ground and marks from blobs. Implementations hold no state that changes.
pub trait Detector: Sync {
    /// Pixels around a core that [`Detector::segment`] must see to be right inside it.
    fn halo_px(&self) -> u64;
    /// Piece → Mask, for detectors that judge a pixel by itself: called for each piece of a block as soon as it is
    /// read, while it lies in the nearest cache. The mask is of the block's window, and background at first.
    fn segment_piece(&self, _piece: &Piece, _mask: &mut Mask) {}
    /// Block → Mask: what is left to do when all pieces are there; sets the foreground bits of the mask.
    fn segment_block(&self, block: &Block, mask: &mut Mask);
    /// Block → Mask, all of it.
    fn segment(&self, block: &Block, mask: &mut Mask) {
        block.pieces.iter().for_each(|piece| self.segment_piece(piece, mask));
        self.segment_block(block, mask);
    }
    /// Whether a complete region may be a mark, from its integers alone.
    fn gate(&self, region: &Region) -> bool;
    /// Pixels around a region's bounds that [`Detector::examine`] wants to see.
    fn patch_margin_px(&self) -> u64;
    /// The longest side a mark may have.
    fn largest_mark_px(&self) -> u64;
    /// Region → Candidate. The pixels are those of the region's bounds grown by the margin, clipped to the raster.
    fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<Candidate>;
    /// Centre and outline of the shape that was fitted to a region, in image pixels; `None` when nothing was fitted.
    fn outline(&self, _region: &Region, _pixels: &dyn Pixels) -> Option<(PixelPoint, Vec<PixelPoint>)> {
        None
    }

    /// Region → Candidates, where a region may be several marks that touch.
    fn examine_all(&self, region: &Region, pixels: &dyn Pixels) -> Vec<Candidate> {
        self.examine(region, pixels).into_iter().collect()
    }
    /// Region → Candidates where a mark must be, in a window of its own.
    fn refine(&self, region: &Region, pixels: &dyn Pixels) -> Vec<Candidate> {
        self.examine(region, pixels).into_iter().collect()
    }
    /// The same detector with a narrower idea of the paint, for a place where a mark must be but its surroundings were
    /// taken for paint too (a mark on a red roof). `None` when there is no narrower one.
    fn stricter(&self) -> Option<Box<dyn Detector>> {
        None
    }
    /// Detectors that look in the same pass with masks of their own: for marks on ground that this one takes for paint
    /// too (white on concrete, green on grass), and for marks of which it takes little for paint (worn, blurred). Of
    /// what several find at one place the first one's stays, this one's before all.
    fn others(&self) -> Vec<&dyn Detector> {
        Vec::new()
    }
    /// Piece → Mask of one of the others, which may ask what the first took for paint.
    fn segment_beside(&self, piece: &Piece, _first: &Mask, mask: &mut Mask) {
        self.segment_piece(piece, mask);
    }
    /// Block → Masks of this one and of the others, in their order: for those that have work in common.
    fn segment_blocks(&self, block: &Block, masks: &mut [Mask]) {
        let (first, rest) = masks.split_at_mut(1);
        self.segment_block(block, &mut first[0]);
        for (other, mask) in self.others().into_iter().zip(rest) {
            other.segment_block(block, mask);
        }
    }
    /// What is done to the whole list at the end; it comes in raster order of the regions' first pixels.
    fn finish(&self, list: Vec<Candidate>) -> Vec<Candidate> {
        list
    }
}
