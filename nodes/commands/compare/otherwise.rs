//! What was set otherwise in runs or sweeps: the entries of their graphs, and what made them.

use crate::commands::common::text_table::TextTable;
use osteoflow_engine::{Provenance, diff::entries_that_differ, names::shortened};
use serde_json::Value;
use std::collections::BTreeMap;

/// Most entries that are listed.
const MAX_LISTED: usize = 8;
/// Most characters of a value.
const MAX_CHARACTERS: usize = 40;

/// What one of the compared came from.
pub(super) struct Made {
    /// The graph, as text.
    pub(super) graph: String,
    /// The manifest of a run or the design of a sweep.
    pub(super) about: Value,
}

/// The entries that differ from those of the first, by their keys as of `--set`: a value of each of the compared.
pub(super) fn entries(all: &[Made]) -> Vec<(String, Vec<String>)> {
    let mut rows: BTreeMap<String, Vec<Option<String>>> = BTreeMap::new();
    for (k, made) in all.iter().enumerate().skip(1) {
        // The name of a graph is no setting.
        let differ = entries_that_differ(&all[0].graph, &made.graph).into_iter().filter(|(key, _)| key != "graph.name");
        for (key, [first, other]) in differ {
            rows.entry(key).or_insert_with(|| vec![first; all.len()])[k] = other;
        }
    }
    let mut rows: Vec<_> = rows.into_iter().map(|(key, row)| (key, row.into_iter().map(shown).collect())).collect();
    // The kind decides what the other keys mean.
    rows.sort_by_key(|(key, _): &(String, Vec<String>)| !key.ends_with(".kind"));
    rows
}

/// A value as TOML, without quotes and not too long.
pub(super) fn shown(value: Option<String>) -> String {
    match value.as_deref().map(|value| value.trim_matches('"')) {
        None => "-".into(),
        Some("") => "there".into(),
        Some(bare) => shortened(bare, MAX_CHARACTERS),
    }
}

/// The entries and `more` of them as a table, and below it the program, inputs and plugins that differ.
pub(super) fn text(all: &[Made], more: Vec<(String, Vec<String>)>, is_brief: bool) -> String {
    let (mut rows, heads) = (more, heads(all.len()));
    rows.extend(entries(all));
    let n_listed = if is_brief { MAX_LISTED } else { usize::MAX };
    let mut table = TextTable::new("set otherwise", &heads.iter().map(String::as_str).collect::<Vec<_>>());
    rows.iter().take(n_listed).for_each(|(key, values)| table.row(key, values.iter().cloned()));
    let mut out = if rows.is_empty() { "nothing was set otherwise\n".to_owned() } else { table.lines() };
    let mut others = Vec::new();
    for (k, made) in all.iter().enumerate().skip(1) {
        let [first, other] = [&all[0], made].map(|made| Provenance::of(&made.about).without_seed());
        let differ = first.differences(&other, ["[1]", &format!("[{}]", k + 1)]);
        others.extend(differ.into_iter().map(|what| format!("  {what}\n")));
    }
    others.iter().take(n_listed).for_each(|line| out += line);
    match rows.len().saturating_sub(n_listed) + others.len().saturating_sub(n_listed) {
        0 => {}
        n => out += &format!("  {n} more with --verbose\n"),
    }
    out
}

/// `[1]`, `[2]` and so on.
pub(super) fn heads(n: usize) -> Vec<String> {
    (1..=n).map(|k| format!("[{k}]")).collect()
}
