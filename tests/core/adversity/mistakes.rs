//! Mosaics, scales, rows and marks that are wrong.

use super::{Case, SIZE, list, run, seen, shifted, usual};
use autoref_raster::coords::PixelPoint;
use autoref_stream::matching::Priors;

#[test]
fn torn_mosaics_are_not_solved_wrong() {
    let score = run("torn: half of the marks shifted", 4, 10, |random| {
        let (marked, listed) = (6 + random.below(9), random.below(6));
        let usual = usual(random, marked, listed, 40);
        let (dx, dy) = (random.uniform(-120.0, 120.0), random.uniform(-120.0, 120.0));
        let torn: Vec<PixelPoint> =
            usual.marks().iter().map(|p| if p.x > SIZE.0 / 2.0 { shifted(p, dx, dy) } else { *p }).collect();
        let gcps = list(usual.listed.clone());
        let case = usual.case(random, gcps, &torn);
        // Either half may be taken for the truth, and a small tear is spread over all.
        Case { allowed_px: 5.0 + 1.5 * dx.hypot(dy), ..case }
    });
    assert_eq!(score.wrong, 0);
}

#[test]
fn wrong_scales_are_not_solved_wrong() {
    let score = run("scale given twice too large or too small", 12, 10, |random| {
        let usual = usual(random, 10, 5, 60);
        let gcps = list(usual.listed.clone());
        let marks = usual.marks();
        let case = usual.case(random, gcps, &marks);
        let factor = if random.below(2) == 0 { 2.0 } else { 0.5 };
        let gsd = case.priors.gsd_m_per_px.map(|(low, high)| (low * factor, high * factor));
        Case { truth: None, priors: Priors { gsd_m_per_px: gsd, ..case.priors.clone() }, ..case }
    });
    assert_eq!(score.wrong, 0);
}

#[test]
fn wrong_rows_among_right() {
    let score = run("coordinates exchanged, digits mistyped", 13, 10, |random| {
        let marked = 6 + random.below(6);
        let usual = usual(random, marked, 5, 60);
        let mut gcps = list(usual.listed.clone());
        for _ in 0..1 + random.below(3) {
            let (i, j) = (random.below(marked), random.below(marked));
            match random.below(3) {
                0 => (gcps[i].easting, gcps[j].easting) = (gcps[j].easting, gcps[i].easting),
                1 => gcps[i].northing += [0.3, 1.0, 10.0, 100.0][random.below(4)],
                _ => {
                    (gcps[i].easting, gcps[j].easting) = (gcps[j].easting, gcps[i].easting);
                    (gcps[i].northing, gcps[j].northing) = (gcps[j].northing, gcps[i].northing);
                }
            }
        }
        let marks = usual.marks();
        let case = usual.case(random, gcps, &marks);
        Case { allowed_px: 10.0, ..case }
    });
    assert_eq!(score.wrong, 0);
}

/// Two to four marks stand beside their points among six or more that stand on them: the sharp pattern is taken, not
/// the loose one of all.
#[test]
fn a_few_marks_beside_their_points() {
    for (what, seed, scale_known) in [("a few beside their points", 21, true), ("the same without a scale", 22, false)]
    {
        let score = run(what, seed, 40, |random| {
            let (exact, beside) = (6 + random.below(7), 2 + random.below(3));
            let beside = beside.min(exact - 4);
            let clutter = random.below(4);
            let usual = usual(random, exact, 22 - exact, clutter);
            let gcps = list(usual.listed.clone());
            let off: Vec<PixelPoint> = usual.points[exact..exact + beside]
                .iter()
                .map(|p| {
                    let (angle, by_px) = (random.uniform(0.0, std::f64::consts::TAU), random.uniform(6.0, 30.0));
                    shifted(p, by_px * angle.cos(), by_px * angle.sin())
                })
                .collect();
            let marks = usual.marks();
            let shown: Vec<PixelPoint> = marks.iter().chain(&off).copied().collect();
            let mut case = usual.case(random, gcps, &[]);
            case.candidates.extend(seen(random, &shown, 0.04));
            let gsd_m_per_px = case.priors.gsd_m_per_px.filter(|_| scale_known);
            Case { priors: Priors { gsd_m_per_px, ..case.priors.clone() }, allowed_px: 1.0, ..case }
        });
        assert_eq!((score.wrong, score.astray), (0, 0));
        assert!(score.right * 20 >= 19 * score.trials, "{score:?}");
    }
}
