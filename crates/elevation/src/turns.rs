//! Polygons and lines whose longitudes count from elsewhere than a model's.

use crate::couple::TURN_DEGREES;
use crate::zones::{Ring, Zones};
use autoref_raster::words::some_of;

/// West and east of a ring.
fn reach(ring: &[(f64, f64)]) -> (f64, f64) {
    ring.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(west, east), p| (west.min(p.0), east.max(p.0)))
}

fn turned(ring: &Ring, turns: f64) -> Ring {
    ring.iter().map(|&(x, y)| (x + turns * TURN_DEGREES, y)).collect()
}

/// The longitude by whole turns nearest to another.
pub(crate) fn nearest(x: f64, to: f64) -> f64 {
    x + turns_towards(x, to) * TURN_DEGREES
}

/// None where it is as near as it can be.
fn turns_towards(x: f64, to: f64) -> f64 {
    let apart = (to - x) / TURN_DEGREES;
    if apart.abs() <= 0.5 { 0.0 } else { apart.round() }
}

/// Takes out the jumps at ±180° that a transform has made of one side; `before` is the ring in degrees, where it was in
/// degrees. A ring around a pole stays as it is.
pub(crate) fn join(ring: &mut Ring, before: Option<&Ring>) {
    const HALF: f64 = TURN_DEGREES / 2.0;
    let jumps = |ring: &Ring, i: usize| (ring[(i + 1) % ring.len()].0 - ring[i].0).abs() > HALF;
    let made = |i: usize| jumps(ring, i) && !before.is_some_and(|before| jumps(before, i));
    let mut turns = vec![0.0; ring.len()];
    let mut turn = 0.0;
    for i in 0..ring.len() {
        turns[i] = turn;
        if made(i) {
            turn -= (ring[(i + 1) % ring.len()].0 - ring[i].0).signum();
        }
    }
    if turn == 0.0 {
        ring.iter_mut().zip(turns).for_each(|(place, turns)| place.0 += turns * TURN_DEGREES);
    }
}

/// Brings the holes of a polygon, its rings after the first, to where that lies.
pub(crate) fn bring_holes(polygon: &mut [Ring]) {
    let Some((outer, holes)) = polygon.split_first_mut() else { return };
    let (west, east) = reach(outer);
    for hole in holes {
        let own = reach(hole);
        let inside = |turns: &f64| {
            let by = turns * TURN_DEGREES;
            own.0 + by >= west && own.1 + by <= east
        };
        if let Some(turns) = [0.0, 1.0, -1.0].into_iter().find(inside) {
            *hole = turned(hole, turns);
        }
    }
}

/// Each polygon of each area by whole turns nearest to the middle of a model in degrees, and a turn away again where it
/// meets the model there too: models run all around the Earth.
pub(crate) fn zones_beside(areas: Vec<(String, Vec<Vec<Ring>>)>, [west, _, east, _]: [f64; 4]) -> Zones {
    let areas = areas.into_iter().map(|(name, polygons)| {
        let (mut own, mut again) = (Vec::new(), Vec::new());
        for polygon in polygons {
            let reach = polygon.first().map_or((0.0, 0.0), |ring| reach(ring));
            let turns = turns_towards((reach.0 + reach.1) / 2.0, (west + east) / 2.0);
            for by in [-1.0, 1.0] {
                let moved = (turns + by) * TURN_DEGREES;
                if reach.0 + moved < east && reach.1 + moved > west {
                    again.extend(polygon.iter().map(|ring| turned(ring, turns + by)));
                }
            }
            own.extend(polygon.iter().map(|ring| turned(ring, turns)));
        }
        (name, own, again)
    });
    Zones::placed(areas)
}

/// What to say of zones without a cell, each with whether it has any area.
pub(crate) fn notes_of_empty(zones: impl Iterator<Item = (String, bool)>) -> Vec<String> {
    let (beside, flat): (Vec<_>, Vec<_>) = zones.partition(|(_, has_area)| *has_area);
    let names = |zones: Vec<(String, bool)>| zones.into_iter().map(|(name, _)| name).collect::<Vec<_>>();
    let flat = names(flat);
    let (noun, have) = if flat.len() == 1 { ("zone", "has") } else { ("zones", "have") };
    let flat = (!flat.is_empty())
        .then(|| format!("{noun} {} {have} no area, and no cell: look at the geometry in QGIS", some_of(&flat)));
    note_of_outside(&names(beside)).into_iter().chain(flat).collect()
}

/// What to say of areas without a cell.
pub(crate) fn note_of_outside(names: &[String]) -> Option<String> {
    let (noun, have, places) =
        if names.len() == 1 { ("zone", "has", "its place") } else { ("zones", "have", "their places") };
    let named = some_of(names);
    (!names.is_empty())
        .then(|| format!("{noun} {named} {have} no cell with heights in both models: look at {places} and CRS"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(west: f64, east: f64) -> Ring {
        vec![(west, 0.0), (east, 0.0), (east, 1.0), (west, 1.0)]
    }

    #[test]
    fn what_a_transform_cut_is_one_again() {
        let mut ring = vec![(179.9, 0.0), (-179.9, 0.0), (-179.9, 1.0), (179.9, 1.0)];
        let mut written = ring.clone();
        join(&mut ring, None);
        let wests: Vec<f64> = ring.iter().map(|p| p.0).collect();
        assert!(wests.iter().zip([179.9, 180.1, 180.1, 179.9]).all(|(a, b)| (a - b).abs() < 1e-9), "{wests:?}");
        // What was so in the file is meant so.
        let before = written.clone();
        join(&mut written, Some(&before));
        assert_eq!(written, before);
        let mut pole = vec![(0.0, 80.0), (120.0, 80.0), (-120.0, 80.0)];
        join(&mut pole, None);
        assert_eq!(pole[2].0, -120.0);
        let mut polygon = vec![square(179.0, 182.0), square(-179.5, -179.0)];
        bring_holes(&mut polygon);
        assert_eq!(polygon[1], square(180.5, 181.0));
    }

    #[test]
    fn zones_come_to_where_the_model_counts() {
        // Beside a model across 180°, one from 0° on, and one around the Earth, of which a zone lies at both ends.
        for (ring, bounds, cells) in [
            (square(-180.0, -179.0), [179.0, 0.0, 182.0, 1.0], 180.0..181.0),
            (square(-10.0, -9.0), [340.0, 0.0, 360.0, 1.0], 350.0..351.0),
            (square(350.0, 351.0), [-20.0, 0.0, 5.0, 1.0], -10.0..-9.0),
            (square(179.0, 181.0), [-180.0, 0.0, 180.0, 1.0], -180.0..-179.0),
            (square(179.0, 181.0), [-180.0, 0.0, 180.0, 1.0], 179.0..180.0),
        ] {
            let width_deg = ring[1].0 - ring[0].0;
            let zones = zones_beside(vec![("zone".into(), vec![vec![ring]])], bounds);
            let mut row = vec![0; ((bounds[2] - bounds[0]) * 10.0) as usize];
            zones.row(0.5, bounds[0] + 0.05, 0.1, &mut row);
            for (i, &zone) in row.iter().enumerate() {
                let x = bounds[0] + (i as f64 + 0.5) * 0.1;
                assert!(zone == 1 || !cells.contains(&x), "{x} in {cells:?}");
            }
            let metre = crate::grid::GroundUnit::Projected { metres_per_unit: 1.0 };
            assert!((zones.areas_m2(&metre)[0] - width_deg).abs() < 1e-6, "counted once");
            assert!(zones.outside(bounds).is_empty());
            assert_eq!(zones.outside([20.0, 0.0, 30.0, 1.0]), ["zone"]);
        }
        assert_eq!(note_of_outside(&[]), None);
        assert!(note_of_outside(&["7".into()]).is_some_and(|note| note.starts_with("zone 7 has no cell")));
        let many: Vec<String> = (1..=8).map(|number| number.to_string()).collect();
        assert!(note_of_outside(&many).is_some_and(|note| note.starts_with("zones 1, 2, 3, 4, 5 and 3 more have")));
    }
}
