//! Least squares over the graph of overlaps: every source has the same few unknowns, every overlap ties two sources.

/// Normal equations of `size` unknowns for each source, as blocks of `size` × `size` numbers (row by row): memory and
/// time of a step are linear in sources and overlaps.
pub struct Normal {
    size: usize,
    own: Vec<Vec<f64>>,
    ties: Vec<(usize, usize, Vec<f64>)>,
    right: Vec<f64>,
    held: Vec<bool>,
}

impl Normal {
    /// `held` says which unknowns, source after source, are zero.
    pub fn new(size: usize, held: Vec<bool>) -> Normal {
        Normal {
            size,
            own: vec![vec![0.0; size * size]; held.len() / size],
            ties: Vec::new(),
            right: vec![0.0; held.len()],
            held,
        }
    }

    /// Begins the overlap of two sources; the observations that follow belong to it.
    pub fn tie(&mut self, first: usize, second: usize) {
        self.ties.push((first, second, vec![0.0; self.size * self.size]));
    }

    /// An observation of the latest overlap: `first` · unknowns of the first − `second` · unknowns of the second =
    /// `gap`.
    pub fn observe(&mut self, first: &[f64], second: &[f64], gap: f64, weight: f64) {
        let n = self.size;
        let Some((i, j, tie)) = self.ties.last_mut() else { return };
        for row in 0..n {
            for column in 0..n {
                self.own[*i][row * n + column] += weight * first[row] * first[column];
                self.own[*j][row * n + column] += weight * second[row] * second[column];
                tie[row * n + column] -= weight * first[row] * second[column];
            }
            self.right[*i * n + row] += weight * first[row] * gap;
            self.right[*j * n + row] -= weight * second[row] * gap;
        }
    }

    /// Pulls the unknowns of each source to zero, by these weights.
    pub fn pull(&mut self, weights: &[f64]) {
        let n = self.size;
        for own in &mut self.own {
            (0..n).for_each(|k| own[k * n + k] += weights[k]);
        }
    }

    fn times(&self, x: &[f64]) -> Vec<f64> {
        let n = self.size;
        let mut out = vec![0.0; x.len()];
        for (source, own) in self.own.iter().enumerate() {
            for row in 0..n {
                out[source * n + row] = (0..n).map(|k| own[row * n + k] * x[source * n + k]).sum();
            }
        }
        for (i, j, tie) in &self.ties {
            for row in 0..n {
                for column in 0..n {
                    out[i * n + row] += tie[row * n + column] * x[j * n + column];
                    out[j * n + column] += tie[row * n + column] * x[i * n + row];
                }
            }
        }
        self.hold(&mut out);
        out
    }

    fn hold(&self, x: &mut [f64]) {
        x.iter_mut().zip(&self.held).filter(|(_, held)| **held).for_each(|(x, _)| *x = 0.0);
    }

    /// The unknowns, source after source, by conjugate gradients with a diagonal preconditioner (M. Hestenes and
    /// E. Stiefel, *Methods of conjugate gradients for solving linear systems*, 1952).
    pub fn solve(&self) -> Vec<f64> {
        let n = self.size;
        let diagonal: Vec<f64> = (0..self.right.len()).map(|k| self.own[k / n][k % n * (n + 1)].max(1e-12)).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut x = vec![0.0; self.right.len()];
        let mut rest = self.right.clone();
        self.hold(&mut rest);
        let mut scaled: Vec<f64> = rest.iter().zip(&diagonal).map(|(r, d)| r / d).collect();
        let mut way = scaled.clone();
        let mut energy = dot(&rest, &scaled);
        let enough = energy * 1e-24;
        for _ in 0..20 * x.len() + 200 {
            if energy <= enough || energy == 0.0 {
                break;
            }
            let product = self.times(&way);
            let step = energy / dot(&way, &product);
            for k in 0..x.len() {
                x[k] += step * way[k];
                rest[k] -= step * product[k];
                scaled[k] = rest[k] / diagonal[k];
            }
            let next = dot(&rest, &scaled);
            let keep = next / energy;
            way.iter_mut().zip(&scaled).for_each(|(w, s)| *w = s + keep * *w);
            energy = next;
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::Normal;

    /// Levels along a chain of sources, the third held: all come back relative to it.
    #[test]
    fn a_chain_comes_back_relative_to_the_held_one() {
        let levels = [3.0, -1.0, 2.5, 7.0, 0.5];
        let mut normal = Normal::new(1, (0..levels.len()).map(|k| k == 2).collect());
        for i in 0..levels.len() - 1 {
            normal.tie(i, i + 1);
            normal.observe(&[1.0], &[1.0], levels[i] - levels[i + 1], 2.0);
        }
        for (found, level) in normal.solve().iter().zip(levels) {
            assert!((found - (level - levels[2])).abs() < 1e-9, "{found} for {level}");
        }
    }
}
