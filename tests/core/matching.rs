//! Blind matching: the real detections of the thesis, the case it failed on, and fields where nothing is to be found.

use std::time::Instant;

use crate::common::{Random, bare_candidate};
use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};
use autoref_solve::{Pair, Similarity, solve, solve_as};
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::Gcp;
use autoref_stream::matching::tpp::{Anchors, Space};
use autoref_stream::matching::{MatchOutcome, Matcher, MirrorMatcher, Priors, RobustMatcher, TimeLimit, TppMatcher};
use autoref_stream::pipeline::georeference::{Orientation, Outcome, Surroundings, diagnose, solve_candidates};

fn pairs_of(candidates: &[Candidate], gcps: &[Gcp], pairs: &[(usize, usize)]) -> Vec<Pair> {
    pairs
        .iter()
        .map(|&(c, g)| Pair {
            pixel: candidates[c].centre,
            covariance_px2: candidates[c].covariance_px2,
            map: gcps[g].position(),
            survey_sigma_m: gcps[g].sigma_m,
        })
        .collect()
}

#[test]
fn the_real_detections_of_lerkendal_give_the_14_gcps_and_no_other() {
    let (Some(candidates), Some(gcps), Some(matched)) = (
        crate::common::thesis_candidates("thesis/b3_candidates.csv"),
        crate::common::thesis_gcps("thesis/b1_lerkendal_gcps.csv"),
        crate::common::rows("thesis/b8_cm.csv"),
    ) else {
        return;
    };
    let started = Instant::now();
    let outcome = RobustMatcher::default().find(&candidates, &gcps, &Priors::default());
    println!("matched in {:.3} s", started.elapsed().as_secs_f64());
    let MatchOutcome::Solved(solved) = outcome else { panic!("not solved: {outcome:?}") };
    println!("{:?} tried, {:?}", solved.effort, solved.pattern.log10_false_alarms);
    let mut names: Vec<&str> = solved.pattern.pairs.iter().map(|&(_, g)| gcps[g].name.as_str()).collect();
    let mut expected: Vec<&str> = matched.iter().map(|row| row["name"].as_str()).collect();
    names.sort_unstable();
    expected.sort_unstable();
    assert_eq!(names, expected);
    let solution = solve(&pairs_of(&candidates, &gcps, &solved.pattern.pairs)).expect("14 points");
    // DESIGN.md: RMSE 0.06410 m, scale 0.031998043, rotation −0.026154°.
    assert!((solution.rmse_m - 0.06410).abs() < 5e-6, "{}", solution.rmse_m);
    assert!((solution.scale_m_per_px - 0.031998043).abs() < 5e-10, "{}", solution.scale_m_per_px);
    assert!((solution.rotation_deg - -0.026154).abs() < 5e-7, "{}", solution.rotation_deg);
}

#[test]
fn topological_point_patterns_find_the_14_gcps_too() {
    let (Some(candidates), Some(gcps)) = (
        crate::common::thesis_candidates("thesis/b3_candidates.csv"),
        crate::common::thesis_gcps("thesis/b1_lerkendal_gcps.csv"),
    ) else {
        return;
    };
    let outcome = TppMatcher::default().find(&candidates, &gcps, &Priors::default());
    let MatchOutcome::Solved(solved) = outcome else { panic!("not solved: {outcome:?}") };
    assert_eq!(solved.pattern.pairs.len(), 14);
}

/// With heights, from a few random anchors, and with fewer matches than were asked for first.
#[test]
fn topological_point_patterns_in_space_and_from_random_anchors() {
    let (Some(candidates), Some(gcps)) = (
        crate::common::thesis_candidates("thesis/b3_candidates.csv"),
        crate::common::thesis_gcps("thesis/b1_lerkendal_gcps.csv"),
    ) else {
        return;
    };
    let names = |matcher: &TppMatcher, gcps: &[Gcp]| match matcher.find(&candidates, gcps, &priors((0.027, 0.035))) {
        MatchOutcome::Solved(solved) => solved.pattern.pairs.iter().map(|p| gcps[p.1].name.clone()).collect(),
        MatchOutcome::NoMatch(_) => Vec::new(),
    };
    let plane = names(&TppMatcher::default(), &gcps);
    let solid = TppMatcher { space: Space::Solid { gsd_m: 0.032 }, ..TppMatcher::default() };
    assert_eq!(names(&solid, &gcps), plane);
    // Heights of which every second is ten metres off are another pattern in space, and the same from above.
    let raised = |i: usize, gcp: &Gcp| Gcp { height: gcp.height.map(|h| h + 10.0 * (i % 2) as f64), ..gcp.clone() };
    let raised: Vec<Gcp> = gcps.iter().enumerate().map(|(i, gcp)| raised(i, gcp)).collect();
    assert_eq!(names(&TppMatcher::default(), &raised), plane);
    assert!(names(&solid, &raised).len() < plane.len());
    // An anchor that is a mark and whose nearest neighbour is one finds the pattern; the seed decides.
    let drawn = |count, seed| TppMatcher { anchors: Anchors::Random { count, seed }, ..TppMatcher::default() };
    assert_eq!(names(&drawn(candidates.len(), 1), &gcps), plane);
    let found = |seed| names(&drawn(30, seed), &gcps).len();
    let all: Vec<usize> = (0..20).map(found).collect();
    assert_eq!(all, (0..20).map(found).collect::<Vec<_>>());
    assert!(all.contains(&0) && all.iter().any(|n| *n > 0), "{all:?}");
    // Twenty matches are more than there are.
    let strict = TppMatcher { minimum_matches: 20, least_matches: 20, ..TppMatcher::default() };
    assert!(names(&strict, &gcps).is_empty());
    assert_eq!(names(&TppMatcher { least_matches: 4, ..strict }, &gcps), plane);
}

/// One synthetic case: GCPs visible in an image somewhere over the list, false candidates, noise.
struct Case {
    candidates: Vec<Candidate>,
    truth: Similarity,
    visible: Vec<usize>,
}

struct Kind {
    size: (f64, f64),
    gsd: f64,
    visible: usize,
    false_candidates: usize,
    sigma_px: f64,
    /// Rotation drawn from ± this.
    turn_deg: f64,
}

fn case(random: &mut Random, gcps: &[Gcp], kind: &Kind) -> Case {
    loop {
        let angle = random.uniform(-kind.turn_deg, kind.turn_deg).to_radians();
        let (a_re, a_im) = (kind.gsd * angle.cos(), kind.gsd * angle.sin());
        // Put a random GCP at a random place of the image.
        let anchor = gcps[random.below(gcps.len())].position();
        let (x, y) = (random.uniform(0.0, kind.size.0), -random.uniform(0.0, kind.size.1));
        let truth = Similarity {
            a_re,
            a_im,
            easting_0: anchor.easting - (a_re * x - a_im * y),
            northing_0: anchor.northing - (a_im * x + a_re * y),
            mirrored: Handedness::AsIs,
        };
        let mut inside: Vec<usize> = (0..gcps.len())
            .filter(|&i| {
                let p = truth.invert(gcps[i].position());
                p.x >= 0.0 && p.y >= 0.0 && p.x < kind.size.0 && p.y < kind.size.1
            })
            .collect();
        if inside.len() < kind.visible {
            continue;
        }
        let order = random.order(inside.len());
        inside = order.into_iter().take(kind.visible).map(|i| inside[i]).collect();
        let mut candidates: Vec<Candidate> = inside
            .iter()
            .map(|&i| {
                let p = truth.invert(gcps[i].position());
                bare_candidate(p.x + kind.sigma_px * random.normal(), p.y + kind.sigma_px * random.normal())
            })
            .collect();
        for _ in 0..kind.false_candidates {
            candidates.push(bare_candidate(random.uniform(0.0, kind.size.0), random.uniform(0.0, kind.size.1)));
        }
        let order = random.order(candidates.len());
        let candidates = order.into_iter().map(|i| candidates[i].clone()).collect();
        return Case { candidates, truth, visible: inside };
    }
}

#[derive(Default, Debug)]
struct Score {
    right: usize,
    wrong: usize,
    refused: usize,
    slowest_s: f64,
    median_s: f64,
    /// Processor time of a trial: other programs on the machine do not lengthen it.
    mean_cpu_s: f64,
}

/// Processor time of this process so far, all threads (proc(5): fields 14 and 15, in ticks of 10 ms).
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    after_name.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

fn trials(kind: &Kind, priors: &Priors, gcps: &[Gcp], count: usize, seed: u64) -> Score {
    let mut random = Random::new(seed);
    let mut score = Score::default();
    let (mut evidence, mut times) = (Vec::new(), Vec::new());
    let cpu_before = cpu_s();
    for _ in 0..count {
        let case = case(&mut random, gcps, kind);
        let started = Instant::now();
        let outcome = RobustMatcher::default().find(&case.candidates, gcps, priors);
        let elapsed = started.elapsed().as_secs_f64();
        times.push(elapsed);
        match outcome {
            MatchOutcome::Solved(solved) => {
                evidence.push(solved.pattern.log10_false_alarms);
                let solution = solve(&pairs_of(&case.candidates, gcps, &solved.pattern.pairs)).expect("a pattern");
                let worst = case
                    .visible
                    .iter()
                    .map(|&i| {
                        let p = case.truth.invert(gcps[i].position());
                        let (m, t) = (solution.similarity.apply(p), gcps[i].position());
                        (m.easting - t.easting).hypot(m.northing - t.northing) / kind.gsd
                    })
                    .fold(0.0, f64::max);
                if worst <= 5.0 * kind.sigma_px.max(1.0) {
                    score.right += 1;
                } else {
                    score.wrong += 1;
                    let matched: Vec<usize> = solved.pattern.pairs.iter().map(|pair| pair.1).collect();
                    println!(
                        "wrong by {worst:.1} px: visible {:?}, matched {matched:?}, log10 NFA {:.2}, {:?}",
                        case.visible,
                        solved.pattern.log10_false_alarms,
                        solution.pairs.iter().map(|p| (p.residual_px * 10.0).round() / 10.0).collect::<Vec<_>>()
                    );
                }
            }
            MatchOutcome::NoMatch(_) => score.refused += 1,
        }
    }
    evidence.sort_by(f64::total_cmp);
    times.sort_by(f64::total_cmp);
    score.slowest_s = *times.last().expect("there are trials");
    score.median_s = times[times.len() / 2];
    score.mean_cpu_s = (cpu_s() - cpu_before) / count as f64;
    println!(
        "{} visible, {} false, {count} trials: {score:.3?}, median log10 NFA {:.1?}",
        kind.visible,
        kind.false_candidates,
        evidence.get(evidence.len() / 2)
    );
    score
}

const E6: (f64, f64) = (15_828.0, 47_619.0);

fn priors(gsd: (f64, f64)) -> Priors {
    Priors { gsd_m_per_px: Some(gsd), rotation_deg: None, image_size_px: Some(E6) }
}

fn kind(visible: usize, false_candidates: usize, turn_deg: f64) -> Kind {
    Kind { size: E6, gsd: 0.03, visible, false_candidates, sigma_px: 1.0, turn_deg }
}

#[test]
fn e6_six_visible_among_a_thousand() {
    let Some(gcps) = crate::common::thesis_gcps("thesis/b2_e6_gcps.csv") else { return };
    let count = crate::common::trials(20, 1000);
    let score = trials(&kind(6, 1000, 180.0), &priors((0.027, 0.033)), &gcps, count, 1);
    assert_eq!(score.wrong, 0);
    assert!(score.right * 1000 >= count * 995, "{score:?}");
}

#[test]
fn e6_five_visible_among_three_hundred() {
    let Some(gcps) = crate::common::thesis_gcps("thesis/b2_e6_gcps.csv") else { return };
    let count = crate::common::trials(20, 1000);
    let score = trials(&kind(5, 300, 180.0), &priors((0.027, 0.033)), &gcps, count, 2);
    assert_eq!(score.wrong, 0);
    assert!(score.right * 100 >= count * 99, "{score:?}");
}

/// Marks five pixels off: whatever happens to fit well among them must not shut out the rest.
#[test]
fn marks_far_off_their_places_keep_the_whole_pattern() {
    let mut random = Random::new(30);
    // A list about as large as the image, so that most of it is seen wherever the image lies.
    let gcps: Vec<Gcp> = (0..36)
        .map(|i| Gcp::control(format!("{i}"), random.uniform(0.0, 480.0), random.uniform(0.0, 1400.0)))
        .collect();
    for (visible, false_candidates, sigma_px, seed) in [(20, 0, 5.0, 31), (14, 30, 5.0, 33)] {
        let kind = Kind { sigma_px, ..kind(visible, false_candidates, 20.0) };
        let score = trials(&kind, &priors((0.027, 0.033)), &gcps, crate::common::trials(10, 300), seed);
        assert_eq!(score.wrong, 0, "{visible} among {false_candidates}, {sigma_px} px: {score:?}");
    }
}

#[test]
fn e6_with_the_scale_known_within_a_factor_of_two() {
    let Some(gcps) = crate::common::thesis_gcps("thesis/b2_e6_gcps.csv") else { return };
    let count = crate::common::trials(2, 1000);
    let score = trials(&kind(6, 1000, 180.0), &priors((0.015, 0.06)), &gcps, count, 3);
    assert_eq!(score.wrong, 0);
    assert!(score.right * 10 >= count * 9, "{score:?}");
}

#[test]
fn e6_ten_visible_among_twenty_thousand_with_north_up() {
    let Some(gcps) = crate::common::thesis_gcps("thesis/b2_e6_gcps.csv") else { return };
    let count = crate::common::trials(1, 300);
    let priors = Priors { rotation_deg: Some((0.0, 15.0)), ..priors((0.027, 0.033)) };
    let score = trials(&kind(10, 20_000, 15.0), &priors, &gcps, count, 4);
    assert_eq!(score.wrong, 0);
    assert!(score.right * 100 >= count * 99, "{score:?}");
}

/// What is known already leaves less than one pattern by chance among so few.
#[test]
fn narrow_priors_hide_no_pattern_of_few_marks() {
    let mut random = Random::new(40);
    for visible in [4, 6] {
        let gcps: Vec<Gcp> = (0..visible)
            .map(|i| Gcp::control(format!("{i}"), random.uniform(0.0, 100.0), random.uniform(0.0, 300.0)))
            .collect();
        for half_deg in [5.0, 1.0, 0.2] {
            let known = Priors { rotation_deg: Some((0.0, half_deg)), ..priors((0.0299, 0.0301)) };
            let count = crate::common::trials(5, 300);
            let score = trials(&kind(visible, 0, half_deg), &known, &gcps, count, 41);
            assert_eq!((score.right, score.wrong), (count, 0), "{visible} marks, ± {half_deg}°: {score:?}");
        }
    }
}

#[test]
fn nothing_there_is_refused() {
    let Some(gcps) = crate::common::thesis_gcps("thesis/b2_e6_gcps.csv") else { return };
    let count = crate::common::trials(4, 1000);
    let mut random = Random::new(5);
    for trial in 0..count {
        let candidates: Vec<Candidate> = match trial % 4 {
            0 => (0..200 + random.below(if crate::common::large() || trial % 20 == 0 { 4800 } else { 800 }))
                .map(|_| bare_candidate(random.uniform(0.0, E6.0), random.uniform(0.0, E6.1)))
                .collect(),
            1 => lattice(random.uniform(600.0, 1500.0), random.uniform(600.0, 1500.0), random.uniform(0.0, 3.0)),
            2 => parking_rows(&mut random),
            _ => mirrored(&mut random, &gcps).candidates,
        };
        let started = Instant::now();
        let outcome = RobustMatcher::default().find(&candidates, &gcps, &priors((0.027, 0.033)));
        if trial < 8 {
            println!("kind {}, {} candidates: {:.2} s", trial % 4, candidates.len(), started.elapsed().as_secs_f64());
        }
        assert!(matches!(outcome, MatchOutcome::NoMatch(_)), "trial {trial}: {outcome:?}");
        if (trial + 1) % 50 == 0 || trial + 1 == count {
            println!("nothing there: {} lists, 0 accepted", trial + 1);
        }
    }
}

/// Random fields without the pattern, small enough that thousands are cheap: how often is the best pattern as rare as a
/// limit says? The printed chance must not promise more than that.
#[test]
fn the_printed_chance_is_no_promise_too_much() {
    let count = crate::common::trials(400, 20_000);
    let mut random = Random::new(8);
    let limits = [0.01, 0.03, 0.1, 0.3, 1.0];
    let mut accepted = [0usize; 5];
    for trial in 0..count {
        let size = (6000.0, 4000.0);
        let gcps: Vec<Gcp> = (0..8)
            .map(|i| Gcp::control(format!("{i}"), random.uniform(0.0, 180.0), random.uniform(0.0, 120.0)))
            .collect();
        // Uniform, and in clumps.
        let candidates: Vec<Candidate> = (0..30)
            .map(|i| match trial % 2 {
                0 => bare_candidate(random.uniform(0.0, size.0), random.uniform(0.0, size.1)),
                _ => {
                    let (x, y) = (1000.0 + 1000.0 * f64::from(i % 4), 1000.0 * f64::from(1 + i % 3));
                    bare_candidate(x + 300.0 * random.normal(), y + 300.0 * random.normal())
                }
            })
            .filter(|c| c.centre.x > 0.0 && c.centre.y > 0.0 && c.centre.x < size.0 && c.centre.y < size.1)
            .collect();
        let priors = Priors { gsd_m_per_px: Some((0.024, 0.036)), rotation_deg: None, image_size_px: Some(size) };
        let best = match RobustMatcher::default().find(&candidates, &gcps, &priors) {
            MatchOutcome::Solved(solved) => Some(solved.pattern.log10_false_alarms),
            MatchOutcome::NoMatch(evidence) => evidence.best.map(|best| best.log10_false_alarms),
        };
        for (accepted, limit) in accepted.iter_mut().zip(limits) {
            *accepted += usize::from(best.is_some_and(|best| best <= f64::log10(limit)));
        }
    }
    println!("{count} fields with nothing there; accepted at limits {limits:?}: {accepted:?}");
    for (accepted, limit) in accepted.into_iter().zip(limits) {
        let expected = limit * count as f64;
        assert!(accepted as f64 <= expected + 3.0 * expected.sqrt(), "limit {limit}: {accepted} of {count}");
    }
}

fn lattice(dx: f64, dy: f64, jitter: f64) -> Vec<Candidate> {
    let mut random = Random::new(dx.to_bits() ^ dy.to_bits());
    let mut all = Vec::new();
    for row in 0..(E6.1 / dy) as usize {
        for column in 0..(E6.0 / dx) as usize {
            all.push(bare_candidate(
                (column as f64 + 0.5) * dx + jitter * random.normal(),
                (row as f64 + 0.5) * dy + jitter * random.normal(),
            ));
        }
    }
    all
}

fn parking_rows(random: &mut Random) -> Vec<Candidate> {
    let mut all = Vec::new();
    for _ in 0..12 {
        let (x, y, angle) = (random.uniform(0.0, E6.0), random.uniform(0.0, E6.1), random.uniform(0.0, 6.3));
        for i in 0..40 {
            let (x, y) = (x + 83.0 * f64::from(i) * angle.cos(), y + 83.0 * f64::from(i) * angle.sin());
            if x > 0.0 && y > 0.0 && x < E6.0 && y < E6.1 {
                all.push(bare_candidate(x, y));
            }
        }
    }
    all
}

fn mirrored(random: &mut Random, gcps: &[Gcp]) -> Case {
    let mut case = case(random, gcps, &kind(6, 300, 180.0));
    for candidate in &mut case.candidates {
        candidate.centre.x = E6.0 - candidate.centre.x;
    }
    case
}

#[test]
fn a_mirrored_image_is_not_matched() {
    let Some(gcps) = crate::common::thesis_gcps("thesis/b2_e6_gcps.csv") else { return };
    let case = mirrored(&mut Random::new(11), &gcps);
    let outcome = RobustMatcher::default().find(&case.candidates, &gcps, &priors((0.027, 0.033)));
    assert!(matches!(outcome, MatchOutcome::NoMatch(_)), "a mirrored image was matched");
}

fn both_ways() -> MirrorMatcher {
    expecting(None)
}

fn expecting(expected: Option<Handedness>) -> MirrorMatcher {
    MirrorMatcher { within: Box::new(RobustMatcher { tries: 2.0, ..RobustMatcher::default() }), expected }
}

#[test]
fn a_mirrored_image_is_matched_where_it_may_be() {
    let gcps: Vec<Gcp> = {
        let mut random = Random::new(5);
        let point = |i| Gcp::control(format!("P{i}"), random.uniform(0.0, 900.0), random.uniform(0.0, 800.0));
        (0..40).map(point).collect()
    };
    for seed in 0..if crate::common::large() { 10 } else { 1 } {
        let straight = case(&mut Random::new(seed), &gcps, &kind(6, 300, 180.0));
        let turned = mirrored(&mut Random::new(seed), &gcps);
        for (case, truth) in [(&straight, straight.truth), (&turned, turned.truth.mirrored(E6.0))] {
            let outcome = both_ways().find(&case.candidates, &gcps, &priors((0.027, 0.033)));
            let MatchOutcome::Solved(solved) = outcome else { panic!("seed {seed}: {outcome:?}") };
            let found = solved.pattern.similarity;
            assert_eq!(found.mirrored, truth.mirrored);
            for corner in [(0.0, 0.0), (E6.0, 0.0), (0.0, E6.1), (E6.0, E6.1)] {
                let corner = PixelPoint { x: corner.0, y: corner.1 };
                let (one, other) = (found.apply(corner), truth.apply(corner));
                let apart = (one.easting - other.easting).hypot(one.northing - other.northing);
                assert!(apart < 0.3, "seed {seed}: {apart} m");
                let back = truth.invert(other);
                assert!((back.x - corner.x).hypot(back.y - corner.y) < 1e-6);
            }
            let pairs = pairs_of(&case.candidates, &gcps, &solved.pattern.pairs);
            let solution = solve_as(&pairs, truth.mirrored).expect("six points");
            assert!(solution.rmse_px < 3.0, "seed {seed}: {} px", solution.rmse_px);
            assert_eq!(solution.geotransform.0[1].is_sign_negative(), found.geotransform().0[1].is_sign_negative());
        }
    }
}

#[test]
fn a_list_that_is_its_own_mirror_image_fits_neither_way_where_both_may_be() {
    // Pairs beside an axis at uneven steps along it.
    let steps = [0.0, 31.0, 83.0, 104.0, 177.0, 239.0];
    let points = steps.iter().enumerate().flat_map(|(i, &n)| {
        let wide = 20.0 + 13.0 * (i * i % 7) as f64;
        [Gcp::control(format!("L{i}"), -wide, n), Gcp::control(format!("R{i}"), wide, n)]
    });
    let gcps: Vec<Gcp> = points.collect();
    let truth = Similarity::through(
        [PixelPoint { x: 0.0, y: 0.0 }, PixelPoint { x: 9_000.0, y: 0.0 }],
        [MapPoint { easting: -130.0, northing: 250.0 }, MapPoint { easting: 138.0, northing: 262.0 }],
    )
    .expect("two points");
    let candidates: Vec<Candidate> =
        gcps.iter().map(|gcp| truth.invert(gcp.position())).map(|p| bare_candidate(p.x, p.y)).collect();
    let MatchOutcome::NoMatch(evidence) = both_ways().find(&candidates, &gcps, &priors((0.027, 0.033))) else {
        panic!("believed one of two ways");
    };
    assert!(evidence.reason.contains("as it is (12 marks) and mirrored (12 marks)"), "{}", evidence.reason);
    for expected in Handedness::BOTH {
        let outcome = expecting(Some(expected)).find(&candidates, &gcps, &priors((0.027, 0.033)));
        let MatchOutcome::Solved(solved) = outcome else { panic!("the image says which: {outcome:?}") };
        assert_eq!(solved.pattern.similarity.mirrored, expected);
    }
    let alone = RobustMatcher::default().find(&candidates, &gcps, &priors((0.027, 0.033)));
    let MatchOutcome::Solved(solved) = alone else { panic!("refused without a mirror: {alone:?}") };
    assert_eq!(solved.pattern.similarity.mirrored, Handedness::AsIs);
}

#[test]
fn threads_do_not_change_the_answer() {
    let Some(gcps) = crate::common::thesis_gcps("thesis/b2_e6_gcps.csv") else { return };
    let case = case(&mut Random::new(21), &gcps, &kind(6, 500, 180.0));
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| RobustMatcher::default().find(&case.candidates, &gcps, &priors((0.027, 0.033))))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn fewer_than_three_of_anything_is_an_answer_not_a_panic() {
    let gcps = [Gcp::control("a", 0.0, 0.0), Gcp::control("b", 10.0, 0.0)];
    let candidates = vec![bare_candidate(1.0, 1.0); 2];
    for (c, g) in [(0, 0), (0, 2), (2, 0), (2, 2), (1, 1)] {
        let outcome = RobustMatcher::default().find(&candidates[..c], &gcps[..g], &Priors::default());
        assert!(matches!(outcome, MatchOutcome::NoMatch(_)));
    }
}

/// Nine marks agree to a tenth of a pixel, old paint lies 6 and 8 px beside the points of two others: these leave the
/// fit that is written.
#[test]
fn old_paint_beside_its_points_is_not_in_the_fit() {
    let mut random = Random::new(23);
    let ground = |p: PixelPoint| MapPoint { easting: 570_000.0 + 0.03 * p.x, northing: 7_032_000.0 - 0.03 * p.y };
    let (mut candidates, mut gcps) = (Vec::new(), Vec::new());
    for i in 0..11 {
        let p = PixelPoint { x: 4000.0 * random.uniform(0.0, 1.0), y: 3000.0 * random.uniform(0.0, 1.0) };
        let old = [[0.0; 2], [6.0, 0.5], [-3.0, -7.4]][if i < 3 { i } else { 0 }];
        let off = |k: usize, random: &mut Random| old[k] + 0.2 * (random.uniform(0.0, 1.0) - 0.5);
        candidates.push(bare_candidate(p.x + off(0, &mut random), p.y + off(1, &mut random)));
        let at = ground(p);
        gcps.push(Gcp::control(format!("P{i}"), at.easting, at.northing));
    }
    let size = Priors { image_size_px: Some((4000.0, 3000.0)), ..Priors::default() };
    let outcome = solve_candidates(&candidates, &gcps, &RobustMatcher::default(), &size).expect("no image is read");
    let Outcome::Solved(orientation) = outcome else { panic!("{outcome:?}") };
    let fitted: Vec<usize> = orientation.marks.iter().map(|mark| mark.gcp).collect();
    assert_eq!(fitted, [0, 3, 4, 5, 6, 7, 8, 9, 10]);
    assert_eq!(orientation.not_found, [1, 2]);
}

/// Twelve points at 3 cm a pixel, of which the last four err by 0.09 to 0.32 m, eight candidates of clutter, and `more`
/// of them. What is stated of the four; the others are good to 0.02 m.
fn with_poor_points(stated_m: Option<f64>, more: usize) -> (Vec<Candidate>, Vec<Gcp>) {
    let mut random = Random::new(47);
    let ground = |p: PixelPoint| MapPoint { easting: 570_000.0 + 0.03 * p.x, northing: 7_032_000.0 - 0.03 * p.y };
    let anywhere = |random: &mut Random| (random.uniform(0.0, 6000.0), random.uniform(0.0, 4000.0));
    let poor = [(0.05, -0.08), (-0.13, 0.02), (0.14, 0.17), (-0.30, -0.11)];
    let (mut candidates, mut gcps) = (Vec::new(), Vec::new());
    for i in 0..12 {
        let (x, y) = anywhere(&mut random);
        candidates.push(bare_candidate(x, y));
        let at = ground(PixelPoint { x, y });
        let (e, n) = if i < 8 { (0.02 * random.normal(), 0.02 * random.normal()) } else { poor[i - 8] };
        let sigma_m = stated_m.map(|poor_m| if i < 8 { 0.02 } else { poor_m });
        gcps.push(Gcp { sigma_m, ..Gcp::control(format!("P{i}"), at.easting + e, at.northing + n) });
    }
    for _ in 0..8 + more {
        let (x, y) = anywhere(&mut random);
        candidates.push(bare_candidate(x, y));
    }
    (candidates, gcps)
}

fn solved_and_diagnosed(candidates: &[Candidate], gcps: &[Gcp]) -> Box<Orientation> {
    let priors = Priors { image_size_px: Some((6000.0, 4000.0)), ..Priors::default() };
    let mut outcome = solve_candidates(candidates, gcps, &RobustMatcher::default(), &priors).expect("no image is read");
    let (max_false_alarms, time_limit) = (1e-4, TimeLimit::default());
    let surroundings = Surroundings { crs: None, known: None, max_false_alarms, time_limit };
    diagnose(&mut outcome, candidates, gcps, &priors, surroundings);
    let Outcome::Solved(orientation) = outcome else { panic!("{outcome:?}") };
    orientation
}

/// Points that lie as well as their list says were called displaced, and mistyped, where others of the list are better.
#[test]
fn points_of_poor_stated_accuracy_keep_their_marks() {
    let (candidates, gcps) = with_poor_points(Some(0.15), 0);
    let solved = solved_and_diagnosed(&candidates, &gcps);
    assert!(
        solved.not_found.is_empty() && solved.diagnoses.is_empty(),
        "{:?} {:?}",
        solved.not_found,
        solved.diagnoses
    );
    assert!(solved.marks.iter().all(|mark| mark.mark.centre == candidates[mark.gcp].centre));
    // Where nothing is stated, what lies so far off is wrong.
    let (candidates, gcps) = with_poor_points(None, 0);
    assert!(!solved_and_diagnosed(&candidates, &gcps).not_found.is_empty());
}

/// Whatever a list states, no point takes a candidate that chance puts there more than three times in a thousand.
#[test]
fn a_wide_stated_accuracy_lets_no_clutter_in() {
    let (mut candidates, mut gcps) = with_poor_points(Some(10.0), 800);
    candidates.drain(8..12);
    gcps[0].sigma_m = None;
    let solved = solved_and_diagnosed(&candidates, &gcps);
    assert_eq!(solved.not_found, [8, 9, 10, 11]);
}
