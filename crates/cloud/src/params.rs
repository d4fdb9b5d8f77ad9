//! Values such as `k=8,m=2`: names and numbers after one option.

use crate::error::{Error, Result};

/// Reads `name=value,…` where every name is one of `defaults`; what is not given keeps its default.
///
/// A value without a name takes the place of the first name that has not been set: `8,2` is `k=8,m=2`.
///
/// # Errors
/// An unknown name, a name given twice, a value that is no finite number; the message names `option`.
pub fn read<const N: usize>(option: &str, text: &str, defaults: [(&str, f64); N]) -> Result<[f64; N]> {
    let mut values = defaults.map(|(_, value)| value);
    let mut set = [false; N];
    let form = || {
        let names: Vec<String> = defaults.iter().map(|(name, value)| format!("{name}={value}")).collect();
        format!("write {option} {}", names.join(","))
    };
    for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
        let (index, number) = match part.split_once('=') {
            Some((name, number)) => {
                let name = name.trim();
                let index = defaults
                    .iter()
                    .position(|(known, _)| *known == name)
                    .ok_or_else(|| Error::usage(format!("{option}: `{name}` is no parameter of it"), form()))?;
                (index, number.trim())
            }
            None => {
                let index = set
                    .iter()
                    .position(|done| !done)
                    .ok_or_else(|| Error::usage(format!("{option}: `{part}` is one value too many"), form()))?;
                (index, part)
            }
        };
        if std::mem::replace(&mut set[index], true) {
            return Err(Error::usage(format!("{option}: `{}` is given twice", defaults[index].0), form()));
        }
        values[index] = number.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| {
            Error::usage(format!("{option}: `{number}` is no number for `{}`", defaults[index].0), form())
        })?;
    }
    Ok(values)
}

/// Reads exactly `N` numbers separated by commas, as in `E,N,H`.
///
/// # Errors
/// Another count, or something that is no finite number.
pub fn numbers<const N: usize>(option: &str, text: &str, form: &str) -> Result<[f64; N]> {
    let remedy = || format!("write {option} {form}");
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    if parts.len() != N {
        return Err(Error::usage(format!("{option}: {} values in `{text}`, not {N}", parts.len()), remedy()));
    }
    let mut values = [0.0; N];
    for (value, part) in values.iter_mut().zip(parts) {
        *value = part
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .ok_or_else(|| Error::usage(format!("{option}: `{part}` is no number"), remedy()))?;
    }
    Ok(values)
}

/// What is added to coordinates: E, N and H, so small that doubles still hold parts of a millimetre.
///
/// # Errors
/// When `text` is not three such numbers.
pub fn shift(option: &str, text: &str) -> Result<[f64; 3]> {
    /// Doubles beyond are coarser than 2⁻¹³.
    const MOST: f64 = 1e12;
    let values = numbers(option, text, "E,N,H")?;
    match values.iter().find(|value| value.abs() > MOST) {
        None => Ok(values),
        Some(value) => {
            let what = format!("{option}: {value:e} is beyond all maps, and coordinates would lose their millimetres");
            Err(Error::usage(what, "give what was taken off the cloud's coordinates"))
        }
    }
}

/// A positive value, or an error that names it.
///
/// # Errors
/// When `value` is zero, negative or infinite.
pub fn positive(option: &str, name: &str, value: f64) -> Result<f64> {
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err(Error::usage(format!("{option}: {name} is {value}"), format!("give a {name} above 0")))
    }
}

/// A whole number of at least `least`.
///
/// # Errors
/// When `value` is no whole number, or less.
pub fn whole(option: &str, name: &str, value: f64, least: u32) -> Result<usize> {
    if value.fract() == 0.0 && value >= f64::from(least) && value <= 1e6 {
        Ok(value as usize)
    } else {
        Err(Error::usage(format!("{option}: {name} is {value}"), format!("give a whole {name} from {least} up")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_order_and_defaults() {
        let defaults = [("k", 8.0), ("m", 2.0)];
        assert_eq!(read("--outliers", "", defaults).expect("defaults"), [8.0, 2.0]);
        assert_eq!(read("--outliers", "m=1.5, k=2", defaults).expect("both"), [2.0, 1.5]);
        assert_eq!(read("--outliers", "5,0", defaults).expect("unnamed"), [5.0, 0.0]);
        for (bad, word) in
            [("q=1", "`q`"), ("k=1,k=2", "twice"), ("k=x", "`x`"), ("1,2,3", "too many"), ("k=inf", "inf")]
        {
            let message = read("--outliers", bad, defaults).expect_err(bad).to_string();
            assert!(message.contains(word) && message.contains("--outliers k=8,m=2"), "{message}");
        }
    }

    #[test]
    fn lists_of_numbers() {
        assert_eq!(numbers::<2>("--z", "-50,716", "MIN,MAX").expect("two"), [-50.0, 716.0]);
        assert!(numbers::<3>("--shift", "1,2", "E,N,H").is_err());
        assert!(numbers::<2>("--z", "1,nan", "MIN,MAX").is_err());
        assert_eq!(shift("--shift", "600000,-8600000,0").expect("a place"), [600_000.0, -8_600_000.0, 0.0]);
        let said = shift("--shift", "0,1e300,0").expect_err("beyond all maps").to_string();
        assert!(said.starts_with("--shift: 1e300 is beyond all maps"), "{said}");
    }
}
