//! Units that titles of columns name: `Easting (ft)`, `sigma E [mm]`.

use autoref_raster::units::{FOOT_M, US_SURVEY_FOOT_M};

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit {
    pub metres: f64,
    pub(super) name: &'static str,
}

impl Unit {
    /// What stands in the brackets of a title, or behind it (`Easting_ft`); `None` where that is no length.
    pub fn of_title(title: &str) -> Option<Unit> {
        let lower = title.to_lowercase().replace('（', "(").replace('）', ")");
        match lower.split_once(['[', '(']) {
            Some((_, rest)) => Unit::of_word(rest.split([']', ')']).next()?),
            None => {
                let mut words = lower.trim().rsplit(['_', ' ', '-']);
                let (last, before) = (words.next()?, words.next()?);
                // "Easting_US_ft" is in feet of a certain kind.
                Unit::of_word(&format!("{before}{last}")).or_else(|| Unit::of_word(last))
            }
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
            "km" | "kilometer" | "kilometers" | "kilometre" | "kilometres" | "kilomètre" | "kilomètres" => {
                unit(1000.0, "kilometres")
            }
            "usft" | "ftus" | "ussft" | "sft" | "usfoot" | "usfeet" | "ussurveyfoot" | "ussurveyfeet"
            | "surveyfeet" => unit(US_SURVEY_FOOT_M, "US survey feet"),
            "ift" | "intft" | "ftint" | "internationalfoot" | "internationalfeet" => unit(FOOT_M, "international feet"),
            "ft" | "foot" | "feet" | "fuß" | "fuss" | "pied" | "pieds" | "fot" => unit(FOOT_M, "feet"),
            _ => None,
        }
    }

    /// Of an accuracy: also the last word of its title (`sigma_mm`).
    pub fn of_accuracy(title: &str) -> Option<Unit> {
        let lower = title.trim().to_lowercase();
        let last = lower.rsplit(['_', ' ', '-']).next().filter(|word| matches!(*word, "mm" | "cm"));
        Unit::of_title(title).or_else(|| Unit::of_title(&format!("({})", last?)))
    }

    /// Whether its length is certain: feet without a word are of either kind, nine metres apart in a northing.
    pub(super) fn is_certain(self) -> bool {
        self.name != "feet"
    }

    /// Whether it is the unit of this length; feet without a word may be of either kind.
    pub(super) fn is(self, metres: f64) -> bool {
        let same = |m: f64| (m / metres - 1.0).abs() < 1e-7;
        same(self.metres) || (self.name == "feet" && same(US_SURVEY_FOOT_M))
    }
}

/// The units that the titles of a table name for its coordinates.
#[derive(Clone, Debug, Default)]
pub(super) struct TitledUnits {
    /// Of easting and northing, with the title.
    pub plan: [Option<(Unit, String)>; 2],
    pub height: Option<(Unit, String)>,
}

impl TitledUnits {
    /// Of the columns with these titles.
    pub fn of(easting: &str, northing: &str, height: Option<&str>) -> Self {
        let titled = |title: &str| Unit::of_title(title).map(|unit| (unit, title.trim().to_string()));
        TitledUnits { plan: [titled(easting), titled(northing)], height: height.and_then(titled) }
    }

    /// The same unit for all coordinates, as a format's own `word` says.
    pub fn all(unit: Unit, word: &str) -> Self {
        let said = || Some((unit, word.to_owned()));
        TitledUnits { plan: [said(), said()], height: said() }
    }
}
