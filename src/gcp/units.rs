//! Units that titles of columns name: `Easting (ft)`, `sigma E [mm]`.

use std::path::Path;

use crate::gcp::raw::RawPoint;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};
use autoref_raster::units::{FOOT_M, US_SURVEY_FOOT_M};

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit {
    pub metres: f64,
    name: &'static str,
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
    fn is_certain(self) -> bool {
        self.name != "feet"
    }

    /// Whether it is the unit of this length; feet without a word may be of either kind.
    fn is(self, metres: f64) -> bool {
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

    /// Brings local coordinates, and those of a CRS in metres, into metres, and heights into the unit of the CRS; says
    /// so in `notes`.
    ///
    /// # Errors
    /// [`Error::Format`] when the titles say two units, feet of no certain kind, or another unit than a CRS that does
    /// not count in metres.
    pub fn apply(
        &self,
        path: &Path,
        points: &mut [RawPoint],
        crs: Option<&Crs>,
        notes: &mut Vec<String>,
    ) -> Result<()> {
        let plan = self.plan_unit(path)?;
        let height_unit_m = match crs {
            Some(crs) => {
                self.refuse_other(path, crs)?;
                crs.height_metres_per_unit().unwrap_or_else(|| crs.metres_per_unit())
            }
            None => 1.0,
        };
        let mut scale = |factor: f64, of: fn(&mut RawPoint) -> Option<&mut f64>| {
            points.iter_mut().filter_map(of).for_each(|value| *value *= factor);
        };
        if let Some(unit) = plan.filter(|unit| crs.is_none_or(in_metres) && !unit.is(1.0)) {
            scale(unit.metres, |p| Some(&mut p.gcp.easting));
            scale(unit.metres, |p| Some(&mut p.gcp.northing));
            notes.push(format!("{}: its titles say {}: coordinates were brought to metres", path.display(), unit.name));
        }
        // Heights without a unit of their own have that of the coordinates beside them.
        let height = self.height.as_ref().map(|(unit, _)| *unit).or(plan.filter(|_| crs.is_none_or(in_metres)));
        if let Some(unit) = height.filter(|unit| !unit.is(height_unit_m)) {
            scale(unit.metres / height_unit_m, |p| p.gcp.height.as_mut());
            let to = if height_unit_m == 1.0 { "metres" } else { "the unit of its CRS" };
            notes.push(format!("{}: its heights are in {}: they were brought to {to}", path.display(), unit.name));
        }
        Ok(())
    }

    /// Of both coordinates.
    fn plan_unit(&self, path: &Path) -> Result<Option<Unit>> {
        let [easting, northing] = &self.plan;
        if let (Some((a, first)), Some((b, second))) = (easting, northing)
            && a != b
        {
            let what = format!("`{first}` and `{second}` name two units; both coordinates need the same one");
            return Err(Error::format(path, "the header", what));
        }
        Ok(easting.as_ref().or(northing.as_ref()).map(|(unit, _)| *unit))
    }

    fn refuse_other(&self, path: &Path, crs: &Crs) -> Result<()> {
        let unit_m = crs.metres_per_unit();
        let other = self.plan.iter().flatten().find(|(unit, _)| !unit.is(unit_m));
        let stays = |unit: &Unit| !(in_metres(crs) && unit.is_certain());
        match other.filter(|(unit, _)| !crs.is_geographic() && stays(unit)) {
            Some((_, title)) if in_metres(crs) => Err(Error::format(
                path,
                "the header",
                format!(
                    "the title `{title}` says feet of no certain kind, but {} counts in metres; write `(US ft)` or \
                     `(ift)` in the titles, or give the --crs that counts in feet",
                    crs.title()
                ),
            )),
            Some((unit, title)) => Err(Error::format(
                path,
                "the header",
                format!(
                    "the title `{title}` says {}, but {} counts in {} of {unit_m} m; give the --crs that counts in \
                     {}, or correct the title",
                    unit.name,
                    crs.title(),
                    crs.unit_name(),
                    unit.name
                ),
            )),
            None => Ok(()),
        }
    }
}

/// Whether it is a map in metres.
fn in_metres(crs: &Crs) -> bool {
    !crs.is_geographic() && crs.metres_per_unit() == 1.0
}
