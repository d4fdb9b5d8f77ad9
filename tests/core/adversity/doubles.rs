//! What is there twice: points of the list, pieces of marks, marks of two flights, a figure of a long list.

use super::{Case, GSD, SIZE, list, run, shifted, usual};
use crate::common::{Random, turned};
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_stream::gcp::Gcp;
use autoref_stream::matching::Priors;

/// Each point twice, `by` metres apart: the same way, or every one in its own.
fn doubled(random: &mut Random, listed: &[MapPoint], by: f64, same_way: bool) -> Vec<Gcp> {
    let common = random.uniform(0.0, std::f64::consts::TAU);
    list(listed.iter().flat_map(|m| {
        let own = random.uniform(0.0, std::f64::consts::TAU);
        let angle = if same_way { common } else { own };
        [*m, MapPoint { easting: m.easting + by * angle.cos(), northing: m.northing + by * angle.sin() }]
    }))
}

#[test]
fn points_listed_twice() {
    for (by, allowed_px) in [(0.01, 5.0), (0.03, 5.0), (0.1, 6.0), (0.3, 5.0), (0.5, 5.0)] {
        for same_way in [false, true] {
            let score = run(&format!("all twice, {by} m, same way {same_way}"), 1, 3, |random| {
                let (marked, unmarked) = (6 + random.below(4), random.below(6));
                let usual = usual(random, marked, unmarked, 40);
                let gcps = doubled(random, &usual.listed, by, same_way);
                let marks = usual.marks();
                Case { allowed_px, ..usual.case(random, gcps, &marks) }
            });
            assert_eq!(score.wrong, 0);
            // Two complete surveys that lie farther apart than marks may be off: either may be the right one.
            let either = same_way && by / GSD > 5.0;
            assert!(either || score.right * 20 >= 19 * score.trials, "{score:?}");
        }
        // Nothing of them in the image, and clutter in twos.
        let score = run(&format!("all twice, {by} m, nothing there"), 2, 3, |random| {
            let n = 5 + random.below(10);
            let usual = usual(random, n, 0, 60);
            let gcps = doubled(random, &usual.listed, by, true);
            // Exactly as far apart as the points, and in their direction.
            let (p, q) = (usual.truth.invert(gcps[0].position()), usual.truth.invert(gcps[1].position()));
            let twos: Vec<PixelPoint> = usual.clutter.iter().map(|c| shifted(c, q.x - p.x, q.y - p.y)).collect();
            Case { truth: None, ..usual.case(random, gcps, &twos[..]) }
        });
        assert_eq!(score.wrong, 0);
    }
}

/// All marks in one part of the image: what is mixed up among them is worse at the corners.
#[test]
fn points_listed_twice_far_from_the_corners() {
    for by in [0.03, 0.1, 0.2] {
        for same_way in [false, true] {
            let score = run(&format!("all twice in a corner, {by} m, same way {same_way}"), 17, 6, |random| {
                let mut usual = usual(random, 8, 0, 40);
                let at = |random: &mut Random| PixelPoint {
                    x: random.uniform(800.0, 3200.0),
                    y: random.uniform(800.0, 5200.0),
                };
                usual.points = (0..8).map(|_| at(random)).collect();
                usual.listed = usual.points.iter().map(|p| usual.truth.apply(*p)).collect();
                let gcps = doubled(random, &usual.listed, by, same_way);
                let shown = usual.marks();
                let mut case = usual.case(random, gcps, &shown);
                case.marks.extend([(0.0, 0.0), SIZE, (SIZE.0, 0.0), (0.0, SIZE.1)].map(|(x, y)| PixelPoint { x, y }));
                Case { allowed_px: 8.0, ..case }
            });
            assert_eq!(score.wrong, 0);
            assert!(by > 0.1 || score.right * 20 >= 19 * score.trials, "{score:?}");
        }
    }
}

#[test]
fn marks_found_in_pieces() {
    for apart_px in [4.0, 10.0, 20.0, 30.0] {
        for same_way in [false, true] {
            let score = run(&format!("pieces {apart_px} px apart, same way {same_way}"), 3, 6, |random| {
                let usual = usual(random, 8, 3, 40);
                let gcps = list(usual.listed.clone());
                let common = random.uniform(0.0, std::f64::consts::TAU);
                let pieces: Vec<PixelPoint> = usual
                    .marks()
                    .iter()
                    .flat_map(|p| {
                        let angle = if same_way { common } else { random.uniform(0.0, std::f64::consts::TAU) };
                        let (dx, dy) = (apart_px / 2.0 * angle.cos(), apart_px / 2.0 * angle.sin());
                        [shifted(p, dx, dy), shifted(p, -dx, -dy)]
                    })
                    .collect();
                let case = usual.case(random, gcps, &pieces);
                // Half the distance off at every mark: all the same way, which no matcher can know, or five sigma.
                let allowed_px =
                    if same_way { 5.0 + apart_px / 2.0 } else { 5.0 * (apart_px / 2.0 / 2f64.sqrt()).max(1.0) };
                let mut case = Case { allowed_px, ..case };
                for candidate in &mut case.candidates {
                    candidate.size_px = Some([0.8 * apart_px; 2]);
                }
                case
            });
            assert_eq!(score.wrong, 0);
            assert!(score.right * 20 >= 19 * score.trials, "{score:?}");
        }
    }
}

#[test]
fn marks_of_two_flights() {
    for apart_px in [3.0, 12.0, 60.0, 600.0] {
        let score = run(&format!("old and new marks {apart_px} px apart"), 11, 10, |random| {
            let usual = usual(random, 8, 4, 40);
            let angle = random.uniform(0.0, 6.3);
            let mut shown = usual.marks();
            let old = usual.marks();
            let kept = 4 + random.below(5);
            shown.extend(old[..kept].iter().map(|p| shifted(p, apart_px * angle.cos(), apart_px * angle.sin())));
            let gcps = list(usual.listed.clone());
            let case = usual.case(random, gcps, &shown);
            // So close together nothing tells old from new.
            Case { allowed_px: if apart_px < 20.0 { 5.0 + apart_px } else { 5.0 }, ..case }
        });
        assert_eq!(score.wrong, 0);
    }
}

/// A list of 120 points and more in which a figure of the image stands a second time, elsewhere and turned: of most of
/// its points it is refused, of few it is solved.
#[test]
fn a_figure_twice_in_a_long_list() {
    let repeated = |share: f64| {
        move |random: &mut Random| {
            let marked = 60 + random.below(60);
            let mut usual = usual(random, marked, 60, 20);
            let elsewhere = turned(random, GSD);
            let again = (share * marked as f64) as usize;
            usual.listed.extend(usual.points[..again].iter().map(|p| {
                let m = elsewhere.apply(*p);
                MapPoint { easting: m.easting + 900.0, northing: m.northing - 700.0 }
            }));
            let gcps = list(usual.listed.clone());
            let marks = usual.marks();
            let case = usual.case(random, gcps, &marks);
            let gsd_m_per_px = case.priors.gsd_m_per_px.filter(|_| random.below(2) == 0);
            Case { priors: Priors { gsd_m_per_px, ..case.priors.clone() }, ..case }
        }
    };
    let most = run("60 % of a long list's figure twice", 23, 2, repeated(0.6));
    assert_eq!((most.right, most.wrong), (0, 0));
    let few = run("20 % of a long list's figure twice", 24, 2, repeated(0.2));
    assert_eq!((few.wrong, few.refused), (0, 0));
}
