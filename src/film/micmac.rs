//! MicMac's inner orientation: what `mm3d ReSampFid` reads (`cAppliOneReechMarqFid` in MicMac's sources). The camera's file is
//! one `MesureAppuiFlottant1Im` in millimetres, a frame's is a `SetOfMesureAppuisFlottants` with one in pixels.

use quick_xml::escape::escape;

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

/// `MeasuresCamera.xml`: millimetres with y **down**, since ReSampFid takes them for the axes of the picture that it writes
/// and would mirror a film whose y runs up.
pub fn camera_xml(camera: &Camera) -> String {
    let points: Vec<_> = camera.marks.iter().map(|m| m.name.clone()).zip(camera.film_points()).collect();
    format!("<?xml version=\"1.0\" ?>\n{}", measures("Glob", &points, ""))
}

/// `MeasuresIm-NAME.xml` of one frame: the marks of its inner orientation, pixels as in `docs/coordinates.md`; `None` when it
/// has none.
pub fn image_xml(frame: &FrameResult) -> Option<String> {
    let used = &frame.inner.as_ref()?.marks;
    let points: Vec<_> = frame
        .marks
        .iter()
        .filter(|m| used.contains(&m.mark))
        .filter_map(|m| m.centre.map(|c| (m.mark.clone(), [c.x, c.y])))
        .collect();
    let one = measures(&file_name(frame), &points, "    ");
    Some(format!("<?xml version=\"1.0\" ?>\n<SetOfMesureAppuisFlottants>\n{one}</SetOfMesureAppuisFlottants>\n"))
}

/// The scan's name with extension, as MicMac calls images.
pub fn file_name(frame: &FrameResult) -> String {
    frame.path.file_name().map_or_else(|| frame.name.clone(), |n| n.to_string_lossy().into_owned())
}
