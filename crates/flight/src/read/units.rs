//! Whether the titles of a camera table say that its coordinates are feet or metres.

use std::path::Path;

use super::titles::{Heading, column_at, title_and_unit};
use crate::error::{Result, read_text};

const FEET: [&str; 10] = ["ft", "feet", "foot", "usft", "ftus", "ift", "usfeet", "ussurveyft", "ussurveyfeet", "intft"];

const METRES: [&str; 5] = ["m", "metre", "metres", "meter", "meters"];

/// A unit of length that a title states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stated {
    /// International or of the US survey.
    Feet,
    Metres,
}

/// Titles that state a unit in brackets, as `z (ft)`: one of easting and northing, and that of heights.
///
/// # Errors
/// When the table cannot be read.
pub fn stated_by_titles(table: &Path) -> Result<[Option<(String, Stated)>; 2]> {
    let text = read_text(table)?;
    let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim).filter(|line| !line.is_empty());
    // Comments, of which one may be the heading, and the first line that is none.
    let mut is_over = false;
    let first = lines.take_while(|line| !std::mem::replace(&mut is_over, !line.starts_with('#')));
    let heading = first.map(|line| Heading::of(line.trim_start_matches('#').trim_start())).find(Heading::names_places);
    let Some(heading) = heading else { return Ok([None, None]) };
    let stated = |i: usize| {
        let field = heading.fields.get(column_at(&heading.heads, i)?)?;
        let unit: String = title_and_unit(field).1.chars().filter(|c| c.is_alphabetic()).collect();
        let known = [(&FEET[..], Stated::Feet), (&METRES[..], Stated::Metres)];
        let (_, unit) = known.into_iter().find(|(words, _)| words.contains(&unit.as_str()))?;
        Some((field.trim().to_string(), unit))
    };
    Ok([stated(0).or_else(|| stated(1)), stated(2)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brackets_tell_the_unit() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("t.csv");
        let told = |text: &str| {
            std::fs::write(&path, text).expect("written");
            stated_by_titles(&path).expect("read")
        };
        let z = Some(("Z (ft)".to_string(), Stated::Feet));
        assert_eq!(told("name,x,y,Z (ft),yaw\na,1,2,3,4\n"), [None, z.clone()]);
        assert_eq!(told("# made by hand\n# name,x,y,Z (ft),yaw\na,1,2,3,4\n"), [None, z]);
        let east = Some(("Easting [US ft]".to_string(), Stated::Feet));
        let height = Some(("z (m)".to_string(), Stated::Metres));
        assert_eq!(told("name,Easting [US ft],Northing [US ft],z (m)\na,1,2,3\n"), [east, height]);
        assert_eq!(told("name,x,y,z\n# z (ft)\na,1,2,3\n"), [None, None]);
        assert_eq!(told("a 1 2 3\n"), [None, None]);
    }
}
