//! Sources on both sides of ±180°, whose longitudes jump there by a turn.

use crate::couple::TURN_DEGREES;
use crate::crs::Crs;
use crate::error::Result;
use crate::grid::Grid;
use autoref_raster::words::counted;

use super::source::{SNAP_PX, Source};

/// Longitudes that differ by less are one, degrees.
const SAME_DEGREES: f64 = 1e-6;

/// Moves sources by whole turns so that together they are as narrow as they can be; the first one stays. Maps that do
/// not count in degrees are left as they are.
pub fn bring_together(sources: &mut [Source]) {
    if !sources.first().is_some_and(is_in_degrees) {
        return;
    }
    let extents: Vec<(f64, f64)> = sources.iter().map(|source| west_and_east(&source.grid)).collect();
    let turns = turns_of(&extents);
    for (source, turns) in sources.iter_mut().zip(turns) {
        source.grid.x0 += turns * TURN_DEGREES;
    }
}

/// The west of one turn, where sources in degrees that lie within these bounds are together wider, and hold some ground
/// twice: that of the widest source, and so that the first one begins within the turn.
pub fn one_turn(sources: &[Source], [west, _, east, _]: [f64; 4]) -> Option<f64> {
    let first = sources.first().filter(|_| sources.len() > 1)?;
    if east - west <= TURN_DEGREES + SNAP_PX * first.grid.step_x || !is_in_degrees(first) {
        return None;
    }
    let extents = sources.iter().map(|source| west_and_east(&source.grid));
    let widest = extents.reduce(|a, b| if b.1 - b.0 > a.1 - a.0 + SAME_DEGREES { b } else { a })?;
    let turns = ((first.grid.x0 - widest.0 + SAME_DEGREES) / TURN_DEGREES).floor();
    Some(widest.0 + turns * TURN_DEGREES)
}

/// Brings a source by whole turns to where most of it lies in a mosaic of one turn, and again to where the rest does.
///
/// # Errors
/// When it cannot be opened a second time.
pub fn place_in(source: &mut Source, mosaic: &Grid) -> Result<()> {
    let ((west, east), (left, right)) = (west_and_east(&source.grid), west_and_east(mosaic));
    let common = |turns: f64| (east + turns * TURN_DEGREES).min(right) - (west + turns * TURN_DEGREES).max(left);
    let mut turns = [0.0, 1.0, -1.0, 2.0, -2.0];
    turns.sort_by(|a, b| common(*b).total_cmp(&common(*a)));
    let x0 = source.grid.x0;
    source.grid.x0 = x0 + turns[0] * TURN_DEGREES;
    let others = turns[1..].iter().filter(|turns| common(**turns) > SNAP_PX * mosaic.step_x);
    for turns in others {
        let mut again = Source::open(&source.path)?;
        again.grid.x0 = x0 + turns * TURN_DEGREES;
        source.again.push(again);
    }
    Ok(())
}

/// What to say where sources lie at both ends of a mosaic that runs around the Earth.
pub fn note_of_one_turn(sources: &[Source], mosaic: &Grid) -> Option<String> {
    let twice: Vec<&Source> = sources.iter().filter(|source| !source.again.is_empty()).collect();
    let degrees = |longitude: f64| (longitude * 1e9).round() / 1e9;
    let (west, east) = west_and_east(mosaic);
    let (west, east) = (degrees(west), degrees(east));
    let first = twice.first()?;
    let who = match twice.len() - 1 {
        0 => format!("{} lies", first.path.display()),
        n => format!("{} and {} lie", first.path.display(), counted(n, "other", "others")),
    };
    Some(format!(
        "the sources are together wider than 360°: the mosaic ends after one turn, from {west}° to {east}°, and {who} \
         at both of its ends"
    ))
}

/// The companion's grid by whole turns nearest to that of its source.
pub fn bring_to(companion: &mut Source, source: &Grid) {
    if is_in_degrees(companion) && companion.grid.overlap(source).is_none() {
        let apart = source.centre().0 - companion.grid.centre().0;
        companion.grid.x0 += (apart / TURN_DEGREES).round() * TURN_DEGREES;
    }
}

fn is_in_degrees(source: &Source) -> bool {
    Crs::parse(&source.wkt).is_ok_and(|crs| crs.counts_degrees())
}

fn west_and_east(grid: &Grid) -> (f64, f64) {
    let [west, _, east, _] = grid.bounds();
    (west, east)
}

/// By how many turns each extent is moved so that all of them together are narrowest: the circle is cut in its widest
/// gap. All zero where that saves nothing.
fn turns_of(extents: &[(f64, f64)]) -> Vec<f64> {
    let width = |places: &[(f64, f64)]| {
        let west = places.iter().fold(f64::INFINITY, |least, place| least.min(place.0));
        places.iter().fold(f64::NEG_INFINITY, |most, place| most.max(place.1)) - west
    };
    let mut narrowest = (width(extents) - SAME_DEGREES, vec![0.0; extents.len()]);
    // The cut is west of one of them. Beginnings in order, so that the widest gap is found in one pass.
    let on_circle = |longitude: f64| longitude.rem_euclid(TURN_DEGREES);
    let mut order: Vec<(f64, f64)> = extents.iter().map(|&(west, east)| (on_circle(west), east - west)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(first) = order.first().map(|(west, _)| *west) else { return Vec::new() };
    // Where the covered part ends, extents that run over the beginning of the circle included.
    let mut reached = order.iter().fold(f64::NEG_INFINITY, |most, (west, size)| most.max(west + size - TURN_DEGREES));
    let mut cut = (f64::NEG_INFINITY, first);
    for (west, size) in &order {
        if west - reached > cut.0 {
            cut = (west - reached, *west);
        }
        reached = reached.max(west + size);
    }
    let placed: Vec<f64> = extents
        .iter()
        .map(|&(west, _)| {
            let after = on_circle(west - cut.1);
            let after = if TURN_DEGREES - after < SAME_DEGREES { after - TURN_DEGREES } else { after };
            ((cut.1 + after - west) / TURN_DEGREES).round()
        })
        .collect();
    let turns: Vec<f64> = placed.iter().map(|turns| turns - placed[0]).collect();
    let moved: Vec<(f64, f64)> = extents
        .iter()
        .zip(&turns)
        .map(|((west, east), turns)| (west + turns * TURN_DEGREES, east + turns * TURN_DEGREES))
        .collect();
    if width(&moved) < narrowest.0 {
        narrowest.1 = turns;
    }
    narrowest.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_meets_at_180_is_joined_there_and_all_else_stays() {
        assert_eq!(turns_of(&[(179.0, 180.0), (-180.0, -179.0)]), [0.0, 1.0]);
        assert_eq!(turns_of(&[(-180.0, -179.0), (179.0, 180.0)]), [0.0, -1.0]);
        assert_eq!(turns_of(&[(10.0, 20.0), (-20.0, -5.0)]), [0.0, 0.0]);
        // Counted from 0° and from −180°.
        assert_eq!(turns_of(&[(200.0, 210.0), (-150.0, -140.0)]), [0.0, 1.0]);
        assert_eq!(turns_of(&[(-150.0, -140.0), (190.0, 210.0)]), [0.0, -1.0]);
        // Begun at one meridian, but for the last place of a number.
        assert_eq!(turns_of(&[(-170.0, -160.0), (190.0 - 1e-12, 191.0)]), [0.0, -1.0]);
        // The whole Earth is as wide as it is.
        assert_eq!(turns_of(&[(-180.0, 180.0), (170.0, 180.0)]), [0.0, 0.0]);
        assert_eq!(turns_of(&[(-180.0, 0.0), (0.0, 180.0)]), [0.0, 0.0]);
    }

    #[test]
    fn no_arrangement_is_narrower() {
        let mut dice = autoref_raster::random::SplitMix64(180);
        for _ in 0..200 {
            let extents: Vec<(f64, f64)> = (0..4)
                .map(|_| {
                    let west = (dice.unit() * 360.0).floor() - 180.0;
                    (west, west + 1.0 + (dice.unit() * 30.0).floor())
                })
                .collect();
            let width = |turns: &dyn Fn(usize) -> f64| {
                let moved =
                    || extents.iter().enumerate().map(|(i, e)| (e.0 + 360.0 * turns(i), e.1 + 360.0 * turns(i)));
                moved().fold(f64::MIN, |most, e| most.max(e.1)) - moved().fold(f64::MAX, |least, e| least.min(e.0))
            };
            let found = turns_of(&extents);
            let least = (0..81usize)
                .map(|choice| {
                    let turn = |i: usize| (choice / 3usize.pow(i as u32) % 3) as f64 - 1.0;
                    width(&turn)
                })
                .fold(f64::INFINITY, f64::min);
            assert!((width(&|i| found[i]) - least).abs() < 1e-9, "{extents:?}: {found:?}, {least} is possible");
        }
    }
}
