//! What a person gives: samples, lessons, global masks and corrections.

use std::path::PathBuf;

use crate::shapes::{Lesson, Shape};

/// What a person gave.
#[derive(Clone, Debug, Default)]
pub struct Given {
    /// What is taught, and kept whatever the classifier says.
    pub samples: Vec<Shape>,
    pub lessons: Vec<Lesson>,
    /// Joined to every frame's mask: fiducials, text boxes, the film's border.
    pub global: Vec<Shape>,
    /// A global mask of the frames' size, 1 = use.
    pub global_mask: Option<PathBuf>,
    /// Corrections by hand; they have the last word.
    pub mended: Vec<Shape>,
}
