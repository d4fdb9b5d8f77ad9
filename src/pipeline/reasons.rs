//! Why a point of the list has no mark: what the picture shows where its mark must be.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::candidate::scene::{Ground, sample_ground};
use crate::candidate::{Candidate, least_whole_area_px};
use crate::gcp::Gcp;
use crate::pipeline::georeference::{FoundMark, Orientation};
use crate::profile::colour::lab_from_srgb;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::ranks::upper_median;
use autoref_raster::window::Window;
use autoref_raster::{Patch, RasterSource, read_patch};
use autoref_solve::{Similarity, Solution};

/// Why a point was not found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The image does not reach there.
    Outside,
    /// Ground, or something that covers the mark.
    Hidden,
    /// A trace of the paint, too weak to be believed.
    Faint,
    /// Something stands out, of another colour than the marks.
    OtherColour,
    /// A mark that may be another point's.
    Ambiguous,
    /// A mark that is nobody else's lies beside the place, farther off than the others are: mark or survey is wrong.
    Displaced,
    /// The run proposed a mark, and a review did not accept it.
    Proposed,
    /// A review rejected what was found, or could not see the mark.
    Reviewed,
}

/// A point without a mark.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Written")]
pub struct NotFound {
    pub name: String,
    pub reason: Reason,
    /// The same for people: how faint, which colour, between which.
    pub detail: String,
    /// Where the mark must be, pixels.
    pub x: f64,
    pub y: f64,
    /// Contrast of what is there with the ground beside it, in deviations of the ground.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contrast: Option<f64>,
    /// Colour of what is there, #RRGGBB.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colour: Option<String>,
    /// The points that a mark there may be.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub between: Vec<String>,
    /// From the listed place to the mark beside it, metres to the east.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_e_m: Option<f64>,
    /// The same to the north.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_n_m: Option<f64>,
}

/// As files hold it; before there were reasons it was the name alone.
#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Name(String),
    Whole {
        name: String,
        reason: Reason,
        #[serde(default)]
        detail: String,
        #[serde(default)]
        x: f64,
        #[serde(default)]
        y: f64,
        contrast: Option<f64>,
        colour: Option<String>,
        #[serde(default)]
        between: Vec<String>,
        offset_e_m: Option<f64>,
        offset_n_m: Option<f64>,
    },
}

impl From<Written> for NotFound {
    fn from(written: Written) -> NotFound {
        match written {
            Written::Name(name) => NotFound::new(name, Reason::Hidden, PixelPoint { x: 0.0, y: 0.0 }, String::new()),
            Written::Whole { name, reason, detail, x, y, contrast, colour, between, offset_e_m, offset_n_m } => {
                NotFound { name, reason, detail, x, y, contrast, colour, between, offset_e_m, offset_n_m }
            }
        }
    }
}

impl NotFound {
    /// A reason, where the point's mark must be, and in words.
    pub fn new(name: String, reason: Reason, at: PixelPoint, detail: String) -> NotFound {
        NotFound {
            name,
            reason,
            detail,
            x: at.x,
            y: at.y,
            contrast: None,
            colour: None,
            between: Vec::new(),
            offset_e_m: None,
            offset_n_m: None,
        }
    }

    /// A name with its reason.
    pub fn line(&self) -> String {
        format!("{} ({})", self.name, self.why())
    }

    /// The reason in words: `faint: 26 % of the paint's contrast`.
    pub fn why(&self) -> String {
        let word = match self.reason {
            Reason::Outside => "outside",
            Reason::Hidden => "hidden",
            Reason::Faint => "faint",
            Reason::OtherColour => "other colour",
            Reason::Ambiguous => "ambiguous",
            Reason::Displaced => "displaced",
            Reason::Proposed => "proposed",
            Reason::Reviewed => "reviewed",
        };
        if self.detail.is_empty() { word.to_owned() } else { format!("{word}: {}", self.detail) }
    }
}

/// Why each point without a mark has none, in the order of the list: those inside the image, then those outside.
/// Without a source (a list of candidates alone) nothing can be looked at, and points inside are hidden.
///
/// # Errors
/// When a window cannot be read.
pub fn reasons(
    source: Option<&dyn RasterSource>,
    orientation: &Orientation,
    gcps: &[Gcp],
    candidates: &[Candidate],
) -> Result<Vec<NotFound>> {
    let expected = |gcp: usize| orientation.solution.similarity.invert(gcps[gcp].position());
    let marks = || orientation.marks.iter().chain(&orientation.check_marks);
    let mut paints: Vec<[u8; 3]> = marks().filter_map(|found| found.mark.paint).collect();
    paints.sort_unstable();
    let paint = paints.get(paints.len() / 2).copied();
    let mut sides: Vec<f64> = marks().filter_map(|found| found.mark.area_px.map(f64::sqrt)).collect();
    let side_px = upper_median(&mut sides).unwrap_or(10.0).clamp(4.0, 100.0);
    let least_area_px = least_whole_area_px(marks().map(|found| &found.mark));
    // Asked for when the first picture is looked at.
    let mut middle = None;
    let mut all = Vec::new();
    for &gcp in &orientation.not_found {
        let (name, at) = (gcps[gcp].name.clone(), expected(gcp));
        let near = |p: PixelPoint, reach: f64| (p.x - at.x).hypot(p.y - at.y) <= reach;
        // A mark is there, but it is another point's.
        let rivals: Vec<String> = marks()
            .filter(|found| near(found.mark.centre, side_px))
            .map(|found| gcps[found.gcp].name.clone())
            .collect();
        let (parts, beside): (Vec<&Candidate>, Vec<&Candidate>) = candidates
            .iter()
            .filter(|c| near(c.centre, 2.5 * side_px))
            .partition(|c| c.area_px.is_some_and(|area| area < least_area_px));
        let around = beside.len();
        if !rivals.is_empty() || around > 1 {
            let detail = match rivals.first() {
                Some(rival) => format!("the mark there is taken for {rival}"),
                None => format!("{around} marks lie beside the place"),
            };
            let mut between = rivals;
            between.push(name.clone());
            all.push(NotFound { between, ..NotFound::new(name, Reason::Ambiguous, at, detail) });
            continue;
        }
        let taken = |mark: PixelPoint| marks().any(|found| near_each_other(found.mark.centre, mark, side_px));
        if let Some(mark) = beside.first().map(|c| c.centre).filter(|mark| !taken(*mark)) {
            all.push(beside_its_place(&gcps[gcp], at, mark, &orientation.solution));
            continue;
        }
        let off = |mark: &PixelPoint| (mark.x - at.x).hypot(mark.y - at.y);
        let nearest = parts.iter().map(|c| c.centre).min_by(|a, b| off(a).total_cmp(&off(b)));
        if let Some(off_px) = nearest.filter(|mark| !taken(*mark)).as_ref().map(off) {
            let detail = format!("only a part of a mark is seen, {off_px:.1} px beside its place");
            all.push(NotFound::new(name, Reason::Hidden, at, detail));
            continue;
        }
        if let Some(detail) = source.and_then(|source| cut_by_border(source, at, side_px)) {
            all.push(NotFound::new(name, Reason::Hidden, at, detail));
            continue;
        }
        let seen = match source {
            Some(source) => {
                if middle.is_none() {
                    middle = Some(Middle::of(source, places(marks()), side_px, paint)?);
                }
                Some(read_around(source, at, side_px)?)
            }
            None => None,
        };
        all.push(match seen {
            Some(patch) => look(name, at, &patch, (side_px, middle.unwrap_or(Middle::Painted)), paint),
            None => NotFound::new(name, Reason::Hidden, at, "no candidate lies there".into()),
        });
    }
    for &gcp in &orientation.outside {
        let name = gcps[gcp].name.clone();
        all.push(NotFound::new(name, Reason::Outside, expected(gcp), "the image does not reach there".into()));
    }
    Ok(all)
}

/// What is said of a place so near the border of the image that a mark there cannot lie in it whole, whatever the
/// picture shows.
fn cut_by_border(source: &dyn RasterSource, at: PixelPoint, side_px: f64) -> Option<String> {
    let (width, height) = (source.info().width as f64, source.info().height as f64);
    let off_px = at.x.min(at.y).min(width - at.x).min(height - at.y);
    (off_px < side_px / 2.0)
        .then(|| format!("its place lies {off_px:.1} px from the image's border, which cuts a mark of {side_px:.0} px"))
}

fn places<'a>(marks: impl Iterator<Item = &'a FoundMark>) -> Vec<PixelPoint> {
    marks.map(|found| found.mark.centre).collect()
}

fn read_around(source: &dyn RasterSource, at: PixelPoint, side_px: f64) -> Result<Patch> {
    let pixel = Window::new(at.x.max(0.0) as u64, at.y.max(0.0) as u64, 1, 1);
    read_patch(source, pixel.grown((2.0 * side_px).ceil() as u64 + 8, &source.info().bounds()))
}

/// What the marks of an image have in their middle.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Middle {
    /// Paint, as squares, discs and crosses.
    Painted,
    /// Ground or another paint; their own lies so far from the middle, pixels, as of rings.
    Hollow { from_px: f64, to_px: f64 },
}

impl Middle {
    /// Told by marks that were found, at most eight of them.
    fn of(
        source: &dyn RasterSource,
        mut found: Vec<PixelPoint>,
        side_px: f64,
        paint: Option<[u8; 3]>,
    ) -> Result<Middle> {
        const ENOUGH: usize = 8;
        let Some(paint) = paint else { return Ok(Middle::Painted) };
        // Images that are decoded from the top down.
        found.sort_by(|a, b| a.y.total_cmp(&b.y));
        // Shares of paint by distance, a pixel each; the middle of some pixel lies in the first.
        let mut sums = vec![(0.0, 0.0); side_px.ceil() as usize + 1];
        for &at in found.iter().step_by(found.len().div_ceil(ENOUGH).max(1)) {
            let patch = read_around(source, at, side_px)?;
            let Some(ground) = ground_around(at, &patch, side_px) else { continue };
            let (scale, width) = (255.0 / f64::from(patch.white), patch.window.width as usize);
            for i in (0..patch.rgb.len()).filter(|&i| patch.valid[i]) {
                let far = distance_px(&patch, width, i, at);
                if let Some(sum) = sums.get_mut(far as usize) {
                    let colour = Vector3::from(patch.rgb[i].map(|v| f64::from(v) * scale));
                    *sum = (sum.0 + share_of(&ground, &colour, paint), sum.1 + 1.0);
                }
            }
        }
        Ok(Middle::by_shares(&sums.iter().map(|(sum, n)| if *n > 0.0 { sum / n } else { 0.0 }).collect::<Vec<_>>()))
    }

    fn by_shares(shares: &[f64]) -> Middle {
        /// The middle has less than this part of the most paint there is at any distance.
        const HALF: f64 = 0.5;
        let Some(peak) = (0..shares.len()).max_by(|a, b| shares[*a].total_cmp(&shares[*b])) else {
            return Middle::Painted;
        };
        if shares[0] >= HALF * shares[peak] {
            return Middle::Painted;
        }
        let is_paint = |r: &usize| shares[*r] >= HALF * shares[peak];
        let from = (0..=peak).rev().take_while(is_paint).last().unwrap_or(peak);
        let to = (peak..shares.len()).take_while(is_paint).last().unwrap_or(peak);
        Middle::Hollow { from_px: from as f64, to_px: to as f64 + 1.0 }
    }

    /// Distances from the middle at which a mark of this side has its paint, pixels.
    fn paint_px(self, side_px: f64) -> (f64, f64) {
        match self {
            Middle::Painted => (0.0, (side_px / 3.0).max(1.0)),
            Middle::Hollow { from_px, to_px } => (from_px, to_px),
        }
    }
}

fn distance_px(patch: &Patch, width: usize, i: usize, at: PixelPoint) -> f64 {
    let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
    (x + patch.window.x as f64 - at.x).hypot(y + patch.window.y as f64 - at.y)
}

fn near_each_other(a: PixelPoint, b: PixelPoint, reach_px: f64) -> bool {
    (a.x - b.x).hypot(a.y - b.y) <= reach_px
}

/// A whole mark, no other point's, that was not taken: beside its place, or where the others do not say so surely.
fn beside_its_place(gcp: &Gcp, at: PixelPoint, mark: PixelPoint, solution: &Solution) -> NotFound {
    /// Of the deviations of a place so many hold the mark.
    const HOLDING: f64 = 4.0;
    let (name, off_px) = (gcp.name.clone(), (mark.x - at.x).hypot(mark.y - at.y));
    let sigma_px = solution.sigma_at_m(at) / solution.scale_m_per_px;
    let ambiguous =
        |detail| NotFound { between: vec![name.clone()], ..NotFound::new(name.clone(), Reason::Ambiguous, at, detail) };
    if let Some(sigma_m) = gcp.sigma_m.filter(|_| off_px * solution.scale_m_per_px <= gcp.reach_m()) {
        return ambiguous(format!(
            "a mark lies {off_px:.1} px beside its place, within its stated accuracy (σ {sigma_m:.3} m): its own, or another \
             as often"
        ));
    }
    if off_px > HOLDING * sigma_px.max(1.0) || sigma_px <= 1.0 {
        return displaced(name, at, mark, &solution.similarity);
    }
    let detail = format!(
        "a mark lies {off_px:.1} px beside its place, which the other points give to {sigma_px:.1} px only: its own, or \
         another as often"
    );
    ambiguous(detail)
}

/// The mark lies whole, but elsewhere than the list has it.
fn displaced(name: String, at: PixelPoint, mark: PixelPoint, similarity: &Similarity) -> NotFound {
    let (listed, seen) = (similarity.apply(at), similarity.apply(mark));
    let (e, n) = (seen.easting - listed.easting, seen.northing - listed.northing);
    let detail = format!(
        "a whole mark lies {:.1} px = {:.3} m beside the listed place: dE {e:+.3} m, dN {n:+.3} m",
        (mark.x - at.x).hypot(mark.y - at.y),
        e.hypot(n)
    );
    NotFound { offset_e_m: Some(e), offset_n_m: Some(n), ..NotFound::new(name, Reason::Displaced, at, detail) }
}

/// What stands out less is ground; as in the examination.
const LEAST_CONTRAST: f64 = 4.0;
/// With at least this share of the paint's contrast it is not for faintness that a mark was not found, ...
const FULL: f64 = 0.7;
/// ... nor where so large a part of its place has that much: what covers a mark in part, or a border of light or ground
/// through it, leaves the rest as it was.
const IN_PART: f64 = 0.25;

/// What the window shows about its place.
fn look(
    name: String,
    at: PixelPoint,
    patch: &Patch,
    (side_px, middle): (f64, Middle),
    paint: Option<[u8; 3]>,
) -> NotFound {
    /// A trace of paint is at least this share of it, and so many times what bare ground around looks like.
    const TRACE: f64 = 0.08;
    const MORE_THAN_GROUND: f64 = 1.5;
    /// Hues that lie further apart are other paints, radians.
    const HUES: f64 = 0.45;
    /// A colour that lies no farther beside the line from ground to paint is ground that paint shows on.
    const MIXED: f64 = 0.3;
    let width = patch.window.width as usize;
    let Some(ground) = ground_around(at, patch, side_px) else {
        return NotFound::new(name, Reason::Hidden, at, "the image holds nothing there".into());
    };
    let scale = 255.0 / f64::from(patch.white);
    // The mark's middle may be a little beside its place: of nine the one that stands out most.
    let (from, to) = middle.paint_px(side_px);
    let step = match middle {
        Middle::Painted => side_px / 3.0,
        Middle::Hollow { .. } => to - from,
    };
    let places = (-1..=1).flat_map(|v| (-1..=1).map(move |u| (f64::from(u) * step, f64::from(v) * step)));
    let inverse = (ground.covariance + Matrix3::identity() * 9.0).cholesky().map(|c| c.inverse());
    let contrast_of = |colour: &Vector3<f64>| {
        let step = colour - ground.mean;
        inverse.map_or(0.0, |inverse| step.dot(&(inverse * step)).max(0.0).sqrt())
    };
    let colours_about = |(dx, dy): (f64, f64)| {
        let middle = PixelPoint { x: at.x + dx, y: at.y + dy };
        let is_of_place = move |i: &usize| (from..=to).contains(&distance_px(patch, width, *i, middle));
        let indices = (0..patch.rgb.len()).filter(|&i| patch.valid[i]).filter(is_of_place);
        indices.map(|i| Vector3::from(patch.rgb[i].map(|v| f64::from(v) * scale)))
    };
    let mean_about = |place: (f64, f64)| {
        let (sum, n) = colours_about(place).fold((Vector3::zeros(), 0.0), |(sum, n), colour| (sum + colour, n + 1.0));
        (n > 0.0).then(|| sum / n)
    };
    let seen = places.filter_map(|place| Some((mean_about(place)?, place)));
    let best = seen.max_by(|(a, _), (b, _)| contrast_of(a).total_cmp(&contrast_of(b)));
    let Some((colour, place)) = best else {
        return NotFound::new(name, Reason::Hidden, at, "the image holds nothing there".into());
    };
    let contrast = contrast_of(&colour);
    let share = paint.map_or(0.0, |paint| share_of(&ground, &colour, paint));
    let is_other_paint =
        paint.is_some_and(|paint| hues_apart(&colour, paint) > HUES && off_line(&ground, &colour, paint) >= MIXED);
    let is_trace = || {
        let of_ground = around(1.5 * side_px)
            .filter_map(mean_about)
            .map(|colour| paint.map_or(0.0, |paint| share_of(&ground, &colour, paint)));
        share >= TRACE && contrast >= 1.0 && share >= MORE_THAN_GROUND * of_ground.fold(0.0, f64::max)
    };
    // Of the place, what has the paint's contrast.
    let painted = paint.map_or(0.0, |paint| {
        let shares: Vec<f64> = colours_about(place).map(|colour| share_of(&ground, &colour, paint)).collect();
        shares.iter().filter(|share| **share >= FULL).count() as f64 / shares.len().max(1) as f64
    });
    let hex = hex(&colour);
    let (reason, detail) = if contrast < LEAST_CONTRAST && !is_trace() {
        let what = format!("no paint is seen there, only ground or cover of {hex}, much as around it");
        (Reason::Hidden, what)
    } else if contrast >= LEAST_CONTRAST && is_other_paint {
        (Reason::OtherColour, format!("what stands out there is {hex}"))
    } else if contrast >= LEAST_CONTRAST && paint.is_none() {
        // Targets that are found by their shape have no paint to be faint.
        let what = format!(
            "something stands out there by {contrast:.1} times the scatter of the ground, but no whole target: covered in part, \
             cut, or of another shape"
        );
        (Reason::Hidden, what)
    } else {
        paint_there(share, painted, contrast)
    };
    NotFound { contrast: Some(contrast), colour: Some(hex), ..NotFound::new(name, reason, at, detail) }
}

/// What is said where the marks' paint is seen: its share of the paint's contrast, the part of the place that has all
/// of it, and the deviations of the ground by which it stands out.
fn paint_there(share: f64, painted: f64, contrast: f64) -> (Reason, String) {
    let percent = 100.0 * share;
    if contrast >= LEAST_CONTRAST && (share >= FULL || painted >= IN_PART) {
        let what = format!(
            "the marks' paint is there, {percent:.0} % of its contrast, but no whole mark: covered in part, cut, across a \
             border of light or ground, or beside its surveyed place"
        );
        return (Reason::Hidden, what);
    }
    let what = format!("{percent:.0} % of the paint's contrast, {contrast:.1} times the scatter of the ground around");
    (Reason::Faint, what)
}

/// The ground beside a mark that would lie there.
fn ground_around(at: PixelPoint, patch: &Patch, side_px: f64) -> Option<Ground> {
    let width = patch.window.width as usize;
    let is_beside = |i: &usize| {
        let far = distance_px(patch, width, *i, at);
        far > 1.1 * side_px && far <= 2.0 * side_px + 6.0
    };
    let ring: Vec<[u16; 3]> =
        (0..patch.rgb.len()).filter(|&i| patch.valid[i]).filter(is_beside).map(|i| patch.rgb[i]).collect();
    sample_ground(&ring, patch.white)
}

/// Places all around, so far away.
fn around(radius_px: f64) -> impl Iterator<Item = (f64, f64)> {
    const PLACES: u32 = 16;
    (0..PLACES).map(move |k| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(PLACES)).sin_cos();
        (radius_px * cos, radius_px * sin)
    })
}

/// Share of paint that the colour is, from the ground.
fn share_of(ground: &Ground, colour: &Vector3<f64>, paint: [u8; 3]) -> f64 {
    let whole = Vector3::from(paint.map(f64::from)) - ground.mean;
    ((colour - ground.mean).dot(&whole) / whole.norm_squared().max(1.0)).clamp(0.0, 1.0)
}

/// How far beside the line from the ground to the paint the colour lies, as a share of its distance from the ground.
fn off_line(ground: &Ground, colour: &Vector3<f64>, paint: [u8; 3]) -> f64 {
    let (step, whole) = (colour - ground.mean, Vector3::from(paint.map(f64::from)) - ground.mean);
    let along = step.dot(&whole).max(0.0) / whole.norm_squared().max(1.0);
    (step - along * whole).norm() / step.norm().max(1.0)
}

/// Angle between the hues of two colours, radians; of colours without hue none.
fn hues_apart(colour: &Vector3<f64>, paint: [u8; 3]) -> f64 {
    const GREY: f64 = 8.0;
    let ab = |rgb: [f64; 3]| {
        let lab = lab_from_srgb(rgb.map(|v| v / 255.0));
        (lab[1], lab[2])
    };
    let (a, b) = (ab([colour[0], colour[1], colour[2]]), ab(paint.map(f64::from)));
    match (a.0.hypot(a.1) < GREY, b.0.hypot(b.1) < GREY) {
        (true, true) => 0.0,
        (false, false) => {
            let turn = (a.1.atan2(a.0) - b.1.atan2(b.0)).abs();
            turn.min(std::f64::consts::TAU - turn)
        }
        _ => std::f64::consts::PI,
    }
}

fn hex(colour: &Vector3<f64>) -> String {
    let [r, g, b] = [0, 1, 2].map(|c| colour[c].round().clamp(0.0, 255.0) as u8);
    format!("#{r:02X}{g:02X}{b:02X}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A white plate on grey ground, 10 px wide.
    fn plate(paint: Option<[u8; 3]>) -> NotFound {
        let window = Window::new(0, 0, 60, 60);
        let far = |i: u64| (i as f64 + 0.5 - 30.0).abs();
        let level = |i: u64| if far(i % 60).max(far(i / 60)) < 5.0 { 200 } else { 100 };
        let rgb = (0..3600).map(|i| [level(i); 3]).collect();
        let patch = Patch { window, rgb, valid: vec![true; 3600], white: 255 };
        look("7".into(), PixelPoint { x: 30.0, y: 30.0 }, &patch, (10.0, Middle::Painted), paint)
    }

    /// A point whose mark lies whole beside the listed place was said to be hidden.
    #[test]
    fn a_mark_beside_its_place_is_displaced_and_old_files_are_read() {
        let similarity = Similarity {
            a_re: 0.03,
            a_im: 0.0,
            easting_0: 500.0,
            northing_0: 700.0,
            mirrored: autoref_raster::coords::Handedness::AsIs,
        };
        let (at, mark) = (PixelPoint { x: 30.0, y: 30.0 }, PixelPoint { x: 40.0, y: 20.0 });
        let point = displaced("7".into(), at, mark, &similarity);
        assert_eq!(
            point.why(),
            "displaced: a whole mark lies 14.1 px = 0.424 m beside the listed place: dE +0.300 m, dN +0.300 m"
        );
        let text = serde_json::to_string(&point).expect("plain data");
        assert!(text.contains(r#""reason":"displaced""#), "{text}");
        assert_eq!(serde_json::from_str::<NotFound>(&text).expect("its own text"), point);
        let old = r#"{"name": "7", "reason": "hidden", "detail": "ground", "x": 1.0, "y": 2.0}"#;
        assert_eq!(serde_json::from_str::<NotFound>(old).expect("an old file").reason, Reason::Hidden);
    }

    /// Grass at the border, where no whole mark can lie, was said to be something of another colour.
    #[test]
    fn a_place_at_the_border_is_said_to_lie_there() {
        let source = autoref_raster::memory::MemorySource::rgb8(100, 80, vec![90; 100 * 80 * 3]);
        let said = |x: f64, y: f64| cut_by_border(&source, PixelPoint { x, y }, 12.0);
        for (x, y) in [(50.0, 79.5), (50.0, 0.5), (0.5, 40.0), (99.5, 40.0)] {
            assert!(said(x, y).is_some_and(|detail| detail.contains("0.5 px from the image's border")), "{x}, {y}");
        }
        assert!(said(50.0, 40.0).is_none() && said(50.0, 73.0).is_none());
    }

    /// A plate that stands out plainly and was no target by its shape was said to be faint.
    #[test]
    fn what_has_no_paint_and_stands_out_is_not_faint() {
        let seen = plate(None);
        assert_eq!(seen.reason, Reason::Hidden, "{seen:?}");
        assert!(seen.detail.contains("no whole target"), "{seen:?}");
        // White paint of which half is there stays faint.
        assert_eq!(plate(Some([255; 3])).reason, Reason::Faint);
    }

    /// The middle of a ring, which is ground, was taken for something of another colour.
    #[test]
    fn rings_are_asked_for_their_paint_where_they_have_it() {
        let middle = Middle::by_shares(&[0.1, 0.1, 0.2, 0.8, 0.9, 0.7, 0.2, 0.0]);
        assert_eq!(middle, Middle::Hollow { from_px: 3.0, to_px: 6.0 });
        assert_eq!(Middle::by_shares(&[0.8, 0.9, 0.9, 0.5, 0.1]), Middle::Painted);
        assert_eq!(Middle::by_shares(&[]), Middle::Painted);
        let window = Window::new(0, 0, 60, 60);
        let far = |i: u64| ((i % 60) as f64 + 0.5 - 30.0).hypot((i / 60) as f64 + 0.5 - 30.0);
        // A green middle, and half of the ring.
        let colour = |i: u64| match far(i) {
            r if r < 3.0 => [40, 160, 60],
            r if r < 6.0 && i % 60 < 30 => [255, 110, 0],
            _ => [100; 3],
        };
        let patch = Patch { window, rgb: (0..3600).map(colour).collect(), valid: vec![true; 3600], white: 255 };
        let at = PixelPoint { x: 30.0, y: 30.0 };
        let seen = look("7".into(), at, &patch, (9.0, middle), Some([255, 110, 0]));
        assert!(seen.reason == Reason::Hidden && seen.detail.contains("the marks' paint is there"), "{seen:?}");
        let blind = look("7".into(), at, &patch, (9.0, Middle::Painted), Some([255, 110, 0]));
        assert_eq!(blind.reason, Reason::OtherColour, "{blind:?}");
    }
}
