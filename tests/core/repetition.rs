//! Figures that repeat, in the list or in the image: nothing in the picture says which is which, so nothing may be
//! claimed.

use crate::common::{Random, bare_candidate, turned};
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::Gcp;
use autoref_stream::matching::{Evidence, MatchOutcome, Matcher, OfImage, Priors, RobustMatcher};

const SIZE: (f64, f64) = (8000.0, 6000.0);
const GSD: f64 = 0.03;

fn figure(random: &mut Random, points: usize) -> Vec<PixelPoint> {
    (0..points).map(|_| PixelPoint { x: random.uniform(800.0, 3200.0), y: random.uniform(800.0, 5200.0) }).collect()
}

fn list(points: impl IntoIterator<Item = MapPoint>) -> Vec<Gcp> {
    points.into_iter().enumerate().map(|(i, m)| Gcp::control(format!("P{i}"), m.easting, m.northing)).collect()
}

fn marks(random: &mut Random, points: &[PixelPoint], clutter: usize) -> Vec<Candidate> {
    let mut all: Vec<Candidate> =
        points.iter().map(|p| bare_candidate(p.x + 0.5 * random.normal(), p.y + 0.5 * random.normal())).collect();
    all.extend((0..clutter).map(|_| bare_candidate(random.uniform(0.0, SIZE.0), random.uniform(0.0, SIZE.1))));
    all
}

fn find(candidates: &[Candidate], gcps: &[Gcp]) -> MatchOutcome {
    let priors = Priors { gsd_m_per_px: Some((0.9 * GSD, 1.1 * GSD)), rotation_deg: None, image_size_px: Some(SIZE) };
    RobustMatcher::default().find(candidates, gcps, &priors)
}

#[track_caller]
fn refused(what: &str, outcome: MatchOutcome) -> Box<Evidence> {
    match outcome {
        MatchOutcome::NoMatch(evidence) => evidence,
        MatchOutcome::Solved(solved) => panic!("{what}: believed {:?}, rival {:?}", solved.pattern, solved.runner_up),
    }
}

#[track_caller]
fn repeats(what: &str, outcome: MatchOutcome) {
    let evidence = refused(what, outcome);
    assert!(evidence.reason.contains("another one is almost as good"), "{what}: {}", evidence.reason);
    assert!(evidence.advice.iter().any(|line| line.contains("repeats")), "{what}: {:?}", evidence.advice);
}

/// The image shows one of two places that look the same in the list, and other GCPs that were not marked.
#[test]
fn a_figure_that_the_list_holds_twice() {
    let mut random = Random::new(41);
    for trial in 0..20 {
        let truth = turned(&mut random, GSD);
        let figure = figure(&mut random, 6);
        let placed: Vec<MapPoint> = figure.iter().map(|p| truth.apply(*p)).collect();
        // Far enough away that the image never shows both.
        let again = placed.iter().map(|m| MapPoint { easting: m.easting + 700.0, northing: m.northing - 400.0 });
        let others = (0..10).map(|_| MapPoint {
            easting: 569_000.0 + random.uniform(-900.0, 900.0),
            northing: 7_032_000.0 + random.uniform(-900.0, 900.0),
        });
        let gcps = list(placed.iter().copied().chain(again).chain(others.collect::<Vec<_>>()));
        let candidates = marks(&mut random, &figure, 40);
        repeats(&format!("trial {trial}"), find(&candidates, &gcps));
    }
}

#[test]
fn a_figure_that_the_image_shows_twice() {
    let mut random = Random::new(43);
    for trial in 0..20 {
        let truth = turned(&mut random, GSD);
        let figure = figure(&mut random, 7);
        let gcps = list(figure.iter().map(|p| truth.apply(*p)));
        let moved = figure.iter().map(|p| PixelPoint { x: p.x + 3600.0, y: p.y + 300.0 });
        let moved: Vec<PixelPoint> = moved.collect();
        // Each copy lacks another mark; then one of them has all: marks are overlooked every day.
        for first in [1, 0] {
            let seen: Vec<PixelPoint> = figure[first..].iter().chain(&moved[..6]).copied().collect();
            let candidates = marks(&mut random, &seen, 40);
            repeats(&format!("trial {trial}, {} and 6 marks", 7 - first), find(&candidates, &gcps));
        }
    }
}

/// Both surveys of a list lie within a mark's place of each other: neither speaks for the other's places.
#[test]
fn points_that_are_listed_twice_are_named() {
    let mut random = Random::new(46);
    for trial in 0..10 {
        let truth = turned(&mut random, GSD);
        let figure = figure(&mut random, 12);
        let placed: Vec<MapPoint> = figure.iter().map(|p| truth.apply(*p)).collect();
        let again = placed.iter().map(|m| MapPoint { easting: m.easting + 0.3, northing: m.northing });
        let gcps = match trial % 2 {
            0 => list(placed.iter().copied().chain(again)),
            _ => list(again.chain(placed.iter().copied())),
        };
        let evidence = refused("listed twice", find(&marks(&mut random, &figure, 3), &gcps));
        let best = evidence.best.expect("either survey");
        assert!(best.log10_false_alarms < -10.0, "trial {trial}: {}", evidence.reason);
        let advice = &evidence.advice[0];
        assert!(
            advice.contains("stand twice") && ["`P0`", "`P12`"].iter().all(|name| advice.contains(name)),
            "trial {trial}: {advice}"
        );
        assert!(advice.contains("0.30 m apart"), "{advice}");
    }
}

/// Of a grid neither the scale nor a list of the points in the image tells anything.
#[test]
fn of_a_grid_only_what_helps_is_named() {
    let mut random = Random::new(48);
    let truth = turned(&mut random, GSD);
    let grid: Vec<PixelPoint> = (0..16)
        .map(|i| PixelPoint { x: 1500.0 + 1200.0 * f64::from(i % 4), y: 700.0 + 1200.0 * f64::from(i / 4) })
        .collect();
    let gcps = list(grid.iter().map(|p| truth.apply(*p)));
    let seen = marks(&mut random, &grid[..12], 0);
    let rotation_deg = Some((truth.rotation_deg(), 15.0));
    let priors = Priors { gsd_m_per_px: None, rotation_deg, image_size_px: Some((8000.0, 4500.0)) };
    let outcome = RobustMatcher::default().find(&seen, &gcps, &priors);
    repeats("grid", outcome.clone());
    let advice = refused("grid", outcome).advice.join("\n");
    assert!(advice.contains("`plan`") && !advice.contains("--gsd") && !advice.contains("--names"), "{advice}");
    assert!(!advice.contains("--north-up"), "{advice}");
    // What the image says of itself is taken loosely: a figure of the user's helps there too.
    let of_image = OfImage { scale: true, north: true };
    let matcher = RobustMatcher { of_image, ..RobustMatcher::default() };
    let elsewhere = list(figure(&mut random, 12).iter().map(|p| truth.apply(*p)));
    let open = Priors { image_size_px: Some(SIZE), ..Priors::default() };
    let said = |matcher: RobustMatcher| {
        let outcome = matcher.find(&seen, &elsewhere, &open);
        refused("other points", outcome).advice.join("\n")
    };
    assert!(said(RobustMatcher::default()).contains("--gsd"));
    assert!(said(matcher).contains("--gsd; the image's own is taken loosely"));
}

#[test]
fn symmetric_layouts() {
    let mut random = Random::new(44);
    let centre = PixelPoint { x: 4000.0, y: 3000.0 };
    let ring = |n: usize| -> Vec<PixelPoint> {
        let at = |i: usize| 0.3 + std::f64::consts::TAU * i as f64 / n as f64;
        (0..n).map(|i| PixelPoint { x: centre.x + 2000.0 * at(i).cos(), y: centre.y + 2000.0 * at(i).sin() }).collect()
    };
    let line: Vec<PixelPoint> = (0..6).map(|i| PixelPoint { x: 1000.0 + 1100.0 * f64::from(i), y: 2500.0 }).collect();
    let grid: Vec<PixelPoint> = (0..12)
        .map(|i| PixelPoint { x: 1500.0 + 1200.0 * f64::from(i % 4), y: 1500.0 + 1200.0 * f64::from(i / 4) })
        .collect();
    for (what, layout) in [
        ("triangle", ring(3)),
        ("square", ring(4)),
        ("hexagon", ring(6)),
        ("ring of twelve", ring(12)),
        ("line", line),
        ("grid", grid),
    ] {
        for clutter in [0, 30] {
            let truth = turned(&mut random, GSD);
            let gcps = list(layout.iter().map(|p| truth.apply(*p)));
            let candidates = marks(&mut random, &layout, clutter);
            refused(&format!("{what} with {clutter} false"), find(&candidates, &gcps));
        }
    }
}

/// Points surveyed twice, marks found twice: the second is no witness.
#[test]
fn duplicates_are_no_evidence() {
    let mut random = Random::new(45);
    let doubled = |gcps: &[Gcp], by: f64| -> Vec<Gcp> {
        list(
            gcps.iter()
                .flat_map(|g| [0.0, by].map(|d| MapPoint { easting: g.easting + d, northing: g.northing - 0.3 * d })),
        )
    };
    let trials = if crate::common::large() { 1000 } else { 60 };
    for trial in 0..trials {
        // Three points a centimetre to half a metre apart from themselves, and clutter in twos: no pattern.
        let by = [0.01, 0.03, 0.1, 0.5][trial % 4];
        let truth = turned(&mut random, GSD);
        let unrelated = figure(&mut random, 8);
        let gcps = doubled(&list(unrelated.iter().map(|p| truth.apply(*p))), by);
        let clutter: Vec<PixelPoint> = (0..60)
            .map(|_| PixelPoint { x: random.uniform(0.0, SIZE.0), y: random.uniform(0.0, SIZE.1) })
            .flat_map(|p| [p, PixelPoint { x: p.x + by / GSD, y: p.y + 2.0 }])
            .collect();
        let candidates = marks(&mut random, &clutter, 0);
        refused(&format!("trial {trial}, {by} m apart"), find(&candidates, &gcps));
    }
}

/// Two rows along a road, a few decimetres irregular: moved on by a place they lie on most of their marks again, to
/// those decimetres; in their place they do to the centring of the marks.
#[test]
fn nearly_regular_rows_are_told_by_how_closely_they_fit() {
    let mut random = Random::new(47);
    let mut solved = 0;
    for trial in 0..20 {
        let irregular_px = [3.0, 7.0, 10.0, 17.0][trial % 4];
        let rows: Vec<PixelPoint> = (0..16)
            .map(|i| PixelPoint {
                x: 800.0 + 800.0 * f64::from(i / 2) + irregular_px * random.normal(),
                y: 2500.0 + 260.0 * f64::from(i % 2) + irregular_px * random.normal(),
            })
            .collect();
        let truth = turned(&mut random, GSD);
        let gcps = list(rows.iter().map(|p| truth.apply(*p)));
        if let MatchOutcome::Solved(found) = find(&marks(&mut random, &rows, 10), &gcps) {
            solved += 1;
            // The marks come first among the candidates, in the order of the list.
            assert!(found.pattern.pairs.iter().all(|(mark, gcp)| mark == gcp), "trial {trial}: {:?}", found.pattern);
        }
    }
    assert!(solved >= 18, "{solved} of 20");
}

/// Eight marks, twenty other candidates, one coordinate 0.2 m wrong. A pattern of four has two of the marks where they
/// are; as a base these two find the other six, which speaks for the eight alone.
#[test]
fn marks_of_the_best_pattern_do_not_speak_for_a_rival() {
    let marks = [
        (2048.3, 1786.7),
        (2452.5, 1783.1),
        (2822.5, 943.6),
        (652.2, 2059.7),
        (483.0, 760.2),
        (444.1, 1631.9),
        (1537.0, 1259.1),
        (2490.9, 2010.2),
    ];
    let others = [
        (1061.1, 211.6),
        (1945.7, 142.4),
        (39.1, 43.7),
        (2645.5, 931.7),
        (1525.9, 714.1),
        (2371.5, 1169.5),
        (517.8, 658.5),
        (2128.7, 1741.6),
        (132.9, 1377.0),
        (578.6, 733.1),
        (749.6, 940.0),
        (2499.7, 750.2),
        (832.6, 1006.6),
        (1559.4, 1208.3),
        (2024.5, 1504.4),
        (813.1, 1902.1),
        (1901.1, 613.8),
        (206.0, 1796.8),
        (557.9, 1075.9),
        (1570.8, 1021.6),
    ];
    let points = [
        (26.32, 34.93),
        (14.67, 31.52),
        (10.83, 4.26),
        (64.40, 54.16),
        (79.86, 18.03),
        (73.77, 43.35),
        (45.37, 23.83),
        (11.71, 37.76),
    ];
    let candidates: Vec<Candidate> = marks.iter().chain(&others).map(|(x, y)| bare_candidate(*x, *y)).collect();
    let gcps = list(points.map(|(easting, northing)| MapPoint { easting, northing }));
    let priors = Priors { image_size_px: Some((3000.0, 2200.0)), ..Priors::default() };
    let MatchOutcome::Solved(solved) = RobustMatcher::default().find(&candidates, &gcps, &priors) else {
        panic!("eight of eight were refused")
    };
    assert_eq!(solved.pattern.pairs, (0..8).map(|i| (i, i)).collect::<Vec<_>>());
}
