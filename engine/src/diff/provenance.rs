//! What made a recording, a run or a sweep: program, seed, plugins and input files, beside its graph.

use super::index::Index;
use crate::{
    graph::difference,
    plan::PlanPlugin,
    recording::format::{INPUT_HASHES, PROGRAM, plugins as plugins_of},
};
use serde_json::Value as Json;
use std::collections::{BTreeMap, BTreeSet};

/// Entries of the program that may decide numbers; the others tell of the machine and the command line.
const PROGRAM_KEYS: [&str; 10] = [
    "version",
    "git_revision",
    "sha256",
    "compiler",
    "target",
    "target_features",
    "rustflags",
    "opt_level",
    "cpu_features",
    "seed",
];

/// Longest value of an entry, in characters.
const MAX_CHARACTERS: usize = 80;

/// What made a recording, a run or a sweep.
#[derive(Debug, Clone)]
pub struct Provenance {
    program: BTreeMap<String, String>,
    /// The SHA-256 of each input file.
    inputs: BTreeMap<String, String>,
    plugins: Vec<PlanPlugin>,
    /// Texts of plugins, by SHA-256.
    texts: BTreeMap<String, String>,
}

impl Provenance {
    /// Of a run or a sweep, by its `manifest.json` or `sweep.json`.
    pub fn of(about: &Json) -> Self {
        let word = |json: &Json| json.as_str().map_or_else(|| json.to_string(), str::to_owned);
        let command = about["command"].as_object().into_iter().flatten();
        let others = [("sha256", &about["program_sha256"]), ("seed", &about["graph"]["seed"])];
        let others = others.into_iter().filter(|(_, value)| !value.is_null());
        let entries = command.map(|(key, value)| (key.as_str(), value)).chain(others);
        let inputs = about["inputs"].as_array().into_iter().flatten();
        Self {
            program: entries.map(|(key, value)| (key.to_owned(), word(value))).collect(),
            inputs: inputs.map(|input| (word(&input["path"]), word(&input["sha256"]))).collect(),
            plugins: serde_json::from_value(about["plugins"].clone()).unwrap_or_default(),
            texts: BTreeMap::new(),
        }
    }

    pub(super) fn of_recording(Index { metadata, .. }: &Index) -> Self {
        let entries = |name| metadata.entries(name).cloned().unwrap_or_default();
        let (plugins, texts) = plugins_of(metadata).unwrap_or_default();
        Self { program: entries(PROGRAM), inputs: entries(INPUT_HASHES), plugins, texts }
    }

    /// What differs in `other`, each in words, in which `names` are those of both.
    pub fn differences(&self, other: &Self, names: [&str; 2]) -> Vec<String> {
        let [first, second] = names;
        let mut found = Vec::new();
        for key in PROGRAM_KEYS {
            if let (Some(a), Some(b)) = (self.program.get(key), other.program.get(key))
                && a != b
            {
                found.push(format!("program, {key}: {first} {a}, {second} {b}"));
            }
        }
        self.plugin_differences(other, names, &mut found);
        let lacks = |made: &Self, sha256: &str| made.inputs.values().all(|other| other != sha256);
        for file in self.inputs.keys().chain(other.inputs.keys()).collect::<BTreeSet<_>>() {
            let only = match (self.inputs.get(file), other.inputs.get(file)) {
                (Some(a), Some(b)) if a != b => format!("{first} sha256 {a}, {second} {b}"),
                (Some(a), None) if lacks(other, a) => format!("only in {first}"),
                (None, Some(b)) if lacks(self, b) => format!("only in {second}"),
                _ => continue,
            };
            found.push(format!("input file {file}: {only}"));
        }
        found
    }

    /// Adds how the plugins differ: their files, what they load, and the first line of a text that both recordings carry.
    fn plugin_differences(&self, other: &Self, [first, second]: [&str; 2], found: &mut Vec<String>) {
        let line = |a: &str, b: &str| first_line([self.texts.get(a)?, other.texts.get(b)?], [first, second]);
        for a in &self.plugins {
            let Some(b) = other.plugins.iter().find(|b| b.name == a.name) else {
                found.push(format!("plugin {}: only in {first}", a.name));
                continue;
            };
            let name = &a.name;
            if a.sha256 != b.sha256 {
                let shown = |plugin: &PlanPlugin| format!("{} (sha256 {})", plugin.path.display(), plugin.sha256);
                let line = line(&a.sha256, &b.sha256).map_or_else(String::new, |line| format!("; {line}"));
                found.push(format!("plugin {name}: {first} {}, {second} {}{line}", shown(a), shown(b)));
            }
            found.extend(a.loads.differences(&b.loads).into_iter().map(|what| format!("plugin {name}: {what}")));
            for a in &a.loads.files {
                let b = b.loads.files.iter().find(|b| b.name == a.name);
                let line = b.and_then(|b| line(&a.sha256, &b.sha256));
                found.extend(line.map(|line| format!("plugin {name}: {}: {line}", a.name)));
            }
        }
        let only = other.plugins.iter().filter(|b| self.plugins.iter().all(|a| a.name != b.name));
        found.extend(only.map(|b| format!("plugin {}: only in {second}", b.name)));
    }
}

/// The entries in which the graphs of two recordings differ, each in words.
pub(super) fn graph_differences(a: &Index, b: &Index) -> Vec<String> {
    let (Some(a), Some(b)) = (&a.run, &b.run) else { return Vec::new() };
    let name = (a.name != b.name).then(|| format!("graph: A {}, B {}", a.name, b.name));
    // A graph names the folder of its plugins, which are compared by themselves.
    let entries = difference::differences(&a.graph, &b.graph)
        .into_iter()
        .filter(|entry| entry.table != "[plugins]" && (&*entry.table, &*entry.key) != ("[graph]", "name"));
    let entries = entries.map(|entry| match (entry.key.as_str(), entry.values) {
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
    });
    name.into_iter().chain(entries).collect()
}

/// The first line in which two texts differ.
fn first_line([a, b]: [&String; 2], [first, second]: [&str; 2]) -> Option<String> {
    let (mut a, mut b) = (a.lines(), b.lines());
    for number in 1.. {
        match (a.next(), b.next()) {
            (None, None) => break,
            (a, b) if a == b => {}
            (a, b) => {
                let shown = |line: Option<&str>| line.map_or("its end".into(), |line| format!("`{}`", line.trim()));
                return Some(format!("line {number}: {first} {}, {second} {}", shown(a), shown(b)));
            }
        }
    }
    None
}
