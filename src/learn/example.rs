//! What one mark shows: its paint, the ground beside it, its size and outline.

use nalgebra::Vector3;

use crate::candidate::pixel_set::PixelSet;
use crate::candidate::scene::sample_ground;
use autoref_raster::Patch;
use autoref_raster::coords::PixelPoint;
use autoref_raster::ranks::median;

/// How far around a mark the ground is taken for its own.
pub(super) const RING_PX: usize = 12;
/// Fewest pixels that say what the ground looks like.
const LEAST_GROUND_PX: usize = 30;

/// What one example shows.
pub(super) struct Example {
    /// sRGB 0..=1 of the mark's pixels.
    pub paint: Vec<[f64; 3]>,
    pub ground: Vec<[f64; 3]>,
    pub side_px: f64,
    pub eccentricity: f64,
    pub tightness: f64,
    pub own: PixelSet,
}

/// The mark at a position that somebody points at.
pub(super) fn example(patch: &Patch, at: PixelPoint) -> std::result::Result<Example, &'static str> {
    let (width, height) = (patch.window.width as usize, patch.window.height as usize);
    let (x, y) = (at.x - patch.window.x as f64, at.y - patch.window.y as f64);
    if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64) {
        return Err("lies outside the image");
    }
    let (x, y) = (x as usize, y as usize);
    let white = f64::from(patch.white);
    let unit = |i: usize| patch.rgb[i].map(|v| (f64::from(v) / white).min(1.0));
    let colour = |i: usize| Vector3::from(unit(i).map(|v| v * 255.0));
    let seed: Vec<usize> = (y.saturating_sub(1)..(y + 2).min(height))
        .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| v * width + u))
        .filter(|&i| patch.valid[i])
        .collect();
    if !patch.valid[y * width + x] {
        return Err("lies where the image holds nothing");
    }
    let seed_colour =
        Vector3::from(std::array::from_fn::<f64, 3, _>(|c| median(seed.iter().map(|&i| colour(i)[c]).collect())));
    // Ground: first the outer part of the patch, then again around what was found.
    let reach = |i: usize| (i % width).abs_diff(x).max((i / width).abs_diff(y));
    let far = width.max(height) / 4;
    let mut back: Vec<usize> = (0..width * height).filter(|&i| patch.valid[i] && reach(i) >= far).collect();
    let mut own = PixelSet::empty(width, height);
    for _ in 0..2 {
        let colours: Vec<[u16; 3]> = back.iter().map(|&i| patch.rgb[i].map(|v| v.min(patch.white))).collect();
        let g = sample_ground(&colours, patch.white).ok_or("has too little ground around it")?;
        let inverse = (g.covariance + nalgebra::Matrix3::identity() * 9.0).cholesky().ok_or("has no ground")?.inverse();
        let step = seed_colour - g.mean;
        let direction = inverse * step;
        let contrast2 = direction.dot(&step);
        if contrast2 < 9.0 {
            return Err("does not stand out from its surroundings");
        }
        let is_paint = |i: usize| patch.valid[i] && direction.dot(&(colour(i) - g.mean)) > 0.5 * contrast2;
        let paint = PixelSet::from_fn(width, height, is_paint);
        if !paint.has(y * width + x) {
            return Err("does not stand out from its surroundings");
        }
        own = paint.piece(y * width + x);
        let ring = own.grown(RING_PX).minus(&own.grown(2)).minus(&paint);
        back = ring.iter().filter(|&i| patch.valid[i]).collect();
    }
    let inside: Vec<usize> = own.iter().collect();
    if inside.iter().any(|&i| i % width == 0 || i % width + 1 == width || i / width == 0 || i / width + 1 == height)
        && inside.len() * 2 > width * height
    {
        return Err("does not end inside its window");
    }
    Ok(described(patch, own, &back))
}

/// The mark that somebody outlined: exactly these pixels. `outlined` holds those of all marks in the patch.
pub(super) fn outlined(
    patch: &Patch,
    own: &PixelSet,
    outlined: &PixelSet,
) -> std::result::Result<Example, &'static str> {
    let (width, height) = (patch.window.width as usize, patch.window.height as usize);
    let own = PixelSet::from_fn(width, height, |i| own.has(i) && patch.valid[i]);
    if own.is_empty() {
        return Err("holds no pixel of the image");
    }
    let ring = own.grown(RING_PX).minus(&outlined.grown(2));
    let back: Vec<usize> = ring.iter().filter(|&i| patch.valid[i]).collect();
    if back.len() < LEAST_GROUND_PX {
        return Err("has too little ground around it");
    }
    Ok(described(patch, own, &back))
}

fn described(patch: &Patch, own: PixelSet, back: &[usize]) -> Example {
    let white = f64::from(patch.white);
    let unit = |i: &usize| patch.rgb[*i].map(|v| (f64::from(v) / white).min(1.0));
    let inside: Vec<usize> = own.iter().collect();
    let (eccentricity, tightness) = outline(&inside, patch.window.width as usize);
    Example {
        paint: inside.iter().map(unit).collect(),
        ground: back.iter().map(unit).collect(),
        side_px: (inside.len() as f64).sqrt(),
        eccentricity,
        tightness,
        own,
    }
}

/// Eccentricity and tightness of a set of pixels.
fn outline(inside: &[usize], width: usize) -> (f64, f64) {
    let n = inside.len() as f64;
    let points: Vec<(f64, f64)> = inside.iter().map(|i| ((i % width) as f64, (i / width) as f64)).collect();
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let moment = |f: &dyn Fn(f64, f64) -> f64| points.iter().map(|p| f(p.0 - mx, p.1 - my)).sum::<f64>() / n;
    let (xx, xy, yy) = (moment(&|x, _| x * x) + 1.0 / 12.0, moment(&|x, y| x * y), moment(&|_, y| y * y) + 1.0 / 12.0);
    let gap = (((xx - yy) / 2.0).powi(2) + xy * xy).sqrt();
    let ratio = (((xx + yy) / 2.0 - gap) / ((xx + yy) / 2.0 + gap)).clamp(0.0, 1.0);
    let span = |f: &dyn Fn(&(f64, f64)) -> f64| {
        let low = points.iter().map(f).fold(f64::INFINITY, f64::min);
        points.iter().map(f).fold(f64::NEG_INFINITY, f64::max) - low + 1.0
    };
    ((1.0 - ratio).sqrt(), n / (span(&|p| p.0) * span(&|p| p.1)))
}
