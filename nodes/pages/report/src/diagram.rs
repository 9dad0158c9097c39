//! Diagrams of a plan and of a run, for `osteoflow-draw`.

use crate::format::{duration, percent};
use osteoflow_draw::{Diagram, Link, Node};
use osteoflow_engine::plan::{self, Plan, PlanOutput, PortFrames};
use osteoflow_node::Role;
use osteoflow_statistics::counted;
use serde_json::Value as Json;
use std::collections::BTreeMap;

/// The diagram of a checked graph: links are labelled with ports, payload and frames.
pub fn of_plan(plan: &Plan) -> Diagram {
    let nodes = plan.nodes.iter().map(|node| Node {
        name: node.name.to_string(),
        kind: node.kind.clone(),
        is_source: node.role != Role::Node,
        lines: node.deadline.iter().map(|deadline| format!("within {}", duration(deadline.ns as f64 / 1e6))).collect(),
        ..Node::default()
    });
    let links = plan.links.iter().map(|link| {
        let label = label(plan, link);
        let to = &plan.nodes[link.to_node];
        let input = &to.inputs[link.to_port].port;
        let ends = format!("{} -> {}.{}", plan.wire_name(link.from), to.name, input.name);
        let tooltip = format!("{ends}: {}, joined by {}", label[1..].join(", "), input.join.name());
        Link { from: link.from.node, to: link.to_node, label, dropped: 0, tooltip }
    });
    Diagram { title: plan.name.clone(), notes: Vec::new(), nodes: nodes.collect(), links: links.collect() }
}

/// Lines for the ports, the payload and its frames.
fn label(plan: &Plan, link: &plan::Link) -> Vec<String> {
    let output = &plan.nodes[link.from.node].outputs[link.from.port];
    let input = &plan.nodes[link.to_node].inputs[link.to_port].port;
    let ports =
        if output.name == input.name { output.name.clone() } else { format!("{} as {}", output.name, input.name) };
    let mut lines = vec![ports, output.payload.name().to_owned()];
    lines.extend(frames(output));
    let contract = &plan.nodes[link.to_node].inputs[link.to_port].contract;
    lines.extend(contract.max_age_ns.map(|ns| format!("at most {} old", duration(ns as f64 / 1e6))));
    lines.extend(contract.period_ns.map(|ns| format!("every {}", duration(ns as f64 / 1e6))));
    lines
}

/// `in ct`, or `world to ct` for a pose.
fn frames(output: &PlanOutput) -> Option<String> {
    match &output.frames {
        PortFrames { frame: Some(frame), .. } => Some(format!("in {frame}")),
        PortFrames { to: None, from: None, .. } => None,
        PortFrames { to, from, .. } => {
            let name = |frame: &Option<String>| frame.clone().unwrap_or_else(|| "?".into());
            Some(format!("{} to {}", name(from), name(to)))
        }
    }
}

/// The diagram of a run, from its `manifest.json` alone: times and counts on nodes and links.
///
/// # Errors
/// If the manifest lacks nodes, links or their names; the message says what is missing.
pub fn of_manifest(manifest: &Json) -> Result<Diagram, String> {
    let list = |key: &str| manifest[key].as_array().ok_or_else(|| format!("it has no list \"{key}\""));
    let (entries, links) = (list("nodes")?, list("links")?);
    let busy_ms: f64 = entries.iter().filter_map(|entry| entry["busy_ms"].as_f64()).sum();
    let outcome = &manifest["outcome"];
    let refusal = outcome["node"].as_str().map(|node| (node, outcome["reason"].as_str().unwrap_or_default()));
    let mut nodes = Vec::new();
    let mut index = BTreeMap::new();
    for entry in entries {
        let name = text(entry, "name")?;
        index.insert(name, nodes.len());
        let mut node = node(entry, name, busy_ms, refusal, &manifest["warnings"]);
        node.lines.extend(contracts(manifest, name));
        nodes.push(node);
    }
    // The names of nodes inside modules contain dots; the names of ports do not.
    let node_of = |end: &str| {
        let name = end.rsplit_once('.').map_or(end, |(node, _)| node);
        index.get(name).copied().ok_or_else(|| format!("its wire end {end} belongs to none of its nodes"))
    };
    let links = links.iter().map(|entry| {
        let (from, to) = (text(entry, "from")?, text(entry, "to")?);
        Ok(link(entry, (from, node_of(from)?), (to, node_of(to)?)))
    });
    let links = links.collect::<Result<_, String>>()?;
    let title = manifest["graph"]["name"].as_str().unwrap_or("run").to_owned();
    Ok(Diagram { title, notes: notes(manifest), nodes, links })
}

fn text<'a>(entry: &'a Json, key: &str) -> Result<&'a str, String> {
    entry[key].as_str().ok_or_else(|| format!("an entry of it has no text \"{key}\""))
}

fn node(entry: &Json, name: &str, busy_ms: f64, refusal: Option<(&str, &str)>, warnings: &Json) -> Node {
    let number = |key: &str| entry[key].as_f64().unwrap_or(0.0);
    let (own_ms, items) = (number("busy_ms"), number("items"));
    let share = if busy_ms > 0.0 { own_ms / busy_ms } else { 0.0 };
    let mut lines = vec![format!("{} \u{b7} {}", duration(own_ms), percent(share))];
    let counts = [("skipped", number("skipped")), ("failed", number("failed"))];
    let counts = counts.into_iter().filter(|(_, n)| *n > 0.0).map(|(what, n)| format!(", {n} {what}"));
    lines.push(counted(items as usize, "item") + &counts.collect::<String>());
    if items > 1.0 {
        lines.push(format!("p50 {}, p99 {}", duration(number("p50_ms")), duration(number("p99_ms"))));
    }
    let failure = match refusal {
        Some((refused, reason)) if refused == name => Some(reason.to_owned()),
        _ if number("failed") > 0.0 => {
            let warning = warnings.as_array().into_iter().flatten().find(|warning| warning["node"] == *name);
            let message = warning.and_then(|warning| warning["message"].as_str());
            Some(message.unwrap_or("see the manifest").to_owned())
        }
        _ => None,
    };
    Node {
        name: name.into(),
        kind: entry["kind"].as_str().unwrap_or_default().into(),
        is_source: entry["source"].as_bool().unwrap_or(false),
        lines,
        busy_share: Some(share),
        failure,
    }
}

/// How the contracts of time of a node and its inputs were kept.
fn contracts<'a>(manifest: &'a Json, name: &'a str) -> impl Iterator<Item = String> + 'a {
    let of_node = move |entry: &&Json| {
        let on = entry["on"].as_str().unwrap_or_default();
        on == name || entry["of"] == "age" && on.rsplit_once('.').is_some_and(|(node, _)| node == name)
    };
    manifest["contracts"].as_array().into_iter().flatten().filter(of_node).map(|entry| {
        let ms = |key: &str| duration(entry[key].as_f64().unwrap_or(0.0));
        let broken = entry["broken"].as_u64().filter(|n| *n > 0).map(|n| format!(", {n} above")).unwrap_or_default();
        format!("{} p99 {} of {}{broken}", entry["of"].as_str().unwrap_or_default(), ms("p99_ms"), ms("limit_ms"))
    })
}

fn link(entry: &Json, (from, from_node): (&str, usize), (to, to_node): (&str, usize)) -> Link {
    let count = |key: &str| entry[key].as_u64().unwrap_or(0);
    let (sent, received, dropped) = (count("sent"), count("received"), count("dropped"));
    let port = from.rsplit_once('.').map_or(from, |(_, port)| port);
    let mut label = format!("{port} {sent}");
    if dropped > 0 {
        label.push_str(&format!(", {dropped} dropped"));
    }
    let (fill, capacity, unmatched) = (count("highest_fill"), count("capacity"), count("unmatched"));
    let tooltip = format!(
        "{from} -> {to}: sent {sent}, received {received}, dropped {dropped}, unmatched {unmatched}, at most {fill} of \
         {capacity} waiting"
    );
    Link { from: from_node, to: to_node, label: vec![label], dropped, tooltip }
}

/// How the run ended, how long it took and when it began.
fn notes(manifest: &Json) -> Vec<String> {
    let outcome = &manifest["outcome"];
    let mut first = vec![outcome["status"].as_str().unwrap_or("unfinished").to_owned()];
    first.extend(manifest["elapsed_ms"].as_f64().map(|ms| format!("after {}", duration(ms))));
    first.extend(manifest["workers"].as_u64().map(|n| counted(n as usize, "worker")));
    first.extend(manifest["graph"]["seed"].as_u64().map(|seed| format!("seed {seed}")));
    first.extend(manifest["began"].as_str().map(str::to_owned));
    let mut lines = vec![first.join(", ")];
    if let (Some(node), Some(reason)) = (outcome["node"].as_str(), outcome["reason"].as_str()) {
        lines.push(format!("node \"{node}\": {reason}"));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_manifest_without_nodes_is_refused() {
        assert_eq!(of_manifest(&json!({ "nodes": [], "links": [] })).unwrap().notes, ["unfinished"]);
        assert!(of_manifest(&json!({})).is_err() && of_manifest(&json!([1])).is_err());
    }
}
