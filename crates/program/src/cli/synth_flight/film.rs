//! The frames of a flight as scans of film: turned and shifted, with the fiducial marks of a camera in the picture.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, bail};
use autoref_film::drawn::{Exposed, FilmGround, FilmScene, FilmSpec, GreyPhoto, write_film};
use autoref_film::{Camera, load_camera};
use autoref_flight::render::FrameRenderer;
use autoref_synth::rng::Rng;

/// Most pixels of a frame, which is held.
const MOST_PX: f64 = 300e6;
/// Tiles of a scan.
const TILE_PX: u64 = 512;

/// A film camera and how finely its frames are scanned.
pub struct Film {
    camera: Camera,
    pixel_mm: f64,
}

impl Film {
    /// # Errors
    /// When there is no such camera, or its frames are too large.
    pub fn new(name: &str, pixel_um: f64) -> Result<Film> {
        let film = Film { camera: load_camera(name)?, pixel_mm: pixel_um / 1e3 };
        let [w, h] = film.size_px();
        if w * h > MOST_PX || w.min(h) < 64.0 {
            bail!("--film-um: frames of {w} x {h} pixels; they have at least 64 and together at most 300 million");
        }
        Ok(film)
    }

    /// Of the exposed picture.
    pub fn size_px(&self) -> [f64; 2] {
        self.image_mm().map(|mm| (mm / self.pixel_mm).round())
    }

    fn image_mm(&self) -> [f64; 2] {
        self.camera.image_size_mm.unwrap_or(self.camera.film_size_mm)
    }

    pub fn f_px(&self) -> Option<f64> {
        Some(self.camera.focal_length_mm? / self.pixel_mm)
    }

    /// Where the picture begins on the film, millimetres, y down.
    fn corner_mm(&self) -> [f64; 2] {
        let (centre, size) = (self.camera.film_centre(), self.size_px());
        [0, 1].map(|k| centre[k] - 0.5 * size[k] * self.pixel_mm)
    }

    /// What is added to a pixel of the picture for that of the frame that `fiducials --resample` makes with pixels of
    /// this size: it begins at the outermost marks.
    pub fn resampled_px(&self) -> [f64; 2] {
        let ((low, _), corner) = (self.camera.film_box(), self.corner_mm());
        [0, 1].map(|k| (corner[k] - low[k]) / self.pixel_mm)
    }

    /// Size of that frame.
    pub fn resampled_size_px(&self) -> [f64; 2] {
        let (low, high) = self.camera.film_box();
        [0, 1].map(|k| ((high[k] - low[k]) / self.pixel_mm).round())
    }

    /// What makes the frames of scans, as a command.
    pub fn command(&self, folder: &Path, name: &str) -> String {
        let (scans, out) = (folder.join("scans"), folder.join("frames"));
        let (scans, out) = (scans.display(), out.display());
        let (mm, um) = (self.pixel_mm, 1e3 * self.pixel_mm);
        // The scans are upright; marks that are all alike do not tell.
        let place = "--turn 0 --mirrored false";
        format!(
            "fiducials {scans}/*.tif --camera {name} --pixel-um {um} {place} --resample --resample-mm {mm} -o {out}"
        )
    }

    /// Renders a frame and writes the scan of it, with the truth of its marks beside it.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, frame: &FrameRenderer<'_>, path: &Path) -> Result<()> {
        let [width, height] = self.size_px().map(|v| v as usize);
        let photo = Arc::new(GreyPhoto { width, height, data: frame.rows(0, height) });
        let exposed = Exposed { photo, corner_mm: self.corner_mm(), pixel_mm: self.pixel_mm };
        let mut rng = Rng::new(frame.exposure.seed, 0xf11, 0);
        let spec = FilmSpec {
            // The renderer's lens has it.
            vignette: 0.0,
            rotation_deg: rng.range(-1.5, 1.5),
            offset_mm: [rng.range(-0.6, 0.6), rng.range(-0.6, 0.6)],
            margin_mm: 3.0,
            scratches: 6,
            dust: 60,
            ..FilmSpec::plain(&self.camera, 1e3 * self.pixel_mm, frame.exposure.seed)
        };
        Ok(write_film(&FilmScene::new(&spec, &FilmGround::Exposed(exposed))?, path, TILE_PX)?)
    }
}
