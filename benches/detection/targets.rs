//! Black and white targets planted into real photographs, with known centres.

use autoref_synth::plant::{Picture, Random, blurred};

/// Photographs of ordinary ground. `IMG_0046` holds two cross plates of its own.
pub const COVERS: [&str; 7] = [
    "photos/city_ochota_3013.jpg",
    "photos/construction_caliterra.jpg",
    "photos/river_town_oam.tif",
    "photos/savanna_oam.tif",
    "photos/canal_pdok_tiled_jpeg.tif",
    "photos/forest_agung.jpg",
    "photos/village_boruszyn.jpg",
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Checker,
    Hourglass,
    /// White cross on black.
    Cross,
    /// The same with the strip of a number that runs into the crossing.
    FifthArm,
}

pub fn photo(name: &str) -> Option<Picture> {
    let here = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = here.ancestors().find(|folder| folder.join(".ci").is_dir())?;
    let path = root.join("../shared/data").join(name);
    let file = gdal::Dataset::open(&path).ok()?;
    let (width, height) = file.raster_size();
    let bands: Vec<Vec<u8>> = (1..=3)
        .map(|b| file.rasterband(b).ok()?.read_as::<u8>((0, 0), (width, height), (width, height), None).ok())
        .map(|b| b.map(|b| b.data().to_vec()))
        .collect::<Option<_>>()?;
    let rgb = (0..width * height).map(|i| [bands[0][i], bands[1][i], bands[2][i]]).collect();
    Some(Picture { width, height, rgb })
}

pub fn middle(picture: &Picture, side: usize) -> Picture {
    let side = side.min(picture.width).min(picture.height);
    picture.crop((picture.width - side) / 2, (picture.height - side) / 2, side, side)
}

/// Is there target, and is it white, at (u, v) in sides from its middle?
fn colour(kind: Kind, u: f64, v: f64) -> (bool, bool) {
    let inside = u.abs() <= 0.5 && v.abs() <= 0.5;
    match kind {
        Kind::Checker => (inside, (u > 0.0) == (v > 0.0)),
        // Two black triangles on a white plate.
        Kind::Hourglass => (inside, v.abs() < 1.2 * u.abs()),
        Kind::Cross => (inside, u.abs() < 0.07 || v.abs() < 0.07),
        Kind::FifthArm => {
            let (sin, cos) = 0.7f64.sin_cos();
            let (along, beside) = (cos * u + sin * v, cos * v - sin * u);
            let strip = (0.0..0.4).contains(&along) && beside.abs() < 0.05;
            (inside, strip || u.abs() < 0.07 || v.abs() < 0.07)
        }
    }
}

/// Plants a target in each square of a grid: side drawn from 14 to 60 px (plates from 30) unless given, any rotation,
/// blur 0.7 to 1.4 px, light 50 to 100 %, JPEG 88. Returns the centres.
pub fn plant_targets(
    ground: &Picture,
    kind: Kind,
    side: Option<f64>,
    random: &mut Random,
) -> (Picture, Vec<(f64, f64)>) {
    let mut out = ground.clone();
    let mut truth = Vec::new();
    let pitch = 150;
    for gy in (20..ground.height.saturating_sub(pitch)).step_by(pitch) {
        for gx in (20..ground.width.saturating_sub(pitch)).step_by(pitch) {
            let least = if matches!(kind, Kind::Cross | Kind::FifthArm) { 30.0 } else { 14.0 };
            let drawn = least * (60.0f64 / least).powf(random.unit());
            let side = side.unwrap_or(drawn);
            let blur = 0.7 + 0.7 * random.unit();
            let size = (side * 1.5 + 8.0 * blur).ceil() as usize + 4;
            let (cx, cy) = (size as f64 / 2.0 + random.unit() - 0.5, size as f64 / 2.0 + random.unit() - 0.5);
            let (sin, cos) = (random.unit() * std::f64::consts::TAU).sin_cos();
            let (x0, y0) = (gx + (random.unit() * 14.0) as usize, gy + (random.unit() * 14.0) as usize);
            let light = 0.5 + 0.5 * random.unit();
            let turned = |x: f64, y: f64| {
                let (dx, dy) = ((x - cx) / side, (y - cy) / side);
                colour(kind, cos * dx + sin * dy, cos * dy - sin * dx)
            };
            let covered = blurred(size, blur, |x, y| f64::from(u8::from(turned(x, y).0)));
            let white = blurred(size, blur, |x, y| f64::from(u8::from(turned(x, y) == (true, true))));
            for i in (0..size * size).filter(|&i| covered[i] > 1e-4) {
                let at = (y0 + i / size) * out.width + x0 + i % size;
                for c in 0..3 {
                    let own = light * (28.0 * (covered[i] - white[i]) + 225.0 * white[i]);
                    let mixed =
                        own + (1.0 - covered[i]) * f64::from(out.rgb[at][c]) + 2.0 * random.gauss() * covered[i];
                    out.rgb[at][c] = mixed.round().clamp(0.0, 255.0) as u8;
                }
            }
            truth.push((x0 as f64 + cx, y0 as f64 + cy));
        }
    }
    (out.through_jpeg(88), truth)
}
