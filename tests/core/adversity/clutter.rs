//! False candidates in rows, grids and clusters, with marks and without.

use super::{Case, SIZE, list, near_grid, run, shifted, systematic, usual};
use autoref_raster::coords::PixelPoint;
use autoref_stream::matching::Priors;

#[test]
fn systematic_clutter() {
    let score = run("systematic clutter, nothing there", 5, 10, |random| {
        let usual = usual(random, 5, 10, 10);
        let clutter = systematic(random);
        let gcps = list(usual.listed.clone());
        Case { truth: None, ..usual.case(random, gcps, &clutter) }
    });
    assert_eq!(score.wrong, 0);
    let score = run("systematic clutter, near-regular list, nothing there", 6, 10, |random| {
        let mut usual = usual(random, 0, 0, 10);
        let jitter = [0.0, 2.0, 10.0, 50.0][random.below(4)];
        let grid = near_grid(random, jitter);
        usual.listed = grid.iter().map(|p| usual.truth.apply(*p)).collect();
        let clutter = systematic(random);
        let gcps = list(usual.listed.clone());
        Case { truth: None, ..usual.case(random, gcps, &clutter) }
    });
    assert_eq!(score.wrong, 0);
    let score = run("systematic clutter about true marks", 7, 10, |random| {
        let marked = 6 + random.below(6);
        let usual = usual(random, marked, 4, 10);
        let mut shown = usual.marks();
        shown.extend(systematic(random));
        let gcps = list(usual.listed.clone());
        usual.case(random, gcps, &shown)
    });
    assert_eq!(score.wrong, 0);
}

#[test]
fn clusters_about_true_marks() {
    for (reach, near) in [(8.0, 3), (25.0, 6), (60.0, 12)] {
        let score = run(&format!("{near} false candidates within {reach} px of every mark"), 9, 10, |random| {
            let usual = usual(random, 7, 5, 40);
            let mut shown = usual.marks();
            for mark in usual.marks() {
                shown.extend((0..near).map(|_| {
                    let (angle, r) = (random.uniform(0.0, 6.3), reach * random.uniform(0.2, 1.0));
                    shifted(&mark, r * angle.cos(), r * angle.sin())
                }));
            }
            let gcps = list(usual.listed.clone());
            let case = usual.case(random, gcps, &shown);
            Case { allowed_px: 5.0 + reach / 2.0, ..case }
        });
        assert_eq!(score.wrong, 0);
    }
}

#[test]
fn without_priors() {
    let none = Priors { gsd_m_per_px: None, rotation_deg: None, image_size_px: Some(SIZE) };
    let score = run("no prior, mirrored", 14, 4, |random| {
        let usual = usual(random, 9, 3, 30);
        let mirrored: Vec<PixelPoint> = usual.marks().iter().map(|p| PixelPoint { x: SIZE.0 - p.x, y: p.y }).collect();
        let gcps = list(usual.listed.clone());
        Case { truth: None, priors: none.clone(), ..usual.case(random, gcps, &mirrored) }
    });
    assert_eq!(score.wrong, 0);
    let score = run("no prior, systematic clutter", 15, 4, |random| {
        let usual = usual(random, 5, 10, 10);
        let clutter = systematic(random);
        let clutter = &clutter[..clutter.len().min(150)];
        let gcps = list(usual.listed.clone());
        Case { truth: None, priors: none.clone(), ..usual.case(random, gcps, clutter) }
    });
    assert_eq!(score.wrong, 0);
    let score = run("no prior, near-regular list and clutter", 16, 4, |random| {
        let mut usual = usual(random, 0, 0, 10);
        let jitter = [0.0, 2.0, 10.0, 50.0][random.below(4)];
        let grid = near_grid(random, jitter);
        usual.listed = grid.iter().map(|p| usual.truth.apply(*p)).collect();
        let clutter = systematic(random);
        let clutter = &clutter[..clutter.len().min(150)];
        let gcps = list(usual.listed.clone());
        Case { truth: None, priors: none.clone(), ..usual.case(random, gcps, clutter) }
    });
    assert_eq!(score.wrong, 0);
}
