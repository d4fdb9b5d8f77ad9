//! Where in a window a mark may be: by correlation, coarse to fine.

use super::correlate::{FLAT, Matcher, Scores};
use super::picture::Picture;
use super::template::{Model, Template};
use super::window::{Grey, around, read_grey};
use autoref_raster::RasterSource;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::window::Window;

/// A place where a mark may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    pub centre: PixelPoint,
    /// Normalised correlation at the finest level, −1 to 1.
    pub score: f64,
}

/// Smallest side of a coarse template, in values.
const COARSE_PX: f64 = 16.0;
/// So many times as many places as are wanted are taken from the coarse picture; the next finer one tells which are
/// kept.
const MORE: usize = 3;
/// Largest side of the template that ranks the places of a search box, in values: enough to tell marks from clutter.
const RANK_PX: f64 = 110.0;
/// Largest side of the finest template, in values; finer levels add cost but no certainty.
const FINE_PX: f64 = 230.0;
/// Peaks below this are no marks.
const LEAST_SCORE: f64 = 0.3;
/// A mark that correlates less is looked at by a person.
pub(super) const GOOD_SCORE: f64 = 0.5;

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
    /// Those that suit the size of a mark and its finest detail in pixels.
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

/// The best places for the mark in `window`, at most `most`, best first, placed at the level [`Levels::rank`]. What the
/// reader keeps of the window is let go.
///
/// # Errors
/// Those of reading the scan.
pub fn search(source: &dyn RasterSource, window: Window, picture: &Picture, most: usize) -> Result<Vec<Peak>> {
    let levels = Levels::of(picture);
    let Some(matcher) = picture.at(levels.coarse) else { return Ok(vec![]) };
    let grey = read_around(source, window, picture.model, levels.coarse, levels.coarse)?;
    if matcher.width > grey.width || matcher.height > grey.height {
        return Ok(vec![]);
    }
    let cuts = cut(grey, picture.model);
    let grey = &cuts[0];
    let mut scores = vec![-1.0f32; grey.data.len()];
    for cut in &cuts {
        let now = matcher.over(cut).all([0, 0], grey.width, grey.height);
        scores.iter_mut().zip(now).for_each(|(b, n)| *b = b.max(n));
    }
    let radius = (matcher.width.min(matcher.height) / 3).max(2);
    // The best first; two coarse peaks can climb the same mark.
    let place = |starts: Vec<PixelPoint>, from: u64, to: u64| -> Result<Vec<Peak>> {
        let mut peaks = vec![];
        for start in starts {
            peaks.extend(settle(source, start, picture, from, to)?);
        }
        peaks.sort_by(|a: &Peak, b| b.score.total_cmp(&a.score));
        let mut kept: Vec<Peak> = vec![];
        for peak in peaks {
            let apart =
                |k: &Peak| (k.centre.x - peak.centre.x).hypot(k.centre.y - peak.centre.y) > 2.0 * levels.coarse as f64;
            if kept.iter().all(apart) {
                kept.push(peak);
            }
        }
        kept.truncate(most);
        Ok(kept)
    };
    let highest = highest(&scores, grey.width, grey.height, radius, MORE * most);
    let starts = highest.into_iter().map(|(x, y, _)| grey.to_scan(x as f64 + 0.5, y as f64 + 0.5)).collect();
    let finer = (levels.coarse / 2).max(levels.rank);
    let mut peaks = place(starts, levels.coarse, finer)?;
    if finer > levels.rank {
        peaks = place(peaks.iter().map(|p| p.centre).collect(), finer, levels.rank)?;
    }
    source.release(window);
    peaks.retain(|p| p.score >= LEAST_SCORE);
    Ok(peaks)
}

/// Reads a window for comparing at decimations from `factor` to `coarsest`, with room beyond the scan's edge for marks
/// of lines: what is beside them is opaque there as well. Marks that show the image keep to the scan, where they may
/// end in the scanner's glass.
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
    for grey in cut(finest, picture.model) {
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
pub fn ascend(grey: &Grey, matcher: &Matcher, start: PixelPoint) -> Option<Peak> {
    let [x0, y0] = grey.from_scan(start).map(|v| v.floor() as i64 - (FIELD / 2) as i64);
    let mut field = Field { scores: matcher.over(grey), x0, y0, rows: [None; FIELD] };
    let (mut i, mut j) = (FIELD / 2, FIELD / 2);
    let mut best = f64::MIN;
    loop {
        let (ci, cj) = (i, j);
        for n in cj.saturating_sub(LOOK)..=(cj + LOOK).min(FIELD - 1) {
            for m in ci.saturating_sub(LOOK)..=(ci + LOOK).min(FIELD - 1) {
                if let Some(score) = field.at(m, n).filter(|s| *s > best) {
                    (best, i, j) = (score, m, n);
                }
            }
        }
        if (i, j) == (ci, cj) {
            break;
        }
    }
    let score = field.at(i, j)?;
    let mut side = |di: i64, dj: i64| {
        let (m, n) = (i as i64 + di, j as i64 + dj);
        let inside = (0..FIELD as i64).contains(&m) && (0..FIELD as i64).contains(&n);
        if inside { field.at(m as usize, n as usize) } else { None }
    };
    let dx = parabola(side(-1, 0), score, side(1, 0));
    let dy = parabola(side(0, -1), score, side(0, 1));
    let (x, y) = ((x0 + i as i64) as f64 + 0.5 + dx, (y0 + j as i64) as f64 + 0.5 + dy);
    Some(Peak { centre: grey.to_scan(x, y), score })
}

/// Scores around a place, a row at a time where one of it is wanted.
struct Field<'a> {
    scores: Scores<'a>,
    x0: i64,
    y0: i64,
    rows: [Option<[f32; FIELD]>; FIELD],
}

impl Field<'_> {
    /// `None` where the template does not lie inside.
    fn at(&mut self, i: usize, j: usize) -> Option<f64> {
        let row = self.rows[j].get_or_insert_with(|| {
            let mut row = [-1.0; FIELD];
            self.scores.row(self.x0, self.y0 + j as i64, &mut row);
            row
        });
        Some(f64::from(row[i])).filter(|s| *s > -1.0)
    }
}

/// Where between −½ and ½ the parabola through three neighbouring scores is highest.
fn parabola(before: Option<f64>, here: f64, after: Option<f64>) -> f64 {
    match (before, after) {
        (Some(a), Some(b)) if a + b - 2.0 * here < -1e-9 => (0.5 * (a - b) / (a + b - 2.0 * here)).clamp(-0.5, 0.5),
        _ => 0.0,
    }
}

/// Local maxima within `reach_px` of a prediction at the decimation `level`, best first, at most `most`; better places
/// beyond do not count, however near.
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
    let Some(matcher) = picture.at(level) else { return Ok(vec![]) };
    let read = read_around(source, window, picture.model, level, level)?;
    let reach = (reach_px / level as f64).ceil() as usize + 1;
    let side = 2 * reach + 1;
    let mut peaks: Vec<Peak> = vec![];
    for grey in cut(read, picture.model) {
        let [x0, y0] = grey.from_scan(predicted).map(|v| v.floor() as i64 - reach as i64);
        let scores = matcher.over(&grey).all([x0, y0], side, side);
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

/// The best place within `reach` values of `start`, to a fraction by the parabola through its neighbours. `doubt` is
/// taken off the score of a place when places are compared.
pub fn climb(
    grey: &Grey,
    template: &Template,
    start: PixelPoint,
    reach: i64,
    doubt: impl Fn(PixelPoint) -> f64,
) -> Option<Peak> {
    // One value more on every side, for the parabola.
    let [x0, y0] = grey.from_scan(start).map(|v| v.floor() as i64 - reach - 1);
    let side = (2 * reach + 3) as usize;
    let scores = Matcher::of(template).over(grey).all([x0, y0], side, side);
    let at = |i: usize, j: usize| Some(f64::from(scores[j * side + i])).filter(|s| *s > -1.0);
    let place = |i: usize, j: usize, dx: f64, dy: f64| {
        grey.to_scan((x0 + i as i64) as f64 + 0.5 + dx, (y0 + j as i64) as f64 + 0.5 + dy)
    };
    let mut best: Option<(usize, usize, f64, f64)> = None;
    for (i, j) in (1..side - 1).flat_map(|j| (1..side - 1).map(move |i| (i, j))) {
        let Some(score) = at(i, j) else { continue };
        let worth = score - doubt(place(i, j, 0.0, 0.0));
        if best.is_none_or(|b| worth > b.3) {
            best = Some((i, j, score, worth));
        }
    }
    let (i, j, score, _) = best?;
    let dx = parabola(at(i - 1, j), score, at(i + 1, j));
    let dy = parabola(at(i, j - 1), score, at(i, j + 1));
    Some(Peak { centre: place(i, j, dx, dy), score })
}

/// The picture as each of the ways of cutting shows it. Values are cut above a level a little brighter than the opaque
/// frame for marks whose transparent parts show the image: what lies behind them (snow beside rock) then hardly counts.
/// The level is a share of the way from the dark peak of the histogram to the bright side: the soft form of the 2017
/// thesis's threshold in the valley after the dark peak. Unlike a threshold it keeps the edges' positions, and it needs
/// no second attempt with equalisation where there is no valley.
fn cut(grey: Grey, model: &Model) -> Vec<Grey> {
    if !(model.is_drawn() && model.shows_image()) || grey.data.is_empty() {
        return vec![grey];
    }
    let mut sample: Vec<f32> = grey.data.iter().step_by(grey.data.len().div_ceil(4_000)).copied().collect();
    let mut at = |share: f64| {
        let k = ((sample.len() - 1) as f64 * share) as usize;
        *sample.select_nth_unstable_by(k, f32::total_cmp).1
    };
    let (dark, bright) = (at(0.05), at(0.75));
    let below = |share: f32| {
        let limit = dark + (share * (bright - dark)).max(8.0 * FLAT);
        Grey { data: grey.data.iter().map(|v| v.min(limit)).collect(), ..grey }
    };
    CUTS.map(below).into()
}

/// Where values are cut between dark and bright, each tried. The lower takes uneven ground away; the upper stays above
/// the bands and the grain of very dark frames, which reach further into the opaque frame than a third of the way.
const CUTS: [f32; 2] = [0.35, 0.8];

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
