//! How much the neighbourhood of a cell looks like the middle of a target: the least difference between samples on a
//! ring that must be bright and samples that must be dark.
//!
//! Sixteen samples on a circle, after S. Bennett and J. Lasenby, "ChESS – quick and robust detection of chess-board
//! features", 2014. We take minimum and maximum where they take sums: a clear corner passes, and one bright stone on a
//! circle of sand does not. Both polarities count, so a negative picture gives the same responses.

use super::Motif;
use super::grey::Plane;

/// A circle of sixteen samples, clockwise from the top, in cells.
pub struct Ring {
    /// Mean radius in cells.
    pub radius: f64,
    /// Farthest coordinate.
    pub reach: usize,
    pub offsets: [(i32, i32); 16],
}

/// Two radii a level, so that a factor of two in size always has one that fits.
pub const RINGS: [Ring; 2] = [
    Ring {
        radius: 3.0,
        reach: 3,
        offsets: [
            (0, -3),
            (1, -3),
            (2, -2),
            (3, -1),
            (3, 0),
            (3, 1),
            (2, 2),
            (1, 3),
            (0, 3),
            (-1, 3),
            (-2, 2),
            (-3, 1),
            (-3, 0),
            (-3, -1),
            (-2, -2),
            (-1, -3),
        ],
    },
    Ring {
        radius: 5.4,
        reach: 5,
        offsets: [
            (0, -5),
            (2, -5),
            (4, -4),
            (5, -2),
            (5, 0),
            (5, 2),
            (4, 4),
            (2, 5),
            (0, 5),
            (-2, 5),
            (-4, 4),
            (-5, 2),
            (-5, 0),
            (-5, -2),
            (-4, -4),
            (-2, -5),
        ],
    },
];

/// Rows of samples on the ring about the cells `from..from + len` of a row.
pub struct Around<'a> {
    pub ring: [&'a [u8]; 16],
    pub centre: &'a [u8],
}

impl<'a> Around<'a> {
    /// `None` too near the upper or lower edge.
    pub fn of_row(plane: &'a Plane, ring: &Ring, row: usize) -> Option<Around<'a>> {
        let reach = ring.reach;
        if row < reach || row + reach >= plane.height || plane.width <= 2 * reach {
            return None;
        }
        let len = plane.width - 2 * reach;
        let slice = |(dx, dy): (i32, i32)| {
            let start = (reach as i32 + dx) as usize;
            &plane.row((row as i32 + dy) as usize)[start..start + len]
        };
        Some(Around { ring: ring.offsets.map(slice), centre: slice((0, 0)) })
    }
}

/// Responses of the cells of row `row` that are at least the ring's reach from the plane's edge; `out[i]` is that of
/// column `reach + i`. Returns how many there are: 0 too near the upper or lower edge.
pub fn respond(plane: &Plane, ring: &Ring, row: usize, motif: Motif, out: &mut Vec<u8>) -> usize {
    out.clear();
    let Some(around) = Around::of_row(plane, ring, row) else { return 0 };
    out.resize(around.centre.len(), 0);
    match motif {
        Motif::Cross => cross(&around, out),
        Motif::Saddle => saddle(&around, out),
    }
    out.len()
}

/// Four arms at quarter turns and the middle on one side, what lies between them on the other.
fn cross(around: &Around<'_>, out: &mut [u8]) {
    let n = out.len();
    let ring = around.ring.map(|s| &s[..n]);
    let centre = &around.centre[..n];
    for (i, out) in out.iter_mut().enumerate() {
        let (mut low, mut high) = ([0u8; 4], [0u8; 4]);
        for k in 0..4 {
            let (a, b, c, d) = (ring[k][i], ring[k + 4][i], ring[k + 8][i], ring[k + 12][i]);
            low[k] = a.min(b).min(c.min(d));
            high[k] = a.max(b).max(c.max(d));
        }
        let middle = centre[i];
        let mut best = 0u8;
        for k in 0..4 {
            let other = (k + 2) % 4;
            best = best.max(low[k].min(middle).saturating_sub(high[other]));
            best = best.max(low[other].saturating_sub(high[k].max(middle)));
        }
        *out = best;
    }
}

/// Two opposite pairs of neighbours bright, the pairs a quarter turn on dark.
fn saddle(around: &Around<'_>, out: &mut [u8]) {
    let n = out.len();
    let ring = around.ring.map(|s| &s[..n]);
    for (i, out) in out.iter_mut().enumerate() {
        let (mut low, mut high) = ([0u8; 8], [0u8; 8]);
        for k in 0..8 {
            low[k] = ring[k][i].min(ring[k + 8][i]);
            high[k] = ring[k][i].max(ring[k + 8][i]);
        }
        let mut best = 0u8;
        for k in 0..8 {
            let (a, b) = (k, (k + 1) % 8);
            let (c, d) = ((k + 4) % 8, (k + 5) % 8);
            best = best.max(low[a].min(low[b]).saturating_sub(high[c].max(high[d])));
        }
        *out = best;
    }
}

/// The sixteen samples of a ring in a plane, as steps along its bytes.
pub struct Steps<'a> {
    plane: &'a Plane,
    steps: [isize; 16],
}

impl<'a> Steps<'a> {
    pub fn new(plane: &'a Plane, ring: &Ring) -> Steps<'a> {
        let mut steps = [0; 16];
        for (step, (dx, dy)) in steps.iter_mut().zip(ring.offsets) {
            *step = dy as isize * plane.width as isize + dx as isize;
        }
        Steps { plane, steps }
    }

    /// The strongest response at a cell that is the ring's reach from the plane's edge: the response, whether the arms
    /// (or the quarters of the sample) are bright, and the number of the sample at an arm (or the first of two about
    /// the middle of a quarter).
    #[inline]
    pub fn strongest(&self, column: usize, row: usize, motif: Motif) -> (u8, bool, usize) {
        let at = row * self.plane.width + column;
        let mut s = [0u8; 16];
        for (s, step) in s.iter_mut().zip(self.steps) {
            *s = self.plane.data[at.wrapping_add_signed(step)];
        }
        let mut best = (0u8, true, 0);
        match motif {
            Motif::Cross => {
                let middle = self.plane.data[at];
                let (mut low, mut high) = ([0u8; 4], [0u8; 4]);
                for k in 0..4 {
                    low[k] = s[k].min(s[k + 4]).min(s[k + 8].min(s[k + 12]));
                    high[k] = s[k].max(s[k + 4]).max(s[k + 8].max(s[k + 12]));
                }
                for k in 0..4 {
                    let between = (k + 2) % 4;
                    let bright = low[k].min(middle).saturating_sub(high[between]);
                    let dark = low[between].saturating_sub(high[k].max(middle));
                    for (response, is_bright) in [(bright, true), (dark, false)] {
                        if response > best.0 {
                            best = (response, is_bright, k);
                        }
                    }
                }
            }
            Motif::Saddle => {
                let (mut low, mut high) = ([0u8; 8], [0u8; 8]);
                for k in 0..8 {
                    low[k] = s[k].min(s[k + 8]);
                    high[k] = s[k].max(s[k + 8]);
                }
                for k in 0..8 {
                    let (next, across, after) = ((k + 1) % 8, (k + 4) % 8, (k + 5) % 8);
                    let response = low[k].min(low[next]).saturating_sub(high[across].max(high[after]));
                    if response > best.0 {
                        best = (response, true, k);
                    }
                }
            }
        }
        best
    }
}

/// The direction of an arm of a cross, or of the middle of a bright quarter of a saddle, of which [`Steps::strongest`]
/// has the sample.
pub fn direction(ring: &Ring, sample: usize, motif: Motif) -> f64 {
    let (a, b) = (ring.offsets[sample], ring.offsets[(sample + 1) % 16]);
    match motif {
        Motif::Cross => f64::from(a.1).atan2(f64::from(a.0)),
        Motif::Saddle => f64::from(a.1 + b.1).atan2(f64::from(a.0 + b.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(value: impl Fn(f64, f64) -> f64) -> Plane {
        let data = (0..21 * 21).map(|i| value(f64::from(i % 21) - 10.0, f64::from(i / 21) - 10.0) as u8).collect();
        Plane { x: 0, y: 0, width: 21, height: 21, data }
    }

    fn middle(plane: &Plane, ring: &Ring, motif: Motif) -> u8 {
        let mut out = Vec::new();
        respond(plane, ring, 10, motif, &mut out);
        let response = out[10 - ring.reach];
        assert_eq!(response, Steps::new(plane, ring).strongest(10, 10, motif).0, "rows and single cells agree");
        response
    }

    #[test]
    fn targets_respond_at_any_angle_and_in_the_negative_and_other_things_do_not() {
        for ring in &RINGS {
            for degrees in (0..90).step_by(5) {
                let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
                let turned = |x: f64, y: f64| (cos * x + sin * y, cos * y - sin * x);
                for negative in [false, true] {
                    let grey = |bright: bool| if bright != negative { 200.0 } else { 30.0 };
                    let width = ring.radius / 1.7;
                    let cross = plane(|x, y| {
                        let (u, v) = turned(x, y);
                        grey(u.abs() < width / 2.0 || v.abs() < width / 2.0)
                    });
                    let checker = plane(|x, y| {
                        let (u, v) = turned(x, y);
                        grey((u > 0.0) == (v > 0.0))
                    });
                    let edge = plane(|x, y| grey(turned(x, y).0 > 0.0));
                    let bar = plane(|x, y| grey(turned(x, y).0.abs() < width / 2.0));
                    let blob = plane(|x, y| grey(x.hypot(y) < width));
                    assert!(middle(&cross, ring, Motif::Cross) > 100, "cross, {degrees}");
                    assert!(middle(&checker, ring, Motif::Saddle) > 100, "checker, {degrees}");
                    for (name, other) in [("edge", &edge), ("bar", &bar), ("blob", &blob)] {
                        for motif in [Motif::Cross, Motif::Saddle] {
                            if name == "bar" && motif == Motif::Saddle {
                                // Four samples of a bar can alternate as those of a checker do; the fit tells them
                                // apart.
                                continue;
                            }
                            let response = middle(other, ring, motif);
                            assert_eq!(response, 0, "{name} as {motif:?}, {degrees}°, radius {}", ring.radius);
                        }
                    }
                    assert_eq!(middle(&checker, ring, Motif::Cross), 0);
                }
            }
        }
    }
}
