//! Residuals that are larger than an orthophoto's should be, and what they come of.

use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_solve::planar::{self, Kind};
use autoref_solve::similarity::Pair;

use super::SolvedRun;

/// A survey whose σ nobody states is this good, metres.
const USUAL_SURVEY_M: f64 = 0.02;
/// Residuals beyond this many times what is expected of them do not come of noise.
const TIMES: f64 = 3.0;
/// Less is no misfit, pixels: orthophotos are hardly truer.
pub const LEAST_MISFIT_PX: f64 = 2.0;
/// Residuals from which a stretched image is told, pixels.
const LEAST_STRETCH_PX: f64 = 0.5;
/// An affine transform explains them when it leaves less than this share at points that it has not seen: fewest points,
/// and the share.
const LEFT_BY_AFFINE: [(usize, f64); 2] = [(8, 0.4), (6, 0.25)];

/// The points do not fit as marks of an orthophoto do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Misfit {
    /// An affine transform explains most of the residuals.
    Stretched { rmse_px: f64, affine_px: f64 },
    /// Residuals that neither the marks' centres nor the survey explain.
    Bad { rmse_px: f64, expected_px: f64 },
    /// Centres or survey are known no better.
    Rough { rmse_px: f64 },
}

impl Misfit {
    /// Of what is written: the affine transform where that was chosen, else the similarity, whatever is reported beside
    /// it. `None` where the points fit, or nothing tells. Residuals count for the degrees of freedom that are left.
    pub fn of(run: &SolvedRun) -> Option<Misfit> {
        let rows = &run.matches;
        let (n, scale) = (rows.len() as f64, run.fit.scale_m_per_px);
        let is_affine = run.chosen_model.as_ref().is_some_and(|model| model["model"] == "affine");
        // Half of its parameters, points' worth.
        let taken = if is_affine { 3.0 } else { 2.0 };
        if n < taken + 2.0 || scale.is_nan() || scale <= 0.0 {
            return None;
        }
        let rmse_px = residual_rms_px(rows.iter().map(|row| row.residual_px), taken);
        if !is_affine
            && rmse_px >= LEAST_STRETCH_PX
            && let Some(affine_px) = affine_px(run)
        {
            let explains = |(fewest, share): &(usize, f64)| rows.len() >= *fewest && affine_px < share * rmse_px;
            if LEFT_BY_AFFINE.iter().any(explains) {
                return Some(Misfit::Stretched { rmse_px, affine_px });
            }
        }
        if rmse_px < LEAST_MISFIT_PX {
            return None;
        }
        let expected = rows.iter().map(|row| {
            let survey_px = row.survey_sigma_m.unwrap_or(USUAL_SURVEY_M) / scale;
            row.covariance_px2.map_or(0.0, |c| c[0] + c[2]) + 2.0 * survey_px * survey_px
        });
        let expected_px = (expected.sum::<f64>() / n).sqrt();
        let bad = rmse_px > TIMES * expected_px;
        Some(if bad { Misfit::Bad { rmse_px, expected_px } } else { Misfit::Rough { rmse_px } })
    }

    /// One line for the verdict.
    pub fn verdict(&self) -> String {
        match self {
            Misfit::Stretched { rmse_px, affine_px } => format!(
                "solved, but the image is stretched or sheared: residuals of {rmse_px:.1} px, {affine_px:.1} px with \
                 --model affine"
            ),
            Misfit::Bad { rmse_px, .. } => {
                format!("solved, but the points fit badly ({rmse_px:.1} px): do not trust it before you know why")
            }
            Misfit::Rough { rmse_px } => format!("solved, but only to {rmse_px:.1} px: marks or survey tell no better"),
        }
    }

    /// What may be the cause, and the remedy.
    pub fn note(&self) -> String {
        let parts = "parts of marks were measured (name their paint with --paint, or their --profile)";
        match self {
            Misfit::Stretched { rmse_px, affine_px } => format!(
                "the points fit a similarity to {rmse_px:.1} px and an affine transform to {affine_px:.1} px: the image is \
                 no true orthophoto; make it anew, or take --model affine"
            ),
            Misfit::Bad { rmse_px, expected_px } => format!(
                "residuals of {rmse_px:.1} px where marks and survey let expect {expected_px:.1} px: {parts}, coordinates \
                 of the list are wrong, or the image is bent"
            ),
            Misfit::Rough { rmse_px } => format!(
                "residuals of {rmse_px:.1} px, which the uncertain centres of the marks or the stated survey allow: {parts}, \
                 or they are worn or covered"
            ),
        }
    }
}

/// RMS of the lengths of residuals, for the degrees of freedom that are left: `taken` is how many points' worth the fit
/// takes, 2 of a similarity.
pub fn residual_rms_px(residuals_px: impl Iterator<Item = f64>, taken: f64) -> f64 {
    let (n, square) = residuals_px.fold((0.0, 0.0), |(n, sum), residual| (n + 1.0, sum + residual * residual));
    (square / f64::max(n - taken, 1.0)).sqrt()
}

/// RMSE of an affine transform at points that were left out of it, pixels.
fn affine_px(run: &SolvedRun) -> Option<f64> {
    let pair = |row: &super::MatchRow| Pair {
        pixel: PixelPoint { x: row.x, y: row.y },
        covariance_px2: None,
        map: MapPoint { easting: row.easting, northing: row.northing },
        survey_sigma_m: None,
    };
    let pairs: Vec<Pair> = run.matches.iter().map(pair).collect();
    let fit = planar::fit(&pairs, Kind::Affine).ok()?;
    Some(fit.leave_one_out_rmse_m? / run.fit.scale_m_per_px)
}
