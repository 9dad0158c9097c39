//! Warnings and failures of nodes, limited in number per node.

use crate::{
    plan::Plan,
    report::{Failure, Warning},
    sign::{Sign, Signs},
};

/// Maximum number of warnings listed per node, and of failures after which the node went on; further ones are counted.
/// Otherwise a node that warns at every item would fill the memory in a long run.
const MAX_PER_NODE: u64 = 100;

/// Warnings, signs and failures of a run in progress.
pub(crate) struct Messages {
    warnings: Vec<(usize, Warning)>,
    failures: Vec<Failure>,
    nodes: Vec<Counts>,
}

#[derive(Default, Clone)]
struct Counts {
    warned: u64,
    failed: u64,
    /// The last item whose warning was not listed.
    last_warned: u64,
    /// The latest failure that is only counted; the node's last empty gives it as its reason.
    latest: Option<Failure>,
    signs: Signs,
}

impl Messages {
    pub(crate) fn new(n_nodes: usize) -> Self {
        Self { warnings: Vec::new(), failures: Vec::new(), nodes: vec![Counts::default(); n_nodes] }
    }

    pub(crate) fn warning(&mut self, node: usize, warning: Warning) {
        let counts = &mut self.nodes[node];
        if let Some(sign) = warning.sign() {
            counts.signs.add(sign);
        }
        counts.warned += 1;
        if counts.warned <= MAX_PER_NODE {
            self.warnings.push((node, warning));
        } else {
            counts.last_warned = warning.item;
        }
    }

    pub(crate) fn failure(&mut self, failure: Failure) {
        let counts = &mut self.nodes[failure.node];
        counts.failed += 1;
        if counts.failed <= MAX_PER_NODE || !failure.skipped {
            self.failures.push(failure);
        } else {
            counts.latest = Some(failure);
        }
    }

    /// Failures in the order of the plan, not of time: the first is the same on any number of workers. Where messages
    /// were left out, a last warning or sign gives their number.
    pub(crate) fn finish(mut self, plan: &Plan) -> (Vec<Failure>, Vec<(usize, Warning)>, Vec<Sign>) {
        let mut signs = Vec::new();
        for (node, counts) in self.nodes.into_iter().enumerate() {
            signs.extend(counts.signs.finish());
            let mut more = |n: u64, item: u64, what: &str| {
                let message = format!("{n} more {what} of this node are counted and not listed");
                self.warnings.push((node, Warning { node: plan.nodes[node].name.to_string(), item, message }));
            };
            if counts.warned > MAX_PER_NODE {
                more(counts.warned - MAX_PER_NODE, counts.last_warned, "warnings");
            }
            if let Some(latest) = counts.latest {
                // `latest` itself is listed.
                let n = counts.failed - MAX_PER_NODE - 1;
                if n > 0 {
                    more(n, latest.item, "failures");
                }
                self.failures.push(latest);
            }
        }
        self.failures.sort_by_key(|failure| (failure.node, failure.item));
        (self.failures, self.warnings, signs)
    }
}
