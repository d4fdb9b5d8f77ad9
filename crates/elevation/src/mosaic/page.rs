//! One page, readable without a network: where sources differ in their overlaps, before and after balancing.

use std::fmt::Write;
use std::path::Path;

use crate::grid::Grid;
use autoref_raster::markup::{escaped, page_head};

use super::balance::{Balance, DifferenceMap, Overlap};
use autoref_raster::words::counted;

/// Rows of a table at most: the largest differences, or the first sources.
const MOST_ROWS: usize = 300;
/// Bars of the drawing at most.
const MOST_BARS: usize = 60;
const STYLE: &str = "body{font:15px/1.45 sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}\
    table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}\
    td.t,th.t{text-align:left}svg{max-width:100%;height:auto}.pair{display:grid;grid-template-columns:1fr 1fr;gap:1em}\
    figure{margin:0}.wide{overflow-x:auto}.dot{display:inline-block;width:.8em;height:.8em;border-radius:50%}";

fn name(path: &Path) -> String {
    escaped(&path.file_name().unwrap_or_default().to_string_lossy())
}

/// The page.
pub fn text(sources: &[(&Path, Grid)], mosaic: &Grid, balance: &Balance) -> String {
    let mut out = page_head("Overlaps of a mosaic", STYLE);
    let overlaps = &balance.overlaps;
    let rms = |of: &dyn Fn(&Overlap) -> f64| {
        let n: usize = overlaps.iter().map(|o| o.blocks).sum();
        (overlaps.iter().map(|o| of(o).powi(2) * o.blocks as f64).sum::<f64>() / n.max(1) as f64).sqrt()
    };
    let _ = write!(
        out,
        "<h1>Overlaps of a mosaic</h1><p>{}, {} × {} cells.</p>",
        counted(sources.len(), "source", "sources"),
        mosaic.width,
        mosaic.height
    );
    for note in &balance.notes {
        let _ = write!(out, "<p>{}.</p>", escaped(note));
    }
    if overlaps.is_empty() {
        out.push_str("<p>No two sources overlap: nothing was balanced.</p></html>\n");
        return out;
    }
    let _ = write!(
        out,
        "<p>Differences of means over blocks of 16 × 16 cells, second source minus first. Root mean square over all \
         overlaps: <b>{:.3}</b> before, <b>{:.3}</b> after.</p>",
        rms(&|o| o.rms_before),
        rms(&|o| o.rms_after)
    );
    maps(&mut out, sources, mosaic, &balance.map);
    let mut worst: Vec<&Overlap> = overlaps.iter().collect();
    worst.sort_by(|a, b| b.rms_before.total_cmp(&a.rms_before));
    bars(&mut out, &worst);
    overlap_table(&mut out, sources, &worst);
    source_table(&mut out, sources, balance);
    out.push_str("</html>\n");
    out
}

/// Where the differences are, on one scale.
fn maps(out: &mut String, sources: &[(&Path, Grid)], mosaic: &Grid, map: &DifferenceMap) {
    let mut sizes: Vec<f64> = map.before.iter().copied().filter(|v| v.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let top = sizes.get(sizes.len() * 95 / 100).copied().unwrap_or(1.0).max(1e-9);
    let scale = 460.0 / (map.width.max(map.height)) as f64;
    let (width, height) = (map.width as f64 * scale, map.height as f64 * scale);
    let side = mosaic.width.max(mosaic.height).div_ceil(map.width.max(map.height) as u64) as f64;
    out.push_str("<h2>Where</h2><div class=\"pair\">");
    for (title, values) in [("Before", &map.before), ("After", &map.after)] {
        let _ = write!(out, "<figure><figcaption>{title}</figcaption><svg viewBox=\"0 0 {width:.1} {height:.1}\">");
        out.push_str("<path d=\"M0 0H9999V9999H0z\" fill=\"#f4f4f4\"/>");
        for (at, value) in values.iter().enumerate().filter(|(_, v)| v.is_finite()) {
            let t = (value / top).min(1.0);
            let _ = write!(
                out,
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"rgb({:.0},{:.0},{:.0})\">\
                 <title>{value:.2}</title></rect>",
                (at % map.width) as f64 * scale,
                (at / map.width) as f64 * scale,
                scale + 0.1,
                scale + 0.1,
                240.0 - 62.0 * t,
                238.0 - 214.0 * t,
                230.0 - 187.0 * t
            );
        }
        for (path, grid) in sources.iter().take(2000) {
            let place = |v: f64, from: f64, step: f64| (v - from) / step / side * scale;
            let [west, south, east, north] = grid.bounds();
            let (x, y) = (place(west, mosaic.x0, mosaic.step_x), place(north, mosaic.y0, mosaic.step_y));
            let (x1, y1) = (place(east, mosaic.x0, mosaic.step_x), place(south, mosaic.y0, mosaic.step_y));
            let _ = write!(
                out,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"#357\" \
                 pointer-events=\"stroke\"><title>{}</title></rect>",
                x1 - x,
                y1 - y,
                name(path)
            );
        }
        out.push_str("</svg></figure>");
    }
    let _ = write!(
        out,
        "</div><p>Mean size of the differences from 0 (pale) to {top:.2} and more (red), all bands; lines are the sources' \
         outlines, grey is without an overlap.</p>"
    );
}

fn bars(out: &mut String, worst: &[&Overlap]) {
    let shown = &worst[..worst.len().min(MOST_BARS)];
    let top = shown.iter().map(|o| o.rms_before.max(o.rms_after)).fold(1e-9, f64::max);
    let x = |value: f64| 150.0 + 780.0 * value / top;
    let _ = write!(
        out,
        "<h2>How much</h2><p><span class=\"dot\" style=\"background:#b2182b\"></span> before, \
         <span class=\"dot\" style=\"background:#2166ac\"></span> after: root mean square of each overlap and band{}.</p>\
         <svg viewBox=\"0 0 960 {}\" font-size=\"12\">",
        if shown.len() < worst.len() { format!(", the {MOST_BARS} largest of {}", worst.len()) } else { String::new() },
        18 * shown.len() + 24
    );
    for (row, o) in shown.iter().enumerate() {
        let y = 18 * row + 10;
        let _ = write!(
            out,
            "<text x=\"140\" y=\"{}\" text-anchor=\"end\">{} and {}, band {}</text><path d=\"M{:.1} {y}H{:.1}\" \
             stroke=\"#bbb\" stroke-width=\"2\"/><circle cx=\"{:.1}\" cy=\"{y}\" r=\"4.5\" fill=\"#b2182b\"/>\
             <circle cx=\"{:.1}\" cy=\"{y}\" r=\"4.5\" fill=\"#2166ac\"/>",
            y + 4,
            o.first,
            o.second,
            o.band,
            x(o.rms_before),
            x(o.rms_after),
            x(o.rms_before),
            x(o.rms_after)
        );
    }
    let y = 18 * shown.len() + 18;
    let _ = write!(
        out,
        "<text x=\"150\" y=\"{y}\">0</text><text x=\"930\" y=\"{y}\" text-anchor=\"end\">{top:.2}</text></svg>"
    );
}

fn overlap_table(out: &mut String, sources: &[(&Path, Grid)], worst: &[&Overlap]) {
    out.push_str(
        "<h2>Overlaps</h2><div class=\"wide\"><table><tr><th class=\"t\">first<th class=\"t\">second<th>band<th>blocks\
         <th>mean before<th>after<th>RMS before<th>after</tr>",
    );
    for o in worst.iter().take(MOST_ROWS) {
        let _ = write!(
            out,
            "<tr><td class=\"t\">{} {}<td class=\"t\">{} {}<td>{}<td>{}<td>{:.3}<td>{:.3}<td>{:.3}<td>{:.3}</tr>",
            o.first,
            name(sources[o.first - 1].0),
            o.second,
            name(sources[o.second - 1].0),
            o.band,
            o.blocks,
            o.mean_before,
            o.mean_after,
            o.rms_before,
            o.rms_after
        );
    }
    out.push_str("</table></div>");
    if worst.len() > MOST_ROWS {
        let _ = write!(out, "<p>The {MOST_ROWS} largest of {}; all are in the JSON.</p>", worst.len());
    }
}

fn source_table(out: &mut String, sources: &[(&Path, Grid)], balance: &Balance) {
    out.push_str(
        "<h2>Corrections</h2><p>Balanced = gain · value + offset + a·u + b·v + c·(u² − ⅓) + d·u·v + e·(v² − ⅓); u runs \
         eastwards and v southwards over the source, from −1 to 1.</p><div class=\"wide\"><table><tr><th>source\
         <th class=\"t\">file<th>band<th>gain<th>offset<th>a<th>b<th>c<th>d<th>e</tr>",
    );
    for (number, (path, _)) in sources.iter().enumerate().take(MOST_ROWS) {
        for (band, gain) in balance.gains[number].iter().enumerate() {
            let _ = write!(
                out,
                "<tr><td>{}<td class=\"t\">{}<td>{}<td>{gain:.5}<td>{:.3}",
                number + 1,
                name(path),
                band + 1,
                balance.offsets[number][band]
            );
            for value in balance.surfaces[number][band] {
                let _ = write!(out, "<td>{value:.3}");
            }
            out.push_str("</tr>");
        }
    }
    out.push_str("</table></div>");
}
