//! Images that explain a mask: class and entropy of every pixel before the cleaning, and how far the nearest sample is.

use autoref_raster::atomic::Transaction;
use autoref_raster::error::Result;
use autoref_raster::window::Window;

use crate::bits::BitMask;
use crate::classify::{Classifier, Cleaner, classify};
use crate::entropy::{RADIUS_PX, entropy};
use crate::names::Names;
use crate::plane::Plane;
use crate::reduce::Reduced;
use crate::write;

/// Stages `NAME_Class.tif` (probability of keep, 0…255; 0 and 255 where the method has none), `NAME_Entropy.tif` (⅟₃₂
/// bit a step), `NAME_Scatter.svg` (entropy against intensity by class) and, for nearest neighbours,
/// `NAME_Distance.tif` (distance to the nearest sample, ⅟₁₀₀ a step).
///
/// # Errors
/// When a plane cannot be read, the classes do not fit into `memory_bytes`, or a file cannot be written.
pub fn stage(
    transaction: &mut Transaction,
    names: &Names,
    reduced: &Reduced,
    classifier: &Classifier,
    memory_bytes: u64,
) -> Result<()> {
    let size = [reduced.width as usize, reduced.height as usize];
    let factor = reduced.factor;
    let raw = classify(reduced, classifier, &Cleaner::Nothing, memory_bytes)?;
    transaction.stage(&names.class, |path| match &raw.probability {
        Some(plane) => write::grey_plane(path, size, factor, plane),
        None => write::grey(path, size, factor, |y| {
            Ok((0..raw.keep.width()).map(|x| if raw.keep.get(x, y) { 255 } else { 0 }).collect())
        }),
    })?;
    transaction.stage(&names.entropy, |path| {
        write::grey(path, size, factor, |y| {
            Ok(entropy_row(&reduced.grey, y)?.1.iter().map(|bit| (bit * 32.0 + 0.5) as u8).collect())
        })
    })?;
    let scatter = scatter(reduced, &raw.keep)?;
    transaction.stage_bytes(&names.scatter, scatter.as_bytes())?;
    if let Classifier::Neighbours(neighbours) = classifier {
        transaction.stage(&names.distance, |path| {
            write::grey(path, size, factor, |y| {
                let (levels, bits) = entropy_row(&reduced.grey, y)?;
                let far = |(bit, level): (&f32, &u8)| (neighbours.distance(*bit, *level) * 100.0).min(255.0) as u8;
                Ok(bits.iter().zip(&levels).map(far).collect())
            })
        })?;
    }
    Ok(())
}

/// Points of the scatter plot along a row and a column of the frame.
const POINTS: usize = 48;

/// Entropy against intensity of evenly spread pixels, by class before the cleaning.
fn scatter(reduced: &Reduced, keep: &BitMask) -> Result<String> {
    let (w, h) = (keep.width(), keep.height());
    let mut circles = [String::new(), String::new()];
    for j in 0..POINTS.min(h) {
        let y = (2 * j + 1) * h / (2 * POINTS.min(h));
        let (levels, bits) = entropy_row(&reduced.grey, y)?;
        for i in 0..POINTS.min(w) {
            let x = (2 * i + 1) * w / (2 * POINTS.min(w));
            if reduced.valid.get(x, y) {
                let (across, up) =
                    (50.0 + f64::from(levels[x]) / 255.0 * 400.0, 330.0 - f64::from(bits[x]) / 8.0 * 300.0);
                circles[usize::from(keep.get(x, y))]
                    .push_str(&format!("<circle cx=\"{across:.1}\" cy=\"{up:.1}\" r=\"2\"/>"));
            }
        }
    }
    let mut axes = String::new();
    for i in 0..=4 {
        let (x, y) = (50 + 100 * i, 330 - 75 * i);
        axes.push_str(&format!(
            "<path d=\"M{x} 330v5M50 {y}h-5\"/><text x=\"{x}\" y=\"350\" text-anchor=\"middle\">{}</text>\
             <text x=\"40\" y=\"{}\" text-anchor=\"end\">{}</text>",
            f64::from(i) / 4.0,
            y + 4,
            2 * i
        ));
    }
    let [masked, kept] = circles;
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 480 385\" font-family=\"sans-serif\" font-size=\"12\">\
         <rect width=\"480\" height=\"385\" fill=\"#fff\"/><g stroke=\"#222\" fill=\"none\"><path d=\"M50 30V330H450\"/></g>\
         <g fill=\"#222\" stroke-width=\"1\">{axes}<text x=\"250\" y=\"372\" text-anchor=\"middle\">intensity / 255</text>\
         <text transform=\"translate(15 180) rotate(-90)\" text-anchor=\"middle\">entropy, bit</text></g>\
         <g fill=\"#d22\" fill-opacity=\".5\">{masked}</g><g fill=\"#173\" fill-opacity=\".5\">{kept}</g>\
         <text x=\"60\" y=\"20\" fill=\"#173\">● keep</text><text x=\"130\" y=\"20\" fill=\"#d22\">● mask</text></svg>\n"
    ))
}

/// Grey levels and entropy of a row.
fn entropy_row(plane: &Plane, y: usize) -> Result<(Vec<u8>, Vec<f32>)> {
    let bounds = Window::whole(plane.width() as u64, plane.height() as u64);
    let read = Window::new(0, y as u64, plane.width() as u64, 1).grown(RADIUS_PX as u64, &bounds);
    let pixels = plane.read(&read)?;
    let row = y - read.y as usize;
    let bits = entropy(&pixels, plane.width(), read.height as usize, RADIUS_PX, row..row + 1);
    Ok((pixels[row * plane.width()..(row + 1) * plane.width()].to_vec(), bits))
}
