//! Rows of polygons: which pixels of a row have their centre inside.

use crate::shapes::Shape;

/// An edge that is not level, its upper end first.
#[derive(Clone, Copy)]
struct Edge {
    upper: [f64; 2],
    lower: [f64; 2],
}

impl Edge {
    fn x_at(&self, y: f64) -> f64 {
        let [x0, y0] = self.upper;
        let [x1, y1] = self.lower;
        x0 + (y - y0) / (y1 - y0) * (x1 - x0)
    }
}

/// A shape, filled row by row from the top by the even–odd rule, as [`Shape::contains`] answers for the pixels'
/// centres. Costs the edges that cross a row, not all of them.
pub struct Fill {
    /// By their upper ends.
    edges: Vec<Edge>,
    begun: usize,
    crossing: Vec<Edge>,
    next_row: usize,
    row_px: f64,
}

impl Fill {
    /// Rows of pixels that stand for `factor` × `factor` of the shape's.
    pub fn new(shape: &Shape, factor: usize) -> Fill {
        let mut edges = Vec::new();
        for ring in &shape.rings {
            for (&a, &b) in ring.iter().zip(ring.iter().cycle().skip(1)) {
                if a[1] < b[1] {
                    edges.push(Edge { upper: a, lower: b });
                } else if a[1] > b[1] {
                    edges.push(Edge { upper: b, lower: a });
                }
            }
        }
        edges.sort_by(|a, b| a.upper[1].total_cmp(&b.upper[1]));
        Fill { edges, begun: 0, crossing: Vec::new(), next_row: 0, row_px: factor as f64 }
    }

    /// Calls `run(start, end)` for every run of pixels inside the shape in row `y`, left to right; rows are asked for
    /// from the top.
    ///
    /// # Panics
    /// When a row above the last one is asked for.
    pub fn row(&mut self, y: usize, width: usize, mut run: impl FnMut(usize, usize)) {
        assert!(y >= self.next_row, "rows are filled from the top");
        self.next_row = y;
        let middle = (y as f64 + 0.5) * self.row_px;
        while let Some(edge) = self.edges.get(self.begun).filter(|edge| edge.upper[1] <= middle) {
            self.crossing.push(*edge);
            self.begun += 1;
        }
        self.crossing.retain(|edge| edge.lower[1] > middle);
        let mut places: Vec<f64> = self.crossing.iter().map(|edge| edge.x_at(middle)).collect();
        places.sort_by(f64::total_cmp);
        let first_from = |x: f64| ((x / self.row_px - 0.5).ceil().max(0.0) as usize).min(width);
        for pair in places.chunks_exact(2) {
            let (start, end) = (first_from(pair[0]), first_from(pair[1]));
            if start < end {
                run(start, end);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::Meaning;
    use autoref_raster::random::SplitMix64;

    #[test]
    fn filled_rows_hold_the_pixels_whose_centre_is_inside() {
        let mut random = SplitMix64(3);
        for factor in [1, 2, 3, 4] {
            for corners in [3, 4, 7, 40] {
                let mut ring =
                    || (0..corners).map(|_| [90.0 * random.unit() - 5.0, 70.0 * random.unit() - 5.0]).collect();
                let shape = Shape {
                    class: "sky".into(),
                    meaning: Meaning::Mask,
                    frame: None,
                    // A level edge and corners on the pixels' centres beside what is drawn at random.
                    rings: vec![ring(), ring(), vec![[10.5, 10.5], [30.5, 10.5], [30.5, 20.5], [10.5, 20.5]]],
                    place: String::new(),
                    file: None,
                };
                let (width, height) = (80_usize.div_ceil(factor), 60_usize.div_ceil(factor));
                let mut fill = Fill::new(&shape, factor);
                for y in 0..height {
                    let mut row = vec![false; width];
                    fill.row(y, width, |start, end| row[start..end].fill(true));
                    for (x, inside) in row.iter().enumerate() {
                        let centre = [(x as f64 + 0.5) * factor as f64, (y as f64 + 0.5) * factor as f64];
                        assert_eq!(*inside, shape.contains(centre), "{centre:?}");
                    }
                }
            }
        }
    }
}
