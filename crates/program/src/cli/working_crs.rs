//! Flags that say how coordinates are understood, and the way from the fit's metres to the outputs.

use autoref_raster::RasterInfo;
use autoref_raster::crs::{Coordinate, DEFAULT_DATUM_ACCURACY_M};
use autoref_raster::error::Error;
use autoref_stream::gcp::{Gcp, GcpList, GcpOptions, ImageGeoreference, Reproject};
use autoref_stream::matching::diagnosis::Mistake;
use autoref_stream::result::{RunResult, Warning};
use clap::{Args, ValueEnum};

use crate::cli::values::word_of;

#[derive(Args, Debug)]
pub struct WorkingCrsArgs {
    /// Whether --to-crs is applied to the points before the fit, or to the result after it.
    #[arg(long, value_enum, default_value = "before", help_heading = "Ground control points")]
    pub reproject: ReprojectArg,
    /// Worst accuracy of a change of datum that is accepted, metres by the authority's word: by --to-crs, and to the
    /// WGS 84 of --write exif.
    #[arg(long, value_name = "M", default_value_t = DEFAULT_DATUM_ACCURACY_M, help_heading = "Ground control points")]
    pub datum_accuracy: f64,
    /// Layer of a file with several (GeoPackage, KML, spreadsheet).
    #[arg(long, value_name = "NAME", help_heading = "Ground control points")]
    pub gcp_layer: Option<String>,
    /// Exchange easting and northing (latitude and longitude) when all points show that they are exchanged.
    #[arg(long, help_heading = "Ground control points")]
    pub fix_axes: bool,
    /// Go on in spite of a mistake that is plain, by its name; may be given several times.
    #[arg(long, value_enum, value_name = "NAME", action = clap::ArgAction::Append, help_heading = "Ground control points")]
    pub force: Vec<Force>,
}

/// A mistake that refuses a run unless it is named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Force {
    /// The list lies on the image only when it is read in a neighbouring UTM zone.
    WrongZone,
    /// The list lies on the image only when its numbers are feet.
    Feet,
    /// The list lies on the image only after division by a factor of ground to grid.
    GroundCoordinates,
    /// The list lies on the image only with other leading digits.
    LeadingDigits,
    /// Points lie outside the area of use of their CRS.
    OutsideArea,
}

impl Force {
    /// What must be named for this mistake of a whole list; `None` for mistakes of single rows.
    pub fn of(mistake: Mistake) -> Option<Force> {
        match mistake {
            Mistake::WrongUtmZone => Some(Force::WrongZone),
            Mistake::Feet | Mistake::InternationalFeet | Mistake::UsSurveyFeet | Mistake::GsdInFeet => {
                Some(Force::Feet)
            }
            Mistake::GridToGround => Some(Force::GroundCoordinates),
            Mistake::LeadingDigits => Some(Force::LeadingDigits),
            Mistake::EastingNorthingSwapped
            | Mistake::MirroredImage
            | Mistake::CoordinatesExchanged
            | Mistake::MistypedDigit
            | Mistake::TransposedDigits
            | Mistake::LabelsExchanged => None,
        }
    }

    /// As the command line has it.
    pub fn name(self) -> String {
        word_of(self)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ReprojectArg {
    Before,
    After,
}

impl WorkingCrsArgs {
    pub fn fill(&self, options: &mut GcpOptions) {
        options.reproject = match self.reproject {
            ReprojectArg::Before => Reproject::Before,
            ReprojectArg::After => Reproject::After,
        };
        options.datum_accuracy_m = self.datum_accuracy;
        options.layer = self.gcp_layer.clone();
        options.fix_axes = self.fix_axes;
        options.keep_outside = self.force.contains(&Force::OutsideArea);
    }
}

/// What an image says of itself, for lists that name no CRS.
pub fn of_image(info: &RasterInfo) -> Option<ImageGeoreference> {
    Some(ImageGeoreference {
        crs_wkt: info.crs_wkt.clone().filter(|wkt| !wkt.is_empty())?,
        transform: info.geotransform,
        size_px: (info.width, info.height),
    })
}

/// Where the points of a list lie in the CRS of the outputs.
///
/// # Errors
/// When they cannot be brought into it.
pub fn places(list: &GcpList) -> Result<Vec<Coordinate>, Error> {
    let place = |gcp: &Gcp| Coordinate { x: gcp.easting, y: gcp.northing, height: gcp.height };
    let mut places: Vec<Coordinate> = list.gcps.iter().map(place).collect();
    list.working_crs.leave(&mut places)?;
    Ok(places)
}

/// Brings transform and points of a result from the metres of the fit into the units and CRS of the outputs. Residuals,
/// scale and the solution itself stay in metres.
pub fn deliver(result: &mut RunResult, list: &GcpList, size_px: Option<(f64, f64)>) -> anyhow::Result<()> {
    let Some(solved) = result.solved_mut().filter(|_| !list.working_crs.is_plain()) else { return Ok(()) };
    let mut points: Vec<Coordinate> = solved
        .matches
        .iter()
        .chain(&solved.check_points)
        .map(|row| Coordinate { x: row.easting, y: row.northing, height: row.height })
        .collect();
    // Without an image the marks tell how far the transform has to hold.
    let marks = solved.matches.iter().fold((1.0, 1.0), |(w, h): (f64, f64), row| (w.max(row.x), h.max(row.y)));
    let delivered = list.working_crs.deliver(&solved.geotransform, size_px.unwrap_or(marks))?;
    list.working_crs.leave(&mut points)?;
    for (row, point) in solved.matches.iter_mut().chain(&mut solved.check_points).zip(points) {
        (row.easting, row.northing, row.height) = (point.x, point.y, point.height);
    }
    solved.geotransform = delivered.transform;
    result.warnings.extend(delivered.notes.into_iter().map(Warning::Said));
    Ok(())
}
