//! The georeference beside the image: world file, `.aux.xml`, and a VRT that refers to it.
//!
//! A world file speaks of pixel centres and knows no CRS; GDAL ignores it beside a GeoTIFF that has a georeference. The
//! `.aux.xml` (GDAL's persistent auxiliary metadata) has transform and CRS, and comes before what is in the file.

use std::path::{Path, PathBuf};

use quick_xml::events::{BytesText, Event};
use quick_xml::{Reader, Writer};

use autoref_raster::bounded;
use autoref_raster::coords::GeoTransform;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// `e6.tif` → `e6.tfw`: first and last letter of the extension and a w, as GDAL and ArcGIS look for it.
pub fn world_file_path(image: &Path) -> PathBuf {
    let extension = image.extension().map(|e| e.to_string_lossy().into_owned()).unwrap_or_default();
    let mut letters = extension.chars();
    match (letters.next(), letters.next_back()) {
        (Some(first), Some(last)) => image.with_extension(format!("{first}{last}w")),
        (Some(first), None) => image.with_extension(format!("{first}w")),
        _ => image.with_extension("wld"),
    }
}

/// `e6.tif` → `e6.tif.aux.xml`.
pub fn aux_path(image: &Path) -> PathBuf {
    let mut name = image.as_os_str().to_owned();
    name.push(".aux.xml");
    PathBuf::from(name)
}

/// Six lines: the four rates, then the map position of the **centre** of the first pixel.
pub fn world_file(transform: &GeoTransform) -> String {
    let g = transform.0;
    let centre = (g[0] + (g[1] + g[2]) / 2.0, g[3] + (g[4] + g[5]) / 2.0);
    // The shortest decimal that reads back to the same number.
    format!("{}\n{}\n{}\n{}\n{}\n{}\n", g[1], g[4], g[2], g[5], centre.0, centre.1)
}

/// What an `.aux.xml` says of coordinates that are local metres. Without it GDAL joins the transform to the CRS that
/// the image has.
pub const LOCAL_METRES: &str =
    "LOCAL_CS[\"local metres\",UNIT[\"metre\",1],AXIS[\"Easting\",EAST],AXIS[\"Northing\",NORTH]]";

/// The CRS that an `.aux.xml` beside `image` needs: that of the transform; else, where the image has one itself, the
/// local one.
///
/// # Errors
/// When GDAL cannot open the image.
pub(super) fn crs_beside(image: &Path, page: usize, crs: Option<&Crs>) -> Result<Option<Crs>> {
    match crs {
        Some(crs) => Ok(Some(crs.clone())),
        None if has_crs(image, page)? => Crs::parse(LOCAL_METRES).map(Some),
        None => Ok(None),
    }
}

/// Whether GDAL finds a CRS in the image or beside it.
///
/// # Errors
/// When GDAL cannot open the image.
pub(super) fn has_crs(image: &Path, page: usize) -> Result<bool> {
    let (_, dataset) = autoref_raster::open_dataset(image, page)?;
    Ok(!dataset.projection().is_empty())
}

/// The `.aux.xml`. What an existing one holds besides CRS, transform and GCPs (statistics, histograms) is kept.
///
/// # Errors
/// When `existing` is no XML.
pub fn aux_xml(transform: &GeoTransform, crs: Option<&Crs>, existing: Option<(&Path, &str)>) -> Result<String> {
    let mut kept = String::new();
    if let Some((path, text)) = existing {
        kept = other_elements(text).map_err(|e| Error::format(path, "the XML", e))?;
    }
    let mut out = String::from("<PAMDataset>\n");
    if let Some(crs) = crs {
        let wkt = quick_xml::escape::escape(crs.wkt());
        out.push_str(&format!(
            "  <SRS dataAxisToSRSAxisMapping=\"{}\">{wkt}</SRS>\n",
            autoref_raster::crs::axis_mapping(crs)
        ));
    }
    out.push_str(&format!("  <GeoTransform>{}</GeoTransform>\n", numbers(transform)));
    out.push_str(&kept);
    out.push_str("</PAMDataset>\n");
    Ok(out)
}

/// The six numbers as we write them: GDAL writes exponents with a sign and two digits.
fn numbers(transform: &GeoTransform) -> String {
    transform.0.map(|v| format!("{v:.17e}")).join(", ")
}

/// The six numbers of an `.aux.xml` that this program wrote, and no other since.
pub(super) fn transform_of_own_aux(text: &str) -> Option<GeoTransform> {
    transform_of_aux(text).filter(|read| text.contains(&format!("<GeoTransform>{}</GeoTransform>", numbers(read))))
}

/// The six numbers of a world file, from pixel corners.
pub(super) fn transform_of_world(text: &str) -> Option<GeoTransform> {
    let numbers: Vec<f64> = text.split_whitespace().map(|word| word.parse().ok()).collect::<Option<_>>()?;
    let [a, d, b, e, x, y] = numbers.try_into().ok()?;
    Some(GeoTransform([x - (a + b) / 2.0, a, b, y - (d + e) / 2.0, d, e]))
}

/// The six numbers that an `.aux.xml` holds.
pub(super) fn transform_of_aux(text: &str) -> Option<GeoTransform> {
    let inner = text.split_once("<GeoTransform>")?.1.split_once("</GeoTransform>")?.0;
    let numbers: Vec<f64> = inner.split(',').map(|number| number.trim().parse().ok()).collect::<Option<_>>()?;
    Some(GeoTransform(numbers.try_into().ok()?))
}

/// The children of the root but those that we write, as text.
fn other_elements(text: &str) -> std::result::Result<String, String> {
    let mut reader = Reader::from_str(text);
    let mut writer = Writer::new(Vec::new());
    let mut depth = 0;
    let mut dropping = false;
    loop {
        let event = reader.read_event().map_err(|e| e.to_string())?;
        match &event {
            Event::Start(start) => {
                depth += 1;
                dropping |= depth == 2 && ours(start.name().as_ref());
            }
            Event::Empty(start) if depth == 1 && ours(start.name().as_ref()) => continue,
            Event::Eof if depth == 0 => break,
            Event::Eof => return Err("it ends in the middle".into()),
            _ => {}
        }
        let inside = depth >= 2 || (depth == 1 && matches!(event, Event::Empty(_)));
        let end = matches!(event, Event::End(_));
        if inside && !dropping {
            writer.write_event(event).map_err(|e| e.to_string())?;
        }
        if end {
            if depth == 2 && !dropping {
                writer.write_event(Event::Text(BytesText::new("\n"))).map_err(|e| e.to_string())?;
            }
            dropping &= depth != 2;
            depth -= 1;
        }
    }
    String::from_utf8(writer.into_inner()).map_err(|e| e.to_string())
}

fn ours(name: &str) -> bool {
    matches!(name, "SRS" | "GeoTransform" | "GCPList")
}

/// Writes a VRT that refers to the image and has the transform and CRS.
///
/// # Errors
/// When GDAL cannot open the image or write the VRT.
pub fn write_vrt(image: &Path, page: usize, vrt: &Path, transform: &GeoTransform, crs: Option<&Crs>) -> Result<()> {
    vrt_of(image, page, vrt, |copy| {
        copy.set_geo_transform(&transform.0)?;
        copy.set_projection(crs.map_or("", Crs::wkt))
    })
}

/// Writes a VRT that refers to the image and has neither transform, CRS nor GCPs.
///
/// # Errors
/// When GDAL cannot open the image or write the VRT.
pub(super) fn write_plain_vrt(image: &Path, page: usize, vrt: &Path) -> Result<()> {
    vrt_of(image, page, vrt, |_| Ok(()))?;
    let text = bounded::read_to_string(vrt, "a VRT", bounded::TEXT_BYTES)?;
    let (Some(start), Some(end)) = (text.find("<VRTDataset"), text.rfind("</VRTDataset>")) else {
        return Err(Error::gdal(vrt, "its VRT has no root element"));
    };
    let open = text[start..].find('>').map_or(start, |at| start + at + 1);
    let kept = other_elements(&text[start..]).map_err(|e| Error::gdal(vrt, e))?;
    std::fs::write(vrt, format!("{}\n{kept}{}", &text[start..open], &text[end..]))
        .map_err(|e| Error::io(vrt, "write", e))
}

/// Lets GDAL make a VRT of the image and `change` it.
fn vrt_of(
    image: &Path,
    page: usize,
    vrt: &Path,
    change: impl FnOnce(&mut gdal::Dataset) -> gdal::errors::Result<()>,
) -> Result<()> {
    let error = |e| Error::gdal(vrt, e);
    // It must outlive the copy, which refers to it.
    let (_, source) = autoref_raster::open_dataset(image, page)?;
    let driver = gdal::DriverManager::get_driver_by_name("VRT").map_err(error)?;
    let mut copy = source.create_copy(&driver, vrt, &Default::default()).map_err(error)?;
    change(&mut copy).and_then(|()| copy.close()).map_err(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_follow_the_extension() {
        let world = |name: &str| world_file_path(Path::new(name)).display().to_string();
        assert_eq!(world("a/e6.tif"), "a/e6.tfw");
        assert_eq!(world("e6.jpeg"), "e6.jgw");
        assert_eq!(world("e6.TIF"), "e6.TFw");
        assert_eq!(world("e6"), "e6.wld");
        assert_eq!(aux_path(Path::new("e6.tif")), Path::new("e6.tif.aux.xml"));
    }

    #[test]
    fn a_world_file_counts_from_the_middle_of_the_first_pixel() {
        let turned = GeoTransform([500_000.0, 0.5, 0.25, 7_000_000.0, -0.125, -0.75]);
        let text = "0.5\n-0.125\n0.25\n-0.75\n500000.375\n6999999.5625\n";
        assert_eq!(world_file(&turned), text);
        assert_eq!(transform_of_world(text), Some(turned));
        assert_eq!(transform_of_world("0.5\n-0.125\n"), None);
    }

    #[test]
    fn what_is_not_ours_stays_in_the_aux_file() {
        let old = "<PAMDataset>\n  <SRS>old</SRS>\n  <PAMRasterBand band=\"1\">\n    <Metadata><MDI key=\"STATISTICS_MEAN\">7</MDI></Metadata>\n  </PAMRasterBand>\n</PAMDataset>";
        let new = aux_xml(&GeoTransform([1.0, 2.0, 0.0, 3.0, 0.0, -2.0]), None, Some((Path::new("a"), old)))
            .expect("well-formed");
        assert!(new.contains("STATISTICS_MEAN") && !new.contains("old"), "{new}");
        assert!(aux_xml(&GeoTransform([0.0; 6]), None, Some((Path::new("a"), "<PAM"))).is_err());
    }
}
