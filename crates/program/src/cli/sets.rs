//! Sets that are united two by two.

/// Sets of the numbers below n. The least number of a set is its root.
pub struct Sets {
    parent: Vec<usize>,
}

impl Sets {
    /// Each of `n` numbers in a set of its own.
    pub fn apart(n: usize) -> Sets {
        Sets { parent: (0..n).collect() }
    }

    pub fn root(&mut self, mut i: usize) -> usize {
        while self.parent[i] != i {
            self.parent[i] = self.parent[self.parent[i]];
            i = self.parent[i];
        }
        i
    }

    /// Makes one set of those of `a` and `b`.
    pub fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b)] = a.min(b);
    }
}
