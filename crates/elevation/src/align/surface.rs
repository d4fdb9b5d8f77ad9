//! The surface that is left between two models beside a shift: a polynomial of low degree.

use std::fmt;
use std::str::FromStr;

/// Powers of u and v of the terms, by degree.
pub const TERMS: [(usize, usize); MOST_TERMS] =
    [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)];
/// Terms of the highest degree.
pub const MOST_TERMS: usize = 10;

/// Degree of a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Degree {
    /// A height alone.
    Level,
    /// A tilt.
    #[default]
    Linear,
    Quadratic,
    Cubic,
}

impl Degree {
    /// What may be asked for.
    pub const ALL: [Degree; 3] = [Degree::Linear, Degree::Quadratic, Degree::Cubic];

    /// As JSON has it.
    pub fn name(self) -> &'static str {
        match self {
            Degree::Level => "level",
            Degree::Linear => "linear",
            Degree::Quadratic => "quadratic",
            Degree::Cubic => "cubic",
        }
    }

    /// How many terms it has.
    pub fn terms(self) -> usize {
        match self {
            Degree::Level => 1,
            Degree::Linear => 3,
            Degree::Quadratic => 6,
            Degree::Cubic => MOST_TERMS,
        }
    }

    /// The next lower one; that of a level is a level.
    pub fn lower(self) -> Degree {
        match self {
            Degree::Level | Degree::Linear => Degree::Level,
            Degree::Quadratic => Degree::Linear,
            Degree::Cubic => Degree::Quadratic,
        }
    }
}

impl fmt::Display for Degree {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Degree {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        Degree::ALL
            .into_iter()
            .find(|degree| degree.name() == text)
            .ok_or_else(|| format!("`{text}` is no degree; choose from {}", Degree::ALL.map(Degree::name).join(", ")))
    }
}

/// Coefficients of [`TERMS`], in the normalised coordinates of a frame; those above the degree are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Surface {
    pub degree: Degree,
    pub coefficients: [f64; MOST_TERMS],
}

impl Surface {
    /// Its height at (u, v), which count from the middle in units of half the grid.
    pub fn at(&self, u: f64, v: f64) -> f64 {
        let terms = terms::<MOST_TERMS, 0>(u, v);
        self.coefficients[..self.degree.terms()].iter().zip(terms).map(|(c, term)| c * term).sum()
    }

    /// The same coefficients, as many as another degree has.
    pub fn of_degree(mut self, degree: Degree) -> Surface {
        self.degree = degree;
        self.coefficients[degree.terms()..].fill(0.0);
        self
    }

    /// Root mean square over −1…1, about the mean, of the terms from a degree on.
    pub fn rms_from(&self, degree: Degree) -> f64 {
        let first = degree.lower().terms();
        let high = || TERMS.iter().zip(self.coefficients).take(self.degree.terms()).skip(first);
        let mean: f64 = high().map(|(&(i, j), c)| c * moment(i) * moment(j)).sum();
        let square = |(&(i, j), a): (&(usize, usize), f64)| -> f64 {
            high().map(|(&(k, l), b)| a * b * moment(i + k) * moment(j + l)).sum()
        };
        (high().map(square).sum::<f64>() - mean * mean).max(0.0).sqrt()
    }
}

/// Mean of a power over −1…1.
fn moment(power: usize) -> f64 {
    if power.is_multiple_of(2) { 1.0 / (power as f64 + 1.0) } else { 0.0 }
}

/// The first terms at a place, from index `FROM` of an array on.
pub fn terms<const N: usize, const FROM: usize>(u: f64, v: f64) -> [f64; N] {
    let mut out = [0.0; N];
    let powers = [[1.0, u, u * u, u * u * u], [1.0, v, v * v, v * v * v]];
    for (term, (i, j)) in out[FROM..].iter_mut().zip(TERMS) {
        *term = powers[0][i] * powers[1][j];
    }
    out
}

/// What the coefficient of term `to` is made of, in coordinates counted from another place: its share of term `from`.
pub fn moved_share(to: usize, from: usize, u: f64, v: f64) -> f64 {
    let ((p, q), (i, j)) = (TERMS[to], TERMS[from]);
    if p > i || q > j {
        return 0.0;
    }
    let choose = |n: usize, k: usize| (0..k).fold(1.0, |c, step| c * (n - step) as f64 / (step + 1) as f64);
    choose(i, p) * choose(j, q) * u.powi((i - p) as i32) * v.powi((j - q) as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BENT: Surface =
        Surface { degree: Degree::Cubic, coefficients: [3.0, -1.0, 2.0, 0.5, 0.7, -0.3, 0.2, 0.1, -0.4, 0.6] };

    #[test]
    fn a_surface_counted_from_elsewhere_is_the_same() {
        let (u0, v0) = (0.3, -0.8);
        let shares =
            |to: usize| (0..MOST_TERMS).map(|from| moved_share(to, from, u0, v0) * BENT.coefficients[from]).sum();
        let moved = Surface { coefficients: std::array::from_fn(shares), ..BENT };
        for (u, v) in [(0.0, 0.0), (1.0, 0.4), (-0.7, 0.9)] {
            assert!((moved.at(u - u0, v - v0) - BENT.at(u, v)).abs() < 1e-12);
        }
    }

    #[test]
    fn its_root_mean_square_is_that_of_many_places() {
        let side = 400;
        let middle = |i: usize| (i as f64 + 0.5) / side as f64 * 2.0 - 1.0;
        for degree in Degree::ALL {
            let mut high = BENT;
            high.coefficients[..degree.lower().terms()].fill(0.0);
            let values = (0..side * side).map(|i| high.at(middle(i % side), middle(i / side)));
            let (sum, square) = values.fold((0.0, 0.0), |(s, q), z| (s + z, q + z * z));
            let n = (side * side) as f64;
            let rms = (square / n - (sum / n).powi(2)).sqrt();
            assert!((BENT.rms_from(degree) - rms).abs() < 1e-4, "{degree}: {rms}");
        }
        assert_eq!(BENT.of_degree(Degree::Linear).rms_from(Degree::Quadratic), 0.0);
    }
}
