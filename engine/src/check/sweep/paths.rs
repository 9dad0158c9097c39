//! Checks that columns and points can exist in the results: each path must start with a result of the graph.

use super::Reader;
use crate::{fault::Fault, graph::Table, names::nearest};

/// Results that every run has, regardless of `[results]`.
const ALWAYS: [&str; 2] = ["notice", "refused"];

impl Reader<'_> {
    /// Faults for columns and points that no run can have; `results` are those of the graph.
    pub(super) fn paths(&mut self, table: &Table, results: &[String]) {
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
