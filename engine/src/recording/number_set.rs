//! Which numbers of a wire have come, in whatever order.

use std::{collections::BTreeMap, ops::RangeInclusive};

/// A set of numbers as runs, so that a wire without holes costs one.
#[derive(Debug, Clone, Default)]
pub(crate) struct Numbers {
    /// The first number of each run, and its last.
    runs: BTreeMap<u64, u64>,
    n: u64,
}

impl Numbers {
    /// Takes a number; false if it was there.
    pub(crate) fn insert(&mut self, number: u64) -> bool {
        let before = self.runs.range(..=number).next_back().map(|(first, last)| (*first, *last));
        if before.is_some_and(|(_, last)| last >= number) {
            return false;
        }
        self.n += 1;
        let first = match before {
            Some((first, last)) if last.checked_add(1) == Some(number) => first,
            _ => number,
        };
        let last = number.checked_add(1).and_then(|next| self.runs.remove(&next)).unwrap_or(number);
        self.runs.insert(first, last);
        true
    }

    /// How many there are.
    pub(crate) fn len(&self) -> u64 {
        self.n
    }

    /// How many there are from 0 to the first hole.
    pub(crate) fn leading(&self) -> u64 {
        self.runs.get(&0).map_or(0, |last| last.saturating_add(1))
    }

    /// The holes from 0 to the largest number, and from there up to `n_expected`.
    pub(crate) fn missing(&self, n_expected: Option<u64>) -> Vec<RangeInclusive<u64>> {
        let mut holes = Vec::new();
        let mut next = 0;
        for (&first, &last) in &self.runs {
            if first > next {
                holes.push(next..=first - 1);
            }
            next = last.saturating_add(1);
        }
        if let Some(n) = n_expected.filter(|n| *n > next) {
            holes.push(next..=n - 1);
        }
        holes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_hold_what_a_set_holds(numbers: Vec<u8>) {
            let (mut runs, mut set) = (Numbers::default(), std::collections::BTreeSet::new());
            for number in numbers {
                prop_assert_eq!(runs.insert(number.into()), set.insert(u64::from(number)));
            }
            prop_assert_eq!(runs.len(), set.len() as u64);
            let missing: Vec<u64> = runs.missing(Some(300)).into_iter().flatten().collect();
            prop_assert_eq!(missing, (0..300).filter(|n| !set.contains(n)).collect::<Vec<u64>>());
            prop_assert_eq!(runs.leading(), (0..).take_while(|n| set.contains(n)).count() as u64);
        }
    }
}
