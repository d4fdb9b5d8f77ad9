//! Where the image lies on the map and which GCPs get a mark.

use super::rng::{Rng, purpose};
use super::spec::{Background, SynthSpec, Visible};
use autoref_raster::coords::{GeoTransform, MapPoint};
use autoref_raster::error::{Error, Result};

pub(crate) struct Plan {
    pub width: u64,
    pub height: u64,
    pub geotransform: GeoTransform,
    /// For each GCP: it gets a mark if it falls inside.
    pub drawn: Vec<bool>,
}

/// The linear part of image → map for a rotation θ of the image's x axis (anticlockwise from east):
/// x runs along (cos θ, sin θ), y along (sin θ, −cos θ); mirrored, x runs the other way.
fn linear(spec: &SynthSpec) -> [f64; 4] {
    let (s, c) = spec.rotation_deg.to_radians().sin_cos();
    let flip = if spec.mirrored { -1.0 } else { 1.0 };
    [flip * spec.gsd_m * c, spec.gsd_m * s, flip * spec.gsd_m * s, -spec.gsd_m * c]
}

fn transform(l: [f64; 4], origin: MapPoint) -> GeoTransform {
    GeoTransform([origin.easting, l[0], l[1], origin.northing, l[2], l[3]])
}

pub(crate) fn lay_out(spec: &SynthSpec) -> Result<Plan> {
    let l = linear(spec);
    let reference = spec.gcps.first().map_or(MapPoint { easting: 570_000.0, northing: 7_032_000.0 }, |g| MapPoint {
        easting: g.easting,
        northing: g.northing,
    });
    // Pixel positions up to a shift.
    let relative = transform(l, reference);
    let at: Vec<(f64, f64)> = spec
        .gcps
        .iter()
        .map(|g| {
            let p = relative
                .invert(MapPoint { easting: g.easting, northing: g.northing })
                .expect("a similarity with a positive scale has an inverse");
            (p.x, p.y)
        })
        .collect();
    let mark_px = spec.mark.size.px(spec.gsd_m);
    let margin = 2.0 * mark_px + 16.0 + spec.border.width_px() as f64;
    let drawn = choose(spec, &at, margin)?;
    let chosen: Vec<(f64, f64)> = at.iter().zip(&drawn).filter(|(_, d)| **d).map(|(p, _)| *p).collect();
    let framed = if chosen.is_empty() { &at } else { &chosen };
    let [x0, y0, x1, y1] = extent(framed);
    let (width, height) = match spec.size_px {
        Some(size) => size,
        None if spec.gcps.is_empty() => {
            return Err(Error::usage("neither GCPs nor an image size are given", "give one of them"));
        }
        None => {
            let air = margin.max(0.06 * (x1 - x0).max(y1 - y0));
            (((x1 - x0) + 2.0 * air).ceil() as u64, ((y1 - y0) + 2.0 * air).ceil() as u64)
        }
    };
    if width == 0 || height == 0 || width > i32::MAX as u64 || height > i32::MAX as u64 {
        return Err(Error::usage(
            format!("an image of {width} x {height} pixels"),
            "TIFF through GDAL takes 1 to 2147483647 pixels a side; check size and ground sample distance",
        ));
    }
    let mut geotransform = match spec.origin {
        Some(origin) => transform(l, origin),
        None if framed.is_empty() => relative,
        None => {
            let corner = autoref_raster::coords::PixelPoint {
                x: (x0 + x1) / 2.0 - width as f64 / 2.0,
                y: (y0 + y1) / 2.0 - height as f64 / 2.0,
            };
            transform(l, relative.apply(corner))
        }
    };
    if let Some(step) = spec.straddle_px.filter(|&n| n > 0) {
        geotransform = straddle(geotransform, spec, &drawn, step, mark_px, (width as f64, height as f64));
    }
    Ok(Plan { width, height, geotransform, drawn })
}

fn extent(points: &[(f64, f64)]) -> [f64; 4] {
    let start = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    points.iter().fold(start, |e, p| [e[0].min(p.0), e[1].min(p.1), e[2].max(p.0), e[3].max(p.1)])
}

/// Which GCPs get a mark.
fn choose(spec: &SynthSpec, at: &[(f64, f64)], margin: f64) -> Result<Vec<bool>> {
    let n = at.len();
    match &spec.visible {
        Visible::All => Ok(vec![true; n]),
        Visible::Named(names) => {
            if let Some(name) = names.iter().find(|name| !spec.gcps.iter().any(|g| g.name == **name)) {
                return Err(Error::usage(format!("no GCP is called {name:?}"), "name GCPs of the list"));
            }
            Ok(spec.gcps.iter().map(|g| names.contains(&g.name)).collect())
        }
        Visible::Random(count) if *count > n => Err(Error::usage(
            format!("{count} visible GCPs are asked for, the list has {n}"),
            "ask for fewer or list more",
        )),
        Visible::Random(count) => random_subset(spec, at, *count, margin),
    }
}

/// `count` GCPs that fit into the image together: first any, then neighbours of a random one.
fn random_subset(spec: &SynthSpec, at: &[(f64, f64)], count: usize, margin: f64) -> Result<Vec<bool>> {
    let mut rng = Rng::new(spec.seed, purpose::VISIBLE, 0);
    let mut order: Vec<usize> = (0..at.len()).collect();
    let fits = |some: &[usize]| {
        let points: Vec<_> = some.iter().map(|&i| at[i]).collect();
        let [x0, y0, x1, y1] = extent(&points);
        match (spec.size_px, &spec.background) {
            _ if points.is_empty() || spec.origin.is_some() => true,
            (Some((w, h)), _) => x1 - x0 + 2.0 * margin <= w as f64 && y1 - y0 + 2.0 * margin <= h as f64,
            (None, Background::AsIs(_) | Background::Landscape | Background::Flat(_) | Background::Photographs(_)) => {
                true
            }
        }
    };
    for attempt in 0..400 {
        rng.shuffle(&mut order);
        if attempt >= 200 {
            let seed = at[order[0]];
            order.sort_by(|&a, &b| {
                let distance = |i: usize| (at[i].0 - seed.0).hypot(at[i].1 - seed.1);
                distance(a).total_cmp(&distance(b))
            });
        }
        if fits(&order[..count]) {
            let mut drawn = vec![false; at.len()];
            order[..count].iter().for_each(|&i| drawn[i] = true);
            return Ok(drawn);
        }
    }
    let (w, h) = spec.size_px.unwrap_or_default();
    Err(Error::usage(
        format!("no {count} GCPs of the list were found that fit into {w} x {h} pixels together"),
        "ask for fewer, a larger image, a larger ground sample distance or another seed",
    ))
}

/// Shifts the image by whole pixels, less than `step` each way, so that a mark lies on a corner of tiles of `step`
/// pixels and many others across edges: of long lists the best of some shifts.
fn straddle(
    g: GeoTransform,
    spec: &SynthSpec,
    drawn: &[bool],
    step: u64,
    mark_px: f64,
    size: (f64, f64),
) -> GeoTransform {
    let points: Vec<_> = spec
        .gcps
        .iter()
        .zip(drawn)
        .filter(|(_, d)| **d)
        .filter_map(|(gcp, _)| g.invert(MapPoint { easting: gcp.easting, northing: gcp.northing }))
        .collect();
    let step = step as f64;
    let half = mark_px / 2.0;
    // Distance to the nearest multiple of the step, after a shift.
    let off = |v: f64, shift: f64| {
        let r = (v - shift).rem_euclid(step);
        r.min(step - r)
    };
    // The nearer of the two whole-pixel shifts that bring a position onto a multiple.
    let shift_of = |v: f64| {
        let r = v.rem_euclid(step).round();
        if r > step / 2.0 { r - step } else { r }
    };
    // Of long lists some: every pair is weighed by all marks.
    const TRIED: usize = 64;
    let tried = || points.iter().step_by(points.len().div_ceil(TRIED).max(1));
    let mut best = (0usize, 0.0, 0.0);
    for a in tried() {
        for b in tried() {
            let (sx, sy) = (shift_of(a.x), shift_of(b.y));
            let score: usize = points
                .iter()
                .filter(|p| p.x - sx > half && p.y - sy > half && p.x - sx < size.0 - half && p.y - sy < size.1 - half)
                .map(|p| {
                    let (nx, ny) = (off(p.x, sx) < half, off(p.y, sy) < half);
                    usize::from(nx) + usize::from(ny) + 8 * usize::from(nx && ny)
                })
                .sum();
            if score > best.0 {
                best = (score, sx, sy);
            }
        }
    }
    let corner = g.apply(autoref_raster::coords::PixelPoint { x: best.1, y: best.2 });
    GeoTransform([corner.easting, g.0[1], g.0[2], corner.northing, g.0[4], g.0[5]])
}
