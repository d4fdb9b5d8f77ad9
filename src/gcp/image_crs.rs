//! The CRS of a list that names none, beside an image that has one: the image's, where the points lie on the image.
//!
//! Such a list is never taken as local metres in silence. What is written beside the image would be joined to the
//! image's own CRS, and lie hundreds of kilometres off.

use std::path::Path;

use crate::gcp::options::ImageGeoreference;
use crate::gcp::raw::RawPoint;
use crate::gcp::{degrees, place};
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

/// The CRS of a list that names none: the image's, when most points lie on the image, as they stand or exchanged
/// (which [`place::check`] tells); of an image that does not say where it lies, in the CRS's area of use. `None` beside
/// an image whose own CRS is local: the list is local too.
///
/// # Errors
/// [`Error::Format`] with the remedy when the points lie elsewhere.
pub(super) fn adopt(
    path: &Path,
    points: &[RawPoint],
    image: &ImageGeoreference,
    notes: &mut Vec<String>,
) -> Result<Option<Crs>> {
    let written = Crs::parse(&image.crs_wkt)?;
    // Images do not hold the area of use, which the authority knows.
    let crs = written.epsg().map_or(Ok(written), Crs::from_epsg)?;
    if crs.is_local() {
        return Ok(None);
    }
    let belongs = |at: MapPoint| {
        image.holds(&crs, at).unwrap_or_else(|| {
            let is_local = at.easting.abs().max(at.northing.abs()) * crs.metres_per_unit() < LOCAL_M;
            (crs.is_geographic() || !is_local) && crs.covers(at.easting, at.northing) != Some(false)
        })
    };
    let most =
        |place: &dyn Fn(&RawPoint) -> MapPoint| points.iter().filter(|p| belongs(place(p))).count() * 2 >= points.len();
    let exchanged = |p: &RawPoint| MapPoint { easting: p.gcp.northing, northing: p.gcp.easting };
    if most(&|p| p.gcp.position()) || most(&exchanged) {
        notes.push(format!("{} names no CRS: it was taken to be the image's, {}", path.display(), crs.title()));
        return Ok(Some(crs));
    }
    degrees::refuse_degrees(path, points)?;
    Err(elsewhere(path, points, image, &crs))
}

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
    let hint = place::inside_otherwise(points, crs, Some(image)).map_or(String::new(), |how| format!(" ({how})"));
    Error::format(
        path,
        "the coordinates",
        format!(
            "the list names no CRS, and in the image's, {}, its points lie {whereabouts}{hint}; give the --crs that they \
             are in, or --crs local if they are local metres",
            crs.title()
        ),
    )
}
