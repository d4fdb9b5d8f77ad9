//! The candidates as a field of points: nearest point, points at a distance, local density.

use crate::coords::PixelPoint;

/// Points in buckets of a square grid.
pub struct Field {
    points: Vec<PixelPoint>,
    origin: PixelPoint,
    cell_px: f64,
    columns: usize,
    rows: usize,
    /// Start of each cell's indices; one more than there are cells.
    starts: Vec<u32>,
    indices: Vec<u32>,
    pub width_px: f64,
    pub height_px: f64,
    /// [`Field::density_near`] each point.
    densities: Vec<f64>,
}

impl Field {
    /// A field of `size_px` from (0, 0), or of the points' own extent.
    pub fn new(points: Vec<PixelPoint>, size_px: Option<(f64, f64)>) -> Self {
        let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        for p in &points {
            low = (low.0.min(p.x), low.1.min(p.y));
            high = (high.0.max(p.x), high.1.max(p.y));
        }
        if let Some((width, height)) = size_px {
            (low, high) = ((0.0, 0.0), (width, height));
        } else if points.is_empty() {
            (low, high) = ((0.0, 0.0), (1.0, 1.0));
        }
        let (width, height) = ((high.0 - low.0).max(1.0), (high.1 - low.1).max(1.0));
        // About one point a cell; never more than four million cells.
        let cell = (width * height / points.len().max(1) as f64).sqrt().max((width * height / 4e6).sqrt()).max(1.0);
        let (columns, rows) = ((width / cell) as usize + 1, (height / cell) as usize + 1);
        let mut field = Field {
            points,
            origin: PixelPoint { x: low.0, y: low.1 },
            cell_px: cell,
            columns,
            rows,
            starts: vec![0; columns * rows + 1],
            indices: Vec::new(),
            width_px: width,
            height_px: height,
            densities: Vec::new(),
        };
        field.fill();
        field.densities = field.points.iter().map(|p| field.density_near(*p)).collect();
        field
    }

    fn fill(&mut self) {
        let cells: Vec<usize> = self.points.iter().map(|p| self.cell(*p)).collect();
        for &cell in &cells {
            self.starts[cell + 1] += 1;
        }
        for i in 1..self.starts.len() {
            self.starts[i] += self.starts[i - 1];
        }
        let mut next = self.starts.clone();
        self.indices = vec![0; self.points.len()];
        for (i, &cell) in cells.iter().enumerate() {
            self.indices[next[cell] as usize] = i as u32;
            next[cell] += 1;
        }
    }

    fn column(&self, x: f64) -> usize {
        (((x - self.origin.x) / self.cell_px).max(0.0) as usize).min(self.columns - 1)
    }

    fn row(&self, y: f64) -> usize {
        (((y - self.origin.y) / self.cell_px).max(0.0) as usize).min(self.rows - 1)
    }

    fn cell(&self, p: PixelPoint) -> usize {
        self.row(p.y) * self.columns + self.column(p.x)
    }

    pub fn points(&self) -> &[PixelPoint] {
        &self.points
    }

    /// Points per px² about a point, itself left out; see [`Field::density_near`].
    #[inline]
    pub fn density_at(&self, index: usize) -> f64 {
        self.densities[index]
    }

    pub fn origin(&self) -> PixelPoint {
        self.origin
    }

    pub fn area_px2(&self) -> f64 {
        self.width_px * self.height_px
    }

    #[inline]
    pub fn contains(&self, p: PixelPoint) -> bool {
        p.x >= self.origin.x
            && p.y >= self.origin.y
            && p.x <= self.origin.x + self.width_px
            && p.y <= self.origin.y + self.height_px
    }

    /// Calls `visit` with every point in the square of half-side `reach_px` about `p`, and some more.
    pub fn around(&self, p: PixelPoint, reach_px: f64, visit: impl FnMut(usize, PixelPoint)) {
        self.in_box((p.x - reach_px, p.x + reach_px), (p.y - reach_px, p.y + reach_px), visit);
    }

    /// Calls `visit` with every point of a box, and some more.
    #[inline]
    pub fn in_box(&self, x: (f64, f64), y: (f64, f64), mut visit: impl FnMut(usize, PixelPoint)) {
        let (left, right) = (self.column(x.0), self.column(x.1));
        for row in self.row(y.0)..=self.row(y.1) {
            let start = self.starts[row * self.columns + left] as usize;
            let end = self.starts[row * self.columns + right + 1] as usize;
            for &i in &self.indices[start..end] {
                visit(i as usize, self.points[i as usize]);
            }
        }
    }

    /// The nearest point within `reach_px`; the lower index when two are equally near.
    #[inline]
    pub fn nearest(&self, p: PixelPoint, reach_px: f64) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        self.around(p, reach_px, |i, q| {
            let square = (q.x - p.x).powi(2) + (q.y - p.y).powi(2);
            if square <= reach_px * reach_px && best.is_none_or(|(j, s)| square < s || (square == s && i < j)) {
                best = Some((i, square));
            }
        });
        best.map(|(i, square)| (i, square.sqrt()))
    }

    /// Points per px² about `p`: the largest of the whole field's and of discs that would hold 16, 4 and 1 points of the
    /// whole field's. Clutter in clumps and rows makes accidents likelier just there, so the estimate leans to the dense
    /// side. Each disc leaves out one point: the hit whose chance is asked for.
    pub fn density_near(&self, p: PixelPoint) -> f64 {
        let global = self.points.len() as f64 / self.area_px2();
        let mut density = global;
        for expected in [16.0, 4.0, 1.0] {
            let radius = (expected / (global * std::f64::consts::PI)).sqrt();
            let mut count = 0u32;
            self.around(p, radius, |_, q| {
                count += u32::from((q.x - p.x).powi(2) + (q.y - p.y).powi(2) <= radius * radius);
            });
            let local = f64::from(count.saturating_sub(1)) / (std::f64::consts::PI * radius * radius);
            density = density.max(local);
        }
        density
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn nearest_is_what_a_full_search_finds(
            points in prop::collection::vec((0.0..500.0f64, 0.0..300.0f64), 1..200),
            x in -20.0..520.0f64, y in -20.0..320.0f64, reach in 0.1..80.0f64,
        ) {
            let points: Vec<PixelPoint> = points.into_iter().map(|(x, y)| PixelPoint { x, y }).collect();
            let expected = points
                .iter()
                .map(|q| ((q.x - x).powi(2) + (q.y - y).powi(2)).sqrt())
                .filter(|d| *d <= reach)
                .min_by(f64::total_cmp);
            let found = Field::new(points, Some((500.0, 300.0))).nearest(PixelPoint { x, y }, reach).map(|(_, d)| d);
            prop_assert_eq!(found, expected);
        }
    }
}
