//! How well each point was surveyed, in a table of its own: a name and one σ, or σ of easting, northing and height.

use std::path::Path;

use super::text::{self, SEPARATORS, Separator, refuse_more_cells};
use super::titles::{NAMES, find, tidy};
use super::units::Unit;
use crate::gcp::Gcp;
use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};
use autoref_raster::ranks::upper_median;
use autoref_raster::words::first_of;

// As `tidy` leaves titles: small letters, blanks for underscores.
const SIGMAS: [&str; 6] = ["sigma", "sigma m", "accuracy", "accuracy m", "std", "sigma xy"];
const SIGMAS_E: [&str; 5] = ["sigma e", "sigma easting", "sigma x", "std e", "se"];
const SIGMAS_N: [&str; 5] = ["sigma n", "sigma northing", "sigma y", "std n", "sn"];
const SIGMAS_H: [&str; 8] =
    ["sigma h", "sigma height", "sigma height m", "sigma z", "std h", "std z", "sh", "accuracy z"];

/// What a row says, metres.
struct Row {
    name: String,
    sigma_m: Option<f64>,
    sigma_height_m: Option<f64>,
}

/// Sets the survey's errors of the named points; the others keep what their list says. With different σ of easting and
/// northing their root mean square is kept, since weights and statement ask for the sum of squares only.
///
/// Returns what looks odd, in plain words: names of no point, points without a row.
///
/// # Errors
/// When the file cannot be read, has no column of names or no column of σ, or a value is no number of at least zero.
pub(super) fn apply(path: &Path, gcps: &mut [Gcp]) -> Result<Vec<String>> {
    let bytes = bounded::read(path, "a table of errors", bounded::TEXT_BYTES)?;
    let text = text::decode(&bytes).ok_or_else(|| Error::format(path, "row 1", "is no table of text"))?;
    text::refuse_long_rows(path, &text)?;
    let rows = parse(path, &text)?;
    let mut unknown = Vec::new();
    let mut named = std::collections::HashSet::new();
    for row in rows {
        if !named.insert(row.name.clone()) {
            return Err(Error::format(path, format!("point `{}`", row.name), "is named twice; keep one row"));
        }
        match gcps.iter_mut().find(|gcp| gcp.name == row.name) {
            None => unknown.push(row.name),
            Some(gcp) => {
                gcp.sigma_m = row.sigma_m.or(gcp.sigma_m);
                gcp.sigma_height_m = row.sigma_height_m.or(gcp.sigma_height_m);
            }
        }
    }
    let missing: Vec<&str> =
        gcps.iter().filter(|gcp| !named.contains(&gcp.name)).map(|gcp| gcp.name.as_str()).collect();
    let mut notes = Vec::new();
    let mut note = |names: &[&str], what: &str| {
        if !names.is_empty() {
            notes.push(format!("{}: {what} {}", path.display(), first_of(names, 8)));
        }
    };
    note(&unknown.iter().map(String::as_str).collect::<Vec<_>>(), "no point of the list is called");
    note(&missing, "says nothing of");
    Ok(notes)
}

/// No survey is as coarse as a metre: what to say where most of the stated errors are larger.
pub(super) fn no_survey(path: &Path, gcps: &[Gcp]) -> Option<String> {
    const COARSE_M: f64 = 1.0;
    let median = |of: fn(&Gcp) -> Option<f64>| {
        let mut stated: Vec<f64> = gcps.iter().filter_map(of).collect();
        upper_median(&mut stated).filter(|sigma| *sigma > COARSE_M)
    };
    let sigma = median(|gcp| gcp.sigma_m).or_else(|| median(|gcp| gcp.sigma_height_m))?;
    Some(format!(
        "{}: the stated accuracies, {sigma} m in the middle, are taken as metres; if they are millimetres, say so in the \
         title, as in `sigma_mm`",
        path.display()
    ))
}

/// The separator that finds a name and an error in the header, since titles have blanks in them; else the one that cuts
/// it into most titles.
fn separator_of(header: &str) -> Separator {
    let finds = |separator: &Separator| {
        let titles: Vec<String> = text::split(header, *separator).iter().map(|title| tidy(title)).collect();
        let errors = [&SIGMAS[..], &SIGMAS_E, &SIGMAS_H].concat();
        find(&titles, NAMES).is_some() && find(&titles, &errors).is_some()
    };
    let most = || SEPARATORS.into_iter().max_by_key(|&separator| text::split(header, separator).len());
    SEPARATORS.into_iter().find(finds).or_else(most).expect("there are separators")
}

fn parse(path: &Path, text: &str) -> Result<Vec<Row>> {
    let lines = text::lines(text);
    let mut lines = lines.iter().filter(|line| !line.is_comment());
    let Some(header) = lines.next() else {
        return Err(Error::format(path, "row 1", "the file holds no header and no points"));
    };
    let header_row = header.row;
    let cut = separator_of(header.text);
    let written = text::split(header.text, cut);
    let titles: Vec<String> = written.iter().map(|title| tidy(title)).collect();
    let unit = |column: usize| Unit::of_accuracy(&written[column]).map_or(1.0, |unit| unit.metres);
    let find = |names: &[&str]| find(&titles, names);
    let Some(name) = find(NAMES) else {
        return Err(Error::format(path, format!("row {header_row}"), "no column of names; call one `name`"));
    };
    let (sigma, e, n, h) = (find(&SIGMAS), find(&SIGMAS_E), find(&SIGMAS_N), find(&SIGMAS_H));
    if sigma.is_none() && h.is_none() && (e.is_none() || n.is_none()) {
        return Err(Error::format(
            path,
            format!("row {header_row}"),
            "no errors in the header; name `sigma`, or `sigma_e`, `sigma_n` and `sigma_h`, in metres",
        ));
    }
    lines
        .map(|line| {
            let row = line.row;
            let fields = text::split(line.text, cut);
            let read = (line, fields);
            refuse_more_cells(path, &read, titles.len(), cut)?;
            let (_, fields) = read;
            let number = |column: Option<usize>| -> Result<Option<f64>> {
                let text = column.and_then(|c| fields.get(c)).map(|t| t.trim()).filter(|t| !t.is_empty());
                let Some((column, text)) = column.zip(text) else { return Ok(None) };
                text::number(text).filter(|v| *v >= 0.0).map(|v| Some(v * unit(column))).ok_or_else(|| {
                    Error::format(path, format!("row {row}"), format!("`{text}` is no error of at least 0"))
                })
            };
            let name = fields.get(name).map(|t| t.trim_matches('"').trim().to_string()).unwrap_or_default();
            if name.is_empty() {
                return Err(Error::format(path, format!("row {row}"), "the name is missing"));
            }
            let one = number(sigma)?;
            let both = number(e)?.zip(number(n)?).map(|(e, n)| ((e * e + n * n) / 2.0).sqrt());
            // One σ is that of every coordinate, unless the height has its own.
            Ok(Row { name, sigma_m: both.or(one), sigma_height_m: number(h)?.or(one) })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn applied(text: &str) -> Result<(Vec<Gcp>, Vec<String>)> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("accuracy.csv");
        std::fs::write(&path, text).expect("writable");
        let mut gcps = vec![Gcp::control("A", 0.0, 0.0), Gcp::control("B", 1.0, 0.0)];
        gcps[1].sigma_m = Some(0.5);
        let notes = apply(&path, &mut gcps)?;
        Ok((gcps, notes))
    }

    #[test]
    fn one_sigma_or_three() {
        let (gcps, notes) = applied("name,sigma_e,sigma_n,sigma_h\nA,0.03,0.01,0.05\nX,1,1,1\n").expect("a table");
        assert!((gcps[0].sigma_m.expect("stated") - 0.0005f64.sqrt()).abs() < 1e-15);
        assert_eq!((gcps[0].sigma_height_m, gcps[1].sigma_m), (Some(0.05), Some(0.5)));
        assert!(notes[0].contains("X") && notes[1].contains("says nothing of B"), "{notes:?}");
        let (gcps, notes) = applied("Point;Sigma\nA;0,02\nB;0,04\n").expect("decimal commas");
        assert_eq!((gcps[0].sigma_m, gcps[1].sigma_m, gcps[1].sigma_height_m), (Some(0.02), Some(0.04), Some(0.04)));
        assert!(notes.is_empty());
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, place) in [
            ("", "row 1"),
            ("sigma\n0.1\n", "names"),
            ("name,height\nA,1\n", "sigma"),
            ("name,sigma\nA,-1\n", "row 2"),
            ("name,sigma\nA,x\n", "row 2"),
            ("name,sigma\nA,1\nA,2\n", "`A`"),
            ("name,sigma\n,2\n", "row 2"),
            ("name,sigma\nA,0,01\n", "3 cells under 2 titles"),
            ("name,sigma_e,sigma_n,sigma_h\nA,0,01,0,02,0,03\n", "decimal commas"),
        ] {
            let message = applied(text).expect_err(place).to_string();
            assert!(message.contains(place) && !message.contains('\n'), "{message}");
        }
    }
}
