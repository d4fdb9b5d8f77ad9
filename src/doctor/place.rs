//! Mistakes that only the image's own georeference shows: a similarity fits a list in any unit, zone or place.

use super::list::{FOOT_M, SURVEY_FOOT_M};
use super::{Diagnosis, Mistake};
use crate::coords::{GeoTransform, MapPoint, PixelPoint};
use crate::georef::crs::{Coordinate, Crs};
use crate::solve::Solution;

/// A georeference without ground control is off by no more than this, metres.
const OWN_ERROR_M: f64 = 100.0;
/// A zone, a unit or an axis puts the image at least this far off.
const FAR_M: f64 = 5000.0;

/// What the image says of itself.
#[derive(Clone, Debug)]
pub struct OwnGeoreference {
    pub geotransform: GeoTransform,
    pub crs: Crs,
    pub image_size_px: (f64, f64),
}

/// `solution` is in metres of `list_crs`. Compares where the list puts the image with where the image says it lies.
pub fn diagnose_place(solution: &Solution, list_crs: &Crs, own: &OwnGeoreference) -> Vec<Diagnosis> {
    let middle = PixelPoint { x: own.image_size_px.0 / 2.0, y: own.image_size_px.1 / 2.0 };
    let listed = solution.similarity.apply(middle);
    let stated = own.geotransform.apply(middle);
    let distance = |crs: &Crs, p: MapPoint| -> Option<f64> {
        let unit_m = crs.metres_per_unit();
        let mut points = [Coordinate { x: p.easting / unit_m, y: p.northing / unit_m, height: None }];
        crs.transform(&mut points, &own.crs, OWN_ERROR_M).ok()?;
        Some((points[0].x - stated.easting).hypot(points[0].y - stated.northing) * own.crs.metres_per_unit())
    };
    if own.crs.is_geographic() {
        return Vec::new();
    }
    let off = distance(list_crs, listed).unwrap_or(f64::INFINITY);
    if off <= OWN_ERROR_M {
        return ground(solution, list_crs, own, stated).into_iter().collect();
    }
    if off < FAR_M {
        return Vec::new();
    }
    let zone = other_zones(list_crs)
        .into_iter()
        .filter_map(|crs| Some((distance(&crs, listed)?, crs)))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(off, _)| *off <= OWN_ERROR_M)
        .map(|(_, crs)| Mistake::WrongZone { listed: list_crs.label(), fits: crs.label() });
    let in_feet = |foot: f64| {
        let p = MapPoint { easting: listed.easting * foot, northing: listed.northing * foot };
        distance(list_crs, p).unwrap_or(f64::INFINITY)
    };
    let feet = || {
        let (international, survey) = (in_feet(FOOT_M), in_feet(SURVEY_FOOT_M));
        (international.min(survey) <= OWN_ERROR_M).then(|| {
            // Seven thousand kilometres of northing tell them apart by 14 m.
            let told = (international - survey).abs() > 3.0 && international.min(survey) < 3.0;
            Mistake::FeetForMetres { survey: told.then_some(survey < international) }
        })
    };
    // Of places all over a zone, few are this close to one.
    let chance = (OWN_ERROR_M / 1e6).powi(2) * 60.0;
    zone.or_else(feet).map(|mistake| Diagnosis::new(mistake, chance.log10())).into_iter().collect()
}

/// The sixty zones that a zone may be mistaken for: those of the same datum and hemisphere.
fn other_zones(crs: &Crs) -> Vec<Crs> {
    // ETRS89, WGS 84 north and south, NAD83: EPSG numbers end in the zone.
    let families = [(25800, 28, 38), (32600, 1, 60), (32700, 1, 60), (26900, 1, 23)];
    let code = crs.epsg().unwrap_or(0);
    let family = families.iter().find(|(base, first, last)| (base + first..=base + last).contains(&code));
    let Some(&(base, first, last)) = family else { return Vec::new() };
    (base + first..=base + last).filter(|c| *c != code).filter_map(|c| Crs::from_epsg(c).ok()).collect()
}

/// Whether the scales differ as ground and grid do. The image's own scale must be of the same CRS.
fn ground(solution: &Solution, list_crs: &Crs, own: &OwnGeoreference, at: MapPoint) -> Option<Diagnosis> {
    if list_crs.label() != own.crs.label() {
        return None;
    }
    let grid = list_crs.point_scale(at.easting, at.northing)?;
    let ratio = solution.scale_m_per_px / (own.geotransform.scale() * own.crs.metres_per_unit());
    let sigma = (solution.covariance[0][0] + solution.covariance[1][1]).sqrt() / solution.scale_m_per_px;
    // Closer to 1 than that the two cannot be told apart.
    if (ratio - 1.0).abs() < 5.0 * sigma || (grid - 1.0).abs() < 6.0 * sigma || sigma == 0.0 {
        return None;
    }
    let fits = |factor: f64| (ratio / factor - 1.0).abs() < 3.0 * sigma;
    if !fits(grid) && !fits(1.0 / grid) {
        return None;
    }
    // A scale that differs for another reason would have to hit within 3σ on either side.
    let chance: f64 = 6.0 * sigma / (grid - 1.0).abs();
    Some(Diagnosis::new(Mistake::GridToGround { factor: ratio }, chance.min(1.0).log10()))
}
