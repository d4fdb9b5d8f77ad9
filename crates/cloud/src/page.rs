//! The page that shows what the steps took: plain HTML with drawings in it, no scripts, nothing fetched.

use std::fmt::Write;

use crate::clean::CleanReport;

const COLOURS: [&str; 8] = ["#c0392b", "#d68910", "#7d3c98", "#1f618d", "#117a65", "#7e5109", "#a93226", "#2e4053"];

/// The page of one cloud.
pub fn page(report: &CleanReport) -> String {
    let mut out = String::from(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Cleaned cloud</title><style>\
         body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:60rem;padding:0 1rem;color:#222}\
         table{border-collapse:collapse}td,th{padding:.25rem .7rem;border-bottom:1px solid #ccc;text-align:right}\
         td:first-child,th:first-child{text-align:left}svg{background:#f6f6f4;display:block;margin:.5rem 0 1.5rem}</style>",
    );
    let summary = &report.summary;
    let _ = write!(
        out,
        "<h1>{}</h1><p>{}: {} points, {} kept in {}.</p>",
        escape(&report.input.display().to_string()),
        escape(&report.format),
        report.points,
        report.points_kept,
        escape(&report.output.display().to_string())
    );
    out += "<table><tr><th>step</th><th>points in</th><th>classified</th><th>%</th><th>dropped</th><th>s</th></tr>";
    for (index, step) in report.steps.iter().enumerate() {
        let share = 100.0 * step.classified as f64 / step.points_in.max(1) as f64;
        let _ = write!(
            out,
            "<tr><td><span style=\"color:{}\">■</span> {}</td><td>{}</td><td>{}</td><td>{share:.2}</td><td>{}</td><td>{:.2}</td></tr>",
            COLOURS[index % COLOURS.len()],
            escape(&step.step),
            step.points_in,
            step.classified,
            step.dropped,
            step.seconds
        );
    }
    out += "</table>";
    let _ = write!(
        out,
        "<h2>Heights</h2><p>{:.2} to {:.2} m; grey all points, coloured what a step took. Bars grow with the logarithm.</p>",
        summary.height_min_m, summary.height_max_m
    );
    histogram(&mut out, report);
    out += "<h2>Map</h2><p>North is up. Grey: points; coloured: the step that took most of a cell's classified points, the \
            fuller the larger their share.</p>";
    map(&mut out, report);
    out += "</html>\n";
    out
}

fn histogram(out: &mut String, report: &CleanReport) {
    let summary = &report.summary;
    let (width, height) = (720.0, 160.0);
    let tall = |count: u64| (count as f64).ln_1p();
    let most = tall(summary.heights.iter().copied().max().unwrap_or(1).max(1));
    let step = width / summary.heights.len() as f64;
    let _ = write!(out, "<svg width=\"{width}\" height=\"{height}\" role=\"img\" aria-label=\"Histogram of heights\">");
    let mut bars = |counts: &[u64], colour: &str, share: f64| {
        for (bin, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let bar = tall(count) / most * (height - 4.0);
            let _ = write!(
                out,
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{bar:.1}\" fill=\"{colour}\"/>",
                bin as f64 * step,
                height - bar,
                step * share
            );
        }
    };
    bars(&summary.heights, "#bbb", 0.95);
    for (index, counts) in summary.heights_by_step.iter().enumerate() {
        bars(counts, COLOURS[index % COLOURS.len()], 0.9 - 0.1 * index.min(7) as f64);
    }
    *out += "</svg>";
}

fn map(out: &mut String, report: &CleanReport) {
    let summary = &report.summary;
    let cell = 6;
    let (width, height) = (summary.map_columns * cell, summary.map_rows * cell);
    let _ =
        write!(out, "<svg width=\"{width}\" height=\"{height}\" role=\"img\" aria-label=\"Map of what was taken\">");
    for (place, &count) in summary.map.iter().enumerate().filter(|(_, count)| **count > 0) {
        let (x, y) = (place % summary.map_columns * cell, place / summary.map_columns * cell);
        let taken: u64 = summary.map_by_step.iter().map(|step| step[place]).sum();
        let (colour, opacity) = match summary.map_by_step.iter().enumerate().max_by_key(|(_, step)| step[place]) {
            Some((index, step)) if step[place] > 0 => {
                (COLOURS[index % COLOURS.len()], 0.25 + 0.75 * taken as f64 / count as f64)
            }
            _ => ("#ccc", 1.0),
        };
        let _ = write!(
            out,
            "<rect x=\"{x}\" y=\"{y}\" width=\"{cell}\" height=\"{cell}\" fill=\"{colour}\" fill-opacity=\"{opacity:.2}\"/>"
        );
    }
    *out += "</svg>";
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
