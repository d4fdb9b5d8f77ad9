//! What lies around the points of a group: gathered once for all of them, chosen from for each.

use std::cmp::Ordering;
use std::sync::Arc;

use autoref_raster::simd::{Kernel, widest};

use super::envelope::Offsets;
use crate::kdtree::{Bounds, Tree};
use crate::point::Point;

/// Surroundings at most, and at least.
const MOST: usize = 128;
const LEAST: usize = 6;
/// More points than these around a group are a crowd: a smaller halo will do.
const CROWD: usize = 2048;

/// Trees of the tiles around, with their numbers.
pub type Trees = [(usize, Arc<Tree>)];

/// What is asked of the surroundings.
#[derive(Clone, Copy, Debug)]
pub struct Question {
    pub radius: f64,
    /// How low a point must lie to be noise ([`Offsets::lowness`]).
    pub lowness: f64,
    /// How many low points beside each other, itself counted, a point may be one of.
    pub company: usize,
    /// Which neighbour's distance is told, at most [`super::envelope::NEAR`].
    pub neighbour: usize,
}

/// What was found of a point.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    pub low: bool,
    /// Squared distance of the neighbour, when the surroundings suffice to know it.
    pub distance2: Option<f64>,
}

/// What lies around a group of points, and buffers.
#[derive(Default)]
pub struct Surroundings {
    found: Vec<Point>,
    /// In the order of their coordinates, so that sums do not depend on tiles.
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    index: Vec<u64>,
    strips: Strips,
    nearest: Vec<[f64; 4]>,
    chosen: Chosen,
}

/// Of one point: what lies around it.
#[derive(Default)]
struct Chosen {
    /// Places in the lists of the group.
    places: Vec<u32>,
    distance2: Vec<f64>,
    ranked: Vec<f64>,
    offsets: Offsets,
    /// What is not chosen is at least so far in plan.
    beyond2: f64,
}

/// Points of a group that are still to be decided, by their place in it.
struct Part {
    open: Vec<usize>,
    halo: f64,
    growth: Growth,
}

/// Whether the halo was too small for these points before.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Growth {
    Free,
    Grown,
}

impl Part {
    fn halves(mut self, points: &[Point], axis: usize) -> [Part; 2] {
        self.open.sort_unstable_by(|&a, &b| points[a].xyz[axis].total_cmp(&points[b].xyz[axis]));
        let upper = self.open.split_off(self.open.len() / 2);
        let upper = Part { open: upper, halo: self.halo, growth: self.growth };
        [self, upper]
    }
}

impl Surroundings {
    /// What the surroundings tell of each point of a group.
    pub fn examine(&mut self, points: &[Point], trees: &Trees, question: &Question) -> Vec<Found> {
        let mut all = vec![Found { low: false, distance2: None }; points.len()];
        // Where all lie at one place, no halo is small enough.
        let least_halo = 1e-9 * question.radius;
        let first =
            Part { open: (0..points.len()).collect(), halo: first_halo(points, question.radius), growth: Growth::Free };
        let mut parts = vec![first];
        while let Some(mut part) = parts.pop() {
            let area = Bounds::of_places(part.open.iter().map(|&at| points[at].xyz));
            let axis = usize::from(area.max[1] - area.min[1] > area.max[0] - area.min[0]);
            let spread = area.max[axis] - area.min[axis];
            let several = part.open.len() > 1;
            // Points far apart, such as birds over a wood, have little around them in common.
            if several && spread > 4.0 * part.halo {
                parts.extend(part.halves(points, axis));
            } else if self.gather(area, trees, part.halo) {
                let widest = part.halo >= question.radius;
                part.open.retain(|&at| {
                    self.choose(&points[at], part.halo);
                    let decided = widest || self.chosen.offsets.len() >= MOST;
                    if decided {
                        all[at] = self.chosen.judge(question);
                    }
                    !decided
                });
                if !part.open.is_empty() {
                    let halo = (2.0 * part.halo).min(question.radius);
                    parts.push(Part { halo, growth: Growth::Grown, ..part });
                }
            } else if several && spread > part.halo {
                parts.extend(part.halves(points, axis));
            } else if part.growth == Growth::Grown || part.halo < least_halo {
                // Beside a crowd: such points search by themselves.
                for at in part.open {
                    self.search(&points[at], trees, question.radius);
                    all[at] = self.chosen.judge(question);
                }
            } else {
                parts.push(Part { halo: part.halo / 2.0, ..part });
            }
        }
        all
    }

    /// Takes in what lies within `halo` of the area in plan; whether it is no crowd.
    fn gather(&mut self, mut area: Bounds, trees: &Trees, halo: f64) -> bool {
        for axis in 0..2 {
            // Rounded outwards: the distance has the last word.
            let slack = outwards(halo, area.min[axis].abs() + area.max[axis].abs());
            area.min[axis] -= slack;
            area.max[axis] += slack;
        }
        self.found.clear();
        trees.iter().for_each(|(_, tree)| tree.within_in_plan(&area, CROWD, &mut self.found));
        if self.found.len() > CROWD {
            return false;
        }
        let order = self.strips.sort(&self.found, area.min[0], area.max[0]);
        self.x.clear();
        self.y.clear();
        self.z.clear();
        self.index.clear();
        for &at in order {
            let point = &self.found[at as usize];
            let [x, y, z] = point.xyz;
            self.x.push(x);
            self.y.push(y);
            self.z.push(z);
            self.index.push(point.index());
        }
        true
    }

    /// Chooses the at most [`MOST`] points nearest to `point` in plan and within `halo`, itself left out.
    fn choose(&mut self, point: &Point, halo: f64) {
        let [px, py, pz] = point.xyz;
        let slack = outwards(halo, px.abs());
        let strip = self.strips.between(px - slack, px + slack);
        let Surroundings { x, y, z, index, chosen, .. } = self;
        let Chosen { places, distance2, ranked, offsets, beyond2 } = chosen;
        let within = Within { x: &x[strip.clone()], y: &y[strip.clone()], px, py, limit2: halo * halo };
        widest(Select { within, first: strip.start as u32, distance2, places });
        let own = self.strips.between(px, px).find(|&at| index[at] == point.index());
        if let Some(at) = own.and_then(|own| places.binary_search(&(own as u32)).ok()) {
            places.remove(at);
        }
        *beyond2 = halo * halo;
        if places.len() > MOST {
            let place2 = |place: u32| distance2[place as usize - strip.start];
            ranked.clear();
            ranked.extend(places.iter().map(|&place| place2(place)));
            let farthest2 = *ranked.select_nth_unstable_by(MOST - 1, f64::total_cmp).1;
            places.retain(|&place| place2(place) <= farthest2);
            *beyond2 = farthest2;
        }
        if places.len() > MOST {
            // Of the equally far ones the lowest count, then those in the west and the south.
            let key = |&place: &u32| {
                let at = place as usize;
                [distance2[at - strip.start], z[at], x[at], y[at]]
            };
            places.sort_by(|a, b| order(&key(a), &key(b)));
            places.truncate(MOST);
            places.sort_unstable();
        }
        offsets.set(places.iter().map(|&place| {
            let at = place as usize;
            [x[at] - px, y[at] - py, z[at] - pz]
        }));
    }

    /// Chooses the at most [`MOST`] points nearest to `point` in plan by a search of its own.
    fn search(&mut self, point: &Point, trees: &Trees, radius: f64) {
        self.nearest.clear();
        for (_, tree) in trees {
            tree.nearest_in_plan(point, radius * radius, MOST, &mut self.nearest);
        }
        let full = self.nearest.len() >= MOST;
        self.chosen.beyond2 = self.nearest.last().filter(|_| full).map_or(radius * radius, |farthest| farthest[0]);
        self.nearest.sort_unstable_by(|[_, az, ax, ay], [_, bz, bx, by]| order(&[*ax, *ay, *az], &[*bx, *by, *bz]));
        let [px, py, pz] = point.xyz;
        self.chosen.offsets.set(self.nearest.iter().map(|[_, z, x, y]| [x - px, y - py, z - pz]));
    }
}

impl Chosen {
    fn judge(&mut self, question: &Question) -> Found {
        let enough = self.offsets.len() >= LEAST;
        let lowness = || self.offsets.lowness(question.company);
        let low = enough && lowness().is_some_and(|lowness| lowness >= question.lowness);
        Found { low, distance2: self.neighbour2(question.neighbour) }
    }

    /// Squared distance of the neighbour, when none of those that were not chosen can be nearer.
    fn neighbour2(&self, neighbour: usize) -> Option<f64> {
        let distance2 = self.offsets.nearest2()[neighbour - 1];
        (distance2 < self.beyond2).then_some(distance2)
    }
}

/// A halo that most points of the group find enough in: of the group's own density, or the whole radius.
fn first_halo(points: &[Point], radius: f64) -> f64 {
    let area = Bounds::of(points);
    let (width, height) = (area.max[0] - area.min[0], area.max[1] - area.min[1]);
    let side2 = (width * height).max((width.max(height) / 8.0).powi(2));
    let halo = 1.2 * (MOST as f64 * side2 / (points.len() as f64 * std::f64::consts::PI)).sqrt();
    if halo > 0.0 && 2.0 * halo < radius { halo } else { radius }
}

/// A length with the rounding of coordinates of a size added.
fn outwards(length: f64, size: f64) -> f64 {
    length + 1e-9 * (size + length)
}

fn order<const N: usize>(a: &[f64; N], b: &[f64; N]) -> Ordering {
    let pairs = a.iter().zip(b).map(|(a, b)| a.total_cmp(b));
    pairs.fold(Ordering::Equal, Ordering::then)
}

/// Points of a group's surroundings in strips of equal width from west to east.
#[derive(Default)]
struct Strips {
    west: f64,
    strips_per_metre: f64,
    /// The begin of each strip in the order, and the end of the last.
    begins: Vec<u32>,
    strip: Vec<u32>,
    order: Vec<u32>,
}

impl Strips {
    /// The places of the points in the order of x, y and z.
    fn sort(&mut self, points: &[Point], west: f64, east: f64) -> &[u32] {
        let count = points.len().max(1);
        self.west = west;
        self.strips_per_metre = if east > west { count as f64 / (east - west) } else { 0.0 };
        self.begins.clear();
        self.begins.resize(count + 2, 0);
        self.strip.clear();
        for point in points {
            let strip = self.of(point.xyz[0], count);
            self.strip.push(strip as u32);
            self.begins[strip + 2] += 1;
        }
        for strip in 2..self.begins.len() {
            self.begins[strip] += self.begins[strip - 1];
        }
        self.order.clear();
        self.order.resize(points.len(), 0);
        for (at, &strip) in self.strip.iter().enumerate() {
            let next = &mut self.begins[strip as usize + 1];
            self.order[*next as usize] = at as u32;
            *next += 1;
        }
        for strip in self.begins.windows(2) {
            let places = &mut self.order[strip[0] as usize..strip[1] as usize];
            if places.len() > 1 {
                places.sort_unstable_by(|&a, &b| order(&points[a as usize].xyz, &points[b as usize].xyz));
            }
        }
        &self.order
    }

    /// Places in the order that hold all points between two x, and a few more.
    fn between(&self, west: f64, east: f64) -> std::ops::Range<usize> {
        let count = self.begins.len() - 2;
        self.begins[self.of(west, count)] as usize..self.begins[self.of(east, count) + 1] as usize
    }

    fn of(&self, x: f64, count: usize) -> usize {
        // Places to the west of the first strip become 0.
        (((x - self.west) * self.strips_per_metre) as usize).min(count - 1)
    }
}

struct Within<'a> {
    x: &'a [f64],
    y: &'a [f64],
    px: f64,
    py: f64,
    limit2: f64,
}

/// Writes all squared distances in plan, and the places of those within the limit.
struct Select<'a> {
    within: Within<'a>,
    first: u32,
    distance2: &'a mut Vec<f64>,
    places: &'a mut Vec<u32>,
}

impl Kernel for Select<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Within { x, y, px, py, limit2 } = self.within;
        self.distance2.clear();
        self.distance2.extend(x.iter().zip(y).map(|(x, y)| (x - px) * (x - px) + (y - py) * (y - py)));
        self.places.clear();
        self.places.resize(x.len(), 0);
        let mut count = 0;
        for (at, &distance2) in self.distance2.iter().enumerate() {
            // Without a branch: one in two is within, and none can tell which.
            self.places[count] = self.first + at as u32;
            count += usize::from(distance2 <= limit2);
        }
        self.places.truncate(count);
    }
}
