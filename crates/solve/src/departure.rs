//! Is the image stretched or bent? A similarity against transforms of the kinds by which orthophotos go wrong.

use nalgebra::{Complex, DMatrix, DVector, RowDVector};

use crate::accuracy::error_map::quantile;
use crate::variance_ratio::chance_of_share;
use autoref_raster::coords::{Handedness, PixelPoint};

type Number = Complex<f64>;

/// What a fit leaves at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Where in the image.
    pub pixel: PixelPoint,
    /// Surveyed less fitted, or the other way round, the same for all.
    pub east_m: f64,
    /// Likewise.
    pub north_m: f64,
}

/// How an image departs from a similarity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Two scales or a shear: an affine transform.
    Stretched,
    /// As by a lens or a block that is domed: with the cube of the distance from the middle.
    Domed,
    /// By terms of the second degree.
    Bent,
}

impl Shape {
    /// From the simplest on.
    const ALL: [Shape; 3] = [Shape::Stretched, Shape::Domed, Shape::Bent];

    /// Terms of a place, those of the similarity first.
    fn terms(self, u: Number) -> Vec<Number> {
        let similarity = [Number::new(1.0, 0.0), u];
        let further = match self {
            Shape::Stretched => vec![u.conj()],
            Shape::Domed => vec![u * u.norm_sqr()],
            Shape::Bent => vec![u.conj(), u * u, u.conj() * u.conj(), Number::new(u.norm_sqr(), 0.0)],
        };
        similarity.into_iter().chain(further).collect()
    }
}

/// A transform that explains most of what the similarity leaves.
#[derive(Clone, Debug, PartialEq)]
pub struct Departure {
    /// Of which kind.
    pub shape: Shape,
    /// RMS at points that were left out of it in turn, metres.
    pub left_m: f64,
    handedness: Handedness,
    middle: PixelPoint,
    reach_px: f64,
    /// Metres east and north of what is written, by terms.
    coefficients: Vec<Number>,
    /// Of the normal equations.
    inverse: DMatrix<Number>,
    /// Radius that holds 95 of 100 errors of a place whose variance is a mark's, metres.
    radius_m: f64,
    marks: Marks,
}

/// Where the marks of a fit lie, and the largest of their residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Marks {
    middle: PixelPoint,
    reach_px: f64,
    worst_m: f64,
}

impl Marks {
    fn of(residuals: &[Residual]) -> Marks {
        let n = residuals.len() as f64;
        let mean = |of: fn(&Residual) -> f64| residuals.iter().map(of).sum::<f64>() / n;
        let middle = PixelPoint { x: mean(|at| at.pixel.x), y: mean(|at| at.pixel.y) };
        let worst_m = residuals.iter().map(|at| at.east_m.hypot(at.north_m)).fold(0.0, f64::max);
        Marks { middle, reach_px: reach_px(residuals, middle), worst_m }
    }

    /// The most that terms of the second degree put a place off by, metres. Along a row of marks they say nothing of
    /// what lies across. A polynomial of the second degree that is nowhere larger than 1 within a distance of 1 grows
    /// at most as Chebyshev's, 2ρ² − 1; between the marks it may be twice what it is at the worst of them.
    fn second_degree_m(&self, pixel: PixelPoint) -> f64 {
        let out = ((pixel.x - self.middle.x).hypot(pixel.y - self.middle.y) / self.reach_px).max(1.0);
        2.0 * self.worst_m * (2.0 * out * out - 1.0)
    }
}

/// How far the farthest lies from a place.
fn reach_px(residuals: &[Residual], from: PixelPoint) -> f64 {
    residuals.iter().map(|at| (at.pixel.x - from.x).hypot(at.pixel.y - from.y)).fold(1.0, f64::max)
}

/// Residuals of complex least squares: their sum of squares, and the RMS of points left out in turn.
struct Left {
    squares: f64,
    left_out: f64,
    coefficients: Vec<Number>,
    inverse: DMatrix<Number>,
}

impl Departure {
    /// The kind that explains the residuals of a similarity best, if one does: chance leaves that little once in some
    /// thousand fits, and points that are left out of it are nearer too. `middle` is that of the image.
    pub fn of(residuals: &[Residual], handedness: Handedness, middle: PixelPoint) -> Option<Departure> {
        /// Chance does as well in so many fits.
        const CHANCE: f64 = 3e-4;
        /// Points left out must be nearer by this factor: one wrong point bends a fit, and is farther off it when it is
        /// left out.
        const SHARE: f64 = 0.7;
        let (marks, reach_px) = (Marks::of(residuals), reach_px(residuals, middle));
        let places: Vec<Number> = residuals.iter().map(|at| place(at.pixel, handedness, middle, reach_px)).collect();
        let residuals: Vec<Number> = residuals.iter().map(|at| Number::new(at.east_m, at.north_m)).collect();
        let plain = fitted(&places, &residuals, |u| vec![Number::new(1.0, 0.0), u])?;
        let explains = |shape: Shape| {
            let left = fitted(&places, &residuals, |u| shape.terms(u))?;
            let terms = left.coefficients.len();
            let freedom = 2 * (places.len() - terms);
            let chance = chance_of_share(left.squares / plain.squares, freedom, 2 * (terms - 2));
            (chance < CHANCE && left.left_out < SHARE * plain.left_out).then_some((shape, left))
        };
        let found = Shape::ALL.into_iter().filter_map(explains);
        let (shape, left) = found.min_by(|a, b| a.1.left_out.total_cmp(&b.1.left_out))?;
        let Left { squares, left_out: left_m, coefficients, inverse } = left;
        let freedom = 2.0 * (places.len() - coefficients.len()) as f64;
        let radius_m = (squares / freedom).sqrt() * quantile(freedom);
        Some(Departure { shape, left_m, handedness, middle, reach_px, coefficients, inverse, radius_m, marks })
    }

    /// How far from where the written transform has a pixel this one has it, metres. Where the marks hardly tell
    /// (beside a row of them, or far outside), no farther in about 95 of 100 cases, and no less than at the worst of
    /// the marks.
    pub fn at_m(&self, pixel: PixelPoint) -> f64 {
        /// Variance of the place, in that of a mark: corners well beyond the marks have eight.
        const MOST_UNSURE: f64 = 25.0;
        let row = RowDVector::from_row_slice(&self.terms(pixel));
        let unsure = (&row * &self.inverse * row.adjoint())[(0, 0)].re;
        let off_m = self.fitted_m(pixel);
        if unsure <= MOST_UNSURE {
            return off_m;
        }
        let at_most_m = off_m + self.radius_m * unsure.sqrt();
        let at_most_m = match self.shape {
            Shape::Stretched | Shape::Domed => at_most_m,
            Shape::Bent => at_most_m.min(self.marks.second_degree_m(pixel)),
        };
        at_most_m.max(self.marks.worst_m)
    }

    /// The same as the marks have it, however little they tell of the place, metres.
    pub fn fitted_m(&self, pixel: PixelPoint) -> f64 {
        self.terms(pixel).iter().zip(&self.coefficients).map(|(term, c)| term * c).sum::<Number>().norm()
    }

    fn terms(&self, pixel: PixelPoint) -> Vec<Number> {
        self.shape.terms(place(pixel, self.handedness, self.middle, self.reach_px))
    }
}

/// A pixel as a number whose products with others turn and stretch it as a similarity does; 1 is as far out as the
/// farthest mark.
fn place(pixel: PixelPoint, handedness: Handedness, middle: PixelPoint, reach_px: f64) -> Number {
    let (x, y) = ((pixel.x - middle.x) / reach_px, (pixel.y - middle.y) / reach_px);
    match handedness {
        Handedness::AsIs => Number::new(x, -y),
        Handedness::Mirrored => Number::new(x, y),
    }
}

/// `None` with fewer than two points more than terms.
fn fitted(places: &[Number], values: &[Number], terms: impl Fn(Number) -> Vec<Number>) -> Option<Left> {
    let rows: Vec<Vec<Number>> = places.iter().map(|u| terms(*u)).collect();
    let columns = rows.first()?.len();
    if rows.len() < columns + 2 {
        return None;
    }
    let design = DMatrix::from_fn(rows.len(), columns, |i, k| rows[i][k]);
    let values = DVector::from_column_slice(values);
    let normal = design.adjoint() * &design;
    let inverse = normal.clone().try_inverse()?;
    // Marks in a row do not tell all terms: then the inverse is none.
    let is_inverse = (&normal * &inverse - DMatrix::identity(columns, columns)).iter().all(|v| v.norm() < 1e-6);
    if !is_inverse {
        return None;
    }
    let coefficients = &inverse * design.adjoint() * &values;
    let residuals = values - &design * &coefficients;
    let (mut squares, mut left_out) = (0.0, 0.0);
    for (row, residual) in design.row_iter().zip(residuals.iter()) {
        let share = (row * &inverse * row.adjoint())[(0, 0)].re;
        squares += residual.norm_sqr();
        left_out += residual.norm_sqr() / (1.0 - share).max(1e-9).powi(2);
    }
    let left_out = (left_out / rows.len() as f64).sqrt();
    Some(Left { squares, left_out, coefficients: coefficients.iter().copied().collect(), inverse })
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::SplitMix64;

    const MIDDLE: PixelPoint = PixelPoint { x: 1000.0, y: 750.0 };

    /// Marks all over the image, with a departure in metres and noise of 1 cm.
    fn drawn(n: usize, random: &mut SplitMix64, departs: impl Fn(Number) -> Number) -> Vec<Residual> {
        let residual = |_| {
            let pixel = PixelPoint { x: 2000.0 * random.unit(), y: 1500.0 * random.unit() };
            let off = departs(Number::new((pixel.x - MIDDLE.x) / 1250.0, -(pixel.y - MIDDLE.y) / 1250.0));
            Residual { pixel, east_m: off.re + 0.01 * random.normal(), north_m: off.im + 0.01 * random.normal() }
        };
        (0..n).map(residual).collect()
    }

    fn told(n: usize, draws: usize, departs: impl Fn(Number) -> Number + Copy) -> Vec<Shape> {
        let mut random = SplitMix64(7);
        let draw = |_| Departure::of(&drawn(n, &mut random, departs), Handedness::AsIs, MIDDLE).map(|d| d.shape);
        (0..draws).filter_map(draw).collect()
    }

    #[test]
    fn each_shape_is_told_by_its_own_terms_and_noise_by_none() {
        for n in [5, 6, 8, 10, 16] {
            let by_chance = told(n, 400, |_| Number::default()).len();
            assert!(by_chance <= 2, "{by_chance} of {n} points");
        }
        for (shape, departs) in [
            (Shape::Stretched, (|u: Number| 0.3 * u.conj()) as fn(Number) -> Number),
            (Shape::Domed, |u| 0.4 * u * u.norm_sqr()),
            (Shape::Bent, |u| Number::new(0.0, 0.5 * u.re * u.re)),
        ] {
            let told = told(12, 50, departs);
            let right = told.iter().filter(|found| **found == shape).count();
            assert!(right >= 45, "{shape:?}: {right} of {}", told.len());
        }
    }

    #[test]
    fn a_corner_is_as_far_off_as_the_shape_takes_it() {
        let all = drawn(14, &mut SplitMix64(3), |u| 0.4 * u * u.norm_sqr());
        let found = Departure::of(&all, Handedness::AsIs, MIDDLE).expect("a dome");
        let corner = PixelPoint { x: 0.0, y: 0.0 };
        let off = found.at_m(corner);
        assert!((off - 0.4).abs() < 0.05, "{off}");
        assert!(found.left_m < 0.03, "{}", found.left_m);
        // Of marks along a road nobody knows the bend beside it: as much as the worst of them is off, and no nonsense.
        let beside = |at: &Residual| PixelPoint { y: 735.0 + 0.02 * at.pixel.y, ..at.pixel };
        let road: Vec<Residual> = all.iter().map(|at| Residual { pixel: beside(at), ..*at }).collect();
        if let Some(along) = Departure::of(&road, Handedness::AsIs, MIDDLE) {
            let off = along.at_m(corner);
            assert!((0.3..10.0).contains(&off), "{:?}: {off}", along.shape);
        }
        // Of marks in the middle half the bend outside is known roughly, and never said to be less than it is.
        let inner = |at: &Residual| {
            let half = |v: f64, middle: f64| middle + 0.5 * (v - middle);
            let pixel = PixelPoint { x: half(at.pixel.x, MIDDLE.x), y: half(at.pixel.y, MIDDLE.y) };
            Residual { pixel, ..*at }
        };
        let inside: Vec<Residual> = all.iter().map(inner).collect();
        let found = Departure::of(&inside, Handedness::AsIs, MIDDLE).expect("a dome");
        let off = found.at_m(corner);
        // Half as wide, the same bend at the marks is eight times as large at the corner.
        assert!((3.0..5.0).contains(&off), "{off}");
        // Turned over, only a mirrored similarity takes it.
        let mirrored = Departure::of(&all, Handedness::Mirrored, MIDDLE);
        assert!(mirrored.is_none_or(|found| found.shape != Shape::Domed));
    }
}
