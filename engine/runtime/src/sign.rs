//! Signs that an input is wrong: the warnings that name a rule, as the `reasons` of `results.json` list them.

use crate::report::Warning;
use serde::{Deserialize, Serialize};

/// Maximum number of different signs listed per node; further ones are counted.
const MAX_PER_NODE: usize = 100;
/// Maximum number of different signs listed per rule of a node, so that a rule that finds one in every item hides no other rule.
const MAX_PER_RULE: usize = 10;
/// Rule of the entry that counts those that are not listed.
const MORE: &str = "more_signs";

/// A sign that an input is wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sign {
    /// The node that found it.
    pub node: String,
    /// The rule that it found it by.
    pub rule: String,
    /// The message.
    pub reason: String,
    /// Number of the activation, from 0; of equal ones the first.
    pub item: u64,
    /// How often the node gave it.
    pub n: u64,
}

impl Warning {
    /// The sign that the warning is, if it names a rule.
    pub fn sign(&self) -> Option<Sign> {
        let (reason, rule) = osteoflow_node::sign(&self.message)?;
        let Self { node, item, .. } = self.clone();
        Some(Sign { node, rule: rule.into(), reason: reason.into(), item, n: 1 })
    }
}

/// The signs of a node, each once, in the order of its firings.
#[derive(Default, Clone)]
pub(crate) struct Signs {
    listed: Vec<Sign>,
    /// Counts those that are not listed; its item is that of the first.
    more: Option<Sign>,
}

impl Signs {
    pub(crate) fn add(&mut self, sign: Sign) {
        let n_of_rule = self.listed.iter().filter(|listed| listed.rule == sign.rule).count();
        if let Some(equal) =
            self.listed.iter_mut().find(|listed| (&listed.rule, &listed.reason) == (&sign.rule, &sign.reason))
        {
            equal.n += 1;
        } else if n_of_rule < MAX_PER_RULE && self.listed.len() < MAX_PER_NODE {
            self.listed.push(sign);
        } else {
            self.more.get_or_insert(Sign { rule: MORE.into(), n: 0, ..sign }).n += 1;
        }
    }

    /// The listed signs, then one that counts the others.
    pub(crate) fn finish(self) -> impl Iterator<Item = Sign> {
        let reason = |n| format!("{n} more signs of this node are counted and not listed");
        self.listed.into_iter().chain(self.more.map(|more| Sign { reason: reason(more.n), ..more }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signs(given: impl Iterator<Item = (&'static str, String)>) -> Vec<Sign> {
        let mut signs = Signs::default();
        for ((rule, message), item) in given.zip(0..) {
            let warning = Warning { node: "scan".into(), item, message: format!("{message} [{rule}]") };
            signs.add(warning.sign().unwrap());
        }
        signs.finish().collect()
    }

    #[test]
    fn equal_signs_are_listed_once_with_the_item_of_the_first_and_their_number() {
        let all =
            signs([("a_b", "x"), ("c_d", "x"), ("a_b", "y"), ("a_b", "x")].map(|(r, m)| (r, m.into())).into_iter());
        let got: Vec<_> = all.iter().map(|s| (&*s.rule, &*s.reason, s.item, s.n)).collect();
        assert_eq!(got, [("a_b", "x", 0, 2), ("c_d", "x", 1, 1), ("a_b", "y", 2, 1)]);
    }

    #[test]
    fn a_rule_that_finds_another_sign_in_every_item_is_bounded_and_hides_no_other_rule() {
        let noisy = (0..5000).map(|k| ("marker_jump", format!("it jumped at sample {k}")));
        let all = signs(noisy.chain([("stamp_unit", "the stamps are in ms".to_owned())]));
        assert_eq!(all.len(), MAX_PER_RULE + 2);
        assert_eq!((&*all[MAX_PER_RULE].rule, all[MAX_PER_RULE].item), ("stamp_unit", 5000));
        let more = all.last().unwrap();
        assert_eq!((&*more.rule, more.n, more.item), (MORE, 4990, 10));
        assert_eq!(more.reason, "4990 more signs of this node are counted and not listed");
        assert_eq!(all.iter().map(|sign| sign.n).sum::<u64>(), 5001, "each is listed or counted");
    }

    #[test]
    fn a_warning_that_names_no_rule_is_no_sign() {
        let sign = |message: &str| Warning { node: "scan".into(), item: 0, message: message.into() }.sign();
        for message in [
            "",
            "[]",
            "[marker_jump]",
            "x [marker jump]",
            "lengths are in [mm]",
            "take it out of [record]",
            "x[marker_jump]",
            "x [_]",
            "x [Marker_Jump]",
        ] {
            assert_eq!(sign(message), None, "{message}");
        }
        let found = sign("it jumped [mm] [marker_jump]").unwrap();
        assert_eq!((&*found.reason, &*found.rule), ("it jumped [mm]", "marker_jump"));
    }
}
