//! Where marks are, for the commands that look at marks somebody points at: by pixels, by the result of an earlier run,
//! or by a list of points through the georeference that the image already has.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use autoref_raster::bounded;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::window::Window;
use autoref_raster::{Patch, RasterInfo, RasterSource};
use autoref_stream::gcp::{self, GcpOptions, Reproject};

use crate::cli::working_crs;

/// How marks are pointed at.
#[derive(Debug, clap::Args)]
pub struct PositionArgs {
    /// Position of the middle of a mark, pixels from the upper left corner; repeat for more marks.
    #[arg(long = "at", value_name = "X,Y", value_parser = parse_point, allow_hyphen_values = true)]
    at: Vec<PixelPoint>,
    /// Take the marks from the matches of an earlier run's .autoref.json.
    #[arg(long, value_name = "JSON")]
    result: Option<PathBuf>,
    /// Take the marks at the points of this list, through the georeference that the image already has.
    #[arg(long, value_name = "FILE")]
    gcps: Option<PathBuf>,
    /// With --gcps: CRS of the list. Default: what the list says, else the image's.
    #[arg(long, value_name = "CRS", requires = "gcps")]
    crs: Option<String>,
    /// With --gcps: use only these points: names, patterns (G*), attributes (COLUMN=VALUE).
    #[arg(long, value_name = "A,B,…", value_delimiter = ',', requires = "gcps")]
    names: Vec<String>,
    /// With --gcps: layer of a file with several.
    #[arg(long, value_name = "NAME", requires = "gcps")]
    gcp_layer: Option<String>,
}

/// A mark and who says that it is there.
#[derive(Clone, Debug)]
pub struct Mark {
    pub name: String,
    pub at: PixelPoint,
    /// By a list or an earlier run: it may be covered, never painted, or something else. Else somebody saw it.
    pub listed: bool,
}

/// The marks in the image, and the names of listed points outside it.
#[derive(Debug)]
pub struct Positions {
    pub marks: Vec<Mark>,
    pub outside: Vec<String>,
}

impl PositionArgs {
    /// # Errors
    /// When nothing is pointed at, a file cannot be read, the image has no georeference for --gcps, or no point of the
    /// list lies in the image.
    pub fn positions(&self, info: &RasterInfo) -> Result<Positions> {
        let seen = |(i, at): (usize, &PixelPoint)| Mark { name: format!("{:03}", i + 1), at: *at, listed: false };
        let mut marks: Vec<Mark> = self.at.iter().enumerate().map(seen).collect();
        if let Some(path) = &self.result {
            let matches = matches_of(path)?;
            marks.extend(matches.into_iter().map(|(name, at)| Mark { name, at, listed: true }));
        }
        let mut outside = Vec::new();
        if let Some(path) = &self.gcps {
            for (name, at) in self.listed(path, info)? {
                let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < info.width as f64 && at.y < info.height as f64;
                if inside {
                    marks.push(Mark { name, at, listed: true });
                } else {
                    outside.push(name);
                }
            }
            if marks.is_empty() {
                bail!(
                    "{}: none of its {} points lies in {} by that image's own georeference; check --crs",
                    path.display(),
                    outside.len(),
                    info.path.display()
                );
            }
        }
        if marks.is_empty() {
            bail!("no marks are pointed at; give --at X,Y, --gcps FILE or --result JSON");
        }
        Ok(Positions { marks, outside })
    }

    /// Names and pixels of the points of a list, those outside the image included.
    fn listed(&self, path: &Path, info: &RasterInfo) -> Result<Vec<(String, PixelPoint)>> {
        let image = info.path.display();
        let transform = info.geotransform.with_context(|| {
            format!("{image}: it has no georeference to place the points by; solve it first, or give --at or --result")
        })?;
        let crs = info.crs_wkt.as_deref().filter(|wkt| !wkt.is_empty()).map(Crs::parse).transpose()?;
        let options = GcpOptions {
            crs: self.crs.clone(),
            // A list without a CRS beside an image without one: both are local.
            to_crs: crs.as_ref().filter(|crs| !crs.is_local()).map(|crs| crs.wkt().to_owned()),
            // Exact also where the image counts in degrees or feet: the points, not a fit, are brought over.
            reproject: Reproject::After,
            names: self.names.clone(),
            layer: self.gcp_layer.clone(),
            image: working_crs::of_image(info),
            ..GcpOptions::default()
        };
        let list = gcp::read(path, &options)?;
        let mut points: Vec<Coordinate> =
            list.gcps.iter().map(|g| Coordinate { x: g.easting, y: g.northing, height: g.height }).collect();
        list.working_crs.leave(&mut points)?;
        let pixel = |p: &Coordinate| {
            transform
                .invert(MapPoint { easting: p.x, northing: p.y })
                .with_context(|| format!("{image}: its georeference is singular"))
        };
        list.gcps.iter().zip(&points).map(|(gcp, point)| Ok((gcp.name.clone(), pixel(point)?))).collect()
    }
}

/// "x,y" in pixels.
pub fn parse_point(text: &str) -> Result<PixelPoint, String> {
    let wrong = || format!("\"{text}\" is not X,Y in pixels");
    let (x, y) = text.split_once(',').ok_or_else(wrong)?;
    let number = |s: &str| s.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    let at = PixelPoint { x: number(x).ok_or_else(wrong)?, y: number(y).ok_or_else(wrong)? };
    if at.x < 0.0 || at.y < 0.0 {
        return Err(format!("\"{text}\" lies outside the image: pixels are counted from its upper left corner"));
    }
    Ok(at)
}

/// Names and positions of the matches in a result file.
fn matches_of(path: &Path) -> Result<Vec<(String, PixelPoint)>> {
    let text = bounded::read_to_string(path, "a list of positions", bounded::TEXT_BYTES)?;
    let json: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("{}: not a result file", path.display()))?;
    let matches = json["matches"].as_array().map(Vec::as_slice).unwrap_or_default();
    let found: Vec<_> = matches
        .iter()
        .filter_map(|m| {
            let name = m["gcp"].as_str().map_or_else(|| m["gcp"].to_string(), str::to_owned);
            Some((name, PixelPoint { x: m["x"].as_f64()?, y: m["y"].as_f64()? }))
        })
        .collect();
    if found.is_empty() {
        bail!("{}: holds no matches; give positions with --at", path.display());
    }
    Ok(found)
}

/// The pixels around a position, clipped to the image.
///
/// # Errors
/// When the position is outside the image or the image cannot be read there.
pub fn patch_around(source: &dyn RasterSource, at: PixelPoint, reach_px: u64) -> Result<Patch> {
    let info = source.info();
    if at.x >= info.width as f64 || at.y >= info.height as f64 {
        bail!(
            "{}: {},{} lies outside the image, which is {} × {} pixels",
            info.path.display(),
            at.x,
            at.y,
            info.width,
            info.height
        );
    }
    let window = Window::new(at.x as u64, at.y as u64, 1, 1).grown(reach_px, &info.bounds());
    Ok(source.read(window)?.to_patch(info))
}
