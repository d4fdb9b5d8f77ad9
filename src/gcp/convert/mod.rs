//! One list of GCPs into another format, with every loss named.
//!
//! Coordinates stay in the CRS of the list, digit by digit where the format allows it, unless another is asked for; KML
//! and GPX know nothing but longitude and latitude, and change them. What the other format cannot hold is left out and
//! listed in [`Converted::lost`]; nothing is put in its place.

mod kof;
mod losses;
pub(crate) mod names;
mod vectors;
mod words;

pub use crate::gcp::list_format::ListFormat;

use std::path::{Path, PathBuf};

use crate::gcp::Gcp;
use crate::gcp::order::Shown;
use crate::gcp::raw::{ColumnOrder, RawPoint, Seen};
use crate::gcp::working_crs;
use crate::gcp::{degrees, metres, place, read, recognise};
use autoref_raster::atomic::Transaction;
use autoref_raster::crs::{Crs, DEFAULT_DATUM_ACCURACY_M};
use autoref_raster::error::{Error, Result};

/// What the caller says.
#[derive(Clone, Debug, Default)]
pub struct ConvertOptions {
    /// Format of the input. Default: recognised as everywhere.
    pub from: Option<ListFormat>,
    /// Format of the output. Default: by its name.
    pub to: Option<ListFormat>,
    /// CRS of the coordinates, over what the list says.
    pub crs: Option<String>,
    /// CRS that the coordinates are brought into. Default: they stay as they are.
    pub to_crs: Option<String>,
    /// Layer of a file with several.
    pub layer: Option<String>,
    /// How far off a change of datum may be, metres. Default: [`DEFAULT_DATUM_ACCURACY_M`].
    pub datum_accuracy_m: Option<f64>,
}

/// What was done.
#[derive(Clone, Debug, PartialEq)]
pub struct Converted {
    pub from: ListFormat,
    pub to: ListFormat,
    pub points: usize,
    pub crs: Option<Crs>,
    /// What the output does not say any more, in plain words; empty when nothing was lost.
    pub lost: Vec<String>,
    pub notes: Vec<String>,
    pub files: Vec<PathBuf>,
}

/// Decimals of projected coordinates: 0.1 mm where the unit is a metre, and of longitude and latitude: 0.01 mm.
const LENGTH_DIGITS: i32 = 4;
const DEGREE_DIGITS: i32 = 10;

/// A list on its way.
pub(super) struct Survey {
    pub points: Vec<RawPoint>,
    pub crs: Option<Crs>,
}

impl Survey {
    fn gcps(&self) -> impl Iterator<Item = &Gcp> + Clone {
        self.points.iter().map(|p| &p.gcp)
    }

    /// Brings all points into another CRS.
    ///
    /// # Errors
    /// When the list has no CRS, or PROJ has no way between the two that is good enough.
    fn project(&mut self, input: &Path, target: Crs, worst_accuracy_m: f64, notes: &mut Vec<String>) -> Result<()> {
        let Some(source) = &self.crs else {
            return Err(Error::usage(
                format!("{} names no coordinate reference system: nothing can be brought from it", input.display()),
                "give --crs, the one of its coordinates",
            ));
        };
        // Columns of the old coordinates go with them.
        for point in &mut self.points {
            point.attributes = losses::extra(point).cloned().collect();
        }
        let mut gcps: Vec<Gcp> = self.gcps().cloned().collect();
        working_crs::change(input, &mut gcps, source, &target, worst_accuracy_m, notes)?;
        let per_unit = 10f64.powi(if target.is_geographic() { DEGREE_DIGITS } else { LENGTH_DIGITS });
        let per_metre = 10f64.powi(LENGTH_DIGITS);
        for (point, gcp) in self.points.iter_mut().zip(gcps) {
            let rounded = |value: f64| (value * per_unit).round() / per_unit;
            let is_same = gcp.height == point.gcp.height;
            let height = if is_same { gcp.height } else { gcp.height.map(|h| (h * per_metre).round() / per_metre) };
            point.gcp = Gcp { easting: rounded(gcp.easting), northing: rounded(gcp.northing), height, ..gcp };
        }
        self.crs = Some(target);
        Ok(())
    }

    fn any(&self, has: impl Fn(&Gcp) -> bool) -> bool {
        self.gcps().any(has)
    }

    /// One image and one place in it for each point: what flat tables can hold.
    fn first_seen(point: &RawPoint) -> Option<&Seen> {
        point.pixels.first()
    }
}

/// Reads a list and writes it in another format.
///
/// # Errors
/// When the list cannot be read, the output's format is not known, or the points lack what that format demands.
pub fn convert(input: &Path, output: &Path, options: &ConvertOptions) -> Result<Converted> {
    let to = match options.to.or_else(|| ListFormat::of_name(output)) {
        Some(to) => to,
        None => {
            let names = ListFormat::WRITTEN.map(ListFormat::name).join(", ");
            return Err(Error::usage(
                format!("the name {} does not say which format to write", output.display()),
                format!("give --to with one of {names}"),
            ));
        }
    };
    if !ListFormat::WRITTEN.contains(&to) {
        return Err(Error::usage(
            format!("{} is read, never written", to.title()),
            format!("give --to with one of {}", ListFormat::WRITTEN.map(ListFormat::name).join(", ")),
        ));
    }
    let (raw, from) = recognise::parse(input, options.layer.as_deref(), options.from)?;
    let mut raw = read::by_the_crs(input, raw, options.crs.as_deref())?;
    let (units, read) = (std::mem::take(&mut raw.units), std::mem::take(&mut raw.read));
    let (set_aside, drawn_in) = (raw.set_aside.take(), raw.drawn_in);
    let is_untitled = raw.order == ColumnOrder::Untitled;
    let target = options.to_crs.as_deref().map(Crs::parse).transpose()?;
    let shown = Shown { target: target.as_ref(), image: None };
    let (mut points, crs, mut notes) = read::settled(input, raw, options.crs.as_deref(), shown)?;
    if is_untitled && crs.is_none() {
        degrees::refuse_untitled_degrees(input, &points)?;
    }
    // What is said again in a column is known by its number, which another unit changes.
    losses::drop_said(&mut points, &read);
    metres::of_drawing(input, &mut points, (crs.as_ref(), drawn_in), &mut notes)?;
    units.apply(input, &mut points, crs.as_ref(), &mut notes)?;
    if let Some(crs) = &crs {
        degrees::refuse_beyond_poles(input, &points, crs)?;
        place::refuse_known_mistakes(input, &points, crs, &mut notes)?;
    }
    if points.is_empty() {
        return Err(Error::format(input, "the list", "it holds no points"));
    }
    let worst_accuracy_m = options.datum_accuracy_m.unwrap_or(DEFAULT_DATUM_ACCURACY_M);
    let mut survey = Survey { points, crs };
    if let Some(target) = target {
        survey.project(input, target, worst_accuracy_m, &mut notes)?;
    }
    losses::refuse(input, &survey, to)?;
    let mut lost = losses::of(&survey, to);
    lost.extend(set_aside);
    for point in &mut survey.points {
        point.gcp.name = names::held(to, &point.gcp.name).into_owned();
    }
    let mut transaction = Transaction::new();
    if to.is_text() {
        let text = words::write(&survey, to)?;
        transaction.stage_bytes(output, text.as_bytes())?;
    } else {
        lost.extend(vectors::write(&survey, to, worst_accuracy_m, output, &mut transaction)?);
    }
    if to == ListFormat::Odm && survey.points.iter().all(|p| p.pixels.is_empty()) {
        notes.push(
            "no point was seen in an image: the list has `label x y z` under its CRS, which OpenDroneMap itself does not take"
                .into(),
        );
    }
    let files = transaction.paths();
    transaction.commit()?;
    Ok(Converted { from, to, points: survey.points.len(), crs: survey.crs, lost, notes, files })
}
