//! Degrees, minutes and seconds written as one number, as pocket calculators and total stations have them: 10.234255 of
//! `DDD.MMSS` is 10° 23′ 42.55″.

use std::collections::HashSet;

use crate::gcp::angle::angle;

/// What a title says of such numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packed {
    /// `DDD.MMSS`: the point stands behind the degrees.
    BehindDegrees,
    /// `DDDMMSS.sss`: the point stands behind the seconds.
    BehindSeconds,
}

impl Packed {
    /// Of a title with a word of D, M and S: `Lon (DDD.MMSS)`, `Lat [ddmmss.ss]`, `Latitude (D.MS)`. Those who write
    /// `DMS` alone put signs between the parts.
    pub(super) fn of(title: &str) -> Option<Packed> {
        let title = title.to_lowercase();
        title.split(|c: char| !matches!(c, 'd' | 'm' | 's' | '.') && !c.is_alphanumeric()).find_map(|word| {
            let rest = word.trim_start_matches('d');
            let degrees = word.len() - rest.len();
            let (point, rest) = rest.strip_prefix('.').map_or((false, rest), |rest| (true, rest));
            let minutes = rest.len() - rest.trim_start_matches('m').len();
            let seconds = rest.get(minutes..)?;
            let is_seconds = seconds.starts_with('s') && seconds.chars().all(|c| matches!(c, 's' | '.'));
            let is_word = (1..=3).contains(&degrees) && (1..=2).contains(&minutes) && is_seconds;
            match (is_word, point) {
                (false, _) => None,
                (true, true) => Some(Packed::BehindDegrees),
                (true, false) => (degrees > 1 && minutes == 2).then_some(Packed::BehindSeconds),
            }
        })
    }

    /// The angle in degrees. One with signs between its parts is read by them.
    pub(super) fn angle(self, text: &str) -> Option<f64> {
        let bare = text.trim().trim_matches('"').trim();
        let (negative, digits) = match bare.strip_prefix('-') {
            Some(digits) => (true, digits),
            None => (false, bare.strip_prefix('+').unwrap_or(bare)),
        };
        if !digits.chars().all(|c| c.is_ascii_digit() || matches!(c, '.' | ',')) {
            return angle(text);
        }
        if !digits.starts_with(|c: char| c.is_ascii_digit()) {
            return None;
        }
        let (whole, decimals) = digits.split_once(['.', ',']).unwrap_or((digits, ""));
        if !decimals.bytes().all(|b| b.is_ascii_digit()) {
            return None;
        }
        let (degrees, minutes, seconds) = match self {
            Packed::BehindDegrees => {
                let decimals = format!("{decimals:0<4}");
                let (minutes, seconds) = decimals.split_at_checked(2)?;
                let (seconds, rest) = seconds.split_at_checked(2)?;
                (whole.to_owned(), minutes.to_owned(), format!("{seconds}.{rest}0"))
            }
            Packed::BehindSeconds => {
                let whole = format!("{whole:0>5}");
                let (rest, seconds) = whole.split_at_checked(whole.len() - 2)?;
                let (degrees, minutes) = rest.split_at_checked(rest.len() - 2)?;
                (degrees.to_owned(), minutes.to_owned(), format!("{seconds}.{decimals}0"))
            }
        };
        let part = |text: String| text.parse::<f64>().ok();
        let (degrees, minutes, seconds) = (part(degrees)?, part(minutes)?, part(seconds)?);
        let value = degrees + (minutes + seconds / 60.0) / 60.0;
        (minutes < 60.0 && seconds < 60.0).then_some(if negative { -value } else { value })
    }

    /// As people write it.
    pub(super) fn written(self) -> &'static str {
        match self {
            Packed::BehindDegrees => "DDD.MMSS",
            Packed::BehindSeconds => "DDDMMSS.s",
        }
    }
}

/// Whether numbers that are taken for decimal degrees could as well be packed ones: so many that chance would hardly
/// leave all minutes and seconds below 60. What tells is the first digit of each; of points that lie close together it
/// is the same again and again, and counts once.
pub(super) fn could_be_packed<'a>(texts: impl Iterator<Item = &'a str>) -> bool {
    /// Six of ten digits are possible: chance leaves so many once in 36 lists.
    const FEWEST: usize = 7;
    const FEWEST_NUMBERS: usize = 10;
    let mut told: HashSet<&str> = HashSet::new();
    let mut numbers = 0;
    let all = { texts }.all(|text| {
        let text = text.trim();
        // Degrees, minutes and seconds apart from each other are no one number.
        let point = text.rfind(['.', ',']);
        let decimals = point.map_or("", |at| &text[at + 1..]);
        let is_one = decimals.bytes().all(|b| b.is_ascii_digit()) && !text.contains([' ', ':', '°']);
        let could = is_one && decimals.len() >= 4 && Packed::BehindDegrees.angle(text).is_some();
        if let Some(at) = point.filter(|_| could) {
            told.extend([&text[..at + 2], &text[..at + 4]]);
        }
        numbers += 1;
        could
    });
    all && numbers >= FEWEST_NUMBERS && told.len() >= FEWEST
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_that_say_so() {
        for title in ["Lon (DDD.MMSS)", "Lat [dd.mmss]", "Latitude (D.MS)", "lon_ddd.mmsss", "Lat (DD.MMSSss)"] {
            assert_eq!(Packed::of(title), Some(Packed::BehindDegrees), "{title}");
        }
        for title in ["Lon [DDDMMSS.sss]", "lat (ddmmss)"] {
            assert_eq!(Packed::of(title), Some(Packed::BehindSeconds), "{title}");
        }
        for title in
            ["Lon", "Lat (deg)", "lat_dms", "Longitude (DMS)", "DD MM SS", "Lat (dd.ddddd)", "dms", "Adresse", ""]
        {
            assert_eq!(Packed::of(title), None, "{title}");
        }
    }

    #[test]
    fn angles_as_one_number() {
        let close = |packed: Packed, text: &str, degrees: f64, minutes: f64, seconds: f64| {
            let value = degrees + minutes / 60.0 + seconds / 3600.0;
            assert!((packed.angle(text).expect(text).abs() - value).abs() < 1e-12, "{text}");
        };
        close(Packed::BehindDegrees, "10.234255", 10.0, 23.0, 42.55);
        close(Packed::BehindDegrees, "63,2548", 63.0, 25.0, 48.0);
        close(Packed::BehindDegrees, "10.2", 10.0, 20.0, 0.0);
        close(Packed::BehindDegrees, "-0.0030", 0.0, 0.0, 30.0);
        assert!(Packed::BehindDegrees.angle("-0.0030").expect("an angle") < 0.0);
        close(Packed::BehindDegrees, "10°23'42.55\"", 10.0, 23.0, 42.55);
        close(Packed::BehindSeconds, "0102342.55", 10.0, 23.0, 42.55);
        close(Packed::BehindSeconds, "632548", 63.0, 25.0, 48.0);
        for text in ["10.6012", "10.2360", "", "-", "x", "é", "10.1.2", "+"] {
            assert_eq!(Packed::BehindDegrees.angle(text), None, "{text}");
        }
        assert_eq!(Packed::BehindSeconds.angle("106112"), None);
        assert_eq!(Packed::BehindSeconds.angle("12"), Some(12.0 / 3600.0));
    }

    #[test]
    fn many_angles_below_sixty_are_noticed() {
        let packed: Vec<String> = (0..10).map(|i| format!("10.{:02}3055", 5 * i)).collect();
        assert!(could_be_packed(packed.iter().map(String::as_str)));
        assert!(!could_be_packed(packed.iter().take(9).map(String::as_str)));
        assert!(!could_be_packed(packed.iter().map(String::as_str).chain(["10.2371"])));
        let close: Vec<String> = (0..16).map(|i| format!("59.9133{i:02}4")).collect();
        assert!(!could_be_packed(close.iter().map(String::as_str)), "all of one street");
        for apart in ["52°20′12.34567″N", "N 52 20 12.34567", "52:20:12.34567", "-52 20 12.34567"] {
            assert!(!could_be_packed([apart; 12].into_iter()), "{apart}");
        }
    }
}
