//! A k-d tree without pointers: points in the order of the tree, and one split per inner node (Friedman, Bentley &
//! Finkel, *An algorithm for finding best matches in logarithmic expected time*, 1977).
//!
//! Distances are compared as they are computed, and every bound is computed by the same operations in the same order,
//! so that rounding never lets a bound exceed a distance: what is found does not depend on the shape of the tree.

use crate::point::Point;

/// Points of a leaf at most.
const LEAF_POINTS: usize = 12;
/// Below this many points a branch is arranged by one thread.
const PARALLEL_POINTS: usize = 1 << 15;

/// An axis-parallel box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    pub min: [f64; 3],
    pub max: [f64; 3],
}

impl Bounds {
    /// The box of nothing.
    pub const EMPTY: Bounds = Bounds { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };

    /// Grows it to hold a place.
    pub fn add(&mut self, xyz: [f64; 3]) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(xyz[axis]);
            self.max[axis] = self.max[axis].max(xyz[axis]);
        }
    }

    /// Grows it to hold another box.
    pub fn merge(&mut self, other: &Bounds) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
    }

    /// The box of points.
    pub fn of(points: &[Point]) -> Bounds {
        Bounds::of_places(points.iter().map(|point| point.xyz))
    }

    /// The box of places.
    pub fn of_places(places: impl Iterator<Item = [f64; 3]>) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        places.for_each(|xyz| bounds.add(xyz));
        bounds
    }

    /// Whether it holds nothing.
    pub fn is_empty(&self) -> bool {
        self.min[0] > self.max[0]
    }

    /// The longest side.
    pub fn widest(&self) -> usize {
        let side = |axis: usize| self.max[axis] - self.min[axis];
        let xy = usize::from(side(1) > side(0));
        if side(2) > side(xy) { 2 } else { xy }
    }

    /// Squared distance of a place from the box; 0 inside.
    pub fn distance2(&self, xyz: [f64; 3]) -> f64 {
        let off = [0, 1, 2].map(|axis| (self.min[axis] - xyz[axis]).max(xyz[axis] - self.max[axis]).max(0.0));
        square(off)
    }

    /// Squared distance of two boxes in plan.
    pub fn gap2_in_plan(&self, other: &Bounds) -> f64 {
        let off = [0, 1].map(|axis| (self.min[axis] - other.max[axis]).max(other.min[axis] - self.max[axis]).max(0.0));
        off[0] * off[0] + off[1] * off[1]
    }

    /// Squared distance of two boxes; 0 when they touch.
    pub fn gap2(&self, other: &Bounds) -> f64 {
        let off =
            [0, 1, 2].map(|axis| (self.min[axis] - other.max[axis]).max(other.min[axis] - self.max[axis]).max(0.0));
        square(off)
    }
}

fn square([x, y, z]: [f64; 3]) -> f64 {
    x * x + y * y + z * z
}

/// Squared distance of two places.
pub fn distance2(a: [f64; 3], b: [f64; 3]) -> f64 {
    square([a[0] - b[0], a[1] - b[1], a[2] - b[2]])
}

/// Brings points into the order of a tree over `bounds`.
pub fn arrange(points: &mut [Point], bounds: Bounds) {
    if points.len() <= LEAF_POINTS {
        return;
    }
    let axis = bounds.widest();
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| a.xyz[axis].total_cmp(&b.xyz[axis]));
    let split = points[middle].xyz[axis];
    // The middle point stays where it is: it tells the split when the tree is read again.
    let (left, right) = points.split_at_mut(middle);
    let right = &mut right[1..];
    let (lower, upper) = cut(bounds, axis, split);
    if left.len() < PARALLEL_POINTS {
        arrange(left, lower);
        arrange(right, upper);
    } else {
        rayon::join(|| arrange(left, lower), || arrange(right, upper));
    }
}

fn cut(bounds: Bounds, axis: usize, split: f64) -> (Bounds, Bounds) {
    let (mut lower, mut upper) = (bounds, bounds);
    lower.max[axis] = split;
    upper.min[axis] = split;
    (lower, upper)
}

/// Points that [`arrange`] has ordered, and the splits, found again from the points.
pub struct Tree {
    points: Vec<Point>,
    bounds: Bounds,
    /// Axis and place of the inner nodes; the children of `i` are `2i + 1` and `2i + 2`.
    splits: Vec<(usize, f64)>,
}

impl Tree {
    /// `points` must be in the order of [`arrange`] with the same `bounds`.
    pub fn new(points: Vec<Point>, bounds: Bounds) -> Tree {
        let mut depth = 0;
        while points.len() >> depth > LEAF_POINTS {
            depth += 1;
        }
        let mut tree = Tree { splits: vec![(0, 0.0); (2usize << depth) - 1], points, bounds };
        tree.find_splits(0, 0, tree.points.len(), bounds);
        tree
    }

    fn find_splits(&mut self, node: usize, begin: usize, end: usize, bounds: Bounds) {
        if end - begin <= LEAF_POINTS {
            return;
        }
        let axis = bounds.widest();
        let middle = begin + (end - begin) / 2;
        let split = self.points[middle].xyz[axis];
        self.splits[node] = (axis, split);
        let (lower, upper) = cut(bounds, axis, split);
        self.find_splits(2 * node + 1, begin, middle, lower);
        self.find_splits(2 * node + 2, middle + 1, end, upper);
    }

    /// The points, in the tree's order.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// The box of all points.
    pub fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// Brings the squared distances of the points nearest to `point`, itself left out, into `nearest`: sorted, the
    /// largest last, which is also the bound below which a distance must lie.
    pub fn nearest(&self, point: &Point, nearest: &mut [f64]) {
        let last = nearest.len() - 1;
        if !self.points.is_empty() && self.bounds.distance2(point.xyz) < nearest[last] {
            self.search(0, 0, self.points.len(), point, [0.0; 3], nearest);
        }
    }

    /// Brings the points nearest to `point` in plan, itself left out, into `nearest`: squared distance, z, x, y; sorted
    /// by these in turn, at most `most` of them, none farther than the root of `bound2`.
    pub fn nearest_in_plan(&self, point: &Point, bound2: f64, most: usize, nearest: &mut Vec<[f64; 4]>) {
        let search = PlanSearch { point, bound2, most };
        self.nearest_from(0, 0, self.points.len(), &search, [0.0; 2], nearest);
    }

    fn nearest_from(
        &self,
        node: usize,
        begin: usize,
        end: usize,
        search: &PlanSearch<'_>,
        off: [f64; 2],
        nearest: &mut Vec<[f64; 4]>,
    ) {
        if end - begin <= LEAF_POINTS {
            self.points[begin..end].iter().for_each(|other| search.consider(other, nearest));
            return;
        }
        let (axis, split) = self.splits[node];
        let middle = begin + (end - begin) / 2;
        search.consider(&self.points[middle], nearest);
        let beyond = search.point.xyz[axis] - split;
        let mut far = off;
        if axis < 2 {
            far[axis] = beyond;
        }
        let lower = (2 * node + 1, begin, middle);
        let upper = (2 * node + 2, middle + 1, end);
        let (first, second) = if beyond < 0.0 { (lower, upper) } else { (upper, lower) };
        self.nearest_from(first.0, first.1, first.2, search, off, nearest);
        if far[0] * far[0] + far[1] * far[1] <= search.reach2(nearest) {
            self.nearest_from(second.0, second.1, second.2, search, far, nearest);
        }
    }

    /// Parts of the points that lie close together, in their order and without gaps: leaves of at most `most` points,
    /// each with the point before it that splits it from the last.
    pub fn groups(&self, most: usize) -> Vec<std::ops::Range<usize>> {
        fn part(begin: usize, end: usize, most: usize, groups: &mut Vec<std::ops::Range<usize>>) {
            if end - begin <= most.max(LEAF_POINTS) {
                let last = groups.last().map_or(0, |group| group.end);
                groups.push(last..end);
                return;
            }
            let middle = begin + (end - begin) / 2;
            part(begin, middle, most, groups);
            part(middle + 1, end, most, groups);
        }
        let mut groups = Vec::new();
        part(0, self.points.len(), most, &mut groups);
        groups
    }

    /// Adds the points whose x and y lie in the box to `found`, in the order of the tree; gives up when there are more
    /// than `most` in it.
    pub fn within_in_plan(&self, area: &Bounds, most: usize, found: &mut Vec<Point>) {
        if !self.points.is_empty() && self.bounds.gap2_in_plan(area) <= 0.0 {
            self.search_in_plan((0, 0, self.points.len()), area, most, found);
        }
    }

    fn search_in_plan(
        &self,
        (node, begin, end): (usize, usize, usize),
        area: &Bounds,
        most: usize,
        found: &mut Vec<Point>,
    ) {
        if found.len() > most {
            return;
        }
        let inside = |point: &&Point| (0..2).all(|i| point.xyz[i] >= area.min[i] && point.xyz[i] <= area.max[i]);
        if end - begin <= LEAF_POINTS {
            found.extend(self.points[begin..end].iter().filter(inside));
            return;
        }
        let (axis, split) = self.splits[node];
        let middle = begin + (end - begin) / 2;
        if axis == 2 || area.min[axis] <= split {
            self.search_in_plan((2 * node + 1, begin, middle), area, most, found);
        }
        found.extend(self.points[middle..=middle].iter().filter(inside));
        if axis == 2 || area.max[axis] >= split {
            self.search_in_plan((2 * node + 2, middle + 1, end), area, most, found);
        }
    }

    fn search(&self, node: usize, begin: usize, end: usize, point: &Point, off: [f64; 3], nearest: &mut [f64]) {
        let last = nearest.len() - 1;
        if end - begin <= LEAF_POINTS {
            self.points[begin..end].iter().for_each(|other| consider(point, other, nearest));
            return;
        }
        let (axis, split) = self.splits[node];
        let middle = begin + (end - begin) / 2;
        consider(point, &self.points[middle], nearest);
        let beyond = point.xyz[axis] - split;
        let mut far = off;
        far[axis] = beyond;
        if beyond < 0.0 {
            self.search(2 * node + 1, begin, middle, point, off, nearest);
            if square(far) < nearest[last] {
                self.search(2 * node + 2, middle + 1, end, point, far, nearest);
            }
        } else {
            self.search(2 * node + 2, middle + 1, end, point, off, nearest);
            if square(far) < nearest[last] {
                self.search(2 * node + 1, begin, middle, point, far, nearest);
            }
        }
    }
}

/// Puts a distance in its place when it is among the least.
fn consider(point: &Point, other: &Point, nearest: &mut [f64]) {
    let distance = distance2(point.xyz, other.xyz);
    let mut at = nearest.len() - 1;
    if distance < nearest[at] && other.index() != point.index() {
        while at > 0 && nearest[at - 1] > distance {
            nearest[at] = nearest[at - 1];
            at -= 1;
        }
        nearest[at] = distance;
    }
}

/// What a search in plan looks for.
struct PlanSearch<'a> {
    point: &'a Point,
    bound2: f64,
    most: usize,
}

impl PlanSearch<'_> {
    /// Squared distance up to which a point may still count.
    fn reach2(&self, nearest: &[[f64; 4]]) -> f64 {
        if nearest.len() < self.most { self.bound2 } else { nearest[self.most - 1][0].min(self.bound2) }
    }

    fn consider(&self, other: &Point, nearest: &mut Vec<[f64; 4]>) {
        let (dx, dy) = (self.point.xyz[0] - other.xyz[0], self.point.xyz[1] - other.xyz[1]);
        let distance2 = dx * dx + dy * dy;
        if distance2 > self.reach2(nearest) || other.index() == self.point.index() {
            return;
        }
        let entry = [distance2, other.xyz[2], other.xyz[0], other.xyz[1]];
        let order = |a: &[f64; 4], b: &[f64; 4]| {
            a.iter()
                .zip(b)
                .map(|(a, b)| a.total_cmp(b))
                .find(|order| order.is_ne())
                .unwrap_or(std::cmp::Ordering::Equal)
        };
        let at = nearest.partition_point(|known| order(known, &entry).is_lt());
        nearest.insert(at, entry);
        nearest.truncate(self.most);
    }
}
