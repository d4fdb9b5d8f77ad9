//! Coordinates and heights brought out of the units that titles name, into metres and the unit of the CRS.

use std::path::Path;

use crate::gcp::raw::RawPoint;
use crate::gcp::units::{TitledUnits, Unit, accuracy_units, tidied};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

impl TitledUnits {
    /// Brings local coordinates, and those of a CRS in metres, into metres, heights into the unit of the CRS, and
    /// accuracies that are in the unit of the coordinates into metres; says so in `notes`.
    ///
    /// # Errors
    /// [`Error::Format`] when the titles say two units, feet of no certain kind, or another unit than a CRS that does
    /// not count in metres.
    pub fn apply(
        &self,
        path: &Path,
        points: &mut [RawPoint],
        crs: Option<&Crs>,
        notes: &mut Vec<String>,
    ) -> Result<()> {
        if let Some(title) = &self.unclear {
            let what =
                format!("`{title}` names two units; write the one that its numbers are in, as in `Elevation (US ft)`");
            return Err(Error::format(path, "the header", what));
        }
        if self.accuracies_as_coordinates {
            accuracies(path, points, crs, notes);
        }
        let plan = self.plan_unit(path)?;
        let height_unit_m = match crs {
            Some(crs) => {
                self.refuse_other(path, crs)?;
                crs.height_metres_per_unit().unwrap_or_else(|| crs.metres_per_unit())
            }
            None => 1.0,
        };
        let mut scale = |factor: f64, of: fn(&mut RawPoint) -> Option<&mut f64>| {
            points.iter_mut().filter_map(of).for_each(|value| *value *= factor);
        };
        if let Some(unit) = plan.filter(|unit| crs.is_none_or(in_metres) && !unit.is(1.0)) {
            scale(unit.metres, |p| Some(&mut p.gcp.easting));
            scale(unit.metres, |p| Some(&mut p.gcp.northing));
            notes.push(format!("{}: its titles say {}: coordinates were brought to metres", path.display(), unit.name));
        }
        // Heights without a unit of their own have that of the coordinates beside them.
        let height = self.height.as_ref().map(|(unit, _)| *unit).or(plan.filter(|_| crs.is_none_or(in_metres)));
        if let Some(unit) = height.filter(|unit| !unit.is(height_unit_m)) {
            scale(unit.metres / height_unit_m, |p| p.gcp.height.as_mut());
            let to = if height_unit_m == 1.0 { "metres" } else { "the unit of its CRS" };
            notes.push(format!("{}: its heights are in {}: they were brought to {to}", path.display(), unit.name));
        }
        Ok(())
    }

    /// Of both coordinates.
    ///
    /// # Errors
    /// [`Error::Format`] when they name two.
    pub(super) fn plan_unit(&self, path: &Path) -> Result<Option<Unit>> {
        let [easting, northing] = &self.plan;
        if let (Some((a, first)), Some((b, second))) = (easting, northing)
            && a != b
        {
            let what = format!("`{first}` and `{second}` name two units; both coordinates need the same one");
            return Err(Error::format(path, "the header", what));
        }
        Ok(easting.as_ref().or(northing.as_ref()).map(|(unit, _)| *unit))
    }

    fn refuse_other(&self, path: &Path, crs: &Crs) -> Result<()> {
        let unit_m = crs.metres_per_unit();
        let other = self.plan.iter().flatten().find(|(unit, _)| !unit.is(unit_m));
        let stays = |unit: &Unit| !(in_metres(crs) && unit.is_certain());
        match other.filter(|(unit, _)| !crs.is_geographic() && stays(unit)) {
            Some((_, title)) if in_metres(crs) => Err(Error::format(
                path,
                "the header",
                format!(
                    "the title `{title}` says feet of no certain kind, but {} counts in metres; write `(US ft)` or \
                     `(ift)` in the titles, or give the --crs that counts in feet",
                    crs.title()
                ),
            )),
            Some((unit, title)) => Err(Error::format(
                path,
                "the header",
                format!(
                    "the title `{title}` says {}, but {} counts in {} of {unit_m} m; give the --crs that counts in \
                     {}, or correct the title",
                    unit.name,
                    crs.title(),
                    crs.unit_name(),
                    unit.name
                ),
            )),
            None => Ok(()),
        }
    }
}

/// Brings accuracies out of the unit of the CRS.
fn accuracies(path: &Path, points: &mut [RawPoint], crs: Option<&Crs>, notes: &mut Vec<String>) {
    let (unit_m, height_unit_m) = accuracy_units(crs);
    let has_any = points.iter().any(|point| point.gcp.sigma_m.is_some() || point.gcp.sigma_height_m.is_some());
    let Some(crs) = crs.filter(|_| has_any && (unit_m, height_unit_m) != (1.0, 1.0)) else { return };
    for RawPoint { gcp, .. } in points.iter_mut() {
        gcp.sigma_m = gcp.sigma_m.map(|sigma| tidied(sigma * unit_m));
        gcp.sigma_height_m = gcp.sigma_height_m.map(|sigma| tidied(sigma * height_unit_m));
    }
    let unit = crs.unit_name();
    notes.push(format!(
        "{}: its accuracies are taken to be in {unit}, as its coordinates are, and were brought to metres",
        path.display()
    ));
}

/// Brings the points of a drawing out of the unit that its head states, where that is certain: by the place, else where
/// no template of a drawing has that unit.
///
/// # Errors
/// [`Error::Format`] for feet of no certain kind under a CRS in metres.
pub(super) fn of_drawing(
    path: &Path,
    points: &mut [RawPoint],
    (crs, unit): (Option<&Crs>, Option<Unit>),
    notes: &mut Vec<String>,
) -> Result<()> {
    let Some(unit) = unit.filter(|unit| !unit.is(1.0) || crs.is_some_and(|crs| crs.metres_per_unit() != 1.0)) else {
        return Ok(());
    };
    let crs = crs.filter(|crs| !crs.is_local());
    let unit_m = crs.map_or(1.0, Crs::metres_per_unit);
    if crs.is_some_and(|crs| crs.is_geographic() || unit.is(unit_m)) {
        return Ok(());
    }
    let by = unit.metres / unit_m;
    let lie = |by: f64| {
        crs.map(|crs| points.iter().all(|p| crs.covers(p.gcp.easting * by, p.gcp.northing * by) == Some(true)))
    };
    let is_of_templates = ["millimetres", "inches"].contains(&unit.name);
    match (lie(1.0), lie(by)) {
        (None, _) if is_of_templates => {
            notes.push(format!(
                "{}: its head says {} ($INSUNITS), as templates leave there: coordinates are taken as metres; where they \
                 are not, scale the drawing by {by}",
                path.display(),
                unit.name
            ));
            return Ok(());
        }
        (None, _) | (Some(false), Some(true)) => {}
        _ => return Ok(()),
    }
    if crs.is_some() && !unit.is_certain() {
        let what = "its head says feet of no certain kind ($INSUNITS 2), but its CRS counts in metres; set the drawing's \
                    unit to US survey feet, scale it to metres, or give the --crs that counts in feet";
        return Err(Error::format(path, "the drawing", what));
    }
    let height_unit_m = crs.map_or(1.0, |crs| crs.height_metres_per_unit().unwrap_or(unit_m));
    for RawPoint { gcp, .. } in points.iter_mut() {
        (gcp.easting, gcp.northing) = (gcp.easting * by, gcp.northing * by);
        gcp.height = gcp.height.map(|height| height * unit.metres / height_unit_m);
    }
    let to = if unit_m == 1.0 { "metres" } else { "the unit of its CRS" };
    notes.push(format!(
        "{}: its head says {} ($INSUNITS): coordinates were brought to {to}",
        path.display(),
        unit.name
    ));
    Ok(())
}

/// Whether it is a map in metres.
fn in_metres(crs: &Crs) -> bool {
    !crs.is_geographic() && crs.metres_per_unit() == 1.0
}
