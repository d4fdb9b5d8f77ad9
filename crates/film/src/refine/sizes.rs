//! Dots drawn larger and smaller than the camera's file has them.

use std::cell::OnceCell;

use super::surface::{SHARP_PX, Surface};
use crate::template::{Linear, Model};
use crate::types::MarkKind;

/// From one size to the next, pixels of diameter and share of the thinnest part: edges half of that off still fit.
const STEP_PX: f64 = 0.4;
const STEP: f64 = 0.05;
/// How much wider or narrower the thinnest part may be, of itself.
const MOST: f64 = 0.45;
/// As many steps as that are at most.
const STEPS: usize = (MOST / STEP) as usize;

/// A dot in steps of its size. Exposure moves all edges by the same, so that the ring around a dot gets wider with it.
pub(super) struct Sizes {
    kind: MarkKind,
    linear: Linear,
    radius_mm: f64,
    step_mm: f64,
    steps: usize,
    larger: [OnceCell<Option<Surface>>; STEPS],
    smaller: [OnceCell<Option<Surface>>; STEPS],
}

impl Sizes {
    /// `None` of what is no dot.
    pub fn of(model: &Model, linear: Linear, radius_mm: f64) -> Option<Sizes> {
        let Model::Drawn(kind @ MarkKind::Dot { .. }) = model else { return None };
        let px_per_mm = (linear[0] * linear[3] - linear[1] * linear[2]).abs().sqrt();
        let thinnest_mm = model.thinnest_mm();
        let step_mm = (STEP_PX / px_per_mm).max(STEP * thinnest_mm);
        let steps = ((MOST * thinnest_mm / step_mm) as usize).min(STEPS);
        let (larger, smaller) = Default::default();
        Some(Sizes { kind: kind.clone(), linear, radius_mm, step_mm, steps, larger, smaller })
    }

    /// From the next larger on.
    pub fn larger(&self) -> Box<dyn Iterator<Item = &Surface> + '_> {
        self.surfaces(&self.larger, self.step_mm)
    }

    /// From the next smaller on.
    pub fn smaller(&self) -> Box<dyn Iterator<Item = &Surface> + '_> {
        self.surfaces(&self.smaller, -self.step_mm)
    }

    fn surfaces<'a>(
        &'a self,
        cells: &'a [OnceCell<Option<Surface>>; STEPS],
        step_mm: f64,
    ) -> Box<dyn Iterator<Item = &'a Surface> + 'a> {
        let drawn = move |k: usize| {
            let model = Model::Drawn(wider(&self.kind, step_mm * (k + 1) as f64));
            Surface::new(&model, self.linear, self.radius_mm, SHARP_PX)
        };
        Box::new((0..self.steps).map_while(move |k| cells[k].get_or_init(|| drawn(k)).as_ref()))
    }
}

/// A dot, and the line of its ring, wider by `mm`.
fn wider(kind: &MarkKind, mm: f64) -> MarkKind {
    match kind {
        MarkKind::Dot { diameter_mm, ring_diameter_mm, ring_line_mm } => MarkKind::Dot {
            diameter_mm: diameter_mm + mm,
            ring_diameter_mm: *ring_diameter_mm,
            ring_line_mm: ring_line_mm.map(|line| line + mm),
        },
        other => other.clone(),
    }
}
