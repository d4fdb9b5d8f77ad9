//! The page of a solved flight: plain HTML with drawings in it, no scripts, nothing fetched.

use std::fmt::Write;

use serde_json::Value;

use crate::cli::values::unsigned_zero;
use autoref_raster::markup::{escaped, page_head};

pub const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:64rem;padding:0 1rem;color:#222}\
    table{border-collapse:collapse;margin:.5rem 0 1.5rem;display:block;overflow-x:auto}td,th{padding:.2rem .7rem;border-bottom:1px solid #ccc;text-align:right}\
    td:first-child,th:first-child{text-align:left}svg{background:#f6f6f4;display:block;margin:.5rem 0;max-width:100%;height:auto}\
    .bad{color:#a93226;font-weight:600}@media print{body{margin:0}}";

/// Width of the map, pixels.
const MAP_PX: f64 = 900.0;
const TABLE: &str = "#7d3c98";
pub const CONTROL: &str = "#1f618d";
pub const CHECK: &str = "#c0392b";

pub fn fixed(value: &Value, digits: usize) -> String {
    value.as_f64().map_or("–".into(), |v| format!("{:.digits$}", unsigned_zero(v, digits as i32)))
}

pub fn rows<'a>(document: &'a Value, key: &str) -> &'a [Value] {
    document[key].as_array().map_or(&[], Vec::as_slice)
}

pub fn name(value: &Value) -> String {
    escaped(value["name"].as_str().unwrap_or_default())
}

/// The page of a document of `flight solve`.
pub fn page(document: &Value, title: &str) -> String {
    let mut out = page_head(title, STYLE);
    let _ = write!(
        out,
        "<h1>{}</h1><p>{} of {} frames registered. Ties: {}, {} px RMS. Surveyed points: {}. CRS: {}.</p>",
        escaped(title),
        document["frames_registered"],
        document["frames_listed"],
        document["ties"],
        fixed(&document["reprojection_rms_px"], 2),
        rows(document, "gcps").len() + rows(document, "check_points").len(),
        escaped(document["crs"].as_str().unwrap_or_default())
    );
    out += "<p><a href=\"stages/index.html\">All stages</a></p>";
    for note in rows(document, "notes").iter().filter_map(Value::as_str) {
        let _ = write!(out, "<p>{}</p>", escaped(note));
    }
    for blunder in rows(document, "blunders") {
        let of = |key: &str| escaped(blunder[key].as_str().unwrap_or_default());
        let place = if blunder["frame"].is_null() { "on the ground".into() } else { format!("in {}", of("frame")) };
        let test = fixed(&blunder["test"], 1);
        let _ = write!(out, "<p class=\"bad\">{} {place} is wrong: {test} standard deviations.</p>", of("gcp"));
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

fn place(value: &Value) -> Option<[f64; 2]> {
    Some([value["e"].as_f64()?, value["n"].as_f64()?])
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

fn map(out: &mut String, document: &Value) {
    let cameras: Vec<[f64; 2]> = rows(document, "cameras").iter().filter_map(place).collect();
    let points: Vec<(&Value, &str)> = [("gcps", CONTROL), ("check_points", CHECK)]
        .iter()
        .flat_map(|(key, colour)| rows(document, key).iter().map(move |p| (p, *colour)))
        .collect();
    let everything: Vec<[f64; 2]> = cameras.iter().copied().chain(points.iter().filter_map(|p| place(p.0))).collect();
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
    let longest = |lengths: &mut dyn Iterator<Item = f64>| lengths.fold(0.0, f64::max);
    // The longest arrow of a kind takes a twelfth of the map.
    let arm_px = MAP_PX / 12.0;
    let differences = rows(&document["rough_differences"], "frames");
    let moved = longest(&mut differences.iter().filter_map(|d| d["d_m"].as_f64()));
    let residual = longest(&mut points.iter().filter_map(|p| p.0["d_m"].as_f64()));
    let scale = |most: f64| if most > 0.0 { arm_px / most } else { 0.0 };
    let _ = write!(
        out,
        "<h2>Map</h2><svg viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" role=\"img\" \
         aria-label=\"Cameras and surveyed points\">"
    );
    for camera in rows(document, "cameras") {
        let (Some(at), Some(yaw)) = (place(camera).map(|p| frame.at(p)), camera["yaw_deg"].as_f64()) else { continue };
        camera_mark(out, at, yaw, &name(camera));
        let by = differences.iter().find(|d| d["name"] == camera["name"]);
        if let Some((x, y)) = by.and_then(|d| Some((d["x_m"].as_f64()?, d["y_m"].as_f64()?))) {
            let by = [x, -y].map(|v| v * scale(moved));
            arrow(out, [at[0] - by[0], at[1] - by[1]], by, TABLE);
        }
    }
    for (point, colour) in &points {
        let Some(at) = place(point).map(|p| frame.at(p)) else { continue };
        point_mark(out, at, &name(point), colour);
        let by = &point["residual_m"];
        if let (Some(x), Some(y)) = (by[0].as_f64(), by[1].as_f64()) {
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

fn statistics(out: &mut String, document: &Value) {
    let all = [
        ("control points", &document["gcp_statistics"]),
        ("check points", &document["check_point_statistics"]),
        ("cameras − rough table", &document["rough_differences"]["statistics"]),
    ];
    *out += "<h2>Residuals, metres</h2><table><tr><th></th><th>n</th><th></th><th>max</th><th>min</th><th>mean</th><th>SD</th><th>RMS</th></tr>";
    let lines = rows(document, "lines");
    let names: Vec<String> = lines.iter().map(|line| format!("control points of line {}", name(line))).collect();
    let of_lines = names.iter().map(String::as_str).zip(lines.iter().map(|line| &line["gcp_statistics"]));
    // Of one line they are those of all.
    let of_lines = of_lines.filter(|_| lines.len() > 1);
    for (what, of) in all.into_iter().chain(of_lines).filter(|(_, of)| of.is_object()) {
        for (i, axis) in ["x", "y", "z", "d"].iter().enumerate() {
            let (what, n) = if i == 0 { (what, of["n"].to_string()) } else { ("", String::new()) };
            let _ = write!(out, "<tr><td>{what}</td><td>{n}</td><td>{axis}</td>");
            for key in ["max", "min", "mean", "sd", "rms"] {
                let _ = write!(out, "<td>{}</td>", fixed(&of[axis][key], 2));
            }
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

fn boxes(out: &mut String, document: &Value) {
    let frames = rows(&document["rough_differences"], "frames");
    let series: Vec<(&str, Vec<f64>)> = ["x_m", "y_m", "z_m", "d_m"]
        .iter()
        .map(|key| {
            let mut values: Vec<f64> = frames.iter().filter_map(|f| f[key].as_f64()).collect();
            values.sort_by(f64::total_cmp);
            (key.trim_end_matches("_m"), values)
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

pub fn cells<const N: usize>(out: &mut String, texts: [String; N]) {
    for text in texts {
        let _ = write!(out, "<td>{text}</td>");
    }
}

fn tables(out: &mut String, document: &Value) {
    *out += "<h2>Cameras</h2><table><tr><th>frame</th><th>e</th><th>n</th><th>h</th><th>σ e, n, h (m)</th><th>yaw</th><th>pitch</th><th>roll (°)</th><th>ties</th><th>RMS (px)</th></tr>";
    for c in rows(document, "cameras") {
        let sigma: Vec<String> = ["sigma_e", "sigma_n", "sigma_h"].iter().map(|k| fixed(&c[k], 1)).collect();
        let _ = write!(out, "<tr><td>{}</td>", name(c));
        cells(out, ["e", "n", "h"].map(|k| fixed(&c[k], 1)));
        cells(out, [sigma.join(", ")]);
        cells(out, ["yaw_deg", "pitch_deg", "roll_deg"].map(|k| fixed(&c[k], 2)));
        let _ = write!(out, "<td>{}</td><td>{}</td></tr>", c["ties"], fixed(&c["rms_px"], 2));
    }
    *out += "</table>";
    for (key, title) in [("gcps", "Control points"), ("check_points", "Check points")] {
        if rows(document, key).is_empty() {
            continue;
        }
        let _ = write!(
            out,
            "<h2>{title}</h2><table><tr><th>point</th><th>x</th><th>y</th><th>z</th><th>d (m)</th><th>frames</th></tr>"
        );
        for p in rows(document, key) {
            let _ = write!(out, "<tr><td>{}</td>", name(p));
            cells(out, [0, 1, 2].map(|a| fixed(&p["residual_m"][a], 2)));
            let _ = write!(out, "<td>{}</td><td>{}</td></tr>", fixed(&p["d_m"], 2), rows(p, "images").len());
        }
        *out += "</table>";
    }
    if !rows(document, "pairs").is_empty() {
        *out += "<h2>Ties of pairs</h2><table><tr><th>frames</th><th>ties</th></tr>";
        for p in rows(document, "pairs") {
            let of = |k: usize| escaped(p["frames"][k].as_str().unwrap_or_default());
            let _ = write!(out, "<tr><td>{} – {}</td><td>{}</td></tr>", of(0), of(1), p["ties"]);
        }
        *out += "</table>";
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_are_those_of_numpy() {
        assert_eq!(five(&[1.0, 2.0, 3.0, 4.0]), [1.0, 1.75, 2.5, 3.25, 4.0]);
        assert_eq!(five(&[7.0]), [7.0; 5]);
    }

    #[test]
    fn names_are_text_in_the_page() {
        let document = serde_json::json!({
            "frames_registered": 1, "frames_listed": 1, "crs": "local", "ties": 3, "notes": ["<i>"],
            "cameras": [{"name": "<b>", "e": 0.0, "n": 0.0, "h": 1.0, "yaw_deg": 3.0}],
            "gcps": [{"name": "a&b", "e": 10.0, "n": 20.0, "residual_m": [1.0, 2.0, 2.0], "d_m": 3.0}],
        });
        let page = page(&document, "x");
        assert!(
            page.contains("&lt;b&gt;") && page.contains("a&amp;b") && !page.contains("<b>") && !page.contains("<i>")
        );
    }
}
