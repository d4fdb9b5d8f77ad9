//! From matches to a transform, with residuals: [`similarity`] in the plane (what a run uses), [`planar`] affine and
//! projective on request, [`absolute`] and [`kraus`] in space, [`heights`] apart.

pub mod absolute;
pub mod heights;
pub mod kraus;
pub mod planar;
pub mod similarity;

pub use similarity::{Pair, PairResult, Similarity, Solution, Unsolvable, solve};
