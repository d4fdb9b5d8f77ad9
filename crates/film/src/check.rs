//! Do the marks agree? Each is compared with where the others put it; what does not fit is never passed as good.

use nalgebra::{Matrix3, Vector3};

use super::interior::{distance, fit_pose};
use autoref_raster::coords::{Handedness, PixelPoint};

/// What the comparison says of one mark.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreement {
    /// Where the marks that agree put it (for one of them: the others).
    pub predicted: Option<PixelPoint>,
    /// Whether it is one of at least three marks that agree with each other.
    pub agrees: bool,
    pub reason: Option<String>,
}

/// Compares marks `(film mm, place)` with each other; `tolerance_px` is how far a mark may lie from where the others put it.
///
/// With four or more, marks are left out one at a time, the worst first, until the rest agree; with three left nothing
/// more can be left out, since two always agree. Where leaving out either of two marks would make the rest agree, nobody
/// can tell which is wrong, and none is passed.
pub fn agreement(points: &[([f64; 2], PixelPoint)], mirrored: Handedness, tolerance_px: f64) -> Vec<Agreement> {
    let all: Vec<usize> = (0..points.len()).collect();
    let mut kept = all.clone();
    let mut undecided = false;
    while kept.len() >= 4 && misfit(points, &kept, mirrored) > tolerance_px {
        let mut without: Vec<(f64, usize)> = kept
            .iter()
            .map(|&k| (misfit(points, &kept.iter().copied().filter(|i| *i != k).collect::<Vec<_>>(), mirrored), k))
            .collect();
        without.sort_by(|a, b| a.0.total_cmp(&b.0));
        undecided = without[0].0 <= tolerance_px && without[1].0 <= 1.5 * tolerance_px;
        kept.retain(|i| *i != without[0].1);
    }
    let consistent = kept.len() >= 3 && misfit(points, &kept, mirrored) <= tolerance_px && !undecided;
    all.iter()
        .map(|&k| {
            let others: Vec<_> = if consistent || kept.len() < 3 { &kept } else { &all }
                .iter()
                .filter(|i| **i != k)
                .map(|i| points[*i])
                .collect();
            let predicted = predict(&others, points[k].0, mirrored);
            let off = predicted.map_or(0.0, |p| distance(p, points[k].1));
            let agrees = consistent && kept.contains(&k);
            let reason = (!agrees).then(|| match (points.len(), consistent) {
                (0..=2, _) => "fewer than three marks: nothing checks it".to_owned(),
                (_, true) => format!("lies {off:.1} px from where the other marks put it"),
                (_, false) => {
                    format!("the marks contradict each other ({off:.1} px at this one) and do not tell which is wrong")
                }
            });
            Agreement { predicted, agrees, reason }
        })
        .collect()
}

/// The largest distance of one of `kept` from where the others of `kept` put it; infinite when it cannot be told.
fn misfit(points: &[([f64; 2], PixelPoint)], kept: &[usize], mirrored: Handedness) -> f64 {
    kept.iter()
        .map(|&k| {
            let others: Vec<_> = kept.iter().filter(|i| **i != k).map(|i| points[*i]).collect();
            predict(&others, points[k].0, mirrored).map_or(f64::INFINITY, |p| distance(p, points[k].1))
        })
        .fold(0.0, f64::max)
}

/// Where `others` put the film point `mm`. Three or more say it by an affine transform, since film and scanners shear and
/// shrink by a tenth of a per cent (the public Wild frame: 0.13 mm at the corners, by hand as by this program); two by a
/// similarity.
fn predict(others: &[([f64; 2], PixelPoint)], mm: [f64; 2], mirrored: Handedness) -> Option<PixelPoint> {
    let pose = fit_pose(others, mirrored)?;
    let similar = pose.apply(mm);
    let Some(affine) = affine(others) else { return Some(similar) };
    let at = [0, 1].map(|d| affine[d][0] * mm[0] + affine[d][1] * mm[1] + affine[d][2]);
    let at = PixelPoint { x: at[0], y: at[1] };
    // More than that is no film: the similarity's answer, which then contradicts somebody.
    let size = others.iter().map(|o| (o.0[0] - mm[0]).hypot(o.0[1] - mm[1])).fold(0.0, f64::max);
    Some(if distance(at, similar) < MOST_DEFORMED * size * pose.px_per_mm() { at } else { similar })
}

/// Shear and shrinkage that film and scanners may have, of a frame's size.
const MOST_DEFORMED: f64 = 0.004;

/// Film → scan by least squares, x and y rows; `None` below three points or when they lie on a line.
fn affine(points: &[([f64; 2], PixelPoint)]) -> Option<[[f64; 3]; 2]> {
    if points.len() < 3 {
        return None;
    }
    let centre = points.iter().fold([0.0, 0.0], |c, p| [c[0] + p.0[0], c[1] + p.0[1]]).map(|v| v / points.len() as f64);
    let (mut normal, mut right) = (Matrix3::<f64>::zeros(), [Vector3::zeros(), Vector3::zeros()]);
    for (mm, p) in points {
        let row = Vector3::new(mm[0] - centre[0], mm[1] - centre[1], 1.0);
        normal += row * row.transpose();
        right[0] += row * p.x;
        right[1] += row * p.y;
    }
    // Nearly on a line: a tenth of the longer extent is the least that carries a prediction.
    let spread = (normal[(0, 0)] + normal[(1, 1)]).max(1e-9);
    let thin = (normal[(0, 0)] * normal[(1, 1)] - normal[(0, 1)].powi(2)) / (spread * spread);
    let inverse = normal.try_inverse().filter(|_| thin > 0.0025)?;
    Some(right.map(|r| {
        let c = inverse * r;
        [c[0], c[1], c[2] - c[0] * centre[0] - c[1] * centre[1]]
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(errors: &[(usize, f64, f64)]) -> Vec<([f64; 2], PixelPoint)> {
        let film = [[89.8, 3.1], [89.5, 177.9], [176.7, 90.4], [2.2, 90.2]];
        film.iter()
            .enumerate()
            .map(|(k, mm)| {
                let (dx, dy) = errors.iter().filter(|e| e.0 == k).fold((0.0, 0.0), |s, e| (s.0 + e.1, s.1 + e.2));
                (*mm, PixelPoint { x: 74.0 * mm[0] + 50.0 + dx, y: 74.0 * mm[1] + 20.0 + dy })
            })
            .collect()
    }

    #[test]
    fn marks_without_error_agree() {
        assert!(agreement(&frame(&[]), Handedness::AsIs, 3.0).iter().all(|a| a.agrees && a.reason.is_none()));
    }

    #[test]
    fn a_gross_error_is_never_passed() {
        for k in 0..4 {
            for (dx, dy) in [(5.0, 0.0), (0.0, -5.0), (4.0, 4.0), (40.0, 3.0), (0.0, 300.0)] {
                let found = agreement(&frame(&[(k, dx, dy)]), Handedness::AsIs, 3.0);
                assert!(!found[k].agrees, "mark {k} off by {dx},{dy}: {found:?}");
            }
        }
    }

    #[test]
    fn sheared_film_is_no_error() {
        let mut points = frame(&[]);
        for (mm, p) in &mut points {
            p.x += 0.06 * (mm[1] - 90.0);
            p.y += 0.03 * (mm[0] - 90.0);
        }
        assert!(agreement(&points, Handedness::AsIs, 3.0).iter().all(|a| a.agrees));
    }

    #[test]
    fn two_marks_check_nothing() {
        assert!(agreement(&frame(&[])[..2], Handedness::AsIs, 3.0).iter().all(|a| !a.agrees));
    }
}
