//! docs/project/dependencies.md lists the libraries that the workspace names, and no others.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

use std::{collections::BTreeSet, fs, path::Path};

#[test]
fn each_dependency_has_its_reason_and_its_upkeep_on_one_page() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest: toml::Table = fs::read_to_string(root.join("Cargo.toml")).unwrap().parse().unwrap();
    let named = manifest["workspace"]["dependencies"].as_table().unwrap().iter();
    let named = named.filter(|(_, entry)| entry.get("path").is_none());
    let named: BTreeSet<String> =
        named.map(|(name, entry)| entry.get("package").and_then(|p| p.as_str()).unwrap_or(name).into()).collect();
    let page = fs::read_to_string(root.join("docs/project/dependencies.md")).unwrap();
    let rows: Vec<Vec<&str>> = page
        .lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.split('|').map(str::trim).collect())
        .collect();
    let listed: BTreeSet<String> = rows.iter().map(|row| row[1].trim_matches('`').into()).collect();
    assert_eq!(named, listed);
    for row in rows {
        assert!(row.len() == 7 && row[2..6].iter().all(|cell| !cell.is_empty()), "{row:?}");
    }
}
