//! Disjoint sets (union-find) whose members carry signs.

/// Disjoint sets of the numbers below `n`, which is at most 2³¹. The root of a set is its lowest member.
///
/// Each member has a sign relative to the root: normals that must be flipped to agree have opposite signs. Sets
/// without signs are joined with `opposite = false`.
pub(crate) struct UnionFind {
    /// For each member twice a member nearer to the root, plus one if the two have opposite signs.
    parents: Vec<u32>,
}

impl UnionFind {
    pub(crate) fn new(n: usize) -> Self {
        Self { parents: (0..n as u32).map(|k| 2 * k).collect() }
    }

    /// The root of a member, and whether the two have opposite signs.
    #[inline]
    pub(crate) fn root(&mut self, k: u32) -> (u32, bool) {
        let at = self.find(k);
        (at / 2, at & 1 == 1)
    }

    /// Twice the root of a member, plus one if the two have opposite signs.
    #[inline]
    fn find(&mut self, k: u32) -> u32 {
        let mut at = 2 * k;
        loop {
            let next = self.parents[(at / 2) as usize];
            if next / 2 == at / 2 {
                return at;
            }
            // Path halving.
            let after = self.parents[(next / 2) as usize] ^ (next & 1);
            self.parents[(at / 2) as usize] = after;
            at = after ^ (at & 1);
        }
    }

    /// Joins the sets of two members, which get equal or opposite signs unless one set already holds both.
    #[inline]
    pub(crate) fn join(&mut self, i: u32, j: u32, opposite: bool) {
        let (a, b) = (self.find(i), self.find(j));
        let (lower, higher) = (a.min(b), a.max(b));
        if lower / 2 != higher / 2 {
            self.parents[(higher / 2) as usize] = lower ^ (higher & 1) ^ u32::from(opposite);
        }
    }

    /// Number of members of each set, at the index of its root; zero elsewhere.
    pub(crate) fn sizes(&mut self) -> Vec<u32> {
        let mut sizes = vec![0; self.parents.len()];
        for k in 0..self.parents.len() as u32 {
            sizes[self.root(k).0 as usize] += 1;
        }
        sizes
    }

    /// For each member the number of its set and whether its sign is opposite to the root's; and the number of sets.
    ///
    /// Sets are numbered in the order of their lowest members.
    pub(crate) fn labels(mut self) -> (Vec<(u32, bool)>, usize) {
        let (mut numbers, mut n_sets) = (vec![0; self.parents.len()], 0);
        let labels = (0..self.parents.len() as u32)
            .map(|k| {
                // A root is the lowest of its set, so it comes first.
                let (root, opposite) = self.root(k);
                if root == k {
                    numbers[k as usize] = n_sets;
                    n_sets += 1;
                }
                (numbers[root as usize], opposite)
            })
            .collect();
        (labels, n_sets as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_numbered_by_their_lowest_members_and_signs_multiply_along_the_joins() {
        let mut sets = UnionFind::new(6);
        sets.join(5, 1, true);
        sets.join(3, 5, true);
        sets.join(4, 3, true);
        sets.join(1, 4, true);
        assert_eq!(sets.root(4), (1, true));
        assert_eq!(sets.sizes(), [1, 4, 1, 0, 0, 0]);
        let (labels, n_sets) = sets.labels();
        assert_eq!(labels, [(0, false), (1, false), (2, false), (1, false), (1, true), (1, true)]);
        assert_eq!(n_sets, 3);
    }
}
