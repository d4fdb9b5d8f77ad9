//! The outlines of what is kept, as GeoJSON polygons in pixels of the frame: x to the right, y down, (0, 0) at the
//! outer corner of the first pixel. `--samples`, `--global` and `--mend` read them.

use std::collections::HashMap;
use std::fmt::Write;

use crate::bits::{Bit, BitMask};

/// Corners of a ring, in pixels of the mask.
type Ring = Vec<[i32; 2]>;

/// East, south, west, north.
const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
/// From a corner, the pixels ahead on the right and on the left, for each direction.
const AHEAD: [([i32; 2], [i32; 2]); 4] =
    [([0, 0], [0, -1]), ([-1, 0], [0, 0]), ([-1, -1], [-1, 0]), ([0, -1], [-1, -1])];

/// The ring that runs along the upper edge of a kept pixel, with what is kept on its right. Areas that touch in a
/// corner only are two.
fn trace(mask: &BitMask, start: [i32; 2], seen: &mut BitMask) -> Ring {
    let kept = |at: [i32; 2]| {
        (0..mask.width() as i32).contains(&at[0])
            && (0..mask.height() as i32).contains(&at[1])
            && mask.get(at[0] as usize, at[1] as usize)
    };
    let mut ring = Vec::new();
    let (mut at, mut heading) = (start, 0);
    loop {
        if heading == 0 {
            seen.set(at[0] as usize, at[1] as usize, true);
        }
        at = [at[0] + STEPS[heading][0], at[1] + STEPS[heading][1]];
        let pixel = |offset: [i32; 2]| [at[0] + offset[0], at[1] + offset[1]];
        let (right, left) = AHEAD[heading];
        let turned = if !kept(pixel(right)) {
            (heading + 1) % 4
        } else if kept(pixel(left)) {
            (heading + 3) % 4
        } else {
            heading
        };
        if turned != heading {
            ring.push(at);
        }
        heading = turned;
        if at == start && heading == 0 {
            return ring;
        }
    }
}

/// Cuts a ring where it meets itself in a corner, as an area does that closes around a hole there: rings of GeoJSON may
/// touch each other in a point, not themselves.
fn cut(ring: Ring) -> Vec<Ring> {
    let mut rings = Vec::new();
    let mut open: Ring = Vec::new();
    let mut places: HashMap<[i32; 2], usize> = HashMap::new();
    for corner in ring {
        if let Some(first) = places.get(&corner).copied() {
            let closed = open.split_off(first);
            for corner in &closed {
                places.remove(corner);
            }
            rings.push(closed);
        }
        places.insert(corner, open.len());
        open.push(corner);
    }
    rings.push(open);
    rings
}

/// The middle of the kept pixel beside the ring's first edge.
fn beside(ring: &Ring) -> [f64; 2] {
    let (a, b) = (ring[0], ring[1]);
    let [dx, dy] = [0, 1].map(|axis| f64::from((b[axis] - a[axis]).signum()) / 2.0);
    [f64::from(a[0]) + dx - dy, f64::from(a[1]) + dy + dx]
}

/// Twice the area; positive for outer rings.
fn area2(ring: &Ring) -> i64 {
    let next = ring.iter().cycle().skip(1);
    let product = |a: i32, b: i32| i64::from(a) * i64::from(b);
    ring.iter().zip(next).map(|(a, b)| product(a[0], b[1]) - product(b[0], a[1])).sum()
}

fn contains(ring: &Ring, [x, y]: [f64; 2]) -> bool {
    let next = ring.iter().cycle().skip(1);
    let crossings = ring.iter().zip(next).filter(|(a, b)| {
        // All edges run along rows or columns.
        (f64::from(a[1]) > y) != (f64::from(b[1]) > y) && x < f64::from(a[0])
    });
    crossings.count() % 2 == 1
}

/// What is kept as GeoJSON, one feature for each connected area, largest first.
pub fn polygons(mask: &BitMask, size: [usize; 2], factor: usize, frame: &str) -> String {
    let mut seen = BitMask::new(mask.width(), mask.height());
    let (mut outer, mut holes): (Vec<(Ring, Vec<Ring>)>, Vec<Ring>) = (Vec::new(), Vec::new());
    for y in 0..mask.height() {
        let mut starts = Vec::new();
        mask.runs(y, Bit::Set, |from, to| starts.extend(from..to));
        for x in starts {
            if (y == 0 || !mask.get(x, y - 1)) && !seen.get(x, y) {
                for ring in cut(trace(mask, [x as i32, y as i32], &mut seen)) {
                    if area2(&ring) > 0 { outer.push((ring, Vec::new())) } else { holes.push(ring) }
                }
            }
        }
    }
    drop(seen);
    outer.sort_by_key(|(ring, _)| std::cmp::Reverse(area2(ring)));
    for hole in holes {
        let inside = beside(&hole);
        // The smallest area around the pixel beside the hole is the one that the hole lies in.
        if let Some((_, own)) = outer.iter_mut().rev().find(|(ring, _)| contains(ring, inside)) {
            own.push(hole);
        }
    }
    let name = serde_json::Value::from(frame);
    let mut text = format!("{{\"type\":\"FeatureCollection\",\"frame\":{name},\"features\":[");
    for (index, (ring, holes)) in outer.iter().enumerate() {
        let comma = if index > 0 { ",\n" } else { "\n" };
        let _ = write!(
            text,
            "{comma}{{\"type\":\"Feature\",\"properties\":{{\"class\":\"keep\",\"frame\":{name}}},\
             \"geometry\":{{\"type\":\"Polygon\",\"coordinates\":["
        );
        for (index, ring) in std::iter::once(ring).chain(holes).enumerate() {
            text += if index > 0 { ",[" } else { "[" };
            for (index, at) in ring.iter().chain(ring.first()).enumerate() {
                let [x, y] = [0, 1].map(|axis| (at[axis] as usize * factor).min(size[axis]));
                let _ = write!(text, "{}[{x},{y}]", if index > 0 { "," } else { "" });
            }
            text.push(']');
        }
        text += "]}}";
    }
    text += "\n]}\n";
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn filled(value: &Value, width: usize, height: usize) -> BitMask {
        let features = value["features"].as_array().expect("features");
        BitMask::from_fn(width, height, |x, y| {
            let point = [x as f64 + 0.5, y as f64 + 0.5];
            features.iter().any(|feature| {
                let rings = feature["geometry"]["coordinates"].as_array().expect("rings");
                let inside = |ring: &Value| {
                    let ring: Ring = serde_json::from_value(ring.clone()).expect("corners");
                    contains(&ring, point)
                };
                rings.iter().filter(|ring| inside(ring)).count() % 2 == 1
            })
        })
    }

    #[test]
    fn outlines_give_the_mask_again() {
        let mut draws = autoref_raster::random::Mmix(7);
        for round in 0..40u64 {
            let (width, height) = (1 + (round * 7 % 23) as usize, 1 + (round * 5 % 17) as usize);
            let mask = BitMask::from_fn(width, height, |_, _| draws.below(5) < 1 + round as usize % 4);
            let value: Value = serde_json::from_str(&polygons(&mask, [width, height], 1, "a.tif")).expect("JSON");
            for ring in value["features"]
                .as_array()
                .expect("features")
                .iter()
                .flat_map(|f| f["geometry"]["coordinates"].as_array().expect("rings").clone())
            {
                let mut ring: Ring = serde_json::from_value(ring).expect("corners");
                assert_eq!(ring.pop(), ring.first().copied(), "closed");
                let count = ring.len();
                ring.sort_unstable();
                ring.dedup();
                assert_eq!(ring.len(), count, "round {round}: a ring touches itself");
            }
            let again = filled(&value, width, height);
            for y in 0..height {
                assert_eq!(again.row(y), mask.row(y), "round {round}, row {y}");
            }
        }
    }

    #[test]
    fn a_hole_belongs_to_its_area_and_the_frame_bounds_all() {
        let mask = BitMask::from_fn(4, 4, |x, y| !(x == 1 && y == 1));
        let value: Value = serde_json::from_str(&polygons(&mask, [15, 14], 4, "a.tif")).expect("JSON");
        assert_eq!(value["features"].as_array().expect("features").len(), 1);
        let rings = value["features"][0]["geometry"]["coordinates"].as_array().expect("rings");
        assert_eq!(rings.len(), 2);
        assert_eq!(rings[0], json!([[15, 0], [15, 14], [0, 14], [0, 0], [15, 0]]));
    }
}
