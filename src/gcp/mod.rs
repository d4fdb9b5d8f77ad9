//! Reading lists of ground control points.
