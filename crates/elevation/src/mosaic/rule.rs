//! The rule by which a cell is taken from one of the sources that hold it.

use std::str::FromStr;

/// Which source a cell is taken from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Choice {
    /// The smallest value of a companion raster; `{stem}` in the pattern is the source's file name without extension.
    Min(String),
    First,
    Last,
    /// The latest date: of the file's metadata, else of its name, else of the file.
    Newest,
    /// The source whose centre is nearest.
    Nearest,
    /// The median of all sources, band by band.
    Median,
    /// The mean of all sources, weighed by the distance from their edges.
    Feather,
}

impl FromStr for Choice {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "first" => Ok(Choice::First),
            "last" => Ok(Choice::Last),
            "newest" => Ok(Choice::Newest),
            "nearest" => Ok(Choice::Nearest),
            "median" => Ok(Choice::Median),
            "feather" => Ok(Choice::Feather),
            _ => match text.strip_prefix("min:") {
                Some(pattern) if pattern.contains("{stem}") => Ok(Choice::Min(pattern.to_string())),
                Some(pattern) => Err(format!("`{pattern}` has no {{stem}}: write min:{{stem}}_range_mean.tif")),
                None => Err(format!(
                    "`{text}` is no choice; write min:PATTERN, first, last, newest, nearest, median or feather"
                )),
            },
        }
    }
}
