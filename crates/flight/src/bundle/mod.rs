//! Bundle adjustment: cameras, poses and points that fit all that was measured best.
//!
//! Minimised is ½ Σ ρ(‖(u − û)/σ‖²) over the image observations plus the squares of all priors (GCPs on the ground,
//! positions, directions, interior parameters). The normal equations are reduced to cameras by the Schur complement,
//! stored as a skyline, and damped after Levenberg and Marquardt (Triggs et al., *Bundle Adjustment — A Modern
//! Synthesis*, 2000, section 4.3 for the curvature of a robust loss; damping after Nielsen 1999).

mod descent;
mod deviations;
mod layout;
mod linear;
mod normal;
mod other_lens;
mod problem;
mod single;
pub mod skyline;
mod small;
mod solve;

pub use descent::{ANY_FOCAL, Ended, FROM_AFAR, FROM_NEAR, Options, Summary};
pub use deviations::{Deviations, MissingTerms, Moved};
pub use normal::Factored;
pub(crate) use problem::HELD_M;
pub use problem::{BundleCamera, BundleFrame, BundlePoint, Loss, Observation, Problem, Treatment, Trust};
pub use solve::{factor, solve};
