//! The CRS in which a fit is made, in metres, and the way from there to the CRS of the outputs.

use std::path::Path;

use crate::gcp::Gcp;
use crate::gcp::units::tidied;
use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use autoref_raster::crs::{Accuracy, Coordinate, Crs};
use autoref_raster::error::{Error, Result};
use autoref_solve::Pair;
use autoref_solve::similarity::fit_equal_weights;

/// When `--to-crs` is applied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reproject {
    /// To the surveyed points, before anything is fitted.
    #[default]
    Before,
    /// To the fitted transform, which stays in the CRS of the points until then.
    After,
}

/// How coordinates of the fit become those of the outputs. Everything between reading and writing is in metres: points
/// in feet are scaled before the fit, and the transform is scaled back after it, exactly.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkingCrs {
    /// System of the points, in its own units; `None` for local coordinates.
    crs: Option<Crs>,
    metres_per_unit: f64,
    height_metres_per_unit: f64,
    /// System of the outputs, when it is another.
    to: Option<Crs>,
    worst_accuracy_m: f64,
    bend: Option<Bend>,
}

/// How far the CRS of the fit departs from that of the points as a map of the same ground, when it is another.
#[derive(Clone, Debug, PartialEq)]
pub struct Bend {
    /// What the best similarity between the two leaves at the points, root mean square.
    pub rms_m: f64,
    points: String,
    fit: String,
}

impl Bend {
    /// In metres, from the points in both systems.
    fn between(points: &[Gcp], (from, to): (&Crs, &Crs), reached: &[Gcp]) -> Option<Bend> {
        let pair = |(a, b): (&Gcp, &Gcp)| Pair {
            // Pixels count downwards.
            pixel: PixelPoint { x: a.easting * from.metres_per_unit(), y: -a.northing * from.metres_per_unit() },
            covariance_px2: None,
            map: MapPoint { easting: b.easting * to.metres_per_unit(), northing: b.northing * to.metres_per_unit() },
            survey_sigma_m: None,
        };
        let pairs: Vec<Pair> = points.iter().zip(reached).map(pair).collect();
        let similarity = fit_equal_weights(&pairs)?;
        let left = |pair: &Pair| {
            let map = similarity.apply(pair.pixel);
            (map.easting - pair.map.easting).powi(2) + (map.northing - pair.map.northing).powi(2)
        };
        let rms_m = (pairs.iter().map(left).sum::<f64>() / pairs.len() as f64).sqrt();
        Some(Bend { rms_m, points: from.title(), fit: to.title() })
    }

    /// Whether residuals of this size come of it.
    pub fn explains(&self, rmse_m: f64) -> bool {
        const LEAST_M: f64 = 0.003;
        const LEAST_SHARE: f64 = 0.5;
        // A bend that the image itself has leaves no residuals.
        const MOST_SHARE: f64 = 2.0;
        self.rms_m > LEAST_M && self.rms_m > LEAST_SHARE * rmse_m && self.rms_m < MOST_SHARE * rmse_m
    }

    /// The cause in a line, and the remedy.
    pub fn note(&self) -> String {
        format!(
            "the image does not lie in {} without being stretched: over these points that departs from {} by {:.3} m \
             (RMS); give --reproject after, which fits in {} and then brings the transform over",
            self.fit, self.points, self.rms_m, self.points
        )
    }
}

/// Axes that count south and west make every list the mirror image of its marks, in either order of the columns.
///
/// # Errors
/// [`Error::Usage`] with the system that counts east and north.
pub(super) fn refuse_mirror_image(crs: &Crs, option: &str) -> Result<()> {
    if !crs.is_mirror_image() {
        return Ok(());
    }
    let upright = if crs.epsg() == Some(8352) { "EPSG:8353" } else { "EPSG:5514" };
    let remedy = if crs.name().contains("Krovak") {
        format!(
            "give {option} {upright}, which counts east and north: easting = −Y (westing), northing = −X (southing)"
        )
    } else {
        format!("give a {option} that counts east and north")
    };
    Err(Error::usage(format!("{} counts south, then west, which is the mirror image of a map", crs.title()), remedy))
}

/// A transform as the outputs have it.
#[derive(Clone, Debug, PartialEq)]
pub struct Delivered {
    pub transform: GeoTransform,
    /// Largest distance between this transform and the exact one in the image, pixels; 0 when only units were changed.
    pub departure_px: f64,
    pub notes: Vec<String>,
}

impl WorkingCrs {
    /// Local coordinates in metres.
    pub fn local() -> Self {
        WorkingCrs {
            crs: None,
            metres_per_unit: 1.0,
            height_metres_per_unit: 1.0,
            to: None,
            worst_accuracy_m: 0.0,
            bend: None,
        }
    }

    /// Brings surveyed points into metres, in place; says what was done in `notes`.
    pub(super) fn enter(
        path: &Path,
        gcps: &mut [Gcp],
        source: Crs,
        target: Option<Crs>,
        reproject: Reproject,
        worst_accuracy_m: f64,
        notes: &mut Vec<String>,
    ) -> Result<(WorkingCrs, Crs)> {
        let before = |wanted: &Option<Crs>| match reproject {
            Reproject::Before => wanted.clone(),
            Reproject::After => None,
        };
        let fit_crs = match before(&target) {
            Some(crs) if crs.is_geographic() => {
                return Err(Error::usage(
                    format!("{} counts in {}s, in which nothing can be fitted", crs.title(), crs.unit_name()),
                    "give a projected --to-crs, or --reproject after",
                ));
            }
            Some(crs) => crs,
            None if source.is_geographic() => utm_of_mean(path, gcps, &source, notes)?,
            None => source.clone(),
        };
        for crs in [Some(&fit_crs), target.as_ref()].into_iter().flatten() {
            refuse_mirror_image(crs, "--to-crs")?;
        }
        let plane = plane_of(path, gcps, &source).filter(|_| fit_crs != source && before(&target).is_some());
        change(path, gcps, &source, &fit_crs, worst_accuracy_m, notes)?;
        let bend = plane.and_then(|(crs, points)| Bend::between(&points, (&crs, &fit_crs), gcps));
        let unit = fit_crs.metres_per_unit();
        let height_unit = fit_crs.height_metres_per_unit().unwrap_or(unit);
        if (unit - 1.0).abs() > 1e-12 {
            notes.push(format!(
                "{} counts in {} of {unit:.9} m: the fit is made in metres and written in {}; residuals are in metres{}",
                fit_crs.title(),
                fit_crs.unit_name(),
                fit_crs.unit_name(),
                match fit_crs.height_metres_per_unit() {
                    None if of_heights(&source, &fit_crs) == 1.0 => "; heights are taken to be in the same unit",
                    _ => "",
                }
            ));
        }
        for gcp in gcps.iter_mut() {
            gcp.easting *= unit;
            gcp.northing *= unit;
            gcp.height = gcp.height.map(|h| h * height_unit);
        }
        let to = target.filter(|to| *to != fit_crs);
        let output = to.clone().unwrap_or_else(|| fit_crs.clone());
        let working = WorkingCrs {
            crs: Some(fit_crs),
            metres_per_unit: unit,
            height_metres_per_unit: height_unit,
            to,
            worst_accuracy_m,
            bend,
        };
        Ok((working, output))
    }

    /// How far the fit's CRS bends what is straight in that of the points.
    pub fn bend(&self) -> Option<&Bend> {
        self.bend.as_ref()
    }

    /// Whether outputs differ from the fit.
    pub fn is_plain(&self) -> bool {
        self.metres_per_unit == 1.0 && self.height_metres_per_unit == 1.0 && self.to.is_none()
    }

    /// Points of the fit as the outputs have them.
    ///
    /// # Errors
    /// Those of [`Crs::transform`].
    pub fn leave(&self, points: &mut [Coordinate]) -> Result<()> {
        for point in points.iter_mut() {
            let by = |value: f64, unit: f64| if unit == 1.0 { value } else { tidied(value / unit) };
            point.x = by(point.x, self.metres_per_unit);
            point.y = by(point.y, self.metres_per_unit);
            point.height = point.height.map(|h| by(h, self.height_metres_per_unit));
        }
        if let (Some(from), Some(to)) = (&self.crs, &self.to) {
            transform(from, points, to, self.worst_accuracy_m)?;
            let factor = of_heights(from, to);
            points.iter_mut().for_each(|point| point.height = point.height.map(|h| h * factor));
        }
        Ok(())
    }

    /// The fitted transform as the outputs have it: scaled exactly when only units differ; else the affine transform
    /// that comes nearest to the exact one on a grid over the image, with what that leaves out.
    ///
    /// # Errors
    /// Those of [`Crs::transform`]; when the image is empty.
    pub fn deliver(&self, fitted: &GeoTransform, size_px: (f64, f64)) -> Result<Delivered> {
        if self.to.is_none() {
            let transform = GeoTransform(fitted.0.map(|value| value / self.metres_per_unit));
            return Ok(Delivered { transform, departure_px: 0.0, notes: Vec::new() });
        }
        const STEPS: usize = 16;
        let (width, height) = (size_px.0.max(1.0), size_px.1.max(1.0));
        let mut pixels = Vec::with_capacity((STEPS + 1) * (STEPS + 1));
        for row in 0..=STEPS {
            for column in 0..=STEPS {
                let share = |i: usize| i as f64 / STEPS as f64;
                pixels.push(PixelPoint { x: width * share(column), y: height * share(row) });
            }
        }
        let mut points: Vec<Coordinate> = pixels
            .iter()
            .map(|p| fitted.apply(*p))
            .map(|m| Coordinate { x: m.easting, y: m.northing, height: None })
            .collect();
        self.leave(&mut points)?;
        let transform = nearest_affine(&pixels, &points, (width, height))
            .ok_or_else(|| Error::usage("the image has no area to reproject", "give --reproject before"))?;
        let departure_px = pixels
            .iter()
            .zip(&points)
            .filter_map(|(pixel, point)| {
                let back = transform.invert(MapPoint { easting: point.x, northing: point.y })?;
                Some((back.x - pixel.x).hypot(back.y - pixel.y))
            })
            .fold(0.0, f64::max);
        let to = self.to.as_ref().map(Crs::title).unwrap_or_default();
        let notes = vec![format!(
            "the fitted transform was brought into {to} after the fit; as an affine transform it departs from the exact \
             one by up to {departure_px:.3} px"
        )];
        Ok(Delivered { transform, departure_px, notes })
    }
}

/// The points as they would be fitted without another CRS, and the CRS of that.
fn plane_of(path: &Path, gcps: &[Gcp], source: &Crs) -> Option<(Crs, Vec<Gcp>)> {
    let mut points = gcps.to_vec();
    if !source.is_geographic() {
        return Some((source.clone(), points));
    }
    let utm = utm_of_mean(path, gcps, source, &mut Vec::new()).ok()?;
    change(path, &mut points, source, &utm, f64::INFINITY, &mut Vec::new()).ok()?;
    Some((utm, points))
}

/// Longitude and latitude are never fitted.
fn utm_of_mean(path: &Path, gcps: &[Gcp], source: &Crs, notes: &mut Vec<String>) -> Result<Crs> {
    let n = gcps.len() as f64;
    // Longitudes across the antimeridian: taken next to the first one.
    let first = gcps.first().map_or(0.0, |g| g.easting);
    let longitude = gcps.iter().map(|g| first + (g.easting - first + 180.0).rem_euclid(360.0) - 180.0).sum::<f64>() / n;
    let latitude = gcps.iter().map(|g| g.northing).sum::<f64>() / n;
    // Grads and other meridians than Greenwich become degrees from Greenwich; the datum does not matter for a zone.
    let (longitude, latitude) = source.longitude_latitude(longitude, latitude).unwrap_or((longitude, latitude));
    let utm = source.utm_zone(longitude, latitude)?;
    notes.push(format!(
        "{}: longitude and latitude were projected to {}, the UTM zone of their mean; --to-crs chooses another",
        path.display(),
        utm.title()
    ));
    Ok(utm)
}

/// [`Crs::transform`] for the commands that read lists of points: what is too coarse for the demand can be accepted by
/// an option.
pub(super) fn transform(from: &Crs, points: &mut [Coordinate], to: &Crs, worst_accuracy_m: f64) -> Result<Accuracy> {
    from.transform(points, to, worst_accuracy_m).map_err(|error| {
        match (error, from.transform(&mut points.to_vec(), to, f64::INFINITY)) {
            (Error::CoarseDatum { what, install, otherwise }, Ok(Accuracy::Metres(metres))) => {
                let otherwise = format!("{otherwise}, or accept it with --datum-accuracy {metres}");
                Error::CoarseDatum { what, install, otherwise }
            }
            (error, _) => error,
        }
    })
}

/// What heights are multiplied by from one system to another where PROJ leaves them as they are, since not both have a
/// vertical axis: heights without one count in the unit of the map, those beside degrees in metres.
fn of_heights(from: &Crs, to: &Crs) -> f64 {
    let unit_m = |crs: &Crs| crs.height_metres_per_unit().unwrap_or_else(|| crs.metres_per_unit());
    let are_changed = from.height_metres_per_unit().is_some() && to.height_metres_per_unit().is_some();
    let factor = unit_m(from) / unit_m(to);
    if are_changed || from.is_local() || to.is_local() || (factor - 1.0).abs() < 1e-12 { 1.0 } else { factor }
}

/// Brings points from one CRS into another, in place; says in `notes` what a change of datum costs.
///
/// # Errors
/// Those of [`Crs::transform`], and when heights cannot be brought along.
pub(super) fn change(
    path: &Path,
    gcps: &mut [Gcp],
    source: &Crs,
    target: &Crs,
    worst_accuracy_m: f64,
    notes: &mut Vec<String>,
) -> Result<()> {
    let heights = gcps.iter().any(|g| g.height.is_some());
    match (source.height_metres_per_unit(), target.height_metres_per_unit()) {
        (None, Some(_)) if heights => {
            return Err(Error::usage(
                format!(
                    "{}: the heights cannot be brought into {}: {} does not say what they count from",
                    path.display(),
                    target.title(),
                    source.title()
                ),
                "give --crs with a vertical part (EPSG:25832+5941 for NN2000), or a --to-crs without one",
            ));
        }
        (Some(_), None) if heights => notes.push(format!(
            "heights stay {}in the vertical system of {}: {} has none",
            if of_heights(source, target) == 1.0 { "as they are, " } else { "" },
            source.title(),
            target.title()
        )),
        _ => {}
    }
    let height_factor = of_heights(source, target);
    if heights && height_factor != 1.0 {
        notes.push(format!(
            "heights were brought from the unit of {} into that of {}: multiplied by {height_factor:.9}",
            source.title(),
            target.title()
        ));
    }
    let mut points: Vec<Coordinate> =
        gcps.iter().map(|g| Coordinate { x: g.easting, y: g.northing, height: g.height }).collect();
    match transform(source, &mut points, target, worst_accuracy_m)? {
        Accuracy::Exact => {}
        Accuracy::Metres(metres) => notes.push(format!(
            "from {} to {} the datum changes, which the authority states as good to {metres} m; within one datum nothing \
             is lost",
            source.title(),
            target.title()
        )),
        Accuracy::Unstated => notes.push(format!(
            "from {} to {} the datum changes by the definition's own parameters; how good they are is not stated",
            source.title(),
            target.title()
        )),
    }
    for (gcp, point) in gcps.iter_mut().zip(points) {
        (gcp.easting, gcp.northing, gcp.height) = (point.x, point.y, point.height.map(|h| h * height_factor));
    }
    Ok(())
}

/// Least squares over the grid, in centred coordinates so that seven-digit northings lose nothing.
fn nearest_affine(pixels: &[PixelPoint], points: &[Coordinate], size_px: (f64, f64)) -> Option<GeoTransform> {
    let n = pixels.len() as f64;
    let (cx, cy) = (size_px.0 / 2.0, size_px.1 / 2.0);
    let (mx, my) = (points.iter().map(|p| p.x).sum::<f64>() / n, points.iter().map(|p| p.y).sum::<f64>() / n);
    let (mut xx, mut yy) = (0.0, 0.0);
    let mut sums = [0.0; 4];
    for (pixel, point) in pixels.iter().zip(points) {
        let (u, v) = (pixel.x - cx, pixel.y - cy);
        xx += u * u;
        yy += v * v;
        sums[0] += u * (point.x - mx);
        sums[1] += v * (point.x - mx);
        sums[2] += u * (point.y - my);
        sums[3] += v * (point.y - my);
    }
    // The grid is symmetric about its centre: the cross products vanish.
    if xx <= 0.0 || yy <= 0.0 {
        return None;
    }
    let [g1, g2, g4, g5] = [sums[0] / xx, sums[1] / yy, sums[2] / xx, sums[3] / yy];
    Some(GeoTransform([mx - g1 * cx - g2 * cy, g1, g2, my - g4 * cx - g5 * cy, g4, g5]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bend_explains_residuals_of_its_size_only() {
        let bend = Bend { rms_m: 0.2, points: "EPSG:3857".into(), fit: "EPSG:25832".into() };
        for (rmse_m, explains) in [(0.002, false), (0.09, false), (0.15, true), (0.35, true), (1.0, false)] {
            assert_eq!(bend.explains(rmse_m), explains, "{rmse_m}");
        }
    }

    #[test]
    fn heights_count_in_metres_beside_degrees() {
        let crs = |text: &str| Crs::parse(text).expect(text);
        let us_foot = 1200.0 / 3937.0;
        for (from, to, factor) in [
            ("EPSG:2278", "EPSG:26914", us_foot),
            ("EPSG:26914", "EPSG:2278", 1.0 / us_foot),
            ("EPSG:4269", "EPSG:2278", 1.0 / us_foot),
            ("EPSG:4979", "EPSG:2278", 1.0 / us_foot),
            ("EPSG:2278", "EPSG:4326", us_foot),
            ("EPSG:25832", "EPSG:25833", 1.0),
            ("EPSG:4269+5703", "EPSG:2278+6360", 1.0),
        ] {
            assert!((of_heights(&crs(from), &crs(to)) - factor).abs() < 1e-9, "{from} to {to}");
        }
    }
}
