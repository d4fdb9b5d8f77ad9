//! From a photograph to the map: where a place of the map lies in the photograph, and whether the ground hides it.

use nalgebra::Vector3;

use crate::camera::Camera;
use crate::pose::Pose;
use crate::reach::Reach;

/// Heights at the centres of the cells of a north-up grid in map coordinates, NaN where there are none. Between centres
/// the surface is bilinear.
#[derive(Clone, Debug)]
pub struct Surface {
    heights: Vec<f32>,
    columns: usize,
    rows: usize,
    /// Centre of the first cell.
    first: [f64; 2],
    step: [f64; 2],
    /// Highest of each block of cells and its eight neighbours.
    near: Vec<f32>,
    blocks: usize,
    range: [f64; 2],
}

const BLOCK: usize = 16;

impl Surface {
    /// From rows of heights; `corner` is the outer corner of the first cell. `None` without a height, or when sizes
    /// disagree.
    pub fn new(heights: Vec<f32>, columns: usize, corner: [f64; 2], step: [f64; 2]) -> Option<Self> {
        let rows = heights.len() / columns.max(1);
        if columns == 0 || rows * columns != heights.len() || step.contains(&0.0) {
            return None;
        }
        let finite = || heights.iter().copied().filter(|h| h.is_finite());
        let (low, high) = finite().fold((f32::MAX, f32::MIN), |(a, b), h| (a.min(h), b.max(h)));
        if low > high {
            return None;
        }
        let (across, down) = (columns.div_ceil(BLOCK), rows.div_ceil(BLOCK));
        let mut highest = vec![f32::MIN; across * down];
        for (k, h) in heights.iter().enumerate().filter(|(_, h)| h.is_finite()) {
            let at = &mut highest[k / columns / BLOCK * across + k % columns / BLOCK];
            *at = at.max(*h);
        }
        let mut near = vec![f32::MIN; across * down];
        for j in 0..down {
            for i in 0..across {
                for b in j.saturating_sub(1)..(j + 2).min(down) {
                    for a in i.saturating_sub(1)..(i + 2).min(across) {
                        near[j * across + i] = near[j * across + i].max(highest[b * across + a]);
                    }
                }
            }
        }
        let first = [corner[0] + step[0] / 2.0, corner[1] + step[1] / 2.0];
        let range = [f64::from(low), f64::from(high)];
        Some(Surface { heights, columns, rows, first, step, near, blocks: across, range })
    }

    /// Heights row by row, the number of columns, the outer corner of the first cell, and the step from cell to cell.
    pub fn cells(&self) -> (&[f32], usize, [f64; 2], [f64; 2]) {
        let corner = [self.first[0] - self.step[0] / 2.0, self.first[1] - self.step[1] / 2.0];
        (&self.heights, self.columns, corner, self.step)
    }

    /// Lowest and highest.
    pub fn range(&self) -> [f64; 2] {
        self.range
    }

    /// Map units of a cell, the shorter side.
    pub fn cell(&self) -> f64 {
        self.step[0].abs().min(self.step[1].abs())
    }

    /// Columns and rows from the centre of the first cell.
    fn place(&self, x: f64, y: f64) -> [f64; 2] {
        [(x - self.first[0]) / self.step[0], (y - self.first[1]) / self.step[1]]
    }

    fn inside(&self, p: [f64; 2]) -> bool {
        p[0] >= -0.5 && p[1] >= -0.5 && p[0] <= self.columns as f64 - 0.5 && p[1] <= self.rows as f64 - 0.5
    }

    /// Height at a place of the map; none outside and beside cells that have none.
    pub fn height(&self, x: f64, y: f64) -> Option<f64> {
        let p = self.place(x, y);
        if !self.inside(p) {
            return None;
        }
        // The outer half of the border's cells is level.
        let axis = |v: f64, n: usize| {
            let v = v.clamp(0.0, (n - 1) as f64);
            let low = (v.floor() as usize).min(n.saturating_sub(2));
            (low, (low + 1).min(n - 1), v - low as f64)
        };
        let ((i, i1, a), (j, j1, b)) = (axis(p[0], self.columns), axis(p[1], self.rows));
        let at = |i: usize, j: usize| f64::from(self.heights[j * self.columns + i]);
        let corner = |weight: f64, height: f64| if weight == 0.0 { 0.0 } else { weight * height };
        let h = corner((1.0 - a) * (1.0 - b), at(i, j))
            + corner(a * (1.0 - b), at(i1, j))
            + corner((1.0 - a) * b, at(i, j1))
            + corner(a * b, at(i1, j1));
        h.is_finite().then_some(h)
    }

    /// Highest ground within a block's width of a place, if the place is on the grid.
    fn highest_near(&self, p: [f64; 2]) -> Option<f64> {
        if !self.inside(p) {
            return None;
        }
        let (i, j) = (p[0].round().max(0.0) as usize, p[1].round().max(0.0) as usize);
        let (i, j) = (i.min(self.columns - 1), j.min(self.rows - 1));
        Some(f64::from(self.near[j / BLOCK * self.blocks + i / BLOCK]))
    }

    /// Whether ground rises above the straight line from `from` (a place on the surface) to `eye`. `sag` is 1/(2R) of
    /// the Earth's radius in map units, or 0: a straight line sinks towards a curved datum between its ends.
    pub fn hides(&self, from: [f64; 3], eye: [f64; 3], sag: f64) -> bool {
        let d = [eye[0] - from[0], eye[1] - from[1]];
        let (start, end) = (self.place(from[0], from[1]), self.place(eye[0], eye[1]));
        // Length in cells, and in map units.
        let cells = (end[0] - start[0]).hypot(end[1] - start[1]);
        let length = d[0].hypot(d[1]);
        if cells < 0.5 {
            return false;
        }
        let line = |t: f64| from[2] + (eye[2] - from[2]) * t - length * length * t * (1.0 - t) * sag;
        // What the surface's own roughness between two steps may amount to.
        let slack = 0.02 * self.cell();
        let mut at = 0.5;
        while at < cells {
            let t = at / cells;
            let h = line(t);
            let p = [start[0] + (end[0] - start[0]) * t, start[1] + (end[1] - start[1]) * t];
            let Some(near) = self.highest_near(p) else { return false };
            let ahead = ((at + BLOCK as f64) / cells).min(1.0);
            if h.min(line(ahead)) - length * length * (ahead - t).powi(2) * sag > near {
                if h > self.range[1] && eye[2] >= h && sag == 0.0 {
                    return false;
                }
                at += BLOCK as f64;
                continue;
            }
            let (x, y) = (from[0] + d[0] * t, from[1] + d[1] * t);
            if self.height(x, y).is_some_and(|g| g > h + slack) {
                return true;
            }
            at += 0.5;
        }
        false
    }

    /// Where a ray from `eye` first meets the surface. `direction` is in the map's axes, of unit length on the ground:
    /// on a map that stretches it, its part in the plan is longer. `sag` is of lengths of the map.
    pub fn meets(&self, eye: [f64; 3], direction: [f64; 3], sag: f64) -> Option<[f64; 3]> {
        let across = direction[0].hypot(direction[1]);
        let at = |s: f64| {
            let flat = across * s;
            [eye[0] + direction[0] * s, eye[1] + direction[1] * s, eye[2] + direction[2] * s + flat * flat * sag]
        };
        // From where the ray comes below the highest ground to where it is under the lowest or has left the grid.
        let mut s = 0.0;
        if eye[2] > self.range[1] {
            if direction[2] >= 0.0 {
                return None;
            }
            s = ((self.range[1] + 2.0 * self.cell() - eye[2]) / direction[2]).max(0.0);
        }
        let far = {
            let far = |axis: usize, n: usize| {
                let end = self.first[axis] + self.step[axis] * n as f64;
                (eye[axis] - self.first[axis]).abs().max((eye[axis] - end).abs())
            };
            far(0, self.columns).hypot(far(1, self.rows))
        };
        let step = self.cell() / across.max(0.2);
        let mut above: Option<f64> = None;
        while across * s <= far + self.cell() {
            let x = at(s);
            if direction[2] >= 0.0 && x[2] > self.range[1] {
                return None;
            }
            // Above all ground nearby, a block's width at once.
            let skip = BLOCK as f64 * step;
            let lowest = x[2].min(at(s + skip)[2]) - (across * skip).powi(2) * sag;
            if self.highest_near(self.place(x[0], x[1])).is_some_and(|near| lowest > near) {
                above = Some(s);
                s += skip;
                continue;
            }
            match self.height(x[0], x[1]) {
                Some(h) if x[2] <= h => {
                    let (mut low, mut high) = (above?, s);
                    for _ in 0..40 {
                        let middle = (low + high) / 2.0;
                        let x = at(middle);
                        if self.height(x[0], x[1]).is_some_and(|h| x[2] <= h) { high = middle } else { low = middle }
                    }
                    return Some(at(high));
                }
                Some(_) => above = Some(s),
                // A ray may enter the grid from its side, above ground.
                None => above = None,
            }
            // After the ground, not before: a steep step may cross it and come out below the lowest.
            if direction[2] < 0.0 && x[2] < self.range[0] {
                return None;
            }
            s += step;
        }
        None
    }
}

/// What lies at a place of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// This pixel of the photograph.
    Pixel([f64; 2]),
    /// The photograph does not show it.
    Outside,
    /// Ground stands before it.
    Hidden,
    /// The elevation model has no height there.
    NoHeight,
}

/// A photograph over a surface.
pub struct View<'a> {
    pub camera: &'a Camera,
    /// In the frame that `to_world` of [`View::at`] leads to.
    pub pose: Pose,
    /// The camera's centre in the map.
    pub eye: [f64; 3],
    pub surface: &'a Surface,
    /// 1/(2R), or 0 on a plane.
    pub sag: f64,
    /// [`Camera::reach`].
    pub reach: Reach,
}

impl View<'_> {
    /// What lies at (x, y) of the map; `to_world` takes a height there to the frame of the pose.
    pub fn at(&self, x: f64, y: f64, to_world: impl Fn(f64) -> Vector3<f64>) -> Place {
        let Some(h) = self.surface.height(x, y) else { return Place::NoHeight };
        let p = self.pose.to_camera(&to_world(h));
        match self.camera.shows(p.into(), &self.reach) {
            None => Place::Outside,
            Some(_) if self.surface.hides([x, y, h], self.eye, self.sag) => Place::Hidden,
            Some(pixel) => Place::Pixel(pixel),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of 50 m at x = 100 … 110 on a plane, cells of 2 m.
    fn wall() -> Surface {
        let heights = (0..100 * 100).map(|k| if (50..55).contains(&(k % 100)) { 50.0 } else { 0.0 }).collect();
        Surface::new(heights, 100, [0.0, 200.0], [2.0, -2.0]).expect("heights")
    }

    #[test]
    fn a_wall_hides_what_lies_behind_it() {
        let surface = wall();
        // From (0, 100, 100) the line over the wall's far edge at (110, 50) comes down at x = 220: nothing on the grid
        // is seen.
        let eye = [0.0, 100.0, 100.0];
        assert!(!surface.hides([60.0, 100.0, 0.0], eye, 0.0) && surface.hides([150.0, 100.0, 0.0], eye, 0.0));
        // From 300 m the shadow ends 22 m behind the wall.
        let high = [0.0, 100.0, 300.0];
        assert!(surface.hides([118.0, 100.0, 0.0], high, 0.0) && !surface.hides([140.0, 100.0, 0.0], high, 0.0));
        assert!(!surface.hides([105.0, 100.0, 50.0], high, 0.0));
    }

    #[test]
    fn rays_meet_the_first_ground() {
        let surface = wall();
        let s = 0.5f64.sqrt();
        let at = surface.meets([0.0, 100.0, 120.0], [s, 0.0, -s], 0.0).expect("the wall");
        assert!((at[2] - 20.0).abs() < 4.0 && (at[0] - 100.0).abs() < 3.0, "{at:?}");
        let down = surface.meets([30.0, 100.0, 500.0], [0.0, 0.0, -1.0], 0.0).expect("ground");
        assert!(down[2].abs() < 1e-6);
        assert!(surface.meets([30.0, 100.0, 500.0], [0.0, 0.0, 1.0], 0.0).is_none());
    }

    #[test]
    fn heights_are_bilinear_and_holes_stay_holes() {
        let mut heights: Vec<f32> = (0..25).map(|k| (k % 5) as f32 * 3.0 + (k / 5) as f32).collect();
        heights[12] = f32::NAN;
        let surface = Surface::new(heights, 5, [0.0, 5.0], [1.0, -1.0]).expect("heights");
        assert!((surface.height(1.0, 4.25).expect("inside") - (1.5 + 0.25)).abs() < 1e-6);
        assert!(surface.height(2.4, 2.4).is_none() && surface.height(-0.1, 1.0).is_none());
        assert!(Surface::new(vec![f32::NAN; 4], 2, [0.0; 2], [1.0, -1.0]).is_none());
    }
}
