//! The two feet, which differ by two millionths: nine metres in a northing.

/// Metres in an international foot.
pub const FOOT_M: f64 = 0.3048;
/// Metres in a US survey foot.
pub const US_SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;
