//! Lengths as a summary has them.

/// Millimetres below a metre.
pub fn length(metres: f64) -> String {
    if metres.abs() < 1.0 { format!("{:.1} mm", 1000.0 * metres) } else { format!("{metres:.3} m") }
}
