//! Accuracies that a title states at more than one standard deviation: `Horizontal Accuracy (95%)`, `CE90`, `2 sigma`.
//!
//! In the plane the radius that holds a share p of errors of one standard deviation in each coordinate is
//! √(−2 ln(1 − p)) of them: 2.1460 for 90 %, 2.4477 for 95 %, 3.0349 for 99 % (FGDC-STD-007.3-1998, appendix 3-A, has
//! that of 95 %; C. R. Greenwalt and M. E. Shultz, "Principles of error theory and cartographic applications", ACIC
//! technical report 96, 1962). Along one axis it is 1.6449, 1.9600 and 2.5758.

use super::titles::folded;

/// What a column of accuracies measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Measured {
    /// The distance in the plan.
    Radius,
    /// One coordinate, or the height.
    Axis,
}

/// Share in per cent, in the plan, along one axis.
const SHARES: [(&str, f64, f64); 3] =
    [("90", 2.145_966, 1.644_854), ("95", 2.447_747, 1.959_964), ("99", 3.034_854, 2.575_829)];

/// How many standard deviations a title states, where it is not one.
pub(super) fn sigmas(title: &str, measured: Measured) -> Option<f64> {
    let plain = folded(title).replace('%', " % ").replace('σ', " sigma ");
    let plain = plain.replace(['(', ')', '[', ']', '_', '-', '/', ',', ';', ':', '='], " ");
    let words: Vec<&str> = plain.split_whitespace().collect();
    let factor = |(share, radius, axis): &(&str, f64, f64)| {
        let is_share = words.windows(2).any(|pair| pair[0] == *share && ["%", "percent", "pct"].contains(&pair[1]));
        let is_error = |of: &str| {
            words.contains(&format!("{of}{share}").as_str()) || words.windows(2).any(|pair| pair == [of, *share])
        };
        // Circular and linear error.
        let (is_circular, is_linear) = (is_error("ce"), is_error("le"));
        match measured {
            Measured::Radius if is_share || is_circular => Some(*radius),
            Measured::Axis if is_share || is_linear || is_circular => Some(*axis),
            Measured::Radius if is_linear => Some(*axis),
            _ => None,
        }
    };
    let of_sigma =
        |pair: &[&str]| ["sigma", "sd", "std"].contains(&pair[1]).then(|| pair[0].parse::<u8>().ok()).flatten();
    let joined = || words.iter().find_map(|word| word.strip_suffix("sigma")?.parse::<u8>().ok());
    SHARES.iter().find_map(factor).or_else(|| {
        let count = words.windows(2).find_map(of_sigma).or_else(joined)?;
        (2..=5).contains(&count).then(|| f64::from(count))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_follow_from_the_normal_distribution() {
        for (share, radius, _) in SHARES {
            let p: f64 = share.parse::<f64>().expect("a number") / 100.0;
            assert!((radius - (-2.0 * (1.0 - p).ln()).sqrt()).abs() < 1e-6, "{share}");
        }
        for (title, measured, wanted) in [
            ("Horizontal Accuracy (95%)", Measured::Radius, Some(2.447_747)),
            ("Vertical Accuracy (95 %)", Measured::Axis, Some(1.959_964)),
            ("CE90", Measured::Radius, Some(2.145_966)),
            ("CE 95", Measured::Radius, Some(2.447_747)),
            ("LE-95 (m)", Measured::Axis, Some(1.959_964)),
            ("LE90 (m)", Measured::Axis, Some(1.644_854)),
            ("Accuracy (2 sigma)", Measured::Radius, Some(2.0)),
            ("Accuracy (2σ)", Measured::Axis, Some(2.0)),
            ("Accuracy_2sigma", Measured::Axis, Some(2.0)),
            ("Accuracy (1 sigma)", Measured::Axis, None),
            ("Accuracy (68%)", Measured::Axis, None),
            ("Accuracy 95", Measured::Axis, None),
            ("sigma_m", Measured::Axis, None),
        ] {
            assert_eq!(sigmas(title, measured), wanted, "{title}");
        }
    }
}
