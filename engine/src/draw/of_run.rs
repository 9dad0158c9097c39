//! The picture of a run, from its manifest alone: neither its graph file nor its kinds need be there.

use super::{Node, Picture, Wire};
use serde_json::Value as Json;
use std::collections::BTreeMap;

impl Picture {
    /// The picture of a run, from its `manifest.json`.
    ///
    /// # Errors
    /// What the manifest lacks.
    pub fn of_run(manifest: &Json) -> Result<Self, String> {
        let list = |key: &str| manifest[key].as_array().ok_or_else(|| format!("it has no list \"{key}\""));
        let (nodes, links) = (list("nodes")?, list("links")?);
        let busy: f64 = nodes.iter().filter_map(|node| node["busy_ms"].as_f64()).sum();
        let outcome = &manifest["outcome"];
        let refused = outcome["node"].as_str().map(|node| (node, outcome["reason"].as_str().unwrap_or_default()));
        let mut pictured = Vec::new();
        let mut index = BTreeMap::new();
        for node in nodes {
            let name = text(node, "name")?;
            index.insert(name, pictured.len());
            pictured.push(self::node(node, name, busy, refused, &manifest["warnings"]));
        }
        // Node names may hold dots, as those of modules do; a port's may not.
        let node_of = |end: &str| {
            let name = end.rsplit_once('.').map_or(end, |(node, _)| node);
            index.get(name).copied().ok_or_else(|| format!("its wire end {end} belongs to none of its nodes"))
        };
        let mut wires = Vec::new();
        for link in links {
            let (from, to) = (text(link, "from")?, text(link, "to")?);
            wires.push(wire(link, (from, node_of(from)?), (to, node_of(to)?)));
        }
        let name = manifest["graph"]["name"].as_str().unwrap_or("run").to_owned();
        Ok(Self { name, about: about(manifest), nodes: pictured, wires })
    }
}

fn text<'a>(of: &'a Json, key: &str) -> Result<&'a str, String> {
    of[key].as_str().ok_or_else(|| format!("an entry of it has no text \"{key}\""))
}

fn node(node: &Json, name: &str, busy: f64, refused: Option<(&str, &str)>, warnings: &Json) -> Node {
    let number = |key: &str| node[key].as_f64().unwrap_or(0.0);
    let (own, items) = (number("busy_ms"), number("items"));
    let share = if busy > 0.0 { own / busy } else { 0.0 };
    let mut figures = vec![format!("{} \u{b7} {}", time(own), percent(share))];
    let counts = [("skipped", number("skipped")), ("failed", number("failed"))];
    let counts = counts.into_iter().filter(|(_, n)| *n > 0.0).map(|(what, n)| format!(", {n} {what}"));
    figures.push(format!("{} {}{}", items, plural(items, "item"), counts.collect::<String>()));
    if items > 1.0 {
        figures.push(format!("p50 {}, p99 {}", time(number("p50_ms")), time(number("p99_ms"))));
    }
    let said = warnings.as_array().into_iter().flatten().find(|w| w["node"] == *name && number("failed") > 0.0);
    let failed = match refused {
        Some((refused, reason)) if refused == name => Some(reason.to_owned()),
        _ if number("failed") > 0.0 => {
            Some(said.and_then(|w| w["message"].as_str()).unwrap_or("see the manifest").to_owned())
        }
        _ => None,
    };
    Node {
        name: name.into(),
        kind: node["kind"].as_str().unwrap_or_default().into(),
        is_source: node["source"].as_bool().unwrap_or(false),
        figures,
        share: Some(share),
        failed,
    }
}

fn wire(link: &Json, (from, from_node): (&str, usize), (to, to_node): (&str, usize)) -> Wire {
    let count = |key: &str| link[key].as_u64().unwrap_or(0);
    let (sent, received, dropped) = (count("sent"), count("received"), count("dropped"));
    let port = from.rsplit_once('.').map_or(from, |(_, port)| port);
    let mut label = format!("{port} {sent}");
    if dropped > 0 {
        label.push_str(&format!(", {dropped} dropped"));
    }
    let (fill, capacity, unmatched) = (count("highest_fill"), count("capacity"), count("unmatched"));
    let about = format!(
        "{from} -> {to}: sent {sent}, received {received}, dropped {dropped}, without a partner {unmatched}, at most \
         {fill} of {capacity} waiting"
    );
    Wire { from: from_node, to: to_node, label: vec![label], dropped, about }
}

/// When, how long and how it ended.
fn about(manifest: &Json) -> Vec<String> {
    let outcome = &manifest["outcome"];
    let mut first = vec![outcome["status"].as_str().unwrap_or("unfinished").to_owned()];
    first.extend(manifest["elapsed_ms"].as_f64().map(|ms| format!("after {}", time(ms))));
    first.extend(manifest["workers"].as_u64().map(|n| format!("{n} {}", plural(n as f64, "worker"))));
    first.extend(manifest["graph"]["seed"].as_u64().map(|seed| format!("seed {seed}")));
    first.extend(manifest["began"].as_str().map(str::to_owned));
    let mut lines = vec![first.join(", ")];
    if let (Some(node), Some(reason)) = (outcome["node"].as_str(), outcome["reason"].as_str()) {
        lines.push(format!("node \"{node}\": {reason}"));
    }
    lines
}

fn plural(n: f64, word: &str) -> String {
    if n == 1.0 { word.into() } else { format!("{word}s") }
}

/// A time in milliseconds, told in the unit that suits it: three digits that count.
pub fn time(ms: f64) -> String {
    let digits = |value: f64| match value {
        v if v >= 99.95 => format!("{v:.0}"),
        v if v >= 9.995 => format!("{v:.1}"),
        v => format!("{v:.2}"),
    };
    match ms {
        0.0 => "0 s".into(),
        ms if ms < 0.0009995 => format!("{:.0} ns", ms * 1e6),
        ms if ms < 0.9995 => format!("{} \u{b5}s", digits(ms * 1e3)),
        ms if ms < 999.5 => format!("{} ms", digits(ms)),
        ms => format!("{} s", digits(ms / 1e3)),
    }
}

/// A share in percent.
pub fn percent(share: f64) -> String {
    match share * 100.0 {
        0.0 => "0 %".into(),
        p if p < 0.1 => "< 0.1 %".into(),
        p if p < 9.95 => format!("{p:.1} %"),
        p => format!("{p:.0} %"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_shares_are_told_with_few_digits() {
        let told: Vec<_> = [0.0, 0.00012, 0.0123, 0.9994, 1.0, 12.345, 412.6, 999.7, 61_234.0].map(time).into();
        let expected =
            ["0 s", "120 ns", "12.3 \u{b5}s", "999 \u{b5}s", "1.00 ms", "12.3 ms", "413 ms", "1.00 s", "61.2 s"];
        assert_eq!(told, expected);
        assert_eq!([0.0, 0.0004, 0.012, 0.2251, 1.0].map(percent), ["0 %", "< 0.1 %", "1.2 %", "23 %", "100 %"]);
    }
}
