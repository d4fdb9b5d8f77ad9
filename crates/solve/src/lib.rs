//! From matches to a transform, with residuals: [`similarity`] in the plane and its [`adjustment`] (what a run uses),
//! [`planar`] affine and projective on request, [`absolute`] and [`kraus`] in space, [`heights`] apart; whether the
//! residuals show a stretched or bent image: [`departure`]; whether they are normal, favour a direction or grow
//! outwards: [`residual_analysis`].
//!
//! ```
//! use autoref_raster::coords::{GeoTransform, PixelPoint};
//! use autoref_solve::{Pair, solve};
//! let truth = GeoTransform([570_000.0, 0.03, 0.004, 7_032_000.0, 0.004, -0.03]);
//! let pairs: Vec<Pair> = [(10.0, 20.0), (5000.0, 100.0), (4000.0, 3000.0), (200.0, 2500.0)]
//!     .map(|(x, y)| PixelPoint { x, y })
//!     .map(|pixel| Pair { pixel, map: truth.apply(pixel), covariance_px2: None, survey_sigma_m: None })
//!     .to_vec();
//! let solution = solve(&pairs).expect("four points apart");
//! assert!(solution.rmse_m < 1e-6 && (solution.geotransform.0[1] - 0.03).abs() < 1e-9);
//! ```
//!
//! This crate imports `autoref-raster` only, for coordinates and distributions.
#![warn(missing_docs)]

pub mod absolute;
pub mod accuracy;
pub mod adjustment;
pub mod departure;
pub mod heights;
pub mod kraus;
pub mod partial;
pub mod planar;
pub mod reliability;
pub mod residual_analysis;
pub mod similarity;
pub mod variance_ratio;
pub mod weights;

pub use adjustment::{PairResult, Solution, solve, solve_as};
pub use similarity::{Pair, Similarity, Unsolvable};
