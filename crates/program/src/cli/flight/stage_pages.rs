//! The pages of a flight's stages: plain HTML with drawings in it, no scripts, nothing fetched but the frames' small
//! pictures beside it.

use std::fmt::Write;

use autoref_flight::adjust::Role;
use autoref_raster::markup::{escaped, page_head};

use super::page::{CHECK, CONTROL, STYLE, both, camera_mark, cells, fixed, known};
use super::stage_documents::{
    FocalLength, FramePlace, GcpStage, InteriorStage, PairsStage, RelativeStage, TiedFrame, TiesStage,
};
use super::ties::Ties;

/// Fewer ties than these make a frame or a pair worth a look.
const FEW_TIES: usize = 30;
/// Less of a frame with ties than this, likewise.
const LITTLE_COVERED: f64 = 0.25;
/// Most ties that are drawn in a frame.
const MOST_DOTS: usize = 400;
const DOT: &str = "#f1c40f";

/// The frames' small pictures.
#[derive(Clone, Copy, Debug)]
pub struct Pictures {
    size_px: [f64; 2],
    /// Pixels of a picture per pixel of the frame.
    scale: f64,
}

impl Pictures {
    pub fn of(frame_px: [f64; 2], longest_px: usize) -> Self {
        let scale = (longest_px as f64 / frame_px[0].max(frame_px[1]).max(1.0)).min(1.0);
        Pictures { size_px: frame_px.map(|s| (s * scale).round().max(1.0)), scale }
    }
}

const FIGURES: &str = ".frames{display:flex;flex-wrap:wrap;gap:.8rem}figure{margin:0}figcaption{font-size:12px}";

/// A page around what a stage shows.
pub fn whole(title: &str, stage: &str, before: Option<&str>, body: &str) -> String {
    let back = before.map_or(String::new(), |before| format!("<a href=\"{before}.html\">← {before}</a> · "));
    let style = format!("{STYLE}{FIGURES}");
    format!(
        "{}<p>{back}<a href=\"index.html\">all stages</a></p><h1>{}: {stage}</h1>{body}\
         <p><a href=\"{stage}.json\">{stage}.json</a></p></html>\n",
        page_head(&format!("{title}: {stage}"), &style),
        escaped(title)
    )
}

/// The page that leads to the others.
pub fn contents(title: &str, rows: &str) -> String {
    format!(
        "{}<h1>{}: stages</h1><table>{rows}</table></html>\n",
        page_head(&format!("{title}: stages"), &format!("{STYLE}td{{text-align:left}}")),
        escaped(title)
    )
}

/// A frame's small picture with something drawn over it.
fn frame(out: &mut String, of: &str, pictures: &Pictures, over: &str, caption: &str) {
    let [width, height] = pictures.size_px;
    let _ = write!(
        out,
        "<figure><svg viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" role=\"img\" \
         aria-label=\"{0}\"><image href=\"frames/{1}.png\" width=\"{width:.0}\" height=\"{height:.0}\"/>{over}</svg>\
         <figcaption>{0}: {caption}</figcaption></figure>",
        escaped(of),
        address(of)
    );
}

/// A file's name in a link.
fn address(name: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.~".contains(&b);
    name.bytes().map(|b| if plain(b) { (b as char).to_string() } else { format!("%{b:02X}") }).collect()
}

fn warning(out: &mut String, text: &str) {
    let _ = write!(out, "<p class=\"bad\">{}</p>", escaped(text));
}

pub fn interior(found: &InteriorStage, pictures: &Pictures) -> String {
    let mut out = String::new();
    for note in &found.left_out {
        warning(&mut out, note);
    }
    let focal = match found.focal {
        FocalLength::Held => "known, held in the relative orientation",
        FocalLength::Rough => "a start, free in the relative orientation",
        FocalLength::Sought => "not known: sought by COLMAP",
    };
    let _ = write!(
        out,
        "<p>{}.</p><table><tr><td>frames</td><td>{} px</td></tr><tr><td>focal length</td><td>{} px ({focal})</td></tr>\
         <tr><td>principal point</td><td>{} px</td></tr><tr><td>field of view</td><td>{}°</td></tr></table>",
        found.line().words(),
        found.size_px.map(|v| fixed(v, 0)).join(" × "),
        fixed(found.f_px, 2),
        found.pp_px.map(|v| fixed(v, 2)).join(", "),
        found.field_of_view_deg.map(|v| fixed(v, 1)).join("° × "),
    );
    let at = found.pp_px.map(|v| v * pictures.scale);
    let cross = format!(
        "<path d=\"M{:.1} {:.1}h12M{:.1} {:.1}v12\" stroke=\"{CHECK}\" stroke-width=\"1.5\"/>",
        at[0] - 6.0,
        at[1],
        at[0],
        at[1] - 6.0
    );
    out += "<h2>Frames</h2><p>In the order of the flight; the cross is the principal point.</p><div class=\"frames\">";
    for f in &found.frames {
        let masks = if f.masks.is_empty() { "no mask".into() } else { escaped(&f.masks.join(", ")) };
        frame(&mut out, &f.name, pictures, &cross, &masks);
    }
    out + "</div>"
}

/// Width of the map of pairs.
const MAP_PX: f64 = 900.0;

pub fn pairs(found: &PairsStage) -> String {
    let mut out = format!("<p>{}.</p>", found.line().words());
    map_of_pairs(&mut out, found);
    out += "<h2>Flight lines</h2><table><tr><th>line</th><th>frames</th><th>first</th><th>last</th></tr>";
    for l in &found.lines {
        let of = |name: Option<&String>| name.map_or(String::new(), |name| escaped(name));
        let _ = write!(out, "<tr><td>{}</td><td>{}</td>", escaped(&l.name), l.frames.len());
        let _ = write!(out, "<td>{}</td><td>{}</td></tr>", of(l.frames.first()), of(l.frames.last()));
    }
    out += "</table><h2>Pairs</h2><table><tr><th>frames</th><th>line</th><th>ground of one in the other</th></tr>";
    for p in &found.pairs {
        let along = if p.along_line { "the same" } else { "two" };
        let shared = p.shared.filter(|s| s.is_finite()).map_or("–".into(), |s| format!("{:.0} %", 100.0 * s));
        let _ = write!(out, "<tr><td>{}</td><td>{along}</td><td>{shared}</td></tr>", both(&p.frames));
    }
    out + "</table>"
}

/// Where the frames are thought to stand, and the pairs.
fn map_of_pairs(out: &mut String, found: &PairsStage) {
    let place = |f: &FramePlace| f.place_m.and_then(known);
    let frames = &found.frames;
    let places: Vec<[f64; 2]> = frames.iter().filter_map(place).collect();
    if places.len() < 2 {
        *out += "<p>No table says where the frames were taken: each is compared with those before and after it.</p>";
        return;
    }
    let low = [0, 1].map(|k| places.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min));
    let high = [0, 1].map(|k| places.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max));
    let border = 40.0;
    let scale = (MAP_PX - 2.0 * border) / (high[0] - low[0]).max(high[1] - low[1]).max(1.0);
    let [width, height] = [0, 1].map(|k| (high[k] - low[k]) * scale + 2.0 * border);
    let at = |p: [f64; 2]| [(p[0] - low[0]) * scale + border, (high[1] - p[1]) * scale + border];
    let _ = write!(
        out,
        "<h2>Map</h2><svg viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" role=\"img\" \
         aria-label=\"Frames and the pairs that are compared\">"
    );
    let of_name = |wanted: &String| frames.iter().find(|f| f.name == *wanted).and_then(place).map(at);
    for p in &found.pairs {
        let (Some(a), Some(b)) = (of_name(&p.frames[0]), of_name(&p.frames[1])) else { continue };
        let colour = if p.along_line { CONTROL } else { DOT };
        let _ = write!(
            out,
            "<path d=\"M{:.1} {:.1}L{:.1} {:.1}\" stroke=\"{colour}\" stroke-opacity=\".6\"/>",
            a[0], a[1], b[0], b[1]
        );
    }
    for f in frames {
        let Some(p) = place(f).map(at) else { continue };
        match f.azimuth_deg.filter(|azimuth| azimuth.is_finite()) {
            Some(azimuth) => camera_mark(out, p, azimuth, &escaped(&f.name)),
            None => {
                let _ = write!(out, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\"/>", p[0], p[1]);
            }
        }
    }
    let _ = write!(
        out,
        "</svg><p>North is up. <span style=\"color:{CONTROL}\">Pairs along a line</span>, \
         <span style=\"color:{DOT}\">pairs across lines</span>.</p>"
    );
}

pub fn ties(found: &TiesStage, verified: &Ties, pictures: &Pictures) -> String {
    let mut out = format!("<p>{}. ", found.line().words());
    out += match found.neighbours_warped {
        true => "Neighbours were warped onto each other by the rough table.</p>",
        false => "Frames were matched as they are: focal length, positions or directions are not known.</p>",
    };
    for TiedFrame { name, ties, covered, .. } in &found.frames {
        if *ties < FEW_TIES {
            warning(&mut out, &format!("{name}: {ties} ties hardly hold it; look at its masks and neighbours."));
        } else if *covered < LITTLE_COVERED {
            warning(&mut out, &format!("{name}: ties in {:.0} % of the frame only.", 100.0 * covered));
        }
    }
    out += "<h2>Pairs</h2><table><tr><th>frames</th><th>matches</th><th>ties that fit a relative orientation</th></tr>";
    for p in &found.pairs {
        let class = if p.ties < FEW_TIES { " class=\"bad\"" } else { "" };
        let _ = write!(out, "<tr><td>{}</td><td>{}</td><td{class}>{}</td></tr>", both(&p.frames), p.matches, p.ties);
    }
    out += "</table><h2>Frames</h2><p>Dots are ties.</p><div class=\"frames\">";
    for (i, f) in found.frames.iter().enumerate() {
        let places = verified.places_tied(i);
        let mut dots = String::new();
        for at in places.iter().step_by(places.len().div_ceil(MOST_DOTS).max(1)) {
            let [x, y] = at.map(|v| v * pictures.scale);
            let _ = write!(dots, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.2\" fill=\"{DOT}\"/>");
        }
        let covered = 100.0 * f.covered;
        let caption = format!("{} ties with {} frames, in {covered:.0} % of it", f.ties, f.neighbours);
        frame(&mut out, &f.name, pictures, &dots, &caption);
    }
    out + "</div>"
}

pub fn relative(found: &RelativeStage) -> String {
    let mut out = format!(
        "<p>{}. Made by {}. {} of {} image points were laid upon each other in the frames.</p>",
        found.line().words(),
        escaped(found.made_by),
        found.image_points_laid,
        found.image_points
    );
    for lost in &found.not_registered {
        warning(&mut out, &format!("{lost}: not registered"));
    }
    out += "<table><tr><th>frame</th><th>ties</th><th>RMS (px)</th><th>x</th><th>y</th><th>z</th></tr>";
    for f in &found.frames {
        let _ = write!(out, "<tr><td>{}</td><td>{}</td>", escaped(&f.name), f.ties);
        cells(&mut out, [fixed(f.rms_px, 2)]);
        cells(&mut out, f.centre.map(|v| fixed(v, 2)));
        out += "</tr>";
    }
    out + "</table><p>Places are those of the block's own frame; COLMAP's text model of it lies in \
           <a href=\"../relative\">relative</a>.</p>"
}

/// The word and the colour of a point.
fn shown_as(role: Role) -> (&'static str, &'static str) {
    match role {
        Role::Control => ("control", CONTROL),
        Role::Check => ("check", CHECK),
    }
}

pub fn gcp(found: &GcpStage, pictures: &Pictures) -> String {
    let mut out = format!("<p>{}.</p>", found.line().words());
    out += "<p>Residuals: where a point's rays meet in the block − its survey, after a similarity by the control points. \
            Nothing is adjusted yet.</p><table><tr><th>point</th><th></th><th>images</th><th>x</th><th>y</th><th>z</th>\
            <th>d (m)</th></tr>";
    for p in &found.points {
        let (role, _) = shown_as(p.role);
        let _ = write!(out, "<tr><td>{}</td><td>{role}</td><td>{}</td>", escaped(&p.name), p.images.len());
        cells(&mut out, [0, 1, 2].map(|k| fixed(p.residual_m.map(|r| r[k]), 2)));
        cells(&mut out, [fixed(p.d_m, 2)]);
        out += "</tr>";
    }
    let _ = write!(
        out,
        "</table><h2>Frames</h2><p><span style=\"color:{CONTROL}\">Control points</span> and \
         <span style=\"color:{CHECK}\">check points</span> where they were measured.</p><div class=\"frames\">"
    );
    let mut shown: Vec<(&str, usize, String)> = Vec::new();
    for p in &found.points {
        let (_, colour) = shown_as(p.role);
        for image in &p.images {
            let of = image.frame.as_str();
            let [x, y] = image.pixel.map(|v| v * pictures.scale);
            let k = shown.iter().position(|s| s.0 == of).unwrap_or_else(|| {
                shown.push((of, 0, String::new()));
                shown.len() - 1
            });
            shown[k].1 += 1;
            let _ = write!(
                shown[k].2,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{colour}\" stroke=\"#fff\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" font-size=\"11\" fill=\"{colour}\" stroke=\"#fff\" stroke-width=\"3\" \
                 paint-order=\"stroke\">{}</text>",
                x + 5.0,
                y - 4.0,
                escaped(&p.name)
            );
        }
    }
    shown.sort_by(|a, b| a.0.cmp(b.0));
    for (of, count, marks) in shown {
        frame(&mut out, of, pictures, &marks, &format!("{count} points"));
    }
    out + "</div>"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::flight::stage::Stage;
    use crate::cli::flight::stage_documents::{MatchedPair, UsedFrame};

    #[test]
    fn names_are_text_in_pages_and_addresses_in_links() {
        let found = InteriorStage {
            stage: Stage::Interior,
            frames_listed: 1,
            f_px: Some(500.0),
            focal: FocalLength::Held,
            pp_px: [250.0, 250.0],
            size_px: [500.0, 500.0],
            field_of_view_deg: [Some(53.1); 2],
            frames: vec![UsedFrame { name: "a <b>#1.png".into(), masks: vec![] }],
            left_out: vec!["<i>".into()],
        };
        let page = whole("x & y", "interior", None, &interior(&found, &Pictures::of([500.0, 500.0], 240)));
        assert!(
            page.contains("x &amp; y") && page.contains("a &lt;b&gt;#1.png") && page.contains("&lt;i&gt;"),
            "{page}"
        );
        assert!(page.contains("frames/a%20%3Cb%3E%231.png.png") && !page.contains("<b>") && !page.contains("<i>"));
    }

    #[test]
    fn a_frame_without_ties_is_named() {
        let frame = |name: &str, ties: usize, covered: f64| TiedFrame {
            name: name.into(),
            features: 100,
            ties,
            neighbours: 1,
            covered,
        };
        let found = TiesStage {
            stage: Stage::Ties,
            neighbours_warped: true,
            pairs: vec![MatchedPair { frames: ["a".into(), "b".into()], matches: 40, ties: 3 }],
            frames: vec![frame("a", 3, 0.02), frame("b", 90, 0.1)],
        };
        let page = ties(&found, &Ties::default(), &Pictures::of([500.0, 500.0], 240));
        assert!(page.contains("a: 3 ties hardly hold it") && page.contains("b: ties in 10 % of the frame"), "{page}");
    }
}
