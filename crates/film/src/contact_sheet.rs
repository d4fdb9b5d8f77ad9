//! The contact sheet: one HTML page with every mark of a roll, plain and equalised, worst frames first, reviewed by
//! keyboard, and beside it a folder with one picture per frame, which the page asks for when the frame comes into view.
//! Frames are written one at a time.

use std::io::Write;
use std::path::Path;

use serde_json::{Value, json};

use super::scan::open_scan;
use super::types::{Camera, FrameResult, FrameStatus, InteriorModel, MarkFind};
use super::window::{around, read_grey};
use autoref_raster::RasterSource;
use autoref_raster::atomic;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};

/// Values along a side of a chip.
const SIDE: usize = 160;
/// What a chip shows of a mark that was not found, millimetres on the film.
const SEARCHED_MM: f64 = 16.0;

/// Writes the page to `path` and the pictures into a folder of its name without extension. A scan that cannot be read
/// has no chips. `model` is what a replay of the patch would solve.
///
/// # Errors
/// When the page or a picture cannot be written.
pub fn write_sheet(path: &Path, camera: &Camera, frames: &[FrameResult], model: InteriorModel) -> Result<()> {
    let folder = path.with_extension("");
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, "create", e))?;
    atomic::with_temporary(path, |part| {
        let file = std::fs::File::create(part).map_err(|e| Error::io(path, "create", e))?;
        let mut out = std::io::BufWriter::new(file);
        let failed = |e| Error::io(path, "write", e);
        let marks: serde_json::Map<_, _> =
            camera.marks.iter().map(|m| (m.name.clone(), json!([m.x_mm, m.y_mm]))).collect();
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let roll = json!({"marks": marks, "model": model, "side": SIDE, "folder": name, "source": "fiducials.csv"});
        write!(
            out,
            "{}<style>\n{}</style>\n{}<script>\n{}{}</script>\n<script>\nSheet.roll({});\n",
            include_str!("contact_sheet/page.html"),
            include_str!("contact_sheet/page.css"),
            include_str!("contact_sheet/body.html"),
            include_str!("contact_sheet/fit.js"),
            include_str!("contact_sheet/page.js"),
            safe(&roll)
        )
        .map_err(failed)?;
        for frame in frames {
            let entry = entry(camera, frame, &folder)?;
            writeln!(out, "Sheet.frame({});", safe(&entry)).map_err(failed)?;
        }
        writeln!(out, "Sheet.start();\n</script>\n</body>\n</html>").and_then(|()| out.flush()).map_err(failed)
    })
}

/// JSON that cannot end the script it stands in.
fn safe(value: &Value) -> String {
    value.to_string().replace('<', "\\u003c")
}

fn entry(camera: &Camera, frame: &FrameResult, folder: &Path) -> Result<Value> {
    let source = open_scan(&frame.path).ok();
    let (status, reasons) = match &frame.status {
        FrameStatus::Ok => ("ok", &[][..]),
        FrameStatus::Doubtful { reasons } => ("doubtful", &reasons[..]),
        FrameStatus::Failed { reasons } => ("failed", &reasons[..]),
    };
    let chips: Vec<Option<Chip>> = (0..frame.marks.len()).map(|k| chip(source.as_deref()?, camera, frame, k)).collect();
    let columns = chips.iter().flatten().count();
    if let Some(picture) = (columns > 0).then(|| sprite(&chips, columns)).flatten() {
        atomic::write(&folder.join(format!("{}.jpg", frame.name)), &picture)?;
    }
    let mut column = 0..;
    let marks: Vec<Value> = frame
        .marks
        .iter()
        .zip(&chips)
        .map(|(m, chip)| {
            let col = chip.as_ref().and_then(|_| column.next());
            let (left, top, step) = chip.as_ref().map_or((0.0, 0.0, 1), |c| (c.left, c.top, c.step));
            json!({"mark": m.mark, "status": m.status, "reason": m.reason, "x": m.centre.map(|c| c.x),
                "y": m.centre.map(|c| c.y), "left": left, "top": top, "step": step, "col": col})
        })
        .collect();
    let mirrored = frame.interior.as_ref().is_some_and(|i| i.mirrored.is_mirrored());
    Ok(json!({"name": frame.name, "status": status, "reasons": reasons, "marks": marks, "columns": columns,
        "flip": mirrored != (camera.y_sign() < 0.0), "worst": frame.interior.as_ref().map_or(0.0, |i| i.rmse_um)}))
}

/// A square window of the scan, plain and equalised.
struct Chip {
    /// Pixel of the scan at its outer upper left corner.
    left: f64,
    top: f64,
    /// Pixels of the scan along one value.
    step: u64,
    plain: Vec<u8>,
    equal: Vec<u8>,
}

/// Where to look for a mark that has no place: where the others put it, or where it would be on a frame in the middle
/// of the scan.
fn place(source: &dyn RasterSource, camera: &Camera, frame: &FrameResult, k: usize) -> (PixelPoint, bool) {
    let mark: &MarkFind = &frame.marks[k];
    if let Some(centre) = mark.centre {
        return (centre, true);
    }
    if let Some(predicted) = mark.predicted {
        return (predicted, true);
    }
    let info = source.info();
    let (film, middle) = (camera.film_points()[k], camera.film_centre());
    let unit = info.width as f64 / camera.film_size_mm[0];
    let at = |k: usize, size: u64| 0.5 * size as f64 + unit * (film[k] - middle[k]);
    (PixelPoint { x: at(0, info.width), y: at(1, info.height) }, false)
}

fn chip(source: &dyn RasterSource, camera: &Camera, frame: &FrameResult, k: usize) -> Option<Chip> {
    if k >= camera.marks.len() {
        return None;
    }
    let (at, known) = place(source, camera, frame, k);
    let bounds = source.info().bounds();
    let searched = SEARCHED_MM * bounds.width as f64 / camera.film_size_mm[0] / SIDE as f64;
    let step = if known { 1 } else { searched.ceil().clamp(1.0, 64.0) as u64 };
    let half = (SIDE as u64 * step) as f64 / 2.0;
    let (left, top) = ((at.x - half).floor(), (at.y - half).floor());
    let window = around(PixelPoint { x: left + half, y: top + half }, half, half, &bounds)?;
    let grey = read_grey(source, window, step).ok()?;
    if grey.data.is_empty() {
        return None;
    }
    let mut ranks: Vec<f32> = grey.data.clone();
    ranks.sort_by(f32::total_cmp);
    let (mut plain, mut equal) = (vec![0u8; SIDE * SIDE], vec![0u8; SIDE * SIDE]);
    // Values of a window that the scan's edge cuts begin within the chip.
    let offset = |from: i64, edge: f64| ((from as f64 - edge) / step as f64).round() as usize;
    let (x0, y0) = (offset(grey.origin[0], left), offset(grey.origin[1], top));
    for (i, v) in grey.data.iter().enumerate() {
        let (x, y) = (x0 + i % grey.width, y0 + i / grey.width);
        if x < SIDE && y < SIDE {
            plain[y * SIDE + x] = (v * 255.0) as u8;
            equal[y * SIDE + x] = (255 * ranks.partition_point(|r| r < v) / ranks.len()) as u8;
        }
    }
    Some(Chip { left, top, step, plain, equal })
}

/// One picture of all chips side by side, plain above, equalised below, as JPEG.
fn sprite(chips: &[Option<Chip>], columns: usize) -> Option<Vec<u8>> {
    let width = columns * SIDE;
    let mut grey = vec![0u8; width * 2 * SIDE];
    for (column, chip) in chips.iter().flatten().enumerate() {
        for (row, part) in [&chip.plain, &chip.equal].into_iter().enumerate() {
            for (y, line) in part.chunks(SIDE).enumerate() {
                grey[(row * SIDE + y) * width + column * SIDE..][..SIDE].copy_from_slice(line);
            }
        }
    }
    let mut bytes = vec![];
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, 85);
    encoder.encode(&grey, width as u16, 2 * SIDE as u16, jpeg_encoder::ColorType::Luma).ok()?;
    Some(bytes)
}
