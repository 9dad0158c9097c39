//! What `--verbose` shows of a run: where the time went, and what went over the wires.

use super::text_table::TextTable;
use osteoflow_engine::run::RunReport;
use std::{collections::BTreeMap, time::Duration};

/// A table of nodes and a table of links, both in the order of the plan.
pub(crate) fn text(report: &RunReport) -> String {
    let mut nodes = TextTable::new("nodes", &["items", "skipped", "failed", "busy ms", "p50", "p95", "p99 ms"]);
    for n in &report.nodes {
        let counts = [n.items, n.skipped, n.failed].map(|count| count.to_string());
        nodes.row(&n.name, counts.into_iter().chain([n.busy, n.p50, n.p95, n.p99].map(ms)));
    }
    let mut links = TextTable::new("wires", &["sent", "received", "dropped", "highest fill", "capacity"]);
    for l in &report.links {
        let counts = [l.sent, l.received, l.dropped, l.highest_fill as u64, l.capacity as u64];
        let remark = (l.unmatched > 0).then(|| format!("{} without a partner", l.unmatched));
        links.row(format!("{} -> {}", l.from, l.to), counts.iter().map(u64::to_string).chain(remark));
    }
    let mut text = format!("{}\n{}", nodes.lines(), links.lines());
    // A queue grows in steps; how far it grew is what matters.
    let mut grown: BTreeMap<(&str, &str), (usize, usize)> = BTreeMap::new();
    for e in &report.enlargements {
        grown.entry((&e.from, &e.to)).or_insert((e.before, e.after)).1 = e.after;
    }
    for ((from, to), (before, after)) in grown {
        text.push_str(&format!("enlarged: {from} -> {to} from {before} to {after} items\n"));
    }
    text
}

fn ms(time: Duration) -> String {
    format!("{:.2}", time.as_secs_f64() * 1e3)
}
