//! Another kind for a node of a recorded graph.
//!
//! A recorded graph states every parameter. Those that the user did not write go with their kind.

use crate::{
    graph::{
        keys_set,
        written::{remove_unwritten, sets_kind},
    },
    plan::Plan,
    recording::format::RunRecord,
};
use std::collections::{BTreeMap, BTreeSet};
use toml::Table;

/// A graph that states every parameter, without the defaults of kinds that `sets` exchange; `None` if they exchange none. `written`
/// has the parameters of each node that the user wrote.
pub(crate) fn without_old_defaults(
    text: &str,
    written: &BTreeMap<String, BTreeSet<String>>,
    sets: &[String],
) -> Option<String> {
    let mut graph: Table = text.parse().ok()?;
    let nodes = graph.get_mut("node")?.as_table_mut()?;
    let mut exchanged: Vec<_> =
        nodes.iter_mut().filter(|(name, _)| sets.iter().any(|set| sets_kind(set, name))).collect();
    if exchanged.is_empty() {
        return None;
    }
    for (name, node) in &mut exchanged {
        if let (Some(written), Some(node)) = (written.get(name.as_str()), node.as_table_mut()) {
            remove_unwritten(node, written);
        }
    }
    Some(graph.to_string())
}

/// In the plan of a recorded graph, which states all: only what the recorded user wrote, or a setting does, was written.
pub(super) fn keep_written(plan: &mut Plan, run: &RunRecord, sets: &[String]) {
    let set: Vec<String> = keys_set(sets).into_iter().map(|(key, _)| key.to_string()).collect();
    for node in &mut plan.nodes {
        let Some(written) = run.written.get(&*node.name) else { continue };
        let is_set = |key: &str| set.contains(&format!("{}.{key}", node.name));
        node.param_places.retain(|key, _| written.contains(key) || is_set(key));
    }
}
