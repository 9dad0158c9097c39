//! Stamps that run backwards within one stream of a file.

use osteoflow_geometry::StampNs;

/// Follows the stamps of one stream in the order of the file, and remembers where they run backwards.
///
/// A reader sorts items by their stamps, which hides a clock that was set back, a counter that began anew, or two recordings
/// joined in the wrong order; so it says so. Stamps of 0 belong to constants and have no order.
#[derive(Debug, Clone, Default)]
pub struct StampOrder {
    last_ns: StampNs,
    /// Place and stamps of the first item before its predecessor.
    first: Option<(String, StampNs, StampNs)>,
    n: usize,
}

impl StampOrder {
    /// Takes the stamp of the next item; `place` names it, such as `line 7`.
    pub fn take(&mut self, stamp_ns: StampNs, place: impl FnOnce() -> String) {
        if stamp_ns == 0 {
            return;
        }
        if stamp_ns < self.last_ns && self.last_ns != 0 {
            self.n += 1;
            self.first.get_or_insert_with(|| (place(), self.last_ns, stamp_ns));
        }
        self.last_ns = stamp_ns;
    }

    /// A warning, if the stamps of the stream ran backwards.
    pub fn note(&self, stream: &str) -> Option<String> {
        let (place, before_ns, after_ns) = self.first.as_ref()?;
        let times = if self.n == 1 { "once".to_owned() } else { format!("{} times", self.n) };
        Some(format!(
            "{stream}: stamps run backwards {times}, first at {place}: {after_ns} ns comes after {before_ns} ns; the items are \
             taken in the order of their stamps, so was a clock set back?"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_that_run_backwards_are_noted_once_with_place_and_count() {
        let note = |stamps: &[StampNs]| {
            let mut order = StampOrder::default();
            stamps.iter().enumerate().for_each(|(k, stamp_ns)| order.take(*stamp_ns, || format!("line {k}")));
            order.note("/tf")
        };
        assert_eq!(note(&[0, 5, 5, 6, 0, 7]), None, "equal stamps and constants are in order");
        let message = note(&[5, 9, 7, 8, 6]).unwrap();
        assert!(
            message.starts_with("/tf: stamps run backwards 2 times, first at line 2: 7 ns comes after 9 ns"),
            "{message}"
        );
    }
}
