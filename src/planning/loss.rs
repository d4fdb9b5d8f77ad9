//! The loss of points that hurts most: which of them, when they are gone, leave the transform weakest at a place.

use autoref_raster::coords::MapPoint;

use super::strength::cofactor;

/// Up to so many different losses all are tried.
const MOST_TRIED: u64 = 100_000;
/// Clusters of points that are tried as what is left, about.
const MOST_CENTRES: usize = 200;

/// The largest cofactor at `at` that the loss of `lose` of the points can leave; two points are always left.
///
/// Among up to [`MOST_TRIED`] different losses it is the largest of all. Among more it is what exchanges of a lost
/// point for a kept one come to, so that a worse loss of as many points may remain unseen.
pub(super) fn worst_loss(places: &[MapPoint], at: MapPoint, lose: usize) -> f64 {
    let lose = lose.min(places.len().saturating_sub(2));
    let lost = match choices(places.len(), lose) {
        Some(_) => of_all(places, at, lose),
        None => by_exchanges(places, at, lose),
    };
    let left: Vec<MapPoint> = (0..places.len()).filter(|i| !lost.contains(i)).map(|i| places[i]).collect();
    cofactor(&left, at).unwrap_or(f64::INFINITY)
}

/// Ways to take `k` of `n`; `None` above [`MOST_TRIED`].
fn choices(n: usize, k: usize) -> Option<u64> {
    let k = k.min(n - k) as u64;
    (1..=k).try_fold(1, |ways, i| Some(ways * (n as u64 - k + i) / i).filter(|ways| *ways <= MOST_TRIED))
}

/// The first of the worst losses, all being tried.
fn of_all(places: &[MapPoint], at: MapPoint, lose: usize) -> Vec<usize> {
    let all = Sums::of(places, at);
    // The lost points in rising order, and the sums that are left before each was lost.
    let mut lost: Vec<usize> = Vec::with_capacity(lose);
    let mut before: Vec<Sums> = Vec::with_capacity(lose);
    let (mut left, mut next) = (all, 0);
    let (mut worst, mut worst_lost) = (f64::NEG_INFINITY, Vec::new());
    loop {
        if lost.len() == lose {
            let value = left.cofactor();
            if value > worst {
                (worst, worst_lost) = (value, lost.clone());
            }
        } else if next + lose - lost.len() <= places.len() {
            before.push(left);
            lost.push(next);
            left = left.without(places[next]);
            next += 1;
            continue;
        }
        let Some(last) = lost.pop() else { return worst_lost };
        left = before.pop().expect("as many as are lost");
        next = last + 1;
    }
}

/// The worse of what exchanges make of two losses: the points that are missed most, one after the other, and all but a
/// cluster. The first alone errs where most points are lost, the second where few are.
fn by_exchanges(places: &[MapPoint], at: MapPoint, lose: usize) -> Vec<usize> {
    let all = Sums::of(places, at);
    let starts = [one_after_the_other(places, all, lose), all_but_a_cluster(places, all, lose)];
    let ends = starts.map(|lost| exchanged(places, all, lost));
    ends.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("two starts").0
}

fn one_after_the_other(places: &[MapPoint], all: Sums, lose: usize) -> Vec<usize> {
    let (mut left, mut lost) = (all, Vec::with_capacity(lose));
    for _ in 0..lose {
        let value = |i: &usize| left.without(places[*i]).cofactor();
        let missed = kept(places, &lost).max_by(|a, b| value(a).total_cmp(&value(b)));
        let missed = missed.expect("two points or more are left");
        left = left.without(places[missed]);
        lost.push(missed);
    }
    lost
}

/// Keeps a point and those nearest to it: around the point that makes it worst.
fn all_but_a_cluster(places: &[MapPoint], all: Sums, lose: usize) -> Vec<usize> {
    let farthest = |centre: &MapPoint| {
        let square =
            |i: &usize| (places[*i].easting - centre.easting).powi(2) + (places[*i].northing - centre.northing).powi(2);
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.select_nth_unstable_by(lose, |a, b| square(b).total_cmp(&square(a)));
        order.truncate(lose);
        (all.without_these(places, &order).cofactor(), order)
    };
    let centres = places.iter().step_by(1 + places.len() / MOST_CENTRES).map(farthest);
    centres.max_by(|a, b| a.0.total_cmp(&b.0)).map(|worst| worst.1).unwrap_or_default()
}

/// Loses one that was kept and keeps one that was lost, always the exchange that makes it worst, until none makes it
/// worse; with the cofactor at the end.
fn exchanged(places: &[MapPoint], all: Sums, mut lost: Vec<usize>) -> (Vec<usize>, f64) {
    let mut left = all.without_these(places, &lost);
    // Every exchange makes it worse, so that no loss comes back; the bound is for rounding.
    for _ in 0..10 * places.len() {
        let pairs = kept(places, &lost).flat_map(|kept| (0..lost.len()).map(move |slot| (slot, kept)));
        let after = |(slot, kept): (usize, usize)| left.without(places[kept]).with(places[lost[slot]]);
        let best = pairs.map(|pair| (after(pair).cofactor(), pair)).max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, pair)) = best.filter(|best| best.0 > left.cofactor() * (1.0 + 1e-9)) else { break };
        left = after(pair);
        lost[pair.0] = pair.1;
    }
    (lost, left.cofactor())
}

fn kept(places: &[MapPoint], lost: &[usize]) -> impl Iterator<Item = usize> {
    (0..places.len()).filter(|i| !lost.contains(i))
}

/// Sums over points, about the middle of all of them: a point goes or comes at the cost of a few additions.
#[derive(Clone, Copy, Debug)]
struct Sums {
    middle: MapPoint,
    at: MapPoint,
    count: f64,
    easting: f64,
    northing: f64,
    squares: f64,
}

impl Sums {
    fn of(places: &[MapPoint], at: MapPoint) -> Sums {
        let first = places.first().copied().unwrap_or(at);
        let n = places.len().max(1) as f64;
        let mean = |f: fn(&MapPoint) -> f64| f(&first) + places.iter().map(|p| f(p) - f(&first)).sum::<f64>() / n;
        let middle = MapPoint { easting: mean(|p| p.easting), northing: mean(|p| p.northing) };
        let none = Sums { middle, at, count: 0.0, easting: 0.0, northing: 0.0, squares: 0.0 };
        places.iter().fold(none, |sums, p| sums.with(*p))
    }

    fn with(self, p: MapPoint) -> Sums {
        self.changed(p, 1.0)
    }

    fn without(self, p: MapPoint) -> Sums {
        self.changed(p, -1.0)
    }

    fn without_these(self, places: &[MapPoint], lost: &[usize]) -> Sums {
        lost.iter().fold(self, |sums, &i| sums.without(places[i]))
    }

    fn changed(self, p: MapPoint, sign: f64) -> Sums {
        let (e, n) = (p.easting - self.middle.easting, p.northing - self.middle.northing);
        Sums {
            count: self.count + sign,
            easting: self.easting + sign * e,
            northing: self.northing + sign * n,
            squares: self.squares + sign * (e * e + n * n),
            ..self
        }
    }

    /// That of [`cofactor`], but for rounding.
    fn cofactor(&self) -> f64 {
        let (e, n) = (self.easting / self.count, self.northing / self.count);
        let spread = self.squares - self.count * (e * e + n * n);
        let away =
            (self.at.easting - self.middle.easting - e).powi(2) + (self.at.northing - self.middle.northing - n).powi(2);
        if spread > 0.0 { 1.0 / self.count + away / spread } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::{unit, xorshift};

    /// Points drawn over a field of 300 × 200 m, every third of them near the one before it, and a corner beyond them.
    fn drawn(count: usize, seed: u64) -> (Vec<MapPoint>, MapPoint) {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut random = || unit(xorshift(&mut state));
        let mut places: Vec<MapPoint> = Vec::new();
        for i in 0..count {
            let (e, n) = (random(), random());
            let near = places.last().copied().filter(|_| i % 3 == 2);
            places.push(match near {
                Some(last) => MapPoint { easting: last.easting + 20.0 * e, northing: last.northing + 20.0 * n },
                None => MapPoint { easting: 570_000.0 + 300.0 * e, northing: 7_032_000.0 + 200.0 * n },
            });
        }
        (places, MapPoint { easting: 569_970.0, northing: 7_032_220.0 })
    }

    /// Every set of `lose` points by its bits, each fitted anew.
    fn brute_force(places: &[MapPoint], at: MapPoint, lose: u32) -> f64 {
        let left = |lost: u32| (0..places.len()).filter(|i| lost >> i & 1 == 0).map(|i| places[i]).collect::<Vec<_>>();
        (0..1u32 << places.len())
            .filter(|lost| lost.count_ones() == lose)
            .map(|lost| cofactor(&left(lost), at).unwrap_or(f64::INFINITY))
            .fold(0.0, f64::max)
    }

    #[test]
    fn few_losses_are_all_tried() {
        for seed in 1..=60 {
            for count in 5..=10 {
                let (places, at) = drawn(count, seed);
                for lose in 1..=3 {
                    let expected = brute_force(&places, at, lose);
                    let got = worst_loss(&places, at, lose as usize);
                    assert!((got / expected - 1.0).abs() < 1e-12, "{seed}, {lose} of {count}: {got} for {expected}");
                }
            }
        }
    }

    #[test]
    fn exchanges_come_near_the_worst_of_all() {
        let (mut same, mut all) = (0, 0);
        for seed in 1..=60 {
            for count in [8, 10, 12] {
                let (places, at) = drawn(count, seed);
                for lose in [1, 3, 6] {
                    let lost = by_exchanges(&places, at, lose as usize);
                    let left: Vec<MapPoint> = (0..count).filter(|i| !lost.contains(i)).map(|i| places[i]).collect();
                    assert_eq!(left.len(), count - lose as usize, "each lost once");
                    let ratio = (cofactor(&left, at).unwrap_or(f64::INFINITY) / brute_force(&places, at, lose)).sqrt();
                    assert!(ratio <= 1.0 + 1e-12, "{seed}, {lose} of {count}: {ratio}");
                    same += usize::from(ratio > 1.0 - 1e-9);
                    all += 1;
                }
            }
        }
        assert!(same * 100 >= all * 98, "{same} of {all}");
    }

    #[test]
    fn many_losses_are_bounded_and_points_in_one_place_are_no_answer() {
        assert_eq!((choices(6, 0), choices(6, 3), choices(85, 3)), (Some(1), Some(20), Some(98_770)));
        assert_eq!((choices(86, 3), choices(2000, 20), choices(2000, 1998)), (None, None, None));
        // Two of the three that are left when one is lost lie in one place.
        let place = |easting| MapPoint { easting, northing: 0.0 };
        assert_eq!(worst_loss(&[place(0.0), place(0.0), place(9.0)], place(5.0), 1), f64::INFINITY);
        let (many, at) = drawn(400, 7);
        let (few, most) = (worst_loss(&many, at, 2), worst_loss(&many, at, 20));
        assert!(most > few && most.is_finite(), "{few} {most}");
    }
}
