//! Two topological point patterns on each other, as SVG.

use std::fmt::Write;

use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::Gcp;
use autoref_stream::matching::tpp::{Overlay, Seen};

use autoref_raster::markup::escaped;

const SIDE: f64 = 720.0;
/// Room for the caption above and the key below.
const MARGIN: f64 = 60.0;
const CANDIDATE: &str = "#0072b2";
const GCP: &str = "#d55e00";

/// Circles are candidates, crosses GCPs; a line joins what was matched and stands out. The anchors lie in the middle,
/// their nearest neighbours at 1 on the right. Candidates beyond the farthest GCP are left out and counted.
pub fn draw(overlay: &Overlay, candidates: &[Candidate], gcps: &[Gcp]) -> String {
    let farthest = |seen: &[Seen]| seen.iter().map(|s| s.radius).fold(1.0, f64::max);
    let reach = 1.05 * farthest(&overlay.gcps);
    let scale = SIDE / 2.0 / reach;
    let at = |seen: &Seen| {
        let [x, y] = seen.place();
        (MARGIN + SIDE / 2.0 + scale * x, MARGIN + SIDE / 2.0 - scale * y)
    };
    let (whole, tall) = (SIDE + 2.0 * MARGIN, SIDE + 2.0 * MARGIN + 20.0);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {whole} {tall}\" width=\"{whole}\" height=\"{tall}\" \
         font-family=\"sans-serif\" font-size=\"13\"><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>"
    );
    let name = |gcp: usize| escaped(&gcps[gcp].name);
    let anchor = candidates[overlay.anchors.0].centre;
    let mut put = |text: String| write!(out, "{text}").expect("a string takes all writes");
    put(format!(
        "<text x=\"{MARGIN}\" y=\"28\" font-size=\"16\">Candidate {} at ({:.1}, {:.1}) and {} as anchors: {} other points agree</text>",
        overlay.anchors.0,
        anchor.x,
        anchor.y,
        name(overlay.anchors.1),
        overlay.pairs.len()
    ));
    let middle = MARGIN + SIDE / 2.0;
    put(format!(
        "<path d=\"M{MARGIN} {middle}H{}M{middle} {MARGIN}V{}\" stroke=\"#ccc\"/>\
         <circle cx=\"{middle}\" cy=\"{middle}\" r=\"{scale:.2}\" fill=\"none\" stroke=\"#ccc\"/>",
        MARGIN + SIDE,
        MARGIN + SIDE
    ));
    let (mut drawn, mut beyond) = (0, 0);
    for (number, seen) in overlay.image.iter().enumerate() {
        if seen.radius > reach {
            beyond += 1;
            continue;
        }
        drawn += 1;
        let (x, y) = at(seen);
        let opacity = if overlay.pairs.iter().any(|p| p.0 == number) { 1.0 } else { 0.35 };
        put(format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"none\" stroke=\"{CANDIDATE}\" stroke-width=\"2\" opacity=\"{opacity}\"/>"
        ));
    }
    for (number, seen) in overlay.gcps.iter().enumerate() {
        let (x, y) = at(seen);
        let pair = overlay.pairs.iter().find(|p| p.1 == number);
        let opacity = if pair.is_some() { 1.0 } else { 0.45 };
        if let Some((image, _)) = pair {
            let (to_x, to_y) = at(&overlay.image[*image]);
            put(format!("<path d=\"M{x:.1} {y:.1}L{to_x:.1} {to_y:.1}\" stroke=\"#000\"/>"));
        }
        put(format!(
            "<path d=\"M{:.1} {y:.1}h10M{x:.1} {:.1}v10\" stroke=\"{GCP}\" stroke-width=\"2\" opacity=\"{opacity}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" opacity=\"{opacity}\">{}</text>",
            x - 5.0,
            y - 5.0,
            x + 7.0,
            y - 7.0,
            name(seen.index)
        ));
    }
    let (first, second) = (MARGIN + SIDE + 32.0, MARGIN + SIDE + 56.0);
    put(format!(
        "<circle cx=\"{MARGIN}\" cy=\"{}\" r=\"5\" fill=\"none\" stroke=\"{CANDIDATE}\" stroke-width=\"2\"/>\
         <text x=\"{}\" y=\"{first}\">candidates ({drawn}; {beyond} lie farther out); pale: not matched</text>\
         <path d=\"M{} {}h10m-5 -5v10\" stroke=\"{GCP}\" stroke-width=\"2\"/>\
         <text x=\"{}\" y=\"{second}\">GCPs ({})</text>\
         <text x=\"{}\" y=\"{second}\">grey circle: distance 1, to the nearest neighbour</text></svg>",
        first - 5.0,
        MARGIN + 12.0,
        MARGIN - 5.0,
        second - 5.0,
        MARGIN + 12.0,
        overlay.gcps.len(),
        MARGIN + 120.0
    ));
    out
}
