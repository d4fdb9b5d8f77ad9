//! Sets that are united two by two (R. E. Tarjan, "Efficiency of a good but not linear set union algorithm", 1975, with
//! path halving). The segmentation and the merging of regions carry more with each set and have their own.

/// Sets of the numbers below n. The least number of a set is its root.
#[derive(Default)]
pub struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    /// Each of `n` numbers in a set of its own.
    ///
    /// # Panics
    ///
    /// From 2³² numbers on.
    pub fn apart(n: usize) -> Sets {
        Sets { parent: (0..u32::try_from(n).expect("fewer than 2^32 numbers")).collect() }
    }

    /// Adds the next number in a set of its own.
    ///
    /// # Panics
    ///
    /// After 2³² numbers.
    pub fn add(&mut self) {
        self.parent.push(u32::try_from(self.parent.len()).expect("fewer than 2^32 numbers"));
    }

    /// The least number of the set of `i`.
    ///
    /// # Panics
    ///
    /// Where there is no number `i`.
    pub fn root(&mut self, i: usize) -> usize {
        let mut i = i as u32;
        while self.parent[i as usize] != i {
            let above = self.parent[self.parent[i as usize] as usize];
            self.parent[i as usize] = above;
            i = above;
        }
        i as usize
    }

    /// Makes one set of those of `a` and `b`.
    ///
    /// # Panics
    ///
    /// Where there is no such number.
    pub fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b)] = a.min(b) as u32;
    }

    /// The root of every number.
    pub fn roots(mut self) -> Vec<u32> {
        // A parent has the smaller number: it is settled before its children.
        for i in 0..self.parent.len() {
            self.parent[i] = self.parent[self.parent[i] as usize];
        }
        self.parent
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sets_are_those_of_a_flood(pairs in prop::collection::vec((0usize..40, 0usize..40), 0..60)) {
            let mut sets = Sets::default();
            (0..40).for_each(|_| sets.add());
            pairs.iter().for_each(|(a, b)| sets.unite(*a, *b));
            let mut flood: Vec<u32> = (0..40).collect();
            for _ in 0..40 {
                for &(a, b) in &pairs {
                    let least = flood[a].min(flood[b]);
                    (flood[a], flood[b]) = (least, least);
                }
            }
            let one_by_one: Vec<u32> = (0..40).map(|i| sets.root(i) as u32).collect();
            prop_assert_eq!(&one_by_one, &flood);
            prop_assert_eq!(sets.roots(), flood);
        }
    }
}
