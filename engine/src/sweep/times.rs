//! How long the nodes of each run took. Times differ from run to run of the same sweep, so they are kept beside the results
//! and enter these only where a column asks for one.

use super::{
    folder::{Folder, FolderError, TIMES},
    table::{cell, names},
};
use crate::{
    check::sweep::{Column, Spec},
    partial::FinishedNode,
    plan::Plan,
    run::RunReport,
};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json, json};
use std::{io::Write, sync::Arc, time::Duration};

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
    fn sums(&self) -> (f64, Option<f64>) {
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

/// Writes `times.csv`: run, factors, repeat, draws, seed, and for each node its kind, where its items come from, firings and times; the row
/// without a node is the run's, with the sums over the nodes that it computed.
///
/// # Errors
/// If a run cannot be read or the table cannot be written.
pub(super) fn write_times(folder: &Folder, spec: &Spec, out: impl Write) -> Result<(), FolderError> {
    let mut table = csv::Writer::from_writer(out);
    let failed = |error: csv::Error| folder.cannot_write(TIMES, error);
    let head = ["run"].into_iter().chain(names(spec)).chain(["seed", "node", "kind", "from", "firings"]);
    table.write_record(head.chain(["busy_ms", "cpu_ms", "wall_ms"])).map_err(failed)?;
    for done in folder.done()? {
        let done = done?;
        let Some(times) = folder.times(done.run)? else { continue };
        let mut own = vec![done.run.to_string()];
        own.extend(names(spec).map(|name| done.value(name).map(cell).unwrap_or_default()));
        own.push(done.seed.to_string());
        let mut row = |of: [&str; 4], times: [Option<f64>; 3]| {
            let times = times.map(|time| time.map(|time| Json::from(time).to_string()).unwrap_or_default());
            let row = own.iter().map(String::as_str).chain(of).chain(times.iter().map(String::as_str));
            table.write_record(row).map_err(failed)
        };
        let (busy_ms, cpu_ms) = times.sums();
        row(["", "", "", ""], [Some(busy_ms), cpu_ms, Some(times.wall_ms)])?;
        for node in &times.nodes {
            let firings = node.firings.to_string();
            let measured = [Some(node.busy_ms), node.cpu_ms, Some(node.wall_ms)];
            row([&node.node, &node.kind, &node.from, &firings], measured)?;
        }
    }
    table.flush().map_err(|error| folder.cannot_write(TIMES, error))
}
