//! Normal equations, reduced to the cameras.

use nalgebra::{DVector, Matrix2, Matrix3, SMatrix, Vector3};

use super::layout::Layout;
use super::linear::{Curvature, Linear, linear};
use super::problem::{Loss, Observation, Problem, Treatment, Trust};
use super::skyline::Skyline;
use super::small::{across, times};
use crate::camera::Parameter;
use crate::pose::turn;

type Matrix6x3 = SMatrix<f64, 6, 3>;

/// Pivots, as shares of their diagonals, above which an unknown is determined by more than rounding, and above which a
/// damped system can be solved.
pub(super) const DETERMINED: f64 = 1e-11;
pub(super) const SOLVABLE: f64 = 1e-15;

/// Whether rays meet at less than some two seconds of arc: the point could lie anywhere along them.
fn is_without_depth(v: &Matrix3<f64>) -> bool {
    let known = v.symmetric_eigenvalues();
    known.min() < 1e-10 * known.max()
}

/// One point after elimination: V⁻¹, its right side, and Jᵀ_c J_x by observation and by camera.
struct Eliminated {
    inverse: Matrix3<f64>,
    right: Vector3<f64>,
    /// Start of the reduced unknowns and Wᵀ's three columns.
    pose: Vec<(usize, Matrix6x3)>,
    interior: Vec<(usize, Vector3<f64>)>,
}

/// The reduced system, damped.
pub(super) struct Reduced {
    matrix: Skyline,
    right: DVector<f64>,
    points: Vec<Eliminated>,
    /// ‖Jᵀr‖ by the largest entry scaled with its diagonal: what is left of the slope.
    pub slope: f64,
    diagonal: Vec<f64>,
    damping: f64,
    point_diagonal: Vec<Vector3<f64>>,
}

/// A step of all unknowns.
pub(super) struct Step {
    pub reduced: DVector<f64>,
    pub points: Vec<Vector3<f64>>,
    /// What the linear model says the cost falls by.
    pub gain: f64,
}

impl Reduced {
    /// Builds the system at the present values with a damping of λ times the diagonal.
    pub fn new(problem: &Problem, layout: &Layout, loss: Loss, curvature: Curvature, damping: f64) -> Self {
        let mut matrix = Skyline::new(layout.first.clone());
        let mut right = DVector::zeros(layout.size);
        let mut points = Vec::with_capacity(problem.points.len());
        let mut point_diagonal = Vec::with_capacity(problem.points.len());
        let mut slope = 0.0f64;
        let mut done: Vec<(usize, Linear)> = Vec::new();
        for (j, list) in layout.of_point.iter().enumerate() {
            done.clear();
            for i in list {
                let o = &problem.observations[*i as usize];
                if let Some(l) = linear(problem, layout, o, loss, curvature) {
                    done.push((o.frame, l));
                }
            }
            let (mut v, mut g) = (Matrix3::zeros(), Vector3::zeros());
            for (_, l) in &done {
                v += across(&l.point, &l.point);
                g -= across(&l.point, &l.residual);
            }
            if let Some((at, sigma)) = &problem.points[j].survey {
                for a in 0..3 {
                    let w = 1.0 / (sigma[a] * sigma[a]);
                    v[(a, a)] += w;
                    g[a] -= w * (problem.points[j].xyz[a] - at[a]);
                }
            }
            for a in 0..3 {
                if v[(a, a)] > 0.0 {
                    slope = slope.max(g[a].abs() / v[(a, a)].sqrt());
                }
            }
            if damping == 0.0 && problem.points[j].survey.is_none() && is_without_depth(&v) {
                // Its huge inverse would drown what all others say.
                done.clear();
                (v, g) = (Matrix3::zeros(), Vector3::zeros());
            }
            let diagonal = v.diagonal().map(|d| d.max(1e-12));
            point_diagonal.push(diagonal);
            let damped = v + Matrix3::from_diagonal(&(diagonal * damping));
            // A point without depth (parallel rays) stays where it is.
            let inverse = damped.cholesky().map_or_else(Matrix3::zeros, |c| c.inverse());
            points.push(eliminate(problem, layout, &done, inverse, g, &mut matrix, &mut right));
        }
        priors(problem, layout, &mut matrix, &mut right);
        // The diagonal before elimination is what Marquardt scales with.
        let mut diagonal = vec![0.0; layout.size];
        let mut gradient = vec![0.0; layout.size];
        for i in 0..layout.size {
            diagonal[i] = matrix.diagonal(i);
            gradient[i] = right[i];
        }
        for e in &points {
            let vg = e.inverse * e.right;
            for (at, w) in &e.pose {
                let (t, slope) = (times(w, &e.inverse), times(w, &vg));
                for a in 0..6 {
                    diagonal[at + a] += t[(a, 0)] * w[(a, 0)] + t[(a, 1)] * w[(a, 1)] + t[(a, 2)] * w[(a, 2)];
                    gradient[at + a] += slope[a];
                }
            }
            for (at, w) in &e.interior {
                diagonal[*at] += w.dot(&(e.inverse * w));
                gradient[*at] += w.dot(&vg);
            }
        }
        for i in 0..layout.size {
            if diagonal[i] > 0.0 {
                slope = slope.max(gradient[i].abs() / diagonal[i].sqrt());
            }
            let d = diagonal[i].max(1e-12);
            diagonal[i] = d;
            if damping > 0.0 {
                matrix.add(i, i, damping * d);
            }
        }
        Reduced { matrix, right, points, slope, diagonal, damping, point_diagonal }
    }

    /// The part of the undamped system that GCPs and priors make; the first `ties` points are ties.
    pub fn of_stated(problem: &Problem, layout: &Layout, loss: Loss, ties: usize) -> Skyline {
        let mut layout = layout.clone();
        layout.of_point[..ties].iter_mut().for_each(Vec::clear);
        Reduced::new(problem, &layout, loss, Curvature::Weights, 0.0).matrix
    }

    /// Solves; `None` when the matrix is not positive definite, a pivot being at most `least_pivot` of its diagonal.
    pub fn step(self, least_pivot: f64) -> Option<Step> {
        let factor = self.matrix.cholesky(least_pivot).ok()?;
        let mut reduced = self.right.clone();
        factor.solve(reduced.as_mut_slice());
        let mut gain = 0.0;
        // Model: ½ Σ δ (λ D δ + g); g of the full system, by parts.
        for i in 0..reduced.len() {
            gain += self.damping * self.diagonal[i] * reduced[i] * reduced[i] + reduced[i] * self.right[i];
        }
        let mut points = Vec::with_capacity(self.points.len());
        for (e, d) in self.points.iter().zip(&self.point_diagonal) {
            let step = e.back(&reduced);
            // δx·g_x and the part that elimination took from the right side.
            let mut through = 0.0;
            let vg = e.inverse * e.right;
            for (at, w) in &e.pose {
                through += reduced.fixed_rows::<6>(*at).dot(&times(w, &vg));
            }
            for (at, w) in &e.interior {
                through += reduced[*at] * w.dot(&vg);
            }
            gain += step.dot(&e.right) + through + self.damping * step.component_mul(d).dot(&step);
            points.push(step);
        }
        reduced.iter().all(|v| v.is_finite()).then_some(Step { reduced, points, gain: 0.5 * gain })
    }

    /// Keeps what covariances need; `None` when the datum is not fixed.
    pub fn factored(self, layout: Layout) -> Option<Factored> {
        let factor = self.matrix.cholesky(DETERMINED).ok()?;
        Some(Factored { factor, points: self.points, layout })
    }
}

impl Eliminated {
    fn back(&self, reduced: &DVector<f64>) -> Vector3<f64> {
        self.inverse * (self.right - self.pulled(reduced))
    }

    /// Wᵀ of a step of the cameras.
    fn pulled(&self, reduced: &DVector<f64>) -> Vector3<f64> {
        let mut g = Vector3::zeros();
        for (at, w) in &self.pose {
            let step = reduced.fixed_rows::<6>(*at);
            for c in 0..3 {
                g[c] += w.column(c).dot(&step);
            }
        }
        for (at, w) in &self.interior {
            g += w * reduced[*at];
        }
        g
    }
}

fn eliminate(
    problem: &Problem,
    layout: &Layout,
    done: &[(usize, Linear)],
    inverse: Matrix3<f64>,
    g: Vector3<f64>,
    matrix: &mut Skyline,
    right: &mut DVector<f64>,
) -> Eliminated {
    let mut pose: Vec<(usize, Matrix6x3)> = Vec::with_capacity(done.len());
    let mut interior: Vec<(usize, Vector3<f64>)> = Vec::new();
    for (frame, l) in done {
        let at = layout.frame_at[*frame];
        let camera = problem.frames[*frame].camera;
        let (start, count) = (layout.interior_at[camera], layout.active[camera].len());
        let square = across(&l.pose, &l.pose);
        for r in 0..6 {
            // Symmetric: a column is a row.
            matrix.add_row(at + r, at, &square.as_slice()[6 * r..=7 * r]);
        }
        let slope = across(&l.pose, &l.residual);
        for r in 0..6 {
            right[at + r] -= slope[r];
        }
        let w = across(&l.pose, &l.point);
        match pose.iter_mut().find(|p| p.0 == at) {
            Some(known) => known.1 += w,
            None => pose.push((at, w)),
        }
        for i in 0..count {
            right[start + i] -= l.interior[i].dot(&l.residual);
            matrix.add_row(start + i, at, across(&l.pose, &l.interior[i]).as_slice());
            for k in 0..=i {
                matrix.add(start + i, start + k, l.interior[i].dot(&l.interior[k]));
            }
            let w = across(&l.point, &l.interior[i]);
            match interior.iter_mut().find(|p| p.0 == start + i) {
                Some(known) => known.1 += w,
                None => interior.push((start + i, w)),
            }
        }
    }
    // In the order of the unknowns, so that every block lies below the diagonal.
    pose.sort_unstable_by_key(|p| p.0);
    let vg = inverse * g;
    for (k, (a, wa)) in pose.iter().enumerate() {
        let t = times(wa, &inverse);
        let slope = times(wa, &vg);
        for r in 0..6 {
            right[a + r] -= slope[r];
        }
        for (b, wb) in &pose[..=k] {
            for r in 0..6 {
                let mut row = [0.0; 6];
                for (c, value) in row.iter_mut().enumerate() {
                    *value = -(t[(r, 0)] * wb[(c, 0)] + t[(r, 1)] * wb[(c, 1)] + t[(r, 2)] * wb[(c, 2)]);
                }
                matrix.add_row(a + r, *b, if a == b { &row[..=r] } else { &row });
            }
        }
    }
    for (k, (a, wa)) in interior.iter().enumerate() {
        let t = inverse * wa;
        right[*a] -= wa.dot(&vg);
        for (b, wb) in &pose {
            matrix.add_row(*a, *b, (-times(wb, &t)).as_slice());
        }
        for (b, wb) in &interior[..=k] {
            matrix.add(*a, *b, -t.dot(wb));
        }
    }
    Eliminated { inverse, right: g, pose, interior }
}

fn priors(problem: &Problem, layout: &Layout, matrix: &mut Skyline, right: &mut DVector<f64>) {
    for (i, frame) in problem.frames.iter().enumerate() {
        let at = layout.frame_at[i];
        if let (Some((_, sigma)), Some(misses)) = (&frame.position, problem.position_misses(i)) {
            for a in 0..3 {
                let w = 1.0 / (sigma[a] * sigma[a]);
                matrix.add(at + 3 + a, at + 3 + a, w);
                right[at + 3 + a] += w * misses[a];
                if let Some(offset_at) = layout.offset_at.filter(|_| !frame.is_held()) {
                    matrix.add(offset_at + a, offset_at + a, w);
                    matrix.add(offset_at + a, at + 3 + a, w);
                    right[offset_at + a] += w * misses[a];
                }
            }
        }
        if let Some((rotation, sigma)) = &frame.direction {
            let (w, r) = (1.0 / (sigma * sigma), turn(&frame.pose.rotation, rotation));
            for a in 0..3 {
                matrix.add(at + a, at + a, w);
                right[at + a] -= w * r[a];
            }
        }
    }
    for (i, camera) in problem.cameras.iter().enumerate() {
        for (k, p) in layout.active[i].iter().enumerate() {
            if let Treatment::Constrained { value, sigma } = camera.treatment[*p as usize] {
                let (at, w) = (layout.interior_at[i] + k, 1.0 / (sigma * sigma));
                matrix.add(at, at, w);
                right[at] -= w * (camera.camera.get(*p) - value);
            }
        }
    }
}

/// The factored normal equations at the solution: covariances of everything.
pub struct Factored {
    factor: Skyline,
    points: Vec<Eliminated>,
    pub(super) layout: Layout,
}

impl Factored {
    /// Columns of N⁻¹.
    pub(super) fn columns(&self, start: usize, count: usize) -> Vec<DVector<f64>> {
        (0..count)
            .map(|i| {
                let mut b = DVector::zeros(self.layout.size);
                b[start + i] = 1.0;
                self.factor.solve(b.as_mut_slice());
                b
            })
            .collect()
    }

    /// Covariance of a frame's turn (radians, R ← exp(δ) R) and centre.
    pub fn frame(&self, frame: usize) -> SMatrix<f64, 6, 6> {
        let at = self.layout.frame_at[frame];
        let columns = self.columns(at, 6);
        SMatrix::from_fn(|r, c| columns[c][at + r])
    }

    /// Covariance of where a frame's position in the table is expected: its centre, and what all are off together.
    pub(crate) fn position(&self, frame: usize) -> Matrix3<f64> {
        let at = self.layout.frame_at[frame] + 3;
        let column = |a: usize| {
            let mut column = DVector::zeros(self.layout.size);
            column[at + a] = 1.0;
            if let Some(offset_at) = self.layout.offset_at {
                column[offset_at + a] = 1.0;
            }
            column
        };
        let solved: [DVector<f64>; 3] = std::array::from_fn(|a| self.solved(column(a)));
        Matrix3::from_fn(|r, c| column(r).dot(&solved[c]))
    }

    /// What all positions, taken as they stand, are off together by what everything else says, metres, and its
    /// covariance: one step of the adjustment that seeks it too. `None` where nothing else says so.
    pub(super) fn offset_of_positions(&self, problem: &Problem) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        /// Share of the positions' weight that something else must hold up to.
        const LEAST: f64 = 1e-9;
        let mut pulls: [DVector<f64>; 3] = std::array::from_fn(|_| DVector::zeros(self.layout.size));
        let (mut weights, mut slope) = (Vector3::zeros(), Vector3::zeros());
        for (i, frame) in problem.frames.iter().enumerate() {
            let (Some((_, sigma)), Some(misses)) = (&frame.position, problem.position_misses(i)) else { continue };
            if frame.is_held() {
                continue;
            }
            for a in 0..3 {
                let w = 1.0 / (sigma[a] * sigma[a]);
                weights[a] += w;
                slope[a] += w * misses[a];
                pulls[a][self.layout.frame_at[i] + 3 + a] = w;
            }
        }
        let solved = pulls.clone().map(|pull| self.solved(pull));
        let left = Matrix3::from_diagonal(&weights) - Matrix3::from_fn(|r, c| pulls[r].dot(&solved[c]));
        if left.symmetric_eigenvalues().min() <= LEAST * weights.max() {
            return None;
        }
        let covariance = left.try_inverse()?;
        Some((covariance * slope, covariance))
    }

    /// Standard deviations of a camera's active parameters.
    pub fn interior(&self, camera: usize) -> Vec<(Parameter, f64)> {
        let at = self.layout.interior_at[camera];
        let active = &self.layout.active[camera];
        let columns = self.columns(at, active.len());
        active.iter().enumerate().map(|(i, p)| (*p, columns[i][at + i].max(0.0).sqrt())).collect()
    }

    /// Covariance of a point.
    pub fn point(&self, point: usize) -> Matrix3<f64> {
        let e = &self.points[point];
        let (columns, solved) = (self.columns_of_point(point), self.leans(point));
        e.inverse + Matrix3::from_fn(|r, c| columns[r].dot(&solved[c]))
    }

    /// Columns of W V⁻¹ of a point in the reduced system.
    fn columns_of_point(&self, point: usize) -> [DVector<f64>; 3] {
        let e = &self.points[point];
        std::array::from_fn(|c| {
            let mut column = DVector::zeros(self.layout.size);
            self.scatter(e, &e.inverse.column(c).into_owned(), &mut column);
            column
        })
    }

    /// N⁻¹ W V⁻¹: how a point's coordinates lean on what pulls the cameras, but for the sign.
    pub(super) fn leans(&self, point: usize) -> [DVector<f64>; 3] {
        self.columns_of_point(point).map(|column| self.solved(column))
    }

    /// Places in the reduced system of what one point's measurements pull, in their order.
    pub(super) fn pulled_by(&self, point: usize) -> Vec<usize> {
        let e = &self.points[point];
        let mut all: Vec<usize> = e.pose.iter().flat_map(|(at, _)| *at..at + 6).collect();
        all.extend(e.interior.iter().map(|(at, _)| *at));
        all.sort_unstable();
        all
    }

    /// Adds Jᵀr of an observation, reduced to the cameras, with the sign of a step.
    pub(super) fn add_pull(&self, problem: &Problem, o: &Observation, l: &Linear, into: &mut DVector<f64>) {
        let e = &self.points[o.point];
        if e.pose.is_empty() {
            return;
        }
        let (at, camera) = (self.layout.frame_at[o.frame], problem.frames[o.frame].camera);
        let slope = across(&l.pose, &l.residual);
        for r in 0..6 {
            into[at + r] -= slope[r];
        }
        for i in 0..self.layout.active[camera].len() {
            into[self.layout.interior_at[camera] + i] -= l.interior[i].dot(&l.residual);
        }
        self.scatter(e, &(e.inverse * across(&l.point, &l.residual)), into);
    }

    /// N⁻¹ of a right side.
    pub(super) fn solved(&self, mut right: DVector<f64>) -> DVector<f64> {
        self.factor.solve(right.as_mut_slice());
        right
    }

    /// Covariance of a point if the cameras were known.
    pub(super) fn alone(&self, point: usize) -> Matrix3<f64> {
        self.points[point].inverse
    }

    fn scatter(&self, e: &Eliminated, v: &Vector3<f64>, into: &mut DVector<f64>) {
        for (at, w) in &e.pose {
            let part = w * v;
            for r in 0..6 {
                into[at + r] += part[r];
            }
        }
        for (at, w) in &e.interior {
            into[*at] += w.dot(v);
        }
    }

    /// Covariance (px²) of what the solution predicts for an observation: J N⁻¹ Jᵀ; `None` behind the camera.
    pub fn predicted(&self, problem: &Problem, o: &Observation) -> Option<Matrix2<f64>> {
        let whole = Observation { trust: Trust::Full, ..*o };
        let l = linear(problem, &self.layout, &whole, Loss::Squared, Curvature::Weights)?;
        let e = &self.points[o.point];
        let (at, camera) = (self.layout.frame_at[o.frame], problem.frames[o.frame].camera);
        let mut rows = Vec::new();
        for axis in 0..2 {
            let mut a = DVector::zeros(self.layout.size);
            let x = l.point.row(axis).transpose();
            let through = -(e.inverse * x);
            self.scatter(e, &through, &mut a);
            for r in 0..6 {
                a[at + r] += l.pose[(axis, r)];
            }
            for i in 0..self.layout.active[camera].len() {
                a[self.layout.interior_at[camera] + i] += l.interior[i][axis];
            }
            rows.push(a);
        }
        let direct = l.point * e.inverse * l.point.transpose();
        let solved: Vec<DVector<f64>> = rows
            .iter()
            .map(|a| {
                let mut b = a.clone();
                self.factor.solve(b.as_mut_slice());
                b
            })
            .collect();
        let c = Matrix2::from_fn(|r, c| rows[r].dot(&solved[c])) + direct;
        Some(c * (o.sigma_px * o.sigma_px))
    }
}
