//! Heights along a line, over several models.

use std::path::Path;

use crate::couple::TURN_DEGREES;
use crate::crs::Crs;
use crate::error::{Error, Result};
use crate::model::Model;
use crate::resample::{Interpolation, Resampled};
use crate::source::{Heights, Patch};
use crate::turns;

/// A place on the line: metres from its start, map position, and the height in each model.
#[derive(Clone, Debug, PartialEq)]
pub struct Station {
    pub distance_m: f64,
    pub x: f64,
    pub y: f64,
    pub heights_m: Vec<Option<f64>>,
}

/// Most stations of a profile.
const MOST: f64 = 5e6;

/// Heights every `step_m` along `line` (map positions in the models' CRS, longitudes as the first model counts them or
/// by whole turns off), and at its corners and its end, bilinear.
///
/// # Errors
/// When a model cannot be read or has another CRS than the first, or the line has no length.
pub fn along(models: &[impl AsRef<Path>], line: &[(f64, f64)], step_m: Option<f64>) -> Result<Vec<Station>> {
    let models: Vec<Model> = models.iter().map(|path| Model::open(path.as_ref())).collect::<Result<_>>()?;
    crate::couple::check_one_map(&models)?;
    let Some(first) = models.first() else { return Err(Error::usage("no model was named", "name at least one")) };
    let unit = first.ground_unit();
    let grid = first.grid();
    // Longitudes that count from elsewhere, or jump at 180°, come to the model; around the Earth the way is as written.
    let [west, _, east, _] = grid.bounds();
    let small = counts_degrees(first) && east - west < TURN_DEGREES / 2.0;
    let beside = |&(x, y): &(f64, f64)| (if small { turns::nearest(x, grid.centre().0) } else { x }, y);
    let line: Vec<(f64, f64)> = line.iter().map(beside).collect();
    let lengths: Vec<f64> = line
        .windows(2)
        .map(|pair| {
            let (mx, my) = unit.metres_per_unit((pair[0].1 + pair[1].1) / 2.0);
            ((pair[1].0 - pair[0].0) * mx).hypot((pair[1].1 - pair[0].1) * my)
        })
        .collect();
    let total: f64 = lengths.iter().sum();
    let step = step_m.unwrap_or_else(|| grid.step_x.abs() * unit.metres_per_unit(grid.centre().1).0);
    if !(total > 0.0 && step > 0.0 && total.is_finite()) || total / step > MOST {
        return Err(Error::usage(
            format!("a line of {total} m in steps of {step} m"),
            format!("give at least two different positions and a --step that makes {MOST:.0} stations at most"),
        ));
    }
    let mut stations = Vec::new();
    let (mut segment, mut before) = (0, 0.0);
    for distance in distances(&lengths, step) {
        while segment + 1 < lengths.len() && distance > before + lengths[segment] {
            before += lengths[segment];
            segment += 1;
        }
        let share = if lengths[segment] > 0.0 { ((distance - before) / lengths[segment]).min(1.0) } else { 0.0 };
        let (a, b) = (line[segment], line[segment + 1]);
        let (x, y) = (a.0 + share * (b.0 - a.0), a.1 + share * (b.1 - a.1));
        let heights_m = models.iter().map(|model| at(model, x, y)).collect::<Result<_>>()?;
        stations.push(Station { distance_m: distance, x, y, heights_m });
    }
    Ok(stations)
}

/// Multiples of the step, and where segments end; of two that are one up to rounding the multiple.
fn distances(lengths: &[f64], step: f64) -> Vec<f64> {
    let total: f64 = lengths.iter().sum();
    let near = 1e-9 * step.max(total);
    let mut all: Vec<f64> = (0..=(total / step + 1e-9) as u64).map(|number| number as f64 * step).collect();
    let mut end = 0.0;
    for length in lengths {
        end += length;
        // Rounding must not carry a corner over a step.
        if (end - (end / step).round() * step).abs() > near {
            all.push(end);
        }
    }
    all.sort_by(f64::total_cmp);
    all.dedup();
    all
}

fn counts_degrees(model: &Model) -> bool {
    model.crs().is_some_and(Crs::counts_degrees)
}

fn at(model: &Model, x: f64, y: f64) -> Result<Option<f64>> {
    let g = model.grid();
    let x = if counts_degrees(model) { turns::nearest(x, g.centre().0) } else { x };
    let cell = crate::grid::Grid { x0: x - g.step_x / 2.0, y0: y - g.step_y / 2.0, width: 1, height: 1, ..g };
    let mut out = Vec::new();
    Resampled::new(model, cell, (0.0, 0.0), Interpolation::Bilinear)
        .read(Patch { x: 0, y: 0, width: 1, height: 1 }, &mut out)?;
    Ok(Some(out[0]).filter(|z| !z.is_nan()))
}
