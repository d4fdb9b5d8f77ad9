//! Marks that somebody outlined: a mask of the image's size, or polygons.

use std::path::Path;

use anyhow::{Result, bail};
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::window::Window;
use autoref_raster::{RasterInfo, RasterSource, read_patch};
use autoref_stream::learn::{OUTLINE_REACH_PX, Outlined};

use autoref_raster::sets::Sets;

/// Most marks of a mask or a file of polygons.
const MOST_MARKS: usize = 10_000;
/// Widest outline, pixels: no mark is as large.
const WIDEST_PX: u64 = 2_048;
/// Most rows of pixels, each a run from one edge of a mark to the other.
const MOST_RUNS: usize = 4_000_000;
/// Pixels of the mask that are read at once.
const BAND_PX: u64 = 4 << 20;

/// Pixels of one row, `from..to`.
#[derive(Clone, Copy, Debug)]
struct Run {
    y: u64,
    from: u64,
    to: u64,
}

/// Marks of a mask: each connected group of pixels (8 neighbours) that are not zero in any band.
///
/// # Errors
/// When the mask has another size than the image, holds nothing or too much, or either cannot be read.
pub fn of_mask(image: &dyn RasterSource, mask: &dyn RasterSource) -> Result<Vec<Outlined>> {
    let (info, other) = (image.info(), mask.info());
    let name = other.path.display();
    if (info.width, info.height) != (other.width, other.height) {
        bail!(
            "{name}: is {} × {} pixels, the image {} is {} × {}; a mask has the image's size",
            other.width,
            other.height,
            info.path.display(),
            info.width,
            info.height
        );
    }
    let all = runs(mask)?;
    let groups = connected(&all);
    if groups.is_empty() {
        bail!("{name}: no pixel of it is set; paint the marks in it with any value but 0");
    }
    if groups.len() > MOST_MARKS {
        bail!(
            "{name}: {} separate groups of pixels are set, at most {MOST_MARKS} marks are learned from",
            groups.len()
        );
    }
    let outline = |(i, group): (usize, &Vec<Run>)| {
        let name = format!("{} of the mask", i + 1);
        outlined(image, name, bounds(group), |window, own| set(window, own, group), |w, all_set| set(w, all_set, &all))
    };
    groups.iter().enumerate().map(outline).collect()
}

fn runs(mask: &dyn RasterSource) -> Result<Vec<Run>> {
    let info = mask.info();
    let rows = (BAND_PX / info.width.max(1)).clamp(1, info.height.max(1));
    let mut runs: Vec<Run> = Vec::new();
    for top in (0..info.height).step_by(rows as usize) {
        let window = Window::new(0, top, info.width, rows.min(info.height - top));
        let patch = read_patch(mask, window)?;
        for y in 0..window.height {
            let is_set = |x: u64| {
                let i = (y * window.width + x) as usize;
                patch.valid[i] && patch.rgb[i].iter().any(|v| *v > 0)
            };
            let mut x = 0;
            while x < window.width {
                if !is_set(x) {
                    x += 1;
                    continue;
                }
                let from = x;
                while x < window.width && is_set(x) {
                    x += 1;
                }
                runs.push(Run { y: top + y, from, to: x });
            }
        }
        if runs.len() > MOST_RUNS {
            bail!("{}: too many pixels are set for a mask of marks; is it a mask of the ground?", info.path.display());
        }
    }
    Ok(runs)
}

/// Groups of runs that touch, corners included, in order of their first run.
fn connected(runs: &[Run]) -> Vec<Vec<Run>> {
    let mut sets = Sets::apart(runs.len());
    let mut above = 0;
    for (i, run) in runs.iter().enumerate() {
        // Runs of the row above that end before this one begins touch no later run either.
        while above < i && (runs[above].y + 1 < run.y || (runs[above].y + 1 == run.y && runs[above].to < run.from)) {
            above += 1;
        }
        let mut j = above;
        while j < i && runs[j].y + 1 == run.y && runs[j].from <= run.to {
            sets.unite(j, i);
            j += 1;
        }
    }
    let mut groups: Vec<Vec<Run>> = Vec::new();
    let mut place = vec![usize::MAX; runs.len()];
    for (i, run) in runs.iter().enumerate() {
        let root = sets.root(i);
        if place[root] == usize::MAX {
            place[root] = groups.len();
            groups.push(Vec::new());
        }
        groups[place[root]].push(*run);
    }
    groups
}

fn bounds(group: &[Run]) -> Window {
    let left = group.iter().map(|r| r.from).min().unwrap_or(0);
    let right = group.iter().map(|r| r.to).max().unwrap_or(0);
    let (top, bottom) = (group[0].y, group[group.len() - 1].y + 1);
    Window::new(left, top, right - left, bottom - top)
}

/// Sets the pixels of runs (in order of their rows) that lie in the window.
fn set(window: &Window, own: &mut [bool], runs: &[Run]) {
    let first = runs.partition_point(|run| run.y < window.y);
    for run in runs[first..].iter().take_while(|run| run.y < window.bottom()) {
        for x in run.from.max(window.x)..run.to.min(window.right()) {
            own[((run.y - window.y) * window.width + (x - window.x)) as usize] = true;
        }
    }
}

/// A polygon in pixels, (0, 0) at the outer corner of the first pixel: its rings, holes included.
struct Polygon {
    name: String,
    rings: Vec<Vec<PixelPoint>>,
}

/// Marks of the polygons of a vector file: the pixels whose centres lie inside by the even-odd rule.
///
/// Coordinates are on the map when the image is georeferenced and the polygons lie in it so; else pixels, y downwards
/// or, as viewers without a georeference count, upwards below zero.
///
/// # Errors
/// When the file cannot be read, or its polygons lie outside the image.
pub fn of_polygons(image: &dyn RasterSource, path: &Path) -> Result<Vec<Outlined>> {
    let info = image.info();
    let areas = autoref_elevation::files::read_areas(path, info.crs_wkt.as_deref().unwrap_or(""))?;
    if areas.len() > MOST_MARKS {
        bail!("{}: {} polygons, at most {MOST_MARKS} marks are learned from", path.display(), areas.len());
    }
    let polygons = placed(&areas, info, path)?;
    let windows: Vec<Window> = polygons.iter().map(|polygon| pixel_bounds(polygon, info)).collect();
    let outline = |(polygon, window): (&Polygon, &Window)| {
        if window.width == 0 || window.height == 0 {
            bail!("{}: the polygon {} lies outside the image {}", path.display(), polygon.name, info.path.display());
        }
        outlined(
            image,
            polygon.name.clone(),
            *window,
            |w, own| fill(w, own, polygon),
            |w, all| {
                let near = polygons.iter().zip(&windows).filter(|(_, other)| !w.intersect(other).is_empty());
                near.for_each(|(other, _)| fill(w, all, other));
            },
        )
    };
    polygons.iter().zip(&windows).map(outline).collect()
}

/// The pixels of the image that hold the polygon; without width or height when it lies outside.
fn pixel_bounds(polygon: &Polygon, info: &RasterInfo) -> Window {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in polygon.rings.iter().flatten() {
        low = [low[0].min(p.x), low[1].min(p.y)];
        high = [high[0].max(p.x), high[1].max(p.y)];
    }
    let whole = |v: f64, most: u64| v.clamp(0.0, most as f64) as u64;
    let (left, top) = (whole(low[0].floor(), info.width), whole(low[1].floor(), info.height));
    let (right, bottom) = (whole(high[0].ceil(), info.width), whole(high[1].ceil(), info.height));
    Window::new(left, top, right - left, bottom - top)
}

/// The polygons in pixels, by the first reading that puts one of them into the image.
fn placed(
    areas: &[(String, Vec<autoref_elevation::zones::Ring>)],
    info: &RasterInfo,
    path: &Path,
) -> Result<Vec<Polygon>> {
    let (width, height) = (info.width as f64, info.height as f64);
    let on_map =
        |x: f64, y: f64| info.geotransform.and_then(|transform| transform.invert(MapPoint { easting: x, northing: y }));
    let downwards = |x: f64, y: f64| Some(PixelPoint { x, y });
    let upwards = |x: f64, y: f64| Some(PixelPoint { x, y: -y });
    let readings: [&dyn Fn(f64, f64) -> Option<PixelPoint>; 3] = [&on_map, &downwards, &upwards];
    for reading in readings {
        let polygon = |(name, rings): &(String, Vec<autoref_elevation::zones::Ring>)| {
            let ring = |ring: &autoref_elevation::zones::Ring| ring.iter().map(|&(x, y)| reading(x, y)).collect();
            Some(Polygon { name: name.clone(), rings: rings.iter().map(ring).collect::<Option<_>>()? })
        };
        let Some(polygons) = areas.iter().map(polygon).collect::<Option<Vec<Polygon>>>() else { continue };
        let inside = |p: &PixelPoint| p.x > 0.0 && p.y > 0.0 && p.x < width && p.y < height;
        if polygons.iter().any(|polygon| polygon.rings.iter().flatten().any(inside)) {
            return Ok(polygons);
        }
    }
    bail!(
        "{}: none of its {} polygons lies in the image {}, on the map or in pixels; check its CRS",
        path.display(),
        areas.len(),
        info.path.display()
    )
}

fn fill(window: &Window, own: &mut [bool], polygon: &Polygon) {
    for y in window.y..window.bottom() {
        let middle = y as f64 + 0.5;
        let mut crossings: Vec<f64> = polygon
            .rings
            .iter()
            .flat_map(|ring| ring.iter().zip(ring.iter().cycle().skip(1)))
            .filter(|(a, b)| (a.y > middle) != (b.y > middle))
            .map(|(a, b)| a.x + (b.x - a.x) * ((middle - a.y) / (b.y - a.y)))
            .collect();
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            // The first pixel whose centre is not left of the crossing.
            let pixel = |v: f64| ((v - 0.5).ceil().max(0.0) as u64).clamp(window.x, window.right());
            for x in pixel(pair[0])..pixel(pair[1]) {
                own[((y - window.y) * window.width + (x - window.x)) as usize] = true;
            }
        }
    }
}

/// Reads what is around an outline and marks its pixels.
fn outlined(
    image: &dyn RasterSource,
    name: String,
    bounds: Window,
    mark_own: impl Fn(&Window, &mut [bool]),
    mark_all: impl Fn(&Window, &mut [bool]),
) -> Result<Outlined> {
    if bounds.width.max(bounds.height) > WIDEST_PX {
        bail!("the mark {name} is {} × {} pixels; at most {WIDEST_PX} are a mark", bounds.width, bounds.height);
    }
    let window = bounds.grown(OUTLINE_REACH_PX, &image.info().bounds());
    let patch = read_patch(image, window)?;
    let pixels = (window.width * window.height) as usize;
    let (mut own, mut all) = (vec![false; pixels], vec![false; pixels]);
    mark_own(&window, &mut own);
    mark_all(&window, &mut all);
    Ok(Outlined { name, patch, own, all })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_that_touch_at_a_corner_are_one_mark() {
        let run = |y, from, to| Run { y, from, to };
        // A U whose arms join below, a speck at its corner, and one apart.
        let runs = [run(0, 0, 2), run(0, 5, 7), run(1, 0, 2), run(1, 5, 7), run(2, 0, 7), run(3, 7, 8), run(3, 20, 21)];
        let groups = connected(&runs);
        assert_eq!(groups.iter().map(Vec::len).collect::<Vec<_>>(), [6, 1]);
        let apart = [run(0, 0, 2), run(2, 0, 2), run(2, 3, 4)];
        assert_eq!(connected(&apart).len(), 3);
    }

    #[test]
    fn a_polygon_holds_the_pixels_whose_centres_it_holds() {
        let point = |x, y| PixelPoint { x, y };
        let square = |a: f64, b: f64| vec![point(a, a), point(b, a), point(b, b), point(a, b)];
        let polygon = Polygon { name: String::new(), rings: vec![square(1.4, 8.5), square(4.0, 6.0)] };
        let window = Window::new(0, 0, 10, 10);
        let mut own = vec![false; 100];
        fill(&window, &mut own, &polygon);
        // Centres 1.5 to 7.5, without those of the hole.
        assert_eq!(own.iter().filter(|inside| **inside).count(), 7 * 7 - 2 * 2);
        assert!(own[11] && own[77] && !own[88] && !own[44] && own[46]);
    }
}
