//! What stands on the drawn landscape: houses, halls, cars, trees and their shadows.

use super::landscape::{BAY_M, BAY_ROWS_M, Landscape, PARCEL_M, PAVEMENT_HALF_M, Parcel, Use};
use super::rng::{Rng, value_noise};
use autoref_raster::window::Window;

/// Everything of a parcel's objects, shadows too, lies within this of its rectangle.
const OVERHANG_M: f32 = 14.0;
/// From here on cars and trees are specks, and a window would hold them by the million.
const OBJECTS_UP_TO_M_PER_PX: f32 = 1.0;

/// Direction to the sun in the image, and shadow length per height.
const SUN: (f32, f32) = (-0.64, -0.77);
const SHADOW_PER_M: f32 = 0.7;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Path,
    Car,
    Roof,
    FlatRoof,
    Tree,
}

/// Positions and sizes in pixels.
#[derive(Clone, Copy, Debug)]
struct Object {
    kind: Kind,
    x: f32,
    y: f32,
    half: (f32, f32),
    axis: (f32, f32),
    rgb: [f32; 3],
    /// Length of the shadow.
    shadow: f32,
    seed: u64,
}

const ROOFS: [[f32; 3]; 6] = [
    [158.0, 82.0, 62.0],
    [146.0, 70.0, 54.0],
    [92.0, 92.0, 96.0],
    [122.0, 92.0, 76.0],
    [150.0, 148.0, 146.0],
    [74.0, 72.0, 74.0],
];
const CARS: [[f32; 3]; 8] = [
    [226.0, 227.0, 228.0],
    [40.0, 41.0, 44.0],
    [156.0, 159.0, 163.0],
    [98.0, 101.0, 106.0],
    [150.0, 32.0, 34.0],
    [44.0, 66.0, 112.0],
    [208.0, 204.0, 190.0],
    [60.0, 74.0, 66.0],
];

/// Draws what stands on the land over its ground.
pub(crate) fn draw(land: &Landscape, window: Window, out: &mut [u8]) {
    if land.gsd_m <= OBJECTS_UP_TO_M_PER_PX {
        draw_all(&near(land, window), land, window, out);
    }
}

/// Objects of all parcels that can reach into the window, in an order that does not depend on the window.
fn near(land: &Landscape, window: Window) -> Vec<Object> {
    let corners = [
        (window.x, window.y),
        (window.right(), window.y),
        (window.x, window.bottom()),
        (window.right(), window.bottom()),
    ]
    .map(|(x, y)| land.grid_of(x as f64, y as f64));
    let range = |values: [f32; 4], size: f32| {
        let low = values.iter().fold(f32::INFINITY, |a, &b| a.min(b)) - OVERHANG_M;
        let high = values.iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b)) + OVERHANG_M;
        (low / size).floor() as i64..=(high / size).floor() as i64
    };
    let mut found = vec![];
    for row in range(corners.map(|c| c.1), PARCEL_M.1) {
        for column in range(corners.map(|c| c.0), PARCEL_M.0) {
            of_parcel(&land.parcel(column, row), land, &mut found);
        }
    }
    found.retain(|o| o.touches(window));
    found
}

/// Adds the objects of a parcel, always in the same order.
fn of_parcel(parcel: &Parcel, land: &Landscape, out: &mut Vec<Object>) {
    let mut rng = Rng::new(parcel.hash ^ parcel.column as u64, 25, parcel.row as u64);
    let mut place = Placer { parcel, land, out };
    match parcel.kind {
        Use::Garden => place.garden(&mut rng),
        Use::Wood => {
            for _ in 0..70 {
                let (u, v) = (rng.range(0.0, f64::from(PARCEL_M.0)), rng.range(0.0, f64::from(PARCEL_M.1)));
                place.tree(u as f32, v as f32, rng.range(1.4, 3.4) as f32, &mut rng);
            }
        }
        Use::Meadow => {
            for _ in 0..rng.below(5) {
                let (u, v) = (rng.range(3.0, 31.0), rng.range(3.0, 25.0));
                place.tree(u as f32, v as f32, rng.range(0.7, 3.0) as f32, &mut rng);
            }
        }
        Use::Pond => {
            for _ in 0..rng.below(9) {
                let u = if rng.chance(0.5) { rng.range(0.5, 3.0) } else { rng.range(31.0, 33.5) };
                place.tree(u as f32, rng.range(1.0, 27.0) as f32, rng.range(0.8, 2.4) as f32, &mut rng);
            }
        }
        Use::CarPark => {
            for row in BAY_ROWS_M {
                for bay in 0..10 {
                    if rng.chance(0.55) {
                        let u = 2.5 + BAY_M * (bay as f32 + 0.5);
                        place.car(u, row, std::f32::consts::FRAC_PI_2, &mut rng);
                    }
                }
            }
        }
        Use::Hall => place.hall(&mut rng),
        Use::Crop | Use::Soil => {}
    }
}

struct Placer<'a> {
    parcel: &'a Parcel,
    land: &'a Landscape,
    out: &'a mut Vec<Object>,
}

impl Placer<'_> {
    /// An object at (u, v) metres from the parcel's corner, turned from the street grid by `turn`.
    fn add(&mut self, kind: Kind, at: (f32, f32), half_m: (f32, f32), turn: f32, height_m: f32, look: ([f32; 3], u64)) {
        // The object lies where the bent grid has that place, as far as the bend is level there.
        let u = f64::from(self.parcel.column as f32 * PARCEL_M.0 + at.0);
        let v = f64::from(self.parcel.row as f32 * PARCEL_M.1 + at.1);
        let (c, s) = (f64::from(self.land.axis.0), f64::from(self.land.axis.1));
        let g = f64::from(self.land.gsd_m);
        let px = 1.0 / self.land.gsd_m;
        let (tc, ts) = (turn.cos(), turn.sin());
        let (ac, asn) = self.land.axis;
        self.out.push(Object {
            kind,
            x: ((c * u - s * v) / g) as f32,
            y: ((s * u + c * v) / g) as f32,
            half: (half_m.0 * px, half_m.1 * px),
            axis: (tc * ac - ts * asn, ts * ac + tc * asn),
            rgb: look.0,
            shadow: height_m * SHADOW_PER_M * px,
            seed: look.1,
        });
    }

    fn tree(&mut self, u: f32, v: f32, radius_m: f32, rng: &mut Rng) {
        let green = rng.range(-12.0, 16.0) as f32;
        let rgb = [66.0 + green * 0.9 + rng.range(-8.0, 10.0) as f32, 92.0 + green, 46.0 + green * 0.5];
        self.add(Kind::Tree, (u, v), (radius_m, radius_m), 0.0, radius_m * 1.6, (rgb, rng.next_u64()));
    }

    fn car(&mut self, u: f32, v: f32, turn: f32, rng: &mut Rng) {
        let rgb = CARS[rng.below(CARS.len())];
        let half = (rng.range(1.95, 2.35) as f32, rng.range(0.85, 0.95) as f32);
        let turn = turn + rng.range(-0.05, 0.05) as f32 + if rng.chance(0.5) { std::f32::consts::PI } else { 0.0 };
        self.add(Kind::Car, (u, v), half, turn, 1.4, (rgb, rng.next_u64()));
    }

    fn garden(&mut self, rng: &mut Rng) {
        let (u, v) = (rng.range(13.0, 21.0) as f32, rng.range(11.0, 17.0) as f32);
        let turn = rng.range(-0.12, 0.12) as f32;
        let gravel = [168.0, 160.0, 148.0];
        // A drive from the road side to the house, with a car on it more often than not.
        let drive_v = v + rng.range(-2.0, 2.0) as f32;
        self.add(Kind::Path, (u * 0.5, drive_v), (u * 0.5, 1.5), 0.0, 0.0, (gravel, rng.next_u64()));
        if rng.chance(0.65) {
            self.car(rng.range(4.5 + f64::from(PAVEMENT_HALF_M) / 2.0, 8.0) as f32, drive_v, 0.0, rng);
        }
        let terrace = (u + rng.range(-3.0, 3.0) as f32, v + 5.5);
        let slabs = [176.0, 168.0, 158.0];
        self.add(Kind::Path, terrace, (3.0, 2.2), turn, 0.0, (slabs, rng.next_u64()));
        let half = (rng.range(4.8, 6.6) as f32, rng.range(3.6, 4.8) as f32);
        let rgb = ROOFS[rng.below(ROOFS.len())].map(|c| c + rng.range(-8.0, 8.0) as f32);
        let turn = turn + if rng.chance(0.35) { std::f32::consts::FRAC_PI_2 } else { 0.0 };
        self.add(Kind::Roof, (u, v), half, turn, 5.5, (rgb, rng.next_u64()));
        if rng.chance(0.45) {
            let rgb = ROOFS[2 + rng.below(4)];
            let at = (rng.range(24.0, 29.5) as f32, rng.range(4.0, 24.0) as f32);
            self.add(Kind::Roof, at, (2.4, 1.9), rng.range(-0.2, 0.2) as f32, 2.6, (rgb, rng.next_u64()));
        }
        for _ in 0..3 + rng.below(9) {
            let u = if rng.chance(0.5) { rng.range(24.0, 33.0) } else { rng.range(1.0, 9.0) } as f32;
            let (v, radius) = (rng.range(1.0, 27.0) as f32, rng.range(0.5, 2.7) as f32);
            if (v - drive_v).abs() > radius + 1.8 {
                self.tree(u, v, radius, rng);
            }
        }
    }

    fn hall(&mut self, rng: &mut Rng) {
        let grey = rng.range(120.0, 205.0) as f32;
        let rgb = [grey, grey + rng.range(-4.0, 6.0) as f32, grey + rng.range(-4.0, 8.0) as f32];
        let half = (rng.range(9.0, 12.0) as f32, rng.range(6.5, 9.5) as f32);
        self.add(Kind::FlatRoof, (17.0, 14.0), half, 0.0, 7.0, (rgb, rng.next_u64()));
        for bay in 0..9 {
            if rng.chance(0.3) {
                self.car(4.0 + bay as f32 * BAY_M, 2.9, std::f32::consts::FRAC_PI_2, rng);
            }
        }
    }
}

impl Object {
    fn reach(&self) -> f32 {
        self.half.0.hypot(self.half.1) * 1.15 + self.shadow + 2.0
    }

    fn touches(&self, window: Window) -> bool {
        let r = self.reach();
        self.x + r >= window.x as f32
            && self.x - r <= window.right() as f32
            && self.y + r >= window.y as f32
            && self.y - r <= window.bottom() as f32
    }

    /// Offset from the object's middle in its own axes.
    fn local(&self, dx: f32, dy: f32) -> (f32, f32) {
        (self.axis.0 * dx + self.axis.1 * dy, self.axis.0 * dy - self.axis.1 * dx)
    }

    /// Share of a pixel (about) that lies in the object's outline.
    fn inside(&self, dx: f32, dy: f32, x: f32, y: f32, land: &Landscape) -> f32 {
        match self.kind {
            Kind::Tree => {
                // Most pixels are decided without the noise that makes the outline.
                let (square, radius) = (dx * dx + dy * dy, self.half.0);
                let (least, most) = ((0.72 * radius - 0.5).max(0.0), 1.12 * radius + 0.5);
                if square >= most * most || square < least * least {
                    return if square < least * least { 1.0 } else { 0.0 };
                }
                let (k, r) = (land.gsd_m / 0.75, square.sqrt());
                let lumpy = radius * (0.72 + 0.4 * value_noise(self.seed, x * k, y * k));
                (lumpy - r + 0.5).clamp(0.0, 1.0)
            }
            Kind::Car => {
                // A rectangle with rounded corners.
                let (a, b) = self.local(dx, dy);
                let round = self.half.1 * 0.4;
                let (qa, qb) = (a.abs() - self.half.0 + round, b.abs() - self.half.1 + round);
                let corner = (qa.max(0.0), qb.max(0.0));
                let outside = (corner.0 * corner.0 + corner.1 * corner.1).sqrt() + qa.max(qb).min(0.0) - round;
                (0.5 - outside).clamp(0.0, 1.0)
            }
            Kind::Path | Kind::Roof | Kind::FlatRoof => {
                let (a, b) = self.local(dx, dy);
                let edge = (self.half.0 - a.abs()).min(self.half.1 - b.abs());
                (edge + 0.5).clamp(0.0, 1.0)
            }
        }
    }

    /// Share of a pixel (none, half, all) in the rectangle as it moves along `1 / inverse` (in its own axes): by the
    /// intervals of the movement during which each pair of sides holds the point.
    fn swept(&self, dx: f32, dy: f32, inverse: (f32, f32)) -> f32 {
        let p = self.local(dx, dy);
        let meets = |grow: f32| {
            let interval = |p: f32, inverse: f32, half: f32| {
                let (t0, t1) = ((p - half) * inverse, (p + half) * inverse);
                (t0.min(t1), t0.max(t1))
            };
            let (a, b) = (interval(p.0, inverse.0, self.half.0 + grow), interval(p.1, inverse.1, self.half.1 + grow));
            a.0.max(b.0).max(0.0) <= a.1.min(b.1).min(1.0)
        };
        match (meets(0.4), meets(-0.4)) {
            (false, _) => 0.0,
            (true, false) => 0.5,
            (true, true) => 1.0,
        }
    }

    fn colour(&self, dx: f32, dy: f32, x: f32, y: f32, land: &Landscape) -> [f32; 3] {
        let (a, b) = self.local(dx, dy);
        let m = land.gsd_m;
        let grain = value_noise(self.seed, x / 2.2, y / 2.2) - 0.5;
        let (gain, add) = match self.kind {
            Kind::Path => (1.0, 26.0 * grain),
            Kind::Roof => self.roof(a, b, m, grain),
            Kind::FlatRoof => {
                let rim = (self.half.0 - a.abs()).min(self.half.1 - b.abs()) * m < 0.4;
                let seam = ((a * m / 1.5).fract().abs()) < 0.05;
                let stain = value_noise(self.seed, x * m / 2.5, y * m / 2.5) - 0.5;
                (1.0 + 0.14 * stain + if rim { 0.12 } else { 0.0 } - if seam { 0.05 } else { 0.0 }, 12.0 * grain)
            }
            Kind::Car => {
                let t = a / self.half.0;
                let glass = b.abs() < self.half.1 * 0.8 && ((0.12..0.42).contains(&t) || (-0.78..-0.55).contains(&t));
                if glass {
                    return [38.0 + 18.0 * grain, 44.0 + 18.0 * grain, 50.0 + 18.0 * grain];
                }
                let roof = (-0.55..0.12).contains(&t) && b.abs() < self.half.1 * 0.75;
                (if roof { 1.06 } else { 0.97 - 0.1 * (b.abs() / self.half.1).powi(4) }, 8.0 * grain)
            }
            Kind::Tree => {
                let k = m / 0.32;
                let leaves = value_noise(self.seed ^ 1, x * k, y * k) - 0.5;
                let lit = (dx * SUN.0 + dy * SUN.1) / self.half.0;
                (0.92 + 0.30 * lit + 0.75 * leaves + 0.5 * grain, 0.0)
            }
        };
        self.rgb.map(|c| c * gain + add)
    }

    /// A hipped roof: four slopes, each lit by how it faces the sun, courses of tiles across, a pale ridge, a chimney.
    fn roof(&self, a: f32, b: f32, m: f32, grain: f32) -> (f32, f32) {
        let hip = self.half.0 - a.abs() < (self.half.1 - b.abs()) * 0.9;
        let slope = if hip {
            (self.axis.0 * a.signum(), self.axis.1 * a.signum())
        } else {
            (-self.axis.1 * b.signum(), self.axis.0 * b.signum())
        };
        let lit = slope.0 * SUN.0 + slope.1 * SUN.1;
        let course = (if hip { a } else { b } * m / 0.33).rem_euclid(1.0);
        let ridge = !hip && b.abs() * m < 0.14;
        let (ca, cb) = ((a - self.half.0 * 0.35) * m, (b - self.half.1 * 0.3) * m);
        if ca.abs() < 0.4 && cb.abs() < 0.4 && self.half.0 * m > 3.0 {
            let flue = ca.abs() < 0.2 && cb.abs() < 0.2;
            return (if flue { 0.35 } else { 0.75 }, 30.0);
        }
        let gain = 0.96 + 0.17 * lit + if course < 0.18 { -0.07 } else { 0.0 } + if ridge { 0.14 } else { 0.0 };
        (gain + 0.14 * grain, 0.0)
    }
}

/// Draws shadows of all, then the objects from the ground up.
fn draw_all(objects: &[Object], land: &Landscape, window: Window, out: &mut [u8]) {
    let mut order: Vec<&Object> = objects.iter().collect();
    // Stable: within a kind the order of the parcels stays.
    order.sort_by_key(|o| o.kind);
    for o in order.iter().filter(|o| o.kind == Kind::Path) {
        body(o, land, window, out);
    }
    cast_shadows(&order, land, window, out);
    for o in order.iter().filter(|o| o.kind != Kind::Path) {
        body(o, land, window, out);
    }
}

/// Calls `f` with each pixel's offset in `out` and its centre, for the part of a square that lies in the window.
fn each_pixel(window: Window, centre: (f32, f32), reach: f32, mut f: impl FnMut(usize, f32, f32)) {
    let low = |v: f32, bound: u64| (v.max(0.0) as u64).max(bound);
    let high = |v: f32, bound: u64| ((v + 1.0).max(0.0) as u64).min(bound);
    let (x0, x1) = (low(centre.0 - reach, window.x), high(centre.0 + reach, window.right()));
    let (y0, y1) = (low(centre.1 - reach, window.y), high(centre.1 + reach, window.bottom()));
    for y in y0..y1 {
        for x in x0..x1 {
            let at = (((y - window.y) * window.width + x - window.x) * 3) as usize;
            f(at, x as f32 + 0.5, y as f32 + 0.5);
        }
    }
}

fn body(o: &Object, land: &Landscape, window: Window, out: &mut [u8]) {
    each_pixel(window, (o.x, o.y), o.half.0.hypot(o.half.1) * 1.15 + 2.0, |at, x, y| {
        let (dx, dy) = (x - o.x, y - o.y);
        let share = o.inside(dx, dy, x, y, land);
        if share > 0.0 {
            let rgb = o.colour(dx, dy, x, y, land);
            for (sample, value) in out[at..at + 3].iter_mut().zip(rgb) {
                *sample = (f32::from(*sample) * (1.0 - share) + value.clamp(0.0, 255.0) * share) as u8;
            }
        }
    });
}

/// Light from the sky is bluish, so shadows keep more blue. Where shadows overlap, the darkest counts.
fn cast_shadows(order: &[&Object], land: &Landscape, window: Window, out: &mut [u8]) {
    let mut dark = vec![0u8; window.area() as usize];
    for o in order.iter().filter(|o| o.shadow > 0.0) {
        let (sx, sy) = (-SUN.0 * o.shadow, -SUN.1 * o.shadow);
        let middle = (o.x + sx / 2.0, o.y + sy / 2.0);
        let along = o.local(sx, sy);
        // Where sun and wall are parallel this is infinite, which compares as it should.
        let inverse = (1.0 / along.0, 1.0 / along.1);
        each_pixel(window, middle, o.half.0.hypot(o.half.1) * 1.15 + o.shadow / 2.0 + 2.0, |at, x, y| {
            if dark[at / 3] == 255 {
                return;
            }
            let share = match o.kind {
                // Lumpy outlines at a few positions along the way.
                Kind::Tree => [0.35f32, 0.7, 1.0]
                    .iter()
                    .map(|t| o.inside(x - o.x - sx * t, y - o.y - sy * t, x - sx * t, y - sy * t, land))
                    .fold(0.0, f32::max),
                _ => o.swept(x - o.x, y - o.y, inverse),
            };
            let level = (share * 255.0) as u8;
            dark[at / 3] = dark[at / 3].max(level);
        });
    }
    for (pixel, &level) in out.chunks_exact_mut(3).zip(&dark) {
        if level > 0 {
            let depth = f32::from(level) / 255.0;
            for (sample, keep) in pixel.iter_mut().zip([0.50, 0.53, 0.60]) {
                *sample = (f32::from(*sample) * (1.0 - depth * (1.0 - keep))) as u8;
            }
        }
    }
}
