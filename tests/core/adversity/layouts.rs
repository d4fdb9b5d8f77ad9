//! Points in bad places: on grids, on lines, in a corner.

use super::{Case, SIZE, list, near_grid, run, shifted, usual};
use autoref_raster::coords::PixelPoint;
use autoref_stream::matching::Priors;

#[test]
fn near_regular_lists() {
    for jitter in [0.0, 2.0, 10.0, 50.0] {
        let score = run(&format!("near-regular list, {jitter} px off"), 8, 10, |random| {
            let mut usual = usual(random, 0, 0, 30);
            usual.points = near_grid(random, jitter);
            usual.listed = usual.points.iter().map(|p| usual.truth.apply(*p)).collect();
            // Some marks are lost; sometimes the picture shows another part of the grid.
            let marked = usual.points.len() - random.below(usual.points.len() / 2);
            let order = random.order(usual.points.len());
            (usual.points, usual.listed) = order.iter().map(|&i| (usual.points[i], usual.listed[i])).unzip();
            usual.marked = marked;
            let gcps = list(usual.listed.clone());
            let marks = usual.marks();
            usual.case(random, gcps, &marks)
        });
        assert_eq!(score.wrong, 0);
    }
}

#[test]
fn points_nearly_on_a_line() {
    for off_line_px in [0.0, 5.0, 40.0] {
        for there in [true, false] {
            let what = format!("on a line, {off_line_px} px off, there {there}");
            let score = run(&what, 10, 10, |random| {
                let mut usual = usual(random, 0, 0, 60);
                usual.marked = 5 + random.below(6);
                // No two marks overlap.
                while usual.points.len() < usual.marked {
                    let x = random.uniform(300.0, SIZE.0 - 300.0);
                    if usual.points.iter().all(|p| (p.x - x).abs() > 30.0) {
                        usual.points.push(PixelPoint { x, y: 2000.0 + 0.2 * x + off_line_px * random.normal() });
                    }
                }
                usual.listed = usual.points.iter().map(|p| usual.truth.apply(*p)).collect();
                let gcps = list(usual.listed.clone());
                if there {
                    let marks = usual.marks();
                    usual.case(random, gcps, &marks)
                } else {
                    // A row of clutter along a line, too.
                    let row: Vec<PixelPoint> = (0..60)
                        .map(|_| PixelPoint {
                            x: random.uniform(0.0, SIZE.0),
                            y: 3100.0 + off_line_px * random.normal(),
                        })
                        .collect();
                    Case { truth: None, ..usual.case(random, gcps, &row) }
                }
            });
            assert_eq!(score.wrong, 0);
        }
    }
}

/// Six of twenty points close together in a corner, all detected, the other fourteen in the image and unmarked.
#[test]
fn six_of_twenty_in_a_corner() {
    for (what, seed, scale_known) in [("six of 20 in a corner", 18, true), ("the same without a scale", 19, false)] {
        let score = run(what, seed, 10, |random| {
            let clutter = 15 + random.below(286);
            let mut usual = usual(random, 6, 14, clutter);
            let (left, top) = (random.below(2) as f64, random.below(2) as f64);
            let reach = random.uniform(0.08, 0.2);
            for point in &mut usual.points[..6] {
                let (u, v) = (random.uniform(0.02, reach), random.uniform(0.02, reach));
                *point = PixelPoint { x: SIZE.0 * (left - u).abs(), y: SIZE.1 * (top - v).abs() };
            }
            usual.listed = usual.points.iter().map(|p| usual.truth.apply(*p)).collect();
            let gcps = list(usual.listed.clone());
            let marks = usual.marks();
            let mut case = usual.case(random, gcps, &marks);
            // Marks of a good image: a tenth of a pixel.
            for candidate in &mut case.candidates {
                let apart = |p: &&PixelPoint| (p.x - candidate.centre.x).hypot(p.y - candidate.centre.y);
                if let Some(mark) = marks.iter().find(|p| apart(p) < 4.0) {
                    candidate.centre = shifted(mark, 0.1 * random.normal(), 0.1 * random.normal());
                }
            }
            let gsd_m_per_px = case.priors.gsd_m_per_px.filter(|_| scale_known);
            Case { priors: Priors { gsd_m_per_px, ..case.priors.clone() }, allowed_px: 3.0, ..case }
        });
        assert_eq!((score.wrong, score.astray), (0, 0));
        assert!(score.right * 50 >= 49 * score.trials, "{score:?}");
    }
}
