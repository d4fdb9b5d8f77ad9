//! From matches to a transform, with residuals: [`similarity`] in the plane.

pub mod similarity;

pub use similarity::{Pair, PairResult, Similarity, Solution, Unsolvable, solve};
