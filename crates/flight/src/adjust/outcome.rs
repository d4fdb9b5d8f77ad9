//! What an adjustment says.

use nalgebra::Vector3;

use super::adjusted::{AdjustedCamera, AdjustedPoint, Adjustment, Blunder};
use super::survey::{GroundPoint, Role};
use crate::bundle::{Deviations, Problem, Summary};
use crate::intersect::intersect_seen;
use crate::read::{Reconstruction, TiePoint};

/// The adjusted problem, and what is known of it.
pub(super) struct End {
    pub problem: Problem,
    pub deviations: Option<Deviations>,
    /// The model's ties that took part.
    pub kept: Vec<usize>,
    pub ties: usize,
    pub dropped_ties: usize,
    pub blunders: Vec<Blunder>,
    pub summary: Summary,
    pub sigma_tie_px: f64,
    pub notes: Vec<String>,
}

pub(super) fn outcome(
    world: &Reconstruction,
    points: &[GroundPoint],
    control: &[&GroundPoint],
    end: End,
) -> Adjustment {
    let End { problem, deviations, kept, ties, .. } = &end;
    let mut model =
        Reconstruction { cameras: problem.cameras.iter().map(|c| c.camera.clone()).collect(), ..world.clone() };
    for (p, f) in model.photographs.iter_mut().zip(&problem.frames) {
        p.pose = f.pose;
    }
    model.ties = kept
        .iter()
        .zip(&problem.points)
        .map(|(j, p)| TiePoint { xyz: p.xyz, seen: world.ties[*j].seen.clone() })
        .collect();
    let residuals = TieResiduals::of(problem, *ties);
    let photographs = problem
        .frames
        .iter()
        .enumerate()
        .map(|(i, f)| AdjustedCamera {
            photograph: i,
            pose: f.pose,
            covariance: deviations.as_ref().filter(|_| !f.is_held()).map(|d| d.frame(i)),
            rms_px: root_mean(residuals.by_frame[i]),
            ties: residuals.by_frame[i].1,
        })
        .collect();
    let interior = |i: usize| deviations.as_ref().map(|d| d.interior(i)).unwrap_or_default();
    Adjustment {
        cameras: model.cameras.clone(),
        interior_sigmas: (0..model.cameras.len()).map(interior).collect(),
        photographs,
        points: points.iter().map(|p| adjusted_point(p, &model, control, &end)).collect(),
        tie_rms_px: root_mean((residuals.squares, residuals.count)),
        tie_mean_px: if residuals.count > 0 { residuals.lengths / residuals.count as f64 } else { f64::NAN },
        sigma_tie_px: end.sigma_tie_px,
        ties: end.ties,
        dropped_ties: end.dropped_ties,
        blunders: end.blunders,
        summary: end.summary,
        model,
        notes: end.notes,
    }
}

/// NaN of nothing.
fn root_mean((sum, count): (f64, usize)) -> f64 {
    if count > 0 { (sum / count as f64).sqrt() } else { f64::NAN }
}

/// Sums over the ties' residuals, pixels.
struct TieResiduals {
    squares: f64,
    lengths: f64,
    count: usize,
    /// Squares and how many, frame by frame.
    by_frame: Vec<(f64, usize)>,
}

impl TieResiduals {
    /// Ties that the robust loss has let go of, beyond ten σ, are left out.
    fn of(problem: &Problem, ties: usize) -> TieResiduals {
        let by_frame = vec![(0.0, 0); problem.frames.len()];
        let mut sums = TieResiduals { squares: 0.0, lengths: 0.0, count: 0, by_frame };
        for o in problem.observations.iter().filter(|o| o.point < ties) {
            let Some(r) = problem.residual(o) else { continue };
            let square = r[0] * r[0] + r[1] * r[1];
            if square > (10.0 * o.sigma_px).powi(2) {
                continue;
            }
            let frame = &mut sums.by_frame[o.frame];
            *frame = (frame.0 + square, frame.1 + 1);
            sums.squares += square;
            sums.lengths += square.sqrt();
            sums.count += 1;
        }
        sums
    }
}

/// A GCP where the adjustment has it; a check point where its rays meet.
fn adjusted_point(p: &GroundPoint, model: &Reconstruction, control: &[&GroundPoint], end: &End) -> AdjustedPoint {
    let image = |xyz: &Vector3<f64>| -> Vec<(usize, [f64; 2])> {
        p.seen
            .iter()
            .filter_map(|(i, pixel)| {
                let photograph = &model.photographs[*i];
                let local = photograph.pose.to_camera(xyz).into();
                Some((*i, model.cameras[photograph.camera].residual(local, *pixel)?))
            })
            .collect()
    };
    let of = |xyz: Vector3<f64>| AdjustedPoint {
        name: p.name.clone(),
        role: p.role,
        xyz,
        residual: Some(xyz - p.xyz),
        covariance: None,
        image: image(&xyz),
    };
    if let Some(k) = control.iter().position(|c| c.name == p.name && p.role == Role::Control) {
        let covariance = end.deviations.as_ref().map(|d| d.point(end.ties + k));
        return AdjustedPoint { covariance, ..of(end.problem.points[end.ties + k].xyz) };
    }
    match intersect_seen(model, &p.seen).filter(|_| p.seen.len() >= 2) {
        Some(x) => of(x),
        None if p.seen.len() >= 2 => AdjustedPoint { residual: None, image: Vec::new(), ..of(p.xyz) },
        None => AdjustedPoint { residual: None, ..of(p.xyz) },
    }
}
