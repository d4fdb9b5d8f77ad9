//! One elevation model brought onto another: shift, height, tilt, and a surface of low degree.
//!
//! `auto` searches for the shift from coarse to fine and then fits shift and surface together, robustly (module `fit`);
//! `nuth-kaab` is C. Nuth and A. Kääb, *Co-registration and bias corrections of satellite elevation data sets for
//! quantifying glacier thickness change*, 2011; `lzd`, `bias` and `tilt` are parts of the joint fit.

mod block;
mod covariance;
mod fit;
mod method;
mod nuth_kaab;
mod pair;
mod parameters;
mod pyramid;
mod residuals;
mod search;
mod smooth;
mod spread;
mod sums;
mod surface;
mod weighing;

use nalgebra::{DMatrix, Matrix3};

use crate::error::{Error, Result};
use crate::grid::{Grid, GroundUnit};
use crate::kept::Kept;
use crate::source::{Cropped, Heights, Means as Averaged};
use crate::zeros::Zeros;

pub use method::{Method, Options};
use pair::{Frame, Pair};
use parameters::{SHIFTS, State};
use search::{Fitted, Found};
pub use spread::Spread;
use sums::Flats;
pub use surface::Degree;
use surface::{MOST_TERMS, TERMS, moved_share};

/// What was applied to A.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// East and north in the units of the CRS.
    pub shift: (f64, f64),
    /// East, north, up in metres; the height is that at [`Alignment::centre`].
    pub shift_m: [f64; 3],
    /// Of `shift_m`, square metres: east, north, height.
    pub covariance_m2: Matrix3<f64>,
    /// Rise of the correction towards east and north at [`Alignment::centre`], metres per metre, when a tilt was taken
    /// out.
    pub tilt: Option<Tilt>,
    /// What the correction has above the tilt, when such a surface was taken out.
    pub bend: Option<Bend>,
    /// Where the height counts: the middle of the aligned A.
    pub centre: (f64, f64),
    pub nmad_before_m: f64,
    pub nmad_after_m: f64,
    pub median_before_m: f64,
    pub median_after_m: f64,
    /// Share of the common cells that took part.
    pub stable_share: f64,
    pub common_cells: u64,
    pub iterations: u32,
    pub zeros: Zeros,
}

/// A tilt and its standard errors, metres per metre towards east and north.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tilt {
    pub east: f64,
    pub north: f64,
    pub east_se: f64,
    pub north_se: f64,
}

/// A surface above the tilt: Σ metres · u^east · v^north, where u and v count from [`Alignment::centre`] to east and
/// north in `half_m`.
#[derive(Clone, Debug, PartialEq)]
pub struct Bend {
    pub degree: Degree,
    pub half_m: (f64, f64),
    pub terms: Vec<BendTerm>,
}

/// One term of a [`Bend`] and its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BendTerm {
    pub east: usize,
    pub north: usize,
    pub metres: f64,
    pub se_m: f64,
}

impl Bend {
    /// At so many metres east and north of the centre.
    fn at(&self, east_m: f64, north_m: f64) -> f64 {
        let (u, v) = (east_m / self.half_m.0, north_m / self.half_m.1);
        self.terms.iter().map(|t| t.metres * u.powi(t.east as i32) * v.powi(t.north as i32)).sum()
    }
}

impl Alignment {
    /// What is added to A's height at a map position of the aligned A.
    pub fn height_at(&self, x: f64, y: f64, unit: &GroundUnit) -> f64 {
        let Some(tilt) = self.tilt else { return self.shift_m[2] };
        let (mx, my) = unit.metres_per_unit(self.centre.1);
        let plane = self.shift_m[2] + tilt.east * (x - self.centre.0) * mx + tilt.north * (y - self.centre.1) * my;
        let Some(bend) = &self.bend else { return plane };
        plane + bend.at((x - self.centre.0) * mx, (y - self.centre.1) * my)
    }
}

/// An answer, or why there is none.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    Aligned(Box<Alignment>),
    Refused(String),
}

/// Cells of the finer model along one of the coarser that are told apart, at least.
const FINEST: f64 = 4.0;
/// So many cells around the smaller model the larger one is looked at, at least.
const LEAST_REACH_PX: f64 = 128.0;
/// A mean residual of more standard errors of the height than this is no accident.
const LEANING: f64 = 3.0;

/// Finds what brings `a` onto `b`; both are in metres and on grids of one CRS.
///
/// # Errors
/// When a model cannot be read, or the two have no ground in common.
pub fn align(a: &dyn Heights, b: &dyn Heights, options: &Options<'_>) -> Result<Outcome> {
    let (ga, gb) = (a.grid(), b.grid());
    if ga.overlap(&gb).is_none() {
        return Err(Error::usage("the two models have no ground in common", "look at their extents with gdalinfo"));
    }
    let area = |g: &Grid| (g.step_x * g.step_y).abs();
    // The finer one is brought onto the coarser one's grid.
    let coarse_a = area(&ga) > 1.5 * area(&gb);
    let (template, other) = if coarse_a { (a, b) } else { (b, a) };
    // Of a much finer one, few cells under each of the coarser one's are kept.
    let ratio = (area(&template.grid()) / area(&other.grid())).sqrt();
    let other = Averaged::new(other, (ratio / FINEST).max(1.0) as u64);
    let finer = (area(&template.grid()) / area(&other.grid())).sqrt().round().max(1.0) as u64;
    // Beyond half of the smaller one's size, or some cells, nothing is looked for.
    let cell = (template.grid().step_x.abs(), template.grid().step_y.abs());
    let reach = |small: &Grid| {
        let w = small.bounds();
        let half = ((w[2] - w[0]) / 2.0, (w[3] - w[1]) / 2.0);
        let (x, y) = (half.0.max(LEAST_REACH_PX * cell.0), half.1.max(LEAST_REACH_PX * cell.1));
        [w[0] - x, w[1] - y, w[2] + x, w[3] + y]
    };
    let none = || Error::usage("the two models have no ground in common", "look at their extents with gdalinfo");
    let template = Cropped::new(template, reach(&other.grid()), 1).ok_or_else(none)?;
    let other = Cropped::new(&other, reach(&template.grid()), 1).ok_or_else(none)?;
    let frame = Frame::of(&template.grid());
    let (kept_template, kept_other) = Kept::both(&template, &other, options.room, options.means)?;
    let means = match (&kept_template, &kept_other) {
        (Some(Kept::InMemory(_)), Some(Kept::InMemory(_))) => options.means.cached(),
        (Some(Kept::OnDisk(_)), _) | (_, Some(Kept::OnDisk(_))) => options.means.flat(),
        _ => options.means,
    };
    let options = &Options { means, ..*options };
    let template: &dyn Heights = kept_template.as_ref().map_or(&template, |kept| kept);
    let other: &dyn Heights = kept_other.as_ref().map_or(&other, |kept| kept);
    let full = Pair { template, other, finer, unit: options.unit, stable: options.stable, frame };

    let mut found = search::run(&full, options, Flats::LeftOut)?;
    if matches!(found, Found::Nothing(_)) && !options.method.moves() {
        // Without any slope, a height and a tilt can still be had.
        found = search::run(&full, options, Flats::Kept)?;
    }
    let mut fitted = match found {
        Found::Nothing(why) => {
            if spread::of(&full, &State::default(), options.means)?.count == 0 {
                let remedy = "look at their extents, nodata values and --stable with gdalinfo -stats";
                return Err(Error::usage("the two models have no cell with heights in common", remedy));
            }
            return Ok(Outcome::Refused(why));
        }
        Found::Fitted(fitted) => fitted,
    };
    let [before, after] = spread::of_each(&full, [&State::default(), &fitted.state], options.means)?;
    // Ground that coarse cells or a filter smooth out leaves differences that lean to one side: a robust height is
    // drawn from the mean, which averaging keeps, by something that the scatter of blocks does not show.
    let leans = after.mean.powi(2) > LEANING.powi(2) * fitted.covariance[(2, 2)];
    if after.mean.is_finite() && (finer > 1 || leans) {
        fitted.covariance[(2, 2)] += after.mean * after.mean;
    }
    // The other model is read at X + shift: where it is A, A itself moves the other way.
    let sign = if coarse_a { 1.0 } else { -1.0 };
    Ok(Outcome::Aligned(Box::new(in_metres(&full, &fitted, sign, &ga, (before, after)))))
}

/// The fit in the words of the caller: what A goes through, in metres.
fn in_metres(full: &Pair<'_>, fitted: &Fitted, sign: f64, a: &Grid, spreads: (Spread, Spread)) -> Alignment {
    let (state, frame, grid) = (&fitted.state, &full.frame, full.template.grid());
    let (mx, my) = full.unit.metres_per_unit(a.centre().1);
    // A zero has no sign.
    let shift = (sign * state.shift.0 + 0.0, sign * state.shift.1 + 0.0);
    let centre = (a.centre().0 + shift.0, a.centre().1 + shift.1);
    // Where the surface counts: in the template's own coordinates.
    let place = if sign > 0.0 { a.centre() } else { centre };
    let (u, v) = ((place.0 - frame.x) / frame.half_x, (place.1 - frame.y) / frame.half_y);
    // From (cells, cells, surface about the frame's middle) to (east, north, surface about the centre).
    let parameters = fitted.covariance.nrows();
    let mut jacobian = DMatrix::zeros(parameters, parameters);
    jacobian[(0, 0)] = sign * grid.step_x * mx;
    jacobian[(1, 1)] = sign * grid.step_y * my;
    let surface = &state.surface;
    let mut coefficients = [0.0; MOST_TERMS];
    for to in 0..parameters - SHIFTS {
        for from in 0..parameters - SHIFTS {
            let share = moved_share(to, from, u, v);
            jacobian[(SHIFTS + to, SHIFTS + from)] = -sign * share;
            coefficients[to] += share * surface.coefficients[from];
        }
    }
    let covariance = &jacobian * &fitted.covariance * jacobian.transpose();
    let (half_east, half_north) = (frame.half_x * mx, frame.half_y * my);
    let coefficient = |term: usize| -sign * coefficients[term] + 0.0;
    let error = |term: usize| covariance[(SHIFTS + term, SHIFTS + term)].max(0.0).sqrt();
    let tilt = (surface.degree >= Degree::Linear).then(|| Tilt {
        east: coefficient(1) / half_east,
        north: coefficient(2) / half_north,
        east_se: error(1) / half_east,
        north_se: error(2) / half_north,
    });
    let bend = (surface.degree > Degree::Linear).then(|| Bend {
        degree: surface.degree,
        half_m: (half_east, half_north),
        terms: (Degree::Linear.terms()..surface.degree.terms())
            .map(|term| BendTerm {
                east: TERMS[term].0,
                north: TERMS[term].1,
                metres: coefficient(term),
                se_m: error(term),
            })
            .collect(),
    });
    Alignment {
        shift,
        shift_m: [shift.0 * mx, shift.1 * my, coefficient(0)],
        covariance_m2: Matrix3::from_fn(|i, j| covariance[(i, j)]),
        tilt,
        bend,
        centre,
        nmad_before_m: spreads.0.nmad,
        nmad_after_m: spreads.1.nmad,
        median_before_m: sign * spreads.0.median + 0.0,
        median_after_m: sign * spreads.1.median + 0.0,
        stable_share: fitted.share,
        common_cells: fitted.common,
        iterations: fitted.iterations,
        zeros: if sign > 0.0 { spreads.1.zeros } else { spreads.1.zeros.exchanged() },
    }
}
