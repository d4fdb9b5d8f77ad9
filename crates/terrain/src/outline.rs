//! The outlines of what is kept, as GeoJSON polygons in pixels of the frame: x to the right, y down, (0, 0) at the
//! outer corner of the first pixel. `--samples`, `--global` and `--mend` read them.

use serde_json::{Value, json};

use crate::bits::BitMask;

/// Corners of a ring, in pixels of the mask.
type Ring = Vec<[i64; 2]>;

/// East, south, west, north.
const STEPS: [[i64; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
/// From a corner, the pixels ahead on the right and on the left, for each direction.
const AHEAD: [([i64; 2], [i64; 2]); 4] =
    [([0, 0], [0, -1]), ([-1, 0], [0, 0]), ([-1, -1], [-1, 0]), ([0, -1], [-1, -1])];

/// The ring that runs along the upper edge of a kept pixel, with what is kept on its right. Areas that touch in a
/// corner only are two.
fn trace(mask: &BitMask, start: [i64; 2], seen: &mut BitMask) -> Ring {
    let kept = |at: [i64; 2]| {
        (0..mask.width() as i64).contains(&at[0])
            && (0..mask.height() as i64).contains(&at[1])
            && mask.get(at[0] as usize, at[1] as usize)
    };
    let mut ring = Vec::new();
    let (mut at, mut heading) = (start, 0);
    loop {
        if heading == 0 {
            seen.set(at[0] as usize, at[1] as usize, true);
        }
        at = [at[0] + STEPS[heading][0], at[1] + STEPS[heading][1]];
        let pixel = |offset: [i64; 2]| [at[0] + offset[0], at[1] + offset[1]];
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

/// Twice the area; positive for outer rings.
fn area2(ring: &Ring) -> i64 {
    let next = ring.iter().cycle().skip(1);
    ring.iter().zip(next).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum()
}

fn contains(ring: &Ring, [x, y]: [f64; 2]) -> bool {
    let next = ring.iter().cycle().skip(1);
    let crossings = ring.iter().zip(next).filter(|(a, b)| {
        // All edges run along rows or columns.
        (a[1] as f64 > y) != (b[1] as f64 > y) && x < a[0] as f64
    });
    crossings.count() % 2 == 1
}

/// What is kept, one feature for each connected area, largest first.
pub fn polygons(mask: &BitMask, size: [usize; 2], factor: usize, frame: &str) -> Value {
    let mut seen = BitMask::new(mask.width(), mask.height());
    let (mut outer, mut holes) = (Vec::new(), Vec::new());
    for y in 0..mask.height() {
        let mut starts = Vec::new();
        mask.runs(y, true, |from, to| starts.extend(from..to));
        for x in starts {
            if (y == 0 || !mask.get(x, y - 1)) && !seen.get(x, y) {
                let ring = trace(mask, [x as i64, y as i64], &mut seen);
                let inside = [x as f64 + 0.5, y as f64 + 0.5];
                if area2(&ring) > 0 { outer.push((ring, Vec::new())) } else { holes.push((ring, inside)) }
            }
        }
    }
    outer.sort_by_key(|(ring, _): &(Ring, Vec<Ring>)| std::cmp::Reverse(area2(ring)));
    for (hole, inside) in holes {
        // The smallest area around the pixel beside the hole is the one that the hole lies in.
        if let Some((_, own)) = outer.iter_mut().rev().find(|(ring, _)| contains(ring, inside)) {
            own.push(hole);
        }
    }
    let corner = |at: &[i64; 2]| [0, 1].map(|axis| (at[axis] as usize * factor).min(size[axis]));
    let closed = |ring: &Ring| {
        let mut corners: Vec<[usize; 2]> = ring.iter().map(corner).collect();
        corners.extend(corners.first().copied());
        corners
    };
    let features: Vec<Value> = outer
        .iter()
        .map(|(ring, holes)| {
            let rings: Vec<Vec<[usize; 2]>> = std::iter::once(ring).chain(holes).map(closed).collect();
            json!({
                "type": "Feature",
                "properties": { "class": "keep", "frame": frame },
                "geometry": { "type": "Polygon", "coordinates": rings },
            })
        })
        .collect();
    json!({ "type": "FeatureCollection", "frame": frame, "features": features })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(value: &Value, width: usize, height: usize) -> BitMask {
        let features = value["features"].as_array().expect("features");
        BitMask::from_fn(width, height, |x, y| {
            let point = [x as f64 + 0.5, y as f64 + 0.5];
            features.iter().any(|feature| {
                let rings = feature["geometry"]["coordinates"].as_array().expect("rings");
                let inside = |ring: &Value| {
                    let ring: Vec<[i64; 2]> = serde_json::from_value(ring.clone()).expect("corners");
                    contains(&ring, point)
                };
                rings.iter().filter(|ring| inside(ring)).count() % 2 == 1
            })
        })
    }

    #[test]
    fn outlines_give_the_mask_again() {
        let mut state = 7u64;
        for round in 0..40u64 {
            let (width, height) = (1 + (round * 7 % 23) as usize, 1 + (round * 5 % 17) as usize);
            let mask = BitMask::from_fn(width, height, |_, _| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) % 5 < 1 + round % 4
            });
            let value = polygons(&mask, [width, height], 1, "a.tif");
            let again = filled(&value, width, height);
            for y in 0..height {
                assert_eq!(again.row(y), mask.row(y), "round {round}, row {y}");
            }
        }
    }

    #[test]
    fn a_hole_belongs_to_its_area_and_the_frame_bounds_all() {
        let mask = BitMask::from_fn(4, 4, |x, y| !(x == 1 && y == 1));
        let value = polygons(&mask, [15, 14], 4, "a.tif");
        assert_eq!(value["features"].as_array().expect("features").len(), 1);
        let rings = value["features"][0]["geometry"]["coordinates"].as_array().expect("rings");
        assert_eq!(rings.len(), 2);
        assert_eq!(rings[0], json!([[15, 0], [15, 14], [0, 14], [0, 0], [15, 0]]));
    }
}
