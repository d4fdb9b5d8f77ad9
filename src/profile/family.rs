//! Families of coded targets.

use serde::{Deserialize, Serialize};

/// Families (dictionaries) of codes that can be read; written as in `apriltag-36h11`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    #[serde(rename = "apriltag-16h5")]
    Apriltag16h5,
    #[serde(rename = "apriltag-36h11")]
    Apriltag36h11,
    /// OpenCV's DICT_4X4_50.
    #[serde(rename = "aruco-4x4-50")]
    Aruco4x4x50,
    /// OpenCV's DICT_4X4_100, whose first 50 are DICT_4X4_50.
    #[serde(rename = "aruco-4x4-100")]
    Aruco4x4x100,
    /// OpenCV's DICT_6X6_250.
    #[serde(rename = "aruco-6x6-250")]
    Aruco6x6x250,
    /// OpenCV's DICT_ARUCO_MIP_36h12.
    #[serde(rename = "aruco-mip-36h12")]
    ArucoMip36h12,
}

impl Family {
    /// As profiles and codes write it.
    pub fn name(self) -> &'static str {
        match self {
            Family::Apriltag16h5 => "apriltag-16h5",
            Family::Apriltag36h11 => "apriltag-36h11",
            Family::Aruco4x4x50 => "aruco-4x4-50",
            Family::Aruco4x4x100 => "aruco-4x4-100",
            Family::Aruco6x6x250 => "aruco-6x6-250",
            Family::ArucoMip36h12 => "aruco-mip-36h12",
        }
    }

    /// Modules along a side of the black square, its border of one module included.
    pub fn modules(self) -> usize {
        match self {
            Family::Apriltag16h5 | Family::Aruco4x4x50 | Family::Aruco4x4x100 => 6,
            Family::Apriltag36h11 | Family::Aruco6x6x250 | Family::ArucoMip36h12 => 8,
        }
    }
}
