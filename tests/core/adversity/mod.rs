//! Lists and images made to mislead: every one may be refused, none may be solved wrong, and where all marks are there
//! most must be solved. `AUTOREF_LARGE=1` runs a thousand of each kind (`AUTOREF_TRIALS` says another number).

use std::time::Instant;

use crate::common::{Random, bare_candidate, turned};
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_solve::{Pair, Similarity, solve};
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::Gcp;
use autoref_stream::matching::{MatchOutcome, Matcher, Priors, RobustMatcher};

const SIZE: (f64, f64) = (8000.0, 6000.0);
const GSD: f64 = 0.03;

struct Case {
    gcps: Vec<Gcp>,
    candidates: Vec<Candidate>,
    /// Where the ground is, when the image shows any of it.
    truth: Option<Similarity>,
    /// Image positions of true marks.
    marks: Vec<PixelPoint>,
    priors: Priors,
    /// Error at a mark that is still right, pixels.
    allowed_px: f64,
}

fn priors(share: f64) -> Priors {
    let gsd_m_per_px = Some((GSD * (1.0 - share), GSD * (1.0 + share)));
    Priors { gsd_m_per_px, rotation_deg: None, image_size_px: Some(SIZE) }
}

fn anywhere(random: &mut Random, n: usize) -> Vec<PixelPoint> {
    (0..n).map(|_| PixelPoint { x: random.uniform(0.0, SIZE.0), y: random.uniform(0.0, SIZE.1) }).collect()
}

fn shifted(p: &PixelPoint, dx: f64, dy: f64) -> PixelPoint {
    PixelPoint { x: p.x + dx, y: p.y + dy }
}

fn list(points: impl IntoIterator<Item = MapPoint>) -> Vec<Gcp> {
    points.into_iter().enumerate().map(|(i, m)| Gcp::control(format!("P{i}"), m.easting, m.northing)).collect()
}

/// In a random order, `sigma_px` off; what lies outside the image is not seen.
fn seen(random: &mut Random, points: &[PixelPoint], sigma_px: f64) -> Vec<Candidate> {
    let order = random.order(points.len());
    order
        .into_iter()
        .map(|i| bare_candidate(points[i].x + sigma_px * random.normal(), points[i].y + sigma_px * random.normal()))
        .filter(|c| c.centre.x >= 0.0 && c.centre.y >= 0.0 && c.centre.x < SIZE.0 && c.centre.y < SIZE.1)
        .collect()
}

/// A usual case, to be spoilt: `marked` marks among `listed` GCPs, and clutter.
struct Usual {
    truth: Similarity,
    points: Vec<PixelPoint>,
    listed: Vec<MapPoint>,
    marked: usize,
    clutter: Vec<PixelPoint>,
}

fn usual(random: &mut Random, marked: usize, unmarked: usize, clutter: usize) -> Usual {
    let truth = turned(random, GSD);
    let points = anywhere(random, marked + unmarked);
    let listed = points.iter().map(|p| truth.apply(*p)).collect();
    Usual { truth, points, listed, marked, clutter: anywhere(random, clutter) }
}

impl Usual {
    fn marks(&self) -> Vec<PixelPoint> {
        self.points[..self.marked].to_vec()
    }

    fn case(self, random: &mut Random, gcps: Vec<Gcp>, shown: &[PixelPoint]) -> Case {
        let mut all = shown.to_vec();
        all.extend(&self.clutter);
        let order = random.order(gcps.len());
        Case {
            gcps: order.into_iter().map(|i| gcps[i].clone()).collect(),
            candidates: seen(random, &all, 0.5),
            marks: self.marks(),
            truth: Some(self.truth),
            priors: priors(0.1),
            allowed_px: 5.0,
        }
    }
}

#[derive(Default, Debug)]
struct Score {
    trials: usize,
    right: usize,
    refused: usize,
    wrong: usize,
    /// More than 25 px and more than five stated deviations off in a corner of the image.
    astray: usize,
    mean_s: f64,
    slowest_s: f64,
}

fn run(what: &str, seed: u64, few: usize, make: impl Fn(&mut Random) -> Case) -> Score {
    let count = crate::common::trials(few, 1000);
    let mut score = Score { trials: count, ..Score::default() };
    for trial in 0..count {
        let mut random = Random::new(seed.wrapping_mul(1_000_003).wrapping_add(trial as u64));
        let case = make(&mut random);
        let started = Instant::now();
        let outcome = RobustMatcher::default().find(&case.candidates, &case.gcps, &case.priors);
        let elapsed = started.elapsed().as_secs_f64();
        score.mean_s += elapsed / count as f64;
        score.slowest_s = score.slowest_s.max(elapsed);
        let solved = match outcome {
            MatchOutcome::Solved(solved) => solved,
            MatchOutcome::NoMatch(evidence) => {
                score.refused += 1;
                if std::env::var_os("AUTOREF_REASONS").is_some() {
                    println!("{what} {trial}: {}; {:?}", evidence.reason, evidence.best);
                    println!("    rival {:?}", evidence.runner_up);
                }
                continue;
            }
        };
        let pairs: Vec<Pair> = solved
            .pattern
            .pairs
            .iter()
            .map(|&(c, g)| Pair {
                pixel: case.candidates[c].centre,
                covariance_px2: None,
                map: case.gcps[g].position(),
                survey_sigma_m: None,
            })
            .collect();
        let solution = solve(&pairs).expect("a pattern can be solved");
        let fitted = solution.similarity;
        let worst = case.truth.map_or(f64::INFINITY, |truth| {
            let off = |p: &PixelPoint| {
                let (m, t) = (fitted.apply(*p), truth.apply(*p));
                (m.easting - t.easting).hypot(m.northing - t.northing) / GSD
            };
            case.marks.iter().map(off).fold(0.0, f64::max)
        });
        // In the image's corners a pattern may be far off when it says so.
        let astray = case.truth.is_some_and(|truth| {
            [(0.0, 0.0), SIZE, (SIZE.0, 0.0), (0.0, SIZE.1)].into_iter().any(|(x, y)| {
                let p = PixelPoint { x, y };
                let (m, t) = (fitted.apply(p), truth.apply(p));
                let off_m = (m.easting - t.easting).hypot(m.northing - t.northing);
                off_m > 25.0 * GSD && off_m > 5.0 * solution.sigma_at_m(p)
            })
        });
        score.astray += usize::from(astray);
        if worst <= case.allowed_px {
            score.right += 1;
        } else {
            score.wrong += 1;
        }
        if worst > case.allowed_px {
            println!(
                "{what} {trial}: wrong by {worst:.1} px, in the corners {astray}, {:?}, rival {:?}",
                solved.pattern, solved.runner_up
            );
            for (i, p) in case.marks.iter().enumerate() {
                let off = |c: &Candidate| (c.centre.x - p.x).hypot(c.centre.y - p.y);
                let nearest = (0..case.candidates.len())
                    .min_by(|&a, &b| off(&case.candidates[a]).total_cmp(&off(&case.candidates[b])));
                println!(
                    "    mark {i} at {:.0} {:.0}: candidate {nearest:?}, {:.1} px",
                    p.x,
                    p.y,
                    nearest.map_or(0.0, |c| off(&case.candidates[c]))
                );
            }
        }
    }
    println!("{what}: {score:.3?}");
    score
}

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
            let score = run(&format!("all twice, {by} m, same way {same_way}"), 1, 6, |random| {
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
        let score = run(&format!("all twice, {by} m, nothing there"), 2, 6, |random| {
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
fn torn_mosaics() {
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

/// Rows, grids with jitter, clumps: shapes that clutter takes.
fn systematic(random: &mut Random) -> Vec<PixelPoint> {
    let jitter = [0.0, 0.5, 2.0, 6.0][random.below(4)];
    let angle = random.uniform(0.0, 6.3);
    let (dx, dy) = (random.uniform(60.0, 700.0), random.uniform(60.0, 700.0));
    let turned = |x: f64, y: f64| PixelPoint {
        x: SIZE.0 / 2.0 + x * angle.cos() - y * angle.sin(),
        y: SIZE.1 / 2.0 + x * angle.sin() + y * angle.cos(),
    };
    let mut points = Vec::new();
    match random.below(3) {
        0 => {
            let (columns, rows) = (4 + random.below(20), 3 + random.below(20));
            for i in 0..columns * rows {
                let (column, row) = ((i % columns) as f64, (i / columns) as f64);
                points.push(turned((column - columns as f64 / 2.0) * dx, (row - rows as f64 / 2.0) * dy));
            }
        }
        1 => {
            for _ in 0..2 + random.below(12) {
                let (start, way) = (anywhere(random, 1)[0], random.uniform(0.0, 6.3));
                let step = if random.below(2) == 0 { 83.0 } else { random.uniform(40.0, 300.0) };
                points.extend(
                    (0..30).map(|i| shifted(&start, f64::from(i) * step * way.cos(), f64::from(i) * step * way.sin())),
                );
            }
        }
        _ => {
            for centre in anywhere(random, 8) {
                for _ in 0..5 + random.below(15) {
                    points.push(shifted(&centre, 60.0 * random.normal(), 60.0 * random.normal()));
                }
            }
        }
    }
    points.iter().map(|p| shifted(p, jitter * random.normal(), jitter * random.normal())).collect()
}

/// GCPs nearly on a grid, as surveyors put them out.
fn near_grid(random: &mut Random, jitter_px: f64) -> Vec<PixelPoint> {
    let (columns, rows) = (3 + random.below(4), 2 + random.below(3));
    let (dx, dy) = (SIZE.0 / columns as f64, SIZE.1 / rows as f64);
    (0..columns * rows)
        .map(|i| PixelPoint {
            x: ((i % columns) as f64 + 0.5) * dx + jitter_px * random.normal(),
            y: ((i / columns) as f64 + 0.5) * dy + jitter_px * random.normal(),
        })
        .collect()
}

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

#[test]
fn wrong_scales() {
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
