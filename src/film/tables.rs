//! Marks of a frame for other programs: CSV as spymicmac and hipp read it, GeoJSON in pixel space.

use serde_json::{Value, json};

use super::types::FrameResult;

/// `gcp,im_col,im_row` of the marks of the inner orientation, pixels as in `docs/coordinates.md`; the residual columns are
/// micrometres.
pub fn measures_csv(frame: &FrameResult) -> String {
    let mut out = csv::Writer::from_writer(vec![]);
    let rows = frame.marks.iter().filter(|m| frame.inner.as_ref().is_some_and(|i| i.marks.contains(&m.mark)));
    out.write_record(["gcp", "im_col", "im_row", "residual_x_um", "residual_y_um"]).expect("memory takes all");
    for m in rows {
        let Some(c) = m.centre else { continue };
        let r = m.residual_um.map_or(["".into(), "".into()], |r| r.map(|v| format!("{v:.3}")));
        let [rx, ry] = &r;
        out.write_record([&m.mark, &c.x.to_string(), &c.y.to_string(), rx, ry]).expect("memory takes all");
    }
    String::from_utf8(out.into_inner().expect("memory takes all")).expect("made of strings")
}

/// One point per mark that has a place. GIS programs show pixel space with y upwards, so y is **minus** the row; `x_px` and
/// `y_px` have the pixels themselves.
pub fn features(frame: &FrameResult) -> Vec<Value> {
    let one = |m: &super::types::MarkFind| {
        let c = m.centre?;
        Some(json!({
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [c.x, -c.y]},
            "properties": {"frame": frame.name, "mark": m.mark, "status": m.status, "x_px": c.x, "y_px": c.y,
                "score": m.score, "residual_um": m.residual_um, "reason": m.reason},
        }))
    };
    frame.marks.iter().filter_map(one).collect()
}

/// A collection of [`features`].
pub fn geojson(frame: &FrameResult) -> String {
    json!({"type": "FeatureCollection", "features": features(frame)}).to_string() + "\n"
}
