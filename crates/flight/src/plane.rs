//! Maps of the image plane onto itself, in pixels: what a camera has beside the terms of its lens.

mod fisheye;
mod linear;
mod polynomial;

use serde::{Deserialize, Serialize};

pub use fisheye::{Fisheye, Law};
use linear::{Linear, inverse};
pub use polynomial::{HIGHEST_POWER, Polynomial, Term};

use crate::dual::Real;

/// A map of the plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum PlaneMap {
    Polynomial(Polynomial),
    /// To the place that the polynomial takes to the given one: a distortion that is stated from the image to the
    /// ideal plane.
    Undo(Polynomial),
    Fisheye(Fisheye),
}

impl PlaneMap {
    /// Where a place goes. What the map does not reach is no number.
    pub(crate) fn apply<T: Real>(&self, [x, y]: [T; 2]) -> [T; 2] {
        let at = [x.value(), y.value()];
        let (to, slope) = self.linear(at).unwrap_or(([f64::NAN; 2], [[f64::NAN; 2]; 2]));
        // Values by plain numbers, derivatives by the chain rule: cheaper than a polynomial of dual numbers, and an
        // inverse by iteration has its exact derivative.
        let (dx, dy) = (x - T::of(at[0]), y - T::of(at[1]));
        [0, 1].map(|k| T::of(to[k]) + T::of(slope[k][0]) * dx + T::of(slope[k][1]) * dy)
    }

    fn linear(&self, at: [f64; 2]) -> Option<Linear> {
        match self {
            PlaneMap::Polynomial(polynomial) => Some(polynomial.linear(at)),
            PlaneMap::Undo(polynomial) => {
                let from = polynomial.undo(at)?;
                Some((from, inverse(polynomial.linear(from).1)?))
            }
            PlaneMap::Fisheye(fisheye) => Some(fisheye.linear(at)),
        }
    }

    /// The place that goes to the given one; `None` where there is none.
    pub fn undo(&self, at: [f64; 2]) -> Option<[f64; 2]> {
        match self {
            PlaneMap::Polynomial(polynomial) => polynomial.undo(at),
            PlaneMap::Undo(polynomial) => Some(polynomial.linear(at).0),
            PlaneMap::Fisheye(fisheye) => fisheye.undo(at),
        }
    }

    /// Whether all its numbers can be reckoned with.
    pub fn is_sound(&self) -> bool {
        match self {
            PlaneMap::Polynomial(p) | PlaneMap::Undo(p) => p.is_sound(),
            PlaneMap::Fisheye(f) => f.scale_px > 0.0 && f.centre_px.iter().chain([&f.scale_px]).all(|v| v.is_finite()),
        }
    }

    /// The same map on a plane of another scale, origin and sense of the axes: `signs` are 1, or −1 where an axis is
    /// turned over, and a place p becomes `shift` + `scale` · `signs` · p.
    #[must_use]
    pub fn moved(&self, scale: f64, signs: [f64; 2], shift: [f64; 2]) -> Self {
        let there = |[x, y]: [f64; 2]| [shift[0] + scale * signs[0] * x, shift[1] + scale * signs[1] * y];
        let polynomial = |p: &Polynomial| p.signed(signs).placed(there(p.centre_px), p.scale_px * scale);
        match self {
            PlaneMap::Polynomial(p) => PlaneMap::Polynomial(polynomial(p)),
            PlaneMap::Undo(p) => PlaneMap::Undo(polynomial(p)),
            PlaneMap::Fisheye(f) => {
                PlaneMap::Fisheye(Fisheye { centre_px: there(f.centre_px), scale_px: f.scale_px * scale, ..f.clone() })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Dual;

    fn maps() -> Vec<PlaneMap> {
        let mut polynomial = Polynomial::new([2000.0, 1400.0], 3000.0);
        polynomial.add([2, 1], [0.02, -0.01]).add([0, 1], [1e-3, 2e-3]).add_radial(&[-0.1, 0.03]);
        polynomial.add_decentric(&[[1e-3, -5e-4], [2e-4, 3e-4]]);
        let fisheye = |law| PlaneMap::Fisheye(Fisheye { law, centre_px: [2010.0, 1390.0], scale_px: 1800.0 });
        let mut all: Vec<PlaneMap> = [Law::Equidistant, Law::Equisolid, Law::Stereographic].map(fisheye).into();
        all.extend([PlaneMap::Polynomial(polynomial.clone()), PlaneMap::Undo(polynomial)]);
        all
    }

    #[test]
    fn maps_are_undone_and_have_their_derivatives() {
        for map in maps() {
            for at in [[2010.0, 1390.0], [100.0, 200.0], [3900.0, 2500.0], [2010.0, 2000.0]] {
                let to = map.apply(at);
                let back = map.undo(to).expect("reached");
                assert!((back[0] - at[0]).hypot(back[1] - at[1]) < 1e-8, "{map:?} {at:?} {back:?}");
                let exact = map.apply([Dual::<2>::variable(at[0], 0), Dual::variable(at[1], 1)]);
                for (i, [dx, dy]) in [[1e-3, 0.0], [0.0, 1e-3]].into_iter().enumerate() {
                    let (near, far) = (map.apply([at[0] - dx, at[1] - dy]), map.apply([at[0] + dx, at[1] + dy]));
                    for k in 0..2 {
                        let slope = (far[k] - near[k]) / 2e-3;
                        assert!((exact[k].d[i] - slope).abs() < 1e-6, "{map:?} {at:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_moved_map_does_the_same_elsewhere() {
        let (scale, shift) = (0.5, [300.0, -20.0]);
        for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]] {
            let there = |[x, y]: [f64; 2]| [shift[0] + scale * signs[0] * x, shift[1] + scale * signs[1] * y];
            for map in maps() {
                let (to, wanted) =
                    (map.moved(scale, signs, shift).apply(there([500.0, 900.0])), there(map.apply([500.0, 900.0])));
                assert!((to[0] - wanted[0]).hypot(to[1] - wanted[1]) < 1e-9, "{map:?} {to:?} {wanted:?}");
            }
        }
    }

    #[test]
    fn a_map_is_what_it_was_after_a_file() {
        for map in maps() {
            let text = serde_json::to_string(&map).expect("written");
            assert_eq!(serde_json::from_str::<PlaneMap>(&text).expect(&text), map);
        }
    }

    #[test]
    fn places_beyond_a_fold_have_none() {
        let mut fold = Polynomial::new([0.0, 0.0], 1000.0);
        fold.add_radial(&[-0.3]);
        assert_eq!(fold.undo([1500.0, 0.0]), None);
        assert!(PlaneMap::Undo(fold).apply([1500.0, 0.0])[0].is_nan());
        let fisheye = Fisheye { law: Law::Equidistant, centre_px: [0.0; 2], scale_px: 1000.0 };
        assert_eq!(fisheye.undo([1600.0, 0.0]), None);
    }
}
