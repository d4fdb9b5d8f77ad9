//! Names that coded targets bear: what they solve, and what they must not make anybody believe. No image and no decoder
//! is needed; `AUTOREF_LARGE=1` runs many more trials (`AUTOREF_TRIALS` says another number).

use crate::common::{Random, bare_candidate, trials, turned};
use autoref_raster::coords::PixelPoint;
use autoref_solve::Similarity;
use autoref_stream::candidate::{Candidate, Code};
use autoref_stream::gcp::{Gcp, GcpRole};
use autoref_stream::matching::{MatchOutcome, Matcher, Priors, RobustMatcher, Solved};

const SIZE: (f64, f64) = (8000.0, 6000.0);
const GSD: f64 = 0.03;

/// A regular grid in the middle of the image.
fn grid(columns: usize, rows: usize) -> Vec<PixelPoint> {
    let step = 700.0;
    let at = |k: usize, n: usize, size: f64| size / 2.0 + step * (k as f64 - (n as f64 - 1.0) / 2.0);
    (0..rows)
        .flat_map(|r| (0..columns).map(move |c| PixelPoint { x: at(c, columns, SIZE.0), y: at(r, rows, SIZE.1) }))
        .collect()
}

fn anywhere(random: &mut Random, n: usize) -> Vec<PixelPoint> {
    (0..n).map(|_| PixelPoint { x: random.uniform(200.0, 7800.0), y: random.uniform(200.0, 5800.0) }).collect()
}

/// GCPs 1, 2, … at the places.
fn list(truth: &Similarity, places: &[PixelPoint]) -> Vec<Gcp> {
    let at = |(i, p): (usize, &PixelPoint)| {
        let m = truth.apply(*p);
        Gcp::control(format!("GCP{:03}", i + 1), m.easting, m.northing)
    };
    places.iter().enumerate().map(at).collect()
}

fn coded(random: &mut Random, p: PixelPoint, number: Option<u32>) -> Candidate {
    let code = number.map(|number| Code { family: "aruco-4x4-50".into(), number });
    let sigma = 0.3;
    Candidate {
        score: Some(10.0),
        size_px: Some([24.0; 2]),
        code,
        ..bare_candidate(p.x + sigma * random.normal(), p.y + sigma * random.normal())
    }
}

/// A mark at each place with the number that `number` says, in any order.
fn marks(random: &mut Random, places: &[PixelPoint], number: impl Fn(usize) -> Option<u32>) -> Vec<Candidate> {
    let order = random.order(places.len());
    order.into_iter().map(|i| coded(random, places[i], number(i))).collect()
}

fn clutter(random: &mut Random, n: usize) -> Vec<Candidate> {
    anywhere(random, n).into_iter().map(|p| coded(random, p, None)).collect()
}

fn find(candidates: &[Candidate], gcps: &[Gcp]) -> MatchOutcome {
    let priors = Priors { gsd_m_per_px: Some((0.9 * GSD, 1.1 * GSD)), rotation_deg: None, image_size_px: Some(SIZE) };
    RobustMatcher::default().find(candidates, gcps, &priors)
}

fn error_px(solved: &Solved, truth: &Similarity, places: &[PixelPoint]) -> f64 {
    let error = |p: &PixelPoint| {
        let q = solved.pattern.similarity.invert(truth.apply(*p));
        (p.x - q.x).hypot(p.y - q.y)
    };
    places.iter().map(error).fold(0.0, f64::max)
}

#[track_caller]
fn solved_right(what: &str, outcome: &MatchOutcome, truth: &Similarity, places: &[PixelPoint]) -> Solved {
    let MatchOutcome::Solved(solved) = outcome else { panic!("{what}: {outcome:?}") };
    let error = error_px(solved, truth, places);
    assert!(error < 3.0, "{what}: {error} px off");
    (**solved).clone()
}

#[test]
fn a_regular_grid_is_solved_by_its_names_and_refused_without() {
    let mut random = Random::new(3);
    for trial in 0..trials(2, 200) {
        for (columns, rows) in [(6, 6), (5, 4), (3, 4), (3, 3)] {
            let what = format!("trial {trial}, {columns} × {rows}");
            let (truth, places) = (turned(&mut random, GSD), grid(columns, rows));
            let gcps = list(&truth, &places);
            let mut named = marks(&mut random, &places, |i| Some(i as u32 + 1));
            named.extend(clutter(&mut random, 30));
            let solved = solved_right(&what, &find(&named, &gcps), &truth, &places);
            let names = solved.names.expect("names were needed");
            assert_eq!((names.named, names.agree, names.contradict), (places.len(), places.len(), 0), "{what}");
            named.iter_mut().for_each(|c| c.code = None);
            assert!(matches!(find(&named, &gcps), MatchOutcome::NoMatch(_)), "{what}: without names");
        }
    }
}

/// A third of the marks is covered, a third of the points lies beyond the image.
#[test]
fn part_of_a_grid_is_enough() {
    let mut random = Random::new(8);
    for trial in 0..trials(2, 200) {
        let truth = turned(&mut random, GSD);
        let places: Vec<PixelPoint> = grid(6, 9).into_iter().map(|p| PixelPoint { x: p.x, y: p.y + 2000.0 }).collect();
        let seen: Vec<usize> =
            (0..places.len()).filter(|&i| places[i].y < SIZE.1 && random.uniform(0.0, 1.0) < 0.67).collect();
        let shown: Vec<PixelPoint> = seen.iter().map(|&i| places[i]).collect();
        let candidates = marks(&mut random, &shown, |k| Some(seen[k] as u32 + 1));
        solved_right(&format!("trial {trial}"), &find(&candidates, &list(&truth, &places)), &truth, &shown);
    }
}

/// The numbers on the ground have nothing to do with the labels: a grid is refused, never solved wrong.
#[test]
fn numbers_dealt_at_random_on_a_grid_are_not_believed() {
    let mut random = Random::new(21);
    let mut most = 0;
    for trial in 0..trials(3, 3000) {
        for (columns, rows) in [(6, 6), (3, 3), (2, 4), (3, 4), (8, 1)] {
            let (truth, places) = (turned(&mut random, GSD), grid(columns, rows));
            let dealt = random.order(places.len());
            let candidates = marks(&mut random, &places, |i| Some(dealt[i] as u32 + 1));
            if let MatchOutcome::Solved(solved) = find(&candidates, &list(&truth, &places)) {
                let error = error_px(&solved, &truth, &places);
                panic!("trial {trial}, {columns} × {rows}: {error} px off with {:?}", solved.names);
            }
            most = most.max(candidates.len());
        }
    }
    assert_eq!(most, 36);
}

/// On points without any regularity the pattern alone decides; foreign numbers must neither mislead it nor stand in its
/// way.
#[test]
fn foreign_numbers_do_not_spoil_an_irregular_list() {
    let mut random = Random::new(5);
    let mut solved = 0;
    let n = trials(10, 1000);
    for trial in 0..n {
        let truth = turned(&mut random, GSD);
        let places = anywhere(&mut random, 12);
        let dealt = random.order(places.len());
        let mut candidates = marks(&mut random, &places, |i| Some(dealt[i] as u32 + 1));
        candidates.extend(clutter(&mut random, 40));
        if let MatchOutcome::Solved(found) = find(&candidates, &list(&truth, &places)) {
            solved += 1;
            let error = error_px(&found, &truth, &places);
            assert!(error < 3.0, "trial {trial}: {error} px off, {:?}", found.names);
        }
    }
    println!("{solved} of {n} solved");
    assert!(20 * solved >= 19 * n, "{solved} of {n}");
}

/// One number misread, one target seen twice, one number on two targets, numbers that no label has, a label that two
/// points have.
#[test]
fn a_few_wrong_numbers_are_borne() {
    let mut random = Random::new(13);
    for trial in 0..trials(5, 300) {
        let (truth, places) = (turned(&mut random, GSD), grid(5, 4));
        let mut gcps = list(&truth, &places);
        let pick = random.order(places.len());
        let wrong = |i: usize| match i {
            i if i == pick[0] => Some(pick[1] as u32 + 1),
            i if i == pick[2] => Some(900),
            i if i == pick[3] => None,
            i => Some(i as u32 + 1),
        };
        let mut candidates = marks(&mut random, &places, wrong);
        let p = places[pick[4]];
        candidates.push(coded(&mut random, PixelPoint { x: p.x + 0.6, y: p.y - 0.4 }, Some(pick[4] as u32 + 1)));
        candidates.push(coded(&mut random, PixelPoint { x: 300.0, y: 200.0 }, Some(pick[5] as u32 + 1)));
        gcps[pick[6]].name = gcps[pick[7]].name.replace("GCP", "X");
        let what = format!("trial {trial}");
        let solved = solved_right(&what, &find(&candidates, &gcps), &truth, &places);
        let misread = |&(c, g): &(usize, usize)| {
            let number = candidates[c].code.as_ref().map(|code| code.number as usize);
            g == pick[0] && number == Some(pick[1] + 1)
        };
        assert!(!solved.pattern.pairs.iter().any(misread), "{what}: another point's name was overruled");
        assert_eq!(solved.names.expect("heeded").contradict, 1, "{what}");
    }
}

/// A mark that names a check point is no control point's, and takes no part.
#[test]
fn marks_of_check_points_are_kept_out() {
    let mut random = Random::new(17);
    let (truth, places) = (turned(&mut random, GSD), grid(5, 4));
    let mut gcps = list(&truth, &places);
    for i in [3, 11, 16] {
        gcps[i].role = GcpRole::Check;
    }
    let candidates = marks(&mut random, &places, |i| Some(i as u32 + 1));
    let solved = solved_right("check points", &find(&candidates, &gcps), &truth, &places);
    assert!(solved.pattern.pairs.iter().all(|&(_, g)| gcps[g].role == GcpRole::Control));
    assert_eq!(solved.names.expect("heeded").named, 17);
}

/// Codes that name nothing change nothing, to the bit.
#[test]
fn codes_without_labels_are_as_free_as_paint() {
    let mut random = Random::new(19);
    for _ in 0..10 {
        let truth = turned(&mut random, GSD);
        let places = anywhere(&mut random, 9);
        let gcps = list(&truth, &places);
        let mut candidates = marks(&mut random, &places, |i| Some(500 + i as u32));
        candidates.extend(clutter(&mut random, 60));
        let with = find(&candidates, &gcps);
        candidates.iter_mut().for_each(|c| c.code = None);
        assert_eq!(with, find(&candidates, &gcps));
        solved_right("irregular", &with, &truth, &places);
    }
}
