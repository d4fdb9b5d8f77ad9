//! Learning from colours alone: a table of samples, as the 2016 prototype took.

use std::path::Path;

use super::{LearnOptions, Lesson, density, widened};
use crate::profile::colour::{Metric, Space, lab_from_srgb};
use crate::profile::{ColourModel, Examine, Filters, GateLimits, Profile, Shape, Size, Target};
use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

/// Fewest colours that say how the paint varies.
const FEWEST: usize = 10;
/// Most colours of a table.
const MOST: usize = 4_000_000;
/// Largest table.
const TABLE_BYTES: u64 = 256 << 20;

/// Learns a profile from samples of the paint's colour (sRGB 0..=1), for marks of this size.
///
/// The colour limit is 3.5 standard deviations, and never below what holds 95 % of the samples. Nothing is known of the
/// ground, so the scores are those of any profile.
///
/// # Errors
/// [`Error::Usage`] with fewer than ten colours, or for a rule that leaves no box.
pub fn learn_colours(name: &str, colours: Vec<[f64; 3]>, size: Size, options: &LearnOptions) -> Result<Lesson> {
    if colours.len() < FEWEST {
        return Err(Error::usage(
            format!("{} colours say too little of how the paint varies", colours.len()),
            format!("give at least {FEWEST}, or one with --paint #RRGGBB in the main job"),
        ));
    }
    let (cloud, shape) = widened(&colours)?;
    let mut own: Vec<f64> = colours.iter().map(|c| shape.distance2(&lab_from_srgb(*c)).sqrt()).collect();
    own.sort_by(f64::total_cmp);
    let rough_box = options.rough_box.map(|rule| rule.of(&colours)).transpose()?;
    let profile = Profile {
        name: name.to_owned(),
        description: format!("Learned from {} colours", colours.len()),
        shape: Shape::Any,
        colour: ColourModel {
            space: Space::Lab,
            metric: Metric::Mahalanobis,
            limit: own[own.len() * 95 / 100].max(3.5),
            rough_box,
            rough: None,
            clouds: vec![cloud],
        },
        size,
        gates: GateLimits::default(),
        filters: Filters::default(),
        examine: Examine { split: true, density: options.density.then(|| density(&colours)), ..Examine::default() },
        target: Target::default(),
        tag: None,
        learned: None,
    };
    profile.validate()?;
    Ok(Lesson { profile, paint: colours })
}

/// Reads a table of colours: three numbers a row, red, green, blue, of 0 to 1 or of 0 to 255, with or without titles;
/// commas, semicolons, tabs or spaces between. With titles, the columns named red/r, green/g, blue/b are taken. Colours
/// in 0..=1 come back; a table is of 0 to 1 when no value in it is above 1.
///
/// # Errors
/// [`Error::Format`] naming the row that is no colour; [`Error::Limit`] above four million rows.
pub fn read_colours(path: &Path) -> Result<Vec<[f64; 3]>> {
    let text = bounded::read_to_string(path, "a table of colours", TABLE_BYTES)?;
    let mut colours: Vec<[f64; 3]> = Vec::new();
    let mut columns = [0, 1, 2];
    let mut titled = false;
    for (index, line) in text.lines().enumerate() {
        let line = line.trim_start_matches('\u{feff}').trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let wrong = |what: String| Error::format(path, format!("row {}", index + 1), what);
        let cells = cells(line);
        if colours.is_empty() && !titled && cells.iter().all(|cell| cell.parse::<f64>().is_err()) {
            columns = titles(&cells).ok_or_else(|| wrong("no columns red, green and blue".into()))?;
            titled = true;
            continue;
        }
        if !titled && cells.len() != 3 {
            return Err(wrong(format!(
                "{} where red, green and blue are expected",
                counted(cells.len(), "value", "values")
            )));
        }
        let value = |column: usize| {
            let cell = cells.get(column).map_or("", String::as_str);
            let value = cell.parse::<f64>().ok().filter(|v| (0.0..=255.0).contains(v));
            value.ok_or_else(|| wrong(format!("`{cell}` is no value of 0 to 1 or 0 to 255")))
        };
        colours.push([value(columns[0])?, value(columns[1])?, value(columns[2])?]);
        if colours.len() > MOST {
            return Err(Error::Limit {
                what: format!("{}: colours", path.display()),
                needed: MOST as u64 + 1,
                allowed: MOST as u64,
                remedy: "thin the table out".into(),
            });
        }
    }
    if colours.iter().flatten().any(|v| *v > 1.0) {
        colours.iter_mut().flatten().for_each(|v| *v /= 255.0);
    }
    Ok(colours)
}

/// What stands between commas, semicolons, tabs or spaces. A decimal comma is one where semicolons, tabs or spaces
/// divide.
fn cells(line: &str) -> Vec<String> {
    let plain = |cell: &str| cell.trim().trim_matches('"').to_owned();
    for divider in [';', '\t'] {
        if line.contains(divider) {
            return line.split(divider).map(|cell| plain(&cell.replace(',', "."))).collect();
        }
    }
    if line.contains(", ") || line.split_whitespace().count() < 3 {
        return line.split(',').map(plain).collect();
    }
    line.split_whitespace().map(|cell| plain(&cell.replace(',', "."))).collect()
}

fn titles(cells: &[String]) -> Option<[usize; 3]> {
    let column =
        |names: [&str; 2]| cells.iter().position(|cell| names.iter().any(|name| cell.eq_ignore_ascii_case(name)));
    Some([column(["red", "r"])?, column(["green", "g"])?, column(["blue", "b"])?])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<[f64; 3]>> {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), text).expect("writable");
        read_colours(file.path())
    }

    #[test]
    fn tables_as_people_have_them() {
        let expected = [[1.0, 0.2, 0.4], [0.6, 0.8, 0.0]];
        for text in [
            "255,51,102\n153,204,0\n",
            "255 51 102\n153 204 0\n",
            "255, 51, 102\r\n153, 204, 0\r\n",
            "r;g;b\n255;51;102\n153;204;0\n",
            "\u{feff}Blue\tGreen\tname\tRed\n102\t51\ta\t255\n0\t204\tb\t153\n",
            "1;0,2;0,4\n0,6;0,8;0\n",
            "# from a raw image\n1 0.2 0.4\n\n0.6 0.8 0\n",
        ] {
            let found = read(text).unwrap_or_else(|e| panic!("{text}: {e}"));
            assert_eq!(found.len(), 2, "{text}");
            for (one, other) in found.iter().flatten().zip(expected.iter().flatten()) {
                assert!((one - other).abs() < 1e-12, "{text}: {found:?}");
            }
        }
    }

    #[test]
    fn what_is_no_table_of_colours_is_refused_with_its_row() {
        for (text, what) in [
            ("1,2\n", "row 1: 2 values"),
            ("1,2,3\n4,5,300\n", "row 2: `300`"),
            ("1,2,3\n4,x,5\n", "row 2: `x`"),
            ("x,y,z\n1,2,3\n", "row 1: no columns red"),
        ] {
            let error = read(text).expect_err(text).to_string();
            assert!(error.contains(what), "{text}: {error}");
        }
    }

    #[test]
    fn colours_make_a_profile_that_holds_them() {
        let colours: Vec<[f64; 3]> = (0..40).map(|i| [0.9, 0.4 + 0.002 * f64::from(i), 0.1]).collect();
        let size = Size { min_px: Some(5.0), max_px: Some(60.0), min_m: None, max_m: None };
        let lesson = learn_colours("amber", colours.clone(), size, &LearnOptions::default()).expect("enough");
        assert_eq!(lesson.profile.colour.limit, 3.5);
        assert!(learn_colours("amber", colours[..9].to_vec(), size, &LearnOptions::default()).is_err());
    }
}
