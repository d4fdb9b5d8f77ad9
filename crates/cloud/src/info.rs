//! What a cloud is, read once from begin to end.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::error::Result;
use crate::io;
use crate::kdtree::Bounds;
use crate::schema::Batch;

const BATCH: usize = 1 << 14;

/// A cloud in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct Info {
    #[serde(serialize_with = "autoref_raster::path_text::one")]
    pub path: PathBuf,
    pub format: String,
    pub points: u64,
    /// Points whose coordinates are no finite numbers.
    pub invalid: u64,
    /// In map coordinates; none for a cloud without points.
    pub min: Option<[f64; 3]>,
    pub max: Option<[f64; 3]>,
    pub shift: Option<[f64; 3]>,
    pub crs: Option<String>,
    /// Over the bounding rectangle.
    pub points_per_m2: Option<f64>,
    pub dimensions: Vec<String>,
    /// Points by class.
    pub classes: BTreeMap<u8, u64>,
    /// What was passed over in the header, and behind the points.
    pub notes: Vec<String>,
}

/// Reads the cloud at `path`; `shift` takes the place of what the file says.
///
/// # Errors
/// When the file is no cloud, or breaks off.
pub fn info(path: &Path, shift: Option<[f64; 3]>) -> Result<Info> {
    let (header, mut reader) = io::open(path)?;
    let shift = shift.or(header.shift);
    let class = header.schema.field("classification").cloned();
    let mut bounds = Bounds::EMPTY;
    let (mut points, mut invalid) = (0, 0);
    let mut classes = BTreeMap::new();
    let mut batch = Batch::default();
    loop {
        reader.read(&mut batch, BATCH)?;
        if batch.is_empty() {
            break;
        }
        for (index, &xyz) in batch.xyz.iter().enumerate() {
            points += 1;
            if xyz.iter().all(|value| value.is_finite()) {
                bounds.add(xyz);
            } else {
                invalid += 1;
            }
            if let Some(field) = &class {
                *classes.entry(field.value(batch.record(&header.schema, index)) as u8).or_insert(0) += 1;
            }
        }
    }
    let mut notes: Vec<String> = header.las.iter().flat_map(|las| [&las.notes[..], &las.not_kept].concat()).collect();
    notes.extend(reader.left_over()?);
    let moved = |place: [f64; 3]| {
        let shift = shift.unwrap_or([0.0; 3]);
        (!bounds.is_empty()).then(|| [0, 1, 2].map(|axis| place[axis] + shift[axis]))
    };
    let area = (bounds.max[0] - bounds.min[0]) * (bounds.max[1] - bounds.min[1]);
    // Without a system a unit is a metre; degrees are none.
    let unit_m =
        header.parsed_crs().map_or(1.0, |crs| if crs.is_geographic() { f64::NAN } else { crs.metres_per_unit() });
    let area_m2 = area * unit_m * unit_m;
    let mut dimensions: Vec<String> = ["x", "y", "z"].map(String::from).into();
    let further = header.schema.fields.iter().map(|field| field.name.clone());
    dimensions.extend(further.filter(|name| !["x", "y", "z"].contains(&name.as_str())));
    Ok(Info {
        path: path.to_path_buf(),
        format: header.description,
        points,
        invalid,
        min: moved(bounds.min),
        max: moved(bounds.max),
        shift,
        crs: header.crs,
        points_per_m2: (area_m2 > 0.0 && area_m2.is_finite()).then(|| (points - invalid) as f64 / area_m2),
        dimensions,
        classes,
        notes,
    })
}
