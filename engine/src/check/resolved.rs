//! Writes the resolved graph as the text of a graph file.

use super::{assemble::Net, inputs::Input, parsed_nodes::ParsedNode, wires};
use crate::plan::{Contract, Deadline, OnError, Policy, PortFrames, RecordSettings, Require, Sources};
use osteoflow_node::{Join, Place};
use serde_json::Value as Json;
use std::fmt::Write;

/// A complete graph file: no `extends`, every default written, every path absolute, every recorded wire named.
pub(super) fn text(net: &Net<'_>) -> String {
    let mut out = String::new();
    if !net.plugins.is_empty() {
        let paths = net.plugins.iter().map(|plugin| {
            let file = quote(&plugin.path.to_string_lossy());
            let interpreter = plugin.interpreter.as_ref().map(|path| quote(&path.to_string_lossy()));
            interpreter.map_or_else(|| file.clone(), |path| format!("{{ file = {file}, interpreter = {path} }}"))
        });
        line(&mut out, &format!("plugins = {}\n", list(paths)));
    }
    line(&mut out, "[graph]");
    line(&mut out, "format = 1");
    line(&mut out, &format!("name = {}", quote(&net.header.name)));
    line(&mut out, &format!("seed = {}", net.header.seed));
    if let Some((frames, _)) = &net.header.frames {
        line(&mut out, &format!("frames = {}", list(frames.iter().map(|frame| quote(frame)))));
    }
    if net.header.lossy {
        line(&mut out, "lossy = true");
    }
    for (parsed_node, inputs) in net.parsed_nodes.iter().zip(&net.inputs) {
        node(&mut out, parsed_node, inputs, &net.parsed_nodes);
    }
    line(&mut out, "\n[record]");
    // Every wire is listed, including those of sources.
    let RecordSettings { sources, compression, views, plugins } = net.record.settings;
    line(&mut out, if sources == Sources::Hashes { "sources = \"hash\"" } else { "sources = false" });
    line(&mut out, &format!("compression = {}", quote(compression.name())));
    line(&mut out, &format!("views = {views}"));
    if !plugins {
        line(&mut out, "plugins = false");
    }
    let wires = net.record.wires.iter().map(|wire| quote(&wires::name(*wire, &net.parsed_nodes)));
    line(&mut out, &format!("wires = {}", list(wires)));
    line(&mut out, "\n[results]");
    if net.results.require == Require::Trusted {
        line(&mut out, "require = \"trusted\"");
    }
    for result in &net.results.entries {
        let mut parts = vec![format!("from = {}", quote(&wires::name(result.from, &net.parsed_nodes)))];
        parts.extend(result.all.then(|| "all = true".into()));
        parts.extend(result.optional.then(|| "optional = true".into()));
        line(&mut out, &format!("{} = {{ {} }}", quote(&result.key), parts.join(", ")));
    }
    out
}

fn node(out: &mut String, parsed_node: &ParsedNode<'_>, inputs: &[Input], parsed_nodes: &[ParsedNode<'_>]) {
    line(out, &format!("\n[node.{}]", bare(parsed_node.name)));
    line(out, &format!("kind = {}", quote(parsed_node.kind_name())));
    if parsed_node.on_error == OnError::Skip {
        line(out, "on_error = \"skip\"");
    }
    let Place { process, stop_after, pool } = parsed_node.place;
    if let Some(process) = process.filter(|process| !(*process && stop_after.is_some())) {
        line(out, &format!("process = {process}"));
    }
    if let Some(pool) = pool {
        line(out, &format!("pool = {pool}"));
    }
    if let Some(limit) = stop_after {
        line(out, &format!("stop_after_s = {:?}", limit.as_secs_f64()));
    }
    if let Some(Deadline { ns, otherwise }) = parsed_node.deadline {
        line(out, &format!("deadline_ms = {}", milliseconds(ns)));
        line(out, &format!("otherwise = {}", quote(otherwise.name())));
    }
    if !parsed_node.env.is_empty() {
        line(out, &format!("env = {}", list(parsed_node.env.iter().map(|(name, _)| quote(name)))));
    }
    for input in inputs {
        let wires: Vec<_> = input.known_wires().map(|(wire, _)| quote(&wires::name(wire, parsed_nodes))).collect();
        if let [first, others @ ..] = wires.as_slice() {
            let from = if others.is_empty() { first.clone() } else { list(wires.iter().cloned()) };
            line(out, &format!("in.{} = {}", input.port.name, wired(input, &from)));
        }
    }
    for (output, port) in parsed_node.outputs.iter().flatten().zip(parsed_node.declared.iter()) {
        let mut parts = vec![format!("type = {}", quote(port.payload.name))];
        let PortFrames { frame, to, from } = &output.given;
        // Kinds that ask for them have the frames among their parameters.
        let frames = [("frame", frame), ("to", to), ("from", from)];
        for (key, frame) in frames.into_iter().filter(|(key, _)| port.params.get(key).is_none()) {
            parts.extend(frame.as_ref().map(|frame| format!("{key} = {}", quote(frame))));
        }
        parts.extend(pairs(&port.params));
        line(out, &format!("out.{} = {{ {} }}", port.name, parts.join(", ")));
    }
    for pair in pairs(&parsed_node.params) {
        line(out, &pair);
    }
}

fn wired(input: &Input, from: &str) -> String {
    let mut parts = vec![format!("from = {from}"), format!("join = \"{}\"", input.port.join.name())];
    match input.port.join {
        Join::Stamp { tolerance_ns } => parts.push(format!("tolerance_ms = {}", milliseconds(tolerance_ns))),
        Join::LatestAfter { after_ns } => parts.push(format!("after_ms = {}", milliseconds(after_ns))),
        Join::Interpolate { max_gap_ns: Some(ns) } => parts.push(format!("max_gap_ms = {}", milliseconds(ns))),
        Join::Collect { n: Some(n) } => parts.push(format!("n = {n}")),
        Join::CollectEvery { n, step } => parts.push(format!("n = {n}, step = {step}")),
        Join::CollectSpan { span_ns, step_ns } => {
            parts.push(format!("span_ms = {}, step_ms = {}", milliseconds(span_ns), milliseconds(step_ns)));
        }
        _ => {}
    }
    parts.push(format!("capacity = {}", input.capacity));
    parts.push(format!("max_bytes = {}", input.max_bytes));
    let policy = match input.policy {
        Policy::Block => "\"block\"".into(),
        Policy::DropOld => "\"drop_old\"".into(),
        Policy::DropNew => "\"drop_new\"".into(),
        Policy::Fail => "\"fail\"".into(),
        Policy::Sample(n) => format!("\"sample\", every = {n}"),
    };
    parts.push(format!("policy = {policy}"));
    let Contract { max_age_ns, period_ns, otherwise } = input.contract;
    parts.extend(max_age_ns.map(|ns| format!("max_age_ms = {}", milliseconds(ns))));
    parts.extend(period_ns.map(|ns| format!("rate_hz = {:?}", 1e9 / ns as f64)));
    if max_age_ns.or(period_ns).is_some() {
        parts.push(format!("otherwise = {}", quote(otherwise.name())));
    }
    format!("{{ {} }}", parts.join(", "))
}

fn milliseconds(ns: i64) -> String {
    format!("{:?}", ns as f64 / 1e6)
}

/// The entries of a table as lines of TOML.
pub(crate) fn pairs(table: &Json) -> Vec<String> {
    let entries = table.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
    entries.map(|(key, value)| format!("{} = {}", bare(key), toml(value))).collect()
}

fn toml(value: &Json) -> String {
    match value {
        // Graph files cannot contain null, and defaults of lists do not.
        Json::Null => "\"\"".into(),
        Json::Bool(value) => value.to_string(),
        Json::Number(number) => match number.as_f64() {
            Some(float) if number.is_f64() => format!("{float:?}"),
            _ => number.to_string(),
        },
        Json::String(text) => quote(text),
        Json::Array(items) => list(items.iter().map(toml)),
        Json::Object(_) => match pairs(value).as_slice() {
            [] => "{}".into(),
            pairs => format!("{{ {} }}", pairs.join(", ")),
        },
    }
}

fn list(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(", "))
}

fn bare(key: &str) -> String {
    if crate::graph::extract::is_name(key) { key.into() } else { quote(key) }
}

/// A TOML basic string: JSON escapes, and additionally the control character that JSON leaves unescaped.
fn quote(text: &str) -> String {
    Json::from(text).to_string().replace('\u{7f}', "\\u007F")
}

fn line(out: &mut String, text: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(out, "{text}");
}
