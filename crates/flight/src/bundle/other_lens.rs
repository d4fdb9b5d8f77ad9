//! What a lens with more terms would change.

use nalgebra::{SVector, Vector3};

use super::layout::{Layout, MOST_INTERIOR};
use super::linear::Curvature;
use super::normal::{DETERMINED, Reduced, Step};
use super::problem::{Loss, Problem, Treatment};
use crate::camera::Parameter;

/// Terms of the lens that may be missing.
const BROWN: [Parameter; 5] = [Parameter::K1, Parameter::K2, Parameter::K3, Parameter::P1, Parameter::P2];

/// The principal point, where it is held, may lie so far from there, 1σ as a share of the image's width: lenses are
/// centred no better, and over level ground nothing but GCPs tells.
const DECENTRED: f64 = 0.005;

/// By how much χ² must fall for a lens to be not as its model. Seven terms take off 7 by chance, and 40 in one of 10⁶
/// blocks.
const BEYOND_CHANCE: f64 = 40.0;

/// Where all unknowns would go, in one step, if the lens had all of Brown's terms and a principal point of its own.
pub(super) struct OtherLens {
    layout: Layout,
    step: Step,
    /// What was held before.
    pub terms: Vec<Parameter>,
}

impl OtherLens {
    /// `None` where the lens has them already, where they are not determined, and where the ties would fit no better
    /// than by chance.
    pub fn of(problem: &Problem, loss: Loss) -> Option<OtherLens> {
        let mut other = problem.clone();
        let mut terms = Vec::new();
        for camera in &mut other.cameras {
            for p in BROWN {
                if camera.treatment[p as usize] == Treatment::Held {
                    camera.treatment[p as usize] = Treatment::Free;
                    terms.push(p);
                }
            }
            let sigma = DECENTRED * camera.camera.size_px[0].max(camera.camera.size_px[1]);
            for p in [Parameter::Cx, Parameter::Cy] {
                if camera.treatment[p as usize] == Treatment::Held && sigma > 0.0 {
                    let value = camera.camera.get(p);
                    camera.treatment[p as usize] = Treatment::Constrained { value, sigma };
                    terms.push(p);
                }
            }
            if camera.active().len() > MOST_INTERIOR {
                return None;
            }
        }
        let layout = Layout::new(&other);
        // Terms that only rounding determines would go anywhere.
        let step = Reduced::new(&other, &layout, loss, Curvature::Weights, 0.0).step(DETERMINED)?;
        terms.sort_unstable();
        terms.dedup();
        (2.0 * step.gain > BEYOND_CHANCE).then_some(OtherLens { layout, step, terms })
    }

    /// Of a frame's turn and centre.
    pub fn frame(&self, frame: usize) -> SVector<f64, 6> {
        self.step.reduced.fixed_rows::<6>(self.layout.frame_at[frame]).into_owned()
    }

    /// Of an interior parameter of a camera; 0 where it is held.
    pub fn interior(&self, camera: usize, parameter: Parameter) -> f64 {
        let at = self.layout.active[camera].iter().position(|p| *p == parameter);
        at.map_or(0.0, |at| self.step.reduced[self.layout.interior_at[camera] + at])
    }

    /// Of what all positions are off together; 0 where that is not adjusted.
    pub fn offset(&self) -> Vector3<f64> {
        let of = |at: usize| self.step.reduced.fixed_rows::<3>(at).into_owned();
        self.layout.offset_at.map_or_else(Vector3::zeros, of)
    }

    /// Of a point, in the world's units.
    pub fn point(&self, point: usize) -> Vector3<f64> {
        self.step.points[point]
    }
}
