//! The accuracy statement, as standards word it.
//!
//! ASPRS, "Positional Accuracy Standards for Digital Geospatial Data", Edition 2, 2023: the horizontal accuracy is the
//! radial root mean square error at independent check points, RMSE_H1 = √(RMSE_x² + RMSE_y²), with the error of their
//! own survey folded in, RMSE_H = √(RMSE_H1² + RMSE_H2²); heights likewise, RMSE_V = √(RMSE_V1² + RMSE_V2²); together
//! RMSE_3D = √(RMSE_H² + RMSE_V²). At least 30 check points are asked for; with fewer the statement must say so, and
//! without any it may only say what the data were produced to meet. The sentences are those that the standard
//! prescribes.
//!
//! FGDC-STD-007.3-1998, "National Standard for Spatial Data Accuracy" (NSSDA), on request: Accuracy_r = 2.4477 ·
//! (RMSE_x + RMSE_y) / 2 where the smaller is at least 0.6 of the larger (1.7308 · RMSE_r when they are equal),
//! Accuracy_z = 1.9600 · RMSE_z; at least 20 check points.

use autoref_raster::words::counted;
use serde::{Deserialize, Serialize};

/// Fewest check points that ASPRS Edition 2 accepts without a reservation.
pub const FEWEST_CHECK_POINTS: usize = 30;
/// The same of the NSSDA.
const FEWEST_NSSDA: usize = 20;
const STANDARD: &str = "ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2 (2023)";

/// A check point: what the result says there less what was surveyed, and how well that was.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckError {
    /// As the list has it.
    pub name: String,
    /// Computed − surveyed, metres.
    pub easting_m: f64,
    /// Likewise.
    pub northing_m: f64,
    /// Likewise; `None` where heights are not compared.
    pub height_m: Option<f64>,
    /// 1σ of the survey in each of easting and northing, metres.
    pub survey_sigma_m: Option<f64>,
    /// 1σ of the surveyed height, metres.
    pub survey_sigma_height_m: Option<f64>,
}

/// What is asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StatementOptions {
    /// The accuracy class that the data are to meet, metres; without it the smallest whole centimetre that they do.
    pub class_h_m: Option<f64>,
    /// Likewise of heights.
    pub class_v_m: Option<f64>,
    /// Add the NSSDA's figure at 95 % confidence.
    pub nssda: bool,
}

/// What the statement rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Basis {
    /// 30 check points or more.
    Tested,
    /// Check points, but fewer.
    TestedReduced,
    /// None: nothing was tested.
    Produced,
}

/// The figures of the horizontal position, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Horizontal {
    /// How many check points the figures rest on.
    pub check_points: usize,
    /// Mean of computed − surveyed.
    pub mean_e_m: f64,
    /// Likewise.
    pub mean_n_m: f64,
    /// √(mean square) of the differences in easting, divisor n.
    pub rmse_e_m: f64,
    /// Likewise in northing.
    pub rmse_n_m: f64,
    /// Of the differences at the check points: √(RMSE_x² + RMSE_y²).
    pub rmse_h1_m: f64,
    /// Of their survey, √(mean(σ_e² + σ_n²)) over those for which it is stated.
    pub rmse_h2_m: Option<f64>,
    /// √(RMSE_H1² + RMSE_H2²); without a stated survey error RMSE_H1.
    pub rmse_h_m: f64,
    /// The class that the statement names.
    pub class_m: f64,
}

/// The figures of the height, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vertical {
    /// How many check points with a height the figures rest on.
    pub check_points: usize,
    /// Mean of computed − surveyed.
    pub mean_m: f64,
    /// Of the differences at the check points.
    pub rmse_v1_m: f64,
    /// Of their survey, √(mean(σ²)) over those for which it is stated.
    pub rmse_v2_m: Option<f64>,
    /// √(RMSE_V1² + RMSE_V2²); without a stated survey error RMSE_V1.
    pub rmse_v_m: f64,
    /// The class that the statement names.
    pub class_m: f64,
}

/// Figures at 95 % confidence after the NSSDA, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Nssda {
    /// Radius that holds 95 of 100 positions.
    pub horizontal_95_m: f64,
    /// Deviation that 95 of 100 heights keep within.
    pub vertical_95_m: Option<f64>,
}

/// All figures of a statement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AccuracyFigures {
    /// What they rest on.
    pub basis: Basis,
    /// `None` without check points.
    pub horizontal: Option<Horizontal>,
    /// `None` without check points that have heights.
    pub vertical: Option<Vertical>,
    /// √(RMSE_H² + RMSE_V²), metres, where both are known.
    pub rmse_3d_m: Option<f64>,
    /// Where it was asked for.
    pub nssda: Option<Nssda>,
    /// √(mean(dE² + dN²)) of the control points, each left out of the fit in turn, metres.
    pub leave_one_out_m: Option<f64>,
}

/// The statement: figures, the sentences that the standard prescribes, and what must be said against them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AccuracyStatement {
    /// What was computed.
    pub figures: AccuracyFigures,
    /// The standard's wording with the figures in it.
    pub sentences: Vec<String>,
    /// What must be said against them, a sentence each.
    pub reservations: Vec<String>,
}

/// The statement from check points and, for want of any, from the leave-one-out errors (easting, northing, metres) of
/// the control points.
pub fn statement(
    checks: &[CheckError],
    leave_one_out_m: &[(f64, f64)],
    options: &StatementOptions,
) -> AccuracyStatement {
    let leave_one_out = rms(leave_one_out_m.iter().map(|(e, n)| e.hypot(*n)));
    let horizontal = horizontal(checks, options.class_h_m);
    let vertical = vertical(checks, options.class_v_m);
    let rmse_3d_m = horizontal.zip(vertical).map(|(h, v)| h.rmse_h_m.hypot(v.rmse_v_m));
    let basis = match checks.len() {
        0 => Basis::Produced,
        n if n < FEWEST_CHECK_POINTS => Basis::TestedReduced,
        _ => Basis::Tested,
    };
    let (mut sentences, mut reservations) = (Vec::new(), Vec::new());
    match &horizontal {
        Some(h) => {
            let tested = Tested {
                symbol: "RMSE_H",
                class_name: "Horizontal Positional Accuracy Class",
                found: "The tested horizontal positional accuracy",
                count: h.check_points,
                value_m: h.rmse_h_m,
                class_m: h.class_m,
            };
            sentences.push(tested.sentence());
            reservations.extend(count_reservation(h.check_points));
            reservations.extend(class_reservation(options.class_h_m));
            reservations.extend(horizontal_reservations(checks, h));
        }
        None => produced(options, leave_one_out, leave_one_out_m.len(), &mut sentences, &mut reservations),
    }
    if let Some(v) = &vertical {
        let tested = Tested {
            symbol: "RMSE_V",
            class_name: "Vertical Accuracy Class",
            found: "The Non-Vegetated Vertical Accuracy (NVA)",
            count: v.check_points,
            value_m: v.rmse_v_m,
            class_m: v.class_m,
        };
        sentences.push(tested.sentence());
        reservations.extend(vertical_reservations(checks.len(), v));
    }
    let nssda = options.nssda.then(|| horizontal.map(|h| nssda(&h, vertical.as_ref()))).flatten();
    if let (Some(n), Some(h)) = (&nssda, &horizontal) {
        nssda_text(n, h, vertical.as_ref(), &mut sentences, &mut reservations);
    }
    let figures = AccuracyFigures { basis, horizontal, vertical, rmse_3d_m, nssda, leave_one_out_m: leave_one_out };
    AccuracyStatement { figures, sentences, reservations }
}

fn rms(values: impl ExactSizeIterator<Item = f64>) -> Option<f64> {
    let n = values.len() as f64;
    (n > 0.0).then(|| (values.map(|v| v * v).sum::<f64>() / n).sqrt())
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    values.sum::<f64>() / n
}

fn horizontal(checks: &[CheckError], asked_m: Option<f64>) -> Option<Horizontal> {
    let rmse_e_m = rms(checks.iter().map(|c| c.easting_m))?;
    let rmse_n_m = rms(checks.iter().map(|c| c.northing_m))?;
    let rmse_h1_m = rmse_e_m.hypot(rmse_n_m);
    let surveyed: Vec<f64> = checks.iter().filter_map(|c| c.survey_sigma_m).collect();
    // Two coordinates of the same σ.
    let rmse_h2_m = rms(surveyed.into_iter()).map(|sigma| std::f64::consts::SQRT_2 * sigma);
    let rmse_h_m = rmse_h1_m.hypot(rmse_h2_m.unwrap_or(0.0));
    Some(Horizontal {
        check_points: checks.len(),
        mean_e_m: mean(checks.iter().map(|c| c.easting_m)),
        mean_n_m: mean(checks.iter().map(|c| c.northing_m)),
        rmse_e_m,
        rmse_n_m,
        rmse_h1_m,
        rmse_h2_m,
        rmse_h_m,
        class_m: asked_m.unwrap_or_else(|| class_for(rmse_h_m)),
    })
}

fn vertical(checks: &[CheckError], asked_m: Option<f64>) -> Option<Vertical> {
    let errors: Vec<f64> = checks.iter().filter_map(|c| c.height_m).collect();
    let rmse_v1_m = rms(errors.iter().copied())?;
    let surveyed: Vec<f64> =
        checks.iter().filter(|c| c.height_m.is_some()).filter_map(|c| c.survey_sigma_height_m).collect();
    let rmse_v2_m = rms(surveyed.into_iter());
    let rmse_v_m = rmse_v1_m.hypot(rmse_v2_m.unwrap_or(0.0));
    Some(Vertical {
        check_points: errors.len(),
        mean_m: mean(errors.iter().copied()),
        rmse_v1_m,
        rmse_v2_m,
        rmse_v_m,
        class_m: asked_m.unwrap_or_else(|| class_for(rmse_v_m)),
    })
}

/// The smallest class that a tested value meets: whole centimetres, below one centimetre whole millimetres.
fn class_for(tested_m: f64) -> f64 {
    let step_m = if tested_m <= 0.01 { 0.001 } else { 0.01 };
    // A value that is a whole number of steps but for rounding stays there.
    ((tested_m / step_m - 1e-9).ceil() * step_m).max(step_m)
}

/// A tested value and its class, ready for the prescribed sentences.
struct Tested {
    symbol: &'static str,
    class_name: &'static str,
    found: &'static str,
    count: usize,
    value_m: f64,
    class_m: f64,
}

impl Tested {
    fn sentence(&self) -> String {
        let Tested { symbol, class_name, found, count, .. } = self;
        let (class, value) = (class_cm(self.class_m), value_cm(self.value_m));
        // What rounds to the class meets it.
        let met = self.value_m <= self.class_m * (1.0 + 1e-9);
        if *count < FEWEST_CHECK_POINTS {
            let aim = if met {
                format!("This data set was produced to meet a {class} (cm) {symbol} {class_name}.")
            } else {
                format!("This data set does NOT meet the {class} (cm) {symbol} {class_name} that was asked for.")
            };
            return format!(
                "This data set was tested as required by {STANDARD}. Although the Standards call for a minimum of \
                 thirty (30) checkpoints, this test was performed using ONLY {count} checkpoints. {aim} {found} was \
                 found to be {symbol} = {value} (cm) using the reduced number of checkpoints."
            );
        }
        if met {
            format!(
                "This data set was tested to meet {STANDARD} for a {class} (cm) {symbol} {class_name}. {found} was found \
                 to be {symbol} = {value} (cm)."
            )
        } else {
            format!(
                "This data set was tested against {STANDARD} and does NOT meet the {class} (cm) {symbol} {class_name} \
                 that was asked for. {found} was found to be {symbol} = {value} (cm)."
            )
        }
    }
}

/// Without check points: what the data were produced to meet, no more.
fn produced(
    options: &StatementOptions,
    leave_one_out: Option<f64>,
    points: usize,
    sentences: &mut Vec<String>,
    reservations: &mut Vec<String>,
) {
    reservations.push(
        "No independent check point was measured, so nothing was tested: the standard allows no tested accuracy. Keep points \
         out of the fit with --check"
            .into(),
    );
    let class_m = options.class_h_m.or_else(|| leave_one_out.map(class_for));
    let Some(class_m) = class_m else { return };
    sentences.push(format!(
        "This data set was produced to meet {STANDARD} for a {} (cm) RMSE_H Horizontal Positional Accuracy Class.",
        class_cm(class_m)
    ));
    if let Some(value) = leave_one_out {
        let verdict = match options.class_h_m {
            None => "; no class was asked for (--accuracy-class), the one named follows from it",
            Some(_) if value > class_m => "; that is above the class that was asked for",
            Some(_) => "",
        };
        reservations.push(format!(
            "The only evidence are the {points} control points, each left out of the fit in turn: RMSE {} cm{verdict}",
            value_cm(value)
        ));
    }
}

fn count_reservation(count: usize) -> Option<String> {
    (count < FEWEST_CHECK_POINTS).then(|| {
        format!(
            "Only {}: the standard asks for {FEWEST_CHECK_POINTS}; from so few the RMSE itself is known to \
             about ±{:.0} %",
            counted(count, "check point", "check points"),
            // The standard deviation of a root mean square of 2n normal values.
            100.0 / (4.0 * count as f64).sqrt()
        )
    })
}

fn class_reservation(asked_m: Option<f64>) -> Option<String> {
    asked_m
        .is_none()
        .then(|| "No class was asked for (--accuracy-class); the one named is the smallest that is met".into())
}

fn horizontal_reservations(checks: &[CheckError], h: &Horizontal) -> Vec<String> {
    let mut out = Vec::new();
    let stated = checks.iter().filter(|c| c.survey_sigma_m.is_some()).count();
    match h.rmse_h2_m {
        None => out.push(
            "The survey's own error is not stated and not in the figure (--accuracy): RMSE_H is that of the differences alone"
                .into(),
        ),
        Some(survey) => {
            if stated < checks.len() {
                out.push(format!(
                    "The survey's own error is stated for {stated} of {} check points and taken to be the same for the others",
                    checks.len()
                ));
            }
            if survey > 0.5 * h.class_m {
                out.push(format!(
                    "The check points (RMSE {} cm) are not twice as accurate as the class, as the standard asks",
                    value_cm(survey)
                ));
            }
        }
    }
    let shift = h.mean_e_m.abs().max(h.mean_n_m.abs());
    if shift > 0.25 * h.class_m {
        out.push(format!(
            "The mean error (E {} cm, N {} cm) exceeds a quarter of the class: look for a shift between datums or surveys",
            signed_cm(h.mean_e_m),
            signed_cm(h.mean_n_m)
        ));
    }
    let blunders: Vec<&str> =
        checks.iter().filter(|c| c.easting_m.hypot(c.northing_m) > 3.0 * h.class_m).map(|c| c.name.as_str()).collect();
    if !blunders.is_empty() {
        out.push(format!("More than three times the class off, perhaps blunders: {}", blunders.join(", ")));
    }
    out
}

fn vertical_reservations(all: usize, v: &Vertical) -> Vec<String> {
    let mut out = Vec::new();
    if v.check_points < all {
        out.push(format!("Heights were checked at {} of {all} check points", v.check_points));
    }
    if v.rmse_v2_m.is_none() {
        out.push("The error of the surveyed heights is not stated and not in RMSE_V (--accuracy)".into());
    }
    out.push("All check points count as open ground (NVA): nothing is known of vegetation at them".into());
    out
}

fn nssda(h: &Horizontal, v: Option<&Vertical>) -> Nssda {
    let (low, high) = (h.rmse_e_m.min(h.rmse_n_m), h.rmse_e_m.max(h.rmse_n_m));
    let horizontal_95_m =
        if low >= 0.6 * high { 2.4477 * 0.5 * (h.rmse_e_m + h.rmse_n_m) } else { 1.7308 * h.rmse_h1_m };
    Nssda { horizontal_95_m, vertical_95_m: v.map(|v| 1.96 * v.rmse_v1_m) }
}

fn nssda_text(
    figures: &Nssda,
    h: &Horizontal,
    v: Option<&Vertical>,
    sentences: &mut Vec<String>,
    reservations: &mut Vec<String>,
) {
    sentences.push(format!(
        "NSSDA: Tested {:.3} meters horizontal accuracy at 95% confidence level.",
        figures.horizontal_95_m
    ));
    if let Some(vertical) = figures.vertical_95_m {
        sentences.push(format!("NSSDA: Tested {vertical:.3} meters vertical accuracy at 95% confidence level."));
    }
    let fewest = v.map_or(h.check_points, |v| v.check_points.min(h.check_points));
    if fewest < FEWEST_NSSDA {
        reservations.push(format!("NSSDA: asks for at least {FEWEST_NSSDA} check points, these are {fewest}"));
    }
    let (low, high) = (h.rmse_e_m.min(h.rmse_n_m), h.rmse_e_m.max(h.rmse_n_m));
    if low < 0.6 * high {
        reservations.push(
            "NSSDA: the errors in easting and northing differ too much for its formula; 1.7308 · RMSE_r stands in"
                .into(),
        );
    }
}

/// A class in centimetres, without needless digits.
fn class_cm(metres: f64) -> String {
    let text = format!("{:.2}", 100.0 * metres);
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

fn signed_cm(metres: f64) -> String {
    format!("{}{}", if metres < 0.0 { "-" } else { "+" }, value_cm(metres.abs()))
}

/// To a millimetre; below a centimetre to a tenth of one.
fn value_cm(metres: f64) -> String {
    format!("{:.*}", if metres.abs() < 0.01 { 2 } else { 1 }, 100.0 * metres)
}
