//! Whether sources go together by what they say of their values, and what the mosaic says.

use std::path::Path;

use autoref_raster::words::{counted, some_of};
use autoref_raster::{same_unit, set_unit};
use gdal::raster::{ColorEntry, ColorInterpretation, ColorTable, GdalDataType, PaletteInterpretation};
use gdal::{Dataset, Metadata};

use crate::error::{Error, Result};
use crate::model::how_to_name_crs;

use super::form::BandForm;
use super::source::{DatedBy, Source};

/// All sources need one form: bands and what they mean, sample type, scale, unit, palette and CRS.
pub fn check_alike(sources: &[Source]) -> Result<()> {
    let Some(first) = sources.first() else { return Err(Error::usage("no raster was named", "name at least one")) };
    for source in sources {
        if source.bands != first.bands || source.kind != first.kind {
            let what = format!(
                "{} of {}, while {} has {} of {}",
                counted(source.bands, "band", "bands"),
                source.kind.name(),
                first.path.display(),
                first.bands,
                first.kind.name()
            );
            return Err(Error::unsupported(&source.path, what, "bring them to one form with gdal_translate"));
        }
        check_bands(first, source)?;
        if source.palette != first.palette {
            let what = format!("another palette than {}", first.path.display());
            let remedy = "bring them to colours with gdal_translate -expand rgb";
            return Err(Error::unsupported(&source.path, what, remedy));
        }
        check_one_crs(first, source)?;
    }
    // Any two must agree, of which the first may say nothing.
    for band in 0..first.bands {
        let mut named = sources.iter().filter_map(|source| Some((source, source.forms[band].unit.as_deref()?)));
        let Some((one, unit)) = named.next() else { continue };
        if let Some((other, own)) = named.find(|(_, own)| !same_unit(own, unit)) {
            let what = format!("band {} in {own}, while {} has it in {unit}", band + 1, one.path.display());
            let remedy = "bring them to one unit with gdal_calc.py, and name it with gdal_edit.py -units";
            return Err(Error::unsupported(&other.path, what, remedy));
        }
    }
    Ok(())
}

/// Scale, offset and meaning, band by band.
fn check_bands(first: &Source, source: &Source) -> Result<()> {
    let whose = first.path.display();
    for (number, (a, b)) in (1..).zip(first.forms.iter().zip(&source.forms)) {
        if a.scale != b.scale {
            let what = format!(
                "scale {} and offset {} in band {number}, while {whose} has {} and {}",
                b.scale.0, b.scale.1, a.scale.0, a.scale.1
            );
            return Err(Error::unsupported(&source.path, what, "bring them to one form with gdal_translate -unscale"));
        }
        let colours = a.colour != b.colour && ((a.is_named() && b.is_named()) || a.is_alpha() || b.is_alpha());
        if colours {
            let what = format!("band {number} is {}, while {whose} has {}", b.colour.name(), a.colour.name());
            let remedy =
                "bring the bands into one order with gdal_translate -b 3 -b 2 -b 1 (or -colorinterp names them)";
            return Err(Error::unsupported(&source.path, what, remedy));
        }
    }
    // Names that stand in another order tell that bands do; of other names nothing is known.
    let names = |source: &Source| source.forms.iter().map(|form| form.name.clone()).collect::<Vec<_>>();
    let (mut a, mut b) = (names(first), names(source));
    if a != b {
        let what = format!("bands called {}, while those of {whose} are called {}", b.join(", "), a.join(", "));
        a.sort();
        b.sort();
        if a == b {
            let remedy = "bring the bands into one order with gdal_translate -b 2 -b 1";
            return Err(Error::unsupported(&source.path, what, remedy));
        }
    }
    Ok(())
}

/// What is joined though sources say different things of it, as words.
pub fn notes(sources: &[Source]) -> Vec<String> {
    let mut notes = Vec::new();
    for band in 0..sources[0].bands {
        let unit = unit(sources, band);
        let silent = sources.iter().find(|source| source.forms[band].unit.is_none());
        if let (Some(unit), Some(silent)) = (unit, silent) {
            notes.push(format!(
                "{} names no unit in band {}: it is taken to be {unit}, as of other sources; name it with gdal_edit.py \
                 -units",
                silent.path.display(),
                band + 1
            ));
        }
        let first = &sources[0].forms[band].name;
        if let Some(other) = sources.iter().find(|source| source.forms[band].name != *first) {
            notes.push(format!(
                "band {} is called `{first}` in {} and `{}` in {}: the mosaic's has no name",
                band + 1,
                sources[0].path.display(),
                other.forms[band].name,
                other.path.display()
            ));
        }
    }
    notes
}

/// What to say where some sources are dated by their metadata or names, and others by when their files were written.
pub fn note_of_dates(sources: &[Source]) -> Option<String> {
    let (by_file, others): (Vec<&Source>, Vec<&Source>) = sources.iter().partition(|s| s.dated_by == DatedBy::File);
    if by_file.is_empty() || others.is_empty() {
        return None;
    }
    let names: Vec<String> = by_file.iter().map(|source| source.path.display().to_string()).collect();
    Some(format!(
        "--choose newest: neither metadata nor name dates {}: when the file was written counts, while others go by what \
         they say",
        some_of(&names)
    ))
}

/// What the sources that say it call the unit of a band.
fn unit(sources: &[Source], band: usize) -> Option<&str> {
    sources.iter().find_map(|source| source.forms[band].unit.as_deref())
}

/// Refuses rasters of two reference systems. What cannot be parsed is like nothing but itself.
pub fn check_one_crs(first: &Source, source: &Source) -> Result<()> {
    let label = |source: &Source| crate::crs::Crs::parse(&source.wkt).ok().map(|crs| crs.label().to_string());
    let same = || label(first).zip(label(source)).is_some_and(|(a, b)| a == b);
    if source.wkt == first.wkt || same() {
        return Ok(());
    }
    let missing = |without: &Source, with: &Source| {
        let what = format!("no CRS, while {} has one", with.path.display());
        Error::unsupported(&without.path, what, how_to_name_crs(&without.path))
    };
    Err(match (first.wkt.is_empty(), source.wkt.is_empty()) {
        (false, true) => missing(source, first),
        (true, false) => missing(first, source),
        _ => {
            let what = format!("another CRS than that of {}", first.path.display());
            Error::unsupported(&source.path, what, "bring it there with gdalwarp -t_srs")
        }
    })
}

/// Whether all sources call a value "nothing", in every band.
fn is_common(sources: &[Source], value: f64) -> bool {
    let same = |n: f64| n == value || (n.is_nan() && value.is_nan());
    sources.iter().flat_map(|source| &source.forms).all(|form| form.nodata.is_some_and(same))
}

/// What the mosaic calls "nothing"; a file has one value for all its bands. Whole numbers keep that of the first
/// source. Floats take one that is the least likely to be data of a source that calls another so: none is a number
/// before all, then what lies farthest from zero.
pub fn nodata_of(sources: &[Source]) -> Option<f64> {
    let first = &sources[0];
    let declared = |source: &Source| source.forms.iter().find_map(|form| form.nodata);
    let own = declared(first);
    if !matches!(first.kind, GdalDataType::Float32 | GdalDataType::Float64) {
        return own;
    }
    if own.is_some_and(|value| is_common(sources, value)) {
        return own;
    }
    let all = sources.iter().flat_map(|source| &source.forms).filter_map(|form| form.nodata);
    let far = |value: &f64| if value.is_nan() { f64::INFINITY } else { value.abs() };
    all.max_by(|a, b| far(a).total_cmp(&far(b))).filter(|value| *value != 0.0).or(Some(USUAL))
}

/// What files of heights call "nothing" where no source says.
const USUAL: f64 = -9999.0;

/// Colours, names, units, scale and palette as the sources have them; and a mask where nothing else tells which cells
/// are there. Whether there is one.
///
/// # Errors
/// When it cannot be written.
pub fn describe(sources: &[Source], path: &Path, dataset: &mut Dataset, nodata: Option<f64>) -> Result<bool> {
    let first = &sources[0];
    let failed = |e: gdal::errors::GdalError| autoref_raster::failed_to_write(path, &e.to_string());
    if first.is_point {
        dataset.set_metadata_item("AREA_OR_POINT", "Point", "").map_err(failed)?;
    }
    for (number, form) in first.forms.iter().enumerate() {
        let mut band = dataset.rasterband(number + 1).map_err(failed)?;
        if let Some(colour) = ColorInterpretation::from_c_int(form.colour.c_int()) {
            band.set_color_interpretation(colour).map_err(failed)?;
        }
        if first.forms.iter().any(|form| form.scale != (1.0, 0.0)) {
            band.set_scale(form.scale.0).and_then(|()| band.set_offset(form.scale.1)).map_err(failed)?;
        }
        if let Some(unit) = unit(sources, number) {
            set_unit(path, &band, unit)?;
        }
        if !form.name.is_empty() && sources.iter().all(|source| source.forms[number].name == form.name) {
            band.set_description(&form.name).map_err(failed)?;
        }
    }
    if !first.palette.is_empty() {
        let mut table = ColorTable::new(PaletteInterpretation::Rgba);
        for (number, &[r, g, b, a]) in (0..).zip(&first.palette) {
            table.set_color_entry(number, &ColorEntry::rgba(r, g, b, a));
        }
        dataset.rasterband(1).map_err(failed)?.set_color_table(&table);
    }
    let masked = nodata.is_none() && !first.forms.iter().any(BandForm::is_alpha);
    if masked {
        dataset.rasterband(1).and_then(|mut band| band.create_mask_band(true)).map_err(failed)?;
    }
    Ok(masked)
}
