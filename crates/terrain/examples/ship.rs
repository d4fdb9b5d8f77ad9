//! Feature values of licensed photographs, as `src/shipped.bin` holds them: `ship FOLDER [SHIPPED.bin]`.
//!
//! `teaching/frames.csv` names the photographs, `teaching/NAME.geojson` holds their polygons. Rows of photographs that
//! lie in FOLDER are made anew, all others stay as they are, so that one can be added without the rest.

use std::path::Path;

use autoref_raster::ReaderChoice;
use autoref_raster::random::SplitMix64;
use autoref_raster::window::Window;
use autoref_terrain::bits::BitMask;
use autoref_terrain::features::FEATURES;
use autoref_terrain::model::{Labels, SHIPPED_ROW, examples};
use autoref_terrain::plane::Plane;
use autoref_terrain::reduce::{Reading, Reduced, reduce_frame};
use autoref_terrain::shapes;
use autoref_terrain::smooth::{gaussian, reduce};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Grain of the film, grey levels at the reduced scale. Chosen: a coarse film's grain is about 8 levels in a pixel of a
/// scan, a quarter of it when 4 × 4 pixels are averaged.
const GRAIN: f64 = 2.0;

/// Film has less contrast than the photograph: it becomes 30 + 0.7 g. Chosen.
const FILM: [f64; 2] = [30.0, 0.7];

/// Another grey image with the rest of the frame.
fn with_grey(pixels: &[u8], size: (usize, usize), valid: BitMask, of: &Reduced, factor: usize) -> Outcome<Reduced> {
    let mut grey = Plane::new(size.0, size.1, u64::MAX)?;
    grey.write(&Window::whole(size.0 as u64, size.1 as u64), pixels)?;
    Ok(Reduced { grey, valid, factor, width: of.width, height: of.height, white_steps: of.white_steps, smooth: true })
}

/// The frame as old film would show it: softer, flatter, with grain that is as large as the blur.
fn film(of: &Reduced) -> Outcome<Reduced> {
    let (w, h) = (of.grey.width(), of.grey.height());
    let soft = gaussian(&of.grey.read(&Window::whole(w as u64, h as u64))?, w, h);
    let mut draws = SplitMix64(1936);
    let noise: Vec<u8> = (0..w * h).map(|_| (128.0 + 32.0 * draws.normal()).clamp(0.0, 255.0) as u8).collect();
    let noise = gaussian(&noise, w, h);
    let mean = noise.iter().map(|&v| f64::from(v)).sum::<f64>() / noise.len() as f64;
    let spread = (noise.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / noise.len() as f64).sqrt();
    let shown = |(&v, &n): (&u8, &u8)| {
        let grain = (f64::from(n) - mean) / spread * GRAIN;
        (FILM[0] + FILM[1] * f64::from(v) + grain).round().clamp(1.0, 254.0) as u8
    };
    let pixels: Vec<u8> = soft.iter().zip(&noise).map(shown).collect();
    with_grey(&pixels, (w, h), of.valid.clone(), of, of.factor)
}

/// The frame from twice as far.
fn half(of: &Reduced) -> Outcome<Reduced> {
    let (w, h) = (of.grey.width(), of.grey.height());
    let pixels = reduce(&gaussian(&of.grey.read(&Window::whole(w as u64, h as u64))?, w, h), w, h, 2);
    let size = (w.div_ceil(2), h.div_ceil(2));
    let valid = BitMask::from_fn(size.0, size.1, |x, y| of.valid.get(2 * x, 2 * y));
    with_grey(&pixels, size, valid, of, 2 * of.factor)
}

/// Appends at most `most` pixels of each class.
fn append(rows: &mut Vec<u8>, frame: &Reduced, shapes: &[shapes::Shape], most: usize, number: u8) -> Outcome<()> {
    if most == 0 {
        return Ok(());
    }
    let mut labels = Labels::new(frame);
    for shape in shapes {
        labels.paint(shape, frame.factor);
    }
    for row in examples(frame, &labels, most, 1)? {
        rows.extend(row.features);
        rows.extend([u8::from(row.keep), number]);
    }
    Ok(())
}

fn main() -> Outcome<()> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().ok_or("ship FOLDER [SHIPPED.bin]")?);
    let shipped = arguments.get(1).map_or(here.join("src/shipped.bin"), |path| path.into());
    let before = std::fs::read(&shipped)?;
    let mut after = Vec::new();
    for line in std::fs::read_to_string(here.join("teaching/frames.csv"))?.lines().skip(1) {
        let [number, photograph, name, file, plain, halved, filmed, ..] = line.split(',').collect::<Vec<_>>()[..]
        else {
            return Err(format!("{line}: too few columns").into());
        };
        let number: u8 = number.parse()?;
        let path = folder.join(file);
        let first = after.len();
        if file.is_empty() || !path.is_file() {
            after.extend(before.chunks_exact(SHIPPED_ROW).filter(|row| row[FEATURES + 1] == number).flatten());
        } else {
            let source = autoref_raster::open(&path, ReaderChoice::Auto, 0, 64 << 20)?;
            let factor = match source.info().width.max(source.info().height) {
                0..1500 => 1,
                1500..3000 => 2,
                _ => 4,
            };
            let smooth = factor > 1;
            let reading = Reading { factor, smooth, tile_px: 0, memory_budget_bytes: 1 << 30, masks_beside: 0 };
            let frame = reduce_frame(&source, &reading)?;
            let shapes = shapes::read(&here.join("teaching").join(name).with_extension("geojson"))?;
            append(&mut after, &frame, &shapes, plain.parse()?, number)?;
            append(&mut after, &half(&frame)?, &shapes, halved.parse()?, number)?;
            append(&mut after, &film(&frame)?, &shapes, filmed.parse()?, number)?;
        }
        println!("{number} {photograph} {name}: {} rows", (after.len() - first) / SHIPPED_ROW);
    }
    Ok(std::fs::write(shipped, after)?)
}
