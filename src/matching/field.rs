//! The candidates as a field of points: nearest point, points at a distance, local density.

use autoref_raster::coords::PixelPoint;
use autoref_raster::ranks::upper_median;

/// Points in buckets of two square grids.
pub struct Field {
    points: Vec<PixelPoint>,
    origin: PixelPoint,
    /// Points per px² of the whole field.
    density: f64,
    /// About one point a cell, for large boxes.
    coarse: Grid,
    /// For small ones: where points lie in clumps, a coarse cell holds most of them.
    fine: Grid,
    pub width_px: f64,
    pub height_px: f64,
    /// [`Field::density_near`] each point.
    densities: Vec<f64>,
    /// Sorted distances from `sampled` of the points to all others within the disc that would hold one by chance.
    neighbours: Vec<f64>,
    sampled: usize,
    /// Larger side of each point's mark, pixels; empty when unknown.
    sizes_px: Vec<f64>,
    usual_size_px: f64,
}

/// Cells of the fine grid at least: so many stay in the near cache.
const FINE_CELLS: f64 = 32_768.0;

/// Side of a mark of which only the centre is known.
const UNKNOWN_SIZE_PX: f64 = 8.0;
/// Parts of one mark lie this far apart at most, in sides of a part.
const PLACE_PER_SIZE: f64 = 1.5;

/// Points whose neighbours are counted.
const MOST_SAMPLED: usize = 2000;

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
        // About one point a cell; never more than four million cells, nor as many along a thin field.
        let cell = (width * height / points.len().max(1) as f64).sqrt().max((width * height / 4e6).sqrt()).max(1.0);
        let cell = cell.max(width.max(height) / 4e6);
        let fine = (width * height / FINE_CELLS).sqrt().clamp(1.0, cell.max(1.0)).max(width.max(height) / 4e6);
        let density = points.len() as f64 / (width * height);
        let origin = PixelPoint { x: low.0, y: low.1 };
        let grid = |cell: f64| Grid::new(&points, origin, (width, height), cell);
        let (coarse, fine) = (grid(cell), grid(fine));
        let mut field = Field {
            points,
            origin,
            density,
            coarse,
            fine,
            width_px: width,
            height_px: height,
            densities: Vec::new(),
            neighbours: Vec::new(),
            sampled: 0,
            sizes_px: Vec::new(),
            usual_size_px: UNKNOWN_SIZE_PX,
        };
        field.measure_neighbours();
        field.densities = field.points.iter().map(|p| field.density_near(*p)).collect();
        field
    }

    /// With the larger side of each point's mark, pixels; zero or less where it is unknown.
    ///
    /// # Panics
    /// When there are not as many sides as points.
    #[must_use]
    pub fn with_sizes(mut self, mut sizes_px: Vec<f64>) -> Self {
        assert_eq!(sizes_px.len(), self.points.len(), "a size for every point");
        let known = |side: &f64| if *side > 0.0 { *side } else { UNKNOWN_SIZE_PX };
        sizes_px.iter_mut().for_each(|side| *side = known(side));
        let usual_px = upper_median(&mut sizes_px.clone()).unwrap_or(UNKNOWN_SIZE_PX);
        // A roof among the marks must not make a whole quarter one place.
        sizes_px.iter_mut().for_each(|side| *side = side.min(2.0 * usual_px));
        self.usual_size_px = usual_px;
        self.sizes_px = sizes_px;
        self
    }

    /// Distance within which another point may be a part of the same mark, pixels.
    pub fn place_px(&self, index: usize) -> f64 {
        PLACE_PER_SIZE * self.sizes_px.get(index).copied().unwrap_or(UNKNOWN_SIZE_PX)
    }

    /// The same for the usual mark.
    pub fn usual_place_px(&self) -> f64 {
        PLACE_PER_SIZE * self.usual_size_px
    }

    /// Whether two points may be parts of one mark.
    pub fn one_place(&self, one: usize, other: usize) -> bool {
        let (p, q) = (self.points[one], self.points[other]);
        (p.x - q.x).hypot(p.y - q.y) < (self.place_px(one) + self.place_px(other)) / 2.0
    }

    /// The points, pixels, in the order in which they came.
    pub fn points(&self) -> &[PixelPoint] {
        &self.points
    }

    /// Points per px² about a point, itself left out; see [`Field::density_near`].
    #[inline]
    pub fn density_at(&self, index: usize) -> f64 {
        self.densities[index]
    }

    /// The upper left corner of the box around all points.
    pub fn origin(&self) -> PixelPoint {
        self.origin
    }

    /// Area of the box around all points.
    pub fn area_px2(&self) -> f64 {
        self.width_px * self.height_px
    }

    /// Points per px² of the whole field.
    #[inline]
    pub fn density(&self) -> f64 {
        self.density
    }

    /// Whether a place lies in that box, its edges included.
    #[inline]
    pub fn contains(&self, p: PixelPoint) -> bool {
        // Without a branch: it is asked of many places that lie in and out in turn.
        (p.x >= self.origin.x)
            & (p.y >= self.origin.y)
            & (p.x <= self.origin.x + self.width_px)
            & (p.y <= self.origin.y + self.height_px)
    }

    /// Calls `visit` with every point in the square of half-side `reach_px` about `p`, and some more.
    pub fn around(&self, p: PixelPoint, reach_px: f64, visit: impl FnMut(usize, PixelPoint)) {
        self.in_box((p.x - reach_px, p.x + reach_px), (p.y - reach_px, p.y + reach_px), visit);
    }

    /// Calls `visit` with every point of a box, and some more.
    #[inline]
    pub fn in_box(&self, x: (f64, f64), y: (f64, f64), mut visit: impl FnMut(usize, PixelPoint)) {
        let grid = if (y.1 - y.0) * self.coarse.cells_per_px < 1.0 { &self.fine } else { &self.coarse };
        grid.in_box(x, y, |i| visit(i as usize, self.points[i as usize]));
    }

    /// The nearest point within `reach_px`; the lower index when two are equally near.
    #[inline]
    pub fn nearest(&self, p: PixelPoint, reach_px: f64) -> Option<(usize, f64)> {
        self.nearest_of(p, reach_px, |_| true)
    }

    /// The same among the points that `may` says.
    #[inline]
    pub fn nearest_of(&self, p: PixelPoint, reach_px: f64, may: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
        self.nearest_square(p, reach_px, may).map(|(i, square)| (i, square.sqrt()))
    }

    /// The same with the square of its distance.
    #[inline]
    pub fn nearest_square(&self, p: PixelPoint, reach_px: f64, may: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        self.around(p, reach_px, |i, q| {
            let square = (q.x - p.x).powi(2) + (q.y - p.y).powi(2);
            let nearer = best.is_none_or(|(j, s)| square < s || (square == s && i < j));
            if square <= reach_px * reach_px && nearer && may(i) {
                best = Some((i, square));
            }
        });
        best
    }

    fn measure_neighbours(&mut self) {
        let reach = (self.area_px2() / (self.points.len().max(1) as f64 * std::f64::consts::PI)).sqrt();
        let step = self.points.len().div_ceil(MOST_SAMPLED).max(1);
        let mut distances = Vec::new();
        for i in (0..self.points.len()).step_by(step) {
            let p = self.points[i];
            self.around(p, reach, |j, q| {
                let distance = (q.x - p.x).hypot(q.y - p.y);
                if j != i && distance <= reach {
                    distances.push(distance);
                }
            });
        }
        distances.sort_by(f64::total_cmp);
        self.neighbours = distances;
        self.sampled = self.points.len().div_ceil(step);
    }

    /// Where points come in twos or in clumps: how often one has another within twice a distance. `None` where they
    /// have no more than an even field would give them (B. D. Ripley, "Modelling spatial patterns", 1977: the K
    /// function), and for distances at which neighbours are no clumps.
    pub fn company(&self, distance_px: f64) -> Option<f64> {
        let reach = 2.0 * distance_px;
        let expected = self.sampled as f64 * self.density * std::f64::consts::PI * reach * reach;
        if expected > self.sampled as f64 {
            return None;
        }
        let seen = self.neighbours.partition_point(|d| *d <= reach) as f64;
        // Pairs are counted from both ends: the spread of the count is twice that of as many single events.
        (seen > expected + 6.0 * expected.sqrt() + 6.0).then(|| (seen / self.sampled as f64).min(1.0))
    }

    /// Points per px² about `p`: the largest of the whole field's and of discs that would hold 16, 4 and 1 points of
    /// the whole field's. Clutter in clumps and rows makes accidents likelier just there, so the estimate leans to the
    /// dense side. Each disc leaves out one point: the hit whose chance is asked for.
    pub fn density_near(&self, p: PixelPoint) -> f64 {
        let radii = [16.0, 4.0, 1.0].map(|expected| (expected / (self.density * std::f64::consts::PI)).sqrt());
        let squares = radii.map(|radius| radius * radius);
        let mut counts = [0u32; 3];
        self.around(p, radii[0], |_, q| {
            let square = (q.x - p.x).powi(2) + (q.y - p.y).powi(2);
            for (count, disc) in counts.iter_mut().zip(squares) {
                *count += u32::from(square <= disc);
            }
        });
        let local = |(count, disc): (u32, f64)| f64::from(count.saturating_sub(1)) / (std::f64::consts::PI * disc);
        counts.into_iter().zip(squares).map(local).fold(self.density, f64::max)
    }
}

/// Indices of points by the cell that they lie in.
struct Grid {
    origin: PixelPoint,
    cells_per_px: f64,
    columns: usize,
    rows: usize,
    /// Start of each cell's indices; one more than there are cells.
    starts: Vec<u32>,
    indices: Vec<u32>,
}

impl Grid {
    fn new(points: &[PixelPoint], origin: PixelPoint, (width, height): (f64, f64), cell_px: f64) -> Grid {
        let (columns, rows) = ((width / cell_px) as usize + 1, (height / cell_px) as usize + 1);
        let starts = vec![0; columns * rows + 1];
        let mut grid = Grid { origin, cells_per_px: 1.0 / cell_px, columns, rows, starts, indices: Vec::new() };
        let cells: Vec<usize> = points.iter().map(|p| grid.cell(*p)).collect();
        for &cell in &cells {
            grid.starts[cell + 1] += 1;
        }
        for i in 1..grid.starts.len() {
            grid.starts[i] += grid.starts[i - 1];
        }
        let mut next = grid.starts.clone();
        grid.indices = vec![0; points.len()];
        for (i, &cell) in cells.iter().enumerate() {
            grid.indices[next[cell] as usize] = i as u32;
            next[cell] += 1;
        }
        grid
    }

    // At most some million cells: a conversion to 32 bits is one instruction, to 64 without sign it is many.
    #[inline]
    fn column(&self, x: f64) -> usize {
        (((x - self.origin.x) * self.cells_per_px).max(0.0) as i32 as usize).min(self.columns - 1)
    }

    #[inline]
    fn row(&self, y: f64) -> usize {
        (((y - self.origin.y) * self.cells_per_px).max(0.0) as i32 as usize).min(self.rows - 1)
    }

    fn cell(&self, p: PixelPoint) -> usize {
        self.row(p.y) * self.columns + self.column(p.x)
    }

    #[inline]
    fn in_box(&self, x: (f64, f64), y: (f64, f64), mut visit: impl FnMut(u32)) {
        let (left, right) = (self.column(x.0), self.column(x.1));
        for row in self.row(y.0)..=self.row(y.1) {
            let start = self.starts[row * self.columns + left] as usize;
            let end = self.starts[row * self.columns + right + 1] as usize;
            self.indices[start..end].iter().for_each(|&i| visit(i));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::Mmix;
    use proptest::prelude::*;

    #[test]
    fn a_point_far_away_makes_no_field_of_all_cells_on_the_way() {
        let points = [(0.0, 0.0), (40.0, 3.0), (1e20, 5.0)].map(|(x, y)| PixelPoint { x, y });
        let field = Field::new(points.to_vec(), None);
        for grid in [&field.coarse, &field.fine] {
            assert!(grid.starts.len() < 10_000_000, "{} cells", grid.starts.len());
        }
    }

    #[test]
    fn points_in_twos_have_company_and_even_ones_have_none() {
        let mut draws = Mmix(7);
        let even: Vec<PixelPoint> =
            (0..300).map(|_| PixelPoint { x: 8000.0 * draws.unit(), y: 6000.0 * draws.unit() }).collect();
        let twos: Vec<PixelPoint> =
            even[..150].iter().flat_map(|p| [*p, PixelPoint { x: p.x + 20.0, y: p.y }]).collect();
        let (even, twos) = (Field::new(even, Some((8000.0, 6000.0))), Field::new(twos, Some((8000.0, 6000.0))));
        assert!([5.0, 20.0, 60.0, 100.0].iter().all(|d| even.company(*d).is_none()));
        assert!(twos.company(20.0).is_some_and(|share| share > 0.95));
        assert_eq!(twos.company(5.0), None);
    }

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
