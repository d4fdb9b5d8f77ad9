//! Do the marks agree? Each is compared with where the others put it; what does not fit is never passed as good.

use super::interior::{
    MOST_DEFORMED, MOST_STRETCH, Stretch, affine, distance, fit_own_stretch, fit_pose, fit_stretched,
};
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

/// Compares marks `(film mm, place)` with each other; `tolerance_px` is how far a mark may lie from where the others
/// put it.
///
/// With four or more, marks are left out one at a time, the worst first, until the rest agree; with three left nothing
/// more can be left out, since two always agree. Where leaving out either of two marks would make the rest agree,
/// nobody can tell which is wrong, and none is passed.
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
                (3, false) if fit_own_stretch(points, mirrored).is_some() => {
                    "three marks check nothing where the scan's axes may differ in scale".to_owned()
                }
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

/// Where `others` put the film point `mm`. Three or more say it by an affine transform, since film and scanners shear
/// and shrink by a tenth of a per cent (the public Wild frame: 0.13 mm at the corners, by hand as by this program), and
/// the axes of scanners in archives differ by two per cent; two by a similarity.
fn predict(others: &[([f64; 2], PixelPoint)], mm: [f64; 2], mirrored: Handedness) -> Option<PixelPoint> {
    let pose = fit_pose(others, mirrored)?;
    let similar = pose.apply(mm);
    let Some([x, y]) = affine(others) else { return Some(similar) };
    let at = PixelPoint { x: x[0] * mm[0] + x[1] * mm[1] + x[2], y: y[0] * mm[0] + y[1] * mm[1] + y[2] };
    // What is neither stretch of an axis nor a small deformation is no film: the similarity's answer, which then
    // contradicts somebody.
    let stretch = Stretch::of_rows([[x[0], x[1]], [y[0], y[1]]]);
    let stretched = fit_stretched(others, mirrored, stretch).filter(|_| stretch.0.abs() <= MOST_STRETCH);
    let size = others.iter().map(|o| (o.0[0] - mm[0]).hypot(o.0[1] - mm[1])).fold(0.0, f64::max);
    let film = stretched.is_some_and(|p| distance(at, p.apply(mm)) < MOST_DEFORMED * size * pose.px_per_mm());
    Some(if film { at } else { similar })
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
    fn axes_that_differ_in_scale_are_no_error_and_hide_none() {
        for percent in [-3.0, 0.5, 2.3, 3.0] {
            let scanned = |errors: &[(usize, f64, f64)]| {
                let mut points = frame(errors);
                points.iter_mut().for_each(|(_, p)| p.x *= 1.0 + percent / 100.0);
                points
            };
            assert!(agreement(&scanned(&[]), Handedness::AsIs, 1.5).iter().all(|a| a.agrees), "{percent} %");
            for k in 0..4 {
                let found = agreement(&scanned(&[(k, 4.0, 4.0)]), Handedness::AsIs, 1.5);
                assert!(!found[k].agrees, "{percent} %, mark {k}: {found:?}");
            }
        }
        let mut beyond = frame(&[]);
        beyond.iter_mut().for_each(|(_, p)| p.x *= 1.05);
        assert!(agreement(&beyond, Handedness::AsIs, 1.5).iter().all(|a| !a.agrees), "5 % is no scanner");
    }

    #[test]
    fn two_marks_check_nothing() {
        assert!(agreement(&frame(&[])[..2], Handedness::AsIs, 3.0).iter().all(|a| !a.agrees));
    }
}
