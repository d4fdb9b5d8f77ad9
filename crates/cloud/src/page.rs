//! The page that shows what the steps took: plain HTML with drawings in it, no scripts, nothing fetched.

use autoref_raster::markup::{escaped, page_head};
use std::fmt::Write;

use crate::clean::{CleanReport, StepReport};
use crate::summary::Summary;

const COLOURS: [&str; 8] = ["#c0392b", "#d68910", "#7d3c98", "#1f618d", "#117a65", "#7e5109", "#a93226", "#2e4053"];
/// Shares of a cell's points from which on a class of the map begins, its opacity, and its name.
const SHARES: [(f64, f64, &str); 5] = [
    (0.0, 0.18, "up to 0.1 %"),
    (0.001, 0.35, "0.1 to 1 %"),
    (0.01, 0.55, "1 to 10 %"),
    (0.1, 0.78, "10 to 50 %"),
    (0.5, 1.0, "more than half"),
];
const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:64rem;padding:0 1rem;color:#222}\
    table{border-collapse:collapse;display:block;overflow-x:auto}td,th{padding:.25rem .7rem;border-bottom:1px solid #ccc;text-align:right;\
    font-variant-numeric:tabular-nums}td:first-child,th:first-child{text-align:left}h2{margin-top:2rem}\
    .pair{display:flex;flex-wrap:wrap;gap:1.5rem;align-items:flex-start}svg text{font-size:11px;fill:#333}\
    figure{margin:0}figcaption{font-size:13px;color:#555;max-width:26rem}";

/// The page of one cloud.
pub fn page(report: &CleanReport) -> String {
    let mut out = page_head("Cleaned cloud", STYLE);
    let summary = &report.summary;
    let _ = write!(
        out,
        "<h1>{}</h1><p>{}: {} points, {} kept in {}.</p>",
        escaped(&report.input.display().to_string()),
        escaped(&report.format),
        grouped(report.points),
        grouped(report.points_kept),
        escaped(&report.output.display().to_string())
    );
    let _ = write!(
        out,
        "<p>East {:.0} to {:.0}, north {:.0} to {:.0}, heights {:.2} to {:.2} {}{}.</p>",
        summary.min[0],
        summary.max[0],
        summary.min[1],
        summary.max[1],
        summary.height_min_m,
        summary.height_max_m,
        escaped(&report.unit),
        report.crs.as_deref().and_then(crs_name).map(|name| format!("; {}", escaped(name))).unwrap_or_default()
    );
    for note in &report.notes {
        let _ = write!(out, "<p>{}.</p>", escaped(note));
    }
    out +=
        "<table><tr><th>step</th><th>points in</th><th>classified</th><th>share</th><th>dropped</th><th>time</th></tr>";
    for (index, step) in report.steps.iter().enumerate() {
        let _ = write!(
            out,
            "<tr><td>{} {}</td><td>{}</td><td>{}</td><td>{:.2} %</td><td>{}</td><td>{:.1} s</td></tr>",
            square(index),
            escaped(&step.step),
            grouped(step.points_in),
            grouped(step.classified),
            100.0 * step.classified as f64 / step.points_in.max(1) as f64,
            grouped(step.dropped),
            step.seconds
        );
    }
    out += "</table>";
    for (index, step) in report.steps.iter().enumerate() {
        section(&mut out, summary, index, (step, &escaped(&report.unit)));
    }
    out += "</html>\n";
    out
}

/// One step: what it found, at which heights, and where.
fn section(out: &mut String, summary: &Summary, index: usize, (step, unit): (&StepReport, &str)) {
    let _ = write!(out, "<h2>{} {}</h2>", square(index), escaped(&step.step));
    if step.classified == 0 {
        *out += "<p>It took no point.</p>";
        return;
    }
    let what = if step.ground.is_some() { "not ground" } else { "noise" };
    let _ = write!(out, "<p>{} of {} points are {what}.", grouped(step.classified), grouped(step.points_in));
    if let Some(found) = &step.statistics {
        let _ = write!(
            out,
            " The mean distance to the neighbours is {:.3} {unit} on average, with a standard deviation of {:.3} {unit}; \
             from {:.3} {unit} on a point is noise.",
            found.mean_m, found.standard_deviation_m, found.threshold_m
        );
    }
    if let Some(range) = step.greatest_range_m {
        let _ = write!(out, " Points farther than {range:.0} {unit} from the camera were taken.");
    }
    *out += "</p><div class=\"pair\">";
    histogram(out, summary, index, unit);
    map(out, summary, index, unit);
    *out += "</div>";
}

fn histogram(out: &mut String, summary: &Summary, index: usize, name: &str) {
    let (left, width, height) = (44.0, 420.0, 220.0);
    let most = summary.heights.iter().copied().max().unwrap_or(1).max(10);
    let decades = (most as f64).log10().ceil();
    // One point has a bar, too.
    let tall = |count: u64| ((count as f64).log10() + 0.15) / (decades + 0.15) * height;
    let step = width / summary.heights.len() as f64;
    let _ = write!(
        out,
        "<figure><svg width=\"{}\" height=\"{}\" role=\"img\" aria-label=\"Histogram of heights\">",
        left + width + 30.0,
        height + 40.0
    );
    for decade in 0..=decades as u32 {
        let y = 10.0 + height - tall(10u64.pow(decade));
        let _ = write!(
            out,
            "<path d=\"M{left} {y:.1}h{width}\" stroke=\"#e3e3e0\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left - 5.0,
            y + 4.0,
            short(10u64.pow(decade))
        );
    }
    let mut bars = |counts: &[u64], colour: &str, inset: f64| {
        let _ = write!(out, "<path fill=\"{colour}\" d=\"");
        for (bin, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let x = left + bin as f64 * step + inset * step;
            let _ = write!(
                out,
                "M{x:.1} {}v-{:.1}h{:.1}v{:.1}z",
                10.0 + height,
                tall(count),
                step * (1.0 - 2.0 * inset),
                tall(count)
            );
        }
        *out += "\"/>";
    };
    bars(&summary.heights, "#c9c9c6", 0.02);
    bars(&summary.heights_by_step[index], COLOURS[index % COLOURS.len()], 0.2);
    let range = summary.height_max_m - summary.height_min_m;
    let unit = round_below(range / 4.0);
    let mut at = (summary.height_min_m / unit).ceil() * unit;
    while range > 0.0 && at <= summary.height_max_m {
        let x = left + (at - summary.height_min_m) / range * width;
        let _ = write!(
            out,
            "<path d=\"M{x:.1} {}v5\" stroke=\"#333\"/><text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{} {name}</text>",
            10.0 + height,
            height + 28.0,
            (at * 1000.0).round() / 1000.0
        );
        at += unit;
    }
    *out += "</svg><figcaption>Points by height, on a logarithmic scale: grey all, coloured what this step took.</figcaption></figure>";
}

fn map(out: &mut String, summary: &Summary, index: usize, unit: &str) {
    let cell = 4;
    let (width, height) = (summary.map_columns * cell, summary.map_rows * cell);
    let _ = write!(
        out,
        "<figure><svg width=\"{}\" height=\"{}\" role=\"img\" aria-label=\"Map of what was taken\">",
        width.max(120),
        height + 30
    );
    let taken = &summary.map_by_step[index];
    // From nothing taken up, one shape for each class.
    let mut shapes = vec![String::new(); SHARES.len() + 1];
    for (place, &count) in summary.map.iter().enumerate().filter(|(_, count)| **count > 0) {
        let share = taken[place] as f64 / count as f64;
        let class = if taken[place] == 0 { 0 } else { SHARES.iter().filter(|(from, ..)| share >= *from).count() };
        let (x, y) = (place % summary.map_columns * cell, place / summary.map_columns * cell);
        let _ = write!(shapes[class], "M{x} {y}h{cell}v{cell}h-{cell}z");
    }
    for (class, shape) in shapes.iter().enumerate().filter(|(_, shape)| !shape.is_empty()) {
        let (colour, opacity) = match class.checked_sub(1) {
            Some(class) => (COLOURS[index % COLOURS.len()], SHARES[class].1),
            None => ("#e4e4e1", 1.0),
        };
        let _ = write!(out, "<path fill=\"{colour}\" fill-opacity=\"{opacity}\" d=\"{shape}\"/>");
    }
    let units_per_px =
        (summary.max[0] - summary.min[0]).max(summary.max[1] - summary.min[1]) / width.max(height) as f64;
    if units_per_px > 0.0 {
        let length = round_below(units_per_px * width as f64 / 3.0);
        let _ = write!(
            out,
            "<path d=\"M1 {0}v6h{1:.1}v-6\" fill=\"none\" stroke=\"#333\"/><text x=\"{2:.1}\" y=\"{3}\">{4} {unit}</text>",
            height + 8,
            length / units_per_px,
            length / units_per_px + 8.0,
            height + 16,
            length
        );
    }
    *out += "</svg><figcaption>North is up. Share of a cell's points that this step took: <span style=\"color:#bbb\">■</span> none";
    for (_, opacity, name) in SHARES {
        let _ =
            write!(out, ", <span style=\"color:{};opacity:{opacity}\">■</span> {name}", COLOURS[index % COLOURS.len()]);
    }
    *out += ".</figcaption></figure>";
}

fn square(index: usize) -> String {
    format!("<span style=\"color:{}\">■</span>", COLOURS[index % COLOURS.len()])
}

/// The name in a reference system's WKT.
fn crs_name(wkt: &str) -> Option<&str> {
    wkt.split('"').nth(1)
}

/// 1, 2 or 5 times a power of ten, at most `length`.
fn round_below(length: f64) -> f64 {
    if length.is_nan() || length <= 0.0 {
        return 1.0;
    }
    let power = 10f64.powf(length.log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|times| times * power).find(|round| *round <= length).unwrap_or(power)
}

/// Digits in groups of three.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut out = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

/// A power of ten in few letters.
fn short(number: u64) -> String {
    match number {
        1_000_000.. => format!("{} M", number / 1_000_000),
        1000.. => format!("{} k", number / 1000),
        _ => number.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_can_be_read() {
        assert_eq!([7, 999, 1000, 96_215_411].map(grouped), ["7", "999", "1\u{202f}000", "96\u{202f}215\u{202f}411"]);
        assert_eq!([0.7, 3.0, 49.0, 5000.0].map(round_below), [0.5, 2.0, 20.0, 5000.0]);
        assert_eq!([1, 100, 10_000, 1_000_000].map(short), ["1", "100", "10 k", "1 M"]);
        assert_eq!(crs_name("PROJCRS[\"WGS 84 / UTM zone 33N\",BASE"), Some("WGS 84 / UTM zone 33N"));
    }
}
