//! Lakes that mirror what stands above them.
//!
//! A calm lake shows the trees and rocks of its shore, so that a forest that looks at windows of a few pixels keeps
//! it. But it shows them upside down: about the line where they meet, rows below are like rows above. The frame is
//! looked at in a few hundred cells. Of each cell's brightness only the difference to its neighbours in the row
//! counts, because every level line, a horizon for one, is its own mirror image. Where the rows about one line are
//! alike, and about all others are not, cells that are like their mirror image are water.
//!
//! All sums are of integers over the whole frame, in one order: nothing depends on tiles or threads.

use autoref_raster::error::Result;
use autoref_raster::window::Window;

use crate::bits::BitMask;
use crate::plane::Plane;

/// Cells along the longer side, at least; fewer than twice as many.
const CELLS: usize = 256;

/// Radius of the row's part that a cell is compared with, and of the window in which it is compared with its mirror
/// image, cells.
const NEIGHBOURS: usize = 8;

/// Grey levels are counted in so many parts.
const PARTS: i64 = 16;

/// The rows that are compared begin so far from the line and end so far, parts of the frame's height. Nearer ones are
/// alike wherever something stands upright.
const NEAR: f64 = 0.03;
const FAR: f64 = 0.22;

/// Another line lies farther from the best one than this part of the height.
const APART: f64 = 0.03;

/// A line mirrors when its likeness (a correlation), squared, is at least so many times that of the best other line,
/// which counts as [`LEAST_OTHER`] at least. Of 504 views of the frames that teach (as they are, turned, upside down
/// and cut) those without a mirror reached 0.71; the faintest lake that is seen whole has 1.0.
const LEAST_CONTRAST: f64 = 0.85;
const LEAST_OTHER: f64 = 0.05;

/// And its likeness is at least so many times that of the best other line: about what stands upright, all lines are
/// alike. Chosen; a lake had 2.4 at least.
const LEAST_TIMES: f64 = 2.0;

/// A cell is water when its window is at least so like its mirror image. With 0.4 more of the teaching lakes was kept.
const LEAST_LIKENESS: f64 = 0.3;

/// Mirror images are looked for up to this part of the height away: what is near stands above a lower line.
const MOVES: f64 = 0.03;

/// Product of two variances below which windows are even and like nothing, grey levels to the fourth power.
const EVEN: f64 = 0.05;

/// The frame in cells: how much each is brighter than its neighbours in the row, [`PARTS`] of a grey level.
struct Cells {
    width: usize,
    height: usize,
    values: Vec<i64>,
    /// Pixels along a cell's side.
    side: usize,
}

impl Cells {
    /// Cells with a pixel that holds nothing are like their neighbours.
    fn of(grey: &Plane, valid: &BitMask) -> Result<Cells> {
        let side = (grey.width().max(grey.height()) / CELLS).max(1);
        let (width, height) = (grey.width() / side, grey.height() / side);
        let mut cells = Cells { width, height, values: Vec::with_capacity(width * height), side };
        for y in 0..height {
            let window = Window::new(0, (y * side) as u64, grey.width() as u64, side as u64);
            let pixels = grey.read(&window)?;
            let mut sums = vec![Some(0i64); width];
            for (i, row) in pixels.chunks_exact(grey.width()).enumerate() {
                for (x, &level) in row[..width * side].iter().enumerate() {
                    let sum = &mut sums[x / side];
                    *sum = sum.filter(|_| valid.get(x, y * side + i)).map(|sum| sum + i64::from(level));
                }
            }
            let level = |sum: &Option<i64>| sum.map(|sum| sum * PARTS / (side * side) as i64);
            let levels: Vec<Option<i64>> = sums.iter().map(level).collect();
            cells.values.extend((0..width).map(|x| against_neighbours(&levels, x)));
        }
        Ok(cells)
    }

    fn row(&self, y: usize) -> &[i64] {
        &self.values[y * self.width..][..self.width]
    }

    /// A part of the height, cells.
    fn part(&self, of: f64) -> usize {
        (of * self.height as f64) as usize
    }

    /// How like the rows are that lie about a line, −1…1. `line` is twice its row: rows y and `line` − y mirror.
    /// Nothing where not all of them lie in the frame.
    fn likeness(&self, line: usize, energies: &[i64]) -> Option<f64> {
        let middle = line.div_ceil(2);
        let rows = middle + self.part(NEAR).max(3)..middle + self.part(FAR);
        if rows.is_empty() || rows.end > self.height || line + 1 < rows.end {
            return None;
        }
        let (mut product, mut energy) = (0, [0; 2]);
        for y in rows {
            product += self.row(y).iter().zip(self.row(line - y)).map(|(a, b)| a * b).sum::<i64>();
            energy = [energy[0] + energies[y], energy[1] + energies[line - y]];
        }
        let whole = (energy[0] as f64 * energy[1] as f64).sqrt();
        Some(if whole > 0.0 { product as f64 / whole } else { 0.0 })
    }

    /// Twice the row of the line that mirrors.
    fn line(&self) -> Option<usize> {
        let energies: Vec<i64> = (0..self.height).map(|y| self.row(y).iter().map(|v| v * v).sum()).collect();
        let all: Vec<(usize, f64)> =
            (0..2 * self.height).filter_map(|line| Some((line, self.likeness(line, &energies)?))).collect();
        let (line, best) = all.iter().copied().reduce(|best, one| if one.1 > best.1 { one } else { best })?;
        let apart = 2.0 * APART * self.height as f64;
        let others = all.iter().filter(|(other, _)| other.abs_diff(line) as f64 > apart);
        let other = others.map(|(_, likeness)| *likeness).fold(LEAST_OTHER, f64::max);
        (best >= LEAST_TIMES * other && best * best >= LEAST_CONTRAST * other).then_some(line)
    }

    /// Sums over windows of (2 [`NEIGHBOURS`] + 1)², of what of them lies in the frame.
    fn window_sums(&self, values: &[i64]) -> Vec<i64> {
        let (w, h, r) = (self.width, self.height, NEIGHBOURS);
        let mut across = vec![0; w * h];
        for (row, out) in values.chunks_exact(w).zip(across.chunks_exact_mut(w)) {
            let mut sum: i64 = row[..r.min(w)].iter().sum();
            for x in 0..w {
                sum += row.get(x + r).copied().unwrap_or(0);
                out[x] = sum;
                sum -= if x >= r { row[x - r] } else { 0 };
            }
        }
        let mut out = vec![0; w * h];
        let mut column = vec![0; w];
        for y in 0..h + r {
            if y < h {
                column.iter_mut().zip(&across[y * w..]).for_each(|(sum, v)| *sum += v);
            }
            if y >= r {
                out[(y - r) * w..(y - r + 1) * w].copy_from_slice(&column);
            }
            if y >= 2 * r {
                column.iter_mut().zip(&across[(y - 2 * r) * w..]).for_each(|(sum, v)| *sum -= v);
            }
        }
        out
    }

    /// The cells below `line` that are like their mirror image.
    fn mirrored(&self, line: usize) -> BitMask {
        let (w, h) = (self.width, self.height);
        let energy = self.window_sums(&self.values.iter().map(|v| v * v).collect::<Vec<i64>>());
        let pixels = self.window_sums(&vec![1; w * h]);
        let moves = self.part(2.0 * MOVES);
        let mut water = BitMask::new(w, h);
        for line in line.saturating_sub(moves)..=line + moves {
            let mut products = vec![0; w * h];
            for y in 0..h.min(line + 1) {
                if line - y < h {
                    let pairs = self.row(y).iter().zip(self.row(line - y));
                    products[y * w..].iter_mut().zip(pairs).for_each(|(product, (a, b))| *product = a * b);
                }
            }
            let products = self.window_sums(&products);
            for y in self.below(line, moves)..h.min(line + 1) {
                for x in 0..w {
                    let i = y * w + x;
                    let other = energy[(line - y) * w + x] as f64;
                    let even = EVEN * (PARTS.pow(4) * pixels[i] * pixels[i]) as f64;
                    if products[i] as f64 > LEAST_LIKENESS * (energy[i] as f64 * other + even).sqrt() {
                        water.set(x, y, true);
                    }
                }
            }
        }
        water
    }

    /// The first row that lies below all lines that are tried about `line`.
    fn below(&self, line: usize, moves: usize) -> usize {
        ((line + moves) / 2 + 1).min(self.height)
    }
}

/// How much a cell is brighter than the mean of those near it in its row.
fn against_neighbours(levels: &[Option<i64>], x: usize) -> i64 {
    let near = &levels[x.saturating_sub(NEIGHBOURS)..(x + NEIGHBOURS + 1).min(levels.len())];
    let (sum, count) = near.iter().flatten().fold((0, 0), |(sum, count), level| (sum + level, count + 1));
    levels[x].map_or(0, |level| (level * count - sum) / count)
}

/// Masks what mirrors the ground above it. Pixels outside `valid` are not looked at.
///
/// # Errors
/// When the plane cannot be read.
pub fn mask_mirrored(mask: &mut BitMask, grey: &Plane, valid: &BitMask) -> Result<()> {
    let cells = Cells::of(grey, valid)?;
    let Some(line) = cells.line() else {
        return Ok(());
    };
    let water = cells.mirrored(line);
    for y in 0..mask.height() {
        for x in 0..mask.width() {
            if water.get((x / cells.side).min(cells.width - 1), (y / cells.side).min(cells.height - 1)) {
                mask.set(x, y, false);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use autoref_raster::random::SplitMix64;

    use super::*;

    const SIZE: (usize, usize) = (400, 300);

    /// Ground of soft noise to row 140, an even strip to 150, what `below` says of the row's mirror image from there.
    fn scene(below: impl Fn(u8, u8) -> u8) -> Plane {
        let mut draws = SplitMix64(1936);
        let noise: Vec<f64> = (0..SIZE.0 * SIZE.1).map(|_| draws.normal()).collect();
        let soft = |x: usize, y: usize| {
            let near = (0..8).flat_map(|j| (0..8).map(move |i| (i, j)));
            near.map(|(i, j)| noise[(y + j) % SIZE.1 * SIZE.0 + (x + i) % SIZE.0]).sum::<f64>()
        };
        let level = |x: usize, y: usize| (120.0 + 4.0 * soft(x, y)).clamp(0.0, 255.0) as u8;
        let pixels: Vec<u8> = (0..SIZE.0 * SIZE.1)
            .map(|i| match (i % SIZE.0, i / SIZE.0) {
                (x, y @ 0..150) => level(x, y),
                (x, y) => below(level(x, 299 - y), level(x, y)),
            })
            .collect();
        let mut plane = Plane::new(SIZE.0, SIZE.1, u64::MAX).expect("a plane");
        plane.write(&Window::whole(SIZE.0 as u64, SIZE.1 as u64), &pixels).expect("written");
        plane
    }

    fn kept(plane: &Plane, rows: std::ops::Range<usize>) -> f64 {
        let valid = BitMask::from_fn(SIZE.0, SIZE.1, |_, _| true);
        let mut mask = valid.clone();
        mask_mirrored(&mut mask, plane, &valid).expect("read");
        let count = rows.len() * SIZE.0;
        rows.flat_map(|y| (0..SIZE.0).map(move |x| (x, y))).filter(|&(x, y)| mask.get(x, y)).count() as f64
            / count as f64
    }

    #[test]
    fn a_dark_mirror_image_is_masked_and_the_ground_above_stays() {
        let lake = scene(|mirrored, other| 20 + mirrored / 3 + other / 8);
        assert_eq!(kept(&lake, 0..150), 1.0);
        assert!(kept(&lake, 160..290) < 0.05, "{}", kept(&lake, 160..290));
    }

    #[test]
    fn ground_and_upright_lines_stay() {
        assert_eq!(kept(&scene(|_, other| other), 0..300), 1.0);
        let mut stripes = Plane::new(SIZE.0, SIZE.1, u64::MAX).expect("a plane");
        let pixels: Vec<u8> = (0..SIZE.0 * SIZE.1).map(|i| (i % SIZE.0 * 7 % 90) as u8).collect();
        stripes.write(&Window::whole(SIZE.0 as u64, SIZE.1 as u64), &pixels).expect("written");
        assert_eq!(kept(&stripes, 0..300), 1.0);
    }

    #[test]
    fn small_and_empty_frames_have_no_line() {
        for (width, height) in [(1, 1), (3, 40), (40, 3), (300, 2)] {
            let plane = Plane::new(width, height, u64::MAX).expect("a plane");
            for held in [true, false] {
                let valid = BitMask::from_fn(width, height, |_, _| held);
                let mut mask = BitMask::from_fn(width, height, |_, _| true);
                mask_mirrored(&mut mask, &plane, &valid).expect("read");
                assert!((0..height).all(|y| (0..width).all(|x| mask.get(x, y))));
            }
        }
    }
}
