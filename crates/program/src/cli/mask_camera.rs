//! What no frame of a camera shows of the ground: its marks, text boxes and the film's border, as polygons joined to
//! masks.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use autoref_film::{Camera, FrameResult, load_camera};
use autoref_raster::ReaderChoice;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_terrain::shapes::{Meaning, Shape};

use super::film_resample::{Box4, parse_box};

#[derive(clap::Args, Debug)]
pub struct CameraArgs {
    /// Mask what every frame of this camera shows: marks, text boxes, border. A name of `fiducials --list-cameras` or a
    /// TOML file. Without --fiducials the frames must be resampled ones, cut to the marks' bounding box.
    #[arg(long, value_name = "NAME", help_heading = "By hand")]
    camera: Option<String>,
    /// Results of `fiducials` (NAME.fiducials.json, or a folder of them), which say where marks and border lie in each
    /// scan.
    #[arg(long, value_name = "RESULT.json", requires = "camera", help_heading = "By hand")]
    fiducials: Vec<PathBuf>,
    /// A text box in the camera's millimetres, two opposite corners; repeat for more. Instead of those known of the
    /// camera.
    #[arg(long, value_name = "X,Y,X,Y", value_parser = parse_box, allow_hyphen_values = true, requires = "camera", help_heading = "By hand")]
    mask_box: Vec<Box4>,
    /// Mask this much around every mark, millimetres.
    #[arg(long, value_name = "MM", default_value_t = 3.0, requires = "camera", help_heading = "By hand")]
    mask_marks_mm: f64,
}

/// What is masked in every frame of a camera.
pub struct CameraMask {
    camera: Camera,
    boxes: Vec<[f64; 4]>,
    marks_mm: f64,
    /// Of scans; `None`: the frames are resampled ones.
    results: Option<Vec<FrameResult>>,
}

impl CameraArgs {
    /// `None` without --camera.
    ///
    /// # Errors
    /// For an unknown camera and a result that cannot be read.
    pub fn prepare(&self) -> anyhow::Result<Option<CameraMask>> {
        let Some(name) = &self.camera else { return Ok(None) };
        if !(0.0..=50.0).contains(&self.mask_marks_mm) {
            bail!("--mask-marks-mm must be between 0 and 50");
        }
        let camera = load_camera(name)?;
        let given: Vec<[f64; 4]> = self.mask_box.iter().map(|b| b.0).collect();
        let boxes = if given.is_empty() { camera.boxes_off_ground_mm().to_vec() } else { given };
        let results = if self.fiducials.is_empty() { None } else { Some(self.results()?) };
        Ok(Some(CameraMask { camera, boxes, marks_mm: self.mask_marks_mm, results }))
    }

    fn results(&self) -> anyhow::Result<Vec<FrameResult>> {
        let mut results = Vec::new();
        for path in &self.fiducials {
            if !path.is_dir() {
                results.push(autoref_film::roll::read_frame(path)?);
                continue;
            }
            let failed = || format!("{}: cannot list the folder", path.display());
            let mut files = std::fs::read_dir(path)
                .with_context(failed)?
                .map(|entry| Ok(entry.with_context(failed)?.path()))
                .collect::<anyhow::Result<Vec<_>>>()?;
            files.retain(|file| file.to_string_lossy().ends_with(".fiducials.json"));
            files.sort();
            if files.is_empty() {
                bail!("{}: no NAME.fiducials.json in this folder; give the -o folder of `fiducials`", path.display());
            }
            for file in files {
                results.push(autoref_film::roll::read_frame(&file)?);
            }
        }
        Ok(results)
    }
}

impl CameraMask {
    /// Polygons of one frame.
    ///
    /// # Errors
    /// When the frame cannot be opened, has no result where results are given, no orientation, or another shape than
    /// the camera's resampled frames.
    pub fn of(&self, frame: &Path) -> Result<Vec<Shape>> {
        let Some(results) = &self.results else { return self.of_resampled(frame) };
        let named = |result: &&FrameResult| frame.file_stem().is_some_and(|stem| stem == result.name.as_str());
        let result = results.iter().find(named).ok_or_else(|| {
            Error::usage(
                format!("{}: no result of --fiducials is of this frame", frame.display()),
                "run `autoref-stream fiducials` on it",
            )
        })?;
        let interior = result.interior.as_ref().ok_or_else(|| {
            Error::usage(
                format!("{}: its result of --fiducials has no orientation", frame.display()),
                "mend its marks, or mask it without --camera",
            )
        })?;
        let source = autoref_raster::open(frame, ReaderChoice::Auto, 0, 16 << 20)?;
        let found = [source.info().width, source.info().height];
        if found != [result.width, result.height] {
            let what = format!(
                "{}: {} × {} px, but its result of --fiducials is of {} × {} px",
                frame.display(),
                found[0],
                found[1],
                result.width,
                result.height
            );
            return Err(Error::usage(what, "give the result of this scan"));
        }
        let sign = self.camera.y_sign();
        self.check_marks(frame, result, |[x, y]| interior.to_pixel([x, sign * y]))?;
        let size = found.map(|v| v as f64);
        Ok(self.polygons(frame, size, |[x, y]| interior.to_pixel([x, sign * y]).map(|PixelPoint { x, y }| [x, y])))
    }

    /// The result's marks lie where the camera's do.
    fn check_marks(
        &self,
        frame: &Path,
        result: &FrameResult,
        to_pixel: impl Fn([f64; 2]) -> Option<PixelPoint>,
    ) -> Result<()> {
        let expected: Vec<PixelPoint> = self.camera.film_points().iter().filter_map(|mm| to_pixel(*mm)).collect();
        // Marks of another camera lie farther from these than a fiftieth of the frame.
        let size_px = (result.width.max(result.height)) as f64;
        let beside = |centre: &PixelPoint| {
            let far = |mark: &PixelPoint| (mark.x - centre.x).hypot(mark.y - centre.y);
            expected.iter().map(far).fold(f64::INFINITY, f64::min) > size_px / 50.0
        };
        let centres: Vec<PixelPoint> = result.marks.iter().filter_map(|mark| mark.centre).collect();
        if centres.iter().filter(|centre| beside(centre)).count() * 2 > centres.len() {
            return Err(Error::usage(
                format!(
                    "{}: the marks of its result of --fiducials do not lie where those of {} do",
                    frame.display(),
                    self.camera.name
                ),
                "give --camera as `fiducials` had it",
            ));
        }
        Ok(())
    }

    fn of_resampled(&self, frame: &Path) -> Result<Vec<Shape>> {
        let source = autoref_raster::open(frame, ReaderChoice::Auto, 0, 16 << 20)?;
        let size = [source.info().width as f64, source.info().height as f64];
        let (low, high) = self.camera.film_box();
        let film = [high[0] - low[0], high[1] - low[1]];
        let ratio = (size[0] / size[1]) / (film[0] / film[1]);
        if !(0.97..=1.03).contains(&ratio) {
            let what = format!(
                "{}: {} × {} px is not the shape of the marks' bounding box, {:.1} × {:.1} mm",
                frame.display(),
                size[0],
                size[1],
                film[0],
                film[1]
            );
            return Err(Error::usage(what, "give --fiducials for scans, or frames that `fiducials --resample` wrote"));
        }
        let to_pixel = |[x, y]: [f64; 2]| [(x - low[0]) / film[0] * size[0], (y - low[1]) / film[1] * size[1]];
        Ok(self.polygons(frame, size, |mm| Some(to_pixel(mm))))
    }

    /// Polygons by a map from film millimetres, y down, to the frame's pixels.
    fn polygons(&self, frame: &Path, size: [f64; 2], to_pixel: impl Fn([f64; 2]) -> Option<[f64; 2]>) -> Vec<Shape> {
        let camera = &self.camera;
        let rectangle = |low: [f64; 2], high: [f64; 2]| -> Option<Vec<[f64; 2]>> {
            [low, [high[0], low[1]], high, [low[0], high[1]]].into_iter().map(&to_pixel).collect()
        };
        let shape = |class: &str, rings: Vec<Vec<[f64; 2]>>| Shape {
            class: format!("mask:{class}"),
            meaning: Meaning::Mask,
            frame: Some(frame.to_string_lossy().into_owned()),
            rings,
            place: format!("{class} of --camera {}", camera.name),
            file: None,
        };
        let r = self.marks_mm;
        let mut shapes: Vec<Shape> = camera
            .film_points()
            .iter()
            .filter_map(|&[x, y]| rectangle([x - r, y - r], [x + r, y + r]))
            .map(|ring| shape("mark", vec![ring]))
            .collect();
        let sign = camera.y_sign();
        shapes.extend(
            self.boxes
                .iter()
                .filter_map(|b| rectangle([b[0], sign * b[1]], [b[2], sign * b[3]]))
                .map(|ring| shape("text", vec![ring])),
        );
        let (low, high) = camera.film_box();
        let image = camera.image_size_mm.unwrap_or([high[0] - low[0], high[1] - low[1]]);
        let middle = camera.film_centre();
        let corner = |s: f64| [middle[0] + s * image[0] / 2.0, middle[1] + s * image[1] / 2.0];
        if let Some(ring) = rectangle(corner(-1.0), corner(1.0)) {
            let [w, h] = size;
            shapes.push(shape("border", vec![vec![[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]], ring]));
        }
        shapes
    }
}
