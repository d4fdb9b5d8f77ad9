//! What is really in the picture.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::paint::Paint;
use super::shape::Shape;
use super::spec::SynthSpec;
use autoref_raster::coords::GeoTransform;
use autoref_raster::error::{Error, Result};

/// How a shadow falls on a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shadow {
    None,
    /// All of it is in shadow.
    Full,
    /// The shadow's edge crosses it.
    Edge,
}

/// A GCP (or a mark placed without one) and what became of it. Pixels as everywhere: `(0, 0)` is the outer corner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthGcp {
    pub name: String,
    pub easting: f64,
    pub northing: f64,
    pub height: Option<f64>,
    /// A mark of it is in the image.
    pub visible: bool,
    /// True centre of the painted mark, in pixels (of the whole mark, also where part of it is hidden); where it would
    /// be when it is not visible.
    pub x: f64,
    pub y: f64,
    /// Where the coordinates fall, in pixels; differs from (x, y) by the displacement asked for.
    pub gcp_x: f64,
    pub gcp_y: f64,
    pub size_px: f64,
    pub shape: Shape,
    /// From the image's x axis towards its y axis.
    pub turn_deg: f64,
    pub paint: Paint,
    pub fading: f64,
    /// Share of the mark's area that is hidden.
    pub covered: f64,
    pub shadow: Shadow,
}

/// A false object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthClutter {
    pub x: f64,
    pub y: f64,
    pub size_px: f64,
    pub shape: Shape,
    pub paint: Paint,
}

/// The truth about a picture, stored beside it as `NAME.truth.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Version of this layout.
    pub version: u32,
    pub width: u64,
    pub height: u64,
    /// Image → map, GDAL's order, pixel corners.
    pub geotransform: GeoTransform,
    pub gsd_m: f64,
    /// Angle of the image's x axis, anticlockwise from east.
    pub rotation_deg: f64,
    pub mirrored: bool,
    pub seed: u64,
    pub gcps: Vec<TruthGcp>,
    pub clutter: Vec<TruthClutter>,
    /// All that was asked for.
    pub options: SynthSpec,
}

impl Truth {
    pub(crate) const VERSION: u32 = 1;

    /// Those with a mark in the image.
    pub fn visible(&self) -> impl Iterator<Item = &TruthGcp> {
        self.gcps.iter().filter(|g| g.visible)
    }

    /// # Errors
    /// [`Error::Io`] when the file cannot be read, [`Error::Format`] when it is no truth file.
    pub fn read(path: &Path) -> Result<Truth> {
        let text = autoref_raster::bounded::read(path, "a truth file", autoref_raster::bounded::DOCUMENT_BYTES)?;
        serde_json::from_slice(&text)
            .map_err(|e| Error::format(path, format!("line {}, column {}", e.line(), e.column()), e.to_string()))
    }

    pub(crate) fn to_json(&self) -> Vec<u8> {
        let mut text = serde_json::to_vec_pretty(self).expect("plain numbers and strings always serialise");
        text.push(b'\n');
        text
    }

    /// Writes through a temporary name, so that the file is whole or absent.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        autoref_raster::atomic::write(path, &self.to_json())
    }
}
