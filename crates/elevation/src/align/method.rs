//! What is fitted, and how.

use std::fmt;
use std::str::FromStr;

use crate::grid::GroundUnit;
use crate::kept::Room;
use crate::stream::Means;
use crate::zones::Zones;

use super::surface::Degree;

/// What is fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Shift, height and, where it is there, a tilt; robust, from coarse to fine.
    #[default]
    Auto,
    /// Nuth and Kääb 2011: shift from the cosine of the aspect, height from the median.
    NuthKaab,
    /// Least-squares z-difference: shift and height.
    Lzd,
    /// The height alone.
    Bias,
    /// Height and tilt, or the surface asked for.
    Tilt,
}

impl Method {
    pub const ALL: [Method; 5] = [Method::Auto, Method::NuthKaab, Method::Lzd, Method::Bias, Method::Tilt];

    /// As the command line has it.
    pub fn name(self) -> &'static str {
        match self {
            Method::Auto => "auto",
            Method::NuthKaab => "nuth-kaab",
            Method::Lzd => "lzd",
            Method::Bias => "bias",
            Method::Tilt => "tilt",
        }
    }

    /// Whether it fits a surface of which the degree can be chosen.
    pub fn bends(self) -> bool {
        matches!(self, Method::Auto | Method::Tilt)
    }

    pub(crate) fn moves(self) -> bool {
        !matches!(self, Method::Bias | Method::Tilt)
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Method {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        Method::ALL
            .into_iter()
            .find(|m| m.name() == text)
            .ok_or_else(|| format!("`{text}` is no method; choose from {}", Method::ALL.map(Method::name).join(", ")))
    }
}

/// How to align.
#[derive(Clone, Copy)]
pub struct Options<'a> {
    pub method: Method,
    /// Highest degree of the surface: `auto` takes what is there, `tilt` all of it; other methods fit none.
    pub surface: Degree,
    /// Stable ground in the map coordinates of both models.
    pub stable: Option<&'a Zones>,
    pub unit: GroundUnit,
    pub means: Means,
    /// Cells of each model that may be held at a time for the search.
    pub memory_cells: u64,
    /// Copies of the two models for all passes but the first; the cells are those of both together. The result is the
    /// same without.
    pub room: Room<'a>,
}

impl Default for Options<'_> {
    fn default() -> Self {
        Options {
            method: Method::Auto,
            surface: Degree::Linear,
            stable: None,
            unit: GroundUnit::METRES,
            means: Means::default(),
            memory_cells: 1_500_000,
            room: Room { held_cells: 25_000_000, scratch: None },
        }
    }
}
