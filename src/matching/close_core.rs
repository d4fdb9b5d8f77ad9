//! Most marks of a pattern agree far more closely than all of them do: the others stand beside their points, as old
//! paint does and parts of marks. Chance would hardly draw so close a core from marks that are all off alike.

use crate::matching::evidence::CLOSEST_PX;
use crate::matching::far::root_mean_square;
use crate::matching::names::log10_choose;
use crate::matching::predictions::spread_from_pair;
use crate::matching::settle::centre_and_spread;
use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_solve::Similarity;
use autoref_solve::departure::{Departure, Residual};
use autoref_solve::similarity::{Pair, fit_equal_weights};
use autoref_solve::variance_ratio::chance_of_share;

/// Marks agree too closely for chance when it would produce less than one such core in so many patterns.
const CORE_LOG10: f64 = -4.0;
/// The mean square of a core's distances from its middle, as a part of the whole pattern's; a cluster says nothing of
/// an image that is bent.
const LEAST_EXTENT: f64 = 0.4;
/// Marks do not agree more closely.
const LEAST_OFF_PX: f64 = 0.1;
/// Fewer marks are no core.
const FEWEST_IN_CORE: usize = 4;
/// Pairs of marks that are asked what they tell, at most about.
const MOST_ASKED: usize = 2_000;
/// A pair that lies close together would put every mark anywhere.
const MOST_SPREAD: f64 = 2.0;
/// A mark within so many of its own stated deviations is where it says.
const OWN_SIGMAS: f64 = 3.0;
/// A mark stands beside its point when it is farther off than the core by this factor, and this many pixels.
const BESIDE_TIMES: f64 = 4.0;
const BESIDE_PX: f64 = 2.0;

/// Were all marks off by the noise of all: how often the squares of the best choice of so many would be as small a
/// share, log₁₀.
fn log10_by_chance((core, close): (&Similarity, &[Pair]), loose: &[Pair]) -> Option<f64> {
    let freedom = 2 * close.len() - 4;
    let squares = |similarity: &Similarity, pairs: &[Pair]| -> f64 {
        pairs.iter().map(|pair| off_px(similarity, pair).powi(2)).sum()
    };
    let close_px2 = squares(core, close).max(freedom as f64 * LEAST_OFF_PX * LEAST_OFF_PX);
    let share = close_px2 / squares(&fit_equal_weights(loose)?, loose);
    let chance = chance_of_share(share, freedom, 2 * (loose.len() - close.len()));
    Some(log10_choose(loose.len(), close.len()) + chance.log10())
}

/// What a core tells of all marks.
#[derive(Debug, PartialEq)]
pub(crate) struct CloseCore {
    /// Of each mark, whether it does not stand beside its point.
    pub stays: Vec<bool>,
    /// 1σ of a coordinate within the core.
    pub noise_px: f64,
}

/// Which marks do not stand beside their points, when most agree so closely that chance is no reason and neither is an
/// image that is stretched or bent about its `middle`; `None` when there is nothing of the kind. A mark that states
/// itself to be unsure is not asked.
pub(crate) fn close_core(marks: &[Pair], handedness: Handedness, middle: Option<PixelPoint>) -> Option<CloseCore> {
    if marks.len() <= FEWEST_IN_CORE {
        return None;
    }
    // Turned over, what is left to fit is an image that is not mirrored.
    let upright = |p: PixelPoint| PixelPoint { x: handedness.sign() * p.x, ..p };
    let marks: Vec<Pair> = marks.iter().map(|mark| Pair { pixel: upright(mark.pixel), ..*mark }).collect();
    let middle = middle.map_or_else(|| centre_and_spread(&marks).0, upright);
    let of = |stays: &[bool]| -> Vec<Pair> {
        marks.iter().zip(stays).filter(|(_, stays)| **stays).map(|(mark, _)| *mark).collect()
    };
    let told = told_by_pairs(&marks)?;
    let similarity = fit_equal_weights(&of(&told))?;
    let core = of(&told);
    let reach_px = BESIDE_PX.max(BESIDE_TIMES * root_mean_square(&similarity, &core));
    let is_beside = |mark: &Pair| {
        let off_px = off_px(&similarity, mark);
        off_px > reach_px && off_px > OWN_SIGMAS * own_px(mark, &similarity)
    };
    let stays: Vec<bool> = marks.iter().map(|mark| !is_beside(mark)).collect();
    let asked: Vec<Pair> =
        marks.iter().zip(&told).filter(|(mark, told)| **told || is_beside(mark)).map(|(mark, _)| *mark).collect();
    let mean_square = |pairs: &[Pair]| centre_and_spread(pairs).1 / pairs.len() as f64;
    let is_cluster = mean_square(&core) < LEAST_EXTENT * mean_square(&asked);
    let is_most = 3 * core.len() >= 2 * asked.len() && core.len() < asked.len();
    if core.len() < FEWEST_IN_CORE || !is_most || is_cluster || is_moved_part(&similarity, &marks, &stays) {
        return None;
    }
    let is_chance = log10_by_chance((&similarity, &core), &asked)? > CORE_LOG10;
    let noise_px = root_mean_square(&similarity, &core);
    (!is_chance && departure(&marks, middle).is_none()).then_some(CloseCore { stays, noise_px })
}

/// Whether the marks that do not stay are all off one way, as a part of the image is beyond a seam: they are where it
/// shows them.
fn is_moved_part(similarity: &Similarity, marks: &[Pair], stays: &[bool]) -> bool {
    /// How far they differ, as a part of the way.
    const ALIKE: f64 = 0.3;
    let off = |mark: &Pair| {
        let p = similarity.invert(mark.map);
        [mark.pixel.x - p.x, mark.pixel.y - p.y]
    };
    let offs: Vec<[f64; 2]> =
        marks.iter().zip(stays).filter(|(_, stays)| !**stays).map(|(mark, _)| off(mark)).collect();
    let mean = [0, 1].map(|k| offs.iter().map(|off| off[k]).sum::<f64>() / offs.len() as f64);
    let unlike_px = offs.iter().map(|off| (off[0] - mean[0]).hypot(off[1] - mean[1])).fold(0.0, f64::max);
    offs.len() > 1 && unlike_px <= BESIDE_PX.max(ALIKE * mean[0].hypot(mean[1]))
}

/// The most marks that two of them, taken as exact, put within [`CLOSEST_PX`] of where they are, or what its spread
/// makes of that; of as many, those that agree best.
fn told_by_pairs(marks: &[Pair]) -> Option<Vec<bool>> {
    let pairs = marks.len() * (marks.len() - 1) / 2;
    let all = (0..marks.len()).flat_map(|i| (i + 1..marks.len()).map(move |j| (i, j)));
    let mut best: Option<(usize, f64, Vec<bool>)> = None;
    for (i, j) in all.step_by(pairs.div_ceil(MOST_ASKED)) {
        let (a, b) = (marks[i].map, marks[j].map);
        let Some(similarity) = Similarity::through([marks[i].pixel, marks[j].pixel], [a, b]) else { continue };
        let mut squares = 0.0;
        let told = |mark: &Pair| {
            let off = off_px(&similarity, mark) / spread_from_pair(a, b, mark.map).min(MOST_SPREAD);
            let is_near = off <= CLOSEST_PX;
            squares += if is_near { off * off } else { 0.0 };
            is_near
        };
        let told: Vec<bool> = marks.iter().map(told).collect();
        let count = told.iter().filter(|told| **told).count();
        if best.as_ref().is_none_or(|known| count > known.0 || (count == known.0 && squares < known.1)) {
            best = Some((count, squares, told));
        }
    }
    best.map(|(_, _, told)| told)
}

/// How the similarity of all marks says that the image is stretched or bent, if it does.
fn departure(marks: &[Pair], middle: PixelPoint) -> Option<Departure> {
    let similarity = fit_equal_weights(marks)?;
    let residual = |mark: &Pair| {
        let there = similarity.apply(mark.pixel);
        Residual {
            pixel: mark.pixel,
            east_m: mark.map.easting - there.easting,
            north_m: mark.map.northing - there.northing,
        }
    };
    let residuals: Vec<Residual> = marks.iter().map(residual).collect();
    Departure::of(&residuals, Handedness::AsIs, middle)
}

/// What a mark and its survey say of themselves, 1σ, pixels.
fn own_px(mark: &Pair, similarity: &Similarity) -> f64 {
    let mark_px2 = mark.covariance_px2.map_or(0.0, |c| c[0].max(c[2]));
    let survey_px = mark.survey_sigma_m.map_or(0.0, |sigma_m| sigma_m / similarity.scale_m_per_px());
    (mark_px2 + survey_px * survey_px).sqrt()
}

fn off_px(similarity: &Similarity, pair: &Pair) -> f64 {
    let p = similarity.invert(pair.map);
    (p.x - pair.pixel.x).hypot(p.y - pair.pixel.y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::coords::GeoTransform;
    use autoref_raster::random::SplitMix64;

    const GROUND: GeoTransform = GeoTransform([570_000.0, 0.03, 0.004, 7_032_000.0, 0.004, -0.03]);

    const MIDDLE: Option<PixelPoint> = Some(PixelPoint { x: 2000.0, y: 1500.0 });

    /// Marks all over an image of 4000 × 3000 px, each off by what it is told, pixels.
    fn marks(n: usize, random: &mut SplitMix64, mut off_px: impl FnMut(usize, PixelPoint) -> [f64; 2]) -> Vec<Pair> {
        let mark = |i| {
            let p = PixelPoint { x: 4000.0 * random.unit(), y: 3000.0 * random.unit() };
            let [x, y] = off_px(i, p);
            let pixel = PixelPoint { x: p.x + x, y: p.y + y };
            Pair { pixel, map: GROUND.apply(p), covariance_px2: Some([0.01, 0.0, 0.01]), survey_sigma_m: None }
        };
        (0..n).map(mark).collect()
    }

    #[test]
    fn old_marks_beside_their_points_are_told() {
        let mut told = 0;
        for seed in 0..100 {
            let (mut random, mut noise) = (SplitMix64(seed), SplitMix64(seed + 1000));
            let beside = |i: usize| i % 4 == 1;
            let drawn = marks(8, &mut random, |i, _| {
                let turn = noise.unit() * std::f64::consts::TAU;
                let old = if beside(i) { 6.0 + 9.0 * noise.unit() } else { 0.0 };
                [old * turn.cos() + 0.1 * noise.normal(), old * turn.sin() + 0.1 * noise.normal()]
            });
            let Some(core) = close_core(&drawn, Handedness::AsIs, MIDDLE) else { continue };
            let CloseCore { stays, noise_px } = core;
            assert!(noise_px < 0.3, "{noise_px}");
            assert!(stays.iter().enumerate().all(|(i, stays)| *stays != beside(i)), "{seed}: {stays:?}");
            told += 1;
            let turned: Vec<Pair> = drawn
                .iter()
                .map(|mark| Pair { pixel: PixelPoint { x: 4000.0 - mark.pixel.x, ..mark.pixel }, ..*mark })
                .collect();
            let mirrored = close_core(&turned, Handedness::Mirrored, MIDDLE);
            assert_eq!(mirrored.map(|core| core.stays), Some(stays), "{seed}");
        }
        assert!(told >= 80, "{told} of 100: some cores are clusters, some old marks lie alike");
    }

    #[test]
    fn noise_and_bent_images_have_no_core() {
        for n in [5, 6, 8, 12, 20] {
            let told = (0..400).filter(|&seed| {
                let (mut random, mut noise) = (SplitMix64(seed), SplitMix64(seed + 1000));
                let drawn = marks(n, &mut random, |_, _| [3.0 * noise.normal(), 3.0 * noise.normal()]);
                close_core(&drawn, Handedness::AsIs, MIDDLE).is_some()
            });
            let told = told.count();
            assert!(told <= 2, "{told} of 400 times {n} marks that are off by 3 px");
        }
        for n in [6, 8, 12] {
            let told = (0..200).filter(|&seed| {
                let (mut random, mut noise) = (SplitMix64(seed), SplitMix64(seed + 1000));
                let drawn = marks(n, &mut random, |_, p| {
                    let (u, v) = ((p.x - 2000.0) / 2500.0, (p.y - 1500.0) / 2500.0);
                    let bend = 15.0 * (u * u + v * v);
                    [bend * u + 0.1 * noise.normal(), bend * v + 0.1 * noise.normal()]
                });
                close_core(&drawn, Handedness::AsIs, MIDDLE).is_some()
            });
            let told = told.count();
            assert!(told <= 6, "{told} of 200 domes of {n} marks");
        }
    }

    /// What its deviation explains says nothing against a mark.
    #[test]
    fn an_unsure_mark_is_not_asked() {
        let mut random = SplitMix64(4);
        let mut drawn = marks(8, &mut random, |i, _| if i == 2 { [7.0, -3.0] } else { [0.02 * i as f64, 0.0] });
        assert_eq!(close_core(&drawn, Handedness::AsIs, MIDDLE).map(|core| core.stays[2]), Some(false));
        drawn[2].covariance_px2 = Some([9.0, 0.0, 9.0]);
        assert_eq!(close_core(&drawn, Handedness::AsIs, MIDDLE), None);
    }

    /// Marks beyond a seam stand where the image shows them.
    #[test]
    fn a_part_of_the_image_that_is_moved_stays() {
        let mut noise = SplitMix64(9);
        let drawn = marks(12, &mut SplitMix64(5), |i, _| {
            let seam = if i < 3 { [6.0, -4.0] } else { [0.0; 2] };
            seam.map(|off| off + 0.1 * noise.normal())
        });
        assert_eq!(close_core(&drawn, Handedness::AsIs, MIDDLE), None);
    }
}
