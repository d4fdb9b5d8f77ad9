//! The georeference of one raster for another of the same project: the elevation model beside the orthophoto, a version
//! of another resolution.

use std::path::Path;

use crate::georef::beneath;
use crate::georef::sidecar;
use crate::georef::tags;
use crate::result::{ImageInfo, PriorGeoreference, RunResult};
use autoref_raster::bounded;
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// What is known of the outer edges of two rasters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edges {
    /// Nothing.
    Unknown,
    /// They coincide.
    Coincide,
}

/// The result as it would be, had it been solved on `other`: transform, size, and the pixels of the matches.
///
/// Which pixel of `other` is which of the image is known in one of three ways, in this order: both had a georeference
/// of their own in the same system before (photogrammetry in local coordinates or by the drone's GNSS); both have the
/// same number of pixels; or `edges` says that they coincide.
///
/// # Errors
/// [`Error::Usage`] when none of these holds, or when what `other` has may be our own output; [`Error::Gdal`] when it
/// cannot be opened.
pub fn carry(result: &RunResult, other: &Path, edges: Edges) -> Result<RunResult> {
    let same_extent = edges == Edges::Coincide;
    let mut carried = result.clone();
    let solved =
        carried.solved_mut().ok_or_else(|| Error::usage("the result holds no georeference", "it was not solved"))?;
    let transform = solved.geotransform;
    let image = result.image.as_ref().ok_or_else(|| {
        Error::usage("the result tells nothing of its image", "make it with an image, not by `solve`")
    })?;
    let (_, dataset) = autoref_raster::open_dataset(other, 0)?;
    let (width, height) = dataset.raster_size();
    let own = dataset.geo_transform().ok().map(GeoTransform);
    let recorded = result.prior_georeference.as_ref();
    let prior = recorded.filter(|prior| !beneath::repeats(&prior.geotransform, &transform));
    if recorded.is_some() && prior.is_none() && own.is_some() && !same_extent {
        return Err(Error::usage(
            format!("{}: the image had the result's georeference already when the run began", other.display()),
            "rasters made from it as it was lie right; for others run the job on the image as it came, or give \
             --same-extent if their outer edges coincide",
        ));
    }
    let same_size = (width as u64, height as u64) == (image.width, image.height);
    if prior.is_some() && !same_extent && !same_size {
        not_ours(other)?;
    }
    let to_image = match (prior, own) {
        (Some(prior), Some(own))
            if !same_extent && same_system(prior, &dataset.projection()) && not_ours(other).is_ok() =>
        {
            PixelAffine::between(&prior.geotransform, &own).ok_or_else(singular)?
        }
        _ if same_size => PixelAffine::scaled(1.0, 1.0),
        _ if same_extent => {
            let (x, y) = (image.width as f64 / width as f64, image.height as f64 / height as f64);
            if !same_ratio(x, y, width.min(height) as f64) {
                let what =
                    format!("{width} × {height} pixels have not the shape of {} × {}", image.width, image.height);
                let remedy = "its outer edges are not those of the image";
                return Err(Error::usage(format!("{}: {what}", other.display()), remedy));
            }
            PixelAffine::scaled(x, y)
        }
        _ => {
            let sizes =
                format!("its {width} × {height} pixels lie on the {} × {} of the image", image.width, image.height);
            return Err(Error::usage(
                format!("{}: it is not known how {sizes}", other.display()),
                "give --same-extent if their outer edges coincide",
            ));
        }
    };
    let new = to_image.then(&transform);
    solved.geotransform = new;
    solved.solution = None;
    for row in solved.matches.iter_mut().chain(&mut solved.check_points) {
        let place = to_image.invert(PixelPoint { x: row.x, y: row.y }).ok_or_else(singular)?;
        (row.x, row.y) = (place.x, place.y);
        row.residual_px *= transform.scale() / new.scale();
        row.covariance_px2 = None;
    }
    carried.image = Some(ImageInfo {
        path: other.display().to_string(),
        width: width as u64,
        height: height as u64,
        bands: dataset.raster_count(),
        reader: "gdal".into(),
        description: dataset.driver().short_name(),
        from_result: None,
    });
    carried.candidates.clear();
    carried.prior_georeference = None;
    Ok(carried)
}

fn singular() -> Error {
    Error::usage("a georeference that the rasters had before has no inverse", "give --same-extent")
}

/// Pixels of one raster → pixels of another.
struct PixelAffine {
    origin: PixelPoint,
    /// What one pixel to the right, and one down, is in the other raster.
    right: (f64, f64),
    down: (f64, f64),
}

impl PixelAffine {
    fn scaled(x: f64, y: f64) -> Self {
        PixelAffine { origin: PixelPoint { x: 0.0, y: 0.0 }, right: (x, 0.0), down: (0.0, y) }
    }

    /// Through the map: pixels of a raster with the transform `own` → pixels of the one with `image`.
    fn between(image: &GeoTransform, own: &GeoTransform) -> Option<Self> {
        let (g, o) = (image.0, own.0);
        let det = g[1] * g[5] - g[2] * g[4];
        if !det.is_finite() || det == 0.0 {
            return None;
        }
        let back = |e: f64, n: f64| ((g[5] * e - g[2] * n) / det, (g[1] * n - g[4] * e) / det);
        let origin = image.invert(own.apply(PixelPoint { x: 0.0, y: 0.0 }))?;
        Some(PixelAffine { origin, right: back(o[1], o[4]), down: back(o[2], o[5]) })
    }

    fn then(&self, transform: &GeoTransform) -> GeoTransform {
        let g = transform.0;
        let origin = transform.apply(self.origin);
        let east = |(x, y): (f64, f64)| g[1] * x + g[2] * y;
        let north = |(x, y): (f64, f64)| g[4] * x + g[5] * y;
        GeoTransform([
            origin.easting,
            east(self.right),
            east(self.down),
            origin.northing,
            north(self.right),
            north(self.down),
        ])
    }

    fn invert(&self, p: PixelPoint) -> Option<PixelPoint> {
        let det = self.right.0 * self.down.1 - self.down.0 * self.right.1;
        let (x, y) = (p.x - self.origin.x, p.y - self.origin.y);
        (det.is_finite() && det != 0.0).then(|| PixelPoint {
            x: (self.down.1 * x - self.down.0 * y) / det,
            y: (self.right.0 * y - self.right.1 * x) / det,
        })
    }
}

fn same_system(prior: &PriorGeoreference, wkt: &str) -> bool {
    match (&prior.crs, wkt.is_empty()) {
        (None, true) => true,
        (Some(old), false) => match (Crs::parse(old), Crs::parse(wkt)) {
            (Ok(a), Ok(b)) => a.label() == b.label(),
            _ => false,
        },
        _ => false,
    }
}

/// Rounding of the pixel counts explains the difference of two scale factors.
fn same_ratio(x: f64, y: f64, pixels: f64) -> bool {
    (x / y - 1.0).abs() <= 2.0 / pixels.max(1.0)
}

/// What an earlier run has written must not be taken for what the photogrammetry wrote.
fn not_ours(other: &Path) -> Result<()> {
    let aux = sidecar::aux_path(other);
    let text = bounded::read_to_string(&aux, "an .aux.xml", bounded::TEXT_BYTES).unwrap_or_default();
    let found = if sidecar::transform_of_aux(&text).is_some() {
        format!("{} may be of an earlier run; remove it", aux.display())
    } else if tags::is_tagged(other) {
        format!("an earlier run has written tags; take them back: autoref-stream undo {}", other.display())
    } else {
        return Ok(());
    };
    Err(Error::usage(format!("{}: its own georeference is needed, but it is covered up", other.display()), found))
}
