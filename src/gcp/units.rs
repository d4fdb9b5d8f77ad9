//! Units that titles of columns name: `Easting (ft)`, `sigma E [mm]`.

use autoref_raster::crs::Crs;
use autoref_raster::units::{FOOT_M, US_SURVEY_FOOT_M};

const FEET: &str = "feet";
const SURVEY: &str = "US survey feet";
const INTERNATIONAL: &str = "international feet";

/// A title that names two units.
struct TwoUnits;

fn words(text: &str) -> Vec<&str> {
    const BETWEEN: [char; 11] = [' ', '_', '-', '/', ',', ';', ':', '(', ')', '[', ']'];
    text.split(BETWEEN).map(|word| word.trim_matches('.')).filter(|word| !word.is_empty()).collect()
}

/// Feet in English, which no title has for anything else.
fn is_foot(word: &str) -> bool {
    matches!(word, "ft" | "foot" | "feet" | "usft" | "ftus" | "ussft" | "sft" | "ift")
}

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit {
    pub metres: f64,
    pub(super) name: &'static str,
}

impl Unit {
    /// What stands in the brackets of a title among other words ("(NAVD88 ft)"), or behind it (`Easting_ft`); feet
    /// anywhere. `None` where that is no length, or two.
    pub fn of_title(title: &str) -> Option<Unit> {
        Unit::among(title).ok().flatten()
    }

    /// As [`Unit::of_title`].
    ///
    /// # Errors
    /// When the title names two units, or both kinds of feet.
    fn among(title: &str) -> Result<Option<Unit>, TwoUnits> {
        let lower = title.to_lowercase().replace('（', "(").replace('）', ")");
        let (head, inner) = match lower.find(['[', '(']) {
            Some(at) => lower.split_at(at),
            None => (lower.as_str(), ""),
        };
        let whole = inner.trim_matches(['[', '(', ']', ')', ' ']);
        let (head, inner) = (words(head), words(inner));
        let last = head.last().filter(|_| inner.is_empty() && head.len() > 1);
        let before = last.and_then(|last| Some(format!("{}{last}", head.get(head.len().checked_sub(2)?)?)));
        let told = inner.iter().chain(last).filter_map(|word| Unit::of_word(word));
        let feet = head.iter().filter(|word| is_foot(word)).filter_map(|word| Unit::of_word(word));
        let joined = [Some(whole.to_owned()), before].into_iter().flatten().filter_map(|phrase| Unit::of_word(&phrase));
        let mut found = joined.chain(told).chain(feet);
        let Some(first) = found.next() else { return Ok(None) };
        let mut unit = first;
        for other in found.filter(|other| *other != first) {
            match (unit.is_certain(), other.is_certain()) {
                (true, false) if unit.is_foot() => {}
                (false, true) if other.is_foot() => unit = other,
                _ => return Err(TwoUnits),
            }
        }
        // "(US Survey ft)" and "(Foot_US)" say of which kind they are.
        let is_said = |kinds: &[&str]| head.iter().chain(&inner).any(|word| kinds.contains(word));
        let (us, international) = (is_said(&["us", "usa", "survey"]), is_said(&["int", "intl", "international"]));
        match unit.is_foot().then_some((us, international)) {
            Some((true, true)) => Err(TwoUnits),
            Some((true, false)) if unit.name == INTERNATIONAL => Err(TwoUnits),
            Some((false, true)) if unit.name == SURVEY => Err(TwoUnits),
            Some((true, false)) => Ok(Some(Unit { metres: US_SURVEY_FOOT_M, name: SURVEY })),
            Some((false, true)) => Ok(Some(Unit { metres: FOOT_M, name: INTERNATIONAL })),
            _ => Ok(Some(unit)),
        }
    }

    /// Of a word that stands alone.
    pub fn of_word(word: &str) -> Option<Unit> {
        let lower = word.to_lowercase();
        let word: String = lower.chars().filter(|c| !" ._-".contains(*c)).collect();
        let unit = |metres: f64, name: &'static str| Some(Unit { metres, name });
        match word.as_str() {
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" | "millimètre" | "millimètres" => {
                unit(0.001, "millimetres")
            }
            "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" | "centimètre" | "centimètres"
            | "zentimeter" => unit(0.01, "centimetres"),
            "m" | "meter" | "meters" | "metre" | "metres" | "mètre" | "mètres" | "metro" | "metros" | "metri"
            | "метр" | "м" => unit(1.0, "metres"),
            "inch" | "inches" => unit(FOOT_M / 12.0, "inches"),
            "km" | "kilometer" | "kilometers" | "kilometre" | "kilometres" | "kilomètre" | "kilomètres" => {
                unit(1000.0, "kilometres")
            }
            "usft" | "ftus" | "ussft" | "sft" | "usfoot" | "usfeet" | "ussurveyfoot" | "ussurveyfeet"
            | "surveyfeet" | "surveyft" | "surveyfoot" | "footus" | "feetus" | "ussurveyft" => {
                unit(US_SURVEY_FOOT_M, SURVEY)
            }
            "ift" | "intft" | "ftint" | "ftintl" | "intlft" | "internationalft" | "internationalfoot"
            | "internationalfeet" => unit(FOOT_M, INTERNATIONAL),
            "ft" | "foot" | "feet" | "fuß" | "fuss" | "pied" | "pieds" | "fot" => unit(FOOT_M, FEET),
            _ => None,
        }
    }

    /// Of an accuracy: also the last word of its title (`sigma_mm`).
    pub fn of_accuracy(title: &str) -> Option<Unit> {
        let lower = title.trim().to_lowercase();
        let last = lower.rsplit(['_', ' ', '-']).next().filter(|word| matches!(*word, "mm" | "cm"));
        Unit::of_title(title).or_else(|| Unit::of_title(&format!("({})", last?)))
    }

    fn is_foot(self) -> bool {
        [FEET, SURVEY, INTERNATIONAL].contains(&self.name)
    }

    /// Whether its length is certain: feet without a word are of either kind, nine metres apart in a northing.
    pub(super) fn is_certain(self) -> bool {
        self.name != FEET
    }

    /// Whether it is the unit of this length; feet without a word may be of either kind.
    pub(super) fn is(self, metres: f64) -> bool {
        let same = |m: f64| (m / metres - 1.0).abs() < 1e-7;
        same(self.metres) || (self.name == FEET && same(US_SURVEY_FOOT_M))
    }
}

/// The units that the titles of a table name for its coordinates.
#[derive(Clone, Debug, Default)]
pub(super) struct TitledUnits {
    /// Of easting and northing, with the title.
    pub plan: [Option<(Unit, String)>; 2],
    pub height: Option<(Unit, String)>,
    /// A title that names two units, one of them feet.
    pub(super) unclear: Option<String>,
    /// Accuracies have no unit of their own: they are in that of the coordinates.
    pub(super) accuracies_as_coordinates: bool,
}

impl TitledUnits {
    /// Of the columns with these titles.
    pub fn of(easting: &str, northing: &str, height: Option<&str>) -> Self {
        let titled = |title: &str| Unit::of_title(title).map(|unit| (unit, title.trim().to_string()));
        let titles = [Some(easting), Some(northing), height];
        let unclear = titles.into_iter().flatten().find(|title| Unit::among(title).is_err());
        TitledUnits {
            plan: [titled(easting), titled(northing)],
            height: height.and_then(titled),
            unclear: unclear.map(|title| title.trim().to_owned()),
            accuracies_as_coordinates: false,
        }
    }

    /// The same unit for all coordinates, as a format's own `word` says.
    pub fn all(unit: Unit, word: &str) -> Self {
        let said = || Some((unit, word.to_owned()));
        TitledUnits { plan: [said(), said()], height: said(), ..TitledUnits::default() }
    }
}

/// Metres per unit of the accuracies, of the place and of the height, in a list that has one unit for all it says: that
/// of the coordinates; metres beside degrees and without a CRS.
pub(super) fn accuracy_units(crs: Option<&Crs>) -> (f64, f64) {
    crs.filter(|crs| !crs.is_geographic()).map_or((1.0, 1.0), |crs| {
        let unit = crs.metres_per_unit();
        (unit, crs.height_metres_per_unit().unwrap_or(unit))
    })
}

/// A number that came through another unit, without the last digits that this left: the shortest decimal that lies
/// within its rounding, 999978.608 for 999978.6080000001.
pub(super) fn tidied(value: f64) -> f64 {
    const DIGITS: usize = 15;
    let within = 1.5 * f64::EPSILON * value.abs();
    let of_digits = |digits: usize| format!("{value:.digits$e}").parse::<f64>().ok();
    (0..DIGITS).filter_map(of_digits).find(|short| (short - value).abs() <= within).unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_unit_leaves_no_digits() {
        for value in [999_978.608, 0.03, -199_999.206, 328.0, 0.0, 1_234_567.890_123_4] {
            assert_eq!(tidied(value * US_SURVEY_FOOT_M / US_SURVEY_FOOT_M), value);
            assert_eq!(tidied(value / FOOT_M * FOOT_M), value);
        }
        assert_eq!(tidied(1.0 / 3.0), 1.0 / 3.0);
    }

    #[test]
    fn units_among_other_words() {
        for (title, name) in [
            ("Easting (US Survey ft)", SURVEY),
            ("Easting (ft(US))", SURVEY),
            ("Easting (Foot_US)", SURVEY),
            ("Easting_US_Survey_ft", SURVEY),
            ("Easting (survey ft)", SURVEY),
            ("Northing [ftUS]", SURVEY),
            ("Easting_ft_US", SURVEY),
            ("Easting (International ft)", INTERNATIONAL),
            ("Elevation (NAVD88 ft)", FEET),
            ("Easting (ft, NAD83)", FEET),
            ("Elevation (Feet AMSL)", FEET),
            ("Elevation Feet AMSL", FEET),
            ("Elevation/ft", FEET),
            ("Elev_ft", FEET),
            ("Höhe (m ü. NN)", "metres"),
            ("Höhe (NN) [m]", "metres"),
            ("H_m", "metres"),
            ("sigma E [mm]", "millimetres"),
        ] {
            assert_eq!(Unit::of_title(title).map(|unit| unit.name), Some(name), "{title}");
        }
        for title in ["Easting", "E (WGS84)", "m", "US Grid East", "Y (E)"] {
            assert!(Unit::among(title).is_ok_and(|unit| unit.is_none()), "{title}");
        }
        for title in ["Easting (ft/m)", "Elev ft (m)", "Easting (US or international ft)"] {
            assert!(Unit::among(title).is_err(), "{title}");
            assert_eq!(TitledUnits::of("Easting", "Northing", Some(title)).unclear.as_deref(), Some(title));
        }
    }
}
