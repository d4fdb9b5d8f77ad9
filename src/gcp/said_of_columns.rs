//! What is said of columns that were read otherwise than they stand, or not at all.

use std::collections::BTreeSet;

use crate::gcp::GcpRole;
use crate::gcp::angle::Letter;
use crate::gcp::columns::Columns;
use crate::gcp::confidence::{self, Measured};
use crate::gcp::hemispheres::counts_backwards;
use crate::gcp::roles::{self, Said};
use crate::gcp::titles::tidy;

/// Words that are listed in one note.
const SHOWN: usize = 4;

impl Columns {
    /// What the words of a row under its roles leave open, with the title.
    pub(super) fn unclear_roles(&self, fields: &[String]) -> Vec<(String, String)> {
        type Of = fn(&str) -> Said;
        let columns: [(Option<usize>, Of); 3] =
            [(self.role, roles::of_role), (self.check, roles::of_check), (self.enabled, roles::of_enabled)];
        let said = columns.into_iter().filter_map(|(column, of)| {
            let (title, text) = (self.titles.get(column?)?.trim(), fields.get(column?)?.trim());
            // "CP" is a control point to some.
            let is_unclear = of(text) == Said::Unknown || text.eq_ignore_ascii_case("cp");
            (!text.is_empty() && is_unclear).then(|| (text.to_owned(), title.to_owned()))
        });
        said.collect()
    }

    /// How many standard deviations the accuracies under a title are, and what they are divided by.
    pub(super) fn sigmas(&self, column: usize) -> f64 {
        // One column for all three coordinates is of each of them.
        let is_radius = self.sigma == [Some(column), None] && self.sigma_height != Some(column);
        let measured = if is_radius { Measured::Radius } else { Measured::Axis };
        self.titles.get(column).and_then(|title| confidence::sigmas(title, measured)).unwrap_or(1.0)
    }

    /// Accuracies that were divided, and those that were not used.
    pub(super) fn told_of_accuracies(&self) -> Option<String> {
        let mut columns: Vec<usize> = self.sigma.into_iter().chain([self.sigma_height]).flatten().collect();
        columns.dedup();
        let title = |column: usize| self.titles.get(column).map_or("", |title| title.trim());
        let divided = columns.iter().map(|&column| (title(column), self.sigmas(column))).filter(|(_, by)| *by != 1.0);
        let divided: Vec<String> = divided.map(|(title, by)| format!("`{title}` by {by:.3}")).collect();
        if !divided.is_empty() {
            return Some(format!(
                "accuracies were brought to one standard deviation: {} (divided)",
                divided.join(", ")
            ));
        }
        // An error is a residual to most.
        const WORDS: [&str; 13] = [
            "accuracy",
            "sigma",
            "std",
            "stddev",
            "stdev",
            "deviation",
            "rms",
            "rmse",
            "hrms",
            "precision",
            "prec",
            "genauigkeit",
            "nøyaktighet",
        ];
        let is_one = |title: &&String| tidy(title).split([' ', '/']).any(|word| WORDS.contains(&word));
        let unused: Vec<&str> = self.titles.iter().filter(is_one).map(|title| title.trim()).collect();
        (columns.is_empty() && !unused.is_empty()).then(|| {
            format!(
                "no accuracy was read from `{}`; call the columns `sigma_m` and `sigma_height_m`, or `sigma E`, `sigma N` \
                 and `sigma H`",
                unused.join("`, `")
            )
        })
    }

    /// Whether the degrees of easting and northing count westwards and southwards by their titles.
    pub(super) fn is_backwards(&self, column: usize) -> bool {
        let axis = if column == self.northing { Letter::Latitude } else { Letter::Longitude };
        self.geographic && self.titles.get(column).is_some_and(|title| counts_backwards(title, axis))
    }

    /// Degrees that were negated.
    pub(super) fn told_of_hemispheres(&self) -> Option<String> {
        let titles = [self.easting, self.northing].into_iter().filter(|&column| self.is_backwards(column));
        let titles: Vec<&str> = titles.map(|column| self.titles[column].trim()).collect();
        (!titles.is_empty()).then(|| {
            format!("positive degrees under `{}` were taken as west or south, so negative", titles.join("` and `"))
        })
    }
}

/// A note on words of roles that are not known, or mean two things.
pub(super) fn of_roles(unclear: &BTreeSet<(String, String)>) -> Option<String> {
    let taken = |word: &str| match roles::of_role(word) {
        Said::Role(GcpRole::Check) => "a check point",
        _ => "a control point",
    };
    let shown: Vec<String> = unclear
        .iter()
        .take(SHOWN)
        .map(|(word, title)| format!("`{word}` in `{title}` was taken for {}", taken(word)))
        .collect();
    let more = match unclear.len().saturating_sub(SHOWN) {
        0 => String::new(),
        more => format!(", and {more} other words for control points"),
    };
    (!shown.is_empty()).then(|| format!("{}{more}; --check names the check points", shown.join(", ")))
}
