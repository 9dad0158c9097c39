//! The output of `--verbose`: times of nodes and counts of wires.

use super::text_table::TextTable;
use osteoflow_engine::run::RunReport;
use osteoflow_report::format::{duration, percent};
use std::{collections::BTreeMap, time::Duration};

/// A table of nodes and a table of links, both in the order of the plan.
pub(crate) fn text(report: &RunReport) -> String {
    let header = ["busy", "share", "items", "skipped", "failed", "p50", "p95", "p99"];
    let mut nodes = TextTable::new("nodes", &header);
    let busy: f64 = report.nodes.iter().map(|n| n.busy.as_secs_f64()).sum();
    let slowest = report.nodes.iter().map(|n| n.busy).max().unwrap_or_default();
    for n in &report.nodes {
        let share = if busy > 0.0 { n.busy.as_secs_f64() / busy } else { 0.0 };
        let counts = [n.items, n.skipped, n.failed].map(counted);
        let cells = [time(n.busy), percent(share)].into_iter().chain(counts).chain([n.p50, n.p95, n.p99].map(time));
        let mark = (n.busy == slowest && !slowest.is_zero()).then(|| "<- slowest".into());
        nodes.row(&n.name, cells.chain(mark));
    }
    let mut links = TextTable::new("wires", &["sent", "received", "dropped", "highest fill"]);
    for l in &report.links {
        let counts = [l.sent, l.received, l.dropped].map(counted);
        let fill = format!("{} of {}", l.highest_fill, l.capacity);
        let remark = (l.unmatched > 0).then(|| format!("{} unmatched", l.unmatched));
        links.row(format!("{} -> {}", l.from, l.to), counts.into_iter().chain([fill]).chain(remark));
    }
    let mut text = format!("{}\n{}", nodes.lines(), links.lines());
    if !report.latencies.is_empty() {
        let mut latencies = TextTable::new("from source to sink", &["firings", "p50", "p95", "p99", "longest"]);
        for l in &report.latencies {
            let spread = [l.spread.p50, l.spread.p95, l.spread.p99, l.spread.max].map(time);
            latencies.row(format!("{} -> {}", l.source, l.sink), [counted(l.firings)].into_iter().chain(spread));
        }
        text.push_str(&format!("\n{}", latencies.lines()));
    }
    if !report.contracts.is_empty() {
        text.push_str(&format!("\n{}", contracts(report)));
    }
    // A queue grows in steps; only its final capacity matters.
    let mut grown: BTreeMap<(&str, &str), (usize, usize)> = BTreeMap::new();
    for e in &report.enlargements {
        grown.entry((&e.from, &e.to)).or_insert((e.before, e.after)).1 = e.after;
    }
    for ((from, to), (before, after)) in grown {
        text.push_str(&format!("enlarged: {from} -> {to} from {before} to {after} items\n"));
    }
    for r in &report.cached_answers {
        text.push_str(&format!("from the store: node \"{}\", item {}\n", r.node, r.item));
    }
    text
}

/// How the contracts of time were kept.
pub(crate) fn contracts(report: &RunReport) -> String {
    let mut contracts = TextTable::new("contracts of time", &["", "allowed", "broken", "of", "p50", "p99", "longest"]);
    for c in &report.contracts {
        let counts = [c.n_broken, c.n].map(counted);
        let spread = [c.spread.p50, c.spread.p99, c.spread.max].map(time);
        let limit = time(Duration::from_nanos(c.limit_ns.unsigned_abs()));
        contracts.row(&c.on, [c.kind.name().to_owned(), limit].into_iter().chain(counts).chain(spread));
    }
    contracts.lines()
}

fn time(time: Duration) -> String {
    duration(time.as_secs_f64() * 1e3)
}

/// A count, or a dash for zero.
fn counted(count: u64) -> String {
    if count == 0 { "-".into() } else { count.to_string() }
}
