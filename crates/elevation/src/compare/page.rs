//! One page, readable without a network: a map with both hillshades and the difference, profiles by click, tables, box
//! plots, and the variogram.

use std::fmt::Write;
use std::path::Path;

use crate::error::{Error, Result};
use autoref_raster::markup::{escaped, page_head};

use super::summary::{Statistics, Summary};

const STYLE: &str = "body{font:15px/1.45 sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}\
    table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}\
    td:first-child,th:first-child,td:nth-child(2),th:nth-child(2){text-align:left}svg{max-width:100%}\
    .bar{display:flex;flex-wrap:wrap;gap:.4em 1.4em;align-items:center}.bar label{display:flex;gap:.5em;align-items:center}\
    #map{max-width:100%;cursor:crosshair;border:1px solid #999}#limit{width:6em}#legend{font-size:13px}\
    .wide{overflow-x:auto}.wide svg{min-width:640px}.note{color:#555}#readout{font-variant-numeric:tabular-nums;flex-basis:100%;min-height:2.9em}";

/// Writes `report.html`.
///
/// # Errors
/// When it cannot be written.
pub fn write_page(folder: &Path, summary: &Summary, map: &serde_json::Value) -> Result<()> {
    let path = folder.join("report.html");
    std::fs::write(&path, page(summary, map)).map_err(|e| Error::io(&path, "write", e))
}

/// Without the folder.
fn name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

fn figure(value: Option<f64>) -> String {
    value.map_or("–".into(), |v| format!("{:.3}", if v.abs() < 5e-4 { 0.0 } else { v }))
}

fn whole(value: Option<f64>) -> String {
    value.map_or("–".into(), |v| format!("{:.0}", if v.abs() <= 0.5 { 0.0 } else { v }))
}

fn page(summary: &Summary, map: &serde_json::Value) -> String {
    let mut out = page_head("Elevation models compared", STYLE);
    let _ = write!(
        out,
        "<h1>{} − {}</h1><p>A is {}, B is {}.</p><p>Differences are A − B in metres, on the grid of B, {} resampling; \
         heights: {}. {} of {} cells have both heights.</p>",
        escaped(name(&summary.a)),
        escaped(name(&summary.b)),
        escaped(&summary.a),
        escaped(&summary.b),
        summary.resampling,
        escaped(&summary.heights),
        summary.common_cells,
        summary.cells
    );
    let _ = write!(
        out,
        "<p>Mean {} m ± {} m (one standard error; {} independent cells by the variogram), median {} m, NMAD {} m, \
         RMSE {} m.</p>",
        figure(summary.mean_m),
        figure(summary.mean_se_m),
        whole(summary.effective_n),
        figure(summary.median_m),
        figure(summary.nmad_m),
        figure(summary.rmse_m)
    );
    let _ = write!(out, "<script>const DATA = {map};</script>");
    out.push_str(include_str!("map.html"));
    out.push_str("<h2>By class</h2>");
    out.push_str(&boxes(&summary.statistics));
    let _ = write!(
        out,
        "<p class=\"note\">Line: from the 5th to the 95th per cent of the differences A − B; box: their middle half; bar: their \
         median. In the table differences are in metres, n counts cells, and <i>within</i> is the share of cells whose \
         difference is at most {} m.</p>",
        summary.within_m
    );
    out.push_str(
        "<div class=\"wide\"><table><tr><th>group<th>class<th>n<th>mean<th>median<th>SD<th>NMAD<th>RMSE<th>min<th>max<th>within</tr>",
    );
    for s in summary.statistics.iter().filter(|s| s.n > 0) {
        let _ = write!(out, "<tr><td>{}<td>{}<td>{}", escaped(&s.group), escaped(&s.class), s.n);
        for value in [s.mean_m, s.median_m, s.sd_m, s.nmad_m, s.rmse_m, s.min_m, s.max_m, s.share_within] {
            let _ = write!(out, "<td>{}", figure(value));
        }
        out.push_str("</tr>");
    }
    out.push_str("</table></div>");
    if !summary.volumes.is_empty() {
        out.push_str(
            "<h2>Volumes</h2><table><tr><th>zone<th><th>area, m²<th>mean, m<th>± m<th>volume, m³<th>± m³</tr>",
        );
        for v in &summary.volumes {
            let _ = write!(
                out,
                "<tr><td>{}<td><td>{:.0}<td>{}<td>{}<td>{}<td>{}</tr>",
                escaped(&v.zone),
                v.area_m2,
                figure(v.mean_m),
                figure(v.mean_se_m),
                whole(v.volume_m3),
                whole(v.volume_se_m3)
            );
        }
        out.push_str("</table>");
    }
    out.push_str("<h2>Variogram</h2>");
    out.push_str(&variogram(summary));
    out.push_str("</html>\n");
    out
}

/// From the 5th to the 95th per cent, the middle half, the median.
fn boxes(statistics: &[Statistics]) -> String {
    let filled: Vec<&Statistics> = statistics.iter().filter(|s| s.n > 0 && s.percentiles_m.len() == 9).collect();
    let at = |s: &Statistics, percent: &str| s.percentiles_m.get(percent).and_then(|v| v.as_f64()).unwrap_or(0.0);
    let low = filled.iter().map(|s| at(s, "5")).fold(f64::INFINITY, f64::min);
    let high = filled.iter().map(|s| at(s, "95")).fold(f64::NEG_INFINITY, f64::max);
    let range = (high - low).max(1e-6);
    let x = |value: f64| 220.0 + 700.0 * (value - low) / range;
    let mut out = format!("<div class=\"wide\"><svg viewBox=\"0 0 960 {}\" font-size=\"12\">", 18 * filled.len() + 30);
    for (row, s) in filled.iter().enumerate() {
        let y = 18.0 * row as f64 + 12.0;
        let _ = write!(
            out,
            "<text x=\"210\" y=\"{:.1}\" text-anchor=\"end\">{} {}</text>\
             <path d=\"M{:.2} {y}H{:.2}\" stroke=\"#888\"/><rect x=\"{:.2}\" y=\"{:.1}\" width=\"{:.2}\" height=\"10\" \
             fill=\"#9bc\"/><path d=\"M{:.2} {:.1}v10\" stroke=\"#000\" stroke-width=\"2\"/>",
            y + 4.0,
            escaped(&s.group),
            escaped(&s.class),
            x(at(s, "5")),
            x(at(s, "95")),
            x(at(s, "25")),
            y - 5.0,
            x(at(s, "75")) - x(at(s, "25")),
            x(at(s, "50")),
            y - 5.0
        );
    }
    let y = 18 * filled.len() + 24;
    let _ = write!(
        out,
        "<text x=\"220\" y=\"{y}\">{low:.2} m</text><text x=\"920\" y=\"{y}\" text-anchor=\"end\">{high:.2} m</text></svg></div>"
    );
    out
}

fn variogram(summary: &Summary) -> String {
    let v = &summary.variogram;
    let Some(last) = v.bins.last() else { return "<p>Too few cells.</p>".into() };
    let first = v.bins[0].lag_m;
    let top = v.bins.iter().map(|b| b.semivariance_m2).fold(v.semivariance(last.lag_m), f64::max).max(1e-12);
    let x = |lag: f64| 60.0 + 860.0 * (lag / first).ln() / (last.lag_m / first).ln().max(1e-9);
    let y = |value: f64| 260.0 - 240.0 * value / top;
    let mut out = String::from(
        "<div class=\"wide\"><svg viewBox=\"0 0 960 290\" font-size=\"12\"><path d=\"M60 20V260H920\" fill=\"none\" stroke=\"#888\"/>",
    );
    for bin in &v.bins {
        let _ = write!(
            out,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"#357\"/>",
            x(bin.lag_m),
            y(bin.semivariance_m2)
        );
    }
    let line: Vec<String> = (0..=100)
        .map(|i| first * (last.lag_m / first).powf(f64::from(i) / 100.0))
        .map(|lag| format!("{:.1},{:.1}", x(lag), y(v.semivariance(lag))))
        .collect();
    let _ = write!(
        out,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#c53\"/><text x=\"60\" y=\"278\">{first:.0} m</text>\
         <text x=\"920\" y=\"278\" text-anchor=\"end\">{:.0} m</text><text x=\"64\" y=\"16\">{top:.4} m²</text></svg></div>\
         <p class=\"note\">Half the mean squared difference of two cells (m²) against how far they are apart; the line is \
         the model that independent cells are counted by.</p>",
        line.join(" "),
        last.lag_m
    );
    out
}
