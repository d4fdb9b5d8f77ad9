//! Clouds in files, read and written point by point.

mod copc;
mod e57;
mod e57_packets;
mod e57_schema;
mod geokeys;
mod las;
mod las_crs;
mod las_fields;
mod las_header;
mod las_plan;
mod las_write;
mod ply;
mod ply_write;
mod text;
mod text_head;
mod text_line;

use std::path::Path;

pub use las_header::LasHeader;

use autoref_raster::crs::Crs;

use crate::error::{Error, Result};
use crate::schema::{Batch, Schema};

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Las,
    Laz,
    /// LAZ with an octree; read as LAZ.
    Copc,
    Ply,
    E57,
    Text,
}

impl Format {
    /// As messages have it.
    pub fn name(self) -> &'static str {
        match self {
            Format::Las => "LAS",
            Format::Laz => "LAZ",
            Format::Copc => "COPC",
            Format::Ply => "PLY",
            Format::E57 => "E57",
            Format::Text => "text",
        }
    }
}

/// How finely a file stores its coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Precision {
    Single,
    Double,
    /// Whole multiples of these steps.
    Steps([f64; 3]),
}

/// What is known of a cloud before its points are read.
#[derive(Clone, Debug)]
pub struct Header {
    pub format: Format,
    /// As the file states it; text files do not.
    pub points: Option<u64>,
    pub schema: Schema,
    pub precision: Precision,
    /// WKT or `EPSG:n`.
    pub crs: Option<String>,
    /// Map coordinates less the file's, when the file says so.
    pub shift: Option<[f64; 3]>,
    /// Between which limits intensities lie that are no whole numbers of 16 bits, as LAS has them.
    pub intensity: Option<[f64; 2]>,
    /// Between which limits colours lie that are no whole numbers of 16 bits, nor bytes by their kind.
    pub colours: Option<[f64; 2]>,
    /// What a LAS file says of itself.
    pub las: Option<LasHeader>,
    /// `LAS 1.4, point format 6` and the like.
    pub description: String,
}

impl Header {
    /// The reference system, when it is understood.
    pub fn parsed_crs(&self) -> Option<Crs> {
        self.crs.as_deref().and_then(|text| Crs::parse(text).ok())
    }

    /// A reference system that PROJ does not understand gives way to `asked`; without one it goes on as it came.
    /// Answers what is to be said of that; `otherwise` is what becomes of it without `asked`.
    pub fn settle_crs(&mut self, asked: Option<&str>, otherwise: &str) -> Option<String> {
        let why = match Crs::parse(self.crs.as_deref()?).err()? {
            Error::Usage { what, .. } => what,
            other => other.to_string(),
        };
        if asked.is_none() {
            return Some(format!("{why}: {otherwise}; --crs replaces it"));
        }
        self.crs = None;
        if let Some(las) = &mut self.las {
            las.forget_crs();
        }
        Some(format!("{why}: that of --crs takes its place"))
    }

    /// Refuses a cloud in degrees, `asked` being the system of one that names none.
    ///
    /// # Errors
    /// When `what`, which needs lengths, would count in degrees.
    pub fn refuse_degrees(&self, path: &Path, asked: Option<&str>, what: &str) -> Result<()> {
        let crs = self.crs.as_deref().or(asked).and_then(|text| Crs::parse(text).ok());
        match crs.filter(Crs::is_geographic) {
            None => Ok(()),
            Some(crs) => Err(Error::usage(
                format!("{}: {what} needs lengths, and {} counts in degrees", path.display(), crs.title()),
                "bring the cloud into a map projection first (pdal translate IN OUT reprojection \
                 --filters.reprojection.out_srs=EPSG:…, or las2las)",
            )),
        }
    }
}

impl Header {
    /// What a cloud loses as PLY, in words.
    pub fn lost_in_ply(&self) -> Vec<String> {
        let mut notes: Vec<String> = self
            .las
            .iter()
            .flat_map(LasHeader::without_names)
            .map(|what| format!("PLY does not carry {what}"))
            .collect();
        for field in self.schema.fields.iter().filter(|field| ply_write::marks_none(field)) {
            notes.push(format!("PLY does not say which number stands for no value of `{}`", field.name));
        }
        notes
    }
}

/// `m`, or what the reference system counts in.
pub fn unit_of(crs: Option<&str>) -> String {
    let crs = crs.and_then(|text| Crs::parse(text).ok());
    let other = crs.filter(|crs| crs.is_geographic() || crs.metres_per_unit() != 1.0);
    other.map_or("m".into(), |crs| crs.unit_name().to_string())
}

/// Reads points in the file's order.
pub trait PointReader: Send {
    /// Replaces the content of `batch` by the next points, at most `limit`; an empty batch is the end.
    ///
    /// # Errors
    /// Truncated or corrupt files; the message names the point.
    fn read(&mut self, batch: &mut Batch, limit: usize) -> Result<()>;

    /// What is to be said of the file once its last point is read: points behind those that its header counts.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn left_over(&mut self) -> Result<Option<String>> {
        Ok(None)
    }
}

/// That the header of a file counts fewer points than the file holds.
fn uncounted(counted: u64, there: u64) -> Option<String> {
    (there > counted).then(|| {
        format!(
            "the header counts {counted} points, the file holds {there}: the last {} are not read; write the file anew \
             where it comes from, or correct the count",
            there - counted
        )
    })
}

/// Opens a cloud: LAS, LAZ (also COPC), PLY and E57 by their first bytes, everything else as a table of text.
///
/// # Errors
/// When the file cannot be opened, or its header breaks the format's rules.
pub fn open(path: &Path) -> Result<(Header, Box<dyn PointReader>)> {
    use std::io::Read;
    autoref_raster::bounded::refuse_endless(path)?;
    let mut file = std::fs::File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let metadata = file.metadata().map_err(|e| Error::io(path, "open", e))?;
    if metadata.is_dir() {
        return Err(Error::usage(format!("{}: is a folder", path.display()), "name its clouds one by one"));
    }
    let mut magic = Vec::new();
    file.by_ref().take(8).read_to_end(&mut magic).map_err(|e| Error::io(path, "read", e))?;
    drop(file);
    if magic.is_empty() {
        return Err(Error::format(path, "begin", "the file is empty"));
    }
    if magic.starts_with(b"LASF") {
        las::open(path)
    } else if magic.starts_with(b"ply ") || magic.starts_with(b"ply\n") || magic.starts_with(b"ply\r") {
        ply::open(path)
    } else if magic.starts_with(b"ASTM-E57") {
        e57::open(path)
    } else if magic.starts_with(b"# .PCD") || magic.starts_with(b"VERSION ") {
        let remedy = "make a PLY of it with pcl_pcd2ply, or a LAS with PDAL or CloudCompare";
        Err(Error::unsupported(path, "a PCD file of the Point Cloud Library", remedy))
    } else if magic.starts_with(b"version ") {
        let remedy = "fetch the file itself with `git lfs pull`";
        Err(Error::unsupported(path, "a pointer of Git LFS that stands for a file", remedy))
    } else if let Some(signature) = missing_signature(path) {
        let what = format!("the file does not begin with `{signature}`: it is none of its ending, or damaged");
        Err(Error::format(path, "begin", what))
    } else {
        text::open(path)
    }
}

/// What a file of this ending begins with.
fn missing_signature(path: &Path) -> Option<&'static str> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "las" | "laz" => Some("LASF"),
        "ply" => Some("ply"),
        "e57" => Some("ASTM-E57"),
        _ => None,
    }
}

/// A cloud on its way to disk.
pub trait PointWriter: Send {
    /// Appends points: coordinates as in the source, its raw records, and the class and further values of each.
    ///
    /// # Errors
    /// When the disk is full, or a coordinate does not fit the format.
    fn write(&mut self, points: &[OutPoint<'_>]) -> Result<()>;
    /// Completes the file.
    ///
    /// # Errors
    /// When the disk is full.
    fn finish(self: Box<Self>) -> Result<u64>;
}

/// A point to write.
pub struct OutPoint<'a> {
    /// In the source's coordinates.
    pub xyz: [f64; 3],
    /// The source's record.
    pub raw: &'a [u8],
    /// `None` leaves the class as it came.
    pub class: Option<u8>,
    /// Distance from the camera.
    pub range: Option<f64>,
}

/// What a writer has to know.
pub struct Target<'a> {
    pub source: &'a Header,
    /// Map coordinates less the source's.
    pub shift: [f64; 3],
    /// Points that will be written.
    pub points: u64,
    /// Whether points carry a range.
    pub with_range: bool,
    /// In the source's coordinates.
    pub min: [f64; 3],
    pub max: [f64; 3],
    /// WKT of the output when the source has none.
    pub crs_wkt: Option<&'a str>,
    /// Folder for scratch files.
    pub scratch: &'a Path,
    /// What the writer may take for itself.
    pub memory_bytes: u64,
}

/// Creates `path` in the format of `named`'s extension.
///
/// # Errors
/// An extension that is not written, a file that cannot be created, coordinates that the format cannot hold.
pub fn create(path: &Path, named: &Path, target: &Target<'_>) -> Result<Box<dyn PointWriter>> {
    match format_of(named)? {
        Format::Ply => ply_write::create(path, named, target),
        format => las_write::create(path, named, target, format),
    }
}

/// The format that an output's name asks for.
///
/// # Errors
/// When it asks for none that is written.
pub fn format_of(path: &Path) -> Result<Format> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    if name.ends_with(".copc.laz") {
        return Ok(Format::Copc);
    }
    match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("las") => Ok(Format::Las),
        Some("laz") => Ok(Format::Laz),
        Some("ply") => Ok(Format::Ply),
        _ => {
            Err(Error::unsupported(path, "this extension for a cloud", "name the output .laz, .copc.laz, .las or .ply"))
        }
    }
}

/// The name of a cloud without folder and extension.
pub fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    match name.strip_suffix(".copc.laz") {
        Some(stem) => stem.to_string(),
        None => Path::new(&name).file_stem().unwrap_or_default().to_string_lossy().into_owned(),
    }
}
