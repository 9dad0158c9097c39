//! The shipped graph of two files, and what a registration changes in it.

use anyhow::{Context, Result};
use toml_edit::{DocumentMut, Item, TableLike};

/// The graph: the start is found by the shape of the bone.
pub(crate) const BY_SHAPE: &str = include_str!("../../../graphs/two_files.toml");
/// What its variant changes, which starts from points picked on both.
pub(crate) const FROM_PAIRS: &str = include_str!("../../../graphs/variants/two_files_picked.toml");

/// The name of the graph in messages.
pub(super) const NAME: &str = "graphs/two_files.toml";

/// The graph, from picked pairs if `from_pairs`, without the keys that `removed` names, such as `node.verdict.in.start`.
pub(super) fn text(from_pairs: bool, removed: &[&str]) -> Result<String> {
    let mut graph: DocumentMut = BY_SHAPE.parse().context("the graph of two files")?;
    if from_pairs {
        let mut variant: DocumentMut = FROM_PAIRS.parse().context("the graph of picked pairs")?;
        variant.remove("extends");
        let listed = variant.remove("remove");
        let listed = listed.iter().filter_map(Item::as_array).flatten().filter_map(|key| key.as_str());
        listed.for_each(|key| remove(graph.as_table_mut(), key));
        merge(graph.as_table_mut(), variant.as_table());
    }
    removed.iter().for_each(|key| remove(graph.as_table_mut(), key));
    Ok(graph.to_string())
}

/// Removes a key, if it is there.
fn remove(table: &mut dyn TableLike, key: &str) {
    match key.split_once('.') {
        // A key of [results] may have a point in it.
        _ if table.contains_key(key) => drop(table.remove(key)),
        Some((first, rest)) => {
            if let Some(inner) = table.get_mut(first).and_then(Item::as_table_like_mut) {
                remove(inner, rest);
            }
        }
        None => {}
    }
}

/// Sets the keys of `variant`, tables key by key.
fn merge(table: &mut dyn TableLike, variant: &dyn TableLike) {
    for (key, item) in variant.iter() {
        match (table.get_mut(key).and_then(Item::as_table_like_mut), item.as_table_like()) {
            (Some(inner), Some(variant)) => merge(inner, variant),
            _ => drop(table.insert(key, item.clone())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> toml::Table {
        text.parse().expect("a graph")
    }

    #[test]
    fn the_variant_of_picked_pairs_is_the_one_of_the_file() {
        let graph = parsed(&text(true, &[]).expect("a graph"));
        let verdict = graph["node"]["verdict"]["in"].as_table().expect("inputs");
        assert!(!verdict.contains_key("start") && verdict.contains_key("landmarks") && verdict.contains_key("icp"));
        assert_eq!(graph["node"]["coarse"]["kind"].as_str(), Some("coarse.three_point"));
        assert!(graph["node"]["coarse"]["in"].get("source").is_some());
        assert_eq!(graph["graph"]["name"].as_str(), Some("two_files_picked"));
    }

    #[test]
    fn keys_are_removed_wherever_they_are() {
        let graph = parsed(
            &text(false, &["node.verdict.in.start", "results.poses.t_ct_camera", "node.export"]).expect("a graph"),
        );
        assert!(graph["node"].get("export").is_none() && graph["node"]["verdict"]["in"].get("start").is_none());
        assert!(graph["node"]["verdict"]["in"].get("icp").is_some());
        assert_eq!(parsed(&text(false, &[]).expect("a graph")), parsed(BY_SHAPE));
    }
}
