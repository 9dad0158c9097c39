//! One run of a sweep: plays the nodes shared with earlier runs and computes the others.

use crate::{
    options::RunOptions,
    partial::{FinishedNode, PartialRun},
    plan::Plan,
    run::{Finished, RunError, RunReport},
    runtime::RunOutcome,
};
use osteoflow_node::Registry;
use std::sync::Arc;

/// Runs a plan with some finished nodes. Returns the report, and the items of the nodes that ended without failure, as
/// did all nodes upstream.
pub(super) fn run(
    plan: &Plan,
    registry: &Registry,
    options: &RunOptions,
    shared: &[Option<Arc<FinishedNode>>],
) -> (Result<RunReport, RunError>, Vec<Option<FinishedNode>>) {
    let mut left = Vec::new();
    let mut see = |finished: Finished| {
        let succeeded = succeeded(plan, &finished.ended);
        let of_node = |index: usize| {
            let is_new = shared[index].is_none() && succeeded[index];
            is_new.then(|| FinishedNode::of(&finished, plan, index))
        };
        left = (0..plan.nodes.len()).map(of_node).collect();
        finished
    };
    let report = PartialRun::new(plan, shared).run(registry, options, &(), None, &mut see);
    (report, left)
}

/// Whether each node and all nodes upstream ended without failure.
fn succeeded(plan: &Plan, ended: &RunOutcome) -> Vec<bool> {
    let cut_short = ended.interrupted || ended.stall.is_some();
    let failed = |index| ended.failures.iter().any(|failure| failure.node == index);
    let mut affected: Vec<bool> = (0..plan.nodes.len()).map(|index| cut_short || failed(index)).collect();
    plan.mark_downstream(&mut affected);
    affected.into_iter().map(|affected| !affected).collect()
}
