//! The blunder doctor on the lists of Lerkendal and E6: it names each mistake, and none where there is none.

mod common;

use autoref_stream::candidate::Candidate;
use autoref_stream::coords::PixelPoint;
use autoref_stream::doctor::{Axis, Case, Diagnosis, Mistake, OwnGeoreference, diagnose};
use autoref_stream::gcp::Gcp;
use autoref_stream::georef::crs::{Coordinate, Crs};
use autoref_stream::matching::{Priors, RobustMatcher};
use autoref_stream::pipeline::georeference::{Outcome, solve_candidates};
use autoref_stream::solve::Similarity;
use common::{Random, bare_candidate};

/// A list, candidates in which its pattern is, and what was known before.
#[derive(Clone)]
struct Scene {
    name: &'static str,
    gcps: Vec<Gcp>,
    candidates: Vec<Candidate>,
    size: (f64, f64),
    priors: Priors,
    /// GCPs whose marks are among the candidates.
    visible: Vec<usize>,
    truth: Similarity,
}

impl Scene {
    fn run(&self, crs: Option<&Crs>, labels: &[Option<String>], own: Option<&OwnGeoreference>) -> Vec<Diagnosis> {
        let matcher = RobustMatcher::default();
        let mut outcome = solve_candidates(&self.candidates, &self.gcps, &matcher, &self.priors).expect("no image");
        if matches!(outcome, Outcome::Refused(_)) && own.is_some() {
            // What the program does when what the image says of itself does not help.
            let free = Priors { gsd_m_per_px: None, ..self.priors.clone() };
            outcome = solve_candidates(&self.candidates, &self.gcps, &matcher, &free).expect("no image");
        }
        let case = Case {
            candidates: &self.candidates,
            labels,
            gcps: &self.gcps,
            crs,
            matcher: &matcher,
            priors: &self.priors,
            own,
        };
        diagnose(&case, &outcome)
    }

    fn changed(&self, change: impl Fn(usize, &mut Gcp)) -> Scene {
        let mut scene = self.clone();
        scene.gcps.iter_mut().enumerate().for_each(|(i, gcp)| change(i, gcp));
        scene
    }

    fn own(&self, crs: &Crs) -> OwnGeoreference {
        OwnGeoreference { geotransform: self.truth.geotransform(), crs: crs.clone(), image_size_px: self.size }
    }
}

/// The 294 real detections.
fn lerkendal() -> Option<Scene> {
    let gcps = common::thesis_gcps("thesis/b1_lerkendal_gcps.csv")?;
    let candidates = common::thesis_candidates("thesis/b3_candidates.csv")?;
    let size = (22_039.0, 20_051.0);
    let priors = Priors { gsd_m_per_px: Some((0.029, 0.0352)), rotation_deg: None, image_size_px: Some(size) };
    let outcome = solve_candidates(&candidates, &gcps, &RobustMatcher::default(), &priors).expect("no image");
    let Outcome::Solved(orientation) = outcome else { panic!("the list is right") };
    let visible = orientation.marks.iter().map(|mark| mark.gcp).collect();
    let truth = orientation.solution.similarity;
    Some(Scene { name: "Lerkendal", gcps, candidates, size, priors, visible, truth })
}

/// Marks planted for the E6 list.
fn e6(seed: u64, visible: usize, clutter: usize) -> Option<Scene> {
    let gcps = common::thesis_gcps("thesis/b2_e6_gcps.csv")?;
    let mut random = Random::new(seed);
    let size = (15_828.0, 47_619.0);
    loop {
        let angle = random.uniform(-20f64, 20.0).to_radians();
        let (a_re, a_im) = (0.03 * angle.cos(), 0.03 * angle.sin());
        let anchor = gcps[random.below(gcps.len())].position();
        let (x, y) = (random.uniform(0.0, size.0), -random.uniform(0.0, size.1));
        let truth = Similarity {
            a_re,
            a_im,
            easting_0: anchor.easting - (a_re * x - a_im * y),
            northing_0: anchor.northing - (a_im * x + a_re * y),
        };
        let inside = |p: PixelPoint| p.x > 0.0 && p.y > 0.0 && p.x < size.0 && p.y < size.1;
        let mut seen: Vec<usize> = (0..gcps.len()).filter(|&i| inside(truth.invert(gcps[i].position()))).collect();
        if seen.len() < visible {
            continue;
        }
        let order = random.order(seen.len());
        seen = order.into_iter().take(visible).map(|i| seen[i]).collect();
        let mut candidates: Vec<Candidate> = seen
            .iter()
            .map(|&i| {
                let p = truth.invert(gcps[i].position());
                bare_candidate(p.x + 0.5 * random.normal(), p.y + 0.5 * random.normal())
            })
            .collect();
        candidates
            .extend((0..clutter).map(|_| bare_candidate(random.uniform(0.0, size.0), random.uniform(0.0, size.1))));
        let priors = Priors { gsd_m_per_px: Some((0.027, 0.033)), rotation_deg: None, image_size_px: Some(size) };
        return Some(Scene { name: "E6", gcps, candidates, size, priors, visible: seen, truth });
    }
}

fn scenes() -> Vec<Scene> {
    [lerkendal(), e6(11, 9, 60)].into_iter().flatten().collect()
}

fn utm32() -> Crs {
    Crs::from_epsg(25832).expect("known")
}

fn mistakes(diagnoses: &[Diagnosis]) -> Vec<Mistake> {
    diagnoses.iter().map(|d| d.mistake.clone()).collect()
}

#[test]
fn correct_lists_are_left_alone() {
    let trials = if common::large() { 500 } else { 40 };
    let scenes = scenes().into_iter().chain((0..trials).filter_map(|seed| {
        let visible = 6 + seed as usize % 6;
        e6(1000 + seed, visible, 20 + 40 * (seed as usize % 5))
    }));
    let (mut runs, mut claimed) = (0, 0);
    for scene in scenes {
        let found = scene.run(Some(&utm32()), &[], Some(&scene.own(&utm32())));
        runs += 1;
        if !found.is_empty() {
            claimed += 1;
            println!("{}: {found:?}", scene.name);
        }
    }
    println!("{claimed} of {runs} correct lists were doubted");
    assert_eq!(claimed, 0);
}

#[test]
fn a_pattern_that_is_not_there_is_no_mistake_of_the_list() {
    let Some(mut scene) = e6(5, 6, 0) else { return };
    let mut random = Random::new(77);
    for clutter in [50, 300] {
        scene.candidates = (0..clutter)
            .map(|_| bare_candidate(random.uniform(0.0, scene.size.0), random.uniform(0.0, scene.size.1)))
            .collect();
        assert_eq!(scene.run(Some(&utm32()), &[], None), []);
    }
}

#[test]
fn swapped_axes_and_mirrored_images_are_told_apart() {
    for scene in scenes() {
        let swapped = scene.changed(|_, gcp| std::mem::swap(&mut gcp.easting, &mut gcp.northing));
        assert_eq!(mistakes(&swapped.run(Some(&utm32()), &[], None)), [Mistake::SwappedAxes], "{}", scene.name);
        assert_eq!(mistakes(&swapped.run(None, &[], None)), [Mistake::SwappedAxes], "{} by size", scene.name);
        let mut flipped = scene.clone();
        flipped.candidates.iter_mut().for_each(|c| c.centre.x = scene.size.0 - c.centre.x);
        assert_eq!(mistakes(&flipped.run(Some(&utm32()), &[], None)), [Mistake::MirroredImage], "{}", scene.name);
        // Local coordinates do not tell which.
        let local = swapped.changed(|_, gcp| {
            gcp.easting -= 7_000_000.0;
            gcp.northing -= 560_000.0;
        });
        assert_eq!(mistakes(&local.run(None, &[], None)), [Mistake::SwappedAxesOrMirroredImage], "{}", scene.name);
    }
}

#[test]
fn feet_are_named_and_of_which_kind_when_the_image_knows_its_place() {
    for scene in scenes() {
        for (foot, survey) in [(0.3048, false), (1200.0 / 3937.0, true)] {
            let feet = scene.changed(|_, gcp| {
                gcp.easting /= foot;
                gcp.northing /= foot;
            });
            let blind = mistakes(&feet.run(None, &[], None));
            assert_eq!(blind, [Mistake::FeetForMetres { survey: None }], "{}", scene.name);
            let placed = mistakes(&feet.run(Some(&utm32()), &[], Some(&scene.own(&utm32()))));
            assert_eq!(placed, [Mistake::FeetForMetres { survey: Some(survey) }], "{}", scene.name);
        }
        let metres = scene.changed(|_, gcp| {
            gcp.easting *= 0.3048;
            gcp.northing *= 0.3048;
        });
        assert_eq!(mistakes(&metres.run(None, &[], None)), [Mistake::MetresForFeet], "{}", scene.name);
    }
}

#[test]
fn exchanged_labels_and_coordinates_are_named() {
    for scene in scenes() {
        let (a, b) = (scene.visible[0], scene.visible[2]);
        let mut labels: Vec<Option<String>> = vec![None; scene.candidates.len()];
        for &gcp in &scene.visible {
            let place = scene.truth.invert(scene.gcps[gcp].position());
            let distance = |c: &Candidate| (c.centre.x - place.x).hypot(c.centre.y - place.y);
            let nearest = (0..labels.len())
                .min_by(|&i, &j| distance(&scene.candidates[i]).total_cmp(&distance(&scene.candidates[j])))
                .expect("there are candidates");
            let called = if gcp == a {
                b
            } else if gcp == b {
                a
            } else {
                gcp
            };
            labels[nearest] = Some(scene.gcps[called].name.clone());
        }
        let mut names = [scene.gcps[a].name.clone(), scene.gcps[b].name.clone()];
        names.sort();
        assert_eq!(
            mistakes(&scene.run(None, &labels, None)),
            [Mistake::ExchangedLabels { gcps: names }],
            "{}",
            scene.name
        );
        let eastings = (scene.gcps[a].easting, scene.gcps[b].easting);
        let exchanged = scene.changed(|i, gcp| {
            if i == a {
                gcp.easting = eastings.1;
            } else if i == b {
                gcp.easting = eastings.0;
            }
        });
        let gcps = [scene.gcps[a.min(b)].name.clone(), scene.gcps[a.max(b)].name.clone()];
        assert_eq!(
            mistakes(&exchanged.run(None, &[], None)),
            [Mistake::ExchangedCoordinates { gcps }],
            "{}",
            scene.name
        );
    }
}

#[test]
fn a_mistyped_digit_is_named() {
    for scene in scenes() {
        let (mut named, mut wrong, mut tried) = (0, 0, 0);
        for &gcp in &scene.visible {
            // Ten metres, a kilometre, and two digits turned round.
            for (axis, step) in [(Axis::Easting, 20.0), (Axis::Northing, -3000.0), (Axis::Easting, 0.0)] {
                let original = scene.gcps[gcp].easting;
                let step = if step == 0.0 { turned(original) - original } else { step };
                if step == 0.0 {
                    continue;
                }
                let typed = scene.changed(|i, g| match axis {
                    _ if i != gcp => {}
                    Axis::Easting => g.easting += step,
                    Axis::Northing => g.northing += step,
                });
                let listed = match axis {
                    Axis::Easting => typed.gcps[gcp].easting,
                    Axis::Northing => typed.gcps[gcp].northing,
                };
                tried += 1;
                for found in typed.run(None, &[], None) {
                    match found.mistake {
                        Mistake::MistypedDigit { gcp: name, axis: a, fits, .. }
                            if name == scene.gcps[gcp].name && a == axis && (fits - (listed - step)).abs() < 1e-6 =>
                        {
                            named += 1;
                        }
                        other => {
                            println!("{}: {other:?}", scene.name);
                            wrong += 1;
                        }
                    }
                }
            }
        }
        println!("{}: {named} of {tried} slips named, {wrong} others claimed", scene.name);
        assert_eq!(wrong, 0);
        assert!(named * 10 >= tried * 9, "{}: {named} of {tried}", scene.name);
    }
}

/// The tens and the hundreds turned round.
fn turned(value: f64) -> f64 {
    let digit = |unit: f64| (value / unit).floor() % 10.0;
    value + (digit(10.0) - digit(100.0)) * 90.0
}

#[test]
fn another_zone_and_distances_on_the_ground_show_beside_the_image_s_own_georeference() {
    for scene in scenes() {
        let (here, next) = (utm32(), Crs::from_epsg(25833).expect("known"));
        let own = scene.own(&here);
        let moved = scene.changed(|_, gcp| {
            let mut point = [Coordinate { x: gcp.easting, y: gcp.northing, height: None }];
            here.transform(&mut point, &next, 0.001).expect("one datum");
            (gcp.easting, gcp.northing) = (point[0].x, point[0].y);
        });
        let zone = Mistake::WrongZone { listed: "EPSG:25832".into(), fits: "EPSG:25833".into() };
        assert_eq!(mistakes(&moved.run(Some(&here), &[], Some(&own))), [zone], "{}", scene.name);
        assert_eq!(mistakes(&moved.run(Some(&next), &[], Some(&own))), [], "{}", scene.name);
    }
    let Some(scene) = e6(3, 10, 20) else { return };
    let grid = utm32().point_scale(568_000.0, 7_023_000.0).expect("projected");
    assert!((grid - 0.99966).abs() < 2e-5, "0.9996 on the central meridian, more beside it: {grid}");
    let middle = scene.gcps[0].position();
    let ground = scene.changed(|_, gcp| {
        gcp.easting = middle.easting + (gcp.easting - middle.easting) / grid;
        gcp.northing = middle.northing + (gcp.northing - middle.northing) / grid;
    });
    let found = mistakes(&ground.run(Some(&utm32()), &[], Some(&scene.own(&utm32()))));
    assert!(
        matches!(found.as_slice(), [Mistake::GridToGround { factor }] if (factor * grid - 1.0).abs() < 1e-4),
        "{found:?}"
    );
}
