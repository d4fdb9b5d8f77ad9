//! One topological point pattern, and how two of them are walked together.

use nalgebra::{Vector2, Vector3};

/// A point as its anchor sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Distance from the anchor, in units of that of the anchor's nearest neighbour.
    pub radius: f64,
    /// Unit vector; its first axis lies in the plane, towards the nearest neighbour, its third points up.
    pub direction: Vector3<f64>,
    /// Which point of the list it is.
    pub index: usize,
}

impl Seen {
    /// Where it lies in the pattern, seen from above.
    pub fn place(&self) -> [f64; 2] {
        [self.radius * self.direction.x, self.radius * self.direction.y]
    }
}

/// What counts as the same place in two patterns.
#[derive(Clone, Copy, Debug)]
pub struct Thresholds {
    /// Largest difference of radii, in units of the pattern.
    pub radius: f64,
    /// Largest angle between directions, radians.
    pub angle: f64,
}

/// All other points as `anchor` sees them, up to `max_distance` (in units of the pattern), sorted by radius, then by
/// the angle from the axis. Points are east, north, up; patterns in the plane have all heights 0. Empty when all points
/// lie in one place, or the nearest neighbour straight above or below.
pub fn pattern(points: &[Vector3<f64>], anchor: usize, max_distance: f64) -> Vec<Seen> {
    let away = |i: usize| points[i] - points[anchor];
    let others = || (0..points.len()).filter(|&i| away(i) != Vector3::zeros());
    let Some(nearest) = others().min_by(|&a, &b| away(a).norm().total_cmp(&away(b).norm())) else { return Vec::new() };
    let unit = away(nearest).norm();
    let Some(axis) = Vector2::new(away(nearest).x, away(nearest).y).try_normalize(0.0) else { return Vec::new() };
    let first = Vector3::x();
    let mut seen: Vec<Seen> = others()
        .map(|index| {
            let d = away(index);
            let turned = Vector3::new(axis.x * d.x + axis.y * d.y, axis.x * d.y - axis.y * d.x, d.z);
            Seen { radius: d.norm() / unit, direction: turned.normalize(), index }
        })
        .filter(|s| s.radius <= max_distance)
        .collect();
    let off_axis = |s: &Seen| between(&s.direction, &first);
    seen.sort_by(|a, b| a.radius.total_cmp(&b.radius).then(off_axis(a).total_cmp(&off_axis(b))));
    seen
}

/// The angle between two unit vectors, radians; exact for small ones too.
pub fn between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

/// Pairs (place in `image`, place in `gcps`) of two patterns, walked together.
pub fn matched(image: &[Seen], gcps: &[Seen], near: Thresholds) -> Vec<(usize, usize)> {
    let close = |a: &Seen, b: &Seen| (a.radius - b.radius).abs() <= near.radius;
    let (mut i, mut j) = (0, 0);
    let mut pairs = Vec::new();
    while i < image.len() && j < gcps.len() {
        let (a, b) = (&image[i], &gcps[j]);
        let off = between(&a.direction, &b.direction);
        if close(a, b) && off <= near.angle {
            pairs.push((i, j));
            i += 1;
            j += 1;
        } else if !close(a, b) {
            if a.radius < b.radius { i += 1 } else { j += 1 }
        } else {
            // The radii agree, the angles do not: skip whichever point's successor fits the other one better.
            let ahead = |a: Option<&Seen>, b: Option<&Seen>| match (a, b) {
                (Some(a), Some(b)) if close(a, b) => between(&a.direction, &b.direction),
                _ => f64::INFINITY,
            };
            let (skip_image, skip_gcp) = (ahead(image.get(i + 1), Some(b)), ahead(Some(a), gcps.get(j + 1)));
            if skip_image.min(skip_gcp) >= off {
                // Neither helps: the one with the smaller radius has had its chance.
                if a.radius <= b.radius { i += 1 } else { j += 1 }
            } else if skip_image <= skip_gcp {
                i += 1;
            } else {
                j += 1;
            }
        }
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEAR: Thresholds = Thresholds { radius: 0.05, angle: 0.05 };

    fn moved(points: &[Vector3<f64>], scale: f64, angle: f64) -> Vec<Vector3<f64>> {
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        points.iter().map(|p| turn * p * scale + Vector3::new(7.0, -2.0, 4.0)).collect()
    }

    #[test]
    fn patterns_agree_whatever_shift_rotation_and_scale() {
        let flat = [(0.0, 0.0), (1.0, 0.2), (3.0, -0.01), (-2.0, 4.0), (5.0, 1.0)];
        for relief in [0.0, 1.0] {
            let height = |i: usize| relief * [0.3, 0.9, -0.4, 1.1, 0.2][i];
            let points: Vec<_> = flat.iter().enumerate().map(|(i, p)| Vector3::new(p.0, p.1, height(i))).collect();
            let moved = moved(&points, 3.7, 2.9);
            for anchor in 0..points.len() {
                let (a, b) = (pattern(&points, anchor, f64::INFINITY), pattern(&moved, anchor, f64::INFINITY));
                let pairs = matched(&a, &b, NEAR);
                assert_eq!(pairs.len(), points.len() - 1, "anchor {anchor}");
                assert!(pairs.iter().all(|&(i, j)| a[i].index == b[j].index), "anchor {anchor}: {pairs:?}");
            }
        }
    }

    #[test]
    fn angles_just_either_side_of_the_axis_are_close() {
        let seen =
            |angle: f64| vec![Seen { radius: 2.0, direction: Vector3::new(angle.cos(), angle.sin(), 0.0), index: 0 }];
        assert!((between(&seen(0.01)[0].direction, &seen(-0.01)[0].direction) - 0.02).abs() < 1e-12);
        assert_eq!(matched(&seen(0.01), &seen(-0.01), NEAR).len(), 1);
        // Opposite directions are not: folding by π took them for one.
        assert_eq!(matched(&seen(0.0), &seen(std::f64::consts::PI), NEAR).len(), 0);
        // A point above another is not in its place, though a map does not show it.
        let up = vec![Seen { radius: 2.0, direction: Vector3::new(1.0, 0.0, 0.1).normalize(), index: 0 }];
        assert_eq!(matched(&seen(0.0), &up, NEAR).len(), 0);
    }
}
