//! All that is adjusted, all that was measured, and what it costs that they do not fit.

use nalgebra::{Matrix3, Vector3};

use crate::camera::{Camera, PARAMETERS, Parameter};
use crate::pose::{Pose, turn};

/// What becomes of an interior parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Treatment {
    #[default]
    Held,
    /// Known as `value` with a standard deviation (units of the parameter: pixels for f, cx, cy).
    Constrained {
        value: f64,
        sigma: f64,
    },
    Free,
}

/// A camera of the adjustment.
#[derive(Clone, Debug)]
pub struct BundleCamera {
    pub camera: Camera,
    pub treatment: [Treatment; PARAMETERS],
}

impl BundleCamera {
    /// A camera of which nothing is adjusted.
    pub fn held(camera: Camera) -> Self {
        BundleCamera { camera, treatment: [Treatment::Held; PARAMETERS] }
    }
    /// The same with one parameter treated otherwise.
    pub fn treat(mut self, parameter: Parameter, treatment: Treatment) -> Self {
        self.treatment[parameter as usize] = treatment;
        self
    }
    /// The parameters that are adjusted.
    pub fn active(&self) -> Vec<Parameter> {
        Parameter::ALL.into_iter().filter(|p| self.treatment[*p as usize] != Treatment::Held).collect()
    }
}

/// A photograph of the adjustment.
#[derive(Clone, Debug)]
pub struct BundleFrame {
    pub camera: usize,
    pub pose: Pose,
    /// Known position with standard deviations (metres).
    pub position: Option<(Vector3<f64>, Vector3<f64>)>,
    /// Known direction (world → camera) with the standard deviation of a turn about any axis, radians.
    pub direction: Option<(Matrix3<f64>, f64)>,
}

/// How wide a frame is held that nothing else fixes: neither its residuals nor other unknowns feel it, metres.
pub(crate) const HELD_M: f64 = 9_999.0;

impl BundleFrame {
    /// Whether its position is a hold and nothing that is known.
    pub(crate) fn is_held(&self) -> bool {
        self.position.is_some_and(|(_, sigma)| sigma.x == HELD_M)
    }
}

/// A point: a tie, or a GCP with its survey.
#[derive(Clone, Debug)]
pub struct BundlePoint {
    pub xyz: Vector3<f64>,
    /// Surveyed place with standard deviations (metres).
    pub survey: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// Whether an observation may be wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// Weighted down when it fits badly.
    Robust,
    /// Taken as it is.
    Full,
}

/// A point seen in a photograph.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    pub frame: usize,
    pub point: usize,
    pub pixel: [f64; 2],
    pub sigma_px: f64,
    pub trust: Trust,
}

/// ρ of the robust observations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    Squared,
    /// Linear beyond this many σ.
    Huber(f64),
    /// c² ln(1 + s/c²): far ones count for next to nothing.
    Cauchy(f64),
}

impl Loss {
    /// ρ(s) and ρ′(s) at the squared length s of a residual in units of σ.
    pub fn at(self, s: f64) -> (f64, f64) {
        match self {
            Loss::Squared => (s, 1.0),
            Loss::Huber(k) if s <= k * k => (s, 1.0),
            Loss::Huber(k) => {
                let root = s.sqrt();
                (2.0 * k * root - k * k, k / root)
            }
            Loss::Cauchy(c) => (c * c * (s / (c * c)).ln_1p(), 1.0 / (1.0 + s / (c * c))),
        }
    }

    /// 1 + 2 s ρ″/ρ′: the share of ρ′ that is left of the curvature along the residual; below zero ρ is concave there.
    pub fn radial(self, s: f64) -> f64 {
        match self {
            Loss::Squared => 1.0,
            Loss::Huber(k) => f64::from(u8::from(s <= k * k)),
            Loss::Cauchy(c) => (1.0 - s / (c * c)) / (1.0 + s / (c * c)),
        }
    }
}

/// All that is adjusted and all that was measured.
#[derive(Clone, Debug, Default)]
pub struct Problem {
    pub cameras: Vec<BundleCamera>,
    pub frames: Vec<BundleFrame>,
    pub points: Vec<BundlePoint>,
    pub observations: Vec<Observation>,
    /// What all known positions are off together, metres, adjusted as well: they may count in another datum than the
    /// GCPs. `None`: they are taken as they stand.
    pub offset: Option<Vector3<f64>>,
}

/// What an observation that its camera does not see costs, in σ: it pulls nowhere, but leaving the image to the back
/// does not pay.
const BEHIND_SIGMAS: f64 = 1e3;

impl Problem {
    /// Residual of an observation (predicted − measured), pixels; `None` when the camera does not see the point.
    pub fn residual(&self, o: &Observation) -> Option<[f64; 2]> {
        let frame = &self.frames[o.frame];
        let p = frame.pose.to_camera(&self.points[o.point].xyz);
        self.cameras[frame.camera].camera.residual(p.into(), o.pixel)
    }

    /// Known position − centre of a frame, metres, without what all positions are off together.
    pub(crate) fn position_misses(&self, frame: usize) -> Option<Vector3<f64>> {
        let frame = &self.frames[frame];
        let offset = self.offset.filter(|_| !frame.is_held()).unwrap_or_default();
        frame.position.map(|(at, _)| at - offset - frame.pose.centre)
    }

    /// The same in standard deviations.
    pub(crate) fn position_off(&self, frame: usize) -> Option<Vector3<f64>> {
        let (_, sigma) = self.frames[frame].position?;
        Some(self.position_misses(frame)?.component_div(&sigma))
    }

    /// Share of what points leave of their measurements that the unknowns of frames and cameras leave as well: by so
    /// much less than errors do residuals vary, in the mean. At least a tenth.
    pub(crate) fn share_left(&self) -> f64 {
        let surveyed = self.points.iter().filter(|p| p.survey.is_some()).count();
        let positions = self.frames.iter().filter(|f| f.position.is_some()).count();
        let directions = self.frames.iter().filter(|f| f.direction.is_some()).count();
        let measured = 2 * self.observations.len() + 3 * (surveyed + positions + directions);
        let spare = measured.saturating_sub(3 * self.points.len()).max(1) as f64;
        let interior: usize = self.cameras.iter().map(|c| c.active().len()).sum();
        let offset = if self.offset.is_some() { 3 } else { 0 };
        ((spare - (6 * self.frames.len() + interior + offset) as f64) / spare).max(0.1)
    }

    /// The cost that is minimised.
    pub fn cost(&self, loss: Loss) -> f64 {
        let mut sum = 0.0;
        for o in &self.observations {
            let s = self
                .residual(o)
                .map_or(BEHIND_SIGMAS * BEHIND_SIGMAS, |r| (r[0] * r[0] + r[1] * r[1]) / (o.sigma_px * o.sigma_px));
            sum += match o.trust {
                Trust::Robust => loss.at(s).0,
                Trust::Full => s,
            };
        }
        for (i, frame) in self.frames.iter().enumerate() {
            sum += self.position_off(i).map_or(0.0, |off| off.norm_squared());
            if let Some((rotation, sigma)) = &frame.direction {
                sum += turn(&frame.pose.rotation, rotation).norm_squared() / (sigma * sigma);
            }
        }
        for point in &self.points {
            if let Some((at, sigma)) = &point.survey {
                sum += (point.xyz - at).component_div(sigma).norm_squared();
            }
        }
        for camera in &self.cameras {
            for p in camera.active() {
                if let Treatment::Constrained { value, sigma } = camera.treatment[p as usize] {
                    sum += ((camera.camera.get(p) - value) / sigma).powi(2);
                }
            }
        }
        0.5 * sum
    }
}
