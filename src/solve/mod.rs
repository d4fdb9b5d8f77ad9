//! From matches to a transform, with residuals.
