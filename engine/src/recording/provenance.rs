//! What made a recording, a run or a sweep: program, seed, plugins and input files, beside its graph.

use crate::{
    hash::files::sha256,
    names::shortened,
    plan::{Loads, PlanPlugin},
    recording::format::{INPUT_HASHES, MetadataRecords, PROGRAM, plugins as plugins_of},
};
use serde_json::Value as Json;
use std::collections::{BTreeMap, BTreeSet};

/// Entries of the program that may decide numbers; the others tell of the machine and the command line.
const PROGRAM_KEYS: [&str; 11] = [
    "version",
    "git_revision",
    "sha256",
    "compiler",
    "target",
    "target_features",
    "rustflags",
    "opt_level",
    "cpu_features",
    "libraries",
    "seed",
];

/// Longest entry of a list, in characters.
const MAX_CHARACTERS: usize = 100;

/// What made a recording, a run or a sweep.
#[derive(Debug, Clone, Default)]
pub struct Provenance {
    program: BTreeMap<String, String>,
    /// The SHA-256 of each input file, by its path, or why there is none.
    pub(crate) inputs: BTreeMap<String, String>,
    pub(crate) plugins: Vec<PlanPlugin>,
    /// The text of plugins and of their modules, by SHA-256.
    pub(crate) texts: BTreeMap<String, String>,
}

impl Provenance {
    /// Of a run, a sweep or a failure, by its `manifest.json`, `sweep.json` or `repro.json`.
    pub fn of(about: &Json) -> Self {
        let word = |json: &Json| json.as_str().map_or_else(|| json.to_string(), str::to_owned);
        let command = about["command"].as_object().into_iter().flatten();
        let (version, sha256) = (("version", &about["engine_version"]), ("sha256", &about["program_sha256"]));
        let others = [version, sha256, ("seed", &about["graph"]["seed"])];
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

    /// Without the seed, for who compares the graphs, which state it, too.
    pub fn without_seed(mut self) -> Self {
        self.program.remove("seed");
        self
    }

    /// Of the run that made a recording.
    ///
    /// # Errors
    /// Which record of plugins cannot be read.
    pub(crate) fn of_recording(metadata: &MetadataRecords) -> Result<Self, String> {
        let entries = |name| metadata.entries(name).cloned().unwrap_or_default();
        let (plugins, texts) = plugins_of(metadata)?;
        Ok(Self { program: entries(PROGRAM), inputs: entries(INPUT_HASHES), plugins, texts })
    }

    /// What differs in `other`, each in words, in which `names` are those of both.
    pub fn differences(&self, other: &Self, names: [&str; 2]) -> Vec<String> {
        let mut found = self.program_differences(other, names);
        found.extend(self.plugin_differences(other, names));
        found.extend(self.late_differences(other, names));
        found.extend(self.input_differences(other, names));
        found
    }

    /// How the programs and their machines differ.
    pub(crate) fn program_differences(&self, other: &Self, [first, second]: [&str; 2]) -> Vec<String> {
        let both = |key: &&'static str| Some((*key, self.program.get(*key)?, other.program.get(*key)?));
        let differ = PROGRAM_KEYS.iter().filter_map(both).filter(|(_, a, b)| a != b);
        // Of lists what the other lacks.
        let list = |text: &str| serde_json::from_str(text).unwrap_or_else(|_| vec![text.to_owned()]);
        let shown = |a, b| lacks(&list(a), &list(b));
        differ.map(|(key, a, b)| format!("program, {key}: {first} {}, {second} {}", shown(a, b), shown(b, a))).collect()
    }

    /// How what firings loaded or opened differs.
    pub(crate) fn late_differences(&self, other: &Self, names: [&str; 2]) -> Vec<String> {
        self.loads_differences(other, |a, b| a.late_differences(b, names))
    }

    fn loads_differences(&self, other: &Self, between: impl Fn(&Loads, &Loads) -> Vec<String>) -> Vec<String> {
        let both = self.plugins.iter().filter_map(|a| Some((a, other.plugins.iter().find(|b| b.name == a.name)?)));
        let differ = both.flat_map(|(a, b)| between(&a.loads, &b.loads).into_iter().map(|what| (&a.name, what)));
        differ.map(|(name, what)| format!("plugin {name}: {what}")).collect()
    }

    /// The files that firings loaded or opened, which hold something else by now; those that are gone are not told.
    pub(crate) fn changed_files(&self) -> Vec<String> {
        let all = self.plugins.iter().flat_map(|plugin| {
            let late = plugin.loads.files.iter().filter(|file| plugin.loads.late.contains(&file.name));
            late.chain(&plugin.loads.opened).map(|file| (&plugin.name, file))
        });
        let changed = all.filter(|(_, file)| sha256(&file.path).is_ok_and(|(_, now)| now.to_string() != file.sha256));
        changed.map(|(plugin, file)| format!("plugin {plugin}: {} has changed since", file.path.display())).collect()
    }

    /// How the input files differ; equal files may have other paths.
    pub(crate) fn input_differences(&self, other: &Self, [first, second]: [&str; 2]) -> Vec<String> {
        let mut found = Vec::new();
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

    /// How the plugins differ: their files, what they load before the first firing, and the first line of a text that both
    /// recordings carry.
    pub(crate) fn plugin_differences(&self, other: &Self, names: [&str; 2]) -> Vec<String> {
        let ([first, second], mut found) = (names, Vec::new());
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
            for a in &a.loads.files {
                let b = b.loads.files.iter().find(|b| b.name == a.name);
                let line = b.and_then(|b| line(&a.sha256, &b.sha256));
                found.extend(line.map(|line| format!("plugin {name}: {}: {line}", a.name)));
            }
        }
        let only = other.plugins.iter().filter(|b| self.plugins.iter().all(|a| a.name != b.name));
        found.extend(only.map(|b| format!("plugin {}: only in {second}", b.name)));
        found.extend(self.loads_differences(other, |a, b| a.differences(b, names)));
        found
    }
}

/// What `one` has and `other` lacks.
fn lacks(one: &[String], other: &[String]) -> String {
    let more = one.iter().filter(|entry| !other.contains(entry)).map(|entry| shortened(entry, MAX_CHARACTERS));
    more.reduce(|all, entry| format!("{all}, {entry}")).unwrap_or_else(|| "no more".into())
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
