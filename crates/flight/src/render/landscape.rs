//! The ground that frames are rendered of: heights, and what covers them.

use autoref_synth::rng::value_noise;

use crate::ortho::Surface;

/// Wavelengths of the drawn cover, metres: longest, and how many halvings follow.
const LONGEST_M: f64 = 800.0;
const OCTAVES: u32 = 14;

/// An image of the ground, seen from above.
#[derive(Clone, Debug)]
pub struct Cover {
    /// Bands behind each other in a pixel, 0..=255.
    pub data: Vec<u8>,
    pub width: usize,
    pub height: usize,
    /// 1 or 3.
    pub bands: usize,
    /// Map → pixel: `x = m[0] + m[1]·e + m[2]·n`, `y = m[3] + m[4]·e + m[5]·n`.
    pub to_pixel: [f64; 6],
    /// Ground size of a pixel.
    pub gsd_m: f64,
}

impl Cover {
    /// Mean colour around a place, 0..=1; none outside. What is wider than a pixel is averaged over its width.
    fn at(&self, e: f64, n: f64, width_m: f64) -> Option<[f64; 3]> {
        let m = &self.to_pixel;
        let (x, y) = (m[0] + m[1] * e + m[2] * n - 0.5, m[3] + m[4] * e + m[5] * n - 0.5);
        let inside = x > -0.5 && y > -0.5 && x < self.width as f64 - 0.5 && y < self.height as f64 - 0.5;
        if !inside {
            return None;
        }
        let reach = (0.5 * (width_m / self.gsd_m - 1.0)).clamp(0.0, 24.0).round() as i64;
        let (left, top) = (x.floor() as i64, y.floor() as i64);
        let (fx, fy) = (x - left as f64, y - top as f64);
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        for dy in -reach..=reach + 1 {
            for dx in -reach..=reach + 1 {
                // A box of 2·reach + 1 pixels with soft ends: bilinear when it is one pixel.
                let end = |d: i64, f: f64| {
                    if d == -reach {
                        1.0 - f
                    } else if d == reach + 1 {
                        f
                    } else {
                        1.0
                    }
                };
                let weight = end(dx, fx) * end(dy, fy);
                let i = (left + dx).clamp(0, self.width as i64 - 1) as usize;
                let j = (top + dy).clamp(0, self.height as i64 - 1) as usize;
                let at = (j * self.width + i) * self.bands;
                for (band, total) in sum.iter_mut().enumerate() {
                    *total += weight * f64::from(self.data[at + band.min(self.bands - 1)]);
                }
                weights += weight;
            }
        }
        Some(sum.map(|v| v / weights / 255.0))
    }
}

/// Heights and cover.
#[derive(Clone, Debug)]
pub struct Landscape {
    pub surface: Surface,
    /// Without one, or outside it, the cover is drawn: meadow, scree, rock and snow by height and slope, with detail at
    /// all scales.
    pub cover: Option<Cover>,
    pub seed: u64,
    /// At and below this height there is water.
    pub sea_level_m: Option<f64>,
    /// Above it flat ground is snow.
    pub snow_line_m: f64,
}

impl Landscape {
    /// Hills, ridges and a sea around a place: `side_m` wide, heights up to about `relief_m`.
    ///
    /// # Panics
    /// When `cell_m` is zero.
    pub fn drawn(seed: u64, centre: [f64; 2], side_m: f64, cell_m: f64, relief_m: f64) -> Landscape {
        let cells = (side_m / cell_m).round().max(2.0) as usize;
        let corner = [centre[0] - side_m / 2.0, centre[1] + side_m / 2.0];
        let mut heights = vec![0f32; cells * cells];
        use rayon::prelude::*;
        heights.par_chunks_mut(cells).enumerate().for_each(|(row, line)| {
            let n = (corner[1] - (row as f64 + 0.5) * cell_m) as f32;
            for (column, height) in line.iter_mut().enumerate() {
                let e = (corner[0] + (column as f64 + 0.5) * cell_m) as f32;
                *height = (relief_m as f32 * relief(seed, e, n)).max(0.0);
            }
        });
        let surface = Surface::new(heights, cells, corner, [cell_m, -cell_m]).expect("as many heights as cells");
        Landscape { surface, cover: None, seed, sea_level_m: Some(0.0), snow_line_m: 0.62 * relief_m }
    }

    /// Steepness and the upward normal, by differences over a cell.
    pub(super) fn normal(&self, e: f64, n: f64) -> [f64; 3] {
        let step = self.surface.cell();
        let at = |x: f64, y: f64| self.surface.height(x, y);
        let slope = |low: Option<f64>, high: Option<f64>| low.zip(high).map_or(0.0, |(l, h)| (h - l) / (2.0 * step));
        let (de, dn) = (slope(at(e - step, n), at(e + step, n)), slope(at(e, n - step), at(e, n + step)));
        let length = (1.0 + de * de + dn * dn).sqrt();
        [-de / length, -dn / length, 1.0 / length]
    }

    /// Colour of the ground in flat light, 0..=1; `width_m` is what a pixel sees of it.
    pub(super) fn colour(&self, e: f64, n: f64, h: f64, up: f64, width_m: f64) -> [f64; 3] {
        if let Some(colour) = self.cover.as_ref().and_then(|cover| cover.at(e, n, width_m)) {
            return colour;
        }
        // From the model's corner: singles of coordinates of a map are coarser than short waves.
        let [west, north] = self.surface.cells().2;
        let (e, n) = (e - west.round(), n - north.round());
        let noise = |purpose: u64, wave: f64| {
            f64::from(value_noise(self.seed ^ (purpose << 32), (e / wave) as f32, (n / wave) as f32)) - 0.5
        };
        let mut detail = 0.0;
        let mut wave = LONGEST_M;
        for octave in 0..OCTAVES {
            if wave < 2.0 * width_m {
                break;
            }
            detail += 0.16 * noise(u64::from(octave) + 1, wave);
            wave /= 2.0;
        }
        // Rock where it is steep, snow where it is high and flat, meadow below.
        let ragged = 60.0 * noise(40, 300.0) + 25.0 * noise(41, 70.0);
        let soft = |v: f64| (v * 0.5 + 0.5).clamp(0.0, 1.0);
        let rock = soft((0.86 - up) * 14.0);
        let snow = soft((h + ragged - self.snow_line_m) / 40.0) * (1.0 - rock);
        let (meadow, stone, white) = ([0.34, 0.42, 0.24], [0.46, 0.43, 0.40], [0.90, 0.91, 0.93]);
        std::array::from_fn(|c| {
            let ground = meadow[c] + (stone[c] - meadow[c]) * rock + detail * (1.0 - 0.25 * c as f64 * (1.0 - rock));
            (ground + (white[c] + 0.25 * detail - ground) * snow).clamp(0.02, 1.0)
        })
    }

    /// Whether a place at this height is water.
    pub(super) fn is_sea(&self, h: f64) -> bool {
        self.sea_level_m.is_some_and(|level| h <= level + 1e-3)
    }
}

/// Ridged fractal relief about −0.3 to 1: K. Musgrave's ridges on value noise, finer where it is high.
fn relief(seed: u64, e: f32, n: f32) -> f32 {
    let (mut sum, mut weight, mut total) = (0.0, 1.0, 0.0);
    let mut wave = 9_000.0f32;
    for octave in 0..9u64 {
        let v = value_noise(seed ^ (octave << 20) ^ 0x7e77, e / wave, n / wave);
        let ridge = 1.0 - (2.0 * v - 1.0).abs();
        sum += weight * if octave < 1 { v } else { ridge * (0.4 + 0.6 * v) };
        total += weight;
        weight *= 0.47;
        wave *= 0.47;
    }
    (sum / total - 0.33) * 2.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cover_is_read_where_it_lies_and_averaged_where_pixels_are_wide() {
        let data: Vec<u8> = (0..20 * 10).map(|k| if k % 20 < 10 { 0 } else { 200 }).collect();
        let to_pixel = [-100.0, 1.0, 0.0, 510.0, 0.0, -1.0];
        let cover = Cover { data, width: 20, height: 10, bands: 1, to_pixel, gsd_m: 1.0 };
        let grey = |e: f64, width: f64| cover.at(e, 505.0, width).map(|c| (255.0 * c[0]).round());
        assert_eq!((grey(103.0, 1.0), grey(115.0, 1.0)), (Some(0.0), Some(200.0)));
        assert_eq!((grey(110.0, 1.0), grey(99.0, 1.0)), (Some(100.0), None));
        assert_eq!(grey(110.0, 5.0), Some(100.0));
        assert!(grey(108.0, 5.0) > Some(0.0), "the edge is within the width");
    }

    #[test]
    fn a_drawn_landscape_has_hills_and_a_sea() {
        let land = Landscape::drawn(3, [0.0, 0.0], 20_000.0, 50.0, 900.0);
        let [low, high] = land.surface.range();
        assert!(low == 0.0 && (400.0..1_300.0).contains(&high), "{low} {high}");
        let heights = (0..400).filter_map(|k| {
            land.surface.height(-9_000.0 + 900.0 * f64::from(k % 20), -9_000.0 + 900.0 * f64::from(k / 20))
        });
        let wet = heights.filter(|h| land.is_sea(*h)).count();
        assert!((10..300).contains(&wet), "{wet} of 400 places are water");
    }
}
