//! The shipped graph of two files, and its variant as settings.

use anyhow::{Context, Result};
use toml::{Table, Value};

/// The graph: the start is found by the shape of the bone.
pub(crate) const BY_SHAPE: &str = include_str!("../../../graphs/two_files.toml");
/// What its variant changes, which starts from points picked on both.
pub(crate) const FROM_PAIRS: &str = include_str!("../../../graphs/variants/two_files_picked.toml");

/// The name of the graph in messages.
pub(super) const NAME: &str = "graphs/two_files.toml";

/// The settings that make the graph its variant.
pub(super) fn from_pairs() -> Result<Vec<String>> {
    let mut variant: Table = FROM_PAIRS.parse().context("the graph of picked pairs")?;
    variant.remove("extends");
    let mut sets = Vec::new();
    flatten("", &variant, &mut sets);
    Ok(sets)
}

fn flatten(prefix: &str, table: &Table, sets: &mut Vec<String>) {
    for (key, value) in table {
        match value {
            Value::Table(inner) => flatten(&format!("{prefix}{key}."), inner, sets),
            value => sets.push(format!("{prefix}{key}={value}")),
        }
    }
}
