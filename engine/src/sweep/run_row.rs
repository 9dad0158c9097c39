//! One run of a sweep: what other runs have left already is played, the rest is computed.

use crate::{
    partial::{self, FinishedNode, PartialRun},
    plan::Plan,
    run::{Finished, RunError, RunReport},
    runtime::{Ended, RunOptions},
};
use osteoflow_node::Registry;
use std::sync::Arc;

/// Runs a plan of whose nodes some have left their items already; answers its report, and what the others have left where
/// they and all before them came to their end.
pub(super) fn run(
    plan: &Plan,
    registry: &Registry,
    options: &RunOptions,
    shared: &[Option<Arc<FinishedNode>>],
) -> (Result<RunReport, RunError>, Vec<Option<FinishedNode>>) {
    let mut left = Vec::new();
    let mut see = |finished: Finished| {
        let sound = sound(plan, &finished.ended);
        let of_node = |index: usize| {
            let is_new = shared[index].is_none() && sound[index];
            is_new.then(|| FinishedNode::of(&finished, plan, index))
        };
        left = (0..plan.nodes.len()).map(of_node).collect();
        finished
    };
    let report = PartialRun::new(plan, shared).run(registry, options, &(), None, &mut see);
    (report, left)
}

/// For each node, whether it and all before it came to their end.
fn sound(plan: &Plan, ended: &Ended) -> Vec<bool> {
    let cut_short = ended.interrupted || ended.stall.is_some();
    let failed = |index| ended.failures.iter().any(|failure| failure.node == index);
    let mut unsound: Vec<bool> = (0..plan.nodes.len()).map(|index| cut_short || failed(index)).collect();
    partial::follow(plan, &mut unsound);
    unsound.into_iter().map(|unsound| !unsound).collect()
}
