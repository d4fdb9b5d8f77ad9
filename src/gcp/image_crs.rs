//! The CRS of a list that names none, beside an image that has one: the image's, where the points lie on the image.
//!
//! Such a list is never taken as local metres in silence. What is written beside the image would be joined to the
//! image's own CRS, and lie hundreds of kilometres off.

use std::path::Path;

use crate::gcp::Gcp;
use crate::gcp::degrees;
use crate::gcp::elsewhere::{Elsewhere, Titles, in_brackets};
use crate::gcp::options::ImageGeoreference;
use crate::gcp::raw::RawPoint;
use crate::gcp::units::Unit;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// Points as near as this to the image belong to it.
const NEAR_M: f64 = 1000.0;
/// Length of a degree.
const DEGREE_M: f64 = 111_000.0;
/// Coordinates of a local system begin near its origin, where hardly a survey in a projected one lies.
const LOCAL_M: f64 = 20_000.0;

impl ImageGeoreference {
    /// Whether a place in the image's own CRS lies on the image, give or take the image's size or a kilometre. `None`
    /// when the image does not say where it lies.
    pub(super) fn holds(&self, crs: &Crs, at: MapPoint) -> Option<bool> {
        let transform = self.transform?;
        let (width, height) = (self.size_px.0 as f64, self.size_px.1 as f64);
        let unit_m = if crs.is_geographic() { DEGREE_M } else { crs.metres_per_unit() };
        let reach = NEAR_M / unit_m / transform.scale();
        Some(transform.invert(at).is_some_and(|pixel| {
            (-width - reach..=2.0 * width + reach).contains(&pixel.x)
                && (-height - reach..=2.0 * height + reach).contains(&pixel.y)
        }))
    }

    /// The middle of the image in its own CRS.
    pub(super) fn middle(&self) -> Option<MapPoint> {
        let middle = PixelPoint { x: self.size_px.0 as f64 / 2.0, y: self.size_px.1 as f64 / 2.0 };
        Some(self.transform?.apply(middle))
    }
}

/// The CRS of an image; with the area of use, which images do not hold and the authority knows.
pub(super) fn system_of(image: &ImageGeoreference) -> Result<Crs> {
    let written = Crs::parse(&image.crs_wkt)?;
    written.epsg().map_or(Ok(written), Crs::from_epsg)
}

/// The CRS of a list that names none: the image's, when most points lie on the image, as they stand or exchanged
/// (which `place::check` tells), brought out of the unit that the list names; of an image that does not say where it
/// lies, in the CRS's area of use. `None` beside an image whose own CRS is local: the list is local too.
///
/// # Errors
/// [`Error::Format`] with the remedy when the points lie elsewhere.
pub(super) fn adopt(
    path: &Path,
    points: &[RawPoint],
    unit: Option<Unit>,
    image: &ImageGeoreference,
    notes: &mut Vec<String>,
) -> Result<Option<Crs>> {
    let crs = system_of(image)?;
    if crs.is_local() {
        return Ok(None);
    }
    let belongs = |at: MapPoint| {
        image.holds(&crs, at).unwrap_or_else(|| {
            let is_local = at.easting.abs().max(at.northing.abs()) * crs.metres_per_unit() < LOCAL_M;
            (crs.is_geographic() || !is_local) && crs.covers(at.easting, at.northing) != Some(false)
        })
    };
    let lie_here = |points: &[RawPoint]| {
        let most = |place: &dyn Fn(&RawPoint) -> MapPoint| {
            points.iter().filter(|p| belongs(place(p))).count() * 2 >= points.len()
        };
        let exchanged = |p: &RawPoint| MapPoint { easting: p.gcp.northing, northing: p.gcp.easting };
        most(&|p| p.gcp.position()) || most(&exchanged)
    };
    // The unit in the head of a drawing may be its template's: as they stand is asked first.
    let brought = brought_to(&crs, points, unit);
    if lie_here(points) || brought.as_deref().is_some_and(lie_here) {
        notes.push(format!("{} names no CRS: it was taken to be the image's, {}", path.display(), crs.title()));
        return Ok(Some(crs));
    }
    degrees::refuse_degrees(path, points)?;
    Err(elsewhere(path, brought.as_deref().unwrap_or(points), image, &crs))
}

/// The points in the unit of a CRS, where their list counts in another.
fn brought_to(crs: &Crs, points: &[RawPoint], unit: Option<Unit>) -> Option<Vec<RawPoint>> {
    let unit = unit.filter(|unit| !crs.is_geographic() && !unit.is(crs.metres_per_unit()))?;
    let by = unit.metres / crs.metres_per_unit();
    let brought = |p: &RawPoint| {
        let (easting, northing) = (p.gcp.easting * by, p.gcp.northing * by);
        RawPoint::bare(Gcp { easting, northing, ..p.gcp.clone() }, p.place.clone())
    };
    Some(points.iter().map(brought).collect())
}

const LOCAL: &str = "or --crs local if they are local metres";

fn elsewhere(path: &Path, points: &[RawPoint], image: &ImageGeoreference, crs: &Crs) -> Error {
    let count = points.len() as f64;
    let mean = |of: &dyn Fn(&RawPoint) -> f64| points.iter().map(of).sum::<f64>() / count;
    let centre = image.middle().filter(|_| !crs.is_geographic());
    let whereabouts = match centre {
        Some(centre) => {
            let (e, n) = (mean(&|p| p.gcp.easting), mean(&|p| p.gcp.northing));
            let away_m = (e - centre.easting).hypot(n - centre.northing) * crs.metres_per_unit();
            format!("{:.0} km from where the image says it is", away_m / 1000.0)
        }
        None if image.transform.is_some() => "elsewhere than the image says it is".to_string(),
        None => "outside its area of use, or near its origin".to_string(),
    };
    let how = Elsewhere::of(points, crs, Some(image));
    let remedy = match &how {
        Some(how @ Elsewhere::Digits(_)) => format!("{}, {LOCAL}", how.remedy(path, Titles::MayNameUnits)),
        Some(how) => how.remedy(path, Titles::MayNameUnits),
        None => format!("give the --crs that they are in, {LOCAL}"),
    };
    Error::format(
        path,
        "the coordinates",
        format!(
            "the list names no CRS, and in the image's, {}, its points lie {whereabouts}{}; {remedy}",
            crs.title(),
            in_brackets(&how)
        ),
    )
}
