//! One frame, each point seen once: the same minimum as of [`super::solve`], on numbers that need no memory of their
//! own. A resection goes there from thousands of starts.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

use super::descent::{Descent, Options, Solved, Summary, Way, descend};
use super::layout::Layout;
use super::linear::{Curvature, linear};
use super::normal::SOLVABLE;
use super::problem::{Problem, Treatment};
use super::small::{Lower, across, tidy, times};
use crate::camera::Parameter;

/// A turn, a place and one interior parameter.
const SIZE: usize = 7;

type Square = SMatrix<f64, SIZE, SIZE>;
type Column = SVector<f64, SIZE>;

/// Whether it is such a problem.
pub(super) fn is_single(problem: &Problem) -> bool {
    let free = |t: &&Treatment| **t == Treatment::Free;
    let one_each = problem.points.len() == problem.observations.len()
        && problem.observations.iter().enumerate().all(|(i, o)| o.point == i);
    let [camera] = problem.cameras.as_slice() else { return false };
    let [frame] = problem.frames.as_slice() else { return false };
    let active = camera.active().len();
    one_each
        && problem.offset.is_none()
        && frame.direction.is_none()
        && active <= 1
        && camera.treatment.iter().filter(free).count() == active
}

/// One point after elimination.
struct Eliminated {
    inverse: Matrix3<f64>,
    right: Vector3<f64>,
    by_frame: SMatrix<f64, SIZE, 3>,
    diagonal: Vector3<f64>,
}

/// Adds the lower triangle of a bᵀ, which is symmetric.
#[inline(always)]
fn add_lower<const K: usize>(to: &mut Square, a: &SMatrix<f64, SIZE, K>, b: &SMatrix<f64, SIZE, K>) {
    for c in 0..SIZE {
        for r in c..SIZE {
            to[(r, c)] += (0..K).fold(0.0, |sum, k| sum + a[(r, k)] * b[(c, k)]);
        }
    }
}

/// The damped system at the present values.
struct System {
    /// Its lower triangle.
    matrix: Square,
    /// After elimination, and before.
    right: Column,
    gradient: Column,
    diagonal: Column,
    points: Vec<Eliminated>,
    slope: f64,
    damping: f64,
}

/// How all unknowns move, and the fall of the cost that it foretells.
struct Step {
    frame: Column,
    points: Vec<Vector3<f64>>,
    foretold: f64,
}

/// What moves.
struct State {
    rotation: Matrix3<f64>,
    centre: Vector3<f64>,
    interior: f64,
    points: Vec<Vector3<f64>>,
}

struct Single<'a> {
    problem: &'a mut Problem,
    layout: Layout,
    active: Option<Parameter>,
    options: &'a Options,
    /// Where it stands; the problem is where it is tried.
    from: State,
}

impl State {
    fn of(problem: &Problem, active: Option<Parameter>) -> State {
        let pose = &problem.frames[0].pose;
        let interior = active.map_or(0.0, |p| problem.cameras[0].camera.get(p));
        let points = problem.points.iter().map(|p| p.xyz).collect();
        State { rotation: pose.rotation, centre: pose.centre, interior, points }
    }

    /// The same, in the memory that is there.
    fn take(&mut self, problem: &Problem, active: Option<Parameter>) {
        let pose = &problem.frames[0].pose;
        (self.rotation, self.centre) = (pose.rotation, pose.centre);
        self.interior = active.map_or(0.0, |p| problem.cameras[0].camera.get(p));
        self.points.iter_mut().zip(&problem.points).for_each(|(at, point)| *at = point.xyz);
    }
}

impl Single<'_> {
    fn system(&self, curvature: Curvature, damping: f64) -> System {
        let (mut whole, mut taken) = (Square::zeros(), Square::zeros());
        let (mut gradient, mut through) = (Column::zeros(), Column::zeros());
        let mut slope = 0.0f64;
        let mut points = Vec::with_capacity(self.problem.points.len());
        for (o, point) in self.problem.observations.iter().zip(&self.problem.points) {
            let (mut v, mut right, mut by_frame) = (Matrix3::zeros(), Vector3::zeros(), SMatrix::zeros());
            if let Some(l) = linear(self.problem, &self.layout, o, self.options.loss, curvature) {
                let mut j = SMatrix::<f64, 2, SIZE>::zeros();
                j.fixed_columns_mut::<6>(0).copy_from(&l.pose);
                j.set_column(6, &l.interior[0]);
                v = across(&l.point, &l.point);
                right = -across(&l.point, &l.residual);
                add_lower(&mut whole, &j.transpose(), &j.transpose());
                gradient -= across(&j, &l.residual);
                by_frame = across(&j, &l.point);
            }
            if let Some((at, sigma)) = &point.survey {
                let weight = sigma.map(|s| 1.0 / (s * s));
                v += Matrix3::from_diagonal(&weight);
                right -= weight.component_mul(&(point.xyz - at));
            }
            let known = v.diagonal();
            (0..3).filter(|a| known[*a] > 0.0).for_each(|a| slope = slope.max(right[a].abs() / known[a].sqrt()));
            let diagonal = known.map(|d| d.max(1e-12));
            let damped = v + Matrix3::from_diagonal(&(diagonal * damping));
            let inverse = Lower::of(&damped).map_or_else(Matrix3::zeros, |l| l.inverse());
            let t = times(&by_frame, &inverse);
            add_lower(&mut taken, &t, &by_frame);
            through += times(&t, &right);
            points.push(Eliminated { inverse, right, by_frame, diagonal });
        }
        if let Some((at, sigma)) = &self.problem.frames[0].position {
            for a in 0..3 {
                let weight = 1.0 / (sigma[a] * sigma[a]);
                whole[(3 + a, 3 + a)] += weight;
                gradient[3 + a] -= weight * (self.problem.frames[0].pose.centre[a] - at[a]);
            }
        }
        if self.active.is_none() {
            whole[(6, 6)] = 1.0;
        }
        let diagonal = whole.diagonal().map(|d| d.max(1e-12));
        (0..SIZE).for_each(|i| slope = slope.max(gradient[i].abs() / diagonal[i].sqrt()));
        let matrix = whole - taken + Square::from_diagonal(&(diagonal * damping));
        System { matrix, right: gradient - through, gradient, diagonal, points, slope, damping }
    }
}

impl Descent for Single<'_> {
    type Step = Step;

    fn cost(&self) -> f64 {
        self.problem.cost(self.options.loss)
    }

    fn solved(&self, curvature: Curvature, damping: f64, least_slope: f64) -> Solved<Step> {
        let system = self.system(curvature, damping);
        if system.slope < least_slope {
            return Solved::Level;
        }
        system.step().map_or(Solved::Unsolvable, |step| Solved::Step { foretold: step.foretold, step })
    }

    /// The problem itself goes there.
    fn tried(&mut self, Step { frame, points, .. }: &Step, way: Way) -> Option<f64> {
        let Way::Straight(reach) = way else { return None };
        let part = |at: usize| Vector3::new(frame[at], frame[at + 1], frame[at + 2]) * reach;
        let pose = &mut self.problem.frames[0].pose;
        pose.rotation = tidy(times(Rotation3::new(part(0)).matrix(), &self.from.rotation));
        pose.centre = self.from.centre + part(3);
        if let Some(p) = self.active {
            self.problem.cameras[0].camera.set(p, self.from.interior + frame[6] * reach);
        }
        for ((point, from), by) in self.problem.points.iter_mut().zip(&self.from.points).zip(points) {
            point.xyz = from + by * reach;
        }
        Some(self.cost())
    }

    fn accept(&mut self) {
        self.from.take(self.problem, self.active);
    }

    fn refuse(&mut self) {
        let pose = &mut self.problem.frames[0].pose;
        (pose.rotation, pose.centre) = (self.from.rotation, self.from.centre);
        if let Some(p) = self.active {
            self.problem.cameras[0].camera.set(p, self.from.interior);
        }
        self.problem.points.iter_mut().zip(&self.from.points).for_each(|(point, at)| point.xyz = *at);
    }

    fn is_out_of_bounds(&self) -> bool {
        self.options.lets_go_of(self.problem)
    }
}

impl System {
    /// `None` where the matrix is not positive definite.
    fn step(&self) -> Option<Step> {
        let factor = Lower::of(&self.matrix)?;
        if (0..SIZE).any(|i| factor.diagonal(i).powi(2) <= SOLVABLE * self.matrix[(i, i)].abs()) {
            return None;
        }
        let frame = factor.solve(&self.right);
        let mut gain = frame.dot(&self.gradient) + self.damping * frame.component_mul(&self.diagonal).dot(&frame);
        let of_point = |e: &Eliminated| {
            let step = times(&e.inverse, &(e.right - times(&e.by_frame.transpose(), &frame)));
            gain += step.dot(&e.right) + self.damping * step.component_mul(&e.diagonal).dot(&step);
            step
        };
        let points = self.points.iter().map(of_point).collect();
        frame.iter().all(|v| v.is_finite()).then_some(Step { frame, points, foretold: 0.5 * gain })
    }
}

/// Adjusts the problem in place.
pub(super) fn solve_single(problem: &mut Problem, options: &Options) -> Summary {
    let layout = Layout::new(problem);
    let active = problem.cameras[0].active().first().copied();
    let from = State::of(problem, active);
    descend(&mut Single { problem, layout, active, options, from }, options)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::{BundleCamera, BundleFrame, BundlePoint, Ended, Loss, Observation, Trust, solve};
    use crate::camera::Camera;
    use crate::pose::{Pose, YawPitchRoll};

    /// A camera that nobody uses sends the same problem to the solver of blocks.
    #[test]
    fn the_minimum_is_that_of_a_block() {
        let camera = Camera::pinhole("c", [4000.0, 3000.0], 3000.0, [2000.0, 1500.0]);
        let angles = |yaw_deg| YawPitchRoll { yaw_deg, pitch_deg: -60.0, roll_deg: 2.0 };
        let truth = Pose::looking(Vector3::new(0.0, 0.0, 100.0), angles(10.0));
        let start = Pose::looking(Vector3::new(6.0, -8.0, 115.0), angles(14.0));
        let mut problem = Problem::default();
        for i in 0..8 {
            let turn = 0.9 * f64::from(i);
            let xyz = Vector3::new(10.0 + 25.0 * turn.cos(), 55.0 + 25.0 * turn.sin(), 8.0 * (3.0 * turn).sin());
            let at = camera.project(truth.to_camera(&xyz).into()).expect("in front");
            // Coordinates that are known to a metre, and one point that is wrong.
            let off = Vector3::new((5.0 * turn).sin(), (7.0 * turn).cos(), (11.0 * turn).sin());
            let pixel = [at[0] + if i == 3 { 60.0 } else { (13.0 * turn).sin() }, at[1] + (17.0 * turn).cos()];
            problem.points.push(BundlePoint { xyz: xyz + off, survey: Some((xyz + off, Vector3::repeat(1.0))) });
            let point = problem.points.len() - 1;
            problem.observations.push(Observation { frame: 0, point, pixel, sigma_px: 1.0, trust: Trust::Robust });
        }
        let free = BundleCamera::held(camera.with(Parameter::F, 2700.0)).treat(Parameter::F, Treatment::Free);
        for (bundle, position) in [
            (free.clone(), None),
            (BundleCamera::held(free.camera.clone()), None),
            (free, Some((truth.centre, Vector3::repeat(0.5)))),
        ] {
            problem.cameras = vec![bundle.clone()];
            problem.frames = vec![BundleFrame { camera: 0, pose: start, position, direction: None }];
            let mut block = problem.clone();
            block.cameras.push(BundleCamera::held(bundle.camera));
            let mut one = problem.clone();
            assert!(is_single(&one) && !is_single(&block));
            for loss in [Loss::Cauchy(2.0), Loss::Squared] {
                let options = Options { loss, least_gain: 1e-14, most_iterations: 300, ..Options::default() };
                let (a, b) = (solve(&mut one, &options).expect("one"), solve(&mut block, &options).expect("a block"));
                assert!((a.cost - b.cost).abs() < 1e-8 * b.cost, "{loss:?}: {a:?} {b:?}");
                let (p, q) = (one.frames[0].pose, block.frames[0].pose);
                assert!((p.centre - q.centre).norm() < 1e-3, "{loss:?}: {:?} {:?}", p.centre, q.centre);
                let (f, g) = (one.cameras[0].camera.f_px(), block.cameras[0].camera.f_px());
                assert!((f - g).abs() < 1e-2, "{loss:?}: {f} {g}");
            }
        }
    }

    /// A focal length that runs away is not followed.
    #[test]
    fn a_focal_length_out_of_bounds_ends_the_iteration() {
        let camera = Camera::pinhole("c", [4000.0, 3000.0], 3000.0, [2000.0, 1500.0]);
        let pose = Pose::looking(
            Vector3::new(0.0, 0.0, 100.0),
            YawPitchRoll { yaw_deg: 0.0, pitch_deg: -90.0, roll_deg: 0.0 },
        );
        let mut problem = Problem {
            cameras: vec![BundleCamera::held(camera.clone()).treat(Parameter::F, Treatment::Free)],
            frames: vec![BundleFrame {
                camera: 0,
                pose,
                position: Some((pose.centre, Vector3::repeat(0.1))),
                direction: None,
            }],
            ..Problem::default()
        };
        for (i, [x, y]) in [[-30.0, -20.0], [30.0, -20.0], [30.0, 20.0], [-30.0, 20.0]].into_iter().enumerate() {
            let xyz = Vector3::new(x, y, 0.0);
            let at = camera.clone().with(Parameter::F, 6000.0).project(pose.to_camera(&xyz).into()).expect("in front");
            problem.points.push(BundlePoint { xyz, survey: Some((xyz, Vector3::repeat(0.1))) });
            problem.observations.push(Observation { frame: 0, point: i, pixel: at, sigma_px: 1.0, trust: Trust::Full });
        }
        let options = Options { focal_px: [1000.0, 5000.0], ..Options::default() };
        assert_eq!(solve(&mut problem.clone(), &options).expect("ended").ended, Ended::Left);
        assert_eq!(solve(&mut problem, &Options::default()).expect("ended").ended, Ended::Converged);
        assert!((problem.cameras[0].camera.f_px() - 6000.0).abs() < 1.0);
    }
}
