//! The contact sheet: every frame with its mask as a tint, shares and warnings, and a polygon and a brush to
//! mend a mask by hand.

use std::path::{Path, PathBuf};

use autoref_raster::atomic;
use autoref_raster::error::{Error, Result};
use autoref_raster::markup::escaped;
use autoref_raster::window::Window;

use crate::batch::Done;
use crate::bits::BitMask;
use crate::names::Names;
use crate::reduce::Reduced;
use crate::report::Report;
use crate::resume;
use crate::shapes::Shape;

/// Longer side of a picture, px.
const SIDE_PX: usize = 640;

/// Collects frames; [`Sheet::finish`] writes `masks.html`. The pictures are in the folder `previews`.
pub struct Sheet {
    folder: PathBuf,
    /// Stems of the frames with their figures.
    entries: Vec<(String, String)>,
    mended: Vec<Shape>,
}

impl Sheet {
    /// `mended` is what was mended by hand, which the page shows and saves again.
    pub fn new(folder: &Path, mended: &[Shape]) -> Sheet {
        Sheet { folder: folder.into(), entries: Vec::new(), mended: mended.to_vec() }
    }

    /// Adds a frame; its picture is written when it was made in this run.
    ///
    /// # Errors
    /// When the picture cannot be written.
    pub fn add(&mut self, done: &Done) -> Result<()> {
        let stem = done.report.frame.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some((reduced, mask)) = &done.picture {
            let path = Names::of(&done.report.frame, &self.folder).preview;
            let previews = path.parent().expect("it lies in the folder of pictures");
            std::fs::create_dir_all(previews).map_err(|e| Error::io(previews, "make the folder", e))?;
            atomic::write(&path, &picture(reduced, mask)?)?;
        }
        let entry = self.entry(&done.report);
        self.entries.push((stem, entry));
        Ok(())
    }

    /// Writes the page, with the frames of earlier runs whose masks are in the folder too.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self) -> Result<()> {
        let stems: Vec<String> = self.entries.iter().map(|(stem, _)| stem.clone()).collect();
        for report in resume::others(&self.folder, &stems) {
            let stem = report.frame.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let entry = self.entry(&report);
            self.entries.push((stem, entry));
        }
        self.entries.sort();
        let figures: String = self.entries.iter().map(|(_, figure)| figure.as_str()).collect();
        // No text of a shape may end the element that it stands in.
        let mended = features(&self.mended).to_string().replace('<', "\\u003c");
        let page = include_str!("sheet.html").replace("<!-- frames -->", &figures).replace("<!-- mended -->", &mended);
        atomic::write(&self.folder.join("masks.html"), page.as_bytes())
    }

    /// The figure of a frame, with the pictures that are there.
    fn entry(&self, report: &Report) -> String {
        let names = Names::of(&report.frame, &self.folder);
        let address = |path: &Path| {
            let inside = path.strip_prefix(&self.folder).expect("it lies in the folder");
            path.is_file().then(|| in_address(&inside.to_string_lossy()))
        };
        let scatter = report.outputs.iter().any(|name| name.ends_with("_Scatter.svg"));
        entry(report, address(&names.preview), address(&names.scatter).filter(|_| scatter))
    }
}

/// Shapes as the page saves them.
fn features(shapes: &[Shape]) -> serde_json::Value {
    let closed = |ring: &Vec<[f64; 2]>| ring.iter().chain(ring.first()).copied().collect::<Vec<_>>();
    let feature = |shape: &Shape| {
        serde_json::json!({
            "type": "Feature",
            "properties": {"class": shape.class, "frame": shape.frame},
            "geometry": {"type": "Polygon", "coordinates": shape.rings.iter().map(closed).collect::<Vec<_>>()},
        })
    };
    shapes.iter().map(feature).collect()
}

/// A relative path as pages name it.
fn in_address(path: &str) -> String {
    escaped(&path.replace('%', "%25").replace('#', "%23").replace('?', "%3F"))
}

fn entry(report: &Report, picture: Option<String>, scatter: Option<String>) -> String {
    let frame = escaped(&report.frame.file_name().unwrap_or_default().to_string_lossy());
    let warnings: String = report.warnings.iter().map(|w| format!("<li>{}</li>", escaped(w))).collect();
    let plot = scatter
        .map(|name| format!("<img loading=\"lazy\" src=\"{name}\" alt=\"Entropy against intensity by class\">"))
        .unwrap_or_default();
    format!(
        "<figure data-frame=\"{frame}\" data-width=\"{}\" data-height=\"{}\"><div><img loading=\"lazy\" src=\"{}\" alt=\"\"><svg viewBox=\"0 0 {} {}\"></svg></div><figcaption><b>{frame}</b> \
         {} · kept {:.1} % · masked {:.1} % · empty {:.1} % · unsure {:.1} %<ul>{warnings}</ul></figcaption>{plot}</figure>\n",
        report.width,
        report.height,
        picture.unwrap_or_default(),
        report.width,
        report.height,
        report.method.name(),
        100.0 * report.classes.keep,
        100.0 * report.classes.mask,
        100.0 * report.classes.empty,
        100.0 * report.unsure_share,
    )
}

/// The frame, with what is masked in red.
fn picture(reduced: &Reduced, mask: &BitMask) -> Result<Vec<u8>> {
    let (width, height) = (mask.width(), mask.height());
    let step = width.max(height).div_ceil(SIDE_PX).max(1);
    let (w, h) = (width.div_ceil(step), height.div_ceil(step));
    let mut pixels = Vec::with_capacity(3 * w * h);
    for y in (0..height).step_by(step) {
        let row = reduced.grey.read(&Window::new(0, y as u64, width as u64, 1))?;
        for x in (0..width).step_by(step) {
            let level = row[x];
            let dark = level / 2;
            pixels.extend(if mask.get(x, y) { [level; 3] } else { [dark + 127, dark, dark] });
        }
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, w as u32, h as u32);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().expect("a picture has pixels");
    writer.write_image_data(&pixels).expect("as many as its size says");
    writer.finish().expect("memory takes all");
    Ok(bytes)
}
