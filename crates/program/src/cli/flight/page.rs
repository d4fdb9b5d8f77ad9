//! The page of a solved flight: plain HTML with drawings in it, no scripts, nothing fetched.

use std::fmt::Write;

use autoref_flight::statistics::Residuals;
use autoref_raster::markup::{escaped, page_head};

use super::document::{BlockCamera, CamerasDocument, FrameDifference, PointRecord};
use crate::cli::values::unsigned_zero;

pub const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:64rem;padding:0 1rem;color:#222}\
    table{border-collapse:collapse;margin:.5rem 0 1.5rem;display:block;overflow-x:auto}td,th{padding:.2rem .7rem;border-bottom:1px solid #ccc;text-align:right}\
    td:first-child,th:first-child{text-align:left}svg{background:#f6f6f4;display:block;margin:.5rem 0;max-width:100%;height:auto}\
    .bad{color:#a93226;font-weight:600}@media print{body{margin:0}}";

/// Width of the map, pixels.
const MAP_PX: f64 = 900.0;
const TABLE: &str = "#7d3c98";
pub const CONTROL: &str = "#1f618d";
pub const CHECK: &str = "#c0392b";

/// A dash for what is not known.
pub fn fixed(value: impl Into<Option<f64>>, digits: usize) -> String {
    let known = value.into().filter(|v| v.is_finite());
    known.map_or("–".into(), |v| format!("{:.digits$}", unsigned_zero(v, digits as i32)))
}

/// A place, or a difference of two, whose parts are both known.
pub fn known(place: [f64; 2]) -> Option<[f64; 2]> {
    place.iter().all(|v| v.is_finite()).then_some(place)
}

/// The page of a document of `flight solve`.
pub fn page(document: &CamerasDocument, title: &str) -> String {
    let mut out = page_head(title, STYLE);
    let _ = write!(
        out,
        "<h1>{}</h1><p>{} of {} frames registered. Ties: {}, {} px RMS. Surveyed points: {}. CRS: {}.</p>",
        escaped(title),
        document.frames_registered,
        document.frames_listed,
        document.ties,
        fixed(document.reprojection_rms_px, 2),
        document.gcps.len() + document.check_points.len(),
        escaped(&document.crs)
    );
    out += "<p><a href=\"stages/index.html\">All stages</a></p>";
    for note in &document.notes {
        let _ = write!(out, "<p>{}</p>", escaped(note));
    }
    for blunder in &document.blunders {
        let in_frame = blunder.frame.as_ref().map(|frame| format!("in {}", escaped(frame)));
        let place = in_frame.unwrap_or("on the ground".into());
        let (gcp, test) = (escaped(&blunder.gcp), fixed(blunder.test, 1));
        let _ = write!(out, "<p class=\"bad\">{gcp} {place} is wrong: {test} standard deviations.</p>");
    }
    map(&mut out, document);
    statistics(&mut out, document);
    boxes(&mut out, document);
    tables(&mut out, document);
    out += "</html>\n";
    out
}

/// Where map coordinates lie in the drawing.
struct Frame {
    left: f64,
    top: f64,
    px_per_m: f64,
}

impl Frame {
    fn at(&self, p: [f64; 2]) -> [f64; 2] {
        [(p[0] - self.left) * self.px_per_m, (self.top - p[1]) * self.px_per_m]
    }
}

/// A round number of metres, not above.
fn round_below(v: f64) -> f64 {
    let unit = 10f64.powf(v.max(f64::MIN_POSITIVE).log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|k| k * unit).find(|r| *r <= v).unwrap_or(unit)
}

fn arrow(out: &mut String, from: [f64; 2], by: [f64; 2], colour: &str) {
    let (tip, length) = ([from[0] + by[0], from[1] + by[1]], by[0].hypot(by[1]));
    if length < 1.0 {
        return;
    }
    let (u, v) = (by[0] / length, by[1] / length);
    let head = 6.0f64.min(length);
    let _ = write!(
        out,
        "<path d=\"M{:.1} {:.1}L{:.1} {:.1}M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}\" stroke=\"{colour}\" stroke-width=\"1.6\" fill=\"none\"/>",
        from[0],
        from[1],
        tip[0],
        tip[1],
        tip[0] - head * (u + 0.5 * v),
        tip[1] - head * (v - 0.5 * u),
        tip[0],
        tip[1],
        tip[0] - head * (u - 0.5 * v),
        tip[1] - head * (v + 0.5 * u)
    );
}

fn map(out: &mut String, document: &CamerasDocument) {
    let of_camera = |c: &BlockCamera| known([c.camera.e, c.camera.n]);
    let of_point = |p: &PointRecord| known([p.e, p.n]);
    let points: Vec<(&PointRecord, &str)> = [(&document.gcps, CONTROL), (&document.check_points, CHECK)]
        .iter()
        .flat_map(|(points, colour)| points.iter().map(move |p| (p, *colour)))
        .collect();
    let cameras = document.cameras.iter().filter_map(of_camera);
    let everything: Vec<[f64; 2]> = cameras.chain(points.iter().filter_map(|p| of_point(p.0))).collect();
    let span = |a: usize| {
        let low = everything.iter().map(|p| p[a]).fold(f64::INFINITY, f64::min);
        (low, everything.iter().map(|p| p[a]).fold(f64::NEG_INFINITY, f64::max))
    };
    let ((west, east), (south, north)) = (span(0), span(1));
    if everything.is_empty() || !(west.is_finite() && north.is_finite()) {
        return;
    }
    // Wide enough for the longest arrow.
    let border = 0.1 * (east - west).max(north - south).max(1.0);
    let size_m = [east - west + 2.0 * border, north - south + 2.0 * border];
    let frame = Frame { left: west - border, top: north + border, px_per_m: MAP_PX / size_m[0].max(size_m[1]) };
    let [width, height] = size_m.map(|s| s * frame.px_per_m);
    let longest = |lengths: &mut dyn Iterator<Item = f64>| lengths.filter(|d| d.is_finite()).fold(0.0, f64::max);
    // The longest arrow of a kind takes a twelfth of the map.
    let arm_px = MAP_PX / 12.0;
    let differences = differences(document);
    let moved = longest(&mut differences.iter().map(|d| d.d_m));
    let residual = longest(&mut points.iter().filter_map(|p| p.0.d_m));
    let scale = |most: f64| if most > 0.0 { arm_px / most } else { 0.0 };
    let _ = write!(
        out,
        "<h2>Map</h2><svg viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" role=\"img\" \
         aria-label=\"Cameras and surveyed points\">"
    );
    for camera in &document.cameras {
        let (Some(at), yaw_deg) = (of_camera(camera).map(|p| frame.at(p)), camera.camera.yaw_deg) else { continue };
        if !yaw_deg.is_finite() {
            continue;
        }
        camera_mark(out, at, yaw_deg, &escaped(&camera.camera.name));
        let by = differences.iter().find(|d| d.name == camera.camera.name);
        if let Some([x, y]) = by.and_then(|d| known([d.x_m, d.y_m])) {
            let by = [x, -y].map(|v| v * scale(moved));
            arrow(out, [at[0] - by[0], at[1] - by[1]], by, TABLE);
        }
    }
    for (point, colour) in &points {
        let Some(at) = of_point(point).map(|p| frame.at(p)) else { continue };
        point_mark(out, at, &escaped(&point.name), colour);
        if let Some([x, y]) = point.residual_m.and_then(|[x, y, _]| known([x, y])) {
            arrow(out, at, [x, -y].map(|v| v * scale(residual)), colour);
        }
    }
    let bar_m = round_below(size_m[0] / 5.0);
    let _ = write!(
        out,
        "<path d=\"M12 {0:.1}h{1:.1}\" stroke=\"#222\" stroke-width=\"3\"/><text x=\"12\" y=\"{2:.1}\" font-size=\"12\">{bar_m} m</text></svg>",
        height - 12.0,
        bar_m * frame.px_per_m,
        height - 18.0
    );
    let _ = write!(out, "<p>North is up. Triangles: cameras and where they look.");
    if !points.is_empty() {
        let _ = write!(
            out,
            " <span style=\"color:{CONTROL}\">Control points</span> and <span style=\"color:{CHECK}\">check points</span> \
             with their residuals, the longest {residual:.2} m."
        );
    }
    if moved > 0.0 {
        let _ = write!(
            out,
            " <span style=\"color:{TABLE}\">Arrows to cameras</span>: from the rough table, the longest {moved:.1} m."
        );
    }
    *out += " Arrows of a kind share a scale of their own.</p>";
}

/// A camera and where it looks.
pub fn camera_mark(out: &mut String, at: [f64; 2], yaw_deg: f64, name: &str) {
    let (sin, cos) = yaw_deg.to_radians().sin_cos();
    let view = |along: f64, beside: f64| [at[0] + along * sin + beside * cos, at[1] - along * cos + beside * sin];
    let (l, r) = (view(22.0, -12.0), view(22.0, 12.0));
    let _ = write!(
        out,
        "<path d=\"M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z\" fill=\"#d5dbdb\" stroke=\"#566573\"/><text x=\"{:.1}\" \
         y=\"{:.1}\" font-size=\"10\" fill=\"#566573\" text-anchor=\"middle\">{name}</text>",
        at[0],
        at[1],
        l[0],
        l[1],
        r[0],
        r[1],
        at[0],
        at[1] + 14.0
    );
}

fn point_mark(out: &mut String, at: [f64; 2], name: &str, colour: &str) {
    let _ = write!(
        out,
        "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{colour}\"><title>{name}</title></circle>\
         <text x=\"{:.1}\" y=\"{:.1}\" font-size=\"11\" fill=\"{colour}\">{name}</text>",
        at[0],
        at[1],
        at[0] + 5.0,
        at[1] - 5.0
    );
}

/// Camera − rough table of every frame that the table has.
fn differences(document: &CamerasDocument) -> &[FrameDifference] {
    document.rough_differences.as_ref().map_or(&[], |differences| &differences.frames)
}

fn statistics(out: &mut String, document: &CamerasDocument) {
    let all = [
        ("control points", document.gcp_statistics),
        ("check points", document.check_point_statistics),
        ("cameras − rough table", document.rough_differences.as_ref().and_then(|differences| differences.statistics)),
    ];
    *out += "<h2>Residuals, metres</h2><table><tr><th></th><th>n</th><th></th><th>max</th><th>min</th><th>mean</th><th>SD</th><th>RMS</th></tr>";
    let lines = document.lines.as_deref().unwrap_or_default();
    let names: Vec<String> = lines.iter().map(|l| format!("control points of line {}", escaped(&l.name))).collect();
    let of_lines = names.iter().map(String::as_str).zip(lines.iter().map(|line| line.gcp_statistics));
    // Of one line they are those of all.
    let of_lines = of_lines.filter(|_| lines.len() > 1);
    for (what, of) in all.into_iter().chain(of_lines) {
        let Some(Residuals { n, x, y, z, d }) = of else { continue };
        for (i, (axis, of)) in [("x", x), ("y", y), ("z", z), ("d", d)].into_iter().enumerate() {
            let (what, n) = if i == 0 { (what, n.to_string()) } else { ("", String::new()) };
            let _ = write!(out, "<tr><td>{what}</td><td>{n}</td><td>{axis}</td>");
            cells(out, [of.max, of.min, of.mean, of.sd, of.rms].map(|v| fixed(v, 2)));
            *out += "</tr>";
        }
    }
    *out += "</table>";
}

/// Minimum, quartiles and maximum of sorted values, by linear interpolation between them.
fn five(values: &[f64]) -> [f64; 5] {
    [0.0, 0.25, 0.5, 0.75, 1.0].map(|q| {
        let at = q * (values.len() - 1) as f64;
        let (low, part) = (at.floor() as usize, at.fract());
        values[low] + part * (values[(low + 1).min(values.len() - 1)] - values[low])
    })
}

fn boxes(out: &mut String, document: &CamerasDocument) {
    let frames = differences(document);
    let of = |axis: usize, f: &FrameDifference| [f.x_m, f.y_m, f.z_m, f.d_m][axis];
    let series: Vec<(&str, Vec<f64>)> = ["x", "y", "z", "d"]
        .into_iter()
        .enumerate()
        .map(|(k, axis)| {
            let mut values: Vec<f64> = frames.iter().map(|f| of(k, f)).filter(|v| v.is_finite()).collect();
            values.sort_by(f64::total_cmp);
            (axis, values)
        })
        .filter(|(_, values)| !values.is_empty())
        .collect();
    if series.is_empty() {
        return;
    }
    let low = series.iter().map(|s| s.1[0]).fold(0.0, f64::min);
    let high = series.iter().map(|s| s.1[s.1.len() - 1]).fold(0.0, f64::max);
    let (height, top) = (220.0, 12.0);
    let y = |v: f64| top + (high - v) / (high - low).max(f64::MIN_POSITIVE) * (height - 2.0 * top);
    let _ = write!(
        out,
        "<h2>Cameras − rough table</h2><svg width=\"420\" height=\"{height}\" role=\"img\" aria-label=\"Box plot of the differences\">\
         <path d=\"M40 {0:.1}H410\" stroke=\"#aaa\"/><text x=\"2\" y=\"{0:.1}\" font-size=\"11\">0</text>\
         <text x=\"2\" y=\"{1:.1}\" font-size=\"11\">{high:.0} m</text><text x=\"2\" y=\"{2:.1}\" font-size=\"11\">{low:.0} m</text>",
        y(0.0),
        y(high) + 8.0,
        y(low)
    );
    for (i, (what, values)) in series.iter().enumerate() {
        let x = 90.0 + 90.0 * i as f64;
        let [least, q1, middle, q3, most] = five(values).map(y);
        let _ = write!(
            out,
            "<path d=\"M{x} {most:.1}V{q3:.1}M{x} {q1:.1}V{least:.1}\" stroke=\"{TABLE}\"/>\
             <rect x=\"{}\" y=\"{q3:.1}\" width=\"44\" height=\"{:.1}\" fill=\"#e8daef\" stroke=\"{TABLE}\"/>\
             <path d=\"M{} {middle:.1}h44\" stroke=\"{TABLE}\" stroke-width=\"2.5\"/><text x=\"{x}\" y=\"{}\" font-size=\"12\" text-anchor=\"middle\">{what}</text>",
            x - 22.0,
            q1 - q3,
            x - 22.0,
            height - 1.0
        );
    }
    *out += "</svg><p>Box: middle half; line: median; whiskers: least and most.</p>";
}

/// Names of a pair's frames.
pub fn both(frames: &[String; 2]) -> String {
    frames.each_ref().map(|name| escaped(name)).join(" – ")
}

pub fn cells<const N: usize>(out: &mut String, texts: [String; N]) {
    for text in texts {
        let _ = write!(out, "<td>{text}</td>");
    }
}

fn tables(out: &mut String, document: &CamerasDocument) {
    *out += "<h2>Cameras</h2><table><tr><th>frame</th><th>e</th><th>n</th><th>h</th><th>σ e, n, h (m)</th><th>yaw</th><th>pitch</th><th>roll (°)</th><th>ties</th><th>RMS (px)</th></tr>";
    for BlockCamera { camera: c, rms_px, ties } in &document.cameras {
        let sigmas = c.deviations.as_ref().map(|d| [d.sigma_e, d.sigma_n, d.sigma_h]);
        let _ = write!(out, "<tr><td>{}</td>", escaped(&c.name));
        cells(out, [c.e, c.n, c.h].map(|v| fixed(v, 1)));
        cells(out, [[0, 1, 2].map(|i| fixed(sigmas.map(|s| s[i]), 1)).join(", ")]);
        cells(out, [c.yaw_deg, c.pitch_deg, c.roll_deg].map(|v| fixed(v, 2)));
        let _ = write!(out, "<td>{ties}</td><td>{}</td></tr>", fixed(*rms_px, 2));
    }
    *out += "</table>";
    for (points, title) in [(&document.gcps, "Control points"), (&document.check_points, "Check points")] {
        if points.is_empty() {
            continue;
        }
        let _ = write!(
            out,
            "<h2>{title}</h2><table><tr><th>point</th><th>x</th><th>y</th><th>z</th><th>d (m)</th><th>frames</th></tr>"
        );
        for p in points {
            let _ = write!(out, "<tr><td>{}</td>", escaped(&p.name));
            cells(out, [0, 1, 2].map(|a| fixed(p.residual_m.map(|r| r[a]), 2)));
            let _ = write!(out, "<td>{}</td><td>{}</td></tr>", fixed(p.d_m, 2), p.images.len());
        }
        *out += "</table>";
    }
    if let Some(pairs) = document.pairs.as_ref().filter(|pairs| !pairs.is_empty()) {
        *out += "<h2>Ties of pairs</h2><table><tr><th>frames</th><th>ties</th></tr>";
        for p in pairs {
            let _ = write!(out, "<tr><td>{}</td><td>{}</td></tr>", both(&p.frames), p.ties);
        }
        *out += "</table>";
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::flight::document::CameraRecord;

    #[test]
    fn quartiles_are_those_of_numpy() {
        assert_eq!(five(&[1.0, 2.0, 3.0, 4.0]), [1.0, 1.75, 2.5, 3.25, 4.0]);
        assert_eq!(five(&[7.0]), [7.0; 5]);
    }

    #[test]
    fn names_are_text_in_the_page() {
        let camera = CameraRecord { name: "<b>".into(), h: 1.0, yaw_deg: 3.0, ..CameraRecord::default() };
        let (residual_m, d_m) = (Some([1.0, 2.0, 2.0]), Some(3.0));
        let gcp = PointRecord { name: "a&b".into(), e: 10.0, n: 20.0, residual_m, d_m, ..PointRecord::default() };
        let document = CamerasDocument {
            crs: "local".into(),
            notes: vec!["<i>".into()],
            cameras: vec![BlockCamera { camera, ..BlockCamera::default() }],
            gcps: vec![gcp],
            ..CamerasDocument::default()
        };
        let page = page(&document, "x");
        assert!(
            page.contains("&lt;b&gt;") && page.contains("a&amp;b") && !page.contains("<b>") && !page.contains("<i>")
        );
    }
}
