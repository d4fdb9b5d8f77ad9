//! What to draw and how to store it.

use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::gcps::SynthGcp;
use super::paint::Paint;
use super::shape::Shape;
use autoref_raster::coords::MapPoint;

/// Side or diameter of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MarkSize {
    Px(f64),
    Metres(f64),
}

impl MarkSize {
    /// In pixels of `gsd_m` metres on the ground.
    pub fn px(self, gsd_m: f64) -> f64 {
        match self {
            MarkSize::Px(px) => px,
            MarkSize::Metres(m) => m / gsd_m,
        }
    }
}

impl FromStr for MarkSize {
    type Err = String;

    /// `20`, `20px` or `0.6m`.
    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let (number, metres) = match (text.strip_suffix("px"), text.strip_suffix('m')) {
            (Some(px), _) => (px, false),
            (None, Some(m)) => (m, true),
            (None, None) => (text, false),
        };
        let value: f64 = number.trim().parse().map_err(|_| format!("{text:?} is no size; write 20, 20px or 0.6m"))?;
        if !(value.is_finite() && value > 0.0) {
            return Err(format!("{text:?} is no size; it must be above 0"));
        }
        Ok(if metres { MarkSize::Metres(value) } else { MarkSize::Px(value) })
    }
}

/// How marks are turned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MarkTurn {
    /// Each by its own angle.
    Random,
    /// All by this many degrees, from the image's x axis towards its y axis.
    Degrees(f64),
}

/// What a mark looks like.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkStyle {
    pub size: MarkSize,
    pub shape: Shape,
    /// Each mark takes one of them. Never empty.
    pub paints: Vec<Paint>,
    /// Of the checker's quadrants, the plate's cross and the hourglass's triangles.
    pub second_paint: Paint,
    /// σ of the Gaussian that stands for the camera's optics and the resampling of the mosaic.
    pub blur_px: f64,
    /// Share of the ground that shines through the paint: 0 fresh, 1 gone.
    pub fading: f64,
    /// Unevenness of the paint: relative half-range of its brightness from pixel to pixel.
    pub texture: f64,
    /// Share of the marks on which a shadow falls; on every other of them its edge.
    pub shadow_share: f64,
    /// Each mark is hidden from one side up to this share of its area (uniformly from 0).
    pub cover_max: f64,
    pub turn: MarkTurn,
}

impl Default for MarkStyle {
    fn default() -> Self {
        MarkStyle {
            size: MarkSize::Px(14.0),
            shape: Shape::Square,
            paints: vec![Paint::ORANGE],
            second_paint: Paint::BLACK,
            blur_px: 0.9,
            fading: 0.1,
            texture: 0.05,
            shadow_share: 0.0,
            cover_max: 0.0,
            turn: MarkTurn::Random,
        }
    }
}

/// A mark at a given place in the image, whatever the GCPs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlacedMark {
    pub name: String,
    /// Centre in pixels.
    pub x: f64,
    pub y: f64,
    /// `None`: the spec's.
    pub style: Option<MarkStyle>,
}

/// Which GCPs have a mark in the image.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Visible {
    /// Every one that falls inside.
    #[default]
    All,
    /// That many, drawn at random; the others have no mark even where they fall inside.
    Random(usize),
    Named(Vec<String>),
}

/// What lies under the marks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// Drawn from nothing: parcels, roads, roofs, cars, trees, water.
    #[default]
    Landscape,
    /// One colour.
    Flat([u8; 3]),
    /// Photographs at their own pixel size, laid out to fill any image.
    Photographs(Vec<PathBuf>),
    /// One photograph, pixel for pixel; the image has its size.
    AsIs(PathBuf),
}

/// What an orthophoto has around its edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Border {
    #[default]
    None,
    /// A ragged border up to `width_px` wide in which all bands have `value`.
    Nodata { width_px: u64, value: u8 },
    /// The same, told by a fourth band.
    Alpha { width_px: u64 },
}

impl Border {
    pub(crate) fn width_px(self) -> u64 {
        match self {
            Border::None => 0,
            Border::Nodata { width_px, .. } | Border::Alpha { width_px } => width_px,
        }
    }
}

/// Blocks of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FileLayout {
    /// Side in pixels, a multiple of 16, up to 4096 (a tile is held in memory until it is whole).
    Tiles(u64),
    /// Rows.
    Strips(u64),
}

/// How file blocks are compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compression {
    #[default]
    None,
    Deflate,
    Lzw,
    Zstd,
    Packbits,
    /// Quality 1–100; YCbCr for three bands.
    Jpeg(u8),
}

/// How the bands of a pixel are stored: together, or a plane each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interleave {
    #[default]
    Pixel,
    Band,
}

/// Whether offsets have 64 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BigTiff {
    /// When the decoded pixels would not fit in 4 GB.
    #[default]
    Auto,
    Always,
}

/// How to store the picture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    pub layout: FileLayout,
    pub compression: Compression,
    /// Horizontal differencing, for Deflate, LZW and ZSTD.
    pub predictor: bool,
    /// 8 or 16 bits a sample; 16 is scaled so that 65535 is white.
    pub bits: u8,
    pub interleave: Interleave,
    pub big_tiff: BigTiff,
    /// Write the true geotransform into the file. Off: the picture comes as from the camera.
    pub georeferenced: bool,
    /// EPSG code of the map that the geotransform leads to; `None` for a local one.
    #[serde(default)]
    pub epsg: Option<u32>,
    /// Replace an existing picture and truth.
    pub overwrite: bool,
}

impl Default for Output {
    fn default() -> Self {
        Output {
            layout: FileLayout::Tiles(512),
            compression: Compression::None,
            predictor: false,
            bits: 8,
            interleave: Interleave::Pixel,
            big_tiff: BigTiff::Auto,
            georeferenced: false,
            epsg: None,
            overwrite: false,
        }
    }
}

/// Everything that decides the picture. The same spec gives the same pixels on every machine with the same libraries
/// and for every number of threads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SynthSpec {
    pub gcps: Vec<SynthGcp>,
    /// Marks besides those of the GCPs.
    pub placed: Vec<PlacedMark>,
    pub seed: u64,
    /// Width and height; `None`: what the visible GCPs need, with a margin.
    pub size_px: Option<(u64, u64)>,
    /// Ground size of a pixel.
    pub gsd_m: f64,
    /// Angle of the image's x axis, anticlockwise from east.
    pub rotation_deg: f64,
    /// Flip the image left to right, which no orthophoto is.
    pub mirrored: bool,
    /// Map position of pixel (0, 0); `None`: the visible GCPs are centred.
    pub origin: Option<MapPoint>,
    pub visible: Visible,
    pub mark: MarkStyle,
    /// σ of each coordinate of an error by which marks lie beside their surveyed points.
    pub displacement_px: f64,
    /// Shift the image so that marks straddle multiples of this many pixels, one of them a corner.
    pub straddle_px: Option<u64>,
    /// σ of the sensor's noise in 8-bit levels. On photographs, which bring their own, only the marks get it.
    pub noise_sigma: f64,
    /// Number of false objects in about the colours of the paints.
    pub clutter: usize,
    pub background: Background,
    pub border: Border,
    pub output: Output,
}

impl Default for SynthSpec {
    fn default() -> Self {
        SynthSpec {
            gcps: vec![],
            placed: vec![],
            seed: 1,
            size_px: None,
            gsd_m: 0.03,
            rotation_deg: 0.0,
            mirrored: false,
            origin: None,
            visible: Visible::All,
            mark: MarkStyle::default(),
            displacement_px: 0.0,
            straddle_px: None,
            noise_sigma: 1.5,
            clutter: 0,
            background: Background::Landscape,
            border: Border::None,
            output: Output::default(),
        }
    }
}
