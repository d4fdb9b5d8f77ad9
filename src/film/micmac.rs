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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::load_camera;

    /// Element names in order of opening, and the text of each.
    fn read_back(xml: &str) -> Vec<(String, String)> {
        let mut reader = quick_xml::Reader::from_str(xml);
        let mut seen: Vec<(String, String)> = vec![];
        loop {
            match reader.read_event().expect("well-formed") {
                quick_xml::events::Event::Start(e) => {
                    seen.push((
                        std::str::from_utf8(e.name().into_inner().as_ref()).expect("UTF-8").to_owned(),
                        String::new(),
                    ));
                }
                quick_xml::events::Event::Text(t) => {
                    if let Some(last) = seen.last_mut().filter(|l| l.1.is_empty()) {
                        last.1 = t.trim().to_owned();
                    }
                }
                quick_xml::events::Event::Eof => return seen,
                _ => {}
            }
        }
    }

    #[test]
    fn the_camera_file_reads_back_in_order_with_y_down() {
        let camera = load_camera("wild-15-4").expect("built in");
        let seen = read_back(&camera_xml(&camera));
        assert_eq!((seen[0].0.as_str(), seen[1].0.as_str()), ("MesureAppuiFlottant1Im", "NameIm"));
        assert_eq!(seen.len(), 2 + 3 * camera.marks.len());
        for (group, (mark, mm)) in seen[2..].chunks(3).zip(camera.marks.iter().zip(camera.film_points())) {
            assert_eq!(group[0].0, "OneMesureAF1I");
            assert_eq!(group[1], ("NamePt".into(), mark.name.clone()));
            let xy: Vec<f64> = group[2].1.split(' ').map(|v| v.parse().expect("a number")).collect();
            assert_eq!((group[2].0.as_str(), xy.as_slice()), ("PtIm", mm.as_slice()));
            assert_eq!(Some(-xy[1]), mark.y_mm);
        }
    }
}
