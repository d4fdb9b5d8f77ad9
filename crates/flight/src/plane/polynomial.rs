//! Polynomials of two variables that move the places of a plane.

use serde::{Deserialize, Serialize};

use super::linear::{Linear, inverse};

/// The highest power of x or y that is held: a radial distortion to r⁴¹.
pub const HIGHEST_POWER: usize = 41;

/// What xⁱ yʲ adds to x and to y.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "(u8, u8, f64, f64)", into = "(u8, u8, f64, f64)")]
pub struct Term {
    pub powers: [u8; 2],
    pub adds: [f64; 2],
}

impl From<(u8, u8, f64, f64)> for Term {
    fn from((i, j, x, y): (u8, u8, f64, f64)) -> Self {
        Term { powers: [i, j], adds: [x, y] }
    }
}

impl From<Term> for (u8, u8, f64, f64) {
    fn from(term: Term) -> Self {
        let ([i, j], [x, y]) = (term.powers, term.adds);
        (i, j, x, y)
    }
}

/// With (x, y) = (place − `centre_px`) / `scale_px`: place + `scale_px` · Σ `adds` xⁱ yʲ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Polynomial {
    pub centre_px: [f64; 2],
    /// Pixels that count as one.
    pub scale_px: f64,
    terms: Vec<Term>,
}

impl Polynomial {
    /// Moves nothing.
    pub fn new(centre_px: [f64; 2], scale_px: f64) -> Self {
        Polynomial { centre_px, scale_px, terms: Vec::new() }
    }

    /// Its terms, in the order in which they are summed.
    pub fn terms(&self) -> &[Term] {
        &self.terms
    }

    /// Whether all its numbers can be reckoned with.
    pub fn is_sound(&self) -> bool {
        let highest = self.terms.iter().flat_map(|t| t.powers).max().unwrap_or(0);
        let numbers = self.terms.iter().flat_map(|t| t.adds).chain(self.centre_px);
        usize::from(highest) <= HIGHEST_POWER
            && self.scale_px > 0.0
            && numbers.chain([self.scale_px]).all(f64::is_finite)
    }

    /// Adds to what xⁱ yʲ adds.
    ///
    /// # Panics
    /// When a power is beyond [`HIGHEST_POWER`].
    pub fn add(&mut self, powers: [u8; 2], adds: [f64; 2]) -> &mut Self {
        assert!(powers.iter().all(|p| usize::from(*p) <= HIGHEST_POWER), "a power that is held");
        if adds == [0.0; 2] {
            return self;
        }
        match self.terms.binary_search_by_key(&powers, |t| t.powers) {
            Ok(at) => (0..2).for_each(|k| self.terms[at].adds[k] += adds[k]),
            Err(at) => self.terms.insert(at, Term { powers, adds }),
        }
        self
    }

    /// (x, y) · Σ cₖ r²ᵏ, k from 1.
    pub fn add_radial(&mut self, coefficients: &[f64]) -> &mut Self {
        for (k, c) in (1..).zip(coefficients) {
            for (powers, share) in radius_to(k) {
                self.add([powers[0] + 1, powers[1]], [c * share, 0.0]);
                self.add([powers[0], powers[1] + 1], [0.0, c * share]);
            }
        }
        self
    }

    /// What a displaced centre changes of (x, y) r²ᵏ, for every k from 1 a pair (a, b):
    /// a (r²ᵏ + 2k x² r²ᵏ⁻², 2k x y r²ᵏ⁻²) + b (2k x y r²ᵏ⁻², r²ᵏ + 2k y² r²ᵏ⁻²).
    pub fn add_decentric(&mut self, pairs: &[[f64; 2]]) -> &mut Self {
        for (k, [a, b]) in (1_u8..).zip(pairs) {
            for (powers, share) in radius_to(k) {
                self.add(powers, [a * share, b * share]);
            }
            for ([i, j], share) in radius_to(k - 1) {
                let twice = 2.0 * f64::from(k) * share;
                self.add([i + 2, j], [a * twice, 0.0]);
                self.add([i + 1, j + 1], [b * twice, a * twice]);
                self.add([i, j + 2], [0.0, b * twice]);
            }
        }
        self
    }

    /// The same map about another centre (its constants move the whole plane).
    #[must_use]
    pub fn about(&self, centre_px: [f64; 2]) -> Self {
        let off = [0, 1].map(|k| (centre_px[k] - self.centre_px[k]) / self.scale_px);
        let mut moved = Polynomial::new(centre_px, self.scale_px);
        for term in &self.terms {
            let [i, j] = term.powers;
            for a in 0..=i {
                for b in 0..=j {
                    let share = choose(i, a) * off[0].powi(i32::from(i - a));
                    let share = share * choose(j, b) * off[1].powi(i32::from(j - b));
                    moved.add([a, b], term.adds.map(|v| v * share));
                }
            }
        }
        moved
    }

    /// The same coefficients elsewhere.
    pub(super) fn placed(mut self, centre_px: [f64; 2], scale_px: f64) -> Self {
        (self.centre_px, self.scale_px) = (centre_px, scale_px);
        self
    }

    /// The map of a plane whose axes run by `signs`.
    pub(super) fn signed(&self, signs: [f64; 2]) -> Self {
        let mut turned = self.clone();
        for term in &mut turned.terms {
            let sign = signs[0].powi(i32::from(term.powers[0])) * signs[1].powi(i32::from(term.powers[1]));
            (0..2).for_each(|k| term.adds[k] *= sign * signs[k]);
        }
        turned
    }

    pub(super) fn linear(&self, at: [f64; 2]) -> Linear {
        let mut powers = [[1.0; HIGHEST_POWER + 1]; 2];
        for k in 0..2 {
            let unit = (at[k] - self.centre_px[k]) / self.scale_px;
            let highest = self.terms.iter().map(|t| usize::from(t.powers[k])).max().unwrap_or(0);
            for n in 1..=highest {
                powers[k][n] = powers[k][n - 1] * unit;
            }
        }
        let (mut moved, mut slope) = ([0.0; 2], [[1.0, 0.0], [0.0, 1.0]]);
        for term in &self.terms {
            let [i, j] = term.powers.map(usize::from);
            let value = powers[0][i] * powers[1][j];
            let by_x = if i == 0 { 0.0 } else { i as f64 * powers[0][i - 1] * powers[1][j] };
            let by_y = if j == 0 { 0.0 } else { j as f64 * powers[0][i] * powers[1][j - 1] };
            for k in 0..2 {
                moved[k] += term.adds[k] * value;
                slope[k][0] += term.adds[k] * by_x;
                slope[k][1] += term.adds[k] * by_y;
            }
        }
        ([0, 1].map(|k| at[k] + self.scale_px * moved[k]), slope)
    }

    /// The place that goes to the given one, by Newton's method from that itself, so that beyond a fold none is found.
    pub(super) fn undo(&self, to: [f64; 2]) -> Option<[f64; 2]> {
        let off = |[x, y]: [f64; 2]| (x - to[0]).hypot(y - to[1]);
        // A hundredth of what rounding leaves of places of this size.
        let least = 1e-14 * (self.scale_px + to[0].abs().max(to[1].abs()));
        let mut from = to;
        let (mut at, mut slope) = self.linear(from);
        let mut error = off(at);
        for _ in 0..60 {
            if error <= least {
                break;
            }
            let back = inverse(slope)?;
            let rest = [to[0] - at[0], to[1] - at[1]];
            let step = back.map(|row| row[0] * rest[0] + row[1] * rest[1]);
            let mut part = 1.0;
            loop {
                let next = [from[0] + part * step[0], from[1] + part * step[1]];
                let there = self.linear(next);
                if off(there.0) < error {
                    (from, at, slope, error) = (next, there.0, there.1, off(there.0));
                    break;
                }
                part *= 0.5;
                if part < 1e-6 {
                    // Rounding: nothing better is near.
                    return (error < 1e5 * least).then_some(from);
                }
            }
        }
        (error < 1e5 * least).then_some(from)
    }
}

/// n over k.
fn choose(n: u8, k: u8) -> f64 {
    (0..k).fold(1.0, |c, m| c * f64::from(n - m) / f64::from(m + 1))
}

/// r²ᵏ = (x² + y²)ᵏ: powers and coefficients.
fn radius_to(k: u8) -> impl Iterator<Item = ([u8; 2], f64)> {
    (0..=k).map(move |m| ([2 * (k - m), 2 * m], choose(k, m)))
}
