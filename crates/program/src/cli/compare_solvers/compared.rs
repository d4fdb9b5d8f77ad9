//! What a comparison says of each solver, as JSON and as a line.

use autoref_solve::absolute;
use autoref_solve::residual_analysis::{Analysis, Component};
use nalgebra::Matrix3;
use serde::Serialize;

/// What a solver places points in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) enum Space {
    #[serde(rename = "plane")]
    Plane,
    #[serde(rename = "space")]
    Full,
}

impl Space {
    fn word(self) -> &'static str {
        match self {
            Space::Plane => "plane",
            Space::Full => "space",
        }
    }

    /// A residual of heights, which a plane has not.
    pub(super) fn height(self, residual: f64) -> Option<f64> {
        (self == Space::Full).then_some(residual)
    }
}

/// A solver, and what became of it.
#[derive(Serialize)]
pub(super) struct Compared {
    space: Space,
    solver: &'static str,
    units: &'static str,
    #[serde(flatten)]
    outcome: Outcome,
}

#[derive(Serialize)]
#[serde(tag = "status", rename_all = "lowercase")]
enum Outcome {
    Solved(Box<Solved>),
    Undetermined { reason: String },
}

/// RMSE is √(mean of squared lengths), divisor n, for each axis over the points that are known in it.
#[derive(Serialize)]
pub(super) struct Solved {
    points: usize,
    rmse_m: f64,
    rmse_e_m: Option<f64>,
    rmse_n_m: Option<f64>,
    rmse_h_m: Option<f64>,
    min_residual_m: f64,
    max_residual_m: f64,
    pub(super) residuals: Vec<PointResidual>,
    #[serde(flatten)]
    found: Found,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) analysis: Option<Analysis>,
}

/// What is left at a point, in the axes that are known of it.
#[derive(Serialize)]
pub(super) struct PointResidual {
    pub(super) gcp: String,
    pub(super) e_m: Option<f64>,
    pub(super) n_m: Option<f64>,
    pub(super) h_m: Option<f64>,
    length_m: f64,
}

/// What is known of a transform beside its residuals.
#[derive(Serialize)]
#[serde(untagged)]
pub(super) enum Found {
    /// The similarity of a run.
    Weighted { scale: f64, rotation_deg: f64, leave_one_out_rmse_m: Option<f64> },
    /// A rotation in space.
    Turned {
        #[serde(flatten)]
        turn: Turn,
        sigma0_m: Option<f64>,
        #[serde(flatten)]
        partly: Option<Partly>,
    },
    /// No rotation and no scale of its own.
    Planar { leave_one_out_rmse_m: Option<f64> },
}

#[derive(Serialize)]
pub(super) struct Turn {
    scale: f64,
    rotation_deg: f64,
    #[serde(flatten)]
    angles: Option<Angles>,
}

#[derive(Serialize)]
struct Angles {
    roll_deg: f64,
    pitch_deg: f64,
    yaw_deg: f64,
}

/// How many points counted in plan or in height alone.
#[derive(Serialize)]
pub(super) struct Partly {
    pub(super) plan_only: usize,
    pub(super) height_only: usize,
}

impl Turn {
    /// In the plane the turn about the vertical is all there is.
    pub(super) fn of(scale: f64, rotation: &Matrix3<f64>, space: Space) -> Turn {
        let [roll_deg, pitch_deg, yaw_deg] = absolute::roll_pitch_yaw_deg(rotation);
        let angles = (space == Space::Full).then_some(Angles { roll_deg, pitch_deg, yaw_deg });
        Turn { scale, rotation_deg: yaw_deg, angles }
    }
}

/// A solver that has no answer for these points.
pub(super) fn failed(space: Space, solver: &'static str, units: &'static str, why: &str) -> Compared {
    Compared { space, solver, units, outcome: Outcome::Undetermined { reason: why.into() } }
}

impl Compared {
    pub(super) fn solved(
        (space, solver, units): (Space, &'static str, &'static str),
        names: &[&str],
        residuals: &[[Option<f64>; 3]],
        found: Found,
    ) -> Compared {
        let rms = |axis: usize| {
            let known: Vec<f64> = residuals.iter().filter_map(|r| r[axis]).collect();
            (!known.is_empty()).then(|| (known.iter().map(|v| v * v).sum::<f64>() / known.len() as f64).sqrt())
        };
        let axes = [rms(0), rms(1), rms(2)];
        let length = |r: &[Option<f64>; 3]| r.iter().flatten().map(|v| v * v).sum::<f64>().sqrt();
        let lengths: Vec<f64> = residuals.iter().map(length).collect();
        let rows = names.iter().zip(residuals).zip(&lengths).map(|((name, r), length_m)| PointResidual {
            gcp: (*name).to_string(),
            e_m: r[0],
            n_m: r[1],
            h_m: r[2],
            length_m: *length_m,
        });
        let solved = Solved {
            points: names.len(),
            rmse_m: axes.iter().flatten().map(|v| v * v).sum::<f64>().sqrt(),
            rmse_e_m: axes[0],
            rmse_n_m: axes[1],
            rmse_h_m: axes[2],
            min_residual_m: lengths.iter().copied().fold(f64::INFINITY, f64::min),
            max_residual_m: lengths.iter().copied().fold(0.0, f64::max),
            residuals: rows.collect(),
            found,
            analysis: None,
        };
        Compared { space, solver, units, outcome: Outcome::Solved(Box::new(solved)) }
    }

    pub(super) fn solved_mut(&mut self) -> Option<&mut Solved> {
        match &mut self.outcome {
            Outcome::Solved(solved) => Some(solved),
            Outcome::Undetermined { .. } => None,
        }
    }
}

impl Found {
    /// Scale, and rotation in degrees anticlockwise from east.
    fn scale_and_rotation(&self) -> Option<(f64, f64)> {
        match self {
            Found::Weighted { scale, rotation_deg, .. } => Some((*scale, *rotation_deg)),
            Found::Turned { turn, .. } => Some((turn.scale, turn.rotation_deg)),
            Found::Planar { .. } => None,
        }
    }

    fn angles(&self) -> Option<&Angles> {
        match self {
            Found::Turned { turn, .. } => turn.angles.as_ref(),
            Found::Weighted { .. } | Found::Planar { .. } => None,
        }
    }
}

/// The table on the terminal.
pub(super) fn print(solvers: &[Compared]) {
    println!(
        "{:<6} {:<17} {:<17} {:>3} {:>15} {:>11} {:>10} {:>10} {:>10} {:>10} {:>10}",
        "space", "solver", "units", "n", "scale", "yaw °", "RMSE m", "E m", "N m", "height m", "max m"
    );
    for Compared { space, solver, units, outcome } in solvers {
        let space = space.word();
        match outcome {
            Outcome::Undetermined { reason } => println!("{space:<6} {solver:<17} {units:<17} {reason}"),
            Outcome::Solved(solved) => {
                let (scale, rotation_deg) = solved.found.scale_and_rotation().unzip();
                println!(
                    "{space:<6} {solver:<17} {units:<17} {:>3} {:>15} {:>11} {:>10} {:>10} {:>10} {:>10} {:>10}",
                    solved.points,
                    figure(scale, 11),
                    figure(rotation_deg, 6),
                    figure(Some(solved.rmse_m), 6),
                    figure(solved.rmse_e_m, 6),
                    figure(solved.rmse_n_m, 6),
                    figure(solved.rmse_h_m, 6),
                    figure(Some(solved.max_residual_m), 6)
                );
                if let Some(normality) = solved.analysis.as_ref().and_then(normality) {
                    println!("{:>24} {normality}", "");
                }
                if let Some(Angles { roll_deg, pitch_deg, yaw_deg }) = solved.found.angles() {
                    println!("{:>24} roll {roll_deg:.6}°, pitch {pitch_deg:.6}°, yaw {yaw_deg:.6}°", "");
                }
            }
        }
    }
}

fn figure(value: Option<f64>, digits: usize) -> String {
    value.filter(|value| value.is_finite()).map_or("–".to_owned(), |value| format!("{value:.digits$}"))
}

/// One line on the analysis: p-values of normality and the correlation of magnitude and distance.
fn normality(analysis: &Analysis) -> Option<String> {
    let p = |component: Option<&Component>| figure(component.and_then(|c| Some(c.normality.as_ref()?.p_value)), 3);
    let grows = analysis.correlations.magnitude_distance_2d.as_ref()?;
    Some(format!(
        "normal: p {} E, {} N, {} height; magnitude and distance: r {:.4} ({:.4} to {:.4})",
        p(Some(&analysis.easting)),
        p(Some(&analysis.northing)),
        p(analysis.height.as_ref()),
        grows.r,
        grows.low_95,
        grows.high_95
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_come_in_the_order_of_the_document() {
        let keys = |compared: &Compared| -> Vec<String> {
            let value = serde_json::to_value(compared).expect("plain data");
            value.as_object().expect("an object").keys().cloned().collect()
        };
        let first = ["space", "solver", "units", "status"];
        assert_eq!(keys(&failed(Space::Plane, "Kraus", "metres", "why")), [&first[..], &["reason"]].concat());
        let residuals = [[Some(0.3), Some(0.4), None]];
        let compared = |found| Compared::solved((Space::Full, "Kraus", "metres"), &["a"], &residuals, found);
        let of_all =
            ["points", "rmse_m", "rmse_e_m", "rmse_n_m", "rmse_h_m", "min_residual_m", "max_residual_m", "residuals"];
        let partly = Some(Partly { plan_only: 1, height_only: 0 });
        let turned =
            compared(Found::Turned { turn: Turn::of(1.0, &Matrix3::identity(), Space::Full), sigma0_m: None, partly });
        let own = ["scale", "rotation_deg", "roll_deg", "pitch_deg", "yaw_deg", "sigma0_m", "plan_only", "height_only"];
        assert_eq!(keys(&turned), [&first[..], &of_all, &own].concat());
        let turned = compared(Found::Turned {
            turn: Turn::of(1.0, &Matrix3::identity(), Space::Plane),
            sigma0_m: None,
            partly: None,
        });
        assert_eq!(keys(&turned), [&first[..], &of_all, &["scale", "rotation_deg", "sigma0_m"]].concat());
        let planar = compared(Found::Planar { leave_one_out_rmse_m: None });
        assert_eq!(keys(&planar), [&first[..], &of_all, &["leave_one_out_rmse_m"]].concat());
        let value = serde_json::to_value(&planar).expect("plain data");
        assert_eq!((&value["status"], &value["space"]), (&"solved".into(), &"space".into()));
    }
}
