//! A set of item numbers, stored as ranges.

use std::{collections::BTreeMap, ops::RangeInclusive};

/// A set of numbers, stored as ranges: a wire without gaps takes one.
#[derive(Debug, Clone, Default)]
pub(crate) struct NumberSet {
    /// The last number of each range, by its first.
    ranges: BTreeMap<u64, u64>,
    n: u64,
}

impl NumberSet {
    /// Inserts a number in any order; false if it was present.
    pub(crate) fn insert(&mut self, number: u64) -> bool {
        let before = self.ranges.range(..=number).next_back().map(|(first, last)| (*first, *last));
        if before.is_some_and(|(_, last)| last >= number) {
            return false;
        }
        self.n += 1;
        let first = match before {
            Some((first, last)) if last.checked_add(1) == Some(number) => first,
            _ => number,
        };
        let last = number.checked_add(1).and_then(|next| self.ranges.remove(&next)).unwrap_or(number);
        self.ranges.insert(first, last);
        true
    }

    /// Count of numbers.
    pub(crate) fn len(&self) -> u64 {
        self.n
    }

    /// Count of numbers from 0 to the first gap.
    pub(crate) fn leading(&self) -> u64 {
        self.ranges.get(&0).map_or(0, |last| last.saturating_add(1))
    }

    /// The gaps between 0 and the largest number or, if that is more, `n_expected` numbers.
    pub(crate) fn missing(&self, n_expected: Option<u64>) -> Vec<RangeInclusive<u64>> {
        let mut gaps = Vec::new();
        let mut next = 0;
        for (&first, &last) in &self.ranges {
            if first > next {
                gaps.push(next..=first - 1);
            }
            next = last.saturating_add(1);
        }
        if let Some(n) = n_expected.filter(|n| *n > next) {
            gaps.push(next..=n - 1);
        }
        gaps
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ranges_agree_with_a_plain_set(numbers: Vec<u8>) {
            let (mut ranges, mut set) = (NumberSet::default(), std::collections::BTreeSet::new());
            for number in numbers {
                prop_assert_eq!(ranges.insert(number.into()), set.insert(u64::from(number)));
            }
            prop_assert_eq!(ranges.len(), set.len() as u64);
            let missing: Vec<u64> = ranges.missing(Some(300)).into_iter().flatten().collect();
            prop_assert_eq!(missing, (0..300).filter(|n| !set.contains(n)).collect::<Vec<u64>>());
            prop_assert_eq!(ranges.leading(), (0..).take_while(|n| set.contains(n)).count() as u64);
        }
    }
}
