//! The lower envelope of what lies around a point: the plane of asymmetric least squares, and how far below it and
//! how much alone there the point is.

use super::lanes::{self, LANES, Lanes, Work};

/// What points above the envelope weigh against those below.
const ABOVE: f64 = 0.02;
const ROUNDS: usize = 8;
/// Neighbours whose distance is looked for among the offsets.
pub const NEAR: usize = 6;

/// Places around a point, itself the origin; filled up with zeros to whole lanes.
#[derive(Default)]
pub struct Offsets {
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    len: usize,
}

impl Offsets {
    /// Takes these places in the order given.
    pub fn set(&mut self, places: impl ExactSizeIterator<Item = [f64; 3]>) {
        self.len = places.len();
        for axis in [&mut self.x, &mut self.y, &mut self.z] {
            axis.clear();
            axis.resize(self.len.next_multiple_of(LANES), 0.0);
        }
        for ((([px, py, pz], x), y), z) in places.zip(&mut self.x).zip(&mut self.y).zip(&mut self.z) {
            (*x, *y, *z) = (px, py, pz);
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// The least squared distances from the origin, in their order; infinite where there are no more points.
    pub fn nearest2(&self) -> [f64; NEAR] {
        lanes::run(Nearest(self))
    }

    /// How low the origin lies: the geometric mean of its depth below the envelope of its surroundings, in units of the
    /// spread about it, and of the height above it of the `rank`-th lowest of them (1 to [`NEAR`]), along the envelope
    /// and in units of their spacing in plan. Terrain deep below what grows on it is not alone at its depth; noise is.
    /// `None` where one of the two is not positive, or the surroundings lie on a line.
    pub fn lowness(&self, rank: usize) -> Option<f64> {
        lanes::run(Lowness { offsets: self, rank })
    }
}

struct Lowness<'a> {
    offsets: &'a Offsets,
    rank: usize,
}

impl Work for Lowness<'_> {
    type Output = Option<f64>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<f64> {
        let mut sums = self.sums::<L>(None);
        let mut plane = solve(&sums)?;
        for _ in 1..ROUNDS {
            let next = self.sums::<L>(Some(plane));
            // The same sums: no point has changed sides.
            if next == sums {
                break;
            }
            sums = next;
            plane = solve(&sums)?;
        }
        // Above its envelope nothing is low.
        if plane[0] <= 0.0 {
            return None;
        }
        let gap = self.gap::<L>(plane);
        if gap.is_infinite() || gap <= 0.0 {
            return None;
        }
        let (spread, spacing) = (self.spread::<L>(plane), self.spacing::<L>());
        (spread > 0.0 && spacing > 0.0).then(|| (plane[0] / spread * (gap / spacing)).sqrt())
    }
}

/// Sums of weights and weighted products: 1, x, y, z, x², xy, y², xz, yz.
type Sums = [f64; 9];

/// A plane: the height at the origin, and the slopes eastwards and northwards.
type Plane = [f64; 3];

/// Four points, and how many of them there are.
struct Points<L> {
    x: L,
    y: L,
    z: L,
    /// 1 for a point, 0 for none.
    there: L,
}

impl<L: Lanes> Points<L> {
    /// What the points are off the plane.
    #[inline(always)]
    fn off(&self, [height, east, north]: Plane) -> L {
        let plane = L::all(height).plus(L::all(east).times(self.x)).plus(L::all(north).times(self.y));
        self.z.minus(plane)
    }

    /// Weights by the side of the plane.
    #[inline(always)]
    fn weights(&self, off: L) -> L {
        off.choose(L::all(ABOVE).times(self.there), self.there)
    }

    #[inline(always)]
    fn add_to(&self, [s, sx, sy, sz, sxx, sxy, syy, sxz, syz]: [L; 9], w: L) -> [L; 9] {
        let &Points { x, y, z, .. } = self;
        let (wx, wy) = (w.times(x), w.times(y));
        [
            s.plus(w),
            sx.plus(wx),
            sy.plus(wy),
            sz.plus(w.times(z)),
            sxx.plus(wx.times(x)),
            sxy.plus(wx.times(y)),
            syy.plus(wy.times(y)),
            sxz.plus(wx.times(z)),
            syz.plus(wy.times(z)),
        ]
    }
}

impl Offsets {
    #[inline(always)]
    fn fours(&self) -> usize {
        self.len.div_ceil(LANES)
    }

    // No closures here: they are not compiled for the wider registers.
    #[inline(always)]
    fn four<L: Lanes>(&self, number: usize) -> Points<L> {
        let places = number * LANES..(number + 1) * LANES;
        let there = if places.end <= self.len { &WHOLE } else { &PARTS[self.len % LANES] };
        Points {
            x: L::load(four(&self.x[places.clone()])),
            y: L::load(four(&self.y[places.clone()])),
            z: L::load(four(&self.z[places])),
            there: L::load(there),
        }
    }
}

#[inline(always)]
fn four(values: &[f64]) -> &[f64; LANES] {
    values.try_into().expect("the range is of so many")
}

const WHOLE: [f64; LANES] = [1.0; LANES];
/// By how many points there are.
const PARTS: [[f64; LANES]; LANES] = [[0.0; LANES], [1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [1.0, 1.0, 1.0, 0.0]];

impl Lowness<'_> {
    /// Points weigh by the side of the plane that they are on; without one, all the same.
    #[inline(always)]
    fn sums<L: Lanes>(&self, plane: Option<Plane>) -> Sums {
        let mut lanes = [L::all(0.0); 9];
        for number in 0..self.offsets.fours() {
            let points: Points<L> = self.offsets.four(number);
            let weights = match plane {
                None => points.there,
                Some(plane) => points.weights(points.off(plane)),
            };
            lanes = points.add_to(lanes, weights);
        }
        let mut sums = [0.0; 9];
        for (sum, lanes) in sums.iter_mut().zip(lanes) {
            *sum = lanes.sum();
        }
        sums
    }

    /// Root of the weighted mean square of what points are off the plane.
    #[inline(always)]
    fn spread<L: Lanes>(&self, plane: Plane) -> f64 {
        let (mut weights, mut squares) = (L::all(0.0), L::all(0.0));
        for number in 0..self.offsets.fours() {
            let points: Points<L> = self.offsets.four(number);
            let off = points.off(plane);
            let w = points.weights(off);
            weights = weights.plus(w);
            squares = squares.plus(w.times(off).times(off));
        }
        (squares.sum() / weights.sum()).sqrt()
    }

    /// Height of the lowest but so many above the origin, along the plane.
    #[inline(always)]
    fn gap<L: Lanes>(&self, [_, east, north]: Plane) -> f64 {
        let mut least = [L::all(f64::INFINITY); NEAR];
        for number in 0..self.offsets.fours() {
            let points: Points<L> = self.offsets.four(number);
            let off = points.off([0.0, east, north]);
            keep(&mut least, points.there.choose(off, L::all(f64::INFINITY)));
        }
        merge(&stored(least))[self.rank - 1]
    }

    /// Side of the square that a point has to itself in a disc that reaches to the farthest.
    #[inline(always)]
    fn spacing<L: Lanes>(&self) -> f64 {
        let mut farthest2 = L::all(0.0);
        for number in 0..self.offsets.fours() {
            let Points { x, y, .. }: Points<L> = self.offsets.four(number);
            (_, farthest2) = farthest2.sorted(x.times(x).plus(y.times(y)));
        }
        let farthest2 = farthest2.store().into_iter().fold(0.0, f64::max);
        (std::f64::consts::PI * farthest2 / self.offsets.len as f64).sqrt()
    }
}

/// The least squared distances from the origin, in their order.
struct Nearest<'a>(&'a Offsets);

impl Work for Nearest<'_> {
    type Output = [f64; NEAR];

    #[inline(always)]
    fn run<L: Lanes>(self) -> [f64; NEAR] {
        // Each lane keeps the least of its own.
        let mut least = [L::all(f64::INFINITY); NEAR];
        for number in 0..self.0.fours() {
            let Points { x, y, z, there }: Points<L> = self.0.four(number);
            let distance2 = x.times(x).plus(y.times(y)).plus(z.times(z));
            keep(&mut least, there.choose(distance2, L::all(f64::INFINITY)));
        }
        merge(&stored(least))
    }
}

/// Keeps the least values of each lane, in their order.
#[inline(always)]
fn keep<L: Lanes>(least: &mut [L; NEAR], mut value: L) {
    for known in least {
        (*known, value) = known.sorted(value);
    }
}

#[inline(always)]
fn stored<L: Lanes>(least: [L; NEAR]) -> [[f64; LANES]; NEAR] {
    let mut stored = [[0.0; LANES]; NEAR];
    for (stored, lanes) in stored.iter_mut().zip(least) {
        *stored = lanes.store();
    }
    stored
}

/// The least of the lanes' least.
fn merge(least: &[[f64; LANES]; NEAR]) -> [f64; NEAR] {
    let mut next = [0; LANES];
    std::array::from_fn(|_| {
        // No lane is at its end before so many were taken from it.
        let head = |lane: usize| least[next[lane]][lane];
        let lane = (1..LANES).fold(0, |best, lane| if head(lane) < head(best) { lane } else { best });
        let value = head(lane);
        next[lane] = (next[lane] + 1).min(NEAR - 1);
        value
    })
}

/// The plane of weighted least squares; `None` when the points lie on a line.
#[inline(always)]
fn solve(sums: &Sums) -> Option<Plane> {
    let [w, x, y, z, xx, xy, yy, xz, yz] = *sums;
    let mut m = [[w, x, y, z], [x, xx, xy, xz], [y, xy, yy, yz]];
    // Gaussian elimination with pivots on the diagonal: the matrix is positive definite, or the points lie on a line.
    let diagonal = [m[0][0], m[1][1], m[2][2]];
    for i in 0..3 {
        let size = m[i][i];
        if size.is_nan() || size <= 1e-12 * diagonal[i] {
            return None;
        }
        for below in i + 1..3 {
            let factor = m[below][i] / size;
            for column in i..4 {
                m[below][column] -= factor * m[i][column];
            }
        }
    }
    let c = m[2][3] / m[2][2];
    let b = (m[1][3] - m[1][2] * c) / m[1][1];
    let a = (m[0][3] - m[0][1] * b - m[0][2] * c) / m[0][0];
    Some([a, b, c])
}
