//! Lists as GDAL's OGR writes them: GeoPackage, Shapefile, FlatGeobuf, GML, KML, GPX.

use std::path::Path;

use gdal::DriverManager;
use gdal::spatial_ref::{AxisMappingStrategy, SpatialRef};
use gdal::vector::{Feature, FieldDefn, Geometry, LayerAccess, LayerOptions, OGRFieldType, OGRwkbGeometryType};

use super::{ListFormat, Survey};
use crate::gcp::{Gcp, GcpRole, working_crs};
use autoref_raster::atomic::Transaction;
use autoref_raster::crs::{Accuracy, Coordinate, Crs};
use autoref_raster::error::{Error, Result};
use autoref_raster::is_cut_table;

const WGS84: u32 = 4326;

/// Writes the list beside the output, in as many files as the format has, and stages them; says what was lost on the
/// way.
pub(super) fn write(
    survey: &Survey,
    format: ListFormat,
    worst_accuracy_m: f64,
    output: &Path,
    transaction: &mut Transaction,
) -> Result<Vec<String>> {
    autoref_raster::initialise_gdal(0);
    let folder = tempfile::tempdir().map_err(|e| Error::io(output, "make a folder for", e))?;
    let name = output.file_name().ok_or_else(|| Error::usage("the output has no name", "name a file"))?;
    let watch = autoref_raster::Written::watch(output);
    let lost = layer(survey, format, worst_accuracy_m, &folder.path().join(name)).map_err(|e| match e {
        Error::Gdal { what, .. } => Error::gdal(output, what),
        other => other,
    })?;
    watch.nothing_failed()?;
    let entries = std::fs::read_dir(folder.path()).map_err(|e| Error::io(output, "read what was written for", e))?;
    let mut made: Vec<_> = entries.flatten().map(|entry| entry.path()).collect();
    made.sort();
    for file in made {
        let bytes = std::fs::read(&file).map_err(|e| Error::io(&file, "read", e))?;
        if file.extension().is_some_and(|end| end == "dbf") && is_cut_table(&file) {
            return Err(Error::gdal(output, "the table beside it could not be written whole; is the disk full?"));
        }
        let target = output.with_file_name(file.file_name().expect("a file of a folder"));
        transaction.stage_bytes(&target, &bytes)?;
    }
    Ok(lost)
}

fn layer(survey: &Survey, format: ListFormat, worst_accuracy_m: f64, path: &Path) -> Result<Vec<String>> {
    let failed = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let driver = match format {
        ListFormat::GeoPackage => "GPKG",
        ListFormat::Shapefile => "ESRI Shapefile",
        ListFormat::FlatGeobuf => "FlatGeobuf",
        ListFormat::Gml => "GML",
        ListFormat::Kml => "KML",
        _ => "GPX",
    };
    let geographic = matches!(format, ListFormat::Kml | ListFormat::Gpx);
    let (places, crs, lost) = places(survey, geographic, worst_accuracy_m)?;
    let reference = match &crs {
        Some(crs) => {
            let mut reference = SpatialRef::from_wkt(crs.wkt()).map_err(failed)?;
            reference.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
            Some(reference)
        }
        None => None,
    };
    // A layer is flat or in space; where only some points have heights a column says them.
    let in_space = survey.gcps().all(|g| g.height.is_some());
    let kind = if in_space { OGRwkbGeometryType::wkbPoint25D } else { OGRwkbGeometryType::wkbPoint };
    let columns = columns(survey, format, in_space);
    let driver = DriverManager::get_driver_by_name(driver).map_err(failed)?;
    let mut dataset = driver.create_vector_only(path).map_err(failed)?;
    let name = if format == ListFormat::Gpx { "waypoints" } else { "gcps" };
    // UTF-8 names in the table of a Shapefile.
    let options: Option<&[&str]> = match format {
        ListFormat::Shapefile => Some(&["ENCODING=UTF-8"]),
        // Its index would put the points in another order.
        ListFormat::FlatGeobuf => Some(&["SPATIAL_INDEX=NO"]),
        _ => None,
    };
    let layer =
        dataset.create_layer(LayerOptions { name, srs: reference.as_ref(), ty: kind, options }).map_err(failed)?;
    if format != ListFormat::Gpx {
        for (title, kind) in &columns {
            let column = FieldDefn::new(title, *kind).map_err(failed)?;
            if *kind == OGRFieldType::OFTReal && format == ListFormat::Shapefile {
                column.set_width(24);
                column.set_precision(12);
            }
            column.add_to_layer(&layer).map_err(failed)?;
        }
    }
    for (gcp, at) in survey.gcps().zip(&places) {
        let mut feature = Feature::new(layer.defn()).map_err(failed)?;
        for (title, _) in &columns {
            let index = layer.defn().field_index(title).map_err(failed)?;
            match attribute(gcp, title) {
                Attribute::Text(text) => feature.set_field_string(index, text).map_err(failed)?,
                Attribute::Number(Some(number)) => feature.set_field_double(index, number).map_err(failed)?,
                Attribute::Number(None) => {}
            }
        }
        let mut geometry = Geometry::empty(kind).map_err(failed)?;
        match at.height.filter(|_| in_space) {
            Some(height) => geometry.add_point((at.x, at.y, height)),
            None => geometry.add_point_2d((at.x, at.y)),
        }
        feature.set_geometry(geometry).map_err(failed)?;
        feature.create(&layer).map_err(failed)?;
    }
    dataset.close().map_err(failed)?;
    Ok(lost)
}

/// Titles and kinds of the columns.
fn columns(survey: &Survey, format: ListFormat, in_space: bool) -> Vec<(&'static str, OGRFieldType::Type)> {
    let mut columns = vec![("name", OGRFieldType::OFTString)];
    if format != ListFormat::Gpx {
        columns.push(("role", OGRFieldType::OFTString));
        columns.extend((!in_space && survey.any(|g| g.height.is_some())).then_some(("height", OGRFieldType::OFTReal)));
        columns.extend(survey.any(|g| g.sigma_m.is_some()).then_some(("sigma_m", OGRFieldType::OFTReal)));
        // Ten letters are what a Shapefile has.
        columns.extend(survey.any(|g| g.sigma_height_m.is_some()).then_some(("sigma_h", OGRFieldType::OFTReal)));
    }
    columns
}

enum Attribute<'a> {
    Text(&'a str),
    Number(Option<f64>),
}

/// What a point has in a column.
fn attribute<'a>(gcp: &'a Gcp, title: &str) -> Attribute<'a> {
    match title {
        "name" => Attribute::Text(&gcp.name),
        "role" => Attribute::Text(if gcp.role == GcpRole::Check { "check" } else { "control" }),
        "height" => Attribute::Number(gcp.height),
        "sigma_m" => Attribute::Number(gcp.sigma_m),
        _ => Attribute::Number(gcp.sigma_height_m),
    }
}

/// The coordinates, in degrees of WGS 84 and heights in metres where the format knows nothing else.
fn places(
    survey: &Survey,
    geographic: bool,
    worst_accuracy_m: f64,
) -> Result<(Vec<Coordinate>, Option<Crs>, Vec<String>)> {
    let mut places: Vec<Coordinate> =
        survey.gcps().map(|g| Coordinate { x: g.easting, y: g.northing, height: g.height }).collect();
    let mut lost = Vec::new();
    let Some(crs) = survey.crs.as_ref().filter(|crs| geographic && crs.epsg() != Some(WGS84)) else {
        return Ok((places, survey.crs.clone(), lost));
    };
    let degrees = Crs::from_epsg(WGS84)?;
    // Heights without a vertical system are in the unit of the plan.
    let height_unit = crs.height_metres_per_unit().unwrap_or(crs.metres_per_unit());
    if height_unit != 1.0 && survey.any(|g| g.height.is_some()) {
        places.iter_mut().for_each(|place| place.height = place.height.map(|height| height * height_unit));
        lost.push(format!("heights in {}: they were brought into metres", crs.unit_name()));
    }
    let how = match working_crs::transform(crs, &mut places, &degrees, worst_accuracy_m)? {
        Accuracy::Exact => String::new(),
        Accuracy::Metres(metres) => format!(", good to {metres} m"),
        Accuracy::Unstated => ", how well is not stated".into(),
    };
    lost.push(format!("crs {}: the coordinates were brought into longitude and latitude of WGS 84{how}", crs.title()));
    Ok((places, Some(degrees), lost))
}
