//! What ground a frame sees: its outline on the map, and the model where it matters.

use anyhow::Result;
use autoref_elevation::grid::Grid;
use autoref_flight::ortho::{Place, Surface, View};
use autoref_flight::world::World;
use autoref_flight::{Camera, Error, Pose, Reach};
use autoref_raster::error::Error as RasterError;
use autoref_raster::ranks::upper_median;
use autoref_raster::window::Window;
use nalgebra::{Matrix2, Matrix3, Vector3};

use super::OrthorectifyArgs;
use super::model::Dem;
use super::place::Lattice;

/// A frame's camera over the model, in metres of the map.
pub(super) struct Seer<'a> {
    world: &'a World,
    camera: &'a Camera,
    reach: Reach,
    pose: Pose,
    eye: [f64; 3],
    /// Half of the Earth's curvature over lengths of the map, or zero where it is flat.
    sag: f64,
    /// From the world's axes to the map's at the camera, and from lengths on the ground to those of the map.
    to_map: Matrix3<f64>,
    /// Lengths of the map over those on the ground.
    scale: f64,
}

/// The ground that a frame sees.
pub(super) struct Seen {
    /// Box of the map, metres.
    pub bounds: [f64; 4],
    /// Median size of a pixel across the view, metres of the map.
    pub across: f64,
    /// The model below the frame and between it and the camera.
    pub surface: Surface,
}

/// Rays along each side of a frame, less one.
const RAYS: usize = 48;
/// How often the place of a border between two rays is halved.
const HALVINGS: usize = 12;
/// Cells of the thinned model, and places of it that are looked for in the frame.
const THINNED_CELLS: u64 = 4_000_000;
const MOST_PLACES: usize = 1_000_000;

/// Where a ray meets the ground.
struct Hit {
    /// By the map's scale at the camera, and by its own: far away scale and north are others.
    at: [[f64; 3]; 2],
    /// Size of a pixel across the view, metres of the map.
    across: f64,
}

/// A box of the map that grows; upside down while it is empty.
#[derive(Clone, Copy)]
struct Outline([f64; 4]);

impl Outline {
    const EMPTY: Outline = Outline([f64::MAX, f64::MAX, f64::MIN, f64::MIN]);

    fn hold(&mut self, [x, y]: [f64; 2], margin: [f64; 2]) {
        let b = self.0;
        let (low, high) = ([x - margin[0], y - margin[1]], [x + margin[0], y + margin[1]]);
        self.0 = [b[0].min(low[0]), b[1].min(low[1]), b[2].max(high[0]), b[3].max(high[1])];
    }

    fn hold_hit(&mut self, hit: &Hit) {
        hit.at.iter().for_each(|at| self.hold([at[0], at[1]], [0.0; 2]));
    }

    fn holds(&self, [x, y]: [f64; 2]) -> bool {
        (self.0[0]..=self.0[2]).contains(&x) && (self.0[1]..=self.0[3]).contains(&y)
    }
}

impl<'c> Seer<'c> {
    /// A camera at a place of the map, in metres as the world has it.
    pub fn new(world: &'c World, camera: &'c Camera, pose: Pose, eye: [f64; 3]) -> Self {
        let plan = world.map_scale(eye).unwrap_or_else(Matrix2::identity);
        let mut stretch = Matrix3::identity();
        stretch.fixed_view_mut::<2, 2>(0, 0).copy_from(&plan);
        let axes = world.grid(eye).unwrap_or_else(Matrix3::identity);
        let area = plan.determinant().abs();
        let sag = if matches!(world, World::Flat { .. }) { 0.0 } else { 0.5 / 6_371_000.0 / area };
        let reach = camera.reach();
        Seer { world, camera, reach, pose, eye, sag, to_map: stretch * axes.transpose(), scale: area.sqrt() }
    }

    pub fn view<'a>(&'a self, surface: &'a Surface) -> View<'a> {
        View { camera: self.camera, pose: self.pose, eye: self.eye, surface, sag: self.sag, reach: self.reach }
    }

    /// The outline from a thinned model, then the model where it matters.
    pub fn ground(&self, args: &OrthorectifyArgs, dem: &Dem, budget_bytes: u64) -> Result<Seen> {
        let all = Window::new(0, 0, dem.grid.width, dem.grid.height);
        let coarse = dem.surface(&args.dem, all, THINNED_CELLS)?;
        let (bounds, across) = self.footprint(&coarse).ok_or_else(|| {
            Error::no_result(
                format!("{}: none of its rays meets {}", args.frame.display(), args.dem.display()),
                "check the CRS, the camera's position and direction, and the area of the model",
            )
        })?;
        drop(coarse);
        let (all, eye) = (dem.grid.bounds(), self.eye);
        let bounds = [bounds[0].max(all[0]), bounds[1].max(all[1]), bounds[2].min(all[2]), bounds[3].min(all[3])];
        let with_eye = [bounds[0].min(eye[0]), bounds[1].min(eye[1]), bounds[2].max(eye[0]), bounds[3].max(eye[1])];
        let part = dem.window(with_eye, 4.0);
        let needed = part.area() * 4;
        if needed > budget_bytes / 3 {
            return Err(RasterError::Limit {
                what: format!("{}: the part between camera and footprint", args.dem.display()),
                needed,
                allowed: budget_bytes / 3,
                remedy: "raise --memory, or thin the model with gdal_translate -outsize".into(),
            }
            .into());
        }
        Ok(Seen { bounds, across, surface: dem.surface(&args.dem, part, u64::MAX)? })
    }

    /// The box of the ground that the frame sees, and the median size of a pixel across the view. Rays over the whole
    /// frame tell it where all of them meet the ground. Where some meet none, the frame sees as far as the ground goes
    /// between them and their neighbours, and as far as a place of the model lies in it.
    fn footprint(&self, surface: &Surface) -> Option<([f64; 4], f64)> {
        let view = self.view(surface);
        let to_ground = self.to_map.try_inverse()?;
        let side = RAYS + 1;
        let pixel = |k: usize| {
            let along = |axis: usize, n: usize| self.camera.size_px[axis] * n as f64 / RAYS as f64;
            [along(0, k % side), along(1, k / side)]
        };
        let hits: Vec<Option<Hit>> = (0..side * side).map(|k| self.hit(&view, &to_ground, pixel(k))).collect();
        let mut outline = Outline::EMPTY;
        hits.iter().flatten().for_each(|hit| outline.hold_hit(hit));
        let mut sizes: Vec<f64> = hits.iter().flatten().map(|hit| hit.across).collect();
        if !sizes.is_empty() {
            // Between the rays the outline may reach further.
            let b = outline.0;
            let more = [(b[2] - b[0]) / RAYS as f64, (b[3] - b[1]) / RAYS as f64];
            outline = Outline([b[0] - more[0], b[1] - more[1], b[2] + more[0], b[3] + more[1]]);
        }
        if hits.iter().any(Option::is_none) {
            let right = (0..hits.len()).filter(|k| k % side != RAYS).map(|k| (k, k + 1));
            let below = (0..hits.len() - side).map(|k| (k, k + side));
            for (a, b) in right.chain(below) {
                match (&hits[a], &hits[b]) {
                    (Some(_), None) => self.hold_border(&view, &to_ground, [pixel(a), pixel(b)], &mut outline),
                    (None, Some(_)) => self.hold_border(&view, &to_ground, [pixel(b), pixel(a)], &mut outline),
                    _ => {}
                }
            }
            let of_places = self.hold_places(&view, &mut outline);
            if sizes.is_empty() {
                sizes = of_places;
            }
        }
        Some((outline.0, upper_median(&mut sizes)?))
    }

    /// Where a pixel's ray meets the ground.
    fn hit(&self, view: &View<'_>, to_ground: &Matrix3<f64>, pixel: [f64; 2]) -> Option<Hit> {
        let ray = self.camera.ray(pixel).filter(|ray| self.camera.reaches(*ray, &self.reach))?;
        let d = self.pose.rotation.transpose() * Vector3::from(ray);
        let at = view.surface.meets(self.eye, (self.to_map * d).into(), self.sag)?;
        let distance = (to_ground * (Vector3::from(at) - Vector3::from(self.eye))).norm();
        let there = self.world.to_map(&(self.pose.centre + d * distance)).unwrap_or(at);
        Some(Hit { at: [at, there], across: self.across(distance, ray) })
    }

    /// Size of a pixel across the view along a unit ray, metres of the map.
    fn across(&self, distance: f64, ray: [f64; 3]) -> f64 {
        self.scale * distance * self.camera.across(ray) / self.camera.f_px()
    }

    /// Holds the last ground from a pixel that sees it to one that sees none.
    fn hold_border(
        &self,
        view: &View<'_>,
        to_ground: &Matrix3<f64>,
        [mut seen, mut unseen]: [[f64; 2]; 2],
        outline: &mut Outline,
    ) {
        for _ in 0..HALVINGS {
            let middle = [0, 1].map(|axis| (seen[axis] + unseen[axis]) / 2.0);
            match self.hit(view, to_ground, middle) {
                Some(hit) => {
                    outline.hold_hit(&hit);
                    seen = middle;
                }
                None => unseen = middle,
            }
        }
    }

    /// Holds the model's corners of cells that the frame shows, each with all up to its neighbours; of large models
    /// not every corner is looked for. The sizes of a pixel at those that lay outside.
    fn hold_places(&self, view: &View<'_>, outline: &mut Outline) -> Vec<f64> {
        let (heights, columns, corner, step) = view.surface.cells();
        let rows = heights.len() / columns;
        let thin = ((columns as f64 * rows as f64 / MOST_PLACES as f64).sqrt().ceil() as usize).max(1);
        let step = step.map(|s| s * thin as f64);
        let margin = step.map(f64::abs);
        let count = |n: usize| n.div_ceil(thin) + 1;
        let (across, down) = (count(columns), count(rows));
        let [x0, y0] = corner;
        let (width, height) = (across as u64 + 1, down as u64 + 1);
        let grid = Grid { x0, y0, step_x: step[0], step_y: step[1], width, height };
        let lattice = Lattice::reaching_out(self.world, &grid);
        let mut sizes = Vec::new();
        // Those on the border lie just within it: beyond there is no height.
        let along = |k: usize, n: usize| (k as f64).clamp(1e-3, n as f64 / thin as f64 - 1e-3);
        for j in 0..down {
            for i in 0..across {
                let (column, row) = (along(i, columns), along(j, rows));
                let [x, y] = [x0 + step[0] * column, y0 + step[1] * row];
                if outline.holds([x, y]) {
                    continue;
                }
                if let Place::Pixel(_) = view.at(x, y, |h| lattice.at(column, row, h)) {
                    outline.hold([x, y], margin);
                    if let Some(h) = view.surface.height(x, y) {
                        let to = self.pose.to_camera(&lattice.at(column, row, h));
                        sizes.push(self.across(to.norm(), to.normalize().into()));
                    }
                }
            }
        }
        sizes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_flight::{Projection, YawPitchRoll};

    const EYE: [f64; 3] = [0.0, 0.0, 1100.0];
    const GROUND: f32 = 100.0;

    /// The outline of a frame over level ground in a box, that of the cells' centres which it shows, and the size of a
    /// pixel.
    fn outlines(camera: &Camera, angles: [f64; 3], area: [f64; 4], cell: f64) -> ([f64; 4], [f64; 4], f64) {
        let [columns, rows] = [0, 1].map(|axis| ((area[axis + 2] - area[axis]) / cell).round() as usize);
        let heights = vec![GROUND; columns * rows];
        let surface = Surface::new(heights, columns, [area[0], area[3]], [cell, -cell]).expect("heights");
        let [yaw_deg, pitch_deg, roll_deg] = angles;
        let pose = Pose::looking(EYE.into(), YawPitchRoll { yaw_deg, pitch_deg, roll_deg });
        let world = World::flat([0.0; 3]);
        let mut shown = Outline::EMPTY;
        for k in 0..columns * rows {
            let at = [(k % columns) as f64 + 0.5, (k / columns) as f64 + 0.5];
            let [x, y] = [area[0] + cell * at[0], area[3] - cell * at[1]];
            let pixel = camera.project(pose.to_camera(&Vector3::new(x, y, f64::from(GROUND))).into());
            if pixel.is_some_and(|pixel| camera.contains(pixel)) {
                shown.hold([x, y], [0.0; 2]);
            }
        }
        let (found, across) = Seer::new(&world, camera, pose, EYE).footprint(&surface).expect("ground is seen");
        (found, shown.0, across)
    }

    /// Nothing is cut off, and the box is wider than what is shown by no more than `share` of it.
    fn assert_holds(found: [f64; 4], shown: [f64; 4], share: f64, what: &str) {
        let side = [0, 1].map(|axis| share * (shown[axis + 2] - shown[axis]));
        for k in 0..4 {
            let beyond = if k < 2 { shown[k] - found[k] } else { found[k] - shown[k] };
            assert!(beyond > -1e-6 && beyond <= side[k % 2], "{what}: {found:?} of {shown:?}");
        }
    }

    #[test]
    fn the_outline_holds_all_that_frame_and_model_have() {
        let low = Camera::pinhole("c", [500.0, 480.0], 520.0, [250.0, 240.0]);
        // The horizon lies in the frame, and the model ends between two rows of rays.
        for (pitch, far) in [(-20.0, 10_000.0), (-20.0, 16_000.0), (-20.0, 18_800.0), (-10.0, 30_000.0)] {
            let area = [-20_000.0, 0.0, 20_000.0, far];
            let (found, shown, _) = outlines(&low, [0.0, pitch, 0.0], area, 200.0);
            assert_holds(found, shown, 0.06, &format!("{pitch} {far}"));
        }
        let nadir = Camera::pinhole("c", [600.0, 450.0], 500.0, [307.0, 220.0]);
        let (found, shown, _) = outlines(&nadir, [20.0, -87.0, 0.0], [-83.0, -83.0, 143.0, 143.0], 2.0);
        assert_holds(found, shown, 0.06, "a model smaller than the frame");
    }

    #[test]
    fn a_model_between_the_rays_is_seen() {
        // Rays are 25 m apart, the model is 16 m wide.
        let camera = Camera::pinhole("c", [600.0, 450.0], 500.0, [307.0, 220.0]);
        let (found, shown, across) = outlines(&camera, [20.0, -87.0, 0.0], [3.0, 3.0, 19.0, 19.0], 1.0);
        assert_holds(found, shown, 0.1, "a small model");
        assert!((across - 2.0).abs() < 0.02, "{across}");
    }

    #[test]
    fn a_sphere_sees_all_around() {
        let sphere = Camera::pinhole("c", [720.0, 360.0], 360.0 / std::f64::consts::PI, [360.0, 180.0]);
        let sphere = Camera { projection: Projection::Equirectangular, ..sphere };
        let (found, shown, across) = outlines(&sphere, [30.0, 0.0, 0.0], [-3000.0, -3000.0, 3000.0, 3000.0], 100.0);
        assert_holds(found, shown, 0.05, "a sphere");
        assert!((8.7..40.0).contains(&across), "{across}");
    }
}
