//! How long the nodes of each run took. Times differ from run to run of the same sweep, so they are kept beside the results
//! and enter these only where a column asks for one.

use crate::{check::sweep::Column, partial::FinishedNode, plan::Plan, run::RunReport};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json, json};
use std::{sync::Arc, time::Duration};

/// The keys of times in the results.
pub(super) const OF_TIMES: [&str; 2] = ["nodes", "run"];

/// Times of a run and of its nodes, in milliseconds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunTimes {
    /// Number of the run.
    pub run: usize,
    /// From the first firing to the last.
    pub wall_ms: f64,
    /// The nodes, in the order of the graph.
    pub nodes: Vec<NodeTimes>,
}

/// Times of a node, in milliseconds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NodeTimes {
    /// The node.
    pub node: String,
    /// Its kind.
    pub kind: String,
    /// Where its items come from: `computed`, `shared` with another run, whose times these are, or from the `store`.
    pub from: String,
    /// Number of firings.
    pub firings: u64,
    /// Duration of its firings.
    pub busy_ms: f64,
    /// Their processor time, with that of its process; `None` where the system does not tell.
    pub cpu_ms: Option<f64>,
    /// From the beginning of its first firing to its end.
    pub wall_ms: f64,
}

fn ms(time: Duration) -> f64 {
    time.as_nanos() as f64 / 1e6
}

impl RunTimes {
    pub(super) fn of(run: usize, plan: &Plan, report: &RunReport, shared: &[Option<Arc<FinishedNode>>]) -> Self {
        let nodes = plan.nodes.iter().zip(&report.nodes).zip(shared).map(|((node, stats), shared)| {
            let recalled = report.cached_answers.iter().any(|answer| *answer.node == *node.name);
            let from = match shared {
                Some(_) => "shared",
                None if recalled => "store",
                None => "computed",
            };
            let (node, kind) = (node.name.to_string(), node.kind.to_string());
            let (busy_ms, cpu_ms, wall_ms) = (ms(stats.busy), stats.cpu.map(ms), ms(stats.wall));
            NodeTimes { node, kind, from: from.into(), firings: stats.items - stats.skipped, busy_ms, cpu_ms, wall_ms }
        });
        Self { run, wall_ms: ms(report.elapsed), nodes: nodes.collect() }
    }

    /// Sums over the nodes that this run computed itself: duration and processor time of firings.
    pub(super) fn sums(&self) -> (f64, Option<f64>) {
        let own = self.nodes.iter().filter(|node| node.from != "shared");
        own.fold((0.0, Some(0.0)), |(busy, cpu), node| {
            (busy + node.busy_ms, cpu.zip(node.cpu_ms).map(|(sum, cpu)| sum + cpu))
        })
    }

    /// Adds to the results what columns ask for: `nodes.NAME.cpu_ms`, `run.wall_ms`. A result of the graph with the same key stays.
    pub(super) fn add_to(&self, results: &mut Json, columns: &[Column]) {
        let Some(results) = results.as_object_mut() else { return };
        let asked = |key: &str| columns.iter().any(|column| column.path.split('.').next() == Some(key));
        if asked("nodes") && !results.contains_key("nodes") {
            let wanted = |node: &&NodeTimes| {
                columns.iter().any(|column| Column::node_of(&column.path).is_some_and(|(name, _)| name == node.node))
            };
            let of_node =
                |node: &NodeTimes| json!({ "busy_ms": node.busy_ms, "cpu_ms": node.cpu_ms, "wall_ms": node.wall_ms });
            let nodes: Map<_, _> = self.nodes.iter().filter(wanted).map(|n| (n.node.clone(), of_node(n))).collect();
            results.insert("nodes".into(), nodes.into());
        }
        if asked("run") && !results.contains_key("run") {
            let (busy_ms, cpu_ms) = self.sums();
            results.insert("run".into(), json!({ "busy_ms": busy_ms, "cpu_ms": cpu_ms, "wall_ms": self.wall_ms }));
        }
    }
}
