//! A symmetric positive definite matrix stored row by row from the first entry that is not zero (the "skyline" or
//! envelope), and its Cholesky factor, which has the same shape (George and Liu, *Computer Solution of Large Sparse
//! Positive Definite Systems*, 1981, ch. 4). Flight lines make narrow bands.

/// The lower triangle, row by row.
#[derive(Clone, Debug)]
pub struct Skyline {
    first: Vec<usize>,
    rows: Vec<Vec<f64>>,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Four sums side by side, so that the compiler may use wide registers.
    let mut s = [0.0; 4];
    let n = a.len() / 4 * 4;
    for (x, y) in a[..n].chunks_exact(4).zip(b[..n].chunks_exact(4)) {
        for i in 0..4 {
            s[i] += x[i] * y[i];
        }
    }
    let tail: f64 = a[n..].iter().zip(&b[n..]).map(|(x, y)| x * y).sum();
    s[0] + s[1] + s[2] + s[3] + tail
}

impl Skyline {
    /// Zeros; `first[i]` is the first column of row i.
    pub fn new(first: Vec<usize>) -> Self {
        let rows = first.iter().enumerate().map(|(i, f)| vec![0.0; i + 1 - f]).collect();
        Skyline { first, rows }
    }
    /// Number of rows.
    pub fn size(&self) -> usize {
        self.first.len()
    }
    /// Makes every entry zero.
    pub fn clear(&mut self) {
        for row in &mut self.rows {
            row.fill(0.0);
        }
    }
    /// Adds to an entry of the lower triangle within the envelope.
    #[inline]
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        let (i, j) = if row >= column { (row, column) } else { (column, row) };
        self.rows[i][j - self.first[i]] += value;
    }
    /// Adds to neighbouring entries of a row of the lower triangle within the envelope.
    #[inline]
    pub fn add_row(&mut self, row: usize, column: usize, values: &[f64]) {
        let from = column - self.first[row];
        for (entry, value) in self.rows[row][from..from + values.len()].iter_mut().zip(values) {
            *entry += value;
        }
    }
    /// The entry of row and column `i`.
    pub fn diagonal(&self, i: usize) -> f64 {
        self.rows[i][i - self.first[i]]
    }

    /// L with L Lᵀ = this.
    ///
    /// # Errors
    /// The row where the matrix is not positive definite: its pivot is no number, not positive, or at most `least` of
    /// the diagonal.
    pub fn cholesky(mut self, least: f64) -> Result<Self, usize> {
        for i in 0..self.size() {
            let original = self.diagonal(i);
            let (above, here) = self.rows.split_at_mut(i);
            let row = &mut here[0];
            let fi = self.first[i];
            for j in fi..i {
                let fj = self.first[j];
                let from = fi.max(fj);
                let s = dot(&row[from - fi..j - fi], &above[j][from - fj..j - fj]);
                row[j - fi] = (row[j - fi] - s) / above[j][j - fj];
            }
            let last = i - fi;
            let pivot = row[last] - dot(&row[..last], &row[..last]);
            if !pivot.is_finite() || pivot <= least * original.abs() || pivot <= 0.0 {
                return Err(i);
            }
            row[last] = pivot.sqrt();
        }
        Ok(self)
    }

    /// Solves L Lᵀ x = b in place; this is a factor.
    pub fn solve(&self, b: &mut [f64]) {
        for i in 0..self.size() {
            let f = self.first[i];
            let last = i - f;
            b[i] = (b[i] - dot(&self.rows[i][..last], &b[f..i])) / self.rows[i][last];
        }
        for i in (0..self.size()).rev() {
            let f = self.first[i];
            let last = i - f;
            b[i] /= self.rows[i][last];
            let x = b[i];
            for (target, l) in b[f..i].iter_mut().zip(&self.rows[i][..last]) {
                *target -= l * x;
            }
        }
    }

    /// xᵀ M x of the symmetric matrix of which this is the lower triangle.
    pub fn quadratic(&self, x: &[f64]) -> f64 {
        let row = |i: usize| {
            let f = self.first[i];
            x[i] * (2.0 * dot(&self.rows[i][..i - f], &x[f..i]) + self.diagonal(i) * x[i])
        };
        (0..self.size()).map(row).sum()
    }

    /// Entries held.
    pub fn stored(&self) -> usize {
        self.rows.iter().map(Vec::len).sum()
    }
}

/// An order of the nodes of a graph in which neighbours stand near each other (reverse Cuthill–McKee, 1969).
pub fn order(neighbours: &[Vec<usize>]) -> Vec<usize> {
    let n = neighbours.len();
    let mut done = vec![false; n];
    let mut out = Vec::with_capacity(n);
    while out.len() < n {
        let far = |start: usize, done: &[bool]| -> usize {
            let (mut level, mut seen, mut last) = (vec![start], done.to_vec(), start);
            seen[start] = true;
            while !level.is_empty() {
                last = level.iter().copied().min_by_key(|i| (neighbours[*i].len(), *i)).unwrap_or(last);
                let mut next = Vec::new();
                for i in level {
                    for k in &neighbours[i] {
                        if !seen[*k] {
                            seen[*k] = true;
                            next.push(*k);
                        }
                    }
                }
                level = next;
            }
            last
        };
        let Some(start) = (0..n).filter(|i| !done[*i]).min_by_key(|i| (neighbours[*i].len(), *i)) else { break };
        let start = far(far(start, &done), &done);
        let begin = out.len();
        done[start] = true;
        out.push(start);
        let mut at = begin;
        while at < out.len() {
            let mut next: Vec<usize> = neighbours[out[at]].iter().copied().filter(|k| !done[*k]).collect();
            next.sort_by_key(|k| (neighbours[*k].len(), *k));
            for k in next {
                if !done[k] {
                    done[k] = true;
                    out.push(k);
                }
            }
            at += 1;
        }
    }
    out.reverse();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factor_solves() {
        // A banded matrix with an arrow at the end.
        let n = 9;
        let first: Vec<usize> = (0..n).map(|i: usize| if i == n - 1 { 0 } else { i.saturating_sub(2) }).collect();
        let mut m = Skyline::new(first.clone());
        let mut full = vec![vec![0.0; n]; n];
        for i in 0..n {
            for j in first[i]..=i {
                let v = if i == j { 10.0 + i as f64 } else { 1.0 / (1.0 + (i * 3 + j) as f64) };
                m.add(i, j, v);
                full[i][j] = v;
                full[j][i] = v;
            }
        }
        let x: Vec<f64> = (0..n).map(|i| (i as f64).sin()).collect();
        let mut b: Vec<f64> = full.iter().map(|r| dot(r, &x)).collect();
        assert!((m.quadratic(&x) - dot(&b, &x)).abs() < 1e-12);
        m.cholesky(1e-14).expect("positive definite").solve(&mut b);
        assert!(b.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn a_singular_matrix_is_noticed() {
        let mut m = Skyline::new(vec![0, 0]);
        for (i, j) in [(0, 0), (1, 0), (1, 1)] {
            m.add(i, j, 1.0);
        }
        assert_eq!(m.cholesky(1e-12).err(), Some(1));
    }

    #[test]
    fn the_order_makes_a_shuffled_line_narrow() {
        let shuffled = [4, 0, 7, 2, 6, 1, 3, 5];
        let mut neighbours = vec![Vec::new(); 8];
        for w in shuffled.windows(2) {
            neighbours[w[0]].push(w[1]);
            neighbours[w[1]].push(w[0]);
        }
        let order = order(&neighbours);
        let place = |k: usize| order.iter().position(|o| *o == k).expect("every node is there");
        assert!(shuffled.windows(2).all(|w| place(w[0]).abs_diff(place(w[1])) == 1), "{order:?}");
    }
}
