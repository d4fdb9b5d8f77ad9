//! Dates of the Gregorian calendar from a clock that counts seconds.

use std::time::{SystemTime, UNIX_EPOCH};

/// Year, month and day in UTC, and the seconds of the day; 1970-01-01 for times before it.
///
/// H. Hinnant, "chrono-compatible low-level date algorithms", 2013: years begin in March, so that the leap day comes
/// last.
pub fn civil(time: SystemTime) -> ((i64, i64, i64), u64) {
    let seconds = time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let days = (seconds / 86_400) as i64 + 719_468;
    let (era, day_of_era) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    ((era * 400 + year_of_era + i64::from(month <= 2), month, day), seconds % 86_400)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn leap_days_and_years_ends_are_dated() {
        for (seconds, date) in [
            (0, ((1970, 1, 1), 0)),
            (951_782_399, ((2000, 2, 28), 86_399)),
            (951_782_400, ((2000, 2, 29), 0)),
            (1_767_225_599, ((2025, 12, 31), 86_399)),
        ] {
            assert_eq!(civil(UNIX_EPOCH + Duration::from_secs(seconds)), date);
        }
    }
}
