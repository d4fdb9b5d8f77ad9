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
    /// What the words of a row under its roles leave open, where no other cell of the row settles it.
    pub(super) fn unclear_roles(&self, fields: &[String]) -> Vec<UnclearRole> {
        type Of = fn(&str) -> Said;
        let columns: [(Option<usize>, Of); 3] =
            [(self.role, roles::of_role), (self.check, roles::of_check), (self.enabled, roles::of_enabled)];
        let said = |(column, of): (Option<usize>, Of)| {
            let (title, word) = (self.titles.get(column?)?.trim(), fields.get(column?)?.trim());
            (!word.is_empty()).then(|| (title, word, of(word)))
        };
        let cells: Vec<(&str, &str, Said)> = columns.into_iter().filter_map(said).collect();
        // "CP" is a control point to some.
        let is_unclear =
            |(_, word, said): &(&str, &str, Said)| *said == Said::Unknown || word.eq_ignore_ascii_case("cp");
        let is_check = cells.iter().any(|(_, _, said)| *said == Said::Role(GcpRole::Check));
        let taken = if is_check { GcpRole::Check } else { GcpRole::Control };
        // That a point is enabled does not say that it is a control point.
        let enabled = self.enabled.and_then(|column| self.titles.get(column)).map(|title| title.trim());
        let settles = |cell: &(&str, &str, Said)| {
            !is_unclear(cell) && cell.2 == Said::Role(taken) && (is_check || Some(cell.0) != enabled)
        };
        if cells.iter().any(settles) {
            return Vec::new();
        }
        let decides = |cell: &&(&str, &str, Said)| is_unclear(cell) && (!is_check || cell.2 == Said::Role(taken));
        let unclear = |(title, word, _): &(&str, &str, Said)| UnclearRole {
            word: (*word).to_owned(),
            title: (*title).to_owned(),
            is_check,
        };
        cells.iter().filter(decides).map(unclear).collect()
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

/// A word under a title of roles that is not known, or means two things.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct UnclearRole {
    word: String,
    title: String,
    /// What the point was taken for, if not for a control point.
    is_check: bool,
}

/// A note on words of roles that are not known, or mean two things.
pub(super) fn of_roles(unclear: &BTreeSet<UnclearRole>) -> Option<String> {
    let taken = |role: &UnclearRole| if role.is_check { "a check point" } else { "a control point" };
    let shown: Vec<String> = unclear
        .iter()
        .take(SHOWN)
        .map(|role| format!("`{}` in `{}` was taken for {}", role.word, role.title, taken(role)))
        .collect();
    let more = match unclear.len().saturating_sub(SHOWN) {
        0 => String::new(),
        more => format!(", and {more} other words likewise"),
    };
    (!shown.is_empty()).then(|| format!("{}{more}; --check names the check points", shown.join(", ")))
}
