//! The gross-error diagnosis: every mistake it knows, made in the two lists of the thesis, and correct lists, about
//! which it must say nothing.

use crate::common::{Random, bare_candidate};
use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::units::{FOOT_M, US_SURVEY_FOOT_M};
use autoref_solve::Similarity;
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::Gcp;
use autoref_stream::matching::diagnosis::{Certainty, Diagnosis, GrossErrors, KnownPlace, Mistake, exchanged_labels};
use autoref_stream::matching::{MatchOutcome, Matcher, Priors, RobustMatcher};

/// A list, what was found in the image, and what is known of the image.
#[derive(Clone)]
struct Setting {
    what: &'static str,
    gcps: Vec<Gcp>,
    candidates: Vec<Candidate>,
    /// GCPs that have a mark.
    visible: Vec<usize>,
    gsd: f64,
    size: (f64, f64),
    truth: Similarity,
}

impl Setting {
    fn priors(&self) -> Priors {
        Priors {
            gsd_m_per_px: Some((self.gsd * 0.9, self.gsd * 1.1)),
            rotation_deg: None,
            image_size_px: Some(self.size),
        }
    }

    fn known(&self) -> KnownPlace {
        let centre_px = PixelPoint { x: self.size.0 / 2.0, y: self.size.1 / 2.0 };
        KnownPlace { centre: self.truth.apply(centre_px), centre_px }
    }

    fn edit(&self, edit: impl Fn(&mut Gcp)) -> Setting {
        let mut setting = self.clone();
        setting.gcps.iter_mut().for_each(edit);
        setting
    }

    fn ask(&self, priors: &Priors, crs: Option<&Crs>, known: Option<KnownPlace>) -> (bool, Vec<Diagnosis>) {
        let matcher = RobustMatcher::default();
        let outcome = matcher.find(&self.candidates, &self.gcps, priors);
        let errors = GrossErrors { candidates: &self.candidates, gcps: &self.gcps, priors, crs, known, matcher };
        match outcome {
            MatchOutcome::Solved(solved) => (true, errors.on_solution(&solved.pattern)),
            MatchOutcome::NoMatch(evidence) => (false, errors.on_refusal(evidence.best.as_ref())),
        }
    }

    #[track_caller]
    fn must_name(&self, mistake: Mistake, answer: &(bool, Vec<Diagnosis>), gcps: &[usize]) {
        let names: Vec<&str> = gcps.iter().map(|&g| self.gcps[g].name.as_str()).collect();
        let found =
            answer.1.iter().find(|d| d.mistake == mistake && names.iter().all(|n| d.gcps.iter().any(|g| g == n)));
        println!("{}: {answer:?}", self.what);
        assert!(found.is_some(), "{}: {mistake:?} of {names:?} is not named: {answer:?}", self.what);
    }
}

/// The real detections of Lerkendal: 14 of 20 GCPs among 294 candidates.
fn lerkendal() -> Option<Setting> {
    let candidates = crate::common::thesis_candidates("thesis/b3_candidates.csv")?;
    let gcps = crate::common::thesis_gcps("thesis/b1_lerkendal_gcps.csv")?;
    let MatchOutcome::Solved(solved) = RobustMatcher::default().find(&candidates, &gcps, &Priors::default()) else {
        panic!("the correct list fits")
    };
    Some(Setting {
        what: "Lerkendal",
        visible: solved.pattern.pairs.iter().map(|pair| pair.1).collect(),
        gcps,
        candidates,
        gsd: 0.032,
        size: (22_039.0, 20_051.0),
        truth: solved.pattern.similarity,
    })
}

/// An image somewhere over the E6 list, `visible` marks with 0.5 px of error, and false candidates.
fn e6(random: &mut Random, visible: usize, false_candidates: usize) -> Option<Setting> {
    let gcps = crate::common::thesis_gcps("thesis/b2_e6_gcps.csv")?;
    let (size, gsd) = ((15_828.0, 47_619.0), 0.03);
    loop {
        let angle = random.uniform(-20.0, 20.0).to_radians();
        let (a_re, a_im) = (gsd * angle.cos(), gsd * angle.sin());
        let anchor = gcps[random.below(gcps.len())].position();
        let (x, y) = (random.uniform(0.0, size.0), -random.uniform(0.0, size.1));
        let truth = Similarity {
            a_re,
            a_im,
            easting_0: anchor.easting - (a_re * x - a_im * y),
            northing_0: anchor.northing - (a_im * x + a_re * y),
            mirrored: Handedness::AsIs,
        };
        let inside: Vec<usize> = (0..gcps.len())
            .filter(|&i| {
                let p = truth.invert(gcps[i].position());
                p.x >= 0.0 && p.y >= 0.0 && p.x < size.0 && p.y < size.1
            })
            .collect();
        if inside.len() < visible {
            continue;
        }
        let visible: Vec<usize> = random.order(inside.len()).into_iter().take(visible).map(|i| inside[i]).collect();
        let mut candidates: Vec<Candidate> = visible
            .iter()
            .map(|&i| {
                let p = truth.invert(gcps[i].position());
                bare_candidate(p.x + 0.5 * random.normal(), p.y + 0.5 * random.normal())
            })
            .collect();
        candidates.extend(
            (0..false_candidates).map(|_| bare_candidate(random.uniform(0.0, size.0), random.uniform(0.0, size.1))),
        );
        return Some(Setting { what: "E6", gcps, candidates, visible, gsd, size, truth });
    }
}

fn settings(visible: usize, false_candidates: usize) -> Vec<Setting> {
    [lerkendal(), e6(&mut Random::new(31), visible, false_candidates)].into_iter().flatten().collect()
}

#[test]
fn swapped_columns_and_mirrored_images_are_told_apart() {
    for setting in settings(7, 300) {
        let swapped = setting.edit(|g| std::mem::swap(&mut g.easting, &mut g.northing));
        let answer = swapped.ask(&swapped.priors(), None, None);
        assert!(!answer.0);
        swapped.must_name(Mistake::EastingNorthingSwapped, &answer, &[]);
        let mut mirrored = setting.clone();
        mirrored.candidates.iter_mut().for_each(|c| c.centre.x = setting.size.0 - c.centre.x);
        let answer = mirrored.ask(&mirrored.priors(), None, None);
        assert!(!answer.0);
        mirrored.must_name(Mistake::MirroredImage, &answer, &[]);
        assert_eq!(answer.1[0].certainty, Certainty::Claimed);
    }
}

#[test]
fn feet_show_in_the_scale_and_their_kind_in_the_place() {
    for (place, setting) in settings(5, 300).into_iter().enumerate() {
        let feet = [(FOOT_M, Mistake::InternationalFeet), (US_SURVEY_FOOT_M, Mistake::UsSurveyFeet)];
        // Each list in one kind of feet; in both with AUTOREF_LARGE=1.
        let asked = if crate::common::large() { &feet[..] } else { &feet[place..][..1] };
        for &(foot, kind) in asked {
            let feet = setting.edit(|g| (g.easting, g.northing) = (g.easting / foot, g.northing / foot));
            let answer = feet.ask(&feet.priors(), None, None);
            assert!(!answer.0, "feet for metres must not fit a known scale");
            feet.must_name(Mistake::Feet, &answer, &[]);
            // Without the scale it fits, and the image's own place tells.
            let unknown = Priors { gsd_m_per_px: Some((0.02, 0.2)), ..feet.priors() };
            let answer = feet.ask(&unknown, None, Some(setting.known()));
            assert!(answer.0);
            // The international and the US survey foot are 14 m apart here: a smaller image would tell them from each
            // other as well as a place that is right to a few metres, which this one is.
            feet.must_name(kind, &answer, &[]);
        }
        let priors = Priors {
            gsd_m_per_px: Some((0.09 * setting.gsd / 0.0305, 0.11 * setting.gsd / 0.0305)),
            ..setting.priors()
        };
        let answer = setting.ask(&priors, None, None);
        assert!(!answer.0);
        setting.must_name(Mistake::GsdInFeet, &answer, &[]);
    }
}

#[test]
fn exchanged_coordinates_of_two_points_are_named() {
    for setting in settings(9, 200) {
        let (i, j) = (setting.visible[1], setting.visible[4]);
        let mut wrong = setting.clone();
        (wrong.gcps[i].easting, wrong.gcps[j].easting) = (setting.gcps[j].easting, setting.gcps[i].easting);
        let answer = wrong.ask(&wrong.priors(), None, None);
        wrong.must_name(Mistake::CoordinatesExchanged, &answer, &[i, j]);
    }
}

#[test]
fn a_mistyped_or_transposed_digit_is_named() {
    for setting in settings(7, 30) {
        let i = setting.visible[2];
        let mut wrong = setting.clone();
        let tens = (setting.gcps[i].northing / 10.0).floor() as i64 % 10;
        wrong.gcps[i].northing += if tens < 5 { 40.0 } else { -40.0 };
        let answer = wrong.ask(&wrong.priors(), None, None);
        wrong.must_name(Mistake::MistypedDigit, &answer, &[i]);
        // Digits that differ, in the easting: tens and ones.
        let digits = |g: usize| {
            let e = setting.gcps[g].easting.floor() as i64;
            (e / 10 % 10, e % 10)
        };
        let &j = setting.visible.iter().find(|&&g| digits(g).0 != digits(g).1).expect("some number has two digits");
        let mut wrong = setting.clone();
        let (tens, ones) = digits(j);
        wrong.gcps[j].easting += 9.0 * (ones - tens) as f64;
        let answer = wrong.ask(&wrong.priors(), None, None);
        wrong.must_name(Mistake::TransposedDigits, &answer, &[j]);
    }
}

/// A digit was "mended" though six times the deviation of the other points was left over.
#[test]
fn a_repair_that_leaves_more_than_the_other_points_do_is_not_offered() {
    for mut setting in settings(7, 30) {
        for &i in &setting.visible {
            let p = setting.truth.invert(setting.gcps[i].position());
            setting.candidates.push(bare_candidate(p.x, p.y));
        }
        let places: Vec<PixelPoint> =
            setting.candidates[setting.candidates.len() - setting.visible.len()..].iter().map(|c| c.centre).collect();
        // Without noise of their own, and none of the old ones beside them.
        setting
            .candidates
            .retain(|c| places.iter().all(|p| *p == c.centre || (p.x - c.centre.x).hypot(p.y - c.centre.y) > 50.0));
        let i = setting.visible[2];
        let at = setting.truth.invert(setting.gcps[i].position());
        let tens = (setting.gcps[i].northing / 10.0).floor() as i64 % 10;
        setting.gcps[i].northing += if tens < 5 { 40.0 } else { -40.0 };
        let named = |setting: &Setting| {
            let (_, told) = setting.ask(&setting.priors(), None, None);
            told.iter().any(|d| d.gcps.contains(&setting.gcps[i].name))
        };
        assert!(named(&setting), "{}: a repair that fits is offered", setting.what);
        let own = setting.candidates.iter_mut().find(|c| c.centre == at).expect("the mark of the point");
        own.centre.x += 2.5;
        assert!(!named(&setting), "{}: 2.5 px are left over", setting.what);
    }
}

/// A point that lies as well as its list says was "mended" by a digit of the decimetres.
#[test]
fn a_digit_is_not_doubted_within_the_stated_accuracy() {
    for mut setting in settings(7, 30) {
        let i = setting.visible[2];
        let place = setting.truth.invert(setting.gcps[i].position());
        // Its mark and no other, exactly where it was listed.
        setting.candidates.retain(|c| (place.x - c.centre.x).hypot(place.y - c.centre.y) > 50.0);
        setting.candidates.push(bare_candidate(place.x, place.y));
        let tenths = (setting.gcps[i].northing * 10.0).floor() as i64 % 10;
        setting.gcps[i].northing += if tenths < 5 { 0.4 } else { -0.4 };
        for (stated, is_named) in [(None, true), (Some(0.02), true), (Some(0.15), false)] {
            setting.gcps[i].sigma_m = stated;
            let (_, told) = setting.ask(&setting.priors(), None, None);
            let named = told.iter().any(|d| d.gcps.contains(&setting.gcps[i].name));
            assert_eq!(named, is_named, "{}: {stated:?} {told:?}", setting.what);
        }
    }
}

#[test]
fn a_wrong_zone_shows_in_the_place_and_in_single_rows() {
    let (zone_32, zone_33) = (Crs::from_epsg(25832).expect("a zone"), Crs::from_epsg(25833).expect("a zone"));
    let to_33 = |g: &mut Gcp| {
        let mut point = [Coordinate { x: g.easting, y: g.northing, height: None }];
        zone_32.transform(&mut point, &zone_33, 1.0).expect("a projection");
        (g.easting, g.northing) = (point[0].x, point[0].y);
    };
    for setting in settings(9, 200) {
        let all = setting.edit(to_33);
        let answer = all.ask(&all.priors(), Some(&zone_32), Some(setting.known()));
        assert!(answer.0, "another zone is the same pattern");
        all.must_name(Mistake::WrongUtmZone, &answer, &[]);
        let mut some = setting.clone();
        let rows = &setting.visible[..2];
        rows.iter().for_each(|&g| to_33(&mut some.gcps[g]));
        let answer = some.ask(&some.priors(), Some(&zone_32), None);
        some.must_name(Mistake::WrongUtmZone, &answer, rows);
        // A sharp idea of north does not agree with another zone's meridian.
        let north = Priors { rotation_deg: Some((setting.truth.rotation_deg(), 1.0)), ..all.priors() };
        let answer = all.ask(&north, Some(&zone_32), None);
        assert!(!answer.0);
        all.must_name(Mistake::WrongUtmZone, &answer, &[]);
    }
}

#[test]
fn a_ground_factor_shows_in_the_place() {
    for setting in settings(7, 200) {
        let ground = setting.edit(|g| (g.easting, g.northing) = (g.easting * 1.0004, g.northing * 1.0004));
        let answer = ground.ask(&ground.priors(), None, Some(setting.known()));
        assert!(answer.0);
        ground.must_name(Mistake::GridToGround, &answer, &[]);
    }
}

#[test]
fn leading_digits_show_in_the_place() {
    for (east, north) in [(0.0, -7_000_000.0), (-500_000.0, -7_000_000.0), (32_000_000.0, 0.0), (0.0, -30_000.0)] {
        for setting in settings(7, 50) {
            let short = setting.edit(|g| (g.easting, g.northing) = (g.easting + east, g.northing + north));
            let answer = short.ask(&short.priors(), None, Some(setting.known()));
            assert!(answer.0);
            short.must_name(Mistake::LeadingDigits, &answer, &[]);
        }
    }
    // Ten kilometres and something is a place of its own.
    for setting in settings(7, 50) {
        let elsewhere = setting.edit(|g| g.northing += 14_321.0);
        let answer = elsewhere.ask(&elsewhere.priors(), None, Some(setting.known()));
        assert!(answer.1.iter().all(|d| d.mistake != Mistake::LeadingDigits), "{answer:?}");
    }
}

#[test]
fn single_rows_with_swapped_columns_or_in_feet_are_named() {
    for setting in settings(9, 200) {
        let rows = &setting.visible[..2];
        let mut swapped = setting.clone();
        for &g in rows {
            let gcp = &mut swapped.gcps[g];
            std::mem::swap(&mut gcp.easting, &mut gcp.northing);
        }
        let answer = swapped.ask(&swapped.priors(), None, None);
        swapped.must_name(Mistake::EastingNorthingSwapped, &answer, rows);
        let mut feet = setting.clone();
        for &g in rows {
            let gcp = &mut feet.gcps[g];
            (gcp.easting, gcp.northing) = (gcp.easting / FOOT_M, gcp.northing / FOOT_M);
        }
        let answer = feet.ask(&feet.priors(), None, None);
        feet.must_name(Mistake::InternationalFeet, &answer, rows);
    }
}

#[test]
fn exchanged_labels_show_when_marks_carry_names() {
    for setting in settings(7, 100) {
        let MatchOutcome::Solved(solved) =
            RobustMatcher::default().find(&setting.candidates, &setting.gcps, &setting.priors())
        else {
            panic!("the correct list fits")
        };
        let mut labels: Vec<(usize, String)> =
            solved.pattern.pairs.iter().map(|&(c, g)| (c, setting.gcps[g].name.clone())).collect();
        assert_eq!(exchanged_labels(&labels, &solved.pattern, &setting.gcps), []);
        let (one, other) = (labels[1].1.clone(), labels[3].1.clone());
        (labels[1].1, labels[3].1) = (other.clone(), one.clone());
        let told = exchanged_labels(&labels, &solved.pattern, &setting.gcps);
        assert_eq!(told.len(), 1);
        assert_eq!(told[0].mistake, Mistake::LabelsExchanged);
        assert!(told[0].gcps.contains(&one) && told[0].gcps.contains(&other));
    }
}

/// Correct lists: with the pattern in the image, with a part of it, and without it.
#[test]
fn nothing_is_claimed_about_correct_lists() {
    let count = crate::common::trials(6, 600);
    let crs = Crs::from_epsg(25832).expect("a zone");
    let mut random = Random::new(77);
    let (mut solved, mut possible) = (0, 0);
    for trial in 0..count {
        let visible = [7, 0, 5, 4][trial % 4];
        let false_candidates = 20 + random.below(if trial % 4 == 1 { 300 } else { 600 });
        let Some(setting) = e6(&mut random, visible, false_candidates) else { return };
        // A place as good as a consumer receiver's.
        let mut known = setting.known();
        known.centre = MapPoint {
            easting: known.centre.easting + 5.0 * random.normal(),
            northing: known.centre.northing + 5.0 * random.normal(),
        };
        let known = (trial % 3 != 0).then_some(known);
        let (fits, told) = setting.ask(&setting.priors(), Some(&crs), known);
        solved += usize::from(fits);
        possible += usize::from(!told.is_empty());
        if trial % 50 == 49 {
            println!("{} lists, {solved} solved, {possible} with something mentioned as possible", trial + 1);
        }
        assert!(told.iter().all(|d| d.certainty == Certainty::Possible), "trial {trial}, {visible} visible: {told:?}");
    }
    println!("{count} correct lists, {solved} solved: 0 mistakes claimed, {possible} mentioned as possible");
    // The figure that is printed with a possibility is at most POSSIBLE_LOG10 for each kind of slip, of which there are
    // three.
    assert!(possible as f64 <= 3.0 + 0.06 * count as f64, "{possible} of {count}");
}

#[test]
fn the_real_lerkendal_list_is_correct() {
    let Some(setting) = lerkendal() else { return };
    let crs = Crs::from_epsg(25832).expect("a zone");
    let (fits, told) = setting.ask(&setting.priors(), Some(&crs), Some(setting.known()));
    assert!(fits && told.iter().all(|d| d.certainty == Certainty::Possible), "{told:?}");
}
