//! MicMac's interior orientation: what `mm3d ReSampFid` reads (`cAppliOneReechMarqFid` and `PackFromCplAPF` in MicMac's
//! sources: both files are a `MesureAppuiFlottant1Im`, points are paired by name, image = affine(camera) by least
//! squares). The camera's file is in millimetres, a frame's is in pixels inside a `SetOfMesureAppuisFlottants`, as
//! MicMac's own `SaisieAppuisInit` writes it.

use quick_xml::escape::escape;

use super::tables::{PixelOrigin, used_marks};
use super::types::{Camera, FrameResult};

fn measures(image: &str, points: &[(String, [f64; 2])], indent: &str) -> String {
    let mut text = format!("{indent}<MesureAppuiFlottant1Im>\n{indent}    <NameIm>{}</NameIm>\n", escape(image));
    for (name, [x, y]) in points {
        text += &format!(
            "{indent}    <OneMesureAF1I>\n{indent}        <NamePt>{}</NamePt>\n{indent}        <PtIm>{x} {y}</PtIm>\n{indent}    </OneMesureAF1I>\n",
            escape(name.as_str())
        );
    }
    text + indent + "</MesureAppuiFlottant1Im>\n"
}

/// Positions of the marks as MicMac and spymicmac want them: millimetres, x right, y **down**, from the upper left
/// corner of the marks' bounding box.
///
/// ReSampFid takes them for the axes of the picture that it writes, and would mirror a film whose y runs up; Apero
/// notes trouble with origins far from the corner; spymicmac's own resampling needs the corner at zero.
pub fn camera_points(camera: &Camera) -> Vec<[f64; 2]> {
    let (points, (low, _)) = (camera.film_points(), camera.film_box());
    // Certificates state micrometres; the subtraction must not show more.
    let tidy = |v: f64| (v * 1e9).round() / 1e9;
    points.iter().map(|p| [tidy(p[0] - low[0]), tidy(p[1] - low[1])]).collect()
}

/// `MeasuresCamera.xml`: [`camera_points`] by name.
pub fn camera_xml(camera: &Camera) -> String {
    let points: Vec<_> = camera.marks.iter().map(|m| m.name.clone()).zip(camera_points(camera)).collect();
    format!("<?xml version=\"1.0\" ?>\n{}", measures("Glob", &points, ""))
}

/// `MeasuresIm-SCAN.xml` of one frame, SCAN with its extension: the marks of its interior orientation, pixels counted
/// from `origin`; `None` when it has none.
pub fn image_xml(frame: &FrameResult, origin: PixelOrigin) -> Option<String> {
    frame.interior.as_ref()?;
    let points: Vec<_> = used_marks(frame, origin).map(|(m, at)| (m.mark.clone(), at)).collect();
    let one = measures(&file_name(frame), &points, "    ");
    Some(format!("<?xml version=\"1.0\" ?>\n<SetOfMesureAppuisFlottants>\n{one}</SetOfMesureAppuisFlottants>\n"))
}

/// `id_fiducial.txt`, the list of names that MicMac's and spymicmac's tools ask for.
pub fn names(camera: &Camera) -> String {
    camera.marks.iter().map(|m| m.name.clone() + "\n").collect()
}

/// The scan's name with extension, as MicMac calls images.
pub fn file_name(frame: &FrameResult) -> String {
    frame.path.file_name().map_or_else(|| frame.name.clone(), |n| n.to_string_lossy().into_owned())
}
