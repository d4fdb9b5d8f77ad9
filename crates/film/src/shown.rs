//! The marks that somebody points at in the first scan of a roll, made exact, and what they look like there.

use super::clicks::{Centre, Told, centres};
use super::interior::{Pose, distance, fit_pose, refit, rms_px};
use super::stack::{Grid, Stack, cut};
use super::types::Camera;
use autoref_raster::RasterSource;
use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_raster::error::{Error, Result};

/// A mark that somebody points at in the first frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Pointed {
    pub mark: String,
    pub at: PixelPoint,
}

fn pose_of_pointed(camera: &Camera, pointed: &[Pointed]) -> Result<(Pose, Vec<(usize, PixelPoint)>)> {
    let mut places: Vec<(usize, PixelPoint)> = vec![];
    for p in pointed {
        let Some(k) = camera.marks.iter().position(|m| m.name == p.mark) else {
            let names: Vec<&str> = camera.marks.iter().map(|m| m.name.as_str()).collect();
            return Err(Error::usage(
                format!("{}: the camera has no mark {}", camera.name, p.mark),
                format!("its marks are {}", names.join(", ")),
            ));
        };
        if places.iter().any(|q| q.0 == k) {
            return Err(Error::usage(format!("mark {} is pointed at twice", p.mark), "say one --at for every mark"));
        }
        places.push((k, p.at));
    }
    pose_of_places(camera, &places).map(|pose| (pose, places)).ok_or_else(|| {
        Error::usage(
            "one mark does not say how the frame lies",
            "point at two or more different marks of the first frame",
        )
    })
}

/// The pose through marks and their places, mirrored where three or more fit better so.
fn pose_of_places(camera: &Camera, places: &[(usize, PixelPoint)]) -> Option<Pose> {
    let film = camera.film_points();
    let points: Vec<_> = places.iter().map(|(k, at)| (film[*k], *at)).collect();
    let of =
        |mirrored| fit_pose(&points, mirrored).and_then(|plain| refit(&points, &plain)).filter(|_| points.len() >= 2);
    let ways: Vec<Pose> = if points.len() >= 3 {
        Handedness::BOTH.into_iter().filter_map(of).collect()
    } else {
        of(Handedness::AsIs).into_iter().collect()
    };
    ways.into_iter().min_by(|a, b| rms_px(a, &points).total_cmp(&rms_px(b, &points)))
}

/// What somebody pointed at in the first scan, made exact.
pub(super) struct Shown {
    pub pose: Pose,
    pub grid: Grid,
    windows: Vec<ShownMark>,
    /// Marks of which the scan shows too little to cut a window out; none without `common`.
    cut: Vec<usize>,
    /// What the marks that show the same have in common; `None` where fewer than [`SAME_MARKS`] do.
    common: Option<Stack>,
}

pub(super) struct ShownMark {
    /// Its place in the camera.
    pub k: usize,
    told: Told,
    /// What is about it.
    pub window: Vec<f32>,
}

/// So many marks of a frame that show the same tell what is the mark and what lies behind it.
const SAME_MARKS: usize = 3;

/// Places further than this from where the other marks put them, of the frame's size, were not meant.
const MISPOINTED: f64 = 0.05;

impl Shown {
    /// # Errors
    /// [`Error::Usage`] that names the mark, the place and what is wrong there; those of reading the scan.
    pub fn of(scan: &dyn RasterSource, camera: &Camera, pointed: &[Pointed], window_mm: [f64; 2]) -> Result<Shown> {
        let (mut pose, mut places) = pose_of_pointed(camera, pointed)?;
        let film = camera.film_points();
        let size_px = pose.px_per_mm() * camera.film_size_mm[0].max(camera.film_size_mm[1]);
        for (k, at) in &places {
            let off = distance(pose.apply(film[*k]), *at);
            if off > MISPOINTED * size_px {
                return Err(Error::usage(
                    format!(
                        "mark {} at {:.0},{:.0} lies {:.1} mm from where the other places and the camera's millimetres put it",
                        camera.marks[*k].name,
                        at.x,
                        at.y,
                        off / pose.px_per_mm()
                    ),
                    "compare the names and places of --at with the camera's x_mm and y_mm",
                ));
            }
        }
        let grid = Grid::new(&pose, window_mm);
        let first = windows_at(scan, camera, &pose, &places, &grid)?;
        // Clicks are a few pixels off; the marks themselves say by how much.
        let windows: Vec<&[f32]> = first.iter().map(|(_, w)| w.as_slice()).collect();
        let centres = centres(&windows, &grid);
        for ((k, _), told) in first.iter().zip(&centres) {
            let Some([dx, dy]) = told.centre.shift() else { continue };
            let linear = pose.shape_linear(camera.turns_deg()[*k]);
            let (u, v) = (dx * grid.step_mm, -dy * grid.step_mm);
            let (_, at) = places.iter_mut().find(|p| p.0 == *k).expect("windows are cut at places");
            *at = PixelPoint { x: at.x + linear[0] * u + linear[1] * v, y: at.y + linear[2] * u + linear[3] * v };
        }
        let whole: Vec<_> = places.iter().copied().filter(|(k, _)| first.iter().any(|w| w.0 == *k)).collect();
        pose = pose_of_places(camera, &whole).unwrap_or(pose);
        let told = |k: usize| first.iter().zip(&centres).find(|((of, _), _)| *of == k).map(|(_, told)| *told);
        let windows: Vec<ShownMark> = windows_at(scan, camera, &pose, &whole, &grid)?
            .into_iter()
            .filter_map(|(k, window)| Some(ShownMark { k, told: told(k)?, window }))
            .collect();
        let cut: Vec<_> = places.into_iter().filter(|(k, _)| windows.iter().all(|m| m.k != *k)).collect();
        let mut same = windows.iter().filter(|m| matches!(m.told.centre, Centre::Same(_))).map(|m| m.window.as_slice());
        let common = same.next().map(|first| {
            let mut stack = Stack::of(first);
            same.for_each(|w| stack.add(w));
            stack
        });
        let common = common.filter(|c| c.windows >= SAME_MARKS);
        if let Some((k, at)) = cut.first().filter(|_| common.is_none()) {
            let [width, height] = window_mm;
            let what = format!("a window of {width} x {height} mm about it leaves the scan");
            return Err(wrong(camera, *k, *at, &what, "say a smaller --window-mm, or leave this mark out"));
        }
        let shown = Shown { pose, grid, windows, cut: cut.into_iter().map(|(k, _)| k).collect(), common };
        shown.warn(camera);
        Ok(shown)
    }

    /// Says what the places leave open.
    fn warn(&self, camera: &Camera) {
        for mark in self.windows.iter().filter(|m| m.told.centre == Centre::AsPointed) {
            let what = if self.common.is_some() {
                "nothing there tells its centre: learned from other frames where these show what the other marks show, else exactly as it \
                 was pointed at"
            } else {
                "taken exactly where it was pointed at, since nothing there tells its centre"
            };
            tracing::warn!("mark {}: {what}", camera.marks[mark.k].name);
        }
        for k in &self.cut {
            let name = &camera.marks[*k].name;
            tracing::warn!("mark {name}: the scan's border cuts it off; taken to look like the others");
        }
        let unsure: Vec<&ShownMark> = self
            .windows
            .iter()
            .filter(|m| m.told.centre != Centre::AsPointed && m.told.sigma > super::judge::GOOD_REFERENCE_PX)
            .collect();
        if let Some(first) = unsure.first() {
            let names: Vec<&str> = unsure.iter().map(|m| camera.marks[m.k].name.as_str()).collect();
            tracing::warn!(
                "{}: their reference point is the mean of what was pointed at, good to {:.1} px, since neither a centre of \
                 symmetry nor a corner lies near it, and frames will be doubtful; point at them again, exactly",
                names.join(", "),
                first.told.sigma
            );
        }
    }

    /// What each mark looks like as far as this frame tells.
    pub fn stacks(&self) -> Vec<(usize, Stack)> {
        let of = |m: &ShownMark| match (&self.common, m.told.centre) {
            (Some(common), Centre::Same(_) | Centre::Faint(_) | Centre::AsPointed) => common.clone(),
            _ => Stack::of(&m.window),
        };
        let cut = self.cut.iter().filter_map(|k| Some((*k, self.common.clone()?)));
        self.windows.iter().map(|m| (m.k, of(m))).chain(cut).collect()
    }

    /// Marks taken to look like the others although this frame does not show it.
    fn guessed(&self) -> impl Iterator<Item = &ShownMark> {
        self.windows.iter().filter(|m| self.common.is_some() && m.told.centre == Centre::AsPointed)
    }

    /// What is about the marks that were taken to look like the others, where somebody pointed at them.
    pub fn guessed_windows(&self) -> impl Iterator<Item = (usize, Stack)> {
        self.guessed().map(|m| (m.k, Stack::of(&m.window)))
    }

    /// Whether the place of mark `k` rests on what the others look like.
    pub fn is_guessed(&self, k: usize) -> bool {
        self.cut.contains(&k) || self.guessed().any(|m| m.k == k)
    }

    /// How well the place of each mark is known, values of the grid; one that is not seen here but `elsewhere`, or that
    /// the border cuts off, lies as well as those that it looks like.
    pub fn sigmas(&self, elsewhere: &[bool]) -> Vec<(usize, f64)> {
        let same = self.windows.iter().find(|m| matches!(m.told.centre, Centre::Same(_))).map(|m| m.told.sigma);
        let of = |m: &ShownMark| same.filter(|_| elsewhere[m.k] && self.is_guessed(m.k)).unwrap_or(m.told.sigma);
        let cut = self.cut.iter().filter_map(|k| Some((*k, same?)));
        self.windows.iter().map(|m| (m.k, of(m))).chain(cut).collect()
    }
}

fn wrong(camera: &Camera, k: usize, at: PixelPoint, what: &str, remedy: &str) -> Error {
    Error::usage(format!("mark {} at {:.0},{:.0}: {what}", camera.marks[k].name, at.x, at.y), remedy)
}

/// Cuts every place out whose window lies in the scan.
fn windows_at(
    scan: &dyn RasterSource,
    camera: &Camera,
    pose: &Pose,
    places: &[(usize, PixelPoint)],
    grid: &Grid,
) -> Result<Vec<(usize, Vec<f32>)>> {
    let mut windows = vec![];
    for &(k, at) in places {
        let Some(window) = cut(scan, camera, pose, k, at, grid)? else { continue };
        let (low, high) = window.iter().fold((f32::MAX, f32::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
        if high - low < 0.2 {
            let remedy = "point at the mark itself, in pixels of the scan";
            return Err(wrong(camera, k, at, "nothing stands out there", remedy));
        }
        windows.push((k, window));
    }
    Ok(windows)
}
