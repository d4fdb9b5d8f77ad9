//! Quick answers to "may a candidate be near here?", for the search's inner loop.

use crate::matching::field::Field;
use autoref_raster::coords::PixelPoint;

/// A prediction that chance hits this often is not worth a look.
pub(super) const WORTHLESS_PROBABILITY: f64 = 0.25;

/// How often a chance prediction may find its bit set with no candidate within the radius. Fewer cells say less, but
/// stay in the nearest cache: with cells of half the radius most of a look was waiting for memory.
const NEEDLESS_LOOK: f64 = 0.03;

/// Where a candidate may be within a radius, a bit a cell: most predictions are answered by one look.
pub(super) struct Bitmap {
    pub radius_px: f64,
    /// A multiplication costs less than a division; building and asking use the same one, so that no cell is missed.
    pub cells_per_px: f64,
    pub columns: usize,
    origin: PixelPoint,
    /// Row by row, and one empty word.
    pub bits: Vec<u64>,
}

impl Bitmap {
    /// False only when no candidate is within the radius of `p`, which must lie in the field.
    #[inline]
    pub fn may_hold(&self, p: PixelPoint) -> bool {
        // At most 16 million cells: a conversion to 32 bits is one instruction, to 64 without sign it is many.
        let column = ((p.x - self.origin.x) * self.cells_per_px) as i32 as usize;
        let bit = ((p.y - self.origin.y) * self.cells_per_px) as i32 as usize * self.columns + column;
        self.bits[bit / 64] >> (bit % 64) & 1 == 1
    }

    /// Radii from 8 px up, by 2, as long as chance hits leave something to see.
    pub fn all(field: &Field) -> Vec<Bitmap> {
        let density = field.points().len() as f64 / field.area_px2();
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
        let density = field.points().len() as f64 / field.area_px2();
        let rare_px = (NEEDLESS_LOOK / density).sqrt() - 2.0 * radius_px;
        let cell_px = rare_px.max(radius_px / 2.0).max((field.area_px2() / 16e6).sqrt());
        let columns = (field.width_px / cell_px) as usize + 2;
        let rows = (field.height_px / cell_px) as usize + 2;
        let mut bitmap = Bitmap {
            radius_px,
            cells_per_px: 1.0 / cell_px,
            columns,
            origin: field.origin(),
            bits: vec![0; (columns * rows).div_ceil(64) + 1],
        };
        for p in field.points() {
            let (x, y) = (p.x - bitmap.origin.x, p.y - bitmap.origin.y);
            let cells_per_px = bitmap.cells_per_px;
            let range = |v: f64, limit: usize| {
                let low = ((v - radius_px) * cells_per_px).max(0.0) as usize;
                (low, (((v + radius_px) * cells_per_px).max(0.0) as usize).min(limit - 1))
            };
            let ((left, right), (top, bottom)) = (range(x, columns), range(y, rows));
            for row in top..=bottom {
                for column in left..=right {
                    let bit = row * columns + column;
                    bitmap.bits[bit / 64] |= 1 << (bit % 64);
                }
            }
        }
        bitmap
    }
}
