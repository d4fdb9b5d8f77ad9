//! The contact sheet: one HTML page with every mark of a roll, plain and equalised, worst frames first, reviewed by
//! keyboard. Frames are written one at a time.

use std::io::Write;
use std::path::Path;

use serde_json::{Value, json};

use super::types::{Camera, FrameResult, FrameStatus, MarkFind};
use super::window::{around, open_scan, read_grey};
use crate::coords::PixelPoint;
use crate::error::{Error, Result};
use crate::georef::atomic;
use crate::raster::RasterSource;

const SIDE: usize = 128;

/// Writes the page. A scan that cannot be read has no chips.
///
/// # Errors
/// When the page cannot be written.
pub fn write_sheet(path: &Path, camera: &Camera, frames: &[FrameResult]) -> Result<()> {
    atomic::with_temporary(path, |part| {
        let file = std::fs::File::create(part).map_err(|e| Error::io(path, "create", e))?;
        let mut out = std::io::BufWriter::new(file);
        let mut write = || -> std::io::Result<()> {
            out.write_all(include_bytes!("contact_sheet.html"))?;
            let places: serde_json::Map<_, _> =
                camera.marks.iter().map(|m| (m.name.clone(), json!([m.x_mm, m.y_mm]))).collect();
            writeln!(out, "<script>C({},\"fiducials.csv\")</script>", safe(&Value::Object(places)))?;
            for frame in frames {
                writeln!(out, "<script>F({})</script>", safe(&entry(camera, frame)))?;
            }
            writeln!(out, "<script>start()</script></html>")?;
            out.flush()
        };
        write().map_err(|e| Error::io(path, "write", e))
    })
}

/// JSON that cannot end the script it stands in.
fn safe(value: &Value) -> String {
    value.to_string().replace('<', "\\u003c")
}

fn entry(camera: &Camera, frame: &FrameResult) -> Value {
    let source = open_scan(&frame.path).ok();
    let (status, reasons) = match &frame.status {
        FrameStatus::Ok => ("ok", &[][..]),
        FrameStatus::Doubtful { reasons } => ("doubtful", &reasons[..]),
        FrameStatus::Failed { reasons } => ("failed", &reasons[..]),
    };
    let marks: Vec<Value> = frame.marks.iter().map(|m| mark(source.as_deref(), m)).collect();
    let mirrored = frame.inner.as_ref().is_some_and(|i| i.mirrored);
    json!({"name": frame.name, "status": status, "reasons": reasons, "marks": marks,
        "model": frame.inner.as_ref().map(|i| i.model), "flip": mirrored != (camera.y_sign() < 0.0),
        "worst": frame.inner.as_ref().map_or(0.0, |i| i.rmse_um)})
}

fn mark(source: Option<&dyn RasterSource>, m: &MarkFind) -> Value {
    let at = m.centre.or(m.predicted);
    let chips = at.zip(source).and_then(|(at, source)| chips(source, at));
    let (left, top, plain, equal) = chips.unwrap_or_default();
    json!({"mark": m.mark, "status": m.status, "x": m.centre.map(|c| c.x), "y": m.centre.map(|c| c.y), "left": left,
        "top": top, "plain": plain, "equal": equal})
}

fn chips(source: &dyn RasterSource, at: PixelPoint) -> Option<(f64, f64, String, String)> {
    let half = SIDE as f64 / 2.0;
    let (left, top) = ((at.x - half).floor(), (at.y - half).floor());
    let window = around(PixelPoint { x: left + half, y: top + half }, half, half, &source.info().bounds())?;
    let grey = read_grey(source, window, 1).ok()?;
    let mut ranks: Vec<f32> = grey.data.clone();
    ranks.sort_by(f32::total_cmp);
    let (mut plain, mut equal) = (vec![0u8; SIDE * SIDE], vec![0u8; SIDE * SIDE]);
    for (i, v) in grey.data.iter().enumerate() {
        let x = (grey.origin[0] as f64 - left) as usize + i % grey.width;
        let y = (grey.origin[1] as f64 - top) as usize + i / grey.width;
        plain[y * SIDE + x] = (v * 255.0) as u8;
        equal[y * SIDE + x] = (255 * ranks.partition_point(|r| r < v) / ranks.len()) as u8;
    }
    Some((left, top, jpeg(&plain)?, jpeg(&equal)?))
}

fn jpeg(grey: &[u8]) -> Option<String> {
    let mut bytes = vec![];
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, 80);
    encoder.encode(grey, SIDE as u16, SIDE as u16, jpeg_encoder::ColorType::Luma).ok()?;
    Some(base64(&bytes))
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let all = group.iter().fold(0u32, |all, b| all << 8 | u32::from(*b)) << (8 * (3 - group.len()));
        for i in 0..4 {
            let digit = DIGITS[(all >> (18 - 6 * i) & 63) as usize];
            out.push(if i <= group.len() { char::from(digit) } else { '=' });
        }
    }
    out
}
