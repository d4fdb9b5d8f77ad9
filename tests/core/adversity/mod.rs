//! Lists and images made to mislead: every one may be refused, none may be solved wrong, and where all marks are there
//! most must be solved. `AUTOREF_LARGE=1` runs a thousand of each kind (`AUTOREF_TRIALS` says another number).

mod clutter;
mod doubles;
mod layouts;
mod mistakes;

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
