//! The warp as GDAL's warper takes it: a virtual raster in XML, as in
//! <https://gdal.org/drivers/raster/vrt.html#warped-vrt>.
//!
//! The transform is written into the transformer itself, so the image needs no georeference of its own and what it may
//! have is not looked at.

use std::fmt::Write;
use std::path::Path;

use gdal::Dataset;
use gdal::raster::{ColorInterpretation, GdalDataType};
use quick_xml::escape::escape;

use super::border::Border;
use super::grid::Grid;
use autoref_raster::coords::GeoTransform;
use autoref_raster::crs::{Crs, axis_mapping};
use autoref_raster::error::{Error, Result};

/// Side of the blocks in which the warper works.
const BLOCK_PX: u64 = 512;

/// What the warper must know of the image.
#[derive(Clone, Debug)]
pub struct Source {
    /// What GDAL opens.
    pub name: String,
    pub width: u64,
    pub height: u64,
    pub bands: Vec<Band>,
    /// Number, from 1, of the band that is alpha.
    pub alpha: Option<usize>,
}

/// What a virtual raster says of a band.
#[derive(Clone, Debug)]
pub struct Band {
    pub kind: GdalDataType,
    pub colour: String,
    pub nodata: Option<f64>,
}

impl Source {
    /// Looks at an open dataset.
    ///
    /// # Errors
    /// When a band cannot be opened, or is a palette, whose indices cannot be averaged.
    pub fn of(path: &Path, name: &Path, dataset: &Dataset) -> Result<Self> {
        let (width, height) = dataset.raster_size();
        let mut bands = Vec::new();
        let mut alpha = None;
        for number in 1..=dataset.raster_count() {
            let band = dataset.rasterband(number).map_err(|e| Error::gdal(path, e))?;
            let colour = band.color_interpretation();
            if matches!(colour, ColorInterpretation::PaletteIndex) {
                let quoted = path.display();
                return Err(Error::unsupported(
                    path,
                    "warping a palette image",
                    format!("make colours of it: gdal_translate -expand rgb {quoted} rgb.tif"),
                ));
            }
            if matches!(colour, ColorInterpretation::AlphaBand) && alpha.is_none() && number > 1 {
                alpha = Some(number);
            }
            let (kind, colour) = (band.band_type(), colour.name());
            bands.push(Band { kind, colour, nodata: band.no_data_value() });
        }
        if bands.is_empty() {
            return Err(Error::unsupported(path, "a file without a raster", "give an image"));
        }
        let name = name.display().to_string();
        Ok(Source { name, width: width as u64, height: height as u64, bands, alpha })
    }

    /// Bands that hold what was seen: all but alpha.
    pub fn colours(&self) -> impl Iterator<Item = (usize, &Band)> {
        (1..).zip(&self.bands).filter(|(number, _)| Some(*number) != self.alpha)
    }
}

/// The XML. `grid` is where the result lies; `memory_bytes` bounds what one step of the warper takes.
///
/// # Errors
/// [`Error::Usage`] when the transform has no inverse.
pub fn xml(
    source: &Source,
    transform: &GeoTransform,
    grid: &Grid,
    crs: Option<&Crs>,
    border: Border,
    algorithm: &str,
    memory_bytes: u64,
) -> Result<String> {
    let inverse = inverse(transform).ok_or_else(|| {
        Error::usage("the transform has no inverse", "solve again: it would draw all pixels in a line")
    })?;
    let mut out = String::new();
    let mut line = |text: String| writeln!(out, "{text}").expect("a string takes all writes");
    line(format!(
        "<VRTDataset rasterXSize=\"{}\" rasterYSize=\"{}\" subClass=\"VRTWarpedDataset\">",
        grid.width, grid.height
    ));
    if let Some(crs) = crs {
        line(format!("  <SRS dataAxisToSRSAxisMapping=\"{}\">{}</SRS>", axis_mapping(crs), escape(crs.wkt())));
    }
    line(format!("  <GeoTransform>{}</GeoTransform>", numbers(&grid.transform.0)));
    let colours: Vec<(usize, &Band)> = source.colours().collect();
    for (number, (_, band)) in (1..).zip(&colours) {
        let nodata = match border {
            Border::Nodata(value) => format!("<NoDataValue>{}</NoDataValue>", real(value)),
            Border::Alpha | Border::Auto => String::new(),
        };
        line(band_xml(number, band.kind, &band.colour, &nodata));
    }
    let alpha = colours.len() + 1;
    if border == Border::Alpha {
        line(band_xml(alpha, colours[0].1.kind, "Alpha", ""));
    }
    line(format!("  <BlockXSize>{0}</BlockXSize>\n  <BlockYSize>{0}</BlockYSize>", BLOCK_PX));
    line(format!("  <GDALWarpOptions>\n    <WarpMemoryLimit>{memory_bytes}</WarpMemoryLimit>"));
    line(format!("    <ResampleAlg>{algorithm}</ResampleAlg>"));
    let init = if border == Border::Alpha { "0" } else { "NO_DATA" };
    line(format!("    <Option name=\"INIT_DEST\">{init}</Option>"));
    line("    <Option name=\"UNIFIED_SRC_NODATA\">YES</Option>".into());
    let (x, y) = scale_factors(transform, grid);
    line(format!("    <Option name=\"XSCALE\">{x}</Option>\n    <Option name=\"YSCALE\">{y}</Option>"));
    line(format!("    <SourceDataset relativeToVRT=\"0\">{}</SourceDataset>", escape(&source.name)));
    line("    <Transformer><GenImgProjTransformer>".into());
    line(format!("      <SrcGeoTransform>{}</SrcGeoTransform>", numbers(&transform.0)));
    line(format!("      <SrcInvGeoTransform>{}</SrcInvGeoTransform>", numbers(&inverse.0)));
    line(format!("      <DstGeoTransform>{}</DstGeoTransform>", numbers(&grid.transform.0)));
    let back = self::inverse(&grid.transform).expect("the grid is north-up with positive pixels");
    line(format!("      <DstInvGeoTransform>{}</DstInvGeoTransform>", numbers(&back.0)));
    line("    </GenImgProjTransformer></Transformer>\n    <BandList>".into());
    for (to, (from, band)) in (1..).zip(&colours) {
        let mut nodata = String::new();
        if let Some(value) = band.nodata {
            write!(nodata, "<SrcNoDataReal>{}</SrcNoDataReal>", real(value)).expect("a string takes all writes");
        }
        if let Border::Nodata(value) = border {
            write!(nodata, "<DstNoDataReal>{}</DstNoDataReal>", real(value)).expect("a string takes all writes");
        }
        line(format!("      <BandMapping src=\"{from}\" dst=\"{to}\">{nodata}</BandMapping>"));
    }
    line("    </BandList>".into());
    if let Some(number) = source.alpha {
        line(format!("    <SrcAlphaBand>{number}</SrcAlphaBand>"));
    }
    if border == Border::Alpha {
        line(format!("    <DstAlphaBand>{alpha}</DstAlphaBand>"));
    }
    line("  </GDALWarpOptions>\n</VRTDataset>".into());
    Ok(out)
}

/// Pixels of the copy for each of the image, across and down. Left alone, GDAL takes the ratio of a block to the box
/// around its rotated counterpart: a kernel that is too wide, by another factor in every block.
fn scale_factors(transform: &GeoTransform, grid: &Grid) -> (f64, f64) {
    let (g, to) = (transform.0, grid.transform.0);
    let (across, down) = match g[2] == 0.0 && g[4] == 0.0 {
        true => (g[1].abs(), g[5].abs()),
        false => (transform.scale(), transform.scale()),
    };
    // Never above 1: a kernel narrower than a pixel of the image would miss pixels.
    ((across / to[1]).min(1.0), (down / -to[5]).min(1.0))
}

fn band_xml(number: usize, kind: GdalDataType, colour: &str, more: &str) -> String {
    let kind = kind.name();
    format!(
        "  <VRTRasterBand dataType=\"{kind}\" band=\"{number}\" subClass=\"VRTWarpedRasterBand\">\
         <ColorInterp>{colour}</ColorInterp>{more}</VRTRasterBand>"
    )
}

fn numbers(values: &[f64; 6]) -> String {
    values.map(|v| format!("{v:.17e}")).join(", ")
}

/// As GDAL reads it.
fn real(value: f64) -> String {
    if value.is_nan() { "nan".into() } else { value.to_string() }
}

/// Map → image as six numbers; `None` when there is none.
fn inverse(transform: &GeoTransform) -> Option<GeoTransform> {
    let g = transform.0;
    let det = g[1] * g[5] - g[2] * g[4];
    if !det.is_finite() || det == 0.0 {
        return None;
    }
    Some(GeoTransform([
        (g[2] * g[3] - g[0] * g[5]) / det,
        g[5] / det,
        -g[2] / det,
        (g[0] * g[4] - g[1] * g[3]) / det,
        -g[4] / det,
        g[1] / det,
    ]))
}
