//! The colours of a lesson on one page: the tables 4.2 and 4.3 and the figures 4.4 and 4.5 of the 2016 thesis, for any
//! sample.

use std::fmt::Write;

use autoref_stream::learn::{ColourStatistics, Lesson, SampleStatistics};
use autoref_stream::profile::colour::lab_from_srgb;

use autoref_raster::markup::{escaped, page_head};

/// Dots of a scatter plot; of larger samples every n-th is drawn.
const MOST_DOTS: usize = 1_500;
const BARS: usize = 40;
/// Side of one plot and the gap to the next.
const SIDE: f64 = 190.0;
const GAP: f64 = 34.0;

const STYLE: &str = "body{font:15px/1.45 sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}\
    table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}\
    td:first-child,th:first-child{text-align:left}.wide{overflow-x:auto}svg{max-width:100%;height:auto}\
    .swatch{display:inline-block;width:3em;height:1.2em;vertical-align:middle;border:1px solid #999}\
    text{font:11px sans-serif;fill:#444}rect.frame{fill:none;stroke:#bbb}@media print{section{break-inside:avoid}}";

/// A page that needs no network.
pub fn page(lesson: &Lesson, statistics: Option<&SampleStatistics>) -> String {
    let name = &lesson.profile.name;
    let mut out = page_head(&format!("Colours of {name}"), STYLE);
    let _ = write!(
        out,
        "<h1>Colours of the profile {}</h1><p>{}.</p>",
        escaped(name),
        escaped(&lesson.profile.description)
    );
    let Some(statistics) = statistics else {
        out.push_str("<p>Too few colours for statistics.</p></html>");
        return out;
    };
    let rgb = statistics.rgb.mean.map(|v| (255.0 * v).round());
    let _ = write!(
        out,
        "<p>{} colours, mean <span class=\"swatch\" style=\"background:rgb({},{},{})\"></span> {} {} {}. A pixel is paint \
         within {:.2} standard deviations (Mahalanobis distance in L*a*b*).</p>",
        statistics.samples, rgb[0], rgb[1], rgb[2], rgb[0], rgb[1], rgb[2], lesson.profile.colour.limit
    );
    let _ = write!(
        out,
        "<p>The covariance here is that of the sample, divided by n − 1. That of the profile has 4² of L* and 2.5² of a* and \
         b* more, since the next mark lies in other light.</p>"
    );
    let lab: Vec<[f64; 3]> = lesson.paint.iter().map(|c| lab_from_srgb(*c).into()).collect();
    for space in [
        ColourSpace {
            title: "RGB (sRGB, 0 to 1)",
            channels: ["Red", "Green", "Blue"],
            statistics: &statistics.rgb,
            values: &lesson.paint,
        },
        ColourSpace { title: "L*a*b* (D65)", channels: ["L*", "a*", "b*"], statistics: &statistics.lab, values: &lab },
    ] {
        let _ = write!(out, "<section><h2>{}</h2>", space.title);
        space.table(&mut out);
        space.plots(&mut out, &lesson.paint);
        out.push_str("</section>");
    }
    out.push_str("</html>\n");
    out
}

/// The sample in one space.
struct ColourSpace<'a> {
    title: &'a str,
    channels: [&'a str; 3],
    statistics: &'a ColourStatistics,
    values: &'a [[f64; 3]],
}

impl ColourSpace<'_> {
    fn table(&self, out: &mut String) {
        let (channels, s) = (self.channels, self.statistics);
        let _ = write!(out, "<div class=\"wide\"><table><tr><th></th>");
        for channel in channels {
            let _ = write!(out, "<th>{channel}</th>");
        }
        out.push_str("</tr>");
        let mut row = |label: &str, cells: [String; 3]| {
            let cells = cells.map(|cell| format!("<td>{cell}</td>")).concat();
            let _ = write!(out, "<tr><td>{label}</td>{cells}</tr>");
        };
        let four = |v: [f64; 3]| v.map(|v| format!("{v:.4}"));
        row("Mean", four(s.mean));
        row("Smallest", four(s.minimum));
        row("Largest", four(s.maximum));
        for (channel, line) in channels.iter().zip(s.covariance) {
            row(&format!("Covariance with {channel}"), four(line));
        }
        for (channel, line) in channels.iter().zip(s.correlation) {
            let cells = line.map(|v| v.map_or("–".to_string(), |v| format!("{v:.4}")));
            row(&format!("Correlation with {channel}"), cells);
        }
        out.push_str("</table></div>");
    }

    /// Histograms on the diagonal, each pair of channels beside it.
    /// `srgb` are the colours of the values.
    fn plots(&self, out: &mut String, srgb: &[[f64; 3]]) {
        let ColourSpace { title, channels, statistics: s, values } = self;
        let whole = 3.0 * (SIDE + GAP) + GAP;
        let _ = write!(
            out,
            "<svg viewBox=\"0 0 {whole} {whole}\" width=\"{whole}\" role=\"img\" aria-label=\"Histograms and scatter plots of {title}\">"
        );
        let spread = |c: usize| (s.maximum[c] - s.minimum[c]).max(1e-9);
        let along = |c: usize, v: f64| SIDE * (v - s.minimum[c]) / spread(c);
        let step = values.len().div_ceil(MOST_DOTS);
        for row in 0..3 {
            for column in 0..3 {
                let (left, top) = (GAP + column as f64 * (SIDE + GAP), GAP / 2.0 + row as f64 * (SIDE + GAP));
                let _ = write!(out, "<g transform=\"translate({left:.0} {top:.0})\">");
                let _ = write!(out, "<rect class=\"frame\" width=\"{SIDE}\" height=\"{SIDE}\"/>");
                if row == column {
                    histogram(out, row, s, values);
                } else {
                    for (value, colour) in values.iter().zip(srgb).step_by(step) {
                        let [r, g, b] = colour.map(|v| (255.0 * v).round());
                        let (x, y) = (along(column, value[column]), SIDE - along(row, value[row]));
                        let _ = write!(
                            out,
                            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2\" fill=\"rgb({r},{g},{b})\" stroke=\"#555\" stroke-width=\".3\"/>"
                        );
                    }
                }
                let _ = write!(
                    out,
                    "<text x=\"0\" y=\"{y}\">{:.3}</text><text x=\"{SIDE}\" y=\"{y}\" text-anchor=\"end\">{:.3}</text>\
                 <text x=\"{}\" y=\"{y}\" text-anchor=\"middle\">{}</text>",
                    s.minimum[column],
                    s.maximum[column],
                    SIDE / 2.0,
                    channels[column],
                    y = SIDE + 13.0
                );
                let _ = write!(
                    out,
                    "<text transform=\"translate(-5 {}) rotate(-90)\" text-anchor=\"middle\">{}</text></g>",
                    SIDE / 2.0,
                    if row == column { "count" } else { channels[row] }
                );
            }
        }
        out.push_str("</svg>");
    }
}

fn histogram(out: &mut String, channel: usize, s: &ColourStatistics, values: &[[f64; 3]]) {
    let mut counts = [0u64; BARS];
    let spread = (s.maximum[channel] - s.minimum[channel]).max(1e-9);
    for value in values {
        let place = (value[channel] - s.minimum[channel]) / spread * BARS as f64;
        counts[(place as usize).min(BARS - 1)] += 1;
    }
    let most = counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    let width = SIDE / BARS as f64;
    for (i, count) in counts.iter().enumerate() {
        let height = (SIDE - 14.0) * *count as f64 / most;
        let (x, y) = (i as f64 * width, SIDE - height);
        let _ = write!(
            out,
            "<rect x=\"{x:.2}\" y=\"{y:.1}\" width=\"{width:.2}\" height=\"{height:.1}\" fill=\"#5b7fa6\"/>"
        );
    }
    let _ = write!(out, "<text x=\"4\" y=\"12\">{most} at most</text>");
}
