//! Messages about nodes for viewers, limited in number.

use crate::recording::format::LogLevel;
use osteoflow_node::StampNs;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of messages of a node and level; a node that warns at every item would fill the file.
const MAX_PER_NODE: usize = 100;

/// A message of a node.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LogEntry {
    /// Index into the plan; `None` for the run itself.
    pub(crate) node: Option<usize>,
    /// Number of the activation, from 0.
    pub(crate) item: u64,
    /// When it is shown; `None`: at the latest time of the recording.
    pub(crate) stamp_ns: Option<StampNs>,
    pub(crate) level: LogLevel,
    pub(crate) message: String,
}

/// Passes each message once, and of a node and level at most [`MAX_PER_NODE`].
#[derive(Debug, Default)]
pub(super) struct LogFilter {
    seen: BTreeMap<(Option<usize>, LogLevel), Messages>,
}

/// Messages with the number of their activation.
type Messages = BTreeSet<(u64, String)>;

impl LogFilter {
    /// The message to write, if any. The last of a node says that more are left out.
    pub(super) fn pass(&mut self, entry: LogEntry) -> Option<LogEntry> {
        let seen = self.seen.entry((entry.node, entry.level)).or_default();
        if seen.len() > MAX_PER_NODE || !seen.insert((entry.item, entry.message.clone())) {
            return None;
        }
        if seen.len() <= MAX_PER_NODE {
            return Some(entry);
        }
        Some(LogEntry { message: "further messages of this node are not listed here".into(), ..entry })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_passes_once_and_a_node_that_warns_at_every_item_is_cut_short() {
        let mut filter = LogFilter::default();
        let entry = |node, item| LogEntry {
            node: Some(node),
            item,
            stamp_ns: None,
            level: LogLevel::Warning,
            message: "lost".into(),
        };
        assert_eq!(filter.pass(entry(0, 7)), Some(entry(0, 7)));
        assert_eq!(filter.pass(entry(0, 7)), None);
        let passed: Vec<_> = (0..1000).filter_map(|item| filter.pass(entry(1, item))).collect();
        assert_eq!(passed.len(), MAX_PER_NODE + 1);
        assert!(passed[MAX_PER_NODE].message.contains("not listed"));
        assert_eq!(filter.pass(entry(2, 0)), Some(entry(2, 0)));
    }
}
