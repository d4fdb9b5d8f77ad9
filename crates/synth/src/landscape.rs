//! A landscape drawn from nothing: blocks of parcels between roads — gardens with houses, fields, woods, car parks and
//! ponds. Every pixel follows from the seed and its place alone, so any window can be drawn by itself.
//!
//! The ground is drawn pixel by pixel in a slightly bent street grid; what stands on it is a list of objects per
//! parcel ([`super::objects`]), drawn over it in a fixed order.

use super::rng::{Rng, hash2, mix, value_noise};
use autoref_raster::window::Window;

/// Size of a parcel, in metres, along the two directions of the street grid.
pub(crate) const PARCEL_M: (f32, f32) = (34.0, 28.0);
/// Parcels of a block between roads, each way.
pub(crate) const BLOCK: i64 = 3;
const ROAD_HALF_M: f32 = 3.0;
pub(crate) const PAVEMENT_HALF_M: f32 = 4.3;
/// Middle lines of a car park's rows of bays, across a parcel, and the width of a bay, in metres.
pub(crate) const BAY_ROWS_M: [f32; 3] = [6.5, 14.0, 21.5];
pub(crate) const BAY_M: f32 = 2.7;
/// The bend of the street grid is computed every so many pixels and drawn straight between.
const NODE_PX: u64 = 16;
/// How far and over what length the grid bends.
const BEND_M: f32 = 5.0;
const BEND_LENGTH_M: f32 = 55.0;

/// What a parcel is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    Garden,
    Crop,
    Soil,
    Meadow,
    Wood,
    CarPark,
    Hall,
    Pond,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Parcel {
    pub column: i64,
    pub row: i64,
    pub kind: Use,
    pub hash: u64,
    /// Tint of the ground, and direction and spacing of its rows.
    tint: [f32; 3],
    along: (f32, f32),
}

#[derive(Debug)]
pub(crate) struct Landscape {
    seed: u64,
    pub(crate) gsd_m: f32,
    /// The street grid's direction in the image.
    pub(crate) axis: (f32, f32),
}

impl Landscape {
    pub(crate) fn new(seed: u64, gsd_m: f64) -> Self {
        let angle = Rng::new(seed, 20, 0).range(-0.5, 0.5) as f32;
        Landscape { seed: mix(seed ^ 0x1a5d), gsd_m: gsd_m as f32, axis: (angle.cos(), angle.sin()) }
    }

    /// The bare ground.
    pub(crate) fn render(&self, window: Window, out: &mut [u8]) {
        let width = window.width as usize;
        let mut fine = vec![0f32; width];
        let mut coarse = vec![0f32; width];
        let mut places = vec![(0f32, 0f32); width];
        let m = 1.0 / self.gsd_m;
        for (row, y) in out.chunks_exact_mut(width * 3).zip(window.y..) {
            fine.fill(0.0);
            coarse.fill(0.0);
            self.octave(1, 2.1, 0.55, window.x, y, &mut fine);
            self.octave(2, 6.3, 0.45, window.x, y, &mut fine);
            self.octave(3, (1.7 * m).max(8.0), 0.45, window.x, y, &mut coarse);
            self.octave(4, (9.0 * m).max(8.0), 0.55, window.x, y, &mut coarse);
            self.bend(window.x, y, &mut places);
            let mut parcel = self.parcel(i64::MIN, 0);
            for (i, pixel) in row.chunks_exact_mut(3).enumerate() {
                let (u, v) = places[i];
                let at = (floor(u * (1.0 / PARCEL_M.0)), floor(v * (1.0 / PARCEL_M.1)));
                if (parcel.column, parcel.row) != at {
                    parcel = self.parcel(at.0, at.1);
                }
                let rgb = parcel.ground(u, v, fine[i], coarse[i]);
                for (sample, value) in pixel.iter_mut().zip(rgb) {
                    *sample = value.clamp(0.0, 255.0) as u8;
                }
            }
        }
    }

    /// Adds value noise in ±`weight` along a row of pixels: lattice values of the two lattice rows about it are
    /// joined once, then smoothed along the row.
    fn octave(&self, index: u64, wave_px: f32, weight: f32, x: u64, y: u64, row: &mut [f32]) {
        let seed = mix(self.seed ^ index);
        let at = |i: i64, j: i64| (hash2(seed, i, j) >> 40) as f32 * (1.0 / 8_388_608.0) - 1.0;
        let per_px = 1.0 / f64::from(wave_px);
        let ty = y as f64 * per_px;
        let j = ty.floor();
        let f = (ty - j) as f32;
        let sy = f * f * (3.0 - 2.0 * f);
        let lattice = |i: i64| {
            let (a, b) = (at(i, j as i64), at(i, j as i64 + 1));
            weight * (a + (b - a) * sy)
        };
        let mut i = (x as f64 * per_px).floor() as i64;
        let (mut left, mut right) = (lattice(i), lattice(i + 1));
        for (k, value) in row.iter_mut().enumerate() {
            let t = (x + k as u64) as f64 * per_px;
            if t >= (i + 1) as f64 {
                // Waves are longer than a pixel, so at most one lattice column is passed.
                i += 1;
                left = right;
                right = lattice(i + 1);
            }
            let f = (t - i as f64) as f32;
            *value += left + (right - left) * (f * f * (3.0 - 2.0 * f));
        }
    }

    /// Street-grid coordinates (metres) of a pixel position, without the bend.
    pub(crate) fn grid_of(&self, x: f64, y: f64) -> (f32, f32) {
        let g = f64::from(self.gsd_m);
        let (c, s) = (f64::from(self.axis.0), f64::from(self.axis.1));
        (((c * x + s * y) * g) as f32, ((c * y - s * x) * g) as f32)
    }

    fn node(&self, x: u64, y: u64) -> (f32, f32) {
        let (u, v) = self.grid_of(x as f64, y as f64);
        let (p, q) = (u / BEND_LENGTH_M, v / BEND_LENGTH_M);
        let bend = |seed| BEND_M * (value_noise(mix(self.seed ^ seed), p, q) - 0.5);
        (u + bend(11), v + bend(12))
    }

    fn bend(&self, x: u64, y: u64, places: &mut [(f32, f32)]) {
        let mut node = x / NODE_PX * NODE_PX;
        let (mut a, mut b) = (self.node(node, y), self.node(node + NODE_PX, y));
        for (k, place) in places.iter_mut().enumerate() {
            let at = x + k as u64;
            if at >= node + NODE_PX {
                node += NODE_PX;
                a = b;
                b = self.node(node + NODE_PX, y);
            }
            let t = (at - node) as f32 / NODE_PX as f32;
            *place = (a.0 + (b.0 - a.0) * t, a.1 + (b.1 - a.1) * t);
        }
    }

    pub(crate) fn parcel(&self, column: i64, row: i64) -> Parcel {
        let block = hash2(mix(self.seed ^ 21), column.div_euclid(BLOCK), row.div_euclid(BLOCK));
        let own = hash2(mix(self.seed ^ 22), column, row);
        // Blocks have a character: mostly houses, farmland (long fields over the block), wood, or trade.
        let strip = hash2(mix(self.seed ^ 23), column.div_euclid(BLOCK), row);
        let kind = match (block % 100, own % 100, strip % 100) {
            (0..=45, 0..=74, _) => Use::Garden,
            (0..=45, 75..=84, _) => Use::Meadow,
            (0..=45, 85..=90, _) => Use::Pond,
            (0..=45, 91..=95, _) => Use::CarPark,
            (0..=45, _, _) => Use::Wood,
            (46..=71, _, 0..=44) => Use::Crop,
            (46..=71, _, 45..=69) => Use::Soil,
            (46..=71, _, _) => Use::Meadow,
            (72..=83, 0..=79, _) => Use::Wood,
            (72..=83, _, _) => Use::Meadow,
            (_, 0..=44, _) => Use::CarPark,
            (_, 45..=79, _) => Use::Hall,
            (_, _, _) => Use::Meadow,
        };
        let hash = if matches!(kind, Use::Crop | Use::Soil) { strip } else { own };
        let mut rng = Rng::new(hash, 24, 0);
        let tint = [0.0; 3].map(|_: f32| rng.range(-9.0, 9.0) as f32);
        let angle = (if rng.chance(0.5) { 0.0 } else { std::f64::consts::FRAC_PI_2 } + rng.range(-0.06, 0.06)) as f32;
        Parcel { column, row, kind, hash, tint, along: (angle.cos(), angle.sin()) }
    }
}

/// Floor without the library call that the baseline instruction set makes of `f32::floor`.
fn floor(t: f32) -> i64 {
    let whole = t as i64;
    whole - i64::from((whole as f32) > t)
}

/// The part of `t` above its floor.
fn fraction(t: f32) -> f32 {
    t - floor(t) as f32
}

impl Parcel {
    /// Colour of the bare ground at a place of the street grid. `fine` and `coarse` are noise, about ±1.
    fn ground(&self, u: f32, v: f32, fine: f32, coarse: f32) -> [f32; 3] {
        let to_line = |t: f32, period: f32| {
            let r = fraction(t * (1.0 / period));
            r.min(1.0 - r) * period
        };
        let (du, dv) = (to_line(u, PARCEL_M.0 * BLOCK as f32), to_line(v, PARCEL_M.1 * BLOCK as f32));
        let road = du.min(dv);
        if road < PAVEMENT_HALF_M {
            return road_colour(road, if du < dv { v } else { u }, du.max(dv), fine, coarse);
        }
        let edge = to_line(u, PARCEL_M.0).min(to_line(v, PARCEL_M.1));
        let shade = |base: [f32; 3], f: f32, c: f32, tint: f32| {
            let add = fine * f + coarse * c;
            [0, 1, 2].map(|b| base[b] + add * [1.0, 1.0, 0.75][b] + self.tint[b] * tint)
        };
        let stripes = |spacing: f32| {
            let t = (u * self.along.0 + v * self.along.1) / spacing;
            // A triangle wave: cheaper than a sine and, under the noise, as good.
            4.0 * (fraction(t) - 0.5).abs() - 1.0
        };
        match self.kind {
            Use::Garden if edge < 0.45 + 0.2 * coarse => shade([52.0, 74.0, 36.0], 20.0, 6.0, 0.5),
            Use::Garden => shade([104.0, 134.0, 66.0], 9.0, 13.0, 1.0),
            Use::Crop => {
                let rows = stripes(0.75);
                let tram = if stripes(12.0) < -0.88 { -16.0 } else { 0.0 };
                let mut c = shade([122.0, 136.0, 70.0], 11.0, 12.0, 1.8);
                c.iter_mut().for_each(|x| *x += 9.0 * rows + tram);
                c
            }
            Use::Soil => {
                let mut c = shade([128.0, 106.0, 82.0], 12.0, 11.0, 1.2);
                c.iter_mut().for_each(|x| *x += 7.0 * stripes(0.5));
                c
            }
            Use::Meadow => {
                let dry = coarse.max(0.0) * 22.0;
                let c = shade([112.0, 132.0, 72.0], 15.0, 15.0, 1.4);
                [c[0] + dry, c[1] + dry * 0.5, c[2]]
            }
            Use::Wood => shade([64.0, 76.0, 44.0], 17.0, 13.0, 0.5),
            Use::CarPark | Use::Hall => car_park(u, v, edge, fine, coarse, self.kind == Use::CarPark),
            Use::Pond => {
                // The bank wanders with the coarse noise.
                let depth = edge - 3.5 - 2.5 * coarse;
                if depth < -0.5 {
                    shade([98.0, 122.0, 62.0], 13.0, 12.0, 1.0)
                } else if depth < 0.3 {
                    shade([118.0, 110.0, 84.0], 12.0, 8.0, 0.5)
                } else {
                    let deep = (depth / 4.0).min(1.0);
                    let c = shade([70.0, 88.0, 80.0], 3.0, 4.0, 0.4);
                    [c[0] - 28.0 * deep, c[1] - 24.0 * deep, c[2] - 12.0 * deep]
                }
            }
        }
    }
}

/// Asphalt with a dashed middle line, a kerb and a pavement. `crossing` is the distance to the nearest road the other
/// way: no lines are painted on crossings.
fn road_colour(distance: f32, along: f32, crossing: f32, fine: f32, coarse: f32) -> [f32; 3] {
    let grey = if distance > ROAD_HALF_M && crossing > ROAD_HALF_M {
        let slab = fraction(along / 0.6) < 0.06;
        let kerb = distance < ROAD_HALF_M + 0.15;
        if kerb { 188.0 + 8.0 * fine } else { 158.0 + 8.0 * fine + 6.0 * coarse - if slab { 20.0 } else { 0.0 } }
    } else if distance < 0.07 && crossing > 8.0 && fraction(along / 6.0) < 0.5 {
        212.0 + 9.0 * fine
    } else {
        // Tyres polish two tracks a lane.
        let track = (1.0 - ((distance - 1.5).abs() - 0.75).abs() * 2.5).max(0.0);
        106.0 + 9.0 * fine + 8.0 * coarse - 5.0 * track
    };
    [grey, grey, grey * 1.01 + 1.0]
}

fn car_park(u: f32, v: f32, edge: f32, fine: f32, coarse: f32, bays: bool) -> [f32; 3] {
    if edge < 1.2 {
        let g = 12.0 * fine + 9.0 * coarse;
        return [100.0 + g, 126.0 + g, 66.0 + g];
    }
    let fu = fraction(u * (1.0 / PARCEL_M.0)) * PARCEL_M.0;
    let fv = fraction(v * (1.0 / PARCEL_M.1)) * PARCEL_M.1;
    let line = bays
        && BAY_ROWS_M.iter().any(|r| (fv - r).abs() < 2.5)
        && (2.5..PARCEL_M.0 - 2.5).contains(&fu)
        && ((fu - 2.5) / BAY_M).fract() * BAY_M < 0.1;
    let grey = if line { 205.0 } else { 122.0 + 8.0 * coarse } + 8.0 * fine;
    [grey, grey, grey]
}
