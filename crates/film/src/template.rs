//! Pictures of a mark to compare with: drawn from the camera's geometry, or learned from a roll.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::shape::{self, Outlines, Tone};
use super::types::MarkKind;
use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};
use autoref_raster::keys::cubic;

/// A template that `fiducials --learn` wrote: a mark as it stands at the lower edge of an upright frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearnedTemplate {
    /// Size of a value on the film, micrometres.
    pub pixel_um: f64,
    pub width: usize,
    pub height: usize,
    /// Where the reference point lies, in values from the outer corner of the first.
    pub reference: [f64; 2],
    /// Mean brightness, 0 to 1, row by row.
    pub values: Vec<f32>,
    /// How far a value is to be trusted, 0 to 1: low where the frames differ.
    pub weights: Vec<f32>,
    /// Number of marks that were averaged.
    pub marks: usize,
    /// Standard deviation of the reference point along each axis, micrometres on the film: of marks without a centre of
    /// symmetry it is only as good as what was pointed at.
    #[serde(default)]
    pub reference_sigma_um: f64,
}

impl LearnedTemplate {
    /// # Errors
    /// [`Error::Io`] when it cannot be read, [`Error::Format`] when it is no template.
    pub fn read(path: &Path) -> Result<Self> {
        let text = bounded::read_to_string(path, "a template", bounded::TEXT_BYTES)?;
        let t: LearnedTemplate = serde_json::from_str(&text)
            .map_err(|e| Error::format(path, format!("line {}", e.line()), e.to_string()))?;
        let sound = t.width >= 8
            && t.height >= 8
            && t.width
                .checked_mul(t.height)
                .is_some_and(|n| n <= 1 << 24 && n == t.values.len() && n == t.weights.len())
            && t.pixel_um.is_finite()
            && t.pixel_um > 0.0
            && t.reference_sigma_um.is_finite()
            && t.reference.iter().all(|v| v.is_finite())
            && t.values.iter().chain(&t.weights).all(|v| v.is_finite());
        if !sound {
            return Err(Error::format(path, "template", "its numbers do not fit together; learn it again"));
        }
        Ok(t)
    }

    fn sample(&self, u_mm: f64, v_mm: f64) -> Option<(f32, f32)> {
        let scale = 1e3 / self.pixel_um;
        let (x, y) = (self.reference[0] + u_mm * scale - 0.5, self.reference[1] - v_mm * scale - 0.5);
        let (i, j) = (x.floor(), y.floor());
        if i < 0.0 || j < 0.0 || i + 1.0 >= self.width as f64 || j + 1.0 >= self.height as f64 {
            return None;
        }
        let of = |d: &[f32]| cubic([self.width, self.height], [x, y], |i, j| d[j * self.width + i]);
        Some((of(&self.values), of(&self.weights).clamp(0.0, 1.0)))
    }
}

/// What a mark looks like, ready to be drawn at any scale and turn.
#[derive(Clone, Debug, PartialEq)]
pub enum Model {
    Drawn(MarkKind),
    Learned(LearnedTemplate),
}

impl Model {
    /// # Errors
    /// Those of [`LearnedTemplate::read`].
    pub fn of(kind: &MarkKind) -> Result<Self> {
        Ok(match kind {
            MarkKind::Learned { template } => Model::Learned(LearnedTemplate::read(&PathBuf::from(template))?),
            other => Model::Drawn(other.clone()),
        })
    }

    /// Value (0 dark, 1 bright) and weight at (u, v) millimetres; `None` where the mark says nothing.
    pub fn sample(&self, u_mm: f64, v_mm: f64) -> Option<(f32, f32)> {
        self.pen().sample(u_mm, v_mm)
    }

    /// For many samples.
    pub fn pen(&self) -> Pen<'_> {
        match self {
            Model::Drawn(kind) => Pen::Drawn(Outlines::of(kind)),
            Model::Learned(t) => Pen::Learned(t),
        }
    }

    /// Extent to both sides, outwards and inwards, millimetres.
    pub fn reach_mm(&self) -> (f64, f64, f64) {
        match self {
            Model::Drawn(kind) => shape::reach_mm(kind),
            Model::Learned(t) => {
                let mm = t.pixel_um / 1e3;
                let half = t.reference[0].max(t.width as f64 - t.reference[0]);
                (half * mm, (t.height as f64 - t.reference[1]) * mm, t.reference[1] * mm)
            }
        }
    }

    /// Half the longer side of what it covers, millimetres.
    pub fn radius_mm(&self) -> f64 {
        let (half, out, inward) = self.reach_mm();
        half.max(0.5 * (out + inward))
    }

    /// Its finest detail, by which pictures are decimated, millimetres.
    pub fn detail_mm(&self) -> f64 {
        match self {
            Model::Drawn(kind) => shape::detail_mm(kind),
            Model::Learned(t) => t.pixel_um / 1e3 * 4.0,
        }
    }

    /// The thinnest thing in it; 0 where that is not known.
    pub fn thinnest_mm(&self) -> f64 {
        match self {
            Model::Drawn(kind) => shape::thinnest_mm(kind),
            Model::Learned(_) => 0.0,
        }
    }

    /// See [`LearnedTemplate::reference_sigma_um`]; 0 for drawn marks.
    pub fn reference_sigma_um(&self) -> f64 {
        match self {
            Model::Drawn(_) => 0.0,
            Model::Learned(t) => t.reference_sigma_um,
        }
    }

    /// Whether it is drawn from numbers, not learned.
    pub fn is_drawn(&self) -> bool {
        matches!(self, Model::Drawn(_))
    }

    /// Whether it is known to be its own mirror image.
    pub fn is_symmetric(&self) -> bool {
        match self {
            Model::Drawn(kind) => shape::is_symmetric(kind),
            Model::Learned(_) => false,
        }
    }

    /// Whether a quarter of a turn changes nothing.
    pub fn is_alike_by_quarters(&self) -> bool {
        self.sectors_deg().is_some()
    }

    /// See [`shape::point_radius_mm`].
    pub fn point_radius_mm(&self) -> Option<f64> {
        match self {
            Model::Drawn(kind) => shape::point_radius_mm(kind),
            Model::Learned(_) => None,
        }
    }

    /// For marks with light of their own, the direction of a line or 0: they are compared in sectors about it.
    pub fn sectors_deg(&self) -> Option<f64> {
        match self {
            Model::Drawn(MarkKind::Cross { lines_deg, .. } | MarkKind::RingCross { lines_deg, .. }) => Some(*lines_deg),
            Model::Drawn(MarkKind::Dot { .. }) => Some(0.0),
            Model::Drawn(_) | Model::Learned(_) => None,
        }
    }

    /// Whether its bright parts show the image and so have no brightness of their own.
    pub fn shows_image(&self) -> bool {
        !matches!(self, Model::Drawn(MarkKind::Cross { .. } | MarkKind::RingCross { .. } | MarkKind::Dot { .. }))
    }
}

/// A model while it is drawn.
pub enum Pen<'a> {
    Drawn(Outlines<'a>),
    Learned(&'a LearnedTemplate),
}

impl Pen<'_> {
    /// See [`Model::sample`].
    pub fn sample(&self, u_mm: f64, v_mm: f64) -> Option<(f32, f32)> {
        match self {
            Pen::Drawn(outlines) => match outlines.tone(u_mm, v_mm) {
                Tone::Opaque => Some((0.0, 1.0)),
                Tone::Bright | Tone::Clear => Some((1.0, 1.0)),
                Tone::Unknown => None,
            },
            Pen::Learned(t) => t.sample(u_mm, v_mm),
        }
    }
}

/// The linear part of shape → scan: pixels = m · (u, v) in millimetres, row by row.
pub type Linear = [f64; 4];

/// A drawn template. Values have weighted mean zero and weighted mean square one.
#[derive(Clone, Debug)]
pub struct Template {
    pub width: usize,
    pub height: usize,
    /// The value whose centre is the reference point; outside of the template for parts.
    pub reference: [i64; 2],
    pub values: Vec<f32>,
    pub weights: Vec<f32>,
    pub weight_sum: f32,
    /// Sectors about the reference point with the share of each in the mark's contrast; empty where the mark is
    /// compared as a whole.
    pub parts: Vec<(f32, Template)>,
}

/// Places drawn per value along each axis, where an edge crosses the value.
const SUB: usize = 4;

/// Draws `model` under `linear` at one value per `factor` pixels. `radius_mm` leaves away what lies further from the
/// reference point. `None` when nothing with contrast is left.
pub fn draw(model: &Model, linear: Linear, factor: f64, radius_mm: Option<f64>) -> Option<Template> {
    let m = linear.map(|v| v / factor);
    let inverse = invert(m)?;
    let (half, out, inward) = model.reach_mm();
    let (half, out, inward) = match radius_mm {
        Some(r) => (half.min(r), out.min(r), inward.min(r)),
        None => (half, out, inward),
    };
    let corners = [(-half, -out), (half, -out), (-half, inward), (half, inward)];
    let reach = |k: usize, sign: f64| {
        let far = corners.iter().map(|(u, v)| sign * (m[2 * k] * u + m[2 * k + 1] * v)).fold(0.0, f64::max);
        (far - 0.5).ceil().max(1.0) as usize
    };
    let (left, right, above, below) = (reach(0, -1.0), reach(0, 1.0), reach(1, -1.0), reach(1, 1.0));
    let (width, height) = (left + right + 1, above + below + 1);
    let mut t = Template {
        width,
        height,
        reference: [left as i64, above as i64],
        values: vec![0.0; width * height],
        weights: vec![0.0; width * height],
        weight_sum: 0.0,
        parts: vec![],
    };
    // Where a value is smaller than everything drawn, its corners and middle tell whether an edge crosses it.
    let value_mm = 1.0 / (m[0] * m[3] - m[1] * m[2]).abs().sqrt();
    let even_tells = model.is_drawn() && value_mm < 0.5 * model.detail_mm();
    let pen = model.pen();
    for y in 0..height {
        for x in 0..width {
            let (px, py) = (x as f64 - left as f64, y as f64 - above as f64);
            let sample = |dx: f64, dy: f64| {
                let (dx, dy) = (px + dx, py + dy);
                let (u, v) = (inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy);
                if radius_mm.is_some_and(|r| u * u + v * v > r * r) { None } else { pen.sample(u, v) }
            };
            let even = if even_tells { even(&sample) } else { None };
            let (value, weight) = even.unwrap_or_else(|| mean(&sample));
            if weight > 0.25 {
                t.values[y * width + x] = value;
                t.weights[y * width + x] = weight;
            }
        }
    }
    if radius_mm.is_none()
        && let Some(lines_deg) = model.sectors_deg()
    {
        t.parts = sectors(&t, inverse, lines_deg);
    }
    normalise(t)
}

/// Sectors of a mark with light of its own, each compared by itself: a scratch is as bright as a line of the mark, and
/// where it runs along one the whole mark would correlate better beside its place. It spoils the sectors it crosses
/// only.
const SECTORS: usize = 8;
/// Sectors with less of the mark's contrast than this share of an even one say nothing.
const LEAST_SHARE: f64 = 0.25;

/// `lines_deg` is the middle of the first sector. Empty where fewer than three have contrast.
fn sectors(t: &Template, inverse: Linear, lines_deg: f64) -> Vec<(f32, Template)> {
    let sector_of = |x: usize, y: usize| {
        let (dx, dy) = (x as f64 - t.reference[0] as f64, y as f64 - t.reference[1] as f64);
        let (u, v) = (inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy);
        let turn = (v.atan2(u).to_degrees() - lines_deg) / 360.0;
        (turn * SECTORS as f64).round().rem_euclid(SECTORS as f64) as usize
    };
    let mut places_of: [Vec<(usize, usize)>; SECTORS] = Default::default();
    for (y, row) in t.weights.chunks_exact(t.width).enumerate() {
        for x in (0..t.width).filter(|x| row[*x] > 0.0) {
            places_of[sector_of(x, y)].push((x, y));
        }
    }
    let mut found: Vec<(f64, Template)> = vec![];
    for places in places_of {
        let least = |f: fn(&(usize, usize)) -> usize| places.iter().map(f).min().unwrap_or(0);
        let most = |f: fn(&(usize, usize)) -> usize| places.iter().map(f).max().unwrap_or(0);
        let (left, top) = (least(|p| p.0), least(|p| p.1));
        let (width, height) = (most(|p| p.0) - left + 1, most(|p| p.1) - top + 1);
        let mut part = Template {
            width,
            height,
            reference: [t.reference[0] - left as i64, t.reference[1] - top as i64],
            values: vec![0.0; width * height],
            weights: vec![0.0; width * height],
            weight_sum: 0.0,
            parts: vec![],
        };
        for (x, y) in places {
            let (from, to) = (y * t.width + x, (y - top) * width + x - left);
            (part.values[to], part.weights[to]) = (t.values[from], t.weights[from]);
        }
        let contrast = part.contrast();
        found.extend(normalise(part).map(|p| (contrast, p)));
    }
    let even = found.iter().map(|f| f.0).sum::<f64>() / SECTORS as f64;
    found.retain(|f| f.0 >= LEAST_SHARE * even);
    if found.len() < 3 {
        return vec![];
    }
    let sum: f64 = found.iter().map(|f| f.0).sum();
    found.into_iter().map(|(contrast, part)| ((contrast / sum) as f32, part)).collect()
}

/// Value and weight of a place where its corners and its middle show the same; `None` where they do not.
fn even(sample: &impl Fn(f64, f64) -> Option<(f32, f32)>) -> Option<(f32, f32)> {
    let middle = sample(0.0, 0.0);
    let same = |(dx, dy): (f64, f64)| sample(dx, dy) == middle;
    let corners = [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)];
    corners.into_iter().all(same).then(|| middle.unwrap_or((0.0, 0.0)))
}

/// Mean value and weight over a value's area.
fn mean(sample: &impl Fn(f64, f64) -> Option<(f32, f32)>) -> (f32, f32) {
    let (mut sum, mut weight) = (0.0f32, 0.0f32);
    for s in 0..SUB * SUB {
        let place = |k: usize| (k as f64 + 0.5) / SUB as f64 - 0.5;
        if let Some((value, w)) = sample(place(s % SUB), place(s / SUB)) {
            sum += value * w;
            weight += w;
        }
    }
    if weight > 0.0 { (sum / weight, weight / (SUB * SUB) as f32) } else { (0.0, 0.0) }
}

impl Template {
    /// Sum of the weights, mean and standard deviation of the values.
    fn moments(&self) -> (f64, f64, f64) {
        let sum: f64 = self.weights.iter().map(|w| f64::from(*w)).sum();
        let dot = |f: &dyn Fn(f64) -> f64| {
            self.values.iter().zip(&self.weights).map(|(v, w)| f64::from(*w) * f(f64::from(*v))).sum::<f64>() / sum
        };
        let mean = dot(&|v| v);
        (sum, mean, dot(&|v| (v - mean).powi(2)).sqrt())
    }

    /// Weighted sum of squares about the mean.
    fn contrast(&self) -> f64 {
        let (sum, _, sigma) = self.moments();
        if sum > 0.0 { sum * sigma * sigma } else { 0.0 }
    }
}

fn normalise(mut t: Template) -> Option<Template> {
    let (sum, mean, sigma) = t.moments();
    if !(sum > 8.0 && sigma > 1e-4) {
        return None;
    }
    for v in &mut t.values {
        *v = ((f64::from(*v) - mean) / sigma) as f32;
    }
    t.weight_sum = sum as f32;
    Some(t)
}

/// The inverse; `None` of a map that squeezes the plane into a line.
pub fn invert(m: Linear) -> Option<Linear> {
    let det = m[0] * m[3] - m[1] * m[2];
    (det.is_finite() && det.abs() > 1e-12).then(|| [m[3] / det, -m[1] / det, -m[2] / det, m[0] / det])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawn_dot_is_bright_at_its_reference_point() {
        let dot = Model::Drawn(MarkKind::Dot { diameter_mm: 0.3, ring_diameter_mm: None, ring_line_mm: None });
        let t = draw(&dot, [50.0, 0.0, 0.0, -50.0], 1.0, None).expect("has contrast");
        let middle = t.reference[1] as usize * t.width + t.reference[0] as usize;
        assert!(t.values[middle] > 0.5 && t.values[middle + 12] < 0.0);
        let mean: f32 = t.values.iter().zip(&t.weights).map(|(v, w)| v * w).sum();
        assert!(mean.abs() < 1e-2, "{mean}");
    }
}
