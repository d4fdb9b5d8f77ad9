//! What a format cannot hold.

use std::collections::HashSet;
use std::path::Path;

use super::kof::{KOF_NAME, fitting};
use super::{ListFormat, Survey, names};
use crate::gcp::odm::CHECK_PREFIX;
use crate::gcp::packed::Packed;
use crate::gcp::raw::RawPoint;
use crate::gcp::{Gcp, GcpRole, angle, heights, programs, text, titles, units};
use autoref_raster::cells::without_apostrophe;
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

/// Properties of our own output, which are said in other columns or follow from the result.
const OWN: [&str; 9] = ["layer", "crs", "x", "y", "pixels", "image", "pixel_x", "pixel_y", "attribute"];

/// What a format has a place for.
struct Holds {
    height: bool,
    sigma: bool,
    sigma_height: bool,
    role: bool,
    crs: bool,
    /// Places in images for each point: none, one, or any number.
    pixels: usize,
    image_name: bool,
    attributes: bool,
}

fn holds(format: ListFormat) -> Holds {
    use ListFormat::{Csv, GeoJson, Gpx, Kof, MetashapeCsv, MetashapeXml, MicMac, Odm, Pix4d, Qgis};
    let pixels = match format {
        GeoJson | Odm | MetashapeXml => usize::MAX,
        Csv | Qgis => 1,
        _ => 0,
    };
    Holds {
        height: !matches!(format, Qgis | Gpx),
        sigma: !matches!(format, Kof | Odm | Qgis | Gpx),
        sigma_height: !matches!(format, Kof | Odm | Qgis | MetashapeCsv | Gpx),
        role: !matches!(format, Kof | Pix4d | MicMac | Gpx),
        crs: !matches!(format, Kof | Pix4d | MicMac),
        pixels,
        image_name: matches!(format, GeoJson | Odm | Csv | MetashapeXml),
        attributes: matches!(format, GeoJson | Csv),
    }
}

/// What the points have that the format has no place for, in plain words.
pub(super) fn of(survey: &Survey, format: ListFormat) -> Vec<String> {
    let holds = holds(format);
    let mut lost = Vec::new();
    let mut say = |what: &str, has: &dyn Fn(&RawPoint) -> bool| {
        let points = survey.points.iter().filter(|p| has(p)).count();
        if points > 0 {
            lost.push(format!("{what} of {}", counted(points, "point", "points")));
        }
    };
    if !holds.height {
        say("height", &|p| p.gcp.height.is_some());
    }
    if !(holds.sigma && all_or_none(survey, format)) {
        say("sigma_m", &|p| p.gcp.sigma_m.is_some());
    }
    if !(holds.sigma_height && all_or_none(survey, format)) {
        say("sigma_height_m", &|p| p.gcp.sigma_height_m.is_some());
    }
    let large = |sigma: Option<f64>, unit_m: f64| sigma.is_some_and(|s| s >= unit_m);
    if format == ListFormat::MicMac {
        let (unit_m, height_unit_m) = units::accuracy_units(survey.crs.as_ref());
        say(&format!("sigma_m of {unit_m} m or more"), &|p| large(p.gcp.sigma_m, unit_m));
        say(&format!("sigma_height_m of {height_unit_m} m or more"), &|p| large(p.gcp.sigma_height_m, height_unit_m));
    }
    if !holds.role {
        say("role (check point)", &|p| p.gcp.role == GcpRole::Check);
    }
    if holds.pixels == 0 {
        say("pixels", &|p| !p.pixels.is_empty());
    }
    if format == ListFormat::Odm && survey.points.iter().any(|p| !p.pixels.is_empty()) {
        say("the points without pixels:", &|p| p.pixels.is_empty());
    }
    if format == ListFormat::MetashapeXml {
        say("pixels in images without a name", &|p| p.pixels.iter().any(|s| s.image.is_none()));
    }
    if holds.pixels == 1 {
        say("pixels in further images", &|p| p.pixels.len() > 1);
    }
    if !holds.image_name && holds.pixels > 0 {
        say("image name", &|p| p.pixels.iter().any(|s| s.image.is_some()));
    }
    if let Some(crs) = &survey.crs {
        if !holds.crs {
            lost.push(format!("crs {}", crs.title()));
        } else if crs.epsg().is_none() && format == ListFormat::Gml {
            lost.push(format!("crs {}: GML names systems by their EPSG code, and it has none", crs.title()));
        } else if crs.epsg().is_none() && format == ListFormat::Odm {
            lost.push(format!("crs {}: written as a PROJ string, without names and vertical datum", crs.title()));
        }
    }
    for column in columns(survey) {
        if !holds.attributes || has_a_meaning(&column) {
            lost.push(format!("column `{column}`"));
        }
    }
    lost.extend(names::lost(survey, format));
    if format == ListFormat::Kof {
        lost.extend(kof(survey));
    }
    lost
}

/// Whether accuracies can be written where the format asks all points for both.
fn all_or_none(survey: &Survey, format: ListFormat) -> bool {
    format != ListFormat::Pix4d || programs::pix4d_has_accuracies(survey.gcps())
}

/// Titles of what the input says beyond a GCP.
fn columns(survey: &Survey) -> Vec<String> {
    let mut seen = HashSet::new();
    let extras = survey.points.iter().flat_map(extra);
    extras.map(|(title, _)| title).filter(|title| seen.insert(title.as_str())).cloned().collect()
}

/// Takes away what the points hold all that it says: columns that were `read` as parts of them, and one that has the
/// names of all. A value that is a point's name by chance stays.
pub(super) fn drop_said(points: &mut [RawPoint], read: &[String]) {
    let mut others = HashSet::new();
    for RawPoint { gcp, attributes, .. } in points.iter() {
        let is_another = |value: &str| !value.trim().is_empty() && without_apostrophe(value.trim()) != gcp.name;
        others.extend(attributes.iter().filter(|(_, value)| is_another(value)).map(|(title, _)| title.clone()));
    }
    for point in points.iter_mut() {
        point.attributes.retain(|(title, _)| others.contains(title) && !read.contains(title));
        point.attributes = extra(point).cloned().collect();
    }
}

/// What a point says beyond a GCP: neither empty nor one of its own values again.
pub(super) fn extra(point: &RawPoint) -> impl Iterator<Item = &(String, String)> {
    let Gcp { easting, northing, height, sigma_m, sigma_height_m, .. } = &point.gcp;
    let values = [Some(*easting), Some(*northing), *height, *sigma_m, *sigma_height_m];
    point.attributes.iter().filter(move |(title, value)| {
        let value = value.trim();
        // Also with marks between its thousands, or as what stands for no height.
        let is_one_of = |number: Option<f64>| number.is_some() && values.contains(&number);
        let is_value = || {
            is_one_of(angle::angle(value))
                || is_one_of(Packed::of(title).and_then(|packed| packed.angle(value)))
                || is_one_of(text::number(value))
                || is_one_of(text::number(&value.replace(['.', ','], "")))
                || heights::stands_for_none(value)
        };
        let said = !value.is_empty() && is_value() && (has_a_meaning(title) || titles::is_letter(title));
        let tidied = titles::tidy(title);
        let own = OWN.contains(&title.as_str()) || titles::is_role(&tidied);
        !(value.is_empty() || value == "null" || title.trim().is_empty() || said || own)
    })
}

/// Whether a reader would take the title for a part of a GCP.
pub(super) fn has_a_meaning(title: &str) -> bool {
    titles::is_known(title)
}

fn kof(survey: &Survey) -> Vec<String> {
    let mut lost = Vec::new();
    let long = survey.gcps().filter(|g| g.name.chars().count() > KOF_NAME).count();
    if long > 0 {
        lost.push(format!("letters beyond the {KOF_NAME}th of {}", counted(long, "name", "names")));
    }
    let mut worst: f64 = 0.0;
    for gcp in survey.gcps() {
        let fields = [(gcp.northing, 12), (gcp.easting, 11)].into_iter().chain(gcp.height.map(|h| (h, 8)));
        for (value, width) in fields {
            let written = fitting(value, width).and_then(|text| text.trim().parse::<f64>().ok());
            worst = worst.max(written.map_or(0.0, |w| (w - value).abs()));
        }
    }
    if worst > 0.0 {
        lost.push(format!("digits: coordinates were rounded by up to {worst:.1e}"));
    }
    lost
}

/// Refuses what a format demands and the points do not have.
///
/// # Errors
/// [`Error::Usage`] with the point and the remedy.
pub(super) fn refuse(input: &Path, survey: &Survey, format: ListFormat) -> Result<()> {
    let title = format.title();
    if matches!(format, ListFormat::Pix4d | ListFormat::MicMac)
        && let Some(point) = survey.points.iter().find(|p| p.gcp.height.is_none())
    {
        return Err(Error::format(
            input,
            &point.place,
            format!(
                "`{}` has no height, which {title} needs; complete the list or write another format",
                point.gcp.name
            ),
        ));
    }
    if matches!(format, ListFormat::Odm | ListFormat::Kml | ListFormat::Gpx) && survey.crs.is_none() {
        return Err(Error::usage(
            format!("{}: {title} needs a CRS, and the list names none", input.display()),
            "give --crs",
        ));
    }
    let is_taken = |p: &&RawPoint| p.gcp.role == GcpRole::Control && p.gcp.name.starts_with(CHECK_PREFIX);
    if let Some(point) = survey.points.iter().find(is_taken).filter(|_| format == ListFormat::Odm) {
        return Err(Error::format(
            input,
            &point.place,
            format!(
                "`{}` is a control point, and {title} has check points by names with {CHECK_PREFIX}; rename it",
                point.gcp.name
            ),
        ));
    }
    let has_titles = match format {
        ListFormat::Pix4d => false,
        ListFormat::Odm => survey.points.iter().any(|p| !p.pixels.is_empty()),
        _ => true,
    };
    if !has_titles && names::look_like_coordinates(survey) {
        return Err(Error::usage(
            format!("{}: names that are numbers cannot be told from coordinates in {title}", input.display()),
            "put a letter before them, or write another format",
        ));
    }
    refuse_one_name_of_two(input, survey, format)?;
    if format != ListFormat::Kof {
        return Ok(());
    }
    for point in &survey.points {
        let gcp = &point.gcp;
        let fit = [(gcp.northing, 12), (gcp.easting, 11), (gcp.height.unwrap_or(0.0), 8)];
        if let Some((value, width)) = fit.into_iter().find(|(v, w)| fitting(*v, *w).is_none()) {
            return Err(Error::format(
                input,
                &point.place,
                format!("{value} does not fit the {width} columns that KOF has for it; write another format"),
            ));
        }
    }
    Ok(())
}

/// Names that the format cannot tell apart.
fn refuse_one_name_of_two(input: &Path, survey: &Survey, format: ListFormat) -> Result<()> {
    let letters = if format == ListFormat::Kof { KOF_NAME } else { usize::MAX };
    let names = survey.points.iter().map(|point| point.gcp.name.as_str());
    if let Some((place, other, cut)) = names::one_of_two(format, letters, names) {
        let point = &survey.points[place];
        let why = match format {
            ListFormat::Kof => format!("KOF, which has {KOF_NAME} letters for a name"),
            _ => format!("{}, which has no line ends or tabs in names", format.title()),
        };
        let what = format!("`{}` and `{other}` are both `{cut}` in {why}; rename one", point.gcp.name);
        return Err(Error::format(input, &point.place, what));
    }
    Ok(())
}
