//! Checks that columns and points can exist in the results: each path must start with a result of the graph.

use super::{Column, Reader, spec::TIMES};
use crate::{
    fault::Fault,
    graph::{Spanned, Table, grammar::REASONS},
    names::nearest,
};

/// Results that every run has, regardless of `[results]`.
const ALWAYS: [&str; 3] = ["notice", REASONS, "refused"];

impl Reader<'_> {
    /// Faults for columns and points that no run can have; `results` and `nodes` are those of the graph.
    pub(super) fn paths(&mut self, table: &Table, results: &[String], nodes: &[String]) {
        let known: Vec<&str> = results.iter().map(String::as_str).chain(ALWAYS).collect();
        for (kind, what) in [("columns", "column"), ("points", "points")] {
            let entries = table.get(kind).and_then(|entry| entry.value.as_table()).into_iter().flat_map(|t| &t.0);
            for entry in entries {
                let value = match kind {
                    "columns" => Some(&entry.value),
                    _ => entry.value.as_table().and_then(|table| table.get("from")).map(|from| &from.value),
                };
                let Some((value, path)) = value.and_then(|value| Some((value, value.as_text()?))) else { continue };
                if known.iter().any(|key| inside(key, path) || inside(path, key)) {
                    continue;
                }
                if kind == "columns" && self.is_time(value, path, &entry.key, nodes) {
                    continue;
                }
                let fault = Fault::new(format!("{what} \"{}\" asks for {path}, which no run has", entry.key));
                let help = meant(path, &known).map(|path| format!("did you mean \"{path}\"?"));
                self.faults.push(
                    fault
                        .at(&value.at, "begins with no result of the graph")
                        .note_if(nearest::all("its results", results.iter().map(String::as_str)))
                        .help_if(help),
                );
            }
        }
    }

    /// Whether a column asks for a time, with a fault if there is none such.
    fn is_time(&mut self, value: &Spanned, path: &str, name: &str, nodes: &[String]) -> bool {
        let times = format!("the times of a node and of the run are {}", TIMES.join(", "));
        let Some(of) = path.strip_prefix("nodes.") else {
            let Some(time) = path.strip_prefix("run.") else { return false };
            if !TIMES.contains(&time) {
                let fault = Fault::new(format!("column \"{name}\" asks for {path}, which no run has"));
                self.faults.push(fault.at(&value.at, "no time of the run").note(times));
            }
            return true;
        };
        let Some((node, _)) = Column::node_of(path) else {
            let fault = Fault::new(format!("column \"{name}\" asks for {path}, which no node has"));
            let node = of.split('.').next().unwrap_or_default();
            let help = format!("write \"nodes.{node}.cpu_ms\"");
            self.faults.push(fault.at(&value.at, "no time of a node").note(times).help(help));
            return true;
        };
        // A node of a module is named after the node that uses the module.
        let outer = node.split('/').next().unwrap_or_default();
        if !nodes.iter().any(|known| known == outer) {
            let fault = Fault::new(format!("column \"{name}\" asks for the time of \"{node}\", which is no node"));
            let known = nodes.iter().map(String::as_str);
            let help = nearest::name(outer, known.clone()).map(|name| format!("did you mean \"{name}\"?"));
            let fault = fault.at(&value.at, "no node of the graph").note_if(nearest::all("its nodes", known));
            self.faults.push(fault.help_if(help));
        }
        true
    }
}

/// Whether a path equals `outer` or is inside it.
fn inside(outer: &str, path: &str) -> bool {
    path.strip_prefix(outer).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// The path with its first part replaced by the nearest known result.
fn meant(path: &str, known: &[&str]) -> Option<String> {
    let ends: Vec<_> = path.match_indices('.').map(|(at, _)| at).chain([path.len()]).collect();
    let n_parts = |name: &str| name.matches('.').count();
    let near = |is_alike: bool| {
        ends.iter().rev().find_map(|end| {
            let (front, rest) = path.split_at(*end);
            let alike = known.iter().copied().filter(|key| !is_alike || n_parts(key) == n_parts(front));
            Some(format!("{}{rest}", nearest::name(front, alike)?))
        })
    };
    // Known names may contain dots; compare names with the same number of parts first.
    near(true).or_else(|| near(false))
}
