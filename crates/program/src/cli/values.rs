//! Values of options, as people write them: bytes, ground sample distances, sizes of marks.

use std::str::FromStr;

use autoref_raster::memory_plan::{self};
use autoref_stream::profile::Size;

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    let value = text.trim().parse::<f64>().ok().filter(|v| *v > 0.0 && v.is_finite());
    value.ok_or_else(|| format!("`{text}` is no positive number"))
}

pub fn seconds(text: &str) -> Result<f64, String> {
    let value = text.trim().trim_end_matches('s').parse::<f64>().ok().filter(|v| *v >= 0.0 && v.is_finite());
    value.ok_or_else(|| format!("`{text}` is no number of seconds"))
}

/// A number of bytes.
#[derive(Clone, Copy, Debug)]
pub struct Bytes(pub u64);

impl FromStr for Bytes {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let trimmed = text.trim().trim_end_matches(['b', 'B']).trim_end_matches(['i', 'I']);
        let (number, unit) = match trimmed.char_indices().last() {
            Some((at, 'k' | 'K')) => (&trimmed[..at], 1u64 << 10),
            Some((at, 'm' | 'M')) => (&trimmed[..at], 1 << 20),
            Some((at, 'g' | 'G')) => (&trimmed[..at], 1 << 30),
            _ => (trimmed, 1),
        };
        let value: f64 = number.trim().parse().map_err(|_| format!("`{text}` is no size; write 512M or 2G"))?;
        let bytes = value * unit as f64;
        if !(1.0..1e18).contains(&bytes) {
            return Err(format!("`{text}` is no sensible size"));
        }
        Ok(Bytes(bytes as u64))
    }
}

/// A budget that the libraries fit into.
pub fn memory_budget(text: &str) -> Result<Bytes, String> {
    let bytes: Bytes = text.parse()?;
    if bytes.0 < memory_plan::SMALLEST_BUDGET_BYTES {
        return Err(format!("the least that is allowed is {}M", memory_plan::SMALLEST_BUDGET_BYTES >> 20));
    }
    Ok(bytes)
}

/// Smallest and largest ground size of a pixel, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gsd(pub f64, pub f64);

impl Gsd {
    /// What lengths in pixels are reckoned with: the middle of the range, which is the given value where one was given.
    pub fn middle_m(self) -> f64 {
        (self.0 + self.1) / 2.0
    }
}

impl FromStr for Gsd {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let number = |t: &str| length_m(t, Some(1.0));
        let range = if let Some((low, high)) = text.split_once("..") {
            // "2..3cm" names its unit once.
            let unit = length_unit(high).1;
            Gsd(length_m(low, unit)?, number(high)?)
        } else if let Some((centre, tolerance)) = text.split_once('±').or_else(|| text.split_once("+-")) {
            let centre = number(centre)?;
            let half = match tolerance.trim().strip_suffix('%') {
                Some(percent) => centre * length_m(percent, Some(1.0))? / 100.0,
                None => number(tolerance)?,
            };
            if half >= centre {
                return Err(format!("`{text}`: the tolerance is larger than the value"));
            }
            Gsd(centre - half, centre + half)
        } else {
            let centre = number(text)?;
            Gsd(centre * 0.9, centre * 1.1)
        };
        if range.0 > range.1 {
            return Err(format!("`{text}`: the smaller value comes first"));
        }
        Ok(range)
    }
}

/// The number before a unit of length, and the metres of the unit, when one is named.
fn length_unit(text: &str) -> (&str, Option<f64>) {
    const UNITS: [(&str, f64); 3] = [("mm", 0.001), ("cm", 0.01), ("m", 1.0)];
    let text = text.trim();
    let unit = UNITS.iter().find_map(|(unit, metres)| Some((text.strip_suffix(unit)?.trim(), Some(*metres))));
    unit.unwrap_or((text, None))
}

/// A positive length in metres; `unit` is that of a number alone.
fn length_m(text: &str, unit: Option<f64>) -> Result<f64, String> {
    let (number, own) = length_unit(text);
    let metres = own.or(unit).unwrap_or(1.0);
    number.parse::<f64>().ok().filter(|v| *v > 0.0 && v.is_finite()).map(|v| v * metres).ok_or_else(|| {
        let hint = if number.contains(',') { "; write a decimal point" } else { "" };
        format!("`{}` is no positive length in metres (m, cm, mm){hint}", text.trim())
    })
}

/// A range of mark sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MarkSize {
    Pixels(f64, f64),
    Metres(f64, f64),
}

impl MarkSize {
    /// The same as a profile has it.
    pub fn of_profile(self) -> Size {
        match self {
            MarkSize::Pixels(low, high) => Size { min_px: Some(low), max_px: Some(high), min_m: None, max_m: None },
            MarkSize::Metres(low, high) => Size { min_px: None, max_px: None, min_m: Some(low), max_m: Some(high) },
        }
    }
}

/// As the command line takes it: `10..20px`.
impl std::fmt::Display for MarkSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            MarkSize::Pixels(low, high) => write!(f, "{low}..{high}px"),
            MarkSize::Metres(low, high) => write!(f, "{low}..{high}m"),
        }
    }
}

/// The word of a choice on the command line.
pub fn word_of(choice: impl clap::ValueEnum) -> String {
    choice.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// What a side of a mark is given in.
#[derive(Clone, Copy)]
enum SideUnit {
    Pixels,
    /// `metres`: of the unit that is named, for a number without one.
    Length {
        metres: f64,
    },
}

impl SideUnit {
    /// `None` of a number alone.
    fn of(text: &str) -> Option<SideUnit> {
        match text.trim().ends_with("px") {
            true => Some(SideUnit::Pixels),
            false => length_unit(text).1.map(|metres| SideUnit::Length { metres }),
        }
    }

    fn is_pixels(self) -> bool {
        matches!(self, SideUnit::Pixels)
    }

    fn number(self, text: &str) -> Result<f64, String> {
        let text = text.trim();
        match self {
            SideUnit::Length { metres } => length_m(text, Some(metres)),
            SideUnit::Pixels => {
                let pixels = text.strip_suffix("px").unwrap_or(text).trim().parse::<f64>().ok();
                let pixels = pixels.filter(|v| *v > 0.0 && v.is_finite());
                pixels.ok_or_else(|| format!("`{text}` is no size in pixels (px) or in metres (m, cm, mm)"))
            }
        }
    }
}

impl FromStr for MarkSize {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let (low, high) = text.split_once("..").unwrap_or((text, text));
        // "0.3..0.5m" names its unit once; a number alone is in pixels.
        let units = [low, high].map(SideUnit::of);
        let [from, to] = [units[0].or(units[1]), units[1].or(units[0])].map(|unit| unit.unwrap_or(SideUnit::Pixels));
        if from.is_pixels() != to.is_pixels() {
            return Err(format!("`{text}`: one size is in pixels, the other a length: give both in one of them"));
        }
        // A single size means about that size.
        let (low, high) = match (from.number(low)?, to.number(high)?) {
            (low, high) if low == high => (low * 0.75, high * 1.25),
            (low, high) if low < high => (low, high),
            _ => return Err(format!("`{text}`: the smaller size comes first")),
        };
        Ok(match to {
            SideUnit::Pixels => MarkSize::Pixels(low, high),
            SideUnit::Length { .. } => MarkSize::Metres(low, high),
        })
    }
}

/// Rounded to so many digits; what is printed as zero has no sign.
pub fn unsigned_zero(value: f64, digits: i32) -> f64 {
    let parts = 10f64.powi(digits);
    (value * parts).round() / parts + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_printed_as_they_are_read() {
        for text in ["10..20px", "0.3..0.5m", "5.25..8.75px"] {
            assert_eq!(text.parse::<MarkSize>().map(|size| size.to_string()).as_deref(), Ok(text));
        }
    }

    #[test]
    fn ground_sample_distances_as_people_write_them() {
        assert_eq!("0.02..0.05".parse(), Ok(Gsd(0.02, 0.05)));
        let Gsd(low, high) = "0.03±5%".parse().expect("a range");
        assert!((low - 0.0285).abs() < 1e-12 && (high - 0.0315).abs() < 1e-12);
        let Gsd(low, high) = "0.03".parse().expect("a number");
        assert!((low - 0.027).abs() < 1e-12 && (high - 0.033).abs() < 1e-12);
        for (text, least, most) in [
            ("2.5cm", 0.0225, 0.0275),
            ("30 mm±10%", 0.027, 0.033),
            ("2..3cm", 0.02, 0.03),
            ("20mm..0.03m", 0.02, 0.03),
        ] {
            let Gsd(low, high) = text.parse().unwrap_or_else(|e| panic!("{text}: {e}"));
            assert!((low - least).abs() < 1e-12 && (high - most).abs() < 1e-12, "{text}: {low} {high}");
        }
        assert!("2.5dm".parse::<Gsd>().is_err_and(|said| said.contains("`2.5dm`")), "quoted as it was written");
        assert!("-1".parse::<Gsd>().is_err() && "0.05..0.02".parse::<Gsd>().is_err());
    }

    #[test]
    fn sizes_with_units() {
        assert_eq!("512M".parse::<Bytes>().expect("a size").0, 512 << 20);
        assert_eq!("2GiB".parse::<Bytes>().expect("a size").0, 2 << 30);
        assert!("many".parse::<Bytes>().is_err());
        for text in ["0.3m..0.5m", "0.3..0.5m", "0.3m..0.5", "300..500mm", "30 cm..0.5 m"] {
            assert_eq!(text.parse(), Ok(MarkSize::Metres(0.3, 0.5)), "{text}");
        }
        assert_eq!("10..20".parse(), Ok(MarkSize::Pixels(10.0, 20.0)));
        for text in ["0.2m..20px", "3dm..5dm", "10mpx", "5..4px", "0..3px"] {
            assert!(text.parse::<MarkSize>().is_err(), "{text}");
        }
    }
}
