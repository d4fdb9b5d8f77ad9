//! Residuals that are larger than an orthophoto's should be, and what they come of.

use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_raster::ranks::upper_median;

use super::{ChosenModel, MatchRow, RunResult, SolvedRun, Twins};
use crate::candidate::Candidate;
use autoref_solve::accuracy::error_map::Corner;
use autoref_solve::departure::{Departure, Residual, Shape};

/// A survey whose σ nobody states is this good, metres.
const USUAL_SURVEY_M: f64 = 0.02;
/// Residuals beyond this many times what is expected of them do not come of noise.
const TIMES: f64 = 3.0;
/// Less is no misfit, pixels: orthophotos are hardly truer.
pub const LEAST_MISFIT_PX: f64 = 2.0;
/// A stretch or a bend is told from so many pixels on, of the residuals or at a corner: residuals of tenths go with
/// corners that are ten times as far off.
const LEAST_STRETCH_PX: f64 = 0.5;
/// From a part to the middle of its mark, as a share of the way to the farthest part; with a little to spare.
const HALF_WAY: f64 = 0.6;
/// A figure is not larger than so many of its parts.
const MOST_PARTS: f64 = 3.0;
/// Whole marks score more.
const UNLIKE_SCORE: f64 = -6.0;
/// So large a share of marks in pieces is no chance.
const LEAST_IN_PIECES: f64 = 0.34;
/// The points do not fit as marks of an orthophoto do.
#[derive(Clone, Debug, PartialEq)]
pub enum Misfit {
    /// A transform of another kind explains most of the residuals, and leaves `left_px` at points that it has not seen.
    /// `corner_px` is how far it puts a corner from where the written one has it, at most.
    Departs { rmse_px: f64, left_px: f64, corner_px: f64, departure: Departure },
    /// Residuals that neither the marks' centres nor the survey explain.
    Bad { rmse_px: f64, expected_px: f64, worst_px: f64 },
    /// Centres or survey are known no better.
    Rough { rmse_px: f64, survey: Survey },
    /// Of many matched marks a part was measured. Parts that lie alike in their marks fit each other as well as the
    /// marks would. `off_px` is how far a part may lie from the middle of its mark, the median.
    InPieces { marks: usize, of: usize, off_px: f64 },
    /// What was matched hardly looks like whole marks: triangles and arrows, measured at their centroids. `off_px` is
    /// how large they are, the median.
    Unlike { off_px: f64 },
}

/// Where the accuracy of a list comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Survey {
    Stated,
    /// Nobody stated it: 20 mm in each axis.
    Assumed,
}

impl Misfit {
    /// Of what is written: the affine transform where that was chosen, else the similarity, whatever is reported beside
    /// it. `None` where the points fit, or nothing tells. Residuals count for the degrees of freedom that are left.
    pub fn of(result: &RunResult) -> Option<Misfit> {
        let run = result.solved()?;
        let rows = &run.matches;
        let mut off_px = in_pieces(rows, &result.candidates);
        let marks = off_px.len();
        let most = marks >= 3 && marks as f64 >= LEAST_IN_PIECES * rows.len() as f64;
        if let Some(part_px) = upper_median(&mut off_px).filter(|_| most) {
            // The other halves of figures lie all the same way.
            let halves_px = Twins::of(result).map_or(0.0, |twins| HALF_WAY * twins.apart_px);
            let off_px = part_px.max(halves_px.min(MOST_PARTS * part_px));
            return Some(Misfit::InPieces { marks, of: rows.len(), off_px });
        }
        if let Some(unlike) = unlike_marks(rows, &result.candidates) {
            return Some(unlike);
        }
        let (n, scale) = (rows.len() as f64, run.fit.scale_m_per_px);
        let is_affine = matches!(run.chosen_model, Some(ChosenModel::Affine(_)));
        // Half of its parameters, points' worth.
        let taken = if is_affine { 3.0 } else { 2.0 };
        if n < taken + 2.0 || scale.is_nan() || scale <= 0.0 {
            return None;
        }
        let rmse_px = residual_rms_px(rows.iter().map(|row| row.residual_px), taken);
        let worst_px = rows.iter().map(|row| row.residual_px).fold(0.0, f64::max);
        if !is_affine && let Some(departs) = departs(result, run, rmse_px) {
            return Some(departs);
        }
        if rmse_px < LEAST_MISFIT_PX {
            return None;
        }
        let expected = rows.iter().map(|row| {
            let survey_px = row.survey_sigma_m.unwrap_or(USUAL_SURVEY_M) / scale;
            row.covariance_px2.map_or(0.0, |c| c[0] + c[2]) + 2.0 * survey_px * survey_px
        });
        let expected_px = (expected.sum::<f64>() / n).sqrt();
        if rmse_px > TIMES * expected_px {
            return Some(Misfit::Bad { rmse_px, expected_px, worst_px });
        }
        let survey = if rows.iter().all(|row| row.survey_sigma_m.is_none()) { Survey::Assumed } else { Survey::Stated };
        Some(Misfit::Rough { rmse_px, survey })
    }

    /// How far a place of the image may be off beyond what a similarity's noise lets expect, pixels at most about.
    pub fn beyond_px(&self, pixel: PixelPoint, scale_m_per_px: f64) -> f64 {
        match self {
            Misfit::InPieces { off_px, .. } | Misfit::Unlike { off_px, .. } => *off_px,
            Misfit::Departs { departure, .. } => departure.at_m(pixel) / scale_m_per_px,
            Misfit::Bad { worst_px, .. } => *worst_px,
            Misfit::Rough { .. } => 0.0,
        }
    }

    /// An expected error of the fit alone at `pixel`, with what the fit does not know.
    pub fn with_m(&self, expected_m: f64, pixel: PixelPoint, scale_m_per_px: f64) -> f64 {
        let beyond_m = self.beyond_px(pixel, scale_m_per_px) * scale_m_per_px;
        match self {
            // A bend is there for certain; its own noise is what the residuals show.
            Misfit::Departs { .. } => expected_m + beyond_m,
            _ => expected_m.hypot(beyond_m),
        }
    }

    /// One line for the verdict of a run that was solved.
    pub fn verdict(&self) -> String {
        format!("solved, but {}", self.clause())
    }

    /// What is to be said against the fit, as a part of a sentence.
    pub fn clause(&self) -> String {
        match self {
            Misfit::Departs { rmse_px, left_px, corner_px, departure, .. } => {
                let (what, with) = match departure.shape {
                    Shape::Stretched => ("stretched or sheared in the CRS of the fit", "--model affine"),
                    Shape::Domed => ("bent as by a lens", "a bend that grows outwards"),
                    Shape::Bent => ("bent", "a bend of the second degree"),
                };
                let (rmse, left, corner) = (few(*rmse_px), few(*left_px), few(*corner_px));
                format!(
                    "the image is {what}: residuals of {rmse} px, {left} px with {with}, and up to {corner} px in the corners"
                )
            }
            Misfit::Bad { rmse_px, .. } => {
                format!("the points fit badly ({rmse_px:.1} px): do not trust it before you know why")
            }
            Misfit::Rough { rmse_px, .. } => {
                format!("the points fit only to {rmse_px:.1} px: where marks and survey are better, something is wrong")
            }
            Misfit::Unlike { .. } => {
                "what was matched hardly looks like whole marks: do not trust it to less than their \
                                      width before you have looked at their pictures"
                    .to_string()
            }
            Misfit::InPieces { marks, of, .. } => format!(
                "{marks} of {of} marks lie in pieces, of which one was measured: do not trust it to less than \
                 a mark's width"
            ),
        }
    }

    /// What may be the cause, and the remedy.
    pub fn note(&self) -> String {
        let parts = "parts of marks were measured (unless it is named already, name their paint with --paint, or their --profile)";
        match self {
            Misfit::Departs { rmse_px, left_px, departure, .. } => {
                let (what, remedy) = match departure.shape {
                    Shape::Stretched => ("an affine transform", "make it anew, or take --model affine"),
                    Shape::Domed | Shape::Bent => {
                        ("a bent image", "make it anew with GCPs in the adjustment. Expected errors count the bend")
                    }
                };
                let (rmse, left) = (few(*rmse_px), few(*left_px));
                format!(
                    "the points fit a similarity to {rmse} px and {what} to {left} px: the image is no true orthophoto; {remedy}"
                )
            }
            Misfit::Bad { rmse_px, expected_px, .. } => format!(
                "residuals of {rmse_px:.1} px where marks and survey let expect {expected_px:.1} px: {parts}, coordinates \
                 of the list are wrong, or the image is bent"
            ),
            Misfit::Rough { rmse_px, survey } => {
                let allowed = match survey {
                    Survey::Stated => "which the marks' centres and the stated survey allow",
                    Survey::Assumed => {
                        "which the 20 mm allow that are assumed of a survey whose accuracy nobody states"
                    }
                };
                format!(
                    "residuals of {rmse_px:.1} px, {allowed}: state how good the survey is (--accuracy); where it is \
                     better, points are wrong, the image is bent or shifted in parts, or {parts}"
                )
            }
            Misfit::Unlike { .. } => format!(
                "half of the matched marks have scores below {UNLIKE_SCORE:.0}: triangles, arrows, L and T are measured at their \
                 centroids, whatever their points are; look at their pictures in the report, or name their shape and \
                 paint with a --profile"
            ),
            Misfit::InPieces { marks, of, .. } => format!(
                "{marks} of {of} marks lie in pieces: other candidates lie beside them, or their centres are uncertain by a \
                 good part of their width; {parts}, and the whole image may be as far off as a mark is wide; name the size \
                 too (--mark-size)"
            ),
        }
    }
}

/// Pixels with one digit behind the point, below one with two.
fn few(px: f64) -> String {
    if px < 0.95 { format!("{px:.2}") } else { format!("{px:.1}") }
}

/// Whether the image is stretched or bent, by residuals or at a corner that may lie far beyond the marks.
fn departs(result: &RunResult, run: &SolvedRun, rmse_px: f64) -> Option<Misfit> {
    let (rows, scale) = (&run.matches, run.fit.scale_m_per_px);
    let [_, a, b, _, c, d] = run.geotransform.0;
    let written = || Handedness::from(a * d - b * c > 0.0);
    let handedness = run.solution.as_ref().map_or_else(written, |solution| solution.similarity.mirrored);
    let departure = Departure::of(&residuals(rows), handedness, middle(result, rows))?;
    let size_px = result.extent_px();
    let corners = Corner::CLOCKWISE.map(|corner| corner.place(size_px));
    let most_px = |of: &dyn Fn(PixelPoint) -> f64| corners.iter().map(|at| of(*at)).fold(0.0, f64::max) / scale;
    let (corner_px, fitted_px) = (most_px(&|at| departure.at_m(at)), most_px(&|at| departure.fitted_m(at)));
    let left_px = departure.left_m / scale;
    let is_worth_saying = rmse_px.max(fitted_px) >= LEAST_STRETCH_PX;
    is_worth_saying.then_some(Misfit::Departs { rmse_px, left_px, corner_px, departure })
}

/// Of the matched marks of which a part may have been measured, how far that may be from their middle, pixels: another
/// candidate of about the size lies beside them, nearer than they are wide, or their centre is stated to be as
/// uncertain as only a part's is.
fn in_pieces(rows: &[MatchRow], candidates: &[Candidate]) -> Vec<f64> {
    /// In sides of the candidate; what is nearer than the first is the same mark, seen twice (a ring and its disc).
    const BESIDE: std::ops::Range<f64> = 0.15..1.3;
    /// A number that is painted beside a mark is smaller.
    const MOST_UNLIKE: f64 = 4.0;
    /// Standard deviation of the centre, in sides.
    const UNCERTAIN: f64 = 0.25;
    const LEAST_SIDE_PX: f64 = 4.0;
    /// Radius that holds 95 of 100 errors of both coordinates, in standard deviations of one.
    const RAYLEIGH_95: f64 = 2.4477;
    let in_part = |row: &MatchRow| {
        let distance = |c: &Candidate| (c.centre.x - row.x).hypot(c.centre.y - row.y);
        let own = candidates.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let area_px = own.area_px?;
        let side_px = area_px.sqrt().max(LEAST_SIDE_PX);
        // A centre that was measured again, or moved by hand, need not be a candidate's.
        if distance(own) >= BESIDE.end * side_px {
            return None;
        }
        let is_beside = |c: &Candidate| {
            let unlike = c.area_px.map_or(1.0, |other| (other / area_px).max(area_px / other));
            !std::ptr::eq(c, own) && BESIDE.contains(&(distance(c) / side_px)) && unlike < MOST_UNLIKE
        };
        let sigma_px = row.covariance_px2.map_or(0.0, |c| ((c[0] + c[2]) / 2.0).sqrt());
        let beside: Vec<&Candidate> = candidates.iter().filter(|c| is_beside(c)).collect();
        let is_in_part = sigma_px > UNCERTAIN * side_px || !beside.is_empty();
        // A part that lies in fragments itself is as small as one of them: the middle is half-way to the farthest.
        let reach_px = farthest_fragment_px(own, &beside, candidates, BESIDE.end);
        is_in_part.then_some(side_px.max(RAYLEIGH_95 * sigma_px).max(HALF_WAY * reach_px))
    };
    rows.iter().filter_map(in_part).collect()
}

/// How far the farthest of the fragments lies that hang together with a candidate, each nearer to another than `reach`
/// sides.
fn farthest_fragment_px(own: &Candidate, beside: &[&Candidate], candidates: &[Candidate], reach: f64) -> f64 {
    /// A figure has no more fields and fragments of them.
    const MOST: usize = 8;
    const LEAST_SIDE_PX: f64 = 4.0;
    let apart = |a: &Candidate, b: &Candidate| (a.centre.x - b.centre.x).hypot(a.centre.y - b.centre.y);
    let side_px = |c: &Candidate| c.area_px.map_or(0.0, f64::sqrt);
    let mut together: Vec<&Candidate> = beside.to_vec();
    let mut looked = 0;
    while looked < together.len() && together.len() < MOST {
        let from = together[looked];
        let joins = |c: &&Candidate| {
            let near = reach * side_px(from).min(side_px(c)).max(LEAST_SIDE_PX);
            !std::ptr::eq(*c, own) && !together.iter().any(|known| std::ptr::eq(*known, *c)) && apart(from, c) < near
        };
        let joining: Vec<&Candidate> = candidates.iter().filter(joins).collect();
        together.extend(joining);
        looked += 1;
    }
    together.iter().take(MOST).map(|c| apart(own, c)).fold(0.0, f64::max)
}

/// Whether the matched marks, most of them, score as no whole marks do.
fn unlike_marks(rows: &[MatchRow], candidates: &[Candidate]) -> Option<Misfit> {
    /// Worn marks that a second pass finds score more, as a rule. What is not of the profile's size has far less.
    const SCORES: std::ops::Range<f64> = -30.0..UNLIKE_SCORE;
    let mut scores: Vec<f64> = rows.iter().filter_map(|row| row.score).collect();
    if scores.len() < 3 || 2 * scores.len() < rows.len() {
        return None;
    }
    let score = upper_median(&mut scores)?;
    let side = |row: &MatchRow| {
        let distance = |c: &Candidate| (c.centre.x - row.x).hypot(c.centre.y - row.y);
        let own = candidates.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let size_px = own.size_px.map(|[a, b]| a.max(b)).or(own.area_px.map(f64::sqrt))?;
        (distance(own) <= size_px).then_some(size_px)
    };
    let mut sides: Vec<f64> = rows.iter().filter_map(side).collect();
    let off_px = upper_median(&mut sides).unwrap_or(0.0);
    SCORES.contains(&score).then_some(Misfit::Unlike { off_px })
}

/// RMS of the lengths of residuals, for the degrees of freedom that are left: `taken` is how many points' worth the fit
/// takes, 2 of a similarity.
pub fn residual_rms_px(residuals_px: impl Iterator<Item = f64>, taken: f64) -> f64 {
    let (n, square) = residuals_px.fold((0.0, 0.0), |(n, sum), residual| (n + 1.0, sum + residual * residual));
    (square / f64::max(n - taken, 1.0)).sqrt()
}

fn residuals(rows: &[MatchRow]) -> Vec<Residual> {
    let pixel = |row: &MatchRow| PixelPoint { x: row.x, y: row.y };
    rows.iter().map(|row| Residual { pixel: pixel(row), east_m: row.residual_e_m, north_m: row.residual_n_m }).collect()
}

/// The middle of the image, or of the marks where its size is not known.
fn middle(result: &RunResult, rows: &[MatchRow]) -> PixelPoint {
    let n = rows.len() as f64;
    let of_marks = || PixelPoint {
        x: rows.iter().map(|row| row.x).sum::<f64>() / n,
        y: rows.iter().map(|row| row.y).sum::<f64>() / n,
    };
    result.size_px().map_or_else(of_marks, |(width, height)| PixelPoint { x: width / 2.0, y: height / 2.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_that_score_as_none_do_are_told() {
        let row = |(i, score): (usize, f64)| -> MatchRow {
            serde_json::from_value(serde_json::json!({
                "gcp": "A", "x": 100.0 * i as f64, "y": 50.0, "easting": 0.0, "northing": 0.0, "height": null,
                "survey_sigma_m": null, "residual_e_m": 0.0, "residual_n_m": 0.0, "residual_px": 0.0,
                "covariance_px2": null, "score": score, "found_by": "scan", "leave_one_out_m": null, "redundancy": null,
                "detectable_blunder_m": null, "outlier": false
            }))
            .expect("a row")
        };
        let mark = |x: f64| Candidate { size_px: Some([19.0, 22.0]), ..Candidate::at(PixelPoint { x, y: 50.2 }) };
        let marks: Vec<Candidate> = (0..5).map(|i| mark(100.0 * f64::from(i))).collect();
        let of = |scores: [f64; 5]| unlike_marks(&scores.into_iter().enumerate().map(row).collect::<Vec<_>>(), &marks);
        assert_eq!(of([-9.0, -8.5, -11.0, -7.0, -9.6]), Some(Misfit::Unlike { off_px: 22.0 }));
        assert_eq!(of([15.0, -9.0, 3.0, -8.0, 0.5]), None, "two of five");
        assert_eq!(of([-50.0; 5]), None, "of another size than the profile's");
    }

    #[test]
    fn marks_with_candidates_beside_them_lie_in_pieces() {
        let row = |x: f64| -> MatchRow {
            serde_json::from_value(serde_json::json!({
                "gcp": "A", "x": x, "y": 50.0, "easting": 0.0, "northing": 0.0, "height": null, "survey_sigma_m": null,
                "residual_e_m": 0.0, "residual_n_m": 0.0, "residual_px": 0.0, "covariance_px2": null, "score": 9.0,
                "found_by": "scan", "leave_one_out_m": null, "redundancy": null, "detectable_blunder_m": null,
                "outlier": false
            }))
            .expect("a row")
        };
        let candidate =
            |x: f64, area_px: f64| Candidate { area_px: Some(area_px), ..Candidate::at(PixelPoint { x, y: 50.0 }) };
        let rows: Vec<MatchRow> = [100.0, 200.0, 300.0].map(row).into();
        let alone: Vec<Candidate> = [100.1, 200.0, 300.0, 250.0].map(|x| candidate(x, 100.0)).into();
        assert!(in_pieces(&rows, &alone).is_empty());
        let pieces = [candidate(109.0, 30.0), candidate(212.0, 30.0), candidate(320.0, 30.0)];
        let both = |other: &[Candidate]| in_pieces(&rows, &[&alone[..], other].concat());
        assert_eq!(both(&pieces), [10.0, 10.0], "20 px away is another thing");
        let ring_and_disc = [100.2, 200.3].map(|x| candidate(x, 40.0));
        assert!(both(&ring_and_disc).is_empty(), "the same mark seen twice");
        let mut fragments = pieces.to_vec();
        fragments.extend([115.0, 121.0].map(|x| candidate(x, 30.0)));
        let off = both(&fragments);
        assert!(off.len() == 2 && (off[0] - 0.6 * 20.9).abs() < 1e-9, "a piece of a piece lies 21 px away: {off:?}");
        let numbers = [109.0, 209.0].map(|x| candidate(x, 20.0));
        assert!(both(&numbers).is_empty(), "small digits beside the marks");
        let mut moved = rows.clone();
        moved[0].x += 4.0;
        moved[1].x += 40.0;
        assert!(in_pieces(&moved, &alone).is_empty(), "moved by hand, or measured where no candidate lay");
        let mut uncertain = rows.clone();
        uncertain[2].covariance_px2 = Some([9.0, 0.0, 9.0]);
        uncertain[1].covariance_px2 = Some([1.0, 0.0, 1.0]);
        assert_eq!(in_pieces(&uncertain, &alone), [10.0]);
    }
}
