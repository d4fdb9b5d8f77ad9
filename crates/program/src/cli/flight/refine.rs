//! Image points of ties, laid upon each other in the frames themselves.

use std::path::Path;

use anyhow::Result;
use autoref_flight::read::Reconstruction;
use autoref_flight::refine::{self, Picture};

use super::relative::Oriented;
use super::views::Shelf;
use crate::cli::progress::Steps;

/// The block with its ties laid upon each other, where their rays meet better then; `laid` says how many image points
/// were.
///
/// # Errors
/// When a frame cannot be read.
pub fn refined(oriented: Oriented, frames: &Path) -> Result<Oriented> {
    let moved = laid(&oriented.model, frames)?;
    Ok(match refine::taken(&oriented.model, &moved) {
        Some(model) => Oriented { model, laid: refine::taken_points(&oriented.model, &moved), ..oriented },
        None => oriented,
    })
}

fn laid(model: &Reconstruction, frames: &Path) -> Result<Vec<refine::Moved>> {
    let pairs = refine::pairs(model);
    let steps = Steps::new("laying ties upon each other", pairs.len() as u64);
    let mut shelf = Shelf::default();
    let mut moved = Vec::new();
    for (done, pair) in pairs.iter().enumerate() {
        steps.at(done as u64, pairs.len() as u64);
        shelf.forget_before(pair.frames[0]);
        for frame in pair.frames {
            shelf.get(frames, &model.photographs[frame].name, frame)?;
        }
        let pictures = pair.frames.map(|frame| {
            let grey = shelf.have(frame);
            Picture { size: [grey.layout.width, grey.layout.height], grey: grey.pixels(), scale: grey.layout.scale }
        });
        moved.extend(refine::laid(model, pair, pictures));
    }
    Ok(moved)
}
