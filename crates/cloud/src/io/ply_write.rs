//! PLY, binary little-endian: what came in, and the class and the range beside it.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use autoref_raster::crs::Crs;

use super::{OutPoint, PointWriter, Target};
use crate::error::{Error, Result};
use crate::schema::{Field, Kind};

/// Larger whole numbers are not all doubles.
const WHOLE_UP_TO: f64 = 9_007_199_254_740_992.0;

struct PlyWriter {
    path: PathBuf,
    file: BufWriter<File>,
    /// Coordinates come first as doubles when the source's records do not hold them.
    with_axes: bool,
    /// Copied as they are.
    fields: Vec<Field>,
    class: Option<Field>,
    with_range: bool,
    written: u64,
    line: Vec<u8>,
}

pub(super) fn create(path: &Path, named: &Path, target: &Target<'_>) -> Result<Box<dyn PointWriter>> {
    let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
    let mut file = BufWriter::with_capacity(1 << 20, file);
    let schema = &target.source.schema;
    let mut head = String::from("ply\nformat binary_little_endian 1.0\n");
    if target.shift != [0.0; 3] {
        let [e, n, h] = target.shift;
        head += &format!("comment shift {e} {n} {h}\n");
    }
    if let Some(crs) = target.source.crs.as_deref().or(target.crs_wkt) {
        // A code where there is one: headers are ASCII, and WKT writes ° in its areas.
        let is_code = |text: &str| text.starts_with("EPSG:");
        let crs = Crs::parse(crs).ok().filter(|_| !is_code(crs)).map_or_else(|| crs.to_string(), |crs| crs.label());
        let crs: String = crs.chars().map(|c| if c.is_ascii() { c } else { '?' }).collect();
        let line: String = crs.split_whitespace().collect::<Vec<_>>().join(" ");
        head += &format!("comment crs {line}\n");
    }
    head += &format!("element vertex {}\n", target.points);
    let with_axes = schema.field("x").is_none();
    if with_axes {
        head += "property double x\nproperty double y\nproperty double z\n";
    }
    let fields: Vec<Field> = schema
        .fields
        .iter()
        .filter(|field| field.name != "classification" && !(target.with_range && field.name == "range"))
        .cloned()
        .collect();
    for field in &fields {
        let name = field.name.split_whitespace().collect::<Vec<_>>().join("_");
        head += &format!("property {} {name}\n", stored_kind(field).ply_name());
    }
    head += "property uchar classification\n";
    if target.with_range {
        head += "property double range\n";
    }
    head += "end_header\n";
    file.write_all(head.as_bytes()).map_err(|e| Error::io(path, "write", e))?;
    Ok(Box::new(PlyWriter {
        path: named.to_path_buf(),
        file,
        with_axes,
        fields,
        class: schema.field("classification").cloned(),
        with_range: target.with_range,
        written: 0,
        line: Vec::new(),
    }))
}

/// The kind in which the value, not the stored number, can be kept.
fn stored_kind(field: &Field) -> Kind {
    if field.bits.is_some() {
        Kind::U8
    } else if field.scale != 1.0 || field.shift != 0.0 {
        Kind::F64
    } else {
        field.kind
    }
}

/// Whether a number that stands for no value is written as it is stored; in doubles and singles it becomes NaN.
pub(super) fn marks_none(field: &Field) -> bool {
    field.no_data.is_some() && !matches!(stored_kind(field).ply_name(), "float" | "double")
}

impl PointWriter for PlyWriter {
    fn write(&mut self, points: &[OutPoint<'_>]) -> Result<()> {
        for point in points {
            self.line.clear();
            if self.with_axes {
                point.xyz.iter().for_each(|value| self.line.extend_from_slice(&value.to_le_bytes()));
            }
            for field in &self.fields {
                match stored_kind(field) {
                    Kind::F32 if field.no_data.is_some() => {
                        self.line.extend_from_slice(&(field.value(point.raw) as f32).to_le_bytes());
                    }
                    Kind::U8 if field.bits.is_some() => self.line.push(field.value(point.raw) as u8),
                    kind if kind.ply_name() == "double" => {
                        let value = field.value(point.raw);
                        if matches!(kind, Kind::U64 | Kind::I64) && value.abs() > WHOLE_UP_TO {
                            let what =
                                format!("`{}` of {value} in PLY, which has no whole numbers of 64 bits", field.name);
                            return Err(Error::unsupported(&self.path, what, "name the output .laz"));
                        }
                        self.line.extend_from_slice(&value.to_le_bytes());
                    }
                    kind => self.line.extend_from_slice(&point.raw[field.offset..field.offset + kind.size()]),
                }
            }
            let came = || self.class.as_ref().map_or(0, |field| field.value(point.raw) as u8);
            let class = point.class.unwrap_or_else(came);
            self.line.push(class);
            if self.with_range {
                self.line.extend_from_slice(&point.range.unwrap_or(f64::NAN).to_le_bytes());
            }
            self.file.write_all(&self.line).map_err(|e| Error::io(&self.path, "write", e))?;
            self.written += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<u64> {
        self.file.flush().map_err(|e| Error::io(&self.path, "write", e))?;
        self.file.get_ref().sync_all().map_err(|e| Error::io(&self.path, "write", e))?;
        Ok(self.written)
    }
}
