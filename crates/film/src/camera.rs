//! Cameras as TOML files: those that come with the program, and the user's own.

mod distances;

use std::collections::HashSet;
use std::path::Path;

use super::types::{Camera, CameraMark, MarkKind, YAxis};
use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};

const BUILTIN: [(&str, &str); 7] = [
    ("svalbard-zeiss-1936", include_str!("cameras/svalbard-zeiss-1936.toml")),
    ("wild-15-4", include_str!("cameras/wild-15-4.toml")),
    ("rmk-cross", include_str!("cameras/rmk-cross.toml")),
    ("rmk-dot", include_str!("cameras/rmk-dot.toml")),
    ("corner-dot-ring", include_str!("cameras/corner-dot-ring.toml")),
    ("side-notch", include_str!("cameras/side-notch.toml")),
    ("arc-cross", include_str!("cameras/arc-cross.toml")),
];

/// Marks lie no nearer to each other, whatever their shape, millimetres.
const LEAST_APART_MM: f64 = 0.5;
/// Marks within less of the film's side are suspected of another unit.
const CLOSE_SHARE: f64 = 0.2;

/// The cameras that come with the program, in the order of `--list-cameras`.
///
/// # Panics
/// Never: a test reads every one of them.
pub fn builtin_cameras() -> Vec<Camera> {
    BUILTIN
        .iter()
        .map(|(name, text)| parse(text, Path::new(name)).expect("the built-in cameras are read by a test"))
        .collect()
}

/// A camera by its built-in name or from a TOML file.
///
/// # Errors
/// [`Error::Usage`] when neither a camera nor a file has this name; [`Error::Format`] when the file is no camera, with
/// the line or the mark at fault.
pub fn load_camera(name_or_file: &str) -> Result<Camera> {
    if let Some((name, text)) = BUILTIN.iter().find(|(name, _)| *name == name_or_file) {
        return parse(text, Path::new(name));
    }
    let path = Path::new(name_or_file);
    if !path.is_file() {
        return Err(Error::usage(
            format!("{name_or_file}: neither a camera of the program nor a file"),
            "see --list-cameras, or write a TOML file as docs/film.md shows",
        ));
    }
    let text = bounded::read_to_string(path, "a description of a camera", bounded::TEXT_BYTES)?;
    let mut camera = parse(&text, path)?;
    // Templates lie beside the camera's file.
    for mark in &mut camera.marks {
        if let MarkKind::Learned { template } = &mut mark.kind
            && let Some(folder) = path.parent()
        {
            *template = folder.join(&*template);
        }
    }
    Ok(camera)
}

/// Reads and checks a camera's TOML; `path` is for messages.
///
/// # Errors
/// [`Error::Format`] as for [`load_camera`].
pub fn parse(text: &str, path: &Path) -> Result<Camera> {
    let mut camera: Camera = toml::from_str(text).map_err(|e| {
        let line = e.span().map_or(0, |s| text[..s.start].matches('\n').count() + 1);
        let what = e.message().lines().collect::<Vec<_>>().join(" ");
        let is_shape = ["`kind`", "`template`"].iter().any(|field| what.contains(&format!("missing field {field}")));
        let remedy = if is_shape {
            "; where the shape is not known yet, write kind = { shape = \"dot\", diameter_mm = 1.0 } with the rough size, \
             and point at the mark with --learn --at"
        } else {
            ""
        };
        Error::format(path, format!("line {line}"), what + remedy)
    })?;
    check(&camera, path)?;
    distances::settle(&mut camera, path)?;
    check_places(&camera, path)?;
    Ok(camera)
}

fn check(camera: &Camera, path: &Path) -> Result<()> {
    let wrong = |place: String, what: &str| Err(Error::format(path, place, what));
    let positive = |v: f64| v.is_finite() && v > 0.0;
    if !camera.film_size_mm.iter().all(|v| positive(*v) && *v < 2000.0) {
        return wrong("film_size_mm".into(), "must be two lengths in millimetres, above 0 and below 2000");
    }
    if camera.image_size_mm.is_some_and(|s| !s.iter().all(|v| positive(*v) && *v < 2000.0)) {
        return wrong("image_size_mm".into(), "must be two lengths in millimetres, above 0 and below 2000");
    }
    if camera.centre_mm.is_some_and(|c| !c.iter().all(|v| v.is_finite() && v.abs() < 2000.0)) {
        return wrong("centre_mm".into(), "must be two millimetres, x and y of the film's middle");
    }
    if camera.focal_length_mm.is_some_and(|f| !positive(f)) {
        return wrong("focal_length_mm".into(), "must be above 0");
    }
    if !(2..=64).contains(&camera.marks.len()) {
        return wrong("marks".into(), "a camera has 2 to 64 marks");
    }
    for (boxes, place) in [(&camera.masked_mm, "masked_mm"), (&camera.text_boxes_mm, "text_boxes_mm")] {
        if !boxes.iter().flatten().all(|v| v.is_finite() && v.abs() < 2000.0) {
            return wrong(place.into(), "every box is four numbers in millimetres: x, y, x, y of two opposite corners");
        }
    }
    let mut names = HashSet::new();
    for mark in &camera.marks {
        let place = || format!("mark \"{}\"", mark.name);
        if mark.name.is_empty() || !names.insert(&mark.name) {
            return wrong(place(), "every mark needs a name of its own");
        }
        if mark.x_mm.is_some() != mark.y_mm.is_some() {
            return wrong(place(), "has one coordinate; give x_mm and y_mm, or neither and distances_mm");
        }
        if mark.x_mm.is_none() && mark.near_mm.is_none() {
            return wrong(place(), "has no position; give x_mm and y_mm, or near_mm and distances_mm");
        }
        let near = mark.near_mm.unwrap_or_default();
        if ![mark.x_mm, mark.y_mm].iter().flatten().chain(&near).all(|v| v.is_finite() && v.abs() < 2000.0) {
            return wrong(place(), "its position is not on any film");
        }
        if !super::shape::is_sound(&mark.kind) {
            return wrong(
                place(),
                "its lengths are not those of a mark: all must be above 0 and below 50 mm, and fit in each other",
            );
        }
    }
    for ([a, b], d) in &camera.distances_mm {
        if !(names.contains(a) && names.contains(b)) || a == b || !positive(*d) {
            return wrong(format!("distance {a} to {b}"), "must name two marks of the camera and be above 0");
        }
    }
    Ok(())
}

/// Marks that are known by now: not beyond the film, and none on another.
fn check_places(camera: &Camera, path: &Path) -> Result<()> {
    let wrong = |what: String| Err(Error::format(path, "marks", what));
    let points = camera.film_points();
    let (low, high) = camera.film_box();
    let apart = [0, 1].map(|k| high[k] - low[k]);
    for axis in [0, 1] {
        // Film of which a part was cut off may be stated as what is left.
        if apart[axis] > 1.2 * camera.film_size_mm[axis] {
            return wrong(format!(
                "lie {:.1} mm apart in {}, on a film of {} mm",
                apart[axis],
                ["x", "y"][axis],
                camera.film_size_mm[axis]
            ));
        }
    }
    if apart[0].hypot(apart[1]) < 1.0 {
        return wrong("all marks lie within a millimetre".into());
    }
    let longest = camera.film_size_mm[0].max(camera.film_size_mm[1]);
    let is_close = apart[0].max(apart[1]) < CLOSE_SHARE * longest;
    for (k, a) in camera.marks.iter().enumerate() {
        for (j, b) in camera.marks.iter().enumerate().skip(k + 1) {
            let mm = (points[k][0] - points[j][0]).hypot(points[k][1] - points[j][1]);
            let size_mm = [a, b].map(|m| super::shape::reach_mm(&m.kind).0);
            if mm < size_mm[0].max(size_mm[1]).max(LEAST_APART_MM) {
                let remedy = if is_close { "are the positions in millimetres?" } else { "correct a sign or a digit" };
                return wrong(format!(
                    "\"{}\" and \"{}\" lie {mm:.2} mm apart, nearer than marks are large: {remedy}",
                    a.name, b.name
                ));
            }
        }
    }
    if is_close {
        tracing::warn!(
            "{}: marks: they lie {:.1} mm apart at most, on a film of {longest} mm: are the positions in millimetres?",
            path.display(),
            apart[0].max(apart[1])
        );
    }
    Ok(())
}

impl Camera {
    /// Boxes that show no ground on any frame: those to be masked, else those of text. Two opposite corners x, y, x, y
    /// in millimetres, in the camera's axes.
    pub fn boxes_off_ground_mm(&self) -> &[[f64; 4]] {
        if self.masked_mm.is_empty() { &self.text_boxes_mm } else { &self.masked_mm }
    }

    /// Positions of the marks on the film, millimetres, x to the right and y **down**, whatever the camera's own axes.
    pub fn film_points(&self) -> Vec<[f64; 2]> {
        let sign = self.y_sign();
        self.marks.iter().map(|m| [m.x_mm.unwrap_or(0.0), sign * m.y_mm.unwrap_or(0.0)]).collect()
    }

    /// 1 where the camera's y runs down, −1 where it runs up.
    pub fn y_sign(&self) -> f64 {
        match self.y_axis {
            YAxis::Down => 1.0,
            YAxis::Up => -1.0,
        }
    }

    /// The marks' bounding box, millimetres, y down: upper left and lower right corner.
    pub fn film_box(&self) -> ([f64; 2], [f64; 2]) {
        let points = self.film_points();
        let end = |start: f64, pick: fn(f64, f64) -> f64| [0, 1].map(|k| points.iter().map(|p| p[k]).fold(start, pick));
        (end(f64::MAX, f64::min), end(f64::MIN, f64::max))
    }

    /// The middle of the film, by default of the marks' bounding box, millimetres, y down.
    pub fn film_centre(&self) -> [f64; 2] {
        if let Some([x, y]) = self.centre_mm {
            return [x, self.y_sign() * y];
        }
        let (low, high) = self.film_box();
        [0, 1].map(|k| 0.5 * (low[k] + high[k]))
    }

    /// Clockwise turn of each mark's shape on an upright frame, degrees.
    pub fn turns_deg(&self) -> Vec<f64> {
        let centre = self.film_centre();
        let turn = |mark: &CameraMark, p: &[f64; 2]| {
            mark.turn_deg.unwrap_or_else(|| {
                let (x, y) = (p[0] - centre[0], p[1] - centre[1]);
                match (x.abs() > y.abs(), x > 0.0, y > 0.0) {
                    (true, true, _) => 270.0,
                    (true, false, _) => 90.0,
                    (false, _, true) => 0.0,
                    (false, _, false) => 180.0,
                }
            })
        };
        self.marks.iter().zip(&self.film_points()).map(|(m, p)| turn(m, p)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cameras_of_the_program_are_sound_and_named_as_listed() {
        let cameras = builtin_cameras();
        assert!(cameras.iter().map(|c| c.name.as_str()).eq(BUILTIN.iter().map(|b| b.0)));
    }

    #[test]
    fn marks_at_one_place_are_refused_by_name() {
        let text = include_str!("cameras/rmk-cross.toml");
        let camera: Camera = toml::from_str(text).expect("built in");
        let (a, b) = (&camera.marks[0], &camera.marks[1]);
        let of = |m: &CameraMark| m.x_mm.zip(m.y_mm).expect("calibrated");
        for beside_mm in [0.0, 0.03, 0.4] {
            let mut wrong = camera.clone();
            (wrong.marks[1].x_mm, wrong.marks[1].y_mm) = (Some(of(a).0 + beside_mm), Some(of(a).1));
            let text = toml::to_string(&wrong).expect("plain data");
            let said = parse(&text, Path::new("x.toml")).expect_err("refused").to_string();
            assert!(said.starts_with("x.toml: marks: ") && said.contains(&a.name) && said.contains(&b.name), "{said}");
        }
    }

    #[test]
    fn what_is_no_camera_is_refused_in_one_line() {
        for text in ["", "name = 1", "name = \"x\"\nfilm_size_mm = [1.0, -1.0]\ny_axis = \"up\"\nmarks = []"] {
            let message = parse(text, Path::new("x.toml")).expect_err("refused").to_string();
            assert!(message.starts_with("x.toml: ") && !message.contains('\n'), "{message}");
        }
    }
}
