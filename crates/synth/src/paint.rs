//! Named paints.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A colour as the camera sees it in full light: red, green, blue, 0–255 each, sRGB.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Paint(pub [u8; 3]);

/// Name, colour. Chosen by eye from photographs of survey paint; no colorimetry stands behind them.
const NAMED: [(&str, [u8; 3]); 9] = [
    ("orange", [243, 104, 36]),
    ("orange-faded", [224, 146, 106]),
    ("pink", [236, 72, 146]),
    ("green", [92, 208, 72]),
    ("yellow", [240, 214, 44]),
    ("blue", [42, 98, 206]),
    ("white", [238, 238, 233]),
    ("black", [28, 28, 31]),
    ("red", [206, 44, 38]),
];

impl Paint {
    pub const ORANGE: Paint = Paint(NAMED[0].1);
    pub const WHITE: Paint = Paint(NAMED[6].1);
    pub const BLACK: Paint = Paint(NAMED[7].1);

    /// The names that parse.
    pub fn names() -> impl Iterator<Item = &'static str> {
        NAMED.iter().map(|(name, _)| *name)
    }
}

impl FromStr for Paint {
    type Err = String;

    /// A name of [`Paint::names`] or `#rrggbb`.
    fn from_str(text: &str) -> Result<Self, String> {
        let lower = text.to_ascii_lowercase();
        if let Some((_, colour)) = NAMED.iter().find(|(name, _)| *name == lower) {
            return Ok(Paint(*colour));
        }
        let wrong = || {
            let names: Vec<_> = Paint::names().collect();
            format!("no paint is called {text:?}; use #rrggbb or one of {}", names.join(", "))
        };
        let hex = lower.strip_prefix('#').filter(|h| h.len() == 6 && h.is_ascii()).ok_or_else(wrong)?;
        let value = u32::from_str_radix(hex, 16).map_err(|_| wrong())?;
        let [_, r, g, b] = value.to_be_bytes();
        Ok(Paint([r, g, b]))
    }
}

impl fmt::Display for Paint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [r, g, b] = self.0;
        write!(f, "#{r:02x}{g:02x}{b:02x}")
    }
}

impl TryFrom<String> for Paint {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Paint> for String {
    fn from(paint: Paint) -> String {
        paint.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_hex_parse_and_nonsense_does_not() {
        assert_eq!("Orange".parse::<Paint>().expect("a name"), Paint::ORANGE);
        assert_eq!("#0a0B0c".parse::<Paint>().expect("hex").to_string(), "#0a0b0c");
        for bad in ["", "#12345", "#12345g", "mauve", "#ééé"] {
            assert!(bad.parse::<Paint>().is_err(), "{bad}");
        }
    }
}
