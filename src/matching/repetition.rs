//! Lists that lie upon themselves when they are moved or turned: rows in equal steps, regular grids.
//!
//! Whatever part of such a list has marks, the same marks fit the moved list as well but for those at its ends, and
//! neither is believed ([`super::rivals`]). A long search would end with the same answer.

use rayon::prelude::*;

use crate::matching::Priors;
use crate::matching::field::Field;
use crate::matching::search::LONG;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::random::Mmix;
use autoref_raster::ranks::upper_median;

/// Share of the points that lie on others, at least.
const REPEATED: f64 = 0.9;
/// Points lie on others when they are no farther off than this share of the usual distance between neighbours.
const OFF_OF_STEP: f64 = 0.01;
/// Pairs of points that are laid on others as long. Of a list of which nine tenths repeat one of so many is of these,
/// but for one case in a hundred.
const BASES: usize = 3;
/// What moves less, in such lengths, stays where it is.
const MOVED: f64 = 10.0;
/// Points that are looked at before the others, and how many of them must lie on others to go on.
const FIRST: (usize, usize) = (20, 12);

/// A move of the list by which it lies upon itself.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Repetition {
    /// How far its middle moves, metres.
    moved_m: f64,
    turned_deg: f64,
    /// For each point the one that it lies on then.
    onto: Vec<Option<usize>>,
}

/// Which way points are moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Way {
    On,
    Back,
}

impl Repetition {
    /// The move, other than none, by which most of a long list lies upon itself; where the direction of north is known,
    /// one that turns it no farther than a rival may be turned.
    pub fn of(gcps: &[MapPoint], priors: &Priors) -> Option<Repetition> {
        // Shorter lists are searched in no time.
        if gcps.len() < LONG {
            return None;
        }
        let middle = middle(gcps);
        let place = |g: &MapPoint| PixelPoint { x: g.easting - middle.easting, y: g.northing - middle.northing };
        let points: Vec<PixelPoint> = gcps.iter().map(place).collect();
        let off_m = OFF_OF_STEP * usual_step(&points);
        if off_m <= 0.0 {
            return None;
        }
        let field = Field::new(points, None);
        let mut draws = Mmix(0x5851_F42D_4C95_7F2D);
        let most_turned_deg = priors.rotation_deg.map_or(180.0, |(_, half)| 2.0 * half);
        (0..BASES).find_map(|_| {
            let base = inner_pair(field.points(), &mut draws)?;
            by_base(&field, base, (off_m, most_turned_deg))
        })
    }

    /// Candidates joined to points, the points moved on by the repetition, or back.
    pub fn moved(&self, pairs: &[(usize, usize)], way: Way) -> Vec<(usize, usize)> {
        let to = |gcp: usize| match way {
            Way::On => self.onto[gcp],
            Way::Back => self.onto.iter().position(|onto| *onto == Some(gcp)),
        };
        pairs.iter().filter_map(|&(candidate, gcp)| Some((candidate, to(gcp)?))).collect()
    }

    /// What is said of it to who is refused.
    pub fn advice(&self) -> String {
        let Repetition { moved_m, turned_deg, onto } = self;
        let (points, of) = (onto.iter().flatten().count(), onto.len());
        let moved = match turned_deg.abs() < 0.05 {
            true => format!("moved by {moved_m:.2} m"),
            false => format!("turned by {turned_deg:.1}° about its middle and moved by {moved_m:.2} m"),
        };
        format!(
            "the list repeats itself: {moved}, {points} of its {of} points lie on others, so that marks alone cannot tell where \
             they are. Give only the points that can be in the image (--names), or number the targets"
        )
    }
}

fn middle(gcps: &[MapPoint]) -> MapPoint {
    let n = gcps.len() as f64;
    MapPoint {
        easting: gcps.iter().map(|g| g.easting).sum::<f64>() / n,
        northing: gcps.iter().map(|g| g.northing).sum::<f64>() / n,
    }
}

fn distance(p: PixelPoint, q: PixelPoint) -> f64 {
    (p.x - q.x).hypot(p.y - q.y)
}

/// Median of the distances of points to their neighbours.
fn usual_step(points: &[PixelPoint]) -> f64 {
    let square = |p: PixelPoint, q: PixelPoint| (p.x - q.x).powi(2) + (p.y - q.y).powi(2);
    // Smaller of two without a branch, and a point of its own on either side.
    let least = |least: f64, s: f64| if s < least { s } else { least };
    let nearest = |i: usize| {
        let others = points[..i].iter().chain(&points[i + 1..]);
        others.map(|q| square(points[i], *q)).fold(f64::INFINITY, least)
    };
    let mut steps: Vec<f64> = (0..points.len()).into_par_iter().map(|i| nearest(i).sqrt()).collect();
    upper_median(&mut steps).expect("a list is long")
}

/// Two points of the inner half, far from each other: what is moved by a few steps is still in the list.
fn inner_pair(points: &[PixelPoint], draws: &mut Mmix) -> Option<(usize, usize)> {
    let from_middle = |p: PixelPoint| p.x.hypot(p.y);
    let mut inner: Vec<usize> = (0..points.len()).collect();
    inner.sort_by(|i, j| from_middle(points[*i]).total_cmp(&from_middle(points[*j])).then(i.cmp(j)));
    inner.truncate(points.len() / 2);
    let reach = from_middle(points[*inner.last()?]);
    let one = inner[draws.below(inner.len())];
    let far: Vec<usize> = inner.into_iter().filter(|other| distance(points[one], points[*other]) >= reach).collect();
    (!far.is_empty()).then(|| (one, far[draws.below(far.len())]))
}

/// The least move that lays a pair on another one as long, and most points on points.
fn by_base(field: &Field, (a, b): (usize, usize), (off_m, most_turned_deg): (f64, f64)) -> Option<Repetition> {
    let points = field.points();
    let length = distance(points[a], points[b]);
    let (least, most) = ((length - off_m).max(0.0).powi(2), (length + off_m).powi(2));
    let is_as_long = |c: usize, d: usize| {
        let square = (points[c].x - points[d].x).powi(2) + (points[c].y - points[d].y).powi(2);
        (least..=most).contains(&square)
    };
    let ends_from = |c: usize| {
        let moved = move |d: usize| {
            let move_m = distance(points[a], points[c]).max(distance(points[b], points[d]));
            (move_m > MOVED * off_m).then_some((move_m, c, d))
        };
        (0..points.len()).filter(move |d| is_as_long(c, *d)).filter_map(moved)
    };
    let mut ends: Vec<(f64, usize, usize)> = (0..points.len()).into_par_iter().flat_map_iter(ends_from).collect();
    ends.par_sort_by(|s, t| s.0.total_cmp(&t.0).then((s.1, s.2).cmp(&(t.1, t.2))));
    ends.into_iter().find_map(|(_, c, d)| {
        let direction = |from: usize, to: usize| (points[to].y - points[from].y).atan2(points[to].x - points[from].x);
        let turn = direction(c, d) - direction(a, b);
        let turned_deg = turn.to_degrees();
        let turned_deg = turned_deg - 360.0 * (turned_deg / 360.0).round();
        if turned_deg.abs() > most_turned_deg {
            return None;
        }
        let (sin, cos) = turn.sin_cos();
        let moved = |p: PixelPoint| {
            let (x, y) = (p.x - points[a].x, p.y - points[a].y);
            PixelPoint { x: points[c].x + cos * x - sin * y, y: points[c].y + sin * x + cos * y }
        };
        let onto = |i: usize| field.nearest(moved(points[i]), off_m).map(|(on, _)| on);
        let step = points.len() / FIRST.0;
        if (0..FIRST.0).filter(|k| onto(k * step).is_some()).count() < FIRST.1 {
            return None;
        }
        let onto: Vec<Option<usize>> = (0..points.len()).map(onto).collect();
        let middle = moved(PixelPoint { x: 0.0, y: 0.0 });
        let repeats = onto.iter().flatten().count() as f64 >= REPEATED * points.len() as f64;
        repeats.then(|| Repetition { moved_m: middle.x.hypot(middle.y), turned_deg, onto })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::SplitMix64;

    fn of(gcps: &[MapPoint]) -> Option<Repetition> {
        Repetition::of(gcps, &Priors::default())
    }

    fn at(places: impl Iterator<Item = (f64, f64)>) -> Vec<MapPoint> {
        places.map(|(x, y)| MapPoint { easting: 570_000.0 + x, northing: 7_030_000.0 + y }).collect()
    }

    /// Rows, to the millimetre, and grids with a tenth of their points missing.
    #[test]
    fn rows_and_grids_repeat_themselves() {
        let rounded = |v: f64| (v * 1000.0).round() / 1000.0;
        let row = at((0..150).map(|i| (rounded(0.9137 * f64::from(i)), rounded(0.3011 * f64::from(i)))));
        let found = of(&row).expect("a row in equal steps");
        assert!((found.moved_m - 0.962).abs() < 0.002 && found.turned_deg.abs() < 0.05, "{found:?}");
        assert_eq!(found.onto.iter().flatten().count(), 149);
        assert!(found.advice().contains("moved by 0.96 m, 149 of its 150 points"), "{}", found.advice());
        let [on, back] = [Way::On, Way::Back].map(|way| found.moved(&[(7, 20), (9, 149), (3, 0)], way));
        assert_eq!((on.len(), back.len()), (2, 2), "an end has no next point: {on:?}, {back:?}");
        assert_eq!((on[0].0, back[0].0), (7, 7));
        assert_eq!(on[0].1.abs_diff(20) + back[0].1.abs_diff(20), 2, "a step on and a step back");

        let cell = |i: u32| (13.0 * f64::from(i % 20), 8.0 * f64::from(i / 20));
        let missing = |i: &u32| i % 31 != 7;
        assert!(of(&at((0..400).filter(missing).map(cell))).is_some());
    }

    /// Half a turn about the middle of a list lays it on itself, whatever else it looks like.
    #[test]
    fn a_list_that_is_its_own_under_half_a_turn_repeats_itself() {
        let mut random = SplitMix64(3);
        let half: Vec<(f64, f64)> = (0..60).map(|_| (300.0 * random.unit(), 200.0 * random.unit())).collect();
        let turned = half.iter().map(|(x, y)| (310.0 - x, 200.0 - y));
        let list = at(half.iter().copied().chain(turned));
        let found = of(&list).expect("the same under half a turn");
        assert!((found.turned_deg.abs() - 180.0).abs() < 0.1 && found.moved_m < 0.1, "{found:?}");
        assert!(found.advice().contains("180.0°"), "{}", found.advice());
        let north_up = Priors { rotation_deg: Some((0.0, 15.0)), ..Priors::default() };
        assert_eq!(Repetition::of(&list, &north_up), None, "north tells which way round");
    }

    #[test]
    fn other_lists_do_not() {
        let mut random = SplitMix64(9);
        let mut unit = || random.unit();
        let anywhere: Vec<(f64, f64)> = (0..300).map(|_| (180.0 * unit(), 120.0 * unit())).collect();
        assert_eq!(of(&at(anywhere.iter().copied())), None);
        // Every point twice, a hand apart: half of them lie on others when moved by that.
        let twice = anywhere.iter().flat_map(|&(x, y)| [(x, y), (x + 0.1, y)]);
        assert_eq!(of(&at(twice)), None);
        // A road's two rows, irregular by a few decimetres.
        let road = at((0..200).map(|i| (0.9 * f64::from(i) + 0.3 * unit(), 3.0 * f64::from(i % 2) + 0.3 * unit())));
        assert_eq!(of(&road), None);
        assert_eq!(of(&at((0..20).map(|i| (f64::from(i), 0.0)))), None, "a short list");
        assert_eq!(of(&at((0..80).map(|_| (5.0, 5.0)))), None, "one place");
    }
}
