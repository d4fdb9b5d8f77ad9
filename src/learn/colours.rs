//! Learning from colours alone: a table of samples, as the 2016 prototype took.

use nalgebra::Vector3;

use super::{LearnOptions, Lesson, density, widened};
use crate::profile::colour::{Metric, Space, lab_from_srgb};
use crate::profile::{ColourModel, Examine, Filters, GateLimits, Profile, Shape, Size, Target};
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

/// Fewest colours that say how the paint varies.
const FEWEST: usize = 10;

/// Learns a profile from samples of the paint's colour (sRGB 0..=1), for marks of this size.
///
/// The colour limit is 3.5 standard deviations, and never below what holds 95 % of the samples. Nothing is known of the
/// ground, so the scores are those of any profile.
///
/// # Errors
/// [`Error::Usage`] with fewer than ten colours, or for a rule that leaves no box.
pub fn learn_colours(name: &str, colours: Vec<[f64; 3]>, size: Size, options: &LearnOptions) -> Result<Lesson> {
    if colours.len() < FEWEST {
        return Err(Error::usage(
            format!("{} too little of how the paint varies", counted(colours.len(), "colour says", "colours say")),
            format!("give at least {FEWEST}, or one with --paint #RRGGBB in the main job"),
        ));
    }
    let (cloud, shape) = widened(&colours)?;
    let mut own: Vec<f64> = colours.iter().map(|c| shape.distance2(&lab_from_srgb(*c)).sqrt()).collect();
    own.sort_by(f64::total_cmp);
    let rough_box = options.rough_box.map(|rule| rule.of(&colours)).transpose()?;
    let profile = Profile {
        name: name.to_owned(),
        description: format!("Learned from {} colours", colours.len()),
        shape: Shape::Any,
        colour: ColourModel {
            space: Space::Lab,
            metric: Metric::Mahalanobis,
            limit: own[own.len() * 95 / 100].max(3.5),
            rough_box,
            rough: None,
            clouds: vec![cloud],
        },
        size,
        gates: GateLimits::default(),
        filters: Filters::default(),
        examine: Examine { split: true, density: options.density.then(|| density(&colours)), ..Examine::default() },
        target: Target::default(),
        tag: None,
        learned: None,
    };
    profile.validate()?;
    Ok(Lesson { profile, paint: colours })
}

/// Largest distance in a\*b\* of a colour of paint from the middle of the others. Paint in shade and sun, fresh and
/// worn, is within it; a car or a bush is not.
pub const LIKE_THE_OTHERS: f64 = 30.0;
/// In less light a colour moves towards L\* = -16, a\* = b\* = 0, by the cube root of the light: to half the way in an
/// eighth of it.
const DEEPEST_SHADE: f64 = 0.5;

/// Whether a colour lies apart from paint with this middle, in any light; both in L\*a\*b\*.
fn lies_apart(colour: &Vector3<f64>, middle: &Vector3<f64>) -> bool {
    let off = |share: f64| (colour[1] - share * middle[1]).hypot(colour[2] - share * middle[2]) > LIKE_THE_OTHERS;
    off(1.0) && off(((colour[0] + 16.0) / (middle[0] + 16.0)).clamp(DEEPEST_SHADE, 1.0))
}

/// Which of the colours (sRGB 0..=1) lie apart from those of one paint, which most of them must be: the colour that
/// most are like is sought, then the middle of these, until the same stay.
///
/// # Errors
/// [`Error::Usage`] when fewer than half are like each other.
pub fn apart_from_paint(colours: &[[f64; 3]]) -> Result<Vec<bool>> {
    /// Colours that are tried as the middle, and those that each is compared with.
    const TRIED: usize = 300;
    const COMPARED: usize = 3000;
    const ROUNDS: usize = 20;
    let lab: Vec<Vector3<f64>> = colours.iter().map(|c| lab_from_srgb(*c)).collect();
    // Evenly strewn: rows may come in turns.
    let mut order: Vec<usize> = (0..lab.len()).collect();
    if lab.len() > TRIED {
        order.sort_by_key(|i| (*i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    }
    let some = |most: usize| order.iter().take(most).map(|i| &lab[*i]);
    let like = |middle: &Vector3<f64>| some(COMPARED).filter(|colour| !lies_apart(colour, middle)).count();
    // The first of equals, so that the order of the table alone decides.
    let Some(start) = some(TRIED).rev().max_by_key(|middle| like(middle)) else { return Ok(Vec::new()) };
    let mut apart: Vec<bool> = lab.iter().map(|colour| lies_apart(colour, start)).collect();
    for _ in 0..ROUNDS {
        let kept: Vec<&Vector3<f64>> = lab.iter().zip(&apart).filter(|(_, apart)| !**apart).map(|(c, _)| c).collect();
        let middle = kept.iter().copied().sum::<Vector3<f64>>() / kept.len().max(1) as f64;
        let now: Vec<bool> = lab.iter().map(|colour| lies_apart(colour, &middle)).collect();
        if now == apart {
            break;
        }
        apart = now;
    }
    let kept = apart.iter().filter(|apart| !**apart).count();
    if kept * 2 < lab.len() {
        return Err(Error::usage(
            format!(
                "no more than {kept} of {} colours are of one paint (within {LIKE_THE_OTHERS} units of a*b*)",
                lab.len()
            ),
            "give a table of one paint",
        ));
    }
    Ok(apart)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Oranges in light of a tenth to all of the sun.
    fn oranges(count: u32) -> Vec<[f64; 3]> {
        let one = |i: u32| {
            let light = (0.1 + 0.9 * f64::from(i % 10) / 9.0).powf(1.0 / 2.2);
            [0.92 * light, (0.35 + 0.01 * f64::from(i % 7)) * light, (0.05 + 0.01 * f64::from(i % 5)) * light]
        };
        (0..count).map(one).collect()
    }

    #[test]
    fn rows_that_are_not_the_paint_lie_apart() {
        let clean = oranges(60);
        assert_eq!(apart_from_paint(&clean).expect("one paint"), vec![false; 60]);
        let others = [[0.2, 0.5, 0.15], [0.3, 0.3, 0.9], [0.6, 0.6, 0.62], [0.9, 0.2, 0.7]];
        let mixed: Vec<[f64; 3]> = clean.iter().copied().chain((0..40).map(|i| others[i % 4])).collect();
        let apart = apart_from_paint(&mixed).expect("most are paint");
        assert!(apart.iter().enumerate().all(|(i, apart)| *apart == (i >= 60)), "{apart:?}");
        let wheel: Vec<[f64; 3]> = (0..64u8).map(|i| [i % 4, i / 4 % 4, i / 16].map(|v| f64::from(v) / 3.0)).collect();
        let error = apart_from_paint(&wheel).expect_err("no paint").to_string();
        assert!(error.contains("of 64 colours are of one paint"), "{error}");
        assert!(apart_from_paint(&[]).expect("nothing").is_empty());
    }

    #[test]
    fn colours_make_a_profile_that_holds_them() {
        let colours: Vec<[f64; 3]> = (0..40).map(|i| [0.9, 0.4 + 0.002 * f64::from(i), 0.1]).collect();
        let size = Size { min_px: Some(5.0), max_px: Some(60.0), min_m: None, max_m: None };
        let lesson = learn_colours("amber", colours.clone(), size, &LearnOptions::default()).expect("enough");
        assert_eq!(lesson.profile.colour.limit, 3.5);
        assert!(learn_colours("amber", colours[..9].to_vec(), size, &LearnOptions::default()).is_err());
    }
}
