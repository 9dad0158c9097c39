//! By what two recordings were made: graph, seed, program, plugins and input files.

use super::index::Index;
use crate::{
    graph::difference,
    plan::PlanPlugin,
    recording::format::{INPUT_HASHES, PROGRAM, plugins as plugins_of},
};
use std::collections::{BTreeMap, BTreeSet};

/// Entries of the program that may decide numbers; the others tell of the machine and the command line.
const PROGRAM_KEYS: [&str; 8] =
    ["version", "git_revision", "compiler", "target", "target_features", "rustflags", "opt_level", "cpu_features"];

/// Longest value of an entry, in characters.
const MAX_CHARACTERS: usize = 80;

/// What differs in what made the recordings, each in words.
pub(super) fn differences(a: &Index, b: &Index) -> Vec<String> {
    let mut found = Vec::new();
    let (run_a, run_b) = (a.run.as_ref(), b.run.as_ref());
    if let (Some(run_a), Some(run_b)) = (run_a, run_b) {
        if run_a.name != run_b.name {
            found.push(format!("graph: A {}, B {}", run_a.name, run_b.name));
        }
        let graph = difference::differences(&run_a.graph, &run_b.graph);
        // A graph names the folder of its plugins, which are compared below.
        let graph = graph
            .into_iter()
            .filter(|entry| entry.table != "[plugins]" && (&*entry.table, &*entry.key) != ("[graph]", "name"));
        found.extend(graph.map(|entry| match (entry.key.as_str(), entry.values) {
            ("", [Some(_), None]) => format!("{}: only in A", entry.table),
            ("", [None, Some(_)]) => format!("{}: only in B", entry.table),
            (key, [a, b]) => {
                let shown = |value: Option<String>| match value {
                    Some(value) if value.chars().count() > MAX_CHARACTERS => {
                        format!("{}..", value.chars().take(MAX_CHARACTERS).collect::<String>())
                    }
                    Some(value) => value,
                    None => "none".into(),
                };
                format!("{} {key}: A {}, B {}", entry.table, shown(a), shown(b))
            }
        }));
    }
    let [of_a, of_b] = [a, b].map(|index| index.metadata.entries(PROGRAM).cloned().unwrap_or_default());
    for key in PROGRAM_KEYS {
        if let (Some(a), Some(b)) = (of_a.get(key), of_b.get(key))
            && a != b
        {
            found.push(format!("program, {key}: A {a}, B {b}"));
        }
    }
    plugins(a, b, &mut found);
    let [of_a, of_b] = [a, b].map(|index| index.metadata.entries(INPUT_HASHES).cloned().unwrap_or_default());
    let files: BTreeSet<&String> = of_a.keys().chain(of_b.keys()).collect();
    for file in files {
        match (of_a.get(file), of_b.get(file)) {
            (Some(a), Some(b)) if a != b => found.push(format!("input file {file}: A sha256 {a}, B {b}")),
            (Some(a), None) if of_b.values().all(|b| b != a) => found.push(format!("input file {file}: only in A")),
            (None, Some(b)) if of_a.values().all(|a| a != b) => found.push(format!("input file {file}: only in B")),
            _ => {}
        }
    }
    found
}

/// Adds how the plugins differ: their files, what they load, and the first line of a text that both recordings carry.
fn plugins(a: &Index, b: &Index, found: &mut Vec<String>) {
    let of = |index: &Index| plugins_of(&index.metadata).unwrap_or_default();
    let ((of_a, texts_a), (of_b, texts_b)) = (of(a), of(b));
    let line = |a: &str, b: &str| first_line(&texts_a, a, &texts_b, b);
    for a in &of_a {
        let Some(b) = of_b.iter().find(|b| b.name == a.name) else {
            found.push(format!("plugin {}: only in A", a.name));
            continue;
        };
        let name = &a.name;
        if a.sha256 != b.sha256 {
            let shown = |plugin: &PlanPlugin| format!("{} (sha256 {})", plugin.path.display(), plugin.sha256);
            let line = line(&a.sha256, &b.sha256);
            found.push(format!("plugin {name}: A {}, B {}{line}", shown(a), shown(b)));
        }
        found.extend(a.loads.differences(&b.loads).into_iter().map(|what| format!("plugin {name}: {what}")));
        for (a, b) in a.loads.files.iter().filter_map(|a| Some((a, b.loads.files.iter().find(|b| b.name == a.name)?))) {
            let line = line(&a.sha256, &b.sha256);
            if let Some(line) = line.strip_prefix("; ") {
                found.push(format!("plugin {name}: {}: {line}", a.name));
            }
        }
    }
    found.extend(
        of_b.iter().filter(|b| of_a.iter().all(|a| a.name != b.name)).map(|b| format!("plugin {}: only in B", b.name)),
    );
}

/// The first line in which two recorded texts differ, after a semicolon; empty if they are the same or not recorded.
fn first_line(of_a: &BTreeMap<String, String>, a: &str, of_b: &BTreeMap<String, String>, b: &str) -> String {
    let (Some(a), Some(b)) = (of_a.get(a), of_b.get(b)) else { return String::new() };
    let (mut a, mut b) = (a.lines(), b.lines());
    for number in 1.. {
        match (a.next(), b.next()) {
            (None, None) => break,
            (a, b) if a == b => {}
            (a, b) => {
                let shown = |line: Option<&str>| line.map_or("its end".into(), |line| format!("`{}`", line.trim()));
                return format!("; line {number}: A {}, B {}", shown(a), shown(b));
            }
        }
    }
    String::new()
}
