//! `manifest.json`: program, graph, inputs, machine, times, and statistics of nodes and links.

use super::{Outcome, RunReport};
use crate::{
    options::RunOptions,
    plan::Plan,
    plugin::with_late_loads,
    record::RecordError,
    recording::format::{FORMAT_VERSION, WireCounts},
};
use jiff::Timestamp;
use osteoflow_node::Role;
use serde_json::{Value as Json, json};
use std::time::{Duration, SystemTime};

/// The manifest of a finished run.
pub(crate) fn manifest(
    plan: &Plan,
    options: &RunOptions,
    report: &RunReport,
    recorded: Option<&Result<WireCounts, RecordError>>,
    inputs: &[Json],
    (began, ended): (SystemTime, SystemTime),
) -> Json {
    let outcome = match &report.outcome {
        Outcome::Complete | Outcome::Interrupted => json!({ "status": report.outcome.status() }),
        Outcome::Refused(r) => json!({
            "status": "refused", "node": r.node, "kind": r.kind, "item": r.item, "reason": r.reason,
            "panicked": r.panicked, "file": r.location.file.display().to_string(), "line": r.location.line,
        }),
    };
    let nodes = report.nodes.iter().zip(&plan.nodes).map(|(n, planned)| {
        json!({
            "name": n.name, "kind": planned.kind, "source": planned.role != Role::Node, "items": n.items, "skipped": n.skipped, "failed": n.failed, "busy_ms": ms(n.busy),
            "p50_ms": ms(n.p50), "p95_ms": ms(n.p95), "p99_ms": ms(n.p99),
        })
    });
    let links = report.links.iter().map(|l| {
        json!({
            "from": l.from, "to": l.to, "sent": l.sent, "received": l.received, "dropped": l.dropped,
            "late": l.late, "unmatched": l.unmatched, "highest_fill": l.highest_fill, "capacity": l.capacity,
        })
    });
    let latencies = report.latencies.iter().map(|l| {
        json!({
            "source": l.source, "sink": l.sink, "firings": l.firings, "p50_ms": ms(l.spread.p50),
            "p95_ms": ms(l.spread.p95), "p99_ms": ms(l.spread.p99), "max_ms": ms(l.spread.max),
        })
    });
    let contracts = report.contracts.iter().map(|c| {
        json!({
            "on": c.on, "of": c.kind.name(), "limit_ms": c.limit_ns as f64 / 1e6, "n": c.n, "broken": c.n_broken, "first": c.first,
            "p50_ms": ms(c.spread.p50), "p99_ms": ms(c.spread.p99), "max_ms": ms(c.spread.max),
        })
    });
    let enlargements =
        report.enlargements.iter().map(|e| json!({ "from": e.from, "to": e.to, "before": e.before, "after": e.after }));
    let warnings = report.warnings.iter().map(|w| json!({ "node": w.node, "item": w.item, "message": w.message }));
    let saved = report
        .saved
        .bundles
        .iter()
        .map(|b| json!({ "node": b.node, "item": b.item, "dir": b.dir.display().to_string() }));
    let not_saved = report.saved.more.iter().map(|(node, n)| json!({ "node": node, "failures": n }));
    let recording = recorded.map(|recorded| match recorded {
        Ok(counts) => {
            let wires = counts.0.iter();
            let wires = wires.map(|(wire, n)| json!({ "wire": wire, "items": n.items, "values": n.values }));
            json!({
                "format_version": FORMAT_VERSION,
                "sources": plan.recording.sources.name(),
                "compression": plan.recording.compression.name(),
                "wires": wires.collect::<Json>(),
            })
        }
        Err(error) => json!({ "error": error.to_string() }),
    });
    let cached_answers = report.cached_answers.iter().map(|r| json!({ "node": r.node, "item": r.item, "key": r.key }));
    let cached_answers = cached_answers.collect::<Json>();
    let store = options.store.as_ref();
    let store = store.map(|store| json!({ "dir": store.dir().display().to_string(), "recalled": cached_answers }));
    json!({
        "graph": { "name": plan.name, "file": plan.path.display().to_string(), "seed": plan.seed },
        "outcome": outcome,
        "began": rfc3339(began),
        "ended": rfc3339(ended),
        "elapsed_ms": ms(report.elapsed),
        "engine_version": env!("CARGO_PKG_VERSION"),
        "command": options.command,
        "workers": options.workers,
        "inputs": inputs,
        "plugins": with_late_loads(&plan.plugins),
        "nodes": nodes.collect::<Json>(),
        "links": links.collect::<Json>(),
        "latencies": latencies.collect::<Json>(),
        "contracts": contracts.collect::<Json>(),
        "enlargements": enlargements.collect::<Json>(),
        "warnings": warnings.collect::<Json>(),
        "recording": recording,
        "store": store,
        "injected": options.inject.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "repro": { "bundles": saved.collect::<Json>(), "not_saved": not_saved.collect::<Json>() },
        "resolved_graph": plan.resolved,
    })
}

fn ms(time: Duration) -> f64 {
    time.as_nanos() as f64 / 1e6
}

/// Formats a time as `2026-11-21T02:34:06.123Z`.
fn rfc3339(time: SystemTime) -> String {
    format!("{:.3}", Timestamp::try_from(time).unwrap_or(Timestamp::UNIX_EPOCH))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::UNIX_EPOCH;

    #[test]
    fn times_are_formatted_as_rfc_3339() {
        let at = |s: u64, ms: u32| rfc3339(UNIX_EPOCH + Duration::new(s, ms * 1_000_000));
        assert_eq!(at(0, 0), "1970-01-01T00:00:00.000Z");
        assert_eq!(rfc3339(UNIX_EPOCH + Duration::from_nanos(1_999_999)), "1970-01-01T00:00:00.001Z");
        assert_eq!(at(951_782_399, 5), "2000-02-28T23:59:59.005Z");
        assert_eq!(at(951_782_400, 0), "2000-02-29T00:00:00.000Z");
        assert_eq!(at(1_795_228_446, 120), "2026-11-21T02:34:06.120Z");
    }
}
