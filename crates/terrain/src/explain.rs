//! Images that explain a mask: class and entropy of every pixel before the cleaning, and how far the nearest sample is.

use autoref_raster::atomic::Transaction;
use autoref_raster::error::Result;
use autoref_raster::window::Window;

use crate::batch::Names;
use crate::classify::{Classifier, Cleaner, classify};
use crate::entropy::{RADIUS_PX, entropy};
use crate::plane::Plane;
use crate::reduce::Reduced;
use crate::write;

/// Stages `NAME_Class.tif` (probability of keep, 0…255; 0 and 255 where the method has none), `NAME_Entropy.tif` (⅟₃₂ bit
/// a step) and, for nearest neighbours, `NAME_Distance.tif` (distance to the nearest sample, ⅟₁₀₀ a step).
pub fn stage(
    transaction: &mut Transaction,
    names: &Names,
    reduced: &Reduced,
    classifier: &Classifier,
    memory_bytes: u64,
) -> Result<()> {
    let size = [reduced.width as usize, reduced.height as usize];
    let factor = reduced.factor;
    let raw = classify(reduced, classifier, &Cleaner::Areas(0.0), true, memory_bytes)?;
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

/// Grey levels and entropy of a row.
fn entropy_row(plane: &Plane, y: usize) -> Result<(Vec<u8>, Vec<f32>)> {
    let bounds = Window::whole(plane.width() as u64, plane.height() as u64);
    let read = Window::new(0, y as u64, plane.width() as u64, 1).grown(RADIUS_PX as u64, &bounds);
    let pixels = plane.read(&read)?;
    let row = y - read.y as usize;
    let bits = entropy(&pixels, plane.width(), read.height as usize, RADIUS_PX, row..row + 1);
    Ok((pixels[row * plane.width()..(row + 1) * plane.width()].to_vec(), bits))
}
