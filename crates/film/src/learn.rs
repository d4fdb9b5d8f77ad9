//! Templates from a roll: the marks of many frames, aligned and averaged.
//!
//! Where a camera's shape is drawn, the frames are examined with that first; where nobody knows the shape, the marks of
//! one frame are pointed at and cut out, found again in the other frames, and averaged. What differs from frame to
//! frame (the image behind the mark, scratches) gets little weight, so that what is left is the mark.

use std::path::{Path, PathBuf};

use super::frame::{FindOptions, Finder};
use super::interior::{Pose, fit_pose, refit};
use super::scan::open_scan;
use super::shown::Shown;

pub use super::shown::Pointed;
use super::stack::{Grid, Stack, cut};
use super::template::{LearnedTemplate, Model};
use super::types::{Camera, CameraMark, FrameResult, MarkKind, MarkStatus};
use autoref_raster::RasterSource;
use autoref_raster::atomic;
use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_raster::error::{Error, Result};
use autoref_raster::output_folder::OutputFolder;

/// Where the camera's marks are to be expected in an upright scan of so many pixels, in the camera's order; `turn_deg`
/// and `mirrored` of `options` turn them.
pub fn expected(camera: &Camera, size_px: [f64; 2], options: &FindOptions) -> Vec<PixelPoint> {
    let middle = PixelPoint { x: 0.5 * size_px[0], y: 0.5 * size_px[1] };
    let [w, h] = camera.film_size_mm;
    let by_film = size_px[0].max(size_px[1]) / w.max(h);
    let px_per_mm = options.pixel_um.map_or(by_film, |um| 1e3 / um);
    let mirrored = options.mirrored.unwrap_or(Handedness::AsIs);
    let pose = Pose::about(camera.film_centre(), middle, px_per_mm, options.turn_deg.unwrap_or(0.0), mirrored);
    camera.film_points().into_iter().map(|mm| pose.apply(mm)).collect()
}

/// Marks that correlate less are not averaged.
const LEAST_SCORE: f64 = 0.5;
/// One template per mark of the camera, in the camera's order; `None` where fewer than two frames show the mark (one,
/// when only one frame is given).
///
/// `window_mm` is width and height of what is cut out, about the reference point. With `pointed` (at least two marks,
/// in the first scan) marks that nobody pointed at are left out.
///
/// # Errors
/// Those of reading the scans; [`Error::Usage`] when nothing can be learned.
pub fn learn(
    scans: &[&dyn RasterSource],
    camera: &Camera,
    pointed: &[Pointed],
    window_mm: [f64; 2],
    options: &FindOptions,
) -> Result<Vec<Option<LearnedTemplate>>> {
    let visit = |k: usize, look: &mut dyn FnMut(&dyn RasterSource) -> Result<()>| look(scans[k]);
    learn_visiting(scans.len(), &visit, camera, pointed, window_mm, options)
}

/// Shows the scan of a number to somebody; it is open only that long.
type Visit<'a> = &'a dyn Fn(usize, &mut dyn FnMut(&dyn RasterSource) -> Result<()>) -> Result<()>;

fn learn_visiting(
    count: usize,
    visit: Visit,
    camera: &Camera,
    pointed: &[Pointed],
    window_mm: [f64; 2],
    options: &FindOptions,
) -> Result<Vec<Option<LearnedTemplate>>> {
    if count == 0 {
        return Err(Error::usage("no frames to learn from", "name the scans of a roll"));
    }
    let mut templates: Vec<Option<LearnedTemplate>> = vec![None; camera.marks.len()];
    let mut finder = Finder::new(&drawn_only(camera, pointed)?)?;
    let mut options = options.clone();
    let mut shown = None;
    if !pointed.is_empty() {
        visit(0, &mut |scan| {
            shown = Some(Shown::of(scan, camera, pointed, window_mm)?);
            Ok(())
        })?;
        let shown = shown.as_ref().expect("the first scan was visited");
        for (k, stack) in shown.stacks() {
            templates[k] = Some(stack.average(&shown.grid));
        }
        options.pixel_um.get_or_insert(1e3 / shown.pose.px_per_mm());
        options.mirrored.get_or_insert(shown.pose.mirrored);
        finder = with_templates(camera, &templates)?;
    }
    let options = &options;
    // Marks that are learned from more than the place where they were pointed at.
    let mut elsewhere = vec![false; camera.marks.len()];
    // The second round looks with the average of the first.
    for _ in 0..2 {
        let (mut stacks, grid) = stacked((count, visit), camera, &finder, shown.as_ref(), window_mm, options)?;
        if let Some(shown) = &shown {
            elsewhere = stacks.iter().map(Option::is_some).collect();
            for (k, window) in shown.guessed_windows() {
                stacks[k].get_or_insert(window);
            }
        }
        for (template, stack) in templates.iter_mut().zip(stacks) {
            let least = if shown.is_some() { 1 } else { count.min(2) };
            if let Some(stack) = stack.filter(|s| s.windows >= least) {
                *template = Some(stack.average(&grid));
            }
        }
        finder = with_templates(camera, &templates)?;
    }
    for (k, sigma) in shown.iter().flat_map(|s| s.sigmas(&elsewhere)) {
        if let Some(template) = &mut templates[k] {
            template.reference_sigma_um = sigma * template.pixel_um;
        }
    }
    Ok(templates)
}

/// The windows of every mark in all scans, and the grid that they lie on.
///
/// # Errors
/// Those of reading the scans; [`Error::Usage`] when no frame shows the marks.
fn stacked(
    (count, visit): (usize, Visit),
    camera: &Camera,
    finder: &Finder,
    shown: Option<&Shown>,
    window_mm: [f64; 2],
    options: &FindOptions,
) -> Result<(Vec<Option<Stack>>, Grid)> {
    let mut stacks: Vec<Option<Stack>> = vec![None; camera.marks.len()];
    let mut grid: Option<Grid> = None;
    // What somebody pointed at is a mark, whether or not it is found again.
    if let Some(shown) = shown {
        grid = Some(shown.grid);
        for (k, stack) in shown.stacks().into_iter().filter(|(k, _)| !shown.is_guessed(*k)) {
            stacks[k] = Some(stack);
        }
    }
    for number in usize::from(shown.is_some())..count {
        visit(number, &mut |scan| {
            let Some((frame, pose)) = examine(finder, scan, shown, options)? else {
                let path = &scan.info().path;
                tracing::warn!("{}: the marks were not found in it; not learned from", path.display());
                return Ok(());
            };
            let grid = *grid.get_or_insert_with(|| Grid::new(&pose, window_mm));
            add_windows(scan, camera, (&frame, &pose), shown, &grid, &mut stacks)
        })?;
    }
    let Some(grid) = grid else {
        return Err(Error::usage(
            "no frame shows marks that could be learned",
            "point at them in the first frame with --at MARK=X,Y, two or more",
        ));
    };
    Ok((stacks, grid))
}

/// Finds the marks in a further frame, first as it lay when they were pointed at: marks in a square, which may all look
/// alike, do not tell its quarters, and one scanner's frames lie alike. `None` when they are not found, or what is
/// found fits no film.
fn examine(
    finder: &Finder,
    scan: &dyn RasterSource,
    shown: Option<&Shown>,
    options: &FindOptions,
) -> Result<Option<(FrameResult, Pose)>> {
    let quarter = |shown: &Shown| (90.0 * (shown.pose.turn_deg() / 90.0).round()).rem_euclid(360.0);
    let alike = shown.filter(|_| options.turn_deg.is_none());
    let ways = alike.map(|s| FindOptions { turn_deg: Some(quarter(s)), ..options.clone() });
    for options in ways.iter().chain([options]) {
        let frame = finder.find(scan, options)?;
        let fits =
            |pose: &Pose| frame.interior.as_ref().is_some_and(|i| i.rmse_um <= finder.most_rmse_um(options, pose));
        if let Some(pose) = pose_of(&finder.camera, &frame).filter(fits) {
            return Ok(Some((frame, pose)));
        }
    }
    Ok(None)
}

/// Adds the windows of a frame's marks; of those whose place was guessed, only what agrees with the interior
/// orientation.
fn add_windows(
    scan: &dyn RasterSource,
    camera: &Camera,
    (frame, pose): (&FrameResult, &Pose),
    shown: Option<&Shown>,
    grid: &Grid,
    stacks: &mut [Option<Stack>],
) -> Result<()> {
    let guessed = |k: usize| shown.is_some_and(|s| s.is_guessed(k));
    let agrees = |k: usize| frame.interior.as_ref().is_some_and(|i| i.marks.contains(&camera.marks[k].name));
    for (k, at) in good_marks(camera, frame) {
        if guessed(k) && !agrees(k) {
            continue;
        }
        if let Some(w) = cut(scan, camera, pose, k, at, grid)? {
            match &mut stacks[k] {
                Some(stack) => stack.add(&w),
                empty => *empty = Some(Stack::of(&w)),
            }
        }
    }
    Ok(())
}

/// As [`learn`] from files, opened one at a time, writing `NAME-learned.toml` and a template per mark into `folder`.
/// Returns the camera's file and how many scans were learned from: those that cannot be read are left out with a
/// warning.
///
/// # Errors
/// Those of [`learn`] and of writing.
pub fn learn_files(
    scans: &[PathBuf],
    camera: &Camera,
    pointed: &[Pointed],
    window_mm: [f64; 2],
    options: &FindOptions,
    folder: &Path,
) -> Result<(PathBuf, usize)> {
    let mut readable = vec![];
    for (number, scan) in scans.iter().enumerate() {
        match open_scan(scan) {
            Ok(_) => readable.push(scan),
            // What was pointed at lies in the first.
            Err(error) if number == 0 && !pointed.is_empty() => return Err(error),
            Err(error) => tracing::warn!("left out: {error}"),
        }
    }
    let visit =
        |k: usize, look: &mut dyn FnMut(&dyn RasterSource) -> Result<()>| look(open_scan(readable[k])?.as_ref());
    let templates = learn_visiting(readable.len(), &visit, camera, pointed, window_mm, options)?;
    let (learned, files) = learned_camera(camera, &templates);
    if learned.marks.len() < 2 {
        return Err(Error::usage(
            "fewer than two marks could be learned",
            "give more frames, or point at the marks in the first one with --at MARK=X,Y",
        ));
    }
    let path = folder.join(format!("{}-learned.toml", file_name(&camera.name)));
    let text = toml::to_string(&learned).map_err(|e| Error::format(&path, "camera", e.to_string()))?;
    // What would be refused is not written.
    super::camera::parse(&text, &path)?;
    let _folder = OutputFolder::make(folder)?;
    for (file, template) in files {
        let json = serde_json::to_vec(template).expect("a template is plain data");
        atomic::write(&folder.join(file), &json)?;
    }
    atomic::write(&path, text.as_bytes())?;
    Ok((path, readable.len()))
}

/// The camera with the marks that have a template, and each template with the file that the camera names. What the
/// marks left out would tell is written: coordinates in the place of distances, the turns, and the film's middle.
fn learned_camera<'a>(
    camera: &Camera,
    templates: &'a [Option<LearnedTemplate>],
) -> (Camera, Vec<(String, &'a LearnedTemplate)>) {
    let mut learned = Camera { name: format!("{}-learned", camera.name), distances_mm: vec![], ..camera.clone() };
    learned.marks.clear();
    if templates.iter().any(Option::is_none) {
        learned.centre_mm = Some(stated_centre(camera));
    }
    let mut files: Vec<(String, &LearnedTemplate)> = vec![];
    for ((mark, turn_deg), template) in camera.marks.iter().zip(camera.turns_deg()).zip(templates) {
        let Some(template) = template else { continue };
        let safe: String = mark.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        let stem = format!("{}-{safe}", file_name(&camera.name));
        // Marks "-X" and "+X" have one safe name, "a" and "A" one file on some systems.
        let free = |file: &String| files.iter().all(|(other, _)| !other.eq_ignore_ascii_case(file));
        let numbered = (2..).map(|n| format!("{stem}-{n}.template.json"));
        let file = std::iter::once(format!("{stem}.template.json")).chain(numbered).find(free);
        let file = file.expect("numbers do not end");
        learned.marks.push(CameraMark {
            near_mm: None,
            kind: MarkKind::Learned { template: PathBuf::from(&file) },
            turn_deg: Some(turn_deg),
            ..mark.clone()
        });
        files.push((file, template));
    }
    (learned, files)
}

/// The film's middle in the camera's own axes.
fn stated_centre(camera: &Camera) -> [f64; 2] {
    let [x, y] = camera.film_centre();
    [x, camera.y_sign() * y]
}

/// A camera's name as that of a file in the folder.
fn file_name(camera: &str) -> String {
    let unsafe_in_names = |c: char| c.is_control() || r#"/\:*?"<>|"#.contains(c);
    camera.trim_start_matches('.').chars().map(|c| if unsafe_in_names(c) { '_' } else { c }).collect()
}

/// With pointed marks the camera's own shapes are not wanted, and may not exist.
fn drawn_only(camera: &Camera, pointed: &[Pointed]) -> Result<Camera> {
    let mut camera = camera.clone();
    if !pointed.is_empty() {
        for mark in &mut camera.marks {
            mark.kind = MarkKind::Dot { diameter_mm: 0.3, ring_diameter_mm: None, ring_line_mm: None };
        }
    }
    Ok(camera)
}

fn with_templates(camera: &Camera, templates: &[Option<LearnedTemplate>]) -> Result<Finder> {
    let mut kept = camera.clone();
    let mut models = vec![];
    kept.marks = camera
        .marks
        .iter()
        .zip(templates)
        .filter_map(|(mark, t)| {
            models.push(Model::Learned(t.clone()?));
            Some(mark.clone())
        })
        .collect();
    // Turns and the film's middle follow from the whole camera, not from what is left of it.
    kept.centre_mm = Some(stated_centre(camera));
    let turns = camera.turns_deg();
    for mark in &mut kept.marks {
        let k = camera.marks.iter().position(|m| m.name == mark.name).expect("taken from there");
        mark.turn_deg = Some(turns[k]);
    }
    Ok(Finder::with_models(&kept, models))
}

fn pose_of(camera: &Camera, frame: &FrameResult) -> Option<Pose> {
    let film = camera.film_points();
    let interior = frame.interior.as_ref()?;
    let points: Vec<_> = camera
        .marks
        .iter()
        .enumerate()
        .filter(|(_, m)| interior.marks.contains(&m.name))
        .filter_map(|(k, m)| Some((film[k], frame.marks.iter().find(|f| f.mark == m.name)?.centre?)))
        .collect();
    let plain = fit_pose(&points, interior.mirrored)?;
    refit(&points, &plain)
}

fn good_marks(camera: &Camera, frame: &FrameResult) -> Vec<(usize, PixelPoint)> {
    frame
        .marks
        .iter()
        .filter(|m| m.status != MarkStatus::Missing && m.score.is_some_and(|s| s >= LEAST_SCORE))
        .filter_map(|m| Some((camera.marks.iter().position(|c| c.name == m.mark)?, m.centre?)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{load_camera, parse};

    fn template() -> LearnedTemplate {
        LearnedTemplate {
            pixel_um: 50.0,
            width: 8,
            height: 8,
            reference: [4.0, 4.0],
            values: vec![0.5; 64],
            weights: vec![1.0; 64],
            marks: 1,
            reference_sigma_um: 1.0,
        }
    }

    #[test]
    fn a_learned_camera_is_read_again_and_keeps_the_turns_of_marks_beside_those_left_out() {
        let mut camera = load_camera("wild-15-4").expect("built in");
        let name = |k: usize| camera.marks[k].name.clone();
        camera.distances_mm = vec![([name(0), name(1)], 1.0), ([name(0), name(2)], 2.0)];
        let turns = camera.turns_deg();
        for left_out in 0..camera.marks.len() {
            let mut templates = vec![Some(template()); camera.marks.len()];
            templates[left_out] = None;
            let (learned, _) = learned_camera(&camera, &templates);
            let text = toml::to_string(&learned).expect("plain data");
            let read = parse(&text, Path::new("x.toml")).expect("sound");
            assert_eq!(read.film_centre(), camera.film_centre(), "without {}", camera.marks[left_out].name);
            for (mark, turn_deg) in read.marks.iter().zip(read.turns_deg()) {
                let k = camera.marks.iter().position(|m| m.name == mark.name).expect("taken from there");
                assert_eq!(turn_deg, turns[k], "{} without {}", mark.name, camera.marks[left_out].name);
            }
        }
    }

    #[test]
    fn every_template_has_a_file_of_its_own_in_the_folder() {
        let mut camera = load_camera("wild-15-4").expect("built in");
        camera.name = "../RC5/RC8".into();
        for (mark, name) in camera.marks.iter_mut().zip(["-X", "+X", "a", "A", "_X", "x/y", "x y", "ü"]) {
            mark.name = name.into();
        }
        let templates = vec![Some(template()); camera.marks.len()];
        let (learned, files) = learned_camera(&camera, &templates);
        let mut names: Vec<String> = files.iter().map(|(file, _)| file.to_lowercase()).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), camera.marks.len(), "{files:?}");
        assert!(names.iter().all(|n| n.starts_with("_rc5_rc8-") && !n.contains(['/', '\\'])), "{names:?}");
        assert_eq!(learned.name, "../RC5/RC8-learned");
        assert_eq!(file_name("wild-15-4"), "wild-15-4");
    }
}
