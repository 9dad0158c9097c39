//! Another kind for a node of a graph that states every parameter: those that the user did not write go with their kind.

use super::grammar;
use std::collections::BTreeSet;
use toml::{Table, Value};

/// Whether the setting is of a key of this node.
pub(crate) fn sets(set: &str, node: &str) -> bool {
    key(set).strip_prefix(node).is_some_and(|rest| rest.starts_with('.'))
}

/// Whether the setting is of this node's kind.
pub(crate) fn sets_kind(set: &str, node: &str) -> bool {
    key(set).strip_prefix(node) == Some(".kind")
}

/// The key of a setting, without `node.`.
fn key(set: &str) -> &str {
    let key = set.split('=').next().unwrap_or_default().trim();
    key.strip_prefix("node.").unwrap_or(key)
}

/// Removes the parameters of a node's table that were not written, and tables that become empty.
pub(crate) fn remove_unwritten(table: &mut Table, written: &BTreeSet<String>) {
    remove(table, "", written);
}

fn remove(table: &mut Table, prefix: &str, written: &BTreeSet<String>) {
    table.retain(|key, value| {
        if prefix.is_empty() && grammar::has(&grammar::NODE, key) {
            return true;
        }
        let path = format!("{prefix}{key}");
        match value {
            Value::Table(inner) => {
                remove(inner, &format!("{path}."), written);
                !inner.is_empty()
            }
            _ => written.contains(&path),
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_written_stays_whatever_the_defaults_are() {
        let mut node: Table =
            "kind = \"a.b\"\nin = { a = \"c.d\" }\nmm = 5.0\nn = 4\nrules = { most = 1.5, least = 0.1 }\n\
                               other = { most = 1.5 }\n"
                .parse()
                .unwrap();
        let written = ["mm", "rules", "rules.least"].map(str::to_owned).into();
        remove_unwritten(&mut node, &written);
        let expected: Table =
            "kind = \"a.b\"\nin = { a = \"c.d\" }\nmm = 5.0\nrules = { least = 0.1 }\n".parse().unwrap();
        assert_eq!(node, expected);
    }

    #[test]
    fn a_setting_of_a_kind_is_known_by_its_key() {
        assert!(sets_kind("icp.kind=my.fit", "icp") && sets_kind(" node.icp.kind = \"my.fit\"", "icp"));
        assert!(
            !sets_kind("icp.kinds=1", "icp")
                && !sets_kind("icp.kind=my.fit", "cp")
                && !sets_kind("x.icp.kind=1", "icp")
        );
    }
}
