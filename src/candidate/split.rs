//! Marks that touch: one region, several candidates.
//!
//! The middle of each mark is the local maximum of a smoothed map of how well the colour fits; every pixel of the
//! region goes to its nearest middle, and each part is examined as if the others were other paint.

use super::Candidate;
use super::examine::{examine_part, examine_whole, figure_of, near};
use super::figure::{Figure, filled};
use super::gates::{Gates, eccentricity};
use super::looks::Looks;
use super::pixel_set::{PixelSet, region_of};
use super::scene::{OwnPaint, Scene};
use super::score::score;
use crate::profile::Profile;
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::{Patch, Pixels};

/// Ground in the paint's colour has a middle every few pixels: so many are no marks that touch, and each costs an
/// examination.
const MOST_PARTS: usize = 256;

/// [`super::examine()`] for a region that may be several marks: the whole, or its parts when one of them is likelier a
/// mark than the whole.
pub fn examine_parts(
    region: &Region,
    pixels: &dyn Pixels,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Vec<Candidate> {
    let inner = near(pixels, region);
    let Some(scene) = Scene::new(region, &inner, classifier, OwnPaint::Piece) else { return Vec::new() };
    match figure_of(&scene, region, pixels, classifier, profile) {
        Figure::Is(candidate) => return vec![*candidate],
        Figure::Elsewhere => return Vec::new(),
        Figure::No => {}
    }
    let single = gates.single(region);
    let whole = single.then(|| examine_whole(&scene, pixels, region, classifier, profile, gates)).flatten();
    let middles = middles(&scene, region, classifier, profile, gates.mark_side_px().0);
    let as_large_as_one = is_as_large_as_one(region, profile);
    let is_one = whole.is_some() && as_large_as_one && is_one_piece(&scene, region);
    if middles.len() < 2 || middles.len() > MOST_PARTS || is_one {
        return whole.into_iter().collect();
    }
    let mut owned = vec![PixelSet::empty(scene.width, scene.height); middles.len()];
    scene.own.iter().for_each(|i| owned[nearest(&middles, position(&scene, i))].insert(i));
    let paint = scene.paint();
    let parts: Vec<Candidate> = owned
        .into_iter()
        .filter_map(|own| {
            let part = region_of(&own, &inner)?;
            examine_part(&Scene::of_pixels(&inner, own, &paint), pixels, &part, classifier, profile, gates)
        })
        .collect();
    let parts = apart(parts, gates.mark_side_px().0 / 2.0);
    match whole {
        Some(whole) if !are_likelier(&parts, &whole, as_large_as_one) => vec![whole],
        _ => parts,
    }
}

/// Whether parts are marks rather than the whole is. Of a worn mark the part without holes is a better square than the
/// whole, so that one part alone must be far likelier; of marks that touch each is one, and they are larger than one.
fn are_likelier(parts: &[Candidate], whole: &Candidate, as_large_as_one: bool) -> bool {
    /// Logarithm of the odds.
    const FAR: f64 = 4.0;
    let best = parts.iter().filter_map(|c| c.score).fold(f64::NEG_INFINITY, f64::max);
    let lead = if parts.len() == 1 && as_large_as_one { FAR } else { 0.0 };
    whole.score.is_none_or(|score| best > score + lead)
}

/// Whether a region is no larger than the largest example.
fn is_as_large_as_one(region: &Region, profile: &Profile) -> bool {
    const SLACK: f64 = 1.1;
    let largest_px = profile.learned.as_ref().map_or(0.0, |learned| SLACK * learned.side_px_max);
    region.area as f64 <= largest_px * largest_px
}

/// Whether a region has no waist and is no longer than wide: marks that touch have, or are.
fn is_one_piece(scene: &Scene<'_>, region: &Region) -> bool {
    const LEAST_FILL: f64 = 0.94;
    /// Half as long again as it is wide.
    const MOST_ECCENTRICITY: f64 = 0.75;
    eccentricity(region) <= MOST_ECCENTRICITY && filled(&scene.own, scene.width) >= LEAST_FILL
}

/// Two parts of one mark give its centre twice: of candidates closer than `least_px` the likeliest stays, in the old
/// order.
fn apart(parts: Vec<Candidate>, least_px: f64) -> Vec<Candidate> {
    let near = |a: &Candidate, b: &Candidate| (a.centre.x - b.centre.x).hypot(a.centre.y - b.centre.y) < least_px;
    let beaten = |i: usize| {
        (0..parts.len()).any(|j| {
            let (mine, other) = (parts[i].score, parts[j].score);
            i != j && near(&parts[i], &parts[j]) && (other > mine || other == mine && j < i)
        })
    };
    (0..parts.len()).filter(|&i| !beaten(i)).map(|i| parts[i].clone()).collect()
}

fn position(scene: &Scene<'_>, i: usize) -> (f64, f64) {
    ((i % scene.width) as f64, (i / scene.width) as f64)
}

fn nearest(middles: &[(f64, f64)], p: (f64, f64)) -> usize {
    let distance = |m: &(f64, f64)| (m.0 - p.0).powi(2) + (m.1 - p.1).powi(2);
    (0..middles.len()).min_by(|&a, &b| distance(&middles[a]).total_cmp(&distance(&middles[b]))).unwrap_or(0)
}

/// Local maxima of the smoothed map that are at least about a mark's smallest side apart, in raster order; `region` is
/// the one that the scene is of.
fn middles(
    scene: &Scene<'_>,
    region: &Region,
    classifier: &Classifier,
    profile: &Profile,
    smallest_px: f64,
) -> Vec<(f64, f64)> {
    let apart = (1.1 * smallest_px).max(3.0);
    let (w, h) = (region.bounds.width as f64, region.bounds.height as f64);
    if (w - 1.0).hypot(h - 1.0) < apart {
        // No room for two, and with one the region is whole.
        return Vec::new();
    }
    let passes = if smallest_px > 6.0 { 3 } else { 1 };
    // The map is nothing beyond.
    let frame = region.bounds.grown(passes, &scene.patch.window);
    let (left, top) = ((frame.x - scene.patch.window.x) as usize, (frame.y - scene.patch.window.y) as usize);
    let (width, height) = (frame.width as usize, frame.height as usize);
    let in_scene = |i: usize| (top + i / width) * scene.width + left + i % width;
    let limit2 = profile.colour.limit * profile.colour.limit;
    let fitting = |i: usize| {
        if !scene.own.has(i) {
            return 0.0;
        }
        let c = scene.colour(i);
        let unit = [c[0], c[1], c[2]].map(|v| v.clamp(0.0, 255.0) / 255.0);
        1.0 - 0.5 * (classifier.reference().nearest2(unit) / limit2).min(1.0)
    };
    let mut map: Vec<f64> = (0..width * height).map(|i| fitting(in_scene(i))).collect();
    for _ in 0..passes {
        map = smoothed(&map, width);
    }
    let highest = |i: usize| {
        let (x, y) = (i % width, i / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        (y.saturating_sub(1)..(y + 2).min(height)).all(|v| columns.clone().all(|u| map[v * width + u] <= map[i]))
    };
    let mut peaks: Vec<usize> = (0..map.len()).filter(|&i| scene.own.has(in_scene(i)) && highest(i)).collect();
    peaks.sort_by(|&a, &b| map[b].total_cmp(&map[a]).then(a.cmp(&b)));
    let mut kept: Vec<usize> = Vec::new();
    for i in peaks.into_iter().map(in_scene) {
        let (x, y) = position(scene, i);
        let clear = kept.iter().all(|&k| {
            let (u, v) = position(scene, k);
            (x - u).hypot(y - v) >= apart
        });
        if clear {
            kept.push(i);
        }
    }
    kept.sort_unstable();
    kept.into_iter().map(|i| position(scene, i)).collect()
}

/// The binomial filter 1-2-1 in both directions; nothing beyond the edge.
fn smoothed(map: &[f64], width: usize) -> Vec<f64> {
    let blend = |before: f64, here: f64, after: f64| 0.25 * before + 0.5 * here + 0.25 * after;
    let mut across = Vec::with_capacity(map.len());
    for row in map.chunks_exact(width) {
        let at = |x: usize| row.get(x).copied().unwrap_or(0.0);
        across.extend((0..width).map(|x| blend(if x > 0 { row[x - 1] } else { 0.0 }, row[x], at(x + 1))));
    }
    let at = |i: usize| across.get(i).copied().unwrap_or(0.0);
    (0..map.len()).map(|i| blend(if i >= width { across[i - width] } else { 0.0 }, across[i], at(i + width))).collect()
}

/// Score of a set of pixels that is known to be a mark; `None` when it has fewer than three.
pub(crate) fn score_of(
    patch: &Patch,
    own: &PixelSet,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<f64> {
    let region = region_of(own, patch)?;
    // Nothing may be given up as hopeless: the least score is what is asked for.
    let mut profile = profile.clone();
    profile.examine.min_score = f64::NEG_INFINITY;
    let scene = Scene::of_pixels(patch, own.clone(), own);
    let looks = Looks { region: &region, classifier, profile: &profile, gates };
    Some(score(&looks.measure_scene(&scene, None), &profile, gates))
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{colour, patch_of};
    use super::*;
    use autoref_raster::coords::PixelPoint;

    fn is_piece(wanted: impl Fn(f64, f64) -> bool) -> bool {
        let set = PixelSet::from_fn(48, 48, |i| wanted((i % 48) as f64 - 23.5, (i / 48) as f64 - 23.5));
        let patch = patch_of(|i| colour(i, set.has(i)));
        let region = region_of(&set, &patch).expect("paint");
        is_one_piece(&Scene::of_pixels(&patch, set.clone(), &set), &region)
    }

    #[test]
    fn squares_and_discs_are_one_piece_and_two_that_touch_are_not() {
        assert!(is_piece(|x, y| x.abs().max(y.abs()) < 8.0));
        assert!(is_piece(|x, y| x.hypot(y) < 9.0));
        assert!(is_piece(|x, y| (x + y).abs() < 12.0 && (x - y).abs() < 12.0));
        assert!(!is_piece(|x, y| (x.abs() - 6.0).abs() < 6.5 && y.abs() < 6.0), "side by side");
        assert!(!is_piece(|x, y| (x - 5.0).hypot(y - 5.0).min((x + 5.0).hypot(y + 5.0)) < 7.0), "two discs");
        assert!(!is_piece(|x, y| x.abs().max(y.abs()) < 9.0 && x.abs().min(y.abs()) < 4.0), "a cross");
    }

    #[test]
    fn one_part_alone_must_be_far_likelier_than_the_whole() {
        let of = |score: f64| Candidate { score: Some(score), ..Candidate::at(PixelPoint { x: 0.0, y: 0.0 }) };
        assert!(!are_likelier(&[of(5.0)], &of(1.0), true));
        assert!(are_likelier(&[of(9.0)], &of(1.0), true));
        assert!(are_likelier(&[of(5.0), of(2.0)], &of(1.0), true));
        assert!(are_likelier(&[of(5.0)], &of(1.0), false));
        assert!(!are_likelier(&[], &of(1.0), true));
    }
}
