//! A list as a file has it, before anything is chosen or projected.

use std::path::Path;

use crate::gcp::Gcp;
use crate::gcp::units::{TitledUnits, Unit};
use autoref_raster::coords::PixelPoint;
use autoref_raster::crs::Crs;
use autoref_raster::error::Error;

/// A point as the file has it.
pub(super) struct RawPoint {
    pub gcp: Gcp,
    /// "row 7", "feature 3".
    pub place: String,
    /// Everything that the file says of it, by column.
    pub attributes: Vec<(String, String)>,
    /// Where it was seen, when the list says so.
    pub pixels: Vec<Seen>,
}

/// A place in an image; (0, 0) is the outer corner of the first pixel.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Seen {
    /// `None` when the list belongs to one image, which it does not name.
    pub image: Option<String>,
    pub at: PixelPoint,
}

impl RawPoint {
    /// A point of which nothing else is listed; `place` is where it stands in the file.
    pub fn bare(gcp: Gcp, place: impl Into<String>) -> Self {
        RawPoint { gcp, place: place.into(), attributes: Vec::new(), pixels: Vec::new() }
    }
}

/// What a file says of its coordinate reference system.
pub(super) enum CrsClaim {
    None,
    Known(Crs),
    /// It names one that is not understood: an error unless `--crs` overrides it.
    Unclear(Error),
}

impl CrsClaim {
    /// What a file claims at `place`.
    pub fn read(path: &Path, place: String, definition: &str) -> Self {
        match Crs::parse(definition) {
            Ok(crs) => CrsClaim::Known(crs),
            Err(error) => CrsClaim::Unclear(Error::format(path, place, format!("{error}; --crs overrides it"))),
        }
    }
}

/// Whether the file says which coordinate is the easting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ColumnOrder {
    Stated,
    /// East before north by custom, which is not everybody's.
    Assumed,
    /// As [`ColumnOrder::Assumed`], without a word over the columns: degrees stand in either order.
    Untitled,
    /// East before north, and of degrees the latitude first (Pix4D).
    LatitudeFirst,
    /// East before north by the format's own rule, which not everybody keeps (GeoJSON): only what cannot be is
    /// exchanged.
    Ruled,
}

/// What a format's reader returns.
pub(super) struct RawList {
    pub points: Vec<RawPoint>,
    pub crs: CrsClaim,
    /// The format says longitude, latitude when nothing else is said (GeoJSON).
    pub may_be_degrees: bool,
    pub order: ColumnOrder,
    /// Titles say longitude and latitude.
    pub titled_degrees: bool,
    /// A number whose mark can stand before decimals or between thousands, where nothing in the file shows it.
    pub open_mark: Option<String>,
    /// The same points by other columns of theirs: coordinates of a map beside degrees, or the other way round.
    pub beside: Option<Box<RawList>>,
    pub units: TitledUnits,
    /// What the head of a drawing says that it counts in.
    pub drawn_in: Option<Unit>,
    /// Titles of columns that became parts of the points.
    pub read: Vec<String>,
    /// Rows that are no points, in plain words.
    pub set_aside: Option<String>,
    pub notes: Vec<String>,
}

impl RawList {
    /// Points of which nothing is doubtful yet.
    pub fn new(points: Vec<RawPoint>, crs: CrsClaim) -> Self {
        RawList {
            points,
            crs,
            may_be_degrees: false,
            order: ColumnOrder::Stated,
            titled_degrees: false,
            open_mark: None,
            beside: None,
            units: TitledUnits::default(),
            drawn_in: None,
            read: Vec::new(),
            set_aside: None,
            notes: Vec::new(),
        }
    }
}
