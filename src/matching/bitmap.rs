//! Quick answers to "may a candidate be near here?", for the search's inner loop.

use crate::matching::field::Field;
use autoref_raster::coords::PixelPoint;

/// A prediction that chance hits this often is not worth a look.
pub(super) const WORTHLESS_PROBABILITY: f64 = 0.25;

/// How often a chance prediction may find its bit set with no candidate within the radius. Fewer cells say less, but
/// stay in the nearest cache: with cells of half the radius most of a look was waiting for memory.
const NEEDLESS_LOOK: f64 = 0.03;

/// So many cells take no room that matters: among few candidates they are smaller, and looks more seldom needless.
const CHEAP_CELLS: f64 = 32_768.0;

/// Of the field's diagonal: some roundings of 2⁻²⁴ each.
const SINGLE_PRECISION: f64 = 1e-6;

/// Cells before the field: one that is empty, and so much that what lies on the field's border is not rounded into it.
const RIM: f64 = 1.01;

/// Where a candidate may be within a radius, a bit a cell: most predictions are answered by one look. The outermost
/// cells lie outside the field and are empty.
pub(super) struct Bitmap {
    pub radius_px: f64,
    /// A multiplication costs less than a division; building and asking use the same one, so that no cell is missed.
    pub cells_per_px: f64,
    pub columns: usize,
    pub rows: usize,
    origin: PixelPoint,
    /// Row by row.
    pub bits: Vec<u32>,
}

impl Bitmap {
    /// False only when no candidate is within the radius of `p`, which must lie in the field: what looks at many
    /// hypotheses together answer, one at a time.
    #[cfg(test)]
    pub fn may_hold(&self, p: PixelPoint) -> bool {
        // At most 16 million cells: a conversion to 32 bits is one instruction, to 64 without sign it is many.
        let (column, row) = self.cell_of(p);
        let bit = row as i32 as usize * self.columns + column as i32 as usize;
        self.bits[bit / 32] >> (bit % 32) & 1 == 1
    }

    /// Column and row; the whole parts say in which cell `p` is.
    #[inline]
    pub fn cell_of(&self, p: PixelPoint) -> (f64, f64) {
        ((p.x - self.origin.x) * self.cells_per_px + RIM, (p.y - self.origin.y) * self.cells_per_px + RIM)
    }

    /// Radii from 8 px up, by 2, as long as chance hits leave something to see.
    pub fn all(field: &Field) -> Vec<Bitmap> {
        let density = field.density();
        let useful = (WORTHLESS_PROBABILITY * 1.5 / (density * std::f64::consts::PI)).sqrt();
        let mut radius_px = 8.0;
        let mut bitmaps = Vec::new();
        while bitmaps.is_empty() || radius_px < 2.0 * useful.min(4096.0) {
            bitmaps.push(Bitmap::new(field, radius_px));
            radius_px *= 2.0;
        }
        bitmaps
    }

    fn new(field: &Field, radius_px: f64) -> Bitmap {
        // As large as needless looks allow; half the radius at least, and no more than 16 million cells.
        let density = field.density();
        let rare_px = (NEEDLESS_LOOK / density).sqrt() - 2.0 * radius_px;
        let cheap_px = (field.area_px2() / CHEAP_CELLS).sqrt();
        let cell_px = rare_px.min(cheap_px).max(radius_px / 2.0).max((field.area_px2() / 16e6).sqrt());
        let columns = (field.width_px / cell_px + RIM) as usize + 2;
        let rows = (field.height_px / cell_px + RIM) as usize + 2;
        let mut bitmap = Bitmap {
            radius_px,
            cells_per_px: 1.0 / cell_px,
            columns,
            rows,
            origin: field.origin(),
            bits: vec![0; (columns * rows).div_ceil(32)],
        };
        // Looks in single precision may be off by this.
        let reach = (radius_px + SINGLE_PRECISION * field.width_px.hypot(field.height_px)) * bitmap.cells_per_px;
        for p in field.points() {
            let (x, y) = bitmap.cell_of(*p);
            let range = |v: f64, cells: usize| ((v - reach).max(1.0) as usize, ((v + reach) as usize).min(cells - 2));
            let ((left, right), (top, bottom)) = (range(x, columns), range(y, rows));
            for row in top..=bottom {
                for column in left..=right {
                    let bit = row * columns + column;
                    bitmap.bits[bit / 32] |= 1 << (bit % 32);
                }
            }
        }
        bitmap
    }
}
