//! Where in a window a mark may be: weighted normalised cross-correlation, coarse to fine.
//!
//! After J. P. Lewis, "Fast template matching", Vision Interface, 1995, with weights: what the mark does not describe (the
//! image beyond the opaque frame, the scanner's glass) takes no part. Correlation does not change when a scan is brightened
//! or stretched, so dark frames need no equalisation first.

use super::correlate::correlate;
use super::kernel::{Kernel, widest};
use super::template::{Model, Picture, Template};
use super::window::{Grey, around, read_grey};
use crate::coords::PixelPoint;
use crate::error::Result;
use crate::raster::RasterSource;
use crate::window::Window;

/// A place where a mark may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    pub centre: PixelPoint,
    /// Normalised correlation at the finest level, −1 to 1.
    pub score: f64,
}

/// Smallest side of a coarse template, in values.
const COARSE_PX: f64 = 20.0;
/// Largest side of the template that ranks the places of a search box, in values: enough to tell marks from clutter.
const RANK_PX: f64 = 110.0;
/// Largest side of the finest template, in values; finer levels add cost but no certainty.
const FINE_PX: f64 = 230.0;
/// Standard deviation of grey values, of white, below which a place is called flat: half an 8-bit level.
pub(super) const FLAT: f32 = 0.002;
/// Peaks below this are no marks.
const LEAST_SCORE: f64 = 0.3;

/// Values added beyond the scan's edge.
const EDGE_VALUES: u64 = 2;

/// Decimations: pixels along one value, powers of two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Levels {
    /// At which a mark is looked for first.
    pub coarse: u64,
    /// At which the places found are ranked.
    pub rank: u64,
    /// At which a mark is placed.
    pub fine: u64,
}

impl Levels {
    pub fn of(picture: &Picture) -> Levels {
        let px_per_mm = picture.px_per_mm();
        let size = 2.0 * picture.model.radius_mm() * px_per_mm;
        let detail = picture.model.detail_mm() * px_per_mm;
        let mut coarse = 1;
        while size / (2 * coarse) as f64 >= COARSE_PX && (2 * coarse) as f64 <= 2.0 * detail && coarse < 64 {
            coarse *= 2;
        }
        let first_below = |most: f64| {
            let mut level = 1;
            while size / level as f64 > most && level < coarse {
                level *= 2;
            }
            level
        };
        Levels { coarse, rank: first_below(RANK_PX), fine: first_below(FINE_PX) }
    }
}

/// The best places for the mark in `window`, at most `most`, best first, placed at the level [`Levels::rank`]. What the reader
/// keeps of the window is let go.
///
/// # Errors
/// Those of reading the scan.
pub fn search(source: &dyn RasterSource, window: Window, picture: &Picture, most: usize) -> Result<Vec<Peak>> {
    let levels = Levels::of(picture);
    let Some(template) = picture.at(levels.coarse) else { return Ok(vec![]) };
    let grey = read_around(source, window, picture.model, levels.coarse, levels.coarse)?;
    if template.width > grey.width || template.height > grey.height {
        return Ok(vec![]);
    }
    let mut scores = vec![-1.0f32; grey.data.len()];
    for cut in cuts(picture.model) {
        let now = correlate(&level_ground(&grey, *cut), template, [0, 0], grey.width, grey.height);
        scores.iter_mut().zip(now).for_each(|(b, n)| *b = b.max(n));
    }
    let radius = (template.width.min(template.height) / 3).max(2);
    let mut peaks = vec![];
    for (x, y, _) in highest(&scores, grey.width, grey.height, radius, most) {
        let start = grey.to_scan(x as f64 + 0.5, y as f64 + 0.5);
        if let Some(peak) = settle(source, start, picture, levels.coarse, levels.rank)? {
            peaks.push(peak);
        }
    }
    source.release(window);
    peaks.sort_by(|a: &Peak, b| b.score.total_cmp(&a.score));
    // Two coarse peaks can climb the same mark.
    let mut kept: Vec<Peak> = vec![];
    for peak in peaks {
        let apart =
            |k: &Peak| (k.centre.x - peak.centre.x).hypot(k.centre.y - peak.centre.y) > 2.0 * levels.coarse as f64;
        if peak.score >= LEAST_SCORE && kept.iter().all(apart) {
            kept.push(peak);
        }
    }
    Ok(kept)
}

/// Reads a window for comparing at decimations from `factor` to `coarsest`, with room beyond the scan's edge for marks of lines: what
/// is beside them is opaque there as well. Marks that show the image keep to the scan, where they may end in the scanner's glass.
fn read_around(source: &dyn RasterSource, window: Window, model: &Model, factor: u64, coarsest: u64) -> Result<Grey> {
    let grey = read_grey(source, window, factor)?;
    let room = (EDGE_VALUES * coarsest / factor) as usize;
    Ok(if model.sectors_deg().is_some() { grey.beyond_edges(&source.info().bounds(), room) } else { grey })
}

/// From about the right place, known at decimation `from`, to the place at decimation `to`, through finer and finer
/// pictures. `None` when the mark would leave the scan there.
///
/// # Errors
/// Those of reading the scan.
pub fn settle(
    source: &dyn RasterSource,
    start: PixelPoint,
    picture: &Picture,
    from: u64,
    to: u64,
) -> Result<Option<Peak>> {
    let (half, out, inward) = picture.model.reach_mm();
    let half = half.max(out).max(inward) * picture.px_per_mm() * 1.05 + 4.0 * from as f64;
    let Some(window) = around(start, half, half, &source.info().bounds()) else { return Ok(None) };
    let finest = read_around(source, window, picture.model, to, from.max(to))?;
    let mut level = from.max(to);
    let mut best: Option<(Peak, Grey)> = None;
    // The cut that shows the mark best at the first level is kept.
    for cut in cuts(picture.model) {
        let grey = level_ground(&finest, *cut);
        let peak = picture.at(level).and_then(|t| ascend(&grey.decimated((level / to) as usize), t, start));
        if let Some(peak) = peak.filter(|p| best.as_ref().is_none_or(|b| p.score > b.0.score)) {
            best = Some((peak, grey));
        }
    }
    let Some((mut peak, finest)) = best else { return Ok(None) };
    while level > to {
        level /= 2;
        let grey = finest.decimated((level / to) as usize);
        let Some(next) = picture.at(level).and_then(|t| ascend(&grey, t, peak.centre)) else { return Ok(None) };
        peak = next;
    }
    Ok(Some(peak))
}

/// Values along one side of the field in which [`ascend`] moves, and how far it looks around a place.
const FIELD: usize = 15;
const LOOK: usize = 2;

/// Walks uphill from `start` until no place within two values is better, not further than seven values; then to a
/// fraction by the parabola through the neighbours. `None` when the template does not lie inside at the start.
pub fn ascend(grey: &Grey, template: &Template, start: PixelPoint) -> Option<Peak> {
    let [x0, y0] = grey.from_scan(start).map(|v| v.floor() as i64 - (FIELD / 2) as i64);
    let mut known: [Option<Option<f64>>; FIELD * FIELD] = [None; FIELD * FIELD];
    let mut at = |i: usize, j: usize| {
        *known[j * FIELD + i].get_or_insert_with(|| score_at(grey, template, x0 + i as i64, y0 + j as i64))
    };
    let (mut i, mut j) = (FIELD / 2, FIELD / 2);
    let mut best = f64::MIN;
    loop {
        let (ci, cj) = (i, j);
        for n in cj.saturating_sub(LOOK)..=(cj + LOOK).min(FIELD - 1) {
            for m in ci.saturating_sub(LOOK)..=(ci + LOOK).min(FIELD - 1) {
                if let Some(score) = at(m, n).filter(|s| *s > best) {
                    (best, i, j) = (score, m, n);
                }
            }
        }
        if (i, j) == (ci, cj) {
            break;
        }
    }
    let score = at(i, j)?;
    let mut side = |di: i64, dj: i64| {
        let (m, n) = (i as i64 + di, j as i64 + dj);
        let inside = (0..FIELD as i64).contains(&m) && (0..FIELD as i64).contains(&n);
        if inside { at(m as usize, n as usize) } else { None }
    };
    let dx = parabola(side(-1, 0), score, side(1, 0));
    let dy = parabola(side(0, -1), score, side(0, 1));
    let (x, y) = ((x0 + i as i64) as f64 + 0.5 + dx, (y0 + j as i64) as f64 + 0.5 + dy);
    Some(Peak { centre: grey.to_scan(x, y), score })
}

/// Where between −½ and ½ the parabola through three neighbouring scores is highest.
fn parabola(before: Option<f64>, here: f64, after: Option<f64>) -> f64 {
    match (before, after) {
        (Some(a), Some(b)) if a + b - 2.0 * here < -1e-9 => (0.5 * (a - b) / (a + b - 2.0 * here)).clamp(-0.5, 0.5),
        _ => 0.0,
    }
}

/// Local maxima within `reach_px` of a prediction at the decimation `level`, best first, at most `most`; better places beyond do
/// not count, however near.
///
/// # Errors
/// Those of reading the scan.
pub fn near(
    source: &dyn RasterSource,
    predicted: PixelPoint,
    picture: &Picture,
    reach_px: f64,
    level: u64,
    most: usize,
) -> Result<Vec<Peak>> {
    let (half, out, inward) = picture.model.reach_mm();
    let half = half.max(out).max(inward) * picture.px_per_mm() * 1.05 + reach_px + 4.0 * level as f64;
    let Some(window) = around(predicted, half, half, &source.info().bounds()) else { return Ok(vec![]) };
    let Some(template) = picture.at(level) else { return Ok(vec![]) };
    let read = read_around(source, window, picture.model, level, level)?;
    let reach = (reach_px / level as f64).ceil() as usize + 1;
    let side = 2 * reach + 1;
    let mut peaks: Vec<Peak> = vec![];
    for cut in cuts(picture.model) {
        let grey = level_ground(&read, *cut);
        let [x0, y0] = grey.from_scan(predicted).map(|v| v.floor() as i64 - reach as i64);
        let scores = correlate(&grey, template, [x0, y0], side, side);
        for (i, j) in (1..side - 1).flat_map(|j| (1..side - 1).map(move |i| (i, j))) {
            // −1: the template does not lie inside.
            let at =
                |di: usize, dj: usize| Some(f64::from(scores[(j + dj - 1) * side + i + di - 1])).filter(|s| *s > -1.0);
            let Some(score) = at(1, 1).filter(|s| *s >= LEAST_SCORE) else { continue };
            if (0..9).any(|k| at(k % 3, k / 3).is_none_or(|s| s > score)) {
                continue;
            }
            let dx = parabola(at(0, 1), score, at(2, 1));
            let dy = parabola(at(1, 0), score, at(1, 2));
            let (x, y) = ((x0 + i as i64) as f64 + 0.5 + dx, (y0 + j as i64) as f64 + 0.5 + dy);
            peaks.push(Peak { centre: grey.to_scan(x, y), score });
        }
    }
    peaks.sort_by(|a, b| b.score.total_cmp(&a.score));
    peaks.truncate(most);
    Ok(peaks)
}

/// The best place within `reach` values of `start`, to a fraction by the parabola through its neighbours. `doubt` is taken
/// off the score of a place when places are compared.
pub fn climb(
    grey: &Grey,
    template: &Template,
    start: PixelPoint,
    reach: i64,
    doubt: impl Fn(PixelPoint) -> f64,
) -> Option<Peak> {
    let [x, y] = grey.from_scan(start).map(|v| v.floor() as i64);
    let at = |x: i64, y: i64| score_at(grey, template, x, y);
    let mut best = (x, y, f64::MIN, f64::MIN);
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let Some(s) = at(x + dx, y + dy) else { continue };
            let worth = s - doubt(grey.to_scan((x + dx) as f64 + 0.5, (y + dy) as f64 + 0.5));
            if worth > best.3 {
                best = (x + dx, y + dy, s, worth);
            }
        }
    }
    let (x, y, score, worth) = best;
    if worth == f64::MIN {
        return None;
    }
    let dx = parabola(at(x - 1, y), score, at(x + 1, y));
    let dy = parabola(at(x, y - 1), score, at(x, y + 1));
    Some(Peak { centre: grey.to_scan(x as f64 + 0.5 + dx, y as f64 + 0.5 + dy), score })
}

/// How well the template fits with its reference value on value (x, y): its correlation, or the mean of its sectors'
/// correlations by their shares. `None` when the template does not lie inside.
pub fn score_at(grey: &Grey, t: &Template, x: i64, y: i64) -> Option<f64> {
    if t.parts.is_empty() {
        return correlation_at(grey, t, x, y);
    }
    let mut score = 0.0;
    for (share, part) in &t.parts {
        score += f64::from(*share) * correlation_at(grey, part, x, y)?;
    }
    Some(score)
}

fn correlation_at(grey: &Grey, t: &Template, x: i64, y: i64) -> Option<f64> {
    let (left, top) = (x - t.reference[0], y - t.reference[1]);
    let inside =
        left >= 0 && top >= 0 && left as usize + t.width <= grey.width && top as usize + t.height <= grey.height;
    if !inside {
        return None;
    }
    Some(widest(Single { grey, t, left: left as usize, top: top as usize }))
}

/// The correlation with the template's corner on one value.
struct Single<'a> {
    grey: &'a Grey,
    t: &'a Template,
    left: usize,
    top: usize,
}

impl Kernel for Single<'_> {
    type Output = f64;

    #[inline(always)]
    fn run(self) -> f64 {
        let Single { grey, t, left, top } = self;
        // About a value of the patch, so that squares lose no digits.
        let base = grey.at(left + t.width / 2, top + t.height / 2);
        let (mut s1, mut s2, mut st) = (0.0f64, 0.0f64, 0.0f64);
        for j in 0..t.height {
            let row = &grey.data[(top + j) * grey.width + left..][..t.width];
            let values = &t.values[j * t.width..][..t.width];
            let weights = &t.weights[j * t.width..][..t.width];
            let (mut a, mut b, mut c) = ([0.0f32; 8], [0.0f32; 8], [0.0f32; 8]);
            let ((r8, r), (v8, v), (w8, w)) = (row.as_chunks::<8>(), values.as_chunks::<8>(), weights.as_chunks::<8>());
            for k in 0..r8.len() {
                add_products(base, [&r8[k], &v8[k], &w8[k]], [&mut a, &mut b, &mut c]);
            }
            if !r.is_empty() {
                // Filled up with values of no weight.
                let (mut r8, mut v8, mut w8) = ([base; 8], [0.0; 8], [0.0; 8]);
                for i in 0..r.len() {
                    (r8[i], v8[i], w8[i]) = (r[i], v[i], w[i]);
                }
                add_products(base, [&r8, &v8, &w8], [&mut a, &mut b, &mut c]);
            }
            s1 += f64::from(a.iter().sum::<f32>());
            s2 += f64::from(b.iter().sum::<f32>());
            st += f64::from(c.iter().sum::<f32>());
        }
        let n = f64::from(t.weight_sum);
        let variance = (s2 / n - (s1 / n).powi(2)).max(0.0) + f64::from(FLAT * FLAT);
        st / n / variance.sqrt()
    }
}

/// Adds weighted values, their squares and their products with the template's.
#[inline(always)]
fn add_products(base: f32, [row, values, weights]: [&[f32; 8]; 3], [a, b, c]: [&mut [f32; 8]; 3]) {
    for i in 0..8 {
        let d = row[i] - base;
        let wd = weights[i] * d;
        a[i] += wd;
        b[i] += wd * d;
        c[i] += wd * values[i];
    }
}

/// Cuts values above a level a little brighter than the opaque frame, for marks whose transparent parts show the image: what
/// lies behind them (snow beside rock) then hardly counts. The level is a share of the way from the dark peak of the
/// histogram to the bright side: the soft form of the 2017 thesis's threshold in the valley after the dark peak. Unlike a
/// threshold it keeps the edges' positions, and it needs no second attempt with equalisation where there is no valley.
pub fn level_ground(grey: &Grey, cut: Option<f32>) -> Grey {
    let mut levelled = grey.clone();
    let Some(cut) = cut.filter(|_| !grey.data.is_empty()) else { return levelled };
    let mut sample: Vec<f32> = grey.data.iter().step_by(grey.data.len().div_ceil(4_000)).copied().collect();
    sample.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| sample[((sample.len() - 1) as f64 * share) as usize];
    let (dark, bright) = (at(0.05), at(0.75));
    let limit = dark + (cut * (bright - dark)).max(8.0 * FLAT);
    levelled.data.iter_mut().for_each(|v| *v = v.min(limit));
    levelled
}

/// Where values are cut between dark and bright, each tried. The lower takes uneven ground away; the upper stays above the
/// bands and the grain of very dark frames, which reach further into the opaque frame than a third of the way.
fn cuts(model: &Model) -> &'static [Option<f32>] {
    if model.is_drawn() && model.shows_image() { &[Some(0.35), Some(0.8)] } else { &[None] }
}

/// The highest local maxima, no two within `radius`, best first.
fn highest(scores: &[f32], width: usize, height: usize, radius: usize, most: usize) -> Vec<(usize, usize, f32)> {
    let mut maxima = vec![];
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let s = scores[y * width + x];
            // Coarse pictures blur thin lines: half of the final limit.
            if f64::from(s) < 0.5 * LEAST_SCORE {
                continue;
            }
            let around = |dx: usize, dy: usize| scores[(y + dy - 1) * width + x + dx - 1];
            if (0..9).all(|k| around(k % 3, k / 3) <= s) {
                maxima.push((x, y, s));
            }
        }
    }
    maxima.sort_by(|a, b| b.2.total_cmp(&a.2));
    let mut kept: Vec<(usize, usize, f32)> = vec![];
    for m in maxima {
        if kept.len() == most {
            break;
        }
        if kept.iter().all(|k| k.0.abs_diff(m.0).max(k.1.abs_diff(m.1)) > radius) {
            kept.push(m);
        }
    }
    kept
}
